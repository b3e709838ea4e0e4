"""The picture for people: tone curve, sRGB codes, and what a PNG shows of each group."""

from __future__ import annotations

import math

import numpy as np
import pytest

from clrast.image.exr import limit_threads
from clrast.image.frame import Frame
from clrast.image.png import picture
from clrast.image.tone import KNEE, srgb_bytes, tone_map


def test_tone_curve():
    def shown(*rgb: float) -> list[float]:
        return tone_map(np.array([[rgb]], np.float32))[0, 0].tolist()

    assert shown(0.0, KNEE, 0.5) == [0.0, KNEE, 0.5]
    assert shown(1.75, 0.0, 0.0) == pytest.approx([1 - 0.25**2 / 1.25, 0.0, 0.0], rel=2**-22)  # four roundings
    assert shown(math.inf, math.nan, -math.inf) == pytest.approx([1.0, 0.0, 0.0], rel=2**-22)
    assert shown(-1.0, 0.25, -0.0) == [0.0, 0.25, 0.0]
    bright = shown(4.0, 2.0, 1.0)
    assert bright[0] == 2 * bright[1] == 4 * bright[2]
    strengths = tone_map(np.geomspace(1e-3, 1e4, 2000, dtype=np.float32).reshape(1, -1, 1).repeat(3, axis=2))[0, :, 0]
    assert np.all(np.diff(strengths) > -(2**-23)) and strengths[-1] < 1.0  # rising, within a rounding
    assert np.all(np.diff(strengths[::10])[:150] > 0)


def test_srgb_codes():
    decoded = [c / 255 / 12.92 if c <= 10 else ((c / 255 + 0.055) / 1.055) ** 2.4 for c in range(256)]
    assert srgb_bytes(np.array(decoded, np.float32)).tolist() == list(range(256))
    assert srgb_bytes(np.array([0.5, 0.18, 0.214041, 2.0], np.float32)).tolist() == [188, 118, 127, 255]


def test_png_is_the_picture_without_a_date(tmp_path):
    from PIL import Image

    straight = np.array([[[0.5, 0.18, 0.0], [0.75, 0.25, 1.0]]], np.float32)
    alpha = np.array([[1.0, 0.5]], np.float32)
    planes = (straight * alpha[..., np.newaxis]).transpose(2, 0, 1)
    frame = Frame({"R": planes[0], "G": planes[1], "B": planes[2], "A": alpha})
    frame.save(tmp_path / "a.png")
    limit_threads(1)
    frame.save(tmp_path / "b.png")
    content = (tmp_path / "a.png").read_bytes()
    assert content == (tmp_path / "b.png").read_bytes()
    assert b"tIME" not in content and b"tEXt" not in content and b"Software" not in content
    pixels = np.asarray(Image.open(tmp_path / "a.png"))
    assert pixels[0, 0].tolist() == [188, 118, 0, 255]
    assert pixels[0, 1, 3] == 128 and np.array_equal(pixels, picture(frame))
    opaque = Frame({name: straight[:, 1:, k] for k, name in enumerate("RGB")})
    assert pixels[0, 1, :3].tolist() == picture(opaque)[0, 0].tolist()


def test_pictures_of_other_groups():
    z = np.array([[1.0, 2.0, 3.0, np.inf]], np.float32)
    assert picture(Frame({"Z": z}))[0, :, 0].tolist() == [255, 140, 26, 0]
    normal = {f"N.{axis}": np.array([[value, 0.0]], np.float32) for axis, value in zip("XYZ", (1.0, 0.0, -1.0))}
    assert picture(Frame(normal)).tolist() == [[[255, 128, 0], [0, 0, 0]]]
    ids = picture(Frame({"id.prim": np.array([[7, 7, 8, 4294967295]], np.uint32)}))[0].tolist()
    assert ids[0] == ids[1] != ids[2] and ids[3] == [0, 0, 0] and min(ids[2]) >= 64
    assert picture(Frame({"uv.U": z, "uv.V": z}))[0].tolist() == [[0, 0, 0], [128, 128, 0], [255, 255, 0], [0, 0, 0]]
