"""The float32 filter's bounds against rational arithmetic: edges, nearness, facing; and whether they are of use."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from bound_probe import BoundProbe, Exact, Found, exact_values
from edge_worlds import blob, edge_on, thin, view_of
from kernel_world import make_scene, orthographic, perspective, start

from clrast.opencl.device import Device
from clrast.scene.camera import CameraVectors, camera_vectors
from clrast.scene.model import Camera

COUNT = 96
"""Triangles of a kind."""
BOUND_CEILING = 2.0**100
"""A larger E leaves all samples open, as cl/error_bounds.clh says."""
PROJECTIONS = ["perspective", "orthographic"]


def short_view(projection: str) -> CameraVectors:
    """A view of short binary numbers round the axis -z."""
    step = 2.0**-5
    if projection == "perspective":
        return perspective(48, 40)
    return orthographic(48, 40, e0=(-24 * step, 20 * step, 0), ex=(step, 0, 0), ey=(0, -step, 0))


def kinds(projection: str, seed: int, count: int = COUNT) -> Mapping[str, tuple[CameraVectors, np.ndarray]]:
    """Name -> a view and triangles (count, 3, 3) float32 in world space."""
    rng = np.random.default_rng(seed)
    oblique, axial = view_of(projection), short_view(projection)
    eye = np.array(oblique.origin)
    far = (3000.0, -2000.0, 1000.0)
    grid = rng.integers(-3, 4, size=(count, 3, 3)).astype(float)
    grid[:, :, 2] = rng.choice([-2.0, -4.0], size=(count, 1))
    sizes = 10.0 ** rng.uniform(-6, 4, size=(count, 1, 1))
    exponents = 10.0 ** rng.uniform(-30, 12, size=(count, 3, 3))
    made = {
        "ordinary": (oblique, blob(seed, count)),
        "small": (oblique, blob(seed + 1, count, 1e-3)),
        "slivers": (oblique, thin(seed + 2, count)),
        "any size": (oblique, rng.normal(size=(count, 3, 3)) * sizes),
        "any exponent": (axial, rng.normal(size=(count, 3, 3)) * exponents),
        "small, far from the origin": (view_of(projection, far=far), blob(seed + 3, count, 1e-2, far)),
        "round the eye": (oblique, blob(seed + 4, count, 2.0, tuple(eye.tolist()))),
        "seen edge-on": (oblique, edge_on(oblique, seed + 5, count)),
        "axis-aligned": (axial, grid),
        "corner at the eye": (axial, rng.normal(size=(count, 3, 3)) * np.array([[1.0], [1.0], [0.0]])),
        "huge": (axial, rng.normal(size=(count, 3, 3)) * 1e37),
        "tiny": (axial, rng.normal(size=(count, 3, 3)) * 1e-33),
        "denormal": (axial, rng.normal(size=(count, 3, 3)) * 1e-39),
        "tiny beside ordinary": (axial, np.where(rng.random((count, 1, 1)) < 0.5, 1.0, 1e-36) * grid / 7),
        "vertices on rays": (axial, on_rays(rng, count, projection)),
    }
    return {name: (view, corners.astype(np.float32)) for name, (view, corners) in made.items()}


def on_rays(rng: np.random.Generator, count: int, projection: str) -> np.ndarray:
    """Corners that `short_view` has exactly at pixel centres, with all bits of their mantissas in use."""
    flat = (rng.integers(-24, 24, size=(count, 3, 2)) + 0.5) / 32
    depth = np.round(rng.uniform(0.5, 4, size=(count, 3, 1)) * 2**17) / 2**17
    return np.concatenate([flat * depth if projection == "perspective" else flat, -depth], axis=2)


# --- right -----------------------------------------------------------------------------------------


def edge_ratios(found: Found, exact: Exact) -> np.ndarray:
    """Errors of V as a part of E, of triangles whose E counts."""
    to_scaled = Fraction(found.scale) ** 2 * exact.value_unit
    ratios = []
    for k in np.flatnonzero(found.error < BOUND_CEILING):
        turn = -1 if found.volume[k] > 0 else 1
        bound = Fraction(float(found.error[k]))
        computed = found.values[k].ravel().tolist()
        for value, right in zip(computed, exact.values[k].ravel().tolist(), strict=True):
            ratios.append(float(abs(Fraction(value) - turn * right * to_scaled) / bound))
    return np.array(ratios)


def nearness_faults(view: CameraVectors, found: Found, exact: Exact) -> tuple[list[str], int]:
    """Samples at t > 0 whose nearness is outside its interval, and how many have a bounded one."""
    is_perspective = view.projection == "perspective"
    scale = 1 / Fraction(found.scale) if is_perspective else Fraction(found.scale)
    faults, bounded_count = [], 0
    for k in np.flatnonzero(~found.facing_unsure):
        for n, right in enumerate(exact.nearness[k]):
            lower, upper = float(found.lower[k, n]), float(found.upper[k, n])
            if right is None or (right <= 0) == is_perspective or not np.isfinite([lower, upper]).all():
                continue
            bounded_count += 1
            value = right * scale
            if not Fraction(lower) <= value <= Fraction(upper):
                faults.append(f"{found.corners[k].tolist()} at {found.at[k, n]}: {float(value)} {lower} {upper}")
    return faults, bounded_count


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_bounds_hold_for_triangles_of_every_kind(device: Device, tmp_path: Path, projection: str) -> None:
    """V within E, nearness in its interval, the facing known for sure only where it is right."""
    probe = BoundProbe(device, tmp_path, projection)
    wrong, sure_count, lines = [], 0, []
    for name, (view, corners) in kinds(projection, 1).items():
        found = probe.look(view, corners)
        exact = exact_values(view, found)
        ratios = edge_ratios(found, exact)
        faults, bounded_count = nearness_faults(view, found, exact)
        sure = ~found.facing_unsure
        sign = np.array([(v > 0) - (v < 0) for v in exact.volume])
        turned = np.count_nonzero(sure & (np.sign(found.volume) != sign))
        if ratios.max(initial=0) > 1 or faults or turned:
            wrong.append(f"{name}: error {ratios.max(initial=0)} of E, {turned} facings, nearness {faults[:1]}")
        sure_count += int(sure.sum())
        useful = f"{1 / np.median(ratios[ratios > 0]):.0f}" if (ratios > 0).any() else "-"
        lines.append(f"{name}: E is {useful} errors, {sure.mean():.0%} facings sure, {bounded_count} nearness bounds")
    print("\n".join(lines))
    assert not wrong, "\n".join(wrong)
    assert sure_count > 4 * COUNT, "nearly nothing is sure: the test tests nothing"


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_a_bound_that_is_too_small_is_found_out(device: Device, tmp_path: Path, projection: str) -> None:
    probe = BoundProbe(device, tmp_path, projection, ("(13.0f * UNIT)", "(0.5f * UNIT)"))
    worst = 0.0
    for name in ("ordinary", "seen edge-on", "any size"):
        view, corners = kinds(projection, 1)[name]
        found = probe.look(view, corners)
        worst = max(worst, edge_ratios(found, exact_values(view, found)).max())
    assert worst > 1


@pytest.mark.long
@pytest.mark.parametrize("projection", PROJECTIONS)
@pytest.mark.parametrize("seed", range(2, 6))
def test_bounds_hold_for_many_triangles(device: Device, tmp_path: Path, projection: str, seed: int) -> None:
    probe = BoundProbe(device, tmp_path, projection)
    for name, (view, corners) in kinds(projection, 20 * seed, 1000).items():
        found = probe.look(view, corners, seed)
        exact = exact_values(view, found)
        assert edge_ratios(found, exact).max(initial=0) <= 1, name
        assert nearness_faults(view, found, exact)[0] == [], name
        sign = np.array([(v > 0) - (v < 0) for v in exact.volume])
        assert (found.facing_unsure | (np.sign(found.volume) == sign)).all(), name


# --- of use ----------------------------------------------------------------------------------------


def lumpy_ball(across: int) -> tuple[np.ndarray, np.ndarray]:
    """A closed mesh of 2 across^2 triangles, with bumps and jitter as a scanned surface has them."""
    rng = np.random.default_rng(7)
    i, j = np.meshgrid(np.arange(across), np.arange(across + 1))
    longitude, latitude = 2 * np.pi * i / across, np.pi * (j / across - 0.5)
    reach = 1 + 0.1 * np.sin(5 * longitude) * np.cos(7 * latitude) + rng.normal(size=i.shape) * 0.002
    flat = reach * np.cos(latitude)
    points = np.stack([flat * np.cos(longitude), reach * np.sin(latitude), flat * np.sin(longitude)], axis=2)
    right, above = (i + 1) % across, j + 1
    inner = j < across
    a, b = j * across + i, j * across + right
    c, d = above * across + right, above * across + i
    triangles = np.stack([np.stack([a, d, b], 2), np.stack([b, d, c], 2)], 2)[inner].reshape(-1, 3)
    return points.reshape(-1, 3), triangles


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_few_samples_of_a_mesh_are_left_open(device: Device, projection: str) -> None:
    """Under 2 % of the samples of a mesh whose triangles are a few pixels large."""
    points, triangles = lumpy_ball(64)
    side = 256
    camera = Camera("oblique", projection, (1.3, 0.7, 3.1), (0.1, -0.2, 0.05), (0.1, 1.0, 0.2), 45.0, 2.6)
    job, frame = start(
        device, make_scene(points, triangles), camera_vectors(camera, side, side), aov="id", precision="exact"
    )
    assert (frame["id.prim"] != 0xFFFFFFFF).mean() > 0.3
    assert job.contenders is not None
    counts = job.contenders.counts
    left_open = counts["decided_float64"] + counts["contenders"]
    print(f"{left_open / side**2:.3%} of {side**2} samples left open, {counts}")
    assert 0 < left_open < 0.02 * side**2
