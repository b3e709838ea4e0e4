"""Every method of the continuum on one scene, in one interleaved run: times, counted work, and instructions.

Davidovic et al., '3D Rasterization', section 5, Fig. 9: rendering time and instructions per frame, both relative to
2D rasterization by brute force; instructions are triangle setups and edge evaluations, weighed by Fig. 10
(operation_counts.py). Time is setup + bin + visibility of a frame; what is built once for a scene stands apart.
Every method renders one frame a round, so that a machine that drifts slows all of them alike; the order changes from
round to round, as who follows a method that leaves the caches cold would pay for it every time.
"""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from clrast.errors import DeviceError, UsageError
from clrast.job import RenderJob
from clrast.opencl.device import Device, open_device
from clrast.opencl.features import Edges, Precision, Projection
from clrast.options import AVAILABLE_METHODS, METHODS, RenderOptions, check_single_view
from clrast.scene.camera import PLANAR_PROJECTIONS, CameraVectors, camera_vectors
from clrast.scene.model import Camera, Scene
from clrast.shading.effects import EffectPlan, plan_effects
from clrast.study.auto_choice import AutoChoice, choose_automatically
from clrast.study.operation_counts import Cost, cost_summary, kernel_cost, paper_cost
from clrast.visibility.methods import AUTO, BASELINE

FIGURE_STAGES = ("setup", "bin", "visibility")
"""What the time of a method is made of; frames share the build, and shading is the same for all."""
DEFAULT_REPETITIONS = 7
DEFAULT_BUDGET = 60.0
"""Seconds of measured frames of one scene, after which slow methods have done enough."""
WIDE_SPREAD = 1.5
"""Ratio of the 90th to the 10th percentile from which on a time says little."""

Show = Callable[[str], None]


@dataclass(frozen=True)
class Counts:
    """Work of one frame; None where it was not counted."""

    setups: int | None = None
    edge_evaluations: int | None = None
    others: Mapping[str, int | None] = field(default_factory=dict)


class Run(Protocol):
    """One method, ready to render: what `measure_methods` asks of it."""

    edges: Edges
    build_ms: float

    def frame(self) -> Mapping[str, float]:
        """Render one frame; returns milliseconds by stage, those of FIGURE_STAGES among them."""

    def counts(self) -> Counts:
        """The work of a frame."""

    def prims(self) -> np.ndarray:
        """(height, width) uint32, what the last frame shows."""


class MethodRun:
    """The renderer as `measure_methods` sees it: one job that renders frame after frame."""

    def __init__(
        self, device: Device, scene: Scene, vectors: CameraVectors, options: RenderOptions, plan: EffectPlan
    ) -> None:
        self._inputs = (device, scene, vectors)
        self._options, self._plan = options, plan
        self._job = RenderJob(device, scene, vectors, options, plan)
        self._channels = self._job.allocate()
        self.edges = self._job.method.edges
        self.build_ms = self._job.times["build"]

    def frame(self) -> Mapping[str, float]:
        self._job.render_frame(self._channels, first=True)  # 'first' keeps this frame's times, not the smallest
        return {stage: self._job.times.get(stage, 0.0) for stage in FIGURE_STAGES}

    def counts(self) -> Counts:
        job = RenderJob(*self._inputs, replace(self._options, counters=True), self._plan)
        job.render_frame(job.allocate(), first=True)
        counts = dict(job.stats()["counts"])
        return Counts(counts.pop("setups", None), counts.pop("edge_evaluations", None), counts)

    def prims(self) -> np.ndarray:
        return self._channels["id.prim"]


