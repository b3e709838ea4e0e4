"""The command line's words for methods, oracles and counters: usage, cards, help, and what comes of them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from cli_world import World, fails, make_scene, make_world
from test_cli_render import PARALLEL, SQUARE, parts, render

import clrast
from clrast.__main__ import main
from clrast.commands.stats import COUNTS
from clrast.options import AVAILABLE_METHODS
from clrast.visibility.oracles import ORACLES, RAY_ORACLES


@pytest.fixture
def world(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> World:
    return make_world(tmp_path, monkeypatch)


@pytest.fixture
def square(tmp_path: Path) -> Path:
    path = tmp_path / "square.ply"
    path.write_text(SQUARE)
    return path


# Usage


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--method", "raycast-grid", "--grid-resolution", "0"], "give a whole number from 1 to 1023"),
        (["--grid-resolution", "64"], "of methods with a grid: use --method raycast-grid or raycast-grid-multipass"),
        (["--method", "raycast-bhv"], "did you mean raycast-bvh"),
        (["--method", "3dr-full", "--method", "auto"], "given as 3dr-full and as auto"),
        (["--accelerator", "octree"], "use auto, grid or bvh"),
        (["--oracle", "binning=never"], "name it, such as --method 3dr-full"),
        (["--oracle", "binning=never", "--method", "auto"], "name it, such as --method 3dr-full"),
        (["--method", "3dr-full", "--oracle", "bining=never"], "did you mean binning"),
        (["--method", "3dr-full", "--oracle", "binning"], "give NAME=VALUE, such as split_frustum=never"),
        (["--method", "3dr-full", "--oracle", "frustum=9"], "a power of two from 4 to 256"),
        (
            ["--method", "3dr-full", "--oracle", "frustum=8", "--oracle", "frustum=16"],
            "'frustum=8' and as 'frustum=16'",
        ),
        (["--method", "3dr-binning", "--oracle", "frustum=8"], "use a frustum method"),
        (["--intersection", "barycentric"], "of --method raycast-brute: give that method"),
        (["--intersection", "barycentric", "--method", "raycast-bvh"], "of --method raycast-brute: give that method"),
        (["--intersection", "determinant"], "use edge or barycentric"),
        (["--evaluation", "sloppy"], "use direct or incremental"),
        (["--counters=yes"], "--counters"),
    ],
)
def test_wrong_usage(world: World, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str) -> None:
    assert re.search(message, fails(capsys, 64, "render", world.source, "-o", world.out(), *arguments))
    assert not world.calls and world.files() == ["scene.ply"]


def test_options_of_methods_reach_the_renderer(world: World) -> None:
    arguments = ["--method", "raycast-brute", "--intersection", "barycentric", "--evaluation", "incremental"]
    arguments += ["--oracle", "frustum=8", "--oracle", "binning=blocks,frustum=8", "--counters", "--aov", "cost,id"]
    assert main(["render", world.source, "-o", world.out(), *arguments]) == 0
    options = world.calls[0][1]
    assert (options.method, options.intersection, options.evaluation) == ("raycast-brute", "barycentric", "incremental")
    assert (options.oracle, options.counters, options.aov) == (("frustum=8", "binning=blocks"), True, ("id", "cost"))


@pytest.mark.parametrize(
    ("card", "given", "expected"),
    [
        ({"method": "3dr-full"}, [], ("3dr-full", "edge", ())),
        ({"method": "3dr-full"}, ["--method", "raycast-bvh"], ("raycast-bvh", "edge", ())),
        ({"method": "3dr-full"}, ["--oracle", "frustum=8"], ("3dr-full", "edge", ("frustum=8",))),
        ({"method": "raycast-brute", "intersection": "barycentric"}, [], ("raycast-brute", "barycentric", ())),
        ({"method": "raycast-brute"}, ["--intersection", "barycentric"], ("raycast-brute", "barycentric", ())),
    ],
)
def test_a_card_names_the_method_that_options_change(
    world: World, card: dict[str, str], given: list[str], expected: tuple[object, ...]
) -> None:
    """What goes together is looked at when card and command line are put together."""
    world.scene = make_scene(render_options=card)
    assert main(["render", world.source, "-o", world.out(), *given]) == 0
    options = world.calls[0][1]
    assert (options.method, options.intersection, options.oracle) == expected


def test_a_card_with_an_option_that_is_not_there(world: World, capsys: pytest.CaptureFixture[str]) -> None:
    """One of a later version is a warning; one of no version is bad input."""
    world.scene = make_scene(render_options={"effects": "secondary_acceleration_structure=on"})
    assert main(["render", world.source, "-o", world.out(), "-q"]) == 0
    warning = capsys.readouterr().err
    assert warning.startswith("warning: ")
    assert "secondary_acceleration_structure=on is not available in this version" in warning
    assert world.calls[0][1].effects == {}
    world.scene = make_scene(render_options={"method": "raycast-gird"})
    assert "did you mean raycast-grid" in fails(capsys, 65, "render", world.source, "-o", world.out())


def test_help_lists_methods_and_oracles(capsys: pytest.CaptureFixture[str]) -> None:
    """All that a user can name, whatever the terminal's width breaks its lines at; nothing that this version lacks."""
    assert main(["render", "--help"]) == 0
    text = "".join(capsys.readouterr().out.split())
    assert ",".join(AVAILABLE_METHODS[:-1]) + "or" + AVAILABLE_METHODS[-1] in text
    for name, oracle in {**ORACLES, **RAY_ORACLES}.items():
        assert f"{name}={'|'.join(oracle.settings)}" in text
    for option in ("--oracleNAME=VALUE", "--intersectionWAY", "--evaluationWAY", "--counters", "frustum=SIDE", "cost("):
        assert option in text
    assert "direct[default],orincremental" in text and "edge[default],orbarycentric" in text


