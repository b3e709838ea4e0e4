"""Kernels with a fault put in on purpose: a copy of cl/ with lines replaced, which a device then builds."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from clrast.opencl import kernels
from clrast.opencl.device import Device

MIDPOINT_LINE = "  return cross3(add(ra, rb), subtract(b, a));\n"
PLAIN = {("edge_function.clh", MIDPOINT_LINE): "  return cross3(add(ra, ra), rb);\n"}
"""Eq. (1) as it is printed, twice: a x b of vertices relative to the eye."""
CONTRACTED = {
    ("edge_function.clh", MIDPOINT_LINE): """  const Vec3 p = add(ra, ra), q = rb;
  Vec3 r = {fma(p.y, q.z, -(p.z * q.y)), fma(p.z, q.x, -(p.x * q.z)), fma(p.x, q.y, -(p.y * q.x))};
  return r;
"""
}
"""The same as compilers make it where they may contract: not antisymmetric, so that neighbours disagree."""


@contextmanager
def patched(device: Device, folder: Path, replacements: Mapping[tuple[str, str], str]) -> Iterator[Device]:
    """The device with kernels of its own.

    replacements : (file, text) -> the text in its place; one that is not there, or twice, is an error.
    """
    original = kernels.kernel_folder
    copy = folder / "cl"
    shutil.copytree(original(), copy)
    for (name, old), new in replacements.items():
        text = (copy / name).read_text("utf-8")
        assert text.count(old) == 1, f"{name} has the text {text.count(old)} times: {old!r}"
        (copy / name).write_text(text.replace(old, new), "utf-8")
    kernels.kernel_folder = lambda: copy  # type: ignore[assignment]
    try:
        yield replace(device, programs={})
    finally:
        kernels.kernel_folder = original  # type: ignore[assignment]