@dataclass(frozen=True)
class MethodRow:
    """What was measured of one method.

    frames_ms : setup + bin + visibility of each frame, in the order of rounds. stages_ms : median of each stage.
    cut : the budget ended its repetitions early. warm_up_only : it took so long that the warm-up frame stands for all.
    differing_pixels : samples whose prim_id is not that of the first method with 3D edges; None without such a one.
    """

    method: str
    edges: Edges
    frames_ms: tuple[float, ...]
    stages_ms: Mapping[str, float]
    build_ms: float
    counts: Counts
    cost: Cost
    cut: bool = False
    warm_up_only: bool = False
    differing_pixels: int | None = None

    def percentile(self, share: float) -> float:
        """Milliseconds that `share` per cent of the frames stay under, interpolated."""
        return float(np.percentile(self.frames_ms, share))

    @property
    def median_ms(self) -> float:
        return self.percentile(50)

    @property
    def setup_instructions(self) -> int | None:
        return None if self.counts.setups is None else self.counts.setups * self.cost.setup

    @property
    def instructions(self) -> int | None:
        """Setups and edge evaluations, weighed by the paper's costs."""
        if self.setup_instructions is None or self.counts.edge_evaluations is None:
            return None
        return self.setup_instructions + self.counts.edge_evaluations * self.cost.pixel

    @property
    def setup_share(self) -> float | None:
        """Part of the instructions that setups take, 0 to 1."""
        if self.setup_instructions is None or not self.instructions:
            return None
        return self.setup_instructions / self.instructions


@dataclass(frozen=True)
class Comparison:
    """All methods on one scene and view. skipped : method -> why it was not measured."""

    scene: str
    triangle_count: int
    size: tuple[int, int]
    device: str
    precision: str
    projection: str
    repetitions: int
    budget_s: float
    rows: tuple[MethodRow, ...]
    skipped: Mapping[str, str] = field(default_factory=dict)
    auto: AutoChoice | None = None

    def row(self, method: str) -> MethodRow | None:
        return next((row for row in self.rows if row.method == method), None)

    def time_ratio(self, method: str, base: str = BASELINE) -> float | None:
        """Time of a method over that of another; None where one of them was not measured."""
        row, other = self.row(method), self.row(base)
        return row.median_ms / other.median_ms if row and other and other.median_ms > 0 else None

    def instruction_ratio(self, method: str, base: str = BASELINE) -> float | None:
        row, other = self.row(method), self.row(base)
        if row is None or other is None or row.instructions is None or not other.instructions:
            return None
        return row.instructions / other.instructions

    def evaluation_ratio(self, method: str, base: str = BASELINE) -> float | None:
        row, other = self.row(method), self.row(base)
        if row is None or other is None or row.counts.edge_evaluations is None or not other.counts.edge_evaluations:
            return None
        return row.counts.edge_evaluations / other.counts.edge_evaluations

    @property
    def fastest(self) -> MethodRow:
        return min(self.rows, key=lambda row: row.median_ms)

    def is_clear(self, method: str, base: str = BASELINE) -> bool:
        """Whether both were measured and the spreads of their times (10th to 90th percentile) do not overlap."""
        row, other = self.row(method), self.row(base)
        if row is None or other is None:
            return False
        return row.percentile(10) > other.percentile(90) or other.percentile(10) > row.percentile(90)

    @property
    def fastest_exact(self) -> MethodRow | None:
        """The fastest whose edges are 3D: `auto` chooses among these, which give one image."""
        rows = [row for row in self.rows if row.edges == Edges.SPATIAL]
        return min(rows, key=lambda row: row.median_ms, default=None)

    @property
    def auto_ratio(self) -> float | None:
        """Time of what `auto` takes over that of `fastest_exact`."""
        if self.auto is None or self.fastest_exact is None:
            return None
        return self.time_ratio(self.auto.method, self.fastest_exact.method)

    @property
    def as_fast(self) -> tuple[str, ...]:
        """Other methods that the spread does not tell from the fastest."""
        best = self.fastest
        return tuple(r.method for r in self.rows if r is not best and not self.is_clear(r.method, best.method))

    @property
    def is_noisy(self) -> bool:
        """Whether the times of most methods spread by more than WIDE_SPREAD."""
        wide = [row.percentile(90) > WIDE_SPREAD * row.percentile(10) for row in self.rows]
        return sum(wide) > len(wide) / 2

    def as_dict(self) -> dict[str, Any]:
        """Plain data, as --json prints it: milliseconds, counts, ratios to the baseline."""
        kinds = tuple(dict.fromkeys(row.edges for row in self.rows))
        return {
            "scene": self.scene,
            "triangles": self.triangle_count,
            "image": {"width": self.size[0], "height": self.size[1]},
            "device": self.device,
            "precision": self.precision,
            "projection": self.projection,
            "baseline": BASELINE if self.row(BASELINE) else None,
            "repetitions": self.repetitions,
            "budget_s": self.budget_s,
            "fastest": self.fastest.method,
            "as_fast": list(self.as_fast),
            "auto": None if self.auto is None else {**asdict(self.auto), "ratio": self.auto_ratio},
            "methods": [self._row_dict(row) for row in self.rows],
            "skipped": dict(self.skipped),
            "operations": cost_summary(kinds, Precision[self.precision.upper()], Projection[self.projection.upper()]),
        }

    def _row_dict(self, row: MethodRow) -> dict[str, Any]:
        cost = kernel_cost(row.edges, Precision[self.precision.upper()], Projection[self.projection.upper()])
        own = None
        if cost and row.counts.setups is not None and row.counts.edge_evaluations is not None:
            own = row.counts.setups * cost[0].arithmetic + row.counts.edge_evaluations * cost[1].arithmetic
        return {
            "method": row.method,
            "edges": row.edges.name.lower(),
            "ms": row.median_ms,
            "p10_ms": row.percentile(10),
            "p90_ms": row.percentile(90),
            "min_ms": min(row.frames_ms),
            "frames_ms": list(row.frames_ms),
            "stages_ms": dict(row.stages_ms),
            "relative_time": self.time_ratio(row.method),
            "build_ms": row.build_ms,
            "setups": row.counts.setups,
            "edge_evaluations": row.counts.edge_evaluations,
            "instructions": row.instructions,
            "relative_instructions": self.instruction_ratio(row.method),
            "setup_share": row.setup_share,
            "kernel_operations": own,
            "cut": row.cut,
            "warm_up_only": row.warm_up_only,
            "differing_pixels": row.differing_pixels,
            "counts": dict(row.counts.others),
        }


