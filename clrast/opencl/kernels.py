"""Programs: found, put together with the shared layout, built once, launched with arguments by name."""

from __future__ import annotations

import re
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clrast.errors import DeviceError
from clrast.opencl import layout
from clrast.opencl.binaries import BuildError, build_options, build_source
from clrast.opencl.c_layout import constants_source, structs_source
from clrast.opencl.features import Edges, Features, Precision, Projection
from clrast.opencl.runtimes import quiet_stderr

if TYPE_CHECKING:
    import pyopencl as cl

    from clrast.opencl.device import Device

__all__ = ["Features", "Precision", "Projection", "Program", "build", "source_text"]

_SCALARS = {
    "char": np.int8,
    "uchar": np.uint8,
    "unsigned char": np.uint8,
    "short": np.int16,
    "ushort": np.uint16,
    "unsigned short": np.uint16,
    "int": np.int32,
    "uint": np.uint32,
    "unsigned int": np.uint32,
    "long": np.int64,
    "ulong": np.uint64,
    "unsigned long": np.uint64,
    "float": np.float32,
    "double": np.float64,
}


def kernel_folder() -> Path:
    """The folder of the OpenCL C files: inside the package (a wheel), else beside it (a checkout)."""
    package = Path(__file__).resolve().parents[1]
    for folder in (package / "cl", package.parent / "cl"):
        if folder.is_dir():
            return folder
    raise DeviceError(f"the kernels are missing: no folder 'cl' in or beside {package}: install clrast again")


_INCLUDE = re.compile(r'^[ \t]*#[ \t]*include[ \t]+"([^"\n]+)"[ \t]*(?://.*)?$')


def source_text(name: str, folder: Path | None = None) -> str:
    """The whole text of a program: shared constants and structs, then the file with its includes put in.

    Contraction is off in all of it, so that no file can forget to say so. Includes are resolved here and
    not by -I: paths may hold spaces, and the caches of binaries look at the text alone. Each header is put
    in once, at its first mention.
    """
    folder = folder or kernel_folder()
    lines: list[str] = []
    _inline(name, folder, lines, set(), ())
    head = constants_source(layout.CONSTANTS) + structs_source(layout.STRUCTS)
    return "#pragma OPENCL FP_CONTRACT OFF\n" + head + "\n".join(lines) + "\n"


def _inline(name: str, folder: Path, lines: list[str], seen: set[str], chain: tuple[str, ...]) -> None:
    if name in chain:
        raise DeviceError(f"{folder / name}: includes itself by way of {' -> '.join(chain)}")
    if name in seen:
        return
    seen.add(name)
    try:
        text = (folder / name).read_text("utf-8")
    except OSError as error:
        where = f", included from {chain[-1]}" if chain else ""
        raise DeviceError(f"{folder / name}: cannot be read{where}: install clrast again") from error
    lines.append(f'#line 1 "{name}"')
    for number, line in enumerate(text.splitlines(), start=1):
        match = _INCLUDE.match(line)
        if match:
            _inline(match[1], folder, lines, seen, (*chain, name))
            lines.append(f'#line {number + 1} "{name}"')
        else:
            lines.append(line)


@dataclass
class Argument:
    """One argument of a kernel, and the value that it was last set to where that saves a call."""

    name: str
    type_name: str
    is_pointer: bool
    is_local: bool
    dtype: np.dtype | None  # of scalars and structs
    last: Any = None


@dataclass
class _Kernel:
    handle: Any
    arguments: list[Argument]
    names: frozenset[str]
    compiles_at_launch: bool  # not launched yet, by a runtime that compiles then, and talks meanwhile


