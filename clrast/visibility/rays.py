"""Rays of any origin and direction through a scene: closest hit, any hit, and rays that leave a hit.

The kernels are cl/trace_rays.cl, what they promise is said in cl/intersect_triangle.clh: hits and their order are
those of real arithmetic, whatever the hierarchy, the vector width and the runtime.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from clrast.errors import DeviceError, SceneError, UsageError
from clrast.opencl import buffers, kernels
from clrast.opencl.device import Device
from clrast.opencl.features import Features, Precision, Projection
from clrast.opencl.layout import BLOCK_LANES, MAX_LISTED, NO_HIT
from clrast.opencl.runtimes import PREFETCHING
from clrast.visibility.bvh import Bvh, build_bvh
from clrast.visibility.geometry import Geometry, build_geometry
from clrast.visibility.leaf_blocks import BLOCK_BYTES, leaf_blocks
from clrast.visibility.loop_limits import loop_limit
from clrast.visibility.ray_arrays import (
    MAX_COORDINATE,
    RayBuffers,
    RayHits,
    as_vectors,
    check_directions,
    padded,
)
from clrast.visibility.ray_grid import GridRequest, RayGrid, build_ray_grid
from clrast.visibility.triangle_list import list_triangles

if TYPE_CHECKING:
    import pyopencl as cl

BufferMaker = Callable[[str, int], "cl.Buffer"]
"""Gives a buffer of a name, of so many bytes or more."""

HIT_BYTES = {"prims_hit": 4, "distances": 8, "weights": 16}
"""What trace_closest writes of a ray, by its argument names."""

WORK_GROUP = 16

MIN_RAYS_PER_ITEM, MAX_RAYS_PER_ITEM = 64, 512
"""Rays that one work item traces: the more, the less its last ones wait for each other alone. 64 cost a tenth."""

ITEMS_PER_UNIT = 16
"""Work items for each processor, as long as they have MIN_RAYS_PER_ITEM rays, so that all are done together."""

MIN_STACK = 15
"""Levels of a ray's stack at least, so that all but the deepest hierarchies share one program."""


def ray_features(device: Device, bvh: Bvh | None, **masks: Any) -> Features:
    """The build options of a tracer over that hierarchy, or without one over a grid.

    `Geometry` must be made with them, at world_scale 1.

    masks : what is looked up at hits, of alpha_mask, alpha_blend, textures and vertex_colors; with indirect it is drawn
    whether rays pass a blending surface.
    """
    return Features(
        device.vector_width,
        precision=Precision.EXACT,
        projection=Projection.PERSPECTIVE,
        float64=device.has_fp64,
        leaf_order=bvh is not None,
        prefetch=device.runtime in PREFETCHING,
        stack_capacity=1 if bvh is None else max(MIN_STACK, bvh.depth),
        **masks,
    )


def make_tracer(
    device: Device,
    positions: np.ndarray,
    triangles: np.ndarray,
    bvh: Bvh | None = None,
    grid: GridRequest | None = None,
) -> RayTracer:
    """A tracer with geometry of its own.

    positions : (vertex_count, 3) float32, world space. triangles : (triangle_count, 3) uint32. bvh : over the same
    triangles, built where it is missing; or grid : one to build in its place. Raises SceneError, CapacityError or
    DeviceError.
    """
    check_loops(device)
    if len(triangles) == 0:
        raise SceneError("rays need a scene, and this one has no triangle")
    used = positions[np.unique(triangles)]
    if not (np.abs(used) <= MAX_COORDINATE).all():
        raise SceneError(f"a vertex lies farther than {MAX_COORDINATE:.0e} from 0, too far for rays: scale the scene")
    return build_tracer(device, positions, triangles, grid or bvh or build_bvh(positions, triangles, device=device))


def build_tracer(
    device: Device,
    positions: np.ndarray,
    triangles: np.ndarray,
    structure: Bvh | GridRequest,
    masks: Mapping[str, cl.Buffer] | None = None,
    **looked_up: bool,
) -> RayTracer:
    """A tracer through a hierarchy over the same triangles, or a grid that is built here.

    masks : as of RayTracer. looked_up : features of these, as of ray_features. Raises CapacityError or DeviceError.
    """
    bvh = structure if isinstance(structure, Bvh) else None
    features = ray_features(device, bvh, **looked_up)
    geometry = build_geometry(device, features, positions, triangles, 1.0, bvh)
    started = time.perf_counter()
    grid = None
    if isinstance(structure, GridRequest):
        grid = build_ray_grid(device, features, geometry, positions, triangles, structure)
    grid_ms = 1000 * (time.perf_counter() - started)
    tracer = RayTracer(device, features, geometry, masks, grid)
    tracer.grid_ms = grid_ms
    return tracer


