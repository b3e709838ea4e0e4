"""`clrast cost`: traces, passes, words, the cache and the cost equation, each against something computed otherwise."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from continuum_world import oblique, soup, through_samples
from kernel_world import make_scene, start

from clrast.__main__ import main
from clrast.opencl import kernels
from clrast.opencl.device import Device
from clrast.study import cache_simulation as cache
from clrast.study import cost
from clrast.study.cost import CostStudy
from clrast.study.cost_equation import Constants, Point, fit, held_out
from clrast.study.ray_traces import Trace, count_passes, make_trace, run_passes
from clrast.study.traffic import KINDS, STATE, TRIANGLES, WORDS, branching_traffic, multipass_traffic
from clrast.visibility.loop_limits import loop_limit
from clrast.visibility.oracles import OracleChoice

PURCELL = OracleChoice("purcell", 20)


@pytest.fixture
def free(device: Device) -> Device:
    if loop_limit(device) is not None:
        pytest.skip(f"{device.runtime} ends long loops early: grids are refused there")
    return device


def made(*rays: str) -> Trace:
    """A trace from words: c a cell without triangles, C one with as many as there are 0, 1 or 2 behind it."""
    words = [np.array([0x80000000 | 0x40000000 * (w != "0") | 0x20000000 * (w == "2") | k if w in "012" else k
                       for k, w in enumerate(ray)], np.uint32) for ray in rays]  # fmt: skip
    return make_trace(np.array([len(ray) for ray in rays]), np.concatenate(words))


# --- traces and passes -----------------------------------------------------------------------------


def test_a_trace_says_what_rays_read() -> None:
    trace = made("ccC012c", "", "C2")
    assert trace.steps.tolist() == [4, 0, 1] and trace.tests.tolist() == [3, 0, 1]
    assert trace.reached.tolist() == [0, 0, 0, 0, 1, 2, 0, 0, 2]
    turned = trace.chosen(np.array([2, 0]))
    assert turned.steps.tolist() == [1, 4] and turned.begin.tolist() == [0, 2, 9]
    assert turned.places.tolist() == [0, 1, 0, 1, 2, 3, 4, 5, 6] and turned.pixels.tolist() == [2, 0]


def test_passes_by_hand() -> None:
    """Two rays: c C 2 2 and C 2: naive intersects as soon as one can."""
    trace = made("cC22", "C2")
    passes = run_passes(trace, OracleChoice("naive"))
    kinds = [(each.kind[0], each.rays.tolist(), each.words.tolist()) for each in passes]
    assert kinds == [("t", [0, 1], [0, 4]), ("i", [1], [5]), ("t", [0], [1]), ("i", [0], [2]), ("i", [0], [3])]
    kinds = [(each.kind[0], each.rays.tolist()) for each in run_passes(trace, OracleChoice("delany"), 2, 2)]
    assert kinds == [("t", [0, 1]), ("i", [0, 1])]


@pytest.mark.parametrize("oracle", ["pass=naive", "pass=delany", "pass=purcell:20", "pass=purcell:30"])
def test_the_device_takes_as_many_passes(free: Device, oracle: str) -> None:
    """And the rays in them, unrolled or not; and the trace counts what the counters count."""
    view = oblique("perspective", 60, 40)
    scene = make_scene(*through_samples(view, 7))
    given = {"aov": ("id",), "grid_resolution": 9}
    job, frame = start(free, scene, view, method="raycast-grid", counters=True, **given)
    trace = make_trace(*job.tiles.trace())
    assert job.tiles.loose_count() == 0
    counts = frame.stats["counts"]
    assert trace.steps.sum() == counts["traversal_steps"] and trace.tests.sum() == counts["intersection_tests"]
    assert (trace.reached > 1).sum() == counts["edge_evaluations"]
    setting, _, number = oracle.removeprefix("pass=").partition(":")
    for steps, tests in ((1, 1), (4, 2)):
        wanted = count_passes(trace, OracleChoice(setting, int(number or 20)), steps, tests)
        oracles = (oracle, f"unroll={steps}:{tests}")
        passes = start(free, scene, view, method="raycast-grid-multipass", oracle=oracles, **given)[0].tiles.passes
        assert vars(passes) == vars(wanted)


# --- words -----------------------------------------------------------------------------------------


def test_words_are_those_of_the_kernels_arguments() -> None:
    """Each array's element type in the text of the kernels."""
    sizes = {"uint": 1, "uint2": 2, "float": 1, "uchar": 0.25}
    for name in ("traverse_grid.cl", "pass_rays.cl"):
        text = (kernels.kernel_folder() / name).read_text("utf-8")
        found = re.findall(r"global (?:const )?(\w+) \*restrict (\w+)[,)]", text)
        assert {argument for _, argument in found} >= {"nearness", "visible_prims", "records", "references"}
        for kind, argument in found:
            assert WORDS.get(argument, sizes.get(kind)) == sizes.get(kind), (name, argument)


