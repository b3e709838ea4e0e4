#!/usr/bin/env python3
"""Renders scenes and holds `id.prim` and `Z` against the exact answer in real arithmetic; exit 1 where a bar is broken.

    python tools/check_visibility.py                              every scene of ../shared/scenes, outside and inside
    python tools/check_visibility.py a.ply --views outside --random 4 --seed 7 --json report.json
    python tools/check_visibility.py a.glb --view nave:-10,-9,0:10,-8,0:70 --renderer midpoint

What is right comes from clrast/study/exact_visibility.py, which shares nothing with the kernels; what is wrong is
named by clrast/study/classify_visibility.py. Bars: no hole, no double hit along an edge; at most 1 sample in 20,000
given to the neighbour across an edge within float32 rounding; at most 1 in 100,000 anything else (holes, phantoms,
farther surfaces, ties, fans); Z within 1e-5 relative; camera vectors within one float32 step of the definition.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from float32_twin import RUNGS, render_twin  # noqa: E402
from reference import camera_vectors_float64, round_camera  # noqa: E402

from clrast.study.classify_visibility import Classification, classify  # noqa: E402
from clrast.study.double_hits import double_hits  # noqa: E402
from clrast.study.exact_visibility import ExactVisibility, exact_visibility  # noqa: E402

SCENES = ("bunny.ply", "dragon.ply", "suzanne.obj", "teapot.obj", "sponza.glb", "sibenik.glb")
NEIGHBOUR_BAR, WRONG_BAR, DEPTH_BAR = 20_000, 100_000, 1e-5
EXACT_FILES = ("exact_visibility.py", "linear_forms.py")

Vector = tuple[float, float, float]
Frame = tuple[np.ndarray, np.ndarray, dict[str, list[float]]]


@dataclass(frozen=True)
class View:
    """A camera to check. `fov` : degrees; `height` : of an orthographic view, world units, else None."""

    name: str
    eye: Vector
    look_at: Vector
    up: Vector = (0.0, 1.0, 0.0)
    fov: float = 45.0
    height: float | None = None


def vector(values: Sequence[float]) -> Vector:
    x, y, z = (float(value) for value in values)
    return x, y, z


def standard_views(low: np.ndarray, high: np.ndarray) -> dict[str, View]:
    """Views from a scene's bounding box: `outside`, `inside` (from its centre along its length), `orthographic`."""
    centre, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    side = np.array([0.5, 0.35, 1.0])
    far = centre + side * (2.4 * radius / float(np.linalg.norm(side)))
    along = np.array([1.0, 0.0, 0.0]) if high[0] - low[0] >= high[2] - low[2] else np.array([0.0, 0.0, 1.0])
    middle, away = vector(centre), vector(far)
    return {
        "outside": View("outside", away, middle),
        "inside": View("inside", middle, vector(centre + along * radius), fov=60.0),
        "orthographic": View("orthographic", away, middle, height=1.5 * radius),
    }


def random_views(low: np.ndarray, high: np.ndarray, count: int, seed: int) -> list[View]:
    """Eyes anywhere within twice the bounding box, looking at a point inside it, with a fov of 20 to 90 degrees."""
    rng, found = np.random.default_rng(seed), []
    centre, half = (low + high) / 2, (high - low) / 2
    for k in range(count):
        eye = centre + half * rng.uniform(-2, 2, 3)
        target = centre + half * rng.uniform(-0.8, 0.8, 3)
        found.append(View(f"random{k}", vector(eye), vector(target), fov=float(rng.uniform(20, 90))))
    return found


def parse_view(text: str) -> View:
    """NAME:EX,EY,EZ:LX,LY,LZ[:FOV]"""
    parts = text.split(":")
    try:
        eye, look_at = (vector([float(c) for c in part.split(",")]) for part in parts[1:3])
        return View(parts[0], eye, look_at, fov=float(parts[3]) if len(parts) > 3 else 45.0)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"'{text}' is not NAME:EX,EY,EZ:LX,LY,LZ[:FOV]") from error


def view_vectors(view: View, size: tuple[int, int]) -> dict[str, list[float]]:
    """The camera vectors of a view by the definition, float64."""
    return camera_vectors_float64(view.eye, view.look_at, view.up, *size, fov=view.fov, view_height=view.height)


def part_of(scene: Any, chosen: np.ndarray) -> Any:
    """The scene with some of its triangles only."""
    rows = {name: getattr(scene, name)[chosen] for name in ("triangles", "object_ids", "material_ids")}
    return replace(scene, **rows)


