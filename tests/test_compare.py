"""Comparisons of methods: rounds and budget, ratios, the table, the plot."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from compare_world import BASE_INSTRUCTIONS, BRUTE_INSTRUCTIONS, TABLE, comparison, row

from clrast.commands.compare_table import operation_lines, table_lines
from clrast.errors import UsageError
from clrast.opencl.features import Edges
from clrast.options import AVAILABLE_METHODS
from clrast.study.compare import Counts, MethodRow, choose_methods, measure_methods
from clrast.study.compare_plot import draw, make_figure, number

REAL = tuple(name for name in AVAILABLE_METHODS if name != "auto")


# A stand-in for the renderer: frames take the milliseconds that they are told, on a clock of their own


@dataclass
class World:
    """Seconds on the clock, and which method rendered when."""

    seconds: float = 0.0
    log: list[str] = field(default_factory=list)

    def clock(self) -> float:
        return self.seconds


@dataclass
class FakeRun:
    world: World
    name: str
    frames: Callable[[int], float]  # number of the frame, the warm-up is 0 -> milliseconds
    edges: Edges = Edges.SPATIAL
    build_ms: float = 0.0
    work: Counts = Counts(10, 100)
    shown: tuple[int, ...] = (1, 2, 3)
    done: int = 0

    def frame(self) -> Mapping[str, float]:
        spent = self.frames(self.done)
        self.done += 1
        self.world.seconds += spent / 1000
        self.world.log.append(self.name)
        return {"setup": 0.25 * spent, "bin": 0.25 * spent, "visibility": 0.5 * spent}

    def counts(self) -> Counts:
        return self.work

    def prims(self) -> np.ndarray:
        return np.array([self.shown], np.uint32)


def measure(world: World, runs: Mapping[str, FakeRun], **named: Any) -> tuple[tuple[MethodRow, ...], dict[str, str]]:
    settings = {"repetitions": 5, "budget_s": 60.0, "clock": world.clock, **named}
    return measure_methods(tuple(runs), runs.__getitem__, **settings)


def fakes(world: World, **milliseconds: float) -> dict[str, FakeRun]:
    return {name: FakeRun(world, name, lambda k, ms=ms: ms) for name, ms in milliseconds.items()}


def test_methods_take_turns_after_one_warm_up_each() -> None:
    world = World()
    measure(world, fakes(world, a=1, b=1, c=1, d=1), repetitions=4)
    rounds = [world.log[k : k + 4] for k in range(0, len(world.log), 4)]
    assert len(rounds) == 5 and rounds[0] == ["a", "b", "c", "d"]
    assert all(sorted(each) == ["a", "b", "c", "d"] for each in rounds)
    assert len({tuple(each) for each in rounds[1:]}) > 1, "the order changes, so that nobody follows the same one"


def test_the_figure_is_the_median_without_the_warm_up() -> None:
    world = World()
    times = (1000.0, 3.0, 1.0, 2.0, 5.0, 4.0)
    rows, _ = measure(world, {"a": FakeRun(world, "a", lambda k: times[k], build_ms=7.0)})
    assert rows[0].frames_ms == times[1:]
    assert rows[0].median_ms == 3.0 and rows[0].build_ms == 7.0
    # Of 1 2 3 4 5 the 10th percentile lies 0.4 of the way from the first to the second.
    assert rows[0].percentile(10) == pytest.approx(1.4) and rows[0].percentile(90) == pytest.approx(4.6)
    assert rows[0].stages_ms == {"setup": 0.75, "bin": 0.75, "visibility": 1.5}
    assert not rows[0].cut and not rows[0].warm_up_only


def test_the_budget_cuts_slow_methods_alone() -> None:
    """Share of each of the three: 1 s of 3. Rounds take 0.6 s; after the fifth the budget is spent."""
    world = World()
    rows, _ = measure(world, fakes(world, fast=50, slow=500, middle=50), repetitions=9, budget_s=3.0)
    fast, slow, middle = rows
    assert len(fast.frames_ms) == len(middle.frames_ms) == 9 and not fast.cut
    assert len(slow.frames_ms) in (5, 6) and slow.cut and not slow.warm_up_only


def test_a_slow_method_renders_one_frame_at_least() -> None:
    world = World()
    rows, _ = measure(world, fakes(world, fast=1, slow=9000), repetitions=9, budget_s=10.0)
    assert len(rows[1].frames_ms) in (1, 2) and rows[1].cut and not rows[1].warm_up_only


def test_a_warm_up_beyond_the_budget_stands_for_all() -> None:
    world = World()
    rows, _ = measure(world, fakes(world, fast=1, slow=20_000), budget_s=10.0)
    assert rows[1].frames_ms == (20_000.0,) and rows[1].cut and rows[1].warm_up_only
    assert world.log.count("slow") == 1


def test_a_method_that_can_not_render_is_left_out_or_raises() -> None:
    world = World()
    runs = fakes(world, a=1, b=2)

    def prepare(name: str) -> FakeRun:
        if name == "a":
            raise UsageError("a lacks this: use b")
        return runs[name]

    named = {"repetitions": 1, "budget_s": 1.0}
    rows, skipped = measure_methods(("a", "b"), prepare, **named)
    assert [row.method for row in rows] == ["b"] and skipped == {"a": "a lacks this: use b"}
    with pytest.raises(UsageError, match="a lacks this"):
        measure_methods(("a", "b"), prepare, strict=True, **named)
    with pytest.raises(UsageError, match="no method can render this: a lacks this"):
        measure_methods(("a",), prepare, **named)


def test_pixels_are_counted_against_the_first_3d_edges() -> None:
    world = World()
    runs = fakes(world, a=1, b=1, c=1)
    runs["a"].edges, runs["a"].shown = Edges.PROJECTED, (1, 9, 9)
    runs["c"].shown = (1, 2, 9)
    rows, _ = measure(world, runs)
    assert [row.differing_pixels for row in rows] == [2, 0, 1]
    runs = {"a": runs["a"]}
    assert measure(world, runs)[0][0].differing_pixels is None


def test_choice_of_methods() -> None:
    assert choose_methods(None) == REAL
    assert choose_methods(["3dr-full", "2dr-brute", "3dr-full"]) == ("2dr-brute", "3dr-full")
    for names, message in ((["auto"], "a choice among the others"), (["3dr-ful"], "did you mean 3dr-full"), ([], "no")):
        with pytest.raises(UsageError, match=message):
            choose_methods(names)


# Ratios, the table, the plot


def test_ratios_to_the_baseline() -> None:
    assert [TABLE.time_ratio(each.method) for each in TABLE.rows] == [1.0, 0.5, 0.25, 25.0]
    assert TABLE.instruction_ratio("3dr-brute") == BRUTE_INSTRUCTIONS / BASE_INSTRUCTIONS
    assert TABLE.instruction_ratio("3dr-full") is None and TABLE.evaluation_ratio("3dr-brute") == 1.0
    assert TABLE.rows[1].setup_share == 5700 / BRUTE_INSTRUCTIONS and TABLE.rows[3].setup_share == 1.0
    assert TABLE.time_ratio("2dh-brute") is None and TABLE.time_ratio("3dr-full", "3dr-brute") == 0.5


def test_the_spread_tells_methods_apart() -> None:
    rows = (row("2dr-brute", 1.0, 2.0, 3.0), row("3dr-brute", 2.5, 3.5, 4.5), row("3dr-full", 9.0, 10.0, 11.0))
    near = comparison(*rows)
    assert near.fastest.method == "2dr-brute" and near.as_fast == ("3dr-brute",)
    assert near.is_clear("3dr-full") and not near.is_clear("3dr-brute") and not near.is_clear("raycast-bvh")
    assert near.is_noisy and not TABLE.is_noisy


def test_table_says_what_was_measured_and_what_was_not() -> None:
    lines = table_lines(TABLE)
    cells = {line.split()[0]: line.split() for line in lines if line.startswith(" ")}
    assert cells["2dr-brute"][1:] == ["8.00", "8.00-8.00", "1.00", "-", "100", "1,000", "21,300", "1.00", "34", "%"]
    assert cells["3dr-brute"][1:] == ["4.00", "4.00-4.00", "0.50", "-", "100", "1,000", "17,700", "0.83", "32", "%"]
    assert cells["3dr-full"][1:] == ["2.00", "2.00-2.00", "0.25", "3.2", "-", "-", "-", "-", "-"]
    assert cells["raycast-bvh*"][1] == "200.00"
    text = "\n".join(lines)
    assert "fastest: 3dr-full, 2.00 ms" in text and "* cut short by the budget of 60 s: raycast-bvh 1 frame" in text
    assert "nothing to be relative to" not in text and "another triangle" not in text
    assert "scene: 12 triangles, 64x32" in lines[0]


def test_table_without_the_baseline() -> None:
    alone = comparison(row("3dr-brute", 4.0, differing_pixels=0), row("3dr-full", 5.0, differing_pixels=3))
    text = "\n".join(table_lines(alone))
    assert "nothing to be relative to: 2dr-brute was not measured (it is not among the --methods)" in text
    assert "3dr-full shows another triangle at 3 of 2,048 pixels" in text and "3dr-brute shows" not in text
    skipped = replace(alone, skipped={"2dr-brute": "no 2D here", "2dh-brute": "none either"})
    text = "\n".join(table_lines(skipped))
    assert "was not measured (no 2D here)" in text and "2dh-brute left out: none either" in text


def test_lines_on_operations_name_the_numbers_taken() -> None:
    text = "\n".join(operation_lines([TABLE]))
    assert "2D 73 and 14; 3D 57 and 12" in text and "homogeneous 2D" not in text.splitlines()[0]
    assert "total of 72 for the setup of 2D, its lines sum to 73: taken is 73" in text


def test_json_holds_the_same_numbers() -> None:
    table = json.loads(json.dumps(TABLE.as_dict()))
    first, brute, full = table["methods"][:3]
    assert (first["ms"], brute["relative_time"], full["relative_time"]) == (8.0, 0.5, 0.25)
    assert brute["instructions"] == BRUTE_INSTRUCTIONS and full["instructions"] is None
    assert table["baseline"] == "2dr-brute" and table["fastest"] == "3dr-full"
    assert table["operations"]["edges"]["projected"]["paper"] == {"setup": 73, "pixel": 14}
    own = table["operations"]["edges"]["spatial"]["kernel"]
    assert brute["kernel_operations"] == 100 * own["setup"]["arithmetic"] + 1000 * own["pixel"]["arithmetic"]


def bars(figure: Any, graph: int) -> list[tuple[float, float]]:
    """(bottom, top) of the bars of a graph, in the order in which they were drawn."""
    return [(bar.get_y(), bar.get_y() + bar.get_height()) for bar in figure.axes[graph].patches]


def test_bars_are_the_ratios() -> None:
    """Times span 0.25 to 25: logarithmic from 0.1 on; instructions 0.13 to 1: linear, the dark part the setups'."""
    figure = make_figure([TABLE])
    times, instructions = figure.axes
    assert (times.get_yscale(), instructions.get_yscale()) == ("log", "linear")
    assert bars(figure, 0) == [(pytest.approx(0.1), pytest.approx(ratio)) for ratio in (1.0, 0.5, 0.25, 25.0)]
    ratios = [1.0, BRUTE_INSTRUCTIONS / BASE_INSTRUCTIONS, 50 * 57 / BASE_INSTRUCTIONS]
    shares = [7300 / BASE_INSTRUCTIONS, 5700 / BRUTE_INSTRUCTIONS, 1.0]
    tops = [top for _, top in bars(figure, 1)]
    assert tops[0::2] == pytest.approx(ratios)
    assert tops[1::2] == pytest.approx([r * s for r, s in zip(ratios, shares, strict=True)])
    assert [label.get_text() for label in instructions.get_xticklabels()] == [each.method for each in TABLE.rows]


