// Decides every sample of a tile: edge functions, fill rule, nearness, visibility buffer.
//
// Davidovic et al., '3D Rasterization', section 3.2 (direct evaluation of equation (2)), section 3.4
// (consistency). One work-item is one tile; its nearness and ids stay in private memory.
//   for 16 references of the tile at a time: set their triangles up, one a lane
//     for each of them, for each block of 4 x 4 samples in its bound:
//       V_i = (c_i + X gx_i) + Y gy_i;  w likewise
//       inside all edges and nearer than what is there: keep w and prim_id
// References come in the order of triangles, so 'nearer' alone makes the smaller id win a tie.
// Tried on PoCL 3.1 (Zen 5, 16 lanes) and left out, in per cent of this kernel's time: fma in the edge functions
// (-5, but a subnormal operand may be flushed), near half of a tile's list first by 12-bit keys (+15), Morton order
// of the triangles and near chunks first with a tie rule by id (+15), one list of blocks per batch (+15), testing
// each block of a small triangle against the nearness that is there (+3), a maximum for the blend (0).
// Good at: small and middle triangles, any mix. Bad at: depth complexity (all layers are evaluated).
// Tests: tests/test_rasterizer.py, tests/test_hard_cases.py.

#include "vector.clh"
#include "counters.clh"
#include "edge_function.clh"
#if ALPHA_MASK
#include "surface.clh"
#endif
#define LISTS_IN_ORDER 1
#include "triangle_batch.clh"
#include "sample_blocks.clh"
#include "sample_memory.clh"

#define REFRESH_PERIOD TILE_BLOCKS            // references between updates of the culling bounds
#define PREFETCH_AHEAD (2 * VECTOR_WIDTH)  // references

// Sets the triangles of up to VECTOR_WIDTH references up; `lowest` is the tile's lowest nearness.
INLINE void load_references(
    Batch *batch,
    View view,
    const TileFrame *frame,
    float lowest,
    uint first,
    uint end,
#if FILTERED
    global const char *restrict facing_signs,
#endif
    global const float4 *restrict corners,
    global const uint *restrict reference_prims,
    global const uint *restrict reference_bounds) {
  // Lanes past the end read what follows the list (the buffers are padded); they get no work.
#pragma unroll
  for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) batch->prim_id[lane] = reference_prims[min(first + lane, end - 1)];
#pragma unroll
  for (uint lane = 0; lane < VECTOR_WIDTH; ++lane)
    PREFETCH_CORNERS(corners, reference_prims[min(first + PREFETCH_AHEAD + lane, end - 1)]);
  const Triangles triangles = gather_triangles(corners, batch->prim_id);
#if ALPHA_MASK
  find_masked(batch, frame, triangles, view);
#endif
  const int_v bounds = AS_INT_V(LOAD_V(reference_bounds + first));
#if FILTERED
  ErrorBounds errors;
  const TriangleSetup setup = setup_triangles_settled(triangles, view, frame->direction_reach, batch->prim_id, facing_signs, &errors);
#pragma unroll
  for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) batch->slot[lane] = batch->prim_id[lane];
  fill_batch(batch, setup, errors, frame,
#else
  fill_batch(batch, setup_triangles_at(triangles, view), frame,
#endif
             bounds & 0xff, bounds >> 8 & 0xff, bounds >> 16 & 0xff, bounds >> 24 & 0xff, LANES < (int)(end - first),
             lowest);
}

