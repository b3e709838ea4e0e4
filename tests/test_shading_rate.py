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
CROWD = STRATA - 1
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
    key = device.runtime, scene.positions.tobytes() + np.asarray(scene.colors).tobytes(), x, y
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
        if prim not in known and len(known) < CROWD:
            known.append(prim)
    return [known.index(prim) if prim in known else CROWD for prim in prims]


def shaded_samples(strata: list[int], most: int, error: float) -> list[list[int]]:
    """Of each surface those that are shaded first, beside the centre, and of the crowd all.

    A quarter of `most`; of each surface one, and two of `most` of those whose share of the pixel times half a quarter
    is larger than `error`.
    """
    found: list[list[int]] = [[] for _ in range(STRATA)]
    covered, lone = [0] * STRATA, len(strata) * error / (0.5 * 0.25)
    for first in range(0, len(strata), 16):
        met = strata[first : first + 16]
        for stratum in dict.fromkeys(met):
            own = [first + k for k, other in enumerate(met) if other == stratum]
            covered[stratum] += len(own)
            found[stratum] += [k for k in own if k < first_shaded(most) or stratum == CROWD]
            for k in own:
                known = len(found[stratum]) + (stratum == 0)
                if k not in found[stratum] and (known == 0 or (known == 1 and covered[stratum] > lone and k < most)):
                    found[stratum].append(k)
    return found


