// Moves subtrees of a binary tree of boxes to where they make the boxes above them smallest.
//
// Bittner, Hapala, Havran, 'Fast Insertion-Based Optimization of Bounding Volume Hierarchies', 2013; the search that
// goes up from where the subtree hangs, and finds the best place, is that of Meister, Bittner, 'Parallel Reinsertion
// for Bounding Volume Hierarchy Optimization', 2018. For each subtree in turn, the largest first:
//   take it out, with its parent, of which the sibling takes the place: all boxes above may shrink
//   for each node on the way to the root: look into the subtree beside it, as long as more could be gained there
//   put it beside the node where the sum of all areas becomes least
// One work item moves all, as each has to see where the others went: two thirds of the moves that are found at once for
// the same tree are in each other's way. Good at: long and overlapping boxes. Bad at: devices of many slow work items.
// Only +, -, *, min and max: the tree is the same everywhere. Tests: tests/test_bvh_reinsertion.py.

#pragma OPENCL FP_CONTRACT OFF

#define NOWHERE 0xffffffffu

typedef struct {
  global TreeNode *nodes;  // [2 * triangle_count - 1] triangles first
  global uint *waiting;    // [triangle_count] nodes whose children are still to be looked at
  global float *prospects; // [triangle_count] what is gained there by a place of no area
  uint triangle_count;
  uint budget;             // nodes that may still be looked at
  uint few;                // triangles of a leaf
  float light;             // what nodes of so few cost, others 1
} Tree;

// A box is a float8: min x, y, z, then max x, y, z negated, so that boxes join by minima; s3 and s7 are of no meaning.
static float8 box_of(const Tree *tree, uint id) { return vload8(0, tree->nodes[id].low); }

// Half the surface.
static float area_of(float8 box) {
  const float4 side = box.lo + box.hi;  // negated: products of two have the right sign
  return (side.x + side.y) * side.z + side.x * side.y;
}

// What a box of `count` triangles costs. In a leaf of the final tree, which takes so few, inner nodes save little.
static float cost_of(const Tree *tree, float8 box, uint count) {
  const float area = area_of(box);
  return count <= tree->few ? area * tree->light : area;
}

static uint sibling_of(const Tree *tree, uint id) {
  global const TreeNode *parent = tree->nodes + tree->nodes[id].parent;
  return parent->left == id ? parent->right : parent->left;
}

// A place beside a node, and by how much the sum of areas sinks there.
typedef struct { float gain; uint beside; } Place;

// The subtree that is moved.
typedef struct { float8 box; float least; uint count; } Moved;  // least: what it costs anywhere

// Looks beside `id`; returns what is gained below it by a place of no area. saved: by taking the subtree out, and by
// boxes that grow on the way to `id`.
static float look_beside(Tree *tree, const Moved *moved, uint id, float saved, Place *best) {
  const float8 box = box_of(tree, id);
  const uint count = tree->nodes[id].count;
  const float gain = saved - cost_of(tree, min(box, moved->box), count + moved->count);
  if (gain > best->gain) {
    best->gain = gain;
    best->beside = id;
  }
  return gain + cost_of(tree, box, count);
}

static bool is_promising(const Tree *tree, const Moved *moved, uint id, float prospect, const Place *best) {
  return id >= tree->triangle_count && prospect - moved->least > best->gain;
}

// Looks below `id`, where the nearer child comes first.
static void look_below(Tree *tree, const Moved *moved, uint id, float prospect, Place *best) {
  uint count = 0;
  while (true) {
    if (is_promising(tree, moved, id, prospect, best)) {
      const uint left = tree->nodes[id].left, right = tree->nodes[id].right;
      const float of_left = look_beside(tree, moved, left, prospect, best);
      const float of_right = look_beside(tree, moved, right, prospect, best);
      tree->budget -= min(tree->budget, 2u);
      const bool is_left = of_left >= of_right;
      const uint later = is_left ? right : left;
      const float of_later = is_left ? of_right : of_left;
      if (is_promising(tree, moved, later, of_later, best)) {
        tree->waiting[count] = later;
        tree->prospects[count++] = of_later;
      }
      id = is_left ? left : right;
      prospect = is_left ? of_left : of_right;
    } else if (count != 0) {
      id = tree->waiting[--count];
      prospect = tree->prospects[count];
    } else {
      return;
    }
    if (tree->budget == 0) return;
  }
}

