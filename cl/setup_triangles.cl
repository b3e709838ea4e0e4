// Finds each triangle's canonical conservative screen bound, empty where no sample can see it.
//
// DESIGN section 1: a sample counts only inside this bound, in every method. Davidovic et al., '3D
// Rasterization', section 3.2: no projection is needed to decide a sample; here vertices are projected
// only to bound where samples may lie, and a triangle that crosses the eye's plane is never clipped:
// the image's rectangle is clipped by its three edge functions instead (in 2D, in floats, for a bound).
//   for 16 triangles at a time:
//     r = p - eye; depth, X, Y by the inverse of (dx, dy, d)
//     in front: box of the three (X, Y), widened by the rounding error
//     crossing: box of the image's rectangle clipped by V_0, V_1, V_2
// Good at: many small triangles (no record of 3D setup leaves the registers). Bad at: nothing known.
//
// How far a bound must be widened. With F pixels per unit of tangent, a projected coordinate X has
// numerator and denominator errors of a few 2^-24 of |r|, hence an error in pixels of a few 2^-24 of
// (F + |X|) |r| / depth, and |r| / depth <= 1 + (|X| + |Y|) / F. An edge function misplaces its edge by
// a few 2^-24 F (1 + (X^2 + Y^2) / F^2): the neighbour that is given a sample so must have it in its bound.
// Both are under BOUND_SLACK (F + |X| + |Y|)^2 / F. Orthographic views take F = (largest distance) / pixel size.
// Tests: tests/test_rasterizer.py (bounds contain every sample that the exact reference covers).

#include "vector.clh"
#include "counters.clh"
#include "edge_function.clh"
#if !PLANAR
#include "curved_bounds.clh"
#endif

#define CORNER_CAPACITY 8

// Pixels that a snapped vertex, or a line through snapped points, may lie beside its own place: twice half a subpixel.
#if FIXED
#define SNAP_SLACK (1.0f / SUBPIXELS)
#else
#define SNAP_SLACK 0.0f
#endif

#if PLANAR
// The three edge functions of one lane, as scalars.
typedef struct { float c[3], gx[3], gy[3]; } LaneEdges;

// Clips the image's rectangle by the edges; returns false where nothing is left, else min and max X, Y.
// Each half-plane is moved outwards by the forward error of the edge's evaluation.
static bool clip_screen_bound(LaneEdges edges, float half_width, float half_height, float4 *bound) {
  float x[CORNER_CAPACITY] = {-half_width, half_width, half_width, -half_width};
  float y[CORNER_CAPACITY] = {-half_height, -half_height, half_height, half_height};
  int corner_count = 4;
  for (int i = 0; i < 3; ++i) {
    const float slack =
        EDGE_SLACK * (fabs(edges.c[i]) + half_width * fabs(edges.gx[i]) + half_height * fabs(edges.gy[i])) +
        SNAP_SLACK * (fabs(edges.gx[i]) + fabs(edges.gy[i]));
    float new_x[CORNER_CAPACITY], new_y[CORNER_CAPACITY];
    int new_count = 0;
    for (int k = 0; k < corner_count; ++k) {
      const int next = k + 1 < corner_count ? k + 1 : 0;
      const float v = (edges.c[i] + x[k] * edges.gx[i]) + y[k] * edges.gy[i] + slack;
      const float v_next = (edges.c[i] + x[next] * edges.gx[i]) + y[next] * edges.gy[i] + slack;
      if (v >= 0.0f && new_count < CORNER_CAPACITY) {
        new_x[new_count] = x[k];
        new_y[new_count++] = y[k];
      }
      if ((v >= 0.0f) != (v_next >= 0.0f) && new_count < CORNER_CAPACITY) {
        const float s = v / (v - v_next);
        new_x[new_count] = x[k] + s * (x[next] - x[k]);
        new_y[new_count++] = y[k] + s * (y[next] - y[k]);
      }
    }
    corner_count = new_count;
    for (int k = 0; k < corner_count; ++k) { x[k] = new_x[k]; y[k] = new_y[k]; }
  }
  if (corner_count == 0) return false;
  float4 box = (float4)(x[0], y[0], x[0], y[0]);
  for (int k = 1; k < corner_count; ++k)
    box = (float4)(min(box.x, x[k]), min(box.y, y[k]), max(box.z, x[k]), max(box.w, y[k]));
  // Half a pixel covers the rounding of the corners' positions.
  *bound = box + (float4)(-0.5f, -0.5f, 0.5f, 0.5f);
  return true;
}

