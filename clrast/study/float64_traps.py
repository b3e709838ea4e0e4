"""Edges and rays of float32 numbers for which float64 gets the sign of an edge function wrong; integers decide.

V = n . d, n = (a - e) x (b - e), of 24-bit numbers takes 72 bits and more; float64 has 53. Two kinds of traps:

    near   V is not 0, but its size is two units of the 2^66 that a, b and d have together. For integers a and b the
           values n . d are the multiples of g = gcd(n). Bezout's identity gives a d with n . d = g; the lattice of
           the vectors that leave this value as it is holds a and b, and taken modulo these d lies between them: the
           ray passes an edge at 1e-20 of its length, on a side that is known.
    zero   a vertex lies exactly on the ray, V = 0 for all edges that meet there, and the fill rule says which one
           of a closed fan has the sample. The rims have full mantissas of other sizes, so that float64 rounds.

Each trap is a scene of its own with a view of one sample, whose right answer is a prim_id by construction, found in
Python integers alone. The scenes are for `double` against `exact`; `float64_value` is the sum that a kernel makes.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass
from math import gcd

import numpy as np

from clrast.scene.camera import CameraVectors

Integers = tuple[int, int, int]
BITS = 22
"""Of the edges' ends; sums of four of these still are float32 numbers."""
UNIT = 2.0**-BITS


@dataclass(frozen=True)
class Trap:
    """One sample of one scene.

    positions : (vertex_count, 3) float32; triangles : (triangle_count, 3) uint32. view : of 1 x 1 samples.
    prim_id : the triangle that the sample belongs to, in real arithmetic. kind : near or zero.
    edges : (edge_count, 2) vertex indices of the edges at or by which the sample lies. values : V at the sample, twice
    as large as in DESIGN and in units of their own, exact.
    """

    kind: str
    positions: np.ndarray
    triangles: np.ndarray
    view: CameraVectors
    prim_id: int
    edges: np.ndarray
    values: tuple[int, ...]


def cross(a: Integers, b: Integers) -> Integers:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def dot(a: Integers, b: Integers) -> int:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def combine(a: Integers, p: int, b: Integers, q: int) -> Integers:
    """p a + q b"""
    return (p * a[0] + q * b[0], p * a[1] + q * b[1], p * a[2] + q * b[2])


def bezout(a: int, b: int) -> tuple[int, int, int]:
    """(g, p, q) with p a + q b = g = gcd(a, b) >= 0."""
    p, q, r, s = 1, 0, 0, 1
    while b:
        k, a, b = a // b, b, a % b
        p, q, r, s = r, s, p - k * r, q - k * s
    return (a, p, q) if a >= 0 else (-a, -p, -q)


def least_product(n: Integers) -> Integers:
    """Some d with n . d = gcd(n)."""
    g, p, q = bezout(n[0], n[1])
    _, r, s = bezout(g, n[2])
    return (p * r, q * r, s)


def between(d: Integers, a: Integers, b: Integers) -> Integers:
    """d less multiples of a and b: what is left is alpha a + beta b + something tiny, 0 <= alpha, beta < 1.

    n . d stays as it is, n = a x b. alpha and beta by Gram's determinants, rounded down in integers.
    """
    aa, ab, bb, da, db = dot(a, a), dot(a, b), dot(b, b), dot(d, a), dot(d, b)
    whole = aa * bb - ab * ab
    alpha, beta = (da * bb - db * ab) // whole, (db * aa - da * ab) // whole
    return combine(d, 1, combine(a, alpha, b, beta), -1)


