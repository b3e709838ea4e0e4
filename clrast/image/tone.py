"""From linear colour to the 8 bits of a screen: a curve without exposure, then sRGB encoding.

Colours whose largest component is at most KNEE stay as they are, so that a material looks the way
its file says. Above it the largest component p becomes

    1 - (1 - KNEE)^2 / (p + 1 - 2 KNEE)

which meets the straight line with its slope and reaches 1 at infinity; the other components shrink in
proportion, which keeps the hue. Nothing depends on the rest of the image: no exposure, no average.
"""

from __future__ import annotations

import functools
import math

import numpy as np

KNEE = 0.75
LARGEST = 1.0e6
"""Larger values, +Inf too, are shown as this."""


def tone_map(rgb: np.ndarray) -> np.ndarray:
    """Linear colour of a screen.

    rgb : (H, W, 3) float32, linear, any value; negative ones and NaN count as 0
    Returns (H, W, 3) float32 in 0..1, linear.
    """
    knee, one = np.float32(KNEE), np.float32(1.0)
    clean = np.where(rgb > 0, np.minimum(rgb, np.float32(LARGEST)), np.float32(0.0)).astype(np.float32)
    peak = np.maximum(np.maximum(clean[..., 0], clean[..., 1]), clean[..., 2])
    high = np.maximum(peak, knee)
    curve = one - (one - knee) * (one - knee) / (high + (one - knee - knee))
    scale = np.where(peak > knee, curve / high, one)
    return np.minimum(clean * scale[..., np.newaxis], one)


def srgb_bytes(linear: np.ndarray) -> np.ndarray:
    """The nearest 8-bit sRGB codes of linear values: uint8 of the same shape.

    Compared with the 255 borders between codes, which `math` computes once in float64: numpy's `power`
    differs between processors in the last bit, a comparison does not.
    """
    return np.searchsorted(_borders(), linear, side="right").astype(np.uint8)


def srgb_encode(linear: np.ndarray) -> np.ndarray:
    """sRGB-encoded float32 of linear values in 0..1. For measures, not for images: see srgb_bytes."""
    border = np.float32(0.0031308)
    low = linear * np.float32(12.92)
    high = np.float32(1.055) * np.power(np.maximum(linear, border), np.float32(1 / 2.4)) - np.float32(0.055)
    return np.where(linear <= border, low, high).astype(np.float32)


@functools.cache
def _borders() -> np.ndarray:
    """(255,) float32, rising: the linear values halfway, in sRGB code, between each code and the next."""
    borders = []
    for code in range(255):
        encoded = (code + 0.5) / 255.0
        borders.append(encoded / 12.92 if encoded <= 0.04045 else math.pow((encoded + 0.055) / 1.055, 2.4))
    return np.array(borders, np.float32)
