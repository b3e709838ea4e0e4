"""A uniform grid for rays of any origin and direction: its cells' lists in blocks, as cl/trace_rays.cl takes them.

The grid is that of camera rays (grid.py), here in world space; how rays walk it is said in cl/walk_grid.clh. A cell's
triangles are laid out side by side in blocks of its own, as a BVH's leaves are, so that vectors test a block at a time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clrast.errors import CapacityError
from clrast.opencl import buffers
from clrast.opencl.device import Device
from clrast.opencl.features import Features
from clrast.visibility.geometry import Geometry
from clrast.visibility.grid import Grid, GridBuilder
from clrast.visibility.leaf_blocks import BLOCK_BYTES, blocks_of_lists

if TYPE_CHECKING:
    import pyopencl as cl

LEAST_EXTENT = 2.0**-30
"""Longest side of the box that is cut into cells, at least: cells' padding then is far over what underflow takes."""

ROUNDINGS = 16 * 2.0**-24
"""Of the ways that come in: what a walk may stray from its ray by, with slack (cl/walk_grid.clh)."""

STRAY_FLOOR = 2.0**-60


@dataclass(frozen=True)
class GridRequest:
    """A grid to build.

    budget : bytes of device memory for all of it. resolution : cells along the shortest side, or None for a choice.
    """

    budget: int
    resolution: int | None = None


@dataclass(frozen=True)
class RayGrid:
    """A grid over a geometry whose triangles lie in the order of the file.

    cells : [cell_count] uint2, first block and number of triangles of each cell. block_places, block_counts :
    (block_count,) uint32, where in the references a block begins, and its triangles. farthest : the greatest sum of an
    origin's distances from the grid's corner along the axes for which rays walk. longest : side of a triangle's box.
    """

    grid: Grid
    cells: cl.Buffer
    block_places: np.ndarray
    block_counts: np.ndarray
    farthest: float
    longest: float

    @property
    def nbytes(self) -> int:
        """Bytes on the device, without the blocks."""
        return self.grid.nbytes + 8 * self.grid.shape.cell_count

    def arguments(self) -> dict[str, Any]:
        """What the kernels of trace_rays.cl take of it, by their names there."""
        where = {"grid": self.grid.shape.struct(), "farthest": self.farthest, "longest": self.longest}
        return {"prims": self.grid.references, "cells": self.cells, **where}


def build_ray_grid(
    device: Device,
    features: Features,
    geometry: Geometry,
    positions: np.ndarray,
    triangles: np.ndarray,
    wanted: GridRequest,
) -> RayGrid:
    """The grid over a scene's triangles; waits.

    geometry : of the same triangles in world space, in the order of the file. positions : (vertex_count, 3) float32.
    triangles : (triangle_count, 3) uint32. Raises CapacityError.
    """
    corners = positions[triangles]
    lows, highs = corners.min(axis=1), corners.max(axis=1)
    low, high = lows.min(axis=0).astype(np.float64), highs.max(axis=0).astype(np.float64)
    if 0.0 < (high - low).max() < LEAST_EXTENT:
        high = low + LEAST_EXTENT
    builder = GridBuilder(device, features, geometry.corners, len(triangles), low, high, wanted.budget)
    grid = builder.build(wanted.resolution)
    begins = buffers.download(device, grid.cell_begin, np.uint32, grid.shape.cell_count + 1)
    of_cells = np.diff(begins)
    firsts, places, counts = blocks_of_lists(begins[:-1], of_cells)
    cells = np.stack([firsts, of_cells], axis=1).astype(np.uint32)
    needed = grid.nbytes + cells.nbytes + BLOCK_BYTES * len(places)
    if needed > wanted.budget or BLOCK_BYTES * len(places) > device.max_allocation_bytes:
        sides = "x".join(map(str, grid.shape.counts))
        raise CapacityError(
            f"a grid of {sides} cells for secondary rays takes {needed} bytes of device memory, and there are "
            f"{min(wanted.budget, device.max_allocation_bytes)}: give a smaller --grid-resolution, or --accelerator bvh"
        )
    size, pad = sum(grid.shape.size), min(grid.shape.pad)
    farthest = (0.5 * pad - STRAY_FLOOR) / ROUNDINGS - size
    longest = float((highs.astype(np.float64) - lows).max())
    return RayGrid(grid, buffers.upload(device, cells), places, counts, farthest, longest * (1 + 2.0**-20))
