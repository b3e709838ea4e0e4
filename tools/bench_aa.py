#!/usr/bin/env python3
"""What each mode of `--aa` costs and how far its colour is from many samples.

    python tools/bench_aa.py                              icosphere, and what ../shared/scenes has
    python tools/bench_aa.py --modes none,msaa:16,csaa:4+12 --repetitions 30 --scenes bunny,dragon
    python tools/bench_aa.py --mode whitted               1 shadow ray and 1 reflection ray of each shaded sample

A mode is one of `--aa`, with `/sample`, `/auto` or `/auto:EPS` behind it for that `--shading-rate`. All modes render
each scene in turn, so that a machine that drifts drifts for all. A time is that of a whole frame: setup, binning,
visibility, shading, resolve and reading the channels back, not of loading and writing. The table gives medians with the
10th and 90th percentile and the median of the paired ratios to `none`. The error is the root mean square over R, G, B
and over A, of the pixels where the reference and `none` differ (edges, textures, and with rays shadows and mirrored
things) against `--reference`, which comes from the same kernels: it measures sampling, not shading. `edges` is the
error where a sample of the pixel shows another triangle than its centre (which `msaa` finds), `inside` that of the
other pixels.

Modes `shadow` and `whitted` measure what Davidovic et al., '3D Rasterization', Fig. 8, do ('recursive ray tracing with
1 shadow ray, and 1 reflection ray for every sample'; their 16 x MSAA takes 11 times as long as no antialiasing, their
CSAA with 4 shading and 12 coverage samples 4.3 times), on the same scenes made like theirs (light_and_mirrors): one
point light takes the place of a scene's lights, a little above and to the right of the eye, so that it shines on nearly
all that the eye sees; every material is opaque and a mirror over what it is, half of it metal; rays end after one
reflection. Rays for each shaded sample that hits something, by the counters of `none`, stand below the scene's name:
shadow rays from what the eye sees and reflection rays from there, one each where the light is before the surface, and
shadow rays from what the mirrors show besides.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tools")]

from bench import scenes  # noqa: E402

from clrast.image.frame import Frame  # noqa: E402
from clrast.job import RenderJob  # noqa: E402
from clrast.opencl import buffers  # noqa: E402
from clrast.opencl.device import open_device  # noqa: E402
from clrast.opencl.layout import NO_HIT  # noqa: E402
from clrast.option_values import parse_size  # noqa: E402
from clrast.options import RenderOptions, parse_effects  # noqa: E402
from clrast.scene.camera import camera_vectors  # noqa: E402
from clrast.scene.load import load  # noqa: E402
from clrast.scene.model import Camera, Light, Material, Scene  # noqa: E402
from clrast.shading.effects import plan_effects  # noqa: E402
from clrast.shading.multisample import Multisampler  # noqa: E402

ROOM = "room"
NAMES = "icosphere,bunny,dragon,sponza inside"
NAMES_OF_RAYS = "icosphere,bunny,room,sponza inside"
MODES = "none,msaa:4,msaa:8,msaa:16,csaa:4+12,csaa:8+8,ssaa:4,ssaa:16,auto:0.05,auto:0.01"
MODES_OF_RAYS = "none,msaa:16/sample,msaa:16,msaa:16/auto,csaa:4+12/sample,csaa:4+12,csaa:4+12/auto,ssaa:16"
REFERENCE, REFERENCE_OF_RAYS = "ssaa:1024", "ssaa:256"
WARM_UP = 2

Channels = dict[str, np.ndarray]


def light_and_mirrors(scene: Scene, camera: Camera) -> Scene:
    """The scene with one point light near the eye, and every material a mirror over what it is; see above."""
    low, high = scene.bounding_box()
    eye, target = np.array(camera.eye), np.array(camera.look_at)
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, camera.up)
    right /= np.linalg.norm(right)
    far = float(np.linalg.norm(np.clip(eye, low, high) - eye)) or 0.25 * float(np.linalg.norm(high - low))
    position = eye + 0.03 * far * (right + 2.0 * np.cross(right, forward))
    light = Light("lamp", "point", (8.0 * far * far,) * 3, tuple(float(c) for c in position))  # type: ignore[arg-type]

    def mirrored(material: Material) -> Material:
        mode = "OPAQUE" if material.alpha_mode == "BLEND" else material.alpha_mode
        return replace(material, metallic=0.5, roughness=0.0, transmission=0.0, alpha_mode=mode, unlit=False)

    return replace(scene, lights=(light,), materials=tuple(mirrored(m) for m in scene.materials))


def make_job(scene: Scene, camera: Camera, mode: str, options: argparse.Namespace, rays: str) -> RenderJob:
    """rays : the mode in which light is followed."""
    aa, _, rate = mode.partition("/")
    given = RenderOptions(
        size=options.size, aa=aa, method=options.method, mode=rays, max_depth=1, shading_rate=rate or "pixel",
        effects=options.effects, aov=("color",) if rays != "cast" else ("color", "depth"),
    )  # fmt: skip
    plan = plan_effects(scene, given.aov, given.effects, rays)
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


def error_of(found: Channels, reference: Channels, names: str, where: np.ndarray) -> float:
    """Root mean square over channels, of the pixels of a mask."""
    if not where.any():
        return 0.0
    squares = [np.mean((found[name][where].astype(np.float64) - reference[name][where]) ** 2) for name in names]
    return float(np.sqrt(np.mean(squares)))


def edges_of(jobs: dict[str, tuple[RenderJob, Channels]]) -> np.ndarray | None:
    """(height, width) where a sample of the first mode that shares all shading shows another triangle than the centre.

    None where no mode does or the image has several bands.
    """
    for job, channels in jobs.values():
        if isinstance(job.resolver, Multisampler) and not job.resolver.parts and job.band_count == 1:
            shape = channels["R"].shape
            places = buffers.download(job.device, job.resolver.edges.places, np.uint32, shape)
            return places != NO_HIT
    return None


def count_rays(scene: Scene, camera: Camera, options: argparse.Namespace) -> str:
    """What a sample that hits something sends, from the counters."""
    counts = {}
    for rays in {"shadow", options.mode}:
        job = make_job(scene, camera, "none", options, rays)
        job.render_frame(job.allocate(), first=True)
        counts[rays] = job.stats()["counts"]
    hits, own = counts["shadow"]["hits"], counts["shadow"]["rays_shadow"]
    text = f"of {hits:,} hits each sends {own / hits:.2f} shadow rays"
    if options.mode == "whitted":
        found = counts["whitted"]
        text += f" and {found['rays_reflection'] / hits:.2f} reflection rays"
        text += f"; {(found['rays_shadow'] - own) / hits:.2f} shadow rays from what these meet"
    return text


def report(name: str, scene: Scene, camera: Camera, options: argparse.Namespace) -> None:
    made = {mode: make_job(scene, camera, mode, options, options.mode) for mode in ("none", *options.modes)}
    jobs = {mode: (job, job.allocate()) for mode, job in made.items()}
    times = measure(jobs, options.repetitions)
    print(f"\n{name}: {scene.triangle_count} triangles, {options.size[0]}x{options.size[1]}")
    if options.mode != "cast":
        print(count_rays(scene, camera, options))
    head = f"{'mode':<19} {'ms':>8} {'p10':>8} {'p90':>8} {'ratio':>6} {'p10':>6} {'p90':>6} {'samples shaded':>15}"
    if options.reference == "none":
        print(head)
        errors = {}
    else:
        print(f"{head} {'colour':>8} {'edges':>8} {'inside':>8} {'alpha':>8}")
        errors = find_errors(jobs, scene, camera, options)
        if options.pictures:
            save(jobs, name, options)
    for mode, (job, _) in jobs.items():
        low, middle, high = np.percentile(times[mode], (10, 50, 90))
        ratios = np.percentile(times[mode] / times["none"], (50, 10, 90))
        pixels = options.size[0] * options.size[1]
        shaded = pixels if job.resolver is None else job.resolver.counts["samples_shaded"]
        row = f"{mode:<19} {middle:8.1f} {low:8.1f} {high:8.1f} " + " ".join(f"{ratio:6.2f}" for ratio in ratios)
        print(f"{row} {shaded:15,}" + "".join(f" {error:8.5f}" for error in errors.get(mode, ())), flush=True)


def find_errors(
    jobs: dict[str, tuple[RenderJob, Channels]], scene: Scene, camera: Camera, options: argparse.Namespace
) -> dict[str, tuple[float, ...]]:
    """Errors of each mode: of colour, of it at edges and inside, of alpha; the reference joins `options.found`."""
    job = make_job(scene, camera, options.reference, options, options.mode)
    reference = options.found = job.allocate()
    job.render_frame(reference, first=True)
    differs = np.any([jobs["none"][1][name] != reference[name] for name in "RGBA"], axis=0)
    edges = edges_of(jobs)
    parts = [differs] if edges is None else [differs, differs & edges, differs & ~edges]
    found = {}
    for mode, (_, channels) in jobs.items():
        colors = [error_of(channels, reference, "RGB", where) for where in parts] + [float("nan")] * (3 - len(parts))
        found[mode] = (*colors, error_of(channels, reference, "A", differs))
    return found


def save(jobs: dict[str, tuple[RenderJob, Channels]], name: str, options: argparse.Namespace) -> None:
    """Write what each mode and the reference show, PNG and EXR."""
    options.pictures.mkdir(parents=True, exist_ok=True)
    for mode, channels in (*((mode, each) for mode, (_, each) in jobs.items()), (options.reference, options.found)):
        stem = f"{name}-{mode}".translate(str.maketrans(" :/", "---"))
        for suffix in ("png", "exr"):
            Frame(channels, {}, {}).save(str(options.pictures / f"{stem}.{suffix}"))


def scenes_of(options: argparse.Namespace) -> Iterator[tuple[str, Scene, Camera]]:
    found = scenes(options.scenes)
    if ROOM in options.scenes:
        scene = load(str(ROOT / "data" / "room.toml"))
        found[ROOM] = (scene, scene.cameras[0])
    for name in options.scenes:
        if name not in found:
            print(f"{name}: left out: ../shared/scenes does not have it")
            continue
        scene, camera = found[name]
        yield name, scene if options.mode == "cast" else light_and_mirrors(scene, camera), camera


def main() -> int:
    def names(text: str) -> list[str]:
        return text.split(",")

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mode", choices=("cast", "shadow", "whitted"), default="cast", help="[default: cast]")
    parser.add_argument("--scenes", type=names, help=f"[default: {NAMES}; with rays {NAMES_OF_RAYS}]")
    parser.add_argument("--modes", type=names, help=f"[default: {MODES}; with rays {MODES_OF_RAYS}]")
    reference = f"a mode, or none for times alone [{REFERENCE}; with rays {REFERENCE_OF_RAYS}]"
    parser.add_argument("--reference", help=reference)
    parser.add_argument("--repetitions", type=int, default=15)
    parser.add_argument("--size", type=lambda text: parse_size("--size", text), help="[1024x1024; with rays 512x512]")
    parser.add_argument("--method", default="3dr-binning")
    parser.add_argument("--effects", type=lambda text: parse_effects("--effects", text), default={})
    parser.add_argument("--pictures", type=Path, help="write what each mode shows into this folder")
    parser.add_argument("--device", default=None)
    options = parser.parse_args()
    is_cast = options.mode == "cast"
    options.scenes = options.scenes or names(NAMES if is_cast else NAMES_OF_RAYS)
    options.modes = [mode for mode in options.modes or names(MODES if is_cast else MODES_OF_RAYS) if mode != "none"]
    options.reference = options.reference or (REFERENCE if is_cast else REFERENCE_OF_RAYS)
    options.size = options.size or ((1024, 1024) if is_cast else (512, 512))
    for name, scene, camera in scenes_of(options):
        report(name, scene, camera, options)
    return 0


if __name__ == "__main__":
    sys.exit(main())
