"""What a triangle's setup and a sample's test cost in scalar operations: the paper's lists, and those of our kernels.

Davidovic et al., '3D Rasterization', Fig. 10, gives each line of its pseudo-code a list of operations, then a list and
a total for the whole. They do not agree everywhere (see `disagreements`), so that one number has to be chosen: taken
are the sums of the pseudo-code's own lines, 73, 73 and 57 for the setups of 2D, homogeneous 2D and 3D edges and 14,
11 and 12 for a pixel. Those of our kernels are counted in their source (kernel_operations.py), not written down.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from types import MappingProxyType
from typing import Any

from clrast.opencl.features import Edges, Precision, Projection
from clrast.study.kernel_operations import KernelOperations, count_operations

PROGRAM = "rasterize_tiles.cl"
FUNCTIONS = ("setup_triangles_at", "rasterize_block")
"""From a triangle's corners to three edge functions and a nearness plane; these at a sample, and what is decided."""


@dataclass(frozen=True)
class Operations:
    """Scalar operations by the paper's kinds; a subtraction counts as an addition."""

    add: int = 0
    mul: int = 0
    madd: int = 0
    rcp: int = 0

    @property
    def total(self) -> int:
        return self.add + self.mul + self.madd + self.rcp

    def __add__(self, other: Operations) -> Operations:
        return Operations(self.add + other.add, self.mul + other.mul, self.madd + other.madd, self.rcp + other.rcp)

    def __str__(self) -> str:
        parts = [f"{getattr(self, each.name)} {each.name.upper()}" for each in fields(self)]
        return ", ".join(part for part in parts if not part.startswith("0 ")) or "nothing"


@dataclass(frozen=True)
class Line:
    """A line of the pseudo-code. `written` : what its statements ask for, where that is not what is printed beside."""

    what: str
    operations: Operations
    written: Operations | None = None


@dataclass(frozen=True)
class Part:
    """Setup, or the operations per pixel, of one column of Fig. 10.

    lines : with the operations printed beside each. printed, printed_total : the list and the total below them.
    slots, printed_slots : the same in instruction slots of shader profile 3.0.
    """

    lines: tuple[Line, ...]
    printed: Operations
    printed_total: int
    slots: Mapping[str, int]
    printed_slots: int

    @property
    def operations(self) -> Operations:
        """The sum of the lines."""
        total = Operations()
        for line in self.lines:
            total += line.operations
        return total


@dataclass(frozen=True)
class EdgeCost:
    """What one kind of edges costs. `remarks` : what is printed and can not be meant, beside numbers."""

    name: str
    setup: Part
    pixel: Part
    remarks: tuple[str, ...] = ()


def _part(lines: tuple[Line, ...], printed: Operations, total: int, slots: dict[str, int], slot_total: int) -> Part:
    return Part(lines, printed, total, MappingProxyType(slots), slot_total)


_SIGN = (
    "a pixel is inside where all of E are < 0; section 3.1 asks for three positive values, section 3.2 for the sign "
    "of V"
)
_VOLUME_COMPONENTS = "D is the product of c0 with the components xyz of a vertex; c0 was made of x, y and w"

PAPER: Mapping[Edges, EdgeCost] = MappingProxyType({
    Edges.PROJECTED: EdgeCost(
        "2D",
        _part(
            (
                Line("vertices projected and divided by w", Operations(rcp=3, mul=12, madd=36)),
                Line("edges c_i", Operations(add=3, mul=3, madd=3), written=Operations(add=6, mul=3, madd=3)),
                Line("determinant D", Operations(mul=1, madd=2)),
                Line("edges divided by D", Operations(rcp=1, mul=9)),
            ),
            Operations(madd=41, mul=25, add=3, rcp=4), 72,
            {"DP3": 1, "DP4": 9, "MADD": 10, "MOV": 5, "MUL": 9, "RCP": 4}, 39,
        ),
        _part(
            (
                Line("edge values E", Operations(madd=6)),
                Line("depth W", Operations(madd=2, mul=1, rcp=1)),
                Line("u", Operations(mul=2)),
                Line("v", Operations(mul=2)),
            ),
            Operations(madd=8, mul=2, rcp=1), 14,
            {"CMP": 4, "DP3": 4, "MOV": 1, "MUL": 2, "RCP": 1}, 12,
        ),
        (_SIGN, _VOLUME_COMPONENTS),
    ),
    Edges.HOMOGENEOUS: EdgeCost(
        "2D homogeneous",
        _part(
            (
                Line("vertices transformed", Operations(madd=36)),
                Line("edge c_0", Operations(mul=3, madd=3)),
                Line("edge c_1", Operations(mul=3, madd=3)),
                Line("edge c_2", Operations(mul=3, madd=3)),
                Line("determinant D", Operations(mul=1, madd=2)),
                Line("edges divided by D", Operations(rcp=1, mul=9)),
                Line("function w", Operations(add=6)),
            ),
            Operations(madd=47, mul=19, add=6, rcp=1), 73,
            {"DP3": 1, "DP4": 9, "MADD": 7, "MOV": 3, "MUL": 6, "RCP": 1}, 27,
        ),
        _part(
            (
                Line("edge values E", Operations(madd=6)),
                Line("depth W", Operations(rcp=1, madd=2)),
                Line("u", Operations(mul=1)),
                Line("v", Operations(mul=1)),
            ),
            Operations(madd=10, mul=3, rcp=1), 14,
            {"CMP": 4, "DP3": 4, "MOV": 2, "MUL": 1, "RCP": 1}, 12,
        ),
        (_SIGN, _VOLUME_COMPONENTS),
    ),
    Edges.SPATIAL: EdgeCost(
        "3D",
        _part(
            (
                Line("edge normals n_i", Operations(add=9, mul=9, madd=9)),
                Line("volume V", Operations(mul=1, madd=2)),
                Line("edge functions from n_i and d0, dx, dy", Operations(mul=9, madd=18)),
            ),
            Operations(madd=29, mul=19, add=9), 57,
            {"DP3": 10, "MADD": 5, "MOV": 1, "MUL": 3, "ADD": 3}, 22,
        ),
        _part(
            (
                Line("edge values E", Operations(madd=6)),
                Line("their sum W", Operations(add=2)),
                Line("u, v and depth", Operations(mul=3, rcp=1)),
            ),
            Operations(madd=6, add=2, mul=3, rcp=1), 12,
            {"CMP": 4, "DP3": 4, "MOV": 2, "MUL": 1, "RCP": 1}, 12,
        ),
        (_SIGN, "E is the transposed matrix times (x, y, 1); by its setup it is the matrix itself times (1, x, y)"),
    ),
})  # fmt: skip
"""Fig. 10 as printed, line by line."""

