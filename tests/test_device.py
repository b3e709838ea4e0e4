"""Devices: listing, choosing, the self-test and its power to refuse, threads that hold."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from conftest import EXPECTED_RUNTIMES, runtimes

from clrast.errors import CapacityError, DeviceError, UsageError
from clrast.opencl import buffers
from clrast.opencl import device as devices
from clrast.opencl import runtimes as known
from clrast.opencl import self_test as testing

ROOT = Path(__file__).resolve().parents[1]


def run_python(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run code in a process of its own, where no runtime is loaded yet."""
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        env={**os.environ, "PYTHONPATH": str(ROOT), **environment},
        capture_output=True,
        text=True,
        timeout=120,
    )


@pytest.mark.parametrize("name", EXPECTED_RUNTIMES)
def test_an_installed_runtime_passes_the_self_test(name: str) -> None:
    reason = runtimes().reasons.get(name, "")
    if reason == "not installed" and not (name == "pocl" and os.environ.get("CI")):
        pytest.skip(f"{name} is not installed")
    assert not reason


@dataclass
class Listed:
    """Stands for a ListedDevice where only names matter."""

    index: str
    runtime: str
    platform: str
    version: str
    name: str


SHELF = [
    Listed("0:0", "oclgrind", "Oclgrind", "OpenCL 1.2 (Oclgrind 21.10)", "Oclgrind Simulator"),
    Listed("1:0", "rusticl", "rusticl", "OpenCL 3.0", "llvmpipe (LLVM 15.0.6, 256 bits)"),
    Listed("2:0", "gpu", "NVIDIA CUDA", "OpenCL 3.0 CUDA", "GeForce"),
    Listed("3:0", "pocl", "Portable Computing Language", "OpenCL 3.0 PoCL 3.1", "pthread-Intel(R) Xeon"),
    Listed("4:0", "intel", "Intel(R) OpenCL", "OpenCL 3.1 LINUX", "Intel(R) Xeon"),
]


@pytest.mark.parametrize(
    ("selector", "indices"),
    [
        (None, ["3:0", "4:0", "2:0", "1:0", "0:0"]),
        ("1:0", ["1:0"]),
        ("7:0", []),
        ("PoCL", ["3:0"]),
        ("intel", ["4:0"]),  # our name of a runtime comes before PoCL's device, whose name has the word too
        ("xeon", ["3:0", "4:0"]),
        ("CUDA", ["2:0"]),
        ("llvmpipe", ["1:0"]),
        ("nothing", []),
        ("", []),
    ],
)
def test_selectors(selector: str | None, indices: list[str]) -> None:
    assert [d.index for d in devices.matching(SHELF, selector)] == indices  # type: ignore[arg-type]


def test_open_device_takes_each_working_runtime_by_name_and_by_index() -> None:
    for name, index in runtimes().working.items():
        assert devices.open_device(name).runtime == name
        assert devices.open_device(index) is devices.open_device(name)


def test_open_device_prefers_pocl() -> None:
    if "pocl" not in runtimes().working:
        pytest.skip("PoCL is not installed")
    assert devices.open_device().runtime == "pocl"


def test_an_unknown_selector_names_what_there_is() -> None:
    with pytest.raises(DeviceError, match="no OpenCL device matches 'warp9': there are .*0:0") as caught:
        devices.open_device("warp9")
    assert caught.value.exit_code == 69
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("threads", [0, -1])
def test_no_threads_is_wrong_usage(threads: int) -> None:
    with pytest.raises(UsageError, match=f"--threads {threads}"):
        devices.open_device(threads=threads)


