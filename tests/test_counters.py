"""Counters against closed forms: what was set up, evaluated, tested and written; off, they are not there at all."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from continuum_world import ROWS, differences, glass_and_leaves, images, oblique, soup
from kernel_world import NO_HIT, make_scene, methods_on, orthographic, start

from clrast import job_choices
from clrast.job import RenderJob
from clrast.opencl import kernels
from clrast.opencl.device import Device
from clrast.opencl.layout import EMPTY_CHILD, LARGE_BLOCK_COUNT, MIN_FRUSTUM_LOG2, WORK_COUNTERS
from clrast.scene.model import Scene
from clrast.study.exact_visibility import exact_visibility
from clrast.visibility.loop_limits import loop_limit
from clrast.visibility.methods import resolve_method

SIDE = 64
VIEW = orthographic(SIDE, SIDE)
"""A pixel is a unit, the sample (x, y) lies at world (x, -y)."""

BLOCKS = {16: (4, 4), 8: (4, 2), 1: (1, 1)}
"""Vector width -> columns and rows of a block of samples."""

STEEP = pytest.mark.xfail(
    strict=True,
    reason="planes of thin triangles are taken to the corners of their bounds: nodes seem to lie before the wall",
)

COUNTED = ("setups", "edge_evaluations", "traversal_steps", "intersection_tests")
COUNTED_TOO = ("samples_covered", "samples_written", "frusta_split", "blocks_culled", "nodes_culled")


def squares(*depths: float) -> Scene:
    """Squares over the whole view, each of two triangles that share its diagonal."""
    corners = [[(0, 0, -d), (SIDE, 0, -d), (SIDE, -SIDE, -d), (0, -SIDE, -d)] for d in depths]
    first = 4 * np.arange(len(depths))[:, None]
    return make_scene(np.array(corners), np.concatenate([first + (0, 1, 2), first + (0, 2, 3)], axis=1).reshape(-1, 3))


def counts(device: Device, scene: Scene, method: str, **options: Any) -> tuple[RenderJob, dict[str, int]]:
    """The job, and all that it counted."""
    job, frame = start(device, scene, VIEW, aov=("id",), method=method, counters=True, **options)
    return job, {**frame.stats["counts"], **frame.stats["other_counts"]}


def root_count(job: RenderJob) -> int:
    """Tiles or root frusta of the view."""
    return max(1, SIDE >> job.tile_log2) ** 2


def children_of_root(job: RenderJob) -> int:
    assert job.geometry.bvh is not None and job.geometry.bvh.depth == 1
    return int((job.geometry.bvh.children[0] != EMPTY_CHILD).sum())


def covered(scene: Scene) -> np.ndarray:
    """(triangle_count, SIDE, SIDE) bool, exactly: what each triangle covers alone."""
    alone = (scene.triangles[k : k + 1] for k in range(scene.triangle_count))
    return np.stack([exact_visibility(scene.positions, k, VIEW.named(), SIDE, SIDE).prim_id != NO_HIT for k in alone])


# --- closed forms ----------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["3dr-brute", "raycast-brute", "raycast-bvh"])
def test_without_binning_every_sample_of_a_bound_is_tested(device: Device, method: str) -> None:
    """Two triangles that cover the view between them, whose bounds are all of it."""
    job, found = counts(device, squares(2.0), method)
    assert found["edge_evaluations"] == found["intersection_tests"] == 2 * SIDE * SIDE
    assert found["samples_covered"] == found["samples_written"] == found["hits"] == SIDE * SIDE
    assert found["setups"] == 2 * root_count(job)
    assert found["frusta_split"] == found["blocks_culled"] == found["nodes_culled"] == 0
    steps = root_count(job) * children_of_root(job) if method == "raycast-bvh" else 0
    assert found["traversal_steps"] == steps
    assert (found["triangles"], found["samples"], found["passes"]) == (2, SIDE * SIDE, 1)


def blocks_that_may_be_hit(width: int) -> int:
    """Of the two triangles of a square, one after the other: blocks that neither edges nor early w drop.

    The diagonal runs through the samples i = j; a block is dropped where its innermost sample is beyond it, or where
    the triangle before covers all of it: both lie at the same depth.
    """
    columns, rows = BLOCKS[width]
    i, j = np.meshgrid(np.arange(SIDE), np.arange(SIDE))
    first = covered(squares(2.0))[0]

    def blocks(image: np.ndarray) -> np.ndarray:
        return image.reshape(SIDE // rows, rows, SIDE // columns, columns).swapaxes(1, 2)

    upper = blocks(i - j).max(axis=(2, 3)) >= 0
    lower = blocks(j - i).max(axis=(2, 3)) >= 0
    return int(upper.sum() + (lower & ~blocks(first).all(axis=(2, 3))).sum())


def test_binning_tests_blocks_before_their_samples(device: Device) -> None:
    job, found = counts(device, squares(2.0), "3dr-binning")
    width = device.vector_width
    all_blocks = 2 * SIDE * SIDE // width
    assert all_blocks // 2 // root_count(job) > LARGE_BLOCK_COUNT, "tiles are too small for blocks to be tested"
    kept = blocks_that_may_be_hit(width)
    assert found["edge_evaluations"] == all_blocks + kept * width
    assert found["intersection_tests"] == kept * width
    assert found["blocks_culled"] == all_blocks - kept
    assert found["samples_covered"] - found["samples_written"] == 0 and found["samples_written"] == SIDE * SIDE
    assert (found["setups"], found["tile_references"]) == (2 * root_count(job),) * 2
    assert found["traversal_steps"] == 0


@pytest.mark.parametrize("frustum", [8, 64])
def test_splitting_at_once_ends_at_the_smallest_frusta(device: Device, frustum: int) -> None:
    """1 + 4 + 16 frusta a root of 64 x 64 and child of the one node; each child is tested once, before it splits."""
    oracle = ("split_frustum=always", "is_occluded=never", f"frustum={frustum}")
    job, found = counts(device, squares(2.0), "3dr-full", oracle=oracle)
    splits = max(0, job.tile_log2 - MIN_FRUSTUM_LOG2)
    assert found["frusta_split"] == root_count(job) * children_of_root(job) * (4**splits - 1) // 3
    assert found["traversal_steps"] == root_count(job) * children_of_root(job)
    assert found["setups"] == 2 * (SIDE >> MIN_FRUSTUM_LOG2) ** 2
    assert (frustum == 8) == (found["frusta_split"] == 0)


def test_a_triangle_is_set_up_once_in_each_root_that_its_bound_touches(device: Device) -> None:
    """Through all leaves of a tree, where nothing is dropped but what lies outside."""
    scene = make_scene(soup(9, 200) * (20, 20, 1) + (32, -32, -9))
    job, found = counts(device, scene, "3dr-full", oracle=("is_occluded=never", "split_frustum=never"))
    x0, y0, x1, y1 = job.tiles.bounds.read().T
    side = 1 << job.tile_log2
    touched = (-(-x1 // side) - x0 // side) * (-(-y1 // side) - y0 // side)
    assert found["setups"] == touched.sum() > 100 and found["hits"] > 1000


@pytest.mark.parametrize("order", ["front to back", "back to front"])
def test_writes_depend_on_the_order_and_tests_do_not(device: Device, order: str) -> None:
    """Five squares behind one another, each sample of each covered: a loop over triangles writes what is nearer."""
    depths = np.arange(5) + 2.0
    _, found = counts(device, squares(*(depths if order == "front to back" else depths[::-1])), "3dr-brute")
    assert found["samples_covered"] == 5 * SIDE * SIDE and found["edge_evaluations"] == 10 * SIDE * SIDE
    assert found["samples_written"] == SIDE * SIDE * (1 if order == "front to back" else 5)


def test_covered_samples_are_those_of_real_arithmetic(device: Device) -> None:
    """Triangles of short numbers, whose edge functions round nothing, one by one."""
    rng = np.random.default_rng(3)
    depth = rng.integers(2, 9, size=(6, 1, 1))
    scene = make_scene(rng.integers(0, 2 * SIDE, size=(6, 3, 3)) * (0.5, -0.5, 0) - depth * (0, 0, 1))
    exact = covered(scene)
    _, found = counts(device, scene, "3dr-brute")
    assert found["samples_covered"] == exact.sum() > 1000
    assert found["hits"] == exact.any(axis=0).sum()


def hidden_heap(count: int, steepness: float) -> Scene:
    """Small triangles behind a wall of two that comes last in the file. steepness : change of depth per pixel."""
    rng = np.random.default_rng(4)
    center = rng.uniform(0, SIDE, size=(count, 1, 3)) * (1, -1, -0.5) - (0, 0, 4)
    small = center + rng.uniform(-3, 3, size=(count, 3, 3)) * (1, 1, steepness)
    wall = squares(2.0)
    return make_scene(np.concatenate([small, wall.positions[wall.triangles]]))


@pytest.mark.parametrize("steepness", [0.01, pytest.param(0.1, marks=STEEP)])
def test_what_a_wall_hides_costs_next_to_nothing(device: Device, steepness: float) -> None:
    """Nearest first and occlusion culling against the order of the file, where the wall comes last."""
    scene = hidden_heap(2000, steepness)
    _, full = counts(device, scene, "3dr-full")
    _, binning = counts(device, scene, "3dr-binning")
    assert full["hits"] == binning["hits"] == SIDE * SIDE
    assert full["edge_evaluations"] <= binning["edge_evaluations"] // 2
    assert full["setups"] <= binning["setups"] // 2 and full["nodes_culled"] > 0
    _, never = counts(device, scene, "3dr-full", oracle=("is_occluded=never",))
    assert never["setups"] > 2 * full["setups"] and never["traversal_steps"] >= full["traversal_steps"]


# --- costs of samples ------------------------------------------------------------------------------

COSTS = ("cost.edge_evaluations", "cost.setups", "cost.traversal_steps")


@pytest.mark.parametrize("method", ["3dr-brute", "3dr-binning", "3dr-full", "raycast-bvh"])
def test_costs_of_samples_add_up(device: Device, method: str) -> None:
    """Evaluations of samples, not those of blocks' corners; the image holds whole blocks."""
    scene, view = make_scene(soup(5, 120)), oblique("perspective", 80, 48)
    job, frame = start(device, scene, view, aov=("id", "cost"), method=method)
    found = frame.stats["counts"]
    evaluations, setups, steps = (frame[name].astype(np.int64) for name in COSTS)
    assert evaluations.sum() == found["intersection_tests"] <= found["edge_evaluations"]
    assert (evaluations[frame["id.prim"] != NO_HIT] > 0).all(), "what is seen was evaluated"
    assert (setups >= evaluations).all() and setups.max() <= scene.triangle_count * 4**job.tile_log2
    assert (steps.sum() > 0) == (found["traversal_steps"] > 0) == job.method.needs_bvh
    if method == "raycast-bvh":  # whole packets: every sample of one took all of its steps
        assert steps.sum() == found["traversal_steps"] * 64
        assert (steps.reshape(6, 8, 10, 8) == steps[::8, ::8].reshape(6, 1, 10, 1)).all()


