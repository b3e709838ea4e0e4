// Light that reaches hits straight from lights: shadow rays, and what becomes of them.
//
// Purcell et al., section 3 and Fig. 3 (shadow caster, Whitted, path tracer). For each light in its order, or in paths for
// one light that is drawn:
//   aim_at_light: a ray from each live item towards the light, with the light that it would bring; of dead ones an empty ray
//   leave_hits.cl, trace_rays.cl: where each begins; which rays meet something on the way
//   add_light: the light of the others
// Good at: few lights. Bad at: many lights outside of paths (a pass each). Tests: tests/test_modes.py.

#define FOOTPRINTS DERIVATIVES
#include "surface_lanes.clh"
#include "lighting.clh"
#include "elementary.clh"
#include "sampling.clh"
#include "ray_items.clh"
#include "light_rays.clh"

// Reads: positions, indices. Writes: face_normals (for the kernels that load places). Work item: one triangle. Local
// memory: 0 bytes.
kernel void find_face_normals(
    uint triangle_count,
    global const float4 *restrict positions,       // [vertex_count] world space
    global const uint *restrict indices,           // [3 * triangle_count]
    global float4 *restrict face_normals)          // [triangle_count] unit, or 0 where it has no area
{
  const uint prim_id = get_global_id(0);
  if (prim_id >= triangle_count) return;
  global const uint *vertices = indices + 3 * (size_t)prim_id;
  const float4 p0 = positions[vertices[0]];
  const float4 e = positions[vertices[1]] - p0, f = positions[vertices[2]] - p0;
  const float4 cross_product = {e.y * f.z - e.z * f.y, e.z * f.x - e.x * f.z, e.x * f.y - e.y * f.x, 0.0f};
  face_normals[prim_id] = unit(cross_product);
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
#if COLORS_VARY
    global const float4 *restrict item_colors,     // [item_count]
#endif
#if FOOTPRINTS
    global const float4 *restrict item_footprints, // [3 * item_count]
#endif
    global const float4 *restrict item_origins,    // [item_count] where the ray that arrived began
    global const float4 *restrict positions,       // [vertex_count] world space
    global const uint *restrict indices,           // [3 * triangle_count]
    global const float4 *restrict normals,         // [vertex_count] unit or 0
    global const float4 *restrict face_normals,    // [triangle_count] unit or 0
    global const float2 *restrict uv,              // [vertex_count]
    global const float2 *restrict uv1,             // [vertex_count]
    global const float4 *restrict colors,          // [vertex_count] linear
    global const uint *restrict material_ids,      // [triangle_count]
    global const Material *restrict materials,     // [material_count]
    global const Texture *restrict textures,       // [texture_count]
    global const uchar4 *restrict texels,          // of all textures
    global const float *restrict srgb_to_linear,   // [512] see Surfaces
    global float4 *restrict radiances)             // [item_count] RGB, weighted for the pixel
{
  const uint first = get_global_id(0) * VECTOR_WIDTH;
  if (first >= item_count) return;
  const Items items = {item_prims, item_weights, item_positions, item_directions, item_throughputs, is_first
#if COLORS_VARY
                       , item_colors
#endif
#if FOOTPRINTS
                       , item_footprints
#endif
  };
  const Mesh mesh = {positions, indices, normals, face_normals};
  const Surfaces surfaces = {material_ids, materials, textures, texels, srgb_to_linear, uv, uv1, colors};
  const uint lanes = min(item_count - first, (uint)VECTOR_WIDTH);
  float4 found[VECTOR_WIDTH];
  for (uint lane = 0; lane < lanes; ++lane) {
    const bool lost = !is_first && items.prims[first + lane] == NO_HIT;
    found[lane] = (float4)(0.0f);
    if (lost) found[lane] = item_throughput(&items, first + lane) * (float4)(environment_r, environment_g, environment_b, 0.0f);
  }
  Places at;
  if (has_lane(find_live(&items, first, item_count, &at)) && shines(&items, surfaces, &at) && load_places(&items, &mesh, surfaces, first, item_count, &at)) {
    float4 brought[VECTOR_WIDTH];
    list_points(own_light(&items, &mesh, surfaces, &at, item_origins, inverse_power), (float_v)(0.0f), brought);
    for (ulong mask = LANE_MASK(at.is_live); mask != 0; mask &= mask - 1) found[first_lane(mask)] = brought[first_lane(mask)];
  }
  for (uint lane = 0; lane < lanes; ++lane) radiances[first + lane] = found[lane];
}

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
#if COLORS_VARY
    global const float4 *restrict item_colors,     // [item_count]
