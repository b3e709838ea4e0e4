#!/usr/bin/env python3
"""Renders scenes by every method: those with 3D edges must agree bit for bit; exit 1 where they do not.

    python tools/check_methods.py                                  all of ../shared/scenes and the suite, 1024x1024
    python tools/check_methods.py a.glb --methods 3dr-full,raycast-bvh --size 512x512 --json report.json

Views: from outside and from inside (perspective). id.prim and Z of each method are held against 3dr-binning's. For 2D
edges and for the barycentric form every sample that differs must lie within float32 rounding of an edge of one of
the two triangles, or one of these must be seen edge-on within rounding, or both must be equally near within it. What
rounding can do is found by float64 twins of the formulas with running error bounds (tests/edge_twins.py), and for
3D edges by BOUND_SLACK of opencl/constants.py, derived in cl/setup_triangles.cl. METHOD:incremental is held against
direct evaluation in the same way, with INCREMENT_SLACK of constants.py for the sums.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tools"), str(ROOT / "tests")]

from check_visibility import standard_views  # noqa: E402
from edge_twins import Rounded, ViewTwin  # noqa: E402

from clrast.errors import ClrastError  # noqa: E402
from clrast.opencl.features import Edges  # noqa: E402
from clrast.opencl.layout import BOUND_SLACK, INCREMENT_SLACK, NO_HIT  # noqa: E402
from clrast.option_values import parse_size  # noqa: E402
from clrast.renderer import render  # noqa: E402
from clrast.scene.camera import CameraVectors, camera_vectors  # noqa: E402
from clrast.scene.load import load  # noqa: E402
from clrast.scene.model import Camera, Scene  # noqa: E402
from clrast.study.suite import SUITE, make_scene  # noqa: E402
from clrast.visibility.methods import METHODS  # noqa: E402

SUFFIXES = (".ply", ".obj", ".stl", ".off", ".glb", ".gltf")
REFERENCE = "3dr-binning"


@dataclass(frozen=True)
class Result:
    """One method on one view. edge_distance : the largest of a sample that is within rounding of an edge, in pixels."""

    scene: str
    view: str
    method: str
    ids: int
    depths: int
    near_edge: int = 0
    edge_on: int = 0
    tied: int = 0
    unexplained: int = 0
    edge_distance: float = 0.0


def sources(names: list[str]) -> Iterator[tuple[str, Scene]]:
    """Scenes by name: files, and scenes of the suite."""
    shared = ROOT.parent / "shared" / "scenes"
    if not names:
        names = [str(path) for path in sorted(shared.rglob("*")) if path.suffix in SUFFIXES] + list(SUITE)
    for name in names:
        if name in SUITE:
            yield name, make_scene(name)
            continue
        try:
            yield name.removeprefix(f"{shared}/"), load(name)
        except ClrastError as error:
            print(f"skipped: {str(error).replace(str(shared), 'scenes')}")


def cameras(scene: Scene) -> dict[str, Camera]:
    """The scene's own two views (of the suite), else from outside and inside its bounding box."""
    if scene.name in SUITE:
        return {camera.name: camera for camera in scene.cameras}
    views = standard_views(*scene.bounding_box())
    return {
        name: Camera(name, "perspective", views[name].eye, views[name].look_at, views[name].up, views[name].fov)
        for name in ("outside", "inside")
    }


def pixels_from_edge(corners: np.ndarray, d: np.ndarray, dx: np.ndarray, dy: np.ndarray) -> np.ndarray:
    """(count,) pixels from samples, of directions `d`, to the nearest edge; corners : (count, 3, 3), from the eye."""
    nearest = np.full(len(d), np.inf)
    for i in range(3):
        n = np.cross(corners[:, (i + 2) % 3], corners[:, (i + 1) % 3])
        with np.errstate(all="ignore"):
            nearest = np.fmin(nearest, abs((n * d).sum(1)) / np.hypot((n * dx).sum(1), (n * dy).sum(1)))
    return nearest


