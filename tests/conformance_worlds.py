"""Scenes of the suites that other systems run, from their descriptions: quads, sheets, far and bumpy spheres.

dEQP draws rotated quads of two triangles, Vulkan's CTS casts rays at randomly subdivided sheets, Embree at a sphere and
a plane far from the origin, pbrt from inside a bumpy sphere. Their rays are the samples of a camera here, so that
rasterizers and ray casters meet the same. `aimed` worlds put every vertex, and the middle of every edge, exactly on
a sample's ray. Nothing here says what is right, but for `single`: the eye sees one unfolded layer, so every sample
meets just one triangle (which exact_counts.faces_one_way proves of the float32 numbers).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from kernel_world import as_float32, make_scene

from clrast.scene.camera import CameraVectors, camera_vectors
from clrast.scene.model import Camera, Scene

SHEET_SEEDS = 10
SHEET_LEVELS = range(1, 9)
"""Sheets of 4^1 to 4^8 = 65,536 triangles."""
FAR = (148376.0, 1234.0, -223423.0)
"""Embree's centre: float32 has steps of 1/64 there."""


@dataclass(frozen=True)
class Case:
    """One view of one scene.

    single : every sample meets one triangle, no more and no less. vertices, edges : (count, 2) int64 columns and
    rows of the samples that are exactly on a vertex, on the middle of an edge. known : ids (height, width) uint32 and
    counts int64 where the suite has a reference of its own. rounds_nothing : so every rung must be right. least_rung :
    the first one on which the float32 promises are made.
    """

    suite: str
    name: str
    scene: Scene
    view: CameraVectors
    single: bool = False
    vertices: np.ndarray | None = None
    edges: np.ndarray | None = None
    known: tuple[np.ndarray, np.ndarray] | None = None
    rounds_nothing: bool = False
    least_rung: str = "fast"


# --- cameras ---------------------------------------------------------------------------------------


def oblique(projection: str, side: int) -> CameraVectors:
    """A square view whose vectors are no short numbers."""
    camera = Camera("oblique", projection, (1.3, 0.7, 3.1), (0.1, -0.2, 0.05), (0.1, 1.0, 0.2), 50.0, 2.5)  # type: ignore[arg-type]
    return camera_vectors(camera, side, side)


def shifted(view: CameraVectors, x: float, y: float) -> CameraVectors:
    """The view whose pixel centres lie (x, y) pixels further on."""
    first = [c + x * p + y * q for c, p, q in zip(view.first, view.tangent_x, view.tangent_y, strict=True)]
    return replace(view, first=as_float32(first))


def short_oblique(projection: str, side: int) -> CameraVectors:
    """A view along (1, 2, 2) with axes along (2, 1, -2) and (-2, 2, -1): every ray is a short binary number."""
    step = 2.0**-10
    x, y, f = np.array([2.0, 1, -2]) * step, np.array([-2.0, 2, -1]) * step, np.array([1.0, 2, 2]) * step
    if projection == "perspective":
        first = side * f - side / 2 * (x + y)
        return CameraVectors("perspective", side, side, (0.0, 0.0, 0.0), as_float32(side * f), as_float32(first),
                             as_float32(x), as_float32(y))  # fmt: skip
    first = as_float32(-side / 2 * (x + y))
    return CameraVectors("orthographic", side, side, first, as_float32(f / step), first, as_float32(x), as_float32(y))


def lift(view: CameraVectors, x: np.ndarray, y: np.ndarray, t: np.ndarray) -> np.ndarray:
    """(count, 3) float64 points at t on the rays of samples (x, y)."""
    swept = np.array(view.first) + x[:, None] * np.array(view.tangent_x) + y[:, None] * np.array(view.tangent_y)
    if view.projection == "orthographic":
        return swept + t[:, None] * np.array(view.direction)
    return np.array(view.origin) + t[:, None] * swept


# --- dEQP: quads -----------------------------------------------------------------------------------

