// Rays that go on from hits: mirrored, refracted, straight through what blends, or in paths one that is drawn.
//
// Purcell et al., section 3: the shading kernel emits rays with the weight that their light has in the pixel, and
// streams of them go back to the traversal. For one generation:
//   scatter_rays: up to `slot_count` rays from each live item
//   list_samples.cl, leave_hits.cl, trace_rays.cl: those that are there, in order; where each begins; what it hits
//   arrive: the next generation's items; where textures are filtered with what a pixel covers of them
// Then add_to_samples sums what the items brought. The order of all sums is that of the items: no bit depends on
// threads.
// Good at: few bounces of all pixels at once. Bad at: memory (a ray of each pixel). Tests: tests/test_modes.py.

#define FOOTPRINTS DERIVATIVES
#include "surface_lanes.clh"
#include "lighting.clh"
#include "elementary.clh"
#include "sampling.clh"
#include "ray_items.clh"
#include "scattered_rays.clh"
#if FOOTPRINTS
#include "ray_differentials.clh"
#endif

typedef struct {
  global float4 *directions, *throughputs;
#if FOOTPRINTS
  global float4 *changes;
#endif
  global uchar *kinds;
} Slots;

// Stores the rays that are worth tracing at slot k of each item, and that there is none elsewhere.
INLINE void store_rays(const Items *items, const Mesh *mesh, const Slots *slots, const Places *at, uint slot_count, uint k, Scattered ray, float least_weight) {
  const int_v goes = worth_tracing(at, ray, least_weight);
  int kinds[VECTOR_WIDTH];
  STORE_V((goes ? ray.kind : (int_v)(0)), kinds);
  const uint lanes = min(at->count - at->first, (uint)VECTOR_WIDTH);
  for (uint lane = 0; lane < lanes; ++lane) slots->kinds[(size_t)(at->first + lane) * slot_count + k] = (uchar)kinds[lane];
  if (!has_lane(goes)) return;
  store_points(slots->directions, at->first, at->count, slot_count, k, ray.direction, (float_v)(INFINITY));
  store_points(slots->throughputs, at->first, at->count, slot_count, k, ray.throughput, ray.density);
#if FOOTPRINTS
  Vec3 covered[3];
  float_v last[3];
#pragma unroll
  for (uint part = 0; part < 3; ++part) {
    uint places[VECTOR_WIDTH];
    for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) places[lane] = 3 * at->item[lane] + part;
    covered[part] = gather_points(items->footprints, places, last + part);
  }
  spread_rays(at, mesh, covered[0], last[0], ray.kind, ray.direction, ray.density, covered + 1);
  for (uint part = 0; part < 2; ++part)
    store_points(slots->changes, at->first, at->count, 2 * slot_count, 2 * k + part, covered[1 + part], (float_v)(0.0f));
#endif
}

