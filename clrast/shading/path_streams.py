"""Paths, a generation of all pixels at a time: cl/shade_paths.cl between two traces.

Purcell et al., 'Ray Tracing on Programmable Graphics Hardware', section 3: kernels joined by streams. Where textures
are filtered integrator.py takes its longer way, which carries footprints; both give the same bits.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from clrast.opencl import buffers, kernels
from clrast.opencl.constants import HAS_LIGHT_RAY, LIST_CHUNK
from clrast.opencl.device import Device
from clrast.opencl.features import Features
from clrast.shading.sample_lists import FlagList, Room
from clrast.visibility.ray_arrays import RayBuffers
from clrast.visibility.rays import RayTracer

if TYPE_CHECKING:
    import pyopencl as cl

WORK_GROUP = 16


class PathStreams:
    """Traces paths. `launches` : kernels launched, those of the tracer and the lists apart.

    constants : arguments of shade_paths that are the scene's. casts_shadows : whether rays to lights are traced.
    count : takes the kinds of rays that go on, 0 for none; count_light : how many look for light.
    """

    def __init__(
        self,
        device: Device,
        features: Features,
        tracer: RayTracer,
        lists: FlagList,
        constants: dict[str, Any],
        casts_shadows: bool,
        count: Callable[[np.ndarray], None],
        count_light: Callable[[int], None],
    ) -> None:
        self.device, self.tracer, self.lists, self.constants = device, tracer, lists, constants
        self.casts_shadows, self.count, self.count_light = casts_shadows, count, count_light
        self._program = kernels.build(device, "shade_paths.cl", features)
        self._lanes, self._draws = features.vector_width, features.alpha_blend
        self._room = Room(device)
        self.launches = 0

    def trace(
        self,
        hits: dict[str, cl.Buffer],
        pixel_count: int,
        path: int,
        seed: int,
        generations: int,
        sums: cl.Buffer,
        booked: Callable[[str, Callable[[], Any]], Any],
    ) -> None:
        """Add a path of each pixel to `sums`.

        hits : of the camera's samples, by the arguments of shade_paths. generations : of rays that go on. booked : does
        what it is given, and books its time on a stage.
        """
        items, count = {**hits, "item_pixels": hits["item_prims"]}, pixel_count
        for depth in range(generations + 1):
            numbers = {"item_count": count, "is_first": int(depth == 0)}
            draws = {"path": path, "seed": seed, "depth": depth}
            is_last = depth == generations
            slots = booked("light", lambda: self._light(items, numbers, draws, is_last, pixel_count, sums))  # noqa: B023
            found = booked("go on", lambda: self._go_on(items, numbers, draws, is_last, slots))  # noqa: B023
            if found is None:
                return
            items, count = found

    def _light(
        self, items: dict[str, cl.Buffer], numbers: dict[str, int], draws: dict[str, int], is_last: bool,
        pixel_count: int, sums: cl.Buffer,
    ) -> dict[str, cl.Buffer]:  # fmt: skip
        """Enqueue: add to `sums` what lights bring to items. Returns the slots of rays that go on, and which do."""
        count = numbers["item_count"]
        lit = self._made(count, radiances=16, slot_radiances=16, slot_kinds=1)
        rays = self._made(count, light_origins=16, light_directions=16)
        ends = self._made(count, slot_ends=16, slot_lamps=4)
        keys = self._made(count, light_keys=4) if self._draws else {}
        slots = self._made(count, slot_origins=16, slot_directions=16, slot_throughputs=16, next_kinds=1, excluded=4)
        left = {name: items[name] for name in items if name != "item_pixels"}
        self._launch(
            "shade_paths", -(-count // self._lanes), **numbers, **draws, is_last=int(is_last), **self.constants, **left,
            **lit, **rays, **ends, **keys, **slots,
        )  # fmt: skip
        if self.casts_shadows:
            arguments = {"origins": rays["light_origins"], "directions": rays["light_directions"]}
            arguments["excluded"] = slots["excluded"]
            known = {"ends": ends["slot_ends"], "lamp_slots": ends["slot_lamps"]}
            draw = {"ray_keys": keys["light_keys"], "path": draws["path"]} if keys else {}
            occluded = self.tracer.enqueue_any(RayBuffers(count, arguments, known, draw), self._room)
        else:
            occluded = self._room("occluded", 4 * count)
            buffers.fill(self.device, occluded, np.uint32(0), 4 * count)
        self._launch(
            "add_paths", -(-count // self._lanes), **numbers, pixel_count=pixel_count, item_pixels=items["item_pixels"],
            **lit, occluded=occluded, sums=sums,
        )  # fmt: skip
        begins = {} if is_last else {"begins": self.lists.enqueue_count(slots["next_kinds"], count)}
        return {**slots, **begins, "slot_kinds": lit["slot_kinds"]}

    def _go_on(
        self, items: dict[str, cl.Buffer], numbers: dict[str, int], draws: dict[str, int], is_last: bool,
        slots: dict[str, cl.Buffer],
    ) -> tuple[dict[str, cl.Buffer], int] | None:  # fmt: skip
        """The hits of the rays that go on, enqueued, and how many they are; None where none do. Counts rays, too."""
        count = numbers["item_count"]
        ray_count = 0 if is_last else self.lists.total(slots["begins"], count)
        with (
            buffers.mapped(self.device, slots["slot_kinds"], np.uint8, count) as light_kinds,
            buffers.mapped(self.device, slots["next_kinds"], np.uint8, count) as next_kinds,
        ):
            found = self._trace_on(items, numbers, draws, slots, ray_count) if ray_count else None
            self.device.queue.flush()
            if self.casts_shadows:
                self.count_light(int(np.count_nonzero(light_kinds & HAS_LIGHT_RAY)))
            if ray_count:
                self.count(next_kinds)
        return found

    def _trace_on(
        self, items: dict[str, cl.Buffer], numbers: dict[str, int], draws: dict[str, int], slots: dict[str, cl.Buffer],
        ray_count: int,
    ) -> tuple[dict[str, cl.Buffer], int]:  # fmt: skip
        """As _go_on, of rays that there are."""
        count, depth = numbers["item_count"], draws["depth"]
        sizes = {
            "origins": 16, "directions": 16, "item_throughputs": 16, "excluded": 4, "item_pixels": 4, "item_keys": 4,
        }  # fmt: skip
        if self._draws:
            sizes["ray_keys"] = 4
        # Rays that leave items and those that have arrived there take turns.
        made = {name: self._room(f"{name} {depth % 2}", size * ray_count) for name, size in sizes.items()}
        left = ("begins", "next_kinds", "slot_origins", "slot_directions", "slot_throughputs")
        own = {name: slots[name] for name in left}
        self._launch(
            "gather_rays", -(-count // LIST_CHUNK), **numbers, seed=draws["seed"], depth=depth, **own,
            excluded_left=slots["excluded"], pixels_left=items["item_pixels"], keys_left=items["item_keys"], **made,
        )  # fmt: skip
        arguments = {name: made[name] for name in ("origins", "directions", "excluded")}
        draw = {"ray_keys": made["ray_keys"], "path": draws["path"]} if self._draws else {}
        found = self.tracer.enqueue_closest(RayBuffers(ray_count, arguments, draws=draw), self._room)
        return {
            "item_prims": found["prims_hit"], "item_weights": found["weights"],
            **{name: items[name] for name in ("item_positions", "item_colors") if name in items},
            "item_directions": made["directions"], "item_throughputs": made["item_throughputs"],
            "item_origins": made["origins"], "item_keys": made["item_keys"], "item_pixels": made["item_pixels"],
        }, ray_count  # fmt: skip

    def _made(self, count: int, **sizes: int) -> dict[str, cl.Buffer]:
        """Buffers by the names of arguments, which are kept; sizes : bytes of an item."""
        return {name: self._room(name, size * count) for name, size in sizes.items()}

    def _launch(self, kernel: str, items: int, **arguments: Any) -> None:
        self._program.launch(kernel, -(-items // WORK_GROUP) * WORK_GROUP, WORK_GROUP, **arguments)
        self.launches += 1
