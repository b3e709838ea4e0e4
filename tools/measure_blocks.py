"""How many blocks of samples are refined without need where views are not planar, on random triangles.

Davidovic et al., '3D Rasterization', section 3.5, print one such figure: about 18 % of the bins that their test
refined, for the paraboloid, did not intersect the triangle. The tests, from the whole image down to LEVELS halvings:

    shifted   theirs: V at the block's corners, those towards the circle's centre moved by m (1 - sqrt(3)/2), m the
              block's side on the disc; blocks with m > 1, or r < m/2, are always refined
    maximum   ours (cl/block_ranges.clh): the largest value that V takes in the block, in closed form
    cone      ours for the fisheye: V in the middle, and how far it may change from there
    .. and w  the same of the three edges and of nearness, which must be above 0 somewhere in the block: so ask
              cl/bin_triangles.cl and cl/sample_blocks.clh in rungs of float32, since near the antipode of a triangle
              its edges reject little

A refined block is needed where the triangle meets it: where one of POINTS x POINTS points of the block, its border
included, lies in all three edges. (So thin triangles that pass between the points count as not met.) Triangles have
corners in random directions about a random one, within a cone of the angle that the row says.

    tools/measure_blocks.py [--triangles N] [--seed N]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

LEVELS = 7
POINTS = 33
ANGLES = (5, 20, 60, 90)
PAIRS_AT_ONCE = 2048

Test = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class View:
    """A projection on the square [-1, 1] x [-1, 1]: `directions` (..., 3) of points (..., 2); z is forward."""

    name: str
    directions: Callable[[np.ndarray], np.ndarray]
    has_disc: bool
    tests: dict[str, Test]


def paraboloid(at: np.ndarray) -> np.ndarray:
    a, b = at[..., 0], at[..., 1]
    return np.stack([a, b, 0.5 - (a * a + b * b) / 2], -1)


def latlong(at: np.ndarray) -> np.ndarray:
    lon, lat = np.pi * at[..., 0], np.pi / 2 * at[..., 1]
    return np.stack([np.cos(lat) * np.sin(lon), np.sin(lat), np.cos(lat) * np.cos(lon)], -1)


FISHEYE_RIM = np.pi / 2


def fisheye(at: np.ndarray) -> np.ndarray:
    q = np.sqrt((at * at).sum(-1))
    scale = FISHEYE_RIM * np.sinc(FISHEYE_RIM * q / np.pi)
    return np.stack([at[..., 0] * scale, at[..., 1] * scale, np.cos(FISHEYE_RIM * q)], -1)


# Tests: n (count, 3) of an edge, inside where n . d > 0; blocks (count, 4) low a, low b, high a, high b. True: refine.


def shifted(n: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    side = blocks[:, 2] - blocks[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        center, radius = n[:, :2] / n[:, 2:], np.linalg.norm(n, axis=1) / abs(n[:, 2])
    corners = np.stack([blocks[:, [x, y]] for x in (0, 2) for y in (1, 3)], 1)
    towards = center - (blocks[:, :2] + blocks[:, 2:]) / 2
    axis = np.argmax(abs(towards), axis=1)
    step = side * (1 - np.sqrt(3) / 2) * np.sign(np.take_along_axis(towards, axis[:, None], 1)[:, 0])
    rows = np.arange(len(n))
    for k in range(4):
        own = corners[rows, k, axis]
        faces = (own - (blocks[rows, axis] + blocks[rows, axis + 2]) / 2) * step > 0
        corners[rows, k, axis] = np.where(faces & (n[:, 2] > 0), own + step, own)
    values = np.einsum("pkc,pc->pk", paraboloid(corners), n)
    return (values >= 0).any(axis=1) | (side > 1) | (radius < side / 2)


def highest_of_parabola(k: np.ndarray, c: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    with np.errstate(divide="ignore", invalid="ignore"):
        peak = np.where(c > 0, k / c, low)
    found = [x * (k - c * x / 2) for x in (low, high, np.clip(peak, low, high))]
    return np.maximum.reduce(found)


def maximum_of_paraboloid(n: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    a, b, c = n.T
    return c / 2 + highest_of_parabola(a, c, blocks[:, 0], blocks[:, 2]) + highest_of_parabola(
        b, c, blocks[:, 1], blocks[:, 3]
    ) >= 0


def highest_of_wave(p: np.ndarray, q: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Of p cos + q sin between two angles."""
    ends = np.maximum(*(p * np.cos(x) + q * np.sin(x) for x in (low, high)))
    peak = np.arctan2(q, p)
    holds = (peak - low) % (2 * np.pi) <= high - low
    return np.where(holds, np.hypot(p, q), ends)


