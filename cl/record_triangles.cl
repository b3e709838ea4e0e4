// Sets triangles up for rays that come one by one: a record each, and whether a grid can be trusted with it.
//
// Rays meet a triangle again and again, in no order: here, unlike in tiles, its setup is kept. A record is RECORD_WORDS
// words, one cache line:
//   0..8    c, gx, gy of the three edge functions        9..11  c, x, y of nearness
//   12, 13  canonical screen bound, x0 | y0 << 16 and x1 | y1 << 16: 0 where no sample can see it, or it is loose
//   14      three bits: a sample on that edge is outside; FILTERED: the bound E of edge errors, with the sign of the volume
//   15      FILTERED: from nearness, an upper bound, to the lower bound
//
// A triangle is *loose* where float32 may let it cover samples whose rays pass farther from it than the grid's padding
// allows, or say it to be nearer than it is by more than NEARNESS_DOUBT: triangles seen all but edge-on. Their bounds go
// to loose_low and loose_high, from which tiles are binned and rasterized before the rays start: same bits, other order.
// Which ones: V_i within E of its value, V_i >= 0 computed, hence V_i >= -E. Let b_i = V_i / (V_0 + V_1 + V_2) >= -B. The
// hit lies within 2 B |e| of the triangle along each axis, |e| its longest extent there (two b_i below 0 at most). With
// volume N . r_0 = v > 0 and depths z_i, perspective: V_0 z_0 + V_1 z_1 + V_2 z_2 = 2 v (f . d = 1), so that
// V_0 + V_1 + V_2 >= 2 v / z - 4 E, z = max |z_i|. With q = E z / v, 5/4 of it for v's own error: B <= q wherever
// q <= 1/8, and then w >= 3 / (4 z) as well. Orthographic: the sum is v itself, B = E / v.
// Good at: many rays a triangle. Bad at: memory (64 bytes a triangle). Tests: tests/test_grid.py.

#define WITH_ERROR_BOUNDS 1

#include "vector.clh"
#include "counters.clh"
#include "edge_function.clh"

#if FILTERED
#define DOUBT_SHARE 1.52587890625e-5f  // 2^-16: float64 decides, its errors are under 2^-25 of float32's
#else
#define DOUBT_SHARE 1.0f
#endif

// Mask: the grid finds every sample that such a triangle may be given.
INLINE int_v is_tame(Triangles t, TriangleSetup setup, ErrorBounds errors, View view, Grid grid, float walk_doubt) {
  const Vec3 origin = broadcast(view.origin);
  const Vec3 edge = largest(sizes(subtract(t.p1, t.p2)), largest(sizes(subtract(t.p2, t.p0)), sizes(subtract(t.p0, t.p1))));
  const float_v size = fabs(setup.volume), doubt = errors.edge * DOUBT_SHARE;
#if PROJECTION == PROJECTION_ORTHOGRAPHIC
  const float_v share = 1.25f * doubt / size;
  const float_v far = fabs(setup.nearness.c) + view.center_x * fabs(setup.nearness.x) + view.center_y * fabs(setup.nearness.y);
  const float_v late = errors.nearness + errors.nearness_by_size * far;
  int_v tame = late * DOUBT_SHARE <= 0.5f * min(grid.pad.x, min(grid.pad.y, grid.pad.z));
#else
  const float_v depth = max(fabs(dot3s(subtract(t.p0, origin), view.inverse_w)),
                            max(fabs(dot3s(subtract(t.p1, origin), view.inverse_w)),
                                fabs(dot3s(subtract(t.p2, origin), view.inverse_w)))) * (1.0f + 64.0f * UNIT) + LENGTH_FLOOR;
  const float_v share = 1.25f * doubt * depth / size;
  const float_v late = errors.nearness * (1.34f * depth) + errors.nearness_by_size;
  int_v tame = late * DOUBT_SHARE <= NEARNESS_DOUBT;
#endif
  tame &= (share <= 0.125f) & (errors.facing_unsure == 0);
  tame &= (2.0f * share * edge.x <= grid.pad.x - walk_doubt) & (2.0f * share * edge.y <= grid.pad.y - walk_doubt) &
          (2.0f * share * edge.z <= grid.pad.z - walk_doubt);
  return tame;
}

#if FILTERED
// Makes nearness an upper bound over the image's samples in the bound, and stores its span.
INLINE void widen_record(TriangleSetup *setup, ErrorBounds errors, View view, uint_v low, uint_v high, float *span) {
  const float_v x0 = TO_FLOAT_V(AS_INT_V(low & 0xffffu)) + (view.samples_left - view.center_x);
  const float_v y0 = TO_FLOAT_V(AS_INT_V(low >> 16)) + (view.samples_top - view.center_y);
  const float_v x1 = TO_FLOAT_V(AS_INT_V(high & 0xffffu)) + (view.samples_right - 1.0f - view.center_x);
  const float_v y1 = TO_FLOAT_V(AS_INT_V(high >> 16)) + (view.samples_bottom - 1.0f - view.center_y);
  const float_v most = block_highest(setup->nearness.c, setup->nearness.x, setup->nearness.y, BLOCK_RANGE(view, x0, y0, x1, y1));
  widen_nearness(&setup->nearness, errors, most, view.center_x, view.center_y, span);
}
#endif

