"""How far an image's linear colour is from a reference: mean squares, FLIP, and the worst pixel.

mse : mean over pixels and R, G, B of the squared difference; rmse its root
relative_mse : likewise of difference^2 / (reference^2 + RELATIVE_FLOOR): errors in the dark count as people see them
flip : mean of FLIP (Andersson et al. 2020) between the tone-mapped pictures; None without the package flip-evaluator
worst : the largest difference of a component, and the pixel (x, y) where it is
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from clrast.errors import UsageError
from clrast.image.flip import flip_error

RELATIVE_FLOOR = 0.01
"""Added to the square of the reference: without it black pixels would decide everything."""
METRICS = ("rmse", "mse", "relative-mse", "flip", "worst")
DEFAULT_METRIC = METRICS[0]


@dataclass(frozen=True)
class Errors:
    """The errors of one image. worst_pixel : (x, y) from the top left."""

    mse: float
    relative_mse: float
    flip: float | None
    worst: float
    worst_pixel: tuple[int, int]

    @property
    def rmse(self) -> float:
        return math.sqrt(self.mse)

    def value(self, metric: str) -> float:
        """The error by a name of METRICS; infinite where it could not be measured."""
        found = getattr(self, metric.replace("-", "_"))
        return math.inf if found is None else float(found)

    def as_dict(self) -> dict[str, Any]:
        named = {metric.replace("-", "_"): getattr(self, metric.replace("-", "_")) for metric in METRICS}
        return {**named, "worst_pixel": list(self.worst_pixel)}


def measure_errors(found: np.ndarray, reference: np.ndarray, with_flip: bool = True) -> Errors:
    """Errors of (H, W, 3) float32 linear colour against a reference of the same shape.

    Equal values differ by 0, infinite ones too; a component that is not finite on one side alone is infinitely wrong.
    """
    test, right = found.astype(np.float64), reference.astype(np.float64)
    with np.errstate(invalid="ignore"):
        differences = np.where(test == right, 0.0, np.abs(test - right))
    differences[np.isnan(differences)] = np.inf
    finite = np.where(np.isfinite(right), right, 0.0)
    squares = differences * differences
    per_pixel = differences.max(axis=-1)
    y, x = divmod(int(per_pixel.argmax()), per_pixel.shape[1])
    flip = flip_error(reference, found).mean if with_flip else None
    relative = squares / (finite * finite + RELATIVE_FLOOR)
    return Errors(float(squares.mean()), float(relative.mean()), flip, float(per_pixel[y, x]), (x, y))


def has_flip() -> bool:
    """Whether the package that measures FLIP is installed."""
    try:
        import flip_evaluator  # noqa: F401
    except ImportError:
        return False
    return True


def check_metric(metric: str) -> None:
    """Raises UsageError where the metric needs a package that is missing."""
    if metric == "flip" and not has_flip():
        raise UsageError("--metric flip needs flip-evaluator: install it with pip install flip-evaluator, or use rmse")
