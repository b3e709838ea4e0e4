// Traces arrays of any rays through a scene of a few triangles, each ray against each: the bits of trace_rays.cl.
//
// Lanes are rays. All triangles are met (triangle_list.clh); then
//   closest hit: one triangle is surely met, and surely before all others: its t and weights are found, by the formulas of
//                the leaves (intersect_triangle.clh), a lane for each ray
//   any hit:     something is surely met before the ray's end, or surely nothing is
//   rays in doubt, and those whose t_min is not 0, take the leaves' test (leaf_hits.clh) of all triangles
// Good at: up to 64 triangles. Bad at: more, and rays of which most are in doubt: scenes of needles, or far from origins.
// Tests: tests/test_rays.py, tests/test_triangle_list.py.

#include "vector.clh"
#include "edge_function.clh"
#include "settled_tests.clh"
#include "intersect_triangle.clh"
#include "leaf_hits.clh"
#include "ray_batch.clh"
#include "triangle_list.clh"

// The leaves' test of all triangles for one ray.
static void meet_all(const Leaves *leaves, const Rays *rays, uint triangle_count, uint ray, bool any_hit) {
  Walk walk;
  begin(leaves, rays, ray, any_hit, &walk);
  walk.improved = meet_leaf(leaves, &walk.ray, 0, triangle_count, any_hit, &walk.best);
  write_answer(rays, &walk, any_hit);
}

// Hits of a triangle for each lane, by the formulas of the leaves. Rays are bounded by all axes.
INLINE void find_hits(const Leaves *leaves, const Rays *rays, const uint *slots, const ListedRays *at, Vec3 origin, Best *hits) {
  uint places[VECTOR_WIDTH];
  Triangles t;
  Vec3 *parts[3] = {&t.p0, &t.p1, &t.p2};
  float_v unused;
#pragma unroll
  for (uint k = 0; k < 3; ++k) {
    for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) places[lane] = 3 * slots[lane] + k;
    *parts[k] = gather_points(leaves->corners, places, &unused);
  }
  t.normal = cross3(subtract(t.p1, t.p0), subtract(t.p2, t.p0));
  const Vec3 direction = at->direction, size = sizes3(direction);
  const float_v size_floor = SIZE_FLOOR * (1.0f + size.x + size.y + size.z);
  TriangleHits found;
  intersect_lanes(t, origin, direction, size, size_floor, LANES >= 0, &found);  // some lane is met
  const Vec3 inverse = {1.0f / direction.x, 1.0f / direction.y, 1.0f / direction.z};
  const Vec3 low = lower_corner(t), high = upper_corner(t);
  const Vec3 near = {inverse.x < 0.0f ? high.x : low.x, inverse.y < 0.0f ? high.y : low.y, inverse.z < 0.0f ? high.z : low.z};
  const Vec3 far = {inverse.x < 0.0f ? low.x : high.x, inverse.y < 0.0f ? low.y : high.y, inverse.z < 0.0f ? low.z : high.z};
  const Interval within = slabs_joined(meet_planes(near, origin, scale3(inverse, (float_v)(1.0f - SLAB_SLACK))),
                                       meet_planes(far, origin, scale3(inverse, (float_v)(1.0f + SLAB_SLACK))));
  const Distances distances = bound_distances_within(&found, t, direction, size, size_floor, within);
  float t_hit[VECTOR_WIDTH], t_low[VECTOR_WIDTH], t_high[VECTOR_WIDTH], edge[3][VECTOR_WIDTH];
  STORE_V(distances.t, t_hit);
  STORE_V(distances.low, t_low);
  STORE_V(distances.high, t_high);
  for (uint k = 0; k < 3; ++k) STORE_V(found.edge[k], edge[k]);
  for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) {
    const uint named = as_uint(words_of_lane(leaves, slots[lane])[(BLOCK_WORDS - 1) * BLOCK_LANES]);
    const Best hit = {slots[lane], named & ((1u << TURN_LOG2) - 1), named >> TURN_LOG2, t_hit[lane], t_low[lane], t_high[lane],
                      {edge[0][lane], edge[1][lane], edge[2][lane]}};
    hits[lane] = hit;
  }
}

// Bounds of where rays meet the lamps that they look for; nothing is before one that is in doubt. Most look for the same few.
INLINE void meet_lamps(global const float *list, const ListedRays *at, uint_v lamps, float_v *low, float_v *high, int_v *in_doubt) {
  uint slots[VECTOR_WIDTH];
  STORE_V(lamps, slots);
  for (ulong mask = LANE_MASK(lamps != (uint_v)(NO_HIT)); mask != 0;) {
    const uint slot = slots[first_lane(mask)];
    const int_v is_lamp = lamps == (uint_v)(slot);
    mask &= ~LANE_MASK(is_lamp);
    ListedHits found;
    const bool is_left = meet_listed(list + LIST_WORDS * slot, at, &found);
    const int_v is_met = is_lamp & (is_left ? found.met : (int_v)(0));
    *low = is_lamp ? (is_met ? found.below.x / found.below.y : (float_v)(0.0f)) : *low;
    *high = is_met ? found.above.x / found.above.y : *high;
    *in_doubt |= is_lamp & (is_met == 0);
  }
}

