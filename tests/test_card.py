"""Scene cards: placing in float64, materials, lights, cameras, and mistakes that name the key and the mend."""

from __future__ import annotations

import importlib.util
import math
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from mesh_writer import SHARED, ascii_ply, binary_ply

from clrast.errors import InputNotFoundError, SceneError
from clrast.scene.load import load
from clrast.scene.model import Material, Scene
from clrast.scene.shapes import box, icosphere, plane, sphere

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT / "data"
TRIANGLE = "[[mesh]]\nvertices = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]\ntriangles = [[0, 1, 2]]\n"
CORNERS = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]


def load_card(folder: Path, text: str, **files: bytes) -> Scene:
    """Load a card; `files` are others beside it, by name with __ for the dot."""
    for name, content in files.items():
        (folder / name.replace("__", ".")).write_bytes(content)
    path = folder / "card.toml"
    path.write_text(text)
    return load(path)


def refuse(folder: Path, text: str, what: str) -> str:
    with pytest.raises(SceneError, match=what) as caught:
        load_card(folder, text)
    message = str(caught.value)
    assert message.startswith(f"{folder / 'card.toml'}: ") and "\n" not in message
    return message


def test_the_smallest_card(tmp_path):
    scene = load_card(tmp_path, TRIANGLE)
    assert scene.positions.tolist() == CORNERS and scene.triangles.tolist() == [[0, 1, 2]]
    assert scene.materials == (Material(double_sided=True),) and scene.name == "card"
    assert scene.image_size is None and scene.render_options == {} and scene.cameras == () and scene.lights == ()


def test_scale_then_turn_then_move(tmp_path):
    text = TRIANGLE + (
        "scale = [2, 3, 5]\ntranslate = [10, 20, 30]\n"
        "rotate = [{ axis = [0, 0, 2], degrees = 90 }, { axis = [1, 0, 0], degrees = -270 }]\n"
    )
    # (1,0,0) -> (2,0,0) -> z by 90: (0,2,0) -> x by 90: (0,0,2);  (0,1,0) -> (0,3,0) -> (-3,0,0) -> (-3,0,0)
    expected = [[10, 20, 30], [10, 20, 32], [7, 20, 30]]
    assert load_card(tmp_path, text).positions.tolist() == expected
    matrix = "matrix = [0, -3, 0, 10, 0, 0, -5, 20, 2, 0, 0, 30, 0, 0, 0, 1]\n"
    assert load_card(tmp_path, TRIANGLE + matrix).positions.tolist() == expected
    third = load_card(tmp_path, TRIANGLE + "scale = 3\nrotate = { axis = [1, 1, 1], degrees = 120 }\n")
    assert third.positions == pytest.approx(np.array([[0, 0, 0], [0, 3, 0], [0, 0, 3]]), abs=1e-6)


def test_a_mesh_file_is_placed_before_its_one_rounding(tmp_path):
    # 0.1 and 1/3 are no float32 numbers: rounding the file first would give another sum
    rows = [(0.1, 0, 0), ("0.333333333333333333", 0, 0), (0, 1, 0)]
    text = '[[mesh]]\nfile = "a.ply"\nscale = 3\ntranslate = [16777216.5, 0, 0]\n'
    scene = load_card(tmp_path, text, a__ply=ascii_ply(rows, [(0, 1, 2)]))
    expected = [np.float32(3 * 0.1 + 16777216.5), np.float32(3 * (1 / 3) + 16777216.5)]
    assert scene.positions[:2, 0].tolist() == expected
    near = load_card(tmp_path, '[[mesh]]\nfile = "a.ply"\nscale = 3\ntranslate = [-0.3, 0, 0]\n')
    # 3 * 0.1 - 0.3 is 5.55e-17 in float64; from float32(0.1) it would be 4.5e-9
    assert near.positions[0, 0] == np.float32(3 * 0.1 - 0.3) and abs(near.positions[0, 0]) < 1e-16


