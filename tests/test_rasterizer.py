"""Invariants of setup, binning and tiles: bounds hold what is covered, lists are complete, settings change no bit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from edge_error import near_edges
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from kernel_world import NO_HIT, Raster, make_scene, orthographic, perspective, rasterize, render, start
from kernel_world import settings as set_up

from clrast.errors import CapacityError
from clrast.opencl import layout
from clrast.opencl.device import Device
from clrast.scene.camera import CameraVectors, camera_vectors
from clrast.scene.model import Camera, Scene
from clrast.study.classify_visibility import Difference, classify
from clrast.study.exact_visibility import exact_visibility
from clrast.study.linear_forms import float_forms

PROPERTY = settings(
    max_examples=40,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.too_slow],
)
TILE_LOG2S = (3, 6)
"""Beside 5, which small images have. In one projection: each is a build of 5 s."""


def oblique(projection: str, width: int, height: int, fov: float = 60.0) -> CameraVectors:
    camera = Camera("oblique", projection, (0.3, 0.7, 2.5), (0.1, -0.2, 0.05), (0.1, 1.0, 0.2), fov, 3.0)
    return camera_vectors(camera, width, height)


def soup(seed: int, count: int) -> Scene:
    """Triangles of all kinds: tiny to huge, slivers, without area, twice there, in axis planes, round the eye."""
    rng = np.random.default_rng(seed)
    center = rng.normal(size=(count, 1, 3)) * 2
    corners = (center + rng.normal(size=(count, 3, 3)) * 10.0 ** rng.uniform(-3, 1.5, size=(count, 1, 1))).astype("f4")
    kind = rng.integers(0, 10, size=count)
    for k in range(count):
        if kind[k] == 0:
            corners[k, 2] = corners[k, 0] + (corners[k, 1] - corners[k, 0]) * np.float32(rng.uniform())
        elif kind[k] == 1:
            corners[k, 2] = corners[k, 1]
        elif kind[k] == 2:
            corners[k] = corners[k - 1][rng.permutation(3)]
        elif kind[k] == 3:
            corners[k, :, rng.integers(3)] = rng.integers(-4, 5) / 2
        elif kind[k] == 4:
            corners[k] *= 100
    return make_scene(corners)


# --- bounds and lists ------------------------------------------------------------------------------


def is_rounding(scene: Scene, view: CameraVectors, one: Difference) -> bool:
    """Whether the sample is within rounding of an edge of the triangle that is right or of the one that was given."""
    chosen = [scene.positions[scene.triangles[k]] for k in (one.right, one.given) if k != NO_HIT]
    return any(near_edges(view, corners, one.x, one.y) for corners in chosen)


def check_against_exact(device: Device, scene: Scene, view: CameraVectors) -> Raster:
    """Bounds and lists hold every exactly covered sample, and ids and Z are right but for float32 rounding."""
    raster = rasterize(device, scene, view)
    named, size = view.named(), raster.tile_size
    x0, y0, x1, y1 = raster.bounds.T
    assert (x0 >= 0).all() and (y0 >= 0).all() and (x1 <= view.width).all() and (y1 <= view.height).all()
    for k in range(scene.triangle_count):
        alone = exact_visibility(scene.positions, scene.triangles[k : k + 1], named, view.width, view.height)
        rows, columns = np.nonzero(alone.prim_id != NO_HIT)
        if len(rows):
            assert x0[k] <= columns.min() and columns.max() < x1[k], f"triangle {k}: bound {raster.bounds[k]}"
            assert y0[k] <= rows.min() and rows.max() < y1[k], f"triangle {k}: bound {raster.bounds[k]}"
        for tile in set(zip((rows // size).tolist(), (columns // size).tolist(), strict=True)):
            assert k in raster.lists[tile], f"triangle {k} is not in the list of tile {tile}"
    exact = exact_visibility(scene.positions, scene.triangles, named, view.width, view.height)
    frame = render(device, scene, view, aov=("id", "depth"))
    np.testing.assert_array_equal(frame["id.prim"], raster.prim_id)
    judged = classify(scene.positions, scene.triangles, named, exact, frame["id.prim"], frame["Z"])
    for one in judged.differences:
        # On an edge that two share neither may be missed; elsewhere nothing beyond rounding may be wrong.
        assert one.place == "depth" or is_rounding(scene, view, one), one
        assert one.kind not in ("hole", "farther") or one.place != "edge", one
    assert judged.depth_error <= 2.0**-24 * 1.01
    return raster


def check_lists(raster: Raster, scene: Scene) -> None:
    """Ascending, without repeats, of existing triangles whose bound meets the tile; as many as were counted."""
    assert sum(len(found) for found in raster.lists.values()) == raster.reference_count
    for (row, column), found in raster.lists.items():
        ids = found.astype(np.int64)
        assert (np.diff(ids) > 0).all(), f"tile {row, column}: {ids}"
        x0, y0, x1, y1 = raster.bounds[ids].T
        left, top = column * raster.tile_size, row * raster.tile_size
        assert (x0 < left + raster.tile_size).all() and (x1 > left).all()
        assert (y0 < top + raster.tile_size).all() and (y1 > top).all()


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
@pytest.mark.parametrize("seed", range(3))
def test_bounds_and_lists_hold_every_covered_sample(device: Device, seed: int, projection: str) -> None:
    scene = soup(seed, 60)
    raster = check_against_exact(device, scene, oblique(projection, 75, 67))
    check_lists(raster, scene)
    assert len(raster.lists) == 9 and raster.reference_count > 12


NEAR_EYE = [-1.0, -0.5, -(2.0**-10), 0.0, 2.0**-10, 0.5, 1.0]
COORDINATE = st.one_of(
    st.sampled_from([*NEAR_EYE, 3.0, -7.0, 100.0, -100.0]),
    st.floats(-4, 4, width=32, allow_subnormal=False).filter(lambda x: x == 0 or abs(x) > 2.0**-10),
    st.floats(-100, 100, width=32, allow_subnormal=False).filter(lambda x: x == 0 or abs(x) > 2.0**-10),
)
POINT = st.tuples(COORDINATE, COORDINATE, COORDINATE)
CORNERS = st.lists(st.tuples(POINT, POINT, POINT), min_size=1, max_size=3)


@pytest.mark.filterwarnings("ignore:invalid value")
@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_any_triangle_lies_in_its_bound(device: Device, projection: str) -> None:
    view = perspective(33, 20)
    if projection == "orthographic":
        view = orthographic(33, 20, e0=(-2, 1.25, 0), ex=(0.125, 0, 0), ey=(0, -0.125, 0))

    @PROPERTY
    @given(corners=CORNERS)
    @example(corners=[((0, 0, 0), (1, 0, -1), (0, 1, -1))])  # a vertex at the eye
    @example(corners=[((-1, 0, -1), (1, 0, -1), (0, 0, -2))])  # edge-on
    @example(corners=[((-1, -1, 1), (1, -1, 1), (0, 1, 2))])  # behind
    @example(corners=[((-1, -1, 0), (1, -1, 0), (0, 1, 0))])  # in the eye's plane
    @example(corners=[((-1e6, -1, -1e6), (1e6, -1, -1e6), (0, -1, 1e6))])  # a floor, ahead of the eye and behind it
    @example(corners=[((-1, -1, -(2.0**-30)), (1, -1, -(2.0**-30)), (0, 1, -(2.0**-30)))])  # just ahead of it
    @example(corners=[((0, 0, -1), (0, 0, -1), (0, 0, -1))])  # a point
    @example(corners=[((0, 0, -1), (1e-6, 0, -1), (1e6, 1e-3, -1))])  # a sliver
    def check(corners: list) -> None:
        scene = make_scene(corners)
        check_lists(check_against_exact(device, scene, view), scene)

    check()


REACHING = [
    ((-0.5364900827, -3.3957297802, -3.192239225), (-447133.25, 1e6, -1e6), (-0.5, -7, 1.4915243387)),
    ((0.4448539913, -0.5813901424, -7), (-687384.5625, -973406.875, 88224.2109375), (-7, -2.836399556, -1.61722993)),
    ((-0.4350250661, -0.0755267888, 0.0009765625), (2.0**-10, 2.0**-10, -(2.0**-10)), (-609.6328, -1000, -388.0579)),
]


@pytest.mark.xfail(reason="the sign of V, and the edge's clip, are float32 noise here: known limit", strict=True)
@pytest.mark.parametrize("corners", REACHING)
def test_a_triangle_from_near_the_eye_to_very_far_lies_in_its_bound(device: Device, corners: tuple) -> None:
    check_against_exact(device, make_scene(corners), perspective(33, 20))


ANY = st.floats(width=32, allow_nan=False, allow_infinity=False)


@pytest.mark.filterwarnings("ignore:overflow")
@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_no_finite_triangle_does_harm(device: Device, projection: str) -> None:
    """Numbers of any size, subnormal ones too: lists that hold together, ids that exist, Z that is a number."""
    view = perspective(20, 12) if projection == "perspective" else orthographic(20, 12, e0=(-10, 6, 0))

    @PROPERTY
    @given(points=st.lists(st.tuples(ANY, ANY, ANY), min_size=3, max_size=6))
    @example(points=[(3e38, 3e38, -3e38), (-3e38, 3e38, -3e38), (0, -3e38, -3e38)])
    @example(points=[(1e-45, 0, -1e-45), (0, 1e-45, -1e-45), (0, 0, -1e-45)])
    @example(points=[(-1, -1, -1), (1, -1, -1), (0, 1, -1), (3e38, 0, 0), (1e-45, 0, 0), (0, 0, 1e-30)])
    def check(points: list) -> None:
        scene = make_scene(points[: 3 * (len(points) // 3)])
        raster = rasterize(device, scene, view)
        check_lists(raster, scene)
        frame = render(device, scene, view, aov=("id", "depth"))
        hit = frame["id.prim"] != NO_HIT
        assert (frame["id.prim"][hit] < scene.triangle_count).all()
        assert not np.isnan(frame["Z"][hit]).any() and (frame["Z"][~hit] == np.inf).all()

    check()


@pytest.mark.small
def test_a_bound_is_empty_where_nothing_can_be_seen(device: Device) -> None:
    """Behind the eye, beside the image, and one that is there: 0 0 0 0, and no reference to it."""
    behind = [(-1, -1, 1), (1, -1, 1), (0, 1, 1)]
    beside = [(9, 0, -1), (10, 0, -1), (9, 1, -1)]
    seen = [(-0.1, -0.1, -1), (0.1, -0.1, -1), (0, 0.1, -1)]
    raster = rasterize(device, make_scene([*behind, *beside, *seen]), perspective(16, 16))
    assert raster.bounds[:2].tolist() == [[0, 0, 0, 0]] * 2
    assert raster.lists[0, 0].tolist() == [2] and raster.reference_count == 1
    # Exactly: 2^5 x / 1 + 8 pixels, so 4.8 .. 11.2 both ways; centres 5.5 .. 10.5 (one more where it is widened).
    x0, y0, x1, y1 = raster.bounds[2].tolist()
    assert (x0, y0, x1, y1) == (5, 5, 11, 11)


# --- triangles across the eye's plane --------------------------------------------------------------


def planks(count: int) -> Scene:
    """A floor one unit under the eye, of thin triangles that run from far ahead to far behind it."""
    edges = np.linspace(-20, 20, count + 1)
    corners = []
    for left, right in zip(edges[:-1], edges[1:], strict=True):
        ahead = (left, -1, -200), (right, -1, -200)
        corners += [[*ahead, (right, -1, 50)], [ahead[0], (right, -1, 50), (left, -1, 50)]]
    return make_scene(np.array(corners))


def touched_tiles(scene: Scene, view: CameraVectors, size: int) -> np.ndarray:
    """(triangle_count,) tiles in which no edge function is negative at all samples, in float64."""
    corners = scene.positions.astype(np.float64)[scene.triangles.astype(np.int64)]
    forms = float_forms(corners, view.named(), view.width, view.height)
    left, top = (a.ravel() for a in np.meshgrid(np.arange(0, view.width, size), np.arange(0, view.height, size)))
    right, bottom = np.minimum(left + size, view.width), np.minimum(top + size, view.height)
    counts = np.zeros(scene.triangle_count, dtype=np.int64)
    for k in range(scene.triangle_count):
        possible = np.ones(len(left), dtype=bool)
        for i in range(3):
            a, b, c = forms.edge[i, :, k] * np.sign(forms.facing[k])
            x = right - 0.5 if b > 0 else left + 0.5
            y = bottom - 0.5 if c > 0 else top + 0.5
            possible &= a + b * x + c * y >= 0
        counts[k] = possible.sum()
    return counts


def test_triangles_across_the_eyes_plane_take_the_tiles_that_they_touch(device: Device) -> None:
    """A naive binner puts each of them into every tile. Here: no more than the edge functions allow, and few."""
    scene = planks(60)
    camera = Camera("inside", "perspective", (0, 0, 0), (0, -0.3, -1), (0, 1, 0), 70.0)
    view = camera_vectors(camera, 256, 256)
    raster = rasterize(device, scene, view, tile_log2=3)
    allowed = touched_tiles(scene, view, 8)
    found = np.bincount(np.concatenate(list(raster.lists.values())), minlength=scene.triangle_count)
    everything = 32 * 32 * scene.triangle_count
    # A narrow bound is not tested tile by tile: up to WIDE_TILE_COUNT tiles may be listed untested.
    assert (found <= np.maximum(allowed, layout.WIDE_TILE_COUNT)).all()
    assert raster.reference_count < 0.12 * everything
    exact = exact_visibility(scene.positions, scene.triangles, view.named(), 256, 256)
    judged = classify(scene.positions, scene.triangles, view.named(), exact, raster.prim_id)
    assert judged.count("hole", "farther", "phantom") == 0 and judged.hit_count > 30000


# --- settings that may change no bit ---------------------------------------------------------------


def busy_scene() -> Scene:
    """Hundreds of triangles in a tile, duplicates among them, and some across the eye's plane."""
    rng = np.random.default_rng(11)
    near = soup(12, 120)
    small = rng.normal(size=(500, 1, 3)) * 0.4 + rng.normal(size=(500, 3, 3)) * 0.15
    corners = np.concatenate([near.positions.reshape(-1, 3, 3), small.astype(np.float32)])
    corners = np.concatenate([corners, corners[::7, [1, 2, 0]], corners[::11, [2, 1, 0]]])
    return make_scene(corners[rng.permutation(len(corners))])


