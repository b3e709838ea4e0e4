"""What modes cost beside ray casting: Purcell et al., Table 3, on the user's scene."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from clrast.options import RenderOptions
from clrast.renderer import render
from clrast.scene.model import Camera, Light, Scene

MODES: dict[str, dict[str, Any]] = {
    "shadow": {"mode": "shadow"},
    "whitted": {"mode": "whitted"},
    "path": {"mode": "path", "max_depth": 2, "samples": 1},
}
"""Table 3's ray tracers: its paths have two bounces, and here one path of each sample."""

FRAMES = 3


@dataclass(frozen=True)
class ModeRow:
    """One mode. ratio : of its time, visibility and shading, to that of mode `cast`. rays : beside the camera's."""

    mode: str
    ratio: float
    rays: int


def lit(scene: Scene) -> tuple[Scene, bool]:
    """The scene, with a sun of ours where it has no light; and whether it has one."""
    if scene.lights:
        return scene, False
    slope = 1 / math.sqrt(3)
    sun = Light("sun", "directional", (3.0, 3.0, 3.0), direction=(-slope, -slope, -slope))
    return replace(scene, lights=(sun,)), True


def measure_modes(scene: Scene, camera: Camera, options: RenderOptions, show: Callable[[str], None]) -> list[ModeRow]:
    """Times of MODES relative to `cast`, all with primary hits by the method of the options."""
    scene, _ = lit(scene)
    base = replace(options, aov=("color",), repeat=FRAMES)

    def measure(changes: dict[str, Any]) -> tuple[float, int]:
        stats = render(scene, camera, options=replace(base, **changes)).stats
        rays = sum(stats["counts"][f"rays_{kind}"] for kind in ("shadow", "reflection", "refraction", "indirect"))
        return stats["times_ms"]["visibility"] + stats["times_ms"]["shade"], rays

    show("timing mode cast")
    cast_ms, _ = measure({"mode": "cast"})
    rows = []
    for mode, changes in MODES.items():
        show(f"timing mode {mode}")
        ms, rays = measure(changes)
        rows.append(ModeRow(mode, ms / cast_ms, rays))
    return rows
