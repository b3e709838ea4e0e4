"""glTF geometry, node tree, cameras and lights against values worked out by hand."""

from __future__ import annotations

import base64
import json
import math

import numpy as np
import pytest
from gltf_writer import TRIANGLE, GltfWriter

from clrast.errors import InputNotFoundError, SceneError
from clrast.scene.gltf import load_gltf

SIN45 = math.sqrt(0.5)
TURN_Z = [0, 0, SIN45, SIN45]  # a quarter turn about z: x goes to y


def load(writer: GltfWriter, tmp_path):
    return load_gltf(writer.write(tmp_path))


def corners(scene) -> np.ndarray:
    """(triangle_count, 3, 3) world positions of the triangles' vertices."""
    return scene.positions[scene.triangles]


def lone(mesh_of, **node):
    """A file of one node; `mesh_of` adds its mesh to the writer."""
    writer = GltfWriter()
    return writer.scene(writer.node(mesh=mesh_of(writer), **node))


# --- order and names ---------------------------------------------------------------------------


def test_order_is_depth_first_by_nodes_then_primitives_then_triangles(tmp_path):
    w = GltfWriter()
    two = w.triangle()
    w.tree["meshes"][two]["primitives"].append({"attributes": {"POSITION": w.accessor(np.add(TRIANGLE, [0, 0, 1]))}})
    one = w.triangle(name="leaf mesh")
    leaf = w.node(mesh=one, translation=[20, 0, 0])
    inner = w.node(mesh=two, name="inner", translation=[10, 0, 0], children=[leaf])
    last = w.node(mesh=one, name="last", translation=[30, 0, 0])
    root = w.node(children=[inner, last])
    scene = load(w.scene(root), tmp_path)
    assert corners(scene)[:, 0].tolist() == [[10, 0, 0], [10, 0, 1], [30, 0, 0], [30, 0, 0]]
    assert scene.object_ids.tolist() == [0, 0, 1, 2]
    assert scene.object_names == ("inner", "leaf mesh", "last")
    assert [c[0][0] for c in corners(scene)] == [10, 10, 30, 30]


def test_default_scene_and_root_nodes(tmp_path):
    w = GltfWriter()
    mesh = w.triangle()
    nodes = [w.node(mesh=mesh, name=f"n{k}") for k in range(3)]
    w.tree["nodes"][nodes[2]]["children"] = [nodes[0]]
    assert load(w, tmp_path).object_names == ("n1", "n2", "n0"), "without scenes: the nodes without a parent"
    w.scene(nodes[0]).scene(nodes[1])
    assert load(w, tmp_path).object_names == ("n0",), "the first scene is the default"
    w.tree["scene"] = 1
    assert load(w, tmp_path).object_names == ("n1",)
    w.tree["scene"] = 2
    with pytest.raises(SceneError, match=r"names scenes\[2\], there are 2"):
        load(w, tmp_path)


@pytest.mark.parametrize(
    "mode, indices", [(5, None), (5, [0, 1, 2, 3, 4]), (6, None), (4, None), (4, [0, 1, 2, 2, 1, 3])]
)
def test_strips_and_fans_face_one_way(tmp_path, mode, indices):
    strip = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 2, 0]]
    fan = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [-1, 1, 0]]
    listed = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 1, 0], [1, 0, 0], [1, 1, 0]]
    points = {5: strip, 6: fan, 4: strip[:4] if indices else listed}[mode]
    scene = load(lone(lambda w: w.mesh(points, indices, mode=mode)), tmp_path)
    p = corners(scene).astype(float)
    areas = 0.5 * np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])[:, 2]
    expected = {5: [0.5, 0.5, 0.5], 6: [0.5, 0.5, 0.5], 4: [0.5, 0.5]}[mode]
    assert areas.tolist() == expected, "every triangle counter-clockwise, none lost"


def test_strip_and_fan_vertices_are_the_specifications(tmp_path):
    points = [[k, k * k, 0] for k in range(6)]
    strip = load(lone(lambda w: w.mesh(points, mode=5)), tmp_path)
    assert strip.triangles.tolist() == [[0, 1, 2], [1, 3, 2], [2, 3, 4], [3, 5, 4]]
    fan = load(lone(lambda w: w.mesh(points, [5, 4, 3, 2, 5], mode=6)), tmp_path)
    assert fan.triangles.tolist() == [[4, 3, 5], [3, 2, 5], [2, 5, 5]], "degenerate ones stay"


