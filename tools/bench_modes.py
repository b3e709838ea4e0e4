#!/usr/bin/env python3
"""Times paths in a Cornell box, with Mitsuba 3 (`llvm_ad_rgb` and `scalar_rgb`) as a peer in the same run.

    python tools/bench_modes.py                              512x512, 16 samples, 1 and 4 bounces
    python tools/bench_modes.py --repetitions 15 --bounces 4 --peers llvm_ad_rgb
    python tools/bench_modes.py --peer-path FOLDER           with a Mitsuba that is installed elsewhere

The room is that of tests/cornell_box.py, which tests/test_modes_mitsuba.py compares with Mitsuba's: the same triangles,
camera, lamp, longest paths and Russian roulette. Mitsuba's surfaces are its own `principled` with the same parameters,
or `--bsdf diffuse`, which is less work. The mean of each image beside that of `ssaa` shows how near they are.
    ssaa   clrast, samples anywhere in a pixel and a path of each: what Mitsuba does
    paths  clrast, as many paths of the pixel's centre, whose visibility is found once
Each repetition renders with all in turn, so that a machine that drifts drifts for all. Times are of whole frames until
they are in arrays of the host, scene and kernels made beforehand; the table gives medians with the 10th and 90th
percentile, and the median of the paired ratios to `ssaa`. Below it are clrast's stages, the least of each, and what the
scenes took to make: clrast's structures, corners, buffers and kernels, Mitsuba's whole scene.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from cornell_box import card_text  # noqa: E402

from clrast.errors import ClrastError  # noqa: E402
from clrast.job import RenderJob  # noqa: E402
from clrast.opencl.device import open_device  # noqa: E402
from clrast.options import make_options  # noqa: E402
from clrast.scene.camera import camera_vectors  # noqa: E402
from clrast.scene.load import load  # noqa: E402
from clrast.scene.model import Scene  # noqa: E402
from clrast.shading.effects import plan_effects  # noqa: E402

PEERS = "llvm_ad_rgb,scalar_rgb"
WORKER = ROOT / "tools" / "bench_modes_peer.py"
MISSING = "Mitsuba 3 is not installed, clrast is timed alone: pip install 'clrast[peers]', or --peer-path FOLDER"
BUILDS = ("build", "prepare", "upload", "kernels")


class Clrast:
    """One way to take the samples. aa, samples : options of that name."""

    def __init__(self, scene: Scene, options: argparse.Namespace, bounces: int, aa: str, samples: int) -> None:
        side, device = options.size, open_device(options.device, options.threads)
        given = make_options({
            "size": (side, side), "mode": "path", "aov": "color", "aa": aa, "samples": samples, "max_depth": bounces,
            "accelerator": options.accelerator,
        })  # fmt: skip
        vectors = camera_vectors(scene.cameras[0], side, side)
        plan = plan_effects(scene, given.aov, given.effects, given.mode, given.ray_accelerator)
        self.job = RenderJob(device, scene, vectors, given, plan)
        self.channels = self.job.allocate()
        self.is_first = True

    def render(self, seed: int) -> tuple[float, np.ndarray]:
        """Milliseconds of a frame, and its mean RGB. The seed stays: frames are the same bits."""
        started = time.perf_counter()
        self.job.render_frame(self.channels, first=self.is_first)
        spent = 1000 * (time.perf_counter() - started)
        self.is_first = False
        return spent, np.array([self.channels[name].astype(np.float64).mean() for name in "RGB"])

    def report(self) -> list[str]:
        """The least time of each stage, and the last frame's secondary rays."""
        stats = self.job.stats()
        times, costs = stats["times_ms"], stats["effect_costs"]
        stages = ", ".join(f"{name} {times[name]:.1f}" for name in ("setup", "bin", "visibility", "shade", "resolve"))
        lines = [f"    stages   {stages} ms"]
        for name, cost in costs.items():
            rays = f"{cost['rays'] / 1e6:.2f} M rays, {cost['launches']} launches"
            lines.append(f"    {name:<14} {cost['ms']:8.1f} ms  {rays}")
        return lines


