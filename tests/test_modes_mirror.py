"""Mirrors and glass: single rays of closed form, and trees of rays against a float64 twin."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from mode_worlds import (
    GLASS,
    MASKED,
    MIRROR,
    Part,
    assemble,
    ball,
    color,
    cube,
    floor,
    looking,
    rays,
    rays_of,
    square,
    traced,
)
from statistics_twin import assert_unbiased
from whitted_twin import Tracer, fresnel

from clrast.opencl.device import Device
from clrast.scene.camera import CameraVectors
from clrast.scene.model import Material, Scene

SIDE = 32
PAINTED = Material("painted", (1.0, 1.0, 1.0, 1.0), unlit=True)
NO_GLOSS = Material("coat", (0.0, 0.0, 0.0, 1.0), roughness=0.0)
GRADIENT = np.array([(0, 0, 1, 1), (1, 0, 1, 1), (1, 1, 1, 1), (0, 1, 1, 1)], dtype=np.float64)


def backdrop(half: float, height: float, faces_down: bool = False) -> Part:
    """A square in z = height, red along x and green along y from 0 to 1, blue 1: it says where it is met."""
    corner, u, v = (-half, -half, height), (2 * half, 0, 0), (0, 2 * half, 0)
    if faces_down:
        return square(corner, v, u, PAINTED, colors=GRADIENT[[0, 3, 2, 1]])
    return square(corner, u, v, PAINTED, colors=GRADIENT)


def gradient(points: np.ndarray, half: float) -> np.ndarray:
    """Colours (..., 3) of a backdrop at points (..., 3)."""
    at = (points[..., :2] + half) / (2 * half)
    return np.concatenate([at, np.ones_like(at[..., :1])], axis=-1)


def unit_rows(v: np.ndarray) -> np.ndarray:
    return v / np.sqrt((v * v).sum(axis=-1, keepdims=True))


def at_height(origins: np.ndarray, d: np.ndarray, z: float) -> np.ndarray:
    """Where lines meet the plane z; nowhere along it."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return origins + d * ((z - origins[..., 2:]) / d[..., 2:])


PLACE = 2.0**-14
"""Colours are places. Directions have 8u of error; a ray may start 16 errors, of 8u each, of the three coordinates from
where it was met, as it keeps clear of edges: that is 128u * 90 of a half of 12 or more at most, in norms of up to 3."""


@pytest.mark.parametrize("mode", ["whitted", "path"])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e5])
def test_a_plane_mirror_shows_what_the_mirrored_eye_sees(first_device: Device, mode: str, scale: float) -> None:
    eye = np.array((1.0, -3.0, 6.0)) * scale
    view = looking(SIDE, eye, (0, 0, 0), 1 / 48)
    scene = assemble(floor(40 * scale, MIRROR), backdrop(16 * scale, 8 * scale, faces_down=True))
    samples = {"samples": 1} if mode == "path" else {}
    effects = {"indirect light": "on"} if mode == "path" else {}
    frame = traced(first_device, scene, view, mode, effects=effects, max_depth=1, **samples)
    origins, d = rays_of(view)
    mirrored = (1, 1, -1)
    expected = gradient(at_height(origins * mirrored, d * mirrored, 8 * scale), 16 * scale)
    assert expected.min() > 0 and np.ptp(expected[..., 0]) > 0.2
    np.testing.assert_allclose(color(frame), expected, atol=PLACE)
    assert rays(frame)["reflection"] == SIDE * SIDE


@pytest.mark.parametrize("metallic", [0.0, 0.5, 1.0])
def test_a_mirror_weighs_by_schlick(first_device: Device, metallic: float) -> None:
    """f0 + (1 - f0)(1 - cos)^5 of a white backdrop, and the headlight on what is not mirrored."""
    base = np.array((0.8, 0.4, 0.1))
    surface = Material("m", (*base, 1.0), metallic=metallic, roughness=0.03)
    view = looking(SIDE, (0.0, -4.0, 1.0), (0, 0, 0), 1 / 40)
    scene = assemble(floor(90, surface), *(
        square((-90, side * 60, 0), (180, 0, 0), (0, 0, 180), replace(PAINTED)) for side in (-1, 1)
    ), square((-90, -60, 150), (180, 0, 0), (0, 120, 0), PAINTED))  # fmt: skip
    frame = traced(first_device, scene, view, "whitted", max_depth=1, aov=("color", "id"))
    on_floor = frame["id.prim"] < 2
    cosine = abs(unit_rows(rays_of(view)[1])[..., 2:])
    f0 = base * metallic + 0.04 * (1 - metallic)
    expected = f0 + (1 - f0) * (1 - cosine) ** 5 + base * cosine * (1 - metallic)
    assert on_floor.sum() > 400 and np.ptp(cosine[on_floor]) > 0.3
    # 1 - cos has 8u of error, and its fifth power five times as much of itself.
    np.testing.assert_allclose(color(frame)[on_floor], expected[on_floor], rtol=64 * 2.0**-24)


