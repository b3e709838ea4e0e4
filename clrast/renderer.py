"""Scene + camera + options -> frame: one page that says what happens in which order.

  plan the effects, open the device, put the scene there
  setup once; then for each band of tile rows: bin, rasterize, shade, and read the channels back
  behind BLEND surfaces: rasterize what lies behind the layer before, shade it, until nothing is open
"""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from clrast.errors import UsageError
from clrast.image.files import check_writable
from clrast.image.frame import Frame
from clrast.image.header import resolved_header
from clrast.job import RenderJob
from clrast.opencl.device import Device, open_device
from clrast.options import RenderOptions, cube_side, make_options
from clrast.scene.camera import CameraVectors, camera_vectors, cube_faces, cube_vectors, frame_scene
from clrast.scene.content import content_digest
from clrast.scene.model import Camera, Scene
from clrast.shading.accumulation import Accumulation
from clrast.shading.antialias import antialiasing_of
from clrast.shading.effects import EffectPlan, plan_effects
from clrast.shading.watch import Watch
from clrast.visibility.cost_model import (
    CANDIDATE,
    TRIAL_FRAMES,
    is_worth_a_trial,
    reason_of_trial,
    reason_without_choice,
    reason_without_trial,
)
from clrast.visibility.loop_limits import loop_limit
from clrast.visibility.methods import AUTO, resolve_method
from clrast.visibility.tiles import TileRasterizer

_ONE_AT_A_TIME = threading.Lock()
"""Threads share a device's kernels, whose arguments are set before each launch: renders take turns."""


def render(
    scene: Scene,
    camera: Camera | None = None,
    *,
    options: RenderOptions | None = None,
    watch: Watch | None = None,
    **named: Any,
) -> Frame:
    """Render a scene; returns its channels, a header that says how it was made, and stats.

    camera : None frames the scene, or takes the file's first camera. options or named : see
    RenderOptions. watch : may stop paths early, and is told of progress; `stats["stopped"]` says why paths are missing.
    Raises UsageError, DeviceError, CapacityError; for a file to resume from SceneError, OutputError.
    """
    options = options or make_options(named)
    options.check_together()
    started = time.perf_counter()
    width, height = options.size
    if camera is None:
        camera = scene.cameras[0] if scene.cameras else frame_scene(scene, width, height)
    options.check_projection(camera.projection)
    if camera.projection == "cube":
        return render_cube(scene, camera, options, watch)
    vectors = camera_vectors(camera, width, height)
    plan = plan_effects(scene, options.aov, options.effects, options.mode, options.ray_accelerator)
    watch = watch or Watch()
    if options.time_budget is not None:
        watch.deadline = started + options.time_budget
    header = resolved_header(options, vectors.named(), [e.name for e in plan.effects if e.on], vectors.projection)
    if vectors.projection == "fisheye":
        header["fov"] = camera.fov
    accumulation = _accumulation(scene, options, header, plan, watch)
    planned = time.perf_counter()
    device = open_device(options.device, options.threads)
    opened = time.perf_counter()
    with _ONE_AT_A_TIME:
        job = start_job(device, scene, vectors, options, plan, accumulation)
        job.times["plan"] = 1000 * (planned - started) + job.trial_ms
        job.times["device"] = 1000 * (opened - planned)
        frame_count = max(1, options.repeat + (1 if options.repeat else 0))
        channels = job.allocate()
        for k in range(frame_count):
            job.render_frame(channels, first=k == 0 or (k == 1 and options.repeat > 0))
    accumulation.save()
    stats = job.stats()
    stats["stopped"] = watch.stopped
    if watch.stopped is not None:
        low, high = accumulation.paths_done
        header["samples"] = str(low) if low == high else f"{low}-{high}"
    stats["times_ms"]["total"] = 1000 * (time.perf_counter() - started)
    return Frame(channels, header, stats)


