"""Any rays through a uniform grid: the bits of all triangles one by one, wherever rays start and go."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from ray_worlds import (
    FAR_CENTER,
    Mesh,
    Rays,
    aimed_rays,
    box,
    bumpy_sphere,
    closest_bytes,
    icosphere,
    lattice_rays,
    lattice_soup,
    limited_rays,
    one_box,
    placed,
    scaled_numbers,
    soup_of_scales,
    targets,
)

from clrast.errors import CapacityError
from clrast.opencl.device import VECTOR_WIDTHS, Device, open_device
from clrast.opencl.layout import NO_HIT
from clrast.visibility.geometry import build_geometry
from clrast.visibility.ray_grid import GridRequest, build_ray_grid
from clrast.visibility.rays import RayTracer, make_tracer, ray_features

PLENTY = 1 << 30


@pytest.fixture(scope="module")
def tracing_device(first_device: Device) -> Device:
    """With vectors as wide as the device takes."""
    return open_device(first_device.runtime)


def through_grid(device: Device, mesh: Mesh, resolution: int | None = None) -> RayTracer:
    return make_tracer(device, *mesh, grid=GridRequest(PLENTY, resolution))


def changed(device: Device, mesh: Mesh, resolution: int, **fields: float) -> RayTracer:
    """A tracer whose grid says something else of itself."""
    features = ray_features(device, None)
    geometry = build_geometry(device, features, *mesh, 1.0)
    grid = build_ray_grid(device, features, geometry, *mesh, GridRequest(PLENTY, resolution))
    return RayTracer(device, features, geometry, grid=replace(grid, **fields))


def assert_same(found: RayTracer, expected: RayTracer, rays: Rays) -> int:
    """Both answer alike, bit for bit, also rays of limited length; returns how many hit something."""
    hits = expected.closest(*rays)
    assert closest_bytes(found, *rays) == closest_bytes(expected, *rays)
    assert (found.any(*rays) == (hits.prim_id != NO_HIT)).all()
    limited = limited_rays(expected, rays, 1)
    for excluded in (limited[4], np.full(len(hits.t), NO_HIT, np.uint32)):
        arguments = (*limited[:4], excluded)
        assert closest_bytes(found, *arguments) == closest_bytes(expected, *arguments)
        assert (found.any(*arguments) == expected.any(*arguments)).all()
    return int((hits.prim_id != NO_HIT).sum())


# --- rays that lie as they should not ---------------------------------------------------------------


def wall_rays(tracer: RayTracer, count: int, seed: int) -> Rays:
    """Rays along and through walls, edges and corners of cells.

    Origins lie on planes, in or up to two cells beside the grid; directions go along axes, also with components of -0,
    through cells' corners, or a rounding beside such.
    """
    grid = tracer._scene["grid"]
    rng = np.random.default_rng(seed)
    low, cell = grid["low"][:3].astype(np.float64), grid["cell"][:3].astype(np.float64)
    counts = np.array([grid["columns"], grid["rows"], grid["layers"]])
    planes = rng.integers(-2, counts + 3, (count, 3))
    origins = low + cell * (planes + np.where(rng.random((count, 3)) < 0.7, 0, rng.random((count, 3))))
    directions = rng.integers(-1, 2, (count, 3)) * cell
    directions[(directions == 0).all(axis=1)] = (0, 0, cell[2])
    directions = (directions * rng.choice([1, 1, 2, 0.5], (count, 1))).astype(np.float32)
    negative = (directions == 0) & (rng.random((count, 3)) < 0.5)
    directions[negative] = np.float32(-0.0)
    beside = rng.random((count, 3)) < 0.1
    directions[beside] = np.nextafter(directions[beside], np.float32(1))
    return origins.astype(np.float32), directions


def plates(count: int, seed: int) -> Mesh:
    """Large triangles all over, a third of them hardly wider than a rounding."""
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(count, 3, 3))
    thin = corners[: count // 3]
    thin[:, 2] = thin[:, 0] + (thin[:, 1] - thin[:, 0]) * rng.random((len(thin), 1))
    thin[:, 2] += 10.0 ** rng.uniform(-7, -2, (len(thin), 1)) * rng.normal(size=(len(thin), 3))
    return corners.reshape(-1, 3).astype(np.float32), np.arange(3 * count, dtype=np.uint32).reshape(-1, 3)


def grazing_rays(mesh: Mesh, count: int, seed: int) -> Rays:
    """Rays that meet triangles nearly along their planes, where float32 has hardly an idea of t."""
    rng = np.random.default_rng(seed)
    corners = mesh[0].astype(np.float64)[mesh[1][rng.integers(0, len(mesh[1]), count)]]
    ends = [(rng.dirichlet((1, 1, 1), count)[:, :, None] * corners).sum(axis=1) for _ in range(2)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.sqrt((normals * normals).sum(axis=1))[:, None]
    sizes = np.ptp(corners, axis=1).max(axis=1)[:, None]
    lift = 10.0 ** rng.uniform(-7.5, -4, (count, 1)) * sizes * normals / np.where(lengths == 0, 1, lengths)
    origins = (ends[0] - (ends[1] - ends[0]) * rng.uniform(0.2, 2, (count, 1)) + lift).astype(np.float32)
    return origins, (ends[1] - origins).astype(np.float32)


def flat(seed: int, axis: int, height: float = 0.25) -> Mesh:
    """Triangles of one plane across an axis, overlapping."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-1, 1, (200, 1, 3)) + 0.3 * rng.uniform(-1, 1, (200, 3, 3))
    corners[..., axis] = height
    return corners.reshape(-1, 3).astype(np.float32), np.arange(600, dtype=np.uint32).reshape(-1, 3)


