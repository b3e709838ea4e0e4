"""Device memory: made, filled from arrays, read back; sizes are checked before the driver sees them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from clrast.errors import CapacityError
from clrast.opencl.device import Device

if TYPE_CHECKING:
    import pyopencl as cl

EMPTY_BYTES = 4
"""OpenCL has no empty buffers; kernels are told counts, so a few bytes that nobody reads stand for nothing."""


def create(device: Device, nbytes: int) -> cl.Buffer:
    """An uninitialised buffer of `nbytes` bytes that kernels may read and write."""
    import pyopencl as cl

    _check(device, nbytes)
    try:
        return cl.Buffer(device.context, cl.mem_flags.READ_WRITE, int(nbytes) or EMPTY_BYTES)
    except (cl.Error, MemoryError) as error:
        raise CapacityError(f"{device.name} could not give {nbytes} bytes of memory: render a smaller image") from error


def upload(device: Device, array: np.ndarray) -> cl.Buffer:
    """A buffer that holds a copy of the array's bytes in C order; any dtype and shape, empty ones too."""
    import pyopencl as cl

    array = np.ascontiguousarray(array)
    _check(device, array.nbytes)
    if not array.nbytes:
        array = np.zeros(EMPTY_BYTES, np.uint8)
    flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
    try:
        return cl.Buffer(device.context, flags, hostbuf=array)
    except (cl.Error, MemoryError) as error:
        raise CapacityError(f"{device.name} could not give {array.nbytes} bytes of memory") from error


def write(device: Device, buffer: cl.Buffer, array: np.ndarray, offset: int = 0) -> None:
    """Copy the array's bytes into the buffer from byte `offset` on; waits."""
    import pyopencl as cl

    if array.nbytes:
        cl.enqueue_copy(device.queue, buffer, np.ascontiguousarray(array), dst_offset=offset)


def copy(device: Device, source: cl.Buffer, target: cl.Buffer, nbytes: int) -> None:
    """Enqueue a copy of the first `nbytes` bytes from one buffer to another."""
    import pyopencl as cl

    cl.enqueue_copy(device.queue, target, source, byte_count=nbytes)


def fill(device: Device, buffer: cl.Buffer, value: np.generic, nbytes: int, offset: int = 0) -> cl.Event:
    """Repeat one numpy scalar over `nbytes` bytes of the buffer; returns the event."""
    import pyopencl as cl

    return cl.enqueue_fill_buffer(device.queue, buffer, np.asarray(value), offset, nbytes)


def filled(device: Device, value: np.generic, nbytes: int) -> cl.Buffer:
    """A new buffer in which one numpy scalar is repeated."""
    buffer = create(device, nbytes)
    if nbytes:
        fill(device, buffer, value, nbytes)
    return buffer


def download(
    device: Device,
    buffer: cl.Buffer,
    dtype: Any,
    shape: int | tuple[int, ...],
    offset: int = 0,
    out: np.ndarray | None = None,
) -> np.ndarray:
    """An array with a copy of the buffer's bytes from `offset` on; waits for all work queued before.

    out : a C-contiguous array of that dtype and shape that takes the copy. A fresh array costs about
    a millisecond per 4 MiB for its pages; one that is used again costs a quarter.
    """
    import pyopencl as cl

    result = np.zeros(shape, dtype) if out is None else out
    if result.nbytes:
        cl.enqueue_copy(device.queue, result, buffer, src_offset=offset)
    return result


@contextmanager
def mapped(
    device: Device, buffer: cl.Buffer, dtype: Any, shape: int | tuple[int, ...], offset: int = 0
) -> Iterator[np.ndarray]:
    """A view of the buffer for reading, without a copy on processors; not to be used after the block."""
    import pyopencl as cl

    shape = (shape,) if isinstance(shape, int) else shape
    view, _ = cl.enqueue_map_buffer(device.queue, buffer, cl.map_flags.READ, offset, shape, np.dtype(dtype))
    try:
        yield view
    finally:
        view.base.release(device.queue)


def _check(device: Device, nbytes: int) -> None:
    if nbytes > device.max_allocation_bytes:
        raise CapacityError(
            f"{device.name} gives at most {device.max_allocation_bytes} bytes in one piece, "
            f"{nbytes} are needed: render a smaller image or scene"
        )
