"""Which camera looks: the file's, one made of options, or one that frames the scene (DESIGN section 1).

--eye or --look-at make a new camera that replaces the file's wholly; what they leave open takes the
defaults: the eye that frames the scene, the centre of the bounding box, up 0,1,0, fov 45. Without
them the file's camera stays, and --projection, --up, --fov and --height replace those values of it.
An orthographic view without a height is as high as the perspective one is at its look-at point. A fisheye's fov is that
of its whole disc, 180 where none is given; a cube map has the axes of the world.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, cast

from clrast.errors import UsageError
from clrast.option_values import Vector, check_choice, did_you_mean, parse_fov, parse_number, parse_vector
from clrast.options import AVAILABLE_PROJECTIONS, PROJECTIONS
from clrast.scene.model import Camera, Projection, Scene

DEFAULT_UP = (0.0, 1.0, 0.0)
DEFAULT_FOV = 45.0
DEFAULT_FISHEYE_FOV = 180.0
UNUSED_OF = {
    "perspective": ("height",),
    "orthographic": ("fov",),
    "paraboloid": ("fov", "height"),
    "latlong": ("fov", "height"),
    "fisheye": ("height",),
    "cube": ("look_at", "up", "fov", "height"),
}
"""Options of a view that a projection has no use for."""
VIEW_NAMES = ("eye", "look_at", "up", "fov", "camera", "projection", "height")


@dataclass(frozen=True)
class View:
    """The options of a view that were given; None where one was not. `camera` : a name, an index or a Camera."""

    eye: Vector | None = None
    look_at: Vector | None = None
    up: Vector | None = None
    fov: float | None = None
    height: float | None = None
    projection: str | None = None
    camera: str | int | Camera | None = None

    @property
    def makes_camera(self) -> bool:
        return self.eye is not None or self.look_at is not None


@dataclass(frozen=True)
class Choice:
    """The camera taken, and lines to say about it: notes, and warnings of options without effect."""

    camera: Camera
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def make_view(values: Mapping[str, Any]) -> View:
    """Check the options of a view, as values or as text; raises UsageError."""
    parsers: dict[str, Any] = {"eye": parse_vector, "look_at": parse_vector, "up": parse_vector, "fov": parse_fov}
    given: dict[str, Any] = {name: value for name, value in values.items() if value is not None}
    for name, parse in parsers.items():
        if name in given:
            more = (given.get("projection"),) if name == "fov" else ()
            given[name] = parse("--" + name.replace("_", "-"), given[name], *more)
    if "height" in given:
        given["height"] = parse_number("--height", given["height"], "a number above 0", above=0.0)
    if "projection" in given:
        check_choice("--projection", given["projection"], PROJECTIONS, AVAILABLE_PROJECTIONS)
    view = View(**given)
    if view.camera is not None and view.makes_camera:
        raise UsageError("--camera contradicts --eye and --look-at, which make a camera of their own: give one of them")
    if view.up == (0.0, 0.0, 0.0):
        raise UsageError("--up 0,0,0 has no direction: give one, such as 0,1,0")
    if view.eye is not None and view.look_at is not None and view.projection != "cube":
        check_camera(Camera(name="given", eye=view.eye, look_at=view.look_at, up=view.up or DEFAULT_UP))
    return view


def check_camera(camera: Camera) -> None:
    """Raises UsageError where eye and look-at coincide, or up is parallel to the view."""
    from clrast.scene.camera import view_basis

    view_basis(camera)


def choose_camera(scene: Scene, view: View, size: tuple[int, int], source: str) -> Choice:
    """The camera for `scene` and the options given; raises UsageError.

    size : (width, height) pixels. source : what messages call the scene.
    """
    if view.makes_camera:
        base, notes = _new_camera(scene, view, size)
    elif isinstance(view.camera, Camera):
        base, notes = view.camera, ()
    elif view.camera is not None or scene.cameras:
        named = view.camera is not None
        base, notes = (_named_camera(scene, view.camera, source) if named else scene.cameras[0]), ()
    else:
        base, notes = _framing_camera(scene, view, size, source)
    camera, warnings = _apply(base, view)
    if camera.projection != "cube":
        check_camera(camera)
    return Choice(camera, notes, warnings)


def _new_camera(scene: Scene, view: View, size: tuple[int, int]) -> tuple[Camera, tuple[str, ...]]:
    """A camera of --eye and --look-at with the defaults for the rest."""
    notes: tuple[str, ...] = ()
    eye, look_at = view.eye, view.look_at
    if look_at is None:
        low, high = scene.bounding_box()
        x, y, z = ((float(a) + float(b)) / 2 for a, b in zip(low, high, strict=True))
        look_at = (x, y, z)
    if eye is None:
        eye = _frame(scene, size, "perspective").eye
        notes = (f"no --eye given: looking from {_numbers(eye)}, from where the whole scene is in view",)
    distance = math.dist(eye, look_at)
    height = 2 * distance * math.tan(math.radians(DEFAULT_FOV) / 2)
    return Camera("given", "perspective", eye, look_at, DEFAULT_UP, DEFAULT_FOV, height), notes


def _named_camera(scene: Scene, wanted: str | int | None, source: str) -> Camera:
    """The file's camera of that name, else of that index."""
    names = [camera.name for camera in scene.cameras]
    if isinstance(wanted, str) and wanted in names:
        return scene.cameras[names.index(wanted)]
    digits = str(wanted)
    if digits.isascii() and digits.isdigit() and int(digits) < len(names):
        return scene.cameras[int(digits)]
    if not names:
        raise UsageError(f"--camera {wanted!r}: {source} brings no camera: leave it out, or give --eye")
    table = ", ".join(f"{index} '{name}'" for index, name in enumerate(names))
    raise UsageError(f"--camera {wanted!r} is not in {source}: it has {table}{did_you_mean(digits, names)}")


