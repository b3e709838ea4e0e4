"""The difference of two images as an image: numbers in an .exr, a heat map in a .png."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from clrast.image.files import image_suffix
from clrast.image.flip import FlipError
from clrast.image.frame import Frame

HEAT = ((0, 96, 0, 96), (1, 200, 20, 60), (3, 255, 140, 0), (6, 255, 240, 100))
"""Decades over the threshold -> red, green, blue; colours between are mixed. Within it: dark blue. Ids that
differ and unmatched NaN or Inf: white. Equal pixels: black."""
WITHIN = (20, 40, 110)
BEYOND = (255, 255, 255)


class ErrorMaps:
    """Errors per pixel, gathered channel by channel.

    errors : channel -> (H, W) float32; ratio : (H, W) float64, largest error / threshold, None so far
    """

    def __init__(self) -> None:
        self.errors: dict[str, np.ndarray] = {}
        self.ratio: np.ndarray | None = None

    def add(self, channel: str, shape: tuple[int, ...], error: np.ndarray | None, threshold: float) -> None:
        """Add a channel's (H, W) float64 errors (None: it is equal); another size than the first's is left out."""
        if self.ratio is None:
            self.ratio = np.zeros(shape)
        if self.ratio.shape != shape:
            return
        if error is None:
            self.errors[channel] = np.zeros(shape, np.float32)
            return
        with np.errstate(over="ignore", under="ignore"):
            self.errors[channel] = error.astype(np.float32)
            if threshold == 0 or np.isinf(threshold):
                ratio = np.where(error > (0 if threshold == 0 else np.finfo(np.float64).max), np.inf, 0.0)
            else:
                ratio = error / threshold
        self.ratio = np.maximum(self.ratio, ratio)


def write_heatmap(path: str | Path, maps: ErrorMaps, flip: FlipError | None) -> None:
    """Write the maps, whole or not at all; OutputError where that fails.

    .exr: |reference - test| of each channel under its own name (1 where ids differ, Inf for an unmatched
    NaN or Inf), and FLIP as `flip.Y`. .png: the largest error over its threshold, in the colours of HEAT.
    """
    assert maps.ratio is not None
    if image_suffix(path) == ".png":
        from clrast.image.png import write_pixels

        write_pixels(path, heat_colors(maps.ratio))
        return
    channels = dict(maps.errors)
    if flip is not None and flip.map.shape == maps.ratio.shape:
        channels["flip.Y"] = flip.map
    Frame(channels).save(path)


def heat_colors(ratio: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8 of (H, W) ratios of error to threshold."""
    with np.errstate(divide="ignore"):
        decades = np.clip(np.log10(np.maximum(ratio, 1e-300)), HEAT[0][0], HEAT[-1][0])
    stops = [stop[0] for stop in HEAT]
    planes = [np.interp(decades, stops, [stop[plane] for stop in HEAT]) for plane in (1, 2, 3)]
    colors = (np.stack(planes, axis=-1) + 0.5).astype(np.uint8)
    colors[ratio <= 1] = WITHIN
    colors[ratio == 0] = 0
    colors[np.isinf(ratio)] = BEYOND
    return colors
