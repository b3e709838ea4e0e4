"""Error against time: errors, the front and its noise, the table of knobs, rounds, the cache, plot and page."""

from __future__ import annotations

import base64
import itertools
import json
import math
import random
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from accuracy_world import FRONT, SIZE, TABLE, point, row, study
from PIL import Image

from clrast.options import RenderOptions
from clrast.scene.model import Light, Material, Scene
from clrast.study import accuracy_cache as cache
from clrast.study.accuracy import kernels_known
from clrast.study.accuracy_answers import OF_COMMAND, OF_FRAME, RUNS, Advisor, Run
from clrast.study.accuracy_errors import measure_errors
from clrast.study.accuracy_front import (
    LEAST_NOISE,
    is_faster,
    median_interval,
    noise_of,
    pareto_front,
    unclear_names,
)
from clrast.study.accuracy_knobs import KNOB_NAMES, KNOBS, Knob, Setting, apply, make_settings
from clrast.study.accuracy_page import MOST_BYTES, Pictures, page, worst_window
from clrast.study.accuracy_plot import draw, make_figure
from clrast.study.accuracy_runs import FEWEST_ROUNDS, MOST_ROUNDS, measure_rounds

BASE = RenderOptions(size=SIZE)

# Errors


def test_errors_in_closed_form() -> None:
    """One of 6 components is off by 0.3, where the reference is 0.4: 0.09 / 6, and 0.09 / (0.16 + 0.01) / 6."""
    reference = np.full((1, 2, 3), 0.4, np.float32)
    found = reference.copy()
    found[0, 1, 2] = np.float32(0.7)
    errors = measure_errors(found, reference, with_flip=False)
    assert errors.mse == pytest.approx(0.015, rel=1e-6) and errors.rmse == pytest.approx(math.sqrt(0.015), rel=1e-6)
    assert errors.relative_mse == pytest.approx(0.09 / 0.17 / 6, rel=1e-6)
    assert (errors.worst, errors.worst_pixel, errors.flip) == (pytest.approx(0.3, rel=1e-6), (1, 0), None)
    assert errors.value("worst") == errors.worst and errors.value("flip") == math.inf


def test_equal_infinities_are_equal_and_others_infinitely_wrong() -> None:
    reference = np.array([[[np.inf, 0.0, 1.0]]], np.float32)
    assert measure_errors(reference.copy(), reference, with_flip=False).mse == 0.0
    for wrong in (np.inf, np.nan):
        found = reference.copy()
        found[0, 0, 1] = wrong
        assert measure_errors(found, reference, with_flip=False).worst == math.inf


def test_flip_is_the_mean_of_its_map() -> None:
    from clrast.image.flip import flip_error

    rng = np.random.default_rng(3)
    reference, found = rng.random((2, 16, 16, 3), np.float32)
    assert measure_errors(found, reference).flip == flip_error(reference, found).mean > 0


# The front


def test_the_interval_of_a_median_holds_it_as_often_as_it_says() -> None:
    """In 2000 samples of 12 from a distribution with the median 1: 95 per cent or more, up to 4 sigma of the count."""
    rng = random.Random(11)
    held = 0
    for _ in range(2000):
        low, high = median_interval([math.exp(rng.gauss(0, 0.3)) for _ in range(12)])
        held += low <= 1.0 <= high
    assert held >= 2000 * 0.95 - 4 * math.sqrt(2000 * 0.95 * 0.05)
    assert median_interval([1.0] * 6) == (1.0, 1.0)


@pytest.mark.parametrize("count", range(6, 41))
def test_the_interval_takes_the_ranks_that_the_binomial_gives(count: int) -> None:
    """The largest k whose two tails together stay within 5 per cent, by a sum over all heads of `count` coins."""
    values = list(range(1, count + 1))
    low, high = median_interval(values)
    assert low + high == count + 1

    def outside(k: int) -> float:
        return 2 * sum(math.comb(count, heads) for heads in range(k)) / 2**count

    assert outside(int(low)) <= 0.05 < outside(int(low) + 1)


