// Rays through a uniform grid in passes: the multipass ray caster, whose rays are streams and whose loops are the host's.
//
// Purcell et al., 'Ray Tracing on Programmable Graphics Hardware', sections 3.1 and 3.2: kernels without branches are run
// again and again over the rays that are in their state; an oracle on the host (clrast/visibility/grid_passes.py) looks
// at how many rays are in which state and picks the next pass:
//   generate_eye_rays: traversing, or done where the ray misses the grid
//   traverse_rays:     UNROLL_STEPS cells; in one that holds triangles: intersecting; out of the grid: shading or done
//   intersect_rays:    UNROLL_TESTS triangles; past the cell's last: traversing in the next one, or shading
// There, a stencil holds each ray's state, and all rays pay for reading it in every pass. Here each state has a stream of
// the rays that are in it, in order, made anew after each pass by counts and prefix sums: what is done costs nothing.
//   scan_stream_chunks, scatter_stream
// A triangle is tested as everywhere (ray_sample.clh), so the bits are those of the branching kernel.
// Good at: devices without branches, or that end loops early. Bad at: many passes; state goes to memory and back.
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

// A cell in one word: 10 bits an axis (MAX_GRID_SIDE).
INLINE uint pack_cell(const GridWalk *walk) { return (uint)walk->x | (uint)walk->y << 10 | (uint)walk->z << 20; }

// The walk of a pixel's ray that is in a packed cell.
INLINE GridWalk resume_walk(View view, Grid grid, float x, float y, uint packed) {
  GridWalk walk = ray_of_sample(view, grid, x, y);
  walk.x = (int)(packed & 1023u);
  walk.y = (int)(packed >> 10 & 1023u);
  walk.z = (int)(packed >> 20);
  find_times(grid, &walk);
  return walk;
}

INLINE float2 place_of_pixel(View view, uint pixel) {
  const uint column = pixel % view.width, row = pixel / view.width + view.band_top;
  return (float2)((float)column + (view.sample_x - view.center_x), (float)row + (view.sample_y - view.center_y));
}

// Notes what becomes of entry k of a chunk.
INLINE void note_state(uchar state, uint k, global uchar *states, uint *counts) {
  states[k] = state;
  counts[0] += state == RAY_TRAVERSING;
  counts[1] += state == RAY_INTERSECTING;
}

INLINE void store_counts(const uint *counts, uint chunk, global uint *chunk_counts) {
  chunk_counts[2 * chunk] = counts[0];
  chunk_counts[2 * chunk + 1] = counts[1];
}

// Reads: the view. Writes: cells (for traverse_rays), states and chunk_counts (for scatter_stream). Work item: LIST_CHUNK
// rays. Local memory: 0 bytes.
kernel void generate_eye_rays(
    View view,
    Grid grid,
    uint ray_count,                  // pixels of the band
    global uint *restrict rays,      // [ray_count] all of them
    global uint *restrict cells,     // [ray_count] the cell that each ray is in
    global uchar *restrict states,   // [ray_count]
    global uint *restrict chunk_counts) // [2 * chunks] rays that traverse, and that intersect
{
  const uint begin = get_global_id(0) * LIST_CHUNK;
  if (begin >= ray_count) return;
  uint counts[2] = {0, 0};
  for (uint pixel = begin; pixel < min(begin + LIST_CHUNK, ray_count); ++pixel) {
    const float2 place = place_of_pixel(view, pixel);
    GridWalk walk = ray_of_sample(view, grid, place.x, place.y);
    const bool enters = enter_grid(grid, &walk);
    rays[pixel] = pixel;
    if (enters) cells[pixel] = pack_cell(&walk);
    note_state(enters ? RAY_TRAVERSING : RAY_DONE, pixel, states, counts);
  }
  store_counts(counts, begin / LIST_CHUNK, chunk_counts);
}

// Reads: rays (scatter_stream), cells, cell_begin (build_grid.cl). Writes: cells, cursors (for intersect_rays), states and
// chunk_counts (for scatter_stream). Work item: LIST_CHUNK rays. Local memory: 0 bytes.
kernel void traverse_rays(
    View view,
    Grid grid,
    uint ray_count,                          // of the stream
    global const uint *restrict rays,        // [ray_count] pixels of the band
    global const uint *restrict cell_begin,  // [cell_count + 1]
    global uint *restrict cells,             // [band pixels]
    global uint2 *restrict cursors,          // [band pixels] next reference of the ray's cell, and its end
    global uchar *restrict states,           // [ray_count] by place in the stream
#if COUNTERS
    uint pixel_count,                        // of the band
    global ulong *restrict work,             // [chunks * WORK_COUNTER_COUNT] added to
    global uint *restrict cost,              // [3 * pixel_count] evaluations, setups, steps of each sample, added to
#endif
    global uint *restrict chunk_counts)      // [2 * chunks]
{
  const uint begin = get_global_id(0) * LIST_CHUNK;
  if (begin >= ray_count) return;
  uint counts[2] = {0, 0};
#if COUNTERS
  Work own = {0, 0, 0, 0, 0, 0, 0, 0, 0};
#endif
  for (uint k = begin; k < min(begin + LIST_CHUNK, ray_count); ++k) {
    const uint pixel = rays[k];
    const float2 place = place_of_pixel(view, pixel);
    GridWalk walk = resume_walk(view, grid, place.x, place.y, cells[pixel]);
    uchar state = RAY_TRAVERSING;
    uint steps = 0;
    do {
      const uint cell = cell_of(grid, walk.x, walk.y, walk.z), first = cell_begin[cell], end = cell_begin[cell + 1];
      ++steps;
      if (first != end) {
        cursors[pixel] = (uint2)(first, end);
        state = RAY_INTERSECTING;
      } else if (!step_walk(grid, &walk)) {
        state = RAY_SHADING;
      }
    } while (state == RAY_TRAVERSING && steps < UNROLL_STEPS);
    cells[pixel] = pack_cell(&walk);
    note_state(state, k, states, counts);
#if COUNTERS
    own.traversal_steps += steps;
    cost[2 * (size_t)pixel_count + pixel] += steps;
#endif
  }
#if COUNTERS
  add_work(&own, begin / LIST_CHUNK, work);
#endif
  store_counts(counts, begin / LIST_CHUNK, chunk_counts);
}

