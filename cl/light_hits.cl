// Light that reaches hits straight from lights: shadow rays, and what becomes of them.
//
// Purcell et al., section 3 and Fig. 3 (shadow caster, Whitted, path tracer). For each light in its order, or in paths for
// one light that is drawn:
//   aim_at_light: a ray from each live item towards the light, with the light that it would bring
//   leave_hits.cl, trace_rays.cl: where each begins; which rays meet something on the way
//   add_light: the light of the others
// In paths a light is drawn by its power: punctual lights, and emissive triangles, on which a point is drawn; what they
// bring is weighted against finding them by chance (Veach and Guibas 1995, power heuristic).
// Good at: few lights. Bad at: many lights outside of paths (a pass each). Tests: tests/test_modes.py.

#define FOOTPRINTS DERIVATIVES
#include "surface.clh"
#include "lighting.clh"
#include "elementary.clh"
#include "sampling.clh"
#include "ray_items.clh"

static inline float power_weight(float a, float b) {
  const float larger = max(a, b);
  if (!(larger > 0.0f)) return 0.0f;
  const float x = a / larger, y = b / larger;
  return x * x / (x * x + y * y);
}

// Density over directions of drawing the point of an emissive triangle that is seen along l at a distance.
static inline float density_of_emitter(const Mesh *mesh, Material material, SurfacePoint at, float4 l, float distance2, float inverse_power) {
  const float4 p0 = mesh->positions[at.i0];
  const float4 e = mesh->positions[at.i1] - p0, f = mesh->positions[at.i2] - p0;
  const float4 cross_product = {e.y * f.z - e.z * f.y, e.z * f.x - e.x * f.z, e.x * f.y - e.y * f.x, 0.0f};
  const float cosine = fabs(dot_f4(unit(cross_product), l));
  const float strength = ((material.emissive.x + material.emissive.y) + material.emissive.z) * inverse_power;
  return cosine > 0.0f ? strength * distance2 / cosine : 0.0f;  // the triangle's area cancels
}

// Reads: items (shade_hits, arrive). Writes: radiances: what items have without any light being asked. Work item: one
// item. Local memory: 0 bytes.
kernel void begin_light(
    uint item_count,
    uint is_first,                                 // 1: hits of the camera's samples
    float inverse_power,                           // of all lights that paths draw
    float environment_r,                           // radiance that comes from where nothing is
    float environment_g,
    float environment_b,
    global const uint *restrict item_prims,        // [item_count], see ray_items.clh
    global const float4 *restrict item_weights,    // [item_count]
    global const float4 *restrict item_positions,  // [item_count]
    global const float4 *restrict item_directions, // [item_count]
    global const float4 *restrict item_throughputs,// [item_count]
#if FOOTPRINTS
    global const float4 *restrict item_footprints, // [3 * item_count]
#endif
    global const float4 *restrict item_origins,    // [item_count] where the ray that arrived began
    global const float4 *restrict positions,       // [vertex_count] world space
    global const uint *restrict indices,           // [3 * triangle_count]
    global const float4 *restrict normals,         // [vertex_count] unit or 0
    global const float2 *restrict uv,              // [vertex_count]
    global const float2 *restrict uv1,             // [vertex_count]
    global const float4 *restrict colors,          // [vertex_count] linear
    global const uint *restrict material_ids,      // [triangle_count]
    global const Material *restrict materials,     // [material_count]
    global const Texture *restrict textures,       // [texture_count]
    global const uchar4 *restrict texels,          // of all textures
    global const float *restrict srgb_to_linear,   // [256]
    global float4 *restrict radiances)             // [item_count] RGB, weighted for the pixel
{
  const uint item = get_global_id(0);
  if (item >= item_count) return;
  const Items items = {item_prims, item_weights, item_positions, item_directions, item_throughputs, is_first
#if FOOTPRINTS
                       , item_footprints
#endif
  };
  const Mesh mesh = {positions, indices, normals};
  const Surfaces surfaces = {material_ids, materials, textures, texels, srgb_to_linear, uv, uv1, colors};
  Place place;
  float4 radiance = (float4)(0.0f);
  if (load_place(&items, &mesh, surfaces, item, &place)) {
    const bool unlit = place.is_unlit;
    if (!is_first && unlit) radiance = place.base * place.alpha;
#if EMISSION
    if (!is_first && !unlit) {
      float share = place.alpha;
#if INDIRECT
      if (place.drawn_density > 0.0f) {
        const float4 way = place.position - item_origins[item];
        share *= power_weight(place.drawn_density, density_of_emitter(&mesh, place.material, place.at, place.direction, dot_f4(way, way), inverse_power));
      }
#endif
      radiance = emitted_light(surfaces, place.material, place.at) * share;
    }
#endif
#if !LIT && !INDIRECT
    const float diffuse = place.is_smooth ? (1.0f - place.material.metallic) * opaque_share(&place) : 1.0f;
    if (!unlit) radiance += place.base * (fabs(dot_f4(place.n, place.to_viewer)) * diffuse * place.alpha);
#endif
    radiance *= place.throughput;
  } else if (!is_first && item_prims[item] == NO_HIT) {
    radiance = item_throughput(&items, item) * (float4)(environment_r, environment_g, environment_b, 0.0f);
  }
  radiances[item] = radiance;
}

