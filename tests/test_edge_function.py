"""The edge function against exact arithmetic: signs between neighbours, accuracy, the fill rule, bounds of blocks."""

from __future__ import annotations

import math
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import reference as ref
from edge_error import U, edge_error, permanent
from kernel_probe import Probe
from kernel_world import NO_HIT, coverage, make_scene, orthographic, perspective, render, render_ids

from clrast.opencl.device import Device
from clrast.opencl.features import Precision, Projection
from clrast.scene.camera import CameraVectors, camera_vectors
from clrast.scene.model import Camera, Scene
from clrast.study.classify_visibility import Classifier, classify
from clrast.study.double_hits import double_hits
from clrast.study.exact_visibility import exact_visibility

SIZE = 64
RUNGS = ("fast", "ordered", "midpoint")
VIEWS = [("perspective", rung) for rung in RUNGS] + [("orthographic", "midpoint")]
"""Projections and rungs that differ: an orthographic edge normal is the same in all."""


# --- edges ----------------------------------------------------------------------------------------


def random_ends(seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Two (count, 3) float32: edges of lengths from 1e-4 to 1 round the origin."""
    rng = np.random.default_rng(seed)
    middle = rng.uniform(-1, 1, size=(count, 3))
    reach = 10.0 ** rng.uniform(-4, 0, size=(count, 1)) * rng.normal(size=(count, 3))
    return (middle - reach).astype(np.float32), (middle + reach).astype(np.float32)


def view_of(projection: str, side: int = SIZE) -> CameraVectors:
    """An oblique view of the origin whose vectors are no short numbers."""
    camera = Camera("oblique", projection, (1.3, 0.7, 3.1), (0.1, -0.2, 0.05), (0.1, 1.0, 0.2), 50.0, 2.5)
    return camera_vectors(camera, side, side)


def exact_value(view: CameraVectors, a: np.ndarray, b: np.ndarray, x: float, y: float) -> Fraction:
    """V of the edge from a to b at (x, y) from the image's centre, as in DESIGN."""
    camera = ref.exact_camera(view.named())
    ray = ref.sample_ray(camera, Fraction(x) + Fraction(view.width, 2), Fraction(y) + Fraction(view.height, 2))
    p, q = ref.vector(a.tolist()), ref.vector(b.tolist())
    return ref.edge_values((q, p, p), ray, camera.is_perspective)[0][2]


# --- neighbours ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("projection", "rung"), VIEWS)
def test_neighbours_get_the_same_bits_with_opposite_signs(
    device: Device, tmp_path: Path, rung: str, projection: str
) -> None:
    """Neighbours have an edge's ends swapped; one that shows its back has its function turned round."""
    probe = Probe(device, tmp_path, precision=Precision[rung.upper()], projection=Projection[projection.upper()])
    view, (a, b) = view_of(projection), random_ends(1, 2000)
    back = np.ones(len(a), dtype=bool)
    coefficients, exclusive = probe.edges(view, a, b)
    bits, opposite = coefficients.view(np.uint32), coefficients.view(np.uint32) ^ np.uint32(0x80000000)
    assert (coefficients != 0).all()
    for ends, turned, expected, excluded in (
        ((b, a), None, opposite, 1 - exclusive),
        ((a, b), back, opposite, 1 - exclusive),
        ((b, a), back, bits, exclusive),
    ):
        found, found_exclusive = probe.edges(view, *ends, turned)
        np.testing.assert_array_equal(found.view(np.uint32), expected)
        np.testing.assert_array_equal(found_exclusive, excluded)


@pytest.mark.small
def test_a_constant_of_zero_has_no_sign(device: Device, tmp_path: Path) -> None:
    """Edges through the image's centre, seen from either side: c is +0 for all, or -0 minus 1 would be inside."""
    view = perspective(SIZE, SIZE)
    a = np.array([[0, 0, -1], [1, 1, -1], [-1, 2, -1], [0, 1, -2], [0, 0, 0]], np.float32)
    b = np.array([[1, 0, -1], [-1, -1, -1], [1, -2, -1], [0, -3, -1], [1, 2, -3]], np.float32)
    for ends in ((a, b), (b, a)):
        for turned in (None, np.ones(len(a), dtype=bool)):
            coefficients, exclusive = Probe(device, tmp_path).edges(view, *ends, turned)
            np.testing.assert_array_equal(coefficients[:, 0].view(np.uint32), 0)
            assert set(exclusive.tolist()) == {0, 1}


FIRST_BITS: dict[str, np.ndarray] = {}
"""The first device's answer for each projection."""


@pytest.mark.small
@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_every_width_and_runtime_gives_the_same_bits(device: Device, tmp_path: Path, projection: str) -> None:
    a, b = random_ends(3, 200)
    for width in (1, 8, 16) if device.runtime == "pocl" else (device.vector_width,):
        probe = Probe(device, tmp_path, vector_width=width, projection=Projection[projection.upper()])
        bits = probe.edges(view_of(projection), a, b)[0].view(np.uint32)
        np.testing.assert_array_equal(bits, FIRST_BITS.setdefault(projection, bits))


# --- accuracy --------------------------------------------------------------------------------------


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_values_are_within_the_forward_error(device: Device, tmp_path: Path, projection: str) -> None:
    view, (a, b) = view_of(projection), random_ends(4, 600)
    probe = Probe(device, tmp_path, projection=Projection[projection.upper()])
    at = np.random.default_rng(5).integers(0, SIZE, size=(600, 2)) + 0.5 - SIZE / 2
    coefficients, exclusive = probe.edges(view, a, b)
    edges = np.repeat(coefficients[:, None], 3, axis=1)
    values, _ = probe.samples(edges, np.repeat(exclusive[:, None], 3, axis=1), at)
    scale = 2 if projection == "perspective" else 1
    exact = [scale * exact_value(view, a[k], b[k], *at[k].tolist()) for k in range(600)]
    error = np.array([abs(float(v - Fraction(float(found)))) for v, found in zip(exact, values[:, 0], strict=True)])
    relative = error / edge_error(view, a, b, at)
    assert relative.max() <= 1
    assert relative.max() > 0.05, "the bound says nothing"


def test_midpoint_keeps_the_digits_of_short_edges_far_away(device: Device, tmp_path: Path) -> None:
    """Edges of 1e-3 at a distance of 1e3: a plain a x b has the error 2u |a| |b|, a million times u |n|.

    Measured in u |n| |d|, the rounding of the last dot product; the midpoint form has 12 of these at most
    (see edge_error; |a - e| + |b - e| is |m| here).
    """
    a, b = (np.float32(600.0) + 1e-3 * ends for ends in random_ends(6, 300))
    a, b = a.astype(np.float32), b.astype(np.float32)
    different = (a != b).any(axis=1)
    a, b = a[different], b[different]
    camera = Camera("far", "perspective", (0, 0, 0), (600, 600, 600), (0, 1, 0), 1e-3)
    view, units = camera_vectors(camera, SIZE, SIZE), {}
    p, q = a.astype(np.float64), b.astype(np.float64)
    size = U * (permanent(p + q, q - p) * abs(np.array(view.center()))).sum(axis=1)
    exact = np.array([float(2 * exact_value(view, *ends, 0.0, 0.0)) for ends in zip(a, b, strict=True)])
    for rung in ("fast", "midpoint"):
        coefficients, _ = Probe(device, tmp_path, precision=Precision[rung.upper()]).edges(view, a, b)
        units[rung] = abs(coefficients[:, 0] - exact) / size
    assert units["midpoint"].max() <= 12
    assert np.quantile(units["fast"], 0.9) > 1e4


# --- the fill rule ---------------------------------------------------------------------------------


def test_a_value_of_zero_is_decided_by_the_gradient(device: Device, tmp_path: Path) -> None:
    """V(+eps, +eps^2) = eps gx + eps^2 gy: outside where that is negative. Other values are decided by their sign."""
    tiny = 2.0**-149 if device.runtime != "rusticl" else 2.0**-126
    cases = [(value, exclusive) for value in (tiny, 1.0, 0.0, -tiny, -1.0) for exclusive in (0, 1)]
    edges = np.zeros((len(cases) * 3, 3, 3), np.float32)
    exclusive = np.zeros((len(cases) * 3, 3), np.int32)
    expected = []
    for k, (value, excluded) in enumerate(cases):
        for i in range(3):
            edges[3 * k + i, :, 0] = 1.0
            edges[3 * k + i, i, 0], exclusive[3 * k + i, i] = value, excluded
            expected.append(value < 0 or (value == 0 and excluded == 1))
    _, outside = Probe(device, tmp_path).samples(edges, exclusive, np.zeros((len(edges), 2)))
    assert outside.tolist() == expected


def dyadic_triangles(seed: int, count: int, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Triangles with vertices on pixel centres and corners of `perspective(side, side)`, at distances 1 and 2.

    Coordinates are multiples of 2^-6 under 1: all of the kernel's products are exact in float32.
    """
    rng = np.random.default_rng(seed)
    half = side // 2
    x, y = rng.integers(-2 * half, 2 * half + 1, size=(2, count, 3)) / 64
    depth = rng.choice([1, 2], size=(count, 3))
    points = np.stack([x * depth, y * depth, -depth.astype(float)], axis=2)
    return points.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
@pytest.mark.parametrize("seed", range(2))
def test_samples_on_edges_and_vertices_are_decided_as_in_real_arithmetic(
    device: Device, seed: int, projection: str
) -> None:
    """Nothing is rounded here, so that every sample must be right, also those on edges and vertices."""
    side = 12
    points, triangles = dyadic_triangles(seed, 24, side)
    view = perspective(side, side)
    if projection == "orthographic":
        points, view = points * 32, orthographic(side, side, e0=(-side / 2, side / 2, 0))
    scene = make_scene(points, triangles)
    expected, t, _ = ref.visible_triangles(scene.positions, scene.triangles, view.named(), side, side)
    frame = render(device, scene, view, aov=("id", "depth"))
    np.testing.assert_array_equal(frame["id.prim"], expected)
    np.testing.assert_array_equal(frame["Z"], t.astype(np.float32))


def fan(count: int, phase: float, center_depth: float) -> tuple[np.ndarray, np.ndarray]:
    """A closed fan round the centre of pixel (4, 4) of an 8 x 8 `perspective` view.

    Ring points are multiples of 2^-8: with them, too, nothing is rounded.
    """
    angles = 2 * math.pi * (np.arange(count) / count) + phase
    middle = np.array([2.0**-6, -(2.0**-6)])
    ring = np.round(256 * (middle + 0.1 * np.stack([np.cos(angles), np.sin(angles)], axis=1))) / 256
    ring = np.concatenate([ring, -np.ones((count, 1))], axis=1)
    hub = center_depth * np.array([*middle, -1.0])
    triangles = [(0, 1 + k, 1 + (k + 1) % count) for k in range(count)]
    return np.concatenate([hub[None], ring]), np.array(triangles)


FANS = [(4, 0.0), (4, math.pi / 4), (4, 1.0), (6, 0.0), (6, 0.3)]


@pytest.mark.parametrize(
    ("count", "phase", "center_depth"),
    [(*one, depth) for one in FANS for depth in (1.0, 2.0, 0.5)] + [(50, 0.5, 2.0)],
)
def test_a_fan_covers_its_hub_and_all_else_just_once(
    device: Device, count: int, phase: float, center_depth: float
) -> None:
    points, triangles = fan(count, phase, center_depth)
    if count == 6:
        triangles = triangles[:, ::-1]  # seen from behind
    scene, view = make_scene(points, triangles), perspective(8, 8)
    covered = coverage(device, scene, view)
    camera, exact = ref.exact_camera(view.named()), np.zeros_like(covered)
    for j in range(8):
        for i in range(8):
            for hit in ref.hits_at(ref.exact_triangles(scene.positions, scene.triangles), camera, i, j):
                exact[hit.prim_id, j, i] = True
    np.testing.assert_array_equal(covered, exact)
    counts = covered.sum(axis=0)
    assert counts.max() == 1 and counts[4, 4] == 1 and counts[3:6, 3:6].sum() == 9


def quad(angle: float, side: int, is_flipped: bool) -> tuple[np.ndarray, np.ndarray]:
    """A square of two triangles, turned round the centre of a pixel, so that its diagonal meets pixel centres."""
    middle = np.array([0.5, -0.5]) * 2.0**-5
    corners = 0.35 * side * 2.0**-5 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    flat = middle + np.array([turn[:, 0] * x + turn[:, 1] * y for x, y in corners])
    triangles = [(0, 1, 2), (0, 3, 2) if is_flipped else (2, 3, 0)]
    return np.concatenate([flat, -np.ones((4, 1))], axis=1), np.array(triangles)


@pytest.mark.parametrize("depth", [0.1, 1.0, 4.0])
@pytest.mark.parametrize("is_flipped", [False, True])
def test_quads_at_many_angles_have_no_seam(device: Device, is_flipped: bool, depth: float) -> None:
    """dEQP's rotated quads: two triangles, 16 angles from 0 to 90 degrees, w in 0.1 .. 4; overlap and gaps counted."""
    side, view = 32, perspective(32, 32)
    for k in range(16):
        points, triangles = quad(math.radians(90 * k / 16), side, is_flipped)
        scene = make_scene(points * depth, triangles)
        counts = coverage(device, scene, view).sum(axis=0)
        exact = exact_visibility(scene.positions, scene.triangles, view.named(), side, side)
        assert counts.max() == 1
        judge = Classifier(scene.positions, scene.triangles, view.named())
        for j, i in np.argwhere((counts == 1) != (exact.prim_id != NO_HIT)).tolist():
            # A sample may differ where an outer edge passes within rounding; the diagonal is edge 1 of both.
            assert all(1 not in judge.near_edges(prim_id, i, j) for prim_id in (0, 1))
            assert judge.near_edges(0, i, j) or judge.near_edges(1, i, j)
        on_diagonal = range(-8, 9) if k == 0 else (0,)
        assert all(judge.near_edges(0, 16 + m, 16 - m) == [1] for m in on_diagonal), "the seam meets no sample"
        assert counts.sum() > 400


def bumpy_sheet(view: CameraVectors, step: int = 2) -> Scene:
    """A sheet over the whole view, its vertices at every `step`-th pixel centre but for rounding to float32.

    So nearly every sample lies within rounding of an edge, and one in step^2 of a vertex.
    """
    side = view.width
    k = np.arange(-step, side + step + 1, step) + 0.5
    x, y = np.meshgrid(k, k)
    swept = [
        view.first[c] + x * view.tangent_x[c] + y * view.tangent_y[c] for c in range(3)
    ]
    depth = 3 + 0.01 * np.sin(x * 1.7 + y * y)
    if view.projection == "orthographic":
        points = [swept[c] + depth * view.direction[c] for c in range(3)]
    else:
        points = [view.origin[c] + depth * swept[c] for c in range(3)]
    across = len(k)
    corners = [across * j + i for j in range(across - 1) for i in range(across - 1)]
    triangles = [t for c in corners for t in ((c, c + across, c + across + 1), (c, c + across + 1, c + 1))]
    return make_scene(np.stack(points, axis=2).reshape(-1, 3), triangles)


@pytest.mark.parametrize(("projection", "rung"), VIEWS)
def test_samples_aimed_at_edges_meet_one_triangle(device: Device, projection: str, rung: str) -> None:
    """No hole and no double hit along edges, in every rung; at vertices float32 promises nothing."""
    side = 32
    view = view_of(projection, side)
    scene = bumpy_sheet(view)
    exact = exact_visibility(scene.positions, scene.triangles, view.named(), side, side)
    assert (exact.prim_id != NO_HIT).all()
    frame = render(device, scene, view, aov=("id", "depth"), precision=rung)
    judged = classify(scene.positions, scene.triangles, view.named(), exact, frame["id.prim"], frame["Z"])
    assert judged.neighbour_count > 10, "no sample is on an edge: the test tests nothing"
    edge_samples = np.ones((side, side), dtype=bool)
    edge_samples[0::2, 0::2] = False
    assert (frame["id.prim"][edge_samples] != NO_HIT).all()
    assert judged.hole_along_edge_count == 0

    def render_part(chosen: np.ndarray) -> np.ndarray:
        part = make_scene(scene.positions, scene.triangles[chosen])
        return render_ids(device, part, view, precision=rung)

    doubles = double_hits(render_part, scene.positions, scene.triangles, view.named())
    assert [one for one in doubles if one.place == "edge"] == []


# --- blocks ----------------------------------------------------------------------------------------


@pytest.mark.small
@pytest.mark.parametrize("scale", [1.0, 1e-30, 1e30])
def test_the_highest_value_of_a_block_is_that_of_a_sample(device: Device, tmp_path: Path, scale: float) -> None:
    """block_highest against edge_value at all samples of blocks of up to 4 x 4: equal, for any coefficients."""
    rng = np.random.default_rng(8)
    count, side = 300, 4
    edges = (rng.normal(size=(count, 3)) * scale * 10.0 ** rng.uniform(-4, 4, size=(count, 3))).astype(np.float32)
    edges[rng.random(size=(count, 3)) < 0.1] = 0.0
    edges[0], edges[1] = (0, -0.0, -0.0), (scale, 0, -scale)
    low = rng.integers(-5000, 5000, size=(count, 2)) + 0.5
    high = low + rng.integers(0, side, size=(count, 2))
    probe = Probe(device, tmp_path)
    (highest,) = probe.run(
        "probe_blocks",
        count,
        {"highest": (np.float32, 1)},
        edges=np.ascontiguousarray(edges.T),
        blocks=np.ascontiguousarray(np.concatenate([low, high], axis=1).T, dtype=np.float32),
    )
    found = np.full(count, -np.inf, dtype=np.float32)
    for j in range(side):
        for i in range(side):
            at = np.minimum(low + (i, j), high)
            values, _ = probe.samples(np.repeat(edges[:, None], 3, axis=1), np.zeros((count, 3)), at)
            found = np.maximum(found, values[:, 0])
    assert np.isfinite(found).all()
    np.testing.assert_array_equal(highest[0], found)
