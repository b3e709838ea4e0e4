"""`clrast diff`: it sees what idiff misses, agrees with it elsewhere, and names the threshold that would pass."""

from __future__ import annotations

import math
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from clrast.commands.entry import run
from clrast.errors import UsageError
from clrast.image.channel_diff import IDIFF_FAIL, Thresholds, largest_but, rounded_up
from clrast.image.diff import diff
from clrast.image.frame import Frame

IDIFF = Path(sys.executable).with_name("idiff")
GENTLE = settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
H, W = 8, 10


def image(**changes: float) -> Frame:
    """Colour, depth, normals and ids; `R=0.5` or `id__prim=3` sets pixel (x=4, y=3) of a channel."""
    random = np.random.default_rng(5)
    names = ("R", "G", "B", "A", "Z", "N.X", "N.Y", "N.Z")
    channels = {name: random.random((H, W), np.float32) for name in names}
    for name in ("id.prim", "id.object", "id.material"):
        channels[name] = random.integers(0, 100000, (H, W)).astype(np.uint32)
    for name, value in changes.items():
        channels[name.replace("__", ".")][3, 4] = value
    return Frame(channels)


def without(frame: Frame, *names: str) -> Frame:
    return Frame({name: values for name, values in frame.channels.items() if name not in names})


def idiff(*arguments: object) -> int:
    if not IDIFF.exists():
        pytest.skip("idiff is not beside this Python: OpenImageIO's wheel brings it")
    return subprocess.run([IDIFF, *map(str, arguments)], capture_output=True, timeout=60).returncode


def plane(value: float, pixel: float | None = None) -> Frame:
    values = np.full((H, W), value, np.float32)
    if pixel is not None:
        values[3, 4] = pixel
    return Frame({"Z": values})


# What idiff lets pass

