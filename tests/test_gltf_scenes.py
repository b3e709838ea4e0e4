"""The shared glTF files against the table in SCENES.md, and against what is true where that differs."""

from __future__ import annotations

import json
import re
import shutil
import struct
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from clrast.errors import SceneError
from clrast.scene.gltf import load_gltf
from clrast.scene.load import load

SHARED = Path(__file__).resolve().parents[2] / "shared" / "scenes"

# True maxima where SCENES.md says that trimesh is wrong, and files whose box is worked out in a test below.
TRUE_BOXES = {"gltf/SimpleSparseAccessor/SimpleSparseAccessor.gltf": ([0, 0, 0], [6, 4, 0])}
TRUE_COUNTS = {"gltf/simple-instancing.glb": 125 * 12}
BOXES_ELSEWHERE = {"gltf/simple-instancing.glb"}
FAR_TILE = "nasty/huge_coordinates_ecef.glb"
FANS = {"gltf/PrimitiveModes/Mesh_PrimitiveMode_05.gltf": (2, [-0.5, -0.5, 0], [0.5, 0.5, 0])}
REFUSED = {
    "gltf/PrimitiveModes/Mesh_PrimitiveMode_00.gltf": "points are not drawn",
    "gltf/PrimitiveModes/Mesh_PrimitiveMode_01.gltf": "lines are not drawn",
    "gltf/PrimitiveModes/Mesh_PrimitiveMode_02.gltf": "line loops are not drawn",
    "gltf/PrimitiveModes/Mesh_PrimitiveMode_03.gltf": "line strips are not drawn",
    "nasty/Box_Draco.glb": "KHR_draco_mesh_compression: decompress the file first",
    "nasty/IndexOutOfRange/IndexOutOfRange.gltf": "index 255 is out of range, there are 24 vertices",
    "nasty/MissingBin.gltf": '"BoxTextured0.bin" is missing',
    "nasty/RecursiveNodes.gltf": "no triangle in the default scene .*its own ancestor",
    "nasty/truncated_chunk_data.glb": "cut short",
}


def table() -> dict[str, tuple[int, list[float] | None, list[float] | None]]:
    """(placed triangles, box minimum, box maximum) by file, of the glTF rows of SCENES.md."""
    rows = {}
    if not (SHARED / "SCENES.md").is_file():
        return rows
    for line in (SHARED / "SCENES.md").read_text().splitlines():
        cells = [cell.strip() for cell in line.split("|")]
        if len(cells) < 6 or not re.fullmatch(r"`[^`]+\.(glb|gltf)`", cells[1]):
            continue
        numbers = [int(text.replace(",", "")) for text in re.findall(r"[\d,]+", cells[3])]
        box = [[float(x) for x in part.split()] for part in re.findall(r"\[([^\]]*)\]", cells[4])]
        rows[cells[1].strip("`")] = (numbers[-1] if numbers else 0, *(box or (None, None)))
    return rows


ROWS = table()
needs_scenes = pytest.mark.skipif(not ROWS, reason=f"the shared scenes are not at {SHARED}")


@needs_scenes
def test_the_table_names_every_file():
    files = {str(p.relative_to(SHARED)) for pattern in ("*.glb", "*.gltf") for p in SHARED.rglob(pattern)}
    assert files == set(ROWS) and len(files) > 30


@needs_scenes
@pytest.mark.parametrize("name", sorted(set(ROWS) - set(REFUSED)))
def test_counts_and_boxes(name):
    count, low, high = FANS.get(name, ROWS[name])
    scene = load_gltf(SHARED / name)
    assert scene.triangle_count == TRUE_COUNTS.get(name, count)
    if name not in BOXES_ELSEWHERE:
        low, high = TRUE_BOXES.get(name, (low, high))
        largest = max(map(abs, low + high))
        # The table has 5 digits, of float32 world positions: half a digit, and half a float32 step.
        assert np.allclose(scene.bounding_box(), (low, high), rtol=0, atol=largest * (5e-5 + 2**-24))
    check_consistent(scene)


@needs_scenes
@pytest.mark.parametrize("name", sorted(REFUSED))
def test_broken_files_are_refused_in_one_line(name):
    with pytest.raises(SceneError, match=REFUSED[name]) as caught:
        load_gltf(SHARED / name)
    assert "\n" not in str(caught.value) and str(caught.value).startswith(Path(name).name)


def check_consistent(scene):
    """What every Scene promises."""
    assert scene.positions.dtype == np.float32 and scene.triangles.dtype == np.uint32
    assert scene.object_ids.dtype == np.uint32 and scene.material_ids.dtype == np.uint32
    assert scene.triangles.max() < scene.vertex_count and np.isfinite(scene.positions).all()
    assert scene.object_ids.max() == len(scene.object_names) - 1 and (np.diff(scene.object_ids.astype(int)) >= 0).all()
    assert scene.material_ids.max() < len(scene.materials)
    for material in scene.materials:
        for use in (material.base_color_texture, material.emissive_texture):
            assert use is None or use.texture < len(scene.textures)
    if scene.normals is not None:
        lengths = np.sqrt((scene.normals.astype(float) ** 2).sum(axis=1))
        assert ((abs(lengths - 1) < 1e-6) | (lengths == 0)).all()


