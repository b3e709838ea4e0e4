"""What accuracy costs in time on a scene: the error and the time of a frame for every setting of every knob.

The reference is the scene by exact arithmetic with very many samples a pixel (accuracy_cache.py keeps it between runs);
errors are those of linear colour against it, and beside them stands how many samples at the pixels' centres show
another triangle than exact arithmetic does. Times come from rounds in which all settings take turns.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from clrast.errors import DeviceError, UsageError
from clrast.image.header import resolved_header
from clrast.opencl.constants import VISIT_SAMPLES
from clrast.opencl.device import Device, open_device
from clrast.options import RenderOptions, check_single_view
from clrast.scene.camera import CameraVectors, camera_vectors
from clrast.scene.model import Camera, Scene
from clrast.shading.antialias import antialiasing_of
from clrast.shading.effects import plan_effects
from clrast.study import accuracy_cache as cache
from clrast.study.accuracy_errors import DEFAULT_METRIC, METRICS, Errors, has_flip, measure_errors
from clrast.study.accuracy_front import LEAST_NOISE, Point, noise_of, pareto_front, unclear_names
from clrast.study.accuracy_knobs import (
    CONVERGENCE,
    CONVERGENCE_OF_PATHS,
    DEFAULT,
    KNOB_NAMES,
    PATH,
    REFERENCE_SAMPLES,
    Setting,
    make_settings,
    sample_count,
)
from clrast.study.accuracy_runs import LONG_PART, JobPool, Show, choose_method, measure_rounds
from clrast.visibility.methods import AUTO

DEFAULT_BUDGET = 60.0
"""Seconds of measured frames."""
TIME_OF_FRAME = "setup, bin, visibility, shade, resolve and reading the channels back"

Keep = Callable[[str, np.ndarray, np.ndarray], None]
"""Takes a setting's name, its (H, W, 3) float32 colour, and that of the reference."""


@dataclass(frozen=True)
class Row:
    """What was measured of a setting. times_ms : of its frames, by round.

    wrong_samples : pixels whose centre shows another triangle than the rung `exact` gives.
    """

    setting: Setting
    method: str
    times_ms: Mapping[int, float]
    errors: Errors
    wrong_samples: int

    @property
    def name(self) -> str:
        return self.setting.name

    def percentile(self, share: float) -> float:
        """Milliseconds that `share` per cent of the frames stay under, interpolated."""
        return float(np.percentile(list(self.times_ms.values()), share))

    @property
    def median_ms(self) -> float:
        return self.percentile(50)

    def point(self, metric: str, noise: float = LEAST_NOISE) -> Point:
        return Point(self.name, self.errors.value(metric), self.times_ms, len(self.setting.changes), noise)


@dataclass(frozen=True)
class Reference:
    """The image that errors are measured against. seconds : of rendering it, 0 where it was kept from before.

    own_rmse : its own error as its samples promise, from that of the supersampled setting with the most samples.
    """

    options: RenderOptions
    color: np.ndarray
    seconds: float
    cached: bool
    own_rmse: float | None = None