def render_frame(scene: Any, view: View, size: tuple[int, int], options: argparse.Namespace) -> Frame:
    """(prim_id, Z, camera vectors) from the renderer or, with `--renderer RUNG`, from the float32 twin."""
    if options.renderer in RUNGS:
        vectors = round_camera(view_vectors(view, size))
        return (*render_twin(scene.positions, scene.triangles, vectors, *size, options.renderer), vectors)
    import clrast
    from clrast.scene.model import Camera

    projection: Literal["perspective", "orthographic"] = "perspective" if view.height is None else "orthographic"
    camera = Camera(view.name, projection, view.eye, view.look_at, view.up, view.fov, view.height or 2.0)
    extra = dict(pair.split("=", 1) for pair in options.option)
    frame = clrast.render(
        scene, camera=camera, size=size, aov=("id", "depth"), effects={"alpha mask": "off"}, **extra
    )
    return frame["id.prim"], frame["Z"], {name: list(v) for name, v in frame.stats["camera"].items()}


def cached_exact(
    scene: Any, camera: Mapping[str, Sequence[float]], size: tuple[int, int], folder: Path | None
) -> ExactVisibility:
    """The exact answer, kept in `folder` under a hash of its inputs and of the code that finds it."""
    if folder is None:
        return exact_visibility(scene.positions, scene.triangles, camera, *size)
    key = hashlib.sha256(repr((sorted((k, list(v)) for k, v in camera.items()), size)).encode())
    for array in (scene.positions, scene.triangles.astype(np.uint32)):
        key.update(repr(array.shape).encode() + np.ascontiguousarray(array).tobytes())
    for name in EXACT_FILES:
        key.update((ROOT / "clrast" / "study" / name).read_bytes())
    file = folder / f"{key.hexdigest()[:32]}.npz"
    if file.exists():
        with np.load(file) as known:
            counts = (int(known["contested_count"]), int(known["pair_count"]))
            return ExactVisibility(known["prim_id"], known["t"], *counts)
    found = exact_visibility(scene.positions, scene.triangles, camera, *size)
    folder.mkdir(parents=True, exist_ok=True)
    partial = file.with_suffix(".partial.npz")
    np.savez_compressed(partial, **asdict(found))
    partial.replace(file)
    return found


def camera_steps(found: Mapping[str, Sequence[float]], expected: Mapping[str, Sequence[float]]) -> float:
    """Largest distance of a camera vector from the float64 definition, in float32 steps of its largest component."""
    if set(found) != set(expected):
        return float("inf")
    worst = 0.0
    for name, values in expected.items():
        for value, right in zip(found[name], values, strict=True):
            # What cancels to nearly nothing in float64 may differ by a few of its own roundings.
            slack = 4e-16 * max(abs(c) for c in values)
            worst = max(worst, (abs(value - right) - slack) / float(np.spacing(np.float32(abs(right)))))
    return worst


@dataclass(frozen=True)
class Result:
    """The figures of one view; `broken` names the bars that it breaks."""

    scene: str
    view: str
    samples: int
    hits: int
    right: int
    neighbours: int
    holes_along_edges: int
    double_hits_along_edges: int | None
    double_hits_elsewhere: int | None
    wrong: dict[str, int]
    depth_error: float
    depth_worst: tuple[int, int] | None
    neighbour_pixels: float
    camera_steps: float
    seconds_exact: float
    broken: list[str]
    examples: list[dict[str, Any]]


def broken_bars(judged: Classification, doubles: int | None, doubled: int | None, steps: float) -> list[str]:
    """The names of the bars that a view breaks."""
    checks = {
        "holes along edges": judged.hole_along_edge_count > 0,
        "double hits along edges": bool(doubles),
        "neighbours": judged.neighbour_count > judged.sample_count / NEIGHBOUR_BAR,
        "wrong surfaces": judged.wrong_surface_count + (doubled or 0) > judged.sample_count / WRONG_BAR,
        "Z": not judged.depth_error <= DEPTH_BAR,
        "camera": not steps <= 1.0,
    }
    return [name for name, is_broken in checks.items() if is_broken]


def check_view(name: str, scene: Any, view: View, options: argparse.Namespace) -> Result:
    """Render one view, judge it, and look for double hits."""
    size = options.size
    prim_id, depth, camera = render_frame(scene, view, size, options)
    start = time.perf_counter()
    exact = cached_exact(scene, camera, size, options.cache)
    seconds = time.perf_counter() - start
    judged = classify(scene.positions, scene.triangles, camera, exact, prim_id, depth)
    along = elsewhere = None
    if not options.no_double_hits:
        render: Callable[[np.ndarray], np.ndarray] = lambda chosen: render_frame(  # noqa: E731
            part_of(scene, chosen), view, size, options
        )[0]
        doubles = double_hits(render, scene.positions, scene.triangles, camera)
        elsewhere = sum(one.place == "vertex" for one in doubles)
        along = len(doubles) - elsewhere
    steps = camera_steps(camera, view_vectors(view, size))
    others = [one for one in judged.differences if one.kind != "neighbour"]
    return Result(
        scene=name,
        view=view.name,
        samples=judged.sample_count,
        hits=judged.hit_count,
        right=judged.right_count,
        neighbours=judged.neighbour_count,
        holes_along_edges=judged.hole_along_edge_count,
        double_hits_along_edges=along,
        double_hits_elsewhere=elsewhere,
        wrong={f"{kind}, {place}": n for (kind, place), n in sorted(judged.counts.items()) if kind != "neighbour"},
        depth_error=judged.depth_error,
        depth_worst=judged.depth_worst,
        neighbour_pixels=max((one.edge_pixels for one in judged.differences if one.kind == "neighbour"), default=0.0),
        camera_steps=steps,
        seconds_exact=seconds,
        broken=broken_bars(judged, along, elsewhere, steps),
        examples=[asdict(one) for one in others[: options.examples]],
    )