def test_few_pairs_say_little() -> None:
    assert not is_faster(point("a", 1, 93.0, 93.0), point("b", 1, 100.0, 100.0))
    assert is_faster(point("a", 1, 93.0), point("b", 1, 100.0))
    assert not is_faster(point("a", 1, 96.0), point("b", 1, 100.0))


def test_noise_is_what_rounds_do_not_share() -> None:
    """Lognormal times of 20 settings: twice sigma times the root of 2, within 4 sigma of the estimate; no drift."""
    rng = random.Random(2)
    drift = [1.3**k for k in range(15)]
    noisy = [{k: 10.0 * n * d * math.exp(rng.gauss(0, 0.2)) for k, d in enumerate(drift)} for n in range(1, 21)]
    expected = 2 * math.sqrt(2) * 0.2
    assert noise_of(noisy) == pytest.approx(expected, rel=4 / math.sqrt(2 * 15 * 20))
    quiet = [{k: 10.0 * n * d for k, d in enumerate(drift)} for n in range(1, 21)]
    assert noise_of(quiet) == noise_of([]) == LEAST_NOISE


def test_a_single_frame_says_little_in_a_noisy_run() -> None:
    fast, slow = (replace(point("a", 1, 60.0), times_ms={0: ms}, noise=noise) for ms, noise in ((60, 0.8), (100, 0.8)))
    assert not is_faster(fast, slow)
    assert is_faster(replace(fast, noise=0.12), replace(slow, noise=0.12))


def names(points: list) -> list[str]:
    return [each.name for each in pareto_front(points)]


def test_front_of_a_clean_curve() -> None:
    points = [point("slow", 1.0, 40.0), point("fast", 4.0, 10.0), point("off", 5.0, 20.0), point("middle", 2.0, 20.0)]
    assert names(points) == ["fast", "middle", "slow"]
    for order in itertools.permutations(points):
        assert names(list(order)) == ["fast", "middle", "slow"]


def test_level_points_are_one_and_the_simplest_stands_for_them() -> None:
    same = [point("both", 1.0, 99.0, changes=2), point("plain", 1.01, 100.0, changes=0), point("one", 1.0, 101.0)]
    for order in itertools.permutations(same):
        assert names(list(order)) == ["plain"]
    assert names([point("first", 1.0, 10.0), point("second", 1.0, 10.0)]) == ["first"]


def test_a_point_must_beat_the_front_by_more_than_the_noise() -> None:
    """Half of its frames are faster than the better one's, half are slower: it is not on the front."""
    times = [80.0, 120.0] * 10
    noisy, better = point("noisy", 2.0, *times), point("better", 1.0, 100.0)
    assert names([noisy, better]) == ["better"]
    assert unclear_names([noisy, better]) == {"noisy", "better"}
    clear = point("clear", 2.0, *[0.4 * time for time in times])
    assert names([clear, better]) == ["clear", "better"] and unclear_names([clear, better]) == set()


def test_a_drift_that_both_share_is_no_noise() -> None:
    drift = [10.0 * 1.5**k for k in range(12)]
    fast, slow = point("fast", 2.0, *[0.9 * d for d in drift]), point("slow", 1.0, *drift)
    assert is_faster(fast, slow) and names([fast, slow]) == ["fast", "slow"]


def test_the_front_stays_when_it_is_measured_again() -> None:
    """Times with 15 per cent of noise round those of a curve: the same points, whatever the seed."""
    truth = {"a": (4.0, 10.0), "b": (2.0, 20.0), "c": (1.0, 40.0), "off": (3.0, 35.0)}
    fronts = set()
    for seed in range(40):
        rng = random.Random(seed)
        points = [
            point(name, error, *[ms * math.exp(rng.gauss(0, 0.15)) for _ in range(15)])
            for name, (error, ms) in truth.items()
        ]
        fronts.add(tuple(names(points)))
    assert fronts == {("a", "b", "c")}


def test_neighbours_that_noise_hides_take_no_other_with_them() -> None:
    """Each step of the ladder is within the noise of the next, and the ends are ten times apart."""
    rng = random.Random(4)
    ladder = [point(str(k), 2.0**-k, *[10 * 1.3**k * math.exp(rng.gauss(0, 0.4)) for _ in range(7)]) for k in range(10)]
    found = names(ladder)
    assert found[-1] == "9" and int(found[0]) <= 3 and len(found) >= 3


