"""Polygons to triangles, and normals of a mesh: what several readers need, without loops over faces."""

from __future__ import annotations

import numpy as np


def fan_triangles(corner_counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of polygons that lie one behind the other in a list of corners, each fanned in place as (0, k, k+1).

    corner_counts : (polygon_count,) corners of each polygon; one with fewer than 3 gives no triangle
    Returns (triangle_count, 3) int64 places in the list of corners, in the order of the polygons,
    and (triangle_count,) int64, the polygon of each triangle.
    """
    counts = np.asarray(corner_counts, np.int64)
    if len(counts) and (counts == 3).all():
        return np.arange(3 * len(counts), dtype=np.int64).reshape(-1, 3), np.arange(len(counts), dtype=np.int64)
    first_corners = np.cumsum(counts) - counts
    triangle_counts = np.maximum(counts - 2, 0)
    polygons = np.repeat(np.arange(len(counts), dtype=np.int64), triangle_counts)
    first_triangles = np.cumsum(triangle_counts) - triangle_counts
    steps = np.arange(len(polygons), dtype=np.int64) - first_triangles[polygons]
    apexes = first_corners[polygons]
    return np.stack((apexes, apexes + steps + 1, apexes + steps + 2), axis=1), polygons


def unit_rows(vectors: np.ndarray) -> np.ndarray:
    """(n, 3) float32 of unit length from (n, 3) vectors; zero stays zero, what is not finite becomes NaN."""
    v = np.asarray(vectors, np.float64)
    largest = np.maximum(np.maximum(np.abs(v[:, 0]), np.abs(v[:, 1])), np.abs(v[:, 2]))
    largest = np.where(largest == 0.0, 1.0, largest)
    with np.errstate(invalid="ignore"):
        x, y, z = v[:, 0] / largest, v[:, 1] / largest, v[:, 2] / largest
        length = np.sqrt(x * x + y * y + z * z)
    length = np.where(length == 0.0, 1.0, length)
    return np.stack((x / length, y / length, z / length), axis=1).astype(np.float32)


def smooth_normals(positions: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Vertex normals: the sum of the normals of the faces round a place, each weighted by its area.

    positions : (vertex_count, 3) float64; vertices in bitwise the same place share their normal
    triangles : (triangle_count, 3) vertex indices
    Returns (vertex_count, 3) float32, unit length, zero where the faces cancel or there are none.
    Sums run in the order of the triangles, in float64 (bincount adds one by one).
    """
    p = np.asarray(positions, np.float64) + 0.0  # -0 and 0 are the same place
    _, place = np.unique(p.view(np.uint64).reshape(-1, 3), axis=0, return_inverse=True)
    place = place.reshape(-1)
    a, b, c = p[triangles[:, 0]], p[triangles[:, 1]], p[triangles[:, 2]]
    u, v = b - a, c - a
    sums = []
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        face = np.repeat(u[:, i] * v[:, j] - u[:, j] * v[:, i], 3)
        sums.append(np.bincount(place[triangles.reshape(-1)], weights=face, minlength=len(p))[place])
    return unit_rows(np.stack(sums, axis=1))
