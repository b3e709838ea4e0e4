"""`clrast compare` as a whole: usage, plots on disk, the suite and the paper's findings, one real device."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
from compare_world import TABLE, comparison, row

from clrast.__main__ import main
from clrast.commands.compare_table import finding_lines
from clrast.options import AVAILABLE_METHODS, RenderOptions
from clrast.scene.model import Camera
from clrast.study import compare as study
from clrast.study import findings
from clrast.study.compare import Comparison

DATA = Path(__file__).resolve().parents[1] / "data"
REAL = tuple(name for name in AVAILABLE_METHODS if name != "auto")

# Findings


@dataclass(frozen=True)
class Kind:
    tiny: bool
    occluded: bool


KINDS = {"plain": Kind(False, False), "tiny": Kind(True, False), "hidden": Kind(True, True)}
AS_IN_THE_PAPER = {
    # method: milliseconds, setups, evaluations; instructions are then 100 %, 85 % and so on
    "2dr-brute": (10.0, 100, 1000),
    "2dr-binning": (12.0, 100, 900),
    "2dh-brute": (8.4, 100, 1000),
    "3dr-brute": (8.5, 100, 1000),
    "3dr-binning": (9.0, 100, 900),
    "3dr-frustum-cull": (6.0, 100, 800),
    "3dr-frustum-split": (4.0, 80, 500),
    "3dr-full": (3.8, 80, 450),
    "raycast-bvh": (5.0, 90, 600),
}
LOOSE = {"plain": {"3dr-brute": (11.0, 100, 1500)}}
"""Inside a hall 3D brute force tests the whole screen."""


def verdicts(
    changes: Mapping[str, tuple[float, int, int]] | None = None, without: tuple[str, ...] = ()
) -> dict[str, findings.Verdict]:
    """Name -> verdict, in a world as the paper found it but for `changes` in every scene."""
    tables = {}
    for scene in KINDS:
        figures = {**AS_IN_THE_PAPER, **(LOOSE.get(scene, {}) if not changes else {}), **(changes or {})}
        rows = [
            row(name, ms, setups=setups, evaluations=evaluations)
            for name, (ms, setups, evaluations) in figures.items()
            if name not in without
        ]
        tables[scene] = comparison(*rows, scene=scene)
    return {each.name: each for each in findings.judge_findings(findings.Measured(tables, KINDS))}


def test_in_the_papers_world_its_findings_hold() -> None:
    """All but one: with loose bounds in one scene instructions grow there."""
    found = verdicts()
    assert [name for name, each in found.items() if each.verdict != findings.HOLDS] == ["fewer instructions"]
    assert found["loose bounds inside a hall"].figures == (
        "edge evaluations, 3dr-brute / 2dr-brute: plain 1.50, tiny 1.00, hidden 1.00",
    )
    assert not any(each.reason for each in found.values())


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("fewer instructions", {"3dr-brute": (8.5, 200, 1000)}),
        ("time follows instructions", {"3dr-brute": (6.5, 100, 1000)}),
        ("brute force is faster in 3D", {"3dr-brute": (10.5, 100, 1000)}),
        ("loose bounds inside a hall", {"3dr-brute": (8.5, 100, 1000)}),
        ("binning does not pay", {"3dr-binning": (8.0, 100, 900)}),
        ("level with ray casting", {"raycast-bvh": (1.9, 90, 600)}),
        ("splitting wins on tiny triangles", {"3dr-full": (5.1, 80, 450)}),
        ("early w adds a little", {"3dr-full": (4.1, 80, 450)}),
        ("half the evaluations", {"3dr-full": (3.8, 80, 600)}),
        ("homogeneous edges are level", {"2dh-brute": (9.5, 100, 1000)}),
    ],
)
def test_each_finding_can_fail(name: str, changes: dict[str, tuple[float, int, int]]) -> None:
    """And holds with that one number as the paper's world has it."""
    found = verdicts(changes)
    assert found[name].verdict == findings.FAILS and found[name].figures
    if name not in ("fewer instructions", "loose bounds inside a hall"):
        assert verdicts()[name].verdict == findings.HOLDS
    reasons = {each.name: each.reason for each in findings.FINDINGS}
    assert found[name].reason == reasons[name]


