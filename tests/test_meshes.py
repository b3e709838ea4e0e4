"""PLY, STL and OFF: file order, polygons in place, colours, byte orders, claims that the file cannot keep."""

from __future__ import annotations

import io
import struct
import sys
import tracemalloc
import warnings
from pathlib import Path

import numpy as np
import pytest
from mesh_writer import (
    MIXED_FACES,
    MIXED_TRIANGLES,
    SHARED,
    SQUARE,
    ascii_ply,
    ascii_stl,
    binary_ply,
    binary_stl,
    ply_header,
)

from clrast.errors import SceneError
from clrast.scene.load import load
from clrast.scene.model import Scene
from clrast.scene.polygons import fan_triangles, smooth_normals, unit_rows

FACETS = [[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0], [0, 1, 0]]]


def load_bytes(folder: Path, name: str, content: bytes | str) -> Scene:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return load(path)


def corners_of(scene: Scene) -> np.ndarray:
    return scene.positions[scene.triangles]


@pytest.mark.parametrize(
    "content",
    [ascii_ply(SQUARE, MIXED_FACES), binary_ply(SQUARE, MIXED_FACES, "<"), binary_ply(SQUARE, MIXED_FACES, ">")],
    ids=["ascii", "little", "big"],
)
def test_ply_polygons_are_fanned_in_place(tmp_path, content):
    scene = load_bytes(tmp_path, "a.ply", content)
    assert scene.triangles.tolist() == [list(t) for t in MIXED_TRIANGLES]
    assert scene.positions.tolist() == [list(v) for v in SQUARE]
    assert scene.positions.dtype == np.float32 and scene.triangles.dtype == np.uint32


@pytest.mark.parametrize("order", ["<", ">"])
def test_ply_quads_alone_keep_their_order(tmp_path, order):
    faces = [(0, 1, 2, 3), (2, 4, 3, 0)]
    scene = load_bytes(tmp_path, "a.ply", binary_ply(SQUARE, faces, order))
    assert scene.triangles.tolist() == [[0, 1, 2], [0, 2, 3], [2, 4, 3], [2, 3, 0]]


def test_ply_numbers_may_run_over_lines_and_line_ends_may_be_any(tmp_path):
    text = ascii_ply(SQUARE, MIXED_FACES).decode()
    header, body = text.split("end_header\n")
    for end in ("\r\n", "\r"):
        joined = (header.replace("\n", end) + "end_header" + end + body.replace("\n", end)).encode()
        assert len(load_bytes(tmp_path, "a.ply", joined).triangles) == 7
    wrapped = (header + "end_header\n" + "\n".join(body.split())).encode()
    assert len(load_bytes(tmp_path, "a.ply", wrapped).triangles) == 7


def test_ply_other_properties_elements_and_types_are_skipped(tmp_path):
    header = (
        "ply\nformat binary_big_endian 1.0\ncomment hello\nobj_info x\n"
        "element material 1\nproperty list uchar short k\nproperty double w\n"
        "element vertex 3\nproperty double x\nproperty uchar flag\nproperty double y\nproperty double z\n"
        "element face 2\nproperty uchar flag\nproperty list ushort uint vertex_index\nproperty float q\nend_header\n"
    )
    body = struct.pack(">B2hd", 2, 7, 8, 1.5)
    for x, y, z in ((0.1, 0, 0), (1, 0.2, 0), (0, 1, 0.3)):
        body += struct.pack(">dBdd", x, 9, y, z)
    body += struct.pack(">BH3If", 1, 3, 0, 1, 2, 0.5) + struct.pack(">BH3If", 1, 3, 2, 1, 0, 0.5)
    scene = load_bytes(tmp_path, "a.ply", header.encode() + body)
    assert scene.triangles.tolist() == [[0, 1, 2], [2, 1, 0]]
    assert scene.positions.tolist() == np.float32([[0.1, 0, 0], [1, 0.2, 0], [0, 1, 0.3]]).tolist()