def test_dark_part_is_the_share_of_the_length_on_a_logarithmic_scale() -> None:
    base = row("2dr-brute", 1.0, setups=0, evaluations=1000)
    whole = row("3dr-full", 1.0, setups=10, evaluations=0)
    (floor, top), (_, dark) = bars(make_figure([comparison(base, whole)]), 1)[2:4]
    assert top == pytest.approx(570 / 14000) and dark == pytest.approx(top)
    half = row("3dr-full", 1.0, setups=4, evaluations=19)  # 228 instructions for each
    (floor, top), (_, dark) = bars(make_figure([comparison(base, half)]), 1)[2:4]
    assert dark / floor == pytest.approx((top / floor) ** 0.5)


def test_several_scenes_stand_in_groups_with_a_legend() -> None:
    figure = make_figure([TABLE, replace(TABLE, scene="other", rows=TABLE.rows[:2])])
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [each.method for each in TABLE.rows]
    labels = [label.get_text() for label in figure.axes[1].get_xticklabels()]
    assert labels == ["scene\n(8 ms, 21.3k instructions)", "other\n(8 ms, 21.3k instructions)"]
    assert len(figure.axes[0].patches) == 4 + 2


def test_without_the_baseline_the_plot_is_absolute() -> None:
    figure = make_figure([comparison(*TABLE.rows[1:3])])
    assert figure.axes[0].get_ylabel() == "time, ms" and bars(figure, 0)[0] == (0.0, pytest.approx(4.0))


def test_files_of_a_plot() -> None:
    hostile = replace(TABLE, scene="$a_b^{$ & <c>")
    picture = draw([hostile], ".svg")
    assert picture == draw([hostile], ".svg"), "the same bars are the same bytes"
    texts = {"".join(element.itertext()).strip() for element in ElementTree.fromstring(picture).iter()}
    assert {"2dr-brute", "raycast-bvh"} <= texts and any(text.startswith(hostile.scene) for text in texts)
    assert draw([TABLE], ".png").startswith(b"\x89PNG\r\n")


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.844, "0.84"), (1.0, "1"), (27.31, "27"), (345.6, "346"), (21300, "21.3k"), (28.6e6, "28.6M"), (2e9, "2G")],
)
def test_short_numbers(value: float, text: str) -> None:
    assert number(value) == text
