"""The last rungs of the precision ladder on the device: what the float32 filter left open is settled here.

The kernels are cl/settle_contenders.cl; what is listed is said in cl/filtered_samples.clh. `decide` waits for the
list's length.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from clrast.errors import CapacityError
from clrast.opencl import buffers, kernels
from clrast.opencl.device import Device
from clrast.opencl.features import Features
from clrast.opencl.layout import (
    CAMERA,
    CONTENDER_COUNT,
    CONTENDER_EXACT,
    CONTENDER_FACINGS,
    CONTENDER_FLOAT64,
    CONTENDER_WORDS,
)
from clrast.visibility.geometry import Geometry
from clrast.visibility.loop_limits import loop_limit

if TYPE_CHECKING:
    import pyopencl as cl

CONTENDER_BYTES = 8
COUNTS = {"decided_float64": CONTENDER_FLOAT64, "contenders": CONTENDER_COUNT, "decided_exact": CONTENDER_EXACT}
"""Name in the stats -> word: samples that float64 knew, pairs that it left, those that took integers."""

MIN_CONTENDERS = 1 << 14
PIXELS_PER_CONTENDER = 8
"""Pixels for each of which a list has room for one contender at first; lists that are too short grow."""

WORKERS_PER_UNIT = 16
"""Work items that share a list of unknown length, per compute unit."""


def first_capacity(pixel_count: int) -> int:
    """Contenders that a list has room for at first."""
    return max(MIN_CONTENDERS, pixel_count // PIXELS_PER_CONTENDER)


def settle_bytes(pixel_count: int, triangle_count: int) -> int:
    """Device bytes of the ladder: contenders, facings."""
    return CONTENDER_BYTES * first_capacity(pixel_count) + 5 * triangle_count


class ContenderList:
    """What float32 left open in one view, and the kernels that settle it.

    camera : CAMERA struct. pixel_count : most pixels of a band. masks : buffers by the argument names of
    settle_contenders, where features.alpha_mask is on.
    """

    def __init__(
        self,
        device: Device,
        features: Features,
        geometry: Geometry,
        camera: np.ndarray,
        masks: Mapping[str, Any],
        pixel_count: int,
        slot_count: int,
    ) -> None:
        assert camera.dtype == CAMERA
        self.device, self.features, self.geometry, self.camera = device, features, geometry, camera
        self._program = kernels.build(device, "settle_contenders.cl", features)
        self._masks: dict[str, Any] = {}
        if features.alpha_mask:
            own = {"corner_vertices": geometry.corner_vertices, "scaled_positions": geometry.positions}
            self._masks = {**masks, **own}
        self._limited = loop_limit(device) is not None
        self.capacity = first_capacity(pixel_count)
        self.contenders = buffers.create(device, CONTENDER_BYTES * self.capacity)
        self.state = buffers.create(device, 4 * CONTENDER_WORDS)
        self.unsure_slots = buffers.create(device, 4 * geometry.triangle_count)
        self.facing_signs = buffers.create(device, slot_count)
        self.counts = dict.fromkeys(COUNTS, 0)
        self.launches = 0
        buffers.fill(device, self.state, np.uint32(0), 4 * CONTENDER_WORDS)
        self._state = np.zeros(CONTENDER_WORDS, dtype=np.uint32)
        self._counted = self._state.copy()

    def setup_arguments(self) -> dict[str, Any]:
        """Of setup_triangles."""
        return {"contender_state": self.state, "unsure_slots": self.unsure_slots}

    def sample_arguments(self) -> dict[str, Any]:
        """Of rasterize_tiles and traverse_frusta."""
        return {
            "contender_capacity": self.capacity,
            "contender_state": self.state,
            "contenders": self.contenders,
            "facing_signs": self.facing_signs,
            "positions": self.geometry.world_positions,
            "prim_vertices": self.geometry.indices,
        }

    def _clear(self, word: int) -> None:
        """Zero a word that is not known to be zero."""
        if self._state[word]:
            buffers.fill(self.device, self.state, np.uint32(0), 4, 4 * word)
            self._state[word] = 0

    def start_view(self) -> None:
        """Before setup_triangles: nothing is listed."""
        self._clear(CONTENDER_FACINGS)
        self._state[CONTENDER_FACINGS] = 1  # unknown until it is read
        self.counts = dict.fromkeys(COUNTS, 0)

    def _items(self, listed: int | None) -> int:
        """Work items for a list: one an entry where drivers limit loops, else few, which share it."""
        if self._limited:
            assert listed is not None
            return max(1, listed)
        return WORKERS_PER_UNIT * max(1, self.device.compute_units)

    def _read(self) -> np.ndarray:
        return buffers.download(self.device, self.state, np.uint32, CONTENDER_WORDS, out=self._state)

    def settle_facing(self, view: np.ndarray, low: cl.Buffer, high: cl.Buffer) -> None:
        """Find the signs of the volumes that float32 could not tell; triangles seen edge-on get empty bounds."""
        listed = int(self._read()[CONTENDER_FACINGS]) if self._limited else None
        more = {"prims": self.geometry.prims} if self.features.leaf_order else {}
        self._program.launch(
            "settle_facing",
            self._items(listed),
            1,
            view=view,
            camera=self.camera,
            positions=self.geometry.world_positions,
            indices=self.geometry.indices,
            contender_state=self.state,
            unsure_slots=self.unsure_slots,
            facing_signs=self.facing_signs,
            bounds_low=low,
            bounds_high=high,
            **more,
        )
        self.launches += 1

    def settle(
        self,
        view: np.ndarray,
        visible_prims: cl.Buffer,
        nearness: cl.Buffer | None,
        layer: int = 0,
        front_prims: cl.Buffer | None = None,
    ) -> None:
        """Let every listed contender take its sample, if it must."""
        more = dict(self._masks)
        if self.features.keep_nearness:
            more |= {"layer": layer, "front_prims": front_prims or visible_prims, "nearness": nearness}
        self._program.launch(
            "settle_contenders",
            self._items(int(self._state[CONTENDER_COUNT])),
            1,
            view=view,
            camera=self.camera,
            contender_capacity=self.capacity,
            positions=self.geometry.world_positions,
            indices=self.geometry.indices,
            contenders=self.contenders,
            contender_state=self.state,
            visible_prims=visible_prims,
            **more,
        )
        self.launches += 1

    def decide(
        self,
        view: np.ndarray,
        decide_samples: Callable[[int, tuple[cl.Buffer, cl.Buffer] | None], None],
        visible_prims: cl.Buffer,
        nearness: cl.Buffer | None,
        layer: int,
        front: tuple[cl.Buffer, cl.Buffer] | None,
    ) -> None:
        """Run `decide_samples(layer, front)` and settle what it left open; again where the list was too short."""
        while True:
            self._clear(CONTENDER_COUNT)
            decide_samples(layer, front)
            if self.fits():
                break
        if self._state[CONTENDER_COUNT]:
            self.settle(view, visible_prims, nearness, layer, None if front is None else front[1])
            self._read()
        for name, word in COUNTS.items():
            # Only the list's own count starts anew: the others go on, modulo 2^32.
            before = 0 if word == CONTENDER_COUNT else int(self._counted[word])
            self.counts[name] += (int(self._state[word]) - before) & 0xFFFFFFFF
        self._counted[:] = self._state

    def fits(self) -> bool:
        """Whether all contenders were listed; where not, the list has grown and the band is to be decided again.

        Waits. Raises CapacityError where the device gives no longer list in one piece.
        """
        count = int(self._read()[CONTENDER_COUNT])
        if count <= self.capacity:
            return True
        if CONTENDER_BYTES * count > self.device.max_allocation_bytes:
            raise CapacityError(
                f"{count} samples need exact arithmetic, more than {self.device.name} can list in one piece: "
                "render a smaller image"
            )
        self.capacity = count + count // 8
        self.contenders.release()
        self.contenders = buffers.create(self.device, CONTENDER_BYTES * self.capacity)
        return False

    def pairs(self) -> np.ndarray:
        """(contender_count, 2) uint32: pixel of the last band, prim_id. Waits."""
        count = int(self._read()[CONTENDER_COUNT])
        return buffers.download(self.device, self.contenders, np.uint32, (count, 2))

    @property
    def nbytes(self) -> int:
        """Bytes on the device."""
        return CONTENDER_BYTES * self.capacity + 5 * self.geometry.triangle_count + 4 * CONTENDER_WORDS
