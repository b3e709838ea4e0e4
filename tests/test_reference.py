"""The exact reference itself, against closed forms and identities that hold in real arithmetic."""

from __future__ import annotations

from fractions import Fraction
from math import atan, cos, degrees, sin, tau

import numpy as np
import pytest
import reference as ref
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import NO_HIT

# One pixel is 1/4 of a unit at depth 2, the eye looks along -z, and all numbers are exact in float32.
# Perspective: the sample (x, y) looks at ((x - 4)/4, (4 - y)/4, -2); orthographic: at the same points of z = -2.
SIZE = 8
PERSPECTIVE = {"e": [0, 0, 0], "d0": [-0.5, 0.5, -1], "dx": [0.125, 0, 0], "dy": [0, -0.125, 0]}
ORTHOGRAPHIC = {"d": [0, 0, -1], "e0": [-1, 1, 0], "ex": [0.25, 0, 0], "ey": [0, -0.25, 0]}
CAMERAS = pytest.mark.parametrize("camera", [PERSPECTIVE, ORTHOGRAPHIC], ids=["perspective", "orthographic"])

QUARTERS = st.integers(-12, 12).map(lambda k: k / 4)
POINTS = st.tuples(QUARTERS, QUARTERS, QUARTERS)


def at_pixels(points, depth=2.0):
    """Positions on z = -2 that the cameras above see at (x, y) in pixels."""
    return np.array([[(x - 4) / 4, (4 - y) / 4, -depth] for x, y in points], dtype=np.float32)


def visible(positions, triangles, camera):
    return ref.visible_triangles(positions, np.array(triangles), camera, SIZE, SIZE)


def expected_cover(x0, x1, y0, y1):
    """Samples of a rectangle, moved by (+eps, +eps^2): on its left and top edges they are in, right and bottom not."""
    centres = np.arange(SIZE) + 0.5
    across, down = (centres >= x0) & (centres < x1), (centres >= y0) & (centres < y1)
    return down[:, None] & across[None, :]


@CAMERAS
@pytest.mark.parametrize("box", [(1.5, 5.5, 2.5, 6.5), (1.5, 5.5, 2.25, 6.75), (0.0, 8.0, 0.0, 8.0), (3.5, 3.5, 1, 7)])
@pytest.mark.parametrize("diagonal", [[(0, 1, 2), (0, 2, 3)], [(1, 2, 3), (3, 0, 1)], [(2, 1, 0), (0, 3, 2)]])
def test_rectangle_is_covered_by_the_top_left_rule(camera, box, diagonal):
    """Two triangles cover a rectangle once each, corners and diagonal on pixel centres included."""
    x0, x1, y0, y1 = box
    positions = at_pixels([(x0, y0), (x0, y1), (x1, y1), (x1, y0)])
    _, t, hit_count = visible(positions, diagonal, camera)
    assert np.array_equal(hit_count, expected_cover(*box).astype(int))
    assert np.all(t[hit_count > 0] == 2.0)


@CAMERAS
@pytest.mark.parametrize("spokes", [3, 5, 8, 13])
def test_closed_fan_is_hit_exactly_once(camera, spokes):
    """A fan round a vertex on a pixel centre, other vertices on pixel centres where they can be."""
    angles = [k * tau / spokes for k in range(spokes)]
    rim = [(4.5 + round(6 * cos(angle)), 4.5 + round(6 * sin(angle))) for angle in angles]
    positions = at_pixels([(4.5, 4.5), *rim])
    fan = [(0, 1 + k, 1 + (k + 1) % spokes) for k in range(spokes)]
    _, _, hit_count = visible(positions, fan, camera)
    assert hit_count[4, 4] == 1
    assert hit_count.max() == 1
    assert hit_count[3:6, 3:6].min() == 1


@CAMERAS
def test_fold_gives_none_or_two(camera):
    """At a silhouette through pixel centres both sheets are hit or neither is."""
    positions = at_pixels([(2.5, 0), (2.5, 8), (7, 4), (7, 4.25)])
    positions[3, 2] = -2.5
    for turn in (1, -1):
        flipped = positions * np.array([turn, 1, 1], dtype=np.float32)
        _, _, hit_count = visible(flipped, [(0, 1, 2), (1, 0, 3)], camera)
        column = 2 if turn == 1 else 5
        assert set(hit_count[1:7, column].tolist()) == ({2} if turn == 1 else {0})


