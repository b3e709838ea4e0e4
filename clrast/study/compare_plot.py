"""The two bar graphs of Davidovic et al., '3D Rasterization', Fig. 9, for any methods and scenes.

Top: time relative to the baseline, with its spread. Bottom: instructions relative to the baseline, the part of the
setups in a darker shade. Where the baseline was not measured both are absolute.
"""

from __future__ import annotations

import colorsys
import io
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from clrast.errors import UsageError
from clrast.study.compare import Comparison, MethodRow
from clrast.visibility.methods import BASELINE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PLOT_SUFFIXES = (".svg", ".png")
LOG_RANGE = 12.0
"""From this ratio of the longest bar to the shortest on the scale is logarithmic."""
DOTS_PER_INCH = 150
HUES = {"2dr": 0.08, "2dh": 0.13, "3dr": 0.58, "raycast": 0.38}
"""Colour of a family of methods; the members differ in lightness."""
DARKER = 0.55
SETTINGS: dict[Any, Any] = {
    "svg.fonttype": "none",  # letters stay text
    "svg.hashsalt": "clrast",  # the same bars are the same file
    "text.parse_math": False,  # a scene's name may hold any sign
    "font.size": 9.0,
    "font.family": "sans-serif",
}


def check_available() -> None:
    """Raises UsageError where the library that draws is missing."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        mend = "install it with pip install 'clrast[plot]', or leave out -o"
        raise UsageError(f"a plot needs matplotlib: {mend}") from None


def draw(comparisons: Sequence[Comparison], suffix: str) -> bytes:
    """The plot as the bytes of a file. suffix : of PLOT_SUFFIXES."""
    check_available()
    import matplotlib

    file = io.BytesIO()
    metadata = {"Date": None} if suffix == ".svg" else {"Software": None}
    with matplotlib.rc_context(SETTINGS):
        make_figure(comparisons).savefig(file, format=suffix[1:], metadata=metadata)
    return file.getvalue()


def make_figure(comparisons: Sequence[Comparison]) -> Figure:
    """Times above instructions; methods beside one another, in groups where there are several scenes."""
    from matplotlib.figure import Figure

    methods = method_order(comparisons)
    end = len(comparisons) * (len(methods) + 1.0) - 1
    width = max(7.0, 1.5 + (0.62 if len(comparisons) == 1 else 0.27) * end)
    figure = Figure(figsize=(width, 7.2), layout="constrained", dpi=DOTS_PER_INCH)
    top, bottom = figure.subplots(2, 1, sharex=True)
    bottom.set_xlim(-1.0, end)
    relative = all(each.row(BASELINE) for each in comparisons)
    _draw_times(top, comparisons, methods, relative)
    _draw_instructions(bottom, comparisons, methods, relative)
    _label_bars(bottom, comparisons, methods, relative)
    if len(comparisons) > 1:
        handles = [_handle(name, methods) for name in methods]
        figure.legend(handles=handles, loc="outside upper center", ncols=6, frameon=False)
    else:
        only = comparisons[0]
        columns, rows = only.size
        figure.suptitle(f"{only.scene}: {only.triangle_count:,} triangles at {columns}x{rows}, {only.device}")
    return figure


def method_order(comparisons: Sequence[Comparison]) -> tuple[str, ...]:
    """The methods of all comparisons, in the order in which they were measured."""
    return tuple(dict.fromkeys(row.method for each in comparisons for row in each.rows))


def color_of(method: str, methods: Sequence[str]) -> tuple[float, float, float]:
    """RGB, 0 to 1: a hue by the family, which the name begins with, and a lightness by the place in it."""
    family = method.split("-")[0]
    members = [name for name in methods if name.split("-")[0] == family]
    lightness = 0.74 - 0.3 * members.index(method) / max(1, len(members) - 1) if len(members) > 1 else 0.6
    return colorsys.hls_to_rgb(HUES.get(family, 0.83), lightness, 0.55)


def _handle(method: str, methods: Sequence[str]) -> Any:
    from matplotlib.patches import Patch

    return Patch(color=color_of(method, methods), label=method)


def _places(comparisons: Sequence[Comparison], methods: Sequence[str]) -> list[tuple[float, Comparison, MethodRow]]:
    """Where each bar stands: scenes apart, in each the methods side by side."""
    places = []
    for group, comparison in enumerate(comparisons):
        for number, name in enumerate(methods):
            row = comparison.row(name)
            if row is not None:
                places.append((group * (len(methods) + 1.0) + number, comparison, row))
    return places


def _draw_times(axes: Axes, comparisons: Sequence[Comparison], methods: Sequence[str], relative: bool) -> None:
    def unit(comparison: Comparison) -> float:
        base = comparison.row(BASELINE)
        return base.median_ms if relative and base else 1.0

    places = _places(comparisons, methods)
    heights = [row.median_ms / unit(c) for _, c, row in places]
    floor = _scale(axes, heights, relative)
    for (x, c, row), height in zip(places, heights, strict=True):
        axes.bar(x, height - floor, bottom=floor, width=0.84, color=color_of(row.method, methods))
        low, high = row.percentile(10) / unit(c), row.percentile(90) / unit(c)
        axes.errorbar(x, height, [[height - low], [high - height]], color="0.25", linewidth=0.8, capsize=1.5)
        _write(axes, x, max(height, high), height)
    axes.set_ylabel(f"time relative to {BASELINE}" if relative else "time, ms")


def _draw_instructions(axes: Axes, comparisons: Sequence[Comparison], methods: Sequence[str], relative: bool) -> None:
    def height_of(comparison: Comparison, row: MethodRow) -> float | None:
        return comparison.instruction_ratio(row.method) if relative else row.instructions

    places = [(x, row, h) for x, c, row in _places(comparisons, methods) if (h := height_of(c, row)) is not None]
    floor = _scale(axes, [height for _, _, height in places], relative)
    for x, row, height in places:
        color = color_of(row.method, methods)
        axes.bar(x, height - floor, bottom=floor, width=0.84, color=color)
        # On either scale the dark part is that share of the bar's length.
        share = row.setup_share or 0.0
        dark = floor * (height / floor) ** share if floor > 0 else height * share
        axes.bar(x, dark - floor, bottom=floor, width=0.84, color=[DARKER * part for part in color])
        _write(axes, x, height, height)
    label = f"instructions relative to {BASELINE}" if relative else "instructions a frame"
    axes.set_ylabel(f"{label}\n(dark: setups)")


def _scale(axes: Axes, heights: Sequence[float], relative: bool) -> float:
    """Choose a linear or a logarithmic scale; returns where bars begin: 0, or a power of ten below the shortest."""
    positive = [height for height in heights if height > 0]
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="y", color="0.88", linewidth=0.6)
    axes.set_axisbelow(True)
    if relative:
        axes.axhline(1.0, color="0.4", linewidth=0.8, linestyle="--")
    if not positive or max(positive) / min(positive) < LOG_RANGE:
        axes.set_ylim(0, 1.12 * max(positive, default=1.0))
        return 0.0
    floor = 10.0 ** math.floor(math.log10(min(positive) / 1.5))
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(lambda value, _: number(value))
    axes.set_ylim(floor, max(positive) * (max(positive) / floor) ** 0.1)
    return floor


def _write(axes: Axes, x: float, top: float, value: float) -> None:
    """The value above a bar, upright so that neighbours do not touch."""
    axes.annotate(
        number(value), (x, top), xytext=(0, 3), textcoords="offset points", ha="center", va="bottom", fontsize=6.5,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.4},
    )  # fmt: skip


def number(value: float) -> str:
    """Two or three digits, and a letter for thousands where there are many."""
    for size, letter in ((1e9, "G"), (1e6, "M"), (1e4, "k")):
        if value >= size:
            return f"{value / (1e3 if letter == 'k' else size):.3g}{letter}"
    return f"{value:.2g}" if value < 10 else f"{value:.0f}"


def _label_bars(axes: Axes, comparisons: Sequence[Comparison], methods: Sequence[str], relative: bool) -> None:
    """Names under the bars: of the methods for one scene, of the scenes, with what the baseline took, for several."""
    if len(comparisons) == 1:
        places = _places(comparisons, methods)
        axes.set_xticks([x for x, _, _ in places], [row.method for _, _, row in places], rotation=35, ha="right")
        base = comparisons[0].row(BASELINE)
        if relative and base:
            axes.set_xlabel(f"{BASELINE}: {_absolute(base)} a frame")
        return
    middles = [group * (len(methods) + 1.0) + (len(methods) - 1) / 2 for group in range(len(comparisons))]
    names = []
    for comparison in comparisons:
        base = comparison.row(BASELINE)
        names.append(comparison.scene + (f"\n({_absolute(base)})" if relative and base else ""))
    axes.set_xticks(middles, names)
    axes.tick_params(axis="x", length=0)


def _absolute(row: MethodRow) -> str:
    counted = "" if row.instructions is None else f", {number(row.instructions)} instructions"
    return f"{row.median_ms:.3g} ms{counted}"
