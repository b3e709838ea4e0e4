"""What a band's samples show beside its centres, and the list of pixels where that differs (cl/list_samples.cl)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from clrast.opencl import buffers, kernels
from clrast.opencl.constants import LIST_CHUNK
from clrast.opencl.device import Device
from clrast.opencl.features import Features
from clrast.shading.shade import WORK_GROUP
from clrast.visibility.sample_passes import SamplePasses
from clrast.visibility.sample_patterns import Position

if TYPE_CHECKING:
    import pyopencl as cl

PLANE_ALIGNMENT = 1024
"""Entries that the planes of samples are padded to: vectors are read past the end, sub-buffers begin aligned."""

BYTES_PER_PIXEL = 4 + 1 + 4
"""Device bytes a pixel of a band takes here, beside 4 for each plane and 4 in the list."""


def padded(count: int) -> int:
    """Work items for so many pixels."""
    return -(-count // WORK_GROUP) * WORK_GROUP


class EdgePixels:
    """Visibility of `plane_count` samples of each pixel, and lists by prefix sums.

    prims : [plane_count * stride] prim_id or NO_HIT, plane by plane; planes : each by itself. center : of the centres.
    places : [pixels] where a pixel stands in the list, or NO_HIT. `launches` : kernels launched.
    """

    def __init__(self, device: Device, features: Features, plane_count: int, max_pixels: int) -> None:
        self.device, self.plane_count = device, plane_count
        self.launches = 0
        self.stride = -(-max_pixels // PLANE_ALIGNMENT) * PLANE_ALIGNMENT
        self._program = kernels.build(device, "list_samples.cl", features)
        self.prims = buffers.create(device, 4 * self.stride * plane_count)
        self.planes = [self.prims.get_sub_region(4 * self.stride * k, 4 * self.stride) for k in range(plane_count)]
        self.center = buffers.create(device, 4 * self.stride)
        self.flags = buffers.create(device, self.stride)
        self.places = buffers.create(device, 4 * self.stride)
        chunks = self.stride // LIST_CHUNK
        self._chunk_counts = buffers.create(device, 4 * chunks)
        self.begins = buffers.create(device, 4 * (chunks + 1))
        self._grown: dict[str, tuple[int, cl.Buffer]] = {}

    def decide(
        self, passes: SamplePasses, row: int, rows: int, pixel_count: int, pattern: Sequence[Position]
    ) -> None:
        """Keep what the centres show, and find what the samples of a pattern do. Waits."""
        self.start(passes, row, rows, pixel_count, pattern)
        passes.decide(pattern, self.planes)

    def start(self, passes: SamplePasses, row: int, rows: int, pixel_count: int, pattern: Sequence[Position]) -> None:
        """Keep what the centres show, and bin the band's triangles by bounds that hold for the pattern's samples."""
        buffers.copy(self.device, passes.tiles.visible_prims, self.center, 4 * pixel_count)
        passes.set_up(pattern)
        passes.start_band(row, rows)

    def flag(self, pixel_count: int) -> None:
        """Enqueue: flag the pixels where a sample shows another triangle than the centre."""
        self._launch(
            "flag_edge_pixels", pixel_count, pixel_count=pixel_count, depth_count=self.plane_count,
            prim_stride=self.stride, center_prims=self.center, sample_prims=self.prims, edge_flags=self.flags,
            chunk_counts=self._chunk_counts,
        )  # fmt: skip

    def count_flags(self, pixel_count: int) -> None:
        """Enqueue: count the flags of each chunk anew, where something else has flagged pixels besides."""
        self._launch("count_flags", pixel_count, count=pixel_count, flags=self.flags, chunk_counts=self._chunk_counts)

    def list_flagged(self, pixel_count: int) -> int:
        """List the flagged pixels as `edge_pixels`; returns how many. Waits."""
        count = self._scan(pixel_count)
        self._launch(
            "list_edge_pixels", pixel_count, pixel_count=pixel_count, edge_flags=self.flags, begins=self.begins,
            edge_pixels=self.room("edge_pixels", 4 * count), edge_places=self.places,
        )  # fmt: skip
        return count

    def sum_entries(self, counts: cl.Buffer, count: int) -> int:
        """`begins` of a list to which each of `count` items gives so many entries (bytes); returns the sum. Waits."""
        self._launch("sum_bytes", count, count=count, bytes=counts, chunk_counts=self._chunk_counts)
        return self._scan(count)

    def _scan(self, count: int) -> int:
        chunks = -(-count // LIST_CHUNK)
        self._launch("scan_counts", 1, count=chunks, counts=self._chunk_counts, begins=self.begins)
        return int(buffers.download(self.device, self.begins, np.uint32, 1, offset=4 * chunks)[0])

    def room(self, name: str, nbytes: int = 0) -> cl.Buffer:
        """A buffer of at least so many bytes, kept from band to band; growing loses what it held."""
        size, buffer = self._grown.get(name, (-1, None))
        if buffer is None or size < nbytes:
            self._grown.pop(name, None)
            size = nbytes + nbytes // 8
            self._grown[name] = size, buffers.create(self.device, size)
        return self._grown[name][1]

    def _launch(self, kernel: str, items: int, /, **arguments: Any) -> None:
        self._program.launch(kernel, -(-items // LIST_CHUNK), 1, **arguments)
        self.launches += 1
