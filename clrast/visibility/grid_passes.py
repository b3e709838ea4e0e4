"""Rays through a uniform grid in passes: the host looks at how many rays are in which state and picks the next kernel.

Purcell et al., 'Ray Tracing on Programmable Graphics Hardware', section 3.2 (its oracles, after Delany's ray tracer for
the Connection Machine) and 4.2 (Table 2, unrolled loops). The kernels are in cl/pass_rays.cl. Which pass comes next
changes the number of passes and no bit of the image. The paper's threshold of 20 % is the setting `purcell`; 40 % took
0.91 of its passes over seven views (geometric mean; at most 1.01), and is what the method has.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clrast.opencl import buffers, kernels
from clrast.opencl.device import Device
from clrast.opencl.features import Features
from clrast.opencl.layout import LIST_CHUNK
from clrast.visibility.geometry import Geometry
from clrast.visibility.grid import Grid
from clrast.visibility.grid_rays import GridRaycaster
from clrast.visibility.oracles import OracleChoice
from clrast.visibility.settle import ContenderList
from clrast.visibility.view import band_pixel_count
from clrast.visibility.work import WorkCounters

if TYPE_CHECKING:
    import pyopencl as cl

TRAVERSE, INTERSECT = "traverse", "intersect"

STATE_BYTES = 4 + 8 + 1 + 4 * 4
"""Device bytes of a ray's state: cell, cursor, state, and places in four streams."""


def choose_pass(oracle: OracleChoice, traversing: int, intersecting: int) -> str:
    """The kind of the next pass. traversing, intersecting : rays in these states, at least one of them."""
    if traversing == 0 or intersecting == 0:
        return INTERSECT if traversing == 0 else TRAVERSE
    if oracle.setting == "naive":
        return INTERSECT
    if oracle.setting == "delany":
        return INTERSECT if intersecting > traversing else TRAVERSE
    return INTERSECT if 100 * intersecting >= oracle.number * (traversing + intersecting) else TRAVERSE


@dataclass
class PassCounts:
    """What the passes of a frame did. `rays_*` : rays that were in them, added up; `rays` : of the frame."""

    traverse: int = 0
    intersect: int = 0
    other: int = 0
    rays_traverse: int = 0
    rays_intersect: int = 0
    rays: int = 0

    @property
    def total(self) -> int:
        return self.traverse + self.intersect + self.other

    @property
    def simd_efficiency(self) -> float:
        """Average part of all rays that a pass works for (Table 2)."""
        passes = self.traverse + self.intersect
        return (self.rays_traverse + self.rays_intersect) / max(1, passes * self.rays) if passes else 0.0


class GridPasses(GridRaycaster):
    """GridRaycaster, its rays in passes. choice : of the oracle `pass`. Features say how long loops are.

    Every band waits for each of its passes.
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
        choice: OracleChoice,
    ) -> None:
        super().__init__(device, features, view, geometry, surfaces, band_rows, work, contenders, grid=grid)
        self.choice = choice
        self.passes = PassCounts()
        self._passes_program = kernels.build(device, "pass_rays.cl", features)
        pixels = min(band_rows << features.tile_log2, int(view["height"])) * int(view["width"])
        chunks = -(-pixels // LIST_CHUNK)
        self._ray_cells = buffers.create(device, 4 * pixels)
        self._ray_cursors = buffers.create(device, 8 * pixels)
        self._ray_states = buffers.create(device, pixels)
        self._streams = {kind: [buffers.create(device, 4 * pixels) for _ in range(2)] for kind in (TRAVERSE, INTERSECT)}
        self._chunk_counts = buffers.create(device, 8 * chunks)
        self._chunk_begins = buffers.create(device, 8 * chunks)
        self._totals = buffers.create(device, 8)
        self._pixel_capacity = pixels

    def setup(self) -> None:
        """Begin a frame."""
        super().setup()
        self.passes = PassCounts()

    def _cast_rays(self, layer: int, front: tuple[cl.Buffer, cl.Buffer] | None) -> None:
        """Run passes until no ray is active. Waits."""
        counts = {TRAVERSE: 0, INTERSECT: 0}
        pixel_count = band_pixel_count(self.view)
        arguments = self._ray_arguments(layer, front)
        self._run_pass("generate_eye_rays", pixel_count, self._streams[TRAVERSE][1], counts, cells=self._ray_cells,
                       view=self.view, grid=self._grid_struct)  # fmt: skip
        self.passes.other += 1
        self.passes.rays += pixel_count
        while any(counts.values()):
            kind = choose_pass(self.choice, counts[TRAVERSE], counts[INTERSECT])
            ray_count, counts[kind] = counts[kind], 0
            stream = self._streams[kind]
            rays, stream[0], stream[1] = stream[0], stream[1], stream[0]
            if kind == TRAVERSE:
                self.passes.traverse += 1
                self.passes.rays_traverse += ray_count
                named = {name: arguments[name] for name in ("view", "grid", "cell_begin")}
                named |= self._work_arguments(ray_count, {"pixel_count": pixel_count})
            else:
                self.passes.intersect += 1
                self.passes.rays_intersect += ray_count
                named = {**arguments, "late": self._late}
                del named["cell_begin"]
                named |= self._work_arguments(ray_count, {})
            named |= {"cells": self._ray_cells, "cursors": self._ray_cursors}
            self._run_pass(f"{kind}_rays", ray_count, rays, counts, **named)

    def _work_arguments(self, ray_count: int, more: dict[str, Any]) -> dict[str, Any]:
        if self.work is None:
            return {}
        return {"work": self.work.rows(-(-self._pixel_capacity // LIST_CHUNK)), "cost": self.work.cost, **more}

    def _run_pass(self, kernel: str, ray_count: int, rays: cl.Buffer, counts: dict[str, int], **arguments: Any) -> None:
        """Launch a pass over a stream and put its rays where they belong; adds to `counts`. Waits."""
        chunks = -(-ray_count // LIST_CHUNK)
        stream = {"ray_count": ray_count, "rays": rays, "states": self._ray_states}
        program, sums = self._passes_program, {"chunk_counts": self._chunk_counts}
        program.launch(kernel, chunks, 1, **stream, **sums, **arguments)
        begins = {"chunk_begins": self._chunk_begins}
        program.launch("scan_stream_chunks", 1, 1, chunk_count=chunks, totals=self._totals, **sums, **begins)
        program.launch(
            "scatter_stream",
            chunks,
            1,
            first_traversing=counts[TRAVERSE],
            first_intersecting=counts[INTERSECT],
            traversing=self._streams[TRAVERSE][0],
            intersecting=self._streams[INTERSECT][0],
            **stream,
            **begins,
        )
        self.launches += 3
        found = buffers.download(self.device, self._totals, np.uint32, 2)
        counts[TRAVERSE] += int(found[0])
        counts[INTERSECT] += int(found[1])

    def counts(self) -> dict[str, Any]:
        """What the stats say of the grid and of the last frame's passes. Waits."""
        done = self.passes
        return super().counts() | {
            "passes_traverse": done.traverse,
            "passes_intersect": done.intersect,
            "passes_other": done.other,
            "simd_efficiency": done.simd_efficiency,
        }

    def list_bytes(self) -> int:
        """Bytes of all that, and of the rays' states."""
        return super().list_bytes() + STATE_BYTES * self._pixel_capacity + 16 * -(-self._pixel_capacity // LIST_CHUNK)
