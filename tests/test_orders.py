"""What the order of loops costs: closed forms for lists and counts that can be worked out by hand."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clrast.__main__ import main
from clrast.study.orders import SIZES, last_reference, orders_of, study_orders


def test_last_references_of_a_few_lists() -> None:
    """Triangle 0 in one tile, 1 in neighbours, 2 in the first and the last of five, 3 again and again."""
    lists = [np.array(each, dtype=np.uint32) for each in ([0, 2], [1, 3], [1, 3], [3], [2, 3])]
    found = last_reference(lists)
    # distances: 0, 1, 4, 3 tiles -> bins 0, 1, 3, 2
    assert found.histogram == (1, 1, 1, 1) and (found.referenced, found.references) == (4, 9)
    assert found.live == 3  # 1, 2 and 3 in the second tile
    assert last_reference([np.zeros(0, dtype=np.uint32)]).references == 0


def test_bytes_of_the_orders() -> None:
    counts = {"triangles": 10, "pixels": 100, "hits": 60, "seen": 5, "references": 12, "lights": 3}
    counts |= {"covered": 90, "written": 70}
    orders = {order.name: order for order in orders_of(counts)}
    s = SIZES
    clear, depth = 100 * (s["nearness"] + s["color"]), 160 * s["nearness"]
    assert orders["sort-last, forward"].bytes == 10 * s["triangle"] + clear + depth + 70 * s["color"]
    pre_z = 20 * s["triangle"] + clear + depth + 90 * s["nearness"] + 60 * s["color"]
    assert orders["sort-last, pre-Z"].bytes == pre_z
    bins = 10 * (s["triangle"] + s["bound"]) + 20 * s["bound"] + 12 * (2 * s["reference"] + s["triangle"])
    assert orders["sort-middle, forward"].bytes == bins + 100 * s["color"]
    by_id = bins + 200 * s["id"] + 5 * s["triangle"] + 100 * s["color"]
    assert orders["sort-middle, deferred by id"].bytes == by_id
    assert {name: order.shadings for name, order in orders.items() if "forward" in name} == {
        "sort-last, forward": 70, "sort-middle, forward": 70,
    }  # fmt: skip
    assert orders["sort-last, a pass per light"].shadings == 180


def test_a_view_of_two_layers(device: Any) -> None:
    """A far wall, then a near one over it: every sample is covered twice and, far first, written twice."""
    from kernel_world import make_scene

    from clrast.options import make_options
    from clrast.scene.model import Camera

    wall = [(-9, 9), (9, 9), (9, -9), (-9, -9)]
    corners = np.array([(x, y, z) for z in (-2.0, -1.0) for x, y in wall])
    scene = make_scene(corners, [(0, 1, 2), (0, 2, 3), (4, 5, 6), (4, 6, 7)])
    camera = Camera("front", "perspective", (0, 0, 0), (0, 0, -1), (0, 1, 0), 60.0)
    study = study_orders(scene, camera, make_options({"size": (64, 48), "device": device.runtime}))
    pixels = 64 * 48
    assert study.counts | {"references": 0} == {
        "triangles": 4, "pixels": pixels, "hits": pixels, "seen": 2, "references": 0, "lights": 1,
        "setups": study.counts["setups"], "covered": 2 * pixels, "written": 2 * pixels,
    }  # fmt: skip
    rates = {rate.method: rate for rate in study.hit_rates}
    assert rates["3dr-brute"].writes == 1.0 and rates["3dr-brute"].nodes is None
    assert study.last_reference.referenced == 4


def test_the_command_prints_them(capsys: pytest.CaptureFixture[str]) -> None:
    source = str(Path(__file__).resolve().parents[1] / "data" / "triangle.toml")
    words = ["compare", source, "--orders", "--methods", "3dr-brute", "--size", "32x32", "--repetitions", "1", "-q"]
    assert main(words) == 0
    text = capsys.readouterr().out
    assert "sort-middle, deferred by id" in text and "last references, 1 triangles in" in text
    assert main([*words, "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["orders"]["orders"]) == 6
    assert main(["compare", "--suite", "paper", "--orders"]) == 64
    assert "--orders studies one scene" in capsys.readouterr().err
