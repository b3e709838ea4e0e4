"""Triangles in the leaves of an acceleration structure, in blocks that vectors load: cl/leaf_hits.clh.

A leaf has blocks of its own, of BLOCK_LANES places each; its last block may hold fewer triangles.
"""

from __future__ import annotations

import numpy as np

from clrast.errors import CapacityError
from clrast.opencl.layout import (
    BLOCK_LANES,
    BLOCK_WORDS,
    EMPTY_CHILD,
    LEAF_BIT,
    LEAF_SLOT,
    LEAF_SLOT_LOG2,
    MAX_LEAF_COUNT,
    NODE_WORDS,
)
from clrast.visibility.bvh import Bvh

BLOCK_BYTES = 4 * BLOCK_WORDS * BLOCK_LANES
"""Device bytes of a block."""


def blocks_of_lists(begins: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Blocks for lists of triangles.

    begins, counts : (list_count,) of whole numbers, each list's first place and its triangles. Returns (list_count,)
    int64, each list's first block; and of all blocks the first places and the numbers of triangles, uint32.
    """
    begins, counts = begins.astype(np.int64), counts.astype(np.int64)
    of_list = -(-counts // BLOCK_LANES)
    firsts = np.cumsum(of_list) - of_list
    past = BLOCK_LANES * (np.arange(int(of_list.sum())) - np.repeat(firsts, of_list))
    places = np.repeat(begins, of_list) + past
    inside = np.minimum(np.repeat(counts, of_list) - past, BLOCK_LANES)
    return firsts, places.astype(np.uint32), inside.astype(np.uint32)


def leaf_blocks(bvh: Bvh) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes as trace_rays.cl takes them, and of all blocks the first places and the numbers of triangles, uint32.

    Nodes : (node_count, NODE_WORDS) float32, boxes and then children, uint32 by their bits, leaves with the number of
    their triangles and their first block. Raises CapacityError.
    """
    is_leaf = bvh.counts > 0
    counts = bvh.counts[is_leaf].astype(np.int64)
    firsts, places, inside = blocks_of_lists(bvh.children[is_leaf] & ~np.uint32(LEAF_BIT), counts)
    most = int(counts.max(initial=0))
    if most > MAX_LEAF_COUNT or len(places) > LEAF_SLOT + 1:
        allowed = f"{LEAF_SLOT + 1} blocks of leaves, {MAX_LEAF_COUNT} triangles of a leaf"
        raise CapacityError(f"rays take at most {allowed}, here are {len(places)} and {most}: take a smaller scene")
    children = bvh.children.copy()
    children[is_leaf] = LEAF_BIT | (counts - 1) << LEAF_SLOT_LOG2 | firsts
    nodes = np.concatenate([bvh.boxes, children.view(np.float32)[:, None]], axis=1)
    nodes = np.take_along_axis(nodes, _promising_first(bvh)[:, None], axis=2)
    return nodes.reshape(-1, NODE_WORDS), places, inside


def _promising_first(bvh: Bvh) -> np.ndarray:
    """(node_count, NODE_WIDTH) int64, each node's children in the order in which rays try them that take any hit.

    Leaves first, the largest first: they end a ray soonest. Half the time of nodes' own order in Sponza.
    """
    used = bvh.children != EMPTY_CHILD
    x, y, z = np.where(used[:, None], bvh.boxes[:, 3:] - bvh.boxes[:, :3], 0.0).astype(np.float64).transpose(1, 0, 2)
    rank = np.where(bvh.counts > 0, 0, np.where(used, 1, 2))
    return np.lexsort((-(x * y + y * z + z * x), rank))
