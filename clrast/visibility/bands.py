"""Bands: an image that does not fit the memory budget is rendered some tile rows at a time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from clrast.errors import CapacityError
from clrast.visibility.loop_limits import MAX_BAND_TILES

REFERENCE_SHARE = 0.5
"""Part of a budget, after the scene, that is left to the tiles' lists."""


@dataclass(frozen=True)
class BandPlan:
    """Bands of `band_rows` tile rows (the last may be shorter). Iterates as (first row, row count).

    pixel_bytes : device bytes a pixel takes; max_pixels : pixels of the largest band.
    """

    tile_rows: int
    band_rows: int
    pixel_bytes: int
    max_pixels: int

    def __iter__(self) -> Iterator[tuple[int, int]]:
        for row in range(0, self.tile_rows, self.band_rows):
            yield row, min(self.band_rows, self.tile_rows - row)

    def __len__(self) -> int:
        return -(-self.tile_rows // self.band_rows)


def plan_bands(
    view: np.ndarray,
    tile_log2: int,
    *,
    fixed_bytes: int,
    pixel_bytes: int,
    piece_bytes: int,
    budget: int,
    max_piece: int,
    limited: bool,
    square_bytes: int = 0,
) -> BandPlan:
    """As few bands as fit `budget` bytes, and `max_piece` bytes in each buffer.

    fixed_bytes : what the scene takes whatever the band. square_bytes : of each tile or root frustum. piece_bytes :
    what a pixel takes in the largest buffer. limited : on drivers that limit loops. Raises CapacityError where not
    even one tile row fits.
    """
    tile_rows, columns = int(view["tile_rows"]), int(view["tile_columns"])
    width, height = int(view["width"]), int(view["height"])
    row_bytes = (width << tile_log2) * pixel_bytes + columns * square_bytes
    band_rows = tile_rows
    left = int((budget - fixed_bytes) * (1 - REFERENCE_SHARE))
    if left < row_bytes:
        least = fixed_bytes + int(row_bytes / (1 - REFERENCE_SHARE))
        raise CapacityError(
            f"{budget} bytes of device memory are too few: the scene takes {fixed_bytes} and one row of tiles "
            f"{row_bytes}: --memory must be at least {least}"
        )
    band_rows = min(band_rows, left // row_bytes, max(1, max_piece // ((width << tile_log2) * piece_bytes)))
    if limited:
        band_rows = max(1, min(band_rows, MAX_BAND_TILES // columns))
    max_pixels = min(band_rows << tile_log2, height) * width
    return BandPlan(tile_rows, band_rows, pixel_bytes, max_pixels)
