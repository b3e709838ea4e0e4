// A probe of incremental_edges.clh for tests: what sums give at single samples of a paraboloid.
//
// Arrays are planes of `count` numbers, one lane each. Tests: tests/test_incremental.py.

#include "vector.clh"
#include "edge_function.clh"

#if CURVED_SUMS
// Reads: normals, places. Writes: values. Work item: VECTOR_WIDTH samples, one after the other. Local memory: 0 bytes.
kernel void probe_sums(
    View view,
    uint count,                            // samples, a multiple of VECTOR_WIDTH
    global const float *restrict normals,  // [3][count]
    global const int *restrict places,     // [2][count] column and row of the pixel
    global float *restrict values)         // [count] V by sums, rim or not
{
  const uint first = get_global_id(0) * VECTOR_WIDTH;
  if (first >= count) return;
  const EdgePlane edge =
      edge_plane(view, LOAD_V(normals + first), LOAD_V(normals + count + first), LOAD_V(normals + 2 * count + first));
  for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) {
    const int column = places[first + lane], row = places[count + first + lane];
    const int cell_x = column & -INCREMENT_CELL, cell_y = row & -INCREMENT_CELL;
    EdgeSum sum = start_sum(view, edge, (float_v)((float)cell_x + (view.sample_x - view.center_x)),
                            (float_v)((float)cell_y + (view.sample_y - view.center_y)));
    for (int y = cell_y; y < (row & -4); y += 4) sum_down(&sum);
    for (int x = cell_x; x < (column & -4); x += 4) sum_right(&sum);
    float lanes[VECTOR_WIDTH];
    STORE_V(sum_at(sum, (float_v)((float)(column & 3)), (float_v)((float)(row & 3))), lanes);
    values[first + lane] = lanes[lane];
  }
}
#endif
