"""glTF accessors, materials and textures against the specification's formulas, by hand."""

from __future__ import annotations

import base64
import io
import json
import math

import numpy as np
import PIL.Image
import pytest
from gltf_writer import TRIANGLE, GltfWriter, png_bytes

from clrast.errors import SceneError
from clrast.scene.gltf import load_gltf
from clrast.scene.gltf_materials import texture_transform
from clrast.scene.load import load as load_scene
from clrast.scene.model import Material, TextureUse
from clrast.scene.texture import decode_image, load_image_file, resolve_below

UV = [[0, 0], [1, 0], [0, 1]]


def load(writer: GltfWriter, tmp_path):
    return load_gltf(writer.write(tmp_path))


def lone(mesh_of, **node):
    """A file of one node; `mesh_of` adds its mesh to the writer."""
    writer = GltfWriter()
    return writer.scene(writer.node(mesh=mesh_of(writer), **node))


def loaded_material(tmp_path, prepare=None, **material) -> tuple[Material, tuple, tuple]:
    """(material, textures, warnings) of a triangle with one material; `prepare` adds images first."""
    w = GltfWriter()
    if prepare:
        prepare(w)
    index = w.add("materials", **material)
    uv = w.accessor(UV)
    scene = load(w.scene(w.node(mesh=w.triangle(material=index, TEXCOORD_0=uv, TEXCOORD_1=uv))), tmp_path)
    return scene.materials[index], scene.textures, scene.warnings


# --- accessors ---------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype, stored, expected", [
    ("u1", [0, 51, 255], [0, 0.2, 1]),
    ("u2", [0, 13107, 65535], [0, 0.2, 1]),
    ("i1", [-128, -127, 127], [-1, -1, 1]),
    ("i2", [-32768, 16384, 32767], [-1, 16384 / 32767, 1]),
])  # fmt: skip
def test_normalised_integers(tmp_path, dtype, stored, expected):
    uv = [[value, 0] for value in stored]
    scene = load(lone(lambda w: w.triangle(TEXCOORD_0=w.accessor(uv, dtype, normalized=True))), tmp_path)
    assert scene.uv[:, 0].tolist() == np.float32(expected).tolist()


def test_quantised_positions_and_normals(tmp_path):
    """KHR_mesh_quantization: plain int16 positions count as they are, normalised ones as fractions."""
    w = GltfWriter()
    w.tree["extensionsUsed"] = w.tree["extensionsRequired"] = ["KHR_mesh_quantization"]
    plain = w.mesh(POSITION=w.accessor([[0, 0, 0], [300, 0, 0], [0, -300, 0]], "i2"),
                   NORMAL=w.accessor([[0, 0, 127]] * 3, "i1", normalized=True))  # fmt: skip
    scaled = w.mesh(POSITION=w.accessor([[0, 0, 0], [65535, 0, 0], [0, 13107, 0]], "u2", normalized=True))
    scene = load(w.scene(w.node(mesh=plain, scale=[0.5, 0.5, 0.5]), w.node(mesh=scaled, scale=[10, 10, 10])), tmp_path)
    assert scene.positions[:3].tolist() == [[0, 0, 0], [150, 0, 0], [0, -150, 0]]
    assert scene.positions[3:].tolist() == [[0, 0, 0], [10, 0, 0], [0, 2, 0]]
    assert scene.normals[:3].tolist() == [[0, 0, 1]] * 3
    assert scene.warnings == ()


def test_interleaved_vertices(tmp_path):
    w = GltfWriter()
    table = np.zeros(3, dtype=[("p", "<f4", 3), ("junk", "<u4"), ("uv", "<u2", 2)])
    table["p"], table["junk"], table["uv"] = TRIANGLE, 0xFFFFFFFF, np.array(UV) * 65535
    view = w.view(b"\xff" * 4 + table.tobytes(), byteStride=20)
    p = w.add("accessors", bufferView=view, byteOffset=4, componentType=5126, count=3, type="VEC3")
    uv = w.add("accessors", bufferView=view, byteOffset=20, componentType=5123, count=3, type="VEC2", normalized=True)
    scene = load(w.scene(w.node(mesh=w.mesh(POSITION=p, TEXCOORD_0=uv))), tmp_path)
    assert scene.positions.tolist() == TRIANGLE and scene.uv.tolist() == UV
    w.tree["bufferViews"][view]["byteLength"] -= 1
    with pytest.raises(SceneError, match="accessor 1 needs 64 bytes for 3 elements, bufferView 0 has 63"):
        load(w, tmp_path)


