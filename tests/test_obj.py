"""OBJ and MTL: faces in the order of their lines, indices of every kind, materials, textures, what is said."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from mesh_writer import SHARED

from clrast.errors import SceneError
from clrast.scene.load import load
from clrast.scene.model import Scene

POINTS = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def load_text(folder: Path, text: str, **files: str | bytes) -> Scene:
    """Load an OBJ; `files` are others beside it, by name with __ for the dot."""
    for name, content in files.items():
        (folder / name.replace("__", ".")).write_bytes(content.encode() if isinstance(content, str) else content)
    path = folder / "scene.obj"
    path.write_text(text)
    return load(path)


def corners_of(scene: Scene) -> list:
    return scene.positions[scene.triangles].tolist()


def save_png(path: Path, colors: list[list[tuple[int, int, int]]]) -> None:
    import PIL.Image

    PIL.Image.fromarray(np.array(colors, np.uint8)).save(path)


def test_faces_keep_the_order_of_their_lines_whatever_their_materials_and_objects(tmp_path):
    text = POINTS + (
        "o b\nusemtl red\nf 1 2 3\nusemtl blue\nf 1 2 3 4\no a\nusemtl red\nf 4 3 2\n"
        "o b\nf 2 3 4\nusemtl unused\nusemtl blue\nf 3 4 1\n"
    )
    scene = load_text(tmp_path, text)
    p = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    expected = [(0, 1, 2), (0, 1, 2), (0, 2, 3), (3, 2, 1), (1, 2, 3), (2, 3, 0)]
    assert corners_of(scene) == [[p[i] for i in t] for t in expected]
    assert scene.object_names == ("b", "a") and scene.object_ids.tolist() == [0, 0, 0, 1, 0, 0]
    assert [m.name for m in scene.materials] == ["red", "blue"]
    assert scene.material_ids.tolist() == [0, 1, 1, 0, 0, 1]


def test_relative_indices_count_from_the_line_of_the_face(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nf -3 -2 -1\nv\t0 1 0\nv 0 2 0\nf 3 -2 -1\nf -5 -4 -3 -1\n"
    scene = load_text(tmp_path, text)
    a, b, c, d, e = [0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 2, 0]
    assert corners_of(scene) == [[a, b, c], [c, d, e], [a, b, c], [a, c, e]]


def test_relative_indices_of_texture_coordinates_and_normals_count_their_own_lines(tmp_path):
    text = POINTS + "vt 0 0\nvt 1 0.25\nvn 0 0 2\nf 1/-2/-1 2/-1/-1 3/2/1\n"
    text += "vt 0.5 1\nvn 0 3 4\nf -4/-1/-1 -3/-1/-2 -1/1/1\n"
    scene = load_text(tmp_path, text)
    assert scene.uv[scene.triangles].tolist() == [[[0, 1], [1, 0.75], [1, 0.75]], [[0.5, 0], [0.5, 0], [0, 1]]]
    up, slant = [0, 0, 1], np.float32([0, 0.6, 0.8]).tolist()
    assert scene.normals[scene.triangles].tolist() == [[up, up, up], [slant, up, up]]


def test_corners_of_every_form_and_vertices_split_where_attributes_differ(tmp_path):
    text = POINTS + "vt 0.5\nvt 1 1 1\nvn 0 0 1\nf 1 2/ 3//\nf 1/2 3/1/ 4/1/1\nf 1//1 3/1 4\n"
    scene = load_text(tmp_path, text)
    none, up = [0, 0, 0], [0, 0, 1]
    uv = [[none[:2]] * 3, [[1, 0], [0.5, 1], [0.5, 1]], [[0, 0], [0.5, 1], [0, 0]]]
    assert scene.uv[scene.triangles].tolist() == uv
    assert scene.normals[scene.triangles].tolist() == [[none] * 3, [none, none, up], [up, none, none]]
    # (1) (2) (3) (1,vt2) (3,vt1) (4,vt1,vn1) (1,vn1) (4): 8 vertices, the last two triples of face 3 shared
    assert scene.vertex_count == 8
    assert corners_of(scene)[1][0] == corners_of(scene)[2][0] == [0, 0, 0]


def test_continuation_lines_comments_and_line_ends(tmp_path):
    text = "# f 9 9 9\n" + POINTS + "f 1 2 \\\n3 4 # a comment\n  f 2 3 4\n\n#f 1 2 9\nf 1 \\\n 2 \\\n 9\n"
    with pytest.raises(SceneError, match="line 11: 'f 1 2 9' has v index 9, the file has 4"):
        load_text(tmp_path, text)
    for end in ("\n", "\r\n", "\r"):
        scene = load_text(tmp_path, text.replace(" 9\n", " 4\n").replace("\n", end))
        assert scene.triangle_count == 4


@pytest.mark.parametrize(
    ("face", "what"),
    [
        ("f 0 1 2", "line 5: .* index 0, OBJ counts from 1"),
        ("f 1 2 5", "line 5: .* v index 5, the file has 4"),
        ("f 1 2 -5", "line 5: .* v index -5, 4 'v' lines precede it"),
        ("f 1/1 2/1 3/1", "vt index 1, the file has 0"),
        ("f 1//1 2 3", "vn index 1, the file has 0"),
        ("f 1 2 99999999999999999999", "v index"),
        ("f 1 2 -99999999999999999999", "v index"),
        ("f 1 2 x", "line 5: 'x' is no corner"),
        ("f 1 2 3.5", "line 5: '3.5' is no corner"),
        ("f 1 2 /3", "'/3' is no corner"),
        ("f 1/2/3/4 1/2 3", "'1/2/3/4' is no corner"),
        ("f 1 2", "no triangle .*fewer than 3 corners"),
        ("l 1 2", "no triangle .*lines are not drawn: 1"),
        ("v 1 2\nf 1 2 3", "line 5: 'v 1 2' has fewer than 3"),
        ("v 1 2 three\nf 1 2 3", "line 5: 'three' in 'v' is no number"),
        ("vn 1 2\nf 1 2 3", "line 5: 'vn 1 2' needs 3 numbers"),
        ("v nan 0 0\nf 1 2 5", "not finite"),
        ("v 1.#IND 0 0\nf 1 2 5", "not finite"),
        ("v 0 -1e39 0\nf 1 2 5", "beyond float32"),
    ],
)
def test_broken_obj_is_one_line_that_names_the_line(tmp_path, face, what):
    with pytest.raises(SceneError, match=what) as caught:
        load_text(tmp_path, POINTS + face + "\n")
    assert "\n" not in str(caught.value)


def test_a_bad_vertex_that_no_face_uses_does_no_harm(tmp_path):
    scene = load_text(tmp_path, "v nan 1.#QNAN -1.#INF\n" + POINTS + "v 1e300 0 0\nf 2 3 4\n")
    assert corners_of(scene) == [[[0, 0, 0], [1, 0, 0], [1, 1, 0]]]


def test_vertex_colours_are_linear_and_bad_ones_white(tmp_path):
    text = "v 0 0 0 0.5 0.25 0\nv 1 0 0\nv 1 1 0 nan 0 0\nv 0 1 0 1\nf 1 2 3 4\n"
    scene = load_text(tmp_path, text)
    assert scene.colors.tolist() == [[0.5, 0.25, 0, 1], [1, 1, 1, 1], [1, 1, 1, 1], [1, 1, 1, 1]]
    assert [line for line in scene.warnings if "white" in line] == ["1 vertex colours are not finite: taken as white"]
    assert scene.materials[0].base_color == (1, 1, 1, 1)


def test_what_is_not_drawn_is_said(tmp_path):
    scene = load_text(tmp_path, POINTS + "s 1\np 1\nl 1 2\nl 2 3\ncurv 0 1 1 2\nf 1 2 3\nf 1 2\n")
    said = "; ".join(scene.warnings)
    for words in ("points are not drawn: 1", "lines are not drawn: 2", "'curv'", "3 corners are not", "smoothing"):
        assert words in said


MTL = """
newmtl shiny metal # 1
Kd 0.1 0.2 0.3
Ks 0.5 0.5 0.5
Ns 30
Ni 1.3
Ke 4 5 6
d 0.25
illum 2
newmtl mapped
map_Kd -clamp on -s 2 4 1 -o 0.5 0.25 sub\\a picture.png
map_Ke t.png
Tr 0.25
newmtl odd
Kd 0.5
Tf 0.2 0.2 0.2
map_d t.png
bump t.png
illum 5
"""


def test_materials_of_an_mtl_file(tmp_path):
    (tmp_path / "sub").mkdir()
    save_png(tmp_path / "sub" / "a picture.png", [[(255, 0, 0)], [(0, 0, 255)]])
    save_png(tmp_path / "t.png", [[(9, 9, 9)]])
    text = "mtllib my mats.mtl\n" + POINTS + "".join(
        f"usemtl {name}\nf 1 2 3\n" for name in ("shiny metal # 1", "mapped", "odd", "nowhere")
    )
    (tmp_path / "my mats.mtl").write_text(MTL)
    scene = load_text(tmp_path, text)
    metal, mapped, odd, nowhere = scene.materials
    assert metal.base_color == (0.1, 0.2, 0.3, 0.25) and metal.alpha_mode == "BLEND"
    assert metal.emissive == (4, 5, 6) and metal.ior == 1.3
    assert metal.roughness == pytest.approx((2 / 32) ** 0.25)  # = 0.5
    assert mapped.base_color == (1, 1, 1, 0.75) and mapped.emissive == (1, 1, 1)
    use = mapped.base_color_texture
    assert scene.textures[use.texture].texels[:, 0, :3].tolist() == [[255, 0, 0], [0, 0, 255]]
    assert (use.wrap_u, use.wrap_v) == ("clamp", "clamp")
    # OBJ (u, v) = (0.3, 0.6) looks up (2 * 0.3 + 0.5, 4 * 0.6 + 0.25) = (1.1, 2.65): v downwards 0.4 -> -1.65
    m = use.transform
    assert (m[0] * 0.3 + m[1] * 0.4 + m[2], m[3] * 0.3 + m[4] * 0.4 + m[5]) == pytest.approx((1.1, -1.65))
    assert mapped.emissive_texture.transform == (1, 0, 0, 0, 1, 0) and mapped.emissive_texture.wrap_u == "repeat"
    assert odd.base_color == (0.5, 0.5, 0.5, 1) and odd.alpha_mode == "OPAQUE"
    assert nowhere.name == "nowhere" and nowhere.base_color == (0.8, 0.8, 0.8, 1)
    said = "; ".join(scene.warnings)
    for words in ("'Tf'", "'map_d'", "'bump'", "illum 5", "'nowhere' is in no MTL"):
        assert words in said


@pytest.mark.parametrize("name", ["../outside.mtl", "/etc/passwd", "http://example.org/a.mtl", "no.mtl", "C:\\a.mtl"])
def test_material_files_outside_or_missing_are_left_out_and_said(tmp_path, name):
    inner = tmp_path / "inner"
    inner.mkdir()
    (tmp_path / "outside.mtl").write_text("newmtl m\nKd 1 0 0\n")
    scene = load_text(inner, f"mtllib {name}\nusemtl m\n" + POINTS + "f 1 2 3\n")
    assert scene.materials[0].base_color == (0.8, 0.8, 0.8, 1)
    assert any("material file left out" in line for line in scene.warnings)


@pytest.mark.parametrize("name", ["../t.png", "missing.png", "broken.png", "/etc/hostname"])
def test_textures_outside_missing_or_broken_are_left_out_and_said(tmp_path, name):
    inner = tmp_path / "inner"
    inner.mkdir()
    save_png(tmp_path / "t.png", [[(9, 9, 9)]])
    (inner / "broken.png").write_bytes(b"\x89PNG\r\n\x1a\nnothing")
    mtl = f"newmtl m\nKd 1 0.5 0\nmap_Kd {name}\n"
    scene = load_text(inner, "mtllib a.mtl\nusemtl m\n" + POINTS + "f 1 2 3\n", a__mtl=mtl)
    assert scene.textures == () and scene.materials[0].base_color_texture is None
    assert scene.materials[0].base_color == (1, 0.5, 0, 1)
    assert any("texture left out" in line for line in scene.warnings)


def test_a_hundred_thousand_faces_take_a_second(tmp_path):
    side = 225
    rows = [f"v {i} 0 {j}\nvt {i / side:.6f} {j / side:.6f}\nvn 0 1 0" for i in range(side) for j in range(side)]
    quads = []
    for i in range(side - 1):
        for j in range(side - 1):
            a, b = i * side + j + 1, (i + 1) * side + j + 1
            quads += [f"f {a}/{a}/{a} {a + 1}/{a + 1}/{a + 1} {b}/{b}/{b}", f"f {b}/{b}/1 {a + 1}//1 {b + 1}"]
    path = tmp_path / "big.obj"
    path.write_text("\n".join(rows + quads))
    start = time.process_time()
    scene = load(path)
    seconds = time.process_time() - start
    assert scene.triangle_count == 2 * (side - 1) ** 2 == 100352
    assert seconds < 4.0  # measured 0.6; the margin is for loaded machines


def test_the_original_cornell_box_equals_the_rewritten_one():
    names = ["nasty/relative_indices/CornellBox-Original.obj", "cornell_box/CornellBox-Original.obj"]
    if not (SHARED / names[0]).exists():
        pytest.skip(f"{SHARED / names[0]} is not there")
    original, rewritten = (load(SHARED / name) for name in names)
    assert corners_of(original) == corners_of(rewritten)
    assert original.materials == rewritten.materials
    assert original.material_ids.tolist() == rewritten.material_ids.tolist()
    assert original.object_names == rewritten.object_names
    light = next(m for m in original.materials if m.name == "light")
    assert light.emissive == (17, 12, 4)
