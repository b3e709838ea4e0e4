"""Which settings are worth their time: the Pareto front of measured times, whose noise is part of the measurement.

Times of two settings are compared by the ratios of the rounds that have both, so that a machine that drifts drifts for
both; an interval round their median says how sure that is. The front is walked from the most accurate setting on:

    settings whose errors are level (within ERROR_MARGIN) are one group
    of a group those are left that are clearly faster (by more than TIME_MARGIN) than all that stand on the front
    of these the fastest joins it; of such as are level in time that which changes the fewest options

So a setting is on the front only if it beats all that are more accurate by more than the noise, and the front stays
when it is measured again. A setting that noise hides drops out alone: it takes no clearly faster one with it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

TIME_MARGIN = 0.05
"""Times whose ratio is nearer to 1 than this are level."""
ERROR_MARGIN = 0.02
"""Likewise of errors, which are not noisy, but whose last digits nobody sees."""
FEW = 6
"""From so many pairs on the interval is one of 95 per cent; below, it is the extremes, widened by the noise."""
LEAST_NOISE = 0.12
"""The interval of a single pair reaches at least as far to both sides; see `noise_of`."""


@dataclass(frozen=True)
class Point:
    """A setting as the front sees it. times_ms : by round. change_count : options that it changes.

    noise : how far a single ratio of times may be off in this run, as `noise_of` finds it.
    """

    name: str
    error: float
    times_ms: Mapping[int, float]
    change_count: int = 0
    noise: float = LEAST_NOISE

    @property
    def median_ms(self) -> float:
        return float(np.median(list(self.times_ms.values())))


def noise_of(times_ms: Iterable[Mapping[int, float]]) -> float:
    """How far a single ratio of two times may be off: twice the standard deviation of its logarithm.

    times_ms : of each setting, by round. It comes from the settings that have many frames, each time over the
    setting's median and without what all of a round share; LEAST_NOISE where none has.
    """
    many = [found for found in times_ms if len(found) >= FEW - 1]
    residuals: dict[int, list[float]] = {}
    for found in many:
        middle = float(np.median(list(found.values())))
        for k, spent in found.items():
            residuals.setdefault(k, []).append(math.log(spent / middle))
    free = [value - float(np.median(all_of)) for all_of in residuals.values() for value in all_of if len(all_of) > 2]
    return max(LEAST_NOISE, 2 * math.sqrt(2) * float(np.std(free)) if free else 0.0)


def median_interval(values: Sequence[float], noise: float = LEAST_NOISE) -> tuple[float, float]:
    """Bounds of the median of positive values: of 95 per cent by order statistics, wider where there are few.

    The interval of a single value reaches as far as the noise, that of N of few an N-th of it beyond their extremes.
    """
    ordered, count = sorted(values), len(values)
    if count < FEW:
        widening = 1 + noise / count
        return ordered[0] / widening, ordered[-1] * widening
    # The median lies outside the k-th from both ends with the chance 2 P(fewer than k heads of `count` coins).
    k, tail = 0, 2.0**-count
    while 2 * tail <= 0.05:
        k += 1
        tail += math.comb(count, k) * 2.0**-count
    return ordered[max(k, 1) - 1], ordered[count - max(k, 1)]


def time_ratio(a: Point, b: Point) -> tuple[float, float]:
    """Bounds of a's time over b's."""
    common = [k for k in a.times_ms if k in b.times_ms]
    ratios = [a.times_ms[k] / b.times_ms[k] for k in common] or [a.median_ms / b.median_ms]
    return median_interval(ratios, max(a.noise, b.noise))


def is_faster(a: Point, b: Point) -> bool:
    """Whether a is clearly faster than b."""
    return time_ratio(a, b)[1] < 1 - TIME_MARGIN


def is_better(a: Point, b: Point) -> bool:
    """Whether a's error is smaller than b's by more than the margin."""
    return a.error < b.error * (1 - ERROR_MARGIN)


def is_level(a: Point, b: Point) -> bool:
    """Whether neither is faster and neither better."""
    return not (is_better(a, b) or is_better(b, a) or is_faster(a, b) or is_faster(b, a))


def pareto_front(points: Sequence[Point]) -> tuple[Point, ...]:
    """The points worth their time, fastest first; of level ones that with the fewest changes, then the earliest."""
    left = sorted((p for p in points if math.isfinite(p.error)), key=lambda p: p.error)
    front: list[Point] = []
    while left:
        group = [p for p in left if not is_better(left[0], p)]
        left = [p for p in left if is_better(group[0], p)]
        # In the order in which they were given.
        group = [p for p in points if any(p is each for each in group)]
        faster = [p for p in group if all(is_faster(p, kept) for kept in front)]
        fastest = [p for p in faster if not any(is_faster(q, p) for q in faster)] or faster
        if fastest:
            front.append(min(fastest, key=lambda p: p.change_count))
    return tuple(reversed(front))


def unclear_names(points: Sequence[Point]) -> set[str]:
    """Settings whose times more rounds should tell apart: one of each pair is on the front, neither is out of reach."""
    front = pareto_front(points)
    unclear: set[str] = set()
    for point in points:
        if any(is_better(kept, point) and is_faster(kept, point) for kept in front):
            continue
        for kept in front:
            if kept is not point and not is_better(point, kept) and _is_open(point, kept):
                unclear |= {point.name, kept.name}
    return unclear


def _is_open(point: Point, kept: Point) -> bool:
    """Whether more rounds could change who of the two is on the front. kept : is no worse."""
    low, high = time_ratio(point, kept)
    is_open = low < 1 - TIME_MARGIN < high
    return is_open or (not is_better(kept, point) and low < 1 / (1 - TIME_MARGIN) < high)
