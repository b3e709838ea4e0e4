// Rays that leave hits: where each of them begins (leave_triangle.clh), and where those end that look for light.
//
// A hit of the camera is known by its position, which shade_hits.cl finds in pairs of floats; hits of other rays by
// their weights. A ray that looks for light is aimed from where it begins, not from the hit: it ends where the light is.
// Good at: any hit. Bad at: drivers that limit loops (exact tests of sides). Tests: tests/test_rays.py,
// tests/test_modes_shadow.py, tests/test_modes_path.py.

#include "vector.clh"
#include "edge_function.clh"
#include "settled_tests.clh"
#include "intersect_triangle.clh"
#include "lanes.clh"
#include "leave_triangle.clh"
#include "random_numbers.clh"

INLINE LeftTriangles gather_triangles_to_leave(global const float4 *positions, global const uint *indices, const uint *prims) {
  uint vertices[3][VECTOR_WIDTH];
#pragma unroll
  for (uint k = 0; k < 3; ++k)
    for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) vertices[k][lane] = indices[3 * (size_t)prims[lane] + k];
  float_v unused;
  return triangles_to_leave(gather_points(positions, vertices[0], &unused), gather_points(positions, vertices[1], &unused),
                            gather_points(positions, vertices[2], &unused));
}

// Where rays begin that leave items along `ways`; origins as of leave_triangles.
INLINE void leave_items(LeftTriangles t, Vec3 weights, Vec3 positions, float_v doubt, bool is_first, Vec3 ways, int_v wanted, float4 *origins) {
  const LeftPoints points = is_first ? points_of_positions(positions, doubt) : points_of_weights(&t, weights);
  leave_triangles(t, points, weights, ways, wanted, origins);
}

// Reads: prims_hit, weights (trace_closest, or the host). Writes: origins (for trace_*). Work item: VECTOR_WIDTH hits.
// Local memory: 0 bytes.
kernel void offset_origins(
    uint ray_count,
    global const uint *restrict prims_left,    // [ray_count] prim_id that the ray leaves
    global const float4 *restrict weights,     // [ray_count] b0 b1 b2 of the point
    global const float4 *restrict directions,  // [ray_count] xyz of the ray that leaves
    global const float4 *restrict positions,   // [vertex_count] world space
    global const uint *restrict indices,       // [3 * triangle_count] vertices
    global float4 *restrict origins)           // [ray_count] xyz; w 1, or 0 where the triangle has no side
{
  const uint first = get_global_id(0) * VECTOR_WIDTH;
  if (first >= ray_count) return;
  uint rays[VECTOR_WIDTH], prims[VECTOR_WIDTH];
  list_items(first, ray_count, rays);
  STORE_V(gather_words(prims_left, rays), prims);
  float4 found[VECTOR_WIDTH];
  float_v unused;
  const Vec3 w = gather_points(weights, rays, &unused);
  leave_items(gather_triangles_to_leave(positions, indices, prims), w, w, unused, false,
              gather_points(directions, rays, &unused), LANES >= 0, found);
  for (uint lane = 0; lane < min(ray_count - first, (uint)VECTOR_WIDTH); ++lane) origins[first + lane] = found[lane];
}

// Reads: sources (list_edge_pixels), slot_directions (scatter_rays), items (shade_hits, arrive). Writes: rays for
// trace_closest, side by side. Work item: VECTOR_WIDTH rays. Local memory: 0 bytes.
kernel void leave_hits(
    uint ray_count,
    uint slot_count,                                // slots of an item
    uint is_first,                                  // 1: hits of the camera's samples
    uint seed,                                      // of random numbers
    uint depth,                                     // generation
    global const uint *restrict sources,            // [ray_count] slot of each ray
    global const uint *restrict item_prims,         // [item_count] prim_id that its rays leave
    global const float4 *restrict item_weights,     // [item_count] barycentrics of the point
    global const float4 *restrict item_positions,   // [item_count] world space; w of the first generation: doubt
    global const uint *restrict item_keys,          // [item_count] of random numbers
    global const float4 *restrict slot_directions,  // [slot_count * item_count] xyz; w t_max
    global const float4 *restrict positions,        // [vertex_count] world space
    global const uint *restrict indices,            // [3 * triangle_count] vertices
    global float4 *restrict origins,                // [ray_count] xyz; w t_min 0
    global float4 *restrict directions,             // [ray_count] xyz; w t_max, 0 where the triangle has no side
    global uint *restrict excluded,                 // [ray_count] prim_id that is left
    global uint *restrict ray_keys)                 // [ray_count] of random numbers
{
  const uint first = get_global_id(0) * VECTOR_WIDTH;
  if (first >= ray_count) return;
  uint rays[VECTOR_WIDTH], slots[VECTOR_WIDTH], items[VECTOR_WIDTH], prims[VECTOR_WIDTH], keys[VECTOR_WIDTH];
  list_items(first, ray_count, rays);
  STORE_V(gather_words(sources, rays), slots);
  for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) items[lane] = slots[lane] / slot_count;
  STORE_V(gather_words(item_prims, items), prims);
  float4 found[VECTOR_WIDTH], ways[VECTOR_WIDTH];
  float_v unused, doubt, t_max;
  const Vec3 weights = gather_points(item_weights, items, &unused), at = gather_points(item_positions, items, &doubt);
  const Vec3 way = gather_points(slot_directions, slots, &t_max);
  leave_items(gather_triangles_to_leave(positions, indices, prims), weights, at, doubt, is_first, way, LANES >= 0, found);
  list_points(way, t_max, ways);
  STORE_V(keys_of_rays(gather_words(item_keys, items), seed, depth, false), keys);
  for (uint lane = 0; lane < min(ray_count - first, (uint)VECTOR_WIDTH); ++lane) {
    origins[first + lane] = (float4)(found[lane].xyz, 0.0f);
    directions[first + lane] = (float4)(ways[lane].xyz, found[lane].w > 0.0f ? ways[lane].w : 0.0f);
    excluded[first + lane] = prims[lane];
    ray_keys[first + lane] = keys[lane];
  }
}