FOOLED = {
    "one NaN": (image(), image(R=math.nan), ()),
    "one Inf": (image(), image(Z=math.inf), ()),
    "all NaN": (plane(1.0), plane(math.nan), ()),
    "one NaN, idiff -hardfail": (image(), image(R=math.nan), ("-hardfail", "0.1")),
    "one NaN, idiff -a": (image(), image(R=math.nan), ("-a",)),
    "+Inf and -Inf": (plane(math.inf), plane(-math.inf), ()),
    "a later part": (image(), image(N__Y=-0.25), ()),
    "ids of a later part": (image(), image(id__prim=5), ()),
    "the last digit of an id": (
        Frame({"id.prim": np.full((H, W), 70001, np.uint32)}),
        Frame({"id.prim": np.full((H, W), 70002, np.uint32)}), ("-a",),
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", FOOLED)
def test_what_idiff_lets_pass_fails_here(tmp_path, case):
    reference, test, arguments = FOOLED[case]
    reference.save(tmp_path / "a.exr")
    test.save(tmp_path / "b.exr")
    for one, other in (("a", "b"), ("b", "a")):
        report = diff(tmp_path / f"{one}.exr", tmp_path / f"{other}.exr")
        assert (report.status, report.exit_code) == ("failure", 2)
    assert idiff(*arguments, tmp_path / "a.exr", tmp_path / "b.exr") == 0


@pytest.mark.parametrize("a, b", [(math.nan, 1.0), (math.inf, 1.0), (math.inf, -math.inf), (math.nan, math.inf)])
def test_no_threshold_excuses_nan_and_inf_on_one_side(a, b):
    generous = {"fail": math.inf, "failpercent": 100, "allowfailures": 99, "failrelative": 10, "rules": {"Z": math.inf}}
    for one, other in ((a, b), (b, a)):
        report = diff(plane(1.0, one), plane(1.0, other), **generous)
        found = report["Z"]
        assert (report.status, report.passes_with, found.passes_at, found.nonfinite) == ("failure", None, None, 1)
        assert (found.worst, found.max_error, found.mean_error) == ((4, 3), math.inf, 0.0)
        assert "no threshold would pass" in report.verdict and "(4, 3)" in report.verdict


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_equal_nan_and_inf_are_equal(value):
    report = diff(plane(1.0, value), plane(1.0, value))
    assert report.equal and report.exit_code == 0
    pairs = (Frame({"Z": np.array([[value, other]], np.float32)}) for other in (1.0, 1.5))
    changed = diff(*pairs)
    assert (changed["Z"].max_error, changed["Z"].mean_error, changed["Z"].differing) == (0.5, 0.25, 1)


# Thresholds

BELOW, ABOVE = np.float32(1e-6), np.nextafter(np.float32(1e-6), np.float32(1))  # 0.99999999e-6, 1.00000011e-6


@pytest.mark.parametrize("channel", ["R", "G", "B", "A", "Z", "N.X", "N.Y", "N.Z"])
def test_default_fail_is_sharp_in_every_channel(channel):
    """What ships without being asked for: fail, and warn with it, 1e-6 here; ids below; all others allow nothing."""
    assert float(BELOW) < IDIFF_FAIL < float(ABOVE)
    seeded = np.random.default_rng(sum(channel.encode()))
    y, x = int(seeded.integers(H)), int(seeded.integers(W))
    reference, test = image(), image()
    reference.channels[channel][y, x] = 0.0
    for error, code in ((BELOW, 0), (-BELOW, 0), (ABOVE, 2), (-ABOVE, 2)):
        test.channels[channel][y, x] = error
        assert diff(reference, test).exit_code == code
    assert diff(reference, test)[channel].worst == (x, y)


@pytest.mark.parametrize("channel", ["id.prim", "id.object", "id.material"])
def test_ids_are_exact_unless_a_count_is_given(channel):
    reference, test = image(), image()
    values = test.channels[channel]
    values[2, 3] ^= 1
    values[7, 9] = 4294967295
    report = diff(reference, test, fail=1e9, failpercent=100, allowfailures=99, hardfail=math.inf)
    found = report[channel]
    assert (report.exit_code, found.differing, found.worst) == (2, 2, (3, 2))
    assert (found.reference_value, found.test_value) == (reference[channel][2, 3], values[2, 3])
    assert report.passes_with == ["--id-fail", "2"]
    assert diff(reference, test, id_fail=1).exit_code == 2 and diff(reference, test, id_fail=2).exit_code == 0
    assert diff(reference, test, rules={channel: 1}).passes_with == ["--rule", f"{channel}=2"]
    assert diff(reference, test, rules={"id.*": 2}).exit_code == 0


PIXELS = [((0, 0), "R", 1.0), ((0, 0), "G", 1.0), ((1, 1), "B", 1.0)]
AS_IDIFF = [
    (PIXELS, {}, 2), (PIXELS, {"fail": 1}, 0), (PIXELS, {"fail": 0.99}, 2), (PIXELS, {"failpercent": 2}, 1),
    (PIXELS, {"failpercent": 1.99}, 2), (PIXELS, {"failpercent": 2, "warnpercent": 2}, 0),
    (PIXELS, {"allowfailures": 2}, 0), (PIXELS, {"allowfailures": 1}, 2),
    (PIXELS, {"allowfailures": 1, "failpercent": 50}, 1),
    (PIXELS, {"allowfailures": 3, "hardfail": 0.1}, 0), (PIXELS, {"failpercent": 50, "hardfail": 0.5}, 2),
    (PIXELS, {"failpercent": 50, "hardfail": 1.0}, 1), ([], {"fail": 0}, 0), (PIXELS, {"failpercent": 2, "warn": 1}, 0),
    (PIXELS, {"failpercent": 50, "warnpercent": 50, "hardwarn": 0.1}, 1), (PIXELS, {"failrelative": 1.99}, 2),
    (PIXELS, {"failrelative": 2.0}, 0), (PIXELS, {"fail": 0, "failrelative": 2.1}, 0),
]  # fmt: skip


def ten_by_ten(pixels: list) -> Frame:
    channels = {name: np.zeros((10, 10), np.float32) for name in "RGB"}
    for (x, y), name, value in pixels:
        channels[name][y, x] = value
    return Frame(channels)


@pytest.mark.parametrize("pixels, options, code", AS_IDIFF)
def test_thresholds_mean_what_they_mean_to_idiff(tmp_path, pixels, options, code):
    ten_by_ten([]).save(tmp_path / "a.exr")
    ten_by_ten(pixels).save(tmp_path / "b.exr")
    assert diff(tmp_path / "a.exr", tmp_path / "b.exr", **options).exit_code == code
    arguments = [word for name, value in options.items() for word in (f"-{name}", value)]
    assert run(["diff", *map(str, arguments), str(tmp_path / "a.exr"), str(tmp_path / "b.exr"), "-q"]) == code
    assert idiff(*arguments, tmp_path / "a.exr", tmp_path / "b.exr") == code


def test_thresholds_that_idiff_documents_but_does_not_keep():
    a, b = ten_by_ten([]), ten_by_ten(PIXELS)
    assert diff(a, b, fail=10, hardfail=0.5).exit_code == 2  # idiff 3.2.2 passes: hard limits after a count of 0
    assert diff(a, b, fail=10, hardfail=0.5).passes_with == ["--hardfail", "1"]
    assert diff(a, b, fail=2, warn=0.5).exit_code == 1  # and never warns below the failure threshold
    assert diff(a, b, fail=2, hardwarn=0.5).exit_code == 1


def test_pixels_are_counted_in_each_part_alone(tmp_path):
    reference, test = image(), image(R=9.0, N__Y=9.0)
    assert diff(reference, test, allowfailures=1).exit_code == 0
    test.channels["N.X"][0, 0] += 1
    assert diff(reference, test, allowfailures=1).exit_code == 2


def test_numbers_are_those_of_the_definition():
    random = np.random.default_rng(3)
    a, b = (random.standard_normal((H, W)).astype(np.float32) for _ in range(2))
    errors = [abs(float(x) - float(y)) for x, y in zip(a.flat, b.flat)]
    found = diff(Frame({"Z": a}), Frame({"Z": b}))["Z"]
    assert found.max_error == max(errors)
    assert found.mean_error == pytest.approx(math.fsum(errors) / len(errors), rel=1e-14)
    assert found.rms_error == pytest.approx(math.sqrt(math.fsum(e * e for e in errors) / len(errors)), rel=1e-14)
    place = errors.index(max(errors))
    assert found.worst == (place % W, place // W)
    assert (found.reference_value, found.test_value) == (float(a.flat[place]), float(b.flat[place]))
    assert found.failing == found.differing == len(errors)


@GENTLE
@given(
    seed=st.integers(0, 2**32 - 1),
    spread=st.sampled_from([1e-7, 1e-4, 1.0, 1e30]),
    changed=st.integers(0, 30),
    options=st.fixed_dictionaries({}, optional={
        "fail": st.sampled_from([0.0, 1e-5, 0.1]), "failrelative": st.sampled_from([0.01, 0.5]),
        "failpercent": st.sampled_from([1.0, 10.0]), "hardfail": st.sampled_from([0.01, 1.0]),
        "allowfailures": st.integers(0, 5), "id_fail": st.integers(0, 5), "fail_flip": st.sampled_from([0.0, 0.01]),
        "rules": st.just({"N.*": 0.01, "id.object": 2}),
    }),
)  # fmt: skip
def test_what_is_said_to_pass_passes(seed, spread, changed, options):
    random = np.random.default_rng(seed)
    reference, test = image(), image()
    for _ in range(changed):
        name = str(random.choice(list(test)))
        place = tuple(random.integers(0, (H, W)))
        if name.startswith("id."):
            test.channels[name][place] += 1
        else:
            test.channels[name][place] += np.float32(random.standard_normal() * spread)
    report = diff(reference, test, **options)
    mirrored = diff(test, reference, **options)
    assert mirrored.status == report.status
    assert [found.max_error for found in mirrored.channels] == [found.max_error for found in report.channels]
    if report.status != "failure":
        return
    words = report.passes_with
    assert words and f"{' '.join(words)} would pass" in report.verdict
    better = dict(options, rules=dict(options.get("rules", {})))
    for option, value in zip(words[::2], words[1::2]):
        if option == "--rule":
            name, _, threshold = value.partition("=")
            better["rules"][name] = float(threshold)
        else:
            better[option[2:].replace("-", "_")] = float(value)
    assert diff(reference, test, **better).status in ("pass", "warning")
    for option, value in zip(words[::2], words[1::2]):  # and with less of any of them it still fails
        if option == "--rule" and {"allowfailures", "failpercent"} & set(options):
            continue  # which pixels to excuse is then a choice, and the rule for a channel is the safe one
        less = dict(better)
        if option == "--rule":
            name, _, threshold = value.partition("=")
            less["rules"] = dict(better["rules"], **{name: float(threshold) * 0.99 - (name.startswith("id.") * 0.5)})
        else:
            less[option[2:].replace("-", "_")] = float(value) * 0.99
        assert diff(reference, test, **less).status == "failure", option


@given(st.floats(min_value=1e-300, max_value=1e300))
def test_thresholds_are_rounded_upwards(value):
    up = rounded_up(value)
    assert value <= up <= value * (1 + 1.1e-5) and len(re.sub(r"e.*|\.|^0\.0*", "", repr(up)).strip("0")) <= 6


def test_largest_but_a_few():
    errors = np.array([[3.0, 1.0], [2.0, 0.0]])
    assert [largest_but(errors, allowed) for allowed in range(6)] == [3.0, 2.0, 1.0, 0.0, 0.0, 0.0]


def test_rules():
    reference, test = image(), image(N__X=1.5, N__Y=1.5)
    assert diff(reference, test, rules={"N.*": 2}).exit_code == 0
    assert diff(reference, test, rules={"N.*": 2, "N.Y": 0.1})["N.Y"].status == "failure"
    assert diff(reference, test, rules={"N.*": 2, "N.Y": 0.1})["N.X"].status == "pass"
    for rules in ({"M.X": 1.0}, {"N.*": 1.0, "N.[XY]": 2.0}, {"N.X": -1.0}, {"N.X": math.nan}):
        with pytest.raises(UsageError):
            diff(reference, test, rules=rules)


@pytest.mark.parametrize("name", sorted(set(Thresholds.__dataclass_fields__) - {"rules", "allow_missing", "header"}))
def test_thresholds_are_numbers_from_zero(name):
    for value in (-1, math.nan, "x"):
        with pytest.raises(UsageError, match=name.replace("_", "-")):
            diff(image(), image(), **{name: value})
    with pytest.raises(UsageError, match="fall"):
        diff(image(), image(), fall=1)


# Structure

def test_sizes_channels_and_parts(tmp_path):
    whole = image()
    smaller = Frame({name: values[1:] for name, values in whole.channels.items()})
    floats = Frame({**whole.channels, "id.prim": whole["id.prim"].astype(np.float32)})
    for other, said in (
        (smaller, "10x8"), (floats, "id.prim"), (Frame({"W": whole["Z"]}), "missing"),
        (without(whole, "N.Y"), "N.Y is missing"), (without(whole, "N.X", "N.Y", "N.Z"), "part normal"),
        (without(whole, "R", "G", "B", "A", "Z"), "part beauty"),
    ):  # fmt: skip
        for one, two in ((whole, other), (other, whole)):
            report = diff(one, two)
            assert report.exit_code == 3 and said in " ".join(report.structure), report.structure
    lacking = without(image(Z=0.0), "N.X", "id.prim")
    assert diff(whole, lacking).exit_code == 3
    assert diff(whole, lacking, allow_missing=True).exit_code == 2
    assert diff(without(whole, "Z"), lacking, allow_missing=True).exit_code == 0
    for never in (smaller, floats, Frame({"W": whole["Z"]})):
        assert diff(whole, never, allow_missing=True).exit_code == 3


def write_parts(
    path: Path, *parts: tuple[str, str, dict[str, np.ndarray]], origin: tuple[int, int] = (0, 0), whole: int = 64
) -> None:
    """A file as another program may write it: (part name, type, channels), stored from `origin` on."""
    specs = []
    for name, kind, channels in parts:
        rows, columns = next(iter(channels.values())).shape
        spec = oiio.ImageSpec(columns, rows, len(channels), kind)
        spec.channelnames = tuple(channels)
        spec.x, spec.y = origin
        spec.full_width = spec.full_height = whole
        spec.attribute("oiio:subimagename", name)
        specs.append(spec)
    output = oiio.ImageOutput.create("openexr")
    assert output.open(str(path), tuple(specs))
    for index, (_, _, channels) in enumerate(parts):
        assert index == 0 or output.open(str(path), specs[index], "AppendSubimage")
        assert output.write_image(np.stack(list(channels.values()), axis=-1))
    assert output.close()


def test_files_of_other_programs(tmp_path):
    r, z = np.full((4, 4), 0.5, np.float32), np.full((4, 4), 2.0, np.float32)
    changed = z.copy()
    changed[1, 2] = 3.0
    files = {
        "a": (("left", "float", {"R": r}), ("right", "float", {"R": z})),
        "b": (("left", "float", {"R": r}), ("right", "float", {"R": changed})),
        "swapped": (("right", "float", {"R": z}), ("left", "float", {"R": r})),
        "one": (("left", "float", {"R": r, "Z": z}),),
        "two": (("left", "float", {"R": r}), ("depth", "float", {"Z": z})),
        "half": (("left", "half", {"R": r, "Z": z}),),
    }
    for name, parts in files.items():
        write_parts(tmp_path / f"{name}.exr", *parts, origin=(10, 20))
    path = {name: tmp_path / f"{name}.exr" for name in files}
    report = diff(path["a"], path["b"])
    assert report["right/R"].worst == (12, 21) and report.exit_code == 2  # in the whole image, not in what is stored
    assert diff(path["a"], path["swapped"]).exit_code == 3
    assert diff(path["one"], path["two"]).exit_code == 3
    assert diff(path["one"], path["two"], allow_missing=True).exit_code == 0
    halved = diff(path["one"], path["half"])
    assert halved.exit_code == 0 and any("half" in note for note in halved.notes)
    write_parts(tmp_path / "moved.exr", files["one"][0], origin=(11, 20))
    assert diff(path["one"], tmp_path / "moved.exr").exit_code == 3
    write_parts(tmp_path / "framed.exr", files["one"][0], origin=(10, 20), whole=65)
    assert diff(path["one"], tmp_path / "framed.exr").structure == [
        f"the whole image: 64x64 in {path['one']}, 65x65 in {tmp_path / 'framed.exr'}"
    ]


def test_headers_are_notes_unless_asked_for(tmp_path):
    for name, precision in (("a", "fast"), ("b", "exact")):
        Frame(image().channels, {"precision": precision, "fov": 45.5, "seed": 1}).save(tmp_path / f"{name}.exr")
    report = diff(tmp_path / "a.exr", tmp_path / "b.exr")
    assert report.exit_code == 0 and report.notes == ["header precision: fast | exact"]
    assert diff(tmp_path / "a.exr", tmp_path / "b.exr", header=True).exit_code == 2
    frame = Frame(image().channels, {"precision": "fast", "fov": 45.5, "seed": 1})
    assert diff(tmp_path / "a.exr", frame, header=True).exit_code == 0


def test_generated_pairs_agree_with_idiff(tmp_path):
    """Finite single-part images, seeded: the same exit code as idiff wherever its hard limits play no part."""
    random = np.random.default_rng(11)
    for index in range(12):
        a = random.random((6, 7, 3)).astype(np.float32)
        b = a + (random.random(a.shape) < 0.1) * random.choice([1e-7, 1e-3, 0.3]).astype(np.float32)
        for name, values in (("a", a), ("b", b)):
            Frame({channel: values[..., k] for k, channel in enumerate("RGB")}).save(tmp_path / f"{name}.exr")
        options = {
            "fail": float(random.choice([1e-6, 0.01])), "failpercent": float(random.choice([0, 10, 30])),
            "allowfailures": int(random.choice([0, 3])), "failrelative": float(random.choice([0.0, 0.05])),
        }  # fmt: skip
        options["warn"], options["warnrelative"] = options["fail"], options["failrelative"]
        words = [word for name, value in options.items() for word in (f"-{name}", value)]
        expected = idiff(*words, tmp_path / "a.exr", tmp_path / "b.exr")
        assert diff(tmp_path / "a.exr", tmp_path / "b.exr", **options).exit_code == expected, (index, options)
