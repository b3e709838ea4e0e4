"""A columned hall seen from inside: walls and floor of a few huge triangles, ornaments of many small ones.

Metres, y up: the nave runs along z from -LENGTH / 2 to LENGTH / 2, with an aisle on either side.
"""

from __future__ import annotations

import math

import numpy as np

from clrast.scene.model import Camera, Material
from clrast.study.suite_meshes import (
    Mesh,
    Part,
    Plan,
    at,
    box,
    circle,
    curve,
    detail,
    join,
    lamp,
    moved,
    paint,
    revolve,
    sheet,
    slab,
    sun,
    sweep,
)
from clrast.study.suite_statue import statue

LENGTH, BAYS = 40.0, 8
BAY = LENGTH / BAYS
NAVE, AISLE = 4.6, 8.4
"""Half widths: to the axis of the arcade, to the outer wall."""
SPRING, CORNICE, AISLE_HEIGHT = 5.2, 9.0, 8.2
"""Heights: where the arches begin, where the barrel vault begins, the aisles' ceilings."""
ARCH = 0.5 * BAY - 0.55
"""Radius of an arch; what remains of the bay stands on a column."""
WALL_DEPTH = 0.7
FLUTES = 20

STONE = paint("stone", 0.60, 0.54, 0.44)
CREAM = paint("cream plaster", 0.70, 0.65, 0.55)
MARBLE = paint("marble", 0.66, 0.62, 0.58, 0.4)
RED = paint("red plaster", 0.42, 0.20, 0.14)
FLOOR = paint("floor", 0.34, 0.29, 0.25, 0.5)
VAULT = paint("blue vault", 0.20, 0.28, 0.42)
GOLD = paint("gold", 0.72, 0.50, 0.16, 0.4, 0.5)
WOOD = paint("oak", 0.27, 0.16, 0.08, 0.7)
BRONZE = paint("bronze", 0.36, 0.27, 0.15, 0.45, 0.3)
MATERIALS: tuple[Material, ...] = (STONE, CREAM, MARBLE, RED, FLOOR, VAULT, GOLD, WOOD, BRONZE)


def _fluted(rings: int, per_flute: int, depth: float) -> np.ndarray:
    """Factors of radius of a fluted shaft: (rings, FLUTES * per_flute), hollows that end at top and bottom."""
    across = [4.0 * t * (1.0 - t) for t in (k / per_flute for k in range(per_flute))]
    along = [min(1.0, 6.0 * t * (1.0 - t)) for t in (j / (rings - 1) for j in range(rings))]
    return 1.0 - depth * np.array(along)[:, None] * np.array(across * FLUTES)[None, :]


def column(scale: float) -> list[Mesh]:
    """Base, shaft, capital and abacus from y = 0 to SPRING; some 6000 triangles at scale 1."""
    segments, per_flute, rings = detail(48, scale, 12), detail(4, scale, 2), detail(10, scale, 5)
    shaft = [(0.42 - 0.07 * t * t, 0.45 + t * (SPRING - 1.25)) for t in (j / (rings - 1) for j in range(rings))]
    base = curve(((0.56, 0.16), (0.60, 0.22), (0.52, 0.29), (0.47, 0.33), (0.52, 0.39), (0.42, 0.46)),
                 detail(12, scale, 5))  # fmt: skip
    leaves, leaf_rings = 10, detail(22, scale, 6)
    sides = leaves * detail(7, scale, 2)
    bell, factors = [], np.ones((leaf_rings, sides))
    for j in range(leaf_rings):
        t = j / (leaf_rings - 1)
        bell.append((0.35 + 0.24 * t * t, SPRING - 0.82 + 0.68 * t))
        tier = 2.0 * t - math.floor(min(2.0 * t, 1.999))
        for i in range(sides):
            shift = 0.5 if t >= 0.5 else 0.0
            u = i * leaves / sides + shift
            u -= math.floor(u)
            factors[j, i] = 1.0 + 0.34 * (4.0 * u * (1.0 - u)) * tier * tier * (1.15 - t)
    return [
        box((-0.62, 0.0, -0.62), (0.62, 0.16, 0.62)),
        revolve(base, segments),
        revolve(shaft, FLUTES * per_flute, _fluted(rings, per_flute, 0.085)),
        revolve(bell, sides, factors),
        box((-0.64, SPRING - 0.14, -0.64), (0.64, SPRING, 0.64)),
    ]


