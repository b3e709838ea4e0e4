"""Lights that paths draw from by their power: punctual ones, and emissive triangles."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from clrast.scene.model import Light, Scene


@dataclass(frozen=True)
class LightSources:
    """prims : (emitter_count,) uint32 of emissive triangles with an area. sums : (light_count + emitter_count + 1,)
    float32, running shares of power from 0 to 1. inverse_power : of an emissive triangle's R + G + B times its area in
    square world units gives its share.
    """

    prims: np.ndarray
    sums: np.ndarray
    inverse_power: float

    @property
    def count(self) -> int:
        return len(self.sums) - 1


def _power(light: Light, radius: float) -> float:
    """What a punctual light gives, in the unit of an emissive triangle's R + G + B times its area: watts over pi."""
    strength = math.fsum(light.intensity)
    if light.kind == "directional":
        return strength * radius * radius
    if light.kind == "spot":
        return strength * 2 * (1 - math.cos(light.outer_cone))
    return strength * 4


def find_light_sources(scene: Scene) -> LightSources:
    """All lights of a scene in the order of the file, the punctual ones first; those without power get no share."""
    low, high = scene.bounding_box()
    radius = 0.5 * math.sqrt(math.fsum(float(c) ** 2 for c in high - low))
    punctual = np.array([_power(light, radius) for light in scene.lights], dtype=np.float64)
    emitted = [0.0 if material.unlit else math.fsum(material.emissive) for material in scene.materials]
    strengths = np.array(emitted, dtype=np.float64)
    strength = strengths[scene.material_ids]
    prims = np.flatnonzero(strength > 0)
    corners = scene.positions[scene.triangles[prims]].astype(np.float64)
    e, f = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    x = e[:, 1] * f[:, 2] - e[:, 2] * f[:, 1]
    y = e[:, 2] * f[:, 0] - e[:, 0] * f[:, 2]
    z = e[:, 0] * f[:, 1] - e[:, 1] * f[:, 0]
    powers = strength[prims] * 0.5 * np.sqrt(x * x + y * y + z * z)
    prims, powers = prims[powers > 0], powers[powers > 0]
    # One running sum, so that shares add up to 1; numpy's accumulate goes from left to right.
    running = np.add.accumulate(np.concatenate(([0.0], punctual, powers)))
    total = float(running[-1])
    if not total > 0 or not math.isfinite(total):
        return LightSources(np.zeros(0, np.uint32), np.zeros(1, np.float32), 0.0)
    return LightSources(prims.astype(np.uint32), (running / total).astype(np.float32), float(np.float32(1 / total)))
