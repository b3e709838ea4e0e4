"""The hierarchy over triangles: every triangle reachable, boxes exact, cost small, closest hits as by brute force."""

from __future__ import annotations

import hashlib
import math
import subprocess
import sys
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from clrast.errors import CapacityError, SceneError, UsageError
from clrast.opencl.layout import EMPTY_CHILD, LEAF_BIT, NODE_WIDTH
from clrast.visibility import bvh as bvh_module
from clrast.visibility.bvh import Bvh, build_bvh
from clrast.visibility.bvh_collapse import LEAF_COST, NODE_COST, TRIANGLE_COST, BinaryTree

Mesh = tuple[np.ndarray, np.ndarray]


# --- meshes ----------------------------------------------------------------------------------------


def separate(corners: np.ndarray) -> Mesh:
    """Triangles without common vertices; corners : (triangle_count, 3, 3)."""
    positions = np.asarray(corners, dtype=np.float32).reshape(-1, 3)
    return positions, np.arange(len(positions), dtype=np.uint32).reshape(-1, 3)


def soup(count: int, seed: int = 1, size: float = 0.1) -> Mesh:
    """Triangles anywhere in the unit cube."""
    rng = np.random.default_rng(seed)
    return separate(rng.random((count, 1, 3)) + size * (rng.random((count, 3, 3)) - 0.5))


def clustered(count: int, seed: int = 2) -> Mesh:
    """Small objects of very different sizes in a large room, walls included: what a uniform order is bad at."""
    rng = np.random.default_rng(seed)
    center, scale = rng.uniform(-50, 50, (20, 3)), 10.0 ** rng.uniform(-2, 1, 20)
    which = rng.integers(0, 20, count)
    offset = rng.normal(size=(count, 1, 3)) + 0.1 * rng.normal(size=(count, 3, 3))
    corners = center[which][:, None] + scale[which][:, None, None] * offset
    wall = rng.integers(0, 3, count // 50)
    corners[: len(wall)] = rng.uniform(-60, 60, (len(wall), 3, 3))
    corners[np.arange(len(wall)), :, wall] = 60.0
    return separate(corners)


def heightfield(side: int, seed: int = 3) -> Mesh:
    """side * side squares of two triangles."""
    x, y = np.meshgrid(np.arange(side + 1), np.arange(side + 1), indexing="ij")
    z = 2 * np.sin(x / 5) + np.random.default_rng(seed).random(x.shape)
    corner = (x[:-1, :-1] * (side + 1) + y[:-1, :-1]).ravel()
    lower = np.stack([corner, corner + 1, corner + side + 1], axis=1)
    upper = np.stack([corner + side + 2, corner + side + 1, corner + 1], axis=1)
    positions = np.stack([x, y, z], axis=2).reshape(-1, 3).astype(np.float32)
    return positions, np.concatenate([lower, upper]).astype(np.uint32)


def nested(count: int, ratio: float) -> Mesh:
    """Each triangle `ratio` times as large as the one before, round one point."""
    size = ratio ** -np.arange(count, dtype=np.float64)[::-1, None, None]
    return separate(size * np.array([[-1.0, -1, -1], [1, 1, -1], [0, 1, 1]]))


def degenerate_meshes() -> dict[str, Mesh]:
    rng = np.random.default_rng(4)
    one = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 2, 3]]])
    point, around = np.full((3, 3), 2.5), rng.normal(size=(300, 3, 3))
    line = np.zeros((400, 3, 3))
    line[:, :, 1] = rng.random((400, 3))
    low_exponent, high_exponent = -37, 37
    return {
        "one": separate(one),
        "two": separate(np.concatenate([one, one + 5])),
        "identical": (one[0].astype(np.float32), np.tile(np.arange(3, dtype=np.uint32), (500, 1))),
        "point": (point.astype(np.float32), np.tile(np.arange(3, dtype=np.uint32), (300, 1))),
        "same centre": separate(np.stack([-around[:, 0], around[:, 0], 0 * around[:, 0]], axis=1)),
        "line": separate(line),
        "plane": separate(around * [1, 0, 1]),
        "no area": separate(np.stack([around[:, 0], around[:, 1], around[:, 1]], axis=1)),
        "1e30": separate(around * 1e30),
        "largest": separate(rng.choice([-1.0, 1.0], (300, 3, 3)) * float(np.finfo(np.float32).max)),
        "denormal": separate(np.round(around * 1000) * 2.0**-149),
        "all scales": separate(around * 10.0 ** rng.uniform(low_exponent, high_exponent, (300, 1, 1))),
        "far away": separate(around + 1e7),
        "signed zeros": separate(rng.choice([-0.0, 0.0, 1.0], (300, 3, 3))),
        "nested": nested(2000, 1.001),
    }


