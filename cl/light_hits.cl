// Light that reaches hits straight from lights: shadow rays, and what becomes of them.
//
// Purcell et al., section 3 and Fig. 3 (shadow caster, Whitted, path tracer). For each light in its order, or in paths for
// one light that is drawn:
//   aim_at_light: a ray from each live item towards the light, with the light that it would bring; of dead ones an empty ray
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

INLINE float_v power_weight(float_v a, float_v b) {
  const float_v larger = max(a, b), x = a / larger, y = b / larger;
  return larger > 0.0f ? x * x / (x * x + y * y) : (float_v)(0.0f);
}

// Density over directions of drawing points of emissive triangles that are seen along l at a distance.
INLINE float_v density_of_emitters(Vec3 face_normal, Vec3 emissive, Vec3 l, float_v distance2, float inverse_power) {
  const float_v cosine = fabs(dot3(face_normal, l));
  const float_v strength = ((emissive.x + emissive.y) + emissive.z) * inverse_power;
  return cosine > 0.0f ? strength * distance2 / cosine : (float_v)(0.0f);  // the triangle's area cancels
}

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

INLINE Vec3 emissive_of(Surfaces surfaces, const Places *at) {
  float x[VECTOR_WIDTH], y[VECTOR_WIDTH], z[VECTOR_WIDTH];
#pragma unroll
  for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) {
    const float4 own = surfaces.materials[surfaces.material_ids[at->prim[lane]]].emissive;
    x[lane] = own.x;
    y[lane] = own.y;
    z[lane] = own.z;
  }
  const Vec3 emissive = {LOAD_V(x), LOAD_V(y), LOAD_V(z)};
  return emissive;
}

// Radiance that the lanes' surfaces emit, in those of the mask.
INLINE Vec3 emitted_by(const Items *items, const Mesh *mesh, Surfaces surfaces, const Places *at, int_v wanted) {
  float x[VECTOR_WIDTH] = {0}, y[VECTOR_WIDTH] = {0}, z[VECTOR_WIDTH] = {0};
  for (ulong mask = LANE_MASK(wanted); mask != 0; mask &= mask - 1) {
    const uint lane = first_lane(mask);
    const Material material = surfaces.materials[surfaces.material_ids[at->prim[lane]]];
    const float4 emitted = emitted_light(surfaces, material, point_of_lane(items, mesh, at, lane));
    x[lane] = emitted.x;
    y[lane] = emitted.y;
    z[lane] = emitted.z;
  }
  const Vec3 emitted = {LOAD_V(x), LOAD_V(y), LOAD_V(z)};
  return emitted;
}

// Whether a live item may have light of its own: an emissive or unlit surface, or any where there are no lights.
INLINE bool find_shining(const Items *items, Surfaces surfaces, uint first, uint count, Places *at) {
  if (!has_lane(find_live(items, first, count, at))) return false;
#if LIT || INDIRECT
  if (items->is_first) return false;
  bool shines = false;
  for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) {
    global const Material *own = surfaces.materials + surfaces.material_ids[at->prim[lane]];
    shines = shines || (own->flags & MATERIAL_UNLIT) != 0 || largest_of(own->emissive) > 0.0f;
  }
  return shines;
#else
  return true;
