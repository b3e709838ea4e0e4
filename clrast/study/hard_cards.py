"""Hard cases as scene cards: those of data/hard/, and the card that reproduces one wrong image."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping

from clrast.scene.model import Camera
from clrast.study.hard_case import HardCase


def card_text(case: HardCase, render: Mapping[str, str] | None = None) -> str:
    """The card of a case with all its views; `render` : options that it sets, by name."""
    lines = [f"# {line}" for line in textwrap.wrap(case.hard, 110)]
    lines += [f"# Expected: {expectation(case)}.", f'name = "{case.name}"', "", "[image]", f"size = {list(case.size)}"]
    if render:
        lines += ["", "[render]", *(f'{name} = "{value}"' for name, value in render.items())]
    for camera in case.cameras:
        lines += ["", *_camera_lines(camera)]
    lines += ["", "[[mesh]]", f'name = "{case.name}"', "vertices = ["]
    lines += [f"  {[float(c) for c in position]}," for position in case.positions]
    lines += ["]", "triangles = ["]
    lines += [f"  {[int(k) for k in triangle]}," for triangle in case.triangles]
    return "\n".join([*lines, "]", ""])


def expectation(case: HardCase) -> str:
    """Which rungs give wrong samples, in words."""
    right = f"none by {', '.join(case.right)}"
    return f"wrong samples by {', '.join(case.wrong)}; {right}" if case.wrong else f"wrong samples: {right}"


def _camera_lines(camera: Camera) -> list[str]:
    vectors = {"eye": camera.eye, "look_at": camera.look_at, "up": camera.up}
    lines = ["[[camera]]", f'name = "{camera.name}"', f'projection = "{camera.projection}"']
    lines += [f"{name} = {[float(c) for c in vector]}" for name, vector in vectors.items()]
    if camera.projection == "orthographic":
        return [*lines, f"height = {float(camera.height)!r}"]
    return [*lines, f"fov = {float(camera.fov)!r}"]
