"""The same bits of colour whatever a machine or a method does; other seeds, other bits; antialiasing in all modes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from kernel_world import settings, start
from mode_worlds import CHALK, GLASS, MIRROR, assemble, ball, color, cube, floor, looking, rays, square, traced

from clrast.errors import CapacityError
from clrast.image.frame import Frame
from clrast.opencl.device import VECTOR_WIDTHS, Device, open_device
from clrast.scene.model import Light, Material, Scene, Texture, TextureUse
from clrast.shading.integrator import Integrator

VIEW = replace(looking(40, (1.5, -4, 3), (0, 0, 0.6), 1 / 32))
LAMP = Material("lamp", (0.2, 0.2, 0.2, 1.0), emissive=(6.0, 4.0, 2.0))
PANE = Material("pane", (0.9, 0.2, 0.1, 0.4), alpha_mode="BLEND")
LIGHTS = (
    Light("p", "point", (9.0, 9.0, 9.0), (1.0, -2.0, 4.0)),
    Light("d", "directional", (0.5, 0.5, 1.0), direction=(-0.48, 0.6, -0.64)),
)


def everything() -> Scene:
    """Mirror, glass, a lamp, a pane, a leaf with holes, two lights and a sky."""
    texels = np.full((4, 4, 4), 255, dtype=np.uint8)
    texels[..., 3] = np.where(np.indices((4, 4)).sum(axis=0) % 2, 255, 0)
    leaf = Material("leaf", (0.2, 0.7, 0.1, 1.0), base_color_texture=TextureUse(0, nearest=True), alpha_mode="MASK")
    return assemble(
        floor(9, replace(CHALK, roughness=0.4)),
        ball(2, 0.6, MIRROR, smooth=True).moved(1, (-0.8, 0.2, 0.7)),
        cube(0.4, GLASS).moved(1, (0.7, -0.4, 0.5)),
        square((-1, -1, 2.5), (0, 1, 0), (1, 0, 0.2), LAMP),
        square((-0.2, -1.2, 0.1), (1.2, 0.3, 0), (0, 0.1, 1), PANE),
        square((0.6, 0.6, 0), (1, 0.3, 0), (0, 0.1, 1.5), leaf, uv=np.array([(0, 1), (1, 1), (1, 0), (0, 0)])),
        lights=LIGHTS, environment=(0.2, 0.3, 0.5), textures=(Texture("leaf", texels, srgb=False),),
    )  # fmt: skip


SCENE = everything()
PATHS = {"samples": 2, "max_depth": 3}


@pytest.fixture(scope="module")
def usual(first_device: Device) -> Frame:
    """Paths through everything, with vectors of one lane, in tiles of 32."""
    return traced(first_device, SCENE, VIEW, "path", **PATHS)


def assert_same(found: Frame, expected: Frame) -> None:
    for channel in "RGBAZ":
        np.testing.assert_array_equal(found[channel].view(np.uint32), expected[channel].view(np.uint32))
    assert rays(found) == rays(expected)


def test_the_scene_has_everything(usual: Frame) -> None:
    assert all(count > 100 for count in rays(usual).values()) and np.isfinite(color(usual)).all()
    on = {row["name"] for row in usual.stats["effects"] if row["on"]}
    assert len(on) == 11, "all but derivatives"


@pytest.mark.long
@pytest.mark.parametrize("width", [width for width in VECTOR_WIDTHS if width > 1])
def test_vector_widths(first_device: Device, usual: Frame, width: int) -> None:
    assert_same(traced(replace(first_device, vector_width=width), SCENE, VIEW, "path", **PATHS), usual)


def test_the_device_s_own_vector_width(first_device: Device) -> None:
    """And one: of a scene without masks, whose programs other tests build, too."""
    wide = open_device(first_device.runtime)
    assert_same(*(traced(each, EDGES, VIEW, "path", **PATHS) for each in (wide, first_device)))


def test_one_kernel_between_two_traces(first_device: Device, usual: Frame, monkeypatch: pytest.MonkeyPatch) -> None:
    """Gives the bits of the longer way, by light_hits.cl and scatter_rays.cl, in one lane and in several."""
    wide = open_device(first_device.runtime)
    short = traced(wide, EDGES, VIEW, "path", **PATHS)
    monkeypatch.setattr(Integrator, "_path_streams", lambda self: None)
    longer = traced(first_device, SCENE, VIEW, "path", **PATHS)
    assert_same(longer, usual)
    assert longer.stats["effect_costs"]["shadow"]["launches"] != usual.stats["effect_costs"]["shadow"]["launches"]
    assert_same(traced(wide, EDGES, VIEW, "path", **PATHS), short)


@pytest.mark.parametrize("threads", [1, 2])
def test_threads(first_device: Device, usual: Frame, threads: int) -> None:
    device = replace(open_device(first_device.runtime, threads), vector_width=1)
    assert_same(traced(device, SCENE, VIEW, "path", **PATHS), usual)


@pytest.mark.parametrize("method", ["raycast-bvh", pytest.param("3dr-full", marks=pytest.mark.long), "3dr-brute"])
def test_methods(first_device: Device, usual: Frame, method: str) -> None:
    assert_same(traced(first_device, SCENE, VIEW, "path", method=method, **PATHS), usual)


@pytest.mark.parametrize("mode", ["shadow", "whitted", "path"])
def test_accelerators(first_device: Device, mode: str) -> None:
    """What secondary rays walk through is named in the stats, and changes nothing: masks and panes are among it."""
    options = PATHS if mode == "path" else {}
    made = {name: traced(first_device, SCENE, VIEW, mode, accelerator=name, **options) for name in ("bvh", "grid")}
    assert_same(made["grid"], made["bvh"])
    assert sum(rays(made["grid"]).values()) > 500
    assert [frame.stats["accelerator"] for frame in made.values()] == ["bvh", "grid"]
    assert made["grid"].stats["method"] == made["bvh"].stats["method"]


@pytest.mark.parametrize("resolution", [1, 30])
def test_grids_of_any_resolution(first_device: Device, usual: Frame, resolution: int) -> None:
    options = {"accelerator": "grid", "grid_resolution": resolution, **PATHS}
    assert_same(traced(first_device, SCENE, VIEW, "path", **options), usual)


def test_tiles_and_chunks(first_device: Device, usual: Frame) -> None:
    with settings(4, 3):
        assert_same(traced(first_device, SCENE, VIEW, "path", **PATHS), usual)


def test_bands(first_device: Device, usual: Frame) -> None:
    """With so little memory that the image takes two bands: pixels have the numbers of their place in the image."""
    scene = replace(SCENE, materials=tuple(replace(each, alpha_mode="OPAQUE") for each in SCENE.materials))
    options: dict[str, Any] = {"mode": "path", "method": "3dr-binning", **PATHS}
    with settings(4):
        with pytest.raises(CapacityError, match="must be at least") as refused:
            start(first_device, scene, VIEW, memory=1, **options)
        least = int(str(refused.value).split()[-1])
        job, whole = start(first_device, scene, VIEW, **options)
        banded, found = start(first_device, scene, VIEW, memory=least, **options)
    assert job.band_count == 1 and banded.band_count > 1
    assert_same(found, whole)


def test_seeds(first_device: Device, usual: Frame) -> None:
    """The same seed gives the same bits again, others give others nearly everywhere, and the same picture."""
    again, other = (traced(first_device, SCENE, VIEW, "path", seed=seed, **PATHS) for seed in (0, 1))
    assert_same(again, usual)
    shaded = usual["A"] > 0
    differing = (color(other) != color(usual)).any(axis=2)[shaded]
    assert differing.mean() > 0.9
    for mode in ("shadow", "whitted"):
        first, second = (traced(first_device, SCENE, VIEW, mode, seed=seed) for seed in (0, 1))
        np.testing.assert_array_equal(color(first), color(second))


def test_paths_are_added_one_by_one(first_device: Device, usual: Frame) -> None:
    """Path k of a sample is the same however many follow: the mean of 4 is that of 2 and of two more."""
    four = traced(first_device, SCENE, VIEW, "path", samples=4, max_depth=3)
    twice = 2 * color(four).astype(np.float64) - color(usual)
    assert twice.min() > -1e-5 * color(four).max()


# --- antialiasing ----------------------------------------------------------------------------------

BODIES = (cube(0.7, CHALK).moved(1, (0, 0, 0.7)), ball(1, 0.5, MIRROR).moved(1, (0.9, -0.9, 0.5)))
EDGES = assemble(floor(3, CHALK), *BODIES, lights=LIGHTS)


def error_of(device: Device, mode: str, aa: str, exact: np.ndarray, **options: Any) -> float:
    found = color(traced(device, EDGES, VIEW, mode, aa=aa, **options)).astype(np.float64)
    return float(np.sqrt(((found - exact) ** 2).mean()))


@pytest.mark.parametrize("mode", ["shadow", "whitted"])
def test_antialiasing_converges(first_device: Device, mode: str) -> None:
    """More samples of a pixel, less error; those that share shading keep shadows' edges, and are no worse than none."""
    exact = color(traced(first_device, EDGES, VIEW, mode, aa="ssaa:64")).astype(np.float64)
    errors = {aa: error_of(first_device, mode, aa, exact) for aa in ("none", "ssaa:4", "ssaa:16")}
    assert errors["ssaa:16"] < 0.7 * errors["ssaa:4"] and errors["ssaa:4"] < 0.7 * errors["none"]
    for aa in ("msaa:4", "csaa:4+4", "auto:0.02"):
        assert error_of(first_device, mode, aa, exact) < errors["none"], aa


@pytest.mark.parametrize("aa", ["ssaa:4", "msaa:4", "auto:0.05"])
def test_paths_with_antialiasing(first_device: Device, aa: str) -> None:
    """The same mean as many samples bring, within what few paths of a pixel leave."""
    exact = color(traced(first_device, EDGES, VIEW, "path", aa="ssaa:16", samples=16, max_depth=2)).astype(np.float64)
    found = color(traced(first_device, EDGES, VIEW, "path", aa=aa, samples=8, max_depth=2, seed=3)).astype(np.float64)
    assert np.isfinite(found).all()
    # Pixels' errors: edges that few samples miss, and paths; the mean of 1600 pixels has a 40th of them.
    residuals = (found - exact).mean(axis=2)
    assert abs(residuals.mean()) < 5 * residuals.std() / 40
    assert residuals.std() < 0.2 * exact.std()
