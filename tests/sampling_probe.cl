// Probes of elementary.clh and sampling.clh for tests: what their functions give for given numbers.
//
// Arrays are planes of `count` numbers. Tests: tests/test_sampling.py.

#include "surface.clh"
#include "lighting.clh"
#include "elementary.clh"
#include "sampling.clh"

// Reads: turns. Writes: results. Work item: one angle. Local memory: 0 bytes.
kernel void probe_turns(
    uint count,
    global const float *restrict turns,  // [count] in [0, 1]
    global float *restrict results)      // [2][count] cosine, sine
{
  const uint i = get_global_id(0);
  if (i >= count) return;
  const SineCosine found = sine_cosine(turns[i]);
  results[i] = found.cosine;
  results[count + i] = found.sine;
}

// Reads: words. Writes: results. Work item: one pair of words. Local memory: 0 bytes.
kernel void probe_keys(
    uint count,
    global const uint *restrict words,  // [2][count]
    global uint *restrict results)      // [count] hash_pair of both
{
  const uint i = get_global_id(0);
  if (i < count) results[i] = hash_pair(words[i], words[count + i]);
}

// Reads: places. Writes: results. Work item: one point. Local memory: 0 bytes.
kernel void probe_points(
    uint count,
    global const uint *restrict places,  // [3][count] key, index, dimension
    global float *restrict results)      // [2][count] in [0, 1)
{
  const uint i = get_global_id(0);
  if (i >= count) return;
  const float2 found = draw_pair(places[i], places[count + i], places[2 * count + i]);
  results[i] = found.x;
  results[count + i] = found.y;
}

static Vec3 vector_of(global const float *numbers, uint count, uint i) {
  const Vec3 v = {numbers[i], numbers[count + i], numbers[2 * count + i]};
  return v;
}

// Reads: vectors. Writes: results. Work item: one vector. Local memory: 0 bytes.
kernel void probe_units(
    uint count,
    global const float *restrict vectors,  // [3][count]
    global float *restrict results)        // [6][count] unit3, unit
{
  const uint i = get_global_id(0);
  if (i >= count) return;
  const Vec3 v = vector_of(vectors, count, i), found = unit3(v);
  const float4 alike = unit((float4)(v.x, v.y, v.z, 0.0f));
  const float all[6] = {found.x, found.y, found.z, alike.x, alike.y, alike.z};
  for (uint k = 0; k < 6; ++k) results[k * count + i] = all[k];
}

// Reads: n, v, u. Writes: results. Work item: one draw. Local memory: 0 bytes.
kernel void probe_directions(
    uint count,
    float alpha,
    global const float *restrict n,  // [3][count] unit
    global const float *restrict v,  // [3][count] unit, on the side of n
    global const float *restrict u,  // [2][count] in [0, 1)
    global float *restrict results)  // [6][count] draw_cosine, draw_normal
{
  const uint i = get_global_id(0);
  if (i >= count) return;
  const Vec3 found[2] = {
      draw_cosine(vector_of(n, count, i), u[i], u[count + i]),
      draw_normal(vector_of(n, count, i), vector_of(v, count, i), alpha, u[i], u[count + i])};
  for (uint k = 0; k < 2; ++k) {
    results[(3 * k + 0) * count + i] = found[k].x;
    results[(3 * k + 1) * count + i] = found[k].y;
    results[(3 * k + 2) * count + i] = found[k].z;
  }
}

// Reads: n, v, l. Writes: results. Work item: one direction. Local memory: 0 bytes.
kernel void probe_densities(
    uint count,
    float alpha,
    global const float *restrict n,  // [3][count] unit
    global const float *restrict v,  // [3][count] unit, on the side of n
    global const float *restrict l,  // [3][count] unit
    global float *restrict results)  // [count] density_of_normal
{
  const uint i = get_global_id(0);
  if (i < count) results[i] = density_of_normal(vector_of(n, count, i), vector_of(v, count, i), vector_of(l, count, i), alpha);
}
