"""The streaming cost model on one scene: what rays through a grid do, and the passes, bytes and time that it takes.

Purcell et al., 'Ray Tracing on Programmable Graphics Hardware', sections 3.2, 4 and 5: Tables 1 to 3, Fig. 6 to 9.
The work is counted from a trace of the rays (ray_traces.py), passes under each oracle follow from it, words from the
kernels' arguments (traffic.py), hit rates from a simulated cache (cache_simulation.py). Times are measured at several
resolutions of the grid, and the cost equation (cost_equation.py) is fitted to them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from clrast.errors import CapacityError
from clrast.job import RenderJob
from clrast.opencl import buffers
from clrast.opencl.device import Device, open_device
from clrast.opencl.layout import NO_HIT
from clrast.options import RenderOptions, check_single_view
from clrast.scene.camera import CameraVectors, camera_vectors
from clrast.scene.model import Camera, Scene
from clrast.shading.effects import EffectPlan, plan_effects
from clrast.study import cache_simulation as cache
from clrast.study.cost_equation import Constants, Point, fit, held_out
from clrast.study.cost_modes import ModeRow, lit, measure_modes
from clrast.study.ray_traces import Trace, count_passes, make_trace
from clrast.study.traffic import Traffic, branching_traffic, multipass_traffic, stencil_bytes
from clrast.visibility.grid_passes import PassCounts
from clrast.visibility.grid_rays import GridRaycaster
from clrast.visibility.oracles import OracleChoice

Show = Callable[[str], None]

BRANCHING, MULTIPASS = "raycast-grid", "raycast-grid-multipass"

PAPER_ORACLE = OracleChoice("purcell", 20)
ORACLES = (OracleChoice("naive", 20), OracleChoice("delany", 20), PAPER_ORACLE, OracleChoice("purcell", 40))
UNROLLED = ((1, 1), (2, 1), (2, 2), (4, 2), (4, 4), (8, 8))
"""(Traversal steps, intersection tests) of a pass; section 4.2 unrolls to (4, 2)."""

RESOLUTIONS = (0.4, 0.63, 1.0, 1.6, 2.5)
"""Cells along a side, relative to the automatic choice, at which times are measured."""

CACHE_WORDS = 1_500_000
"""Words of a trace, at most, that go through the simulated cache: whole rows of the image's middle."""

TILE_SIDE = 8
DEFAULT_SIZE = (256, 256)
DEFAULT_REPETITIONS = 5


@dataclass(frozen=True)
class PassRow:
    """Passes of the whole image under one oracle (Table 2)."""

    oracle: str
    steps: int
    tests: int
    passes: PassCounts
    words: float


@dataclass(frozen=True)
class CacheRow:
    """Hit rates of one order of work. bytes_left : misses times the line, and what is written, of all bytes without."""

    name: str
    rates: Mapping[str, cache.HitRate]
    bytes_left: float


@dataclass(frozen=True)
class CostStudy:
    """What `study_cost` found. Times in milliseconds, traffic in words of 32 bits."""

    scene: str
    triangle_count: int
    size: tuple[int, int]
    device: str
    precision: str
    grid: tuple[int, int, int]
    references: int
    loose: int
    rays: int
    rays_entering: int
    hits: int
    steps: float
    tests: float
    max_steps: int
    max_tests: int
    least_passes: int
    rows: tuple[PassRow, ...]
    unrolled: tuple[PassRow, ...]
    branching: Traffic
    multipass: Traffic
    stencil: int
    caches: tuple[CacheRow, ...]
    cache_rays: int
    points: tuple[Point, ...]
    constants: Constants
    predicted: tuple[float, ...]
    pass_points: tuple[Point, ...]
    pass_constants: Constants
    pass_predicted: tuple[float, ...]
    shade_ns: float
    modes: tuple[ModeRow, ...] = ()
    notes: tuple[str, ...] = field(default_factory=tuple)

    @property
    def tests_a_second(self) -> float:
        """Intersections of the branching kernel at the automatic resolution (section 5.2)."""
        own = self.points[RESOLUTIONS.index(1.0)] if len(self.points) == len(RESOLUTIONS) else self.points[0]
        return 1000 * own.rays * own.tests / own.ms

    def as_dict(self) -> dict[str, Any]:
        """Plain data, as --json prints it."""
        found = {name: value for name, value in vars(self).items() if name not in ("branching", "multipass", "caches")}
        rows = {name: [self._row(row) for row in getattr(self, name)] for name in ("rows", "unrolled")}
        models = {name: self._traffic(getattr(self, name)) for name in ("branching", "multipass")}
        plain = {name: [asdict(p) for p in getattr(self, name)] for name in ("points", "pass_points")}
        constants = {name: asdict(getattr(self, name)) for name in ("constants", "pass_constants")}
        caches = [
            {"order": row.name, "bytes_left": row.bytes_left,
             "kinds": {kind: {**asdict(rate), "rate": rate.rate} for kind, rate in row.rates.items()}}
            for row in self.caches
        ]  # fmt: skip
        more = {"caches": caches, "modes": [asdict(row) for row in self.modes], "tests_a_second": self.tests_a_second}
        return {**found, **rows, **models, **plain, **constants, **more}

    @staticmethod
    def _row(row: PassRow) -> dict[str, Any]:
        counts = asdict(row.passes) | {"total": row.passes.total, "simd_efficiency": row.passes.simd_efficiency}
        return {"oracle": row.oracle, "steps": row.steps, "tests": row.tests, **counts, "words": row.words}

    @staticmethod
    def _traffic(traffic: Traffic) -> dict[str, Any]:
        return {
            "words": traffic.total, "by_kernel": traffic.by_kernel(), "by_kind": traffic.by_kind(),
            "a_ray": {kernel: traffic.a_ray(kernel) for kernel in traffic.instances},
        }  # fmt: skip