def float64_value(trap: Trap, edge: int) -> float:
    """V of an edge at the trap's sample as the midpoint form gives it in float64, multiplications and sums in turn."""
    view, (i, k) = trap.view, trap.edges[edge]
    a, b = (trap.positions[m].astype(np.float64) for m in (i, k))
    sides = [np.array(v, dtype=np.float64) for v in (view.first, view.tangent_x, view.tangent_y)]
    swept = sides[0] + 0.5 * sides[1] + 0.5 * sides[2]

    def product(p: np.ndarray, q: np.ndarray) -> np.ndarray:
        return np.array([p[k - 2] * q[k - 1] - p[k - 1] * q[k - 2] for k in range(3)])

    if view.projection == "orthographic":
        n = product(np.array(view.direction, dtype=np.float64), b - a)
        v = -((a - swept) + (b - swept))
    else:
        eye = np.array(view.origin, dtype=np.float64)
        n, v = product((a - eye) + (b - eye), b - a), swept
    return float((n[0] * v[0] + n[1] * v[1]) + n[2] * v[2])


# --- views of one sample ---------------------------------------------------------------------------


def scaled(v: Integers) -> tuple[float, float, float]:
    """Integers in UNIT as float32 numbers; ValueError where they are none."""
    found = tuple(float(c * UNIT) for c in v)
    if any(float(np.float32(c)) != c or abs(c) >= 8 for c in found):
        raise ValueError(f"{v} has more bits than float32")
    return (found[0], found[1], found[2])