def _accumulation(
    scene: Scene, options: RenderOptions, header: dict[str, Any], plan: EffectPlan, watch: Watch
) -> Accumulation:
    """Where paths are summed; with --resume in a file, which knows what it belongs to."""
    if options.resume is None:
        return Accumulation(watch)
    if not plan["indirect light"]:
        raise UsageError("--resume keeps sums of paths, and none are traced here: use --mode path, or leave it out")
    check_writable(options.resume, suffixes=None)
    decides = {name: value for name, value in header.items() if name != "samples"}
    return Accumulation(watch, options.resume, content_digest(scene, decides, options.aov))


def render_cube(scene: Scene, camera: Camera, options: RenderOptions, watch: Watch | None = None) -> Frame:
    """Six views of 90 degrees, one below the other in OpenEXR's order; stats are those of all six."""
    started = time.perf_counter()
    side = cube_side(options.size)
    options = replace(options, size=(side, 6 * side))
    of_face = replace(options, size=(side, side))
    frames = [render(scene, face, options=of_face, watch=watch) for face in cube_faces(camera)]
    channels = {name: np.concatenate([frame[name] for frame in frames]) for name in frames[0]}
    plan = plan_effects(scene, options.aov, options.effects, options.mode, options.ray_accelerator)
    vectors = cube_vectors(camera)
    header = resolved_header(options, vectors, [e.name for e in plan.effects if e.on], camera.projection)
    if "samples" in header:
        # Of a render that was stopped: the fewest and the most paths of any face.
        counts = [int(count) for frame in frames for count in str(frame.header["samples"]).split("-")]
        header["samples"] = str(min(counts)) if min(counts) == max(counts) else f"{min(counts)}-{max(counts)}"
    stats = {**frames[-1].stats, "camera": vectors, "image": {"width": side, "height": 6 * side}}
    for group in ("counts", "other_counts", "times_ms"):
        stats[group] = add_counts([frame.stats[group] for frame in frames])
    stats["counts"]["triangles"] = scene.triangle_count
    stats["times_ms"]["total"] = 1000 * (time.perf_counter() - started)
    return Frame(channels, header, stats)


def add_counts(tables: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Sums of the numbers under each name; what is None anywhere stays None, and a list is that of the last table."""
    names = {name: None for table in tables for name in table}
    found = {name: [table.get(name, 0) for table in tables] for name in names}
    return {
        name: None if None in values else values[-1] if isinstance(values[-1], list) else sum(values)
        for name, values in found.items()
    }


def start_job(
    device: Device,
    scene: Scene,
    vectors: CameraVectors,
    options: RenderOptions,
    plan: EffectPlan,
    accumulation: Accumulation | None = None,
) -> RenderJob:
    """The job of the method that the options name; with `auto` the fastest, by frames of the view itself."""
    job = RenderJob(device, scene, vectors, options, plan, accumulation=accumulation)
    if options.method != AUTO or options.casts_grid:
        return job
    antialiasing = antialiasing_of(options)
    job.reason = reason_without_choice(
        options.precision,
        lists_samples=antialiasing.lists_samples and isinstance(job.tiles, TileRasterizer) and job.tiles.takes_samples,
        is_limited=loop_limit(device) is not None or len(job.bands) > 1 or options.memory is not None,
    )  # fmt: skip
    if job.reason is not None:
        return job
    started = time.perf_counter()
    passes = max(1, len(antialiasing.pattern))
    job.time_frame()  # the first one waits for what the driver still compiles
    default = job.time_frame().with_passes(passes)
    counts = job.count_view()
    if is_worth_a_trial(counts, default):
        method = resolve_method(CANDIDATE, evaluation=options.evaluation)
        other = RenderJob(device, scene, vectors, options, plan, method, accumulation)
        other.time_frame()
        pairs = [(job.time_frame(), other.time_frame()) for _ in range(TRIAL_FRAMES)]
        default, candidate = (
            min((each.with_passes(passes) for each in times), key=lambda each: each.total)
            for times in zip(*pairs, strict=True)
        )
        job.reason = other.reason = reason_of_trial(default, candidate)
        if candidate.total < default.total:
            job = other
    else:
        job.reason = reason_without_trial(counts, default)
    # What was built for a method that then is not used was part of the trial.
    job.trial_ms = max(0.0, 1000 * (time.perf_counter() - started) - job.times["build"])
    return job