class Peer:
    """Mitsuba in a variant. Raises RuntimeError with its last words where it does not start."""

    def __init__(self, variant: str, options: argparse.Namespace, bounces: int, folder: Path) -> None:
        environment = dict(os.environ)
        if options.peer_path:
            paths = [options.peer_path, environment.get("PYTHONPATH", "")]
            environment["PYTHONPATH"] = os.pathsep.join(path for path in paths if path)
        self.bounces, self.samples = bounces, options.samples
        command = [sys.executable, str(WORKER), variant, options.bsdf, str(folder), str(options.size)]
        self._log = (folder / f"{variant}.log").open("w+")
        pipes: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": self._log}
        self._process = subprocess.Popen(command, env=environment, text=True, **pipes)
        self.load_ms = float(self._answer()[1])

    def _answer(self) -> list[str]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            self._log.seek(0)
            raise RuntimeError((self._log.read().strip().splitlines() or ["it ended without a word"])[-1])
        return line.split()

    def render(self, seed: int) -> tuple[float, np.ndarray]:
        assert self._process.stdin is not None
        self._process.stdin.write(f"{self.bounces} {self.samples} {seed}\n")
        self._process.stdin.flush()
        spent, *mean = (float(text) for text in self._answer())
        return spent, np.array(mean)

    def close(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(timeout=60)
        self._log.close()


def start_peers(options: argparse.Namespace, bounces: int, folder: Path) -> dict[str, Peer]:
    """The variants that start; those that do not are said."""
    peers = {}
    for variant in options.peers:
        try:
            peers[variant] = Peer(variant, options, bounces, folder)
        except (OSError, RuntimeError) as error:
            print(f"  {variant} is left out: {error}")
    return peers


def measure(scene: Scene, bounces: int, options: argparse.Namespace, folder: Path) -> None:
    """Print the table of a number of bounces."""
    own = {
        "ssaa": Clrast(scene, options, bounces, f"ssaa:{options.samples}", 1),
        "paths": Clrast(scene, options, bounces, "none", options.samples),
    }
    peers = start_peers(options, bounces, folder)
    all_: dict[str, Clrast | Peer] = {**own, **peers}
    firsts = {name: each.render(0)[0] for name, each in all_.items()}
    times: dict[str, list[float]] = {name: [] for name in all_}
    means: dict[str, list[np.ndarray]] = {name: [] for name in all_}
    for k in range(options.repetitions):
        for name, each in all_.items():
            spent, mean = each.render(k + 1)
            times[name].append(spent)
            means[name].append(mean)
    for peer in peers.values():
        peer.close()
    rays = options.samples * options.size**2
    print(f"{bounces} bounce(s), {options.size}x{options.size}, {options.samples} samples")
    for name, spent in times.items():
        low, middle, high = np.percentile(spent, (10, 50, 90))
        ratio = np.percentile(np.array(spent) / times["ssaa"], (10, 50, 90))
        differs = (np.mean(means[name], axis=0) / np.mean(means["ssaa"], axis=0) - 1) * 100
        line = f"  {name:<12} {middle:8.1f} ms ({low:.1f} .. {high:.1f})  {rays / middle / 1000:6.2f} M samples/s"
        line += f"  {ratio[1]:5.2f} x ssaa ({ratio[0]:.2f} .. {ratio[2]:.2f})"
        print(line + "  mean " + " ".join(f"{value:+.1f}" for value in differs) + " %")
    for name, each in own.items():
        print(f"  {name}")
        print("\n".join(each.report()))
    for name, each in own.items():
        made = ", ".join(f"{stage} {each.job.times.get(stage, 0.0):.1f}" for stage in BUILDS)
        print(f"  made  {name:<12} {made} ms; first frame {firsts[name]:.0f} ms")
    for variant, peer in peers.items():
        print(f"  made  {variant:<12} scene {peer.load_ms:.1f} ms; first frame {firsts[variant]:.0f} ms")


def names(text: str) -> list[str]:
    return [each for each in text.split(",") if each]


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=512, help="pixels a side")
    parser.add_argument("--samples", type=int, default=16)
    parser.add_argument("--bounces", type=lambda text: [int(each) for each in text.split(",")], default=[1, 4])
    parser.add_argument("--repetitions", type=int, default=9)
    parser.add_argument("--peers", type=names, default=names(PEERS), help="variants of Mitsuba, or nothing")
    parser.add_argument("--peer-path", default=None, help="folder of Python packages that has Mitsuba")
    parser.add_argument("--bsdf", choices=("principled", "diffuse"), default="principled", help="of Mitsuba's surfaces")
    parser.add_argument("--accelerator", choices=("auto", "bvh", "grid"), default="auto")
    parser.add_argument("--threads", type=int, default=None)
    parser.add_argument("--device", default=None)
    options = parser.parse_args(arguments)
    if options.peers and not options.peer_path and importlib.util.find_spec("mitsuba") is None:
        print(MISSING)
        options.peers = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "box.toml").write_text(card_text())
        try:
            scene = load(folder / "box.toml")
            for bounces in options.bounces:
                measure(scene, bounces, options, folder)
        except ClrastError as error:
            print(error, file=sys.stderr)
            return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
