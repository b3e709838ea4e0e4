"""The rungs `exact` and `double`: the exact answer at every sample, whatever the world, method, device or layout."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import reference as ref
from adversarial_worlds import FAMILIES, World, make_world
from kernel_world import NO_HIT, make_scene, orthographic, perspective, settings, start

from clrast.errors import CapacityError, DeviceError
from clrast.job import RenderJob
from clrast.opencl.device import Device
from clrast.scene.camera import CameraVectors
from clrast.scene.model import Material, Scene
from clrast.study.exact_visibility import exact_visibility
from clrast.visibility import settle
from clrast.visibility.methods import METHODS

PROJECTIONS = ["perspective", "orthographic"]
FEW_FAMILIES = ("short numbers", "on rays", "one ulp apart", "any exponent", "through the eye")
LONG_SEEDS = 120


@pytest.fixture(autouse=True)
def _no_stored_binaries(monkeypatch: pytest.MonkeyPatch) -> None:
    """Binaries of so many programs would push those of other tests out."""
    monkeypatch.setenv("CLRAST_CACHE_DIR", "off")


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


# --- the exact answer ------------------------------------------------------------------------------


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_every_method_sees_the_exact_triangle_at_every_sample(device: Device, projection: str) -> None:
    """All rungs of the ladder are needed: some samples go to float64, some to integers."""
    if device.runtime == "pocl":
        wrong, counts = faults(device, some_worlds(FAMILIES, projection, [1]), list(METHODS))
    else:
        wrong, counts = faults(device, some_worlds(FEW_FAMILIES, projection, [1]), ["3dr-binning", "3dr-full"])
    assert not wrong, "\n".join(wrong)
    assert counts["decided_exact"] > 100
    assert counts["decided_float64"] > 100 or not device.has_fp64


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_more_worlds_by_one_method(device: Device, projection: str) -> None:
    if device.runtime == "pocl":
        wrong, _ = faults(device, some_worlds(FAMILIES, projection, range(2, 8)), ["3dr-binning"])
    else:
        wrong, _ = faults(device, some_worlds(FAMILIES, projection, [2]), ["3dr-binning"])
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_incremental_evaluation_sees_the_same(device: Device, projection: str) -> None:
    methods = ["3dr-binning", "3dr-full"] if device.runtime == "pocl" else ["3dr-binning"]
    worlds = some_worlds(FAMILIES if device.runtime == "pocl" else FEW_FAMILIES, projection, [3])
    wrong, _ = faults(device, worlds, methods, evaluation="incremental")
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_integers_alone_see_the_same(device: Device, projection: str) -> None:
    """As on a device without float64: whatever float32 leaves open is for integers."""
    if not device.has_fp64:
        pytest.skip(f"{device.runtime} has no float64: every other test is this one there")
    worlds = some_worlds(FAMILIES, projection, [4])
    wrong, counts = faults(replace(device, has_fp64=False), worlds, ["3dr-binning", "3dr-full"])
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
    assert set(right.ravel().tolist()) > {0, 1, NO_HIT}
    job, found = shown(device, World("tiny", 0, scene, view))
    np.testing.assert_array_equal(found, right)
    assert job.contenders is not None and sum(job.contenders.counts.values()) > 0


@pytest.mark.long
@pytest.mark.parametrize("family", FAMILIES)
def test_ten_million_samples(device: Device, family: str) -> None:
    """Large views of many worlds, by a method that changes with the seed."""
    names, wrong, sample_count = list(METHODS), [], 0
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


LAYOUT_WORLDS = [("on rays", 11, "perspective"), ("coincident", 12, "orthographic")]


@pytest.mark.parametrize("of_world", LAYOUT_WORLDS)
def test_tiles_of_any_size(device: Device, of_world: tuple[str, int, str]) -> None:
    world, right = world_and_answer(*of_world)
    for tile_log2 in (3, 4, 6) if device.runtime == "pocl" else (4,):
        with settings(tile_log2):
            same_everywhere(device, world, right)


@pytest.mark.parametrize("vector_width", [1, 8, 16])
@pytest.mark.parametrize("of_world", LAYOUT_WORLDS)
def test_vectors_of_any_width(device: Device, of_world: tuple[str, int, str], vector_width: int) -> None:
    if device.runtime != "pocl":
        pytest.skip(f"{device.runtime} takes minutes to build for other widths than its own")
    for method in ("3dr-binning", "raycast-bvh"):
        same_everywhere(device, *world_and_answer(*of_world), vector_width=vector_width, method=method)


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_bands(device: Device, projection: str) -> None:
    """Ever smaller budgets: more bands, the same bits."""
    world, right = world_and_answer("fans", 13, projection, 200)
    budget, band_counts = same_everywhere(device, world, right).device_bytes, set()
    for share in (1.0, 0.9, 0.8, 0.7, 0.6, 0.5):
        try:
            band_counts.add(same_everywhere(device, world, right, memory=int(share * budget)).band_count)
        except CapacityError:
            break
    assert max(band_counts) > 1


@pytest.mark.parametrize("method", ["3dr-binning", "3dr-full"])
def test_a_list_that_is_too_short_grows(device: Device, monkeypatch: pytest.MonkeyPatch, method: str) -> None:
    world, right = world_and_answer("coincident", 12, "perspective")
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


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_masked_surfaces_let_the_exact_one_behind_be_seen(device: Device, projection: str) -> None:
    """Half of the triangles are under their cutoff: what is left is a world of its own."""
    leaf = Material("leaf", (1.0, 1.0, 1.0, 0.75), alpha_mode="MASK", alpha_cutoff=0.5)
    hole = Material("hole", (1.0, 1.0, 1.0, 0.25), alpha_mode="MASK", alpha_cutoff=0.5)
    for family in FEW_FAMILIES:
        for method in ("3dr-binning", "3dr-full") if device.runtime == "pocl" else ("3dr-binning",):
            world = with_materials(world_and_answer(family, 5, projection)[0], [leaf, hole, Material("wall")], 5)
            is_there = np.flatnonzero(world.scene.material_ids != 1).astype(np.uint32)
            with np.errstate(all="ignore"):
                kept = exact_ids(replace(world.scene, triangles=world.scene.triangles[is_there]), world.view)
            right = np.where(kept == NO_HIT, NO_HIT, is_there[np.where(kept == NO_HIT, 0, kept)])
            job, found = shown(device, world, method=method)
            assert job.plan["alpha mask"]
            assert (found == right).all(), f"{world} by {method}: {first_wrong(found, right)}"


def panes(count: int) -> list[Material]:
    """Materials whose colours tell the order of layers apart: each has a weight of its own in R, G and B."""
    rng = np.random.default_rng(8)
    return [
        Material(str(k), (*(float(c) for c in rng.uniform(0.1, 1, 3)), 0.5), alpha_mode="BLEND", unlit=True)
        for k in range(count)
    ]


@pytest.mark.parametrize("projection", PROJECTIONS)
@pytest.mark.parametrize("family", ["short numbers", "axis-aligned", "coincident", "one ulp apart", "on rays"])
def test_layers_come_in_the_exact_order(device: Device, family: str, projection: str) -> None:
    """Each pixel's hits from the slow reference, sorted by exact t and id, put together front to back."""
    world = make_world(family, 21, projection, 24)
    count = world.scene.triangle_count
    materials = panes(count)
    scene = replace(world.scene, materials=tuple(materials), material_ids=np.arange(count).astype(np.uint32))
    with np.errstate(all="ignore"):
        job, frame = start(device, scene, world.view, aov=("color", "id"), precision="exact")
    assert job.plan["alpha blend"]
    camera, triangles = ref.exact_camera(world.view.named()), ref.exact_triangles(scene.positions, scene.triangles)
    deepest = 0
    for j in range(world.view.height):
        for i in range(world.view.width):
            hits = [hit.prim_id for hit in ref.hits_at(triangles, camera, i, j)]
            deepest = max(deepest, len(hits))
            assert frame["id.prim"][j, i] == (hits[0] if hits else NO_HIT), (i, j)
            right = sum((0.5 ** (n + 1) * np.array(materials[k].base_color[:3]) for n, k in enumerate(hits)), np.zeros(3))
            found = [float(frame[c][j, i]) for c in "RGB"]
            np.testing.assert_allclose(found, right, rtol=1e-5, err_msg=f"{world} at {i, j}: {hits}")
    assert deepest > 2


# --- double ----------------------------------------------------------------------------------------


def test_double_needs_float64(device: Device) -> None:
    world, _ = world_and_answer("ordinary", 1, "perspective")
    with pytest.raises(DeviceError, match="no float64") as caught:
        shown(replace(device, has_fp64=False), world, precision="double")
    assert caught.value.exit_code == 69


@pytest.mark.parametrize("projection", PROJECTIONS)
@pytest.mark.parametrize("family", ["short numbers", "ordinary", "on centres", "axis-aligned", "slivers"])
def test_double_is_right_where_float64_is(device: Device, family: str, projection: str) -> None:
    """Where all products are short numbers, or no sample is within 2^-49 of an edge."""
    if not device.has_fp64:
        pytest.skip(f"{device.runtime} has no float64")
    for seed in (1, 2):
        world, right = world_and_answer(family, seed, projection)
        job, found = shown(device, world, precision="double")
        assert (found == right).all(), f"{world}: {first_wrong(found, right)}"
        assert job.contenders is not None and job.contenders.counts["decided_exact"] == 0
