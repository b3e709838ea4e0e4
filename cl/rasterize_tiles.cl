// Decides every sample of a tile: edge functions, fill rule, nearness, visibility buffer.
//
// Davidovic et al., '3D Rasterization', section 3.2 (direct evaluation of equation (2)), section 3.4
// (consistency). One work-item is one tile; its nearness and ids stay in private memory.
//   for 16 references of the tile at a time: set their triangles up, one a lane
//     for each of them, for each block of 4 x 4 samples in its bound:
//       V_i = (c_i + X gx_i) + Y gy_i;  w likewise
//       inside all edges and nearer than what is there: keep w and prim_id
// References come in the order of triangles, so 'nearer' alone makes the smaller id win a tie.
// With KEEP_NEARNESS the tile's state goes to memory and back, so that a tile's list can be split over
// launches (drivers that limit loops), and hits behind a layer that was found before can be sought.
// Tried on PoCL 3.1 (Zen 5, 16 lanes) and left out, in per cent of this kernel's time: fma in the edge functions
// (-5, but a subnormal operand may be flushed), near half of a tile's list first by 12-bit keys (+15), Morton order
// of the triangles and near chunks first with a tie rule by id (+15), one list of blocks per batch (+15), testing
// each block of a small triangle against the nearness that is there (+3), a maximum for the blend (0).
// Good at: small and middle triangles, any mix. Bad at: depth complexity (all layers are evaluated).
// Tests: tests/test_rasterizer.py, tests/test_hard_cases.py.

#include "vector.clh"
#include "edge_function.clh"
#if ALPHA_MASK
#include "surface.clh"
#endif
#include "triangle_batch.clh"

#define TILE_BLOCK_COLUMNS (TILE_SIZE / BLOCK_COLUMNS)
#define TILE_BLOCK_ROWS (TILE_SIZE / BLOCK_ROWS)
#define TILE_BLOCKS (TILE_BLOCK_COLUMNS * TILE_BLOCK_ROWS)

#define REFRESH_PERIOD TILE_BLOCKS  // references between updates of the culling bounds

// The samples of one tile: private memory, block by block.
typedef struct {
  float_v nearness[TILE_BLOCKS];  // of the nearest triangle so far
  uint_v visible[TILE_BLOCKS];    // its prim_id
  float lowest[TILE_BLOCKS];      // lower bounds of the blocks' nearness, for culling
#if KEEP_NEARNESS
  float_v front_nearness[TILE_BLOCKS];  // of the layer in front: only what lies behind it is a hit
  uint_v front_prims[TILE_BLOCKS];
#endif
} TileSamples;

#if ALPHA_MASK
// Takes out the lanes whose surface has less alpha than its material's cutoff (glTF alpha mode MASK).
static inline int_v mask_samples(const TileTriangle *t, const TileFrame *frame, int_v pass, float_v v0, float_v v1, float_v v2) {
  int lane_pass[VECTOR_WIDTH];
  float lane_v0[VECTOR_WIDTH], lane_v1[VECTOR_WIDTH], lane_v2[VECTOR_WIDTH];
  STORE_V(pass, lane_pass);
  STORE_V(v0, lane_v0);
  STORE_V(v1, lane_v1);
  STORE_V(v2, lane_v2);
  const uint prim_id = t->lane_prim_id;
  const Material material = frame->surfaces.materials[frame->surfaces.material_ids[prim_id]];
  SurfacePoint at;
  at.prim_id = prim_id;
  at.i0 = frame->indices[3 * prim_id];
  at.i1 = frame->indices[3 * prim_id + 1];
  at.i2 = frame->indices[3 * prim_id + 2];
  for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) {
    if (!lane_pass[lane]) continue;
    weigh_vertices(&at, lane_v0[lane], lane_v1[lane], lane_v2[lane]);
    if (base_color(frame->surfaces, material, at).w < material.alpha_cutoff) lane_pass[lane] = 0;
  }
  return LOAD_V(lane_pass);
}
#endif

