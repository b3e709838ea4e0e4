"""Edge functions of a paraboloid by sums and in real arithmetic, for tests and tools/measure_increments.py.

`summed_values` makes the steps of cl/incremental_edges.clh with any kind of number: float32 gives the kernel's bits,
fractions what the steps come to where nothing is rounded. `exact_values` knows of no steps: n . d by the definition of
the projection, in fractions, or in float64, 2^29 times as fine as float32.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np

from clrast.opencl.constants import INCREMENT_CELL
from clrast.scene.camera import CameraVectors

Number = Callable[[Any], Any]
STEP = 4
"""Samples that a sum goes on by."""

fractions: Number = np.vectorize(Fraction, otypes=[object])


def _along(n: np.ndarray, vector: tuple[float, float, float], number: Number) -> Any:
    x, y, z = (number(component) for component in vector)
    return (n[..., 0] * x + n[..., 1] * y) + n[..., 2] * z


def radius_of(view: CameraVectors) -> float:
    """Of the disc, pixels."""
    return min(view.width, view.height) / 2


def summed_values(
    view: CameraVectors, n: np.ndarray, columns: np.ndarray, rows: np.ndarray,
    number: Number = np.float32, cell: int = INCREMENT_CELL,
) -> np.ndarray:  # fmt: skip
    """V of normals n (..., 3) float32 at the centres of pixels; columns, rows (...) integers: arrays that go together.

    number : makes numbers of arrays; all that follows is done with such. cell : samples a side of a square.
    """
    columns, rows = np.broadcast_arrays(columns, rows)
    n = number(n)
    a_part, b_part, c = (_along(n, v, number) for v in (view.tangent_x, view.tangent_y, view.direction))
    start_x = number((columns // cell * cell).astype(float) + (0.5 - view.width / 2))
    start_y = number((rows // cell * cell).astype(float) + (0.5 - view.height / 2))
    one, half, radius = number(1.0), number(0.5), number(radius_of(view))
    a, b, half_c, scale = start_x / radius, -start_y / radius, half * c, one / radius
    value = half_c + (a * (a_part - half_c * a) + b * (b_part - half_c * b))
    gx, gy, bend = (a_part - c * a) * scale, (c * b - b_part) * scale, c * scale * scale
    step, loss = number(float(STEP)), number(STEP * STEP / 2)
    for change, place in ((gy, rows), (gx, columns)):
        for k in range(1, cell // STEP):
            goes_on = place % cell >= STEP * k
            value = np.where(goes_on, value + (step * change - loss * bend), value)
            change = np.where(goes_on, change - step * bend, change)
        gx, gy = (change, gy) if place is columns else (gx, change)
    x, y = (number((place % STEP).astype(float)) for place in (columns, rows))
    half_bend = half * bend
    return value + (x * (gx - x * half_bend) + y * (gy - y * half_bend))


def exact_values(
    view: CameraVectors, n: np.ndarray, columns: np.ndarray, rows: np.ndarray, number: Number = fractions
) -> np.ndarray:
    """n . d at the centres of pixels by the definition of d; arguments as of `summed_values`."""
    n, radius = number(n), number(radius_of(view))
    a = number(columns + 0.5 - view.width / 2) / radius
    b = number(view.height / 2 - (rows + 0.5)) / radius
    height = (number(1.0) - a * a - b * b) / number(2.0)
    return sum(
        n[..., k] * (a * number(view.tangent_x[k]) + b * number(view.tangent_y[k]) + height * number(view.direction[k]))
        for k in range(3)
    )