def one_sample(projection: str, eye: Integers, ray: Integers, tx: Integers, ty: Integers) -> CameraVectors:
    """The view whose only sample has the ray (orthographic: from `eye` along `ray`); tx and ty even."""
    corner = combine(combine(ray if projection == "perspective" else eye, 2, tx, -1), 1, ty, -1)
    first = scaled((corner[0] // 2, corner[1] // 2, corner[2] // 2))
    return CameraVectors(projection, 1, 1, scaled(eye), scaled(ray), first, scaled(tx), scaled(ty))


def tangents(rng: random.Random, ray: Integers) -> tuple[Integers, Integers]:
    """Two small vectors of even numbers that make a proper view with the ray."""
    while True:
        found = [tuple(2 * rng.randint(-200, 200) for _ in range(3)) for _ in range(2)]
        tx, ty = (found[0][0], found[0][1], found[0][2]), (found[1][0], found[1][1], found[1][2])
        volume = dot(cross(tx, ty), ray)
        if abs(volume) > 60 * 60 << BITS:
            return (tx, ty) if volume > 0 else (ty, tx)


def vector(rng: random.Random, bits: int) -> Integers:
    """Three odd numbers of up to so many bits: their mantissas are full."""
    return tuple(rng.choice((-1, 1)) * (rng.getrandbits(bits) | 1) for _ in range(3))  # type: ignore[return-value]


# --- traps -----------------------------------------------------------------------------------------


def near_trap(rng: random.Random, projection: str) -> Trap | None:
    """Two triangles on either side of an edge that the ray all but meets; None where the numbers do not fit."""
    eye = vector(rng, BITS - 2) if rng.random() < 0.75 else (0, 0, 0)
    one, other = vector(rng, BITS - 1), vector(rng, BITS - 1)
    n = cross(one, other)
    sign = rng.choice((-1, 1))
    if gcd(*n) != 2:  # of odd numbers it is even
        return None
    least = combine(least_product(n), sign, (0, 0, 0), 0)
    found = between(least, one, other)
    if projection == "perspective":
        # Ends a and b as seen from the eye, the ray between them.
        a, b, ray = one, other, found
        apart = [combine(combine(a, 1, b, 1), 1, vector(rng, BITS), 1) for _ in range(2)]
        sides = [dot(n, v) for v in apart]
        values = (dot(n, ray),)
    else:
        # `one` is the direction, `other` the edge, `found` less a direction leads from a to the ray's origin.
        a = vector(rng, BITS - 1)
        b = combine(a, 1, other, 1)
        ray = one
        away = combine(found, 1, one, -1)
        apart = [combine(combine(a, 1, b, 1), 1, vector(rng, BITS), 1) for _ in range(2)]
        apart = [tuple(c // 2 for c in v) for v in apart]  # type: ignore[misc]
        sides = [dot(n, combine(v, 1, a, -1)) for v in apart]
        values = (dot(n, away),)
        start = combine(eye, 1, combine(a, 1, away, 1), 1)
    if sides[0] * sides[1] >= 0 or values[0] == 0:
        return None
    tx, ty = tangents(rng, ray)
    try:
        corners = [scaled(combine(eye, 1, v, 1)) for v in (a, b, *apart)]
        view = one_sample(projection, eye if projection == "perspective" else start, ray, tx, ty)
    except ValueError:
        return None
    prim_id = 0 if sides[0] * values[0] > 0 else 1
    return Trap("near", np.array(corners, np.float32), np.array([(0, 1, 2), (1, 0, 3)], np.uint32), view, prim_id,
                np.array([(0, 1)]), (2 * values[0],))  # fmt: skip


def zero_trap(rng: random.Random, projection: str, count: int = 6) -> Trap | None:
    """A closed fan whose hub lies on the ray; None where the numbers do not fit or the fan is folded."""
    eye = vector(rng, BITS - 2) if rng.random() < 0.75 else (0, 0, 0)
    ray = vector(rng, BITS - 1)
    tx, ty = tangents(rng, ray)
    # Rims round the ray: by the tangents in turn, out of the plane as well, and of sizes from 2^-12 to 1.
    turns = sorted(rng.random() for _ in range(count))
    angles = np.array(turns) * 2 * np.pi
    rims: list[Integers] = []
    for c, s in zip(np.cos(angles).tolist(), np.sin(angles).tolist(), strict=True):
        reach = 2.0 ** rng.uniform(0, 12)
        moved = combine(tx, round(reach * c * 4), ty, round(reach * s * 4))
        wobble = tuple(rng.randint(-1, 1) for _ in range(3))
        share = rng.randint(-(1 << 8), 1 << 8)
        rims.append(tuple(r + r * share // 1024 + m + w for r, m, w in zip(ray, moved, wobble, strict=True)))  # type: ignore[arg-type]
    signs = []
    for k in range(count):
        p, q = rims[k], rims[(k + 1) % count]
        signs.append(dot(cross(p, q), ray))
    if not all(s > 0 for s in signs):
        return None
    owner = fan_owner(projection, ray, rims, tx, ty)
    try:
        hub = ray
        corners = [scaled(combine(eye, 1, v, 1)) for v in (hub, *rims)]
        start = eye if projection == "perspective" else combine(eye, 1, ray, 0)
        view = one_sample(projection, start, ray, tx, ty)
    except ValueError:
        return None
    triangles = np.array([(0, 1 + k, 1 + (k + 1) % count) for k in range(count)], np.uint32)
    edges = np.array([(0, 1 + k) for k in range(count)])
    return Trap("zero", np.array(corners, np.float32), triangles, view, owner, edges, (0,) * count)


def fan_owner(projection: str, ray: Integers, rims: list[Integers], tx: Integers, ty: Integers) -> int:
    """The triangle of a fan that has the sample moved by (+eps, +eps^2): tx, then ty, decide for each spoke.

    A spoke's V grows along tx by n . tx, n = ray x rim. The triangle between spokes k and k + 1 has the sample where
    it lies to the left of the one and to the right of the other.
    """
    sides = []
    for rim in rims:
        n = cross(ray, rim)
        value = dot(n, tx) or dot(n, ty)
        sides.append(value > 0)
    owners = [k for k in range(len(rims)) if sides[k] and not sides[(k + 1) % len(rims)]]
    if len(owners) != 1:
        raise ArithmeticError("a fan that is closed and unfolded has one owner")
    return owners[0]


def traps(seed: int = 0, count: int = 64) -> Iterator[Trap]:
    """So many traps of each kind for each projection."""
    rng = random.Random(seed)
    for kind in (near_trap, zero_trap):
        for projection in ("perspective", "orthographic"):
            made = 0
            while made < count:
                trap = kind(rng, projection)
                if trap is not None:
                    made += 1
                    yield trap
