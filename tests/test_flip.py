"""FLIP, and the difference of two images as an image."""

from __future__ import annotations

import math

import flip_evaluator
import numpy as np
import pytest

import clrast
from clrast.errors import UsageError
from clrast.image.channel_diff import rounded_up
from clrast.image.diff import diff
from clrast.image.frame import Frame
from clrast.image.heatmap import BEYOND, HEAT, WITHIN, heat_colors


def image(**changes: float) -> Frame:
    """Colour, depth and ids of 10x8 pixels; `R=0.5` sets pixel (x=4, y=3) of a channel."""
    random = np.random.default_rng(5)
    channels = {name: random.random((8, 10), np.float32) for name in "RGBAZ"}
    channels["id.prim"] = random.integers(0, 100000, (8, 10)).astype(np.uint32)
    for name, value in changes.items():
        channels[name][3, 4] = value
    return Frame(channels)


def plane(value: float) -> Frame:
    return Frame({"Z": np.full((8, 10), value, np.float32)})


def srgb(value: float) -> float:
    return 12.92 * value if value <= 0.0031308 else 1.055 * value ** (1 / 2.4) - 0.055


def test_flip_is_that_of_its_package():
    random = np.random.default_rng(1)
    shape = (24, 32, 3)
    a, b = ((random.random(shape) * 0.7).astype(np.float32) for _ in range(2))  # below the knee of the tone curve
    pictures = [np.array([srgb(float(value)) for value in side.flat], np.float32).reshape(shape) for side in (a, b)]
    expected, mean, _ = flip_evaluator.evaluate(*pictures, "LDR", True, False, True, {})
    report = diff(*(Frame({name: side[..., k] for k, name in enumerate("RGB")}) for side in (a, b)))
    assert report.flip.mean == pytest.approx(mean, rel=1e-4)
    assert np.allclose(report.flip.map, expected[..., 0], atol=1e-3)
    y, x = np.unravel_index(report.flip.map.argmax(), report.flip.map.shape)
    assert report.flip.worst == (x, y) and report.flip.max == report.flip.map.max()


def test_flip_of_known_pairs():
    def grey(value: float) -> Frame:
        return Frame({name: np.full((16, 16), value, np.float32) for name in "RGB"})

    assert diff(image(), image()).flip.mean == 0.0
    assert diff(plane(0), plane(0)).flip is None
    black = np.zeros((16, 16, 3), np.float32)
    largest = flip_evaluator.evaluate(black, black + 1, "LDR")[1]
    assert diff(grey(0), grey(1e6)).flip.mean == pytest.approx(largest, abs=1e-5)
    assert diff(grey(2.0), grey(4.0)).flip.mean > 0.01  # highlights are not clipped
    limit = diff(grey(0.2), grey(0.21)).flip.mean
    assert diff(grey(0.2), grey(0.21), fail=1, fail_flip=limit).exit_code == 0
    failed = diff(grey(0.2), grey(0.21), fail=1, fail_flip=np.nextafter(limit, 0))
    assert failed.exit_code == 2 and failed.passes_with == ["--fail-flip", repr(rounded_up(limit))]
    with pytest.raises(UsageError, match="fail-flip"):
        diff(plane(0), plane(0), fail_flip=0.1)


# The difference image

def test_difference_images(tmp_path):
    reference, test = image(Z=1.0, R=0.25), image(Z=math.inf, R=0.75)
    test.channels["id.prim"][0, 1] += 1
    diff(reference, test, output=tmp_path / "d.exr")
    errors = Frame.load(tmp_path / "d.exr")
    assert errors["R"][3, 4] == 0.5 and errors["Z"][3, 4] == np.inf and errors["id.prim"][0, 1] == 1
    assert np.count_nonzero(errors["R"]) == np.count_nonzero(errors["id.prim"]) == 1 and errors["flip.Y"].max() > 0
    diff(reference, test, output=tmp_path / "d.png")
    heat = (Frame.load(tmp_path / "d.png")["R"] * 255).round()
    assert heat[3, 4] == 255 and heat[0, 1] == 255 and np.count_nonzero(heat) == 2
    assert clrast.diff(reference, reference, output=tmp_path / "same.png").equal and (tmp_path / "same.png").exists()
    diff(reference, reference, output=tmp_path / "none.png", output_only_different=True)
    assert not (tmp_path / "none.png").exists()
    report = diff(plane(1.0), Frame({"Z": np.ones((2, 2), np.float32)}), output=tmp_path / "sizes.png")
    assert not (tmp_path / "sizes.png").exists() and "sizes.png" in report.notes[-1]


def test_heat_colours():
    colors = heat_colors(np.array([[0.0, 0.5, 1.0, 1.0001, 1e3, 1e9, np.inf]]))[0].tolist()
    within, hot, hottest = list(WITHIN), list(HEAT[2][1:]), list(HEAT[3][1:])
    assert colors == [[0, 0, 0], within, within, [96, 0, 96], hot, hottest, list(BEYOND)]
