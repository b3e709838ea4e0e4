"""Points of the continuum, and scenes that are hard on oracles; nothing here says what is right."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np
from kernel_world import make_scene, orthographic, perspective, render

from clrast.opencl.device import Device
from clrast.opencl.features import Edges
from clrast.scene.camera import CameraVectors, camera_vectors
from clrast.scene.model import Camera, Material, Scene
from clrast.visibility.methods import METHODS

Point = tuple[str, tuple[str, ...]]
"""A method, and what `--oracle` changes of it."""

ROWS: Mapping[str, Point] = {name: (name, ()) for name, row in METHODS.items() if row.edges == Edges.SPATIAL}
"""Every method with 3D edges, as the table has it."""

REFERENCE = ROWS["3dr-binning"]

MADE_UP: Mapping[str, Point] = {
    "vectors of rays with everything": ("3dr-full", ("frustum=4",)),
    "single packets that never split": ("3dr-full", ("frustum=8", "binning=never")),
    "packets of 16": ("3dr-full", ("frustum=16", "split_frustum=small:1")),
    "32, split at once": ("3dr-full", ("frustum=32", "is_outside=never", "split_frustum=always")),
    "128, split at the centre": ("3dr-full", ("frustum=128", "split_frustum=center")),
    "256, split for the smallest nodes": ("3dr-full", ("frustum=256", "split_frustum=small:65536")),
    "never outside": ("3dr-full", ("is_outside=never",)),
    "never occluded": ("3dr-full", ("is_occluded=never",)),
    "nothing is dropped": ("3dr-full", ("is_outside=never", "is_occluded=never", "split_frustum=never")),
    "splitting alone": ("3dr-full", ("is_occluded=never", "binning=never", "split_frustum=always")),
    "binning at the root": ("3dr-full", ("generate_samples=root", "split_frustum=never")),
    "occlusion at the root of a packet": ("3dr-full", ("generate_samples=root", "binning=never", "frustum=8")),
    "a tree under Durand's loop": ("raycast-brute", ("generate_samples=leaf",)),
}
"""Oracles that no method puts together."""

EYE = (0.3, 0.7, 2.5)


def images(device: Device, scene: Scene, view: CameraVectors, point: Point, **options: object) -> dict[str, np.ndarray]:
    """`id.prim` and the bits of Z, at that point of the continuum."""
    method, oracles = point
    with np.errstate(over="ignore", invalid="ignore"):
        frame = render(device, scene, view, aov=("id", "depth"), method=method, oracle=oracles, **options)
    return {"id.prim": frame["id.prim"], "Z": frame["Z"].view(np.uint32)}


def differences(found: Mapping[str, np.ndarray], expected: Mapping[str, np.ndarray]) -> str:
    """What differs, and at which pixel first; empty where every bit is the same."""
    texts = []
    for name, values in expected.items():
        rows, columns = np.nonzero(found[name] != values)
        if len(rows):
            j, i = rows[0], columns[0]
            texts.append(f"{name}: {len(rows)} pixels, ({i}, {j}) {found[name][j, i]:#x} for {values[j, i]:#x}")
    return "; ".join(texts)


# --- scenes ----------------------------------------------------------------------------------------


def soup(seed: int, count: int) -> np.ndarray:
    """(count, 3, 3) triangles round the origin, from under a pixel to a quarter of the image; some larger behind."""
    rng = np.random.default_rng(seed)
    size = 10.0 ** rng.uniform(-2, -0.2, size=(count, 1, 1))
    corners = rng.normal(size=(count, 1, 3)) * (0.9, 0.5, 0.5) + rng.normal(size=(count, 3, 3)) * size
    behind = rng.normal(size=(count // 16, 1, 3)) * (2, 2, 0.2) + rng.normal(size=(count // 16, 3, 3)) * (3, 3, 0.3)
    corners[: count // 16] = behind - (0, 0, 3)
    return rng.permutation(corners)


def round_the_eye(seed: int, count: int) -> np.ndarray:
    """(count, 3, 3) triangles about EYE, mostly slabs under and over it that reach from before it to behind it."""
    rng = np.random.default_rng(seed)
    reach = 10.0 ** rng.uniform(-2, 1, size=(count, 1, 1))
    height = rng.uniform(-1, 0.5, size=(count, 1, 1)) * (0, 1, 0)
    return EYE + reach * (height + rng.normal(size=(count, 1, 3)) * 0.2 + rng.normal(size=(count, 3, 3)) * (1, 0.1, 1))


def through_samples(view: CameraVectors, step: int) -> tuple[np.ndarray, np.ndarray]:
    """A bent sheet whose vertices lie on every `step`-th sample's ray: edges run through samples, within rounding."""
    rng = np.random.default_rng(37)
    x, y = np.meshgrid(np.arange(0, view.width, step) + 0.5, np.arange(0, view.height, step) + 0.5)
    reach = rng.uniform(2, 2.5, size=(*x.shape, 1))
    moved = x[..., None] * np.array(view.tangent_x) + y[..., None] * np.array(view.tangent_y)
    if view.projection == "perspective":
        points = np.array(view.origin) + reach * (np.array(view.first) + moved)
    else:
        points = np.array(view.first) + moved + reach * np.array(view.direction)
    rows, columns = x.shape
    first = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()[:, None]
    triangles = np.concatenate([first + (0, 1, columns), first + (columns + 1, columns, 1)])
    return points.reshape(-1, 3), triangles


