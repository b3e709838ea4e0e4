"""Triangles on the device, laid out for rasterization: the part that all frames of a scene share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clrast.opencl import buffers, kernels
from clrast.opencl.device import Device
from clrast.opencl.features import Features
from clrast.visibility.bvh import Bvh

if TYPE_CHECKING:
    import pyopencl as cl

WORK_GROUP = 64


@dataclass(frozen=True)
class Geometry:
    """Triangles on the device, in the order of the file.

    positions : [vertex_count] float4, world space times the view's world_scale, for shading
    indices : [3 * triangle_count] uint, for shading
    world_positions : [vertex_count] float4, world space, as given: what is exact starts from; or None
    corners : [3 * triangle_count] float4, as prepare_triangles.cl writes them, for everything else
        (with a BVH in the order of its leaves: by slot)
    corner_vertices : [3 * triangle_count] uint, the vertices that the corners are, where masks look attributes up
    bvh : the hierarchy over the triangles, and prims : [triangle_count] uint, prim_id of each slot; or None
    """

    positions: cl.Buffer
    indices: cl.Buffer
    corners: cl.Buffer
    triangle_count: int
    vertex_count: int
    corner_vertices: cl.Buffer | None = None
    world_positions: cl.Buffer | None = None
    bvh: Bvh | None = None
    prims: cl.Buffer | None = None

    @property
    def nbytes(self) -> int:
        """Bytes on the device."""
        masked_bytes = 0 if self.corner_vertices is None else 12
        slot_bytes = 0 if self.prims is None else 4
        unscaled_bytes = 0 if self.world_positions in (None, self.positions) else 16
        return (16 + unscaled_bytes) * self.vertex_count + (12 + 48 + masked_bytes + slot_bytes) * self.triangle_count


def build_geometry(
    device: Device,
    features: Features,
    positions: np.ndarray,
    triangles: np.ndarray,
    world_scale: float,
    bvh: Bvh | None = None,
) -> Geometry:
    """Upload a scene's triangles and lay them out; waits.

    positions : (vertex_count, 3) float32, world space. triangles : (triangle_count, 3) uint32. bvh : with
    features.leaf_order the hierarchy whose leaves the triangles are laid out by.
    """
    scaled = np.zeros((len(positions), 4), dtype=np.float32)
    scaled[:, :3] = positions
    world_positions = buffers.upload(device, scaled) if features.filtered else None
    buffer = world_positions
    if buffer is None or world_scale != 1.0:
        scaled *= np.float32(world_scale)
        buffer = buffers.upload(device, scaled)
    indices = buffers.upload(device, np.ascontiguousarray(triangles, dtype=np.uint32))
    corners = buffers.create(device, 48 * len(triangles))
    masks = {"corner_vertices": buffers.create(device, 12 * len(triangles))} if features.alpha_mask else {}
    order = {"prims": buffers.upload(device, bvh.prims)} if features.leaf_order and bvh is not None else {}
    kernels.build(device, "prepare_triangles.cl", features).launch(
        "prepare_triangles",
        -(-len(triangles) // WORK_GROUP) * WORK_GROUP,
        WORK_GROUP,
        triangle_count=len(triangles),
        positions=buffer,
        indices=indices,
        corners=corners,
        **masks,
        **order,
    )
    device.queue.finish()
    return Geometry(
        buffer,
        indices,
        corners,
        len(triangles),
        len(positions),
        world_positions=world_positions,
        bvh=bvh,
        **masks,
        **order,
    )
