"""How far a float32 renderer may be from the real edge function and depth: forward error bounds.

u = 2^-24 is the relative error of one float32 operation; tiny = 2^-149 pays for subnormal products. For a sample
at (x, y), with |.| and all products by component and `sum` over the three components:

    d = d0 + x dx + y dy             D = 3u (|d0| + x |dx| + y |dy|)              two products, two additions
    m = e - (a + b)/2                M = u |m| + u |a + b| / 2                    one addition, one subtraction
    q = a - b                        Q = u |q|
    n = m x q (perspective)          N = M*|q| + |m|*Q + 2u |m|*|q|               where * has the terms of x, all plus
    V_i = n . d                      error <= sum(N |d| + |n| D + 3u |n| |d|)

Orthographic: n = d x q has N = |d|*Q + 2u |d|*|q|, and V_i = n . (e - mid) likewise with the error of e - mid.
The depth is w = (N . d)/(N . (p0 - e)) with N = (p1 - p0) x (p2 - p0): the relative errors of both halves add up.
Terms of second order are paid for by a factor 1.001. All of it is evaluated in float64.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

U = 2.0**-24
TINY = 2.0**-149
SECOND_ORDER = 1.001


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a x b; numpy's own takes ten times as long for one vector."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _permanent(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a x b with absolute values and plus signs."""
    a, b = abs(a), abs(b)
    return np.array([a[1] * b[2] + a[2] * b[1], a[2] * b[0] + a[0] * b[2], a[0] * b[1] + a[1] * b[0]])


def _dot_error(n: np.ndarray, n_error: np.ndarray, d: np.ndarray, d_error: np.ndarray) -> float:
    """Error of n . d in float32."""
    return float((n_error * abs(d) + abs(n) * d_error + 3 * U * abs(n) * abs(d)).sum() + 3 * TINY)


class Float32Bounds:
    """Bounds at samples of one view. `camera_vectors` as in `stats["camera"]`."""

    def __init__(self, camera_vectors: Mapping[str, Sequence[float]]) -> None:
        self.camera = {name: np.array(values, dtype=np.float64) for name, values in camera_vectors.items()}
        self.is_perspective = "d0" in self.camera

    def ray(self, x: float, y: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """(e, error of e, d, error of d) at a sample."""
        c, none = self.camera, np.zeros(3)
        names = ("d0", "dx", "dy") if self.is_perspective else ("e0", "ex", "ey")
        start, along_x, along_y = (c[name] for name in names)
        value = start + x * along_x + y * along_y
        error = 3 * U * (abs(start) + x * abs(along_x) + y * abs(along_y)) + 2 * TINY
        return (c["e"], none, value, error) if self.is_perspective else (value, error, c["d"], none)

    def edge(self, corners: np.ndarray, i: int, x: float, y: float) -> float:
        """Bound on the error of V_i. corners : (3, 3) float64 holding float32 numbers."""
        e, e_error, d, d_error = self.ray(x, y)
        a, b = corners[(i + 2) % 3], corners[(i + 1) % 3]
        q, half_sum = a - b, abs(a + b) / 2
        m = e - (a + b) / 2
        m_error, q_error = U * abs(m) + U * half_sum + e_error, U * abs(q)
        if self.is_perspective:
            n = _cross(m, q)
            n_error = _permanent(m_error, q) + _permanent(m, q_error) + 2 * U * _permanent(m, q) + 2 * TINY
            return SECOND_ORDER * _dot_error(n, n_error, d, d_error)
        n = _cross(d, q)
        n_error = _permanent(d, q_error) + 2 * U * _permanent(d, q) + 2 * TINY
        return SECOND_ORDER * _dot_error(n, n_error, m, m_error)

    def relative_depth(self, corners: np.ndarray, x: float, y: float) -> float:
        """Bound on the relative error of w (and of t); inf where w is only noise."""
        e, e_error, d, d_error = self.ray(x, y)
        q1, q2, a = corners[1] - corners[0], corners[2] - corners[0], corners[0] - e
        n = _cross(q1, q2)
        n_error = 4 * U * _permanent(q1, q2) + 2 * TINY
        over, under = abs(float(np.dot(n, d))), abs(float(np.dot(n, a)))
        over_error = _dot_error(n, n_error, d, d_error)
        under_error = _dot_error(n, n_error, a, U * abs(a) + e_error)
        if over <= over_error or under <= under_error:
            return float("inf")
        return SECOND_ORDER * (over_error / (over - over_error) + under_error / (under - under_error) + U)
