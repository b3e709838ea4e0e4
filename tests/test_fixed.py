"""--precision fixed against integers in Python: snapped vertices, clipped lines and the fill rule, sample by sample.

The reference projects in numpy float32 as cl/snapped_edges.clh says, then leaves floats: V = (b - a) x (s - a) of
Python integers in subpixels, every sample of the image, no bound, no tile, no block. Facing is exact:
the area of the snapped
snapped triangle, or the rational determinant of the vertices where one lies outside the guard band.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
import pytest
from edge_worlds import blob, crossing, edge_on, sheet, thin, view_of
from kernel_world import NO_HIT, coverage, make_scene, orthographic, perspective, render, render_ids

from clrast.errors import UsageError
from clrast.opencl.device import Device
from clrast.options import make_options
from clrast.scene.camera import CameraVectors
from clrast.scene.model import Scene
from clrast.study.double_hits import hit_counts

SUBPIXELS = 4096
f32 = np.float32


def cross(a, b) -> list:
    return [a[k - 2] * b[k - 1] - a[k - 1] * b[k - 2] for k in range(3)]


def dot(a, b):
    return (a[0] * b[0] + a[1] * b[1]) + a[2] * b[2]


class Screen:
    """A view as the kernel has it: float32 origin (a sum of two where parallel) and inverse axes."""

    def __init__(self, view: CameraVectors) -> None:
        self.is_perspective = view.projection == "perspective"
        self.width, self.height = view.width, view.height
        self.guard = f32(view.width + view.height)
        tx, ty, first = ([Fraction(c) for c in v] for v in (view.tangent_x, view.tangent_y, view.first))
        center = [f + Fraction(view.width, 2) * x + Fraction(view.height, 2) * y for f, x, y in zip(first, tx, ty)]
        axis = center if self.is_perspective else [Fraction(c) for c in view.direction]
        self.exact_origin = [Fraction(c) for c in view.origin] if self.is_perspective else center
        determinant = dot(tx, cross(ty, axis))
        self.exact_inverse = [[c / determinant for c in cross(*pair)] for pair in ((ty, axis), (axis, tx), (tx, ty))]
        self.inverse = [[f32(float(c)) for c in row] for row in self.exact_inverse]
        self.origin = [f32(float(c)) for c in self.exact_origin]
        self.rest = [f32(float(c - Fraction(float(o)))) for c, o in zip(self.exact_origin, self.origin)]

    def transform(self, p: np.ndarray) -> list:
        """(X depth, Y depth, depth) in float32; X and Y themselves where rays are parallel."""
        r = [f32(c) - o for c, o in zip(p, self.origin)]
        if not self.is_perspective:
            r = [c - o for c, o in zip(r, self.rest)]
        return [dot(r, row) for row in self.inverse]

    def facing(self, corners: np.ndarray) -> int:
        """Sign of the screen's area, from rational numbers."""
        points = [[Fraction(float(c)) - o for c, o in zip(p, self.exact_origin)] for p in corners]
        h = [[dot(r, row) for row in self.exact_inverse] for r in points]
        if not self.is_perspective:
            h = [[x, y, 1] for x, y, _ in h]
        value = dot(h[0], cross(h[1], h[2]))
        return (value > 0) - (value < 0)


def snap(pixels: np.float32) -> int:
    """To the nearest subpixel, ties to even."""
    return round(Fraction(float(pixels)) * SUBPIXELS)


@dataclass
class Vertex:
    h: list
    p: list  # X, Y
    in_front: bool
    within: bool


def vertex(screen: Screen, corner: np.ndarray) -> Vertex:
    with np.errstate(all="ignore"):
        h = screen.transform(corner)
        p = [h[0] / h[2], h[1] / h[2]] if screen.is_perspective else h[:2]
    in_front = not screen.is_perspective or bool(h[2] > 0)
    return Vertex(h, p, in_front, in_front and all(abs(c) <= screen.guard for c in p))


