"""What samples of listed pixels show where surfaces blend, layer by layer (cl/listed_layers.cl)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from clrast.opencl import buffers, kernels
from clrast.opencl.device import Device
from clrast.opencl.features import Features
from clrast.visibility.sample_passes import SamplePasses
from clrast.visibility.sample_patterns import Position

if TYPE_CHECKING:
    import pyopencl as cl

WORK_GROUP = 64


def nearness_bytes(features: Features) -> int:
    """Device bytes a sample's nearness takes."""
    return 4 * features.nearness_planes


class ListedLayers:
    """Decides samples of a list's pixels, each by a pass over the band that meets nothing beside the list.

    With features.keep_nearness. Samples are given by number, with where they lie.
    """

    def __init__(self, device: Device, features: Features, max_pixels: int) -> None:
        self.device = device
        self.launches = 0
        self._is_masked = not features.filtered
        self._program = kernels.build(device, "listed_layers.cl", features)
        self._front_nearness = buffers.create(device, nearness_bytes(features) * max_pixels)
        self._front_prims = buffers.create(device, 4 * max_pixels)
        self._found = buffers.create(device, 4 * max_pixels)

    @staticmethod
    def bytes_per_pixel(features: Features) -> int:
        """Device bytes a pixel of a band takes here."""
        return nearness_bytes(features) + 2 * 4

    def start(self, pixel_count: int, pixels: cl.Buffer, count: int) -> None:
        """Enqueue: from here on the list is `pixels`, [count] of the band."""
        self._count = count
        self._list: dict[str, Any] = {"count": count, "pixel_count": pixel_count, "pixels": pixels}
        fronts = {"front_nearness": self._front_nearness, "front_prims": self._front_prims}
        self._launch("close_fronts", pixel_count, pixel_count=pixel_count, **fronts)

    def decide(self, passes: SamplePasses, samples: Mapping[int, Position], found: dict[str, Any]) -> None:
        """Find what some samples show first. Waits.

        found : prims [count * stride] and nearness, by the samples' numbers, and `stride`.
        """
        front = None
        if self._is_masked:
            opened = {"count": self._count, "pixels": self._list["pixels"]}
            self._launch("open_fronts", self._count, **opened, front_nearness=self._front_nearness)
            front = self._front_nearness, self._front_prims
        for sample, position in samples.items():
            self._pass(passes, sample, position, int(front is not None), front, found)
            passes.listed += 0 if front is None else self._count

    def decide_behind(
        self, passes: SamplePasses, samples: Mapping[int, Position], layer: int, found: dict[str, Any],
        shaded: dict[str, Any],
    ) -> None:  # fmt: skip
        """Replace what samples show by what lies behind it, where they are shaded and open. Waits.

        shaded : which those are: visit_count, chosen, first_shaded, open_samples.
        """
        front = self._front_nearness, self._front_prims
        for sample, position in samples.items():
            self._launch(
                "put_fronts", self._count, **self._list, **shaded, **found, sample=sample,
                front_nearness=self._front_nearness, front_prims=self._front_prims,
            )  # fmt: skip
            self._pass(passes, sample, position, layer, front, found)

    def _pass(
        self, passes: SamplePasses, sample: int, position: Position, layer: int,
        front: tuple[cl.Buffer, cl.Buffer] | None, found: dict[str, Any],
    ) -> None:  # fmt: skip
        passes.decide((position,), (self._found,), layer, front)
        self._launch(
            "take_layer", self._count, **self._list, **found, sample=sample, visible_prims=self._found,
            band_nearness=passes.tiles.nearness,
        )  # fmt: skip

    def _launch(self, kernel: str, items: int, **arguments: Any) -> None:
        self._program.launch(kernel, -(-items // WORK_GROUP) * WORK_GROUP, WORK_GROUP, **arguments)
        self.launches += 1
