"""Source text to a built pyopencl program, by way of a cache of binaries between runs."""

from __future__ import annotations

import functools
import hashlib
import os
import platform
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from clrast.opencl.runtimes import quiet_stderr

BINARY_RUNTIMES = ("portable computing language", "intel")
"""Platforms whose program binaries load faster than they build and carry what a launch needs (measured
on PoCL 3.1: 1 ms against 20 to 35 ms from PoCL's own cache of sources)."""

MOST_BINARIES = 300
"""Files in the cache; a program takes 60 to 300 KB."""


wishes: list[Callable[[str, str, str], None]] = []
"""Each takes source, options and the file's name of a program whose binary is not in the cache."""

DIGEST_BYTES = 32
"""A SHA-256 stands in front of every stored binary."""


def build_options(handle: Any, defines: tuple[str, ...] = ()) -> str:
    """The options of every build on a pyopencl device."""
    import pyopencl as cl

    options = ["-cl-std=CL1.2", "-cl-kernel-arg-info"]
    if handle.single_fp_config & cl.device_fp_config.CORRECTLY_ROUNDED_DIVIDE_SQRT:
        options.append("-cl-fp32-correctly-rounded-divide-sqrt")
    return " ".join([*options, *defines])


def cache_folder() -> Path | None:
    """Where built programs are kept between runs; CLRAST_CACHE_DIR overrides, "off" switches it off."""
    chosen = os.environ.get("CLRAST_CACHE_DIR")
    if chosen == "off":
        return None
    if chosen:
        return Path(chosen)
    home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    return Path(home) / "clrast"


def build_source(context: Any, handle: Any, source: str, options: str) -> Any:
    """A built pyopencl program from source text, or from the cache of binaries.

    A binary that is not there yet is wished for; see binary_maker.py.
    """
    import pyopencl as cl

    path = _binary_path(handle, source, options)
    if path is not None and path.is_file():
        try:
            program = _raw_build(cl._cl._Program(context, [handle], [_checked(path.read_bytes())]), options)
            os.utime(path)  # `_save_binary` removes those that were not used for longest
            return program
        except Exception:  # a stale or broken binary: build from source and write it anew
            path.unlink(missing_ok=True)
    program = _raw_build(cl._cl._Program(context, source), options)
    if path is not None:
        for wish in wishes:
            wish(source, options, path.name)
    return program


def _checked(stored: bytes) -> bytes:
    """The binary behind its SHA-256: PoCL crashes on a damaged one. Raises ValueError where they disagree."""
    digest, binary = stored[:DIGEST_BYTES], stored[DIGEST_BYTES:]
    if hashlib.sha256(binary).digest() != digest:
        raise ValueError("damaged")
    return binary


def _raw_build(program: Any, options: str) -> Any:
    """Build as pyopencl's Program.build does, without its include path (spaces!) and its second cache."""
    import pyopencl as cl

    try:
        with quiet_stderr():
            program._build(options=options.encode(), devices=None)
    except cl.Error as error:
        log = "\n".join(program.get_build_info(d, cl.program_build_info.LOG) for d in _devices(program))
        raise BuildError(f"{log}\n{error}") from error
    return program


def _devices(program: Any) -> list[Any]:
    import pyopencl as cl

    return program.get_info(cl.program_info.DEVICES)


class BuildError(Exception):
    """The compiler's log and then pyopencl's words; `build` makes a DeviceError of it."""


def _binary_path(handle: Any, source: str, options: str) -> Path | None:
    folder = cache_folder()
    if folder is None or not any(word in handle.platform.name.lower() for word in BINARY_RUNTIMES):
        return None
    return folder / f"{fingerprint(handle, options, source)}.bin"


def fingerprint(handle: Any, *texts: str) -> str:
    """40 hexadecimal digits that change with the driver, the device, this machine's processor, or a text."""
    facts = (handle.platform.version, handle.driver_version, handle.name, _processor())
    return hashlib.sha256("\0".join((*facts, *texts)).encode()).hexdigest()[:40]


@functools.cache
def _processor() -> str:
    """Name and instruction sets of the processor: a home folder may move to another machine."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
            first = file.read(8192).split("\n\n")[0]
    except OSError:
        return platform.processor()
    return "\n".join(line for line in first.splitlines() if line.startswith(("model name", "flags", "Features", "CPU")))


def make_binary(handle: Any, source: str, options: str, file_name: str) -> bool:
    """Build a program for a pyopencl device and keep its binary, if it is the one that belongs under this name."""
    import pyopencl as cl

    path = _binary_path(handle, source, options)
    if path is None or path.name != file_name:
        return False
    if not path.is_file():
        _save_binary(path, _raw_build(cl._cl._Program(cl.Context([handle]), source), options))
    return True


def _save_binary(path: Path, program: Any) -> None:
    """Write the binary whole or not at all; a cache that cannot be written is no error."""
    import pyopencl as cl

    try:
        binary = program.get_info(cl.program_info.BINARIES)[0]
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
            try:
                file.write(hashlib.sha256(binary).digest() + binary)
                file.flush()
                os.replace(file.name, path)
            except OSError:
                os.unlink(file.name)
                raise
        kept = sorted(path.parent.glob("*.bin"), key=lambda p: p.stat().st_mtime)
        for old in kept[:-MOST_BINARIES]:
            old.unlink()
    except (OSError, cl.Error, IndexError):
        pass
