"""What samples of listed pixels show, VISIT_SAMPLES at a time: by lanes (cl/rasterize_samples.cl), or by passes."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from clrast.opencl import buffers, kernels
from clrast.opencl.constants import LIST_CHUNK, VISIT_SAMPLES
from clrast.opencl.device import Device
from clrast.opencl.features import Features
from clrast.visibility.sample_passes import SamplePasses
from clrast.visibility.sample_patterns import UNITS, Position
from clrast.visibility.tiles import TileRasterizer

if TYPE_CHECKING:
    import pyopencl as cl


class ListedSamples:
    """Decides samples of a pattern. prims : [listed * VISIT_SAMPLES] prim_id or NO_HIT, those of a pixel together.

    Where a method or rung has no kernel for lists, whole bands are decided, sample by sample; bits are the same.
    """

    def __init__(self, device: Device, features: Features, positions: Sequence[Position], max_pixels: int) -> None:
        self.device, self.positions = device, positions
        self.launches = 0
        self._width = features.vector_width
        self._program = kernels.build(device, "list_samples.cl", features)
        self.prims = buffers.create(device, 4 * VISIT_SAMPLES * max_pixels)

    def decide(
        self, passes: SamplePasses, visit: int, count: int, pixel_count: int, places: cl.Buffer | None,
        pixels: cl.Buffer | None = None,
    ) -> None:  # fmt: skip
        """Find what samples VISIT_SAMPLES * visit and on show. Waits.

        pixels : [count] of the band, rising. places : [pixel_count] where they stand there, or NO_HIT. None: all.
        """
        first = VISIT_SAMPLES * visit
        wanted = self.positions[first : first + VISIT_SAMPLES]
        if isinstance(passes.tiles, TileRasterizer) and passes.tiles.takes_samples:
            passes.timed("visibility", partial(self._decide_lanes, passes.tiles, wanted, places))
            passes.visits += 1
            passes.listed += count * VISIT_SAMPLES
            return
        for k, position in enumerate(wanted):
            passes.decide((position,))
            self._program.launch(
                "take_samples", -(-count // LIST_CHUNK), 1, count=count, everywhere=int(pixels is None), sample=k,
                pixels=passes.tiles.visible_prims if pixels is None else pixels,
                visible_prims=passes.tiles.visible_prims, sample_prims=self.prims,
            )  # fmt: skip
            self.launches += 1

    def _decide_lanes(self, tiles: TileRasterizer, wanted: Sequence[Position], places: cl.Buffer | None) -> None:
        for first in range(0, VISIT_SAMPLES, self._width):
            lanes = np.array(wanted[first : first + self._width], dtype=np.float32).T / UNITS
            tiles.rasterize_samples(lanes, places, self.prims, VISIT_SAMPLES, first)
