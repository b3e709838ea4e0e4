// Shades the visible triangle of each sample, once: deferred shading of primary hits.
//
// Durand, 'A Unifying Paradigm', section 7 (deferred shading: a sample is shaded after visibility is
// known, so never twice).
//   hits = visible_prims[pixels];  setup of their canonical forms;  b_i = V_i / (V_0 + V_1 + V_2): camera_hits.clh
//   write what was asked for: depth, position, normals, uv, albedo, colour, ids
// Lanes are samples; textures and materials are looked up lane by lane.
// Light: the scene's punctual lights without shadows (KHR_lights_punctual), with glTF's
// metallic-roughness model; where there are none a headlight, radiance = base colour x cosine. With SECONDARY only what
// a surface emits: the rest is found by rays, which begin at the hits that are left here (scatter_rays.cl).
// Good at: any number of triangles. Bad at: many lights (each is evaluated). Tests: tests/test_shading.py.

#include "vector.clh"
#include "edge_function.clh"
#define FOOTPRINTS DERIVATIVES
#include "surface_lanes.clh"
#include "lighting.clh"
#include "elementary.clh"
#include "sampling.clh"
#include "camera_hits.clh"
#include "channel_planes.clh"

// What lanes' surfaces are made of.
typedef struct {
  Finish finish;
  float_v base_alpha, alpha;  // alpha: of blending surfaces, else 1
  Vec3 emitted;
  int_v is_unlit, blends;
} Coats;

INLINE void load_coats(Surfaces surfaces, const Samples *s, const Hits *hits, Coats *coats) {
  float4 base[VECTOR_WIDTH], emitted[VECTOR_WIDTH];
  float metallic[VECTOR_WIDTH] = {0}, roughness[VECTOR_WIDTH] = {0}, reflectance[VECTOR_WIDTH] = {0};
  uint flags[VECTOR_WIDTH] = {0}, materials[VECTOR_WIDTH];
  for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) base[lane] = emitted[lane] = (float4)(0.0f);
  const ulong hit_lanes = LANE_MASK(s->is_hit);
  for (ulong mask = hit_lanes; mask != 0; mask &= mask - 1) {
    const uint lane = first_lane(mask);
    materials[lane] = surfaces.material_ids[s->prims[lane]];
    global const Material *own = surfaces.materials + materials[lane];
    metallic[lane] = own->metallic;
    roughness[lane] = own->roughness;
    reflectance[lane] = own->reflectance;
    flags[lane] = own->flags;
  }
  color_lanes(surfaces, hits->at, materials, hit_lanes, false, base);
#if EMISSION
  color_lanes(surfaces, hits->at, materials, hit_lanes, true, emitted);
#endif
  float_v unused;
  const Finish finish = {join_points(base, &coats->base_alpha), LOAD_V(metallic), LOAD_V(roughness), LOAD_V(reflectance)};
  coats->finish = finish;
  coats->emitted = join_points(emitted, &unused);
  coats->is_unlit = (LOAD_V(flags) & (uint_v)(MATERIAL_UNLIT)) != 0;
  coats->alpha = (float_v)(1.0f);
  coats->blends = LANES < 0;
#if ALPHA_BLEND
  coats->blends = (LOAD_V(flags) & (uint_v)(MATERIAL_BLEND)) != 0;
  coats->alpha = coats->blends ? min(max(coats->base_alpha, 0.0f), 1.0f) : coats->alpha;
#endif
}

#if LIT
// Adds what a light brings, without shadows.
INLINE Vec3 add_light(Light light, const Samples *s, const Hits *hits, const Coats *coats, Vec3 g, Vec3 n, Vec3 to_viewer, Vec3 sum) {
  float4 places[VECTOR_WIDTH], brought[VECTOR_WIDTH], ways[VECTOR_WIDTH];
  list_points(hits->plane.position, (float_v)(0.0f), places);
  for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) brought[lane] = ways[lane] = (float4)(0.0f);
  for (ulong mask = LANE_MASK(s->is_hit); mask != 0; mask &= mask - 1) {
    const uint lane = first_lane(mask);
    brought[lane] = incoming(light, places[lane], ways + lane);
  }
  float_v unused;
  const Vec3 arriving = join_points(brought, &unused), to_light = join_points(ways, &unused);
  const Vec3 sent = multiply3(arriving, reflected_by(coats->finish, n, to_viewer, to_light, LANES >= 0));
  return select3(dot3(g, to_light) > 0.0f, add(sum, sent), sum);
}
#endif

