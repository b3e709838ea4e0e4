"""Edges of the other kinds (cl/projected_edges.clh) against exact arithmetic, within their forward error.

An image may differ from the exact one only where the sample is within rounding of an edge of the triangle that is right
or of the one that was given (edge_twins.py derives how far that is for each formula), where two depths are within
rounding of each other, and in triangles whose area (determinant, volume) is within rounding of 0: these are thinner
than rounding, so that each of their samples is close to an edge.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from edge_twins import Setup, ViewTwin
from edge_worlds import KINDS, METHODS, blob, crossing, edge_on, probe, sheet, thin, view_of
from kernel_world import NO_HIT, make_scene, orthographic, perspective, render

from clrast.opencl import layout
from clrast.opencl.device import Device
from clrast.opencl.features import Edges, Features
from clrast.scene.camera import CameraVectors
from clrast.scene.model import Scene
from clrast.study.classify_visibility import Classification, Difference, classify
from clrast.study.exact_visibility import exact_visibility
from clrast.study.linear_forms import IntegerForms

# --- images -----------------------------------------------------------------------------------------


def is_rounding(setup: Setup, exact: IntegerForms, view: CameraVectors, one: Difference) -> bool:
    """Whether float32 may make this difference."""
    x, y = one.x + 0.5 - view.width / 2, one.y + 0.5 - view.height / 2
    chosen = [k for k in (one.right, one.given) if k != NO_HIT]
    depths = []
    for k in chosen:
        values, nearness = setup.at(k, x, y)
        if any(abs(v.value) <= v.error for v in values) or abs(setup.turn.value[k]) <= setup.turn.error[k]:
            return True
        depths.append(nearness)
    if abs(depths[0].value) <= depths[0].error:
        return True
    is_tie = len(chosen) == 2 and abs(depths[0].value - depths[1].value) <= depths[0].error + depths[1].error
    return is_tie and all(exact.covers(k, one.x, one.y) for k in chosen)


def assert_right(device: Device, kind: Edges, scene: Scene, view: CameraVectors, wrong: int = 10) -> Classification:
    """Right but for rounding, and wrong at few samples; Z, which does not depend on edges, to half an ulp."""
    frame = render(device, scene, view, aov=("id", "depth"), **METHODS[kind])
    exact = exact_visibility(scene.positions, scene.triangles, view.named(), view.width, view.height)
    judged = classify(scene.positions, scene.triangles, view.named(), exact, frame["id.prim"], frame["Z"])
    setup = ViewTwin(view).setup(kind, scene.positions[scene.triangles])
    forms = IntegerForms(scene.positions, scene.triangles, view.named())
    for one in judged.differences:
        assert is_rounding(setup, forms, view, one), one
    assert len(judged.differences) <= wrong
    assert judged.depth_error <= 2.0**-24 * 1.01
    return judged


@pytest.mark.parametrize(("projection", "kind"), KINDS)
def test_triangles_in_front_are_right(device: Device, projection: str, kind: Edges) -> None:
    view = view_of(projection)
    for seed in range(3):
        assert assert_right(device, kind, make_scene(blob(seed, 50)), view).hit_count > 400
        assert assert_right(device, kind, make_scene(blob(seed, 2000, 0.03)), view).hit_count > 200


@pytest.mark.parametrize("behind_count", [1, 2, 3])
@pytest.mark.parametrize(("projection", "kind"), KINDS)
def test_triangles_across_the_eyes_plane_are_right(
    device: Device, projection: str, kind: Edges, behind_count: int
) -> None:
    """Each alone and all at once."""
    view = view_of(projection)
    corners = crossing(view, 3, 40, behind_count)
    assert len(corners) == 40
    hits = [assert_right(device, kind, make_scene(one), view).hit_count for one in corners[:12]]
    hits.append(assert_right(device, kind, make_scene(corners), view).hit_count)
    assert sum(hits[:-1]) > 500 and hits[-1] > 1200 if behind_count < 3 else max(hits) == 0


NEAR_EYE = (-100.0, -7.0, -1.0, -0.5, -(2.0**-10), 0.0, 2.0**-10, 0.5, 1.0, 3.0, 100.0)


@pytest.mark.parametrize("kind", [kind for projection, kind in KINDS if projection == "perspective"])
def test_vertices_in_the_eyes_plane_and_close_to_it(device: Device, kind: Edges) -> None:
    """Also at the eye, in lines through it, and a hundred thousand times as far away as other vertices."""
    view, rng, hits = perspective(33, 20), np.random.default_rng(9), 0
    for corners in rng.choice(NEAR_EYE, size=(80, 3, 3)):
        hits += assert_right(device, kind, make_scene(corners), view).hit_count
    assert hits > 1500


@pytest.mark.parametrize(("projection", "kind"), KINDS)
def test_slivers_and_triangles_seen_edge_on(device: Device, projection: str, kind: Edges) -> None:
    """Thinner than rounding, or without any area; a wall behind them shows what they cover."""
    view = view_of(projection, 64, 64)
    wall = np.array([(-9, -9, -1), (9, -9, -1.5), (0, 9, -1)], dtype=np.float32)[None]
    for corners in (thin(2, 60), edge_on(view, 2, 60)):
        judged = assert_right(device, kind, make_scene(np.concatenate([corners, wall])), view)
        assert judged.hit_count == judged.sample_count
    exact = np.array([[(0, -1, -2), (0, 1, -2), (0, 0, -1)], [(-1, 0, -1), (1, 0, -3), (1, 0, 2)], *thin(2, 60)[-6:]])
    flat = perspective(16, 16) if projection == "perspective" else orthographic(16, 16, e0=(-8, 8, 0))
    frame = render(device, make_scene(exact), flat, aov=("id", "depth"), **METHODS[kind])
    assert (frame["id.prim"] == NO_HIT).all()


@pytest.mark.parametrize(("projection", "kind"), KINDS)
def test_samples_on_the_edges_and_vertices_of_a_sheet(device: Device, projection: str, kind: Edges) -> None:
    """2D and 2DH leave no hole along edges; barycentric edges of neighbours are rounded apart, and may."""
    view = view_of(projection, 32, 32)
    judged = assert_right(device, kind, sheet(view), view, wrong=32 * 32)
    assert len(judged.differences) > 10, "no sample is on an edge: the test tests nothing"
    if kind != Edges.BARYCENTRIC:
        odd = [one for one in judged.differences if one.kind in ("hole", "farther") and (one.x % 2 or one.y % 2)]
        assert odd == []


@pytest.mark.parametrize(("projection", "kind"), KINDS)
def test_shading_takes_3d_edges_whatever_decided_visibility(device: Device, projection: str, kind: Edges) -> None:
    scene, view = make_scene(np.concatenate([blob(4, 40), blob(5, 20, 3.0)])), view_of(projection)
    names = ("id", "depth", "bary", "position", "normal")
    expected = render(device, scene, view, aov=names, method="3dr-binning")
    found = render(device, scene, view, aov=names, **METHODS[kind])
    alike = found["id.prim"] == expected["id.prim"]
    assert alike.mean() > 0.99 and (expected["id.prim"] != NO_HIT).sum() > 500
    for name in expected:
        np.testing.assert_array_equal(found[name][alike], expected[name][alike], err_msg=name)


# --- setups -----------------------------------------------------------------------------------------

HIDDEN = (1.0, 0.0, 0.0)
"""Coefficients of an edge that lies behind the eye."""


@pytest.mark.parametrize(("projection", "kind"), KINDS)
def test_coefficients_are_within_the_forward_error(
    device: Device, tmp_path: Path, projection: str, kind: Edges
) -> None:
    """Triangles of many sizes, whole and clipped, near the world's origin and far from it; none that lies behind."""
    for far in ((0, 0, 0), (148376, 1234, -223423)):
        view = view_of(projection, far=far)
        corners = [blob(1, 300), blob(2, 100, 0.01), *(crossing(view_of(projection), 3, 100, k) for k in (1, 2))]
        if far == (0, 0, 0):
            corners.append(blob(3, 100, 0.001))
        corners = (np.concatenate(corners) + np.float64(far)).astype(np.float32)
        setups = probe(device, tmp_path, projection, kind)
        check_coefficients(setups.setups(view, corners), ViewTwin(view).setup(kind, corners))
        if projection == "perspective" and kind == Edges.PROJECTED:
            assert not setups.setups(view, crossing(view, 3, 100, 3))[2].any()


