// Probes of edge_function.clh and pair.clh for tests: what their functions give for given numbers.
//
// Arrays are planes of `count` numbers, one lane each. Tests: tests/test_edge_function.py, tests/test_shading.py.

#include "vector.clh"
#include "edge_function.clh"
#include "pair.clh"

// Reads: ends, sign_bits. Writes: coefficients, exclusive. Work item: VECTOR_WIDTH edges. Local memory: 0 bytes.
kernel void probe_edges(
    View view,
    uint count,                            // edges, a multiple of VECTOR_WIDTH
    global const float *restrict ends,     // [6][count] x y z of a, then of b; world space
    global const int *restrict sign_bits,  // [count] 0, or 0x80000000 to turn the function round
    global float *restrict coefficients,   // [3][count] c gx gy
    global int *restrict exclusive)        // [count] 1 where a sample on the edge is outside, else 0
{
  const uint first = get_global_id(0) * VECTOR_WIDTH;
  if (first >= count) return;
  const Vec3 a = {LOAD_V(ends + first), LOAD_V(ends + count + first), LOAD_V(ends + 2 * count + first)};
  const Vec3 b = {LOAD_V(ends + 3 * count + first), LOAD_V(ends + 4 * count + first), LOAD_V(ends + 5 * count + first)};
  const Vec3 ra = subtract(a, broadcast(view.origin)), rb = subtract(b, broadcast(view.origin));
  const EdgeFunction edge = edge_function(edge_normal(a, b, ra, rb, view), ra, rb, view, LOAD_V(sign_bits + first));
  STORE_V(edge.c, coefficients + first);
  STORE_V(edge.gx, coefficients + count + first);
  STORE_V(edge.gy, coefficients + 2 * count + first);
  STORE_V(edge.exclusive, exclusive + first);
}

// Reads: edges, samples. Writes: values, outside. Work item: VECTOR_WIDTH samples. Local memory: 0 bytes.
kernel void probe_samples(
    uint count,                              // samples, a multiple of VECTOR_WIDTH
    global const float *restrict edges,      // [9][count] c gx gy of three edges
    global const int *restrict exclusive,    // [3][count] 0 or 1
    global const float *restrict positions,  // [2][count] X Y from the image's centre, pixels
    global float *restrict values,           // [3][count]
    global int *restrict outside)            // [count] negative: outside
{
  const uint first = get_global_id(0) * VECTOR_WIDTH;
  if (first >= count) return;
  const SamplePoint at = {LOAD_V(positions + first), LOAD_V(positions + count + first)};
  float_v v[3];
  for (uint i = 0; i < 3; ++i) {
    const float_v c = LOAD_V(edges + (3 * i + 0) * count + first);
    const float_v gx = LOAD_V(edges + (3 * i + 1) * count + first);
    const float_v gy = LOAD_V(edges + (3 * i + 2) * count + first);
    v[i] = edge_value(c, gx, gy, at);
    STORE_V(v[i], values + i * count + first);
  }
  const int_v x0 = LOAD_V(exclusive + first);
  const int_v x1 = LOAD_V(exclusive + count + first);
  const int_v x2 = LOAD_V(exclusive + 2 * count + first);
  STORE_V(sample_outside(v[0], v[1], v[2], x0, x1, x2), outside + first);
}

// Reads: edges, blocks. Writes: highest. Work item: VECTOR_WIDTH blocks. Local memory: 0 bytes.
kernel void probe_blocks(
    uint count,                           // blocks, a multiple of VECTOR_WIDTH
    global const float *restrict edges,   // [3][count] c gx gy
    global const float *restrict blocks,  // [4][count] x0 y0 x1 y1 of the samples at the corners
    global float *restrict highest)       // [count]
{
  const uint first = get_global_id(0) * VECTOR_WIDTH;
  if (first >= count) return;
  STORE_V(
      block_highest(
          LOAD_V(edges + first), LOAD_V(edges + count + first), LOAD_V(edges + 2 * count + first),
          corner_range(LOAD_V(blocks + first), LOAD_V(blocks + count + first),
                       LOAD_V(blocks + 2 * count + first), LOAD_V(blocks + 3 * count + first))),
      highest + first);
}

// Reads: numbers. Writes: results. Work item: one pair of numbers. Local memory: 0 bytes.
kernel void probe_pairs(
    uint count,
    global const float *restrict numbers,  // [4][count] a.high a.low b.high b.low
    global float *restrict results)        // [10][count] sum, product of the highs; sum, product, quotient of the pairs
{
  const uint i = get_global_id(0);
  if (i >= count) return;
  const Pair a = {(float_v)(numbers[i]), (float_v)(numbers[count + i])};
  const Pair b = {(float_v)(numbers[2 * count + i]), (float_v)(numbers[3 * count + i])};
  const Pair found[5] = {
      two_sum(a.high, b.high), two_product(a.high, b.high), pair_add(a, b), pair_multiply(a, b), pair_divide(a, b)};
  for (uint k = 0; k < 5; ++k) {
    results[2 * k * count + i] = FIRST_LANE(found[k].high);
    results[(2 * k + 1) * count + i] = FIRST_LANE(found[k].low);
  }
}
