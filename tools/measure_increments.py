#!/usr/bin/env python3
"""How far edge functions that are summed up drift from their values, and what that costs: the paraboloid's sums.

    python tools/measure_increments.py [--size N] [--edges N] [--seed N]

Davidovic et al., '3D Rasterization', section 3.4, saw no sampling problem 'with incremental evaluation (for reasonably
small bin sizes)'. cl/incremental_edges.clh begins anew in each square of INCREMENT_CELL samples a side, derives a bound
and goes on by 4 samples at a time. Two tables say what is measured:

    by steps    in squares of that size, of random edges at random samples of the disc: how many steps led to a sample,
                the largest and the mean |V summed up - V exact|, in units of 2^-24 |n|, and the largest in pixels by
                which an edge is misplaced (V changes by |n| / R for each pixel where it is 0)
    by squares  the same for squares of other sizes, up to the whole image, beside the bound; and a sphere from
                inside, rendered with such squares: samples wrong against exact arithmetic, missed, hit twice

`direct` is n . d with the sample's own d. The sums are those of tests/incremental_twin.py, whose bits the kernels have
(tests/test_incremental.py), and exact is n . d in float64, 2^29 times as fine. The last lines are of rung `exact`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from curved_reference import exact_image_by_blocks, rays_of  # noqa: E402
from curved_world import ball, curved_view  # noqa: E402
from incremental_twin import STEP, exact_values, radius_of, summed_values  # noqa: E402
from kernel_world import NO_HIT, render  # noqa: E402

from clrast.opencl import layout  # noqa: E402
from clrast.opencl.constants import INCREMENT_CELL, INCREMENT_CURVED_SLACK  # noqa: E402
from clrast.opencl.device import Device, open_device  # noqa: E402
from clrast.scene.camera import CameraVectors  # noqa: E402
from clrast.scene.model import Scene  # noqa: E402
from clrast.visibility.sample_generator import sample_rays  # noqa: E402

UNIT = 2.0**-24
SMALLEST_CELL = 4


@dataclass(frozen=True)
class Edges:
    """Edges at samples of the disc. n : (count, 3) float32; size : (count,) float64, |n|; exact : (count,) float64."""

    n: np.ndarray
    columns: np.ndarray
    rows: np.ndarray
    size: np.ndarray
    exact: np.ndarray

    def errors(self, found: np.ndarray) -> np.ndarray:
        """(count,) |found - exact| in units of 2^-24 |n|."""
        return abs(found.astype(np.float64) - self.exact) / (self.size * UNIT)


def random_edges(view: CameraVectors, count: int, seed: int) -> Edges:
    rng = np.random.default_rng(seed)
    n = rng.normal(size=(count, 3)).astype(np.float32)
    radius = radius_of(view)
    at = np.sqrt(rng.random(count)) * radius * (1 - 1 / radius)
    turn = 2 * np.pi * rng.random(count)
    columns = (view.width / 2 + at * np.cos(turn)).astype(int)
    rows = (view.height / 2 + at * np.sin(turn)).astype(int)
    exact = exact_values(view, n, columns, rows, np.float64)
    return Edges(n, columns, rows, np.linalg.norm(n.astype(np.float64), axis=1), exact)


def direct_values(view: CameraVectors, edges: Edges) -> np.ndarray:
    """n . d as cl/edge_function.clh has it."""
    d = sample_rays(view, edges.columns + 0.5, edges.rows + 0.5).d
    n = edges.n
    return (n[:, 0] * d[:, 0] + n[:, 1] * d[:, 1]) + n[:, 2] * d[:, 2]


def slack_of(cell: int) -> float:
    """INCREMENT_CURVED_SLACK of squares of another size."""
    return INCREMENT_CURVED_SLACK + 1.125 * (cell - INCREMENT_CELL) * UNIT


def sphere(levels: int) -> Scene:
    """The ball without its bumps: convex, so that from inside each sample is hit once."""
    bumpy = ball(levels)
    lengths = np.linalg.norm(bumpy.positions.astype(np.float64), axis=1, keepdims=True)
    return replace(bumpy, positions=(bumpy.positions / lengths).astype(np.float32))


@contextmanager
def squares(device: Device, cell: int) -> Iterator[Device]:
    """The device with kernels for squares of `cell` samples a side."""
    before = dict(layout.CONSTANTS)
    layout.CONSTANTS.update(INCREMENT_CELL=cell, INCREMENT_CURVED_SLACK=slack_of(cell))
    try:
        yield replace(device, programs={})
    finally:
        layout.CONSTANTS.update(before)


@dataclass(frozen=True)
class Counted:
    """Samples of a closed mesh seen from inside."""

    wrong: int
    missed: int
    twice: int
    asked: int  # of rung `exact`: pairs that float64 or integers decided

    @staticmethod
    def of(device: Device, scene: Scene, view: CameraVectors, right: np.ndarray, **options: str) -> Counted:
        """Every triangle meets every sample of its bound, so that all that cover a sample are counted."""
        frame = render(device, scene, view, aov="id", method="3dr-brute", counters=True, **options)
        ids, counts = frame["id.prim"], frame.stats["other_counts"]
        samples = int((right != NO_HIT).sum())
        missed = int(((ids == NO_HIT) & (right != NO_HIT)).sum())
        asked = counts.get("decided_float64", 0) + counts.get("contenders", 0)
        return Counted(int((ids != right).sum()), missed, counts["samples_covered"] - samples + missed, asked)


def print_steps(view: CameraVectors, edges: Edges) -> None:
    steps = edges.columns % INCREMENT_CELL // STEP + edges.rows % INCREMENT_CELL // STEP
    errors = edges.errors(summed_values(view, edges.n, edges.columns, edges.rows))
    print(f"squares of {INCREMENT_CELL} x {INCREMENT_CELL}: {len(errors):,} edges at samples")
    print(f"{'steps':>7}{'edges':>10}{'largest':>10}{'mean':>8}{'pixels':>11}")
    for k in range(steps.max() + 1):
        own = errors[steps == k]
        print(f"{k:>7}{len(own):>10,}{own.max():>10.2f}{own.mean():>8.2f}{own.max() * UNIT * radius_of(view):>11.2g}")


def print_row(name: str, errors: np.ndarray, bound: float | None, view: CameraVectors, counted: Counted) -> None:
    pixels = errors.max() * UNIT * radius_of(view)
    limit = "" if bound is None else f"{bound:.0f}"
    print(f"{name:>8}{errors.max():>10.2f}{errors.mean():>8.2f}{limit:>8}{pixels:>11.2g}"
          f"{counted.wrong:>8}{counted.missed:>8}{counted.twice:>8}")  # fmt: skip


def print_squares(device: Device, view: CameraVectors, edges: Edges, scene: Scene, right: np.ndarray) -> bool:
    """Whether every error keeps to its bound, and the squares in use to the project's bars."""
    print(f"\na sphere of {scene.triangle_count:,} triangles, {int((right != NO_HIT).sum()):,} samples, midpoint")
    print(f"{'square':>8}{'largest':>10}{'mean':>8}{'bound':>8}{'pixels':>11}{'wrong':>8}{'missed':>8}{'twice':>8}")
    counted = Counted.of(device, scene, view, right)
    print_row("direct", edges.errors(direct_values(view, edges)), None, view, counted)
    holds, cell = True, SMALLEST_CELL
    while cell < 2 * max(view.width, view.height):
        errors = edges.errors(summed_values(view, edges.n, edges.columns, edges.rows, cell=cell))
        bound = slack_of(cell) / UNIT * (1 + cell / radius_of(view)) ** 2
        with squares(device, cell) as own:
            counted = Counted.of(own, scene, view, right, evaluation="incremental")
        print_row(str(cell) + " *" * (cell == INCREMENT_CELL), errors, bound, view, counted)
        holds &= bool(errors.max() <= bound)
        if cell == INCREMENT_CELL:
            samples = int((right != NO_HIT).sum())
            holds &= counted.missed == counted.twice == 0 and counted.wrong * 20_000 <= samples
        cell *= 2
    return holds


def main(arguments: Sequence[str] | None = None) -> int:
    """0: bounds and bars hold; 1: one does not."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=500, help="side of the image, pixels [default: 500]")
    parser.add_argument("--edges", type=int, default=200_000, help="edges at samples [default: 200000]")
    parser.add_argument("--levels", type=int, default=6, help="of the sphere: 8 x 4^levels triangles [default: 6]")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(arguments)
    device, scene = open_device(None), sphere(options.levels)
    view = curved_view("paraboloid", options.size, options.size)
    edges = random_edges(view, options.edges, options.seed)
    print_steps(view, edges)
    rays = rays_of(render(device, scene, view, aov="ray").channels)
    right, _ = exact_image_by_blocks(scene.positions, scene.triangles, np.array(view.origin), *rays)
    holds = print_squares(device, view, edges, scene, right)
    for evaluation in ("direct", "incremental"):
        counted = Counted.of(device, scene, view, right, precision="exact", evaluation=evaluation)
        print(f"exact, {evaluation}: {counted.wrong} wrong; {counted.asked:,} samples left open by float32")
        holds &= counted.wrong == 0
    return int(not holds)


if __name__ == "__main__":
    sys.exit(main())
