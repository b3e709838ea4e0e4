"""A float32 renderer of ids and depth in numpy: the specimen that the classifier is tried on.

Not a reference: it rounds as a kernel would. `midpoint` is DESIGN's default rung; `fast` takes plain cross products
relative to the eye; `contracted` the same with one product of each term left unrounded, as a compiler that fuses
multiply and add would: its edges are not antisymmetric, so it must show holes along them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from clrast.study.exact_visibility import NO_HIT, screen_boxes, small_boxes, spread
from clrast.study.linear_forms import float_forms

RUNGS = ("midpoint", "fast", "contracted")
FLOAT32_SLACK = 2.0**31  # float64 bounds times this let no sample out that float32 rounding could cover

Float3 = list[np.ndarray]


def cross(a: Float3, b: Float3, is_contracted: bool = False) -> Float3:
    """a x b in float32; contracted: the first product of each component enters the subtraction unrounded."""
    found = []
    for k in range(3):
        p, q, r, s = a[(k + 1) % 3], b[(k + 2) % 3], a[(k + 2) % 3], b[(k + 1) % 3]
        if is_contracted:
            found.append((p.astype(np.float64) * q - (r * s)).astype(np.float32))
        else:
            found.append(p * q - r * s)
    return found


def dot(a: Float3, b: Float3) -> np.ndarray:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def columns(rows: np.ndarray) -> Float3:
    """(count, 3) as three float32 arrays."""
    return [np.ascontiguousarray(rows[:, k], dtype=np.float32) for k in range(3)]


def minus(a: Float3, b: Float3) -> Float3:
    return [a[k] - b[k] for k in range(3)]


def edge_parts(p: list[Float3], ray: Mapping[str, Float3], i: int, rung: str) -> tuple[Float3, Float3 | None]:
    """Edge normal n_i and, for an orthographic view, the midpoint of the edge."""
    a, b, half = p[(i + 2) % 3], p[(i + 1) % 3], np.float32(0.5)
    midpoint = [(a[k] + b[k]) * half for k in range(3)]
    if "d0" not in ray:
        return cross(ray["d"], minus(b, a), rung == "contracted"), midpoint if rung == "midpoint" else b
    if rung == "midpoint":
        return cross(minus(ray["e"], midpoint), minus(a, b)), None
    return cross(minus(a, ray["e"]), minus(b, ray["e"]), rung == "contracted"), None


def hits(
    p: list[Float3], ray: Mapping[str, Float3], x: np.ndarray, y: np.ndarray, rung: str
) -> tuple[np.ndarray, np.ndarray]:
    """(is hit, w) for pairs of a triangle (vertices p) and a sample (x, y); all (pair_count,) float32."""
    is_perspective = "d0" in ray
    start, along_x, along_y = (ray[name] for name in (("d0", "dx", "dy") if is_perspective else ("e0", "ex", "ey")))
    swept = [(start[k] + x * along_x[k]) + y * along_y[k] for k in range(3)]
    d, e = (swept, ray["e"]) if is_perspective else (ray["d"], swept)
    values, signs = [], []
    for i in range(3):
        n, midpoint = edge_parts(p, ray, i, rung)
        value = dot(n, d) if midpoint is None else dot(n, minus(e, midpoint))
        if i == 0:
            first = n
        by_x, by_y = dot(n, along_x), dot(n, along_y)
        values.append(value)
        signs.append(np.sign(np.where(value != 0, value, np.where(by_x != 0, by_x, by_y))))
    facing = dot(minus(p[0], e), first) if is_perspective else (values[0] + values[1]) + values[2]
    normal = cross(minus(p[1], p[0]), minus(p[2], p[0]))
    with np.errstate(all="ignore"):
        w = dot(normal, d) / dot(normal, minus(p[0], e))
    is_hit = (facing != 0) & np.all([s == np.sign(facing) for s in signs], axis=0)
    return is_hit & (w > 0) & np.isfinite(w), w


def render_twin(
    positions: np.ndarray,
    triangles: np.ndarray,
    camera_vectors: Mapping[str, Sequence[float]],
    width: int,
    height: int,
    rung: str = "midpoint",
) -> tuple[np.ndarray, np.ndarray]:
    """`id.prim` (height, width) uint32 and `Z` (height, width) float32, +inf where nothing is hit."""
    positions, triangles = np.asarray(positions, dtype=np.float32), np.asarray(triangles).astype(np.int64)
    corners = positions[triangles].astype(np.float64)
    forms = float_forms(corners, camera_vectors, width, height)
    # An exact box would take from a triangle what float32 gives it just past its outermost edge: a hole.
    boxes = screen_boxes(corners, camera_vectors, width, height, margin=1.0)
    forms.edge[:] *= np.sign(forms.facing)
    boxes = small_boxes(boxes, replace(forms, edge_error=forms.edge_error * FLOAT32_SLACK))
    ray = {name: [np.asarray(value, dtype=np.float32) for value in values] for name, values in camera_vectors.items()}
    found = []
    for part in boxes.chunks():
        owner, k = spread(part.area())
        across = (part.x1 - part.x0)[owner]
        x, y, triangle = part.x0[owner] + k % across, part.y0[owner] + k // across, part.triangle[owner]
        p = [columns(positions[triangles[triangle, vertex]]) for vertex in range(3)]
        half = np.float32(0.5)
        is_hit, w = hits(p, ray, x.astype(np.float32) + half, y.astype(np.float32) + half, rung)
        found.append((y[is_hit] * width + x[is_hit], triangle[is_hit], w[is_hit]))
    sample, triangle, w = (np.concatenate([one[k] for one in found]) for k in range(3))
    order = np.lexsort((triangle, -w, sample))
    seen, first = np.unique(sample[order], return_index=True)
    prim_id, depth = np.full(width * height, NO_HIT, dtype=np.uint32), np.full(width * height, np.inf, np.float32)
    prim_id[seen], depth[seen] = triangle[order][first], np.float32(1) / w[order][first]
    return prim_id.reshape(height, width), depth.reshape(height, width)