// Whether rays meet something before their end: 1 or 0 into `occluded` of `count` rays. items: theirs, the last filled up.
INLINE void stop_rays(const TriangleList *list, const Leaves *leaves, const Rays *rays, const uint *items, uint count) {
  ListedRays at;
  float_v t_min, t_max;
  const Vec3 origin = gather_points(rays->origins, items, &t_min), direction = gather_points(rays->directions, items, &t_max);
  place_rays(list, origin, direction, &at);
  const uint_v left = gather_words(rays->excluded, items);
  const uint_v lamps = rays->ends ? gather_words(rays->lamp_slots, items) : (uint_v)(NO_HIT);
  const int_v has_lamp = lamps != (uint_v)(NO_HIT), from_start = t_min == 0.0f;
  // Hits end at t_max; where there is a lamp at that, whatever t_max is. Where none is surely met the leaves' test decides.
  float_v end_low = t_max, end_high = t_max;
  int_v in_doubt = from_start == 0, stops = in_doubt & 0;
  meet_lamps(list->triangles, &at, lamps, &end_low, &end_high, &in_doubt);
  for (uint slot = 0; slot < list->triangle_count; ++slot) {
    global const float *triangle = list->triangles + LIST_WORDS * slot;
    ListedHits found;
    if (!meet_listed(triangle, &at, &found)) continue;
    const int_v missed = found.missed | (has_lamp & (lamps == (uint_v)(slot))) | (left == (uint_v)(as_uint(triangle[9])));
    const int_v is_behind = found.is_known & (found.below.x >= end_high * found.below.y);
    const int_v counts = (missed | is_behind) == 0, surely = found.met & (found.above.x < end_low * found.above.y);
    stops |= counts & surely;
    in_doubt |= counts & (surely == 0);
  }
  stops &= from_start;
  int is_open[VECTOR_WIDTH], stopped[VECTOR_WIDTH];
  STORE_V(in_doubt & (stops == 0), is_open);
  STORE_V(stops, stopped);
  for (uint lane = 0; lane < count; ++lane) {
    if (is_open[lane]) meet_all(leaves, rays, list->triangle_count, items[lane], true);
    else rays->occluded[items[lane]] = stopped[lane] != 0;
  }
}