SIZES = [(1, 1), (33, 7), (31, 65), (130, 70)]


def bits(device: Device, scene: Scene, view: CameraVectors, **options: object) -> bytes:
    frame = render(device, scene, view, aov=("id", "depth"), **options)
    return frame["id.prim"].tobytes() + frame["Z"].tobytes()


FIRST_BITS: dict[object, bytes] = {}
"""The first device's answer for each view: all the others must give the same. No fixture: pytest runs one device's
tests of all files before the next device's."""


def same_as_first(key: object, found: bytes) -> None:
    assert found == FIRST_BITS.setdefault(key, found), key


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_sizes_runtimes_and_chunks_change_no_bit(device: Device, projection: str) -> None:
    scene = busy_scene()
    for width, height in SIZES:
        view = oblique(projection, width, height)
        for chunk_count in (32, 7, 1):
            with set_up(chunk_count=chunk_count):
                same_as_first((projection, width, height), bits(device, scene, view))


@pytest.mark.parametrize("tile_log2", TILE_LOG2S)
def test_tile_sizes_change_no_bit(device: Device, tile_log2: int) -> None:
    scene = busy_scene()
    for width, height in SIZES:
        with set_up(tile_log2=tile_log2):
            found = bits(device, scene, oblique("perspective", width, height))
        same_as_first(("perspective", width, height), found)


