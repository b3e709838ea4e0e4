// Settles what float32 left open: which triangles face the viewer, and which contenders take their samples.
//
// The last two rungs of the precision ladder (DESIGN section 1). A contender is a pair (pixel, triangle) that the
// filter could not decide (filtered_samples.clh). For each:
//   does the triangle cover the sample? float64 with its bound, else integers; `double`: float64 as it is
//   is it nearer than what is visible there? the same ladder; where both are as near, the smaller id
//   if so it takes the sample, by compare and exchange: whatever the order, the nearest stays
// Good at: few contenders (a fraction of a per cent of the samples). Bad at: many coincident surfaces.
// Tests: tests/test_exact.py.

#include "vector.clh"
#include "counters.clh"
#include "edge_function.clh"
#if ALPHA_MASK
#include "surface.clh"
#endif
#include "settled_tests.clh"

// What the contenders of one launch share.
typedef struct {
  View view;
  Camera camera;
  global const float4 *positions;  // [vertex_count] world space, as given
  global const uint *indices;      // [3 * triangle_count]
#if KEEP_NEARNESS
  uint layer;
  global const uint *front_prims;  // [band pixels]
  global float *nearness;          // [2 * band pixels]
#endif
#if ALPHA_MASK
  Surfaces surfaces;
  global const uint *corner_vertices;     // [3 * triangle_count] vertices in the order of the corners
  global const float4 *scaled_positions;  // [vertex_count] world space times world_scale
#endif
} Ground;

#if ALPHA_MASK
// Whether a surface of alpha mode MASK is opaque enough at the sample; weighed as in the other rungs.
static bool mask_lets_pass(const Ground *g, uint prim_id, Place at) {
  const Material material = g->surfaces.materials[g->surfaces.material_ids[prim_id]];
  if (!(material.flags & MATERIAL_MASK)) return true;
  global const uint *vertices = g->corner_vertices + 3 * (size_t)prim_id;
  float4 p[3];
  for (uint i = 0; i < 3; ++i) p[i] = g->scaled_positions[vertices[i]];
  const Vec3 a = {p[0].x, p[0].y, p[0].z}, b = {p[1].x, p[1].y, p[1].z}, c = {p[2].x, p[2].y, p[2].z};
  const TriangleSetup setup = setup_triangles_3d(canonical_triangles(a, b, c), g->view);
  const SamplePoint sample = sample_point(g->view, (float)at.x * (1.0f / 256.0f) - g->view.center_x,
                                          (float)at.y * (1.0f / 256.0f) - g->view.center_y);
  SurfacePoint point;
  point.prim_id = prim_id;
  point.i0 = vertices[0];
  point.i1 = vertices[1];
  point.i2 = vertices[2];
  weigh_vertices(&point, edge_value_at(setup.edge[0], sample), edge_value_at(setup.edge[1], sample),
                 edge_value_at(setup.edge[2], sample));
  return !(base_color(g->surfaces, material, point).w < material.alpha_cutoff);
}
#endif

// Lets one contender take its sample, if it must.
static void settle_contender(const Ground *g, uint pixel, uint prim_id, volatile global uint *visible_prims, Rungs *rungs) {
  const uint column = pixel % g->view.width, row = pixel / g->view.width + g->view.band_top;
  const Place place = {(int)(256 * column) + (int)(256.0f * g->view.sample_x), (int)(256 * row) + (int)(256.0f * g->view.sample_y)};
#if PLANAR
  const Place at = place;
  const Camera camera = g->camera;
#else
  const Place at = {0, 0};
  const Camera camera = camera_of_sample(g->view, g->camera.origin, (float)place.x * (1.0f / 256.0f) - g->view.center_x,
                                         (float)place.y * (1.0f / 256.0f) - g->view.center_y);
#endif
  const Corners t = load_corners(g->positions, g->indices, prim_id);
  if (!covers(t, camera, at, rungs)) return;
#if ALPHA_MASK
  if (!mask_lets_pass(g, prim_id, place)) return;
#endif
  uint other = visible_prims[pixel];
#if KEEP_NEARNESS
  // First against the layer in front, which must come before it, then against what is visible.
  bool is_behind = g->layer == 0;
  if (!is_behind) other = g->front_prims[pixel];
  if (!is_behind && (other == NO_HIT || other == prim_id)) return;
#else
  const bool is_behind = true;
#endif
  while (other != prim_id) {
    if (other != NO_HIT) {
      const Corners u = load_corners(g->positions, g->indices, other);
      if (goes_before(t, prim_id, u, other, camera, at, rungs) != is_behind) return;
    }
#if KEEP_NEARNESS
    if (!is_behind) {
      is_behind = true;
      other = visible_prims[pixel];
      continue;
    }
#endif
    const uint found = atomic_cmpxchg(visible_prims + pixel, other, prim_id);
    if (found == other) break;
    other = found;
  }
#if KEEP_NEARNESS
  // What lies behind this layer is compared with the triangle itself.
  g->nearness[pixel] = -INFINITY;
  g->nearness[band_pixels(g->view) + pixel] = INFINITY;
#endif
}

