"""One channel of two images, compared pixel by pixel: the numbers that a verdict is made from."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from decimal import ROUND_CEILING, Decimal
from fnmatch import fnmatchcase

import numpy as np

from clrast.errors import UsageError

IDIFF_FAIL = 1e-6


@dataclass(frozen=True)
class Thresholds:
    """When a difference is a warning or a failure: idiff's options, and what idiff lacks.

    A float value fails if |a-b| > fail and |a-b| > failrelative * (|a|+|b|)/2; a pixel fails if a
    value of its part does; a part fails if more pixels do than `allowfailures` and `failpercent`
    (of its pixels) each allow, or more than `allowfailures` have a value beyond `hardfail`. The same
    for warnings; `warn` and `warnrelative` are those of fail where not given.
    A NaN on one side only fails, whatever is allowed; so does an Inf that is not matched by its like.

    id_fail : pixels that may differ in a uint32 channel
    fail_flip : largest mean FLIP error of the colour that passes; None: it is reported only
    rules : channel name, or pattern as `N.*`, -> threshold in place of fail and warn (pixels, for ids)
    allow_missing : compare what both have, where parts or channels are missing on one side
    header : a difference in the header is a failure
    """

    fail: float = IDIFF_FAIL
    failrelative: float = 0.0
    failpercent: float = 0.0
    hardfail: float = math.inf
    allowfailures: int = 0
    warn: float | None = None
    warnrelative: float | None = None
    warnpercent: float = 0.0
    hardwarn: float = math.inf
    id_fail: int = 0
    fail_flip: float | None = None
    rules: dict[str, float] = field(default_factory=dict)
    allow_missing: bool = False
    header: bool = False

    def __post_init__(self) -> None:
        for name in (
            "fail", "failrelative", "failpercent", "hardfail", "allowfailures", "warn", "warnrelative",
            "warnpercent", "hardwarn", "id_fail", "fail_flip",
        ):  # fmt: skip
            _check_threshold("--" + name.replace("_", "-"), getattr(self, name))
        for name, value in self.rules.items():
            _check_threshold(f"--rule {name}", value)

    def rule_for(self, channel: str) -> float | None:
        """The threshold that a rule sets for a channel: its own name goes before patterns."""
        if channel in self.rules:
            return self.rules[channel]
        found = {value for pattern, value in self.rules.items() if fnmatchcase(channel, pattern)}
        if len(found) > 1:
            raise UsageError(f"--rule: two patterns give {channel} different thresholds: name it in a rule of its own")
        return found.pop() if found else None


def _check_threshold(option: str, value: object) -> None:
    if value is None:
        return
    if not isinstance(value, (int, float, np.number)) or isinstance(value, bool) or not value >= 0:
        raise UsageError(f"{option} {value} is no threshold: give a number from 0")


@dataclass
class ChannelDiff:
    """What one channel's comparison found. Positions are x, y from the top left of the whole image.

    kind : "float" or "uint" (exact); threshold : the one that held, in pixels for uint
    differing : pixels that differ at all (NaN equals NaN, +Inf +Inf); failing, warning : over the thresholds
    nonfinite : pixels with a NaN or Inf on one side that the other side does not match
    max_error, mean_error, rms_error : of |reference - test|; the maximum is inf where nonfinite is not 0,
        the others are over the finite pairs; None for uint
    worst : position of the largest error (of the first nonfinite one; for uint, of the first difference)
    passes_at : the smallest threshold for this channel alone that lets it pass, rounded up; None: none does
    status : "pass", "warning" or "failure"
    """

    part: str
    channel: str
    kind: str
    threshold: float
    differing: int = 0
    failing: int = 0
    warning: int = 0
    nonfinite: int = 0
    max_error: float | None = None
    mean_error: float | None = None
    rms_error: float | None = None
    worst: tuple[int, int] | None = None
    reference_value: float | int | None = None
    test_value: float | int | None = None
    passes_at: float | None = 0
    status: str = "pass"

    @property
    def severity(self) -> tuple[float, ...]:
        """Larger is worse, over channels of every kind."""
        rank = {"pass": 0.0, "warning": 1.0, "failure": 2.0}[self.status]
        error = float(self.differing if self.kind == "uint" else self.max_error or 0.0)
        ratio = math.inf if error > 0 else 0.0
        if self.threshold > 0 and error < math.inf:
            ratio = error / self.threshold
        return (rank, float(self.nonfinite > 0), float(self.kind == "uint"), ratio, error)


@dataclass(frozen=True)
class PixelErrors:
    """One channel's errors, (H, W).

    error : float64 |reference - test|, inf where nonfinite, 0 where equal; 1 or 0 for uint
    relevant : float64, the error where the relative threshold does not excuse it, else 0
    fails, warns : bool
    """

    error: np.ndarray
    relevant: np.ndarray
    fails: np.ndarray
    warns: np.ndarray


class PartTotals:
    """What the float channels of a part add up to at each pixel, (H, W).

    fails, warns : bool, of any channel
    error : float64, largest of any channel; without_rule : of those that no rule has, `relevant` ones alone
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.fails = np.zeros(shape, bool)
        self.warns = np.zeros(shape, bool)
        self.error = np.zeros(shape)
        self.without_rule = np.zeros(shape)

    def add(self, channel: PixelErrors, ruled: bool) -> None:
        self.fails |= channel.fails
        self.warns |= channel.warns
        np.maximum(self.error, channel.error, out=self.error)
        if not ruled:
            np.maximum(self.without_rule, channel.relevant, out=self.without_rule)


