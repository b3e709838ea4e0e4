"""Colours in files: what is an 8-bit number is sRGB-encoded, what is a real number is linear.

The rule holds for vertex colours of PLY, OBJ and OFF alike, and for MTL's factors (real, so linear).
sRGB: IEC 61966-2-1, the piecewise curve.
"""

from __future__ import annotations

import numpy as np


def srgb_to_linear(value: float) -> float:
    """The linear intensity of an sRGB-encoded one; both 0..1."""
    return value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4


def decode_srgb8(codes: np.ndarray) -> np.ndarray:
    """Linear RGBA of 8-bit colours.

    codes : (n, 3) or (n, 4) uint8, RGB sRGB-encoded, alpha linear; alpha is 1 where there is none
    Returns (n, 4) float32.
    """
    table = np.array([srgb_to_linear(code / 255.0) for code in range(256)], dtype=np.float64).astype(np.float32)
    colors = np.ones((len(codes), 4), np.float32)
    colors[:, :3] = table[codes[:, :3]]
    if codes.shape[1] == 4:
        colors[:, 3] = (codes[:, 3].astype(np.float64) / 255.0).astype(np.float32)
    return colors


def linear_rgba(values: np.ndarray) -> np.ndarray:
    """(n, 4) float32 of (n, 3) or (n, 4) linear colours; alpha is 1 where there is none."""
    colors = np.ones((len(values), 4), np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        colors[:, : values.shape[1]] = values
    return colors
