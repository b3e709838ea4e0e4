"""Materials, textures and samplers of a glTF file, as records of clrast.scene.model.

Only the images that some material here looks up are decoded. A texture that cannot be had leaves
its factor alone, with a warning. glTF 2.0 specification, sections 3.8 and 3.9, and the KHR
extensions named below.
"""

from __future__ import annotations

import math
from dataclasses import replace

from clrast.errors import SceneError
from clrast.scene.gltf_file import (
    MAX_BYTES,
    MAX_VALUE,
    GltfFile,
    get_extension,
    get_integer,
    get_number,
    get_numbers,
    get_object,
    get_text,
    is_data_uri,
    shorten,
)
from clrast.scene.model import AlphaMode, Material, Texture, TextureUse, WrapMode
from clrast.scene.texture import MAX_FILE_BYTES, decode_images

DEFAULT_MATERIAL = Material(name="default", base_color=(1.0, 1.0, 1.0, 1.0), metallic=0.0, roughness=1.0)
MAX_COORDINATE = 1e6  # of a texture transform: beyond, float32 has no texels left

_WRAP_MODES: dict[int, WrapMode] = {10497: "repeat", 33648: "mirror", 33071: "clamp"}
_NEAREST = 9728
_MIPMAPS = (9984, 9985, 9986, 9987)
_ALPHA_MODES: dict[str, AlphaMode] = {"OPAQUE": "OPAQUE", "MASK": "MASK", "BLEND": "BLEND"}
_IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)


def read_materials(file: GltfFile) -> tuple[tuple[Material, ...], tuple[Texture, ...]]:
    """All materials of the file, in its order, and the textures that they look up."""
    materials = [_read_material(file, entry, i) for i, entry in enumerate(file.items("materials"))]
    _warn_of_unused_textures(file)
    images = _images_in_use(materials)
    loaded = _load_images(file, images)
    rank = {image: k for k, image in enumerate(i for i in images if i in loaded)}
    return tuple(_renumber(material, rank) for material in materials), tuple(loaded[i] for i in rank)


def _images_in_use(materials: list[Material]) -> list[int]:
    """The image numbers that materials look up, rising."""
    uses = [use for m in materials for use in (m.base_color_texture, m.emissive_texture) if use is not None]
    return sorted({use.texture for use in uses})


def _renumber(material: Material, rank: dict[int, int]) -> Material:
    """`material` with its image numbers replaced by texture numbers, absent images dropped."""

    def renumbered(use: TextureUse | None) -> TextureUse | None:
        return None if use is None or use.texture not in rank else replace(use, texture=rank[use.texture])

    return replace(
        material,
        base_color_texture=renumbered(material.base_color_texture),
        emissive_texture=renumbered(material.emissive_texture),
    )


def _read_material(file: GltfFile, entry: dict, index: int) -> Material:
    """One material; its texture uses still hold image numbers."""
    name = get_text(entry, "name", f"material{index}")
    where = f'material {index} "{name}"'
    surface = get_object(entry, "pbrMetallicRoughness", where)
    color = get_numbers(surface, "baseColorFactor", where, (1.0, 1.0, 1.0, 1.0))
    color_texture = surface.get("baseColorTexture")
    metallic = _bounded(file, surface, "metallicFactor", where, 1.0)
    roughness = _bounded(file, surface, "roughnessFactor", where, 1.0)
    old = get_extension(entry, "KHR_materials_pbrSpecularGlossiness", where)
    if old is not None and "pbrMetallicRoughness" not in entry:
        color = get_numbers(old, "diffuseFactor", where, (1.0, 1.0, 1.0, 1.0))
        color_texture = old.get("diffuseTexture")
        metallic, roughness = 0.0, 1.0 - _bounded(file, old, "glossinessFactor", where, 1.0)
    strength = get_number(
        get_extension(entry, "KHR_materials_emissive_strength", where) or {}, "emissiveStrength", where, 1.0
    )
    red, green, blue = get_numbers(entry, "emissiveFactor", where, (0.0, 0.0, 0.0))
    transmission = get_extension(entry, "KHR_materials_transmission", where) or {}
    return Material(
        name=name,
        base_color=file.clamp(color, 1.0, f"{where}: base colour"),
        metallic=metallic,
        roughness=roughness,
        emissive=file.clamp((red * strength, green * strength, blue * strength), MAX_VALUE, f"{where}: emission"),
        alpha_mode=_alpha_mode(file, entry, where),
        alpha_cutoff=_bounded(file, entry, "alphaCutoff", where, 0.5, MAX_VALUE),
        double_sided=entry.get("doubleSided") is True,
        unlit=get_extension(entry, "KHR_materials_unlit", where) is not None,
        transmission=_bounded(file, transmission, "transmissionFactor", where, 0.0),
        ior=_index_of_refraction(file, entry, where),
        base_color_texture=_read_texture_use(file, color_texture, f"{where}: base colour texture"),
        emissive_texture=_read_texture_use(file, entry.get("emissiveTexture"), f"{where}: emissive texture"),
    )


