"""Rays through a uniform grid, one at a time, after the few triangles that no grid can be trusted with.

Purcell et al., 'Ray Tracing on Programmable Graphics Hardware'; the kernels are cl/record_triangles.cl and
cl/traverse_grid.cl. Triangles that float32 sees edge-on (*loose* ones, see record_triangles.cl) are binned and
rasterized first, by their screen bounds; rays start with what these left. So the bits are those of every other method.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clrast.errors import DeviceError
from clrast.opencl import buffers, kernels
from clrast.opencl.device import Device
from clrast.opencl.features import Features, Projection
from clrast.opencl.layout import RAY_BLOCK, RECORD_WORDS
from clrast.visibility.geometry import Geometry
from clrast.visibility.grid import Grid
from clrast.visibility.loop_limits import loop_limit
from clrast.visibility.screen_bounds import BOUND_BYTES, round_up
from clrast.visibility.settle import ContenderList
from clrast.visibility.tiles import TileRasterizer
from clrast.visibility.view import band_pixel_count
from clrast.visibility.work import WorkCounters

if TYPE_CHECKING:
    import pyopencl as cl

RECORD_BYTES = 4 * RECORD_WORDS
MAX_FLOAT32 = 3.4028234663852886e38
GRID_SHARE = 0.5
"""Part of the budget that a grid may take, after what the scene takes."""


def grid_view_bytes(triangle_count: int) -> int:
    """Device bytes that a view takes beside the canonical bounds: records and loose bounds."""
    return (RECORD_BYTES + BOUND_BYTES) * triangle_count


def check_loops(device: Device) -> None:
    """Raises DeviceError where a driver ends long loops: a walk through a grid may be long."""
    if loop_limit(device) is not None:
        raise DeviceError(f"{device.name} ends long loops early, and a grid may need them: use --device pocl")


def walk_doubt(view: np.ndarray, features: Features, grid: Grid) -> float:
    """How far the walks of this view may stray from their rays, device space (grid.clh, point 2).

    An origin, a direction, a plane's time each round some times; 16 roundings of 2^-24 of the distances that come in,
    and of the direction's largest component times these, hold them all.
    """
    size, low = np.array(grid.shape.size), np.array(grid.shape.low)
    reach = np.abs(view["origin"][:3].astype(np.float64) - low).sum() + size.sum()
    slope = 1.0 + float(view["direction_reach"].max())
    if features.projection is Projection.ORTHOGRAPHIC:
        reach += float(view["origin_reach"].sum())
    return min(float(16 * 2.0**-24 * reach * slope), MAX_FLOAT32)


class GridRaycaster(TileRasterizer):
    """Buffers and launches of one view of one scene; stages in order: setup, then bin and rasterize per band.

    grid : over the geometry's triangles. The other arguments are those of TileRasterizer, which does the loose ones.
    `features` keep nearness, where rays start from. Raises DeviceError on drivers that limit loops.
    """

    def __init__(
        self,
        device: Device,
        features: Features,
        view: np.ndarray,
        geometry: Geometry,
        surfaces: Mapping[str, Any],
        band_rows: int,
        work: WorkCounters | None = None,
        contenders: ContenderList | None = None,
        *,
        grid: Grid,
    ) -> None:
        assert features.keep_nearness
        super().__init__(device, features, view, geometry, surfaces, band_rows, work, contenders)
        self.grid, self._grid_struct = grid, grid.shape.struct()
        self._program = kernels.build(device, "traverse_grid.cl", features)
        self._record_program = kernels.build(device, "record_triangles.cl", features)
        padded = self.bounds.padded_count + features.vector_width
        self.records = buffers.create(device, RECORD_BYTES * padded)
        self._loose_low = buffers.create(device, 4 * padded)
        self._loose_high = buffers.create(device, 4 * padded)
        self._loose_counts = buffers.create(device, 4 * self.bounds.chunk_count)
        self._late = 0.5 * min(grid.shape.pad) * (1 + 2.0**-10)

    def setup(self) -> None:
        """Find every triangle's bound and record, and which are loose."""
        super().setup()
        more: dict[str, Any] = {} if self.work is None else {"work": self.work.rows(self.bounds.chunk_count)}
        if self.contenders is not None:
            more["facing_signs"] = self.contenders.facing_signs
        self._record_program.launch(
            "record_triangles",
            self.bounds.chunk_count,
            1,
            view=self.view,
            grid=self._grid_struct,
            triangle_count=self.geometry.triangle_count,
            chunk_size=self.bounds.chunk_size,
            doubt=walk_doubt(self.view, self.features, self.grid),
            corners=self.geometry.corners,
            bounds_low=self.bounds.low,
            bounds_high=self.bounds.high,
            records=self.records,
            loose_low=self._loose_low,
            loose_high=self._loose_high,
            loose_counts=self._loose_counts,
            **more,
        )
        self.launches += 1

    def _bin_arguments(self) -> dict[str, Any]:
        return super()._bin_arguments() | {"bounds_low": self._loose_low, "bounds_high": self._loose_high}

    def _decide_samples(self, layer: int, front: tuple[cl.Buffer, cl.Buffer] | None) -> None:
        super()._decide_samples(layer, front)
        self._cast_rays(layer, front)

    def _cast_rays(self, layer: int, front: tuple[cl.Buffer, cl.Buffer] | None) -> None:
        """Let the rays of the band go on from what the loose triangles left."""
        self._launch_blocks(self._program, self._ray_arguments(layer, front))

    def _launch_blocks(self, program: kernels.Program, arguments: dict[str, Any]) -> None:
        width = int(self.view["width"])
        columns, rows = -(-width // RAY_BLOCK), -(-int(self.view["band_height"]) // RAY_BLOCK)
        arguments |= {"block_columns": columns, "block_count": columns * rows, "late": self._late}
        if self.work is not None:
            arguments |= {"work": self.work.rows(columns * rows), "cost": self.work.cost}
        program.launch("traverse_grid", columns * rows, 1, **arguments)
        self.launches += 1

    def trace(self) -> tuple[np.ndarray, np.ndarray]:
        """What the band's rays read: (pixel_count,) uint32 words of each ray, and the words, one ray after another.

        A word is a cell that was entered, or TRACE_* | prim_id of a triangle that was tested. Waits.
        """
        program = kernels.build(self.device, "traverse_grid.cl", replace(self.features, trace=True))
        pixel_count = band_pixel_count(self.view)
        counts = buffers.create(self.device, 4 * pixel_count)
        buffers.fill(self.device, counts, np.uint32(0), 4 * pixel_count)
        begin, total = np.zeros(pixel_count, dtype=np.uint64), 0
        words: cl.Buffer | None = None
        for is_counting in (True, False):
            super()._decide_samples(0, None)
            where = buffers.upload(self.device, begin.astype(np.uint32))
            arguments = self._ray_arguments(0, None) | {"trace_begin": where, "trace": words, "trace_counts": counts}
            self._launch_blocks(program, arguments)
            found = buffers.download(self.device, counts, np.uint32, pixel_count)
            if is_counting:
                ends = np.cumsum(found, dtype=np.uint64)
                begin, total = ends - found, int(ends[-1])
                words = buffers.create(self.device, 4 * max(1, total))
        assert words is not None
        return found, buffers.download(self.device, words, np.uint32, total)

    def _ray_arguments(self, layer: int, front: tuple[cl.Buffer, cl.Buffer] | None) -> dict[str, Any]:
        """What every kernel takes that tests triangles."""
        front_nearness, front_prims = front or (self.nearness, self.visible_prims)
        arguments: dict[str, Any] = {
            "view": self.view,
            "grid": self._grid_struct,
            "pixel_count": band_pixel_count(self.view),
            "layer": layer,
            "front_nearness": front_nearness,
            "front_prims": front_prims,
            "records": self.records,
            "cell_begin": self.grid.cell_begin,
            "references": self.grid.references,
            "nearness": self.nearness,
            "visible_prims": self.visible_prims,
            **self.surfaces,
        }
        if self.contenders is not None:
            own = self.contenders.sample_arguments()
            own.pop("facing_signs")
            arguments |= {**own, "corners": self.geometry.corners}
        return arguments

    def loose_count(self) -> int:
        """Triangles of the last view that were rasterized by their bounds. Waits."""
        return int(buffers.download(self.device, self._loose_counts, np.uint32, self.bounds.chunk_count).sum())

    def counts(self) -> dict[str, Any]:
        """What the stats say of the grid. Waits."""
        return {
            "grid": list(self.grid.shape.counts),
            "grid_references": self.grid.reference_count,
            "triangles_loose": self.loose_count(),
        }

    def list_bytes(self) -> int:
        """Bytes of the grid, of the records and of the tiles' lists."""
        padded = round_up(self.geometry.triangle_count, self.features.vector_width) + self.features.vector_width
        return super().list_bytes() + self.grid.nbytes + (RECORD_BYTES + BOUND_BYTES) * padded
