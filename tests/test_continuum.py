"""THE heart: every method with 3D edges, and oracles that no method puts together, give the same image bit for bit."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from continuum_world import (
    MADE_UP,
    REFERENCE,
    ROWS,
    Point,
    depths,
    differences,
    glass_and_leaves,
    hard_scenes,
    images,
    oblique,
    round_the_eye,
    soup,
)
from edge_error import near_edges
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from kernel_world import NO_HIT, make_scene, methods_on, orthographic, perspective, render, start

from clrast import job as job_module
from clrast import job_choices, renderer
from clrast.errors import CapacityError
from clrast.opencl import buffers
from clrast.opencl.device import Device
from clrast.opencl.layout import EMPTY_CHILD, LEAF_BIT, NODE_WIDTH
from clrast.options import AVAILABLE_PRECISIONS
from clrast.scene.camera import CameraVectors
from clrast.scene.model import Scene
from clrast.study.classify_visibility import classify
from clrast.study.exact_visibility import exact_visibility
from clrast.visibility import frusta
from clrast.visibility.loop_limits import loop_limit
from clrast.visibility.methods import resolve_method

PROPERTY = settings(
    max_examples=15, deadline=None, derandomize=True, database=None, suppress_health_check=[HealthCheck.too_slow]
)
POINTS = {**ROWS, **MADE_UP}


_EXPECTED: dict[object, dict[str, np.ndarray]] = {}
"""What the reference method found first, by setting and scene: on every device, at every width, the same."""


def expected(device: Device, key: tuple, scene: Scene, view: CameraVectors, **options: object) -> dict[str, np.ndarray]:
    """The image of the reference method, rendered once on each device."""
    own = (device.runtime, *key)
    if own not in _EXPECTED:
        found = images(device, scene, view, REFERENCE, **options)
        assert differences(found, _EXPECTED.setdefault(key, found)) == "", (device.runtime, key)
        _EXPECTED[own] = found
    return _EXPECTED[own]


def check(device: Device, points: dict[str, Point], projection: str = "perspective", **options: object) -> None:
    """The same bits at all points on all hard scenes."""
    wrong = []
    for scene_name, (scene, view) in hard_scenes(projection).items():
        key = (scene_name, projection, *(options.get(name, "") for name in ("precision", "evaluation")))
        right = expected(device, key, scene, view, **options)
        for name, point in points.items():
            found = differences(images(device, scene, view, point, **options), right)
            wrong += [f"{scene_name}, {name}: {found}"] if found else []
    assert not wrong, "\n".join(wrong)


def some(*names: str) -> dict[str, Point]:
    return {name: POINTS[name] for name in names}


# --- the same image --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ROWS)
def test_every_method_gives_the_same_image(device: Device, name: str) -> None:
    if name not in methods_on(device):
        pytest.skip(f"{device.runtime} ends long loops early: grids are refused there")
    check(device, some(name))


@pytest.mark.parametrize("name", MADE_UP)
def test_any_oracles_give_the_same_image(device: Device, name: str) -> None:
    check(device, some(name))


def test_parallel_rays(device: Device) -> None:
    check(device, some("3dr-full", "raycast-brute"), "orthographic")


OTHER_RUNGS = [rung for rung in AVAILABLE_PRECISIONS if rung not in ("midpoint", "fixed")]  # fixed: 2D edges alone
EVALUATIONS_OF_RUNGS = [(rung, ("direct", "incremental")[k % 2]) for k, rung in enumerate(OTHER_RUNGS)]
"""Every rung, and both ways of evaluation in turns: the two have nothing to do with each other."""


@pytest.mark.parametrize(("precision", "evaluation"), EVALUATIONS_OF_RUNGS)
def test_every_rung_and_evaluation(device: Device, precision: str, evaluation: str) -> None:
    """All methods have one image, incremental values depend on the sample's place alone, and rungs differ somewhere."""
    if precision == "double" and not device.has_fp64:
        pytest.skip(f"{device.runtime} has no float64")
    check(device, some("3dr-full"), precision=precision, evaluation=evaluation)
    own = {name: _EXPECTED[name, "perspective", precision, evaluation] for name in hard_scenes("perspective")}
    assert any(differences(image, midpoint_image(device, name)) for name, image in own.items())


def midpoint_image(device: Device, name: str) -> dict[str, np.ndarray]:
    return expected(device, (name, "perspective", "", ""), *hard_scenes("perspective")[name])


@pytest.mark.parametrize("vector_width", [1, 8])
def test_vector_widths(device: Device, vector_width: int) -> None:
    if device.runtime != "pocl":
        pytest.skip(f"{device.runtime} takes minutes to build for other widths than its own")
    check(device, some("3dr-full", "raycast-bvh"), vector_width=vector_width)


