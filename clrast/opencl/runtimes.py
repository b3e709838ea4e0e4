"""What is known about OpenCL runtimes before one is loaded: environment, threads, preference, faults.

OpenCL's loader reads its settings once, at the first question to it, and so do the runtimes.
Everything here therefore happens before that question, and this module never imports pyopencl.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

MEND = "install a working one: apt-get install pocl-opencl-icd, or run through tools/run"

# The runtimes that we have a name for: a word of the platform's name or version -> our name.
PLATFORM_WORDS = (
    ("pocl", "pocl"),
    ("portable computing language", "pocl"),
    ("intel", "intel"),
    ("rusticl", "rusticl"),
    ("clover", "clover"),
    ("oclgrind", "oclgrind"),
)

# Best first; "cpu" and "gpu" stand for runtimes without a name of their own.
PREFERENCE = ("pocl", "intel", "cpu", "gpu", "rusticl", "clover", "oclgrind")

# Environment variables by which a runtime takes its number of threads when it is loaded.
# Measured: PoCL 3.1 obeys POCL_MAX_PTHREAD_COUNT, llvmpipe LP_NUM_THREADS, Intel's CPU runtime
# DPCPP_CPU_NUM_CUS; sub-devices of PoCL and Intel do not hold (all threads stay busy). Later releases of
# PoCL read POCL_CPU_MAX_CU_COUNT.
THREAD_VARIABLES = ("POCL_MAX_PTHREAD_COUNT", "POCL_CPU_MAX_CU_COUNT", "LP_NUM_THREADS", "DPCPP_CPU_NUM_CUS")


PREFETCHING = ("pocl", "intel")
"""Runtimes whose compiler knows __builtin_prefetch (and whose own prefetch() does nothing)."""


@dataclass(frozen=True)
class KnownFault:
    """One fault of a driver: where it is met, what happens, and what that means here."""

    runtime: str  # our name of the runtime, see PLATFORM_WORDS
    version: str  # a part of "platform version, driver version"; empty for all
    what: str


KNOWN_FAULTS = (
    KnownFault("pocl", "PoCL 3.0", "the wheel's LLVM 14 does not know newer processors: unknown target CPU 'generic'"),
    KnownFault("pocl", "PoCL 3.1", "sub-devices do not limit the number of busy threads"),
    KnownFault("intel", "", "keeps the number of threads that it had at its first use in a process"),
    KnownFault("rusticl", " 22.3", "no float64; flushes subnormal operands and results of fma"),
    KnownFault("rusticl", " 22.3", "its compiler kills the process at __builtin_prefetch"),
    KnownFault("rusticl", "", "llvmpipe ends all loops of a work-item after 65,535 iterations, without a word"),
    KnownFault("clover", "", "shows no device for a processor"),
    KnownFault("oclgrind", "", "an interpreter, for small scenes; its own launcher crashes pyopencl's wheel"),
)


def runtime_name(platform_text: str, is_cpu: bool = True) -> str:
    """Our name of the runtime whose platform name, vendor and version are in `platform_text`."""
    text = platform_text.lower()
    for word, name in PLATFORM_WORDS:
        if word in text:
            return name
    return "cpu" if is_cpu else "gpu"


def known_faults(runtime: str, version: str) -> tuple[str, ...]:
    """What is known to be wrong with this runtime in this version."""
    return tuple(f.what for f in KNOWN_FAULTS if f.runtime == runtime and f.version in version)


def prepare_environment(threads: int | None) -> None:
    """Set what the runtimes read when they are loaded; a user's own thread variables yield to `threads` only."""
    os.environ.setdefault("RUSTICL_ENABLE", "llvmpipe")  # or rusticl shows no device
    os.environ.setdefault("OCL_ICD_PLATFORM_SORT", "none")  # else the loader asks each platform for its devices
    for name in THREAD_VARIABLES:
        if threads is not None:
            os.environ[name] = str(threads)
            _set_by_us.add(name)
        elif name in _set_by_us:
            os.environ.pop(name, None)
            _set_by_us.discard(name)


_set_by_us: set[str] = set()

_helper_threads: list[int] = []
"""Ids of the threads that the runtimes started in this process when they were loaded."""

_limit: int | None = None
"""The `threads` of the last call of `limit_threads`; None for no limit."""


@contextmanager
def watch_threads() -> Iterator[None]:
    """Remember the threads that are started inside the block as helpers of a runtime."""
    before = set(_thread_ids())
    yield
    _helper_threads.extend(sorted(set(_thread_ids()) - before))


@contextmanager
def quiet_stderr() -> Iterator[None]:
    """Drop what drivers write to stderr inside the block; our own errors say it better.

    clang's count of errors, and Mesa 22.3 at the first launch of a kernel: 'Treating load_kernel_arg in
    control flow as uniform', which arguments of kernels always are.
    """
    try:
        kept = os.dup(2)
    except OSError:  # stderr is closed
        yield
        return
    sink = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(sink, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(sink)


def _thread_ids() -> list[int]:
    try:
        return [int(name) for name in os.listdir("/proc/self/task")]
    except OSError:
        return []


def limit_threads(threads: int | None) -> None:
    """Let the runtimes' threads run on the first `threads` of this process's processors only; None: on all.

    A runtime obeys THREAD_VARIABLES once, when it is loaded; this makes a later, different wish hold too,
    up to the number of threads that it was loaded with.
    """
    global _limit
    if not hasattr(os, "sched_setaffinity") or threads == _limit:
        return
    _limit = threads
    processors = sorted(os.sched_getaffinity(0))[:threads]
    for k, thread in enumerate(_helper_threads):
        try:
            # First one processor each: threads that were held on one do not spread by themselves for seconds.
            os.sched_setaffinity(thread, [processors[k % len(processors)]])
            os.sched_setaffinity(thread, processors)
        except OSError:
            continue
