"""A town on water: blocks of houses with framed windows and tiled roofs, narrow streets, canals, bridges and boats.

Metres, y up, the pavement at y = 0. Blocks stand in rows along x; canals run along z after every third block of a
row, and one wide canal along x through the middle.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from clrast.scene.gltf_nodes import Matrix
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
    moved,
    paint,
    prism,
    quad,
    revolve,
    sheet,
    sun,
    sweep,
)

LOT = 10.5
BLOCK = 3.0 * LOT
STOREY, GROUND = 3.3, 0.5
STREET, CANAL, GRAND_CANAL = 4.6, 11.0, 24.0
WATER = -1.1
BLOCKS = 9
"""Along each side, at scale 1."""

WALLS = (
    paint("ochre wall", 0.62, 0.42, 0.20),
    paint("rose wall", 0.58, 0.30, 0.22),
    paint("cream wall", 0.68, 0.60, 0.46),
    paint("red wall", 0.44, 0.17, 0.11),
)
TILES = paint("roof tiles", 0.46, 0.18, 0.09)
TRIM = paint("white stone", 0.74, 0.71, 0.65)
GLASS = paint("panes", 0.07, 0.09, 0.12, 0.25)
SHUTTER = paint("shutters", 0.08, 0.20, 0.13)
DOOR = paint("doors", 0.20, 0.11, 0.06)
PAVING = paint("paving", 0.42, 0.39, 0.35)
SEA = paint("water", 0.08, 0.22, 0.22, 0.3)
LEAD = paint("lead", 0.36, 0.40, 0.44, 0.6)
BOAT = paint("boats", 0.03, 0.03, 0.035, 0.4)
MATERIALS = (*WALLS, TILES, TRIM, GLASS, SHUTTER, DOOR, PAVING, SEA, LEAD, BOAT)

BAR = ((-0.09, -0.03), (0.09, -0.03), (0.09, 0.10), (-0.09, 0.10))
Opening = dict[str, Mesh]
"""What one window or door adds to each material, facing +z round (0, 0, 0), the middle of its lower edge."""


def _windows() -> list[Opening]:
    """A plain one, one with shutters, and one under a round arch."""
    w, h = 0.55, 1.65
    frame = sweep([(-w, 0.0), (w, 0.0), (w, h), (-w, h)], BAR, loop=True)
    sill = box((-0.75, -0.16, 0.0), (0.75, -0.04, 0.22))
    pane = quad((-w, 0.0, 0.03), (w, 0.0, 0.03), (w, h, 0.03), (-w, h, 0.03))
    shutters = join([box((a, 0.0, 0.02), (b, h, 0.08)) for a, b in ((-1.16, -0.62), (0.62, 1.16))])
    arch = [(w, 0.0), *((w * c, 1.2 + w * s) for c, s in circle(5, 0.5)), (-w, 1.2), (-w, 0.0)]
    round_frame = sweep(arch, BAR)
    round_pane = _polygon(arch, 0.03)
    cross = join([box((-0.03, 0.0, 0.03), (0.03, h, 0.08)), box((-w, 1.0, 0.03), (w, 1.06, 0.08))])
    return [
        {TRIM.name: join([frame, sill]), GLASS.name: pane, DOOR.name: cross},
        {TRIM.name: join([frame, sill]), GLASS.name: pane, SHUTTER.name: shutters},
        {TRIM.name: join([round_frame, sill]), GLASS.name: round_pane},
    ]


def _door() -> Opening:
    w, h = 0.75, 2.1
    arch = [(w, 0.0), *((w * c, h + w * s) for c, s in circle(8, 0.5)), (-w, h), (-w, 0.0)]
    return {TRIM.name: sweep(arch, [(1.6 * a, 1.6 * z) for a, z in BAR]), DOOR.name: _polygon(arch, 0.04)}


def _polygon(outline: list[tuple[float, float]], z: float) -> Mesh:
    """A convex outline, counter-clockwise, as a flat fan."""
    fan = [(0, k, k + 1) for k in range(1, len(outline) - 1)]
    return Mesh(np.array([(x, y, z) for x, y in outline], np.float64), np.array(fan, np.int64))


def _roof() -> dict[str, Mesh]:
    """A gable over a lot, ridge along z: eaves at y = 0, centred; rows of tiles lie on both slopes."""
    half, over, height = 0.5 * LOT, 0.5 * LOT + 0.35, 2.6
    gable = moved(prism(((-half, 0.0), (half, 0.0), (0.0, height)), LOT), at(0.0, 0.0, -half))
    eaves = box((-half - 0.25, -0.35, -half - 0.02), (half + 0.25, -0.02, half + 0.02))
    rows = 9
    lines = []
    for x, y in ((over, -0.08), (0.0, height + 0.10)):
        steps = [over * (1.0 - k / rows) for k in range(2 * rows + 1)]
        lines.append([(x, y + (0.16 if k % 2 else 0.0), z) for k, z in enumerate(steps)])
    slope = sheet(np.array(lines, np.float64))
    other = moved(slope, at(0.0, 0.0, 0.0, degrees=180.0))
    return {TILES.name: join([slope, other]), TRIM.name: join([gable, eaves])}


def _chimney() -> dict[str, Mesh]:
    pot = revolve(((0.30, 1.5), (0.28, 1.9), (0.55, 2.5)), 8)
    return {TRIM.name: join([box((-0.3, -0.6, -0.3), (0.3, 1.5, 0.3)), pot])}


def _bridge(span: float) -> dict[str, Mesh]:
    """An arched bridge along x, centred: deck and two parapets."""
    rise = 0.16 * span
    steps = 10
    path = [(0.5 * span * u, rise * (1.0 - u * u)) for u in (2.0 * k / steps - 1.0 for k in range(steps + 1))]
    path = [(-0.5 * span - 1.0, -0.2), *path, (0.5 * span + 1.0, -0.2)]
    deck = sweep(path, ((-0.35, -1.5), (0.12, -1.5), (0.12, 1.5), (-0.35, 1.5)))
    rail = [(x, y + 0.5) for x, y in path]
    parapets = [moved(sweep(rail, ((-0.5, -0.1), (0.45, -0.1), (0.45, 0.1), (-0.5, 0.1))), at(0.0, 0.0, z))
                for z in (-1.45, 1.45)]  # fmt: skip
    return {TRIM.name: join([deck, *parapets])}


def _boat() -> Mesh:
    """A slender boat along x, raised at both ends; the water line at y = 0."""
    line = curve(((-4.6, 0.95, 0.08), (-3.6, 0.28, 0.4), (0.0, 0.08, 0.75), (3.4, 0.28, 0.42), (4.8, 1.15, 0.06)), 16)
    hull = [(0.30 * c, 0.9 * s) for c, s in circle(10)]
    return sweep([(x, y) for x, y, _ in line], hull, [size for _, _, size in line])


def _church() -> dict[str, Mesh]:
    """A domed church and its bell tower, within a block round the origin."""
    nave = [box((-9.0, 0.0, -6.0), (9.0, 11.0, 6.0)), box((-5.5, 0.0, -11.0), (5.5, 11.0, 11.0))]
    drum = revolve(((5.2, 10.5), (5.2, 15.0), (5.6, 15.1), (5.6, 15.6), (5.3, 15.7)), 48)
    dome = curve(((5.2, 15.6), (5.25, 17.5), (4.6, 20.0), (3.2, 22.0), (1.5, 23.2), (0.8, 23.6)), 22)
    lantern = curve(((0.75, 23.4), (0.75, 25.6), (1.0, 25.8), (0.6, 26.6), (0.05, 28.0)), 14)
    tower = [box((10.0, 0.0, 8.0), (15.0, 34.0, 13.0)), box((9.6, 34.0, 7.6), (15.4, 35.0, 13.4)),
             box((10.6, 35.0, 8.6), (14.4, 40.0, 12.4))]  # fmt: skip
    spire = moved(revolve(((2.9, 0.0), (0.04, 11.0)), 4), at(12.5, 40.0, 10.5, degrees=45.0))
    column = revolve(curve(((0.42, 0.0), (0.36, 0.5), (0.30, 6.0), (0.45, 6.6)), 12), 16)
    columns = [moved(column, at(-4.4 + 2.2 * k, 0.0, 12.6)) for k in range(5)]
    pediment = moved(prism(((-5.6, 6.6), (5.6, 6.6), (0.0, 9.4)), 2.6), at(0.0, 0.0, 10.6))
    return {
        WALLS[3].name: join(tower[:1]),
        TRIM.name: join([*nave, *tower[1:], drum, pediment, *columns]),
        LEAD.name: join([revolve(dome, 48), revolve(lantern, 20), spire]),
    }


@dataclass(frozen=True)
class _Grid:
    """Where blocks stand: their first edges along x and along z, centred round 0, and what lies between them."""

    count: int

    @property
    def gaps_x(self) -> list[float]:
        return [CANAL if i % 3 == 1 else STREET for i in range(self.count - 1)]

    @property
    def gaps_z(self) -> list[float]:
        return [GRAND_CANAL if j == self.count // 2 - 1 else STREET for j in range(self.count - 1)]

    def edges(self, gaps: list[float]) -> list[float]:
        total = self.count * BLOCK + sum(gaps)
        firsts = [-0.5 * total]
        for gap in gaps:
            firsts.append(firsts[-1] + BLOCK + gap)
        return firsts

    def middles(self, gaps: list[float], widths: tuple[float, ...]) -> list[float]:
        """The middle lines of the gaps of these widths."""
        ends = [first + BLOCK for first in self.edges(gaps)]
        return [end + 0.5 * gap for end, gap in zip(ends, gaps, strict=False) if gap in widths]

    def land(self, gaps: list[float]) -> list[tuple[float, float]]:
        """Intervals of dry land, streets included."""
        firsts = self.edges(gaps)
        made, begin = [], firsts[0] - STREET
        for k, gap in enumerate(gaps):
            if gap != STREET:
                made.append((begin, firsts[k] + BLOCK + 0.8))
                begin = firsts[k + 1] - 0.8
        return [*made, (begin, firsts[-1] + BLOCK + STREET)]


class _Town:
    """Puts everything into parts: one for each material of each row of blocks."""

    def __init__(self, count: int, seed: int) -> None:
        self.grid = _Grid(count)
        self.random = np.random.Generator(np.random.PCG64(seed))
        self.parts: dict[str, Part] = {}
        self.windows, self.door, self.roof, self.chimney = _windows(), _door(), _roof(), _chimney()
        self.wall = box((-0.5 * LOT, 0.0, -0.5 * LOT), (0.5 * LOT, 1.0, 0.5 * LOT))

    def draw(self, count: int) -> int:
        """One of 0 .. count - 1."""
        return int(float(self.random.random()) * count)

    def put(self, where: str, meshes: dict[str, Mesh], matrix: Matrix) -> None:
        for material, mesh in meshes.items():
            name = f"{where} {material}"
            smooth = material in (LEAD.name, BOAT.name)
            self.parts.setdefault(name, Part(name, material, smooth)).add(mesh, matrix)

    def build(self) -> None:
        grid = self.grid
        self._ground()
        church = (grid.count // 2, max(0, grid.count // 2 - 1))
        for j, z in enumerate(grid.edges(grid.gaps_z)):
            for i, x in enumerate(grid.edges(grid.gaps_x)):
                if (i, j) == church:
                    self.put("church", _church(), at(x + 0.5 * BLOCK, 0.0, z + 0.5 * BLOCK))
                else:
                    self._block(f"row {j}", x, z)
        self._canals()

    def _ground(self) -> None:
        grid = self.grid
        for x0, x1 in grid.land(grid.gaps_x):
            for z0, z1 in grid.land(grid.gaps_z):
                self.put("land", {PAVING.name: box((x0, -3.0, z0), (x1, 0.0, z1))}, at(0.0, 0.0, 0.0))
        x, z = (-1.25 * grid.edges(gaps)[0] + 20.0 for gaps in (grid.gaps_x, grid.gaps_z))
        sea = quad((-x, WATER, z), (x, WATER, z), (x, WATER, -z), (-x, WATER, -z))
        self.put("sea", {SEA.name: sea}, at(0.0, 0.0, 0.0))

    def _block(self, where: str, x: float, z: float) -> None:
        """Eight houses round a court."""
        for b in range(3):
            for a in range(3):
                if (a, b) != (1, 1):
                    self._house(where, a, b, x + (a + 0.5) * LOT, z + (b + 0.5) * LOT)

    def _house(self, where: str, a: int, b: int, x: float, z: float) -> None:
        """A house on lot (a, b) of its block, its middle at x, z: every one has two façades."""
        floors, wall, kind = 3 + self.draw(3), self.draw(len(WALLS)), self.draw(len(self.windows))
        top = GROUND + STOREY * floors + 0.3
        self.put(where, {WALLS[wall].name: self.wall}, at(x, 0.0, z, (1.0, top, 1.0)))
        along = 90.0 if b == 1 or (a != 1 and self.draw(2)) else 0.0
        self.put(where, self.roof, at(x, top + 0.35, z, degrees=along))
        for _ in range(1 + self.draw(2)):
            reach = 0.36 * LOT
            u, v = (reach * (2.0 * float(self.random.random()) - 1.0) for _ in range(2))
            self.put(where, self.chimney, at(x + u, top + 1.5, z + v))
        for degrees, street in self._facades(a, b):
            self._facade(where, x, z, degrees, floors, self.windows[kind], 3 if street else 2)

    def _facades(self, a: int, b: int) -> Iterator[tuple[float, bool]]:
        """Which way façades look, degrees from +z towards +x, and whether to a street (else to the court)."""
        if b != 1:
            yield (0.0 if b == 2 else 180.0), True
        if a != 1:
            yield (90.0 if a == 2 else -90.0), True
        if a == 1:
            yield (180.0 if b == 2 else 0.0), False
        if b == 1:
            yield (-90.0 if a == 2 else 90.0), False

    def _facade(
        self, where: str, x: float, z: float, degrees: float, floors: int, window: Opening, columns: int
    ) -> None:
        face = at(x, 0.0, z, degrees=degrees)
        door = self.draw(columns)
        for floor in range(floors):
            for column in range(columns):
                across = LOT * ((column + 0.5) / columns - 0.5)
                is_door = floor == 0 and column == door
                y = 0.02 if is_door else GROUND + STOREY * floor + 0.9
                matrix = (*face[:3], x + face[0] * across + face[2] * 0.5 * LOT, *face[4:7], y,
                          *face[8:11], z + face[8] * across + face[10] * 0.5 * LOT)  # fmt: skip
                self.put(where, self.door if is_door else window, matrix)

    def _canals(self) -> None:
        """Bridges where streets meet canals, and boats between them."""
        grid = self.grid
        narrow, wide = _bridge(CANAL), _bridge(GRAND_CANAL)
        boat = {BOAT.name: _boat()}
        for x in grid.middles(grid.gaps_x, (CANAL,)):
            for z in grid.middles(grid.gaps_z, (STREET,)):
                self.put("bridges", narrow, at(x, 0.0, z))
        for x in grid.middles(grid.gaps_x, (STREET,)):
            for z in grid.middles(grid.gaps_z, (GRAND_CANAL,)):
                self.put("bridges", wide, at(x, 0.0, z, degrees=90.0))
        for z in grid.edges(grid.gaps_z):
            for x in grid.middles(grid.gaps_x, (CANAL,)):
                across, along = x + 2.0 * self.draw(3) - 2.0, z + BLOCK * float(self.random.random())
                self.put("boats", boat, at(across, WATER, along, degrees=90.0))
        for x in grid.edges(grid.gaps_x):
            for z in grid.middles(grid.gaps_z, (GRAND_CANAL,)):
                degrees = 40.0 * float(self.random.random()) - 20.0
                along, across = x + BLOCK * float(self.random.random()), z + 4.0 * self.draw(3) - 4.0
                self.put("boats", boat, at(along, WATER, across, degrees=degrees))


def city_plan(scale: float, seed: int) -> Plan:
    """Whole blocks, at least four: `outside` from above at an angle, `inside` at eye level in a street."""
    count = detail(BLOCKS, scale, 2)
    town = _Town(count, seed)
    town.build()
    grid = town.grid
    half = -grid.edges(grid.gaps_x)[0]
    street = min(grid.middles(grid.gaps_x, (STREET,)), key=abs)
    row = grid.edges(grid.gaps_z)[count - 1]
    stand = (street - 0.6, 1.7, row + 0.6 * BLOCK)

    def scaled(x: float, y: float, z: float) -> Vector:
        return (x * half, y * half, z * half)

    return Plan(
        parts=tuple(town.parts.values()),
        materials=MATERIALS,
        lights=(
            sun("sun", 2.6, 2.35, 1.95, -0.7, -0.9, -0.45),
            sun("sky", 0.45, 0.58, 0.80, 0.5, -0.8, 0.4),
            sun("west sky", 0.35, 0.42, 0.52, 0.9, -0.1, -0.6),
            sun("bounce", 0.30, 0.26, 0.20, 0.2, 0.9, -0.3),
        ),
        cameras=(
            Camera("outside", eye=scaled(0.3, 0.66, 1.38), look_at=scaled(0.06, -0.12, 0.1), fov=50.0),
            Camera("inside", eye=stand, look_at=(street + 1.2, 4.2, row - 30.0), fov=65.0),
        ),
    )
