// Rays that go on from hits: mirrored, refracted, straight through what blends, or in paths one that is drawn.
//
// Purcell et al., section 3: the shading kernel emits rays with the weight that their light has in the pixel, and
// streams of them go back to the traversal. For one generation:
//   scatter_rays: up to `slot_count` rays from each live item
//   list_samples.cl, leave_hits.cl, trace_rays.cl: those that are there, in order; where each begins; what it hits
//   arrive: the next generation's items; where textures are filtered with what a pixel covers of them
// Then add_to_samples sums what the items brought. The order of all sums is that of the items: no bit depends on
// threads. Paths (INDIRECT) draw one ray at a hit, in proportion to what it brings where that is known, and end by
// Russian roulette (Arvo and Kirk 1990).
// Good at: few bounces of all pixels at once. Bad at: memory (a ray of each pixel). Tests: tests/test_modes.py.

#define FOOTPRINTS DERIVATIVES
#include "surface.clh"
#include "lighting.clh"
#include "elementary.clh"
#include "sampling.clh"
#include "ray_items.clh"
#if FOOTPRINTS
#include "ray_differentials.clh"
#endif

typedef struct { float4 direction, throughput; float density; uchar kind; } Scattered;

// Mirrored at n; where that leads into the surface, at its plane in place of the interpolated normal.
static float4 mirror_direction(const Place *place) {
  const float4 d = place->direction;
  const float4 r = d - place->n * (2.0f * dot_f4(d, place->n));
  if (dot_f4(place->g, r) > 0.0f) return unit(r);
  return unit(d - place->g * (2.0f * dot_f4(d, place->g)));
}

static Scattered mirrored(const Place *place, float4 share) {
  const Scattered ray = {mirror_direction(place), place->throughput * share, 0.0f, RAY_REFLECTED};
  return ray;
}

static Scattered refracted(const Place *place, const Interface *at, float4 share) {
  const float4 bent = place->direction * at->ratio + place->n * (at->ratio * at->cosine - at->inner);
  const bool enters = dot_f4(place->g, bent) < 0.0f;  // else a shading normal bends it outwards: straight on
  const Scattered ray = {enters ? unit(bent) : place->direction, place->throughput * share, 0.0f, RAY_REFRACTED};
  return ray;
}

#if INDIRECT
static Scattered nowhere(void) {
  const Scattered ray = {(float4)(0.0f), (float4)(0.0f), 0.0f, 0};
  return ray;
}

static Scattered draw_diffuse(const Place *place, float2 u, float4 share) {
  const float4 l = draw_cosine(place->n, u);
  if (!(dot_f4(place->g, l) > 0.0f)) return nowhere();
  const Scattered ray = {l, place->throughput * place->base * share, density_of(place, l), RAY_INDIRECT};
  return ray;
}

static Scattered draw_rough(const Place *place, float2 u, float choice) {
  const float glossy = glossy_share(place), alpha = lobe_alpha(place->material);
  float4 l;
  if (choice < glossy) {
    const float4 h = draw_normal(place->n, place->to_viewer, alpha, u);
    l = unit(h * (2.0f * dot_f4(place->to_viewer, h)) - place->to_viewer);
  } else {
    l = draw_cosine(place->n, u);
  }
  const float cosine = dot_f4(place->n, l);
  if (!(cosine > 0.0f) || !(dot_f4(place->g, l) > 0.0f)) return nowhere();
  const float density = glossy * density_of_normal(place->n, place->to_viewer, l, alpha) + (1.0f - glossy) * cosine / PI;
  const float4 sent = reflected(place->material, place->base, place->n, place->to_viewer, l, true);
  const Scattered ray = {l, place->throughput * sent / density, density_of(place, l), RAY_INDIRECT};
  return ray;
}

// One ray, drawn. choice: of the ways to go on; u: the direction.
static Scattered draw_ray(const Place *place, float choice, float2 u) {
  if (place->is_unlit) return nowhere();
  const float glass = 1.0f - opaque_share(place);
  const float4 one = (float4)(1.0f);
  if (place->is_glass && choice < glass) {
    const Interface at = interface_of(place);
    return choice / glass < at.mirror.x ? mirrored(place, one) : refracted(place, &at, place->base);
  }
  if (place->is_glass) return draw_diffuse(place, u, one);
  if (!place->is_smooth) return draw_rough(place, u, choice);
  const float mirror = mirror_probability(place);
  const float4 share = interface_of(place).mirror;
  if (choice < mirror) return mirrored(place, share / mirror);
  return draw_diffuse(place, u, (one - share) * ((1.0f - place->material.metallic) / (1.0f - mirror)));
}

