"""The plot of a page as SVG text: error against time, both logarithmic, a shape for each setting that can be chosen."""

from __future__ import annotations

import html
import math

from clrast.study.accuracy import Accuracy, Row
from clrast.study.accuracy_plot import floor_of, style_of

WIDTH, HEIGHT = 640, 460
LEFT, RIGHT, TOP, BOTTOM = 64, 16, 16, 46
RADIUS = 5.5


class Axis:
    """A logarithmic axis: `low` to `high` on `begin` to `end`, SVG units."""

    def __init__(self, values: list[float], begin: float, end: float) -> None:
        low, high = math.log10(min(values)), math.log10(max(values))
        margin = max(0.08 * (high - low), 0.1)
        self.low, self.high = low - margin, high + margin
        self.begin, self.end = begin, end

    def place(self, value: float) -> float:
        share = (math.log10(value) - self.low) / (self.high - self.low)
        return self.begin + share * (self.end - self.begin)

    def ticks(self) -> list[float]:
        """1, 2 and 5 times powers of ten, or the powers alone where there are many."""
        powers = range(math.floor(self.low), math.ceil(self.high) + 1)
        steps = (1, 2, 5) if self.high - self.low < 2.5 else (1,)
        values = [step * 10.0**power for power in powers for step in steps]
        return [value for value in values if self.low <= math.log10(value) <= self.high]


def chart(study: Accuracy) -> str:
    """The SVG element; each setting is a `g` of class `point` with its place in the table as `data-index`."""
    floor = floor_of(study)
    rows = [row for row in study.rows if math.isfinite(study.error(row))]
    times = [value / 1000 for row in rows for value in (row.percentile(10), row.percentile(90))]
    x_axis = Axis(times, LEFT, WIDTH - RIGHT)
    y_axis = Axis([max(study.error(row), floor) for row in rows], HEIGHT - BOTTOM, TOP)
    parts = [f'<svg id="chart" viewBox="0 0 {WIDTH} {HEIGHT}" role="group" aria-label="error against time">']
    parts += _grid(x_axis, y_axis)
    label = html.escape(f"{study.metric} of linear colour")
    parts.append(f'<text class="title" x="{(LEFT + WIDTH) / 2}" y="{HEIGHT - 8}">seconds of a frame</text>')
    parts.append(f'<text class="title" transform="translate(14 {HEIGHT / 2}) rotate(-90)">{label}</text>')
    parts.append(_front_line(study, x_axis, y_axis, floor))
    front = {row.name for row in study.front}
    for row in sorted(rows, key=lambda each: each.name in front):  # those of the front above the others
        place = (x_axis.place(row.median_ms / 1000), y_axis.place(max(study.error(row), floor)))
        parts.append(_point(study, row, study.rows.index(row), place, x_axis, row.name in front))
    parts.append("</svg>")
    return "\n".join([*parts, _legend(study)])


def _grid(x_axis: Axis, y_axis: Axis) -> list[str]:
    parts = []
    for value in x_axis.ticks():
        x = x_axis.place(value)
        parts.append(f'<path class="grid" d="M{x:.1f} {TOP}V{HEIGHT - BOTTOM}"/>')
        parts.append(f'<text class="tick" x="{x:.1f}" y="{HEIGHT - BOTTOM + 15}" text-anchor="middle">{value:g}</text>')
    for value in y_axis.ticks():
        y = y_axis.place(value)
        parts.append(f'<path class="grid" d="M{LEFT} {y:.1f}H{WIDTH - RIGHT}"/>')
        parts.append(f'<text class="tick" x="{LEFT - 6}" y="{y + 3.5:.1f}" text-anchor="end">{value:g}</text>')
    return parts


def _front_line(study: Accuracy, x_axis: Axis, y_axis: Axis, floor: float) -> str:
    """Steps: from each point of the front to the time from which on the next is to be had."""
    path = ""
    for row in study.front:
        x, y = x_axis.place(row.median_ms / 1000), y_axis.place(max(study.error(row), floor))
        path += f"H{x:.1f}V{y:.1f}" if path else f"M{x:.1f} {y:.1f}"
    return f'<path class="front" d="{path}"/>'


def _point(
    study: Accuracy, row: Row, index: int, place: tuple[float, float], x_axis: Axis, is_on_front: bool
) -> str:
    x, y = place
    color, _ = style_of(study, row.setting.knob)
    low, high = (x_axis.place(row.percentile(share) / 1000) for share in (10, 90))
    title = f"{row.name}: {row.median_ms / 1000:.3g} s, {study.metric} {study.error(row):.3g}"
    return (
        f'<g class="point{" on-front" if is_on_front else ""}" data-index="{index}" tabindex="0" role="button" '
        f'style="--color:{color}"><title>{html.escape(title)}</title>'
        f'<path class="spread" d="M{low:.1f} {y:.1f}H{high:.1f}"/>'
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{RADIUS}"/></g>'
    )


def _legend(study: Accuracy) -> str:
    knobs = dict.fromkeys(row.setting.knob for row in study.rows)
    marks = [
        f'<span class="key" style="--color:{style_of(study, knob)[0]}">{html.escape(knob)}</span>' for knob in knobs
    ]
    return f'<p class="legend">{" ".join(marks)} <span>filled: on the Pareto front</span></p>'
