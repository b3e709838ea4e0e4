"""The formulas of cl/projected_edges.clh in numbers that know what float32 makes of them: running error bounds.

Each `Rounded` number is what real arithmetic gives (in float64, whose own rounding is 2^-29 of the bound) and a bound
on its error in float32. Bounds run along with the operations (u = 2^-24):

    a + b    E_a + E_b,                                   and u (|a + b| + that) for the rounding of the result
    a * b    |a| E_b + |b| E_a + E_a E_b,                 likewise
    a / b    (E_a + |a / b| E_b) / (|b| - E_b),           likewise; no bound where E_b >= |b|

Inputs are exact but for the view's inverse axes, whose rounding to float32 is an error of u to begin with, and for the
place of a clipped edge's end, which the kernel takes 2^-24 of the way off. A sample is within rounding of an edge where
the bound of the edge's value there exceeds the value.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clrast.opencl.features import Edges
from clrast.scene.camera import CameraVectors

U = 2.0**-24


class Rounded:
    """Float32 numbers by their real value and a bound on their error: (count,) float64 each."""

    def __init__(self, value, error=0.0) -> None:
        self.value, self.error = np.asarray(value, dtype=np.float64), np.asarray(error, dtype=np.float64)

    @staticmethod
    def of(value) -> Rounded:
        return value if isinstance(value, Rounded) else Rounded(value)

    @staticmethod
    def result(value, error) -> Rounded:
        with np.errstate(all="ignore"):
            found = error + U * (abs(value) + error)
            return Rounded(value, np.where(np.isnan(found), np.inf, found))

    def __neg__(self) -> Rounded:
        return Rounded(-self.value, self.error)

    def __add__(self, other) -> Rounded:
        with np.errstate(all="ignore"):
            return self.result(self.value + Rounded.of(other).value, self.error + Rounded.of(other).error)

    def __sub__(self, other) -> Rounded:
        return self + -Rounded.of(other)

    def __mul__(self, other) -> Rounded:
        a, b = self, Rounded.of(other)
        with np.errstate(all="ignore"):
            error = abs(a.value) * b.error + abs(b.value) * a.error + a.error * b.error
            return self.result(a.value * b.value, error)

    def __truediv__(self, other) -> Rounded:
        a, b = self, Rounded.of(other)
        with np.errstate(all="ignore"):
            value = a.value / b.value
            error = (a.error + abs(value) * b.error) / (abs(b.value) - b.error)
            return self.result(value, np.where(abs(b.value) > b.error, error, np.inf))

    def times_power(self, power) -> Rounded:
        """Times powers of two or a sign: nothing is rounded."""
        return Rounded(self.value * power, self.error * abs(power))

    def moved(self, step: np.ndarray) -> Rounded:
        """What the kernel takes for another number, `step` away."""
        return Rounded(self.value + step, self.error + abs(step))

    def is_certain(self) -> np.ndarray:
        return (abs(self.value) > self.error) | (self.error == 0)


def choose(mask: np.ndarray, a, b):
    """a where the mask is set, else b; of Rounded or of lists of them."""
    if isinstance(a, list):
        return [choose(mask, *pair) for pair in zip(a, b, strict=True)]
    return Rounded(np.where(mask, a.value, b.value), np.where(mask, a.error, b.error))


def pick(number: Rounded, k: int) -> Rounded:
    return Rounded(number.value[k], number.error[k])


def dot(a: list, b: list) -> Rounded:
    return (a[0] * b[0] + a[1] * b[1]) + a[2] * b[2]


def minus(a: list, b: list) -> list:
    return [p - q for p, q in zip(a, b, strict=True)]


def cross(a: list, b: list) -> list:
    return [a[k - 2] * b[k - 1] - a[k - 1] * b[k - 2] for k in range(3)]


def rounded_vector(exact: np.ndarray) -> list[Rounded]:
    """Float64 numbers that reach the kernel in float32."""
    return [Rounded(c, 0.0 if np.float32(c) == c else U * abs(c)) for c in exact]


@dataclass
class Setup:
    """What a kernel's setup stands for: edges [3][c, gx, gy], nearness [c, x, y], positive inside, seen from its front.

    turn : area, determinant or volume, whose sign turns the edges. depths : of the vertices, where their sign decides.
    hidden : [3] (count,) bool, edges that are left out.
    """

    edges: list[list[Rounded]]
    nearness: list[Rounded]
    turn: Rounded
    depths: list[Rounded]
    hidden: list[np.ndarray]

    def at(self, prim_id: int, x: float, y: float) -> tuple[list[Rounded], Rounded]:
        """(values of the edges that are not hidden, nearness) of one triangle; X and Y from the image's centre."""
        edges = [[pick(c, prim_id) for c in edge] for edge, gone in zip(self.edges, self.hidden) if not gone[prim_id]]
        values = [(c + gx * x) + gy * y for c, gx, gy in (*edges, [pick(c, prim_id) for c in self.nearness])]
        return values[:-1], values[-1]

    def oriented(self) -> Setup:
        sign = np.where(self.turn.value < 0, -1.0, 1.0)
        return replace(self, edges=[[c.times_power(sign) for c in edge] for edge in self.edges])

    def is_certain(self) -> np.ndarray:
        """Where no rounding can change a decision of the setup's own."""
        return np.all([one.is_certain() for one in (self.turn, *self.depths)], axis=0)