MESHES = {
    "soup": soup(700),
    "clustered": clustered(3000),
    "heightfield": heightfield(30),
    **{f"soup of {count}": soup(count) for count in (3, 15, 16, 17, 256, 257)},
    **degenerate_meshes(),
}


# --- what a tree must be ---------------------------------------------------------------------------


def corners_of(mesh: Mesh) -> np.ndarray:
    return mesh[0][mesh[1]]


def leaf_prims(tree: Bvh, node: int, slot: int) -> np.ndarray:
    first = int(tree.children[node, slot]) & ~LEAF_BIT
    return tree.prims[first : first + int(tree.counts[node, slot])]


def is_leaf(tree: Bvh, node: int, slot: int) -> bool:
    child = int(tree.children[node, slot])
    return child != EMPTY_CHILD and bool(child & LEAF_BIT)


def check_tree(tree: Bvh, mesh: Mesh, max_leaf: int = 16) -> None:
    """Everything that `Bvh` promises, child by child, from the root down."""
    assert (tree.children.dtype, tree.counts.dtype, tree.prims.dtype) == (np.uint32,) * 3
    assert tree.boxes.dtype == np.float32
    assert tree.children.shape == tree.counts.shape == (tree.node_count, NODE_WIDTH)
    assert tree.boxes.shape == (tree.node_count, 6, NODE_WIDTH)
    corners = corners_of(mesh)
    seen = np.zeros(len(corners), dtype=np.int64)
    level, below = [0], []
    levels = []
    while level:
        assert level == list(range(level[0], level[0] + len(level))), "a level is one range of nodes, in order"
        levels.append((level[0], level[-1] + 1))
        for node in level:
            for slot in range(NODE_WIDTH):
                child, box = int(tree.children[node, slot]), tree.boxes[node, :, slot]
                if child == EMPTY_CHILD:
                    assert (tree.children[node, slot:] == EMPTY_CHILD).all(), "used slots come first"
                    assert tree.counts[node, slot] == 0
                    assert (box == [math.inf] * 3 + [-math.inf] * 3).all()
                elif is_leaf(tree, node, slot):
                    prims = leaf_prims(tree, node, slot)
                    assert 1 <= tree.counts[node, slot] <= max_leaf
                    assert len(prims) == tree.counts[node, slot]
                    assert (np.diff(prims.astype(np.int64)) > 0).all(), "ascending in a leaf"
                    seen[prims] += 1
                    points = corners[prims].reshape(-1, 3)
                    assert (box == np.concatenate([points.min(axis=0), points.max(axis=0)])).all()
                else:
                    assert tree.counts[node, slot] == 0
                    below.append(child)
                    used = tree.children[child] != EMPTY_CHILD
                    assert used.sum() >= 2, "a node of one child does nothing"
                    of_child = tree.boxes[child][:, used]
                    assert (box == np.concatenate([of_child[:3].min(axis=1), of_child[3:].max(axis=1)])).all()
        level, below = below, []
    assert tree.levels == tuple(levels) and tree.depth == len(levels)
    assert tree.levels[-1][1] == tree.node_count
    assert (seen == 1).all(), "every triangle is reached once"
    assert not np.signbit(tree.boxes[tree.boxes == 0]).any(), "-0 and 0 would make equal trees differ in bits"


