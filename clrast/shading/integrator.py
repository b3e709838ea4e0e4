"""Light that takes more than the camera's rays to find: shadows, mirrors, glass, paths.

Purcell et al., 'Ray Tracing on Programmable Graphics Hardware', section 3: kernels joined by streams, weights in place
of recursion. The kernels are cl/light_hits.cl, cl/scatter_rays.cl, cl/trace_rays.cl; paths without footprints take
path_streams.py. Hits of the camera's samples come from any method of the continuum. A generation is: light that reaches
the hits, rays that go on, what they hit.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from clrast.opencl import buffers, kernels
from clrast.opencl.constants import RAY_INDIRECT, RAY_REFLECTED, RAY_REFRACTED
from clrast.opencl.device import Device
from clrast.opencl.features import Features
from clrast.opencl.layout import NO_HIT
from clrast.scene.model import Scene
from clrast.shading.accumulation import Accumulation
from clrast.shading.effects import EffectPlan, is_specular
from clrast.shading.light_sources import find_light_sources
from clrast.shading.path_streams import PathStreams
from clrast.shading.sample_lists import FlagList, Room
from clrast.shading.surfaces import MASK_ARGUMENTS, SurfaceBuffers
from clrast.shading.watch import Watch
from clrast.visibility.bvh import Bvh
from clrast.visibility.ray_grid import GridRequest
from clrast.visibility.rays import build_tracer

if TYPE_CHECKING:
    import pyopencl as cl

WORK_GROUP = 16

LEAST_WEIGHT = 2.0**-10
"""Of a mirrored or refracted ray in its pixel: those that bring less are not traced."""

RAY_EFFECTS = {RAY_REFLECTED: "reflection", RAY_REFRACTED: "refraction", RAY_INDIRECT: "indirect light"}
"""Kind of ray -> effect that it is traced for."""

RAY_KINDS = {RAY_REFLECTED: "rays_reflection", RAY_REFRACTED: "rays_refraction", RAY_INDIRECT: "rays_indirect"}

SURFACES = ("uv", "uv1", "colors", "material_ids", "materials", "textures", "texels", "srgb_to_linear")

BYTES_PER_SLOT = 33
BYTES_PER_RAY = 16 + 16 + 4 + 24 + 8 + 28 + 80
"""Origins, directions, excluded; ends, lamps, keys; sources and places; what is hit; the item that it becomes."""

SLOT_CHANGE_BYTES, ITEM_FOOTPRINT_BYTES = 32, 48
"""Besides, where textures are filtered: how a ray's direction changes from pixel to pixel; what an item covers."""


def no_rays() -> dict[str, int]:
    """Counts of secondary rays where there are none, by the names of the stats."""
    return dict.fromkeys(("rays_shadow", *RAY_KINDS.values()), 0)


@dataclass(frozen=True)
class Items:
    """Hits that rays go on from, as ray_items.clh reads them. `hits` : the buffers by their arguments there."""

    count: int
    is_first: bool
    hits: dict[str, cl.Buffer]
    origins: cl.Buffer
    pixels: cl.Buffer
    keys: cl.Buffer


@dataclass(frozen=True)
class Depths:
    """How far light is followed. generations : of rays that go on; path_count : paths of a sample."""

    generations: int
    path_count: int
    seed: int