def maximum_of_latlong(n: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    west, east = np.pi * blocks[:, 0], np.pi * blocks[:, 2]
    south, north = np.pi / 2 * blocks[:, 1], np.pi / 2 * blocks[:, 3]
    return highest_of_wave(highest_of_wave(n[:, 2], n[:, 0], west, east), n[:, 1], south, north) >= 0


def cone_of_fisheye(n: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    middle = fisheye((blocks[:, :2] + blocks[:, 2:]) / 2)
    reach = FISHEYE_RIM * np.linalg.norm(blocks[:, 2:] - blocks[:, :2], axis=1) / 2
    return np.einsum("pc,pc->p", middle, n) + np.linalg.norm(n, axis=1) * np.minimum(reach, 2) >= 0


VIEWS = (
    View("paraboloid", paraboloid, True, {"shifted": shifted, "maximum": maximum_of_paraboloid}),
    View("latlong", latlong, False, {"maximum": maximum_of_latlong}),
    View("fisheye", fisheye, True, {"cone": cone_of_fisheye}),
)


def random_planes(rng: np.random.Generator, count: int, angle: float, has_disc: bool) -> np.ndarray:
    """(count, 4, 3): three edges' normals that point inwards, and what gives nearness by its dot product with a
    direction, but for a factor above 0. Axes of the cones lie within the view's half of directions."""
    axis = rng.normal(size=(count, 3))
    axis[:, 2] = abs(axis[:, 2]) if has_disc else axis[:, 2]
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    off = rng.normal(size=(count, 3, 3))
    off -= (off * axis[:, None]).sum(-1, keepdims=True) * axis[:, None]
    off /= np.linalg.norm(off, axis=2, keepdims=True)
    tilt = np.radians(angle) * np.sqrt(rng.random((count, 3, 1)))
    corners = np.cos(tilt) * axis[:, None] + np.sin(tilt) * off
    edges = np.cross(np.roll(corners, -1, axis=1), np.roll(corners, -2, axis=1))
    edges *= np.sign(np.einsum("tkc,tkc->tk", edges, corners))[..., None]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals *= np.sign((normals * corners[:, 0]).sum(1))[:, None]
    return np.concatenate([edges, normals[:, None]], axis=1)


def meets(view: View, edges: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    """(count,) bool: the triangle has a point in the block."""
    share = np.linspace(0, 1, POINTS)
    a = blocks[:, :1] + share * (blocks[:, 2:3] - blocks[:, :1])
    b = blocks[:, 1:2] + share * (blocks[:, 3:] - blocks[:, 1:2])
    at = np.stack(np.broadcast_arrays(a[:, None, :], b[:, :, None]), -1)
    inside = (np.einsum("pyxc,pec->pyxe", view.directions(at), edges) >= 0).all(axis=-1)
    if view.has_disc:
        inside &= (at * at).sum(-1) <= 1
    return inside.any(axis=(1, 2))


def quarters(blocks: np.ndarray) -> np.ndarray:
    low, middle, high = blocks[:, :2], (blocks[:, :2] + blocks[:, 2:]) / 2, blocks[:, 2:]
    parts = []
    for x in (0, 1):
        for y in (0, 1):
            start = np.stack([(low, middle)[x][:, 0], (low, middle)[y][:, 1]], 1)
            end = np.stack([(middle, high)[x][:, 0], (middle, high)[y][:, 1]], 1)
            parts.append(np.concatenate([start, end], 1))
    return np.concatenate(parts)


def measure(view: View, test: Test, planes: np.ndarray, asked: int) -> tuple[int, int, int]:
    """Blocks tested by the first `asked` planes, blocks refined, and how many of these the triangle does not meet."""
    triangle, blocks = np.arange(len(planes)), np.tile([[-1.0, -1.0, 1.0, 1.0]], (len(planes), 1))
    tested = refined = needless = 0
    for _ in range(LEVELS):
        keep = np.ones(len(blocks), dtype=bool)
        for i in range(asked):
            keep &= test(planes[triangle, i], blocks)
        tested, refined = tested + len(blocks), refined + int(keep.sum())
        triangle, blocks = triangle[keep], blocks[keep]
        for first in range(0, len(blocks), PAIRS_AT_ONCE):
            chosen = slice(first, first + PAIRS_AT_ONCE)
            needless += int((~meets(view, planes[triangle[chosen], :3], blocks[chosen])).sum())
        triangle, blocks = np.tile(triangle, 4), quarters(blocks)
        if view.has_disc:
            nearest = np.clip(0, blocks[:, :2], blocks[:, 2:])
            there = (nearest * nearest).sum(axis=1) <= 1
            triangle, blocks = triangle[there], blocks[there]
    return tested, refined, needless


def main() -> int:
    parser = argparse.ArgumentParser(description="The share of blocks that are refined without need.")
    parser.add_argument("--triangles", type=int, default=100, help="for each angle [default: 100]")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    print(f"{'projection':<12}{'test':<15}{'angle':>6}{'tested':>10}{'refined':>10}{'not needed':>12}")
    for view in VIEWS:
        asked = [(name, test, 3) for name, test in view.tests.items()]
        for name, test, count in (*asked, (f"{asked[-1][0]} and w", asked[-1][1], 4)):
            rows = []
            for angle in ANGLES:
                rng = np.random.default_rng(arguments.seed)
                planes = random_planes(rng, arguments.triangles, angle, view.has_disc)
                rows.append(measure(view, test, planes, count))
            for angle, row in (*zip(map(str, ANGLES), rows, strict=True), ("all", tuple(map(sum, zip(*rows))))):
                tested, refined, needless = row
                share = needless / max(refined, 1)
                print(f"{view.name:<12}{name:<15}{angle:>6}{tested:>10,}{refined:>10,}{share:>11.1%}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