@CAMERAS
def test_orientation_and_front_face(camera):
    """Both faces are hit; V > 0 is the counter-clockwise side."""
    positions = at_pixels([(1, 1), (1, 7), (7, 7)])
    for order, is_front in (((0, 1, 2), True), ((0, 2, 1), False)):
        hits = ref.hits_at(ref.exact_triangles(positions, np.array([order])), ref.exact_camera(camera), 2, 5)
        assert len(hits) == 1 and hits[0].front == is_front


@CAMERAS
def test_equal_depth_goes_to_the_smaller_id(camera):
    positions = at_pixels([(1, 1), (1, 7), (7, 7)])
    prim_id, _, hit_count = visible(positions, [(0, 2, 2), (2, 1, 0), (0, 1, 2), (1, 2, 0)], camera)
    assert hit_count.max() == 3
    assert set(np.unique(prim_id).tolist()) == {1, NO_HIT}


@CAMERAS
@pytest.mark.parametrize(
    "points",
    [
        [(1, 1, -2), (1, 1, -2), (3, 2, -2)],  # two vertices alike
        [(-1, -1, -2), (0, 0, -2), (1, 1, -2)],  # on one line
        [(0, -1, 3), (0, 1, 2), (1, 1, 2)],  # behind
    ],
)
def test_nothing_is_hit(camera, points):
    _, _, hit_count = visible(np.array(points, dtype=np.float32), [(0, 1, 2), (2, 1, 0)], camera)
    assert hit_count.max() == 0


def test_edge_on_covers_nothing():
    """A plane through the eye, or along the parallel rays, has V = 0: nothing, also where samples lie on it."""
    points = np.array([[-0.125, -5, -1], [-0.125, 5, -1], [-0.375, 0, -3]], dtype=np.float32)
    assert visible(points, [(0, 1, 2)], PERSPECTIVE)[2].max() == 0
    points[:, 0] = 0.125
    assert visible(points, [(0, 1, 2)], ORTHOGRAPHIC)[2].max() == 0


def test_floor_that_crosses_the_eye_plane():
    """A floor at y = -1 from behind the eye to the horizon: t = -1/d_y below the horizon, nothing above it."""
    positions = np.array([[-4096, -1, 64], [4096, -1, 64], [0, -1, -(1 << 20)]], dtype=np.float32)
    prim_id, t, _ = visible(positions, [(0, 1, 2)], PERSPECTIVE)
    assert np.all(prim_id[:4] == NO_HIT) and np.all(prim_id[4:] == 0)
    d_y = 0.5 - (np.arange(4, 8) + 0.5) / 8
    assert np.allclose(t[4:], (-1 / d_y)[:, None], rtol=1e-15, atol=0)


def test_orthographic_hits_before_the_view_plane_only():
    """t > 0: a slanted triangle z = -x counts where x > 0, from the plane of the ray origins on."""
    positions = np.array([[-8, -8, 8], [8, -8, -8], [0, 16, 0]], dtype=np.float32)
    prim_id, t, _ = visible(positions, [(0, 1, 2)], ORTHOGRAPHIC)
    x = (np.arange(SIZE) + 0.5) / 4 - 1
    assert np.array_equal(prim_id == 0, np.broadcast_to(x > 0, (SIZE, SIZE)))
    assert np.array_equal(t[:, x > 0], np.broadcast_to(x[x > 0], (SIZE, int((x > 0).sum()))))


@CAMERAS
@settings(max_examples=150, deadline=None)
@given(points=st.tuples(POINTS, POINTS, POINTS), i=st.integers(0, 7), j=st.integers(0, 7))
def test_identities_of_the_definitions(camera, points, i, j):
    """Facts of real arithmetic that the formulas must obey, on and off the triangle."""
    exact, triangle = ref.exact_camera(camera), tuple(ref.vector(p) for p in points)
    ray = ref.sample_ray(exact, i + ref.HALF, j + ref.HALF)
    values, facing, signs = ref.edge_values(triangle, ray, exact.is_perspective)
    normal = ref.cross(ref.subtract(triangle[1], triangle[0]), ref.subtract(triangle[2], triangle[0]))
    plane_side = ref.dot(normal, ref.subtract(triangle[0], ray.e))
    # N . d = V_0 + V_1 + V_2 up to the sign that both forms of w share, so w is the same number.
    if exact.is_perspective:
        assert sum(values) * plane_side == ref.dot(normal, ray.d) * facing
    else:
        assert facing == sum(values) == -ref.dot(normal, ray.d)
    # The midpoint form of the edge normal equals the paper's.
    a, b = (ref.subtract(triangle[k], ray.e) for k in (2, 1))
    midpoint = ref.scale(ref.add(a, b), Fraction(-1, 2))
    assert ref.cross(midpoint, ref.subtract(a, b)) == ref.cross(a, b)
    # A hit lies on the ray and inside the triangle, and turning the triangle over changes nothing but its face.
    hit = ref.intersect(triangle, ray, exact.is_perspective)
    turned = ref.intersect((triangle[0], triangle[2], triangle[1]), ray, exact.is_perspective)
    assert (hit is None) == (turned is None)
    if hit is not None and turned is not None:
        assert hit.position == turned.position == ref.add(ray.e, ref.scale(ray.d, hit.t))
        assert sum(hit.bary) == 1 and min(hit.bary) >= 0 and hit.t == turned.t > 0
        assert hit.front != turned.front
    elif facing != 0 and 0 not in signs and len(set(signs)) == 1 and ref.sign(facing) == signs[0]:
        assert ref.plane_t(triangle, ray) is None or ref.plane_t(triangle, ray) <= 0