def check_coefficients(setup: tuple[np.ndarray, np.ndarray, np.ndarray], twin: Setup) -> None:
    """A kernel's setup against what it stands for, wherever no decision of its own is within rounding."""
    found, _, valid = setup
    certain = twin.is_certain()
    assert certain.mean() > 0.95
    np.testing.assert_array_equal(valid[certain], twin.turn.value[certain] != 0)
    hidden = np.stack([*twin.hidden, np.zeros(len(found), dtype=bool)], axis=1)
    assert (found[hidden] == HIDDEN).all() and hidden.any() == bool(twin.depths)
    rows = [*twin.edges, twin.nearness]
    value = np.stack([np.stack([c.value for c in row], axis=1) for row in rows], axis=1)
    error = np.stack([np.stack([c.error for c in row], axis=1) for row in rows], axis=1)
    used = (abs(found - value) / np.where(error > 0, error, np.inf))[(certain & valid)[:, None] & ~hidden]
    assert used.max() <= 1
    assert used.max(axis=0).min() > 0.05, "the bound says nothing"


FIRST_BITS: dict[object, np.ndarray] = {}
"""The first device's answer for each kind: every width and runtime must give the same."""


@pytest.mark.small
@pytest.mark.parametrize(("projection", "kind"), [*KINDS, ("orthographic", Edges.HOMOGENEOUS)])
def test_every_width_and_runtime_gives_the_same_bits(
    device: Device, tmp_path: Path, projection: str, kind: Edges
) -> None:
    """In orthographic views homogeneous edges are projected ones."""
    view = view_of(projection)
    corners = np.concatenate([blob(1, 20), *(crossing(view, 2, 10, k) for k in (1, 2, 3)), thin(3, 20)])
    shared = Edges.PROJECTED if projection == "orthographic" and kind == Edges.HOMOGENEOUS else kind
    for width in (1, 8, 16) if device.runtime == "pocl" else (device.vector_width,):
        found, exclusive, valid = probe(device, tmp_path, projection, kind, vector_width=width).setups(view, corners)
        bits = np.concatenate([found.reshape(len(corners), 12).view(np.int32), exclusive], axis=1)[valid]
        np.testing.assert_array_equal(bits, FIRST_BITS.setdefault((projection, shared), bits))


