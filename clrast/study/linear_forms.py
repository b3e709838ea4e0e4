"""Edge functions and depth of each triangle as linear forms A + B x + C y of the sample: float64 and integer.

For both planar projections V_i, and the two halves of t = numerator / denominator, are linear in (x, y). Here
they are found once per triangle, in float64 with a bound on the error, and on request in integers without any.

Error bounds. u = 2^-53. Inputs are float32, so they are exact; a difference of two has relative error u; a cross
product of such differences is within 5u of its permanent (the same expression with absolute values and plus
signs); a dot product with a third vector adds 4u, and summing A + B x + C y adds 3u of |A| + |B| x + |C| y. That
makes 13u of the permanents; 16u is used, which also pays for rounding in the bound itself. Nothing under- or
overflows: a product of three float32 differences lies within 2^-447 and 2^393.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import frexp, ldexp

import numpy as np

UNIT_64 = 2.0**-53
BOUND_64 = 16 * UNIT_64

IntegerForm = tuple[int, int, int]


@dataclass(frozen=True)
class FloatForms:
    """float64 forms and bounds that hold for every sample with 0 <= x <= width, 0 <= y <= height.

    edge : (3 edges, 3 coefficients A B C, triangle_count); edge_error : (3 edges, triangle_count)
    facing, facing_error : (triangle_count,), V (orthographic: S)
    numerator, denominator : (3 coefficients, triangle_count), t is their ratio; *_error : (triangle_count,)
    """

    edge: np.ndarray
    edge_error: np.ndarray
    facing: np.ndarray
    facing_error: np.ndarray
    numerator: np.ndarray
    numerator_error: np.ndarray
    denominator: np.ndarray
    denominator_error: np.ndarray


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Dot product over the last axis, in the fixed order x, y, z."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def cross(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cross product over the last axis and its permanent."""
    terms = [(a[..., (k + 1) % 3] * b[..., (k + 2) % 3], a[..., (k + 2) % 3] * b[..., (k + 1) % 3]) for k in range(3)]
    value = np.stack([p - q for p, q in terms], axis=-1)
    return value, np.stack([abs(p) + abs(q) for p, q in terms], axis=-1)


def form(
    normal: np.ndarray, permanent: np.ndarray, axes: list[np.ndarray], size: list[int]
) -> tuple[np.ndarray, np.ndarray]:
    """[normal . axes[k] for k] and the bound of their sum at any sample of the image."""
    weights = [1, size[0], size[1]]
    bounds = [weights[k] * dot(permanent, abs(axes[k])) for k in range(3)]
    return np.stack([dot(normal, axis) for axis in axes]), BOUND_64 * (bounds[0] + bounds[1] + bounds[2])


def float_forms(corners: np.ndarray, camera: Mapping[str, Sequence[float]], width: int, height: int) -> FloatForms:
    """corners : (triangle_count, 3 vertices, 3) float64 holding float32 numbers; camera as in `stats["camera"]`."""
    vectors = {name: np.array(values, dtype=np.float64) for name, values in camera.items()}
    size, p = [width, height], [corners[:, k] for k in range(3)]
    normal, permanent = cross(p[1] - p[0], p[2] - p[0])
    if "d0" in vectors:
        axes = [vectors["d0"], vectors["dx"], vectors["dy"]]
        a = [vertex - vectors["e"] for vertex in p]
        normals = [cross(a[(i + 2) % 3], a[(i + 1) % 3]) for i in range(3)]
        edges = [form(n, perm, axes, size) for n, perm in normals]
        facing, facing_bound = dot(a[0], normals[0][0]), dot(abs(a[0]), normals[0][1])
        denominator, denominator_error = form(normal, permanent, axes, size)
        constant, numerator_bound = dot(normal, a[0]), dot(permanent, abs(a[0]))
        numerator = np.stack([constant, 0 * constant, 0 * constant])
        numerator_error = BOUND_64 * numerator_bound
    else:
        d, e0, ex, ey = (vectors[name] for name in ("d", "e0", "ex", "ey"))
        edges = []
        for i in range(3):
            n, perm = cross(np.broadcast_to(d, p[0].shape), p[(i + 1) % 3] - p[(i + 2) % 3])
            edges.append(form(n, perm, [e0 - p[(i + 1) % 3], ex, ey], size))
        facing, facing_bound = -dot(normal, d), dot(permanent, abs(d))
        numerator, numerator_error = form(normal, permanent, [p[0] - e0, -ex, -ey], size)
        denominator = np.stack([-facing, 0 * facing, 0 * facing])
        denominator_error = BOUND_64 * facing_bound
    return FloatForms(
        edge=np.stack([value for value, _ in edges]),
        edge_error=np.stack([error for _, error in edges]),
        facing=facing,
        facing_error=BOUND_64 * facing_bound,
        numerator=numerator,
        numerator_error=numerator_error,
        denominator=denominator,
        denominator_error=denominator_error,
    )


def fraction_bits(values: np.ndarray) -> int:
    """The smallest k for which every float32 of `values` times 2^k is sure to be an integer."""
    finite = [abs(float(v)) for v in np.unique(np.abs(values.astype(np.float64))) if v != 0]
    return 24 - frexp(finite[0])[1] if finite else 0


def integers(values: Sequence[float], bits: int) -> list[int]:
    """Each number times 2^bits, exactly."""
    return [int(ldexp(float(v), bits)) if bits >= 0 else int(float(v)) >> -bits for v in values]


def exact_cross(a: list[int], b: list[int]) -> list[int]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def exact_dot(a: list[int], b: list[int]) -> int:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def minus(a: list[int], b: list[int]) -> list[int]:
    return [a[0] - b[0], a[1] - b[1], a[2] - b[2]]