@pytest.mark.parametrize("has_base", [True, False])
def test_sparse_accessors(tmp_path, has_base):
    def mesh(w):
        sparse = {
            "count": 2,
            "indices": {"bufferView": w.view(np.array([1, 2], "<u1").tobytes()), "componentType": 5121},
            "values": {"bufferView": w.view(np.array([[5, 0, 0], [0, 6, 0]], "<f4").tobytes())},
        }
        if has_base:
            return w.mesh(POSITION=w.accessor([[9, 9, 9]] * 3, sparse=sparse))
        return w.mesh(POSITION=w.add("accessors", componentType=5126, count=3, type="VEC3", sparse=sparse))

    w = lone(mesh)
    first = [9, 9, 9] if has_base else [0, 0, 0]
    assert load(w, tmp_path).positions.tolist() == [first, [5, 0, 0], [0, 6, 0]]
    w.blob[0:2] = b"\1\3"
    with pytest.raises(SceneError, match="index 3 passes the end, there are 3 elements"):
        load(w, tmp_path)


@pytest.mark.parametrize("dtype", ["u1", "u2", "u4"])
def test_index_types_and_range(tmp_path, dtype):
    scene = load(lone(lambda w: _indexed(w, dtype, [2, 0, 1])), tmp_path)
    assert scene.triangles.tolist() == [[2, 0, 1]]
    with pytest.raises(SceneError, match="mesh 0, primitive 0: index 3 is out of range, there are 3 vertices"):
        load(lone(lambda w: _indexed(w, dtype, [0, 1, 3])), tmp_path)


def _indexed(w, dtype, order):
    mesh = w.triangle()
    w.tree["meshes"][mesh]["primitives"][0]["indices"] = w.accessor(order, dtype)
    return mesh


@pytest.mark.parametrize("values, dtype, more, expected", [
    ([[0, 0.25, 1], [2, -1, 0.5], [0, 0, 0]], "f4", {}, [[0, 0.25, 1, 1], [1, 0, 0.5, 1], [0, 0, 0, 1]]),
    ([[255, 51, 0, 51]] * 3, "u1", {"normalized": True}, [[1, 0.2, 0, 0.2]] * 3),
    ([[65535, 0, 13107]] * 3, "u2", {"normalized": True}, [[1, 0, 0.2, 1]] * 3),
])  # fmt: skip
def test_vertex_colours_are_linear_and_clamped(tmp_path, values, dtype, more, expected):
    scene = load(lone(lambda w: w.triangle(COLOR_0=w.accessor(values, dtype, **more))), tmp_path)
    assert scene.colors.tolist() == np.float32(expected).tolist()


def test_attributes_that_are_not_finite(tmp_path):
    uv = [[np.nan, 0.5], [np.inf, 1], [0.25, -np.inf]]
    scene = load(lone(lambda w: w.triangle(TEXCOORD_0=w.accessor(uv))), tmp_path)
    assert scene.uv.tolist() == [[0, 0.5], [0, 1], [0.25, 0]] and "not finite" in scene.warnings[0]


# --- materials ---------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_positions_that_are_not_finite_are_refused_where_a_triangle_uses_them(tmp_path, value):
    w = GltfWriter()
    mesh = w.mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, value, 0]], [0, 1, 2])
    near = load_scene(w.scene(w.node(mesh=mesh), w.node(mesh=mesh, scale=[0, 0, 0])).write(tmp_path))
    assert np.isfinite(near.positions).all() and near.positions[:3].tolist() == TRIANGLE
    w = GltfWriter()
    mesh = w.mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, value, 0]], [0, 1, 2, 0, 3, 1])
    for more in ({}, {"translation": [1, 2, 3]}, {"scale": [0, 0, 0]}):
        w.tree.update(scenes=[], nodes=[])
        path = w.scene(w.node(mesh=mesh, **more)).write(tmp_path)
        with pytest.raises(SceneError, match="vertex 3 .*which triangle 1 uses, is not finite") as caught:
            load_scene(path)
        assert caught.value.exit_code == 65


def test_positions_beyond_float32_are_refused(tmp_path):
    """float64 holds them until a card or a node brings them back; as a result they are no scene."""
    w = GltfWriter()
    mesh = w.mesh([[0, 0, 0], [1, 0, 0], [0, 3e38, 0]])
    inner = w.node(mesh=mesh, scale=[2, 2, 2])
    path = w.scene(w.node(children=[inner], scale=[0.5, 0.5, 0.5])).write(tmp_path)
    assert load_scene(path).positions[2].tolist() == [0, np.float32(3e38), 0]
    w.tree["scenes"] = [{"nodes": [inner]}]
    with pytest.raises(SceneError, match="vertex 2 at 0, 6e.38, 0 is beyond float32"):
        load_scene(w.write(tmp_path))


