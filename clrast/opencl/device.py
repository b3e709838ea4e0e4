"""OpenCL devices: which there are, which of them work, and one opened for use.

A listed device is not a working one: drivers list devices whose compiler cannot build for this
processor. `self_test` builds and runs a small program with our own habits before anything trusts it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from clrast.errors import DeviceError, UsageError
from clrast.opencl import runtimes
from clrast.opencl.self_test import SelfTestResult, one_line, self_test

if TYPE_CHECKING:
    import pyopencl as cl

__all__ = ["Device", "ListedDevice", "SelfTestResult", "list_devices", "open_device", "self_test"]

VECTOR_WIDTHS = (1, 8, 16)


@dataclass(frozen=True)
class ListedDevice:
    """A device that a platform lists, working or not; `index` is what `--device P:D` takes."""

    index: str  # "P:D": number of the platform, number of the device in it
    runtime: str  # our name of the runtime, see runtimes.PREFERENCE
    platform: str
    version: str  # of the platform
    driver: str
    name: str
    kind: str  # "cpu", "gpu" or "other"
    handle: Any = field(repr=False, compare=False)  # pyopencl.Device


@dataclass(frozen=True, eq=False)
class Device:
    """An opened device that passed its self-test. `programs` is the program cache of kernels.py."""

    context: cl.Context
    queue: cl.CommandQueue
    handle: cl.Device
    name: str
    platform: str
    version: str
    runtime: str
    driver: str
    compute_units: int
    local_memory_bytes: int
    global_memory_bytes: int
    max_allocation_bytes: int
    max_work_group_size: int
    has_fp64: bool
    is_cpu: bool
    correctly_rounded: bool  # takes -cl-fp32-correctly-rounded-divide-sqrt
    vector_width: int  # samples per explicit vector: 16, 8 or 1
    programs: dict[Any, Any] = field(default_factory=dict, repr=False)

    def __str__(self) -> str:
        return f"{self.name} ({self.runtime} {self.driver})"


_opened: dict[tuple[int, bool, int], Device] = {}
"""Contexts outlive a single render: opening costs a self-test and loses the programs."""


def _load_pyopencl(threads: int | None) -> Any:
    runtimes.prepare_environment(threads)
    try:
        import pyopencl
    except Exception as error:  # a missing or broken libOpenCL shows as ImportError or OSError
        raise DeviceError(f"pyopencl does not load ({one_line(error)}): pip install pyopencl") from error
    return pyopencl


_platforms: list[tuple[int, str, Any]] = []
"""(number, text, pyopencl.Platform) of all platforms, asked for once: the loader answers once, too."""

_devices: dict[int, list[ListedDevice]] = {}
"""Platform number -> its devices. Filled when needed: rusticl takes 0.2 s to say what it has."""


def _load_platforms(cl: Any) -> list[tuple[int, str, Any]]:
    if not _platforms:
        try:
            with runtimes.watch_threads():
                found = cl.get_platforms()
        except cl.Error:  # the loader's way to say that there is none
            found = []
        _platforms.extend((p, f"{x.name} {x.vendor} {x.version}", x) for p, x in enumerate(found))
    return _platforms


def _load_devices(cl: Any, number: int, platform: Any) -> list[ListedDevice]:
    if number not in _devices:
        found = []
        try:
            with runtimes.watch_threads():
                handles = platform.get_devices()
            found = [_describe(cl, f"{number}:{d}", platform, handle) for d, handle in enumerate(handles)]
        except cl.Error:  # a platform without devices
            pass
        _devices[number] = found
    return _devices[number]


def list_devices(threads: int | None = None) -> list[ListedDevice]:
    """Every device of every platform, in the loader's order; empty where there is none. Nothing is tested."""
    cl = _load_pyopencl(threads)
    return [device for number, _, platform in _load_platforms(cl) for device in _load_devices(cl, number, platform)]


def _describe(cl: Any, index: str, platform: Any, handle: Any) -> ListedDevice:
    kind = handle.type
    is_cpu = bool(kind & cl.device_type.CPU)
    text = f"{platform.name} {platform.vendor} {platform.version}"
    return ListedDevice(
        index=index,
        runtime=runtimes.runtime_name(text, is_cpu),
        platform=platform.name.strip(),
        version=platform.version.strip(),
        driver=handle.driver_version.strip(),
        name=handle.name.strip(),
        kind="cpu" if is_cpu else "gpu" if kind & cl.device_type.GPU else "other",
        handle=handle,
    )


def preferred(devices: list[ListedDevice]) -> list[ListedDevice]:
    """The devices in the order in which `open_device` tries them."""
    return sorted(devices, key=lambda d: runtimes.PREFERENCE.index(d.runtime))


def matching(devices: list[ListedDevice], selector: str | None) -> list[ListedDevice]:
    """The devices that `selector` names, best first; None for all.

    "P:D" is an index. A word is our name of a runtime, else a part of a platform's name or version, else
    a part of a device's name, in any case: the first of these that fits anything decides.
    """
    if selector is None:
        return preferred(devices)
    wanted = selector.strip().lower()
    if re.fullmatch(r"\d+:\d+", wanted):
        return [d for d in devices if d.index == wanted]
    if wanted.isdigit():  # a platform by its number, never a digit of some version
        return preferred([d for d in devices if d.index.split(":")[0] == wanted])
    if wanted in ("cpu", "gpu"):
        return preferred([d for d in devices if d.kind == wanted])
    texts: tuple[Callable[[ListedDevice], Any], ...] = (
        lambda d: [d.runtime],
        lambda d: f"{d.platform} {d.version}".lower(),
        lambda d: d.name.lower(),
    )
    for text in texts if wanted else ():
        found = [d for d in devices if wanted in text(d)]
        if found:
            return preferred(found)
    return []


