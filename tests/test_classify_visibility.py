"""The classifier, the float32 bounds and the search for double hits, on frames whose faults are known."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import reference as ref
from float32_twin import RUNGS, columns, dot, edge_parts, hits, minus, render_twin

from clrast.study.classify_visibility import Classifier, classify, depth_errors
from clrast.study.double_hits import double_hits, hit_counts
from clrast.study.exact_visibility import NO_HIT, exact_visibility
from clrast.study.float32_bounds import Float32Bounds
from clrast.study.mesh_topology import Topology

PERSPECTIVE = {"e": [0, 0, 0], "d0": [-0.5, 0.5, -1], "dx": [0.125, 0, 0], "dy": [0, -0.125, 0]}
SIZE = 8


def sheet_camera(seed, side, is_perspective=True):
    """A float32 camera at a place that is no short number."""
    rng = np.random.default_rng(seed)
    eye = rng.normal(size=3) * 3
    height = None if is_perspective else 2.0
    return ref.round_camera(
        ref.camera_vectors_float64(eye, eye + rng.normal(size=3), (0, 1, 0), side, side, fov=50, view_height=height)
    )


def sheet_through_samples(camera, side, step=2):
    """A bumpy sheet over the whole view, its vertices at every `step`-th pixel centre but for float32 rounding.

    So nearly every sample lies within rounding of an edge, and one in step^2 of a vertex.
    """
    k = np.arange(-step, side + step + 1, step)
    x, y = (k[None, :] + 0.5) + 0 * k[:, None], (k[:, None] + 0.5) + 0 * k[None, :]
    names = ("d0", "dx", "dy") if "d0" in camera else ("e0", "ex", "ey")
    start, by_x, by_y = (np.array(camera[name]) for name in names)
    swept = start + x[..., None] * by_x + y[..., None] * by_y
    depth = (3 + 0.01 * np.sin(x * 1.7 + y * y))[..., None]
    rows = np.array(camera["e"]) + depth * swept if "d0" in camera else swept + depth * np.array(camera["d"])
    across = len(k)
    corners = [across * j + i for j in range(across - 1) for i in range(across - 1)]
    triangles = [t for c in corners for t in ((c, c + across, c + across + 1), (c, c + across + 1, c + 1))]
    return rows.reshape(-1, 3).astype(np.float32), np.array(triangles)


def part_renderer(positions, triangles, camera, side, rung):
    return lambda chosen: render_twin(positions, triangles[chosen], camera, side, side, rung)[0]


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_naive_edges_are_caught_and_midpoint_edges_pass(projection):
    """The heart: on the same sheet a fused cross product tears along edges, the midpoint form does not."""
    side = 32
    found = {}
    for seed in (1, 2):
        camera = sheet_camera(seed, side, projection == "perspective")
        positions, triangles = sheet_through_samples(camera, side)
        exact = exact_visibility(positions, triangles, camera, side, side)
        assert (exact.prim_id != NO_HIT).all()
        for rung in ("midpoint", "contracted"):
            prim_id, depth = render_twin(positions, triangles, camera, side, side, rung)
            judged = classify(positions, triangles, camera, exact, prim_id, depth)
            doubles = double_hits(part_renderer(positions, triangles, camera, side, rung), positions, triangles, camera)
            along = sum(one.place == "edge" for one in doubles)
            holes, neighbours, doubled = found.get(rung, (0, 0, 0))
            found[rung] = (holes + judged.hole_along_edge_count, neighbours + judged.neighbour_count, doubled + along)
            assert judged.right_count + len(judged.differences) == side * side
            if rung == "midpoint":
                assert judged.count("hole", "farther", "phantom", place="elsewhere") == 0
                assert judged.depth_error < 1e-5
    assert found["midpoint"][0] == 0 and found["midpoint"][2] == 0 and found["midpoint"][1] > 10
    assert found["contracted"][0] > 10 and found["contracted"][2] > 10


def test_doubles_by_counting_agree():
    """Each triangle alone: the midpoint form covers no sample of an edge twice, the fused one does."""
    side = 12
    camera = sheet_camera(4, side)
    positions, triangles = sheet_through_samples(camera, side)
    exact = np.ones((side, side), dtype=bool)
    exact[0::2, 0::2] = False  # samples at vertices, where float32 promises nothing
    for rung in ("midpoint", "contracted"):
        counts = hit_counts(part_renderer(positions, triangles, camera, side, rung), len(triangles))
        assert (counts[exact] == 1).all() == (rung == "midpoint")


def rectangle():
    """Two triangles over pixels 1 to 7, seen at z = -2, a third behind them, a fourth apart; all but short numbers.

    Samples (i, j) on the diagonal i = j are decided by the rule alone.
    """
    flat = [[-0.75, 0.75, -2], [-0.75, -0.75, -2], [0.75, -0.75, -2], [0.75, 0.75, -2]]
    behind = [[-3, 3, -4], [-3, -9, -4], [9, 3, -4]]
    return np.array(flat + behind, dtype=np.float32), np.array([(0, 1, 2), (0, 2, 3), (4, 5, 6)])


def judge(positions, triangles, changes, camera=PERSPECTIVE):
    """The differences of the exact frame with {(column, row): prim_id} painted over it."""
    exact = exact_visibility(positions, np.array(triangles), camera, SIZE, SIZE)
    prim_id = exact.prim_id.copy()
    for (i, j), given in changes.items():
        assert prim_id[j, i] != given, "the change changes nothing"
        prim_id[j, i] = given
    found = classify(positions, np.array(triangles), camera, exact, prim_id)
    return {(one.x, one.y): (one.kind, one.place) for one in found.differences}, found


def test_kinds_and_places_of_planted_faults():
    """One fault of each kind at a sample where its name is plain."""
    positions, triangles = rectangle()
    changes = {
        (3, 3): 0,  # the other side of the diagonal
        (4, 4): 2,  # a crack along the diagonal, the far triangle shows through
        (5, 5): NO_HIT,  # a crack with nothing behind
        (2, 5): 2,  # a hole in the middle of a triangle
        (5, 2): 0,  # the neighbour, but far from their edge
        (0, 4): 0,  # before the right surface, off the triangle
    }
    found, judged = judge(positions, triangles, changes)
    assert found == {
        (3, 3): ("neighbour", "edge"),
        (4, 4): ("farther", "edge"),
        (5, 5): ("hole", "edge"),
        (2, 5): ("farther", "elsewhere"),
        (5, 2): ("farther", "elsewhere"),
        (0, 4): ("phantom", "elsewhere"),
    }
    assert judged.hole_along_edge_count == 2 and judged.neighbour_count == 1 and judged.wrong_surface_count == 5
    assert judged.right_count == SIZE * SIZE - 6
    assert {one.edge_pixels for one in judged.differences if one.place == "edge"} == {0.0}


def test_vertices_silhouettes_and_open_edges():
    """A pyramid's tip on a pixel centre, its folded rim and the open edge of a lone triangle on others."""
    tip, left, low, right, top = [-0.125, 0.125, -2], [-0.75, 0, -2], [0, -0.75, -2], [0.75, 0, -2], [0, 0.75, -2]
    lone = [[-0.875, -0.25, -2], [-0.875, -1.0, -2], [-0.25, -1.0, -2]]
    positions = np.array([tip, left, low, right, top, *lone], dtype=np.float32)
    fan = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 1)]
    triangles = [*fan, (5, 6, 7)]
    exact = exact_visibility(positions, np.array(triangles), PERSPECTIVE, SIZE, SIZE)
    right_id = int(exact.prim_id[3, 3])
    opposite = (right_id + 2) % 4
    assert judge(positions, triangles, {(3, 3): NO_HIT})[0] == {(3, 3): ("hole", "vertex")}
    assert judge(positions, triangles, {(3, 3): opposite})[0] == {(3, 3): ("fan", "vertex")}
    # The lone triangle's left edge is x = 0.5 pixel: the centre of column 0; row 6 is inside.
    assert exact.prim_id[6, 0] == 4
    assert judge(positions, triangles, {(0, 6): NO_HIT})[0] == {(0, 6): ("hole", "open")}
    # With another triangle folded back along that edge it is a silhouette.
    positions = np.append(positions, np.array([[-0.25, -0.5, -3]], dtype=np.float32), axis=0)
    folded = [*triangles, (5, 6, 8)]
    assert judge(positions, folded, {(0, 6): NO_HIT})[0] == {(0, 6): ("hole", "silhouette")}
    unfolded = positions.copy()
    unfolded[8, 0] = -3
    assert judge(unfolded, folded, {(0, 6): NO_HIT})[0] == {(0, 6): ("hole", "edge")}