def test_ply_uchar_colours_are_srgb_and_float_ones_linear(tmp_path):
    more = "property uchar red\nproperty uchar green\nproperty uchar blue\nproperty uchar alpha"
    rows = [(0, 0, 0, 0, 10, 128, 51), (1, 0, 0, 255, 1, 188, 255), (0, 1, 0, 255, 255, 255, 0)]
    scene = load_bytes(tmp_path, "a.ply", ascii_ply(rows, [(0, 1, 2)], more))
    # IEC 61966-2-1: 10 and 1 lie on the straight part, 128 and 188 on the curve
    curve = [((code / 255 + 0.055) / 1.055) ** 2.4 for code in (128, 188)]
    expected = [[0, 10 / 255 / 12.92, curve[0], 51 / 255], [1, 1 / 255 / 12.92, curve[1], 1], [1, 1, 1, 0]]
    assert scene.colors == pytest.approx(np.array(expected), rel=1e-6)
    assert scene.materials[0].base_color == (1.0, 1.0, 1.0, 1.0)
    more = "property float red\nproperty float green\nproperty float blue"
    rows = [(0, 0, 0, 0.25, 0.5, 2), (1, 0, 0, 1, 1, 1), (0, 1, 0, 0, 0, 0)]
    scene = load_bytes(tmp_path, "b.ply", ascii_ply(rows, [(0, 1, 2)], more))
    assert scene.colors.tolist() == [[0.25, 0.5, 2, 1], [1, 1, 1, 1], [0, 0, 0, 1]]


def test_ply_normals_become_unit_and_v_grows_downwards(tmp_path):
    more = "\n".join(f"property float {name}" for name in ("nx", "ny", "nz", "s", "t"))
    rows = [(0, 0, 0, 0, 3, 4, 0.25, 0.25), (1, 0, 0, 0, 0, 0, 1, 0), (0, 1, 0, 1e-30, 0, 0, 0, 1)]
    scene = load_bytes(tmp_path, "a.ply", ascii_ply(rows, [(0, 1, 2)], more))
    assert scene.normals.tolist() == np.float32([[0, 0.6, 0.8], [0, 0, 0], [1, 0, 0]]).tolist()
    assert scene.uv.tolist() == [[0.25, 0.75], [1, 1], [0, 0]]


@pytest.mark.parametrize(
    ("content", "what"),
    [
        (ply_header("ascii", 10**12, 1) + "0 0 0\n", "1000000000000 rows of vertex"),
        (ply_header("binary_little_endian", 10**12, 1) + "0 0 0\n", "1000000000000 rows of vertex"),
        (ply_header("ascii", 3, 10**17) + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "rows of face"),
        (ply_header("ascii", 3, 1) + "0 0 0\n1 0 0\n0 1 0\n3 0 1\n", "cut short"),
        (ply_header("ascii", 3, 1) + "0 0 0\n1 0 0\n0 1 0\n4000000000 0 1 2\n", "cut short"),
        (ply_header("ascii", 3, 1) + "0 0 0\n1 0 0\n0 1 0\n-3 0 1 2\n", "list of -3"),
        (ply_header("ascii", 3, 1) + "0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n", "index 3, there are 3 vertices"),
        (ply_header("ascii", 3, 1) + "0 0 0\n1 0 0\n0 1 0\n3 0 1 -1\n", "index -1"),
        (ply_header("ascii", 3, 1) + "0 0 0\n1 0 0\n0 1 0\n3 0 1 1.5\n", "index 1.5"),
        (ply_header("ascii", 3, 1) + "0 0 0\n1 0 zero\n0 1 0\n3 0 1 2\n", '"zero"'),
        (ply_header("ascii", 3, 1) + "0 0 0\n1 0 nan\n0 1 0\n3 0 1 2\n", "vertex 1 .* not finite"),
        (ply_header("ascii", 3, 1) + "0 0 0\n1 0 1e39\n0 1 0\n3 0 1 2\n", "vertex 1 .* beyond float32"),
        (ply_header("ascii", 3, 0) + "0 0 0\n1 0 0\n0 1 0\n", "no triangle in it .3 vertices"),
        (ply_header("ascii", 3, 1) + "0 0 0\n1 0 0\n0 1 0\n2 0 1\n", "no triangle .*fewer than 3 corners"),
        ("ply\nformat ascii 1.0\nelement vertex 1\n", "no 'end_header'"),
        ("ply\nformat ascii 1.0\nelement vertex 1\nproperty quad x\nend_header\n", "line 4"),
        ("ply\nelement vertex 0\nend_header\n", "no 'format'"),
        ("plywood\n", "no PLY file"),
        ("", "no PLY file"),
    ],
)
def test_broken_ply_is_one_line_and_little_memory(tmp_path, content, what):
    tracemalloc.start()
    try:
        with pytest.raises(SceneError, match=what) as caught:
            load_bytes(tmp_path, "a.ply", content)
        assert tracemalloc.get_traced_memory()[1] < 50e6
    finally:
        tracemalloc.stop()
    assert "\n" not in str(caught.value) and str(tmp_path / "a.ply") in str(caught.value)