def one_in(count: int, samples: int) -> str:
    return f"{count} (1 in {samples // count:,})" if count else "0"


def row(result: Result) -> list[str]:
    """The cells of a result."""
    doubles = "-" if result.double_hits_along_edges is None else str(result.double_hits_along_edges)
    wrong = ", ".join(f"{n} {what.replace(', ', '/')}" for what, n in result.wrong.items())
    total = sum(result.wrong.values()) + (result.double_hits_elsewhere or 0)
    if result.double_hits_elsewhere:
        wrong += f", {result.double_hits_elsewhere} double/vertex"
    return [
        result.scene,
        result.view,
        f"{result.samples:,}",
        f"{result.right:,}",
        one_in(result.neighbours, result.samples),
        str(result.holes_along_edges),
        doubles,
        one_in(total, result.samples) + (f": {wrong.strip(', ')}" if wrong else ""),
        f"{result.depth_error:.2g}",
        "BROKEN: " + ", ".join(result.broken) if result.broken else "ok",
    ]


COLUMNS = ("scene", "view", "samples", "right", "neighbours", "edge holes", "edge doubles", "wrong", "Z error", "bars")


def print_table(results: Sequence[Result]) -> None:
    """Plain columns: the same in a terminal and in a log."""
    rows = [list(COLUMNS), *(row(result) for result in results)]
    widths = [max(len(cells[k]) for cells in rows) for k in range(len(COLUMNS))]
    for cells in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(cells, widths, strict=True)).rstrip())
    for result in results:
        for example in result.examples:
            print(f"{result.scene} {result.view}: {example}")


def parse_arguments(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", type=Path, help="scene files; default: those of ../shared/scenes")
    parser.add_argument("--views", default="outside,inside", help="of outside,inside,orthographic; may be empty")
    parser.add_argument("--view", action="append", default=[], type=parse_view, help="NAME:EX,EY,EZ:LX,LY,LZ[:FOV]")
    parser.add_argument("--random", type=int, default=0, metavar="N", help="N more views at random")
    parser.add_argument("--seed", type=int, default=0, help="of the random views")
    parser.add_argument("--size", default="512x512", help="WxH, default 512x512")
    parser.add_argument("--renderer", default="clrast", choices=("clrast", *RUNGS), help="or a float32 twin in numpy")
    parser.add_argument("--option", action="append", default=[], metavar="NAME=VALUE", help="passed to clrast.render")
    parser.add_argument("--no-double-hits", action="store_true", help="one render a view instead of four to eight")
    parser.add_argument("--examples", type=int, default=3, help="wrong samples to print for each view")
    parser.add_argument("--cache", type=Path, help="folder that keeps exact answers")
    parser.add_argument("--json", type=Path, help="write all figures to this file")
    options = parser.parse_args(arguments)
    width, _, height = options.size.partition("x")
    if not (width.isdigit() and height.isdigit() and int(width) and int(height)):
        parser.error(f"--size {options.size}: give WIDTHxHEIGHT, such as 512x512")
    options.size = (int(width), int(height))
    unknown = set(filter(None, options.views.split(","))) - {"outside", "inside", "orthographic"}
    if unknown:
        parser.error(f"--views {','.join(sorted(unknown))}: choose from outside,inside,orthographic")
    return options


def main(arguments: Sequence[str] | None = None) -> int:
    """0: all bars hold; 1: one is broken; 66: no scene was found."""
    options = parse_arguments(arguments)
    paths = options.scenes or [ROOT.parent / "shared" / "scenes" / name for name in SCENES]
    missing = [path for path in paths if not path.exists()]
    for path in missing:
        print(f"{path.name}: not there, left out", file=sys.stderr)
    if len(missing) == len(paths) or (missing and options.scenes):
        return 66
    import clrast

    results: list[Result] = []
    for path in paths:
        if path in missing:
            continue
        scene = clrast.load(path)
        low, high = scene.bounding_box()
        standard = standard_views(low, high)
        views = [standard[name] for name in options.views.split(",") if name]
        views += options.view + random_views(low, high, options.random, options.seed)
        for view in views:
            results.append(check_view(path.name, scene, view, options))
            print(f"{path.name} {view.name}: {results[-1].broken or 'ok'}", file=sys.stderr, flush=True)
    print_table(results)
    if options.json:
        options.json.write_text(json.dumps([asdict(result) for result in results], indent=1) + "\n")
    return 1 if any(result.broken for result in results) else 0


if __name__ == "__main__":
    sys.exit(main())
