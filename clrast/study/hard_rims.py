"""Cases beyond float64: edges of long numbers that pass exactly through samples, or by them as closely as can be.

The view has sample directions d = (3677 (2 i - 63), 3677 (63 - 2 j), -2^18) up to scale, of up to 18 bits; vertices
are a and b, relative to the eye, of up to 24 bits. An edge function is V = det(a, b, d), a sum of products of 66 bits.

    hubs       a = k d: every edge from it has V = 0 whatever b is
    crossings  b = k d - 2 a: the edge from a to b crosses the ray, V = 0
    passings   det(a, b, d) = g, the smallest number above 0 that it can be: an integer solution of n . b = g with
               n = d x a by Euclid, brought near to k d - 2 a by the lattice of all solutions of n . b = 0

float64 has 53 bits, so its V is noise there; that it has the wrong sign at many of these samples is tested.
"""

from __future__ import annotations

import math

import numpy as np

from clrast.scene.model import Camera
from clrast.study.hard_case import NO_EXACT, SIDE, Built, Family, Shape, fan, join, noise

FAMILY = Family()
STEP = 3677
"""Twice a pixel's side at the distance 2^18: an odd number of 12 bits."""
HALF = STEP * 32 / 2**18 * 2
DEPTH_BITS = 20
"""Vertices are integers times 2^-20."""
LONG_NUMBERS = Camera(
    "long numbers", "perspective", (0.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0),
    math.degrees(2.0 * math.atan(HALF)),
)  # fmt: skip
SPACING = 8

Integers = tuple[int, int, int]


def direction(i: int, j: int) -> Integers:
    """The direction of the sample at the centre of pixel (i, j), as integers."""
    return STEP * (2 * i + 1 - SIDE), STEP * (SIDE - 1 - 2 * j), -(2**18)


def cross(a: Integers, b: Integers) -> Integers:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def dot(a: Integers, b: Integers) -> int:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def combine(k: int, a: Integers, m: int, b: Integers) -> Integers:
    """k a + m b."""
    return k * a[0] + m * b[0], k * a[1] + m * b[1], k * a[2] + m * b[2]


def points_round(i: int, j: int, angles: np.ndarray, seed: int, low: float = 2.0, high: float = 3.4) -> list[Integers]:
    """Vertices of long numbers that are seen `low` to `high` pixels from a sample, at the given angles."""
    found = []
    for angle, (share, depth) in zip(angles.tolist(), noise(seed, len(angles), 2).tolist(), strict=True):
        radius = (low + high) / 2 + (high - low) / 2 * share
        x, y = i + 0.5 + radius * math.cos(angle), j + 0.5 - radius * math.sin(angle)
        z = -int(2.0 ** (DEPTH_BITS + 1.6 + 0.9 * depth))
        found.append((
            round(STEP * (2 * x - SIDE) / 2**18 * -z), round(STEP * (SIDE - 2 * y) / 2**18 * -z), z
        ))  # fmt: skip
    return found


def samples() -> list[tuple[int, int, int]]:
    """(number, column, row) of the samples that the cases are about."""
    half = SPACING // 2
    places = [(i, j) for j in range(half, SIDE, SPACING) for i in range(half, SIDE, SPACING)]
    return [(k, i, j) for k, (i, j) in enumerate(places)]


def world(points: list[Integers]) -> np.ndarray:
    """Integer vertices in world space; float32 holds them exactly."""
    assert all(abs(c) < 2**24 for point in points for c in point)
    return np.array(points, dtype=np.float64) * 2.0**-DEPTH_BITS


@FAMILY.case(
    "hubs", "Fans of long numbers whose hubs lie exactly on samples: each spoke's V is 0 in 66 bits, noise in 53.",
    wrong=NO_EXACT,
)  # fmt: skip
def hubs() -> Built:
    shapes: list[Shape] = []
    for seed, i, j in samples():
        d = direction(i, j)
        hub = combine(13 + 2 * (seed % 6), d, 0, d)
        rim = world(points_round(i, j, np.arange(12) * math.pi / 6, seed))
        shapes.append(fan(tuple(world([hub])[0]), [tuple(p) for p in rim]))
    return join(shapes), [LONG_NUMBERS]


