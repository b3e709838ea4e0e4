"""Where a mesh of a card stands: its matrix, and the mesh, its lights and its cameras taken there.

A matrix is 12 floats, the upper three rows of a 4x4 one, row by row; it takes column vectors. All
arithmetic is float64, written out; positions are not rounded here.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from clrast.scene.gltf import transform_normals, transform_points
from clrast.scene.gltf_nodes import IDENTITY, Matrix, multiply, unit
from clrast.scene.model import Camera, Light, Scene

Vector = tuple[float, float, float]


def turn(axis: tuple[float, ...], degrees: float) -> Matrix:
    """The rotation by an angle, counter-clockwise for who looks against the axis; right angles are exact."""
    quarter, rest = divmod(degrees, 90.0)
    if rest == 0.0:
        c, s = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[int(quarter) % 4]
    else:
        c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    direction = unit((axis[0], axis[1], axis[2]))
    assert direction is not None
    x, y, z = direction
    d = 1.0 - c
    return (
        c + x * x * d, x * y * d - z * s, x * z * d + y * s, 0.0,
        y * x * d + z * s, c + y * y * d, y * z * d - x * s, 0.0,
        z * x * d - y * s, z * y * d + x * s, c + z * z * d, 0.0,
    )  # fmt: skip


def place(
    scale: tuple[float, ...], turns: list[tuple[tuple[float, ...], float]], translation: tuple[float, ...]
) -> Matrix:
    """Scale, then each turn (axis, degrees) in the order given, then move."""
    x, y, z = scale
    matrix: Matrix = (x, 0.0, 0.0, 0.0, 0.0, y, 0.0, 0.0, 0.0, 0.0, z, 0.0)
    for axis, degrees in turns:
        matrix = multiply(turn(axis, degrees), matrix)
    x, y, z = translation
    return multiply((1.0, 0.0, 0.0, x, 0.0, 1.0, 0.0, y, 0.0, 0.0, 1.0, z), matrix)


def place_scene(scene: Scene, world: Matrix) -> Scene:
    """`scene` with positions float64, taken to the world; a mirror keeps the order of vertices."""
    if world == IDENTITY:
        return scene
    normals = None if scene.normals is None else transform_normals(world, scene.normals).astype(np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        positions = transform_points(world, scene.positions)
    return dataclasses.replace(
        scene,
        positions=positions,
        normals=normals,
        lights=tuple(_place_light(light, world) for light in scene.lights),
        cameras=tuple(_place_camera(camera, world) for camera in scene.cameras),
    )


def _point(world: Matrix, p: Vector) -> Vector:
    x, y, z = (world[r] * p[0] + world[r + 1] * p[1] + world[r + 2] * p[2] + world[r + 3] for r in (0, 4, 8))
    return (x, y, z)


def _direction(world: Matrix, d: Vector, otherwise: Vector) -> Vector:
    x, y, z = (world[r] * d[0] + world[r + 1] * d[1] + world[r + 2] * d[2] for r in (0, 4, 8))
    return unit((x, y, z)) or otherwise


def _place_light(light: Light, world: Matrix) -> Light:
    """Moved and turned; intensity and range are the light's own, whatever the scale."""
    return dataclasses.replace(
        light,
        position=_point(world, light.position),
        direction=_direction(world, light.direction, light.direction),
    )


def _place_camera(camera: Camera, world: Matrix) -> Camera:
    """Moved and turned; an orthographic height grows with the scale along `up`."""
    up = unit(camera.up) or (0.0, 1.0, 0.0)
    x, y, z = (world[r] * up[0] + world[r + 1] * up[1] + world[r + 2] * up[2] for r in (0, 4, 8))
    stretch = math.sqrt(x * x + y * y + z * z)
    return dataclasses.replace(
        camera,
        eye=_point(world, camera.eye),
        look_at=_point(world, camera.look_at),
        up=unit((x, y, z)) or camera.up,
        height=camera.height * stretch if stretch > 0.0 else camera.height,
    )
