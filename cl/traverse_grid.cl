// Rays through a uniform grid, one at a time: the branching ray caster.
//
// Purcell et al., 'Ray Tracing on Programmable Graphics Hardware', sections 3.1 and 3.2: eye ray generation, grid
// traversal and intersection in a single pass, on an architecture that can branch.
//   for each ray: enter the grid; in each cell that it pierces, near to far:
//     test the cell's triangles
//     stop where what was hit is nearer than anything in a cell that is still to come
// A hit outside the cell is kept: it is compared with the cells' exits, not rejected and found again as in the paper.
// Good at: scenes of even detail, images that few triangles decide. Bad at: packets do the same work once for many rays.
// Tests: tests/test_grid.py.

#include "vector.clh"
#include "counters.clh"
#include "edge_function.clh"
#if ALPHA_MASK
#include "surface.clh"
#endif
#define LISTS_IN_ORDER 0
#include "triangle_batch.clh"
#include "sample_blocks.clh"
#include "sample_memory.clh"
#include "ray_sample.clh"
#include "grid.clh"

// Reads: records (record_triangles), cell_begin and references (build_grid.cl), nearness and visible_prims of loose
// triangles (rasterize_tiles). Writes: nearness, visible_prims (for shade_hits). Work item: a square of RAY_BLOCK rays a
// side, one after the other. Local memory: 0 bytes.
kernel void traverse_grid(
    View view,
    Grid grid,
    uint block_columns,                          // squares side by side
    uint block_count,
    uint pixel_count,                            // of the band
    float late,                                  // orthographic: how much later than a ray's t nothing comes
    uint layer,                                  // 0, or more: front_* say what lies in front
    global const float *restrict front_nearness, // [band height * width] of the layer in front
    global const uint *restrict front_prims,     // [band height * width] its prim_id or NO_HIT
#if ALPHA_MASK
    global const uint *restrict indices,         // [3 * triangle_count] vertices of the attributes
    global const uint *restrict material_ids,    // [triangle_count]
    global const Material *restrict materials,   // [material_count]
    global const Texture *restrict textures,     // [texture_count]
    global const uchar4 *restrict texels,        // of all textures
    global const float *restrict srgb_to_linear, // [512] see Surfaces
    global const float2 *restrict uv,            // [vertex_count]
    global const float2 *restrict uv1,           // [vertex_count]
    global const float4 *restrict colors,        // [vertex_count] linear
#endif
#if FILTERED
    uint contender_capacity,                     // entries of the list
    global uint *restrict contender_state,       // [CONTENDER_WORDS] first word: contenders found
    global uint2 *restrict contenders,           // [contender_capacity] pixel of the band, prim_id
    global const float4 *restrict corners,       // [3 * triangle_count]
    global const float4 *restrict positions,     // [vertex_count] world space, as given
    global const uint *restrict prim_vertices,   // [3 * triangle_count] vertices
#endif
    global const uint *restrict records,         // [padded triangle_count * RECORD_WORDS]
    global const uint *restrict cell_begin,      // [cell_count + 1] where each cell's list begins
    global const uint *restrict references,      // [reference_count] prim_ids
#if TRACE
    global const uint *restrict trace_begin,     // [pixel_count] where each ray's words begin
    global uint *restrict trace,                 // cells, and TRACE_* | prim_id, in the order of reading; or 0
    global uint *restrict trace_counts,          // [pixel_count] words of each ray; 0 where it misses the grid
#endif
#if COUNTERS
    global ulong *restrict work,                 // [block_count * WORK_COUNTER_COUNT] added to
    global uint *restrict cost,                  // [3 * pixel_count] evaluations, setups, steps of each sample, added to
#endif
    global float *restrict nearness,             // [band height * width]
    global uint *restrict visible_prims)         // [band height * width] prim_id or NO_HIT
{
  const uint item = get_global_id(0);
  if (item >= block_count) return;
  RayScene s;
  s.view = view;
  s.pixel_count = pixel_count;
  s.records = records;
  s.layer = layer;
  s.front_nearness = front_nearness;
  s.front_prims = front_prims;
#if ALPHA_MASK
  const Surfaces surfaces = {material_ids, materials, textures, texels, srgb_to_linear, uv, uv1, colors};
  s.surfaces = surfaces;
  s.indices = indices;
#endif
#if FILTERED
  s.corners = corners;
  s.positions = positions;
  s.prim_vertices = prim_vertices;
  s.contender_capacity = contender_capacity;
  s.contender_state = contender_state;
  s.contenders = contenders;
#endif
#if COUNTERS
  Work own = {0, 0, 0, 0, 0, 0, 0, 0, 0};
#endif
  for (uint k = 0; k < RAY_BLOCK * RAY_BLOCK; ++k) {
    const uint column = item % block_columns * RAY_BLOCK + k % RAY_BLOCK;
    const uint pixel = (item / block_columns * RAY_BLOCK + k / RAY_BLOCK) * view.width + column;
    if (column >= view.width || pixel >= pixel_count) continue;
    RaySample ray = load_ray_sample(&s, pixel, nearness, visible_prims);
    GridWalk walk = ray_of_sample(view, grid, ray.x, ray.y);
    if (!enter_grid(grid, &walk)) continue;
#if MAILBOX
    uint mailbox[MAILBOX];  // the triangle that was tested last of those that share a box
    for (uint box = 0; box < MAILBOX; ++box) mailbox[box] = NO_HIT;
#endif
#if COUNTERS
    uint steps = 0;
#endif
#if TRACE
    uint written = 0;
    global uint *words = trace == 0 ? 0 : trace + trace_begin[pixel];
#endif
    do {
      const uint cell = cell_of(grid, walk.x, walk.y, walk.z);
#if TRACE
      if (words != 0) words[written] = cell;
      ++written;
#endif
      const uint end = cell_begin[cell + 1];
      for (uint place = cell_begin[cell]; place < end; ++place) {
        const uint prim_id = references[place];
#if MAILBOX
        if (mailbox[prim_id % MAILBOX] == prim_id) continue;
        mailbox[prim_id % MAILBOX] = prim_id;
#endif
        meet_triangle(&s, prim_id, &ray);
#if TRACE
        if (words != 0) words[written] = TRACE_TEST | ray.reached | prim_id;
        ++written;
#endif
      }
#if COUNTERS
      ++steps;
#endif
    } while (!is_final(&ray, exit_time(&walk), late) && step_walk(grid, &walk));
    store_ray_sample(&s, &ray, pixel, nearness, visible_prims);
#if TRACE
    trace_counts[pixel] = written;
#endif
#if COUNTERS
    own.edge_evaluations += ray.evaluated;
    own.samples_tested += ray.tested;
    own.samples_covered += ray.covered;
    own.samples_written += ray.written;
    own.traversal_steps += steps;
    cost[pixel] += ray.evaluated;
    cost[2 * (size_t)pixel_count + pixel] += steps;
#endif
  }
#if COUNTERS
  add_work(&own, item, work);
#endif
}
