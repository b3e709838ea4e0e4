#!/usr/bin/env python3
"""Renders the pictures of README.md into data/pictures.

    python tools/make_pictures.py            Sponza from inside with lights; needs ../shared/scenes/sponza.glb
    python tools/make_pictures.py --size 480x270 --output somewhere

Crytek's Sponza comes without lights: a sun from above and lamps along the hall are put in here.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from clrast import Camera, load, render  # noqa: E402
from clrast.options import parse_size  # noqa: E402
from clrast.scene.model import Light, Scene  # noqa: E402

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


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=lambda text: parse_size("--size", text), default=(960, 540))
    parser.add_argument("--output", type=Path, default=ROOT / "data" / "pictures")
    args = parser.parse_args()
    if not SPONZA.exists():
        print(f"{SPONZA.name} is not there: nothing to render")
        return 1
    args.output.mkdir(parents=True, exist_ok=True)
    camera = Camera(eye=(-1150.0, 260.0, -60.0), look_at=(600.0, 330.0, 60.0), fov=58.0)
    frame = render(light_sponza(load(str(SPONZA))), camera=camera, size=args.size)
    frame.save(args.output / "sponza.png")
    print(args.output / "sponza.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
