"""tools/hashes.py: the stored table of AOV hashes, held here and now; the rest of it with --long, on every runtime."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from clrast.opencl.device import Device
from clrast.visibility.methods import SNAPPED_METHODS

TOOL = Path(__file__).resolve().parents[1] / "tools" / "hashes.py"


@pytest.fixture(scope="module")
def tool():
    """The tool as a module."""
    spec = importlib.util.spec_from_file_location("hashes", TOOL)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["hashes"] = module
    spec.loader.exec_module(module)
    return module


def test_digest_sees_every_bit(tool) -> None:
    """Signs of zero, the order of planes, and that the bytes are little-endian wherever this runs."""
    one = np.array([[0.0, 1.0]], np.float32)
    assert tool.digest(one) != tool.digest(-one * np.float32(0) + one * [[-0.0, 1.0]])
    assert tool.digest(one, 2 * one) != tool.digest(2 * one, one)
    assert tool.digest(one) == tool.digest(one.astype(">f4"))


def test_the_table_has_every_scene_and_method(tool) -> None:
    """No row was lost: every method with 3D edges, on the rungs that all of them have, in one group."""
    table = json.loads(tool.TABLE.read_text())
    rows = {view.name: view.rows for view in tool.views()}
    assert list(table) == list(rows)
    for name, rungs in table.items():
        assert {"fast", "ordered", "midpoint"} <= set(rungs)
        for rung, groups in rungs.items():
            found = [row for group in groups for row in group["methods"]]
            if rung == "fixed":  # for projected vertices alone
                assert set(found) <= set(SNAPPED_METHODS) and len(groups) <= 1
                continue
            assert len(found) == len(set(found)) and (rung == "exact" or set(found) == set(rows[name]))
            spatial = [g for g in groups if "3dr-binning" in g["methods"]]
            assert len(spatial) == 1 and "3dr-full" in spatial[0]["methods"]
            assert all(len(bytes.fromhex(group[image])) == 32 for group in groups for image in tool.IMAGES)


def test_a_part_of_the_table(device: Device, tool, capsys: pytest.CaptureFixture[str]) -> None:
    """Two scenes by one method on every runtime."""
    arguments = ["--device", device.runtime, "--scenes", "cube,crossing", "--precision", "midpoint"]
    assert tool.main([*arguments, "--methods", "3dr-binning"]) == 0, capsys.readouterr().out
    assert f"{device.runtime}: 6 images equal, 0 different" in capsys.readouterr().out


@pytest.mark.small
@pytest.mark.long
def test_the_table_on_an_interpreter(device: Device, tool, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--device", device.runtime, "--scenes", "cube", "--precision", "midpoint", "--methods", "3dr-binning"]
    assert tool.main(arguments) == 0, capsys.readouterr().out


@pytest.mark.long
def test_the_whole_table(device: Device, tool, capsys: pytest.CaptureFixture[str]) -> None:
    assert tool.main(["--device", device.runtime]) == 0, capsys.readouterr().out


def test_another_hash_fails(
    device: Device, tool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One digit of one hash: exit 1, and its row is named. Unknown names are usage errors."""
    table = json.loads(tool.TABLE.read_text())
    group = table["cube"]["midpoint"][0]
    group["Z"] = ("0" if group["Z"][0] != "0" else "1") + group["Z"][1:]
    changed = tmp_path / "table.json"
    changed.write_text(json.dumps(table))
    monkeypatch.setattr(tool, "TABLE", changed)
    page = tmp_path / "page.md"
    arguments = ["--device", device.runtime, "--scenes", "cube", "--precision", "midpoint", "--markdown", str(page)]
    assert tool.main([*arguments, "--methods", "3dr-binning"]) == 1
    assert "DIFFERENT: cube, midpoint, 3dr-binning: Z" in capsys.readouterr().out
    assert "| cube | midpoint | 2 of 3 |" in page.read_text()
    assert tool.main(["--precision", "midpiont"]) == 64
    assert tool.main(["--device", "none", "--scenes", "cube"]) == 69