@dataclass(frozen=True)
class _Ground:
    """What every frame of the study shares."""

    device: Device
    scene: Scene
    vectors: CameraVectors
    plan: EffectPlan
    options: RenderOptions

    def job(self, method: str, resolution: int | None, oracle: Sequence[str] = (), counters: bool = False) -> RenderJob:
        options = replace(
            self.options, method=method, grid_resolution=resolution, oracle=tuple(oracle), counters=counters
        )
        return RenderJob(self.device, self.scene, self.vectors, options, self.plan)


def study_cost(
    scene: Scene,
    camera: Camera,
    options: RenderOptions,
    *,
    repetitions: int = DEFAULT_REPETITIONS,
    show: Show = lambda text: None,
) -> CostStudy:
    """Count and measure a view of a scene. Raises what a render by `raycast-grid` raises."""
    check_single_view(camera.projection, "cost")
    options = replace(options, aov=("color", "id"), counters=False, repeat=0, oracle=(), intersection="edge",
                      accelerator="auto", mode="cast", memory=None)  # fmt: skip
    vectors = camera_vectors(camera, *options.size)
    ground = _Ground(open_device(options.device, options.threads), scene, vectors, plan_effects(
        scene, options.aov, options.effects), options)  # fmt: skip
    show("tracing rays")
    job = ground.job(BRANCHING, options.grid_resolution)
    channels = job.allocate()
    for first in (True, False, False):
        job.render_frame(channels, first=first)
    if job.band_count != 1:
        raise CapacityError("the image takes more than one band of memory: give a smaller --size")
    raycaster = job.tiles
    assert isinstance(raycaster, GridRaycaster)
    trace = make_trace(*raycaster.trace())
    prims, grid = channels["id.prim"], raycaster.grid
    hits, steps, tests = int(np.count_nonzero(prims != NO_HIT)), trace.steps, trace.tests
    rows, unrolled = _passes(trace, hits, show)
    paper = next(row for row in rows if row.oracle == "purcell:20")
    show("simulating the cache")
    caches, cache_rays = _caches(ground, raycaster, trace, hits)
    points, pass_points = _measure(ground, _resolutions(grid.shape.counts), repetitions, show)
    constants, pass_constants = fit(points), fit(pass_points)
    loose = raycaster.loose_count()
    modes = measure_modes(scene, camera, replace(options, method=BRANCHING), show)
    notes = [f"{loose} triangles are seen edge-on and rasterized by their bounds: no count of words or passes has them"]
    if lit(scene)[1]:
        notes.append("the scene has no light: its modes were timed with a sun of ours")
    return CostStudy(
        scene.name, scene.triangle_count, options.size, ground.device.name, options.precision, grid.shape.counts,
        grid.reference_count, raycaster.loose_count(), trace.ray_count, int((steps > 0).sum()), hits,
        float(steps.mean()), float(tests.mean()), int(steps.max()), int(tests.max()), int((steps + tests).max()),
        rows, unrolled, branching_traffic(trace, hits), multipass_traffic(trace, paper.passes, hits),
        stencil_bytes(trace, paper.passes), caches, cache_rays, points, constants, tuple(held_out(points)), pass_points,
        pass_constants, tuple(held_out(pass_points)), 1e6 * job.times["shade"] / max(1, hits), tuple(modes),
        tuple(notes),
    )  # fmt: skip


def _name(choice: OracleChoice) -> str:
    return f"{choice.setting}:{choice.number}" if choice.setting == "purcell" else choice.setting


def _passes(trace: Trace, hits: int, show: Show) -> tuple[tuple[PassRow, ...], tuple[PassRow, ...]]:
    """Each oracle without unrolling, and the paper's with it."""

    def row(choice: OracleChoice, steps: int, tests: int) -> PassRow:
        show(f"passes by {_name(choice)}, {steps} steps and {tests} tests")
        passes = count_passes(trace, choice, steps, tests)
        return PassRow(_name(choice), steps, tests, passes, multipass_traffic(trace, passes, hits).total)

    return tuple(row(choice, 1, 1) for choice in ORACLES), tuple(row(PAPER_ORACLE, *pair) for pair in UNROLLED)


