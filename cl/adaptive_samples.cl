// Samples pixels until their estimated error is small: where colour is flat none, at edges as many as it takes.
//
// A pixel begins where one of the first samples shows another triangle than its centre, or where the colours at the
// centres of its quad (2 x 2 pixels) differ so much that one sample's error may be too large. Then, for 8, 16, 32 ..
// samples of a (0,2)-sequence:
//   each pixel of the list gathers colours less that of its centre: their sum, and the sum of their squares
//   error = standard deviation * n^(-3/4); pixels whose largest channel has less are done, the others stay in the list
// n^(-3/4) is how fast the error of an edge falls when n samples are one in each of n equal squares: an edge passes about
// sqrt(n) squares, each of which adds its own, independent error (Mitchell 1996). The list is walked by prefix sums.
// Good at: few edges, large flat regions. Bad at: noise everywhere (every pass decides the samples of all pixels).
// Tests: tests/test_antialiasing.py.

#pragma OPENCL FP_CONTRACT OFF

#define STATE_PLANES 8  // sums of R G B A less those of the centre, then sums of their squares

static inline float4 load_planes(global const float *planes, size_t stride, size_t at) {
  return (float4)(planes[at], planes[stride + at], planes[2 * stride + at], planes[3 * stride + at]);
}

static inline void store_planes(global float *planes, size_t stride, size_t at, float4 value) {
  planes[at] = value.x;
  planes[stride + at] = value.y;
  planes[2 * stride + at] = value.z;
  planes[3 * stride + at] = value.w;
}

static inline float largest_of(float4 v) { return max(max(v.x, v.y), max(v.z, v.w)); }

// A quad lies in one band: bands begin at even rows. A ramp of a range per pixel has a deviation of 1/sqrt(12) of it.
// Reads: values (shade_hits). Writes: edge_flags (for list_edge_pixels). Work item: one pixel. Local memory: 0 bytes.
kernel void flag_contrast(
    uint pixel_count,                     // of the band
    uint width,                           // pixels of a row
    float threshold,                      // error that is allowed
    global const float *restrict values,  // [4 * pixel_count] R G B A at the centres
    global uchar *restrict edge_flags)    // [pixel_count] in and out: not 0 where samples are called for
{
  const uint pixel = get_global_id(0);
  if (pixel >= pixel_count) return;
  const uint column = pixel % width & ~1u, row = pixel / width & ~1u, rows = pixel_count / width;
  float4 low = load_planes(values, pixel_count, pixel), high = low;
  for (uint k = 0; k < 4; ++k) {
    const uint other_column = column + (k & 1), other_row = row + (k >> 1);
    if (other_column >= width || other_row >= rows) continue;
    const float4 other = load_planes(values, pixel_count, (size_t)other_row * width + other_column);
    low = min(low, other);
    high = max(high, other);
  }
  if (largest_of(high - low) * 0.2886751f > threshold) edge_flags[pixel] = 255;
}

// Reads: pixels (list_edge_pixels, keep_pixels), visible_prims (rasterize_tiles). Writes: shaded_prims, places (for
// shade_hits). Work item: one listed pixel. Local memory: 0 bytes.
kernel void list_places(
    uint count,                                // of listed pixels
    uint position,                             // of the sample, 256ths, x | y << 16
    global const uint *restrict pixels,        // [count]
    global const uint *restrict visible_prims, // [pixel_count] at the sample
    global uint *restrict shaded_prims,        // [count]
    global uint2 *restrict places)             // [count]
{
  const uint item = get_global_id(0);
  if (item >= count) return;
  shaded_prims[item] = visible_prims[pixels[item]];
  places[item] = (uint2)(pixels[item], position);
}

// Reads: pixels, colors (shade_hits), values (shade_hits, at the centres). Writes: state (for judge_pixels).
// Work item: one listed pixel. Local memory: 0 bytes.
kernel void gather_sample(
    uint count,
    uint pixel_count,
    uint color_stride,                     // entries of a plane of colours
    uint by_pixel,                         // 1: colours are those of all pixels, 0: of the list
    uint begins,                           // 1: the first sample
    global const uint *restrict pixels,    // [count]
    global const float *restrict colors,   // [4 * color_stride] R G B A
    global const float *restrict values,   // [4 * pixel_count] at the centres
    global float *restrict state)          // [STATE_PLANES * count]
{
  const uint item = get_global_id(0);
  if (item >= count) return;
  const uint pixel = pixels[item];
  const float4 color = load_planes(colors, color_stride, by_pixel ? pixel : item);
  const float4 d = color - load_planes(values, pixel_count, pixel);
  float4 sum = (float4)(0.0f), squares = (float4)(0.0f);
  global float *square_planes = state + 4 * (size_t)count;
  if (!begins) {
    sum = load_planes(state, count, item);
    squares = load_planes(square_planes, count, item);
  }
  store_planes(state, count, item, sum + d);
  store_planes(square_planes, count, item, squares + d * d);
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
  const float4 mean = load_planes(state, count, item) / sample_count;
  const float4 squares = load_planes(state + 4 * (size_t)count, count, item) / sample_count;
  const float variance = max(largest_of(squares - mean * mean), 0.0f);
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
      const float4 center = load_planes(values, pixel_count, pixel);
      store_planes(values, pixel_count, pixel, center + load_planes(state, count, item) / sample_count);
      continue;
    }
    kept_pixels[position] = pixel;
    for (uint plane = 0; plane < STATE_PLANES; ++plane)
      kept_state[plane * (size_t)kept_count + position] = state[plane * (size_t)count + item];
    ++position;
  }
}