def meshes() -> dict[str, Mesh]:
    bumpy = bumpy_sphere(1, 10)
    return {
        "lattice": lattice_soup(200, 2),
        "box": box(),
        "bumpy": bumpy,
        "far away": placed(bumpy, 2.0, FAR_CENTER),
        "large": placed(bumpy, 2.0**56),
        "small": placed(bumpy, 1e-8),
        "under all padding": placed(bumpy, 1e-13, (1e-13, 0, 0)),
        "nearly a point": placed(bumpy, 1e-6, (1.0, 2.0, -3.0)),
        "all scales": soup_of_scales(150, 3),
        "plates": plates(150, 4),
        "flat x": flat(5, 0),
        "flat z": flat(6, 2),
        "one triangle": plates(1, 7),
    }  # fmt: skip


MESHES = meshes()
RESOLUTIONS = (None, 1, 9)


@pytest.mark.parametrize("name", MESHES)
def test_the_grid_changes_no_bit(tracing_device: Device, name: str) -> None:
    mesh = MESHES[name]
    brute = make_tracer(tracing_device, *mesh, bvh=one_box(mesh))
    met = 0
    for resolution in RESOLUTIONS:
        tracer = through_grid(tracing_device, mesh, resolution)
        assert tracer.accelerator == "grid"
        several = [aimed_rays(mesh, 200, 11), grazing_rays(mesh, 400, 12), wall_rays(tracer, 600, 13)]
        usable = [np.abs(each[1]).max(axis=1) >= 2.0**-60 for each in several]
        rays = [np.concatenate([each[k][keep] for each, keep in zip(several, usable, strict=True)]) for k in (0, 1)]
        met += assert_same(tracer, brute, (rays[0], rays[1]))
    assert met > 500


def test_whole_numbers_on_walls(tracing_device: Device) -> None:
    """Rays and triangles of whole numbers: edges, corners and planes are met exactly, copies decided by their ids."""
    mesh = lattice_soup(300, 14)
    brute = make_tracer(tracing_device, *mesh, bvh=one_box(mesh))
    for resolution in (None, 8, 40):
        assert assert_same(through_grid(tracing_device, mesh, resolution), brute, lattice_rays(1500, 15)) > 200


def test_directions_of_any_length(tracing_device: Device) -> None:
    mesh, (origins, directions) = lattice_soup(200, 16), lattice_rays(500, 17)
    brute, tracer = make_tracer(tracing_device, *mesh, bvh=one_box(mesh)), through_grid(tracing_device, mesh, 12)
    for exponent in (-58, -20, 30, 58):
        assert assert_same(tracer, brute, (origins, directions * np.float32(2.0**exponent))) > 50
    slanted = directions + np.float32(1e-30) * lattice_rays(500, 18)[1]
    slanted[directions != 0] = directions[directions != 0]
    assert assert_same(tracer, brute, (origins, slanted)) > 50


# --- what keeps it right ----------------------------------------------------------------------------


