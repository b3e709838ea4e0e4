"""Visibility where it is easy to be wrong: ties, the eye on planes and vertices, extreme scales and places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import reference as ref
from edge_error import near_edges
from kernel_world import NO_HIT, make_scene, orthographic, perspective, render, render_ids

from clrast.opencl.device import Device
from clrast.scene.camera import CameraVectors, camera_vectors
from clrast.scene.model import Camera, Scene
from clrast.study.classify_visibility import Classification, classify
from clrast.study.exact_visibility import exact_visibility

VIEWS = [("perspective", "fast"), ("perspective", "ordered"), ("perspective", "midpoint"), ("orthographic", "midpoint")]
"""Projections and rungs that differ: an orthographic edge normal is the same in all."""

PROJECTIONS = ["perspective", "orthographic"]


def view_of(
    projection: str, width: int = 48, height: int = 40, eye: tuple = (0.3, 0.7, 2.5), at: tuple = (0.1, -0.2, 0.05)
) -> CameraVectors:
    """A camera whose vectors are no short numbers."""
    return camera_vectors(Camera("oblique", projection, eye, at, (0.1, 1.0, 0.2), 60.0, 3.0), width, height)


def blob(seed: int, count: int, size: float = 0.4) -> np.ndarray:
    """(count, 3, 3) float32: triangles round the origin."""
    rng = np.random.default_rng(seed)
    return (rng.normal(size=(count, 1, 3)) * 0.5 + rng.normal(size=(count, 3, 3)) * size).astype(np.float32)


def judge(device: Device, scene: Scene, view: CameraVectors, **options: object) -> Classification:
    """The frame against real arithmetic."""
    frame = render(device, scene, view, aov=("id", "depth"), **options)
    exact = exact_visibility(scene.positions, scene.triangles, view.named(), view.width, view.height)
    return classify(scene.positions, scene.triangles, view.named(), exact, frame["id.prim"], frame["Z"])


def assert_right(device: Device, scene: Scene, view: CameraVectors, hits: int, **options: object) -> None:
    """Right everywhere but for samples within rounding of an edge, of which there are hardly any; Z to half an ulp."""
    judged = judge(device, scene, view, **options)
    for one in judged.differences:
        chosen = [scene.positions[scene.triangles[k]] for k in (one.right, one.given) if k != NO_HIT]
        assert one.place == "depth" or any(near_edges(view, corners, one.x, one.y) for corners in chosen), one
    assert len(judged.differences) <= judged.sample_count // 200
    assert judged.hit_count >= hits
    assert judged.depth_error <= 2.0**-24 * 1.01


# --- plain scenes ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("projection", "rung"), VIEWS)
def test_random_scenes_are_right_on_every_rung(device: Device, projection: str, rung: str) -> None:
    for seed in range(4):
        assert_right(device, make_scene(blob(seed, 50)), view_of(projection), 400, precision=rung)


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_interpenetrating_triangles_change_where_they_cross(device: Device, projection: str) -> None:
    """Two large planes through each other, and a comb of blades through both."""
    cross = [[(-1, -1, -1), (1, -1, 1), (0, 1.5, 0)], [(-1, -1, 1), (1, -1, -1), (0, 1.5, 0.0625)]]
    blades = [[(x, -1, 0.8), (x + 0.1, 1, -0.8), (x + 0.2, -1, -0.3)] for x in np.linspace(-0.8, 0.6, 9)]
    scene = make_scene(np.array(cross + blades))
    assert_right(device, scene, view_of(projection), 300)
    ids = render_ids(device, scene, view_of(projection))
    assert (ids == 0).sum() > 40 and (ids == 1).sum() > 40


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_slivers_and_needles(device: Device, projection: str) -> None:
    """Thinner than a pixel, and thinner than float32 can tell; those without any area cover nothing."""
    rng = np.random.default_rng(4)
    corners = blob(5, 60, 1.0).astype(np.float64)
    share, width = rng.uniform(size=(60, 1)), 10.0 ** rng.uniform(-9, -1, size=(60, 1))
    corners[:, 2] = corners[:, 0] + share * (corners[:, 1] - corners[:, 0]) + width * rng.normal(size=(60, 3))
    corners[50:, 2] = corners[50:, 1]
    scene = make_scene(corners)
    assert_right(device, scene, view_of(projection, 64, 64), 10)
    ids = render_ids(device, scene, view_of(projection, 64, 64))
    assert set(np.unique(ids).tolist()).isdisjoint(range(50, 60))


# --- ties ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("projection", "rung"), VIEWS)
def test_coincident_triangles_go_to_the_smaller_id(device: Device, projection: str, rung: str) -> None:
    """Copies with turned, flipped and doubled vertices, put before, behind and among the first ones."""
    corners = blob(6, 60)
    view = view_of(projection)
    first = render(device, make_scene(corners), view, aov=("id", "depth"), precision=rung)
    assert (first["id.prim"] != NO_HIT).sum() > 500
    orders = ([1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2])
    copies = np.concatenate([corners[:, order] for order in orders])
    # Behind the first ones they are never seen.
    found = render(device, make_scene(np.concatenate([corners, copies])), view, aov=("id", "depth"), precision=rung)
    np.testing.assert_array_equal(found["id.prim"], first["id.prim"])
    np.testing.assert_array_equal(found["Z"], first["Z"])
    # Shuffled, the copy with the smallest id is seen: the first place where the same triangle stands.
    everything = np.concatenate([corners, copies])
    order = np.random.default_rng(7).permutation(len(everything))
    found = render(device, make_scene(everything[order]), view, aov=("id", "depth"), precision=rung)
    kinds = order % 60
    smallest = np.array([np.flatnonzero(kinds == kind)[0] for kind in range(60)] + [NO_HIT])
    expected = smallest[np.minimum(first["id.prim"], 60)]
    np.testing.assert_array_equal(found["id.prim"], expected)
    np.testing.assert_array_equal(found["Z"], first["Z"])


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_shared_vertices_or_copies_of_them_are_the_same(device: Device, projection: str) -> None:
    """A mesh whose seams have doubled vertices gives the bits of the one that shares them."""
    rng = np.random.default_rng(8)
    points = rng.normal(size=(30, 3)).astype(np.float32)
    triangles = np.array([rng.choice(30, 3, replace=False) for _ in range(80)])
    view = view_of(projection)
    shared = render(device, make_scene(points, triangles), view, aov=("id", "depth"))
    split = render(device, make_scene(points[triangles]), view, aov=("id", "depth"))
    np.testing.assert_array_equal(shared["id.prim"], split["id.prim"])
    np.testing.assert_array_equal(shared["Z"], split["Z"])


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("projection", PROJECTIONS)
def test_overlaps_in_an_axis_plane_go_to_the_smaller_id(device: Device, projection: str, axis: int) -> None:
    """Many triangles in one axis-aligned plane that is no short number: equal depth wherever they overlap."""
    corners = blob(9 + axis, 40, 0.6)
    corners[:, :, axis] = np.float32(0.1)
    view = view_of(projection, eye=(1.3, 1.1, 1.7))
    scene = make_scene(corners)
    judged = judge(device, scene, view)
    assert judged.count("tie", "farther", "phantom") == 0
    assert judged.right_count >= judged.sample_count - 2 and judged.hit_count > 400
    turned = make_scene(corners[::-1])
    assert judge(device, turned, view).count("tie", "farther", "phantom") == 0
    ids, turned_ids = (render_ids(device, one, view).astype(np.int64) for one in (scene, turned))
    hit = ids != NO_HIT
    assert (ids[hit] != 39 - turned_ids[hit]).sum() > 200, "too few overlaps"


@pytest.mark.small
def test_ties_in_short_numbers_are_exact(device: Device) -> None:
    """Nothing is rounded in this view: overlaps in slanted planes, through samples and vertices, all exact."""
    view = perspective(16, 16)
    plane = np.array([(x / 8, y / 8, -1 - x / 8) for x, y in ((-4, -4), (4, -4), (4, 4), (-4, 4), (0, 0), (0, 6))])
    scene = make_scene(plane, [(0, 1, 4), (1, 2, 4), (0, 2, 3), (0, 1, 2), (4, 5, 3), (2, 5, 4), (3, 0, 4)])
    expected, t, hit_count = ref.visible_triangles(scene.positions, scene.triangles, view.named(), 16, 16)
    frame = render(device, scene, view, aov=("id", "depth"))
    np.testing.assert_array_equal(frame["id.prim"], expected)
    np.testing.assert_array_equal(frame["Z"], t.astype(np.float32))
    assert (hit_count > 1).sum() > 50


# --- the eye ---------------------------------------------------------------------------------------


@pytest.mark.small
def test_a_triangle_whose_plane_holds_the_eye_covers_nothing(device: Device) -> None:
    """V = 0: what lies behind is seen through it, whether it is ahead, around or behind the eye."""
    wall = [(-8, -8, -4), (8, -8, -4), (0, 12, -4)]
    through = [
        [(0, -1, -2), (0, 1, -2), (0, 0, -1)],
        [(-1, 0, -1), (1, 0, -3), (1, 0, 2)],
        [(0.5, 0.5, -1), (-0.25, -0.25, -1), (2, 2, 3)],
    ]
    view = perspective(16, 16)
    ids = render_ids(device, make_scene(np.array([*through, wall])), view)
    assert (ids == 3).all()


@pytest.mark.small
def test_a_vertex_or_an_edge_at_the_eye(device: Device) -> None:
    """Again V = 0: n_0 . (p_0 - e) has p_0 = e, or an edge through e."""
    wall = [(-8, -8, -4), (8, -8, -4), (0, 12, -4)]
    at_eye = [[(0, 0, 0), (1, -1, -2), (-1, 1, -2)], [(-1, -1, -1), (1, 1, 1), (3, 1, -5)]]
    assert (render_ids(device, make_scene(np.array([*at_eye, wall])), perspective(16, 16)) == 2).all()
    # The same in numbers that are not short, and with the neighbours that share the vertex.
    view = view_of("perspective", eye=(0.3, 0.7, 2.5))
    eye = np.array(view.origin)
    fan = [[eye, p, q] for p, q in zip(blob(12, 10)[:, 0], blob(13, 10)[:, 0], strict=True)]
    scene = make_scene(np.concatenate([np.array(fan), blob(14, 30)]))
    ids = render_ids(device, scene, view)
    assert (ids >= 10).all() and (ids != NO_HIT).sum() > 300
    expected = render_ids(device, make_scene(blob(14, 30)), view)
    np.testing.assert_array_equal(np.where(ids == NO_HIT, NO_HIT, ids - 10), expected)


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_what_lies_behind_the_eye_is_not_seen(device: Device, projection: str) -> None:
    """Alone: nothing. With things ahead: as if it were not there."""
    view = view_of(projection, eye=(0, 0, 4), at=(0, 0, 0))
    ahead, behind = blob(15, 30), blob(16, 30) + np.float32([0, 0, 12])
    frame = render(device, make_scene(behind), view, aov=("id", "depth"))
    assert (frame["id.prim"] == NO_HIT).all() and (frame["Z"] == np.inf).all()
    expected = render_ids(device, make_scene(ahead), view)
    np.testing.assert_array_equal(render_ids(device, make_scene(np.concatenate([ahead, behind])), view), expected)
    assert (expected != NO_HIT).sum() > 200


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_triangles_across_the_eyes_plane(device: Device, projection: str) -> None:
    """The eye amid large triangles, most of which reach behind it."""
    for seed in range(3):
        scene = make_scene(blob(20 + seed, 40, 3.0))
        assert_right(device, scene, view_of(projection, eye=(0.1, 0.2, 0.3), at=(1, 0.5, -1)), 500)


def test_a_room_from_inside_has_no_hole(device: Device) -> None:
    """A box of 12 triangles round the eye: every sample meets a wall, and just one."""
    points = np.array([(x, y, z) for x in (-1.1, 1.3) for y in (-0.9, 1.2) for z in (-1.4, 1.6)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    scene = make_scene(points, [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    for at in ((1, 0.2, -0.3), (-0.2, 1, 0.1), (0.3, -0.4, -1), (-1, -1, 1)):
        view = view_of("perspective", eye=(0.1, 0.2, 0.3), at=at)
        judged = judge(device, scene, view)
        assert judged.hit_count == judged.sample_count
        assert judged.count("hole", "farther", "phantom", "tie") == 0


# --- scales and places -----------------------------------------------------------------------------


def scaled(view: CameraVectors, factor: float) -> CameraVectors:
    """The view of a world that is `factor` times as large."""
    if view.projection == "orthographic":
        return replace(
            view,
            origin=tuple(c * factor for c in view.origin),
            first=tuple(c * factor for c in view.first),
            tangent_x=tuple(c * factor for c in view.tangent_x),
            tangent_y=tuple(c * factor for c in view.tangent_y),
        )
    return replace(view, origin=tuple(c * factor for c in view.origin))


@pytest.mark.parametrize("exponent", [-66, -40, -20, 20, 40, 66, 100])
@pytest.mark.parametrize("projection", PROJECTIONS)
def test_a_power_of_two_in_scale_changes_no_bit(device: Device, projection: str, exponent: int) -> None:
    """2^-66 is 1.4e-20, 2^66 is 7e19; float32 reaches 3e38. Z is scaled with the world, exactly."""
    corners, view = blob(30, 50), view_of(projection)
    factor = 2.0**exponent
    names = ("id", "depth", "position", "bary", "normal", "distance", "ray")
    expected = render(device, make_scene(corners), view, aov=names)
    found = render(device, make_scene(corners.astype(np.float64) * factor), scaled(view, factor), aov=names)
    for name in expected:
        is_length = name in ("Z", "distance.Y") or name.startswith("P.")
        is_length |= name.startswith(("raydx", "raydy")) and projection == "orthographic"
        wanted = expected[name] * np.float32(factor) if is_length else expected[name]
        np.testing.assert_array_equal(found[name], wanted, err_msg=name)
    assert (expected["id.prim"] != NO_HIT).sum() > 500


@pytest.mark.parametrize("scale", [1e-20, 1e20])
@pytest.mark.parametrize("projection", PROJECTIONS)
def test_worlds_of_other_sizes_are_right(device: Device, projection: str, scale: float) -> None:
    """The same in numbers that the scale rounds, against real arithmetic."""
    camera = Camera(
        "far",
        projection,
        tuple(scale * c for c in (0.3, 0.7, 2.5)),
        tuple(scale * c for c in (0.1, -0.2, 0.05)),
        (0.1, 1.0, 0.2),
        60.0,
        3.0 * scale,
    )
    scene = make_scene(blob(31, 50).astype(np.float64) * scale)
    assert_right(device, scene, camera_vectors(camera, 48, 40), 500)


@pytest.mark.parametrize("projection", PROJECTIONS)
@pytest.mark.parametrize("offset", [(1e6, 0, 0), (148376.0, 1234.0, -223423.0), (-1e6, 1e6, 1e6)])
def test_coordinates_far_from_the_origin(device: Device, projection: str, offset: tuple) -> None:
    """Scene and camera together a million units away: vertices in steps of 1/16, but no more is lost."""
    corners = blob(32, 40, 2.0).astype(np.float64) * 4 + np.array(offset)
    eye = tuple(a + b for a, b in zip((1.0, 3.0, 12.0), offset, strict=True))
    view = view_of(projection, eye=eye, at=offset)
    if projection == "orthographic":
        view = scaled_tangents(view, 8.0)
    assert_right(device, make_scene(corners), view, 300)


def scaled_tangents(view: CameraVectors, factor: float) -> CameraVectors:
    """An orthographic view of an area `factor` times as wide and high, about the same corner."""
    return replace(
        view,
        tangent_x=tuple(c * factor for c in view.tangent_x),
        tangent_y=tuple(c * factor for c in view.tangent_y),
    )


def test_a_camera_a_million_units_away(device: Device) -> None:
    """A telescope: p - e is rounded to 1/16 there, which is a hundredth of a pixel in this view."""
    camera = Camera("telescope", "perspective", (6e5, 5e5, 6e5), (0, 0, 0), (0, 1, 0), 2e-2)
    scene = make_scene(300 * blob(33, 40, 0.6))
    assert_right(device, scene, camera_vectors(camera, 48, 40), 500)


@pytest.mark.parametrize("fov", [1e-3, 1.0, 120.0, 170.0, 179.0])
def test_narrow_and_wide_angles(device: Device, fov: float) -> None:
    camera = Camera("any", "perspective", (0.3, 0.7, 2.5), (0.1, -0.2, 0.05), (0.1, 1.0, 0.2), fov)
    hits = 5 if fov > 175 else 100
    assert_right(device, make_scene(blob(34, 60, 2.0)), camera_vectors(camera, 48, 40), hits)


@pytest.mark.small
@pytest.mark.parametrize("projection", PROJECTIONS)
def test_one_pixel(device: Device, projection: str) -> None:
    """The centre of the one pixel is the centre of the view."""
    view = perspective(1, 1) if projection == "perspective" else orthographic(1, 1, e0=(-0.5, 0.5, 0))
    near = [(-1, -1, -3), (1, -1, -3), (0, 1, -3)]
    far = [(-1, -1, -5), (1, -1, -5), (0, 1, -5)]
    frame = render(device, make_scene(np.array([far, near])), view, aov=("id", "depth"))
    assert frame["id.prim"].tolist() == [[1]] and frame["Z"].tolist() == [[3.0]]
    beside = np.array([far, near]) + np.array([4, 0, 0])
    assert render_ids(device, make_scene(beside), view).tolist() == [[NO_HIT]]
