"""tools/check_methods.py as a program: what agrees, what rounding explains, and that it can fail."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from clrast.image.frame import Frame

ROOT = Path(__file__).resolve().parents[1]
METHODS = "3dr-full,2dr-binning,raycast-brute:barycentric,3dr-binning:incremental"


@pytest.fixture
def tool() -> ModuleType:
    sys.path.insert(0, str(ROOT / "tools"))
    try:
        import check_methods
    finally:
        sys.path.remove(str(ROOT / "tools"))
    return check_methods


def run(tool: ModuleType, monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["check_methods.py", *arguments])
    return tool.main()


def test_methods_agree_on_a_card(
    tool: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report, card = tmp_path / "report.json", str(ROOT / "data" / "room.toml")
    assert run(tool, monkeypatch, card, "--methods", METHODS, "--size", "72x40", "--json", str(report)) == 0
    rows = json.loads(report.read_text())
    assert [row["method"] for row in rows] == 2 * METHODS.split(",")
    assert {row["view"] for row in rows} == {"outside", "inside"}
    assert all(row["unexplained"] == 0 for row in rows)
    assert "3D edges: 2 compared, 0 samples differ" in capsys.readouterr().out


@pytest.mark.parametrize(("method", "message"), [("3dr-full", "1 samples differ"), ("2dr-binning", "1 unexplained")])
def test_a_wrong_sample_is_noticed(
    tool: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], method: str, message: str
) -> None:
    """One sample that shows nothing, far from any edge: in the middle of the largest triangle's samples."""
    right = tool.render

    def render(scene: object, camera: object, **options: object) -> Frame:
        frame = right(scene, camera, **options)
        if options.get("method") == method and camera.name == "outside":  # type: ignore[attr-defined]
            ids, counts = np.unique(frame["id.prim"][frame["id.prim"] != 0xFFFFFFFF], return_counts=True)
            rows, columns = np.nonzero(frame["id.prim"] == ids[counts.argmax()])
            frame["id.prim"][int(np.median(rows)), int(np.median(columns[rows == int(np.median(rows))]))] = 0xFFFFFFFF
        return frame

    monkeypatch.setattr(tool, "render", render)
    arguments = (str(ROOT / "data" / "room.toml"), "--methods", method, "--size", "160x120")
    assert run(tool, monkeypatch, *arguments) == 1
    assert message in capsys.readouterr().out


def test_nothing_to_compare_is_a_failure(tool: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert run(tool, monkeypatch, str(tmp_path / "missing.ply"), "--methods", "3dr-full") == 1
