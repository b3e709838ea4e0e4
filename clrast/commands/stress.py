"""`clrast stress`: the hard cases on this device, by every method and rung, against exact arithmetic."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from clrast.commands import messages
from clrast.commands import parameters as p
from clrast.commands.progress import progress
from clrast.commands.render import once
from clrast.commands.stats import to_json
from clrast.errors import EXIT_CHECK_FAILED, EXIT_OK, OutputError, UsageError
from clrast.image.files import check_writable, write_text
from clrast.options import make_options

if TYPE_CHECKING:
    from clrast.study.stress import Plan, Stress

MACHINE_OPTIONS = ("device", "threads")
"""Options of a render that this command passes on."""
PANEL = "Cases"

CaseList = Annotated[
    p.Texts,
    typer.Option("--case", metavar="LIST", rich_help_panel=PANEL, show_default=False,
                 help="Comma list of cases, as data/hard/ names them [default: all]."),
]  # fmt: skip
PrecisionList = Annotated[
    p.Texts,
    typer.Option("--precision", metavar="LIST", rich_help_panel=PANEL, show_default=False,
                 help="Comma list of rungs [default: all that the device has]."),
]  # fmt: skip
MethodList = Annotated[
    p.Texts,
    typer.Option("--method", metavar="LIST", rich_help_panel=PANEL, show_default=False,
                 help="Comma list of methods [default: all]."),
]  # fmt: skip
Long = Annotated[
    bool, typer.Option("--long", rich_help_panel=PANEL, help="Also other image sizes and random cameras.")
]
Failures = Annotated[
    p.Texts,
    typer.Option("--failures", metavar="DIR", rich_help_panel=p.OUTPUTS, show_default=False,
                 help="For each image with wrong samples: the picture, a map of them, and the card that makes it."),
]  # fmt: skip
Output = Annotated[
    p.Texts,
    typer.Option("-o", "--output", metavar="FILE", rich_help_panel=p.OUTPUTS, show_default=False,
                 help="The whole run as a page, x.html, that needs no other file."),
]  # fmt: skip


@dataclass(frozen=True)
class Call:
    """One call of `stress`, checked."""

    cases: tuple[str, ...]
    plan: Plan
    failures: str | None
    output: str | None
    json: bool
    quiet: bool


def stress_command(
    case: CaseList = None,
    precision: PrecisionList = None,
    method: MethodList = None,
    long: Long = False,
    failures: Failures = None,
    output: Output = None,
    json: p.StudyJson = False,
    quiet: p.StudyQuiet = False,
    device: p.Device = None,
    threads: p.Threads = None,
) -> int:
    """Render hard cases by every method and rung, and count the wrong samples against exact arithmetic.

    Exit code 1 where a rung breaks its promise: exact gives no wrong sample at all, midpoint no hole and no double
    hit along an edge that triangles share.
    """
    return run(dict(locals()))


def run(values: Mapping[str, Any]) -> int:
    """Check everything, then render, compare, write and print. `values` : of `stress_command`, by name."""
    from clrast.study.stress import run_stress

    call = make_call(values)
    _check_outputs(call)
    with progress(call.quiet) as show:
        stress = run_stress(call.cases, call.plan, show)
        if call.failures is not None or call.output is not None:
            show("drawing")
            _write(call, stress)
    messages.result(_as_json(stress) if call.json else _as_text(stress))
    if not call.quiet:
        for line in stress.notes:
            messages.note(line)
    return EXIT_CHECK_FAILED if stress.is_broken else EXIT_OK


def make_call(values: Mapping[str, Any]) -> Call:
    """Parse and check all options; raises UsageError. Reads and writes nothing."""
    from clrast.study.hard_cases import ENTRY_NAMES, choose_cases
    from clrast.study.stress import Plan, choose_methods, choose_precisions

    lists = {name: _members(values[name]) for name in ("case", "precision", "method")}
    single = {name: once(name, texts) for name, texts in values.items() if name not in lists}
    machine = {name: single[name] for name in MACHINE_OPTIONS if single[name] is not None}
    make_options(machine, whole=False)
    plan = Plan(
        choose_precisions(lists["precision"]),
        choose_methods(lists["method"], single["long"]),
        machine,
        single["long"],
        must_have=lists["precision"] is not None,
    )
    plan.check()
    failures, output = _last(single["failures"]), _last(single["output"])
    if output is not None and os.path.splitext(output)[1].lower() not in (".html", ".htm"):
        raise UsageError(f"--output {output!r} has no known suffix: name a file .html")
    cases = ENTRY_NAMES if lists["case"] is None else choose_cases(lists["case"])
    return Call(cases, plan, failures, output, single["json"], single["quiet"])


def _members(texts: Sequence[str] | None) -> list[str] | None:
    """The names in comma lists; None where the option was not given."""
    return None if not texts else [name.strip() for text in texts for name in text.split(",")]


def _last(given: Any) -> str | None:
    """The one path of an option that `once` leaves as a list or as a text."""
    if not given:
        return None
    if isinstance(given, str):
        return given
    if len(given) > 1:
        raise UsageError(f"{given[0]!r} and {given[1]!r}: give one of them")
    return str(given[0])


def _check_outputs(call: Call) -> None:
    """Raises OutputError where a file could not be written in the end."""
    if call.output is not None:
        check_writable(call.output, suffixes=None)
    if call.failures is not None:
        try:
            os.makedirs(call.failures, exist_ok=True)
        except (OSError, ValueError) as fault:
            reason = getattr(fault, "strerror", None) or fault
            raise OutputError(f"--failures {call.failures}: {reason}: name another folder") from None
        check_writable(os.path.join(call.failures, "x.png"))


def _write(call: Call, stress: Stress) -> None:
    from clrast.study.stress_page import page
    from clrast.study.stress_pictures import write_failures

    if call.failures is not None:
        write_failures(call.failures, stress)
    if call.output is not None:
        write_text(call.output, page(stress))


def _as_json(stress: Stress) -> str:
    return to_json(stress.as_dict())


def _as_text(stress: Stress) -> str:
    from clrast.commands.stress_table import broken_lines, promise_lines, table_lines, unexpected_lines

    lines = [*table_lines(stress), *unexpected_lines(stress), *broken_lines(stress), *promise_lines(stress)]
    return "\n".join(lines)
