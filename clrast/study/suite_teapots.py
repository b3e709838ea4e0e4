"""Finely tessellated teapots of our own drawing: in a room, and in rows that hide one another."""

from __future__ import annotations

import numpy as np

from clrast.scene.model import Camera
from clrast.study.suite_meshes import (
    Mesh,
    Part,
    Plan,
    Vector,
    at,
    box,
    circle,
    curve,
    detail,
    join,
    lamp,
    paint,
    revolve,
    slab,
    sun,
    sweep,
)

BODY = (
    (0.02, 0.03), (0.50, 0.03), (0.56, 0.0), (0.61, 0.03), (0.60, 0.09), (0.78, 0.22), (0.96, 0.43), (1.00, 0.66),
    (0.93, 0.90), (0.78, 1.08), (0.63, 1.17), (0.60, 1.22), (0.63, 1.26), (0.58, 1.28), (0.02, 1.27),
)  # fmt: skip
"""(radius, height) of the pot, whose belly has the radius 1; it stands on y = 0."""

LID = (
    (0.02, 1.25), (0.54, 1.26), (0.57, 1.29), (0.52, 1.34), (0.36, 1.41), (0.17, 1.46), (0.075, 1.50), (0.070, 1.55),
    (0.13, 1.60), (0.155, 1.665), (0.12, 1.73), (0.02, 1.75),
)  # fmt: skip

SPOUT = ((0.80, 0.42, 0.27), (1.08, 0.50, 0.24), (1.30, 0.74, 0.16), (1.45, 1.03, 0.115), (1.72, 1.27, 0.10))
"""(x, y, radius) along it; it begins inside the pot."""

LEVELS = (0.0, 1.45, 2.9)
"""Heights of the shelves of a rack."""

HANDLE = ((-0.66, 0.98), (-1.16, 1.08), (-1.55, 0.99), (-1.63, 0.75), (-1.42, 0.48), (-1.08, 0.34), (-0.66, 0.32))

GLAZES = (
    paint("celadon", 0.36, 0.50, 0.38, 0.45),
    paint("cobalt", 0.07, 0.14, 0.42, 0.4),
    paint("oxblood", 0.42, 0.06, 0.045, 0.4),
    paint("cream", 0.78, 0.70, 0.54, 0.5),
    paint("ochre", 0.62, 0.36, 0.08, 0.55),
    paint("slate", 0.16, 0.18, 0.21, 0.4),
)
WOOD = paint("wood", 0.34, 0.19, 0.09, 0.7)
FLOOR = paint("floor", 0.42, 0.37, 0.32, 0.9)
WALL = paint("wall", 0.66, 0.63, 0.56)
SIDE = paint("side wall", 0.40, 0.50, 0.55)


def teapot(scale: float) -> Mesh:
    """Pot, lid, spout and handle: four closed solids that reach into one another; some 29 000 triangles at 1."""
    segments, sides = detail(132, scale, 8), detail(36, scale, 5)
    rim = circle(sides)
    spout = curve(SPOUT, detail(40, scale, 4))
    handle = curve(HANDLE, detail(48, scale, 6))
    return join([
        revolve(curve(BODY, detail(60, scale, len(BODY) - 1)), segments),
        revolve(curve(LID, detail(24, scale, len(LID) - 1)), segments),
        sweep([(x, y) for x, y, _ in spout], rim, [radius for _, _, radius in spout]),
        sweep(handle, [(0.07 * c, 0.12 * s) for c, s in rim]),
    ])  # fmt: skip


