"""The shared layout: dtypes and C structs agree, programs build for the features in use, imports point one way."""

from __future__ import annotations

import ast
import itertools
import math
import re
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from clrast.opencl import buffers, c_layout, kernels, layout
from clrast.opencl.device import VECTOR_WIDTHS, Device
from clrast.opencl.features import Edges, Features, Precision, Projection
from clrast.opencl.runtimes import PREFETCHING
from clrast.visibility.methods import EVALUATIONS
from clrast.visibility.oracles import ORACLES

PACKAGE = Path(kernels.__file__).resolve().parents[1]
PROGRAMS = sorted(path.name for path in kernels.kernel_folder().glob("*.cl"))


# --- structs and constants -------------------------------------------------------------------------


@pytest.mark.parametrize("name", layout.STRUCTS)
def test_structs_have_no_padding(name: str) -> None:
    dtype = layout.STRUCTS[name]
    assert dtype.fields is not None
    assert dtype.itemsize == sum(field[0].itemsize for field in dtype.fields.values())


@pytest.mark.small
@pytest.mark.parametrize("name", layout.STRUCTS)
def test_the_device_sees_each_field_where_numpy_puts_it(device: Device, name: str, tmp_path: Path) -> None:
    dtype = layout.STRUCTS[name]
    assert dtype.names is not None and dtype.fields is not None
    lines = "".join(
        f"    offsets[{i}] = (uint)((global uchar *)&records[0].{field} - (global uchar *)records);\n"
        for i, field in enumerate(dtype.names)
    )
    (tmp_path / "offsets.cl").write_text(
        f"kernel void write_offsets(global {name} *records, global uint *offsets)\n{{\n{lines}"
        f"    offsets[{len(dtype.names)}] = sizeof({name});\n}}\n"
    )
    program = kernels.build(device, "offsets.cl", folder=tmp_path)
    count = len(dtype.names) + 1
    out = buffers.create(device, 4 * count)
    records = buffers.upload(device, np.zeros(1, dtype))
    program.launch("write_offsets", 1, 1, records=records, offsets=out)
    expected = [dtype.fields[field][1] for field in dtype.names] + [dtype.itemsize]
    assert buffers.download(device, out, np.uint32, count).tolist() == expected


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (5, "5"),
        (-5, "(-5)"),
        (2**31 - 1, "2147483647"),
        (2**31, "2147483648u"),
        (0xFFFFFFFF, "4294967295u"),
        (2**32, "4294967296l"),
        (2**64 - 1, "18446744073709551615ul"),
        (1.5, "0x1.8000000000000p+0f"),
        (-0.5, "(-0x1.0000000000000p-1f)"),
        (0.1, "0x1.99999a0000000p-4f"),  # float32 nearest to 0.1
        (np.float64(0.1), "0x1.999999999999ap-4"),
        (math.inf, "INFINITY"),
    ],
)
def test_literals(value: float, text: str) -> None:
    assert c_layout.literal(value) == text


def test_a_constant_of_nan_is_refused() -> None:
    with pytest.raises(ValueError, match="NaN"):
        c_layout.literal(math.nan)


def test_a_struct_with_padding_is_refused() -> None:
    padded = np.dtype([("small", "<u1"), ("large", "<f4")], align=True)
    with pytest.raises(ValueError, match="padding before field large"):
        c_layout.structs_source({"Padded": padded})


def test_enumerations_have_the_numbers_that_kernels_compare_with() -> None:
    for member in (*Precision, *Projection):
        name = f"{type(member).__name__.upper()}_{member.name}"
        assert layout.CONSTANTS.get(name, member.value) == member.value
    known = {f"{kind.__name__.upper()}_{m.name}" for kind in (Precision, Projection) for m in kind}
    assert {n for n in layout.CONSTANTS if n.startswith(("PRECISION_", "PROJECTION_"))} <= known
    assert list(Edges) == [layout.EDGES_3D, layout.EDGES_2D, layout.EDGES_2DH, layout.EDGES_BARYCENTRIC]
    assert list(EVALUATIONS.values()) == [layout.EVALUATION_DIRECT, layout.EVALUATION_INCREMENTAL]


