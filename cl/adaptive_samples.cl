// Samples pixels until their estimated error is small: where colour is flat none, at edges as many as it takes.
//
// A pixel begins where one of the first samples shows another triangle than its centre, or where the colours at centres
// about it step or bend so much that one sample's error may be too large. Then, for 8, 16, 32 ..
// samples of a (0,2)-sequence:
//   each pixel of the list gathers colours less that of its centre: their sum, and the sum of their squares
//   error = standard deviation * n^(-3/4); pixels whose largest channel has less are done, the others stay in the list
// n^(-3/4) is how fast the error of an edge falls when n samples are one in each of n equal squares: an edge passes about
// sqrt(n) squares, each of which adds its own, independent error (Mitchell 1996). The list is walked by prefix sums.
// Good at: few edges, large flat regions. Bad at: noise everywhere (every pass decides the samples of all pixels).
// Tests: tests/test_antialiasing.py.

#include "color_planes.clh"

#pragma OPENCL FP_CONTRACT OFF

#define STATE_PLANES 8  // sums of R G B A less those of the centre, then sums of their squares

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

// Reads: pixels, colors (shade_hits), values (shade_hits, at the centres). Writes: state (for judge_pixels).
// Work item: one listed pixel. Local memory: 0 bytes.
kernel void gather_sample(
    uint count,
    uint pixel_count,
    uint begins,                           // 1: the first sample
    global const uint *restrict pixels,    // [count]
    global const float *restrict colors,   // [4 * pixel_count] R G B A of all pixels at the sample
    global const float *restrict values,   // [4 * pixel_count] at the centres
    global float *restrict state)          // [STATE_PLANES * count]
{
  const uint item = get_global_id(0);
  if (item >= count) return;
  const uint pixel = pixels[item];
  const float4 color = load_color(colors, pixel_count, pixel);
  const float4 d = color - load_color(values, pixel_count, pixel);
  float4 sum = (float4)(0.0f), squares = (float4)(0.0f);
  global float *square_planes = state + 4 * (size_t)count;
  if (!begins) {
    sum = load_color(state, count, item);
    squares = load_color(square_planes, count, item);
  }
  store_color(state, count, item, sum + d);
  store_color(square_planes, count, item, squares + d * d);
}

// Reads: state (gather_sample). Writes: keep (for keep_pixels). Work item: one listed pixel. Local memory: 0 bytes.
kernel void judge_pixels(
    uint count,
    float sample_count,                  // samples so far
    float error_factor,                  // n^(-3/4)
    float threshold,
    global const float *restrict state,  // [STATE_PLANES * count]
    global uchar *restrict keep)         // [count] 1 where more samples are called for
{
  const uint item = get_global_id(0);
  if (item >= count) return;
  const float4 mean = load_color(state, count, item) / sample_count;
  const float4 squares = load_color(state + 4 * (size_t)count, count, item) / sample_count;
  const float variance = max(largest_channel(squares - mean * mean), 0.0f);
  keep[item] = sqrt(variance) * error_factor > threshold;
}

// Reads: keep (judge_pixels), begins (list_samples.cl), pixels, state. Writes: kept_pixels and kept_state (the list that
// is sampled further), values (host). Work item: LIST_CHUNK listed pixels. Local memory: 0 bytes.
kernel void keep_pixels(
    uint count,
    uint pixel_count,
    uint kept_count,
    float sample_count,
    global const uchar *restrict keep,   // [count]
    global const uint *restrict begins,  // [chunks + 1]
    global const uint *restrict pixels,  // [count]
    global const float *restrict state,  // [STATE_PLANES * count]
    global uint *restrict kept_pixels,   // [kept_count]
    global float *restrict kept_state,   // [STATE_PLANES * kept_count]
    global float *restrict values)       // [4 * pixel_count] in: at the centres; out: of pixels that are done
{
  const uint begin = get_global_id(0) * LIST_CHUNK;
  if (begin >= count) return;
  uint position = begins[begin / LIST_CHUNK];
  for (uint item = begin; item < min(begin + LIST_CHUNK, count); ++item) {
    const uint pixel = pixels[item];
    if (!keep[item]) {
      const float4 center = load_color(values, pixel_count, pixel);
      store_color(values, pixel_count, pixel, center + load_color(state, count, item) / sample_count);
      continue;
    }
    kept_pixels[position] = pixel;
    for (uint plane = 0; plane < STATE_PLANES; ++plane)
      kept_state[plane * (size_t)kept_count + position] = state[plane * (size_t)count + item];
    ++position;
  }
}
