"""`clrast render` as a whole, on a real device: pixels of closed form, files, stats, exit codes."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clrast
from clrast.__main__ import main
from clrast.commands.stats import COUNTS, KEYS, STAGES
from clrast.options import EFFECTS
from clrast.scene.camera import camera_vectors
from clrast.scene.model import Camera

SHARED = Path(__file__).resolve().parents[2] / "shared" / "scenes"
NASTY = SHARED / "nasty"

SQUARE = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
end_header
-1 -1 0
1 -1 0
1 1 0
-1 1 0
3 0 1 2
3 0 2 3
"""
NO_ID = 4294967295
PARALLEL = ("--eye", "0,0,5", "--projection", "orthographic", "--height", "4", "--size", "64x64", "-q")
"""Looks along -z, 1/16 of a world unit a pixel: the square covers columns and rows 16 to 47."""


@pytest.fixture
def square(tmp_path: Path) -> Path:
    path = tmp_path / "square.ply"
    path.write_text(SQUARE)
    return path


def render(source: Path, output: Path, *arguments: str) -> dict[str, Any]:
    """Run the command; returns its stats."""
    stats = output.with_suffix(".json")
    assert main(["render", str(source), "-o", str(output), "--stats", str(stats), *arguments]) == 0
    return json.loads(stats.read_text())


def parts(path: Path) -> dict[str, tuple[list[str], str]]:
    """Part name -> channel names (EXR sorts them; OpenImageIO puts RGBA and Z right) and type."""
    import OpenImageIO as oiio

    image, found, index = oiio.ImageInput.open(str(path)), {}, 0
    while image.seek_subimage(index, 0):
        spec = image.spec()
        found[spec.getattribute("oiio:subimagename")] = (list(spec.channelnames), str(spec.format))
        index += 1
    return found


# Pixels


def test_square_seen_in_parallel(square: Path, tmp_path: Path) -> None:
    """Pixel (i, j) is on the diagonal where i + j = 63; moved to the right it belongs to triangle 0."""
    stats = render(square, tmp_path / "a.exr", *PARALLEL, "--aov", "all")
    frame = clrast.Frame.load(tmp_path / "a.exr")
    i, j = np.meshgrid(np.arange(64), np.arange(64))
    inside = (i >= 16) & (i < 48) & (j >= 16) & (j < 48)
    expected = np.where(inside, np.where(i + j >= 63, 0, 1), NO_ID).astype(np.uint32)
    np.testing.assert_array_equal(frame["id.prim"], expected)
    assert np.count_nonzero(expected == 0) == 528 and np.count_nonzero(expected == 1) == 496
    np.testing.assert_array_equal(frame["id.object"], np.where(inside, 0, NO_ID))
    assert np.all(np.isposinf(frame["Z"][~inside])) and np.all(np.isposinf(frame["distance.Y"][~inside]))
    # t is the reciprocal of a rounded 1/5: two roundings of half an ulp
    np.testing.assert_allclose(frame["Z"][inside], 5, rtol=2**-22)
    np.testing.assert_allclose(frame["distance.Y"][inside], 5, rtol=2**-21)
    # e + t*d, each of a few roundings on values up to 5
    np.testing.assert_allclose(frame["P.X"][inside], (i[inside] + 0.5) / 16 - 2, atol=5 * 2**-21)
    np.testing.assert_allclose(frame["P.Y"][inside], 2 - (j[inside] + 0.5) / 16, atol=5 * 2**-21)
    np.testing.assert_allclose(frame["P.Z"][inside], 0, atol=5 * 2**-21)
    assert np.all(frame["Ng.Z"][inside] == 1) and np.all(frame["Ng.X"] == 0) and np.all(frame["A"] == inside)
    np.testing.assert_array_equal(frame["ray.Z"], np.full((64, 64), -1, np.float32))
    np.testing.assert_array_equal(frame["raydx.X"], np.full((64, 64), 1 / 16, np.float32))
    for name in ("R", "G", "B", "P.X", "N.Z", "bary.U", "bary.V", "albedo.R", "uv.U"):
        assert np.all(frame[name][~inside] == 0), name
    assert stats["counts"]["hits"] == 1024


