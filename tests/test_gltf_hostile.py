"""Broken and hostile glTF files: one line of SceneError or a consistent scene, in bounded time and memory."""

from __future__ import annotations

import copy
import json
import math
import random
import struct
import time

import numpy as np
import pytest
from gltf_writer import GltfWriter, pack_glb
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from clrast.errors import SceneError
from clrast.scene.gltf import load_gltf


def rich_file() -> GltfWriter:
    """A small file that uses nearly everything the loader reads."""
    w = GltfWriter()
    source = w.image(np.arange(48, dtype=np.uint8).reshape(4, 4, 3))
    texture = w.add("textures", source=source, sampler=w.add("samplers", wrapS=33071, magFilter=9728))
    transform = {"KHR_texture_transform": {"offset": [0.5, 0], "rotation": 1, "scale": [2, 2], "texCoord": 1}}
    surface = {"baseColorTexture": {"index": texture, "extensions": transform}, "metallicFactor": 0.5}
    surface["baseColorFactor"] = [1, 0.5, 0.25, 1]
    extensions = {"KHR_materials_ior": {"ior": 1.4}, "KHR_materials_emissive_strength": {"emissiveStrength": 2}}
    more = {"emissiveFactor": [1, 1, 1], "alphaMode": "MASK", "extensions": extensions}
    w.add("materials", name="m", pbrMetallicRoughness=surface, **more)
    sparse = {"count": 1, "indices": {"bufferView": w.view(b"\1"), "componentType": 5121},
              "values": {"bufferView": w.view(np.float32([2, 0, 0]).tobytes())}}  # fmt: skip
    points = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    uv = w.accessor([[0, 0], [255, 0], [255, 255], [0, 255]], "u1", normalized=True)
    attributes = {"POSITION": w.accessor(points, sparse=sparse), "NORMAL": w.accessor([[0, 0, 1]] * 4)}
    attributes.update(TEXCOORD_0=uv, TEXCOORD_1=uv, COLOR_0=w.accessor(points))
    mesh = w.mesh(name="quad", material=0, indices=[0, 1, 2, 0, 2, 3], **attributes)
    w.tree["meshes"][mesh]["primitives"].append({"attributes": {"POSITION": 1}, "mode": 5})
    lights = [{"type": "spot", "intensity": 3, "spot": {"outerConeAngle": 0.5}}]
    w.tree["extensions"] = {"KHR_lights_punctual": {"lights": lights}}
    w.tree["extensionsUsed"] = ["KHR_lights_punctual", "EXT_mesh_gpu_instancing"]
    lens = w.add("cameras", type="perspective", perspective={"yfov": 1, "znear": 0.1})
    instances = {"TRANSLATION": w.accessor([[0, 0, 0], [3, 0, 0]]), "ROTATION": w.accessor([[0, 0, 0, 1]] * 2)}
    leaf = w.node(mesh=mesh, name="leaf", extensions={"EXT_mesh_gpu_instancing": {"attributes": instances}})
    eye = w.node(camera=lens, translation=[0, 0, 5], extensions={"KHR_lights_punctual": {"light": 0}})
    root = w.node(mesh=mesh, children=[leaf, eye], rotation=[0, 0, 1, 1], scale=[1, 2, 3])
    turned = w.node(mesh=mesh, matrix=[1, 0, 0, 0, 0, 0, 1, 0, 0, -1, 0, 0, 4, 5, 6, 1])
    w.tree["scene"] = 0
    return w.scene(root, turned)


def outcome(path) -> str:
    """'scene' or 'refused'; anything else that the loader does is a failure."""
    start = time.perf_counter()
    try:
        scene = load_gltf(path)
    except SceneError as error:
        assert "\n" not in str(error) and len(str(error)) < 1000
        assert "is not understood" not in str(error), "a mistake that no check foresaw"
        result = "refused"
    else:
        check_consistent(scene)
        result = "scene"
    assert time.perf_counter() - start < 5
    return result