// Writes the records of VECTOR_WIDTH triangles from `first` on, as far as they are in `wanted`.
INLINE void store_records(TriangleSetup setup, const uint *word_14, const float *word_15, uint first, int_v wanted,
                          global uint *records) {
  float word[12][VECTOR_WIDTH];
#pragma unroll
  for (uint i = 0; i < 3; ++i) {
    STORE_V(setup.edge[i].c, word[3 * i]);
    STORE_V(setup.edge[i].gx, word[3 * i + 1]);
    STORE_V(setup.edge[i].gy, word[3 * i + 2]);
  }
  STORE_V(setup.nearness.c, word[9]);
  STORE_V(setup.nearness.x, word[10]);
  STORE_V(setup.nearness.y, word[11]);
  for (ulong mask = LANE_MASK(wanted); mask != 0; mask &= mask - 1) {
    const int lane = first_lane(mask);
    global uint *record = records + (size_t)RECORD_WORDS * (first + lane);
    for (uint k = 0; k < 12; ++k) record[k] = as_uint(word[k][lane]);
    record[14] = word_14[lane];
    record[15] = as_uint(word_15[lane]);
  }
}

// Reads: corners (prepare_triangles), bounds (setup_triangles), facing_signs (settle_facing). Writes: records (for
// traverse_grid), loose bounds (for bin_triangles), loose_counts (for the host). Work item: one chunk of triangles.
// Local memory: 0 bytes.
kernel void record_triangles(
    View view,
    Grid grid,
    uint triangle_count,
    uint chunk_size,                          // triangles a chunk, a multiple of VECTOR_WIDTH
    float doubt,                              // how far at most walks stray from their rays
    global const float4 *restrict corners,    // [3 * triangle_count]
    global const uint *restrict bounds_low,   // [padded triangle_count]
    global const uint *restrict bounds_high,  // [padded triangle_count]
#if FILTERED
    global const char *restrict facing_signs, // [padded triangle_count] signs that float32 cannot tell
#endif
#if COUNTERS
    global ulong *restrict work,              // [chunks * WORK_COUNTER_COUNT] added to
#endif
    global uint *restrict records,            // [padded triangle_count * RECORD_WORDS]
    global uint *restrict loose_low,          // [padded triangle_count] bounds of loose triangles, 0 for others
    global uint *restrict loose_high,         // [padded triangle_count]
    global uint *restrict loose_counts)       // [chunks] loose triangles
{
  const uint begin = get_global_id(0) * chunk_size;
  const uint end = min(begin + chunk_size, triangle_count);
  uint loose_count = 0;
  for (uint k = begin; k < end; k += VECTOR_WIDTH) {
    const uint_v low = LOAD_V(bounds_low + k), high = LOAD_V(bounds_high + k);
    int_v in_view = high != 0;
    int_v loose = in_view;
    if (has_lane(in_view)) {
      uint prim_id[VECTOR_WIDTH];  // lanes past the last triangle repeat it
#pragma unroll
      for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) prim_id[lane] = min(k + lane, triangle_count - 1);
      const Triangles triangles = gather_triangles(corners, prim_id);
      uint word_14[VECTOR_WIDTH];
      float word_15[VECTOR_WIDTH];
#if FILTERED
      ErrorBounds errors;
      TriangleSetup setup =
          setup_triangles_settled(triangles, view, view.direction_reach, prim_id, facing_signs, &errors);
      loose = in_view & !is_tame(triangles, setup, errors, view, grid, doubt);
      const uint_v back = setup.volume > 0.0f ? (uint_v)(0) : (uint_v)(0x80000000u);
      STORE_V(AS_UINT_V(errors.edge) | back, word_14);
      widen_record(&setup, errors, view, low, high, word_15);
#else
      const TriangleSetup setup = setup_triangles_at(triangles, view);
      const ErrorBounds errors = bound_errors(triangles, setup.volume, view, view.direction_reach);
      loose = in_view & (is_tame(triangles, setup, errors, view, grid, doubt) == 0);
      STORE_V(AS_UINT_V(setup.edge[0].exclusive | setup.edge[1].exclusive << 1 | setup.edge[2].exclusive << 2), word_14);
      STORE_V((float_v)(0.0f), word_15);
#endif
      // What has no volume covers nothing.
      loose &= setup.valid;
      in_view &= setup.valid;
      store_records(setup, word_14, word_15, k, in_view, records);
#if COUNTERS
      work[WORK_COUNTER_COUNT * (size_t)get_global_id(0)] += count_lanes(in_view);
#endif
    }
    const int_v taken = in_view & !loose;
    uint in_grid[2][VECTOR_WIDTH];
    STORE_V(taken ? low : (uint_v)(0), in_grid[0]);
    STORE_V(taken ? high : (uint_v)(0), in_grid[1]);
    for (uint lane = 0; lane < min((uint)VECTOR_WIDTH, triangle_count - k); ++lane) {
      global uint *record = records + (size_t)RECORD_WORDS * (k + lane);
      record[12] = in_grid[0][lane];
      record[13] = in_grid[1][lane];
    }
    STORE_V(loose ? low : (uint_v)(0), loose_low + k);
    STORE_V(loose ? high : (uint_v)(0), loose_high + k);
    loose_count += popcount(LANE_MASK(loose));
  }
  loose_counts[get_global_id(0)] = loose_count;
}