def test_barycentrics_are_of_vertices_1_and_2(square: Path, tmp_path: Path) -> None:
    """P = p0 + U (p1 - p0) + V (p2 - p0): on triangle 0, x = -1 + 2U + 2V and y = -1 + 2V."""
    render(square, tmp_path / "a.exr", *PARALLEL, "--aov", "bary,id,position")
    frame = clrast.Frame.load(tmp_path / "a.exr")
    first = frame["id.prim"] == 0
    np.testing.assert_allclose(frame["bary.V"][first], (frame["P.Y"][first] + 1) / 2, atol=2**-18)
    np.testing.assert_allclose(frame["bary.U"][first], (frame["P.X"][first] - frame["P.Y"][first]) / 2, atol=2**-18)


def test_perspective_camera_and_depth(square: Path, tmp_path: Path) -> None:
    """With h = 0.4 the view at distance 5 is 4 high: the same 1024 pixels, and Z = 5 where distance.Y grows."""
    fov = repr(math.degrees(2 * math.atan(0.4)))
    arguments = ("--eye", "0,0,5", "--look-at", "0,0,0", "--fov", fov, "--size", "64x64", "--aov", "depth,distance")
    stats = render(square, tmp_path / "a.exr", *arguments, "-q")
    camera = {name: np.array(vector, np.float32) for name, vector in stats["camera"].items()}
    assert sorted(camera) == ["d0", "dx", "dy", "e"]
    near = {"rtol": 2**-22, "atol": 1e-9}
    np.testing.assert_allclose(camera["e"], (0, 0, 5), **near)
    np.testing.assert_allclose(camera["dx"], (0.8 / 64, 0, 0), **near)
    np.testing.assert_allclose(camera["dy"], (0, -0.8 / 64, 0), **near)
    np.testing.assert_allclose(camera["d0"], (-0.4, 0.4, -1), **near)
    frame = clrast.Frame.load(tmp_path / "a.exr")
    hit = np.isfinite(frame["Z"])
    assert np.count_nonzero(hit) == 1024 and np.all(hit[16:48, 16:48])
    np.testing.assert_allclose(frame["Z"][hit], 5, rtol=2**-20)
    j, i = np.nonzero(hit)
    x, y = (i + 0.5) / 16 - 2, 2 - (j + 0.5) / 16
    np.testing.assert_allclose(frame["distance.Y"][hit], np.sqrt(x * x + y * y + 25), rtol=2**-20)


def test_stats_camera_is_float32_and_agrees_with_the_definition(square: Path, tmp_path: Path) -> None:
    view = ("--eye=-3.1,2.7,4.9", "--look-at", "-0.1,0.2,0.3", "--up", "0.1,1,-0.2", "--fov", "33.3")
    stats = render(square, tmp_path / "a.exr", *view, "--size", "50x30", "-q")
    for vector in stats["camera"].values():
        assert vector == [float(np.float32(value)) for value in vector]
    camera = Camera("c", "perspective", (-3.1, 2.7, 4.9), (-0.1, 0.2, 0.3), (0.1, 1.0, -0.2), 33.3)
    assert stats["camera"] == camera_vectors(camera, 50, 30).named()


def test_a_view_of_nothing_is_a_picture(square: Path, tmp_path: Path) -> None:
    """A triangle behind the eye is hit by nothing."""
    render(square, tmp_path / "a.exr", "--eye", "0,0,5", "--look-at", "0,0,9", "--size", "8x8", "--aov", "id,depth")
    frame = clrast.Frame.load(tmp_path / "a.exr")
    assert np.all(frame["id.prim"] == NO_ID) and np.all(np.isposinf(frame["Z"]))


# Files