BARYCENTRIC_SETUP = (
    Line("two edges, and the eye from a corner", Operations(add=9)),
    Line("normals N, b1 and b2: three cross products", Operations(mul=9, madd=9)),
    Line("numerator of t", Operations(mul=1, madd=2)),
    Line("three functions from N, b1, b2 and d0, dx, dy", Operations(mul=9, madd=18)),
)
BARYCENTRIC_PIXEL = (
    Line("determinant, and numerators of b1 and b2", Operations(madd=6)),
    Line("numerator of b0", Operations(add=2)),
    Line("b1, b2 and depth", Operations(mul=3, rcp=1)),
)
"""Durand, 'A Unifying Paradigm', section 3: the determinants of Cramer's rule for b1, b2 and t, written in the manner
of Fig. 10 (which lacks them). What does not depend on the ray is setup; each determinant is then linear in x and y."""


@dataclass(frozen=True)
class Cost:
    """Instructions by which the work of a method is weighed: of a setup, and of an edge evaluation."""

    setup: int
    pixel: int


def _sum(lines: tuple[Line, ...]) -> int:
    return sum(line.operations.total for line in lines)


def paper_cost(edges: Edges) -> Cost:
    """The sums of the pseudo-code's own lines."""
    if edges == Edges.BARYCENTRIC:
        return Cost(_sum(BARYCENTRIC_SETUP), _sum(BARYCENTRIC_PIXEL))
    column = PAPER[edges]
    return Cost(column.setup.operations.total, column.pixel.operations.total)


def kernel_cost(
    edges: Edges, precision: Precision = Precision.MIDPOINT, projection: Projection = Projection.PERSPECTIVE
) -> tuple[KernelOperations, KernelOperations] | None:
    """What our kernels do for a setup and for an edge evaluation, counted in their source.

    None where the source has come to hold what kernel_operations.py does not understand.
    """
    try:
        setup, pixel = count_operations(PROGRAM, FUNCTIONS, edges=edges, precision=precision, projection=projection)
    except ValueError:
        return None
    return setup, pixel


@dataclass(frozen=True)
class Disagreement:
    """Two numbers of Fig. 10 that ought to be one. `taken` : which of them is used here, None where neither is."""

    edges: str
    part: str
    what: str
    printed: str
    counted: str
    taken: str | None = None


def disagreements() -> tuple[Disagreement, ...]:
    """Every place where the numbers of Fig. 10 contradict each other, found by adding them up."""
    found: list[Disagreement] = []
    for column in PAPER.values():
        for name, part in (("setup", column.setup), ("pixel", column.pixel)):
            found += _check_part(column.name, name, part)
    return tuple(found)


def _check_part(edges: str, name: str, part: Part) -> list[Disagreement]:
    found = []
    lines, slots = part.operations, sum(part.slots.values())
    for line in part.lines:
        if line.written is not None and line.written != line.operations:
            what = f"operations beside the line '{line.what}', and those of its statements"
            found.append(Disagreement(edges, name, what, str(line.operations), str(line.written), "printed"))
    if part.printed != lines:
        what = "list of operations, and the sum of the lines"
        found.append(Disagreement(edges, name, what, str(part.printed), str(lines), "counted"))
    if part.printed_total != part.printed.total:
        what = "total, and the sum of the list beside it"
        found.append(Disagreement(edges, name, what, str(part.printed_total), str(part.printed.total)))
    if part.printed_total != lines.total:
        what = "total, and the sum of the lines"
        found.append(Disagreement(edges, name, what, str(part.printed_total), str(lines.total), "counted"))
    if part.printed_slots != slots:
        what = "total of instruction slots, and the sum of the list beside it"
        found.append(Disagreement(edges, name, what, str(part.printed_slots), str(slots)))
    return found


def remarks() -> tuple[str, ...]:
    """What Fig. 10 prints and can not mean, beside numbers; a remark for each column that it is in."""
    return tuple(f"{column.name}: {remark}" for column in PAPER.values() for remark in column.remarks)


def cost_summary(kinds: tuple[Edges, ...], precision: Precision, projection: Projection) -> dict[str, Any]:
    """The numbers taken, those of our kernels and the disagreements, as plain data."""
    table = {}
    for edges in kinds:
        own = kernel_cost(edges, precision, projection)
        kernel = {name: each.as_dict() for name, each in zip(("setup", "pixel"), own, strict=True)} if own else None
        table[edges.name.lower()] = {"paper": asdict(paper_cost(edges)), "kernel": kernel}
    return {
        "taken": "the sums of the pseudo-code's own lines (Davidovic et al., Fig. 10)",
        "edges": table,
        "disagreements": [asdict(each) for each in disagreements()],
        "remarks": list(remarks()),
    }