def crossing_quads(offset: int) -> Shape:
    """Quads round samples; the diagonal of each crosses the sample's ray, or has `offset` times the smallest V."""
    shapes = []
    for seed, i, j in samples():
        d = direction(i, j)
        angle = 0.4 + 0.7 * seed
        a, side_a, side_b = points_round(i, j, angle + np.array([0.0, 0.5, 1.5]) * math.pi, seed)
        b = combine(nearest(4 * a[2], d[2]), d, -2, a)  # twice as far as a, on the other side of the ray
        if offset:
            b = nearby(a, d, b, offset * (1 if seed % 2 else -1))
        points = world([a, side_a, b, side_b])
        shapes.append((points, np.array([(0, 1, 2), (0, 2, 3)])))
    return join(shapes)


def nearby(a: Integers, d: Integers, target: Integers, multiple: int) -> Integers:
    """An integer b near `target` with det(a, b, d) = multiple * g, g the smallest number above 0 that it can be.

    det(a, b, d) = n . b with n = d x a. The solutions of n . b = 0 have the basis d / gcd(d) and a second vector,
    found from one solution of n . b = g in the plane; near is: within half a cell of that lattice.
    """
    n = cross(d, a)
    g_xy, s, t = euclid(n[0], n[1])
    g, u, v = euclid(g_xy, n[2])
    start = (multiple * u * s, multiple * u * t, multiple * v)
    # A basis of n . b = 0: (n_y, -n_x, 0) / g_xy, and the one that takes the smallest step in z.
    flat = (n[1] // g_xy, -n[0] // g_xy, 0)
    risen = (-s * (n[2] // g), -t * (n[2] // g), g_xy // g)
    first, second = reduce_pair(flat, risen)
    rest = combine(1, target, -1, start)
    # rest = x first + y second, nearly: by the two components in which n is not largest.
    drop = max(range(3), key=lambda axis: abs(n[axis]))
    p, q = [axis for axis in range(3) if axis != drop]
    area = first[p] * second[q] - first[q] * second[p]
    x = nearest(rest[p] * second[q] - rest[q] * second[p], area)
    y = nearest(first[p] * rest[q] - first[q] * rest[p], area)
    return combine(1, combine(1, start, x, first), y, second)


def euclid(a: int, b: int) -> tuple[int, int, int]:
    """(g, s, t) with g = gcd(a, b) = s a + t b, g > 0."""
    old, new, s, next_s, t, next_t = a, b, 1, 0, 0, 1
    while new:
        quotient = old // new
        old, new = new, old - quotient * new
        s, next_s = next_s, s - quotient * next_s
        t, next_t = next_t, t - quotient * next_t
    return (old, s, t) if old > 0 else (-old, -s, -t)


def nearest(a: int, b: int) -> int:
    """The integer nearest to a / b."""
    return (2 * a + b) // (2 * b)


def reduce_pair(a: Integers, b: Integers) -> tuple[Integers, Integers]:
    """A basis of the same lattice with the shortest vectors (Gauss and Lagrange)."""
    while True:
        if dot(a, a) > dot(b, b):
            a, b = b, a
        step = nearest(dot(a, b), dot(a, a))
        if step == 0:
            return a, b
        b = combine(1, b, -step, a)


@FAMILY.case(
    "crossings", "Edges of long numbers pass exactly through samples: V is 0 in 66 bits, noise in 53.",
    wrong=NO_EXACT,
)  # fmt: skip
def crossings() -> Built:
    return crossing_quads(0), [LONG_NUMBERS]


@FAMILY.case(
    "passings", "Edges of long numbers pass by samples as closely as can be: V is 1 in numbers of 66 bits.",
    wrong=NO_EXACT,
)  # fmt: skip
def passings() -> Built:
    return crossing_quads(1), [LONG_NUMBERS]
