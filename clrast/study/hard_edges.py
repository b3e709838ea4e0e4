"""Hard cases about edges and vertices: shared ones that samples lie on, and rows and columns of pixels."""

from __future__ import annotations

import numpy as np

from clrast.scene.model import Camera
from clrast.study.hard_case import (
    AHEAD,
    ALL,
    FLOAT32,
    OBLIQUE,
    SIDE,
    WIDE,
    Built,
    Family,
    Shape,
    at,
    fan,
    grid,
    join,
    noise,
    orthographic,
    ring,
    swept,
)

FAMILY = Family()
SQUARE = Camera("square", "orthographic", (0.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0), height=16.0)
"""An orthographic view of pixels of 1/4, without rounding."""


def fan_field(valence: int, radius: float, spacing: int) -> Shape:
    """Closed fans in rows, each hub at the centre of a pixel, rims at pixel corners and centres."""
    first = spacing // 2
    places = [(i + 0.5, j + 0.5) for j in range(first, SIDE, spacing) for i in range(first, SIDE, spacing)]
    return join([fan(at(x, y), [at(*p) for p in ring(valence, radius, x, y)]) for x, y in places])


@FAMILY.case("fan-4", "Hubs of four triangles lie exactly on samples, and so do parts of their edges.", right=ALL)
def fan_4() -> Built:
    return fan_field(4, 7.0, 16), [AHEAD]


@FAMILY.case("fan-6", "Hubs of six triangles lie exactly on samples, as in a regular triangulation.", right=ALL)
def fan_6() -> Built:
    return fan_field(6, 7.0, 16), [AHEAD]


@FAMILY.case("fan-50", "A hub of fifty triangles lies exactly on a sample.", right=ALL)
def fan_50() -> Built:
    return fan_field(50, 28.0, 64), [AHEAD]


def fan_rounded(valence: int, spacing: int) -> Built:
    """Hubs on the rays of OBLIQUE, but for the rounding to float32."""
    first, radius = spacing // 2, 0.45 * spacing
    shapes = []
    for k, (i, j) in enumerate((i, j) for j in range(first, SIDE, spacing) for i in range(first, SIDE, spacing)):
        rim = np.array(ring(valence, radius, i + 0.5, j + 0.5, 1024.0))
        x, y = np.append(i + 0.5, rim[:, 0]), np.append(j + 0.5, rim[:, 1])
        points = swept(OBLIQUE, x, y, 3.0 + 0.5 * noise(k, len(x)))
        shapes.append(fan(tuple(points[0]), [tuple(p) for p in points[1:]]))
    return join(shapes), [OBLIQUE]


@FAMILY.case(
    "fan-4-rounded", "Hubs of four triangles lie within rounding of samples, in a view of long numbers.",
    wrong=FLOAT32, right=WIDE,
)  # fmt: skip
def fan_4_rounded() -> Built:
    return fan_rounded(4, 8)


@FAMILY.case(
    "fan-6-rounded", "Hubs of six triangles lie within rounding of samples, in a view of long numbers.",
    wrong=FLOAT32, right=WIDE,
)  # fmt: skip
def fan_6_rounded() -> Built:
    return fan_rounded(6, 8)


@FAMILY.case(
    "fan-50-rounded", "Hubs of fifty triangles lie within rounding of samples, in a view of long numbers.",
    wrong=FLOAT32, right=WIDE,
)  # fmt: skip
def fan_50_rounded() -> Built:
    return fan_rounded(50, 16)


@FAMILY.case(
    "rows-and-columns", "Every edge runs along a row, a column or a diagonal of samples, exactly.", right=ALL
)
def rows_and_columns() -> Built:
    k = np.arange(-3, SIDE + 4, 3) + 0.5
    x, y = np.meshgrid(k, k)
    return grid(np.stack([(x - 32) / 8, (32 - y) / 8, np.full(x.shape, -4.0)], axis=2)), [AHEAD]