def _caches(
    ground: _Ground, raycaster: GridRaycaster, trace: Trace, hits: int
) -> tuple[tuple[CacheRow, ...], int]:
    """Both architectures, and tiles rendered to their end one by one."""
    width, height = ground.options.size
    share = min(1.0, CACHE_WORDS / max(1, len(trace.places)))
    row_count = max(TILE_SIDE, int(share * height) // TILE_SIDE * TILE_SIDE) if share < 1 else height
    first = (height - min(row_count, height)) // 2
    part = trace.chosen(np.arange(first * width, (first + min(row_count, height)) * width))
    begin = buffers.download(ground.device, raycaster.grid.cell_begin, np.uint32, raycaster.grid.shape.cell_count + 1)
    memory = cache.Memory(begin, ground.scene.triangle_count, part.ray_count)
    part = replace(part, pixels=part.pixels - first * width)
    tiles = cache.tiles_of(part, width, TILE_SIDE)
    in_tiles = part.chosen(np.concatenate(tiles))
    orders = {
        "branching": lambda: cache.branching_accesses(memory, part),
        f"branching, {TILE_SIDE}x{TILE_SIDE} tiles": lambda: cache.branching_accesses(memory, in_tiles),
        "multipass": lambda: cache.multipass_accesses(memory, part, PAPER_ORACLE, 1, 1),
        f"multipass, {TILE_SIDE}x{TILE_SIDE} tiles": lambda: cache.multipass_accesses(
            memory, part, PAPER_ORACLE, 1, 1, tiles
        ),
        "multipass, 32x32 tiles": lambda: cache.multipass_accesses(
            memory, part, PAPER_ORACLE, 1, 1, cache.tiles_of(part, width, 32)
        ),
    }
    passes = count_passes(part, PAPER_ORACLE)
    rows = []
    for name, make in orders.items():
        rates = cache.hit_rates(make())
        traffic = branching_traffic(part, 0) if name.startswith("branching") else multipass_traffic(part, passes, 0)
        missed = sum(rate.misses for rate in rates.values()) * cache.LINE_BYTES
        written = 4 * sum(traffic.written.values())
        rows.append(CacheRow(name, rates, (missed + written) / (4 * traffic.total)))
    return tuple(rows), part.ray_count


def _resolutions(counts: tuple[int, int, int]) -> tuple[int, ...]:
    """Least sides that are measured, about the automatic one."""
    least = min((count for count in counts if count > 1), default=1)
    return tuple(dict.fromkeys(min(1023, max(1, round(factor * least))) for factor in RESOLUTIONS))


def _measure(
    ground: _Ground, resolutions: Sequence[int], repetitions: int, show: Show
) -> tuple[tuple[Point, ...], tuple[Point, ...]]:
    """Times of both methods, jobs in turns, the smallest of each; what they did is counted apart."""
    middle = resolutions[len(resolutions) // 2]
    wanted: list[tuple[str, str, int, tuple[str, ...]]] = [
        (f"grid {each}", BRANCHING, each, ()) for each in resolutions
    ]
    wanted += [(f"grid {each}, purcell:20, unroll {k}", MULTIPASS, each, ("pass=purcell:20", f"unroll={k}"))
               for each in resolutions for k in (1, 4)]  # fmt: skip
    wanted += [(f"grid {middle}, {pick}, unroll {k}", MULTIPASS, middle, (f"pass={pick}", f"unroll={k}"))
               for pick, k in (("delany", 1), ("delany", 2), ("naive", 4), ("purcell:40", 2))]  # fmt: skip
    jobs: list[tuple[str, int, RenderJob]] = []
    counted: dict[int, tuple[float, float]] = {}
    for name, method, resolution, oracle in wanted:
        show(f"{name}: building")
        try:
            job = ground.job(method, resolution, oracle)
            if resolution not in counted:
                counted[resolution] = _counts(ground.job(BRANCHING, resolution, counters=True))
        except CapacityError:
            continue
        job.time_frame()
        jobs.append((name, resolution, job))
    times = [float("inf")] * len(jobs)
    for _ in range(repetitions):
        for k, (name, _, job) in enumerate(jobs):
            show(f"{name}: measuring")
            times[k] = min(times[k], job.time_frame().visibility)
    points: dict[str, list[Point]] = {BRANCHING: [], MULTIPASS: []}
    for (name, resolution, job), ms in zip(jobs, times, strict=True):
        rays = ground.options.size[0] * ground.options.size[1]
        passes = job.tiles.passes.total if job.method.passes else 0  # type: ignore[union-attr]
        points[job.method.name].append(Point(name, rays, *counted[resolution], passes, ms))
    return tuple(points[BRANCHING]), tuple(points[MULTIPASS])


def _counts(job: RenderJob) -> tuple[float, float]:
    """Steps and tests a ray of a frame."""
    job.render_frame(job.allocate(), first=True)
    counts = job.stats()["counts"]
    rays = max(1, counts["rays_primary"])
    return counts["traversal_steps"] / rays, counts["intersection_tests"] / rays
