"""Values of options, read from the object or from the text that the command line takes, and checked: one at a time.

What makes no sense is a UsageError that names the option, the value and what is allowed. A name that the design has and
this version has not is an UnavailableError: it says so, and what to use instead. Tests: tests/test_options.py.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Sequence
from typing import Any

from clrast.errors import UsageError

MAX_SIDE = 65535
MAX_PIXELS = 1 << 28
"""Largest image: 16384 x 16384 pixels or as many in another shape."""
MAX_FLOAT32 = 3.4028234663852886e38

Vector = tuple[float, float, float]

_INTEGER = re.compile(r"[+-]?[0-9]{1,30}")
_NUMBER = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")
_SIZE = re.compile(r"([0-9]{1,30})[xX]([0-9]{1,30})")
_MEMORY = re.compile(r"([0-9]{1,18}(?:\.[0-9]{0,18})?)\s*([A-Za-z]*)")
_MEMORY_UNITS = {"": 1, "b": 1}
for _power, _letter in enumerate("kmgt", start=1):
    _MEMORY_UNITS[_letter] = _MEMORY_UNITS[_letter + "ib"] = 1024**_power
    _MEMORY_UNITS[_letter + "b"] = 1000**_power


class UnavailableError(UsageError):
    """An option or a name of the design that this version does not have yet."""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """` (did you mean X?)` for the nearest of the known names, or nothing."""
    names = list(known)
    begun = [each for each in names if len(name) > 1 and each.startswith(name.lower())]
    near = begun or difflib.get_close_matches(name.lower(), names, n=1, cutoff=0.6)
    return f" (did you mean {near[0]}?)" if near else ""


def listed(names: Sequence[str]) -> str:
    """Names as `a, b or c`."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} or {names[-1]}"


def check_choice(option: str, value: Any, names: Sequence[str], available: Sequence[str] | None = None) -> str:
    """The value, if it is one of `names` and of those `available`; `option` is named in the error."""
    can = tuple(names if available is None else available)
    if not isinstance(value, str) or value not in names:
        raise UsageError(f"{option} {value!r} is unknown: use {listed(can)}{did_you_mean(str(value), names)}")
    if value not in can:
        raise UnavailableError(f"{option} {value} is not available in this version; use {listed(can)}")
    return value


def parse_texts(option: str, value: Any) -> list[str]:
    """The members of a comma list or of a sequence (whose members may be comma lists), trimmed."""
    if not isinstance(value, (str, list, tuple, set, frozenset)):
        raise UsageError(f"{option} {value!r} is no text and no list of texts")
    members = [value] if isinstance(value, str) else list(value)
    return [part.strip() for member in members for part in str(member).split(",")]


def parse_count(option: str, value: Any, low: int, high: int) -> int:
    """A whole number from `low` to `high`, from a number or its text."""
    allowed = f"a whole number from {low} to {high}"
    if isinstance(value, str):
        if not _INTEGER.fullmatch(value):
            raise UsageError(f"{option} {value!r} is not a number: give {allowed}")
        value = int(value)
    try:
        number = value.__index__()
    except (AttributeError, TypeError):
        raise UsageError(f"{option} {value!r} is not a whole number: give {allowed}") from None
    if not low <= number <= high:
        raise UsageError(f"{option} {number} is out of range: give {allowed}")
    return int(number)


def parse_number(option: str, value: Any, allowed: str = "a finite number", *, above: float = -math.inf) -> float:
    """A finite number that float32 can hold, larger than `above`, from a number or its text."""
    if isinstance(value, str) and not _NUMBER.fullmatch(value):
        raise UsageError(f"{option} {value!r} is not a number: give {allowed}")
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise UsageError(f"{option} {value!r} is not a number: give {allowed}") from None
    if not (math.isfinite(number) and abs(number) <= MAX_FLOAT32 and number > above):
        raise UsageError(f"{option} {value} is out of range: give {allowed}")
    return number


def parse_vector(option: str, value: Any) -> Vector:
    """Three finite numbers, from `X,Y,Z` or a sequence; any may be negative."""
    parts = value.split(",") if isinstance(value, str) else value
    try:
        parts = [part.strip() if isinstance(part, str) else part for part in parts]
    except TypeError:
        parts = []
    if len(parts) != 3:
        raise UsageError(f"{option} {value!r} is not a vector: give three numbers as X,Y,Z")
    x, y, z = (parse_number(option, part, "three finite numbers as X,Y,Z") for part in parts)
    return (x, y, z)


def parse_fov(option: str, value: Any, projection: Any = None) -> float:
    """A vertical angle in degrees, inside (0, 180); of a fisheye, whose whole disc it is, inside (0, 360]."""
    if projection == "fisheye":
        degrees = parse_number(option, value, "an angle up to 360 degrees", above=0.0)
        if degrees > 360.0:
            raise UsageError(f"{option} {value} is out of range: give an angle up to 360 degrees")
        return degrees
    allowed = "an angle between 0 and 180 degrees"
    degrees = parse_number(option, value, allowed, above=0.0)
    if degrees >= 180.0:
        raise UsageError(f"{option} {value} is out of range: give {allowed}")
    return degrees


def parse_size(option: str, value: Any) -> tuple[int, int]:
    """(width, height) in pixels, from `WxH` or a pair, within MAX_SIDE and MAX_PIXELS."""
    parts = value
    if isinstance(value, str):
        match = _SIZE.fullmatch(value)
        parts = match.groups() if match else ()
    if not isinstance(parts, Sequence) or len(parts) != 2:
        raise UsageError(f"{option} {value!r} is not a size: give WxH in pixels, such as 640x480")
    width, height = (parse_count(option, part, 1, MAX_SIDE) for part in parts)
    if width * height > MAX_PIXELS:
        raise UsageError(f"{option} {width}x{height} has {width * height} pixels: at most {MAX_PIXELS} are allowed")
    return (width, height)


def parse_memory(option: str, value: Any) -> int:
    """Bytes, from a number or text with a suffix: K M G T and KiB.. are powers of 1024, KB.. of 1000."""
    if isinstance(value, str):
        match = _MEMORY.fullmatch(value.strip())
        unit = _MEMORY_UNITS.get(match.group(2).lower()) if match else None
        if match is None or unit is None:
            raise UsageError(f"{option} {value!r} is not a size of memory: give bytes, or such as 512M, 2G, 1.5GiB")
        value = int(float(match.group(1)) * unit) if "." in match.group(1) else int(match.group(1)) * unit
    return parse_count(option, value, 1, 1 << 50)
