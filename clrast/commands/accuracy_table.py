"""The table of `clrast accuracy` on a terminal, and the lines below it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from clrast.commands.accuracy_call import as_line
from clrast.commands.compare_table import NOTHING, TABLE_WIDTH, Column
from clrast.study.accuracy_answers import OF_COMMAND, OF_FRAME, WHAT_IS_IN

if TYPE_CHECKING:
    from clrast.study.accuracy import Accuracy, Row
    from clrast.study.accuracy_answers import Answer

ON_FRONT = "*"
WIDE_SPREAD = 1.5
"""Ratio of the 90th to the 10th percentile from which on a time says little."""
COLUMNS = (
    Column(""), Column("setting", wide=True), Column("ms"), Column("p10-p90"), Column("frames"), Column("relative"),
    Column("rmse"), Column("MSE"), Column("rel. MSE"), Column("FLIP"), Column("worst"), Column("at pixel"),
    Column("wrong samples"),
)  # fmt: skip


def table_lines(study: Accuracy) -> list[str]:
    """The heading, the table, and what has to be said of it."""
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for column in COLUMNS:
        table.add_column(column.heading, justify="left" if column.wide else "right", no_wrap=True)
    front = {row.name for row in study.front}
    knob = study.rows[0].setting.knob
    for row in study.rows:
        if row.setting.knob != knob:
            table.add_section()
            knob = row.setting.knob
        table.add_row(*map(Text, _cells(study, row, row.name in front)))
    console = Console(highlight=False, width=TABLE_WIDTH)
    with console.capture() as captured:
        console.print(table)
    lines = [line.rstrip() for line in captured.get().splitlines()]
    return [_heading(study), *[line for line in lines if line], *_notes(study)]


def _heading(study: Accuracy) -> str:
    width, height = study.size
    default = study.default.setting.options
    return (
        f"{study.scene}: {study.triangle_count:,} triangles, {width}x{height}, {study.projection}, on {study.device}; "
        f"default: precision {default.precision}, aa {default.aa}, method {study.default.method}"
    )


def _cells(study: Accuracy, row: Row, is_on_front: bool) -> tuple[str, ...]:
    errors = row.errors
    return (
        ON_FRONT if is_on_front else "",
        row.name,
        f"{row.median_ms:.1f}",
        f"{row.percentile(10):.1f}-{row.percentile(90):.1f}",
        str(len(row.times_ms)),
        f"{study.relative(row):.2f}",
        number(errors.rmse),
        number(errors.mse),
        number(errors.relative_mse),
        NOTHING if errors.flip is None else number(errors.flip),
        number(errors.worst),
        f"{errors.worst_pixel[0]},{errors.worst_pixel[1]}",
        f"{row.wrong_samples:,}" if row.wrong_samples else NOTHING,
    )


def number(value: float) -> str:
    """Three digits, with an exponent where the value is very small."""
    return f"{value:.2e}" if 0 < value < 1e-4 else f"{value:.3g}"


def _notes(study: Accuracy) -> list[str]:
    """Lines below the table."""
    reference = study.reference
    made = "kept from an earlier run" if reference.cached else f"rendered in {reference.seconds:.1f} s"
    own = "" if reference.own_rmse is None else f"; by its samples its own rmse is about {number(reference.own_rmse)}"
    width, height = study.size
    lines = [
        f"errors: linear colour against {reference.options.aa} by exact arithmetic, {made}{own}",
        f"times: {WHAT_IS_IN[OF_FRAME]}; loading, building and writing apart; relative to the default, round by round",
        f"wrong samples: of {width * height:,} pixels' centres, against the rung exact",
        f"{ON_FRONT} on the Pareto front by {study.metric}, beyond the noise: "
        + ", ".join(f"{row.name} {row.median_ms:.1f} ms" for row in study.front),
    ]
    wide = [row for row in study.rows if row.percentile(90) > WIDE_SPREAD * row.percentile(10)]
    if len(wide) > len(study.rows) / 2:
        lines.append("the times spread widely, as on a machine that does something else: give more --budget")
    lines += [f"left out: {name}: {why}" for name, why in study.left_out.items()]
    return lines


def answer_lines(study: Accuracy, answers: Sequence[Answer], commands: Mapping[str, Sequence[str]]) -> list[str]:
    """What was asked, what to type, what it will take, and what it took."""
    lines: list[str] = []
    for answer in answers:
        row = answer.row
        lines += ["", _verdict(study, answer), f"    {as_line(commands[row.name])}"]
        error = f"{study.metric} {number(study.error(row))}"
        frame = f"its frame {row.median_ms / 1000:.3g} s"
        if answer.predicted_s is None:
            lines.append(f"    predicted: {frame}, {error}; not run (--no-check), so the whole command is not known")
            continue
        lines.append(f"    predicted: {answer.predicted_s:.3g} s in all, of which {frame}; {error}")
        runs = answer.runs
        if runs:
            count = "once" if len(runs) == 1 else f"{len(runs)} times"
            took = ", ".join(f"{run.command_s:.3g}" for run in runs)
            frames = ", ".join(f"{run.frame_ms / 1000:.3g}" for run in runs)
            lines.append(f"    run {count} as printed: {took} s in all, frame {frames} s; {study.metric} "
                         + number(runs[-1].error))  # fmt: skip
    return lines


def _verdict(study: Accuracy, answer: Answer) -> str:
    row = answer.row
    if answer.asked == "time":
        within = f"within {answer.value:g} s ({WHAT_IS_IN[answer.of]})"
        if answer.reached:
            return f"{within} the best is: {row.name}, {study.metric} {number(study.error(row))}"
        return f"{within} nothing is ready: the nearest, the fastest, is {row.name}"
    wanted = f"for {study.metric} {answer.value:g}"
    if answer.reached:
        return f"{wanted} the cheapest is: {row.name}, {study.metric} {number(study.error(row))}"
    return f"{wanted} nothing is accurate enough: the nearest is {row.name}, {study.metric} {number(study.error(row))}"


__all__ = ["OF_COMMAND", "answer_lines", "number", "table_lines"]
