"""What is right, in real arithmetic: primary visibility by the definitions alone, slow and readable.

Numbers are `fractions.Fraction`, so nothing is ever rounded. The input is what the renderer takes for
the scene: float32 positions and float32 camera vectors. Nothing here is shared with the kernels.

    for each sample:                          the point (i + 1/2, j + 1/2) of the viewport
        ray = sample_ray(camera, x, y)        origin e, direction d, tangents tx and ty
        for each triangle:                    skip where V = 0 (no area, or seen edge-on)
            V_i = n_i . d                     zero is settled by moving the sample (+eps, +eps^2)
            covered if V_0, V_1, V_2 have the sign of V, and t > 0
        the smallest t wins, equal t the smaller prim_id

Good at: being checked by eye. Bad at: more than about a million (triangle, sample) pairs; the fast exact
answer for real scenes is exact_visibility.py, which test_reference.py holds against this file.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

NO_HIT = 4294967295

Vector = tuple[Fraction, Fraction, Fraction]
Triangle = tuple[Vector, Vector, Vector]
ZERO: Vector = (Fraction(0), Fraction(0), Fraction(0))
HALF = Fraction(1, 2)


def vector(values: Iterable[float | int | Fraction]) -> Vector:
    """Three finite numbers as exact fractions (a float32 or float64 is a fraction already)."""
    x, y, z = (value if isinstance(value, Fraction) else Fraction(float(value)) for value in values)
    return x, y, z


def add(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def subtract(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def scale(a: Vector, s: Fraction) -> Vector:
    return a[0] * s, a[1] * s, a[2] * s


def dot(a: Vector, b: Vector) -> Fraction:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def sign(value: Fraction | int) -> int:
    return (value > 0) - (value < 0)


@dataclass(frozen=True)
class ExactCamera:
    """Origin and direction of the ray of a sample (x, y), each linear in x and y.

    perspective : origin_dx = origin_dy = 0;   orthographic : direction_dx = direction_dy = 0.
    """

    origin: Vector
    origin_dx: Vector
    origin_dy: Vector
    direction: Vector
    direction_dx: Vector
    direction_dy: Vector
    is_perspective: bool


@dataclass(frozen=True)
class Ray:
    """e + t d, with the tangents that settle V_i = 0."""

    e: Vector
    d: Vector
    tx: Vector
    ty: Vector


@dataclass(frozen=True)
class Hit:
    """The visible triangle at a sample. `bary` weighs vertices 0, 1, 2 and sums to 1; `front`: V > 0."""

    prim_id: int
    t: Fraction
    bary: Vector
    position: Vector
    front: bool


def exact_camera(camera_vectors: Mapping[str, Sequence[float]]) -> ExactCamera:
    """The camera from the vectors of `stats["camera"]`: `e d0 dx dy` or `d e0 ex ey`.

    The vectors are float32 numbers; one that is not makes the answer meaningless, so it raises ValueError.
    """
    for name, values in camera_vectors.items():
        if any(float(np.float32(value)) != float(value) for value in values):
            raise ValueError(f"camera vector {name} = {list(values)} is not made of float32 numbers")
    vectors = {name: vector(values) for name, values in camera_vectors.items()}
    if "d0" in vectors:
        return ExactCamera(vectors["e"], ZERO, ZERO, vectors["d0"], vectors["dx"], vectors["dy"], True)
    return ExactCamera(vectors["e0"], vectors["ex"], vectors["ey"], vectors["d"], ZERO, ZERO, False)


def sample_ray(camera: ExactCamera, x: Fraction, y: Fraction) -> Ray:
    """The ray of the sample at (x, y), in pixels, y down."""
    e = add(camera.origin, add(scale(camera.origin_dx, x), scale(camera.origin_dy, y)))
    d = add(camera.direction, add(scale(camera.direction_dx, x), scale(camera.direction_dy, y)))
    if camera.is_perspective:
        return Ray(e, d, camera.direction_dx, camera.direction_dy)
    return Ray(e, d, camera.origin_dx, camera.origin_dy)


def general_ray(e: Vector, d: Vector) -> Ray:
    """A ray of no camera: its tangents are the axes k + 1 and k + 2, k the axis of the largest |d_k|."""
    k = max(range(3), key=lambda axis: (abs(d[axis]), -axis))
    axes = [vector(1 if axis == j else 0 for axis in range(3)) for j in range(3)]
    return Ray(e, d, axes[(k + 1) % 3], axes[(k + 2) % 3])


def edge_values(triangle: Triangle, ray: Ray, is_perspective: bool) -> tuple[list[Fraction], Fraction, list[int]]:
    """(V_0, V_1, V_2), V (orthographic: S), and the signs of V_i after the fill rule.

    A sign is 0 only where the edge normal is perpendicular to d and both tangents: then V = 0 as well.
    """
    values, signs = [], []
    for i in range(3):
        a, b = triangle[(i + 2) % 3], triangle[(i + 1) % 3]
        if is_perspective:
            n = cross(subtract(a, ray.e), subtract(b, ray.e))
            value = dot(n, ray.d)
        else:
            n = cross(ray.d, subtract(b, a))
            value = dot(n, subtract(ray.e, scale(add(a, b), HALF)))
        values.append(value)
        signs.append(sign(value) or sign(dot(n, ray.tx)) or sign(dot(n, ray.ty)))
    if is_perspective:
        p0, p1, p2 = (subtract(p, ray.e) for p in triangle)
        return values, dot(p0, cross(p2, p1)), signs
    return values, sum(values, Fraction(0)), signs


def plane_t(triangle: Triangle, ray: Ray) -> Fraction | None:
    """t where the ray meets the triangle's plane; None where it is parallel to it or the plane holds e."""
    normal = cross(subtract(triangle[1], triangle[0]), subtract(triangle[2], triangle[0]))
    numerator, denominator = dot(normal, subtract(triangle[0], ray.e)), dot(normal, ray.d)
    return numerator / denominator if numerator and denominator else None


