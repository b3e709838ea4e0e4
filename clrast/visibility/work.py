"""Counters of what kernels did: rows of work items on the device, summed on the host; and costs per sample."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clrast.opencl import buffers
from clrast.opencl.device import Device
from clrast.opencl.layout import WORK_COUNTERS
from clrast.visibility.view import band_pixel_count

if TYPE_CHECKING:
    import pyopencl as cl

COST_PLANES = 3
"""Evaluations, setups and traversal steps of each sample."""


class WorkCounters:
    """Device buffers that kernels built with features.counters add to."""

    def __init__(self, device: Device, pixel_count: int) -> None:
        self.device = device
        self.pixel_count = pixel_count
        self._rows: cl.Buffer | None = None
        self._row_count = 0
        self.cost = buffers.create(device, 4 * COST_PLANES * pixel_count)
        self.totals = dict.fromkeys(WORK_COUNTERS, 0)

    def clear(self) -> None:
        """Begin a frame."""
        self.totals = dict.fromkeys(WORK_COUNTERS, 0)
        self._clear_rows()

    def _clear_rows(self) -> None:
        if self._rows is not None:
            buffers.fill(self.device, self._rows, np.uint32(0), 8 * len(WORK_COUNTERS) * self._row_count)

    def clear_cost(self) -> None:
        """Begin a band."""
        buffers.fill(self.device, self.cost, np.uint32(0), 4 * COST_PLANES * self.pixel_count)

    def rows(self, item_count: int) -> cl.Buffer:
        """A buffer with a row for each of that many work items, which may have been added to."""
        if self._rows is None or item_count > self._row_count:
            self.collect()
            self._row_count = item_count
            self._rows = buffers.create(self.device, 8 * len(WORK_COUNTERS) * item_count)
            self._clear_rows()
        return self._rows

    def of_samples(self, view: np.ndarray, item_count: int) -> dict[str, Any]:
        """Arguments of a kernel that decides the samples of the view's band."""
        return {"work": self.rows(item_count), "cost": self.cost, "pixel_count": band_pixel_count(view)}

    def collect(self) -> dict[str, int]:
        """Totals of the frame so far, by the names of WORK_COUNTERS. Waits."""
        if self._rows is not None:
            table = buffers.download(self.device, self._rows, np.uint64, (self._row_count, len(WORK_COUNTERS)))
            for name, column in zip(WORK_COUNTERS, table.T, strict=True):
                self.totals[name] += int(column.sum())
            self._clear_rows()
        return dict(self.totals)

    def read_cost(self, out: tuple[np.ndarray, ...], first_row: int, row_count: int, pixel_count: int) -> None:
        """Copy the band's costs into rows of three (height, width) float32 arrays. Waits."""
        width = out[0].shape[1]
        for plane, channel in enumerate(out):
            values = buffers.download(
                self.device, self.cost, np.uint32, (row_count, width), offset=4 * plane * pixel_count
            )
            channel[first_row : first_row + row_count] = values