// Reads: items (shade_hits, arrive). Writes: slot_directions, slot_throughputs, slot_kinds, slot_changes (for leave_hits,
// arrive). Work item: VECTOR_WIDTH items. Local memory: 0 bytes.
kernel void scatter_rays(
    uint item_count,
    uint is_first,                                  // 1: hits of the camera's samples
    uint slot_count,                                // rays of an item at most
    uint path,                                      // its number in the sample
    uint seed,                                      // of random numbers
    uint depth,                                     // generation
    float least_weight,                             // of a ray that is worth tracing, outside of paths
    global const uint *restrict item_prims,         // [item_count], see ray_items.clh
    global const float4 *restrict item_weights,     // [item_count]
    global const float4 *restrict item_positions,   // [item_count]
    global const float4 *restrict item_directions,  // [item_count]
    global const float4 *restrict item_throughputs, // [item_count]
#if COLORS_VARY
    global const float4 *restrict item_colors,     // [item_count]
#endif
#if FOOTPRINTS
    global const float4 *restrict item_footprints,  // [3 * item_count]
#endif
    global const uint *restrict item_keys,          // [item_count] of random numbers
    global const float4 *restrict positions,        // [vertex_count] world space
    global const uint *restrict indices,            // [3 * triangle_count]
    global const float4 *restrict normals,          // [vertex_count] unit or 0
    global const float4 *restrict face_normals,     // [triangle_count] unit or 0
    global const float2 *restrict uv,               // [vertex_count]
    global const float2 *restrict uv1,              // [vertex_count]
    global const float4 *restrict colors,           // [vertex_count] linear
    global const uint *restrict material_ids,       // [triangle_count]
    global const Material *restrict materials,      // [material_count]
    global const Texture *restrict textures,        // [texture_count]
    global const uchar4 *restrict texels,           // of all textures
    global const float *restrict srgb_to_linear,    // [512] see Surfaces
    global float4 *restrict slot_directions,        // [slot_count * item_count] xyz; w t_max
    global float4 *restrict slot_throughputs,       // [slot_count * item_count] RGB; w density
#if FOOTPRINTS
    global float4 *restrict slot_changes,           // [2 * slot_count * item_count] of the direction, to the right, downwards
#endif
    global uchar *restrict slot_kinds)              // [slot_count * item_count] 0: no ray, else RAY_*
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
  const Slots slots = {slot_directions, slot_throughputs,
#if FOOTPRINTS
                       slot_changes,
#endif
                       slot_kinds};
  Places at;
  if (!load_places(&items, &mesh, surfaces, first, item_count, &at)) {
    const size_t end = (size_t)min(first + VECTOR_WIDTH, item_count) * slot_count;
    for (size_t slot = (size_t)first * slot_count; slot < end; ++slot) slot_kinds[slot] = 0;
    return;
  }
#if INDIRECT
  const uint_v keys = hash_pairs(load_words(item_keys, first, item_count), (uint_v)(seed));
  const uint dimension = depth * PAIRS_OF_HIT + 2;
  Scattered ray = draw_rays(&at, draw_pairs(keys, path, dimension).y, draw_pairs(keys, path, dimension + 1));
  if (depth >= ROULETTE_DEPTH) ray = play_roulette(ray, draw_pairs(keys, path, dimension + 2).x);
  store_rays(&items, &mesh, &slots, &at, slot_count, 0, ray, 0.0f);
#else
  Scattered rays[2];
  split_rays(&at, rays);
  for (uint k = 0; k < min(slot_count, 2u); ++k)
    store_rays(&items, &mesh, &slots, &at, slot_count, k, rays[k], least_weight);
#endif
}

