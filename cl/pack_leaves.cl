// Packs the triangles of an acceleration structure's leaves in blocks, as rays read them: see Leaves in leaf_hits.clh.
//
// Tests: tests/test_rays.py, tests/test_ray_grid.py.

#include "vector.clh"
#include "edge_function.clh"
#include "settled_tests.clh"
#include "intersect_triangle.clh"
#include "leaf_hits.clh"

// Reads: corners (prepare_triangles), positions, indices, prims, block_places, block_counts (host, or
// order_cell_triangles). Writes: blocks (for trace_rays.cl, trace_list.cl). Work item: one block. Local memory: 0 bytes.
kernel void pack_leaves(
    uint block_count,
    global const float4 *restrict corners,     // [3 * triangle_count] by slot
    global const float4 *restrict positions,   // [vertex_count] world space
    global const uint *restrict indices,       // [3 * triangle_count] vertices
    global const uint *restrict prims,         // [places] prim_id of each place in the leaves
    global const uint *restrict block_places,  // [block_count] where in prims a block's first triangle stands
    global const uint *restrict block_counts,  // [block_count] its triangles: the last of them fills what is left
    global float *restrict blocks)             // [block_count * BLOCK_WORDS * BLOCK_LANES]
{
  const uint block = get_global_id(0);
  if (block >= block_count) return;
  global float *own = blocks + (size_t)block * (BLOCK_WORDS * BLOCK_LANES);
  for (uint lane = 0; lane < BLOCK_LANES; ++lane) {
    const uint place = block_places[block] + min(lane, block_counts[block] - 1);
    const uint prim_id = prims[place];
    global const float4 *from = corners + 3 * (size_t)slot_of(place, prim_id);
    for (uint k = 0; k < 3; ++k) {
      own[(3 * k) * BLOCK_LANES + lane] = from[k].x;
      own[(3 * k + 1) * BLOCK_LANES + lane] = from[k].y;
      own[(3 * k + 2) * BLOCK_LANES + lane] = from[k].z;
    }
    // Where vertices coincide either turn names the same points.
    global const uint *vertices = indices + 3 * (size_t)prim_id;
    const uint turn =
        same_point(positions[vertices[0]], from[0]) ? 0 : (same_point(positions[vertices[1]], from[0]) ? 1 : 2);
    ((global uint *)own)[(BLOCK_WORDS - 1) * BLOCK_LANES + lane] = turn << TURN_LOG2 | prim_id;
  }
}
