"""Integrals of light over directions and emitters in float64, of the BRDF of light_twin.py."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from light_twin import brdf, distribution_of_normals
from mode_worlds import Part

from clrast.scene.model import Material


def frame_of(n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two float64 unit vectors beside n, by cross products with an axis."""
    t = np.cross(np.eye(3)[np.argmin(abs(n))], n)
    t /= np.sqrt((t * t).sum())
    return t, np.cross(n, t)


def ggx_nodes(n: np.ndarray, alpha: float, count: int, turns: int) -> tuple[np.ndarray, np.ndarray]:
    """Normals (count * turns, 3) about n, and their solid angles.

    With tan^2 = alpha^2 (1 - w^2) / w^2 D cos dh = 2w dw dturn; w at the points of Gauss and Legendre.
    """
    points, weights = np.polynomial.legendre.leggauss(count)
    w, turn = (points + 1) / 2, (np.arange(turns) + 0.5) / turns
    cosine = w / np.sqrt(w**2 + alpha**2 * (1 - w**2))
    sine = np.sqrt(1 - cosine**2)
    t, b = frame_of(n)
    angle = 2 * np.pi * turn[:, None]
    side = t * np.cos(angle) + b * np.sin(angle)
    h = n * cosine[:, None, None] + side[None] * sine[:, None, None]
    solid = weights * w / (distribution_of_normals(cosine, alpha) * cosine) / turns
    return h.reshape(-1, 3), np.repeat(solid, turns)


def directional_albedo(material: Material, cosine: float, count: int = 128, turns: int = 128) -> np.ndarray:
    """(3,) share of light that a surface sends on, seen at that cosine: of f cos over the half-sphere.

    Nodes are normals h, which light is mirrored at: dl = 4 (v . h) dh. They lie close where the lobe is high.
    """
    n = np.array((0.0, 0.0, 1.0))
    v = np.array((np.sqrt(1 - cosine * cosine), 0.0, cosine))
    h, solid = ggx_nodes(n, material.roughness**2, count, turns)
    v_h = h @ v
    to_light = 2 * v_h[:, None] * h - v
    kept = (v_h > 0) & (to_light[:, 2] > 0)
    to_light, solid, v_h = to_light[kept], solid[kept], v_h[kept]
    share = (to_light[:, 2] * 4 * v_h * solid)[:, None]
    return (brdf(material, n, v, to_light) * share).sum(axis=0)


def light_of_emitters(
    material: Material,
    points: np.ndarray,
    n: np.ndarray,
    to_viewer: np.ndarray,
    emitters: Sequence[Part],
    count: int = 24,
) -> np.ndarray:
    """(points, 3) radiance towards viewers that points (points, 3) send on of the light of parallelograms.

    n : (3,); to_viewer : (points, 3) unit. Emitters shine to both sides, nothing is in the way. Gauss and Legendre.
    """
    nodes, weights = np.polynomial.legendre.leggauss(count)
    total = np.zeros_like(points)
    for emitter in emitters:
        c = emitter.positions[0]
        u, v = emitter.positions[1] - c, emitter.positions[3] - c
        area = np.cross(u, v)
        for a, weight_a in zip((nodes + 1) / 2, weights / 2, strict=True):
            for b, weight_b in zip((nodes + 1) / 2, weights / 2, strict=True):
                way = c + a * u + b * v - points
                distance2 = (way * way).sum(-1, keepdims=True)
                to_light = way / np.sqrt(distance2)
                cosine = np.maximum((to_light * n).sum(-1, keepdims=True), 0)
                seen = abs((to_light * area).sum(-1, keepdims=True)) / distance2 * (weight_a * weight_b)
                f = brdf(material, n, to_viewer, to_light)
                total += np.array(emitter.material.emissive) * np.where(cosine > 0, f, 0) * cosine * seen
    return total