def test_an_error_of_zero_and_an_infinite_one() -> None:
    assert names([point("right", 0.0, 10.0), point("also", 0.0, 20.0), point("broken", math.inf, 1.0)]) == ["right"]


# Knobs


def test_first_frames_wait_for_kernels_that_no_setting_before_has() -> None:
    """Of msaa those of 16 and 32 samples have kernels of lists; what lists pixels has its own each time."""
    modes = [
        ("none", "pixel"), ("msaa:2", "pixel"), ("msaa:8", "pixel"), ("msaa:16", "pixel"), ("msaa:32", "pixel"),
        ("csaa:4+12", "pixel"), ("csaa:8+8", "pixel"), ("ssaa:2", "pixel"), ("ssaa:16", "pixel"), ("auto:0.1", "pixel"),
        ("auto:0.01", "pixel"), ("msaa:4", "auto"), ("msaa:16", "auto"),
    ]  # fmt: skip
    chosen = [
        Setting(f"{aa} {rate}", "antialiasing", {}, replace(BASE, aa=aa, shading_rate=rate)) for aa, rate in modes
    ]
    assert kernels_known(chosen) == ["msaa:8 pixel", "msaa:32 pixel", "csaa:8+8 pixel", "ssaa:16 pixel"]


def test_each_knob_is_turned_alone_and_reasons_are_kept() -> None:
    settings = make_settings(BASE)
    assert settings.chosen[0].options == BASE and settings.chosen[0].changes == {}
    alone = [each for each in settings.chosen[1:] if each.knob != "combination"]
    # A grid's resolution needs a method with a grid, and a rate samples to share.
    pairs = {"method", "grid_resolution"}, {"aa", "shading_rate"}
    assert all(len(each.changes) == 1 or set(each.changes) in pairs for each in alone)
    assert {each.options.aa for each in alone if "shading_rate" in each.changes} == {"msaa:4", "msaa:16"}
    for one in settings.chosen:
        assert one.options == apply(BASE, one.changes)
        assert all(getattr(BASE, option) != value for option, value in one.changes.items())
    found = [each.options for each in settings.chosen]
    assert all(options not in found[:k] for k, options in enumerate(found))
    assert {each.changes["precision"] for each in alone if each.knob == "precision"} == {
        "fast", "ordered", "fixed", "double", "exact",
    }  # fmt: skip
    assert (settings.reference.precision, settings.reference.aa) == ("exact", "ssaa:1024")
    assert all(reason for reason in settings.left_out.values())


def test_what_is_refused_is_left_out_with_its_reason() -> None:
    """A row for an option that another version has, one whose value is refused, and one of another mode."""
    knobs = (
        Knob("new", ({"texture_filter": "trilinear"}, {"texture_filter": "nearest"}), {"texture_filter": "trilinear"}),
        Knob("antialiasing", ({"aa": "msaa:3"}, {"aa": "msaa:4"})),
        Knob("bounces", ({"precision": "fast"},), modes=("path",)),
    )
    settings = make_settings(BASE, names=("new", "antialiasing", "bounces"), knobs=knobs, combinations=())
    assert [each.name for each in settings.chosen] == ["default", "aa msaa:4"]
    assert settings.left_out == {
        "new": "this version has no option --texture-filter",
        "aa msaa:3": "--aa msaa:3: msaa takes 2, 4, 8, 16, 32 samples",
        "bounces": "acts in mode path, and this is cast",
    }
    assert settings.reference == replace(BASE, precision="exact", aa="ssaa:1024")


def test_the_default_is_what_the_user_gives() -> None:
    base = replace(BASE, aa="msaa:8", precision="fast")
    settings = make_settings(base, 256)
    by_name = {each.name: each for each in settings.chosen}
    assert "precision fast" not in by_name and "aa msaa:8" not in by_name
    assert by_name["precision exact"].options == replace(base, precision="exact")
    assert by_name["aa none"].options.precision == "fast"
    assert "needs a reference of 1024 samples" in settings.left_out["aa ssaa:256"]
    assert settings.reference.aa == "ssaa:256"
    only = make_settings(base, names=("output",))
    assert [each.name for each in only.chosen] == ["default", "half"]


