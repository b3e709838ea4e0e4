// The continuum between rasterization and ray casting: frusta of samples meet nodes of a BVH.
//
// Davidovic et al., '3D Rasterization', section 4, Fig. 7, with an explicit stack and front-to-back order. One
// work item is one root frustum, a square of 2^TILE_LOG2 samples a side; a method is its choice of oracles
// (oracles.clh) and of that side: from the loop over triangles round a loop over samples (a rasterizer) to the
// loop over samples round a loop over triangles (a ray caster, Durand section 3) it is this one kernel.
//   push (F, root); until the stack is empty, pop (F, N):
//     is_occluded or is_outside: drop it
//     split_frustum: push (Fi, N) for the four quarters Fi of F
//     generate_samples (N is a leaf, or the whole scene): rasterize N's triangles in F, with binning or without
//     else: push (F, child of N), the nearest last
// Good at: occlusion, views of a part of a scene. Bad at: few work items; its root frusta are its parallelism.
// Tests: tests/test_continuum.py.

#include "vector.clh"
#include "counters.clh"
#include "edge_function.clh"
#if ALPHA_MASK
#include "surface.clh"
#endif
#define LISTS_IN_ORDER 0
#include "triangle_batch.clh"
#include "sample_blocks.clh"
#include "sample_memory.clh"
#include "oracles.clh"
#include "w_pyramid.clh"
#include "slot_queue.clh"

#if RESUMABLE
#define STACK_SPACE global
#define COUNTED_BLOCKS (COUNTERS * TILE_BLOCKS)  // loops of counting
// Upper bounds: of a pop, its expansion and its pushes; of clearing, loading and storing the samples, and the root.
#define ITERATIONS_OF_STEP (64 + NODE_WIDTH * NODE_WIDTH + COUNTED_BLOCKS)
#define RESERVED_ITERATIONS (8 * TILE_SIZE * TILE_SIZE + 3 * COUNTED_BLOCKS)
#else
#define STACK_SPACE private
#endif

INLINE ulong pack_entry(uint slot, Frustum f) {
  return (ulong)slot << 32 | (ulong)(f.size_log2 << 24 | f.y << 12 | f.x);
}

INLINE Frustum unpack_frustum(ulong entry) {
  const Frustum f = {(int)(entry & 0xfff), (int)(entry >> 12 & 0xfff), (int)(entry >> 24 & 0xff)};
  return f;
}

#if COUNTERS
// `tested` tests of nodes by a frustum, for the samples that it holds.
INLINE void count_steps(TileSamples *samples, Frustum f, uint tested) {
  samples->work.traversal_steps += tested;
  for (int y = f.y; y < f.y + (1 << f.size_log2); y += BLOCK_ROWS)
    for (int x = f.x; x < f.x + (1 << f.size_log2); x += BLOCK_COLUMNS)
      samples->steps[y / BLOCK_ROWS * TILE_BLOCK_COLUMNS + x / BLOCK_COLUMNS] += tested;
}
#endif

// Pushes the children of a node that the oracles keep, the nearest last. Returns the new top.
INLINE uint push_children(Scene *s, uint node, Frustum f, float lowest, STACK_SPACE ulong *stack, uint top,
                          TileSamples *samples) {
  ulong keys[NODE_WIDTH];  // nearness in an order of unsigned integers, then the child
  uint count = 0;
#if COUNTERS
  uint tested = 0;
#endif
  for (uint k = 0; k < NODE_WIDTH; k += VECTOR_WIDTH) {
    const size_t first = (size_t)node * NODE_WIDTH + k;
    const int_v low = AS_INT_V(LOAD_V(s->node_low + first)), high = AS_INT_V(LOAD_V(s->node_high + first));
    const float_v nearest = LOAD_V(s->node_nearest + first);
    int_v keep = high != 0;
    keep &= MAY_BE_INSIDE(f, (low & 0xffff) - s->left, (low >> 16 & 0xffff) - s->top, (high & 0xffff) - s->left,
                          (high >> 16 & 0xffff) - s->top);
    keep &= MAY_BE_VISIBLE(nearest, lowest);
#if COUNTERS
    const uint here = count_lanes(LOAD_V(s->children + first) != (uint_v)(EMPTY_CHILD));
    tested += here;
    COUNT(samples, nodes_culled, here - count_lanes(keep));
#endif
    float lane_nearest[VECTOR_WIDTH];
    STORE_V(nearest, lane_nearest);
    for (ulong mask = LANE_MASK(keep); mask != 0; mask &= mask - 1) {
      const int lane = first_lane(mask);
      const uint bits = as_uint(lane_nearest[lane]);
      const uint ordered = bits & 0x80000000u ? ~bits : bits | 0x80000000u;
      const ulong key = (ulong)ordered << 32 | (uint)(k + lane);
      uint place = count++;
      for (; place > 0 && keys[place - 1] > key; --place) keys[place] = keys[place - 1];
      keys[place] = key;
    }
  }
#if COUNTERS
  count_steps(samples, f, tested);
#endif
  for (uint i = 0; i < count; ++i) stack[top++] = pack_entry(node * NODE_WIDTH + (uint)(keys[i] & 0xffffffff), f);
  return top;
}

