// Traces arrays of any rays through a scene: the closest hit, and any hit.
//
// One work item is rays_per_item rays, which walk the scene's acceleration structure and test the leaves that they come to:
//   a BVH (walk_hierarchy.clh) where triangles lie in the order of its leaves: LEAF_ORDER
//   a uniform grid (walk_grid.clh) elsewhere
// What is hit is decided by the leaves' test alone (leaf_hits.clh), so both give the same bits.
// Any hit is closest hit that stops at the first.
// A ray that looks for light may end at a point, where a punctual light is, or on a triangle that shines. Before a point
// lies what parts it from where the ray starts; before a triangle what the ray meets first, in real arithmetic both.
// Good at: incoherent rays on processors. Bad at: drivers that limit loops: rays.py refuses them.
// Tests: tests/test_rays.py, tests/test_ray_grid.py.

#include "vector.clh"
#include "edge_function.clh"
#include "settled_tests.clh"
#include "intersect_triangle.clh"
#include "leaf_hits.clh"
#include "ray_batch.clh"
#if LEAF_ORDER
#include "walk_hierarchy.clh"
#else
#include "grid.clh"
#include "walk_grid.clh"
#endif

// Reads: corners (prepare_triangles), the hierarchy or the grid's cells (host), blocks (pack_leaves). Writes: prims_hit,
// distances, weights (for arrive, offset_origins and the host). Work item: rays_per_item rays. Local memory: 0 bytes.
kernel void trace_closest(
    uint ray_count,
    uint rays_per_item,
    global const float4 *restrict origins,     // [ray_count] xyz world space, w t_min, exclusive, not negative
    global const float4 *restrict directions,  // [ray_count] xyz, any length within 2^-60 .. 2^60, w t_max, exclusive
    global const uint *restrict excluded,      // [ray_count] prim_id that the ray does not meet, or NO_HIT
    global const float *restrict blocks,       // [block_count * BLOCK_WORDS * BLOCK_LANES], see Leaves
    global const float4 *restrict corners,     // [3 * triangle_count] by slot
    global const uint *restrict prims,         // [places] prim_id of each place in the leaves
#if LEAF_ORDER
    global const float *restrict nodes,        // [nodes * NODE_WORDS], see walk_hierarchy.clh
#else
    Grid grid,
    float farthest,                            // sum of an origin's distances from the grid's corner for a walk
    float longest,                             // side of a triangle's box
    global const uint2 *restrict cells,        // [cell_count] first block and triangles of each
#endif
#if MASKED
    global const uint *restrict indices,       // [3 * triangle_count] vertices
    global const uint *restrict material_ids,  // [triangle_count]
    global const Material *restrict materials, // [material_count]
    global const Texture *restrict textures,   // [texture_count]
    global const uchar4 *restrict texels,      // of all textures
    global const float *restrict srgb_to_linear, // [512] see Surfaces
    global const float2 *restrict uv,          // [vertex_count] or unused
    global const float2 *restrict uv1,         // [vertex_count] or unused
    global const float4 *restrict colors,      // [vertex_count] linear, or unused
#endif
#if PANES_ARE_DRAWN
    uint path,                                 // its number in the sample
    global const uint *restrict ray_keys,      // [ray_count] of random numbers
#endif
    global uint *restrict prims_hit,           // [ray_count] prim_id or NO_HIT
    global float2 *restrict distances,         // [ray_count] t (+inf: no hit), bound of its error
    global float4 *restrict weights)           // [ray_count] barycentrics b0 b1 b2 in the order of indices, w 0
{
  const uint first = get_global_id(0) * rays_per_item;
  if (first >= ray_count) return;
  const Accelerator a = {
      {blocks, corners, prims
#if MASKED
       , indices, {material_ids, materials, textures, texels, srgb_to_linear, uv, uv1, colors}
#endif
      },
#if LEAF_ORDER
      nodes
#else
      grid, cells, farthest, longest
#endif
  };
  const Rays rays = {origins, directions, excluded, 0, 0,
#if PANES_ARE_DRAWN
                     ray_keys, path,
#endif
                     prims_hit, distances, weights, 0};
  trace_rays(&a, &rays, first, min(first + rays_per_item, ray_count), false);
}

// Reads: corners (prepare_triangles), the hierarchy or the grid's cells (host), blocks (pack_leaves), ends, lamp_slots
// (leave_for_light). Writes: occluded (for add_light and the host). Work item: rays_per_item rays. Local memory: 0 bytes.
kernel void trace_any(
    uint ray_count,
    uint rays_per_item,
    global const float4 *restrict origins,     // [ray_count] xyz world space, w t_min, exclusive, not negative
    global const float4 *restrict directions,  // [ray_count] xyz, any length within 2^-60 .. 2^60, w t_max, exclusive
    global const uint *restrict excluded,      // [ray_count] prim_id that the ray does not meet, or NO_HIT
    global const float4 *restrict ends,        // [ray_count] w 1: hits count before the point xyz, and t_max is 1; else 0
    global const uint *restrict lamp_slots,    // [ray_count] hits count before this triangle, where it is met; or NO_HIT
    global const float *restrict blocks,       // [block_count * BLOCK_WORDS * BLOCK_LANES], see Leaves
    global const float4 *restrict corners,     // [3 * triangle_count] by slot
    global const uint *restrict prims,         // [places] prim_id of each place in the leaves
#if LEAF_ORDER
    global const float *restrict nodes,        // [nodes * NODE_WORDS], see walk_hierarchy.clh
#else
    Grid grid,
    float farthest,                            // sum of an origin's distances from the grid's corner for a walk
    float longest,                             // side of a triangle's box
    global const uint2 *restrict cells,        // [cell_count] first block and triangles of each
#endif
#if MASKED
    global const uint *restrict indices,       // [3 * triangle_count] vertices
    global const uint *restrict material_ids,  // [triangle_count]
    global const Material *restrict materials, // [material_count]
    global const Texture *restrict textures,   // [texture_count]
    global const uchar4 *restrict texels,      // of all textures
    global const float *restrict srgb_to_linear, // [512] see Surfaces
    global const float2 *restrict uv,          // [vertex_count] or unused
    global const float2 *restrict uv1,         // [vertex_count] or unused
    global const float4 *restrict colors,      // [vertex_count] linear, or unused
#endif
#if PANES_ARE_DRAWN
    uint path,                                 // its number in the sample
    global const uint *restrict ray_keys,      // [ray_count] of random numbers
#endif
    global uint *restrict occluded)            // [ray_count] 1: something is hit, else 0
{
  const uint first = get_global_id(0) * rays_per_item;
  if (first >= ray_count) return;
  const Accelerator a = {
      {blocks, corners, prims
#if MASKED
       , indices, {material_ids, materials, textures, texels, srgb_to_linear, uv, uv1, colors}
#endif
      },
#if LEAF_ORDER
      nodes
#else
      grid, cells, farthest, longest
#endif
  };
  const Rays rays = {origins, directions, excluded, ends, lamp_slots,
#if PANES_ARE_DRAWN
                     ray_keys, path,
#endif
                     0, 0, 0, occluded};
  trace_rays(&a, &rays, first, min(first + rays_per_item, ray_count), true);
}