def test_paths_are_counted_as_samples() -> None:
    """In mode path the reference has one path for each of 1024 samples, and a default of 16 is no setting twice."""
    settings = make_settings(replace(BASE, mode="path"))
    assert (settings.reference.aa, settings.reference.samples) == ("ssaa:1024", 1)
    assert settings.reference.max_depth == 16 and settings.reference.effects == {"derivatives": "off"}
    names_of = {each.name for each in settings.chosen}
    assert {"samples 1", "samples 4", "samples 64", "samples 256", "max-depth 4", "aa ssaa:16"} <= names_of
    assert not {"samples 16", "max-depth 8", "aa ssaa:64"} & names_of
    assert "needs a reference of 4096 samples" in settings.left_out["aa ssaa:64"]
    whitted = make_settings(replace(BASE, mode="whitted"))
    assert "samples" in whitted.left_out and "max-depth 2" in {each.name for each in whitted.chosen}


def test_an_effect_is_turned_and_the_others_stay() -> None:
    base = replace(BASE, effects={"alpha mask": "off"})
    settings = make_settings(base, names=("textures",))
    names = ["default", *(f"derivatives {each}" for each in ("off", "coarse", "on"))]
    assert [each.name for each in settings.chosen] == names
    assert settings.chosen[1].options.effects == {"alpha mask": "off", "derivatives": "off"}
    assert settings.chosen[1].changes == {"effects": {"derivatives": "off"}}


def test_rungs_of_other_methods_are_left_out() -> None:
    settings = make_settings(replace(BASE, method="3dr-full"))
    assert "3dr-full projects none" in settings.left_out["precision fixed"]


def test_what_does_not_go_with_the_view_is_left_out() -> None:
    settings = make_settings(BASE, projection="latlong")
    for name in ("precision fixed", "evaluation incremental", "grid"):
        assert "latlong is none" in settings.left_out[name] or "latlong has sines" in settings.left_out[name]
    assert all(each.options.method != "raycast-grid" for each in settings.chosen)


def test_names_of_the_table_are_unique() -> None:
    assert len(set(KNOB_NAMES)) == len(KNOB_NAMES) == len(KNOBS) + 1


# Rounds


@dataclass
class FakeRunner:
    """Frames that take the milliseconds that they are told, on a clock of their own."""

    ms: dict[str, float]
    seconds: float = 0.0
    log: list[str] = field(default_factory=list)

    def frame(self, name: str) -> float:
        self.seconds += self.ms[name] / 1000
        self.log.append(name)
        return self.ms[name]

    def clock(self) -> float:
        return self.seconds


def rounds(runner: FakeRunner, budget: float, unclear: object = None, long: tuple[str, ...] = ()) -> dict:
    return measure_rounds(
        runner, runner.ms, long, budget, unclear or (lambda times: ()), clock=runner.clock
    )  # fmt: skip


def test_all_take_turns_in_orders_that_change() -> None:
    runner = FakeRunner({"a": 1.0, "b": 2.0, "c": 3.0})
    times = rounds(runner, 10.0)
    assert {name: list(found) for name, found in times.items()} == {n: list(range(FEWEST_ROUNDS)) for n in "abc"}
    orders = [tuple(runner.log[k : k + 3]) for k in range(0, len(runner.log), 3)]
    assert all(sorted(order) == ["a", "b", "c"] for order in orders) and len(set(orders)) > 1


def test_unclear_ones_go_on_and_others_stop() -> None:
    runner = FakeRunner({"a": 1.0, "b": 1.0, "c": 1.0})
    times = rounds(runner, 10.0, lambda found: ("a", "b"))
    assert [len(times[name]) for name in "abc"] == [MOST_ROUNDS, MOST_ROUNDS, FEWEST_ROUNDS]


def test_slow_ones_take_their_share_and_one_frame_at_least() -> None:
    """Of 4 s two settings have 2 s each: two frames of 0.9 s, one of 30 s, or none where the warm-up counts."""
    runner = FakeRunner({"cheap": 10.0, "slow": 900.0})
    times = rounds(runner, 4.0)
    assert len(times["cheap"]) == FEWEST_ROUNDS and len(times["slow"]) == 2
    runner = FakeRunner({"cheap": 10.0, "huge": 30000.0})
    assert len(rounds(runner, 4.0)["huge"]) == 1
    runner = FakeRunner({"cheap": 10.0, "huge": 30000.0})
    times = rounds(runner, 4.0, long=("huge",))
    assert times["huge"] == {-1: 30000.0} and "huge" not in runner.log