def expected_colors(
    device: Device, scene: clrast.Scene, mode: str, shades_all: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(SIDE, SIDE, 4) float64, where pixels show more than one triangle, and the samples shaded beside the centre.

    shades_all : all `most` samples of the surfaces of a quad where two of one surface are known to differ.
    """
    most, count = counts_of(mode)
    center_prims, centers = shown(device, scene, *CENTER)
    samples = [shown(device, scene, x, y) for x, y in scrambled(count).positions]
    prims, colors = (np.stack(each) for each in zip(*samples, strict=True))
    expected, edges = centers.copy(), (prims != center_prims).any(axis=0)
    varies = np.zeros((SIDE, SIDE), dtype=bool)
    strata = {at: strata_of(center_prims[at], prims[:, *at]) for at in np.ndindex(SIDE, SIDE)}
    shaded = {at: shaded_samples(strata[at], most, 1e-6 if shades_all else 1.0) for at in strata}

    def known(at: tuple[int, int], stratum: int) -> np.ndarray:
        found = colors[shaded[at][stratum], *at]
        return np.concatenate([centers[at][None], found]) if stratum == 0 else found

    for at in strata:
        varies[at] = any((known(at, k) != known(at, k)[:1]).any() for k in set(strata[at]) - {CROWD})
    for at in strata:
        corner = at[0] & ~1, at[1] & ~1
        if shades_all and varies[corner[0] : corner[0] + 2, corner[1] : corner[1] + 2].any():
            for k in range(first_shaded(most), most):
                if k not in shaded[at][strata[at][k]]:
                    shaded[at][strata[at][k]].append(k)
        if edges[at] or shades_all:
            expected[at] = sum(known(at, k).mean(axis=0) / count for k in strata[at])
    counts = np.reshape([sum(len(found) for found in shaded[at]) for at in strata], (SIDE, SIDE))
    return expected, edges, counts


def varied_triangles() -> clrast.Scene:
    """Triangles of one material each, whose corners have colours."""
    shades = np.random.default_rng(8).uniform(0.1, 1.0, size=(90, 3))
    colors = np.concatenate([shades, np.ones((90, 1))], axis=1).astype(np.float32)
    return replace(some_triangles(), colors=colors, materials=unlit(*[(1.0, 1.0, 1.0)] * 30))


def check_rate(device: Device, scene: clrast.Scene, mode: str, rate: str, error: float) -> np.ndarray:
    """Colours at rate FEW or ALL, held to the reference and to what may be shaded, of edge pixels or of all."""
    most, count = counts_of(mode)
    frame = render(device, scene, orthographic(SIDE, SIDE), aov=("color",), aa=mode, shading_rate=rate)
    expected, edges, shaded = expected_colors(device, scene, mode, shades_all=rate == ALL)
    np.testing.assert_allclose(colors_of(frame), expected, rtol=0, atol=error)
    counts = frame.stats["other_counts"]
    if rate == FEW:
        assert counts["edge_pixels"] == np.count_nonzero(edges) > SIDE
        assert counts["samples_shaded"] == SIDE * SIDE + shaded[edges].sum()
    assert counts["samples_shaded"] <= SIDE * SIDE + shaded.sum()
    if most == count:
        assert shaded.max() <= most
    return colors_of(frame)


@pytest.mark.parametrize("rate", [FEW, ALL])
@pytest.mark.parametrize("mode", MODES)
def test_rate_auto_shades_a_quarter_or_all_of_each_surface(device: Device, mode: str, rate: str) -> None:
    """A quarter with an error that all may have, all S where surfaces vary with one that none may have."""
    check_rate(device, varied_triangles(), mode, rate, 16 * U)


def specks() -> clrast.Scene:
    """Small triangles of one material and one colour each, and of many colours; in half of the pixels there are few."""
    rng = np.random.default_rng(12)
    centers = rng.uniform(0.0, SIDE, size=(3000, 2))
    centers = centers[(centers[:, 0] < SIDE / 2) | (rng.uniform(size=3000) < 0.1)][:, None]
    count = len(centers)
    depths = np.repeat(rng.uniform(-2.0, -1.0, size=(count, 1, 1)), 3, axis=1)
    corners = np.concatenate([centers + rng.uniform(-0.3, 0.3, size=(count, 3, 2)), depths], axis=2) * (1, -1, 1)
    colors = [tuple(color) for color in rng.integers(0, 16, size=(count, 3)) / 16.0]
    return make_scene(corners, materials=unlit(*colors), material_ids=np.arange(count, dtype=np.uint32))


@pytest.mark.parametrize("rate", [FEW, ALL])
@pytest.mark.parametrize("mode", ["msaa:16", "msaa:32", "csaa:4+12"])
def test_all_samples_of_a_crowd_are_shaded(device: Device, mode: str, rate: str) -> None:
    """Pixels of more surfaces than are kept apart show all that their samples show, nothing too."""
    count = counts_of(mode)[1]
    center_prims, _ = shown(device, specks(), *CENTER)
    prims = np.stack([shown(device, specks(), x, y)[0] for x, y in scrambled(count).positions])
    crowds = [CROWD in strata_of(center_prims[at], prims[:, *at]) for at in np.ndindex(SIDE, SIDE)]
    assert 0.1 < np.mean(crowds) < 0.9 and (prims == NO_HIT).any()
    found = check_rate(device, specks(), mode, rate, 32 * U)
    samples = np.stack([shown(device, specks(), x, y)[1] for x, y in scrambled(count).positions])
    np.testing.assert_allclose(found[..., 3], samples[..., 3].mean(axis=0), rtol=0, atol=32 * U)


def test_auto_shows_what_all_samples_do_in_crowds() -> None:
    """Surfaces of one colour: with an error that none may have what 256 plain renders show."""
    device, scene = open_first_device(), specks()
    positions = scrambled(256).positions
    samples = np.stack([colors_of(moved_render(device, scene, x, y)).astype(np.float64) for x, y in positions])
    frame = render(device, scene, orthographic(SIDE, SIDE), aov=("color",), aa="auto:1e-06")
    edges = (samples[:16] != samples[0]).any(axis=(0, 3))  # else nothing tells that there is more than they show
    assert edges.mean() > 0.5
    np.testing.assert_allclose(colors_of(frame)[edges], samples.mean(axis=0)[edges], rtol=0, atol=256 * U)


@pytest.mark.parametrize(("mode", "rate"), [("auto:0.002", "pixel"), ("msaa:32", "auto:0.002")])
def test_a_small_surface_shades_enough_of_its_samples(mode: str, rate: str) -> None:
    """A square with a ramp over a quarter of each pixel: one sample alone does not tell that it varies."""
    device, corners, shades = open_first_device(), [], []
    for x, y in np.ndindex(SIDE, SIDE):
        for u, v in ((0, 0), (1, 0), (1, 1), (0, 0), (1, 1), (0, 1)):
            corners.append((x + 0.5 * u, -y - 0.5 * v, -2.0))
            shades.append((8.0 * u, 0.5, 0.25, 1.0))
    colors = np.array(shades, dtype=np.float32)
    scene = make_scene(corners, materials=unlit((1.0, 1.0, 1.0)), colors=colors)
    given = {"aov": ("color",), "aa": mode, "shading_rate": rate}
    frame = render(device, scene, orthographic(SIDE, SIDE), **given)
    np.testing.assert_allclose(frame["A"], 0.25, rtol=0, atol=2 / 32)
    np.testing.assert_allclose(frame["R"], 4.0 * frame["A"], rtol=0.1)


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


@pytest.mark.parametrize("mode", ["msaa:4", "csaa:3+4", "msaa:16"])
def test_as_many_samples_are_decided_by_lanes_as_by_passes(mode: str) -> None:
    """Vectors take 16 samples of a pixel at once: those that a pattern does not have are none."""
    device, given = open_first_device(), {"aov": ("color",), "method": "3dr-binning", "aa": mode, "shading_rate": FEW}
    frames = [render(device, some_triangles(), orthographic(SIDE, SIDE), vector_width=w, **given) for w in (1, 8)]
    counts = [frame.stats["counts"] for frame in frames]
    assert counts[0]["samples"] == counts[1]["samples"] == (1 + counts_of(mode)[1]) * SIDE * SIDE
    assert counts[0]["passes"] > counts[1]["passes"]


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