#endif
#if FOOTPRINTS
    global const float4 *restrict item_footprints, // [3 * item_count]
#endif
    global const uint *restrict item_keys,         // [item_count] of random numbers
    global const float4 *restrict positions,       // [vertex_count] world space
    global const uint *restrict indices,           // [3 * triangle_count]
    global const float4 *restrict normals,         // [vertex_count] unit or 0
    global const float4 *restrict face_normals,    // [triangle_count] unit or 0
    global const float2 *restrict uv,              // [vertex_count]
    global const float2 *restrict uv1,             // [vertex_count]
    global const float4 *restrict colors,          // [vertex_count] linear
    global const uint *restrict material_ids,      // [triangle_count]
    global const Material *restrict materials,     // [material_count]
    global const Texture *restrict textures,       // [texture_count]
    global const uchar4 *restrict texels,          // of all textures
    global const float *restrict srgb_to_linear,   // [512] see Surfaces
    global const Light *restrict lights,           // [light_count]
    global const uint *restrict emitters,          // [emitter_count] prim_id of emissive triangles
    global const uint *restrict emitter_slots,     // [emitter_count] theirs in the hierarchy's leaves
    global const float *restrict power_sums,       // [light_count + emitter_count + 1] running shares of power
    global float4 *restrict slot_ends,             // [item_count] w 1: the point that light comes from; 0: its direction
    global uint *restrict slot_lamps,              // [item_count] slot of the emissive triangle that it is on, or NO_HIT
    global float4 *restrict slot_radiances,        // [item_count] RGB that arrives in the pixel, if nothing is in the way
    global uchar *restrict slot_kinds)             // [item_count] 1: a ray, 0: none
{
  const uint first = get_global_id(0) * VECTOR_WIDTH;
  if (first >= item_count) return;
  const Items items = {item_prims, item_weights, item_positions, item_directions, item_throughputs, is_first
#if COLORS_VARY
                       , item_colors
#endif
#if FOOTPRINTS
                       , item_footprints
#endif
  };
  const Mesh mesh = {positions, indices, normals, face_normals};
  const Surfaces surfaces = {material_ids, materials, textures, texels, srgb_to_linear, uv, uv1, colors};
  const uint lanes = min(item_count - first, (uint)VECTOR_WIDTH);
  Places at;
  if (!load_places(&items, &mesh, surfaces, first, item_count, &at)) {
    for (uint lane = 0; lane < lanes; ++lane) {
      slot_kinds[first + lane] = 0;
      slot_lamps[first + lane] = NO_HIT;
      slot_ends[first + lane] = (float4)(0.0f);
    }
    return;
  }
  const Lights all = {lights, emitters, emitter_slots, power_sums, light_count, emitter_count, inverse_power};
#if INDIRECT
  const uint_v keys = hash_pairs(load_words(item_keys, first, item_count), (uint_v)(seed));
#else
  const uint_v keys = (uint_v)(0);
#endif
  const Aim aim = aim_at_lights(&at, &mesh, surfaces, &all, light, keys, path, depth, is_last != 0);
  store_points(slot_ends, first, item_count, 1, 0, aim.end, aim.to_point);
  store_points(slot_radiances, first, item_count, 1, 0, aim.radiance, (float_v)(0.0f));
  store_words(slot_lamps, first, item_count, aim.lamp_slot);
  int kinds[VECTOR_WIDTH];
  STORE_V(aim.goes, kinds);
  for (uint lane = 0; lane < lanes; ++lane) slot_kinds[first + lane] = kinds[lane] != 0;
}

// Reads: occluded (trace_any, or 0 where light casts no shadow), slot_kinds, slot_radiances. Writes: radiances of the items
// that the light reaches. Work item: one item. Local memory: 0 bytes.
kernel void add_light(
    uint item_count,
    global const uint *restrict occluded,          // [item_count] 1: something is in the way
    global const uchar *restrict slot_kinds,       // [item_count] 1: a ray, 0: none
    global const float4 *restrict slot_radiances,  // [item_count]
    global float4 *restrict radiances)             // [item_count]
{
  const uint item = get_global_id(0);
  if (item >= item_count || !slot_kinds[item] || occluded[item]) return;
  radiances[item] += slot_radiances[item];
}
