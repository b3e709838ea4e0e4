"""Incremental evaluation under the paraboloid: its steps in real arithmetic, its bits, its error, its images."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from curved_probe import CurvedProbe
from curved_reference import exact_image, rays_of
from curved_world import CURVED, aimed_sheet, ball, box, curved_view, soup_in_box
from incremental_twin import exact_values, fractions, radius_of, summed_values
from kernel_world import NO_HIT, make_scene, render

from clrast.errors import UsageError
from clrast.opencl import buffers, kernels
from clrast.opencl.constants import EVALUATION_INCREMENTAL, INCREMENT_CELL, INCREMENT_CURVED_SLACK
from clrast.opencl.device import Device
from clrast.opencl.features import Features, Projection
from clrast.options import METHODS_OF_ANY_VIEW, RenderOptions
from clrast.scene.camera import CameraVectors
from clrast.visibility.view import build_view

SIZES = ((64, 64), (121, 98), (40, 300), (200, 7))
AXES = {"eye": (0, 0, 0), "look_at": (0, 0, -1), "up": (0, 1, 0)}


def samples_of(view: CameraVectors, count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normals of all sizes and pixels in the disc, at random."""
    rng = np.random.default_rng(seed)
    normals = (rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(-6, 6, (count, 1))).astype(np.float32)
    normals[: count // 8] = rng.integers(-3, 4, (count // 8, 3))
    column, row = np.meshgrid(np.arange(view.width), np.arange(view.height))
    x, y = column + 0.5 - view.width / 2, row + 0.5 - view.height / 2
    inside = np.flatnonzero((x * x + y * y <= radius_of(view) ** 2).ravel())
    chosen = rng.choice(inside, count)
    return normals, column.ravel()[chosen], row.ravel()[chosen]


# --- sums ------------------------------------------------------------------------------------------


def test_steps_lead_to_the_value_in_real_arithmetic() -> None:
    """From any aligned square's first sample to any sample of it, whatever the size of the disc."""
    for seed, size in enumerate(SIZES):
        view = curved_view("paraboloid", *size)
        normals, columns, rows = samples_of(view, 60, seed)
        found = summed_values(view, normals, columns, rows, fractions)
        assert (found == exact_values(view, normals, columns, rows)).all()


def test_steps_as_the_paper_prints_them_do_not() -> None:
    """Equation (3) on the disc of radius 1, with steps of (3, -2)/8: its own d tells another value; ours that one."""
    n = fractions(np.array([5.0, -3.0, 2.0]))
    x, y, dx, dy = fractions(np.array([0.25, -0.5, 0.375, -0.25]))

    def value(x: object, y: object) -> object:
        return n @ np.array([x, y, (1 - x * x - y * y) / 2])

    vx, vy, right = n[0] - n[2] * x, n[1] - n[2] * y, value(x + dx, y + dy)
    printed = value(x, y) + value(dx, dy) - n[2] / 2 + dx * (vx - n[2]) + dy * (vy - n[2])
    assert value(x, y) + dx * vx + dy * vy - n[2] * (dx * dx + dy * dy) / 2 == right != printed
    assert (vx - n[2] * dx, vy - n[2] * dy) == (n[0] - n[2] * (x + dx), n[1] - n[2] * (y + dy))
    assert vx - n[0] * dx != n[0] - n[2] * (x + dx)


class Probe(CurvedProbe):
    """tests/incremental_probe.cl on one device."""

    def __init__(self, device: Device, folder: Path) -> None:
        for path in [*kernels.kernel_folder().glob("*.clh"), Path(__file__).with_name("incremental_probe.cl")]:
            shutil.copy(path, folder)
        self.device = device
        features = Features(device.vector_width, projection=Projection.PARABOLOID, evaluation=EVALUATION_INCREMENTAL)
        self.program = kernels.build(device, "incremental_probe.cl", features, folder)

    def sums(self, view: CameraVectors, normals: np.ndarray, columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
        count = len(normals)
        padded = -(-count // self.device.vector_width) * self.device.vector_width
        given = {"normals": normals.T.astype(np.float32), "places": np.stack([columns, rows]).astype(np.int32)}
        sent = {
            name: buffers.upload(self.device, np.pad(values, ((0, 0), (0, padded - count)), "edge"))
            for name, values in given.items()
        }
        made = buffers.create(self.device, 4 * padded)
        built = build_view(view, np.zeros(3), np.ones(3), 5)
        items = padded // self.device.vector_width
        self.program.launch("probe_sums", items, 1, view=built, count=padded, values=made, **sent)
        return buffers.download(self.device, made, np.float32, (padded,))[:count]


@pytest.mark.small
def test_the_device_makes_these_steps(device: Device, tmp_path: Path) -> None:
    """Bit for bit; and no value is farther from n . d than cl/incremental_edges.clh derives."""
    probe = Probe(device, tmp_path)
    for seed, size in enumerate(SIZES):
        view = curved_view("paraboloid", *size)
        normals, columns, rows = samples_of(view, 256, 10 + seed)
        found = probe.sums(view, normals, columns, rows)
        assert (found.view(np.uint32) == summed_values(view, normals, columns, rows).view(np.uint32)).all()
        right = exact_values(view, normals, columns, rows)
        errors = abs(fractions(found) - right).astype(np.float64)
        reach = 1 + INCREMENT_CELL / radius_of(view)
        bound = INCREMENT_CURVED_SLACK * reach**2 * np.linalg.norm(normals.astype(np.float64), axis=1)
        assert (errors <= bound).all() and errors.any()


# --- images ----------------------------------------------------------------------------------------


def pyramid() -> np.ndarray:
    """Four triangles round the axis of view: the rays of both diagonals lie in their edges, V = 0."""
    corners = [(3, 3, -2), (-3, 3, -2), (-3, -3, -2), (3, -3, -2)]
    rim = [(9, 9, 1), (-9, 9, 1), (-9, -9, 1), (9, -9, 1)]
    triangles = []
    for k in range(4):
        a, b, c, d = corners[k], corners[(k + 1) % 4], rim[k], rim[(k + 1) % 4]
        triangles += [((0, 0, -4), a, b), (a, c, b), (b, c, d)]
    return np.array(triangles, dtype=np.float64)


def test_short_numbers_are_summed_up_exactly(device: Device) -> None:
    """A disc of radius 2^5 and small integers: no step rounds, so each sample is right, the 64 on edges too."""
    view = curved_view("paraboloid", 64, 64, **AXES)
    scene = make_scene(pyramid())
    frame = render(device, scene, view, aov="id,ray", evaluation="incremental")
    d, tx, ty = rays_of(frame.channels)
    right, _, _, asked = exact_image(scene.positions, scene.triangles, np.zeros(3), d, tx, ty)
    assert asked >= 64 and (right != NO_HIT).sum() == d.any(axis=-1).sum()
    assert (frame["id.prim"] == right).all()


def summed(device: Device, scene: object, view: CameraVectors, **options: object) -> np.ndarray:
    return render(device, scene, view, aov="id", evaluation="incremental", **options)["id.prim"]


def test_an_image_is_what_its_sums_say(device: Device) -> None:
    """A triangle covers the samples where three sums are positive: by the twin, all over a wide image, rim or not."""
    view = curved_view("paraboloid", 150, 100, **AXES)
    corners = np.array([(11, -7, -3), (-13, 5, -6), (2, 9, -1)], dtype=np.float64)
    ends = [(corners[(i + 2) % 3], corners[(i + 1) % 3]) for i in range(3)]
    normals = np.array([np.cross(a + b, b - a) for a, b in ends])  # short: exact in float32
    normals *= np.sign(normals[0] @ corners[0])
    column, row = np.meshgrid(np.arange(view.width), np.arange(view.height))
    values = [summed_values(view, np.broadcast_to(n, (*column.shape, 3)), column, row) for n in normals]
    inside = (column + 0.5 - 75) ** 2 + (row + 0.5 - 50) ** 2 <= 2500
    expected = (np.min(values, axis=0) > 0) & inside
    assert 500 < expected.sum() < 5000 and np.min(np.abs(values)) > 0
    found = summed(device, make_scene(corners), view) != NO_HIT
    assert (found == expected).all()


def test_midpoint_is_right_and_closed_meshes_are_hit_once(device: Device) -> None:
    """At most one sample of 20,000 is wrong, no sample is missed and none hit twice."""
    view = curved_view("paraboloid", 121, 98)
    wrong = samples = 0
    scenes = {"ball": ball(2), "box": make_scene(*box()), "soup": soup_in_box()}
    for name, scene in scenes.items():
        frame = render(
            device, scene, view, aov="id,ray", evaluation="incremental", method="raycast-brute", counters=True
        )
        d, tx, ty = rays_of(frame.channels)
        right = exact_image(scene.positions, scene.triangles, np.array(view.origin), d, tx, ty)[0]
        count = int(d.any(axis=-1).sum())
        assert ((frame["id.prim"] != NO_HIT) == d.any(axis=-1)).all()
        assert (frame["id.prim"] == summed(device, scene, view)).all()  # another method's, with tiles
        if name != "soup":
            assert frame.stats["other_counts"]["samples_covered"] == count
        wrong, samples = wrong + int((frame["id.prim"] != right).sum()), samples + count
    assert wrong * 20_000 <= samples


def check_methods(device: Device, methods: tuple[str, ...], **options: object) -> None:
    for size in ((121, 98), (70, 9)):
        view = curved_view("paraboloid", *size)
        for scene in (soup_in_box(), ball(2), aimed_sheet(view)):
            right = summed(device, scene, view, **options)
            for method in methods:
                assert (summed(device, scene, view, method=method, **options) == right).all(), method


def test_methods_agree(first_device: Device) -> None:
    """Tiles and frusta; all methods in all rungs with --long."""
    check_methods(first_device, ("3dr-full",))


@pytest.mark.long
@pytest.mark.parametrize("precision", ["fast", "ordered", "midpoint", "double", "exact"])
def test_all_methods_agree(device: Device, precision: str) -> None:
    if precision == "double" and not device.has_fp64:
        pytest.skip(f"{device.runtime} has no float64")
    check_methods(device, METHODS_OF_ANY_VIEW, precision=precision)
    if device.runtime == "pocl":
        view = curved_view("paraboloid", 121, 98)
        for scene in (soup_in_box(), aimed_sheet(view)):
            right = summed(device, scene, view, precision=precision)
            for width in (1, 8):
                assert (summed(device, scene, view, precision=precision, vector_width=width) == right).all()


def check_exact(device: Device, size: tuple[int, int]) -> None:
    """No wrong sample within rounding of corners and edges, where sums have many; nor at edges of short numbers."""
    view = curved_view("paraboloid", *size)
    scene = aimed_sheet(view)
    frame = render(device, scene, view, aov="id,ray", evaluation="incremental", precision="exact")
    right = exact_image(scene.positions, scene.triangles, np.array(view.origin), *rays_of(frame.channels))[0]
    assert (frame["id.prim"] == right).all()
    assert (summed(device, scene, view) != right).any()


def test_exact_is_right(first_device: Device) -> None:
    check_exact(first_device, (61, 50))


@pytest.mark.long
@pytest.mark.parametrize("size", [(121, 98), (40, 70), (33, 20)])
def test_exact_is_right_everywhere(device: Device, size: tuple[int, int]) -> None:
    check_exact(device, size)


def test_what_is_no_polynomial_refuses() -> None:
    options = RenderOptions(size=(6, 6), evaluation="incremental")
    for projection in CURVED:
        if projection == "paraboloid":
            options.check_projection(projection)
            continue
        with pytest.raises(UsageError, match=f"polynomials, and {projection} has sines and cosines: use direct"):
            options.check_projection(projection)
    options.check_projection("cube")  # its faces are planar
