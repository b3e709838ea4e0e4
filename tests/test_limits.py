"""What a view, a budget and a device cannot do is said in one line: what, where, and a mend that works."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from kernel_world import NO_HIT, make_scene, orthographic, perspective, render, start

import clrast
from clrast.errors import CapacityError, ClrastError, DeviceError, UsageError
from clrast.opencl.device import Device
from clrast.scene.camera import camera_vectors, frame_scene
from clrast.scene.model import Camera, Scene

TRIANGLE = [(-1, -1, -3), (1, -1, -3), (0, 1, -3)]


def said(error: pytest.ExceptionInfo[ClrastError]) -> str:
    """The message, which is one line."""
    text = str(error.value)
    assert text and "\n" not in text
    return text


# --- views -----------------------------------------------------------------------------------------


VIEW = Camera("north", eye=(1.0, 2.0, 3.0), look_at=(0.0, 0.0, 0.0))
TOO_WIDE = "must lie between 0 and 180 degrees"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"look_at": (1.0, 2.0, 3.0)}, r"eye equals look-at \(\(1.0, 2.0, 3.0\)\): move one"),
        ({"up": (-1.0, -2.0, -3.0)}, "is parallel to the view direction: choose another up"),
        ({"up": (2.0, 4.0, 6.0)}, "is parallel to the view direction: choose another up"),
        ({"up": (0.0, 0.0, 0.0)}, "up is 0,0,0: give a direction"),
        ({"fov": 0.0}, TOO_WIDE),
        ({"fov": 180.0}, TOO_WIDE),
        ({"fov": -30.0}, TOO_WIDE),
        ({"fov": math.nan}, TOO_WIDE),
        ({"eye": (math.inf, 0.0, 0.0)}, "eye is not finite: give three finite numbers"),
        ({"up": (math.nan, 0.0, 1.0)}, "up is not finite: give three finite numbers"),
        ({"projection": "orthographic", "height": 0.0}, "height 0.0 must be positive"),
        ({"projection": "orthographic", "height": -2.0}, "height -2.0 must be positive"),
        ({"projection": "orthographic", "height": math.inf}, "height inf must be positive"),
    ],
)
def test_views_that_are_none(change: dict, message: str) -> None:
    """Each names the camera, and is wrong usage (64); so it is when a render meets it."""
    camera = replace(VIEW, **change)
    with pytest.raises(UsageError, match=message) as error:
        camera_vectors(camera, 8, 8)
    assert "camera 'north'" in said(error) and error.value.exit_code == 64
    with pytest.raises(UsageError, match=message):
        clrast.render(make_scene(TRIANGLE), camera, size=(8, 8))


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_framing_a_point(device: Device, projection: str) -> None:
    """A scene without extent has a view all the same; what has no area is not seen."""
    point = make_scene([(1, 2, 3)] * 3)
    camera = frame_scene(point, 8, 8, projection)
    assert camera.look_at == (1.0, 2.0, 3.0) and camera.eye != camera.look_at
    frame = clrast.render(point, camera, size=(8, 8), aov="id", device=device.runtime)
    assert (frame["id.prim"] == NO_HIT).all()


# --- images ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("size", "message"),
    [
        ((0, 8), "--size 0 is out of range: give a whole number from 1 to 65535"),
        ((8, 65536), "--size 65536 is out of range: give a whole number from 1 to 65535"),
        ((65535, 65535), "--size 65535x65535 has 4294836225 pixels: at most 268435456 are allowed"),
    ],
)
def test_images_that_are_too_small_or_too_large(size: tuple[int, int], message: str) -> None:
    with pytest.raises(UsageError, match=re.escape(message)) as error:
        clrast.render(make_scene(TRIANGLE), size=size)
    assert said(error) == message


@pytest.mark.parametrize("size", [(65535, 1), (1, 65535)])
def test_the_longest_sides(device: Device, size: tuple[int, int]) -> None:
    """Bounds have 16 bits a side: the last pixel of 65535 is still found."""
    width, height = size
    view = orthographic(width, height)
    last = np.array([(width - 0.5, 0.5 - height, -2)])
    corners = last + np.array([(-0.25, -0.25, 0), (0.25, -0.25, 0), (0, 0.25, 0)])
    frame = render(device, make_scene(corners), view, aov="id")
    expected = np.full((height, width), NO_HIT)
    expected[-1, -1] = 0
    np.testing.assert_array_equal(frame["id.prim"], expected)


# --- budgets ---------------------------------------------------------------------------------------


def heap(count: int) -> Scene:
    """Large triangles, all in all tiles: lists take more than the image."""
    rng = np.random.default_rng(1)
    return make_scene(rng.normal(size=(count, 3, 3)) * 3 + (0, 0, -12))


@pytest.mark.parametrize(("count", "memory"), [(1, 1000), (3000, 390_000)])
def test_a_budget_that_is_too_small_names_one_that_is_not(device: Device, count: int, memory: int) -> None:
    """Exit 75 with both numbers; giving what it asks for leads to a render, after few more such answers at most."""
    scene, view = heap(count), perspective(32, 160)
    expected = render(device, scene, view, aov=("id", "depth"))
    for attempt in range(5):
        try:
            job, frame = start(device, scene, view, aov=("id", "depth"), memory=memory)
            break
        except CapacityError as error:
            assert error.exit_code == 75 and "\n" not in str(error)
            numbers = [int(number) for number in re.findall(r"\d+", str(error))]
            assert memory in numbers and max(numbers) > memory
            memory = max(numbers)
    else:
        pytest.fail(f"no end of answers: {memory}")
    assert attempt > 0 and job.bytes_device() <= memory
    for name in expected:
        np.testing.assert_array_equal(frame[name], expected[name])


def test_lists_grow_until_they_hold_everything(device: Device) -> None:
    """More references than the first guess of a buffer has room for, twice as many in a second frame."""
    view = perspective(64, 64)
    for count in (200, 2000):
        job, frame = start(device, heap(count), view, aov="id", repeat=0)
        assert job.tiles.read_reference_count() <= job.tiles.reference_capacity
        assert sum(len(found) for found in job.tiles.tile_lists()) == job.tiles.read_reference_count()
    assert job.tiles.reference_count > 1024


# --- devices ---------------------------------------------------------------------------------------


def test_a_device_that_is_not_there() -> None:
    """Exit 69, and what there is instead."""
    with pytest.raises(DeviceError, match="no OpenCL device matches 'abacus': there are 0:0") as error:
        clrast.render(make_scene(TRIANGLE), size=(8, 8), device="abacus")
    assert error.value.exit_code == 69 and said(error)


def test_options_that_do_not_exist() -> None:
    with pytest.raises(UsageError, match="there is no option 'sizes'") as error:
        clrast.render(make_scene(TRIANGLE), sizes=(8, 8))
    assert "did you mean size?" in said(error)