def _candidates(cl: Any, selector: str | None) -> Iterator[ListedDevice]:
    """What `matching` gives, but without asking platforms that need not be asked."""
    platforms = _load_platforms(cl)
    if selector is None:
        order = sorted(platforms, key=lambda entry: runtimes.PREFERENCE.index(runtimes.runtime_name(entry[1])))
        yield from (d for number, _, platform in order for d in preferred(_load_devices(cl, number, platform)))
        return
    wanted = selector.strip().lower()
    known = [entry for entry in platforms if runtimes.runtime_name(entry[1]) == wanted]
    devices = [d for number, _, platform in known or platforms for d in _load_devices(cl, number, platform)]
    yield from matching(devices, selector)


def test_by_index(index: str) -> SelfTestResult:
    """The self-test of the device "P:D", in this process."""
    number = int(index.split(":")[0])
    for p, _, platform in _load_platforms(_load_pyopencl(None)):
        for listed in _load_devices(_load_pyopencl(None), p, platform) if p == number else ():
            if listed.index == index:
                return self_test(listed.handle)
    return SelfTestResult(False, f"no OpenCL device has the index {index}")


def open_device(selector: str | None = None, threads: int | None = None, *, profiling: bool = False) -> Device:
    """The best working device, or the best that `selector` names (see `matching`).

    threads : at most so many threads compute; None leaves it to the runtime. A runtime never gets more
    threads than at its first use in a process. profiling : events carry times.
    Raises DeviceError where no such device works.
    """
    if threads is not None and threads < 1:
        raise UsageError(f"--threads {threads}: give 1 or more")
    cl = _load_pyopencl(threads)
    failures = []
    for candidate in _candidates(cl, selector):
        result = self_test(candidate.handle, candidate.index)
        if result.ok:
            _check_threads(candidate.runtime, threads)
            runtimes.limit_threads(threads)
            return _open(candidate, profiling)
        failures.append(f"{candidate.index} {candidate.name}: {result.reason}")
    if failures:
        raise DeviceError(f"no OpenCL device passes the self-test ({'; '.join(failures)}): {runtimes.MEND}")
    listed = list_devices(threads)
    if not listed:
        raise DeviceError(f"there is no OpenCL device: {runtimes.MEND}")
    names = ", ".join(f"{d.index} {d.runtime} {d.name}" for d in listed)
    raise DeviceError(f"no OpenCL device matches '{selector}': there are {names}")


_first_threads: dict[str, int | None] = {}
"""Our name of a runtime -> `threads` at its first use in this process."""


def _check_threads(runtime: str, threads: int | None) -> None:
    first = _first_threads.setdefault(runtime, threads)
    if runtime == "intel" and threads not in (None, first):  # see runtimes.KNOWN_FAULTS
        had = "all processors" if first is None else f"{first} threads"
        raise DeviceError(f"Intel's runtime was started on {had} in this process: ask for {threads} in a new one")


def _open(listed: ListedDevice, profiling: bool) -> Device:
    import pyopencl as cl

    handle = listed.handle
    width = vector_width(listed)  # the environment may change between two renders of a process
    key = (handle.int_ptr, profiling, width)
    if key in _opened:
        return _opened[key]
    context = cl.Context([handle])
    profile = cl.command_queue_properties.PROFILING_ENABLE
    config = handle.single_fp_config
    device = Device(
        context=context,
        queue=cl.CommandQueue(context, properties=profile) if profiling else cl.CommandQueue(context),
        handle=handle,
        name=listed.name,
        platform=listed.platform,
        version=listed.version,
        runtime=listed.runtime,
        driver=listed.driver,
        compute_units=handle.max_compute_units,
        local_memory_bytes=handle.local_mem_size,
        global_memory_bytes=handle.global_mem_size,
        max_allocation_bytes=handle.max_mem_alloc_size,
        max_work_group_size=handle.max_work_group_size,
        has_fp64="cl_khr_fp64" in handle.extensions.split(),
        is_cpu=listed.kind == "cpu",
        correctly_rounded=bool(config & cl.device_fp_config.CORRECTLY_ROUNDED_DIVIDE_SQRT),
        vector_width=width,
    )
    _opened[key] = device
    return device


def vector_width(listed: ListedDevice) -> int:
    """Samples per explicit vector; CLRAST_VECTOR_WIDTH overrides (pixels do not depend on it)."""
    asked = os.environ.get("CLRAST_VECTOR_WIDTH")
    if asked:
        if asked not in ("1", "8", "16"):
            raise UsageError(f"CLRAST_VECTOR_WIDTH={asked}: give one of 1, 8, 16")
        return int(asked)
    if listed.kind != "cpu" or listed.runtime not in ("pocl", "intel"):
        return 1
    return 16 if listed.handle.native_vector_width_float >= 16 else 8