@pytest.mark.parametrize("order", ["<", ">"])
def test_a_binary_ply_cut_anywhere_is_an_error(tmp_path, order):
    content = binary_ply(SQUARE, MIXED_FACES, order)
    for length in range(len(content)):
        with pytest.raises(SceneError):
            load_bytes(tmp_path, "a.ply", content[:length])


def test_a_bad_vertex_that_no_face_uses_does_no_harm(tmp_path):
    rows = [("nan", 0, 0), (0, 0, 0), (1, 0, 0), (0, 1, 0), (0, "1e300", 0), ("inf", 0, 0)]
    scene = load_bytes(tmp_path, "a.ply", ascii_ply(rows, [(1, 2, 3)]))
    assert scene.vertex_count == 6 and np.isfinite(scene.positions).all()
    assert corners_of(scene).tolist() == [[[0, 0, 0], [1, 0, 0], [0, 1, 0]]]


def test_binary_stl_stays_a_soup_in_file_order(tmp_path):
    for header in (b"", b"solid in spite of the name"):
        scene = load_bytes(tmp_path, "a.STL", binary_stl(FACETS, header))
        assert corners_of(scene).tolist() == FACETS
        assert scene.triangles.tolist() == [[0, 1, 2], [3, 4, 5]]


def test_binary_stl_with_bytes_behind_it_is_read_and_said(tmp_path):
    scene = load_bytes(tmp_path, "a.stl", binary_stl(FACETS) + b"extra")
    assert corners_of(scene).tolist() == FACETS
    assert any("5 bytes after" in line for line in scene.warnings)


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_ascii_stl_solids_are_objects(tmp_path, end):
    text = (ascii_stl(FACETS, "first vertex") + ascii_stl(FACETS[:1], "b")).replace("\n", end)
    scene = load_bytes(tmp_path, "a.stl", text.encode("latin-1"))
    assert corners_of(scene).tolist() == [*FACETS, FACETS[0]]
    assert scene.object_ids.tolist() == [0, 0, 1] and scene.object_names == ("first _", "b")


@pytest.mark.parametrize(
    ("content", "what"),
    [
        (binary_stl(FACETS)[:-1], "2 facets, which take 184 bytes, the file has 183"),
        (binary_stl([]), "no triangle"),
        (b"", "too short"),
        (binary_stl([[(0, 0, 0), (1, 0, 0), (0, float("inf"), 0)]]), "vertex 2 .* not finite"),
        (ascii_stl(FACETS)[:-40], "cut short"),
        (ascii_stl(FACETS, "a") + ascii_stl(FACETS, "b")[:-60], "cut short"),
        (ascii_stl([[(0, 0, 0), (1, 0, 0), (0, "1e39", 0)]]), "beyond float32"),
        ("solid Empty\nendsolid Empty", "no triangle"),
    ],
)
def test_broken_stl_is_one_line(tmp_path, content, what, capfd):
    with pytest.raises(SceneError, match=what):
        load_bytes(tmp_path, "a.stl", content)
    assert capfd.readouterr() == ("", "")


OFF_BODY = "5 4 0\n" + "\n".join(" ".join(map(str, v)) for v in SQUARE) + "\n"
OFF_FACES = "\n".join(" ".join(map(str, (len(f), *f))) for f in MIXED_FACES) + "\n"


@pytest.mark.parametrize(
    "content",
    [
        "OFF\n" + OFF_BODY + OFF_FACES,
        "OFF " + OFF_BODY + OFF_FACES,
        "# made by hand\nOFF # here\n\n" + (OFF_BODY + OFF_FACES).replace("\n", "\r\n"),
    ],
)
def test_off_polygons_are_fanned_in_place(tmp_path, content):
    scene = load_bytes(tmp_path, "a.off", content)
    assert scene.triangles.tolist() == [list(t) for t in MIXED_TRIANGLES]
    assert scene.positions.tolist() == [list(v) for v in SQUARE]


def test_off_colours_and_normals(tmp_path):
    rows = "0 0 0 0 0 2 255 0 0 51\n1 0 0 0 3 4 0 255 0 255\n0 1 0 0 0 1 0 0 255 255\n3 0 1 2\n"
    scene = load_bytes(tmp_path, "a.off", "CNOFF\n3 1 0\n" + rows)
    assert scene.normals.tolist() == np.float32([[0, 0, 1], [0, 0.6, 0.8], [0, 0, 1]]).tolist()
    assert scene.colors.tolist() == np.float32([[1, 0, 0, 0.2], [0, 1, 0, 1], [0, 0, 1, 1]]).tolist()
    rows = "0 0 0 0.5 0 0\n1 0 0 0 1 0\n0 1 0 0 0 1\n3 0 1 2 1 0 0\n"
    scene = load_bytes(tmp_path, "b.off", "COFF\n3 1 0\n" + rows)
    assert scene.colors.tolist() == [[0.5, 0, 0, 1], [0, 1, 0, 1], [0, 0, 1, 1]]
    assert any("colours of faces" in line for line in scene.warnings)


