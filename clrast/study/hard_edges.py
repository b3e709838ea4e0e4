"""Hard cases about edges and vertices: shared ones that samples lie on, and rows and columns of pixels."""

from __future__ import annotations

import numpy as np

from clrast.study.hard_case import (
    AHEAD,
    ALL,
    EXACT,
    FLOAT32,
    OBLIQUE,
    SIDE,
    Family,
    at,
    fan,
    grid,
    join,
    orthographic,
    ring,
    swept,
)

FAMILY = Family()


def fan_field(valence: int, radius: float, spacing: int):
    """Closed fans in rows, each hub at the centre of a pixel, rims at pixel corners and centres."""
    first = spacing // 2
    places = [(i + 0.5, j + 0.5) for j in range(first, SIDE, spacing) for i in range(first, SIDE, spacing)]
    return join([fan(at(x, y), [at(*p) for p in ring(valence, radius, x, y)]) for x, y in places])


@FAMILY.case(
    "fan-4", "Hubs of four triangles lie exactly on samples, and so do parts of their edges.", right=ALL
)
def fan_4():
    return fan_field(4, 7.0, 16), [AHEAD]


@FAMILY.case(
    "fan-6", "Hubs of six triangles lie exactly on samples, as in a regular triangulation.", right=ALL
)
def fan_6():
    return fan_field(6, 7.0, 16), [AHEAD]


@FAMILY.case("fan-50", "A hub of fifty triangles lies exactly on a sample.", right=ALL)
def fan_50():
    return fan_field(50, 28.0, 64), [AHEAD]