def test_words_by_hand() -> None:
    """Three rays, one that misses the grid. Branching: 2 read and 2 written a ray, 2 a cell, 1 a reference, 2, 5 or 15
    a record. Multipass, a pass of each word: what the kernels' bodies say."""
    trace = made("ccC012c", "", "C2")
    branching = branching_traffic(trace, 1)
    assert branching.by_kind() == {
        "stencil": 0, "state variables": 12, "grid cells": 10, "triangle lists": 4, "triangles": 2 + 5 + 15 + 15,
        "shading data": 15,
    }  # fmt: skip
    passes = count_passes(trace, PURCELL)
    multipass = multipass_traffic(trace, passes, 1)
    assert (passes.rays_traverse, passes.rays_intersect) == (5, 4)
    assert multipass.by_kind()["stencil"] == 0.5 * (3 + 5 + 4)
    generate = 3 * 1 + 3 * 2 + 2
    traverse = 5 * (2 + 1 + 1 + 1) + 2 * 2
    intersect = 4 * (2 + 1) + 4 * (2 + 2) + 2 * 1 + 4 * 2 + 2 * (4 - 2) + 2 * 1
    assert multipass.by_kind()[STATE] == generate + traverse + intersect + 3
    for kind in KINDS[2:]:
        assert multipass.by_kind()[kind] == branching.by_kind()[kind], "data are the same"


# --- the cache -------------------------------------------------------------------------------------


def test_the_cache_against_a_loop() -> None:
    rng = np.random.default_rng(4)
    lines = np.concatenate([rng.integers(0, 60, 3000), rng.integers(0, 7, 500) + 13 * rng.integers(0, 3, 500)])
    tags: dict[int, int] = {}
    expected = []
    for line in lines.tolist():
        expected.append(tags.get(line % 13) == line)
        tags[line % 13] = line
    assert (cache.simulate(lines, 13) == expected).all() and 0 < sum(expected) < len(lines)
    assert cache.SET_COUNT == 1365 and len(cache.simulate(lines[:0])) == 0


def test_every_word_of_a_trace_is_read_where_it_lies(free: Device) -> None:
    """One order or another: the same reads of data; a record's line once it is there is found again."""
    trace = made("CC22", "C2")
    trace = Trace(trace.begin, np.array([4, 5, 7, 8, 5, 7]), trace.is_test, trace.reached, trace.pixels)
    begin = np.array([0, 0, 0, 0, 0, 1, 3])
    memory = cache.Memory(begin, 9, 2)
    with pytest.raises(IndexError):
        cache.Memory(begin[:5], 9, 2).of_words(trace)
    rates = cache.hit_rates(cache.branching_accesses(memory, trace))
    assert rates[TRIANGLES].reads == 3 * 6 and rates["grid cells"].reads == 3 and rates[STATE].rate is None
    passes = cache.hit_rates(cache.multipass_accesses(memory, trace, PURCELL, 1, 1))
    tiles = cache.hit_rates(cache.multipass_accesses(memory, trace, PURCELL, 1, 1, cache.tiles_of(trace, 2, 1)))
    for kind in KINDS[2:]:
        assert passes[kind].reads == tiles[kind].reads == rates[kind].reads
    assert [tile.tolist() for tile in cache.tiles_of(made(*"cccccc"), 3, 2)] == [[0, 1, 3, 4], [2, 5]]


