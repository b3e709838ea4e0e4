"""Embree's sphere and plane far from the origin, and pbrt's bumpy sphere seen from inside, as views of cameras.

A sphere is seen through the six faces of a cube, so that every direction meets a sample. pbrt aims as many rays at
vertices as anywhere; here each vertex of a bumpy sphere lies exactly on the ray of a sample, those on the cube's
edges on those of two faces. Scenes alone; `single` as in conformance_worlds.py.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from conformance_worlds import FAR, Case
from kernel_world import as_float32, make_scene

from clrast.scene.camera import CameraVectors, camera_vectors
from clrast.scene.model import Camera

AXES = [np.roll(np.array([sign, 0.0, 0.0]), k) for k in range(3) for sign in (1.0, -1.0)]
EMBREE_SIDE, EMBREE_SEGMENTS = 512, (50, 200)
BUMPY_SEEDS = 10


def face(forward: np.ndarray, half: int, eye: tuple[float, float, float]) -> CameraVectors:
    """One side of a cube round the eye; samples lie at -half, ..., half of its half side, borders included."""
    side = 2 * half + 1
    right = np.roll(forward, 1) * forward.sum()
    down = np.cross(forward, right)
    first = forward - (half + 0.5) / half * (right + down)
    return CameraVectors("perspective", side, side, eye, as_float32(forward), as_float32(first),
                         as_float32(right / half), as_float32(down / half))  # fmt: skip


def far_sphere(segments: int) -> tuple[np.ndarray, np.ndarray]:
    """Embree's sphere of radius 2 round FAR: closed, its float32 vertices far from round."""
    theta, phi = np.meshgrid(np.arange(1, segments) * math.pi / segments, np.arange(2 * segments) * math.pi / segments,
                             indexing="ij")  # fmt: skip
    ring = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], axis=2).reshape(-1, 3)
    points = np.array(FAR) + 2 * np.concatenate([ring, [(0, 1, 0), (0, -1, 0)]])
    count, top, bottom = 2 * segments, len(ring), len(ring) + 1
    k = np.arange(count)
    last = (segments - 2) * count
    caps = [np.stack([0 * k + top, (k + 1) % count, k], axis=1),
            np.stack([0 * k + bottom, last + k, last + (k + 1) % count], axis=1)]  # fmt: skip
    row = (np.arange(segments - 2) * count)[:, None]
    a, b = (row + k).ravel(), (row + (k + 1) % count).ravel()
    bands = [np.stack([a, b, a + count], axis=1), np.stack([b, b + count, a + count], axis=1)]
    return points, np.concatenate(caps + bands)


def far_cases() -> Iterator[Case]:
    """6 faces x 2 tessellations of 513 x 513 rays from inside the sphere, and as many at a plane: 3.2 million.

    The sphere's vertices move by 1/128: the eye may see folds, so that counts come from real arithmetic.
    """
    eye = as_float32(FAR)
    for segments in EMBREE_SEGMENTS:
        scene = make_scene(*far_sphere(segments))
        for k, axis in enumerate(AXES):
            yield Case("Embree far", f"sphere {segments}, face {k}", scene, face(axis, EMBREE_SIDE // 2, eye))
        k = np.arange(segments + 1) / segments - 0.5
        x, z = np.meshgrid(4 * k, 4 * k)
        points = np.array(FAR) + np.stack([x.ravel(), 0 * x.ravel(), z.ravel()], axis=1)
        corner = (np.arange(segments)[:, None] * (segments + 1) + np.arange(segments)).ravel()
        quads = [corner[:, None] + at for at in ((0, 1, segments + 2), (0, segments + 2, segments + 1))]
        scene = make_scene(points, np.concatenate(quads))
        for k, (away, fov) in enumerate(((1.0, 60.0), (2.0, 30.0), (3.0, 45.0))):
            for tilt in (0.0, 0.5):
                above = tuple(c + d for c, d in zip(FAR, (tilt, away, 0.25 * tilt), strict=True))
                camera = Camera("plane", "perspective", above, FAR, (0.0, 0.0, 1.0), fov)
                view = camera_vectors(camera, EMBREE_SIDE + 1, EMBREE_SIDE + 1)
                yield Case("Embree far", f"plane {segments}, {k} tilted {tilt}", scene, view)


def bumpy_sphere(seed: int, cells: int, half: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions on a cube of half side `half`, (count, 3) int64, and triangles seen unfolded from its centre.

    cells : per side of a face. Vertices inside a face are moved at random, those on the cube's edges are shared.
    """
    rng = np.random.default_rng([seed, cells])
    step = 2 * half // cells
    spot = np.arange(cells + 1) * step - half
    u, v = (k.ravel() for k in np.meshgrid(spot, spot))
    is_inner = (abs(u) < half) & (abs(v) < half)
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    points, quads = [], []
    for axis in AXES:
        right = np.roll(axis, 1) * axis.sum()
        moved = rng.integers(-(step // 5), step // 5 + 1, size=(2, len(u))) * is_inner
        at = half * axis + (u + moved[0])[:, None] * right + (v + moved[1])[:, None] * np.cross(axis, right)
        quads.append(len(points) * (cells + 1) ** 2 + corner)
        points.append(at)
    corner = np.concatenate(quads)
    turned = rng.integers(0, 2, size=len(corner)).astype(bool)[:, None]
    a, b, c, d = (corner + k for k in (0, 1, cells + 2, cells + 1))
    first = np.where(turned, np.stack([a, b, d], axis=1), np.stack([a, b, c], axis=1))
    second = np.where(turned, np.stack([b, c, d], axis=1), np.stack([a, c, d], axis=1))
    unique, index = np.unique(np.round(np.concatenate(points)).astype(np.int64), axis=0, return_inverse=True)
    triangles = index.reshape(-1)[np.concatenate([first, second])]
    return unique, triangles[rng.permutation(len(triangles))]


def bumpy_cases(cells: int, half: int, seeds: int) -> Iterator[Case]:
    """Six views of each sphere. Radii vary by half at random: short numbers, so that vertices stay on their rays."""
    for seed in range(seeds):
        directions, triangles = bumpy_sphere(seed, cells, half)
        t = np.random.default_rng(seed).integers(2048, 4096, size=len(directions)) / 2048
        exact = directions / half * t[:, None]
        scene = make_scene(exact, triangles)
        assert (scene.positions == exact).all(), "a vertex is not a float32 number"
        for k, axis in enumerate(AXES):
            view = face(axis, half, (0.0, 0.0, 0.0))
            ahead = directions[directions @ axis.astype(np.int64) == half]
            right, down = (np.round(np.array(v) * half).astype(np.int64) for v in (view.tangent_x, view.tangent_y))
            at = np.stack([ahead @ right, ahead @ down], axis=1) + half
            name = f"{len(directions)} vertices, seed {seed}, face {k}"
            yield Case("pbrt bumpy sphere", name, scene, view, single=True, vertices=at)


def small_bumpy_cases() -> Iterator[Case]:
    """About pbrt's size: 386 vertices, 10 spheres, 998,460 rays."""
    return bumpy_cases(8, 64, BUMPY_SEEDS)


def dense_bumpy_cases() -> Iterator[Case]:
    """98,306 vertices, 1.6 million rays, 99,846 of them aimed at vertices: one in sixteen."""
    return bumpy_cases(128, 256, 1)


def large_bumpy_cases() -> Iterator[Case]:
    """98,306 vertices, 6.3 million rays, 99,846 of them aimed at vertices."""
    return bumpy_cases(128, 512, 1)
