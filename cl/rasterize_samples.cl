// Decides several samples of each pixel of a list at once: a lane is a sample of one pixel.
//
// Where antialiasing wants many samples of few pixels: triangles are set up once for all samples of a launch, up to
// LANE_GROUPS * VECTOR_WIDTH, and pixels that are not listed, and what lies before them alone, cost nothing. Samples are
// decided by the expressions of rasterize_tiles.cl (sample_blocks.clh), so that they come out the same bit for bit.
// Davidovic et al., '3D Rasterization', section 4.
//   for each square of 16 x 16 pixels of a tile that has a listed pixel:
//     references whose bound holds a listed pixel are gathered, VECTOR_WIDTH at a time, and those that no listed pixel's
//     centre shows wait until the others are done, which nearly always hide them:
//       set their triangles up
//       for each group of VECTOR_WIDTH samples, each triangle, each listed pixel in its bound: all lanes' samples
// A pixel that is not listed is as near as infinity: the culling by nearness leaves it out. No order decides a sample: where
// two triangles are as near, the id does.
// Good at: lists of any length. Bad at: nothing known. Tests: tests/test_sample_lanes.py.

#define SAMPLE_LANES 1
#if TILE_LOG2 < 4
#define SQUARE_LOG2 TILE_LOG2
#else
#define SQUARE_LOG2 4
#endif
#define TILE_SIZE (1 << SQUARE_LOG2)
#include "vector.clh"
#include "counters.clh"
#include "edge_function.clh"
#if ALPHA_MASK
#include "surface.clh"
#endif
#include "triangle_batch.clh"
#include "sample_blocks.clh"
#include "listed_squares.clh"

#if !FILTERED  // rungs that filter take passes over all pixels: listed_samples.py

#define REFRESH_BATCHES 4  // between updates of the culling bounds
#define TILE_SQUARES (1 << (TILE_LOG2 - SQUARE_LOG2))

// Where the lanes of a group lie in the square's first pixel, see TileFrame.
typedef struct { float_v x, y; float left, top, right, bottom; } Lanes;

// Sets what is found at the square's listed pixels to nothing, and the others to as near as infinity.
INLINE void start_samples(const Square *square, TileSamples *samples) {
  for (uint block = 0; block < TILE_BLOCKS; ++block) samples->lowest[block] = INFINITY;
#if COUNTERS
  for (uint block = 0; block < TILE_BLOCKS; ++block) {
    samples->evaluations[block] = 0;
    samples->setups[block] = samples->steps[block] = 0;
  }
#endif
  for (uint k = 0; k < square->count; ++k) {
    const uint block = square->blocks[k];
    samples->nearness[block] = NEARNESS_OF_NOTHING;
    samples->lowest[block] = NEARNESS_OF_NOTHING;
    samples->visible[block] = NO_HIT;
  }
}

// Recomputes the culling bounds of the listed pixels and returns the lowest.
INLINE float refresh_listed(const Square *square, uint group_count, TileSamples *samples) {
  float_v lowest = INFINITY;
  for (uint group = 0; group < group_count; ++group)
    for (uint k = 0; k < square->count; ++k) {
      const uint block = square->blocks[k];
      samples[group].lowest[block] = LOWEST_V(samples[group].nearness[block]);
      lowest = min(lowest, samples[group].nearness[block]);
    }
  return LOWEST_V(lowest);
}

INLINE Lanes place_lanes(View view, int left, int top, float_v sample_x, float_v sample_y) {
  Lanes lanes;
  lanes.x = (float)left + (sample_x - view.center_x);
  lanes.y = (float)top + (sample_y - view.center_y);
  lanes.left = LOWEST_V(lanes.x);
  lanes.top = LOWEST_V(lanes.y);
  lanes.right = -LOWEST_V(-lanes.x);
  lanes.bottom = -LOWEST_V(-lanes.y);
  return lanes;
}

INLINE void take_lanes(TileFrame *frame, const Lanes *lanes) {
  frame->x = lanes->x;
  frame->y = lanes->y;
  frame->left = lanes->left;
  frame->top = lanes->top;
  frame->right = lanes->right;
  frame->bottom = lanes->bottom;
}

