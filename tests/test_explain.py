"""`clrast explain`: the plan, and expected figures against those of the render itself."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from clrast import load, render
from clrast.__main__ import main
from clrast.options import EFFECTS

MIRROR = """
[[camera]]
eye = [0.0, 1.0, 4.0]
look_at = [0.0, 0.5, 0.0]
[[light]]
kind = "point"
name = "lamp"
intensity = 20.0
position = [1.0, 3.0, 1.0]
[[material]]
name = "steel"
metallic = 1.0
roughness = 0.0
[[mesh]]
shape = "plane"
scale = [6.0, 1.0, 6.0]
[[mesh]]
shape = "box"
material = "steel"
translate = [0.0, 0.6, 0.0]
"""


@pytest.fixture
def card(tmp_path: Path) -> str:
    path = tmp_path / "mirror.toml"
    path.write_text(MIRROR)
    return str(path)


def explained(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, dict[str, object]]:
    assert main(["explain", *arguments, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    rows = {row["name"]: row for row in found["effects"]}
    assert tuple(rows) == EFFECTS
    assert all(row["reason"] for row in rows.values())
    return rows


def test_expected_rays_are_near_those_of_the_render(card: str, capsys: pytest.CaptureFixture[str]) -> None:
    rows = explained(capsys, card, "--mode", "whitted", "--size", "400x300")
    counts = render(load(card), mode="whitted", size=(400, 300)).stats["counts"]
    # Bounds: shares of a 400x300 image found in one of a seventh of its pixels are off by a few edge pixels.
    assert rows["shadow"]["rays_expected"] == pytest.approx(counts["rays_shadow"], rel=0.05)
    assert rows["reflection"]["rays_expected"] == pytest.approx(counts["rays_reflection"], rel=0.05)
    assert rows["refraction"]["rays_expected"] == counts["rays_refraction"] == 0
    assert rows["shadow"]["on"] and "lamp" in str(rows["shadow"]["reason"])
    assert rows["reflection"]["on"] and "steel" in str(rows["reflection"]["reason"])
    assert "trace_any" in rows["shadow"]["kernels"]  # type: ignore[operator]


def test_kernels_of_paths_are_named(card: str, capsys: pytest.CaptureFixture[str]) -> None:
    rows = explained(capsys, card, "--mode", "path", "--plan-only")
    assert rows["shadow"]["kernels"] == ["shade_paths", "trace_any", "add_paths"]
    assert "shade_paths" in rows["indirect light"]["kernels"]  # type: ignore[operator]


def test_the_structure_of_secondary_rays_is_named(card: str, capsys: pytest.CaptureFixture[str]) -> None:
    taken = {}
    for name, what in (("auto", "BVH"), ("bvh", "BVH"), ("grid", "uniform grid")):
        rows = explained(capsys, card, "--mode", "whitted", "--accelerator", name, "--plan-only")
        row = rows["secondary acceleration structure"]
        assert row["reason"] == f"{what}, for shadow and reflection"
        taken[name] = row["bytes"]
    assert taken["auto"] == taken["bvh"] < taken["grid"]  # type: ignore[operator]
    frame = render(load(card), mode="whitted", size=(40, 30), accelerator="grid")
    (row,) = (row for row in frame.stats["effects"] if row["name"] == "secondary acceleration structure")
    assert frame.stats["accelerator"] == "grid" and row["reason"] == f"{what}, for shadow and reflection"
    assert frame.stats["times_ms"]["build"] > 0
    assert render(load(card), size=(40, 30)).stats["accelerator"] is None


def test_a_plan_alone_renders_nothing(card: str, capsys: pytest.CaptureFixture[str]) -> None:
    rows = explained(capsys, card, "--mode", "path", "--plan-only")
    assert rows["indirect light"]["on"] and rows["indirect light"]["rays_expected"] is None
    rows = explained(capsys, card, "--plan-only")
    assert not any(rows[name]["on"] for name in ("shadow", "reflection", "secondary acceleration structure"))


def test_usage_errors_come_before_the_file_is_read(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "missing.toml", "--mode", "wrong"]) == 64
    assert main(["explain", "missing.toml"]) == 66
