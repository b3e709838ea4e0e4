"""`clrast accuracy`: error against time for every knob, the Pareto front, and what to take when time is short."""

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
from clrast.image.files import check_writable
from clrast.option_values import check_choice, did_you_mean, listed, parse_count, parse_number
from clrast.options import make_options
from clrast.study.accuracy_knobs import KNOB_NAMES

if TYPE_CHECKING:
    from clrast.study.accuracy import Accuracy
    from clrast.study.accuracy_answers import Answer
    from clrast.study.accuracy_page import Pictures

OPTIONS = (
    "size", "precision", "aa", "shading_rate", "filter", "evaluation", "samples", "seed", "max_depth", "quality",
    "method", "oracle", "intersection", "accelerator", "grid_resolution", "mode", "effects", "half", "device",
    "threads",
)  # fmt: skip
"""Options of a render that this command takes: they are the default setting, from which each knob is turned alone."""
DEFAULT_SIZE = (512, 512)
"""Where neither the user nor a card says: the reference takes a thousand samples of each pixel."""
SUFFIXES = (".svg", ".png", ".html", ".json")
PANEL = "Study"

Time = Annotated[
    p.Texts,
    typer.Option("--time", metavar="S", rich_help_panel=PANEL, show_default=False,
                 help="Seconds: print the command of the most accurate setting within them."),
]  # fmt: skip
TimeOf = Annotated[
    p.Texts,
    typer.Option("--time-of", metavar="WHAT", rich_help_panel=PANEL, show_default=False,
                 help="What --time counts: command [default], from starting to writing, or frame alone."),
]  # fmt: skip
Error = Annotated[
    p.Texts,
    typer.Option("--error", metavar="E", rich_help_panel=PANEL, show_default=False,
                 help="Print the command of the cheapest setting whose error is at most E."),
]  # fmt: skip
Metric = Annotated[
    p.Texts,
    typer.Option("--metric", metavar="NAME", rich_help_panel=PANEL, show_default=False,
                 help="Of the front and of --error: rmse [default], mse, relative-mse, flip or worst."),
]  # fmt: skip
Knobs = Annotated[
    p.Texts,
    typer.Option("--knobs", metavar="LIST", rich_help_panel=PANEL, show_default=False,
                 help=f"Comma list of {listed(KNOB_NAMES)} [default: all]."),
]  # fmt: skip
ReferenceSamples = Annotated[
    p.Texts,
    typer.Option("--reference-samples", metavar="N", rich_help_panel=PANEL, show_default=False,
                 help="Samples a pixel of the reference, 4 to 1024 [default: 1024]."),
]  # fmt: skip
Budget = Annotated[
    p.Texts,
    typer.Option("--budget", metavar="S", rich_help_panel=PANEL, show_default=False,
                 help="Seconds of measured frames; more of them tell closer settings apart [default: 60]."),
]  # fmt: skip
NoCache = Annotated[
    bool, typer.Option("--no-cache", rich_help_panel=PANEL, help="Render the reference anew, and do not keep it.")
]
NoCheck = Annotated[
    bool, typer.Option("--no-check", rich_help_panel=PANEL, help="Do not run what --time and --error give.")
]
Output = Annotated[
    p.Texts,
    typer.Option("-o", "--output", metavar="FILE", rich_help_panel=p.OUTPUTS, show_default=False,
                 help="A plot, x.svg or x.png; x.html, a page; x.json, the table; may be given again."),
]  # fmt: skip
Html = Annotated[
    p.Texts,
    typer.Option("--html", metavar="FILE", rich_help_panel=p.OUTPUTS, show_default=False,
                 help="A page that needs no other file: each point with its image beside the reference."),
]  # fmt: skip
PageSide = Annotated[
    p.Texts,
    typer.Option("--page-side", metavar="N", rich_help_panel=p.OUTPUTS, show_default=False,
                 help="Largest side of the page's pictures in pixels; larger images are cut to where the default is "
                      "most wrong [default: what fits into some MB]."),
]  # fmt: skip


@dataclass(frozen=True)
class Plan:
    """One call of `accuracy`, checked. given, typed_view : options of a render as they were typed."""

    source: str
    given: dict[str, Any]
    view: View
    typed_view: dict[str, Any]
    time_s: float | None
    time_of: str
    error: float | None
    metric: str
    knobs: tuple[str, ...]
    reference_samples: int
    budget_s: float
    use_cache: bool
    check: bool
    outputs: tuple[str, ...]
    page_side: int | None
    json: bool
    quiet: bool