def test_sliver_beside_the_edge_is_not_taken_for_a_crack():
    """Where the triangle across the edge is thinner than rounding, float32 promises no more than at a vertex."""
    positions, triangles = rectangle()
    thin = np.nextafter(positions[3], np.float32(-9)).astype(np.float32)
    thin[:2] = positions[0, :2] * np.float32(0.5) + positions[2, :2] * np.float32(0.5) + np.float32(1e-8)
    positions = np.append(positions, thin[None], axis=0)
    with_sliver = [triangles[0], (0, 2, 7), (0, 7, 3), (7, 2, 3)]
    right = int(exact_visibility(positions, np.array(with_sliver), PERSPECTIVE, SIZE, SIZE).prim_id[5, 5])
    (kind, place), = judge(positions, with_sliver, {(5, 5): NO_HIT})[0].values()
    assert (right, kind) == (0, "hole") and place == "sliver" or (right == 1 and place == "vertex")


def test_seam_duplicates_are_neighbours():
    """The same rectangle with its diagonal's vertices repeated, one as -0."""
    positions, triangles = rectangle()
    positions = np.append(positions - np.float32([0.75, 0, 0]), positions[[0, 2]] - np.float32([0.75, 0, 0]), axis=0)
    positions[2, 0], positions[8, 0] = 0.0, -0.0
    seam = np.array([triangles[0], (7, 8, 3), triangles[2]])
    camera = {**PERSPECTIVE, "d0": [-0.875, 0.5, -1]}
    found, _ = judge(positions, seam, {(3, 3): 0, (4, 4): NO_HIT}, camera)
    assert found == {(3, 3): ("neighbour", "edge"), (4, 4): ("hole", "edge")}