#endif
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
    global const float4 *restrict face_normals,    // [triangle_count] unit or 0
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
  const uint first = get_global_id(0) * VECTOR_WIDTH;
  if (first >= item_count) return;
  const Items items = {item_prims, item_weights, item_positions, item_directions, item_throughputs, is_first
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
  if (find_shining(&items, surfaces, first, item_count, &at) && load_places(&items, &mesh, surfaces, first, item_count, &at)) {
    const Vec3 base = at.finish.base, none = fill3((float_v)(0.0f));
    Vec3 radiance = none;
    const int_v is_arrived = is_first ? (LANES < 0) : (LANES >= 0);
    radiance = select3(is_arrived & at.is_unlit, scale3(base, at.alpha), radiance);
#if EMISSION
    const Vec3 emitted = emitted_by(&items, &mesh, surfaces, &at, at.is_live & is_arrived & (at.is_unlit == 0));
    float_v share = at.alpha;
#if INDIRECT
    float_v unused;
    const Vec3 way = subtract(at.position, gather_points(item_origins, at.item, &unused));
    const Vec3 face_normal = gather_points(face_normals, at.prim, &unused);
    const float_v density = density_of_emitters(face_normal, emissive_of(surfaces, &at), at.direction, dot3(way, way), inverse_power);
    share *= at.drawn_density > 0.0f ? power_weight(at.drawn_density, density) : (float_v)(1.0f);
#endif
    radiance = select3(is_arrived & (at.is_unlit == 0), scale3(emitted, share), radiance);
#endif
#if !LIT && !INDIRECT
    const float_v diffuse = at.is_smooth ? (1.0f - at.finish.metallic) * opaque_share(&at) : (float_v)(1.0f);
    const Vec3 head = scale3(base, fabs(dot3(at.n, at.to_viewer)) * diffuse * at.alpha);
    radiance = select3(at.is_unlit, radiance, add(radiance, head));
#endif
    float4 brought[VECTOR_WIDTH];
    list_points(multiply3(radiance, at.throughput), (float_v)(0.0f), brought);
    for (ulong mask = LANE_MASK(at.is_live); mask != 0; mask &= mask - 1) found[first_lane(mask)] = brought[first_lane(mask)];
  }
  for (uint lane = 0; lane < lanes; ++lane) radiances[first + lane] = found[lane];
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

// Radiance that points of emissive triangles send, in the lanes of the mask; *share: as emitting_share.
INLINE Vec3 emitted_at(Surfaces surfaces, const Mesh *mesh, const Places *lamp, Vec3 weights, int_v wanted, Vec3 emissive, float_v *share) {
#if TEXTURES || ALPHA_MASK || ALPHA_BLEND
  float4 listed[VECTOR_WIDTH];
  list_points(weights, (float_v)(0.0f), listed);
  float x[VECTOR_WIDTH] = {0}, y[VECTOR_WIDTH] = {0}, z[VECTOR_WIDTH] = {0}, shares[VECTOR_WIDTH] = {0};
  for (ulong mask = LANE_MASK(wanted); mask != 0; mask &= mask - 1) {
    const uint lane = first_lane(mask), prim_id = lamp->prim[lane];
    global const uint *v = mesh->indices + 3 * (size_t)prim_id;
    const SurfacePoint point = {prim_id, v[0], v[1], v[2], listed[lane].x, listed[lane].y, listed[lane].z};
    const Material material = surfaces.materials[surfaces.material_ids[prim_id]];
    const float4 emitted = emitted_light(surfaces, material, point);
    shares[lane] = emitting_share(surfaces, material, point);
    x[lane] = emitted.x;
    y[lane] = emitted.y;
    z[lane] = emitted.z;
  }
  const Vec3 all = {LOAD_V(x), LOAD_V(y), LOAD_V(z)};
  *share = LOAD_V(shares);
  return all;
#else
  *share = (float_v)(1.0f);
  return emissive;
#endif
}

// Light from points that are drawn on emissive triangles. is_last: no ray goes on that could find them by chance.
// *end: the points.
INLINE Vec3 light_of_emitters(const Places *at, const Mesh *mesh, Surfaces surfaces, Places *lamp, int_v wanted, Numbers u, float inverse_power, bool is_last, Vec3 *end) {
  const float_v root = sqrt(u.x), b0 = 1.0f - root, b1 = u.y * root;
  const Vec3 weights = {b0, b1, max((1.0f - b0) - b1, 0.0f)};
  *end = weigh3(gather_vertices(mesh->positions, mesh, lamp, 0), gather_vertices(mesh->positions, mesh, lamp, 1),
                gather_vertices(mesh->positions, mesh, lamp, 2), weights);
  const Vec3 way = subtract(*end, at->position), l = unit3(way);
  float_v unused;
  const Vec3 emissive = emissive_of(surfaces, lamp), face_normal = gather_points(mesh->face_normals, lamp->prim, &unused);
  const float_v density = density_of_emitters(face_normal, emissive, l, dot3(way, way), inverse_power);
  const float_v found = is_last ? (float_v)(1.0f) : power_weight(density, density_of(at, l));
  const int_v is_seen = wanted & (dot3(at->g, l) > 0.0f) & (density > 0.0f);
  float_v emitting = (float_v)(1.0f);
  const Vec3 emitted = emitted_at(surfaces, mesh, lamp, weights, is_seen, emissive, &emitting);
  const Vec3 sent = reflected_by(at->finish, at->n, at->to_viewer, l, at->is_smooth == 0);
  return select3(is_seen, scale3(multiply3(emitted, sent), found * emitting / density), fill3((float_v)(0.0f)));
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

// What light would bring to the lanes' items, and where it comes from: a point, or where to_point is 0 a direction.
typedef struct { Vec3 radiance, end; float_v to_point; } Aim;

#if LIT
// Light of the punctual lights that lanes ask; other lanes stay as they are.
INLINE void aim_at_punctual(const Places *at, global const Light *lights, uint light_count, const uint *asked, Aim *aim) {
  float4 places[VECTOR_WIDTH], brought[VECTOR_WIDTH], ways[VECTOR_WIDTH], ends[VECTOR_WIDTH];
  list_points(at->position, (float_v)(0.0f), places);
  for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) {
    brought[lane] = ways[lane] = ends[lane] = (float4)(0.0f);
    if (asked[lane] >= light_count) continue;
    const Light source = lights[asked[lane]];
    brought[lane] = incoming(source, places[lane], ways + lane);
    ends[lane] = source.kind == LIGHT_DIRECTIONAL ? ways[lane] : (float4)(source.position.xyz, 1.0f);
  }
  float_v unused, to_point;
  const Vec3 to_light = join_points(ways, &unused), arriving = join_points(brought, &unused), end = join_points(ends, &to_point);
  const int_v is_punctual = LOAD_V(asked) < light_count, is_seen = dot3(at->g, to_light) > 0.0f;
  const Vec3 sent = multiply3(arriving, reflected_by(at->finish, at->n, at->to_viewer, to_light, at->is_smooth == 0));
  aim->radiance = select3(is_punctual, select3(is_seen, sent, fill3((float_v)(0.0f))), aim->radiance);
  aim->end = select3(is_punctual, end, aim->end);
  aim->to_point = is_punctual ? to_point : aim->to_point;
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
    global const float4 *restrict face_normals,    // [triangle_count] unit or 0
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
  const uint first = get_global_id(0) * VECTOR_WIDTH;
  if (first >= item_count) return;
  const Items items = {item_prims, item_weights, item_positions, item_directions, item_throughputs, is_first
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
  uint drawn[VECTOR_WIDTH], lamp_slots[VECTOR_WIDTH];
  for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) {
    drawn[lane] = light;
    lamp_slots[lane] = NO_HIT;
  }
  float_v share = (float_v)(1.0f);
  Aim aim = {fill3((float_v)(0.0f)), fill3((float_v)(0.0f)), (float_v)(0.0f)};
#if INDIRECT
  const uint_v keys = hash_pairs(gather_words(item_keys, at.item), (uint_v)(seed));
  const uint dimension = depth * PAIRS_OF_HIT;
  float picked[VECTOR_WIDTH], shares[VECTOR_WIDTH];
  Places lamp;
  STORE_V(draw_pairs(keys, path, dimension).x, picked);
  for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) {
    const uint one = draw_light(power_sums, light_count + emitter_count, picked[lane]);
    const bool is_emitter = one >= light_count;
    drawn[lane] = one;
    shares[lane] = is_emitter ? 1.0f : 1.0f / (power_sums[one + 1] - power_sums[one]);
    lamp.prim[lane] = is_emitter ? emitters[one - light_count] : 0;
    lamp_slots[lane] = is_emitter ? emitter_slots[one - light_count] : NO_HIT;
  }
  share = LOAD_V(shares);
  const int_v is_emitter = LOAD_V(drawn) >= light_count;
  if (has_lane(is_emitter)) {
    aim.radiance = light_of_emitters(&at, &mesh, surfaces, &lamp, is_emitter, draw_pairs(keys, path, dimension + 1), inverse_power, is_last != 0, &aim.end);
    aim.to_point = (float_v)(1.0f);
  }
#endif
#if LIT
  aim_at_punctual(&at, lights, light_count, drawn, &aim);
#endif
  aim.radiance = multiply3(aim.radiance, scale3(at.throughput, share * at.alpha * opaque_share(&at)));
  const Vec3 way = select3(aim.to_point > 0.0f, subtract(aim.end, at.position), aim.end);
  const float_v size = largest3(sizes3(way));
  const int_v goes = at.is_live & (at.is_unlit == 0) & (largest3(aim.radiance) > 0.0f) & (size >= LEAST_WAY) & (size <= LARGEST_WAY);
  store_points(slot_ends, first, item_count, 1, 0, select3(goes, aim.end, fill3((float_v)(0.0f))), goes ? aim.to_point : (float_v)(0.0f));
  store_points(slot_radiances, first, item_count, 1, 0, aim.radiance, (float_v)(0.0f));
  store_words(slot_lamps, first, item_count, goes ? LOAD_V(lamp_slots) : (uint_v)(NO_HIT));
  int kinds[VECTOR_WIDTH];
  STORE_V(goes, kinds);
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
