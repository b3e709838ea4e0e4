"""Lists of what is flagged in an array on the device, in order, by prefix sums (cl/list_samples.cl), and memory."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clrast.opencl import buffers, kernels
from clrast.opencl.constants import LIST_CHUNK
from clrast.opencl.device import Device
from clrast.opencl.features import Features

if TYPE_CHECKING:
    import pyopencl as cl


class Room:
    """Buffers by name that grow as they are asked for, and are kept; growing loses what one held."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self._made: dict[str, tuple[int, cl.Buffer]] = {}

    def __call__(self, name: str, nbytes: int) -> cl.Buffer:
        size, buffer = self._made.get(name, (-1, None))
        if buffer is None or size < nbytes:
            self._made.pop(name, None)
            size = nbytes + nbytes // 8
            self._made[name] = size, buffers.create(self.device, size)
        return self._made[name][1]


class FlagList:
    """Where flags are set, in order. `launches` : kernels launched."""

    def __init__(self, device: Device, features: Features) -> None:
        self.device, self.launches = device, 0
        self._room = Room(device)
        self._program = kernels.build(device, "list_samples.cl", features)

    def list(self, flags: cl.Buffer, count: int, name: str) -> tuple[cl.Buffer, int]:
        """Indices of the flags that are not 0, rising, in a buffer of that name, and how many there are. Waits.

        flags : [count] uchar.
        """
        begins, found = self.count(flags, count)
        listed = self._room(name, 4 * found)
        if found:
            self._launch(
                "list_edge_pixels", -(-count // LIST_CHUNK), pixel_count=count, edge_flags=flags, begins=begins,
                edge_pixels=listed, edge_places=self._room("places", 4 * count),
            )  # fmt: skip
        return listed, found

    def count(self, flags: cl.Buffer, count: int) -> tuple[cl.Buffer, int]:
        """How many flags before each LIST_CHUNK of them are not 0, [chunks + 1] uint, and how many in all. Waits.

        flags : [count] uchar.
        """
        begins = self.enqueue_count(flags, count)
        return begins, self.total(begins, count)

    def enqueue_count(self, flags: cl.Buffer, count: int) -> cl.Buffer:
        """The first that `count` returns, without a wait."""
        chunks = -(-count // LIST_CHUNK)
        counts, begins = self._room("counts", 4 * chunks), self._room("begins", 4 * (chunks + 1))
        self._launch("count_flags", chunks, count=count, flags=flags, chunk_counts=counts)
        self._launch("scan_counts", 1, count=chunks, counts=counts, begins=begins)
        return begins

    def total(self, begins: cl.Buffer, count: int) -> int:
        """How many of `count` flags are not 0, of what enqueue_count returned. Waits."""
        return int(buffers.download(self.device, begins, np.uint32, 1, offset=4 * -(-count // LIST_CHUNK))[0])

    def _launch(self, kernel: str, items: int, **arguments: Any) -> None:
        self._program.launch(kernel, items, 1, **arguments)
        self.launches += 1
