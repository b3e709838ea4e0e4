// Decides several samples of each pixel of a list at once: a lane is a sample of one pixel.
//
// Where antialiasing wants many samples of few pixels: triangles are set up once for VECTOR_WIDTH samples, and pixels that
// are not listed, and what lies before them alone, cost nothing. Samples are decided by the expressions of rasterize_tiles.cl
// (sample_blocks.clh), so that they come out the same bit for bit. Davidovic et al., '3D Rasterization', section 4.
//   for each square of 16 x 16 pixels of a tile that has a listed pixel:
//     references whose bound holds a listed pixel are gathered, in their order, VECTOR_WIDTH at a time:
//       set their triangles up; for each of them, for each listed pixel in its bound: all lanes' samples
// A pixel that is not listed is as near as infinity: the culling by nearness leaves it out.
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
#define LISTS_IN_ORDER 1
#include "triangle_batch.clh"
#include "sample_blocks.clh"

#if !FILTERED  // rungs that filter take passes over all pixels: listed_samples.py

#define REFRESH_BATCHES 4  // between updates of the culling bounds
#define TILE_SQUARES (1 << (TILE_LOG2 - SQUARE_LOG2))

// One square: its first pixel in the tile, and which of its pixels are listed, a bit each, row by row.
typedef struct { int left, top; ushort rows[TILE_SIZE]; } Square;

// References whose bounds in the square hold a listed pixel; VECTOR_WIDTH of them and what one more step may add.
typedef struct {
  uint prim_id[2 * VECTOR_WIDTH];
  int bounds[2 * VECTOR_WIDTH];  // in the square: x0 | y0 << 8 | x1 << 16 | y1 << 24
  uint count;
} Gathered;

// Looks for the square's listed pixels, and sets what is found there to nothing; false where there are none.
INLINE bool start_square(View view, int left, int top, Square *square, TileSamples *samples, uint everywhere,
                         global const uint *restrict places) {
  bool any = false;
  for (uint row = 0; row < TILE_SIZE; ++row) {
    uint bits = 0;
    const uint y = top + square->top + row, x0 = left + square->left;
    const size_t first = (size_t)(y - (view.band_row << TILE_LOG2)) * view.width + x0;
    if (y < view.height)
      for (uint column = 0; column < TILE_SIZE && x0 + column < view.width; ++column)
        if (everywhere || places[first + column] != NO_HIT) bits |= 1u << column;
    square->rows[row] = bits;
    any |= bits != 0;
    for (uint column = 0; column < TILE_SIZE; ++column) {
      const uint block = row * TILE_SIZE + column;
      const float nothing = bits >> column & 1 ? NEARNESS_OF_NOTHING : INFINITY;
      samples->nearness[block] = nothing;
      samples->lowest[block] = nothing;
      samples->visible[block] = NO_HIT;
#if COUNTERS
      samples->evaluations[block] = 0;
      samples->setups[block] = samples->steps[block] = 0;
#endif
    }
  }
  return any;
}

// Adds those of VECTOR_WIDTH references from `first` on that meet a listed pixel.
INLINE void gather_references(const Square *square, uint first, uint end, Gathered *gathered,
                              global const uint *restrict reference_prims, global const uint *restrict reference_bounds) {
  const int_v bounds = AS_INT_V(LOAD_V(reference_bounds + first));
  const int_v x0 = clamp((bounds & 0xff) - square->left, 0, TILE_SIZE), x1 = clamp((bounds >> 16 & 0xff) - square->left, 0, TILE_SIZE);
  const int_v y0 = clamp((bounds >> 8 & 0xff) - square->top, 0, TILE_SIZE), y1 = clamp((bounds >> 24 & 0xff) - square->top, 0, TILE_SIZE);
  const int_v columns = ((int_v)(1) << x1) - ((int_v)(1) << x0);
  int_v held = 0;
  for (int row = 0; row < TILE_SIZE; ++row)
    held |= ((row >= y0) & (row < y1)) != 0 ? columns & (int)square->rows[row] : (int_v)(0);
  int found[VECTOR_WIDTH], packed[VECTOR_WIDTH];
  STORE_V((held != 0) & (LANES < (int)(end - first)), found);
  STORE_V(x0 | y0 << 8 | x1 << 16 | y1 << 24, packed);
  uint count = gathered->count;
  for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) {
    gathered->prim_id[count] = reference_prims[first + lane];
    gathered->bounds[count] = packed[lane];
    count += found[lane] != 0;
  }
  gathered->count = count;
}

