// Paths: what a generation of hits brings, and the rays that go on from it, in one kernel between two traces.
//
// Purcell et al., section 3: kernels joined by streams. As light_hits.cl and scatter_rays.cl, whose functions these are and
// whose bits it gives, but a hit's surface is looked up once, and both of its rays begin where it is left once. For one
// generation:
//   shade_paths: light of their own; a ray to a light; a ray that goes on
//   trace_any (trace_rays.cl), add_paths: what comes of the first goes into the sums
//   gather_rays: the rays that go on, side by side
//   trace_closest (trace_rays.cl): what they hit: the next generation
// A pixel has one item at most, so no two items add to the same sum.
// Good at: textures that are not filtered. Bad at: footprints, which it does not carry: light_hits.cl does.
// Tests: tests/test_modes_path.py, tests/test_modes_bits.py.

#include "vector.clh"
#include "edge_function.clh"
#include "settled_tests.clh"
#include "intersect_triangle.clh"
#include "surface_lanes.clh"
#include "lighting.clh"
#include "elementary.clh"
#include "sampling.clh"
#include "leave_triangle.clh"
#include "ray_items.clh"
#include "scattered_rays.clh"
#include "light_rays.clh"

// Light of dead items, whose rays left the scene.
INLINE void store_lost(const Items *items, uint first, uint lanes, float4 environment, global float4 *radiances, uchar *kinds) {
  for (uint lane = 0; lane < lanes; ++lane) {
    kinds[lane] = 0;
    if (items->is_first || items->prims[first + lane] != NO_HIT || !(largest_of(environment) > 0.0f)) continue;
    radiances[first + lane] = item_throughput(items, first + lane) * environment;
    kinds[lane] = HAS_OWN_LIGHT;
  }
}

