// How far pixels' colours may be off after some samples of their surfaces, and those that are done.
//
// The estimates are those of stratify_samples.cl, which says what a stratum is and what is kept of it.
//   gather_strata: colours of shaded samples, less the centre's, summed by stratum, and their squares, and
//   how far they vary within strata
//   judge_strata: which pixels and strata call for more; the others' colours
//   keep_strata: the list of those
// Good at: lists of any length. Bad at: nothing known. Tests: tests/test_antialiasing.py.

#include "color_planes.clh"
#include "strata.clh"

#pragma OPENCL FP_CONTRACT OFF

// What is summed of a stratum: colours less the centre's, then their squares.
#define SUM_OF(stratum) (2 * (stratum))
#define SQUARES_OF(stratum) (2 * (stratum) + 1)

// Reads: chosen, stratum_counts (meet_strata), colors (shade_hits), values (shade_hits, at the centres). Writes: sums and
// deviations (for judge_strata). Work item: one listed pixel. Local memory: 0 bytes.
kernel void gather_strata(
    uint count,
    uint pixel_count,                            // of the band
    uint listed_count,                           // samples that were shaded
    uint visit_count,                            // of which they are
    uint begins,                                 // 1: nothing is known yet
    global const uint *restrict pixels,          // [count]
    global const uint *restrict slots,           // [count]
    global const ChosenSamples *restrict chosen, // [count * visit_count]
    global const uint *restrict stratum_counts,  // [slots * STRATA] these samples included
    global const uint *restrict first_shaded,    // [count]
    global const float *restrict colors,         // [4 * listed_count] R G B A
    global const float *restrict values,         // [4 * pixel_count] at the centres
    global float4 *restrict sums,                // [slots * 2 * STRATA] in and out
    global float *restrict deviations)           // [pixel_count] variance within a listed pixel's strata
{
  const uint item = get_global_id(0);
  if (item >= count) return;
  const size_t slot = slots[item];
  const float4 center = load_color(values, pixel_count, pixels[item]);
  uint position = first_shaded[item];
  float4 sum[STRATA], squares[STRATA];
  uint found[STRATA];
  for (uint k = 0; k < STRATA; ++k) {
    sum[k] = squares[k] = (float4)(0.0f);
    found[k] = 0;
  }
  for (uint visit = 0; visit < visit_count; ++visit) {
    const ChosenSamples own = chosen[item * (size_t)visit_count + visit];
    for (uint mask = own.x; mask != 0; mask &= mask - 1) {
      const uint stratum = chosen_stratum(own, first_bit(mask));
      const float4 d = load_color(colors, listed_count, position++) - center;
      sum[stratum] += d;
      squares[stratum] += d * d;
      found[stratum] += 1;
    }
  }
  float4 within = (float4)(0.0f);
  float freedom = 0.0f;
  for (uint k = 0; k < STRATA; ++k) {
    const uint shaded = stratum_counts[STRATA * slot + k] >> 16;
    if (!shaded) continue;
    if (!begins && shaded != found[k]) {
      sum[k] += sums[2 * STRATA * slot + SUM_OF(k)];
      squares[k] += sums[2 * STRATA * slot + SQUARES_OF(k)];
    }
    if (begins || found[k] != 0) {
      sums[2 * STRATA * slot + SUM_OF(k)] = sum[k];
      sums[2 * STRATA * slot + SQUARES_OF(k)] = squares[k];
    }
    if (shaded < 2 || k == CROWD) continue;
    within += squares[k] - sum[k] * (sum[k] / (float)shaded);
    freedom += (float)(shaded - 1);
  }
  deviations[pixels[item]] = freedom > 0.0f ? max(largest_channel(within), 0.0f) / freedom : 0.0f;
}

// The mean variance of the listed pixels of a quad, which lies in one band: bands begin at even rows.
static inline float quad_variance(uint pixel, uint pixel_count, uint width, global const float *restrict deviations) {
  const uint column = pixel % width & ~1u, row = pixel / width & ~1u, rows = pixel_count / width;
  float sum = 0.0f, listed = 0.0f;
  for (uint k = 0; k < 4; ++k) {
    const uint other_column = column + (k & 1), other_row = row + (k >> 1);
    if (other_column >= width || other_row >= rows) continue;
    const float variance = deviations[(size_t)other_row * width + other_column];
    if (variance < 0.0f) continue;
    sum += variance;
    listed += 1.0f;
  }
  return sum / listed;
}

