"""A bounding volume hierarchy over triangles, 16 children a node, built on the host; it does not depend on the view.

    Morton order of the triangles' centres
    while more than one cluster:              agglomerative clustering, all clusters at once
        each cluster looks at its neighbours in that order and picks the one whose common box adds least
        two clusters that picked each other become one, at the place of the first
    with a device: subtrees move to where boxes become smaller (bvh_reinsertion.py)
    the binary tree becomes one of 16 children a node at the least cost (bvh_collapse.py)

Good at: any mixture of sizes, a few passes over arrays. Bad at: nothing is split, so long thin slanted triangles
keep their large boxes. Tests: tests/test_bvh.py, tests/test_bvh_reinsertion.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clrast.errors import CapacityError, SceneError, UsageError
from clrast.opencl.device import Device
from clrast.opencl.layout import EMPTY_CHILD, LEAF_BIT, NODE_WIDTH
from clrast.visibility.bvh_collapse import LEAF_COST, NODE_COST, TRIANGLE_COST, BinaryTree, WideTree, collapse
from clrast.visibility.bvh_reinsertion import can_reinsert, reinsert_subtrees

MAX_TRIANGLES = 1 << 30
"""Ids of a binary tree's nodes fit 31 bits."""

SEARCH_RADIUS = 8
"""Neighbours on each side, in Morton order, that a cluster looks at."""

MAX_RADIUS = 64
"""The same when few clusters are left, and looking costs little."""

WIDENING = 1 << 18
"""Clusters times neighbours up to which the radius grows."""

BLOCK = 16384
"""Clusters at a time, so that their boxes stay in a cache."""

MANTISSA_BITS, ALL_BITS = 23, 31
"""Low bits of a float32 without its exponent, and with it."""

MAX_MORTON_BITS = 16
"""Bits of each axis in a Morton code; fewer where the triangle's number needs them."""


@dataclass(frozen=True)
class Bvh:
    """Nodes, breadth first; node 0 is the root.

    children : (node_count, 16) uint32, node of an inner child, LEAF_BIT | first slot in `prims`, or EMPTY_CHILD;
        used slots come first, in the order of `prims`.
    counts : (node_count, 16) uint32, triangles of a leaf, 0 for the others.
    boxes : (node_count, 6, 16) float32, world space, min x, y, z, max x, y, z of each child, exact; unused: +inf, -inf.
    prims : (triangle_count,) uint32, every prim_id once, ascending in each leaf.
    levels : (first_node, end_node) of each level, the root's first.
    """

    children: np.ndarray
    counts: np.ndarray
    boxes: np.ndarray
    prims: np.ndarray
    levels: tuple[tuple[int, int], ...]

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        return self.children.nbytes + self.counts.nbytes + self.boxes.nbytes + self.prims.nbytes

    @property
    def node_count(self) -> int:
        return len(self.children)

    @property
    def depth(self) -> int:
        """Levels of nodes, 1 for a root alone."""
        return len(self.levels)

    def sah_cost(self) -> float:
        """What a random ray through the root's box is expected to cost, in tests of a node.

        Areas are float64 and relative to the root's; where that is 0 every node counts as met.
        """
        low, high = self.boxes[:, :3].astype(np.float64), self.boxes[:, 3:].astype(np.float64)
        used = self.children != EMPTY_CHILD
        leaf = self.counts > 0
        if not used.any():
            return NODE_COST
        x, y, z = np.where(used[:, None], high - low, 0.0).transpose(1, 0, 2)
        dx, dy, dz = (high[0][:, used[0]].max(axis=1) - low[0][:, used[0]].min(axis=1)).tolist()
        root = dx * dy + dy * dz + dz * dx
        met = (x * y + y * z + z * x) / root if root > 0 else used.astype(np.float64)
        cost = np.where(leaf, LEAF_COST + TRIANGLE_COST * self.counts, NODE_COST)
        return NODE_COST + float((met * cost)[used].sum())


def build_bvh(positions: np.ndarray, triangles: np.ndarray, max_leaf: int = 16, device: Device | None = None) -> Bvh:
    """Build the hierarchy of a scene's triangles; equal input gives equal arrays.

    positions : (vertex_count, 3) float32, world space, finite where a triangle uses them.
    triangles : (triangle_count, 3) uint32, indices in range. max_leaf : most triangles of a leaf.
    device : moves subtrees, which takes as long again; without one, or where it limits loops, they stay where they are.
    Without triangles: a root without children. Raises SceneError, CapacityError or UsageError.
    """
    if max_leaf < 1:
        raise UsageError(f"a leaf of a BVH cannot hold {max_leaf} triangles: give 1 or more")
    if len(triangles) > MAX_TRIANGLES:
        raise CapacityError(f"a BVH holds {MAX_TRIANGLES} triangles, the scene has {len(triangles)}: split it")
    if len(triangles) == 0:
        return _empty_bvh()
    boxes = _triangle_boxes(positions, triangles)
    tree = _cluster(boxes)
    if device is not None and can_reinsert(device, len(triangles)):
        tree = reinsert_subtrees(device, tree, _scaled(boxes), max_leaf)
    wide = collapse(tree, max_leaf)
    return Bvh(wide.children, wide.counts, _child_boxes(boxes, wide), wide.prims, wide.levels)


