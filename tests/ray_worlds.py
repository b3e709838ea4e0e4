"""Meshes and rays for the tests of cl/trace_rays.cl and tools/check_rays.py; nothing here says what is right.

A mesh is (positions (vertex_count, 3) float32, triangles (triangle_count, 3) uint32).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clrast.opencl.device import Device
from clrast.opencl.layout import EMPTY_CHILD, LEAF_BIT, MAX_LEAF_COUNT, NO_HIT, NODE_WIDTH
from clrast.visibility.bvh import Bvh
from clrast.visibility.rays import RayTracer, make_tracer

Mesh = tuple[np.ndarray, np.ndarray]
Rays = tuple[np.ndarray, np.ndarray]

TARGETS = ("random", "edges", "vertices")
FAR_CENTER = (148376.0, 1234.0, -223423.0)
"""Where Embree's tests put a sphere that is far from the origin."""

EXPONENTS = (-8.0, 8.0)
"""Of ten: coordinates of the reintersection test."""


def icosphere(levels: int) -> Mesh:
    """A unit sphere of 20 * 4**levels triangles, edges halved `levels` times; convex but for rounding."""
    golden = (1 + 5**0.5) / 2
    points = np.array([[s, t * golden, 0.0] for s in (-1, 1) for t in (-1, 1)])
    points = np.concatenate([np.roll(points, k, axis=1) for k in range(3)])
    near = [(i, j, k) for i in range(12) for j in range(i) for k in range(j)]
    lengths = np.linalg.norm(points[:, None] - points, axis=2)
    faces = [f for f in near if max(lengths[f[0], f[1]], lengths[f[1], f[2]], lengths[f[2], f[0]]) < 2.1]
    triangles = np.array([f if np.linalg.det(points[list(f)]) > 0 else f[::-1] for f in faces])
    for _ in range(levels):
        ends = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
        edges, which = np.unique(ends, axis=0, return_inverse=True)
        middle = len(points) + which.reshape(3, -1).T
        points = np.concatenate([points, points[edges].sum(axis=1)])
        a, b, c = triangles.T
        ab, bc, ca = middle.T
        triangles = np.concatenate([np.stack(f, axis=1) for f in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
        points /= np.linalg.norm(points, axis=1)[:, None]
    return (points / np.linalg.norm(points, axis=1)[:, None]).astype(np.float32), triangles.astype(np.uint32)


def box() -> Mesh:
    """The cube between -1 and 1, 12 triangles: from its centre, edges and vertices are met exactly."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float32)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))]
    return corners, np.array(faces, dtype=np.uint32)


def tilted_box() -> Mesh:
    """The box turned so that no face lies along an axis."""
    corners, faces = box()
    turn = np.array([[2.0, -1, 2], [2, 2, -1], [-1, 2, 2]]) / 3
    return (corners.astype(np.float64) @ turn).astype(np.float32), faces


def tetrahedron() -> Mesh:
    """Four triangles that meet at 50 to 80 degrees."""
    points = np.array([[0, 0, 0], [1, 0.01, 0.02], [0.03, 1.1, 0.1], [0.2, 0.25, 0.8]], dtype=np.float32)
    return points, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], dtype=np.uint32)


def bumpy_sphere(seed: int, side: int = 16, bumps: float = 0.2) -> Mesh:
    """A closed sphere of side * side squares in latitude and longitude, radii within 1 +- bumps; pbrt's test has it."""
    rng = np.random.default_rng(seed)
    theta = np.arange(1, side) * np.pi / side
    phi = np.arange(side) * 2 * np.pi / side
    x, y = np.outer(np.sin(theta), np.cos(phi)), np.outer(np.sin(theta), np.sin(phi))
    ring = np.stack([x, y, np.outer(np.cos(theta), np.ones(side))], axis=2).reshape(-1, 3)
    ring *= rng.uniform(1 - bumps, 1 + bumps, (len(ring), 1))
    points = np.concatenate([ring, [[0, 0, 1], [0, 0, -1]]])
    north, south = len(ring), len(ring) + 1
    faces = []
    for j in range(side):
        k = (j + 1) % side
        faces += [(north, j, k), (south, (side - 2) * side + k, (side - 2) * side + j)]
        for i in range(side - 2):
            here, below = i * side, (i + 1) * side
            faces += [(here + j, below + j, below + k), (here + j, below + k, here + k)]
    return points.astype(np.float32), np.array(faces, dtype=np.uint32)


def placed(mesh: Mesh, scale: float, center: Sequence[float] = (0, 0, 0)) -> Mesh:
    """The mesh scaled, then moved; rounded once."""
    return (mesh[0].astype(np.float64) * scale + np.asarray(center, dtype=np.float64)).astype(np.float32), mesh[1]


def lattice_soup(count: int, seed: int, reach: int = 4) -> Mesh:
    """Triangles with whole coordinates: shared planes, edges and corners, copies, some without area."""
    rng = np.random.default_rng(seed)
    corners = rng.integers(-reach, reach + 1, (count, 3, 3)).astype(np.float32)
    corners[: count // 3, :, rng.integers(0, 3)] = rng.integers(-reach, reach + 1, (count // 3, 1))
    corners[-count // 6 :] = corners[: count // 6 + (count % 6 > 0)][:, [1, 2, 0]]
    return corners.reshape(-1, 3), np.arange(3 * count, dtype=np.uint32).reshape(-1, 3)


def lattice_rays(count: int, seed: int, reach: int = 5) -> Rays:
    """Origins and directions of whole numbers: many rays pass edges, corners and planes exactly."""
    rng = np.random.default_rng(seed)
    origins = rng.integers(-reach, reach + 1, (count, 3))
    directions = rng.integers(-2, 3, (count, 3))
    directions[(directions == 0).all(axis=1)] = (0, 0, 1)
    return origins.astype(np.float32), directions.astype(np.float32)


def targets(mesh: Mesh, kind: str, count: int, rng: np.random.Generator) -> np.ndarray:
    """(count, 3) float64 points of the surface: anywhere, on edges or on vertices."""
    corners = mesh[0].astype(np.float64)[mesh[1][rng.integers(0, len(mesh[1]), count)]]
    if kind == "vertices":
        return corners[:, 0]
    weights = rng.dirichlet((1, 1, 1), count)
    if kind == "edges":
        weights[:, 2] = 0.0
        weights[: count // 2, :2] = 0.5
        weights[count // 2 :, 1] = 1.0 - weights[count // 2 :, 0]
    return (weights[:, :, None] * corners).sum(axis=1)


def kernel_radius(mesh: Mesh) -> float:
    """Radius of the largest ball round the centre of all vertices that lies inside of every triangle's plane.

    From a point of it each direction meets the surface once, so that no triangle is seen edge-on.
    """
    corners = mesh[0].astype(np.float64)[mesh[1]] - mesh[0].astype(np.float64).mean(axis=0)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(((normals * corners[:, 0]).sum(axis=1) / np.linalg.norm(normals, axis=1)).min())


def rays_from_inside(mesh: Mesh, kind: str, count: int, rng: np.random.Generator, reach: float) -> Rays:
    """Origins within `reach` of the centre of all vertices; a quarter of them is the very centre."""
    center = mesh[0].astype(np.float64).mean(axis=0)
    origins = rng.normal(size=(count, 3))
    origins *= reach * rng.random((count, 1)) / np.linalg.norm(origins, axis=1)[:, None]
    origins[: count // 4] = 0
    origins = (origins + center).astype(np.float32)
    return origins, (targets(mesh, kind, count, rng) - origins).astype(np.float32)


def rays_from_outside(mesh: Mesh, kind: str, count: int, rng: np.random.Generator, reach: float) -> Rays:
    """Rays whose lines pass within `reach` of the centre, in through a target at t = 1, from 2 to 10 times as far."""
    center = mesh[0].astype(np.float64).mean(axis=0)
    inner = rng.normal(size=(count, 3))
    inner = center + reach * rng.random((count, 1)) * inner / np.linalg.norm(inner, axis=1)[:, None]
    at = targets(mesh, kind, count, rng)
    origins = (inner + (at - inner) * rng.uniform(2, 10, (count, 1))).astype(np.float32)
    return origins, (at - origins).astype(np.float32)


def scaled_numbers(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Numbers of either sign, their sizes 10 to the power of anything within EXPONENTS: float32."""
    return (rng.choice([-1.0, 1.0], shape) * 10.0 ** rng.uniform(*EXPONENTS, shape)).astype(np.float32)


def leaving_directions(origins: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(count, 3) float32: half of them anywhere, half towards points at any scale."""
    directions = rng.normal(size=origins.shape).astype(np.float32)
    half = len(origins) // 2
    towards = scaled_numbers(rng, (half, 3)) - origins[:half]
    towards[(towards == 0).all(axis=1)] = 1
    directions[:half] = towards
    return directions


def soup_of_scales(count: int, seed: int) -> Mesh:
    """Triangles whose corners have coordinates of sizes from 1e-8 to 1e8, each on its own."""
    corners = scaled_numbers(np.random.default_rng(seed), (count, 3, 3))
    return corners.reshape(-1, 3), np.arange(3 * count, dtype=np.uint32).reshape(-1, 3)


def aimed_rays(mesh: Mesh, count: int, seed: int) -> Rays:
    """Rays from anywhere in sight towards random points, edges and vertices."""
    rng = np.random.default_rng(seed)
    at = np.concatenate([targets(mesh, kind, count, rng) for kind in TARGETS])
    size = np.abs(mesh[0].astype(np.float64) - mesh[0].mean(axis=0)).max()
    origins = (mesh[0].mean(axis=0) + rng.normal(size=at.shape) * size).astype(np.float32)
    return origins, (at - origins).astype(np.float32)


def closest_bytes(tracer: RayTracer, *arguments: np.ndarray) -> list[bytes]:
    hits = tracer.closest(*arguments)
    return [a.tobytes() for a in (hits.prim_id, hits.t, hits.t_error, hits.barycentrics)]


def limited_rays(tracer: RayTracer, rays: Rays, seed: int) -> tuple[np.ndarray, ...]:
    """The rays with t_min and t_max at, just before, just behind and away from what they hit, and a prim left out."""
    rng = np.random.default_rng(seed)
    found = tracer.closest(*rays)
    t = np.where(np.isfinite(found.t), found.t, 1).astype(np.float32)
    steps = np.stack([t, np.nextafter(t, np.float32(0)), np.nextafter(t, np.float32(np.inf)), t / 2, t * 2, t * 0])
    choose = lambda: steps[rng.integers(0, len(steps), len(t)), np.arange(len(t))]  # noqa: E731
    return (*rays, choose(), np.where(rng.random(len(t)) < 0.3, np.float32(np.inf), choose() * 2), found.prim_id)


def lost_in_bounces(
    tracer: RayTracer, mesh: Mesh, kind: str, count: int, rng: np.random.Generator, bounces: int = 4
) -> tuple[int, int]:
    """(rays traced, rays lost) from inside a closed mesh whose normals point outwards, with diffuse bounces inside.

    Lost: it hits nothing, or a face from outside.
    """
    corners = mesh[0].astype(np.float64)[mesh[1]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    origins, directions = rays_from_inside(mesh, kind, count, rng, 0.3 * kernel_radius(mesh))
    excluded, traced, lost = None, 0, 0
    for _ in range(1 + bounces):
        hits = tracer.closest(origins, directions, excluded=excluded)
        traced += len(origins)
        kept = hits.prim_id != NO_HIT
        prims = hits.prim_id[kept]
        outwards = (directions[kept].astype(np.float64) * normals[prims]).sum(axis=1) > 0
        lost += len(origins) - int(outwards.sum())
        excluded, weights = prims[outwards], hits.barycentrics[kept][outwards]
        towards = rng.normal(size=(len(excluded), 3))
        towards *= -np.sign((towards * normals[excluded]).sum(axis=1))[:, None]
        directions = towards.astype(np.float32)
        origins = tracer.leave(excluded, weights, directions)
    return traced, lost


def reintersections(device: Device, shape_count: int, ray_count: int, rng: np.random.Generator) -> tuple[int, int]:
    """(rays that left, those that hit what they had left): one triangle of any scale at a time, nothing excluded.

    As in pbrt's test: a ray from anywhere to a point of the triangle, then one from the hit in any direction.
    """
    left = again = 0
    for _ in range(shape_count):
        mesh = scaled_numbers(rng, (3, 3)), np.array([[0, 1, 2]], dtype=np.uint32)
        tracer = make_tracer(device, *mesh)
        origins = scaled_numbers(rng, (ray_count, 3))
        hits = tracer.closest(origins, targets(mesh, "random", ray_count, rng) - origins)
        hit = hits.prim_id != NO_HIT
        directions = leaving_directions(origins[hit], rng)
        starts = tracer.leave(hits.prim_id[hit], hits.barycentrics[hit], directions)
        left += len(starts)
        again += int(tracer.any(starts, directions).sum())
    return left, again


def one_box(mesh: Mesh) -> Bvh:
    """A hierarchy that is none: every box is that of everything, so that a tracer goes by brute force."""
    count = len(mesh[1])
    leaves = [(first, min(first + MAX_LEAF_COUNT, count)) for first in range(0, count, MAX_LEAF_COUNT)]
    nodes, levels = [(0, len(leaves))], [(0, 1)]  # what leaves each node covers, breadth first
    rows = []
    for begin, end in nodes:  # grows as it is walked
        share = 1
        while share * NODE_WIDTH < end - begin:
            share *= NODE_WIDTH
        row = []
        for first in range(begin, end, share):
            if share == 1:
                row.append((LEAF_BIT | leaves[first][0], leaves[first][1] - leaves[first][0]))
            else:
                row.append((len(nodes), 0))
                nodes.append((first, min(first + share, end)))
        rows.append(row)
        if len(rows) == levels[-1][1] and len(nodes) > len(rows):
            levels.append((len(rows), len(nodes)))
    children = np.full((len(rows), NODE_WIDTH), EMPTY_CHILD, dtype=np.uint32)
    counts = np.zeros_like(children)
    boxes = np.full((len(rows), 6, NODE_WIDTH), np.inf, dtype=np.float32)
    boxes[:, 3:] = -np.inf
    used = mesh[0][mesh[1]].reshape(-1, 3)
    for number, row in enumerate(rows):
        children[number, : len(row)], counts[number, : len(row)] = zip(*row, strict=True)
        boxes[number, :3, : len(row)] = used.min(axis=0)[:, None]
        boxes[number, 3:, : len(row)] = used.max(axis=0)[:, None]
    return Bvh(children, counts, boxes, np.arange(count, dtype=np.uint32), tuple(levels))
