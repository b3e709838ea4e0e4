"""`--aa auto:EPS` where surfaces blend: pixels are sampled until their estimated error is small.

The kernels are cl/adaptive_samples.cl. Where nothing blends, strata.py takes fewer samples.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from clrast.opencl import buffers, kernels
from clrast.opencl.constants import LIST_CHUNK
from clrast.opencl.device import Device
from clrast.opencl.features import Features
from clrast.shading.edge_pixels import BYTES_PER_PIXEL, FOOTPRINT, EdgePixels, padded, quads_of
from clrast.shading.shade import WORK_GROUP, Shader
from clrast.shading.supersample import Layers
from clrast.visibility.sample_passes import SamplePasses
from clrast.visibility.sample_patterns import Antialiasing

FIRST_SAMPLES = 8
"""Samples whose triangles are looked at in every pixel, and that every listed pixel gets."""

STATE_BYTES = 32
"""Device bytes of a listed pixel's sums."""


class AdaptiveSampler:
    """Samples a band's pixels in rounds of 8, 16, 32 .. samples.

    shader : of colour alone, of all pixels. layers : adds what lies behind the surfaces that blend.
    """

    lists_samples = False

    def __init__(
        self, device: Device, features: Features, wanted: Antialiasing, shader: Shader, max_pixels: int,
        layers: Layers,
    ) -> None:  # fmt: skip
        shader.footprint = FOOTPRINT
        self.device, self.shader, self.layers = device, shader, layers
        self.positions, self.threshold = wanted.pattern.positions, float(np.float32(wanted.threshold))
        self.counts: dict[str, int] = {}
        self.own_launches = 0
        self.edges = EdgePixels(device, features, FIRST_SAMPLES, max_pixels)
        self._program = kernels.build(device, "adaptive_samples.cl", features)

    @property
    def launches(self) -> int:
        """Kernels launched so far, the shader's apart."""
        return self.own_launches + self.edges.launches

    @staticmethod
    def bytes_per_pixel() -> int:
        """Device bytes a pixel of a band takes here where all are listed."""
        listed = 2 * (4 + STATE_BYTES) + 1 + Shader.bytes_per_pixel(("color",))
        return 4 * FIRST_SAMPLES + BYTES_PER_PIXEL + listed

    def resolve_band(self, passes: SamplePasses, row: int, rows: int, pixel_count: int, target: Shader) -> None:
        """Replace the colour of a band in `target`, shaded at the centres, where samples are called for. Waits."""
        self.edges.decide(passes, row, rows, pixel_count, self.positions[:FIRST_SAMPLES], self.positions)
        width = int(passes.tiles.view["width"])
        count = passes.timed("resolve", partial(self._list_first, width, pixel_count, target))
        self._count("edge_pixels", count)
        self._count("samples_shaded", pixel_count)
        pixels, state, first = self.edges.room("edge_pixels"), "state", 0
        while count:
            end = max(FIRST_SAMPLES, 2 * first)
            for k in range(first, end):
                self._add_sample(
                    passes, k, pixels, count, pixel_count, target, self.edges.room(state, STATE_BYTES * count)
                )
            judge = partial(self._judge, end, pixels, state, count, pixel_count, target)
            pixels, state, count = passes.timed("resolve", judge)
            first = end

    def _list_first(self, width: int, pixel_count: int, target: Shader) -> int:
        self.edges.flag(pixel_count)
        self._launch(
            "flag_contrast", quads_of(pixel_count, width), pixel_count=pixel_count, width=width,
            threshold=self.threshold, values=target.values, edge_flags=self.edges.flags,
        )  # fmt: skip
        self.edges.count_flags(pixel_count)
        return self.edges.list_flagged(pixel_count)

    def _add_sample(
        self, passes: SamplePasses, k: int, pixels: object, count: int, pixel_count: int, target: Shader, state: object
    ) -> None:
        """Shade sample k of the band, and add it to the sums of the listed pixels."""
        plane = self.edges.planes[k % FIRST_SAMPLES]
        passes.decide((self.positions[k],), (plane,))
        buffers.copy(self.device, plane, passes.tiles.visible_prims, 4 * pixel_count)
        passes.timed("shade", partial(self.shader.shade, passes.tiles.view, plane, pixel_count, 0))
        self.layers(pixel_count, self.shader)
        self._count("samples_shaded", pixel_count)
        self._launch(
            "gather_sample", count, count=count, pixel_count=pixel_count, begins=int(k == 0), pixels=pixels,
            colors=self.shader.values, values=target.values, state=state,
        )  # fmt: skip

    def _judge(
        self, samples: int, pixels: object, state: str, count: int, pixel_count: int, target: Shader
    ) -> tuple[object, str, int]:
        """Finish the pixels whose error is small; returns the list of the others. Waits."""
        other = "other_state" if state == "state" else "state"
        threshold = self.threshold if samples < len(self.positions) else math.inf
        keep, sums = self.edges.room("keep", count), self.edges.room(state)
        factor = float(np.float32(math.pow(samples, -0.75)))
        self._launch(
            "judge_pixels", count, count=count, sample_count=float(samples), error_factor=factor,
            threshold=threshold, state=sums, keep=keep,
        )  # fmt: skip
        kept = self.edges.sum_entries(keep, count)
        kept_pixels = self.edges.room(f"pixels_of_{other}", 4 * kept)
        self._program.launch(
            "keep_pixels", -(-count // LIST_CHUNK), 1, count=count, pixel_count=pixel_count, kept_count=kept,
            sample_count=float(samples), keep=keep, begins=self.edges.begins, pixels=pixels, state=sums,
            kept_pixels=kept_pixels, kept_state=self.edges.room(other, STATE_BYTES * kept), values=target.values,
        )  # fmt: skip
        self.own_launches += 1
        return kept_pixels, other, kept

    def _count(self, name: str, count: int) -> None:
        self.counts[name] = self.counts.get(name, 0) + count

    def _launch(self, kernel: str, items: int, /, **arguments: object) -> None:
        self._program.launch(kernel, padded(items), WORK_GROUP, **arguments)
        self.own_launches += 1
