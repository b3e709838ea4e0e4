"""Rays through scenes: hits and their order as in real arithmetic, no leaks, no hit of what a ray leaves."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from ray_worlds import (
    FAR_CENTER,
    TARGETS,
    Mesh,
    Rays,
    aimed_rays,
    box,
    bumpy_sphere,
    closest_bytes,
    icosphere,
    kernel_radius,
    lattice_rays,
    lattice_soup,
    limited_rays,
    lost_in_bounces,
    one_box,
    placed,
    rays_from_inside,
    rays_from_outside,
    reintersections,
    soup_of_scales,
    tetrahedron,
    tilted_box,
)
from reference import all_hits, exact_triangles, general_ray, vector

from clrast.errors import DeviceError, SceneError, UsageError
from clrast.opencl.device import VECTOR_WIDTHS, Device
from clrast.opencl.layout import NO_HIT
from clrast.visibility.loop_limits import loop_limit
from clrast.visibility.rays import RayTracer, make_tracer


@pytest.fixture(autouse=True)
def _device_takes_long_loops(request: pytest.FixtureRequest) -> None:
    if "refuses" in request.node.name or "device" not in request.fixturenames:
        return
    device = request.getfixturevalue("device")
    if loop_limit(device) is not None:
        pytest.skip(f"{device.runtime} limits loops: rays are refused there, which another test holds")


def worlds() -> dict[str, tuple[Mesh, Rays]]:
    small = bumpy_sphere(3, 6)
    cases = {
        "lattice": (lattice_soup(60, 1), lattice_rays(150, 2)),
        "dense lattice": (lattice_soup(80, 3, 2), lattice_rays(150, 4, 2)),
        "bumpy sphere": (small, aimed_rays(small, 40, 5)),
    }
    for scale in (1e-8, 1e8):
        mesh = placed(small, scale)
        cases[f"bumpy sphere {scale:g}"] = (mesh, aimed_rays(mesh, 25, 6))
    far = placed(small, 2.0, FAR_CENTER)
    cases["far away"] = (far, aimed_rays(far, 25, 7))
    soup = soup_of_scales(60, 8)
    cases["all scales"] = (soup, aimed_rays(soup, 40, 9))
    long = lattice_rays(60, 10)
    cases["long directions"] = (lattice_soup(60, 1), (long[0], long[1] * np.float32(2.0**50)))
    cases["short directions"] = (lattice_soup(60, 1), (long[0], long[1] * np.float32(2.0**-50)))
    return cases


WORLDS = worlds()


def check_against_reference(tracer: RayTracer, mesh: Mesh, rays: Rays) -> int:
    """The first hits are those of real arithmetic, t within its bound; returns how many rays hit something."""
    found = tracer.closest(*rays)
    scene = exact_triangles(*mesh)
    hit_count = 0
    for k, (origin, direction) in enumerate(zip(*rays, strict=True)):
        hits = all_hits(scene, general_ray(vector(origin), vector(direction)), True)
        if not hits:
            assert found.prim_id[k] == NO_HIT and found.t[k] == np.inf
            continue
        hit_count += 1
        assert found.prim_id[k] == hits[0].prim_id, f"ray {k}: {origin} {direction}"
        # The bound is rounded twice itself.
        doubt = Fraction(float(found.t_error[k])) * Fraction(1 + 2.0**-22)
        assert abs(Fraction(float(found.t[k])) - hits[0].t) <= doubt, f"ray {k}: t {found.t[k]}, not {float(hits[0].t)}"
        assert (found.barycentrics[k] >= 0).all() and abs(found.barycentrics[k].astype(float).sum() - 1) < 4 * 2.0**-24
    assert (tracer.any(*rays) == (found.prim_id != NO_HIT)).all()
    return hit_count


@pytest.mark.parametrize("name", WORLDS)
def test_first_hits_are_those_of_real_arithmetic(device: Device, name: str) -> None:
    mesh, rays = WORLDS[name]
    assert check_against_reference(make_tracer(device, *mesh), mesh, rays) > len(rays[0]) // 4


@pytest.mark.small
def test_a_few_rays_of_each_kind(device: Device) -> None:
    mesh, rays = lattice_soup(20, 1), lattice_rays(12, 2)
    check_against_reference(make_tracer(device, *mesh), mesh, rays)
    origins = make_tracer(device, *mesh).leave(np.zeros(2), np.full((2, 3), 1 / 3), rays[1][:2])
    assert np.isfinite(origins).all()


def test_barycentrics_are_those_of_the_file_s_order(device: Device) -> None:
    mesh = icosphere(1)
    rng = np.random.default_rng(1)
    prims = rng.integers(0, len(mesh[1]), 500)
    weights = rng.dirichlet((2, 2, 2), 500)
    at = (mesh[0].astype(np.float64)[mesh[1][prims]] * weights[:, :, None]).sum(axis=1)
    found = make_tracer(device, *mesh).closest(np.zeros((500, 3)), at)
    inside = weights.min(axis=1) > 1e-5
    assert (found.prim_id == prims)[inside].all()
    # Edge functions of triangles about as large as they are far: some tens of roundings of values about 1.
    assert np.abs(found.barycentrics - weights)[inside].max() < 64 * 2.0**-24


# --- the hierarchy changes nothing ------------------------------------------------------------------


@pytest.mark.parametrize("name", ["clutter", "bumpy", "all scales", "lattice"])
def test_the_hierarchy_changes_no_bit(device: Device, name: str) -> None:
    rng = np.random.default_rng(11)
    corners = rng.random((2000, 1, 3)) + 0.2 * (rng.random((2000, 3, 3)) - 0.5)
    clutter = corners.reshape(-1, 3).astype(np.float32), np.arange(6000, dtype=np.uint32).reshape(-1, 3)
    soup = soup_of_scales(300, 12)
    bumpy = bumpy_sphere(13)
    mesh, rays = {
        "clutter": (clutter, aimed_rays(clutter, 700, 14)),
        "bumpy": (bumpy, aimed_rays(bumpy, 700, 14)),
        "all scales": (soup, aimed_rays(soup, 200, 14)),
        "lattice": (lattice_soup(300, 15), lattice_rays(1500, 16)),
    }[name]
    tracer, brute = make_tracer(device, *mesh), make_tracer(device, *mesh, bvh=one_box(mesh))
    assert closest_bytes(tracer, *rays) == closest_bytes(brute, *rays)
    limited = limited_rays(tracer, rays, 17)
    found = tracer.closest(*limited)
    assert closest_bytes(tracer, *limited) == closest_bytes(brute, *limited)
    is_hit = found.prim_id != NO_HIT
    assert 0 < is_hit.sum() < len(is_hit)
    assert ((found.t > limited[2]) & (found.t < limited[3]) & (found.prim_id != limited[4]))[is_hit].all()
    assert (tracer.any(*limited) == is_hit).all() and (brute.any(*limited) == is_hit).all()


@pytest.mark.long
def test_neither_vector_width_nor_float64_changes_a_bit(device: Device) -> None:
    mesh = bumpy_sphere(18)
    rays = [np.concatenate(pair) for pair in zip(aimed_rays(mesh, 100, 19), lattice_rays(100, 19), strict=True)]
    devices = [replace(device, vector_width=width) for width in VECTOR_WIDTHS]
    found = [closest_bytes(make_tracer(d, *mesh), *rays) for d in (*devices, replace(device, has_fp64=False))]
    assert all(other == found[0] for other in found)


# --- no leaks ---------------------------------------------------------------------------------------


def closed_meshes() -> dict[str, Mesh]:
    return {
        "icosphere": icosphere(3),
        "icosphere 1e-8": placed(icosphere(3), 1e-8),
        "icosphere 1e8": placed(icosphere(3), 1e8),
        "icosphere far away": placed(icosphere(3), 2.0, FAR_CENTER),
        "box": box(),
        "bumpy sphere": bumpy_sphere(20, bumps=0.04),
        "bumpy sphere far away": placed(bumpy_sphere(20, bumps=0.04), 2.0, FAR_CENTER),
    }


CLOSED = closed_meshes()


@pytest.mark.parametrize("name", CLOSED)
def test_no_ray_leaks_into_or_out_of_a_closed_mesh(device: Device, name: str) -> None:
    mesh = CLOSED[name]
    tracer = make_tracer(device, *mesh)
    rng = np.random.default_rng(21)
    size = float(np.ptp(mesh[0].astype(np.float64), axis=0).max()) / 2
    reach = kernel_radius(mesh)
    assert reach > 0.1 * size
    for kind in TARGETS:
        inside = rays_from_inside(mesh, kind, 4000, rng, 0.9 * reach)
        first = tracer.closest(*inside).prim_id
        assert (first != NO_HIT).all(), f"from inside at {kind}"
        assert tracer.any(*inside).all()
        assert not tracer.any(*inside, excluded=first).any(), f"each meets the surface once, also at {kind}"
        outside = rays_from_outside(mesh, kind, 4000, rng, 0.9 * reach)
        # The target is at 1, where the line comes nearest to the centre over 1.1, and the far side beyond that.
        assert (tracer.closest(*outside).t < 1.05).all(), f"from outside at {kind}"


def test_no_ray_leaks_out_of_a_rough_sphere(device: Device) -> None:
    mesh = bumpy_sphere(29, bumps=0.3)
    assert kernel_radius(mesh) < 0.2, "from some origins parts of it hide others"
    tracer = make_tracer(device, *mesh)
    for kind in TARGETS:
        # Radii of 0.7 and more, and faces within an angle of 0.4 of their middles, leave a ball of 0.64 inside.
        rays = rays_from_inside(mesh, kind, 4000, np.random.default_rng(30), 0.4)
        assert (tracer.closest(*rays).prim_id != NO_HIT).all() and tracer.any(*rays).all()


def test_the_leak_test_sees_a_missing_triangle(device: Device) -> None:
    positions, triangles = icosphere(3)
    tracer = make_tracer(device, positions, triangles[1:])
    hits = tracer.closest(*rays_from_inside((positions, triangles), "random", 4000, np.random.default_rng(22), 0.4))
    assert 0 < (hits.prim_id == NO_HIT).sum() < 30


# --- rays that leave --------------------------------------------------------------------------------


def test_no_ray_hits_what_it_leaves(device: Device) -> None:
    left, again = reintersections(device, 60, 500, np.random.default_rng(23))
    assert left > 60 * 500 * 0.8
    assert again == 0


def test_without_the_offset_rays_do_hit_what_they_leave(device: Device) -> None:
    mesh = icosphere(2)
    tracer = make_tracer(device, *mesh)
    rng = np.random.default_rng(24)
    rays = rays_from_inside(mesh, "random", 2000, rng, 0.3)
    hits = tracer.closest(*rays)
    points = (mesh[0][mesh[1][hits.prim_id]] * hits.barycentrics[:, :, None]).sum(axis=1)
    outwards = rng.normal(size=points.shape).astype(np.float32)
    outwards *= np.sign((outwards * points).sum(axis=1))[:, None]
    assert tracer.any(points, outwards).sum() > 200


@pytest.mark.parametrize("name", ["tilted box", "tetrahedron", "far box", "icosphere"])
def test_rays_that_bounce_inside_a_closed_mesh_stay_inside(device: Device, name: str) -> None:
    mesh = {
        "tilted box": tilted_box(),
        "tetrahedron": tetrahedron(),
        "far box": placed(tilted_box(), 2.0, FAR_CENTER),
        "icosphere": icosphere(2),
    }[name]
    tracer = make_tracer(device, *mesh)
    for kind in TARGETS:
        traced, lost = lost_in_bounces(tracer, mesh, kind, 2000, np.random.default_rng(28))
        assert (traced, lost) == (10000, 0), f"at {kind}"


@pytest.mark.parametrize("scale", [1e-8, 1e-4, 1.0, 1e4, 1e8])
@pytest.mark.parametrize("kind", TARGETS)
def test_rays_that_leave_a_convex_mesh_hit_nothing(device: Device, kind: str, scale: float) -> None:
    mesh = placed(icosphere(2), scale)
    corners = mesh[0].astype(np.float64)[mesh[1]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    heights = normals @ mesh[0].astype(np.float64).T - (normals * corners[:, 0]).sum(axis=1)[:, None]
    of_face = np.zeros(heights.shape, dtype=bool)
    np.put_along_axis(of_face, mesh[1].astype(np.int64), True, axis=1)
    assert (heights[~of_face] < 0).all(), "the mesh is convex"
    tracer = make_tracer(device, *mesh)
    rng = np.random.default_rng(25)
    hits = tracer.closest(*rays_from_inside(mesh, kind, 2000, rng, 0.3 * scale))
    outwards = rng.normal(size=(2000, 3))
    outwards *= np.sign((outwards * normals[hits.prim_id]).sum(axis=1))[:, None]
    starts = tracer.leave(hits.prim_id, hits.barycentrics, outwards)
    assert not tracer.any(starts, outwards).any()


def test_an_origin_is_close_to_the_point_and_on_the_side_that_the_ray_goes_to(device: Device) -> None:
    mesh = placed(bumpy_sphere(26), 2.0, FAR_CENTER)
    tracer = make_tracer(device, *mesh)
    rng = np.random.default_rng(27)
    prims = rng.integers(0, len(mesh[1]), 500)
    weights = rng.dirichlet((1, 1, 1), 500).astype(np.float32)
    directions = rng.normal(size=(500, 3)).astype(np.float32)
    starts = tracer.leave(prims, weights, directions)
    for triangle, start, direction in zip(mesh[0][mesh[1][prims]], starts, directions, strict=True):
        p0, p1, p2 = (vector(p) for p in triangle)
        e, f = [b - a for a, b in zip(p0, p1, strict=True)], [b - a for a, b in zip(p0, p2, strict=True)]
        normal = [e[i - 2] * f[i - 1] - e[i - 1] * f[i - 2] for i in range(3)]
        height = sum(n * (a - b) for n, a, b in zip(normal, vector(start), p0, strict=True))
        slope = sum(n * d for n, d in zip(normal, vector(direction), strict=True))
        assert height * slope > 0
    points = (mesh[0].astype(np.float64)[mesh[1][prims]] * weights[:, :, None]).sum(axis=1)
    # The bound is 8 roundings of the point's coordinates, along the normal: up to 3 times as far, and one rounding.
    assert np.abs(starts - points).max() < 32 * 2.0**-24 * np.abs(FAR_CENTER).max()


# --- what is refused --------------------------------------------------------------------------------


def test_a_driver_that_limits_loops_refuses_rays(device: Device) -> None:
    if loop_limit(device) is None:
        make_tracer(device, *icosphere(0))
    else:
        with pytest.raises(DeviceError, match="ends long loops early.*--device pocl"):
            make_tracer(device, *icosphere(0))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"directions": [[0, 0, 0]]}, "direction must have a size within"),
        ({"directions": [[np.nan, 1, 0]]}, "direction must have a size within"),
        ({"directions": [[2.0**61, 1, 0]]}, "direction must have a size within"),
        ({"directions": [[1, 0]]}, "directions of 1 rays are 1 x 3 numbers, not 1 x 2"),
        ({"origins": [[np.inf, 0, 0]]}, "origin of a ray lies farther than"),
        ({"t_min": -1.0}, "t_min of a ray must be 0 or more"),
        ({"t_max": np.nan}, "t_max a number"),
        ({"excluded": np.zeros(2, np.uint32)}, "1 rays need as many excluded prim_ids, not 2"),
    ],
)
def test_rays_out_of_range_are_told_apart(device: Device, change: dict, message: str) -> None:
    tracer = make_tracer(device, *icosphere(0))
    with pytest.raises(UsageError, match=message):
        tracer.closest(**{"origins": [[0, 0, 0]], "directions": [[0, 0, 1]], **change})


def test_what_cannot_be_traced_or_left_is_said(device: Device) -> None:
    with pytest.raises(SceneError, match="no triangle"):
        make_tracer(device, np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32))
    with pytest.raises(SceneError, match="too far for rays"):
        make_tracer(device, *placed(icosphere(0), 1e30))
    flat = make_tracer(device, np.zeros((3, 3), np.float32), np.array([[0, 1, 2]], np.uint32))
    with pytest.raises(SceneError, match="triangle 0 has no area"):
        flat.leave(np.zeros(1), np.full((1, 3), 1 / 3), np.ones((1, 3)))
    with pytest.raises(UsageError, match="rays can leave prim_id 0 to 0, not 7"):
        flat.leave(np.full(1, 7), np.full((1, 3), 1 / 3), np.ones((1, 3)))


def test_no_rays_give_empty_arrays(device: Device) -> None:
    tracer = make_tracer(device, *icosphere(0))
    nothing = np.zeros((0, 3), np.float32)
    assert tracer.closest(nothing, nothing).prim_id.shape == (0,)
    assert tracer.any(nothing, nothing).shape == (0,)
    assert tracer.leave(np.zeros(0), nothing, nothing).shape == (0, 3)
