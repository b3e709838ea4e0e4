"""Scenes for the tests of modes that trace rays from hits, and renders of them; nothing here says what is right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from kernel_world import make_scene, orthographic, start

from clrast.image.frame import Frame
from clrast.opencl.device import Device
from clrast.scene.camera import CameraVectors
from clrast.scene.model import Light, Material, Scene
from clrast.scene.shapes import box, icosphere

MIRROR = Material("mirror", (1.0, 1.0, 1.0, 1.0), metallic=1.0, roughness=0.0)
GLASS = Material("glass", (1.0, 1.0, 1.0, 1.0), roughness=0.0, transmission=1.0, ior=1.5)
CHALK = Material("chalk", (0.8, 0.6, 0.4, 1.0))

SHARED = {"reflection": "on", "refraction": "on", "emission": "on", "normal interpolation": "on"}
"""Effects switched on where a scene may not call for them: many tests run few programs."""

DARK = Light("dark", "point", (0.0, 0.0, 0.0))
"""A light without power: it stands in for the headlight, and paths never draw it."""

MASKED = {**SHARED, "textures": "on", "alpha mask": "on", "alpha blend": "on"}


@dataclass(frozen=True)
class Part:
    """A mesh of one material. positions : (n, 3); triangles : (m, 3); colors, normals, uv : per vertex, or None."""

    positions: np.ndarray
    triangles: np.ndarray
    material: Material
    colors: np.ndarray | None = None
    normals: np.ndarray | None = None
    uv: np.ndarray | None = None

    def moved(self, scale: float = 1.0, offset: Sequence[float] = (0, 0, 0)) -> Part:
        return replace(self, positions=self.positions * scale + np.asarray(offset, dtype=np.float64))


def square(corner: Sequence[float], u: Sequence[float], v: Sequence[float], material: Material, **fields: Any) -> Part:
    """A parallelogram of two triangles, front where u x v points to; vertices corner, +u, +u+v, +v."""
    c, u_, v_ = (np.asarray(each, dtype=np.float64) for each in (corner, u, v))
    return Part(np.array([c, c + u_, c + u_ + v_, c + v_]), np.array([(0, 1, 2), (0, 2, 3)]), material, **fields)


def floor(half: float, material: Material, height: float = 0.0, **fields: Any) -> Part:
    """A square in the plane z = height, seen from above."""
    return square((-half, -half, height), (2 * half, 0, 0), (0, 2 * half, 0), material, **fields)


def ball(subdivisions: int, radius: float, material: Material, smooth: bool = False) -> Part:
    """A convex closed mesh about the origin."""
    shape = icosphere(subdivisions)
    return Part(2 * radius * shape.positions, shape.triangles, material, normals=shape.normals if smooth else None)


def cube(half: float, material: Material) -> Part:
    """A closed box about the origin, normals outwards."""
    shape = box()
    return Part(2 * half * shape.positions, shape.triangles, material)


def assemble(*parts: Part, lights: Sequence[Light] = (), **fields: Any) -> Scene:
    """One scene of all parts; prim_ids in their order, a material each."""
    firsts = np.cumsum([0] + [len(part.positions) for part in parts])
    made: dict[str, Any] = {}
    for name, width, empty in (("colors", 4, 1.0), ("normals", 3, 0.0), ("uv", 2, 0.0)):
        rows = [getattr(part, name) for part in parts]
        if any(row is not None for row in rows):
            blank = [np.full((len(part.positions), width), empty) for part in parts]
            filled = [b if row is None else row for b, row in zip(blank, rows, strict=True)]
            made[name] = np.concatenate(filled).astype(np.float32)
    return make_scene(
        np.concatenate([part.positions for part in parts]),
        np.concatenate([part.triangles + first for part, first in zip(parts, firsts, strict=False)]),
        material_ids=np.repeat(np.arange(len(parts)), [len(part.triangles) for part in parts]).astype(np.uint32),
        materials=tuple(part.material for part in parts),
        lights=tuple(lights),
        **{**made, **fields},
    )


def downwards(side: int, width: float, height: float, at: Sequence[float] = (0, 0, 0)) -> CameraVectors:
    """side x side pixels over the square of that width about a point, seen along -z from so high above it."""
    step = width / side
    corner = (at[0] - width / 2, at[1] + width / 2, at[2] + height)
    return orthographic(side, side, corner, (0, 0, -1), (step, 0, 0), (0, -step, 0))


def looking(
    side: int, eye: Sequence[float], at: Sequence[float], step: float = 1.0 / 16, up: Sequence[float] = (0, 0, 1)
) -> CameraVectors:
    """A perspective view; `step` : a pixel's side at distance 1."""
    e, forward = np.asarray(eye, dtype=np.float64), np.asarray(at, dtype=np.float64) - np.asarray(eye, dtype=np.float64)
    forward /= np.sqrt((forward * forward).sum())
    right = np.cross(forward, up)
    right /= np.sqrt((right * right).sum())
    above = np.cross(right, forward)
    rounded = [tuple(float(np.float32(c)) for c in row) for row in (
        e, forward, forward - (right - above) * step * side / 2, right * step, -above * step
    )]  # fmt: skip
    return CameraVectors("perspective", side, side, *rounded)  # type: ignore[arg-type]


def parallel(side: int, width: float, direction: Sequence[float], distance: float) -> CameraVectors:
    """side x side pixels over a square of that width about the origin, seen along `direction` from a distance."""
    d = np.asarray(direction, dtype=np.float64)
    d /= np.sqrt((d * d).sum())
    right = np.cross(d, (0.0, 0.0, 1.0))
    right *= width / side / np.sqrt((right * right).sum())
    above = np.cross(right, d)
    corner = -distance * d - (right - above) * side / 2
    return orthographic(side, side, corner, d, right, -above)


def planned(device: Device, scene: Scene, view: CameraVectors, mode: str, **options: Any) -> Frame:
    """A render in a mode with the effects that it calls for, by tiles unless another method is asked for."""
    return start(device, scene, view, mode=mode, **{"method": "3dr-binning", **options})[1]


def traced(device: Device, scene: Scene, view: CameraVectors, mode: str, **options: Any) -> Frame:
    """`planned` with programs that many scenes share: the effects of SHARED beside those of `options`, and DARK."""
    if mode == "path" and not scene.lights:
        scene = replace(scene, lights=(DARK,))
    effects = {**(SHARED if mode != "cast" else {}), **options.pop("effects", {})}
    return planned(device, scene, view, mode, effects=effects, **options)


def color(frame: Frame) -> np.ndarray:
    """(height, width, 3) float32."""
    return np.stack([frame[c] for c in "RGB"], axis=2)


def rays_of(view: CameraVectors) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions (height, width, 3) float64 of the pixels' centres."""
    x, y = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    moved = np.array(view.first) + x[..., None] * np.array(view.tangent_x) + y[..., None] * np.array(view.tangent_y)
    if view.projection == "orthographic":
        return moved, np.broadcast_to(np.array(view.direction), moved.shape)
    return np.broadcast_to(np.array(view.origin), moved.shape), moved


def effect(frame: Frame, name: str) -> bool:
    return next(each["on"] for each in frame.stats["effects"] if each["name"] == name)


def rays(frame: Frame) -> dict[str, int]:
    """The counts of secondary rays, without `rays_`."""
    names = ("shadow", "reflection", "refraction", "indirect")
    return {name: frame.stats["counts"][f"rays_{name}"] for name in names}
