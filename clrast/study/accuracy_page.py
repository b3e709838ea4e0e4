"""The study of accuracy as one HTML page that asks for no other file and no network.

The plot is SVG in the page: a click on a point shows its image beside the reference, with a slider between the two, a
zoom, and their difference. Pictures are tone-mapped PNGs of 8 bits inside the page, at the pixels of the image: making
them smaller would smooth the very errors that they show. So what is too large is cut to the window in which the default
setting is most wrong. accuracy_page.html is the template, with the script.
"""

from __future__ import annotations

import base64
import html
import json
import math
import os
import re
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from clrast.image.png import write_pixels
from clrast.image.tone import srgb_bytes, tone_map
from clrast.study.accuracy import TIME_OF_FRAME, Accuracy
from clrast.study.accuracy_chart import chart
from clrast.study.accuracy_knobs import DEFAULT

TEMPLATE = Path(__file__).with_name("accuracy_page.html")
MOST_BYTES = 5_000_000
"""Of all pictures of a page; base64 makes a third more of them."""
MOST_SIDE = 1024
LEAST_SIDE = 64
REFERENCE = "reference"


class Pictures:
    """Images of the settings and of the reference as 8-bit pictures, cut to one window.

    side : the largest of the window, pixels; None takes what MOST_BYTES hold. window : x, y, width, height, from the
    first image, which is the default's.
    """

    def __init__(self, side: int | None = None) -> None:
        self.side = side
        self.window: tuple[int, int, int, int] | None = None
        self.of: dict[str, np.ndarray] = {}

    def add(self, name: str, color: np.ndarray, reference: np.ndarray) -> None:
        """Keep the picture of (H, W, 3) float32 linear colour."""
        if self.window is None:
            self.window = worst_window(color, reference, self.side or MOST_SIDE)
            self.of[REFERENCE] = self._cut(reference)
        self.of[name] = self._cut(color)

    def _cut(self, color: np.ndarray) -> np.ndarray:
        assert self.window is not None
        x, y, width, height = self.window
        return srgb_bytes(tone_map(np.ascontiguousarray(color[y : y + height, x : x + width])))

    def encoded(self) -> tuple[dict[str, bytes], tuple[int, int, int, int]]:
        """PNG files by name, and their window; smaller than asked only where no side was given."""
        assert self.window is not None
        x, y, width, height = self.window
        while True:
            files = _encode(self._moved(x, y, width, height))
            total = sum(len(content) for content in set(files.values()))
            if self.side is not None or total <= MOST_BYTES or min(width, height) <= LEAST_SIDE:
                return files, (x, y, width, height)
            factor = 0.97 * math.sqrt(MOST_BYTES / total)
            smaller = max(LEAST_SIDE, int(width * factor)), max(LEAST_SIDE, int(height * factor))
            dx, dy = self._worst_part(*smaller)
            x, y, width, height = self.window[0] + dx, self.window[1] + dy, *smaller

    def _moved(self, x: int, y: int, width: int, height: int) -> dict[str, np.ndarray]:
        assert self.window is not None
        left, top = x - self.window[0], y - self.window[1]
        return {name: image[top : top + height, left : left + width] for name, image in self.of.items()}

    def _worst_part(self, width: int, height: int) -> tuple[int, int]:
        """Upper left corner, inside the window, of the part in which the default differs most."""
        differences = np.abs(self.of[DEFAULT].astype(np.float64) - self.of[REFERENCE]).sum(axis=-1)
        return _densest(differences, width, height)


def worst_window(color: np.ndarray, reference: np.ndarray, side: int) -> tuple[int, int, int, int]:
    """x, y, width, height of the window of at most `side` pixels that holds most of the squared error."""
    height, width = reference.shape[:2]
    w, h = min(side, width), min(side, height)
    with np.errstate(invalid="ignore", over="ignore"):
        errors = ((color.astype(np.float64) - reference) ** 2).sum(axis=-1)
    errors[~np.isfinite(errors)] = 0.0
    x, y = _densest(errors, w, h)
    return x, y, w, h


def _densest(values: np.ndarray, width: int, height: int) -> tuple[int, int]:
    """x, y of the window with the largest sum, by a table of sums; the first of equal ones."""
    sums = np.zeros((values.shape[0] + 1, values.shape[1] + 1))
    sums[1:, 1:] = values.cumsum(axis=0).cumsum(axis=1)
    inside = sums[height:, width:] - sums[:-height, width:] - sums[height:, :-width] + sums[:-height, :-width]
    y, x = divmod(int(inside.argmax()), inside.shape[1])
    return x, y


def _encode(pictures: Mapping[str, np.ndarray]) -> dict[str, bytes]:
    """(H, W, 3) uint8 as PNG files; equal pictures are encoded once."""
    known: dict[bytes, bytes] = {}
    files: dict[str, bytes] = {}
    with tempfile.TemporaryDirectory(prefix="clrast-accuracy-") as folder:
        path = os.path.join(folder, "x.png")
        for name, pixels in pictures.items():
            content = pixels.tobytes()
            if content not in known:
                write_pixels(path, np.ascontiguousarray(pixels))
                known[content] = Path(path).read_bytes()
            files[name] = known[content]
    return files


def page(study: Accuracy, pictures: Pictures, commands: Mapping[str, str]) -> str:
    """The page. commands : setting -> the command that renders it."""
    files, window = pictures.encoded()
    distinct = list(dict.fromkeys(files.values()))
    data: dict[str, Any] = {
        "metric": study.metric,
        "front": [row.name for row in study.front],
        "settings": [
            {
                "name": row.name, "ms": row.median_ms, "low": row.percentile(10), "high": row.percentile(90),
                "relative": study.relative(row), "errors": row.errors.as_dict(), "wrong": row.wrong_samples,
                "picture": distinct.index(files[row.name]), "command": commands[row.name],
            }
            for row in study.rows
        ],
        "reference": distinct.index(files[REFERENCE]),
        "pictures": ["data:image/png;base64," + base64.b64encode(each).decode("ascii") for each in distinct],
        "window": list(window),
    }  # fmt: skip
    return _fill(TEMPLATE.read_text("utf-8"), {
        "TITLE": html.escape(f"clrast accuracy: {study.scene}"),
        "SUMMARY": _summary(study, window),
        "CHART": chart(study),
        # No text of a scene ends the script: JSON allows the sign to be written otherwise.
        "DATA": json.dumps(_finite(data)).replace("<", "\\u003c"),
    })  # fmt: skip


def _fill(template: str, parts: Mapping[str, str]) -> str:
    """The template with each @NAME@ replaced, in one pass: what is put in is not searched again."""
    return re.sub(r"@([A-Z]+)@", lambda found: parts[found[1]], template)


def _finite(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: _finite(member) for key, member in value.items()}
    return [_finite(member) for member in value] if isinstance(value, list) else value


def _summary(study: Accuracy, window: tuple[int, int, int, int]) -> str:
    width, height = study.size
    options = study.reference.options
    cut = ""
    if window[2:] != (width, height):
        cut = (
            f" Pictures show the {window[2]} x {window[3]} pixels from ({window[0]}, {window[1]}) on, where the "
            "default is most wrong."
        )
    return html.escape(
        f"{study.scene}: {study.triangle_count:,} triangles at {width} x {height} on {study.device}. Errors are those "
        f"of linear colour against {options.aa}, precision {options.precision}; times are medians of a frame: "
        f"{TIME_OF_FRAME}." + cut
    )
