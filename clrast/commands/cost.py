"""`clrast cost`: the streaming cost model on a scene, counted and measured, as tables and a plot."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
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
from clrast.option_values import did_you_mean, parse_count
from clrast.options import make_options

if TYPE_CHECKING:
    from clrast.study.cost import CostStudy

OPTIONS = ("size", "precision", "effects", "grid_resolution", "device", "threads")
"""Options of a render that this command takes."""
MAX_REPETITIONS = 1000
PANEL = "Cost"

Input = Annotated[str, typer.Argument(metavar="INPUT", help="A mesh or a scene card.", show_default=False)]
Repetitions = Annotated[
    p.Texts,
    typer.Option("--repetitions", metavar="N", help="Frames of each setting [default: 5].", rich_help_panel=PANEL),
]
Output = Annotated[
    p.Texts,
    typer.Option("-o", "--output", metavar="FILE", help="A plot, x.svg or x.png; may be given again.",
                 rich_help_panel=p.OUTPUTS),
]  # fmt: skip


@dataclass(frozen=True)
class Plan:
    """One call of `cost`, checked."""

    source: str
    given: dict[str, Any]
    view: View
    repetitions: int
    outputs: tuple[str, ...]
    json: bool
    quiet: bool


def cost_command(
    input: Input,
    repetitions: Repetitions = None,
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
    grid_resolution: p.GridResolution = None,
    output: Output = None,
    json: p.StudyJson = False,
    quiet: p.StudyQuiet = False,
    device: p.Device = None,
    threads: p.Threads = None,
) -> int:
    """What streaming ray tracing on a grid costs here: steps, tests, passes, bytes, cache hits, milliseconds.

    Images have 256x256 pixels unless --size says otherwise: every ray is traced word by word.
    """
    return run(dict(locals()))


def run(values: Mapping[str, Any]) -> int:
    """Check everything, then measure, write and print. `values` : of `cost_command`, by name."""
    plan = make_plan(values)
    check_input(plan.source)
    for path in plan.outputs:
        check_writable(path, suffixes=None)
    notes: list[str] = []
    with progress(plan.quiet) as show:
        study = _study(plan, show, notes)
        if plan.outputs:
            show("drawing")
            _write_plots(plan.outputs, study)
    if plan.json:
        messages.result(to_json(study.as_dict()))
    else:
        from clrast.commands.cost_table import study_lines

        messages.result("\n".join(study_lines(study)))
    if not plan.quiet:
        for line in notes:
            messages.note(line)
    return EXIT_OK


def make_plan(values: Mapping[str, Any]) -> Plan:
    """Parse and check all options; raises UsageError. Reads and writes nothing."""
    from clrast.study.cost import DEFAULT_REPETITIONS

    single = {name: once(name, texts) for name, texts in values.items()}
    given = {name: single[name] for name in OPTIONS if single.get(name) is not None}
    make_options({**given, "method": "raycast-grid"})
    repetitions = single["repetitions"]
    return Plan(
        single["input"], given, make_view({name: single[name] for name in VIEW_NAMES}),
        DEFAULT_REPETITIONS if repetitions is None else parse_count("--repetitions", repetitions, 1, MAX_REPETITIONS),
        _check_outputs(single["output"] or (), single["input"]), single["json"], single["quiet"],
    )  # fmt: skip


def _check_outputs(paths: Sequence[str], source: str) -> tuple[str, ...]:
    """The plots' paths, each once; raises UsageError for what can not be drawn, before anything is measured."""
    from clrast.study.compare_plot import PLOT_SUFFIXES, check_available

    unique = {os.path.realpath(path): path for path in paths}
    for path in unique.values():
        suffix = os.path.splitext(path)[1].lower()
        if suffix not in PLOT_SUFFIXES:
            hint = did_you_mean(suffix, PLOT_SUFFIXES)
            raise UsageError(f"--output {path!r} has no known suffix: name a file .svg or .png{hint}")
    if os.path.realpath(source) in unique:
        raise UsageError(f"output {source!r} is the input too: give it a file of its own")
    if unique:
        check_available()
    return tuple(unique.values())


def _study(plan: Plan, show: Callable[[str], None], notes: list[str]) -> CostStudy:
    from clrast.scene.load import load
    from clrast.study.cost import DEFAULT_SIZE, study_cost

    show(f"loading {plan.source}")
    scene = load(plan.source)
    given = {"size": DEFAULT_SIZE, **plan.given, "method": "raycast-grid"}
    request = make_request(scene, plan.view, given, plan.source)
    for line in (*scene.warnings, *request.warnings):
        messages.warn(line)
    notes += request.notes
    return study_cost(scene, request.camera, request.options, repetitions=plan.repetitions, show=show)


def _write_plots(paths: Sequence[str], study: CostStudy) -> None:
    """All plots or none: each is written beside its target before the first takes its place."""
    from clrast.study.cost_plot import draw

    _write_all([(path, draw(study, os.path.splitext(path)[1].lower())) for path in paths])


def _write_all(files: Sequence[tuple[str, bytes]]) -> None:
    if not files:
        return
    (path, content), *rest = files

    def write(draft: str) -> None:
        with open(draft, "wb") as file:
            file.write(content)
        _write_all(rest)

    write_whole(path, write)
