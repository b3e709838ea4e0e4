"""Antialiasing by shading every sample: the passes of a pattern, summed by a filter (cl/resolve_samples.cl)."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

from clrast.opencl import buffers, kernels
from clrast.opencl.device import Device
from clrast.opencl.features import Features
from clrast.shading.edge_pixels import padded
from clrast.shading.filters import reach_of, weight_table
from clrast.shading.shade import WORK_GROUP, Shader
from clrast.visibility.sample_passes import SamplePasses
from clrast.visibility.sample_patterns import Pattern

Layers = Callable[[int, Shader], None]
"""Adds what lies behind BLEND surfaces to the colour that a shader has for a band of so many pixels."""


class Supersampler:
    """Shades every sample of a band. shader : of colour alone; layers : None where nothing blends."""

    def __init__(
        self,
        device: Device,
        features: Features,
        pattern: Pattern,
        filter_name: str,
        shader: Shader,
        max_pixels: int,
        layers: Layers | None,
    ) -> None:
        shader.footprint = 1.0 / math.sqrt(len(pattern))
        self.device, self.pattern, self.shader, self.layers = device, pattern, shader, layers
        self.counts: dict[str, int] = {}
        self.reach = reach_of(filter_name)
        table = weight_table(filter_name, pattern)
        self._taps = table.shape[1]
        self._weights = buffers.upload(device, table)
        self._program = kernels.build(device, "resolve_samples.cl", features)
        self._sums = buffers.create(device, 20 * max_pixels)
        self.launches = 0

    @staticmethod
    def bytes_per_pixel() -> int:
        """Device bytes that a pixel of a band takes here: colour of one sample and sums."""
        return Shader.bytes_per_pixel(("color",)) + 20

    def resolve_band(self, passes: SamplePasses, row: int, rows: int, pixel_count: int, target: Shader) -> None:
        """Replace the colour of a band in `target` by that of its samples. Waits."""
        timed = passes.timed
        passes.set_up(self.pattern.positions)
        passes.start_band(row, rows)
        for k, position in enumerate(self.pattern.positions):
            passes.decide((position,))
            self.shade_pass(passes, pixel_count)
            timed("resolve", partial(self._add, k, int(passes.tiles.view["width"]), pixel_count))
        timed("resolve", partial(self._divide, pixel_count, target))

    def shade_pass(self, passes: SamplePasses, pixel_count: int) -> None:
        """Shade what the last pass found, layers behind it included."""
        tiles = passes.tiles
        passes.timed("shade", partial(self.shader.shade, tiles.view, tiles.visible_prims, pixel_count, 0))
        if self.layers is not None:
            self.layers(pixel_count, self.shader)
        self.counts["samples_shaded"] = self.counts.get("samples_shaded", 0) + pixel_count

    def _add(self, sample: int, width: int, pixel_count: int) -> None:
        self._launch(
            "add_sample", pixel_count, width=width, reach=self.reach, first_weight=sample * self._taps,
            begins=int(sample == 0), weights=self._weights, values=self.shader.values, sums=self._sums,
        )  # fmt: skip

    def _divide(self, pixel_count: int, target: Shader) -> None:
        self._launch("divide_sums", pixel_count, sums=self._sums, values=target.values)

    def _launch(self, kernel: str, pixel_count: int, **arguments: object) -> None:
        self._program.launch(kernel, padded(pixel_count), WORK_GROUP, pixel_count=pixel_count, **arguments)
        self.launches += 1
