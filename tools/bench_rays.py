#!/usr/bin/env python3
"""Times secondary rays through a BVH and a uniform grid, with Embree (embreex, one thread) as a peer in the same run.

    python tools/bench_rays.py                            icosphere, and what ../shared/scenes has
    python tools/bench_rays.py --rays 1000000 --repetitions 15 --scenes bunny

Rays are incoherent: origins uniform in the scene's box, or for `sponza inside` within its middle half, directions
uniform on the sphere, from a fixed seed. All trace each kind in turn, so that a machine that drifts drifts for all.
clrast is timed from the launch to the finished queue, with rays and scene on the device; Embree from its first ray to
its last, with rays and tree made beforehand. The table gives medians with the 10th and 90th percentile, the median of
the paired ratios to the BVH, and the time that each structure takes to build. That BVH and grid answer alike, bit for
bit, is checked first. `even at`: so many closest hits take as long with either, the build counted for one frame alone.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import numpy as np  # noqa: E402

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tools")]

from bench import scenes  # noqa: E402

from clrast.opencl.device import open_device  # noqa: E402
from clrast.scene.model import Scene  # noqa: E402
from clrast.visibility.bvh import build_bvh  # noqa: E402
from clrast.visibility.ray_grid import GridRequest  # noqa: E402
from clrast.visibility.rays import RayTracer, build_tracer  # noqa: E402

NAMES = "icosphere,bunny,sponza inside"
KINDS = ("closest", "any")
WARM_UP = 2


def incoherent_rays(scene: Scene, count: int, share: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Origins in the middle `share` of the scene's box, directions uniform on the sphere: two (count, 3) float32."""
    random = np.random.default_rng(seed)
    low, high = scene.bounding_box()
    center, half = (low + high) / 2, (high - low) / 2 * share
    origins = center + half * random.uniform(-1, 1, (count, 3))
    directions = random.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return origins.astype(np.float32), directions.astype(np.float32)