// Reads: sources (list_edge_pixels), prims_hit, weights (trace_closest), origins, directions (leave_hits),
// slot_throughputs, slot_changes (scatter_rays). Writes: the items of the next generation. Work item: one ray.
// Local memory: 0 bytes.
kernel void arrive(
    uint ray_count,
    uint slot_count,
    uint is_first,                                  // 1: the rays left hits of the camera's samples
    global const uint *restrict sources,            // [ray_count] slot of each ray
    global const uint *restrict prims_hit,          // [ray_count] prim_id or NO_HIT
    global const float4 *restrict weights,          // [ray_count] barycentrics
    global const float4 *restrict directions,       // [ray_count] xyz
    global const float4 *restrict slot_throughputs, // [slot_count * item_count]
    global const uint *restrict pixels_left,        // [item_count] pixels of the items that the rays left
    global const uint *restrict keys_left,          // [item_count] their keys
#if FOOTPRINTS
    global const uint *restrict prims_left,         // [item_count] the triangles
    global const float4 *restrict footprints_left,  // [3 * item_count]
    global const float4 *restrict slot_changes,     // [2 * slot_count * item_count]
    global const float4 *restrict origins,          // [ray_count] where the rays began
    global float4 *restrict item_footprints,        // [3 * ray_count] see ray_items.clh
#endif
    global const float4 *restrict positions,        // [vertex_count] world space
    global const uint *restrict indices,            // [3 * triangle_count]
    global float4 *restrict item_positions,         // [ray_count] world space
    global float4 *restrict item_directions,        // [ray_count] xyz; w density
    global float4 *restrict item_throughputs,       // [ray_count] RGB
    global uint *restrict item_pixels,              // [ray_count] pixel of the band
    global uint *restrict item_keys)                // [ray_count]
{
  const uint ray = get_global_id(0);
  if (ray >= ray_count) return;
  const uint source = sources[ray], item = source / slot_count, prim_id = prims_hit[ray];
  const float4 throughput = slot_throughputs[source];
  float4 position = (float4)(0.0f);
#if FOOTPRINTS
  const float4 changes[2] = {slot_changes[2 * (size_t)source], slot_changes[2 * (size_t)source + 1]};
  float4 spread = (float4)(0.0f);
#endif
  if (prim_id != NO_HIT) {
    const float4 w = weights[ray];
    global const uint *vertices = indices + 3 * (size_t)prim_id;
    position = (positions[vertices[0]] * w.x + positions[vertices[1]] * w.y) + positions[vertices[2]] * w.z;
#if FOOTPRINTS
    const float4 d = (float4)(directions[ray].xyz, 0.0f);
    const float t = dot_f4(position - origins[ray], d);
    spread = carry_footprint(positions, indices + 3 * (size_t)prims_left[item], vertices, footprints_left[3 * (size_t)item], d, t, changes);
#endif
  }
  item_positions[ray] = position;
  item_directions[ray] = (float4)(directions[ray].xyz, throughput.w);
  item_throughputs[ray] = (float4)(throughput.xyz, 0.0f);
  item_pixels[ray] = is_first ? item : pixels_left[item];
  item_keys[ray] = keys_left[item];
#if FOOTPRINTS
  item_footprints[3 * (size_t)ray] = spread;
  item_footprints[3 * (size_t)ray + 1] = changes[0];
  item_footprints[3 * (size_t)ray + 2] = changes[1];
#endif
}

// Reads: radiances (begin_light, add_light). Writes: sums of pixels. Items of one pixel lie side by side: the first
// of them adds them all. Work item: one item. Local memory: 0 bytes.
kernel void add_to_samples(
    uint item_count,
    uint pixel_count,                           // of the band
    uint is_first,                              // 1: item k is that of pixel k
    global const uint *restrict item_pixels,    // [item_count] rising
    global const float4 *restrict radiances,    // [item_count] RGB
    global float *restrict sums)                // [3 * pixel_count] R, G, B
{
  const uint item = get_global_id(0);
  if (item >= item_count) return;
  const uint pixel = is_first ? item : item_pixels[item];
  if (!is_first && item > 0 && item_pixels[item - 1] == pixel) return;
  float4 sum = radiances[item];
  if (!is_first)
    for (uint other = item + 1; other < item_count && item_pixels[other] == pixel; ++other) sum += radiances[other];
  const size_t stride = pixel_count;
  sums[pixel] += sum.x;
  sums[stride + pixel] += sum.y;
  sums[2 * stride + pixel] += sum.z;
}

// Reads: sums (add_to_samples). Writes: color. Work item: one pixel. Local memory: 0 bytes.
kernel void add_mean(
    uint pixel_count,                           // of the band
    float path_count,                           // paths of a sample
    global const float *restrict sums,          // [3 * pixel_count] R, G, B
    uint first_plane,                           // of colour
    global float *restrict values)              // [planes * pixel_count] premultiplied, as shade_hits leaves them
{
  const uint pixel = get_global_id(0);
  if (pixel >= pixel_count) return;
  const size_t stride = pixel_count;
  for (uint k = 0; k < 3; ++k) values[(first_plane + k) * stride + pixel] += sums[k * stride + pixel] / path_count;
}
