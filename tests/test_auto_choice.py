"""`--method auto`: whether a second method is tried, and which of the two it takes, by times that these tests give."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
from kernel_world import make_scene, perspective

from clrast import job as job_module
from clrast import renderer
from clrast.opencl.device import Device
from clrast.options import make_options
from clrast.shading.effects import plan_effects
from clrast.visibility.cost_model import CANDIDATE, DEFAULT, StageTimes, ViewCounts, is_worth_a_trial

CORNERS = np.array([[[-1, -1, -3], [1, -1, -3], [0, 1, -3]]], dtype=np.float32)


@dataclass
class GivenTimes:
    """Milliseconds of visibility of each method's frames, in the order in which they are timed; setup takes 1 ms."""

    times: dict[str, list[float]]
    counts: dict[str, int] = field(default_factory=lambda: {DEFAULT: 0, CANDIDATE: 0})

    def next(self, method: str) -> StageTimes:
        self.counts[method] += 1
        return StageTimes(setup=1.0, bin=0.0, visibility=self.times[method][self.counts[method] - 1])


def choose(
    device: Device, monkeypatch: pytest.MonkeyPatch, times: GivenTimes, **options: object
) -> job_module.RenderJob:
    """The job that `auto` takes where frames take the given times, and a trial seems worth it."""
    really = job_module.RenderJob.time_frame

    def time_frame(job: job_module.RenderJob) -> StageTimes:
        really(job)
        return times.next(job.method.name)

    monkeypatch.setattr(job_module.RenderJob, "time_frame", time_frame)
    monkeypatch.setattr(renderer, "is_worth_a_trial", lambda counts, default: True)
    scene = make_scene(CORNERS)
    wanted = make_options({"size": (32, 32), "aov": ("color",), **options})
    plan = plan_effects(scene, wanted.aov, wanted.effects, wanted.mode)
    return renderer.start_job(device, scene, perspective(32, 32), wanted, plan)


@pytest.fixture
def free_device(device: Device) -> Device:
    if renderer.loop_limit(device) is not None:
        pytest.skip(f"{device.runtime} ends long loops: nothing is tried there")
    return device


def test_one_slow_frame_decides_nothing(free_device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """The fastest of three frames of each counts: the default's last is disturbed, and it wins all the same."""
    times = GivenTimes({DEFAULT: [90, 10, 11, 10, 30], CANDIDATE: [50, 12, 13, 12]})
    job = choose(free_device, monkeypatch, times)
    assert (job.method.name, job.reason) == (DEFAULT, f"measured: {DEFAULT} 11.0 ms, {CANDIDATE} 13.0 ms")
    assert times.counts == {DEFAULT: 5, CANDIDATE: 4}


def test_the_faster_method_is_taken(free_device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    times = GivenTimes({DEFAULT: [90, 10, 11, 10, 10], CANDIDATE: [50, 7, 29, 8]})
    job = choose(free_device, monkeypatch, times)
    assert (job.method.name, job.reason) == (CANDIDATE, f"measured: {DEFAULT} 11.0 ms, {CANDIDATE} 8.0 ms")


@pytest.mark.parametrize(("aa", "passes"), [("ssaa:4", 4), ("msaa:2", 2), ("csaa:2+6", 8)])
def test_visibility_counts_for_each_sample(
    free_device: Device, monkeypatch: pytest.MonkeyPatch, aa: str, passes: int
) -> None:
    """One setup serves the passes of all samples."""
    times = GivenTimes({DEFAULT: [10] * 5, CANDIDATE: [8] * 4})
    job = choose(free_device, monkeypatch, times, aa=aa)
    assert job.reason == f"measured: {DEFAULT} {1 + 10 * passes:.1f} ms, {CANDIDATE} {1 + 8 * passes:.1f} ms"


@pytest.mark.parametrize(("aa", "rate"), [("auto:0.1", "pixel"), ("msaa:16", "pixel"), ("csaa:4+4", "auto")])
def test_samples_that_are_listed_have_one_method(
    free_device: Device, monkeypatch: pytest.MonkeyPatch, aa: str, rate: str
) -> None:
    """Only tiles decide many samples of pixels together: no other method is tried, however fast one frame is."""
    times = GivenTimes({DEFAULT: [10] * 5, CANDIDATE: [1] * 4})
    job = choose(free_device, monkeypatch, times, aa=aa, shading_rate=rate)
    assert job.method.name == DEFAULT and "many samples of pixels together" in str(job.reason)
    assert times.counts == {DEFAULT: 0, CANDIDATE: 0}


def test_limits_leave_no_choice(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    times = GivenTimes({DEFAULT: [10] * 5, CANDIDATE: [1] * 4})
    job = choose(device, monkeypatch, times, memory="64M")
    assert job.method.name == DEFAULT and times.counts == {DEFAULT: 0, CANDIDATE: 0}


def test_a_trial_must_promise_a_tenth() -> None:
    """By the model the candidate takes 1.7 of the setup and the share of visibility that seen triangles have."""
    hidden = ViewCounts(seen=100, in_view=100_000, references=300_000, bound_samples=3_000_000, hits=1000)
    times = StageTimes(setup=10.0, bin=10.0, visibility=100.0)
    assert is_worth_a_trial(hidden, times)
    seen = ViewCounts(seen=100_000, in_view=100_000, references=300_000, bound_samples=3_000_000, hits=100_000)
    assert not is_worth_a_trial(seen, times)
    assert not is_worth_a_trial(hidden, StageTimes(setup=0.1, bin=0.1, visibility=0.5))  # less than a millisecond
    assert is_worth_a_trial(hidden, StageTimes(0.1, 0.1, 0.5).with_passes(16))
