"""The suite's scenes: the same bits everywhere, of the size and the kind that they say, and whole on the way to disk.

What a camera sees is found here by float64 rays against every triangle, without the renderer.
"""

from __future__ import annotations

import hashlib
import importlib.util
import math
import os
import subprocess
import sys
from dataclasses import fields
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
import pytest

import clrast
from clrast.errors import OutputError, UsageError
from clrast.scene.camera import camera_vectors
from clrast.scene.model import Camera, Scene
from clrast.study import suite, suite_hall, suite_meshes, suite_statue, suite_teapots
from clrast.study.suite_meshes import Mesh

TOOL = Path(__file__).resolve().parents[1] / "tools" / "make_suite.py"
SMALL = 0.02
RAYS = 9
ARRAYS = ("positions", "triangles", "object_ids", "material_ids", "normals")
NAMES = tuple(suite.SUITE)


@lru_cache(maxsize=len(NAMES))
def small_scene(name: str) -> Scene:
    return suite.make_scene(name, SMALL)


def digest(scene: Scene) -> str:
    made = hashlib.sha256()
    for name in ARRAYS:
        made.update(getattr(scene, name).tobytes())
    return made.hexdigest()


# --- what a camera sees ----------------------------------------------------------------------------


class View:
    """Triangles in a camera's own axes, float64: x and y in pixels at depth 1.

    corners : (triangle_count, 3, 3), last axis x * depth, y * depth, depth
    """

    def __init__(self, scene: Scene, camera: Camera, side: int) -> None:
        v = camera_vectors(camera, side, side)
        axes = np.stack((v.tangent_x, v.tangent_y, v.first), axis=1).astype(np.float64)
        placed = (scene.positions.astype(np.float64) - np.array(v.origin)) @ np.linalg.inv(axes).T
        self.side = side
        self.corners = placed[scene.triangles]

    @cached_property
    def edges(self) -> np.ndarray:
        c = self.corners
        return np.stack([np.cross(c[:, (i + 1) % 3], c[:, (i + 2) % 3]) for i in range(3)])

    @cached_property
    def volume(self) -> np.ndarray:
        return (self.edges[0] * self.corners[:, 0]).sum(axis=1)

    def met(self, x: float, y: float) -> np.ndarray:
        """Numbers of the triangles that the ray through this viewport point meets in front of the eye."""
        values = self.edges[:, :, 0] * x + self.edges[:, :, 1] * y + self.edges[:, :, 2]
        ahead = np.where(self.volume > 0.0, 1.0, -1.0) * values
        return np.flatnonzero((ahead > 0.0).all(axis=0) & (self.volume != 0.0))

    def rays(self) -> list[np.ndarray]:
        """`met` of the centres of all pixels, row by row."""
        return [self.met(i + 0.5, j + 0.5) for j in range(self.side) for i in range(self.side)]


VIEWS = [(name, k) for name in NAMES for k in range(2)]


@lru_cache(maxsize=len(VIEWS))
def surfaces_met(name: str, camera: int) -> tuple[np.ndarray, ...]:
    """Triangles that each of RAYS x RAYS rays of a camera meets."""
    scene = small_scene(name)
    return tuple(View(scene, scene.cameras[camera], RAYS).rays())


def numpy_core():
    """numpy's own module of what it knows about the processor, by its name in this version."""
    return (np._core if hasattr(np, "_core") else np.core)._multiarray_umath


def cpu_features() -> dict[str, bool]:
    """Which of the processor's features numpy makes use of."""
    return numpy_core().__cpu_features__


# --- bits ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_a_scene_is_made_twice_alike_and_another_seed_makes_another(name: str) -> None:
    again, other = suite.make_scene(name, SMALL), suite.make_scene(name, SMALL, seed=7)
    assert digest(small_scene(name)) == digest(again)
    assert not np.array_equal(other.positions, again.positions)


