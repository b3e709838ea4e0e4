#!/usr/bin/env python3
"""Runs the suites by which other systems test rasterizers and ray casters; exit 1 where a promise is broken.

    python tools/check_suites.py                               a part of every suite, the three main methods
    python tools/check_suites.py --long --json suites.json     all of it: every method, every rung
    python tools/check_suites.py --suite sheets,aimed --methods raycast-bvh --precision exact --device rusticl

Suites: dEQP's fill rules (quads), Vulkan's sheets (sheets) and the same aimed at every vertex and at the middle of
every edge (aimed), Embree's sphere and plane far from the origin (far) and small triangles far away (small), pbrt's
bumpy sphere (bumpy, bumpy-large), piglit's exact triangles (integer), NaN, Inf and the like (inputs). What they are
stands in the files tests/conformance_*.py, what is promised in tests/conformance.py.
A row sums the cases of a suite for one rung and method; numbers are samples.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

import conformance_worlds as worlds  # noqa: E402
from conformance import METHOD_OPTIONS, UNJUDGED_RUNGS, Verdict, run_case  # noqa: E402
from conformance_inputs import run_inputs  # noqa: E402
from conformance_integer import integer_cases  # noqa: E402
from conformance_spheres import far_cases, large_bumpy_cases, small_bumpy_cases  # noqa: E402
from conformance_worlds import Case  # noqa: E402

from clrast.errors import ClrastError  # noqa: E402
from clrast.opencl.device import open_device  # noqa: E402
from clrast.options import AVAILABLE_PRECISIONS  # noqa: E402

SHORT_METHODS = ("3dr-binning", "3dr-full", "raycast-bvh")
SUITES = {
    "quads": worlds.quad_cases,
    "sheets": worlds.sheet_cases,
    "aimed": worlds.aimed_sheet_cases,
    "far": far_cases,
    "small": worlds.small_cases,
    "bumpy": small_bumpy_cases,
    "bumpy-large": large_bumpy_cases,
    "integer": integer_cases,
}
INPUTS = "inputs"
SHORT_SHARE = {"quads": 3, "sheets": 7, "aimed": 7, "far": 6, "small": 4, "bumpy": 10, "bumpy-large": 6, "integer": 10}
"""Without --long every so manieth case is run."""
COLUMNS = ("suite", "rung", "method", "cases", "samples", "at vertices", "at edges", "missed", "double",
           "of these excused", "other id", "not as 3dr-binning", "verdict")  # fmt: skip


def cases_of(suite: str, is_long: bool) -> Iterator[Case]:
    """The cases of a suite, or a part of them."""
    for k, case in enumerate(SUITES[suite]()):
        if is_long or k % SHORT_SHARE[suite] == 0:
            yield case


def table_rows(verdicts: Sequence[Verdict]) -> list[list[str]]:
    """A row for each suite, rung and method, in the order of their first verdicts."""
    groups: dict[tuple[str, str, str], list[Verdict]] = {}
    for one in verdicts:
        groups.setdefault((one.suite, one.rung, one.method), []).append(one)
    rows = []
    for key, group in groups.items():
        names = ("samples", "aimed_vertices", "aimed_edges", "misses", "doubles", "at_vertices")
        sums = [sum(getattr(one, name) for one in group) for name in names]
        ids = [one.wrong_ids for one in group if one.wrong_ids is not None]
        broken = sum(one.forbidden for one in group)
        sums += [sum(ids) if ids else -1, sum(one.differing for one in group)]
        numbers = ["-" if value < 0 else f"{value:,}" for value in sums]
        rows.append([*key, str(len(group)), *numbers, f"BROKEN: {broken:,}" if broken else "ok"])
    return rows


def print_table(rows: Sequence[Sequence[str]]) -> None:
    """Plain columns: the same in a terminal and in a log."""
    whole = [list(COLUMNS), *rows]
    widths = [max(len(cells[k]) for cells in whole) for k in range(len(COLUMNS))]
    for cells in whole:
        print("  ".join(cell.ljust(width) for cell, width in zip(cells, widths, strict=True)).rstrip())


def check_inputs(device: str | None) -> int:
    """The hostile files; prints each fault and how many there are."""
    with tempfile.TemporaryDirectory() as folder:
        found = list(run_inputs(Path(folder), device))
    faults = [(one, fault) for one, fault in found if fault]
    for one, fault in faults:
        print(f"BROKEN: input with {one.name}: {fault}")
    print(f"inputs: {len(found)} files, {len(faults)} of them with another result than the design's")
    return len(faults)


def names_in(text: str | None, known: Sequence[str], default: Sequence[str], parser: argparse.ArgumentParser) -> tuple:
    """A comma list of known names."""
    chosen = tuple(text.split(",")) if text else tuple(default)
    for name in chosen:
        if name not in known:
            parser.error(f"'{name}' is unknown: use {', '.join(known)}")
    return chosen


def parse_arguments(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line, its lists checked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--suite", help=f"comma list of {', '.join((*SUITES, INPUTS))}; all where none is named")
    parser.add_argument("--methods", help="comma list; with --long all where none is named")
    parser.add_argument("--precision", help="comma list of rungs; all where none is named")
    parser.add_argument("--device", help="as for clrast render")
    parser.add_argument("--long", action="store_true", help="all cases and methods; an hour on two processors")
    parser.add_argument("--json", type=Path, help="write all figures, a case a record, to this file")
    options = parser.parse_args(arguments)
    methods = tuple(METHOD_OPTIONS)
    suites = (*SUITES, INPUTS)
    options.suite = names_in(options.suite, suites, suites, parser)
    options.methods = names_in(options.methods, methods, methods if options.long else SHORT_METHODS, parser)
    options.precision = names_in(options.precision, AVAILABLE_PRECISIONS, AVAILABLE_PRECISIONS, parser)
    return options


def main(arguments: Sequence[str] | None = None) -> int:
    """0: every promise holds; 1: one is broken; 69: no working device."""
    options = parse_arguments(arguments)
    try:
        device = open_device(options.device)
    except ClrastError as error:
        print(f"check_suites: {error}", file=sys.stderr)
        return 69
    rungs = tuple(rung for rung in options.precision if rung not in UNJUDGED_RUNGS)
    for rung in set(options.precision) - set(rungs):
        print(f"{rung}: not judged here: {UNJUDGED_RUNGS[rung]}")
    if "double" in rungs and not device.has_fp64:
        print(f"double: not judged here: {device.runtime} has no float64")
    print(f"{device}: rungs {', '.join(rungs)}; methods {', '.join(options.methods)}", flush=True)
    verdicts: list[Verdict] = []
    faults = check_inputs(options.device) if INPUTS in options.suite else 0
    for suite in (name for name in options.suite if name in SUITES):
        started, before = time.perf_counter(), len(verdicts)
        for case in cases_of(suite, options.long):
            for verdict in run_case(device, case, rungs, options.methods):
                verdicts.append(verdict)
                if verdict.forbidden:
                    print(f"BROKEN: {verdict}", flush=True)
        spent = time.perf_counter() - started
        print(f"{suite}: {len(verdicts) - before} images judged in {spent:.0f} s", file=sys.stderr, flush=True)
    if verdicts:
        print_table(table_rows(verdicts))
    if options.json:
        options.json.write_text(json.dumps([asdict(one) for one in verdicts], indent=1) + "\n", encoding="utf-8")
    return int(faults > 0 or any(one.forbidden for one in verdicts))


if __name__ == "__main__":
    sys.exit(main())
