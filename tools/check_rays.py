#!/usr/bin/env python3
"""Counts what rays get wrong: leaks of closed meshes, hits of what a ray leaves, differences to other answers.

    python tools/check_rays.py                        the long run, a few minutes
    python tools/check_rays.py --rays 2000 --shapes 20 --exact 100

Prints a line for each count: tried, wrong. Exit 1 where anything is wrong, 69 where rays are refused.
    leaks      rays from inside a closed mesh at random points, edges and vertices: each must hit
    double     the same rays must not meet a second triangle: these surfaces lie round their centre but once
    through    rays from outside at such points, past which the mesh goes on behind a ball: they must not get there
    bounces    the same rays, reflected diffusely inside: they must stay inside
    left       pbrt's reintersection test: triangles with coordinates of 1e-8 to 1e8, nothing excluded
    exact      first hits against real arithmetic (tests/reference.py), t within its bound
    hierarchy  the hierarchy against all triangles one by one, bit for bit, and any hit against the closest
    grid       the same of a uniform grid
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

import ray_worlds as worlds  # noqa: E402
from reference import all_hits, exact_triangles, general_ray, vector  # noqa: E402

from clrast.errors import ClrastError  # noqa: E402
from clrast.opencl.device import Device, open_device  # noqa: E402
from clrast.opencl.layout import NO_HIT  # noqa: E402
from clrast.scene.load import load  # noqa: E402
from clrast.visibility.ray_grid import GridRequest  # noqa: E402
from clrast.visibility.rays import make_tracer  # noqa: E402

Count = tuple[str, int, int]
"""What was tried, how often, and how often it went wrong."""

SEED = 1


def closed_meshes() -> dict[str, worlds.Mesh]:
    sphere = load(ROOT / "data" / "meshes" / "icosphere.ply")
    mesh = sphere.positions, sphere.triangles
    bumpy = worlds.bumpy_sphere(SEED, bumps=0.04)
    return {
        "icosphere": mesh,
        "icosphere 1e-8": worlds.placed(mesh, 1e-8),
        "icosphere 1e8": worlds.placed(mesh, 1e8),
        "icosphere far away": worlds.placed(mesh, 2.0, worlds.FAR_CENTER),
        "bumpy sphere": bumpy,
        "bumpy sphere far away": worlds.placed(bumpy, 2.0, worlds.FAR_CENTER),
        "box": worlds.box(),
        "tilted box": worlds.tilted_box(),
        "tetrahedron": worlds.tetrahedron(),
    }


def count_leaks(device: Device, ray_count: int) -> Iterator[Count]:
    for name, mesh in closed_meshes().items():
        tracer = make_tracer(device, *mesh)
        reach = worlds.kernel_radius(mesh)
        for kind in worlds.TARGETS:
            rng = np.random.default_rng(SEED)
            inside = worlds.rays_from_inside(mesh, kind, ray_count, rng, 0.9 * reach)
            first = tracer.closest(*inside).prim_id
            yield f"leaks, {name}, {kind}", ray_count, int((first == NO_HIT).sum())
            yield f"double, {name}, {kind}", ray_count, int(tracer.any(*inside, excluded=first).sum())
            outside = worlds.rays_from_outside(mesh, kind, ray_count, rng, 0.9 * reach)
            # The target is at 1, the far side beyond 1.1 (see rays_from_outside).
            yield f"through, {name}, {kind}", ray_count, int((~(tracer.closest(*outside).t < 1.05)).sum())
            yield (f"bounces, {name}, {kind}", *worlds.lost_in_bounces(tracer, mesh, kind, ray_count // 4, rng))


def count_rough_leaks(device: Device, ray_count: int) -> Iterator[Count]:
    mesh = worlds.bumpy_sphere(SEED, bumps=0.3)
    tracer = make_tracer(device, *mesh)
    for kind in worlds.TARGETS:
        inside = worlds.rays_from_inside(mesh, kind, ray_count, np.random.default_rng(SEED), 0.4)
        yield f"leaks, rough sphere, {kind}", ray_count, int((tracer.closest(*inside).prim_id == NO_HIT).sum())


def count_left(device: Device, shape_count: int) -> Iterator[Count]:
    yield ("left", *worlds.reintersections(device, shape_count, 1000, np.random.default_rng(SEED)))


def count_exact(device: Device, ray_count: int) -> Iterator[Count]:
    bumpy = worlds.bumpy_sphere(SEED, 6)
    cases = {
        "lattice": (worlds.lattice_soup(80, SEED), worlds.lattice_rays(ray_count, SEED)),
        **{
            f"bumpy sphere {scale:g}": _aimed(worlds.placed(bumpy, scale), ray_count)
            for scale in (1e-8, 1e-4, 1.0, 1e4, 1e8)
        },
        "bumpy sphere far away": _aimed(worlds.placed(bumpy, 2.0, worlds.FAR_CENTER), ray_count),
    }
    for name, (mesh, rays) in cases.items():
        found = make_tracer(device, *mesh).closest(*rays)
        scene, wrong, errors = exact_triangles(*mesh), 0, [0.0]
        for k, (origin, direction) in enumerate(zip(*rays, strict=True)):
            hits = all_hits(scene, general_ray(vector(origin), vector(direction)), True)
            if not hits:
                wrong += int(found.prim_id[k] != NO_HIT)
                continue
            error = abs(Fraction(float(found.t[k])) - hits[0].t)
            is_within = error <= Fraction(float(found.t_error[k])) * Fraction(1 + 2.0**-22)
            wrong += int(found.prim_id[k] != hits[0].prim_id or not is_within)
            errors.append(float(error / hits[0].t) * 2**24)
        print(f"t of {name}: median {np.median(errors):.2f}, worst {max(errors):.1f} times 2^-24 off")
        yield f"exact, {name}", len(rays[0]), wrong


def _aimed(mesh: worlds.Mesh, count: int) -> tuple[worlds.Mesh, worlds.Rays]:
    """Rays from in and round a mesh to its points, edges and vertices, as many of each."""
    rng = np.random.default_rng(SEED)
    at = np.concatenate([worlds.targets(mesh, kind, count // 3, rng) for kind in worlds.TARGETS])
    center = mesh[0].astype(np.float64).mean(axis=0)
    origins = (center + rng.normal(size=at.shape) * np.abs(mesh[0] - center).max()).astype(np.float32)
    return mesh, (origins, (at - origins).astype(np.float32))


def count_structures(device: Device, ray_count: int) -> Iterator[Count]:
    rng = np.random.default_rng(SEED)
    corners = rng.random((3000, 1, 3)) + 0.2 * (rng.random((3000, 3, 3)) - 0.5)
    soup = corners.reshape(-1, 3).astype(np.float32), np.arange(9000, dtype=np.uint32).reshape(-1, 3)
    cases = {
        "soup": _aimed(soup, ray_count),
        "bumpy sphere": _aimed(worlds.bumpy_sphere(SEED), ray_count),
        "lattice": (worlds.lattice_soup(400, SEED), worlds.lattice_rays(ray_count, SEED)),
    }
    for name, (mesh, rays) in cases.items():
        brute = make_tracer(device, *mesh, bvh=worlds.one_box(mesh))
        expected = brute.closest(*rays)
        t_max = (expected.t * rng.choice([0.5, 1, 1.5], len(expected.t))).astype(np.float32)
        limited = brute.closest(*rays, 0.0, t_max).prim_id != NO_HIT
        grid = make_tracer(device, *mesh, grid=GridRequest(device.global_memory_bytes))
        for structure, tracer in (("hierarchy", make_tracer(device, *mesh)), ("grid", grid)):
            found = tracer.closest(*rays)
            same = (found.prim_id == expected.prim_id) & (found.t.view(np.uint32) == expected.t.view(np.uint32))
            yield f"{structure}, {name}", len(same), int((~same).sum())
            yield f"{structure}, any hit, {name}", len(same), int((tracer.any(*rays, 0.0, t_max) != limited).sum())


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rays", type=int, default=200_000, help="rays of each kind and mesh")
    parser.add_argument("--shapes", type=int, default=1000, help="triangles of the reintersection test")
    parser.add_argument("--exact", type=int, default=1500, help="rays of each scene against real arithmetic")
    parser.add_argument("--device", default=None, help="as of clrast")
    given = parser.parse_args(arguments)
    all_tried = all_wrong = 0
    start = time.perf_counter()
    try:
        device = open_device(given.device)
        print(f"device: {device}")
        for counts in (
            count_leaks(device, given.rays),
            count_rough_leaks(device, given.rays),
            count_left(device, given.shapes),
            count_exact(device, given.exact),
            count_structures(device, given.rays // 20),
        ):
            for name, tried, wrong in counts:
                print(f"{name:44} {tried:9} tried {wrong:7} wrong", flush=True)
                all_tried, all_wrong = all_tried + tried, all_wrong + wrong
    except ClrastError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    print(f"{'all':44} {all_tried:9} tried {all_wrong:7} wrong, {time.perf_counter() - start:.0f} s")
    return int(all_wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
