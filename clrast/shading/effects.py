"""What a scene calls for: each effect on or off, with the material, light or option that decides it.

An effect that is off is absent from the compiled kernels (DESIGN section 4). Pure decisions: no device.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from clrast.opencl.constants import MIRROR_ROUGHNESS
from clrast.options import COARSE
from clrast.scene.model import Material, Scene

EFFECT_NAMES = (
    "shadow",
    "reflection",
    "refraction",
    "indirect light",
    "emission",
    "textures",
    "normal interpolation",
    "alpha mask",
    "alpha blend",
    "environment",
    "secondary acceleration structure",
    "derivatives",
)

SECONDARY_EFFECTS = ("shadow", "reflection", "refraction", "indirect light")
"""Effects that trace rays from hits."""

ACCELERATORS = {"bvh": "BVH", "grid": "uniform grid"}
"""What secondary rays walk through, by the names of --accelerator."""

_NO_SECONDARY = "mode cast traces no secondary rays"

Wanted = dict[str, tuple[bool, str]]


@dataclass(frozen=True)
class Effect:
    """One row of the plan. `reason` names what calls for the effect, or why nothing does."""

    name: str
    on: bool
    reason: str


@dataclass(frozen=True)
class EffectPlan:
    """All effects of EFFECT_NAMES, in that order."""

    effects: tuple[Effect, ...]

    def __getitem__(self, name: str) -> bool:
        return next(effect.on for effect in self.effects if effect.name == name)

    def as_stats(self) -> list[dict[str, str | bool]]:
        """The `effects` entry of the stats."""
        return [{"name": e.name, "on": e.on, "reason": e.reason} for e in self.effects]


def used_materials(scene: Scene) -> list[Material]:
    """The materials that at least one triangle has, in their order."""
    counts = np.bincount(scene.material_ids, minlength=len(scene.materials))
    return [material for material, count in zip(scene.materials, counts, strict=False) if count]


def _called_for(
    materials: Iterable[Material], test: Callable[[Material], bool], what: str, why_not: str
) -> tuple[bool, str]:
    names = [material.name for material in materials if test(material)]
    if not names:
        return False, why_not
    more = f" and {len(names) - 1} more" if len(names) > 1 else ""
    return True, f"material '{names[0]}'{more}: {what}"


def _is_textured(material: Material) -> bool:
    return material.base_color_texture is not None or material.emissive_texture is not None


def is_mirror(material: Material) -> bool:
    """Whether a surface is so smooth that it mirrors single rays."""
    return material.roughness <= MIRROR_ROUGHNESS and not material.unlit


def is_glass(material: Material) -> bool:
    return material.transmission > 0 and not material.unlit


def is_specular(material: Material) -> bool:
    """Whether rays go on from a surface outside of paths."""
    return is_mirror(material) or is_glass(material) or material.alpha_mode == "BLEND"


def plan_effects(
    scene: Scene,
    aov: Iterable[str],
    asked: Mapping[str, str] | None = None,
    mode: str = "cast",
    accelerator: str = "bvh",
) -> EffectPlan:
    """The plan of `scene` in a mode for the output groups `aov`.

    asked : effect name -> "on", "off", "auto" or COARSE; all but "auto" overrule what the scene calls for.
    accelerator : of ACCELERATORS, what secondary rays would walk through.
    """
    groups, materials = set(aov), used_materials(scene)
    wanted: Wanted = {}
    wanted.update(_plan_secondary(scene, materials, mode if "color" in groups else None))
    wanted.update(_plan_surfaces(scene, materials, groups))
    if wanted["textures"][0]:
        wanted["derivatives"] = _called_for(
            materials, _filters_textures, "its texture asks for mip maps", "no texture asks for mip maps"
        )
    else:
        wanted["derivatives"] = (False, "no texture is looked up")
    for name, state in (asked or {}).items():
        if state == COARSE and wanted["textures"][0]:
            wanted[name] = (True, "asked for by --effects: coarse, by differences of 2 x 2 pixels")
        elif state == "on" and not wanted[name][0]:
            wanted[name] = (True, "asked for by --effects")
        elif state == "off":
            wanted[name] = (False, "switched off by --effects")
    if "color" not in groups:
        for name in SECONDARY_EFFECTS:
            wanted[name] = (False, "no colour is asked for")
    tracing = [name for name in SECONDARY_EFFECTS if wanted[name][0]]
    reason = f"{ACCELERATORS[accelerator]}, for {' and '.join(tracing)}" if tracing else "no secondary ray is traced"
    wanted["secondary acceleration structure"] = (bool(tracing), reason)
    return EffectPlan(tuple(Effect(name, *wanted[name]) for name in EFFECT_NAMES))


def _plan_secondary(scene: Scene, materials: list[Material], mode: str | None) -> Wanted:
    """The effects that take rays from hits; mode : None where no colour is asked for."""
    names = (*SECONDARY_EFFECTS, "environment")
    if mode is None or mode == "cast":
        why = "no colour is asked for" if mode is None else _NO_SECONDARY
        wanted = {name: (False, why) for name in names}
        if scene.environment is None:
            wanted["environment"] = (False, "the scene has no environment")
        return wanted
    wanted = {name: (False, f"mode {mode} traces shadow rays alone") for name in names}
    lights = [light.name for light in scene.lights if max(light.intensity) > 0]
    emitting = _called_for(materials, _is_emitter, "lights the scene", "no material emits light")
    bright = scene.environment is not None and max(scene.environment) > 0
    more = f" and {len(lights) - 1} more" if len(lights) > 1 else ""
    if lights:
        wanted["shadow"] = (True, f"light '{lights[0]}'{more}")
    elif mode == "path" and emitting[0]:
        wanted["shadow"] = emitting
    else:
        wanted["shadow"] = (False, "the scene has no light that casts shadows: the headlight casts none")
    if mode == "shadow":
        return wanted
    wanted["reflection"] = _called_for(
        materials, lambda m: is_mirror(m) or is_glass(m), "is smooth", "no visible material is a mirror or glass"
    )
    wanted["refraction"] = _called_for(materials, is_glass, "lets light through", "no visible material is glass")
    if mode == "whitted":
        wanted["indirect light"] = (False, "mode whitted follows mirrors and glass alone")
    elif lights or emitting[0] or bright:
        wanted["indirect light"] = (True, "mode path, and the scene has light of its own")
    else:
        wanted["indirect light"] = (False, "the scene has no light, emission or environment: the headlight is direct")
    goes_on = any(wanted[name][0] for name in ("reflection", "refraction", "indirect light"))
    if scene.environment is None:
        wanted["environment"] = (False, "the scene has no environment")
    else:
        why = "seen by secondary rays" if goes_on else "no ray goes on to see it"
        why = why if bright else "the environment is black"
        wanted["environment"] = (bright and goes_on, why)
    return wanted


def _plan_surfaces(scene: Scene, materials: list[Material], groups: set[str]) -> Wanted:
    """The effects of surfaces themselves."""
    wanted: Wanted = {}
    shades = "color" in groups
    wanted["alpha mask"] = _called_for(
        materials, lambda m: m.alpha_mode == "MASK", "alpha mode MASK", "no visible material has alpha mode MASK"
    )
    if shades:
        wanted["alpha blend"] = _called_for(
            materials, lambda m: m.alpha_mode == "BLEND", "alpha mode BLEND", "no visible material has alpha mode BLEND"
        )
        wanted["emission"] = _called_for(
            materials, lambda m: max(m.emissive) > 0, "emits light", "no material emits light"
        )
    else:
        wanted["alpha blend"] = (False, "no colour is asked for")
        wanted["emission"] = (False, "no colour is asked for")
    if shades or "albedo" in groups or wanted["alpha mask"][0]:
        wanted["textures"] = _called_for(materials, _is_textured, "has a texture", "no material has a texture")
    else:
        wanted["textures"] = (False, "no output that is asked for reads a texture")
    if scene.normals is None:
        wanted["normal interpolation"] = (False, "the file has no vertex normals")
    elif shades or "normal" in groups:
        wanted["normal interpolation"] = (True, "the file has vertex normals")
    else:
        wanted["normal interpolation"] = (False, "no output that is asked for reads a normal")
    return wanted


def _filters_textures(material: Material) -> bool:
    uses = (material.base_color_texture, material.emissive_texture)
    return any(use is not None and use.mipmap for use in uses)


def asks_for_mipmaps(scene: Scene) -> bool:
    """Whether a material in use asks for mip maps."""
    return any(_filters_textures(material) for material in used_materials(scene))


def _is_emitter(material: Material) -> bool:
    return max(material.emissive) > 0 and not material.unlit