class _Shelf:
    """Puts teapots where they are asked for, in colours by turns and turned by draws."""

    def __init__(self, scale: float, seed: int) -> None:
        self.mesh = teapot(scale)
        self.random = np.random.Generator(np.random.PCG64(seed))
        self.parts: list[Part] = []

    def put(self, position: Vector, size: float, degrees: float | None = None) -> None:
        """degrees : turn about the vertical, spout to +x at 0; None draws one."""
        drawn = 360.0 * float(self.random.random())
        number = len(self.parts)
        part = Part(f"teapot {number}", GLAZES[(5 * number + number // 6) % len(GLAZES)].name, smooth=True)
        part.add(self.mesh, at(*position, size, drawn if degrees is None else degrees))
        self.parts.append(part)

    def jitter(self, reach: float) -> float:
        return reach * (2.0 * float(self.random.random()) - 1.0)


def _room(x: float, y: float, z0: float, z1: float) -> list[Part]:
    """The inside of a box from -x to x, 0 to y, z0 to z1, as pairs of large triangles."""
    return [
        slab("floor", FLOOR, (-x, 0.0, z1), (x, 0.0, z1), (x, 0.0, z0), (-x, 0.0, z0)),
        slab("ceiling", WALL, (-x, y, z0), (x, y, z0), (x, y, z1), (-x, y, z1)),
        slab("back wall", WALL, (-x, 0.0, z0), (x, 0.0, z0), (x, y, z0), (-x, y, z0)),
        slab("front wall", WALL, (x, 0.0, z1), (-x, 0.0, z1), (-x, y, z1), (x, y, z1)),
        slab("left wall", SIDE, (-x, 0.0, z1), (-x, 0.0, z0), (-x, y, z0), (-x, y, z1)),
        slab("right wall", SIDE, (x, 0.0, z0), (x, 0.0, z1), (x, y, z1), (x, y, z0)),
    ]


def _furniture(name: str, *boxes: tuple[Vector, Vector]) -> Part:
    part = Part(name, WOOD.name)
    for low, high in boxes:
        part.add(box(low, high))
    return part


MATERIALS = (*GLAZES, WOOD, FLOOR, WALL, SIDE)


def teapots_plan(scale: float, seed: int) -> Plan:
    """A room of 8 x 3.4 x 8 metres with fourteen teapots on a table, on plinths and on the floor."""
    shelf = _Shelf(scale, seed)
    for x in (-1.35, -0.45, 0.45, 1.35):
        shelf.put((x, 0.85, -2.6 + shelf.jitter(0.06)), 0.26)
    for x in (-2.9, 2.9):
        shelf.put((x, 1.1, -2.7), 0.36)
        shelf.put((x, 0.6, -0.6), 0.42)
    for x, z in ((-1.6, -0.9), (0.1, -1.0), (1.5, -0.7), (-0.8, 0.5), (0.9, 0.7), (-2.3, 1.3)):
        shelf.put((x + shelf.jitter(0.1), 0.0, z + shelf.jitter(0.1)), 0.34 + shelf.jitter(0.05))
    legs = [((x - 0.05, 0.0, z - 0.05), (x + 0.05, 0.78, z + 0.05)) for x in (-1.8, 1.8) for z in (-3.0, -2.2)]
    furniture = [
        _furniture("table", ((-2.0, 0.78, -3.1), (2.0, 0.85, -2.1)), *legs),
        *(_furniture(f"plinth {k}", ((x - 0.45, 0.0, z - 0.45), (x + 0.45, y, z + 0.45)))
          for k, (x, y, z) in enumerate(((-2.9, 1.1, -2.7), (-2.9, 0.6, -0.6), (2.9, 1.1, -2.7), (2.9, 0.6, -0.6)))),
    ]  # fmt: skip
    return Plan(
        parts=(*_room(4.0, 3.4, -4.0, 4.0), *furniture, *shelf.parts),
        materials=MATERIALS,
        lights=(
            lamp("ceiling lamp", 11.0, 9.6, 7.6, 0.3, 2.7, 0.2),
            lamp("table lamp", 2.6, 1.9, 1.2, -0.9, 2.2, -1.7),
            sun("daylight", 1.2, 1.35, 1.6, 0.7, -0.5, -0.6),
            sun("bounce", 0.55, 0.50, 0.44, -0.4, 0.8, -0.5),
        ),
        cameras=(
            Camera("view", eye=(1.7, 1.95, 3.6), look_at=(-0.1, 0.5, -0.9), fov=58.0),
            Camera("inside", eye=(0.25, 0.42, -0.15), look_at=(-0.95, 0.40, -1.1), fov=72.0),
        ),
    )


def occluded_plan(scale: float, seed: int) -> Plan:
    """Six racks of three shelves with five teapots each, one behind another, and before them a large teapot."""
    shelf = _Shelf(scale, seed)
    shelf.put((0.1, 1.0, 0.4), 1.05, 25.0)
    shelf.mesh = teapot(0.32 * scale)
    racks = []
    for row in range(6):
        z, shift = -2.6 - 1.9 * row, 0.45 * (row % 2)
        boards = [((-4.5 + shift, y - 0.06, z - 0.75), (4.5 + shift, y, z + 0.75)) for y in LEVELS[1:]]
        posts = [((x + shift - 0.05, 0.0, z - 0.75), (x + shift + 0.05, LEVELS[-1], z + 0.75)) for x in (-4.5, 4.5)]
        racks.append(_furniture(f"rack {row}", *boards, *posts))
        for y in LEVELS:
            for column in range(5):
                x = 1.75 * (column - 2) + shift + shelf.jitter(0.12)
                shelf.put((x, y, z + shelf.jitter(0.1)), 0.60 + shelf.jitter(0.06))
    # In no order: sorted from near to far, the order of the file would do the work of occlusion culling.
    things = [_furniture("pedestal", ((-0.7, 0.0, -0.4), (0.9, 1.0, 1.2))), *racks, *shelf.parts]
    shuffled = [things[k] for k in shelf.random.permutation(len(things))]
    return Plan(
        parts=(*_room(7.0, 5.2, -15.0, 6.0), *shuffled),
        materials=MATERIALS,
        lights=(
            lamp("front lamp", 20.0, 17.5, 14.5, -2.4, 3.6, 3.0),
            lamp("back lamp", 24.0, 20.0, 14.5, 1.5, 4.0, -8.0),
            sun("daylight", 1.2, 1.35, 1.6, 0.8, -0.5, -0.5),
            sun("bounce", 0.55, 0.50, 0.44, -0.4, 0.8, -0.5),
        ),
        cameras=(
            Camera("view", eye=(0.0, 2.25, 4.5), look_at=(0.0, 2.0, -2.0), fov=46.0),
            Camera("inside", eye=(1.9, 2.1, -3.55), look_at=(-0.6, 1.75, -9.0), fov=65.0),
        ),
    )  # fmt: skip
