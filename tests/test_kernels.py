"""Programs: includes, the cache of binaries, failures that explain themselves, launches by name."""

from __future__ import annotations

import re
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clrast.errors import DeviceError
from clrast.opencl import buffers, kernels, layout
from clrast.opencl.binary_maker import kept_binaries
from clrast.opencl.device import Device

FILL = """
kernel void fill(
    const uint count,
    const int shift,
    const float gain,
    const View view,
    global const float *restrict input,
    local float *scratch,
    global float *restrict out)
{
    uint i = get_global_id(0);
    if (i >= count) return;
    scratch[get_local_id(0)] = input[i] * gain;
    out[i] = scratch[get_local_id(0)] + view.focal + (float)shift;
}
"""


def write(folder: Path, **files: str) -> Path:
    folder.mkdir(exist_ok=True)
    for name, text in files.items():
        (folder / name.replace("_cl", ".cl")).write_text(text)
    return folder


def test_includes_are_put_in_once_and_lines_keep_their_numbers(tmp_path: Path) -> None:
    write(
        tmp_path,
        a_cl='#include "b.clh"\n#include "c.clh" // why\nint a;\n',
        b_clh='#include "c.clh"\nint b;\n',
        c_clh="int c;\n",
    )
    text = kernels.source_text("a.cl", tmp_path)
    body = text[text.index("#line") :].splitlines()
    numbered = {}
    number, name = 0, ""
    for line in body:
        if line.startswith("#line"):
            _, first, name = line.split()
            number = int(first)
            continue
        numbered.setdefault(line, []).append((name.strip('"'), number))
        number += 1
    assert numbered == {"int c;": [("c.clh", 1)], "int b;": [("b.clh", 2)], "int a;": [("a.cl", 3)]}


def test_an_include_cycle_and_a_missing_file_are_named(tmp_path: Path) -> None:
    write(tmp_path, a_cl='#include "b.clh"\n', b_clh='#include "a.cl"\n', d_cl='#include "no.clh"\n')
    with pytest.raises(DeviceError, match=r"a.cl: includes itself by way of a.cl -> b.clh"):
        kernels.source_text("a.cl", tmp_path)
    with pytest.raises(DeviceError, match=r"no.clh: cannot be read, included from d.cl"):
        kernels.source_text("d.cl", tmp_path)


