"""Cameras: from look-at parameters to the ray basis of DESIGN section 1, in float64, rounded once.

Everything here is written out in + - * / and `math`, so that it gives the same bits on every
machine. A sample (x, y) is in pixels, y down; x = i + 0.5 at the centre of pixel column i.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clrast.errors import UsageError
from clrast.scene.model import Camera

if TYPE_CHECKING:
    from clrast.scene.model import Scene

Vector = tuple[float, float, float]

PARALLEL_SINE = 1e-7
"""`up` within this sine of the view direction counts as parallel to it."""


SMALLEST_TANGENT = 2.0**-100
"""Below it the inverse axes of a pixel leave float32's range."""


def _subtract(a: Vector, b: Vector) -> Vector:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def _scale(a: Vector, s: float) -> Vector:
    return (a[0] * s, a[1] * s, a[2] * s)


def _add(*vectors: Vector) -> Vector:
    x, y, z = vectors[0]
    for v in vectors[1:]:
        x, y, z = x + v[0], y + v[1], z + v[2]
    return (x, y, z)


def _cross(a: Vector, b: Vector) -> Vector:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _normalize(a: Vector) -> Vector:
    largest = max(abs(a[0]), abs(a[1]), abs(a[2]))
    scaled = (a[0] / largest, a[1] / largest, a[2] / largest)
    return _scale(scaled, 1.0 / math.sqrt(_dot(scaled, scaled)))


def _float32(a: Vector) -> Vector:
    x, y, z = (float(np.float32(c)) for c in a)
    return (x, y, z)


PLANAR_PROJECTIONS = ("perspective", "orthographic")
"""Projections whose samples lie in a plane; edge functions are linear over it."""

MAX_FISHEYE_FOV = 360.0


@dataclass(frozen=True)
class CameraVectors:
    """The ray basis of a view for one image size; all values are float32 numbers.

    perspective: `origin` = e, `first` = d0, `tangent_x` = dx, `tangent_y` = dy.
    orthographic: `direction` = d, `first` = e0, `tangent_x` = ex, `tangent_y` = ey.
    others: `origin` = e, `direction` = forward, `tangent_x` = right, `tangent_y` = up; `first` is 0.
    rim : of a fisheye, the angle between forward and the disc's rim, in turns.
    """

    projection: str
    width: int
    height: int
    origin: Vector
    direction: Vector
    first: Vector
    tangent_x: Vector
    tangent_y: Vector
    rim: float = 0.0

    @property
    def is_planar(self) -> bool:
        """Whether rays are linear in the sample's place."""
        return self.projection in PLANAR_PROJECTIONS

    def named(self) -> dict[str, list[float]]:
        """The vectors under the names of the stats' `camera` entry."""
        if self.projection == "orthographic":
            return {
                "d": list(self.direction),
                "e0": list(self.first),
                "ex": list(self.tangent_x),
                "ey": list(self.tangent_y),
            }
        if not self.is_planar:
            return {
                "e": list(self.origin),
                "right": list(self.tangent_x),
                "up": list(self.tangent_y),
                "forward": list(self.direction),
            }
        return {
            "e": list(self.origin),
            "d0": list(self.first),
            "dx": list(self.tangent_x),
            "dy": list(self.tangent_y),
        }

    def center(self) -> Vector:
        """d (perspective) or ray origin (orthographic) of the image's centre, float64."""
        return _add(self.first, _scale(self.tangent_x, self.width / 2), _scale(self.tangent_y, self.height / 2))


def view_basis(camera: Camera) -> tuple[Vector, Vector, Vector]:
    """Forward, right and up of a camera, unit, float64, world space (DESIGN section 1).

    Raises UsageError where eye and look-at coincide, up is parallel to the view, or a value is not finite.
    """
    for name, value in (("eye", camera.eye), ("look-at", camera.look_at), ("up", camera.up)):
        if not all(math.isfinite(c) for c in value):
            raise UsageError(f"camera '{camera.name}': {name} is not finite: give three finite numbers")
    toward = _subtract(camera.look_at, camera.eye)
    if toward == (0.0, 0.0, 0.0) or not all(math.isfinite(c) for c in toward):
        raise UsageError(f"camera '{camera.name}': eye equals look-at ({camera.eye}): move one of them")
    forward = _normalize(toward)
    if camera.up == (0.0, 0.0, 0.0):
        raise UsageError(f"camera '{camera.name}': up is 0,0,0: give a direction, such as 0,1,0")
    side = _cross(forward, _normalize(camera.up))
    if math.sqrt(_dot(side, side)) < PARALLEL_SINE:
        raise UsageError(f"camera '{camera.name}': up {camera.up} is parallel to the view direction: choose another up")
    right = _normalize(side)
    return forward, right, _cross(right, forward)