# Renders


def test_counters_are_numbers_where_they_are_asked_for(square: Path, tmp_path: Path) -> None:
    """Two triangles of 32 x 32 pixels; what is not counted is null, and what the host knows is a number."""
    counted = ("setups", "edge_evaluations", "intersection_tests", "traversal_steps")
    method = ("--method", "3dr-brute")
    plain = render(square, tmp_path / "a.exr", *PARALLEL, *method)["counts"]
    assert [plain[name] for name in counted] == [None, None, None, 0]
    found = render(square, tmp_path / "b.exr", *PARALLEL, *method, "--counters")
    assert [found["counts"][name] for name in COUNTS if not name.startswith("kernel")] == [
        found["counts"][name] if name == "setups" else known for name, known in (
            ("triangles", 2), ("setups", None), ("edge_evaluations", 2048), ("samples", 4096), ("hits", 1024),
            ("rays_primary", 4096), ("rays_shadow", 0), ("rays_reflection", 0), ("rays_refraction", 0),
            ("rays_indirect", 0), ("traversal_steps", 0), ("intersection_tests", 2048), ("passes", 1),
        )
    ]  # fmt: skip
    assert found["counts"]["setups"] >= 2 and found["other_counts"]["samples_written"] == 1024
    tree = render(square, tmp_path / "c.exr", *PARALLEL, "--method", "raycast-bvh", "--counters")
    assert tree["counts"]["traversal_steps"] >= 64 and tree["times_ms"]["build"] > 0
    none = render(square, tmp_path / "d.exr", *PARALLEL, "--method", "raycast-bvh")
    assert none["counts"]["traversal_steps"] is None
    assert len({(tmp_path / f"{name}.exr").read_bytes() for name in "abcd"}) == 1


def test_costs_are_a_part_of_their_own(square: Path, tmp_path: Path) -> None:
    """Both triangles at each pixel of the square, of which their bounds are all; not in `all`, and numbers in stats."""
    stats = render(square, tmp_path / "a.exr", *PARALLEL, "--aov", "cost,id", "--method", "3dr-brute")
    found = parts(tmp_path / "a.exr")
    names = ["cost.edge_evaluations", "cost.setups", "cost.traversal_steps"]
    assert list(found) == ["id", "cost"] and found["cost"] == (names, "float")
    frame = clrast.Frame.load(tmp_path / "a.exr")
    assert (frame["cost.edge_evaluations"][16:48, 16:48] == 2).all() and (frame["cost.setups"][16:48, 16:48] == 2).all()
    assert frame["cost.edge_evaluations"].sum() == 2048 == stats["counts"]["edge_evaluations"]
    assert not frame["cost.traversal_steps"].any()


def test_a_card_names_its_method(tmp_path: Path) -> None:
    """The method of a card, and that of the command line in its place: the image is the same but for the header."""
    card = tmp_path / "card.toml"
    card.write_text('[render]\nmethod = "raycast-bvh"\n\n[[mesh]]\nshape = "box"\n')
    found = {}
    for name, more in {"own": (), "given": ("--method", "3dr-brute")}.items():
        found[name] = render(card, tmp_path / f"{name}.exr", "--size", "40x30", "--aov", "all", "-q", *more)
    assert [found[name]["method"] for name in ("own", "given")] == ["raycast-bvh", "3dr-brute"]
    assert (tmp_path / "own.exr").read_bytes() == (tmp_path / "given.exr").read_bytes()
