"""The figures of Purcell et al. on one scene: bytes by kernel (7), by kind of data (8), with a cache (9), and passes.

'Ray Tracing on Programmable Graphics Hardware', sections 4.1 and 4.2.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from clrast.study.compare_plot import DOTS_PER_INCH, SETTINGS, check_available
from clrast.study.traffic import KERNELS, KINDS, SHADING, STENCIL

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from clrast.study.cost import CostStudy

COLORS = ("#8c6bb1", "#b3b3b3", "#3182bd", "#9ecae1", "#31a354", "#fdae6b")
"""Of kernels and of kinds, in their order."""


def draw(study: CostStudy, suffix: str) -> bytes:
    """The plot as the bytes of a file. suffix : .svg or .png."""
    check_available()
    import matplotlib

    file = io.BytesIO()
    metadata = {"Date": None} if suffix == ".svg" else {"Software": None}
    with matplotlib.rc_context(SETTINGS):
        make_figure(study).savefig(file, format=suffix[1:], metadata=metadata)
    return file.getvalue()


def make_figure(study: CostStudy) -> Figure:
    """Four panels."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 8.0), layout="constrained", dpi=DOTS_PER_INCH)
    ((kernels, kinds), (hits, passes)) = figure.subplots(2, 2)
    models = {"multipass": study.multipass, "branching": study.branching}
    _stack(kernels, {name: each.by_kernel() for name, each in models.items()}, KERNELS, 4e-6)
    kernels.set_title("bytes by kernel (Fig. 7)")
    _stack(kinds, {name: each.by_kind() for name, each in models.items()}, KINDS, 4e-6)
    kinds.set_title("bytes by kind of data (Fig. 8)")
    for axes in (kernels, kinds):
        axes.set_ylabel("MB a frame")
    _draw_hits(hits, study)
    _draw_passes(passes, study)
    width, height = study.size
    grid = "x".join(map(str, study.grid))
    what = f"{study.triangle_count:,} triangles at {width}x{height}, grid {grid}"
    figure.suptitle(f"{study.scene}: {what}, {study.device}")
    return figure


def _stack(axes: Axes, bars: Mapping[str, Mapping[str, float]], parts: Sequence[str], scale: float) -> None:
    """A bar a model, its parts on top of each other."""
    bottoms = [0.0] * len(bars)
    for part, color in zip(parts, COLORS, strict=False):
        heights = [scale * bar[part] for bar in bars.values()]
        axes.bar(list(bars), heights, bottom=bottoms, width=0.6, color=color, label=part)
        bottoms = [a + b for a, b in zip(bottoms, heights, strict=True)]
    axes.legend(frameon=False)
    _plain(axes)


def _draw_hits(axes: Axes, study: CostStudy) -> None:
    kinds = [kind for kind in KINDS if kind not in (SHADING, STENCIL)]
    step = 0.8 / len(kinds)
    for k, kind in enumerate(kinds):
        rates = [100 * (row.rates[kind].rate or 0.0) for row in study.caches]
        places = [group - 0.4 + (k + 0.5) * step for group in range(len(rates))]
        axes.bar(places, rates, width=step, color=COLORS[KINDS.index(kind)], label=kind)
    axes.set_xticks(range(len(study.caches)), [row.name.replace(", ", "\n") for row in study.caches], fontsize=7)
    axes.set_ylabel("hit rate, %")
    axes.set_ylim(0, 118)
    axes.axhspan(96, 99, color="0.6", alpha=0.25, label="paper, triangles")
    axes.legend(frameon=False, ncols=3, loc="upper center", fontsize=7)
    axes.set_title("a cache of 64 KB (Fig. 9)")
    _plain(axes)


def _draw_passes(axes: Axes, study: CostStudy) -> None:
    names = [row.oracle for row in study.rows]
    traverse, intersect = ([getattr(row.passes, kind) for row in study.rows] for kind in ("traverse", "intersect"))
    axes.bar(names, traverse, width=0.6, color=COLORS[2], label="traverse")
    axes.bar(names, intersect, bottom=traverse, width=0.6, color=COLORS[4], label="intersect")
    axes.axhline(study.least_passes, color="0.3", linestyle="--", linewidth=0.8, label="the longest ray")
    axes.set_ylabel("passes a frame")
    axes.set_title("passes by oracle (Table 2)")
    axes.legend(frameon=False)
    _plain(axes)


def _plain(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="y", color="0.88", linewidth=0.6)
    axes.set_axisbelow(True)