def test_ties_and_depth_within_rounding():
    """A duplicate with a greater id is a tie; a copy one float32 step behind is farther by rounding; more is wrong."""
    positions, triangles = rectangle()
    step = positions[:4].copy()
    step[:, 2] = np.nextafter(np.float32(-2), np.float32(-3))
    clear = positions[:4] * np.array([1.5, 1.5, 1.001], dtype=np.float32)
    positions = np.concatenate([positions, step * np.float32([1.5, 1.5, 1]), clear])
    stack = [*triangles, (2, 0, 1), (7, 8, 9), (11, 12, 13)]
    found, judged = judge(positions, stack, {(2, 5): 3, (2, 4): 4, (1, 5): 5})
    assert found == {(2, 5): ("tie", "depth"), (2, 4): ("farther", "depth"), (1, 5): ("farther", "elsewhere")}
    assert judged.wrong_surface_count == 3


def test_too_many_differences_are_counted_not_examined():
    positions, triangles = rectangle()
    exact = exact_visibility(positions, triangles, PERSPECTIVE, SIZE, SIZE)
    nothing = np.full_like(exact.prim_id, NO_HIT)
    judged = classify(positions, triangles, PERSPECTIVE, exact, nothing, limit=3)
    assert judged.counts["unexamined", "unexamined"] == judged.hit_count - 3 == judged.wrong_surface_count - 3
    assert classify(positions, triangles, PERSPECTIVE, exact, np.where(nothing, 77, 0)).wrong_surface_count > 0


def test_depth_errors():
    """The largest relative error where ids agree; NaN, and anything but +inf at no hit, are infinite errors."""
    positions, triangles = rectangle()
    exact = exact_visibility(positions, triangles[:2], PERSPECTIVE, SIZE, SIZE)
    depth = exact.t.astype(np.float32)
    assert depth_errors(exact, exact.prim_id, depth) == (0.0, None)
    depth[4, 2] *= np.float32(1 + 2e-5)
    error, worst = depth_errors(exact, exact.prim_id, depth)
    assert error == pytest.approx(2e-5, rel=0.01) and worst == (2, 4)
    given = exact.prim_id.copy()
    given[4, 2] = 1 - given[4, 2]
    assert depth_errors(exact, given, depth) == (0.0, None)
    for at, value in (((4, 3), np.nan), ((0, 0), 0.0), ((4, 3), np.inf)):
        broken = exact.t.astype(np.float32)
        broken[at] = value
        assert depth_errors(exact, exact.prim_id, broken)[0] == np.inf


