"""A uniform grid over a scene's triangles, built on the device; it does not depend on the view.

Purcell et al., 'Ray Tracing on Programmable Graphics Hardware', section 4.1: cells are nearly cubes, and the resolution
is said by the least number of cells along any side of the scene's box. Kernels: cl/build_grid.cl; what the grid
promises to walks is said in cl/grid.clh.

Their resolutions 'allow our algorithms to spend equal amounts of time in the traversal and intersection kernels'. A ray
that pierces v cells tests t = v * (references / cells) triangles on the average, wherever it stops. So the times are
equal where references / cells = C_v / C_t, and that depends on the scene alone: the automatic choice counts references
at a few resolutions and takes the one that comes nearest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clrast.errors import CapacityError
from clrast.opencl import buffers, kernels
from clrast.opencl.device import Device
from clrast.opencl.features import Features
from clrast.opencl.layout import CELL_CHUNK, GRID, MAX_GRID_SIDE, ORDER_CHUNK
from clrast.visibility.geometry import WORK_GROUP

if TYPE_CHECKING:
    import pyopencl as cl

PAD_SHARE = 1.0 / 16
"""Part of a cell's side within which a triangle still stands in the cell."""

CELL_BITS = 12
"""Significant bits of a cell's side: with these, places of all planes are exact."""

THIN = 2.0**-10
"""A side of the scene's box under this part of the longest one has no say in the size of cells."""

CELL_BYTES, REFERENCE_BYTES = 8, 4
"""Device bytes: where a cell's list begins and a cursor while building; a reference."""

BALANCE = 2.5
"""References a cell for which traversal and intersection take equal times: C_v / C_t, by `clrast cost`."""

FIRST_DENSITY = 1.0
"""Cells a triangle that the automatic choice tries first."""

MAX_TRIALS = 4
NEAR_ENOUGH = 1.15
"""Ratio to BALANCE within which a resolution is taken."""

LEAST_SLOPE = 0.1
"""Of log(references / cells) over log(cells), falling: under it cells are finer without gain, as across layers."""

MAX_GROWTH = 64.0
"""Of cells from one trial to the next: references may grow as much."""

MAX_AUTO_CELLS = 1 << 25
MIN_AUTO_CELLS = 8


@dataclass(frozen=True)
class GridShape:
    """Where cells lie, device space. low, cell, pad : by axis, float32 values. counts : cells along x, y, z."""

    low: tuple[float, float, float]
    cell: tuple[float, float, float]
    pad: tuple[float, float, float]
    counts: tuple[int, int, int]

    @property
    def cell_count(self) -> int:
        return self.counts[0] * self.counts[1] * self.counts[2]

    @property
    def size(self) -> tuple[float, float, float]:
        """Sides of the whole grid, exact."""
        x, y, z = (count * side for count, side in zip(self.counts, self.cell, strict=True))
        return (x, y, z)

    def struct(self) -> np.ndarray:
        """The `Grid` struct, one element."""
        grid = np.zeros((), dtype=GRID)
        grid["low"][:3], grid["cell"][:3], grid["pad"][:3] = self.low, self.cell, self.pad
        grid["inverse_cell"][:3] = [1.0 / side for side in self.cell]
        grid["columns"], grid["rows"], grid["layers"] = self.counts
        grid["cell_count"] = self.cell_count
        return grid


@dataclass(frozen=True)
class Grid:
    """A grid with its lists on the device.

    cell_begin : [cell_count + 1] uint, where each cell's list begins. references : [reference_count] uint, prim_ids,
    in each cell rising. trials : (counts, references) of the resolutions that were looked at.
    """

    shape: GridShape
    cell_begin: cl.Buffer
    references: cl.Buffer
    reference_count: int
    trials: tuple[tuple[tuple[int, int, int], int], ...] = ()

    @property
    def nbytes(self) -> int:
        """Bytes on the device."""
        return 4 * (self.shape.cell_count + 1) + REFERENCE_BYTES * self.reference_count


def _round_up(value: float) -> float:
    """The least number of CELL_BITS significant bits that is not below a positive value."""
    mantissa, exponent = math.frexp(value)
    return math.ldexp(math.ceil(mantissa * (1 << CELL_BITS)), exponent - CELL_BITS)


def _round_down(value: float) -> float:
    """The greatest float32 that is not above."""
    nearest = np.float32(value)
    return float(nearest if float(nearest) <= value else np.nextafter(nearest, np.float32(-np.inf)))


