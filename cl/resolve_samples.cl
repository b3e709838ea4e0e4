// Sums the colours of samples into pixels: premultiplied linear colour, weights of a reconstruction filter.
//
// A pass has shaded one sample of every pixel, all at the same place in their pixels. A pixel gathers those that its
// filter reaches, its own and, of filters wider than a pixel, its neighbours':
//   for each sample of the pattern, in its order:
//     for each pixel within the filter's reach, row by row: sum += weight * colour;  weights += weight
//   colour = sum / weights
// Samples outside the image do not count, so that the weights of those inside stand for all. The order is fixed: no
// bit depends on tiles or threads. The box filter's weights are 1, its reach is the pixel itself.
// Good at: any number of samples, one at a time. Bad at: nothing known. Tests: tests/test_antialiasing.py.

#include "color_planes.clh"

#pragma OPENCL FP_CONTRACT OFF

// Reads: values (shade_hits). Writes: sums (for divide_sums). Work item: one pixel. Local memory: 0 bytes.
kernel void add_sample(
    uint pixel_count,                     // of the band
    uint width,                           // pixels of a row
    uint reach,                           // pixels to each side that the filter takes samples of
    uint first_weight,                    // of this sample
    uint begins,                          // 1: the first sample, sums hold nothing yet
    global const float *restrict weights, // [samples * (2 reach + 1)^2] row by row
    global const float *restrict values,  // [4 * pixel_count] R G B A of this sample
    global float *restrict sums)          // [5 * pixel_count] R G B A and weight
{
  const uint pixel = get_global_id(0);
  if (pixel >= pixel_count) return;
  const size_t stride = pixel_count;
  const int column = pixel % width, row = pixel / width, rows = pixel_count / width, r = reach;
  float4 sum = (float4)(0.0f);
  float weight_sum = 0.0f;
  if (!begins) {
    sum = load_color(sums, stride, pixel);
    weight_sum = sums[4 * stride + pixel];
  }
  uint tap = first_weight;
  for (int dy = -r; dy <= r; ++dy)
    for (int dx = -r; dx <= r; ++dx, ++tap) {
      if (column + dx < 0 || column + dx >= (int)width || row + dy < 0 || row + dy >= rows) continue;
      const size_t other = (size_t)(row + dy) * width + (column + dx);
      sum += load_color(values, stride, other) * weights[tap];
      weight_sum += weights[tap];
    }
  store_color(sums, stride, pixel, sum);
  sums[4 * stride + pixel] = weight_sum;
}

// Reads: sums (add_sample). Writes: values (host). Work item: one pixel. Local memory: 0 bytes.
kernel void divide_sums(
    uint pixel_count,                     // of the band
    global const float *restrict sums,    // [5 * pixel_count] R G B A and weight
    global float *restrict values)        // [4 * pixel_count] R G B A
{
  const uint pixel = get_global_id(0);
  if (pixel >= pixel_count) return;
  const size_t stride = pixel_count;
  store_color(values, stride, pixel, load_color(sums, stride, pixel) / sums[4 * stride + pixel]);
}

// A pixel's samples as surfaces that were shaded once, see share_shading.cl.
typedef struct {
  uint sample_count, listed_count;
  size_t stride;                      // pixels of the band
  global const float *values;         // [4 * pixel_count] colour at the pixels' centres
  global const uchar *surfaces;       // [edge_count * sample_count]
  global const uint *first_surfaces;  // [edge_count]
  global const float *shaded;         // [4 * listed_count] colours of the listed surfaces
} SharedColors;

// The colour of one sample of an edge pixel: `place` is its place among them.
static inline float4 shared_color(const SharedColors *c, uint pixel, uint place, uint surface) {
  if (surface == SURFACE_NOTHING) return (float4)(0.0f);
  if (surface == SURFACE_OF_CENTER) return load_color(c->values, c->stride, pixel);
  return load_color(c->shaded, c->listed_count, c->first_surfaces[place] + surface - 1);
}

