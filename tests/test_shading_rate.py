"""Which samples msaa and csaa shade: once a surface, every sample, or as many as a colour's estimated error asks for.

The reference of rate auto takes what plain renders by moved cameras show at each sample, and sums it in float64: which
triangle belongs to which surface is known here, for triangles of one material each are surfaces by themselves.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import first_runtime, open_first_device
from kernel_world import make_scene, orthographic, render
from test_antialiasing import (
    CENTER,
    SIDE,
    U,
    colors_of,
    directions,
    draw_corner,
    edge_triangle,
    inside,
    moved_render,
    some_triangles,
    unlit,
)

import clrast
from clrast.opencl.constants import STRATA
from clrast.opencl.device import Device
from clrast.opencl.layout import NO_HIT
from clrast.shading.rounds import rounds_of
from clrast.visibility.sample_patterns import UNITS, Antialiasing, parse_antialiasing, scrambled

MODES = ("msaa:2", "msaa:4", "msaa:16", "msaa:32", "csaa:4+12", "csaa:1+7", "csaa:2+3")
ALL, FEW = "auto:1e-06", "auto:1"  # every surface that varies has too large an error; none has


def counts_of(mode: str) -> tuple[int, int]:
    """Samples that may be shaded, and all whose visibility is known."""
    wanted = parse_antialiasing("--aa", mode)
    return wanted.depth_count, len(wanted.pattern)


SHOWN: dict[tuple[str, bytes, int, int], tuple[np.ndarray, np.ndarray]] = {}


def shown(device: Device, scene: clrast.Scene, x: int, y: int) -> tuple[np.ndarray, np.ndarray]:
    """(SIDE, SIDE) prim_ids and (SIDE, SIDE, 4) colours by a camera moved so that centres are at (x, y) of pixels.

    Patterns begin alike: each place is rendered once for all.
    """
    key = device.runtime, np.asarray(scene.colors).tobytes(), x, y
    if key not in SHOWN:
        frame = moved_render(device, scene, x, y)
        SHOWN[key] = np.asarray(frame["id.prim"]), colors_of(frame).astype(np.float64)
    return SHOWN[key]


def first_shaded(most: int) -> int:
    """Of `most` samples those that are shaded before more are called for."""
    return max(1, most // 4)


def strata_of(center: int, prims: np.ndarray) -> list[int]:
    """The surface of each sample, in the order in which they are met; the last takes what has no room."""
    known = [center]
    for prim in prims:
        if prim not in known and len(known) < STRATA:
            known.append(prim)
    return [known.index(prim) if prim in known else STRATA - 1 for prim in prims]


def shaded_samples(strata: list[int], most: int) -> list[list[int]]:
    """Of each surface those that are shaded first, beside the centre: a quarter of `most`, and the first of each."""
    found: list[list[int]] = [[] for _ in range(STRATA)]
    for k, stratum in enumerate(strata):
        if k < first_shaded(most) or (stratum != 0 and not found[stratum]):
            found[stratum].append(k)
    return found


def expected_colors(device: Device, scene: clrast.Scene, mode: str, shades_all: bool) -> tuple[np.ndarray, np.ndarray]:
    """(SIDE, SIDE, 4) float64, and where pixels show more than one triangle.

    shades_all : all `most` samples of the surfaces of a quad where two of one surface are known to differ.
    """
    most, count = counts_of(mode)
    center_prims, centers = shown(device, scene, *CENTER)
    samples = [shown(device, scene, x, y) for x, y in scrambled(count).positions]
    prims, colors = (np.stack(each) for each in zip(*samples, strict=True))
    expected, edges = centers.copy(), (prims != center_prims).any(axis=0)
    varies = np.zeros((SIDE, SIDE), dtype=bool)
    strata = {at: strata_of(center_prims[at], prims[:, *at]) for at in np.ndindex(SIDE, SIDE)}
    shaded = {at: shaded_samples(strata[at], most) for at in strata}

    def known(at: tuple[int, int], stratum: int) -> np.ndarray:
        found = colors[shaded[at][stratum], *at]
        return np.concatenate([centers[at][None], found]) if stratum == 0 else found

    for at in strata:
        varies[at] = any((known(at, k) != known(at, k)[:1]).any() for k in set(strata[at]))
    for at in strata:
        corner = at[0] & ~1, at[1] & ~1
        if shades_all and varies[corner[0] : corner[0] + 2, corner[1] : corner[1] + 2].any():
            for k in range(first_shaded(most), most):
                if k not in shaded[at][strata[at][k]]:
                    shaded[at][strata[at][k]].append(k)
        if edges[at] or shades_all:
            expected[at] = sum(known(at, k).mean(axis=0) / count for k in strata[at])
    return expected, edges


def varied_triangles() -> clrast.Scene:
    """Triangles of one material each, whose corners have colours."""
    shades = np.random.default_rng(8).uniform(0.1, 1.0, size=(90, 3))
    colors = np.concatenate([shades, np.ones((90, 1))], axis=1).astype(np.float32)
    return replace(some_triangles(), colors=colors, materials=unlit(*[(1.0, 1.0, 1.0)] * 30))


def check_rate(device: Device, scene: clrast.Scene, mode: str, rate: str, error: float) -> np.ndarray:
    """Colours at rate FEW or ALL, held to the reference and to what may be shaded, of edge pixels or of all."""
    most, count = counts_of(mode)
    frame = render(device, scene, orthographic(SIDE, SIDE), aov=("color",), aa=mode, shading_rate=rate)
    expected, edges = expected_colors(device, scene, mode, shades_all=rate == ALL)
    np.testing.assert_allclose(colors_of(frame), expected, rtol=0, atol=error)
    counts, edge_count = frame.stats["other_counts"], np.count_nonzero(edges)
    if rate == FEW:
        assert counts["edge_pixels"] == edge_count > SIDE
    listed, each = (SIDE * SIDE, most) if rate == ALL else (edge_count, first_shaded(most))
    firsts = 0 if rate == ALL and count == most else STRATA - 1  # that are none of the samples shaded in any case
    assert counts["samples_shaded"] <= SIDE * SIDE + listed * (each + firsts)
    return colors_of(frame)


@pytest.mark.parametrize("rate", [FEW, ALL])
@pytest.mark.parametrize("mode", MODES)
def test_rate_auto_shades_a_quarter_or_all_of_each_surface(device: Device, mode: str, rate: str) -> None:
    """A quarter with an error that all may have, all S where surfaces vary with one that none may have."""
    check_rate(device, varied_triangles(), mode, rate, 16 * U)


def test_rate_auto_leaves_flat_colours_alone(device: Device) -> None:
    """Half of a triangle in one colour, half a ramp: a sample each there, beside the pixels at the ramp's foot."""
    xs, depth = (-1.0, SIDE / 2, 4.0 * SIDE), -1.0
    corners = [(x, y, depth) for x in xs for y in (1.0, -9.0 * SIDE)]
    shades = np.repeat([0.25, 0.25, 4.0], 2)[:, None] * np.array([1.0, 0.5, 0.25])
    colors = np.concatenate([shades, np.ones((6, 1))], axis=1).astype(np.float32)
    triangles = [(0, 1, 2), (2, 1, 3), (2, 3, 4), (4, 3, 5)]
    scene = make_scene(corners, triangles, colors=colors, materials=unlit((1.0, 1.0, 1.0)))
    plain = colors_of(render(device, scene, orthographic(SIDE, SIDE), aov=("color",)))
    frame = render(device, scene, orthographic(SIDE, SIDE), aov=("color",), aa="msaa:8", shading_rate=ALL)
    step = np.abs(np.diff(plain, axis=1)).max(axis=-1) > 0
    flat = ~np.pad(step, ((0, 0), (2, 0)))[:, :-1] & ~np.pad(step, ((0, 0), (0, 2)))[:, 1:]
    flat[:, :-2] &= flat[:, 2:]
    assert 0.1 < flat.mean() < 0.6
    np.testing.assert_array_equal(colors_of(frame)[flat], plain[flat])
    assert frame.stats["other_counts"]["edge_pixels"] <= np.count_nonzero(~flat)


