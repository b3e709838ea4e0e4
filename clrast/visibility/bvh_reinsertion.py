"""A better binary tree over triangles: subtrees move to where boxes become smaller; cl/reinsert_subtrees.cl says how.

Rays then meet a tenth (compact objects) to a fifth (architecture, whose triangles are of all sizes) fewer nodes.
"""

from __future__ import annotations

import numpy as np

from clrast.opencl import buffers, kernels
from clrast.opencl.device import Device
from clrast.opencl.layout import TREE_NODE
from clrast.visibility.bvh_collapse import BinaryTree
from clrast.visibility.loop_limits import loop_limit

ROUNDS = 2
"""How often subtrees are moved: the second round brings a quarter of what the first does."""

SHARE = 0.3
"""Of all nodes, the largest, are moved, as far as the budget goes; the others bring little."""

LIGHT = 0.7
"""What an inner node costs that has no more triangles than a leaf takes, where others cost their area: the final tree
has leaves there. With 1, large triangles are strung along the way to the root, each at a node of its own: of a scene of
small objects and 60 triangles across all of them rays met 8.6 leaves, not 3.4."""

BUDGET = 12
"""Nodes that are looked at in a round, at most, for each triangle: of a million the build then takes up to twice as
long."""

MAX_DEEPENING = 2
"""How much deeper than it was, and than the logarithm of its triangles, a tree may become."""


def can_reinsert(device: Device, triangle_count: int) -> bool:
    """Whether the device has no limit of loops, and room for the tree."""
    return loop_limit(device) is None and 2 * triangle_count * TREE_NODE.itemsize <= device.max_allocation_bytes


def reinsert_subtrees(device: Device, tree: BinaryTree, boxes: np.ndarray, max_leaf: int) -> BinaryTree:
    """The same triangles in a tree of less area; the same one where none is found.

    boxes : (6, triangle_count) float32, min x, y, z, max x, y, z of triangles, within -1 and 1. device : of which
    `can_reinsert` holds. max_leaf : triangles of a leaf of the final tree.
    """
    n = tree.triangle_count
    if n < 4:
        return tree
    nodes = np.zeros(2 * n - 1, TREE_NODE)
    nodes["low"][:n], nodes["high"][:n] = boxes[:3].T, -boxes[3:].T
    nodes["left"][n:], nodes["right"][n:], nodes["count"][:n] = tree.left, tree.right, 1
    program = kernels.build(device, "reinsert_subtrees.cl")
    on_device = {"nodes": buffers.upload(device, nodes)}
    scratch = {name: buffers.create(device, 4 * n) for name in ("waiting", "prospects")}
    program.launch("fit_tree", 1, 1, triangle_count=n, **on_device)
    for _ in range(ROUNDS):
        buffers.download(device, on_device["nodes"], TREE_NODE, len(nodes), out=nodes)
        movable = _largest(_half_areas(nodes), max(1, int(SHARE * len(nodes))))
        program.launch(
            "reinsert_subtrees",
            1,
            1,
            triangle_count=n,
            movable_count=len(movable),
            few=max_leaf,
            light=LIGHT,
            budget=min(BUDGET * n, 0xFFFFFFFF),
            movable=buffers.upload(device, movable),
            **on_device,
            **scratch,
        )
    buffers.download(device, on_device["nodes"], TREE_NODE, len(nodes), out=nodes)
    return _ordered(nodes, int(np.argmax(nodes["parent"])), tree)


def _half_areas(nodes: np.ndarray) -> np.ndarray:
    """Half the surface of nodes' boxes, float32."""
    x, y, z = np.ascontiguousarray((nodes["low"] + nodes["high"]).T)  # negated: products of two have the right sign
    return (x + y) * z + x * y + np.float32(0.0)  # -0 becomes 0, which sorts as the least


def _largest(areas: np.ndarray, count: int) -> np.ndarray:
    """Ids of the `count` largest areas, the largest first, equal ones by id: (count,) uint32."""
    keys = (~areas.view(np.uint32)).astype(np.uint64) << np.uint64(32) | np.arange(len(areas), dtype=np.uint64)
    keys.partition(count - 1)
    return np.sort(keys[:count]).astype(np.uint32)


def _ordered(nodes: np.ndarray, root: int, before: BinaryTree) -> BinaryTree:
    """The tree with its inner nodes from the deepest level to the root; `before` where that has become too deep."""
    n = before.triangle_count
    deepest = MAX_DEEPENING * max(len(before.rounds), n.bit_length())
    levels = [np.array([root])]
    while len(levels[-1]):
        if len(levels) > deepest:
            return before
        children = np.stack([nodes["left"][levels[-1]], nodes["right"][levels[-1]]], axis=1).ravel()
        levels.append(children[children >= n])
    levels = levels[-2::-1]
    inner = np.concatenate(levels)
    ids = np.arange(2 * n - 1, dtype=np.int32)
    ids[inner] = np.arange(n, 2 * n - 1)
    left, right = ids[nodes["left"][inner]], ids[nodes["right"][inner]]
    ends = tuple(np.cumsum([len(level) for level in levels]).tolist())
    counts, areas = nodes["count"][inner].astype(np.int32), _half_areas(nodes)
    return BinaryTree(left, right, counts, np.concatenate([areas[:n], areas[inner]]), ends)
