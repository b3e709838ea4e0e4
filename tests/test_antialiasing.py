"""Antialiasing: coverage of half-planes and thin lines against integer arithmetic, resolves against numpy, ids, bits.

Edges have short coordinates and never pass through a sample, so that every rung decides them exactly, and expected
coverages are counts of samples, or areas of clipped squares; no pixel of a reference comes from the kernels.
"""

from __future__ import annotations

import itertools
import math
import re

import numpy as np
import pytest
from conftest import first_runtime, open_first_device
from kernel_world import make_scene, orthographic, render, settings
from small_renders import LAMPS, ROOT

import clrast
from clrast.errors import CapacityError, UsageError
from clrast.opencl.device import Device
from clrast.opencl.layout import NO_HIT
from clrast.options import RenderOptions
from clrast.scene.model import Material
from clrast.shading.filters import weight_at
from clrast.shading.rounds import EDGE_ERROR
from clrast.visibility.sample_patterns import (
    FILTERS,
    MSAA_COUNTS,
    UNITS,
    mixed,
    parse_antialiasing,
    pattern_of,
    scrambled,
    sobol,
)

SIDE = 12
CENTER = (UNITS // 2, UNITS // 2)
MODES = ("ssaa:2", "ssaa:5", "ssaa:16", "msaa:2", "msaa:4", "msaa:8", "msaa:16", "msaa:32", "csaa:4+12", "csaa:1+7")
U = 2.0**-24


def unlit(*colors: tuple[float, float, float]) -> tuple[Material, ...]:
    return tuple(Material(str(k), (*color, 1.0), unlit=True) for k, color in enumerate(colors))


# --- patterns --------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1 << k for k in range(1, 9)])
def test_sobol_points_are_nets(count: int) -> None:
    """One point in each box of every grid of 2^a x 2^(m-a) boxes: the definition of a (0,m,2)-net."""
    points, levels = sobol(count).positions, count.bit_length() - 1
    for a in range(levels + 1):
        boxes = {((x << a) // UNITS, (y << (levels - a)) // UNITS) for x, y in points}
        assert len(boxes) == count


def test_scrambled_points_are_nets_and_centred_whenever_samples_stop() -> None:
    """The samples of auto: a net, as Sobol's are, and from 8 on with a mean near the centre, as those have not."""
    points = scrambled(256).positions
    for levels in range(9):
        for a in range(levels + 1):
            boxes = {((x << a) // UNITS, (y << (levels - a)) // UNITS) for x, y in points[: 1 << levels]}
            assert len(boxes) == 1 << levels
    for levels in range(3, 7):
        count = 1 << levels
        mean = (np.array(points[:count]) + 0.5).mean(axis=0) / UNITS
        assert np.abs(mean - 0.5).max() <= 0.06 / count
    assert np.abs(np.array(sobol(256).positions[:8]).mean(axis=0) / UNITS - 0.5).max() > 0.05


def areas_below(normals: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """(n,) the parts of the unit square with normal . p < offset, by 512 columns that are each cut exactly."""
    flat = np.abs(normals[:, 1]) < np.abs(normals[:, 0])
    turned = np.where(flat[:, None], normals[:, ::-1], normals)
    columns = (np.arange(512) + 0.5) / 512
    below = np.clip((offsets[:, None] - turned[:, :1] * columns) / turned[:, 1:], 0.0, 1.0).mean(axis=1)
    return np.where(turned[:, 1] > 0, below, 1.0 - below)


def test_edges_have_the_error_that_auto_takes_them_to_have() -> None:
    """Root mean square over straight edges anywhere in a pixel, by that of the deviation of what samples show."""
    rng = np.random.default_rng(37)
    angles = rng.uniform(0.0, 2.0 * np.pi, size=20_000)
    normals = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    offsets = 0.5 * (normals.sum(axis=1) + rng.uniform(-1.0, 1.0, size=len(angles)) * np.abs(normals).sum(axis=1))
    exact, points = areas_below(normals, offsets), np.array(scrambled(256).positions) / UNITS
    for count in (16, 32, 64, 128, 256):
        shares = (normals @ points[:count].T < offsets[:, None]).mean(axis=1)
        estimate = np.sqrt(np.mean(shares * (1.0 - shares))) * count**-0.75
        found = np.sqrt(np.mean((shares - exact) ** 2)) / estimate
        assert 0.75 < found <= EDGE_ERROR, f"{count} samples: {found:.3f}"


@pytest.mark.parametrize("count", [4, 8, 16])
def test_standard_patterns_have_one_sample_a_row_and_column(count: int) -> None:
    pattern = pattern_of(count)
    assert pattern.name == "standard"
    for axis in (0, 1):
        assert len({p[axis] for p in pattern.positions}) == count
    assert all(0 <= c < UNITS for p in pattern.positions for c in p)


@pytest.mark.parametrize(("depth", "coverage"), [(1, 1), (4, 12), (8, 8), (8, 24), (3, 5)])
def test_mixed_patterns_begin_with_a_whole_one(depth: int, coverage: int) -> None:
    positions = mixed(depth, coverage).positions
    assert positions[:depth] == pattern_of(depth).positions
    assert len(set(positions)) == depth + coverage


# --- coverage --------------------------------------------------------------------------------------


def directions(count: int) -> list[tuple[int, int]]:
    """Edge directions (q, p) with q even and p odd: with corners at odd 512ths no edge passes through a sample."""
    found = []
    for k in range(count):
        angle = 2 * math.pi * (k + 0.5) / count
        found.append((2 * round(31 * math.cos(angle)), 2 * round(31 * math.sin(angle)) + 1))
    return found


def draw_corner(rng: np.random.Generator) -> tuple[int, int]:
    """A point near the middle, in odd 512ths."""
    x, y = rng.integers(4 * 256, 8 * 256, size=2)
    return 2 * int(x) + 1, 2 * int(y) + 1


def edge_triangle(q: int, p: int, corner: tuple[int, int]) -> np.ndarray:
    """A triangle to one side of the line through corner (512ths) along (q, p) pixels: (3, 3) float32, world."""
    x, y = corner[0] / 512, corner[1] / 512
    points = [(x - q, y - p), (x + q, y + p), (x - 2 * p, y + 2 * q)]
    return np.array([(a, -b, -2.0) for a, b in points], dtype=np.float32)


def inside(q: int, p: int, corner: tuple[int, int], positions: tuple[tuple[int, int], ...]) -> np.ndarray:
    """(SIDE, SIDE, samples) bool: whether samples lie on the triangle's side of the line, in integers."""
    x = np.arange(SIDE)[None, :, None] * 512 + np.array([2 * x for x, _ in positions]) - corner[0]
    y = np.arange(SIDE)[:, None, None] * 512 + np.array([2 * y for _, y in positions]) - corner[1]
    value = q * y - p * x
    assert (value != 0).all()
    return value > 0


def area_below(q: float, p: float, corner: tuple[int, int]) -> np.ndarray:
    """(SIDE, SIDE) float64: the part of each pixel on that side, by clipping its square."""
    areas = np.zeros((SIDE, SIDE))
    for j, i in itertools.product(range(SIDE), range(SIDE)):
        square = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
        values = [q * (y - corner[1] / 512) - p * (x - corner[0] / 512) for x, y in square]
        kept = []
        for k in range(4):
            (x0, y0), (x1, y1), v0, v1 = square[k - 1], square[k], values[k - 1], values[k]
            if (v0 > 0) != (v1 > 0):
                kept.append((x0 + (x1 - x0) * v0 / (v0 - v1), y0 + (y1 - y0) * v0 / (v0 - v1)))
            if v1 > 0:
                kept.append((x1, y1))
        areas[j, i] = abs(sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(kept, kept[1:] + kept[:1], strict=True))) / 2
    return areas


def expected_coverage(mode: str, is_inside) -> np.ndarray:
    """A of one half-plane or line: samples inside over samples. `is_inside` : positions -> (SIDE, SIDE, samples)."""
    wanted = parse_antialiasing("--aa", mode)
    counts = is_inside(wanted.pattern.positions).astype(np.float64).mean(axis=2)
    if wanted.kind != "csaa":
        return counts
    # Coverage samples count only where a sample with visibility, or the centre, says that there is an edge.
    known = is_inside((CENTER, *wanted.pattern.positions[: wanted.depth_count]))
    return np.where(known.all(axis=2), 1.0, np.where(known.any(axis=2), counts, 0.0))


def check_half_planes(device: Device, modes: tuple[str, ...], count: int) -> None:
    view, rng = orthographic(SIDE, SIDE), np.random.default_rng(1)
    for q, p in directions(count):
        corner = draw_corner(rng)
        scene = make_scene(edge_triangle(q, p, corner), materials=unlit((0.25, 0.5, 1.0)))
        for mode in modes:
            frame = render(device, scene, view, aov=("color", "id"), aa=mode)
            expected = expected_coverage(mode, lambda positions: inside(q, p, corner, positions))  # noqa: B023
            np.testing.assert_allclose(frame["A"], expected, rtol=0, atol=2 * U, err_msg=f"{mode} {q, p, corner}")
            np.testing.assert_allclose(frame["R"], 0.25 * expected, rtol=0, atol=U, err_msg=f"{mode}: premultiplied")
            center = inside(q, p, corner, (CENTER,))[..., 0]
            np.testing.assert_array_equal(frame["id.prim"], np.where(center, 0, NO_HIT), err_msg=f"{mode}: ids")


def test_half_planes_cover_what_their_samples_say(device: Device) -> None:
    check_half_planes(device, MODES, 3)


@pytest.mark.long
def test_half_planes_at_a_thousand_angles(device: Device) -> None:
    check_half_planes(device, MODES, 1000)


def worst_half_plane(positions: tuple[tuple[int, int], ...]) -> float:
    """How far the share of samples in a half-plane can be from its area in the pixel, over lines near every pair."""
    points = np.array(positions) / UNITS
    worst = 0.0
    for a, b in itertools.combinations(points, 2):
        normal = np.array([-(b - a)[1], (b - a)[0]])
        line = float(normal @ a)
        area = polygon_share(normal, line)
        values = points @ normal - line
        on = np.abs(values) < 1e-12
        low, high = (values > 1e-12).mean(), ((values > 1e-12) | on).mean()
        worst = max(worst, abs(low - area), abs(high - area))
    return worst


def polygon_share(normal: np.ndarray, line: float) -> float:
    """Area of the unit square where normal . x > line."""
    square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], dtype=np.float64)
    values, kept = square @ normal - line, []
    for k in range(4):
        if (values[k - 1] > 0) != (values[k] > 0):
            kept.append(square[k - 1] + (square[k] - square[k - 1]) * values[k - 1] / (values[k - 1] - values[k]))
        if values[k] > 0:
            kept.append(square[k])
    return abs(sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(kept, kept[1:] + kept[:1], strict=True))) / 2


@pytest.mark.parametrize("count", MSAA_COUNTS[1:])
def test_coverage_is_within_the_patterns_bound_of_the_area(count: int) -> None:
    """What kernels are held to above, held to areas: none is farther off than the worst line of the pattern."""
    positions = pattern_of(count).positions
    bound, rng = worst_half_plane(positions), np.random.default_rng(2)
    worst = 0.0
    for q, p in directions(40):
        corner = draw_corner(rng)
        shares = inside(q, p, corner, positions).mean(axis=2)
        worst = max(worst, float(np.abs(shares - area_below(q, p, corner)).max()))
    assert 0.2 * bound < worst <= bound < 2.5 / math.sqrt(count)


def test_adaptive_samples_reach_the_area(device: Device) -> None:
    """No pixel is farther off than the first samples can be, and all edges together, of 11 or 12 pixels each, less than
    the threshold; flat ones are not sampled."""
    view = orthographic(SIDE, SIDE)
    first = scrambled(256).positions[:8]
    errors: dict[float, list[np.ndarray]] = {0.05: [], 0.01: []}
    for (q, p), threshold in itertools.product(directions(12), errors):
        corner = (5 * 512 + 77, 6 * 512 + 131)
        scene = make_scene(edge_triangle(q, p, corner), materials=unlit((1.0, 1.0, 1.0)))
        frame = render(device, scene, view, aov=("color", "id"), aa=f"auto:{threshold}")
        area = area_below(q, p, corner)
        error = np.abs(frame["A"] - area)
        assert error.max() <= worst_half_plane(first)
        known = inside(q, p, corner, (CENTER, *first))
        edges = known.any(axis=2) & ~known.all(axis=2)
        errors[threshold].append(error[edges])
        assert (error[(area == 0) | (area == 1)] == 0).all()
    for threshold, found in errors.items():
        assert np.sqrt((np.concatenate(found) ** 2).mean()) <= threshold


def line_triangles(q: int, p: int, corner: tuple[int, int], across: tuple[int, int]) -> np.ndarray:
    """Two triangles between the line through `corner` and that moved by `across`, 512ths."""
    x, y = corner[0] / 512, corner[1] / 512
    u, v = across[0] / 512, across[1] / 512
    a, b = (x - q, y - p), (x + q, y + p)
    quad = [a, b, (b[0] + u, b[1] + v), (a[0] + u, a[1] + v)]
    corners = [quad[k] for k in (0, 1, 2, 0, 2, 3)]
    return np.array([(s, -t, -2.0) for s, t in corners], dtype=np.float32)


def check_thin_lines(device: Device, modes: tuple[str, ...], count: int) -> None:
    view, rng = orthographic(SIDE, SIDE), np.random.default_rng(3)
    for q, p in directions(count):
        corner = draw_corner(rng)
        size = math.hypot(q, p)
        across = (2 * round(-p / size * 100), 2 * round(q / size * 100))  # about 0.39 pixels
        if across[0] * p == across[1] * q:
            continue
        other = (corner[0] + across[0], corner[1] + across[1])
        scene = make_scene(line_triangles(q, p, corner, across), materials=unlit((1.0, 1.0, 1.0)))

        def is_inside(positions, q=q, p=p, corner=corner, other=other):  # noqa: ANN001, ANN202
            return inside(q, p, corner, positions) & ~inside(q, p, other, positions)

        for mode in modes:
            frame = render(device, scene, view, aov=("color", "id"), aa=mode)
            expected = expected_coverage(mode, is_inside)
            np.testing.assert_allclose(frame["A"], expected, rtol=0, atol=2 * U, err_msg=f"{mode} {q, p, corner}")


LINE_MODES = ("ssaa:16", "msaa:4", "msaa:8", "msaa:32")


def test_thin_lines_are_not_lost(device: Device) -> None:
    """Lines of 0.39 pixels, whose triangles miss most centres: every sample counts, in exact numbers."""
    check_thin_lines(device, LINE_MODES, 3)


@pytest.mark.long
def test_thin_lines_at_a_thousand_angles(device: Device) -> None:
    check_thin_lines(device, LINE_MODES, 1000)


@pytest.mark.parametrize("mode", ["ssaa:8", "msaa:4", "msaa:32", "csaa:4+12", "auto:0.02"])
def test_two_sides_of_an_edge_sum_to_one(device: Device, mode: str) -> None:
    """A shared edge between two colours over the whole view: no sample is lost or counted twice, alpha stays 1."""
    quad = [(-1, 1, -2), (SIDE + 1, 3, -2), (SIDE + 2, -SIDE - 1, -2), (-3, -SIDE - 2, -2)]
    scene = make_scene(
        quad, [(0, 1, 2), (0, 2, 3)], materials=unlit((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
        material_ids=np.array([0, 1], dtype=np.uint32),
    )  # fmt: skip
    frame = render(device, scene, orthographic(SIDE, SIDE), aov=("color", "id"), aa=mode)
    assert (frame["A"] == 1.0).all()
    np.testing.assert_array_equal(frame["R"] + frame["G"], np.float32(1.0))
    assert 0 < np.count_nonzero((frame["R"] > 0) & (frame["R"] < 1)) < SIDE * SIDE / 2
    plain = render(device, scene, orthographic(SIDE, SIDE), aov=("id",))
    np.testing.assert_array_equal(frame["id.prim"], plain["id.prim"])


# --- resolves --------------------------------------------------------------------------------------


def some_triangles() -> clrast.Scene:
    rng = np.random.default_rng(4)
    corners = rng.integers(-8, 8 * SIDE + 8, size=(30, 3, 3)) / 8.0
    corners[..., 1] *= -1.0
    corners[..., 2] = rng.integers(-16, -1, size=(30, 3)) / 2.0
    colors = [tuple(rng.integers(0, 16, size=3) / 16.0) for _ in range(30)]
    return make_scene(corners, materials=unlit(*colors), material_ids=np.arange(30, dtype=np.uint32))


def colors_of(frame: clrast.Frame) -> np.ndarray:
    """(SIDE, SIDE, 4) float32."""
    return np.stack([frame[name] for name in "RGBA"], axis=-1)


def moved_render(device: Device, scene: clrast.Scene, x: int, y: int) -> clrast.Frame:
    """A plain render by a camera that is moved so that centres are at (x, y) of pixels."""
    view = orthographic(SIDE, SIDE, e0=((x - UNITS / 2) / UNITS, -(y - UNITS / 2) / UNITS, 0))
    return render(device, scene, view, aov=("color", "id"))


def moved_renders(device: Device, scene: clrast.Scene, mode: str) -> list[np.ndarray]:
    """(SIDE, SIDE, 4) colours at the pattern's samples."""
    positions = parse_antialiasing("--aa", mode).pattern.positions
    return [colors_of(moved_render(device, scene, x, y)) for x, y in positions]


RESOLVES = (
    ("ssaa:4", "box"),
    ("ssaa:6", "box"),
    ("ssaa:4", "tent"),
    ("ssaa:16", "gaussian"),
    ("ssaa:4", "blackman-harris"),
)


@pytest.mark.parametrize(("mode", "name"), RESOLVES)
def test_samples_are_whole_renders_summed_in_order(device: Device, mode: str, name: str) -> None:
    """Bit for bit: sums and weights in float32, sample by sample, neighbours row by row."""
    scene = some_triangles()
    reach = 0 if name == "box" else 1
    sums, weights = np.zeros((SIDE, SIDE, 4), np.float32), np.zeros((SIDE, SIDE, 1), np.float32)
    positions = parse_antialiasing("--aa", mode).pattern.positions
    for (x, y), colors in zip(positions, moved_renders(device, scene, mode), strict=True):
        for dy, dx in itertools.product(range(-reach, reach + 1), repeat=2):
            weight = np.float32(weight_at(name, dx + x / UNITS - 0.5) * weight_at(name, dy + y / UNITS - 0.5))
            for j, i in itertools.product(range(SIDE), repeat=2):
                if 0 <= j + dy < SIDE and 0 <= i + dx < SIDE:
                    sums[j, i] += colors[j + dy, i + dx] * weight
                    weights[j, i] += weight
    frame = render(device, scene, orthographic(SIDE, SIDE), aov=("color",), aa=mode, filter=name)
    np.testing.assert_array_equal(colors_of(frame), sums / weights)


@pytest.mark.parametrize("name", FILTERS)
def test_shared_shading_resolves_as_shading_of_every_sample(device: Device, name: str) -> None:
    """Triangles of one colour each: shared or not, a sample's colour is the same; sums take another order."""
    scene, view = some_triangles(), orthographic(SIDE, SIDE)
    shared = render(device, scene, view, aov=("color",), aa="msaa:8", filter=name)
    each = render(device, scene, view, aov=("color",), aa="msaa:8", filter=name, shading_rate="sample")
    for channel in "RGBA":
        np.testing.assert_allclose(shared[channel], each[channel], rtol=72 * U, atol=1e-9)


def test_filters_are_what_they_say() -> None:
    assert [weight_at("tent", x) for x in (-1.0, -0.5, 0.0, 0.25, 1.0)] == [0.0, 0.5, 1.0, 0.75, 0.0]
    assert weight_at("box", -0.5) == 1.0 and weight_at("box", 0.5) == 0.0
    assert weight_at("gaussian", 0.5) == pytest.approx(math.exp(-0.5))
    assert weight_at("blackman-harris", 0.0) == pytest.approx(1.0)
    assert weight_at("blackman-harris", -1.5) == pytest.approx(0.00006, abs=1e-9)


# --- other channels, bits, options -----------------------------------------------------------------


@pytest.fixture(scope="module")
def room() -> clrast.Scene:
    """Textures, masks, lights and layers."""
    return clrast.load(ROOT / "data" / "room.toml")


@pytest.fixture(scope="module")
def lamps(tmp_path_factory: pytest.TempPathFactory) -> clrast.Scene:
    """Opaque: kernels that every runtime builds in a second."""
    path = tmp_path_factory.mktemp("cards") / "lamps.toml"
    path.write_text(LAMPS)
    return clrast.load(path)


def small_view(runtime: str, scene: clrast.Scene, **options: object) -> clrast.Frame:
    return clrast.render(scene, **{"size": (40, 36), "device": runtime, "method": "3dr-binning", **options})


def check_bits(device: Device, scene: clrast.Scene, options: dict[str, object]) -> None:
    """The reference is the first runtime's, in tiles of another size."""
    with settings(tile_log2=4):
        reference = small_view(first_runtime(), scene, **options)
    found = small_view(device.runtime, scene, **options)
    for name in reference:
        np.testing.assert_array_equal(found[name], reference[name], err_msg=name)


BITS = (
    {"aa": "ssaa:2"}, {"aa": "msaa:4"}, {"aa": "csaa:2+4", "filter": "tent"}, {"aa": "auto:0.2"},
    {"aa": "csaa:2+2", "shading_rate": "auto"},
)  # fmt: skip


@pytest.mark.parametrize("options", BITS, ids=lambda options: options["aa"])
def test_bits_do_not_depend_on_runtimes_and_tiles(device: Device, lamps: clrast.Scene, options: dict) -> None:
    check_bits(device, lamps, options)


@pytest.mark.long
@pytest.mark.parametrize("blend", ["on", "off"])
@pytest.mark.parametrize("options", BITS, ids=lambda options: options["aa"])
def test_bits_of_everything_a_scene_can_have(device: Device, room: clrast.Scene, options: dict, blend: str) -> None:
    check_bits(device, room, {**options, "effects": {"alpha blend": blend}})


def check_other_channels(runtime: str, scene: clrast.Scene, mode: str) -> None:
    plain = small_view(runtime, scene, aov="all")
    found = small_view(runtime, scene, aov="all", aa=mode)
    for name in plain:
        if name in "RGB":
            assert (found[name] != plain[name]).any(), name
        elif name != "A":
            np.testing.assert_array_equal(found[name], plain[name], err_msg=name)
    assert found.header["aa"] == mode and found.stats["counts"]["passes"] > plain.stats["counts"]["passes"]


@pytest.mark.parametrize("mode", ["ssaa:3", "msaa:4", "csaa:4+12", "auto:0.2"])
def test_only_colour_is_antialiased(device: Device, lamps: clrast.Scene, mode: str) -> None:
    check_other_channels(device.runtime, lamps, mode)


@pytest.mark.parametrize("mode", ["msaa:4", "auto:0.2"])
def test_only_colour_is_antialiased_where_surfaces_blend(room: clrast.Scene, mode: str) -> None:
    check_other_channels(first_runtime(), room, mode)


def same_samples(change: dict[str, str]) -> None:
    scene, view = some_triangles(), orthographic(SIDE, SIDE)
    device = open_first_device()
    expected = render(device, scene, view, aov=("color",), aa="msaa:4", method="3dr-binning")
    found = render(device, scene, view, aov=("color",), aa="msaa:4", **{"method": "3dr-binning", **change})
    for name in "RGBA":
        np.testing.assert_array_equal(found[name], expected[name], err_msg=f"{change} {name}")


@pytest.mark.parametrize("method", ["3dr-full", "raycast-brute"])
def test_every_method_shows_the_same_samples(method: str) -> None:
    same_samples({"method": method})


@pytest.mark.long
@pytest.mark.parametrize("precision", ["fast", "ordered", "double", "exact"])
def test_every_rung_shows_the_same_samples(precision: str) -> None:
    """Short numbers, where float32 is exact too."""
    same_samples({"precision": precision})


@pytest.mark.long
def test_the_fixed_rung_shows_the_same_samples() -> None:
    """Corners on its grid of 1/4096 pixel."""
    same_samples({"precision": "fixed", "method": "2dr-binning"})


def test_coplanar_triangles_of_one_material_share_their_shading(device: Device) -> None:
    """A fan of slivers: one surface, so nothing beside the centres is shaded; in two materials, what edges show is."""
    angles = np.linspace(0, 2 * np.pi, 65)
    rim = np.stack([6 + 20 * np.cos(angles), -6 + 20 * np.sin(angles), np.full(65, -2.0)], axis=-1)
    corners = np.array([[(6.3, -6.1, -2.0), rim[k], rim[k + 1]] for k in range(64)])
    for material_ids, is_shared in ((np.zeros(64, np.uint32), True), (np.arange(64, dtype=np.uint32) % 2, False)):
        scene = make_scene(corners, materials=unlit((1, 0, 0), (0, 1, 0)), material_ids=material_ids)
        frame = render(device, scene, orthographic(SIDE, SIDE), aov=("color",), aa="msaa:8")
        shaded = frame.stats["other_counts"]["samples_shaded"]
        assert (shaded == SIDE * SIDE) == is_shared


@pytest.mark.parametrize(
    ("options", "mend"),
    [
        ({"aa": "msaa:3"}, "2, 4, 8, 16, 32"),
        ({"aa": "ssaa:0"}, "give 1 to 1024"),
        ({"aa": "ssaa:1025"}, "give 1 to 1024"),
        ({"aa": "csaa:16+17"}, "at most 32"),
        ({"aa": "csaa:0+4"}, "at least 1"),
        ({"aa": "auto:0"}, "such as auto:0.01"),
        ({"aa": "auto:1e999"}, "such as auto:0.01"),
        ({"aa": "auto:e"}, "such as auto:0.01"),
        ({"aa": "msaa"}, "use none, ssaa:N"),
        ({"filter": "mitchell"}, "use box, tent"),
        ({"aa": "auto:0.1", "filter": "tent"}, "use --aa ssaa:N"),
        ({"aa": "csaa:4+4", "shading_rate": "sample", "filter": "tent"}, "use --filter box"),
        ({"aa": "msaa:4", "shading_rate": "auto", "filter": "gaussian"}, "use --filter box"),
        ({"aa": "csaa:4+4", "shading_rate": "auto:0.1", "filter": "tent"}, "use --filter box"),
        ({"aa": "msaa:4", "shading_rate": "fine"}, "use pixel, sample, auto or auto:EPS"),
        ({"aa": "msaa:4", "shading_rate": "auto:2"}, "such as auto:0.01"),
        ({"aa": "msaa:4", "shading_rate": "auto:"}, "such as auto:0.01"),
        ({"aa": "msaa:4", "shading_rate": 4}, "use pixel, sample, auto or auto:EPS"),
    ],
)
def test_what_makes_no_sense_is_refused(options: dict, mend: str) -> None:
    with pytest.raises(UsageError, match="^[^\n]*$") as caught:
        RenderOptions(**options).check_together()
    assert mend in str(caught.value)


def test_modes_have_one_form() -> None:
    assert RenderOptions(aa="msaa:004").aa == "msaa:4"
    assert RenderOptions(aa="csaa:04+12").aa == "csaa:4+12"
    assert RenderOptions(aa="auto:1e-2").aa == "auto:0.01"
    assert RenderOptions(shading_rate="auto:1e-2").shading_rate == "auto:0.01"
    assert RenderOptions(shading_rate="auto:0.050").shading_rate == RenderOptions(shading_rate="auto").shading_rate


def least_memory(runtime: str, scene: clrast.Scene, **options: object) -> int:
    """The budget of one row of tiles, which the error names."""
    with pytest.raises(CapacityError) as caught:
        small_view(runtime, scene, memory=1, **options)
    return int(re.search(r"at least (\d+)", str(caught.value))[1])


@pytest.mark.parametrize("rate", ["pixel", "auto"])
def test_bands_do_not_show(lamps: clrast.Scene, rate: str) -> None:
    runtime, options = first_runtime(), {"aa": "msaa:4", "shading_rate": rate}
    whole = small_view(runtime, lamps, **options)
    with settings(tile_log2=4):
        bands = small_view(runtime, lamps, memory=least_memory(runtime, lamps, **options), **options)
    assert bands.stats["other_counts"]["bands"] == 3
    assert bands.stats["counts"]["samples"] == whole.stats["counts"]["samples"] == (1 + 4) * 40 * 36
    for name in whole:
        np.testing.assert_array_equal(bands[name], whole[name], err_msg=name)


def test_bands_do_not_show_where_surfaces_blend(room: clrast.Scene) -> None:
    """What lies behind panes in one band decides nothing in another: pixels are listed by what is in front."""
    runtime, options = first_runtime(), {"aa": "auto:0.1", "camera": "plan", "size": (64, 120)}
    whole = small_view(runtime, room, **options)
    with settings(tile_log2=3):
        bands = small_view(runtime, room, memory=least_memory(runtime, room, **options), **options)
    assert bands.stats["other_counts"]["bands"] > 2
    for name in whole:
        np.testing.assert_array_equal(bands[name], whole[name], err_msg=name)
    counts = bands.stats["other_counts"]
    assert counts["edge_pixels"] == whole.stats["other_counts"]["edge_pixels"] > 0
    assert counts["samples_shaded"] == whole.stats["other_counts"]["samples_shaded"]


def test_wide_filters_want_the_image_in_one_band(lamps: clrast.Scene) -> None:
    runtime, options = first_runtime(), {"aa": "msaa:4", "filter": "tent"}
    with settings(tile_log2=4):
        memory = least_memory(runtime, lamps, **options)
        with pytest.raises(CapacityError, match="--filter tent .* use --filter box"):
            small_view(runtime, lamps, memory=memory, **options)