@pytest.mark.small
def test_a_changed_header_changes_the_program_in_a_path_with_spaces(
    device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CLRAST_CACHE_DIR", str(tmp_path / "a cache"))
    main = '#include "value.clh"\nkernel void set(global int *out) { out[0] = VALUE; }\n'
    out = buffers.create(device, 4)
    got = []
    for k in (1, 2, 1):
        folder = write(tmp_path / "with spaces", a_cl=main, value_clh=f"#define VALUE {k}\n")
        kernels.build(replace(device, programs={}), "a.cl", folder=folder).launch("set", 1, 1, out=out)
        got.append(int(buffers.download(device, out, np.int32, 1)[0]))
    assert got == [1, 2, 1]


@pytest.mark.small
def test_a_broken_binary_in_the_cache_is_replaced(
    device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cache = tmp_path / "cache"
    monkeypatch.setenv("CLRAST_CACHE_DIR", str(cache))
    monkeypatch.setenv("CLRAST_KEEP_BINARIES", "on")
    main = "kernel void set(global int *out) { out[0] = 7; }\n"
    with kept_binaries():
        kernels.build(device, "a.cl", folder=write(tmp_path / "first", a_cl=main))
    files = list(cache.glob("*.bin"))
    assert len(files) == (1 if device.runtime in ("pocl", "intel") else 0)
    for damage in (lambda whole: b"no program", lambda whole: whole[:-10], lambda whole: whole[:-1] + b"?"):
        for file in files:
            file.write_bytes(damage(file.read_bytes()))
        out = buffers.create(device, 4)
        with kept_binaries():
            program = kernels.build(replace(device, programs={}), "a.cl", folder=tmp_path / "first")
            program.launch("set", 1, 1, out=out)
        assert buffers.download(device, out, np.int32, 1).tolist() == [7]
        for file in files:
            assert len(file.read_bytes()) > 100


def test_binaries_are_made_where_they_are_asked_for_alone(
    first_device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cache = tmp_path / "cache"
    monkeypatch.setenv("CLRAST_CACHE_DIR", str(cache))
    monkeypatch.setenv("CLRAST_KEEP_BINARIES", "on")
    folder = write(tmp_path / "programs", a_cl="kernel void set(global int *out) { out[0] = 7; }\n")
    kernels.build(replace(first_device, programs={}), "a.cl", folder=folder)
    monkeypatch.setenv("CLRAST_KEEP_BINARIES", "off")
    with kept_binaries():
        kernels.build(replace(first_device, programs={}), "a.cl", folder=folder)
    monkeypatch.setenv("CLRAST_KEEP_BINARIES", "on")
    assert not list(cache.glob("*.bin"))
    with pytest.raises(ZeroDivisionError), kept_binaries() as maker:
        kernels.build(replace(first_device, programs={}), "a.cl", folder=folder)
        1 // 0
    assert not maker.is_busy
    with kept_binaries() as maker:
        maker.ask("kernel void wrong(", "", "no-such-program.bin")
        kernels.build(replace(first_device, programs={}), "a.cl", folder=folder)
    assert not maker.is_busy
    assert len(list(cache.iterdir())) == (1 if first_device.runtime in ("pocl", "intel") else 0)


@pytest.mark.small
def test_a_build_failure_says_what_where_and_keeps_the_program(device: Device, tmp_path: Path) -> None:
    write(tmp_path, a_cl="\n\nkernel void set(global int *out) { out[0] = nowhere; }\n")
    with pytest.raises(DeviceError, match="a.cl does not build on .*nowhere") as caught:
        kernels.build(device, "a.cl", folder=tmp_path)
    message = str(caught.value)
    assert "\n" not in message
    if device.runtime != "oclgrind":  # which numbers the lines of the whole text
        assert "a.cl:3:" in message
    dumped = Path(message[message.index("(program: ") :].removeprefix("(program: ").removesuffix(")"))
    assert "nowhere" in dumped.read_text()
    dumped.unlink()


@pytest.fixture
def fill(device: Device, tmp_path: Path) -> kernels.Program:
    return kernels.build(device, "fill.cl", folder=write(tmp_path, fill_cl=FILL))


@pytest.mark.small
def test_launch_by_name_in_any_order_with_conversions(device: Device, fill: kernels.Program) -> None:
    values = np.arange(100, dtype=np.float32)
    view = np.zeros((), layout.VIEW)
    view["focal"] = 0.25
    given = dict(input=buffers.upload(device, values), out=buffers.create(device, 400), scratch=4 * 32)
    for count, shift, gain in ((100, -3, 2), (np.int64(50), np.uint8(4), np.float64(0.5)), (50, 4.0, 0.5)):
        event = fill.launch("fill", (128,), 32, view=view, gain=gain, count=count, shift=shift, **given)
        event.wait()
        got = buffers.download(device, given["out"], np.float32, int(count))
        assert np.array_equal(got, values[: int(count)] * np.float32(gain) + np.float32(0.25) + np.float32(shift))
        view["focal"] = 0.25  # the same object again: structs are copied at each launch
    view["focal"] = 8.0
    fill.launch("fill", 128, 32, view=view, gain=0.5, count=1, shift=0, **given).wait()
    assert buffers.download(device, given["out"], np.float32, 1).tolist() == [8.0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"gain": None}, "missing gain"),
        ({"gian": 1.0}, "unknown gian"),
        ({"count": 1.5}, "count takes an integer"),
        ({"view": np.zeros((), layout.LIGHT)}, "view takes one View"),
        ({"view": np.zeros(2, layout.VIEW)}, "view takes one View"),
    ],
)
def test_wrong_arguments_are_named(device: Device, fill: kernels.Program, change: dict, message: str) -> None:
    given = dict(count=1, shift=0, gain=1.0, view=np.zeros((), layout.VIEW), input=None, scratch=128, out=None)
    given |= change
    given = {k: v for k, v in given.items() if v is not None or k in ("input", "out")}
    with pytest.raises(TypeError, match=message):
        fill.launch("fill", 32, 32, **given)


@pytest.mark.parametrize("value", [-1, 2**32])
def test_a_count_out_of_range_is_refused(fill: kernels.Program, value: int) -> None:
    given = dict(shift=0, gain=1.0, view=np.zeros((), layout.VIEW), input=None, scratch=128, out=None)
    with pytest.raises((OverflowError, TypeError)):
        fill.launch("fill", 32, 32, count=value, **given)


@pytest.mark.small
def test_drivers_keep_off_stderr(device: Device, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Errors are one line on stderr, and they are ours; the guard makes Mesa's compiler talk."""
    text = FILL.replace("fill", f"fill_{time.time_ns()}")  # in no cache
    name = re.search(r"fill_\w+", text)[0]
    program = kernels.build(device, "a.cl", folder=write(tmp_path, a_cl=text))
    given = dict(shift=0, gain=1.0, view=np.zeros((), layout.VIEW), scratch=128, count=0)
    given |= dict(input=buffers.create(device, 128), out=buffers.create(device, 128))
    program.launch(name, 32, 32, **given).wait()
    write(tmp_path, b_cl="kernel void broken(global int *out) { out[0] = nowhere; }\n")
    with pytest.raises(DeviceError):
        kernels.build(device, "b.cl", folder=tmp_path)
    assert capfd.readouterr().err == ""


def test_an_unknown_kernel_is_named(fill: kernels.Program) -> None:
    with pytest.raises(DeviceError, match="fill.cl: no kernel fall"):
        fill.launch("fall", 1)


def test_arguments_read_from_the_source_are_those_of_the_runtime(fill: kernels.Program) -> None:
    fill.launch(
        "fill", 32, 32, count=0, shift=0, gain=1, view=np.zeros((), layout.VIEW), input=None, scratch=128, out=None
    )
    told = fill.arguments("fill")
    read = kernels.arguments_from_source(fill.source, "fill")
    assert [(a.name, a.is_pointer, a.is_local, a.dtype) for a in read] == [
        (a.name, a.is_pointer, a.is_local, a.dtype) for a in told
    ]