def test_a_mirror_keeps_the_order_and_turns_normals_with_the_surface(tmp_path):
    text = TRIANGLE + "normals = [[0, 3, 4], [0, 0, 1], [1, 0, 0]]\nscale = [-1, 2, 1]\n"
    scene = load_card(tmp_path, text)
    assert scene.positions[scene.triangles[0]].tolist() == [[0, 0, 0], [-1, 0, 0], [0, 2, 0]]
    # inverse transpose of diag(-1, 2, 1): (0, 0.6/2, 0.8) made unit, (0, 0, 1), (-1, 0, 0)
    slant = np.array([0, 0.3, 0.8]) / math.sqrt(0.73)
    assert scene.normals == pytest.approx(np.array([slant, [0, 0, 1], [-1, 0, 0]]), abs=1e-7)


def test_triangles_count_through_and_what_a_mesh_lacks_is_neutral(tmp_path):
    text = '[[mesh]]\nname = "first"\nfile = "sub/b.ply"\n' + TRIANGLE + (
        "uv = [[0, 1], [1, 1], [0, 0.5]]\ncolors = [[1, 0, 0], [0, 1, 0, 0.5], [0, 0, 1]]\n"
        "normals = [[0, 0, 2], [0, 0, 1], [0, 0, 1]]\n"
        '[[mesh]]\nshape = "plane"\n'
    )
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "b.ply").write_bytes(binary_ply(CORNERS, [(2, 1, 0), (0, 1, 2)]))
    scene = load_card(tmp_path, text)
    assert scene.triangles.tolist() == [[2, 1, 0], [0, 1, 2], [3, 4, 5], [6, 7, 8], [6, 8, 9]]
    assert scene.object_ids.tolist() == [0, 0, 1, 2, 2]
    assert scene.object_names == ("first", "mesh[1]", "plane")
    assert scene.uv[:6].tolist() == [[0, 0]] * 3 + [[0, 1], [1, 1], [0, 0.5]]
    assert scene.colors[2:6].tolist() == [[1, 1, 1, 1], [1, 0, 0, 1], [0, 1, 0, 0.5], [0, 0, 1, 1]]
    assert scene.normals[:4].tolist() == [[0, 0, 0]] * 3 + [[0, 0, 1]]


OBJ = b"mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\no x\nusemtl m\nf 1 2 3\no y\nusemtl n\nf 3 2 1\n"
MTL = b"newmtl m\nKd 1 0 0\nnewmtl n\nKd 0 1 0\n"


def test_materials_of_the_card_take_the_place_of_the_files(tmp_path):
    text = (
        '[[material]]\nname = "plain"\nbase_color = [0.1, 0.2, 0.3]\nroughness = 0.5\nemissive = [0, 2, 0]\n'
        '[[mesh]]\nfile = "a.obj"\n[[mesh]]\nname = "p"\nfile = "a.obj"\nmaterial = "plain"\n'
        '[[mesh]]\nname = "q"\nfile = "a.obj"\n'
    )
    scene = load_card(tmp_path, text, a__obj=OBJ, a__mtl=MTL)
    assert [m.name for m in scene.materials] == ["plain", "m", "n"]
    assert scene.material_ids.tolist() == [1, 2, 0, 0, 1, 2]
    plain = scene.materials[0]
    assert plain.base_color == (0.1, 0.2, 0.3, 1.0) and plain.emissive == (0, 2, 0) and plain.roughness == 0.5
    assert scene.object_names == ("a/x", "a/y", "p/x", "p/y", "q/x", "q/y")


def test_every_field_of_a_material(tmp_path):
    shutil.copy(DATA / "textures" / "checker.png", tmp_path / "t.png")
    text = TRIANGLE + 'material = "m"\n' + (
        '[[material]]\nname = "m"\nmetallic = 0.25\nalpha_mode = "MASK"\nalpha_cutoff = 0.75\ndouble_sided = false\n'
        'unlit = true\ntransmission = 0.5\nior = 1.25\nemissive_texture = "t.png"\n'
        'base_color_texture = { file = "t.png", scale = [2, 3], offset = [0.25, 0.5], wrap = ["clamp", "mirror"], '
        "nearest = true, uv_set = 1 }\n"
    )
    material = (scene := load_card(tmp_path, text)).materials[0]
    assert material.base_color == (1, 1, 1, 1) and material.emissive == (1, 1, 1)
    assert (material.metallic, material.alpha_mode, material.alpha_cutoff) == (0.25, "MASK", 0.75)
    assert not material.double_sided and material.unlit and (material.transmission, material.ior) == (0.5, 1.25)
    use = material.base_color_texture
    assert use.transform == (2, 0, 0.25, 0, 3, 0.5) and use.nearest and use.uv_set == 1
    assert (use.wrap_u, use.wrap_v) == ("clamp", "mirror")
    assert len(scene.textures) == 1 and material.emissive_texture.texture == use.texture == 0


