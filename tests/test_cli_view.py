"""Which camera and which options a command line means: given ones, those of the file, and the defaults."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import permutations
from pathlib import Path
from typing import Any

import pytest
from cli_world import World, fails, make_scene, make_world

from clrast.__main__ import main
from clrast.quality import PRESETS
from clrast.scene.model import Camera


@pytest.fixture
def world(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> World:
    return make_world(tmp_path, monkeypatch)


def camera_of(world: World, *arguments: str) -> Camera:
    assert main(["render", world.source, "-o", world.out(), "-q", *arguments]) == 0
    return world.calls[-1][0]


def test_values_may_begin_with_a_minus(world: World) -> None:
    camera = camera_of(world, "--eye", "-1,2,3", "--look-at", "-1,0,0", "--up=-1,0,0")
    assert (camera.eye, camera.look_at, camera.up) == ((-1, 2, 3), (-1, 0, 0), (-1, 0, 0))
    camera = camera_of(world, "--eye=-1e-3,-2,-.5", "--up", "-0,-1,-0")
    assert (camera.eye, camera.up) == ((-0.001, -2, -0.5), (0, -1, 0))


def test_the_order_of_options_never_matters(world: World) -> None:
    parts = [[world.source], ["-o", world.out()], ["--eye", "-1,2,3"], ["--size=8x4"], ["--aov", "id,depth"]]
    for order in permutations(parts):
        assert main(["render", *(word for part in order for word in part)]) == 0
    assert len(set(map(repr, world.calls))) == 1
    camera, options = world.calls[0]
    assert (camera.eye, options.size, options.aov) == ((-1, 2, 3), (8, 4), ("depth", "id"))


def test_defaults_of_a_given_camera(world: World) -> None:
    """The bounding box is (0,0,0) to (2,4,0); nothing comes from the file's camera."""
    world.scene = make_scene(cameras=(Camera("c", "orthographic", (9, 9, 9), (8, 8, 8), (1, 0, 0), 10.0, 5.0),))
    camera = camera_of(world, "--eye", "1,2,7")
    assert (camera.projection, camera.look_at, camera.up, camera.fov) == ("perspective", (1, 2, 0), (0, 1, 0), 45)
    camera = camera_of(world, "--eye", "1,2,7", "--projection", "orthographic")
    assert camera.height == pytest.approx(2 * 7 * math.tan(math.pi / 8), rel=1e-15)
    camera = camera_of(world, "--look-at", "1,1,1")
    assert camera.look_at == (1, 1, 1) and camera.eye != (9, 9, 9)


def test_a_camera_of_the_file_and_values_over_it(world: World) -> None:
    first = Camera("first", "perspective", (0, 0, 5), (0, 0, 1), (0, 1, 0), 30.0)
    world.scene = make_scene(cameras=(first, Camera("7", eye=(1, 2, 3)), Camera("x", eye=(3, 2, 1))))
    assert camera_of(world) == first
    assert camera_of(world, "--camera", "x").name == "x"
    assert camera_of(world, "--camera", "2").name == "x"
    assert camera_of(world, "--camera", "7").name == "7"
    assert camera_of(world, "--fov", "20") == replace(first, fov=20.0)
    assert camera_of(world, "--up", "1,0,0") == replace(first, up=(1.0, 0.0, 0.0))
    flat = camera_of(world, "--projection", "orthographic")
    assert (flat.projection, flat.eye, flat.fov) == ("orthographic", (0, 0, 5), 30.0)
    assert flat.height == pytest.approx(2 * 4 * math.tan(math.radians(15)), rel=1e-15)
    assert camera_of(world, "--projection", "orthographic", "--height", "1.5").height == 1.5


@pytest.mark.parametrize(("size", "fov"), [("64x64", "45"), ("64x64", "10"), ("64x64", "120"), ("32x96", "30")])
def test_framing_keeps_the_scene_in_view(world: World, size: str, fov: str) -> None:
    """Every corner of the bounding box is inside the view, and the box's sphere fills it at least by two thirds."""
    from clrast.scene.camera import view_basis

    camera = camera_of(world, "--size", size, "--fov", fov)
    width, height = map(int, size.split("x"))
    assert camera.fov == float(fov)
    forward, right, up = view_basis(camera)
    half = math.tan(math.radians(camera.fov) / 2)

    def dot(a: Any, b: Any) -> float:
        return float(sum(x * y for x, y in zip(a, b, strict=True)))

    for corner in ((0, 0, 0), (2, 0, 0), (0, 4, 0), (2, 4, 0)):
        toward = [c - e for c, e in zip(corner, camera.eye, strict=True)]
        depth = dot(toward, forward)
        assert depth > 0
        assert abs(dot(toward, right)) <= depth * half * width / height
        assert abs(dot(toward, up)) <= depth * half
    radius = math.sqrt(5)
    narrow = math.atan(half * min(1, width / height))
    assert radius / math.dist(camera.eye, (1, 2, 0)) >= math.sin(narrow) * 2 / 3


def test_a_cards_values_yield(world: World, capsys: pytest.CaptureFixture[str]) -> None:
    own = {"precision": "fast", "aov": "id", "effects": "alpha_mask=off,textures=off"}
    world.scene = make_scene(image_size=(32, 16), render_options=own)
    camera_of(world)
    options = world.calls[-1][1]
    assert (options.size, options.precision, options.aov) == ((32, 16), "fast", ("id",))
    camera_of(world, "--size", "8x8", "--precision", "ordered", "--effects", "textures=auto", "--aov", "depth")
    options = world.calls[-1][1]
    assert (options.size, options.precision, options.aov) == ((8, 8), "ordered", ("depth",))
    assert options.effects == {"alpha mask": "off", "textures": "auto"}
    camera_of(world, "--quality", "final")
    preset = {name: getattr(world.calls[-1][1], name) for name in PRESETS["final"]}
    assert preset == PRESETS["final"] and world.calls[-1][1].aov == ("id",)
    camera_of(world, "--quality", "final", "--aa", "none")
    assert (world.calls[-1][1].precision, world.calls[-1][1].aa) == (PRESETS["final"]["precision"], "none")
    capsys.readouterr()
    world.scene = make_scene(render_options={"aa": "ssaa:4", "effects": "secondary_acceleration_structure=on"})
    camera_of(world)
    printed = capsys.readouterr().err.splitlines()
    assert [line.split(":")[0] for line in printed] == ["warning"]
    assert world.calls[-1][1].aa == "ssaa:4"
    world.scene = make_scene(render_options={"precision": "exakt"})
    assert "precision" in fails(capsys, 65, "render", world.source, "-o", world.out())
