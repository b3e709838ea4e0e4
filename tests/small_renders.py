"""Small scenes and views that together use everything a render can: for tests of whole renders."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SHARED = ROOT.parent / "shared" / "scenes"

LAYERS = """
# Panes behind, beside and through one another, two glass spheres, an opaque one behind them all.
[[camera]]
eye = [0.3, 1.2, 4.0]
look_at = [0.0, 0.4, 0.0]
fov = 40.0

[[light]]
kind = "point"
intensity = 20.0
position = [1.0, 3.0, 2.0]

[[material]]
name = "red"
base_color = [0.8, 0.1, 0.1, 0.5]
alpha_mode = "BLEND"

[[material]]
name = "blue"
base_color = [0.2, 0.5, 0.9, 0.35]
alpha_mode = "BLEND"

[[mesh]]
shape = "plane"
scale = [4, 1, 4]

[[mesh]]
shape = "box"
material = "blue"
scale = [2, 1.4, 0.02]
rotate = { axis = [0, 1, 0], degrees = 30 }
translate = [0, 0.7, 0]

[[mesh]]
shape = "box"
material = "red"
scale = [2, 1.0, 0.02]
rotate = { axis = [0, 1, 0], degrees = -20 }
translate = [0, 0.6, 0]

[[mesh]]
shape = "sphere"
segments = 16
material = "blue"
translate = [0.4, 0.6, 1.0]

[[mesh]]
shape = "sphere"
segments = 16
material = "red"
translate = [-0.5, 0.3, 1.2]

[[mesh]]
shape = "sphere"
segments = 16
translate = [-0.6, 0.5, -1.0]
"""

LAMPS = """
# No lights, so a headlight; an unlit sign, a smooth ball that glows, coloured corners; no camera.
[[material]]
name = "sign"
base_color = [0.9, 0.5, 0.1]
unlit = true

[[material]]
name = "lamp"
base_color = [0.3, 0.3, 0.3]
emissive = [0.0, 0.6, 0.25]

[[mesh]]
shape = "box"
material = "sign"
rotate = { axis = [1, 1, 0], degrees = 30 }

[[mesh]]
shape = "icosphere"
subdivisions = 2
smooth = true
material = "lamp"
translate = [0.9, 0.2, 0.4]

[[mesh]]
shape = "plane"
scale = [3, 1, 3]
translate = [0, -0.8, 0]

[[mesh]]
vertices = [[-1.5, -0.8, -1.0], [0.2, -0.8, -1.2], [-0.7, 0.9, -1.1]]
triangles = [[0, 1, 2]]
colors = [[1.0, 0.1, 0.1], [0.1, 1.0, 0.1], [0.1, 0.1, 1.0]]
"""


@dataclass(frozen=True)
class SmallRender:
    """One image: `source` : a scene; `view` : options of `clrast render` that make its pixels."""

    name: str
    source: Path
    view: tuple[str, ...]


def small_renders(folder: Path) -> dict[str, SmallRender]:
    """By name; cards that are not in data/ are written into `folder`. Five rows of tiles each."""
    (folder / "layers.toml").write_text(LAYERS)
    (folder / "lamps.toml").write_text(LAMPS)
    room = ROOT / "data" / "room.toml"
    size = ("--size", "96x160", "--aov", "all")
    made = (
        SmallRender("room", room, size),  # textures, MASK, BLEND, emission, three kinds of light
        SmallRender("plan", room, (*size, "--camera", "plan")),  # the same, orthographic
        SmallRender("layers", folder / "layers.toml", size),  # BLEND without MASK
        SmallRender("lamps", folder / "lamps.toml", size),  # opaque, unlit, emission, headlight, framed
    )
    return {one.name: one for one in made}


def large_renders() -> dict[str, SmallRender]:
    """Shared scenes, bunny from outside and Sponza from inside; none where they are not there."""
    size = ("--size", "128x128", "--aov", "all")
    inside = ("--eye", "-800,200,0", "--look-at", "1000,150,0", "--fov", "70")
    made = (
        SmallRender("bunny", SHARED / "bunny.ply", size),
        SmallRender("sponza", SHARED / "sponza.glb", (*size, *inside)),
    )
    return {one.name: one for one in made if one.source.exists()}
