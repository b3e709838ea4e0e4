// Samples pixels until their estimated error is small: visibility at many samples, shading at few of each surface.
//
// What a pixel shows is a mean over its surfaces (strata): of each the share of the samples that show it, which needs
// visibility alone, times the mean of its colour, which needs few samples (post-stratification). A pixel begins where one
// of the first 16 samples of a (0,2)-sequence shows another surface than its centre, or where colours at centres about it
// step or bend (flag_contrast). In rounds, of N = 16, 32, 64 .. samples:
//   meet_strata: each new sample belongs to a surface; which are shaded: the first two of a surface, for one says nothing of
//     how its colour varies, and of the first N/4 those whose surface is still open
//   gather_strata, judge_strata: of the shares   deviation between the surfaces' means * EDGE_ERROR N^(-3/4)
//     of a surface's mean   share * half the deviation of its n colours * n^(-3/4); it is open while that is too large
//     pixels with no such error stay out of the next round
// Samples that show none of a pixel's first STRATA - 1 surfaces are the CROWD, the last stratum: all of them are shaded, each
// as a surface of its own, so that a pixel of many surfaces has what as many samples of each pixel would show.
// N^(-3/4) is how fast the error of an edge falls when N samples are one in each of N equal squares: an edge passes about
// sqrt(N) squares, each of which adds its own, independent error (Mitchell 1996); EDGE_ERROR (rounds.py) is what the pattern's
// straight edges have of it. Within a surface there are no edges, but what changes slowly; half is what was measured there.
// msaa and csaa with shading rate auto end with the samples that they have: rounds of S/4 and of S shaded ones of the same N,
// in which the colour of the centre counts as that of one sample of its surface, and shares count for no error (rounds.py).
// Deviations of few samples are uncertain: half of one is that of the listed pixels of its quad. Lists are made by prefix sums.
// Good at: few surfaces a pixel. Bad at: pixels of more than STRATA - 1 of them, which cost what all samples cost; what varies
// within a surface where its first shaded samples agree, as a thin shadow may, is never seen.
// Tests: tests/test_antialiasing.py, tests/test_shading_rate.py.

#include "vector.clh"
#include "edge_function.clh"
#include "same_surface.clh"
#include "strata.clh"

#define FIRST_VISIT NO_HIT  // in place of a first entry: the samples that all pixels were looked at
#define NO_FIRSTS 0xffffffffu  // no sample has these numbers

// What is known of a listed pixel's strata: the triangle that each was first seen by, samples that show it, of these shaded,
// and up to two that were shaded because few were, 16 bits each, which are not shaded again.
typedef struct {
  uint prims[STRATA], covered[STRATA], shaded[STRATA], firsts[STRATA];
  uint count;
} Strata;

static inline Strata no_strata() {
  Strata s;
  for (uint k = 0; k < STRATA; ++k) {
    s.prims[k] = s.covered[k] = s.shaded[k] = 0;
    s.firsts[k] = NO_FIRSTS;
  }
  s.count = 0;
  return s;
}

static inline Strata load_strata(size_t slot, global const uint *restrict prims, global const uint *restrict counts,
                                 global const uint *restrict firsts) {
  Strata s = no_strata();
  for (uint k = 0; k < STRATA; ++k) {
    const uint both = counts[STRATA * slot + k];
    s.covered[k] = both & 0xffffu;
    s.shaded[k] = both >> 16;
    if (!s.shaded[k] || k == CROWD) continue;  // each is shaded when it is found
    s.prims[k] = prims[STRATA * slot + k];
    s.firsts[k] = firsts[STRATA * slot + k];
    s.count = k + 1;
  }
  return s;
}

static inline bool shows_same(const Ground *g, uint a, uint b, float x, float y) {
  if (a == NO_HIT || b == NO_HIT || g->material_ids[a] != g->material_ids[b]) return false;  // before planes are computed
  const SurfacePlane first = plane_of(g, a), second = plane_of(g, b);
  return is_same_surface(g, &first, &second, x, y);
}

