// Flags pixels whose one sample may be too far from what they show, by the colours at centres about them.
//
// With those where a sample shows another surface than the centre they are the list that stratify_samples.cl begins with.
// Good at: colours that step or bend. Bad at: what is finer than pixels and hit by no centre. Tests:
// tests/test_antialiasing.py, tests/test_shading_rate.py.

#include "color_planes.clh"

#pragma OPENCL FP_CONTRACT OFF

#define GROUP_ROWS 4u     // rows that a second difference stays within: bands begin at multiples of them
#define ERROR_SHARE 0.15625f  // of range and second differences: the error of one sample, see flag_contrast

// |a - 2 b + c| of three entries in a row or column: the middle one is `at`, or the nearest that has both neighbours among
// `count` of them from `first` on.
static inline float4 second_difference(global const float *planes, size_t plane, size_t first, size_t step, uint at, uint count) {
  if (count < 3) return (float4)(0.0f);
  const size_t middle = first + clamp(at, 1u, count - 2) * step;
  const float4 sides = load_color(planes, plane, middle - step) + load_color(planes, plane, middle + step);
  return fabs(sides - 2.0f * load_color(planes, plane, middle));
}

// Flags pixels whose one sample may be too far from their mean: where colours step, or bend. The mean of a ramp is what its
// centre shows: its range in the quad (2 x 2 pixels) alone counts little; a step has second differences besides. At the same
// error of the other pixels a sixth fewer are flagged than by the deviation of a ramp, range / sqrt(12) (Sponza). Of
// ERROR_SHARE the choice is where a view of Sponza reaches the error of 16 samples in the least time.
// A quad lies in one band and one group of rows: bands begin at even rows. What its pixels share is found once.
// Reads: values (shade_hits). Writes: edge_flags (for list_edge_pixels). Work item: one quad. Local memory: 0 bytes.
kernel void flag_contrast(
    uint pixel_count,                     // of the band
    uint width,                           // pixels of a row
    float threshold,                      // error that is allowed
    global const float *restrict values,  // [4 * pixel_count] R G B A at the centres
    global uchar *restrict edge_flags)    // [pixel_count] in and out: not 0 where samples are called for
{
  const uint quads_across = (width + 1) / 2, rows = pixel_count / width, quad = get_global_id(0);
  const uint left = 2 * (quad % quads_across), top = 2 * (quad / quads_across);
  if (top >= rows) return;
  const uint right_end = min(left + 2, width), bottom_end = min(top + 2, rows);
  float4 low = (float4)(INFINITY), high = (float4)(-INFINITY);
  bool is_flagged = true;
  for (uint row = top; row < bottom_end; ++row) {
    for (uint column = left; column < right_end; ++column) {
      const float4 color = load_color(values, pixel_count, (size_t)row * width + column);
      low = min(low, color);
      high = max(high, color);
      is_flagged = is_flagged && edge_flags[(size_t)row * width + column] != 0;
    }
  }
  if (is_flagged) return;
  const float range = largest_channel(high - low);
  const uint group = top & ~(GROUP_ROWS - 1), group_rows = min(GROUP_ROWS, rows - group);
  for (uint column = left; column < right_end; ++column) {
    // Both rows of a quad are nearest to the same middle.
    const float4 down = second_difference(values, pixel_count, (size_t)group * width + column, width, top - group, group_rows);
    for (uint row = top; row < bottom_end; ++row) {
      const float4 across = second_difference(values, pixel_count, (size_t)row * width, 1, column, width);
      if ((range + largest_channel(across + down)) * ERROR_SHARE > threshold) edge_flags[(size_t)row * width + column] = 255;
    }
  }
}
