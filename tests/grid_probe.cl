// What the functions of cl/grid.clh do: the cells that rays walk through, and when they leave each.

#include "vector.clh"
#include "grid.clh"

kernel void probe_walks(
    View view,
    Grid grid,
    uint ray_count,
    uint capacity,                         // cells of a ray that are kept
    global const float2 *restrict places,  // [ray_count] X and Y from the image's centre
    global uint *restrict counts,          // [ray_count] cells
    global int *restrict cells,            // [ray_count * capacity * 3]
    global float *restrict times)          // [ray_count * capacity] when the ray leaves the cell
{
  const uint ray = get_global_id(0);
  if (ray >= ray_count) return;
  GridWalk walk = ray_of_sample(view, grid, places[ray].x, places[ray].y);
  uint count = 0;
  if (enter_grid(grid, &walk)) {
    do {
      const uint place = ray * capacity + min(count, capacity - 1);
      cells[3 * place] = walk.x;
      cells[3 * place + 1] = walk.y;
      cells[3 * place + 2] = walk.z;
      times[place] = exit_time(&walk);
      ++count;
    } while (step_walk(grid, &walk));
  }
  counts[ray] = count;
}
