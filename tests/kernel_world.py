"""Scenes, cameras of short binary numbers and renders for the tests of kernels; nothing here says what is right."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clrast import job as job_module
from clrast import job_choices
from clrast.image.frame import Frame
from clrast.opencl import layout
from clrast.opencl.device import Device
from clrast.options import make_options
from clrast.scene.camera import CameraVectors
from clrast.scene.model import Material, Scene
from clrast.shading.effects import plan_effects
from clrast.visibility import screen_bounds
from clrast.visibility.loop_limits import loop_limit
from clrast.visibility.methods import METHODS

NO_HIT = layout.NO_HIT

# Oclgrind has no `llvm.experimental.noalias.scope.decl`, which clang leaves where it inlines a function.
os.environ.setdefault("OCLGRIND_BUILD_OPTIONS", "-cl-opt-disable -Dalways_inline=")


def as_float32(values: Sequence[float] | np.ndarray) -> tuple[float, float, float]:
    """Three numbers, each rounded to float32."""
    x, y, z = (float(np.float32(value)) for value in values)
    return (x, y, z)


def perspective(
    width: int,
    height: int,
    eye: Sequence[float] = (0, 0, 0),
    d0: Sequence[float] | None = None,
    dx: Sequence[float] | None = None,
    dy: Sequence[float] | None = None,
) -> CameraVectors:
    """A view along -z; by default a pixel at distance 1 has the side 2^-5, and (0, 0) is the image's centre."""
    step = 2.0**-5
    return CameraVectors(
        "perspective",
        width,
        height,
        origin=as_float32(eye),
        direction=(0.0, 0.0, -1.0),
        first=as_float32((-step * width / 2, step * height / 2, -1) if d0 is None else d0),
        tangent_x=as_float32((step, 0, 0) if dx is None else dx),
        tangent_y=as_float32((0, -step, 0) if dy is None else dy),
    )


def orthographic(
    width: int,
    height: int,
    e0: Sequence[float] = (0, 0, 0),
    d: Sequence[float] = (0, 0, -1),
    ex: Sequence[float] = (1, 0, 0),
    ey: Sequence[float] = (0, -1, 0),
) -> CameraVectors:
    """By default a pixel is a unit, and the sample (x, y) lies at world (x, -y)."""
    return CameraVectors(
        "orthographic",
        width,
        height,
        origin=as_float32(e0),
        direction=as_float32(d),
        first=as_float32(e0),
        tangent_x=as_float32(ex),
        tangent_y=as_float32(ey),
    )


def methods_on(device: Device) -> tuple[str, ...]:
    """Those that the device is not refused for: grids need loops that no driver ends."""
    return tuple(name for name, row in METHODS.items() if not row.grid or loop_limit(device) is None)


def make_scene(positions: Any, triangles: Any = None, **fields: Any) -> Scene:
    """A scene of one object and material, unless `fields` say otherwise.

    positions : (vertex_count, 3); triangles : (triangle_count, 3) vertex indices, by default (0 1 2), (3 4 5) ...
    """
    vertices = np.asarray(positions, dtype=np.float32).reshape(-1, 3)
    corners = np.arange(len(vertices)) if triangles is None else np.asarray(triangles)
    corners = np.ascontiguousarray(corners.reshape(-1, 3), dtype=np.uint32)
    nothing = np.zeros(len(corners), dtype=np.uint32)
    made = {"positions": vertices, "triangles": corners, "object_ids": nothing, "material_ids": nothing, **fields}
    return Scene(**made)


def with_material(scene: Scene, **fields: Any) -> Scene:
    """The scene with one material for everything."""
    return replace(scene, materials=(Material(**fields),))


@contextmanager
def settings(tile_log2: int = 5, chunk_count: int | None = None) -> Iterator[None]:
    """Tile size and number of chunks meanwhile; no pixel may depend on either."""
    before = job_choices.TILE_LOG2_SMALL, screen_bounds.CHUNK_COUNT
    job_choices.TILE_LOG2_SMALL, screen_bounds.CHUNK_COUNT = tile_log2, chunk_count or screen_bounds.CHUNK_COUNT
    try:
        yield
    finally:
        job_choices.TILE_LOG2_SMALL, screen_bounds.CHUNK_COUNT = before


def start(device: Device, scene: Scene, view: CameraVectors, **options: Any) -> tuple[job_module.RenderJob, Frame]:
    """A whole render with camera vectors as given, so that they can be short numbers; the job is kept, too.

    vector_width : in place of the device's own.
    """
    width = options.pop("vector_width", None)
    given = make_options({"size": (view.width, view.height), "device": device.runtime, **options})
    if width:
        device = replace(device, vector_width=width)
    job = job_module.RenderJob(device, scene, view, given, plan_effects(scene, given.aov, given.effects, given.mode))
    channels = job.allocate()
    job.render_frame(channels, first=True)
    return job, Frame(channels, {}, job.stats())


def render(device: Device, scene: Scene, view: CameraVectors, **options: Any) -> Frame:
    """The frame of `start`."""
    return start(device, scene, view, **options)[1]


def render_ids(device: Device, scene: Scene, view: CameraVectors, **options: Any) -> np.ndarray:
    """(height, width) uint32 `id.prim`."""
    return render(device, scene, view, aov="id", **options)["id.prim"]


@dataclass(frozen=True)
class Raster:
    """What the rasterizer made of one view, in one band.

    prim_id : (height, width) uint32
    bounds : (triangle_count, 4) int64, x0 y0 x1 y1 in pixels
    lists : (row, column) of a tile -> its prim_ids, in their order
    reference_count : counted (tile, triangle) pairs
    """

    prim_id: np.ndarray
    bounds: np.ndarray
    lists: Mapping[tuple[int, int], np.ndarray]
    reference_count: int
    tile_size: int


def rasterize(
    device: Device,
    scene: Scene,
    view: CameraVectors,
    tile_log2: int = 5,
    chunk_count: int | None = None,
    **options: Any,
) -> Raster:
    """An id render, and the bounds and lists behind it."""
    with settings(tile_log2, chunk_count):
        job, frame = start(device, scene, view, aov="id", **options)
    assert job.band_count == 1
    columns = -(-view.width // (1 << tile_log2))
    lists = {(k // columns, k % columns): found for k, found in enumerate(job.tiles.tile_lists())}
    return Raster(frame["id.prim"], job.tiles.bounds.read(), lists, job.tiles.read_reference_count(), 1 << tile_log2)


def coverage(device: Device, scene: Scene, view: CameraVectors, **options: Any) -> np.ndarray:
    """(triangle_count, height, width) bool: what each triangle covers when it is rendered alone."""
    alone = (replace(scene, triangles=scene.triangles[k : k + 1]) for k in range(scene.triangle_count))
    return np.stack([render_ids(device, part, view, **options) != NO_HIT for part in alone])
