// Sorts triangles into the tiles that they may cover: count, prefix sum, scatter.
//
// Davidovic et al., '3D Rasterization', section 3.1 ('binning') and section 4. No atomics: a chunk of
// triangles has tile counters of its own, a scan turns them into positions, and every tile's list
// comes out in the order of the triangles, whatever the scheduler does.
//   count_tile_triangles:    for each triangle of the chunk: cursors[chunk][tile] += 1
//   sum_tile_counts:         cursors -> exclusive sums over the chunks; references of each tile
//   scan_tiles:              starts of the tiles' lists
//   scatter_tile_triangles:  the same walk; references[begin + cursor++] = (prim_id, bound within the tile)
// A wide triangle (large, or across the eye's plane) is walked through a hierarchy of screen blocks,
// 4 x 4 tiles and then tiles, VECTOR_WIDTH of them at a time, each kept where all three edge functions
// allow a sample in it. The test is exact (see edge_function.clh), so it never loses a sample.
// Good at: any mix of sizes. Bad at: images so large that chunk_count * tile_count counters outgrow
// the cache. Tests: tests/test_rasterizer.py.

#include "vector.clh"
#include "counters.clh"
#include "edge_function.clh"

#define TILE_SIZE (1 << TILE_LOG2)

// Rows of tiles of the band.
INLINE int first_row(View view) { return (int)(view.band_top >> TILE_LOG2); }
INLINE int last_row(View view) { return (int)((view.band_top + view.band_height - 1) >> TILE_LOG2); }
#define GROUP_LOG2 2  // a group is 4 x 4 tiles
#define WALK (-1)     // of a lane: more than one tile
#define SKIP (-2)     // of a lane: no sample

// Where the walk of one chunk puts what it finds: counters, and for the scatter references too.
typedef struct {
  global uint *cursors;           // [tile_stride] of this chunk: counters, or next positions in the tile's list
  global const uint *tile_begin;  // [tile_stride + 1] where the lists start
  global uint *reference_prims;   // [capacity], or 0 while counting
  global uint *reference_bounds;  // [capacity], likewise
  uint capacity;
#if COUNTERS
  Work *work;
#endif
} TileSink;

// A triangle and its bound in pixels.
typedef struct { uint prim_id; int x0, y0, x1, y1; } BoundedTriangle;

// Counts or stores one reference.
INLINE void emit_reference(TileSink sink, uint tile, uint prim_id, uint bound) {
  const uint position = sink.cursors[tile]++;
  if (sink.reference_prims == 0) return;
  const uint slot = sink.tile_begin[tile] + position;
  if (slot >= sink.capacity) return;
  sink.reference_prims[slot] = prim_id;
  sink.reference_bounds[slot] = bound;
}

// Counts or stores VECTOR_WIDTH references to one tile, of triangles that follow each other.
INLINE void emit_run(TileSink sink, uint tile, uint first_prim_id, int_v bounds) {
  const uint position = sink.cursors[tile];
  sink.cursors[tile] = position + VECTOR_WIDTH;
  if (sink.reference_prims == 0) return;
  const uint slot = sink.tile_begin[tile] + position;
  if (slot + VECTOR_WIDTH > sink.capacity) return;
  STORE_V(AS_UINT_V(LANES) + first_prim_id, sink.reference_prims + slot);
  STORE_V(AS_UINT_V(bounds), sink.reference_bounds + slot);
}

// One (tile, triangle) pair; column and row are the tile's, in the whole image.
INLINE void emit_tile(TileSink sink, View view, BoundedTriangle s, int column, int row) {
  const int left = column << TILE_LOG2, top = row << TILE_LOG2;
  const int x0 = max(s.x0 - left, 0), y0 = max(s.y0 - top, 0);
  const int x1 = min(s.x1 - left, TILE_SIZE), y1 = min(s.y1 - top, TILE_SIZE);
  const uint tile = (row - first_row(view)) * view.tile_columns + column;
  emit_reference(sink, tile, s.prim_id, x0 | y0 << 8 | x1 << 16 | y1 << 24);
}

