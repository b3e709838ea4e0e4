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

#define MASKED (ALPHA_MASK || ALPHA_BLEND)
#if MASKED
#include "surface.clh"
#endif

// A scene's triangles in the order of a hierarchy's leaves, and the hierarchy.
//
// For tests against rays leaves lie in blocks of BLOCK_LANES triangles as structures of arrays, BLOCK_WORDS numbers each:
// one load a component, where corners that lie apart take dozens of permutations.
typedef struct {
  global const float *blocks;      // [block_count * BLOCK_WORDS * BLOCK_LANES] x y z of the corners, then of the normal
  global const uint *block_slots;  // [block_count] slot of a block's first triangle
  global const float4 *corners;    // [3 * triangle_count] as prepare_triangles.cl leaves them, by slot
  global const uint *prims;        // [triangle_count] prim_id of each slot
  global const uint *children;     // [nodes * NODE_WIDTH] node; or LEAF_BIT | (triangles - 1) << LEAF_SLOT_LOG2 | first block
  global const float *node_boxes;  // [nodes * 6 * NODE_WIDTH] min x, y, z, max x, y, z of each child
#if MASKED
  global const float4 *positions;  // [vertex_count] world space
  global const uint *indices;      // [3 * triangle_count]
  Surfaces surfaces;
#endif
} Hierarchy;

// The best hit so far.
typedef struct {
  uint slot, prim_id;
  float t, low, high;  // t as reported, and bounds of what it is in real arithmetic
  float edge[3];       // edge functions, float32
} Best;

// Whether a ray that surely hits triangle `slot` does so before the best; intervals alone cannot tell.
__attribute__((noinline)) static bool comes_before(const Hierarchy *h, Ray ray, uint slot, uint prim_id, const Best *best) {
  const Place at = {0, 0};
  Rungs rungs = {false, false};
  return goes_before(corners_of_slot(h->corners, slot), prim_id, corners_of_slot(h->corners, best->slot), best->prim_id, camera_of(ray), at, &rungs);
}

// Barycentrics in the order of the file. Corners are a turn of it; where vertices coincide either turn names the same
// points.
static float4 weigh_vertices_of(float4 first_corner, global const float4 *positions, global const uint *vertices, const float *edge) {
  const float4 w = weigh_corners(edge[0], edge[1], edge[2]);
  if (same_point(positions[vertices[0]], first_corner)) return w;
  return same_point(positions[vertices[1]], first_corner) ? w.zxyw : w.yzxw;
}

#if MASKED
// Whether a surface is not there at a hit: where it is masked; for light (`any_hit`) also where it blends and is thin.
static bool lets_through(const Hierarchy *h, const Best *hit, bool any_hit) {
  const Material material = h->surfaces.materials[h->surfaces.material_ids[hit->prim_id]];
  const uint flags = material.flags & ((ALPHA_MASK ? MATERIAL_MASK : 0u) | (ALPHA_BLEND && any_hit ? MATERIAL_BLEND : 0u));
  if (flags == 0) return false;
  global const uint *v = h->indices + 3 * (size_t)hit->prim_id;
  const float4 w = weigh_vertices_of(h->corners[3 * (size_t)hit->slot], h->positions, v, hit->edge);
  const SurfacePoint at = {hit->prim_id, v[0], v[1], v[2], w.x, w.y, w.z};
  return base_color(h->surfaces, material, at).w < (flags & MATERIAL_MASK ? material.alpha_cutoff : THIN_ALPHA);
}
#endif

__attribute__((noinline)) static bool covers_ray(const Hierarchy *h, Ray ray, uint slot) {
  const Place at = {0, 0};
  Rungs rungs = {false, false};
  return covers(corners_of_slot(h->corners, slot), camera_of(ray), at, &rungs);
}

// One component of VECTOR_WIDTH triangles from lane `first` of block `low` on; 16 take the eight of block `high` as well.
INLINE float_v load_component(global const float *low, global const float *high, uint word, uint first) {
#if VECTOR_WIDTH == 16
  return (float16)(vload8(word, low), vload8(word, high));
#elif VECTOR_WIDTH == 8
  return vload8(word, low);
#else
  return low[word * BLOCK_LANES + first];
#endif
}

INLINE Triangles load_triangles(const Hierarchy *h, uint block, uint last, uint first) {
  global const float *low = h->blocks + (size_t)block * (BLOCK_WORDS * BLOCK_LANES);
  global const float *high = h->blocks + (size_t)last * (BLOCK_WORDS * BLOCK_LANES);
  Triangles t;
  Vec3 *parts[3] = {&t.p0, &t.p1, &t.p2};
#pragma unroll
  for (uint k = 0; k < 3; ++k) {
    parts[k]->x = load_component(low, high, 3 * k, first);
    parts[k]->y = load_component(low, high, 3 * k + 1, first);
    parts[k]->z = load_component(low, high, 3 * k + 2, first);
  }
  t.normal = cross3(subtract(t.p1, t.p0), subtract(t.p2, t.p0));
  return t;
}

