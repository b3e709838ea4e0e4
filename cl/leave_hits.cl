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
#include "leave_triangle.clh"
#include "random_numbers.clh"

INLINE Corners corners_of_prim(global const float4 *positions, global const uint *indices, uint prim_id) {
  global const uint *v = indices + 3 * (size_t)prim_id;
  const Corners t = {{positions[v[0]], positions[v[1]], positions[v[2]]}};
  return t;
}

// Where a ray begins that leaves an item along `way`; w as of leave_triangle.
static float4 leave_item(Corners t, float4 weights, float4 position, bool is_first, float4 way) {
  const float4 w = (float4)(weights.xyz, 0.0f);
  const LeftPoint point = is_first ? point_of_position(position, position.w) : point_of_weights(t, w);
  return leave_triangle(t, point, w, camera_of(make_ray((float4)(0.0f), way, NO_HIT)));
}

// Reads: prims_hit, weights (trace_closest, or the host). Writes: origins (for trace_*). Work item: one hit.
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
  const uint item = get_global_id(0);
  if (item >= ray_count) return;
  const Corners t = corners_of_prim(positions, indices, prims_left[item]);
  const Ray ray = make_ray((float4)(0.0f), directions[item], NO_HIT);
  origins[item] = leave_triangle(t, point_of_weights(t, weights[item]), weights[item], camera_of(ray));
}

// Reads: sources (list_edge_pixels), slot_directions (scatter_rays), items (shade_hits, arrive). Writes: rays for
// trace_closest, side by side. Work item: one ray. Local memory: 0 bytes.
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
  const uint ray = get_global_id(0);
  if (ray >= ray_count) return;
  const uint source = sources[ray], item = source / slot_count, prim_id = item_prims[item];
  const float4 direction = slot_directions[source];
  const float4 origin = leave_item(corners_of_prim(positions, indices, prim_id), item_weights[item], item_positions[item], is_first, direction);
  origins[ray] = (float4)(origin.xyz, 0.0f);
  directions[ray] = (float4)(direction.xyz, origin.w > 0.0f ? direction.w : 0.0f);
  excluded[ray] = prim_id;
  ray_keys[ray] = FIRST_LANE(keys_of_rays((uint_v)(item_keys[item]), seed, depth, false));
}

// Reads: slot_ends, slot_lamps (aim_at_light), items (shade_hits, arrive). Writes: rays for trace_any, one of each item.
// Work item: one ray. Local memory: 0 bytes.
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
  const uint ray = get_global_id(0);
  if (ray >= ray_count) return;
  const uint prim_id = item_prims[ray] == NO_HIT ? 0 : item_prims[ray];
  const float4 end = slot_ends[ray], position = item_positions[ray];
  const bool to_point = end.w > 0.0f;
  const float4 way = to_point ? end - position : end;
  float4 origin = (float4)(0.0f);
  if (way.x != 0.0f || way.y != 0.0f || way.z != 0.0f)
    origin = leave_item(corners_of_prim(positions, indices, prim_id), item_weights[ray], position, is_first, way);
  const float4 aim = to_point ? end - origin : end;
  const float size = max(fabs(aim.x), max(fabs(aim.y), fabs(aim.z)));
  const bool goes = origin.w > 0.0f && size >= LEAST_WAY && size <= LARGEST_WAY;
  origins[ray] = (float4)(origin.xyz, 0.0f);
  directions[ray] = (float4)(aim.xyz, goes ? (to_point ? 1.0f : INFINITY) : 0.0f);
  excluded[ray] = prim_id;
  ends[ray] = end;
  lamp_slots[ray] = slot_lamps[ray];
  ray_keys[ray] = FIRST_LANE(keys_of_rays((uint_v)(item_keys[ray]), seed, depth, true));
}
