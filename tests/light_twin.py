"""Light on a surface in float64, from the formulas of glTF 2.0's appendix B and KHR_lights_punctual.

    radiance = sum over lights (f_diffuse + f_specular) E max(N . L, 0)
    f_diffuse = (1 - F) c_diff / pi;   f_specular = F D G / (4 N.L N.V)
    D = alpha^2 / (pi ((N.H)^2 (alpha^2 - 1) + 1)^2),  alpha = roughness^2
    G = 1 / (1 + Lambda(N.L) + Lambda(N.V)),  Lambda(c) = (sqrt(1 + alpha^2 tan^2) - 1) / 2
    F = f0 + (1 - f0) (1 - V.H)^5,  f0 = mix(0.04, base, metallic),  c_diff = base (1 - metallic)

G is the height-correlated form (Heitz 2014), which the appendix names as the more accurate one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from clrast.scene.model import Light, Material


def unit(v: Sequence[float] | np.ndarray) -> np.ndarray:
    """`v` divided by its length."""
    v = np.asarray(v, dtype=np.float64)
    return v / math.sqrt(float((v * v).sum()))


def masking(cosine: Any, alpha: float) -> Any:
    """Lambda of Smith's model for GGX, of a number or an array."""
    tangent2 = (1 - cosine * cosine) / (cosine * cosine)
    return (np.sqrt(1 + alpha * alpha * tangent2) - 1) / 2


def distribution_of_normals(n_h: Any, alpha: float) -> Any:
    """D of GGX, of a number or an array."""
    return alpha**2 / (math.pi * (n_h * n_h * (alpha**2 - 1) + 1) ** 2)


def brdf(material: Material, n: np.ndarray, v: np.ndarray, to_light: np.ndarray) -> np.ndarray:
    """f_diffuse + f_specular, (..., 3) RGB; n, v, to_light (..., 3) unit and on one side."""
    base = np.array(material.base_color[:3])
    alpha = material.roughness**2
    h = v + to_light
    h = h / np.sqrt((h * h).sum(axis=-1, keepdims=True))
    n_l, n_v, n_h, v_h = ((a * b).sum(axis=-1)[..., None] for a, b in ((n, to_light), (n, v), (n, h), (v, h)))
    shadowing = 1 / (1 + masking(n_l, alpha) + masking(n_v, alpha))
    f0 = 0.04 * (1 - material.metallic) + base * material.metallic
    fresnel = f0 + (1 - f0) * (1 - v_h) ** 5
    diffuse = (1 - fresnel) * base * (1 - material.metallic) / math.pi
    return diffuse + fresnel * distribution_of_normals(n_h, alpha) * shadowing / (4 * n_l * n_v)


def irradiance(light: Light, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(RGB per unit of cosine, unit direction to the light) at a point."""
    intensity = np.array(light.intensity)
    if light.kind == "directional":
        return intensity, -unit(light.direction)
    way = np.array(light.position) - point
    distance = math.sqrt(float((way * way).sum()))
    attenuation = 1 / distance**2
    if light.range > 0:
        attenuation *= max(min(1 - (distance / light.range) ** 4, 1), 0)
    if light.kind == "spot":
        scale = 1 / max(0.001, math.cos(light.inner_cone) - math.cos(light.outer_cone))
        offset = -math.cos(light.outer_cone) * scale
        angular = min(max(float(unit(light.direction) @ -unit(way)) * scale + offset, 0), 1)
        attenuation *= angular * angular
    return intensity * attenuation, unit(way)


def radiance(
    material: Material,
    lights: Sequence[Light],
    point: np.ndarray,
    n: np.ndarray,
    v: np.ndarray,
    facing: np.ndarray | None = None,
) -> np.ndarray:
    """RGB towards v. n : shading normal; facing : geometric normal (default n); both on the viewer's side."""
    total = np.zeros(3)
    for light in lights:
        arriving, to_light = irradiance(light, point)
        if float(n @ to_light) > 0 and float((n if facing is None else facing) @ to_light) > 0:
            total += arriving * brdf(material, n, v, to_light) * float(n @ to_light)
    return total
