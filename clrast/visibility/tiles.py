"""Tile-binned 3D rasterization: setup, binning and rasterization of primary samples on a device.

Davidovic et al., '3D Rasterization', sections 3 and 4; the kernels are cl/setup_triangles.cl,
cl/bin_triangles.cl and cl/rasterize_tiles.cl. An image is rendered in one or more bands of tile rows; the
bits do not depend on the bands, on the chunks of triangles or on the tile size.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from clrast.opencl import buffers, kernels
from clrast.opencl.constants import EVALUATION_DIRECT
from clrast.opencl.device import Device
from clrast.opencl.features import Features, Precision, Projection
from clrast.visibility.geometry import Geometry
from clrast.visibility.loop_limits import chunk_size_within, loop_limit, reference_span_within
from clrast.visibility.screen_bounds import ScreenBounds, round_up
from clrast.visibility.settle import ContenderList
from clrast.visibility.view import band_tile_count, set_band
from clrast.visibility.work import WorkCounters

if TYPE_CHECKING:
    import pyopencl as cl

REFERENCE_BYTES = 8
TILE_PAD = 16
"""sum_tile_counts takes 16 tiles at a time."""


class TileRasterizer:
    """Buffers and launches of one view of one scene; stages in order: setup, then bin and rasterize per band.

    surfaces : buffers by the argument names of rasterize_tiles, read where features.alpha_mask is on.
    contenders : the list of what float32 leaves open, where features.filtered is on.
    band_rows : most tile rows that a band will have. Every method only enqueues, except where it says so.
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
    ) -> None:
        self.device = device
        self.work = work
        self.contenders = contenders
        self.features = features
        self.view = view.copy()
        self.geometry = geometry
        self.surfaces = {**surfaces, "indices": geometry.corner_vertices} if features.alpha_mask else {}
        self.launches = 0
        self.reference_count = 0
        self.reference_capacity = 0
        self._programs = {
            name: kernels.build(device, name, features)
            for name in ("bin_triangles.cl", "rasterize_tiles.cl")
        }
        self._sample_program: kernels.Program | None = None
        self._limit = loop_limit(device)
        self._reference_span = 0
        self.bounds = ScreenBounds(device, features, geometry)
        self._band_stride = round_up(band_rows * int(view["tile_columns"]), TILE_PAD)
        pixel_count = min(band_rows << features.tile_log2, int(view["height"])) * int(view["width"])
        self._tile_counts = buffers.create(device, 4 * self._band_stride)
        self._tile_begin = buffers.create(device, 4 * (self._band_stride + 1))
        self._cursors = buffers.create(device, 4 * self._band_stride * self.bounds.chunk_count)
        self._reference_prims: cl.Buffer | None = None
        self._reference_bounds: cl.Buffer | None = None
        self.visible_prims = buffers.create(device, 4 * pixel_count)
        nearness_bytes = 4 * features.nearness_planes * pixel_count
        self.nearness = buffers.create(device, nearness_bytes) if features.keep_nearness else None

    def _launch(self, program: str, kernel: str, items: int, **arguments: Any) -> None:
        self._programs[program].launch(kernel, items, 1, **arguments)
        self.launches += 1

    def setup(self) -> None:
        """Find every triangle's canonical conservative screen bound."""
        self.bounds.find(self.view, self.work, self.contenders)
        self.launches += 1
        if self._limit is not None:
            self._fit_chunks()

    def _fit_chunks(self) -> None:
        """Cut chunks to what the driver's loops allow; reads the bounds back."""
        low = buffers.download(self.device, self.bounds.low, np.uint32, self.bounds.padded_count)
        high = buffers.download(self.device, self.bounds.high, np.uint32, self.bounds.padded_count)
        shift = self.features.tile_log2
        last = high - np.uint32(0x00010001)
        columns = (last >> shift & 0xFFFF >> shift).astype(np.int64) - (low >> shift & 0xFFFF >> shift) + 1
        rows = (last >> 16 >> shift).astype(np.int64) - (low >> 16 >> shift) + 1
        spans = np.where(high == 0, 0, columns * rows)
        assert self._limit is not None
        self.bounds.set_chunks(chunk_size_within(self._limit, spans, self.features.vector_width))
        self._cursors = buffers.create(self.device, 4 * self._band_stride * self.bounds.chunk_count)

    def count_references(self, band_row: int, band_rows: int) -> None:
        """Count the (tile, triangle) pairs of a band, which decide how much memory its lists take."""
        set_band(self.view, band_row, band_rows, self.features.tile_log2)
        self._stride = round_up(band_rows * int(self.view["tile_columns"]), TILE_PAD)
        program = "bin_triangles.cl"
        self._launch(program, "count_tile_triangles", self.bounds.chunk_count, **self._bin_arguments())
        self._launch(
            program,
            "sum_tile_counts",
            self._stride // TILE_PAD,
            chunk_count=self.bounds.chunk_count,
            tile_stride=self._stride,
            cursors=self._cursors,
            tile_counts=self._tile_counts,
        )
        begin = self._tile_begin
        self._launch(
            program, "scan_tiles", 1, tile_stride=self._stride, tile_counts=self._tile_counts, tile_begin=begin
        )

    def read_reference_count(self) -> int:
        """The number of references that `count_references` found. Waits."""
        last = buffers.download(self.device, self._tile_begin, np.uint32, 1, offset=4 * self._stride)
        self.reference_count = int(last[0])
        return self.reference_count

    def _bin_arguments(self) -> dict[str, Any]:
        return {
            "view": self.view,
            "triangle_count": self.geometry.triangle_count,
            "chunk_size": self.bounds.chunk_size,
            "tile_stride": self._stride,
            "corners": self.geometry.corners,
            "bounds_low": self.bounds.low,
            "bounds_high": self.bounds.high,
            "cursors": self._cursors,
            **({} if self.work is None else {"work": self.work.rows(self.bounds.chunk_count)}),
        }

    def scatter_references(self) -> None:
        """Write the lists that `count_references` counted, as far as the buffers reach (see `fits`)."""
        if self.reference_count > self.reference_capacity or self._reference_prims is None:
            self._reference_prims = self._reference_bounds = None
            self.reference_capacity = max(self.reference_count + self.reference_count // 8, 1024)
            # Tiles read whole vectors: the last list may be read past its end.
            padded_bytes = 4 * (self.reference_capacity + self.features.vector_width)
            self._reference_prims = buffers.create(self.device, padded_bytes)
            self._reference_bounds = buffers.create(self.device, padded_bytes)
        self._launch(
            "bin_triangles.cl",
            "scatter_tile_triangles",
            self.bounds.chunk_count,
            **self._bin_arguments(),
            reference_capacity=self.reference_capacity,
            tile_begin=self._tile_begin,
            reference_prims=self._reference_prims,
            reference_bounds=self._reference_bounds,
        )
        if self._limit is not None:
            self._fit_references(band_tile_count(self.view, self.features.tile_log2))

    def start_band(self, band_row: int, band_rows: int) -> int:
        """Count the references of the band that is rendered next; returns their number. Waits."""
        self.count_references(band_row, band_rows)
        return self.read_reference_count()

    def finish_lists(self) -> None:
        """Write the lists of the band that was started."""
        self.scatter_references()

    def fits(self) -> bool:
        """Whether all references were written; where not, scatter again: the buffers then grow. Waits."""
        return self.read_reference_count() <= self.reference_capacity

    def _fit_references(self, tile_count: int) -> None:
        """Cut the tiles' lists to what the driver's loops allow; reads the references back."""
        begin = buffers.download(self.device, self._tile_begin, np.uint32, tile_count + 1)
        assert self._limit is not None and self._reference_bounds is not None
        bounds = buffers.download(self.device, self._reference_bounds, np.uint32, self.reference_count)
        self._longest_list = int(np.diff(begin.astype(np.int64)).max(initial=0))
        self._reference_span = reference_span_within(
            self._limit // (2 if self.features.filtered else 1),  # blocks may be gone through again
            begin,
            bounds,
            1 << self.features.tile_log2,
            self.features.vector_width,
        )

    def rasterize(self, layer: int = 0, front: tuple[cl.Buffer, cl.Buffer] | None = None) -> None:
        """Decide every sample of the band: `visible_prims` (and `nearness`, where kept).

        front : nearness and prim_ids of the layer in front, where `layer` > 0: only what lies behind
        it is found. Needs features.keep_nearness. Waits where contenders are settled.
        """
        if self.contenders is None:
            self._decide_samples(layer, front)
        else:
            self.contenders.decide(self.view, self._decide_samples, self.visible_prims, self.nearness, layer, front)

    def _decide_samples(self, layer: int, front: tuple[cl.Buffer, cl.Buffer] | None) -> None:
        tile_count = band_tile_count(self.view, self.features.tile_log2)
        common = {
            "view": self.view,
            "tile_count": tile_count,
            "reference_capacity": self.reference_capacity,
            "corners": self.geometry.corners,
            "tile_begin": self._tile_begin,
            "reference_prims": self._reference_prims,
            "reference_bounds": self._reference_bounds,
            "visible_prims": self.visible_prims,
            **self.surfaces,
        }
        if self.contenders is not None:
            common |= self.contenders.sample_arguments()
        if self.work is not None:
            common |= self.work.of_samples(self.view, tile_count)
        if not self.features.keep_nearness:
            self._launch("rasterize_tiles.cl", "rasterize_tiles", tile_count, **common)
            return
        front_nearness, front_prims = front or (self.nearness, self.visible_prims)
        span = self._reference_span or 0xFFFFFFFF
        total = self._longest_list if self._reference_span else 1
        for k, first in enumerate(range(0, max(total, 1), span)):
            self._launch(
                "rasterize_tiles.cl",
                "rasterize_tiles",
                tile_count,
                **common,
                first_reference=first,
                reference_span=span,
                resume=int(k > 0),
                layer=layer,
                front_nearness=front_nearness,
                front_prims=front_prims,
                nearness=self.nearness,
            )

    @property
    def takes_samples(self) -> bool:
        """Whether `rasterize_samples` serves this view: what it leaves out is rare, or has no lanes to fill."""
        f = self.features
        return (
            f.vector_width > 1 and not (f.keep_nearness or f.filtered)
            and f.precision != Precision.FIXED and f.evaluation == EVALUATION_DIRECT
            and f.projection in (Projection.PERSPECTIVE, Projection.ORTHOGRAPHIC)
        )  # fmt: skip

    def rasterize_samples(
        self, positions: np.ndarray, places: cl.Buffer | None, center_prims: cl.Buffer, differs: cl.Buffer,
        sample_prims: cl.Buffer, stride: int, first: int,
    ) -> None:  # fmt: skip
        """Decide samples of each listed pixel: entries from `first` on of its `stride` in `sample_prims`.

        positions : (2, n * VECTOR_WIDTH) float32, x and y of the samples in a pixel, pixels; n is at most LANE_GROUPS.
        places : [pixels of the band] where a pixel stands in the list, or NO_HIT; None lists all. The bounds have to
        hold for the positions. center_prims : [pixels of the band] what centres show. differs : [pixels of the band],
        where all are listed: uchar, 1 where a sample shows another triangle, and only there `sample_prims` are written.
        """
        if self._sample_program is None:
            self._sample_program = kernels.build(self.device, "rasterize_samples.cl", self.features)
        x, y = (buffers.upload(self.device, each) for each in positions)
        tile_count = band_tile_count(self.view, self.features.tile_log2)
        counted = {} if self.work is None else self.work.of_samples(self.view, tile_count)
        self._sample_program.launch(
            "rasterize_samples", tile_count, 1, view=self.view, tile_count=tile_count,
            reference_capacity=self.reference_capacity, everywhere=int(places is None), stride=stride,
            first_entry=first, group_count=positions.shape[1] // self.features.vector_width, sample_x=x, sample_y=y,
            corners=self.geometry.corners, tile_begin=self._tile_begin, reference_prims=self._reference_prims,
            reference_bounds=self._reference_bounds,
            places=self._tile_begin if places is None else places, center_prims=center_prims,
            differs=differs, sample_prims=sample_prims, **self.surfaces, **counted,
        )  # fmt: skip
        self.launches += 1

    def list_length(self) -> int:
        """References in the lists of the band, as last read."""
        return self.reference_count

    def list_bytes(self) -> int:
        """Bytes of the tiles' lists: counters, starts and references, those counted last included."""
        stride = self._band_stride
        references = max(self.reference_capacity, self.reference_count)
        return 4 * (stride * self.bounds.chunk_count + 2 * stride + 1) + REFERENCE_BYTES * references

    def tile_lists(self) -> list[np.ndarray]:
        """prim_ids of each tile of the band, in their order. Waits."""
        tile_count = band_tile_count(self.view, self.features.tile_log2)
        begin = buffers.download(self.device, self._tile_begin, np.uint32, tile_count + 1)
        assert self._reference_prims is not None
        prims = buffers.download(self.device, self._reference_prims, np.uint32, self.reference_count)
        return [prims[a:b] for a, b in zip(begin[:-1], begin[1:], strict=True)]
