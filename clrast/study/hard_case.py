"""What a hard case is, and the words that its builders share: short-number views, fans, grids, oblique views.

A case says what is hard about it, and which rungs of the precision ladder are expected to give wrong samples there
and which none, by methods with 3D edges. The expectations are tested; what a rung *promises* is in stress.py.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from clrast.scene.camera import CameraVectors, camera_vectors
from clrast.scene.model import Camera, Scene

Point = tuple[float, float, float]
Shape = tuple[np.ndarray, np.ndarray]
"""(vertex_count, 3) positions and (triangle_count, 3) vertex indices."""

ALL = ("fast", "ordered", "midpoint", "double", "exact")
FLOAT32 = ("fast", "ordered", "midpoint")
NO_EXACT = ("fast", "ordered", "midpoint", "double")
WIDE = ("double", "exact")
EXACT = ("exact",)

SIDE = 64
"""Width and height of most views, in pixels: a power of two, so that pixels are short numbers."""
AHEAD = Camera("ahead", "perspective", (0.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0), 90.0)
"""In a view of SIDE pixels the sample (x, y) has d = ((x - 32) / 32, (32 - y) / 32, -1), without rounding."""
OBLIQUE = Camera("oblique", "perspective", (0.3, 0.7, 2.5), (0.1, -0.2, 0.05), (0.1, 1.0, 0.2), 60.0)
"""A view none of whose numbers is short."""


@dataclass(frozen=True)
class HardCase:
    """A scene and views of it.

    hard : what is hard, one sentence. wrong, right : rungs that are expected to give wrong samples, and none.
    positions : (vertex_count, 3) float32, world space; triangles : (triangle_count, 3) uint32
    """

    name: str
    hard: str
    wrong: tuple[str, ...]
    right: tuple[str, ...]
    positions: np.ndarray
    triangles: np.ndarray
    cameras: tuple[Camera, ...]
    size: tuple[int, int] = (SIDE, SIDE)

    def scene(self) -> Scene:
        """The case as a scene of one material; its cameras are in it."""
        nothing = np.zeros(len(self.triangles), dtype=np.uint32)
        return Scene(
            positions=self.positions,
            triangles=self.triangles,
            object_ids=nothing,
            material_ids=nothing,
            cameras=self.cameras,
            object_names=(self.name,),
            image_size=self.size,
            name=self.name,
        )


Built = tuple[Shape, Sequence[Camera]]
Builder = Callable[[], Built]


@dataclass(frozen=True)
class Recipe:
    """A case that is not built yet."""

    name: str
    hard: str
    wrong: tuple[str, ...]
    right: tuple[str, ...]
    build: Builder
    size: tuple[int, int]

    def make(self) -> HardCase:
        (positions, triangles), cameras = self.build()
        return HardCase(
            self.name,
            self.hard,
            self.wrong,
            self.right,
            np.asarray(positions, dtype=np.float64).reshape(-1, 3).astype(np.float32),
            np.asarray(triangles).reshape(-1, 3).astype(np.uint32),
            tuple(cameras),
            self.size,
        )


class Family:
    """Recipes in the order in which a module writes them down."""

    def __init__(self) -> None:
        self.recipes: list[Recipe] = []

    def case(
        self,
        name: str,
        hard: str,
        *,
        wrong: tuple[str, ...] = (),
        right: tuple[str, ...] = EXACT,
        size: tuple[int, int] = (SIDE, SIDE),
    ) -> Callable[[Builder], Builder]:
        """Decorates a function that builds the case's shape and its cameras."""

        def add(build: Builder) -> Builder:
            self.recipes.append(Recipe(name, hard, wrong, right, build, size))
            return build

        return add


def at(x: float, y: float, depth: float = 4.0) -> Point:
    """The world point that AHEAD sees at (x, y) pixels; exact for short numbers."""
    return ((x - 32.0) * depth / 32.0, (32.0 - y) * depth / 32.0, -depth)


def orthographic(camera: Camera, height: float) -> Camera:
    return replace(camera, name=f"{camera.name} orthographic", projection="orthographic", height=height)


def swept(camera: Camera, x: np.ndarray, y: np.ndarray, depth: np.ndarray, size: int = SIDE) -> np.ndarray:
    """(..., 3) float64: where the sample rays at (x, y) pixels of a square view are at a depth."""
    view: CameraVectors = camera_vectors(camera, size, size)
    vectors = [np.array(v) for v in (view.first, view.tangent_x, view.tangent_y, view.origin, view.direction)]
    first, dx, dy, origin, direction = vectors
    ray = first + x[..., None] * dx + y[..., None] * dy
    if view.projection == "perspective":
        return origin + depth[..., None] * ray
    return ray + depth[..., None] * direction


def fan(hub: Point, rim: Sequence[Point]) -> Shape:
    """A closed fan: vertex 0 is the hub."""
    count = len(rim)
    triangles = [(0, k + 1, (k + 1) % count + 1) for k in range(count)]
    return np.array([hub, *rim], dtype=np.float64), np.array(triangles)


def join(shapes: Sequence[Shape]) -> Shape:
    """Shapes as one, in their order."""
    counts = np.cumsum([0, *(len(positions) for positions, _ in shapes)])
    triangles = [np.asarray(part[1]) + first for part, first in zip(shapes, counts, strict=False)]
    return np.concatenate([positions for positions, _ in shapes]), np.concatenate(triangles)


def loose(corners: np.ndarray) -> Shape:
    """(triangle_count, 3, 3) corners as triangles that share no vertex."""
    positions = np.asarray(corners, dtype=np.float64).reshape(-1, 3)
    return positions, np.arange(len(positions)).reshape(-1, 3)


def grid(points: np.ndarray) -> Shape:
    """(rows, columns, 3) points as a sheet, two triangles a quad, whose diagonals alternate."""
    rows, columns = points.shape[:2]
    triangles = []
    for j in range(rows - 1):
        for i in range(columns - 1):
            a, b, c, d = j * columns + i, (j + 1) * columns + i, (j + 1) * columns + i + 1, j * columns + i + 1
            triangles += [(a, b, c), (a, c, d)] if (i + j) % 2 else [(a, b, d), (b, c, d)]
    return points.reshape(-1, 3), np.array(triangles)


def ring(count: int, radius: float, x: float, y: float, step: float = 2.0) -> list[tuple[float, float]]:
    """Points round (x, y), counter-clockwise on the screen, rounded to 1/step pixel."""
    found = []
    for k in range(count):
        angle = 2.0 * math.pi * k / count
        px, py = x + radius * math.cos(angle), y - radius * math.sin(angle)
        found.append((math.floor(step * px + 0.5) / step, math.floor(step * py + 0.5) / step))
    return found


def blob(seed: int, count: int, size: float = 0.4, spread: float = 0.5) -> np.ndarray:
    """(count, 3, 3) float64: triangles round the origin, the same numbers on every machine."""
    centers, corners = noise(seed, count, 1, 3), noise(seed + 1, count, 3, 3)
    return 2.0 * spread * centers + 2.0 * size * corners


def noise(seed: int, *shape: int) -> np.ndarray:
    """Numbers in -1..1, denser in the middle: Python's generator, whose sequence no version changes."""
    source = random.Random(seed)
    count = math.prod(shape)
    return np.array([source.random() + source.random() - 1.0 for _ in range(count)]).reshape(shape)