@pytest.mark.parametrize("width", ["1", "8", "16"])
def test_vector_width_from_the_environment(width: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CLRAST_VECTOR_WIDTH", width)
    listed = devices.list_devices()[0]
    assert devices.vector_width(listed) == int(width)
    assert devices.open_device(listed.index).vector_width == int(width)


@pytest.mark.parametrize("width", ["4", "sixteen", "-8", "016"])
def test_a_wrong_vector_width_is_wrong_usage(width: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CLRAST_VECTOR_WIDTH", width)
    with pytest.raises(UsageError, match="1, 8, 16"):
        devices.vector_width(devices.list_devices()[0])


@pytest.mark.small
def test_device_facts(device: devices.Device) -> None:
    assert device.handle.int_ptr == device.context.devices[0].int_ptr
    assert device.compute_units >= 1
    assert device.local_memory_bytes >= 16 * 1024
    assert device.max_allocation_bytes <= device.global_memory_bytes
    assert device.vector_width in devices.VECTOR_WIDTHS
    assert device.has_fp64 is ("cl_khr_fp64" in device.handle.extensions.split())
    assert str(device).startswith(device.name)
    assert devices.self_test(device.handle).ok


@pytest.mark.small
@pytest.mark.parametrize(
    ("habit", "fault", "reason"),
    [
        ("#pragma OPENCL FP_CONTRACT OFF", "#define x_times_y_plus_x", "without contraction"),
        ("x / y", "x * (1.0f / y)", "division"),
        ("sqrt(fabs(x))", "nextafter(sqrt(fabs(x)), 9.0f)", "sqrt"),
        ("select(x - y, y, less)", "select(y, x - y, less)", "select"),
        ("2654435761u", "2654435763u", "integer"),
        ("shared_sums[i] += other", "shared_sums[i] += other * (i != 31)", "prefix sum"),
        ("float16 x =", "float17 x =", "float17"),
    ],
)
def test_the_self_test_refuses_a_device_that_errs(
    device: devices.Device, monkeypatch: pytest.MonkeyPatch, habit: str, fault: str, reason: str
) -> None:
    """The fault is put into the program, as a wrong compiler would; the reason must name it."""
    source = testing.SELF_TEST_SOURCE
    assert habit in source
    source = source.replace(habit, fault)
    if habit.startswith("#pragma"):
        source = source.replace("x * y + x", "fma(x, y, x)")
    monkeypatch.setenv("CLRAST_CACHE_DIR", "off")
    monkeypatch.setattr(testing, "SELF_TEST_SOURCE", source)
    monkeypatch.setattr(testing, "_tested", {})
    result = testing.self_test(device.handle)
    assert not result.ok
    assert reason in result.reason
    assert "\n" not in result.reason


@pytest.mark.parametrize(
    ("script", "reason"), [("kill -SEGV $$", "crashes (signal 11)"), ("exec sleep 30", "does not finish within 1 s")]
)
def test_a_driver_that_crashes_or_hangs_takes_only_a_child_down(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, script: str, reason: str
) -> None:
    """A stand-in for the interpreter crashes or hangs as the driver would make it."""
    stand_in = tmp_path / "python"
    stand_in.write_text(f"#!/bin/sh\n{script}\n")
    stand_in.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(stand_in))
    monkeypatch.setattr(testing, "CHILD_SECONDS", 1)
    monkeypatch.setattr(testing, "_tested", {})
    monkeypatch.setenv("CLRAST_CACHE_DIR", str(tmp_path / "cache"))
    listed = devices.list_devices()[0]
    result = testing.self_test(listed.handle, listed.index)
    assert not result.ok
    assert reason in result.reason


def test_the_first_self_test_on_a_machine_leaves_a_mark(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(testing, "_tested", {})
    monkeypatch.setenv("CLRAST_CACHE_DIR", str(tmp_path))
    listed = devices.preferred(devices.list_devices())[0]
    assert testing.self_test(listed.handle, listed.index).ok
    assert len(list(tmp_path.glob("*.survived"))) == 1


def test_no_device_is_exit_69_with_a_mend(tmp_path: Path) -> None:
    code = """
        from clrast.errors import DeviceError
        from clrast.opencl.device import open_device
        try:
            open_device()
        except DeviceError as error:
            print(error.exit_code, error)
    """
    done = run_python(code, OCL_ICD_VENDORS=str(tmp_path))
    assert done.stdout.startswith("69 there is no OpenCL device: ")
    assert "apt-get install pocl-opencl-icd" in done.stdout


BUSY = """
    import resource, time
    from pathlib import Path
    from clrast.opencl import buffers, kernels
    from clrast.opencl.device import open_device
    def busy(threads):
        device = open_device({runtime!r}, threads)
        program = kernels.build(device, "spin.cl", folder=Path({folder!r}))
        out = buffers.create(device, 4 * 4096)
        program.launch("spin", 4096, 16, step_count=100, out=out).wait()
        begin, start = resource.getrusage(resource.RUSAGE_SELF), time.perf_counter()
        program.launch("spin", 4096, 16, step_count={steps}, out=out).wait()
        wall, end = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_SELF)
        return (end.ru_utime - begin.ru_utime) / wall
    print(*(busy(threads) for threads in {wishes}))
"""
SPIN = """
kernel void spin(const uint step_count, global float *restrict out)
{
    float a = (float)get_global_id(0);
    for (uint i = 0; i < step_count; i++) a = a * 0.999f + 1.0f;
    out[get_global_id(0)] = a;
}
"""


@pytest.mark.parametrize("wishes", [(1,), (2, 1), (2, 1, 2)])
def test_threads_hold(device: devices.Device, tmp_path: Path, wishes: tuple[int, ...]) -> None:
    """Processor time over wall time is at most the threads asked for, also when a process changes its wish.

    The bound is one-sided and half a thread wide: other programs can only take time away.
    """
    if device.runtime not in ("pocl", "rusticl"):
        pytest.skip(f"{device.runtime}: its threads are set by a variable that another process tests")
    (tmp_path / "spin.cl").write_text(SPIN)
    code = BUSY.format(runtime=device.runtime, folder=str(tmp_path), steps=100_000, wishes=wishes)
    done = run_python(code)
    assert done.returncode == 0, done.stderr
    shares = [float(word) for word in done.stdout.split()]
    for wish, share in zip(wishes, shares, strict=True):
        assert share < wish + 0.5


def test_a_runtime_that_cannot_change_its_threads_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(devices, "_first_threads", {})
    for wish in (2, 2, None):
        devices._check_threads("intel", wish)
    with pytest.raises(DeviceError, match="started on 2 threads in this process: ask for 1 in a new one"):
        devices._check_threads("intel", 1)
    devices._check_threads("pocl", 2)
    devices._check_threads("pocl", 1)


def test_known_faults_are_found_by_runtime_and_version() -> None:
    assert any("generic" in what for what in known.known_faults("pocl", "OpenCL 3.0 PoCL 3.0-rc2"))
    assert not any("generic" in what for what in known.known_faults("pocl", "OpenCL 3.0 PoCL 3.1+debian"))


@pytest.mark.small
@pytest.mark.parametrize("shape", [(0, 3), (1,), (7, 5)])
def test_buffers_keep_bytes(device: devices.Device, shape: tuple[int, ...]) -> None:
    array = np.arange(np.prod(shape), dtype=np.float32).reshape(shape) - 2.5
    buffer = buffers.upload(device, array)
    assert np.array_equal(buffers.download(device, buffer, np.float32, shape), array)
    buffers.write(device, buffer, array + 1)
    out = np.zeros_like(array)
    assert buffers.download(device, buffer, np.float32, shape, out=out) is out
    assert np.array_equal(out, array + 1)
    if array.size:
        buffers.fill(device, buffer, np.uint32(0xFFFFFFFF), array.nbytes)
        with buffers.mapped(device, buffer, np.uint32, shape) as view:
            assert (view == 0xFFFFFFFF).all()


def test_a_strided_view_is_uploaded_by_value(device: devices.Device) -> None:
    array = np.arange(24, dtype=np.uint32).reshape(4, 6)[::2, ::-1]
    assert np.array_equal(buffers.download(device, buffers.upload(device, array), np.uint32, (2, 6)), array)


def test_too_large_a_buffer_is_a_capacity_error_with_both_numbers(device: devices.Device) -> None:
    wanted = device.max_allocation_bytes + 1
    with pytest.raises(CapacityError, match=f"{device.max_allocation_bytes} .*{wanted}"):
        buffers.create(device, wanted)
