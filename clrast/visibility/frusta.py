"""Frusta through a BVH, or over the whole scene: the methods of the continuum that use no lists of tiles.

Davidovic et al., '3D Rasterization', section 4, Fig. 7; the kernels are cl/setup_triangles.cl, cl/refit_nodes.cl
and cl/traverse_frusta.cl. Bits depend neither on the oracles nor on the frusta's size, nor on bands.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from clrast.errors import DeviceError
from clrast.opencl import buffers, kernels
from clrast.opencl.device import Device
from clrast.opencl.features import Features
from clrast.opencl.layout import NODE_WIDTH
from clrast.visibility.bvh import Bvh
from clrast.visibility.geometry import Geometry
from clrast.visibility.loop_limits import loop_limit
from clrast.visibility.methods import Method
from clrast.visibility.screen_bounds import ScreenBounds, round_up
from clrast.visibility.settle import ContenderList
from clrast.visibility.view import band_tile_count, set_band
from clrast.visibility.work import WorkCounters

if TYPE_CHECKING:
    import pyopencl as cl

REFIT_GROUP = 64

MAX_LAUNCHES_ALIKE = 256
"""Launches after each of which all stacks are as high as before: chance for a few, and an end where nothing moves."""

NODE_BYTES = 4 * 5 * NODE_WIDTH
"""Device bytes of a node: children, counts, bounds, nearness."""


def stack_capacity(levels: int, frustum_log2: int) -> int:
    """Entries that a traversal's stack can come to hold, rounded up to a power of two.

    On a path each level of the tree leaves at most NODE_WIDTH - 1 siblings and each split 3 quarters.
    """
    most = levels * (NODE_WIDTH - 1) + 3 * frustum_log2 + 1
    return 1 << max(5, (most - 1).bit_length())


def traversal_bytes(features: Features, bvh: Bvh | None, triangle_count: int) -> tuple[int, int]:
    """(bytes, bytes a root frustum) of device memory that a traversal takes beside bounds and ids."""
    tree = NODE_BYTES * bvh.node_count if bvh is not None else 0
    nearest = 4 * round_up(triangle_count, features.vector_width) if features.node_bounds else 0
    stacks = 8 + 8 * features.stack_capacity if features.resumable else 0
    return tree + nearest, stacks


class FrustumTraversal:
    """Buffers and launches of one view of one scene; stages in order: setup, then rasterize per band.

    surfaces : buffers by the argument names of traverse_frusta, read where features.alpha_mask is on.
    contenders : the list of what float32 leaves open, where features.filtered is on.
    band_rows : most rows of root frusta that a band will have. Every method only enqueues, except where it says so.
    """

    def __init__(
        self,
        device: Device,
        features: Features,
        method: Method,
        view: np.ndarray,
        geometry: Geometry,
        surfaces: Mapping[str, Any],
        band_rows: int,
        work: WorkCounters | None = None,
        contenders: ContenderList | None = None,
    ) -> None:
        self.device, self.features, self.method = device, features, method
        self.view, self.geometry, self.work = view.copy(), geometry, work
        self.contenders = contenders
        self.surfaces = {**surfaces, "indices": geometry.corner_vertices} if features.alpha_mask else {}
        self.launches = 0
        self.bounds = ScreenBounds(device, features, geometry)
        self._program = kernels.build(device, "traverse_frusta.cl", features)
        self._limit = loop_limit(device)
        pixel_count = min(band_rows << features.tile_log2, int(view["height"])) * int(view["width"])
        self.visible_prims = buffers.create(device, 4 * pixel_count)
        nearness_bytes = 4 * features.nearness_planes * pixel_count
        self.nearness = buffers.create(device, nearness_bytes) if features.keep_nearness else None
        self._nodes: dict[str, cl.Buffer] = {}
        self._make_nodes()
        self._frustum_count = band_rows * int(view["tile_columns"])
        self._resume: dict[str, cl.Buffer] = {}
        if features.resumable:
            self._resume = {
                "resume_points": buffers.create(device, 8 * self._frustum_count),
                "stacks": buffers.create(device, 8 * self._frustum_count * features.stack_capacity),
            }

    def _make_nodes(self) -> None:
        names = ("children", "slot_counts", "node_low", "node_high", "node_nearest")
        bvh, prims = self.geometry.bvh, self.geometry.prims
        if bvh is None or prims is None:
            empty = buffers.create(self.device, 4)
            self._nodes = {name: empty for name in (*names, "prims")}
            return
        self._refit = kernels.build(self.device, "refit_nodes.cl", self.features)
        size = 4 * NODE_WIDTH * bvh.node_count
        self._nodes = {
            "children": buffers.upload(self.device, bvh.children),
            "slot_counts": buffers.upload(self.device, bvh.counts),
            **{name: buffers.create(self.device, size) for name in names[2:]},
            "prims": prims,
        }

    def setup(self) -> None:
        """Find every triangle's canonical bound, and those of the nodes."""
        self.bounds.find(self.view, self.work, self.contenders)
        self.launches += 1
        if not self.method.needs_bvh:
            return
        assert self.geometry.bvh is not None
        for first, end in reversed(self.geometry.bvh.levels):
            self._refit.launch(
                "refit_nodes",
                -(-(end - first) * NODE_WIDTH // REFIT_GROUP) * REFIT_GROUP,
                REFIT_GROUP,
                first_node=first,
                node_count=end - first,
                bounds_low=self.bounds.low,
                bounds_high=self.bounds.high,
                nearest=self.bounds.nearest,
                **{name: buffer for name, buffer in self._nodes.items() if name != "prims"},
            )
            self.launches += 1

    def start_band(self, band_row: int, band_rows: int) -> int:
        """Choose the band that is rendered next; returns 0, as there are no lists."""
        set_band(self.view, band_row, band_rows, self.features.tile_log2)
        return 0

    def finish_lists(self) -> None:
        """Nothing: frusta have no lists."""

    def rasterize(self, layer: int = 0, front: tuple[cl.Buffer, cl.Buffer] | None = None) -> None:
        """Decide every sample of the band: `visible_prims` (and `nearness`, where kept).

        front : nearness and prim_ids of the layer in front, where `layer` > 0. Waits where contenders are settled,
        and on drivers that limit loops.
        """
        if self.contenders is None:
            self._decide_samples(layer, front)
        else:
            self.contenders.decide(self.view, self._decide_samples, self.visible_prims, self.nearness, layer, front)

    def _decide_samples(self, layer: int, front: tuple[cl.Buffer, cl.Buffer] | None) -> None:
        frustum_count = band_tile_count(self.view, self.features.tile_log2)
        arguments: dict[str, Any] = {
            "view": self.view,
            "frustum_count": frustum_count,
            "triangle_count": self.geometry.triangle_count,
            "small_ratio": self.method.small_ratio,
            "corners": self.geometry.corners,
            "bounds_low": self.bounds.low,
            "bounds_high": self.bounds.high,
            "nearest": self.bounds.nearest if self.bounds.nearest is not None else self._nodes["children"],
            "visible_prims": self.visible_prims,
            **self._nodes,
            **self.surfaces,
            **self._resume,
        }
        if self.contenders is not None:
            arguments |= self.contenders.sample_arguments()
        if self.work is not None:
            arguments |= self.work.of_samples(self.view, frustum_count)
        if self.features.keep_nearness:
            front_nearness, front_prims = front or (self.nearness, self.visible_prims)
            arguments |= {
                "resume": 0,
                "layer": layer,
                "front_nearness": front_nearness,
                "front_prims": front_prims,
                "nearness": self.nearness,
            }
        if self.features.resumable:
            arguments["iterations"] = self._limit or 0
        self._launch(frustum_count, arguments)
        before, alike = np.zeros((frustum_count, 2), dtype=np.uint32), 0
        while self.features.resumable:
            points = buffers.download(self.device, self._resume["resume_points"], np.uint32, (frustum_count, 2))
            if not points[:, 0].any():
                break
            alike = alike + 1 if np.array_equal(points, before) else 0
            if alike > MAX_LAUNCHES_ALIKE:
                raise DeviceError("this driver limits loops to fewer than one step takes: use --method 3dr-binning")
            before = points
            arguments["resume"] = 1
            self._launch(frustum_count, arguments)

    def _launch(self, items: int, arguments: dict[str, Any]) -> None:
        self._program.launch("traverse_frusta", items, 1, **arguments)
        self.launches += 1

    def list_length(self) -> int:
        """No references."""
        return 0

    def list_bytes(self) -> int:
        """Bytes of what the traversal keeps beside the pixels: nodes, nearness of triangles, stacks."""
        fixed, of_frustum = traversal_bytes(self.features, self.geometry.bvh, self.geometry.triangle_count)
        return fixed + of_frustum * self._frustum_count