def test_a_processor_without_wide_vectors_makes_the_same_scenes() -> None:
    """numpy picks its loops by the processor; with all of those switched off the bits must stay."""
    dispatched = [name for name in numpy_core().__cpu_dispatch__ if cpu_features()[name]]
    code = (
        "import sys; sys.path.insert(0, 'tests'); import test_suite as t\n"
        f"assert not any(t.cpu_features()[name] for name in {dispatched})\n"
        "print(*(t.digest(t.small_scene(name)) for name in t.NAMES))"
    )
    environment = {**os.environ, "NPY_DISABLE_CPU_FEATURES": " ".join(dispatched)}
    command = [sys.executable, "-W", "ignore", "-c", code]
    done = subprocess.run(command, cwd=TOOL.parents[1], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.split() == [digest(small_scene(name)) for name in NAMES]


@pytest.mark.parametrize("name", NAMES)
def test_a_card_reads_back_as_the_scene(name: str, tmp_path: Path) -> None:
    read, made = clrast.load(suite.write_scene(name, tmp_path, SMALL)), small_scene(name)
    for field in fields(Scene):
        ours, theirs = getattr(made, field.name), getattr(read, field.name)
        if field.name in ARRAYS:
            assert np.array_equal(ours, theirs) and ours.dtype == theirs.dtype, field.name
        else:
            assert ours == theirs, field.name


# --- size and kind ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_scenes_have_the_triangles_that_they_say(name: str) -> None:
    """The figure's grow with the surface that the lattice cuts: a tenth of it says what the whole has."""
    scale = 0.1 if name == "tiny" else 1.0
    assert suite.plan_scene(name, scale).triangle_count / scale == pytest.approx(
        suite.SUITE[name].triangle_count, rel=0.1
    )
    low, high = {
        "tiny": (1.0e6, 1.2e6), "teapots": (3e5, 5e5), "teapots-occluded": (5e5, 1e6),
        "hall": (1.5e5, 3e5), "city": (1.1e6, 1.3e6),
    }[name]  # fmt: skip
    assert low <= suite.SUITE[name].triangle_count <= high


@pytest.mark.parametrize("name", NAMES)
def test_plans_count_what_is_made(name: str) -> None:
    plan = suite.plan_scene(name, SMALL)
    scene = small_scene(name)
    counts = np.bincount(scene.object_ids, minlength=len(plan.parts)).tolist()
    assert counts == [part.triangle_count for part in plan.parts]
    assert min(counts) > 0


@pytest.mark.parametrize("name", NAMES)
def test_scenes_are_sound(name: str) -> None:
    scene = small_scene(name)
    assert scene.positions.dtype == np.float32 and np.isfinite(scene.positions).all()
    a, b, c = scene.triangles.T
    assert not ((a == b) | (b == c) | (c == a)).any()
    assert sorted(set(scene.material_ids.tolist())) == list(range(len(scene.materials)))
    assert len(set(scene.object_names)) == len(scene.object_names)
    assert [camera.name for camera in scene.cameras] in (["outside", "inside"], ["view", "inside"])
    assert scene.lights


@pytest.mark.parametrize(("name", "camera"), VIEWS)
def test_every_view_sees_something(name: str, camera: int) -> None:
    share = np.mean([len(met) > 0 for met in surfaces_met(name, camera)])
    if (name, camera) == ("tiny", 0):
        assert 0.2 < share < 0.6
    else:
        assert share > 0.75


def test_the_figure_is_seen_whole() -> None:
    side = 256
    x, y, depth = np.moveaxis(View(small_scene("tiny"), small_scene("tiny").cameras[0], side).corners, 2, 0)
    assert (depth > 0.0).all()
    for across in (x / depth, y / depth):
        assert 0.0 < across.min() and across.max() < side
    assert (y / depth).max() - (y / depth).min() > 0.8 * side


@pytest.mark.parametrize("name", NAMES)
def test_occluded_scenes_have_surfaces_one_behind_another(name: str) -> None:
    depths = [len(met) for met in surfaces_met(name, 0) if len(met)]
    assert (np.mean(depths) > 3.0) == suite.SUITE[name].occluded


@pytest.mark.parametrize("name", [name for name in NAMES if suite.SUITE[name].tiny])
def test_tiny_scenes_have_tiny_triangles(name: str) -> None:
    """A scene of a share of the triangles on as small a share of the pixels has triangles as large in pixels."""
    scale = 0.3 if name == "teapots-occluded" else 0.1
    scene = suite.make_scene(name, scale)
    view = View(scene, scene.cameras[0], round(1024 * math.sqrt(scale)))
    corners = view.corners[(view.corners[:, :, 2] > 0.0).all(axis=1)]
    flat = corners[:, :, :2] / corners[:, :, 2:]
    inside = flat[((flat > 0.0) & (flat < view.side)).all(axis=(1, 2))]
    (ax, ay), (bx, by) = (inside[:, 1] - inside[:, 0]).T, (inside[:, 2] - inside[:, 0]).T
    assert np.mean(np.abs(ax * by - ay * bx) / 2.0 < 2.0) > 0.5


@pytest.mark.parametrize("camera", [0, 1])
def test_triangles_of_the_hall_cross_the_plane_of_the_eye_and_are_seen(camera: int) -> None:
    scene = small_scene("hall")
    depth = View(scene, scene.cameras[camera], RAYS).corners[:, :, 2]
    crossing = (depth.min(axis=1) < 0.0) & (depth.max(axis=1) > 0.0)
    met = np.unique(np.concatenate(surfaces_met("hall", camera)))
    names = {scene.object_names[k] for k in scene.object_ids[met[crossing[met]]]}
    assert {"floor", "vault"} <= names


def test_the_hall_mixes_huge_triangles_with_small_ones() -> None:
    scene = small_scene("hall")
    p = scene.positions.astype(np.float64)[scene.triangles]
    areas = np.sqrt((np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]) ** 2).sum(axis=1)) / 2.0
    assert areas.max() == pytest.approx(suite_hall.LENGTH * suite_hall.AISLE)  # half the floor
    assert np.median(areas) < areas.max() / 1e4


