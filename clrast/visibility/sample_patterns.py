"""Where in a pixel samples lie, and what `--aa` asks for: the one table of sample patterns, for host and device.

Positions are integers, in 256ths of a pixel from its upper left corner: exact in float32 and in the integers of the
exact rung. The patterns:

standard : 2, 4, 8 or 16 samples, as Direct3D and Vulkan define their standard sample locations, on a grid of 1/16
sobol : any number of samples, the first points of Sobol's (0,2)-sequence in two dimensions (Sobol 1967). The first
    2^m points are a (0,m,2)-net: of every grid of 2^a x 2^(m-a) equal boxes each holds one. So the first S of S + C
    points are spread as well as all of them. Points are moved by half of the finest box, where 1/256 allows it, so that
    their mean is the pixel's centre.
scrambled : up to 256 samples, Sobol's first points with each digit of a coordinate flipped or not by what the digits
    before it are (Owen 1995), which keeps the nets. Samples that stop after 8, 16, 32 .. are to be a pattern by
    themselves: of 4,000 ways to flip it is the one whose points are then centred within 0.06 / N pixel and farthest
    apart. Sobol's own first N points lie 1/(2N) to the upper left.
mixed : S + C samples, the S standard ones (or sobol), then the sobol points of all S + C without those nearest to them
center : one sample, the pixel's centre; what `none` has
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

from clrast.errors import UsageError
from clrast.opencl.constants import MAX_SHARED_SAMPLES as MAX_SHARED
from clrast.opencl.constants import VISIT_SAMPLES

UNITS = 256
"""Positions a pixel's side has."""

Position = tuple[int, int]

