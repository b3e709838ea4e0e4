"""Antialiasing among panes by lists: what lies behind samples, against plain renders by moved cameras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import open_first_device
from kernel_world import make_scene, orthographic, render, settings
from test_antialiasing import SIDE, U, colors_of, some_triangles, unlit
from test_shading_rate import ALL, FEW, check_rate

import clrast
from clrast.opencl.device import Device
from clrast.scene.model import Material

LISTED = {"aa": "auto:0.02", "aov": ("color", "id")}


def panes() -> clrast.Scene:
    """Triangles of one material each, two of three of which let some light through, and corners with colours."""
    rng, scene = np.random.default_rng(9), some_triangles()
    colors = np.concatenate([rng.uniform(0.1, 1.0, size=(90, 3)), rng.uniform(0.3, 1.0, size=(90, 1))], axis=1)
    materials = tuple(
        Material(str(k), (1.0, 1.0, 1.0, 0.75), unlit=True, alpha_mode="BLEND" if k % 3 else "OPAQUE")
        for k in range(30)
    )  # fmt: skip
    return replace(scene, colors=colors.astype(np.float32), materials=materials)


@pytest.mark.parametrize("rate", [FEW, ALL])
@pytest.mark.parametrize("mode", ["msaa:4", "msaa:32", "csaa:4+12"])
def test_shaded_samples_show_what_lies_behind_them(device: Device, mode: str, rate: str) -> None:
    scene = panes()
    found = check_rate(device, scene, mode, rate, 32 * U)
    opaque = render(device, scene, orthographic(SIDE, SIDE), aov=("color",), effects={"alpha blend": "off"})
    assert (colors_of(opaque) != found).any()


@pytest.mark.parametrize("error", [0.1, 0.01, 0.003])
def test_auto_is_nearer_than_as_many_samples_of_every_pixel(error: float) -> None:
    """Panes everywhere, many to a pixel: root mean squares against 1024 shaded samples of every pixel."""
    device, scene, view = open_first_device(), panes(), orthographic(SIDE, SIDE)
    reference = colors_of(render(device, scene, view, aov=("color",), aa="ssaa:1024"))
    frame = render(device, scene, view, aov=("color",), aa=f"auto:{error}")
    shaded = frame.stats["other_counts"]["samples_shaded"]
    each = render(device, scene, view, aov=("color",), aa=f"ssaa:{-(-shaded // (SIDE * SIDE))}")
    found, expected = (np.sqrt(np.mean((colors_of(other) - reference) ** 2)) for other in (frame, each))
    assert found < expected, f"{found:.4f} of {expected:.4f}, {shaded} samples"


CHANGES = (
    {"method": "3dr-full"}, {"method": "raycast-brute"}, {"method": "raycast-grid"}, {"precision": "double"},
    {"precision": "exact"}, {"counters": True}, {"vector_width": 1},
)  # fmt: skip


@pytest.mark.parametrize("change", CHANGES, ids=str)
def test_methods_and_rungs_list_the_same_layers(change: dict[str, object]) -> None:
    """Short numbers, where float32 is exact too: rungs that filter compare with what lies in front in their own way."""
    device, scene, view = open_first_device(), panes(), orthographic(SIDE, SIDE)
    expected = render(device, scene, view, method="3dr-binning", **LISTED)
    found = render(device, scene, view, **{"method": "3dr-binning", **LISTED, **change})
    for name in ("R", "G", "B", "A", "id.prim"):
        np.testing.assert_array_equal(found[name], expected[name], err_msg=f"{change} {name}")


def test_passes_behind_layers_are_no_samples() -> None:
    """Samples: the centres, those of the first visit everywhere, and the list's once more, layer 0 alone."""
    device, scene, view = open_first_device(), panes(), orthographic(SIDE, SIDE)
    given = {"aov": ("color",), "aa": "msaa:4", "shading_rate": FEW, "method": "3dr-binning"}
    frame = render(device, scene, view, **given)
    listed = frame.stats["other_counts"]["edge_pixels"]
    assert frame.stats["counts"]["samples"] == (1 + 4) * SIDE * SIDE + 4 * listed
    assert frame.stats["counts"]["passes"] > 1 + 4 + 4


def test_tiles_do_not_show_in_listed_layers(device: Device) -> None:
    scene, view = panes(), orthographic(SIDE, SIDE)
    with settings(tile_log2=3):
        expected = render(open_first_device(), scene, view, method="3dr-binning", **LISTED)
    found = render(device, scene, view, method="3dr-binning", **LISTED)
    for name in ("R", "G", "B", "A"):
        np.testing.assert_array_equal(found[name], expected[name], err_msg=name)


def test_tiles_without_a_front_are_not_walked() -> None:
    """A grid of opaque triangles with a pane before one of them: what lies behind is sought in its tile alone."""
    places = np.stack(np.meshgrid(np.arange(16.0), np.arange(16.0)), axis=-1).reshape(-1, 1, 2) * 8
    corners = np.concatenate([places + [[1, 1], [7, 1], [1, 7]], np.full((256, 3, 1), 5.0)], axis=-1)
    pane = np.array([[[1.0, 1.0, 2.0], [6.0, 1.0, 2.0], [1.0, 6.0, 2.0]]])
    corners = np.concatenate([corners, pane]) * [1.0, -1.0, -1.0]
    glass = Material("glass", (1.0, 1.0, 1.0, 0.5), unlit=True, alpha_mode="BLEND")
    ids = np.zeros(257, np.uint32)
    ids[-1] = 1
    scene = make_scene(corners, materials=(*unlit((0.5, 0.5, 0.5)), glass), material_ids=ids)
    setups = []
    for state in ("off", "on"):
        with settings(tile_log2=4):
            frame = render(
                open_first_device(), scene, orthographic(128, 128), aov=("color",), method="3dr-binning", counters=True,
                effects={"alpha blend": state},
            )  # fmt: skip
        setups.append(frame.stats["counts"]["setups"])
    assert frame.stats["counts"]["passes"] == 2
    assert setups[0] < setups[1] <= setups[0] + 5
