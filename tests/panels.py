"""Square panels side by side, one material each, seen so that every pixel's surface point is a short number."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from kernel_world import make_scene, orthographic

from clrast.scene.camera import CameraVectors
from clrast.scene.model import Material, Scene

SIDE = 16
"""Pixels of a panel's side; a power of two, so that barycentrics are exact in float32."""


def panel_scene(
    materials: Sequence[Material],
    uv: Sequence[tuple[float, float, float, float]] | None = None,
    depth: float = 4.0,
    rotation: int = 0,
    **fields: Any,
) -> Scene:
    """Panels from left to right at distance `depth`, each of two triangles, upper right and lower left.

    uv : u at the left and right edges, v at the top and bottom edges of each panel (default 0 1 0 1).
    rotation : of the vertices within each triangle. Vertices are the corners of a panel from its top left on,
    clockwise, so the panels show their backs.
    """
    count = len(materials)
    corners = np.array([(0, 0), (1, 0), (1, -1), (0, -1)]) * SIDE
    positions = np.concatenate([np.column_stack([corners + (k * SIDE, 0), np.full(4, -depth)]) for k in range(count)])
    order = np.roll([(0, 1, 2), (2, 3, 0)], rotation, axis=1)
    triangles = np.concatenate([order + 4 * k for k in range(count)])
    ranges = uv or [(0.0, 1.0, 0.0, 1.0)] * count
    made: dict[str, Any] = {
        "materials": tuple(materials),
        "material_ids": np.repeat(np.arange(count), 2).astype(np.uint32),
        "uv": np.array([p for a, b, c, d in ranges for p in ((a, c), (b, c), (b, d), (a, d))], dtype=np.float32),
    }
    return make_scene(positions, triangles, **{**made, **fields})


def panel_view(count: int) -> CameraVectors:
    """One unit a pixel, along -z from z = 0; the first panel's top left corner is the image's."""
    return orthographic(count * SIDE, SIDE)


def panel(image: np.ndarray, k: int) -> np.ndarray:
    """The pixels of panel k."""
    return image[:, k * SIDE : (k + 1) * SIDE]


def pixel_uv(uv: tuple[float, float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """u and v (SIDE, SIDE) float64 at the pixels of a panel with that range."""
    share = (np.arange(SIDE) + 0.5) / SIDE
    left, right, top, bottom = uv
    u, v = np.meshgrid(left + share * (right - left), top + share * (bottom - top))
    return u, v
