#!/usr/bin/env python3
"""Times setup + bin + visibility of primary samples, with Embree (embreex) as a peer in the same run.

    python tools/bench.py                                   icosphere, and what ../shared/scenes has
    python tools/bench.py --repetitions 60 --json out.json --size 1024x1024
    python tools/bench.py --scene my.glb --eye 1,2,3 --look-at 0,0,0 --fov 60

Every repetition times each renderer on each scene in turn, so that a machine that drifts drifts for
all; the table gives medians with the 10th and 90th percentile, and the median of the paired ratios.
clrast is timed from the first launch to the finished queue, with the scene on the device, its corners and
plane normals laid out once (`prepare`, shown apart); Embree from its first ray to its last, on two threads,
with rays and tree made beforehand. Alpha tests are off.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import numpy as np  # noqa: E402

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from clrast.job import RenderJob  # noqa: E402
from clrast.opencl.device import Device, open_device  # noqa: E402
from clrast.option_values import parse_size, parse_vector  # noqa: E402
from clrast.options import RenderOptions  # noqa: E402
from clrast.scene.camera import camera_vectors  # noqa: E402
from clrast.scene.load import load  # noqa: E402
from clrast.scene.model import Camera, Scene  # noqa: E402
from clrast.shading.effects import plan_effects  # noqa: E402
from clrast.visibility.geometry import build_geometry  # noqa: E402

SHARED = ROOT.parent / "shared" / "scenes"
TARGET_MS = {"icosphere": 6.0, "bunny": 2.0, "dragon": 4.0, "sponza inside": 6.0}
TARGET_RATIO = 8.0
STAGES = ("setup", "bin", "visibility")


def icosphere(subdivisions: int) -> Scene:
    """A unit sphere of 20 * 4**subdivisions triangles."""
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    count = len(mesh.faces)
    return Scene(
        positions=np.asarray(mesh.vertices, np.float32),
        triangles=np.asarray(mesh.faces, np.uint32),
        object_ids=np.zeros(count, np.uint32),
        material_ids=np.zeros(count, np.uint32),
    )


def view_from_front(scene: Scene) -> Camera:
    """From a little above the front, the scene filling most of the view."""
    low, high = scene.bounding_box()
    x, y, z = (float(c) for c in (low + high) / 2)
    radius = float(np.sqrt(((high - low) ** 2).sum())) / 2
    return Camera(eye=(x, y + 0.1 * radius, z + 2.2 * radius), look_at=(x, y, z))


def scenes(names: list[str]) -> dict[str, tuple[Scene, Camera]]:
    """Scenes of the standard table that are there, by name."""
    found: dict[str, tuple[Scene, Camera]] = {}
    if "icosphere" in names:
        found["icosphere"] = (icosphere(7), Camera(eye=(0.0, 0.0, 3.0)))
    for name, file in (("bunny", "bunny.ply"), ("dragon", "dragon.ply")):
        if name in names and (SHARED / file).exists():
            scene = load(str(SHARED / file))
            found[name] = (scene, view_from_front(scene))
    if "sponza inside" in names and (SHARED / "sponza.glb").exists():
        inside = Camera(eye=(-1100.0, 300.0, -30.0), look_at=(1000.0, 350.0, 0.0), fov=60.0)
        found["sponza inside"] = (load(str(SHARED / "sponza.glb")), inside)
    return found


class ClrastPeer:
    """The tile rasterizer on one scene: `frame` is setup + bin + visibility; `stages` times each apart."""

    def __init__(self, device: Device, scene: Scene, camera: Camera, size: tuple[int, int]) -> None:
        options = RenderOptions(size=size, aov=("id",), effects={"alpha mask": "off"})
        plan = plan_effects(scene, options.aov, options.effects)
        job = RenderJob(device, scene, camera_vectors(camera, *size), options, plan)
        self.tiles, self.queue, self.rows = job.tiles, device.queue, int(job.view["tile_rows"])
        self.references = 0
        self.frame()
        self.prepare_ms = self._time_prepare(device, job, scene)

    @staticmethod
    def _time_prepare(device: Device, job: RenderJob, scene: Scene) -> float:
        """Milliseconds of what is done once for a scene: upload and prepare_triangles."""
        started = time.perf_counter()
        build_geometry(device, job.features, scene.positions, scene.triangles, float(job.view["world_scale"]))
        return 1000 * (time.perf_counter() - started)

    def frame(self) -> None:
        """Setup, bin and visibility without a stop: the lists' size is known from the frame before."""
        while True:
            self.tiles.setup()
            self.tiles.count_references(0, self.rows)
            self.tiles.scatter_references()
            self.tiles.rasterize()
            if self.tiles.fits():
                break
        self.references = self.tiles.reference_count

    def stages(self) -> dict[str, float]:
        """Milliseconds of each stage round a finished queue."""

        def timed(*work: Callable[[], object]) -> float:
            started = time.perf_counter()
            for step in work:
                step()
            self.queue.finish()
            return 1000 * (time.perf_counter() - started)

        return {
            "setup": timed(self.tiles.setup),
            "bin": timed(lambda: self.tiles.count_references(0, self.rows), self.tiles.scatter_references),
            "visibility": timed(self.tiles.rasterize),
        }

    def prim_ids(self, size: tuple[int, int]) -> np.ndarray:
        from clrast.opencl import buffers

        return buffers.download(self.tiles.device, self.tiles.visible_prims, np.uint32, (size[1], size[0]))


