"""How much one work-item may do on drivers that end loops early without a word.

Mesa's llvmpipe stops all loops of a work-item after 65,535 iterations in sum, and the image is then wrong
in silence. On such devices work is cut so that an upper bound of the iterations stays below half the limit.
"""

from __future__ import annotations

import numpy as np

from clrast.errors import DeviceError
from clrast.opencl.device import Device

LOOP_LIMITS = {"rusticl": 65535}
"""Runtime -> iterations of all loops together that one work-item may make; absent: no limit."""

MAX_BAND_TILES = 1024
"""A triangle over the whole band walks through all its tiles: a band of more does not fit the limit."""

SETUP_ITERATIONS = 80
"""Upper bound for one triangle in setup_triangles (three clips of up to eight corners)."""


def loop_limit(device: Device) -> int | None:
    """Half the iterations that a work-item may make, or None where there is no limit."""
    limit = LOOP_LIMITS.get(device.runtime)
    return None if limit is None else limit // 2


def chunk_size_within(limit: int, spans: np.ndarray, vector_width: int) -> int:
    """Triangles that one work-item may bin.

    spans : (triangle_count,) int, tiles of each triangle's bound. Raises DeviceError where one
    triangle is already too much.
    """
    cost = 16 + 4 * spans.astype(np.int64) + vector_width
    size = max(vector_width, limit // SETUP_ITERATIONS // vector_width * vector_width)
    while size > vector_width:
        if int(np.add.reduceat(cost, np.arange(0, len(cost), size)).max()) <= limit:
            return size
        size = max(vector_width, size // 2 // vector_width * vector_width)
    if int(np.add.reduceat(cost, np.arange(0, len(cost), size)).max()) > limit:
        raise DeviceError("this driver limits loops and the triangles are too large for it: use --device pocl")
    return size


def _worst_piece(cost: np.ndarray, begin: np.ndarray, lengths: np.ndarray, span: int) -> int:
    """Largest cost of a piece when each list of `lengths` from `begin` on is cut every `span` references."""
    piece_counts = -(-lengths // span)
    if not piece_counts.any():
        return 0
    number = np.arange(int(piece_counts.sum())) - np.repeat(np.cumsum(piece_counts) - piece_counts, piece_counts)
    starts = np.repeat(begin[:-1].astype(np.int64), piece_counts) + number * span
    ends = np.minimum(starts + span, np.repeat(begin[1:].astype(np.int64), piece_counts))
    return int((cost[ends] - cost[starts]).max())


def reference_span_within(
    limit: int, tile_begin: np.ndarray, bounds: np.ndarray, tile_size: int, vector_width: int
) -> int:
    """References of each tile's list that one work-item may rasterize in one launch.

    tile_begin : (tile_count + 1,) uint32. bounds : (reference_count,) uint32, packed as in
    rasterize_tiles.cl.
    """
    columns, rows = {16: (4, 4), 8: (4, 2), 1: (1, 1)}[vector_width]
    x0, y0, x1, y1 = (bounds >> shift & 0xFF for shift in (0, 8, 16, 24))
    block_rows = ((y1 + rows - 1) // rows - y0 // rows).astype(np.int64)
    blocks = ((x1 + columns - 1) // columns - x0 // columns) * block_rows
    # A large triangle goes through whole rows of the tile's blocks, vector_width of them at a time.
    tested = block_rows * max(1, tile_size // columns // vector_width)
    cost = np.concatenate([[0], np.cumsum(16 + 3 * blocks + tested)])
    base = 9 * tile_size * tile_size
    lengths = np.diff(tile_begin.astype(np.int64))
    span = max(vector_width, int(lengths.max(initial=0)))
    while span > 1:
        if _worst_piece(cost, tile_begin, lengths, span) + base <= limit:
            break
        span //= 2
    return span