def test_points_and_lines_are_warned_of(tmp_path):
    w = GltfWriter()
    meshes = [w.triangle(), w.triangle(mode=0), w.triangle(mode=1), w.triangle(mode=1), w.triangle(mode=9)]
    scene = load(w.scene(*[w.node(mesh=m) for m in meshes]), tmp_path)
    assert scene.triangle_count == 1
    assert scene.warnings == (
        "points are not drawn: 1 primitive",
        "lines are not drawn: 2 primitives",
        "primitives of mode 9 are not drawn: 1 primitive",
    )
    with pytest.raises(SceneError, match=r"no triangle in the default scene \(points are not drawn"):
        load(lone(lambda w: w.triangle(mode=0)), tmp_path)


def test_vertices_stay_shared_and_unused_ones_go_only_from_pools(tmp_path):
    quad = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    scene = load(lone(lambda w: w.mesh(quad, [0, 1, 2, 0, 2, 3])), tmp_path)
    assert scene.vertex_count == 4 and scene.triangles.tolist() == [[0, 1, 2], [0, 2, 3]]
    pool = [[k, k % 7, 0] for k in range(100)]
    uv = [[k / 128, 0] for k in range(100)]
    scene = load(lone(lambda w: w.mesh(pool, [90, 7, 50], TEXCOORD_0=w.accessor(uv))), tmp_path)
    assert scene.vertex_count == 3
    assert corners(scene)[0].tolist() == [pool[90], pool[7], pool[50]]
    assert scene.uv[scene.triangles][0].tolist() == [uv[90], uv[7], uv[50]]


# --- transforms --------------------------------------------------------------------------------


def test_trs_goes_down_the_tree(tmp_path):
    w = GltfWriter()
    leaf = w.node(mesh=w.triangle(), translation=[1, 2, 3], scale=[2, 3, 4])
    root = w.node(children=[leaf], rotation=TURN_Z, translation=[100, 0, 0])
    p = corners(load(w.scene(root), tmp_path))[0]
    # (x, y, z) -> (2x + 1, 3y + 2, 4z + 3) -> a quarter turn (x, y) -> (-y, x) -> +100
    assert np.allclose(p, [[98, 1, 3], [98, 3, 3], [95, 1, 3]], rtol=0, atol=1e-5)


def test_matrix_is_read_column_by_column(tmp_path):
    matrix = [0, 2, 0, 0, -3, 0, 0, 0, 0, 0, 4, 0, 5, 6, 7, 1]  # x to 2y, y to -3x, z to 4z, then move
    p = corners(load(lone(lambda w: w.triangle(), matrix=matrix), tmp_path))[0]
    assert p.tolist() == [[5, 6, 7], [5, 8, 7], [2, 6, 7]]


def test_positions_are_rounded_once(tmp_path):
    """Far out and back: float32 matrices would lose the quarter, float64 ones keep every bit."""
    w = GltfWriter()
    leaf = w.node(mesh=w.mesh([[0.25, 0, 0], [1.125, 0, 0], [0, 1, 0]]), translation=[-6378137.1875, 0, 0])
    root = w.node(children=[leaf], translation=[6378137.25, 0, 0])
    p = corners(load(w.scene(root), tmp_path))[0]
    assert p[:, 0].tolist() == [0.3125, 1.1875, 0.0625]


def test_a_mirrored_instance_keeps_vertex_order_and_outward_normals(tmp_path):
    def mesh(w):
        return w.triangle(NORMAL=w.accessor([[0, 0, 1], [SIN45, 0, SIN45], [0, 1, 0]]))

    scene = load(lone(mesh, scale=[-1, 1, 1]), tmp_path)
    assert corners(scene)[0].tolist() == [[0, 0, 0], [-1, 0, 0], [0, 1, 0]]
    assert np.allclose(scene.normals, [[0, 0, 1], [-SIN45, 0, SIN45], [0, 1, 0]], atol=1e-7)


@pytest.mark.parametrize("scale", [[2, 2, 2], [1, 4, 1], [-1, -1, -1], [1e-30, 4e-30, 1e-30], [-1e25, 4e25, 1e25]])
def test_normals_stay_perpendicular(tmp_path, scale):
    """The normal of a slanted plane, scaled: inverse transpose, whatever the size and sign."""
    points = [[0, 0, 0], [1, 0, 1], [0, 1, 0]]
    normal = [-SIN45, 0, SIN45]
    scene = load(lone(lambda w: w.mesh(points, NORMAL=w.accessor([normal] * 3)), scale=scale), tmp_path)
    inverse = np.array(normal) / np.array(scale, dtype=float)
    assert np.allclose(scene.normals, inverse / np.sqrt((inverse**2).sum()), atol=1e-6)