@pytest.mark.parametrize("depth", [2, 4])
@pytest.mark.parametrize("ior", [1.5, 2.4, 1.0])
def test_a_slab_of_glass_shifts_what_is_behind(first_device: Device, ior: float, depth: int) -> None:
    """Snell's parallel shift, weighed (1 - F)^2; with more rays also light that was mirrored twice inside."""
    thick, half, z = 1.5, 16.0, -6.0
    view = looking(SIDE, (1.0, -7.0, 7.0), (0.5, -2.0, 0.0), 1 / 64)
    slab = cube(0.5, replace(GLASS, ior=ior))
    slab = replace(slab, positions=slab.positions * (60, 60, thick) + (0, 0, -thick / 2))
    scene = assemble(slab, backdrop(half, z))
    frame = traced(first_device, scene, view, "whitted", max_depth=depth)
    origins, d = rays_of(view)
    d = unit_rows(d)
    cosine = -d[..., 2:]
    inner = np.sqrt(1 - (1 - cosine**2) / ior**2)
    share = np.vectorize(lambda c: fresnel(float(c), 1.0, ior)[0])(cosine)
    tangent = np.sqrt(1 - inner**2) / inner
    along = np.concatenate([unit_rows(d[..., :2]), np.zeros_like(cosine)], axis=-1)
    entry = at_height(origins, d, 0.0)
    expected = np.zeros_like(d)
    for bounces in range(0, depth - 1, 2):
        exit_ = entry + along * tangent * thick * (bounces + 1) - (0, 0, thick)
        weight = (1 - share) ** 2 * share**bounces
        assert (weight > 2.0**-10).all() or bounces > 0
        expected += np.where(weight > 2.0**-10, weight, 0) * gradient(at_height(exit_, d, z), half)
    unsure = abs((1 - share) ** 2 * share**2 / 2.0**-10 - 1) < 1e-3
    assert unsure.mean() < 0.05 or depth == 2
    wanted = ~unsure[..., 0] if depth > 2 else np.ones((SIDE, SIDE), dtype=bool)
    np.testing.assert_allclose(color(frame)[wanted], expected[wanted], atol=PLACE)


