#!/usr/bin/env python3
"""Renders random adversarial worlds in the rung `exact` against exact arithmetic; exit 1 where a sample is wrong.

    python tools/fuzz_exact.py                                    200 worlds from seed 0, on the default device
    python tools/fuzz_exact.py 5000 --seed 1000 --max-side 300
    python tools/fuzz_exact.py --families "on rays,fans" --methods 3dr-full --no-float64 --device rusticl

The worlds are those of tests/adversarial_worlds.py, the answers those of clrast/study/exact_visibility.py, which
shares nothing with the kernels. Each world is rendered by one method, which changes with the seed as the way of
evaluation does. A wrong world is printed with what renders it again.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from dataclasses import dataclass, field, replace
from pathlib import Path

os.environ.setdefault("CLRAST_CACHE_DIR", "off")

import numpy as np  # noqa: E402

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from adversarial_worlds import FAMILIES, World, full_mantissas, make_world  # noqa: E402
from kernel_world import NO_HIT, start  # noqa: E402

from clrast.errors import ClrastError  # noqa: E402
from clrast.opencl.device import Device, open_device  # noqa: E402
from clrast.study.exact_visibility import exact_visibility  # noqa: E402
from clrast.visibility.methods import METHODS  # noqa: E402

FULL = "full mantissas"
COUNTS = ("decided_float64", "contenders", "decided_exact")
INCREMENTAL_EVERY = 7


@dataclass
class Total:
    """What all worlds came to."""

    samples: int = 0
    wrong: int = 0
    hits: int = 0
    worlds: int = 0
    counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(COUNTS, 0))


def world_of(family: str, seed: int, max_side: int) -> World:
    if family == FULL:
        return full_mantissas(seed, ("perspective", "orthographic")[seed % 2])
    return make_world(family, seed, None, max_side)


def check(device: Device, world: World, method: str, total: Total) -> None:
    """Render one world and add what came of it."""
    view, scene = world.view, world.scene
    evaluation = "incremental" if world.seed % INCREMENTAL_EVERY == 3 else "direct"
    with np.errstate(all="ignore"):
        try:
            right = exact_visibility(scene.positions, scene.triangles, view.named(), view.width, view.height).prim_id
        except ValueError as error:
            print(f"{world}: not rendered: {error}")
            return
        options = {"aov": "id", "precision": "exact", "method": method, "evaluation": evaluation}
        job, frame = start(device, scene, view, **options)
    found = frame["id.prim"]
    rows, columns = np.nonzero(found != right)
    total.worlds += 1
    total.samples += right.size
    total.hits += int((right != NO_HIT).sum())
    total.wrong += len(rows)
    assert job.contenders is not None
    for name in COUNTS:
        total.counts[name] += job.contenders.counts[name]
    if len(rows):
        i, j = columns[0], rows[0]
        print(f"{world} by {method}, {evaluation}: {len(rows)} wrong, ({i}, {j}) {found[j, i]} for {right[j, i]}")


def parse(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", nargs="?", type=int, default=200, help="worlds (default 200)")
    parser.add_argument("--seed", type=int, default=0, help="of the first world (default 0)")
    names = ", ".join([*FAMILIES, FULL])
    parser.add_argument("--families", default="", help=f"separated by commas; default all: {names}")
    parser.add_argument("--methods", default="", help="separated by commas; default all")
    parser.add_argument("--max-side", type=int, default=70, help="of an image, pixels (default 70)")
    parser.add_argument("--device", default=None, help="as for clrast render")
    parser.add_argument("--no-float64", action="store_true", help="as if the device had none")
    given = parser.parse_args(arguments)
    given.families = [name for name in given.families.split(",") if name] or [*FAMILIES, FULL]
    given.methods = [name for name in given.methods.split(",") if name] or list(METHODS)
    for name in given.families:
        if name not in FAMILIES and name != FULL:
            parser.error(f"--families: no family {name!r}: choose from {names}")
    for name in given.methods:
        if name not in METHODS:
            parser.error(f"--methods: no method {name!r}: choose from {', '.join(METHODS)}")
    if given.count < 1 or given.seed < 0 or given.max_side < 4:
        parser.error("count must be at least 1, --seed at least 0 and --max-side at least 4")
    return given


def main(arguments: list[str] | None = None) -> int:
    given = parse(arguments)
    try:
        device = open_device(given.device)
        if given.no_float64:
            device = replace(device, has_fp64=False)
        total, started = Total(), time.monotonic()
        for seed in range(given.seed, given.seed + given.count):
            family = given.families[seed % len(given.families)]
            method = given.methods[seed // len(given.families) % len(given.methods)]
            check(device, world_of(family, seed, given.max_side), method, total)
    except ClrastError as error:
        print(f"fuzz_exact: {error}", file=sys.stderr)
        return error.exit_code
    counts = total.counts
    print(f"wrong {total.wrong} of {total.samples} samples")
    print(
        f"{total.worlds} worlds, {total.hits} samples hit, on {device.name} in {time.monotonic() - started:.0f} s; "
        f"decided by float64: {counts['decided_float64']}, by integers: {counts['decided_exact']}, "
        f"listed: {counts['contenders']}"
    )
    return 1 if total.wrong else 0


if __name__ == "__main__":
    sys.exit(main())
