"""The uniform grid: every triangle reachable, walks in order with none skipped, and the bits of every other method.

What cl/grid.clh promises is asked in rational arithmetic; images are compared with methods that use no grid.
"""

from __future__ import annotations

import shutil
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from adversarial_worlds import FAMILIES, make_world
from continuum_world import depths, differences, glass_and_leaves, images, oblique, soup, sphere, through_samples
from kernel_world import NO_HIT, make_scene, orthographic, perspective, start

from clrast.errors import CapacityError, DeviceError
from clrast.opencl import buffers, kernels
from clrast.opencl.device import Device
from clrast.opencl.features import Features, Projection
from clrast.opencl.layout import RECORD_WORDS
from clrast.scene.camera import CameraVectors
from clrast.scene.model import Scene
from clrast.visibility.geometry import build_geometry
from clrast.visibility.grid import (
    BALANCE,
    CELL_BITS,
    MAX_GRID_SIDE,
    Grid,
    GridBuilder,
    shape_of,
    side_of_cells,
    side_of_minimum,
)
from clrast.visibility.grid_passes import INTERSECT, TRAVERSE, choose_pass
from clrast.visibility.grid_rays import walk_doubt
from clrast.visibility.loop_limits import loop_limit
from clrast.visibility.oracles import RAY_ORACLES, OracleChoice
from clrast.visibility.view import build_view

BRUTE = ("3dr-binning", ())
GRID = ("raycast-grid", ())
PASSES = ("raycast-grid-multipass", ())
BUDGET = 1 << 28


@pytest.fixture
def free(device: Device) -> Device:
    """A device without a limit on loops; on others grids are refused, which one test looks at."""
    if loop_limit(device) is not None:
        pytest.skip(f"{device.runtime} ends long loops early: grids are refused there")
    return device


def build(device: Device, scene: Scene, minimum: int | None, budget: int = BUDGET) -> Grid:
    features = Features(vector_width=device.vector_width)
    geometry = build_geometry(device, features, scene.positions, scene.triangles, 1.0)
    low, high = scene.bounding_box()
    return GridBuilder(device, features, geometry.corners, scene.triangle_count, low, high, budget).build(minimum)


def lists_of(device: Device, grid: Grid) -> list[list[int]]:
    """prim_ids of each cell, in the order of the lists."""
    begin = buffers.download(device, grid.cell_begin, np.uint32, grid.shape.cell_count + 1)
    references = buffers.download(device, grid.references, np.uint32, grid.reference_count)
    assert begin[0] == 0 and begin[-1] == grid.reference_count and (np.diff(begin.astype(np.int64)) >= 0).all()
    return [references[a:b].tolist() for a, b in zip(begin[:-1], begin[1:], strict=True)]


