"""Reconstruction filters: how much a sample counts for a pixel, by its offset from the pixel's centre.

All are separable, w(x) w(y), positive, and 0 from `radius` on (pixels):

box : 1 within the pixel; radius 1/2. The only one that takes no samples of neighbours.
tent : 1 - |x|; radius 1
gaussian : exp(-2 x^2), standard deviation 1/2; radius 1.5
blackman-harris : Harris' window of four terms (Harris 1978, 'minimum 4-term'), a window 3 pixels wide; radius 1.5
"""

from __future__ import annotations

import math

import numpy as np

from clrast.visibility.sample_patterns import UNITS, Pattern

RADII = {"box": 0.5, "tent": 1.0, "gaussian": 1.5, "blackman-harris": 1.5}

_HARRIS = (0.35875, 0.48829, 0.14128, 0.01168)


def weight_at(name: str, x: float) -> float:
    """w(x), float64, not normalised."""
    radius = RADII[name]
    if not -radius <= x < radius:
        return 0.0
    if name == "box":
        return 1.0
    if name == "tent":
        return 1.0 - abs(x)
    if name == "gaussian":
        return math.exp(-2.0 * x * x)
    phase = math.pi * (x / radius + 1.0)
    return sum((-1) ** k * a * math.cos(k * phase) for k, a in enumerate(_HARRIS))


def reach_of(name: str) -> int:
    """Pixels to each side whose samples the filter takes."""
    return math.ceil(RADII[name] - 0.5)


def weight_table(name: str, pattern: Pattern) -> np.ndarray:
    """(samples, taps) float32: each sample's weight where it belongs to the pixel dy rows below, dx to the right.

    Taps go row by row over dy and dx from -reach to reach.
    """
    reach = reach_of(name)
    offsets = range(-reach, reach + 1)
    rows = []
    for x, y in pattern.positions:
        across = [weight_at(name, d + x / UNITS - 0.5) for d in offsets]
        down = [weight_at(name, d + y / UNITS - 0.5) for d in offsets]
        rows.append([v * w for v in down for w in across])
    return np.array(rows, dtype=np.float64).astype(np.float32)
