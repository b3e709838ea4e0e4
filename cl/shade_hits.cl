// Shades the visible triangle of each sample, once: deferred shading of primary hits.
//
// Durand, 'A Unifying Paradigm', section 7 (deferred shading: a sample is shaded after visibility is
// known, so never twice). The edge functions of the visible triangle are evaluated again at the
// sample; their ratios are its barycentrics (Davidovic et al., section 3.2: lambda_i = V_i / sum V).
//   hit = visible_prims[pixel];  setup of its canonical form;  b_i = V_i / (V_0 + V_1 + V_2)
//   write what was asked for: depth, position, normals, uv, albedo, colour, ids
// Light: the scene's punctual lights without shadows (KHR_lights_punctual), with glTF's
// metallic-roughness model; where there are none a headlight, radiance = base colour x cosine. With SECONDARY only what
// a surface emits: the rest is found by rays, which begin at the hits that are left here (scatter_rays.cl).
// Good at: any number of triangles. Bad at: many lights (each is evaluated). Tests: tests/test_shading.py.

#include "vector.clh"
#include "edge_function.clh"
#define FOOTPRINTS DERIVATIVES
#include "surface.clh"
#include "lighting.clh"
#include "pair.clh"
#include "elementary.clh"
#include "sampling.clh"
#if DERIVATIVES
#include "pixel_footprints.clh"
#endif

#define PLANE_ERROR 1.1368683772161603e-13f  // 2^-43: of pairs, see meet_plane

// Where the ray through the sample (x, y) of the viewport meets the triangle's plane: t = N . (p_0 - e) / (N . d)
// and e + t d, with e, d0, dx, dy as DESIGN defines them. In pairs of floats, since N . d cancels where a triangle is
// seen at a grazing angle, and e + t d where the eye is far away. t, depth along the view axis and position come in world
// units.
// Where rays go on from the position, w is how far off the plane it may lie before it is rounded to float32. In units of
// 2^-48: a sum of pairs is off by 3 of its terms, a product by 8; N by 11 of |e| x |f|; N . (p_0 - e) by 28, N . d by 31
// of their terms; the quotient by 16 and t d by 8 more. 32 and 64, over |N|, hold all of it.
static inline float4 meet_plane(
    View view, float4 p0, float4 p1, float4 p2, float x, float y, float4 direction, float *t, float *depth) {
  const float4 nothing = (float4)(0.0f);
  const Pair3 normal = pair_cross(pair_difference(p1, p0), pair_difference(p2, p0));
#if PROJECTION == PROJECTION_ORTHOGRAPHIC
  const Pair3 e = pair_affine3(view.first, view.tangent_x, x, view.tangent_y, y);
  const Pair3 d = pair_difference(view.axis, nothing);
#else
  const Pair3 e = pair_difference(view.origin, nothing);
#if PLANAR
  const Pair3 d = pair_affine3(view.first, view.tangent_x, x, view.tangent_y, y);
#else
  const Pair3 d = pair_difference(direction, nothing);
#endif
#endif
  const Pair3 p = pair_difference(p0, nothing);
  const Pair3 way = {
      pair_add(p.x, pair_negate(e.x)), pair_add(p.y, pair_negate(e.y)), pair_add(p.z, pair_negate(e.z))};
  const Pair parameter = pair_divide(pair_dot(normal, way), pair_dot(normal, d));
  *t = parameter.high / view.world_scale;
#if PLANAR
  *depth = *t;
#else
  *depth = pair_multiply(parameter, pair_dot(d, pair_difference(FORWARD(view), nothing))).high / view.world_scale;
#endif
  const Pair at_x = pair_add(e.x, pair_multiply(parameter, d.x));
  const Pair at_y = pair_add(e.y, pair_multiply(parameter, d.y));
  const Pair at_z = pair_add(e.z, pair_multiply(parameter, d.z));
  float doubt = 0.0f;
#if SECONDARY
  const float4 from = fabs(high_parts(e)), to = fabs(high_parts(way)), along = fabs(high_parts(d) * parameter.high);
  const float4 a = fabs(p1 - p0), b = fabs(p2 - p0);
  const float4 terms = {a.y * b.z + a.z * b.y, a.z * b.x + a.x * b.z, a.x * b.y + a.y * b.x, 0.0f};
  doubt = PLANE_ERROR * (dot_f4(terms, to + along * 2.0f) / largest_of(fabs(high_parts(normal))) + largest_of(from));
#endif
  return (float4)(at_x.high, at_y.high, at_z.high, doubt) / view.world_scale;
}