class Peer:
    """Embree on the same rays."""

    def __init__(self, scene: Scene, threads: int) -> None:
        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh

        started = time.perf_counter()
        self._scene = rtcore_scene.EmbreeScene(robust=True)
        vertices = np.ascontiguousarray(scene.positions[scene.triangles].reshape(-1, 3), np.float32)
        faces = np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
        TriangleMesh(self._scene, vertices, faces)
        self._scene.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))
        self.build_ms = 1000 * (time.perf_counter() - started)
        self._pool = ThreadPoolExecutor(threads)
        self.threads = threads

    def trace(self, kind: str, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        query = "INTERSECT" if kind == "closest" else "OCCLUDED"
        parts = np.array_split(np.arange(len(origins)), self.threads)
        run = [self._pool.submit(self._scene.run, origins[part], directions[part], query=query) for part in parts]
        return np.concatenate([each.result() for each in run])


def build_tracers(
    scene: Scene, options: argparse.Namespace
) -> tuple[dict[str, RayTracer], Peer | None, dict[str, float]]:
    """Tracers by the names of --accelerator, Embree, and the median milliseconds that each structure takes to build."""
    device = open_device(options.device, options.threads)
    wanted = GridRequest(device.global_memory_bytes // 2, options.grid_resolution)
    build_tracer(device, scene.positions, scene.triangles, wanted)  # the first one waits for kernels
    times: dict[str, list[float]] = {}
    tracers: dict[str, RayTracer] = {}
    peer = None
    for _ in range(options.builds):
        started = time.perf_counter()
        bvh = build_bvh(scene.positions, scene.triangles, device=device)
        times.setdefault("bvh", []).append(1000 * (time.perf_counter() - started))
        tracers["bvh"] = build_tracer(device, scene.positions, scene.triangles, bvh)
        tracers["grid"] = build_tracer(device, scene.positions, scene.triangles, wanted)
        times.setdefault("grid", []).append(tracers["grid"].grid_ms)
        if not options.no_embree:
            peer = Peer(scene, options.embree_threads)
            times.setdefault("Embree", []).append(peer.build_ms)
    return tracers, peer, {name: statistics.median(each) for name, each in times.items()}


def same_answers(tracers: dict[str, RayTracer], origins: np.ndarray, directions: np.ndarray) -> bool:
    """Whether all tracers answer alike, bit for bit."""
    answers = []
    for tracer in tracers.values():
        hits = tracer.closest(origins, directions)
        arrays = (hits.prim_id, hits.t, hits.t_error, hits.barycentrics, tracer.any(origins, directions))
        answers.append([np.ascontiguousarray(each).tobytes() for each in arrays])
    return all(answer == answers[0] for answer in answers)


def measure(scene: Scene, share: float, options: argparse.Namespace) -> bool:
    """Print the table of a scene; returns whether BVH and grid answer alike."""
    tracers, peer, builds = build_tracers(scene, options)
    origins, directions = incoherent_rays(scene, options.rays, share, 1)
    if not same_answers(tracers, origins, directions):
        print("  BVH and grid answer differently: nothing is timed")
        return False
    rays = tracers["bvh"].upload(origins, directions)
    names = [*tracers, *(["Embree"] if peer else [])]
    times: dict[str, dict[str, list[float]]] = {kind: {name: [] for name in names} for kind in KINDS}
    for k in range(options.repetitions + WARM_UP):
        for kind in KINDS:
            for name in names:
                started = time.perf_counter()
                if name in tracers:
                    tracer = tracers[name]
                    (tracer.enqueue_closest if kind == "closest" else tracer.enqueue_any)(rays)
                    tracer.device.queue.finish()
                elif peer is not None:
                    peer.trace(kind, origins, directions)
                if k >= WARM_UP:
                    times[kind][name].append(1000 * (time.perf_counter() - started))
    for kind, of_kind in times.items():
        for name, spent in of_kind.items():
            low, middle, high = np.percentile(spent, (10, 50, 90))
            ratio = np.percentile(np.array(spent) / of_kind["bvh"], (10, 50, 90))
            line = f"  {kind:<8} {name:<7} {middle:8.1f} ms  ({low:.1f} .. {high:.1f})"
            line += f"  {options.rays / middle / 1000:6.2f} Mrays/s"
            print(line + f"   {ratio[1]:5.2f} x bvh ({ratio[0]:.2f} .. {ratio[2]:.2f})")
    print("  build    " + ", ".join(f"{name} {ms:.1f} ms" for name, ms in builds.items()))
    print("  memory   " + ", ".join(f"{name} {each.nbytes / 2**20:.1f} MiB" for name, each in tracers.items()))
    medians = {name: statistics.median(spent) for name, spent in times["closest"].items()}
    saved, lost = builds["bvh"] - builds["grid"], (medians["grid"] - medians["bvh"]) / options.rays
    if saved > 0 and lost > 0:
        print(f"  even at  {saved / lost:,.0f} rays, {saved / lost / scene.triangle_count:.2f} a triangle")
    else:
        print(f"  even at  none: the {'grid' if lost <= 0 else 'BVH'} is faster at all numbers of rays")
    return True


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=lambda text: text.split(","), default=NAMES.split(","))
    parser.add_argument("--rays", type=int, default=1_000_000)
    parser.add_argument("--repetitions", type=int, default=9)
    parser.add_argument("--builds", type=int, default=3)
    parser.add_argument("--grid-resolution", type=int, default=None)
    parser.add_argument("--threads", type=int, default=None)
    parser.add_argument("--embree-threads", type=int, default=1)
    parser.add_argument("--no-embree", action="store_true")
    parser.add_argument("--device", default=None)
    options = parser.parse_args()
    found, alike = scenes(options.scenes), True
    for name in options.scenes:
        if name not in found:
            print(f"{name}: left out: ../shared/scenes does not have it")
            continue
        scene = found[name][0]
        what = f"{scene.triangle_count} triangles, {options.rays} incoherent rays"
        print(f"{name}: {what}, Embree on {options.embree_threads} thread(s)")
        alike = measure(scene, 0.5 if "inside" in name else 1.0, options) and alike
    return int(not alike)


if __name__ == "__main__":
    sys.exit(main())
