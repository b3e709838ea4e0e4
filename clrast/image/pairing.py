"""Which channel of one image is compared with which of the other, and what has no counterpart."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from clrast.image.frame import Part
from clrast.image.read import HEADER_PREFIX


@dataclass(frozen=True)
class Pair:
    """A channel that both images have: `key` is its full name, with its part where the name alone is not unique."""

    key: str
    name: str
    reference: Part
    test: Part


@dataclass
class Pairing:
    """Channels to compare, and sentences on the rest.

    missing : parts and channels that one side lacks, or has in another part or order
    unequal : sizes and types that make channels incomparable
    header : differences of the header, one sentence each
    stored : types in the two files -> channels that have them; notes : what decides nothing
    """

    pairs: list[Pair] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    unequal: list[str] = field(default_factory=list)
    header: list[str] = field(default_factory=list)
    stored: dict[tuple[str, str], list[str]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def pair_up(reference: Sequence[Part], test: Sequence[Part], names: tuple[str, str], from_files: bool) -> Pairing:
    """Match the channels of two images by their full names, in the order of the reference.

    names : what the two are called in sentences; from_files : both are, so that whole headers compare
    """
    result = Pairing()
    left, right = _keyed(reference), _keyed(test)
    for key, (part, name) in left.items():
        if key in right:
            _match(result, Pair(key, name, part, right[key][0]), names)
    for (one, other), keys in result.stored.items():
        result.notes.append(f"stored as {one} in {names[0]}, as {other} in {names[1]}: {' '.join(keys)}")
    result.missing += _absent(reference, left, right, names[1])
    result.missing += _absent(test, right, left, names[0])
    if not result.missing and (unlike := _parts_unlike(reference, test, names)):
        result.missing.append(unlike)
    result.header = _header_changes(reference, test, from_files)
    return result


def _keyed(parts: Sequence[Part]) -> dict[str, tuple[Part, str]]:
    counts = Counter(name for part in parts for name in part.channels)
    keyed: dict[str, tuple[Part, str]] = {}
    for index, part in enumerate(parts):
        for name in part.channels:
            key = name if counts[name] == 1 else f"{part.name or index}/{name}"
            keyed[key if key not in keyed else f"{index}/{name}"] = (part, name)
    return keyed


def _match(result: Pairing, pair: Pair, names: tuple[str, str]) -> None:
    """Add the pair, or the sentence on why its channels cannot be compared."""
    one, other = pair.reference, pair.test
    sentence = ""
    for what, a, b in (("pixels", one.window, other.window), ("the whole image", one.display, other.display)):
        if a != b and not sentence:
            sentence = f"{what}: {_sized(a, b)} in {names[0]}, {_sized(b, a)} in {names[1]}"
    types = one.pixel_types.get(pair.name, "float"), other.pixel_types.get(pair.name, "float")
    if not sentence and (types[0] == "uint") != (types[1] == "uint"):
        sentence = f"{pair.key} is {types[0]} in {names[0]}, {types[1]} in {names[1]}"
    if not sentence:
        result.pairs.append(pair)
        if types[0] != types[1]:
            result.stored.setdefault(types, []).append(pair.key)
    elif sentence not in result.unequal:
        result.unequal.append(sentence)


def _sized(window: tuple[int, ...], other: tuple[int, ...]) -> str:
    """`640x480`, with the place of the corner where it is what differs."""
    place = f" at {window[0]},{window[1]}" if window[:2] != other[:2] else ""
    return f"{window[2]}x{window[3]}{place}"


def _absent(parts: Sequence[Part], keyed: dict[str, Any], others: dict[str, Any], name: str) -> list[str]:
    """Sentences on the channels of `keyed` that `others` lacks, a whole part in one."""
    sentences = []
    for index, part in enumerate(parts):
        lost = [key for key, (home, _) in keyed.items() if home is part and key not in others]
        if not lost:
            continue
        whole = len(lost) == len(part.channels)
        what = f"part {part.name or index} ({' '.join(lost)})" if whole else f"{' '.join(lost)}"
        sentences.append(f"{what} {'is' if whole or len(lost) == 1 else 'are'} missing in {name}")
    return sentences


def _parts_unlike(reference: Sequence[Part], test: Sequence[Part], names: tuple[str, str]) -> str:
    """A sentence where the same channels lie in other parts, or parts in another order; parts may be nameless."""
    left = [(part.name, sorted(part.channels)) for part in reference]
    right = [(part.name, sorted(part.channels)) for part in test]
    same = [a[1] == b[1] and (a[0] == b[0] or not a[0] or not b[0]) for a, b in zip(left, right)]
    if len(left) == len(right) and all(same):
        return ""
    return f"parts are {_listed(left)} in {names[0]}, {_listed(right)} in {names[1]}"


def _listed(parts: list[tuple[str, list[str]]]) -> str:
    return ", ".join(f"{name or index} ({' '.join(channels)})" for index, (name, channels) in enumerate(parts))


def _header_changes(reference: Sequence[Part], test: Sequence[Part], from_files: bool) -> list[str]:
    """One sentence per attribute that differs. A frame in memory has only what clrast would write."""
    changes = []
    for index, (one, other) in enumerate(zip(reference, test)):
        for key in sorted(one.header.keys() | other.header.keys()):
            if not from_files and not key.startswith(HEADER_PREFIX):
                continue
            a, b = _text(one.header.get(key)), _text(other.header.get(key))
            if a != b:
                place = f"{one.name or index}: " if index else ""
                changes.append(f"header {place}{key.removeprefix(HEADER_PREFIX)}: {a or 'nothing'} | {b or 'nothing'}")
    return changes


def _text(value: Any) -> str:
    members = value if isinstance(value, tuple) else (value,)
    return " ".join("" if member is None else str(member) for member in members)