class Program:
    """A built program; `launch` runs its kernels. Kernel objects are made once and kept."""

    def __init__(self, device: Device, name: str, source: str, handle: Any) -> None:
        self.device = device
        self.name = name
        self.source = source
        self.handle = handle
        self._kernels: dict[str, _Kernel] = {}

    def launch(
        self,
        kernel: str,
        global_size: int | tuple[int, ...],
        local_size: int | tuple[int, ...] | None = None,
        **arguments: Any,
    ) -> cl.Event:
        """Enqueue a kernel and return its event; every argument is given by its name in the kernel.

        Buffers for `global` and `constant` pointers (None for a null pointer), a byte count for `local`
        pointers, numbers for scalars, numpy structured scalars for structs.
        """
        import pyopencl as cl

        entry = self._kernels.get(kernel) or self._prepare(kernel)
        if arguments.keys() != entry.names:
            raise TypeError(self._wrong_names(kernel, entry, arguments))
        handle = entry.handle
        for i, argument in enumerate(entry.arguments):
            value = arguments[argument.name]
            if argument.dtype is not None:
                if value is not argument.last:
                    handle._set_arg_buf(i, _scalar(argument, value, kernel))
                    argument.last = value if isinstance(value, (int, float, np.number)) else None
            elif argument.is_local:
                handle.set_arg(i, cl.LocalMemory(int(value)))
            else:
                handle.set_arg(i, value)
        sizes = (global_size,) if isinstance(global_size, int) else tuple(global_size)
        locals_ = (local_size,) if isinstance(local_size, int) else local_size
        if entry.compiles_at_launch:
            entry.compiles_at_launch = False
            with quiet_stderr():
                event = cl.enqueue_nd_range_kernel(self.device.queue, handle, sizes, locals_)
                event.wait()
            return event
        return cl.enqueue_nd_range_kernel(self.device.queue, handle, sizes, locals_)

    def arguments(self, kernel: str) -> list[Argument]:
        """The kernel's arguments, in their order."""
        return (self._kernels.get(kernel) or self._prepare(kernel)).arguments

    def _wrong_names(self, kernel: str, entry: _Kernel, given: dict[str, Any]) -> str:
        missing = [a.name for a in entry.arguments if a.name not in given]
        unknown = [name for name in given if name not in entry.names]
        parts = [f"missing {', '.join(missing)}"] * bool(missing) + [f"unknown {', '.join(unknown)}"] * bool(unknown)
        return f"{self.name}: kernel {kernel}: arguments {'; '.join(parts)}"

    def _prepare(self, kernel: str) -> _Kernel:
        import pyopencl as cl

        try:
            handle = cl.Kernel(self.handle, kernel)
        except cl.Error as error:
            raise DeviceError(f"{self.name}: no kernel {kernel}: {error}") from error
        try:
            arguments = [_from_runtime(cl, handle, i) for i in range(handle.num_args)]
        except cl.Error:
            arguments = arguments_from_source(self.source, kernel)
        if len(arguments) != handle.num_args or not all(a.name for a in arguments):
            arguments = arguments_from_source(self.source, kernel)
        entry = _Kernel(handle, arguments, frozenset(a.name for a in arguments), self.device.runtime == "rusticl")
        self._kernels[kernel] = entry
        return entry


def _scalar(argument: Argument, value: Any, kernel: str) -> bytes:
    dtype = argument.dtype
    assert dtype is not None
    if dtype.fields is not None:
        if getattr(value, "dtype", None) != dtype or value.shape not in ((), (1,)):
            raise TypeError(f"kernel {kernel}: {argument.name} takes one {argument.type_name} of layout.py")
        return value.tobytes()
    if dtype.kind in "iu" and int(value) != value:
        raise TypeError(f"kernel {kernel}: {argument.name} takes an integer, not {value!r}")
    return np.array(value, dtype).tobytes()


def _from_runtime(cl: Any, handle: Any, i: int) -> Argument:
    info = cl.kernel_arg_info
    where = handle.get_arg_info(i, info.ADDRESS_QUALIFIER)
    is_local = where == cl.kernel_arg_address_qualifier.LOCAL
    return _argument(
        handle.get_arg_info(i, info.NAME),
        handle.get_arg_info(i, info.TYPE_NAME),
        where != cl.kernel_arg_address_qualifier.PRIVATE,
        is_local,
    )


def _argument(name: str, type_name: str, is_pointer: bool, is_local: bool) -> Argument:
    dtype: np.dtype[Any] | None = None
    if not is_pointer:
        base = type_name.strip().removeprefix("struct ")
        if base in layout.STRUCTS:
            dtype = layout.STRUCTS[base]
        elif base in _SCALARS:
            dtype = np.dtype(_SCALARS[base])
        else:
            raise DeviceError(f"kernel argument {name}: type {type_name} is neither a scalar nor a struct of layout.py")
    return Argument(name, type_name, is_pointer, is_local, dtype)


