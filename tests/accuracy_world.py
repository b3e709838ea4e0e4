"""Studies of accuracy with given times and errors, for the tests of what is made of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from clrast.options import RenderOptions
from clrast.study.accuracy import Accuracy, Reference, Row
from clrast.study.accuracy_errors import Errors
from clrast.study.accuracy_front import Point
from clrast.study.accuracy_knobs import DEFAULT, Setting, name_of

SIZE = (8, 4)
ROUNDS = 20


def point(name: str, error: float, *milliseconds: float, changes: int = 1) -> Point:
    """Its times in rounds 0, 1 ..; a single one stands for ROUNDS equal ones."""
    times = milliseconds * ROUNDS if len(milliseconds) == 1 else milliseconds
    return Point(name, error, dict(enumerate(times)), changes)


def row(changes: Mapping[str, Any], rmse: float, *milliseconds: float, knob: str = "antialiasing", **named: Any) -> Row:
    name = name_of(changes) or DEFAULT
    times = dict(enumerate(milliseconds * ROUNDS if len(milliseconds) == 1 else milliseconds))
    options = RenderOptions(size=SIZE, **changes)
    errors = Errors(rmse * rmse, 2 * rmse * rmse, named.pop("flip", 3 * rmse), 4 * rmse, (5, 2))
    setting = Setting(name, knob if changes else DEFAULT, changes, options)
    return Row(setting, named.pop("method", "3dr-binning"), times, errors, named.pop("wrong", 0))


def study(*rows: Row, **named: Any) -> Accuracy:
    color = np.zeros((SIZE[1], SIZE[0], 3), np.float32)
    reference = Reference(RenderOptions(size=SIZE, aa="ssaa:1024", precision="exact"), color, 1.5, False, 0.0001)
    made: dict[str, Any] = {
        "scene": "scene", "triangle_count": 12, "size": SIZE, "device": "a device", "projection": "perspective",
        "metric": "rmse", "budget_s": 60.0, "reference": reference, "rows": rows, **named,
    }  # fmt: skip
    return Accuracy(**made)


TABLE = study(
    row({}, 0.02, 40.0, wrong=3),
    row({"precision": "exact"}, 0.02, 44.0, knob="precision"),
    row({"aa": "msaa:4"}, 0.015, 100.0),
    row({"aa": "ssaa:4"}, 0.007, 250.0),
    row({"aa": "ssaa:16"}, 0.003, 900.0),
    row({"aa": "auto:0.01"}, 0.005, 3000.0),
    row({"precision": "exact", "aa": "ssaa:16"}, 0.003, 905.0, knob="combination"),
    left_out={"grid": "not available"},
)
FRONT = ("default", "aa msaa:4", "aa ssaa:4", "aa ssaa:16")