// Sets the last VECTOR_WIDTH gathered triangles up and decides their samples.
// lanes : of each group, and behind them what bounds those of all.
INLINE void decide_gathered(View view, TileFrame *frame, float lowest, Gathered *gathered, uint group_count,
                            const Lanes *lanes, TileSamples *samples, global const float4 *restrict corners) {
  const uint count = min(gathered->count, (uint)VECTOR_WIDTH);
  gathered->count -= count;
  const uint first = gathered->count;
  Batch batch;
#pragma unroll
  for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) batch.prim_id[lane] = gathered->prim_id[first + min(lane, count - 1)];
  const Triangles triangles = gather_triangles(corners, batch.prim_id);
#if ALPHA_MASK
  find_masked(&batch, frame, triangles, view);
#endif
  const int_v bounds = LOAD_V(gathered->bounds + first);
  take_lanes(frame, lanes + group_count);
  fill_batch(&batch, setup_triangles_at(triangles, view), frame, bounds & 0xff, bounds >> 8 & 0xff, bounds >> 16 & 0xff,
             bounds >> 24 & 0xff, LANES < (int)count, lowest);
#if COUNTERS
  count_batch(&batch, LANES < (int)count, samples);
#endif
  for (uint group = 0; group < group_count; ++group) {
    take_lanes(frame, lanes + group);
    rasterize_batch(&batch, frame, samples + group);
  }
}

// Writes what was found at the listed pixels: where all are, whether it differs from what the centres show, and only then
// the samples.
INLINE void store_square(View view, int left, int top, const Square *square, uint group_count, const TileSamples *samples,
                         uint everywhere, uint stride, uint first_entry, global const uint *restrict places,
                         global const uint *restrict center_prims, global uchar *restrict differs,
                         global uint *restrict sample_prims) {
  for (uint k = 0; k < square->count; ++k) {
    const uint block = square->blocks[k], row = block / TILE_SIZE, column = block % TILE_SIZE;
    const size_t pixel = (size_t)(top + square->top + row - view.band_top) * view.width + left + square->left + column;
    if (everywhere) {
      const int_v center = (int)center_prims[pixel];
      int_v others = 0;
      for (uint group = 0; group < group_count; ++group) others |= AS_INT_V(samples[group].visible[block]) != center;
      differs[pixel] = has_lane(others) != 0;
      if (!differs[pixel]) continue;
    }
    global uint *own = sample_prims + (everywhere ? pixel : places[pixel]) * (size_t)stride + first_entry;
    for (uint group = 0; group < group_count; ++group) STORE_V(samples[group].visible[block], own + group * VECTOR_WIDTH);
  }
}

#if COUNTERS
// Adds what the samples of the square's pixels cost to their pixels.
INLINE void add_costs(View view, int left, int top, const Square *square, const TileSamples *samples, uint pixel_count,
                      global uint *restrict cost) {
  for (uint k = 0; k < square->count; ++k) {
    const uint block = square->blocks[k], row = block / TILE_SIZE, column = block % TILE_SIZE;
    const size_t pixel = (size_t)(top + square->top + row - view.band_top) * view.width + left + square->left + column;
    uint evaluations[VECTOR_WIDTH];
    STORE_V(samples->evaluations[block], evaluations);
    for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) cost[pixel] += evaluations[lane];
    cost[(size_t)pixel_count + pixel] += samples->setups[block];
  }
}
#endif