def arcade_wall(scale: float) -> Mesh:
    """A bay of wall over an arch, both faces and the soffit: x along the wall, centred; z its depth."""
    steps = detail(20, scale, 4)
    turn = circle(steps, 0.5) + [(-1.0, 0.0)]
    arch = [(ARCH * c, SPRING + ARCH * s) for c, s in turn]
    half, depth = 0.5 * BAY, 0.5 * WALL_DEPTH
    edge = [(half, SPRING), *arch, (-half, SPRING)]
    top = [(half, CORNICE), *((x, CORNICE) for x, _ in arch), (-half, CORNICE)]
    faces = []
    for z, flip in ((depth, -1), (-depth, 1)):
        rows = np.array([[(x, y, z) for x, y in line[::flip]] for line in (edge, top)], np.float64)
        faces.append(sheet(rows))
    soffit = np.array([[(x, y, z) for x, y in arch] for z in (depth, -depth)], np.float64)
    return join([*faces, sheet(soffit)])


def archivolt(scale: float) -> Mesh:
    """A moulding along the arch: closed, lying on the plane z = 0."""
    turn = circle(detail(32, scale, 6), 0.5) + [(-1.0, 0.0)]
    outline = curve(((0.16, -0.02), (0.18, 0.05), (0.08, 0.10), (0.0, 0.06), (-0.09, 0.12), (-0.14, -0.02)),
                    detail(9, scale, 5))  # fmt: skip
    return sweep([((ARCH + 0.17) * c, SPRING + (ARCH + 0.17) * s) for c, s in turn], outline)


def rosette(scale: float) -> Mesh:
    """A flower of two rings of petals, radius 1, standing out towards +y: closed."""
    petals, rings = 8, detail(12, scale, 5)
    sides = petals * detail(6, scale, 2)
    profile, factors = [], np.ones((rings, sides))
    for j in range(rings):
        t = j / (rings - 1)
        bulge = 4.0 * (2.0 * t - math.floor(min(2.0 * t, 1.999)))
        profile.append((1.0 - 0.94 * t, 0.10 + 0.25 * t + 0.05 * bulge * (1.0 - 0.25 * bulge)))
        for i in range(sides):
            u = i * petals / sides + (0.5 if t >= 0.5 else 0.0)
            u -= math.floor(u)
            factors[j, i] = 1.0 - 0.26 * (1.0 - 4.0 * u * (1.0 - u)) * (1.0 - 0.6 * t)
    return revolve([(1.0, 0.0), *profile], sides, np.concatenate([factors[:1], factors]))


def baluster(scale: float) -> Mesh:
    """A turned baluster 0.8 high."""
    shape = ((0.075, 0.0), (0.075, 0.06), (0.045, 0.10), (0.085, 0.27), (0.04, 0.50), (0.055, 0.56), (0.04, 0.62),
             (0.07, 0.74), (0.07, 0.80))  # fmt: skip
    return revolve(curve(shape, detail(14, scale, 8)), detail(12, scale, 5))


def chandelier(scale: float) -> Mesh:
    """A ring with lamps, hung from y = 0: closed solids."""
    ring, sides = circle(detail(72, scale, 8)), detail(10, scale, 4)
    hoop = sweep([(1.1 * c, 1.1 * s) for c, s in ring], [(0.06 * c, 0.06 * s) for c, s in circle(sides)], loop=True)
    bulb = curve(((0.02, 0.0), (0.09, 0.04), (0.12, 0.16), (0.07, 0.26), (0.02, 0.32)), detail(12, scale, 4))
    candle = revolve(bulb, detail(16, scale, 5))
    flat = moved(hoop, at(0.0, -3.0, 0.0, degrees=90.0, axis=(1.0, 0.0, 0.0)))
    lights = [moved(candle, at(1.1 * c, -2.96, 1.1 * s)) for c, s in circle(12)]
    rod = sweep([(0.0, 0.0), (0.0, -3.0)], [(0.03 * c, 0.03 * s) for c, s in circle(sides)])
    spoke = sweep([(-1.1, -3.0), (1.1, -3.0)], [(0.025 * c, 0.025 * s) for c, s in circle(sides)])
    return join([flat, rod, spoke, moved(spoke, at(0.0, 0.0, 0.0, degrees=90.0)), *lights])