// Evaluates the visible triangle at the sample (x, y) of the viewport; without `has_place` not how far away it is.
static inline Hit find_hit(
    View view, uint prim_id, bool has_place, float x, float y, float footprint, float4 direction,
    global const float4 *positions, global const uint *indices, global const float4 *normals) {
  Hit hit;
  hit.at.prim_id = prim_id;
  hit.at.i0 = indices[3 * prim_id];
  hit.at.i1 = indices[3 * prim_id + 1];
  hit.at.i2 = indices[3 * prim_id + 2];
  const float4 p0 = positions[hit.at.i0], p1 = positions[hit.at.i1], p2 = positions[hit.at.i2];
  const Vec3 a = {p0.x, p0.y, p0.z}, b = {p1.x, p1.y, p1.z}, c = {p2.x, p2.y, p2.z};
  const TriangleSetup setup = setup_triangles_3d(canonical_triangles(a, b, c), view);
  float v[3];
  const SamplePoint at = sample_point(view, x - view.center_x, y - view.center_y);
  for (uint i = 0; i < 3; ++i) v[i] = edge_value_at(setup.edge[i], at);
  // Canonical order began with vertex 1 or 2: turn the weights back to the order of the file.
  const uint turn = is_first(b, c, a) ? 2 : (is_first(c, a, b) ? 1 : 0);
  weigh_vertices(&hit.at, v[turn], v[(turn + 1) % 3], v[(turn + 2) % 3]);
#if FOOTPRINTS
  spread_weights(&hit.at, &setup, view, x, y, v, turn, footprint);
#endif
  hit.position = (float4)(0.0f);
  hit.t = hit.depth = 0.0f;
  if (has_place) hit.position = meet_plane(view, p0, p1, p2, x, y, direction, &hit.t, &hit.depth);
  hit.direction = direction;
  const Vec3 plane = cross3(subtract(b, a), subtract(c, a));
  hit.geometric_normal = unit((float4)(plane.x, plane.y, plane.z, 0.0f));
  hit.shading_normal = interpolate_normal(normals, hit.at, hit.geometric_normal);
  return hit;
}

// Radiance towards the viewer; not premultiplied.
static inline float4 shade(
    Surfaces surfaces, Hit hit, Material material, float4 base, uint light_count, global const Light *lights) {
  // KHR_materials_unlit: the base colour is all that counts of such a material, not its emission.
  if (material.flags & MATERIAL_UNLIT) return base;
  float4 radiance = (float4)(0.0f);
#if EMISSION
  radiance += emitted_light(surfaces, material, hit.at);
#endif
#if !SECONDARY
  const float4 to_viewer = -unit(hit.direction);
  const float side = dot_f4(hit.geometric_normal, to_viewer) < 0.0f ? -1.0f : 1.0f;
  const float4 n = hit.shading_normal * side;
#if LIT
  for (uint i = 0; i < light_count; ++i) {
    float4 to_light;
    const float4 arriving = incoming(lights[i], hit.position, &to_light);
    if (dot_f4(hit.geometric_normal * side, to_light) > 0.0f)
      radiance += arriving * reflected(material, base, n, to_viewer, to_light, true);
  }
#else
  radiance += base * fabs(dot_f4(n, to_viewer));
#endif
#endif
  return radiance;
}

static inline void store3(global float *planes, size_t stride, float4 value) {
  planes[0] = value.x;
  planes[stride] = value.y;
  planes[2 * stride] = value.z;
}

