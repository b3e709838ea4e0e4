"""From a binary tree over triangles to nodes of many children: the cheapest choice, by a dynamic programme.

Cost of a subtree under the surface area heuristic, for a node n of area A(n) and j child slots of its parent:

    one(n)           = min(A(n) leaf_cost(triangles of n), A(n) NODE_COST + split(n, NODE_WIDTH))
    split(n, j)      = min over 0 < k < j of best(left(n), k) + best(right(n), j - k)
    best(n, 1)       = one(n);    best(n, j) = min(one(n), split(n, j))

Bottom-up, all nodes of one round of the binary tree at once; then the choices are followed from the root down.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from clrast.opencl.layout import EMPTY_CHILD, LEAF_BIT, NODE_WIDTH

NODE_COST = 1.0
"""Testing the boxes of all children of a node at once; the unit of the two below."""

LEAF_COST = 0.75
"""Visiting a leaf, however many triangles it has."""

TRIANGLE_COST = 1.0 / 256
"""A leaf's cost for each of its triangles: they are set up together, but each is fetched. Measured with frusta over
the icosphere and Sponza: 1/32 makes leaves of 6 triangles and costs 5 to 10 % more than this."""

CHOICE_BITS = NODE_WIDTH - 1
"""Low bits of a cost that keep what was chosen; a few units in the last place of float32 decide nothing."""

LEAF, INNER = 0, 1
"""The choice where a node of the binary tree takes one slot."""

BLOCK = 2048
"""Nodes at a time, so that the tables of a block stay in a cache."""

AREA_FLOOR = 2.0**-40
"""Least area, relative to the root's: among points and lines the fewest nodes and leaves win."""


@dataclass(frozen=True)
class BinaryTree:
    """Ids below triangle_count are triangles, the others inner nodes, children before parents, the root last.

    left, right : (triangle_count - 1,) int32, ids of an inner node's children, by id - triangle_count.
    counts : (triangle_count - 1,) int32, triangles of an inner node.
    areas : (2 triangle_count - 1,) float32, half the surface of each id's box, in any unit.
    rounds : ends of runs of inner nodes (counted from 0) that do not hold each other.
    """

    left: np.ndarray
    right: np.ndarray
    counts: np.ndarray
    areas: np.ndarray
    rounds: tuple[int, ...]

    @property
    def triangle_count(self) -> int:
        return len(self.left) + 1


@dataclass(frozen=True)
class WideTree:
    """Nodes and leaves without their boxes, as `Bvh` in bvh.py has them."""

    children: np.ndarray
    counts: np.ndarray
    prims: np.ndarray
    levels: tuple[tuple[int, int], ...]


def collapse(tree: BinaryTree, max_leaf: int) -> WideTree:
    """The cheapest tree of nodes of NODE_WIDTH children and leaves of at most `max_leaf` triangles."""
    root = np.array([2 * tree.triangle_count - 2])
    table = _solve(tree, max_leaf)
    if _is_one_leaf(tree, table, max_leaf):
        children, counts = _slots(np.zeros(1, np.intp), np.array([LEAF_BIT]), np.array([tree.triangle_count]), 1)
        return WideTree(children, counts, _leaf_order(tree, np.zeros(1, np.intp), root), ((0, 1),))
    levels: list[tuple[int, int]] = []
    rows: list[tuple[np.ndarray, np.ndarray]] = []
    leaves: list[np.ndarray] = []
    nodes, firsts, end = root, np.zeros(1, dtype=np.int64), 0
    while len(nodes):
        levels.append((end, end + len(nodes)))
        end += len(nodes)
        owner, ids, first = _children(tree, table, nodes, firsts)
        inner = ids >= tree.triangle_count
        inner[inner] = table[ids[inner] - tree.triangle_count, 0] & CHOICE_BITS == INNER
        links = np.where(inner, end + np.cumsum(inner) - 1, first | LEAF_BIT)
        rows.append(_slots(owner, links, np.where(inner, 0, _triangle_counts(tree, ids)), len(nodes)))
        leaves.append(np.stack([first[~inner], ids[~inner]]))
        nodes, firsts = ids[inner], first[inner]
    children, counts = (np.concatenate(arrays) for arrays in zip(*rows, strict=True))
    return WideTree(children, counts, _leaf_order(tree, *np.concatenate(leaves, axis=1)), tuple(levels))