def _bounded(file: GltfFile, parent: dict, key: str, where: str, default: float, high: float = 1.0) -> float:
    return file.clamp((get_number(parent, key, where, default),), high, f"{where}: {key}")[0]


def _alpha_mode(file: GltfFile, entry: dict, where: str) -> AlphaMode:
    mode = get_text(entry, "alphaMode", "OPAQUE")
    if mode not in _ALPHA_MODES:
        file.warn(f"{where}: alphaMode {shorten(mode, 20)} is unknown: taken as OPAQUE")
    return _ALPHA_MODES.get(mode, "OPAQUE")


def _index_of_refraction(file: GltfFile, entry: dict, where: str) -> float:
    """KHR_materials_ior: at least 1, or 0 for a surface that reflects all light."""
    extension = get_extension(entry, "KHR_materials_ior", where) or {}
    ior = get_number(extension, "ior", where, 1.5)
    if ior != 0.0 and not 1.0 <= ior <= 1e6:
        file.warn(f"{where}: ior {ior:g} is neither 0 nor at least 1: taken as 1.5")
        return 1.5
    return ior


def _read_texture_use(file: GltfFile, reference: object, where: str) -> TextureUse | None:
    """How a textureInfo looks its image up; `texture` is the *image* number. None where it is absent."""
    if reference is None:
        return None
    if not isinstance(reference, dict):
        raise SceneError(f"{where} needs an object: export the file again")
    texture_index = get_integer(reference, "index", where)
    texture = file.item("textures", texture_index, where)
    place = f"texture {texture_index}"
    image = _image_of(texture, place)
    if image is None:
        file.warn(f"{place} has no image of a kind that is read (PNG, JPEG, WebP): its factor is used alone")
        return None
    uv_set = get_integer(reference, "texCoord", where, 0)
    transform = _IDENTITY
    extension = get_extension(reference, "KHR_texture_transform", where)
    if extension is not None:
        uv_set = get_integer(extension, "texCoord", where, uv_set)
        transform = texture_transform(
            get_numbers(extension, "offset", where, (0.0, 0.0)),
            get_number(extension, "rotation", where, 0.0),
            get_numbers(extension, "scale", where, (1.0, 1.0)),
        )
        if max(abs(value) for value in transform) > MAX_COORDINATE:
            file.warn(f"{where}: its KHR_texture_transform has values over {MAX_COORDINATE:g}: left out")
            transform = _IDENTITY
    if uv_set > 1:
        file.warn(f"{where} uses TEXCOORD_{uv_set}, only 0 and 1 are read: its factor is used alone")
        return None
    sampler: dict = {}
    if "sampler" in texture:
        sampler = file.item("samplers", get_integer(texture, "sampler", place), place)
    return TextureUse(
        texture=image,
        uv_set=uv_set,
        transform=transform,
        wrap_u=_wrap_mode(file, sampler, "wrapS", place),
        wrap_v=_wrap_mode(file, sampler, "wrapT", place),
        nearest=get_integer(sampler, "magFilter", place, 0) == _NEAREST,
        mipmap=get_integer(sampler, "minFilter", place, 0) in _MIPMAPS,
    )


