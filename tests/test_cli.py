"""The command line without a device: exit codes and their one line, outputs, help.

The renderer and the loader are stand-ins here (cli_world.py); tests/test_cli_render.py runs the real ones.
"""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import tomllib
from contextlib import chdir, redirect_stderr, redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from cli_world import World, fails, make_scene, make_world
from hypothesis import given, settings
from hypothesis import strategies as st

import clrast
from clrast import errors
from clrast.__main__ import main
from clrast.commands.stats import COUNTS, KEYS, STAGES
from clrast.options import EFFECTS
from clrast.scene.model import Camera, Scene


@pytest.fixture
def world(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> World:
    return make_world(tmp_path, monkeypatch)


# Usage: 64


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "no command given: use render, .*accuracy, .*devices"),
        (["rendr"], "did you mean render"),
        (["--nonsense"], "see 'clrast --help'"),
        (["render"], "INPUT.*see 'clrast render --help'"),
        (["render", "a.ply", "b.ply", "-o", "x.exr"], "b.ply"),
        (["render", "a.ply"], "no output: name an image"),
        (["render", "a.ply", "-o"], "requires an argument"),
        (["render", "a.ply", "-o", "x.jpg"], "name a file .exr or .png"),
        (["render", "a.ply", "-o", "x"], "name a file .exr or .png"),
        (["render", "a.ply", "-o", ""], "name a file .exr or .png"),
        (["render", "a.ply", "-o", "x.exr", "--stats", "./x.exr"], "another output too"),
        (["render", "a.ply", "-o", "x.exr", "--stats", "a.ply"], "the input too"),
        (["render", "a.ply", "-o", "x.exr", "--siz", "2x2"], "--size"),
        (["render", "a.ply", "-o", "x.exr", "--size", "2"], "--size '2' is not a size"),
        (["render", "a.ply", "-o", "x.exr", "--size", "2x2", "--size", "3x3"], "given as 2x2 and as 3x3"),
        (["render", "a.ply", "-o", "x.exr", "--eye", "0,0"], "--eye '0,0' is not a vector"),
        (["render", "a.ply", "-o", "x.exr", "--eye", "nan,0,0"], "--eye"),
        (["render", "a.ply", "-o", "x.exr", "--eye", "1,2,3", "--look-at", "1,2,3"], "eye equals look-at"),
        (["render", "a.ply", "-o", "x.exr", "--eye", "0,1,0", "--look-at", "0,-1,0"], "parallel"),
        (["render", "a.ply", "-o", "x.exr", "--up", "0,0,0"], "--up 0,0,0 has no direction"),
        (["render", "a.ply", "-o", "x.exr", "--fov", "180"], "between 0 and 180"),
        (["render", "a.ply", "-o", "x.exr", "--height", "0"], "--height"),
        (["render", "a.ply", "-o", "x.exr", "--camera", "a", "--eye", "0,0,1"], "contradicts"),
        (["render", "a.ply", "-o", "x.exr", "--projection", "latlong", "--method", "2dh-brute"], "use 3dr-brute"),
        (["render", "a.ply", "-o", "x.exr", "--projection", "paraboloid", "--precision", "fixed"], "use another rung"),
        (["render", "a.ply", "-o", "x.exr", "--projection", "latlong", "--evaluation", "incremental"], "use direct"),
        (["render", "a.ply", "-o", "x.exr", "--projection", "cube", "--size", "8x16"], "W x 6W"),
        (["render", "a.ply", "-o", "x.exr", "--projection", "fisheye", "--fov", "361"], "up to 360"),
        (["render", "a.ply", "-o", "x.exr", "--projection", "ortho"], "did you mean orthographic"),
        (["render", "a.ply", "-o", "x.exr", "-t", "0"], "--threads 0"),
        (["render", "a.ply", "-o", "x.exr", "--repeat", "0"], "--repeat 0"),
        (["render", "a.ply", "-o", "x.exr", "--memory", "lots"], "--memory 'lots'"),
        (["render", "a.ply", "-o", "x.exr", "--effects", "alpha=off"], "--effects"),
    ],
)
def test_usage_errors(capsys: pytest.CaptureFixture[str], arguments: list[str], message: str) -> None:
    """The input a.ply does not exist either: usage is checked before anything is read."""
    import re

    assert re.search(message, fails(capsys, 64, *arguments))