def test_lights_and_cameras(tmp_path):
    text = TRIANGLE + (
        '[[light]]\nkind = "point"\nposition = [1, 2, 3]\ncolor = [1, 0.5, 0]\nintensity = 8\nrange = 5\n'
        '[[light]]\nname = "s"\nkind = "spot"\nposition = [0, 4, 0]\nlook_at = [3, 0, 0]\n'
        "inner_cone = 30\nouter_cone = 60\n"
        '[[light]]\nkind = "directional"\ndirection = [0, -2, 0]\n'
        "[[camera]]\neye = [0, 0, 5]\nfov = 90\n"
        '[[camera]]\nname = "o"\nprojection = "orthographic"\neye = [0, 5, 0]\nup = [0, 0, -1]\nheight = 3\n'
    )
    scene = load_card(tmp_path, text)
    point, spot, sun = scene.lights
    assert point.intensity == (8, 4, 0) and point.position == (1, 2, 3) and point.range == 5 and point.name == "light0"
    assert spot.direction == pytest.approx((0.6, -0.8, 0)) and spot.name == "s"
    assert (spot.inner_cone, spot.outer_cone) == pytest.approx((math.pi / 6, math.pi / 3))
    assert sun.kind == "directional" and sun.direction == (0, -1, 0)
    view, ortho = scene.cameras
    assert (view.name, view.eye, view.look_at, view.fov) == ("camera0", (0, 0, 5), (0, 0, 0), 90)
    assert (ortho.name, ortho.projection, ortho.up, ortho.height) == ("o", "orthographic", (0, 0, -1), 3)


def test_image_and_render_options(tmp_path):
    text = (
        "name = 'n'\n[image]\nsize = [640, 480]\n[render]\nprecision = 'exact'\naov = ['id', 'depth']\nseed = 7\n"
        "shading_rate = 'pixel'\neffects = { alpha_mask = false, textures = 'auto' }\n" + TRIANGLE
    )
    scene = load_card(tmp_path, text)
    assert scene.image_size == (640, 480) and scene.name == "n"
    assert scene.render_options == {
        "precision": "exact", "aov": "id,depth", "seed": "7", "shading-rate": "pixel",
        "effects": "alpha_mask=off,textures=auto",
    }  # fmt: skip


def test_smooth_on_off_and_as_the_file_has_it(tmp_path):
    ball = '[[mesh]]\nshape = "icosphere"\nsubdivisions = {}\n'
    exact, flat = (load_card(tmp_path, ball.format(2) + more) for more in ("", "smooth = false\n"))
    assert exact.normals == pytest.approx(2 * exact.positions, abs=1e-6)
    assert flat.normals is None
    # the five faces round a corner of an icosahedron are alike: their mean is the sphere's own normal
    mean = load_card(tmp_path, ball.format(0) + "smooth = true\n")
    assert mean.normals == pytest.approx(2 * mean.positions, abs=1e-6)


def test_a_gltf_brings_its_lights_and_cameras_and_they_are_placed_with_it(tmp_path):
    if not SHARED.exists():
        pytest.skip(f"{SHARED} is not there")
    shutil.copy(SHARED / "gltf" / "Lights.glb", tmp_path / "a.glb")
    alone = load(tmp_path / "a.glb")
    text = TRIANGLE + "[[camera]]\neye = [0, 0, 9]\n[[mesh]]\nfile = 'a.glb'\n" + (
        "rotate = { axis = [0, 1, 0], degrees = 90 }\ntranslate = [0, 10, 0]\nscale = 2\n"
    )
    scene = load_card(tmp_path, text)

    def placed(p):  # y by 90 degrees takes x to -z and z to x
        return (2 * p[2], 2 * p[1] + 10, -2 * p[0])

    assert [light.name for light in scene.lights] == [light.name for light in alone.lights]
    for light, before in zip(scene.lights, alone.lights, strict=True):
        assert light.position == pytest.approx(placed(before.position), abs=1e-12)
        d = before.direction
        assert light.direction == pytest.approx((d[2], d[1], -d[0]), abs=1e-12)
        assert light.intensity == before.intensity
    assert [camera.name for camera in scene.cameras][1:] == [camera.name for camera in alone.cameras]
    assert scene.cameras[1].eye == pytest.approx(placed(alone.cameras[0].eye))
    expected = [placed(p) for p in alone.positions.astype(np.float64)]
    assert scene.positions[3:] == pytest.approx(np.array(expected), rel=1e-6, abs=1e-6)


