#!/usr/bin/env python3
"""Writes the benchmark scenes of clrast/study/suite.py as scene cards with binary PLY meshes beside them.

    python tools/make_suite.py                                   all five into out/suite
    python tools/make_suite.py --out DIR --only hall,city --scale 0.1
    clrast render out/suite/hall.toml --camera inside -o hall.exr
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from clrast.errors import ClrastError  # noqa: E402
from clrast.study.suite import SEED, SUITE, check_request, write_scene  # noqa: E402


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "suite", help="folder of the cards")
    parser.add_argument("--only", default=",".join(SUITE), help="names of scenes, with commas between them")
    parser.add_argument("--scale", type=float, default=1.0, help="share of the triangles")
    parser.add_argument("--seed", type=int, default=SEED)
    args = parser.parse_args(arguments)
    names = args.only.split(",")
    try:
        for name in names:  # a mistake in any of them before the first is written
            check_request(name, args.scale, args.seed)
        for name in names:
            started = time.perf_counter()
            card = write_scene(name, args.out, args.scale, args.seed)
            print(f"{card}: {SUITE[name].kind} {time.perf_counter() - started:.1f} s")
    except ClrastError as error:
        print(f"make_suite: {error}", file=sys.stderr)
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
