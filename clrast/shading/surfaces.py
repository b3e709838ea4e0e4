"""What shading reads of a scene, packed for the device: materials, textures, lights, vertex attributes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from clrast.errors import CapacityError
from clrast.opencl import buffers, layout
from clrast.opencl.device import Device
from clrast.scene.model import Light, Material, Scene, TextureUse
from clrast.shading.effects import EffectPlan

if TYPE_CHECKING:
    import pyopencl as cl

WRAPS = {"repeat": layout.WRAP_REPEAT, "mirror": layout.WRAP_MIRROR, "clamp": layout.WRAP_CLAMP}
LIGHT_KINDS = {
    "point": layout.LIGHT_POINT,
    "spot": layout.LIGHT_SPOT,
    "directional": layout.LIGHT_DIRECTIONAL,
}
LOOKUP_NEAREST = 16
LOOKUP_SECOND_UV = 32
MAX_UV = 1.0e6
"""Texture coordinates are limited to this magnitude: beyond it float32 has no texels left to tell apart."""


def srgb_table() -> np.ndarray:
    """(256,) float32: linear value of each sRGB byte (IEC 61966-2-1), computed in float64, rounded once."""
    values = [c / 255 for c in range(256)]
    linear = [c / 12.92 if c <= 0.04045 else math.pow((c + 0.055) / 1.055, 2.4) for c in values]
    return np.array(linear, dtype=np.float64).astype(np.float32)


def _lookup_bits(use: TextureUse) -> int:
    bits = WRAPS[use.wrap_u] | WRAPS[use.wrap_v] << 2
    return bits | (LOOKUP_NEAREST if use.nearest else 0) | (LOOKUP_SECOND_UV if use.uv_set else 0)


def pack_materials(materials: tuple[Material, ...]) -> np.ndarray:
    """One layout.MATERIAL record each."""
    packed = np.zeros(max(1, len(materials)), dtype=layout.MATERIAL)
    for record, material in zip(packed, materials, strict=False):
        record["base_color"] = material.base_color
        record["emissive"][:3] = material.emissive
        record["metallic"], record["roughness"] = material.metallic, material.roughness
        record["alpha_cutoff"], record["ior"] = material.alpha_cutoff, material.ior
        record["transmission"] = material.transmission
        # KHR_materials_ior: 0 stands for a surface that reflects all light.
        record["reflectance"] = ((material.ior - 1) / (material.ior + 1)) ** 2
        for prefix, use in (("base", material.base_color_texture), ("emissive", material.emissive_texture)):
            record[f"{prefix}_texture"] = layout.NO_TEXTURE if use is None else use.texture
            if use is not None:
                record[f"{prefix}_lookup"] = _lookup_bits(use)
                record[f"{prefix}_u"][:3], record[f"{prefix}_v"][:3] = use.transform[:3], use.transform[3:]
        record["flags"] = (
            (layout.MATERIAL_MASK if material.alpha_mode == "MASK" else 0)
            | (layout.MATERIAL_BLEND if material.alpha_mode == "BLEND" else 0)
            | (layout.MATERIAL_UNLIT if material.unlit else 0)
        )
    return packed


def pack_lights(lights: tuple[Light, ...]) -> np.ndarray:
    """One layout.LIGHT record each, at least one (all zero)."""
    packed = np.zeros(max(1, len(lights)), dtype=layout.LIGHT)
    for record, light in zip(packed, lights, strict=False):
        record["position"][:3] = light.position
        record["direction"][:3] = light.direction
        record["intensity"][:3] = light.intensity
        record["cos_inner"], record["cos_outer"] = math.cos(light.inner_cone), math.cos(light.outer_cone)
        record["range"] = light.range
        record["kind"] = LIGHT_KINDS[light.kind]
    return packed


def _pack_textures(scene: Scene, wanted: bool) -> tuple[np.ndarray, np.ndarray]:
    """Records and texels (N, 4) uint8 of all textures, one after the other."""
    textures = scene.textures if wanted else ()
    records = np.zeros(max(1, len(textures)), dtype=layout.TEXTURE)
    total = sum(texture.texels.shape[0] * texture.texels.shape[1] for texture in textures)
    if total >= 1 << 32:
        raise CapacityError(f"the textures have {total} texels: at most {(1 << 32) - 1} fit; use smaller images")
    texels = np.zeros((max(1, total), 4), dtype=np.uint8)
    first = 0
    for record, texture in zip(records, textures, strict=False):
        height, width = texture.texels.shape[:2]
        record["first_texel"], record["width"], record["height"] = first, width, height
        record["srgb"] = int(texture.srgb)
        texels[first : first + width * height] = texture.texels.reshape(-1, 4)
        first += width * height
    return records, texels


def _pad4(values: np.ndarray) -> np.ndarray:
    """(n, 3) as (n, 4) float32 with w = 0."""
    packed = np.zeros((len(values), 4), dtype=np.float32)
    packed[:, : values.shape[1]] = values
    return packed


def _clean_uv(uv: np.ndarray) -> np.ndarray:
    cleaned = np.nan_to_num(uv.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
    return np.clip(cleaned, np.float32(-MAX_UV), np.float32(MAX_UV))


class SurfaceBuffers:
    """Device buffers by the argument names of shade_hits; only what the plan reads takes memory.

    `nbytes` : bytes uploaded.
    """

    def __init__(self, device: Device, scene: Scene, plan: EffectPlan, reads_uv: bool) -> None:
        self.nbytes = 0
        self._device = device
        nothing2, nothing4 = np.zeros((1, 2), np.float32), np.zeros((1, 4), np.float32)
        textured = plan["textures"]
        records, texels = _pack_textures(scene, textured)
        uv = scene.uv if scene.uv is not None and (textured or reads_uv) else None
        if uv is None and (textured or reads_uv):
            uv = np.zeros((scene.vertex_count, 2), np.float32)
        uv1 = scene.uv1 if textured else None
        if textured and uv1 is None and any(_uses_second_uv(material) for material in scene.materials):
            uv1 = uv
        normals = scene.normals if plan["normal interpolation"] else None
        if plan["normal interpolation"] and normals is None:  # asked for all the same: 0 stands for none
            normals = np.zeros((scene.vertex_count, 3), np.float32)
        arrays: dict[str, np.ndarray] = {
            "material_ids": scene.material_ids,
            "object_ids": scene.object_ids,
            "materials": pack_materials(scene.materials),
            "textures": records,
            "texels": texels,
            "srgb_to_linear": srgb_table(),
            "lights": pack_lights(scene.lights),
            "uv": nothing2 if uv is None else _clean_uv(uv),
            "uv1": nothing2 if uv1 is None else _clean_uv(uv1),
            "colors": nothing4 if scene.colors is None else _pad4(scene.colors),
            "normals": nothing4 if normals is None else _pad4(normals),
        }
        self.buffers: dict[str, cl.Buffer] = {name: self._upload(array) for name, array in arrays.items()}

    def _upload(self, array: np.ndarray) -> Any:
        self.nbytes += array.nbytes
        return buffers.upload(self._device, array)

    def named(self, *names: str) -> dict[str, Any]:
        """The buffers of these argument names."""
        return {name: self.buffers[name] for name in names}


MASK_ARGUMENTS = ("material_ids", "materials", "textures", "texels", "srgb_to_linear", "uv", "uv1", "colors")
"""What rasterize_tiles reads where the effect 'alpha mask' is on."""


def _uses_second_uv(material: Material) -> bool:
    return any(use is not None and use.uv_set for use in (material.base_color_texture, material.emissive_texture))
