"""Perceptual error of colour by FLIP (Andersson et al. 2020), from the package flip-evaluator.

FLIP is asked for its version for screens (LDR), at its own default of 67 pixels per degree, on the
picture that a PNG shows over black: premultiplied colour through tone.py's curve. That curve never
clips, so highlights of different strength stay different, and it needs no exposure.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clrast.image.tone import srgb_encode, tone_map


@dataclass(frozen=True)
class FlipError:
    """FLIP of two colour images: 0 equal, 1 the largest difference.

    map : (H, W) float32; worst : x, y of the largest value, from the top left
    """

    map: np.ndarray
    mean: float
    max: float
    worst: tuple[int, int]


def flip_error(reference: np.ndarray, test: np.ndarray) -> FlipError:
    """FLIP between two (H, W, 3) float32 images of linear colour; equal ones cost no time."""
    height, width = reference.shape[:2]
    if np.array_equal(reference, test):
        return FlipError(np.zeros((height, width), np.float32), 0.0, 0.0, (0, 0))
    import flip_evaluator

    pictures = [np.ascontiguousarray(srgb_encode(tone_map(image))) for image in (reference, test)]
    errors = flip_evaluator.evaluate(pictures[0], pictures[1], "LDR", True, False, False, {})[0]
    errors = np.ascontiguousarray(errors.reshape(height, width), np.float32)
    y, x = divmod(int(errors.argmax()), width)
    return FlipError(errors, float(errors.mean(dtype=np.float64)), float(errors[y, x]), (x, y))
