"""Sines, random numbers and drawn directions against float64, nets counted in integers, and quadrature."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from light_quadrature import frame_of, ggx_nodes
from light_twin import masking
from statistics_twin import assert_uniform, chi_square, chi_square_limit

from clrast.opencl import buffers, kernels
from clrast.opencl.device import Device
from clrast.opencl.features import Features


class Probe:
    """tests/sampling_probe.cl on one device."""

    def __init__(self, device: Device, folder: Path) -> None:
        for path in [*kernels.kernel_folder().glob("*.clh"), Path(__file__).with_name("sampling_probe.cl")]:
            shutil.copy(path, folder)
        self.device = device
        self.program = kernels.build(device, "sampling_probe.cl", Features(1), folder)

    def run(self, kernel: str, planes: int, dtype: Any = np.float32, **arguments: Any) -> np.ndarray:
        """(planes, count); arrays among the arguments are (planes, count), too."""
        given, count = {}, 0
        for name, value in arguments.items():
            if isinstance(value, np.ndarray):
                count = value.shape[-1]
                value = buffers.upload(self.device, np.ascontiguousarray(value))
            given[name] = value
        made = buffers.create(self.device, 4 * planes * count)
        self.program.launch(f"probe_{kernel}", count, 1, count=count, **given, results=made)
        return buffers.download(self.device, made, dtype, (planes, count))

    def points(self, keys: Any, indices: Any, dimensions: Any) -> np.ndarray:
        """(2, ...) float32 for what these broadcast to."""
        places = np.stack([a.astype(np.uint32) for a in np.broadcast_arrays(keys, indices, dimensions)])
        return self.run("points", 2, places=places.reshape(3, -1)).reshape(2, *places.shape[1:])

    def keys(self, first: Any, second: Any) -> np.ndarray:
        words = np.stack([a.astype(np.uint32) for a in np.broadcast_arrays(first, second)])
        return self.run("keys", 1, np.uint32, words=words.reshape(2, -1)).reshape(words.shape[1:])


@pytest.fixture(scope="module")
def probe(first_device: Device, tmp_path_factory: pytest.TempPathFactory) -> Probe:
    return Probe(first_device, tmp_path_factory.mktemp("probe"))


# --- unit vectors ----------------------------------------------------------------------------------


def test_unit_vectors_of_all_sizes(probe: Probe) -> None:
    """Three products and two sums, a root and a quotient are 3.5 units of 2^-24 of each coordinate; sizes from where
    float32's last bits are subnormal to where they end, and along axes, where nothing is rounded."""
    rng = np.random.default_rng(29)
    drawn = rng.normal(size=(3, 1 << 16)) * 2.0 ** rng.integers(-100, 125, size=1 << 16)
    ends = np.array([[2.0**-126, 0, 0], [0, -(2.0**127), 0], [0, 0, 3.0], [2.0**-149, 0, 0], [0, 0, 0]]).T
    largest = np.full((3, 1), np.finfo(np.float32).max)
    vectors = np.concatenate([drawn, largest, ends], axis=1).astype(np.float32)
    found = probe.run("units", 6, vectors=vectors)
    np.testing.assert_array_equal(found[:3].view(np.uint32), found[3:].view(np.uint32))
    exact = vectors[:, :-2].astype(np.float64)
    exact /= np.linalg.norm(exact, axis=0)
    assert (abs(found[:3, :-2] - exact) <= 3.5 * 2.0**-24 * abs(exact) + 2.0**-126).all()
    np.testing.assert_array_equal(found[:3, -5:-2], np.sign(ends[:, :3]))
    assert tuple(found[:3, -2]) in {(1.0, 0.0, 0.0), (0.0, 0.0, 0.0)}, "subnormal numbers count or are 0"
    np.testing.assert_array_equal(found[:3, -1], 0)


# --- sine and cosine -------------------------------------------------------------------------------


def check_turns(probe: Probe, turns: np.ndarray) -> None:
    """The error that elementary.clh states; and that the circle's quarters are exact."""
    angle = 2 * np.pi * turns.astype(np.float64)
    found = probe.run("turns", 2, turns=turns)
    assert abs(found[0] - np.cos(angle)).max() < 2.0**-23
    assert abs(found[1] - np.sin(angle)).max() < 2.0**-23


def test_sine_and_cosine_are_as_exact_as_they_say(probe: Probe) -> None:
    rng = np.random.default_rng(11)
    eighths = np.arange(9, dtype=np.float32) / np.float32(8)
    near = [np.nextafter(eighths, np.float32(toward)) for toward in (-1, 2)]
    drawn = rng.integers(0, 1 << 24, size=1 << 18) / 2.0**24
    tiny = 2.0 ** -rng.uniform(1, 120, size=1000)
    check_turns(probe, np.clip(np.concatenate([eighths, *near, drawn, tiny]), 0, 1).astype(np.float32))
    exact = probe.run("turns", 2, turns=np.array([0, 0.25, 0.5, 0.75, 1], dtype=np.float32))
    np.testing.assert_array_equal(exact, [[1, 0, -1, 0, 1], [0, 1, 0, -1, 0]])