MISTAKES = [
    ("", "mesh is missing"),
    ("mesh = []\n", "mesh is .*at least 1 item"),
    ("[[mesh]]\n", r"mesh\[0\]: needs one of file, shape or vertices, has none"),
    (TRIANGLE + 'shape = "box"\n', r"mesh\[0\]: needs one of .*shape and vertices"),
    (TRIANGLE + 'materal = "x"\n', r'mesh\[0\].materal is no key of a card: did you mean "material"\? \(allowed: '),
    (TRIANGLE + "[imge]\nsize = [1, 1]\n", 'imge is no key of a card: did you mean "image"'),
    (TRIANGLE + "[image]\nsize = [0, 1]\n", r"image.size\[0\] is 0, it should be greater than or equal to 1: mend it"),
    (TRIANGLE + "[image]\nsize = [640]\n", "image.size is .*at least 2 items"),
    (TRIANGLE + "[render]\nprecission = 'fast'\n", 'render.precission .* did you mean "precision"'),
    (TRIANGLE + 'scale = "big"\n', r"mesh\[0\].scale is 'big', it should be a valid list"),
    (TRIANGLE + "scale = [1, 2]\n", r"mesh\[0\].scale is \[1, 2\], it .*at least 3 items"),
    (TRIANGLE + "translate = [0, nan, 0]\n", r"mesh\[0\].translate\[1\] is nan, it should be a finite number"),
    (TRIANGLE + "rotate = { axis = [0, 0, 0], degrees = 3 }\n", r"rotate\[0\]: axis is 0, 0, 0: give a direction"),
    (TRIANGLE + "rotate = { axs = [0, 0, 1], degrees = 3 }\n", r"mesh\[0\].rotate\[0\].ax(i)?s"),
    (TRIANGLE + "matrix = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 0, 0, 1]\n", "matrix is row by row"),
    (TRIANGLE + "scale = 2\nmatrix = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\n", "keep one or the others"),
    (TRIANGLE + "rings = 3\n", "rings does not go with vertices"),
    ('[[mesh]]\nshape = "bax"\n', "mesh.0..shape is 'bax', it should be 'plane', 'box', 'sphere' or 'icosphere'"),
    ('[[mesh]]\nshape = "icosphere"\nsubdivisions = 20\n', "subdivisions is 20, it should be less than or equal to 8"),
    ('[[mesh]]\nshape = "icosphere"\nsubdivisions = 1.5\n', "subdivisions is 1.5, it should be a valid integer"),
    ("[[mesh]]\nvertices = [[0, 0, 0]]\n", "vertices need triangles"),
    (TRIANGLE.replace("[0, 1, 2]]", "[0, 1, 3]]"), r"triangles\[0\] has index 3, there are 3 vertices"),
    (TRIANGLE.replace("[0, 1, 2]]", "[0, 1, -1]]"), r"triangles\[0\]\[2\] is -1"),
    (TRIANGLE + "uv = [[0, 0]]\n", "uv has 1 rows, there are 3 vertices"),
    (TRIANGLE + 'material = "rad"\n[[material]]\nname = "red"\n', 'material is "rad", .* did you mean "red"'),
    (TRIANGLE + '[[material]]\nname = "a"\n' * 2, r'material\[1\].name is "a", as that of material\[0\]'),
    (TRIANGLE + "[[material]]\nroughness = 1\n", r"material\[0\].name is missing"),
    (TRIANGLE + '[[material]]\nname = "a"\nroughness = 2\n', "roughness is 2, it should be less than or equal to 1"),
    (TRIANGLE + '[[material]]\nname = "a"\nalpha_mode = "mask"\n', "'OPAQUE', 'MASK' or 'BLEND'"),
    (TRIANGLE + '[[material]]\nname = "a"\nbase_color_texture = "no.png"\n', 'base_color_texture: "no.png" is missing'),
    (TRIANGLE + '[[material]]\nname = "a"\nbase_color_texture = "../x.png"\n', "outside the scene's folder"),
    (TRIANGLE + '[[light]]\nkind = "area"\n', "kind is 'area', it should be 'point', 'spot' or 'directional'"),
    (TRIANGLE + '[[light]]\nkind = "point"\n', "a point light needs a position"),
    (TRIANGLE + '[[light]]\nkind = "directional"\n', "needs direction or look_at"),
    (TRIANGLE + '[[light]]\nkind = "spot"\nposition = [0, 0, 0]\nlook_at = [0, 0, 0]\n', "shines nowhere"),
    (TRIANGLE + '[[light]]\nkind = "directional"\ndirection = [1, 0, 0]\ninner_cone = 60\n', "smaller than outer_cone"),
    (TRIANGLE + "[[camera]]\nlook_at = [0, 0, 0]\n", r"camera\[0\].eye is missing"),
    (TRIANGLE + "[[camera]]\neye = [0, 0, 0]\n", r"camera\[0\]: .*eye equals look-at"),
    (TRIANGLE + "[[camera]]\neye = [0, 5, 0]\n", r"camera\[0\]: .*parallel to the view"),
    (TRIANGLE + "[[camera]]\neye = [0, 0, 5]\nfov = 180\n", "fov is 180, it should be less than 180"),
    (TRIANGLE + "[[camera]]\neye = [0, 0, 5]\nfovv = 3\n", 'camera.0..fovv .* did you mean "fov"'),
    ('[[mesh]]\nfile = "no.ply"\n', r'mesh\[0\].file: "no.ply" is missing'),
    ('[[mesh]]\nfile = "/etc/passwd"\n', r"mesh\[0\].file: .*is absolute"),
    ('[[mesh]]\nfile = "card.toml"\n', "a card holds no cards"),
    ('[[mesh]]\nfile = "bad.ply"\n', r"mesh\[0\].file: bad.ply: face 0 has vertex index 9"),
    ('[[mesh]]\nfile = "empty.ply"\n', r"mesh\[0\].file: empty.ply: no triangle"),
    (TRIANGLE + TRIANGLE + "x = 1\n", r"mesh\[1\].x is no key of a card: leave it out"),
    ("[[mesh]\n", "is no TOML: .*line 1"),
    ("a = " + "[" * 100000, "is no TOML|nested too deep"),
    ("a = " + "9" * 5000, "is no TOML|no key of a card"),
    ("mesh = 3\n", "mesh is 3, it should be a valid list"),
]


