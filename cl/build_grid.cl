// Builds a uniform grid over a scene's triangles: count, prefix sum, scatter, sort.
//
// Purcell et al., 'Ray Tracing on Programmable Graphics Hardware', sections 3.1.3 and 4.1, Fig. 4: each cell points to a
// list of triangles. Theirs is built before rendering begins; section 5.1 asks for a build on the device: here it is.
//   count_cell_triangles:    for each triangle, for each cell that it may touch: cell_counts[cell] += 1
//   sum_cell_counts, scan_cell_chunks, spread_cell_begins: where each cell's list begins
//   scatter_cell_triangles:  the same walk; references[cursor++] = prim_id, in any order
//   order_cell_triangles:    each list in the order of the triangles, whatever the scheduler did
// A triangle's cells: along the axis of its normal's largest component columns of cells stand on a grid of the other
// two axes. Columns that the triangle's projection touches (its three edges), and of each the cells that its plane
// passes through: as many steps as there are cells to find, not as its box has. Slivers have no plane that rounding
// leaves alone: they are walked slab by slab along their longest axis.
// All tests are padded (grid.clh) and then widened by the rounding of their own, so that none is missed.
// Good at: many triangles of a cell's size. Bad at: one work item takes one triangle, however large.
// Tests: tests/test_grid.py.

#include "vector.clh"

#define ROUNDINGS 9.5367431640625e-7f  // 2^-20: 16 roundings
#define LEAST_AREA 1.0e-30f            // products under this may have lost bits to underflow

// Where a triangle's walk over cells puts what it finds.
typedef struct {
  volatile global uint *cursors;  // [cell_count] counters, or next places
  global uint *references;        // prim_ids, or 0 while counting
  uint prim_id;
} CellSink;

// A triangle relative to the grid, its axes turned so that its normal's largest component comes last.
typedef struct {
  float x[3], y[3], z[3];
  float nx, ny, nz;
  float doubt;  // what rounding can have done to any of these
} TurnedTriangle;

typedef struct { float cell, inverse_cell, pad; int first, end; uint stride; } GridAxis;

INLINE float lowest_of(const float *a) { return min(a[0], min(a[1], a[2])); }

INLINE float highest_of(const float *a) { return max(a[0], max(a[1], a[2])); }

INLINE uint largest_of(const float *a) {
  const float x = fabs(a[0]), y = fabs(a[1]), z = fabs(a[2]);
  return x >= y && x >= z ? 0 : (y >= z ? 1 : 2);
}

// The cells along an axis that [low, high] may touch, padding included.
INLINE void find_range(GridAxis *axis, float low, float high, int first, int end) {
  axis->first = max((int)floor(clamp((low - axis->pad) * axis->inverse_cell, -1.0f, 4096.0f)), first);
  axis->end = min((int)floor(clamp((high + axis->pad) * axis->inverse_cell, -1.0f, 4096.0f)) + 1, end);
}

INLINE GridAxis axis_of(float cell, float inverse_cell, float pad, uint count, uint stride, const float *p) {
  GridAxis axis = {cell, inverse_cell, pad * 1.125f, 0, 0, stride};
  find_range(&axis, lowest_of(p), highest_of(p), 0, (int)count);
  return axis;
}

INLINE void emit_cell(CellSink sink, uint cell) {
  const uint place = atomic_inc(sink.cursors + cell);
  if (sink.references != 0) sink.references[place] = sink.prim_id;
}

// Whether the projection of a triangle onto x and y may touch the rectangle with that middle and half its sides:
// the rectangle's best corner lies inside of each edge, but for rounding (4 roundings of each product).
INLINE bool touches_projection(const TurnedTriangle *t, float x, float y, float half_x, float half_y) {
  for (uint i = 0; i < 3; ++i) {
    const uint j = i == 2 ? 0 : i + 1;
    const float ex = t->x[j] - t->x[i], ey = t->y[j] - t->y[i], rx = x - t->x[i], ry = y - t->y[i];
    const float best = fabs(ex) * half_y + fabs(ey) * half_x;
    const float slack = ROUNDINGS * (fabs(ex) * (fabs(ry) + half_y) + fabs(ey) * (fabs(rx) + half_x)) + LEAST_AREA;
    const float side = ex * ry - ey * rx;
    if ((t->nz < 0.0f ? -side : side) < -(best + slack)) return false;
  }
  return true;
}