@pytest.mark.parametrize(("projection", "kind"), KINDS)
def test_coincident_triangles_get_the_same_setup(
    device: Device, tmp_path: Path, projection: str, kind: Edges
) -> None:
    """Whatever the order of their vertices: then ties go to the smaller id."""
    view = view_of(projection)
    corners = np.concatenate([blob(6, 100), *(crossing(view, 6, 40, k) for k in (1, 2))])
    setups = probe(device, tmp_path, projection, kind)
    expected, _, valid = setups.setups(view, corners)
    for order in ([1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]):
        found, _, also_valid = setups.setups(view, corners[:, order])
        np.testing.assert_array_equal(also_valid, valid)
        if order[1] != (order[0] + 1) % 3:
            found = found[:, [0, 2, 1, 3]]
        np.testing.assert_array_equal(found[valid], expected[valid])


@pytest.mark.parametrize(("projection", "kind"), [one for one in KINDS if one[1] != Edges.BARYCENTRIC])
def test_neighbours_get_the_same_edge(device: Device, tmp_path: Path, projection: str, kind: Edges) -> None:
    """Bit for bit but for its direction: also where the edge passes the eye's plane, and is clipped."""
    view = view_of(projection)
    ends = np.concatenate([blob(7, 200), crossing(view, 7, 200, 1), crossing(view, 8, 100, 2)])
    others = ends[:, [1, 0, 2]].copy()
    others[:, 2] = np.random.default_rng(8).permutation(ends[:, 2])
    setups = probe(device, tmp_path, projection, kind)
    (one, _, valid), (other, _, also_valid) = setups.setups(view, ends), setups.setups(view, others)
    twin = ViewTwin(view)
    depth = np.stack([twin.transform(ends[:, k].astype(np.float64))[2].value for k in range(2)])
    seen = valid & also_valid & ((depth > 0).any(axis=0) | (projection == "orthographic"))
    shared = [bool(a & b - {HIDDEN}) for a, b in zip(lines(one), lines(other), strict=True)]
    assert seen.sum() > 300 and np.array(shared)[seen].all()


def lines(coefficients: np.ndarray) -> list[set[tuple[float, ...]]]:
    """Per triangle its three edges, each turned so that it grows to the right or, failing that, downwards."""
    edges = np.where(np.isfinite(coefficients[:, :3]), coefficients[:, :3], 0)
    sign = np.where(edges[..., 1] != 0, np.sign(edges[..., 1]), np.where(edges[..., 2] < 0, -1, 1))
    return [{tuple(edge) for edge in three} for three in (edges * sign[..., None]).tolist()]


# --- the fill rule ----------------------------------------------------------------------------------


def covered(setup: tuple[np.ndarray, np.ndarray, np.ndarray], view: CameraVectors) -> np.ndarray:
    """(count, height, width) bool: the samples that a setup covers, by the float32 operations of the kernels."""
    coefficients, exclusive, valid = setup
    x = (np.arange(view.width, dtype=np.float32) + np.float32(0.5 - view.width / 2))[None, None, None]
    y = (np.arange(view.height, dtype=np.float32) + np.float32(0.5 - view.height / 2))[None, None, :, None]
    c, gx, gy = (np.where(valid[:, None], coefficients[:, :, k], np.float32(0))[:, :, None, None] for k in range(3))
    values = (c + x * gx) + y * gy
    outside = values[:, :3].view(np.int32) - exclusive[:, :, None, None] < 0
    near = values[:, 3] < 0 if view.projection == "orthographic" else values[:, 3] > np.finfo(np.float32).tiny
    return valid[:, None, None] & near & ~outside.any(axis=1)