#endif

// First and one past the last column with samples in [low, high], clamped to [0, size]; `sample` is the last place in
// a pixel that has one for the first column, and the first place for the last.
INLINE int_v first_sample(float_v low, float center, float sample, uint size) {
  const float_v first = ceil(low + (center - sample));
  return TO_INT_V(min(max(first, 0.0f), (float)size));
}

INLINE int_v end_sample(float_v high, float center, float sample, uint size) {
  const float_v last = floor(high + (center - sample)) + 1.0f;
  return TO_INT_V(min(max(last, 0.0f), (float)size));
}

#if PLANAR
// Where a vertex lies: X and Y from the image's centre in pixels, depth along the view axis.
typedef struct { float_v x, y, depth; int_v crossing, behind; } ScreenPoint;

INLINE ScreenPoint project_point(Vec3 p, View view) {
  Vec3 r = subtract(p, broadcast(view.origin));
#if PROJECTION == PROJECTION_ORTHOGRAPHIC
  r = subtract(r, broadcast(view.origin_low));
#endif
  ScreenPoint point;
  point.x = dot3s(r, view.inverse_x);
  point.y = dot3s(r, view.inverse_y);
  point.depth = dot3s(r, view.inverse_w);
  const float_v margin = (fabs(r.x) + fabs(r.y) + fabs(r.z)) * CROSSING_RATIO;
#if PROJECTION == PROJECTION_ORTHOGRAPHIC
  // Affine: a vertex behind the origin's plane projects as well as any other.
  point.crossing = (int_v)(0);
#else
  const float_v nearness = 1.0f / point.depth;
  point.x *= nearness;
  point.y *= nearness;
#if FILTERED
  point.crossing = !(point.depth > margin + LENGTH_FLOOR);  // products of what is smaller may underflow
#else
  point.crossing = !(point.depth > margin);
#endif
#endif
  point.behind = point.depth < -margin;
  return point;
}

// Bounds of the lanes whose triangle crosses the eye's plane, from its edge functions.
INLINE void bound_crossing_lanes(
    const int *crossing,  // [VECTOR_WIDTH]
    TriangleSetup setup,
    View view,
    uint *low,            // [VECTOR_WIDTH] in and out: x0 | y0 << 16
    uint *high)           // [VECTOR_WIDTH] in and out: x1 | y1 << 16
{
  float coefficient[9][VECTOR_WIDTH];
  int valid[VECTOR_WIDTH];
  for (uint i = 0; i < 3; ++i) {
    STORE_V(setup.edge[i].c, coefficient[3 * i]);
    STORE_V(setup.edge[i].gx, coefficient[3 * i + 1]);
    STORE_V(setup.edge[i].gy, coefficient[3 * i + 2]);
  }
  STORE_V(setup.valid, valid);
  for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) {
    if (!crossing[lane]) continue;
    LaneEdges edges;
    for (uint i = 0; i < 3; ++i) {
      edges.c[i] = coefficient[3 * i][lane];
      edges.gx[i] = coefficient[3 * i + 1][lane];
      edges.gy[i] = coefficient[3 * i + 2][lane];
    }
    low[lane] = high[lane] = 0;
    float4 bound;
#if FIXED
    // Without a volume a snapped triangle may still have an area.
    if (!valid[lane]) bound = (float4)(-view.center_x, -view.center_y, view.center_x, view.center_y);
    else
#else
    if (!valid[lane]) continue;
#endif
    if (!clip_screen_bound(edges, view.center_x, view.center_y, &bound)) continue;
    const int x0 = clamp((int)ceil(bound.x + (view.center_x - view.samples_right)), 0, (int)view.width);
    const int y0 = clamp((int)ceil(bound.y + (view.center_y - view.samples_bottom)), 0, (int)view.height);
    const int x1 = clamp((int)floor(bound.z + (view.center_x - view.samples_left)) + 1, 0, (int)view.width);
    const int y1 = clamp((int)floor(bound.w + (view.center_y - view.samples_top)) + 1, 0, (int)view.height);
    low[lane] = x0 | y0 << 16;
    high[lane] = x1 | y1 << 16;
  }
}
#endif

