"""The curve of `clrast accuracy`: error against the time of a frame, both logarithmic, with the Pareto front marked.

Each knob has a colour and a mark; the spread of times is a bar. Points of the front are filled and named. An error of
zero cannot stand on a logarithmic axis: it stands on the lowest line, which says so.
"""

from __future__ import annotations

import io
import math
from typing import TYPE_CHECKING

from clrast.study.accuracy import Accuracy, Row
from clrast.study.compare_plot import DOTS_PER_INCH, PLOT_SUFFIXES, SETTINGS, check_available

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["PLOT_SUFFIXES", "STYLES", "check_available", "draw", "floor_of", "make_figure", "style_of"]

STYLES = {
    "default": ("#000000", "D"),
    "precision": ("#0072b2", "o"),
    "evaluation": ("#56b4e9", "v"),
    "antialiasing": ("#d55e00", "s"),
    "output": ("#999999", "h"),
    "combination": ("#009e73", "^"),
}
"""Knob -> colour (of Okabe and Ito's set, which colour-blind people tell apart) and matplotlib's mark."""
OTHERS = (("#cc79a7", "P"), ("#e69f00", "X"), ("#7f6000", "<"), ("#6a3d9a", ">"))
"""Of knobs that have no colour of their own, in the order of the table."""

NAME_SIZE, NAME_HEIGHT = 7.0, 8.5
"""Of the names at points, and of a line of them, points."""


def style_of(study: Accuracy, knob: str) -> tuple[str, str]:
    """Colour and mark of a knob."""
    if knob in STYLES:
        return STYLES[knob]
    more = [name for name in dict.fromkeys(row.setting.knob for row in study.rows) if name not in STYLES]
    return OTHERS[more.index(knob) % len(OTHERS)]


def floor_of(study: Accuracy) -> float:
    """Where errors of zero are drawn: a third of the smallest other one."""
    return min((study.error(row) for row in study.rows if study.error(row) > 0), default=1e-6) / 3


def draw(study: Accuracy, suffix: str) -> bytes:
    """The plot as the bytes of a file. suffix : of PLOT_SUFFIXES."""
    check_available()
    import matplotlib

    file = io.BytesIO()
    metadata = {"Date": None} if suffix == ".svg" else {"Software": None}
    with matplotlib.rc_context(SETTINGS):
        make_figure(study).savefig(file, format=suffix[1:], metadata=metadata)
    return file.getvalue()


def make_figure(study: Accuracy) -> Figure:
    """One pair of axes: seconds of a frame to the right, error upwards."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.6, 5.2), layout="constrained", dpi=DOTS_PER_INCH)
    axes = figure.subplots()
    axes.set_xscale("log")
    axes.set_yscale("log")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(lambda value, _: f"{value:g}")
        axis.set_minor_formatter(lambda value, _: "")
    axes.grid(which="major", color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    floor, front = floor_of(study), study.front
    for knob in dict.fromkeys(row.setting.knob for row in study.rows):
        _draw_knob(axes, study, knob, [row for row in study.rows if row.setting.knob == knob], floor)
    steps_x = [row.median_ms / 1000 for row in front]
    steps_y = [max(study.error(row), floor) for row in front]
    axes.step(steps_x, steps_y, where="post", color="0.35", linewidth=0.9, zorder=1.5, label="Pareto front")
    if any(study.error(row) == 0 for row in study.rows):
        axes.axhline(floor, color="0.6", linewidth=0.6, linestyle=":")
        axes.annotate("no error", (0.01, floor), xycoords=("axes fraction", "data"), fontsize=7, va="bottom")
    width, height = study.size
    axes.set_xlabel("seconds of a frame (median, 10th to 90th percentile)")
    axes.set_ylabel(f"{study.metric} of linear colour against {study.reference.options.aa}, exact")
    axes.set_title(f"{study.scene}: {study.triangle_count:,} triangles at {width}x{height}, {study.device}", fontsize=9)
    axes.legend(fontsize=7, frameon=False, loc="upper right")
    axes.margins(0.1)
    figure.draw_without_rendering()  # where points stand is known from now on
    _name_points(axes, [row.name for row in front], list(zip(steps_x, steps_y, strict=True)))
    return figure


def _name_points(axes: Axes, names: list[str], points: list[tuple[float, float]]) -> None:
    """Names below the front's points to the left, fastest first: nothing else is there. None covers another."""
    last_y = math.inf
    for name, point in zip(names, points, strict=True):
        y = float(axes.transData.transform(point)[1]) * 72 / DOTS_PER_INCH
        last_y = min(y, last_y) - NAME_HEIGHT
        axes.annotate(
            name, point, xytext=(-7, last_y - y), textcoords="offset points", fontsize=NAME_SIZE,
            ha="right", va="center",
            arrowprops={"arrowstyle": "-", "color": "0.6", "linewidth": 0.5, "shrinkA": 0, "shrinkB": 3},
        )  # fmt: skip


def _draw_knob(axes: Axes, study: Accuracy, knob: str, rows: list[Row], floor: float) -> None:
    color, mark = style_of(study, knob)
    front = {row.name for row in study.front}
    for k, row in enumerate(rows):
        x, y = row.median_ms / 1000, max(study.error(row), floor)
        low, high = row.percentile(10) / 1000, row.percentile(90) / 1000
        axes.errorbar(
            x, y, xerr=[[x - low], [high - x]], color=color, marker=mark, markersize=5.5, linewidth=0.8, capsize=1.5,
            markerfacecolor=color if row.name in front else "white", linestyle="none",
            label=knob if k == 0 else None,
        )  # fmt: skip