def exactly_covered(corners: np.ndarray, view: CameraVectors) -> np.ndarray:
    """The same in integers."""
    forms = IntegerForms(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), view.named())
    found = np.zeros((len(corners), view.height, view.width), dtype=bool)
    for k, j, i in np.ndindex(found.shape):
        found[k, j, i] = forms.covers(k, i, j) and forms.depth_ratio(k, i, j)[0] > 0
    return found


def short_view(projection: str, side: int) -> CameraVectors:
    """A pixel is 2^-5 wide at distance 1."""
    step = 2.0**-5
    if projection == "perspective":
        return perspective(side, side)
    e0 = (-side / 2 * step, side / 2 * step, 0)
    return orthographic(side, side, e0=e0, ex=(step, 0, 0), ey=(0, -step, 0))


@pytest.mark.small
@pytest.mark.parametrize(("projection", "kind"), KINDS)
def test_samples_on_edges_follow_the_rule_where_nothing_is_rounded(
    device: Device, tmp_path: Path, projection: str, kind: Edges
) -> None:
    """Vertices on pixel centres and corners, depths that a reciprocal would round, also behind the eye but for 2D."""
    rng, side, count = np.random.default_rng(1), 11, 60
    may_be_behind = projection == "perspective" and kind != Edges.PROJECTED
    depth = rng.choice([1, 2, 41, -1, -2] if may_be_behind else [1, 2, 41], size=(count, 3))
    x, y = rng.integers(-side, side + 1, size=(2, count, 3)) / 64
    x[:20, 0] = y[:20, 0] = 0  # a sample at X = Y = 0, where c alone has a sign
    scale = depth if projection == "perspective" else 1
    corners = np.stack([x * scale, y * scale, -depth.astype(float)], axis=2).astype(np.float32)
    view = short_view(projection, side)
    found = covered(probe(device, tmp_path, projection, kind).setups(view, corners), view)
    np.testing.assert_array_equal(found, exactly_covered(corners, view))
    assert found.sum() > 500


@pytest.mark.parametrize(("projection", "kind"), KINDS)
def test_a_grid_gives_each_sample_to_one_triangle(
    device: Device, tmp_path: Path, projection: str, kind: Edges
) -> None:
    """Vertices on the centres of pixels 1 to 13, at any of three depths, diagonals and vertex orders at random."""
    rng, view, corners = np.random.default_rng(2), short_view(projection, 16), []
    k = np.arange(1, 14) + 0.5 - 8
    depth = rng.choice([1, 3, 41], size=(13, 13))
    scale = depth if projection == "perspective" else 1
    y, x = (each / 32 * scale for each in np.meshgrid(k, k, indexing="ij"))
    points = np.stack([x, -y, -depth], axis=2).astype(np.float32)
    for j, i in np.ndindex(12, 12):
        a, b, c, d = points[j, i], points[j, i + 1], points[j + 1, i + 1], points[j + 1, i]
        for three in ([a, b, c], [c, d, a]) if rng.random() < 0.5 else ([a, b, d], [d, b, c]):
            corners.append(rng.permutation(np.array(three)))
    counts = covered(probe(device, tmp_path, projection, kind).setups(view, np.array(corners)), view).sum(axis=0)
    # By the rule a square keeps its left and top edge.
    inside = (np.arange(16) >= 1) & (np.arange(16) < 13)
    np.testing.assert_array_equal(counts, (inside[:, None] & inside[None]).astype(int))


# --- settings ---------------------------------------------------------------------------------------


def test_kinds_have_the_numbers_that_kernels_compare_with() -> None:
    names = ("EDGES_3D", "EDGES_2D", "EDGES_2DH", "EDGES_BARYCENTRIC")
    assert [layout.CONSTANTS[name] for name in names] == [*Edges]
    assert "-D EDGES=2" in Features(edges=Edges.HOMOGENEOUS).defines()


@pytest.mark.parametrize("kind", [Edges.PROJECTED, Edges.HOMOGENEOUS])
def test_what_leaves_the_range_of_float32_is_dropped(device: Device, tmp_path: Path, kind: Edges) -> None:
    """NaN would count as inside: a setup that counts has none."""
    rng = np.random.default_rng(3)
    bits = rng.integers(0, 0x7F800000, size=(500, 3, 3), dtype=np.uint32) | (rng.integers(0, 2, size=(500, 3, 3)) << 31)
    corners = bits.astype(np.uint32).view(np.float32)
    found, _, valid = probe(device, tmp_path, "perspective", kind).setups(perspective(16, 16), corners)
    assert np.isfinite(found[valid][:, :3, 0]).all()
    assert valid.any() and (~valid).any()