// Reads: slot_ends, slot_lamps (aim_at_light), items (shade_hits, arrive). Writes: rays for trace_any, one of each item.
// Work item: VECTOR_WIDTH rays. Local memory: 0 bytes.
kernel void leave_for_light(
    uint ray_count,
    uint is_first,                                  // 1: hits of the camera's samples
    uint seed,                                      // of random numbers
    uint depth,                                     // generation
    global const uint *restrict item_prims,         // [ray_count] prim_id that the ray leaves, or NO_HIT
    global const float4 *restrict item_weights,     // [ray_count] barycentrics of the point
    global const float4 *restrict item_positions,   // [ray_count] world space; w of the first generation: doubt
    global const uint *restrict item_keys,          // [ray_count] of random numbers
    global const float4 *restrict slot_ends,        // [ray_count] w 1: xyz is a point; 0: a direction, (0, 0, 0): no ray
    global const uint *restrict slot_lamps,         // [ray_count] slot of the emissive triangle that it is on, or NO_HIT
    global const float4 *restrict positions,        // [vertex_count] world space
    global const uint *restrict indices,            // [3 * triangle_count] vertices
    global float4 *restrict origins,                // [ray_count] xyz; w t_min 0
    global float4 *restrict directions,             // [ray_count] xyz; w t_max, 0 where there is nothing in between
    global uint *restrict excluded,                 // [ray_count] prim_id that is left
    global float4 *restrict ends,                   // [ray_count] slot_ends
    global uint *restrict lamp_slots,               // [ray_count] slot_lamps
    global uint *restrict ray_keys)                 // [ray_count] of random numbers
{
  const uint first = get_global_id(0) * VECTOR_WIDTH;
  if (first >= ray_count) return;
  uint items[VECTOR_WIDTH], prims[VECTOR_WIDTH], keys[VECTOR_WIDTH], lamps[VECTOR_WIDTH];
  list_items(first, ray_count, items);
  for (uint lane = 0; lane < VECTOR_WIDTH; ++lane)
    prims[lane] = item_prims[items[lane]] == NO_HIT ? 0 : item_prims[items[lane]];
  float4 found[VECTOR_WIDTH], ended[VECTOR_WIDTH];
  float_v unused, doubt, to_point;
  const Vec3 weights = gather_points(item_weights, items, &unused), at = gather_points(item_positions, items, &doubt);
  const Vec3 end = gather_points(slot_ends, items, &to_point);
  const Vec3 way = select3(to_point > 0.0f, subtract(end, at), end);
  const int_v wanted = (way.x != 0.0f) | (way.y != 0.0f) | (way.z != 0.0f);
  leave_items(gather_triangles_to_leave(positions, indices, prims), weights, at, doubt, is_first, way, wanted, found);
  list_points(end, to_point, ended);
  STORE_V(gather_words(slot_lamps, items), lamps);
  STORE_V(keys_of_rays(gather_words(item_keys, items), seed, depth, true), keys);
  for (uint lane = 0; lane < min(ray_count - first, (uint)VECTOR_WIDTH); ++lane) {
    const bool is_point = ended[lane].w > 0.0f;
    const float4 aim = is_point ? ended[lane] - found[lane] : ended[lane];
    const float size = max(fabs(aim.x), max(fabs(aim.y), fabs(aim.z)));
    const bool goes = found[lane].w > 0.0f && size >= LEAST_WAY && size <= LARGEST_WAY;
    origins[first + lane] = (float4)(found[lane].xyz, 0.0f);
    directions[first + lane] = (float4)(aim.xyz, goes ? (is_point ? 1.0f : INFINITY) : 0.0f);
    excluded[first + lane] = prims[lane];
    ends[first + lane] = ended[lane];
    lamp_slots[first + lane] = lamps[lane];
    ray_keys[first + lane] = keys[lane];
  }
}