@needs_scenes
def test_instances_against_their_numbers_in_the_file():
    """125 unit cubes: each box must be the cube moved, turned and scaled by the file's own numbers."""
    content = (SHARED / "gltf/simple-instancing.glb").read_bytes()
    size = struct.unpack_from("<I", content, 12)[0]
    tree, blob = json.loads(content[20 : 20 + size]), content[28 + size :]
    attributes = tree["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]

    def values(key, width):
        accessor = tree["accessors"][attributes[key]]
        start = tree["bufferViews"][accessor["bufferView"]].get("byteOffset", 0) + accessor.get("byteOffset", 0)
        return np.frombuffer(blob, "<f4", 125 * width, start).reshape(125, width).astype(float)

    scene = load_gltf(SHARED / "gltf/simple-instancing.glb")
    corners = scene.positions[scene.triangles].reshape(125, 36, 3).astype(float)
    centre = (corners.min(axis=1) + corners.max(axis=1)) / 2
    q, s, t = values("ROTATION", 4), values("SCALE", 3), values("TRANSLATION", 3)
    half = s / 2  # the cube's centre, in its own scaled space; turned by q v q*
    turned = half + 2 * np.cross(q[:, :3], np.cross(q[:, :3], half) + q[:, 3:] * half)
    assert np.allclose(centre, t + turned, atol=1e-5)
    assert len(scene.object_names) == 125 and np.ptp(s) > 0 and np.ptp(q) > 0


def far_vertices() -> list[list[Fraction]]:
    """World positions of the earth-centred tile in exact arithmetic."""
    content = (SHARED / FAR_TILE).read_bytes()
    size = struct.unpack_from("<I", content, 12)[0]
    tree, blob = json.loads(content[20 : 20 + size]), content[28 + size :]
    (node,) = tree["nodes"]
    accessor = tree["accessors"][tree["meshes"][node["mesh"]]["primitives"][0]["attributes"]["POSITION"]]
    view = tree["bufferViews"][accessor["bufferView"]]
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    local = np.frombuffer(blob, "<f4", accessor["count"] * 3, start).reshape(-1, 3).tolist()
    m = [Fraction(value) for value in node["matrix"]]
    return [[sum(m[4 * j + k] * Fraction(v[j]) for j in range(3)) + m[12 + k] for k in range(3)] for v in local]


def check_rounded_once(scene, exact):
    """Each coordinate within half a float32 step, and what float64 loses on sums of terms below 1e7."""
    assert len(exact) == scene.vertex_count > 50 and scene.positions.dtype == np.float32
    for vertex, found in zip(exact, scene.positions):
        for k in range(3):
            half_step = Fraction(float(np.spacing(abs(found[k])))) / 2
            assert abs(Fraction(float(found[k])) - vertex[k]) <= half_step + Fraction(1, 10**8)


@needs_scenes
def test_far_coordinates_are_rounded_once():
    check_rounded_once(load_gltf(SHARED / FAR_TILE), far_vertices())


@needs_scenes
def test_a_card_brings_far_coordinates_near_before_they_are_rounded(tmp_path):
    """In the file's place float32 steps by 0.25 m and more; recentred, the tile keeps fractions of a millimetre."""
    shutil.copy(SHARED / FAR_TILE, tmp_path / "tile.glb")
    card = tmp_path / "card.toml"
    card.write_text(
        "[[mesh]]\nfile = 'tile.glb'\nscale = [0.5, 0.5, 2]\n"
        "rotate = { axis = [0, 0, 1], degrees = 90 }\ntranslate = [1998300.125, -193215.0625, -9890010.5]\n"
    )
    move = [Fraction(1998300.125), Fraction(-193215.0625), Fraction(-9890010.5)]
    exact = [[-y / 2 + move[0], x / 2 + move[1], 2 * z + move[2]] for x, y, z in far_vertices()]
    scene = load(card)
    assert abs(scene.positions).max() < 2000
    check_rounded_once(scene, exact)


@needs_scenes
def test_arrows_of_the_texture_transform_test_point_at_correct():
    """The dark arrow of each panel, looked up through its transform, must end beside the 'Correct' quad."""
    scene = load_gltf(SHARED / "gltf/TextureTransformTest/TextureTransformTest.gltf")
    names = scene.object_names
    for panel in ("Rotation", "Scale", "All"):
        own = scene.object_ids == names.index(panel)
        target = scene.object_ids == (names.index(panel) + 1)
        vertices = np.unique(scene.triangles[own])
        quad = scene.positions[vertices].astype(float)
        assert scene.uv[vertices].tolist()[np.argmin(quad[:, 0] - quad[:, 1])] == [0, 0], "v = 0 is the top"
        goal = scene.positions[np.unique(scene.triangles[target])].astype(float).mean(axis=0)
        use = scene.materials[int(scene.material_ids[own][0])].base_color_texture
        image = scene.textures[use.texture].texels[:, :, 0]
        # uv is (0, 0) at the quad's top left corner, so uv of the goal follows from its place.
        low, high = quad.min(axis=0), quad.max(axis=0)
        goal_uv = ((goal[0] - low[0]) / (high[0] - low[0]), (high[1] - goal[1]) / (high[1] - low[1]))
        u, v = np.meshgrid((np.arange(200) + 0.5) / 200, (np.arange(200) + 0.5) / 200)
        m = use.transform
        x = np.clip(m[0] * u + m[1] * v + m[2], 0, 0.9999) * image.shape[1]
        y = np.clip(m[3] * u + m[4] * v + m[5], 0, 0.9999) * image.shape[0]
        dark = image[y.astype(int), x.astype(int)] < 80
        start, tip = arrow_ends(u[dark], v[dark])
        angle = np.arctan2(*(tip - start)[::-1]) - np.arctan2(goal_uv[1] - start[1], goal_uv[0] - start[0])
        assert abs(np.degrees((angle + np.pi) % (2 * np.pi) - np.pi)) < 4, f"{panel}: the arrow misses 'Correct'"


def arrow_ends(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Tail and tip of an arrow of dark points that starts near the panel's top left corner."""
    points = np.stack([u, v], axis=1)
    order = np.argsort((points**2).sum(axis=1))
    return points[order[:20]].mean(axis=0), points[order[-5:]].mean(axis=0)


@needs_scenes
def test_what_trimesh_drops_is_read():
    def materials(name):
        return load_gltf(SHARED / "gltf" / name).materials

    box = load_gltf(SHARED / "gltf/CornellBox.glb")
    assert max(max(m.emissive) for m in box.materials) >= 99 and box.colors is not None and box.colors.max() == 1
    lights = load_gltf(SHARED / "gltf/Lights.glb").lights
    assert [light.kind for light in lights] == ["point", "spot", "spot", "directional"]
    assert all(m.unlit for m in materials("UnlitTest/UnlitTest.gltf"))
    assert any(m.transmission > 0 and m.alpha_mode == "BLEND" for m in materials("glass-table.glb"))
    wraps = {m.base_color_texture.wrap_u for m in materials("TextureSettingsTest/TextureSettingsTest.gltf")
             if m.base_color_texture}  # fmt: skip
    assert wraps == {"repeat", "mirror", "clamp"}
    multi = materials("MultiUVTest/MultiUVTest.gltf")[0]
    assert (multi.base_color_texture.uv_set, multi.emissive_texture.uv_set) == (0, 1)
    kinds = [(c.projection, c.fov, c.height) for c in load_gltf(SHARED / "gltf/Cameras/Cameras.gltf").cameras]
    assert kinds[0][0] == "perspective" and abs(kinds[0][1] - 40.1) < 0.1 and kinds[1][0::2] == ("orthographic", 2.0)


@needs_scenes
def test_mirrored_files_keep_vertex_order():
    scene = load_gltf(SHARED / "gltf/mirror_triangle/one_face_123_mirror.gltf")
    listed = np.float32([[1, 0.0999713, 0], [2.000061, 0.01, 0], [3, 0.1099817, 0]])  # in the file's order, scale -1
    assert np.allclose(scene.positions[scene.triangles][0], -listed, atol=1e-6)
    scene = load_gltf(SHARED / "gltf/IrradianceVolumeExample.glb")
    p = scene.positions[scene.triangles].astype(float)
    geometric = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    assert ((geometric * scene.normals[scene.triangles[:, 0]]).sum(axis=1) < 0).all(), "turned inside out"


@needs_scenes
@pytest.mark.parametrize("name", ["2CylinderEngine.glb", "Duck.glb", "OrientationTest.glb", "../sponza.glb"])
def test_triangles_equal_trimeshs(name):
    """The triangles of each placed primitive, in order, are those that another loader places in the world."""
    trimesh = pytest.importorskip("trimesh")
    path = SHARED / "gltf" / name
    other = trimesh.load(path, force="scene", process=False, skip_materials=True)
    scene = load_gltf(path)
    ours = scene.positions[scene.triangles].reshape(-1, 9).astype(float)
    keys = np.stack([scene.object_ids, scene.material_ids], axis=1).astype(int)
    parts = np.split(ours, np.nonzero(np.diff(keys, axis=0).any(axis=1))[0] + 1)
    # Both sides hold float32 vertices under float64 matrices; ours are rounded to float32 at the end.
    tolerance = abs(ours).max() * 2**-23
    for node in other.graph.nodes_geometry:
        matrix, geometry = other.graph[node]
        mesh = other.geometry[geometry]
        corners = (mesh.vertices @ matrix[:3, :3].T + matrix[:3, 3])[mesh.faces].reshape(-1, 9)
        same = [k for k, part in enumerate(parts) if part.shape == corners.shape and np.allclose(
            part, corners, rtol=0, atol=tolerance)]  # fmt: skip
        assert same, f"{node} has no counterpart here"
        parts.pop(same[0])
    assert parts == []