// Visits the cells of a triangle with a plane. x, y, z : the grid's axes, turned as the triangle's are.
static void walk_plane(const TurnedTriangle *t, GridAxis x, GridAxis y, GridAxis z, CellSink sink) {
  const float half_x = 0.5f * x.cell + x.pad, half_y = 0.5f * y.cell + y.pad;
  const float slope_x = t->nx / t->nz, slope_y = t->ny / t->nz, doubt = 4.0f * t->doubt / fabs(t->nz) + ROUNDINGS;
  const float reach = fabs(slope_x) * half_x + fabs(slope_y) * half_y;
  for (int j = y.first; j < y.end; ++j)
    for (int i = x.first; i < x.end; ++i) {
      const float middle_x = ((float)i + 0.5f) * x.cell, middle_y = ((float)j + 0.5f) * y.cell;
      if (!touches_projection(t, middle_x, middle_y, half_x, half_y)) continue;
      const float rx = middle_x - t->x[0], ry = middle_y - t->y[0];
      const float height = t->z[0] - (slope_x * rx + slope_y * ry);
      const float slack =
          doubt * (fabs(rx) + fabs(ry) + half_x + half_y) + ROUNDINGS * (fabs(t->z[0]) + fabs(height) + reach);
      GridAxis column = z;
      find_range(&column, height - reach - slack, height + reach + slack, z.first, z.end);
      const uint base = (uint)i * x.stride + (uint)j * y.stride;
      for (int k = column.first; k < column.end; ++k) emit_cell(sink, base + (uint)k * z.stride);
    }
}

// Widens [low, high] by what an edge from p to q has between x0 and x1: all of it where it is steep.
INLINE void clip_edge(float px, float py, float qx, float qy, bool is_steep, float x0, float x1, float2 *range) {
  if (max(px, qx) < x0 || min(px, qx) > x1) return;
  float from = py, to = qy;
  if (!is_steep) {
    from = py + (qy - py) * clamp((x0 - px) / (qx - px), 0.0f, 1.0f);
    to = py + (qy - py) * clamp((x1 - px) / (qx - px), 0.0f, 1.0f);
  }
  *range = (float2)(min(range->x, min(from, to)), max(range->y, max(from, to)));
}

// Visits the cells of a sliver, which is hardly more than a line: slab by slab along x, its longest axis, the box of
// what lies in the slab.
static void walk_sliver(const TurnedTriangle *t, GridAxis x, GridAxis y, GridAxis z, CellSink sink) {
  for (int i = x.first; i < x.end; ++i) {
    const float x0 = (float)i * x.cell - x.pad, x1 = (float)(i + 1) * x.cell + x.pad;
    float2 in_y = (float2)(INFINITY, -INFINITY), in_z = (float2)(INFINITY, -INFINITY);
    for (uint k = 0; k < 3; ++k) {
      const uint n = k == 2 ? 0 : k + 1;
      const float dx = fabs(t->x[n] - t->x[k]);
      const bool is_steep = !(dx > fabs(t->y[n] - t->y[k]) && dx > fabs(t->z[n] - t->z[k]));
      clip_edge(t->x[k], t->y[k], t->x[n], t->y[n], is_steep, x0, x1, &in_y);
      clip_edge(t->x[k], t->z[k], t->x[n], t->z[n], is_steep, x0, x1, &in_z);
    }
    if (!(in_y.x <= in_y.y && in_z.x <= in_z.y)) continue;
    GridAxis rows = y, column = z;
    find_range(&rows, in_y.x, in_y.y, y.first, y.end);
    find_range(&column, in_z.x, in_z.y, z.first, z.end);
    for (int j = rows.first; j < rows.end; ++j)
      for (int k = column.first; k < column.end; ++k)
        emit_cell(sink, (uint)i * x.stride + (uint)j * y.stride + (uint)k * z.stride);
  }
}