// Reads: surfaces, first_surfaces (share_shading.cl), shaded (shade_hits). Writes: values of edge pixels (host): the
// mean of the samples whose surface is known. Work item: one edge pixel. Local memory: 0 bytes.
kernel void resolve_surfaces(
    uint pixel_count,                            // of the band
    uint first_edge,                             // of the list that is taken
    uint edge_count,                             // from there on
    uint sample_count,
    uint listed_count,
    global const uint *restrict edge_pixels,     // [first_edge + edge_count]
    global const uchar *restrict surfaces,       // [edge_count * sample_count]
    global const uint *restrict first_surfaces,  // [edge_count]
    global const float *restrict shaded,         // [4 * listed_count]
    global float *values)                        // [4 * pixel_count] in: at the centres
{
  const uint place = get_global_id(0);
  if (place >= edge_count) return;
  const uint pixel = edge_pixels[first_edge + place];
  const SharedColors c = {sample_count, listed_count, pixel_count, values, surfaces, first_surfaces, shaded};
  float4 sum = (float4)(0.0f);
  float known = 0.0f;
  uint others = 0;
  for (uint sample = 0; sample < sample_count; ++sample) {
    const uint surface = surfaces[(size_t)place * sample_count + sample];
    others |= surface;
    if (surface == SURFACE_UNKNOWN) continue;
    sum += shared_color(&c, pixel, place, surface);
    known += 1.0f;
  }
  if (others == SURFACE_OF_CENTER) return;  // as in a pixel that is no edge pixel, to the last bit
  store_color(values, pixel_count, pixel, sum / known);
}

// The same for filters wider than a pixel. Reads besides: edge_places (list_edge_pixels). Writes: sums (for
// divide_sums). Work item: one pixel. Local memory: 0 bytes.
kernel void filter_surfaces(
    uint pixel_count,                            // of the band
    uint width,                                  // pixels of a row
    uint sample_count,
    uint listed_count,
    uint reach,                                  // pixels to each side that the filter takes samples of
    global const float *restrict weights,        // [sample_count * (2 reach + 1)^2], see add_sample
    global const uint *restrict edge_places,     // [pixel_count] place among edge pixels, or NO_HIT
    global const uchar *restrict surfaces,       // [edge_count * sample_count]
    global const uint *restrict first_surfaces,  // [edge_count]
    global const float *restrict shaded,         // [4 * listed_count]
    global const float *restrict values,         // [4 * pixel_count] at the centres
    global float *restrict sums)                 // [5 * pixel_count] R G B A and weight
{
  const uint pixel = get_global_id(0);
  if (pixel >= pixel_count) return;
  const size_t stride = pixel_count;
  const int column = pixel % width, row = pixel / width, rows = pixel_count / width, r = reach;
  const uint taps = (2 * reach + 1) * (2 * reach + 1);
  const SharedColors c = {sample_count, listed_count, stride, values, surfaces, first_surfaces, shaded};
  float4 sum = (float4)(0.0f);
  float weight_sum = 0.0f;
  uint tap = 0;
  for (int dy = -r; dy <= r; ++dy)
    for (int dx = -r; dx <= r; ++dx, ++tap) {
      if (column + dx < 0 || column + dx >= (int)width || row + dy < 0 || row + dy >= rows) continue;
      const uint other = (row + dy) * width + (column + dx), place = edge_places[other];
      const float4 center = load_color(values, stride, other);
      for (uint sample = 0; sample < sample_count; ++sample) {
        const uint surface = place == NO_HIT ? SURFACE_OF_CENTER : surfaces[(size_t)place * sample_count + sample];
        if (surface == SURFACE_UNKNOWN) continue;
        const float weight = weights[sample * taps + tap];
        sum += (surface == SURFACE_OF_CENTER ? center : shared_color(&c, other, place, surface)) * weight;
        weight_sum += weight;
      }
    }
  store_color(sums, stride, pixel, sum);
  sums[4 * stride + pixel] = weight_sum;
}
