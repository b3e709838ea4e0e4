"""The tables of methods and oracles: complete, what kernels are built from, checked where a user names them."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import fields, replace
from types import MappingProxyType

import numpy as np
import pytest
from continuum_world import REFERENCE, differences, hard_scenes, images
from hypothesis import given
from hypothesis import strategies as st

from clrast import options
from clrast.errors import UsageError
from clrast.job import RenderJob
from clrast.opencl import kernels, layout
from clrast.opencl.device import Device
from clrast.opencl.features import Edges, Features
from clrast.options import RenderOptions, make_options
from clrast.shading.effects import plan_effects
from clrast.visibility import methods, oracles
from clrast.visibility.frusta import stack_capacity
from clrast.visibility.methods import METHODS, Method, resolve_method
from clrast.visibility.oracles import FRUSTUM_SIDES, ORACLES, RAY_ORACLES, OracleChoice, parse_oracle

ORACLE_SETTINGS = [(name, setting) for name, oracle in ORACLES.items() for setting in oracle.settings]


# --- the tables ------------------------------------------------------------------------------------


def test_every_method_can_be_named_in_the_order_of_the_table() -> None:
    assert options.AVAILABLE_METHODS == ("auto", *METHODS)
    assert [name for name in options.METHODS if name in METHODS] == list(METHODS)
    assert methods.BASELINE in METHODS


@pytest.mark.parametrize("name", METHODS)
def test_a_row_says_all_that_there_is_to_say(name: str) -> None:
    method = METHODS[name]
    assert method.name == name and method.meaning and method.section
    assert list(method.oracles) == list(ORACLES)
    assert all(choice.setting in ORACLES[each].settings for each, choice in method.oracles.items())
    assert method.frustum in [4, 8, 16, 32, 64, 128, 256] and method.evaluation == "direct"
    assert (method.needs_bvh, method.is_brute, method.tiles, method.grid).count(True) == 1
    assert all(choice.setting in RAY_ORACLES[each].settings for each, choice in method.rays.items())
    assert method.grid == bool(method.rays) and method.passes == ("pass" in method.rays)
    assert (method.edges == Edges.SPATIAL) == name.startswith(("3dr-", "raycast-"))


def test_no_two_methods_are_the_same_point() -> None:
    points = Counter(
        (m.edges, m.tiles, m.grid, m.passes, m.frustum, m.evaluation, *(m.oracles[name].setting for name in ORACLES))
        for m in METHODS.values()
    )
    assert set(points.values()) == {1}


@pytest.mark.parametrize(("name", "setting"), ORACLE_SETTINGS)
def test_settings_have_the_numbers_that_kernels_compare_with(name: str, setting: str) -> None:
    number, meaning = ORACLES[name].settings[setting]
    assert layout.CONSTANTS[f"{name}_{setting}".upper()] == number and meaning


@pytest.mark.parametrize("name", ORACLES)
def test_an_oracle_is_one_object_and_one_predicate(name: str) -> None:
    """Its macro is a feature of that name, decides something in the kernels, and has no number that nobody can set."""
    oracle, macro = ORACLES[name], name.upper()
    assert oracle.name == name and oracle.meaning and oracle.section
    assert name in {field.name for field in fields(Features)}
    kernel = "\n".join(path.read_text("utf-8") for path in sorted(kernels.kernel_folder().glob("*.cl*")))
    assert re.search(rf"^[ \t]*#[ \t]*if\b.*\b{macro}\b", kernel, flags=re.MULTILINE)
    assert f"-D {macro}=" in " ".join(Features().defines(kernels.source_text("traverse_frusta.cl")))
    known = {f"{macro}_{setting.upper()}" for setting in oracle.settings}
    assert {constant for constant in layout.CONSTANTS if constant.startswith(f"{macro}_")} == known
    numbers = [number for number, _ in oracle.settings.values()]
    assert len(set(numbers)) == len(numbers)


def test_adaptive_splitting_is_both_reasons_together() -> None:
    assert layout.SPLIT_FRUSTUM_CENTER | layout.SPLIT_FRUSTUM_SMALL == layout.SPLIT_FRUSTUM_ADAPTIVE


@pytest.mark.parametrize("name", METHODS)
def test_features_take_what_the_method_decides_and_nothing_else(name: str) -> None:
    method = METHODS[name]
    before = Features(vector_width=8, counters=True, alpha_mask=True, tile_log2=4)
    after = method.configure(before)
    decided = {"edges", "evaluation", *ORACLES, *(("unroll_steps", "unroll_tests") if method.passes else ())}
    assert all(getattr(after, f.name) == getattr(before, f.name) for f in fields(Features) if f.name not in decided)
    assert after.edges == method.edges and after.evaluation == layout.EVALUATION_DIRECT
    for each, choice in method.oracles.items():
        assert getattr(after, each) == ORACLES[each].settings[choice.setting][0]


# --- new ones --------------------------------------------------------------------------------------


def render_at(device: Device, name: str, scene_name: str) -> dict[str, np.ndarray]:
    """The image by a method of the (patched) table."""
    scene, view = hard_scenes("perspective")[scene_name]
    given = make_options({"size": (view.width, view.height), "aov": ("id", "depth"), "device": device.runtime})
    plan = plan_effects(scene, given.aov, given.effects)
    job = RenderJob(device, scene, view, given, plan, resolve_method(name))
    channels = job.allocate()
    job.render_frame(channels, first=True)
    assert job.stats()["method"] == name
    return {"id.prim": channels["id.prim"], "Z": channels["Z"].view(np.uint32)}


def test_a_new_method_is_one_row(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """Put together from oracles that are there, by the table's own way and from another row: the same image."""
    settings = {
        "is_outside": "never", "is_occluded": "w_buffer", "split_frustum": "small",
        "generate_samples": "leaf", "binning": "blocks",
    }  # fmt: skip
    made = (
        methods._row("made-up", "packets that split for small nodes", "4", Edges.SPATIAL, settings, frustum=32),
        replace(METHODS["raycast-brute"], name="raycast-brute-16", frustum=16),
    )
    table = MappingProxyType({**METHODS, **{row.name: row for row in made}})
    monkeypatch.setattr(methods, "METHODS", table)
    assert made[0].small_ratio == ORACLES["split_frustum"].parameter[1]  # type: ignore[index]
    for scene_name in ("soup", "ties"):
        right = images(device, *hard_scenes("perspective")[scene_name], REFERENCE)
        for row in made:
            assert differences(render_at(device, row.name, scene_name), right) == "", (row.name, scene_name)


