"""Every scene at hand through `clrast render`: it renders, exactly, or fails in one line and writes nothing.

What is expected of each file is what DESIGN section 2 says of its kind of defect; what is right in a
picture is said by exact_visibility.py and by float64 arithmetic on the scene's float32 values.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clrast
from clrast.__main__ import main
from clrast.image.frame import CHANNEL_GROUPS, Frame
from clrast.scene.model import Scene
from clrast.study.classify_visibility import classify
from clrast.study.exact_visibility import exact_visibility

ROOT = Path(__file__).resolve().parents[1]
SHARED = ROOT.parent / "shared" / "scenes"
SIZE = (64, 48)
OTHER_SIZES = {"fan.toml": (64, 64)}
"""The fan's vertices are on pixel centres of this size to the last bit, and within rounding of others' edges."""
NO_ID = 4294967295
KINDS = (".ply", ".stl", ".off", ".obj", ".glb", ".gltf")

REFUSED = {
    "gltf/PrimitiveModes/Mesh_PrimitiveMode_00.gltf": "no triangle",  # points
    "gltf/PrimitiveModes/Mesh_PrimitiveMode_01.gltf": "no triangle",  # lines
    "gltf/PrimitiveModes/Mesh_PrimitiveMode_02.gltf": "no triangle",  # a line loop
    "gltf/PrimitiveModes/Mesh_PrimitiveMode_03.gltf": "no triangle",  # a line strip
    "nasty/Box_Draco.glb": "compressed",  # required, and the vertices are nowhere else
    "nasty/IndexOutOfRange/IndexOutOfRange.gltf": "out of range",
    "nasty/MissingBin.gltf": "missing",
    "nasty/RecursiveNodes.gltf": "no triangle",  # a cycle of nodes without a mesh
    "nasty/empty.obj": "no triangle",
    "nasty/empty.ply": "no triangle",
    "nasty/empty.stl": "no triangle",
    "nasty/inf_nan.obj": "not finite",
    "nasty/malformed.obj": "index 12",  # of 8 vertices
    "nasty/points_only.ply": "no triangle",
    "nasty/test-nan.obj": "not finite",
    "nasty/truncated_chunk_data.glb": "cut short",
    "nasty/wireframe_only.obj": "no triangle",
    "nasty/zero_face_index.obj": "index 0",
}
"""File -> words of the one line that says why it cannot be rendered (exit 65)."""

NASTY_BUT_SOUND = {
    "nasty/BoxBadNormals.glb",  # normals of length 0: the faces' own are used
    "nasty/busted.STL",
    "nasty/concave_polygon.obj",  # a fan, as defined
    "nasty/deg_faces.obj",
    "nasty/degenerate_mesh.obj",  # one triangle that is a point: a picture of nothing
    "nasty/huge_coordinates_ecef.glb",
    "nasty/joined_tetrahedra.obj",
    "nasty/nancolor.obj",
    "nasty/negative_indices.obj",
    "nasty/non_manifold_wrap.obj",
    "nasty/origin_inside.STL",
    "nasty/polygonfaces.obj",
    "nasty/relative_indices/CornellBox-Original.obj",
    "nasty/singlevn.obj",
    "nasty/soup.stl",
    "nasty/wallhole.obj",
}
COVERS_NOTHING = {"nasty/degenerate_mesh.obj"}

MUST_WARN = {
    "gltf/AlphaBlendModeTest.glb": ("normalTexture", "occlusionTexture", "metallicRoughnessTexture"),
    "gltf/AttenuationTest.glb": ("KHR_materials_volume",),
    "gltf/CesiumMan.glb": ("skins", "animations"),
    "gltf/DamagedHelmet.glb": ("normalTexture", "occlusionTexture", "metallicRoughnessTexture"),
    "nasty/concave_polygon.obj": ("concave_polygon.mtl",),
    "nasty/huge_coordinates_ecef.glb": ("EXT_feature_metadata",),
    "nasty/nancolor.obj": ("not finite",),
    "nasty/polygonfaces.obj": ("surface.mtl",),
}
"""File -> what it asks for, and does not get: each must be named in a warning."""


def shared_names() -> list[str]:
    if not SHARED.is_dir():
        return []
    return sorted(str(path.relative_to(SHARED)) for path in SHARED.rglob("*") if path.suffix.lower() in KINDS)


SCENES = [name for name in shared_names() if name not in REFUSED]
CARDS = sorted(path.name for path in (ROOT / "data").glob("*.toml"))
needs_scenes = pytest.mark.skipif(not SHARED.is_dir(), reason=f"the shared scenes are not at {SHARED}")


@dataclass
class Rendered:
    scene: Scene
    frame: Frame
    stats: dict[str, Any]
    stderr: list[str]


def render(source: Path, folder: Path, capfd: pytest.CaptureFixture[str], *arguments: str) -> Rendered:
    """Render with every channel; the command must succeed, say nothing on stdout and only warnings on stderr."""
    image, stats = folder / "a.exr", folder / "a.json"
    width, height = OTHER_SIZES.get(source.name, SIZE)
    words = ["render", str(source), "-o", str(image), "--stats", str(stats), "--size", f"{width}x{height}", "-q"]
    capfd.readouterr()
    code = main([*words, "--aov", "all", *arguments])
    printed = capfd.readouterr()
    assert (code, printed.out) == (0, ""), printed.err
    lines = printed.err.splitlines()
    assert all(line.startswith("warning: ") for line in lines), lines
    assert sorted(path.name for path in folder.iterdir()) == ["a.exr", "a.json"]
    return Rendered(clrast.load(source), Frame.load(image), json.loads(stats.read_text()), lines)


def vectors(frame: Frame, layer: str, where: np.ndarray) -> np.ndarray:
    """(hit_count, 3) float64 of the channels layer.X .Y .Z."""
    return np.stack([frame[f"{layer}.{axis}"][where] for axis in "XYZ"], axis=1).astype(np.float64)


def length(rows: np.ndarray) -> np.ndarray:
    return np.sqrt((rows * rows).sum(axis=1))


def check_channels(rendered: Rendered) -> np.ndarray:
    """What holds for every frame whatever the scene; returns where something was hit, (H, W) bool."""
    frame, scene = rendered.frame, rendered.scene
    wanted = [name for group, names in CHANNEL_GROUPS.items() if group != "cost" for name in names]
    assert list(frame) == wanted
    hit = frame["id.prim"] != NO_ID
    for name in wanted:
        values = frame[name]
        if name.startswith("id."):
            np.testing.assert_array_equal(values == NO_ID, ~hit, err_msg=name)
            continue
        assert not np.isnan(values).any(), name
        if name in ("Z", "distance.Y"):
            np.testing.assert_array_equal(np.isposinf(values), ~hit, err_msg=name)
            assert (values > 0).all(), name
            continue
        assert np.isfinite(values).all(), name
        assert name.startswith("ray") or (values[~hit] == 0).all(), name
    prims = frame["id.prim"][hit]
    assert (prims < scene.triangle_count).all()
    np.testing.assert_array_equal(frame["id.object"][hit], scene.object_ids[prims])
    np.testing.assert_array_equal(frame["id.material"][hit], scene.material_ids[prims])
    assert rendered.stats["counts"]["hits"] == np.count_nonzero(hit)
    assert rendered.stats["counts"]["triangles"] == scene.triangle_count
    assert rendered.stats["counts"]["samples"] == hit.size
    return hit


def check_colors(rendered: Rendered, hit: np.ndarray) -> None:
    frame, scene = rendered.frame, rendered.scene
    assert all((frame[name] >= 0).all() for name in "RGBA") and (frame["A"] <= 1).all()
    if not any(material.alpha_mode == "BLEND" for material in scene.materials):
        np.testing.assert_array_equal(frame["A"], hit.astype(np.float32))
    largest = max(max(material.base_color[:3]) for material in scene.materials)
    for name in ("albedo.R", "albedo.G", "albedo.B"):
        assert frame[name].min() >= 0 and frame[name].max() <= max(1, largest) * (1 + 2**-20), name


def check_geometry(rendered: Rendered, hit: np.ndarray) -> None:
    """Depth, distance, position, barycentrics and normals in float64, of perspective views.

    e and d : eye and ray, r : corners from the eye; n_i and V_i as in DESIGN section 1.
    """
    frame, scene = rendered.frame, rendered.scene
    corners = scene.positions[scene.triangles[frame["id.prim"][hit]]].astype(np.float64)
    e, d0, dx, dy = (np.array(rendered.stats["camera"][name]) for name in ("e", "d0", "dx", "dy"))
    row, column = np.nonzero(hit)
    d = d0 + (column[:, None] + 0.5) * dx + (row[:, None] + 0.5) * dy
    # t, t * d and the sum: three roundings of half an ulp
    position = e + frame["Z"][hit].astype(np.float64)[:, None] * d
    magnitude = abs(e).max() + abs(position - e).max(axis=1)
    assert (abs(vectors(frame, "P", hit) - position).max(axis=1) <= magnitude * 2**-22).all()
    np.testing.assert_allclose(frame["distance.Y"][hit], frame["Z"][hit] * length(d), rtol=2**-21)
    # each V_i within a few 2^-24 of |r| times the edge's length, their sum being what it is
    r = corners - e
    edges = [length(corners[:, (i + 2) % 3] - corners[:, (i + 1) % 3]) for i in range(3)]
    values = [(np.cross(r[:, (i + 2) % 3], r[:, (i + 1) % 3]) * d).sum(axis=1) for i in range(3)]
    doubt = sum(length(r[:, (i + 1) % 3]) * edges[i] for i in range(3)) * length(d)
    for i, name in ((1, "bary.U"), (2, "bary.V")):
        error = abs(frame[name][hit] - values[i] / sum(values))
        assert (error <= 2**-22 * doubt / abs(sum(values)) + 2**-22).all(), name
    assert min(frame["bary.U"].min(), frame["bary.V"].min(), 1 - (frame["bary.U"] + frame["bary.V"]).max()) >= -(2**-20)
    # edges are rounded by up to half an ulp of a coordinate; a triangle of small angle turns more for it
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sides = edges[1] * edges[2]
    slack = 2**-20 * sides / length(normals) * np.maximum(1, abs(corners).max(axis=(1, 2)) / np.sqrt(sides))
    assert (length(vectors(frame, "Ng", hit) - normals / length(normals)[:, None]) <= slack).all()
    np.testing.assert_allclose(length(vectors(frame, "N", hit)), 1, atol=2**-21)


def check_visibility(rendered: Rendered, frame: Frame) -> None:
    """`frame`, of the scene's bare geometry, against the exact answer. A sample within float32 rounding of an edge
    may go to the triangle beyond it, 1 in 20,000: one in a picture this small; nothing else may be wrong."""
    camera, scene = rendered.stats["camera"], rendered.scene
    exact = exact_visibility(scene.positions, scene.triangles, camera, frame.width, frame.height)
    found = classify(scene.positions, scene.triangles, camera, exact, frame["id.prim"], frame["Z"])
    assert (found.hole_along_edge_count, found.wrong_surface_count) == (0, 0), found.differences
    assert found.neighbour_count <= 1 and found.right_count >= found.sample_count - 1, found.differences
    # the plane's t in pairs of floats, rounded once
    assert found.depth_error <= 2**-23, found.depth_worst


def check(name: str, source: Path, folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    rendered = render(source, folder, capfd)
    hit = check_channels(rendered)
    check_colors(rendered, hit)
    assert hit.any() != (name in COVERS_NOTHING)
    if hit.any():
        check_geometry(rendered, hit)
    bare = rendered.frame
    if any(material.alpha_mode == "MASK" for material in rendered.scene.materials):
        bare = render(source, folder, capfd, "--effects", "alpha_mask=off").frame
    check_visibility(rendered, bare)
    for word in MUST_WARN.get(name, ()):
        assert any(word in line for line in rendered.stderr), word


@needs_scenes
def test_the_tables_name_every_nasty_file() -> None:
    nasty = {name for name in shared_names() if name.startswith("nasty/")}
    assert nasty == {name for name in REFUSED if name.startswith("nasty/")} | NASTY_BUT_SOUND
    assert set(shared_names()) > set(MUST_WARN) | set(REFUSED) and len(SCENES) > 40


@needs_scenes
@pytest.mark.parametrize("name", SCENES)
def test_scene(name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    check(name, SHARED / name, tmp_path, capfd)


@pytest.mark.parametrize("name", CARDS)
def test_card(name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    check(name, ROOT / "data" / name, tmp_path, capfd)


@needs_scenes
@pytest.mark.parametrize("name", sorted(REFUSED))
def test_refused(name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Exit 65, one line that names the file, and the files that were there stay as they were."""
    image, stats = tmp_path / "a.exr", tmp_path / "a.json"
    image.write_text("an older image")
    words = ["render", str(SHARED / name), "-o", str(image), "-o", str(tmp_path / "b.png"), "--stats", str(stats)]
    assert main(words) == 65
    check_refusal(name, *capfd.readouterr())
    assert [path.name for path in tmp_path.iterdir()] == ["a.exr"] and image.read_text() == "an older image"