// A bit for each of a visit's samples that shows a triangle.
static inline uint samples_of(uint16 samples, uint prim_id) {
  const int16 bits = (int16)(1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048, 4096, 8192, 16384, 32768);
  const int16 found = samples == prim_id ? bits : (int16)(0);
  const int8 eight = found.lo | found.hi;
  const int4 four = eight.lo | eight.hi;
  const int2 two = four.lo | four.hi;
  return (uint)(two.x | two.y);
}

// Reads: center_prims, sample_prims (rasterize_samples) of a visit. Writes: edge_flags (for flag_contrast).
// Work item: one pixel. Local memory: 0 bytes.
kernel void flag_surfaces(
    View view,
    uint pixel_count,                             // of the band
    uint lanes,                                   // a bit for each sample that counts
    uint begins,                                  // 1: no visit was looked at before
    float surface_distance,                       // of planes that count as one: world units, or a share of t
    global const float4 *restrict positions,      // [vertex_count] world space times world_scale
    global const uint *restrict indices,          // [3 * triangle_count]
    global const uint *restrict object_ids,       // [triangle_count]
    global const uint *restrict material_ids,     // [triangle_count]
    global const uint *restrict center_prims,     // [pixel_count] prim_id or NO_HIT
    global const uchar *restrict differs,         // [pixel_count] 0 where no sample shows another triangle
    global const uint *restrict sample_prims,     // [pixel_count * VISIT_SAMPLES] of pixels that differ
    global uchar *restrict edge_flags)            // [pixel_count] in and out: 255 where a sample shows another surface
{
  const uint pixel = get_global_id(0);
  if (pixel >= pixel_count) return;
  if (begins) edge_flags[pixel] = 0;
  if (!differs[pixel]) return;
  const uint center = center_prims[pixel];
  const Ground g = {view, surface_distance, positions, indices, object_ids, material_ids};
  const float x = (float)(pixel % view.width) - view.center_x + 0.5f;
  const float y = (float)(pixel / view.width + view.band_top) - view.center_y + 0.5f;
  global const uint *samples = sample_prims + (size_t)pixel * VISIT_SAMPLES;
  const uint16 shown = vload16(0, samples);
  // Each triangle once.
  for (uint left = lanes & ~samples_of(shown, center); left != 0;) {
    const uint prim_id = samples[first_bit(left)];
    if (!shows_same(&g, center, prim_id, x, y)) {
      edge_flags[pixel] = 255;
      return;
    }
    left &= ~samples_of(shown, prim_id);
  }
}

// The stratum of a triangle that a sample at (X, Y) shows; a new one where it is part of none and there is room. S->count is
// of those beside the crowd.
static inline uint find_stratum(const Ground *g, Strata *s, uint prim_id, float x, float y) {
  for (uint k = 0; k < s->count; ++k)
    if (s->prims[k] == prim_id) return k;
  for (uint k = 0; k < s->count; ++k)
    if (shows_same(g, s->prims[k], prim_id, x, y)) return k;
  if (s->count == CROWD) return CROWD;
  s->prims[s->count] = prim_id;
  return s->count++;
}

// Counts the samples FOUND of a visit, which show one stratum; returns those that are to be shaded. CALLED: those that are
// where it is open. OWN: the visit's entry.
static inline uint take_samples(Strata *s, uint stratum, uint found, uint called, uint4 own, uint lone_samples) {
  const uint first_number = own.w >> 1, is_new = own.w & 1;
  s->covered[stratum] += is_new * popcount(found);
  if (stratum == CROWD) {
    s->shaded[CROWD] += is_new * popcount(found);
    return is_new ? found : 0;
  }
  const uint low = (s->firsts[stratum] & 0xffffu) - first_number, high = (s->firsts[stratum] >> 16) - first_number;
  uint shaded = called;
  if (low < VISIT_SAMPLES) shaded &= ~(1u << low);
  if (high < VISIT_SAMPLES) shaded &= ~(1u << high);
  const bool calls_for_two = is_new && s->covered[stratum] > lone_samples;
  uint known = s->shaded[stratum] + popcount(shaded), left = found & ~shaded;
  for (; left != 0 && known < 2; left &= left - 1) {
    const uint first = left & (0 - left);
    if (known == 1 && !(calls_for_two && first & own.y >> 16)) continue;
    s->firsts[stratum] = s->firsts[stratum] << 16 | (first_number + first_bit(first));
    shaded |= first;
    known += 1;
  }
  s->shaded[stratum] += popcount(shaded);
  return shaded;
}