def _shell() -> list[Part]:
    """Floor, outer walls, end walls and the aisles' ceilings: two huge triangles each."""
    x, y, z = AISLE, AISLE_HEIGHT, 0.5 * LENGTH
    n, top = NAVE, CORNICE + NAVE
    return [
        slab("floor", FLOOR, (-x, 0.0, z), (x, 0.0, z), (x, 0.0, -z), (-x, 0.0, -z)),
        slab("left wall", RED, (-x, 0.0, z), (-x, 0.0, -z), (-x, y, -z), (-x, y, z)),
        slab("right wall", RED, (x, 0.0, -z), (x, 0.0, z), (x, y, z), (x, y, -z)),
        slab("left ceiling", CREAM, (-x, y, -z), (-n, y, -z), (-n, y, z), (-x, y, z)),
        slab("right ceiling", CREAM, (n, y, -z), (x, y, -z), (x, y, z), (n, y, z)),
        slab("far wall", CREAM, (-x, 0.0, -z), (x, 0.0, -z), (x, top, -z), (-x, top, -z)),
        slab("near wall", CREAM, (x, 0.0, z), (-x, 0.0, z), (-x, top, z), (x, top, z)),
    ]


def _vault(scale: float) -> list[Part]:
    """A barrel vault of strips as long as the hall, and ribs across it."""
    z = 0.5 * LENGTH
    radius = NAVE - 0.5 * WALL_DEPTH
    turn = circle(detail(24, scale, 6), 0.5) + [(-1.0, 0.0)]
    rows = np.array([[(radius * c, CORNICE + radius * s, d) for c, s in turn] for d in (z, -z)], np.float64)
    vault = Part("vault", VAULT.name, smooth=True)
    vault.add(sheet(rows))
    ribs = Part("ribs", GOLD.name, smooth=True)
    outline = curve(((0.06, -0.22), (0.06, 0.22), (-0.02, 0.16), (-0.12, 0.0), (-0.02, -0.16)), detail(14, scale, 5))
    turn = circle(detail(48, scale, 8), 0.5) + [(-1.0, 0.0)]
    rib = sweep([(radius * c, CORNICE + radius * s) for c, s in turn], outline[::-1])
    for k in range(BAYS + 1):
        ribs.add(rib, at(0.0, 0.0, -z + k * BAY))
    return [vault, ribs]


def _arcades(scale: float) -> list[Part]:
    """Columns, arches and what adorns them, on both sides of the nave."""
    columns, walls = Part("columns", MARBLE.name, smooth=True), Part("arcade walls", STONE.name)
    plinths, mouldings = Part("plinths and abaci", STONE.name), Part("archivolts", CREAM.name, smooth=True)
    flowers, cornice = Part("rosettes", GOLD.name, smooth=True), Part("cornices", CREAM.name)
    plinth, base, shaft, capital, abacus = column(scale)
    round_parts = join([base, shaft, capital])
    square_parts = join([plinth, abacus])
    wall, moulding, flower = arcade_wall(scale), archivolt(scale), rosette(scale)
    face = 0.5 * WALL_DEPTH
    for side in (-1.0, 1.0):
        for k in range(BAYS + 1):
            foot = at(side * NAVE, 0.0, -0.5 * LENGTH + k * BAY)
            columns.add(round_parts, foot)
            plinths.add(square_parts, foot)
        for k in range(BAYS):
            z = -0.5 * LENGTH + (k + 0.5) * BAY
            walls.add(wall, at(side * NAVE, 0.0, z, degrees=90.0))
            for degrees, x in ((90.0, NAVE * side + face), (-90.0, NAVE * side - face)):
                mouldings.add(moulding, at(x, 0.0, z, degrees=degrees))
            for along, height, size in ((0.5 * BAY, 7.35, 0.42), (0.0, 8.45, 0.24)):
                flat = (size, 0.5 * size, size)
                x = side * (NAVE - face)
                flowers.add(flower, at(x, height, z + along, flat, 90.0 * side, axis=(0.0, 0.0, 1.0)))
        low, high = side * (NAVE - face - 0.22), side * NAVE
        ends = (min(low, high), max(low, high))
        cornice.add(box((ends[0], CORNICE - 0.12, -0.5 * LENGTH), (ends[1], CORNICE + 0.1, 0.5 * LENGTH)))
    return [plinths, columns, walls, mouldings, flowers, cornice]


