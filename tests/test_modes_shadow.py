"""Hard shadows against geometry in float64: which pixels lights reach; no acne and no leaks at any scale or place."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from kernel_world import NO_HIT
from mode_worlds import CHALK, Part, assemble, ball, color, downwards, floor, looking, rays_of, traced
from segment_twin import surely_blocked

from clrast.opencl.device import Device
from clrast.scene.camera import CameraVectors
from clrast.scene.model import Light, Scene

SIDE = 48


def occluders(count: int) -> Part:
    """Tilted triangles round heights 2 to 3, over the square from -2.5 to 2.5."""
    rng = np.random.default_rng(21)
    centers = np.column_stack([rng.uniform(-2.5, 2.5, size=(count, 2)), rng.uniform(2, 3, size=count)])
    corners = centers[:, None] + rng.uniform(-0.5, 0.5, size=(count, 3, 3))
    return Part(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3), CHALK)


LIGHTS = {
    "point": Light("p", "point", (20.0, 15.0, 10.0), (0.3, -0.2, 5.0)),
    "side": Light("l", "point", (60.0, 50.0, 40.0), (6.0, 3.0, 6.0)),
    "directional": Light("d", "directional", (3.0, 2.0, 1.0), direction=(0.48, -0.36, -0.8)),
    "spot": Light("s", "spot", (20.0, 15.0, 10.0), (-0.5, 0.4, 5.0), (0.0, 0.0, -1.0), 0.0, 0.0, 0.19),
}


def placed(light: Light, scale: float, offset: tuple[float, float, float]) -> Light:
    """The light where the scene is scaled and moved; as bright on it, its place rounded to float32."""
    at = np.float32(np.array(light.position) * scale + offset)
    strength = 1.0 if light.kind == "directional" else scale**2
    intensity = tuple(c * strength for c in light.intensity)
    return replace(light, position=tuple(float(c) for c in at), intensity=intensity)


def lit_by_geometry(
    scene: Scene, view: CameraVectors, light: Light, prim_ids: np.ndarray, margin: float
) -> tuple[np.ndarray, np.ndarray]:
    """Which pixels (rows, columns) the light reaches, and where `margin` in world units cannot change that."""
    corners = scene.positions.astype(np.float64)[scene.triangles]
    origins, directions = (each.reshape(-1, 3) for each in rays_of(view))
    own = np.where(prim_ids == NO_HIT, 0, prim_ids).ravel().astype(int)
    p0 = corners[own, 0]
    normal = np.cross(corners[own, 1] - p0, corners[own, 2] - p0)
    normal /= np.sqrt((normal * normal).sum(-1, keepdims=True))
    normal *= -np.sign((normal * directions).sum(-1, keepdims=True))
    t = ((p0 - origins) * normal).sum(-1) / (directions * normal).sum(-1)
    points = origins + t[:, None] * directions
    if light.kind == "directional":
        to_light = np.broadcast_to(-np.array(light.direction, dtype=np.float64), points.shape)
    else:
        to_light = np.array(light.position) - points
    dark, sure = surely_blocked(points, to_light, corners, math.inf if light.kind == "directional" else 1, own, margin)
    length = np.sqrt((to_light * to_light).sum(-1))
    slope = (to_light * normal).sum(-1)
    lit, sure = ~dark & (slope > 0), sure & (abs(slope) > 2.0**-16 * length) & (prim_ids != NO_HIT).ravel()
    if light.kind == "spot":
        cosine = -(to_light @ np.array(light.direction)) / length
        limit = math.cos(light.outer_cone)
        lit, sure = lit & (cosine > limit), sure & (abs(cosine - limit) > 2 * margin / length + 2.0**-20)
    return lit.reshape(prim_ids.shape), sure.reshape(prim_ids.shape)


def check_shadows(device: Device, scene: Scene, view: CameraVectors, margin: float, **options: Any) -> tuple[int, int]:
    """Light is where geometry says, bit for bit as without shadows, and nowhere else; returns pixels lit and dark."""
    options = {"aov": ("color", "id"), **options}
    cast, shadow = traced(device, scene, view, "cast", **options), traced(device, scene, view, "shadow", **options)
    hit = shadow["id.prim"] != NO_HIT
    lit, sure = lit_by_geometry(scene, view, scene.lights[0], shadow["id.prim"], margin)
    assert hit.mean() > 0.5 and sure[hit].mean() > 0.9
    np.testing.assert_array_equal((color(shadow) > 0).all(axis=2)[sure], lit[sure])
    same = (color(shadow) == color(cast)).all(axis=2)
    dark = (color(shadow) == 0).all(axis=2)
    assert (same | dark).all()
    assert same[sure & lit].all() and dark[sure & ~lit].all()
    return int((sure & lit).sum()), int((sure & ~lit).sum())


def shadow_scene(light: Light, scale: float, offset: tuple[float, float, float] = (0, 0, 0)) -> Scene:
    parts = [part.moved(scale, offset) for part in (floor(4, CHALK), occluders(40))]
    return assemble(*parts, lights=(placed(light, scale, offset),))


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e5])
@pytest.mark.parametrize("kind", LIGHTS)
def test_shadows_are_where_geometry_says(first_device: Device, kind: str, scale: float) -> None:
    """Seen from under the occluders, so that every pixel is on the floor. 2^-16 of the scene's size is 64 ulp."""
    scene, view = shadow_scene(LIGHTS[kind], scale), downwards(SIDE, 2 * scale, scale)
    lit, dark = check_shadows(first_device, scene, view, scale * 2.0**-16)
    assert lit > 200 and dark > 200


