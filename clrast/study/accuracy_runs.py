"""Frames for the study of accuracy: a job of each setting, kept or made anew, and rounds in which all take turns.

A frame's time is that of setup, bin, visibility, shade, resolve and reading the channels back: all that is done again
for each frame, and nothing of loading, building, planning and writing.
"""

from __future__ import annotations

import gc
import random
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Protocol

import numpy as np

from clrast.job import RenderJob
from clrast.opencl.device import Device
from clrast.options import RenderOptions
from clrast.renderer import start_job
from clrast.scene.camera import CameraVectors
from clrast.scene.model import Scene
from clrast.shading.effects import plan_effects
from clrast.visibility.cost_model import DEFAULT as USUAL_METHOD
from clrast.visibility.methods import AUTO

FEWEST_ROUNDS, MOST_ROUNDS = 7, 40
SHARE_OF_UNCLEAR = 4
"""A setting whose place is not clear may take so many times its share of the budget."""
LONG_PART = 30
"""A warm-up frame that took such a part of the budget counts as a measured one, where nothing was compiled in it."""
METHOD_TRIALS = 3
POOL_SHARE = 0.25
"""Part of the device's memory that jobs may keep between their turns."""

Show = Callable[[str], None]


class Runner(Protocol):
    """Renders frames by name: what `measure_rounds` asks of the renderer."""

    def frame(self, name: str) -> float:
        """Render a frame; returns milliseconds."""


class JobPool:
    """A job for each setting; those that were not used for longest go where the memory does not hold all."""

    def __init__(
        self, device: Device, scene: Scene, vectors: CameraVectors, options: Mapping[str, RenderOptions]
    ) -> None:
        self._inputs = (device, scene, vectors)
        self._options = dict(options)
        self._jobs: dict[str, tuple[RenderJob, dict[str, np.ndarray]]] = {}
        self._budget = int(POOL_SHARE * device.global_memory_bytes)

    def add(self, name: str, options: RenderOptions) -> None:
        self._options[name] = options

    def method(self, name: str) -> str:
        """The method that a setting runs by."""
        return self._job(name)[0].method.name

    def frame(self, name: str) -> float:
        is_new = name not in self._jobs
        job, channels = self._job(name)
        if is_new:
            job.render_frame(channels, first=True)
        started = time.perf_counter()
        job.render_frame(channels, first=False)
        return 1000 * (time.perf_counter() - started)

    def first_frame(self, name: str) -> float:
        """The same without a warm-up: drivers compile, lists grow."""
        job, channels = self._job(name)
        started = time.perf_counter()
        job.render_frame(channels, first=True)
        return 1000 * (time.perf_counter() - started)

    def color(self, name: str) -> np.ndarray:
        """(H, W, 3) float32, linear, premultiplied: the last frame as its file holds it."""
        _, channels = self._job(name)
        rgb = np.stack([channels[axis] for axis in "RGB"], axis=-1)
        if not self._options[name].half:
            return rgb
        with np.errstate(over="ignore"):  # beyond 65504 a half is infinite
            return rgb.astype(np.float16).astype(np.float32)

    def prims(self, name: str) -> np.ndarray:
        """(H, W) uint32 of the last frame, which must have had the ids."""
        return self._job(name)[1]["id.prim"].copy()

    def drop(self, name: str) -> None:
        self._jobs.pop(name, None)
        gc.collect()  # a job and its resolver hold each other

    def _job(self, name: str) -> tuple[RenderJob, dict[str, np.ndarray]]:
        if name in self._jobs:
            self._jobs[name] = self._jobs.pop(name)
            return self._jobs[name]
        device, scene, vectors = self._inputs
        options = self._options[name]
        plan = plan_effects(scene, options.aov, options.effects, options.mode)
        job = RenderJob(device, scene, vectors, options, plan)
        while self._jobs and job.bytes_device() + sum(j.bytes_device() for j, _ in self._jobs.values()) > self._budget:
            self.drop(next(iter(self._jobs)))
        self._jobs[name] = (job, job.allocate())
        return self._jobs[name]


def choose_method(device: Device, scene: Scene, vectors: CameraVectors, options: RenderOptions) -> str:
    """The method of all settings: the one named, or what `auto` takes for the default.

    One trial of two methods that are nearly as fast is a coin toss, by which all times of a study would differ: only
    what each of METHOD_TRIALS trials takes replaces the usual method.
    """
    if options.method != AUTO:
        return options.method
    plan = plan_effects(scene, options.aov, options.effects, options.mode)
    options = replace(options, precision=_spatial(options.precision))
    for _ in range(METHOD_TRIALS):
        name = start_job(device, scene, vectors, options, plan).method.name
        if name == USUAL_METHOD:
            break
    return name


def _spatial(precision: str) -> str:
    """A rung that every method has."""
    return "midpoint" if precision == "fixed" else precision


def measure_rounds(
    runner: Runner,
    warm_ms: Mapping[str, float],
    long: Iterable[str],
    budget_s: float,
    unclear: Callable[[Mapping[str, Mapping[int, float]]], Iterable[str]],
    show: Show = lambda text: None,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, dict[int, float]]:
    """Milliseconds of frames by name and round, all in turn in an order that is drawn for the round.

    warm_ms : of the frames before, which count for those that are `long`. unclear : names whose places the times so
    far leave open. Cheap settings render FEWEST_ROUNDS frames; those that are unclear go on while their share and the
    budget last. Slow ones stop when their share is used up; each has one frame at least. The clock gives seconds.
    """
    names = list(warm_ms)
    share_ms = 1000 * budget_s / len(names)
    started = clock()
    times: dict[str, dict[int, float]] = {name: {} for name in names}
    for name in long:
        times[name][-1] = warm_ms[name]  # the round before the first: all long ones share it
    open_names: set[str] = set()
    for k in range(MOST_ROUNDS):
        if k >= FEWEST_ROUNDS:
            open_names = set(unclear(times))
        any_left = False
        for name in random.Random(k).sample(names, len(names)):
            done = times[name]
            cost = min(done.values(), default=warm_ms[name])
            part = SHARE_OF_UNCLEAR * share_ms if name in open_names else share_ms
            enough = len(done) >= FEWEST_ROUNDS and name not in open_names
            over = clock() - started > budget_s or cost * (len(done) + 1) > part
            if done and (enough or over):
                continue
            any_left = True
            show(f"round {k + 1}: {name}")
            times[name][k] = runner.frame(name)
        if not any_left and k >= FEWEST_ROUNDS:
            break
    return times