// The samples of one block against one triangle; returns the block's nearness.
INLINE float_v rasterize_block(const TileTriangle *t, const TileFrame *frame, int block_column, int block_row,
                               TileSamples *samples) {
  const int block = block_row * TILE_BLOCK_COLUMNS + block_column;
  const float_v x = frame->x + (float)(block_column * BLOCK_COLUMNS);
  const float_v y = frame->y + (float)(block_row * BLOCK_ROWS);
  const int_v column = frame->column + block_column * BLOCK_COLUMNS;
  const int_v row = frame->row + block_row * BLOCK_ROWS;
  const float_v v0 = edge_value(t->c[0], t->gx[0], t->gy[0], x, y);
  const float_v v1 = edge_value(t->c[1], t->gx[1], t->gy[1], x, y);
  const float_v v2 = edge_value(t->c[2], t->gx[2], t->gy[2], x, y);
  const float_v near = edge_value(t->depth_c, t->depth_x, t->depth_y, x, y);
  int_v pass = (row >= t->y0) & (row < t->y1) & (column >= t->x0) & (column < t->x1);
  pass &= sample_outside(v0, v1, v2, t->exclusive[0], t->exclusive[1], t->exclusive[2]) >= 0;
  pass &= near > samples->nearness[block];
#if PROJECTION == PROJECTION_ORTHOGRAPHIC
  pass &= near < 0.0f;
#endif
#if KEEP_NEARNESS
  // Behind the layer in front: lower nearness, or the same and a larger id.
  const float_v front = samples->front_nearness[block];
  pass &= (near < front) | ((near == front) & (t->prim_id > samples->front_prims[block]));
#endif
#if ALPHA_MASK
  if (t->masked) pass &= mask_samples(t, frame, pass, v0, v1, v2);
#endif
  const float_v nearest = pass ? near : samples->nearness[block];
  samples->nearness[block] = nearest;
  samples->visible[block] = pass ? t->prim_id : samples->visible[block];
  return nearest;
}

// Few blocks: each is evaluated, since finding out which are empty costs as much.
INLINE void rasterize_small(const Batch *batch, uint lane, const TileFrame *frame, TileSamples *samples) {
  const TileTriangle t = spread_lane(batch, lane);
  const int first_column = batch->first_column[lane], end_column = batch->end_column[lane];
  const int end_row = batch->end_row[lane];
  for (int row = batch->first_row[lane]; row < end_row; ++row)
    for (int column = first_column; column < end_column; ++column) rasterize_block(&t, frame, column, row, samples);
}

// Many blocks: VECTOR_WIDTH of them at a time are tested against the edges and the nearness that is
// there already (the tile's own level of a hierarchical w-buffer); both tests are exact by monotonicity.
INLINE void rasterize_large(const Batch *batch, uint lane, const TileFrame *frame, TileSamples *samples) {
  const TileTriangle t = spread_lane(batch, lane);
  const int first = batch->first_row[lane] * TILE_BLOCK_COLUMNS;
  const int end = batch->end_row[lane] * TILE_BLOCK_COLUMNS;
  for (int base = first & -VECTOR_WIDTH; base < end; base += VECTOR_WIDTH) {
    const int_v block = LANES + base;
    const int_v left = (block & (TILE_BLOCK_COLUMNS - 1)) * BLOCK_COLUMNS;
    const int_v top = (block / TILE_BLOCK_COLUMNS) * BLOCK_ROWS;
    const int_v x0 = max(left, t.x0), x1 = min(left + BLOCK_COLUMNS, t.x1) - 1;
    const int_v y0 = max(top, t.y0), y1 = min(top + BLOCK_ROWS, t.y1) - 1;
    const float_v low_x = TO_FLOAT_V(x0) + frame->left, high_x = TO_FLOAT_V(x1) + frame->left;
    const float_v low_y = TO_FLOAT_V(y0) + frame->top, high_y = TO_FLOAT_V(y1) + frame->top;
    int_v may_hit = (x0 <= x1) & (y0 <= y1);
    may_hit &= block_highest(t.c[0], t.gx[0], t.gy[0], low_x, low_y, high_x, high_y) >= 0.0f;
    may_hit &= block_highest(t.c[1], t.gx[1], t.gy[1], low_x, low_y, high_x, high_y) >= 0.0f;
    may_hit &= block_highest(t.c[2], t.gx[2], t.gy[2], low_x, low_y, high_x, high_y) >= 0.0f;
    const float_v nearest = block_highest(t.depth_c, t.depth_x, t.depth_y, low_x, low_y, high_x, high_y);
    may_hit &= nearest > LOAD_V(samples->lowest + base);
    for (ulong mask = LANE_MASK(may_hit); mask != 0; mask &= mask - 1) {
      const uint hit = base + first_lane(mask);
      samples->lowest[hit] =
          LOWEST_V(rasterize_block(&t, frame, hit % TILE_BLOCK_COLUMNS, hit / TILE_BLOCK_COLUMNS, samples));
    }
  }
}