// Tests the `count` triangles of a leaf; returns whether one was hit that is better than `best`, which becomes it.
static bool meet_leaf(const Hierarchy *h, Ray ray, uint leaf_block, uint count, bool any_hit, Best *best) {
  bool improved = false;
  for (uint k = 0; k < count; k += VECTOR_WIDTH) {
    const uint block = leaf_block + k / BLOCK_LANES, last = leaf_block + (count - 1) / BLOCK_LANES;
    const TriangleHits found = intersect_triangles(load_triangles(h, block, last, k % BLOCK_LANES), ray);
    if (!has_lane(found.hit | found.open)) continue;
    const int_v wanted = (found.hit | found.open) & (found.t > ray.t_min) & (found.t < ray.t_max) &
                         (found.low <= best->high) & (LANES < (int)(count - k));
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
      const uint slot = h->block_slots[block + lane / BLOCK_LANES] + (k + lane) % BLOCK_LANES, prim_id = h->prims[slot];
      if (prim_id == ray.excluded || low[lane] > best->high) continue;
      if (!hit[lane] && !covers_ray(h, ray, slot)) continue;
      if (best->prim_id != NO_HIT && high[lane] >= best->low && !comes_before(h, ray, slot, prim_id, best)) continue;
      const Best better = {slot, prim_id, t[lane], low[lane], high[lane], {edge[0][lane], edge[1][lane], edge[2][lane]}};
#if MASKED
      if (lets_through(h, &better, any_hit)) continue;
#endif
      *best = better;
      improved = true;
      if (any_hit) return true;
    }
  }
  return improved;
}

// Asks for the corners of a child that is a leaf: rays that go anywhere find them in no near cache.
INLINE void expect_leaf(const Hierarchy *h, uint child) {
#if PREFETCH
  if (!(child & LEAF_BIT)) return;
  const size_t address = (size_t)(h->blocks + (size_t)(child & LEAF_SLOT) * (BLOCK_WORDS * BLOCK_LANES));
  for (size_t line = 0; line < 4 * BLOCK_WORDS * BLOCK_LANES; line += 64) __builtin_prefetch((const void *)(address + line));
#endif
}

// A child on the stack: where the ray enters it, as bits that sort like the number, above what it is.
INLINE ulong stack_key(const Hierarchy *h, uint place, float entry) {
  const uint child = h->children[place];
  expect_leaf(h, child);
  return (ulong)as_uint(entry) << 32 | child;
}

// Pushes the children of a node that the ray enters before `limit`, the nearest last where `sorted`. One and two
// children, the most frequent numbers, have ways of their own.
INLINE uint push_entered(const Hierarchy *h, Ray ray, uint node, float limit, bool sorted, ulong *stack, uint top) {
  const uint base = top;
  const uint x = ray.inverse.x < 0.0f ? 3 * NODE_WIDTH : 0, y = ray.inverse.y < 0.0f ? 3 * NODE_WIDTH : 0;
  const uint z = ray.inverse.z < 0.0f ? 3 * NODE_WIDTH : 0;
  for (uint k = 0; k < NODE_WIDTH; k += VECTOR_WIDTH) {
    global const float *boxes = h->node_boxes + (size_t)node * 6 * NODE_WIDTH + k;
    const Vec3 near = {LOAD_V(boxes + x), LOAD_V(boxes + NODE_WIDTH + y), LOAD_V(boxes + 2 * NODE_WIDTH + z)};
    const Vec3 far = {
        LOAD_V(boxes + 3 * NODE_WIDTH - x), LOAD_V(boxes + 4 * NODE_WIDTH - y), LOAD_V(boxes + 5 * NODE_WIDTH - z)};
    const Interval within = slab_interval_between(near, far, ray);
    const int_v entered = (within.entry <= within.exit) & (within.entry <= limit) & (within.entry < ray.t_max);
    float entry[VECTOR_WIDTH];
    STORE_V(within.entry, entry);
    ulong mask = LANE_MASK(entered);
    if (mask == 0) continue;
    const uint place = node * NODE_WIDTH + k;
    const int first = first_lane(mask);
    ulong key = stack_key(h, place + first, entry[first]);
    mask &= mask - 1;
    const ulong more = mask & (mask - 1);
    if (more == 0 && (!sorted || top == base)) {
      if (mask != 0) {
        const int second = first_lane(mask);
        const ulong other = stack_key(h, place + second, entry[second]);
        stack[top++] = max(key, other);
        key = min(key, other);
      }
      stack[top++] = key;
      continue;
    }
    while (true) {
      uint at = top++;
      if (sorted)
        for (; at > base && stack[at - 1] < key; --at) stack[at] = stack[at - 1];
      stack[at] = key;
      if (mask == 0) break;
      const int lane = first_lane(mask);
      key = stack_key(h, place + lane, entry[lane]);
      mask &= mask - 1;
    }
  }
  return top;
}