def choose_methods(names: Sequence[str] | None) -> tuple[str, ...]:
    """The methods to compare, in the order of the design; None stands for all that this version has."""
    can = tuple(name for name in AVAILABLE_METHODS if name != AUTO)
    if names is None:
        return can
    if not names:
        raise UsageError("--methods names no method: leave it out for all")
    for name in names:
        if name == AUTO:
            raise UsageError("--methods auto is a choice among the others: name methods, or leave it out for all")
        RenderOptions(method=name)
    return tuple(name for name in METHODS if name in names)


def compare_scene(
    scene: Scene,
    camera: Camera,
    options: RenderOptions,
    methods: Sequence[str] | None = None,
    *,
    repetitions: int = DEFAULT_REPETITIONS,
    budget_s: float = DEFAULT_BUDGET,
    show: Show = lambda text: None,
) -> Comparison:
    """Measure methods on a view of a scene; ids alone are rendered.

    methods : names, None for all. A method that can not render this view is left out with its reason where it
    was not named, and raises where it was. repetitions : rounds. budget_s : seconds.
    """
    if options.precision == "fixed":
        raise UsageError("--precision fixed is for 2dr-brute and 2dr-binning alone: compare methods at another rung")
    options = replace(options, aov=("id",), counters=False, repeat=0, oracle=(), intersection="edge", method=AUTO)
    check_single_view(camera.projection, "compare")
    if camera.projection not in PLANAR_PROJECTIONS:
        raise UsageError(f"2D methods need planar views, and {camera.projection} is none: use perspective")
    vectors = camera_vectors(camera, *options.size)
    plan = plan_effects(scene, options.aov, options.effects)
    device = open_device(options.device, options.threads)

    def prepare(name: str) -> Run:
        return MethodRun(device, scene, vectors, replace(options, method=name), plan)

    rows, skipped = measure_methods(
        choose_methods(methods), prepare, repetitions=repetitions, budget_s=budget_s, strict=methods is not None,
        show=show,
    )  # fmt: skip
    return Comparison(
        scene.name, scene.triangle_count, options.size, device.name, options.precision, vectors.projection,
        repetitions, budget_s, rows, skipped, choose_automatically(device, scene, vectors, options, plan),
    )  # fmt: skip