class IntegerForms:
    """The same forms without error: Python integers in X = 2 i + 1 and Y = 2 j + 1 for pixel (i, j).

    Lengths are multiplied by 2^length_bits, direction vectors by 2^ray_bits, forms by whatever is positive.
    """

    def __init__(self, positions: np.ndarray, triangles: np.ndarray, camera: Mapping[str, Sequence[float]]) -> None:
        self.is_perspective = "d0" in camera
        lengths = ["e"] if self.is_perspective else ["e0", "ex", "ey"]
        rays = ["d0", "dx", "dy"] if self.is_perspective else ["d"]
        used = np.asarray(positions)[np.asarray(triangles).reshape(-1)]
        self.length_bits = max(fraction_bits(used), fraction_bits(np.array([camera[k] for k in lengths])), 0)
        self.ray_bits = max(fraction_bits(np.array([camera[k] for k in rays])), 0)
        self.vectors = {k: integers(camera[k], self.length_bits) for k in lengths}
        self.vectors |= {k: integers(camera[k], self.ray_bits) for k in rays}
        self.positions, self.triangles = positions, triangles
        self.known: dict[int, tuple[list[IntegerForm], int, IntegerForm, IntegerForm]] = {}

    def corners(self, prim_id: int) -> list[list[int]]:
        """The triangle's vertices as integers."""
        rows = self.positions[self.triangles[prim_id].astype(np.int64)].tolist()
        return [integers(row, self.length_bits) for row in rows]

    def of(self, prim_id: int) -> tuple[list[IntegerForm], int, IntegerForm, IntegerForm]:
        """(three edge forms, V or S, numerator, denominator) of one triangle; kept for the next call."""
        if prim_id not in self.known:
            p = self.corners(prim_id)
            self.known[prim_id] = self._perspective(p) if self.is_perspective else self._orthographic(p)
        return self.known[prim_id]

    def _perspective(self, p: list[list[int]]) -> tuple[list[IntegerForm], int, IntegerForm, IntegerForm]:
        e, d0, dx, dy = (self.vectors[name] for name in ("e", "d0", "dx", "dy"))
        a = [minus(vertex, e) for vertex in p]
        normals = [exact_cross(a[(i + 2) % 3], a[(i + 1) % 3]) for i in range(3)]
        plane = exact_cross(minus(p[1], p[0]), minus(p[2], p[0]))
        # Twice the direction of a sample is 2 d0 + X dx + Y dy.
        forms = [(2 * exact_dot(n, d0), exact_dot(n, dx), exact_dot(n, dy)) for n in (*normals, plane)]
        return forms[:3], exact_dot(a[0], normals[0]), (exact_dot(plane, a[0]), 0, 0), forms[3]

    def _orthographic(self, p: list[list[int]]) -> tuple[list[IntegerForm], int, IntegerForm, IntegerForm]:
        d, e0, ex, ey = (self.vectors[name] for name in ("d", "e0", "ex", "ey"))
        edges = []
        for i in range(3):
            n = exact_cross(d, minus(p[(i + 1) % 3], p[(i + 2) % 3]))
            edges.append((2 * exact_dot(n, minus(e0, p[(i + 1) % 3])), exact_dot(n, ex), exact_dot(n, ey)))
        plane = exact_cross(minus(p[1], p[0]), minus(p[2], p[0]))
        numerator = (2 * exact_dot(plane, minus(p[0], e0)), -exact_dot(plane, ex), -exact_dot(plane, ey))
        return edges, -exact_dot(plane, d), numerator, (exact_dot(plane, d), 0, 0)

    def covers(self, prim_id: int, i: int, j: int) -> bool:
        """Whether the sample at the centre of pixel (i, j) is covered, by the fill rule."""
        edges, facing, _, _ = self.of(prim_id)
        if facing == 0:
            return False
        for a, b, c in edges:
            value = (a + b * (2 * i + 1) + c * (2 * j + 1)) or b or c
            if (value > 0) != (facing > 0) or value == 0:
                return False
        return True

    def depth_ratio(self, prim_id: int, i: int, j: int) -> tuple[int, int] | None:
        """(numerator, denominator > 0) of t at the sample, up to one scale for all; None where it is undefined."""
        _, _, (a, b, c), (f, g, h) = self.of(prim_id)
        x, y = 2 * i + 1, 2 * j + 1
        numerator, denominator = a + b * x + c * y, f + g * x + h * y
        if denominator == 0:
            return None
        return (numerator, denominator) if denominator > 0 else (-numerator, -denominator)

    def t(self, ratio: tuple[int, int]) -> Fraction:
        """The exact t of a `depth_ratio`."""
        numerator, denominator = ratio
        if self.is_perspective:
            return Fraction(numerator << (self.ray_bits + 1), denominator << self.length_bits)
        return Fraction(numerator << self.ray_bits, denominator << (self.length_bits + 1))

    def closest(self, prim_ids: Sequence[int], i: int, j: int) -> tuple[int, tuple[int, int]] | None:
        """The visible one among some triangles at a sample, and its `depth_ratio`; None where none is hit."""
        best: tuple[int, tuple[int, int]] | None = None
        for prim_id in sorted(prim_ids):
            if not self.covers(prim_id, i, j):
                continue
            ratio = self.depth_ratio(prim_id, i, j)
            if ratio is None or ratio[0] <= 0:
                continue
            if best is None or ratio[0] * best[1][1] < best[1][0] * ratio[1]:
                best = (prim_id, ratio)
        return best
