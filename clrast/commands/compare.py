"""`clrast compare`: every method of the continuum on a scene, in time and in instructions, as a table and a plot."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import typer

from clrast.commands import messages
from clrast.commands import parameters as p
from clrast.commands.progress import progress
from clrast.commands.render import check_input, once
from clrast.commands.request import make_request
from clrast.commands.stats import to_json
from clrast.commands.viewpoint import VIEW_NAMES, View, make_view
from clrast.errors import EXIT_OK, UsageError
from clrast.image.files import check_writable, write_whole
from clrast.option_values import check_choice, did_you_mean, parse_count, parse_number
from clrast.options import make_options

if TYPE_CHECKING:
    from clrast.scene.model import Scene
    from clrast.study.compare import Comparison
    from clrast.study.findings import Verdict
    from clrast.study.orders import OrderStudy

SUITES = ("paper",)
OPTIONS = ("size", "precision", "effects", "device", "threads")
"""Options of a render that this command takes."""
MAX_REPETITIONS = 10_000
PANEL = "Comparison"

Input = Annotated[
    str | None, typer.Argument(metavar="INPUT", help="A mesh or a scene card; or give --suite.", show_default=False)
]
MethodList = Annotated[
    p.Texts,
    typer.Option("--methods", metavar="LIST", help="Comma list of methods [default: all].", rich_help_panel=PANEL),
]
Repetitions = Annotated[
    p.Texts,
    typer.Option("--repetitions", metavar="N", help="Frames of each method [default: 7].", rich_help_panel=PANEL),
]
Budget = Annotated[
    p.Texts,
    typer.Option(
        "--budget", metavar="S", rich_help_panel=PANEL,
        help="Seconds of measuring a scene, after which slow methods render no more frames [default: 60].",
    ),
]  # fmt: skip
SuiteName = Annotated[
    p.Texts,
    typer.Option(
        "--suite", metavar="NAME", rich_help_panel=PANEL,
        help="paper: in place of INPUT scenes of the kinds that the paper measured, and which of its findings hold.",
    ),
]  # fmt: skip
SuiteScale = Annotated[
    p.Texts,
    typer.Option(
        "--suite-scale", metavar="S", help="Share of the suite's triangles [default: 1].", rich_help_panel=PANEL
    ),
]
Orders = Annotated[
    bool,
    typer.Option(
        "--orders", rich_help_panel=PANEL,
        help="Also what the order of loops costs: hit rates, shadings and bytes off chip of each, last references.",
    ),
]  # fmt: skip
Output = Annotated[
    p.Texts,
    typer.Option("-o", "--output", metavar="FILE", help="A plot, x.svg or x.png; may be given again.",
                 rich_help_panel=p.OUTPUTS),
]  # fmt: skip


@dataclass(frozen=True)
class Plan:
    """One call of `compare`, checked. `methods` None: all. `suite` : its name, where there is no input."""

    source: str | None
    suite: str | None
    suite_scale: float
    given: dict[str, Any]
    view: View
    methods: tuple[str, ...] | None
    repetitions: int
    budget_s: float
    outputs: tuple[str, ...]
    json: bool
    quiet: bool
    orders: bool


def compare_command(
    input: Input = None,
    suite: SuiteName = None,
    suite_scale: SuiteScale = None,
    methods: MethodList = None,
    repetitions: Repetitions = None,
    budget: Budget = None,
    orders: Orders = False,
    size: p.Size = None,
    eye: p.Eye = None,
    look_at: p.LookAt = None,
    up: p.Up = None,
    fov: p.Fov = None,
    camera: p.CameraName = None,
    projection: p.ProjectionName = None,
    height: p.Height = None,
    precision: p.Precision = None,
    effects: p.Effects = None,
    output: Output = None,
    json: p.StudyJson = False,
    quiet: p.StudyQuiet = False,
    device: p.Device = None,
    threads: p.Threads = None,
) -> int:
    """Measure every method of the continuum on a scene: time, setups, edge evaluations, instructions.

    Times are setup + bin + visibility of a frame; methods take turns, a frame a round.
    """
    return run(dict(locals()))


def run(values: Mapping[str, Any]) -> int:
    """Check everything, then measure, write and print. `values` : of `compare_command`, by name."""
    plan = make_plan(values)
    if plan.source is not None:
        check_input(plan.source)
    for path in plan.outputs:
        check_writable(path, suffixes=None)
    notes: list[str] = []
    studies: list[OrderStudy] = []
    with progress(plan.quiet) as show:
        comparisons = _measure(plan, show, notes, studies)
        verdicts = _judge(comparisons) if plan.suite else ()
        if plan.outputs:
            show("drawing")
            _write_plots(plan.outputs, comparisons)
    as_asked = _as_json(plan, comparisons, verdicts, studies) if plan.json else _as_text(comparisons, verdicts, studies)
    messages.result(as_asked)
    if not plan.quiet:
        for line in notes:
            messages.note(line)
    return EXIT_OK


def make_plan(values: Mapping[str, Any]) -> Plan:
    """Parse and check all options; raises UsageError. Reads and writes nothing."""
    from clrast.study.compare import DEFAULT_BUDGET, DEFAULT_REPETITIONS, choose_methods

    single = {name: once(name, texts) for name, texts in values.items() if name != "methods"}
    given = {name: single[name] for name in OPTIONS if single.get(name) is not None}
    make_options(given, whole=False)
    view = make_view({name: single[name] for name in VIEW_NAMES})
    suite, source, scale = single["suite"], single["input"], single["suite_scale"]
    if (suite is None) == (source is None):
        raise UsageError("give a scene or --suite paper, one of them: see 'clrast compare --help'")
    if suite is None and scale is not None:
        raise UsageError("--suite-scale is of --suite paper: leave it out")
    if suite is not None:
        check_choice("--suite", suite, SUITES)
        if single["orders"]:
            raise UsageError("--orders studies one scene: give it in place of --suite")
        if view.makes_camera or view.camera is not None:
            raise UsageError("--suite brings its own cameras: leave out --eye, --look-at and --camera")
    methods = None
    if values["methods"]:
        methods = choose_methods([name.strip() for text in values["methods"] for name in text.split(",")])
    repetitions, budget = single["repetitions"], single["budget"]
    return Plan(
        source, suite,
        1.0 if scale is None else parse_number("--suite-scale", scale, "a number above 0", above=0.0),
        given, view, methods,
        DEFAULT_REPETITIONS if repetitions is None else parse_count("--repetitions", repetitions, 1, MAX_REPETITIONS),
        DEFAULT_BUDGET if budget is None else parse_number("--budget", budget, "seconds above 0", above=0.0),
        _check_outputs(single["output"] or (), source), single["json"], single["quiet"], single["orders"],
    )  # fmt: skip


def _check_outputs(paths: Sequence[str], source: str | None) -> tuple[str, ...]:
    """The plots' paths, each once; raises UsageError for what can not be drawn, before anything is measured."""
    from clrast.study.compare_plot import PLOT_SUFFIXES, check_available

    if not paths:
        return ()
    unique = {os.path.realpath(path): path for path in paths}
    for path in unique.values():
        suffix = os.path.splitext(path)[1].lower()
        if suffix not in PLOT_SUFFIXES:
            hint = did_you_mean(suffix, PLOT_SUFFIXES)
            raise UsageError(f"--output {path!r} has no known suffix: name a file .svg or .png{hint}")
    if source is not None and os.path.realpath(source) in unique:
        raise UsageError(f"output {source!r} is the input too: give it a file of its own")
    check_available()
    return tuple(unique.values())