def check_loops(device: Device) -> None:
    """Raise DeviceError where a driver ends long loops: a ray's walk, and exact arithmetic, may be long."""
    if loop_limit(device) is not None:
        raise DeviceError(f"{device.name} ends long loops early, and a ray may need them: use --device pocl")


class RayTracer:
    """Rays against one scene; every method waits, but those that enqueue.

    features : of `ray_features`. geometry : built with these, at world_scale 1, with its hierarchy; or without, and
    grid : over it. masks : with features.alpha_mask or alpha_blend what surfaces are looked up in, by the arguments of
    trace_rays.cl; rays then pass where a surface is masked, and `any` also where it blends and is thin;
    with features.indirect each ray is stopped by what blends with the probability alpha, and is to bring its draws.
    `accelerator` : bvh or grid. `is_listed` : whether there are so few triangles that rays meet each, without a walk
    through the hierarchy; with the same bits. `launches` : kernels launched. `nbytes` : of the structure and its
    leaves on the device. `grid_ms` : what building the grid took, where build_tracer did.
    Raises DeviceError on drivers that limit loops.
    """

    def __init__(
        self,
        device: Device,
        features: Features,
        geometry: Geometry,
        masks: Mapping[str, cl.Buffer] | None = None,
        grid: RayGrid | None = None,
    ) -> None:
        check_loops(device)
        if geometry.world_positions is None or (geometry.prims is None) == (grid is None):
            raise UsageError("rays need a geometry of precision 'exact', in the order of a BVH's leaves or with a grid")
        self.device, self.features, self.geometry = device, features, geometry
        self.launches = 0
        self.grid_ms = 0.0
        is_small = geometry.triangle_count <= MAX_LISTED
        self.is_listed = is_small and grid is None and not masks and features.vector_width > 1
        self._program = kernels.build(device, "trace_list.cl" if self.is_listed else "trace_rays.cl", features)
        self._leaving = kernels.build(device, "leave_hits.cl", features)
        self._masks = dict(masks or {})
        if grid is None:
            self.accelerator = "bvh"
            structure, places, counts = self._list_arguments() if self.is_listed else self._hierarchy_arguments()
        else:
            self.accelerator = "grid"
            structure, places, counts = grid.arguments(), grid.block_places, grid.block_counts
            self.nbytes = grid.nbytes
        self.nbytes += BLOCK_BYTES * len(places)
        leaves = {
            "blocks": buffers.create(device, BLOCK_BYTES * len(places)),
            "corners": geometry.corners,
            "prims": structure.pop("prims"),
        }
        self._scene: dict[str, Any] = {**leaves, **structure}
        self._vertices = {"positions": geometry.world_positions, "indices": geometry.indices}
        kernels.build(device, "pack_leaves.cl", features).launch(
            "pack_leaves",
            -(-len(places) // WORK_GROUP) * WORK_GROUP,
            WORK_GROUP,
            block_count=len(places),
            block_places=buffers.upload(device, places),
            block_counts=buffers.upload(device, counts),
            **leaves,
            **self._vertices,
        )

    def _hierarchy_arguments(self) -> tuple[dict[str, Any], np.ndarray, np.ndarray]:
        """Arguments that are a BVH's, and its blocks' places and counts."""
        bvh = self.geometry.bvh
        assert bvh is not None
        nodes, places, counts = leaf_blocks(bvh)
        self.nbytes = nodes.nbytes
        return {"prims": self.geometry.prims, "nodes": buffers.upload(self.device, nodes)}, places, counts

    def _list_arguments(self) -> tuple[dict[str, Any], np.ndarray, np.ndarray]:
        """Arguments that are those of trace_list.cl, and the places and counts of the list's blocks."""
        assert self.geometry.bvh is not None
        count = self.geometry.triangle_count
        places = np.arange(0, count, BLOCK_LANES, dtype=np.uint32)
        corners = buffers.download(self.device, self.geometry.corners, np.float32, (count, 3, 4))
        edges, listed = list_triangles(corners[:, :, :3], self.geometry.bvh.prims)
        self.nbytes = edges.nbytes + listed.nbytes
        counts = np.minimum(count - places, BLOCK_LANES).astype(np.uint32)
        arguments = {
            "prims": self.geometry.prims,
            "list_edges": buffers.upload(self.device, edges),
            "list": buffers.upload(self.device, listed),
            "edge_count": (edges.size - 4) // 6,
            "triangle_count": count,
        }
        return arguments, places, counts

    def closest(
        self,
        origins: np.ndarray,
        directions: np.ndarray,
        t_min: np.ndarray | float = 0.0,
        t_max: np.ndarray | float = np.inf,
        excluded: np.ndarray | None = None,
    ) -> RayHits:
        """The first hits with t_min < t < t_max.

        origins, directions : (ray_count, 3) float32, world space; directions of any length. t_min, t_max :
        (ray_count,) float32 or one number, in lengths of the direction. excluded : (ray_count,) uint32, a prim_id
        that each ray passes through, or NO_HIT. Raises UsageError for rays that are not finite or out of range.
        """
        rays = self.upload(origins, directions, t_min, t_max, excluded)
        count, made = rays.count, self.enqueue_closest(rays)
        prim_id = buffers.download(self.device, made["prims_hit"], np.uint32, count)
        distances = buffers.download(self.device, made["distances"], np.float32, (count, 2))
        weights = buffers.download(self.device, made["weights"], np.float32, (count, 4))
        return RayHits(prim_id, distances[:, 0], distances[:, 1], weights[:, :3])

    def any(
        self,
        origins: np.ndarray,
        directions: np.ndarray,
        t_min: np.ndarray | float = 0.0,
        t_max: np.ndarray | float = np.inf,
        excluded: np.ndarray | None = None,
    ) -> np.ndarray:
        """(ray_count,) bool: whether there is a hit with t_min < t < t_max; arguments as of `closest`."""
        rays = self.upload(origins, directions, t_min, t_max, excluded)
        return buffers.download(self.device, self.enqueue_any(rays), np.uint32, rays.count) != 0

    def enqueue_closest(self, rays: RayBuffers, room: BufferMaker | None = None) -> dict[str, cl.Buffer]:
        """Enqueue `closest` of rays on the device; returns what trace_closest writes, by its argument names.

        room : gives the buffers, by those names; else they are new.
        """
        room = room or self._new_buffer
        made = {name: room(name, nbytes * rays.count) for name, nbytes in HIT_BYTES.items()}
        self._trace("trace_closest", rays, **made)
        return made

    def enqueue_any(self, rays: RayBuffers, room: BufferMaker | None = None) -> cl.Buffer:
        """Enqueue `any` of rays on the device; returns [ray_count] uint, 1 where something is hit. room : as above."""
        occluded = (room or self._new_buffer)("occluded", 4 * rays.count)
        ends: dict[str, Any] = rays.ends or {"ends": None, "lamp_slots": None}
        self._trace("trace_any", rays, **ends, occluded=occluded)
        return occluded

    def _new_buffer(self, name: str, nbytes: int) -> cl.Buffer:
        return buffers.create(self.device, nbytes)

    def _trace(self, kernel: str, rays: RayBuffers, **others: Any) -> None:
        masks = {"indices": self.geometry.indices, **self._masks} if self._masks else {}
        draws = rays.draws if self.features.alpha_blend and self.features.indirect else {}
        arguments = {**rays.arguments, **self._scene, **masks, **draws, **others}
        if rays.count:
            if self.is_listed and kernel == "trace_closest":
                per_item, group = self.features.vector_width, WORK_GROUP
            else:
                per_item, group = self._rays_per_item(rays.count)
                arguments["rays_per_item"] = per_item
            items = -(-rays.count // (per_item * group)) * group
            self._program.launch(kernel, items, group, ray_count=rays.count, **arguments)
            self.launches += 1

    def _rays_per_item(self, count: int) -> tuple[int, int]:
        """Rays of a work item, and work items of a group."""
        width = self.features.vector_width
        if width == 1:
            return width, WORK_GROUP
        share = count // (ITEMS_PER_UNIT * self.device.compute_units)
        return max(MIN_RAYS_PER_ITEM, min(MAX_RAYS_PER_ITEM, share)), 1

    def enqueue_leave(self, count: int, path: int, **streams: Any) -> RayBuffers:
        """Enqueue leave_hits, which see: rays on the device that go on from items of streams.

        path : its number in the sample. streams : what leave_hits takes of items, and slot_count and slot_directions.
        """
        made = self._make_rays(count)
        keys = {"ray_keys": buffers.create(self.device, 4 * count)}
        self._leave("leave_hits", count, **streams, **self._vertices, **made, **keys)
        return RayBuffers(count, made, draws={**keys, "path": path})

    def enqueue_leave_for_light(self, count: int, path: int, **streams: Any) -> RayBuffers:
        """Enqueue leave_for_light, which see: rays on the device from items of streams to where light comes from.

        streams : what leave_for_light takes of items, and slot_ends and slot_lamps.
        """
        made = self._make_rays(count)
        keys = {"ray_keys": buffers.create(self.device, 4 * count)}
        ends = {
            "ends": buffers.create(self.device, 16 * count),
            "lamp_slots": buffers.create(self.device, 4 * count),
        }
        self._leave("leave_for_light", count, **streams, **self._vertices, **made, **keys, **ends)
        return RayBuffers(count, made, ends, {**keys, "path": path})

    def _make_rays(self, count: int) -> dict[str, cl.Buffer]:
        sizes = {"origins": 16, "directions": 16, "excluded": 4}
        return {name: buffers.create(self.device, size * count) for name, size in sizes.items()}

    def slots_of(self, prim_ids: np.ndarray) -> np.ndarray:
        """(n,) uint32, where triangles' corners lie: in the order of a hierarchy's leaves, or in that of the file."""
        if self.geometry.bvh is None:
            return prim_ids.astype(np.uint32)
        slots = np.zeros(self.geometry.triangle_count, dtype=np.uint32)
        slots[self.geometry.bvh.prims] = np.arange(self.geometry.triangle_count, dtype=np.uint32)
        return slots[prim_ids]

    def leave(self, prim_id: np.ndarray, barycentrics: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Where rays start that leave points of triangles: (ray_count, 3) float32, world space.

        prim_id : (ray_count,) uint32. barycentrics : (ray_count, 3) float32 of the points. directions : (ray_count, 3)
        float32 of the rays that leave. An origin lies strictly on the side of the triangle's plane that the direction
        points to (along the plane: on the side of its normal). Give prim_id as `excluded` to the ray. Raises
        UsageError for a prim_id that is none, and SceneError for a triangle without area.
        """
        prims = np.ascontiguousarray(prim_id, dtype=np.uint32)
        directions = as_vectors("directions", directions, len(prims))
        weights = as_vectors("barycentrics", barycentrics, len(prims))
        if len(prims) and int(prims.max()) >= self.geometry.triangle_count:
            raise UsageError(f"rays can leave prim_id 0 to {self.geometry.triangle_count - 1}, not {prims.max()}")
        check_directions(directions)
        origins = buffers.create(self.device, 16 * len(prims))
        self._leave(
            "offset_origins",
            len(prims),
            prims_left=buffers.upload(self.device, prims),
            weights=buffers.upload(self.device, padded(weights, 0.0)),
            directions=buffers.upload(self.device, padded(directions, 0.0)),
            **self._vertices,
            origins=origins,
        )
        found = buffers.download(self.device, origins, np.float32, (len(prims), 4))
        if not found[:, 3].all():
            raise SceneError(f"triangle {prims[np.argmin(found[:, 3])]} has no area: no ray can leave it")
        return found[:, :3]

    def upload(
        self,
        origins: np.ndarray,
        directions: np.ndarray,
        t_min: np.ndarray | float = 0.0,
        t_max: np.ndarray | float = np.inf,
        excluded: np.ndarray | None = None,
    ) -> RayBuffers:
        """Rays on the device; arguments and errors as of `closest`."""
        count = len(origins)
        origins, directions = as_vectors("origins", origins, count), as_vectors("directions", directions, count)
        if not (np.abs(origins) <= MAX_COORDINATE).all():
            raise UsageError(f"an origin of a ray lies farther than {MAX_COORDINATE:.0e} from 0: scale the scene")
        check_directions(directions)
        low, high = np.asarray(t_min, dtype=np.float32), np.asarray(t_max, dtype=np.float32)
        if not (low >= 0).all() or np.isnan(high).any():
            raise UsageError("t_min of a ray must be 0 or more, and t_max a number")
        if excluded is None:
            excluded = np.full(count, NO_HIT, dtype=np.uint32)
        if len(excluded) != count:
            raise UsageError(f"{count} rays need as many excluded prim_ids, not {len(excluded)}")
        arguments = {
            "origins": buffers.upload(self.device, padded(origins, low)),
            "directions": buffers.upload(self.device, padded(directions, high)),
            "excluded": buffers.upload(self.device, np.ascontiguousarray(excluded, dtype=np.uint32)),
        }
        return RayBuffers(count, arguments)

    def _leave(self, kernel: str, count: int, **arguments: Any) -> None:
        """A kernel of leave_hits.cl, whose work items take vector_width rays each."""
        if count:
            per_group = WORK_GROUP * self.features.vector_width
            items = -(-count // per_group) * WORK_GROUP
            self._leaving.launch(kernel, items, WORK_GROUP, ray_count=count, **arguments)
            self.launches += 1
