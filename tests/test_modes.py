"""Only what a scene calls for: which rays are traced, kernels launched and hierarchies built, by counts and stats."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from mode_worlds import CHALK, GLASS, MIRROR, assemble, ball, color, effect, floor, looking, planned, rays, square

from clrast.opencl.device import Device
from clrast.scene.model import Light, Material, Scene
from clrast.shading.effects import plan_effects
from clrast.visibility.loop_limits import loop_limit

MODES = ("cast", "shadow", "whitted", "path")
SECONDARY = ("shadow", "whitted", "path")
EFFECTS = [
    "shadow", "reflection", "refraction", "indirect light", "emission", "textures", "normal interpolation",
    "alpha mask", "alpha blend", "environment", "secondary acceleration structure", "derivatives",
]  # fmt: skip
LIGHT = Light("sun", "point", (9.0, 9.0, 9.0), (1.0, -1.0, 4.0))
VIEW = looking(16, (1, -4, 3), (0, 0, 0.5), 1 / 16)
BODY = ball(1, 0.5, CHALK).moved(1, (0, 0, 0.5))
PLAIN = assemble(floor(9, CHALK), BODY)
LIT = replace(PLAIN, lights=(LIGHT,))
SHINY = assemble(floor(9, CHALK), ball(1, 0.5, MIRROR).moved(1, (0, 0, 0.5)))
NOTHING = {"shadow": 0, "reflection": 0, "refraction": 0, "indirect": 0}


def few(mode: str, **options: Any) -> dict[str, Any]:
    return {**({"samples": 2} if mode == "path" else {}), **options}


@pytest.mark.parametrize("mode", SECONDARY)
def test_a_plain_scene_is_cast(device: Device, mode: str) -> None:
    """Nothing that rays could find: the same bits, kernels and times as in mode cast; on every runtime."""
    cast, other = (planned(device, PLAIN, VIEW, each) for each in ("cast", mode))
    for channel in ("R", "G", "B", "A", "Z"):
        np.testing.assert_array_equal(other[channel], cast[channel])
    assert other.stats["counts"] == cast.stats["counts"]
    assert other.stats["times_ms"]["build"] == 0 and rays(other) == NOTHING
    assert other.stats["bytes_device"] == cast.stats["bytes_device"]


@pytest.mark.parametrize("mode", SECONDARY)
def test_drivers_that_limit_loops_refuse_rays(device: Device, mode: str) -> None:
    from clrast.errors import DeviceError

    if loop_limit(device) is None:
        pytest.skip(f"{device.runtime} takes long loops: other tests trace rays there")
    with pytest.raises(DeviceError, match="long loops.*--device"):
        planned(device, LIT, VIEW, mode)


def test_what_each_mode_traces(first_device: Device) -> None:
    """A light calls for shadow rays, a mirror for mirrored ones, glass for both kinds, all of them for nothing else."""
    glassy = assemble(floor(9, CHALK), ball(1, 0.5, GLASS).moved(1, (0, 0, 0.5)))
    expected = {
        ("shadow", "lit"): {"shadow"}, ("whitted", "lit"): {"shadow"}, ("path", "lit"): {"shadow", "indirect"},
        ("shadow", "shiny"): set(), ("whitted", "shiny"): {"reflection"}, ("path", "shiny"): {"reflection"},
        ("whitted", "glassy"): {"reflection", "refraction"}, ("path", "glassy"): {"reflection", "refraction"},
    }  # fmt: skip
    scenes = {"lit": LIT, "shiny": SHINY, "glassy": glassy}
    for (mode, name), kinds in expected.items():
        frame = planned(first_device, scenes[name], VIEW, mode, **few(mode))
        assert {kind for kind, count in rays(frame).items() if count} == kinds, (mode, name)
        for kind, row in {"shadow": "shadow", "reflection": "reflection", "refraction": "refraction"}.items():
            assert effect(frame, row) == (kind in kinds), (mode, name, row)
        assert effect(frame, "secondary acceleration structure") == bool(kinds)
        assert (frame.stats["times_ms"]["build"] > 0) == bool(kinds)


def test_a_mirror_that_nothing_shows(first_device: Device) -> None:
    """It is behind the eye, or behind a wall: no queue is started, and nothing is launched but looking for one."""
    hidden = assemble(floor(9, CHALK), ball(1, 0.5, MIRROR).moved(1, (3, -20, 2)))
    wall = square((-9, -1, -1), (18, 0, 0), (0, 0, 18), CHALK)
    covered = assemble(floor(9, CHALK), ball(1, 0.5, MIRROR).moved(1, (0, 1, 0.5)), wall)
    shown = planned(first_device, SHINY, VIEW, "whitted")
    for scene in (hidden, covered):
        frame, cast = (planned(first_device, scene, VIEW, mode) for mode in ("whitted", "cast"))
        assert rays(frame) == NOTHING
        for channel in "RGB":
            np.testing.assert_array_equal(frame[channel], cast[channel])
        started = frame.stats["counts"]["kernel_launches"] - cast.stats["counts"]["kernel_launches"]
        assert 0 <= started < shown.stats["counts"]["kernel_launches"] - cast.stats["counts"]["kernel_launches"]
        assert started <= 3, "light, its sum and its mean"


def test_a_material_that_no_triangle_has_calls_for_nothing(first_device: Device) -> None:
    scene = replace(PLAIN, materials=(*PLAIN.materials, MIRROR, GLASS, replace(CHALK, emissive=(1.0, 1.0, 1.0))))
    for mode in SECONDARY:
        frame = planned(first_device, scene, VIEW, mode)
        assert rays(frame) == NOTHING and not effect(frame, "secondary acceleration structure")


def test_lights_without_power_cast_no_shadow(first_device: Device) -> None:
    """They light nothing: black in every mode, as in mode cast, and no ray is traced."""
    scene = replace(PLAIN, lights=(replace(LIGHT, intensity=(0.0, 0.0, 0.0)),))
    for mode in MODES:
        frame = planned(first_device, scene, VIEW, mode, **few(mode))
        assert not color(frame).any() and rays(frame)["shadow"] == 0


@pytest.mark.parametrize("mode", MODES)
def test_no_colour_no_rays(first_device: Device, mode: str) -> None:
    scene = replace(SHINY, lights=(LIGHT,), environment=(1.0, 1.0, 1.0))
    frame = planned(first_device, scene, VIEW, mode, aov=("depth", "normal", "albedo", "id"))
    assert rays(frame) == NOTHING and frame.stats["times_ms"]["build"] == 0
    for row in frame.stats["effects"]:
        if row["name"] in ("shadow", "reflection", "refraction", "indirect light", "environment"):
            assert row == {"name": row["name"], "on": False, "reason": "no colour is asked for"}


# --- --effects -------------------------------------------------------------------------------------


def test_effects_that_are_asked_for(first_device: Device) -> None:
    """shadow=on in mode cast is mode shadow; shadow=off in mode shadow is mode cast."""
    shadow, cast = (planned(first_device, LIT, VIEW, mode) for mode in ("shadow", "cast"))
    forced = planned(first_device, LIT, VIEW, "cast", effects={"shadow": "on"})
    off = planned(first_device, LIT, VIEW, "shadow", effects={"shadow": "off"})
    assert not (color(shadow) == color(cast)).all()
    np.testing.assert_array_equal(color(forced), color(shadow))
    np.testing.assert_array_equal(color(off), color(cast))
    assert rays(forced) == rays(shadow) and rays(off) == NOTHING and off.stats["times_ms"]["build"] == 0
    assert {"name": "shadow", "on": True, "reason": "asked for by --effects"} in forced.stats["effects"]
    assert {"name": "shadow", "on": False, "reason": "switched off by --effects"} in off.stats["effects"]


def test_mirrors_that_are_asked_for(first_device: Device) -> None:
    whitted, cast = (planned(first_device, SHINY, VIEW, mode) for mode in ("whitted", "cast"))
    forced = planned(first_device, SHINY, VIEW, "cast", effects={"reflection": "on"})
    off = planned(first_device, SHINY, VIEW, "whitted", effects="reflection=off")
    np.testing.assert_array_equal(color(forced), color(whitted))
    np.testing.assert_array_equal(color(off), color(cast))
    assert rays(forced) == rays(whitted) and rays(off) == NOTHING
    idle = planned(first_device, PLAIN, VIEW, "cast", effects="reflection=on,refraction=on,shadow=on")
    assert rays(idle) == NOTHING
    np.testing.assert_array_equal(color(idle), color(planned(first_device, PLAIN, VIEW, "cast")))


def test_paths_without_indirect_light_are_whitted(first_device: Device) -> None:
    scene = replace(SHINY, lights=(LIGHT,), environment=(0.5, 0.25, 1.0))
    whitted = planned(first_device, scene, VIEW, "whitted")
    direct = planned(first_device, scene, VIEW, "path", effects={"indirect light": "off"})
    assert rays(direct)["indirect"] == 0 and rays(direct)["reflection"] > 0
    np.testing.assert_array_equal(color(direct), color(whitted))
    dark = planned(first_device, scene, VIEW, "whitted", effects={"environment": "off"})
    assert (color(dark) <= color(whitted)).all() and (color(dark) < color(whitted)).any()


@pytest.mark.parametrize("roughness", [0.0, 0.04, 0.0400001])
def test_smooth_ends_at_mirror_roughness(first_device: Device, roughness: float) -> None:
    body = ball(1, 0.5, replace(MIRROR, roughness=roughness)).moved(1, (0, 0, 0.5))
    frame = planned(first_device, assemble(floor(9, CHALK), body), VIEW, "whitted")
    assert effect(frame, "reflection") == (roughness <= 0.04)
    assert (rays(frame)["reflection"] > 0) == (roughness <= 0.04)


# --- the plan --------------------------------------------------------------------------------------


def scenes_of_all_kinds() -> dict[str, Scene]:
    glow = replace(CHALK, emissive=(1.0, 0.0, 0.0))
    pane = Material("pane", (1.0, 1.0, 1.0, 0.5), alpha_mode="BLEND")
    made = {
        "plain": PLAIN, "lit": LIT, "shiny": SHINY,
        "glow": assemble(BODY, floor(9, glow)), "pane": assemble(BODY, floor(9, pane)),
        "unlit": assemble(BODY, floor(9, replace(glow, unlit=True))), "glass": assemble(BODY, floor(9, GLASS)),
    }  # fmt: skip
    sky = {f"{name}, sky": replace(scene, environment=(1.0, 1.0, 1.0)) for name, scene in made.items()}
    night = {f"{name}, night": replace(scene, environment=(0.0, 0.0, 0.0)) for name, scene in made.items()}
    return {**made, **sky, **night}


def test_the_plan_is_complete_and_true_to_itself() -> None:
    """Every effect, in the order of the design, each with a reason of its own; and the reasons fit the switches."""
    for name, scene in scenes_of_all_kinds().items():
        for mode in MODES:
            for aov in (("color",), ("depth",)):
                rows = plan_effects(scene, aov, {}, mode).as_stats()
                assert [row["name"] for row in rows] == EFFECTS
                on = {row["name"]: row["on"] for row in rows}
                assert all(isinstance(row["reason"], str) and row["reason"].strip() for row in rows), (name, mode)
                tracing = [on[each] for each in EFFECTS[:4]]
                assert on["secondary acceleration structure"] == any(tracing), (name, mode, aov)
                assert not any(tracing) or (mode != "cast" and aov == ("color",)), (name, mode, aov)
                assert not on["environment"] or any(on[each] for each in EFFECTS[1:4]), (name, mode, aov)


def test_a_black_environment_says_why_it_is_off() -> None:
    scene = replace(SHINY, environment=(0.0, 0.0, 0.0))
    row = next(e for e in plan_effects(scene, ("color",), {}, "whitted").effects if e.name == "environment")
    assert not row.on and "seen by" not in row.reason


def test_repeated_frames_count_one(first_device: Device) -> None:
    from clrast.renderer import render as render_scene

    options = {"size": (16, 16), "mode": "whitted", "method": "3dr-binning", "device": first_device.runtime}
    once = render_scene(replace(SHINY, lights=(LIGHT,)), **options)
    often = render_scene(replace(SHINY, lights=(LIGHT,)), repeat=2, **options)
    assert often.stats["counts"] == once.stats["counts"] and rays(once)["shadow"] > 0
    np.testing.assert_array_equal(color(often), color(once))


@pytest.mark.small
def test_small_paths(device: Device) -> None:
    """A few paths through mirrors, glass, lamps and lights, for Oclgrind, which sees what they read and write."""
    if device.runtime != "oclgrind":
        pytest.skip(f"{device.runtime} does not watch memory; paths are traced by other tests, or refused")
    lamp = Material("lamp", (0.0, 0.0, 0.0, 1.0), emissive=(4.0, 4.0, 4.0))
    panes = [square((x, 0, 0.2), (1, 0, 0), (0, 0, 1), material) for x, material in ((-1, MIRROR), (0, GLASS))]
    parts = (floor(9, CHALK), *panes, square((-1, -1, 3), (0, 1, 0), (1, 0, 0), lamp))
    scene = assemble(*parts, lights=(LIGHT,), environment=(0.5, 0.5, 0.5))
    frame = planned(device, scene, looking(4, (0.1, -3, 1.5), (0, 0, 0.4), 1 / 4), "path", samples=1, max_depth=2)
    counts = rays(frame)
    assert counts["shadow"] > 0 and counts["indirect"] > 0 and np.isfinite(color(frame)).all()
