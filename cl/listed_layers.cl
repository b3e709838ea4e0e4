// What lies behind samples of listed pixels: passes over the whole band (rasterize_tiles.cl and the like) that meet nothing
// beside the list, sample by sample and layer by layer.
//
// A pass finds what lies behind a front. Pixels whose front is nothing meet nothing, and rasterize_tiles.cl does not walk
// tiles of such pixels alone; a front as near as can be lets everything through.
//   close_fronts: nothing is sought, anywhere
//   open_fronts: anything is sought at the listed pixels
//   put_fronts: at those of them whose sample is shaded, and lets light through, what lies behind it
//   take_layer: what a pass found, and how near, for the list
// Good at: few samples, any method and rung. Bad at: many, each of which is a pass. Tests: tests/test_listed_layers.py.

#include "vector.clh"
#include "edge_function.clh"
#include "fronts.clh"
#include "strata.clh"

// Reads: nothing. Writes: front_nearness, front_prims (for rasterize_tiles with a layer in front). Work item: one pixel.
// Local memory: 0 bytes.
kernel void close_fronts(
    uint pixel_count,                          // of the band
    global float *restrict front_nearness,     // [pixel_count], of filtering rungs [2 * pixel_count]
    global uint *restrict front_prims)         // [pixel_count]
{
  const uint pixel = get_global_id(0);
  if (pixel < pixel_count) close_front(pixel, pixel_count, front_nearness, front_prims);
}

// Reads: pixels. Writes: front_nearness (for rasterize_tiles with a layer in front). Not for rungs that filter, which
// compare with what lies in front. Work item: one listed pixel. Local memory: 0 bytes.
kernel void open_fronts(
    uint count,
    global const uint *restrict pixels,        // [count]
    global float *restrict front_nearness)     // [pixel_count]
{
  const uint item = get_global_id(0);
  if (item < count) front_nearness[pixels[item]] = INFINITY;
}

// Reads: pixels, chosen (meet_strata), first_shaded (list_chosen), open_samples (shade_hits), prims, nearness (take_layer).
// Writes: front_nearness, front_prims (for rasterize_tiles with a layer in front) at the listed pixels.
// Work item: one listed pixel. Local memory: 0 bytes.
kernel void put_fronts(
    uint count,
    uint pixel_count,
    uint visit_count,
    uint sample,                               // which of a pixel's
    uint stride,                               // entries from one listed pixel to the next
    global const uint *restrict pixels,        // [count]
    global const ChosenSamples *restrict chosen, // [count * visit_count]
    global const uint *restrict first_shaded,  // [count] where a pixel's samples begin in the list of these
    global const uchar *restrict open_samples, // [listed] 1 where something behind is to be seen
    global const uint *restrict prims,         // [count * stride]
    global const float *restrict nearness,     // [count * stride], of filtering rungs twice that
    global float *restrict front_nearness,     // [pixel_count], of filtering rungs [2 * pixel_count]
    global uint *restrict front_prims)         // [pixel_count]
{
  const uint item = get_global_id(0);
  if (item >= count) return;
  const uint pixel = pixels[item], visit = sample / VISIT_SAMPLES, bit = 1u << sample % VISIT_SAMPLES;
  global const ChosenSamples *own = chosen + item * (size_t)visit_count;
  bool is_open = (own[visit].x & bit) != 0;
  if (is_open) {
    uint place = first_shaded[item] + popcount((uint)own[visit].x & (bit - 1));
    for (uint k = 0; k < visit; ++k) place += popcount((uint)own[k].x);
    is_open = open_samples[place] != 0;
  }
  if (!is_open) {
    close_front(pixel, pixel_count, front_nearness, front_prims);
    return;
  }
  const size_t entry = item * (size_t)stride + sample;
  front_nearness[pixel] = nearness[entry];
#if FILTERED
  front_nearness[(size_t)pixel_count + pixel] = nearness[(size_t)count * stride + entry];
#endif
  front_prims[pixel] = prims[entry];
}

// Reads: pixels, visible_prims, band_nearness (rasterize_tiles). Writes: prims (for meet_strata, list_chosen), nearness (for
// put_fronts). Work item: one listed pixel. Local memory: 0 bytes.
kernel void take_layer(
    uint count,
    uint pixel_count,
    uint sample,
    uint stride,
    global const uint *restrict pixels,         // [count]
    global const uint *restrict visible_prims,  // [pixel_count]
    global const float *restrict band_nearness, // [pixel_count], of filtering rungs [2 * pixel_count]
    global uint *restrict prims,                // [count * stride]
    global float *restrict nearness)            // [count * stride], of filtering rungs twice that
{
  const uint item = get_global_id(0);
  if (item >= count) return;
  const uint pixel = pixels[item];
  const size_t entry = item * (size_t)stride + sample;
  prims[entry] = visible_prims[pixel];
  nearness[entry] = band_nearness[pixel];
#if FILTERED
  nearness[(size_t)count * stride + entry] = band_nearness[(size_t)pixel_count + pixel];
#endif
}
