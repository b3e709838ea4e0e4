// Lays a scene's triangles out for rasterization: corners side by side, and the plane's normal.
//
// View-independent, once for a scene. Reading a triangle then takes no indirection by vertex indices, and
// its plane (see canonical_triangles) need not be found again in every tile and frame.
//   corners[3 slot + i] = i-th corner, the canonically first one first; w = i-th component of the normal
// A slot is a prim_id, or with LEAF_ORDER a place in the leaves of a BVH: a leaf's triangles lie side by side.
// Good at: everything that is drawn more than once. Bad at: memory (48 bytes a triangle).
// Tests: tests/test_rasterizer.py.

#include "vector.clh"
#include "edge_function.clh"

// Reads: positions, indices (host). Writes: corners (for setup_triangles, bin_triangles,
// rasterize_tiles). Work item: one triangle. Local memory: 0 bytes.
kernel void prepare_triangles(
    uint triangle_count,
    global const float4 *restrict positions,  // [vertex_count] world space times world_scale
    global const uint *restrict indices,      // [3 * triangle_count] vertices
#if LEAF_ORDER
    global const uint *restrict prims,        // [triangle_count] prim_id of each slot
#endif
#if ALPHA_MASK
    global uint *restrict corner_vertices,    // [3 * triangle_count] the vertices that the corners are
#endif
    global float4 *restrict corners)          // [3 * triangle_count]
{
  const uint slot = get_global_id(0);
  if (slot >= triangle_count) return;
#if LEAF_ORDER
  const uint prim_id = prims[slot];
#else
  const uint prim_id = slot;
#endif
  global const uint *vertices = indices + 3 * (size_t)prim_id;
  const float4 a = positions[vertices[0]], b = positions[vertices[1]], c = positions[vertices[2]];
  const Vec3 p0 = {a.x, a.y, a.z}, p1 = {b.x, b.y, b.z}, p2 = {c.x, c.y, c.z};
  const Triangles t = canonical_triangles(p0, p1, p2);
#if ALPHA_MASK
  const uint turn = is_first(p1, p2, p0) ? 1 : (is_first(p2, p0, p1) ? 2 : 0);
  for (uint i = 0; i < 3; ++i) corner_vertices[3 * (size_t)prim_id + i] = vertices[(i + turn) % 3];
#endif
  global float4 *own = corners + 3 * (size_t)slot;
  own[0] = (float4)(t.p0.x, t.p0.y, t.p0.z, t.normal.x);
  own[1] = (float4)(t.p1.x, t.p1.y, t.p1.z, t.normal.y);
  own[2] = (float4)(t.p2.x, t.p2.y, t.p2.z, t.normal.z);
}
