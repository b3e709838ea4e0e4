"""piglit's exact triangles: vertices at multiples of 1/16 pixel, held against an integer rasterizer of ours.

    V of an edge from a to b at p = (b_x - a_x) (p_y - a_y) - (b_y - a_y) (p_x - a_x), in units of 1/16 pixel
    covered: the three have the sign of the area; 0 goes by the movement (+eps, +eps^2): first -(b_y - a_y), then
    b_x - a_x

No float on the way, nothing shared with kernels or with the other references. The renderer sees the triangles by an
orthographic camera whose pixel is a unit. In units of 2^-8 all that its 3D edge functions compute lies under 2^24
(coordinates from the centre under 2^11, their products under 2^22, twice a cross product and V under 2^24): float32
rounds nothing, so that every rung must be right at every sample.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from conformance_worlds import Case
from kernel_world import NO_HIT, make_scene, orthographic

SIDE = 256
RANDOM_COUNT, PER_IMAGE = 10_000, 16
UNIT = 16
"""28.4 fixed point."""
FIXED = (
    ((8, 8), (248, 8), (8, 248)),
    ((128, 8), (248, 248), (8, 248)),
    ((8, 128), (248, 8), (248, 248)),
    ((8, 8), (248, 120), (120, 248)),
)
"""Four triangles on a 16 x 16 grid of pixels, in pixels of the whole image."""


def covers(triangle: np.ndarray, side: int = SIDE) -> np.ndarray:
    """(side, side) bool; triangle : (3, 2) integers, x to the right and y down, in 1/16 pixel."""
    t = triangle.astype(np.int64)
    center = np.arange(side, dtype=np.int64) * UNIT + UNIT // 2
    x, y = center[None, :], center[:, None]
    area = (t[1, 0] - t[0, 0]) * (t[2, 1] - t[0, 1]) - (t[1, 1] - t[0, 1]) * (t[2, 0] - t[0, 0])
    if area == 0:
        return np.zeros((side, side), dtype=bool)
    inside = np.ones((side, side), dtype=bool)
    for a, b in ((t[0], t[1]), (t[1], t[2]), (t[2], t[0])):
        along_x, along_y = int(b[0] - a[0]), int(b[1] - a[1])
        value = (along_x * (y - a[1]) - along_y * (x - a[0])) * np.sign(area)
        moved = (-along_y or along_x) * int(np.sign(area))
        inside &= (value > 0) | ((value == 0) & (moved > 0))
    return inside


def random_triangles(seed: int, count: int) -> np.ndarray:
    """(count, 3, 2) in 1/16 pixel, of 1 to 256 pixels; every tenth a sliver, some without any area."""
    rng = np.random.default_rng(seed)
    size = np.round(UNIT * 2.0 ** rng.uniform(0, 8, size=(count, 1, 1))).astype(np.int64)
    place = (rng.uniform(size=(count, 1, 2)) * (UNIT * SIDE - size)).astype(np.int64)
    triangles = place + (rng.uniform(size=(count, 3, 2)) * (size + 1)).astype(np.int64)
    half = (triangles[::10, 0] + triangles[::10, 1]) // 2
    triangles[::10, 2] = half + rng.integers(-1, 2, size=half.shape)
    triangles[5::20, 2] = triangles[5::20, 1]
    triangles[15::40] = triangles[15::40, :1]
    return triangles


def integer_case(name: str, triangles: np.ndarray) -> Case:
    """Triangles behind one another, the first one nearest; `known` is what the integers say."""
    depth = np.broadcast_to(1.0 + np.arange(len(triangles))[:, None, None], (len(triangles), 3, 1))
    flat = triangles / UNIT * (1, -1)
    scene = make_scene(np.concatenate([flat, -depth], axis=2).reshape(-1, 3))
    masks = np.stack([covers(triangle) for triangle in triangles])
    ids = np.where(masks.any(axis=0), masks.argmax(axis=0), NO_HIT).astype(np.uint32)
    known = ids, masks.sum(axis=0).astype(np.int64)
    return Case("piglit triangles", name, scene, orthographic(SIDE, SIDE), known=known, rounds_nothing=True)


def integer_cases() -> Iterator[Case]:
    """4 triangles x 9 shifts, each an image of its own; then 10,000 at random, 16 behind one another in an image."""
    shifts = [(x, y) for y in (0, 5, 11) for x in (0, 7, 15)]
    for k, corners in enumerate(FIXED):
        for shift in shifts:
            one = np.array([corners], dtype=np.int64) * UNIT + np.array(shift)
            yield integer_case(f"fixed {k} shifted {shift}", one)
    triangles = random_triangles(0, RANDOM_COUNT)
    for start in range(0, RANDOM_COUNT, PER_IMAGE):
        yield integer_case(f"random {start}", triangles[start : start + PER_IMAGE])