# --- the equation ----------------------------------------------------------------------------------


def test_constants_are_found_again() -> None:
    """Times made by known constants; one that would be negative is 0."""
    rng = np.random.default_rng(2)
    true = Constants(30.0, 4.0, 1.5, 90000.0)
    points = []
    for k in range(9):
        steps, tests = rng.uniform(5, 50, size=2).tolist()
        point = Point(str(k), 10000, steps, tests, int(rng.integers(50, 900)), 1.0)
        points.append(Point(**{**vars(point), "ms": true.predict_ms(point)}))
    found = fit(points)
    assert np.allclose(list(vars(found).values()), list(vars(true).values()), rtol=1e-6)
    assert np.allclose(held_out(points), [point.ms for point in points], rtol=1e-6)
    late = [Point(**{**vars(point), "ms": point.ms - 0.4}) for point in points]
    assert fit(late).ray == 0.0 and min(vars(fit(late)).values()) >= 0.0


# --- the command -----------------------------------------------------------------------------------


def test_the_command_prints_draws_and_counts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One study, printed both ways."""
    studies: list[CostStudy] = []
    study_once = cost.study_cost

    def remembered(*values: object, **named: object) -> CostStudy:
        studies.extend([study_once(*values, **named)] if not studies else [])  # type: ignore[arg-type]
        return studies[0]

    monkeypatch.setattr(cost, "study_cost", remembered)
    source = Path(__file__).resolve().parents[1] / "data" / "cube.toml"
    plot, arguments = tmp_path / "cost.svg", [str(source), "--size", "24x24", "--repetitions", "1", "-q"]
    assert main(["cost", *arguments, "--json", "-o", str(plot)]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["rays"] == 576 and found["rows"][2]["oracle"] == "purcell:20" and found["tests_a_second"] > 0
    assert found["multipass"]["words"] > found["branching"]["words"] > 0
    assert "passes by oracle (Table 2)" in plot.read_text()
    assert main(["cost", *arguments]) == 0
    text = capsys.readouterr().out
    for part in ("Table 1", "Table 2", "Table 3", "Fig. 7", "Fig. 8", "Fig. 9", "C_stencil", "more rays"):
        assert part in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["x.ply", "--repetitions", "0"], "give a whole number from 1 to 1000"),
        (["x.ply", "--precision", "fixed"], "raycast-grid projects none"),
        (["x.ply", "-o", "x.gif"], "name a file .svg or .png"),
        (["x.ply", "--grid-resolution", "2000"], "from 1 to 1023"),
    ],
)
def test_wrong_usage(capsys: pytest.CaptureFixture[str], arguments: list[str], message: str) -> None:
    assert main(["cost", *arguments]) == 64
    assert re.search(message, capsys.readouterr().err)


def test_soup_of_other_resolutions_balances(free: Device) -> None:
    """Finer cells: more steps, fewer tests."""
    scene, view = make_scene(soup(3, 400)), oblique("perspective", 40, 30)
    found = []
    for resolution in (4, 12, 36):
        job, _ = start(free, scene, view, aov=("id",), method="raycast-grid", grid_resolution=resolution)
        trace = make_trace(*job.tiles.trace())
        found.append((trace.steps.sum(), trace.tests.sum()))
    assert found[0][0] < found[1][0] < found[2][0] and found[0][1] > found[1][1] > found[2][1]
