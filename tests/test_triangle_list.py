"""Scenes of so few triangles that rays meet each of them: the bits of the walk, whatever is in doubt."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from patched_kernels import patched
from ray_worlds import (
    FAR_CENTER,
    Mesh,
    Rays,
    aimed_rays,
    box,
    bumpy_sphere,
    closest_bytes,
    lattice_rays,
    lattice_soup,
    limited_rays,
    placed,
    soup_of_scales,
)

from clrast.opencl import buffers
from clrast.opencl.device import Device
from clrast.opencl.layout import LIST_WORDS, MAX_LISTED, NO_HIT
from clrast.visibility import rays as rays_module
from clrast.visibility.loop_limits import loop_limit
from clrast.visibility.ray_arrays import RayBuffers
from clrast.visibility.rays import RayTracer, make_tracer
from clrast.visibility.triangle_list import NOTHING_MET, list_triangles


@pytest.fixture(autouse=True)
def _device_lists(request: pytest.FixtureRequest) -> None:
    if "device" not in request.fixturenames:
        return
    device = request.getfixturevalue("device")
    if loop_limit(device) is not None:
        pytest.skip(f"{device.runtime} limits loops: rays are refused there, which another test holds")
    if device.vector_width == 1:
        pytest.skip(f"{device.runtime} has vectors of one lane: rays walk there, whatever the scene")


def needles(count: int, seed: int) -> Mesh:
    """Triangles so thin that float32 knows little of them, some of no area at all."""
    rng = np.random.default_rng(seed)
    start, along = rng.normal(size=(2, count, 3))
    thin = 10.0 ** rng.uniform(-9, -3, (count, 1)) * rng.normal(size=(count, 3))
    corners = np.stack([start, start + along, start + along / 2 + thin], axis=1)
    corners[::7, 2] = corners[::7, 1]
    return corners.reshape(-1, 3).astype(np.float32), np.arange(3 * count, dtype=np.uint32).reshape(-1, 3)


def worlds() -> dict[str, tuple[Mesh, Rays]]:
    small = bumpy_sphere(3, 5)
    meshes = {
        "bumpy sphere": small,
        "box": box(),
        "one triangle": (box()[0], box()[1][:1]),
        "all scales": soup_of_scales(MAX_LISTED, 8),
        "needles": needles(MAX_LISTED, 9),
        "tiny": placed(small, 1e-15),
        "huge": placed(small, 2.0**57),
        "far away": placed(small, 2.0, FAR_CENTER),
    }
    cases = {name: (mesh, aimed_rays(mesh, 300, 6)) for name, mesh in meshes.items()}
    cases["lattice"] = (lattice_soup(60, 1), lattice_rays(1500, 2))
    long = lattice_rays(500, 10)
    cases["long directions"] = (lattice_soup(60, 1), (long[0], long[1] * np.float32(2.0**50)))
    cases["short directions"] = (lattice_soup(60, 1), (long[0], long[1] * np.float32(2.0**-50)))
    return cases


WORLDS = worlds()


def two_tracers(device: Device, mesh: Mesh, monkeypatch: pytest.MonkeyPatch) -> tuple[RayTracer, RayTracer]:
    """One that meets every triangle, and one that walks through the hierarchy."""
    listed = make_tracer(device, *mesh)
    monkeypatch.setattr(rays_module, "MAX_LISTED", 0)
    walking = make_tracer(device, *mesh)
    assert listed.is_listed and not walking.is_listed
    return listed, walking


@pytest.mark.parametrize("name", WORLDS)
def test_the_list_gives_the_bits_of_the_walk(device: Device, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    mesh, rays = WORLDS[name]
    listed, walking = two_tracers(device, mesh, monkeypatch)
    assert closest_bytes(listed, *rays) == closest_bytes(walking, *rays)
    limited = limited_rays(walking, rays, 17)
    for t_min in (limited[2], np.zeros_like(limited[2])):
        given = (*rays, t_min, *limited[3:])
        assert closest_bytes(listed, *given) == closest_bytes(walking, *given)
        assert (listed.any(*given) == walking.any(*given)).all()


@pytest.mark.parametrize("name", ["bumpy sphere", "lattice", "needles", "all scales"])
def test_light_is_looked_for_alike(device: Device, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rays that end at a point, on a triangle, or on one that they do not meet."""
    mesh, (origins, directions) = WORLDS[name]
    listed, walking = two_tracers(device, mesh, monkeypatch)
    count, rng = len(origins), np.random.default_rng(5)
    kinds = rng.integers(0, 3, count)
    ends = np.zeros((count, 4), dtype=np.float32)
    ends[:, :3] = origins + directions
    ends[:, 3] = kinds == 1
    lamps = np.where(kinds == 2, rng.integers(0, len(mesh[1]), count), NO_HIT).astype(np.uint32)
    # Half of the lamps are triangles that the ray meets.
    met = walking.closest(origins, directions).prim_id
    is_met = (kinds == 2) & (met != NO_HIT) & (rng.random(count) < 0.5)
    lamps[is_met] = walking.slots_of(met[is_met])
    t_max = np.where(kinds == 1, np.float32(1), np.float32(np.inf))
    found = []
    for tracer in (listed, walking):
        rays = tracer.upload(origins, directions, 0.0, t_max)
        known = {"ends": buffers.upload(device, ends), "lamp_slots": buffers.upload(device, lamps)}
        occluded = tracer.enqueue_any(RayBuffers(count, rays.arguments, known))
        found.append(buffers.download(device, occluded, np.uint32, count))
    assert (found[0] == found[1]).all()
    assert 0 < found[0].sum() < count


def test_few_rays_are_in_doubt(device: Device, tmp_path: Path) -> None:
    """Of a million pairs of a ray and a triangle of a closed room: those in doubt give an answer that is none."""
    mesh = box()
    rng = np.random.default_rng(3)
    low, high = mesh[0].min(axis=0), mesh[0].max(axis=0)
    origins = (low + (high - low) * rng.uniform(0.05, 0.95, (80_000, 3))).astype(np.float32)
    directions = rng.normal(size=origins.shape).astype(np.float32)
    told = {("trace_list.cl", "    else meet_all(&leaves, &rays, triangle_count, first + lane, false);\n"):
            "    else rays.prims_hit[first + lane] = NO_HIT - 1;\n"}  # fmt: skip
    with patched(device, tmp_path, told) as own:
        doubtful = make_tracer(own, *mesh).closest(origins, directions).prim_id == NO_HIT - 1
    assert doubtful.sum() < 8e-4 * len(origins)


def test_the_size_of_a_scene_decides(device: Device) -> None:
    mesh = soup_of_scales(MAX_LISTED + 1, 4)
    assert not make_tracer(device, *mesh).is_listed
    assert make_tracer(device, mesh[0], mesh[1][:-1]).is_listed


def test_edges_stand_once() -> None:
    points, triangles = box()
    edges, listed = list_triangles(points[triangles], np.arange(len(triangles)))
    assert len(triangles) == 12 and listed.shape == (12, LIST_WORDS)
    assert (edges.size - 4) // 6 == 18
    named = listed[:, :3].view(np.uint32)
    # Of a closed mesh each edge is met once each way.
    assert sorted(named.ravel()) == list(range(36))


def test_a_triangle_of_two_corners_is_never_met() -> None:
    corners = np.array([[[0, 0, 0], [1, 0, 0], [1, 0, 0]], [[0, 0, 0], [1, 0, 0], [0, 1, 0]]], dtype=np.float32)
    listed = list_triangles(corners, np.arange(2))[1]
    assert listed[0, 7] == NOTHING_MET and listed[1, 7] > 0