// Reads: unsure_slots, contender_state (setup_triangles). Writes: facing_signs (for rasterize_tiles,
// traverse_frusta); bounds_high: 0 where a triangle is seen edge-on. Work item: some slots. Local memory: 0 bytes.
kernel void settle_facing(
    View view,
    Camera camera,
    global const float4 *restrict positions,  // [vertex_count] world space, as given
    global const uint *restrict indices,      // [3 * triangle_count]
#if LEAF_ORDER
    global const uint *restrict prims,        // [triangle_count] prim_id of each slot
#endif
    global const uint *restrict contender_state, // [CONTENDER_WORDS]
    global const uint *restrict unsure_slots, // [triangle_count]
    global char *restrict facing_signs,       // [padded triangle_count] by slot
    global uint *restrict bounds_low,         // [padded triangle_count]
    global uint *restrict bounds_high)        // [padded triangle_count]
{
  const uint count = contender_state[CONTENDER_FACINGS];
  for (uint k = get_global_id(0); k < count; k += get_global_size(0)) {
    const uint slot = unsure_slots[k];
#if LEAF_ORDER
    const uint prim_id = prims[slot];
#else
    const uint prim_id = slot;
#endif
    Rungs rungs = {false, false};
    const int sign = facing_sign(load_corners(positions, indices, prim_id), camera, &rungs);
    facing_signs[slot] = (char)sign;
    if (sign == 0) bounds_low[slot] = bounds_high[slot] = 0;
  }
}

// Reads: contenders (rasterize_tiles, traverse_frusta). Writes: visible_prims (for shade_hits).
// Work item: some contenders. Local memory: 0 bytes.
kernel void settle_contenders(
    View view,
    Camera camera,
    uint contender_capacity,                  // entries of the list
    global const float4 *restrict positions,  // [vertex_count] world space, as given
    global const uint *restrict indices,      // [3 * triangle_count]
#if KEEP_NEARNESS
    uint layer,                               // 0, or more: front_prims says what lies in front
    global const uint *restrict front_prims,  // [band height * width] prim_id or NO_HIT
    global float *restrict nearness,          // [2 * band height * width]
#endif
#if ALPHA_MASK
    global const uint *restrict corner_vertices, // [3 * triangle_count] vertices in the order of the corners
    global const float4 *restrict scaled_positions, // [vertex_count] world space times world_scale
    global const uint *restrict material_ids,    // [triangle_count]
    global const Material *restrict materials,   // [material_count]
    global const Texture *restrict textures,     // [texture_count]
    global const uchar4 *restrict texels,        // of all textures
    global const float *restrict srgb_to_linear, // [512] see Surfaces
    global const float2 *restrict uv,            // [vertex_count]
    global const float2 *restrict uv1,           // [vertex_count]
    global const float4 *restrict colors,        // [vertex_count] linear
#endif
    global const uint2 *restrict contenders,  // [contender_capacity] pixel of the band, prim_id
    global uint *restrict contender_state,    // [CONTENDER_WORDS] counts what each rung settled
    volatile global uint *visible_prims)      // [band height * width] prim_id or NO_HIT
{
  const uint count = min(contender_state[CONTENDER_COUNT], contender_capacity);
  Ground g;
  g.view = view;
  g.camera = camera;
  g.positions = positions;
  g.indices = indices;
#if KEEP_NEARNESS
  g.layer = layer;
  g.front_prims = front_prims;
  g.nearness = nearness;
#endif
#if ALPHA_MASK
  const Surfaces surfaces = {material_ids, materials, textures, texels, srgb_to_linear, uv, uv1, colors};
  g.surfaces = surfaces;
  g.corner_vertices = corner_vertices;
  g.scaled_positions = scaled_positions;
#endif
  uint by_float64 = 0, by_integers = 0;
  for (uint k = get_global_id(0); k < count; k += get_global_size(0)) {
    Rungs rungs = {false, false};
    settle_contender(&g, contenders[k].x, contenders[k].y, visible_prims, &rungs);
    by_float64 += rungs.by_float64 && !rungs.by_integers;
    by_integers += rungs.by_integers;
  }
  if (by_float64) atomic_add(contender_state + CONTENDER_FLOAT64, by_float64);
  if (by_integers) atomic_add(contender_state + CONTENDER_EXACT, by_integers);
}