# --- what a user names -----------------------------------------------------------------------------


def chosen(method: Method) -> dict[str, str]:
    return {name: choice.setting for name, choice in method.oracles.items()}


def test_oracles_change_what_they_name_alone() -> None:
    method = resolve_method("3dr-full", ["split_frustum=small:12", "frustum=16", "binning=never"])
    changed = {"split_frustum": "small", "binning": "never"}
    assert chosen(method) == {**chosen(METHODS["3dr-full"]), **changed}
    assert (method.frustum, method.small_ratio, method.name) == (16, 12, "3dr-full")
    assert resolve_method("3dr-full") == METHODS["3dr-full"]
    assert resolve_method("3dr-full", evaluation="incremental").evaluation == "incremental"
    assert resolve_method("3dr-full", ["generate_samples=root"]).is_brute
    assert resolve_method("3dr-brute", ["generate_samples=leaf"]).needs_bvh


def test_determinants_are_an_intersection_of_durands_loop() -> None:
    method = resolve_method("raycast-brute", intersection="barycentric")
    assert method == replace(METHODS["raycast-brute"], edges=Edges.BARYCENTRIC)
    for name in METHODS:
        if name != "raycast-brute":
            with pytest.raises(UsageError, match="of --method raycast-brute: give that method"):
                resolve_method(name, intersection="barycentric")


