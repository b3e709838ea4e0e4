"""Comparisons of methods with given numbers, for the tests of what is made of them."""

from __future__ import annotations

from typing import Any

from clrast.opencl.features import Edges
from clrast.study.compare import Comparison, Counts, MethodRow
from clrast.study.operation_counts import paper_cost
from clrast.visibility.methods import METHODS


def row(method: str, *frames: float, setups: int | None = 10, evaluations: int | None = 100, **named: Any) -> MethodRow:
    edges = METHODS[method].edges if method in METHODS else Edges.SPATIAL
    stages = {"setup": 0.0, "bin": 0.0, "visibility": 1.0}
    return MethodRow(
        method, edges, frames, stages, named.pop("build_ms", 0.0), Counts(setups, evaluations), paper_cost(edges),
        **named,
    )  # fmt: skip


def comparison(*rows: MethodRow, scene: str = "scene", **named: Any) -> Comparison:
    return Comparison(scene, 12, (64, 32), "a device", "midpoint", "perspective", 5, 60.0, rows, **named)


TABLE = comparison(
    row("2dr-brute", 8.0, setups=100, evaluations=1000),
    row("3dr-brute", 4.0, setups=100, evaluations=1000),
    row("3dr-full", 2.0, setups=None, evaluations=None, build_ms=3.25),
    row("raycast-bvh", 200.0, setups=50, evaluations=0, cut=True),
)
BASE_INSTRUCTIONS = 100 * 73 + 1000 * 14
BRUTE_INSTRUCTIONS = 100 * 57 + 1000 * 12
