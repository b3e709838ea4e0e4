"""Rays through mirrors and glass in float64, one at a time: what mode whitted shows of smooth and unlit surfaces.

    mirror, metal or plastic: F = f0 + (1 - f0) (1 - cos)^5; glass: Fresnel's unpolarized share, Snell's direction,
    the base colour at each passage; what blends lets 1 - alpha pass; a headlight shows the rest of a smooth surface.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from clrast.scene.model import Material, Scene

LEAST_WEIGHT = 2.0**-10


def fresnel(cosine: float, n1: float, n2: float) -> tuple[float, float]:
    """Share of unpolarized light that is reflected from n1 to n2, and the cosine beyond (0 where all is)."""
    sine = n1 / n2 * math.sqrt(max(1 - cosine * cosine, 0.0))
    if sine >= 1:
        return 1.0, 0.0
    beyond = math.sqrt(1 - sine * sine)
    s = (n1 * cosine - n2 * beyond) / (n1 * cosine + n2 * beyond)
    p = (n1 * beyond - n2 * cosine) / (n1 * beyond + n2 * cosine)
    return (s * s + p * p) / 2, beyond


def unit(v: np.ndarray) -> np.ndarray:
    return v / math.sqrt(float(v @ v))


@dataclass
class Surface:
    """What a ray meets: triangle, point, normals on the viewer's side, colour there."""

    prim: int
    point: np.ndarray
    g: np.ndarray
    n: np.ndarray
    is_front: bool
    base: np.ndarray
    material: Material


class Tracer:
    """`least` : the least barycentric of all that the last ray tree met, and its distance from missing things."""

    def __init__(self, scene: Scene, max_depth: int) -> None:
        self.scene, self.max_depth, self.least = scene, max_depth, 1.0
        corners = scene.positions.astype(np.float64)[scene.triangles]
        self.p0, self.e, self.f = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        self.area = np.cross(self.e, self.f)
        self.size = (self.area * self.area).sum(-1)
        self.sky = np.array(scene.environment or (0.0, 0.0, 0.0))

    def meet(self, start: np.ndarray, d: np.ndarray, own: int) -> Surface | None:
        with np.errstate(divide="ignore", invalid="ignore"):
            t = ((self.p0 - start) * self.area).sum(-1) / (self.area @ d)
            at = start + t[:, None] * d - self.p0
            b1 = (np.cross(at, self.f) * self.area).sum(-1) / self.size
            b2 = (np.cross(self.e, at) * self.area).sum(-1) / self.size
        inside = np.minimum(np.minimum(b1, b2), 1 - b1 - b2)
        ahead = (t > 0) & np.isfinite(t)
        if own >= 0:
            ahead[own] = False
        self.least = min(self.least, float(abs(inside[ahead]).min(initial=1.0)))
        if not (ahead & (inside > 0)).any():
            return None
        k = int(np.argmin(np.where(ahead & (inside > 0), t, np.inf)))
        weights = np.array((1 - b1[k] - b2[k], b1[k], b2[k]))
        return self.surface(k, start + t[k] * d, weights, d)

    def surface(self, k: int, point: np.ndarray, weights: np.ndarray, d: np.ndarray) -> Surface:
        owners, material = self.scene.triangles[k], self.scene.materials[self.scene.material_ids[k]]
        g = unit(self.area[k])
        side = 1.0 if g @ d < 0 else -1.0
        n, base = g, np.array(material.base_color)
        if self.scene.normals is not None and self.scene.normals[owners].any(axis=1).all():
            n = unit(weights @ self.scene.normals[owners].astype(np.float64))
        if self.scene.colors is not None:
            base = base * (weights @ self.scene.colors[owners].astype(np.float64))
        return Surface(k, point, g * side, n * side, side > 0, base, material)

    def radiance(
        self, start: np.ndarray, d: np.ndarray, depth: int = 0, own: int = -1, weight: float = 1.0
    ) -> np.ndarray:
        """RGB that arrives along d; of the camera's own ray nothing where it meets nothing."""
        d = unit(d)
        s = self.meet(start, d, own)
        if s is None:
            return self.sky if depth else np.zeros(3)
        m, colour = s.material, s.base[:3]
        alpha = float(s.base[3]) if m.alpha_mode == "BLEND" else 1.0
        if m.unlit:
            total = alpha * colour
            return total + self.follow(s, d, d, 1 - alpha, np.ones(3), depth, weight)
        cosine = float(max(-(s.n @ d), 0.0))
        glass = m.transmission
        is_smooth = m.roughness <= 0.04 or glass > 0
        diffuse = (1 - glass if glass else 1 - m.metallic) if is_smooth else 1.0
        total = alpha * (np.array(m.emissive) + colour * abs(float(s.n @ d)) * diffuse)
        total = total + self.follow(s, d, d, 1 - alpha, np.ones(3), depth, weight)
        if not is_smooth:
            return total
        if not glass:
            f0 = colour * m.metallic + ((m.ior - 1) / (m.ior + 1)) ** 2 * (1 - m.metallic)
            share = f0 + (1 - f0) * (1 - cosine) ** 5
            return total + self.follow(s, d, self.mirrored(s, d), alpha, share, depth, weight)
        n1, n2 = (1.0, m.ior) if s.is_front else (m.ior, 1.0)
        share, beyond = fresnel(cosine, n1, n2)
        total = total + self.follow(s, d, self.mirrored(s, d), alpha * glass * share, np.ones(3), depth, weight)
        bent = n1 / n2 * d + (n1 / n2 * cosine - beyond) * s.n
        onwards = bent if float(bent @ s.g) < 0 else d
        return total + self.follow(s, d, onwards, alpha * glass * (1 - share), colour, depth, weight)

    def mirrored(self, s: Surface, d: np.ndarray) -> np.ndarray:
        r = d - 2 * float(d @ s.n) * s.n
        return r if float(r @ s.g) > 0 else d - 2 * float(d @ s.g) * s.g

    def follow(
        self, s: Surface, d: np.ndarray, onwards: np.ndarray, share: float, tint: np.ndarray, depth: int, weight: float
    ) -> np.ndarray:
        """What a ray that goes on brings; one that can bring too little to the pixel is not traced."""
        largest = weight * share * float(tint.max())
        if depth == self.max_depth or largest <= LEAST_WEIGHT:
            return np.zeros(3)
        return share * tint * self.radiance(s.point, onwards, depth + 1, s.prim, largest)