class EmbreePeer:
    """embreex (Embree with Python bindings): closest hits of the same rays, on `threads` threads."""

    def __init__(self, scene: Scene, camera: Camera, size: tuple[int, int], threads: int) -> None:
        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh

        self.scene = rtcore_scene.EmbreeScene()
        self.mesh = TriangleMesh(self.scene, scene.positions, scene.triangles.astype(np.int32))
        vectors = camera_vectors(camera, *size)
        x = np.arange(size[0], dtype=np.float64)[None, :, None] + 0.5
        y = np.arange(size[1], dtype=np.float64)[:, None, None] + 0.5
        first, dx, dy = (np.array(v) for v in (vectors.first, vectors.tangent_x, vectors.tangent_y))
        directions = (first + x * dx + y * dy).reshape(-1, 3).astype(np.float32)
        origins = np.broadcast_to(np.array(vectors.origin, np.float32), directions.shape).copy()
        self.parts = list(zip(np.array_split(origins, threads), np.array_split(directions, threads), strict=True))
        self.pool = ThreadPoolExecutor(threads)
        self.hits: list[np.ndarray] = []
        self.frame()

    def frame(self) -> None:
        self.hits = list(self.pool.map(lambda part: self.scene.run(part[0], part[1]), self.parts))

    def prim_ids(self, size: tuple[int, int]) -> np.ndarray:
        return np.concatenate(self.hits).reshape(size[1], size[0]).astype(np.int64).astype(np.uint32)


@dataclass
class Row:
    """Figures of one scene. frame_ms, embree_ms : one entry a repetition; stage_ms likewise by stage."""

    name: str
    triangles: int
    references: int = 0
    prepare_ms: float = 0.0
    agreement: float = float("nan")
    frame_ms: list[float] = field(default_factory=list)
    embree_ms: list[float] = field(default_factory=list)
    stage_ms: dict[str, list[float]] = field(default_factory=lambda: {stage: [] for stage in STAGES})

    def figures(self) -> dict[str, object]:
        ratios = [e / c for e, c in zip(self.embree_ms, self.frame_ms, strict=False)]
        return {
            "scene": self.name,
            "triangles": self.triangles,
            "references": self.references,
            "prepare_ms": self.prepare_ms,
            "clrast_ms": spread(self.frame_ms),
            "stages_ms": {stage: spread(values) for stage, values in self.stage_ms.items()},
            "embree_ms": spread(self.embree_ms) if self.embree_ms else None,
            "ratio": spread(ratios) if ratios else None,
            "same_ids": self.agreement,
            "target_ms": TARGET_MS.get(self.name),
        }