def test_normals_without_direction_become_zero(tmp_path):
    normals = [[0, 0, 0], [np.nan, 0, 1], [0, 0, 3]]
    scene = load(lone(lambda w: w.triangle(NORMAL=w.accessor(normals))), tmp_path)
    assert scene.normals.tolist() == [[0, 0, 0], [0, 0, 0], [0, 0, 1]]
    normals = [[0, 0, 1], [0, 1, 0], [0, 1, 1]]
    flat = load(lone(lambda w: w.triangle(NORMAL=w.accessor(normals)), scale=[1, 1, 0]), tmp_path)
    assert flat.normals.tolist() == [[0, 0, 1], [0, 0, 0], [0, 0, 1]], "flattened: only the direction left counts"


def test_quaternions_are_made_unit_length(tmp_path):
    p = corners(load(lone(lambda w: w.triangle(), rotation=[0, 0, 3, 3]), tmp_path))[0]
    assert np.allclose(p, [[0, 0, 0], [0, 1, 0], [-1, 0, 0]], atol=1e-7)
    scene = load(lone(lambda w: w.triangle(), rotation=[0, 0, 0, 0]), tmp_path)
    assert corners(scene)[0].tolist() == TRIANGLE and "zero quaternion" in scene.warnings[0]


def test_attributes_that_only_some_primitives_have(tmp_path):
    w = GltfWriter()
    full = w.triangle(NORMAL=w.accessor([[0, 0, 1]] * 3), TEXCOORD_1=w.accessor([[0.5, 2]] * 3),
                      COLOR_0=w.accessor([[0.25, 0.5, 0.75]] * 3))  # fmt: skip
    scene = load(w.scene(w.node(mesh=w.triangle()), w.node(mesh=full)), tmp_path)
    assert scene.normals.tolist() == [[0, 0, 0]] * 3 + [[0, 0, 1]] * 3
    assert scene.uv is None and scene.uv1.tolist() == [[0, 0]] * 3 + [[0.5, 2]] * 3
    assert scene.colors.tolist() == [[1, 1, 1, 1]] * 3 + [[0.25, 0.5, 0.75, 1]] * 3


# --- instancing --------------------------------------------------------------------------------


def test_gpu_instances_are_objects_in_order(tmp_path):
    w = GltfWriter()
    attributes = {
        "TRANSLATION": w.accessor([[1, 0, 0], [2, 0, 0]]),
        "ROTATION": w.accessor([[0, 0, 0, 127], [0, 0, 90, 90]], "i1", normalized=True),
        "SCALE": w.accessor([[1, 1, 1], [2, 3, 1]]),
    }
    instancing = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
    node = w.node(mesh=w.triangle(), name="tree", translation=[0, 10, 0], extensions=instancing)
    scene = load(w.scene(node), tmp_path)
    assert scene.object_names == ("tree[0]", "tree[1]") and scene.object_ids.tolist() == [0, 1]
    assert np.allclose(corners(scene)[0], [[1, 10, 0], [2, 10, 0], [1, 11, 0]])
    assert np.allclose(corners(scene)[1], [[2, 10, 0], [2, 12, 0], [-1, 10, 0]], atol=1e-6)
    assert scene.warnings == ()


def test_gpu_instances_must_agree_in_number(tmp_path):
    w = GltfWriter()
    attributes = {"TRANSLATION": w.accessor([[1, 0, 0]]), "SCALE": w.accessor([[1, 1, 1]] * 2)}
    w.scene(w.node(mesh=w.triangle(), extensions={"EXT_mesh_gpu_instancing": {"attributes": attributes}}))
    with pytest.raises(SceneError, match="as many of each attribute"):
        load(w, tmp_path)


# --- cameras and lights ------------------------------------------------------------------------


