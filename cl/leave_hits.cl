// Rays that leave hits: where each of them begins (leave_triangle.clh), and where those end that look for light.
//
// A hit of the camera is known by its position, which shade_hits.cl finds in pairs of floats; hits of other rays by
// their weights. A ray that looks for light is aimed from where it begins, not from the hit: it ends where the light is.
// Good at: any hit. Bad at: drivers that limit loops (exact tests of sides). Tests: tests/test_rays.py,
// tests/test_modes_shadow.py, tests/test_modes_path.py.

#include "vector.clh"
#include "edge_function.clh"
#include "settled_tests.clh"
#include "intersect_triangle.clh"
#include "lanes.clh"
#include "leave_triangle.clh"
#include "random_numbers.clh"

INLINE LeftTriangles gather_triangles_to_leave(global const float4 *positions, global const uint *indices, const uint *prims) {
  uint vertices[3][VECTOR_WIDTH];
#pragma unroll
  for (uint k = 0; k < 3; ++k)
    for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) vertices[k][lane] = indices[3 * (size_t)prims[lane] + k];
  float_v unused;
  return triangles_to_leave(gather_points(positions, vertices[0], &unused), gather_points(positions, vertices[1], &unused),
                            gather_points(positions, vertices[2], &unused));
}

// Where rays begin that leave items along `ways`.
INLINE Starts leave_items(LeftTriangles t, Vec3 weights, Vec3 positions, float_v doubt, bool is_first, Vec3 ways, int_v wanted) {
  const LeftPoints points = is_first ? points_of_positions(positions, doubt) : points_of_weights(&t, weights);
  return leave_triangles(t, points, weights, ways, wanted);
}

// Reads: prims_hit, weights (trace_closest, or the host). Writes: origins (for trace_*). Work item: VECTOR_WIDTH hits.
// Local memory: 0 bytes.
kernel void offset_origins(
    uint ray_count,
    global const uint *restrict prims_left,    // [ray_count] prim_id that the ray leaves
    global const float4 *restrict weights,     // [ray_count] b0 b1 b2 of the point
    global const float4 *restrict directions,  // [ray_count] xyz of the ray that leaves
    global const float4 *restrict positions,   // [vertex_count] world space
    global const uint *restrict indices,       // [3 * triangle_count] vertices
    global float4 *restrict origins)           // [ray_count] xyz; w 1, or 0 where the triangle has no side
{
  const uint first = get_global_id(0) * VECTOR_WIDTH;
  if (first >= ray_count) return;
  uint prims[VECTOR_WIDTH];
  STORE_V(load_words(prims_left, first, ray_count), prims);
  float_v unused;
  const Vec3 w = load_points(weights, first, ray_count, &unused), way = load_points(directions, first, ray_count, &unused);
  const Starts starts = leave_items(
      gather_triangles_to_leave(positions, indices, prims), w, w, unused, false, way, LANES >= 0);
  store_points(origins, first, ray_count, 1, 0, starts.at, starts.begins);
}

// Reads: sources (list_edge_pixels), slot_directions (scatter_rays), items (shade_hits, arrive). Writes: rays for
// trace_closest, side by side. Work item: VECTOR_WIDTH rays. Local memory: 0 bytes.
kernel void leave_hits(
    uint ray_count,
    uint slot_count,                                // slots of an item
    uint is_first,                                  // 1: hits of the camera's samples
    uint seed,                                      // of random numbers
    uint depth,                                     // generation
    global const uint *restrict sources,            // [ray_count] slot of each ray
    global const uint *restrict item_prims,         // [item_count] prim_id that its rays leave
    global const float4 *restrict item_weights,     // [item_count] barycentrics of the point
    global const float4 *restrict item_positions,   // [item_count] world space; w of the first generation: doubt
    global const uint *restrict item_keys,          // [item_count] of random numbers
    global const float4 *restrict slot_directions,  // [slot_count * item_count] xyz; w t_max
    global const float4 *restrict positions,        // [vertex_count] world space
    global const uint *restrict indices,            // [3 * triangle_count] vertices
    global float4 *restrict origins,                // [ray_count] xyz; w t_min 0
    global float4 *restrict directions,             // [ray_count] xyz; w t_max, 0 where the triangle has no side
    global uint *restrict excluded,                 // [ray_count] prim_id that is left
    global uint *restrict ray_keys)                 // [ray_count] of random numbers
{
  const uint first = get_global_id(0) * VECTOR_WIDTH;
  if (first >= ray_count) return;
  uint slots[VECTOR_WIDTH], items[VECTOR_WIDTH], prims[VECTOR_WIDTH];
  STORE_V(load_words(sources, first, ray_count), slots);
  for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) items[lane] = slots[lane] / slot_count;
  const uint_v left = gather_words(item_prims, items);
  STORE_V(left, prims);
  float_v unused, doubt, t_max;
  const Vec3 weights = gather_points(item_weights, items, &unused), at = gather_points(item_positions, items, &doubt);
  const Vec3 way = gather_points(slot_directions, slots, &t_max);
  const Starts starts = leave_items(
      gather_triangles_to_leave(positions, indices, prims), weights, at, doubt, is_first, way, LANES >= 0);
  store_points(origins, first, ray_count, 1, 0, starts.at, (float_v)(0.0f));
  store_points(directions, first, ray_count, 1, 0, way, starts.begins > 0.0f ? t_max : (float_v)(0.0f));
  store_words(excluded, first, ray_count, left);
  store_words(ray_keys, first, ray_count, keys_of_rays(gather_words(item_keys, items), seed, depth, false));
}