def camera_vectors(camera: Camera, width: int, height: int) -> CameraVectors:
    """The ray basis of `camera` for an image of `width` x `height` pixels.

    Raises UsageError for a degenerate camera.
    """
    forward, right, up = view_basis(camera)
    if camera.projection not in PLANAR_PROJECTIONS:
        return _curved_vectors(camera, width, height, forward, right, up)
    if camera.projection == "orthographic":
        if not (math.isfinite(camera.height) and camera.height > 0):
            raise UsageError(f"camera '{camera.name}': height {camera.height} must be positive")
        half = camera.height / 2
    else:
        if not 0 < camera.fov < 180:
            raise UsageError(f"camera '{camera.name}': fov {camera.fov} must lie between 0 and 180 degrees")
        half = math.tan(math.radians(camera.fov) / 2)
    tangent_x = _scale(right, 2 * half / height)
    tangent_y = _scale(up, -2 * half / height)
    corner = _add(_scale(right, -half * width / height), _scale(up, half))
    base = camera.eye if camera.projection == "orthographic" else forward
    smallest = min(max(map(abs, _float32(tangent))) for tangent in (tangent_x, tangent_y))
    if smallest < SMALLEST_TANGENT:
        raise UsageError(f"camera '{camera.name}': its view is too small for float32: give a larger fov or height")
    return CameraVectors(
        projection=camera.projection,
        width=width,
        height=height,
        origin=_float32(camera.eye),
        direction=_float32(forward),
        first=_float32(_add(base, corner)),
        tangent_x=_float32(tangent_x),
        tangent_y=_float32(tangent_y),
    )


def _curved_vectors(
    camera: Camera, width: int, height: int, forward: Vector, right: Vector, up: Vector
) -> CameraVectors:
    """The ray basis of a view that is not planar."""
    rim = 0.0
    if camera.projection == "fisheye":
        if not 0 < camera.fov <= MAX_FISHEYE_FOV:
            raise UsageError(f"camera '{camera.name}': a fisheye's fov {camera.fov} must lie between 0 and 360 degrees")
        rim = float(np.float32(camera.fov / 720))
        if rim < SMALLEST_TANGENT:
            raise UsageError(f"camera '{camera.name}': its view is too small for float32: give a larger fov")
    return CameraVectors(
        projection=camera.projection,
        width=width,
        height=height,
        origin=_float32(camera.eye),
        direction=_float32(forward),
        first=(0.0, 0.0, 0.0),
        tangent_x=_float32(right),
        tangent_y=_float32(up),
        rim=rim,
    )


_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)

CUBE_FACES: tuple[tuple[str, Vector, Vector], ...] = (
    ("+X", _X, _Y),
    ("-X", _scale(_X, -1.0), _Y),
    ("+Y", _Y, _Z),
    ("-Y", _scale(_Y, -1.0), _scale(_Z, -1.0)),
    ("+Z", _Z, _Y),
    ("-Z", _scale(_Z, -1.0), _Y),
)
"""Faces of a cube map from top to bottom: name, forward and up in the world, as OpenEXR's ImfEnvmap.h lays them out."""


def cube_faces(camera: Camera) -> list[Camera]:
    """The six views of a cube map round a camera's eye, along the world's axes; its look-at and up are not used."""
    faces = []
    for name, forward, up in CUBE_FACES:
        # At the eye's own scale, so that the sum moves.
        reach = 2.0 ** math.frexp(max(1.0, *map(abs, camera.eye)))[1]
        target = _add(camera.eye, _scale(forward, reach))
        faces.append(Camera(f"{camera.name} {name}", "perspective", camera.eye, target, up, fov=90.0))
    return faces


def cube_vectors(camera: Camera) -> dict[str, list[float]]:
    """What the stats call the camera of a cube map: +Z lies forward, +Y up, so that +X lies to the left."""
    right, up, forward = _scale(_X, -1.0), _Y, _Z
    return {"e": list(_float32(camera.eye)), "right": [*right], "up": [*up], "forward": [*forward]}


def frame_scene(scene: Scene, width: int, height: int, projection: str = "perspective") -> Camera:
    """A camera that frames the whole scene from the front, a little to the right and above.

    The scene's bounding sphere (of its box) fits the narrower side of the image with a margin of 5 %.
    """
    low, high = scene.bounding_box()
    center = tuple(float((a + b) / 2) for a, b in zip(low, high, strict=True))
    radius = math.sqrt(sum(float(b - a) * float(b - a) for a, b in zip(low, high, strict=True))) / 2
    radius = radius if radius > 0 else 1.0
    toward = _normalize((0.5, 0.4, 1.0))
    half = math.radians(45.0) / 2
    narrow = math.atan(math.tan(half) * min(1.0, width / height))
    distance = 1.05 * radius / math.sin(narrow)
    eye = _add((center[0], center[1], center[2]), _scale(toward, distance))
    return Camera(
        name="framed",
        projection="orthographic" if projection == "orthographic" else "perspective",
        eye=eye,
        look_at=(center[0], center[1], center[2]),
        fov=45.0,
        height=2.1 * radius * max(1.0, height / width),
    )