def test_parts_and_channels(square: Path, tmp_path: Path) -> None:
    render(square, tmp_path / "default.exr", *PARALLEL)
    assert parts(tmp_path / "default.exr") == {"beauty": (["R", "G", "B", "A", "Z"], "float")}
    render(square, tmp_path / "all.exr", *PARALLEL, "--aov", "all")
    found = parts(tmp_path / "all.exr")
    assert list(found)[0] == "beauty" and "cost" not in found
    assert found["id"] == (["id.material", "id.object", "id.prim"], "uint")
    names = [name for channels, _ in found.values() for name in channels]
    assert " ".join(sorted(names)) == (
        "A B G N.X N.Y N.Z Ng.X Ng.Y Ng.Z P.X P.Y P.Z R Z albedo.B albedo.G albedo.R bary.U bary.V distance.Y "
        "id.material id.object id.prim ray.X ray.Y ray.Z raydx.X raydx.Y raydx.Z raydy.X raydy.Y raydy.Z uv.U uv.V"
    )
    render(square, tmp_path / "id.exr", *PARALLEL, "--aov", "id")
    assert list(parts(tmp_path / "id.exr")) == ["id"]


def test_the_same_render_is_the_same_file(square: Path, tmp_path: Path) -> None:
    """Whatever the machine's options, the path, the order of options and the name of the method."""
    (tmp_path / "else").mkdir()
    base = [str(square), "--aov", "all", *PARALLEL]
    variants = [
        [*base, "-o", str(tmp_path / "a.exr")],
        ["-o", str(tmp_path / "else" / "b.exr"), *base[1:], base[0]],
        [*base, "-o", str(tmp_path / "c.exr"), "-t", "1", "--method", "3dr-binning", "--device", "0:0"],
        [*base, "-o", str(tmp_path / "d.exr"), "--threads", "2", "--repeat", "1", "--report", "--seed", "3"],
        [*base, "-o", str(tmp_path / "e.exr"), "--method", "3dr-full", "--counters"],
        [*base, "-o", str(tmp_path / "f.exr"), "--method", "raycast-bvh", "--oracle", "frustum=16,binning=blocks"],
    ]
    contents = []
    for variant in variants:
        assert main(["render", *variant]) == 0
        contents.append(Path(variant[variant.index("-o") + 1]).read_bytes())
    assert len(set(contents)) == 1
    frame = clrast.render(
        clrast.load(square), size=(64, 64), eye=(0, 0, 5), projection="orthographic", height=4, aov="all"
    )
    frame.save(tmp_path / "python.exr")
    assert (tmp_path / "python.exr").read_bytes() == contents[0]


def test_a_picture_beside_it_does_not_change_the_exr(tmp_path: Path) -> None:
    """A PNG wants colour, and with it effects that ids do not call for: they are not in the EXR file's header."""
    room = Path(__file__).resolve().parents[1] / "data" / "room.toml"
    for name, more in (("alone", ()), ("beside", ("-o", str(tmp_path / "b.png")))):
        render(room, tmp_path / f"{name}.exr", "--aov", "id", "--size", "24x16", "-q", *more)
    assert clrast.Frame.load(tmp_path / "alone.exr").header["effects"] == "textures,alpha_mask"
    assert (tmp_path / "alone.exr").read_bytes() == (tmp_path / "beside.exr").read_bytes()


