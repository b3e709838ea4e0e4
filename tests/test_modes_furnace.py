"""Furnaces: bodies in light that comes from everywhere alike, whose radiance has a closed form or is a quadrature."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from kernel_world import NO_HIT
from light_quadrature import directional_albedo
from mode_worlds import (
    DARK,
    GLASS,
    MIRROR,
    assemble,
    ball,
    color,
    cube,
    looking,
    parallel,
    rays,
    rays_of,
    traced,
)
from statistics_twin import assert_unbiased

from clrast.opencl.device import Device
from clrast.scene.camera import CameraVectors
from clrast.scene.model import Material, Scene

WHITE = (1.0, 1.0, 1.0, 1.0)
VIEW = parallel(56, 3.2, (-3, -2, -4), 8)
"""Parallel rays see a flat triangle at one cosine."""

BODIES = {
    "chalk": Material("chalk", WHITE, roughness=1.0),
    "metal 1": Material("metal", WHITE, metallic=1.0, roughness=1.0),
    "metal 0.5": Material("metal", WHITE, metallic=1.0, roughness=0.5),
    "metal 0.2": Material("metal", WHITE, metallic=1.0, roughness=0.2),
    "metal 0.05": Material("metal", WHITE, metallic=1.0, roughness=0.05),
    "plastic": Material("plastic", (0.5, 0.25, 1.0, 1.0), roughness=0.3),
    "alloy": Material("alloy", (1.0, 0.5, 0.25, 1.0), metallic=0.5, roughness=0.6),
}


NAMES = list(BODIES)

QUADRATURE = 2e-4
"""Error of directional_albedo."""


def furnace(material: Material) -> Scene:
    """A convex body alone in an environment of radiance 1."""
    return assemble(ball(1, 1.5, material), lights=(DARK,), environment=(1.0, 1.0, 1.0))


def cosines(scene: Scene, view: CameraVectors) -> np.ndarray:
    """(triangle_count,) cosine at which a parallel view sees each, in float64."""
    corners = scene.positions.astype(np.float64)[scene.triangles]
    n = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    d = np.array(view.direction)
    return abs(n @ d) / np.sqrt((n * n).sum(-1) * (d @ d))


def test_quadrature_has_converged() -> None:
    """And white metals lose what the BRDF, which mirrors once, loses; nearly nothing where they are smooth."""
    for material in BODIES.values():
        for cosine in (0.15, 0.6):
            coarse, fine = (directional_albedo(material, cosine, k, k) for k in (128, 200))
            np.testing.assert_allclose(coarse, fine, atol=QUADRATURE)
    assert 0.999 < directional_albedo(BODIES["metal 0.05"], 0.6)[0] <= 1.0001


@pytest.mark.parametrize("name", [*NAMES[:4], *(pytest.param(name, marks=pytest.mark.long) for name in NAMES[4:])])
def test_rough_bodies_in_a_furnace(first_device: Device, name: str) -> None:
    """Each pixel's expectation is the directional albedo at its cosine: the mean of what is left is 0 to 1 in 1000."""
    scene = furnace(BODIES[name])
    options = {"samples": 512 if BODIES[name].metallic < 1 else 128, "max_depth": 1}
    frame = traced(first_device, scene, VIEW, "path", aov=("color", "id"), **options)
    hit = frame["id.prim"] != NO_HIT
    seen, where = np.unique(frame["id.prim"][hit], return_inverse=True)
    albedos = np.array([directional_albedo(BODIES[name], c) for c in cosines(scene, VIEW)[seen]])
    assert hit.sum() > 1500 and len(seen) > 30
    for channel in range(3):
        assert_unbiased(color(frame)[hit][:, channel] - albedos[where, channel], 1e-3, QUADRATURE)


@pytest.mark.parametrize("mode", ["whitted", "path"])
@pytest.mark.parametrize("smooth", [False, True], ids=["flat", "smooth"])
def test_a_mirror_in_a_furnace_is_white(first_device: Device, mode: str, smooth: bool) -> None:
    """And so is the mean of pixels that it covers in part: colour is premultiplied, its alpha is what is covered."""
    scene = replace(furnace(MIRROR), environment=(0.25, 1.0, 3.0))
    if smooth:
        scene = replace(assemble(ball(2, 1.5, MIRROR, True), lights=(DARK,)), environment=(0.25, 1.0, 3.0))
    for aa in ("none", "ssaa:4"):
        frame = traced(first_device, scene, VIEW, mode, aa=aa, **({"samples": 3} if mode == "path" else {}))
        assert (frame["A"] == 1).sum() > 200 and (frame["A"] == 0).any()
        for channel, radiance in zip("RGB", (0.25, 1.0, 3.0), strict=True):
            # Sums of three paths, and of four samples: 4u.
            np.testing.assert_allclose(frame[channel], radiance * frame["A"], rtol=4 * 2.0**-24)


