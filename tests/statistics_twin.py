"""Thresholds of statistical tests, from closed forms: each names the chance with which a right program fails it."""

from __future__ import annotations

import math

import numpy as np

Z_OF_1E_6 = 4.7534
"""A normal number exceeds it with a chance of 1e-6; numbers are fixed by seeds, so a pass stays a pass."""


def chi_square_limit(freedom: int, z: float = Z_OF_1E_6) -> float:
    """What a chi-square of so many degrees of freedom exceeds with the chance of z (Wilson and Hilferty 1931)."""
    share = 2 / (9 * freedom)
    return freedom * (1 - share + z * math.sqrt(share)) ** 3


def chi_square(found: np.ndarray, expected: np.ndarray) -> float:
    """Pearson's sum over cells; `expected` counts of 5 and more, to which the limit applies."""
    assert (expected >= 5).all() and abs(float(found.sum() / expected.sum()) - 1) < 1e-6
    return float(((found - expected) ** 2 / expected).sum())


def assert_uniform(cells: np.ndarray, cell_count: int) -> None:
    """Cell numbers fall into all cells alike."""
    found = np.bincount(cells.ravel(), minlength=cell_count)
    assert len(found) == cell_count
    statistic = chi_square(found, np.full(cell_count, found.sum() / cell_count))
    assert statistic < chi_square_limit(cell_count - 1), f"chi-square {statistic} of {cell_count - 1} degrees"


def mean_and_error(residuals: np.ndarray) -> tuple[float, float]:
    """Mean of independent residuals, and its standard error."""
    flat = np.asarray(residuals, dtype=np.float64).ravel()
    return float(flat.mean()), float(flat.std(ddof=1) / math.sqrt(flat.size))


def assert_unbiased(residuals: np.ndarray, bound: float, systematic: float = 0.0, z: float = Z_OF_1E_6) -> None:
    """The mean of independent residuals is 0 within z of its standard errors, which are small enough to see `bound`.

    systematic : what rounding and quadrature may leave.
    """
    mean, error = mean_and_error(residuals)
    allowed = z * error + systematic
    assert allowed <= bound, f"too few samples to see {bound}: the mean is known to {allowed}"
    assert abs(mean) <= allowed, f"mean {mean}, {abs(mean) / max(error, 1e-30):.1f} standard errors from 0"
