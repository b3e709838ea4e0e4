#!/usr/bin/env python3
"""Draws what accuracy costs on three scenes into data/pictures, by `clrast accuracy`.

    python tools/make_accuracy_pictures.py                   Sponza from inside, the bunny, data/room.toml
    python tools/make_accuracy_pictures.py --scenes room --pages out --budget 120

Sponza and the bunny are looked for in ../shared/scenes; what is not there is said. --pages DIR also writes the page and
the table of each scene. Times are of the machine that runs it, which should do nothing else meanwhile.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from clrast.__main__ import main as clrast  # noqa: E402

SHARED = ROOT.parent / "shared" / "scenes"
INSIDE = ["--eye", "-1100,300,-30", "--look-at", "1000,350,0", "--fov", "60"]
SCENES = {
    "sponza": (SHARED / "sponza.glb", INSIDE),
    "bunny": (SHARED / "bunny.ply", []),
    "room": (ROOT / "data" / "room.toml", ["--size", "512x512"]),
}
"""Name of the picture -> the scene, and the options of its view."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=lambda text: text.split(","), default=list(SCENES))
    parser.add_argument("--output", type=Path, default=ROOT / "data" / "pictures")
    parser.add_argument("--pages", type=Path, default=None)
    parser.add_argument("--budget", default="60")
    args = parser.parse_args()
    code = 0
    for folder in (args.output, args.pages):
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
    for name in args.scenes:
        source, view = SCENES[name]
        if not source.exists():
            print(f"{name}: left out: {source.name} is not in {source.parent}")
            code = 1
            continue
        picture = args.output / f"accuracy-{name}.svg"
        words = ["accuracy", str(source), *view, "--budget", args.budget, "-o", str(picture)]
        if args.pages is not None:
            words += ["--html", str(args.pages / f"{name}.html"), "-o", str(args.pages / f"{name}.json")]
        code = clrast(words) or code
    return code


if __name__ == "__main__":
    sys.exit(main())