INLINE ScreenBound bound_of(const Scene *s, uint slot) {
  const uint low = s->node_low[slot], high = s->node_high[slot];
  const ScreenBound b = {(int)(low & 0xffff) - s->left, (int)(low >> 16) - s->top, (int)(high & 0xffff) - s->left,
                         (int)(high >> 16) - s->top};
  return b;
}

// split_frustum: the quarters of a frustum that touch the node take its place. Returns the new top.
INLINE uint push_quarters(uint slot, Frustum f, ScreenBound b, STACK_SPACE ulong *stack, uint top) {
  const int side = 1 << (f.size_log2 - 1);
  for (int quarter = 0; quarter < 4; ++quarter) {
    const Frustum q = {f.x + (quarter & 1) * side, f.y + (quarter >> 1) * side, f.size_log2 - 1};
    if (MAY_BE_INSIDE(q, b.x0, b.y0, b.x1, b.y1)) stack[top++] = pack_entry(slot, q);
  }
  return top;
}

#if GENERATE_SAMPLES == GENERATE_SAMPLES_LEAF
// The recursion of Fig. 7 from what the stack holds on. Returns the top of the stack that is left: 0, or more where
// the launch may do no more; then `next_slot` says where the topmost entry's leaf goes on (0: at its first).
static uint traverse(Scene *s, STACK_SPACE ulong *stack, uint top, uint *next_slot, SlotQueue *queue,
                     TileSamples *samples, WPyramid *pyramid) {
  while (top > 0) {
    const ulong entry = stack[top - 1];
    const Frustum f = unpack_frustum(entry);
    const uint slot = (uint)(entry >> 32);
    const ScreenBound b = bound_of(s, slot);
    const float lowest = lowest_in(pyramid, f);
#if RESUMABLE
    s->budget -= ITERATIONS_OF_STEP;
    if (s->budget < 0) return top;
#endif
    if (!MAY_BE_VISIBLE(s->node_nearest[slot], lowest)) {
      COUNT(samples, nodes_culled, 1);
      *next_slot = 0;
      --top;
    } else if (split_frustum(f, b, s->small_ratio)) {
      COUNT(samples, frusta_split, 1);
      top = push_quarters(slot, f, b, stack, top - 1);
    } else if (!(s->children[slot] & LEAF_BIT)) {
      top = push_children(s, s->children[slot], f, lowest, stack, top - 1, samples);
    } else {
      const uint first = s->children[slot] & ~LEAF_BIT, end = first + s->slot_counts[slot];
      const uint next =
          generate_samples(s, *next_slot == 0 ? first : *next_slot, end, f, lowest, queue, samples, pyramid);
      *next_slot = next < end ? next : 0;
      if (next < end) return top;
      --top;
    }
  }
  return 0;
}
#endif