// Puts colour over what is in front of it already: premultiplied, the nearest layer first.
static inline void store_color(global float *color, size_t stride, float4 radiance, float alpha, uint layer) {
  float4 front = (float4)(0.0f);
  if (layer > 0) front = (float4)(color[0], color[stride], color[2 * stride], color[3 * stride]);
  const float share = alpha * (1.0f - front.w);
  color[0] = front.x + radiance.x * share;
  color[stride] = front.y + radiance.y * share;
  color[2 * stride] = front.z + radiance.z * share;
  color[3 * stride] = front.w + share;
}

// Reads: visible_prims (rasterize_tiles), scene buffers (host). Writes: values, ids (host), open_pixels
// (host: whether another layer is called for). Work item: one pixel. Local memory: 0 bytes.
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
#if DERIVATIVES
    global float4 *restrict hit_footprints,        // [3 * pixel_count], see ray_items.clh
#endif
#endif
    global float *restrict values,                 // [planes * pixel_count]
    global uint *restrict ids,                     // [2 * pixel_count] object, material
    global uchar *restrict open_pixels)            // [pixel_count] 1 where the hit is a BLEND surface
{
  const uint pixel = get_global_id(0);
  if (pixel >= pixel_count) return;
#if SAMPLE_LIST
  const uint place = places[pixel].x, position = places[pixel].y;
  const float sample_x = (float)(position & 0xffffu) / 256.0f, sample_y = (float)(position >> 16) / 256.0f;
#else
  const uint place = pixel;
  const float sample_x = view.sample_x, sample_y = view.sample_y;
#endif
  const float x = (float)(place % view.width) + sample_x;
  const float y = (float)(place / view.width + (view.band_row << TILE_LOG2)) + sample_y;
  const size_t stride = pixel_count;
  global float *out = values + pixel;
#if !DERIVATIVES
  const float footprint = 0.0f;
#endif

#if !PLANAR
  const Camera own_ray = camera_of_sample(view, view.origin, x - view.center_x, y - view.center_y);
  const float4 direction = own_ray.direction;
#elif PROJECTION == PROJECTION_ORTHOGRAPHIC
  const float4 direction = view.axis;
#else
  const float4 direction =
      (view.first + view.tangent_x * x) + view.tangent_y * y;
#endif
  if (planes.ray != PLANE_NONE && layer == 0) {
    store3(out + planes.ray * stride, stride, direction);
#if !PLANAR
    store3(out + (planes.ray + 3) * stride, stride, own_ray.step_x);
    store3(out + (planes.ray + 6) * stride, stride, own_ray.step_y);
#elif PROJECTION == PROJECTION_ORTHOGRAPHIC
    store3(out + (planes.ray + 3) * stride, stride, view.tangent_x / view.world_scale);
    store3(out + (planes.ray + 6) * stride, stride, view.tangent_y / view.world_scale);
#else
    store3(out + (planes.ray + 3) * stride, stride, view.tangent_x);
    store3(out + (planes.ray + 6) * stride, stride, view.tangent_y);
#endif
  }

  const uint prim_id = visible_prims[pixel];
  if (prim_id == NO_HIT) {
    open_pixels[pixel] = 0;
    if (layer > 0) return;
    const float4 nothing = (float4)(0.0f);
    if (planes.color != PLANE_NONE) store_color(out + planes.color * stride, stride, nothing, 0.0f, 0);
    if (planes.depth != PLANE_NONE) out[planes.depth * stride] = INFINITY;
    if (planes.distance != PLANE_NONE) out[planes.distance * stride] = INFINITY;
    if (planes.normal != PLANE_NONE) {
      store3(out + planes.normal * stride, stride, nothing);
      store3(out + (planes.normal + 3) * stride, stride, nothing);
    }
    if (planes.position != PLANE_NONE) store3(out + planes.position * stride, stride, nothing);
    if (planes.bary != PLANE_NONE) out[planes.bary * stride] = out[(planes.bary + 1) * stride] = 0.0f;
    if (planes.uv != PLANE_NONE) out[planes.uv * stride] = out[(planes.uv + 1) * stride] = 0.0f;
    if (planes.albedo != PLANE_NONE) store3(out + planes.albedo * stride, stride, nothing);
    if (planes.id != PLANE_NONE) ids[pixel] = ids[stride + pixel] = NO_HIT;
    return;
  }

  const Surfaces surfaces = {material_ids, materials, textures, texels, srgb_to_linear, uv, uv1, colors};
  const bool is_first = layer == 0;
  const bool has_place = SECONDARY || LIT ||
      (is_first && (planes.depth != PLANE_NONE || planes.distance != PLANE_NONE || planes.position != PLANE_NONE));
  const Hit hit = find_hit(view, prim_id, has_place, x, y, footprint, direction, positions, indices, normals);
  const uint material_id = material_ids[prim_id];
  if (layer == 0) {
    if (planes.depth != PLANE_NONE) out[planes.depth * stride] = hit.depth;
    if (planes.distance != PLANE_NONE) out[planes.distance * stride] = hit.t * sqrt(dot_f4(direction, direction));
    if (planes.normal != PLANE_NONE) {
      store3(out + planes.normal * stride, stride, hit.shading_normal);
      store3(out + (planes.normal + 3) * stride, stride, hit.geometric_normal);
    }
    if (planes.position != PLANE_NONE) store3(out + planes.position * stride, stride, hit.position);
    if (planes.bary != PLANE_NONE) {
      out[planes.bary * stride] = hit.at.b1;
      out[(planes.bary + 1) * stride] = hit.at.b2;
    }
    if (planes.uv != PLANE_NONE) {
      const float2 at = interpolate_uv(uv, hit.at);
      out[planes.uv * stride] = at.x;
      out[(planes.uv + 1) * stride] = at.y;
    }
    if (planes.id != PLANE_NONE) {
      ids[pixel] = object_ids[prim_id];
      ids[stride + pixel] = material_id;
    }
  }
  if (planes.color == PLANE_NONE && planes.albedo == PLANE_NONE) return;
  const Material material = materials[material_id];
  const float4 base = base_color(surfaces, material, hit.at);
  if (planes.albedo != PLANE_NONE && layer == 0) store3(out + planes.albedo * stride, stride, base);
  if (planes.color == PLANE_NONE) return;
#if ALPHA_BLEND
  const bool blends = (material.flags & MATERIAL_BLEND) != 0;
#else
  const bool blends = false;
#endif
  const float alpha = blends ? min(max(base.w, 0.0f), 1.0f) : 1.0f;
#if SECONDARY
  const bool is_lit = (material.flags & MATERIAL_UNLIT) == 0;
  const float behind = layer > 0 ? 1.0f - out[(planes.color + 3) * stride] : 1.0f;
  hit_weights[pixel] = (float4)(hit.at.b0, hit.at.b1, hit.at.b2, is_lit ? alpha * behind : 0.0f);
  hit_positions[pixel] = hit.position;
  hit_directions[pixel] = (float4)(direction.xyz, 0.0f);
#if DERIVATIVES
  const Change steps = direction_change(view, x - view.center_x, y - view.center_y);
  hit_footprints[3 * (size_t)pixel] = (float4)(hit.at.db1, hit.at.db2);
  hit_footprints[3 * (size_t)pixel + 1] = unit_change(direction, steps.right) * footprint;
  hit_footprints[3 * (size_t)pixel + 2] = unit_change(direction, steps.down) * footprint;
#endif
#if SAMPLE_LIST
  const uint sample_place = position;
#else
  const uint sample_place = (uint)(sample_x * 256.0f) | (uint)(sample_y * 256.0f) << 16;
#endif
  sample_keys[pixel] = hash_pair((uint)x | (uint)y << 16, sample_place);
#endif
  store_color(out + planes.color * stride, stride, shade(surfaces, hit, material, base, light_count, lights), alpha, layer);
  open_pixels[pixel] = blends ? 1 : 0;
}

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
  if (open_pixels[pixel]) return;
  front_nearness[pixel] = NEARNESS_OF_NOTHING;
#if FILTERED
  front_nearness[(size_t)pixel_count + pixel] = NEARNESS_OF_NOTHING;
#endif
  front_prims[pixel] = NO_HIT;
}