@pytest.mark.parametrize(("text", "what"), MISTAKES)
def test_a_mistake_names_the_key_and_the_mend(tmp_path, text, what):
    (tmp_path / "bad.ply").write_bytes(ascii_ply(CORNERS, [(0, 1, 9)]))
    (tmp_path / "empty.ply").write_bytes(ascii_ply(CORNERS, []))
    assert len(refuse(tmp_path, text, what)) < 600


def test_other_ways_to_be_no_card(tmp_path):
    path = tmp_path / "card.toml"
    path.write_bytes(b"name = '\xff'\n")
    with pytest.raises(SceneError, match="not UTF-8 at byte 8"):
        load(path)
    with path.open("wb") as file:
        file.truncate(1 << 30)
    with pytest.raises(SceneError, match="a card at most"):
        load(path)
    with pytest.raises(InputNotFoundError):
        load(tmp_path / "none.toml")


def test_a_scene_that_leaves_float32_is_refused(tmp_path):
    refuse(tmp_path, TRIANGLE.replace("[1, 0, 0]", "[1e20, 0, 0]") + "scale = 1e20\n", "vertex 1 .* is beyond float32")


def test_thousands_of_placements_share_one_file_and_are_bounded(tmp_path, monkeypatch):
    import clrast.scene.card as card

    monkeypatch.setattr(card, "MAX_TRIANGLES", 100)
    text = '[[mesh]]\nshape = "box"\n' * 9
    refuse(tmp_path, text, "its meshes have 108 triangles, at most 100")
    assert load_card(tmp_path, '[[mesh]]\nshape = "box"\n' * 8).triangle_count == 96


