"""The tables of `clrast cost` on a terminal, with the paper's own numbers where its text kept them.

Purcell et al., 'Ray Tracing on Programmable Graphics Hardware', Tables 1 to 3, Fig. 7 to 9, sections 4.2, 5.2 and 5.3.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from clrast.study.cost import TILE_SIDE, UNROLLED
from clrast.study.traffic import KERNELS, KINDS, SHADING, STATE, STENCIL

if TYPE_CHECKING:
    from clrast.study.cost import CostStudy, PassRow
    from clrast.study.cost_equation import Point

TABLE_WIDTH = 150
NOTHING = "-"

PAPER_PASSES = (
    ("paper, Hall outside", "2443", "692", "1747", "4", "384", "1123", "0.009"),
    ("paper, Hall inside", "1198", "70", "1124", "4", NOTHING, NOTHING, NOTHING),
    ("paper, Forest top down", "1999", "311", "1684", "4", "137", "1435", "0.062"),
    ("paper, Forest inside", "2835", "1363", "1468", "4", "898", "990", "0.068"),
    ("paper, Bunny", "1085", "610", "471", "4", "221", "328", "0.105"),
)
"""Table 2, at 1024x1024 and grids of 250x198x128, 581x128x581 and 98x64x163, as far as its text was kept."""

PAPER_EXTENSIONS = (("shadow caster", 0.85, 1.15), ("Whitted ray tracer", 2.62, 3.00), ("path tracer", 3.24, 4.06))
"""Table 3: instructions and bytes of the bunny relative to ray casting, branching."""

PAPER_RATES = "paper: 20 M (processor, 800 MHz), 114 M (fixed point), 56 M and 222 M (2 and 8 G instructions a second)"


def study_lines(study: CostStudy) -> list[str]:
    """Everything, a table after the other."""
    lines = [_heading(study), ""]
    for part in (_passes(study), _words(study), _unrolled(study), _caches(study), _times(study), _extensions(study)):
        lines += [*part, ""]
    return [*lines, *study.notes]


def _heading(study: CostStudy) -> str:
    width, height = study.size
    grid, rays = "x".join(map(str, study.grid)), study.rays
    return (
        f"{study.scene}: {study.triangle_count:,} triangles, {width}x{height}, precision {study.precision}, on "
        f"{study.device}; grid {grid}, {study.references:,} references; of {rays:,} rays {study.rays_entering:,} meet "
        f"it: v {study.steps:.1f} cells, t {study.tests:.1f} triangles, s {study.hits / rays:.2f} shadings a ray"
    )


def _table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Columns: the first text, the others aligned to the right."""
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for k, heading in enumerate(headings):
        table.add_column(heading, justify="right" if k else "left", no_wrap=True)
    for row in rows:
        table.add_row(*map(Text, row))
    console = Console(highlight=False, width=TABLE_WIDTH)
    with console.capture() as captured:
        console.print(table)
    return [line.rstrip() for line in captured.get().splitlines() if line.strip()]


def _passes(study: CostStudy) -> list[str]:
    def cells(row: PassRow) -> tuple[str, ...]:
        done = row.passes
        return (
            row.oracle, str(done.total), str(done.traverse), str(done.intersect), str(done.other),
            str(study.max_steps), str(study.max_tests), f"{done.simd_efficiency:.3f}",
        )  # fmt: skip

    headings = ("passes (Table 2)", "total", "traverse", "intersect", "other", "most steps", "most tests", "efficiency")
    lines = _table(headings, [*map(cells, study.rows), *PAPER_PASSES])
    fewest = min(study.rows, key=lambda row: row.passes.total)
    times = fewest.passes.total / max(1, study.least_passes)
    return [*lines, (
        f"no oracle can need fewer than {study.least_passes} passes, what the longest ray takes; {fewest.oracle} needs "
        f"{times:.1f} times as many (paper: purcell 2 to 3, naive 5 and more)"
    )]  # fmt: skip