def compare_floats(
    found: ChannelDiff, reference: np.ndarray, test: np.ndarray, limits: Thresholds, rule: float | None
) -> PixelErrors | None:
    """Fill `found` from two (H, W) float32 arrays; None where they are equal."""
    if np.array_equal(reference.view(np.uint32), test.view(np.uint32)):
        found.max_error = found.mean_error = found.rms_error = 0.0
        return None
    with np.errstate(invalid="ignore", over="ignore"):
        a, b = reference.astype(np.float64), test.astype(np.float64)
        same = (a == b) | (np.isnan(a) & np.isnan(b))
        finite = np.isfinite(a) & np.isfinite(b)
        error = np.where(same, 0.0, np.where(finite, np.abs(a - b), np.inf))
        mean_size = np.where(finite, (np.abs(a) + np.abs(b)) * 0.5, 0.0)
    wrong = np.isinf(error)
    warn = limits.fail if limits.warn is None else limits.warn
    warnrelative = limits.failrelative if limits.warnrelative is None else limits.warnrelative
    if rule is not None:
        warn = rule
    fails = (error > found.threshold) & (error > limits.failrelative * mean_size)
    warns = (error > warn) & (error > warnrelative * mean_size)
    found.differing = int(np.count_nonzero(error))
    found.nonfinite = int(np.count_nonzero(wrong))
    found.failing = int(np.count_nonzero(fails))
    found.warning = int(np.count_nonzero(warns))
    found.max_error = float(error.max())
    values = error[~wrong]
    found.mean_error = float(values.mean()) if values.size else 0.0
    found.rms_error = float(math.sqrt(np.square(values).mean())) if values.size else 0.0
    relevant = np.where(error > limits.failrelative * mean_size, error, 0.0)
    found.passes_at = None if found.nonfinite else rounded_up(float(relevant.max()))
    _locate(found, int(error.argmax()), reference, test)
    return PixelErrors(error, relevant, fails | wrong, warns)


def compare_ids(found: ChannelDiff, reference: np.ndarray, test: np.ndarray) -> PixelErrors | None:
    """Fill `found` from two (H, W) uint32 arrays, compared exactly; None where they are equal."""
    differs = reference != test
    found.differing = int(np.count_nonzero(differs))
    if not found.differing:
        return None
    found.failing = found.differing if found.differing > found.threshold else 0
    found.passes_at = found.differing
    _locate(found, int(differs.argmax()), reference, test)
    error = differs.astype(np.float64)
    return PixelErrors(error, error, differs, differs)


def _locate(found: ChannelDiff, index: int, reference: np.ndarray, test: np.ndarray) -> None:
    y, x = divmod(index, reference.shape[1])
    found.worst = (x, y)
    found.reference_value = reference[y, x].item()
    found.test_value = test[y, x].item()


def largest_but(errors: np.ndarray, allowed: int) -> float:
    """The threshold that all but `allowed` of the errors stay within: the next largest one."""
    flat = errors.reshape(-1)
    if allowed >= flat.size:
        return 0.0
    return float(np.partition(flat, flat.size - 1 - allowed)[flat.size - 1 - allowed])


def rounded_up(value: float) -> float:
    """`value` with six significant digits, never smaller than it is: a threshold to type."""
    if not math.isfinite(value) or value == 0.0:
        return value
    nearest = float(f"{value:.6g}")
    if nearest >= value:
        return nearest
    exact = Decimal(value)
    return float(exact.quantize(Decimal(1).scaleb(exact.adjusted() - 5), rounding=ROUND_CEILING))
