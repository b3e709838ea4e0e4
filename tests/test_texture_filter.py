"""Texture filtering: mip maps against numpy, filtered floors against many samples, and when it is called for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clrast import render
from clrast.errors import UsageError
from clrast.opencl import buffers
from clrast.opencl.device import Device
from clrast.scene.model import Camera, Material, Scene, Texture, TextureUse
from clrast.shading.effects import plan_effects
from clrast.shading.surfaces import SurfaceBuffers, level_sizes

EYE = Camera(eye=(0.0, 1.0, 0.0), look_at=(0.3, 0.8, -4.0), fov=60.0)


def linear_of(byte: np.ndarray) -> np.ndarray:
    """sRGB decoded, IEC 61966-2-1, float64."""
    c = byte / 255
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def floor(texels: np.ndarray, repeats: float, *, mipmap: bool = True, srgb: bool = True) -> Scene:
    """An unlit plane at y = 0, 200 units a side."""
    corners = np.array([[-100, 0, 100], [100, 0, 100], [100, 0, -100], [-100, 0, -100]], dtype=np.float32)
    use = TextureUse(0, transform=(repeats, 0.0, 0.0, 0.0, repeats, 0.0), mipmap=mipmap)
    return Scene(
        positions=corners,
        triangles=np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32),
        object_ids=np.zeros(2, np.uint32),
        material_ids=np.zeros(2, np.uint32),
        uv=np.array([[0, 1], [1, 1], [1, 0], [0, 0]], dtype=np.float32),
        materials=(Material(base_color=(1.0, 1.0, 1.0, 1.0), unlit=True, base_color_texture=use),),
        textures=(Texture("floor", texels, srgb),),
    )


def noise(width: int, height: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (height, width, 4), dtype=np.uint8)


def checker() -> np.ndarray:
    """(64, 64, 4) uint8, 8 x 8 squares of black and white."""
    squares = (np.indices((64, 64)) // 8).sum(axis=0) % 2
    return np.dstack([*[(255 * squares).astype(np.uint8)] * 3, np.full((64, 64), 255, np.uint8)])


@pytest.mark.parametrize(("width", "height"), [(8, 8), (16, 4), (7, 5), (1, 9), (1, 1)])
@pytest.mark.parametrize("srgb", [True, False])
def test_levels_are_means_of_the_level_before(device: Device, width: int, height: int, srgb: bool) -> None:
    scene = floor(noise(width, height), 1.0, srgb=srgb)
    packed = SurfaceBuffers(device, scene, plan_effects(scene, ("color",)), reads_uv=False)
    sizes = level_sizes(width, height, True)
    total = sum(w * h for w, h in sizes)
    texels = buffers.download(device, packed.buffers["texels"], np.uint8, (total, 4))
    first = 0
    for (w, h), (w2, h2) in zip(sizes, sizes[1:], strict=False):
        before = texels[first : first + w * h].reshape(h, w, 4).astype(np.float64)
        after = texels[first + w * h : first + w * h + w2 * h2].reshape(h2, w2, 4).astype(np.float64)
        light = np.dstack([linear_of(before[..., :3]) if srgb else before[..., :3] / 255, before[..., 3:] / 255])
        down, across = overlap(h, h2), overlap(w, w2)
        mean = np.einsum("ij,jkc,lk->ilc", down, light, across)
        # The nearest byte: a float32 mean may fall on the other side of the middle between two.
        codes = mean.copy()
        if srgb:
            c = mean[..., :3]
            codes[..., :3] = np.where(c <= 0.0031308, c * 12.92, 1.055 * c ** (1 / 2.4) - 0.055)
        assert np.abs(after - 255 * codes).max() <= 0.5 + 1e-3
        first += w * h


def overlap(size: int, smaller: int) -> np.ndarray:
    """(smaller, size) float64: share of each texel in each texel of the level after it; rows sum to 1."""
    edges = np.arange(smaller + 1) * size / smaller
    low = np.maximum(edges[:-1, None], np.arange(size)[None, :])
    high = np.minimum(edges[1:, None], np.arange(size)[None, :] + 1)
    shares = np.maximum(high - low, 0)
    return shares / shares.sum(axis=1, keepdims=True)


@pytest.mark.parametrize("repeats", [50.0, 400.0])
def test_a_slanted_floor_comes_near_many_samples(device: Device, repeats: float) -> None:
    scene = floor(checker(), repeats)
    size = (96, 64)
    shown = {}
    for name, options in {
        "reference": {"aa": "ssaa:256", "effects": {"derivatives": "off"}},
        "plain": {"effects": {"derivatives": "off"}},
        "filtered": {},
    }.items():
        shown[name] = render(scene, EYE, size=size, aov=("color", "id"), **options)["R"].astype(np.float64)
    hit = render(scene, EYE, size=size, aov=("id",))["id.prim"] != 0xFFFFFFFF
    whole = hit & np.roll(hit, 1, axis=0)  # not at the horizon, where the floor covers a part of a pixel
    error = {name: np.sqrt(np.mean((shown[name] - shown["reference"])[whole] ** 2)) for name in ("plain", "filtered")}
    assert error["plain"] > 0.15
    assert error["filtered"] < error["plain"] / 3


def test_what_is_magnified_is_not_touched(device: Device) -> None:
    scene = floor(noise(64, 64), 1.0)
    near = Camera(eye=(0.0, 1.0, 0.0), look_at=(0.0, 0.0, 0.0), up=(0.0, 0.0, -1.0), fov=60.0)
    with_filter = render(scene, near, size=(48, 32))
    without = render(scene, near, size=(48, 32), effects={"derivatives": "off"})
    assert np.array_equal(with_filter["R"], without["R"]) and with_filter["R"].std() > 0
    assert {e["name"]: e["on"] for e in with_filter.stats["effects"]}["derivatives"]


def test_a_file_or_the_user_calls_for_it(device: Device) -> None:
    plain = floor(checker(), 400.0, mipmap=False)
    assert not plan_effects(plain, ("color",))["derivatives"]
    assert plan_effects(floor(checker(), 1.0), ("color",))["derivatives"]
    assert not plan_effects(floor(checker(), 1.0), ("depth",))["derivatives"], "no texture is read"
    size = (48, 32)
    forced = render(plain, EYE, size=size, effects={"derivatives": "on"})["R"]
    assert np.array_equal(forced, render(floor(checker(), 400.0), EYE, size=size)["R"])
    assert not np.array_equal(forced, render(plain, EYE, size=size)["R"])
    untextured = replace(plain, materials=(Material(),), textures=())
    render(untextured, EYE, size=(8, 8), effects={"derivatives": "on"})
    with pytest.raises(UsageError):
        render(plain, EYE, size=(8, 8), effects={"derivatives": "perhaps"})


def test_supersampling_shares_the_footprint(device: Device) -> None:
    """Sixteen samples, each filtered over a sixteenth of the pixel, blur no more than sixteen without a filter."""
    scene = floor(checker(), 100.0)
    size = (96, 64)
    reference = render(scene, EYE, size=size, aa="ssaa:256", effects={"derivatives": "off"})["R"].astype(np.float64)
    errors = []
    for effects in ({}, {"derivatives": "off"}):
        found = render(scene, EYE, size=size, aa="ssaa:16", effects=effects)["R"].astype(np.float64)
        errors.append(np.sqrt(np.mean((found - reference) ** 2)))
    assert errors[0] < errors[1]