def arguments_from_source(source: str, kernel: str) -> list[Argument]:
    """The arguments as written, for runtimes that do not tell them."""
    text = re.sub(r"/\*.*?\*/|//[^\n]*", " ", source, flags=re.DOTALL)
    match = re.search(rf"\bkernel\b[^;{{(]*(?:\([^)]*\)\)\s*)?[^;{{(]*\b{re.escape(kernel)}\s*\(([^)]*)\)", text)
    if not match:
        raise DeviceError(f"kernel {kernel}: its arguments cannot be read from the source")
    found = []
    for part in match[1].split(","):
        words = re.findall(r"\w+", part)
        qualifiers = {w.strip("_") for w in words[:-1]}
        kept = [w for w in words[:-1] if w.strip("_") not in ("global", "constant", "local", "const", "restrict")]
        found.append(_argument(words[-1], " ".join(kept), "*" in part, "local" in qualifiers))
    return found


SCALAR_PROGRAMS = ("prepare_triangles.cl", "settle_contenders.cl", "share_shading.cl", "stratify_samples.cl")
"""Programs whose work-items are the lanes: vectors have one lane there, and edges are 3D, whatever decides samples."""

SHADE_PROGRAMS = ("shade_hits.cl",)
"""Programs that evaluate what was found visible: their edges are 3D, each rung above `ordered` has the edge normals of
`midpoint`, and sums along rows are of visibility alone."""

MASKED = ("alpha_mask", "alpha_blend", "textures", "vertex_colors")

RAY_PROGRAMS = ("trace_rays.cl", "trace_list.cl", "pack_leaves.cl", "leave_hits.cl")
"""Programs for rays of no camera: always exact, each ray a perspective sample of its own. They read the vector width,
float64, the order of triangles, the stack's capacity and what decides whether rays pass surfaces; what else views are
made of leaves them as they are."""

UNMASKED_PROGRAMS = ("trace_list.cl",)
"""Of RAY_PROGRAMS those that know no surfaces: they serve scenes where no ray passes one."""

PATH_PROGRAMS = ("shade_paths.cl",)
"""Programs that look surfaces up for paths and let rays leave them: as exact as RAY_PROGRAMS, with all
that surfaces are made of, unfiltered."""


def build(device: Device, name: str, features: Features | None = None, folder: Path | None = None) -> Program:
    """The program of `cl/<name>` for this device, built at most once for the features that it reads.

    folder : where the file is, in place of the package's own kernels.
    """
    source = _source_once(device, name, folder)
    features = features or Features(vector_width=device.vector_width)
    if name in SCALAR_PROGRAMS:
        features = replace(features, vector_width=1, edges=Edges.SPATIAL)
    if name in SHADE_PROGRAMS:
        rung = min(features.precision, Precision.MIDPOINT)
        features = replace(features, edges=Edges.SPATIAL, precision=rung, evaluation=0)
    if name in RAY_PROGRAMS:
        width, stack = features.vector_width, features.stack_capacity
        read = ("prefetch", "leaf_order", *(() if name in UNMASKED_PROGRAMS else ("indirect", *MASKED)))
        kept = {feature: getattr(features, feature) for feature in read}
        features = Features(width, precision=Precision.EXACT, float64=features.float64, stack_capacity=stack, **kept)
    if name in PATH_PROGRAMS:
        features = replace(features, precision=Precision.EXACT, projection=Projection.PERSPECTIVE, edges=Edges.SPATIAL,
                           evaluation=0, indirect=True)  # fmt: skip
    defines = features.defines(source)
    key = (name, source, defines)
    program = device.programs.get(key)
    if program is None:
        options = build_options(device.handle, defines)
        try:
            handle = build_source(device.context, device.handle, source, options)
        except BuildError as error:
            raise DeviceError(_build_failure(device, name, source, options, error)) from error
        program = device.programs[key] = Program(device, name, source, handle)
    return program


def _source_once(device: Device, name: str, folder: Path | None) -> str:
    """The text of a program, read once per opened device."""
    key = ("source", name, folder)
    if key not in device.programs:
        device.programs[key] = source_text(name, folder)
    return device.programs[key]


def _build_failure(device: Device, name: str, source: str, options: str, error: Exception) -> str:
    file = tempfile.NamedTemporaryFile("w", prefix="clrast-", suffix=f"-{name}", delete=False, encoding="utf-8")
    with file:
        file.write(f"// {options}\n{source}")
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    telling = [line for line in lines if "error" in line.lower()][:3] or lines[:3]
    return f"{name} does not build on {device.name}: {' | '.join(telling)[:600]} (program: {file.name})"