class Integrator:
    """Adds to the colour of hits what secondary rays bring; shared by all shaders of a render.

    `counts` : rays by the names of the stats. `launches` : kernels launched. `nbytes` : of the scene, on the device.
    """

    def __init__(
        self,
        device: Device,
        features: Features,
        plan: EffectPlan,
        scene: Scene,
        surfaces: SurfaceBuffers,
        structure: Bvh | GridRequest,
        depths: Depths,
        accumulation: Accumulation | None = None,
    ) -> None:
        self.accumulation = accumulation or Accumulation(Watch())
        self.device, self.features, self.plan, self.depths = device, features, plan, depths
        self.is_path, self._filters = features.indirect, features.derivatives
        self.shows_shadows = plan["shadow"]
        masked = {"alpha_mask": features.alpha_mask, "alpha_blend": features.alpha_blend}
        looked_up = {"textures": features.textures, "vertex_colors": features.vertex_colors}
        looked_up["indirect"] = features.indirect and features.alpha_blend
        masks, reads = None, masked
        if any(masked.values()):
            masks, reads = surfaces.named(*MASK_ARGUMENTS), {**masked, **looked_up}
        self.tracer = build_tracer(device, scene.positions, scene.triangles, structure, masks, **reads)
        geometry = self.tracer.geometry
        self.nbytes = geometry.nbytes + self.tracer.nbytes + 16 * len(scene.triangles)
        self._surfaces = surfaces.named(*SURFACES)
        self._lighting = kernels.build(device, "light_hits.cl", features)
        self._scattering = kernels.build(device, "scatter_rays.cl", features)
        self._lists = FlagList(device, features)
        self._room = Room(device)
        self.own_launches = 0
        self.counts = no_rays()
        self._launches_of: dict[str, int] = {}
        self._ms_of: dict[str, float] = {}
        self._mesh = {"positions": geometry.world_positions, "indices": geometry.indices, **surfaces.named("normals")}
        self._mesh["face_normals"] = self._find_face_normals(len(scene.triangles))
        self._find_lights(device, scene, surfaces)
        special = np.array([is_specular(material) for material in scene.materials], dtype=bool)
        self._special = special[scene.material_ids]
        goes_on = plan["reflection"] or plan["refraction"] or self.is_path
        passes = not self.is_path and (features.refraction or features.alpha_blend)
        self.slot_count = (2 if passes else 1) if goes_on else 0
        self.environment = scene.environment if plan["environment"] and scene.environment else (0.0, 0.0, 0.0)
        self._streams = self._path_streams() if self.is_path and not self._filters else None

    def _path_streams(self) -> PathStreams:
        red, green, blue = self.environment
        constants = {
            **self._mesh, **self._surfaces, **self._lights, "light_count": self._light_count,
            "emitter_count": self._emitter_count, "inverse_power": self._inverse_power,
            "environment_r": red, "environment_g": green, "environment_b": blue,
        }  # fmt: skip
        return PathStreams(
            self.device, self.features, self.tracer, self._lists, constants, self.shows_shadows, self._count_rays,
            self._count_light,
        )  # fmt: skip

    def _count_light(self, count: int) -> None:
        self.counts["rays_shadow"] += count

    def _find_face_normals(self, triangle_count: int) -> cl.Buffer:
        """[triangle_count] float4, unit normals of the triangles, world space."""
        normals = buffers.create(self.device, 16 * triangle_count)
        corners = {name: self._mesh[name] for name in ("positions", "indices")}
        self._launch(self._lighting, "find_face_normals", triangle_count, triangle_count=triangle_count, **corners,
                     face_normals=normals)  # fmt: skip
        return normals

    def _find_lights(self, device: Device, scene: Scene, surfaces: SurfaceBuffers) -> None:
        sources = find_light_sources(scene)
        self._light_count, self._emitter_count = len(scene.lights), len(sources.prims)
        self._inverse_power = sources.inverse_power
        self._lights = {
            **surfaces.named("lights"),
            "emitters": buffers.upload(device, sources.prims),
            "emitter_slots": buffers.upload(device, self.tracer.slots_of(sources.prims)),
            "power_sums": buffers.upload(device, sources.sums),
        }
        # A light at a time; or in paths one that is drawn of all.
        self._rounds = (1 if sources.count else 0) if self.is_path else self._light_count

    @property
    def launches(self) -> int:
        streams = 0 if self._streams is None else self._streams.launches
        return self.own_launches + streams + self.tracer.launches + self._lists.launches

    @staticmethod
    def bytes_per_pixel(filters: bool) -> int:
        """Device bytes that a pixel of a band takes where each has a hit from which two rays go on.

        filters : whether textures are filtered by footprints.
        """
        footprints = (1 + 4) * ITEM_FOOTPRINT_BYTES + 2 * SLOT_CHANGE_BYTES if filters else 0
        return 52 + 16 + 12 + 16 + 20 + 2 * BYTES_PER_SLOT + 4 * BYTES_PER_RAY + footprints

    @staticmethod
    def largest_piece(filters: bool) -> int:
        """Of those bytes what the largest buffer takes."""
        return 2 * max(16, SLOT_CHANGE_BYTES if filters else 0)

    def start_frame(self) -> None:
        self.counts = no_rays()
        self.accumulation.start_frame()
        self._launches_of.clear()
        self._ms_of.clear()

    def effect_costs(self) -> dict[str, dict[str, float]]:
        """What each effect took in the last frame: rays, launches, milliseconds. Kinds of rays that go on from hits
        together share their launches, and their time by their numbers."""
        costs: dict[str, dict[str, float]] = {}
        if self.plan["shadow"]:
            costs["shadow"] = {"rays": self.counts["rays_shadow"], **self._spent("light", 1.0)}
        going = sum(self.counts[name] for name in RAY_KINDS.values())
        for kind, name in RAY_KINDS.items():
            if self.plan[RAY_EFFECTS[kind]]:
                share = self.counts[name] / going if going else 0.0
                costs[RAY_EFFECTS[kind]] = {"rays": self.counts[name], **self._spent("go on", share)}
        return costs

    def _spent(self, stage: str, share: float) -> dict[str, float]:
        return {"launches": self._launches_of.get(stage, 0), "ms": share * self._ms_of.get(stage, 0.0)}

    def _booked(self, stage: str, work: Callable[[], Any]) -> Any:
        """Do `work`, wait for it, and book its launches and time on a stage."""
        before, started = self.launches, time.perf_counter()
        result = work()
        self.device.queue.finish()
        self._launches_of[stage] = self._launches_of.get(stage, 0) + self.launches - before
        self._ms_of[stage] = self._ms_of.get(stage, 0.0) + 1000 * (time.perf_counter() - started)
        return result

    def gather(
        self,
        visible_prims: cl.Buffer,
        hits: dict[str, cl.Buffer],
        pixel_count: int,
        values: cl.Buffer,
        first_plane: int,
    ) -> None:
        """Add to the colour of `pixel_count` samples what secondary rays bring. Waits.

        visible_prims : prim_id or NO_HIT. hits : left by shade_hits. values : planes, colour from `first_plane` on.
        """
        if not pixel_count or not self._has_hits(visible_prims, pixel_count):
            return
        sums = self._room("sums", 12 * pixel_count)
        done, kept = self.accumulation.begin(3 * pixel_count)
        if kept is None:
            buffers.fill(self.device, sums, np.float32(0), 12 * pixel_count)
        else:
            buffers.write(self.device, sums, kept)
        first = Items(
            pixel_count, True,
            {"item_prims": visible_prims, "item_weights": hits["hit_weights"],
             "item_positions": hits["hit_positions"], "item_directions": hits["hit_directions"],
             "item_throughputs": hits["hit_weights"],
             **({"item_colors": hits["hit_colors"]} if self.features.colors_vary else {}),
             **({"item_footprints": hits["hit_footprints"]} if self._filters else {})},
            hits["hit_positions"], visible_prims, hits["sample_keys"],
        )  # fmt: skip
        goes_on = self.slot_count > 0 and (self.is_path or self._shows_special(visible_prims, pixel_count))
        done = self._trace_paths(first, done, self.depths.generations if goes_on else 0, sums, pixel_count)
        self._launch(
            self._scattering, "add_mean", pixel_count, pixel_count=pixel_count,
            path_count=float(done), sums=sums, first_plane=first_plane, values=values,
        )  # fmt: skip
        self.device.queue.finish()

    def _trace_paths(self, first: Items, done: int, generations: int, sums: cl.Buffer, pixel_count: int) -> int:
        """Trace what is wanted of paths beyond the `done` first, one at least of each sample; returns how many are."""
        wanted, watch = self.depths.path_count, self.accumulation.watch
        while done < wanted and not (done and watch.should_stop()):
            self._trace_path(first, done, generations, sums, pixel_count)
            done += 1
            if self.is_path:
                watch.tell(done, wanted, sum(self.counts.values()))
        read = partial(buffers.download, self.device, sums, np.float32, 3 * pixel_count)
        self.accumulation.end(done, read)
        return done

    def _trace_path(self, items: Items, path: int, generations: int, sums: cl.Buffer, pixel_count: int) -> None:
        if self._streams is not None:
            hits = {**items.hits, "item_origins": items.origins, "item_keys": items.keys}
            self._streams.trace(hits, pixel_count, path, self.depths.seed, generations, sums, self._booked)
            return
        for depth in range(generations + 1):
            is_last = depth == generations
            radiances = self._booked("light", partial(self._light, items, path, depth, is_last))
            self._launch(
                self._scattering, "add_to_samples", items.count, item_count=items.count, pixel_count=pixel_count,
                is_first=int(items.is_first), item_pixels=items.pixels, radiances=radiances, sums=sums,
            )  # fmt: skip
            if is_last:
                return
            following = self._booked("go on", partial(self._go_on, items, path, depth))
            if following is None:
                return
            items = following

    def _light(self, items: Items, path: int, depth: int, is_last: bool) -> cl.Buffer:
        """What lights bring to items: [item_count] float4."""
        radiances = self._room("radiances", 16 * items.count)
        numbers = {"item_count": items.count, "is_first": int(items.is_first)}
        common = {**numbers, **items.hits, **self._mesh, **self._surfaces}
        red, green, blue = self.environment
        self._launch_lanes(
            self._lighting, "begin_light", items.count, **common, inverse_power=self._inverse_power,
            environment_r=red, environment_g=green, environment_b=blue, item_origins=items.origins,
            radiances=radiances,
        )  # fmt: skip
        sizes = {"slot_ends": 16, "slot_lamps": 4}
        ends = {name: self._room(name, size * items.count) for name, size in sizes.items()}
        brought = {"slot_radiances": self._room("slot_radiances", 16 * items.count)}
        kinds = self._room("slot_kinds", items.count)
        for light in range(self._rounds):
            self._launch_lanes(
                self._lighting, "aim_at_light", items.count, **common, light=light, light_count=self._light_count,
                emitter_count=self._emitter_count, path=path, depth=depth, is_last=int(is_last),
                inverse_power=self._inverse_power, item_keys=items.keys, seed=self.depths.seed, **self._lights,
                **ends, **brought, slot_kinds=kinds,
            )  # fmt: skip
            self._launch(
                self._lighting, "add_light", items.count, item_count=items.count, slot_kinds=kinds,
                occluded=self._occluded(items, path, depth, kinds, ends), **brought, radiances=radiances,
            )  # fmt: skip
        return radiances

    def _occluded(self, items: Items, path: int, depth: int, kinds: cl.Buffer, ends: dict[str, cl.Buffer]) -> cl.Buffer:
        if not self.shows_shadows:
            free = self._room("occluded", 4 * items.count)
            buffers.fill(self.device, free, np.uint32(0), 4 * items.count)
            return free
        streams = self._streams_left(items, depth)
        occluded = self.tracer.enqueue_any(self.tracer.enqueue_leave_for_light(items.count, path, **ends, **streams))
        with buffers.mapped(self.device, kinds, np.bool_, items.count) as flags:
            self.counts["rays_shadow"] += int(np.count_nonzero(flags))
        return occluded

    def _streams_left(self, items: Items, depth: int) -> dict[str, Any]:
        """What leave_hits.cl takes of the items that rays leave."""
        hits = {name: items.hits[name] for name in ("item_prims", "item_weights", "item_positions")}
        numbers = {"is_first": int(items.is_first), "seed": self.depths.seed, "depth": depth}
        return {**hits, "item_keys": items.keys, **numbers}

    def _go_on(self, items: Items, path: int, depth: int) -> Items | None:
        """The hits of the rays that go on from items; None where none do. Waits."""
        slots = self.slot_count * items.count
        directions, throughputs = self._room("slot_directions", 16 * slots), self._room("slot_throughputs", 16 * slots)
        kinds = self._room("slot_kinds", slots)
        changes = {"slot_changes": self._room("slot_changes", SLOT_CHANGE_BYTES * slots)} if self._filters else {}
        self._launch_lanes(
            self._scattering, "scatter_rays", items.count, item_count=items.count, is_first=int(items.is_first),
            slot_count=self.slot_count, path=path, depth=depth, least_weight=LEAST_WEIGHT, **items.hits,
            item_keys=items.keys, seed=self.depths.seed, **self._mesh, **self._surfaces, slot_directions=directions,
            slot_throughputs=throughputs, slot_kinds=kinds, **changes,
        )  # fmt: skip
        sources, count = self._lists.list(kinds, slots, "sources")
        if not count:
            return None
        with buffers.mapped(self.device, kinds, np.uint8, slots) as flags:
            self._count_rays(flags)
        rays = self.tracer.enqueue_leave(
            count, path, slot_count=self.slot_count, sources=sources, slot_directions=directions,
            **self._streams_left(items, depth),
        )  # fmt: skip
        found = self.tracer.enqueue_closest(rays)
        return self._arrive(items, sources, count, rays.arguments, found, {"slot_throughputs": throughputs, **changes})

    def _arrive(
        self, items: Items, sources: cl.Buffer, count: int, rays: dict[str, cl.Buffer], found: dict[str, cl.Buffer],
        slots: dict[str, cl.Buffer],
    ) -> Items:  # fmt: skip
        make = buffers.create
        vectors = ("item_positions", "item_directions", "item_throughputs")
        made = {name: make(self.device, 16 * count) for name in vectors}
        left = {}
        if self._filters:
            made["item_footprints"] = make(self.device, ITEM_FOOTPRINT_BYTES * count)
            left = {"prims_left": items.hits["item_prims"], "footprints_left": items.hits["item_footprints"],
                    "origins": rays["origins"]}  # fmt: skip
        numbers = {name: make(self.device, 4 * count) for name in ("item_pixels", "item_keys")}
        self._launch(
            self._scattering, "arrive", count, ray_count=count, slot_count=self.slot_count,
            is_first=int(items.is_first), sources=sources, prims_hit=found["prims_hit"], weights=found["weights"],
            directions=rays["directions"], pixels_left=items.pixels, keys_left=items.keys,
            positions=self._mesh["positions"], indices=self._mesh["indices"], **slots, **left, **made, **numbers,
        )  # fmt: skip
        unused = {name: items.hits[name] for name in ("item_colors",) if name in items.hits}
        hits = {"item_prims": found["prims_hit"], "item_weights": found["weights"], **made, **unused}
        return Items(count, False, hits, rays["origins"], numbers["item_pixels"], numbers["item_keys"])

    def _count_rays(self, kinds: np.ndarray) -> None:
        for kind, name in RAY_KINDS.items():
            self.counts[name] += int(np.count_nonzero(kinds == kind))

    def _has_hits(self, visible_prims: cl.Buffer, count: int) -> bool:
        with buffers.mapped(self.device, visible_prims, np.uint32, count) as prims:
            return bool((prims != NO_HIT).any())

    def _shows_special(self, visible_prims: cl.Buffer, count: int) -> bool:
        """Whether a hit is on a surface that mirrors or refracts: else no ray goes on, and no kernel for it runs."""
        with buffers.mapped(self.device, visible_prims, np.uint32, count) as prims:
            return bool(self._special[prims[prims != NO_HIT]].any())

    def _launch_lanes(self, program: Any, kernel: str, items: int, **arguments: Any) -> None:
        """Launch a kernel whose work-items take as many items as a vector has lanes."""
        self._launch(program, kernel, -(-items // self.features.vector_width), **arguments)

    def _launch(self, program: Any, kernel: str, items: int, **arguments: Any) -> None:
        program.launch(kernel, -(-items // WORK_GROUP) * WORK_GROUP, WORK_GROUP, **arguments)
        self.own_launches += 1