// Reads: rays (scatter_stream), cells, cursors (traverse_rays), records (record_triangles), references (build_grid.cl).
// Writes: nearness, visible_prims (for shade_hits), cells, cursors, states and chunk_counts (for scatter_stream).
// Work item: LIST_CHUNK rays. Local memory: 0 bytes.
kernel void intersect_rays(
    View view,
    Grid grid,
    uint ray_count,                              // of the stream
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
    global const uint *restrict rays,            // [ray_count] pixels of the band
    global const uint *restrict records,         // [padded triangle_count * RECORD_WORDS]
    global const uint *restrict references,      // [reference_count] prim_ids
    global uint *restrict cells,                 // [band pixels]
    global uint2 *restrict cursors,              // [band pixels] next reference of the ray's cell, and its end
    global float *restrict nearness,             // [band height * width]
    global uint *restrict visible_prims,         // [band height * width] prim_id or NO_HIT
    global uchar *restrict states,               // [ray_count] by place in the stream
#if COUNTERS
    global ulong *restrict work,                 // [chunks * WORK_COUNTER_COUNT] added to
    global uint *restrict cost,                  // [3 * pixel_count] evaluations, setups, steps of each sample, added to
#endif
    global uint *restrict chunk_counts)          // [2 * chunks]
{
  const uint begin = get_global_id(0) * LIST_CHUNK;
  if (begin >= ray_count) return;
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
  uint counts[2] = {0, 0};
#if COUNTERS
  Work own = {0, 0, 0, 0, 0, 0, 0, 0, 0};
#endif
  for (uint k = begin; k < min(begin + LIST_CHUNK, ray_count); ++k) {
    const uint pixel = rays[k];
    RaySample ray = load_ray_sample(&s, pixel, nearness, visible_prims);
    uint2 cursor = cursors[pixel];
    for (uint n = 0; n < UNROLL_TESTS && cursor.x < cursor.y; ++n, ++cursor.x)
      meet_triangle(&s, references[cursor.x], &ray);
    uchar state = RAY_INTERSECTING;
    if (cursor.x == cursor.y) {
      GridWalk walk = resume_walk(view, grid, ray.x, ray.y, cells[pixel]);
      const bool goes_on = !is_final(&ray, exit_time(&walk), late) && step_walk(grid, &walk);
      state = goes_on ? RAY_TRAVERSING : RAY_SHADING;
      cells[pixel] = pack_cell(&walk);
    } else {
      cursors[pixel] = cursor;
    }
    store_ray_sample(&s, &ray, pixel, nearness, visible_prims);
    note_state(state, k, states, counts);
#if COUNTERS
    own.edge_evaluations += ray.evaluated;
    own.samples_tested += ray.tested;
    own.samples_covered += ray.covered;
    own.samples_written += ray.written;
    cost[pixel] += ray.evaluated;
#endif
  }
#if COUNTERS
  add_work(&own, begin / LIST_CHUNK, work);
#endif
  store_counts(counts, begin / LIST_CHUNK, chunk_counts);
}

// Reads: chunk_counts (the pass before). Writes: chunk_begins (for scatter_stream), totals (for the host). Work item: only
// one. Local memory: 0 bytes.
kernel void scan_stream_chunks(
    uint chunk_count,
    global const uint *restrict chunk_counts,  // [2 * chunks]
    global uint *restrict chunk_begins,        // [2 * chunks] exclusive sums
    global uint *restrict totals)              // [2] rays that traverse, and that intersect
{
  if (get_global_id(0) != 0) return;
  uint traversing = 0, intersecting = 0;
  for (uint k = 0; k < chunk_count; ++k) {
    chunk_begins[2 * k] = traversing;
    chunk_begins[2 * k + 1] = intersecting;
    traversing += chunk_counts[2 * k];
    intersecting += chunk_counts[2 * k + 1];
  }
  totals[0] = traversing;
  totals[1] = intersecting;
}

// Reads: rays, states (the pass before), chunk_begins (scan_stream_chunks). Writes: both streams (for the next pass).
// Work item: LIST_CHUNK rays. Local memory: 0 bytes.
kernel void scatter_stream(
    uint ray_count,
    uint first_traversing,                     // rays that the stream has already
    uint first_intersecting,
    global const uint *restrict rays,          // [ray_count]
    global const uchar *restrict states,       // [ray_count]
    global const uint *restrict chunk_begins,  // [2 * chunks]
    global uint *restrict traversing,          // stream of rays that traverse
    global uint *restrict intersecting)        // stream of rays that intersect
{
  const uint begin = get_global_id(0) * LIST_CHUNK;
  if (begin >= ray_count) return;
  uint place = first_traversing + chunk_begins[begin / LIST_CHUNK * 2];
  uint other = first_intersecting + chunk_begins[begin / LIST_CHUNK * 2 + 1];
  for (uint k = begin; k < min(begin + LIST_CHUNK, ray_count); ++k) {
    if (states[k] == RAY_TRAVERSING) traversing[place++] = rays[k];
    if (states[k] == RAY_INTERSECTING) intersecting[other++] = rays[k];
  }
}
