"""`clrast render`: from options and a file to images and stats."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import typer

from clrast.commands import messages
from clrast.commands import parameters as p
from clrast.commands.outputs import Outputs
from clrast.commands.progress import path_observer, progress
from clrast.commands.request import Request, make_request
from clrast.commands.stats import complete_stats, report_lines, summary, to_json
from clrast.commands.viewpoint import VIEW_NAMES, View, make_view
from clrast.errors import EXIT_BUDGET, EXIT_INTERRUPTED, EXIT_OK, InputNotFoundError, OutputError, UsageError
from clrast.image.header import effects_text
from clrast.opencl.binary_maker import kept_binaries
from clrast.options import OPTION_NAMES, RenderOptions, make_options
from clrast.shading.watch import Watch

if TYPE_CHECKING:
    from clrast.image.frame import Frame
    from clrast.scene.model import Scene

LIST_OPTIONS = ("aov", "effects", "oracle")
"""Options whose repetitions add up."""


@dataclass
class Job:
    """One call of `render`, checked. `given` : options of RenderOptions that were given; times in seconds.

    can_resume : whether --resume goes with all options, those of the scene's card too.
    """

    source: str
    given: dict[str, Any]
    view: View
    outputs: Outputs
    started: float
    report: bool = False
    json: bool = False
    quiet: bool = False
    times_ms: dict[str, float] = field(default_factory=dict)
    can_resume: bool = True

    @property
    def is_timed(self) -> bool:
        """Whether times decide something, or are what is asked for."""
        return "repeat" in self.given or "time_budget" in self.given


def render_command(
    context: typer.Context,
    input: p.Input,
    output: p.Output = None,
    size: p.Size = None,
    eye: p.Eye = None,
    look_at: p.LookAt = None,
    up: p.Up = None,
    fov: p.Fov = None,
    camera: p.CameraName = None,
    projection: p.ProjectionName = None,
    height: p.Height = None,
    precision: p.Precision = None,
    aa: p.Antialiasing = None,
    shading_rate: p.ShadingRate = None,
    filter: p.Filter = None,
    evaluation: p.Evaluation = None,
    samples: p.Samples = None,
    seed: p.Seed = None,
    max_depth: p.MaxDepth = None,
    quality: p.Quality = None,
    method: p.Method = None,
    oracle: p.Oracle = None,
    intersection: p.Intersection = None,
    accelerator: p.Accelerator = None,
    grid_resolution: p.GridResolution = None,
    mode: p.Mode = None,
    effects: p.Effects = None,
    aov: p.Aov = None,
    half: p.Half = False,
    stats: p.Stats = None,
    counters: p.Counters = False,
    report: p.Report = False,
    json: p.Json = False,
    quiet: p.Quiet = False,
    device: p.Device = None,
    threads: p.Threads = None,
    memory: p.Memory = None,
    time_budget: p.TimeBudget = None,
    resume: p.Resume = None,
    repeat: p.Repeat = None,
) -> int:
    """Render a mesh (.ply .obj .stl .off .glb .gltf) or a scene card (.toml) to an image.

    The order of options never matters. Values may begin with a minus.
    """
    values = {name: value for name, value in locals().items() if name != "context"}
    return run(values, context.obj["started"])


def run(values: Mapping[str, Any], started: float) -> int:
    """Check everything, then render and write. `values` : of `render_command`, by name."""
    job = make_job(values, started)
    check_input(job.source)
    job.outputs.check_writable()
    with nullcontext() if job.is_timed else kept_binaries():
        return _run(job)


def _run(job: Job) -> int:
    watch = Watch()
    try:
        stats = _render_and_write(job, watch)
    finally:
        job.outputs.discard()
    if job.json:
        messages.result(to_json(stats))
    elif job.report:
        messages.result("\n".join(report_lines(stats)))
    if not job.quiet:
        messages.note(summary(stats))
    return _exit_code(stats, watch, job)


def _exit_code(stats: Mapping[str, Any], watch: Watch, job: Job) -> int:
    """0, or why paths are missing from an image that is written all the same."""
    if watch.interrupted:
        return EXIT_INTERRUPTED
    if stats.get("stopped") is None:
        return EXIT_OK
    budget = job.given.get("time_budget")
    mend = "--resume FILE goes on" if job.can_resume else "give it more time, or use --aa ssaa:N with --resume FILE"
    messages.error(f"--time-budget {budget} is reached: the image has fewer paths than wanted: {mend}")
    return EXIT_BUDGET


@contextmanager
def _interruptible(watch: Watch) -> Iterator[None]:
    """The first interruption lets the render end with the paths that it has; a second one ends it at once."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number: int, frame: Any) -> None:
        if watch.interrupted:
            raise KeyboardInterrupt
        watch.interrupted = True

    before = signal.signal(signal.SIGINT, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def make_job(values: Mapping[str, Any], started: float) -> Job:
    """Parse and check all options; raises UsageError. Reads and writes nothing."""
    single = {name: once(name, texts) for name, texts in values.items()}
    given = {name: single[name] for name in OPTION_NAMES if single.get(name) not in (None, False)}
    if make_options(given, whole=False).repeat == 0 and "repeat" in given:
        raise UsageError("--repeat 0 renders nothing: give 1 or more, or leave it out")
    view = make_view({name: single[name] for name in VIEW_NAMES})
    if view.projection is not None:
        make_options(given, whole=False).check_projection(view.projection)
    outputs = Outputs(tuple(dict.fromkeys(values["output"] or ())), single["stats"], bool(single["half"]))
    outputs.check_usage(single["input"])
    if not outputs.images and not (single["stats"] or single["report"] or single["json"]):
        raise UsageError("no output: name an image, such as -o image.exr")
    shown = {name: single[name] for name in ("report", "json", "quiet")}
    return Job(single["input"], given, view, outputs, started, **shown)


def once(name: str, texts: Any) -> Any:
    """The one text of an option, or None; lists stay lists. Two different texts are a UsageError."""
    if not isinstance(texts, (list, tuple)):
        return texts
    if name in LIST_OPTIONS or name == "output":
        return list(texts) or None
    if len(set(texts)) > 1:
        raise UsageError(f"--{name.replace('_', '-')} is given as {' and as '.join(texts)}: give one")
    return texts[0] if texts else None


def check_input(path: str) -> None:
    """Raises InputNotFoundError unless there is something of that name; the loader looks closer."""
    if not os.path.exists(path):
        raise InputNotFoundError(f"{path} does not exist: check the name, relative to {os.getcwd()}")


def _render_and_write(job: Job, watch: Watch) -> dict[str, Any]:
    """Load, render, write; returns the complete stats. Notes come last: a failure is its one line alone."""
    with progress(job.quiet) as show:
        show(f"loading {job.source}")
        scene = _load(job)
        request = make_request(scene, job.view, job.given, job.source)
        for line in (*scene.warnings, *request.warnings):
            messages.warn(line)
        show(f"rendering {scene.triangle_count} triangles")
        watch.observer = path_observer(show)
        job.can_resume = request.options.can_resume
        frame, exr_frame = _render(scene, request, job, watch)
        show("writing")
        stats = _write(frame, exr_frame, request, job)
    if not job.quiet:
        for line in request.notes:
            messages.note(line)
    return stats


def _load(job: Job) -> Scene:
    from clrast.scene.load import load

    before = time.perf_counter()
    scene = load(job.source)
    job.times_ms["load"] = 1000 * (time.perf_counter() - before)
    return scene


def _render(scene: Scene, request: Request, job: Job, watch: Watch) -> tuple[Frame, Frame]:
    """The frame of pictures and the frame of EXR files: the same, unless a PNG alone wants colour."""
    from clrast.renderer import render

    options = request.options
    if not job.outputs.has_png or "color" in options.aov:
        with _interruptible(watch) if options.mode == "path" else nullcontext():
            frame = render(scene, request.camera, options=options, watch=watch)
        return frame, frame
    frame = render(scene, request.camera, options=replace(options, aov=("color", *options.aov)))
    return frame, _without_color(frame, scene, options)


def _without_color(frame: Frame, scene: Scene, options: RenderOptions) -> Frame:
    """The frame that `options` alone give: no colour, and in the header only the effects that they call for."""
    from clrast.image.frame import CHANNEL_GROUPS
    from clrast.shading.effects import plan_effects

    channels = {name: values for name, values in frame.channels.items() if name not in CHANNEL_GROUPS["color"]}
    plan = plan_effects(scene, options.aov, options.effects, options.mode)
    effects = effects_text(effect.name for effect in plan.effects if effect.on)
    # Without colour no ray goes on from a hit, and nothing is antialiased.
    of_color = ["max_depth", "samples", "seed", "shading_rate", "filter"]
    of_color += [] if plan["derivatives"] else ["derivatives"]
    kept = {name: value for name, value in frame.header.items() if name not in of_color}
    return type(frame)(channels, {**kept, "aa": "none", "effects": effects}, frame.stats)


def _write(frame: Frame, exr_frame: Frame, request: Request, job: Job) -> dict[str, Any]:
    """Put every file in place, or none; returns the complete stats."""
    before = time.perf_counter()
    if request.options.threads is not None and job.outputs.images:
        from clrast.image.exr import limit_threads

        limit_threads(request.options.threads)
    try:
        job.outputs.prepare_images(frame, exr_frame)
    except OSError as fault:
        reason = fault.strerror or fault
        raise OutputError(f"cannot write the image: {reason}: free space or name another file") from None
    now = time.perf_counter()
    job.times_ms["write"] = 1000 * (now - before)
    job.times_ms["total"] = 1000 * (now - job.started)
    stats = complete_stats(frame.stats, request.options, job.times_ms)
    job.outputs.prepare_stats(to_json(stats))
    job.outputs.commit()
    return stats
