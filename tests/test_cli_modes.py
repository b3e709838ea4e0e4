"""`clrast render --mode` as typed: exit codes, warnings, headers, hostile values."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import runtimes

import clrast
from clrast.__main__ import main

CARD = """
[[camera]]
eye = [0.0, 1.5, 4.0]
look_at = [0.0, 0.5, 0.0]
[[light]]
kind = "point"
intensity = 20.0
position = [1.0, 3.0, 1.0]
[[material]]
name = "mirror"
base_color = [1.0, 1.0, 1.0]
metallic = 1.0
roughness = 0.0
[[mesh]]
shape = "plane"
scale = [6.0, 1.0, 6.0]
[[mesh]]
shape = "box"
translate = [0.0, 0.6, 0.0]
"""
MIRRORED = CARD + 'material = "mirror"\n'
UNLIT = CARD.replace('[[light]]\nkind = "point"\nintensity = 20.0\nposition = [1.0, 3.0, 1.0]\n', "")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in (("lit", CARD), ("mirrored", MIRRORED), ("plain", UNLIT)):
        (tmp_path / f"{name}.toml").write_text(text)
    return tmp_path


def render(folder: Path, name: str, *arguments: str) -> int:
    out = str(folder / "out.exr")
    return main(["render", str(folder / f"{name}.toml"), "-o", out, "--size", "16x16", "-q", *arguments])


def header(folder: Path, name: str, *arguments: str) -> dict[str, Any]:
    assert render(folder, name, *arguments) == 0
    return dict(clrast.Frame.load(folder / "out.exr").header)


def entry(found: dict[str, Any], name: str) -> Any:
    return found.get(name, found.get(f"clrast:{name}"))


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        (("--mode", "ray"), "cast, shadow, whitted or path"),
        (("--mode", "Path"), "path"),
        (("--mode", ""), "--mode"),
        (("--mode", "path", "--max-depth", "-1"), "--max-depth -1 is out of range"),
        (("--mode", "path", "--max-depth", "1001"), "--max-depth 1001 is out of range"),
        (("--mode", "path", "--max-depth", "1.5"), "--max-depth '1.5' is not a number"),
        (("--mode", "path", "--samples", "0"), "--samples 0 is out of range"),
        (("--mode", "path", "--samples", "-4"), "--samples -4 is out of range"),
        (("--mode", "path", "--samples", "99999999999999999999"), "--samples 99999999999999999999 is out of range"),
        (("--mode", "path", "--samples", "nan"), "--samples 'nan' is not a number"),
        (("--mode", "path", "--seed", "-1"), "--seed -1 is out of range"),
        (("--mode", "path", "--seed", "4294967296"), "--seed 4294967296 is out of range"),
        (("--mode", "path", "--effects", "indirect_light=maybe"), "indirect_light"),
        (("--effects", "shadows=on"), "did you mean shadow"),
    ],
    ids=" ".join,
)
def test_hostile_values(folder: Path, capsys: pytest.CaptureFixture[str], arguments: Any, wanted: str) -> None:
    """Exit 64, one line that names option and mend, and no file."""
    assert render(folder, "lit", *arguments) == 64
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and lines[0].startswith("clrast: error: ") and wanted in lines[0]
    assert not (folder / "out.exr").exists()


@pytest.mark.parametrize("mode", ["cast", "shadow", "whitted", "path"])
def test_options_that_a_mode_does_not_read_are_named(
    folder: Path, capsys: pytest.CaptureFixture[str], mode: str
) -> None:
    assert render(folder, "lit", "--mode", mode, "--samples", "2", "--max-depth", "1") == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if "warning" in line]
    unread = {"cast": ["samples", "max-depth"], "shadow": ["samples", "max-depth"], "whitted": ["samples"], "path": []}
    assert len(lines) == len(unread[mode])
    for line, name in zip(lines, unread[mode], strict=True):
        assert line.startswith("warning: ") or line.startswith("clrast: warning: ")
        assert f"--{name} is not used in mode {mode}" in line


@pytest.mark.parametrize(
    ("arguments", "unread"),
    [
        (("--filter", "tent", "--shading-rate", "sample"), ("filter", "shading-rate")),
        (("--aa", "ssaa:2", "--filter", "tent", "--shading-rate", "sample"), ("shading-rate",)),
        (("--aa", "auto:0.1", "--shading-rate", "auto"), ("shading-rate",)),
        (("--aa", "msaa:2", "--filter", "tent", "--shading-rate", "sample"), ()),
    ],
    ids=" ".join,
)
def test_options_that_antialiasing_does_not_read_are_named(
    folder: Path, capsys: pytest.CaptureFixture[str], arguments: Any, unread: tuple[str, ...]
) -> None:
    assert render(folder, "lit", *arguments) == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if "is not used by --aa" in line]
    assert {line.split("--")[1].split()[0] for line in lines} == set(unread)


def test_antialiasing_of_no_colour_is_in_no_header(folder: Path) -> None:
    """The pixels are the same, so the files are."""
    files = []
    for more in ((), ("--aa", "msaa:4", "--filter", "tent"), ("--quality", "draft")):
        assert render(folder, "lit", "--aov", "id", *more) == 0
        files.append((folder / "out.exr").read_bytes())
    assert files[0] == files[1] == files[2]
    assert entry(header(folder, "lit", "--aov", "color,id", "--aa", "msaa:4"), "aa") == "msaa:4"


def test_samples_that_cannot_share_shading_are_said(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Where surfaces blend each sample has layers of its own: the note names the mode that it is."""
    glass = CARD.replace('name = "mirror"', 'name = "mirror"\nalpha_mode = "BLEND"') + 'material = "mirror"\n'
    (folder / "glass.toml").write_text(glass.replace("1.0, 1.0, 1.0, 1.0", "1.0, 1.0, 1.0, 0.5"))
    for name, aa, rate, same in (
        ("glass", "csaa:2+6", "pixel", "ssaa:2"), ("glass", "msaa:4", "sample", "ssaa:4"),
        ("glass", "msaa:4", "auto", None), ("lit", "msaa:4", "pixel", None),
    ):  # fmt: skip
        out, given = str(folder / "out.exr"), ["--aa", aa, "--shading-rate", rate]
        assert main(["render", str(folder / f"{name}.toml"), "-o", out, "--size", "16x16", *given]) == 0
        lines = [line for line in capsys.readouterr().err.splitlines() if "surfaces blend here" in line]
        assert len(lines) == (same is not None) and all(f"those of {same}; --shading-rate auto" in s for s in lines)
    found = clrast.Frame.load(folder / "out.exr")
    assert found.header["aa"] == "msaa:4"