def test_usage_errors_that_need_the_scene(world: World, capsys: pytest.CaptureFixture[str]) -> None:
    line = fails(capsys, 64, "render", world.source, "-o", world.out(), "--camera", "0")
    assert "brings no camera" in line
    world.scene = make_scene(cameras=(Camera("front"), Camera("side")))
    for wanted in ("sid", "2", "-1", "Front"):
        line = fails(capsys, 64, "render", world.source, "-o", world.out(), "--camera", wanted)
        assert "0 'front', 1 'side'" in line
    line = fails(capsys, 64, "render", world.source, "-o", world.out(), "--eye", "1,9,0", "--look-at=1,2,0")
    assert "parallel" in line
    line = fails(capsys, 64, "render", world.source, "-o", world.out(), "--eye", "1,2,0")
    assert "eye equals look-at" in line
    assert world.files() == ["scene.ply"]


WORDS = st.sampled_from(
    ["render", "--help", "-h", "--size", "8x8", "-o", "x.exr", "--eye", "-1,2,3", "--aov", "all", "--", "-q", "=",
     "--effects", "alpha_mask=off", "--precision", "fast", "--repeat", "-t", "1", "--fov=", "nope.ply", "--version"]
) | st.text(max_size=6)  # fmt: skip


@settings(max_examples=150, deadline=None)
@given(st.lists(WORDS, max_size=8))
def test_any_command_line_ends_with_a_code(words: list[str]) -> None:
    """In an empty folder nothing can be rendered: help, wrong usage, no (sound) input, and never a fault."""
    with TemporaryDirectory() as empty, chdir(empty):
        with redirect_stderr(io.StringIO()) as said, redirect_stdout(io.StringIO()):
            code = main(["render", *words])
        assert os.listdir() == []
    assert code in (0, 64, 65, 66, 73)
    assert said.getvalue().count("\n") == (1 if code else 0)


# The other exit codes


def test_input_that_is_not_there(world: World, capsys: pytest.CaptureFixture[str]) -> None:
    assert "nope.ply does not exist" in fails(capsys, 66, "render", "nope.ply", "-o", world.out())


@pytest.mark.parametrize(
    ("fault", "code"),
    [
        (errors.SceneError("no triangle"), 65),
        (errors.InputNotFoundError("gone"), 66),
        (errors.DeviceError("no device"), 69),
        (errors.ClrastError("hm"), 70),
        (errors.OutputError("read-only"), 73),
        (errors.CapacityError("needs 3, has 2"), 75),
        (MemoryError("Unable to allocate 9 GiB"), 75),
        (KeyboardInterrupt(), 130),
        (ZeroDivisionError("by\nzero"), 70),
        (RecursionError("too deep"), 70),
    ],
)
def test_faults_of_the_renderer(
    world: World, capsys: pytest.CaptureFixture[str], fault: BaseException, code: int
) -> None:
    world.fault = fault
    line = fails(capsys, code, "render", world.source, "-o", world.out(), "--stats", world.out("s.json"))
    assert all(word in line for word in str(fault).split())
    if isinstance(fault, ZeroDivisionError):
        assert "ZeroDivisionError: by zero" in line and "CLRAST_DEBUG=1" in line
    assert world.files() == ["scene.ply"]