def test_rates_show_the_same_where_triangles_have_one_colour(device: Device) -> None:
    scene, view = some_triangles(), orthographic(SIDE, SIDE)
    frames = [
        render(device, scene, view, aov=("color",), aa="csaa:8+8", shading_rate=rate) for rate in ("pixel", "sample")
    ]
    np.testing.assert_allclose(colors_of(frames[1]), colors_of(frames[0]), rtol=72 * U, atol=1e-9)


# --- coverage --------------------------------------------------------------------------------------


def check_coverage(device: Device, count: int) -> None:
    """A of half-planes: the samples inside over samples, in integers; ids stay those of the centres."""
    view, rng = orthographic(SIDE, SIDE), np.random.default_rng(6)
    for q, p in directions(count):
        corner = draw_corner(rng)
        scene = make_scene(edge_triangle(q, p, corner), materials=unlit((0.25, 0.5, 1.0)))
        for mode in MODES:
            frame = render(device, scene, view, aov=("color", "id"), aa=mode, shading_rate="auto")
            expected = inside(q, p, corner, scrambled(counts_of(mode)[1]).positions).mean(axis=2)
            np.testing.assert_allclose(frame["A"], expected, rtol=0, atol=4 * U, err_msg=f"{mode} {q, p, corner}")
            center = inside(q, p, corner, (CENTER,))[..., 0]
            np.testing.assert_array_equal(frame["id.prim"], np.where(center, 0, NO_HIT), err_msg=f"{mode}: ids")