// Sets the first VECTOR_WIDTH gathered triangles up and decides their samples; the rest of the list moves up.
INLINE void decide_gathered(View view, const TileFrame *frame, float lowest, Gathered *gathered, TileSamples *samples,
                            global const float4 *restrict corners) {
  const uint count = min(gathered->count, (uint)VECTOR_WIDTH);
  Batch batch;
#pragma unroll
  for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) batch.prim_id[lane] = gathered->prim_id[min(lane, count - 1)];
  const Triangles triangles = gather_triangles(corners, batch.prim_id);
#if ALPHA_MASK
  find_masked(&batch, frame, triangles, view);
#endif
  const int_v bounds = LOAD_V(gathered->bounds);
  fill_batch(&batch, setup_triangles_at(triangles, view), frame, bounds & 0xff, bounds >> 8 & 0xff, bounds >> 16 & 0xff,
             bounds >> 24 & 0xff, LANES < (int)count, lowest);
#if COUNTERS
  count_batch(&batch, LANES < (int)count, samples);
#endif
  rasterize_batch(&batch, frame, samples);
  gathered->count -= count;
  for (uint k = 0; k < gathered->count; ++k) {
    gathered->prim_id[k] = gathered->prim_id[count + k];
    gathered->bounds[k] = gathered->bounds[count + k];
  }
}

// Writes what was found at the listed pixels.
INLINE void store_square(View view, int left, int top, const Square *square, const TileSamples *samples, uint everywhere,
                         uint stride, uint first_entry, global const uint *restrict places, global uint *restrict sample_prims) {
  for (uint row = 0; row < TILE_SIZE; ++row)
    for (uint column = 0; column < TILE_SIZE; ++column) {
      if (!(square->rows[row] >> column & 1)) continue;
      const size_t pixel = (size_t)(top + square->top + row - (view.band_row << TILE_LOG2)) * view.width + left + square->left + column;
      STORE_V(samples->visible[row * TILE_SIZE + column], sample_prims + (size_t)(everywhere ? pixel : places[pixel]) * stride + first_entry);
    }
}

#if COUNTERS
// Adds what the samples of the square's pixels cost to their pixels.
INLINE void add_costs(View view, int left, int top, const Square *square, const TileSamples *samples, uint pixel_count,
                      global uint *restrict cost) {
  for (uint row = 0; row < TILE_SIZE; ++row)
    for (uint column = 0; column < TILE_SIZE; ++column) {
      if (!(square->rows[row] >> column & 1)) continue;
      const size_t pixel = (size_t)(top + square->top + row - (view.band_row << TILE_LOG2)) * view.width + left + square->left + column;
      uint evaluations[VECTOR_WIDTH];
      STORE_V(samples->evaluations[row * TILE_SIZE + column], evaluations);
      for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) cost[pixel] += evaluations[lane];
      cost[(size_t)pixel_count + pixel] += samples->setups[row * TILE_SIZE + column];
    }
}
#endif

