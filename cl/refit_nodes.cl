// Gives each child of each node of the BVH its screen bound and its greatest nearness, for one view.
//
// DESIGN section 1: every oracle keeps every (triangle, sample) pair inside the triangle's canonical screen bound.
// Bounds of nodes are unions of those of their triangles, so that tests of nodes need no slack, also where
// triangles cross the eye's plane. Levels from the deepest to the root, a launch each; the tree itself does
// not depend on the view. Good at: exactness, a test of 16 children in a few operations. Bad at: scenes
// of which a view sees little (every triangle is bounded in every frame). Tests: tests/test_continuum.py.

#include "vector.clh"

// The union of what was met so far.
typedef struct { int_v x0, y0, x1, y1; float_v nearest; } Union;

INLINE void join(Union *all, uint_v low, uint_v high, float_v nearest, int_v used) {
  used &= high != 0;  // 0: a triangle that no sample can see
  all->x0 = min(all->x0, used ? AS_INT_V(low & 0xffffu) : (int_v)(0xffff));
  all->y0 = min(all->y0, used ? AS_INT_V(low >> 16) : (int_v)(0xffff));
  all->x1 = max(all->x1, used ? AS_INT_V(high & 0xffffu) : (int_v)(0));
  all->y1 = max(all->y1, used ? AS_INT_V(high >> 16) : (int_v)(0));
  // NaN is no hit anywhere in the bound, and leaves what is there.
  all->nearest = used & (nearest > all->nearest) ? nearest : all->nearest;
}

// Reads: bounds, nearest (setup_triangles), bounds of deeper levels. Writes: node_low, node_high, node_nearest
// (for traverse_frusta). Work item: one child of a node. Local memory: 0 bytes.
kernel void refit_nodes(
    uint first_node,                          // of the level
    uint node_count,                          // of the level
    global const uint *restrict children,     // [nodes * NODE_WIDTH] node, or LEAF_BIT | first slot, or EMPTY_CHILD
    global const uint *restrict slot_counts,  // [nodes * NODE_WIDTH] triangles of a leaf
    global const uint *restrict bounds_low,   // [padded triangle_count] x0 | y0 << 16, in the order of slots
    global const uint *restrict bounds_high,  // [padded triangle_count]
    global const float *restrict nearest,     // [padded triangle_count] greatest nearness in the bound
    global uint *node_low,                    // [nodes * NODE_WIDTH]
    global uint *node_high,                   // [nodes * NODE_WIDTH]
    global float *node_nearest)               // [nodes * NODE_WIDTH]
{
  if (get_global_id(0) >= node_count * NODE_WIDTH) return;
  const uint own = first_node * NODE_WIDTH + get_global_id(0);
  const uint child = children[own];
  node_low[own] = node_high[own] = 0;
  node_nearest[own] = -INFINITY;
  if (child == EMPTY_CHILD) return;
  Union all = {(int_v)(0xffff), (int_v)(0xffff), (int_v)(0), (int_v)(0), (float_v)(-INFINITY)};
  if (child & LEAF_BIT) {
    const uint first = child & ~LEAF_BIT, count = slot_counts[own];
    for (uint k = 0; k < count; k += VECTOR_WIDTH)
      join(&all, LOAD_V(bounds_low + first + k), LOAD_V(bounds_high + first + k), LOAD_V(nearest + first + k),
           LANES < (int)(count - k));
  } else {
    const size_t first = (size_t)child * NODE_WIDTH;
    for (uint k = 0; k < NODE_WIDTH; k += VECTOR_WIDTH)
      join(&all, LOAD_V(node_low + first + k), LOAD_V(node_high + first + k), LOAD_V(node_nearest + first + k),
           LANES < (int)(NODE_WIDTH - k));
  }
  const int x1 = -LOWEST_INT_V(-all.x1), y1 = -LOWEST_INT_V(-all.y1);
  if (x1 == 0) return;
  node_low[own] = LOWEST_INT_V(all.x0) | LOWEST_INT_V(all.y0) << 16;
  node_high[own] = x1 | y1 << 16;
  node_nearest[own] = -LOWEST_V(-all.nearest);
}
