"""Paths against integrals in float64: emitters, many lights, depth; what blends, masks and covers."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from light_quadrature import directional_albedo, light_of_emitters
from light_twin import radiance
from mode_worlds import (
    CHALK,
    MASKED,
    Part,
    assemble,
    color,
    cube,
    downwards,
    floor,
    looking,
    parallel,
    rays_of,
    square,
    traced,
)
from statistics_twin import assert_unbiased

from clrast.opencl.device import Device
from clrast.scene.camera import CameraVectors
from clrast.scene.model import Light, Material, Scene, Texture, TextureUse

SIDE = 32
UP = np.array((0.0, 0.0, 1.0))
PLASTIC = Material("plastic", (0.3, 0.6, 0.9, 1.0), roughness=0.45)
ALLOY = Material("alloy", (0.9, 0.6, 0.3, 1.0), metallic=0.6, roughness=0.5)
LAMP = Material("lamp", (0.0, 0.0, 0.0, 1.0), emissive=(8.0, 4.0, 2.0))
OTHER = Material("other", (0.0, 0.0, 0.0, 1.0), emissive=(0.5, 3.0, 6.0))
LAMP_PART = square((-0.75, -0.5, 1.5), (0, 1, 0), (1.25, 0, 0.25), LAMP)
OTHER_PART = square((0.75, 0.25, 1.4), (0.5, 0, 0), (0, 0.4, 0.05), OTHER)
LIGHT = Light("p", "point", (3.0, 2.0, 6.0), (1.5, -1.5, 1.0))
EYE = np.array((0.2, -2.5, 1.2))
VIEW = looking(SIDE, EYE, (0, 0, 0), 1 / 64)
"""Sees the floor alone, from under the lamps, which hide no part of each other from where it looks."""

def floor_points(view: CameraVectors) -> tuple[np.ndarray, np.ndarray]:
    """Where pixels see z = 0, and unit vectors to the viewer: (pixels, 3) float64."""
    origins, d = (each.reshape(-1, 3) for each in rays_of(view))
    return origins - d * (origins[:, 2:] / d[:, 2:]), -d / np.sqrt((d * d).sum(-1, keepdims=True))


def paths(device: Device, scene: Scene, view: CameraVectors = VIEW, **options: Any) -> np.ndarray:
    """(pixels, 3) float64 of a path render in which every pixel shows something."""
    frame = traced(device, scene, view, "path", **{"samples": 64, "max_depth": 1, **options})
    assert (frame["A"] == 1).all()
    return color(frame).reshape(-1, 3).astype(np.float64)


def check_floor(found: np.ndarray, expected: np.ndarray, share: float = 0.01) -> None:
    """No bias in any channel, over the image and in each eighth of its rows; to `share` of the mean."""
    for channel in range(3):
        residuals, scale = found[:, channel] - expected[:, channel], expected[:, channel].mean()
        assert_unbiased(residuals, share * scale, 1e-5 * scale)
        for rows in residuals.reshape(8, -1):
            assert_unbiased(rows, 4 * share * scale, 1e-5 * scale)


def light_on_floor(material: Material, emitters: tuple[Part, ...], lights: tuple[Light, ...] = ()) -> np.ndarray:
    points, to_viewer = floor_points(VIEW)
    expected = light_of_emitters(material, points, UP, to_viewer, emitters)
    if lights:
        pairs = zip(points, to_viewer, strict=True)
        expected += np.array([radiance(material, lights, point, UP, v) for point, v in pairs])
    return expected


@pytest.mark.parametrize("material", [CHALK, PLASTIC, ALLOY], ids=lambda m: m.name)
def test_a_square_lamp_over_a_floor(first_device: Device, material: Material) -> None:
    """One bounce: points drawn on the lamp, and rays that find it, weighed against each other."""
    scene = assemble(floor(20, material), LAMP_PART)
    check_floor(paths(first_device, scene), light_on_floor(material, (LAMP_PART,)))


@pytest.mark.parametrize("material", [CHALK, PLASTIC], ids=lambda m: m.name)
def test_two_lamps_and_a_light(first_device: Device, material: Material) -> None:
    """Of unlike colours, so that the light that is drawn and its share of the power must go together."""
    scene = assemble(floor(20, material), LAMP_PART, OTHER_PART, lights=(LIGHT,))
    expected = light_on_floor(material, (LAMP_PART, OTHER_PART), (LIGHT,))
    check_floor(paths(first_device, scene, samples=128), expected)


@pytest.mark.parametrize("material", [CHALK, PLASTIC], ids=lambda m: m.name)
def test_depth_0_is_direct_light(first_device: Device, material: Material) -> None:
    """No ray goes on, so points drawn on the lamp stand for all of its light."""
    scene = assemble(floor(20, material), LAMP_PART)
    found = paths(first_device, scene, max_depth=0)
    check_floor(found, light_on_floor(material, (LAMP_PART,)))


@pytest.mark.parametrize("offset", [0.0, 3000.0, 50000.0])
def test_a_lamp_far_from_the_origin(first_device: Device, offset: float) -> None:
    """Coordinates are rounded, lamp and floor to other planes: but a lamp never hides its own light."""
    at = (offset, -offset, 0.5 * offset)
    parts = [part.moved(16, at) for part in (floor(20, CHALK), LAMP_PART)]
    view = looking(SIDE, np.array(at) + 16 * EYE, at, 1 / 64)
    found, near = paths(first_device, assemble(*parts), view), light_on_floor(CHALK, (LAMP_PART,))
    # Places move by 2^-9 of 16 at most: angles by a thousandth, and what the floor shows by a few.
    assert (abs((found - near).mean(axis=0)) < 0.01 * near.mean(axis=0)).all()


def test_light_between_walls(first_device: Device) -> None:
    """In a closed box that glows each wall sees 1 everywhere: with depth 0 it sends 1 + albedo at its cosine."""
    wall = replace(CHALK, base_color=(0.5, 0.5, 0.5, 1.0), emissive=(1.0, 1.0, 1.0))
    view = parallel(SIDE, 0.5, (-3, -2, -4), 0.25)
    scene = assemble(cube(1.0, wall))
    d = np.array(view.direction)
    frame = traced(first_device, scene, view, "path", samples=128, max_depth=0, aov=("color", "normal"))
    cosine = abs(sum(frame[f"Ng.{axis}"].astype(np.float64) * d[k] for k, axis in enumerate("XYZ")))
    values = {float(c): directional_albedo(wall, float(c))[0] for c in np.unique(cosine.round(5))}
    expected = 1 + np.vectorize(lambda c: values[round(float(c), 5)])(cosine)
    assert_unbiased(frame["R"] - expected, 0.06, 2e-4)


# --- lights of shadow mode in paths ----------------------------------------------------------------


@pytest.mark.parametrize("kind", ["point", "directional", "spot"])
def test_one_light_and_depth_0_is_mode_shadow(first_device: Device, kind: str) -> None:
    """Bit for bit: the light is drawn for sure, and its share of the power is 1."""
    light = replace(LIGHT, kind=kind, direction=(-0.48, 0.6, -0.64), inner_cone=0.1, outer_cone=0.5)
    blocker = square((-0.5, -0.5, 0.5), (1, 0, 0.25), (0, 1, 0), PLASTIC)
    scene = assemble(floor(20, CHALK), blocker, lights=(light,))
    view = looking(SIDE, (0.2, -2.5, 3.0), (0, 0.1, 0), 1 / 24)
    shadow = traced(first_device, scene, view, "shadow")
    path = traced(first_device, scene, view, "path", max_depth=0, samples=1, seed=7)
    assert (color(shadow) == 0).any() and (color(shadow) > 0).any()
    np.testing.assert_array_equal(color(path), color(shadow))


# --- leaves and panes ------------------------------------------------------------------------------

LEAF_UV = np.array([(0, 1), (1, 1), (1, 0), (0, 0)], dtype=np.float64)


def leaf(z: float, half: float = 1.0, **fields: Any) -> Part:
    """A square whose texture of 8 x 8 texels is opaque in a pattern, as a mask or blending."""
    use = TextureUse(0, nearest=True, wrap_u="clamp", wrap_v="clamp")
    material = Material("leaf", (0.2, 0.7, 0.1, 1.0), base_color_texture=use, **{"alpha_mode": "MASK", **fields})
    return square((-half, -half, z), (2 * half, 0, 0), (0, 2 * half, 0), material, uv=LEAF_UV)


def pattern() -> np.ndarray:
    """(8, 8) bool, row 0 at the top (v = 0)."""
    return np.random.default_rng(5).random((8, 8)) < 0.5


def leaf_texture() -> Texture:
    texels = np.full((8, 8, 4), 255, dtype=np.uint8)
    texels[..., 3] = np.where(pattern(), 255, 0)
    return Texture("leaf", texels, srgb=False)


@pytest.mark.parametrize("mode", ["shadow", "path"])
def test_the_shadow_of_a_leaf_has_its_holes(first_device: Device, mode: str) -> None:
    """The floor seen from under the leaf: lit through the texels that are not there, and beside it."""
    light = replace(LIGHT, position=(0.3, -0.2, 3.0))
    scene = assemble(floor(6, CHALK), leaf(1.0), lights=(light,), textures=(leaf_texture(),))
    view = downwards(48, 4.0, 0.5)
    options = {"max_depth": 0, "samples": 1} if mode == "path" else {}
    lit = color(traced(first_device, scene, view, mode, effects=MASKED, **options))[..., 0] > 0
    points, _ = floor_points(view)
    crossing = points + (np.array(light.position) - points) / 3
    texel = (crossing[:, :2] * (1, -1) + 1) * 4
    inside = ((texel >= 0) & (texel < 8)).all(axis=1)
    column, row = np.clip(texel, 0, 7.999).astype(int).T
    dark = inside & pattern()[row, column]
    sure = (abs(texel - texel.round()) > 2.0**-12).all(axis=1)
    assert sure.mean() > 0.95 and dark.sum() > 200 and (~dark).sum() > 200
    np.testing.assert_array_equal(lit.ravel()[sure], ~dark[sure])


@pytest.mark.parametrize(("alpha", "passes"), [(0.25, True), (0.4999, True), (0.5, False), (1.0, False)])
def test_panes_stop_light_from_half_alpha_on(first_device: Device, alpha: float, passes: bool) -> None:
    """THIN_ALPHA: in mode shadow light passes a blending surface wholly or not at all."""
    pane = Material("pane", (1.0, 0.0, 0.0, alpha), alpha_mode="BLEND")
    scene = assemble(floor(6, CHALK), floor(20, pane, 0.75), lights=(LIGHT,))
    view = downwards(16, 2.0, 0.5)
    assert (color(traced(first_device, scene, view, "shadow", effects=MASKED))[..., 0] > 0).all() == passes


def black_pane(alpha: float, z: float) -> Part:
    """Lets 1 - alpha pass, and sends nothing on."""
    return floor(30, Material("pane", (0.0, 0.0, 0.0, alpha), unlit=True, alpha_mode="BLEND"), z)


@pytest.mark.parametrize(("alpha", "depth"), [(0.25, 0), (0.25, 1), (0.25, 2), (0.75, 1), (0.75, 2)])
def test_panes_dim_the_light_of_lamps(first_device: Device, alpha: float, depth: int) -> None:
    """1 - alpha of a lamp's light arrives at the floor below a black pane, whether points on it are drawn or rays find
    it; seen from under it. A pane that a path passes is no bounce."""
    scene = assemble(floor(20, CHALK), LAMP_PART, black_pane(alpha, 1.25))
    found = paths(first_device, scene, max_depth=depth, samples=128, effects=MASKED)
    # Which rays pass is drawn: of 64 rows of pixels and 128 samples a variance of alpha (1 - alpha) leaves a percent.
    check_floor(found, (1 - alpha) * light_on_floor(CHALK, (LAMP_PART,)), 0.02)


@pytest.mark.parametrize("kind", ["point", "directional"])
def test_panes_dim_lights(first_device: Device, kind: str) -> None:
    """Two panes between the light and the floor: in paths each lets 1 - alpha pass."""
    light = replace(LIGHT, kind=kind, position=(1.5, -1.5, 3.0), direction=(-0.48, 0.6, -0.64))
    scene = assemble(floor(20, CHALK), black_pane(0.25, 1.25), black_pane(0.6, 1.5), lights=(light,))
    found = paths(first_device, scene, max_depth=0, samples=256, effects=MASKED)
    check_floor(found, 0.75 * 0.4 * light_on_floor(CHALK, (), (light,)), 0.02)


@pytest.mark.parametrize("alpha", [0.25, 0.75])
def test_seen_through_a_pane(first_device: Device, alpha: float) -> None:
    """A black pane upright between the eye and the floor: 1 - alpha of what the floor shows."""
    upright = square((-9, -2.0, -9), (18, 0, 0), (0, 0, 18), black_pane(alpha, 0).material)
    found = paths(first_device, assemble(floor(20, CHALK), LAMP_PART, upright), effects=MASKED)
    check_floor(found, (1 - alpha) * light_on_floor(CHALK, (LAMP_PART,)))


def leaf_squares() -> tuple[Part, ...]:
    """The texels of a glowing leaf that are there, as lamps."""
    step = 1.5 / 8
    return tuple(
        square((-0.75 + step * column, 0.75 - step * (row + 1), 1.5), (step, 0, 0), (0, step, 0), LAMP)
        for row, column in np.argwhere(pattern()).tolist()
    )


def test_masked_lamps_shine_where_they_are(first_device: Device) -> None:
    """Texels that are not there send no light, whether a point on them is drawn or a ray goes there."""
    use = TextureUse(0, nearest=True, wrap_u="clamp", wrap_v="clamp")
    material = replace(LAMP, base_color_texture=use, alpha_mode="MASK")
    lamp = replace(leaf(1.5, 0.75), material=material)
    scene = assemble(floor(20, CHALK), lamp, textures=(leaf_texture(),))
    points, to_viewer = floor_points(VIEW)
    expected = light_of_emitters(CHALK, points, UP, to_viewer, leaf_squares(), 4)
    check_floor(paths(first_device, scene, effects=MASKED), expected, 0.03)


def test_blending_lamps_shine_by_their_alpha(first_device: Device) -> None:
    lamp = replace(LAMP_PART, material=replace(LAMP, base_color=(0.0, 0.0, 0.0, 0.75), alpha_mode="BLEND"))
    found = paths(first_device, assemble(floor(20, CHALK), lamp), effects=MASKED)
    check_floor(found, 0.75 * light_on_floor(CHALK, (LAMP_PART,)))


def test_unlit_surfaces_are_no_lamps(first_device: Device) -> None:
    """KHR_materials_unlit: their emission does not count; they shine with their base colour, found by rays alone."""
    sign = replace(LAMP, unlit=True, base_color=(0.5, 0.25, 1.0, 1.0))
    scene = assemble(floor(20, CHALK), replace(LAMP_PART, material=sign), OTHER_PART)
    shining = replace(LAMP_PART, material=replace(LAMP, emissive=(0.5, 0.25, 1.0)))
    check_floor(paths(first_device, scene, samples=256), light_on_floor(CHALK, (shining, OTHER_PART)), 0.02)


BLACK = replace(CHALK, base_color=(0.0, 0.0, 0.0, 1.0), ior=1.0)
COVER = square((-3, -3, 1.2), (6, 0, 0), (0, 6, 0), BLACK)
FLAT_LAMP = square((-0.75, -0.5, 1.2), (0, 1, 0), (1.25, 0, 0), LAMP)


@pytest.mark.parametrize("gap", [1e-4, 2.0**-23])
def test_a_cover_just_before_a_lamp_hides_it(first_device: Device, gap: float) -> None:
    """By a ten thousandth of the way, and by one float32: light ends on the lamp itself, not somewhere before it."""
    behind = FLAT_LAMP.moved(1, (0, 0, gap))
    assert np.float32(behind.positions[0, 2]) > np.float32(1.2)
    found = paths(first_device, assemble(floor(20, CHALK), behind, COVER), max_depth=0, samples=4)
    assert not found.any()


@pytest.mark.parametrize("lamp_first", [True, False])
def test_of_a_lamp_and_a_cover_in_one_plane_the_first_is_seen(first_device: Device, lamp_first: bool) -> None:
    """By light that is drawn as by rays: the smaller prim_id, wholly."""
    for depth in (0, 1):
        parts = (FLAT_LAMP, COVER) if lamp_first else (COVER, FLAT_LAMP)
        found = paths(first_device, assemble(*parts, floor(20, CHALK)), max_depth=depth)
        if lamp_first:
            check_floor(found, light_on_floor(CHALK, (FLAT_LAMP,)))
        else:
            assert found.max() < 1e-9, "what Schlick's term leaves of light along the cover"


@pytest.mark.parametrize("mode", ["shadow", "path"])
def test_a_light_on_a_surface_lights_the_side_that_it_is_on(first_device: Device, mode: str) -> None:
    """A point in the plane of a ceiling, and one that lies one float32 beyond it."""
    ceiling = square((-8, -8, 1.7), (0, 16, 0), (16, 0, 0), BLACK)
    height = float(np.float32(1.7))
    options = {"samples": 1, "max_depth": 0} if mode == "path" else {}
    for beyond, is_lit in ((0.0, True), (2.0**-22, False)):
        light = replace(LIGHT, position=(0.3, 0.2, height + beyond))
        frame = traced(first_device, assemble(floor(20, CHALK), ceiling, lights=(light,)), VIEW, mode, **options)
        assert ((color(frame) > 0).all(axis=2) == is_lit).all()


def test_polished_surfaces_send_on_one_brdf(first_device: Device) -> None:
    """A smooth dielectric: Lambert under a coat. Light that is drawn and light that is found see the same surface, so
    that a lamp of a given power brings the same whatever its share of being drawn: a second lamp that the floor does
    not see changes it."""
    coat = Material("coat", (0.8, 0.8, 0.8, 1.0), roughness=0.0)
    hidden = square((-5, -5, -3), (10, 0, 0), (0, 10, 0), replace(LAMP, emissive=(400.0, 400.0, 400.0)))
    grazing = looking(SIDE, (0.2, -6.0, 1.2), (0, 0, 0), 1 / 160)
    scenes = (assemble(floor(20, coat), OTHER_PART, *more) for more in ((), (hidden,)))
    alone, beside = (paths(first_device, scene, grazing, samples=256) for scene in scenes)
    for channel in range(3):
        assert_unbiased(alone[:, channel] - beside[:, channel], 0.2 * alone[:, channel].mean())