QUAD_KINDS = ("basic", "reversed", "clipped full", "clipped partly", "projected")
TARGETS = ("1 sample", "1 sample, orthographic", "4 samples, grid", "4 samples, rotated", "16 samples")
"""Where dEQP has a window, a texture and multisampled buffers: grids of samples with the same meaning."""
ROTATED = ((-0.125, -0.375), (0.375, -0.125), (-0.375, 0.125), (0.125, 0.375))


def flat_quads(view: CameraVectors, kind: str, angles: list[float], reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Squares of two triangles, one for each angle, on a grid of the view; corners and triangles.

    reach : half a diagonal, pixels. Centres are pixel centres, so that diagonals at 0, 45 and 90 degrees meet samples.
    """
    across = math.isqrt(len(angles) - 1) + 1
    cell, rng = view.width // across, np.random.default_rng(len(kind))
    points, triangles = [], []
    for k, angle in enumerate(angles):
        middle = np.array([(k % across + 0.5) * cell, (k // across + 0.5) * cell]) + 0.5
        turns = [angle + math.pi / 4 + quarter * math.pi / 2 for quarter in range(4)]
        x, y = (middle[:, None] + reach * np.array([[math.cos(a) for a in turns], [math.sin(a) for a in turns]]))
        depth = rng.uniform(0.1, 4, size=4) if kind == "projected" else np.full(4, 2.0)
        points.append(lift(view, x, y, depth))
        second = (3, 2, 0) if kind == "reversed" else (0, 2, 3)
        triangles += [np.array(one) + 4 * k for one in ((0, 1, 2), second)]
    return np.concatenate(points), np.array(triangles)


def quad_views(target: str, side: int) -> Iterator[tuple[str, CameraVectors]]:
    """The images that together hold a target's samples."""
    if target == "4 samples, rotated":
        for k, at in enumerate(ROTATED):
            yield f" {k}", shifted(oblique("perspective", side), *at)
    else:
        scale = {"4": 2, "16": 4}.get(target.split()[0], 1)
        projection = "orthographic" if "orthographic" in target else "perspective"
        yield "", oblique(projection, side * scale)


def quad_cases() -> Iterator[Case]:
    """5 kinds x 5 targets, 0 to 90 degrees: 16 quads x 2 rounds at 256 x 256, clipped ones 15 angles at 64 x 64."""
    for target in TARGETS:
        for kind in QUAD_KINDS:
            is_clipped = kind.startswith("clipped")
            count = 15 if is_clipped else 32
            angles = [math.radians(90 * k / (count - 1)) for k in range(count)]
            groups = [[a] for a in angles] if is_clipped else [angles[:16], angles[16:]]
            for round_, group in enumerate(groups):
                for part, view in quad_views(target, 64 if is_clipped else 256):
                    full = kind == "clipped full"
                    share = {"clipped full": 1.3, "clipped partly": 0.6}.get(kind, 0.11)
                    points, triangles = flat_quads(view, kind, group, share * view.width)
                    name = f"{kind}, {target}{part} {round_}"
                    yield Case("dEQP fill rules", name, make_scene(points, triangles), view, single=full)


# --- Vulkan: sheets --------------------------------------------------------------------------------


def subdivided(seed: int, level: int, unit: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A unit square cut into 4^level triangles at random: points (count, 2) float64, triangles (4^level, 3).

    Four triangles round a point; then every edge is cut somewhere near its middle, and every triangle into four.
    unit : points are multiples of it, 0 for any.
    """
    rng = np.random.default_rng([seed, level])

    def snap(p: np.ndarray) -> np.ndarray:
        return np.round(p / unit) * unit if unit else p

    middle = snap(0.5 + rng.uniform(-0.1, 0.1, size=2))
    points = np.array([(0, 0), (1, 0), (1, 1), (0, 1), middle])
    triangles = np.array([(0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)])
    for _ in range(level - 1):
        ends = np.sort(triangles[:, [1, 2, 2, 0, 0, 1]].reshape(-1, 2), axis=1)
        edges, at = np.unique(ends, axis=0, return_inverse=True)
        cut = len(points) + at.reshape(-1, 3)
        # Coarse units would fold a triangle over, were it thin.
        share = 0.5 + (0.04 if unit else 0.08) * rng.uniform(-1, 1, size=(len(edges), 1))
        points = np.concatenate([points, snap((1 - share) * points[edges[:, 0]] + share * points[edges[:, 1]])])
        a, b, c = triangles.T
        d, e, f = cut.T  # on the edges opposite a, b, c
        triangles = np.concatenate([np.stack(k, axis=1) for k in ((a, f, e), (f, b, d), (e, d, c), (d, e, f))])
    return points, triangles[rng.permutation(len(triangles))]


def sheet(seed: int, level: int, projection: str, side: int = 256) -> Case:
    """A bumpy sheet of 4^level triangles that reaches a little over the view's border."""
    view, (points, triangles) = oblique(projection, side), subdivided(seed, level)
    x, y = (points.T * 1.1 - 0.05) * side
    t = np.random.default_rng(seed).uniform(2, 3, size=len(points))
    scene = make_scene(lift(view, x, y, t), triangles)
    return Case("Vulkan sheets", f"{projection} seed {seed}, {4**level} triangles", scene, view, single=True)


def sheet_cases() -> Iterator[Case]:
    """10 seeds x 8 sizes, for each camera model."""
    for projection in ("perspective", "orthographic"):
        for seed in range(SHEET_SEEDS):
            for level in SHEET_LEVELS:
                yield sheet(seed, level, projection)


def small_cases() -> Iterator[Case]:
    """Embree's test of small triangles from 1e6 away, which it leaves out: sheets of triangles of 4 units there.

    A plain cross product is noise for them; the midpoint form keeps its digits.
    """
    for seed in range(SHEET_SEEDS):
        camera = Camera("far", "perspective", (0.3, 0.7, 2.5), (6e5, 6e5, 5e5), (0.1, 1.0, 0.2), 0.0125)
        view, (points, triangles) = camera_vectors(camera, 128, 128), subdivided(seed, 6)
        x, y = (points.T * 1.1 - 0.05) * 128
        t = 985_000 + np.random.default_rng(seed).uniform(-20, 20, size=len(points))
        scene = make_scene(lift(view, x, y, t), triangles)
        name = f"seed {seed}, {len(triangles)} triangles"
        yield Case("Embree small, 1e6 away", name, scene, view, single=True, least_rung="midpoint")


def middles(triangles: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Middles of all edges, each once; at : (vertex_count, 2) even distances apart."""
    edges = np.unique(np.sort(triangles[:, [1, 2, 2, 0, 0, 1]].reshape(-1, 2), axis=1), axis=0)
    return at[edges].sum(axis=1) // 2


def inside(at: np.ndarray, width: int, height: int) -> np.ndarray:
    """The samples that the image has, each once."""
    return np.unique(at[((at >= 0) & (at < (width, height))).all(axis=1)], axis=0)


def aimed_sheet(seed: int, level: int, projection: str) -> Case:
    """A sheet of which every vertex and the middle of every edge lie exactly on a sample's ray."""
    side = max(64, 8 << (level - 1))
    view, (points, triangles) = short_oblique(projection, side), subdivided(seed, level, unit=2 / side)
    columns_rows = np.round(points * side).astype(np.int64) - 1
    columns_rows[columns_rows == side - 1] += 2  # the border lies outside of the last samples
    t = np.random.default_rng(seed).integers(1024, 1536, size=len(points)) / 512
    at = columns_rows + 0.5
    exact = lift(view, at[:, 0], at[:, 1], t)
    scene = make_scene(exact, triangles)
    assert (scene.positions == exact).all(), "a vertex is not a float32 number"
    name = f"{projection} seed {seed}, {4**level} triangles"
    return Case("Vulkan sheets, aimed", name, scene, view, True, inside(columns_rows, side, side),
                inside(middles(triangles, columns_rows), side, side))  # fmt: skip


def aimed_sheet_cases() -> Iterator[Case]:
    """The same seeds and sizes."""
    for projection in ("perspective", "orthographic"):
        for seed in range(SHEET_SEEDS):
            for level in SHEET_LEVELS:
                yield aimed_sheet(seed, level, projection)
