// Traces arrays of any rays through a scene: the closest hit, any hit, and where rays that leave a hit start.
//
// One work item is one ray, which walks a BVH of NODE_WIDTH children a node (Wald, Benthin, Boulos, 'Getting Rid of
// Packets', 2008: vectors lie over the children of a node and over the triangles of a leaf, not over rays).
//   push root; until the stack is empty, pop a child that is entered before the best hit:
//     inner: push the children whose boxes the ray enters, the nearest last (any hit: in any order)
//     leaf: test its triangles; what float32 leaves open is settled one by one; keep the best
// The best hit is the least t in real arithmetic, equal t the smaller prim_id, whatever the order: intervals of t decide
// where they do not overlap, exact comparison where they do. A node is passed over only where its entry lies beyond the
// upper bound of the best t, or beyond t_max; entries never exceed the t that is reported of any triangle inside
// (intersect_triangle.clh), so that the hierarchy changes nothing. Any hit is closest hit that stops at the first.
// Good at: incoherent rays on processors. Bad at: drivers that limit loops: rays.py refuses them.
// Tests: tests/test_rays.py.

#include "vector.clh"
#include "edge_function.clh"
#include "settled_tests.clh"
#include "intersect_triangle.clh"

// A scene's triangles in the order of a hierarchy's leaves, and the hierarchy.
typedef struct {
  global const float4 *corners;    // [3 * triangle_count] as prepare_triangles.cl leaves them, by slot
  global const uint *prims;        // [triangle_count] prim_id of each slot
  global const uint *children;     // [nodes * NODE_WIDTH] node, or LEAF_BIT | first slot, or EMPTY_CHILD
  global const uint *slot_counts;  // [nodes * NODE_WIDTH] triangles of a leaf
  global const float *node_boxes;  // [nodes * 6 * NODE_WIDTH] min x, y, z, max x, y, z of each child
} Hierarchy;

// The best hit so far.
typedef struct {
  uint slot, prim_id;
  float t, low, high;  // t as reported, and bounds of what it is in real arithmetic
  float edge[3];       // edge functions, float32
} Best;

// Whether a ray that surely hits triangle `slot` does so before the best; intervals alone cannot tell.
static bool comes_before(const Hierarchy *h, Ray ray, uint slot, uint prim_id, const Best *best) {
  const Place at = {0, 0};
  Rungs rungs = {false, false};
  return goes_before(corners_of_slot(h->corners, slot), prim_id, corners_of_slot(h->corners, best->slot), best->prim_id, camera_of(ray), at, &rungs);
}

static bool covers_ray(const Hierarchy *h, Ray ray, uint slot) {
  const Place at = {0, 0};
  Rungs rungs = {false, false};
  return covers(corners_of_slot(h->corners, slot), camera_of(ray), at, &rungs);
}

// Tests triangles first .. end - 1; returns whether one was hit that is better than `best`, which becomes it.
static bool meet_leaf(const Hierarchy *h, Ray ray, uint first, uint end, bool any_hit, Best *best) {
  bool improved = false;
  for (uint k = first; k < end; k += VECTOR_WIDTH) {
    uint slots[VECTOR_WIDTH];
    for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) slots[lane] = min(k + lane, end - 1);
    const TriangleHits found = intersect_triangles(gather_triangles(h->corners, slots), ray);
    if (!has_lane(found.hit | found.open)) continue;
    const int_v wanted = (found.hit | found.open) & (found.t > ray.t_min) & (found.t < ray.t_max) &
                         (found.low <= best->high) & (LANES < (int)(end - k));
    ulong mask = LANE_MASK(wanted);
    if (mask == 0) continue;
    int hit[VECTOR_WIDTH];
    float t[VECTOR_WIDTH], low[VECTOR_WIDTH], high[VECTOR_WIDTH], edge[3][VECTOR_WIDTH];
    STORE_V(found.hit, hit);
    STORE_V(found.t, t);
    STORE_V(found.low, low);
    STORE_V(found.high, high);
    for (uint i = 0; i < 3; ++i) STORE_V(found.edge[i], edge[i]);
    for (; mask != 0; mask &= mask - 1) {
      const int lane = first_lane(mask);
      const uint slot = k + lane, prim_id = h->prims[slot];
      if (prim_id == ray.excluded || low[lane] > best->high) continue;
      if (!hit[lane] && !covers_ray(h, ray, slot)) continue;
      if (best->prim_id != NO_HIT && high[lane] >= best->low && !comes_before(h, ray, slot, prim_id, best)) continue;
      const Best better = {slot, prim_id, t[lane], low[lane], high[lane], {edge[0][lane], edge[1][lane], edge[2][lane]}};
      *best = better;
      improved = true;
      if (any_hit) return true;
    }
  }
  return improved;
}