def test_what_was_not_measured_is_said() -> None:
    found = verdicts(without=("3dr-full", "2dr-brute"))
    unmeasured = {name for name, each in found.items() if each.verdict == findings.NOT_MEASURED}
    assert unmeasured == {
        "fewer instructions", "time follows instructions", "brute force is faster in 3D", "loose bounds inside a hall",
        "splitting wins on tiny triangles", "early w adds a little", "half the evaluations",
        "homogeneous edges are level",
    }  # fmt: skip
    assert all(not found[name].figures for name in unmeasured)


def test_lines_of_the_findings() -> None:
    lines = finding_lines(tuple(verdicts({"3dr-brute": (8.5, 100, 1000)}).values()))
    at = next(k for k, line in enumerate(lines) if line.startswith("does not hold here: Seen from inside a hall"))
    assert lines[at + 1].startswith("    edge evaluations") and lines[at + 2].startswith("    because the bound")
    noisy = {name: comparison(row("2dr-brute", 9.0, 11.0), row("3dr-brute", 8.0, 10.0)) for name in KINDS}
    judged = {each.name: each for each in findings.judge_findings(findings.Measured(noisy, KINDS))}
    assert "tiny 0.90?, hidden 0.90? (? within" in judged["brute force is faster in 3D"].figures[0]


