"""Closed solids and open sheets from closed formulas: what the scenes of suite.py are put together from.

Everything is float64 in + - * / and sqrt, with Python's sine and cosine in small tables: numpy's differ between
processors in the last bit. A closed mesh has for each directed edge as many edges the other way, and is seen
counter-clockwise from outside.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar, cast

import numpy as np

from clrast.scene.gltf_nodes import IDENTITY, Matrix
from clrast.scene.model import Camera, Light, Material
from clrast.scene.placement import place

Vector = tuple[float, float, float]
Profile = Sequence[tuple[float, float]]
Point = TypeVar("Point", bound=tuple[float, ...])

UP: Vector = (0.0, 1.0, 0.0)


@dataclass(frozen=True, eq=False)
class Mesh:
    """positions : (vertex_count, 3) float64; triangles : (triangle_count, 3) int64, vertex indices."""

    positions: np.ndarray
    triangles: np.ndarray

    @property
    def triangle_count(self) -> int:
        return len(self.triangles)


class Part:
    """What becomes one object of a scene: meshes of one material, each placed any number of times.

    smooth : whether normals are interpolated. Triangles come mesh by mesh, in the order in which meshes were
    first placed, and then placement by placement.
    """

    def __init__(self, name: str, material: str, smooth: bool = False) -> None:
        self.name, self.material, self.smooth = name, material, smooth
        self._placements: dict[Mesh, list[Matrix]] = {}

    def add(self, mesh: Mesh, matrix: Matrix = IDENTITY) -> None:
        self._placements.setdefault(mesh, []).append(matrix)

    @property
    def triangle_count(self) -> int:
        return sum(mesh.triangle_count * len(matrices) for mesh, matrices in self._placements.items())

    def bake(self) -> Mesh:
        """All placements as one mesh, world space, float64."""
        meshes = []
        for mesh, matrices in self._placements.items():
            m = np.array(matrices, np.float64)[:, :, None]
            x, y, z = (mesh.positions[None, :, k] for k in range(3))
            rows = [m[:, k] * x + m[:, k + 1] * y + m[:, k + 2] * z + m[:, k + 3] for k in (0, 4, 8)]
            copies = np.arange(len(matrices), dtype=np.int64)[:, None, None] * len(mesh.positions)
            triangles = (mesh.triangles[None] + copies).reshape(-1, 3)
            meshes.append(Mesh(np.stack(rows, axis=2).reshape(-1, 3), triangles))
        return join(meshes)


@dataclass(frozen=True)
class Plan:
    """A scene before its triangles are laid out: counting them costs little.

    lights : `direction` of any length, the way the light shines; cameras : the first is rendered by default
    """

    parts: tuple[Part, ...]
    materials: tuple[Material, ...]
    lights: tuple[Light, ...]
    cameras: tuple[Camera, ...]

    @property
    def triangle_count(self) -> int:
        return sum(part.triangle_count for part in self.parts)


def paint(name: str, red: float, green: float, blue: float, roughness: float = 0.9, metallic: float = 0.0) -> Material:
    """An opaque material, linear colour, lit on both sides."""
    return Material(
        name=name, base_color=(red, green, blue, 1.0), roughness=roughness, metallic=metallic, double_sided=True
    )


def sun(name: str, red: float, green: float, blue: float, *direction: float) -> Light:
    """A directional light of these lux; `direction` : x, y, z, of any length, the way it shines."""
    x, y, z = direction
    return Light(name, "directional", (red, green, blue), direction=(x, y, z))


def lamp(name: str, red: float, green: float, blue: float, *position: float) -> Light:
    """A point light of these candela."""
    x, y, z = position
    return Light(name, "point", (red, green, blue), position=(x, y, z))


def detail(count: int, scale: float, least: int) -> int:
    """How many steps a side has where `count` are meant at scale 1: triangles grow with `scale`."""
    return max(least, math.floor(count * math.sqrt(scale) + 0.5))


def circle(count: int, turns: float = 1.0, start: float = 0.0) -> list[tuple[float, float]]:
    """(cos, sin) of `count` equal steps through `turns` of a circle, from `start` turns; the end is left out."""
    angles = [2.0 * math.pi * (start + turns * k / count) for k in range(count)]
    return [(math.cos(a), math.sin(a)) for a in angles]


def curve(points: Sequence[Point], steps: int) -> list[Point]:
    """`steps` + 1 points of a smooth curve that passes through `points`, evenly in its parameter (Catmull-Rom)."""
    ends = [points[0], *points, points[-1]]
    made = []
    for k in range(steps + 1):
        place = k * (len(points) - 1) / steps
        first = min(int(place), len(points) - 2)
        t = place - first
        p, q, r, s = ends[first : first + 4]
        made.append(tuple(
            b + 0.5 * t * ((c - a) + t * ((2.0 * a - 5.0 * b + 4.0 * c - d) + t * (3.0 * (b - c) + d - a)))
            for a, b, c, d in zip(p, q, r, s, strict=True)
        ))  # fmt: skip
    return cast("list[Point]", made)


def join(meshes: Sequence[Mesh]) -> Mesh:
    """One mesh of several, in order."""
    firsts = np.cumsum([0, *(len(mesh.positions) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.positions for mesh in meshes]),
        np.concatenate([mesh.triangles + first for mesh, first in zip(meshes, firsts[:-1].tolist(), strict=True)]),
    )


def at(
    x: float, y: float, z: float, size: float | Vector = 1.0, degrees: float = 0.0, axis: Vector = UP
) -> Matrix:
    """A placement: scaled by `size`, turned by `degrees` round `axis`, then moved to x, y, z."""
    factors = size if isinstance(size, tuple) else (size, size, size)
    return place(factors, [(axis, degrees)], (x, y, z))


def moved(mesh: Mesh, matrix: Matrix) -> Mesh:
    part = Part("", "")
    part.add(mesh, matrix)
    return part.bake()


def _ring_triangles(rings: int, sides: int, wrap: bool) -> np.ndarray:
    """Triangles between successive rings of `sides` vertices; `wrap`: the last ring is followed by the first."""
    j, i = np.meshgrid(np.arange(rings if wrap else rings - 1), np.arange(sides), indexing="ij")
    here, above = j * sides, (j + 1) % rings * sides
    right = (i + 1) % sides
    a, b, c, d = here + i, here + right, above + right, above + i
    return np.stack((np.stack((a, b, c), axis=2), np.stack((a, c, d), axis=2)), axis=2).reshape(-1, 3)


def revolve(profile: Profile, segments: int, factors: np.ndarray | None = None) -> Mesh:
    """A solid of revolution round the y axis, closed at both ends by a vertex on the axis.

    profile : (radius, height) from the lower end to the upper one, radius > 0
    factors : (len(profile), segments) float64 that the radii are multiplied with: flutes, leaves; or None
    """
    turn = np.array(circle(segments), np.float64)
    radius, height = (np.array([point[k] for point in profile], np.float64)[:, None] for k in (0, 1))
    radius = radius * (np.ones((len(profile), segments)) if factors is None else factors)
    rings = np.stack((radius * turn[:, 0], height + np.zeros_like(radius), -(radius * turn[:, 1])), axis=2)
    ends = np.array([(0.0, profile[0][1], 0.0), (0.0, profile[-1][1], 0.0)], np.float64)
    return _with_ends(rings, ends)


def _with_ends(rings: np.ndarray, ends: np.ndarray) -> Mesh:
    """Rings (ring_count, sides, 3) counter-clockwise seen from the last, with a fan to a vertex at either end."""
    ring_count, sides = rings.shape[:2]
    bottom = ring_count * sides
    i = np.arange(sides, dtype=np.int64)
    right, top = (i + 1) % sides, (ring_count - 1) * sides
    fans = [
        np.stack((np.full_like(i, bottom), right, i), axis=1),
        np.stack((np.full_like(i, bottom + 1), top + i, top + right), axis=1),
    ]
    triangles = np.concatenate([_ring_triangles(ring_count, sides, False), *fans])
    return Mesh(np.concatenate([rings.reshape(-1, 3), ends]), triangles)


def sweep(
    path: Sequence[tuple[float, float]], outline: Profile, sizes: Sequence[float] | None = None, loop: bool = False
) -> Mesh:
    """A bar along a path in the plane z = 0: closed, by fans at both ends or by joining them where `loop`.

    outline : (across, along z) of the bar's section, counter-clockwise with `across` to the left of the path's
    direction and z towards the viewer; round the origin, and star-shaped seen from it
    sizes : a factor for the section at each point of the path, or None
    """
    count = len(path)
    section = np.array(outline, np.float64)
    rings = np.zeros((count, len(outline), 3), np.float64)
    for k, (x, y) in enumerate(path):
        before = path[k - 1] if loop or k > 0 else path[k]
        after = path[(k + 1) % count] if loop or k < count - 1 else path[k]
        into, out = _unit2(x - before[0], y - before[1]), _unit2(after[0] - x, after[1] - y)
        ahead = _unit2(into[0] + out[0], into[1] + out[1])
        stretch = 1.0  # at a corner the section is cut along the bisector, and longer
        if into != (0.0, 0.0) and out != (0.0, 0.0):
            stretch = 1.0 / max(0.25, ahead[0] * out[0] + ahead[1] * out[1])
        size = 1.0 if sizes is None else sizes[k]
        rings[k, :, 0] = x - section[:, 0] * (size * stretch * ahead[1])
        rings[k, :, 1] = y + section[:, 0] * (size * stretch * ahead[0])
        rings[k, :, 2] = section[:, 1] * size
    if loop:
        return Mesh(rings.reshape(-1, 3), _ring_triangles(count, len(outline), True))
    ends = np.array([(*path[0], 0.0), (*path[-1], 0.0)], np.float64)
    return _with_ends(rings, ends)


def _unit2(x: float, y: float) -> tuple[float, float]:
    length = math.sqrt(x * x + y * y)
    return (x / length, y / length) if length > 0.0 else (0.0, 0.0)


def prism(outline: Profile, depth: float) -> Mesh:
    """A convex outline (x, y), counter-clockwise, from z = 0 towards the viewer to z = `depth`: closed."""
    count = len(outline)
    positions = [(x, y, z) for z in (0.0, depth) for x, y in outline]
    triangles = []
    for i in range(count):
        j = (i + 1) % count
        triangles += [(i, j, count + j), (i, count + j, count + i)]
    for i in range(1, count - 1):
        triangles += [(0, i + 1, i), (count, count + i, count + i + 1)]
    return Mesh(np.array(positions, np.float64), np.array(triangles, np.int64))


def box(low: Vector, high: Vector) -> Mesh:
    """A box of 12 triangles: closed."""
    (a, b, c), (d, e, f) = low, high
    made = prism(((a, b), (d, b), (d, e), (a, e)), f - c)
    return Mesh(made.positions + np.array((0.0, 0.0, c)), made.triangles)


def quad(a: Vector, b: Vector, c: Vector, d: Vector) -> Mesh:
    """Two triangles, seen from where the corners go counter-clockwise."""
    return Mesh(np.array((a, b, c, d), np.float64), np.array(((0, 1, 2), (0, 2, 3)), np.int64))


def sheet(points: np.ndarray) -> Mesh:
    """An open sheet through (rows, columns, 3) points, seen from where columns go right and rows up."""
    rows, columns = points.shape[:2]
    j, i = np.meshgrid(np.arange(rows - 1), np.arange(columns - 1), indexing="ij")
    a = j * columns + i
    corners = np.stack((a, a + 1, a + columns + 1, a, a + columns + 1, a + columns), axis=2)
    return Mesh(points.reshape(-1, 3).astype(np.float64), corners.reshape(-1, 3))


def slab(name: str, material: Material, *corners: Vector) -> Part:
    """A part that is one `quad`: two large triangles."""
    part = Part(name, material.name)
    part.add(quad(*corners))
    return part