# --- features --------------------------------------------------------------------------------------


def values_in_use(name: str) -> list:
    """Every value of a feature that a program may be built for today."""
    default = getattr(Features(), name)
    if name == "vector_width":
        return list(VECTOR_WIDTHS)
    if name == "tile_log2":
        return [2, 5, 8]
    if name in ORACLES:
        return [number for number, _ in ORACLES[name].settings.values()]
    if name == "evaluation":
        return list(EVALUATIONS.values())
    if isinstance(default, bool):
        return [False, True]
    if isinstance(default, Edges):
        return list(Edges)
    if isinstance(default, (Precision, Projection)):
        prefix = type(default).__name__.upper()
        return [m for m in type(default) if f"{prefix}_{m.name}" in layout.CONSTANTS]
    return [default]


MOST_COMBINATIONS = 300
"""Of one program; where its features have more, all values of every two of them are combined, the others default."""


def values_that_are_read(source: str, device: Device) -> dict[str, list]:
    """The features that a program of that text reads, with all values that each may have on the device."""
    defines = " ".join(Features().defines(source))
    values = {f.name: values_in_use(f.name) for f in fields(Features) if f"-D {f.name.upper()}=" in defines}
    if "prefetch" in values and device.runtime not in PREFETCHING:
        values["prefetch"] = [False]  # never asked for there: see runtimes.py
    if "float64" in values and not device.has_fp64:
        values["float64"] = [False]
    return values


def combinations_in_use(source: str, device: Device) -> list[Features]:
    """The features that a program of that text may be built for, as far as that can be done in minutes."""
    values = values_that_are_read(source, device)
    together = [tuple(values)] if math.prod(map(len, values.values())) <= MOST_COMBINATIONS else []
    made = {
        Features(**dict(zip(names, chosen, strict=True)))
        for names in together or itertools.combinations(values, 2)
        for chosen in itertools.product(*(values[name] for name in names))
    }
    return sorted(made, key=lambda features: features.defines())


def test_defines_cover_every_field_once() -> None:
    names = [f.name.upper() for f in fields(Features)]
    assert [d.removeprefix("-D ").split("=")[0] for d in Features().defines()] == names
    assert "-D COUNTERS=1" in Features(counters=True).defines()
    assert "-D PRECISION=2" in Features(precision=Precision.MIDPOINT).defines()


def test_a_program_is_rebuilt_only_for_a_feature_that_it_reads(device: Device, tmp_path: Path) -> None:
    (tmp_path / "reads.cl").write_text("kernel void set(global uint *out) { out[0] = TILE_LOG2; }\n")
    build = lambda **change: kernels.build(device, "reads.cl", Features(**change), folder=tmp_path)  # noqa: E731
    first = build()
    assert build(counters=True) is first
    assert build(tile_log2=4) is not first


@pytest.mark.parametrize("name", PROGRAMS)
def test_contraction_is_off_from_the_first_line_of_a_program(name: str) -> None:
    assert kernels.source_text(name).startswith("#pragma OPENCL FP_CONTRACT OFF\n")


