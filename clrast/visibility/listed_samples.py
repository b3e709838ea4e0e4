"""What samples of listed pixels show, VISIT_SAMPLES a visit: by lanes (cl/rasterize_samples.cl), or by passes."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from clrast.opencl import kernels
from clrast.opencl.constants import LANE_GROUPS, LIST_CHUNK, VISIT_SAMPLES
from clrast.opencl.device import Device
from clrast.opencl.features import Features
from clrast.visibility.sample_passes import SamplePasses
from clrast.visibility.sample_patterns import UNITS, Position
from clrast.visibility.tiles import TileRasterizer

if TYPE_CHECKING:
    import pyopencl as cl


class ListedSamples:
    """Decides samples of a pattern, visit by visit.

    Where a method or rung has no kernel for lists, whole bands are decided, sample by sample; bits are the same.
    """

    def __init__(self, device: Device, features: Features, positions: Sequence[Position]) -> None:
        self.device, self.positions = device, positions
        self.launches = 0
        self._width = features.vector_width
        self._program = kernels.build(device, "list_samples.cl", features)

    def decide_all(
        self, passes: SamplePasses, visits: Sequence[int], pixel_count: int, center: cl.Buffer, differs: cl.Buffer,
        prims: cl.Buffer, lanes: Sequence[int] | None = None,
    ) -> None:  # fmt: skip
        """Find what the samples of some visits, as few as one launch takes, show in all pixels of the band. Waits.

        lanes : of each visit a bit for each sample that counts; others are not decided where each takes a pass.

        center : [pixel_count] what centres show. differs : [pixel_count] uchar, 1 where a sample shows another
        triangle. prims : [pixel_count * samples] prim_id or NO_HIT, those of a pixel together, where it is 1.
        """
        self._decide(passes, visits, lanes, pixel_count, (center, differs, prims), None, None)

    def decide(
        self, passes: SamplePasses, visits: Sequence[int], count: int, center: cl.Buffer, prims: cl.Buffer,
        places: cl.Buffer, pixels: cl.Buffer, lanes: Sequence[int] | None = None,
    ) -> None:  # fmt: skip
        """Find what the samples of some visits show: of visit v those from VISIT_SAMPLES * v on. Waits.

        pixels : [count] of the band, rising. places : [pixel_count] where they stand there, or NO_HIT. center :
        [pixel_count] what is likely to be seen. prims : [count * samples] prim_id or NO_HIT, those of a pixel together,
        as the visits come.
        """
        if visits:
            self._decide(passes, visits, lanes, count, (center, center, prims), places, pixels)

    def _decide(
        self, passes: SamplePasses, visits: Sequence[int], lanes: Sequence[int] | None, count: int,
        found: tuple[cl.Buffer, cl.Buffer, cl.Buffer], places: cl.Buffer | None, pixels: cl.Buffer | None,
    ) -> None:  # fmt: skip
        wanted = [self.positions[VISIT_SAMPLES * visit + k] for visit in visits for k in range(VISIT_SAMPLES)]
        masks = [(1 << VISIT_SAMPLES) - 1] * len(visits) if lanes is None else lanes
        if isinstance(passes.tiles, TileRasterizer) and passes.tiles.takes_samples:
            passes.timed("visibility", partial(self._decide_lanes, passes.tiles, wanted, places, found))
            passes.visits += len(visits)
            passes.listed += count * sum(mask.bit_count() for mask in masks)
            return
        center, differs, prims = found
        for k, position in enumerate(wanted):
            if not masks[k // VISIT_SAMPLES] >> k % VISIT_SAMPLES & 1:
                continue
            passes.decide((position,))
            self._program.launch(
                "take_samples", -(-count // LIST_CHUNK), 1, count=count, everywhere=int(pixels is None), sample=k,
                stride=len(wanted), pixels=passes.tiles.visible_prims if pixels is None else pixels,
                visible_prims=passes.tiles.visible_prims, center_prims=center, differs=differs, sample_prims=prims,
            )  # fmt: skip
            self.launches += 1

    def _decide_lanes(
        self, tiles: TileRasterizer, wanted: Sequence[Position], places: cl.Buffer | None,
        found: tuple[cl.Buffer, cl.Buffer, cl.Buffer],
    ) -> None:  # fmt: skip
        at_once = LANE_GROUPS * self._width
        assert places is not None or len(wanted) <= at_once  # one launch says where samples differ
        for first in range(0, len(wanted), at_once):
            lanes = np.array(wanted[first : first + at_once], dtype=np.float32).T / UNITS
            tiles.rasterize_samples(lanes, places, *found, len(wanted), first)