// Reads: corners (prepare_triangles), bounds, nearest (setup_triangles), node bounds (refit_nodes).
// Writes: visible_prims (for shade_hits). Work item: one root frustum. Local memory: 0 bytes.
kernel void traverse_frusta(
    View view,
    uint frustum_count,
    uint triangle_count,
    uint small_ratio,                            // split_frustum: frusta with more times the area of a node's bound
#if RESUMABLE
    uint iterations,                             // loop iterations that a work item may make in this launch
    global uint *restrict resume_points,         // [frustum_count * 2] height of the stack, next slot
    global ulong *restrict stacks,               // [frustum_count * STACK_CAPACITY]
#endif
#if KEEP_NEARNESS || RESUMABLE
    uint resume,                                 // 1: go on from nearness and visible_prims (and resume_points)
#endif
#if KEEP_NEARNESS
    uint layer,                                  // 0, or more: front_* say what lies in front
    global const float *restrict front_nearness, // [band height * width] of the layer in front
    global const uint *restrict front_prims,     // [band height * width] its prim_id or NO_HIT
    global float *restrict nearness,             // [band height * width]
#endif
#if ALPHA_MASK
    global const uint *restrict indices,         // [3 * triangle_count] vertices of the attributes
    global const uint *restrict material_ids,    // [triangle_count]
    global const Material *restrict materials,   // [material_count]
    global const Texture *restrict textures,     // [texture_count]
    global const uchar4 *restrict texels,        // of all textures
    global const float *restrict srgb_to_linear, // [512] see Surfaces
    global const float2 *restrict uv,            // [vertex_count]
    global const float2 *restrict uv1,           // [vertex_count]
    global const float4 *restrict colors,        // [vertex_count] linear
#endif
#if FILTERED
    uint contender_capacity,                     // entries of the list
    global uint *restrict contender_state,       // [CONTENDER_WORDS] first word: contenders found
    global uint2 *restrict contenders,           // [contender_capacity] pixel of the band, prim_id
    global const char *restrict facing_signs,    // [padded triangle_count] signs that float32 cannot tell, by slot
    global const float4 *restrict positions,     // [vertex_count] world space, as given
    global const uint *restrict prim_vertices,    // [3 * triangle_count] vertices
#endif
    global const float4 *restrict corners,       // [3 * triangle_count] canonical corners and normals, by slot
    global const uint *restrict prims,           // [triangle_count] prim_id of each slot
    global const uint *restrict bounds_low,      // [padded triangle_count] x0 | y0 << 16, by slot
    global const uint *restrict bounds_high,     // [padded triangle_count]
    global const float *restrict nearest,        // [padded triangle_count] greatest nearness in the bound
    global const uint *restrict children,        // [nodes * NODE_WIDTH] node, or LEAF_BIT | first slot, or EMPTY_CHILD
    global const uint *restrict slot_counts,     // [nodes * NODE_WIDTH] triangles of a leaf
    global const uint *restrict node_low,        // [nodes * NODE_WIDTH]
    global const uint *restrict node_high,       // [nodes * NODE_WIDTH]
    global const float *restrict node_nearest,   // [nodes * NODE_WIDTH]
#if COUNTERS
    uint pixel_count,                            // of the band
    global ulong *restrict work,                 // [frustum_count * WORK_COUNTER_COUNT] added to
    global uint *restrict cost,                  // [3 * pixel_count] evaluations, setups, steps of each sample, added to
#endif
    global uint *restrict visible_prims)         // [band height * width] prim_id or NO_HIT
{
  const uint item = get_global_id(0);
  if (item >= frustum_count) return;
  const int left = item % view.tile_columns << TILE_LOG2;
  const int top_row = (item / view.tile_columns << TILE_LOG2) + view.band_top;
  Scene s = {view, make_frame(view, left, top_row), left, top_row, (int)small_ratio, corners, prims, bounds_low,
             bounds_high, nearest, children, slot_counts, node_low, node_high, node_nearest, 0};
#if FILTERED
  s.frame.contender_capacity = contender_capacity;
  s.frame.contender_state = contender_state;
  s.frame.contenders = contenders;
  s.frame.corners = corners;
  s.frame.positions = positions;
  s.frame.prim_vertices = prim_vertices;
  s.facing_signs = facing_signs;
#endif
#if ALPHA_MASK
  const Surfaces surfaces = {material_ids, materials, textures, texels, srgb_to_linear, uv, uv1, colors};
  s.frame.surfaces = surfaces;
  s.frame.indices = indices;
#endif
  const Frustum whole = {0, 0, TILE_LOG2};
  uint top = 0, next_slot = 0;
#if RESUMABLE
  s.budget = (long)iterations - RESERVED_ITERATIONS;
  global ulong *stack = stacks + (size_t)item * STACK_CAPACITY;
  if (resume) {
    top = resume_points[2 * item];
    next_slot = resume_points[2 * item + 1];
    if (top == 0) return;
  }
#else
  ulong stack[STACK_CAPACITY];
#endif
  TileSamples samples;
#if KEEP_NEARNESS
  clear_samples(view, left, top_row, &samples, resume, layer, front_nearness, front_prims, nearness, visible_prims);
#else
  clear_samples(view, left, top_row, &samples);
#endif
  WPyramid pyramid;
  clear_pyramid(&pyramid);
  SlotQueue queue;
  queue.count = 0;
  for (uint row = 0; row < CELL_COLUMNS; ++row) queue.dirty.rows[row] = 0;
#if KEEP_NEARNESS && IS_OCCLUDED == IS_OCCLUDED_W_BUFFER
  mark_cells(&queue.dirty, 0, 0, TILE_SIZE, TILE_SIZE);
  update_pyramid(&pyramid, &samples, &queue.dirty);
#endif
#if GENERATE_SAMPLES == GENERATE_SAMPLES_ROOT
  next_slot = generate_samples(&s, next_slot, triangle_count, whole, -INFINITY, &queue, &samples, &pyramid);
  top = next_slot < triangle_count;
#else
  if (top == 0) top = push_children(&s, 0, whole, NEARNESS_OF_NOTHING, stack, 0, &samples);
  top = traverse(&s, stack, top, &next_slot, &queue, &samples, &pyramid);
#endif
  flush_queue(&s, &queue, &samples, &pyramid);
#if RESUMABLE
  resume_points[2 * item] = top;
  resume_points[2 * item + 1] = next_slot;
#endif
  store_tile(view, left, top_row, samples.visible, visible_prims);
#if FILTERED
  if (samples.asked) atomic_add(contender_state + CONTENDER_FLOAT64, samples.asked);
#endif
#if KEEP_NEARNESS
  store_nearness(view, left, top_row, samples.nearness, nearness);
#if FILTERED
  store_nearness(view, left, top_row, samples.upper_nearness, nearness + band_pixels(view));
#endif
#endif
#if COUNTERS
  store_work(view, left, top_row, &samples, item, work, cost, pixel_count);
#endif
}
