"""The rungs `exact` and `double`: the exact answer at every sample, whatever the world, method, device or layout."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import reference as ref
from adversarial_worlds import FAMILIES, World, full_mantissas, make_world
from kernel_world import NO_HIT, make_scene, methods_on, orthographic, perspective, settings, start

from clrast.errors import CapacityError, DeviceError
from clrast.job import RenderJob
from clrast.opencl.device import Device
from clrast.scene.camera import CameraVectors
from clrast.scene.model import Material, Scene
from clrast.study.exact_visibility import exact_visibility
from clrast.visibility import settle
from clrast.visibility.methods import METHODS

PROJECTIONS = ["perspective", "orthographic"]
MAINLY_PERSPECTIVE = ["perspective", pytest.param("orthographic", marks=pytest.mark.long)]
"""To build the programs of one more setting takes seconds; every default test has both projections somewhere."""
FEW_FAMILIES = ("short numbers", "on rays", "one ulp apart", "any exponent", "through the eye")
TILE_METHODS = [name for name, row in METHODS.items() if row.tiles and row.oracles["binning"].setting != "never"]
"""They share one program here, since all edges are 3D in these rungs."""

LONG_SEEDS = 120


@cache
def world_and_answer(family: str, seed: int, projection: str | None, max_side: int = 70) -> tuple[World, np.ndarray]:
    """A world and the exact prim_id (height, width) of its samples."""
    world = make_world(family, seed, projection, max_side)
    with np.errstate(all="ignore"):
        return world, exact_ids(world.scene, world.view)


def exact_ids(scene: Scene, view: CameraVectors) -> np.ndarray:
    return exact_visibility(scene.positions, scene.triangles, view.named(), view.width, view.height).prim_id


def shown(device: Device, world: World, **options: Any) -> tuple[RenderJob, np.ndarray]:
    """The job and its prim_id, by default of the rung `exact`."""
    with np.errstate(all="ignore"):
        job, frame = start(device, world.scene, world.view, **{"aov": "id", "precision": "exact", **options})
    return job, frame["id.prim"]


def first_wrong(found: np.ndarray, right: np.ndarray) -> str:
    rows, columns = np.nonzero(found != right)
    i, j = columns[0], rows[0]
    return f"{len(rows)} wrong samples, ({i}, {j}) has {found[j, i]:#x} in place of {right[j, i]:#x}"


def faults(
    device: Device, worlds: Iterable[tuple[World, np.ndarray]], methods: Sequence[str], **options: Any
) -> tuple[list[str], dict[str, int]]:
    """Each world by each method: what is wrong, and the counts of the rungs added up."""
    wrong, counts = [], {"samples": 0, "decided_float64": 0, "contenders": 0, "decided_exact": 0}
    for world, right in worlds:
        for method in methods:
            job, found = shown(device, world, method=method, **options)
            if (found != right).any():
                wrong.append(f"{world} by {method}: {first_wrong(found, right)}")
            assert job.contenders is not None
            counts["samples"] += right.size
            for name, value in job.contenders.counts.items():
                counts[name] += value
    return wrong, counts


def some_worlds(families: Iterable[str], projection: str, seeds: Iterable[int]) -> Iterator[tuple[World, np.ndarray]]:
    return (world_and_answer(family, seed, projection) for seed in seeds for family in families)


@pytest.fixture
def builder(request: pytest.FixtureRequest, device: Device) -> Device:
    """A device for tests that build many programs: without --long only PoCL."""
    if device.runtime != "pocl" and not request.config.getoption("--long"):
        pytest.skip(f"{device.runtime} takes many seconds to build these programs: give --long")
    return device


# --- the exact answer ------------------------------------------------------------------------------


def test_methods_see_the_exact_triangle_at_every_sample(builder: Device) -> None:
    """All rungs of the ladder are needed: some samples go to float64, some to integers."""
    wrong, counts = faults(builder, some_worlds(FAMILIES, "perspective", [1]), [*TILE_METHODS, "3dr-full"])
    assert not wrong, "\n".join(wrong)
    assert counts["decided_exact"] > 100
    assert counts["decided_float64"] > 100 or not builder.has_fp64


@pytest.mark.long
@pytest.mark.parametrize("projection", PROJECTIONS)
@pytest.mark.parametrize("evaluation", ["direct", "incremental"])
def test_every_method_in_every_setting(device: Device, projection: str, evaluation: str) -> None:
    wrong, _ = faults(device, some_worlds(FAMILIES, projection, [1]), methods_on(device), evaluation=evaluation)
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_more_worlds_by_one_method(device: Device, projection: str) -> None:
    """Where a device has no float64 this is the test of integers alone."""
    seeds = range(2, 8) if device.runtime == "pocl" else [2]
    wrong, counts = faults(device, some_worlds(FAMILIES, projection, seeds), ["3dr-binning"])
    assert not wrong, "\n".join(wrong)
    assert counts["decided_exact"] > 100


@pytest.mark.parametrize("evaluation", ["incremental", pytest.param("direct", marks=pytest.mark.long)])
@pytest.mark.parametrize("projection", MAINLY_PERSPECTIVE)
def test_integers_alone_see_the_same(device: Device, projection: str, evaluation: str) -> None:
    """As on a device without float64: whatever float32 leaves open is for integers."""
    if not device.has_fp64:
        pytest.skip(f"{device.runtime} has no float64: every other test is this one there")
    worlds = some_worlds(FAMILIES, projection, [3, 4])
    wrong, counts = faults(replace(device, has_fp64=False), worlds, ["3dr-binning"], evaluation=evaluation)
    assert not wrong, "\n".join(wrong)
    assert counts["decided_float64"] == 0 and counts["decided_exact"] > 100


@pytest.mark.small
@pytest.mark.parametrize("projection", PROJECTIONS)
def test_a_tiny_world(device: Device, projection: str) -> None:
    """Here Oclgrind looks on; the answer comes from the slow reference."""
    positions = [(-4, -4, -4), (4, -4, -4), (0, 4, -4), (-4, 0, -4), (4, 0, -4), (0, -4, -4), (0, 0, -2), (4, 4, -6)]
    triangles = [(0, 1, 2), (3, 4, 5), (0, 4, 6), (3, 7, 1)]
    view = perspective(6, 5, d0=(-1, 1, -1), dx=(0.375, 0, 0), dy=(0, -0.375, 0))
    if projection == "orthographic":
        view = orthographic(6, 5, e0=(-4.5, 3.5, 0), ex=(1.5, 0, 0), ey=(0, -1.5, 0))
    scene = make_scene(positions, triangles)
    right, _, _ = ref.visible_triangles(scene.positions, scene.triangles, view.named(), 6, 5)
    assert set(right.ravel().tolist()) >= {0, 2, 3, NO_HIT}
    job, found = shown(device, World("tiny", 0, scene, view))
    np.testing.assert_array_equal(found, right)
    assert job.contenders is not None and sum(job.contenders.counts.values()) > 0


@pytest.mark.long
@pytest.mark.parametrize("family", FAMILIES)
def test_ten_million_samples(device: Device, family: str) -> None:
    """Large views of many worlds, by a method that changes with the seed."""
    names, wrong, sample_count = methods_on(device), [], 0
    for seed in range(100, 100 + LONG_SEEDS if device.runtime == "pocl" else 104):
        world = world_and_answer.__wrapped__(family, seed, None, 200)
        found, counts = faults(device, [world], [names[seed % len(names)]])
        wrong += found
        sample_count += counts["samples"]
    print(f"{family}: {sample_count} samples")
    assert not wrong, "\n".join(wrong)


# --- whatever the layout ---------------------------------------------------------------------------


def same_everywhere(device: Device, world: World, right: np.ndarray, **options: Any) -> RenderJob:
    job, found = shown(device, world, **options)
    np.testing.assert_array_equal(found, right)
    return job


LONG_LAYOUTS = [(1, 3), (1, 5), (1, 6), (8, 3), (8, 6), (16, 3), (16, 4), (16, 6)]
LAYOUTS = [(8, 4), *(pytest.param(*layout, marks=pytest.mark.long) for layout in LONG_LAYOUTS)]
"""Vector widths and tile sizes: 16 and 2^5 is what all other tests have on PoCL, 1 what Oclgrind has."""


@pytest.mark.parametrize(("vector_width", "tile_log2"), LAYOUTS)
@pytest.mark.parametrize("projection", MAINLY_PERSPECTIVE)
def test_vectors_and_tiles_of_any_size(device: Device, projection: str, vector_width: int, tile_log2: int) -> None:
    if device.runtime != "pocl":
        pytest.skip(f"{device.runtime} takes minutes to build for other widths than its own")
    assert device.vector_width == 16
    for family in FEW_FAMILIES:
        with settings(tile_log2):
            same_everywhere(device, *world_and_answer(family, 11, projection), vector_width=vector_width)


@pytest.mark.long
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("vector_width", [1, 8])
def test_every_method_with_every_width(device: Device, method: str, vector_width: int) -> None:
    if device.runtime != "pocl":
        pytest.skip(f"{device.runtime} takes minutes to build for other widths than its own")
    for family in FAMILIES:
        same_everywhere(device, *world_and_answer(family, 12, None), vector_width=vector_width, method=method)


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_bands(device: Device, projection: str) -> None:
    """Ever smaller budgets: more bands, the same bits."""
    world, right = world_and_answer("fans", 13, projection, 200)
    budget, band_counts = same_everywhere(device, world, right).bytes_device(), set()
    for share in (1.0, 0.9, 0.8, 0.7, 0.6, 0.5):
        try:
            band_counts.add(same_everywhere(device, world, right, memory=int(share * budget)).band_count)
        except CapacityError:
            break
    assert max(band_counts) > 1


@pytest.mark.parametrize("method", ["3dr-binning", pytest.param("3dr-full", marks=pytest.mark.long)])
def test_a_list_that_is_too_short_grows(device: Device, monkeypatch: pytest.MonkeyPatch, method: str) -> None:
    world, right = world_and_answer("any exponent", 2, "perspective")
    before = same_everywhere(device, world, right, method=method)
    monkeypatch.setattr(settle, "first_capacity", lambda pixel_count: 1)
    grown = same_everywhere(device, world, right, method=method)
    assert before.contenders is not None and grown.contenders is not None
    assert 1 < grown.contenders.counts["contenders"] <= grown.contenders.capacity < before.contenders.capacity
    assert grown.contenders.counts["contenders"] == before.contenders.counts["contenders"]


# --- alpha -----------------------------------------------------------------------------------------


def with_materials(world: World, materials: Sequence[Material], seed: int) -> World:
    """Each triangle with one of the materials."""
    count = world.scene.triangle_count
    ids = np.random.default_rng(seed).integers(0, len(materials), count).astype(np.uint32)
    return replace(world, scene=replace(world.scene, materials=tuple(materials), material_ids=ids))


@pytest.mark.long
@pytest.mark.parametrize("method", ["3dr-binning", "3dr-full"])
@pytest.mark.parametrize("projection", PROJECTIONS)
def test_masked_surfaces_let_the_exact_one_behind_be_seen(device: Device, projection: str, method: str) -> None:
    """Half of the triangles are under their cutoff: what is left is a world of its own."""
    leaf = Material("leaf", (1.0, 1.0, 1.0, 0.75), alpha_mode="MASK", alpha_cutoff=0.5)
    hole = Material("hole", (1.0, 1.0, 1.0, 0.25), alpha_mode="MASK", alpha_cutoff=0.5)
    for family in FEW_FAMILIES:
        world = with_materials(world_and_answer(family, 5, projection)[0], [leaf, hole, Material("wall")], 5)
        is_there = np.flatnonzero(world.scene.material_ids != 1).astype(np.uint32)
        with np.errstate(all="ignore"):
            kept = exact_ids(replace(world.scene, triangles=world.scene.triangles[is_there]), world.view)
        right = np.where(kept == NO_HIT, NO_HIT, is_there[np.where(kept == NO_HIT, 0, kept)])
        job, found = shown(device, world, method=method)
        assert job.plan["alpha mask"]
        assert (found == right).all(), f"{world} by {method}: {first_wrong(found, right)}"


def panes(count: int) -> list[Material]:
    """Materials whose colours tell the order of layers apart; every fifth is a hole."""
    rng = np.random.default_rng(8)
    colors = [(*(float(c) for c in rng.uniform(0.1, 1, 3)), 0.5) for _ in range(count)]
    made = [Material(str(k), color, alpha_mode="BLEND", unlit=True) for k, color in enumerate(colors)]
    hole = Material("hole", (1.0, 1.0, 1.0, 0.25), alpha_mode="MASK", alpha_cutoff=0.5)
    return [hole if k % 5 == 2 else pane for k, pane in enumerate(made)]


DEEP_WORLDS = [
    ("short numbers", 28, "perspective"),
    ("axis-aligned", 39, "perspective"),
    ("coincident", 23, "perspective"),
    ("one ulp apart", 32, "perspective"),
    ("on rays", 25, "perspective"),
    *(
        pytest.param(family, seed, "orthographic", marks=pytest.mark.long)
        for family, seed in [("axis-aligned", 39), ("coincident", 23), ("one ulp apart", 29), ("on rays", 25)]
    ),
]


@pytest.mark.parametrize(("family", "seed", "projection"), DEEP_WORLDS)
def test_layers_come_in_the_exact_order(builder: Device, family: str, seed: int, projection: str) -> None:
    """Each pixel's hits from the slow reference but for holes, sorted by exact t and id, put together front to back."""
    world = make_world(family, seed, projection, 24)
    count = world.scene.triangle_count
    materials = panes(count)
    scene = replace(world.scene, materials=tuple(materials), material_ids=np.arange(count).astype(np.uint32))
    with np.errstate(all="ignore"):
        job, frame = start(builder, scene, world.view, aov=("color", "id"), precision="exact")
    assert job.plan["alpha blend"] and job.plan["alpha mask"]
    camera, triangles = ref.exact_camera(world.view.named()), ref.exact_triangles(scene.positions, scene.triangles)
    deepest = 0
    for j in range(world.view.height):
        for i in range(world.view.width):
            hits = [hit.prim_id for hit in ref.hits_at(triangles, camera, i, j) if hit.prim_id % 5 != 2]
            deepest = max(deepest, len(hits))
            assert frame["id.prim"][j, i] == (hits[0] if hits else NO_HIT), (i, j)
            right = np.zeros(3)
            for n, k in enumerate(hits):
                right += 0.5 ** (n + 1) * np.array(materials[k].base_color[:3])
            found = [float(frame[c][j, i]) for c in "RGB"]
            np.testing.assert_allclose(found, right, rtol=1e-5, err_msg=f"{world} at {i, j}: {hits}")
    assert deepest > 3