# The cache


def scene_of(**changes: object) -> Scene:
    made = Scene(
        positions=np.eye(3, dtype=np.float32), triangles=np.array([[0, 1, 2]], np.uint32),
        object_ids=np.zeros(1, np.uint32), material_ids=np.zeros(1, np.uint32),
    )  # fmt: skip
    return replace(made, **changes)


def test_all_that_decides_a_pixel_changes_the_key(monkeypatch: pytest.MonkeyPatch) -> None:
    decided = {"aa": "ssaa:16", "camera.e": (0.0, 0.0, 1.0)}
    key = cache.reference_key(scene_of(), decided)
    assert key == cache.reference_key(scene_of(), dict(decided))
    assert key == cache.reference_key(scene_of(name="other", warnings=("x",)), decided)
    moved = np.eye(3, dtype=np.float32)
    moved[0, 0] = np.nextafter(np.float32(1), np.float32(2))
    others = [
        cache.reference_key(scene_of(positions=moved), decided),
        cache.reference_key(scene_of(materials=(Material(roughness=0.5),)), decided),
        cache.reference_key(scene_of(lights=(Light("sun", "directional", (1.0, 1.0, 1.0)),)), decided),
        cache.reference_key(scene_of(), {**decided, "aa": "ssaa:64"}),
        cache.reference_key(scene_of(), {**decided, "camera.e": (0.0, 0.0, 1.5)}),
    ]
    monkeypatch.setattr(cache, "_program_digest", lambda: "another version")
    others.append(cache.reference_key(scene_of(), decided))
    assert len({key, *others}) == 7


def test_references_are_kept_whole_and_damaged_ones_are_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CLRAST_CACHE_DIR", str(tmp_path))
    color = np.random.default_rng(1).random((4, 8, 3), np.float32)
    assert cache.load_reference("a", color.shape) is None
    cache.save_reference("a", color)
    assert np.array_equal(cache.load_reference("a", color.shape), color)
    assert cache.load_reference("a", (8, 4, 3)) is None
    file = tmp_path / cache.FOLDER / "a.npz"
    assert [path.name for path in file.parent.iterdir()] == ["a.npz"]
    content = file.read_bytes()
    for damaged in (b"", content[:-30], content[:300] + b"\xff\x00" + content[302:], b"PK\x03\x04" * 9):
        file.write_bytes(damaged)
        assert cache.load_reference("a", color.shape) is None
    for k in range(cache.MOST_FILES + 5):
        cache.save_reference(f"b{k}", color)
    assert len(list(file.parent.iterdir())) == cache.MOST_FILES
    monkeypatch.setenv("CLRAST_CACHE_DIR", "off")
    cache.save_reference("c", color)
    assert cache.load_reference("b9", color.shape) is None


def test_a_cache_that_cannot_be_written_is_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("CLRAST_CACHE_DIR", str(tmp_path / "file"))
    cache.save_reference("a", np.zeros((1, 1, 3), np.float32))
    assert cache.load_reference("a", (1, 1, 3)) is None


# Answers


OVERHEAD = 1.0


def runner_of(factor: float = 1.0, log: list[str] | None = None) -> object:
    """Commands whose frames take `factor` times what the study measured."""

    def run(found: object) -> Run:
        if log is not None:
            log.append(found.name)
        spent = factor * found.median_ms
        return Run(OVERHEAD + spent / 1000, spent, found.errors.rmse)

    return run


