"""layout.py as OpenCL C: constants become macros, numpy structs become C structs of the same bytes."""

from __future__ import annotations

import math

import numpy as np

C_NAMES = {
    "int8": "char",
    "uint8": "uchar",
    "int16": "short",
    "uint16": "ushort",
    "int32": "int",
    "uint32": "uint",
    "int64": "long",
    "uint64": "ulong",
    "float32": "float",
    "float64": "double",
}


def constants_source(constants: dict[str, int | float]) -> str:
    """One `#define` a line. Floats are float32 in hexadecimal, or double where given as numpy.float64."""
    return "".join(f"#define {name} {literal(value)}\n" for name, value in constants.items())


def literal(value: int | float) -> str:
    """A number as an OpenCL C literal that denotes exactly this int, or this float rounded to float32 once."""
    if isinstance(value, (int, np.integer)):
        return _integer(int(value))
    if isinstance(value, np.float64):
        text, suffix = float(value), ""
    else:
        text, suffix = float(np.float32(value)), "f"
    if math.isnan(text):
        raise ValueError("a shared constant is NaN")
    if math.isinf(text):
        return "INFINITY" if text > 0 else "(-INFINITY)"
    written = text.hex() + suffix
    return f"({written})" if text < 0 else written


def _integer(value: int) -> str:
    if not -(2**63) < value < 2**64:
        raise ValueError(f"a shared constant does not fit 64 bits: {value}")
    if -(2**31) < value < 2**31:
        return f"({value})" if value < 0 else str(value)
    if 0 < value < 2**32:
        return f"{value}u"
    return f"({value}l)" if value < 0 else f"{value}{'l' if value < 2**63 else 'ul'}"


def structs_source(structs: dict[str, np.dtype]) -> str:
    """A typedef per struct, each with a check by the device's compiler that its size is numpy's.

    A field of 4 elements is a vector (`float4`, `uint4`), any other sub-array an array, a nested struct
    must be listed before. A dtype has no padding, so an equal size means equal offsets.
    """
    parts = []
    for name, dtype in structs.items():
        earlier = dict(list(structs.items())[: list(structs).index(name)])
        fields = "".join(f"    {_field(name, dtype, field, earlier)};\n" for field in dtype.names or ())
        parts.append(
            f"typedef struct {{\n{fields}}} {name};\n"
            f"typedef char {name}_has_the_size_of_its_dtype[sizeof({name}) == {dtype.itemsize} ? 1 : -1];\n"
        )
    return "".join(parts)


def _field(struct: str, dtype: np.dtype, field: str, structs: dict[str, np.dtype]) -> str:
    assert dtype.fields is not None and dtype.names is not None
    kind, offset = dtype.fields[field][:2]
    element, shape = kind.subdtype or (kind, ())
    before = [dtype.fields[n] for n in dtype.names[: dtype.names.index(field)]]
    if offset != sum(f[0].itemsize for f in before):
        raise ValueError(f"struct {struct}: padding before field {field}: order the fields large to small")
    nested = [name for name, other in structs.items() if element == other]
    if element.fields is not None:
        if not nested:
            raise ValueError(f"struct {struct}: field {field} has a struct type that is not listed before it")
        c_name = nested[0]
    else:
        c_name = C_NAMES[element.name]
        if shape == (4,):
            return f"{c_name}4 {field}"
    return f"{c_name} {field}" + "".join(f"[{n}]" for n in shape)