def test_rays_from_far_away(tracing_device: Device) -> None:
    """A ray from where rounding exceeds cells' padding visits all of them; were it to walk, it would miss."""
    mesh = bumpy_sphere(21, 12)
    rng = np.random.default_rng(22)
    origins = (rng.normal(size=(300, 3)) * rng.choice([1e4, 1e6, 1e7], (300, 1))).astype(np.float32)
    rays = origins, (targets(mesh, "random", 300, rng) - origins).astype(np.float32)
    brute, tracer = make_tracer(tracing_device, *mesh, bvh=one_box(mesh)), through_grid(tracing_device, mesh, 30)
    assert assert_same(tracer, brute, rays) > 50
    walking = changed(tracing_device, mesh, 30, farthest=np.inf)
    assert closest_bytes(walking, *rays) != closest_bytes(brute, *rays)


def test_a_limit_of_t_is_for_t_as_reported(tracing_device: Device) -> None:
    """Where a triangle is seen edge-on t may be reported well before the hit: the walk goes on for that long."""
    mesh = plates(150, 24)
    brute, tracer = make_tracer(tracing_device, *mesh, bvh=one_box(mesh)), through_grid(tracing_device, mesh, 60)
    rays = grazing_rays(mesh, 20000, 25)
    t = brute.closest(*rays).t
    limited = (*rays, np.zeros_like(t), np.nextafter(np.where(np.isfinite(t), t, 1), np.float32(np.inf)))
    assert closest_bytes(tracer, *limited) == closest_bytes(brute, *limited)
    assert (tracer.any(*limited) == brute.any(*limited)).all()
    hasty = changed(tracing_device, mesh, 60, longest=0.0)
    assert closest_bytes(hasty, *limited) != closest_bytes(brute, *limited)


def test_rays_leave_alike(tracing_device: Device) -> None:
    mesh = bumpy_sphere(26)
    rng = np.random.default_rng(27)
    prims, weights = rng.integers(0, len(mesh[1]), 400), rng.dirichlet((1, 1, 1), 400).astype(np.float32)
    directions = rng.normal(size=(400, 3)).astype(np.float32)
    tracer, other = through_grid(tracing_device, mesh), make_tracer(tracing_device, *mesh)
    starts = tracer.leave(prims, weights, directions)
    assert starts.tobytes() == other.leave(prims, weights, directions).tobytes()
    excluded = prims.astype(np.uint32)
    away = [closest_bytes(each, starts, directions, 0.0, np.inf, excluded) for each in (tracer, other)]
    assert away[0] == away[1]


@pytest.mark.long
def test_neither_vector_width_nor_float64_changes_a_bit(tracing_device: Device) -> None:
    mesh = bumpy_sphere(28)
    rays = [np.concatenate(pair) for pair in zip(aimed_rays(mesh, 200, 29), lattice_rays(200, 29), strict=True)]
    devices = [replace(tracing_device, vector_width=width) for width in VECTOR_WIDTHS]
    others = (*devices, replace(tracing_device, has_fp64=False))
    expected = closest_bytes(make_tracer(tracing_device, *mesh), *rays)
    for resolution in (None, 2):  # few triangles in a cell, and many more than a vector has
        found = [closest_bytes(through_grid(device, mesh, resolution), *rays) for device in others]
        assert all(other == expected for other in found)


@pytest.mark.long
def test_many_worlds_of_all_kinds(tracing_device: Device) -> None:
    for seed in range(60):
        rng = np.random.default_rng(seed)
        soup, bumpy = soup_of_scales(80, seed), bumpy_sphere(seed, 8)
        kinds = (lattice_soup(150, seed), plates(100, seed), soup, bumpy, flat(seed, 1))
        mesh = placed(kinds[seed % len(kinds)], float(abs(scaled_numbers(rng, (1,))[0])), rng.normal(size=3))
        brute = make_tracer(tracing_device, *mesh, bvh=one_box(mesh))
        tracer = through_grid(tracing_device, mesh, int(rng.integers(1, 40)))
        for rays in (aimed_rays(mesh, 300, seed), grazing_rays(mesh, 900, seed), wall_rays(tracer, 1500, seed)):
            keep = np.abs(rays[1]).max(axis=1) >= 2.0**-60
            assert_same(tracer, brute, (rays[0][keep], rays[1][keep]))


def test_a_grid_that_does_not_fit_says_so(tracing_device: Device) -> None:
    mesh = icosphere(3)
    with pytest.raises(CapacityError, match="bytes of device memory.*give a smaller --grid-resolution"):
        make_tracer(tracing_device, *mesh, grid=GridRequest(1 << 20, 200))
    with pytest.raises(CapacityError, match="for secondary rays takes .* or --accelerator bvh"):
        make_tracer(tracing_device, *mesh, grid=GridRequest(130_000, 12))
