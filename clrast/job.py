"""One view of one scene on one device: uploads once, renders any number of equal frames."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from clrast.errors import CapacityError
from clrast.image.frame import CHANNEL_GROUPS, channels_of
from clrast.job_choices import hierarchy_of, make_features, named_method
from clrast.opencl import buffers
from clrast.opencl.device import Device
from clrast.opencl.layout import NO_HIT
from clrast.options import RenderOptions
from clrast.scene.camera import CameraVectors
from clrast.scene.model import Scene
from clrast.shading.accumulation import Accumulation
from clrast.shading.antialias import check_bands, make_resolver, resolver_bytes, uses_centers
from clrast.shading.effects import EffectPlan
from clrast.shading.integrator import Depths, Integrator, no_rays
from clrast.shading.shade import Shader, channel_names
from clrast.shading.surfaces import MASK_ARGUMENTS, SurfaceBuffers
from clrast.visibility.bands import BandPlan, plan_bands
from clrast.visibility.bvh import Bvh
from clrast.visibility.cost_model import StageTimes, ViewCounts
from clrast.visibility.frusta import FrustumTraversal, traversal_bytes
from clrast.visibility.geometry import build_geometry
from clrast.visibility.grid import Grid, GridBuilder
from clrast.visibility.grid_passes import STATE_BYTES, GridPasses
from clrast.visibility.grid_rays import GRID_SHARE, GridRaycaster, check_loops, grid_view_bytes
from clrast.visibility.loop_limits import loop_limit
from clrast.visibility.methods import Method
from clrast.visibility.ray_grid import GridRequest
from clrast.visibility.sample_passes import SamplePasses
from clrast.visibility.screen_bounds import BOUND_BYTES
from clrast.visibility.settle import ContenderList, settle_bytes
from clrast.visibility.tiles import TileRasterizer
from clrast.visibility.view import build_camera, build_view
from clrast.visibility.work import COST_PLANES, WorkCounters

MEMORY_SHARE = 0.75
"""Part of the device's memory that is the budget where --memory names none."""


