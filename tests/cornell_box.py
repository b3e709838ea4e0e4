"""A Cornell box as numbers: one list that a scene card and another program's scene are made from. No import but math.

Lengths: the room is 2 high, wide and deep, open to the viewer at y = -1, and its lamp lies in a hole of the ceiling, as
lamps shine to both sides here. Materials are rough, so that both programs find the same light by the same means.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

Point = tuple[float, float, float]


@dataclass(frozen=True)
class Surface:
    """glTF's metallic-roughness parameters of a surface; emission is linear RGB radiance."""

    base: Point
    metallic: float = 0.0
    roughness: float = 1.0
    emission: Point = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Quad:
    """A flat face of four corners in their order, and the name of its surface."""

    corners: tuple[Point, Point, Point, Point]
    surface: str


SURFACES = {
    "white": Surface((0.73, 0.73, 0.73)),
    "red": Surface((0.63, 0.06, 0.05)),
    "green": Surface((0.14, 0.45, 0.09)),
    "lamp": Surface((0.0, 0.0, 0.0), emission=(18.0, 12.0, 5.0)),
    "brass": Surface((0.9, 0.7, 0.35), metallic=1.0, roughness=0.6),
    "plastic": Surface((0.2, 0.3, 0.7), roughness=0.5),
}
CAMERA = {"eye": (0.037, -4.4, 1.021), "look_at": (0.0, 0.0, 0.993), "up": (0.0, 0.0, 1.0), "fov": 37.0}
"""From where no pixel's centre lies on an edge between walls."""


def _ceiling(low: float, high: float) -> list[Quad]:
    """Four strips round a square hole, and the lamp in it; they face down."""
    made = []
    for x0, x1, y0, y1, surface in (
        (-1.0, low, -1.0, 1.0, "white"), (high, 1.0, -1.0, 1.0, "white"),
        (low, high, -1.0, low, "white"), (low, high, high, 1.0, "white"), (low, high, low, high, "lamp"),
    ):  # fmt: skip
        made.append(Quad(((x0, y0, 2.0), (x0, y1, 2.0), (x1, y1, 2.0), (x1, y0, 2.0)), surface))
    return made


def _block(x: float, y: float, half: float, height: float, degrees: float, surface: str) -> list[Quad]:
    """A turned box on the floor without its bottom; faces outwards."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    foot = [(x + half * (c * u - s * v), y + half * (s * u + c * v)) for u, v in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    low, high = [(*p, 0.0) for p in foot], [(*p, height) for p in foot]
    sides = [Quad((low[k], low[(k + 1) % 4], high[(k + 1) % 4], high[k]), surface) for k in range(4)]
    return [*sides, Quad((high[0], high[1], high[2], high[3]), surface)]


QUADS = [
    Quad(((-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)), "white"),
    Quad(((-1, 1, 0), (1, 1, 0), (1, 1, 2), (-1, 1, 2)), "white"),
    Quad(((-1, -1, 0), (-1, 1, 0), (-1, 1, 2), (-1, -1, 2)), "red"),
    Quad(((1, 1, 0), (1, -1, 0), (1, -1, 2), (1, 1, 2)), "green"),
    *_ceiling(-0.25, 0.25),
    *_block(-0.35, 0.3, 0.3, 1.2, 17.0, "brass"),
    *_block(0.35, -0.3, 0.3, 0.6, -18.0, "plastic"),
]


def card_text() -> str:
    """The box as a scene card."""

    def numbers(values: Point) -> str:
        return "[" + ", ".join(repr(float(value)) for value in values) + "]"

    lines = ["# A Cornell box.", "[[camera]]"]
    lines += [f"{name} = {numbers(v) if isinstance(v, tuple) else v}" for name, v in CAMERA.items()]
    for name, surface in SURFACES.items():
        lines += ["[[material]]", f'name = "{name}"', f"base_color = {numbers(surface.base)}"]
        lines += [f"metallic = {surface.metallic}", f"roughness = {surface.roughness}"]
        lines += [f"emissive = {numbers(surface.emission)}"] * any(surface.emission)
    for quad in QUADS:
        corners = ", ".join(numbers(corner) for corner in quad.corners)
        lines += ["[[mesh]]", f'material = "{quad.surface}"', f"vertices = [{corners}]"]
        lines += ["triangles = [[0, 1, 2], [0, 2, 3]]"]
    return "\n".join([*lines, ""])