# The command


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        ([], 64, "give a scene or --suite paper"),
        (["x.ply", "--suite", "paper"], 64, "one of them"),
        (["--suite", "papr"], 64, "did you mean paper"),
        (["x.ply", "--suite-scale", "0.5"], 64, "--suite-scale is of --suite"),
        (["--suite", "paper", "--eye", "0,0,1"], 64, "brings its own cameras"),
        (["--suite", "paper", "--suite-scale", "0"], 64, "--suite-scale 0"),
        (["x.ply", "--methods", "3dr-fast"], 64, "--method"),
        (["x.ply", "--methods", "auto"], 64, "auto"),
        (["x.ply", "--repetitions", "0"], 64, "--repetitions 0 is out of range"),
        (["x.ply", "--repetitions", "3", "--repetitions", "4"], 64, "given as 3 and as 4"),
        (["x.ply", "--budget", "-1"], 64, "--budget"),
        (["x.ply", "-o", "x.pdf"], 64, "name a file .svg or .png"),
        (["x.svg", "-o", "./x.svg"], 64, "is the input too"),
        (["x.ply", "--precision", "exat"], 64, "did you mean exact"),
        (["x.ply"], 66, "does not exist"),
        ([str(DATA / "triangle.toml"), "-o", "nowhere/x.svg"], 73, "nowhere"),
    ],
)
def test_wrong_usage(
    arguments: list[str], code: int, message: str, capsys: pytest.CaptureFixture[str], tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert main(["compare", *arguments]) == code
    printed = capsys.readouterr()
    assert printed.out == "" and message in printed.err and len(printed.err.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_without_matplotlib_a_plot_says_what_to_install(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "matplotlib", None)
    assert main(["compare", str(DATA / "triangle.toml"), "-o", "x.svg"]) == 64
    assert "pip install 'clrast[plot]'" in capsys.readouterr().err


@pytest.fixture
def canned(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """compare_scene without a device; returns what it is called with."""
    calls: list[tuple[Any, ...]] = []

    def compare_scene(scene: Any, camera: Camera, options: RenderOptions, methods: Any, **named: Any) -> Comparison:
        calls.append((scene, camera, options, methods, named["repetitions"], named["budget_s"]))
        return replace(TABLE, scene=scene.name)

    monkeypatch.setattr(study, "compare_scene", compare_scene)
    return calls


def test_options_reach_the_measurement(canned: list[tuple[Any, ...]], capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--size", "20x10", "--eye", "1,2,3", "--methods", "3dr-full, 2dr-brute", "--methods", "3dr-brute",
                 "--repetitions", "3", "--budget", "2.5", "--precision", "ordered", "-t", "2"]  # fmt: skip
    assert main(["compare", str(DATA / "triangle.toml"), *arguments]) == 0
    _, camera, options, methods, repetitions, budget = canned[0]
    assert camera.eye == (1.0, 2.0, 3.0) and options.size == (20, 10) and options.threads == 2
    assert methods == ("2dr-brute", "3dr-brute", "3dr-full") and (repetitions, budget) == (3, 2.5)
    assert options.precision == "ordered"
    assert "fastest: 3dr-full" in capsys.readouterr().out


def test_plots_appear_together_or_not_at_all(canned: list[tuple[Any, ...]], tmp_path: Path, monkeypatch: Any) -> None:
    """The second file can not be written when it comes to it: the first is not there either."""
    arguments = ["compare", str(DATA / "triangle.toml"), "-q", "-o", str(tmp_path / "a.svg"), "-o"]
    (tmp_path / "sub").mkdir()
    from clrast.study import compare_plot

    plain = compare_plot.draw

    def draw_and_lock(comparisons: Any, suffix: str) -> bytes:
        if suffix == ".png":
            (tmp_path / "sub").rmdir()
        return plain(comparisons, suffix)

    monkeypatch.setattr(compare_plot, "draw", draw_and_lock)
    assert main([*arguments, str(tmp_path / "sub" / "b.png")]) == 73
    assert list(tmp_path.iterdir()) == []
    monkeypatch.undo()


def test_suite_judges_the_findings(
    canned: list[tuple[Any, ...]], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from clrast.study import suite

    made = []

    def make_scene(name: str, scale: float = 1.0) -> Any:
        from clrast.scene.load import load

        made.append((name, scale))
        return replace(load(DATA / "triangle.toml"), name=name)

    monkeypatch.setattr(suite, "make_scene", make_scene)
    assert main(["compare", "--suite", "paper", "--suite-scale", "0.25", "--json", "-q"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert made == [(name, 0.25) for name in suite.SUITE]
    assert [each["scene"] for each in report["scenes"]] == list(suite.VIEWS)
    assert [each["name"] for each in report["findings"]] == [each.name for each in findings.FINDINGS]
    verdict = {each["name"]: each["verdict"] for each in report["findings"]}
    assert verdict["brute force is faster in 3D"] == "holds" and verdict["binning does not pay"] == "not measured"
    assert main(["compare", "--suite", "paper", "-q"]) == 0
    assert "the paper's findings:" in capsys.readouterr().out


# With the renderer


def test_compare_on_a_device(device: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One triangle by brute force: what is counted is weighed by Fig. 10."""
    arguments = ["--methods", "2dr-brute,3dr-brute", "--size", "32x32", "--repetitions", "2", "--json"]
    output = tmp_path / "plot.svg"
    source = str(DATA / "triangle.toml")
    assert main(["compare", source, *arguments, "--device", device.runtime, "-q", "-o", str(output)]) == 0
    report = json.loads(capsys.readouterr().out)
    rows = {each["method"]: each for each in report["methods"]}
    assert list(rows) == ["2dr-brute", "3dr-brute"] and report["triangles"] == 1
    assert all(len(each["frames_ms"]) == 2 and each["ms"] > 0 and each["build_ms"] == 0 for each in rows.values())
    brute = rows["3dr-brute"]
    assert brute["setups"] >= 1 and brute["edge_evaluations"] >= brute["counts"]["hits"] > 0
    assert brute["instructions"] == 57 * brute["setups"] + 12 * brute["edge_evaluations"]
    assert brute["differing_pixels"] == 0
    assert rows["2dr-brute"]["relative_time"] == 1.0 and output.read_bytes().startswith(b"<?xml")


@pytest.mark.long
def test_all_methods_of_this_version(device: Any, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--size", "64x64", "--repetitions", "1", "--json", "-q", "--device", device.runtime]
    assert main(["compare", str(DATA / "icosphere.toml"), *arguments]) == 0
    report = json.loads(capsys.readouterr().out)
    assert tuple(each["method"] for each in report["methods"]) == REAL and report["skipped"] == {}
    for each in report["methods"]:
        assert each["setups"] > 0 and each["edge_evaluations"] > 0
        assert each["edges"] != "spatial" or each["differing_pixels"] == 0
