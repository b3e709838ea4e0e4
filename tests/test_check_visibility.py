"""tools/check_visibility.py as a program: exit codes, bars and figures, with the float32 twin as renderer."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from test_classify_visibility import sheet_camera, sheet_through_samples

TOOL = Path(__file__).resolve().parents[1] / "tools" / "check_visibility.py"


@pytest.fixture(scope="module")
def tool():
    """The tool as a module."""
    spec = importlib.util.spec_from_file_location("check_visibility", TOOL)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["check_visibility"] = module
    spec.loader.exec_module(module)
    return module


def write_off(file, positions, triangles):
    """A mesh as OFF, coordinates with all their digits."""
    rows = [" ".join(repr(float(c)) for c in row) for row in positions]
    faces = [f"3 {a} {b} {c}" for a, b, c in triangles]
    file.write_text("\n".join(["OFF", f"{len(rows)} {len(faces)} 0", *rows, *faces]) + "\n")
    return str(file)


@pytest.fixture
def torn_sheet(tmp_path, tool):
    """(OFF file, view): a sheet with edges through the samples of that view."""
    side = 24
    eye, look_at = (1.25, -0.75, 2.0), (0.5, 0.25, -1.0)
    view = tool.View("sheet", eye, look_at, fov=50.0)
    camera = tool.round_camera(tool.view_vectors(view, (side, side)))
    file = write_off(tmp_path / "sheet.off", *sheet_through_samples(camera, side))
    return file, "sheet:1.25,-0.75,2:0.5,0.25,-1:50", f"{side}x{side}"


def test_fused_edges_break_the_bars(torn_sheet, tool, tmp_path, capsys):
    """The figures of a renderer that tears, and exit 1."""
    file, view, size = torn_sheet
    report = tmp_path / "report.json"
    arguments = [file, "--views", "", "--view", view, "--size", size, "--json", str(report)]
    assert tool.main([*arguments, "--renderer", "contracted"]) == 1
    assert "BROKEN: holes along edges" in capsys.readouterr().out
    (found,) = json.loads(report.read_text())
    assert found["samples"] == 24 * 24 and found["holes_along_edges"] > 5 and found["double_hits_along_edges"] > 5
    assert {"holes along edges", "double hits along edges", "wrong surfaces"} <= set(found["broken"])
    assert found["right"] + found["neighbours"] + sum(found["wrong"].values()) == found["samples"]
    assert found["camera_steps"] <= 0.5
    assert tool.main([*arguments, "--renderer", "midpoint"]) == 1  # so many samples on edges: too many neighbours
    (found,) = json.loads(report.read_text())
    assert found["holes_along_edges"] == found["double_hits_along_edges"] == 0 and found["neighbours"] > 0


def test_sound_render_passes_and_is_cached(tool, tmp_path, capsys):
    """A mesh without spite: exit 0, the same figures from the cache, also for random and orthographic views."""
    points = np.array([[0, 1.1, 0.1], [-1.3, -0.7, -0.9], [1.2, -0.8, -0.6], [0.2, -0.5, 1.4]])
    file = write_off(tmp_path / "four.off", points, [(0, 2, 1), (0, 3, 2), (0, 1, 3), (1, 2, 3)])
    cache = tmp_path / "cache"
    arguments = [file, "--renderer", "midpoint", "--size", "40x30", "--views", "outside,inside,orthographic"]
    arguments += ["--random", "2", "--cache", str(cache), "--examples", "0"]
    assert tool.main(arguments) == 0
    first = capsys.readouterr().out
    assert first.count(" ok") == 5 and len(list(cache.iterdir())) == 5
    assert tool.main(arguments) == 0
    assert capsys.readouterr().out == first and len(list(cache.iterdir())) == 5


def test_missing_scene_and_wrong_usage(tool, tmp_path):
    assert tool.main([str(tmp_path / "none.ply")]) == 66
    for wrong in (["--size", "12"], ["--views", "above"], ["--view", "a:1,2:3,4,5"]):
        with pytest.raises(SystemExit, match="2"):
            tool.main(wrong)


def test_camera_steps(tool):
    """One float32 step away is 1, another set of vectors is infinitely far."""
    camera = tool.round_camera(sheet_camera(1, 8))
    assert tool.camera_steps(camera, camera) <= 0
    moved = {**camera, "dx": [float(np.nextafter(np.float32(c), np.float32(9))) for c in camera["dx"]]}
    assert tool.camera_steps(moved, camera) == pytest.approx(1, abs=0.01)
    assert tool.camera_steps({"d": [0, 0, 1]}, camera) == np.inf