def _words(study: CostStudy) -> list[str]:
    models = (("multipass", study.multipass), ("branching", study.branching))
    rows = []
    for kernel in KERNELS:
        cells = [kernel]
        for _, traffic in models:
            a_ray = traffic.a_ray(kernel)
            cells += [f"{a_ray[part]:.2f}" if kernel in traffic.instances else NOTHING for part in "RWM"]
        rows.append((*cells, *(f"{4 * traffic.by_kernel()[kernel] / 1e6:.1f}" for _, traffic in models)))
    headings = ("words a run (Table 1)", "R", "W", "M", "R, branching", "W", "M", "MB, multipass (Fig. 7)", "branching")
    lines = _table(headings, rows)
    kinds = [
        (kind, *(f"{4 * traffic.by_kind()[kind] / 1e6:.1f}" for _, traffic in models)) for kind in KINDS
    ]  # fmt: skip
    lines += ["", *_table(("MB by kind (Fig. 8)", "multipass", "branching"), kinds)]
    state = study.multipass.by_kind()
    share = (state[STATE] + state[STENCIL]) / study.multipass.total
    return [*lines, (
        f"R read of a stream, W written, M read elsewhere; {100 * share:.0f} % of the multipass bytes are state; a "
        f"stencil read for every ray in every pass, as in the paper, would be {study.stencil / 1e6:.1f} MB"
    )]  # fmt: skip


def _unrolled(study: CostStudy) -> list[str]:
    whole = study.unrolled[0].words
    rows = [
        (f"{row.steps} steps, {row.tests} tests", str(row.passes.total), f"{4 * row.words / 1e6:.1f}",
         f"{100 * (1 - row.words / whole):.0f} %", "50 to 60 %" if (row.steps, row.tests) == (4, 2) else NOTHING)
        for row in study.unrolled
    ]  # fmt: skip
    assert len(rows) == len(UNROLLED)
    return _table(("unrolled loops (4.2)", "passes", "MB", "saved", "paper"), rows)


def _caches(study: CostStudy) -> list[str]:
    kinds = [kind for kind in KINDS if kind != SHADING]
    rows = [
        (row.name, *(_percent(row.rates[kind].rate) for kind in kinds), f"{row.bytes_left:.2f}") for row in study.caches
    ]
    lines = _table(("hit rates, 64 KB cache (Fig. 9)", *kinds, "bytes left"), rows)
    return [*lines, (
        f"of {study.cache_rays:,} rays, direct-mapped, lines of 48 bytes; paper: triangles 96 to 99 % at 1024x1024; "
        f"tiles of {TILE_SIDE}x{TILE_SIDE} and 32x32 pixels are rendered to their end one by one (5.3)"
    )]  # fmt: skip


def _percent(rate: float | None) -> str:
    return NOTHING if rate is None else f"{100 * rate:.1f} %"


def _times(study: CostStudy) -> list[str]:
    def row(point: Point, predicted: float) -> tuple[str, ...]:
        passes = str(point.passes) if point.passes else NOTHING
        numbers = [f"{value:.1f}" for value in (point.steps, point.tests, point.ms, predicted)]
        error = f"{100 * (predicted / point.ms - 1):+.0f} %"
        return point.name, *numbers[:2], passes, *numbers[2:], error

    rows = [row(*pair) for pair in zip(study.points, study.predicted, strict=True)]
    rows += [row(*pair) for pair in zip(study.pass_points, study.pass_predicted, strict=True)]
    lines = _table(("C = R (C_r + v C_v + t C_t + s C_s) + P C_pass", "v", "t", "P", "ms", "predicted", "off"), rows)
    for name, c in (("branching", study.constants), ("multipass", study.pass_constants)):
        passing = f", C_pass {c.passing / 1000:.0f} us, C_stencil {c.passing / study.rays:.2f} ns" if c.passing else ""
        costs = f"C_r {c.ray:.1f} ns, C_v {c.step:.2f} ns, C_t {c.test:.2f} ns, C_s {study.shade_ns:.0f} ns"
        lines.append(f"{name}: {costs}{passing}")
    lines.append("each time is predicted by constants fitted to all the others; C_s and the shading are apart")
    return [*lines, f"{study.tests_a_second / 1e6:.0f} M intersections a second, branching; {PAPER_RATES}"]


def _extensions(study: CostStudy) -> list[str]:
    rows = [
        (name, f"{work:.2f}", f"{moved:.2f}", f"{row.ratio:.2f}", f"{row.rays:,}")
        for (name, work, moved), row in zip(PAPER_EXTENSIONS, study.modes, strict=True)
    ]
    heads = ("relative to ray casting (Table 3)", "paper, instructions", "paper, bytes", "here, time", "more rays")
    note = "here: visibility and shading; secondary rays go through the BVH; paths of two bounces"
    return [*_table(heads, rows), note]