// Mask per lane: the screen block with its first pixel at (left, top) may hold a sample of the triangle.
INLINE int_v blocks_may_hit(TriangleSetup setup, View view, BoundedTriangle s, int_v left, int_v top, int size) {
#if FIXED
  int_v may_cover = setup.valid;
  for (uint i = 0; i < 3; ++i) {
    const SnappedEdge edge = setup.snapped[i];
    const int_v x = edge.gx > 0 ? min(left + size, s.x1) - 1 : max(left, s.x0);
    const int_v y = edge.gy > 0 ? min(top + size, s.y1) - 1 : max(top, s.y0);
    const long_v upper = max(snapped_value(edge, view.samples_left - view.center_x, view.samples_top - view.center_y),
                             snapped_value(edge, view.samples_right - view.center_x, view.samples_top - view.center_y));
    const long_v lower = max(snapped_value(edge, view.samples_left - view.center_x, view.samples_bottom - view.center_y),
                             snapped_value(edge, view.samples_right - view.center_x, view.samples_bottom - view.center_y));
    const long_v v = max(upper, lower);
    may_cover &= TO_INT_V((v + TO_LONG_V(x) * TO_LONG_V(edge.gx) + TO_LONG_V(y) * TO_LONG_V(edge.gy)) >> 32) >= 0;
  }
  return may_cover;
#else
  const float_v x0 = TO_FLOAT_V(max(left, s.x0)) + (view.samples_left - view.center_x);
  const float_v y0 = TO_FLOAT_V(max(top, s.y0)) + (view.samples_top - view.center_y);
  const float_v x1 = TO_FLOAT_V(min(left + size, s.x1)) + (view.samples_right - 1.0f - view.center_x);
  const float_v y1 = TO_FLOAT_V(min(top + size, s.y1)) + (view.samples_bottom - 1.0f - view.center_y);
  int_v may_hit = setup.valid;
  const BlockRange range = BLOCK_RANGE(view, x0, y0, x1, y1);
#pragma unroll
  for (uint i = 0; i < 3; ++i) {
    const float_v highest = block_highest(setup.edge[i].c, setup.edge[i].gx, setup.edge[i].gy, range);
#if !PLANAR
    may_hit &= highest >= setup.bar;
#elif EVALUATION == EVALUATION_INCREMENTAL
    // Sums of up to 2 * INCREMENT_CELL / 4 increments stray from the value: as far as this, and no farther.
    may_hit &= highest >= -INCREMENT_SLACK * (fabs(setup.edge[i].c) + fabs(setup.edge[i].gx) * view.center_x +
                                              fabs(setup.edge[i].gy) * view.center_y);
#else
    may_hit &= highest >= 0.0f;
#endif
  }
#if !PLANAR && !FILTERED
  // t > 0: near the antipode of a small triangle its three edges reject nothing.
  may_hit &= block_highest(setup.nearness.c, setup.nearness.x, setup.nearness.y, range) > 0.0f;
#endif
  return may_hit;
#endif
}

// Visits the tiles of one group of 4 x 4 tiles that the triangle may touch, row by row.
INLINE void walk_group(
    TileSink sink, View view, BoundedTriangle s, TriangleSetup setup, int4 tiles, int group_column, int group_row) {
  for (int first = 0; first < 16; first += VECTOR_WIDTH) {
    const int_v tile = LANES + first;
    const int_v column = (tile & 3) + (group_column << GROUP_LOG2);
    const int_v row = (tile >> 2) + (group_row << GROUP_LOG2);
    int hit[VECTOR_WIDTH];
    STORE_V(blocks_may_hit(setup, view, s, column << TILE_LOG2, row << TILE_LOG2, TILE_SIZE), hit);
#if COUNTERS
    sink.work->edge_evaluations += VECTOR_WIDTH;
#endif
    for (int lane = 0; lane < VECTOR_WIDTH; ++lane) {
      const int c = ((lane + first) & 3) + (group_column << GROUP_LOG2);
      const int r = ((lane + first) >> 2) + (group_row << GROUP_LOG2);
      if (hit[lane] && c >= tiles.x && r >= tiles.y && c <= tiles.z && r <= tiles.w) emit_tile(sink, view, s, c, r);
    }
  }
}

// Visits every tile in `tiles` (first column, first row, last column, last row) through the hierarchy.
static void walk_wide(
    TileSink sink,
    View view,
    BoundedTriangle s,
    int4 tiles,
    global const float4 *restrict corners) {
  uint prim_id[VECTOR_WIDTH];
  for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) prim_id[lane] = s.prim_id;
#if FILTERED
  const TriangleSetup setup = setup_triangles_outwards(gather_triangles(corners, prim_id), view);
#else
  const TriangleSetup setup = setup_triangles_at(gather_triangles(corners, prim_id), view);
#endif
#if COUNTERS
  sink.work->setups += 1;