@pytest.mark.parametrize(
    ("seconds", "of", "name"),
    [(1.05, OF_COMMAND, "default"), (1.3, OF_COMMAND, "aa ssaa:4"), (9.0, OF_COMMAND, "aa ssaa:16"),
     (0.05, OF_FRAME, "default"), (0.24, OF_FRAME, "aa msaa:4"), (0.9, OF_FRAME, "aa ssaa:16")],
)  # fmt: skip
def test_the_best_within_a_time(seconds: float, of: str, name: str) -> None:
    answer = Advisor(TABLE, runner_of()).within_time(seconds, of)
    assert (answer.reached, answer.row.name, len(answer.runs)) == (True, name, RUNS)
    assert answer.predicted_s == pytest.approx(OVERHEAD + answer.row.median_ms / 1000)


def test_an_unreachable_time_names_the_nearest() -> None:
    answer = Advisor(TABLE, runner_of()).within_time(1.01, OF_COMMAND)
    assert not answer.reached and answer.row.name == "default"


def test_what_takes_longer_when_it_is_run_is_not_claimed() -> None:
    """Frames take twice what was measured: 1.5 s hold no ssaa:16 (1.9 s by prediction, 2.8 s in truth)."""
    answer = Advisor(TABLE, runner_of(2.0)).within_time(1.95, OF_COMMAND)
    assert answer.reached and answer.row.name == "aa ssaa:4"
    assert all(run.command_s <= 1.95 for run in answer.runs)


def test_the_cheapest_for_an_error() -> None:
    advisor = Advisor(TABLE, runner_of())
    assert [advisor.for_error(error).row.name for error in (0.02, 0.01, 0.0031)] == [
        "default", "aa ssaa:4", "aa ssaa:16",
    ]  # fmt: skip
    unreachable = advisor.for_error(0.001)
    assert not unreachable.reached and unreachable.row.name == "aa ssaa:16"


def test_without_runs_frames_alone_are_known() -> None:
    answer = Advisor(TABLE, None).within_time(0.3, OF_FRAME)
    assert (answer.row.name, answer.predicted_s, answer.runs) == ("aa ssaa:4", None, ())


# The study, the plot, the page


def test_the_study_as_plain_data() -> None:
    found = TABLE.as_dict()
    assert tuple(found["front"]) == FRONT == tuple(each["name"] for each in found["settings"] if each["on_front"])
    first, exact = found["settings"][:2]
    assert first["wrong_samples"] == 3 and first["samples"] == 32 and first["relative"] == 1.0
    assert exact["options"] == {"precision": "exact"} and exact["relative"] == pytest.approx(1.1)
    assert exact["frame_ms"] == {"median": 44.0, "p10": 44.0, "p90": 44.0, "frames": 20}
    assert exact["errors"] == {
        "rmse": pytest.approx(0.02), "mse": pytest.approx(0.0004), "relative_mse": pytest.approx(0.0008),
        "flip": pytest.approx(0.06), "worst": pytest.approx(0.08), "worst_pixel": [5, 2],
    }  # fmt: skip
    json.dumps(found, allow_nan=False)


def test_the_plot_names_the_front_and_has_a_place_for_no_error() -> None:
    with_zero = study(*TABLE.rows, row({"aa": "ssaa:64"}, 0.0, 4000.0))
    axes = make_figure(with_zero).axes[0]
    texts = {text.get_text() for text in axes.texts}
    assert {*FRONT, "aa ssaa:64", "no error"} <= texts and "aa auto:0.01" not in texts
    bottom, _ = axes.get_ylim()
    assert 0 < bottom < 0.003 / 3
    svg = draw(with_zero, ".svg")
    ElementTree.fromstring(svg)
    assert draw(with_zero, ".svg") == svg and b"seconds of a frame" in svg
    assert draw(TABLE, ".png")[:4] == b"\x89PNG"


def pictures_of(found: object, side: int | None = None, shape: tuple[int, int] = (4, 8)) -> Pictures:
    """A picture of each row: noise of its own round one reference."""
    rng = np.random.default_rng(5)
    reference = rng.random((*shape, 3), np.float32) * np.float32(0.7)
    pictures = Pictures(side)
    for each in found.rows:
        noise = rng.random((*shape, 3), np.float32) * np.float32(0.2)
        pictures.add(each.name, reference + noise, reference)
    return pictures


