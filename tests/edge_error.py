"""How far the kernels' float32 edge functions may be from V: forward error bounds of their own formulas.

u = 2^-24 is the relative error of one operation. With m = (a - e) + (b - e) and q = b - a:

perspective   n = m x q. The differences have the relative error u, so m has u (|a - e| + |b - e| + |m|), and n
              has that times |q|, and 3u |m| |q| from q and from the product.
orthographic  n = d x q has 3u |d| |q|, and c = -n . m / 2 takes the error of m, too.

A dot product of three terms adds 3u, its use in (c + X gx) + Y gy at most 3u more. All in float64.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import reference as ref

from clrast.scene.camera import CameraVectors

U = 2.0**-24
SECOND_ORDER = 1.001


def permanent(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """|a x b| with every minus a plus: (count, 3)."""
    a, b = abs(a), abs(b)
    return np.stack([a[:, k - 2] * b[:, k - 1] + a[:, k - 1] * b[:, k - 2] for k in range(3)], axis=1)


def edge_error(view: CameraVectors, a: np.ndarray, b: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Forward error (count,) of V of the edge from a to b, in the kernel's scale (perspective: twice eq. 1).

    a, b : (count, 3) world space; at : (count, 2) X and Y from the image's centre, pixels.
    """
    a, b = a.astype(np.float64), b.astype(np.float64)
    tx, ty = (abs(np.array(t)) for t in (view.tangent_x, view.tangent_y))
    steps = abs(at[:, :1]) * tx + abs(at[:, 1:]) * ty
    center = np.array(view.center())
    origin = center if view.projection == "orthographic" else np.array(view.origin)
    ra, rb = a - origin, b - origin
    m, q = ra + rb, b - a
    m_error = U * (abs(ra) + abs(rb) + abs(m))
    if view.projection == "orthographic":
        n = permanent(np.broadcast_to(np.array(view.direction), q.shape), q)
        reach = abs(m) / 2 + steps + U * abs(center)
        return SECOND_ORDER * (9 * U * n * reach + n * m_error / 2).sum(axis=1)
    n = permanent(m, q)
    reach = abs(center) + steps
    return SECOND_ORDER * ((permanent(m_error, q) + 9 * U * n) * reach).sum(axis=1)


def near_edges(view: CameraVectors, corners: np.ndarray, i: int, j: int) -> list[int]:
    """Edges of a triangle, corners (3, 3) float32, whose exact V at pixel (column i, row j) is within the error."""
    camera = ref.exact_camera(view.named())
    ray = ref.sample_ray(camera, i + ref.HALF, j + ref.HALF)
    triangle = ref.exact_triangles(corners, np.array([[0, 1, 2]]))[0]
    values, _, _ = ref.edge_values(triangle, ray, camera.is_perspective)
    at = np.array([[i + 0.5 - view.width / 2, j + 0.5 - view.height / 2]])
    found, scale = [], 2 if camera.is_perspective else 1
    for edge, value in enumerate(values):
        a, b = corners[(edge + 2) % 3][None], corners[(edge + 1) % 3][None]
        if abs(scale * value) <= Fraction(float(edge_error(view, a, b, at)[0])):
            found.append(edge)
    return found