// Reads: references, tile_begin (bin_triangles.cl), corners (prepare_triangles), places (list_edge_pixels, keep_pixels).
// Writes: sample_prims (for meet_strata). Work item: one tile. Local memory: 0 bytes.
kernel void rasterize_samples(
    View view,
    uint tile_count,
    uint reference_capacity,                     // references that were written
    uint everywhere,                             // 1: all pixels are listed, each in its own place
    uint stride,                                 // entries from one listed pixel to the next
    uint first_entry,                            // where these samples begin among a pixel's
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
    global const float *restrict sample_x,       // [VECTOR_WIDTH] where in its pixel a lane's sample lies, pixels
    global const float *restrict sample_y,       // [VECTOR_WIDTH]
    global const float4 *restrict corners,       // [3 * triangle_count] canonical corners and normals
    global const uint *restrict tile_begin,      // [tile_count + 1] first reference of each tile
    global const uint *restrict reference_prims,   // [padded reference_capacity] prim_id
    global const uint *restrict reference_bounds,  // [padded reference_capacity] bound within the tile
    global const uint *restrict places,          // [band height * width] a pixel's place in the list, or NO_HIT
#if COUNTERS
    uint pixel_count,                            // of the band
    global ulong *restrict work,                 // [tile_count * WORK_COUNTER_COUNT] added to
    global uint *restrict cost,                  // [3 * pixel_count] evaluations, setups, steps, added to
#endif
    global uint *restrict sample_prims)          // [listed * stride] prim_id or NO_HIT of VECTOR_WIDTH samples
{
  const uint tile = get_global_id(0);
  if (tile >= tile_count) return;
  const int left = tile % view.tile_columns << TILE_LOG2, top = (tile / view.tile_columns + view.band_row) << TILE_LOG2;
  const uint begin = tile_begin[tile], end = min(tile_begin[tile + 1], reference_capacity);
  const float_v lane_x = LOAD_V(sample_x), lane_y = LOAD_V(sample_y);
  TileFrame frame;
#if ALPHA_MASK
  const Surfaces surfaces = {material_ids, materials, textures, texels, srgb_to_linear, uv, uv1, colors};
  frame.surfaces = surfaces;
  frame.indices = indices;
#endif
  frame.column = frame.row = 0;
  frame.center_x = view.center_x;
  frame.center_y = view.center_y;
  TileSamples samples;
#if COUNTERS
  const Work none = {0, 0, 0, 0, 0, 0, 0, 0, 0};
  samples.work = none;
#endif
  for (uint k = 0; k < TILE_SQUARES * TILE_SQUARES; ++k) {
    Square square;
    square.left = k % TILE_SQUARES << SQUARE_LOG2;
    square.top = k / TILE_SQUARES << SQUARE_LOG2;
    if (!start_square(view, left, top, &square, &samples, everywhere, places)) continue;
    frame.x = (float)(left + square.left) + (lane_x - view.center_x);
    frame.y = (float)(top + square.top) + (lane_y - view.center_y);
    frame.left = LOWEST_V(frame.x);
    frame.top = LOWEST_V(frame.y);
    frame.right = -LOWEST_V(-frame.x);
    frame.bottom = -LOWEST_V(-frame.y);
    float lowest = NEARNESS_OF_NOTHING;
    Gathered gathered;
    gathered.count = 0;
    uint batches = 0;
    for (uint first = begin; first < end; first += VECTOR_WIDTH) {
      gather_references(&square, first, end, &gathered, reference_prims, reference_bounds);
      if (gathered.count < VECTOR_WIDTH && first + VECTOR_WIDTH < end) continue;
      while (gathered.count >= VECTOR_WIDTH || (gathered.count != 0 && first + VECTOR_WIDTH >= end)) {
        if (++batches % REFRESH_BATCHES == 0) lowest = refresh_lowest(&samples);
        decide_gathered(view, &frame, lowest, &gathered, &samples, corners);
      }
    }
    store_square(view, left, top, &square, &samples, everywhere, stride, first_entry, places, sample_prims);
#if COUNTERS
    add_costs(view, left, top, &square, &samples, pixel_count, cost);
#endif
  }
#if COUNTERS
  add_work(&samples.work, tile, work);
#endif
}

#endif
