"""The hard cases by name. data/hard/ holds a card of each, written from here by tools/make_data.py."""

from __future__ import annotations

import math
import struct
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from clrast.errors import ClrastError
from clrast.option_values import check_choice
from clrast.study import hard_edges, hard_places, hard_rims, hard_shapes
from clrast.study.hard_cards import card_text
from clrast.study.hard_case import HardCase

FAMILIES = (hard_edges, hard_rims, hard_shapes, hard_places)
RECIPES = {recipe.name: recipe for family in FAMILIES for recipe in family.FAMILY.recipes}


@dataclass(frozen=True)
class Refusal:
    """Input that must be refused. files : name -> content; the first one is the card."""

    name: str
    hard: str
    files: Mapping[str, bytes]

    def exit_code(self) -> int | None:
        """That of the error with which loading the card ends, None where it is taken."""
        from clrast.scene.load import load

        with tempfile.TemporaryDirectory(prefix="clrast-stress-") as folder:
            for name, content in self.files.items():
                path = Path(folder) / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)
            try:
                load(Path(folder) / next(iter(self.files)))
            except ClrastError as fault:
                return fault.exit_code
        return None


def _refused_head(name: str, hard: str) -> str:
    return f'# {hard}\n# Expected: refused with exit code 65.\nname = "{name}"\n\n[[mesh]]\n'


def _refusal(name: str, hard: str, value: float) -> Refusal:
    """A card whose mesh is a PLY file with one vertex that no number is."""
    vertices = struct.pack("<9f", 0, 0, 0, 1, 0, value, 0, 1, 0)
    header = (
        "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uchar uint vertex_indices\nend_header\n"
    )
    card = _refused_head(name, hard) + f'file = "meshes/{name}.ply"\n'
    mesh = header.encode("ascii") + vertices + struct.pack("<B3I", 3, 0, 1, 2)
    return Refusal(name, hard, {f"{name}.toml": card.encode("ascii"), f"meshes/{name}.ply": mesh})


def _literal(name: str, hard: str, text: str) -> Refusal:
    vertices = f"[[0.0, 0.0, 0.0], [1.0, 0.0, {text}], [0.0, 1.0, 0.0]]"
    card = _refused_head(name, hard) + f"vertices = {vertices}\ntriangles = [[0, 1, 2]]\n"
    return Refusal(name, hard, {f"{name}.toml": card.encode("ascii")})


REFUSALS: Mapping[str, Refusal] = {
    each.name: each
    for each in (
        _refusal("nan", "A vertex that a face uses is NaN: no answer would be right.", math.nan),
        _refusal("infinite", "A vertex that a face uses is +Inf: its edges have no direction.", math.inf),
        _refusal("minus-infinite", "A vertex that a face uses is -Inf: its edges have no direction.", -math.inf),
        _literal("nan-in-card", "A card writes nan for a coordinate.", "nan"),
        _literal("overflow", "A coordinate is finite in float64 and not in float32.", "1e39"),
    )
}

CASE_NAMES = tuple(RECIPES)
ENTRY_NAMES = (*CASE_NAMES, *REFUSALS)


@cache
def make_case(name: str) -> HardCase:
    """The case of that name; built once."""
    return RECIPES[name].make()


def choose_cases(names: Sequence[str]) -> tuple[str, ...]:
    """Names of cases and refusals in the order of the registry, each once; UsageError for one that there is not."""
    wanted = {check_choice("--case", name, ENTRY_NAMES) for name in names}
    return tuple(name for name in ENTRY_NAMES if name in wanted)


def card_files() -> dict[str, bytes]:
    """Every file of data/hard/, by its path below it."""
    files = {f"{name}.toml": card_text(make_case(name)).encode("ascii") for name in CASE_NAMES}
    for refusal in REFUSALS.values():
        files |= refusal.files
    return files