# --- double ----------------------------------------------------------------------------------------


def test_double_needs_float64(device: Device) -> None:
    world, _ = world_and_answer("ordinary", 1, "perspective")
    with pytest.raises(DeviceError, match="no float64") as caught:
        shown(replace(device, has_fp64=False), world, precision="double")
    assert caught.value.exit_code == 69


@pytest.mark.parametrize("projection", MAINLY_PERSPECTIVE)
def test_double_is_right_where_float64_is(device: Device, projection: str) -> None:
    """Where all products are short numbers, or no sample is within 2^-49 of an edge."""
    if not device.has_fp64:
        pytest.skip(f"{device.runtime} has no float64")
    for family in ("short numbers", "ordinary", "on centres", "axis-aligned", "slivers"):
        for seed in (1, 2):
            world, right = world_and_answer(family, seed, projection)
            job, found = shown(device, world, precision="double")
            assert (found == right).all(), f"{world}: {first_wrong(found, right)}"
            assert job.contenders is not None and job.contenders.counts["decided_exact"] == 0


@pytest.mark.parametrize("projection", MAINLY_PERSPECTIVE)
def test_exact_is_right_where_float64_is_wrong(device: Device, projection: str) -> None:
    """Vertices exactly on sample rays, all mantissas full: float64 gets the sign of a V that is 0 by chance."""
    if not device.has_fp64:
        pytest.skip(f"{device.runtime} has no float64")
    wrong_count = 0
    for seed in range(4):
        world = full_mantissas(seed, projection)
        right = exact_ids(world.scene, world.view)
        _, found = shown(device, world)
        assert (found == right).all(), f"{world}: {first_wrong(found, right)}"
        _, double = shown(device, world, precision="double")
        wrong_count += int((double != right).sum())
    assert wrong_count > 0, "float64 gets everything right: the test tests nothing"
