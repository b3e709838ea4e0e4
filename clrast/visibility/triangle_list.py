"""The triangles of a small scene, for rays that meet each: cl/triangle_list.clh says what is found with them."""

from __future__ import annotations

import numpy as np

from clrast.opencl.layout import LIST_WORDS

UNIT = 2.0**-24

EDGE_DOUBT = 64 * UNIT
"""Of an edge's 1-norm."""

AREA_DOUBT = 512 * UNIT
"""Of the square of the longest component of a triangle's edges; both are derived in cl/triangle_list.clh."""

LEAST_EDGE = 2.0**-40
"""Doubts are those of edges of this length at least, so that they hold what underflow takes."""

NOTHING_MET = -1.0
"""In place of a doubt: nothing passes between less than 1 and more than -1."""


@np.errstate(over="ignore")
def list_triangles(corners: np.ndarray, prims: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What TriangleList of cl/triangle_list.clh takes: edges and triangles, (4 + 6 * edge_count,) and (n, LIST_WORDS).

    corners : (n, 3, 3) float32, world space. prims : (n,) uint32, their prim_id. Both are float32; what that cannot
    hold is infinite, and nothing is sure of it.
    """
    points = corners.astype(np.float64)
    low, high = points.min(axis=(0, 1)), points.max(axis=(0, 1))
    middle = ((low + high) / 2).astype(np.float32).astype(np.float64)
    points -= middle
    edges = np.roll(points, -1, axis=1) - points
    size = np.abs(edges)
    normals = np.cross(edges[:, 0], edges[:, 1])
    ends, turned, of_triangle = _shared_edges(corners)
    starts, along = ends[:, :3] - middle, ends[:, 3:] - ends[:, :3]
    is_nothing = (along[of_triangle] == 0).all(axis=2).any(axis=1)

    listed = np.zeros((len(corners), LIST_WORDS), dtype=np.float32)
    listed[:, :3] = (2 * of_triangle + turned).astype(np.uint32).view(np.float32)
    listed[:, 3:6] = normals
    listed[:, 6] = (normals * points[:, 0]).sum(axis=1)
    listed[:, 7] = EDGE_DOUBT * np.maximum(size.sum(axis=2).max(axis=1), LEAST_EDGE)
    listed[:, 8] = AREA_DOUBT * np.maximum(size.max(axis=(1, 2)), LEAST_EDGE) ** 2
    listed[is_nothing, 7] = NOTHING_MET
    listed[:, 9] = prims.astype(np.uint32).view(np.float32)
    head = [*middle, np.abs(points).max()]
    return np.concatenate([head, np.hstack([along, np.cross(starts, along)]).ravel()]).astype(np.float32), listed


def _shared_edges(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges by their ends, each once.

    Returns (edge_count, 6) float64; and of each edge of triangles, (n, 3), whether it runs the other way, and which it
    is.
    """
    starts, ends = corners.astype(np.float64), np.roll(corners, -1, axis=1).astype(np.float64)
    differ = starts != ends
    first = np.argmax(differ, axis=2)[..., None]
    turned = (np.take_along_axis(starts, first, 2) > np.take_along_axis(ends, first, 2))[..., 0]
    both = np.where(turned[..., None], np.concatenate([ends, starts], axis=2), np.concatenate([starts, ends], axis=2))
    found, places = np.unique(both.reshape(-1, 6), axis=0, return_inverse=True)
    return found, turned, places.reshape(turned.shape)