// Reads: references, tile_begin (bin_triangles.cl), corners (prepare_triangles), places (list_edge_pixels, keep_strata).
// Writes: sample_prims (for meet_strata, flag_surfaces, group_samples). Work item: one tile. Local memory: 0 bytes.
kernel void rasterize_samples(
    View view,
    uint tile_count,
    uint reference_capacity,                     // references that were written
    uint everywhere,                             // 1: all pixels are listed, each in its own place
    uint stride,                                 // entries from one listed pixel to the next
    uint first_entry,                            // where these samples begin among a pixel's
    uint group_count,                            // of VECTOR_WIDTH samples each, at most LANE_GROUPS
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
    global const float *restrict sample_x,       // [group_count * VECTOR_WIDTH] where in its pixel a sample lies, pixels
    global const float *restrict sample_y,       // [group_count * VECTOR_WIDTH]
    global const float4 *restrict corners,       // [3 * triangle_count] canonical corners and normals
    global const uint *restrict tile_begin,      // [tile_count + 1] first reference of each tile
    global const uint *restrict reference_prims,   // [padded reference_capacity] prim_id
    global const uint *restrict reference_bounds,  // [padded reference_capacity] bound within the tile
    global const uint *restrict places,          // [band height * width] a pixel's place in the list, or NO_HIT
    global const uint *restrict center_prims,    // [band height * width] prim_id or NO_HIT; a guess where not `everywhere`
#if COUNTERS
    uint pixel_count,                            // of the band
    global ulong *restrict work,                 // [tile_count * WORK_COUNTER_COUNT] added to
    global uint *restrict cost,                  // [3 * pixel_count] evaluations, setups, steps, added to
#endif
    global uchar *restrict differs,              // [band height * width] `everywhere`: 1 where a sample shows another triangle
    global uint *restrict sample_prims)          // [listed * stride] prim_id or NO_HIT of the samples; of pixels that differ
{
  const uint tile = get_global_id(0);
  if (tile >= tile_count) return;
  const int left = tile % view.tile_columns << TILE_LOG2, top = (tile / view.tile_columns << TILE_LOG2) + view.band_top;
  const uint begin = tile_begin[tile], end = min(tile_begin[tile + 1], reference_capacity);
  TileFrame frame;
#if ALPHA_MASK
  const Surfaces surfaces = {material_ids, materials, textures, texels, srgb_to_linear, uv, uv1, colors};
  frame.surfaces = surfaces;
  frame.indices = indices;
#endif
  frame.column = frame.row = 0;
  frame.center_x = view.center_x;
  frame.center_y = view.center_y;
  TileSamples samples[LANE_GROUPS];
#if COUNTERS
  const Work none = {0, 0, 0, 0, 0, 0, 0, 0, 0};
  for (uint group = 0; group < group_count; ++group) samples[group].work = none;
#endif
  for (uint k = 0; k < TILE_SQUARES * TILE_SQUARES; ++k) {
    Square square;
    square.left = k % TILE_SQUARES << SQUARE_LOG2;
    square.top = k / TILE_SQUARES << SQUARE_LOG2;
    list_blocks(view, left, top, &square, everywhere, places, center_prims);
    if (square.count == 0) continue;
    Lanes lanes[LANE_GROUPS + 1], all = {0.0f, 0.0f, INFINITY, INFINITY, -INFINITY, -INFINITY};
    for (uint group = 0; group < group_count; ++group) {
      const Lanes own = place_lanes(view, left + square.left, top + square.top, LOAD_V(sample_x + group * VECTOR_WIDTH),
                                    LOAD_V(sample_y + group * VECTOR_WIDTH));
      lanes[group] = own;
      all.left = min(all.left, own.left);
      all.top = min(all.top, own.top);
      all.right = max(all.right, own.right);
      all.bottom = max(all.bottom, own.bottom);
      start_samples(&square, samples + group);
    }
    lanes[group_count] = all;
    float lowest = NEARNESS_OF_NOTHING;
    Gathered shown, waiting;
    shown.count = waiting.count = 0;
    uint batches = 0;
    bool has_waited = false;
    for (uint first = begin; first < end || shown.count + waiting.count != 0; first += VECTOR_WIDTH) {
      const bool is_read = first >= end;
      if (!is_read) gather_references(&square, first, end, &shown, &waiting, reference_prims, reference_bounds);
      Gathered *next = shown.count >= (is_read ? 1 : VECTOR_WIDTH) ? &shown : &waiting;
      if (next == &waiting && !is_read && waiting.count < WAITING_CAPACITY) continue;
      if (++batches % REFRESH_BATCHES == 0 || (next == &waiting && !has_waited))
        lowest = refresh_listed(&square, group_count, samples);
      has_waited = next == &waiting;
      decide_gathered(view, &frame, lowest, next, group_count, lanes, samples, corners);
    }
    store_square(view, left, top, &square, group_count, samples, everywhere, stride, first_entry, places, center_prims, differs,
                 sample_prims);
#if COUNTERS
    for (uint group = 0; group < group_count; ++group) add_costs(view, left, top, &square, samples + group, pixel_count, cost);
#endif
  }
#if COUNTERS
  for (uint group = 0; group < group_count; ++group) add_work(&samples[group].work, tile, work);
#endif
}

#endif