// By a pointer: Oclgrind 21.10 does not know what LLVM notes of structures that functions return.
static void find_place(Tree *tree, uint id, Place *best) {
  const float8 box = box_of(tree, id);
  const uint count = tree->nodes[id].count;
  const Moved moved = {box, cost_of(tree, box, count + 1), count};
  best->gain = 0.0f;
  best->beside = NOWHERE;
  uint above = tree->nodes[id].parent, beside = sibling_of(tree, id);
  float8 rest = box_of(tree, beside);  // of what is left below `above`
  uint left = tree->nodes[beside].count;
  float saved = cost_of(tree, box_of(tree, above), left + count);
  // Beside its sibling it is now.
  look_below(tree, &moved, beside, cost_of(tree, rest, left), best);
  while (tree->nodes[above].parent != NOWHERE && tree->budget != 0) {
    beside = sibling_of(tree, above);
    above = tree->nodes[above].parent;
    look_below(tree, &moved, beside, look_beside(tree, &moved, beside, saved, best), best);
    rest = min(rest, box_of(tree, beside));
    left += tree->nodes[beside].count;
    saved += cost_of(tree, box_of(tree, above), left + count) - cost_of(tree, rest, left);
    const float gain = saved - cost_of(tree, min(rest, box), left + count);
    if (gain > best->gain) {
      best->gain = gain;
      best->beside = above;
    }
    tree->budget -= min(tree->budget, 2u);
  }
}

// Fits an inner node to its children; returns whether it changes.
static bool fit_node(Tree *tree, uint id) {
  global TreeNode *node = tree->nodes + id;
  const float8 old = box_of(tree, id);
  const float8 box = min(box_of(tree, node->left), box_of(tree, node->right));
  const uint count = tree->nodes[node->left].count + tree->nodes[node->right].count;
  const bool same = all((old.s012 == box.s012) & (old.s456 == box.s456)) && node->count == count;
  vstore3(box.s012, 0, node->low);
  vstore3(box.s456, 0, node->high);
  node->count = count;
  return !same;
}

static void fit_above(Tree *tree, uint id) {
  for (; id != NOWHERE && fit_node(tree, id); id = tree->nodes[id].parent) tree->budget -= min(tree->budget, 1u);
}

// Puts `id` in the place of a child of `above`, or at the root.
static void hang(Tree *tree, uint above, uint child, uint id) {
  tree->nodes[id].parent = above;
  if (above == NOWHERE) return;
  global TreeNode *node = tree->nodes + above;
  if (node->left == child) node->left = id;
  else node->right = id;
}

// Moves a subtree beside another node that it does not hold; its parent goes with it.
static void move_subtree(Tree *tree, uint id, uint beside) {
  const uint parent = tree->nodes[id].parent, above = tree->nodes[parent].parent;
  hang(tree, above, parent, sibling_of(tree, id));
  fit_above(tree, above);
  hang(tree, tree->nodes[beside].parent, beside, parent);
  tree->nodes[parent].left = beside;
  tree->nodes[parent].right = id;
  tree->nodes[beside].parent = parent;
  fit_node(tree, parent);
  fit_above(tree, tree->nodes[parent].parent);
}

// Reads: nodes (host). Writes: boxes and counts of inner nodes, parents. Work item: all nodes. Local memory: 0 bytes.
kernel void fit_tree(
    uint triangle_count,
    global TreeNode *nodes)              // [2 * triangle_count - 1] children before parents, the root last
{
  Tree tree = {nodes, 0, 0, triangle_count, 0, 0, 0.0f};
  for (uint id = triangle_count; id < 2 * triangle_count - 1; ++id) {
    fit_node(&tree, id);
    nodes[nodes[id].left].parent = nodes[nodes[id].right].parent = id;
  }
  nodes[2 * triangle_count - 2].parent = NOWHERE;
}

// Reads: movable (host). Writes: nodes (for the host). Work item: all subtrees. Local memory: 0 bytes.
kernel void reinsert_subtrees(
    uint triangle_count,
    uint movable_count,
    uint budget,                         // nodes that are looked at, at most (and those of the last step)
    uint few,                            // triangles of a leaf
    float light,                         // what a node of so few costs
    global const uint *restrict movable, // [movable_count] ids of the subtrees that are moved, in turn
    global TreeNode *nodes,              // [2 * triangle_count - 1] triangles, then inner nodes
    global uint *waiting,                // [triangle_count] scratch
    global float *prospects)             // [triangle_count] scratch
{
  Tree tree = {nodes, waiting, prospects, triangle_count, budget, few, light};
  for (uint k = 0; k < movable_count && tree.budget != 0; ++k) {
    if (nodes[movable[k]].parent == NOWHERE) continue;
    Place place;
    find_place(&tree, movable[k], &place);
    if (place.beside != NOWHERE) move_subtree(&tree, movable[k], place.beside);
  }
}
