"""Families of random worlds that are hard on float32 and float64 decisions; nothing here says what is right.

A world is a pure function of its family and seed. Samples on edges and vertices, coincident and nearly coincident
planes, slivers, sizes from the smallest denormal to the largest float, eyes on vertices, edges and planes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from kernel_world import make_scene, orthographic, perspective

from clrast.scene.camera import CameraVectors
from clrast.scene.model import Scene

LARGEST = float(np.finfo(np.float32).max)
MAX_TRIANGLES = 40


@dataclass(frozen=True)
class World:
    """One scene and view, by the name of its family and its seed."""

    family: str
    seed: int
    scene: Scene
    view: CameraVectors

    def __str__(self) -> str:
        view, count = self.view, self.scene.triangle_count
        return f"{self.family} {self.seed}: {count} triangles, {view.projection} {view.width}x{view.height}"


# --- families: (3 count, 3) float64 positions -----------------------------------------------------------


def short_numbers(rng: np.random.Generator, count: int) -> np.ndarray:
    """Small integers: ties, shared vertices, samples on edges."""
    return rng.integers(-8, 9, (3 * count, 3)) - [0, 0, float(rng.choice([0, 8, 12]))]


def ordinary(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.normal(size=(3 * count, 3)) * 4 - [0, 0, 4]


def on_centers(rng: np.random.Generator, count: int) -> np.ndarray:
    """Vertices on the rays of pixel centres, at distances that are powers of two."""
    flat, depth = (rng.integers(-16, 16, (3 * count, 2)) + 0.5) / 32, 2.0 ** rng.integers(-3, 4, (3 * count, 1))
    return np.hstack([flat * depth, -depth])


def on_rays(rng: np.random.Generator, count: int) -> np.ndarray:
    """The same at distances of 17 bits, so that mantissas are full and products are rounded."""
    flat = (rng.integers(-16, 16, (3 * count, 2)) + 0.5) / 32
    depth = np.round(rng.uniform(0.5, 4, (3 * count, 1)) * 2**17) / 2**17
    return np.hstack([flat * depth, -depth])


def huge_and_tiny(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.normal(size=(3 * count, 3)) * 10.0 ** rng.uniform(-25, 20, (3 * count, 1))


def slivers(rng: np.random.Generator, count: int) -> np.ndarray:
    """Third vertices on the opposite edge, but for 1e-9 to 1e-2."""
    a = rng.normal(size=(count, 3)) * 3 - [0, 0, 5]
    b = a + rng.normal(size=(count, 3))
    off = rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(-9, -2, (count, 1))
    return np.stack([a, b, a + (b - a) * rng.uniform(0, 1, (count, 1)) + off], axis=1).reshape(-1, 3)


def coincident(rng: np.random.Generator, count: int) -> np.ndarray:
    """Triangles in one plane, but for the rounding of their vertices."""
    corners = rng.integers(-6, 7, (3, 3)) - [0.0, 0.0, 7.0]
    weights = rng.integers(0, 5, (3 * count, 3)) / 4.0
    return weights / np.maximum(weights.sum(1, keepdims=True), 1) @ corners


def one_ulp_apart(rng: np.random.Generator, count: int) -> np.ndarray:
    """The same few triangles again and again, some coordinates moved by a unit in their last place."""
    few = (rng.normal(size=(3, 3, 3)) * 2 - [0, 0, 4]).astype(np.float32)
    chosen = few[rng.integers(0, 3, count)].reshape(-1, 3)
    moved = np.nextafter(chosen, np.where(rng.random(chosen.shape) < 0.5, np.float32(-9), np.float32(9)))
    return np.where(rng.random(chosen.shape) < 0.15, moved, chosen).astype(np.float64)


def through_the_eye(rng: np.random.Generator, count: int) -> np.ndarray:
    """Vertices, edges and planes that hold the origin, where many views have their eye."""
    points = rng.integers(-4, 5, (3 * count, 3)) * 1.0
    points[rng.random(3 * count) < 0.3] = 0
    return points


def edge_on(rng: np.random.Generator, count: int) -> np.ndarray:
    """Planes that pass the origin within rounding: c is a combination of a and b."""
    a, b = rng.normal(size=(2, count, 3)) * 2 - [0, 0, 3]
    s, t = rng.uniform(-0.5, 1, (2, count, 1))
    return np.stack([a, b, s * a + t * b], axis=1).reshape(-1, 3)


def denormal(rng: np.random.Generator, count: int) -> np.ndarray:
    return (rng.normal(size=(3 * count, 3)) * 3 - [0, 0, 5]) * 1e-38


def overflowing(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.normal(size=(3 * count, 3)) * 1e37


def axis_aligned(rng: np.random.Generator, count: int) -> np.ndarray:
    """Nearly all in one plane, the rest crossing it."""
    points = rng.integers(-3, 4, (3 * count, 3)) * 1.0
    points[:, 2] = rng.choice([-4.0, -2.0, -2.0, -2.0], 3 * count)
    return points


def any_exponent(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.normal(size=(3 * count, 3)) * 10.0 ** rng.uniform(-38, 38, (3 * count, 3))


def fans(rng: np.random.Generator, count: int) -> np.ndarray:
    """Closed fans round points on rays of pixel centres: each sample there belongs to just one triangle."""
    parts, left = [], count
    while left > 0:
        n = min(left, int(rng.integers(3, 9)))
        hub = on_rays(rng, 1)[0]
        angle = np.sort(rng.uniform(0, 2 * np.pi, n))
        ring = np.stack([np.cos(angle), np.sin(angle), rng.normal(size=n) * 0.1], axis=1) * rng.uniform(0.02, 0.5)
        ring = (hub + ring).astype(np.float32).astype(np.float64)
        parts.append(np.stack([np.broadcast_to(hub, ring.shape), ring, np.roll(ring, -1, axis=0)], axis=1))
        left -= n
    return np.concatenate(parts).reshape(-1, 3)


FAMILIES: Mapping[str, Callable[[np.random.Generator, int], np.ndarray]] = {
    "short numbers": short_numbers,
    "ordinary": ordinary,
    "on centres": on_centers,
    "on rays": on_rays,
    "huge and tiny": huge_and_tiny,
    "slivers": slivers,
    "coincident": coincident,
    "one ulp apart": one_ulp_apart,
    "through the eye": through_the_eye,
    "edge-on": edge_on,
    "denormal": denormal,
    "overflowing": overflowing,
    "axis-aligned": axis_aligned,
    "any exponent": any_exponent,
    "fans": fans,
}


# --- views -----------------------------------------------------------------------------------------


def choose_eye(rng: np.random.Generator, positions: np.ndarray) -> np.ndarray:
    """The origin, a vertex, a short number, or somewhere near or far from the middle."""
    choice = rng.random()
    if choice < 0.5:
        return np.zeros(3)
    if choice < 0.65:
        return positions[rng.integers(len(positions))].astype(np.float64)
    if choice < 0.8:
        return rng.integers(-3, 4, 3) * 0.5
    size = float(np.abs(positions).max()) * rng.choice([1e-3, 1, 1e3])
    return np.clip(positions.mean(0, dtype=np.float64) + rng.normal(size=3) * size, -LARGEST, LARGEST)


def make_view(rng: np.random.Generator, positions: np.ndarray, projection: str, max_side: int) -> CameraVectors:
    """Vectors that are short numbers, or those of a random direction."""
    width, height = (int(n) for n in rng.integers(3, max_side, 2))
    step, is_short = 2.0 ** -int(rng.integers(3, 7)), rng.random() < 0.5
    right, up, back = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    if projection == "perspective":
        eye = choose_eye(rng, positions)
        if is_short:
            first = (-step * width / 2, step * height / 2, -1)
            return perspective(width, height, eye=eye, d0=first, dx=(step, 0, 0), dy=(0, -step, 0))
        first = back - right * step * width / 2 - up * step * height / 2
        return perspective(width, height, eye=eye, d0=first, dx=right * step, dy=up * step)
    if is_short:
        first = (-width * step * 4, height * step * 4, float(rng.choice([0, 5, -4])))
        return orthographic(width, height, e0=first, ex=(step * 8, 0, 0), ey=(0, -step * 8, 0))
    size = max(1e-30, min(1e30, float(np.abs(positions).max()))) / 20
    first = (back * float(rng.choice([0, -30, 5])) - right * width / 2 - up * height / 2) * size
    return orthographic(width, height, e0=first, d=back, ex=right * size, ey=up * size)


def full_mantissas(seed: int, projection: str = "perspective", side: int = 24) -> World:
    """Closed fans whose hubs lie on the rays of pixel centres exactly, all numbers in 24 random bits.

    Camera vectors are multiples of 2^-24 and steps powers of two, so that sums with places of samples stay so.
    Edges to a hub pass its sample exactly, and float64 cannot hold the products that tell.
    """
    rng = np.random.default_rng((seed, len(FAMILIES)))
    step, unit, hub_count = 2.0**-6, 2.0**-24, 12
    corner = rng.integers(-(2**22), 2**22, 3) * unit
    along = 2 * unit * rng.integers(2**20, 2**21, 3)
    if projection == "perspective":
        corner[2] = -unit * rng.integers(2**23, 2**24)
        view = perspective(side, side, d0=corner, dx=(step, 0, 0), dy=(0, -step, 0))
    else:
        view = orthographic(side, side, e0=corner, d=along, ex=(step, 0, 0), ey=(0, -step, 0))
    parts = []
    for _ in range(hub_count):
        x, y = rng.integers(2, side - 2, 2) + 0.5
        hub = corner + [x * step, -y * step, 0] + (along / 2 if projection == "orthographic" else 0)
        assert (hub.astype(np.float32) == hub).all()
        n = int(rng.integers(3, 7))
        angle = 2 * np.pi * (np.arange(n) + rng.uniform(0, 0.9, n)) / n
        ring = np.stack([np.cos(angle), np.sin(angle), rng.normal(size=n)], axis=1) * rng.uniform(0.02, 0.1)
        ring = (hub + ring).astype(np.float32).astype(np.float64)
        parts.append(np.stack([np.broadcast_to(hub, ring.shape), ring, np.roll(ring, -1, axis=0)], axis=1))
    return World("full mantissas", seed, make_scene(np.concatenate(parts).reshape(-1, 3)), view)


def make_world(family: str, seed: int, projection: str | None = None, max_side: int = 70) -> World:
    """One world; a fifth of them lies far from the origin, a third has vertices that triangles share."""
    rng = np.random.default_rng((seed, list(FAMILIES).index(family)))
    count = int(rng.integers(1, MAX_TRIANGLES))
    with np.errstate(over="ignore"):
        positions = FAMILIES[family](rng, count)
        if rng.random() < 0.2:
            positions = positions + 10.0 ** int(rng.integers(1, 9))
        positions = np.clip(positions, -LARGEST, LARGEST).astype(np.float32)
    triangles = rng.integers(0, len(positions), (count, 3)) if rng.random() < 0.3 else None
    chosen = str(rng.choice(["perspective", "orthographic"]))
    view = make_view(rng, positions, projection or chosen, max_side)
    return World(family, seed, make_scene(positions, triangles), view)