def test_cameras_in_order_with_their_parents(tmp_path):
    w = GltfWriter()
    lens = w.add("cameras", type="perspective", perspective={"yfov": math.pi / 3, "znear": 0.1, "aspectRatio": 2})
    lens_box = {"xmag": 4, "ymag": 1.5, "znear": 0, "zfar": 9}
    box = w.add("cameras", type="orthographic", name="box", orthographic=lens_box)
    first = w.node(camera=lens, translation=[0, 0, 5])
    turned = w.node(children=[first, w.node(camera=box)], rotation=TURN_Z, translation=[1, 2, 3], scale=[2, 2, 2])
    side = w.node(camera=lens, name="side", rotation=[0, SIN45, 0, SIN45])
    scene = load(w.scene(w.node(mesh=w.triangle()), turned, side), tmp_path)
    assert [c.name for c in scene.cameras] == ["camera0", "box", "side"]
    a, b, c = scene.cameras
    assert a.projection == "perspective" and a.fov == pytest.approx(60)
    assert np.allclose(a.eye, [1, 2, 13]) and np.allclose(a.look_at, [1, 2, 12]) and np.allclose(a.up, [-1, 0, 0])
    assert b.projection == "orthographic" and b.height == 3.0 and np.allclose(b.eye, [1, 2, 3])
    assert np.allclose(np.subtract(c.look_at, c.eye), [-1, 0, 0]) and np.allclose(c.up, [0, 1, 0])
    assert scene.warnings == ()


def test_cameras_that_cannot_look_are_left_out(tmp_path):
    w = GltfWriter()
    good = w.add("cameras", type="perspective", perspective={"yfov": 1, "znear": 0.1})
    wide = w.add("cameras", type="perspective", perspective={"yfov": 4, "znear": 0.1})
    odd = w.add("cameras", type="fisheye")
    nodes = [w.node(camera=good, scale=[1, 1, 0]), w.node(camera=wide), w.node(camera=odd), w.node(camera=good)]
    scene = load(w.scene(w.node(mesh=w.triangle()), *nodes), tmp_path)
    assert [c.name for c in scene.cameras] == ["camera0"]
    assert len(scene.warnings) == 3 and all("left out" in warning for warning in scene.warnings)


def test_lights(tmp_path):
    w = GltfWriter()
    lights = [
        {"type": "point", "color": [1, 0.5, 0], "intensity": 40, "range": 7, "name": "lamp"},
        {"type": "spot", "spot": {"innerConeAngle": 0.25, "outerConeAngle": 0.5}},
        {"type": "directional", "intensity": 3},
        {"type": "area"},
        {"type": "spot", "spot": {"innerConeAngle": 0.5, "outerConeAngle": 0.25}},
    ]
    w.tree["extensions"] = {"KHR_lights_punctual": {"lights": lights}}
    w.tree["extensionsUsed"] = ["KHR_lights_punctual"]
    tilt = [SIN45, 0, 0, SIN45]  # a quarter turn about x: -z goes to +y
    nodes = [w.node(extensions={"KHR_lights_punctual": {"light": k}}, translation=[k, 0, 0]) for k in range(5)]
    w.tree["nodes"][nodes[1]]["rotation"] = tilt
    w.tree["nodes"][nodes[2]].update(rotation=tilt, scale=[1, 1, 5], name="sun")
    scene = load(w.scene(w.node(mesh=w.triangle()), *nodes), tmp_path)
    point, spot, sun, wrong = scene.lights
    assert (point.name, point.kind, point.intensity, point.range) == ("lamp", "point", (40.0, 20.0, 0.0), 7.0)
    assert (spot.kind, spot.inner_cone, spot.outer_cone, spot.position) == ("spot", 0.25, 0.5, (1.0, 0.0, 0.0))
    assert np.allclose(spot.direction, [0, 1, 0]) and spot.intensity == (1.0, 1.0, 1.0) and spot.range == 0.0
    assert sun.name == "sun" and np.allclose(sun.direction, [0, 1, 0], atol=1e-12) and sun.intensity == (3.0, 3.0, 3.0)
    assert (wrong.inner_cone, wrong.outer_cone) == (0.0, math.pi / 4)
    assert scene.warnings == (
        "light 3 is left out: its type area is not known",
        "light 4: its cones 0.5 and 0.25 are not 0 <= inner < outer <= pi/2: taken as 0 and pi/4",
    )


# --- what is not done is named -----------------------------------------------------------------


def test_skins_animations_and_morph_targets_are_warned_of(tmp_path):
    w = GltfWriter()
    mesh = w.triangle(targets=[{"POSITION": 0}])
    w.tree["skins"] = [{"joints": [0]}]
    w.tree["animations"] = [{}, {}]
    scene = load(w.scene(w.node(mesh=mesh, skin=0), w.node(mesh=mesh)), tmp_path)
    assert scene.warnings == (
        "morph targets are not applied: 1 primitive",
        "skins are not applied, the bind pose is shown: 1 node",
        "animations are not played, the rest pose is shown: 2",
    )


