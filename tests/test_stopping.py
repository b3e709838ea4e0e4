"""Paths that stop early and go on: time budgets, interruptions, --resume."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from clrast import load, render
from clrast.__main__ import main
from clrast.errors import SceneError, UsageError
from clrast.image.read import read_parts
from clrast.renderer import render as render_frame
from clrast.shading.watch import Watch

ROOT = Path(__file__).resolve().parents[1]

CARD = """
[[camera]]
eye = [0.0, 1.0, 4.0]
look_at = [0.0, 0.5, 0.0]
[environment]
color = [0.2, 0.3, 0.5]
[[light]]
kind = "point"
intensity = 20.0
position = [1.0, 3.0, 1.0]
[[mesh]]
shape = "plane"
scale = [6.0, 1.0, 6.0]
[[mesh]]
shape = "box"
translate = [0.0, 0.6, 0.0]
"""
PATHS = {"mode": "path", "size": (24, 16), "aov": "color"}


def channels_of(path: Path) -> dict[str, np.ndarray]:
    return {name: values for part in read_parts(path) for name, values in part.channels.items()}


@pytest.fixture
def card(tmp_path: Path) -> Path:
    path = tmp_path / "box.toml"
    path.write_text(CARD)
    return path


@pytest.mark.parametrize("aa", ["none", "ssaa:2", "msaa:4"])
def test_going_on_gives_the_bits_of_a_render_that_never_stopped(card: Path, tmp_path: Path, aa: str) -> None:
    scene, sums = load(card), str(tmp_path / "sums.npz")
    whole = render(scene, samples=7, aa=aa, **PATHS)
    first = render_frame(scene, mode="path", size=(24, 16), aov="color", samples=7, aa=aa, resume=sums,
                         watch=Watch(interrupted=True))  # fmt: skip
    assert first.stats["stopped"] == "interrupted" and first.header["samples"] == "1"
    assert first.stats["counts"]["rays_indirect"] > 0
    second = render(scene, samples=4, aa=aa, resume=sums, **PATHS)
    third = render(scene, samples=7, aa=aa, resume=sums, **PATHS)
    for name in "RGBA":
        assert np.array_equal(third[name].view(np.uint32), whole[name].view(np.uint32))
    assert not np.array_equal(second["R"], whole["R"]), "fewer paths are another image"
    assert third.stats["stopped"] is None and third.header == whole.header


def test_sums_of_another_render_are_refused(card: Path, tmp_path: Path) -> None:
    scene, sums = load(card), tmp_path / "sums.npz"
    render(scene, samples=2, resume=str(sums), **PATHS)
    with pytest.raises(SceneError, match="another scene, view or options"):
        render(scene, samples=2, resume=str(sums), seed=1, **PATHS)
    with pytest.raises(SceneError, match="another scene, view or options"):
        render(scene, samples=2, resume=str(sums), **{**PATHS, "size": (16, 16)})
    for damage in (b"", b"no sums", sums.read_bytes()[:200]):
        sums.write_bytes(damage)
        with pytest.raises(SceneError, match="no file of sums"):
            render(scene, samples=2, resume=str(sums), **PATHS)
    assert main(["render", str(card), "--mode", "path", "-o", str(tmp_path / "x.exr"), "--resume", str(sums)]) == 65
    assert not (tmp_path / "x.exr").exists()


def test_what_traces_no_paths_has_no_sums(card: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="--mode path"):
        render(load(card), size=(8, 8), resume=str(tmp_path / "sums.npz"))
    with pytest.raises(UsageError, match="auto"):
        render(load(card), aa="auto:0.1", resume=str(tmp_path / "sums.npz"), **PATHS)
    for aa in ("msaa:4", "csaa:4+4"):
        with pytest.raises(UsageError, match="--shading-rate auto the samples depend"):
            render(load(card), aa=aa, shading_rate="auto:0.1", resume=str(tmp_path / "sums.npz"), **PATHS)
    assert main(["render", str(card), "--mode", "path", "-o", str(tmp_path / "x.exr"), "--time-budget", "0"]) == 64


def test_a_spent_budget_leaves_a_complete_image(card: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "x.exr"
    arguments = ["render", str(card), "--mode", "path", "--size", "24x16", "--samples", "9", "-q", "-o", str(out)]
    assert main([*arguments, "--time-budget", "1e-6"]) == 75
    assert "--time-budget" in capsys.readouterr().err
    found = channels_of(out)
    one = render(load(card), samples=1, **PATHS)
    for name in "RGBA":
        assert np.array_equal(found[name], one[name]), "one path a sample at least"
    assert main([*arguments, "--time-budget", "1000"]) == 0


@pytest.mark.parametrize(
    ("given", "mend"),
    [([], "--resume FILE goes on"), (["--aa", "msaa:2"], "--resume FILE goes on"), (["--aa", "auto:0.1"], "more time"),
     (["--aa", "msaa:2", "--shading-rate", "auto"], "more time")],
)  # fmt: skip
def test_what_a_spent_budget_advises_is_what_may_be_done(
    card: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], given: list[str], mend: str
) -> None:
    arguments = ["render", str(card), "--mode", "path", "--size", "24x16", "--samples", "9", "-q", *given]
    arguments += ["-o", str(tmp_path / "x.exr")]
    assert main([*arguments, "--time-budget", "1e-6"]) == 75
    assert mend in capsys.readouterr().err
    resumes = main([*arguments, "--resume", str(tmp_path / "sums.npz")]) == 0
    assert resumes == ("goes on" in mend)


@pytest.mark.skipif(os.name != "posix", reason="signals are sent as on POSIX systems")
def test_an_interruption_leaves_a_complete_image(card: Path, tmp_path: Path) -> None:
    out, sums = tmp_path / "x.exr", tmp_path / "sums.npz"
    command = [sys.executable, "-P", "-m", "clrast", "render", str(card), "--mode", "path", "--size", "64x48",
               "--samples", "100000", "-o", str(out), "--resume", str(sums), "-q"]  # fmt: skip
    process = subprocess.Popen(command, env={**os.environ, "PYTHONPATH": str(ROOT)}, stderr=subprocess.PIPE, text=True)
    time.sleep(6)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130, said
    assert said.splitlines() == ["clrast: error: interrupted"]
    if out.exists():  # not where the interruption came before the render
        assert channels_of(out)["R"].shape == (48, 64) and sums.exists()