# --- shapes ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("low", "high"),
    [
        ((0, 0, 0), (98, 64, 163)),
        ((-1, -1, -1), (1, 1, -1)),
        ((5, 5, 5), (5, 5, 5)),
        ((0, 0, 0), (0, 0, 0)),
        ((1e8, -1e8, 0), (1e8 + 800, -1e8 + 24, 8)),
        ((1e-9, 0, 0), (3e-9, 1e-9, 1e-10)),
        ((-1e9, -1e9, -1), (1e9, 1e9, 1e9)),
    ],
)
@pytest.mark.parametrize("minimum", [1, 2, 7, 64, MAX_GRID_SIDE])
def test_shapes_hold_the_box_and_its_padding(low: tuple, high: tuple, minimum: int) -> None:
    """Planes are exact in float32, and all that is within a padding of the box lies within the grid by another."""
    box = np.array(low, np.float32).astype(np.float64), np.array(high, np.float32).astype(np.float64)
    shape = shape_of(*box, side_of_minimum(*box, minimum))
    for axis in range(3):
        start, cell, pad, count = shape.low[axis], shape.cell[axis], shape.pad[axis], shape.counts[axis]
        assert 1 <= count <= MAX_GRID_SIDE and cell > 0 and Fraction(pad) == Fraction(cell) / 16
        assert float(np.float32(start)) == start
        assert all(float(np.float32(k * cell)) == k * cell for k in (1, count // 3, count - 1, count))
        assert Fraction(start) + 2 * Fraction(pad) <= Fraction(box[0][axis])
        assert Fraction(start) + count * Fraction(cell) >= Fraction(box[1][axis]) + 2 * Fraction(pad)


def test_the_least_side_and_cubes_are_as_in_the_paper() -> None:
    """Section 4.1: for the bunny a minimal dimension of 64 gives 98 x 64 x 163."""
    box = np.zeros(3), np.array([98.0, 64.0, 163.0])
    shape = shape_of(*box, side_of_minimum(*box, 64))
    assert shape.counts == (98, 64, 163)
    assert max(shape.cell) / min(shape.cell) < 1.01
    box = np.zeros(3), np.array([10.0, 0.0, 5.0])
    flat = shape_of(*box, side_of_minimum(*box, 8))
    assert flat.counts == (16, 1, 8), "an axis without extent has no say"


def test_cells_are_as_many_as_asked_for() -> None:
    box = np.zeros(3), np.array([3.0, 2.0, 1.0])
    for wanted in (8, 1000, 10**6):
        counts = np.array(shape_of(*box, side_of_cells(*box, wanted)).counts)
        assert np.prod(counts - 1) < wanted <= np.prod(counts), "each count is rounded up"


def test_sides_have_few_significant_bits() -> None:
    cell = shape_of(np.zeros(3), np.array([1.0, 1 / 3, 0.1]), 1 / 77).cell
    for side in cell:
        mantissa = Fraction(side)
        while mantissa.denominator > 1:
            mantissa *= 2
        odd = mantissa.numerator
        while odd % 2 == 0:
            odd //= 2
        assert odd < 1 << CELL_BITS


# --- the lists -------------------------------------------------------------------------------------


def awkward() -> Scene:
    """Small and large triangles, slivers, lines, points and triangles along the axes."""
    rng = np.random.default_rng(11)
    corners = soup(12, 90).astype(np.float32)
    corners[0:8, 2] = corners[0:8, 1]  # lines
    corners[8:12] = corners[8:12, :1]  # points
    corners[12:24, 2] = (corners[12:24, 0] + corners[12:24, 1]) / 2 + rng.normal(size=(12, 3)) * 1e-4  # slivers
    for axis in range(3):
        corners[24 + 8 * axis : 32 + 8 * axis, :, axis] = corners[24 + 8 * axis : 32 + 8 * axis, :1, axis]
    return make_scene(corners)


@pytest.mark.parametrize("minimum", [1, 5, 23])
def test_every_point_of_a_triangle_is_in_a_cell_that_lists_it(free: Device, minimum: int) -> None:
    """Corners, points of edges and of the inside, as they are and moved by the padding along each axis."""
    scene = awkward()
    grid = build(free, scene, minimum)
    lists = lists_of(free, grid)
    assert all(found == sorted(set(found)) for found in lists), "triangle order, none twice"
    shape, rng = grid.shape, np.random.default_rng(3)
    low, cell, pad = (np.array(v, np.float64) for v in (shape.low, shape.cell, shape.pad))
    columns, rows, _ = shape.counts
    for prim_id, corners in enumerate(scene.positions[scene.triangles].astype(np.float64)):
        weights = rng.dirichlet((0.5, 0.5, 0.5), size=120)
        weights[:3] = np.eye(3)
        weights[3:40, rng.integers(3)] = 0.0
        weights /= weights.sum(axis=1, keepdims=True)
        points = weights @ corners
        points = np.concatenate([points, points + rng.choice([-0.999, 0, 0.999], size=points.shape) * pad])
        for x, y, z in np.floor((points - low) / cell).astype(int):
            assert prim_id in lists[(z * rows + y) * columns + x]


def boxes_overlap(corners: np.ndarray, low: np.ndarray, high: np.ndarray) -> bool:
    """Separating axes of a triangle and a box (Akenine-Moeller): the box's, the plane's, and the crosses of edges."""
    edges = corners[[1, 2, 0]] - corners
    axes = [*np.eye(3), np.cross(edges[0], edges[1])]
    axes += [np.cross(edge, unit) for edge in edges for unit in np.eye(3)]
    middle, half = (low + high) / 2, (high - low) / 2
    for axis in axes:
        heights, reach = (corners - middle) @ axis, np.abs(axis) @ half
        if heights.min() > reach or heights.max() < -reach:
            return False
    return True


def test_lists_hold_little_else(free: Device) -> None:
    """Against boxes that are padded by twice as much: fewer than one reference in ten is in vain."""
    scene = make_scene(soup(5, 60))
    grid = build(free, scene, 12)
    lists = lists_of(free, grid)
    low, cell, pad = (np.array(v, np.float64) for v in (grid.shape.low, grid.shape.cell, grid.shape.pad))
    columns, rows, _ = grid.shape.counts
    corners, vain = scene.positions[scene.triangles].astype(np.float64), 0
    for number, found in enumerate(lists):
        index = np.array([number % columns, number // columns % rows, number // (columns * rows)])
        box = low + index * cell - 2 * pad, low + (index + 1) * cell + 2 * pad
        vain += sum(not boxes_overlap(corners[prim_id], *box) for prim_id in found)
    assert vain < 0.1 * grid.reference_count


def test_the_automatic_choice_balances_references_and_cells(free: Device) -> None:
    for scene in (make_scene(*sphere(1.0, 24)), make_scene(soup(3, 600))):
        grid = build(free, scene, None)
        ratio = grid.reference_count / grid.shape.cell_count / BALANCE
        assert 0.5 < ratio < 2.0 and (grid.shape.counts, grid.reference_count) in grid.trials
        assert build(free, scene, None).shape == grid.shape


def test_layers_are_not_cut_into_cells_without_end(free: Device) -> None:
    """However fine, half of the cells hold all of the layers: a finer grid than is tried second is no better."""
    grid = build(free, make_scene(depths(200)), None)
    assert [counts[2] for counts, _ in grid.trials] == [1, 1]
    assert grid.shape.counts == grid.trials[0][0] and grid.shape.cell_count <= 2 * 200
    few, many = (references / (columns * rows * layers) for (columns, rows, layers), references in grid.trials)
    assert many > 0.6 * few > 0.6 * 100


def test_a_grid_that_does_not_fit_is_refused_before_it_is_made(free: Device) -> None:
    scene = make_scene(*sphere(1.0, 8))
    with pytest.raises(CapacityError, match=r"a grid of 1023x1023x1023 cells .*: give a smaller --grid-resolution"):
        build(free, scene, 1023)
    with pytest.raises(CapacityError, match="give a smaller --grid-resolution"):
        build(free, scene, 20, budget=20**3 * 8 + 4)
    assert build(free, scene, None, budget=1 << 16).nbytes <= 1 << 16


# --- walks -----------------------------------------------------------------------------------------


def walks(device: Device, view: np.ndarray, grid: Grid, places: np.ndarray, folder: Path, **features: object) -> list:
    """For each ray: (cells (n, 3) int, times (n,) float32)."""
    for path in [*kernels.kernel_folder().glob("*.clh"), Path(__file__).with_name("grid_probe.cl")]:
        shutil.copy(path, folder)
    program = kernels.build(device, "grid_probe.cl", Features(device.vector_width, **features), folder)  # type: ignore
    count, capacity = len(places), sum(grid.shape.counts)
    made = {
        "counts": buffers.create(device, 4 * count),
        "cells": buffers.create(device, 12 * count * capacity),
        "times": buffers.create(device, 4 * count * capacity),
    }
    program.launch(
        "probe_walks", count, 1, view=view, grid=grid.shape.struct(), ray_count=count, capacity=capacity,
        places=buffers.upload(device, np.ascontiguousarray(places, np.float32)), **made,
    )  # fmt: skip
    counts = buffers.download(device, made["counts"], np.uint32, count)
    cells = buffers.download(device, made["cells"], np.int32, (count, capacity, 3))
    times = buffers.download(device, made["times"], np.float32, (count, capacity))
    assert counts.max() <= capacity
    return [(cells[k, :n], times[k, :n]) for k, n in enumerate(counts)]


def exact_ray(view: np.ndarray, projection: str, place: np.ndarray) -> tuple[list[Fraction], list[Fraction]]:
    """Origin and direction of a sample, of the numbers that kernels are given."""
    part = lambda name: [Fraction(float(c)) for c in view[name][:3]]  # noqa: E731
    x, y = (Fraction(float(c)) for c in place)
    moved = [x * a + y * b for a, b in zip(part("tangent_x"), part("tangent_y"), strict=True)]
    total = lambda *vectors: [sum(parts) for parts in zip(*vectors, strict=True)]  # noqa: E731
    if projection == "orthographic":
        return total(part("origin"), part("origin_low"), moved), part("axis")
    return part("origin"), total(part("axis"), part("axis_low"), moved)


def inside(grid: Grid, origin: list, direction: list) -> tuple[Fraction, Fraction] | None:
    """When the ray is in the grid, t >= 0, exactly; None where it never is."""
    entry, exit_ = Fraction(0), Fraction(10) ** 40
    for axis in range(3):
        low = Fraction(grid.shape.low[axis])
        high = low + grid.shape.counts[axis] * Fraction(grid.shape.cell[axis])
        if direction[axis] == 0:
            if not low < origin[axis] < high:
                return None
            continue
        times = sorted(((low - origin[axis]) / direction[axis], (high - origin[axis]) / direction[axis]))
        entry, exit_ = max(entry, times[0]), min(exit_, times[1])
    return (entry, exit_) if entry < exit_ else None


def check_walk(grid: Grid, view: np.ndarray, projection: str, place: np.ndarray, walk: tuple) -> None:
    """Cells follow each other by faces, times rise, and where the ray is at any time the walk is, within its doubt."""
    cells, times = walk
    features = Features(projection=Projection[projection.upper()])
    doubt = Fraction(walk_doubt(view, features, grid))
    origin, direction = exact_ray(view, projection, place)
    span = inside(grid, origin, direction)
    assert (np.abs(np.diff(cells, axis=0)).sum(axis=1) == 1).all() and (np.diff(times) >= 0).all()
    if span is None or not len(cells):
        assert span is None or span[1] - span[0] < 4 * doubt / max(abs(d) for d in direction)
        return
    slack = doubt / max(abs(d) for d in direction)
    start, end = span[0], Fraction(float(times[-1])) if np.isfinite(times[-1]) else span[1]
    assert end >= span[1] - slack, "the walk ends where the ray leaves"
    for cell, time in zip(cells.tolist(), times.tolist(), strict=True):
        leave = min(Fraction(time), span[1]) if np.isfinite(time) else span[1]
        for t in (start, max(start, leave)):
            for axis in range(3):
                low = Fraction(grid.shape.low[axis]) + cell[axis] * Fraction(grid.shape.cell[axis])
                at = origin[axis] + t * direction[axis]
                assert low - doubt <= at <= low + Fraction(grid.shape.cell[axis]) + doubt
        start = max(start, leave)


WALK_VIEWS = {
    "oblique": oblique("perspective", 64, 48),
    "oblique, parallel": oblique("orthographic", 64, 48),
    "along an axis": perspective(64, 48, (0.125, 0.25, 4.0)),
    "along an axis, parallel": orthographic(64, 48, (-2, 1.5, 3), (0, 0, -1), (0.0625, 0, 0), (0, -0.0625, 0)),
    "inside": perspective(64, 48, (0.1, 0.0, 0.2)),
    "backwards, inside": orthographic(64, 48, (-1, 0.5, -0.5), (0, 0.0, 1), (0.03125, 0, 0), (0, -0.03125, 0)),
}


@pytest.mark.parametrize("name", WALK_VIEWS)
def test_walks_visit_cells_in_order_and_skip_none(free: Device, tmp_path: Path, name: str) -> None:
    camera, scene = WALK_VIEWS[name], make_scene(soup(21, 80))
    low, high = scene.bounding_box()
    for minimum in (1, 9, 40):
        grid, view = build(free, scene, minimum), build_view(camera, low, high, 5)
        rng = np.random.default_rng(minimum)
        places = np.floor(rng.uniform(-32, 32, size=(60, 2)) * 256) / 256
        places[:12] = np.floor(places[:12])
        places[12:20, 0] = 0.0
        feature = {"projection": Projection[camera.projection.upper()]}
        assert walk_doubt(view, Features(free.vector_width, **feature), grid) < 0.05 * min(grid.shape.pad)
        for place, walk in zip(places, walks(free, view, grid, places, tmp_path, **feature), strict=True):
            check_walk(grid, view, camera.projection, place, walk)


def test_rays_along_planes_and_from_walls(free: Device, tmp_path: Path) -> None:
    """Parallel rays whose samples lie exactly on planes of cells, and eyes on them."""
    scene = make_scene([(-1, -1, -1), (1, -1, 1), (1, 1, 0.5), (-1, 1, 1), (0, 1, -1), (1, 0.5, -1)])
    low, high = scene.bounding_box()
    grid = build(free, scene, 8)
    corner, cell = np.array(grid.shape.low), np.array(grid.shape.cell)
    for d, ex, ey in (((0, 0, -1), 0, 1), ((0, 1, 0), 0, 2), ((-1, 0, 0), 1, 2)):
        step_x, step_y = np.eye(3)[ex] * cell / 2, np.eye(3)[ey] * cell / 2
        first = corner - 4 * (np.array(d) * cell) if min(d) == 0 else corner + np.array(grid.shape.counts) * cell
        first = np.where(np.array(d) == 0, corner, first)
        camera = orthographic(16, 16, first, d, step_x, step_y)
        view = build_view(camera, low, high, 5)
        places = np.array([(x - 8.0, y - 8.0) for x in range(16) for y in range(16)])
        found = walks(free, view, grid, places, tmp_path, projection=Projection.ORTHOGRAPHIC)
        for place, walk in zip(places[::7], found[::7], strict=True):
            check_walk(grid, view, "orthographic", place, walk)
    camera = perspective(16, 16, corner + 3 * cell)
    view = build_view(camera, low, high, 5)
    places = np.array([(x, y) for x in (-8, -2, 0, 1, 6) for y in (-8, -1, 0, 3, 7)], float)
    for place, walk in zip(places, walks(free, view, grid, places, tmp_path), strict=True):
        check_walk(grid, view, "perspective", place, walk)


# --- images ----------------------------------------------------------------------------------------


def check(device: Device, scene: Scene, view: CameraVectors, *points: tuple, **options: object) -> None:
    without = {name: value for name, value in options.items() if name != "grid_resolution"}
    right = images(device, scene, view, BRUTE, **without)
    for point in points or (GRID, PASSES):
        assert differences(images(device, scene, view, point, **options), right) == "", (point, options)


@pytest.mark.parametrize("side", [1, 10, 100])
def test_a_grid_is_brute_force_for_1_100_and_10000_rays(free: Device, side: int) -> None:
    """Among 300 triangles in clusters of very different sizes."""
    rng = np.random.default_rng(side)
    corners = np.concatenate([soup(side, 200), 0.1 * soup(side + 1, 60) + rng.normal(size=3), 0.01 * soup(7, 40)])
    scene, view = make_scene(corners), oblique("perspective", side, side)
    right = images(free, scene, view, ("raycast-brute", ()))
    for minimum in (None, 1, 33):
        for point in (GRID, PASSES):
            assert differences(images(free, scene, view, point, grid_resolution=minimum), right) == ""


def test_vertices_on_walls(free: Device) -> None:
    """Triangles whose corners are corners of cells, and an eye on a plane of them."""
    frame = np.array([[(-1, -1, -1), (1, 1, 1), (-1, 1, -1)]], np.float32)
    box = frame.min(axis=(0, 1)).astype(float), frame.max(axis=(0, 1)).astype(float)
    shape = shape_of(*box, side_of_minimum(*box, 6))
    rng = np.random.default_rng(8)
    index = rng.integers(1, 6, size=(200, 1, 3)) + rng.integers(-1, 2, size=(200, 3, 3))
    corners = np.clip(np.array(shape.low) + index * np.array(shape.cell), -1, 1)
    scene = make_scene(np.concatenate([frame, corners.astype(np.float32)]))
    on_plane = np.array(shape.low) + (3, 2, 14) * np.array(shape.cell)
    for view in (oblique("perspective", 90, 70), perspective(90, 70, on_plane), oblique("orthographic", 90, 70)):
        check(free, scene, view, grid_resolution=6)


@pytest.mark.parametrize("axis", range(3))
def test_flat_scenes(free: Device, axis: int) -> None:
    corners = soup(4, 120).astype(np.float32)
    corners[:, :, axis] = 0.25
    for view in (oblique("perspective", 60, 50), oblique("orthographic", 60, 50)):
        check(free, make_scene(corners), view)
    edge_on = perspective(60, 50, (0.25, 0.25, 2.5))
    check(free, make_scene(corners), edge_on)


def test_one_triangle_a_line_and_a_point(free: Device) -> None:
    one = [(-0.5, -0.5, 0), (0.5, -0.25, 0.1), (0, 0.5, -0.2)]
    for corners in (one, [one[0], one[1], one[1]], [one[0]] * 3):
        for view in (perspective(40, 30, (0, 0, 2)), oblique("orthographic", 40, 30)):
            check(free, make_scene(corners), view)


@pytest.mark.parametrize("scale", [1e30, 1e-30])
def test_huge_and_tiny_scenes(free: Device, scale: float) -> None:
    check(free, make_scene(scale * soup(7, 80)), oblique("perspective", 48, 50, scale))


def test_eyes_so_far_that_no_walk_can_be_trusted(free: Device) -> None:
    """Everything is loose then, and rasterized by its screen bounds."""
    scene, step = make_scene(*sphere(1.0, 12)), 2.0**-29
    eye = np.float32([0, 0, 2.0**24])
    view = perspective(64, 64, eye, (-32 * step, 32 * step, -1), (step, 0, 0), (0, -step, 0))
    job, frame = start(free, scene, view, aov="id", method="raycast-grid")
    counts = frame.stats["other_counts"]
    assert counts["triangles_loose"] > 0 and (frame["id.prim"] != NO_HIT).any()
    assert walk_doubt(job.view, job.features, job.grid) > max(job.grid.shape.pad)
    records = buffers.download(free, job.tiles.records, np.uint32, (scene.triangle_count, RECORD_WORDS))
    assert (records[:, 12:14] == 0).all(), "none is left to the grid"
    check(free, scene, view)


def test_triangles_seen_edge_on_are_loose(free: Device) -> None:
    """Sheets through the eye, turned by 2^-k: some of their triangles no grid finds."""
    view, rows = perspective(100, 80), np.arange(18) + 0.5
    turns = [(row / 32, side * 2.0**-k) for row, k, side in zip(rows, range(18), 9 * (-1, 1), strict=True)]
    corners = [[(-1, -3 * y, -3), (1, -3.5 * y, -3.5), (0.5, -9 * y + turn, -9)] for y, turn in turns]
    scene = make_scene(corners)
    counts = start(free, scene, view, aov="id", method="raycast-grid")[1].stats["other_counts"]
    assert 0 < counts["triangles_loose"] < scene.triangle_count
    check(free, scene, view)


@pytest.mark.parametrize("precision", ["midpoint", "exact"])
@pytest.mark.parametrize("point", [GRID, pytest.param(PASSES, marks=pytest.mark.long)])
def test_masked_and_blended_surfaces(free: Device, point: tuple, precision: str) -> None:
    scene, view = glass_and_leaves(31), oblique("perspective", 72, 40)
    options = {"aov": ("color", "id", "depth"), "precision": precision}
    right = start(free, scene, view, method="3dr-binning", **options)[1]
    found = start(free, scene, view, method=point[0], **options)[1]
    for name in right.channels:
        assert (found[name].view(np.uint32) == right[name].view(np.uint32)).all(), name


@pytest.mark.parametrize("point", [GRID, pytest.param(PASSES, marks=pytest.mark.long)])
def test_incremental_evaluation(free: Device, point: tuple) -> None:
    check(free, make_scene(soup(9, 150)), oblique("perspective", 100, 70), point, evaluation="incremental")


def test_bands_and_antialiasing(free: Device) -> None:
    scene, view = make_scene(soup(10, 200)), oblique("perspective", 96, 200)
    for point in (GRID, PASSES):
        job, whole = start(free, scene, view, aov=("id", "depth"), method=point[0])
        banded, frame = start(
            free, scene, view, aov=("id", "depth"), method=point[0], memory=int(0.9 * job.bytes_device())
        )
        assert banded.band_count > 1 and (frame["id.prim"] == whole["id.prim"]).all()
        right = start(free, scene, view, aov=("color",), method="3dr-binning", aa="msaa:4")[1]
        found = start(free, scene, view, aov=("color",), method=point[0], aa="msaa:4")[1]
        assert all((found[name] == right[name]).all() for name in right.channels)


@pytest.mark.long
@pytest.mark.parametrize("precision", ["midpoint", "double", "exact"])
@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_adversarial_worlds(free: Device, projection: str, precision: str) -> None:
    if precision == "double" and not free.has_fp64:
        pytest.skip(f"{free.name} has no float64")
    for family in FAMILIES:
        for seed in (1, 2, 3):
            world = make_world(family, seed, projection)
            check(free, world.scene, world.view, precision=precision)


# --- passes ----------------------------------------------------------------------------------------


def test_oracles_of_passes() -> None:
    naive, delany, purcell = (OracleChoice(name, 20) for name in ("naive", "delany", "purcell"))
    assert [choose_pass(naive, 99, k) for k in (0, 1)] == [TRAVERSE, INTERSECT]
    assert [choose_pass(delany, 5, k) for k in (5, 6)] == [TRAVERSE, INTERSECT]
    assert [choose_pass(purcell, 80, k) for k in (19, 20)] == [TRAVERSE, INTERSECT]
    for setting in RAY_ORACLES["pass"].settings:
        assert choose_pass(OracleChoice(setting, 20), 0, 1) == INTERSECT
        assert choose_pass(OracleChoice(setting, 20), 1, 0) == TRAVERSE


def test_every_oracle_gives_the_same_image_and_does_the_same_work(free: Device) -> None:
    """The order of passes changes how many there are; steps and tests are those of the branching kernel."""
    scene, view = make_scene(*through_samples(oblique("perspective", 90, 60), 9)), oblique("perspective", 90, 60)
    right = images(free, scene, view, BRUTE)
    given = {"aov": ("id", "depth"), "counters": True, "grid_resolution": 8}
    one = start(free, scene, view, method="raycast-grid", **given)[1].stats["counts"]
    passes = {}
    for setting in RAY_ORACLES["pass"].settings:
        options = {"method": PASSES[0], "oracle": (f"pass={setting}", "unroll=1")}
        frame = start(free, scene, view, **given, **options)[1]
        assert (frame["id.prim"] == right["id.prim"]).all() and (frame["Z"].view(np.uint32) == right["Z"]).all()
        counts, more = frame.stats["counts"], frame.stats["other_counts"]
        assert [counts[n] for n in ("traversal_steps", "intersection_tests")] == [
            one[n] for n in ("traversal_steps", "intersection_tests")
        ]
        assert more["triangles_loose"] == 0
        rays = more["simd_efficiency"] * (more["passes_traverse"] + more["passes_intersect"]) * 90 * 60
        assert round(rays) == counts["traversal_steps"] + counts["intersection_tests"], "one of either a pass"
        passes[setting] = more["passes_traverse"] + more["passes_intersect"]
    assert passes["naive"] == max(passes.values()) > passes["purcell"]


def test_unrolled_loops_take_fewer_passes(free: Device) -> None:
    scene, view = make_scene(soup(14, 300)), oblique("perspective", 90, 60)
    right, before = images(free, scene, view, BRUTE), 1 << 30
    for unroll in ("1", "2", "4", "8"):
        frame = start(free, scene, view, aov=("id", "depth"), method=PASSES[0], oracle=f"unroll={unroll}")[1]
        assert (frame["id.prim"] == right["id.prim"]).all() and (frame["Z"].view(np.uint32) == right["Z"]).all()
        more = frame.stats["other_counts"]
        assert more["passes_traverse"] + more["passes_intersect"] < before
        before = more["passes_traverse"] + more["passes_intersect"]


def test_mailboxes_save_tests_and_change_no_bit(free: Device) -> None:
    scene, view = make_scene(soup(14, 300)), oblique("perspective", 90, 60)
    right, found = images(free, scene, view, BRUTE), {}
    for mailbox in ("never", "boxes:1", "boxes:16"):
        options = {"oracle": f"mailbox={mailbox}", "counters": True, "grid_resolution": 24}
        frame = start(free, scene, view, aov=("id", "depth"), method="raycast-grid", **options)[1]
        found[mailbox] = frame.stats["counts"]["intersection_tests"]
        assert (frame["id.prim"] == right["id.prim"]).all()
    assert found["never"] > found["boxes:1"] > found["boxes:16"]


def test_costs_of_rays_add_up(free: Device) -> None:
    scene, view = make_scene(soup(5, 120)), oblique("perspective", 80, 48)
    for point in (GRID, PASSES):
        _, frame = start(free, scene, view, aov=("id", "cost"), method=point[0], counters=True)
        counts = frame.stats["counts"]
        assert frame["cost.traversal_steps"].sum() == counts["traversal_steps"] > 0
        assert frame["cost.edge_evaluations"].sum() <= counts["edge_evaluations"] <= 2 * counts["intersection_tests"]
        assert (frame["cost.edge_evaluations"][frame["id.prim"] != NO_HIT] > 0).all()


# --- refusals --------------------------------------------------------------------------------------


def test_drivers_that_end_loops_are_refused(device: Device) -> None:
    if loop_limit(device) is None:
        pytest.skip(f"{device.runtime} ends no loops")
    with pytest.raises(DeviceError, match="ends long loops early, and a grid may need them: use --device pocl"):
        start(device, make_scene(soup(1, 20)), oblique("perspective", 8, 8), method="raycast-grid")


def test_memory_budgets_hold_for_grids(free: Device) -> None:
    scene, view = make_scene(*sphere(1.0, 40)), oblique("perspective", 40, 40)
    with pytest.raises(CapacityError, match="give a smaller --grid-resolution"):
        start(free, scene, view, method="raycast-grid", memory=8 << 20, grid_resolution=400)
    job, _ = start(free, scene, view, method="raycast-grid", memory=8 << 20)
    assert job.bytes_device() <= 8 << 20