def check_consistent(scene) -> None:
    """What must hold of a scene whatever the file says; positions may still be NaN, the caller asks for that."""
    assert scene.triangle_count > 0 and scene.triangles.max() < scene.vertex_count
    assert scene.object_ids.max() < len(scene.object_names) and scene.material_ids.max() < len(scene.materials)
    for array in (scene.normals, scene.uv, scene.uv1, scene.colors):
        assert array is None or len(array) == scene.vertex_count and not np.isnan(array).any()
    for material in scene.materials:
        numbers = (*material.base_color, *material.emissive, material.metallic, material.roughness, material.ior)
        assert all(0 <= value < math.inf for value in numbers)
        for use in (material.base_color_texture, material.emissive_texture):
            assert use is None or 0 <= use.texture < len(scene.textures) and use.uv_set in (0, 1)
    for camera in scene.cameras:
        assert all(map(math.isfinite, (*camera.eye, *camera.look_at, *camera.up, camera.fov, camera.height)))
    for light in scene.lights:
        assert all(map(math.isfinite, (*light.intensity, *light.position, *light.direction, light.range)))
    assert all(isinstance(warning, str) and "\n" not in warning and len(warning) < 1000 for warning in scene.warnings)


def test_the_file_to_be_broken_is_whole(tmp_path):
    scene = load_gltf(rich_file().write(tmp_path))
    assert scene.warnings == () and scene.triangle_count == 4 * 4
    assert len(scene.cameras) == len(scene.lights) == len(scene.textures) == 1 and len(scene.object_names) == 4


VALUES = [
    None, True, False, 0, 1, 2, 3, 5, 255, 5120, 5126, 2**31, 2**32, 2**53, 10**30, -1, 0.5, -0.0, 1e-300, 1e300,
    -1e39, "", "x", "data:,", "\ud800\n", "../x", "http://x/", "MAT4", "VEC2", "SCALAR", [], [0], [0, 0], [1, 2, 3],
    [0, 0, 0, 0], [1e300, 1e300, 1e300], ["a"], [None] * 16, [[]] * 3, {}, {"a": 1}, {"index": 0}, [[[[[]]]]],
]  # fmt: skip


