#!/usr/bin/env python3
"""Mitsuba 3 on the Cornell box, in a process of its own, for tools/bench_modes.py.

    python bench_modes_peer.py VARIANT BSDF FOLDER SIDE

Prints `ready MS`, what the scene took to load. Then for each line `BOUNCES SAMPLES SEED` it renders once and prints
`MS R G B`: the time until the image is in an array of the host, and the image's mean. FOLDER : for the scene's meshes.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from cornell_mitsuba import ROULETTE, box_tree, native_bsdf, path_tree, sensor_tree  # noqa: E402


def main() -> None:
    import mitsuba as mi

    variant, bsdf, folder, side = sys.argv[1], sys.argv[2], Path(sys.argv[3]), int(sys.argv[4])
    mi.set_variant(variant)
    mi.set_log_level(mi.LogLevel.Error)
    started = time.perf_counter()
    tree = box_tree(folder, lambda surface: native_bsdf(surface, bsdf))
    scene = mi.load_dict({**tree, "sensor": sensor_tree(mi.ScalarTransform4f().look_at, side, 1)})
    print(f"ready {1000 * (time.perf_counter() - started):.3f}", flush=True)
    integrators: dict[int, Any] = {}
    for line in sys.stdin:
        bounces, samples, seed = (int(text) for text in line.split())
        if bounces not in integrators:
            integrators[bounces] = mi.load_dict(path_tree(bounces, ROULETTE))
        started = time.perf_counter()
        image = np.array(mi.render(scene, integrator=integrators[bounces], spp=samples, seed=seed))
        spent = 1000 * (time.perf_counter() - started)
        mean = image.astype(np.float64).mean(axis=(0, 1))
        print(f"{spent:.3f} " + " ".join(f"{value:.9g}" for value in mean), flush=True)


if __name__ == "__main__":
    main()