def accuracy_command(
    input: p.Input,
    time: Time = None,
    time_of: TimeOf = None,
    error: Error = None,
    metric: Metric = None,
    knobs: Knobs = None,
    reference_samples: ReferenceSamples = None,
    budget: Budget = None,
    no_cache: NoCache = False,
    no_check: NoCheck = False,
    size: p.Size = None,
    eye: p.Eye = None,
    look_at: p.LookAt = None,
    up: p.Up = None,
    fov: p.Fov = None,
    camera: p.CameraName = None,
    projection: p.ProjectionName = None,
    height: p.Height = None,
    precision: p.Precision = None,
    aa: p.Antialiasing = None,
    shading_rate: p.ShadingRate = None,
    filter: p.Filter = None,
    evaluation: p.Evaluation = None,
    samples: p.Samples = None,
    seed: p.Seed = None,
    max_depth: p.MaxDepth = None,
    quality: p.Quality = None,
    method: p.Method = None,
    oracle: p.Oracle = None,
    intersection: p.Intersection = None,
    accelerator: p.Accelerator = None,
    grid_resolution: p.GridResolution = None,
    mode: p.Mode = None,
    effects: p.Effects = None,
    half: p.Half = False,
    output: Output = None,
    html: Html = None,
    page_side: PageSide = None,
    json: p.StudyJson = False,
    quiet: p.StudyQuiet = False,
    device: p.Device = None,
    threads: p.Threads = None,
) -> int:
    """Measure what accuracy costs on a scene: the error and the time of every setting, and which are worth their time.

    Errors are those of linear colour against an image with 1024 samples a pixel by exact arithmetic, which is kept
    between runs. Options of a render are the default, from which each knob is turned. Without --size: 512x512.
    """
    return run(dict(locals()))


def run(values: Mapping[str, Any]) -> int:
    """Check everything, then measure, answer, write and print. `values` : of `accuracy_command`, by name."""
    plan = make_plan(values)
    check_input(plan.source)
    for path in plan.outputs:
        check_writable(path, suffixes=None)
    notes: list[str] = []
    with progress(plan.quiet) as show:
        study, pictures = _measure(plan, show, notes)
        commands = _commands(plan, study)
        answers = _answer(plan, study, commands, show)
        text = _as_json(study, answers, commands)
        if plan.outputs:
            show("drawing")
            _write(plan, study, pictures, commands, text)
    messages.result(text if plan.json else _as_text(study, answers, commands))
    if not plan.quiet:
        for line in notes:
            messages.note(line)
    return EXIT_OK


def make_plan(values: Mapping[str, Any]) -> Plan:
    """Parse and check all options; raises UsageError. Reads and writes nothing."""
    from clrast.study.accuracy import DEFAULT_BUDGET
    from clrast.study.accuracy_answers import OF_COMMAND, TIMES
    from clrast.study.accuracy_errors import DEFAULT_METRIC, METRICS, check_metric
    from clrast.study.accuracy_knobs import REFERENCE_SAMPLES

    single = {name: once(name, texts) for name, texts in values.items() if name != "knobs"}
    given = {name: single[name] for name in OPTIONS if single.get(name) not in (None, False)}
    make_options(given, whole=False)
    typed_view = {name: single[name] for name in VIEW_NAMES if single[name] is not None}
    metric = check_choice("--metric", single["metric"] or DEFAULT_METRIC, METRICS)
    check_metric(metric)
    time_of = check_choice("--time-of", single["time_of"] or OF_COMMAND, TIMES)
    if single["time_of"] and single["time"] is None:
        raise UsageError("--time-of says what --time counts: give --time too")

    def positive(name: str, unit: str, default: float | None = None) -> float | None:
        text = single[name]
        return default if text is None else parse_number(f"--{name}", text, f"{unit} above 0", above=0.0)

    samples, side = single["reference_samples"], single["page_side"]
    outputs = _check_outputs([*(single["output"] or ()), *([single["html"]] if single["html"] else ())], single)
    return Plan(
        single["input"], given, make_view({name: single[name] for name in VIEW_NAMES}), typed_view,
        positive("time", "seconds"), time_of, positive("error", "a number"), metric, _knobs(values["knobs"]),
        REFERENCE_SAMPLES if samples is None else parse_count("--reference-samples", samples, 4, REFERENCE_SAMPLES),
        positive("budget", "seconds", DEFAULT_BUDGET) or DEFAULT_BUDGET,
        not single["no_cache"], not single["no_check"], outputs,
        None if side is None else parse_count("--page-side", side, 16, 4096), single["json"], single["quiet"],
    )  # fmt: skip


def _knobs(texts: Sequence[str] | None) -> tuple[str, ...]:
    """The names in comma lists, in the order of the table; all where none is given."""
    wanted = [name.strip() for text in texts or () for name in text.split(",")]
    for name in wanted:
        check_choice("--knobs", name, KNOB_NAMES)
    return tuple(name for name in KNOB_NAMES if name in wanted or not wanted)