def spread(values: list[float]) -> dict[str, float]:
    """Median, minimum, 10th and 90th percentile."""
    ordered = sorted(values)
    return {
        "median": statistics.median(ordered),
        "min": ordered[0],
        "p10": ordered[len(ordered) // 10],
        "p90": ordered[-1 - len(ordered) // 10],
    }


def measure(table: dict[str, tuple[Scene, Camera]], args: argparse.Namespace) -> list[Row]:
    """All repetitions, interleaved: every scene and renderer once per round; the first round is a warm-up."""
    device = open_device(args.device, args.threads)
    print(f"device: {device}, {device.compute_units} compute units, vectors of {device.vector_width}")
    peers = {}
    for name, (scene, camera) in table.items():
        embree = None if args.no_embree else EmbreePeer(scene, camera, args.size, args.threads or 2)
        peers[name] = (ClrastPeer(device, scene, camera, args.size), embree)
    rows = {name: Row(name, scene.triangle_count) for name, (scene, _) in table.items()}
    for repetition in range(args.repetitions + 1):
        for name, (ours, embree) in peers.items():
            row = rows[name]
            stages = ours.stages()
            started = time.perf_counter()
            ours.frame()
            frame = 1000 * (time.perf_counter() - started)
            started = time.perf_counter()
            if embree is not None and repetition <= args.embree_repetitions:
                embree.frame()
            spent = 1000 * (time.perf_counter() - started)
            if repetition == 0:
                continue
            row.frame_ms.append(frame)
            for stage in STAGES:
                row.stage_ms[stage].append(stages[stage])
            if embree is not None and repetition <= args.embree_repetitions:
                row.embree_ms.append(spent)
    for name, (ours, embree) in peers.items():
        rows[name].references = ours.references
        rows[name].prepare_ms = ours.prepare_ms
        if embree is not None:
            rows[name].agreement = float((ours.prim_ids(args.size) == embree.prim_ids(args.size)).mean())
    return list(rows.values())


def print_table(rows: list[Row]) -> None:
    print(
        f"{'scene':<14} {'triangles':>9}  {'ms (p10-p90)':>19} {'target':>6}  {'setup':>6} {'bin':>6} {'raster':>6} "
        f"{'prepare':>8}  {'embreex ms':>10} {'ratio':>6} {'same ids':>9}"
    )
    for row in rows:
        f = row.figures()
        ours, stages, embree, ratio = f["clrast_ms"], f["stages_ms"], f["embree_ms"], f["ratio"]
        target = TARGET_MS.get(row.name)
        print(
            f"{row.name:<14} {row.triangles:>9}  {ours['median']:>6.2f} ({ours['p10']:.2f}-{ours['p90']:.2f})".ljust(47)
            + f"{target or '-':>6}  "
            + " ".join(f"{stages[stage]['median']:>6.2f}" for stage in STAGES)
            + f" {row.prepare_ms:>8.2f}"
            + (f"  {embree['median']:>10.1f} {ratio['median']:>5.1f}x {row.agreement:>9.6f}" if embree else "")
        )


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=lambda text: parse_size("--size", text), default=(1024, 1024))
    parser.add_argument("--repetitions", type=int, default=40)
    parser.add_argument("--embree-repetitions", type=int, default=10, help="Embree takes longer: its first rounds only")
    parser.add_argument("--only", default=",".join(TARGET_MS), help="comma list of standard scenes")
    parser.add_argument("--scene", help="a scene file of your own, in place of the standard ones")
    parser.add_argument("--eye", type=lambda text: parse_vector("--eye", text))
    parser.add_argument("--look-at", type=lambda text: parse_vector("--look-at", text))
    parser.add_argument("--fov", type=float, default=45.0)
    parser.add_argument("--device")
    parser.add_argument("--threads", type=int)
    parser.add_argument("--no-embree", action="store_true")
    parser.add_argument("--json", metavar="FILE", help="write all figures")
    return parser.parse_args()


def main() -> int:
    args = parse_arguments()
    if args.scene:
        scene = load(args.scene)
        camera = view_from_front(scene)
        if args.eye and args.look_at:
            camera = Camera(eye=args.eye, look_at=args.look_at, fov=args.fov)
        table = {Path(args.scene).stem: (scene, camera)}
    else:
        table = scenes(args.only.split(","))
    rows = measure(table, args)
    print_table(rows)
    if args.json:
        Path(args.json).write_text(json.dumps([row.figures() for row in rows], indent=2) + "\n")
    missing = [name for name in args.only.split(",") if not args.scene and name not in table]
    if missing:
        print(f"left out, as {SHARED} does not have them: {', '.join(missing)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