def test_total_internal_reflection(first_device: Device) -> None:
    """The eye is inside of glass whose face is z = 0: past the critical angle it is a mirror, before it both show."""
    half, below, above = 16.0, -6.0, 4.0
    view = looking(SIDE, (0.0, -3.0, -2.5), (0.0, 0.2, 0.0), 1 / 24)
    scene = assemble(floor(30, GLASS), backdrop(half, below), backdrop(60.0, above, faces_down=True))
    frame = traced(first_device, scene, view, "whitted", max_depth=1, aov=("color", "id"))
    origins, d = rays_of(view)
    d = unit_rows(d)
    up = d[..., 2] > 0.02
    cosine = d[..., 2:]
    sine = 1.5 * np.sqrt(1 - cosine**2)
    share = np.vectorize(lambda c: fresnel(abs(float(c)), 1.5, 1.0)[0])(cosine)
    entry = at_height(origins, d, 0.0)
    mirrored = gradient(at_height(entry, d * (1, 1, -1), below), half)
    outside = np.concatenate([1.5 * d[..., :2], np.sqrt(np.maximum(1 - sine**2, 0))], axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        beyond = gradient(at_height(entry, outside, above), 60.0)
    seen = abs(at_height(entry, d * (1, 1, -1), below)[..., :2]).max(axis=-1) < half
    with np.errstate(invalid="ignore"):
        seen &= (share[..., 0] == 1) | (abs(at_height(entry, outside, above)[..., :2]).max(axis=-1) < 60)
    # Near the critical angle Fresnel's share has a root's slope: 2^-12 of an angle there moves it by 2^-6.
    wanted = up & seen & (abs(sine[..., 0] - 1) > 2.0**-12)
    total = share[..., 0] == 1
    assert (wanted & total).sum() > 200 and (wanted & ~total).sum() > 50
    found = color(frame)
    np.testing.assert_allclose(found[wanted & total], mirrored[wanted & total], atol=PLACE)
    expected = share * mirrored + (1 - share) * np.nan_to_num(beyond, posinf=0, neginf=0)
    np.testing.assert_allclose(found[wanted & ~total], expected[wanted & ~total], atol=2 * PLACE)


ROOM = (
    backdrop(12.0, -5.0),
    backdrop(12.0, 9.0, faces_down=True),
    square((-12, 9, -5), (24, 0, 0), (0, 0, 14), PAINTED, colors=GRADIENT[[1, 2, 3, 0]]),
    square((12, -9, -5), (-24, 0, 0), (0, 0, 14), PAINTED, colors=GRADIENT[[2, 0, 1, 3]]),
    square((-9, -12, -5), (0, 24, 0), (0, 0, 14), PAINTED, colors=GRADIENT[[3, 1, 0, 2]]),
    square((9, 12, -5), (0, -24, 0), (0, 0, 14), PAINTED, colors=GRADIENT[[0, 2, 1, 3]]),
)
TINTED = replace(GLASS, base_color=(0.9, 0.7, 0.5, 1.0), transmission=0.75, ior=1.33)
VEIL = Material("veil", (0.2, 0.5, 0.1, 0.375), unlit=True, alpha_mode="BLEND")
BODIES: dict[str, tuple[Part, ...]] = {
    "glass ball": (ball(1, 1.5, GLASS),),
    "glass ball, normals": (ball(1, 1.5, GLASS, smooth=True),),
    "tinted ball": (ball(1, 1.5, TINTED, smooth=True),),
    "mirror ball, normals": (ball(1, 1.5, MIRROR, smooth=True), floor(5.0, NO_GLOSS, -1.6)),
    "two balls": (ball(1, 1.0, MIRROR).moved(1, (-1, 0, 0.2)), ball(1, 0.9, GLASS).moved(1, (0.9, -0.9, 0))),
    "veiled mirror": (floor(5.0, MIRROR, -1.5), square((-2, -1, -1), (4, 1, 0), (0, 0.5, 2.5), VEIL)),
}


def against_the_twin(device: Device, scene: Scene, view: CameraVectors, max_depth: int, **options: Any) -> int:
    """Compares the pixels whose rays stay clear of edges; returns how many those are."""
    frame = traced(device, scene, view, "whitted", max_depth=max_depth, **options)
    origins, d = (each.reshape(-1, 3) for each in rays_of(view))
    found, compared = color(frame).reshape(-1, 3), 0
    for k in range(len(d)):
        tracer = Tracer(scene, max_depth)
        expected = tracer.radiance(origins[k], d[k])
        if tracer.least < 1e-3:
            continue
        compared += 1
        # Curved surfaces spread rays: each generation may make an error ten times as large.
        np.testing.assert_allclose(found[k], expected, atol=2.0**-12, err_msg=f"pixel {k}")
    return compared


@pytest.mark.parametrize("name", [pytest.param(k, marks=pytest.mark.long) if "veil" in k else k for k in BODIES])
def test_trees_of_rays_against_the_twin(first_device: Device, name: str) -> None:
    scene = assemble(*BODIES[name], *ROOM)
    view = looking(24, (3.0, -5.0, 2.5), (0, 0, 0), 1 / 24)
    assert against_the_twin(first_device, scene, view, 4) > 24 * 24 * 0.75


@pytest.mark.parametrize("mode", ["whitted", "path"])
def test_panes_seen_in_a_mirror(first_device: Device, mode: str) -> None:
    """Two unlit panes one behind the other before the sky: each shows alpha of itself, and lets the rest pass."""
    red = Material("red", (1.0, 0.0, 0.0, 0.375), unlit=True, alpha_mode="BLEND")
    scene = assemble(
        floor(9, MIRROR), floor(40, red, 4.0), floor(60, replace(red, base_color=(0.0, 0.5, 0.0, 0.25)), 5.0),
        environment=(0.25, 0.5, 1.0),
    )  # fmt: skip
    options = {"samples": 64, "effects": {**MASKED, "indirect light": "on"}} if mode == "path" else {"effects": MASKED}
    frame = traced(first_device, scene, looking(16, (0, -1, 2), (0, 0, 0), 1 / 64), mode, max_depth=3, **options)
    sky = 0.625 * 0.75 * np.array((0.25, 0.5, 1.0))
    expected = np.array((0.375, 0, 0)) + 0.625 * 0.25 * np.array((0, 0.5, 0)) + sky
    # Paths are stopped by a pane or go on as the rays that they were.
    assert (rays(frame)["refraction"] > 0) == (mode == "whitted")
    if mode == "whitted":
        np.testing.assert_allclose(color(frame), np.broadcast_to(expected, (16, 16, 3)), rtol=16 * 2.0**-24)
    for channel in range(3):
        assert_unbiased(color(frame)[..., channel] - expected[channel], 0.02, 2.0**-20)


def test_nothing_is_behind_the_last_ray(first_device: Device) -> None:
    """max_depth 0 shows a mirror black; 1 shows a mirror in it black, and what else is there."""
    view = looking(8, (0, -3, 1), (0, 0, 0), 1 / 32)
    scene = assemble(floor(9, MIRROR), square((-9, 6, -1), (18, 0, 0), (0, 0, 18), MIRROR))
    for depth in (0, 1, 7):
        frame = traced(first_device, replace(scene, environment=None), view, "whitted", max_depth=depth)
        assert (frame["A"] == 1).all() and not color(frame).any()
        assert rays(frame)["reflection"] == 64 * min(depth, 2)