def pixels_of_sums(corners: np.ndarray, vectors: CameraVectors) -> np.ndarray:
    """(count,) pixels by which incremental sums may misplace the edge that suffers most; corners : from the eye."""
    e, d0, dx, dy = (np.array(v, dtype=np.float64) for v in vectors.named().values())
    center = d0 + vectors.width / 2 * dx + vectors.height / 2 * dy
    most = np.zeros(len(corners))
    for i in range(3):
        n = np.cross(corners[:, (i + 2) % 3], corners[:, (i + 1) % 3])
        gx, gy = abs(n @ dx), abs(n @ dy)
        terms = abs(n @ center) + gx * vectors.width / 2 + gy * vectors.height / 2
        with np.errstate(all="ignore"):
            most = np.fmax(most, INCREMENT_SLACK * terms / np.hypot(gx, gy))
    return most


def explain(
    scene: Scene, vectors: CameraVectors, edges: Edges, ids: np.ndarray, right: np.ndarray
) -> dict[str, Any]:
    """Why samples differ: an edge of either triangle within rounding, of 3D edges or of the method's own, a triangle
    seen edge-on within rounding, or two surfaces equally near within it."""
    rows, columns = np.nonzero(ids != right)
    e, d0, dx, dy = (np.array(v, dtype=np.float64) for v in vectors.named().values())
    x, y = columns + 0.5 - vectors.width / 2, rows + 0.5 - vectors.height / 2
    d = d0 + (columns[:, None] + 0.5) * dx + (rows[:, None] + 0.5) * dy
    focal = 1 / np.sqrt(min(dx @ dx, dy @ dy))
    bound = BOUND_SLACK * (focal + abs(x) + abs(y)) ** 2 / focal
    twin = ViewTwin(vectors)
    find = {Edges.PROJECTED: twin.projected, Edges.HOMOGENEOUS: twin.homogeneous, Edges.BARYCENTRIC: twin.barycentric}
    near, edge_on = np.zeros((2, len(rows)), dtype=bool)
    distance, nearness = np.full(len(rows), np.inf), []
    for prims in (ids[rows, columns], right[rows, columns]):
        found = prims != NO_HIT
        corners = scene.positions[scene.triangles[np.where(found, prims, 0)]].astype(np.float64)
        if edges == Edges.SPATIAL:  # incremental against direct: nearness is the same in both
            bound = bound + np.where(found, pixels_of_sums(corners - e, vectors), 0.0)
            nearness.append((np.where(found, np.inf, 0.0), 0.0))
            distance = np.where(found, np.fmin(distance, pixels_from_edge(corners - e, d, dx, dy)), distance)
            continue
        setup = find[edges](corners)
        for edge, hidden in zip(setup.edges, setup.hidden, strict=True):
            near |= found & ~hidden & ~at_samples(edge, x, y).is_certain()
        edge_on |= found & ~setup.is_certain()
        own = at_samples(setup.nearness, x, y)
        nearness.append((np.where(found, own.value, 0.0), np.where(found, own.error, 0.0)))
        distance = np.where(found, np.fmin(distance, pixels_from_edge(corners - e, d, dx, dy)), distance)
    near |= distance <= bound
    (a, a_error), (b, b_error) = nearness
    with np.errstate(all="ignore"):
        tied = ~near & ~edge_on & (abs(a - b) <= a_error + b_error)
    worst = int(np.argmax(np.where(near, distance, 0))) if len(rows) else 0
    return {
        "near_edge": int(near.sum()),
        "edge_on": int((edge_on & ~near).sum()),
        "tied": int(tied.sum()),
        "unexplained": int((~near & ~edge_on & ~tied).sum()),
        "edge_distance": float(distance[worst]) if near.any() else 0.0,
    }


def at_samples(coefficients: list[Rounded], x: np.ndarray, y: np.ndarray) -> Rounded:
    """A function over the screen at a sample of each triangle."""
    c, gx, gy = coefficients
    return (c + gx * x) + gy * y


