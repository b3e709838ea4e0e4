"""What a render will do and why: the plan of effects with what each is expected to take.

Expected rays and times come from a probe, a small image of the same view, whose rays and times are scaled by the
number of samples: an effect's rays are counted there; the time of what traces none is that of the probe less the time
without the effect.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from clrast.options import RenderOptions
from clrast.renderer import render
from clrast.scene.model import Camera, Scene
from clrast.shading.effects import SECONDARY_EFFECTS, EffectPlan, plan_effects
from clrast.shading.integrator import Integrator
from clrast.visibility.sample_patterns import parse_antialiasing

PROBE_PIXELS = 1 << 14
PROBE_PATHS = 4
PROBE_FRAMES = 3

KERNELS = {
    "shadow": ("aim_at_light", "leave_for_light", "trace_any", "add_light"),
    "reflection": ("scatter_rays", "leave_hits", "trace_closest", "arrive"),
    "refraction": ("scatter_rays", "leave_hits", "trace_closest", "arrive"),
    "indirect light": ("scatter_rays", "leave_hits", "trace_closest", "arrive"),
    "emission": ("shade_hits",),
    "textures": ("shade_hits",),
    "normal interpolation": ("shade_hits",),
    "alpha mask": ("rasterize_tiles",),
    "alpha blend": ("rasterize_tiles", "shade_hits", "close_pixels"),
    "environment": ("begin_light",),
}
"""Effect -> kernels that are launched for it, or that it adds to."""

STREAM_KERNELS = {
    "shadow": ("shade_paths", "trace_any", "add_paths"),
    "indirect light": ("shade_paths", "gather_rays", "trace_closest"),
    "environment": ("shade_paths",),
}
"""Those of paths whose textures are not filtered, which replace them: shading/path_streams.py."""

MARGINAL = ("emission", "textures", "normal interpolation", "alpha mask", "alpha blend")
"""Effects that trace no rays: what they take is the difference to a probe without them."""

RAYS = {
    "shadow": "rays_shadow", "reflection": "rays_reflection", "refraction": "rays_refraction",
    "indirect light": "rays_indirect",
}  # fmt: skip


STRUCTURE_BYTES = {"bvh": 57, "grid": 150}
"""A triangle's, with what it takes in blocks: of a sphere, the bunny and Sponza 57 to 59, and 125, 140 and 184."""


@dataclass(frozen=True)
class Row:
    """One effect. rays, ms : expected; None where nothing was probed. nbytes : on the device."""

    name: str
    on: bool
    reason: str
    kernels: tuple[str, ...]
    nbytes: int
    rays: int | None
    ms: float | None


@dataclass(frozen=True)
class Explanation:
    """rows : all effects in their order. frame_ms : expected, from setup to resolve; None where nothing was probed."""

    rows: tuple[Row, ...]
    probe_size: tuple[int, int] | None
    frame_ms: float | None

    def as_dict(self) -> dict[str, Any]:
        return {
            "effects": [
                {"name": r.name, "on": r.on, "reason": r.reason, "rays_expected": r.rays, "kernels": list(r.kernels),
                 "bytes": r.nbytes, "ms_expected": r.ms}
                for r in self.rows
            ],
            "probe": None if self.probe_size is None else list(self.probe_size),
            "frame_ms_expected": self.frame_ms,
        }  # fmt: skip


