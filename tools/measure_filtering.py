#!/usr/bin/env python3
"""How far filtered textures are from many samples: mip maps, probes along the footprint, exact and coarse derivatives.

    python tools/measure_filtering.py
    python tools/measure_filtering.py --size 256x256 --reference ssaa:256 --pictures out/

A checker floor is seen by a pinhole, by a paraboloid, in a flat mirror, and in a ball. The rows:

    none         the full-size image (--effects derivatives=off)
    trilinear    one lookup between two mip maps, by the footprint's longer axis; derivatives exact or coarse
    anisotropic  up to 16 of them along the longer axis, by the shorter one: what `on` and `coarse` are

The error is the root mean square over R, G, B against the reference, which has no filter, of the pixels that show the
floor with all their neighbours (in mirrors: the mirror, where it shows the floor), so that no edge counts; `worst` is
that of the half of them where `none` is off most. Times are of whole frames, the least of a few, over that of `none`.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from patched_kernels import patched  # noqa: E402

from clrast.image.frame import Frame  # noqa: E402
from clrast.job import RenderJob  # noqa: E402
from clrast.opencl.device import Device, open_device  # noqa: E402
from clrast.opencl.layout import NO_HIT  # noqa: E402
from clrast.option_values import parse_size  # noqa: E402
from clrast.options import RenderOptions  # noqa: E402
from clrast.scene.camera import camera_vectors  # noqa: E402
from clrast.scene.model import Camera, Material, Scene, Texture, TextureUse  # noqa: E402
from clrast.scene.shapes import icosphere  # noqa: E402
from clrast.shading.effects import plan_effects  # noqa: E402

REFERENCE = "ssaa:1024"
FRAMES = 3
ONE_PROBE = {("texture_filter.clh", "#define MAX_PROBES 16\n"): "#define MAX_PROBES 1\n"}

Channels = dict[str, np.ndarray]


@dataclass(frozen=True)
class Filtering:
    """One row. state : of the effect `derivatives`. changes : of kernels, as `patched` takes them."""

    name: str
    state: str
    changes: Mapping[tuple[str, str], str] = field(default_factory=dict)


ROWS = (
    Filtering("none", "off"),
    Filtering("trilinear, coarse", "coarse", ONE_PROBE),
    Filtering("trilinear, exact", "on", ONE_PROBE),
    Filtering("anisotropic, coarse", "coarse"),
    Filtering("anisotropic, exact", "on"),
)


@dataclass(frozen=True)
class View:
    """What is measured. mirror : prim_ids from this one on are a mirror that shows the floor; 0: the floor is seen."""

    name: str
    scene: Scene
    camera: Camera
    mode: str = "cast"
    mirror: int = 0


FLOOR = np.array([[-60, 0, 60], [60, 0, 60], [60, 0, -60], [-60, 0, -60]], dtype=np.float32)
QUAD = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)
MIRROR = Material("mirror", (1.0, 1.0, 1.0, 1.0), metallic=1.0, roughness=0.0)


def make_scene(*mirrors: tuple[np.ndarray, np.ndarray, np.ndarray | None]) -> Scene:
    """The floor, unlit, squares of its checker a unit wide; and meshes that mirror: positions, triangles, normals."""
    squares = np.kron([[0, 1], [1, 0]], np.ones((32, 32)))
    texels = np.dstack([*[(40 + 200 * squares).astype(np.uint8)] * 3, np.full((64, 64), 255, np.uint8)])
    paint = TextureUse(0, transform=(60.0, 0.0, 0.0, 0.0, 60.0, 0.0), mipmap=True)
    meshes = [(FLOOR, QUAD, None), *mirrors]
    firsts = np.cumsum([0] + [len(positions) for positions, _, _ in meshes])
    counts = [len(triangles) for _, triangles, _ in meshes]
    corners = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], dtype=np.float32)
    normals = [np.zeros_like(positions) if n is None else n for positions, _, n in meshes]
    return Scene(
        positions=np.concatenate([positions for positions, _, _ in meshes]).astype(np.float32),
        triangles=np.concatenate([m[1] + first for m, first in zip(meshes, firsts, strict=False)]).astype(np.uint32),
        object_ids=np.repeat(np.arange(len(meshes)), counts).astype(np.uint32),
        material_ids=np.repeat(np.minimum(np.arange(len(meshes)), 1), counts).astype(np.uint32),
        uv=np.concatenate([corners, np.zeros((firsts[-1] - 4, 2), np.float32)]),
        normals=np.concatenate(normals).astype(np.float32) if mirrors else None,
        materials=(Material("floor", (1.0, 1.0, 1.0, 1.0), unlit=True, base_color_texture=paint), MIRROR),
        textures=(Texture("checker", texels, True),),
        environment=(0.0, 0.0, 0.0),
    )


def views() -> list[View]:
    wall = np.array([[-40, 0, -8], [40, 0, -8], [40, 9, -8], [-40, 9, -8]], dtype=np.float32)
    shape = icosphere(5)
    ball = 2 * 1.5 * shape.positions + np.array([0, 1.6, -4], np.float32), shape.triangles, shape.normals
    eye, up = (0.3, 2.0, 4.0), (0.1, 1.0, 0.0)
    ahead = (0.7, 1.0, -8.0)
    return [
        View("floor, pinhole", make_scene(), Camera("p", "perspective", eye, ahead, up, fov=60.0)),
        View("floor, paraboloid", make_scene(), Camera("d", "paraboloid", eye, (0.7, 0.5, 0.0), up)),
        View("mirror, pinhole", make_scene((wall, QUAD, None)),
             Camera("p", "perspective", eye, (0.7, 2.4, -8.0), up, fov=40.0), "whitted", 2),
        View("ball, pinhole", make_scene(ball),
             Camera("p", "perspective", eye, (0.0, 1.6, -4.0), up, fov=26.0), "whitted", 2),
    ]  # fmt: skip


def make_job(device: Device, view: View, options: RenderOptions) -> RenderJob:
    plan = plan_effects(view.scene, options.aov, options.effects, options.mode)
    return RenderJob(device, view.scene, camera_vectors(view.camera, *options.size), options, plan)


def frame_of(job: RenderJob, frames: int) -> tuple[Channels, float]:
    """What a job shows, and the least milliseconds of some frames after the first."""
    channels, times = job.allocate(), []
    for k in range(frames + 1):
        started = time.perf_counter()
        job.render_frame(channels, first=k == 0)
        times.append(1000 * (time.perf_counter() - started))
    return channels, min(times[1:], default=times[0])


def counted(ids: np.ndarray, reference: Channels, mirror: int) -> np.ndarray:
    """(H, W) bool: pixels that show the floor, or in a mirror the floor, with all their neighbours."""
    shows = (ids >= mirror) & (ids != NO_HIT)
    if mirror:
        shows &= reference["G"] > 0.02  # the checker's darkest; where nothing is mirrored it is black
    inside = shows.copy()
    for axis in (0, 1):
        for step in (-1, 1):
            inside &= np.roll(shows, step, axis)
    inside[[0, -1]] = inside[:, [0, -1]] = False
    return inside


def squares(found: Channels, reference: Channels) -> np.ndarray:
    """(H, W) mean square over R, G, B."""
    return np.mean([(found[c].astype(np.float64) - reference[c]) ** 2 for c in "RGB"], axis=0)


def kernels_of(row: Filtering, device: Device, folder: Path) -> AbstractContextManager[Device]:
    return patched(device, folder, row.changes) if row.changes else nullcontext(device)


def report(view: View, device: Device, given: argparse.Namespace, save: Callable[[str, Channels], None]) -> None:
    base = {"size": given.size, "mode": view.mode, "method": "3dr-binning"}
    options = RenderOptions(**base, aov="color,id", effects="derivatives=off", aa=given.reference)
    reference, _ = frame_of(make_job(device, view, options), 0)
    save(f"{view.name} {given.reference}", reference)
    shown: dict[str, tuple[Channels, float]] = {}
    for row in ROWS:
        options = RenderOptions(**base, aov="color,id", effects={"derivatives": row.state})
        with tempfile.TemporaryDirectory() as folder, kernels_of(row, device, Path(folder)) as own:
            shown[row.name] = frame_of(make_job(own, view, options), FRAMES)
        save(f"{view.name} {row.name}", shown[row.name][0])
    inside = counted(shown["none"][0]["id.prim"], reference, view.mirror)
    worst = squares(shown["none"][0], reference)
    half = inside & (worst >= np.median(worst[inside]))
    print(f"\n{view.name}: {int(inside.sum()):,} of {inside.size:,} pixels, against {given.reference}")
    print(f"{'textures':<21}{'RMSE':>8}{'of none':>9}{'worst':>8}{'time':>7}")
    plain = np.sqrt(worst[inside].mean())
    for name, (channels, ms) in shown.items():
        found = squares(channels, reference)
        error, there = (float(np.sqrt(found[where].mean())) for where in (inside, half))
        print(f"{name:<21}{error:8.4f}{error / plain:9.3f}{there:8.4f}{ms / shown['none'][1]:7.2f}", flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=lambda text: parse_size("--size", text), default=(160, 160))
    parser.add_argument("--reference", default=REFERENCE, help=f"a mode of --aa [default: {REFERENCE}]")
    parser.add_argument("--views", default="", help="those whose names have this text [default: all]")
    parser.add_argument("--device", default=None)
    parser.add_argument("--pictures", type=Path, help="a folder for a picture of each")
    given = parser.parse_args()

    def save(name: str, channels: Channels) -> None:
        if given.pictures is not None:
            given.pictures.mkdir(parents=True, exist_ok=True)
            file = name.replace(",", "").replace(" ", "-").replace(":", "") + ".png"
            Frame(channels, {}, {}).save(str(given.pictures / file))

    device = open_device(given.device)
    for view in views():
        if given.views in view.name:
            report(view, device, given, save)
    return 0


if __name__ == "__main__":
    sys.exit(main())
