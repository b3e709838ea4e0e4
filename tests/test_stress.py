"""`clrast stress`: the cases of data/hard/, the counts against exact arithmetic, and an exit code that can be 1."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clrast.__main__ import main
from clrast.options import AVAILABLE_PRECISIONS
from clrast.scene.load import load
from clrast.study import stress as stress_module
from clrast.study.hard_cases import CASE_NAMES, REFUSALS, make_case

HARD = Path(__file__).resolve().parents[1] / "data" / "hard"
FEW = "fan-4,hubs,near-plane,offset-1e6,coplanar-roofs,nan"


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    code = main(["stress", "-q", *arguments])
    return int(code or 0), capsys.readouterr().out


@pytest.mark.parametrize("name", CASE_NAMES)
def test_the_card_of_a_case_is_the_case(name: str) -> None:
    case, scene = make_case(name), load(HARD / f"{name}.toml")
    np.testing.assert_array_equal(scene.positions.view(np.uint32), case.positions.view(np.uint32))
    np.testing.assert_array_equal(scene.triangles, case.triangles)
    assert [camera.name for camera in scene.cameras] == [camera.name for camera in case.cameras]
    assert case.hard.endswith(".") and not set(case.wrong) & set(case.right)
    assert "exact" in case.right


@pytest.mark.parametrize("name", REFUSALS)
def test_what_is_no_number_is_refused(name: str) -> None:
    assert REFUSALS[name].exit_code() == 65


def test_exact_gives_no_wrong_sample_and_float32_does(capsys: pytest.CaptureFixture[str]) -> None:
    code, out = run(capsys, "--case", FEW, "--method", "3dr-binning", "--precision", "fast,exact")
    assert code == 0, out
    assert "exact: 0 wrong of" in out


def test_a_wrong_buffer_is_exit_1(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """The whole command with one sample given away, in place of the renderer's own."""
    real = stress_module.render_frame

    def spoilt(*arguments: Any) -> tuple[np.ndarray, np.ndarray]:
        prim_id, depth = real(*arguments)
        prim_id[tuple(n // 2 for n in prim_id.shape)] ^= 1
        return prim_id, depth

    monkeypatch.setattr(stress_module, "render_frame", spoilt)
    code, out = run(capsys, "--case", "hubs", "--method", "3dr-binning", "--precision", "exact")
    assert code == 1 and "BROKEN" in out


def test_the_table_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    code, out = run(capsys, "--case", "nan,hubs", "--method", "3dr-binning", "--precision", "exact", "--json")
    assert code == 0 and json.loads(out)


def test_an_unknown_case_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(capsys, "--case", "hard-luck")[0] == 64


@pytest.mark.long
def test_every_case_every_method_every_rung(capsys: pytest.CaptureFixture[str]) -> None:
    code, out = run(capsys)
    assert code == 0, out
    assert "not as expected" not in out and "exact" in AVAILABLE_PRECISIONS