// Reads: items (shade_hits; gather_rays, trace_closest). Writes: radiances, slot_radiances, slot_kinds (for add_paths),
// light_origins, light_directions, slot_ends, slot_lamps, light_keys (for trace_any), slot_origins, slot_directions,
// slot_throughputs, next_kinds (for gather_rays). Work item: VECTOR_WIDTH items. Local memory: 0 bytes.
kernel void shade_paths(
    uint item_count,
    uint is_first,                                 // 1: hits of the camera's samples
    uint light_count,
    uint emitter_count,
    uint path,                                     // its number in the sample
    uint seed,                                     // of random numbers
    uint depth,                                    // generation
    uint is_last,                                  // 1: no ray goes on from these items
    float inverse_power,                           // of all lights that paths draw
    float environment_r,                           // radiance that comes from where nothing is
    float environment_g,
    float environment_b,
    global const uint *restrict item_prims,        // [item_count], see ray_items.clh
    global const float4 *restrict item_weights,    // [item_count]
    global const float4 *restrict item_positions,  // [item_count] of the camera's samples, else unused
    global const float4 *restrict item_directions, // [item_count]
    global const float4 *restrict item_throughputs,// [item_count] w density
#if COLORS_VARY
    global const float4 *restrict item_colors,     // [item_count] of the camera's samples, else unused
#endif
    global const float4 *restrict item_origins,    // [item_count] where the ray that arrived began
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
    global float4 *restrict radiances,             // [item_count] RGB of their own light, where slot_kinds says so
    global float4 *restrict slot_radiances,        // [item_count] RGB that arrives if nothing is in the way
    global uchar *restrict slot_kinds,             // [item_count] HAS_LIGHT_RAY | HAS_OWN_LIGHT
    global float4 *restrict light_origins,         // [item_count] xyz; w t_min 0
    global float4 *restrict light_directions,      // [item_count] xyz; w t_max, 0 where there is no ray
    global float4 *restrict slot_ends,             // [item_count] w 1: the point that light comes from; 0: its direction
    global uint *restrict slot_lamps,              // [item_count] slot of the emissive triangle that it is on, or NO_HIT
    global uint *restrict excluded,                // [item_count] prim_id that is left
#if ALPHA_BLEND
    global uint *restrict light_keys,              // [item_count] of random numbers
#endif
    global float4 *restrict slot_origins,          // [item_count] xyz; w t_min 0
    global float4 *restrict slot_directions,       // [item_count] xyz; w t_max
    global float4 *restrict slot_throughputs,      // [item_count] RGB; w density
    global uchar *restrict next_kinds)             // [item_count] 0: no ray goes on, else RAY_*
{
  const uint first = get_global_id(0) * VECTOR_WIDTH;
  if (first >= item_count) return;
  const Items items = {item_prims, item_weights, item_positions, item_directions, item_throughputs, is_first
#if COLORS_VARY
                       , item_colors
#endif
  };
  const Mesh mesh = {positions, indices, normals, face_normals};
  const Surfaces surfaces = {material_ids, materials, textures, texels, srgb_to_linear, uv, uv1, colors};
  const Lights all = {lights, emitters, emitter_slots, power_sums, light_count, emitter_count, inverse_power};
  const uint lanes = min(item_count - first, (uint)VECTOR_WIDTH);
  const Vec3 none = fill3((float_v)(0.0f));
  uchar kinds[VECTOR_WIDTH];
  store_lost(&items, first, lanes, (float4)(environment_r, environment_g, environment_b, 0.0f), radiances, kinds);

  // What is left.
  Places at;
  const int_v is_live = find_live(&items, first, item_count, &at);
  if (!has_lane(is_live)) {
    for (uint lane = 0; lane < lanes; ++lane) {
      slot_kinds[first + lane] = kinds[lane];
      next_kinds[first + lane] = 0;
      light_directions[first + lane] = (float4)(0.0f);
      slot_lamps[first + lane] = NO_HIT;
    }
    return;
  }
  const LeftTriangles t = triangles_to_leave(
      gather_vertices(positions, &mesh, &at, 0), gather_vertices(positions, &mesh, &at, 1), gather_vertices(positions, &mesh, &at, 2));
  LeftPoints points = points_of_weights(&t, at.weights);
  if (is_first) {
    float_v doubt;
    const Vec3 position = load_points(item_positions, first, item_count, &doubt);
    points = points_of_positions(position, doubt);
  }
  at.position = points.at;
  load_surfaces(&items, &mesh, surfaces, &at);
  if (!is_first) load_points(item_throughputs, first, item_count, &at.drawn_density);
  points = keep_from_edges(&t, points, at.weights);

  // Light.
  const uint_v keys = hash_pairs(load_words(item_keys, first, item_count), (uint_v)(seed));
  if (shines(&items, surfaces, &at)) {
    const Vec3 own = own_light(&items, &mesh, surfaces, &at, item_origins, inverse_power);
    float4 brought[VECTOR_WIDTH];
    list_points(own, (float_v)(0.0f), brought);
    for (ulong mask = LANE_MASK(is_live & (largest3(own) > 0.0f)); mask != 0; mask &= mask - 1) {
      kinds[first_lane(mask)] = HAS_OWN_LIGHT;
      radiances[first + first_lane(mask)] = brought[first_lane(mask)];
    }
  }
  Aim aim = {none, none, (float_v)(0.0f), (uint_v)(NO_HIT), LANES < 0};
  if (light_count + emitter_count != 0) aim = aim_at_lights(&at, &mesh, surfaces, &all, 0, keys, path, depth, is_last != 0);
  // Where no light is asked for the side of the viewer is found: most rays go on there.
  const Vec3 way = way_to(at.position, aim.end, aim.to_point);
  const Starts starts = leave_kept(&t, points, select3(aim.goes, way, at.to_viewer), is_live);
  float_v t_max;
  const Vec3 to_end = aim_again(starts, aim.end, aim.to_point, &t_max);
  store_points(light_origins, first, item_count, 1, 0, starts.at, (float_v)(0.0f));
  store_points(light_directions, first, item_count, 1, 0, to_end, t_max);
  store_points(slot_ends, first, item_count, 1, 0, aim.end, aim.to_point);
  store_points(slot_radiances, first, item_count, 1, 0, aim.radiance, (float_v)(0.0f));
  store_words(slot_lamps, first, item_count, aim.lamp_slot);
#if ALPHA_BLEND
  store_words(light_keys, first, item_count, keys_of_rays(load_words(item_keys, first, item_count), seed, depth, true));
#endif
  store_words(excluded, first, item_count, LOAD_V(at.prim));
  int goes[VECTOR_WIDTH];
  STORE_V(aim.goes, goes);
  for (uint lane = 0; lane < lanes; ++lane) {
    slot_kinds[first + lane] = kinds[lane] | (goes[lane] ? HAS_LIGHT_RAY : 0u);
    next_kinds[first + lane] = 0;
  }
  if (is_last) return;

  // What goes on.
  const uint dimension = depth * PAIRS_OF_HIT + 2;
  Scattered ray = draw_rays(&at, draw_pairs(keys, path, dimension).y, draw_pairs(keys, path, dimension + 1));
  if (depth >= ROULETTE_DEPTH) ray = play_roulette(ray, draw_pairs(keys, path, dimension + 2).x);
  const int_v goes_on = worth_tracing(&at, ray, 0.0f);
  const Starts again = leave_again(&t, points, ray.direction, goes_on, starts);
  store_points(slot_origins, first, item_count, 1, 0, again.at, (float_v)(0.0f));
  store_points(slot_directions, first, item_count, 1, 0, ray.direction, again.begins > 0.0f ? (float_v)(INFINITY) : (float_v)(0.0f));
  store_points(slot_throughputs, first, item_count, 1, 0, ray.throughput, ray.density);
  STORE_V((goes_on ? ray.kind : (int_v)(0)), goes);
  for (uint lane = 0; lane < lanes; ++lane) next_kinds[first + lane] = (uchar)goes[lane];
}