// Radiance towards the viewer; not premultiplied.
INLINE Vec3 shade(const Samples *s, const Hits *hits, const Coats *coats, uint light_count, global const Light *lights) {
  Vec3 radiance = fill3((float_v)(0.0f));
#if EMISSION
  radiance = add(radiance, coats->emitted);
#endif
#if !SECONDARY
  const Vec3 to_viewer = negate3(unit3(s->direction));
  const float_v side = dot3(hits->geometric_normal, to_viewer) < 0.0f ? (float_v)(-1.0f) : (float_v)(1.0f);
  const Vec3 n = scale3(hits->shading_normal, side);
#if LIT
  const Vec3 g = scale3(hits->geometric_normal, side);
  for (uint i = 0; i < light_count; ++i) radiance = add_light(lights[i], s, hits, coats, g, n, to_viewer, radiance);
#else
  radiance = add(radiance, scale3(coats->finish.base, fabs(dot3(n, to_viewer))));
#endif
#endif
  // KHR_materials_unlit: the base colour is all that counts of such a material, not its emission.
  return select3(coats->is_unlit, coats->finish.base, radiance);
}

#if SECONDARY
// What rays that go on need of hits.
typedef struct {
  global float4 *weights, *positions, *directions;
  global uint *keys;
#if COLORS_VARY
  global float4 *colors;
#endif
#if DERIVATIVES
  global float4 *footprints;
#endif
} Left;

// Leaves hits for rays that go on; weight: share of the pixel.
INLINE void leave_hits(const Left *left, size_t first, View view, float footprint, const Samples *s, const Hits *hits,
                       const Coats *coats, float_v weight) {
  float4 positions[VECTOR_WIDTH], directions[VECTOR_WIDTH];
  float weights[VECTOR_WIDTH], x[VECTOR_WIDTH], y[VECTOR_WIDTH];
  list_points(hits->plane.position, hits->plane.doubt, positions);
  list_points(s->direction, (float_v)(0.0f), directions);
  STORE_V(weight, weights);
  STORE_V(s->x, x);
  STORE_V(s->y, y);
#if COLORS_VARY
  float4 colors[VECTOR_WIDTH];
  list_points(coats->finish.base, coats->base_alpha, colors);
#endif
#if DERIVATIVES
  const Change steps = direction_change(view, s->x - view.center_x, s->y - view.center_y);
  float4 right[VECTOR_WIDTH], down[VECTOR_WIDTH];
  list_points(scale3(unit_change(s->direction, steps.right), (float_v)(footprint)), (float_v)(0.0f), right);
  list_points(scale3(unit_change(s->direction, steps.down), (float_v)(footprint)), (float_v)(0.0f), down);
#endif
  for (ulong mask = LANE_MASK(s->is_hit); mask != 0; mask &= mask - 1) {
    const uint lane = first_lane(mask);
    const size_t pixel = first + lane;
    const SurfacePoint *at = &hits->at[lane];
    left->weights[pixel] = (float4)(at->b0, at->b1, at->b2, weights[lane]);
    left->positions[pixel] = positions[lane];
    left->directions[pixel] = directions[lane];
    left->keys[pixel] = hash_pair((uint)x[lane] | (uint)y[lane] << 16, s->offset[lane]);
#if COLORS_VARY
    left->colors[pixel] = colors[lane];
#endif
#if DERIVATIVES
    left->footprints[3 * pixel] = (float4)(at->db1, at->db2);
    left->footprints[3 * pixel + 1] = right[lane];
    left->footprints[3 * pixel + 2] = down[lane];
#endif
  }
}
#endif

INLINE void list_prims(global const uint *visible_prims, uint first, Samples *s) {
  uint found[VECTOR_WIDTH];
  for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) {
    found[lane] = lane < s->lanes ? visible_prims[first + lane] : NO_HIT;
    s->prims[lane] = found[lane] == NO_HIT ? 0 : found[lane];
  }
  s->is_hit = LOAD_V(found) != NO_HIT;
}