// Turns triangle `prim_id` and the grid's axes, and visits its cells.
static void visit_cells(Grid grid, global const float4 *corners, CellSink sink) {
  float p[3][3];
  for (uint i = 0; i < 3; ++i) {
    const float4 corner = corners[3 * (size_t)sink.prim_id + i] - grid.low;
    p[0][i] = corner.x;
    p[1][i] = corner.y;
    p[2][i] = corner.z;
  }
  float n[3], size[3];
  for (uint a = 0; a < 3; ++a) {
    const uint b = (a + 1) % 3, c = (a + 2) % 3;
    n[a] = (p[b][1] - p[b][0]) * (p[c][2] - p[c][0]) - (p[c][1] - p[c][0]) * (p[b][2] - p[b][0]);
    size[a] = highest_of(p[a]) - lowest_of(p[a]);
  }
  // Each component is a difference of two products of differences: 7 roundings of what the products may be.
  const float doubt = 0.5f * ROUNDINGS * max(size[0] * size[1], max(size[1] * size[2], size[2] * size[0]));
  const uint face = largest_of(n), length = largest_of(size);
  const bool is_plane = fabs(n[face]) > 1024.0f * doubt && fabs(n[face]) > LEAST_AREA;
  const uint a = is_plane ? (face + 1) % 3 : length, b = (a + 1) % 3, c = (a + 2) % 3;
  TurnedTriangle t;
  for (uint i = 0; i < 3; ++i) {
    t.x[i] = p[a][i];
    t.y[i] = p[b][i];
    t.z[i] = p[c][i];
  }
  t.nx = n[a];
  t.ny = n[b];
  t.nz = n[c];
  t.doubt = doubt;
  const GridAxis axes[3] = {
      axis_of(grid.cell.x, grid.inverse_cell.x, grid.pad.x, grid.columns, 1, p[0]),
      axis_of(grid.cell.y, grid.inverse_cell.y, grid.pad.y, grid.rows, grid.columns, p[1]),
      axis_of(grid.cell.z, grid.inverse_cell.z, grid.pad.z, grid.layers, grid.columns * grid.rows, p[2])};
  if (is_plane) walk_plane(&t, axes[a], axes[b], axes[c], sink);
  else walk_sliver(&t, axes[a], axes[b], axes[c], sink);
}

// Reads: corners (prepare_triangles). Writes: cell_counts (for sum_cell_counts). Work item: one triangle.
// Local memory: 0 bytes.
kernel void count_cell_triangles(
    Grid grid,
    uint triangle_count,
    global const float4 *restrict corners,  // [3 * triangle_count]
    volatile global uint *cell_counts)      // [cell_count] added to
{
  const uint prim_id = get_global_id(0);
  if (prim_id >= triangle_count) return;
  const CellSink sink = {cell_counts, 0, prim_id};
  visit_cells(grid, corners, sink);
}

// Reads: cell_counts (count_cell_triangles). Writes: chunk_sums (for scan_cell_chunks). Work item: CELL_CHUNK cells.
// Local memory: 0 bytes.
kernel void sum_cell_counts(
    uint cell_count,
    global const uint *restrict cell_counts,  // [cell_count]
    global ulong *restrict chunk_sums)        // [chunks]
{
  const uint begin = get_global_id(0) * CELL_CHUNK;
  if (begin >= cell_count) return;
  ulong sum = 0;
  for (uint cell = begin; cell < min(begin + CELL_CHUNK, cell_count); ++cell) sum += cell_counts[cell];
  chunk_sums[begin / CELL_CHUNK] = sum;
}