#endif
  const int4 groups = tiles >> GROUP_LOG2;
  const int group_columns = groups.z - groups.x + 1;
  const int group_count = group_columns * (groups.w - groups.y + 1);
  const int group_size = TILE_SIZE << GROUP_LOG2;
  for (int first = 0; first < group_count; first += VECTOR_WIDTH) {
    const int_v group = LANES + first;
    const int_v column = group % group_columns + groups.x;
    const int_v row = group / group_columns + groups.y;
    int hit[VECTOR_WIDTH];
    STORE_V(blocks_may_hit(setup, view, s, column * group_size, row * group_size, group_size), hit);
#if COUNTERS
    sink.work->edge_evaluations += min(VECTOR_WIDTH, group_count - first);
#endif
    for (int lane = 0; lane < VECTOR_WIDTH && first + lane < group_count; ++lane) {
      const int g = first + lane;
      if (hit[lane]) walk_group(sink, view, s, setup, tiles, g % group_columns + groups.x, g / group_columns + groups.y);
    }
  }
}

// All tiles of a triangle that covers more than one.
INLINE void walk_triangle(
    TileSink sink,
    View view,
    BoundedTriangle s,
    global const float4 *restrict corners) {
  const int4 tiles = (int4)(
      s.x0 >> TILE_LOG2,
      max(s.y0 >> TILE_LOG2, first_row(view)),
      (s.x1 - 1) >> TILE_LOG2,
      min((s.y1 - 1) >> TILE_LOG2, last_row(view)));
  if (tiles.y > tiles.w) return;
  if ((tiles.z - tiles.x + 1) * (tiles.w - tiles.y + 1) > WIDE_TILE_COUNT) {
    walk_wide(sink, view, s, tiles, corners);
    return;
  }
  for (int row = tiles.y; row <= tiles.w; ++row)
    for (int column = tiles.x; column <= tiles.z; ++column) emit_tile(sink, view, s, column, row);
}

// Walks the triangles of one chunk in order; what is done with each tile is the sink's business.
// The tile of a triangle that lies in just one is found for VECTOR_WIDTH of them at a time.
INLINE void walk_chunk(
    TileSink sink,
    View view,
    uint begin,
    uint end,
    global const uint *restrict bounds_low,
    global const uint *restrict bounds_high,
    global const float4 *restrict corners) {
  for (uint k = begin; k < end; k += VECTOR_WIDTH) {
    const uint_v low = LOAD_V(bounds_low + k), high = LOAD_V(bounds_high + k);
    const int_v x0 = AS_INT_V(low & 0xffffu), y0 = AS_INT_V(low >> 16);
    const int_v x1 = AS_INT_V(high & 0xffffu), y1 = AS_INT_V(high >> 16);
    const int_v column = x0 >> TILE_LOG2, row = y0 >> TILE_LOG2;
    const int_v single = (column == (x1 - 1) >> TILE_LOG2) & (row == (y1 - 1) >> TILE_LOG2) &
                         (row >= first_row(view)) & (row <= last_row(view));
    const int_v tile = (row - first_row(view)) * (int)view.tile_columns + column;
    const int_v left = column << TILE_LOG2, top = row << TILE_LOG2;
    const int_v kinds = single ? tile : (x1 == 0 ? (int_v)(SKIP) : (int_v)(WALK));
    const int_v bounds = (x0 - left) | (y0 - top) << 8 | (x1 - left) << 16 | (y1 - top) << 24;
    if (ALL_ALIKE(kinds)) {
      const int first = FIRST_LANE(kinds);
      if (first == SKIP) continue;
      if (first >= 0) {
        emit_run(sink, first, k, bounds);
        continue;
      }
    }
    int kind[VECTOR_WIDTH];  // tile where there is just one, else WALK or SKIP
    int bound[VECTOR_WIDTH];
    uint lane_low[VECTOR_WIDTH], lane_high[VECTOR_WIDTH];
    STORE_V(kinds, kind);
    STORE_V(bounds, bound);
    STORE_V(low, lane_low);
    STORE_V(high, lane_high);
    for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) {
      if (kind[lane] >= 0) {
        emit_reference(sink, kind[lane], k + lane, bound[lane]);
      } else if (kind[lane] == WALK) {
        const uint a = lane_low[lane], b = lane_high[lane];
        const BoundedTriangle s = {k + lane, a & 0xffff, a >> 16, b & 0xffff, b >> 16};
        walk_triangle(sink, view, s, corners);
      }
    }
  }
}