def test_vector_widths_change_no_bit(device: Device) -> None:
    """All that PoCL may have; other runtimes take only their own."""
    scene = busy_scene()
    for vector_width in (1, 8, 16) if device.runtime == "pocl" else (device.vector_width,):
        for width, height in SIZES:
            found = bits(device, scene, oblique("perspective", width, height), vector_width=vector_width)
            same_as_first(("perspective", width, height), found)


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_bands_change_no_bit(device: Device, projection: str) -> None:
    """Ever smaller budgets, down to one that is too small: more bands, within the budget, the same bits."""
    scene, view = busy_scene(), oblique(projection, 31, 165)
    job, frame = start(device, scene, view, aov=("id", "depth"))
    assert job.band_count == 1
    band_counts = set()
    with pytest.raises(CapacityError):
        for share in (1.0, 0.95, 0.9, 0.85, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2):
            memory = int(share * job.bytes_device())
            banded, found = start(device, scene, view, aov=("id", "depth"), memory=memory)
            band_counts.add(banded.band_count)
            assert banded.bytes_device() <= memory
            np.testing.assert_array_equal(found["id.prim"], frame["id.prim"])
            np.testing.assert_array_equal(found["Z"], frame["Z"])
    assert max(band_counts) >= 3


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_the_order_of_triangles_changes_no_surface(device: Device, projection: str) -> None:
    """Front to back, back to front or shuffled, hundreds in a tile: the same surface, under its new number."""
    rng = np.random.default_rng(13)
    corners = rng.normal(size=(900, 1, 3)) * 0.5 + rng.normal(size=(900, 3, 3)) * 0.3
    scene, view = make_scene(corners), oblique(projection, 64, 64)
    expected = render(device, scene, view, aov=("id", "depth"))
    toward = np.array(view.direction)
    depth = (scene.positions[scene.triangles].mean(axis=1) * toward).sum(axis=1)
    for order in (np.argsort(depth), np.argsort(-depth), rng.permutation(900)):
        found = render(device, replace(scene, triangles=scene.triangles[order]), view, aov=("id", "depth"))
        np.testing.assert_array_equal(found["Z"], expected["Z"])
        numbers = np.append(order, NO_HIT).astype(np.uint32)
        np.testing.assert_array_equal(numbers[np.minimum(found["id.prim"], 900)], expected["id.prim"])
    exact = exact_visibility(scene.positions, scene.triangles, view.named(), 64, 64)
    judged = classify(scene.positions, scene.triangles, view.named(), exact, expected["id.prim"], expected["Z"])
    assert {one.place for one in judged.differences} <= {"vertex", "silhouette", "open", "depth"}
    assert judged.right_count > 0.999 * 64 * 64


