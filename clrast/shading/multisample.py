"""Antialiasing with shared shading: visibility at every sample, shading once a pixel and surface (msaa, csaa).

With shading rate `sample` (csaa's; msaa's is supersample.py's) each sample that has visibility of its own is shaded.
The kernels are cl/share_shading.cl, which says what is one surface, and cl/resolve_samples.cl.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np

from clrast.opencl import buffers, kernels
from clrast.opencl.constants import LIST_CHUNK, VISIT_SAMPLES
from clrast.opencl.device import Device
from clrast.opencl.features import Features, Projection
from clrast.shading.edge_pixels import BYTES_PER_PIXEL, EdgePixels, padded
from clrast.shading.filters import reach_of, weight_table
from clrast.shading.shade import WORK_GROUP, Shader
from clrast.visibility.listed_samples import ListedSamples
from clrast.visibility.sample_passes import SamplePasses
from clrast.visibility.sample_patterns import Antialiasing
from clrast.visibility.tiles import TileRasterizer

TYPICAL_SURFACES = 2
"""Surfaces an edge pixel that memory is planned for where no budget is given."""


def surface_distance(view: np.ndarray, projection: Projection) -> float:
    """Half the size of a pixel: in device units where rays are parallel, else as a share of t."""
    if projection is Projection.LATLONG:
        return float(np.float32(math.pi / 2 / max(float(view["width"]) / 2, float(view["height"]))))
    if projection in (Projection.PARABOLOID, Projection.FISHEYE):
        turns = float(view["focal"]) if projection is Projection.FISHEYE else 0.25
        return float(np.float32(0.5 * 2 * math.pi * turns / min(float(view["center_x"]), float(view["center_y"]))))
    x, y = (math.sqrt(sum(float(c) ** 2 for c in view[name][:3].tolist())) for name in ("tangent_x", "tangent_y"))
    return float(np.float32(0.5 * min(x, y)))


def ground_arguments(shader: Shader, view: np.ndarray, projection: Projection) -> dict[str, Any]:
    """What kernels tell surfaces apart by (cl/same_surface.clh), as arguments by name."""
    geometry = shader.geometry
    return {
        "view": view, "surface_distance": surface_distance(view, projection), "positions": geometry.positions,
        "indices": geometry.indices, **shader.surfaces.named("object_ids", "material_ids"),
    }  # fmt: skip


class Multisampler:
    """Shares the shading of a band's samples. shader : of colour alone, with features.sample_list. parts : whether each
    sample that has visibility of its own is shaded."""

    def __init__(
        self,
        device: Device,
        features: Features,
        wanted: Antialiasing,
        filter_name: str,
        shader: Shader,
        max_pixels: int,
    ) -> None:
        self.device, self.wanted, self.shader, self.parts = device, wanted, shader, wanted.shades_all
        self._pixels_at_once = max(1, max_pixels // wanted.depth_count)
        shader.footprint = 1.0 / math.sqrt(wanted.depth_count) if self.parts else 1.0
        self._projection = features.projection
        self.counts: dict[str, int] = {}
        self.own_launches = 0
        self.reach = reach_of(filter_name)
        self.edges = EdgePixels(device, features, wanted.depth_count, max_pixels)
        decided = wanted.pattern.positions[: wanted.depth_count]
        self._samples = ListedSamples(device, features, decided) if wanted.lists_samples else None
        self._strides = 1, self.edges.stride
        self._sharing = kernels.build(device, "share_shading.cl", features)
        self._resolving = kernels.build(device, "resolve_samples.cl", features)
        packed = [x | y << 16 for x, y in wanted.pattern.positions]
        self._positions = buffers.upload(device, np.array(packed, dtype=np.uint32))
        self._weights = buffers.upload(device, weight_table(filter_name, wanted.pattern))
        self._sums = buffers.create(device, 20 * max_pixels) if self.reach else None

    @property
    def launches(self) -> int:
        """Kernels launched so far, the shader's apart."""
        return self.own_launches + self.edges.launches + (0 if self._samples is None else self._samples.launches)

    @staticmethod
    def bytes_per_pixel(wanted: Antialiasing, filter_name: str, at_worst: bool) -> int:
        """Device bytes a pixel of a band takes here; at_worst : where each pixel shows all that it can."""
        surfaces = wanted.depth_count if at_worst else min(TYPICAL_SURFACES, wanted.depth_count)
        of_edge = 4 + len(wanted.pattern) + 1 + 4 + surfaces * (12 + Shader.bytes_per_pixel(("color",)))
        return 4 * wanted.depth_count + BYTES_PER_PIXEL + 1 + of_edge + (20 if reach_of(filter_name) else 0)

    def resolve_band(self, passes: SamplePasses, row: int, rows: int, pixel_count: int, target: Shader) -> None:
        """Replace the colour of a band in `target`, shaded at the centres, by that of its samples. Waits."""
        self._decide(passes, row, rows, pixel_count)
        self._count("samples_shaded", 0 if self.parts else pixel_count)
        self._share(passes, pixel_count, target)

    def _decide(self, passes: SamplePasses, row: int, rows: int, pixel_count: int) -> None:
        """Find what the samples show, and flag the pixels that are looked at, edge pixels or all. Waits."""
        edges, decided = self.edges, self.wanted.pattern.positions[: self.wanted.depth_count]
        tiles = passes.tiles
        if self._samples is not None and isinstance(tiles, TileRasterizer) and tiles.takes_samples:
            visits = range(len(decided) // VISIT_SAMPLES)
            edges.start(passes, row, rows, pixel_count, decided)
            self._samples.decide_all(passes, visits, pixel_count, edges.center, edges.flags, edges.prims)
            self._strides = len(decided), 1
        else:
            edges.decide(passes, row, rows, pixel_count, decided)
            if not self.parts:
                passes.timed("resolve", partial(edges.flag, pixel_count))
                return
            buffers.fill(self.device, edges.flags, np.uint8(255), pixel_count)
        passes.timed("resolve", partial(edges.count_flags, pixel_count))

    def _share(self, passes: SamplePasses, pixel_count: int, target: Shader) -> None:
        """Shade the surfaces of the pixels that are flagged, or (`parts`) their samples, and resolve the pixels."""
        view, timed = passes.tiles.view, passes.timed
        edge_count = timed("resolve", partial(self.edges.list_flagged, pixel_count))
        at_once = self._pixels_at_once if self.parts else edge_count
        for first in range(0, edge_count, max(1, at_once)):
            count = min(at_once, edge_count - first)
            listed_count = timed("resolve", partial(self._list_surfaces, view, first, count))
            if listed_count:
                lists = self.edges.room("shaded_prims"), listed_count, 0, self.edges.room("places")
                timed("shade", partial(self.shader.shade, view, *lists))
            timed("resolve", partial(self._resolve, view, pixel_count, first, count, listed_count, target))
            self._count("samples_shaded", listed_count)
        if not edge_count and self.reach:
            timed("resolve", partial(self._resolve, view, pixel_count, 0, 0, 0, target))
        self._count("pixels_parted" if self.parts else "edge_pixels", edge_count)

    def _count(self, name: str, count: int) -> None:
        self.counts[name] = self.counts.get(name, 0) + count

    def _list_surfaces(self, view: np.ndarray, first: int, edge_count: int) -> int:
        """Surfaces of the samples of listed pixels from `first` on, and the list of those to be shaded; returns its
        length. Waits."""
        room = self.edges.room
        of_samples = {
            "edge_count": edge_count, "depth_count": self.wanted.depth_count,
            "sample_count": len(self.wanted.pattern), "pixel_stride": self._strides[0],
            "sample_stride": self._strides[1], "sample_positions": self._positions,
            "edge_pixels": room("edge_pixels"), "first_edge": first, "sample_prims": self.edges.prims,
            "surfaces": room("surfaces", edge_count * len(self.wanted.pattern)),
            "new_surfaces": room("new_surfaces", edge_count),
        }  # fmt: skip
        self._launch(
            "group_samples", padded(edge_count), WORK_GROUP, parts=int(self.parts), center_prims=self.edges.center,
            **ground_arguments(self.shader, view, self._projection), **of_samples,
        )  # fmt: skip
        count = self.edges.sum_entries(room("new_surfaces"), edge_count)
        self._launch(
            "list_surfaces", -(-edge_count // LIST_CHUNK), 1, begins=self.edges.begins, **of_samples,
            first_surfaces=room("first_surfaces", 4 * edge_count),
            shaded_prims=room("shaded_prims", 4 * count), places=room("places", 8 * count),
        )  # fmt: skip
        self.shader.make_room(count)
        return count

    def _resolve(
        self, view: np.ndarray, pixel_count: int, first: int, edge_count: int, listed_count: int, target: Shader
    ) -> None:
        shared = {
            "pixel_count": pixel_count, "sample_count": len(self.wanted.pattern), "listed_count": listed_count,
            "surfaces": self.edges.room("surfaces"), "first_surfaces": self.edges.room("first_surfaces"),
            "shaded": self.shader.values, "values": target.values,
        }  # fmt: skip
        if not self.reach:
            edges = {"edge_count": edge_count, "edge_pixels": self.edges.room("edge_pixels"), "first_edge": first}
            self._resolving.launch("resolve_surfaces", padded(edge_count), WORK_GROUP, **edges, **shared)
            self.own_launches += 1
            return
        self._resolving.launch(
            "filter_surfaces", padded(pixel_count), WORK_GROUP, width=int(view["width"]), reach=self.reach,
            weights=self._weights, edge_places=self.edges.places, sums=self._sums, **shared,
        )  # fmt: skip
        done = {"pixel_count": pixel_count, "sums": self._sums, "values": target.values}
        self._resolving.launch("divide_sums", padded(pixel_count), WORK_GROUP, **done)
        self.own_launches += 2

    def _launch(self, kernel: str, items: int, group: int, **arguments: Any) -> None:
        self._sharing.launch(kernel, items, group, **arguments)
        self.own_launches += 1