// Reads: slot_ends, slot_lamps (aim_at_light), items (shade_hits, arrive). Writes: rays for trace_any, one of each item.
// Work item: VECTOR_WIDTH rays. Local memory: 0 bytes.
kernel void leave_for_light(
    uint ray_count,
    uint is_first,                                  // 1: hits of the camera's samples
    uint seed,                                      // of random numbers
    uint depth,                                     // generation
    global const uint *restrict item_prims,         // [ray_count] prim_id that the ray leaves, or NO_HIT
    global const float4 *restrict item_weights,     // [ray_count] barycentrics of the point
    global const float4 *restrict item_positions,   // [ray_count] world space; w of the first generation: doubt
    global const uint *restrict item_keys,          // [ray_count] of random numbers
    global const float4 *restrict slot_ends,        // [ray_count] w 1: xyz is a point; 0: a direction, (0, 0, 0): no ray
    global const uint *restrict slot_lamps,         // [ray_count] slot of the emissive triangle that it is on, or NO_HIT
    global const float4 *restrict positions,        // [vertex_count] world space
    global const uint *restrict indices,            // [3 * triangle_count] vertices
    global float4 *restrict origins,                // [ray_count] xyz; w t_min 0
    global float4 *restrict directions,             // [ray_count] xyz; w t_max, 0 where there is nothing in between
    global uint *restrict excluded,                 // [ray_count] prim_id that is left
    global float4 *restrict ends,                   // [ray_count] slot_ends
    global uint *restrict lamp_slots,               // [ray_count] slot_lamps
    global uint *restrict ray_keys)                 // [ray_count] of random numbers
{
  const uint first = get_global_id(0) * VECTOR_WIDTH;
  if (first >= ray_count) return;
  uint prims[VECTOR_WIDTH];
  const uint_v hit = load_words(item_prims, first, ray_count), left = hit == (uint_v)(NO_HIT) ? (uint_v)(0) : hit;
  STORE_V(left, prims);
  float_v unused, doubt, to_point, t_max;
  const Vec3 weights = load_points(item_weights, first, ray_count, &unused);
  const Vec3 at = load_points(item_positions, first, ray_count, &doubt);
  const Vec3 end = load_points(slot_ends, first, ray_count, &to_point);
  const Vec3 way = way_to(at, end, to_point);
  const int_v wanted = (way.x != 0.0f) | (way.y != 0.0f) | (way.z != 0.0f);
  const Starts starts = leave_items(
      gather_triangles_to_leave(positions, indices, prims), weights, at, doubt, is_first, way, wanted);
  const Vec3 aim = aim_again(starts, end, to_point, &t_max);
  store_points(origins, first, ray_count, 1, 0, starts.at, (float_v)(0.0f));
  store_points(directions, first, ray_count, 1, 0, aim, t_max);
  store_words(excluded, first, ray_count, left);
  store_points(ends, first, ray_count, 1, 0, end, to_point);
  store_words(lamp_slots, first, ray_count, load_words(slot_lamps, first, ray_count));
  store_words(ray_keys, first, ray_count, keys_of_rays(load_words(item_keys, first, ray_count), seed, depth, true));
}
