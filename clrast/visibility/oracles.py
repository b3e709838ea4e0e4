"""The oracles of the continuum as named objects: what each decides, what it can be set to, where it comes from.

Davidovic et al., '3D Rasterization', section 4, Fig. 6 and 7. Their predicates are in cl/oracles.clh; the numbers
that the two share stand in opencl/constants.py. An oracle only says what is worth doing: whatever it answers, the
image is the same.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from clrast.errors import UsageError
from clrast.opencl import constants


@dataclass(frozen=True)
class Oracle:
    """One decision of the recursion.

    settings : name of a setting -> (its number in the kernel, what it means). The number's macro in the kernel is
    the oracle's upper-case name. parameter : what a `:NUMBER` after a setting means, with its default and range;
    None where there is none.
    """

    name: str
    meaning: str
    section: str
    settings: Mapping[str, tuple[int, str]]
    parameter: tuple[str, int, int, int] | None = None


def _oracle(name: str, meaning: str, section: str, settings: dict[str, tuple[int, str]],
            parameter: tuple[str, int, int, int] | None = None) -> Oracle:  # fmt: skip
    return Oracle(name, meaning, section, MappingProxyType(settings), parameter)


ORACLES: Mapping[str, Oracle] = MappingProxyType({
    oracle.name: oracle
    for oracle in (
        _oracle(
            "is_outside",
            "drop a node whose screen bound holds no sample of the frustum",
            "4, Fig. 6a",
            {
                "never": (constants.IS_OUTSIDE_NEVER, "every frustum meets every node"),
                "screen_bound": (constants.IS_OUTSIDE_SCREEN_BOUND, "the union of the node's canonical screen bounds"),
            },
        ),
        _oracle(
            "is_occluded",
            "drop a node that lies behind what every sample of the frustum shows already",
            "4, Fig. 6a; 5",
            {
                "never": (constants.IS_OCCLUDED_NEVER, "nothing is taken as hidden"),
                "w_buffer": (constants.IS_OCCLUDED_W_BUFFER, "hierarchical w-buffer against the node's greatest w"),
            },
        ),
        _oracle(
            "split_frustum",
            "go on with the four quarters of the frustum, down to 8 x 8 samples",
            "4, Fig. 6b, c; 5",
            {
                "never": (constants.SPLIT_FRUSTUM_NEVER, "frusta stay whole"),
                "center": (constants.SPLIT_FRUSTUM_CENTER, "where the centre's ray misses the node"),
                "small": (constants.SPLIT_FRUSTUM_SMALL, "where the node is small against the frustum"),
                "adaptive": (constants.SPLIT_FRUSTUM_ADAPTIVE, "where its centre misses the node or the node is small"),
                "always": (constants.SPLIT_FRUSTUM_ALWAYS, "at once, down to the smallest"),
            },
            ("areas of the node's bound that fit into a frustum for which it is small", 4, 1, 65536),
        ),
        _oracle(
            "generate_samples",
            "rasterize the node's triangles now, in place of visiting its children",
            "4, Fig. 6d",
            {
                "root": (constants.GENERATE_SAMPLES_ROOT, "at once, with all triangles: no acceleration structure"),
                "leaf": (constants.GENERATE_SAMPLES_LEAF, "at the leaves of the BVH"),
            },
        ),
        _oracle(
            "binning",
            "test blocks of samples against a triangle's edges and nearness before its samples",
            "4, 'Binning'; 5",
            {
                "never": (constants.BINNING_NEVER, "every sample of the triangle's bound in the frustum"),
                "blocks": (constants.BINNING_BLOCKS, "blocks of samples, and early w"),
            },
        ),
    )
})  # fmt: skip
"""Name -> oracle, in the order in which the recursion asks them."""

RAY_ORACLES: Mapping[str, Oracle] = MappingProxyType({
    oracle.name: oracle
    for oracle in (
        _oracle(
            "pass",
            "which rays the next pass is for: those that traverse, or those that intersect",
            "Purcell 3.2",
            {
                "naive": (0, "intersect as soon as any ray can, else traverse"),
                "delany": (1, "what more rays wait for"),
                "purcell": (2, "intersect once a share of the active rays can, else traverse"),
            },
            ("per cent of the active rays that make an intersection pass worth it", 20, 1, 100),
        ),
        _oracle(
            "unroll",
            "how often a pass runs its kernel's inner loop for each ray",
            "Purcell 4.2",
            {str(k): (k, f"{k} traversal {'step' if k == 1 else 'steps'}") for k in (1, 2, 4, 8)},
            ("intersection tests of an intersection pass, 0 for as many as traversal steps", 0, 0, 8),
        ),
        _oracle(
            "mailbox",
            "skip triangles that the ray was tested against in an earlier cell",
            "Purcell 3.1.3",
            {
                "never": (0, "test a triangle in every cell that holds it"),
                "boxes": (1, "each ray remembers some triangles, by prim_id modulo their number"),
            },
            ("triangles that a ray remembers", 16, 1, 64),
        ),
    )
})  # fmt: skip
"""Name -> oracle of rays through a grid: Purcell et al., 'Ray Tracing on Programmable Graphics Hardware'."""

FRUSTUM_SIDES = (4, 256)
"""Smallest and largest side of a root frustum, samples."""

_SETTING = re.compile(r"([a-z_0-9]+)(?::([0-9]{1,9}))?")


@dataclass(frozen=True)
class OracleChoice:
    """A setting of one oracle. `number` : its parameter, 0 where it has none."""

    setting: str
    number: int = 0


def parse_oracle(option: str, text: str) -> tuple[str, OracleChoice]:
    """`NAME=SETTING[:NUMBER]`, or `frustum=SIDE`, as the name and the choice; raises UsageError."""
    name, equals, value = (part.strip() for part in text.partition("="))
    names = (*ORACLES, "frustum", *RAY_ORACLES)
    if not equals:
        raise UsageError(f"{option} {text!r}: give NAME=VALUE, such as split_frustum=never")
    if name not in names:
        raise UsageError(f"{option} {name!r} is unknown: use {' or '.join(names)}{_hint(name, names)}")
    if name == "frustum":
        return name, OracleChoice("side", _side(option, value))
    oracle = ORACLES.get(name) or RAY_ORACLES[name]
    match = _SETTING.fullmatch(value)
    if not match or match[1] not in oracle.settings:
        raise UsageError(f"{option} {name}={value}: use {' or '.join(oracle.settings)}{_hint(value, oracle.settings)}")
    if oracle.parameter is None:
        if match[2] is not None:
            raise UsageError(f"{option} {name}={value}: {name} takes no number: leave out ':{match[2]}'")
        return name, OracleChoice(match[1])
    _, default, low, high = oracle.parameter
    number = default if match[2] is None else int(match[2])
    if not low <= number <= high:
        raise UsageError(f"{option} {name}={value}: the number is out of range: give {low} to {high}")
    return name, OracleChoice(match[1], number)


def _side(option: str, value: str) -> int:
    low, high = FRUSTUM_SIDES
    sides = [1 << k for k in range(low.bit_length() - 1, high.bit_length())]
    if not value.isascii() or not value.isdigit() or len(value) > 9 or int(value) not in sides:
        raise UsageError(f"{option} frustum={value}: give a power of two from {low} to {high}")
    return int(value)


def _hint(name: str, known: object) -> str:
    near = difflib.get_close_matches(name, list(known), n=1)  # type: ignore[call-overload]
    return f" (did you mean {near[0]}?)" if near else ""