def test_costs_of_a_square(device: Device) -> None:
    """Each sample meets both triangles, in every method that tests no blocks; and none where nothing is."""
    for method in ("3dr-brute", "raycast-bvh"):
        scene = replace(squares(2.0), positions=squares(2.0).positions * np.float32([0.5, 1, 1]))
        job, frame = start(device, scene, VIEW, aov=("cost",), method=method)
        steps = children_of_root(job) if method == "raycast-bvh" else 0
        for name, cost in zip(COSTS, (2, 2, steps), strict=True):
            assert (frame[name][:, : SIDE // 2] == cost).all(), (method, name)
        assert all((frame[name][:, SIDE // 2 + 4 :] == 0).all() for name in COSTS[:2])


def test_costs_and_counts_of_bands_are_those_of_the_whole(device: Device) -> None:
    scene, view = make_scene(soup(6, 120)), oblique("perspective", 16, 400)
    options = {"aov": ("cost",), "method": "raycast-bvh"}
    job, whole = start(device, scene, view, **options)
    banded, frame = start(device, scene, view, memory=int(0.9 * job.bytes_device()), **options)
    assert banded.band_count > job.band_count == 1
    assert all((frame[name] == whole[name]).all() for name in COSTS)
    for name in ("edge_evaluations", "intersection_tests", "traversal_steps"):
        assert frame.stats["counts"][name] == whole.stats["counts"][name] > 0


def test_a_second_frame_counts_the_same(device: Device) -> None:
    scene, view = make_scene(soup(7, 120)), oblique("perspective", 80, 48)
    for method in ("3dr-binning", "raycast-bvh"):
        job, first = start(device, scene, view, aov=("cost",), method=method)
        channels = job.allocate()
        job.render_frame(channels, first=False)
        again = job.stats()
        assert all((channels[name] == first[name]).all() for name in COSTS)
        assert again["counts"] == first.stats["counts"] and again["other_counts"] == first.stats["other_counts"]


# --- on and off ------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ROWS)
def test_counters_change_no_pixel(device: Device, method: str) -> None:
    """Nor does counting cost a driver that limits loops its image."""
    if method not in methods_on(device):
        pytest.skip(f"{device.runtime} ends long loops early: grids are refused there")
    scene, view = make_scene(soup(8, 160)), oblique("perspective", 80, 48)
    right = images(device, scene, view, ROWS["3dr-binning"])
    assert differences(images(device, scene, view, ROWS[method], counters=True), right) == ""


@pytest.mark.parametrize("method", ["3dr-full", "3dr-frustum-cull"])
def test_counting_is_work_too_where_loops_are_limited(device: Device, method: str) -> None:
    """Many nodes, each of whose tests is noted at all samples of a frustum: launches must end in time all the same."""
    if loop_limit(device) is None:
        pytest.skip(f"{device.runtime} sets no limit")
    scene, view = make_scene(soup(10, 1500)), oblique("perspective", 130, 70)
    right = images(device, scene, view, ROWS["3dr-binning"])
    assert differences(images(device, scene, view, ROWS[method], counters=True), right) == ""


def test_counters_change_no_layer(device: Device) -> None:
    scene, view = glass_and_leaves(38), oblique("perspective", 40, 31)
    plain, counted = (
        start(device, scene, view, aov=("color", "id"), method="raycast-bvh", counters=on)[1] for on in (False, True)
    )
    for name in ("R", "G", "B", "A", "id.prim"):
        np.testing.assert_array_equal(counted[name], plain[name])
    assert counted.stats["counts"]["passes"] > 2


@pytest.mark.parametrize("method", ["3dr-binning", "3dr-full", "3dr-brute"])
def test_off_nothing_is_counted_and_no_buffer_is_there_for_it(device: Device, method: str) -> None:
    job, frame = start(device, squares(2.0), VIEW, aov=("id",), method=method)
    found = frame.stats["counts"]
    assert job.work is None and not job.features.counters
    assert [found[name] for name in ("triangles", "samples", "hits", "passes")] == [2, SIDE * SIDE, SIDE * SIDE, 1]
    assert [found.get(name) for name in COUNTED if name != "traversal_steps"] == [None] * 3
    assert found["traversal_steps"] == (None if job.method.needs_bvh else 0), "without a tree it is known to be 0"
    assert set(frame.stats["other_counts"]).isdisjoint(COUNTED_TOO)
    _, counted = counts(device, squares(2.0), method)
    assert all(isinstance(counted[name], int) for name in (*COUNTED, *COUNTED_TOO))
    for name in ("setup_triangles.cl", "traverse_frusta.cl" if not job.method.tiles else "rasterize_tiles.cl"):
        program = kernels.build(job.device, name, job.features)
        names = {argument.name for argument in program.arguments(name.removesuffix(".cl"))}
        assert names.isdisjoint({"work", "cost", "pixel_count"})
        assert "-D COUNTERS=0" in job.features.defines(program.source)


def without_counters(text: str) -> str:
    """Kernel text as compiled with COUNTERS off: no comments, none of its lines in `#if COUNTERS`, no COUNT()."""
    kept: list[str] = []
    inside: list[str] = []  # for each open #if: what it is about
    for line in re.sub(r"//[^\n]*", "", text).splitlines():
        directive = re.match(r"\s*#\s*(if|ifdef|ifndef|else|elif|endif)\b\s*(.*)", line)
        if directive and directive[1].startswith("if"):
            inside.append("on" if directive[2].strip() == "COUNTERS" else "other")
        elif directive and directive[1] == "else" and inside[-1] == "on":
            inside[-1] = "off"
        elif directive and directive[1] == "endif":
            inside.pop()
        elif "on" not in inside:
            kept.append(line)
    return re.sub(r"\bCOUNT\([^;]*\);", "", "\n".join(kept))


@pytest.mark.parametrize("path", sorted(kernels.kernel_folder().glob("*.cl*")), ids=lambda path: path.name)
def test_off_no_counter_is_compiled(path: Any) -> None:
    code = without_counters(path.read_text("utf-8"))
    words = {"Work", "work", "cost", "WORK_COUNTER_COUNT", "count_lanes", "count_batch", "count_steps", *WORK_COUNTERS}
    of_others = {"work"} if path.name in ("triangle_batch.clh", "sample_blocks.clh", "slot_queue.clh") else set()
    assert set(re.findall(r"[A-Za-z_]\w*", code)) & (words - of_others) == set()


def test_the_columns_of_counters_are_named_in_their_order() -> None:
    """`Work` of counters.clh, the row that it is added to, and WORK_COUNTERS of layout.py."""
    text = (kernels.kernel_folder() / "counters.clh").read_text("utf-8")
    assert tuple(re.findall(r"^\s*ulong (\w+);", text, flags=re.MULTILINE)) == WORK_COUNTERS
    rows = re.findall(r"row\[(\d+)\] \+= own->(\w+);", text)
    assert rows == [(str(k), name) for k, name in enumerate(WORK_COUNTERS)]


def test_every_method_of_the_table_counts(device: Device) -> None:
    """Only what a method does is counted, and all of it."""
    scene = hidden_heap(60, 0.1)
    for name in ROWS.keys() & methods_on(device):
        _, found = counts(device, scene, name)
        method = resolve_method(name)
        assert found["setups"] >= 2 and found["intersection_tests"] >= SIDE * SIDE
        # A ray through a grid is tested by a triangle's bound and nearness before its edges are evaluated.
        assert method.grid or found["edge_evaluations"] >= found["intersection_tests"]
        assert found["samples_covered"] >= found["samples_written"] >= found["hits"] == SIDE * SIDE
        splits = method.oracles["split_frustum"].setting != "never"
        assert (found["frusta_split"] > 0) == (splits and not method.tiles), name
        assert (found["traversal_steps"] > 0) == (method.needs_bvh or method.grid)
        assert job_choices.square_log2(device, method, SIDE * SIDE) >= 2