// Pushes the children of a node that the ray enters before `limit`, the nearest last where `sorted`.
INLINE uint push_entered(const Hierarchy *h, Ray ray, uint node, float limit, bool sorted, ulong *stack, uint top) {
  const uint base = top;
  for (uint k = 0; k < NODE_WIDTH; k += VECTOR_WIDTH) {
    global const float *boxes = h->node_boxes + (size_t)node * 6 * NODE_WIDTH + k;
    const Vec3 low = {LOAD_V(boxes), LOAD_V(boxes + NODE_WIDTH), LOAD_V(boxes + 2 * NODE_WIDTH)};
    const Vec3 high = {LOAD_V(boxes + 3 * NODE_WIDTH), LOAD_V(boxes + 4 * NODE_WIDTH), LOAD_V(boxes + 5 * NODE_WIDTH)};
    const Interval within = slab_interval(low, high, ray);
    const int_v entered = (within.entry <= within.exit) & (within.entry <= limit) & (within.entry < ray.t_max);
    float entry[VECTOR_WIDTH];
    STORE_V(within.entry, entry);
    for (ulong mask = LANE_MASK(entered); mask != 0; mask &= mask - 1) {
      const int lane = first_lane(mask);
      const ulong key = (ulong)as_uint(entry[lane]) << 32 | (node * NODE_WIDTH + k + (uint)lane);
      uint place = top++;
      if (sorted)
        for (; place > base && stack[place - 1] < key; --place) stack[place] = stack[place - 1];
      stack[place] = key;
    }
  }
  return top;
}

// Walks the hierarchy; `any_hit`: stops at the first hit.
INLINE Best trace(const Hierarchy *h, Ray ray, bool any_hit) {
  Best best = {0, NO_HIT, INFINITY, INFINITY, INFINITY, {0.0f, 0.0f, 0.0f}};
  if (!(ray.t_min < ray.t_max)) return best;
  ulong stack[STACK_CAPACITY];
  uint top = push_entered(h, ray, 0, best.high, !any_hit, stack, 0);
  while (top > 0) {
    const ulong key = stack[--top];
    if (as_float((uint)(key >> 32)) > best.high) continue;
    const uint place = (uint)key, child = h->children[place];
    if (!(child & LEAF_BIT)) {
      top = push_entered(h, ray, child, best.high, !any_hit, stack, top);
      continue;
    }
    const uint first = child & ~LEAF_BIT;
    if (meet_leaf(h, ray, first, first + h->slot_counts[place], any_hit, &best) && any_hit) return best;
  }
  return best;
}