def test_two_outputs_and_nothing_on_stdout(square: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    arguments = ["-o", str(tmp_path / "a.exr"), "-o", str(tmp_path / "b.png"), "--size", "32x24"]
    assert main(["render", str(square), *arguments]) == 0
    printed = capfd.readouterr()
    assert printed.out == ""
    lines = printed.err.splitlines()
    assert "framing the whole scene" in lines[0] and "32x24" in lines[-1]
    from PIL import Image

    with Image.open(tmp_path / "b.png") as picture:
        assert picture.size == (32, 24)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.exr", "b.png", "square.ply"]


def test_framing_shows_the_scene(square: Path, tmp_path: Path) -> None:
    """The framing camera sees all of the square: no hit in the outermost pixels, both triangles inside."""
    render(square, tmp_path / "a.exr", "--size", "64x48", "--aov", "id", "-q")
    ids = clrast.Frame.load(tmp_path / "a.exr")["id.prim"]
    assert {0, 1} <= set(np.unique(ids))
    assert np.all(ids[[0, -1]] == NO_ID) and np.all(ids[:, [0, -1]] == NO_ID)


# Stats


def test_stats_schema(square: Path, tmp_path: Path) -> None:
    stats = render(square, tmp_path / "a.exr", *PARALLEL, "--effects", "alpha_mask=off", "--repeat", "2")
    assert set(KEYS) <= set(stats)
    assert (stats["method"], stats["method_requested"]) == ("3dr-binning", "auto")
    assert (stats["precision"], stats["aa"], stats["mode"]) == ("midpoint", "none", "cast")
    assert stats["bytes_device"] > 0 and stats["device"]
    assert set(COUNTS) <= set(stats["counts"])
    assert (stats["counts"]["triangles"], stats["counts"]["samples"]) == (2, 4096)
    assert stats["counts"]["kernel_launches"] > 0 and stats["counts"]["edge_evaluations"] is None
    for name in ("rays_shadow", "rays_reflection", "rays_refraction", "rays_indirect"):
        assert stats["counts"][name] == 0
    times = stats["times_ms"]
    assert list(times) == list(STAGES) and all(times[stage] >= 0 for stage in STAGES)
    assert not set(stats["other_times_ms"]) & set(STAGES)
    for stage in ("load", "setup", "bin", "visibility", "shade", "write"):
        assert times[stage] > 0, stage
    assert times["build"] == 0
    assert sum(times[stage] for stage in STAGES if stage != "total") <= times["total"]
    assert [effect["name"] for effect in stats["effects"]] == list(EFFECTS)
    assert all(isinstance(effect["on"], bool) and effect["reason"] for effect in stats["effects"])
    on = {effect["name"] for effect in stats["effects"] if effect["on"]}
    assert not on & {"alpha mask", "shadow", "textures", "reflection", "emission"}


def test_the_stats_of_python_have_the_same_keys(square: Path, tmp_path: Path) -> None:
    stats = render(square, tmp_path / "a.exr", *PARALLEL)
    frame = clrast.render(clrast.load(square), size=(8, 8))
    assert list(frame.stats) == list(stats)
    for table in ("counts", "times_ms"):
        assert list(frame.stats[table]) == list(stats[table])
    assert frame.stats["times_ms"]["write"] == 0 and frame.stats["counts"]["setups"] is None


# Scene cards and cameras of files


def test_a_card_brings_size_options_and_cameras(square: Path, tmp_path: Path) -> None:
    cards = sorted((Path(__file__).resolve().parents[1] / "data").glob("*.toml"))
    if not cards:
        pytest.skip("data/ has no scene card")
    scene = clrast.load(cards[0])
    stats = render(cards[0], tmp_path / "own.exr", "-q")
    width, height = scene.image_size or (1024, 1024)
    assert (stats["image"]["width"], stats["image"]["height"]) == (width, height)
    stats = render(cards[0], tmp_path / "given.exr", "--size", "40x20", "--precision", "ordered", "-q")
    assert (stats["image"]["width"], stats["image"]["height"], stats["precision"]) == (40, 20, "ordered")


@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared scenes are not here")
def test_cameras_of_a_gltf(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = SHARED / "gltf" / "Cameras" / "Cameras.gltf"
    first = render(source, tmp_path / "a.exr", "--size", "32x32", "-q")["camera"]
    assert first == render(source, tmp_path / "b.exr", "--size", "32x32", "-q", "--camera", "0")["camera"]
    assert set(first) == {"e", "d0", "dx", "dy"}
    second = render(source, tmp_path / "c.exr", "--size", "32x32", "-q", "--camera", "1")["camera"]
    assert set(second) == {"d", "e0", "ex", "ey"}
    assert main(["render", str(source), "-o", str(tmp_path / "d.exr"), "--camera", "2"]) == 64
    assert "it has 0 '" in capsys.readouterr().err


# Errors


def one_error(capsys: pytest.CaptureFixture[str], code: int, *arguments: str) -> None:
    assert main(["render", *arguments]) == code
    printed = capsys.readouterr()
    errors = [line for line in printed.err.splitlines() if line.startswith("clrast: error: ")]
    others = [line for line in printed.err.splitlines() if not line.startswith(("clrast: ", "warning: "))]
    assert (len(errors), others, printed.out) == (1, [], "")


def test_device_and_memory_errors(square: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = str(tmp_path / "a.exr")
    one_error(capsys, 69, str(square), "-o", output, "--device", "no such device")
    one_error(capsys, 75, str(square), "-o", output, "--memory", "1K")
    assert not os.path.exists(output)


@pytest.mark.parametrize(
    "text",
    ["", "ply\n", "not a ply at all", SQUARE.replace("3 0 2 3", "3 0 2 4"), SQUARE.replace("1 1 0", "nan 1 0"),
     SQUARE.replace("1 1 0", "1e39 1 0"), SQUARE.replace("element face 2", "element face 0")],
)  # fmt: skip
def test_bad_input_writes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str) -> None:
    (tmp_path / "bad.ply").write_text(text)
    one_error(capsys, 65, str(tmp_path / "bad.ply"), "-o", str(tmp_path / "a.exr"), "--stats", str(tmp_path / "s.json"))
    assert [path.name for path in tmp_path.iterdir()] == ["bad.ply"]


MUST_FAIL = {
    "empty.obj", "empty.ply", "empty.stl", "inf_nan.obj", "malformed.obj", "points_only.ply", "wireframe_only.obj",
    "zero_face_index.obj", "test-nan.obj", "truncated_chunk_data.glb", "IndexOutOfRange.gltf", "MissingBin.gltf",
    "RecursiveNodes.gltf",
}  # fmt: skip
MAY_FAIL = {"Box_Draco.glb"}
"""Compressed vertices: an error or a warning, never a silent picture of nothing."""


def nasty_files() -> list[Path]:
    kinds = (".obj", ".ply", ".stl", ".glb", ".gltf")
    return sorted(path for path in NASTY.rglob("*") if path.suffix.lower() in kinds) if NASTY.is_dir() else []


@pytest.mark.skipif(not NASTY.is_dir(), reason="the shared nasty scenes are not here")
@pytest.mark.parametrize("source", nasty_files(), ids=lambda path: path.name)
def test_nasty_files_render_or_fail_in_one_line(
    source: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    code = main(["render", str(source), "-o", str(tmp_path / "a.exr"), "--size", "64x64", "-q"])
    printed = capfd.readouterr()
    lines = printed.err.splitlines()
    errors = [line for line in lines if line.startswith("clrast: error: ")]
    assert all(line.startswith(("clrast: error: ", "warning: ")) for line in lines)
    expected = (0, 65) if source.name in MAY_FAIL else (65,) if source.name in MUST_FAIL else (0,)
    assert code in expected, lines
    assert (len(errors), (tmp_path / "a.exr").exists(), printed.out) == (int(code != 0), code == 0, "")
    if source.name in MAY_FAIL:
        assert lines


# The whole process


def test_whole_process(square: Path, tmp_path: Path) -> None:
    """One command, as typed; the second run, with warm caches, within the budget of a render (generous for CI)."""
    command = [sys.executable, "-m", "clrast", "render", str(square), "-o", str(tmp_path / "a.exr")]
    for _ in range(2):
        before = time.perf_counter()
        done = subprocess.run(command, capture_output=True, text=True, timeout=120)
        seconds = time.perf_counter() - before
        assert (done.returncode, done.stdout) == (0, "")
    assert seconds < 5
    assert all(line.startswith(("clrast: ", "warning: ")) for line in done.stderr.splitlines())