def _furniture(scale: float, seed: int) -> list[Part]:
    """Balustrades, benches, chandeliers, a figure on an altar: what stands and hangs about."""
    rails, balusters = Part("rails", STONE.name), Part("balusters", MARBLE.name, smooth=True)
    shape = baluster(scale)
    benches, lamps = Part("benches", WOOD.name), Part("chandeliers", GOLD.name, smooth=True)
    hung = chandelier(scale)
    random = np.random.Generator(np.random.PCG64(seed))
    for side in (-1.0, 1.0):
        for k in range(BAYS):
            z = -0.5 * LENGTH + k * BAY
            if k % 2 == 1:
                count = detail(12, scale, 4)
                for j in range(count):
                    balusters.add(shape, at(side * NAVE, 0.1, z + 0.85 + (BAY - 1.7) * j / (count - 1)))
                for low, high in ((0.0, 0.1), (0.9, 1.0)):
                    rails.add(box((side * NAVE - 0.14, low, z + 0.6), (side * NAVE + 0.14, high, z + BAY - 0.6)))
        for k in range(9):
            z = -11.0 + 2.2 * k + 0.1 * float(random.random())
            near, far = sorted((0.9 * side, 3.5 * side))
            benches.add(box((near, 0.38, z), (far, 0.44, z + 0.45)))
            benches.add(box((near, 0.44, z + 0.40), (far, 0.95, z + 0.45)))
            for x in (near, far - 0.08):
                benches.add(box((x, 0.0, z), (x + 0.08, 0.95, z + 0.46)))
    for k in range(1, BAYS, 2):
        lamps.add(hung, at(0.0, CORNICE + 1.2, -0.5 * LENGTH + (k + 0.5) * BAY))
    altar, figure = Part("altar", MARBLE.name), Part("figure", BRONZE.name, smooth=True)
    far = -0.5 * LENGTH
    for step in range(3):
        x = 3.4 - 0.5 * step
        altar.add(box((-x, 0.25 * step, far), (x, 0.25 * step + 0.25, far + 4.0 - 0.6 * step)))
    altar.add(box((-1.0, 0.75, far + 0.6), (1.0, 1.7, far + 2.2)))
    figure.add(statue(detail(66, scale, 24), seed), at(0.0, 1.7, far + 1.4, 1.3))
    return [rails, balusters, benches, lamps, altar, figure]


def hall_plan(scale: float, seed: int) -> Plan:
    """A nave of eight bays with aisles; `view` along it, `inside` an aisle with a column close by."""
    return Plan(
        parts=(*_shell(), *_vault(scale), *_arcades(scale), *_furniture(scale, seed)),
        materials=MATERIALS,
        lights=(
            sun("window light", 1.9, 1.85, 1.65, 0.75, -0.9, -0.55),
            sun("sky", 0.6, 0.7, 0.85, -0.8, -0.35, -0.6),
            sun("bounce", 0.65, 0.55, 0.45, -0.25, 0.9, -0.35),
            lamp("altar lamp", 16.0, 12.0, 7.0, 0.0, 5.0, -15.5),
            lamp("nave lamp", 34.0, 26.0, 16.0, 0.0, 5.6, 2.0),
        ),
        cameras=(
            Camera("view", eye=(0.6, 2.2, 18.4), look_at=(-0.2, 3.6, -6.0), fov=65.0),
            Camera("inside", eye=(6.0, 1.65, 6.3), look_at=(-1.2, 3.0, -7.0), fov=75.0),
        ),
    )