// Recomputes the culling bounds of all blocks and returns the lowest.
INLINE float refresh_lowest(TileSamples *samples) {
  float_v tile_lowest = samples->nearness[0];
  for (uint block = 0; block < TILE_BLOCKS; ++block) {
    samples->lowest[block] = LOWEST_V(samples->nearness[block]);
    tile_lowest = min(tile_lowest, samples->nearness[block]);
  }
  return LOWEST_V(tile_lowest);
}

// Whether lane `lane` of a block lies in the image, and where in the band's buffers.
INLINE bool find_pixel(View view, int left, int top, uint block, uint lane, size_t *pixel) {
  const uint x = left + block % TILE_BLOCK_COLUMNS * BLOCK_COLUMNS + lane % BLOCK_COLUMNS;
  const uint y = top + block / TILE_BLOCK_COLUMNS * BLOCK_ROWS + lane / BLOCK_COLUMNS;
  *pixel = (size_t)(y - (view.band_row << TILE_LOG2)) * view.width + x;
  return x < view.width && y < view.height;
}

// Writes a tile's blocks as rows of the image; the last tiles may stick out of it.
INLINE void store_tile(View view, int left, int top, const uint_v *visible, global uint *restrict visible_prims) {
  const bool whole = left + TILE_SIZE <= (int)view.width && top + TILE_SIZE <= (int)view.height;
  for (uint block = 0; block < TILE_BLOCKS; ++block) {
    uint ids[VECTOR_WIDTH];
    size_t pixel;
    STORE_V(visible[block], ids);
    if (whole) {
      find_pixel(view, left, top, block, 0, &pixel);
      for (uint row = 0; row < BLOCK_ROWS; ++row)
        STORE_BLOCK_ROW(ids + row * BLOCK_COLUMNS, visible_prims + pixel + (size_t)row * view.width);
    } else {
      for (uint lane = 0; lane < VECTOR_WIDTH; ++lane)
        if (find_pixel(view, left, top, block, lane, &pixel)) visible_prims[pixel] = ids[lane];
    }
  }
}

// A tile that no triangle may cover: rows of NO_HIT.
INLINE void clear_tile(View view, int left, int top, global uint *restrict visible_prims) {
  const uint end_x = min((uint)left + TILE_SIZE, view.width), end_y = min((uint)top + TILE_SIZE, view.height);
  for (uint y = top; y < end_y; ++y)
    for (uint x = left; x < end_x; ++x)
      visible_prims[(size_t)(y - (view.band_row << TILE_LOG2)) * view.width + x] = NO_HIT;
}

#if KEEP_NEARNESS
// Reads one 32-bit value per sample of a block; `nothing` outside the image.
static inline uint_v load_block(View view, int left, int top, uint block, global const uint *from, uint nothing) {
  uint lanes[VECTOR_WIDTH];
  for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) {
    size_t pixel;
    lanes[lane] = find_pixel(view, left, top, block, lane, &pixel) ? from[pixel] : nothing;
  }
  return LOAD_V(lanes);
}

static inline float_v load_nearness(View view, int left, int top, uint block, global const float *from) {
  return AS_FLOAT_V(load_block(view, left, top, block, (global const uint *)from, as_uint(NEARNESS_OF_NOTHING)));
}