// Reads: list_edges, list (host), blocks (pack_leaves), corners (prepare_triangles). Writes: prims_hit, distances, weights (for
// arrive, offset_origins and the host). Work item: VECTOR_WIDTH rays. Local memory: 0 bytes.
kernel void trace_closest(
    uint ray_count,
    uint triangle_count,
    uint edge_count,
    global const float4 *restrict origins,     // [ray_count] xyz world space, w t_min, exclusive, not negative
    global const float4 *restrict directions,  // [ray_count] xyz, any length within 2^-60 .. 2^60, w t_max, exclusive
    global const uint *restrict excluded,      // [ray_count] prim_id that the ray does not meet, or NO_HIT
    global const float *restrict list_edges,   // [4 + 6 * edge_count], see TriangleList
    global const float *restrict list,         // [LIST_WORDS * triangle_count]
    global const float *restrict blocks,       // [block_count * BLOCK_WORDS * BLOCK_LANES], see Leaves
    global const float4 *restrict corners,     // [3 * triangle_count] by slot
    global const uint *restrict prims,         // [triangle_count] prim_id of each slot
    global uint *restrict prims_hit,           // [ray_count] prim_id or NO_HIT
    global float2 *restrict distances,         // [ray_count] t (+inf: no hit), bound of its error
    global float4 *restrict weights)           // [ray_count] barycentrics b0 b1 b2 in the order of indices, w 0
{
  const uint first = get_global_id(0) * VECTOR_WIDTH;
  if (first >= ray_count) return;
  const Leaves leaves = {blocks, corners, prims};
  const Rays rays = {origins, directions, excluded, 0, 0, prims_hit, distances, weights, 0};
  const TriangleList all = {list_edges, list, edge_count, triangle_count};
  ListedRays at;
  float_v t_min, t_max;
  const Vec3 origin = load_points(origins, first, ray_count, &t_min), direction = load_points(directions, first, ray_count, &t_max);
  place_rays(&all, origin, direction, &at);
  const uint_v left = load_words(excluded, first, ray_count);

  // The best hit that is surely met, and the least t of what may be met and is neither surely behind it nor itself.
  const float_v nowhere = (float_v)(INFINITY);
  Quotient low = {nowhere, (float_v)(1.0f)}, high = low;
  float_v others = nowhere;
  uint_v best_slot = (uint_v)(0);
  for (uint slot = 0; slot < triangle_count; ++slot) {
    global const float *triangle = list + LIST_WORDS * slot;
    ListedHits found;
    if (!meet_listed(triangle, &at, &found)) continue;
    const int_v missed = found.missed | (left == (uint_v)(as_uint(triangle[9])));
    const int_v is_before = found.met & (found.above.x * low.y < low.x * found.above.y) & (missed == 0);
    const int_v is_behind = found.below.x * high.y > high.x * found.below.y;
    const int_v in_doubt = (missed | is_before | is_behind) == 0;
    low.x = is_before ? found.below.x : low.x;
    low.y = is_before ? found.below.y : low.y;
    high.x = is_before ? found.above.x : high.x;
    high.y = is_before ? found.above.y : high.y;
    best_slot = is_before ? (uint_v)(slot) : best_slot;
    if (has_lane(in_doubt)) others = min(others, in_doubt ? least_t(&found) : nowhere);
  }
  const float_v best_low = low.x / low.y, best_high = high.x / high.y;

  const Vec3 size = sizes3(at.direction);
  const int_v is_empty = t_max <= t_min, is_bounded = min(size.x, min(size.y, size.z)) >= LEAST_SLOPE;
  const int_v misses = is_empty | ((t_min == 0.0f) & (min(best_low, others) >= t_max));
  const int_v hits = (misses == 0) & is_bounded & (t_min == 0.0f) & (best_high < others) & (best_high < t_max);
  uint slots[VECTOR_WIDTH];
  int missed[VECTOR_WIDTH], hit[VECTOR_WIDTH];
  STORE_V(best_slot, slots);
  STORE_V(misses, missed);
  STORE_V(hits, hit);
  Best best[VECTOR_WIDTH];
  if (has_lane(hits)) find_hits(&leaves, &rays, slots, &at, origin, best);
  for (uint lane = 0; lane < min(ray_count - first, (uint)VECTOR_WIDTH); ++lane) {
    if (missed[lane]) hit_nothing(&best[lane]);
    if (missed[lane] || hit[lane]) write_closest(&rays, first + lane, &best[lane]);
    else meet_all(&leaves, &rays, triangle_count, first + lane, false);
  }
}

// Reads: list_edges, list (host), blocks (pack_leaves), corners (prepare_triangles), ends, lamp_slots (leave_for_light).
// Writes: occluded (for add_light and the host). Work item: rays_per_item rays. Local memory: 0 bytes.
kernel void trace_any(
    uint ray_count,
    uint rays_per_item,
    uint triangle_count,
    uint edge_count,
    global const float4 *restrict origins,     // [ray_count] xyz world space, w t_min, exclusive, not negative
    global const float4 *restrict directions,  // [ray_count] xyz, any length within 2^-60 .. 2^60, w t_max, exclusive
    global const uint *restrict excluded,      // [ray_count] prim_id that the ray does not meet, or NO_HIT
    global const float4 *restrict ends,        // [ray_count] w 1: hits count before the point xyz, and t_max is 1; else 0
    global const uint *restrict lamp_slots,    // [ray_count] hits count before this triangle, where it is met; or NO_HIT
    global const float *restrict list_edges,   // [4 + 6 * edge_count], see TriangleList
    global const float *restrict list,         // [LIST_WORDS * triangle_count]
    global const float *restrict blocks,       // [block_count * BLOCK_WORDS * BLOCK_LANES], see Leaves
    global const float4 *restrict corners,     // [3 * triangle_count] by slot
    global const uint *restrict prims,         // [triangle_count] prim_id of each slot
    global uint *restrict occluded)            // [ray_count] 1: something is hit, else 0
{
  const uint first = get_global_id(0) * rays_per_item;
  if (first >= ray_count) return;
  const Leaves leaves = {blocks, corners, prims};
  const Rays rays = {origins, directions, excluded, ends, lamp_slots, 0, 0, 0, occluded};
  const TriangleList all = {list_edges, list, edge_count, triangle_count};
  // Of paths every other item has no ray to a light: those that there are fill vectors.
  const uint end = min(first + rays_per_item, ray_count);
  uint items[VECTOR_WIDTH], waiting = 0;
  for (uint ray = first; ray < end; ++ray) {
    const bool is_there = origins[ray].w < directions[ray].w || (ends && lamp_slots[ray] != NO_HIT);
    if (is_there) items[waiting++] = ray;
    else occluded[ray] = 0;
    if (waiting == 0 || (waiting < VECTOR_WIDTH && ray + 1 < end)) continue;
    for (uint lane = waiting; lane < VECTOR_WIDTH; ++lane) items[lane] = items[waiting - 1];
    stop_rays(&all, &leaves, &rays, items, waiting);
    waiting = 0;
  }
}