#if INDIRECT
// The share of light that a surface sends where it is masked or blends.
static inline float emitting_share(Surfaces surfaces, Material material, SurfacePoint at) {
#if ALPHA_MASK
  if (material.flags & MATERIAL_MASK) return base_color(surfaces, material, at).w < material.alpha_cutoff ? 0.0f : 1.0f;
#endif
#if ALPHA_BLEND
  if (material.flags & MATERIAL_BLEND) return min(max(base_color(surfaces, material, at).w, 0.0f), 1.0f);
#endif
  return 1.0f;
}

// Light from a point that is drawn on an emissive triangle. is_last: no ray goes on that could find it by chance.
// *end: the point, w 1.
static float4 light_of_emitter(const Place *place, const Mesh *mesh, Surfaces surfaces, uint prim_id, float2 u, float inverse_power, bool is_last, float4 *end) {
  global const uint *vertices = mesh->indices + 3 * (size_t)prim_id;
  const float root = sqrt(u.x), b0 = 1.0f - root, b1 = u.y * root;
  const SurfacePoint at = {prim_id, vertices[0], vertices[1], vertices[2], b0, b1, max((1.0f - b0) - b1, 0.0f)};
  const float4 point = (mesh->positions[at.i0] * at.b0 + mesh->positions[at.i1] * at.b1) + mesh->positions[at.i2] * at.b2;
  const float4 way = point - place->position, l = unit(way);
  *end = (float4)(point.xyz, 1.0f);
  if (!(dot_f4(place->g, l) > 0.0f)) return (float4)(0.0f);
  const Material material = surfaces.materials[surfaces.material_ids[prim_id]];
  const float density = density_of_emitter(mesh, material, at, l, dot_f4(way, way), inverse_power);
  if (!(density > 0.0f)) return (float4)(0.0f);
  const float found = is_last ? 1.0f : power_weight(density, density_of(place, l));
  const float share = found * emitting_share(surfaces, material, at) / density;
  return emitted_light(surfaces, material, at) * reflected(place->material, place->base, place->n, place->to_viewer, l, !place->is_smooth) * share;
}

// The light that u draws by its power: the last whose running sum begins at u or below.
static inline uint draw_light(global const float *sums, uint count, float u) {
  uint low = 0, high = count;
  while (high - low > 1) {
    const uint middle = (low + high) / 2;
    if (sums[middle] <= u) low = middle; else high = middle;
  }
  return low;
}
#endif

