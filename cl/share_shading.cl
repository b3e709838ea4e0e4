// Antialiasing with shared shading: samples know their surface, a surface is shaded once in a pixel.
//
// Davidovic et al., '3D Rasterization', section 4, 'Anti-aliasing' (MSAA and CSAA in a 3D rasterizer). Visibility at
// the samples is known before (one pass a sample), and so is the colour of every pixel's centre.
//   edge pixels: a sample shows another triangle than the centre; all others keep the colour of the centre
//   in an edge pixel: triangles that differ neither in object and material nor, much, in direction and depth are one
//   surface; that of the centre has its colour already, each other is shaded once, where its samples' centroid lies
//   csaa: a coverage sample belongs to the nearest known triangle that covers it, or to nothing, if a sample shows that
//   and none covers it; where triangles are fine, so that some may be unknown, coverage samples do not count
//   colour of the pixel: the mean over its samples of the colours of their surfaces
// Where one colour for a surface is not enough (csaa with shading rate sample) each sample that has visibility of its own
// is a surface by itself, and a coverage sample has the colour of the nearest of those that show its surface.
// Lists are those of list_samples.cl.
// Good at: few surfaces a pixel, however many triangles. Bad at: textures finer than pixels (shade every sample then).
// Tests: tests/test_antialiasing.py.

#include "vector.clh"
#include "edge_function.clh"
#include "same_surface.clh"

// The triangles that a pixel's samples show, and the surfaces that they are parts of.
typedef struct {
  uint prims[MAX_SHARED_SAMPLES + 1];
  uchar surface[MAX_SHARED_SAMPLES + 1];        // of each of them
  SurfacePlane planes[MAX_SHARED_SAMPLES + 1];  // of the first triangle of each surface
  uint prim_count, surface_count;
} PixelSurfaces;

// The surface of a triangle that a sample at (X, Y) shows; a new one where it is part of none.
static inline uchar find_surface(const Ground *g, PixelSurfaces *s, uint prim_id, float x, float y) {
  if (prim_id == NO_HIT) return SURFACE_NOTHING;
  for (uint k = 0; k < s->prim_count; ++k)
    if (s->prims[k] == prim_id) return s->surface[k];
  const SurfacePlane plane = plane_of(g, prim_id);
  uint surface = 0;
  for (; surface < s->surface_count; ++surface)
    if (s->planes[surface].prim_id != NO_HIT && is_same_surface(g, &s->planes[surface], &plane, x, y)) break;
  if (surface == s->surface_count) s->planes[s->surface_count++] = plane;
  s->prims[s->prim_count] = prim_id;
  s->surface[s->prim_count++] = surface;
  return surface;
}

// Whether a corner of a triangle lies within FINE_TRIANGLE_PIXELS of the opposite edge, about (X, Y): its weights change
// by more than 1 over that way. Others of its surface are likely to lie beside it then, and no sample may show them.
static inline bool is_fine_triangle(const Ground *g, const TriangleSetup *t, float x, float y) {
  float sum = 0.0f, steepest = 0.0f;
  const SamplePoint at = sample_point(g->view, x, y);
#if !PLANAR
  const SamplePoint right = sample_point(g->view, x + 1.0f, y), below = sample_point(g->view, x, y + 1.0f);
#endif
  for (uint i = 0; i < 3; ++i) {
    const float value = edge_value_at(t->edge[i], at);
    sum += value;
#if PLANAR
    steepest = max(steepest, max(fabs(t->edge[i].gx), fabs(t->edge[i].gy)));
#else
    steepest = max(steepest, max(fabs(edge_value_at(t->edge[i], right) - value), fabs(edge_value_at(t->edge[i], below) - value)));
#endif
  }
  return steepest * FINE_TRIANGLE_PIXELS > fabs(sum);
}