def texture_transform(offset: tuple, rotation: float, scale: tuple) -> tuple[float, float, float, float, float, float]:
    """KHR_texture_transform as a 2x3 matrix: scale, then rotate counter-clockwise as seen, then offset.

    v grows downwards, so a counter-clockwise turn takes (1, 0) to (cos, -sin). The extension's
    sample shader has the opposite sign; its own examples, its test model and viewers this one.
    """
    c, s = math.cos(rotation), math.sin(rotation)
    return (c * scale[0], s * scale[1], offset[0], -s * scale[0], c * scale[1], offset[1])


def _image_of(texture: dict, where: str) -> int | None:
    """The image number of a texture: WebP where EXT_texture_webp has one, else its plain source."""
    webp = get_extension(texture, "EXT_texture_webp", where) or {}
    for holder in (webp, texture):
        if "source" in holder:
            return get_integer(holder, "source", where)
    return None


def _wrap_mode(file: GltfFile, sampler: dict, key: str, where: str) -> WrapMode:
    code = get_integer(sampler, key, where, 10497)
    if code not in _WRAP_MODES:
        file.warn(f"{where}: {key} {code} is none of glTF's: taken as repeat")
    return _WRAP_MODES.get(code, "repeat")


def _load_images(file: GltfFile, images: list[int]) -> dict[int, Texture]:
    """The images that can be decoded, by number; a warning for each of the others."""
    encoded: list[tuple[bytes, str]] = []
    numbers: list[int] = []
    for index in images:
        image = file.item("images", index, "a texture")
        try:
            encoded.append(_image_bytes(file, image, index))
            numbers.append(index)
        except SceneError as error:
            file.warn(f"image {index} is left out, its factor is used alone: {error}")
    loaded = {}
    for index, result in zip(numbers, decode_images(encoded)):
        if isinstance(result, SceneError):
            file.warn(f"image {index} is left out, its factor is used alone: {result}")
        else:
            loaded[index] = result
    return loaded


def _image_bytes(file: GltfFile, image: dict, index: int) -> tuple[bytes, str]:
    """An image's file content, and its name."""
    uri = image.get("uri")
    if isinstance(uri, str):
        name = f"image{index}" if is_data_uri(uri) else shorten(uri)
        return file.read_uri(uri, min(MAX_FILE_BYTES, MAX_BYTES)), get_text(image, "name", name)
    where = f"image {index}"
    view, _ = file.view(get_integer(image, "bufferView", where), where)
    return bytes(view), get_text(image, "name", where.replace(" ", ""))


def _warn_of_unused_textures(file: GltfFile) -> None:
    """One warning per kind of texture that materials have and shading does not use yet."""
    counts: dict[str, int] = {}
    specular_glossiness = 0
    for i, entry in enumerate(file.items("materials")):
        where = f"material {i}"
        surface = get_object(entry, "pbrMetallicRoughness", where)
        transmission = get_extension(entry, "KHR_materials_transmission", where) or {}
        old = get_extension(entry, "KHR_materials_pbrSpecularGlossiness", where)
        specular_glossiness += old is not None
        for holder, kind in (
            (surface, "metallicRoughnessTexture"),
            (entry, "normalTexture"),
            (entry, "occlusionTexture"),
            (transmission, "transmissionTexture"),
            (old or {}, "specularGlossinessTexture"),
        ):
            counts[kind] = counts.get(kind, 0) + (kind in holder)
    for kind, count in counts.items():
        if count:
            file.warn(f"{kind} is not used yet: {count} material{'s' * (count != 1)}")
    if specular_glossiness:
        kept = "their core values, or their diffuse colour where they have none"
        file.warn(f"KHR_materials_pbrSpecularGlossiness is approximated: {specular_glossiness} materials keep {kept}")