// Reads: items (shade_hits, arrive). Writes: slot_ends, slot_lamps, slot_kinds (for leave_for_light),
// slot_radiances (for add_light).
// Work item: one item. Local memory: 0 bytes.
kernel void aim_at_light(
    uint item_count,
    uint is_first,                                 // 1: hits of the camera's samples
    uint light,                                    // the light; unused in paths
    uint light_count,
    uint emitter_count,
    uint path,                                     // its number in the sample
    uint seed,                                     // of random numbers
    uint depth,                                    // generation
    uint is_last,                                  // 1: no ray goes on from these items
    float inverse_power,                           // of all lights that paths draw
    global const uint *restrict item_prims,        // [item_count], see ray_items.clh
    global const float4 *restrict item_weights,    // [item_count]
    global const float4 *restrict item_positions,  // [item_count]
    global const float4 *restrict item_directions, // [item_count]
    global const float4 *restrict item_throughputs,// [item_count]
#if FOOTPRINTS
    global const float4 *restrict item_footprints, // [3 * item_count]
#endif
    global const uint *restrict item_keys,         // [item_count] of random numbers
    global const float4 *restrict positions,       // [vertex_count] world space
    global const uint *restrict indices,           // [3 * triangle_count]
    global const float4 *restrict normals,         // [vertex_count] unit or 0
    global const float2 *restrict uv,              // [vertex_count]
    global const float2 *restrict uv1,             // [vertex_count]
    global const float4 *restrict colors,          // [vertex_count] linear
    global const uint *restrict material_ids,      // [triangle_count]
    global const Material *restrict materials,     // [material_count]
    global const Texture *restrict textures,       // [texture_count]
    global const uchar4 *restrict texels,          // of all textures
    global const float *restrict srgb_to_linear,   // [256]
    global const Light *restrict lights,           // [light_count]
    global const uint *restrict emitters,          // [emitter_count] prim_id of emissive triangles
    global const uint *restrict emitter_slots,     // [emitter_count] theirs in the hierarchy's leaves
    global const float *restrict power_sums,       // [light_count + emitter_count + 1] running shares of power
    global float4 *restrict slot_ends,             // [item_count] w 1: the point that light comes from; 0: its direction
    global uint *restrict slot_lamps,              // [item_count] slot of the emissive triangle that it is on, or NO_HIT
    global float4 *restrict slot_radiances,        // [item_count] RGB that arrives in the pixel, if nothing is in the way
    global uchar *restrict slot_kinds)             // [item_count] 1: a ray, 0: none
{
  const uint item = get_global_id(0);
  if (item >= item_count) return;
  const Items items = {item_prims, item_weights, item_positions, item_directions, item_throughputs, is_first
#if FOOTPRINTS
                       , item_footprints
#endif
  };
  const Mesh mesh = {positions, indices, normals};
  const Surfaces surfaces = {material_ids, materials, textures, texels, srgb_to_linear, uv, uv1, colors};
  Place place;
  slot_kinds[item] = 0;
  if (!load_place(&items, &mesh, surfaces, item, &place) || place.is_unlit) return;
  float share = 1.0f;
  float4 radiance = (float4)(0.0f), end = (float4)(0.0f);
  uint lamp = NO_HIT;
#if INDIRECT
  const uint dimension = depth * PAIRS_OF_HIT;
  const uint key = hash_pair(item_keys[item], seed);
  const float picked = draw_pair(key, path, dimension).x;
  light = draw_light(power_sums, light_count + emitter_count, picked);
  share = 1.0f / (power_sums[light + 1] - power_sums[light]);
  if (light >= light_count) {
    const uint emitter = light - light_count;
    radiance = light_of_emitter(&place, &mesh, surfaces, emitters[emitter], draw_pair(key, path, dimension + 1), inverse_power, is_last != 0, &end);
    share = 1.0f;
    lamp = emitter_slots[emitter];
  }
#endif
  if (light < light_count) {
    float4 to_light;
    const Light source = lights[light];
    const float4 arriving = incoming(source, place.position, &to_light);
    end = source.kind == LIGHT_DIRECTIONAL ? to_light : (float4)(source.position.xyz, 1.0f);
    if (dot_f4(place.g, to_light) > 0.0f)
      radiance = arriving * reflected(place.material, place.base, place.n, place.to_viewer, to_light, !place.is_smooth);
  }
  radiance *= place.throughput * (share * place.alpha * opaque_share(&place));
  const float4 way = end.w > 0.0f ? end - place.position : end;
  const float size = max(fabs(way.x), max(fabs(way.y), fabs(way.z)));
  if (!(largest_of(radiance) > 0.0f) || !(size >= LEAST_WAY) || !(size <= LARGEST_WAY)) return;
  slot_ends[item] = end;
  slot_lamps[item] = lamp;
  slot_radiances[item] = radiance;
  slot_kinds[item] = 1;
}

// Reads: sources (list_edge_pixels), occluded (trace_any, or 0 where light casts no shadow), slot_radiances. Writes:
// radiances of the items that the light reaches; a ray of each item at most. Work item: one ray. Local memory: 0 bytes.
kernel void add_light(
    uint ray_count,
    global const uint *restrict sources,           // [ray_count] item of each ray
    global const uint *restrict occluded,          // [ray_count] 1: something is in the way
    global const float4 *restrict slot_radiances,  // [item_count]
    global float4 *restrict radiances)             // [item_count]
{
  const uint ray = get_global_id(0);
  if (ray >= ray_count || occluded[ray]) return;
  radiances[sources[ray]] += slot_radiances[sources[ray]];
}