// Where the samples of a visit stand, of one pixel. Those of the first visit are not written where nothing differs.
static inline global const uint *visit_samples(uint4 visit, uint pixel, uint item, uint stride,
                                               global const uint *first_prims, global const uint *later_prims) {
  if (visit.x == FIRST_VISIT) return first_prims + (size_t)pixel * VISIT_SAMPLES;
  return later_prims + (size_t)item * stride + visit.x;
}

// Reads: pixels, slots (list_edge_pixels, keep_strata), differs, first_prims, later_prims (rasterize_samples). Writes:
// stratum_prims, stratum_counts, stratum_firsts, chosen, chosen_counts (for list_chosen). Work item: one listed pixel.
// Local memory: 0 bytes.
kernel void meet_strata(
    View view,
    uint count,                                   // of listed pixels
    float surface_distance,
    uint visit_count,                             // of VISIT_SAMPLES samples each
    uint stride,                                  // entries from one listed pixel to the next in later_prims
    uint begins,                                  // 1: nothing is known yet
    uint lone_samples,                            // of a surface that shows in more than so many two are shaded
    uint uses_center,                             // 1: the centre's colour is that of one shaded sample of its surface
    global const float4 *restrict positions,      // [vertex_count] world space times world_scale
    global const uint *restrict indices,          // [3 * triangle_count]
    global const uint *restrict object_ids,       // [triangle_count]
    global const uint *restrict material_ids,     // [triangle_count]
    global const uint4 *restrict visits,          // [visit_count] first entry or FIRST_VISIT; a bit for each sample that
                                                  // counts | for each that may be a surface's second << 16; a bit for each
                                                  // that is shaded where its stratum is open; number of the first sample
                                                  // << 1, and 1: all are new
    global const uint *restrict sample_positions, // [visit_count * VISIT_SAMPLES] 256ths of a pixel, x | y << 16
    global const uint *restrict pixels,           // [count]
    global const uint *restrict slots,            // [count] where what is known of a pixel stands
    global const uint *restrict center_prims,     // [pixel_count]
    global const uchar *restrict differs,         // [pixel_count] 0: all samples of the first visit show center_prims
    global const uint *restrict first_prims,      // [pixel_count * VISIT_SAMPLES] prim_id or NO_HIT, of pixels that differ
    global const uint *restrict later_prims,      // [count * stride]
    global const uchar *restrict open,            // [slots] a bit for each stratum that calls for more shading
    global uint *restrict stratum_prims,          // [slots * STRATA] in and out
    global uint *restrict stratum_counts,         // [slots * STRATA] in and out: samples | shaded << 16
    global uint *restrict stratum_firsts,         // [slots * STRATA] in and out: numbers of samples shaded when few were
    global ChosenSamples *restrict chosen,        // [count * visit_count]
    global uchar *restrict chosen_counts)         // [count]
{
  const uint item = get_global_id(0);
  if (item >= count) return;
  const uint pixel = pixels[item];
  const size_t slot = slots[item];
  const Ground g = {view, surface_distance, positions, indices, object_ids, material_ids};
  const float left = (float)(pixel % view.width) - view.center_x;
  const float top = (float)(pixel / view.width + view.band_top) - view.center_y;
  Strata s = begins ? no_strata() : load_strata(slot, stratum_prims, stratum_counts, stratum_firsts);
  if (begins && uses_center) {
    s.prims[0] = center_prims[pixel];
    s.shaded[0] = s.count = 1;
  }
  const uint is_open = begins ? (1u << STRATA) - 1 : open[slot];
  uint chosen_count = 0;
  for (uint visit = 0; visit < visit_count; ++visit) {
    const uint4 own = visits[visit];
    global const uint *samples = visit_samples(own, pixel, item, stride, first_prims, later_prims);
    // Where samples do not differ from the centre they need not be looked at. All else by triangle, as they come.
    const bool is_plain = own.x == FIRST_VISIT && !differs[pixel];
    const uint16 shown = is_plain ? (uint16)(center_prims[pixel]) : vload16(0, samples);
    ChosenSamples marked = (ChosenSamples)(0);
    for (uint left_over = own.y & 0xffffu; left_over != 0;) {
      const uint k = first_bit(left_over), prim_id = is_plain ? center_prims[pixel] : samples[k];
      const uint position = sample_positions[visit * VISIT_SAMPLES + k];
      const float x = left + (float)(position & 0xffffu) / 256.0f, y = top + (float)(position >> 16) / 256.0f;
      const uint stratum = find_stratum(&g, &s, prim_id, x, y), found = left_over & samples_of(shown, prim_id);
      left_over &= ~found;
      const uint called = is_open >> stratum & 1 ? found & own.z : 0;
      const uint shaded = take_samples(&s, stratum, found, called, own, lone_samples);
      chosen_count += popcount(shaded);
      marked = add_chosen(marked, shaded, stratum);
    }
    chosen[item * (size_t)visit_count + visit] = marked;
  }
  for (uint k = 0; k < STRATA; ++k) {
    stratum_counts[STRATA * slot + k] = s.covered[k] | s.shaded[k] << 16;
    if (k >= s.count) continue;
    stratum_prims[STRATA * slot + k] = s.prims[k];
    stratum_firsts[STRATA * slot + k] = s.firsts[k];
  }
  chosen_counts[item] = chosen_count;
}

