"""Path tracing of a Cornell box against Mitsuba 3, where that is installed: a z-test of each pixel, and of the image.

The z-test is Mitsuba's own for its renders: significance 0.01 with Sidak's correction, a floor of 1e-4 for variances of
samples, 99.75 % of pixels and channels at least. It is a weak one for a bias of all pixels, which the means of whole
images show. Both programs take the same rays through pixels' centres, the same BRDF (cornell_worker.py) and the same
longest paths: rays that follow each other, --max-depth, are two less than Mitsuba's max_depth, which counts the eye's
ray and the one to the lamp.
"""

from __future__ import annotations

import importlib.util
import statistics
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from cornell_box import card_text

import clrast

SIDE = 40
OURS = {"seeds": 32, "samples": 32}
THEIRS = {"batches": 64, "samples": 128}
WORKER = Path(__file__).with_name("cornell_worker.py")


def z_of(significance: float, tests: int) -> float:
    """Size of a normal number that one of so many tests exceeds with that chance (Sidak)."""
    each = 1 - (1 - significance) ** (1 / tests)
    return statistics.NormalDist().inv_cdf(1 - each / 2)


def their_means(frame: clrast.Frame, folder: Path, depth: int) -> np.ndarray:
    """(batches, SIDE, SIDE, 3) means of Mitsuba's samples through the pixels' centres."""
    vectors = {name: np.array(vector, np.float64) for name, vector in frame.stats["camera"].items()}
    np.savez(folder / "camera.npz", size=SIDE, **vectors)
    numbers = [str(each) for each in (depth, THEIRS["batches"], THEIRS["samples"])]
    command = [sys.executable, str(WORKER), str(folder / "camera.npz"), str(folder / "out.npz"), *numbers]
    subprocess.run(command, check=True, timeout=1800)
    return np.load(folder / "out.npz")["means"].astype(np.float64)


@pytest.mark.long
@pytest.mark.parametrize("depth", [0, 1, 5])
def test_a_cornell_box(tmp_path: Path, depth: int) -> None:
    if importlib.util.find_spec("mitsuba") is None:
        pytest.skip("Mitsuba 3 is not installed: pip install 'clrast[peers]'")
    (tmp_path / "box.toml").write_text(card_text())
    scene = clrast.load(tmp_path / "box.toml")
    options = {"mode": "path", "size": (SIDE, SIDE), "samples": OURS["samples"], "max_depth": depth, "aov": "color"}
    frames = [clrast.render(scene, seed=seed, **options) for seed in range(OURS["seeds"])]
    ours = np.array([np.stack([frame[c] for c in "RGB"], axis=2) for frame in frames], dtype=np.float64)
    theirs = their_means(frames[0], tmp_path, depth)
    # Variance of means: floored as that of samples is, by 1e-4 over their number.
    spread = [
        np.maximum(each.var(axis=0, ddof=1), 1e-4 / samples) / len(each)
        for each, samples in ((ours, OURS["samples"]), (theirs, THEIRS["samples"]))
    ]
    z = (ours.mean(axis=0) - theirs.mean(axis=0)) / np.sqrt(spread[0] + spread[1])
    assert (abs(z) < z_of(0.01, z.size)).mean() >= 0.9975
    whole = [each.mean(axis=(1, 2)) for each in (ours, theirs)]
    error = np.sqrt(sum(each.var(axis=0, ddof=1) / len(each) for each in whole))
    difference, level = whole[0].mean(axis=0) - whole[1].mean(axis=0), whole[1].mean(axis=0)
    assert (4.7534 * error < 0.01 * level).all(), "too few samples to see 1 %"
    assert (abs(difference) < 4.7534 * error).all(), f"{difference / level} of the mean, {difference / error} errors"