# --- meshes ----------------------------------------------------------------------------------------


def is_closed(mesh: Mesh) -> bool:
    """Whether each directed edge has as many edges the other way."""
    a = mesh.triangles
    ahead = np.concatenate([a[:, [0, 1]], a[:, [1, 2]], a[:, [2, 0]]])
    count = len(mesh.positions)
    return np.array_equal(np.sort(ahead[:, 0] * count + ahead[:, 1]), np.sort(ahead[:, 1] * count + ahead[:, 0]))


def volume(mesh: Mesh) -> float:
    """Of a closed mesh; positive where its triangles go counter-clockwise from outside."""
    p = mesh.positions[mesh.triangles]
    return float((np.cross(p[:, 0], p[:, 1]) * p[:, 2]).sum() / 6.0)


SQUARE = ((-0.1, -0.2), (0.1, -0.2), (0.1, 0.2), (-0.1, 0.2))
HEXAGON = 1.5 * math.sqrt(3.0)
"""Area of the regular hexagon whose circle has the radius 1."""


@pytest.mark.parametrize(
    ("mesh", "expected"),
    [
        (suite_meshes.box((-1.0, 0.0, 2.0), (1.0, 3.0, 4.0)), 12.0),
        (suite_meshes.prism(((0.0, 0.0), (2.0, 0.0), (0.0, 1.0)), 3.0), 3.0),
        (suite_meshes.revolve(((2.0, 0.0), (2.0, 5.0)), 6), 4.0 * HEXAGON * 5.0),
        (suite_meshes.revolve(((1.0, 0.0), (1.0, 2.0)), 6, np.full((2, 6), 3.0)), 9.0 * HEXAGON * 2.0),
        (suite_meshes.sweep(((0.0, 0.0), (3.0, 4.0)), SQUARE), 0.08 * 5.0),
        # cut along the bisector a corner takes away on its inner side what it adds on its outer one
        (suite_meshes.sweep(((0.0, 0.0), (3.0, 0.0), (3.0, 2.0)), SQUARE), 0.08 * 5.0),
        (suite_meshes.sweep(((0.0, 0.0), (3.0, 0.0), (3.0, 2.0), (0.0, 2.0)), SQUARE, loop=True), 0.08 * 10.0),
        (suite_meshes.sweep(((0.0, 0.0), (2.0, 0.0)), SQUARE, sizes=(1.0, 2.0)), 0.08 * 2.0 * (1.0 + 2.0 + 4.0) / 3.0),
    ],
)  # fmt: skip
def test_solids_are_closed_and_hold_what_they_should(mesh: Mesh, expected: float) -> None:
    assert is_closed(mesh)
    assert volume(mesh) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("mesh"),
    [
        suite_teapots.teapot(0.05),
        *suite_hall.column(0.05),
        suite_hall.archivolt(0.05),
        suite_hall.rosette(0.05),
        suite_hall.baluster(0.05),
        suite_hall.chandelier(0.05),
    ],
)
def test_things_made_of_solids_are_closed(mesh: Mesh) -> None:
    assert is_closed(mesh)
    assert volume(mesh) > 0.0


