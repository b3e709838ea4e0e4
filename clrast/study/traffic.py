"""Words that rays through a grid read and write, by kernel and by kind of data, for both architectures.

Purcell et al., 'Ray Tracing on Programmable Graphics Hardware', Table 1 and Fig. 7, 8. All numbers are of the arguments
that our kernels have (cl/traverse_grid.cl, cl/pass_rays.cl) and of how often they touch them; tests hold WORDS against
the kernels' text. A ray's state is one byte, as the paper's stencil is; only rays in a stream pay for it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from clrast.study.ray_traces import Trace
from clrast.visibility.grid_passes import PassCounts

WORDS: Mapping[str, float] = {
    "rays": 1, "cells": 1, "cursors": 2, "states": 0.25, "nearness": 1, "visible_prims": 1,
    "cell_begin": 1, "references": 1, "records": 1,
}  # fmt: skip
"""Argument of a kernel -> words of one of its elements."""

STATE, STENCIL, GRID_DATA, LISTS, TRIANGLES, SHADING = (
    "state variables", "stencil", "grid cells", "triangle lists", "triangles", "shading data",
)  # fmt: skip
KINDS = (STENCIL, STATE, GRID_DATA, LISTS, TRIANGLES, SHADING)
"""Fig. 8 and 9: what words are of. The last four are data structures, which are read and never written."""

KERNELS = ("generate", "traverse", "intersect", "shade")

CELL_WORDS = 2
"""A cell: where its list begins and where it ends."""

BOUND_WORDS, NEARNESS_WORDS, EDGE_WORDS = 2, 3, 10
"""Of a triangle's record: its screen bound always; nearness where the bound holds the sample; then edges."""

SHADING_WORDS = 15
"""Of a hit: three vertices' numbers and positions."""


@dataclass
class Traffic:
    """Words by (kernel, kind), and of these the written ones. `instances` : how often each kernel ran for a ray."""

    words: dict[tuple[str, str], float] = field(default_factory=dict)
    written: dict[tuple[str, str], float] = field(default_factory=dict)
    instances: dict[str, int] = field(default_factory=dict)

    def add(self, kernel: str, kind: str, read: float, written: float = 0.0) -> None:
        self.words[kernel, kind] = self.words.get((kernel, kind), 0.0) + read + written
        self.written[kernel, kind] = self.written.get((kernel, kind), 0.0) + written

    @property
    def total(self) -> float:
        """Words in all."""
        return sum(self.words.values())

    def by_kernel(self) -> dict[str, float]:
        return {name: sum(v for (kernel, _), v in self.words.items() if kernel == name) for name in KERNELS}

    def by_kind(self) -> dict[str, float]:
        return {name: sum(v for (_, kind), v in self.words.items() if kind == name) for name in KINDS}

    def a_ray(self, kernel: str) -> dict[str, float]:
        """Table 1: words that a kernel's run for one ray reads of its stream (R), writes (W), reads elsewhere (M)."""
        count = max(1, self.instances.get(kernel, 0))
        stream = [(k, v) for k, v in self.words.items() if k[0] == kernel and k[1] in (STATE, STENCIL)]
        written = sum(self.written[k] for k, _ in stream)
        other = sum(v for k, v in self.words.items() if k[0] == kernel and k[1] not in (STATE, STENCIL))
        return {"R": (sum(v for _, v in stream) - written) / count, "W": written / count, "M": other / count}


def _add_data(traffic: Traffic, trace: Trace, hits: int) -> None:
    """What is read of grid, lists, triangles and surfaces: the same in both architectures."""
    tests = int(trace.is_test.sum())
    in_bound, evaluated = int((trace.reached > 0).sum()), int((trace.reached > 1).sum())
    traffic.add("traverse", GRID_DATA, CELL_WORDS * WORDS["cell_begin"] * (len(trace.places) - tests))
    traffic.add("intersect", LISTS, WORDS["references"] * tests)
    record = BOUND_WORDS * tests + NEARNESS_WORDS * in_bound + EDGE_WORDS * evaluated
    traffic.add("intersect", TRIANGLES, WORDS["records"] * record)
    traffic.add("shade", SHADING, SHADING_WORDS * hits)
    traffic.instances |= {"generate": trace.ray_count, "shade": hits}


def branching_traffic(trace: Trace, hits: int) -> Traffic:
    """One pass: state stays in registers, but for what a ray begins with and what it leaves."""
    traffic = Traffic()
    _add_data(traffic, trace, hits)
    sample = WORDS["nearness"] + WORDS["visible_prims"]
    traffic.add("generate", STATE, sample * trace.ray_count, sample * trace.ray_count)
    traffic.instances |= {"traverse": int(trace.steps.sum()), "intersect": int(trace.tests.sum())}
    return traffic


def multipass_traffic(trace: Trace, passes: PassCounts, hits: int) -> Traffic:
    """Streams: every pass reads its rays' numbers and states and writes them, and its kernels' variables."""
    traffic = Traffic()
    _add_data(traffic, trace, hits)
    entering = int((trace.begin[1:] > trace.begin[:-1]).sum())
    lists = int((trace.is_test[1:] & ~trace.is_test[:-1]).sum())  # cells that hold triangles, once a ray
    rays, cells, cursors, state = (WORDS[name] for name in ("rays", "cells", "cursors", "states"))
    sample = WORDS["nearness"] + WORDS["visible_prims"]
    # The stream of a pass is compacted after it: numbers and states are read again, numbers of active rays written.
    traffic.add("generate", STATE, rays * trace.ray_count, (rays + cells) * trace.ray_count + rays * entering)
    traffic.add("generate", STENCIL, state * trace.ray_count, state * trace.ray_count)
    for kernel, active in (("traverse", passes.rays_traverse), ("intersect", passes.rays_intersect)):
        traffic.add(kernel, STENCIL, state * active, state * active)
        traffic.add(kernel, STATE, 2 * rays * active, rays * active)
    traffic.add("traverse", STATE, cells * passes.rays_traverse, cells * passes.rays_traverse + cursors * lists)
    going_on = passes.rays_intersect - lists
    read = (sample + cursors) * passes.rays_intersect + cells * lists
    traffic.add("intersect", STATE, read, sample * passes.rays_intersect + cursors * going_on + cells * lists)
    traffic.add("shade", STATE, WORDS["visible_prims"] * trace.ray_count)
    traffic.instances |= {"traverse": passes.rays_traverse, "intersect": passes.rays_intersect}
    return traffic


def stencil_bytes(trace: Trace, passes: PassCounts) -> int:
    """What the paper's stencil would cost: a byte of every ray in every pass."""
    return trace.ray_count * passes.total


def hit_count(prims: np.ndarray, nothing: int) -> int:
    return int(np.count_nonzero(prims != nothing))