@dataclass(frozen=True)
class Accuracy:
    """A whole study. left_out : name of a setting or of a knob -> why it was not measured."""

    scene: str
    triangle_count: int
    size: tuple[int, int]
    device: str
    projection: str
    metric: str
    budget_s: float
    reference: Reference
    rows: tuple[Row, ...]
    left_out: Mapping[str, str] = field(default_factory=dict)

    @property
    def default(self) -> Row:
        return self.rows[0]

    def row(self, name: str) -> Row:
        return next(row for row in self.rows if row.name == name)

    def error(self, row: Row) -> float:
        """The error of a row by the metric of the study."""
        return row.errors.value(self.metric)

    @cached_property
    def front(self) -> tuple[Row, ...]:
        """The rows worth their time, fastest first."""
        return tuple(self.row(point.name) for point in pareto_front([self.point(row) for row in self.rows]))

    @cached_property
    def noise(self) -> float:
        """How far a single ratio of two times may be off in this run."""
        return noise_of(row.times_ms for row in self.rows)

    def point(self, row: Row) -> Point:
        """A row as the front sees it."""
        return row.point(self.metric, self.noise)

    def relative(self, row: Row) -> float:
        """A row's time over the default's: the median ratio of the rounds that have both."""
        base = self.default.times_ms
        ratios = [row.times_ms[k] / base[k] for k in row.times_ms if k in base]
        return float(np.median(ratios)) if ratios else row.median_ms / self.default.median_ms

    def as_dict(self) -> dict[str, Any]:
        """Plain data, as --json prints it: milliseconds, errors of linear colour, options by name."""
        front = {row.name for row in self.front}
        options = self.reference.options
        return {
            "scene": self.scene,
            "triangles": self.triangle_count,
            "image": {"width": self.size[0], "height": self.size[1]},
            "device": self.device,
            "projection": self.projection,
            "metric": self.metric,
            "time_of_a_frame": TIME_OF_FRAME,
            "budget_s": self.budget_s,
            "noise": self.noise,
            "reference": {
                "precision": options.precision, "aa": options.aa, "cached": self.reference.cached,
                "seconds": self.reference.seconds, "own_rmse": self.reference.own_rmse,
            },
            "front": [row.name for row in self.front],
            "settings": [self._row_dict(row, row.name in front) for row in self.rows],
            "left_out": dict(self.left_out),
        }  # fmt: skip

    def _row_dict(self, row: Row, is_on_front: bool) -> dict[str, Any]:
        width, height = self.size
        return {
            "name": row.name,
            "knob": row.setting.knob,
            "options": dict(row.setting.changes),
            "method": row.method,
            "on_front": is_on_front,
            "frame_ms": {
                "median": row.median_ms, "p10": row.percentile(10), "p90": row.percentile(90),
                "frames": len(row.times_ms),
            },
            "relative": self.relative(row),
            "errors": row.errors.as_dict(),
            "wrong_samples": row.wrong_samples,
            "samples": width * height,
        }  # fmt: skip


def study_accuracy(
    scene: Scene,
    camera: Camera,
    options: RenderOptions,
    *,
    metric: str = DEFAULT_METRIC,
    reference_samples: int = REFERENCE_SAMPLES,
    knobs: Sequence[str] = KNOB_NAMES,
    budget_s: float = DEFAULT_BUDGET,
    use_cache: bool = True,
    keep: Keep | None = None,
    show: Show = lambda text: None,
) -> Accuracy:
    """Measure every setting of a view of a scene. options : the default setting. keep : is shown each image.

    knobs : names of those to turn. budget_s : seconds of measured frames.
    """
    check_single_view(camera.projection, "accuracy")
    options = replace(options, counters=False, repeat=0, aov=_with_color(options.aov))
    options.check_together()
    options.check_projection(camera.projection)
    settings = make_settings(options, reference_samples, knobs, projection=camera.projection)
    vectors = camera_vectors(camera, *options.size)
    device = open_device(options.device, options.threads)
    method = choose_method(device, scene, vectors, options)
    left_out = dict(settings.left_out)
    chosen = [replace(each, options=_by_method(each.options, method)) for each in settings.chosen]
    reference = _reference(
        device, scene, vectors, _by_method(settings.reference, method), use_cache=use_cache, show=show
    )
    pool = JobPool(device, scene, vectors, {each.name: each.options for each in chosen})
    warm, errors = _warm_up(pool, chosen, reference, left_out, keep, show)
    long = [name for name in kernels_known(chosen) if warm.get(name, 0.0) > 1000 * budget_s / LONG_PART]
    chosen = [each for each in chosen if each.name in warm]
    wrong = _count_wrong(pool, chosen, options, method, show)

    def unclear(times: Mapping[str, Mapping[int, float]]) -> set[str]:
        noise = noise_of(times.values())
        points = [
            Point(each.name, errors[each.name].value(metric), times[each.name], len(each.changes), noise)
            for each in chosen
        ]
        return unclear_names(points)

    times = measure_rounds(pool, {each.name: warm[each.name] for each in chosen}, long, budget_s, unclear, show)
    rows = tuple(
        Row(each, pool.method(each.name), times[each.name], errors[each.name], wrong[each.name]) for each in chosen
    )
    return Accuracy(
        scene.name, scene.triangle_count, options.size, device.name, vectors.projection, metric, budget_s,
        replace(reference, own_rmse=_own_rmse(rows, reference_samples)), rows, left_out,
    )  # fmt: skip


def _with_color(groups: tuple[str, ...]) -> tuple[str, ...]:
    return groups if "color" in groups else ("color", *groups)


def _by_method(options: RenderOptions, method: str) -> RenderOptions:
    """The options with the method of all settings; `fixed` and what lists pixels, which have their own, keep `auto`."""
    has_own = options.precision == "fixed" or antialiasing_of(options).lists_samples
    is_free = options.method == AUTO and not has_own
    return replace(options, method=method) if is_free else options