@pytest.mark.long
def test_sine_and_cosine_of_every_number_that_is_drawn(probe: Probe) -> None:
    for first in range(0, 1 << 24, 1 << 21):
        check_turns(probe, (np.arange(first, first + (1 << 21)) / 2.0**24).astype(np.float32))


# --- random numbers --------------------------------------------------------------------------------


def assert_net(points: np.ndarray, m: int) -> None:
    """points (2, sets, 2^m): every elementary interval of area 2^-m holds exactly one point of a set."""
    assert (points >= 0).all() and (points < 1).all()
    for j in range(m + 1):
        columns = np.floor(points[0].astype(np.float64) * 2**j).astype(np.int64)
        rows = np.floor(points[1].astype(np.float64) * 2 ** (m - j)).astype(np.int64)
        cells = np.sort(columns * 2 ** (m - j) + rows, axis=-1)
        np.testing.assert_array_equal(cells, np.broadcast_to(np.arange(2**m), cells.shape), err_msg=f"m {m}, j {j}")


@pytest.mark.parametrize("m", range(11))
def test_first_points_are_nets(probe: Probe, m: int) -> None:
    """And so are the following ones, 2^m at a time: a (0,2)-sequence, whatever scrambles it."""
    rng = np.random.default_rng(m)
    keys = np.concatenate([[0, 1, 0xFFFFFFFF], rng.integers(0, 1 << 32, size=21)])[:, None]
    dimensions = np.array([0, 1, 2, 3, 4, 9, 5000, 0xFFFFFFFF])[np.arange(24) % 8][:, None]
    for block in (0, 1, 5):
        assert_net(probe.points(keys, np.arange(2**m) + block * 2**m, dimensions), m)


def test_scrambles_differ(probe: Probe) -> None:
    """Of keys, dimensions and seeds: no two of 3000 neighbours have the same first points."""
    keys = np.arange(1000)[:, None]
    sets = [probe.points(keys, np.arange(4), 0), probe.points(0, np.arange(4), keys + 1)]
    sets.append(probe.points(probe.keys(77, keys), np.arange(4), 0))
    flat = np.concatenate([each.transpose(1, 0, 2).reshape(-1, 8) for each in sets])
    assert len(np.unique(flat, axis=0)) == 3000


def cells_of(x: np.ndarray, y: np.ndarray, side: int) -> np.ndarray:
    return np.floor(x.astype(np.float64) * side).astype(int) * side + np.floor(y.astype(np.float64) * side).astype(int)


def test_points_of_pixels_are_uniform(probe: Probe) -> None:
    """Over the keys of an image's pixels each point of a pair lies anywhere alike, and pairs know nothing of others."""
    y, x = np.mgrid[0:128, 0:128]
    keys = probe.keys(probe.keys(x | y << 16, 128 | 128 << 16), 5)
    for index in range(8):
        first, second = probe.points(keys, index, 3), probe.points(keys, index, 4)
        assert_uniform(cells_of(first[0], first[1], 16), 256)
        assert_uniform(cells_of(first[0], second[0], 16), 256)
        assert_uniform(cells_of(first[1], second[0], 16), 256)
        assert_uniform(cells_of(first[0][:, 1:], first[0][:, :-1], 8), 64)
        assert_uniform(cells_of(first[1][1:], first[1][:-1], 8), 64)
        other = probe.points(probe.keys(probe.keys(x | y << 16, 128 | 128 << 16), 6), index, 3)
        assert_uniform(cells_of(first[0], other[0], 16), 256)


def test_pairs_of_one_pixel_are_paired_anew(probe: Probe) -> None:
    """Points of two pairs of dimensions with one index do not move together, as unscrambled orders would."""
    keys = probe.keys(np.arange(64), 9)[:, None]
    pairs = [probe.points(keys, np.arange(256), dimension) for dimension in range(5)]
    for k in range(1, 5):
        assert_uniform(cells_of(pairs[0][0], pairs[k][0], 8), 64)
        assert_uniform(cells_of(pairs[0][1], pairs[k][1], 8), 64)


# --- directions ------------------------------------------------------------------------------------

NORMALS = np.array([(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, 1, -1e-8), (0.36, 0.48, -0.8), (1e-4, -1e-4, -1)])


def unit_rows(v: np.ndarray) -> np.ndarray:
    return v / np.sqrt((v * v).sum(axis=-1, keepdims=True))


def repeated(v: np.ndarray, count: int) -> np.ndarray:
    return np.repeat(v.astype(np.float32)[:, None], count, axis=1)


