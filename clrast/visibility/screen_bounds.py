"""The canonical conservative screen bounds of all triangles, on the device: what every method starts from."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clrast.opencl import buffers, kernels
from clrast.opencl.device import Device
from clrast.opencl.features import Features
from clrast.opencl.layout import CHUNK_COUNT
from clrast.visibility.geometry import Geometry
from clrast.visibility.loop_limits import SETUP_ITERATIONS, loop_limit

if TYPE_CHECKING:
    import pyopencl as cl

    from clrast.visibility.settle import ContenderList
    from clrast.visibility.work import WorkCounters

BOUND_BYTES = 8
"""Device bytes of a triangle's screen bound; 4 more for its nearness, with features.node_bounds."""


def round_up(value: int, step: int) -> int:
    return -(-value // step) * step


class ScreenBounds:
    """Buffers of bounds, in the order of the geometry's slots, and their kernel.

    low, high : [padded_count] uint32, x0 | y0 << 16 and x1 | y1 << 16. nearest : [padded_count] float32, greatest
    nearness in the bound, or None. Vectors may be read past the last triangle.
    """

    def __init__(self, device: Device, features: Features, geometry: Geometry) -> None:
        self.device, self.features, self.geometry = device, features, geometry
        width = features.vector_width
        self.padded_count = round_up(geometry.triangle_count, width)
        limit = loop_limit(device)
        chunk_count = CHUNK_COUNT if limit is None else -(-self.padded_count // max(1, limit // SETUP_ITERATIONS))
        self.set_chunks(round_up(-(-self.padded_count // chunk_count), width))
        size = 4 * (self.padded_count + width)
        self.low = buffers.create(device, size)
        self.high = buffers.create(device, size)
        self.nearest: cl.Buffer | None = buffers.create(device, size) if features.node_bounds else None
        self._program = kernels.build(device, "setup_triangles.cl", features)

    def set_chunks(self, chunk_size: int) -> None:
        """Runs of triangles that a work item takes."""
        self.chunk_size = chunk_size
        self.chunk_count = max(1, -(-self.padded_count // chunk_size))

    def find(self, view: np.ndarray, work: WorkCounters | None, contenders: ContenderList | None) -> None:
        """Enqueue the setup of every triangle's bound (and nearness, and facing)."""
        more: dict[str, Any] = {} if self.nearest is None else {"nearest": self.nearest}
        if contenders is not None:
            contenders.start_view()
            more |= contenders.setup_arguments()
        if work is not None:
            more["work"] = work.rows(self.chunk_count)
        self._program.launch(
            "setup_triangles",
            self.chunk_count,
            1,
            view=view,
            triangle_count=self.geometry.triangle_count,
            chunk_size=self.chunk_size,
            corners=self.geometry.corners,
            bounds_low=self.low,
            bounds_high=self.high,
            **more,
        )
        if contenders is not None:
            contenders.settle_facing(view, self.low, self.high)

    def areas(self) -> np.ndarray:
        """Samples in each bound: (triangle_count,) int64, by slot. Waits."""
        count = self.geometry.triangle_count
        low = buffers.download(self.device, self.low, np.uint32, count)
        high = buffers.download(self.device, self.high, np.uint32, count)
        widths, heights = (high & 0xFFFF) - (low & 0xFFFF), (high >> 16) - (low >> 16)
        return widths.astype(np.int64) * heights

    def read(self) -> np.ndarray:
        """The bounds: (triangle_count, 4) int64, x0 y0 x1 y1 in pixels, empty ones 0, by slot. Waits."""
        count = self.geometry.triangle_count
        low = buffers.download(self.device, self.low, np.uint32, count).astype(np.int64)
        high = buffers.download(self.device, self.high, np.uint32, count).astype(np.int64)
        return np.stack([low & 0xFFFF, low >> 16, high & 0xFFFF, high >> 16], axis=1)
