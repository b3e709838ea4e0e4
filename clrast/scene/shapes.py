"""Shapes that a scene card can name. Each fills the box from -0.5 to 0.5 and is seen from outside counter-clockwise.

From + - * / sqrt in float64, and Python's sine and cosine for the rings of `sphere`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Shape:
    """positions, normals : (vertex_count, 3) float64; uv : (vertex_count, 2) float64, v down, or None;
    triangles : (triangle_count, 3) uint32; normals are None where faces are flat."""

    positions: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray | None = None
    uv: np.ndarray | None = None


_SQUARE_UV = ((0.0, 1.0), (1.0, 1.0), (1.0, 0.0), (0.0, 0.0))


def plane() -> Shape:
    """The unit square at y = 0, seen from above: two triangles; u along x, v along z."""
    positions = np.array([(-0.5, 0, 0.5), (0.5, 0, 0.5), (0.5, 0, -0.5), (-0.5, 0, -0.5)], np.float64)
    return Shape(positions, np.array([(0, 1, 2), (0, 2, 3)], np.uint32), None, np.array(_SQUARE_UV, np.float64))


def box() -> Shape:
    """The unit cube: 12 triangles, four vertices on each side, so that each side has the whole texture."""
    positions: list[list[float]] = []
    triangles: list[tuple[int, int, int]] = []
    for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1), (2, 1), (2, -1)):
        # `right` and `up` lie in the side, right x up points outwards; up is +y except on top and bottom
        up_axis = 2 if axis == 1 else 1
        up_sign = -sign if axis == 1 else 1
        right_axis = 3 - axis - up_axis
        cyclic = (right_axis, up_axis, axis) in ((0, 1, 2), (1, 2, 0), (2, 0, 1))
        right_sign = sign * up_sign * (1 if cyclic else -1)
        first = len(positions)
        for u, v in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)):
            corner = [0.0, 0.0, 0.0]
            corner[axis], corner[right_axis], corner[up_axis] = 0.5 * sign, right_sign * u, up_sign * v
            positions.append(corner)
        triangles += [(first, first + 1, first + 2), (first, first + 2, first + 3)]
    uv = np.array(_SQUARE_UV * 6, np.float64)
    return Shape(np.array(positions, np.float64), np.array(triangles, np.uint32), None, uv)


def sphere(segments: int = 48, rings: int = 24) -> Shape:
    """A sphere of meridians and parallels: 2 * segments * (rings - 1) triangles.

    u grows eastwards from the seam at -x, v downwards from the pole at +y.
    """
    positions, uv = [], []
    for j in range(rings + 1):
        polar = math.pi * j / rings
        height, radius = math.cos(polar), 0.0 if j in (0, rings) else math.sin(polar)
        for i in range(segments + 1):
            turn = 2.0 * math.pi * (i % segments) / segments  # the seam closes bit for bit
            positions.append((-radius * math.cos(turn), height, radius * math.sin(turn)))
            uv.append((i / segments, j / rings))
    triangles = []
    for j in range(rings):
        for i in range(segments):
            a = j * (segments + 1) + i
            b = a + segments + 1
            if j > 0:
                triangles.append((a, b, a + 1))
            if j < rings - 1:
                triangles.append((b, b + 1, a + 1))
    normals = np.array(positions, np.float64)
    return Shape(0.5 * normals, np.array(triangles, np.uint32), normals, np.array(uv, np.float64))


def icosphere(subdivisions: int = 4) -> Shape:
    """A sphere of 20 * 4^subdivisions near-equal triangles, from an icosahedron by halving edges."""
    golden = (1.0 + math.sqrt(5.0)) / 2.0
    corners = []
    for a in (-1.0, 1.0):
        for b in (-golden, golden):
            corners += [(0.0, a, b), (a, b, 0.0), (b, 0.0, a)]
    positions = _on_unit_sphere(np.array(corners, np.float64))
    triangles = _hull_of_icosahedron(positions)
    for _ in range(subdivisions):
        a, b, c = triangles.T
        edges = np.concatenate([np.stack((a, b)), np.stack((b, c)), np.stack((c, a))], axis=1)
        low, high = np.minimum(edges[0], edges[1]), np.maximum(edges[0], edges[1])
        keys, number = np.unique(low * len(positions) + high, return_inverse=True)
        middle = positions[keys // len(positions)] + positions[keys % len(positions)]
        ab, bc, ca = (number.reshape(3, -1) + len(positions)).astype(np.int64)
        positions = np.concatenate([positions, _on_unit_sphere(middle)])
        quarters = [np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        triangles = np.stack(quarters, axis=1).reshape(-1, 3)
    return Shape(0.5 * positions, triangles.astype(np.uint32), positions)


def _on_unit_sphere(points: np.ndarray) -> np.ndarray:
    x, y, z = points[:, 0], points[:, 1], points[:, 2]
    return points / np.sqrt(x * x + y * y + z * z)[:, None]


def _hull_of_icosahedron(corners: np.ndarray) -> np.ndarray:
    """Its 20 faces, counter-clockwise from outside: the triples of corners that are neighbours of one another."""
    faces = []
    edge = 1.2  # neighbours are 1.05 apart, others 1.70 or 2
    for i in range(12):
        for j in range(i + 1, 12):
            for k in range(j + 1, 12):
                p, q, r = (corners[n].tolist() for n in (i, j, k))
                if max(math.dist(p, q), math.dist(q, r), math.dist(r, p)) < edge:
                    volume = (
                        p[0] * (q[1] * r[2] - q[2] * r[1])
                        + p[1] * (q[2] * r[0] - q[0] * r[2])
                        + p[2] * (q[0] * r[1] - q[1] * r[0])
                    )
                    faces.append((i, j, k) if volume > 0 else (i, k, j))
    return np.array(faces, np.int64)