def test_extensions_are_warned_of_or_refused(tmp_path):
    w = lone(lambda w: w.triangle())
    w.tree["extensionsUsed"] = ["KHR_mesh_quantization", "EXT_something"]
    w.tree["extensionsRequired"] = ["KHR_mesh_quantization", "KHR_texture_basisu"]
    w.tree["nodes"][0]["extensions"] = {"MSFT_lod": {"ids": []}}
    assert load(w, tmp_path).warnings == tuple(
        f"the extension {name} is not supported: shown without it"
        for name in ("EXT_something", "KHR_texture_basisu", "MSFT_lod")
    )
    for name, mend in (("KHR_draco_mesh_compression", "decompress"), ("EXT_meshopt_compression", "decompress"),
                       ("CESIUM_RTC", "export the file without it")):  # fmt: skip
        w.tree["extensionsRequired"] = [name]
        with pytest.raises(SceneError, match=f"{name}.*{mend}"):
            load(w, tmp_path)


def test_draco_without_its_being_required(tmp_path):
    w = lone(lambda w: w.triangle(extensions={"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {}}}))
    assert load(w, tmp_path).triangle_count == 1, "the uncompressed copy is used"
    del w.tree["accessors"][0]["bufferView"]
    with pytest.raises(SceneError, match="compressed with KHR_draco_mesh_compression: decompress the file first"):
        load(w, tmp_path)


# --- containers --------------------------------------------------------------------------------


def test_json_with_data_uri_and_external_buffer(tmp_path):
    w = lone(lambda w: w.triangle())
    (tmp_path / "my bin").mkdir()
    (tmp_path / "my bin" / "a.bin").write_bytes(w.blob)
    encoded = base64.b64encode(w.blob).decode()
    for uri in ("my%20bin/a.bin", "data:application/octet-stream;base64," + encoded):
        w.tree["buffers"] = [{"byteLength": len(w.blob), "uri": uri}]
        path = tmp_path / "scene.gltf"
        path.write_text(json.dumps(w.tree))
        assert corners(load_gltf(path))[0].tolist() == TRIANGLE


@pytest.mark.parametrize("uri, reason", [
    ("gone.bin", "missing"), ("../out.bin", "outside"), ("in/../../out.bin", "outside"), ("%2e%2e/out.bin", "outside"),
    ("link.bin", "outside"), ("/etc/passwd", "absolute"), ("%2Fetc/passwd", "absolute"), ("file:///etc/passwd", "URL"),
    ("http://127.0.0.1:9/a.bin", "URL"), ("C:/a.bin", "URL or a drive"), ("//host/a.bin", "absolute"),
    ("", "no file name"), ("data:;base64,AAA", "no base64"), ("data:AAAA", "comma"),
])  # fmt: skip
def test_buffers_come_from_below_the_scenes_folder(tmp_path, uri, reason):
    folder = tmp_path / "home"
    (folder / "in").mkdir(parents=True)
    w = lone(lambda w: w.triangle())
    (tmp_path / "out.bin").write_bytes(w.blob)
    (folder / "link.bin").symlink_to(tmp_path / "out.bin")
    w.tree["buffers"] = [{"byteLength": len(w.blob), "uri": uri}]
    (folder / "scene.gltf").write_text(json.dumps(w.tree))
    with pytest.raises(SceneError, match=reason) as caught:
        load_gltf(folder / "scene.gltf")
    assert str(caught.value).startswith("scene.gltf: buffer 0: ") and "\n" not in str(caught.value)


def test_no_such_file(tmp_path):
    with pytest.raises(InputNotFoundError, match="no such file"):
        load_gltf(tmp_path / "gone.glb")


def test_node_cycles_are_skipped(tmp_path):
    w = GltfWriter()
    node = w.node(mesh=w.triangle(), children=[0])
    scene = load(w.scene(node), tmp_path)
    assert scene.triangle_count == 1 and scene.warnings == ("node 0 is its own ancestor: skipped there",)
    shared = GltfWriter()
    leaf = shared.node(mesh=shared.triangle())
    assert load(shared.scene(leaf, leaf), tmp_path).triangle_count == 2, "shared, but no cycle"
