// Ends the search for layers behind a pixel that is opaque.
//
// A BLEND surface lets through what lies behind it, which is found by another pass in front of which the layer lies
// (rasterize_tiles.cl). Bad at: scenes of many layers, each of which is a pass over all samples.
// Tests: tests/test_layers.py.

#include "vector.clh"
#include "edge_function.clh"
#include "fronts.clh"

// Reads: open_pixels (shade_hits). Writes: front_nearness, front_prims (for rasterize_tiles with a layer in front): the
// nearness of nothing where the layer is opaque, so that no sample lies behind it.
// Work item: one pixel. Local memory: 0 bytes.
kernel void close_pixels(
    uint pixel_count,                             // of the band
    global const uchar *restrict open_pixels,     // [pixel_count]
    global float *restrict front_nearness,        // [pixel_count], of filtering rungs [2 * pixel_count]
    global uint *restrict front_prims)            // [pixel_count]
{
  const uint pixel = get_global_id(0);
  if (pixel >= pixel_count) return;
  if (!open_pixels[pixel]) close_front(pixel, pixel_count, front_nearness, front_prims);
}