def shape_of(low: np.ndarray, high: np.ndarray, side: float) -> GridShape:
    """Cells of about that side over the box low .. high.

    low, high : (3,) float64, device space. The box is widened so that whatever is within a cell's padding of it lies in
    the grid by another padding. An axis of one cell takes a cube's side at least.
    """
    extents = [float(b) - float(a) for a, b in zip(low, high, strict=True)]
    counts = [min(MAX_GRID_SIDE, max(1, math.ceil(extent / side - 1e-9))) for extent in extents]
    lows, cells, pads = [], [], []
    for start, end, extent, count in zip(low.tolist(), high.tolist(), extents, counts, strict=True):
        cell = _round_up(max(extent / (count - 4 * PAD_SHARE), side if count == 1 else 0.0))
        while True:
            corner = _round_down(start - 2 * PAD_SHARE * cell)
            needed = (end + 2 * PAD_SHARE * cell - corner) / count
            if needed <= cell:
                break
            cell = _round_up(max(needed, cell * (1 + 2.0**-CELL_BITS)))
        lows.append(corner)
        cells.append(cell)
        pads.append(PAD_SHARE * cell)
    return GridShape(tuple(lows), tuple(cells), tuple(pads), tuple(counts))  # type: ignore[arg-type]


def side_of_minimum(low: np.ndarray, high: np.ndarray, minimum: int) -> float:
    """The cells' side with `minimum` of them along the shortest side of the box that is not thin."""
    extents = (np.asarray(high, np.float64) - low).tolist()
    longest = max(extents)
    if longest <= 0.0:
        return _point_side(low)
    return min(extent for extent in extents if extent > THIN * longest) / minimum


def side_of_cells(low: np.ndarray, high: np.ndarray, cell_count: float) -> float:
    """The side of cubes of which about `cell_count` fill the box."""
    extents = (np.asarray(high, np.float64) - low).tolist()
    if max(extents) <= 0.0:
        return _point_side(low)
    least, most = max(extents) / MAX_GRID_SIDE, max(extents)
    for _ in range(60):
        side = math.sqrt(least * most)
        if math.prod(max(1.0, extent / side) for extent in extents) > cell_count:
            least = side
        else:
            most = side
    return most


def _point_side(low: np.ndarray) -> float:
    """A side for a scene that is but a point."""
    return max(2.0**-10 * float(np.abs(low).max()), 2.0**-40)