def test_glass_in_a_furnace_is_white(first_device: Device) -> None:
    """Light that glass does not mirror it lets through: no path loses any. Of a cube of glass all light gets out:
    inside it has a cosine of 0.745 or more to the faces that it came in by, and leaves there."""
    scene = assemble(cube(0.9, GLASS), lights=(DARK,), environment=(1.0, 1.0, 1.0))
    options = {"samples": 32, "max_depth": 64, "aov": ("color", "id")}
    frame = traced(first_device, scene, VIEW, "path", **options)
    hit = frame["id.prim"] != NO_HIT
    assert_unbiased(color(frame)[hit][:, 0].astype(np.float64) - 1, 1e-2)
    counts = rays(frame)
    assert counts["reflection"] > 0 and counts["refraction"] > counts["reflection"] and counts["indirect"] == 0
    short = traced(first_device, scene, VIEW, "path", **{**options, "max_depth": 2, "samples": 1})
    assert set(np.unique(short["R"])) == {0.0, 1.0}, "a path of two rays got out, or did not"


def test_whitted_glass_loses_what_is_too_weak_to_trace(first_device: Device) -> None:
    """At each hit two rays of 2^-10 at most are not traced."""
    scene = assemble(cube(0.9, GLASS), lights=(DARK,), environment=(1.0, 1.0, 1.0))
    frame = traced(first_device, scene, VIEW, "whitted", max_depth=64, aov=("color", "id"))
    found, counts = color(frame)[frame["id.prim"] != NO_HIT], rays(frame)
    hits_of_pixel = 1 + (counts["reflection"] + counts["refraction"]) / len(found)
    assert found.max() <= 1 + 2.0**-16
    assert 1 - found.mean() <= 2.0**-9 * hits_of_pixel < 0.03
    assert found.min() > 0.9


GLOW = 0.375


@pytest.mark.parametrize(("mode", "depth"), [("whitted", 0), ("whitted", 1), ("whitted", 25), ("path", 0), ("path", 3)])
def test_a_box_of_glowing_mirrors(first_device: Device, mode: str, depth: int) -> None:
    """Each generation adds what a wall emits, exactly: sums of 3/8 are short numbers. And no ray gets out."""
    walls = replace(MIRROR, emissive=(GLOW, 2 * GLOW, 4 * GLOW))
    scene = assemble(cube(1.0, walls), lights=(DARK,), environment=(64.0, 64.0, 64.0))
    view = looking(24, (0.1, 0.2, -0.3), (0.9, 0.3, 0.2), 1 / 12)
    samples = {"samples": 2} if mode == "path" else {}
    frame = traced(first_device, scene, view, mode, max_depth=depth, **samples)
    for channel, factor in zip("RGB", (1, 2, 4), strict=True):
        np.testing.assert_array_equal(frame[channel], np.float32(GLOW * factor * (depth + 1)))
    assert rays(frame)["reflection"] == 24 * 24 * depth * samples.get("samples", 1)


def test_roulette_keeps_the_mean(first_device: Device) -> None:
    """From depth 3 on paths end by chance: those that go on stand for them."""
    scene = assemble(cube(1.0, replace(MIRROR, emissive=(0.25, 0.25, 0.25))))
    view = looking(32, (0.1, 0.2, -0.3), (0.9, 0.3, 0.2), 1 / 12)
    frame = traced(first_device, scene, view, "path", max_depth=15, samples=32)
    assert np.ptp(frame["R"]) > 0
    assert_unbiased(frame["R"].astype(np.float64) - 4, 0.05)


@pytest.mark.parametrize("depth", [0, 1, 4])
def test_a_closed_box_that_glows(first_device: Device, depth: int) -> None:
    """Mirrors of base 1/2 that emit 1, followed from wall to wall in float64 with Schlick's term at each."""
    walls = replace(MIRROR, base_color=(0.5, 0.5, 0.5, 1.0), emissive=(1.0, 1.0, 1.0))
    scene = assemble(cube(1.0, walls), lights=(DARK,))
    view = looking(16, (0.1, 0.2, -0.3), (0.9, 0.3, 0.2), 1 / 256)
    frame = traced(first_device, scene, view, "whitted", max_depth=depth)
    d = rays_of(view)[1].reshape(-1, 3)
    d = d / np.sqrt((d * d).sum(-1, keepdims=True))
    eye = np.array(view.origin)
    expected = np.array([glowing_box(eye, each, depth) for each in d])
    np.testing.assert_allclose(frame["R"].ravel(), expected, rtol=2.0**-19)


def glowing_box(at: np.ndarray, d: np.ndarray, depth: int) -> float:
    """Radiance along d in the box from -1 to 1 whose walls emit 1 and mirror f0 = 1/2 by Schlick's term."""
    total, weight = 0.0, 1.0
    for _ in range(depth + 1):
        steps = (np.where(d > 0, 1.0, -1.0) - at) / d
        axis = int(np.argmin(steps))
        at, total = at + steps[axis] * d, total + weight
        weight *= 0.5 + 0.5 * (1 - abs(d[axis])) ** 5
        d = d * np.where(np.arange(3) == axis, -1.0, 1.0)
    return total