CENTER: Position = (UNITS // 2, UNITS // 2)

# Offsets from the centre in 1/16 pixel, x to the right, y down.
_STANDARD: dict[int, tuple[Position, ...]] = {
    2: ((4, 4), (-4, -4)),
    4: ((-2, -6), (6, -2), (-6, 2), (2, 6)),
    8: ((1, -3), (-1, 3), (5, 1), (-3, -5), (-5, 5), (-7, -1), (3, 7), (7, -7)),
    16: (
        (1, 1), (-1, -3), (-3, 2), (4, -1), (-5, -2), (2, 5), (5, 3), (3, -5),
        (-2, 6), (0, -7), (-4, -6), (-6, 4), (-8, 0), (7, -4), (6, 7), (-7, -8),
    ),
}  # fmt: skip

FILTERS = ("box", "tent", "gaussian", "blackman-harris")
"""Names of reconstruction filters; what they are says shading/filters.py."""

SCRAMBLE = 3632
"""The way in which the pattern `scrambled` flips digits."""

MSAA_COUNTS = (2, 4, 8, 16, 32)
MAX_SAMPLES = 1024

_MODE = re.compile(r"(none)|(ssaa|msaa):([0-9]{1,9})|(csaa):([0-9]{1,9})\+([0-9]{1,9})|(auto):([0-9.eE+-]{1,30})")
_FORMS = "none, ssaa:N, msaa:N, csaa:S+C or auto:EPS"


@dataclass(frozen=True)
class Pattern:
    """Sample positions of a pixel, in the order in which they are summed. name : of the table above."""

    name: str
    positions: tuple[Position, ...]

    def __len__(self) -> int:
        return len(self.positions)


@dataclass(frozen=True)
class Antialiasing:
    """What `--aa` asks for. kind : none, ssaa, msaa, csaa or auto.

    pattern : all samples; the first `depth_count` of them have visibility of their own, the rest (csaa's C) store only
    whose they are. threshold : estimated error from which on a pixel is sampled further: auto's EPS, or that of msaa
    and csaa with shading rate auto, else 0. shades_all : whether each sample that has visibility of its own is shaded:
    ssaa, and msaa and csaa with shading rate sample.
    """

    kind: str
    pattern: Pattern
    depth_count: int
    threshold: float = 0.0
    shades_all: bool = False

    @property
    def lists_samples(self) -> bool:
        """Whether many samples of a pixel are decided at once where a method can (listed_samples.py)."""
        return not self.shades_all and (self.threshold > 0 or self.depth_count % VISIT_SAMPLES == 0)

    @property
    def name(self) -> str:
        """The mode as text, in one form."""
        if self.kind == "csaa":
            return f"csaa:{self.depth_count}+{len(self.pattern) - self.depth_count}"
        if self.kind == "auto":
            return f"auto:{self.threshold!r}"
        return self.kind if self.kind == "none" else f"{self.kind}:{len(self.pattern)}"


def _reversed_bits(k: int) -> int:
    """Van der Corput's radical inverse of k < 1024 in base 2, times 1024."""
    return int(f"{k:010b}"[::-1], 2)


def _sobol_second(k: int) -> int:
    """The second coordinate of Sobol's k-th point, times 1024: direction numbers of the polynomial x + 1."""
    direction, value = 512, 0
    while k:
        if k & 1:
            value ^= direction
        direction ^= direction >> 1
        k >>= 1
    return value


@cache
def sobol(count: int) -> Pattern:
    """The first `count` points of Sobol's sequence, 1 to MAX_SAMPLES, rounded down to 256ths."""
    box = 1 << (count - 1).bit_length()
    shift = UNITS // (2 * box)
    points = ((_reversed_bits(k) * UNITS // 1024, _sobol_second(k) * UNITS // 1024) for k in range(count))
    return Pattern("sobol", tuple((x + shift, y + shift) for x, y in points))


def hash_bits(x: Any) -> Any:
    """A number of 32 bits in which every bit depends on every bit of x, an integer or an array of uint32: as
    cl/random_numbers.clh has it."""
    x = (x ^ x >> 16) * 0x7FEB352D & 0xFFFFFFFF
    x = (x ^ x >> 15) * 0x846CA68B & 0xFFFFFFFF
    return x ^ x >> 16


def _flipped(value: int, seed: int) -> int:
    """A coordinate of 8 binary digits, each flipped or not by a hash of those before it."""
    found = 0
    for digits in range(8):
        before = value >> 8 - digits
        flip = hash_bits(seed * 0x9E3779B9 + (1 << digits | before) & 0xFFFFFFFF) & 1
        found = found << 1 | ((value >> 7 - digits & 1) ^ flip)
    return found


@cache
def scrambled(count: int, seed: int = SCRAMBLE) -> Pattern:
    """The first `count` points of Sobol's sequence, 1 to 256, their digits flipped."""
    points = ((_reversed_bits(k) // 4, _sobol_second(k) // 4) for k in range(count))
    return Pattern("scrambled", tuple((_flipped(x, 2 * seed), _flipped(y, 2 * seed + 1)) for x, y in points))


def pattern_of(count: int) -> Pattern:
    """The pattern of `count` samples: center, standard, or sobol where there is no standard one."""
    if count == 1:
        return Pattern("center", (CENTER,))
    if count in _STANDARD:
        step = UNITS // 16
        return Pattern("standard", tuple((CENTER[0] + x * step, CENTER[1] + y * step) for x, y in _STANDARD[count]))
    return sobol(count)


@cache
def mixed(depth_count: int, coverage_count: int) -> Pattern:
    """The pattern of csaa:S+C; the first `depth_count` samples are a pattern by themselves."""
    first = pattern_of(depth_count).positions
    rest = list(sobol(depth_count + coverage_count).positions)
    for x, y in first:
        rest.remove(min(rest, key=lambda p: (p[0] - x) ** 2 + (p[1] - y) ** 2))
    return Pattern("mixed", (*first, *rest))


def parse_antialiasing(option: str, text: Any) -> Antialiasing:
    """What the text asks for; raises UsageError where it is none of the forms or a count is out of range."""
    match = _MODE.fullmatch(text) if isinstance(text, str) else None
    if not match:
        raise UsageError(f"{option} {text!r} is unknown: use {_FORMS}")
    if match[1]:
        return Antialiasing("none", pattern_of(1), 1)
    if match[2] == "ssaa":
        count = _in_range(option, text, int(match[3]), MAX_SAMPLES)
        return Antialiasing("ssaa", pattern_of(count), count, shades_all=True)
    if match[2] == "msaa":
        count = int(match[3])
        if count not in MSAA_COUNTS:
            raise UsageError(f"{option} {text}: msaa takes {', '.join(map(str, MSAA_COUNTS))} samples")
        return Antialiasing("msaa", pattern_of(count), count)
    if match[4]:
        shaded, stored = int(match[5]), int(match[6])
        if shaded < 1 or stored < 1 or shaded + stored > MAX_SHARED:
            raise UsageError(f"{option} {text}: give S and C of at least 1, together at most {MAX_SHARED}")
        return Antialiasing("csaa", mixed(shaded, stored), shaded)
    return Antialiasing("auto", scrambled(MAX_AUTO), MAX_AUTO, _threshold(option, text, match[8]))


MAX_AUTO = 256
"""Most samples that `auto` gives a pixel."""

SHADING_RATES = ("pixel", "sample", "auto")
"""Of msaa and csaa: each surface of a pixel once, every sample, or the second where colours are estimated to be off by
more than SHADING_ERROR, or EPS (auto:EPS)."""

SHADING_ERROR = 0.05


def parse_shading_rate(option: str, text: Any) -> tuple[str, float]:
    """The rate as text, in one form, and the estimated error from which on auto shades all samples, else 0."""
    if not isinstance(text, str) or (text not in SHADING_RATES and not text.startswith("auto:")):
        raise UsageError(f"{option} {text!r} is unknown: use pixel, sample, auto or auto:EPS")
    if text in SHADING_RATES:
        return text, SHADING_ERROR if text == "auto" else 0.0
    value = _threshold(option, text, text.removeprefix("auto:"))
    return "auto" if value == SHADING_ERROR else f"auto:{value!r}", value


def with_rate(wanted: Antialiasing, rate: str) -> Antialiasing:
    """The mode with a shading rate, which msaa and csaa alone read."""
    if wanted.kind not in ("msaa", "csaa"):
        return wanted
    name, error = parse_shading_rate("--shading-rate", rate)
    return replace(wanted, threshold=error, shades_all=name == "sample")


def _in_range(option: str, text: str, count: int, most: int) -> int:
    if not 1 <= count <= most:
        raise UsageError(f"{option} {text}: give 1 to {most} samples")
    return count


def _threshold(option: str, text: str, written: str) -> float:
    try:
        value = float(written)
    except ValueError:
        value = 0.0
    if not 1e-6 <= value <= 1.0:
        raise UsageError(f"{option} {text}: give an error from 1e-6 to 1, such as auto:0.01")
    return value
