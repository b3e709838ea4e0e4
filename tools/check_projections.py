#!/usr/bin/env python3
"""Renders scenes under projections that are no single plane and holds `id.prim` against exact arithmetic; exit 1 where
a bar is broken.

    python tools/check_projections.py                             scenes of ../shared/scenes and a ball, from inside
    python tools/check_projections.py a.ply --views inside,outside --precision midpoint,exact --size 512
    python tools/check_projections.py --projections paraboloid:incremental --json report.json

Each sample's direction, as `--aov ray` exports it, is held against each triangle in real arithmetic
(tests/curved_reference.py); the faces of a cube map, whose directions are linear and never rounded, by
clrast/study/exact_visibility.py. Neither shares anything with the kernels. Wrong samples are

    neighbour   the triangle across an edge that both share
    hole        nothing, or a surface farther by 1e-6 of the distance, at an edge that two triangles share and the eye
                sees them on different sides of; `rim` at any other edge, `vertex` near two edges
    tie         another surface, as near within 1e-6
    other       anything else, such as what is there alone in the image (a phantom)

and double hits samples of two such triangles, both of which cover it where each is rendered without the other. Bars:
`exact` 0 wrong; other rungs no hole, no double hit along an edge, and 1 wrong sample in 20,000.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import combinations
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # products here are small

import numpy as np  # noqa: E402

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tools"), str(ROOT / "tests")]

from check_visibility import NEIGHBOUR_BAR, SCENES, part_of, standard_views  # noqa: E402
from curved_reference import exact_image_by_blocks, rays_of  # noqa: E402
from curved_world import ball  # noqa: E402

from clrast.errors import ClrastError  # noqa: E402
from clrast.renderer import render  # noqa: E402
from clrast.scene.camera import camera_vectors, cube_faces  # noqa: E402
from clrast.scene.load import load  # noqa: E402
from clrast.scene.model import Camera, Scene  # noqa: E402
from clrast.study.classify_visibility import Classifier  # noqa: E402
from clrast.study.double_hits import render_part, unfolded_edge  # noqa: E402
from clrast.study.exact_visibility import NO_HIT, exact_visibility  # noqa: E402

PROJECTIONS = ("paraboloid", "paraboloid:incremental", "fisheye", "latlong", "cube")
VIEWS = ("inside", "outside")
WRONG_KINDS = ("neighbour", "hole", "rim", "vertex", "tie", "other")
NEAR_EDGE = 1e-5
"""Sine of the angle to an edge's plane below which float32 may be wrong; its bounds lie at 13 to 90 times 2^-24."""
SAME_DISTANCE = 1e-6
BALL = "ball"


@dataclass(frozen=True)
class View:
    """A camera, how edges are evaluated, by which method, and the image's size."""

    camera: Camera
    evaluation: str
    method: str
    size: tuple[int, int]

    @property
    def name(self) -> str:
        return f"{self.camera.name} {self.camera.projection}" + " by sums" * (self.evaluation != "direct")


@dataclass(frozen=True)
class Truth:
    """What is right for a view. eye : float64; d : (height, width, 3) float64, 0 where there is no sample."""

    eye: np.ndarray
    d: np.ndarray
    prim_id: np.ndarray


@dataclass(frozen=True)
class Result:
    """The figures of one view in one rung."""

    scene: str
    view: str
    precision: str
    samples: int
    hits: int
    wrong: dict[str, int]
    doubles: dict[str, int] | None
    broken: bool