BUILDS = 6
"""Of each program: no feature has more values."""
SWITCHED_ON = list(itertools.combinations(range(BUILDS), BUILDS // 2))[: math.comb(BUILDS, BUILDS // 2) // 2]
"""In which builds a feature of two values has the second, feature by feature: half of them, and of any two features
all four pairs of values, as no two sets are the same or each other's rest."""


def covering_features(source: str, device: Device) -> list[Features]:
    """BUILDS features that have every value of each between them, and pairs of switches as far as SWITCHED_ON goes."""
    values, made = values_that_are_read(source, device), []
    switches = [name for name, of in values.items() if len(of) == 2]
    for k in range(BUILDS):
        chosen = {name: of[k % len(of)] for name, of in values.items() if name not in switches}
        for name, on in zip(switches, itertools.cycle(SWITCHED_ON)):
            chosen[name] = values[name][k in on]
        made.append(Features(**chosen))
    return made


@pytest.mark.parametrize("name", PROGRAMS)
def test_programs_build_with_every_value_of_every_feature(device: Device, name: str) -> None:
    source = kernels.source_text(name)
    covering = covering_features(source, device)
    for field, values in values_that_are_read(source, device).items():
        assert {getattr(features, field) for features in covering} == set(values)
    for features in covering:
        kernels.build(device, name, features)


@pytest.mark.long
@pytest.mark.parametrize("name", PROGRAMS)
def test_programs_build_for_the_combinations_that_they_read(device: Device, name: str) -> None:
    for features in combinations_in_use(kernels.source_text(name), device):
        kernels.build(device, name, features)


# --- kernels' own rules ----------------------------------------------------------------------------


FORBIDDEN_CALL = re.compile(
    r"\b(native_\w+|half_\w+|fast_\w+|rsqrt|mad|dot|cross|normalize|length|distance|mix|smoothstep|radians|degrees"
    r"|sin|cos|tan|asin|acos|atan|atan2|exp|exp2|exp10|log|log2|log10|pow|powr|pown|cbrt|hypot|sincos)\s*\("
)
"""Builtins whose bits differ between runtimes."""


def without_comments(text: str) -> str:
    return re.sub(r"/\*.*?\*/|//[^\n]*", " ", text, flags=re.DOTALL)


@pytest.mark.parametrize("path", sorted(kernels.kernel_folder().glob("*.cl*")), ids=lambda p: p.name)
def test_kernel_files_keep_the_house_rules(path: Path) -> None:
    code = without_comments(path.read_text("utf-8"))
    assert "FP_CONTRACT ON" not in code
    assert FORBIDDEN_CALL.findall(code) == []
    defined = set(re.findall(r"#[ \t]*define[ \t]+(\w+)", code))
    assert not defined & set(layout.CONSTANTS), "shared constants live in layout.py"
    assert not defined & {f.name.upper() for f in fields(Features)}, "features live in features.py"
    assert not set(re.findall(r"\}\s*(\w+)\s*;", code)) & set(layout.STRUCTS), "shared structs live in layout.py"
    assert len(path.read_text("utf-8").splitlines()) <= 400


# --- imports ---------------------------------------------------------------------------------------

FLOORS = (
    "errors",
    "opencl",
    "scene",
    "visibility",
    "quality",
    "option_values",
    "options",
    "shading",
    "image",
    "job_choices",
    "job",
    "renderer",
    "study",
    "commands",
    "__init__",
    "__main__",
)
"""From the bottom to the top: a module imports from its own floor and from those before it."""

HOMES = {"pyopencl": "opencl", "trimesh": "scene", "OpenImageIO": "image"}
"""Libraries that one floor alone may import."""


def imported_names(path: Path, for_types: bool) -> set[str]:
    """Absolute names of the modules that a file imports anywhere; those `if TYPE_CHECKING` only if `for_types`."""
    found = set()
    tree = ast.parse(path.read_text("utf-8"))
    hidden: set[ast.AST] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            hidden |= {inner for statement in node.body for inner in ast.walk(statement)}
    for node in ast.walk(tree):
        if node in hidden and not for_types:
            continue
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            found.add(node.module or "")
            if node.module == "clrast":
                found |= {f"clrast.{alias.name}" for alias in node.names}
    return found


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_point_one_way(path: Path) -> None:
    floor = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
    for name in imported_names(path, for_types=True):
        parts = name.split(".")
        if parts[0] == "clrast" and len(parts) > 1 and parts[1] in FLOORS:
            assert FLOORS.index(parts[1]) <= FLOORS.index(floor), f"{floor} must not import {name}"
    for name in imported_names(path, for_types=False):
        home = HOMES.get(name.split(".")[0], floor)
        assert floor == home, f"{name} is imported in {home} alone, not in {floor}"


def test_the_import_rule_sees_a_wrong_import(tmp_path: Path) -> None:
    (tmp_path / "wrong.py").write_text(
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import trimesh\n"
        "def f():\n    from clrast import renderer\n    import pyopencl.tools\n"
    )
    assert imported_names(tmp_path / "wrong.py", for_types=False) == {
        "typing",
        "clrast",
        "clrast.renderer",
        "pyopencl.tools",
    }
    assert "trimesh" in imported_names(tmp_path / "wrong.py", for_types=True)