static inline void store_nearness(View view, int left, int top, const float_v *nearness, global float *to) {
  for (uint block = 0; block < TILE_BLOCKS; ++block) {
    float lanes[VECTOR_WIDTH];
    STORE_V(nearness[block], lanes);
    for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) {
      size_t pixel;
      if (find_pixel(view, left, top, block, lane, &pixel)) to[pixel] = lanes[lane];
    }
  }
}
#endif

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
    global const float *restrict srgb_to_linear, // [256]
    global const float2 *restrict uv,            // [vertex_count]
    global const float2 *restrict uv1,           // [vertex_count]
    global const float4 *restrict colors,        // [vertex_count] linear
#endif
    global const float4 *restrict corners,    // [3 * triangle_count] canonical corners and normals
    global const uint *restrict tile_begin,   // [tile_count + 1] first reference of each tile
    global const uint *restrict reference_prims,  // [reference_capacity] prim_id
    global const uint *restrict reference_bounds, // [padded reference_capacity] bound within the tile
    global uint *restrict visible_prims)      // [band height * width] prim_id or NO_HIT
{
  const uint tile = get_global_id(0);
  if (tile >= tile_count) return;
  const uint column = tile % view.tile_columns, row = tile / view.tile_columns;
  const int left = column << TILE_LOG2, top = (row + view.band_row) << TILE_LOG2;
#if !KEEP_NEARNESS
  if (tile_begin[tile] == tile_begin[tile + 1]) {
    clear_tile(view, left, top, visible_prims);
    return;
  }
#endif
  TileFrame frame;
  frame.column = BLOCK_COLUMN_LANES;
  frame.row = BLOCK_ROW_LANES;
  frame.left = (float)left + (0.5f - view.center_x);
  frame.top = (float)top + (0.5f - view.center_y);
  frame.x = TO_FLOAT_V(frame.column) + frame.left;
  frame.y = TO_FLOAT_V(frame.row) + frame.top;
#if ALPHA_MASK
  const Surfaces surfaces = {material_ids, materials, textures, texels, srgb_to_linear, uv, uv1, colors};
  frame.surfaces = surfaces;
  frame.indices = indices;
#endif

  TileSamples samples;
  for (uint block = 0; block < TILE_BLOCKS; ++block) {
    samples.nearness[block] = NEARNESS_OF_NOTHING;
    samples.visible[block] = NO_HIT;
    samples.lowest[block] = NEARNESS_OF_NOTHING;
#if KEEP_NEARNESS
    samples.front_nearness[block] = INFINITY;
    samples.front_prims[block] = NO_HIT;
    if (layer > 0) {
      // Where nothing lies in front, nothing lies behind either.
      samples.front_nearness[block] = load_nearness(view, left, top, block, front_nearness);
      samples.front_prims[block] = load_block(view, left, top, block, front_prims, NO_HIT);
    }
    if (resume) {
      samples.nearness[block] = load_nearness(view, left, top, block, nearness);
      samples.visible[block] = load_block(view, left, top, block, visible_prims, NO_HIT);
    }
#endif
  }

  uint begin = tile_begin[tile], end = min(tile_begin[tile + 1], reference_capacity);
#if KEEP_NEARNESS
  begin = min(begin + first_reference, end);
  end = begin + min(reference_span, end - begin);
#endif
  float tile_lowest = NEARNESS_OF_NOTHING;
  for (uint k = begin; k < end; k += VECTOR_WIDTH) {
    if (k != begin && (k - begin) % REFRESH_PERIOD == 0) tile_lowest = refresh_lowest(&samples);
    Batch batch;
    load_batch(&batch, view, &frame, tile_lowest, k, end, corners, reference_prims, reference_bounds);
    for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) {
      if (batch.work[lane] == WORK_SMALL)
        rasterize_small(&batch, lane, &frame, &samples);
      else if (batch.work[lane] == WORK_LARGE)
        rasterize_large(&batch, lane, &frame, &samples);
    }
  }
  store_tile(view, left, top, samples.visible, visible_prims);
#if KEEP_NEARNESS
  store_nearness(view, left, top, samples.nearness, nearness);
#endif
}