def test_a_planted_double_hit_is_found():
    """A renderer that covers the diagonal twice, seen only when the two triangles are rendered apart."""
    positions, triangles = rectangle()

    def render(chosen, is_faulty):
        exact = exact_visibility(positions, triangles[chosen], PERSPECTIVE, SIZE, SIZE).prim_id
        if is_faulty and 0 in chosen:
            exact[4, 4] = list(chosen).index(0)
        return exact

    found = double_hits(lambda chosen: render(chosen, True), positions, triangles, PERSPECTIVE)
    assert [(one.x, one.y, {one.right, one.given}, one.place) for one in found] == [(4, 4, {0, 1}, "edge")]
    assert double_hits(lambda chosen: render(chosen, False), positions, triangles, PERSPECTIVE) == []
    assert hit_counts(lambda chosen: render(chosen, True), 2)[4, 4] == 2
    assert hit_counts(lambda chosen: render(chosen, False), 2).max() == 1


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_float32_bounds_hold_and_are_not_idle(projection):
    """|float32 - exact| <= bound for edge functions and depth, and the worst case comes within a factor of 12."""
    rng = np.random.default_rng(17)
    worst_edge = worst_depth = 0.0
    for _ in range(30):
        camera = sheet_camera(rng.integers(1 << 30), SIZE, projection == "perspective")
        bounds, exact = Float32Bounds(camera), ref.exact_camera(camera)
        ray = {name: [np.float32(c) for c in v] for name, v in camera.items()}
        for corners in rng.normal(size=(40, 3, 3)).astype(np.float32) * 3:
            p = [columns(vertex[None]) for vertex in corners]
            i, j = (int(k) for k in rng.integers(0, SIZE, 2))
            x, y = np.float32([i + 0.5]), np.float32([j + 0.5])
            swept = ("d0", "dx", "dy") if projection == "perspective" else ("e0", "ex", "ey")
            at = [(ray[swept[0]][k] + x * ray[swept[1]][k]) + y * ray[swept[2]][k] for k in range(3)]
            true_ray = ref.sample_ray(exact, i + ref.HALF, j + ref.HALF)
            triangle = tuple(ref.vector(vertex) for vertex in corners.tolist())
            values, _, _ = ref.edge_values(triangle, true_ray, exact.is_perspective)
            for edge in range(3):
                n, midpoint = edge_parts(p, ray, edge, "midpoint")
                value = dot(n, at) if midpoint is None else dot(n, minus(at, midpoint))
                error = abs(Fraction(float(value[0])) - values[edge])
                used = float(error) / bounds.edge(corners.astype(np.float64), edge, i + 0.5, j + 0.5)
                worst_edge = max(worst_edge, used)
            with np.errstate(all="ignore"):
                _, w = hits(p, ray, x, y, "midpoint")
            t = ref.plane_t(triangle, true_ray)
            bound = bounds.relative_depth(corners.astype(np.float64), i + 0.5, j + 0.5)
            if t is not None and bound < 0.01:
                worst_depth = max(worst_depth, float(abs(Fraction(float(w[0])) * t - 1)) / bound)
    assert 1 / 12 < worst_edge <= 1
    assert 1 / 12 < worst_depth <= 1


def test_topology():
    """Neighbours across seams, and colours that part them."""
    positions, triangles = rectangle()
    topology = Topology(positions, triangles)
    assert topology.shared_edge(0, 1) == 1 and topology.shared_edge(1, 0) == 2
    assert topology.across(0, 1) == [(1, 2)] and topology.across(0, 0) == [] and topology.shared_edge(0, 2) is None
    assert topology.shared_places(0, 1) == [0, 2]
    camera = sheet_camera(1, 12)
    positions, triangles = sheet_through_samples(camera, 12)
    sheet = Topology(positions, triangles)
    colours = sheet.colours()
    pairs = [(k, other) for k in range(len(triangles)) for edge in range(3) for other, _ in sheet.across(k, edge)]
    assert len(pairs) > 100 and all(colours[a] != colours[b] for a, b in pairs)
    assert colours.max() <= 3


def test_eye_sees_edges_folded_or_not():
    """`is_across` against the sides of the plane through the eye and the edge."""
    rng = np.random.default_rng(23)
    seen = set()
    for _ in range(200):
        positions = rng.normal(size=(4, 3)).astype(np.float32)
        pair = np.array([(0, 1, 2), (0, 1, 3) if rng.random() < 0.5 else (1, 0, 3)])
        classifier = Classifier(positions, pair, {**PERSPECTIVE, "e": [0.25, 0.5, 3]})
        a, b = positions[:2].astype(np.float64) - np.array([0.25, 0.5, 3])
        sides = np.sign((positions[2:].astype(np.float64) - np.array([0.25, 0.5, 3])) @ np.cross(a, b))
        across = classifier.is_across(0, 2, 1, 2)
        assert across == (sides[0] != sides[1])
        seen.add(across)
    assert seen == {True, False}


def test_rungs_of_the_twin_differ_only_by_rounding():
    """A scene far from any edge: all rungs of the specimen give the exact answer."""
    positions, triangles = rectangle()
    exact = exact_visibility(positions, triangles, PERSPECTIVE, SIZE, SIZE)
    for rung in RUNGS:
        prim_id, depth = render_twin(positions, triangles, PERSPECTIVE, SIZE, SIZE, rung)
        assert np.array_equal(prim_id, exact.prim_id)
        assert depth_errors(exact, prim_id, depth)[0] < 1e-6