def test_defaults(tmp_path):
    scene = load(lone(lambda w: w.triangle()), tmp_path)
    assert scene.materials == (Material("default", (1.0, 1.0, 1.0, 1.0), metallic=0.0, roughness=1.0),)
    material, _, warnings = loaded_material(tmp_path)
    assert material == Material("material0", (1.0, 1.0, 1.0, 1.0), metallic=1.0, roughness=1.0) and warnings == ()


def test_material_ids_are_the_files_with_the_default_last(tmp_path):
    w = GltfWriter()
    for name in "abc":
        w.add("materials", name=name)
    nodes = [w.node(mesh=w.triangle(**more)) for more in ({"material": 2}, {}, {"material": 0})]
    scene = load(w.scene(*nodes), tmp_path)
    assert scene.material_ids.tolist() == [2, 3, 0]
    assert [m.name for m in scene.materials] == ["a", "b", "c", "default"]


def test_every_factor(tmp_path):
    surface = {"baseColorFactor": [0.0015, 0.00631, 0.5, 0.25], "metallicFactor": 0.3, "roughnessFactor": 0.7}
    material, _, warnings = loaded_material(
        tmp_path,
        name="all",
        pbrMetallicRoughness=surface,
        emissiveFactor=[1, 0.5, 0.25],
        alphaMode="MASK",
        alphaCutoff=0.75,
        doubleSided=True,
        extensions={
            "KHR_materials_emissive_strength": {"emissiveStrength": 100},
            "KHR_materials_unlit": {},
            "KHR_materials_transmission": {"transmissionFactor": 0.9},
            "KHR_materials_ior": {"ior": 1.33},
        },
    )
    assert material == Material(
        "all", (0.0015, 0.00631, 0.5, 0.25), 0.3, 0.7, (100.0, 50.0, 25.0), "MASK", 0.75, True, True, 0.9, 1.33
    )
    assert warnings == ()


def test_values_out_of_range_are_clamped_aloud(tmp_path):
    material, _, warnings = loaded_material(
        tmp_path, name="m", pbrMetallicRoughness={"metallicFactor": 2, "roughnessFactor": -1}, alphaMode="SOMETIMES",
        extensions={"KHR_materials_ior": {"ior": 0.5}},
    )  # fmt: skip
    assert (material.metallic, material.roughness, material.alpha_mode, material.ior) == (1.0, 0.0, "OPAQUE", 1.5)
    assert len(warnings) == 4 and all(warning.startswith('material 0 "m": ') for warning in warnings)


