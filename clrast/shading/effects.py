"""What a scene calls for: each effect on or off, with the material, light or option that decides it.

An effect that is off is absent from the compiled kernels (DESIGN section 4). Pure decisions: no device.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

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

_NO_SECONDARY = "mode cast traces no secondary rays"


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


def plan_effects(scene: Scene, aov: Iterable[str], asked: Mapping[str, str] | None = None) -> EffectPlan:
    """The plan of `scene` in mode `cast` for the output groups `aov`.

    asked : effect name -> "on", "off" or "auto"; "on" and "off" overrule what the scene calls for.
    """
    groups = set(aov)
    materials = used_materials(scene)
    shades = "color" in groups
    wanted: dict[str, tuple[bool, str]] = {name: (False, _NO_SECONDARY) for name in EFFECT_NAMES}
    wanted["environment"] = (False, "the scene has no environment")
    wanted["derivatives"] = (False, "textures are looked up at full size without filter footprints")
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
    for name, state in (asked or {}).items():
        if state == "on" and not wanted[name][0]:
            wanted[name] = (True, "asked for by --effects")
        elif state == "off":
            wanted[name] = (False, "switched off by --effects")
    return EffectPlan(tuple(Effect(name, *wanted[name]) for name in EFFECT_NAMES))
