"""The fast exact answer against the slow one, on random and on spiteful scenes, and against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import reference as ref
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import NO_HIT

from clrast.study.exact_visibility import exact_visibility

WIDTH, HEIGHT = 9, 7
# Sample centres see short binary fractions exactly, so vertices and edges can fall on them.
SNAPPED = {
    "perspective": {"e": [0, 0, 3], "d0": [-0.84375, 0.65625, -1], "dx": [0.1875, 0, 0], "dy": [0, -0.1875, 0]},
    "orthographic": {"d": [0, 0, -1], "e0": [-1.6875, 1.3125, 3], "ex": [0.375, 0, 0], "ey": [0, -0.375, 0]},
}


def any_camera(rng, is_perspective, distance=3.0, target=(0, 0, 0)):
    """A float32 camera from a random side."""
    side = rng.normal(size=3)
    eye = np.asarray(target) + distance * side / np.linalg.norm(side)
    height = None if is_perspective else 2.5
    found = ref.camera_vectors_float64(eye, target, (0.1, 1, 0.2), WIDTH, HEIGHT, fov=50, view_height=height)
    return ref.round_camera(found)


def soup(rng, count=25):
    return rng.normal(size=(24, 3)), rng.integers(0, 24, (count, 3))


def on_the_grid(rng):
    positions, triangles = soup(rng, 30)
    return np.round(positions * 4) / 4, triangles


def slivers(rng):
    """Triangles thinner than float32 rounding: at random, and along the rows of samples of the snapped cameras."""
    ends = rng.normal(size=(20, 2, 3))
    ends[:7, :, 1] = 1.3125 - 0.375 * (np.arange(7)[:, None] + 0.5)
    ends[:7, :, 0], ends[:7, :, 2] = (-2, 2), 1
    third = ends[:, 0] + rng.uniform(-0.2, 1.2, (20, 1)) * (ends[:, 1] - ends[:, 0]) + rng.normal(size=(20, 3)) * 1e-7
    return np.concatenate([ends[:, 0], ends[:, 1], third]), np.arange(60).reshape(3, 20).T


def duplicates(rng):
    positions, triangles = soup(rng, 10)
    turned = np.roll(triangles, 1, axis=1)[::-1]
    return np.concatenate([positions, positions]), np.concatenate([triangles, turned, 24 + triangles[:, ::-1]])


def coplanar(rng):
    """Overlapping triangles on two planes, all coordinates short, so that equal depths are equal exactly."""
    positions = np.round(rng.uniform(-2, 2, (30, 3)) * 8) / 8
    positions[:15, 2], positions[15:, 2] = 0.25, positions[15:, 0] * 0.5
    return positions, np.concatenate([rng.integers(0, 15, (15, 3)), rng.integers(15, 30, (15, 3))])


def fan(rng):
    rim = np.round(rng.normal(size=(9, 3)) * 8) / 8
    return np.concatenate([[[0, 0, 0.5]], rim]), np.array([(0, 1 + k, 1 + (k + 1) % 9) for k in range(9)] * 2)


def around_the_eye(rng):
    """Large triangles near the origin: they cross the eye's plane, lie behind it, or nearly hold it."""
    positions = rng.normal(size=(24, 3)) * 4
    positions[:6] *= 1e-3
    return positions, rng.integers(0, 24, (30, 3))


SHAPES = [soup, on_the_grid, slivers, duplicates, coplanar, fan, around_the_eye]


