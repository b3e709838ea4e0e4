"""Pictures of wrong samples: the image that a method made, a map of its wrong samples by kind, and the card for it."""

from __future__ import annotations

import os
import re
from dataclasses import replace

import numpy as np

from clrast.image.files import write_text
from clrast.image.frame import Frame
from clrast.image.png import picture, write_pixels
from clrast.study.hard_cards import card_text
from clrast.study.stress import Finding, Stress
from clrast.study.wrong_samples import KINDS

COLORS = {
    "hole": (255, 255, 255), "double hit": (255, 60, 255), "wrong neighbour": (255, 200, 40), "vertex": (255, 130, 0),
    "unexplained": (255, 30, 30), "other": (60, 170, 255), "Z": (60, 220, 120),
}  # fmt: skip
"""Kind of a wrong sample -> red, green, blue in its map, where right samples are dark."""
DIM = 5
"""Right samples are shown at this part of their brightness."""


def wrong_findings(stress: Stress) -> list[Finding]:
    """The images with wrong samples, those of a wrong depth alone among them."""
    return [finding for finding in stress.findings if finding.kinds.any()]


def id_picture(finding: Finding) -> np.ndarray:
    """(height, width, 3) uint8: a colour for each triangle, black where nothing is hit."""
    return picture(Frame({"id.prim": finding.prim_id}))


def wrong_map(finding: Finding) -> np.ndarray:
    """(height, width, 3) uint8: wrong samples in the colours of their kinds over a dark picture."""
    shown = id_picture(finding) // DIM
    for k, kind in enumerate(KINDS):
        shown[finding.kinds == k + 1] = COLORS[kind]
    return shown


def reproducing_card(finding: Finding, stress: Stress) -> str:
    """A card with the one view, rung and method of an image: `clrast render` makes it again."""
    case = next(each for each in stress.cases if each.name == finding.case)
    only = replace(case, cameras=(finding.view.camera,), size=finding.view.size)
    options = {"precision": finding.precision, "method": finding.methods[0], "aov": "id,depth"}
    return card_text(only, options)


def stem(finding: Finding) -> str:
    """What the files of an image are called, without a suffix; no two images of a run have the same."""
    text = f"{finding.case}-{finding.view.name}-{finding.precision}-{finding.methods[0]}"
    return re.sub(r"[^A-Za-z0-9.-]+", "-", text)


def write_failures(folder: str, stress: Stress) -> None:
    """Three files for each image with wrong samples; OutputError where one cannot be written."""
    for finding in wrong_findings(stress):
        path = os.path.join(folder, stem(finding))
        write_pixels(f"{path}.png", id_picture(finding))
        write_pixels(f"{path}-wrong.png", wrong_map(finding))
        write_text(f"{path}.toml", reproducing_card(finding, stress))
