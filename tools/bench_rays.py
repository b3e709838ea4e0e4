#!/usr/bin/env python3
"""Times secondary rays, closest and any hit, with Embree (embreex, one thread) as a peer in the same run.

    python tools/bench_rays.py                            icosphere, and what ../shared/scenes has
    python tools/bench_rays.py --rays 1000000 --repetitions 15 --scenes bunny

Rays are incoherent: origins uniform in the scene's box, or for `sponza inside` within its middle half, directions
uniform on the sphere, from a fixed seed. Both renderers trace each kind in turn, so that a machine that drifts drifts
for both. clrast is timed from the launch to the finished queue, with rays and scene on the device; Embree from its
first ray to its last, with rays and tree made beforehand. The table gives medians with the 10th and 90th percentile,
the median of the paired ratios, and the time that each hierarchy takes to build.
"""

from __future__ import annotations

import argparse
import os
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
from clrast.visibility.rays import make_tracer  # noqa: E402

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


def measure(scene: Scene, share: float, options: argparse.Namespace) -> None:
    device = open_device(options.device, options.threads)
    started = time.perf_counter()
    bvh = build_bvh(scene.positions, scene.triangles)
    build_ms = 1000 * (time.perf_counter() - started)
    tracer = make_tracer(device, scene.positions, scene.triangles, bvh)
    origins, directions = incoherent_rays(scene, options.rays, share, 1)
    rays = tracer.upload(origins, directions)
    peer = None if options.no_embree else Peer(scene, options.embree_threads)
    times: dict[str, list[tuple[float, float]]] = {kind: [] for kind in KINDS}
    for k in range(options.repetitions + WARM_UP):
        for kind in KINDS:
            started = time.perf_counter()
            (tracer.enqueue_closest if kind == "closest" else tracer.enqueue_any)(rays)
            device.queue.finish()
            own = time.perf_counter() - started
            started = time.perf_counter()
            if peer is not None:
                peer.trace(kind, origins, directions)
            other = time.perf_counter() - started
            if k >= WARM_UP:
                times[kind].append((own, other))
    for kind, pairs in times.items():
        own, other = np.array(pairs).T
        low, middle, high = np.percentile(1000 * own, (10, 50, 90))
        line = f"  {kind:<8} {middle:8.1f} ms  ({low:.1f} .. {high:.1f})  {options.rays / middle / 1000:6.2f} Mrays/s"
        if peer is not None:
            ratio = np.percentile(other / own, (10, 50, 90))
            line += f"   Embree {1000 * np.median(other):8.1f} ms   {ratio[1]:.2f} x ({ratio[0]:.2f} .. {ratio[2]:.2f})"
        print(line)
    print(f"  build    {build_ms:8.1f} ms" + ("" if peer is None else f"   Embree {peer.build_ms:.1f} ms"))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=lambda text: text.split(","), default=NAMES.split(","))
    parser.add_argument("--rays", type=int, default=1_000_000)
    parser.add_argument("--repetitions", type=int, default=9)
    parser.add_argument("--threads", type=int, default=None)
    parser.add_argument("--embree-threads", type=int, default=1)
    parser.add_argument("--no-embree", action="store_true")
    parser.add_argument("--device", default=None)
    options = parser.parse_args()
    found = scenes(options.scenes)
    for name in options.scenes:
        if name not in found:
            print(f"{name}: left out: ../shared/scenes does not have it")
            continue
        scene = found[name][0]
        what = f"{scene.triangle_count} triangles, {options.rays} incoherent rays"
        print(f"{name}: {what}, Embree on {options.embree_threads} thread(s)")
        measure(scene, 0.5 if "inside" in name else 1.0, options)
    return 0


if __name__ == "__main__":
    sys.exit(main())