@pytest.mark.parametrize(
    ("content", "what"),
    [
        ("OFF\n1000000000000 1 0\n0 0 0\n", "1000000000000 vertices"),
        ("OFF\n" + OFF_BODY + "3 0 1 5\n" * 4, "face 0 has a vertex index outside 0 to 4"),
        ("OFF\n" + OFF_BODY + "3 0 1 -1\n" * 4, "face 0 has a vertex index"),
        ("OFF\n" + OFF_BODY + "4 0 1 2\n" * 4, "face 0 says 4 corners"),
        ("OFF\n" + OFF_BODY.replace("0.5", "nan") + OFF_FACES, "not finite"),
        ("4OFF\n" + OFF_BODY + OFF_FACES, "four or n dimensions"),
        ("OFF BINARY\n", "binary OFF"),
        ("OFF\n", "two counts"),
        ("OFF\n3 0 0\n0 0 0\n1 0 0\n0 1 0\n", "no triangle"),
        ("", "no OFF file"),
    ],
)
def test_broken_off_is_one_line(tmp_path, content, what):
    with pytest.raises(SceneError, match=what):
        load_bytes(tmp_path, "a.off", content)


def test_fans_of_any_sizes():
    corners, polygons = fan_triangles(np.array([3, 2, 5, 0, 4]))
    assert corners.tolist() == [[0, 1, 2], [5, 6, 7], [5, 7, 8], [5, 8, 9], [10, 11, 12], [10, 12, 13]]
    assert polygons.tolist() == [0, 2, 2, 2, 4, 4]
    corners, polygons = fan_triangles(np.array([], np.int64))
    assert corners.shape == (0, 3) and polygons.shape == (0,)


def test_unit_rows_take_any_size():
    rows = unit_rows(np.array([[3e300, 4e300, 0], [0, 0, 5e-320], [0, 0, 0], [np.inf, 0, 0]]))
    assert rows[:3].tolist() == np.float32([[0.6, 0.8, 0], [0, 0, 1], [0, 0, 0]]).tolist()
    assert np.isnan(rows[3]).any()


def test_smooth_normals_weigh_faces_by_area_and_join_equal_places():
    # A roof: one face in z = 0 of area 2, one in x = 0 of area 0.5; the ridge vertices are stored twice.
    # (p1 - p0) x (p2 - p0) is (0,1,0) x (-4,0,0) = (0,0,4) and (0,0,-1) x (0,1,0) = (1,0,0).
    positions = np.array([[0, 0, 0], [0, 1, 0], [-4, 0, 0], [0, 0, -0.0], [0, 1, 0], [0, 0, -1]], np.float64)
    normals = smooth_normals(positions, np.array([[0, 1, 2], [3, 5, 4]]))
    ridge = np.array([1.0, 0, 4.0]) / np.sqrt(17)
    assert normals[[0, 1, 3, 4]] == pytest.approx(np.array([ridge] * 4), abs=1e-7)
    assert normals[2].tolist() == [0, 0, 1] and normals[5].tolist() == [1, 0, 0]


@pytest.mark.parametrize(
    "name", ["bunny.ply", "dragon.ply", "nasty/busted.STL", "nasty/origin_inside.STL", "nasty/soup.stl"]
)
def test_triangles_equal_those_of_trimesh(name):
    path = SHARED / name
    if not path.exists():
        pytest.skip(f"{path} is not there")
    import trimesh

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        other = trimesh.load(io.BytesIO(path.read_bytes()), file_type=path.suffix[1:].lower(), process=False)
    assert corners_of(load(path)).tolist() == other.vertices[other.faces].astype(np.float32).tolist()


def test_loading_imports_nothing_heavy():
    """The bunny's start-up time: a PLY or OBJ needs numpy and nothing else; STL needs trimesh alone."""
    import subprocess

    code = (
        "import sys; from clrast.scene import ply, obj, meshes, load;"
        "print([m for m in ('trimesh', 'PIL', 'pydantic', 'scipy', 'networkx', 'OpenImageIO', 'pyopencl') "
        "if m in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"
