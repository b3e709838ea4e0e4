"""Options: parsing from text, what is refused and how, and the header's fixed order."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clrast import option_values as v
from clrast import options as o
from clrast.errors import UsageError
from clrast.image.header import resolved_header
from clrast.option_values import UnavailableError
from clrast.options import AOV_GROUPS, EFFECTS, RenderOptions, make_options
from clrast.quality import PRESETS
from clrast.visibility.sample_patterns import parse_antialiasing

FLOAT32_RANGE = st.floats(min_value=-v.MAX_FLOAT32, max_value=v.MAX_FLOAT32, allow_nan=False, allow_infinity=False)


@given(st.integers(1, 65535), st.integers(1, 65535))
def test_size_round_trip_or_too_many_pixels(width: int, height: int) -> None:
    text = f"{width}x{height}"
    if width * height <= 16384 * 16384:
        assert v.parse_size("--size", text) == (width, height)
    else:
        with pytest.raises(UsageError, match=f"{width * height} pixels: at most 268435456"):
            v.parse_size("--size", text)


@pytest.mark.parametrize(
    "text",
    ["", "64", "64x", "x64", "64x64x64", "64 x 64", "-64x64", "0x64", "64x0", "65536x1", "1x65536", "6_4x64", "1e2x64",
     "64.0x64", "nanx1", "٦٤x٦٤", "9" * 40 + "x1"],
)  # fmt: skip
def test_size_refuses(text: str) -> None:
    with pytest.raises(UsageError, match="--size"):
        v.parse_size("--size", text)


@given(st.tuples(FLOAT32_RANGE, FLOAT32_RANGE, FLOAT32_RANGE))
def test_vector_round_trip(vector: tuple[float, float, float]) -> None:
    text = ",".join(repr(component) for component in vector)
    assert v.parse_vector("--eye", text) == vector
    assert v.parse_vector("--eye", list(vector)) == vector
    assert v.parse_vector("--eye", np.array(vector)) == vector


@pytest.mark.parametrize(
    "text", ["", "1,2", "1,2,3,4", "a,b,c", "1,,3", "nan,0,0", "inf,0,0", "0,0,-inf", "1e39,0,0", "1e999,0,0", "1;2;3"]
)
def test_vector_refuses(text: str) -> None:
    with pytest.raises(UsageError, match="--eye.*three"):
        v.parse_vector("--eye", text)


@given(st.lists(st.sampled_from([*(group for group in AOV_GROUPS if group != "cost"), "all"]), min_size=1))
def test_aov_is_a_set_in_the_fixed_order(names: list[str]) -> None:
    parsed = o.parse_aov("--aov", ",".join(names))
    wanted = set(AOV_GROUPS) - {"cost"} if "all" in names else set(names)
    assert set(parsed) == wanted
    assert [AOV_GROUPS.index(name) for name in parsed] == sorted(AOV_GROUPS.index(name) for name in parsed)
    assert o.parse_aov("--aov", names) == parsed


def test_aov_all_has_every_group_but_cost() -> None:
    assert o.parse_aov("--aov", "all") == (
        "color", "depth", "distance", "normal", "position", "bary", "uv", "albedo", "ray", "id",
    )  # fmt: skip


@pytest.mark.parametrize(("text", "hint"), [("depht", "did you mean depth"), ("colour", "did you mean color")])
def test_aov_names_the_nearest(text: str, hint: str) -> None:
    with pytest.raises(UsageError, match=hint):
        o.parse_aov("--aov", text)


@pytest.mark.parametrize("text", ["", ",", "color,,depth"])
def test_aov_refuses_empty_names(text: str) -> None:
    with pytest.raises(UsageError, match="--aov"):
        o.parse_aov("--aov", text)


@given(st.dictionaries(st.sampled_from(EFFECTS), st.sampled_from(["off", "auto"])))
def test_effects_with_underscores(effects: dict[str, str]) -> None:
    texts = [f"{name.replace(' ', '_')}={state}" for name, state in effects.items()]
    assert o.parse_effects("--effects", texts) == effects
    assert o.parse_effects("--effects", effects) == effects
    assert list(o.parse_effects("--effects", texts)) == [name for name in EFFECTS if name in effects]


def test_there_are_twelve_effects() -> None:
    assert set(EFFECTS) == {
        "shadow", "reflection", "refraction", "indirect light", "emission", "textures", "normal interpolation",
        "alpha mask", "alpha blend", "environment", "secondary acceleration structure", "derivatives",
    }  # fmt: skip
    assert len(EFFECTS) == 12


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("alpha_mask", "NAME=on"),
        ("alpha_mask=yes", "use on, off or auto"),
        ("alphamask=on", "did you mean alpha_mask"),
        ("alpha_mask=on,alpha_mask=off", "given as on and as off"),
    ],
)
def test_effects_refuses(text: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        o.parse_effects("--effects", text)


@pytest.mark.parametrize(
    ("text", "size"),
    [("1", 1), ("4096", 4096), ("1K", 1024), ("1k", 1024), ("512M", 512 * 2**20), ("2G", 2**31), ("1.5G", 3 * 2**29),
     ("1KiB", 1024), ("3MiB", 3 * 2**20), ("1GiB", 2**30), ("1KB", 1000), ("2MB", 2_000_000), ("1T", 2**40),
     ("7 MiB", 7 * 2**20), ("12B", 12)],
)  # fmt: skip
def test_memory(text: str, size: int) -> None:
    assert v.parse_memory("--memory", text) == size


@pytest.mark.parametrize("text", ["", "0", "-1", "G", "1X", "1e9", "nan", "0.1", "1GG", "9999999T", "9" * 30])
def test_memory_refuses(text: str) -> None:
    with pytest.raises(UsageError, match="--memory"):
        v.parse_memory("--memory", text)


@given(st.floats())
def test_fov_is_inside_0_and_180(degrees: float) -> None:
    if math.isfinite(degrees) and 0 < degrees < 180:
        assert v.parse_fov("--fov", repr(degrees)) == degrees
    else:
        with pytest.raises(UsageError, match="between 0 and 180"):
            v.parse_fov("--fov", repr(degrees))


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        (
            "effects",
            "secondary_acceleration_structure=on",
            "secondary_acceleration_structure=on is not available in this version; use auto or off",
        ),
    ],
)
def test_what_is_not_there_yet_says_so(name: str, value: str | bool, message: str) -> None:
    with pytest.raises(UnavailableError, match=message):
        RenderOptions(**{name: value})


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("precision", "midpiont", "use fast, ordered, midpoint, double, fixed or exact .did you mean midpoint"),
        ("method", "3dr-bining", "use auto, 2dr-brute, .* or raycast-brute .did you mean 3dr-binning"),
        ("method", "raycast-bhv", "did you mean raycast-bvh"),
        ("method", "3DR-full", "did you mean 3dr-full"),
        ("evaluation", "incrementel", "use direct or incremental .did you mean incremental"),
        ("intersection", "determinant", "use edge or barycentric"),
        ("counters", "yes", "use True or False"),
        ("counters", 1, "use True or False"),
        ("half", "yes", "use True or False"),
        ("oracle", 3, "no text and no list of texts"),
        ("oracle", "", "give NAME=VALUE"),
        ("mode", "trace", "use cast"),
        ("aa", "msaa", "use none"),
        ("threads", "0", "from 1 to"),
        ("threads", "two", "not a number"),
        ("threads", "1.5", "not a number"),
        ("seed", "-1", "from 0 to 4294967295"),
        ("seed", "4294967296", "from 0 to 4294967295"),
        ("repeat", "-1", "from 0"),
        ("device", "", "empty"),
        ("oracle", "nope=1", "use is_outside"),
        ("quality", "best", "use preview, draft or final"),
        ("quality", 3, "use preview, draft or final"),
        ("quality", ["draft"], "use preview, draft or final"),
    ],
)
def test_nonsense_is_refused_with_what_is_allowed(name: str, value: str, message: str) -> None:
    with pytest.raises(UsageError, match=message) as caught:
        RenderOptions(**{name: value})
    assert not isinstance(caught.value, UnavailableError)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"oracle": "binning=never"}, "--oracle changes a method: name it, such as --method 3dr-full"),
        ({"oracle": "binning=never", "method": "auto"}, "--oracle changes a method: name it"),
        ({"oracle": "binning=never", "method": "3dr-binning"}, "--oracle: 3dr-binning has its lists of tiles"),
        ({"oracle": "binning=never", "method": "2dh-binning"}, "use a frustum method"),
        ({"intersection": "barycentric"}, "--intersection barycentric is of --method raycast-brute: give that method"),
        ({"intersection": "barycentric", "method": "3dr-full"}, "is of --method raycast-brute: give that method"),
        ({"grid_resolution": "64"}, "--grid-resolution is of methods with a grid: use --method raycast-grid or"),
        ({"grid_resolution": "64", "method": "3dr-full"}, "is of methods with a grid: use --method raycast-grid or"),
        ({"accelerator": "bvh", "grid_resolution": 9, "mode": "path"}, "a grid: use --method .* or --accelerator grid"),
        ({"accelerator": "grid", "method": "3dr-full"}, "not that of 3dr-full: use --method raycast-grid or raycast-"),
        ({"accelerator": "bvh", "method": "raycast-grid"}, "not that of raycast-grid: leave it out"),
        ({"oracle": "pass=naive", "method": "raycast-grid"}, "--oracle pass: raycast-grid has no rays that ask it"),
        ({"oracle": "mailbox=never", "method": "3dr-full"}, "3dr-full has no rays .*: use --method raycast-grid$"),
        ({"oracle": "frustum=8", "method": "raycast-grid"}, "has rays in place of frusta: use mailbox"),
    ],
)
def test_what_does_not_go_together_says_what_does(values: dict[str, str], message: str) -> None:
    """A scene's card may bring what is missing, so each alone is sound."""
    with pytest.raises(UsageError, match=message) as caught:
        make_options(values)
    assert not isinstance(caught.value, UnavailableError)
    assert make_options(values, whole=False) == RenderOptions(**values)