#if FILTERED
// Lists the lanes of `unsure` that a sample may see: settle_facing finds their signs.
static void list_unsure_facings(int_v unsure, uint_v high, uint first, uint slot_count, global uint *restrict state,
                                global uint *restrict slots) {
  int wanted[VECTOR_WIDTH];
  STORE_V(unsure & (high != 0), wanted);
  for (uint lane = 0; lane < VECTOR_WIDTH; ++lane)
    if (wanted[lane] && first + lane < slot_count) slots[atomic_inc(state + CONTENDER_FACINGS)] = first + lane;
}
#endif

#if NODE_BOUNDS
// The greatest nearness that a lane's triangle reaches at a sample of its bound: exact, by monotonicity.
INLINE float_v nearest_in_bound(TriangleSetup setup, View view, uint_v low, uint_v high) {
  const float_v x0 = TO_FLOAT_V(AS_INT_V(low & 0xffffu)) + (view.samples_left - view.center_x);
  const float_v y0 = TO_FLOAT_V(AS_INT_V(low >> 16)) + (view.samples_top - view.center_y);
  const float_v x1 = TO_FLOAT_V(AS_INT_V(high & 0xffffu)) + (view.samples_right - 1.0f - view.center_x);
  const float_v y1 = TO_FLOAT_V(AS_INT_V(high >> 16)) + (view.samples_bottom - 1.0f - view.center_y);
  const float_v most =
      block_highest(setup.nearness.c, setup.nearness.x, setup.nearness.y, BLOCK_RANGE(view, x0, y0, x1, y1));
#if FIXED
  return clamp_nearness(most, setup.least, setup.most);
#else
  return most;
#endif
}
#endif