def places(value, path=()):
    """All (path, key) below a JSON value."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, child in items:
        yield path, key
        yield from places(child, (*path, key))


def mutated(tree: dict, source: random.Random) -> dict:
    tree = copy.deepcopy(tree)
    for _ in range(source.choice([1, 1, 1, 2, 4])):
        path, key = source.choice(list(places(tree)))
        holder = tree
        for step in path:
            holder = holder[step]
        action = source.random()
        if action < 0.15:
            del holder[key]
        elif action < 0.25 and isinstance(holder, list):
            holder.append(copy.deepcopy(holder[key]))
        elif action < 0.4 and isinstance(holder[key], (int, float)) and not isinstance(holder[key], bool):
            holder[key] += source.choice([-1, 1, 2, 4, 1000])
        else:
            holder[key] = copy.deepcopy(source.choice(VALUES))
        if not list(places(tree)):
            break
    return tree


@pytest.mark.parametrize("seed", range(4))
def test_json_mutations(tmp_path, seed):
    """750 files a seed, each with a few values of the JSON replaced, removed, repeated or moved a little."""
    whole = rich_file()
    whole.glb()
    source = random.Random(seed)
    seen = {"scene": 0, "refused": 0}
    path = tmp_path / "mutant.glb"
    for _ in range(750):
        path.write_bytes(pack_glb(json.dumps(mutated(whole.tree, source)).encode(), bytes(whole.blob)))
        seen[outcome(path)] += 1
    assert min(seen.values()) > 100, "mutations must reach both ends"


@pytest.mark.parametrize("seed", range(2))
def test_byte_mutations(tmp_path, seed):
    content = rich_file().glb()
    source = random.Random(100 + seed)
    path = tmp_path / "mutant.glb"
    for _ in range(750):
        broken = bytearray(content)
        for _ in range(source.choice([1, 2, 8])):
            broken[source.randrange(len(broken))] = source.randrange(256)
        if source.random() < 0.3:
            del broken[source.randrange(len(broken)) :]
        path.write_bytes(broken)
        outcome(path)


@given(st.binary(max_size=400))
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_bytes_are_refused(tmp_path, content):
    (tmp_path / "a.gltf").write_bytes(content)
    with pytest.raises(SceneError):
        load_gltf(tmp_path / "a.gltf")
    (tmp_path / "a.glb").write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(content)) + content)
    with pytest.raises(SceneError):
        load_gltf(tmp_path / "a.glb")


def test_every_truncation_is_refused(tmp_path):
    w = GltfWriter()
    content = w.scene(w.node(mesh=w.triangle())).glb()
    path = tmp_path / "cut.glb"
    for size in range(0, len(content)):
        path.write_bytes(content[:size])
        with pytest.raises(SceneError):
            load_gltf(path)
        if size >= 20:  # the same with a header that agrees
            path.write_bytes(content[:8] + struct.pack("<I", size) + content[12:size])
            with pytest.raises(SceneError):
                load_gltf(path)


def edited(tmp_path, edit):
    w = GltfWriter()
    w.scene(w.node(mesh=w.triangle(indices=[0, 1, 2], NORMAL=w.accessor([[0, 0, 1]] * 3))))
    edit(w.tree)
    return w.write(tmp_path)


@pytest.mark.parametrize("kind, index, change, message", [
    ("accessors", 1, {"count": 10**12}, "accessor 1: count needs an integer from 0 to"),
    ("accessors", 1, {"count": 10**9}, "accessor 1 needs 12000000000 bytes for 1000000000 elements"),
    ("accessors", 1, {"count": 10**8, "bufferView": None}, "bufferView needs an integer, there is null"),
    ("accessors", 1, {"count": -3}, "count needs an integer from 0 to .* there is -3"),
    ("accessors", 1, {"count": 2.5}, "count needs an integer, there is a number"),
    ("accessors", 1, {"type": "VEC2"}, "needs type VEC3, not VEC2"),
    ("accessors", 1, {"componentType": 5124}, "componentType 5124 is none of glTF's"),
    ("accessors", 1, {"byteOffset": 4}, "accessor 1 needs 40 bytes for 3 elements, bufferView 1 has 36"),
    ("accessors", 0, {"count": 2, "byteOffset": 12}, "NORMAL has 2 elements, POSITION 3"),
    ("accessors", 2, {"componentType": 5122}, "indices need an unsigned integer type"),
    ("bufferViews", 1, {"byteStride": 4}, "accessor 1 needs 12 bytes an element, bufferView 1 has byteStride 4"),
    ("bufferViews", 1, {"byteLength": 10**6}, "bufferView 1 ends at byte .*, buffer 0 has"),
    ("bufferViews", 1, {"buffer": 1}, r"bufferView 1 names buffers\[1\], there are 1"),
    ("nodes", 0, {"mesh": 7}, r"node 0 names meshes\[7\], there are 1"),
    ("nodes", 0, {"children": [5]}, r"names nodes\[5\], there are 1"),
    ("nodes", 0, {"matrix": [1, 2, 3]}, "matrix needs 16 numbers, there are 3"),
    ("nodes", 0, {"translation": [0, 0, "x"]}, "translation needs a number, there is a string"),
    ("nodes", 0, {"scale": [0, 0, 10**400]}, "scale needs a finite number"),
    ("scenes", 0, {"nodes": {}}, "nodes needs an array, there is an object"),
    ("meshes", 0, {"primitives": [7]}, "primitive 0 needs an object"),
])  # fmt: skip
def test_common_mistakes_are_named(tmp_path, kind, index, change, message):
    path = edited(tmp_path, lambda tree: tree[kind][index].update(change))
    with pytest.raises(SceneError, match=message) as caught:
        load_gltf(path)
    assert str(caught.value).startswith("scene.glb: ")


@pytest.mark.parametrize("text, message", [
    (b"{", "the JSON is broken"), (b"[]", "needs an object, there is an array"), (b"[" * 100_000, "nested too deeply"),
    (b'{"asset":{"version":"1.0"}}', "glTF 1.0 is not read"), (b"\xff\xfe", "the JSON is broken"),
    (b'{"asset":{"version":"2.0"},"nodes":[{"translation":[NaN,0,0]}]}', "NaN is no JSON number"),
    (b'{"a":' + b"9" * 5000 + b"}", "the JSON is broken"), (b"{}", "no triangle in the default scene"),
])  # fmt: skip
def test_broken_json(tmp_path, text, message):
    for name, content in (("a.gltf", text), ("a.glb", pack_glb(text, b""))):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(SceneError, match=message):
            load_gltf(tmp_path / name)


def test_zero_accessors_do_not_allocate_the_sky(tmp_path):
    def edit(tree):
        tree["accessors"][1]["count"] = 10**9
        del tree["accessors"][1]["bufferView"]

    with pytest.raises(SceneError, match="accessor 1 has 1000000000 elements and no bytes"):
        load_gltf(edited(tmp_path, edit))


def test_deep_trees_load(tmp_path):
    w = GltfWriter()
    mesh = w.triangle()
    depth = 20_000
    for k in range(depth):
        w.node(translation=[1, 0, 0], children=[k + 1])
    w.node(mesh=mesh)
    scene = load_gltf(w.scene(0).write(tmp_path))
    assert scene.positions[0].tolist() == [depth, 0, 0]


def test_trees_that_explode_are_refused(tmp_path):
    w = GltfWriter()
    mesh = w.triangle()
    for k in range(40):  # 2 to the 40th paths to one leaf
        w.node(children=[k + 1, k + 1])
    w.node(mesh=mesh)
    with pytest.raises(SceneError, match="nodes must have one parent each"):
        load_gltf(w.scene(0).write(tmp_path))


def test_triangle_and_placement_bounds(tmp_path):
    w = GltfWriter()
    count = 3_000_000
    mesh = w.mesh(POSITION=w.add("accessors", componentType=5126, type="VEC3", count=count))
    nodes = [w.node(mesh=mesh) for _ in range(300)]
    with pytest.raises(SceneError, match="over 200000000 triangles|over 400000000 vertices"):
        load_gltf(w.scene(*nodes).write(tmp_path))
    w = GltfWriter()
    mesh = w.triangle()
    w.tree["meshes"][mesh]["primitives"] *= 3000
    nodes = [w.node(mesh=mesh) for _ in range(1000)]
    with pytest.raises(SceneError, match="over 1000000 placed primitives"):
        load_gltf(w.scene(*nodes).write(tmp_path))


def test_names_cannot_break_lines_or_terminals(tmp_path):
    def edit(tree):
        tree["nodes"][0]["name"] = "a\nb\x1b[31m\ud800" + "x" * 1000
        tree["extensionsUsed"] = ["E\nvil" + "y" * 1000]

    scene = load_gltf(edited(tmp_path, edit))
    assert scene.object_names[0].startswith("a?b?[31m?xxx") and len(scene.object_names[0]) == 200
    assert scene.warnings == ("the extension E?vil" + "y" * 52 + "... is not supported: shown without it",)


def test_warnings_are_bounded(tmp_path):
    w = GltfWriter()
    nodes = [w.node(mesh=w.triangle())] + [w.node(rotation=[0, 0, 0, 0]) for _ in range(500)]
    assert len(load_gltf(w.scene(*nodes).write(tmp_path)).warnings) == 101
