"""What options, scene and device decide before a render's buffers: method, hierarchy, tiles, features of kernels."""

from __future__ import annotations

import time
import weakref

import numpy as np

from clrast.errors import DeviceError
from clrast.opencl.device import Device
from clrast.opencl.features import Features, Precision, Projection
from clrast.opencl.runtimes import PREFETCHING
from clrast.options import COARSE, RenderOptions
from clrast.scene.camera import CameraVectors
from clrast.scene.model import Scene
from clrast.shading.effects import EffectPlan
from clrast.visibility.bvh import Bvh, build_bvh
from clrast.visibility.cost_model import DEFAULT
from clrast.visibility.frusta import stack_capacity
from clrast.visibility.loop_limits import loop_limit
from clrast.visibility.methods import AUTO, SNAPPED_DEFAULT, Method, resolve_method

TILE_LOG2_SMALL, TILE_LOG2_LARGE = 5, 6
LARGE_IMAGE = 1 << 19
"""Pixels from which on tiles of 64 x 64 are faster than 32 x 32: fewer lists, and still enough for all threads."""
MAX_FRUSTUM_LOG2_OF_SCALARS = 5
"""Largest root frustum where a work item takes one sample at a time, as such devices' only parallelism, or where
drivers limit its loops, which must leave room for more than clearing and storing its samples."""

_HIERARCHIES: dict[int, tuple[weakref.ref[np.ndarray], weakref.ref[np.ndarray], Bvh, float]] = {}


def hierarchy_of(device: Device, scene: Scene) -> tuple[Bvh, float]:
    """The BVH over a scene's triangles and the milliseconds that its build took; built once for its two arrays.

    Scenes that differ in cameras or lights alone share it. device : the first that asks moves subtrees, see build_bvh.
    """
    found = _HIERARCHIES.get(id(scene.triangles))
    if found is None or found[0]() is not scene.triangles or found[1]() is not scene.positions:
        started = time.perf_counter()
        bvh = build_bvh(scene.positions, scene.triangles, device=device)
        arrays = weakref.ref(scene.triangles), weakref.ref(scene.positions)
        found = (*arrays, bvh, 1000 * (time.perf_counter() - started))
        for key in [key for key, each in _HIERARCHIES.items() if each[0]() is None]:
            del _HIERARCHIES[key]
        _HIERARCHIES[id(scene.triangles)] = found
    return found[2], found[3]


def named_method(options: RenderOptions) -> Method:
    """The method that the options name, with their oracles; the default one for `auto`."""
    if options.casts_grid:
        return resolve_method("raycast-grid", evaluation=options.evaluation)
    if options.method == AUTO:
        default = SNAPPED_DEFAULT if options.precision == "fixed" else DEFAULT
        return resolve_method(default, evaluation=options.evaluation)
    return resolve_method(
        options.method, options.oracle, intersection=options.intersection, evaluation=options.evaluation
    )


def square_log2(device: Device, method: Method, pixel_count: int) -> int:
    """Side of the tiles or root frusta that a work item takes, as a power of two."""
    if method.tiles or method.grid:
        large = pixel_count >= LARGE_IMAGE and loop_limit(device) is None
        return TILE_LOG2_LARGE if large else TILE_LOG2_SMALL
    side_log2 = method.frustum.bit_length() - 1
    is_free = device.vector_width > 1 and loop_limit(device) is None
    return side_log2 if is_free else min(side_log2, MAX_FRUSTUM_LOG2_OF_SCALARS)


def make_features(
    device: Device,
    scene: Scene,
    vectors: CameraVectors,
    options: RenderOptions,
    plan: EffectPlan,
    method: Method,
    bvh: Bvh | None,
) -> Features:
    """The build options of all kernels of one render."""
    if options.precision == "double" and not device.has_fp64:
        raise DeviceError(f"--precision double: {device.name} has no float64: use exact, which does without")
    tile_log2 = square_log2(device, method, options.size[0] * options.size[1])
    limited = loop_limit(device) is not None
    return method.configure(Features(
        vector_width=device.vector_width,
        tile_log2=tile_log2,
        precision=Precision[options.precision.upper()],
        float64=device.has_fp64,
        projection=Projection[vectors.projection.upper()],
        keep_nearness=plan["alpha blend"] or limited or method.grid,
        prefetch=device.runtime in PREFETCHING,
        alpha_mask=plan["alpha mask"],
        alpha_blend=plan["alpha blend"],
        textures=plan["textures"],
        normal_interpolation=plan["normal interpolation"],
        emission=plan["emission"],
        vertex_colors=scene.colors is not None,
        derivatives=plan["derivatives"] and plan["textures"],
        coarse_derivatives=plan["derivatives"] and options.effects.get("derivatives") == COARSE,
        lit=bool(scene.lights),
        secondary=plan["secondary acceleration structure"],
        reflection=plan["reflection"],
        refraction=plan["refraction"],
        indirect=plan["indirect light"],
        counters=options.counters or "cost" in options.aov,
        node_bounds=not (method.tiles or method.grid),
        leaf_order=method.needs_bvh,
        stack_capacity=stack_capacity(bvh.depth, tile_log2) if bvh is not None else 1,
        resumable=not (method.tiles or method.grid) and limited,
    ))