@pytest.mark.long
@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
@pytest.mark.parametrize("precision", AVAILABLE_PRECISIONS)
@pytest.mark.parametrize("evaluation", ["direct", "incremental"])
def test_every_point_in_every_setting(device: Device, projection: str, precision: str, evaluation: str) -> None:
    for vector_width in (1, 8, 16) if device.runtime == "pocl" else (device.vector_width,):
        options = {"precision": precision, "evaluation": evaluation, "vector_width": vector_width}
        check(device, POINTS, projection, **options)


@pytest.mark.small
def test_one_triangle_and_a_few(device: Device) -> None:
    """A tree of one node with one leaf, and the smallest images: here Oclgrind looks on."""
    view = oblique("perspective", 17, 9)
    across = [[(-1, -0.5, 0.25), (1, -0.4, 0), (0.125, 0.75, -0.5)]]
    for count in (0, 20):
        scene = make_scene(np.concatenate([across, soup(21, 20)[:count]]))
        right = expected(device, ("few", count), scene, view)
        assert (right["id.prim"] != NO_HIT).any()
        for name in ("3dr-full", "raycast-bvh", "3dr-brute"):
            assert differences(images(device, scene, view, ROWS[name]), right) == "", (count, name)


COORDINATE = st.one_of(
    st.sampled_from([-1.0, 0.0, 0.5, 2.5, 100.0, 1e-3, -1e6]), st.floats(-3, 3, width=32, allow_subnormal=False)
)
TRIANGLES = st.lists(st.lists(COORDINATE, min_size=9, max_size=9), min_size=20, max_size=40)


def test_any_triangles(device: Device) -> None:
    view = oblique("perspective", 40, 25)

    @PROPERTY
    @given(corners=TRIANGLES)
    def same(corners: list) -> None:
        scene = make_scene(np.array(corners).reshape(-1, 3))
        right = images(device, scene, view, REFERENCE)
        for name in ROWS.keys() & methods_on(device):
            assert differences(images(device, scene, view, ROWS[name]), right) == "", name

    same()


# --- the right image -------------------------------------------------------------------------------


def assert_right(scene: Scene, view: CameraVectors, found: dict[str, np.ndarray], hits: int) -> None:
    """As real arithmetic has it, but for samples within rounding of an edge or of another surface's depth."""
    named = view.named()
    exact = exact_visibility(scene.positions, scene.triangles, named, view.width, view.height)
    depth = found["Z"].view(np.float32)
    judged = classify(scene.positions, scene.triangles, named, exact, found["id.prim"], depth)
    for one in judged.differences:
        chosen = [scene.positions[scene.triangles[k]] for k in (one.right, one.given) if k != NO_HIT]
        assert one.place == "depth" or any(near_edges(view, corners, one.x, one.y) for corners in chosen), one
    assert len(judged.differences) <= judged.sample_count // 200
    assert judged.hit_count >= hits and judged.depth_error <= 2.0**-24 * 1.01


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
@pytest.mark.parametrize("name", ["soup", "closed, from inside", "ties"])
def test_the_image_is_right(device: Device, name: str, projection: str) -> None:
    """So that not all methods are wrong together."""
    scene, view = hard_scenes(projection)[name]
    assert_right(scene, view, images(device, scene, view, ROWS["3dr-full"]), 900)


def test_a_closed_mesh_has_no_hole_from_inside(device: Device) -> None:
    scene, view = hard_scenes("perspective")["closed, from inside"]
    assert (images(device, scene, view, ROWS["3dr-full"])["id.prim"] != NO_HIT).all()


@pytest.mark.parametrize("name", ["3dr-full", "raycast-bvh", "raycast-brute"])
def test_the_nearest_of_many_layers_and_the_first_of_equal_ones(device: Device, name: str) -> None:
    """Closed form: the layer at distance 10, whichever its place; of two of them the one with the smaller id."""
    corners = depths(200)
    nearest = int(np.argmax(corners[:, 0, 2]))
    doubled = np.concatenate([corners, corners[nearest : nearest + 1, [1, 2, 0]], corners[:40]])
    for scene in (make_scene(doubled), make_scene(doubled[::-1])):
        found = images(device, scene, perspective(70, 64), ROWS[name])
        equal = np.flatnonzero((scene.positions.reshape(-1, 3, 3)[:, :, 2] == -10).all(axis=1))
        assert len(equal) == 2 + (nearest < 40)
        assert (found["id.prim"] == equal.min()).all() and (found["Z"].view(np.float32) == 10).all()