def intersect(triangle: Triangle, ray: Ray, is_perspective: bool, prim_id: int = 0) -> Hit | None:
    """The hit of one triangle, both faces, or None."""
    values, facing, signs = edge_values(triangle, ray, is_perspective)
    if facing == 0 or any(s != sign(facing) for s in signs):
        return None
    t = plane_t(triangle, ray)
    if t is None or t <= 0:
        return None
    total = sum(values, Fraction(0))
    b0, b1, b2 = (value / total for value in values)
    position = add(add(scale(triangle[0], b0), scale(triangle[1], b1)), scale(triangle[2], b2))
    return Hit(prim_id, t, (b0, b1, b2), position, facing > 0)


def exact_triangles(positions: np.ndarray, triangles: np.ndarray) -> list[Triangle]:
    """positions : (vertex_count, 3) float32; triangles : (triangle_count, 3) vertex indices."""
    vertices = [vector(row) for row in np.asarray(positions, dtype=np.float32).tolist()]
    return [(vertices[a], vertices[b], vertices[c]) for a, b, c in np.asarray(triangles).tolist()]


def all_hits(triangles: Sequence[Triangle], ray: Ray, is_perspective: bool) -> list[Hit]:
    """Every hit of a ray, nearest first, equal t by prim_id."""
    found = (intersect(triangle, ray, is_perspective, k) for k, triangle in enumerate(triangles))
    return sorted((hit for hit in found if hit is not None), key=lambda hit: (hit.t, hit.prim_id))


def hits_at(triangles: Sequence[Triangle], camera: ExactCamera, i: int, j: int) -> list[Hit]:
    """Every hit at the centre of pixel (column i, row j), nearest first."""
    return all_hits(triangles, sample_ray(camera, i + HALF, j + HALF), camera.is_perspective)


def visible_triangles(
    positions: np.ndarray,
    triangles: np.ndarray,
    camera_vectors: Mapping[str, Sequence[float]],
    width: int,
    height: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The whole image by brute force.

    Returns `prim_id` (height, width) uint32, NO_HIT where nothing is hit; `t` (height, width) float64, the
    nearest to the exact t, +inf where nothing is hit; `hit_count` (height, width) int64, surfaces in line.
    """
    scene, camera = exact_triangles(positions, triangles), exact_camera(camera_vectors)
    prim_id = np.full((height, width), NO_HIT, dtype=np.uint32)
    t = np.full((height, width), np.inf)
    hit_count = np.zeros((height, width), dtype=np.int64)
    for j in range(height):
        for i in range(width):
            hits = hits_at(scene, camera, i, j)
            hit_count[j, i] = len(hits)
            if hits:
                prim_id[j, i], t[j, i] = hits[0].prim_id, float(hits[0].t)
    return prim_id, t, hit_count


def camera_vectors_float64(
    eye: Sequence[float],
    look_at: Sequence[float],
    up: Sequence[float],
    width: int,
    height: int,
    fov: float | None = 45.0,
    view_height: float | None = None,
) -> dict[str, list[float]]:
    """The camera table in float64 (plain math): perspective from `fov` in degrees, else orthographic.

    `view_height` : of an orthographic view, world units. Not rounded to float32: see `round_camera`.
    """
    f = unit([look_at[k] - eye[k] for k in range(3)])
    r = unit([f[1] * up[2] - f[2] * up[1], f[2] * up[0] - f[0] * up[2], f[0] * up[1] - f[1] * up[0]])
    u = [r[1] * f[2] - r[2] * f[1], r[2] * f[0] - r[0] * f[2], r[0] * f[1] - r[1] * f[0]]
    half = math.tan(math.radians(fov) / 2) if view_height is None and fov is not None else (view_height or 0.0) / 2
    step_x = [r[k] * 2 * half / height for k in range(3)]
    step_y = [-u[k] * 2 * half / height for k in range(3)]
    corner = [-r[k] * half * width / height + u[k] * half for k in range(3)]
    if view_height is None:
        d0 = [f[k] + corner[k] for k in range(3)]
        return {"e": [float(c) for c in eye], "d0": d0, "dx": step_x, "dy": step_y}
    return {"d": f, "e0": [eye[k] + corner[k] for k in range(3)], "ex": step_x, "ey": step_y}


def unit(v: Sequence[float]) -> list[float]:
    """`v` divided by its length, float64."""
    length = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    return [c / length for c in v]


def round_camera(camera_vectors: Mapping[str, Sequence[float]]) -> dict[str, list[float]]:
    """Each number rounded to float32 once: what the renderer, and right and wrong, go by."""
    return {name: [float(np.float32(c)) for c in values] for name, values in camera_vectors.items()}