class ViewTwin:
    """A view's vectors, and the formulas of projected_edges.clh for them."""

    def __init__(self, view: CameraVectors) -> None:
        self.is_perspective = view.projection == "perspective"
        tx, ty = (np.array(v) for v in (view.tangent_x, view.tangent_y))
        center = np.array(view.first) + view.width / 2 * tx + view.height / 2 * ty
        low = center - center.astype(np.float32)
        self.low = [Rounded(c, U * abs(c)) for c in low]
        self.origin = np.array(view.origin) if self.is_perspective else center.astype(np.float32)
        axis = center if self.is_perspective else np.array(view.direction)
        self.axis = axis.astype(np.float32).astype(np.float64)
        self.tangents = [tx, ty]
        self.focal = 1 / min(np.linalg.norm(tx), np.linalg.norm(ty))
        rows = np.cross(ty, axis), np.cross(axis, tx), np.cross(tx, ty)
        self.inverse = [rounded_vector(row / tx.dot(rows[0])) for row in rows]

    def transform(self, corner: np.ndarray) -> list[Rounded]:
        """corner : (count, 3)."""
        r = [Rounded.result(corner[:, k] - float(self.origin[k]), 0.0) for k in range(3)]
        r = r if self.is_perspective else minus(r, self.low)
        return [dot(r, row) for row in self.inverse]

    def screen_edge(self, a: list, b: list, pa: list, pb: list) -> tuple[list[Rounded], np.ndarray]:
        """([c, gx, gy, gq], hidden)."""
        scale, hidden = np.ones(len(a[0].value)), np.zeros(len(a[0].value), dtype=bool)
        if self.is_perspective:
            a_in_front, b_in_front = a[2].value > 0, b[2].value > 0
            front, behind = choose(a_in_front, a, b), choose(a_in_front, b, a)
            margin_nearness = choose(a_in_front, pa[2], pb[2]).times_power(2.0**24)
            span = front[2] - behind[2]
            clip = []
            for k in range(2):
                crossing = behind[k] * front[2] - front[k] * behind[2]
                # Where the eye's plane is met, in place of the point 2^-24 of the way back.
                step = 2.0**-24 * (front[k].value * span.value - crossing.value)
                clip.append(crossing.moved(step) * (margin_nearness / span))
            pa = choose(a_in_front, pa, [*clip, margin_nearness])
            pb = choose(b_in_front, pb, [*clip, margin_nearness])
            scale, hidden = np.where(a_in_front != b_in_front, 2.0**-24, 1.0), ~(a_in_front | b_in_front)
        found = [pa[0] * pb[1] - pa[1] * pb[0], pa[1] - pb[1], pb[0] - pa[0], pb[2] - pa[2]]
        return [one.times_power(scale) for one in found], hidden

    def projected(self, corners: np.ndarray) -> Setup:
        h = [self.transform(corners[:, i]) for i in range(3)]
        p = [[c[0] / c[2], c[1] / c[2], Rounded(1) / c[2]] if self.is_perspective else [c[0], c[1], -c[2]] for c in h]
        found = [self.screen_edge(h[i - 2], h[i - 1], p[i - 2], p[i - 1]) for i in range(3)]
        e, hidden = [edge for edge, _ in found], [mask for _, mask in found]
        leaving, reaching, corner = e[2], e[1], p[0]
        if self.is_perspective:
            keys = [np.stack([-c[2].value, c[0].value, c[1].value], axis=1) for c in h]
            first = first_rows(keys)
            leaving = choose(first == 1, e[0], choose(first == 2, e[1], e[2]))
            reaching = choose(first == 1, e[2], choose(first == 2, e[0], e[1]))
            corner = choose(first == 1, p[1], choose(first == 2, p[2], p[0]))
        area = leaving[2] * reaching[1] - leaving[1] * reaching[2]
        x, y = ((leaving[3] * reaching[k] - reaching[3] * leaving[k]) / area for k in (1, 2))
        nearness = [corner[2] - (corner[0] * x + corner[1] * y), x, y]
        depths = [c[2] for c in h] if self.is_perspective else []
        return Setup([edge[:3] for edge in e], nearness, area, depths, hidden).oriented()

    def homogeneous(self, corners: np.ndarray) -> Setup:
        h = [self.transform(corners[:, i]) for i in range(3)]
        rows = [cross(h[i - 2], h[i - 1]) for i in range(3)]
        reach = [abs(c[0].value) + abs(c[1].value) + self.focal * abs(c[2].value) for c in h]
        first = first_rows([np.stack([r, c[0].value, c[1].value], axis=1) for r, c in zip(reach, h, strict=True)])
        corner, after, last = (
            choose(first == 1, h[k - 2], choose(first == 2, h[k - 1], h[k])) for k in range(3)
        )
        total = cross(minus(after, corner), minus(last, corner))
        determinant = dot(total, corner)
        edges = [[row[2], row[0], row[1]] for row in rows]
        nearness = [total[k] / determinant for k in (2, 0, 1)]
        return Setup(edges, nearness, determinant, [], [np.zeros(len(corners), dtype=bool)] * 3).oriented()

    def barycentric(self, corners: np.ndarray) -> Setup:
        p = [[corners[:, i, k] for k in range(3)] for i in range(3)]
        oa = [Rounded.result(p[0][k] - float(self.origin[k]), 0.0) for k in range(3)]
        ba, ca = ([Rounded.result(p[0][k] - q[k], 0.0) for k in range(3)] for q in p[1:])
        d, normal = [Rounded(c) for c in self.axis], cross(ba, ca)
        tx, ty = ([Rounded(c) for c in tangent] for tangent in self.tangents)
        if self.is_perspective:
            m, beta, gamma = (
                [dot(n, d) + dot(n, self.low), dot(n, tx), dot(n, ty)]
                for n in (normal, cross(oa, ca), cross(ba, oa))
            )
            volume, along = dot(normal, oa), m
        else:
            beta, gamma = (
                [dot(n, oa) - dot(n, self.low), -dot(n, tx), -dot(n, ty)] for n in (cross(ca, d), cross(d, ba))
            )
            volume = dot(normal, d)
            m = [volume, Rounded(0), Rounded(0)]
            along = [dot(normal, self.low) - dot(normal, oa), dot(normal, tx), dot(normal, ty)]
        alpha = [m[k] - (beta[k] + gamma[k]) for k in range(3)]
        nearness = [one / volume for one in along]
        return Setup([alpha, beta, gamma], nearness, volume, [], [np.zeros(len(corners), dtype=bool)] * 3).oriented()

    def setup(self, kind: Edges, corners: np.ndarray) -> Setup:
        """corners : (count, 3, 3) float32, in the order of the file."""
        p = corners.astype(np.float64) + 0.0
        first = first_rows([p[:, i] for i in range(3)])
        return getattr(self, kind.name.lower())(np.stack([np.roll(c, -k, axis=0) for c, k in zip(p, first)]))


def first_rows(keys: list[np.ndarray]) -> np.ndarray:
    """(count,) which of three (count, 3) keys comes first, as is_first of edge_function.clh decides."""

    def before(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        x, y, z = (a[:, k] < b[:, k] for k in range(3))
        return x | ((a[:, 0] == b[:, 0]) & (y | ((a[:, 1] == b[:, 1]) & z)))

    first1 = ~before(keys[2], keys[1]) & before(keys[1], keys[0])
    first2 = ~before(keys[0], keys[2]) & before(keys[2], keys[1])
    return np.where(first1, 1, np.where(first2, 2, 0))