// Walks the hierarchy; `any_hit`: stops at the first hit.
INLINE Best trace(const Hierarchy *h, Ray ray, bool any_hit) {
  Best best = {0, NO_HIT, INFINITY, INFINITY, INFINITY, {0.0f, 0.0f, 0.0f}};
  if (!(ray.t_min < ray.t_max)) return best;
  ulong stack[STACK_CAPACITY];
  uint top = 0, child = 0;
  while (true) {
    if (!(child & LEAF_BIT)) {
      top = push_entered(h, ray, child, best.high, !any_hit, stack, top);
    } else {
      const uint first = child & LEAF_SLOT, count = (child >> LEAF_SLOT_LOG2 & (MAX_LEAF_COUNT - 1)) + 1;
      if (meet_leaf(h, ray, first, count, any_hit, &best) && any_hit) return best;
    }
    ulong key;
    do {
      if (top == 0) return best;
      key = stack[--top];
    } while (as_float((uint)(key >> 32)) > best.high);
    child = (uint)key;
  }
}

// Reads: corners (prepare_triangles), the hierarchy (host). Writes: prims_hit, distances, weights (for offset_origins and
// the host). Work item: one ray. Local memory: 0 bytes.
kernel void trace_closest(
    uint ray_count,
    global const float4 *restrict origins,     // [ray_count] xyz world space, w t_min, exclusive, not negative
    global const float4 *restrict directions,  // [ray_count] xyz, any length within 2^-60 .. 2^60, w t_max, exclusive
    global const uint *restrict excluded,      // [ray_count] prim_id that the ray does not meet, or NO_HIT
    global const float *restrict blocks,       // [block_count * BLOCK_WORDS * BLOCK_LANES], see Hierarchy
    global const uint *restrict block_slots,   // [block_count]
    global const float4 *restrict corners,     // [3 * triangle_count] by slot
    global const uint *restrict prims,         // [triangle_count] prim_id of each slot
    global const uint *restrict children,      // [nodes * NODE_WIDTH]
    global const float *restrict node_boxes,   // [nodes * 6 * NODE_WIDTH]
    global const float4 *restrict positions,   // [vertex_count] world space
    global const uint *restrict indices,       // [3 * triangle_count] vertices
#if MASKED
    global const uint *restrict material_ids,  // [triangle_count]
    global const Material *restrict materials, // [material_count]
    global const Texture *restrict textures,   // [texture_count]
    global const uchar4 *restrict texels,      // of all textures
    global const float *restrict srgb_to_linear, // [256]
    global const float2 *restrict uv,          // [vertex_count] or unused
    global const float2 *restrict uv1,         // [vertex_count] or unused
    global const float4 *restrict colors,      // [vertex_count] linear, or unused
#endif
    global uint *restrict prims_hit,           // [ray_count] prim_id or NO_HIT
    global float2 *restrict distances,         // [ray_count] t (+inf: no hit), bound of its error
    global float4 *restrict weights)           // [ray_count] barycentrics b0 b1 b2 in the order of indices, w 0
{
  const uint item = get_global_id(0);
  if (item >= ray_count) return;
  const Hierarchy h = {blocks, block_slots, corners, prims, children, node_boxes
#if MASKED
                       , positions, indices, {material_ids, materials, textures, texels, srgb_to_linear, uv, uv1, colors}
#endif
  };
  const Best best = trace(&h, make_ray(origins[item], directions[item], excluded[item]), false);
  prims_hit[item] = best.prim_id;
  if (best.prim_id == NO_HIT) {
    distances[item] = (float2)(INFINITY, 0.0f);
    weights[item] = (float4)(0.0f);
    return;
  }
  distances[item] = (float2)(best.t, max(best.high - best.t, best.t - best.low));
  global const uint *vertices = indices + 3 * (size_t)best.prim_id;
  weights[item] = weigh_vertices_of(corners[3 * (size_t)best.slot], positions, vertices, best.edge);
}

