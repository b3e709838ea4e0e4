"""Textures, uv sets and vertex colours against glTF's and OpenGL's definitions, in float64."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import reference as ref
from kernel_world import NO_HIT, perspective, render
from panels import SIDE, panel, panel_scene, panel_view, pixel_uv

from clrast.opencl.device import Device
from clrast.scene.model import Material, Texture, TextureUse

ULP = 2.0**-23
WHITE = (1.0, 1.0, 1.0, 1.0)
WRAPS = ("repeat", "mirror", "clamp")
EFFECTS = {"textures": "on"}
"""On for all, so that one build serves all of these tests."""


def linear(code: int) -> float:
    """IEC 61966-2-1 of an 8-bit code."""
    c = code / 255
    return c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4


def albedo(frame) -> np.ndarray:
    """(height, width, 3) float32."""
    return np.stack([frame[f"albedo.{c}"] for c in "RGB"], axis=2)


def random_texture(seed: int, width: int, height: int, srgb: bool = False) -> Texture:
    texels = np.random.default_rng(seed).integers(0, 256, size=(height, width, 4), dtype=np.uint8)
    return Texture(f"random {seed}", texels, srgb)


def textured(texture: int = 0, **use: object) -> Material:
    return Material(f"texture {texture}", WHITE, base_color_texture=TextureUse(texture, **use))


# --- the reference: OpenGL's sampling, in float64 ---------------------------------------------------


def wrapped(i: np.ndarray, size: int, mode: str) -> np.ndarray:
    """Texel index of any integer: OpenGL 4.6, table 8.20 (repeat, mirrored repeat, clamp to edge)."""
    if mode == "repeat":
        return i % size
    if mode == "mirror":
        a = i % (2 * size) - size
        return (size - 1) - np.where(a >= 0, a, -(1 + a))
    return np.clip(i, 0, size - 1)


def sampled(texture: Texture, u: np.ndarray, v: np.ndarray, use: TextureUse) -> np.ndarray:
    """RGBA (..., 4) float64 at texture coordinates, bilinear or nearest (section 8.14.2)."""
    height, width = texture.texels.shape[:2]
    colors = texture.texels / 255.0
    if texture.srgb:
        colors[..., :3] = np.vectorize(linear)(texture.texels[..., :3])

    def texel(i: np.ndarray, j: np.ndarray) -> np.ndarray:
        return colors[wrapped(j, height, use.wrap_v), wrapped(i, width, use.wrap_u)]

    if use.nearest:
        return texel(np.floor(u * width).astype(int), np.floor(v * height).astype(int))
    x, y = u * width - 0.5, v * height - 0.5
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    a, b = (x - i)[..., None], (y - j)[..., None]
    upper = (1 - a) * texel(i, j) + a * texel(i + 1, j)
    lower = (1 - a) * texel(i, j + 1) + a * texel(i + 1, j + 1)
    return (1 - b) * upper + b * lower


def test_the_reference_at_known_places() -> None:
    """Two texels, 0 and 1, side by side: their centres are at 1/4 and 3/4, between them lies the mean."""
    texture = Texture("two", np.array([[[0, 0, 0, 0], [255, 255, 255, 255]]], dtype=np.uint8), srgb=False)
    u = np.array([0.25, 0.5, 0.75, 0.0, -0.25, 1.25])
    for wrap, expected in (
        ("repeat", [0, 0.5, 1, 0.5, 1, 0]),
        ("mirror", [0, 0.5, 1, 0, 0, 1]),
        ("clamp", [0, 0.5, 1, 0, 0, 1]),
    ):
        assert sampled(texture, u, u, TextureUse(0, wrap_u=wrap))[:, 0].tolist() == expected


# --- texels ----------------------------------------------------------------------------------------


@pytest.mark.small
def test_every_srgb_code(device: Device) -> None:
    """One texel a pixel, nearest: the curve of the standard, rounded once to float32."""
    codes = np.arange(256, dtype=np.uint8).reshape(16, 16)
    texels = np.stack([codes, 255 - codes, codes ^ 0x55, np.full_like(codes, 7)], axis=2)
    scene = panel_scene([textured(nearest=True)], textures=(Texture("codes", texels),))
    found = albedo(render(device, scene, panel_view(1), aov="albedo", effects=EFFECTS))
    expected = np.vectorize(linear)(texels[..., :3]).astype(np.float32)
    np.testing.assert_array_equal(found, expected)


def test_every_linear_code(device: Device) -> None:
    """code / 255 to an ulp."""
    codes = np.arange(256, dtype=np.uint8).reshape(16, 16)
    texels = np.stack([codes, 255 - codes, codes ^ 0x55, codes], axis=2)
    scene = panel_scene([textured(nearest=True)], textures=(Texture("codes", texels, srgb=False),))
    found = albedo(render(device, scene, panel_view(1), aov="albedo", effects=EFFECTS))
    np.testing.assert_allclose(found, texels[..., :3] / 255.0, rtol=ULP)


SHAPES = [(4, 4), (5, 3), (1, 1), (2, 1), (16, 16)]
RANGE = (-1.75, 2.25, 2.5, -1.5)
"""Of u and v: through all repetitions; v runs upwards."""


@pytest.mark.parametrize("srgb", [False, True])
@pytest.mark.parametrize("is_nearest", [False, True])
def test_lookups_and_wraps(device: Device, is_nearest: bool, srgb: bool) -> None:
    """Nine pairs of wrap modes, textures of several shapes, side by side in one render.

    Coordinates are exact; u * width has the error u |width|, folding and fractions as much again, and the
    filter moves by 1 at most a texel: 3 * 16 u for each of two axes, and 8u for the sums.
    """
    textures = tuple(random_texture(k, *shape, srgb) for k, shape in enumerate(SHAPES))
    uses = [
        TextureUse(k, wrap_u=a, wrap_v=b, nearest=is_nearest) for k in range(len(SHAPES)) for a in WRAPS for b in WRAPS
    ]
    # Nearest: off the texels' borders, where 5/256 more or less decide nothing.
    shift = 5 / 256 if is_nearest else 0.0
    ranges = tuple(c + shift for c in RANGE)
    materials = [Material(str(use), WHITE, base_color_texture=use) for use in uses]
    scene = panel_scene(materials, [ranges] * len(uses), textures=textures)
    found = albedo(render(device, scene, panel_view(len(uses)), aov="albedo", effects=EFFECTS))
    u, v = pixel_uv(ranges)
    tolerance = ULP if is_nearest else 104 * 2.0**-24
    for k, use in enumerate(uses):
        expected = sampled(textures[use.texture], u, v, use)[..., :3]
        assert is_nearest is False or not ((u * 240) % 1 == 0).any()
        np.testing.assert_allclose(panel(found, k), expected, rtol=0, atol=tolerance, err_msg=str(use))


def test_rows_begin_at_the_top(device: Device) -> None:
    """v = 0 is row 0 of the image, and v grows downwards: with uv from 0 to 1 the picture stands upright."""
    texture = random_texture(9, SIDE, SIDE)
    scene = panel_scene([textured(nearest=True)], textures=(texture,))
    found = albedo(render(device, scene, panel_view(1), aov="albedo", effects=EFFECTS))
    np.testing.assert_allclose(found, texture.texels[..., :3] / 255.0, rtol=ULP)


@pytest.mark.parametrize("rotation", [0, 1, 2])
def test_the_order_of_vertices_changes_no_lookup(device: Device, rotation: int) -> None:
    texture = random_texture(9, SIDE, SIDE)
    scene = panel_scene([textured(nearest=True)], textures=(texture,), rotation=rotation)
    frame = render(device, scene, panel_view(1), aov=("albedo", "uv", "bary"), effects=EFFECTS)
    np.testing.assert_allclose(albedo(frame), texture.texels[..., :3] / 255.0, rtol=ULP)
    u, v = pixel_uv((0, 1, 0, 1))
    np.testing.assert_array_equal(frame["uv.U"], u.astype(np.float32))
    np.testing.assert_array_equal(frame["uv.V"], v.astype(np.float32))


# --- coordinates -----------------------------------------------------------------------------------


def test_transforms_and_uv_sets(device: Device) -> None:
    """Each material through its own 2x3 matrix (KHR_texture_transform's order: scale, turn, shift) and uv set."""
    texture = random_texture(10, 8, 8)
    quarter = (0.0, 1.0, 0.25, -1.0, 0.0, 1.0)
    stretched = (2.0, 0.0, -0.5, 0.0, 0.5, 0.125)
    skewed = (1.0, 0.25, 0.0, 0.5, 1.0, 0.0)
    uses = [
        TextureUse(0, uv_set, matrix, nearest=False)
        for uv_set in (0, 1)
        for matrix in (quarter, stretched, skewed)
    ]
    first, second = (0.0, 1.0, 0.0, 1.0), (3.0, -1.0, 0.25, 0.75)
    materials = [Material(str(use), WHITE, base_color_texture=use) for use in uses]
    scene = panel_scene(materials, [first] * 6, textures=(texture,))
    scene = replace(scene, uv1=panel_scene(materials, [second] * 6).uv)
    found = albedo(render(device, scene, panel_view(6), aov="albedo", effects=EFFECTS))
    for k, use in enumerate(uses):
        u, v = pixel_uv(second if use.uv_set else first)
        m = use.transform
        expected = sampled(texture, m[0] * u + m[1] * v + m[2], m[3] * u + m[4] * v + m[5], use)[..., :3]
        np.testing.assert_allclose(panel(found, k), expected, rtol=0, atol=104 * 2.0**-24, err_msg=str(use))


def test_a_second_uv_set_that_is_missing_is_the_first(device: Device) -> None:
    texture = random_texture(11, 4, 4)
    scene = panel_scene([textured(uv_set=1)], textures=(texture,))
    found = albedo(render(device, scene, panel_view(1), aov="albedo", effects=EFFECTS))
    expected = sampled(texture, *pixel_uv((0, 1, 0, 1)), TextureUse(0))[..., :3]
    np.testing.assert_allclose(found, expected, rtol=0, atol=104 * 2.0**-24)


def test_coordinates_that_are_no_numbers_or_huge_do_no_harm(device: Device) -> None:
    """NaN, Inf and 1e30 in a file: some texel of the texture, never NaN."""
    scene = panel_scene([textured()] * 3, textures=(random_texture(12, 4, 4),))
    uv = scene.uv.copy()
    uv[0], uv[5], uv[10] = (np.nan, 0.5), (np.inf, -np.inf), (1e30, -1e30)
    frame = render(device, replace(scene, uv=uv), panel_view(3), aov=("albedo", "uv"), effects=EFFECTS)
    found = albedo(frame)
    assert np.isfinite(found).all() and (found >= 0).all() and (found <= 1).all()
    assert np.isfinite(frame["uv.U"]).all() and np.isfinite(frame["uv.V"]).all()


@pytest.mark.small
def test_without_texture_coordinates_uv_is_zero(device: Device) -> None:
    scene = replace(panel_scene([textured()], textures=(random_texture(13, 2, 2),)), uv=None)
    frame = render(device, scene, panel_view(1), aov=("albedo", "uv"), effects=EFFECTS)
    assert not frame["uv.U"].any() and not frame["uv.V"].any()
    expected = sampled(scene.textures[0], np.zeros(1), np.zeros(1), TextureUse(0))[0, :3]
    np.testing.assert_allclose(albedo(frame)[5, 5], expected, rtol=0, atol=8 * 2.0**-24)


def test_perspective_is_undone(device: Device) -> None:
    """A slanted panel in perspective: uv is linear over the surface, not over the screen."""
    view = perspective(48, 32)
    points = [(-1, 1, -1), (1, 1, -2), (1, -1, -2.5), (-1, -1, -1)]
    scene = replace(panel_scene([Material(base_color=WHITE)]), positions=np.array(points, dtype=np.float32))
    frame = render(device, scene, view, aov=("uv", "id"), effects=EFFECTS)
    camera, triangles = ref.exact_camera(view.named()), ref.exact_triangles(scene.positions, scene.triangles)
    corners = [[ref.Fraction(float(c)) for c in row] for row in scene.uv]
    checked = 0
    for j, i in np.argwhere(frame["id.prim"] != NO_HIT)[::7].tolist():
        hit = ref.hits_at(triangles, camera, i, j)[0]
        owners = scene.triangles[hit.prim_id].tolist()
        exact = [sum(b * corners[k][c] for b, k in zip(hit.bary, owners, strict=True)) for c in range(2)]
        # Each V_i has at most 20u of relative error in this view, and uv is at most 1.
        assert abs(frame["uv.U"][j, i] - float(exact[0])) < 64 * 2.0**-24
        assert abs(frame["uv.V"][j, i] - float(exact[1])) < 64 * 2.0**-24
        checked += 1
    assert checked > 50
    # The panel reaches from -1 to 1/2 on the screen; halfway, at -1/4, u is not 1/2 but nearer to 1/3.
    assert abs(frame["uv.U"][16, 16] - 1 / 3) < 0.05


# --- colours ---------------------------------------------------------------------------------------


def test_factor_texture_and_vertex_colour_multiply(device: Device) -> None:
    """Exactly: a corner's weight is a multiple of 1/32, and all factors are short numbers."""
    grey = Texture("grey", np.full((1, 1, 4), 255, dtype=np.uint8), srgb=False)
    material = Material("mixed", (0.5, 0.25, 2.0, 0.5), base_color_texture=TextureUse(0))
    scene = panel_scene([material], textures=(grey,))
    colors = np.array([(1, 0, 0, 1), (0, 1, 0, 1), (0, 0, 1, 0.5), (1, 1, 1, 1)], dtype=np.float32)
    found = albedo(render(device, replace(scene, colors=colors), panel_view(1), aov="albedo", effects=EFFECTS))
    share = (np.arange(SIDE) + 0.5) / SIDE
    x, y = np.meshgrid(share, share)
    # Upper right triangle (y <= x): weights 1 - x, x - y, y of corners 0, 1, 2; lower left: 1 - y, x, y - x of 0, 2, 3.
    upper = np.stack([1 - x, x - y, y], axis=2)
    lower = np.stack([(1 - y) + (y - x), y - x, x + (y - x)], axis=2)
    expected = np.where((y < x)[..., None], upper, lower) * material.base_color[:3]
    inside = abs(x - y) > 1e-9
    np.testing.assert_allclose(found[inside], expected[inside], rtol=0, atol=ULP)
    assert found[0, SIDE - 1].tolist() == pytest.approx((0.5 / 32, 0.25 * 30 / 32, 2 / 32))


@pytest.mark.small
def test_plain_factors_are_exact(device: Device) -> None:
    """Without texture and vertex colours the base colour is the factor, bit for bit."""
    colors = [(0.1, 0.2, 0.3, 1.0), (0.0, 1.0, 7.5, 0.25), (0.8, 0.8, 0.8, 1.0)]
    scene = panel_scene([Material(str(color), color) for color in colors])
    found = albedo(render(device, scene, panel_view(3), aov="albedo", effects=EFFECTS))
    for k, color in enumerate(colors):
        assert (panel(found, k) == np.array(color[:3], dtype=np.float32)).all()


@pytest.mark.small
def test_effects_that_are_asked_for_without_cause_change_nothing(device: Device) -> None:
    """No normals, no texture, no light that emits: switched on all the same, nothing is read out of bounds."""
    scene = replace(panel_scene([Material("plain", (0.5, 0.25, 0.125, 1.0))]), uv=None)
    names = ("textures", "normal interpolation", "emission", "alpha mask", "alpha blend")
    on, auto = (
        render(device, scene, panel_view(1), aov="all", effects={name: state for name in names})
        for state in ("on", "auto")
    )
    for name in auto:
        np.testing.assert_array_equal(on[name], auto[name], err_msg=name)
    assert math.isclose(float(auto["R"][3, 3]), 0.5)
