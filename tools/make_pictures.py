#!/usr/bin/env python3
"""Renders the pictures of README.md into data/pictures.

    python tools/make_pictures.py            Sponza from inside with lights; needs ../shared/scenes/sponza.glb
    python tools/make_pictures.py --size 480x270 --output somewhere

sponza.png: Crytek's Sponza comes without lights: a sun from above and lamps along the hall are put in here.
cost.png: a street of the suite's city, and how often edge functions were evaluated at each pixel by 3dr-binning and
by 3dr-full, as in the right images of Fig. 1 of Davidovic et al.; both in one scale of colours.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402

from clrast import Camera, load, render  # noqa: E402
from clrast.image.png import picture, write_pixels  # noqa: E402
from clrast.option_values import parse_size  # noqa: E402
from clrast.scene.model import Light, Scene  # noqa: E402
from clrast.study.suite import make_scene, make_view  # noqa: E402

SPONZA = ROOT.parent / "shared" / "scenes" / "sponza.glb"


def light_sponza(scene: Scene) -> Scene:
    """Sponza with a sun, a sky that fills from above, and two rows of warm lamps; units are centimetres."""
    lights = [
        Light("sun", "directional", (1.9, 1.75, 1.5), direction=(-0.30, -0.90, 0.3162277660168379)),
        Light("sky", "directional", (0.30, 0.38, 0.50), direction=(0.0, -1.0, 0.0)),
        Light("fill", "directional", (0.85, 0.80, 0.72), direction=(0.8, 0.0, -0.6)),
        Light("back fill", "directional", (0.50, 0.50, 0.55), direction=(-0.6, 0.0, 0.8)),
        Light("floor", "directional", (0.55, 0.48, 0.42), direction=(0.0, 1.0, 0.0)),
    ]
    for x in (-900.0, -300.0, 300.0, 900.0):
        lights.append(Light(f"lamp {x:g}", "point", (60000.0, 42000.0, 24000.0), position=(x, 160.0, -20.0)))
    return replace(scene, lights=tuple(lights))


RAMP = ((0.0, 8, 8, 40), (0.25, 40, 60, 170), (0.5, 30, 160, 140), (0.75, 250, 200, 60), (1.0, 255, 255, 240))
"""Share of the scale -> red, green, blue."""
SCALE = 256.0
"""Evaluations at a pixel that are the end of the scale, which is logarithmic."""


def cost_colors(evaluations: np.ndarray) -> np.ndarray:
    """(H, W) counts as (H, W, 3) uint8 colours of RAMP."""
    share = np.clip(np.log2(1 + evaluations) / np.log2(1 + SCALE), 0, 1)
    stops = [stop[0] for stop in RAMP]
    return np.stack([np.interp(share, stops, [stop[k] for stop in RAMP]) for k in (1, 2, 3)], -1).astype(np.uint8)


def cost_picture(size: tuple[int, int]) -> np.ndarray:
    """Colour, cost of 3dr-binning and of 3dr-full side by side: (H, 3 W, 3) uint8."""
    scene = make_view("city-street", make_scene("city"))
    panels = []
    for method in ("3dr-binning", "3dr-full"):
        frame = render(scene, scene.cameras[0], size=size, method=method, aov=("color", "cost"))
        cost = frame["cost.edge_evaluations"]
        print(f"{method}: {cost.mean():.1f} evaluations a pixel, at most {cost.max():.0f}")
        panels += [picture(frame)[..., :3]] if not panels else []
        panels.append(cost_colors(cost))
    return np.concatenate(panels, axis=1)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=lambda text: parse_size("--size", text), default=(960, 540))
    parser.add_argument("--output", type=Path, default=ROOT / "data" / "pictures")
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    width, height = args.size
    write_pixels(args.output / "cost.png", cost_picture((width // 3, height // 2)))
    print(args.output / "cost.png")
    if not SPONZA.exists():
        print(f"{SPONZA.name} is not there: nothing to render")
        return 1
    camera = Camera(eye=(-1150.0, 260.0, -60.0), look_at=(600.0, 330.0, 60.0), fov=58.0)
    frame = render(light_sponza(load(str(SPONZA))), camera=camera, size=args.size)
    frame.save(args.output / "sponza.png")
    print(args.output / "sponza.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
