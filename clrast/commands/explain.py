"""`clrast explain`: which effects a scene calls for, why, and what each is expected to take."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

import typer

from clrast.commands import messages
from clrast.commands import parameters as p
from clrast.commands.progress import progress
from clrast.commands.render import check_input, once
from clrast.commands.request import make_request
from clrast.commands.stats import to_json
from clrast.commands.viewpoint import VIEW_NAMES, make_view
from clrast.errors import EXIT_OK
from clrast.options import OPTION_NAMES, make_options

if TYPE_CHECKING:
    from clrast.study.explain import Explanation

PlanOnly = Annotated[
    bool, typer.Option("--plan-only", help="Render no small image: no expected rays and times.")
]  # fmt: skip


def explain_command(
    input: p.Input,
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
    samples: p.Samples = None,
    seed: p.Seed = None,
    max_depth: p.MaxDepth = None,
    method: p.Method = None,
    accelerator: p.Accelerator = None,
    mode: p.Mode = None,
    effects: p.Effects = None,
    aov: p.Aov = None,
    plan_only: PlanOnly = False,
    json: p.StudyJson = False,
    quiet: p.StudyQuiet = False,
    device: p.Device = None,
    threads: p.Threads = None,
) -> int:
    """Print which effects a render of INPUT calls for, with a reason for each, and what each will cost.

    Expected figures come from a small image of the same view.
    """
    return run(dict(locals()))


def run(values: Mapping[str, Any]) -> int:
    """Check everything, probe and print. `values` : of `explain_command`, by name."""
    single = {name: once(name, texts) for name, texts in values.items()}
    given = {name: single[name] for name in OPTION_NAMES if single.get(name) not in (None, False)}
    make_options(given, whole=False)
    view = make_view({name: single[name] for name in VIEW_NAMES})
    check_input(single["input"])
    from clrast.scene.load import load
    from clrast.study.explain import explain

    with progress(single["quiet"]) as show:
        show(f"loading {single['input']}")
        scene = load(single["input"])
        request = make_request(scene, view, given, single["input"])
        for line in (*scene.warnings, *request.warnings):
            messages.warn(line)
        show("rendering small images" if not single["plan_only"] else "planning")
        explanation = explain(scene, request.camera, request.options, not single["plan_only"])
    messages.result(to_json(explanation.as_dict()) if single["json"] else "\n".join(table_lines(explanation)))
    if not single["quiet"]:
        for line in request.notes:
            messages.note(line)
    return EXIT_OK


def table_lines(explanation: Explanation) -> list[str]:
    """The effects as lines of a table, and what the figures are of."""
    rows: list[tuple[str, ...]] = [("effect", "on", "rays", "ms", "MiB", "called for by, or why not", "kernels")]
    for row in explanation.rows:
        rays = "" if row.rays is None or not row.on else f"{row.rays:,}"
        ms = "" if row.ms is None or not row.on else f"{row.ms:.1f}"
        memory = f"{row.nbytes / 2**20:.1f}" if row.nbytes else ""
        rows.append((row.name, "on" if row.on else "off", rays, ms, memory, row.reason, ", ".join(row.kernels)))
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = []
    for cells_of in rows:
        sized = enumerate(zip(cells_of, widths, strict=True))
        cells = [cell.rjust(width) if 2 <= k <= 4 else cell.ljust(width) for k, (cell, width) in sized]
        lines.append("  ".join(cells).rstrip())
    if explanation.probe_size is not None:
        width, height = explanation.probe_size
        lines += ["", f"expected frame {explanation.frame_ms:.0f} ms, by an image of {width}x{height} of the same view"]
    return lines