def methods_of(names: str | None) -> list[tuple[str, dict[str, str]]]:
    """Methods with their options."""
    chosen = names.split(",") if names else [*METHODS, "raycast-brute:barycentric", "3dr-binning:incremental"]
    options = {"": {}, "barycentric": {"intersection": "barycentric"}, "incremental": {"evaluation": "incremental"}}
    split = [name.partition(":") for name in chosen]
    return [(name, options[kind]) for name, _, kind in split]


def check(
    name: str, scene: Scene, methods: list[tuple[str, dict[str, str]]], size: tuple[int, int]
) -> Iterator[Result]:
    """Every method on every view of a scene, against REFERENCE."""
    for view, camera in cameras(scene).items():
        common = {"size": size, "aov": ("id", "depth"), "effects": {"alpha mask": "off", "alpha blend": "off"}}
        try:
            right = render(scene, camera, method=REFERENCE, **common)
        except ClrastError as error:  # such as a single point, which has no inside
            print(f"skipped: {name}, {view}: {error}")
            continue
        for method, options in methods:
            if method == REFERENCE and not options:
                continue
            frame = render(scene, camera, method=method, **options, **common)
            ids = int((frame["id.prim"] != right["id.prim"]).sum())
            depths = int((frame["Z"] != right["Z"]).sum())
            edges = Edges.BARYCENTRIC if "intersection" in options else METHODS[method].edges
            vectors, why = camera_vectors(camera, *size), {}
            if edges != Edges.SPATIAL or options:
                why = explain(scene, vectors, edges, frame["id.prim"], right["id.prim"])
            label = ":".join([method, *options.values()])
            yield Result(name, view, label, ids, depths, **why)


def is_spatial(result: Result) -> bool:
    """Whether a method has 3D edges: then nothing may differ."""
    return ":" not in result.method and METHODS[result.method].edges == Edges.SPATIAL


def summary(results: list[Result]) -> str:
    """Comparisons and differing samples of both kinds, in a line."""
    same, others = [r for r in results if is_spatial(r)], [r for r in results if not is_spatial(r)]
    return (
        f"3D edges: {len(same)} compared, {sum(r.ids + r.depths for r in same)} samples differ; other edges: "
        f"{len(others)} compared, {sum(r.ids for r in others)} differ: {sum(r.near_edge for r in others)} within "
        f"rounding of an edge, {sum(r.edge_on for r in others)} edge-on, {sum(r.tied for r in others)} equally near, "
        f"{sum(r.unexplained for r in others)} unexplained"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", help="files, or names of the suite; all where none is named")
    parser.add_argument("--methods", help="comma list; with :barycentric or :incremental after a method")
    parser.add_argument("--size", default="1024x1024")
    parser.add_argument("--json", metavar="FILE")
    args = parser.parse_args()
    size, methods, results = parse_size("--size", args.size), methods_of(args.methods), []
    for name, scene in sources(args.scenes):
        started = time.perf_counter()
        found = list(check(name, scene, methods, size))
        results += found
        spent = time.perf_counter() - started
        print(f"{name}: {scene.triangle_count} triangles, {summary(found)} ({spent:.0f} s)", flush=True)
    print(f"{len(results)} comparisons: {summary(results)}")
    for method in sorted({r.method for r in results}):
        rows = [r for r in results if r.method == method]
        far = max(r.edge_distance for r in rows)
        print(f"  {method}: {sum(r.ids for r in rows)} ids, {sum(r.depths for r in rows)} depths differ; "
              f"within rounding of an edge at up to {far:.2g} pixels from it")  # fmt: skip
    if args.json:
        Path(args.json).write_text(json.dumps([asdict(r) for r in results], indent=1) + "\n", encoding="utf-8")
    return int(not results or any(r.unexplained or (is_spatial(r) and r.ids + r.depths) for r in results))


if __name__ == "__main__":
    sys.exit(main())
