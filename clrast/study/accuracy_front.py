"""Which settings are worth their time: the Pareto front of measured times, whose noise is part of the measurement.

Times of two settings are compared by the ratios of the rounds that have both, so that a machine that drifts drifts for
both; an interval round their median says how sure that is. A setting dominates another

    if its error is smaller (by more than ERROR_MARGIN) and it is not clearly slower, or
    if it is clearly faster (by more than TIME_MARGIN) and its error is not larger.

What is level with another in both is one point twice: the one that changes less stands for both. So a setting is on
the front only if it beats all others by more than the noise, and the front stays when it is measured again.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

TIME_MARGIN = 0.05
"""Times whose ratio is nearer to 1 than this are level."""
ERROR_MARGIN = 0.02
"""Likewise of errors, which are not noisy, but whose last digits nobody sees."""
FEW = 6
"""From so many pairs on the interval is one of 95 per cent; below, the extremes, widened."""
ALONE = 0.12
"""The interval of a single pair reaches as far, and that of N pairs of few an N-th of it beyond their extremes."""


@dataclass(frozen=True)
class Point:
    """A setting as the front sees it. times_ms : by round. change_count : options that it changes."""

    name: str
    error: float
    times_ms: Mapping[int, float]
    change_count: int = 0

    @property
    def median_ms(self) -> float:
        return float(np.median(list(self.times_ms.values())))


def median_interval(values: Sequence[float]) -> tuple[float, float]:
    """Bounds of the median of positive values: of 95 per cent by order statistics, wider where there are few."""
    ordered, count = sorted(values), len(values)
    if count < FEW:
        widening = 1 + ALONE / count
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
    if not common:
        ratio = a.median_ms / b.median_ms
        return ratio / (1 + ALONE), ratio * (1 + ALONE)
    return median_interval([a.times_ms[k] / b.times_ms[k] for k in common])


def is_faster(a: Point, b: Point) -> bool:
    """Whether a is clearly faster than b."""
    return time_ratio(a, b)[1] < 1 - TIME_MARGIN


def is_unclear(a: Point, b: Point) -> bool:
    """Whether more rounds could change how a's time compares with b's."""
    low, high = time_ratio(a, b)
    return low < 1 - TIME_MARGIN < high or low < 1 / (1 - TIME_MARGIN) < high


def is_better(a: Point, b: Point) -> bool:
    """Whether a's error is smaller than b's by more than the margin."""
    return a.error < b.error * (1 - ERROR_MARGIN)


def dominates(a: Point, b: Point) -> bool:
    """Whether nobody would take b who can have a."""
    if is_better(a, b):
        return not is_faster(b, a)
    return is_faster(a, b) and not is_better(b, a)


def is_level(a: Point, b: Point) -> bool:
    """Whether neither is faster and neither better."""
    return not (is_better(a, b) or is_better(b, a) or is_faster(a, b) or is_faster(b, a))


def pareto_front(points: Sequence[Point]) -> tuple[Point, ...]:
    """The points worth their time, fastest first; of level ones that with the fewest changes, then the earliest."""
    left = [p for p in points if math.isfinite(p.error) and not any(dominates(q, p) for q in points if q is not p)]
    front: list[Point] = []
    for point in sorted(left, key=lambda p: p.change_count):
        if not any(is_level(point, kept) for kept in front):
            front.append(point)
    return tuple(sorted(front, key=lambda p: p.median_ms))


def unclear_names(points: Sequence[Point]) -> set[str]:
    """Settings whose times more rounds should tell apart: one of each pair is on the front, neither is out of reach."""
    front = pareto_front(points)
    unclear: set[str] = set()
    for point in points:
        out = any(q is not point and is_better(q, point) and is_faster(q, point) for q in front)
        if out:
            continue
        for other in front:
            if other is not point and is_unclear(point, other) and not _is_settled(point, other):
                unclear |= {point.name, other.name}
    return unclear


def _is_settled(point: Point, other: Point) -> bool:
    """Whether the unclear part of the ratio decides nothing: only who is slower matters to who is more accurate."""
    low, high = time_ratio(point, other)
    if is_better(point, other):
        return not low < 1 / (1 - TIME_MARGIN) < high
    if is_better(other, point):
        return not low < 1 - TIME_MARGIN < high
    return False
