"""`load`: the way from a path to a checked scene, and every shared scene that is no glTF against its table."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mesh_writer import SHARED

from clrast.errors import ClrastError, InputNotFoundError, SceneError
from clrast.scene.load import check_scene, load
from clrast.scene.model import Material, Scene, Texture, TextureUse

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


def scene_of(positions, triangles, **more) -> Scene:
    triangles = np.array(triangles, np.uint32).reshape(-1, 3)
    ids = np.zeros(len(triangles), np.uint32)
    more = {"object_ids": ids, "material_ids": ids, **more}
    return Scene(positions=np.array(positions), triangles=triangles, **more)


@pytest.mark.parametrize("suffix", [".obj", ".OBJ", ".Obj"])
def test_the_suffix_says_the_kind_in_any_case(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    path.write_text(TRIANGLE)
    assert load(path).triangle_count == load(str(path)).triangle_count == 1


def test_a_path_that_leads_nowhere(tmp_path):
    (tmp_path / "file.obj").write_text(TRIANGLE)
    names = ["missing.obj", "missing.xyz", "no/such/folder/a.ply", "file.obj/a.ply", "a\0b.obj", "a" * 5000 + ".obj"]
    for name in names:
        with pytest.raises(InputNotFoundError) as caught:
            load(f"{tmp_path}/{name}")
        assert caught.value.exit_code == 66 and "\n" not in str(caught.value)


def test_a_directory_a_pipe_and_an_unknown_suffix(tmp_path):
    (tmp_path / "dir.obj").mkdir()
    os.mkfifo(tmp_path / "pipe.obj")
    (tmp_path / "a.fbx").write_text("x")
    (tmp_path / "plain").write_text("x")
    for name, what in (
        ("dir.obj", "is a directory"),
        ("pipe.obj", "no regular file"),
        ("a.fbx", '".fbx" is unknown: use one of .ply .obj .stl .off .glb .gltf .toml'),
        ("plain", "no suffix"),
    ):
        with pytest.raises(SceneError, match=what) as caught:
            load(tmp_path / name)
        assert caught.value.exit_code == 65 and str(caught.value).startswith(f"{tmp_path / name}: ")


@pytest.mark.skipif(os.geteuid() == 0, reason="root reads every file")
def test_an_unreadable_file(tmp_path):
    path = tmp_path / "a.obj"
    path.write_text(TRIANGLE)
    path.chmod(0)
    with pytest.raises(SceneError, match="cannot be read"):
        load(path)


def test_a_huge_file_is_refused_before_it_is_read(tmp_path):
    path = tmp_path / "sparse.ply"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(SceneError, match="has 1099511627776 bytes, at most"):
        load(path)


def test_what_a_reader_throws_is_one_line(tmp_path, monkeypatch):
    import clrast.scene.obj

    path = tmp_path / "a.obj"
    path.write_text(TRIANGLE)
    for error in (ValueError("one\ntwo"), KeyError("x"), RecursionError(), MemoryError(), OSError(5, "no luck")):
        def fail(_path: Path, error: Exception = error) -> Scene:
            raise error

        monkeypatch.setattr(clrast.scene.obj, "read_obj", fail)
        with pytest.raises(SceneError) as caught:
            load(path)
        assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)


def test_a_newline_in_the_name_stays_off_the_line(tmp_path):
    with pytest.raises(ClrastError) as caught:
        load(tmp_path / "a\nb.obj")
    assert "\n" not in str(caught.value)


def test_positions_are_rounded_once_from_float64():
    # 1 + 2^-24 lies halfway between floats, a little more goes up; through float32 twice it would not differ
    value = 1.0 + 2.0**-24 + 2.0**-50
    scene = check_scene(scene_of([[value, 0, 0], [0, 0.1, 0], [0, 0, 1 / 3]], [0, 1, 2]), "a")
    assert scene.positions.dtype == np.float32
    assert scene.positions[0, 0] == np.float32(1 + 2.0**-23)
    assert scene.positions[2, 2] == np.float32(1 / 3)


def test_the_largest_float32_passes_and_what_rounds_beyond_it_does_not():
    largest = 3.4028234663852886e38
    scene = check_scene(scene_of([[largest, 0, 0], [0, 1, 0], [0, 0, 1]], [0, 1, 2]), "a")
    assert scene.positions[0, 0] == np.float32(largest)
    with pytest.raises(SceneError, match="vertex 0 at 3.40282e.38, 0, 0 is beyond float32"):
        check_scene(scene_of([[3.4028236e38, 0, 0], [0, 1, 0], [0, 0, 1]], [0, 1, 2]), "a")


@pytest.mark.parametrize(
    ("triangles", "more", "what"),
    [
        ([], {}, "a: no triangle in it .3 vertices, no face"),
        ([0, 1, 3], {}, "triangle 0 has vertex index 3, there are 3"),
        ([0, 1, 2, 0, 1, 4294967295], {}, "triangle 1 has vertex index 4294967295"),
        ([0, 1, 2], {"material_ids": np.array([1], np.uint32)}, "material index 1, there are 1"),
        ([0, 1, 2], {"object_ids": np.array([7], np.uint32)}, "object index 7, there are 1"),
    ],
)
def test_check_scene_refuses(triangles, more, what):
    with pytest.raises(SceneError, match=what):
        check_scene(scene_of([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]], triangles, **more), "a")


TEXELS = np.zeros((2, 2, 4), np.uint8)
TEXTURED = (Material(emissive_texture=TextureUse(1)),)


@pytest.mark.parametrize(
    ("more", "what"),
    [
        ({"triangles": np.array([[0, 1, -1]])}, "triangle 0 has vertex index -1, there are 3"),
        ({"triangles": [[0, 1, 2]]}, "triangles is no numpy array of integers"),
        ({"triangles": np.array([[0.0, 1.0, 2.0]])}, "triangles is no numpy array of integers"),
        ({"triangles": np.zeros((1, 4), np.uint32)}, r"triangles has the shape \(1, 4\): give rows of 3"),
        ({"positions": np.zeros((3, 4))}, r"positions has the shape \(3, 4\): give rows of 3"),
        ({"object_ids": np.zeros((1, 1), np.uint32)}, r"object_ids has the shape \(1, 1\): give rows"),
        ({"material_ids": np.zeros(0, np.uint32)}, "material_ids has 0 rows for 1 triangle entries"),
        ({"normals": np.zeros((1, 3))}, "normals has 1 rows for 3 vertex entries"),
        ({"uv": np.zeros((3, 3))}, r"uv has the shape \(3, 3\): give rows of 2"),
        ({"colors": np.zeros((4, 4))}, "colors has 4 rows for 3 vertex entries"),
        ({"materials": TEXTURED}, "material 'default' has texture 1, there are 0"),
        ({"materials": TEXTURED, "textures": (Texture("t", TEXELS),)}, "has texture 1, there are 1"),
        ({"textures": (Texture("t", TEXELS[:0]),)}, r"texture 't' is uint8 \(0, 2, 4\)"),
        ({"textures": (Texture("t", TEXELS[0]),)}, r"texture 't' is uint8 \(2, 4\)"),
        ({"textures": (Texture("t", TEXELS / 2),)}, "texture 't' is float64"),
    ],
)
def test_check_scene_refuses_arrays_that_do_not_fit(more, what):
    """A scene made by hand: what a kernel would read is there, or it is refused."""
    good = scene_of([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]], [0, 1, 2])
    assert check_scene(good, "a").triangle_count == 1
    with pytest.raises(SceneError, match=what):
        check_scene(replace(good, **more), "a")


def test_check_scene_refuses_nan_and_infinity_where_faces_use_them():
    for dtype in (np.float32, np.float64):
        for bad in (np.nan, np.inf, -np.inf):
            positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, bad, 0], [5, 5, 5]], dtype)
            with pytest.raises(SceneError, match="vertex 3 at .*, which triangle 1 uses, is not finite"):
                check_scene(scene_of(positions, [0, 1, 2, 2, 1, 3]), "a")
            assert np.isfinite(check_scene(scene_of(positions, [0, 1, 2]), "a").positions).all()


def test_attributes_that_are_not_finite_become_neutral_with_a_warning():
    nan = float("nan")
    scene = check_scene(
        scene_of(
            [[0, 0, 0], [1, 0, 0], [0, 1, 0.0]],
            [0, 1, 2],
            normals=np.float32([[0, 0, 1], [nan, 0, 0], [0, 0, 1]]),
            uv=np.float32([[0, 1], [0.5, np.inf], [nan, nan]]),
            colors=np.float32([[1, 0, 0, 1], [0, nan, 0, 1], [0, 0, 0, 0]]),
        ),
        "a",
    )
    assert scene.normals.tolist() == [[0, 0, 1], [0, 0, 0], [0, 0, 1]]
    assert scene.uv.tolist() == [[0, 1], [0, 0], [0, 0]]
    assert scene.colors.tolist() == [[1, 0, 0, 1], [1, 1, 1, 1], [0, 0, 0, 0]]
    assert len(scene.warnings) == 3


TABLE = {
    # file: (triangles, low corner, high corner, words of a warning), as the public files' table has it
    "bunny.ply": (69451, (-0.09469, 0.032987, -0.061874), (0.061009, 0.18732, 0.0588), ""),
    "dragon.ply": (202520, (-0.10819, 0.052739, -0.050345), (0.096406, 0.19714, 0.041137), ""),
    "suzanne.obj": (968, (-3.8613, 0.26731, 3.2523), (-1.1269, 2.2361, 4.9555), ""),
    "teapot.obj": (6320, (-3, 0, -2), (3.434, 3.15, 2), ""),
    "spot/spot.obj": (5856, (-0.47155, -0.73678, -0.66891), (0.47155, 0.95365, 1.049), ""),
    "cornell_box/CornellBox-Original.obj": (36, (-1.02, 0, -1.04), (1, 1.99, 0.99), ""),
    # the table's low x of 0.13 is what trimesh makes of the original; right is what the rewritten file has
    "nasty/relative_indices/CornellBox-Original.obj": (36, (-1.02, 0, -1.04), (1, 1.99, 0.99), ""),
    "nasty/busted.STL": (3878, (-5.3983, 18.301, -9.9357), (5.2772, 29.685, -0.36328), ""),
    "nasty/concave_polygon.obj": (64, (-1.146, 1.6575, 1.6055), (-1.146, 3.1425, 3.0905), "concave_polygon.mtl"),
    "nasty/deg_faces.obj": (4, (0.123, 0.1234, 1e-06), (0.342, 1.2715, 6e-06), ""),
    "nasty/degenerate_mesh.obj": (1, (0, 0, 0), (0, 0, 0), ""),
    "nasty/joined_tetrahedra.obj": (8, (-0.5, -0.86603, -1), (1, 0.86603, 1), ""),
    "nasty/nancolor.obj": (12, (-0.5, -0.5, -0.5), (0.5, 0.5, 0.5), "taken as white"),
    "nasty/negative_indices.obj": (12, (-1, -1, -1), (1, 1, 1), ""),
    "nasty/non_manifold_wrap.obj": (12, (-0.5, -1, -1), (1.5, 1, 1), ""),
    "nasty/origin_inside.STL": (28, (-0.5, -0.5, -0.5), (0.5, 0.5, 0.5), ""),
    "nasty/polygonfaces.obj": (3, (-500, 0, -500), (500, 500, 500), "surface.mtl"),
    "nasty/singlevn.obj": (2, (-500, 0, -500), (500, 0, 500), "surface.mtl"),
    "nasty/soup.stl": (100, (0.0023589, 0.0025305, 0.0060982), (0.99981, 0.99906, 0.99901), ""),
    "nasty/wallhole.obj": (66, (0, 0, -10), (10, 15, 0), "00.mtl"),
}
REFUSED = {
    "nasty/empty.obj": "no triangle",
    "nasty/empty.ply": "no triangle",
    "nasty/empty.stl": "no triangle",
    "nasty/inf_nan.obj": "vertex 0 at inf, nan, inf, which triangle 0 uses, is not finite",
    "nasty/malformed.obj": "line 23: 'f 4 12 2 1' has v index 12, the file has 8",
    "nasty/points_only.ply": "no triangle in it .8 vertices",
    "nasty/test-nan.obj": "not finite",
    "nasty/wireframe_only.obj": "no triangle .*lines are not drawn",
    "nasty/zero_face_index.obj": "line 16: .* index 0",
}


def shared(name: str) -> Path:
    if not (SHARED / name).exists():
        pytest.skip(f"{SHARED / name} is not there")
    return SHARED / name


@pytest.mark.parametrize("name", TABLE)
def test_shared_scene(name):
    triangle_count, low, high, said = TABLE[name]
    scene = load(shared(name))
    assert scene.triangle_count == triangle_count
    box = scene.bounding_box()
    # the table has five digits
    assert box[0] == pytest.approx(low, rel=1e-4, abs=1e-9) and box[1] == pytest.approx(high, rel=1e-4, abs=1e-9)
    assert said in "; ".join(scene.warnings)
    assert scene.positions.dtype == np.float32 and scene.triangles.dtype == np.uint32


@pytest.mark.parametrize("name", REFUSED)
def test_refused_shared_scene(name):
    with pytest.raises(SceneError, match=REFUSED[name]) as caught:
        load(shared(name))
    assert "\n" not in str(caught.value)


def test_no_shared_mesh_is_left_out_here():
    if not SHARED.exists():
        pytest.skip(f"{SHARED} is not there")
    kinds = (".ply", ".obj", ".stl", ".off")
    found = {str(path.relative_to(SHARED)) for path in SHARED.rglob("*") if path.suffix.lower() in kinds}
    assert found == set(TABLE) | set(REFUSED)


def test_shared_materials_and_normals():
    spot = load(shared("spot/spot.obj"))
    assert spot.textures[0].texels.shape == (1024, 1024, 4) and spot.materials[0].base_color_texture.texture == 0
    lines = [line.split() for line in shared("spot/spot.obj").read_text().splitlines()]
    uv = [(float(line[1]), 1.0 - float(line[2])) for line in lines if line[:1] == ["vt"]]
    corners = [[uv[int(word.split("/")[1]) - 1] for word in line[1:]] for line in lines if line[:1] == ["f"]]
    assert spot.uv[spot.triangles].tolist() == np.array(corners).astype(np.float32).tolist()
    suzanne = load(shared("suzanne.obj"))
    lengths = np.sqrt((suzanne.normals.astype(np.float64) ** 2).sum(axis=1))
    assert lengths == pytest.approx(np.ones(len(lengths)), abs=1e-6)
    # 15 combinations of position and normal occur, says the file
    assert load(shared("nasty/joined_tetrahedra.obj")).vertex_count == 15
    # a cube with unit normals: each face's normals stand along one axis, outwards
    cube = load(shared("nasty/negative_indices.obj"))
    for corners, normals in zip(cube.positions[cube.triangles], cube.normals[cube.triangles], strict=True):
        axis = int(np.argmax(np.abs(normals[0])))
        assert (normals == normals[0]).all() and normals[0, axis] == corners[0, axis] == corners[1, axis]
