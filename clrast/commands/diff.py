"""`clrast diff REF TEST`: what changed between two images, with idiff's options and exit codes."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from clrast.commands import messages
from clrast.errors import ClrastError, InputNotFoundError, SceneError, UsageError

if TYPE_CHECKING:
    from clrast.image.channel_diff import ChannelDiff
    from clrast.image.diff import DiffReport

EXIT_UNREADABLE = 4
"""In place of 65 and 66: idiff's code for a file that is missing or cannot be read."""

COLUMNS = (
    "part", "channel", "verdict", "differ", "over", "max", "mean", "rms", "worst at", "reference", "test", "passes at",
)  # fmt: skip

FAILURES, WARNINGS, WHAT, OUTPUTS = "Failure", "Warning", "What is compared", "Outputs"


def _threshold(name: str, metavar: str, text: str, panel: str) -> Any:
    """An option under its own name and, with one dash, under idiff's."""
    return typer.Option(
        f"--{name}", f"-{name}", metavar=metavar, help=text, rich_help_panel=panel, show_default=False
    )


def _switch(*flags: str, text: str, panel: str) -> Any:
    return typer.Option(*flags, help=text, rich_help_panel=panel, show_default=False)


Floats = list[float] | None
Counts = list[int] | None
Texts = list[str] | None

Ref = Annotated[str, typer.Argument(metavar="REF", help="The image to compare with: .exr or .png.", show_default=False)]
Test = Annotated[str, typer.Argument(metavar="TEST", help="The image to judge.", show_default=False)]
Fail = Annotated[Floats, _threshold("fail", "VAL", "A value fails beyond this error [default: 1e-6].", FAILURES)]
FailRelative = Annotated[
    Floats, _threshold("failrelative", "VAL", "and beyond this share of the values' mean size [default: 0].", FAILURES)
]
FailPercent = Annotated[
    Floats, _threshold("failpercent", "PERCENT", "Pixels of a part that may fail [default: 0].", FAILURES)
]
HardFail = Annotated[Floats, _threshold("hardfail", "VAL", "No pixel may exceed this error.", FAILURES)]
AllowFailures = Annotated[
    Counts, _threshold("allowfailures", "N", "Pixels of a part that may fail by any amount [default: 0].", FAILURES)
]
IdFail = Annotated[
    Counts, _threshold("id-fail", "COUNT", "Pixels that may differ in an id channel [default: 0].", FAILURES)
]
FailFlip = Annotated[
    Floats, _threshold("fail-flip", "VAL", "Largest mean FLIP error of the colour, 0 to 1.", FAILURES)
]
Rule = Annotated[
    Texts,
    typer.Option(
        "--rule", metavar="NAME=VAL", rich_help_panel=FAILURES, show_default=False,
        help="A threshold for one channel, or for a pattern as N.*; may be given again. For ids: pixels.",
    ),
]  # fmt: skip
Warn = Annotated[Floats, _threshold("warn", "VAL", "A value warns beyond this error [default: as --fail].", WARNINGS)]
WarnRelative = Annotated[
    Floats, _threshold("warnrelative", "VAL", "Likewise [default: as --failrelative].", WARNINGS)
]
WarnPercent = Annotated[
    Floats, _threshold("warnpercent", "PERCENT", "Pixels of a part that may warn [default: 0].", WARNINGS)
]
HardWarn = Annotated[Floats, _threshold("hardwarn", "VAL", "Warn if a pixel exceeds this error.", WARNINGS)]
AllParts = Annotated[bool, _switch("-a", "--all", text="Compare all parts, as without it: idiff has it.", panel=WHAT)]
AllowMissing = Annotated[bool, _switch("--allow-missing", text="Compare what both images have.", panel=WHAT)]
Header = Annotated[bool, _switch("--header", text="A difference in the header is a failure.", panel=WHAT)]
Output = Annotated[
    Texts,
    typer.Option(
        "-o", "--output", metavar="FILE", rich_help_panel=OUTPUTS, show_default=False,
        help="x.exr (error of every channel, and FLIP) or x.png (a heat map).",
    ),
]  # fmt: skip
OnlyDifferent = Annotated[bool, _switch("--od", "-od", text="Write -o only if pixels differ.", panel=OUTPUTS)]
Json = Annotated[bool, _switch("--json", text="Print the report as JSON.", panel=OUTPUTS)]
Quiet = Annotated[bool, _switch("-q", "--quiet", text="Print nothing but errors.", panel=OUTPUTS)]


def run(
    ref: str,
    test: str,
    *,
    output: str | None = None,
    output_only_different: bool = False,
    json_output: bool = False,
    quiet: bool = False,
    **thresholds: Any,
) -> int:
    """Compare two files, print what was found, and return the exit code.

    thresholds : fields of clrast.image.channel_diff.Thresholds. UsageError and OutputError are raised.
    """
    from clrast.image.diff import diff
    from clrast.image.files import check_writable

    if output is not None:
        _check_output(output, ref, test)
        check_writable(output)
    try:
        report = diff(ref, test, output=output, output_only_different=output_only_different, **thresholds)
    except (InputNotFoundError, SceneError) as fault:
        if json_output:
            print(json.dumps(_unreadable(ref, test, fault), indent=2))
        messages.error(str(fault))
        return EXIT_UNREADABLE
    if json_output:
        print(json.dumps(report.to_dict(), indent=2, allow_nan=False))
    elif not quiet:
        _print_report(report)
    return report.exit_code