def test_the_accelerator_is_that_of_secondary_rays_where_there_are_any() -> None:
    """In mode cast it is the camera's, whose method then is the grid's or has to be; elsewhere they are two things."""
    for mode, casts in (("cast", True), ("shadow", False), ("path", False)):
        made = make_options({"accelerator": "grid", "mode": mode})
        assert made.casts_grid == casts and made.ray_accelerator == "grid"
    for method, accelerator in (("3dr-full", "grid"), ("raycast-grid", "bvh"), ("raycast-bvh", "grid")):
        made = make_options(
            {"accelerator": accelerator, "method": method, "mode": "whitted", "grid_resolution": 9}
        )
        assert made.method == method and made.ray_accelerator == accelerator and not made.casts_grid
    assert make_options({"mode": "path"}).ray_accelerator == "bvh"
    assert make_options({"accelerator": "grid", "mode": "path"}).check_projection("fisheye") is None
    with pytest.raises(UsageError, match="--accelerator grid needs planar views"):
        make_options({"accelerator": "grid"}).check_projection("fisheye")


def test_what_is_there_is_taken() -> None:
    for method in o.AVAILABLE_METHODS:
        assert RenderOptions(method=method, evaluation="incremental", counters=True, aov="cost").aov == ("cost",)
    assert o.METHODS == o.AVAILABLE_METHODS
    made = RenderOptions(method="raycast-brute", intersection="barycentric", oracle=["frustum=8", "binning=blocks"])
    assert (made.intersection, made.oracle) == ("barycentric", ("frustum=8", "binning=blocks"))