def check_refusal(name: str, out: str, err: str) -> None:
    (line,) = err.splitlines()
    assert out == "" and line.startswith(f"clrast: error: {SHARED / name}: ") and REFUSED[name] in line


@needs_scenes
def test_relative_indices_mean_the_same(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """The untouched Cornell box, with relative indices and tabs, is the one with absolute indices."""
    images = []
    for folder in ("cornell_box", "nasty/relative_indices"):
        made = tmp_path / Path(folder).name
        made.mkdir()
        render(SHARED / folder / "CornellBox-Original.obj", made, capfd)
        images.append((made / "a.exr").read_bytes())
    assert images[0] == images[1]


@needs_scenes
@pytest.mark.parametrize("name", ["suzanne.obj", "nasty/soup.stl", "nasty/inf_nan.obj", "nasty/Box_Draco.glb"])
def test_whole_process(name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """As typed: the interpreter ends with the command's code, and the file is the one of a call in this process."""
    words = [sys.executable, "-m", "clrast", "render", str(SHARED / name), "-o", str(tmp_path / "p.exr"), "-q"]
    words += ["--size", "64x48", "--aov", "all"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=300)
    if name in REFUSED:
        assert done.returncode == 65 and not list(tmp_path.iterdir())
        check_refusal(name, done.stdout, done.stderr)
        return
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    (tmp_path / "here").mkdir()
    render(SHARED / name, tmp_path / "here", capfd)
    assert (tmp_path / "p.exr").read_bytes() == (tmp_path / "here" / "a.exr").read_bytes()


def test_interrupted_process_leaves_what_was_there(tmp_path: Path) -> None:
    """Ctrl-C in the midst of a render: exit 130, one line, no file but the older image."""
    image = tmp_path / "a.exr"
    image.write_text("an older image")
    words = [sys.executable, "-m", "clrast", "render", str(ROOT / "data" / "room.toml"), "-q", "--repeat", "1000000"]
    words += ["--size", "64x48", "-o", str(image), "-o", str(tmp_path / "b.png"), "--stats", str(tmp_path / "a.json")]
    process = subprocess.Popen(words, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    time.sleep(4)  # where other tests run besides it takes more than 2 to start
    assert process.poll() is None, process.communicate()
    process.send_signal(signal.SIGINT)
    assert process.communicate(timeout=300) == ("", "clrast: error: interrupted\n")
    assert process.returncode == 130
    assert [path.name for path in tmp_path.iterdir()] == ["a.exr"] and image.read_text() == "an older image"


def test_without_a_home_or_a_cache(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """No HOME, and caches that cannot be made: the same bytes, and not a word."""
    (tmp_path / "file").write_text("")
    (tmp_path / "here").mkdir()
    source = ROOT / "data" / "cube.toml"
    render(source, tmp_path / "here", capfd)
    image = tmp_path / "a.exr"
    environment = {name: value for name, value in os.environ.items() if name not in ("HOME", "XDG_CACHE_HOME")}
    environment |= {"CLRAST_CACHE_DIR": str(tmp_path / "file" / "cache"), "POCL_CACHE_DIR": str(tmp_path / "pocl")}
    words = [sys.executable, "-m", "clrast", "render", str(source), "-q", "-o", str(image)]
    words += ["--size", "64x48", "--aov", "all"]
    done = subprocess.run(words, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert image.read_bytes() == (tmp_path / "here" / "a.exr").read_bytes()