def sphere(radius: float, segments: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a closed sphere; those at the poles have no area."""
    latitude, longitude = np.meshgrid(np.arange(segments + 1), np.arange(2 * segments), indexing="ij")
    theta, phi = latitude.ravel() * np.pi / segments, longitude.ravel() * np.pi / segments
    points = radius * np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], axis=1)
    row, column = (k.ravel() for k in np.meshgrid(np.arange(segments), np.arange(2 * segments), indexing="ij"))
    a, b = row * 2 * segments + column, row * 2 * segments + (column + 1) % (2 * segments)
    corners = [np.stack(k, axis=1) for k in ((a, b, a + 2 * segments), (b, b + 2 * segments, a + 2 * segments))]
    return points, np.concatenate(corners)


def ties(seed: int) -> np.ndarray:
    """(208, 3, 3) float32: each triangle four times with its vertices in other orders, and many in common planes."""
    rng = np.random.default_rng(seed)
    one = (rng.normal(size=(26, 1, 3)) * 0.5 + rng.normal(size=(26, 3, 3)) * 0.6).astype(np.float32)
    flat = one.copy()
    for axis, start in enumerate((0, 9, 18)):
        flat[start : start + 9, :, axis] = 0.125 * axis
    copies = [part[:, order] for part in (one, flat) for order in ([0, 1, 2], [1, 2, 0], [2, 1, 0], [0, 2, 1])]
    return np.concatenate(copies)[rng.permutation(208)]


def degenerate(seed: int) -> np.ndarray:
    """(100, 3, 3) float32: every second one without area, as a line or a point."""
    corners = soup(seed, 100).astype(np.float32)
    corners[0::6, 2] = corners[0::6, 1]
    corners[2::6, 2] = (corners[2::6, 0] + corners[2::6, 1]) / 2
    corners[4::6] = corners[4::6, :1]
    return corners


def overflowing(seed: int) -> np.ndarray:
    """(40, 3, 3) float32 from 1e-30 to 1e30, of one size or mixed within a triangle: products are inf and NaN."""
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(40, 3, 3)) * 10.0 ** rng.uniform(-30, 30, size=(40, 1, 1))
    other = 10.0 ** rng.uniform(-30, 30, size=corners.shape) * rng.choice([-1, 1], size=corners.shape)
    return np.where(rng.uniform(size=corners.shape) < 0.15, other, corners).astype(np.float32)


def depths(count: int) -> np.ndarray:
    """(count, 3, 3) layers over the whole view, 1e-5 of their depth apart, the nearest somewhere among them."""
    distance = (10 + 1e-4 * np.arange(count))[np.random.default_rng(14).permutation(count)]
    return np.array([[(-99, 99, -d), (299, 99, -d), (-99, -299, -d)] for d in distance])


def oblique(projection: str, width: int, height: int, scale: float = 1.0) -> CameraVectors:
    """A camera whose vectors are no short numbers; `scale` : of the world."""
    eye, at = (tuple(scale * c for c in point) for point in (EYE, (0.1, -0.2, 0.05)))
    camera = Camera("oblique", projection, eye, at, (0.1, 1.0, 0.2), 60.0, 3.0 * scale)  # type: ignore[arg-type]
    return camera_vectors(camera, width, height)


@cache
def hard_scenes(projection: str) -> dict[str, tuple[Scene, CameraVectors]]:
    """By name. Sizes are no multiples of tiles or frusta; trees have two levels, so that each point is built once."""
    short = perspective if projection == "perspective" else orthographic
    inside = camera_vectors(Camera("in", projection, (0.1, 0.2, -0.3), (1, 0.5, 0.2), (0, 1, 0), 80.0, 1.5), 100, 61)
    sheet = oblique(projection, 65, 57)
    return {
        "soup": (make_scene(soup(1, 160)), oblique(projection, 200, 75)),
        "soup in one pixel": (make_scene(soup(2, 120)), oblique(projection, 1, 1)),
        "soup in a strip": (make_scene(soup(3, 160)), oblique(projection, 300, 7)),
        "round the eye": (make_scene(round_the_eye(4, 60)), oblique(projection, 64, 64)),
        "through samples": (make_scene(*through_samples(sheet, 5)), sheet),
        "closed, from inside": (make_scene(*sphere(2.0, 9)), inside),
        "ties": (make_scene(ties(5)), oblique(projection, 33, 150)),
        "degenerate": (make_scene(degenerate(6)), oblique(projection, 65, 33)),
        "1e8": (make_scene(1e8 * soup(7, 100)), oblique(projection, 48, 50, 1e8)),
        "1e-8": (make_scene(1e-8 * soup(8, 100)), oblique(projection, 50, 31, 1e-8)),
        "layers": (make_scene(depths(200)), short(70, 64)),
        "1e30": (make_scene(overflowing(30)), oblique(projection, 36, 20)),  # wide integers decide every sample
    }


def glass_and_leaves(seed: int) -> Scene:
    """Masked, blended and opaque triangles mixed, some twice there: layers of glass behind and before leaves."""
    rng = np.random.default_rng(seed)
    corners = soup(seed, 160)
    corners[1::8] = corners[0::8, [1, 2, 0]]
    count = len(corners)
    return make_scene(
        corners,
        materials=(
            Material("wall", (0.4, 0.5, 0.6, 1.0)),
            Material("leaf", (1.0, 0.5, 0.25, 1.0), alpha_mode="MASK", alpha_cutoff=0.5),
            Material("glass", (0.25, 0.5, 1.0, 0.4), alpha_mode="BLEND"),
        ),
        material_ids=rng.choice(3, size=count, p=(0.15, 0.3, 0.55)).astype(np.uint32),
        colors=rng.uniform(0.25, 1.0, size=(3 * count, 4)).astype(np.float32),
    )