def test_text_and_values_give_equal_options() -> None:
    text = RenderOptions(size="640x480", aov="id,color", effects="alpha_mask=off", memory="1M", threads="2", seed="7")
    values = RenderOptions(
        size=(640, 480), aov=("color", "id"), effects={"alpha mask": "off"}, memory=1 << 20, threads=2, seed=7
    )
    assert text == values
    assert RenderOptions() == RenderOptions(size="1024x1024", aov="color,depth", precision="midpoint", aa="none")


def test_unknown_name_is_named_with_the_nearest() -> None:
    with pytest.raises(UsageError, match="did you mean precision"):
        make_options({"precison": "fast"})
    assert make_options({"shading-rate": "sample"}).shading_rate == "sample"


@pytest.mark.parametrize("name", PRESETS)
def test_a_quality_is_its_options_and_what_is_given_wins(name: str) -> None:
    """Also where what is given is the default of an option."""
    preset = PRESETS[name]
    made = make_options({"quality": name, "size": "8x8"})
    assert made == RenderOptions(size=(8, 8), **preset) == RenderOptions(size=(8, 8), quality=name)
    assert made.quality is None
    for option in preset:
        default = getattr(RenderOptions(), option)
        assert make_options({"quality": name, option: default}) == RenderOptions(**{**preset, option: default})
    header = resolved_header(made, {"e": (0.0, 0.0, 1.0)})
    assert {option: header[option] for option in preset} == preset and "quality" not in header