def check(positions, triangles, camera, width=WIDTH, height=HEIGHT):
    positions = np.asarray(positions, dtype=np.float32)
    prim_id, t, _ = ref.visible_triangles(positions, triangles, camera, width, height)
    fast = exact_visibility(positions, triangles, camera, width, height)
    assert np.array_equal(fast.prim_id, prim_id)
    assert np.array_equal(np.isinf(fast.t), prim_id == NO_HIT)
    hit = prim_id != NO_HIT
    assert np.all(abs(fast.t[hit] - t[hit]) <= 1e-12 * t[hit])
    return fast


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape.__name__)
def test_equals_the_slow_reference(shape, projection):
    rng = np.random.default_rng([7, SHAPES.index(shape)])
    hit_count = 0
    for distance in (3.0, 0.3):
        fast = check(*shape(rng), any_camera(rng, projection == "perspective", distance))
        hit_count += int((fast.prim_id != NO_HIT).sum())
    fast = check(*shape(rng), SNAPPED[projection])
    assert hit_count + int((fast.prim_id != NO_HIT).sum()) > 0


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
@pytest.mark.parametrize("scale", [2.0**-120, 2.0**-60, 1e4, 2.0**60, 2.0**110])
def test_huge_and_tiny_scenes(scale, projection):
    """Scaling by a power of two and back changes nothing; other scales stay right."""
    rng = np.random.default_rng(11)
    positions, triangles = soup(rng)
    camera = any_camera(rng, projection == "perspective")
    lengths = ("e",) if projection == "perspective" else ("e0", "ex", "ey")
    scaled = {name: [c * scale for c in v] if name in lengths else v for name, v in camera.items()}
    fast = check(positions * scale, triangles, ref.round_camera(scaled))
    assert (fast.prim_id != NO_HIT).any()


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_mixed_magnitudes(projection):
    """Vertices from 1e-38 to 1e30 in one scene, and a scene far from the origin."""
    rng = np.random.default_rng(13)
    positions, triangles = soup(rng)
    check(positions * 10.0 ** rng.integers(-38, 31, (24, 1)), triangles, SNAPPED[projection])
    offset = np.array([148376, 1234, -223423])
    check(positions + offset, triangles, any_camera(rng, projection == "perspective", target=offset))


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(*[st.integers(-9, 9)] * 9), min_size=1, max_size=6), st.sampled_from(sorted(SNAPPED)))
def test_any_small_scene_on_the_grid(rows, projection):
    """Hypothesis looks for a scene of snapped triangles where the two disagree."""
    positions = np.array(rows, dtype=np.float32).reshape(-1, 3) / 4
    check(positions, np.arange(len(positions)).reshape(-1, 3), SNAPPED[projection], 7, 6)


def test_long_image_uses_all_block_sizes():
    """Wide enough for blocks of every size; the closed form is a floor: t = -1/d_y below the horizon."""
    width, height = 300, 40
    camera = {"e": [0, 0, 0], "d0": [-150 / 64, 20 / 64, -1], "dx": [1 / 64, 0, 0], "dy": [0, -1 / 64, 0]}
    corner = 1 << 20
    floor = np.array([[-corner, -1, 64], [corner, -1, 64], [corner, -1, -corner], [-corner, -1, -corner]])
    found = exact_visibility(floor.astype(np.float32), np.array([(0, 1, 2), (0, 2, 3)]), camera, width, height)
    d_y = 20 / 64 - (np.arange(height) + 0.5) / 64
    is_floor = d_y < 0
    assert np.array_equal(found.prim_id != NO_HIT, np.broadcast_to(is_floor[:, None], (height, width)))
    assert np.allclose(found.t[is_floor], (-1 / d_y[is_floor])[:, None], rtol=1e-14, atol=0)


def test_sphere_seen_from_its_middle():
    """Every ray from the middle of a closed surface hits, and t times |d| lies between the inner and outer radius."""
    rng = np.random.default_rng(5)
    u, v = np.meshgrid(np.arange(24), np.arange(13), indexing="ij")
    a, b = u * np.pi / 12, v * np.pi / 12
    positions = np.stack([np.sin(b) * np.cos(a), np.cos(b), np.sin(b) * np.sin(a)], axis=-1).reshape(-1, 3)
    corners = [(13 * i + j, 13 * ((i + 1) % 24) + j) for i in range(24) for j in range(12)]
    triangles = [t for p, q in corners for t in ((p, q, q + 1), (p, q + 1, p + 1))]
    camera = any_camera(rng, True, distance=1e-3)
    found = exact_visibility(positions.astype(np.float32), np.array(triangles), camera, 96, 96)
    x, y = np.meshgrid(np.arange(96) + 0.5, np.arange(96) + 0.5)
    d = sum(np.multiply.outer(w, np.array(camera[k])) for w, k in ((np.ones_like(x), "d0"), (x, "dx"), (y, "dy")))
    radius = np.linalg.norm(np.array(camera["e"]) + found.t[..., None] * d, axis=-1)
    assert (found.prim_id != NO_HIT).all()
    # The faces' own distance: cos of half the widest angle between neighbours, in both directions.
    assert radius.max() <= 1 + 1e-6 and radius.min() >= np.cos(np.pi / 24) ** 2 - 1e-6


def test_camera_without_a_view_is_refused():
    positions, triangles = soup(np.random.default_rng(1))
    with pytest.raises(ValueError, match="one plane"):
        exact_visibility(positions, triangles, {**SNAPPED["perspective"], "dy": [0.25, 0, 0]}, 4, 4)
