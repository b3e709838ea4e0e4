// Lists of pixels and samples that something is to be done with: antialiasing works on these, not on whole bands.
//
// An edge pixel is one where a sample shows another triangle than the pixel's centre does. Lists are made by counting,
// prefix sums and a second walk, so that no racing order decides what stands where.
//   flag_edge_pixels, or sum_bytes: how many entries each chunk makes
//   scan_counts: where each chunk's entries begin
//   list_edge_pixels, or a kernel of the list's own: the entries
// Good at: bands of any size. Bad at: nothing known. Tests: tests/test_antialiasing.py.

#pragma OPENCL FP_CONTRACT OFF

// Reads: center_prims, sample_prims (rasterize_tiles). Writes: edge_flags, chunk_counts (for scan_counts).
// Work item: LIST_CHUNK pixels. Local memory: 0 bytes.
kernel void flag_edge_pixels(
    uint pixel_count,                         // of the band
    uint depth_count,                         // samples with visibility of their own
    uint prim_stride,                         // entries from one sample's plane to the next
    global const uint *restrict center_prims, // [padded pixel_count] prim_id or NO_HIT
    global const uint *restrict sample_prims, // [depth_count * prim_stride]
    global uchar *restrict edge_flags,        // [padded pixel_count] 255 at edges, else 0
    global uint *restrict chunk_counts)       // [chunks] edge pixels
{
  const uint begin = get_global_id(0) * LIST_CHUNK;
  if (begin >= pixel_count) return;
  const uint end = min(begin + LIST_CHUNK, pixel_count);
  uint count = 0;
  for (uint pixel = begin; pixel < end; pixel += 16) {
    const uint16 center = vload16(0, center_prims + pixel);
    int16 differs = 0;
    for (uint sample = 0; sample < depth_count; ++sample)
      differs |= vload16(0, sample_prims + (size_t)sample * prim_stride + pixel) != center;
    uchar flags[16];
    vstore16(convert_uchar16(as_uint16(differs) & 255u), 0, flags);
    for (uint lane = 0; lane < 16; ++lane) {
      if (pixel + lane >= end) flags[lane] = 0;
      count += flags[lane] != 0;
    }
    vstore16(vload16(0, flags), 0, edge_flags + pixel);
  }
  chunk_counts[begin / LIST_CHUNK] = count;
}

// Reads: counts (the kernel before). Writes: begins (for the list's kernel and the host). Work item: only one.
// Local memory: 0 bytes.
kernel void scan_counts(
    uint count,                          // of chunks
    global const uint *restrict counts,  // [count]
    global uint *restrict begins)        // [count + 1] exclusive sums, then the total
{
  if (get_global_id(0) != 0) return;
  uint total = 0;
  for (uint k = 0; k < count; ++k) {
    begins[k] = total;
    total += counts[k];
  }
  begins[count] = total;
}

// Reads: edge_flags (flag_edge_pixels), begins (scan_counts). Writes: edge_pixels (for what follows), edge_places (for
// filter_surfaces). Work item: LIST_CHUNK pixels. Local memory: 0 bytes.
kernel void list_edge_pixels(
    uint pixel_count,                         // of the band
    global const uchar *restrict edge_flags,  // [pixel_count]
    global const uint *restrict begins,       // [chunks + 1]
    global uint *restrict edge_pixels,        // [edge_count] pixels of the band, rising
    global uint *restrict edge_places)        // [pixel_count] where in edge_pixels, or NO_HIT
{
  const uint begin = get_global_id(0) * LIST_CHUNK;
  if (begin >= pixel_count) return;
  uint position = begins[begin / LIST_CHUNK];
  for (uint pixel = begin; pixel < min(begin + LIST_CHUNK, pixel_count); ++pixel) {
    edge_places[pixel] = edge_flags[pixel] ? position : NO_HIT;
    if (edge_flags[pixel]) edge_pixels[position++] = pixel;
  }
}

// Reads: counts of whatever is listed. Writes: chunk_counts (for scan_counts). Work item: LIST_CHUNK of them.
// Local memory: 0 bytes.
kernel void sum_bytes(
    uint count,
    global const uchar *restrict bytes,  // [count]
    global uint *restrict chunk_counts)  // [chunks]
{
  const uint begin = get_global_id(0) * LIST_CHUNK;
  if (begin >= count) return;
  uint sum = 0;
  for (uint item = begin; item < min(begin + LIST_CHUNK, count); ++item) sum += bytes[item];
  chunk_counts[begin / LIST_CHUNK] = sum;
}

// Reads: flags of whatever is listed. Writes: chunk_counts (for scan_counts). Work item: LIST_CHUNK of them.
// Local memory: 0 bytes.
kernel void count_flags(
    uint count,
    global const uchar *restrict flags,  // [count] 0, or not
    global uint *restrict chunk_counts)  // [chunks]
{
  const uint begin = get_global_id(0) * LIST_CHUNK;
  if (begin >= count) return;
  uint sum = 0;
  for (uint item = begin; item < min(begin + LIST_CHUNK, count); ++item) sum += flags[item] != 0;
  chunk_counts[begin / LIST_CHUNK] = sum;
}

// Reads: visible_prims (any method's). Writes: sample_prims and differs (for meet_strata). Work item: LIST_CHUNK listed
// pixels. Local memory: 0 bytes.
kernel void take_samples(
    uint count,                                 // of listed pixels
    uint everywhere,                            // 1: all pixels of the band are listed
    uint sample,                                // which of a pixel's
    uint stride,                                // entries from one listed pixel to the next
    global const uint *restrict pixels,         // [count]
    global const uint *restrict visible_prims,  // [pixel_count] at the sample
    global const uint *restrict center_prims,   // [pixel_count]
    global uchar *restrict differs,             // [pixel_count] `everywhere`: 1 where a sample shows another triangle
    global uint *restrict sample_prims)         // [count * stride]
{
  const uint begin = get_global_id(0) * LIST_CHUNK;
  for (uint item = begin; item < min(begin + LIST_CHUNK, count); ++item) {
    const uint pixel = everywhere ? item : pixels[item], found = visible_prims[pixel];
    sample_prims[(size_t)item * stride + sample] = found;
    if (everywhere) differs[pixel] = (sample != 0 && differs[pixel]) || found != center_prims[pixel];
  }
}
