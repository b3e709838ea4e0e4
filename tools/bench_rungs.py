#!/usr/bin/env python3
"""What each rung of `--precision` costs in the visibility stage, and which rung of the filter settled what.

    python tools/bench_rungs.py                              icosphere, and what ../shared/scenes has
    python tools/bench_rungs.py --method 3dr-full --repetitions 60 --rungs midpoint,exact

All rungs render each scene in turn, so that a machine that drifts drifts for all; the table gives medians with the
10th and 90th percentile and the median of the paired ratios to `midpoint`. A sample is settled by float32 unless it
was asked about in float64 or listed for exact arithmetic; both are counted per (sample, triangle) pair, so that
their shares of the samples are upper bounds. Wrong samples come from exact arithmetic that shares nothing with kernels.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tools")]

from bench import scenes  # noqa: E402

from clrast.job import RenderJob  # noqa: E402
from clrast.opencl import buffers  # noqa: E402
from clrast.opencl.device import open_device  # noqa: E402
from clrast.option_values import parse_size  # noqa: E402
from clrast.options import AVAILABLE_PRECISIONS, RenderOptions  # noqa: E402
from clrast.scene.camera import camera_vectors  # noqa: E402
from clrast.scene.model import Camera, Scene  # noqa: E402
from clrast.shading.effects import plan_effects  # noqa: E402
from clrast.study.exact_visibility import exact_visibility  # noqa: E402
from clrast.study.stress import is_offered  # noqa: E402

NAMES = ["icosphere", "bunny", "dragon", "sponza inside"]


def make_jobs(scene: Scene, camera: Camera, options: argparse.Namespace) -> dict[str, RenderJob]:
    """A job of each rung on one scene."""
    device, found = open_device(options.device), {}
    for rung in options.rungs:
        given = RenderOptions(
            size=options.size, precision=rung, method=options.method, aov=("id",), effects={"alpha mask": "off"}
        )
        plan = plan_effects(scene, given.aov, given.effects)
        found[rung] = RenderJob(device, scene, camera_vectors(camera, *options.size), given, plan)
    return found


def measure(jobs: dict[str, RenderJob], repetitions: int) -> dict[str, np.ndarray]:
    """Milliseconds of the visibility stage: (repetitions,) of each rung, interleaved."""
    times: dict[str, list[float]] = {rung: [] for rung in jobs}
    for k in range(repetitions + 3):
        for rung, job in jobs.items():
            spent = job.time_frame().visibility
            if k >= 3:
                times[rung].append(spent)
    return {rung: np.array(values) for rung, values in times.items()}


def wrong_samples(job: RenderJob, scene: Scene, size: tuple[int, int]) -> int:
    exact = exact_visibility(scene.positions, scene.triangles, job.vectors.named(), *size)
    prims = buffers.download(job.device, job.tiles.visible_prims, np.uint32, (size[1], size[0]))
    return int(np.count_nonzero(prims != exact.prim_id))


def report(name: str, scene: Scene, camera: Camera, options: argparse.Namespace) -> None:
    jobs = make_jobs(scene, camera, options)
    times = measure(jobs, options.repetitions)
    base = times.get("midpoint", next(iter(times.values())))
    samples = options.size[0] * options.size[1]
    for rung, job in jobs.items():
        low, middle, high = np.percentile(times[rung], (10, 50, 90))
        line = f"{name:14} {rung:9} {middle:8.2f} ms  {low:7.2f} to {high:7.2f}  {np.median(times[rung] / base):6.2f} x"
        line += f"  {wrong_samples(job, scene, options.size):6} wrong"
        if job.contenders is not None:
            counts = job.contenders.counts
            by_float64 = counts["decided_float64"] + counts["contenders"] - counts["decided_exact"]
            by_integers = counts["decided_exact"]
            rest = 100 * (1 - (by_float64 + by_integers) / samples)
            line += f"  settled by float32 {rest:.3f} %, float64 {by_float64}, exact arithmetic {by_integers}"
        print(line, flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", default=",".join(NAMES), help="of: " + ", ".join(NAMES))
    parser.add_argument("--size", type=parse_size, default=(1024, 1024))
    parser.add_argument("--method", default="3dr-binning")
    parser.add_argument("--rungs", default=",".join(AVAILABLE_PRECISIONS))
    parser.add_argument("--repetitions", type=int, default=40)
    parser.add_argument("--device")
    options = parser.parse_args()
    options.rungs = [rung for rung in options.rungs.split(",") if is_offered(options.method, rung)]
    wanted = options.scenes.split(",")
    found = scenes(wanted)
    for name in wanted:
        if name in found:
            report(name, *found[name], options)
        else:
            print(f"{name}: left out: ../shared/scenes does not have it")
    return 0


if __name__ == "__main__":
    sys.exit(main())