@pytest.mark.parametrize("target", [(0, 0, 2), (1, 0, 2), (0.5, 0.5, 2), (1, 1, 2), (0.25, 0, 2)])
@pytest.mark.parametrize("origin", [(0, 0, 0), (-3, 0.5, 1), (0.5, 8, -1)])
def test_rays_of_no_camera_meet_a_sheet_once(target, origin):
    """Aimed at vertices and edges of a sheet that the origin sees unfolded: exactly one triangle each."""
    grid = [(x, y, 2) for y in range(-2, 4) for x in range(-2, 4)]
    cells = [6 * r + c for r in range(5) for c in range(5)]
    sheet = [corner for k in cells for corner in ((k, k + 1, k + 7), (k, k + 7, k + 6))]
    triangles = ref.exact_triangles(np.array(grid, dtype=np.float32), np.array(sheet))
    e = ref.vector(origin)
    ray = ref.general_ray(e, ref.subtract(ref.vector(target), e))
    hits = ref.all_hits(triangles, ray, is_perspective=True)
    assert len(hits) == 1 and hits[0].t == 1 and hits[0].position == ref.vector(target)


def test_tangents_of_rays_of_no_camera():
    """Axes k + 1 and k + 2 after the largest component, the first of equal ones."""
    for d, k in (((0, -3, 1), 1), ((2, 2, -2), 0), ((0, 1, -1.5), 2)):
        ray = ref.general_ray(ref.ZERO, ref.vector(d))
        assert ray.tx[(k + 1) % 3] == 1 and ray.ty[(k + 2) % 3] == 1
        assert sum(map(abs, ray.tx)) == 1 and sum(map(abs, ray.ty)) == 1


def test_camera_table():
    """Perspective: f . d = 1 everywhere, the middle looks along f, the top middle is half the view up."""
    eye, target, width, height = (1.0, 2.0, 3.0), (-2.0, 2.5, 1.0), 30, 20
    found = ref.camera_vectors_float64(eye, target, (0, 1, 0), width, height, fov=50)
    f = ref.unit([target[k] - eye[k] for k in range(3)])
    d0, dx, dy = (np.array(found[name]) for name in ("d0", "dx", "dy"))
    for x, y in ((0, 0), (7.5, 19), (30, 20)):
        assert np.dot(f, d0 + x * dx + y * dy) == pytest.approx(1, abs=1e-14)
    assert np.allclose(d0 + 15 * dx + 10 * dy, f, atol=1e-15)
    top = d0 + 15 * dx
    assert degrees(atan(np.linalg.norm(top - f))) == pytest.approx(25)
    assert top[1] > f[1] and abs(dx[1]) < 1e-16 and np.linalg.norm(dx) == pytest.approx(np.linalg.norm(dy))
    flat = ref.camera_vectors_float64(eye, target, (0, 1, 0), width, height, view_height=4.0)
    assert np.allclose(flat["d"], f)
    e0, ex, ey = (np.array(flat[name]) for name in ("e0", "ex", "ey"))
    assert np.allclose(e0 + 15 * ex + 10 * ey, eye) and np.linalg.norm(ey) * height == pytest.approx(4.0)
    assert np.linalg.norm(ex) * width == pytest.approx(6.0)


def test_camera_of_more_than_float32_is_refused():
    with pytest.raises(ValueError, match="d0"):
        ref.exact_camera({**PERSPECTIVE, "d0": [-0.5, 0.1, 1]})
