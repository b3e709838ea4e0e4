"""Hard cases about shapes: slivers and needles, faces without area, copies, surfaces in or through one another."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from clrast.scene.model import Camera
from clrast.scene.shapes import icosphere
from clrast.study.hard_case import (
    AHEAD,
    FLOAT32,
    OBLIQUE,
    Built,
    Family,
    Shape,
    at,
    blob,
    join,
    loose,
    noise,
    orthographic,
    swept,
)

FAMILY = Family()


def slivers(aspect: float) -> Built:
    """Bands of triangles of that aspect, each round a slanted line of samples, between two large triangles.

    A band runs from the lower to the upper line of its samples and is `length / aspect` high; its triangles share
    their long edges with one another and with the large ones, so that nothing shows through.
    """
    shapes: list[Shape] = []
    length = 60.0
    for k, (dx, dy) in enumerate([(1, 0), (3, 1), (2, 1), (1, 1), (1, 2), (1, 3), (0, 1)]):
        norm = math.hypot(dx, dy)
        along, across = np.array([dx, dy]) / norm, np.array([-dy, dx]) / norm
        thin = length / aspect
        middle = np.array([8.5 * k + 6.5, 8.5 * k + 6.5]) // 1 + 0.5
        rows = [middle + across * offset for offset in (-2.5, -0.5 * thin, 0.5 * thin, 2.5)]
        ends = np.array([[row - along * length / 2, row + along * length / 2] for row in rows]).reshape(-1, 2)
        points = swept(AHEAD, ends[:, 0], ends[:, 1], np.full(8, 3.0 + 0.5 * k))
        strip = [(2 * r, 2 * r + 1, 2 * r + 3) for r in range(3)] + [(2 * r, 2 * r + 3, 2 * r + 2) for r in range(3)]
        shapes.append((points, np.array(strip)))
    return join(shapes), [AHEAD, Camera("from aside", "perspective", (2.0, 1.5, 1.0), (0.2, 0.1, -4.0), fov=70.0)]


for _power, _wrong in ((3, FLOAT32), (4, ("fast", "ordered")), (5, FLOAT32), (6, FLOAT32), (7, FLOAT32)):
    FAMILY.case(
        f"slivers-1e{_power}",
        f"Triangles 10^{_power} times as long as wide lie along rows, columns and diagonals of samples.",
        wrong=_wrong,
    )(partial(slivers, 10.0**_power))


@FAMILY.case(
    "needles", "Triangles from before the eye to ten thousand times as far, a pixel wide where they begin.",
)  # fmt: skip
def needles() -> Built:
    count = 200
    angle = math.pi * noise(40, count)
    near, far = 1.0 + 0.5 * noise(41, count), 1e4 * (1.2 + noise(42, count))
    lateral = 0.8 * noise(43, count)
    start = np.stack([lateral * np.cos(angle), lateral * np.sin(angle), -near], axis=1)
    width = 0.03 * np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)
    tip = np.stack([0.6 * far * noise(44, count), 0.6 * far * noise(45, count), -far], axis=1)
    return loose(np.stack([start - width, start + width, tip], axis=1)), [AHEAD]


@FAMILY.case(
    "tunnel", "A closed cone of 64 needles round the eye meets in one vertex a million times as far as its rim.",
    wrong=FLOAT32,
)  # fmt: skip
def tunnel() -> Built:
    count = 64
    rim = [(math.cos(2 * math.pi * k / count), math.sin(2 * math.pi * k / count), 1.0) for k in range(count)]
    tip = (1e6 / 64, 1e6 / 64, -1e6)  # on the ray of the sample (32.5, 31.5)
    triangles = [(0, 1 + k, 1 + (k + 1) % count) for k in range(count)]
    return (np.array([tip, *rim]), np.array(triangles)), [AHEAD]


@FAMILY.case(
    "duplicates", "Every face is there four times, turned and flipped: the smallest id is seen.", right=("exact",)
)
def duplicates() -> Built:
    ball = icosphere(2)
    orders = ([0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1])
    triangles = np.concatenate([ball.triangles[:, order] for order in orders])
    shuffled = np.argsort(noise(50, len(triangles)), kind="stable")
    return (ball.positions, triangles[shuffled]), [OBLIQUE, orthographic(OBLIQUE, 2.5)]


@FAMILY.case(
    "flipped", "Half of the faces of a closed mesh are turned inside out: edges run the same way in both neighbours.",
    right=("exact",),
)  # fmt: skip
def flipped() -> Built:
    ball = icosphere(3)
    triangles = ball.triangles.copy()
    turned = noise(51, len(triangles)) > 0
    triangles[turned] = triangles[turned][:, [0, 2, 1]]
    return (ball.positions, triangles), [OBLIQUE]


@FAMILY.case(
    "no-area", "Faces that are points or lines, through vertices and edges of a sheet before which they lie.",
    right=("exact",),
)  # fmt: skip
def no_area() -> Built:
    corners = blob(52, 40, 0.8)
    corners[10:20, 1] = corners[10:20, 0]
    corners[20:25, 1:] = corners[20:25, :1]
    share = noise(54, 15)[:, None]
    short = np.floor(corners[25:, :2] * 64) / 64  # on a line in short numbers: exactly without area
    corners[25:, :2] = short
    corners[25:, 2] = short[:, 0] + np.floor(share * 8) * (short[:, 1] - short[:, 0])
    wall = [[(-8.0, -8.0, -3.0), (8.0, -8.0, -3.0), (0.0, 12.0, -3.0)]]
    return loose(np.concatenate([corners, wall])), [OBLIQUE, orthographic(OBLIQUE, 3.0)]


def walls(slanted: bool) -> Shape:
    """Two hundred pairs of rectangles of other sizes in the same planes, as walls of neighbouring buildings are."""
    shapes = []
    random = noise(60, 200, 6)
    quads = np.array([(0, 1, 2), (0, 2, 3)])
    for k, (x, y, z, a, b, c) in enumerate(random):
        base = np.round(np.array([8 * x, 4 * y, 8 * z]) * 16) / 16
        width, height = 1.0 + round(abs(a) * 32) / 16, 1.0 + round(abs(b) * 32) / 16
        axis = k % 3
        sides = [np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]]
        if slanted:
            sides = [np.array([1.0, 0.25, 0.5]), np.array([-0.5, 1.0, 0.125])][:: 1 if k % 2 else -1]
        for shift, order in ((0.0, 1), (0.25 + round(abs(c) * 8) / 16, -1)):
            corner = base + shift * (sides[0] + sides[1])
            points = [corner, corner + width * sides[0], corner + width * sides[0] + height * sides[1],
                      corner + height * sides[1]]  # fmt: skip
            shapes.append((np.array(points), quads[:, ::order]))
    return join(shapes)


@FAMILY.case(
    "coplanar-walls", "Two hundred pairs of overlapping walls in the same axis planes: equal depths, the smaller id.",
)
def coplanar_walls() -> Built:
    eye = Camera("street", "perspective", (3.1, 1.7, 14.3), (0.2, 0.1, 0.0), fov=50.0)
    return walls(False), [eye, orthographic(eye, 14.0)]


@FAMILY.case(
    "coplanar-roofs",
    "Two hundred pairs of overlapping roofs in the same slanted planes: equal depths in real arithmetic alone.",
    wrong=("fast", "ordered", "midpoint"),
)
def coplanar_roofs() -> Built:
    eye = Camera("street", "perspective", (3.1, 1.7, 14.3), (0.2, 0.1, 0.0), fov=50.0)
    return walls(True), [eye, orthographic(eye, 14.0)]


@FAMILY.case(
    "interpenetrating", "Planes and blades pass through one another: the nearer surface changes between samples."
)
def interpenetrating() -> Built:
    cross = [[(-1, -1, -1), (1, -1, 1), (0, 1.5, 0)], [(-1, -1, 1), (1, -1, -1), (0, 1.5, 0.0625)]]
    blades = [[(x, -1, 0.8), (x + 0.1, 1, -0.8), (x + 0.2, -1, -0.3)] for x in np.linspace(-0.8, 0.6, 9)]
    return loose(np.array(cross + blades, dtype=np.float64)), [OBLIQUE, orthographic(OBLIQUE, 3.0)]


@FAMILY.case(
    "layers", "Eight parallel surfaces a float32 step apart: the depths differ by less than a rounding."
)
def layers() -> Built:
    step = 2.0**-22
    square = np.array([at(8, 8), at(8, 56), at(56, 56), at(56, 8)])
    shapes = []
    for k in (3, 1, 7, 5, 0, 6, 2, 4):
        turn = np.roll(square, k, axis=0) * (1.0 - 0.03 * k)
        turn[:, 2] = -3.0 - k * step
        shapes.append((turn, np.array([(0, 1, 2), (0, 2, 3)])))
    return join(shapes), [AHEAD]


@FAMILY.case(
    "ball-inside", "A closed mesh round the eye: every sample meets it, and exactly one face of it.", right=("exact",)
)
def ball_inside() -> Built:
    ball = icosphere(3)
    cameras = [
        Camera(f"inside {k}", "perspective", (0.1, 0.2, 0.3), look_at, (0.1, 1.0, 0.2), 100.0)
        for k, look_at in enumerate([(1.0, 0.2, -0.3), (-0.2, 1.0, 0.1), (-1.0, -1.0, 1.0)])
    ]
    return (ball.positions, ball.triangles), cameras


@FAMILY.case(
    "room-inside", "A box of twelve faces round the eye, whose edges meet at corners in view.", right=("exact",)
)
def room_inside() -> Built:
    points = np.array([(x, y, z) for x in (-1.1, 1.3) for y in (-0.9, 1.2) for z in (-1.4, 1.6)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    # Looking at a corner: it lies within rounding of the middle of the image, which is between four samples.
    return (points, triangles), [
        Camera(f"to {name}", "perspective", (0.1, 0.2, 0.3), look_at, (0.1, 1.0, 0.2), 120.0)
        for name, look_at in (("corner", (1.3, 1.2, -1.4)), ("edge", (1.3, 0.0, 1.6)), ("wall", (-1.1, 0.2, 0.3)))
    ]


@FAMILY.case("point-cloud", "Ten thousand triangles much smaller than a pixel: most are missed, none may be doubled.")
def point_cloud() -> Built:
    return loose(blob(70, 3000, 0.004, 1.2)), [OBLIQUE]