// Reads: visible_prims (rasterize_tiles), scene buffers (host). Writes: values, ids (host), open_pixels
// (host: whether another layer is called for). Work item: VECTOR_WIDTH pixels. Local memory: 0 bytes.
kernel void shade_hits(
    View view,
    Planes planes,                                 // where each group of channels goes
    uint pixel_count,                              // of the band
    uint light_count,
#if DERIVATIVES
    float footprint,                               // side of what a sample stands for, pixels
#endif
    uint layer,                                    // 0, then 1.. for what lies behind BLEND surfaces
    global const float4 *restrict positions,       // [vertex_count] world space times world_scale
    global const uint *restrict indices,           // [3 * triangle_count]
    global const float4 *restrict normals,         // [vertex_count] unit or 0
    global const float2 *restrict uv,              // [vertex_count]
    global const float2 *restrict uv1,             // [vertex_count]
    global const float4 *restrict colors,          // [vertex_count] linear
    global const uint *restrict object_ids,        // [triangle_count]
    global const uint *restrict material_ids,      // [triangle_count]
    global const Material *restrict materials,     // [material_count]
    global const Texture *restrict textures,       // [texture_count]
    global const uchar4 *restrict texels,          // of all textures
    global const float *restrict srgb_to_linear,   // [512] see Surfaces
    global const Light *restrict lights,           // [light_count]
    global const uint *restrict visible_prims,     // [pixel_count] prim_id or NO_HIT
#if SAMPLE_LIST
    global const uint2 *restrict places,           // [pixel_count] pixel of the band; sample in it, 256ths: x | y << 16
#endif
#if SECONDARY
    global float4 *restrict hit_weights,           // [pixel_count] barycentrics b0 b1 b2; w share of the pixel, 0: none
    global float4 *restrict hit_positions,         // [pixel_count] world space
    global float4 *restrict hit_directions,        // [pixel_count] d of the ray that found it, w 0
    global uint *restrict sample_keys,             // [pixel_count] a number of its own for each sample of the image
#if COLORS_VARY
    global float4 *restrict hit_colors,            // [pixel_count] linear base colour and alpha
#endif
#if DERIVATIVES
    global float4 *restrict hit_footprints,        // [3 * pixel_count], see ray_items.clh
#endif
#endif
    global float *restrict values,                 // [planes * pixel_count]
    global uint *restrict ids,                     // [2 * pixel_count] object, material
    global uchar *restrict open_pixels)            // [pixel_count] 1 where the hit is a BLEND surface
{
  const uint first = get_global_id(0) * VECTOR_WIDTH;
  if (first >= pixel_count) return;
  Samples s;
  s.lanes = min(pixel_count - first, (uint)VECTOR_WIDTH);
  uint pixels[VECTOR_WIDTH], columns[VECTOR_WIDTH], rows[VECTOR_WIDTH];
  list_items(first, pixel_count, pixels);
#if SAMPLE_LIST
  for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) {
    const uint2 place = places[pixels[lane]];
    pixels[lane] = place.x;
    s.offset[lane] = place.y;
  }
#else
  for (uint lane = 0; lane < VECTOR_WIDTH; ++lane)
    s.offset[lane] = (uint)(view.sample_x * 256.0f) | (uint)(view.sample_y * 256.0f) << 16;
#endif
  list_places(pixels, view.width, columns, rows);
  place_samples(view, columns, rows, &s);
  list_prims(visible_prims, first, &s);
  const Out out = {values + first, pixel_count, s.lanes};
  if (planes.ray != PLANE_NONE && layer == 0) store_rays(&out, planes.ray, view, &s);

  const bool meets = has_lane(s.is_hit);
  for (uint lane = 0; lane < s.lanes; ++lane) open_pixels[first + lane] = 0;
  if (!meets && layer > 0) return;
#if !DERIVATIVES
  const float footprint = 0.0f;
#endif
  Hits hits;
  const bool has_place = SECONDARY || LIT || (layer == 0 &&
      (planes.depth != PLANE_NONE || planes.distance != PLANE_NONE || planes.position != PLANE_NONE));
  if (meets) find_hits(view, &s, has_place, footprint, positions, indices, normals, &hits);
  else find_nothing(&hits);
  if (layer == 0) {
    store_geometry(&out, planes, &s, &hits, uv);
    if (planes.id != PLANE_NONE) store_ids(&s, object_ids, material_ids, ids + first, pixel_count);
  }
  if (planes.color == PLANE_NONE && planes.albedo == PLANE_NONE) return;
  const Surfaces surfaces = {material_ids, materials, textures, texels, srgb_to_linear, uv, uv1, colors};
  Coats coats;
  load_coats(surfaces, &s, &hits, &coats);
  const Vec3 nothing = fill3((float_v)(0.0f));
  if (planes.albedo != PLANE_NONE && layer == 0) store_planes(&out, planes.albedo, select3(s.is_hit, coats.finish.base, nothing));
  if (planes.color == PLANE_NONE) return;
#if SECONDARY
  const Left left = {hit_weights, hit_positions, hit_directions, sample_keys
#if COLORS_VARY
                     , hit_colors
#endif
#if DERIVATIVES
                     , hit_footprints
#endif
  };
  const float_v behind = layer > 0 ? 1.0f - load_plane(&out, planes.color + 3) : (float_v)(1.0f);
  leave_hits(&left, first, view, footprint, &s, &hits, &coats, coats.is_unlit ? (float_v)(0.0f) : coats.alpha * behind);
#endif
  store_color(&out, planes.color, &s, shade(&s, &hits, &coats, light_count, lights), coats.alpha, layer);
#if ALPHA_BLEND
  for (ulong mask = LANE_MASK(s.is_hit & coats.blends); mask != 0; mask &= mask - 1) open_pixels[first + first_lane(mask)] = 1;
#endif
}