@pytest.mark.parametrize(
    ("shape", "triangle_count", "volume"),
    [
        (box(), 12, 1.0),
        (icosphere(0), 20, None),
        (icosphere(3), 1280, None),
        (sphere(7, 5), 2 * 7 * 4, None),
        (sphere(96, 48), 2 * 96 * 47, None),
    ],
)
def test_shapes_are_closed_and_turned_outwards(shape, triangle_count, volume):
    triangles, positions = shape.triangles.astype(int), shape.positions
    assert len(triangles) == triangle_count
    a, b, c = positions[triangles[:, 0]], positions[triangles[:, 1]], positions[triangles[:, 2]]
    inside = (np.cross(a, b) * c).sum() / 6
    if volume is not None:
        assert inside == pytest.approx(volume)
    else:
        # between a sphere of the insphere's radius and the sphere itself
        distances = (np.cross(b - a, c - a) * a).sum(axis=1) / np.linalg.norm(np.cross(b - a, c - a), axis=1)
        assert math.pi / 6 * (2 * distances.min()) ** 3 < inside < math.pi / 6
        assert np.linalg.norm(positions, axis=1) == pytest.approx(np.full(len(positions), 0.5))
    edges: dict = {}
    places = [tuple(p) for p in (positions + 0.0).tolist()]
    for t in triangles:
        for i in range(3):
            edge = (places[t[i]], places[t[(i + 1) % 3]])
            assert edge not in edges
            edges[edge] = 1
    assert all((q, p) in edges for p, q in edges)  # bit for bit the same places on both sides


def test_plane_faces_up_and_uv_grows_along_x_and_z():
    shape = plane()
    a, b, c = shape.positions[shape.triangles[0]]
    assert np.cross(b - a, c - a)[1] > 0
    assert shape.uv.tolist() == (shape.positions[:, [0, 2]] + 0.5).tolist()


def make_data():
    spec = importlib.util.spec_from_file_location("make_data", ROOT / "tools" / "make_data.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_data_files_are_what_the_tool_writes():
    for name, content in make_data().make_files().items():
        assert (DATA / name).read_bytes() == content, f"{name}: run tools/make_data.py"


@pytest.mark.parametrize("path", sorted(DATA.glob("*.toml")), ids=lambda path: path.name)
def test_each_card_of_data_loads_without_a_warning(path):
    scene = load(path)
    assert scene.triangle_count and not scene.warnings and scene.cameras and scene.image_size


def test_data_is_small_and_the_demo_has_some_of_everything():
    assert sum(p.stat().st_size for p in DATA.rglob("*") if p.suffix != ".exr") < 3_500_000
    room = load(DATA / "room.toml")
    assert {light.kind for light in room.lights} == {"point", "spot", "directional"}
    assert {m.alpha_mode for m in room.materials} == {"OPAQUE", "MASK", "BLEND"}
    assert [c.name for c in room.cameras] == ["outside", "inside", "plan"]
    assert room.colors is not None and room.uv is not None and len(room.textures) == 2
    assert load(DATA / "icosphere.toml").triangle_count == 5120


def test_the_hub_of_the_fan_is_at_the_centre_of_a_pixel():
    from clrast.scene.camera import camera_vectors

    scene = load(DATA / "fan.toml")
    view = camera_vectors(scene.cameras[0], *scene.image_size)
    first, dx, dy = (np.array(v) for v in (view.first, view.tangent_x, view.tangent_y))
    d = first + 32.5 * dx + 32.5 * dy  # exact: multiples of 1/64
    assert scene.positions[0].tolist() == (4.0 * d).tolist()
    hubs = scene.triangles[:, 0]
    assert (hubs == 0).all() and scene.triangles[:, 2].tolist() == [*scene.triangles[1:, 1].tolist(), 1]


def test_the_example_of_the_readme_is_a_card(tmp_path):
    text = re.search(r"```toml\n(.*?)```", (DATA / "README.md").read_text(), re.S).group(1)
    shutil.copytree(DATA / "meshes", tmp_path / "meshes")
    shutil.copytree(DATA / "textures", tmp_path / "textures")
    scene = load_card(tmp_path, text)
    assert scene.triangle_count == 5120 + 12 + 1 and scene.name == "example"
    assert scene.positions[:2562].min(axis=0) == pytest.approx([-1, 0, -1], abs=1e-2)  # a ball of radius 1 at y = 1