def line(screen: Screen, a: Vertex, b: Vertex):
    """Two points of the edge's line, or the sign of one that has no line in the guard band, or None where hidden."""
    if not (a.in_front or b.in_front):
        return None
    if a.within and b.within:
        return [snap(c) for c in a.p], [snap(c) for c in b.p]
    if screen.is_perspective:
        way = [b.h[k] * a.h[2] - a.h[k] * b.h[2] for k in (0, 1)]
    else:
        way = [b.p[k] - a.p[k] for k in (0, 1)]
    size = max(abs(way[0]), abs(way[1]))
    if not size > 0:
        return -1
    u = [c / size for c in way]
    step = [snap(c * (f32(2) * screen.guard)) for c in u]
    if a.within or b.within:
        start = [snap(c) for c in (a if a.within else b).p]
    else:
        offset = (a.h[0] * b.h[1] - a.h[1] * b.h[0]) / size
        middle = offset / (u[0] * u[0] + u[1] * u[1])
        nearest = [middle * u[1], -(middle * u[0])]
        if not all(abs(c) <= screen.guard for c in nearest):
            return 1 if offset > 0 else -1
        start = [snap(c) for c in nearest]
    return start, [start[k] + step[k] for k in (0, 1)]


def expected(screen: Screen, corners: np.ndarray) -> np.ndarray:
    """(height, width) bool: samples of one triangle."""
    v = [vertex(screen, corner) for corner in corners]
    covered = np.zeros((screen.height, screen.width), dtype=bool)
    lines = [line(screen, v[(i + 1) % 3], v[(i + 2) % 3]) for i in range(3)]
    if all(one.within for one in v):
        (ax, ay), (bx, by), (cx, cy) = ([snap(c) for c in one.p] for one in v)
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        facing = (area > 0) - (area < 0)
    else:
        facing = screen.facing(corners)
    if facing == 0 or not any(one.in_front for one in v):
        return covered
    for row in range(screen.height):
        for column in range(screen.width):
            s = [(2 * k + 1 - side) * SUBPIXELS // 2 for k, side in ((column, screen.width), (row, screen.height))]
            covered[row, column] = all(is_inside(one, facing, s) for one in lines)
    return covered


def is_inside(one, facing: int, s: list[int]) -> bool:
    if one is None or isinstance(one, int):
        return one is None or one * facing > 0
    (ax, ay), (bx, by) = one
    # The sample moved by (eps, eps^2): first V, then its change to the right, then downwards.
    for value in ((bx - ax) * (s[1] - ay) - (by - ay) * (s[0] - ax), ay - by, bx - ax):
        if value:
            return value * facing > 0
    return False


def in_front(view: CameraVectors, corners: np.ndarray) -> np.ndarray:
    """Triangles that no ray meets before its origin."""
    screen = Screen(view)
    return np.array([one for one in corners if all(screen.transform(p)[2] > 0 for p in one)])


def needles(seed: int, count: int) -> np.ndarray:
    """(count, 3, 3) float32: long triangles, the widest first: about a pixel, the last ones a few subpixels."""
    rng, corners = np.random.default_rng(seed), blob(seed, count, 0.7).astype(np.float64)
    width = -np.sort(-(10.0 ** rng.uniform(-4, -1, size=(count, 1))), axis=0)
    corners[:, 2] = corners[:, 1] + width * rng.normal(size=(count, 3))
    return corners.astype(np.float32)


CASES = {
    "small": lambda view: in_front(view, blob(1, 24, 0.2)),
    "beyond the guard band": lambda view: in_front(view, blob(2, 60, 2.5))[:16],
    "slivers": lambda view: in_front(view, needles(2, 24)),
    "thinner than a subpixel": lambda view: in_front(view, thin(2, 24)),
    "edge-on": lambda view: in_front(view, edge_on(view, 2, 24)),
    "one vertex behind": lambda view: crossing(view, 3, 14, 1),
    "two vertices behind": lambda view: crossing(view, 3, 14, 2),
    "all vertices behind": lambda view: crossing(view, 3, 3, 3),
}


# Parallel rays have no eye's plane to cross.
WORLDS = [(p, c) for p in ("perspective", "orthographic") for c in CASES if p == "perspective" or "behind" not in c]
MAY_HIT_NOTHING = ("thinner than a subpixel", "edge-on", "all vertices behind")


@pytest.mark.parametrize(
    ("method", "count"), [("2dr-binning", 5), pytest.param("2dr-brute", 24, marks=pytest.mark.long)]
)
@pytest.mark.parametrize(("projection", "case"), WORLDS)
def test_every_sample_is_that_of_the_integers(
    device: Device, projection: str, case: str, method: str, count: int
) -> None:
    view = view_of(projection, 33, 24)
    corners = CASES[case](view)[:count]
    screen = Screen(view)
    right = np.stack([expected(screen, one) for one in corners])
    found = coverage(device, make_scene(corners), view, method=method, precision="fixed")
    wrong = np.argwhere(found != right)
    assert len(wrong) == 0, f"{len(wrong)} samples, first triangle, row, column {wrong[0]}"
    assert right.any() or case in MAY_HIT_NOTHING


def sides_of_a_fan(view: CameraVectors, count: int) -> Scene:
    """Triangles round a point that is a sample, or close to one; together they cover the view, its corners beyond the
    guard band."""
    k = np.arange(count) * 2 * np.pi / count
    far = np.stack([40 * np.cos(k), 40 * np.sin(k), np.full(count, -2.0)], axis=1)
    center = [0.5 * 2.0**-4, -0.5 * 2.0**-4, -2.0]
    triangles = [(0, 1 + i, 1 + (i + 1) % count) for i in range(count)]
    return make_scene(np.concatenate([[center], far]), triangles)


@pytest.mark.parametrize("method", ["2dr-binning", pytest.param("2dr-brute", marks=pytest.mark.long)])
def test_each_sample_of_a_fan_and_of_a_grid_has_one_triangle(device: Device, method: str) -> None:
    """At vertices, too: coordinates are integers there as everywhere."""
    view = view_of("perspective", 6, 6)
    flat = perspective(16, 16)
    parallel = view_of("orthographic", 6, 6)
    for scene, seen_from in (
        (sides_of_a_fan(flat, 23), flat), (sides_of_a_fan(flat, 8), flat),
        (sheet(view), view), (sheet(parallel), parallel),
    ):  # fmt: skip

        def part(chosen: np.ndarray, scene: Scene = scene, seen_from: CameraVectors = seen_from) -> np.ndarray:
            one = replace(scene, triangles=scene.triangles[chosen])
            return render_ids(device, one, seen_from, method=method, precision="fixed")

        assert (hit_counts(part, scene.triangle_count) == 1).all()


def test_lanes_tiles_evaluation_and_methods_change_nothing(device: Device) -> None:
    view = view_of("perspective", 70, 45)
    scene = make_scene(np.concatenate([blob(5, 60), blob(6, 20, 2.5), crossing(view, 7, 6, 1)]))
    plain = render(device, scene, view, aov=("id", "depth"), method="2dr-binning", precision="fixed")
    assert (plain["id.prim"] != NO_HIT).mean() > 0.5
    for given in (
        {"method": "2dr-brute"}, {"vector_width": 1}, {"vector_width": 8}, {"evaluation": "incremental"},
        {"method": "auto"},
    ):  # fmt: skip
        options = {"method": "2dr-binning", **given}
        found = render(device, scene, view, aov=("id", "depth"), precision="fixed", **options)
        for name in plain:
            np.testing.assert_array_equal(found[name], plain[name], err_msg=f"{given} {name}")


def test_a_vertex_moves_by_half_a_subpixel_and_no_more(device: Device) -> None:
    """A sample on the left edge is inside; 1/8192 pixel to the right of it the edge snaps back, ties to even."""
    view = orthographic(8, 8, e0=(-4, 4, 1))
    for quarters, is_hit in ((0, True), (1, True), (2, True), (3, False), (4, False), (-3, True)):
        left = 0.5 + quarters / (4 * SUBPIXELS)
        corners = np.array([(left, -3, 0), (3, -3, 0), (left, 3, 0)], dtype=np.float32)
        ids = render_ids(device, make_scene(corners), view, method="2dr-binning", precision="fixed")
        assert (ids[5, 4] != NO_HIT) == is_hit, quarters
        assert ids[5, 3] == NO_HIT and ids[5, 5] != NO_HIT


@pytest.mark.parametrize("method", ["2dh-brute", "2dh-binning", "3dr-brute", "3dr-binning", "3dr-full", "raycast-bvh"])
def test_other_methods_refuse_it_and_say_what_to_use(method: str) -> None:
    with pytest.raises(UsageError, match="use --method 2dr-brute or 2dr-binning, or another rung"):
        make_options({"precision": "fixed", "method": method})