// Reads: corners (prepare_triangles), the hierarchy (host). Writes: occluded. Work item: one ray. Local memory: 0 bytes.
kernel void trace_any(
    uint ray_count,
    global const float4 *restrict origins,     // [ray_count] xyz world space, w t_min, exclusive, not negative
    global const float4 *restrict directions,  // [ray_count] xyz, any length within 2^-60 .. 2^60, w t_max, exclusive
    global const uint *restrict excluded,      // [ray_count] prim_id that the ray does not meet, or NO_HIT
    global const float *restrict blocks,       // [block_count * BLOCK_WORDS * BLOCK_LANES], see Hierarchy
    global const uint *restrict block_slots,   // [block_count]
    global const float4 *restrict corners,     // [3 * triangle_count] by slot
    global const uint *restrict prims,         // [triangle_count] prim_id of each slot
    global const uint *restrict children,      // [nodes * NODE_WIDTH]
    global const float *restrict node_boxes,   // [nodes * 6 * NODE_WIDTH]
#if MASKED
    global const float4 *restrict positions,   // [vertex_count] world space
    global const uint *restrict indices,       // [3 * triangle_count] vertices
#endif
#if MASKED
    global const uint *restrict material_ids,  // [triangle_count]
    global const Material *restrict materials, // [material_count]
    global const Texture *restrict textures,   // [texture_count]
    global const uchar4 *restrict texels,      // of all textures
    global const float *restrict srgb_to_linear, // [256]
    global const float2 *restrict uv,          // [vertex_count] or unused
    global const float2 *restrict uv1,         // [vertex_count] or unused
    global const float4 *restrict colors,      // [vertex_count] linear, or unused
#endif
    global uint *restrict occluded)            // [ray_count] 1: something is hit, else 0
{
  const uint item = get_global_id(0);
  if (item >= ray_count) return;
  const Hierarchy h = {blocks, block_slots, corners, prims, children, node_boxes
#if MASKED
                       , positions, indices, {material_ids, materials, textures, texels, srgb_to_linear, uv, uv1, colors}
#endif
  };
  occluded[item] = trace(&h, make_ray(origins[item], directions[item], excluded[item]), true).prim_id != NO_HIT;
}

// Reads: corners (prepare_triangles), block_slots, block_counts (host). Writes: blocks (for trace_*). Work item: one block.
// Local memory: 0 bytes.
kernel void pack_leaves(
    uint block_count,
    global const float4 *restrict corners,     // [3 * triangle_count] by slot
    global const uint *restrict block_slots,   // [block_count] slot of a block's first triangle
    global const uint *restrict block_counts,  // [block_count] its triangles: the last of them fills what is left
    global float *restrict blocks)             // [block_count * BLOCK_WORDS * BLOCK_LANES]
{
  const uint block = get_global_id(0);
  if (block >= block_count) return;
  global float *own = blocks + (size_t)block * (BLOCK_WORDS * BLOCK_LANES);
  for (uint lane = 0; lane < BLOCK_LANES; ++lane) {
    global const float4 *from = corners + 3 * (size_t)(block_slots[block] + min(lane, block_counts[block] - 1));
    for (uint k = 0; k < 3; ++k) {
      own[(3 * k) * BLOCK_LANES + lane] = from[k].x;
      own[(3 * k + 1) * BLOCK_LANES + lane] = from[k].y;
      own[(3 * k + 2) * BLOCK_LANES + lane] = from[k].z;
    }
  }
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

// Reads: sources (list_edge_pixels), slot_directions (aim_at_light, scatter_rays), item_prims, item_weights. Writes: rays
// for trace_*: where those that leave items begin, side by side. Work item: one ray. Local memory: 0 bytes.
kernel void leave_hits(
    uint ray_count,
    uint slot_count,                                // slots of an item
    global const uint *restrict sources,            // [ray_count] slot of each ray
    global const uint *restrict item_prims,         // [item_count] prim_id that its rays leave
    global const float4 *restrict item_weights,     // [item_count] barycentrics of the point
    global const float4 *restrict slot_directions,  // [slot_count * item_count] xyz; w t_max
    global const float4 *restrict positions,        // [vertex_count] world space
    global const uint *restrict indices,            // [3 * triangle_count] vertices
    global float4 *restrict origins,                // [ray_count] xyz; w t_min 0
    global float4 *restrict directions,             // [ray_count] xyz; w t_max, 0 where the triangle has no side
    global uint *restrict excluded)                 // [ray_count] prim_id that is left
{
  const uint ray = get_global_id(0);
  if (ray >= ray_count) return;
  const uint source = sources[ray], item = source / slot_count, prim_id = item_prims[item];
  global const uint *vertices = indices + 3 * (size_t)prim_id;
  const Corners t = {{positions[vertices[0]], positions[vertices[1]], positions[vertices[2]]}};
  const float4 direction = slot_directions[source], weights = item_weights[item];
  const float4 origin = leave_triangle(t, (float4)(weights.xyz, 0.0f), camera_of(make_ray((float4)(0.0f), direction, NO_HIT)));
  origins[ray] = (float4)(origin.xyz, 0.0f);
  directions[ray] = (float4)(direction.xyz, origin.w > 0.0f ? direction.w : 0.0f);
  excluded[ray] = prim_id;
}
