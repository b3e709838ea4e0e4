#!/usr/bin/env python3
"""What each mode of `--aa` costs and how far its colour is from many samples.

    python tools/bench_aa.py                              icosphere, and what ../shared/scenes has
    python tools/bench_aa.py --modes none,msaa:16,csaa:4+12 --repetitions 30 --scenes bunny,dragon

All modes render each scene in turn, so that a machine that drifts drifts for all. A time is that of a whole frame:
setup, binning, visibility, shading, resolve and reading the channels back, not of loading and writing. The table gives
medians with the 10th and 90th percentile and the median of the paired ratios to `none`. The error is the root mean
square over R, G, B and over A, of the pixels where the reference and `none` differ (edges, textures) against
`ssaa:1024`, which comes from the same kernels: it measures sampling, not shading.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tools")]

from bench import scenes  # noqa: E402

from clrast.job import RenderJob  # noqa: E402
from clrast.opencl.device import open_device  # noqa: E402
from clrast.option_values import parse_size  # noqa: E402
from clrast.options import RenderOptions  # noqa: E402
from clrast.scene.camera import camera_vectors  # noqa: E402
from clrast.scene.model import Camera, Scene  # noqa: E402
from clrast.shading.effects import plan_effects  # noqa: E402

NAMES = "icosphere,bunny,dragon,sponza inside"
MODES = "none,msaa:4,msaa:8,msaa:16,csaa:4+12,csaa:8+8,ssaa:4,ssaa:16,auto:0.05,auto:0.01"
REFERENCE = "ssaa:1024"
WARM_UP = 2

Channels = dict[str, np.ndarray]


def make_job(scene: Scene, camera: Camera, mode: str, options: argparse.Namespace) -> RenderJob:
    given = RenderOptions(size=options.size, aa=mode, method=options.method)
    plan = plan_effects(scene, given.aov, given.effects)
    return RenderJob(open_device(options.device), scene, camera_vectors(camera, *options.size), given, plan)


def measure(jobs: dict[str, tuple[RenderJob, Channels]], repetitions: int) -> dict[str, np.ndarray]:
    """Milliseconds of a frame: (repetitions,) of each mode, interleaved."""
    times: dict[str, list[float]] = {mode: [] for mode in jobs}
    for k in range(repetitions + WARM_UP):
        for mode, (job, channels) in jobs.items():
            started = time.perf_counter()
            job.render_frame(channels, first=k == 0)
            if k >= WARM_UP:
                times[mode].append(1000 * (time.perf_counter() - started))
    return {mode: np.array(values) for mode, values in times.items()}


def errors(found: Channels, reference: Channels, plain: Channels) -> tuple[float, float]:
    """Root mean square of colour and of alpha where the reference differs from one sample."""
    differs = np.any([plain[name] != reference[name] for name in "RGBA"], axis=0)
    if not differs.any():
        return 0.0, 0.0
    squares = {name: (found[name][differs].astype(np.float64) - reference[name][differs]) ** 2 for name in "RGBA"}
    color = np.mean([squares[name].mean() for name in "RGB"])
    return float(np.sqrt(color)), float(np.sqrt(squares["A"].mean()))


def report(name: str, scene: Scene, camera: Camera, options: argparse.Namespace) -> None:
    made = {mode: make_job(scene, camera, mode, options) for mode in ("none", *options.modes)}
    jobs = {mode: (job, job.allocate()) for mode, job in made.items()}
    times = measure(jobs, options.repetitions)
    reference: Channels | None = None
    if options.reference != "none":
        job = make_job(scene, camera, options.reference, options)
        reference = job.allocate()
        job.render_frame(reference, first=True)
    print(f"\n{name}: {scene.triangle_count} triangles, {options.size[0]}x{options.size[1]}")
    print(
        f"{'mode':<12} {'ms':>8} {'p10':>8} {'p90':>8} {'ratio':>6} {'samples shaded':>15} {'colour':>8} {'alpha':>8}"
    )
    for mode, (job, channels) in jobs.items():
        low, middle, high = np.percentile(times[mode], (10, 50, 90))
        ratio = float(np.median(times[mode] / times["none"]))
        pixels = options.size[0] * options.size[1]
        shaded = pixels if job.resolver is None else job.resolver.counts["samples_shaded"]
        color, alpha = (0.0, 0.0) if reference is None else errors(channels, reference, jobs["none"][1])
        row = f"{mode:<12} {middle:8.1f} {low:8.1f} {high:8.1f} {ratio:6.2f} {shaded:15,}"
        print(row + (f" {color:8.5f} {alpha:8.5f}" if reference is not None else ""))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=lambda text: text.split(","), default=NAMES.split(","))
    parser.add_argument("--modes", type=lambda text: text.split(","), default=MODES.split(","))
    parser.add_argument("--reference", default=REFERENCE, help="a mode, or none for times alone")
    parser.add_argument("--repetitions", type=int, default=15)
    parser.add_argument("--size", type=lambda text: parse_size("--size", text), default=(1024, 1024))
    parser.add_argument("--method", default="3dr-binning")
    parser.add_argument("--device", default=None)
    options = parser.parse_args()
    options.modes = [mode for mode in options.modes if mode != "none"]
    found = scenes(options.scenes)
    for name in options.scenes:
        if name in found:
            report(name, *found[name], options)
        else:
            print(f"{name}: left out: ../shared/scenes does not have it")
    return 0


if __name__ == "__main__":
    sys.exit(main())