// Coverage samples: each belongs to the nearest of the known triangles that cover it. (left, top) : the pixel's corner.
// Returns whether it can be known; it cannot where surfaces are of fine triangles.
static inline bool cover_samples(
    const Ground *g, const PixelSurfaces *s, float left, float top, uint begin, uint end,
    global const uint *sample_positions, global uchar *out) {
  float nearest[MAX_SHARED_SAMPLES];
  for (uint sample = begin; sample < end; ++sample) nearest[sample] = NEARNESS_OF_NOTHING;
  for (uint k = 0; k < s->prim_count; ++k) {
    const uint prim_id = s->prims[k];
    if (prim_id == NO_HIT) continue;
    const float4 p0 = g->positions[g->indices[3 * prim_id]], p1 = g->positions[g->indices[3 * prim_id + 1]];
    const float4 p2 = g->positions[g->indices[3 * prim_id + 2]];
    const Vec3 a = {p0.x, p0.y, p0.z}, b = {p1.x, p1.y, p1.z}, c = {p2.x, p2.y, p2.z};
    const TriangleSetup t = setup_triangles_3d(canonical_triangles(a, b, c), g->view);
    if (!t.valid) continue;
    if (is_fine_triangle(g, &t, left + 0.5f, top + 0.5f)) return false;
    for (uint sample = begin; sample < end; ++sample) {
      const float x = left + (float)(sample_positions[sample] & 0xffffu) / 256.0f;
      const float y = top + (float)(sample_positions[sample] >> 16) / 256.0f;
      const SamplePoint at = sample_point(g->view, x, y);
      float v[3];
      for (uint i = 0; i < 3; ++i) v[i] = edge_value_at(t.edge[i], at);
#if PLANAR
      if (sample_outside(v[0], v[1], v[2], t.edge[0].exclusive, t.edge[1].exclusive, t.edge[2].exclusive) < 0) continue;
#else
      const Tangents along = sample_tangents(g->view, x, y);
      bool inside = true;
      for (uint i = 0; i < 3; ++i)
        inside = inside && (v[i] > 0.0f || (v[i] == 0.0f && is_inclusive(t.edge[i].c, t.edge[i].gx, t.edge[i].gy, along)));
      if (!inside) continue;
#endif
      const float near = edge_value(t.nearness.c, t.nearness.x, t.nearness.y, at);
      if (!(near > nearest[sample])) continue;
      nearest[sample] = near;
      out[sample] = s->surface[k];
    }
  }
  return true;
}

// Makes each sample that has visibility of its own a surface by itself; returns how many. `out` in: surfaces.
static inline uint part_samples(
    uint depth_count, uint sample_count, global const uint *sample_positions, global uchar *out) {
  uchar own[MAX_SHARED_SAMPLES];
  uint count = 0;
  for (uint sample = 0; sample < depth_count; ++sample) own[sample] = out[sample] == SURFACE_NOTHING ? SURFACE_NOTHING : ++count;
  for (uint sample = depth_count; sample < sample_count; ++sample) {
    if (out[sample] == SURFACE_NOTHING) continue;
    const int x = sample_positions[sample] & 0xffffu, y = sample_positions[sample] >> 16;
    int least = 0x7fffffff;
    uchar nearest = SURFACE_UNKNOWN;
    for (uint other = 0; other < depth_count; ++other) {
      const int dx = (int)(sample_positions[other] & 0xffffu) - x, dy = (int)(sample_positions[other] >> 16) - y;
      if (out[other] != out[sample] || dx * dx + dy * dy >= least) continue;
      least = dx * dx + dy * dy;
      nearest = own[other];
    }
    out[sample] = nearest;
  }
  for (uint sample = 0; sample < depth_count; ++sample) out[sample] = own[sample];
  return count;
}

// Reads: edge_pixels (list_samples.cl), center_prims, sample_prims (rasterize_tiles, rasterize_samples), scene buffers (host).
// Writes: surfaces (for list_surfaces, resolve_surfaces), new_surfaces (for sum_bytes).
// Work item: one edge pixel. Local memory: 0 bytes.
kernel void group_samples(
    View view,
    uint first_edge,                              // of the list that is taken
    uint edge_count,                              // from there on
    uint depth_count,                             // samples with visibility of their own
    uint sample_count,                            // and coverage samples
    uint pixel_stride,                            // entries from one pixel to the next in sample_prims
    uint sample_stride,                           // and from one sample
    uint parts,                                   // 1: each sample with visibility of its own is shaded
    float surface_distance,                       // of planes that count as one: world units, or a share of t
    global const float4 *restrict positions,      // [vertex_count] world space times world_scale
    global const uint *restrict indices,          // [3 * triangle_count]
    global const uint *restrict object_ids,       // [triangle_count]
    global const uint *restrict material_ids,     // [triangle_count]
    global const uint *restrict sample_positions, // [sample_count] 256ths of a pixel, x | y << 16
    global const uint *restrict edge_pixels,      // [first_edge + edge_count]
    global const uint *restrict center_prims,     // [pixel_count]
    global const uint *restrict sample_prims,     // plane by plane of samples, or pixel by pixel
    global uchar *restrict surfaces,              // [edge_count * sample_count] number of each sample's surface
    global uchar *restrict new_surfaces)          // [edge_count] surfaces beside that of the centre
{
  const uint item = get_global_id(0);
  if (item >= edge_count) return;
  const uint pixel = edge_pixels[first_edge + item];
  const float left = (float)(pixel % view.width) - view.center_x;
  const float top = (float)(pixel / view.width + view.band_top) - view.center_y;
  const Ground g = {view, surface_distance, positions, indices, object_ids, material_ids};
  PixelSurfaces s;
  s.prims[0] = center_prims[pixel];
  s.planes[0].prim_id = NO_HIT;
  if (s.prims[0] != NO_HIT) s.planes[0] = plane_of(&g, s.prims[0]);
  s.surface[0] = SURFACE_OF_CENTER;
  s.prim_count = s.surface_count = 1;
  bool shows_nothing = s.prims[0] == NO_HIT;
  global uchar *out = surfaces + (size_t)item * sample_count;
  for (uint sample = 0; sample < depth_count; ++sample) {
    const uint position = sample_positions[sample];
    const float x = left + (float)(position & 0xffffu) / 256.0f, y = top + (float)(position >> 16) / 256.0f;
    const uint prim_id = sample_prims[(size_t)sample * sample_stride + (size_t)pixel * pixel_stride];
    shows_nothing |= prim_id == NO_HIT;
    out[sample] = find_surface(&g, &s, prim_id, x, y);
  }
  const bool is_whole = s.surface_count == 1 && !shows_nothing;  // one surface: so are the samples that nobody asked
  for (uint sample = depth_count; sample < sample_count; ++sample)
    out[sample] = is_whole && !parts ? SURFACE_OF_CENTER : SURFACE_UNKNOWN;
  if (!is_whole && sample_count > depth_count) {
    const bool is_known = s.prim_count == s.surface_count &&
                          cover_samples(&g, &s, left, top, depth_count, sample_count, sample_positions, out);
    for (uint sample = depth_count; sample < sample_count; ++sample) {
      if (!is_known) out[sample] = SURFACE_UNKNOWN;
      else if (out[sample] == SURFACE_UNKNOWN && shows_nothing) out[sample] = SURFACE_NOTHING;
    }
  }
  new_surfaces[item] = parts ? part_samples(depth_count, sample_count, sample_positions, out) : s.surface_count - 1;
}