// Reads: radiances, slot_radiances, slot_kinds (shade_paths), occluded (trace_any, or 0 where light casts no shadow).
// Writes: sums. Work item: VECTOR_WIDTH items. Local memory: 0 bytes.
kernel void add_paths(
    uint item_count,
    uint pixel_count,                              // of the band
    uint is_first,                                 // 1: item k is that of pixel k
    global const uint *restrict item_pixels,       // [item_count] rising
    global const float4 *restrict radiances,       // [item_count] RGB
    global const float4 *restrict slot_radiances,  // [item_count] RGB
    global const uchar *restrict slot_kinds,       // [item_count] HAS_LIGHT_RAY | HAS_OWN_LIGHT
    global const uint *restrict occluded,          // [item_count] 1: something is in the way
    global float *restrict sums)                   // [3 * pixel_count] R, G, B
{
  const uint first = get_global_id(0) * VECTOR_WIDTH;
  if (first >= item_count) return;
  // No branch for each of them: whether light arrives is not to be guessed.
  const uint lanes = min(item_count - first, (uint)VECTOR_WIDTH);
  const Vec3 none = fill3((float_v)(0.0f));
  uint listed[VECTOR_WIDTH] = {0};
  for (uint lane = 0; lane < lanes; ++lane) listed[lane] = slot_kinds[first + lane];
  const uint_v kinds = LOAD_V(listed), zero = (uint_v)(0);
  const int_v has_own = (kinds & HAS_OWN_LIGHT) != zero;
  const int_v is_lit = ((kinds & HAS_LIGHT_RAY) != zero) & (load_words(occluded, first, item_count) == zero);
  if (!has_lane(has_own | is_lit)) return;
  float_v unused;
  Vec3 sum = none;
  if (has_lane(has_own)) sum = select3(has_own, load_points(radiances, first, item_count, &unused), none);
  sum = add(sum, select3(is_lit, load_points(slot_radiances, first, item_count, &unused), none));
  float x[VECTOR_WIDTH], y[VECTOR_WIDTH], z[VECTOR_WIDTH];
  STORE_V(sum.x, x);
  STORE_V(sum.y, y);
  STORE_V(sum.z, z);
  const size_t stride = pixel_count;
  for (uint lane = 0; lane < lanes; ++lane) {
    const size_t pixel = is_first ? first + lane : item_pixels[first + lane];
    sums[pixel] += x[lane];
    sums[stride + pixel] += y[lane];
    sums[2 * stride + pixel] += z[lane];
  }
}

// Reads: next_kinds, slot_origins, slot_directions, slot_throughputs (shade_paths), begins (scan_counts). Writes: rays for
// trace_closest, and what items keep of them. Work item: LIST_CHUNK items. Local memory: 0 bytes.
kernel void gather_rays(
    uint item_count,
    uint is_first,                                 // 1: item k is that of pixel k
    uint seed,                                     // of random numbers
    uint depth,                                    // generation
    global const uchar *restrict next_kinds,       // [item_count] 0: no ray goes on
    global const uint *restrict begins,            // [chunks + 1]
    global const float4 *restrict slot_origins,    // [item_count]
    global const float4 *restrict slot_directions, // [item_count]
    global const float4 *restrict slot_throughputs,// [item_count]
    global const uint *restrict excluded_left,     // [item_count] prim_id that is left
    global const uint *restrict pixels_left,       // [item_count] pixel of the band
    global const uint *restrict keys_left,         // [item_count] of random numbers
    global float4 *restrict origins,               // [ray_count] xyz; w t_min 0
    global float4 *restrict directions,            // [ray_count] xyz; w t_max
    global float4 *restrict item_throughputs,      // [ray_count] RGB; w density
    global uint *restrict excluded,                // [ray_count] prim_id that is left
#if ALPHA_BLEND
    global uint *restrict ray_keys,                // [ray_count] of random numbers
#endif
    global uint *restrict item_pixels,             // [ray_count] rising
    global uint *restrict item_keys)               // [ray_count]
{
  const uint begin = get_global_id(0) * LIST_CHUNK;
  if (begin >= item_count) return;
  uint ray = begins[begin / LIST_CHUNK];
  // Which items they are first: copies then take no branch that is not to be guessed.
  uint items[LIST_CHUNK], count = 0;
  for (uint item = begin; item < min(begin + LIST_CHUNK, item_count); ++item) {
    items[count] = item;
    count += next_kinds[item] != 0;
  }
  for (uint k = 0; k < count; ++k, ++ray) {
    const uint item = items[k];
    origins[ray] = slot_origins[item];
    directions[ray] = slot_directions[item];
    item_throughputs[ray] = slot_throughputs[item];
    excluded[ray] = excluded_left[item];
#if ALPHA_BLEND
    ray_keys[ray] = FIRST_LANE(keys_of_rays((uint_v)(keys_left[item]), seed, depth, false));
#endif
    item_pixels[ray] = is_first ? item : pixels_left[item];
    item_keys[ray] = keys_left[item];
  }
}