def _check_outputs(paths: Sequence[str], single: Mapping[str, Any]) -> tuple[str, ...]:
    """The files' paths, each once; raises UsageError for what can not be made, before anything is measured."""
    from clrast.study.accuracy_plot import PLOT_SUFFIXES, check_available

    unique = {os.path.realpath(path): path for path in paths}
    for path in unique.values():
        suffix = _suffix(path)
        if path == single["html"] and suffix not in (".html", ".htm"):
            raise UsageError(f"--html {path!r} is a page: name a file .html")
        if path != single["html"] and suffix not in SUFFIXES:
            hint = did_you_mean(suffix, SUFFIXES)
            raise UsageError(f"--output {path!r} has no known suffix: name a file .svg, .png, .html or .json{hint}")
    if os.path.realpath(single["input"]) in unique:
        raise UsageError(f"output {single['input']!r} is the input too: give it a file of its own")
    if any(_suffix(path) in PLOT_SUFFIXES for path in unique.values()):
        check_available()
    if single["page_side"] is not None and not any(_suffix(path) in (".html", ".htm") for path in unique.values()):
        raise UsageError("--page-side is of the page's pictures: give --html x.html too")
    return tuple(unique.values())


def _suffix(path: str) -> str:
    return os.path.splitext(path)[1].lower()


def _measure(plan: Plan, show: Callable[[str], None], notes: list[str]) -> tuple[Accuracy, Pictures | None]:
    """The study, and the images of a page if there is one; lines to say afterwards are added to `notes`."""
    from clrast.scene.load import load
    from clrast.study.accuracy import study_accuracy

    show(f"loading {plan.source}")
    scene = load(plan.source)
    given = dict(plan.given)
    if scene.image_size is None and "size" not in scene.render_options:
        given.setdefault("size", DEFAULT_SIZE)
    request = make_request(scene, plan.view, given, plan.source)
    for line in (*scene.warnings, *request.warnings):
        messages.warn(line)
    notes += request.notes
    pictures = None
    if any(_suffix(path) in (".html", ".htm") for path in plan.outputs):
        from clrast.study.accuracy_page import Pictures

        pictures = Pictures(plan.page_side)
    study = study_accuracy(
        scene, request.camera, request.options, metric=plan.metric, reference_samples=plan.reference_samples,
        knobs=plan.knobs, budget_s=plan.budget_s, use_cache=plan.use_cache,
        keep=pictures.add if pictures else None, show=show,
    )  # fmt: skip
    return study, pictures


def _commands(plan: Plan, study: Accuracy) -> dict[str, list[str]]:
    from clrast.commands.accuracy_call import command_of

    return {row.name: command_of(row, study.size, plan.source, plan.given, plan.typed_view) for row in study.rows}


def _answer(
    plan: Plan, study: Accuracy, commands: Mapping[str, Sequence[str]], show: Callable[[str], None]
) -> list[Answer]:
    """What was asked by --time and --error; where the time is too short for any command, also of frames alone."""
    from clrast.commands.accuracy_call import CommandRunner
    from clrast.study.accuracy_answers import OF_COMMAND, OF_FRAME, Advisor

    if plan.time_s is None and plan.error is None:
        return []
    show("running the commands of the answers")
    answers: list[Answer] = []
    with CommandRunner(study, commands) as runner:
        advisor = Advisor(study, runner if plan.check else None)
        if plan.time_s is not None:
            time_of = plan.time_of if plan.check else OF_FRAME
            answers.append(advisor.within_time(plan.time_s, time_of))
            if time_of == OF_COMMAND and not answers[-1].reached:
                answers.append(advisor.within_time(plan.time_s, OF_FRAME))
        if plan.error is not None:
            answers.append(advisor.for_error(plan.error))
    return answers


def _write(
    plan: Plan, study: Accuracy, pictures: Pictures | None, commands: Mapping[str, Sequence[str]], table: str
) -> None:
    """All files or none: each is written beside its target before the first takes its place."""
    from clrast.commands.accuracy_call import as_line
    from clrast.commands.compare import write_all
    from clrast.study.accuracy_plot import draw

    files: list[tuple[str, bytes]] = []
    for path in plan.outputs:
        suffix = _suffix(path)
        if suffix == ".json":
            files.append((path, table.encode("utf-8")))
        elif suffix in (".html", ".htm"):
            from clrast.study.accuracy_page import page

            assert pictures is not None
            lines = {name: as_line(words) for name, words in commands.items()}
            files.append((path, page(study, pictures, lines).encode("utf-8")))
        else:
            files.append((path, draw(study, suffix)))
    write_all(files)


def _as_json(study: Accuracy, answers: Sequence[Answer], commands: Mapping[str, Sequence[str]]) -> str:
    own = {**study.as_dict(), "commands": {name: list(words) for name, words in commands.items()}}
    return to_json({**own, "answers": [each.as_dict(commands[each.row.name], study.metric) for each in answers]})


def _as_text(study: Accuracy, answers: Sequence[Answer], commands: Mapping[str, Sequence[str]]) -> str:
    from clrast.commands.accuracy_table import answer_lines, table_lines

    return "\n".join([*table_lines(study), *answer_lines(study, answers, commands)])