@FAMILY.case(
    "rows-and-columns-orthographic", "Edges along rows, columns and diagonals of samples, in parallel rays.", right=ALL
)
def rows_and_columns_orthographic() -> Built:
    k = np.arange(-3, SIDE + 4, 3) + 0.5
    x, y = np.meshgrid(k, k)
    return grid(np.stack([(x - 32) / 4, (32 - y) / 4, np.full(x.shape, -4.0)], axis=2)), [SQUARE]


SHEET_SIDE = 24


def sheet(camera: Camera) -> Built:
    """A wavy sheet over the whole view; its vertices are every second sample, but for rounding."""
    k = np.arange(-2, SHEET_SIDE + 3, 2) + 0.5
    x, y = np.meshgrid(k, k)
    return grid(swept(camera, x, y, 3.0 + 0.25 * noise(7, *x.shape), SHEET_SIDE)), [camera]


@FAMILY.case(
    "sheet", "Every second sample lies within rounding of a vertex of six or four triangles, the others of edges.",
    wrong=FLOAT32, right=WIDE, size=(SHEET_SIDE, SHEET_SIDE),
)  # fmt: skip
def sheet_perspective() -> Built:
    return sheet(OBLIQUE)


@FAMILY.case(
    "sheet-orthographic", "Samples within rounding of vertices and edges, in parallel rays.",
    wrong=FLOAT32, right=WIDE, size=(SHEET_SIDE, SHEET_SIDE),
)  # fmt: skip
def sheet_orthographic() -> Built:
    return sheet(orthographic(OBLIQUE, 3.0))


@FAMILY.case(
    "sheet-wide", "Samples within rounding of edges under an angle of 150 degrees, where rays differ in length.",
    wrong=FLOAT32, right=WIDE, size=(SHEET_SIDE, SHEET_SIDE),
)  # fmt: skip
def sheet_wide() -> Built:
    return sheet(Camera("wide", "perspective", (0.3, 0.7, 2.5), (0.1, -0.2, 0.05), (0.1, 1.0, 0.2), 150.0))


def with_t_junctions(rounded: bool) -> Shape:
    """Long edges that meet the middles of others: rows of bricks, every second row shifted by a part of a brick.

    rounded : in a slanted plane of long numbers, where the middle vertices do not lie on the edges that they meet.
    """
    shapes = []
    for row in range(9):
        top, bottom, shift = 8.0 * row - 3.5, 8.0 * row + 4.5, (row * 5) % 16
        for column in range(-1, 5):
            left, right = 16.0 * column + shift + 0.5, 16.0 * (column + 1) + shift + 0.5
            corners = np.array([at(left, top), at(left, bottom), at(right, bottom), at(right, top)])
            if rounded:
                corners = corners * (1.0 / 3.0) + corners[:, :1] * np.array([0.0, 0.3, 0.2])
            shapes.append((corners, np.array([(0, 1, 2), (0, 2, 3)])))
    return join(shapes)


@FAMILY.case(
    "t-junctions", "Vertices lie exactly on edges of other triangles and on rows of samples: nothing may show through.",
    right=ALL,
)  # fmt: skip
def t_junctions() -> Built:
    return with_t_junctions(False), [AHEAD]


@FAMILY.case(
    "t-junctions-rounded",
    "Vertices lie on edges of other triangles but for rounding: real arithmetic finds true cracks and overlaps.",
)
def t_junctions_rounded() -> Built:
    return with_t_junctions(True), [AHEAD]


@FAMILY.case(
    "grid-planes",
    "All faces of a lattice of cubes lie in planes of the cells of any uniform grid; the eye lies in three of them.",
)
def grid_planes() -> Built:
    corners = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float64)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    cells = [(x, y, z) for x in range(4) for y in range(4) for z in range(4) if (x + y + z) % 2 == 0]
    shape = join([((corners + np.array(cell) - 2.0) / 2.0, triangles) for cell in cells])
    inside = Camera("on planes", "perspective", (0.5, 0.0, 1.5), (0.5, 0.0, 0.0), (0.0, 1.0, 0.0), 60.0)
    return shape, [inside, OBLIQUE]
