"""The table of `clrast compare` on a terminal, the lines below it, and the findings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from clrast.opencl.features import Edges, Precision, Projection
from clrast.study.operation_counts import disagreements, kernel_cost, paper_cost
from clrast.visibility.methods import BASELINE

if TYPE_CHECKING:
    from clrast.study.compare import Comparison, MethodRow
    from clrast.study.findings import Verdict
    from clrast.study.orders import OrderStudy

TABLE_WIDTH = 160
"""Columns; a narrower terminal folds the lines, as numbers that are left out would be worse."""
NOTHING = "-"
EDGE_NAMES = {Edges.SPATIAL: "3D", Edges.PROJECTED: "2D", Edges.HOMOGENEOUS: "homogeneous 2D",
              Edges.BARYCENTRIC: "barycentric"}  # fmt: skip


@dataclass(frozen=True)
class Column:
    """`wide` columns hold text, the others numbers that are aligned to the right."""

    heading: str
    wide: bool = False


COLUMNS = (
    Column("method", wide=True), Column("ms"), Column("p10-p90"), Column("relative"), Column("build ms"),
    Column("setups"), Column("edge evaluations"), Column("instructions"), Column("relative"), Column("setup share"),
)  # fmt: skip


def table_lines(comparison: Comparison) -> list[str]:
    """The heading, the table, and what has to be said of it."""
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for column in COLUMNS:
        table.add_column(column.heading, justify="left" if column.wide else "right", no_wrap=True)
    for row in comparison.rows:
        table.add_row(*map(Text, _cells(comparison, row)))
    console = Console(highlight=False, width=TABLE_WIDTH)
    with console.capture() as captured:
        console.print(table)
    lines = [line.rstrip() for line in captured.get().splitlines()]
    return [_heading(comparison), *[line for line in lines if line], *_notes(comparison)]


def _heading(comparison: Comparison) -> str:
    width, height = comparison.size
    return (
        f"{comparison.scene}: {comparison.triangle_count:,} triangles, {width}x{height}, {comparison.projection}, "
        f"precision {comparison.precision}, on {comparison.device}; {comparison.repetitions} interleaved frames"
    )


def _cells(comparison: Comparison, row: MethodRow) -> tuple[str, ...]:
    mark = "*" if row.cut else ""
    return (
        row.method + mark,
        f"{row.median_ms:.2f}",
        f"{row.percentile(10):.2f}-{row.percentile(90):.2f}",
        _ratio(comparison.time_ratio(row.method)),
        f"{row.build_ms:.1f}" if row.build_ms else NOTHING,
        _count(row.counts.setups),
        _count(row.counts.edge_evaluations),
        _count(row.instructions),
        _ratio(comparison.instruction_ratio(row.method)),
        NOTHING if row.setup_share is None else f"{100 * row.setup_share:.0f} %",
    )


def _ratio(value: float | None) -> str:
    return NOTHING if value is None else f"{value:.2f}"


def _count(value: int | None) -> str:
    return NOTHING if value is None else f"{value:,}"


def _notes(comparison: Comparison) -> list[str]:
    """Lines below the table."""
    best = comparison.fastest
    level = f"; within its spread: {', '.join(comparison.as_fast)}" if comparison.as_fast else ""
    lines = [f"fastest: {best.method}, {best.median_ms:.2f} ms of setup, bin and visibility{level}"]
    if comparison.auto is not None:
        lines.append(f"auto takes {comparison.auto.method}{_auto_ratio(comparison)} ({comparison.auto.reason})")
    if comparison.row(BASELINE) is None:
        why = comparison.skipped.get(BASELINE, "it is not among the --methods")
        lines.append(f"nothing to be relative to: {BASELINE} was not measured ({why})")
    if comparison.is_noisy:
        lines.append("the times spread widely, as on a machine that does something else: give more --repetitions")
    cut = [row for row in comparison.rows if row.cut]
    if cut:
        counts = ", ".join(f"{row.method} {_frames(row)}" for row in cut)
        lines.append(f"* cut short by the budget of {comparison.budget_s:g} s: {counts}")
    lines += [f"{method} left out: {why}" for method, why in comparison.skipped.items() if method != BASELINE]
    pixel_count = comparison.size[0] * comparison.size[1]
    lines += [
        f"{row.method} shows another triangle at {row.differing_pixels:,} of {pixel_count:,} pixels than 3D edges do"
        for row in comparison.rows
        if row.differing_pixels
    ]
    return lines


def _auto_ratio(comparison: Comparison) -> str:
    best, ratio = comparison.fastest_exact, comparison.auto_ratio
    if best is None or ratio is None:
        return ""
    return f": {ratio:.2f} x the time of {best.method}, the fastest with 3D edges"


def _frames(row: MethodRow) -> str:
    if row.warm_up_only:
        return "its warm-up frame alone"
    return f"{len(row.frames_ms)} frame" + ("s" if len(row.frames_ms) > 1 else "")


def operation_lines(comparisons: Sequence[Comparison]) -> list[str]:
    """What an instruction is, and where the paper contradicts itself."""
    first = comparisons[0]
    precision, projection = Precision[first.precision.upper()], Projection[first.projection.upper()]
    kinds = dict.fromkeys(row.edges for comparison in comparisons for row in comparison.rows)
    paper = "; ".join(f"{EDGE_NAMES[k]} {paper_cost(k).setup} and {paper_cost(k).pixel}" for k in kinds)
    own = []
    for kind in kinds:
        cost = kernel_cost(kind, precision, projection)
        if cost is not None:
            own.append(f"{EDGE_NAMES[kind]} {cost[0].arithmetic} and {cost[1].arithmetic}")
    lines = [f"instructions of a setup and of an edge evaluation, the sums of the lines of Fig. 10: {paper}"]
    if own:
        lines.append(f"of our kernels, with no multiply-add and the nearness: {'; '.join(own)}")
    taken = [each for each in disagreements() if each.taken == "counted" and each.what.startswith("total")]
    lines += [
        f"Fig. 10 prints a total of {each.printed} for the {each.part} of {each.edges}, its lines sum to "
        f"{each.counted}: taken is {each.counted}"
        for each in taken
    ]
    return lines


def finding_lines(verdicts: Sequence[Verdict]) -> list[str]:
    """A line for each finding, with its figures and the reason below it."""
    lines = ["the paper's findings:"]
    for verdict in verdicts:
        lines.append(f"{verdict.verdict}: {verdict.text} ({verdict.section})")
        lines += [f"    {figure}" for figure in verdict.figures]
        if verdict.reason:
            lines.append(f"    because {verdict.reason}")
    return lines


def order_lines(study: OrderStudy) -> list[str]:
    """Hit rates, orders of loops and last references, as tables."""
    lines = [f"{'hit rate of':<18}  {'triangles':>9}  {'samples':>9}  {'writes':>9}  {'nodes':>9}"]
    for rate in study.hit_rates:
        shares = (rate.objects, rate.samples, rate.writes, rate.nodes)
        lines.append(f"{rate.method:<18}" + "".join(f"  {NOTHING if s is None else f'{s:.3f}':>9}" for s in shares))
    lines += ["", f"{'order of loops':<28}  {'shadings':>14}  {'MiB off chip':>12}"]
    lines += [f"{o.name:<28}  {o.shadings:>14,}  {o.bytes / 2**20:>12.1f}" for o in study.orders]
    last = study.last_reference
    ranges = ["1 tile", *(f"{2**k}-{2 ** (k + 1) - 1} tiles" for k in range(len(last.histogram)))]
    spread = ", ".join(f"{count:,} after {where}" for where, count in zip(ranges, last.histogram) if count)
    what = f"last references, {last.referenced:,} triangles in {last.references:,} references: {spread}"
    return [*lines, "", f"{what}; a cache of {last.live:,} triangles reads each once"]