@pytest.mark.parametrize("name", MESHES)
def test_a_tree_is_what_it_promises(name: str) -> None:
    with np.errstate(all="raise", under="ignore"):  # nothing may overflow or become NaN on the way
        tree = build_bvh(*MESHES[name])
        assert math.isfinite(tree.sah_cost())
    check_tree(tree, MESHES[name])


@pytest.mark.parametrize("max_leaf", [1, 2, 5, 40])
@pytest.mark.parametrize("name", ["clustered", "identical", "one"])
def test_leaves_have_at_most_max_leaf_triangles(name: str, max_leaf: int) -> None:
    check_tree(build_bvh(*MESHES[name], max_leaf=max_leaf), MESHES[name], max_leaf)


def test_equal_triangles_fill_the_leaves() -> None:
    """500 equal triangles: whatever is under the root, the fewest leaves hold 16 each."""
    tree = build_bvh(*MESHES["identical"])
    assert (tree.counts > 0).sum() <= 500 // 16 * 2


def test_no_triangle_is_a_root_without_children() -> None:
    tree = build_bvh(np.zeros((4, 3), np.float32), np.zeros((0, 3), np.uint32))
    check_tree(tree, (np.zeros((4, 3), np.float32), np.zeros((0, 3), np.uint32)))
    assert (tree.node_count, tree.depth, tree.levels) == (1, 1, ((0, 1),))
    assert tree.nbytes == 64 + 64 + 6 * 64
    assert tree.sah_cost() == NODE_COST


def test_one_triangle_is_a_root_with_one_leaf() -> None:
    tree = build_bvh(*MESHES["one"])
    assert tree.children[0].tolist() == [LEAF_BIT] + 15 * [EMPTY_CHILD]
    assert tree.counts[0].tolist() == [1] + 15 * [0]
    assert tree.boxes[0, :, 0].tolist() == [0, 0, 0, 1, 2, 3]
    assert tree.nbytes == 64 + 64 + 6 * 64 + 4
    assert tree.sah_cost() == NODE_COST + LEAF_COST + TRIANGLE_COST


def test_vertices_that_no_triangle_uses_do_not_matter() -> None:
    positions, triangles = soup(50)
    more = np.concatenate([positions, np.full((2, 3), np.nan, np.float32)])
    assert digest(build_bvh(more, triangles)) == digest(build_bvh(positions, triangles))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_vertex_that_is_not_finite_is_refused(value: float) -> None:
    positions, triangles = soup(50)
    positions[70, 1] = value
    with pytest.raises(SceneError, match="not finite"):
        build_bvh(positions, triangles)


def test_limits_are_named() -> None:
    with pytest.raises(UsageError, match="cannot hold 0 triangles"):
        build_bvh(*soup(3), max_leaf=0)
    too_many = np.broadcast_to(np.zeros((1, 3), np.uint32), (2**30 + 1, 3))
    with pytest.raises(CapacityError, match="1073741824 triangles, the scene has 1073741825"):
        build_bvh(np.zeros((1, 3), np.float32), too_many)


# --- the same bits ---------------------------------------------------------------------------------


def digest(tree: Bvh) -> str:
    arrays = (tree.children, tree.counts, tree.boxes, tree.prims)
    return hashlib.sha256(b"".join(a.tobytes() for a in arrays) + repr(tree.levels).encode()).hexdigest()


def test_equal_input_gives_equal_arrays() -> None:
    for name in ("clustered", "identical", "all scales"):
        positions, triangles = MESHES[name]
        first = digest(build_bvh(positions, triangles))
        assert digest(build_bvh(positions.copy(), triangles.copy())) == first
        assert digest(build_bvh(np.asfortranarray(positions), np.asfortranarray(triangles))) == first