def test_debug_variable_brings_the_traceback(
    world: World, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CLRAST_DEBUG", "1")
    world.fault = ZeroDivisionError("by zero")
    assert main(["render", world.source, "-o", world.out()]) == 70
    assert "Traceback" in capsys.readouterr().err


def test_unwritable_output_is_found_before_loading(world: World, capsys: pytest.CaptureFixture[str]) -> None:
    world.load_fault = AssertionError("loaded")
    for outputs in (["-o", "gone/x.exr"], ["-o", world.out(), "--stats", "gone/s.json"]):
        assert "no folder" in fails(capsys, 73, "render", world.source, *outputs)
    assert world.files() == ["scene.ply"]


def test_a_missing_input_comes_before_an_unwritable_output(world: World, capsys: pytest.CaptureFixture[str]) -> None:
    fails(capsys, 66, "render", "nope.ply", "-o", "gone/x.exr")


# Outputs: all or none


def test_all_outputs_or_none(world: World, capsys: pytest.CaptureFixture[str]) -> None:
    Path(world.out("a.exr")).write_text("old")
    world.disk_is_full = True
    arguments = ["render", world.source, "-o", world.out("a.exr"), "-o", world.out("b.png")]
    line = fails(capsys, 73, *arguments, "--stats", world.out("s.json"))
    assert line.startswith(f"clrast: error: {world.out('b.png')}: cannot be written (No space left")
    assert world.files() == ["a.exr", "scene.ply"]
    assert Path(world.out("a.exr")).read_text() == "old"


def test_outputs_and_stats_are_written(world: World, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["-o", world.out("a.exr"), "-o", world.out("b.PNG"), "--stats", world.out("s.json")]
    assert main(["render", world.source, *arguments]) == 0
    assert capsys.readouterr().out == ""
    assert world.files() == ["a.exr", "b.PNG", "s.json", "scene.ply"]
    stats = json.loads(Path(world.out("s.json")).read_text())
    assert list(stats)[: len(KEYS)] == list(KEYS)
    assert list(stats["counts"]) == list(COUNTS) and stats["counts"]["samples"] is None
    assert list(stats["times_ms"]) == list(STAGES)
    assert [effect["name"] for effect in stats["effects"]] == list(EFFECTS)
    assert all(effect["reason"] and effect["on"] in (True, False) for effect in stats["effects"])
    times = stats["times_ms"]
    assert (times["setup"], times["visibility"], times["plan"]) == (1.5, 2.5, 0.0)
    assert times["load"] > 0 and times["write"] > 0 and times["total"] > times["load"] + times["write"]
    assert (stats["method"], stats["method_requested"]) == ("3dr-binning", "auto")


def test_a_link_stays_a_link(world: World) -> None:
    Path(world.out("real.exr")).write_text("old")
    os.symlink("real.exr", world.out("link.exr"))
    assert main(["render", world.source, "-o", world.out("link.exr")]) == 0
    assert os.path.islink(world.out("link.exr"))
    assert Path(world.out("real.exr")).read_text().startswith("R,G,B,A")


def test_a_png_without_the_color_group(world: World) -> None:
    arguments = ["-o", world.out("a.exr"), "-o", world.out("b.png"), "--aov", "depth,id"]
    assert main(["render", world.source, *arguments]) == 0
    assert Path(world.out("a.exr")).read_text() == "Z,id.prim"
    assert Path(world.out("b.png")).read_text() == "R,G,B,A,Z,id.prim"


def test_stats_alone_and_into_a_pipe(world: World, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["render", world.source, "--stats", "/dev/stdout", "-q"]) == 0
    assert json.loads(capfd.readouterr().out)["device"] == "a device"
    assert world.files() == ["scene.ply"]


def test_json_and_report_are_the_only_things_on_stdout(world: World, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["render", world.source, "-o", world.out(), "--json"]) == 0
    assert list(json.loads(capsys.readouterr().out))[0] == "camera"
    assert main(["render", world.source, "-o", world.out(), "--report", "-q"]) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    for word in (*EFFECTS, *STAGES, "no texture"):
        assert word in printed.out


# Notes and warnings


def test_notes_and_warnings(world: World, capsys: pytest.CaptureFixture[str]) -> None:
    world.scene = make_scene(warnings=("scene.ply: skins are not supported:\nbind pose shown",))
    arguments = ["render", world.source, "-o", world.out(), "--height", "2"]
    assert main(arguments) == 0
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "warning: scene.ply: skins are not supported: bind pose shown"
    assert lines[1] == "warning: --height is ignored: the perspective projection does not use it"
    assert lines[2].startswith(f"clrast: {world.source} brings no camera: framing the whole scene")
    assert "1024x1024 on a device, method 3dr-binning, precision midpoint, effects: none" in lines[3]
    assert len(lines) == 4
    assert main([*arguments, "--quiet"]) == 0
    assert [line.split(":")[0] for line in capsys.readouterr().err.splitlines()] == ["warning", "warning"]


def test_a_failure_is_one_line_beside_warnings(world: World, capsys: pytest.CaptureFixture[str]) -> None:
    """What the camera is, is said of pictures only: scripts take the one line that is no warning for the error."""
    world.fault = errors.DeviceError("there is no OpenCL device: install one")
    assert main(["render", world.source, "-o", world.out(), "--height", "2"]) == 69
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(":")[0] for line in lines] == ["warning", "clrast"]


def test_fov_is_ignored_by_an_orthographic_view(world: World, capsys: pytest.CaptureFixture[str]) -> None:
    world.scene = make_scene(cameras=(Camera("flat", "orthographic", height=3.0),))
    assert main(["render", world.source, "-o", world.out(), "--fov", "20"]) == 0
    assert "warning: --fov is ignored" in capsys.readouterr().err
    assert world.calls[0][0] == world.scene.cameras[0]


# The program as a whole


@pytest.mark.parametrize("verb", ["", "render", "explain", "diff", "compare", "cost", "accuracy", "stress", "devices"])
def test_help_has_one_example(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    if verb == "diff":
        pytest.importorskip("clrast.commands.diff", reason="diff is not there")
    assert main([*([verb] if verb else []), "--help"]) == 0
    printed = capsys.readouterr()
    assert printed.out.count("Example:") == 1 and printed.err == ""
    example = printed.out.split("Example:")[1].split("\n")[1]
    assert example.startswith(f"    clrast {verb or 'render'} ")
    if not verb:
        assert all(word in printed.out for word in ("render", "diff", "compare", "accuracy", "devices"))


def test_every_example_parses() -> None:
    """The examples are command lines that get past the checks of usage: 66, as their files are not there."""
    import shlex

    from clrast.commands.app import EXAMPLES

    for verb in ("", "render", "compare", "accuracy"):
        assert main(shlex.split(EXAMPLES[verb])[1:]) == 66


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    project = tomllib.loads((Path(__file__).resolve().parents[1] / "pyproject.toml").read_text())
    assert clrast.__version__ == project["project"]["version"]
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"clrast {clrast.__version__}\n"


def run(*arguments: str, **more: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run(arguments, capture_output=True, text=True, timeout=60, **more)


def test_the_module_runs_and_exits_with_the_code() -> None:
    done = run(sys.executable, "-m", "clrast", "render", "nope.ply", "-o", "x.exr")
    assert (done.returncode, done.stdout) == (66, "")
    assert done.stderr.count("\n") == 1 and done.stderr.startswith("clrast: error: nope.ply does not exist")


def test_odd_bytes_in_a_name_stay_one_line() -> None:
    name = b"a\nb\x1b[31m\xff.ply".decode(errors="surrogateescape")
    done = run(sys.executable, "-m", "clrast", "render", name, "-o", "x.exr")
    assert done.returncode == 66
    assert done.stderr.count("\n") == 1 and "\x1b" not in done.stderr


def test_a_closed_pipe_is_quiet() -> None:
    command = f"{sys.executable} -m clrast render --help | true; echo ${{PIPESTATUS[0]}}"
    done = run("bash", "-c", command)
    assert done.stderr == "" and done.stdout.strip() in ("0", "141")


def test_a_full_stdout_is_an_error() -> None:
    if not os.path.exists("/dev/full"):
        pytest.skip("no /dev/full here")
    command = [sys.executable, "-m", "clrast", "--help"]
    with open("/dev/full", "w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 73
    assert done.stderr.count("\n") == 1 and "standard output" in done.stderr


def test_import_is_light() -> None:
    """`import clrast` brings none of the heavy modules, and every public name is there."""
    code = (
        "import sys, clrast; heavy = {'numpy', 'typer', 'trimesh', 'pyopencl', 'rich', 'pydantic'};"
        "print(sorted(set(sys.modules) & heavy));"
        "print(all(name in dir(clrast) for name in clrast.__all__))"
    )
    assert run(sys.executable, "-c", code).stdout == "[]\nTrue\n"


def test_public_names() -> None:
    assert clrast.Scene is Scene and clrast.Camera is Camera
    assert clrast.errors is errors and clrast.UsageError is errors.UsageError
    assert issubclass(clrast.SceneError, clrast.ClrastError)
    with pytest.raises(AttributeError, match="nonsense"):
        _ = clrast.nonsense


def test_python_render(world: World) -> None:
    scene = make_scene(cameras=(Camera("a"), Camera("b", eye=(0, 0, 9))), render_options={"precision": "fast"})
    clrast.render(scene, camera="b", size="32x16", aov=["id"])
    camera, options = world.calls[-1]
    assert (camera.name, options.size, options.aov, options.precision) == ("b", (32, 16), ("id",), "fast")
    clrast.render(scene, Camera("own", eye=(1, 1, 1)), precision="midpoint")
    assert world.calls[-1][0].name == "own" and world.calls[-1][1].precision == "midpoint"
    clrast.render(scene, eye=(0, 0, 3), look_at="0,0,-1", projection="orthographic", height=4)
    camera = world.calls[-1][0]
    assert (camera.eye, camera.look_at, camera.projection, camera.height) == ((0, 0, 3), (0, 0, -1), "orthographic", 4)
    with pytest.raises(errors.UsageError, match="did you mean precision"):
        clrast.render(scene, precison="fast")
    with pytest.warns(UserWarning, match="--height is ignored"):
        clrast.render(scene, height=3)