def test_open_edges_are_noticed() -> None:
    mesh = suite_meshes.box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    assert not is_closed(Mesh(mesh.positions, mesh.triangles[1:]))
    assert not is_closed(Mesh(mesh.positions, np.concatenate([mesh.triangles[1:], mesh.triangles[:1, ::-1]])))


def test_the_figure_is_one_closed_skin() -> None:
    mesh = suite_statue.statue(90, 3)
    assert is_closed(mesh)
    assert 0.6 < volume(mesh) < 0.9  # cubic metres: a plinth of 0.64 m radius and a body of human size
    assert mesh.positions[:, 1].min() == pytest.approx(0.0, abs=0.02)
    assert mesh.positions[:, 1].max() == pytest.approx(suite_statue.HEIGHT, abs=0.03)


def test_a_surface_net_of_a_sphere_is_the_sphere_within_a_cell() -> None:
    radius, step = 0.8, 0.05

    def ball(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        return np.sqrt(x * x + y * y + z * z) - radius

    mesh = suite_statue.surface_net(ball, (-1.01, -1.02, -1.03), (1.0, 1.0, 1.0), step)
    assert is_closed(mesh)
    a, b, c = mesh.positions.T
    # a vertex is a mean of points of the sphere within one cell, whose diagonal is the longest chord: it lies
    # below the sphere by the height of that chord's arc at most (crossings are linear: off by less still)
    depth = radius - np.sqrt(radius * radius - 3.0 * step * step)
    distance = np.sqrt(a * a + b * b + c * c)
    assert distance.max() <= radius + 1e-12 and distance.min() >= radius - depth
    assert volume(mesh) == pytest.approx(4.0 / 3.0 * math.pi * radius**3, rel=3.0 * depth / radius)
    edges = len(mesh.triangles) * 3 // 2
    assert len(mesh.positions) - edges + len(mesh.triangles) == 2  # Euler: one skin, no handle


def test_a_curve_passes_through_its_points() -> None:
    points = ((0.0, 0.0), (1.0, 2.0), (3.0, 1.0), (4.0, 4.0))
    made = suite_meshes.curve(points, 30)
    assert len(made) == 31
    assert made[::10] == [pytest.approx(point) for point in points]


def test_parts_place_meshes_in_order() -> None:
    part = suite_meshes.Part("pair", "any")
    triangle = Mesh(np.eye(3), np.array([[0, 1, 2]]))
    part.add(triangle, suite_meshes.at(1.0, 2.0, 3.0, 2.0))
    part.add(triangle, suite_meshes.at(0.0, 0.0, 0.0, degrees=90.0))
    made = part.bake()
    assert part.triangle_count == 2
    assert made.triangles.tolist() == [[0, 1, 2], [3, 4, 5]]
    assert made.positions.tolist() == [[3, 2, 3], [1, 4, 3], [1, 2, 5], [0, 0, -1], [0, 1, 0], [1, 0, 0]]


# --- mistakes, and the tool ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("attic", 1.0, 0), 'no scene "attic": name one of tiny, teapots'),
        (("hall", 0.0, 0), "scale of a scene is 0: .*above 0 and up to 16"),
        (("hall", math.nan, 0), "scale of a scene is nan"),
        (("hall", 17.0, 0), "scale of a scene is 17"),
        (("hall", 1.0, -1), "seed is -1"),
    ],
)
def test_mistakes_are_named(arguments: tuple[str, float, int], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        suite.make_scene(*arguments)


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="file: cannot write the scene hall there"):
        suite.write_scene("hall", tmp_path / "file", SMALL)


def test_the_tool_writes_what_it_is_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    spec = importlib.util.spec_from_file_location("make_suite", TOOL)
    assert spec is not None and spec.loader is not None
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    assert tool.main(["--out", str(tmp_path), "--only", "teapots", "--scale", str(SMALL)]) == 0
    assert [path.name for path in tmp_path.glob("*.toml")] == ["teapots.toml"]
    assert digest(clrast.load(tmp_path / "teapots.toml")) == digest(small_scene("teapots"))
    assert tool.main(["--out", str(tmp_path / "more"), "--only", "hall,attic"]) == UsageError.exit_code
    assert 'no scene "attic"' in capsys.readouterr().err
    assert not (tmp_path / "more").exists()