def _empty_bvh() -> Bvh:
    children = np.full((1, NODE_WIDTH), EMPTY_CHILD, dtype=np.uint32)
    return Bvh(children, np.zeros_like(children), _unused_boxes(1), np.zeros(0, dtype=np.uint32), ((0, 1),))


def _unused_boxes(node_count: int) -> np.ndarray:
    """The boxes of nodes without children: (node_count, 6, NODE_WIDTH) float32."""
    boxes = np.full((node_count, 6, NODE_WIDTH), np.inf, dtype=np.float32)
    boxes[:, 3:] = -np.inf
    return boxes


def _triangle_boxes(positions: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """min x, y, z, max x, y, z of each triangle: (6, triangle_count) float32."""
    boxes = np.zeros((6, len(triangles)), dtype=np.float32)
    a, b, c = (np.ascontiguousarray(triangles[:, k]) for k in range(3))
    for axis in range(3):
        line = np.ascontiguousarray(positions[:, axis], dtype=np.float32)
        pa, pb, pc = line[a], line[b], line[c]
        np.minimum(np.minimum(pa, pb), pc, out=boxes[axis])
        np.maximum(np.maximum(pa, pb), pc, out=boxes[axis + 3])
    boxes += np.float32(0.0)  # -0 becomes 0: min and max of the two depend on the processor
    return boxes


def _morton_order(boxes: np.ndarray) -> np.ndarray:
    """Triangles by the Morton codes of their boxes' centres, equal codes by number: (triangle_count,) int64."""
    count = boxes.shape[1]
    index_bits = max(1, (count - 1).bit_length())
    bits = min(MAX_MORTON_BITS, (64 - index_bits) // 3)
    low = boxes[:3].min(axis=1).astype(np.float64)
    high = boxes[3:].max(axis=1).astype(np.float64)
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        raise SceneError("a vertex that a triangle uses is not finite: repair the mesh")
    side = float((high - low).max())
    scale = (1 << bits) / side if side > 0.0 else 0.0
    cells = np.arange(1 << bits, dtype=np.uint64)
    spread = np.zeros(1 << bits, dtype=np.uint64)
    for bit in range(bits):
        spread |= (cells >> np.uint64(bit) & np.uint64(1)) << np.uint64(3 * bit)
    keys = np.arange(count, dtype=np.uint64)
    for axis in range(3):
        center = np.add(boxes[axis], boxes[axis + 3], dtype=np.float64)
        center *= 0.5
        center -= low[axis]
        center *= scale
        cell = np.minimum(center, (1 << bits) - 1).astype(np.intp)
        keys |= spread[cell] << np.uint64(index_bits + axis)
    keys.sort()
    return (keys & np.uint64((1 << index_bits) - 1)).astype(np.int64)


def _scaled(boxes: np.ndarray) -> np.ndarray:
    """Boxes scaled by a power of two to within -1 and 1, so that no area overflows."""
    return np.ldexp(boxes, -int(np.frexp(np.abs(boxes).max())[1]))


def _half_areas(boxes: np.ndarray) -> np.ndarray:
    """Half the surface of boxes given as (6, count) float32: min x, y, z, then max x, y, z negated."""
    x, y, z = boxes[:3] + boxes[3:]  # the extents negated: products of two have the right sign
    return (x + y) * z + x * y


def _cluster(triangle_boxes: np.ndarray) -> BinaryTree:
    """The binary tree over triangles; triangle_boxes : (6, triangle_count) float32."""
    count = triangle_boxes.shape[1]
    ids = _morton_order(triangle_boxes)
    boxes = _scaled(triangle_boxes).take(ids, axis=1)  # the maximum negated, so that a union is six minima
    np.negative(boxes[3:], out=boxes[3:])
    left, right, counts = (np.zeros(count - 1, dtype=np.int32) for _ in range(3))
    areas = np.zeros(2 * count - 1, dtype=np.float32)
    areas[ids] = _half_areas(boxes)
    ids = ids.astype(np.int32)
    sizes = np.ones(count, dtype=np.int32)
    rounds: list[int] = []
    made = 0
    ignored_bits = 0
    while len(ids) > 1:
        radius = min(MAX_RADIUS, max(SEARCH_RADIUS, WIDENING // len(ids)))
        partner = _nearest_neighbours(boxes, radius, ignored_bits)
        here = np.arange(len(ids))
        first = np.flatnonzero((partner > here) & (partner[partner] == here))
        second = partner[first]
        end = made + len(first)
        left[made:end], right[made:end] = ids[first], ids[second]
        sizes[first] += sizes[second]
        counts[made:end] = sizes[first]
        merged = np.minimum(boxes[:, first], boxes[:, second])
        areas[count + made : count + end] = _half_areas(merged)
        boxes[:, first] = merged
        ids[first] = np.arange(count + made, count + end)
        stays = np.ones(len(ids), dtype=bool)
        stays[second] = False
        ignored_bits = _bits_to_ignore(ignored_bits, len(ids), len(first))
        kept = np.flatnonzero(stays)
        boxes, ids, sizes = boxes.take(kept, axis=1), ids[kept], sizes[kept]
        made = end
        rounds.append(made)
    return BinaryTree(left, right, counts, areas, tuple(rounds))


def _bits_to_ignore(ignored_bits: int, before: int, merged: int) -> int:
    """For the next round, after one with `before` clusters that merged `merged` pairs.

    Where sizes grow along the order each cluster picks the smaller neighbour, and next to none is picked back: a
    round may then merge one pair in thousands. Ignoring mantissas makes neighbours alike, ignoring all pairs them up.
    """
    if merged * 16 >= before:
        return 0
    return MANTISSA_BITS if ignored_bits == 0 or merged * 64 >= before else ALL_BITS


def _nearest_neighbours(boxes: np.ndarray, radius: int, ignored_bits: int) -> np.ndarray:
    """The neighbour that each cluster would rather be joined with: (count,) int64.

    boxes : (6, count) float32, as `_half_areas` takes them. radius : neighbours on each side. ignored_bits : low bits
    of a pair's price that count as equal, besides those that the order of pairs takes.

    The price of a pair is the area of its common box less the mean of the two: what joining adds, which measured
    better than the area alone. Pairs (i, i + d) are ordered by price, then d, then the parity of i // d: two pairs
    with one cluster in common never compare equal, so the least pair of all is picked from both sides, and among
    equal boxes each cluster finds a partner.
    """
    count = boxes.shape[1]
    radius = min(radius, count - 1)
    code_bits = (2 * radius - 1).bit_length()
    keep = np.uint32(0x7FFFFFFF >> max(code_bits, ignored_bits) << max(code_bits, ignored_bits))
    block = min(BLOCK, count)
    codes = [(np.arange(block + 2 * d) // d % 2 + 2 * (d - 1)).astype(np.uint32) for d in range(1, radius + 1)]
    best = np.full(count, 0xFFFFFFFF, dtype=np.uint32)
    union = np.zeros((6, block), dtype=np.float32)
    area = np.zeros(block, dtype=np.float32)
    quarters = _half_areas(boxes) * np.float32(0.5)
    for begin in range(0, count, block):
        for d in range(1, radius + 1):
            end = min(begin + block, count - d)
            if end <= begin:
                break
            u, a = union[:, : end - begin], area[: end - begin]
            np.minimum(boxes[:, begin:end], boxes[:, begin + d : end + d], out=u)
            u[:3] += u[3:]
            np.add(u[0], u[1], out=a)
            a *= u[2]
            u[0] *= u[1]
            a += u[0]
            np.add(quarters[begin:end], quarters[begin + d : end + d], out=u[0])
            a -= u[0]
            key = a.view(np.uint32)
            key &= keep
            shift = begin % (2 * d)
            key |= codes[d - 1][shift : shift + end - begin]
            np.minimum(best[begin:end], key, out=best[begin:end])
            np.minimum(best[begin + d : end + d], key, out=best[begin + d : end + d])
    here = np.arange(count)
    distance = (best & np.uint32((1 << code_bits) - 1)).astype(np.int64) // 2 + 1
    return np.where(here // distance % 2 == best % 2, here + distance, here - distance)


def _child_boxes(triangle_boxes: np.ndarray, wide: WideTree) -> np.ndarray:
    """Boxes of all children: leaves from their triangles, then the others level by level from below.

    triangle_boxes : (6, triangle_count) float32. Returns (node_count, 6, NODE_WIDTH) float32.
    """
    boxes = _unused_boxes(len(wide.children))
    node, slot = np.nonzero(wide.counts)
    firsts = wide.children[node, slot] & ~np.uint32(LEAF_BIT)
    order = np.argsort(firsts)
    node, slot = node[order], slot[order]
    for row in range(6):
        reduce = np.minimum if row < 3 else np.maximum
        boxes[node, row, slot] = reduce.reduceat(triangle_boxes[row][wide.prims], firsts[order].astype(np.intp))
    inner = wide.children & np.uint32(LEAF_BIT) == 0
    for (begin, end), (below, below_end) in zip(wide.levels[-2::-1], wide.levels[:0:-1], strict=True):
        whole = boxes[below:below_end]
        union = np.concatenate([whole[:, :3].min(axis=2), whole[:, 3:].max(axis=2)], axis=1)
        node, slot = np.nonzero(inner[begin:end])
        boxes[begin + node, :, slot] = union[wide.children[begin + node, slot] - np.uint32(below)]
    return boxes