def _reference(
    device: Device, scene: Scene, vectors: CameraVectors, options: RenderOptions, *, use_cache: bool, show: Show
) -> Reference:
    """Rendered, or as an earlier run left it."""
    plan = plan_effects(scene, options.aov, options.effects, options.mode)
    effects = [effect.name for effect in plan.effects if effect.on]
    key = ""
    if use_cache:
        key = cache.reference_key(scene, resolved_header(options, vectors.named(), effects, vectors.projection))
    width, height = options.size
    if use_cache:
        kept = cache.load_reference(key, (height, width, 3))
        if kept is not None:
            return Reference(options, kept, 0.0, True)
    show(f"the reference: {options.aa} by exact arithmetic")
    started = time.perf_counter()
    pool = JobPool(device, scene, vectors, {"reference": options})
    pool.first_frame("reference")
    color = pool.color("reference")
    if use_cache:
        cache.save_reference(key, color)
    return Reference(options, color, time.perf_counter() - started, False)


def _warm_up(
    pool: JobPool, chosen: list[Setting], reference: Reference, left_out: dict[str, str], keep: Keep | None, show: Show
) -> tuple[dict[str, float], dict[str, Errors]]:
    """A frame of each setting: its milliseconds and its errors. What the device lacks is left out."""
    warm: dict[str, float] = {}
    errors: dict[str, Errors] = {}
    with_flip = has_flip()
    for setting in chosen:
        show(f"{setting.name}: building and a warm-up frame")
        try:
            warm[setting.name] = pool.first_frame(setting.name)
        except (UsageError, DeviceError) as fault:
            if setting.name == DEFAULT:
                raise
            left_out[setting.name] = str(fault)
            continue
        color = pool.color(setting.name)
        errors[setting.name] = measure_errors(color, reference.color, with_flip)
        if keep is not None:
            keep(setting.name, color, reference.color)
    return warm, errors


def kernels_known(chosen: list[Setting]) -> list[str]:
    """Settings whose kernels an earlier one has: nothing is compiled in their first frame."""
    known: list[RenderOptions] = []
    names = []
    for setting in chosen:
        kernels = replace(setting.options, aa=_kernels_of(setting.options))
        if kernels in known:
            names.append(setting.name)
        known.append(kernels)
    return names


def _kernels_of(options: RenderOptions) -> str:
    """A mode with the same kernels.

    What has a threshold has its own: PoCL compiles kernels once more for the lengths of lists, which that decides.
    """
    wanted = antialiasing_of(options)
    if wanted.threshold or wanted.kind == "none":
        return options.aa
    count = VISIT_SAMPLES if wanted.lists_samples else 2
    return f"csaa:{count}+1" if wanted.kind == "csaa" else f"{wanted.kind}:{count}"


VISIBILITY = ("precision", "evaluation", "method", "grid_resolution")
"""Options that decide which triangle a sample shows."""


def _count_wrong(
    pool: JobPool, chosen: list[Setting], base: RenderOptions, method: str, show: Show
) -> dict[str, int]:
    """Pixels whose centres show another triangle than exact arithmetic does; no other option than VISIBILITY acts.

    base : the default setting, whose programs do for most; method : that of the exact image.
    """
    base = replace(base, aov=("color", "id"), aa="none", filter="box", shading_rate="pixel", half=False, samples=1)
    found: dict[tuple[object, ...], np.ndarray] = {}

    def prims(options: RenderOptions) -> np.ndarray:
        own = {name: getattr(options, name) for name in VISIBILITY}
        key = tuple(own.values())
        if key not in found:
            show(f"{options.precision}: counting wrong samples")
            pool.add("ids", replace(base, **own))
            pool.first_frame("ids")
            found[key] = pool.prims("ids")
            pool.drop("ids")
        return found[key]

    exact = prims(replace(base, precision="exact", evaluation="direct", method=method))
    return {each.name: int(np.count_nonzero(prims(each.options) != exact)) for each in chosen}


def _own_rmse(rows: tuple[Row, ...], reference_samples: int) -> float | None:
    """The reference's own error, from that of the finest supersampled setting."""
    found = [
        (sample_count(row.setting.options), row.errors.rmse, row.setting.options.mode)
        for row in rows
        if row.setting.options.aa.startswith("ssaa")
    ]
    if not found:
        return None
    samples, rmse, mode = max(found)
    return rmse * (samples / reference_samples) ** (CONVERGENCE_OF_PATHS if mode == PATH else CONVERGENCE)


__all__ = ["METRICS", "Accuracy", "Reference", "Row", "study_accuracy"]