@pytest.mark.parametrize("name", ["3dr-full", "raycast-bvh", "raycast-brute"])
def test_of_one_plane_the_smallest_id_is_seen_wherever_it_lies_in_the_tree(device: Device, name: str) -> None:
    """200 triangles over the whole view in one plane: what lies as near as all that is there is not hidden by it."""
    view = perspective(40, 33)
    for seed in range(4):
        reach = 10.0 ** np.random.default_rng(seed).uniform(1.5, 3, size=(200, 1, 1))
        corners = reach * [(-1, 1, 0), (3, 1, 0), (-1, -3, 0)] - (0, 0, 4)
        assert (images(device, make_scene(corners), view, ROWS[name])["id.prim"] == 0).all()


SHORT = st.lists(st.tuples(*[st.integers(-6, 6)] * 3), min_size=3, max_size=60)


def test_short_numbers_are_covered_exactly(device: Device) -> None:
    """Edge functions of short numbers round nothing: what is hit is what real arithmetic says, fill rule and all."""
    view = orthographic(25, 21, e0=(-6.25, 5.25, 7), ex=(0.5, 0, 0), ey=(0, -0.5, 0))

    @PROPERTY
    @given(points=SHORT)
    def right(points: list) -> None:
        scene = make_scene(points[: len(points) // 3 * 3])
        exact = exact_visibility(scene.positions, scene.triangles, view.named(), view.width, view.height)
        for name in ("3dr-full", "raycast-brute"):
            found = images(device, scene, view, ROWS[name])
            np.testing.assert_array_equal(found["id.prim"] == NO_HIT, exact.prim_id == NO_HIT)
            np.testing.assert_allclose(found["Z"].view(np.float32), exact.t, rtol=2.0**-20)

    right()


# --- masks, layers, bands, launches ----------------------------------------------------------------


def color_bits(device: Device, scene: Scene, view: CameraVectors, point: Point) -> np.ndarray:
    """R G B A, the ids and Z, as bits: (6, height, width)."""
    method, oracles = point
    frame = render(device, scene, view, aov=("color", "depth", "id"), method=method, oracle=oracles)
    return np.stack([frame[name].view(np.uint32) for name in ("R", "G", "B", "A", "id.prim", "Z")])


def test_masks_and_layers(device: Device) -> None:
    """Cut-out leaves, and glass in many layers: each layer is a traversal of its own."""
    scene, view = glass_and_leaves(38), oblique("perspective", 70, 45)
    right = color_bits(device, scene, view, REFERENCE)
    job, _ = start(device, scene, view, aov=("color",), method="3dr-full")
    assert job.passes >= 5 and job.features.alpha_mask and job.features.alpha_blend
    for name in ("3dr-full", "raycast-bvh"):
        found = color_bits(device, scene, view, ROWS[name])
        assert [(found[k] != right[k]).sum() for k in range(6)] == [0] * 6, name


@pytest.mark.parametrize("name", ["3dr-brute", "3dr-full", "raycast-bvh"])
def test_bands(device: Device, name: str) -> None:
    """Ever smaller budgets of memory: more bands, the same bits."""
    scene, view = make_scene(soup(32, 160)), oblique("perspective", 21, 800)
    right = expected(device, ("bands",), scene, view)
    job, _ = start(device, scene, view, aov=("id", "depth"), method=name)
    counts = set()
    for share in (1.0, 0.9, 0.8):
        banded, frame = start(
            device, scene, view, aov=("id", "depth"), method=name, memory=int(share * job.bytes_device())
        )
        counts.add(banded.band_count)
        assert differences({"id.prim": frame["id.prim"], "Z": frame["Z"].view(np.uint32)}, right) == ""
    assert max(counts) >= 2


def test_the_memory_that_an_error_names_is_enough(device: Device) -> None:
    """`--memory` at the bytes that the message asks for renders; a tree and its bounds are part of them."""
    scene, view = make_scene(soup(33, 1000)), oblique("perspective", 31, 165)
    with pytest.raises(CapacityError) as caught:
        start(device, scene, view, aov=("id", "depth"), method="raycast-bvh", memory=1)
    least = re.search(r"at least ([0-9]+)", str(caught.value))
    assert least
    job, _ = start(device, scene, view, aov=("id", "depth"), method="raycast-bvh", memory=int(least[1]))
    assert job.bytes_device() <= int(least[1])


@contextmanager
def limited_loops(monkeypatch: pytest.MonkeyPatch, iterations: int) -> Iterator[None]:
    """As on a driver that ends all loops of a work-item after twice as many iterations."""
    with monkeypatch.context() as patch:
        for module in (job_module, job_choices, renderer, frusta):
            patch.setattr(module, "loop_limit", lambda device: iterations)
        yield


@pytest.mark.parametrize(
    ("point", "vector_width", "first", "second"),
    [
        (("3dr-full", ("frustum=32",)), None, 400, 1500),
        (("raycast-bvh", ()), 1, 400, 1500),  # stops within leaves, too
        (("3dr-brute", ("frustum=16",)), None, 12, 400),
    ],
    ids=["3dr-full", "raycast-bvh", "3dr-brute"],
)
def test_a_traversal_stops_and_goes_on(
    device: Device, monkeypatch: pytest.MonkeyPatch, point: Point, vector_width: int | None, first: int, second: int
) -> None:
    """After every few nodes or triangles, and the image is that of one launch. `first`, `second` : iterations."""
    scene, view = make_scene(soup(34, 160)), oblique("perspective", 70, 45)
    right = expected(device, ("stops",), scene, view)
    method, oracles = point
    side_log2 = job_choices.square_log2(device, resolve_method(method, oracles), view.width * view.height)
    for_samples = 8 * 4**side_log2  # RESERVED_ITERATIONS of traverse_frusta.cl: clearing and storing them
    launches = []
    for iterations in (first, second):
        with limited_loops(monkeypatch, for_samples + iterations):
            job, frame = start(
                device, scene, view, aov=("id", "depth"), method=method, oracle=oracles, vector_width=vector_width
            )
        assert differences({"id.prim": frame["id.prim"], "Z": frame["Z"].view(np.uint32)}, right) == "", iterations
        launches.append(job.tiles.launches)
    assert launches[0] > launches[1] >= 2 and launches[0] >= 4


@pytest.mark.parametrize("vector_width", [1, 8, 16])
def test_limited_loops_leave_room_for_a_step(device: Device, vector_width: int) -> None:
    """Else a traversal would stop before its first node, launch after launch. Widths are the user's to choose."""
    limited = replace(device, runtime="rusticl", vector_width=vector_width)
    limit = loop_limit(limited)
    assert limit is not None
    for method in ("3dr-brute", "3dr-full", "raycast-bvh"):
        side_log2 = job_choices.square_log2(limited, resolve_method(method, ["frustum=256"]), 300 * 300)
        assert 8 * 4**side_log2 + 1000 < limit, (method, side_log2)


# --- bounds of nodes -------------------------------------------------------------------------------


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_bounds_of_nodes(device: Device, monkeypatch: pytest.MonkeyPatch, projection: str) -> None:
    """Unions of their triangles' bounds; and no sample of any of these is nearer than the node says."""
    corners = np.concatenate([soup(35, 500), round_the_eye(36, 100)])
    scene, view = make_scene(corners), oblique(projection, 130, 70)
    with limited_loops(monkeypatch, 32767):  # so that the nearness of samples is kept
        job, frame = start(device, scene, view, aov=("id",), method="3dr-full", oracle=("frustum=32",))
    bvh, bounds = job.geometry.bvh, job.tiles.bounds
    assert bvh is not None and len(bvh.levels) > 1
    read = lambda buffer, dtype, count: buffers.download(device, buffer, dtype, count)  # noqa: E731
    shape = (bvh.node_count, NODE_WIDTH)
    low, high = (read(job.tiles._nodes[name], np.uint32, shape) for name in ("node_low", "node_high"))
    of_node = read(job.tiles._nodes["node_nearest"], np.float32, shape)
    of_slot = read(bounds.nearest, np.float32, scene.triangle_count)
    boxes = bounds.read()
    seen = boxes[:, 2] > 0
    assert 50 < seen.sum() < scene.triangle_count
    for node, slots in triangles_of_nodes(bvh).items():
        slots = np.array(sorted(slots))
        slots = slots[seen[slots]]
        found = [low[node] & 0xFFFF, low[node] >> 16, high[node] & 0xFFFF, high[node] >> 16]
        if len(slots) == 0:
            assert (found, of_node[node]) == ([0, 0, 0, 0], -np.inf)
            continue
        assert found == [*boxes[slots, :2].min(axis=0), *boxes[slots, 2:].max(axis=0)], node
        assert of_node[node] == np.nanmax(of_slot[slots])
    nearness = read(job.tiles.nearness, np.float32, (view.height, view.width))
    slot_of_prim = np.argsort(bvh.prims)
    hit = frame["id.prim"] != NO_HIT
    assert hit.sum() > 1000
    assert (of_slot[slot_of_prim[frame["id.prim"][hit]]] >= nearness[hit]).all()


def triangles_of_nodes(bvh: object) -> dict[tuple[int, int], set[int]]:
    """(node, child) -> slots of all triangles below it."""
    below: dict[tuple[int, int], set[int]] = {}

    def collect(node: int) -> set[int]:
        total: set[int] = set()
        for k, child in enumerate(bvh.children[node].tolist()):  # type: ignore[attr-defined]
            if child == EMPTY_CHILD:
                continue
            first = child & ~LEAF_BIT
            leaf = set(range(first, first + int(bvh.counts[node, k])))  # type: ignore[attr-defined]
            below[node, k] = leaf if child & LEAF_BIT else collect(child)
            total |= below[node, k]
        return total

    assert len(collect(0)) == len(bvh.prims)  # type: ignore[attr-defined]
    return below
