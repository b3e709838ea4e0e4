"""`clrast accuracy` as a whole: usage, the command that it prints, a real device, and the page in a real browser."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from accuracy_world import FRONT, TABLE
from accuracy_world import row as world_row
from browser import NAMES, Browser, find_browser

from clrast.__main__ import main
from clrast.commands import accuracy as command
from clrast.commands.accuracy_call import command_of
from clrast.commands.accuracy_table import answer_lines, number, table_lines
from clrast.image.frame import Frame
from clrast.options import RenderOptions
from clrast.study.accuracy_answers import OF_COMMAND, OF_FRAME, Answer, Run

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT / "data"


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        ([], 64, "INPUT"),
        (["x.ply", "--time", "0"], 64, "--time 0 is out of range"),
        (["x.ply", "--time", "soon"], 64, "--time 'soon' is not a number"),
        (["x.ply", "--time-of", "frame"], 64, "give --time too"),
        (["x.ply", "--time", "1", "--time-of", "frames"], 64, "did you mean frame"),
        (["x.ply", "--error", "-1"], 64, "--error -1 is out of range"),
        (["x.ply", "--metric", "mae"], 64, "use rmse, mse"),
        (["x.ply", "--knobs", "antialiasng"], 64, "did you mean antialiasing"),
        (["x.ply", "--reference-samples", "2048"], 64, "from 4 to 1024"),
        (["x.ply", "--budget", "nan"], 64, "--budget"),
        (["x.ply", "--precision", "exat"], 64, "did you mean exact"),
        (["x.ply", "--quality", "best"], 64, "use preview, draft or final"),
        (["x.ply", "-o", "x.pdf"], 64, "name a file .svg, .png, .html or .json"),
        (["x.ply", "--html", "x.svg"], 64, "name a file .html"),
        (["x.ply", "--page-side", "100"], 64, "give --html x.html too"),
        (["x.svg", "-o", "./x.svg"], 64, "is the input too"),
        (["x.ply"], 66, "does not exist"),
        ([str(DATA / "triangle.toml"), "--html", "nowhere/x.html"], 73, "nowhere"),
    ],
)
def test_wrong_usage(
    arguments: list[str], code: int, message: str, capsys: pytest.CaptureFixture[str], tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert main(["accuracy", *arguments]) == code
    printed = capsys.readouterr()
    assert printed.out == "" and message in printed.err and len(printed.err.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_without_flip_its_metric_says_what_to_install(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "flip_evaluator", None)
    assert main(["accuracy", str(DATA / "cube.toml"), "--metric", "flip"]) == 64
    assert "pip install flip-evaluator" in capsys.readouterr().err


@pytest.fixture
def canned(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """study_accuracy without a device; returns what it is called with."""
    from clrast.study import accuracy

    calls: list[tuple[Any, ...]] = []

    def study_accuracy(scene: Any, camera: Any, options: RenderOptions, **named: Any) -> Any:
        calls.append((camera, options, named))
        if named["keep"]:
            for row in TABLE.rows:
                named["keep"](row.name, np.zeros((4, 8, 3), np.float32), np.ones((4, 8, 3), np.float32))
        return replace(TABLE, scene=scene.name, metric=named["metric"])

    monkeypatch.setattr(accuracy, "study_accuracy", study_accuracy)
    return calls


def test_options_reach_the_study(canned: list[tuple[Any, ...]], capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--eye", "1,2,3", "--aa", "msaa:4", "--knobs", "output, precision", "--reference-samples", "64",
                 "--budget", "2.5", "--metric", "worst", "--no-cache", "-t", "2", "--quality", "final"]  # fmt: skip
    assert main(["accuracy", str(DATA / "triangle.toml"), *arguments]) == 0
    camera, options, named = canned[0]
    assert camera.eye == (1.0, 2.0, 3.0) and (options.aa, options.precision, options.threads) == ("msaa:4", "exact", 2)
    assert (named["knobs"], named["reference_samples"], named["budget_s"]) == (("precision", "output"), 64, 2.5)
    assert (named["metric"], named["use_cache"], named["keep"]) == ("worst", False, None)
    assert "* on the Pareto front by worst" in capsys.readouterr().out


def test_the_default_size_is_that_of_the_card_or_512(canned: list[tuple[Any, ...]], tmp_path: Path) -> None:
    text = '[[mesh]]\nshape = "box"\n'
    (tmp_path / "plain.toml").write_text(text)
    (tmp_path / "sized.toml").write_text("[image]\nsize = [40, 30]\n" + text)
    for name, more in (("plain", []), ("sized", []), ("sized", ["--size", "9x7"])):
        assert main(["accuracy", str(tmp_path / f"{name}.toml"), "-q", *more]) == 0
    assert [call[1].size for call in canned] == [(512, 512), (40, 30), (9, 7)]


def test_files_appear_together_or_not_at_all(
    canned: list[tuple[Any, ...]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = [str(tmp_path / name) for name in ("a.svg", "b.json", "c.html")]
    words = ["accuracy", str(DATA / "triangle.toml"), "-q", "-o", paths[0], "-o", paths[1], "--html", paths[2]]
    assert main(words) == 0
    assert sorted(each.name for each in tmp_path.iterdir()) == ["a.svg", "b.json", "c.html"]
    assert tuple(json.loads(Path(paths[1]).read_text())["front"]) == FRONT
    for path in paths:
        os.unlink(path)
    plain = command._write

    def write_and_lock(plan: Any, *rest: Any) -> None:
        plain(replace(plan, outputs=(*plan.outputs, str(tmp_path / "gone" / "d.svg"))), *rest)

    monkeypatch.setattr(command, "_write", write_and_lock)
    assert main(words) == 73
    assert list(tmp_path.iterdir()) == []


def test_the_printed_command_is_the_setting() -> None:
    """What the user typed, then what the setting changes; what it changes is not said twice."""
    given = {"size": (512, 512), "aa": "msaa:4", "effects": ["textures=off", "alpha_mask=off"], "half": True}
    view = {"eye": "-1,2,3", "fov": "60"}
    row = next(each for each in TABLE.rows if each.name == "precision exact, aa ssaa:16")
    assert command_of(row, (8, 4), "a scene.ply", given, view) == [
        "clrast", "render", "a scene.ply", "-o", "best.exr", "--size", "8x4", "--eye", "-1,2,3", "--fov", "60",
        "--effects", "textures=off", "--effects", "alpha_mask=off", "--half", "--precision", "exact", "--aa", "ssaa:16",
        "--method", "3dr-binning",
    ]  # fmt: skip


def test_effects_of_a_setting_join_those_that_were_typed() -> None:
    row = world_row({"effects": {"derivatives": "off"}}, 0.02, 40.0, knob="textures")
    assert row.name == "derivatives off"
    words = command_of(row, (8, 4), "x.ply", {"effects": ["alpha_mask=off", "derivatives=on"]}, {})
    assert words[7:11] == ["--effects", "alpha_mask=off", "--effects", "derivatives=off"]
    assert command_of(row, (8, 4), "x.ply", {}, {})[7:9] == ["--effects", "derivatives=off"]


def test_lines_of_the_table() -> None:
    lines = table_lines(TABLE)
    marked = [line.split("  ")[0] for line in lines if line.lstrip().startswith("*   ")]
    assert len(marked) == len(FRONT)
    default = next(line for line in lines if " default  " in line).split()
    assert default == ["*", "default", "40.0", "40.0-40.0", "20", "1.00", "0.02", "0.0004", "0.0008", "0.06", "0.08",
                       "5,2", "3"]  # fmt: skip
    assert "left out: grid: not available" in lines
    assert any("ssaa:1024 by exact arithmetic, rendered in 1.5 s; by its samples its own rmse is about" in line
               for line in lines)  # fmt: skip
    assert [number(value) for value in (0.0, 0.01234, 0.0000123, 12.0)] == ["0", "0.0123", "1.23e-05", "12"]


def test_lines_of_answers() -> None:
    runs = (Run(1.25, 251.0, 0.007), Run(1.26, 249.0, 0.007))
    row = TABLE.row("aa ssaa:4")
    answers = [
        Answer("time", 1.3, OF_COMMAND, True, row, 1.25, runs), Answer("time", 0.1, OF_COMMAND, False, row, 1.25, runs),
        Answer("error", 0.01, OF_COMMAND, True, row, 1.25, runs), Answer("error", 1e-5, OF_FRAME, False, row, None),
    ]  # fmt: skip
    text = answer_lines(TABLE, answers, {row.name: ["clrast", "render", "a b.ply"]})
    assert text[1].startswith("within 1.3 s (the whole command: starting, ") and text[1].endswith("rmse 0.007")
    assert text[2] == "    clrast render 'a b.ply'"
    assert text[3] == "    predicted: 1.25 s in all, of which its frame 0.25 s; rmse 0.007"
    assert text[4] == "    run 2 times as printed: 1.25, 1.26 s in all, frame 0.251, 0.249 s; rmse 0.007"
    assert "nothing is ready: the nearest, the fastest, is aa ssaa:4" in text[6]
    assert text[11].startswith("for rmse 0.01 the cheapest is: aa ssaa:4")
    assert text[16].startswith("for rmse 1e-05 nothing is accurate enough: the nearest is aa ssaa:4")
    assert "--no-check" in text[18]


def run_program(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(
        [sys.executable, "-P", "-m", "clrast", *words], cwd=folder, env=environment, capture_output=True, text=True
    )


def test_the_program_end_to_end(tmp_path: Path) -> None:
    """Few settings of a small picture; the command that it prints gives the error that it claims."""
    words = [
        "accuracy", str(DATA / "cube.toml"), "--size", "32x32", "--method", "3dr-binning", "--knobs", "output",
        "--reference-samples", "16", "--budget", "0.2", "--html", "page.html", "-o", "table.json", "-o", "plot.svg",
        "--time", "600", "--time-of", "frame",
    ]  # fmt: skip
    done = run_program(tmp_path, *words, "--json", "-q")
    assert done.returncode == 0 and done.stderr == ""
    found = json.loads(done.stdout)
    assert done.stdout == (tmp_path / "table.json").read_text()
    assert {each.name for each in tmp_path.iterdir()} == {"page.html", "table.json", "plot.svg"}
    assert [each["name"] for each in found["settings"]] == ["default", "half"] and "default" in found["front"]
    assert found["reference"]["aa"] == "ssaa:16" and found["reference"]["precision"] == "exact"
    assert all(each["frame_ms"]["frames"] >= 1 and each["frame_ms"]["median"] > 0 for each in found["settings"])
    assert [(each["asked"], each["reached"]) for each in found["answers"]] == [("time", True)]
    answer = found["answers"][0]
    assert len(answer["runs"]) == 3 and {run["rmse"] for run in answer["runs"]} == {answer["predicted"]["rmse"]}

    # Both sides rendered by the program anew, and the error by another formula.
    line = shlex.split(shlex.join(answer["command"]))
    assert line[:2] == ["clrast", "render"]
    assert run_program(tmp_path, *line[1:], "-q").returncode == 0
    reference = [*line[1:], "-o", "right.exr", "-q", "--precision", "exact", "--aa", "ssaa:16"]
    reference.remove("best.exr")
    reference.remove("-o")
    assert run_program(tmp_path, *reference).returncode == 0
    images = [Frame.load(tmp_path / name) for name in ("best.exr", "right.exr")]
    squares = [(images[0][axis].astype(float) - images[1][axis]) ** 2 for axis in "RGB"]
    rmse = float(np.sqrt(np.mean(squares)))
    assert rmse > 0 and rmse == pytest.approx(answer["predicted"]["rmse"], rel=1e-9)

    again = run_program(tmp_path, *words[:-4], "-q", "--error", "1", "--no-check")
    assert again.returncode == 0 and "kept from an earlier run" in again.stdout
    assert re.search(r"^for rmse 1 the cheapest is: (default|half)", again.stdout, re.M)


@pytest.mark.long
def test_every_setting_on_a_real_device(tmp_path: Path) -> None:
    """All knobs: errors fall with the samples, half differs by its rounding alone, exact has no wrong sample."""
    words = ["accuracy", str(DATA / "room.toml"), "--size", "48x32", "--budget", "5", "--json", "-q", "--no-cache"]
    done = run_program(tmp_path, *words)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    rmse = {each["name"]: each["errors"]["rmse"] for each in found["settings"]}
    series = [rmse[name] for name in ("default", "aa ssaa:4", "aa ssaa:16", "aa ssaa:64", "aa ssaa:256")]
    assert series == sorted(series, reverse=True) and series[0] > 20 * series[-1] > 0
    wrong = {each["name"]: each["wrong_samples"] for each in found["settings"]}
    assert wrong["precision exact"] == wrong["precision exact, aa ssaa:16"] == 0
    # A half has 11 bits: the rounding of a value below 4 is at most 2^-10.
    assert 0 < abs(rmse["half"] - rmse["default"]) < 2**-10
    assert {"samples", "depth", "grid"} >= set(found["left_out"]) - {"precision double"}


@pytest.mark.long
def test_the_page_works_in_a_browser(tmp_path: Path) -> None:
    """Real mouse clicks: a point shows its image, the table too; slider, zoom and difference; no request goes out."""
    program = find_browser()
    if program is None:
        pytest.skip(f"no browser is installed to show the page: one of {', '.join(NAMES)}")
    done = run_program(
        tmp_path, "accuracy", str(DATA / "cube.toml"), "--size", "64x48", "--knobs", "antialiasing", "--budget", "2",
        "--reference-samples", "64", "--html", "page.html", "-o", "table.json", "-q",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    settings = [each["name"] for each in json.loads((tmp_path / "table.json").read_text())["settings"]]
    pixel = (
        "(([x, y]) => Array.from(viewer.getContext('2d').getImageData(viewer.width * x, viewer.height * y, 1, 1).data)"
        ".slice(0, 3))"
    )
    corner = "[0.01, 0.01]"
    with Browser(program) as browser:
        browser.open(tmp_path / "page.html")
        browser.wait_for("document.body.dataset.ready === 'yes'")
        chosen = "document.getElementById('name').textContent"
        assert browser.evaluate(chosen) == "default"
        count = browser.evaluate("document.querySelectorAll('svg .point').length")
        assert count == len(settings) == browser.evaluate("document.querySelectorAll('#table tbody tr').length")
        # A point that no other covers.
        wanted = settings.index("aa ssaa:16")
        browser.click(f'.point[data-index="{wanted}"] circle')
        assert browser.evaluate(chosen) == "aa ssaa:16"
        assert "--aa ssaa:16" in browser.evaluate("document.getElementById('command').textContent")
        browser.click(f"#table tbody tr:nth-child({settings.index('default') + 1})")
        assert browser.evaluate(chosen) == "default"

        # The background is black in both: their difference too. Along the cube's edges it is not.
        browser.click("input[value=difference]")
        assert browser.evaluate(f"{pixel}({corner})") == [0, 0, 0]
        sums = (
            "Array.from(viewer.getContext('2d').getImageData(0, 0, viewer.width, viewer.height).data)"
            ".reduce((sum, value, k) => k % 4 === 3 ? sum : sum + value, 0)"
        )
        default_sum = browser.evaluate(sums)
        browser.evaluate(f"choose({wanted})")
        assert default_sum > browser.evaluate(sums) > 0
        browser.click("input[value=reference]")
        before = browser.evaluate(sums)
        box = browser.evaluate("(b => [b.x + b.width / 2, b.y + b.height / 2])(viewer.getBoundingClientRect())")
        browser.mouse("mouseWheel", *box, deltaX=0, deltaY=-240)
        browser.wait_for("state.zoom > 1")
        assert browser.evaluate(sums) != before
        browser.click("input[value=slider]")
        left, right = (browser.evaluate(f"splitAt({share}), {sums}") for share in (0, 1))
        assert left != right
        assert browser.evaluate("document.getElementById('split').value") == "100"
        browser.evaluate("document.activeElement.blur()")
        browser.key("ArrowRight")
        front = browser.evaluate("data.front")
        assert browser.evaluate(chosen) in front

        asked = [e["params"]["request"]["url"] for e in browser.events if e["method"] == "Network.requestWillBeSent"]
        assert {url.split(":")[0] for url in asked} == {"file", "data"} and len([u for u in asked if "file" in u]) == 1
        logged = [e["params"]["entry"] for e in browser.events if e["method"] == "Log.entryAdded"]
        assert [entry for entry in logged if entry["level"] == "error"] == []
        assert not any(e["method"] == "Runtime.exceptionThrown" for e in browser.events)
        browser.screenshot(tmp_path / "page.png")