def measure_methods(
    names: Sequence[str],
    prepare: Callable[[str], Run],
    *,
    repetitions: int,
    budget_s: float,
    strict: bool = False,
    show: Show = lambda text: None,
    clock: Callable[[], float] = time.perf_counter,
) -> tuple[tuple[MethodRow, ...], dict[str, str]]:
    """Rows in the order of `names`, and reasons of those that could not be prepared (raised where `strict`).

    clock : seconds. Once the rounds have taken `budget_s`, methods whose frames would take more than their share of
    it stop with what they have; a method whose warm-up frame alone took so long keeps that one.
    """
    runs: dict[str, _Timed] = {}
    skipped: dict[str, str] = {}
    for name in names:
        show(f"{name}: building and a warm-up frame")
        try:
            run = prepare(name)
        except (UsageError, DeviceError) as fault:
            if strict:
                raise
            skipped[name] = str(fault)
            continue
        runs[name] = _Timed(run)
        started = clock()
        runs[name].warm_up()
        runs[name].is_done = clock() - started > budget_s
    if not runs:
        raise UsageError(f"no method can render this: {next(iter(skipped.values()))}")
    _run_rounds(runs, repetitions, budget_s, show, clock)
    counts = {}
    for name, timed in runs.items():
        show(f"{name}: counting")
        counts[name] = timed.run.counts()
    reference = next((timed.run.prims() for timed in runs.values() if timed.run.edges == Edges.SPATIAL), None)
    return tuple(timed.row(name, counts[name], repetitions, reference) for name, timed in runs.items()), skipped


class _Timed:
    """A run and its frames' times."""

    def __init__(self, run: Run) -> None:
        self.run = run
        self.frames: list[Mapping[str, float]] = []
        self.warm: Mapping[str, float] = {}
        self.is_done = False

    def warm_up(self) -> None:
        self.warm = dict(self.run.frame())

    def frame_s(self) -> float:
        """Seconds of the last frame's stages."""
        return sum((self.frames or [self.warm])[-1].values()) / 1000

    def row(self, name: str, counts: Counts, repetitions: int, reference: np.ndarray | None) -> MethodRow:
        frames = self.frames or [self.warm]
        stages = {stage: float(np.median([frame[stage] for frame in frames])) for stage in FIGURE_STAGES}
        figures = tuple(float(sum(frame[stage] for stage in FIGURE_STAGES)) for frame in frames)
        differing = None if reference is None else int(np.count_nonzero(self.run.prims() != reference))
        return MethodRow(
            name, self.run.edges, figures, stages, self.run.build_ms, counts, paper_cost(self.run.edges),
            cut=len(self.frames) < repetitions, warm_up_only=not self.frames, differing_pixels=differing,
        )  # fmt: skip


def _run_rounds(
    runs: Mapping[str, _Timed], repetitions: int, budget_s: float, show: Show, clock: Callable[[], float]
) -> None:
    """Every method once a round, in an order that is drawn for the round."""
    started = clock()
    share = budget_s / len(runs)
    for k in range(repetitions):
        for name, timed in random.Random(k).sample(list(runs.items()), len(runs)):
            is_slow = timed.frame_s() * repetitions > share
            if timed.is_done or (k > 0 and is_slow and clock() - started > budget_s):
                timed.is_done = True
                continue
            show(f"round {k + 1} of {repetitions}: {name}")
            timed.frames.append(dict(timed.run.frame()))