def _framing_camera(scene: Scene, view: View, size: tuple[int, int], source: str) -> tuple[Camera, tuple[str, ...]]:
    """A camera that shows the whole scene, as far away as its --fov needs."""
    projection = view.projection or "perspective"
    camera = _frame(scene, size, projection)
    if view.fov is not None and projection == "perspective":
        aspect = min(1.0, size[0] / size[1])
        sine = [math.sin(math.atan(math.tan(math.radians(fov) / 2) * aspect)) for fov in (camera.fov, view.fov)]
        nearer = sine[0] / sine[1]
        x, y, z = (c + (e - c) * nearer for e, c in zip(camera.eye, camera.look_at, strict=True))
        camera = replace(camera, eye=(x, y, z), fov=view.fov)
    where = f"--eye {_numbers(camera.eye)} --look-at {_numbers(camera.look_at)}"
    return camera, (f"{source} brings no camera: framing the whole scene ({where})",)


def _frame(scene: Scene, size: tuple[int, int], projection: str) -> Camera:
    from clrast.scene.camera import frame_scene

    return frame_scene(scene, size[0], size[1], projection=projection)


def _apply(base: Camera, view: View) -> tuple[Camera, tuple[str, ...]]:
    """`base` with the values given; those that its projection does not use become warnings."""
    projection = view.projection or base.projection
    up = view.up or base.up
    warnings = tuple(
        f"--{unused.replace('_', '-')} is ignored: the {projection} projection does not use it"
        for unused in UNUSED_OF[projection]
        if getattr(view, unused) is not None
    )
    height = base.height
    if projection == "orthographic":
        if view.height is not None:
            height = view.height
        elif base.projection == "perspective":
            height = 2 * math.dist(base.eye, base.look_at) * math.tan(math.radians(base.fov) / 2)
    fov = base.fov
    if view.fov is not None and projection in ("perspective", "fisheye"):
        fov = view.fov
    elif projection == "fisheye" and base.projection != "fisheye":
        fov = DEFAULT_FISHEYE_FOV
    return replace(base, projection=cast(Projection, projection), up=up, fov=fov, height=height), warnings


def _numbers(vector: Vector) -> str:
    """The vector as an option's value, with the digits that bring it back."""
    return ",".join(repr(component) for component in vector)