def _slots(
    owner: np.ndarray, links: np.ndarray, leaf_counts: np.ndarray, node_count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Children laid out in the slots of their nodes: `children` and `counts` of `node_count` nodes.

    owner : (child_count,) int, the node of each child, ascending.
    """
    children = np.full((node_count, NODE_WIDTH), EMPTY_CHILD, dtype=np.uint32)
    counts = np.zeros((node_count, NODE_WIDTH), dtype=np.uint32)
    slot = np.arange(len(owner)) - np.searchsorted(owner, owner)
    children[owner, slot] = links
    counts[owner, slot] = leaf_counts
    return children, counts


def _leaf_costs(areas: np.ndarray, counts: np.ndarray | int) -> np.ndarray:
    """Cost of leaves, float32."""
    return areas * (np.float32(LEAF_COST) + np.float32(TRIANGLE_COST) * np.asarray(counts, dtype=np.float32))


def _triangle_counts(tree: BinaryTree, ids: np.ndarray) -> np.ndarray:
    """Triangles under each id."""
    inner = ids - tree.triangle_count
    return np.where(inner < 0, 1, tree.counts.take(inner, mode="clip"))


def _runs(tree: BinaryTree) -> Iterator[tuple[int, int]]:
    """Blocks of inner nodes, children first; no block holds a node and its child."""
    begin = 0
    for end in tree.rounds:
        for first in range(begin, end, BLOCK):
            yield first, min(first + BLOCK, end)
        begin = end


def _solve(tree: BinaryTree, max_leaf: int) -> np.ndarray:
    """The table of costs: (triangle_count - 1, NODE_WIDTH) uint32, float32 bits with a choice in the low CHOICE_BITS.

    Columns but the last are best(n, column + 1), the last is split(n, NODE_WIDTH), which a node of its own has.
    The choice is k of `split`, or 0 for one(n); in column 0 it is LEAF or INNER.
    """
    keep = np.uint32(~CHOICE_BITS & 0xFFFFFFFF)
    table = np.zeros((tree.triangle_count - 1, NODE_WIDTH), dtype=np.uint32)
    floor = np.float32(max(float(tree.areas[-1]) * AREA_FLOOR, 2.0**-100))
    sums = np.zeros((NODE_WIDTH, BLOCK), dtype=np.float32)
    split = np.zeros((NODE_WIDTH, BLOCK), dtype=np.uint32)
    for first, end in _runs(tree):
        m = end - first
        left = _child_costs(tree, table, tree.left[first:end], floor)
        right = _child_costs(tree, table, tree.right[first:end], floor)
        best = split[:, :m]
        best[:] = 0xFFFFFFFF
        for k in range(1, NODE_WIDTH):
            np.add(left[k - 1], right[: NODE_WIDTH - k], out=sums[: NODE_WIDTH - k, :m])
            bits = sums.view(np.uint32)[: NODE_WIDTH - k, :m]
            bits &= keep
            bits |= np.uint32(k)
            np.minimum(best[k:], bits, out=best[k:])
        areas = np.maximum(tree.areas[tree.triangle_count + first : tree.triangle_count + end], floor)
        inner = areas * np.float32(NODE_COST) + (best[-1] & keep).view(np.float32)
        counts = tree.counts[first:end]
        leaf = np.where(counts <= max_leaf, _leaf_costs(areas, counts), np.float32(np.inf))
        one = np.minimum(leaf.view(np.uint32) & keep | np.uint32(LEAF), inner.view(np.uint32) & keep | np.uint32(INNER))
        np.minimum(best[:-1], one & keep, out=best[:-1])
        best[0] = one
        table[first:end] = best.T
    return table


def _child_costs(tree: BinaryTree, table: np.ndarray, ids: np.ndarray, floor: np.float32) -> np.ndarray:
    """best(id, 1 ..) of each id: (NODE_WIDTH, len(ids)) float32."""
    rows = table.take(ids - tree.triangle_count, axis=0, mode="clip")
    rows &= np.uint32(~CHOICE_BITS & 0xFFFFFFFF)
    triangles = np.flatnonzero(ids < tree.triangle_count)
    areas = np.maximum(tree.areas[ids[triangles]], floor)
    rows.view(np.float32)[triangles] = _leaf_costs(areas, 1)[:, None]
    return np.ascontiguousarray(rows.T).view(np.float32)


def _is_one_leaf(tree: BinaryTree, table: np.ndarray, max_leaf: int) -> bool:
    """Whether the root has one child, a leaf of all triangles; it is visited anyway and costs nothing here."""
    if tree.triangle_count == 1:
        return True
    split = (table[-1, NODE_WIDTH - 1 :] & np.uint32(~CHOICE_BITS & 0xFFFFFFFF)).view(np.float32)
    return tree.triangle_count <= max_leaf and bool(_leaf_costs(tree.areas[-1:], tree.triangle_count) <= split)


def _children(
    tree: BinaryTree, table: np.ndarray, nodes: np.ndarray, firsts: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Owner (index into `nodes`), id and first slot of the children of inner nodes, in the order of the binary tree.

    firsts : first slot of each node's triangles.
    """
    n = tree.triangle_count
    owner, ids, slots = np.arange(len(nodes)), nodes, firsts
    budget = np.full(len(nodes), NODE_WIDTH)
    position = np.zeros(len(nodes), dtype=np.int64)
    done: list[np.ndarray] = []
    while len(ids):
        # Of a triangle the index is one of another node: what is read there is not used.
        inner = np.maximum(ids - n, 0)
        k = np.where((ids >= n) & (budget > 1), table[inner, budget - 1] & CHOICE_BITS, 0).astype(np.int64)
        one = k == 0
        done.append(np.stack([owner[one] * NODE_WIDTH + position[one], ids[one], slots[one]]))
        owner, inner, slots, budget, position, k = (a[~one] for a in (owner, inner, slots, budget, position, k))
        left, right = tree.left[inner].astype(np.int64), tree.right[inner].astype(np.int64)
        ids = np.concatenate([left, right])
        slots = np.concatenate([slots, slots + _triangle_counts(tree, left)])
        owner = np.concatenate([owner, owner])
        position = np.concatenate([position, position + k])
        budget = np.concatenate([k, budget - k])
    place, ids, slots = np.concatenate(done, axis=1)
    order = np.argsort(place)
    return place[order] // NODE_WIDTH, ids[order], slots[order]


def _leaf_order(tree: BinaryTree, leaf: np.ndarray, ids: np.ndarray) -> np.ndarray:
    """prim_ids in the order of the leaves' slots, ascending in each leaf.

    leaf, ids : (leaf_count,) int64, first slot and id of each leaf.
    """
    n = tree.triangle_count
    keys: list[np.ndarray] = []
    while len(ids):
        triangles = ids < n
        keys.append(leaf[triangles] << 32 | ids[triangles])
        inner = ids[~triangles] - n
        leaf = np.concatenate([leaf[~triangles]] * 2)
        ids = np.concatenate([tree.left[inner], tree.right[inner]]).astype(np.int64)
    ordered = np.sort(np.concatenate(keys))
    return (ordered & 0xFFFFFFFF).astype(np.uint32)