class RenderJob:
    """One view of one scene on one device: uploads once, renders any number of equal frames."""

    def __init__(
        self,
        device: Device,
        scene: Scene,
        vectors: CameraVectors,
        options: RenderOptions,
        plan: EffectPlan,
        method: Method | None = None,
        accumulation: Accumulation | None = None,
    ) -> None:
        self.device, self.scene, self.vectors, self.options, self.plan = device, scene, vectors, options, plan
        self.times: dict[str, float] = {}
        self.method = method or named_method(options)
        self.reason: str | None = None
        self.trial_ms = 0.0
        if self.method.grid:
            check_loops(device)
        traces_rays = plan["secondary acceleration structure"]
        self.accelerator = options.ray_accelerator if traces_rays else None
        needs_bvh = self.method.needs_bvh or self.accelerator == "bvh"
        hierarchy, self.times["build"] = hierarchy_of(device, scene) if needs_bvh else (None, 0.0)
        bvh = hierarchy if self.method.needs_bvh else None
        self.features = make_features(device, scene, vectors, options, plan, self.method, bvh)
        self.tile_log2 = self.features.tile_log2
        low, high = scene.bounding_box()
        self.view = build_view(vectors, low, high, self.tile_log2)
        self.groups = tuple(group for group in options.aov if group != "cost")
        started = time.perf_counter()
        self.geometry = build_geometry(
            device, self.features, scene.positions, scene.triangles, float(self.view["world_scale"]), bvh
        )
        self.times["prepare"] = 1000 * (time.perf_counter() - started)
        started = time.perf_counter()
        self.surfaces = SurfaceBuffers(device, scene, plan, reads_uv="uv" in self.groups)
        self.times["upload"] = 1000 * (time.perf_counter() - started)
        self.scene_bytes = self.geometry.nbytes + self.surfaces.nbytes
        self.grid = self._build_grid() if self.method.grid else None
        self.integrator = self._make_integrator(hierarchy if self.accelerator == "bvh" else None, accumulation)
        self.bands = self._plan_bands()
        check_bands(self.options, len(self.bands))
        started = time.perf_counter()
        self.work = WorkCounters(device, self.bands.max_pixels) if self.features.counters else None
        self.contenders = self._make_contenders()
        self.tiles = self._make_visibility()
        self.shader = Shader(
            device, self.features, self.geometry, self.surfaces, self.groups, len(scene.lights), self.bands.max_pixels,
            self.integrator,
        )  # fmt: skip
        layers = self._render_layers if plan["alpha blend"] else None
        self.resolver = make_resolver(device, self.features, options, self.shader, self.bands.max_pixels, layers)
        self.sample_passes = SamplePasses(self.tiles, self._timed)
        self.times["kernels"] = 1000 * (time.perf_counter() - started)
        self.hit_count = self.samples_decided = 0
        self.launches = self.passes = self.reference_peak = self.band_count = 0

    def _make_integrator(self, hierarchy: Bvh | None, accumulation: Accumulation | None) -> Integrator | None:
        if self.accelerator is None:
            return None
        paths = self.options.path_count if self.features.indirect else 1
        depths = Depths(self.options.depth, paths, self.options.seed)
        structure = hierarchy or GridRequest(self._grid_budget, self.options.grid_resolution)
        scene = (self.scene, self.surfaces, structure)
        made = Integrator(self.device, self.features, self.plan, *scene, depths, accumulation)
        self.scene_bytes += made.nbytes
        self.times["build"] += made.tracer.grid_ms
        return made

    @property
    def _budget(self) -> int:
        """Bytes of device memory that all buffers may take."""
        return self.options.memory or int(MEMORY_SHARE * self.device.global_memory_bytes)

    @property
    def _grid_budget(self) -> int:
        """Bytes of device memory that a grid may take, after what the scene takes."""
        return int(GRID_SHARE * (self._budget - self.scene_bytes))

    def _build_grid(self) -> Grid:
        started = time.perf_counter()
        low, high = self.scene.bounding_box()
        scale = float(self.view["world_scale"])
        count, corners = self.scene.triangle_count, self.geometry.corners
        builder = GridBuilder(self.device, self.features, corners, count, scale * low, scale * high, self._grid_budget)
        grid = builder.build(self.options.grid_resolution)
        self.times["build"] += 1000 * (time.perf_counter() - started)
        return grid

    def _make_contenders(self) -> ContenderList | None:
        if not self.features.filtered:
            return None
        masks = self.surfaces.named(*MASK_ARGUMENTS)
        camera, slots = build_camera(self.vectors), self.scene.triangle_count + self.features.vector_width
        return ContenderList(self.device, self.features, self.geometry, camera, masks, self.bands.max_pixels, slots)

    def _make_visibility(self) -> TileRasterizer | FrustumTraversal:
        masks = self.surfaces.named(*MASK_ARGUMENTS)
        common = (self.view, self.geometry, masks, self.bands.band_rows, self.work, self.contenders)
        if self.grid is not None and self.method.passes:
            choice = self.method.rays["pass"]
            return GridPasses(self.device, self.features, *common, grid=self.grid, choice=choice)
        if self.grid is not None:
            return GridRaycaster(self.device, self.features, *common, grid=self.grid)
        if self.method.tiles:
            return TileRasterizer(self.device, self.features, *common)
        return FrustumTraversal(self.device, self.features, self.method, *common)

    def _plan_bands(self) -> BandPlan:
        per_pixel = 4 + Shader.bytes_per_pixel(self.groups)
        planes = self.features.nearness_planes
        if self.features.keep_nearness:
            per_pixel += 4 * planes
        if self.plan["alpha blend"]:
            per_pixel += 8 + 4 * planes
        if self.method.passes:
            per_pixel += STATE_BYTES
        if self.features.counters:
            per_pixel += 4 * COST_PLANES
        of_rays = 0 if self.integrator is None else self.integrator.bytes_per_pixel(self.features.derivatives)
        per_pixel += of_rays
        resolving, piece = resolver_bytes(self.options, self.features, self.plan["alpha blend"], of_rays)
        streams = 0 if self.integrator is None else self.integrator.largest_piece(self.features.derivatives)
        fixed, of_square = 0, 0
        if self.grid is not None:
            fixed = self.grid.nbytes + grid_view_bytes(self.scene.triangle_count)
        elif not self.method.tiles:
            fixed, of_square = traversal_bytes(self.features, self.geometry.bvh, self.scene.triangle_count)
        if self.features.filtered:
            width, height = self.options.size
            fixed += settle_bytes(width * height, self.scene.triangle_count)
        return plan_bands(
            self.view,
            self.tile_log2,
            fixed_bytes=self.scene_bytes + BOUND_BYTES * self.scene.triangle_count + fixed,
            square_bytes=of_square,
            pixel_bytes=per_pixel + resolving,
            piece_bytes=max(4, piece, 4 * len(channel_names(self.groups)), streams),
            budget=self._budget,
            max_piece=self.device.max_allocation_bytes,
            limited=loop_limit(self.device) is not None,
        )

    def allocate(self) -> dict[str, np.ndarray]:
        """The channel arrays of the frame, in file order."""
        width, height = self.options.size
        channels = {}
        for name in channels_of(self.options.aov):
            channels[name] = np.zeros((height, width), dtype=np.uint32 if name.startswith("id.") else np.float32)
        return channels

    def time_frame(self) -> StageTimes:
        """Setup, bin and visibility of the whole image, timed; nothing is shaded."""
        self._frame_times: dict[str, float] = {}
        rows = int(self.view["tile_rows"])
        self._timed("setup", self.tiles.setup)
        self._timed("bin", partial(self.tiles.start_band, 0, rows))
        self._timed("bin", self.tiles.finish_lists)
        self._timed("visibility", self.tiles.rasterize)
        return StageTimes(**self._frame_times)

    def count_view(self) -> ViewCounts:
        """What the last frame showed."""
        width, height = self.options.size
        prims = buffers.download(self.device, self.tiles.visible_prims, np.uint32, width * height)
        hits = prims[prims != NO_HIT]
        seen = np.bincount(hits, minlength=1)
        areas = self.tiles.bounds.areas()
        return ViewCounts(
            seen=int(np.count_nonzero(seen)),
            in_view=int(np.count_nonzero(areas)),
            references=self.tiles.list_length(),
            bound_samples=int(areas.sum()),
            hits=len(hits),
        )

    def _timed(self, stage: str, work: Callable[[], Any]) -> Any:
        started = time.perf_counter()
        result = work()
        self.device.queue.finish()
        self._frame_times[stage] = self._frame_times.get(stage, 0.0) + 1000 * (time.perf_counter() - started)
        return result

    def render_frame(self, channels: dict[str, np.ndarray], first: bool) -> None:
        """Render all bands into `channels`; keeps the smallest time of each stage unless `first`."""
        self._frame_times = {}
        self.hit_count = self.passes = self.band_count = self.samples_decided = 0
        self.sample_passes.start_frame()
        if self.integrator is not None:
            self.integrator.start_frame()
        if self.resolver is not None:
            self.resolver.counts.clear()
        before = self._count_launches()
        if self.work is not None:
            self.work.clear()
        self.sample_passes.set_up_center()
        for row, rows in self.bands:
            self._render_band(channels, row, rows)
        self.launches = self._count_launches() - before
        self.passes += self.sample_passes.count + self.sample_passes.visits
        self.samples_decided += self.sample_passes.listed
        for stage, spent in self._frame_times.items():
            self.times[stage] = spent if first else min(spent, self.times[stage])

    def _render_band(self, channels: dict[str, np.ndarray], row: int, rows: int) -> None:
        width, height = self.options.size
        passes_before = self.sample_passes.count
        self.sample_passes.return_to_center()
        references = self._timed("bin", partial(self.tiles.start_band, row, rows))
        if self.options.memory is not None and self.bytes_device() > self.options.memory:
            self._split_band(channels, row, rows)
            return
        self._timed("bin", self.tiles.finish_lists)
        self.reference_peak = max(self.reference_peak, references)
        self.band_count += 1
        first_row = row << self.tile_log2
        row_count = min(rows << self.tile_log2, height - first_row)
        pixel_count = row_count * width
        if self.work is not None:
            self.work.clear_cost()
        self._timed("visibility", self.tiles.rasterize)
        self.passes += 1
        follows = uses_centers(self.options, self.plan["alpha blend"])
        shade = partial(self.shader.shade, self.tiles.view, self.tiles.visible_prims, pixel_count, 0, follows=follows)
        self._timed("shade", shade)
        self._timed("resolve", lambda: self._read_prims(channels, first_row, row_count))
        if self.plan["alpha blend"]:
            self._render_layers(pixel_count, self.shader)
        if self.resolver is not None:
            self.resolver.resolve_band(self.sample_passes, row, rows, pixel_count, self.shader)
        self.samples_decided += (1 + self.sample_passes.count - passes_before) * pixel_count
        self._timed("resolve", lambda: self.shader.read(channels, first_row, row_count, width))
        if self.work is not None and "cost" in self.options.aov:
            costs = tuple(channels[name] for name in CHANNEL_GROUPS["cost"])
            self.work.read_cost(costs, first_row, row_count, pixel_count)

    def _count_launches(self) -> int:
        """Kernels launched by this job's stages so far."""
        resolving = () if self.resolver is None else (self.resolver, self.resolver.shader)
        others = [each for each in (self.contenders, self.integrator) if each is not None]
        return sum(each.launches for each in (self.tiles, self.shader, *others, *resolving))

    def _split_band(self, channels: dict[str, np.ndarray], row: int, rows: int) -> None:
        """Two bands in place of one whose lists do not fit the budget."""
        check_bands(self.options, 2)
        if rows == 1:
            raise CapacityError(
                f"--memory {self.options.memory} is too small: one row of tiles needs {self.bytes_device()} bytes: "
                "give at least as many"
            )
        self._render_band(channels, row, rows // 2)
        self._render_band(channels, row + rows // 2, rows - rows // 2)

    def _read_prims(self, channels: dict[str, np.ndarray], first_row: int, row_count: int) -> None:
        width = self.options.size[0]
        with buffers.mapped(self.device, self.tiles.visible_prims, np.uint32, (row_count, width)) as prims:
            self.hit_count += int(np.count_nonzero(prims != NO_HIT))
            if "id.prim" in channels:
                channels["id.prim"][first_row : first_row + row_count] = prims

    def _render_layers(self, pixel_count: int, shader: Shader) -> None:
        """Add what lies behind BLEND surfaces, layer by layer; each layer lies strictly behind the last.

        `tiles.visible_prims` stays what the samples show first.
        """
        layer, size = 0, 4 * pixel_count
        nearness_size = size * self.features.nearness_planes
        sizes = (nearness_size, size, size)
        front_nearness, front_prims, own_prims = (buffers.create(self.device, each) for each in sizes)
        first_prims = self.tiles.visible_prims
        assert self.tiles.nearness is not None
        while shader.has_open_pixels(pixel_count):
            layer += 1
            buffers.copy(self.device, self.tiles.nearness, front_nearness, nearness_size)
            buffers.copy(self.device, self.tiles.visible_prims, front_prims, size)
            self.tiles.visible_prims = own_prims
            shader.close_pixels(front_nearness, front_prims, pixel_count)
            self._timed("visibility", partial(self.tiles.rasterize, layer, (front_nearness, front_prims)))
            self.passes += 1
            shade = partial(shader.shade, self.tiles.view, self.tiles.visible_prims, pixel_count, layer)
            self._timed("shade", shade)
        self.tiles.visible_prims = first_prims

    def bytes_device(self) -> int:
        """Bytes of all device buffers of this job."""
        return (
            self.scene_bytes
            + BOUND_BYTES * self.scene.triangle_count
            + self.bands.pixel_bytes * self.bands.max_pixels
            + self.tiles.list_bytes()
            + (0 if self.contenders is None else self.contenders.nbytes)
        )

    def work_counts(self) -> tuple[dict[str, int], dict[str, int]]:
        """What the counters found: entries of `counts` and of `other_counts`; empty where they are off."""
        if self.work is None:
            return {}, {}
        found = self.work.collect()
        known = {name: found.pop(name) for name in ("setups", "edge_evaluations", "traversal_steps")}
        return {**known, "intersection_tests": found.pop("samples_tested")}, found

    def stats(self) -> dict[str, Any]:
        """The stats of DESIGN section 2; what is not counted is None."""
        counted, more_counted = self.work_counts()
        triangles = self.scene.triangle_count
        return {
            "camera": self.vectors.named(),
            "image": dict(zip(("width", "height"), self.options.size, strict=True)),
            "device": {"name": self.device.name, "platform": self.device.platform, "version": self.device.version},
            "method": self.method.name,
            "method_requested": self.options.method,
            "method_reason": self.reason or "asked for",
            "precision": self.options.precision,
            "aa": self.options.aa,
            "mode": self.options.mode,
            "accelerator": self.accelerator,
            "bytes_device": self.bytes_device(),
            "bytes_per_triangle": self.bytes_device() / triangles,
            "counts": {
                "triangles": triangles,
                "samples": self.samples_decided,
                "hits": self.hit_count,
                "rays_primary": self.samples_decided,
                **(no_rays() if self.integrator is None else self.integrator.counts),
                "traversal_steps": None if self.method.needs_bvh or self.method.grid else 0,
                "kernel_launches": self.launches,
                "passes": self.passes,
                **counted,
            },
            "other_counts": {
                **{"bands": self.band_count, "tile_references": self.reference_peak, **more_counted},
                **({} if self.resolver is None else self.resolver.counts),
                **({} if self.contenders is None else self.contenders.counts),
                **(self.tiles.counts() if isinstance(self.tiles, GridRaycaster) else {}),
            },
            "times_ms": {
                **{stage: 0.0 for stage in ("build", "setup", "bin", "visibility", "shade", "resolve", "plan")},
                **self.times,
            },
            "effects": self.plan.as_stats(),
            "effect_costs": {} if self.integrator is None else self.integrator.effect_costs(),
        }
