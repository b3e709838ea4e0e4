"""What shading reads of a scene, packed for the device: materials, textures, lights, vertex attributes."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from clrast.errors import CapacityError
from clrast.opencl import buffers, kernels, layout
from clrast.opencl.device import Device
from clrast.scene.model import Light, Material, Scene, TextureUse
from clrast.shading.effects import EffectPlan, asks_for_mipmaps

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
LOOKUP_MIPMAP = 64
WORK_GROUP = 64
MAX_UV = 1.0e6
"""Texture coordinates are limited to this magnitude: beyond it float32 has no texels left to tell apart."""


def srgb_table() -> np.ndarray:
    """(512,) float32: linear value of each sRGB byte (IEC 61966-2-1), computed in float64, rounded once; then of each
    byte as a fraction of 255."""
    values = [c / 255 for c in range(256)]
    linear = [c / 12.92 if c <= 0.04045 else math.pow((c + 0.055) / 1.055, 2.4) for c in values]
    fractions = np.arange(256, dtype=np.float32) * np.float32(1.0 / 255.0)
    return np.concatenate([np.array(linear, dtype=np.float64).astype(np.float32), fractions])


def _lookup_bits(use: TextureUse, filters_all: bool) -> int:
    bits = WRAPS[use.wrap_u] | WRAPS[use.wrap_v] << 2
    bits |= LOOKUP_MIPMAP if use.mipmap or filters_all else 0
    return bits | (LOOKUP_NEAREST if use.nearest else 0) | (LOOKUP_SECOND_UV if use.uv_set else 0)


def pack_materials(materials: tuple[Material, ...], filters_all: bool = False) -> np.ndarray:
    """One layout.MATERIAL record each. filters_all : mip maps for all textures, whatever the file asks for."""
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
                record[f"{prefix}_lookup"] = _lookup_bits(use, filters_all)
                record[f"{prefix}_u"][:3], record[f"{prefix}_v"][:3] = use.transform[:3], use.transform[3:]
        record["flags"] = (
            (layout.MATERIAL_MASK if material.alpha_mode == "MASK" else 0)
            | (layout.MATERIAL_BLEND if material.alpha_mode == "BLEND" else 0)
            | (layout.MATERIAL_UNLIT if material.unlit else 0)
            | (layout.MATERIAL_SHINES if material.unlit or max(material.emissive) > 0 else 0)
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


def srgb_midpoints() -> np.ndarray:
    """(255,) float32: linear values half way, in sRGB, between neighbouring bytes."""
    values = [(c + 0.5) / 255 for c in range(255)]
    linear = [c / 12.92 if c <= 0.04045 else math.pow((c + 0.055) / 1.055, 2.4) for c in values]
    return np.array(linear, dtype=np.float64).astype(np.float32)


def level_sizes(width: int, height: int, mipmaps: bool) -> list[tuple[int, int]]:
    """(width, height) of a texture and of its mip maps, down to a single texel."""
    sizes = [(width, height)]
    while mipmaps and sizes[-1] != (1, 1):
        sizes.append((max(1, sizes[-1][0] // 2), max(1, sizes[-1][1] // 2)))
    return sizes


def _pack_textures(scene: Scene, wanted: bool, mipmaps: bool) -> tuple[np.ndarray, np.ndarray]:
    """Records and texels (N, 4) uint8 of all textures, one after the other, with room for mip maps after each."""
    textures = scene.textures if wanted else ()
    records = np.zeros(max(1, len(textures)), dtype=layout.TEXTURE)
    sizes = [level_sizes(texture.texels.shape[1], texture.texels.shape[0], mipmaps) for texture in textures]
    total = sum(width * height for levels in sizes for width, height in levels)
    if total >= 1 << 32:
        raise CapacityError(f"the textures have {total} texels: at most {(1 << 32) - 1} fit; use smaller images")
    texels = np.zeros((max(1, total), 4), dtype=np.uint8)
    first = 0
    for record, texture, levels in zip(records, textures, sizes, strict=False):
        height, width = texture.texels.shape[:2]
        record["first_texel"], record["width"], record["height"] = first, width, height
        record["srgb"], record["level_count"] = int(texture.srgb), len(levels)
        texels[first : first + width * height] = texture.texels.reshape(-1, 4)
        first += sum(across * down for across, down in levels)
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
        self._filters = plan["derivatives"]
        # Asked for, not called for: then for all textures.
        filters_all = self._filters and not asks_for_mipmaps(scene)
        records, texels = _pack_textures(scene, textured, self._filters)
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
            "materials": pack_materials(scene.materials, filters_all),
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
        if self._filters and textured:
            self._build_mips(device, records)

    def _build_mips(self, device: Device, records: np.ndarray) -> None:
        program = kernels.build(device, "build_mips.cl")
        midpoints = self._upload(srgb_midpoints())
        for record in records:
            first = int(record["first_texel"])
            sizes = level_sizes(int(record["width"]), int(record["height"]), int(record["level_count"]) > 1)
            for (width, height), (across, down) in itertools.pairwise(sizes):
                target = first + width * height
                program.launch(
                    "build_level", -(-across * down // WORK_GROUP) * WORK_GROUP, WORK_GROUP, source=first,
                    source_width=width, source_height=height, target=target, width=across, height=down,
                    srgb=int(record["srgb"]), midpoints=midpoints, **self.named("srgb_to_linear", "texels"),
                )  # fmt: skip
                first = target
        device.queue.finish()

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