// Reads: chunk_sums (sum_cell_counts). Writes: chunk_sums (for spread_cell_begins and the host). Work item: only one.
// Local memory: 0 bytes.
kernel void scan_cell_chunks(
    uint chunk_count,
    global ulong *restrict chunk_sums)  // [chunks + 1] sums, then exclusive sums and the total
{
  if (get_global_id(0) != 0) return;
  ulong total = 0;
  for (uint k = 0; k < chunk_count; ++k) {
    const ulong sum = chunk_sums[k];
    chunk_sums[k] = total;
    total += sum;
  }
  chunk_sums[chunk_count] = total;
}

// Reads: chunk_sums (scan_cell_chunks). Writes: cell_begin (for walks), cell_counts (for scatter_cell_triangles: next
// places). Work item: CELL_CHUNK cells. Local memory: 0 bytes.
kernel void spread_cell_begins(
    uint cell_count,
    global const ulong *restrict chunk_sums,  // [chunks + 1]
    global uint *restrict cell_counts,        // [cell_count] counts, then where each list begins
    global uint *restrict cell_begin)         // [cell_count + 1]
{
  const uint begin = get_global_id(0) * CELL_CHUNK;
  if (begin >= cell_count) return;
  const uint end = min(begin + CELL_CHUNK, cell_count);
  uint place = (uint)chunk_sums[begin / CELL_CHUNK];
  for (uint cell = begin; cell < end; ++cell) {
    const uint count = cell_counts[cell];
    cell_begin[cell] = cell_counts[cell] = place;
    place += count;
  }
  if (end == cell_count) cell_begin[cell_count] = place;
}

// Reads: corners (prepare_triangles), cell_cursors (spread_cell_begins). Writes: references (for order_cell_triangles).
// Work item: one triangle. Local memory: 0 bytes.
kernel void scatter_cell_triangles(
    Grid grid,
    uint triangle_count,
    global const float4 *restrict corners,  // [3 * triangle_count]
    volatile global uint *cell_cursors,     // [cell_count] next place of each list
    global uint *references)                // [reference_count] prim_ids
{
  const uint prim_id = get_global_id(0);
  if (prim_id >= triangle_count) return;
  const CellSink sink = {cell_cursors, references, prim_id};
  visit_cells(grid, corners, sink);
}

// Restores a heap whose root alone may be too small.
INLINE void sift_down(global uint *heap, uint root, uint count) {
  while (2 * root + 1 < count) {
    uint child = 2 * root + 1;
    if (child + 1 < count && heap[child] < heap[child + 1]) ++child;
    if (heap[root] >= heap[child]) return;
    const uint moved = heap[root];
    heap[root] = heap[child];
    heap[child] = moved;
    root = child;
  }
}

// Reads: cell_begin (spread_cell_begins). Writes: references (for walks). Work item: ORDER_CHUNK cells.
// Local memory: 0 bytes.
kernel void order_cell_triangles(
    uint cell_count,
    global const uint *restrict cell_begin,  // [cell_count + 1]
    global uint *references)                 // [reference_count] prim_ids; in each cell rising
{
  const uint first_cell = get_global_id(0) * ORDER_CHUNK;
  if (first_cell >= cell_count) return;
  for (uint cell = first_cell; cell < min(first_cell + ORDER_CHUNK, cell_count); ++cell) {
    global uint *list = references + cell_begin[cell];
    const uint count = cell_begin[cell + 1] - cell_begin[cell];
    if (count <= SHORT_LIST) {
      for (uint k = 1; k < count; ++k) {
        const uint moved = list[k];
        uint place = k;
        for (; place > 0 && list[place - 1] > moved; --place) list[place] = list[place - 1];
        list[place] = moved;
      }
      continue;
    }
    for (uint root = count / 2; root-- > 0;) sift_down(list, root, count);
    for (uint last = count - 1; last > 0; --last) {
      const uint largest = list[0];
      list[0] = list[last];
      list[last] = largest;
      sift_down(list, 0, last);
    }
  }
}