def test_the_page_has_everything_inside() -> None:
    text = page(TABLE, pictures_of(TABLE), {each.name: f"clrast render {each.name}" for each in TABLE.rows})
    assert not re.search(r"""(?:src|href)=["'](?!data:)""", text) and "http" not in text.replace("http-equiv", "")
    assert "@" not in re.sub(r"<script.*?</script>", "", text, flags=re.S)
    svg = ElementTree.fromstring(re.search(r"<svg.*?</svg>", text, re.S)[0])
    points = [each for each in svg.iter("g") if "point" in each.get("class", "").split()]
    points.sort(key=lambda each: int(each.get("data-index")))
    assert [int(each.get("data-index")) for each in points] == list(range(len(TABLE.rows)))
    assert {TABLE.rows[int(each.get("data-index"))].name for each in points if "on-front" in each.get("class")} == set(
        FRONT
    )
    x = [float(each.find("circle").get("cx")) for each in points]
    y = [float(each.find("circle").get("cy")) for each in points]
    by_time, by_error = (sorted(range(len(x)), key=key) for key in (x.__getitem__, y.__getitem__))
    times, errors = [r.median_ms for r in TABLE.rows], [r.errors.rmse for r in TABLE.rows]
    assert [times[k] for k in by_time] == sorted(times)
    assert [errors[k] for k in by_error] == sorted(errors, reverse=True)


def data_of(text: str) -> dict:
    return json.loads(re.search(r'<script id="data"[^>]*>(.*?)</script>', text, re.S)[1])


def decoded(source: str, tmp_path: Path) -> np.ndarray:
    head, _, content = source.partition(",")
    assert head == "data:image/png;base64"
    (tmp_path / "x.png").write_bytes(base64.b64decode(content))
    return np.asarray(Image.open(tmp_path / "x.png"))


def test_pictures_of_the_page_are_the_tone_mapped_images(tmp_path: Path) -> None:
    from clrast.image.tone import srgb_bytes, tone_map

    pictures = Pictures()
    reference = np.linspace(0, 2, 96, dtype=np.float32).reshape(4, 8, 3)
    for each in TABLE.rows:
        pictures.add(each.name, reference * np.float32(0.5), reference)
    data = data_of(page(TABLE, pictures, {each.name: "" for each in TABLE.rows}))
    assert data["window"] == [0, 0, 8, 4] and len(data["pictures"]) == 2  # equal ones are stored once
    shown = decoded(data["pictures"][data["settings"][0]["picture"]], tmp_path)
    assert np.array_equal(shown, srgb_bytes(tone_map(reference * np.float32(0.5))))
    assert np.array_equal(decoded(data["pictures"][data["reference"]], tmp_path), srgb_bytes(tone_map(reference)))


def test_a_scene_with_an_evil_name_stays_text() -> None:
    evil = replace(TABLE, scene="</script><script>alert(1)</script>@DATA@")
    text = page(evil, pictures_of(evil), {each.name: "</script><b>" for each in evil.rows})
    assert text.count("<script") == 2 and "<b>" not in text and "alert(1)</script>" not in text
    assert data_of(text)["settings"][0]["command"] == "</script><b>"


def test_the_window_is_where_the_error_is() -> None:
    reference = np.zeros((40, 60, 3), np.float32)
    found = reference.copy()
    found[30:34, 50:54] = 1.0
    x, y, width, height = worst_window(found, reference, 16)
    assert (width, height) == (16, 16) and x <= 50 and x + 16 >= 54 and y <= 30 and y + 16 >= 34
    assert worst_window(found, reference, 100) == (0, 0, 60, 40)


def test_the_page_stays_within_its_bytes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Noise hardly compresses: the window shrinks until all pictures fit; a side that was asked for stays."""
    from clrast.study import accuracy_page

    assert MOST_BYTES <= 8_000_000
    monkeypatch.setattr(accuracy_page, "MOST_BYTES", 300_000)
    files, (x, y, width, height) = pictures_of(TABLE, shape=(160, 240)).encoded()
    assert sum(map(len, files.values())) <= 300_000 and 64 <= height <= width < 240
    assert x + width <= 240 and y + height <= 160
    (tmp_path / "x.png").write_bytes(files["reference"])
    assert Image.open(tmp_path / "x.png").size == (width, height)
    _, window = pictures_of(TABLE, side=150, shape=(160, 240)).encoded()
    assert window[2:] == (150, 150)
