// Mip maps: each level is half as wide and as high as the one before it, of the same texels' mean.
//
// A texel of a level stands for a rectangle of the level before, two texels a side or, where that is odd, a little more,
// whose colours it sums by the area that it covers; in linear light, and back to the bytes that textures are kept in.
// Good at: any size. Bad at: nothing known. Tests: tests/test_texture_filter.py.

#pragma OPENCL FP_CONTRACT OFF

// The byte whose linear value is nearest, among those of a table by its midpoints.
static inline uchar nearest_byte(float value, global const float *midpoints) {
  uint low = 0;
  for (uint step = 128; step > 0; step /= 2)
    if (low + step <= 255 && value >= midpoints[low + step - 1]) low += step;
  return (uchar)low;
}

// Reads: texels of the level before (host, or this kernel). Writes: texels of a level. Work item: one texel of it.
// Local memory: 0 bytes.
kernel void build_level(
    uint source,                                  // first texel of the level before
    uint source_width,
    uint source_height,
    uint target,                                  // first texel of this one
    uint width,
    uint height,
    uint srgb,                                    // 1: RGB bytes go through the sRGB table
    global const float *restrict srgb_to_linear,  // [512] see Surfaces
    global const float *restrict midpoints,       // [255] linear values half way between sRGB bytes
    global uchar4 *texels)                        // of all textures
{
  const uint item = get_global_id(0);
  if (item >= width * height) return;
  const uint x = item % width, y = item / width;
  const float step_x = (float)source_width / (float)width, step_y = (float)source_height / (float)height;
  const float left = (float)x * step_x, right = left + step_x, top = (float)y * step_y, bottom = top + step_y;
  float4 sum = (float4)(0.0f);
  float weights = 0.0f;
  for (uint row = (uint)top; row < source_height && (float)row < bottom; ++row) {
    const float share_y = min(bottom, (float)row + 1.0f) - max(top, (float)row);
    for (uint column = (uint)left; column < source_width && (float)column < right; ++column) {
      const float weight = (min(right, (float)column + 1.0f) - max(left, (float)column)) * share_y;
      const uchar4 t = texels[source + row * source_width + column];
      const float4 linear = srgb ? (float4)(srgb_to_linear[t.x], srgb_to_linear[t.y], srgb_to_linear[t.z], (float)t.w)
                                 : convert_float4(t);
      sum += linear * weight;
      weights += weight;
    }
  }
  const float4 mean = sum / weights;
  const uchar alpha = (uchar)(min(max(mean.w, 0.0f), 255.0f) + 0.5f);
  texels[target + item] = srgb ? (uchar4)(nearest_byte(mean.x, midpoints), nearest_byte(mean.y, midpoints), nearest_byte(mean.z, midpoints), alpha)
                               : (uchar4)((uchar)(mean.x + 0.5f), (uchar)(mean.y + 0.5f), (uchar)(mean.z + 0.5f), alpha);
}