def test_presets_grow_more_accurate() -> None:
    samples = [len(parse_antialiasing("--aa", preset["aa"]).pattern) for preset in PRESETS.values()]
    assert list(PRESETS) == ["preview", "draft", "final"] and samples == sorted(set(samples))
    assert PRESETS["final"]["precision"] == "exact"


def test_header_has_a_fixed_order_and_nothing_of_the_machine() -> None:
    vectors = {"e": (0.0, 0.0, 1.0), "d0": (1.0, 2.0, 3.0)}
    here = RenderOptions(size="64x32", device="x", threads=2, memory="1G", repeat=3, method="auto", seed=5)
    there = RenderOptions(size="64x32", device="y", threads=1, method="3dr-binning", memory=1 << 20)
    header = resolved_header(here, vectors, ["textures", "alpha mask"])
    assert list(header.items()) == list(resolved_header(there, vectors, ["alpha mask", "textures"]).items())
    assert list(header) == [
        "version", "size", "projection", "mode", "precision", "aa", "effects", "camera.e", "camera.d0",
    ]  # fmt: skip
    assert header["effects"] == "textures,alpha_mask"
    methods = [name for name in o.AVAILABLE_METHODS if name.startswith(("3dr-", "raycast-"))]
    for method in methods:
        more = {"counters": True, "oracle": "frustum=8"} if "binning" not in method else {}
        assert resolved_header(RenderOptions(size="64x32", method=method, **more), vectors, []) == {
            **header, "effects": "",
        }  # fmt: skip
    assert header["camera.d0"] == (1.0, 2.0, 3.0)


@pytest.mark.parametrize(
    ("values", "key", "value"),
    [
        ({"evaluation": "incremental"}, "evaluation", "incremental"),
        ({"method": "2dr-brute"}, "edges", "projected"),
        ({"method": "2dh-binning"}, "edges", "homogeneous"),
        ({"method": "raycast-brute", "intersection": "barycentric"}, "edges", "barycentric"),
    ],
)
def test_header_names_what_decides_pixels_of_its_own(values: dict[str, str], key: str, value: str) -> None:
    vectors = {"e": (0.0, 0.0, 1.0)}
    plain = resolved_header(RenderOptions(size="64x32"), vectors)
    header = resolved_header(RenderOptions(size="64x32", **values), vectors)
    assert header == {**plain, key: value} and list(header)[-1] == "camera.e"