// Reads: pixels, first_prims, later_prims, chosen (meet_strata), begins (list_samples.cl). Writes: shaded_prims, places
// (for shade_hits), first_shaded (for gather_strata). Work item: LIST_CHUNK listed pixels. Local memory: 0 bytes.
kernel void list_chosen(
    uint count,
    uint visit_count,
    uint stride,
    global const uint4 *restrict visits,          // [visit_count]
    global const uint *restrict sample_positions, // [visit_count * VISIT_SAMPLES]
    global const uint *restrict pixels,           // [count]
    global const uint *restrict center_prims,     // [pixel_count]
    global const uchar *restrict differs,         // [pixel_count]
    global const uint *restrict first_prims,      // [pixel_count * VISIT_SAMPLES] of pixels that differ
    global const uint *restrict later_prims,      // [count * stride]
    global const ChosenSamples *restrict chosen,  // [count * visit_count]
    global const uint *restrict begins,           // [chunks + 1]
    global uint *restrict first_shaded,           // [count] where a pixel's samples begin in the list
    global uint *restrict shaded_prims,           // [listed]
    global uint2 *restrict places)                // [listed] pixel of the band; where in it, x | y << 16
{
  const uint begin = get_global_id(0) * LIST_CHUNK;
  if (begin >= count) return;
  uint position = begins[begin / LIST_CHUNK];
  for (uint item = begin; item < min(begin + LIST_CHUNK, count); ++item) {
    const uint pixel = pixels[item];
    first_shaded[item] = position;
    for (uint visit = 0; visit < visit_count; ++visit) {
      const bool is_plain = visits[visit].x == FIRST_VISIT && !differs[pixel];
      global const uint *samples = visit_samples(visits[visit], pixel, item, stride, first_prims, later_prims);
      for (uint mask = chosen[item * (size_t)visit_count + visit].x; mask != 0; mask &= mask - 1) {
        const uint k = first_bit(mask);
        shaded_prims[position] = is_plain ? center_prims[pixel] : samples[k];
        places[position++] = (uint2)(pixel, sample_positions[visit * VISIT_SAMPLES + k]);
      }
    }
  }
}