def test_equal_input_gives_equal_arrays_in_another_process() -> None:
    program = "from test_bvh import *; print(digest(build_bvh(*clustered(3000))))"
    folder = Path(__file__).resolve().parent
    command = [sys.executable, "-c", f"import sys; sys.path[:0] = [{str(folder.parent)!r}, {str(folder)!r}]; {program}"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == digest(build_bvh(*clustered(3000)))


# --- cost ------------------------------------------------------------------------------------------


def area(low: np.ndarray, high: np.ndarray) -> float:
    """Half the surface of a box, float64."""
    x, y, z = (high.astype(np.float64) - low.astype(np.float64)).tolist()
    return x * y + y * z + z * x


def test_the_cost_is_the_sum_over_children() -> None:
    mesh = MESHES["clustered"]
    tree = build_bvh(*mesh)
    points = corners_of(mesh).reshape(-1, 3)
    total = 0.0
    for node, slot in np.argwhere(tree.children != EMPTY_CHILD):
        cost = LEAF_COST + TRIANGLE_COST * int(tree.counts[node, slot]) if is_leaf(tree, node, slot) else NODE_COST
        total += cost * area(tree.boxes[node, :3, slot], tree.boxes[node, 3:, slot])
    expected = NODE_COST + total / area(points.min(axis=0), points.max(axis=0))
    # Sums of fewer than 3000 positive float64 terms in different orders.
    assert tree.sah_cost() == pytest.approx(expected, rel=3000 * 2.0**-52)


def morton_tree(mesh: Mesh) -> Bvh:
    """Leaves of 16 triangles cut from the Morton order of their centres, nodes of 16 children cut from that."""
    corners = corners_of(mesh).astype(np.float64)
    center = (corners.min(axis=1) + corners.max(axis=1)) / 2
    cells = ((center - center.min(axis=0)) / np.ptp(center, axis=0).max() * 1023).astype(int)
    codes = [sum((int(v) >> b & 1) << (3 * b + axis) for b in range(10) for axis, v in enumerate(row)) for row in cells]
    prims = np.argsort(codes, kind="stable")
    starts = np.arange(0, len(prims), 16)
    ends = np.minimum(starts + 16, len(prims))
    boxes = [np.concatenate([corners[prims[a:b]].min((0, 1)), corners[prims[a:b]].max((0, 1))]) for a, b in zip(starts, ends)]
    layers = [(starts | LEAF_BIT, ends - starts, np.array(boxes))]
    while len(layers[-1][0]) > NODE_WIDTH:
        below = layers[-1][2]
        groups = [below[k : k + 16] for k in range(0, len(below), 16)]
        joined = np.array([np.concatenate([g[:, :3].min(axis=0), g[:, 3:].max(axis=0)]) for g in groups])
        layers.append((np.arange(len(groups)), np.zeros(len(groups), int), joined))
    node_counts = [-(-len(links) // NODE_WIDTH) for links, _, _ in reversed(layers)]
    ends_of_levels = np.cumsum(node_counts)
    children = np.full((ends_of_levels[-1], NODE_WIDTH), EMPTY_CHILD, dtype=np.uint32)
    counts = np.zeros_like(children)
    of_nodes = np.full((len(children), 6, NODE_WIDTH), np.inf, dtype=np.float32)
    of_nodes[:, 3:] = -np.inf
    for (links, leaf_counts, layer_boxes), end, node_count in zip(reversed(layers), ends_of_levels, node_counts):
        node, slot = np.divmod(np.arange(len(links)), NODE_WIDTH)
        node += end - node_count
        children[node, slot] = np.where(leaf_counts > 0, links, links + end)
        counts[node, slot] = leaf_counts
        of_nodes[node, :, slot] = layer_boxes
    levels = tuple((int(end - count), int(end)) for end, count in zip(ends_of_levels, node_counts))
    for begin, end in levels:  # ascending in each leaf
        for node, slot in np.argwhere(counts[begin:end] > 0):
            first = children[begin + node, slot] & 0x7FFFFFFF
            prims[first : first + 16] = np.sort(prims[first : first + 16])
    return Bvh(children, counts, of_nodes, prims.astype(np.uint32), levels)


@pytest.mark.parametrize("name", ["clustered", "heightfield", "soup"])
def test_the_cost_is_below_that_of_a_plain_morton_tree(name: str) -> None:
    plain = morton_tree(MESHES[name])
    check_tree(plain, MESHES[name])
    assert build_bvh(*MESHES[name]).sah_cost() <= plain.sah_cost()


def least_cost(tree: BinaryTree, boxes: np.ndarray, max_leaf: int) -> float:
    """What the cheapest tree of NODE_WIDTH children costs that keeps the binary tree's nesting, float64, by recursion.

    boxes : (2 triangle_count - 1, 6), of every id.
    """
    n = tree.triangle_count
    areas = [area(box[:3], box[3:]) for box in boxes]

    def leaf(node: int) -> float:
        count = 1 if node < n else int(tree.counts[node - n])
        return areas[node] * (LEAF_COST + TRIANGLE_COST * count) if count <= max_leaf else math.inf

    @lru_cache(maxsize=None)
    def split(node: int, slots: int) -> float:
        left, right = int(tree.left[node - n]), int(tree.right[node - n])
        return min((best(left, k) + best(right, slots - k) for k in range(1, slots)), default=math.inf)

    @lru_cache(maxsize=None)
    def best(node: int, slots: int) -> float:
        if node < n:
            return leaf(node)
        return min(leaf(node), areas[node] * NODE_COST + split(node, NODE_WIDTH), split(node, slots))

    root = 2 * n - 2
    return NODE_COST + min(leaf(root), split(root, NODE_WIDTH)) / areas[root]


@pytest.mark.parametrize("max_leaf", [1, 16])
@pytest.mark.parametrize("name", ["clustered", "heightfield"])
def test_no_other_collapse_of_the_binary_tree_costs_less(name: str, max_leaf: int) -> None:
    mesh = clustered(400) if name == "clustered" else heightfield(14)
    corners = corners_of(mesh)
    of_triangles = np.concatenate([corners.min(axis=1), corners.max(axis=1)], axis=1)
    tree = bvh_module._cluster(np.ascontiguousarray(of_triangles.T))
    boxes, heights = list(of_triangles), [0] * len(corners)
    for left, right in zip(tree.left.tolist(), tree.right.tolist(), strict=True):
        low, high = np.minimum(boxes[left], boxes[right])[:3], np.maximum(boxes[left], boxes[right])[3:]
        boxes.append(np.concatenate([low, high]))
        heights.append(1 + max(heights[left], heights[right]))
    least = least_cost(tree, np.array(boxes), max_leaf)
    cost = build_bvh(*mesh, max_leaf=max_leaf).sah_cost()
    # A cost of the table is too small by 15 of 2^23 for its choice, and rounded a few times (areas: four, sum, product),
    # once or, where a node begins, twice for each level of the binary tree. The last term: the float64 sums.
    slack = 2 * heights[-1] * (15 + 4) * 2.0**-23
    assert least * (1 - 1e-12) <= cost <= least * (1 + slack)


@pytest.mark.parametrize("ratio", [1.0001, 1.001, 1.01, 1.1])
def test_sizes_that_grow_along_the_order_do_not_stall_the_build(ratio: float) -> None:
    """Each round joins a 64th of the clusters, or is one of at most two before a round that joins half of them."""
    count = min(3000, int(80 / math.log10(ratio)))
    positions, triangles = nested(count, ratio)
    rounds = bvh_module._cluster(bvh_module._triangle_boxes(positions, triangles)).rounds
    assert len(rounds) <= 64 * math.log(count) + 3 * math.log2(count)
    assert rounds[-1] == count - 1


# --- closest hits ----------------------------------------------------------------------------------

NO_HIT = 0xFFFFFFFF


def hit_distance(corners: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """t of each pair of ray and triangle, inf where it misses: Moeller-Trumbore written out in float64.

    Each operation is its own, so that the answer for a pair does not depend on which pairs are asked together.
    """

    def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        x = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
        y = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
        return np.stack([x, y, a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]], axis=-1)

    def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]

    edge1, edge2 = corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :]
    p, offset = cross(direction, edge2), origin - corners[..., 0, :]
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1 / dot(edge1, p)
        q = cross(offset, edge1)
        b1, b2, t = dot(offset, p) * inverse, dot(direction, q) * inverse, dot(edge2, q) * inverse
    return np.where((b1 >= 0) & (b2 >= 0) & (b1 + b2 <= 1) & (t > 0), t, np.inf)


def closest(ray: np.ndarray, prim: np.ndarray, t: np.ndarray, ray_count: int) -> tuple[np.ndarray, np.ndarray]:
    """The nearest hit of each ray among pairs, equal t the smaller prim_id: t and prim_id."""
    order = np.lexsort((prim, t, ray))
    order = order[np.isfinite(t[order])]
    rays, first = np.unique(ray[order], return_index=True)
    best_t, best_prim = np.full(ray_count, np.inf), np.full(ray_count, NO_HIT, dtype=np.uint32)
    best_t[rays], best_prim[rays] = t[order[first]], prim[order[first]]
    return best_t, best_prim


def by_brute_force(corners: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    pieces = []
    for first in range(0, len(origin), 256):
        o, d = origin[first : first + 256, None], direction[first : first + 256, None]
        t = hit_distance(corners[None], o, d)
        ray, prim = np.nonzero(np.isfinite(t))
        pieces.append((first + ray, prim, t[ray, prim]))
    return closest(*(np.concatenate(part) for part in zip(*pieces, strict=True)), len(origin))


def by_tree(
    tree: Bvh, corners: np.ndarray, origin: np.ndarray, direction: np.ndarray
) -> tuple[np.ndarray, np.ndarray, int]:
    """All rays through the tree together, level by level; also how many pairs of ray and triangle were tested."""
    ray, node = np.arange(len(origin)), np.zeros(len(origin), dtype=np.int64)
    rays, prims = [], []
    while len(ray):
        box = tree.boxes[node].astype(np.float64)  # (pair, 6, 16)
        o, inverse = origin[ray][:, :, None], 1 / direction[ray][:, :, None]
        low, high = (box[:, :3] - o) * inverse, (box[:, 3:] - o) * inverse
        used = tree.children[node] != EMPTY_CHILD
        # Three roundings of 2^-53 in each bound: 8 of them on one side cover both.
        near = np.minimum(low, high).max(axis=1)
        far = np.maximum(low, high).min(axis=1) * (1 + 8 * 2.0**-53)
        pair, slot = np.nonzero(used & (near <= far) & (far >= 0))
        ray, child, count = ray[pair], tree.children[node[pair], slot].astype(np.int64), tree.counts[node[pair], slot]
        for k in range(int(count.max(initial=0))):
            some = count > k
            rays.append(ray[some])
            prims.append(tree.prims[(child[some] & ~LEAF_BIT) + k])
        ray, node = ray[count == 0], child[count == 0]
    all_rays, all_prims = np.concatenate(rays), np.concatenate(prims)
    t = hit_distance(corners[all_prims], origin[all_rays], direction[all_rays])
    return *closest(all_rays, all_prims, t, len(origin)), len(t)


@pytest.mark.parametrize("name", ["soup", "clustered", "heightfield", "same centre", "plane", "nested"])
@pytest.mark.parametrize("ray_count", [1, 100, 10000])
def test_closest_hits_through_the_tree_are_those_of_brute_force(name: str, ray_count: int) -> None:
    mesh = {"clustered": clustered(600), "heightfield": heightfield(15), "nested": nested(300, 1.01)}.get(
        name, MESHES[name]
    )
    corners = corners_of(mesh).astype(np.float64)
    rng = np.random.default_rng(5)
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    origin = low + (high - low) * rng.uniform(-0.5, 1.5, (ray_count, 3))
    # At points near triangles, so that most rays pass through something.
    aim = corners[rng.integers(len(corners), size=ray_count)].mean(axis=1)
    direction = aim + 0.02 * (high - low).max() * rng.normal(size=(ray_count, 3)) - origin
    expected_t, expected_prim = by_brute_force(corners, origin, direction)
    tree = build_bvh(*mesh)
    t, prim, tested = by_tree(tree, corners, origin, direction)
    assert (t == expected_t).all() and (prim == expected_prim).all()
    if ray_count == 10000:
        assert (prim != NO_HIT).mean() > 0.1, "the rays must hit something to show anything"
        assert tested < ray_count * len(corners)