// Reads: stratum_counts, sums, deviations (gather_strata). Writes: keep (for keep_strata), open (for meet_strata), values
// of the pixels that are done (host).
// Work item: one listed pixel. Local memory: 0 bytes.
kernel void judge_strata(
    uint count,
    uint pixel_count,
    uint width,                                  // pixels of a row
    float sample_count,                          // samples so far
    float error_factor,                          // EDGE_ERROR N^(-3/4)
    float threshold,
    global const uint *restrict pixels,          // [count]
    global const uint *restrict slots,           // [count]
    global const uint *restrict stratum_counts,  // [slots * STRATA]
    global const float4 *restrict sums,          // [slots * 2 * STRATA]
    global const float *restrict deviations,     // [pixel_count] negative where a pixel is not listed
    global uchar *restrict open,                 // [slots]
    global uchar *restrict keep,                 // [count] 1 where more samples are called for
    global float *restrict values)               // [4 * pixel_count] in: at the centres; out: of pixels that are done
{
  const uint item = get_global_id(0);
  if (item >= count) return;
  const size_t slot = slots[item];
  const float around = quad_variance(pixels[item], pixel_count, width, deviations);
  float4 mean = (float4)(0.0f), squares = (float4)(0.0f);
  uint open_strata = 0;
  for (uint k = 0; k < STRATA; ++k) {
    const uint both = stratum_counts[STRATA * slot + k], shaded = both >> 16;
    if (!shaded) continue;
    const float share = (float)(both & 0xffffu) / sample_count, n = (float)shaded;
    const float4 sum = sums[2 * STRATA * slot + SUM_OF(k)], own_mean = sum / n;
    const float4 own_squares = sums[2 * STRATA * slot + SQUARES_OF(k)];
    mean += own_mean * share;
    squares += (k == CROWD ? own_squares / n : own_mean * own_mean) * share;
    if (k == CROWD) continue;
    float variance = around;
    if (shaded > 1) {
      const float4 own = own_squares - sum * own_mean;
      variance = 0.5f * (max(largest_channel(own), 0.0f) / (n - 1.0f) + around);
    }
    const float root = sqrt(n), slowly = root * sqrt(root);
    if (0.5f * share * sqrt(variance) > threshold * slowly) open_strata |= 1u << k;
  }
  const float between = max(largest_channel(squares - mean * mean), 0.0f);
  open[slot] = open_strata;
  const bool goes_on = open_strata != 0 || sqrt(between) * error_factor > threshold;
  keep[item] = goes_on;
  if (goes_on) return;
  store_color(values, pixel_count, pixels[item], load_color(values, pixel_count, pixels[item]) + mean);
}

// Reads: keep (judge_strata), begins (list_samples.cl). Writes: kept_pixels, kept_slots and pixel_places: the list that is
// sampled further. Work item: LIST_CHUNK listed pixels. Local memory: 0 bytes.
kernel void keep_strata(
    uint count,
    global const uchar *restrict keep,   // [count]
    global const uint *restrict begins,  // [chunks + 1]
    global const uint *restrict pixels,  // [count]
    global const uint *restrict slots,   // [count]
    global uint *restrict kept_pixels,   // [kept]
    global uint *restrict kept_slots,    // [kept]
    global uint *restrict pixel_places)  // [pixel_count] a pixel's place in the list, or NO_HIT
{
  const uint begin = get_global_id(0) * LIST_CHUNK;
  if (begin >= count) return;
  uint position = begins[begin / LIST_CHUNK];
  for (uint item = begin; item < min(begin + LIST_CHUNK, count); ++item) {
    pixel_places[pixels[item]] = keep[item] ? position : NO_HIT;
    if (!keep[item]) continue;
    kept_pixels[position] = pixels[item];
    kept_slots[position++] = slots[item];
  }
}