@pytest.mark.parametrize("tile_log2", [3, 5])
def test_tiles_and_blocks_that_only_an_edge_reaches(device: Device, tile_log2: int) -> None:
    """A square from 7.5 to 60: its left and top edges lie on the last samples of blocks and tiles, and count."""
    view, corners = orthographic(64, 64), np.array([(7.5, -7.5, -2), (60, -7.5, -2), (60, -60, -2), (7.5, -60, -2)])
    inside = (np.arange(64) >= 7) & (np.arange(64) < 60)
    expected = inside[:, None] & inside[None, :]
    for triangles in ([(0, 1, 2), (0, 2, 3)], [(0, 1, 3), (1, 2, 3)]):
        found = rasterize(device, make_scene(corners, triangles), view, tile_log2)
        np.testing.assert_array_equal(found.prim_id != NO_HIT, expected)


@pytest.mark.parametrize("order", ["forwards", "backwards", "shuffled"])
@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_layers_that_hardly_differ_in_depth(device: Device, projection: str, order: str) -> None:
    """300 layers, 1e-5 apart, over whole tiles: culling what lies behind others must not take the nearest."""
    view = perspective(64, 32) if projection == "perspective" else orthographic(64, 32)
    depths = (10 + 1e-4 * np.arange(300)).astype(np.float32)
    places = {"forwards": np.arange(300), "backwards": np.arange(300)[::-1]}.get(order)
    if places is None:
        places = np.random.default_rng(14).permutation(300)
    corners = [[(-99, 99, -d), (299, 99, -d), (-99, -299, -d)] for d in depths[places]]
    frame = render(device, make_scene(np.array(corners)), view, aov=("id", "depth"))
    assert (frame["id.prim"] == np.flatnonzero(places == 0)[0]).all()
    assert (frame["Z"] == np.float32(10)).all()


@pytest.mark.parametrize("count", [1, 15, 16, 17, 4000])
def test_every_triangle_of_a_long_list_is_seen(device: Device, count: int) -> None:
    """A staircase of `count` triangles, each nearer than all before it in one sample alone; lists of any length."""
    side = 64
    view = orthographic(side, side, e0=(0, 0, 0))
    k = np.arange(count)
    x, y = k % side + 0.5, -(k // side) - 0.5
    small = np.array([(-0.25, -0.25, 0), (0.25, -0.25, 0), (0, 0.25, 0)])
    corners = small + np.stack([x, y, -10 - k / 4096], axis=1)[:, None]
    raster = rasterize(device, make_scene(corners), view)
    expected = np.full(side * side, NO_HIT, dtype=np.uint32)
    expected[:count] = k
    np.testing.assert_array_equal(raster.prim_id, expected.reshape(side, side))
    assert raster.reference_count == count