// Ends paths of little weight, so that the others stand for them.
static Scattered play_roulette(Scattered ray, float choice) {
  const float survival = min(largest_of(ray.throughput), 0.95f);
  if (choice >= survival) return nowhere();
  ray.throughput /= survival;
  return ray;
}
#else
static Scattered passing(const Place *place, float share) {
  const Scattered ray = {place->direction, place->throughput * share, 0.0f, RAY_REFRACTED};
  return ray;
}
#endif

// Reads: items (shade_hits, arrive). Writes: slot_directions, slot_throughputs, slot_kinds, slot_changes (for leave_hits,
// arrive). Work item: one item. Local memory: 0 bytes.
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
#if FOOTPRINTS
    global const float4 *restrict item_footprints,  // [3 * item_count]
#endif
    global const uint *restrict item_keys,          // [item_count] of random numbers
    global const float4 *restrict positions,        // [vertex_count] world space
    global const uint *restrict indices,            // [3 * triangle_count]
    global const float4 *restrict normals,          // [vertex_count] unit or 0
    global const float2 *restrict uv,               // [vertex_count]
    global const float2 *restrict uv1,              // [vertex_count]
    global const float4 *restrict colors,           // [vertex_count] linear
    global const uint *restrict material_ids,       // [triangle_count]
    global const Material *restrict materials,      // [material_count]
    global const Texture *restrict textures,        // [texture_count]
    global const uchar4 *restrict texels,           // of all textures
    global const float *restrict srgb_to_linear,    // [256]
    global float4 *restrict slot_directions,        // [slot_count * item_count] xyz; w t_max
    global float4 *restrict slot_throughputs,       // [slot_count * item_count] RGB; w density
#if FOOTPRINTS
    global float4 *restrict slot_changes,           // [2 * slot_count * item_count] of the direction, to the right, downwards
#endif
    global uchar *restrict slot_kinds)              // [slot_count * item_count] 0: no ray, else RAY_*
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
  const size_t first_slot = (size_t)item * slot_count;
  for (uint k = 0; k < slot_count; ++k) slot_kinds[first_slot + k] = 0;
  Place place;
  if (!load_place(&items, &mesh, surfaces, item, &place)) return;
  Scattered rays[2];
  uint count = 0;
#if INDIRECT
  const uint key = hash_pair(item_keys[item], seed), dimension = depth * PAIRS_OF_HIT + 2;
  rays[count++] = draw_ray(&place, draw_pair(key, path, dimension).y, draw_pair(key, path, dimension + 1));
  if (depth >= ROULETTE_DEPTH) rays[0] = play_roulette(rays[0], draw_pair(key, path, dimension + 2).x);
#else
  const Interface at = interface_of(&place);
  const float glass = 1.0f - opaque_share(&place);
  if (place.is_smooth)
    rays[count++] = mirrored(&place, at.mirror * (place.alpha * (place.is_glass ? glass : 1.0f)));
  if (place.is_glass)
    rays[count++] = refracted(&place, &at, place.base * (place.alpha * glass * at.pass));
  else if (place.alpha < 1.0f)
    rays[count++] = passing(&place, 1.0f - place.alpha);
#endif
  for (uint k = 0; k < count && k < slot_count; ++k) {
    const Scattered ray = rays[k];
    const float largest = largest_of(ray.throughput);
    if (ray.kind == 0 || !(largest > (INDIRECT ? 0.0f : least_weight)) || !(largest < INFINITY)) continue;
    slot_directions[first_slot + k] = (float4)(ray.direction.xyz, INFINITY);
    slot_throughputs[first_slot + k] = (float4)(ray.throughput.xyz, ray.density);
    slot_kinds[first_slot + k] = ray.kind;
#if FOOTPRINTS
    float4 changes[2] = {item_footprints[3 * (size_t)item + 1], item_footprints[3 * (size_t)item + 2]};
    spread_ray(&place, &mesh, ray.kind, ray.direction, ray.density, changes);
    slot_changes[2 * (first_slot + k)] = changes[0];
    slot_changes[2 * (first_slot + k) + 1] = changes[1];
#endif
  }
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
