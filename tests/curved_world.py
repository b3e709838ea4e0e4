"""Scenes and views for tests of projections that are not planar; nothing here says what is right."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from kernel_world import make_scene

from clrast.scene.camera import CameraVectors, camera_vectors
from clrast.scene.model import Camera, Scene
from clrast.visibility.sample_generator import sample_rays

CURVED = ("paraboloid", "latlong", "fisheye")
EYE, LOOK_AT, UP = (0.125, -0.25, 0.0625), (1.0, 0.5, -0.75), (0.1, 1.0, 0.2)
BOX_FACES = np.array(
    [(0, 2, 1), (1, 2, 3), (4, 5, 6), (5, 7, 6), (0, 1, 4), (1, 5, 4), (2, 6, 3), (3, 6, 7), (0, 4, 2), (2, 4, 6),
     (1, 3, 5), (3, 7, 5)]
)  # fmt: skip


def curved_view(
    projection: str,
    width: int,
    height: int,
    eye: Sequence[float] = EYE,
    look_at: Sequence[float] = LOOK_AT,
    up: Sequence[float] = UP,
    fov: float = 270.0,
) -> CameraVectors:
    """A view whose axes are in general position unless they are given."""
    camera = Camera("test", projection, tuple(eye), tuple(look_at), tuple(up), fov=fov)  # type: ignore[arg-type]
    return camera_vectors(camera, width, height)


def box(size: Sequence[float] = (3.0, 2.0, 4.0)) -> tuple[np.ndarray, np.ndarray]:
    """A closed box round the origin: edges and faces over the poles, the seam and the rim."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
    return corners * np.array(size), BOX_FACES


def ball(levels: int = 3) -> Scene:
    """A closed mesh of 8 * 4^levels triangles round the origin, with bumps: an octahedron, split at its edges."""
    corners, faces = (array.tolist() for array in _octahedron())
    for _ in range(levels):
        middles: dict[tuple[int, int], int] = {}
        split = []
        for face in faces:
            new = []
            for a, b in zip(face, face[1:] + face[:1], strict=True):
                key = (min(a, b), max(a, b))
                if key not in middles:
                    middles[key] = len(corners)
                    middle = np.add(corners[a], corners[b])
                    corners.append((middle / np.linalg.norm(middle)).tolist())
                new.append(middles[key])
            (a, b, c), (ab, bc, ca) = face, new
            split += [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
        faces = split
    rng = np.random.default_rng(5)
    return make_scene(np.array(corners) * (1 + 0.25 * rng.random((len(corners), 1))), np.array(faces))


def soup_in_box(count: int = 60, seed: int = 3) -> Scene:
    """Loose triangles of all sizes, near and far, before the walls of a box."""
    rng = np.random.default_rng(seed)
    centers = rng.normal(size=(count, 1, 3))
    centers *= rng.uniform(0.25, 1.8, (count, 1, 1)) / np.linalg.norm(centers, axis=2, keepdims=True)
    sizes = 10.0 ** rng.uniform(-2.5, 0.3, (count, 1, 1))
    loose = (centers + sizes * rng.normal(size=(count, 3, 3))).reshape(-1, 3)
    walls, faces = box()
    triangles = np.concatenate([np.arange(3 * count).reshape(-1, 3), faces + 3 * count])
    return make_scene(np.concatenate([loose, walls]), triangles)


def _octahedron() -> tuple[np.ndarray, np.ndarray]:
    corners = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)], dtype=np.float64)
    faces = [(0 if x else 1, 2 if y else 3, 4 if z else 5) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    return corners, np.array([(a, c, b) if (a + b + c) % 2 else (a, b, c) for a, b, c in faces])


def octahedron() -> Scene:
    """Corners on the axes: rays of an eye in the middle that looks along an axis meet edges and corners exactly."""
    return make_scene(*_octahedron())


def aimed_sheet(view: CameraVectors, step: int = 5, offset: int = 2, seed: int = 7) -> Scene:
    """A sheet whose corners are the directions of every `step`-th sample, at random distances, rounded to float32.

    Samples lie within rounding of its corners and of edges along rows, columns and diagonals.
    """
    columns, rows = np.arange(offset, view.width, step) + 0.5, np.arange(offset, view.height, step) + 0.5
    d = sample_rays(view, columns[None], rows[:, None]).d.astype(np.float64)
    t = np.random.default_rng(seed).uniform(2, 3, d.shape[:2])[..., None]
    inside = d.any(axis=2)
    index = np.arange(inside.size).reshape(inside.shape)
    quads = np.stack([index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]], -1)
    quads = quads[inside[:-1, :-1] & inside[:-1, 1:] & inside[1:, 1:] & inside[1:, :-1]]
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return make_scene((np.array(view.origin) + t * d).reshape(-1, 3), faces)