// Reads: corners (prepare_triangles), the hierarchy (host). Writes: prims_hit, distances, weights (for offset_origins and
// the host). Work item: one ray. Local memory: 0 bytes.
kernel void trace_closest(
    uint ray_count,
    global const float4 *restrict origins,     // [ray_count] xyz world space, w t_min, exclusive, not negative
    global const float4 *restrict directions,  // [ray_count] xyz, any length within 2^-60 .. 2^60, w t_max, exclusive
    global const uint *restrict excluded,      // [ray_count] prim_id that the ray does not meet, or NO_HIT
    global const float4 *restrict corners,     // [3 * triangle_count] by slot
    global const uint *restrict prims,         // [triangle_count] prim_id of each slot
    global const uint *restrict children,      // [nodes * NODE_WIDTH]
    global const uint *restrict slot_counts,   // [nodes * NODE_WIDTH]
    global const float *restrict node_boxes,   // [nodes * 6 * NODE_WIDTH]
    global const float4 *restrict positions,   // [vertex_count] world space
    global const uint *restrict indices,       // [3 * triangle_count] vertices
    global uint *restrict prims_hit,           // [ray_count] prim_id or NO_HIT
    global float2 *restrict distances,         // [ray_count] t (+inf: no hit), bound of its error
    global float4 *restrict weights)           // [ray_count] barycentrics b0 b1 b2 in the order of indices, w 0
{
  const uint item = get_global_id(0);
  if (item >= ray_count) return;
  const Hierarchy h = {corners, prims, children, slot_counts, node_boxes};
  const Best best = trace(&h, make_ray(origins[item], directions[item], excluded[item]), false);
  prims_hit[item] = best.prim_id;
  if (best.prim_id == NO_HIT) {
    distances[item] = (float2)(INFINITY, 0.0f);
    weights[item] = (float4)(0.0f);
    return;
  }
  distances[item] = (float2)(best.t, max(best.high - best.t, best.t - best.low));
  const float4 w = weigh_corners(best.edge[0], best.edge[1], best.edge[2]);
  global const uint *vertices = indices + 3 * (size_t)best.prim_id;
  const float4 first = corners[3 * (size_t)best.slot];
  // Corners are a turn of the file's order; where vertices coincide either turn names the same points.
  const bool is_second = !same_point(positions[vertices[0]], first) && same_point(positions[vertices[1]], first);
  const bool is_third = !same_point(positions[vertices[0]], first) && !is_second;
  weights[item] = is_second ? w.zxyw : (is_third ? w.yzxw : w);
}

// Reads: corners (prepare_triangles), the hierarchy (host). Writes: occluded. Work item: one ray. Local memory: 0 bytes.
kernel void trace_any(
    uint ray_count,
    global const float4 *restrict origins,     // [ray_count] xyz world space, w t_min, exclusive, not negative
    global const float4 *restrict directions,  // [ray_count] xyz, any length within 2^-60 .. 2^60, w t_max, exclusive
    global const uint *restrict excluded,      // [ray_count] prim_id that the ray does not meet, or NO_HIT
    global const float4 *restrict corners,     // [3 * triangle_count] by slot
    global const uint *restrict prims,         // [triangle_count] prim_id of each slot
    global const uint *restrict children,      // [nodes * NODE_WIDTH]
    global const uint *restrict slot_counts,   // [nodes * NODE_WIDTH]
    global const float *restrict node_boxes,   // [nodes * 6 * NODE_WIDTH]
    global uint *restrict occluded)            // [ray_count] 1: something is hit, else 0
{
  const uint item = get_global_id(0);
  if (item >= ray_count) return;
  const Hierarchy h = {corners, prims, children, slot_counts, node_boxes};
  occluded[item] = trace(&h, make_ray(origins[item], directions[item], excluded[item]), true).prim_id != NO_HIT;
}

// Reads: prims_hit, weights (trace_closest, or the host). Writes: origins (for trace_*). Work item: one hit.
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
  const uint item = get_global_id(0);
  if (item >= ray_count) return;
  global const uint *vertices = indices + 3 * (size_t)prims_left[item];
  const Corners t = {{positions[vertices[0]], positions[vertices[1]], positions[vertices[2]]}};
  const Ray ray = make_ray((float4)(0.0f), directions[item], NO_HIT);
  origins[item] = leave_triangle(t, weights[item], camera_of(ray));
}