class GridBuilder:
    """Builds grids over one geometry. budget : bytes of device memory that a grid may take."""

    def __init__(
        self,
        device: Device,
        features: Features,
        corners: cl.Buffer,
        triangle_count: int,
        low: np.ndarray,
        high: np.ndarray,
        budget: int,
    ) -> None:
        self.device, self.corners, self.triangle_count, self.budget = device, corners, triangle_count, budget
        self.low, self.high = np.asarray(low, np.float64), np.asarray(high, np.float64)
        self._program = kernels.build(device, "build_grid.cl", features)
        self._counts: cl.Buffer | None = None
        self._sums: cl.Buffer | None = None

    def build(self, minimum: int | None = None) -> Grid:
        """The grid with `minimum` cells along the shortest side, or of a resolution that is chosen; waits.

        Raises CapacityError where it takes more memory than the budget, before it takes it.
        """
        trials: list[tuple[tuple[int, int, int], int]] = []
        if minimum is None:
            shape, references = self._choose(trials)
        else:
            shape = shape_of(self.low, self.high, side_of_minimum(self.low, self.high, minimum))
            self._check_cells(shape)
            references = self._count(shape)
        self._check(shape, references)
        cell_begin = buffers.create(self.device, 4 * (shape.cell_count + 1))
        lists = buffers.create(self.device, max(4, REFERENCE_BYTES * references))
        cells = {"cell_count": shape.cell_count, "cell_begin": cell_begin}
        spread = {"chunk_sums": self._sums, "cell_counts": self._counts}
        self._launch("spread_cell_begins", -(-shape.cell_count // CELL_CHUNK), 1, **cells, **spread)
        triangles = {"triangle_count": self.triangle_count, "corners": self.corners, "references": lists}
        self._launch(
            "scatter_cell_triangles",
            -(-self.triangle_count // WORK_GROUP) * WORK_GROUP,
            WORK_GROUP,
            grid=shape.struct(),
            cell_cursors=self._counts,
            **triangles,
        )
        self._launch("order_cell_triangles", -(-shape.cell_count // ORDER_CHUNK), 1, **cells, references=lists)
        self.device.queue.finish()
        self._counts = self._sums = None
        return Grid(shape, cell_begin, lists, references, tuple(trials))

    def _launch(self, kernel: str, items: int, group: int, **arguments: object) -> None:
        self._program.launch(kernel, items, group, **arguments)

    def _choose(self, trials: list[tuple[tuple[int, int, int], int]]) -> tuple[GridShape, int]:
        """A resolution whose references a cell come near BALANCE. Between two trials log(references / cells) is taken
        as linear in log(cells); before there are two, as falling by half of it. Where it does not fall, the coarser of
        the two is as good."""
        most = min(MAX_AUTO_CELLS, self.budget // (2 * CELL_BYTES))
        wanted = FIRST_DENSITY * self.triangle_count
        found: list[tuple[float, float, GridShape]] = []
        for _ in range(MAX_TRIALS):
            wanted = min(max(wanted, MIN_AUTO_CELLS), most)
            shape = shape_of(self.low, self.high, side_of_cells(self.low, self.high, wanted))
            if any(shape.counts == each.counts for _, _, each in found):
                break
            self._check_cells(shape)
            references = self._count(shape)
            trials.append((shape.counts, references))
            ratio = max(references, 1) / shape.cell_count / BALANCE
            found.append((math.log(shape.cell_count), math.log(ratio), shape))
            if 1 / NEAR_ENOUGH < ratio < NEAR_ENOUGH:
                break
            slope = -0.5
            if len(found) > 1 and found[-1][0] != found[-2][0]:
                slope = (found[-1][1] - found[-2][1]) / (found[-1][0] - found[-2][0])
                if slope > -LEAST_SLOPE:
                    found.remove(max(found[-2:], key=lambda each: each[0]))
                    break
                slope = min(max(slope, -1.0), -0.2)
            wanted = shape.cell_count * min(math.exp(-found[-1][1] / slope), MAX_GROWTH)
        best = min(found, key=lambda each: abs(each[1]))[2]
        references = self._count(best)
        if self._bytes(best, references) > self.budget:  # the smallest tried, if any fits
            best = min(found, key=lambda each: each[0])[2]
            references = self._count(best)
        return best, references

    def _count(self, shape: GridShape) -> int:
        """The references of a shape; leaves the cells' counts, and the sums of chunks, on the device. Waits."""
        chunks = -(-shape.cell_count // CELL_CHUNK)
        self._counts = buffers.create(self.device, 4 * shape.cell_count)
        self._sums = buffers.create(self.device, 8 * (chunks + 1))
        buffers.fill(self.device, self._counts, np.uint32(0), 4 * shape.cell_count)
        self._launch(
            "count_cell_triangles",
            -(-self.triangle_count // WORK_GROUP) * WORK_GROUP,
            WORK_GROUP,
            grid=shape.struct(),
            triangle_count=self.triangle_count,
            corners=self.corners,
            cell_counts=self._counts,
        )
        counts = {"cell_count": shape.cell_count, "cell_counts": self._counts, "chunk_sums": self._sums}
        self._launch("sum_cell_counts", chunks, 1, **counts)
        self._launch("scan_cell_chunks", 1, 1, chunk_count=chunks, chunk_sums=self._sums)
        return int(buffers.download(self.device, self._sums, np.uint64, 1, offset=8 * chunks)[0])

    @staticmethod
    def _bytes(shape: GridShape, references: int) -> int:
        return CELL_BYTES * shape.cell_count + REFERENCE_BYTES * references

    def _check_cells(self, shape: GridShape) -> None:
        self._check(shape, 0)

    def _check(self, shape: GridShape, references: int) -> None:
        """Raises CapacityError where the grid would not fit."""
        needed = self._bytes(shape, references)
        piece = max(4 * shape.cell_count, REFERENCE_BYTES * references)
        if needed <= self.budget and piece <= self.device.max_allocation_bytes and references < 1 << 32:
            return
        sides = "x".join(map(str, shape.counts))
        raise CapacityError(
            f"a grid of {sides} cells with {references} references takes {needed} bytes of device memory, and there "
            f"are {min(self.budget, self.device.max_allocation_bytes)}: give a smaller --grid-resolution"
        )
