"""The cost equation of streaming ray tracing, its constants fitted to measured times.

Purcell et al., 'Ray Tracing on Programmable Graphics Hardware', section 3.2:
    C = R (C_r + v C_v + t C_t + s C_s) + R P C_stencil
R rays, v cells a ray, t triangles a ray, s shadings a ray, P passes. Theirs are instructions, and every ray pays for
every pass; here they are nanoseconds, and what is done pays nothing: a pass costs C_pass, its launches and the host's
question, and C_stencil = C_pass / R is that cost in the paper's terms. C_s is measured apart (the shading stage).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Point:
    """One measured frame. steps, tests : a ray. passes : 0 where the kernel branches. ms : the visibility stage."""

    name: str
    rays: int
    steps: float
    tests: float
    passes: int
    ms: float

    def terms(self) -> tuple[float, float, float, float]:
        """What C_r, C_v, C_t and C_pass are multiplied with."""
        return self.rays, self.rays * self.steps, self.rays * self.tests, self.passes


@dataclass(frozen=True)
class Constants:
    """Nanoseconds; none below 0."""

    ray: float
    step: float
    test: float
    passing: float

    def predict_ms(self, point: Point) -> float:
        parts = (self.ray, self.step, self.test, self.passing)
        return sum(a * b for a, b in zip(parts, point.terms(), strict=True)) / 1e6


def fit(points: Sequence[Point]) -> Constants:
    """The constants of least squares of relative errors, none negative.

    Every subset of the constants is tried: the best solution whose numbers are all positive is the one that is sought.
    """
    table = np.array([point.terms() for point in points]) / 1e6
    times = np.array([point.ms for point in points])
    scaled = table / times[:, None]
    best, least = np.zeros(4), float(len(points))
    columns = [k for k in range(4) if scaled[:, k].any()]
    for size in range(1, len(columns) + 1):
        for chosen in itertools.combinations(columns, size):
            part = scaled[:, chosen]
            if len(points) < size or np.linalg.matrix_rank(part / np.abs(part).max(axis=0)) < size:
                continue
            solution = np.linalg.lstsq(part, np.ones(len(points)), rcond=None)[0]
            error = float(((part @ solution - 1) ** 2).sum())
            if (solution > 0).all() and error < least:
                least = error
                best = np.zeros(4)
                best[list(chosen)] = solution
    return Constants(*best.tolist())


def held_out(points: Sequence[Point]) -> list[float]:
    """For each point its time as the constants of all the others predict it, milliseconds."""
    others = [[other for other in points if other is not point] for point in points]
    return [fit(rest).predict_ms(point) for point, rest in zip(points, others, strict=True)]