def test_half_planes_cover_what_their_samples_say_at_rate_auto(device: Device) -> None:
    check_coverage(device, 3)


@pytest.mark.long
def test_half_planes_at_a_thousand_angles_at_rate_auto(device: Device) -> None:
    if device.runtime != first_runtime():
        pytest.skip("a thousand angles on the first runtime alone: others take a second for each")
    check_coverage(device, 1000)


# --- rounds ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", ["msaa:2", "msaa:8", "msaa:16", "msaa:32", "csaa:4+12", "csaa:1+2", "csaa:3+29"])
def test_rounds_of_rate_auto_shade_each_of_s_samples_once(mode: str) -> None:
    wanted = parse_antialiasing("--aa", mode)
    rounds = rounds_of(Antialiasing(wanted.kind, wanted.pattern, wanted.depth_count, 0.05))
    most, count = counts_of(mode)
    seen: list[int] = []
    shaded: list[int] = []
    for number in range(len(rounds.samples)):
        for visit in rounds.visits(number):
            samples = [16 * visit.number + k for k in range(16)]
            counted = [k for k in samples if visit.lanes >> (k - samples[0]) & 1]
            assert counted == [k for k in samples if k < count]
            seen += counted if visit.is_new else []
            shaded += [k for k in samples if visit.shaded >> (k - samples[0]) & 1]
        assert seen == list(range(count))
        assert shaded == list(range(first_shaded(most) if number == 0 else most))
    assert len(rounds.samples) == (1 if most == 1 else 2)
    assert rounds.threshold_of(len(rounds.samples) - 1) == np.inf and rounds.edge_error(0) == 0.0


@pytest.mark.parametrize(("mode", "count"), [("msaa:2", 2), ("csaa:4+8", 12), ("msaa:32", 32 + 16)])
def test_samples_that_do_not_count_take_no_pass(mode: str, count: int) -> None:
    """Where each sample takes one: those of the pattern, and a second visit's once more for the list."""
    device = open_first_device()
    given = {"aov": ("color",), "method": "3dr-full", "aa": mode, "shading_rate": FEW}
    counts = render(device, some_triangles(), orthographic(SIDE, SIDE), **given).stats["counts"]
    assert counts["passes"] == 1 + count
    assert counts["samples"] == counts["passes"] * SIDE * SIDE


def test_lanes_beyond_a_pattern_decide_nothing() -> None:
    """A triangle that none of 2 samples shows, but samples of the same visit do, is not seen."""
    device = open_first_device()
    two, others = scrambled(2).positions, scrambled(16).positions[2:]
    x, y = others[0]
    sizes = [max(abs(x - u), abs(y - v)) for u, v in (*two, CENTER)]
    half = 0.9 * min(sizes) / UNITS
    at = np.array([x, y]) / UNITS + 5
    corners = [(at[0] - half, -at[1] - half, -1.0), (at[0] + half, -at[1] - half, -1.0), (at[0], -at[1] + half, -1.0)]
    scene = make_scene(corners, materials=unlit((1.0, 1.0, 1.0)))
    for mode, is_seen in (("msaa:2", False), ("msaa:16", True)):
        frame = render(device, scene, orthographic(SIDE, SIDE), aov=("color",), aa=mode, shading_rate="auto")
        assert (frame["A"] > 0).any() == is_seen
        assert frame.stats["other_counts"]["edge_pixels"] == is_seen