def around(h: np.ndarray, n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cosine to n, and turns about it in [0, 1), of vectors (3, count)."""
    t, b = frame_of(n)
    return n @ h, (np.arctan2(b @ h, t @ h) / (2 * np.pi)) % 1.0


@pytest.mark.parametrize("n", NORMALS, ids=str)
def test_cosine_weighted_directions(probe: Probe, n: np.ndarray) -> None:
    """With density cosine / pi the square of the cosine and the turn are uniform."""
    n, count = unit_rows(n), 1 << 15
    u = np.random.default_rng(3).random((2, count), dtype=np.float32)
    about = repeated(n, count)
    found = probe.run("directions", 6, alpha=0.5, n=about, v=about, u=u)[:3].astype(np.float64)
    # unit(): 5 roundings and those of its argument
    assert abs((found * found).sum(axis=0) - 1).max() < 8 * 2.0**-23
    cosine, turn = around(found, n)
    assert cosine.min() > -1e-6
    assert_uniform(cells_of(np.clip(cosine**2, 0, 1 - 1e-12), turn, 16), 256)


def tilted(n: np.ndarray, cosine: float, turn: float = 0.1) -> np.ndarray:
    t, b = frame_of(n)
    return n * cosine + np.sqrt(1 - cosine**2) * (t * np.cos(2 * np.pi * turn) + b * np.sin(2 * np.pi * turn))


@pytest.mark.parametrize("cosine", [1.0, 0.7, 0.2, 0.02])
@pytest.mark.parametrize("alpha", [0.04, 0.25, 1.0])
def test_density_of_mirrored_normals_is_a_density(probe: Probe, alpha: float, cosine: float) -> None:
    """Its integral over all directions that v is mirrored to is 1: dl = 4 (v . h) dh."""
    n = unit_rows(np.array([0.3, -0.5, 0.8]))
    v = tilted(n, cosine)
    h, solid = ggx_nodes(n, alpha, 256, 256)
    v_h = h @ v
    h, solid, v_h = h[v_h > 0], solid[v_h > 0], v_h[v_h > 0]
    way = (2 * v_h[:, None] * h - v).T.astype(np.float32)
    at = {"n": repeated(n, len(h)), "v": repeated(v, len(h)), "l": way}
    density = probe.run("densities", 1, alpha=alpha, **at)[0].astype(np.float64)
    # The rule errs by 1e-4 at the kink where v . h = 0 cuts the lobe. In float32
    # bell is n_h^2 (alpha^2 - 1) + 1 with 4u of error against alpha^2 at least: 2 * 4u / alpha^2, 3e-4 at 0.04.
    assert float((density * 4 * v_h * solid).sum()) == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize("cosine", [1.0, 0.7, 0.2])
@pytest.mark.parametrize("alpha", [0.04, 0.25, 1.0])
def test_normals_are_drawn_by_their_density(probe: Probe, alpha: float, cosine: float) -> None:
    """Counts in cells of (w, turn), as in ggx_nodes, against the integral of G1 D (v . h) / (n . v) over each."""
    n, count, side, fine = unit_rows(np.array([-0.2, 0.5, -0.8])), 1 << 15, 12, 16
    v = tilted(n, cosine)
    u = np.random.default_rng(4).random((2, count), dtype=np.float32)
    h = probe.run("directions", 6, alpha=alpha, n=repeated(n, count), v=repeated(v, count), u=u)[3:].astype(np.float64)
    assert abs((h * h).sum(axis=0) - 1).max() < 8 * 2.0**-23
    c, turn = around(h, n)
    tangent2 = (1 - np.minimum(c * c, 1)) / (c * c)
    w = alpha / np.sqrt(alpha**2 + tangent2)
    found = np.bincount(cells_of(np.clip(w, 0, 1 - 1e-12), turn, side), minlength=side**2)
    # The same cells by midpoints, fine^2 to a cell.
    points = (np.arange(side * fine) + 0.5) / (side * fine)
    cos_h = points / np.sqrt(points**2 + alpha**2 * (1 - points**2))
    t, b = frame_of(n)
    angle = 2 * np.pi * points
    beside = np.cos(angle) * (v @ t) + np.sin(angle) * (v @ b)
    v_h = cos_h[:, None] * (v @ n) + np.sqrt(1 - cos_h**2)[:, None] * beside[None, :]
    share = 2 * (points / cos_h)[:, None] * np.maximum(v_h, 0) / (v @ n) / (1 + masking(float(v @ n), alpha))
    expected = share.reshape(side, fine, side, fine).mean(axis=(1, 3)).ravel() / side**2
    assert expected.sum() == pytest.approx(1, abs=1e-4)
    expected *= count / expected.sum()
    # Cells that are too empty are counted as one.
    full = expected >= 8
    found, expected = np.append(found[full], found[~full].sum()), np.append(expected[full], expected[~full].sum())
    if expected[-1] < 5:
        found, expected = found[:-1], expected[:-1] * count / expected[:-1].sum()
        found = found * (expected.sum() / found.sum())
    assert chi_square(found, expected) < chi_square_limit(len(found) - 1)
