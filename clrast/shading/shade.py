"""Deferred shading of a band's visible triangles into planes of channels (cl/shade_hits.cl)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clrast.opencl import buffers, kernels
from clrast.opencl.device import Device
from clrast.opencl.features import Features
from clrast.opencl.layout import PLANE_NONE, PLANES
from clrast.shading.surfaces import SurfaceBuffers
from clrast.visibility.geometry import Geometry

if TYPE_CHECKING:
    from clrast.shading.integrator import Integrator

GROUP_CHANNELS: dict[str, tuple[str, ...]] = {
    "color": ("R", "G", "B", "A"),
    "depth": ("Z",),
    "distance": ("distance.Y",),
    "normal": ("N.X", "N.Y", "N.Z", "Ng.X", "Ng.Y", "Ng.Z"),
    "position": ("P.X", "P.Y", "P.Z"),
    "bary": ("bary.U", "bary.V"),
    "uv": ("uv.U", "uv.V"),
    "albedo": ("albedo.R", "albedo.G", "albedo.B"),
    "ray": (
        *("ray.X", "ray.Y", "ray.Z"),
        *("raydx.X", "raydx.Y", "raydx.Z"),
        *("raydy.X", "raydy.Y", "raydy.Z"),
    ),
}
"""Float planes that shade_hits writes for each group, in their order."""

WORK_GROUP = 64

HIT_BYTES = {"hit_weights": 16, "hit_positions": 16, "hit_directions": 16, "sample_keys": 4}
"""What shade_hits leaves of each sample where rays go on from hits."""

COLOR_BYTES = {"hit_colors": 16}
"""And of its colour, where that is more than the material says: it is looked up once."""

FOOTPRINT_BYTES = {"hit_footprints": 48}
"""And of what it covers, where textures are filtered."""


def channel_names(groups: tuple[str, ...]) -> list[str]:
    """Names of the float planes of these groups, in plane order."""
    return [name for group, names in GROUP_CHANNELS.items() if group in groups for name in names]


class Shader:
    """Shades bands. groups : output groups asked for; max_pixels : pixels of the largest band.

    footprint : side of what a sample stands for, pixels, where textures are filtered.
    integrator : with features.secondary what rays that go on from hits are traced by; `color` is among the groups then.
    """

    def __init__(
        self,
        device: Device,
        features: Features,
        geometry: Geometry,
        surfaces: SurfaceBuffers,
        groups: tuple[str, ...],
        light_count: int,
        max_pixels: int,
        integrator: Integrator | None = None,
    ) -> None:
        self.device = device
        self.integrator = integrator
        self.footprint = 1.0
        self._filters = features.derivatives
        self._hit_sizes = dict(HIT_BYTES)
        if features.colors_vary:
            self._hit_sizes |= COLOR_BYTES
        if features.derivatives:
            self._hit_sizes |= FOOTPRINT_BYTES
        self.geometry = geometry
        self.surfaces = surfaces
        self.light_count = light_count
        self.launches = 0
        self.names = channel_names(groups)
        self.has_ids = "id" in groups
        self._program = kernels.build(device, "shade_hits.cl", features)
        self._features = features
        self._lanes = features.vector_width
        self._planes = np.zeros((), dtype=PLANES)
        for group in PLANES.names or ():
            first = channel_names(groups).index(GROUP_CHANNELS[group][0]) if group in groups and group != "id" else -1
            self._planes[group] = PLANE_NONE if first < 0 else first
        self._planes["id"] = 0 if self.has_ids else PLANE_NONE
        self._capacity = max_pixels
        self._make_planes()

    def sibling(self, features: Features, groups: tuple[str, ...], max_pixels: int) -> Shader:
        """Another shader of the same scene."""
        of_scene = (self.geometry, self.surfaces, groups, self.light_count)
        return Shader(self.device, features, *of_scene, max_pixels, self.integrator)

    def make_room(self, sample_count: int) -> None:
        """Grow the planes for so many samples; what they held may be lost."""
        if sample_count > self._capacity:
            self._capacity = sample_count + sample_count // 8
            self._make_planes()

    def _make_planes(self) -> None:
        self.values = buffers.create(self.device, 4 * len(self.names) * self._capacity)
        self.ids = buffers.create(self.device, 4 * (2 * self._capacity if self.has_ids else 1))
        self.open_pixels = buffers.create(self.device, self._capacity)
        sizes = {} if self.integrator is None else self._hit_sizes
        self._hits = {name: buffers.create(self.device, size * self._capacity) for name, size in sizes.items()}

    @staticmethod
    def bytes_per_pixel(groups: tuple[str, ...]) -> int:
        """Device bytes that a pixel of a band takes here."""
        return 4 * len(channel_names(groups)) + (8 if "id" in groups else 0) + 1

    def shade(
        self, view: np.ndarray, visible_prims: Any, pixel_count: int, layer: int, places: Any | None = None,
        follows: bool = True,
    ) -> None:  # fmt: skip
        """Enqueue the shading of one layer of a band; layers after the first only add colour behind it.

        Where rays go on from hits, waits for them.

        places : with features.sample_list [pixel_count] uint2, which samples: pixel of the band, place in it.
        follows : whether rays go on from hits at all; without them colour is not to be used.
        """
        items = -(-pixel_count // self._lanes)
        self._program.launch(
            "shade_hits",
            -(-items // WORK_GROUP) * WORK_GROUP,
            WORK_GROUP,
            view=view,
            planes=self._planes,
            pixel_count=pixel_count,
            light_count=self.light_count,
            layer=layer,
            positions=self.geometry.positions,
            indices=self.geometry.indices,
            **self.surfaces.buffers,
            visible_prims=visible_prims,
            **({} if places is None else {"places": places}),
            **self._hits,
            **({"footprint": self.footprint} if self._filters else {}),
            values=self.values,
            ids=self.ids,
            open_pixels=self.open_pixels,
        )
        self.launches += 1
        if self.integrator is not None and follows:
            color = int(self._planes["color"])
            self.integrator.gather(visible_prims, self._hits, pixel_count, self.values, color)

    def close_pixels(self, front_nearness: Any, front_prims: Any, pixel_count: int) -> None:
        """Enqueue: where the last layer is opaque or empty, nothing behind it will be found."""
        kernels.build(self.device, "close_pixels.cl", self._features).launch(
            "close_pixels",
            -(-pixel_count // WORK_GROUP) * WORK_GROUP,
            WORK_GROUP,
            pixel_count=pixel_count,
            open_pixels=self.open_pixels,
            front_nearness=front_nearness,
            front_prims=front_prims,
        )
        self.launches += 1

    def has_open_pixels(self, pixel_count: int) -> bool:
        """Whether a pixel shows a BLEND surface, so that what is behind it counts. Waits."""
        with buffers.mapped(self.device, self.open_pixels, np.uint8, pixel_count) as flags:
            return bool(flags.any())

    def read(self, channels: dict[str, np.ndarray], first_row: int, row_count: int, width: int) -> None:
        """Copy a band into rows first_row.. of the (H, W) channel arrays. Waits."""
        pixel_count = row_count * width
        rows = slice(first_row, first_row + row_count)
        for k, name in enumerate(self.names):
            out = channels[name][rows]
            buffers.download(self.device, self.values, np.float32, out.shape, 4 * k * pixel_count, out)
        if self.has_ids:
            for k, name in enumerate(("id.object", "id.material")):
                out = channels[name][rows]
                buffers.download(self.device, self.ids, np.uint32, out.shape, 4 * k * pixel_count, out)