def views_of(scene: Scene, options: argparse.Namespace) -> Iterator[View]:
    """From the middle of the bounding box along its length, and from outside it."""
    side = options.size
    for name in options.views.split(","):
        standard = standard_views(*scene.bounding_box())[name]
        for text in options.projections.split(","):
            projection, _, evaluation = text.partition(":")
            size = {"latlong": (side, side // 2), "cube": (side // 2, 3 * side)}.get(projection, (side, side))
            camera = Camera(name, projection, standard.eye, standard.look_at, standard.up, fov=270.0)  # type: ignore
            yield View(camera, evaluation or "direct", options.method, size)


def render_ids(scene: Scene, view: View, precision: str) -> dict[str, np.ndarray]:
    return render(
        scene, view.camera, size=view.size, aov=("id", "ray"), precision=precision, evaluation=view.evaluation,
        method=view.method, effects={"alpha mask": "off"},
    ).channels  # fmt: skip


def find_truth(scene: Scene, view: View) -> Truth:
    """The exact answer for every sample of a view."""
    if view.camera.projection != "cube":
        rays = rays_of(render_ids(scene, view, "midpoint"))
        eye = np.array(camera_vectors(view.camera, *view.size).origin)
        prim_id, _ = exact_image_by_blocks(scene.positions, scene.triangles, eye, *rays)
        return Truth(eye, rays[0].astype(np.float64), prim_id)
    directions, found, side = [], [], view.size[0]
    x, y = (np.arange(side) + 0.5)[None, :, None], (np.arange(side) + 0.5)[:, None, None]
    for face in cube_faces(view.camera):
        vectors = camera_vectors(face, side, side)
        d0, dx, dy = (np.array(v) for v in (vectors.first, vectors.tangent_x, vectors.tangent_y))
        directions.append(d0 + x * dx + y * dy)
        found.append(exact_visibility(scene.positions, scene.triangles, vectors.named(), side, side).prim_id)
    return Truth(np.array(vectors.origin), np.concatenate(directions), np.concatenate(found))


class Judge:
    """Says what kind of wrong a sample is; of one scene and eye."""

    def __init__(self, scene: Scene, eye: np.ndarray) -> None:
        any_view = {"e": eye.tolist(), "d0": [0.0, 0.0, -1.0], "dx": [1.0, 0.0, 0.0], "dy": [0.0, 1.0, 0.0]}
        self.classifier = Classifier(scene.positions, scene.triangles, any_view)  # sides are seen from the eye alone
        self.topology = self.classifier.topology
        self.colours = self.topology.colours()
        self.corners = scene.positions.astype(np.float64)[scene.triangles.astype(np.int64)] - eye

    def near_edges(self, prim_id: int, d: np.ndarray) -> list[int]:
        """Edges whose plane through the eye a direction lies in, within float32."""
        p, near = self.corners[prim_id], []
        for i in range(3):
            n = np.cross(p[(i + 2) % 3], p[(i + 1) % 3])
            # How far rounding turns a plane: more where the edge is short for its distance.
            size = np.linalg.norm(p[(i + 2) % 3]) * np.linalg.norm(p[(i + 1) % 3] - p[(i + 2) % 3])
            if abs(n @ d) <= NEAR_EDGE * max(size, float(np.linalg.norm(n))) * np.linalg.norm(d):
                near.append(i)
        return near

    def distance(self, prim_id: int, d: np.ndarray) -> float:
        """t of a triangle's plane."""
        p = self.corners[prim_id]
        n = np.cross(p[1] - p[0], p[2] - p[0])
        with np.errstate(divide="ignore", invalid="ignore"):
            return float((n @ p[0]) / (n @ d))

    def kind(self, right: int, given: int, d: np.ndarray) -> str:
        if NO_HIT not in (right, given) and self.topology.shared_edge(right, given) is not None:
            return "neighbour"
        if right == NO_HIT:
            near = self.near_edges(given, d)
            return "vertex" if len(near) > 1 else "rim" if near else "other"
        farther = given == NO_HIT or self.distance(given, d) > self.distance(right, d) * (1 + SAME_DISTANCE)
        near = self.near_edges(right, d)
        if not farther:
            return "tie" if self.distance(given, d) > self.distance(right, d) * (1 - SAME_DISTANCE) else "other"
        if len(near) != 1:
            return "vertex" if near else "other"
        across = self.topology.across(right, near[0])
        return "hole" if any(self.classifier.is_across(right, near[0], k, edge) for k, edge in across) else "rim"


def find_doubles(scene: Scene, view: View, precision: str, truth: Truth, judge: Judge) -> dict[str, int]:
    """Samples that two neighbours cover whom the eye sees on different sides of their edge, by place."""
    images = [
        render_part(lambda chosen: render_ids(part_of(scene, chosen), view, precision)["id.prim"], np.flatnonzero(own))
        for own in (judge.colours == k for k in range(judge.colours.max() + 1))
    ]
    found: Counter[str] = Counter()
    for first, second in combinations(images, 2):
        rows, columns = np.nonzero((first != NO_HIT) & (second != NO_HIT))
        a, b = first[rows, columns], second[rows, columns]
        shares = (judge.topology.places[a][:, :, None] == judge.topology.places[b][:, None, :]).sum((1, 2))
        for k in np.flatnonzero(shares >= 2).tolist():
            pair, d = (int(a[k]), int(b[k])), truth.d[rows[k], columns[k]]
            if unfolded_edge(judge.classifier, *pair) is None:
                continue
            near = [len(judge.near_edges(prim_id, d)) for prim_id in pair]
            found["edge" if max(near) <= 1 else "vertex"] += 1
    return dict(found)


def check(name: str, scene: Scene, view: View, precision: str, truth: Truth, judge: Judge, doubles: bool) -> Result:
    """One view of one scene in one rung."""
    ids = render_ids(scene, view, precision)["id.prim"]
    rows, columns = np.nonzero(ids != truth.prim_id)
    wrong: Counter[str] = Counter()
    for i, j in zip(rows.tolist(), columns.tolist(), strict=True):
        wrong[judge.kind(int(truth.prim_id[i, j]), int(ids[i, j]), truth.d[i, j])] += 1
    samples = int(truth.d.any(axis=-1).sum())
    twice = find_doubles(scene, view, precision, truth, judge) if doubles else None
    broken = wrong["hole"] > 0 or bool(twice and twice.get("edge")) or wrong.total() * NEIGHBOUR_BAR > samples
    if precision == "exact":
        broken = wrong.total() > 0 or bool(twice and sum(twice.values()))
    hits = int((truth.prim_id != NO_HIT).sum())
    return Result(name, view.name, precision, samples, hits, dict(wrong), twice, broken)


def show(result: Result) -> str:
    """A line of the table."""
    total = sum(result.wrong.values())
    kinds = ", ".join(f"{result.wrong[kind]} {kind}" for kind in WRONG_KINDS if kind in result.wrong)
    share = f" (1 in {result.samples // total:,}: {kinds})" if total else ""
    twice = "-" if result.doubles is None else str(result.doubles.get("edge", 0))
    if result.doubles and result.doubles.get("vertex"):
        twice += f" ({result.doubles['vertex']} at vertices)"
    state = "BROKEN" if result.broken else "ok"
    head = f"{result.scene:<13}{result.view:<29}{result.precision:<9}{result.samples:>9,}{result.hits:>9,}"
    return f"{head}  {state:<7}wrong {total}{share}; double hits {twice}"


def summary(precision: str, results: Sequence[Result]) -> str:
    """All views of a rung in a line."""
    total: Counter[str] = Counter()
    for r in results:
        total.update(r.wrong)
    worst = max((sum(r.wrong.values()) for r in results), default=0)
    kinds = ", ".join(f"{n} {kind}" for kind, n in total.items()) or "none"
    doubles = sum((r.doubles or {}).get("edge", 0) for r in results)
    return f"{precision}: {len(results)} views, {sum(r.samples for r in results):,} samples, {total.total()} wrong, " \
        f"at most {worst} in a view ({kinds}), {doubles} double hits along edges"  # fmt: skip


def scenes_of(paths: Sequence[Path]) -> Iterator[tuple[str, Scene]]:
    """Scenes by name; those that cannot be read are named."""
    shared = ROOT.parent / "shared" / "scenes"
    for path in paths or [Path(BALL), *(shared / name for name in SCENES)]:
        try:
            yield path.name, ball(5) if str(path) == BALL else load(path)
        except ClrastError as error:
            print(f"{path.name}: left out: {str(error).replace(str(shared), 'scenes')}", file=sys.stderr)


def parse_arguments(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", type=Path, help=f"files, or `{BALL}`, closed, of 8,192 triangles")
    parser.add_argument("--views", default="inside", help=f"of {','.join(VIEWS)}")
    parser.add_argument("--projections", default=",".join(PROJECTIONS), help=f"of {','.join(PROJECTIONS)}")
    parser.add_argument("--precision", default="midpoint,exact", help="rungs")
    parser.add_argument("--size", type=int, default=512, help="side, pixels; latlong SxS/2, cube faces of S/2")
    parser.add_argument("--method", default="3dr-binning", help="default: 3dr-binning; all give one image")
    parser.add_argument("--no-double-hits", action="store_true", help="one render of a view in place of several")
    parser.add_argument("--json", type=Path, help="write all figures to this file")
    options = parser.parse_args(arguments)
    for name, known in (("views", VIEWS), ("projections", PROJECTIONS)):
        unknown = set(getattr(options, name).split(",")) - set(known)
        if unknown:
            parser.error(f"--{name} {','.join(sorted(unknown))}: choose from {','.join(known)}")
    return options


def main(arguments: Sequence[str] | None = None) -> int:
    """0: all bars hold; 1: one is broken; 66: no scene was found."""
    options = parse_arguments(arguments)
    results: list[Result] = []
    for name, scene in scenes_of(options.scenes):
        truths: dict[tuple[str, str], Truth] = {}
        judges: dict[str, Judge] = {}
        for view in views_of(scene, options):
            key, started = (view.camera.name, view.camera.projection), time.perf_counter()
            truth = truths[key] = truths.get(key) or find_truth(scene, replace(view, evaluation="direct"))
            judge = judges[view.camera.name] = judges.get(view.camera.name) or Judge(scene, truth.eye)
            for precision in options.precision.split(","):
                results.append(check(name, scene, view, precision, truth, judge, not options.no_double_hits))
                print(show(results[-1]), flush=True)
            print(f"{name} {view.name}: {time.perf_counter() - started:.0f} s", file=sys.stderr, flush=True)
    for precision in options.precision.split(","):
        print(summary(precision, [r for r in results if r.precision == precision]))
    if options.json:
        options.json.write_text(json.dumps([asdict(r) for r in results], indent=1) + "\n", encoding="utf-8")
    return 66 if not results else int(any(r.broken for r in results))


if __name__ == "__main__":
    sys.exit(main())
