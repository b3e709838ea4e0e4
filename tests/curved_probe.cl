// Probes of elementary.clh, block_ranges.clh and nearness_plane.clh for tests: what their functions give for given numbers.
//
// Arrays are planes of `count` numbers, one lane each. Tests: tests/test_projections.py.

#include "vector.clh"
#include "edge_function.clh"

#if !PLANAR
// Reads: numbers. Writes: results. Work item: VECTOR_WIDTH numbers. Local memory: 0 bytes.
kernel void probe_angles(
    uint count,                            // numbers, a multiple of VECTOR_WIDTH
    float whole,
    global const float *restrict numbers,  // [2][count] x and y
    global float *restrict results)        // [5][count] sine, cosine of x turns; of y / whole turns; angle of (x, y)
{
  const uint first = get_global_id(0) * VECTOR_WIDTH;
  if (first >= count) return;
  const float_v x = LOAD_V(numbers + first), y = LOAD_V(numbers + count + first);
  const SineCosine turned = sine_cosine(x), part = sine_cosine_of_ratio(y, whole);
  STORE_V(turned.sine, results + first);
  STORE_V(turned.cosine, results + count + first);
  STORE_V(part.sine, results + 2 * count + first);
  STORE_V(part.cosine, results + 3 * count + first);
  STORE_V(turn_of(y, x), results + 4 * count + first);
}

// Reads: normals, blocks. Writes: highest. Work item: VECTOR_WIDTH blocks. Local memory: 0 bytes.
kernel void probe_blocks(
    View view,
    uint count,                            // blocks, a multiple of VECTOR_WIDTH
    global const float *restrict normals,  // [3][count]
    global const float *restrict blocks,   // [4][count] x0 y0 x1 y1 from the image's centre
    global float *restrict highest)        // [count]
{
  const uint first = get_global_id(0) * VECTOR_WIDTH;
  if (first >= count) return;
  const BlockRange range = BLOCK_RANGE(view, LOAD_V(blocks + first), LOAD_V(blocks + count + first),
                                       LOAD_V(blocks + 2 * count + first), LOAD_V(blocks + 3 * count + first));
  STORE_V(block_highest(LOAD_V(normals + first), LOAD_V(normals + count + first), LOAD_V(normals + 2 * count + first), range),
          highest + first);
}

// Reads: normals, points. Writes: volumes. Work item: VECTOR_WIDTH planes. Local memory: 0 bytes.
kernel void probe_volumes(
    uint count,                            // planes, a multiple of VECTOR_WIDTH
    float eye_x,
    float eye_y,
    float eye_z,
    global const float *restrict normals,  // [3][count] N
    global const float *restrict points,   // [3][count] p
    global float *restrict volumes)        // [count] N . (p - eye)
{
  const uint first = get_global_id(0) * VECTOR_WIDTH;
  if (first >= count) return;
  const Vec3 n = {LOAD_V(normals + first), LOAD_V(normals + count + first), LOAD_V(normals + 2 * count + first)};
  const Vec3 p = {LOAD_V(points + first), LOAD_V(points + count + first), LOAD_V(points + 2 * count + first)};
  STORE_V(precise_volume(n, p, (float4)(eye_x, eye_y, eye_z, 0.0f)), volumes + first);
}
#endif