// The sample of a surface that lies nearest to the centroid of its samples, the first of equals.
static inline uint central_sample(
    global const uchar *surfaces, global const uint *sample_positions, uint depth_count, uint surface) {
  int count = 0, sum_x = 0, sum_y = 0, least = 0x7fffffff;
  for (uint sample = 0; sample < depth_count; ++sample) {
    if (surfaces[sample] != surface) continue;
    count += 1;
    sum_x += sample_positions[sample] & 0xffffu;
    sum_y += sample_positions[sample] >> 16;
  }
  uint best = 0;
  for (uint sample = 0; sample < depth_count; ++sample) {
    if (surfaces[sample] != surface) continue;
    const int dx = count * (int)(sample_positions[sample] & 0xffffu) - sum_x;
    const int dy = count * (int)(sample_positions[sample] >> 16) - sum_y;
    if (dx * dx + dy * dy >= least) continue;
    least = dx * dx + dy * dy;
    best = sample;
  }
  return best;
}

// Reads: surfaces, new_surfaces (group_samples), begins (list_samples.cl). Writes: shaded_prims, places (for shade_hits),
// first_surfaces (for resolve_surfaces). Work item: LIST_CHUNK edge pixels. Local memory: 0 bytes.
kernel void list_surfaces(
    uint first_edge,                              // of the list that is taken
    uint edge_count,                              // from there on
    uint depth_count,
    uint sample_count,
    uint pixel_stride,
    uint sample_stride,
    global const uint *restrict sample_positions, // [sample_count]
    global const uint *restrict edge_pixels,      // [first_edge + edge_count]
    global const uint *restrict sample_prims,
    global const uchar *restrict surfaces,        // [edge_count * sample_count]
    global const uchar *restrict new_surfaces,    // [edge_count]
    global const uint *restrict begins,           // [chunks + 1]
    global uint *restrict first_surfaces,         // [edge_count] where a pixel's surfaces begin in the list
    global uint *restrict shaded_prims,           // [listed] triangle that is shaded
    global uint2 *restrict places)                // [listed] pixel of the band; where in it, x | y << 16
{
  const uint begin = get_global_id(0) * LIST_CHUNK;
  if (begin >= edge_count) return;
  uint position = begins[begin / LIST_CHUNK];
  for (uint item = begin; item < min(begin + LIST_CHUNK, edge_count); ++item) {
    const uint pixel = edge_pixels[first_edge + item];
    first_surfaces[item] = position;
    for (uint surface = 1; surface <= new_surfaces[item]; ++surface, ++position) {
      const uint sample = central_sample(surfaces + (size_t)item * sample_count, sample_positions, depth_count, surface);
      shaded_prims[position] = sample_prims[(size_t)sample * sample_stride + (size_t)pixel * pixel_stride];
      places[position] = (uint2)(pixel, sample_positions[sample]);
    }
  }
}
