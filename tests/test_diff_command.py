"""`clrast diff` as a command: exit codes, the last line, JSON, and one line for every error."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import clrast
from clrast.commands.entry import run
from clrast.errors import InputNotFoundError, OutputError, SceneError
from clrast.image.frame import Frame


def image(value: float) -> Frame:
    """Colour, depth, normals and ids of 10x8 pixels; R is `value` at x=4, y=3."""
    random = np.random.default_rng(5)
    channels = {name: random.random((8, 10), np.float32) for name in ("R", "G", "B", "A", "Z", "N.X", "N.Y", "N.Z")}
    for name in ("id.prim", "id.object", "id.material"):
        channels[name] = random.integers(0, 100000, (8, 10)).astype(np.uint32)
    channels["R"][3, 4] = value
    return Frame(channels)


@pytest.fixture
def pair(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    image(0.25).save("a.exr")
    image(0.5).save("b.exr")
    return tmp_path


def test_command_says_what_and_what_would_pass(pair, capsys):
    assert run(["diff", "a.exr", "a.exr"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "PASS: 11 channels are equal"
    assert run(["diff", "a.exr", "b.exr", "-o", "d.png"]) == 2
    captured = capsys.readouterr()
    line = "FAILURE: R at (4, 3): 0.25 in a.exr, 0.5 in b.exr, error 0.25; 1 pixel over 1e-06; --fail 0.25 would pass"
    assert captured.out.splitlines()[-1] == line and captured.err == "" and "\x1b" not in captured.out
    assert (pair / "d.png").exists()
    assert run(["diff", "a.exr", "b.exr", "--fail", "0.25"]) == 0
    assert run(["diff", "a.exr", "b.exr", "--failpercent", "2"]) == 1
    assert run(["diff", "a.exr", "b.exr", "--rule", "R=0.25", "-a", "-q"]) == 0
    capsys.readouterr()


def test_command_prints_json(pair, capsys):
    image(math.nan).save("c.exr")
    assert run(["diff", "a.exr", "c.exr", "--json"]) == 2

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is no JSON")

    report = json.loads(capsys.readouterr().out, parse_constant=refuse)
    assert (report["status"], report["exit_code"], report["passes_with"]) == ("failure", 2, None)
    worst = next(found for found in report["channels"] if found["channel"] == "R")
    assert (worst["worst"], worst["reference_value"], worst["test_value"]) == ([4, 3], 0.25, "nan")
    assert run(["diff", "a.exr", "nothing.exr", "--json"]) == 4
    assert json.loads(capsys.readouterr().out)["exit_code"] == 4


def test_unreadable_files_are_code_4(pair, capsys):
    whole = Path("a.exr").read_bytes()
    Path("cut.exr").write_bytes(whole[: len(whole) // 2])
    Path("text.exr").write_text("no image")
    Path("folder.exr").mkdir()
    for name in ("nothing.exr", "cut.exr", "text.exr", "folder.exr", "a.jpg", "text.exr/x.exr"):
        for arguments in ((name, "a.exr"), ("a.exr", name), (name, name)):
            assert run(["diff", *arguments, "-o", "d.exr"]) == 4
            captured = capsys.readouterr()
            assert captured.out == "" and captured.err.count("\n") == 1 and name.split("/")[0] in captured.err
    assert not Path("d.exr").exists()
    with pytest.raises(InputNotFoundError):
        clrast.diff("nothing.exr", "a.exr")
    with pytest.raises(SceneError):
        clrast.diff("cut.exr", "a.exr")


def test_wrong_usage_and_outputs(pair, capsys):
    before = sorted(os.listdir())
    for arguments, code in [
        (["a.exr"], 64), (["a.exr", "b.exr", "c.exr"], 64), (["a.exr", "b.exr", "--fail", "x"], 64),
        (["a.exr", "b.exr", "--fail", "-1"], 64), (["a.exr", "b.exr", "--fail", "nan"], 64),
        (["a.exr", "b.exr", "--fail", "1", "--fail", "2"], 64), (["a.exr", "b.exr", "--rule", "R"], 64),
        (["a.exr", "b.exr", "--rule", "R=x"], 64), (["a.exr", "b.exr", "--rule", "nope=1"], 64),
        (["a.exr", "b.exr", "-o", "d.jpg"], 64), (["a.exr", "b.exr", "-o", "./a.exr"], 64),
        (["a.exr", "b.exr", "-o", "missing/d.png"], 73), (["a.exr", "b.exr", "--allowfailures", "1.5"], 64),
    ]:  # fmt: skip
        assert run(["diff", *arguments]) == code, arguments
        captured = capsys.readouterr()
        assert captured.out == "" and captured.err.count("\n") == 1
    assert sorted(os.listdir()) == before
    with pytest.raises(OutputError):
        clrast.diff("a.exr", "b.exr", output="missing/d.png")


def test_command_on_a_terminal(pair):
    import pty

    leader, follower = pty.openpty()
    environment = dict(os.environ, TERM="xterm", COLUMNS="200", PYTHONPATH=str(Path(__file__).resolve().parents[1]))
    command = [sys.executable, "-m", "clrast", "diff", "a.exr", "b.exr"]
    process = subprocess.Popen(command, stdout=follower, stderr=subprocess.PIPE, env=environment)
    os.close(follower)
    shown = b""
    try:
        while chunk := os.read(leader, 4096):
            shown += chunk
    except OSError:  # Linux says EIO where the other end is closed
        pass
    os.close(leader)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 2 and errors == b""
    assert b"\x1b[" in shown and b"FAILURE: R at (4, 3)" in shown and b"id.material" in shown


def test_a_table_hides_no_markup(pair, capsys):
    names = {"[red]layer[/red].X": np.zeros((2, 2), np.float32)}
    Frame(names).save("m.exr")
    assert run(["diff", "m.exr", "m.exr"]) == 0
    assert "[red]layer[/red].X" in capsys.readouterr().out