// Reads: references, tile_begin (bin_triangles.cl), corners (prepare_triangles).
// Writes: visible_prims (for shade_hits). Work item: one tile. Local memory: 0 bytes.
kernel void rasterize_tiles(
    View view,
    uint tile_count,
    uint reference_capacity,                  // references that were written
#if KEEP_NEARNESS
    uint first_reference,                     // of every tile's list, for this launch
    uint reference_span,                      // references of every tile's list in this launch
    uint resume,                              // 1: go on from nearness and visible_prims
    uint layer,                               // 0, or more: front_* say what lies in front
    global const float *restrict front_nearness, // [band height * width] of the layer in front
    global const uint *restrict front_prims,     // [band height * width] its prim_id or NO_HIT
    global float *restrict nearness,             // [band height * width]
#endif
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
    uint contender_capacity,                  // entries of the list
    global uint *restrict contender_state,    // [CONTENDER_WORDS] first word: contenders found
    global uint2 *restrict contenders,        // [contender_capacity] pixel of the band, prim_id
    global const char *restrict facing_signs, // [padded triangle_count] signs that float32 cannot tell, by slot
    global const float4 *restrict positions,  // [vertex_count] world space, as given
    global const uint *restrict prim_vertices, // [3 * triangle_count] vertices
#endif
    global const float4 *restrict corners,    // [3 * triangle_count] canonical corners and normals
    global const uint *restrict tile_begin,   // [tile_count + 1] first reference of each tile
    global const uint *restrict reference_prims,  // [reference_capacity] prim_id
    global const uint *restrict reference_bounds, // [padded reference_capacity] bound within the tile
#if COUNTERS
    uint pixel_count,                         // of the band
    global ulong *restrict work,              // [tile_count * WORK_COUNTER_COUNT] added to
    global uint *restrict cost,               // [3 * pixel_count] evaluations, setups, steps of each sample, added to
#endif
    global uint *restrict visible_prims)      // [band height * width] prim_id or NO_HIT
{
  const uint tile = get_global_id(0);
  if (tile >= tile_count) return;
  const uint column = tile % view.tile_columns, row = tile / view.tile_columns;
  const int left = column << TILE_LOG2, top = (row << TILE_LOG2) + view.band_top;
#if !KEEP_NEARNESS
  if (tile_begin[tile] == tile_begin[tile + 1]) {
    clear_tile(view, left, top, visible_prims);
    return;
  }
#endif
  TileFrame frame = make_frame(view, left, top);
#if ALPHA_MASK
  const Surfaces surfaces = {material_ids, materials, textures, texels, srgb_to_linear, uv, uv1, colors};
  frame.surfaces = surfaces;
  frame.indices = indices;
#endif
#if FILTERED
  frame.contender_capacity = contender_capacity;
  frame.contender_state = contender_state;
  frame.contenders = contenders;
  frame.corners = corners;
  frame.positions = positions;
  frame.prim_vertices = prim_vertices;
#endif
  TileSamples samples;
  uint begin = tile_begin[tile], end = min(tile_begin[tile + 1], reference_capacity);
#if KEEP_NEARNESS
  clear_samples(view, left, top, &samples, resume, layer, front_nearness, front_prims, nearness, visible_prims);
  begin = min(begin + first_reference, end);
  end = layer > 0 && !has_front(&samples) ? begin : begin + min(reference_span, end - begin);
#else
  clear_samples(view, left, top, &samples);
#endif
  float tile_lowest = NEARNESS_OF_NOTHING;
  for (uint k = begin; k < end; k += VECTOR_WIDTH) {
    if (k != begin && (k - begin) % REFRESH_PERIOD == 0) tile_lowest = refresh_lowest(&samples);
    Batch batch;
#if FILTERED
    load_references(&batch, view, &frame, tile_lowest, k, end, facing_signs, corners, reference_prims, reference_bounds);
#else
    load_references(&batch, view, &frame, tile_lowest, k, end, corners, reference_prims, reference_bounds);
#endif
#if COUNTERS
    count_batch(&batch, LANES < (int)(end - k), &samples);
#endif
    rasterize_batch(&batch, &frame, &samples);
  }
  store_tile(view, left, top, samples.visible, visible_prims);
#if FILTERED
  if (samples.asked) atomic_add(contender_state + CONTENDER_FLOAT64, samples.asked);
#endif
#if KEEP_NEARNESS
  store_nearness(view, left, top, samples.nearness, nearness);
#if FILTERED
  store_nearness(view, left, top, samples.upper_nearness, nearness + band_pixels(view));
#endif
#endif
#if COUNTERS
  store_work(view, left, top, &samples, tile, work, cost, pixel_count);
#endif
}
