"""The table of `clrast stress` on a terminal, and the lines below it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from clrast.opencl.features import Edges
from clrast.study.stress import PROMISES, REPRODUCE
from clrast.study.wrong_samples import KINDS, VISIBLE
from clrast.visibility.methods import METHODS

if TYPE_CHECKING:
    from clrast.study.stress import Stress

TABLE_WIDTH = 160
EDGE_NAMES = {Edges.PROJECTED: "2dr-*", Edges.HOMOGENEOUS: "2dh-*", Edges.SPATIAL: "3D edges"}
NOTHING = "-"
COLUMNS = ("case", "rung", "method", "samples", "wrong", *KINDS)
TEXT_COLUMNS = 3
"""The first columns hold text, the others numbers."""


@dataclass(frozen=True)
class Row:
    """Methods and rungs that have the same figures for a case. counts : wrong samples of one method by kind."""

    case: str
    precisions: tuple[str, ...]
    methods: tuple[str, ...]
    samples: int
    wrong: int
    counts: tuple[int, ...]


def table_rows(stress: Stress) -> list[Row]:
    """A row for each case and each set of figures, over all its views."""
    rows: list[Row] = []
    for case in stress.cases:
        figures: dict[tuple[str, str], list[int]] = {}
        for finding in stress.findings:
            if finding.case != case.name:
                continue
            numbers = [finding.sample_count, finding.wrong_count, *finding.counts.values()]
            for method in finding.methods:
                sums = figures.setdefault((finding.precision, method), [0] * len(numbers))
                sums[:] = [a + b for a, b in zip(sums, numbers, strict=True)]
        by_rung: dict[str, dict[tuple[int, ...], list[str]]] = {}
        for (precision, method), sums in figures.items():
            by_rung.setdefault(precision, {}).setdefault(tuple(sums), []).append(method)
        merged: dict[tuple[tuple[str, ...], tuple[int, ...]], list[str]] = {}
        for precision, groups in by_rung.items():
            for key, methods in groups.items():
                ordered = tuple(name for name in stress.plan.methods if name in methods)
                merged.setdefault((ordered, key), []).append(precision)
        for (ordered, key), precisions in merged.items():
            rows.append(Row(case.name, tuple(precisions), ordered, key[0], key[1], key[2:]))
    return rows


def table_lines(stress: Stress) -> list[str]:
    """A heading and the table."""
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for k, heading in enumerate(COLUMNS):
        table.add_column(heading, justify="left" if k < TEXT_COLUMNS else "right", no_wrap=True)
    last = None
    for row in table_rows(stress):
        name = row.case if row.case != last else ""
        last = row.case
        is_all = row.precisions == stress.plan.precisions and len(row.precisions) > 1
        rungs = "all" if is_all else " ".join(row.precisions)
        cells = (name, rungs, methods_text(row.methods, stress.plan.methods), str(row.samples))
        table.add_row(*map(Text, (*cells, *(str(n) if n else NOTHING for n in (row.wrong, *row.counts)))))
    for one in stress.refused:
        answer = f"refused, exit {one.exit_code}" if one.exit_code is not None else "TAKEN"
        table.add_row(*map(Text, (one.name, answer, *[""] * (len(COLUMNS) - 2))))
    console = Console(highlight=False, width=TABLE_WIDTH)
    with console.capture() as captured:
        console.print(table)
    lines = [line.rstrip() for line in captured.get().splitlines()]
    return [_heading(stress), *[line for line in lines if line]]


def _heading(stress: Stress) -> str:
    count = len(stress.cases) + len(stress.refused)
    noun = "hard case" if count == 1 else "hard cases"
    return f"{count} {noun} on {stress.device}, against exact arithmetic; wrong samples of each method by kind"


def methods_text(methods: Sequence[str], asked: Sequence[str]) -> str:
    """`all 11`, or names, those of one kind of edges together where all that were asked for are there."""
    if tuple(methods) == tuple(asked) and len(methods) > 1:
        return f"all {len(methods)}"
    parts, left = [], list(methods)
    for edges, text in EDGE_NAMES.items():
        kind = [name for name in asked if name in METHODS and METHODS[name].edges == edges]
        if len(kind) > 1 and set(kind) <= set(left):
            parts.append(text)
            left = [name for name in left if name not in kind]
    return ", ".join([*parts, *left])


def unexpected_lines(stress: Stress) -> list[str]:
    """Where 3D edges give wrong samples that a case does not expect, or none where it does."""
    return [
        f"not as expected: {case.name}, {precision}: {wrong} wrong samples by 3D edges, expected "
        + ("none" if precision in case.right else "some")
        for case, precision, wrong in stress.unexpected()
    ]


def broken_lines(stress: Stress) -> list[str]:
    """A line for each image that breaks a promise, with the command that makes it."""
    lines = []
    for finding in stress.broken:
        what = ", ".join(f"{n} {kind}" for kind, n in finding.broken.items())
        first = finding.first_wrong(PROMISES[finding.precision])
        lines.append(
            f"BROKEN: {finding.case}, {finding.view.name}, {finding.precision}, "
            f"{methods_text(finding.methods, stress.plan.methods)}: {what}; the first at pixel {first}; "
            + REPRODUCE.format(case=finding.case, precision=finding.precision, method=finding.methods[0])
        )
    lines += [f"BROKEN: {one.name}: not refused with exit code 65" for one in stress.refused if not one.is_right]
    return lines


def promise_lines(stress: Stress) -> list[str]:
    """What each rung that promises something gave; `exact` comes last."""
    lines = []
    for precision in stress.plan.precisions:
        if precision not in PROMISES:
            continue
        wrong, samples = stress.total(precision)
        if PROMISES[precision] == VISIBLE:
            lines.append(f"{precision}: {wrong} wrong of {samples} samples")
        else:
            what = " and ".join(f"{kind}s" for kind in PROMISES[precision])
            lines.append(f"{precision}: {wrong} {what} along edges of {samples} samples")
    return lines