def explain(scene: Scene, camera: Camera, options: RenderOptions, probes: bool = True) -> Explanation:
    """The plan of a render. probes : whether to render small images for what effects will take."""
    plan = plan_effects(scene, options.aov, options.effects, options.mode, options.ray_accelerator)
    bytes_of = effect_bytes(scene, plan, options)
    if not probes:
        return Explanation(tuple(_row(plan, name, bytes_of, None, None) for name in bytes_of), None, None)
    size = probe_size(options.size)
    small = replace(options, size=size, aa="none", repeat=PROBE_FRAMES, aov=_probed_groups(options),
                    samples=min(options.path_count, PROBE_PATHS), effects={**options.effects})  # fmt: skip
    stats = render(scene, camera, options=small).stats
    scale = sample_count(options) / (size[0] * size[1])
    paths = options.path_count / small.path_count if plan["indirect light"] else 1.0
    base_ms = frame_ms(stats)
    rows = []
    for name in bytes_of:
        rays = ms = None
        if name in RAYS:
            rays = round(stats["counts"][RAYS[name]] * scale * paths) if plan[name] else 0
            ms = stats["effect_costs"].get(name, {"ms": 0.0})["ms"] * scale * paths
        elif name in MARGINAL and plan[name]:
            without = replace(small, effects={**options.effects, name: "off"})
            ms = max(0.0, base_ms - frame_ms(render(scene, camera, options=without).stats)) * scale
        elif not plan[name]:
            rays, ms = 0, 0.0
        rows.append(_row(plan, name, bytes_of, rays, ms))
    secondary = sum(row.ms or 0.0 for row in rows if row.name in RAYS)
    primary = max(0.0, base_ms - sum(cost["ms"] for cost in stats["effect_costs"].values())) * scale
    return Explanation(tuple(rows), size, primary + secondary)


def _row(plan: EffectPlan, name: str, bytes_of: dict[str, int], rays: int | None, ms: float | None) -> Row:
    effect = next(each for each in plan.effects if each.name == name)
    filters = plan["derivatives"] and plan["textures"]
    launched = {**KERNELS, **STREAM_KERNELS} if plan["indirect light"] and not filters else KERNELS
    kernels = launched.get(name, ()) if effect.on else ()
    return Row(name, effect.on, effect.reason, kernels, bytes_of[name] if effect.on else 0, rays, ms)


def _probed_groups(options: RenderOptions) -> tuple[str, ...]:
    return tuple(group for group in options.aov if group != "cost") or ("depth",)


def probe_size(size: tuple[int, int]) -> tuple[int, int]:
    """A size of that shape with at most PROBE_PIXELS pixels."""
    factor = min(1.0, math.sqrt(PROBE_PIXELS / (size[0] * size[1])))
    return max(1, round(size[0] * factor)), max(1, round(size[1] * factor))


def sample_count(options: RenderOptions) -> int:
    """Samples that are shaded at most, those of edges alone not told apart: one a pixel where their number is open."""
    wanted = parse_antialiasing("--aa", options.aa)
    each = len(wanted.pattern) if wanted.kind == "ssaa" else 1
    return options.size[0] * options.size[1] * each


def frame_ms(stats: dict[str, Any]) -> float:
    """Setup to resolve."""
    return sum(stats["times_ms"][stage] for stage in ("setup", "bin", "visibility", "shade", "resolve"))


def effect_bytes(scene: Scene, plan: EffectPlan, options: RenderOptions) -> dict[str, int]:
    """Device bytes that each effect adds, of the whole image in one band; all effects in their order."""
    pixels = options.size[0] * options.size[1]
    rays_at_once = [name for name in SECONDARY_EFFECTS if plan[name]]
    streams = pixels * Integrator.bytes_per_pixel(plan["derivatives"]) // len(rays_at_once) if rays_at_once else 0
    found = {effect.name: 0 for effect in plan.effects}
    found.update(dict.fromkeys(rays_at_once, streams))
    # Corners, indices and ids of triangles, unscaled vertices, and the structure with its blocks of triangles.
    of_triangle = 48 + 12 + 4 + STRUCTURE_BYTES[options.ray_accelerator]
    found["secondary acceleration structure"] = scene.triangle_count * of_triangle + 16 * scene.vertex_count
    found["textures"] = 4 * sum(texture.texels.shape[0] * texture.texels.shape[1] for texture in scene.textures)
    found["normal interpolation"] = 16 * scene.vertex_count
    found["alpha mask"] = 12 * scene.triangle_count
    found["alpha blend"] = 12 * pixels
    return found