// Reads: corners (prepare_triangles). Writes: bounds (for bin_triangles.cl, refit_nodes.cl, traverse_frusta.cl).
// Work item: one chunk of triangles. Local memory: 0 bytes.
kernel void setup_triangles(
    View view,                                // camera and image
    uint triangle_count,
    uint chunk_size,                          // triangles a chunk, a multiple of VECTOR_WIDTH
    global const float4 *restrict corners,    // [3 * triangle_count]
#if COUNTERS
    global ulong *restrict work,              // [chunks * WORK_COUNTER_COUNT] added to
#endif
#if NODE_BOUNDS
    global float *restrict nearest,           // [padded triangle_count] greatest nearness of any sample in the bound
#endif
#if FILTERED
    global uint *restrict contender_state,    // [CONTENDER_WORDS] counts the facings
    global uint *restrict unsure_slots,       // [triangle_count] slots whose facing float32 cannot tell
#endif
    global uint *restrict bounds_low,         // [padded triangle_count] x0 | y0 << 16, first column and row
    global uint *restrict bounds_high)        // [padded triangle_count] x1 | y1 << 16, one past the last
{
  const uint begin = get_global_id(0) * chunk_size;
  const uint end = min(begin + chunk_size, triangle_count);
  for (uint k = begin; k < end; k += VECTOR_WIDTH) {
    uint prim_id[VECTOR_WIDTH];  // lanes past the last triangle repeat it
#pragma unroll
    for (uint lane = 0; lane < VECTOR_WIDTH; ++lane) prim_id[lane] = min(k + lane, triangle_count - 1);
    const Triangles triangles = gather_triangles(corners, prim_id);
#if PLANAR
    const ScreenPoint a = project_point(triangles.p0, view);
    const ScreenPoint b = project_point(triangles.p1, view);
    const ScreenPoint c = project_point(triangles.p2, view);

    // In front of the eye: the box of three points, widened.
    const float_v x_low = min(a.x, min(b.x, c.x)), x_high = max(a.x, max(b.x, c.x));
    const float_v y_low = min(a.y, min(b.y, c.y)), y_high = max(a.y, max(b.y, c.y));
    const float_v reach = max(max(-x_low, x_high), 0.0f) + max(max(-y_low, y_high), 0.0f) + view.focal;
#if FILTERED
    // Conservative without an exception: for the sums with the image's centre as well.
    const float_v slack = reach * reach * (2.0f * BOUND_SLACK / view.focal) + BOUND_SLACK * (view.center_x + view.center_y);
#else
    const float_v slack = reach * reach * (BOUND_SLACK / view.focal) + SNAP_SLACK;
#endif
    int_v x0 = first_sample(x_low - slack, view.center_x, view.samples_right, view.width);
    int_v y0 = first_sample(y_low - slack, view.center_y, view.samples_bottom, view.height);
    int_v x1 = end_sample(x_high + slack, view.center_x, view.samples_left, view.width);
    int_v y1 = end_sample(y_high + slack, view.center_y, view.samples_top, view.height);
#if FILTERED
    const int_v unbounded = !(slack < 1.0e9f);
    x0 = unbounded ? (int_v)(0) : x0;
    y0 = unbounded ? (int_v)(0) : y0;
    x1 = unbounded ? (int_v)((int)view.width) : x1;
    y1 = unbounded ? (int_v)((int)view.height) : y1;
#endif
    const int_v behind = a.behind & b.behind & c.behind;
#else
    Cone cone;
    const CurvedBox box = box_of_triangles(triangles, setup_triangles_3d(triangles, view), view, &cone);
    const int_v x0 = first_sample(box.x0, view.center_x, view.samples_right, view.width);
    const int_v y0 = first_sample(box.y0, view.center_y, view.samples_bottom, view.height);
    const int_v x1 = end_sample(box.x1, view.center_x, view.samples_left, view.width);
    const int_v y1 = end_sample(box.y1, view.center_y, view.samples_top, view.height);
    const int_v behind = box.gone;
#endif
    // Lanes past the last triangle, like triangles behind the eye and empty boxes, get the bound 0, 0.
    const int_v dropped = behind | (x0 >= x1) | (y0 >= y1) | (LANES >= (int)(triangle_count - k));
    const uint_v low = AS_UINT_V(dropped ? (int_v)(0) : x0 | y0 << 16);
    const uint_v high = AS_UINT_V(dropped ? (int_v)(0) : x1 | y1 << 16);
    STORE_V(low, bounds_low + k);
    STORE_V(high, bounds_high + k);
#if PROJECTION != PROJECTION_ORTHOGRAPHIC
#if PLANAR
    const int_v crossing = (a.crossing | b.crossing | c.crossing) & !behind & (LANES < (int)(triangle_count - k));
#else
    const int_v crossing = box.hard & !box.gone & (LANES < (int)(triangle_count - k));
#endif
    if (ANY_LANE(crossing)) {
      int lane_crossing[VECTOR_WIDTH];
      uint lane_low[VECTOR_WIDTH], lane_high[VECTOR_WIDTH];
      STORE_V(crossing, lane_crossing);
      STORE_V(low, lane_low);
      STORE_V(high, lane_high);
#if FILTERED
      const TriangleSetup edges = setup_triangles_outwards(triangles, view);
#else
      const TriangleSetup edges = setup_triangles_3d(triangles, view);
#endif
#if PLANAR
      bound_crossing_lanes(lane_crossing, edges, view, lane_low, lane_high);
#else
      bound_hard_lanes(lane_crossing, edges, cone, view, lane_low, lane_high);
#endif
      STORE_V(LOAD_V(lane_low), bounds_low + k);
      STORE_V(LOAD_V(lane_high), bounds_high + k);
#if COUNTERS
      work[WORK_COUNTER_COUNT * (size_t)get_global_id(0)] += count_lanes(crossing);
#endif
    }
#endif
#if FILTERED
    const ErrorBounds errors = bound_errors(triangles, volume_of(triangles, view), view, view.direction_reach);
    if (has_lane(errors.facing_unsure))
      list_unsure_facings(errors.facing_unsure, LOAD_V(bounds_high + k), k, triangle_count, contender_state, unsure_slots);
#endif
#if NODE_BOUNDS
    const TriangleSetup setup = setup_triangles_at(triangles, view);
    float_v most = nearest_in_bound(setup, view, LOAD_V(bounds_low + k), LOAD_V(bounds_high + k));
#if FILTERED
    NearnessPlane plane = setup.nearness;
    float span[VECTOR_WIDTH];
    most = widen_nearness(&plane, errors, most, view.center_x, view.center_y, span);
    most = most == most ? most : (float_v)(INFINITY);
#endif
    STORE_V(most, nearest + k);
#endif
  }
}