@pytest.mark.parametrize("name", [name for name, method in METHODS.items() if method.tiles])
def test_methods_of_tiles_have_no_oracles_to_change(name: str) -> None:
    with pytest.raises(UsageError, match=f"--oracle: {name} has its lists of tiles .* use a frustum method"):
        resolve_method(name, ["binning=never"])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("is_occluded=never", ("is_occluded", OracleChoice("never"))),
        (" is_outside = screen_bound ", ("is_outside", OracleChoice("screen_bound"))),
        ("split_frustum=adaptive", ("split_frustum", OracleChoice("adaptive", 4))),
        ("split_frustum=small:65536", ("split_frustum", OracleChoice("small", 65536))),
        ("split_frustum=small:1", ("split_frustum", OracleChoice("small", 1))),
        ("frustum=4", ("frustum", OracleChoice("side", 4))),
        ("frustum=256", ("frustum", OracleChoice("side", 256))),
        ("pass=purcell:35", ("pass", OracleChoice("purcell", 35))),
        ("unroll=4:2", ("unroll", OracleChoice("4", 2))),
        ("mailbox=boxes", ("mailbox", OracleChoice("boxes", 16))),
    ],
)
def test_oracle_texts(text: str, expected: tuple[str, OracleChoice]) -> None:
    assert parse_oracle("--oracle", text) == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("binning", "'binning': give NAME=VALUE, such as split_frustum=never"),
        ("", "give NAME=VALUE"),
        ("is_ocluded=never", "'is_ocluded' is unknown: use is_outside or .*did you mean is_occluded"),
        ("=never", "'' is unknown"),
        ("binning=", "binning=: use never or blocks"),
        ("binning=block", "use never or blocks .did you mean blocks"),
        ("binning=never:3", "binning takes no number: leave out ':3'"),
        ("binning=Never", "use never or blocks"),
        ("split_frustum=adaptive:", "use never or center"),
        ("split_frustum=adaptive:0", "out of range: give 1 to 65536"),
        ("split_frustum=adaptive:65537", "out of range: give 1 to 65536"),
        ("split_frustum=adaptive:-1", "use never or center"),
        ("split_frustum=adaptive:1.5", "use never or center"),
        ("split_frustum=adaptive:9999999999", "use never or center"),
        ("frustum=2", "give a power of two from 4 to 256"),
        ("frustum=512", "give a power of two from 4 to 256"),
        ("frustum=48", "give a power of two from 4 to 256"),
        ("frustum=-8", "give a power of two from 4 to 256"),
        ("frustum=8.0", "give a power of two from 4 to 256"),
        ("frustum=٨", "give a power of two from 4 to 256"),
        ("frustum=", "give a power of two from 4 to 256"),
        ("unroll=3", "use 1 or 2 or 4 or 8"),
        ("pass=purcell:101", "out of range: give 1 to 100"),
    ],
)
def test_oracle_texts_that_are_refused(text: str, message: str) -> None:
    with pytest.raises(UsageError, match=message) as caught:
        parse_oracle("--oracle", text)
    assert str(caught.value).startswith("--oracle") and "\n" not in str(caught.value)


@given(st.text(max_size=20) | st.builds("{}={}".format, st.sampled_from([*ORACLES, "frustum"]), st.text(max_size=8)))
def test_any_oracle_text_is_parsed_or_refused(text: str) -> None:
    try:
        name, choice = parse_oracle("--oracle", text)
    except UsageError:
        return
    if name in RAY_ORACLES:
        assert choice.setting in RAY_ORACLES[name].settings
    elif name == "frustum":
        assert FRUSTUM_SIDES[0] <= choice.number <= FRUSTUM_SIDES[1] and choice.number.bit_count() == 1
    else:
        assert choice.setting in ORACLES[name].settings


def test_oracles_of_options_are_checked_together() -> None:
    given = RenderOptions(method="3dr-full", oracle="split_frustum=never,frustum=8,frustum=8")
    assert given.oracle == ("split_frustum=never", "frustum=8")
    with pytest.raises(UsageError, match="--oracle frustum is given as 'frustum=8' and as 'frustum=16': give one"):
        RenderOptions(method="3dr-full", oracle=["frustum=8", "frustum=16"])
    with pytest.raises(UsageError, match="--oracle changes a method: name it, such as --method 3dr-full"):
        make_options({"oracle": "frustum=8"})


# --- the stack of a traversal ----------------------------------------------------------------------


@pytest.mark.parametrize("frustum_log2", range(2, 9))
def test_the_stack_holds_the_deepest_traversal(frustum_log2: int) -> None:
    """Walks down the top of the stack, with every frustum split and every child kept on the way."""
    for levels in range(1, 12):
        height = most = layout.NODE_WIDTH
        size, level = frustum_log2, 1
        while True:
            if size > layout.MIN_FRUSTUM_LOG2:
                height, size = height + 3, size - 1
            elif level < levels:
                height, level = height - 1 + layout.NODE_WIDTH, level + 1
            else:
                break
            most = max(most, height)
        capacity = stack_capacity(levels, frustum_log2)
        assert most <= capacity and capacity.bit_count() == 1


def test_meanings_are_said_once() -> None:
    """No two settings, oracles or methods share a sentence: what the help lists can be told apart."""
    said = [meaning for oracle in oracles.ORACLES.values() for _, meaning in oracle.settings.values()]
    said += [oracle.meaning for oracle in (*ORACLES.values(), *RAY_ORACLES.values())]
    said += [method.meaning for method in METHODS.values()]
    assert len(set(said)) == len(said)
