"""Golden images: two small scenes, every channel, exactly as stored. --update-golden stores them anew: look at
them first (`clrast render ... -o picture.png`). A golden that is missing fails."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from small_renders import ROOT, small_renders

import clrast

GOLDEN = ROOT / "data" / "golden"
MOST_BYTES = 200_000
VIEWS: dict[str, dict[str, str]] = {
    "room": {},  # textures, MASK, BLEND, emission, point, spot and directional light; perspective
    "lamps": {"projection": "orthographic"},  # unlit, emission, vertex colours, headlight, framed
}
"""Name of a golden and of its scene -> options beside size and channels."""


def compare(golden: Path, frame: clrast.Frame, folder: Path) -> None:
    """Fails where any bit of a channel or of the header differs; result and heat map are left in `folder`."""
    if not golden.exists():
        frame.save(folder / golden.name)
        pytest.fail(f"{golden} is missing; this render is {folder / golden.name}: look, then give --update-golden")
    heat_map = folder / f"{golden.stem}-difference.png"
    report = clrast.diff(
        golden, frame, output=heat_map, output_only_different=True, fail=0, warn=0, hardfail=0, header=True
    )
    if report.equal and report.exit_code == 0:
        return
    result = folder / golden.name
    frame.save(result)
    pytest.fail(f"{golden.name}: {report.verdict}; result {result}, heat map {heat_map}")


@pytest.mark.parametrize("name", VIEWS)
def test_golden(name: str, tmp_path: Path, update_golden: bool) -> None:
    scene = clrast.load(small_renders(tmp_path)[name].source)
    frame = clrast.render(scene, size=(64, 64), aov="all", **VIEWS[name])
    golden = GOLDEN / f"{name}.exr"
    if update_golden:
        GOLDEN.mkdir(exist_ok=True)
        frame.save(golden)
    compare(golden, frame, tmp_path)
    assert golden.stat().st_size < MOST_BYTES


def test_one_bit_fails_and_its_pixel_is_named(tmp_path: Path) -> None:
    frame = clrast.Frame.load(GOLDEN / "room.exr")
    changed = {name: values.copy() for name, values in frame.channels.items()}
    changed["N.Y"].view(np.uint32)[40, 23] ^= 1
    with pytest.raises(pytest.fail.Exception, match=r"N\.Y at \(23, 40\)"):
        compare(GOLDEN / "room.exr", clrast.Frame(changed, frame.header), tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["room-difference.png", "room.exr"]
    assert (clrast.Frame.load(tmp_path / "room.exr")["N.Y"] == changed["N.Y"]).all()


def test_another_id_or_header_fails(tmp_path: Path) -> None:
    frame = clrast.Frame.load(GOLDEN / "lamps.exr")
    changed = {name: values.copy() for name, values in frame.channels.items()}
    changed["id.object"][5, 60] ^= 1
    with pytest.raises(pytest.fail.Exception, match=r"id\.object at \(60, 5\)"):
        compare(GOLDEN / "lamps.exr", clrast.Frame(changed, frame.header), tmp_path)
    header = {**frame.header, "version": "0"}
    with pytest.raises(pytest.fail.Exception, match="version"):
        compare(GOLDEN / "lamps.exr", clrast.Frame(frame.channels, header), tmp_path)


def test_a_missing_golden_fails(tmp_path: Path) -> None:
    frame = clrast.Frame.load(GOLDEN / "lamps.exr")
    with pytest.raises(pytest.fail.Exception, match="is missing"):
        compare(tmp_path / "gone" / "none.exr", frame, tmp_path)
    assert (tmp_path / "none.exr").exists()
