"""Which method is fastest: when it pays to try another than the default, from counts of one frame.

The choice itself is made by measured times (see renderer.py); this model only spares trials that cannot win, with
the BVH and the kernels that they would need. Its constants are nanoseconds of two threads on a processor with
AVX-512, fitted to the scenes of study/suite.py; it uses them as ratios to what the default was measured at.
Davidovic et al., '3D Rasterization', section 5, compares the methods; Fig. 9 is why none is always the best.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from clrast.visibility.methods import SNAPPED_DEFAULT

DEFAULT = "3dr-binning"
CANDIDATE = "3dr-full"
"""What may beat it: where so much is hidden that the tree's setup in every frame pays."""

SETUP_RATIO = 1.7
"""Setup with the bounds of nodes, against setup of the triangles' bounds alone."""

LEAST_GAIN, LEAST_GAIN_MS = 0.1, 1.0
"""Share of the default's time, and milliseconds, that must be in sight: a trial builds a tree and kernels."""

TRIAL_FRAMES = 3
"""Frames of each method in a trial, in turns, whose fastest counts: one of each is a coin toss."""

BINNED_REFERENCE, BINNED_BOUND_SAMPLE = 7.1, 0.11
FULL_SEEN_TRIANGLE, FULL_HIT = 39.0, 2.2


@dataclass(frozen=True)
class ViewCounts:
    """What a frame of the default method showed.

    seen : triangles that are visible somewhere. in_view : triangles whose bound holds a sample. references :
    (tile, triangle) pairs. bound_samples : samples in all bounds together. hits : samples where something is visible.
    """

    seen: int
    in_view: int
    references: int
    bound_samples: int
    hits: int


@dataclass(frozen=True)
class StageTimes:
    """Milliseconds of one frame. visibility : of all passes."""

    setup: float
    bin: float
    visibility: float

    def with_passes(self, count: int) -> StageTimes:
        """Those of a frame with `count` passes over one setup and binning, where this one has one."""
        return replace(self, visibility=count * self.visibility)

    @property
    def total(self) -> float:
        return self.setup + self.bin + self.visibility


def least_time_of_candidate(counts: ViewCounts, default: StageTimes) -> float:
    """Milliseconds that CANDIDATE takes at least, by the model."""
    binned = BINNED_REFERENCE * counts.references + BINNED_BOUND_SAMPLE * counts.bound_samples
    full = FULL_SEEN_TRIANGLE * counts.seen + FULL_HIT * counts.hits
    return SETUP_RATIO * default.setup + default.visibility * full / max(1.0, binned)


def is_worth_a_trial(counts: ViewCounts, default: StageTimes) -> bool:
    """Whether CANDIDATE may be faster than the default by what is worth it."""
    gain = default.total - least_time_of_candidate(counts, default)
    return gain > max(LEAST_GAIN * default.total, LEAST_GAIN_MS)


def reason_without_choice(precision: str, *, lists_samples: bool, is_limited: bool) -> str | None:
    """Why nothing else than the default is tried, if so, whatever the view is.

    precision : a rung's name. lists_samples : whether the default alone decides many samples of pixels together.
    is_limited : the device ends long loops, the image is rendered in bands, or there is a memory budget.
    """
    if precision == "fixed":
        return f"{SNAPPED_DEFAULT}: --precision fixed is for projected vertices"
    if lists_samples:
        return f"{DEFAULT}: it alone decides many samples of pixels together, without a pass for each"
    if is_limited:
        return f"{DEFAULT}: nothing else is tried on this device, in bands or under a memory budget"
    return None


def reason_without_trial(counts: ViewCounts, default: StageTimes) -> str:
    return (
        f"{DEFAULT} took {default.total:.1f} ms; with {counts.seen} of {counts.in_view} triangles in view visible "
        f"{CANDIDATE} cannot win much"
    )


def reason_of_trial(default: StageTimes, candidate: StageTimes) -> str:
    return f"measured: {DEFAULT} {default.total:.1f} ms, {CANDIDATE} {candidate.total:.1f} ms"
