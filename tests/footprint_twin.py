"""What pixels cover of triangles, by finite differences in float64: nothing here is shared with the kernels.

A sample (x, y) of a view gives a ray by the formulas of the projections; it meets the planes of a chain of triangles
and is mirrored or refracted in between. Weights of the last triangle's vertices are a smooth function of (x, y), whose
derivatives are central differences.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from clrast.scene.camera import CameraVectors
from clrast.scene.model import Scene

STEP = 1e-4
"""Pixels: a central difference is off by STEP^2 / 6 of the third derivative, and by 2^-52 / STEP of the values."""

MIRRORED, REFRACTED = 0, 1


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a * b).sum(-1, keepdims=True)


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.sqrt(dot(v, v))


def rays(view: CameraVectors, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions, (..., 3) float64, of samples of the viewport, inside a disc or not."""
    first, right, up, forward, origin = (
        np.array(v, dtype=np.float64)
        for v in (view.first, view.tangent_x, view.tangent_y, view.direction, view.origin)
    )
    x, y = x[..., None], y[..., None]
    if view.projection == "perspective":
        d = first + x * right + y * up
    elif view.projection == "orthographic":
        moved = first + x * right + y * up
        return moved, np.broadcast_to(forward, moved.shape)
    elif view.projection == "latlong":
        lon, lat = 2 * np.pi * (x / view.width - 0.5), np.pi * (0.5 - y / view.height)
        d = np.cos(lat) * (np.cos(lon) * forward + np.sin(lon) * right) + np.sin(lat) * up
    else:
        half = min(view.width, view.height) / 2
        a, b = (x - view.width / 2) / half, (view.height / 2 - y) / half
        if view.projection == "paraboloid":
            d = a * right + b * up + (0.5 - (a * a + b * b) / 2) * forward
        else:
            q, k = np.hypot(a, b), 2 * np.pi * view.rim
            d = np.cos(k * q) * forward + k * np.sinc(k * q / np.pi) * (a * right + b * up)
    return np.broadcast_to(origin, d.shape), d


@dataclass(frozen=True)
class Triangles:
    """Corners and vertex normals, (count, 3, 3) float64, of one triangle for each ray. ior : (count, 1)."""

    corners: np.ndarray
    normals: np.ndarray
    ior: np.ndarray

    @classmethod
    def of(cls, scene: Scene, prims: np.ndarray) -> Triangles:
        vertices = scene.triangles[prims]
        corners = scene.positions.astype(np.float64)[vertices]
        plane = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals = np.repeat(plane[:, None], 3, axis=1)
        if scene.normals is not None:
            given = scene.normals.astype(np.float64)[vertices]
            normals = np.where((given != 0).any(axis=2).all(axis=1)[:, None, None], given, normals)
        ior = np.array([material.ior for material in scene.materials])[scene.material_ids[prims]]
        return cls(corners, normals, ior[:, None])

    @property
    def planes(self) -> np.ndarray:
        """(count, 3) normals of the triangles' planes, of any length."""
        return np.cross(self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0])

    def meet(self, origin: np.ndarray, d: np.ndarray) -> np.ndarray:
        """(count, 3) weights of the corners where a ray meets the triangle's plane, by Cramer's rule."""
        p0, e, f = self.corners[:, 0], self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0]
        q = origin - p0
        volume = dot(np.cross(e, f), d)
        b1, b2 = dot(np.cross(q, f), d) / volume, dot(np.cross(e, q), d) / volume
        return np.concatenate([1 - b1 - b2, b1, b2], axis=1)

    def at(self, weights: np.ndarray) -> np.ndarray:
        return (self.corners * weights[:, :, None]).sum(axis=1)

    def leave(self, weights: np.ndarray, d: np.ndarray, kind: np.ndarray) -> np.ndarray:
        """Unit directions, mirrored or refracted at the interpolated normal."""
        d = unit(d)
        is_front = dot(self.planes, d) <= 0
        n = unit((self.normals * weights[:, :, None]).sum(axis=1)) * np.where(is_front, 1, -1)
        cosine, ratio = -dot(n, d), np.where(is_front, 1 / self.ior, self.ior)
        mirrored = d + 2 * cosine * n
        inner = np.sqrt(np.maximum(1 - ratio * ratio * (1 - cosine * cosine), 0))
        refracted = ratio * d + (ratio * cosine - inner) * n
        return np.where(kind[:, None] == MIRRORED, mirrored, refracted)


def follow(
    view: CameraVectors, chain: list[Triangles], kinds: list[np.ndarray], x: np.ndarray, y: np.ndarray
) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """Weights on the last triangle of the chain, the unit direction that leads there, cosines on the way."""
    origin, d = rays(view, x, y)
    cosines = []
    for triangles, kind in zip(chain, kinds, strict=False):
        weights = triangles.meet(origin, d)
        cosines.append(abs(dot(unit(triangles.planes), unit(d)))[:, 0])
        origin, d = triangles.at(weights), triangles.leave(weights, d, kind)
    return chain[-1].meet(origin, d), unit(d), cosines


def difference(
    function: Callable[[np.ndarray, np.ndarray], np.ndarray], x: np.ndarray, y: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of a function of (x, y), to the right and downwards."""
    right = function(x + STEP, y) - function(x - STEP, y)
    down = function(x, y + STEP) - function(x, y - STEP)
    return right / (2 * STEP), down / (2 * STEP)
