"""Inputs that make other programs hang or crash: NaN, Inf, no area, twice the same, indices out of range.

Each is a file, rendered by the command line in a process of its own, so that a hang is seen; `code` is the exit code
that the design says, and for those that render, `ids` what a triangle over the whole view must show.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import clrast
from clrast.options import AVAILABLE_PRECISIONS

SECONDS = 60
WALL = "v -9 -9 -2\nv 9 -9 -2\nv 0 9 -2\n"
FARTHEST = "v 3e38 0 -3e38\nv -3e38 1 -3e38\nv 0 3e38 -3e38\nf 1 2 3\nf 4 5 6\n"
VIEW = ("--eye", "0,0,1", "--look-at", "0,0,0", "--fov", "30", "--size", "16x16", "--aov", "id,depth", "-q")


@dataclass(frozen=True)
class Input:
    """An OBJ file, the exit code that it must give, and the one id that its image must show."""

    name: str
    text: str
    code: int
    prim_id: int | None = None
    precision: str = "midpoint"


INPUTS = (
    Input("NaN in a vertex that is used", WALL + "v nan 0 0\nf 1 2 3\nf 1 2 4\n", 65),
    Input("Inf in a vertex that is used", WALL + "v 0 inf 0\nf 1 2 3\nf 1 2 4\n", 65),
    Input("a number beyond float32", WALL + "v 0 1e300 0\nf 1 2 3\nf 1 2 4\n", 65),
    Input("NaN in a vertex that is not used", WALL + "v nan 0 0\nf 1 2 3\n", 0, 0),
    Input("an index out of range", WALL + "f 1 2 9\n", 65),
    Input("an index of 0", WALL + "f 0 1 2\n", 65),
    Input("no triangle", WALL, 65),
    Input("nothing", "", 65),
    Input("points and lines before a wall", WALL + "v 0 0 0\nf 4 4 4\nf 4 1 4\nf 1 2 3\n", 0, 2),
    Input("twice the same triangle", WALL + "f 1 2 3\nf 1 2 3\nf 3 2 1\n", 0, 0),
    # Beside it a wall of ordinary size is a subnormal number at the scale at which float32 products do not overflow:
    # below `exact` (and `double`) it is lost.
    Input("the largest numbers behind a wall", WALL + FARTHEST, 0, 0, "exact"),
    Input("subnormal numbers before a wall", WALL + "v 0 0 1e-44\nv 1e-44 0 0\nv 0 1e-44 0\nf 4 5 6\nf 1 2 3\n", 0, 1),
)


def run_inputs(folder: Path, device: str | None = None) -> Iterator[tuple[Input, str]]:
    """Each input with what is wrong; an empty text where nothing is."""
    for k, one in enumerate(INPUTS):
        source, image = folder / f"{k}.obj", folder / f"{k}.exr"
        source.write_text(one.text)
        words = [sys.executable, "-P", "-m", "clrast", "render", str(source), "-o", str(image), *VIEW]
        if one.precision != "midpoint":
            if one.precision not in AVAILABLE_PRECISIONS:
                continue
            words += ["--precision", one.precision, "--method", "3dr-binning"]
        words += ["--device", device] if device else []
        try:
            done = subprocess.run(words, capture_output=True, text=True, timeout=SECONDS, cwd=Path(__file__).parents[1])
        except subprocess.TimeoutExpired:
            yield one, f"no end within {SECONDS} s"
            continue
        yield one, fault_of(one, done.returncode, done.stderr, image)


def fault_of(one: Input, code: int, stderr: str, image: Path) -> str:
    """What is wrong with a run."""
    if code != one.code:
        return f"exit code {code} in place of {one.code}: {stderr.strip()[-200:]}"
    if "Traceback" in stderr or (one.code and len([s for s in stderr.splitlines() if "warning:" not in s]) != 1):
        return f"not one line: {stderr.strip()[-200:]}"
    if image.exists() != (code == 0):
        return "an image was left" if code else "no image"
    if one.prim_id is not None:
        ids = clrast.Frame.load(image)["id.prim"]
        if not (ids == one.prim_id).all():
            return f"ids {sorted(set(ids.ravel().tolist()))} in place of {one.prim_id}"
    return ""
