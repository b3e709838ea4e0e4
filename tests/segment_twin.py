"""Straight ways through triangles in float64: what is in the way, and how far that is from being otherwise."""

from __future__ import annotations

import numpy as np


def crossings(starts: np.ndarray, ways: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """t and least barycentric of lines through planes: two (rays, triangles).

    starts, ways : (rays, 3); corners : (triangles, 3, 3). Along a plane t is nan.
    """
    p0, e, f = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    n = np.cross(e, f)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = ((p0[None] - starts[:, None]) * n).sum(-1) / (ways[:, None] * n).sum(-1)
        at = starts[:, None] + t[..., None] * ways[:, None] - p0[None]
        size = (n * n).sum(-1)
        b1 = (np.cross(at, f[None]) * n).sum(-1) / size
        b2 = (np.cross(e[None], at) * n).sum(-1) / size
    return t, np.minimum(np.minimum(b1, b2), 1 - b1 - b2)


def blocked(
    starts: np.ndarray, ways: np.ndarray, corners: np.ndarray, t_max: float, own: np.ndarray
) -> np.ndarray:
    """(rays,) bool: whether a triangle other than `own` (rays,) is met at 0 < t < t_max."""
    t, inside = crossings(starts, ways, corners)
    met = (inside > 0) & (t > 0) & (t < t_max)
    met[np.arange(len(starts)), own] = False
    return met.any(axis=1)


def surely_blocked(
    starts: np.ndarray, ways: np.ndarray, corners: np.ndarray, t_max: float, own: np.ndarray, margin: float
) -> tuple[np.ndarray, np.ndarray]:
    """`blocked`, and whether that stays so where starts move by `margin` along each axis either way."""
    found = blocked(starts, ways, corners, t_max, own)
    sure = np.ones(len(starts), dtype=bool)
    for axis in range(3):
        for sign in (-1, 1):
            moved = starts.copy()
            moved[:, axis] += sign * margin
            towards = ways - (moved - starts) if t_max == 1 else ways
            sure &= blocked(moved, towards, corners, t_max, own) == found
    return found, sure