def diff_command(
    ref: Ref,
    test: Test,
    fail: Fail = None,
    failrelative: FailRelative = None,
    failpercent: FailPercent = None,
    hardfail: HardFail = None,
    allowfailures: AllowFailures = None,
    id_fail: IdFail = None,
    fail_flip: FailFlip = None,
    rule: Rule = None,
    warn: Warn = None,
    warnrelative: WarnRelative = None,
    warnpercent: WarnPercent = None,
    hardwarn: HardWarn = None,
    all_parts: AllParts = True,
    allow_missing: AllowMissing = False,
    header: Header = False,
    output: Output = None,
    output_only_different: OnlyDifferent = False,
    json_output: Json = False,
    quiet: Quiet = False,
) -> int:
    """What changed between two images: every part, every channel, ids exactly, NaN and Inf, FLIP.

    Exit codes: 0 within thresholds, 1 warning, 2 failure, 3 sizes, channels or parts differ, 4 a file is
    missing or cannot be read. idiff's options are taken with one dash, too.
    """
    del all_parts
    given = {
        "fail": fail, "failrelative": failrelative, "failpercent": failpercent, "hardfail": hardfail,
        "allowfailures": allowfailures, "id_fail": id_fail, "fail_flip": fail_flip, "warn": warn,
        "warnrelative": warnrelative, "warnpercent": warnpercent, "hardwarn": hardwarn,
    }  # fmt: skip
    thresholds = {name: _one(name, values) for name, values in given.items() if values}
    return run(
        ref,
        test,
        output=_one("output", output) if output else None,
        output_only_different=output_only_different,
        json_output=json_output,
        quiet=quiet,
        rules=_rules(rule or ()),
        allow_missing=allow_missing,
        header=header,
        **thresholds,
    )


def _one(name: str, values: Sequence[Any]) -> Any:
    """The one value of an option: the order of options never decides between two."""
    different = sorted({str(value) for value in values})
    if len(different) > 1:
        option = "--" + name.replace("_", "-")
        raise UsageError(f"{option} is given as {' and as '.join(different)}: give it once")
    return values[0]


def _rules(texts: Sequence[str]) -> dict[str, float]:
    rules: dict[str, float] = {}
    for text in texts:
        name, equals, number = text.rpartition("=")
        try:
            value = float(number)
        except ValueError:
            equals = ""
        if not equals or not name:
            raise UsageError(f"--rule {text!r} is no rule: give CHANNEL=THRESHOLD, as N.X=0.01")
        rules[name] = _one(f"rule {name}", (rules.get(name, value), value))
    return rules


def _check_output(output: str, *inputs: str) -> None:
    for path in inputs:
        if os.path.realpath(output) == os.path.realpath(path):
            raise UsageError(f"-o {output} would overwrite an image that is compared: give another name")


def _unreadable(ref: str, test: str, fault: ClrastError) -> dict[str, Any]:
    return {
        "reference": ref, "test": test, "status": "unreadable", "exit_code": EXIT_UNREADABLE, "verdict": str(fault),
    }  # fmt: skip


def _print_report(report: DiffReport) -> None:
    """A table of the channels, notes, and the verdict as the last line."""
    rows = [_row(found) for found in report.channels]
    if rows and sys.stdout.isatty():
        _print_rich(rows)
    elif rows:
        widths = [max(len(row[column]) for row in (COLUMNS, *rows)) for column in range(len(COLUMNS))]
        for row in (COLUMNS, *rows):
            print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
    if report.flip is not None:
        place = f", largest {report.flip.max:.6g} at {report.flip.worst}" if report.flip.max else ""
        print(f"FLIP of the colour: mean {report.flip.mean:.6g}{place}")
    for sentence in report.structure:
        print(f"structure: {messages.one_line(sentence)}")
    for sentence in report.notes:
        print(f"note: {messages.one_line(sentence)}")
    print(messages.one_line(report.verdict))


def _row(found: ChannelDiff) -> tuple[str, ...]:
    """A channel as the cells of COLUMNS."""
    from clrast.image.diff import value_text

    def number(value: float | None) -> str:
        return "" if value is None else f"{value:.6g}"

    passes = "" if not found.differing else "never" if found.passes_at is None else f"{found.passes_at:.6g}"
    return (
        found.part, found.channel, found.status, str(found.differing), str(found.failing), number(found.max_error),
        number(found.mean_error), number(found.rms_error),
        "" if found.worst is None else f"{found.worst[0]},{found.worst[1]}",
        value_text(found, found.reference_value) if found.worst else "",
        value_text(found, found.test_value) if found.worst else "", passes,
    )  # fmt: skip


def _print_rich(rows: Sequence[Sequence[str]]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    styles = {"pass": "green", "warning": "yellow", "failure": "bold red"}
    table = Table(box=None, pad_edge=False)
    for column in COLUMNS:
        table.add_column(column, justify="left" if column in ("part", "channel", "verdict") else "right")
    for row in rows:
        table.add_row(*(Text(cell) for cell in row), style=styles[row[2]])
    Console().print(table)