// Reads: bounds (setup_triangles). Writes: cursors (for sum_tile_counts).
// Work item: one chunk. Local memory: 0 bytes.
kernel void count_tile_triangles(
    View view,
    uint triangle_count,
    uint chunk_size,                         // triangles a chunk
    uint tile_stride,                        // tiles of the band, rounded up to a multiple of 16
    global const float4 *restrict corners,   // [3 * triangle_count]
    global const uint *restrict bounds_low,  // [padded triangle_count] x0 | y0 << 16
    global const uint *restrict bounds_high, // [padded triangle_count] x1 | y1 << 16
#if COUNTERS
    global ulong *restrict work,             // [chunks * WORK_COUNTER_COUNT] added to
#endif
    global uint *restrict cursors)           // [chunk_count * tile_stride] triangles of the chunk in the tile
{
  const uint chunk = get_global_id(0);
  global uint *own = cursors + (size_t)chunk * tile_stride;
  for (uint tile = 0; tile < tile_stride; tile += 16) vstore16((uint16)(0), 0, own + tile);
  TileSink sink = {own, 0, 0, 0, 0};
  const uint begin = chunk * chunk_size;
#if COUNTERS
  Work own_work = {0, 0, 0, 0, 0, 0, 0, 0, 0};
  sink.work = &own_work;
#endif
  walk_chunk(sink, view, begin, min(begin + chunk_size, triangle_count), bounds_low, bounds_high, corners);
#if COUNTERS
  add_work(&own_work, chunk, work);
#endif
}

// Reads: cursors (count_tile_triangles). Writes: cursors, as first positions within the tiles' lists;
// tile_counts (for scan_tiles). Work item: 16 tiles. Local memory: 0 bytes.
kernel void sum_tile_counts(
    uint chunk_count,
    uint tile_stride,                   // a multiple of 16
    global uint *restrict cursors,      // [chunk_count * tile_stride] in: counts, out: exclusive sums over chunks
    global uint *restrict tile_counts)  // [tile_stride] references of each tile
{
  const uint tile = get_global_id(0) * 16;
  if (tile >= tile_stride) return;
  uint16 position = 0;
  for (uint chunk = 0; chunk < chunk_count; ++chunk) {
    global uint *cell = cursors + (size_t)chunk * tile_stride + tile;
    const uint16 count = vload16(0, cell);
    vstore16(position, 0, cell);
    position += count;
  }
  vstore16(position, 0, tile_counts + tile);
}

// Reads: tile_counts (sum_tile_counts). Writes: tile_begin (for scatter_tile_triangles and
// rasterize_tiles). Work item: only one. Local memory: 0 bytes.
kernel void scan_tiles(
    uint tile_stride,
    global const uint *restrict tile_counts,  // [tile_stride]
    global uint *restrict tile_begin)         // [tile_stride + 1] exclusive sums, then the total
{
  if (get_global_id(0) != 0) return;
  uint total = 0;
  for (uint tile = 0; tile < tile_stride; ++tile) {
    tile_begin[tile] = total;
    total += tile_counts[tile];
  }
  tile_begin[tile_stride] = total;
}

// Reads: bounds (setup_triangles), cursors (sum_tile_counts), tile_begin (scan_tiles). Writes: references (for rasterize_tiles).
// Work item: one chunk. Local memory: 0 bytes.
kernel void scatter_tile_triangles(
    View view,
    uint triangle_count,
    uint chunk_size,
    uint tile_stride,
    uint reference_capacity,                 // references that fit; the rest is counted, not written
    global const float4 *restrict corners,   // [3 * triangle_count]
    global const uint *restrict bounds_low,  // [padded triangle_count]
    global const uint *restrict bounds_high, // [padded triangle_count]
    global const uint *restrict tile_begin,  // [tile_stride + 1] where the tiles' lists start
#if COUNTERS
    global ulong *restrict work,             // [chunks * WORK_COUNTER_COUNT] added to
#endif
    global uint *restrict cursors,           // [chunk_count * tile_stride] next position of the chunk in the list
    global uint *restrict reference_prims,   // [reference_capacity] prim_id
    global uint *restrict reference_bounds)  // [reference_capacity] in the tile: x0 | y0 << 8 | x1 << 16 | y1 << 24
{
  const uint chunk = get_global_id(0);
  TileSink sink = {cursors + (size_t)chunk * tile_stride, tile_begin, reference_prims, reference_bounds,
                   reference_capacity};
  const uint begin = chunk * chunk_size;
#if COUNTERS
  Work own_work = {0, 0, 0, 0, 0, 0, 0, 0, 0};
  sink.work = &own_work;
#endif
  walk_chunk(sink, view, begin, min(begin + chunk_size, triangle_count), bounds_low, bounds_high, corners);
#if COUNTERS
  add_work(&own_work, chunk, work);
#endif
}