def _measure(
    plan: Plan, show: Callable[[str], None], notes: list[str], studies: list[OrderStudy]
) -> list[Comparison]:
    """Each scene in turn; lines to say afterwards are added to `notes`, what the orders cost to `studies`."""
    if plan.source is not None:
        from clrast.scene.load import load

        show(f"loading {plan.source}")
        return [_compare(load(plan.source), plan, plan.source, show, notes, studies)]
    from clrast.study.suite import VIEWS, make_scene, make_view

    found, made = [], {}
    for name, view in VIEWS.items():
        show(f"making {name}")
        if view.scene not in made:
            made = {view.scene: make_scene(view.scene, scale=plan.suite_scale)}
        scene = make_view(name, made[view.scene])
        found.append(_compare(scene, plan, name, partial(_show_of_scene, show, name), notes, studies))
    return found


def _show_of_scene(show: Callable[[str], None], name: str, text: str) -> None:
    show(f"{name}: {text}")


def _compare(
    scene: Scene,
    plan: Plan,
    source: str,
    show: Callable[[str], None],
    notes: list[str],
    studies: list[OrderStudy],
) -> Comparison:
    from clrast.study.compare import compare_scene

    request = make_request(scene, plan.view, plan.given, source)
    for line in (*scene.warnings, *request.warnings):
        messages.warn(line)
    notes += request.notes
    comparison = compare_scene(
        scene, request.camera, request.options, plan.methods, repetitions=plan.repetitions, budget_s=plan.budget_s,
        show=show,
    )  # fmt: skip
    if plan.orders:
        from clrast.study.orders import study_orders

        show("counting what the orders of loops cost")
        studies.append(study_orders(scene, request.camera, request.options))
    return comparison


def _judge(comparisons: Sequence[Comparison]) -> tuple[Verdict, ...]:
    from clrast.study.findings import Measured, judge_findings
    from clrast.study.suite import VIEWS

    return judge_findings(Measured({each.scene: each for each in comparisons}, VIEWS))


def _write_plots(paths: Sequence[str], comparisons: Sequence[Comparison]) -> None:
    """All plots or none: each is written beside its target before the first takes its place."""
    from clrast.study.compare_plot import draw

    pictures = [(path, draw(comparisons, os.path.splitext(path)[1].lower())) for path in paths]
    write_all(pictures)


def write_all(files: Sequence[tuple[str, bytes]]) -> None:
    """Write files by path, all or none: each stands beside its target before the first takes its place."""
    if not files:
        return
    (path, content), *rest = files

    def write(draft: str) -> None:
        with open(draft, "wb") as file:
            file.write(content)
        write_all(rest)

    write_whole(path, write)


def _as_json(
    plan: Plan, comparisons: Sequence[Comparison], verdicts: Sequence[Verdict], studies: Sequence[OrderStudy]
) -> str:
    if plan.suite is None:
        return to_json({**comparisons[0].as_dict(), **{"orders": study.as_json() for study in studies}})
    scenes = [comparison.as_dict() for comparison in comparisons]
    findings = [verdict.as_dict() for verdict in verdicts]
    return to_json({"suite": plan.suite, "suite_scale": plan.suite_scale, "scenes": scenes, "findings": findings})


def _as_text(
    comparisons: Sequence[Comparison], verdicts: Sequence[Verdict], studies: Sequence[OrderStudy]
) -> str:
    """A table and its lines for each scene, then the findings."""
    from clrast.commands.compare_table import finding_lines, operation_lines, order_lines, table_lines

    lines: list[str] = []
    for comparison in comparisons:
        lines += [*table_lines(comparison), ""]
    lines += operation_lines(comparisons)
    for study in studies:
        lines += ["", *order_lines(study)]
    if verdicts:
        lines += ["", *finding_lines(verdicts)]
    return "\n".join(lines)
