"""Does a listed OpenCL device work? A small program with our own habits, compared with IEEE arithmetic bit by bit.

The first test of a driver on a machine runs in a process of its own: drivers have been seen to crash and
to hang where they compile for a processor that is newer than they are.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clrast.opencl.binaries import build_options, build_source, cache_folder, fingerprint

CHILD_SECONDS = 120
"""Longest first test; Oclgrind and a cold compiler need a few seconds."""


@dataclass(frozen=True)
class SelfTestResult:
    """Outcome of `self_test`: `reason` is one line on what failed, empty where `ok`."""

    ok: bool
    reason: str = ""
    milliseconds: float = 0.0


SELF_TEST_SOURCE = """
#pragma OPENCL FP_CONTRACT OFF
kernel void check_vectors(global const float *a, global const float *b, global float *out, global uint *bits)
{
    uint i = get_global_id(0);
    float16 x = vload16(i, a);
    float16 y = vload16(i, b);
    vstore16(x * y + x, i, out);
    vstore16(x / y, i + 4, out);
    vstore16(sqrt(fabs(x)), i + 8, out);
    int16 less = x < y;
    vstore16(select(x - y, y, less), i + 12, out);
    uint16 key = as_uint16(x) * 2654435761u ^ (as_uint16(y) >> 7);
    vstore16(clz(key) + popcount(as_uint16(less)), i, bits);
}
kernel void check_local(global const uint *bits, global uint *sums, local uint *shared_sums)
{
    uint i = get_local_id(0);
    uint count = get_local_size(0);
    shared_sums[i] = bits[get_global_id(0)];
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint step = 1; step < count; step *= 2) {
        uint other = i >= step ? shared_sums[i - step] : 0u;
        barrier(CLK_LOCAL_MEM_FENCE);
        shared_sums[i] += other;
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    sums[get_global_id(0)] = shared_sums[i];
}
"""


def _self_test_data() -> tuple[np.ndarray, np.ndarray]:
    """Two (64,) float32 arrays of mixed sign and magnitude, no subnormals in any result."""
    k = np.arange(64, dtype=np.uint32)
    mixed = (k * np.uint32(2654435761)) ^ (k << np.uint32(9))
    a = ((mixed >> np.uint32(8)).astype(np.float32) * np.float32(2.0**-20)) - np.float32(7.3)
    b = ((mixed & np.uint32(0xFFFFFF)).astype(np.float32) + np.float32(1.0)) * np.float32(3.1e-5)
    return a, b


def _expected(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    less = a < b
    floats = np.concatenate([a * b + a, a / b, np.sqrt(np.abs(a)), np.where(less, b, a - b)])
    key = (a.view(np.uint32) * np.uint32(2654435761)) ^ (b.view(np.uint32) >> np.uint32(7))
    bits = np.array([32 - int(v).bit_length() + (32 if lower else 0) for v, lower in zip(key, less)], np.uint32)
    sums = np.concatenate([np.cumsum(half, dtype=np.uint32) for half in np.split(bits, 2)])
    return floats, bits, sums


def _run(cl: Any, handle: Any) -> str:
    """One line on what is wrong with the device, empty where nothing is."""
    context = cl.Context([handle])
    queue = cl.CommandQueue(context)
    program = build_source(context, handle, SELF_TEST_SOURCE, build_options(handle))
    a, b = _self_test_data()
    floats, bits, sums = np.zeros(256, np.float32), np.zeros(64, np.uint32), np.zeros(64, np.uint32)
    flags = cl.mem_flags
    inputs = [cl.Buffer(context, flags.READ_ONLY | flags.COPY_HOST_PTR, hostbuf=x) for x in (a, b)]
    outputs = [cl.Buffer(context, flags.READ_WRITE, x.nbytes) for x in (floats, bits, sums)]
    vectors, local = cl.Kernel(program, "check_vectors"), cl.Kernel(program, "check_local")
    for i, buffer in enumerate((*inputs, outputs[0], outputs[1])):
        vectors.set_arg(i, buffer)
    for i, value in enumerate((outputs[1], outputs[2], cl.LocalMemory(32 * 4))):
        local.set_arg(i, value)
    cl.enqueue_nd_range_kernel(queue, vectors, (4,), (1,))
    cl.enqueue_nd_range_kernel(queue, local, (64,), (32,))
    for array, buffer in zip((floats, bits, sums), outputs):
        cl.enqueue_copy(queue, array, buffer)
    queue.finish()
    return _compare(floats, bits, sums, *_expected(a, b))


def _compare(*arrays: np.ndarray) -> str:
    floats, bits, sums, right_floats, right_bits, right_sums = arrays
    names = ("a * b + a without contraction", "division", "sqrt", "comparison and select")
    for k, name in enumerate(names):
        part = slice(64 * k, 64 * k + 64)
        if not np.array_equal(floats[part].view(np.uint32), right_floats[part].view(np.uint32)):
            wrong = int(np.count_nonzero(floats[part].view(np.uint32) != right_floats[part].view(np.uint32)))
            return f"{name}: {wrong} of 64 results differ from IEEE float32"
    if not np.array_equal(bits, right_bits):
        return "integer operations give wrong results"
    if not np.array_equal(sums, right_sums):
        return "a prefix sum in local memory gives wrong results"
    return ""


_tested: dict[int, SelfTestResult] = {}


def self_test(handle: Any, index: str | None = None) -> SelfTestResult:
    """Build and run a small program with our habits on a pyopencl device; never raises. Once per process.

    index : "P:D" of the device, by which a process of its own can find it; None tests in this one only.
    """
    key = handle.int_ptr
    if key not in _tested:
        start = time.perf_counter()
        reason = _crash_reason(handle, index) or _test_here(handle)
        _tested[key] = SelfTestResult(not reason, reason, 1e3 * (time.perf_counter() - start))
    return _tested[key]


def _test_here(handle: Any) -> str:
    try:
        import pyopencl as cl

        return _run(cl, handle)
    except Exception as error:  # drivers fail in every way there is
        return one_line(error)


def _crash_reason(handle: Any, index: str | None) -> str:
    """Empty where the device is known not to take the process down; the first time, a child process finds out."""
    folder = cache_folder()
    if index is None or folder is None:
        return ""
    try:
        proof = folder / f"{fingerprint(handle, SELF_TEST_SOURCE)}.survived"
        if proof.exists():
            return ""
        code = f"from clrast.opencl import device; device.test_by_index({index!r})"
        here = str(Path(__file__).resolve().parents[2])
        given = os.environ.get("PYTHONPATH")
        done = subprocess.run(
            [sys.executable, "-c", code],
            env={**os.environ, "PYTHONPATH": f"{here}{os.pathsep}{given}" if given else here},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            timeout=CHILD_SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"its driver does not finish within {CHILD_SECONDS} s"
    except Exception:  # no child can be had: the test itself says the rest
        return ""
    if done.returncode < 0:
        return f"its driver crashes (signal {-done.returncode})"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        proof.touch()
    except OSError:
        pass
    return ""


def one_line(error: BaseException) -> str:
    """The first line of an error that says something, at most 160 characters."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    telling = [line for line in lines if "error:" in line.lower() or "unknown" in line.lower()]
    return ((telling or lines or [type(error).__name__])[0])[:160]
