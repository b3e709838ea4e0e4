"""Visibility of one band of pixels at several places in its pixels: passes of any method over one setup and binning."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from clrast.visibility.sample_patterns import CENTER, Position
from clrast.visibility.view import place_samples, spread_samples

if TYPE_CHECKING:
    import pyopencl as cl

    from clrast.visibility.frusta import FrustumTraversal
    from clrast.visibility.tiles import TileRasterizer

Timed = Callable[[str, Callable[[], Any]], Any]


class SamplePasses:
    """Passes over bands. timed : runs work and books its time on a stage.

    Since `start_frame`, `count` : passes; `visits` and `listed` : passes over listed pixels alone, or behind a layer,
    and the samples that these decided first.
    """

    def __init__(self, tiles: TileRasterizer | FrustumTraversal, timed: Timed) -> None:
        self.tiles, self.timed = tiles, timed
        self.start_frame()
        self._is_centered = False

    def start_frame(self) -> None:
        """Count from 0 on."""
        self.count = self.visits = self.listed = 0

    def set_up(self, positions: Sequence[Position]) -> None:
        """Find the triangles' bounds, which then hold for samples at each of these positions, 256ths of a pixel."""
        self._is_centered = tuple(positions) == (CENTER,)
        place_samples(self.tiles.view, positions[0])
        spread_samples(self.tiles.view, positions)
        self.timed("setup", self.tiles.setup)

    def set_up_center(self) -> None:
        """Find the bounds for samples at the pixels' centres."""
        self.set_up((CENTER,))

    def return_to_center(self) -> None:
        """The same, where the last band left them elsewhere."""
        if not self._is_centered:
            self.set_up_center()

    def start_band(self, row: int, rows: int) -> int:
        """Bin the triangles of a band; returns the number of references. Waits."""
        references = self.timed("bin", partial(self.tiles.start_band, row, rows))
        self.timed("bin", self.tiles.finish_lists)
        return references

    def decide(
        self, positions: Sequence[Position], planes: Sequence[cl.Buffer] | None = None, layer: int = 0,
        front: tuple[cl.Buffer, cl.Buffer] | None = None,
    ) -> None:  # fmt: skip
        """Find what is visible at these places of each pixel of the band. Waits once.

        planes : where to, for each; None for `tiles.visible_prims`, which has the last. layer, front : as the tiles'
        `rasterize` takes them.
        """
        self.timed("visibility", partial(self._decide, positions, planes, layer, front))
        if front is None:
            self.count += len(positions)
        else:
            self.visits += len(positions)

    def _decide(
        self, positions: Sequence[Position], planes: Sequence[cl.Buffer] | None, layer: int,
        front: tuple[cl.Buffer, cl.Buffer] | None,
    ) -> None:  # fmt: skip
        own = self.tiles.visible_prims
        for position, plane in zip(positions, planes or [own] * len(positions), strict=True):
            place_samples(self.tiles.view, position)
            self.tiles.visible_prims = plane
            self.tiles.rasterize(layer, front)
        self.tiles.visible_prims = own