def test_headers_say_what_decides_pixels(folder: Path) -> None:
    """The mode always; depth where rays go on, samples and seed where they are drawn, as they were resolved."""
    cast = header(folder, "lit")
    assert entry(cast, "mode") == "cast"
    assert all(entry(cast, name) is None for name in ("samples", "seed", "max_depth"))
    shadow = header(folder, "lit", "--mode", "shadow", "--seed", "5")
    assert entry(shadow, "mode") == "shadow" and "shadow" in entry(shadow, "effects").split(",")
    assert all(entry(shadow, name) is None for name in ("samples", "seed", "max_depth"))
    whitted = header(folder, "mirrored", "--mode", "whitted", "--max-depth", "3")
    assert str(entry(whitted, "max_depth")) == "3" and entry(whitted, "samples") is None
    diffuse = header(folder, "lit", "--mode", "whitted")
    assert entry(diffuse, "max_depth") is None
    path = header(folder, "lit", "--mode", "path", "--samples", "2", "--seed", "9")
    assert [str(entry(path, name)) for name in ("samples", "seed", "max_depth")] == ["2", "9", "8"]
    plain = header(folder, "plain", "--mode", "path")
    assert entry(plain, "samples") is None and entry(plain, "max_depth") is None


def test_the_same_file_every_time(folder: Path) -> None:
    """Byte for byte; and whatever machine options were given."""
    options = ("--mode", "path", "--samples", "2", "--max-depth", "2")
    assert render(folder, "mirrored", *options) == 0
    first = (folder / "out.exr").read_bytes()
    for more in ((), ("-t", "1"), ("--method", "raycast-bvh"), ("--memory", "64M")):
        assert render(folder, "mirrored", *options, *more) == 0
        assert (folder / "out.exr").read_bytes() == first, more


def test_a_card_may_set_the_mode(folder: Path) -> None:
    (folder / "set.toml").write_text('render = { mode = "path", samples = 3, seed = 4, max_depth = 1 }\n' + CARD)
    found = header(folder, "set")
    assert [str(entry(found, name)) for name in ("mode", "samples", "seed", "max_depth")] == ["path", "3", "4", "1"]
    assert entry(header(folder, "set", "--mode", "cast"), "mode") == "cast"


@pytest.mark.parametrize(
    ("table", "wanted"),
    [
        ('render = { mode = "paths" }', "--mode"),
        ("render = { samples = 0 }", "--samples"),
        ("environment = { color = [-1, 0, 0] }", "environment"),
        ("environment = { color = [nan, 0, 0] }", "environment"),
        ("environment = { color = [1, 0] }", "environment"),
        ("environment = { colour = [1, 0, 0] }", "environment"),
        ("environment = { color = [1e31, 0, 0] }", "environment"),
    ],
)
def test_cards_that_make_no_sense(folder: Path, capsys: pytest.CaptureFixture[str], table: str, wanted: str) -> None:
    (folder / "bad.toml").write_text(f"{table}\n{CARD}")
    assert render(folder, "bad") == 65
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and wanted in lines[0] and not (folder / "out.exr").exists()


def test_the_brightest_environment_is_finite_or_refused(folder: Path) -> None:
    """Radiance up to 1e30 is allowed: colours stay finite."""
    (folder / "sun.toml").write_text("environment = { color = [1e30, 1, 0], intensity = 1e30 }\n" + MIRRORED)
    assert render(folder, "sun", "--mode", "path", "--samples", "2") == 0
    frame = clrast.Frame.load(folder / "out.exr")
    assert all(np.isfinite(frame[channel]).all() for channel in "RGB") and frame["R"].max() > 1e20


def test_rays_on_a_driver_that_limits_loops(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit 69, one line, no file; where the scene calls for no ray the mode works there as well."""
    if "rusticl" not in runtimes().working:
        pytest.skip("rusticl is not installed or does not work here")
    assert render(folder, "lit", "--mode", "shadow", "--device", "rusticl") == 69
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and "--device" in lines[0] and not (folder / "out.exr").exists()
    assert render(folder, "plain", "--mode", "path", "--device", "rusticl") == 0


def test_stats_of_modes(folder: Path) -> None:
    """Kinds of rays in the stats, and the hierarchy's time where there is one."""
    stats = folder / "stats.json"
    for mode, kinds in (("cast", set()), ("whitted", {"rays_shadow", "rays_reflection"})):
        assert render(folder, "mirrored", "--mode", mode, "--stats", str(stats)) == 0
        found = json.loads(stats.read_text())
        assert found["mode"] == mode
        secondary = ("rays_shadow", "rays_reflection", "rays_refraction", "rays_indirect")
        assert {name for name in secondary if found["counts"][name]} == kinds
        assert all(isinstance(found["counts"][name], int) for name in secondary)
        assert (found["times_ms"]["build"] > 0) == bool(kinds)