def test_specular_glossiness_is_approximated(tmp_path):
    old = {"diffuseFactor": [0.1, 0.2, 0.3, 0.4], "glossinessFactor": 0.25, "diffuseTexture": {"index": 0}}
    extensions = {"KHR_materials_pbrSpecularGlossiness": old}
    material, textures, warnings = loaded_material(tmp_path, with_image, extensions=extensions)
    assert (material.base_color, material.metallic, material.roughness) == ((0.1, 0.2, 0.3, 0.4), 0.0, 0.75)
    assert material.base_color_texture == TextureUse(0) and len(textures) == 1
    assert len(warnings) == 1 and "KHR_materials_pbrSpecularGlossiness is approximated" in warnings[0]
    core = {"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}}
    material, textures, warnings = loaded_material(tmp_path, with_image, extensions=extensions, **core)
    assert material.base_color == (1.0, 0.0, 0.0, 1.0) and textures == () and len(warnings) == 1


def test_unused_texture_kinds_get_one_warning_each(tmp_path):
    w = GltfWriter()
    with_image(w)
    for _ in range(2):
        w.add("materials", normalTexture={"index": 0}, pbrMetallicRoughness={"metallicRoughnessTexture": {"index": 0}})
    w.add("materials", occlusionTexture={"index": 0})
    scene = load(w.scene(w.node(mesh=w.triangle(material=0))), tmp_path)
    assert scene.warnings == (
        "metallicRoughnessTexture is not used yet: 2 materials",
        "normalTexture is not used yet: 2 materials",
        "occlusionTexture is not used yet: 1 material",
    )
    assert scene.textures == (), "images that nothing looks up are not decoded"


# --- textures ----------------------------------------------------------------------------------

TEXELS = np.arange(2 * 3 * 4, dtype=np.uint8).reshape(2, 3, 4) * 9


def with_image(w, **sampler):
    source = w.image(TEXELS, name="tiles")
    w.add("textures", source=source, **({"sampler": w.add("samplers", **sampler)} if sampler else {}))


def test_textures_keep_their_texels_and_row_0_is_the_top(tmp_path):
    texture = {"index": 0, "texCoord": 1}
    material, textures, _ = loaded_material(
        tmp_path, with_image, pbrMetallicRoughness={"baseColorTexture": texture}, emissiveTexture={"index": 0}
    )
    assert len(textures) == 1 and textures[0].name == "tiles" and textures[0].srgb
    assert textures[0].texels.dtype == np.uint8 and textures[0].texels.tolist() == TEXELS.tolist()
    assert material.base_color_texture == TextureUse(0, uv_set=1)
    assert material.emissive_texture == TextureUse(0), "the image is shared"


def test_samplers(tmp_path):
    material, _, warnings = loaded_material(
        tmp_path,
        lambda w: with_image(w, wrapS=33071, wrapT=33648, magFilter=9728, minFilter=9987),
        emissiveTexture={"index": 0},
    )
    assert material.emissive_texture == TextureUse(0, wrap_u="clamp", wrap_v="mirror", nearest=True, mipmap=True)
    material, _, more = loaded_material(
        tmp_path, lambda w: with_image(w, wrapS=7, magFilter=9729), emissiveTexture={"index": 0}
    )
    assert material.emissive_texture == TextureUse(0)
    assert warnings == () and more == ("texture 0: wrapS 7 is none of glTF's: taken as repeat",)


def test_texture_transform(tmp_path):
    transform = {"offset": [0.5, -1], "rotation": math.pi / 2, "scale": [2, 3], "texCoord": 1}
    texture = {"index": 0, "extensions": {"KHR_texture_transform": transform}}
    material, _, warnings = loaded_material(tmp_path, with_image, pbrMetallicRoughness={"baseColorTexture": texture})
    use = material.base_color_texture
    # Scale (u, v) to (2u, 3v); turn (u, v) to (v, -u), counter-clockwise where v grows down; move.
    assert use.uv_set == 1 and np.allclose(use.transform, [0, 3, 0.5, -2, 0, -1], atol=1e-15)
    assert warnings == ()


def test_texture_transform_takes_the_lower_left_quadrant():
    """The extension's own example: offset 0,1, a quarter turn, half scale: the image's lower left quarter."""
    m = texture_transform((0.0, 1.0), math.pi / 2, (0.5, 0.5))
    looked_up = [(m[0] * u + m[1] * v + m[2], m[3] * u + m[4] * v + m[5]) for u in (0, 1) for v in (0, 1)]
    assert np.allclose(np.min(looked_up, axis=0), [0, 0.5]) and np.allclose(np.max(looked_up, axis=0), [0.5, 1])


def test_image_sources(tmp_path):
    png = png_bytes(TEXELS)
    stream = io.BytesIO()
    PIL.Image.fromarray(TEXELS).save(stream, "WEBP", lossless=True, exact=True)
    (tmp_path / "a b.png").write_bytes(png)
    (tmp_path / "b.webp").write_bytes(stream.getvalue())
    w = lone(lambda w: w.triangle(material=0, TEXCOORD_0=w.accessor(UV)))
    data_uri = "data:image/png;base64," + base64.b64encode(png).decode()
    w.tree["images"] = [{"uri": "a%20b.png"}, {"uri": data_uri}, {"uri": "b.webp"}, {"uri": "gone.png"}]
    w.add("textures", source=0)
    w.add("textures", source=1)
    w.add("textures", source=3, extensions={"EXT_texture_webp": {"source": 2}})
    w.add("textures", extensions={"KHR_texture_basisu": {"source": 0}})
    for k in range(2):
        surface = {"baseColorTexture": {"index": 2 * k}}
        w.add("materials", pbrMetallicRoughness=surface, emissiveTexture={"index": 2 * k + 1})
    scene = load(w, tmp_path)
    assert [t.texels.tolist() for t in scene.textures] == [TEXELS.tolist()] * 3
    assert scene.materials[1].base_color_texture == TextureUse(2) and scene.materials[1].emissive_texture is None
    assert any("texture 3 has no image of a kind that is read" in warning for warning in scene.warnings)


@pytest.mark.parametrize("image, reason", [
    ({"uri": "gone.png"}, "missing"), ({"uri": "../a.png"}, "outside"), ({"uri": "https://x.org/a.png"}, "URL"),
    ({"uri": "notes.txt"}, "no known format"), ({"uri": "cut.png"}, "broken"), ({"uri": "wide.png"}, "16385x1"),
    ({}, "lacks bufferView"),
])  # fmt: skip
def test_absent_images_leave_the_factor_alone(tmp_path, image, reason):
    folder = tmp_path / "home"
    folder.mkdir()
    (tmp_path / "a.png").write_bytes(png_bytes(TEXELS))
    (folder / "notes.txt").write_text("not an image")
    (folder / "cut.png").write_bytes(png_bytes(np.random.default_rng(1).integers(0, 256, (64, 64, 3), np.uint8))[:4000])
    (folder / "wide.png").write_bytes(png_bytes(np.zeros((1, 16385, 3), np.uint8)))
    w = GltfWriter()
    w.tree["images"] = [image]
    w.add("textures", source=0)
    w.add("materials", pbrMetallicRoughness={"baseColorTexture": {"index": 0}, "baseColorFactor": [0.5, 0.5, 0.5, 1]})
    scene = load(w.scene(w.node(mesh=w.triangle(material=0, TEXCOORD_0=w.accessor(UV)))), folder)
    assert scene.textures == () and scene.materials[0].base_color_texture is None
    assert scene.materials[0].base_color == (0.5, 0.5, 0.5, 1.0)
    assert len(scene.warnings) == 1
    assert scene.warnings[0].startswith("image 0 is left out") and reason in scene.warnings[0]


def test_missing_texture_coordinates_are_warned_of(tmp_path):
    w = GltfWriter()
    with_image(w)
    w.add("materials", emissiveTexture={"index": 0})
    scene = load(w.scene(w.node(mesh=w.triangle(material=0))), tmp_path)
    assert scene.warnings == ("1 primitives lack the texture coordinates that their material uses: taken as 0, 0",)


@pytest.mark.parametrize("mode, pixel, rgba", [
    ("L", 100, [100, 100, 100, 255]), ("LA", (100, 50), [100, 100, 100, 50]), ("RGB", (1, 2, 3), [1, 2, 3, 255]),
    ("RGBA", (9, 8, 7, 0), [9, 8, 7, 0]), ("1", 1, [255, 255, 255, 255]), ("I;16", 0x8080, [128, 128, 128, 255]),
    ("I;16", 400, [2, 2, 2, 255]),
])  # fmt: skip
def test_pixel_formats_become_rgba8(mode, pixel, rgba):
    stream = io.BytesIO()
    PIL.Image.new(mode, (3, 2), pixel).save(stream, "PNG")
    texels = decode_image(stream.getvalue(), "x").texels
    assert texels.shape == (2, 3, 4) and texels.dtype == np.uint8 and texels.flags.c_contiguous
    assert (texels == rgba).all()


def test_palette_with_transparency():
    image = PIL.Image.new("P", (2, 1))
    image.putpalette([10, 20, 30, 40, 50, 60])
    image.putdata([0, 1])
    stream = io.BytesIO()
    image.save(stream, "PNG", transparency=bytes([128, 255]))
    assert decode_image(stream.getvalue(), "x").texels.tolist() == [[[10, 20, 30, 128], [40, 50, 60, 255]]]


def test_image_files_of_other_loaders(tmp_path):
    folder = tmp_path / "home"
    (folder / "maps").mkdir(parents=True)
    (folder / "maps" / "50%20.png").write_bytes(png_bytes(TEXELS))
    assert load_image_file("maps\\50%20.png", folder).texels.tolist() == TEXELS.tolist()
    (tmp_path / "a.png").write_bytes(png_bytes(TEXELS))
    for name, reason in (("../a.png", "outside"), (str(tmp_path / "a.png"), "absolute"), ("b.png", "missing")):
        with pytest.raises(SceneError, match=reason):
            load_image_file(name, folder)
    assert resolve_below(folder, "a/../b.png") == (folder / "b.png").resolve()


def test_json_stays_readable_with_a_byte_order_mark(tmp_path):
    w = lone(lambda w: w.triangle())
    w.tree["buffers"] = [{"byteLength": len(w.blob), "uri": "data:;base64," + base64.b64encode(w.blob).decode()}]
    (tmp_path / "a.gltf").write_bytes(b"\xef\xbb\xbf" + json.dumps(w.tree).encode())
    assert load_gltf(tmp_path / "a.gltf").triangle_count == 1