@pytest.mark.parametrize("kind", LIGHTS)
def test_shadows_in_perspective(first_device: Device, kind: str) -> None:
    """Occluders and floor seen from the side: shadows on either, and faces that turn from the light."""
    view = looking(SIDE, (-3.5, -2.5, 4.5), (0, 0, 0.6), 1 / 64)
    lit, dark = check_shadows(first_device, shadow_scene(LIGHTS[kind], 1.0), view, 2.0**-16)
    assert lit > 100 and dark > 100


@pytest.mark.parametrize("offset", [(1000.0, -700.0, 300.0), (-30000.0, 50000.0, 20000.0)], ids=["1e3", "5e4"])
def test_shadows_far_from_the_origin(first_device: Device, offset: tuple[float, float, float]) -> None:
    """A ray keeps 16 errors from the edges of what it leaves, each 8u of the sum of its coordinates' sizes."""
    scene, view = shadow_scene(LIGHTS["point"], 40.0, offset), downwards(SIDE, 160.0, 40.0, offset)
    lit, dark = check_shadows(first_device, scene, view, 16 * 8 * 2.0**-24 * sum(map(abs, offset)))
    assert lit > 200 and dark > 200


@pytest.mark.parametrize(("distance", "precision"), [(100.0, "midpoint"), (1e4, "midpoint"), (1e6, "exact")])
def test_shadows_seen_from_afar(first_device: Device, distance: float, precision: str) -> None:
    """A telescope: where a sample meets the floor is known to much less than a pixel, however far the eye is. From
    1e6 away float32 cannot tell which triangle that is: edge functions carry 2^-24 of the distance, a tenth here."""
    scene = shadow_scene(LIGHTS["point"], 1.0)
    direction = np.array((-0.3, -0.2, 1.0))
    view = looking(SIDE, direction * distance, (0.0, 0.0, 0.0), 2 / SIDE / distance, up=(0, 1, 0))
    check_shadows(first_device, scene, view, 2.0**-9, precision=precision)


# --- no acne, no leaks -----------------------------------------------------------------------------

OUTSIDE = (
    Light("p", "point", (3e4, 2e4, 1e4), (3.0, 2.5, 4.0)),
    Light("d", "directional", (3.0, 2.0, 1.0), direction=(-0.6, 0.64, -0.48)),
    Light("s", "spot", (3e4, 2e4, 1e4), (-4.0, 1.0, 2.0), (0.8728715609, -0.2182178902, -0.4364357805), 0.0, 0.1, 1.0),
)


@pytest.mark.parametrize("smooth", [False, True], ids=["flat", "smooth"])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e5])
def test_a_convex_body_does_not_shadow_itself(first_device: Device, smooth: bool, scale: float) -> None:
    lights = tuple(placed(light, scale, (0, 0, 0)) for light in OUTSIDE)
    scene = assemble(ball(3, scale, CHALK, smooth), lights=lights)
    view = looking(64, (0.5 * scale, 1.5 * scale, 3 * scale), (0, 0, 0), 1 / 96)
    cast, shadow = (traced(first_device, scene, view, mode) for mode in ("cast", "shadow"))
    assert (cast["R"] > 0).sum() > 500
    for channel in "RGBA":
        np.testing.assert_array_equal(shadow[channel], cast[channel])


@pytest.mark.parametrize("smooth", [False, True], ids=["flat", "smooth"])
@pytest.mark.parametrize(
    ("scale", "offset"), [(1e-3, 0.0), (1.0, 0.0), (1e5, 0.0), (100.0, 2e4)], ids=["1e-3", "1", "1e5", "afar"]
)
def test_no_light_leaks_into_a_closed_mesh(first_device: Device, smooth: bool, scale: float, offset: float) -> None:
    """Lights outside, the eye inside: every pixel of five views is black. And the other way round."""
    at = (offset, -0.5 * offset, 0.25 * offset)
    inside = Light("i", "point", (5.0, 5.0, 5.0), (0.1, 0.2, -0.15))
    body = ball(4, scale, CHALK, smooth).moved(1.0, at)
    scene = assemble(body, lights=tuple(placed(light, scale, at) for light in OUTSIDE))
    for k, to in enumerate(((1, 0.2, 0.1), (-1, 0.3, 0), (0.1, 1, 0.2), (0.2, -1, 0.1), (0.3, 0.2, 1))):
        eye = np.array(at) + scale * 0.1 * k
        view = looking(SIDE, eye, eye + np.array(to), 1 / 24, up=(0.3, 0.1, 0.9))
        frame = traced(first_device, scene, view, "shadow")
        assert (frame["A"] == 1).all() and not color(frame).any()
    walls = floor(8 * scale, CHALK, -3 * scale).moved(1.0, at)
    lamp = assemble(body, walls, lights=(placed(inside, scale, at),))
    view = looking(SIDE, np.array(at) + scale * np.array((3, 4, 5)), at, 1 / 24)
    frame = traced(first_device, lamp, view, "shadow")
    assert (frame["A"] == 1).sum() > 800 and not color(frame).any()
    # The lamp is on: it lights the mesh from inside.
    view = looking(SIDE, np.array(at), np.array(at) + (1, 0, 0), 1 / 24)
    assert (color(traced(first_device, lamp, view, "shadow")) > 0).mean() > 0.99
