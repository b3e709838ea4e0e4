"""The camera as kernels see it: centre-relative, with inverse axes for bounds, at a safe scale."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from clrast.opencl.layout import CAMERA, VIEW
from clrast.scene.camera import CameraVectors
from clrast.visibility.sample_patterns import CENTER, UNITS, Position

Vector = tuple[float, float, float]

SCALE_FREE_EXPONENT = 30
"""World sizes within 2^-30 .. 2^30 are rendered as they are: products of four stay in float32's range."""


def _cross(a: Vector, b: Vector) -> Vector:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _times(a: Vector, s: float) -> Vector:
    return (a[0] * s, a[1] * s, a[2] * s)


def _split(a: Vector) -> tuple[np.ndarray, np.ndarray]:
    """A float64 vector as the sum of two float32 ones, each (4,) float32 with w = 0."""
    exact = np.array([*a, 0.0], dtype=np.float64)
    high = exact.astype(np.float32)
    return high, (exact - high.astype(np.float64)).astype(np.float32)


def _reaches(low: np.ndarray, high: np.ndarray, center: Vector) -> list[float]:
    """How far the box low .. high reaches from `center` along each axis."""
    return [max(abs(float(b) - c), abs(float(a) - c)) for a, b, c in zip(low, high, center, strict=True)]


def world_scale(camera: CameraVectors, low: np.ndarray, high: np.ndarray) -> float:
    """The power of two that positions are multiplied by on the device, 1 for ordinary sizes.

    low, high : (3,) float64, the scene's bounding box, world space. The scale is exact (powers of two
    round nothing), so the answer is the same; it keeps products of coordinates in float32's range.
    """
    center = camera.center() if camera.projection == "orthographic" else camera.origin
    reach = max(_reaches(low, high, center))
    exponent = math.frexp(reach)[1]
    if reach == 0.0 or -SCALE_FREE_EXPONENT <= exponent <= SCALE_FREE_EXPONENT:
        return 1.0
    return 2.0 ** max(-126, min(126, -exponent))


def build_camera(camera: CameraVectors) -> np.ndarray:
    """The `Camera` struct (one element): the vectors as they are defined."""
    vectors = np.zeros((), dtype=CAMERA)
    is_parallel = camera.projection == "orthographic"
    vectors["origin"][:3] = camera.first if is_parallel else camera.origin
    # Not planar: each sample has a direction and steps of its own, found on the device.
    vectors["direction"][:3] = camera.direction if is_parallel or not camera.is_planar else camera.first
    vectors["step_x"][:3], vectors["step_y"][:3] = camera.tangent_x, camera.tangent_y
    return vectors


def _spread(view: np.ndarray, center: Vector, tangent_x: Vector, tangent_y: Vector) -> list[float]:
    """The largest size of each component of center + X tangent_x + Y tangent_y over the image."""
    half_width, half_height = float(view["center_x"]), float(view["center_y"])
    return [
        abs(c) + half_width * abs(x) + half_height * abs(y)
        for c, x, y in zip(center, tangent_x, tangent_y, strict=True)
    ]


def _find_reaches(view: np.ndarray, camera: CameraVectors, center: Vector, tangents: tuple[Vector, Vector]) -> None:
    """Set `direction_reach` and `origin_reach`; `center` is scaled where rays are parallel, as `tangents` are."""
    upwards = 1 + 2.0**-20
    if camera.projection == "orthographic":
        view["direction_reach"][:3] = [upwards * abs(c) for c in camera.direction]
        # What two floats lose of the centre, 2^-46 of it, counts as 2^-24 of what bounds are multiplied with.
        spread = _spread(view, _split(center)[1].tolist()[:3], *tangents)
        view["origin_reach"][:3] = [upwards * (s + 2.0**-22 * abs(c)) for s, c in zip(spread, center, strict=True)]
    else:
        view["direction_reach"][:3] = [upwards * c for c in _spread(view, center, *tangents)]


def place_samples(view: np.ndarray, position: Position) -> None:
    """Samples of a pass lie there in their pixels, 256ths."""
    view["sample_x"], view["sample_y"] = position[0] / UNITS, position[1] / UNITS


def spread_samples(view: np.ndarray, positions: Sequence[Position]) -> None:
    """Bounds of triangles are to hold for samples at all these positions."""
    columns, rows = [x for x, _ in positions], [y for _, y in positions]
    view["samples_left"], view["samples_top"] = min(columns) / UNITS, min(rows) / UNITS
    view["samples_right"], view["samples_bottom"] = max(columns) / UNITS, max(rows) / UNITS


def build_view(camera: CameraVectors, low: np.ndarray, high: np.ndarray, tile_log2: int) -> np.ndarray:
    """The `View` struct (one element) for a camera and a scene whose bounding box is low .. high.

    Orthographic cameras take the ray origin of the image's centre as origin. The inverse axes solve
    p - origin = t * (d + X dx + Y dy), or = X ex + Y ey + t d, for X, Y and t.
    """
    scale = world_scale(camera, low, high)
    view = np.zeros((), dtype=VIEW)
    if camera.is_planar:
        _set_planar(view, camera, scale, low, high)
    else:
        view["origin"] = _split(_times(camera.origin, scale))[0]
        view["axis"][:3], view["tangent_x"][:3], view["tangent_y"][:3] = (
            camera.direction, camera.tangent_x, camera.tangent_y,
        )  # fmt: skip
        view["focal"] = camera.rim
        view["direction_reach"][:3] = 1 + 2.0**-20
    view["center_x"], view["center_y"] = camera.width / 2, camera.height / 2
    place_samples(view, CENTER)
    spread_samples(view, (CENTER,))
    view["world_scale"] = scale
    view["width"], view["height"] = camera.width, camera.height
    tile = 1 << tile_log2
    view["tile_columns"] = (camera.width + tile - 1) // tile
    view["tile_rows"] = (camera.height + tile - 1) // tile
    set_band(view, 0, int(view["tile_rows"]), tile_log2)
    return view


def set_band(view: np.ndarray, band_row: int, band_rows: int, tile_log2: int) -> None:
    """Let a view speak of so many rows of tiles from `band_row` on."""
    top = band_row << tile_log2
    view["band_top"], view["band_height"] = top, min(band_rows << tile_log2, int(view["height"]) - top)


def band_tile_count(view: np.ndarray, tile_log2: int) -> int:
    """Tiles of a view's band."""
    return (-(-int(view["band_height"]) >> tile_log2)) * int(view["tile_columns"])


def band_pixel_count(view: np.ndarray) -> int:
    """Pixels of a view's band."""
    return int(view["band_height"]) * int(view["width"])


def _set_planar(view: np.ndarray, camera: CameraVectors, scale: float, low: np.ndarray, high: np.ndarray) -> None:
    """Set what a planar view is made of; arguments as of `build_view`."""
    view["center_x"], view["center_y"] = camera.width / 2, camera.height / 2
    center = camera.center()
    tangent_x, tangent_y = camera.tangent_x, camera.tangent_y
    if camera.projection == "orthographic":
        tangent_x, tangent_y = _times(tangent_x, scale), _times(tangent_y, scale)
        view["origin"], view["origin_low"] = _split(_times(center, scale))
        axis = camera.direction
        view["axis"], view["axis_low"] = _split(axis)
        view["first"] = _split(_times(camera.first, scale))[0]
        distance = scale * math.sqrt(sum(reach * reach for reach in _reaches(low, high, center)))
        pixel = math.sqrt(min(_dot(tangent_x, tangent_x), _dot(tangent_y, tangent_y)))
        view["focal"] = max(distance / pixel, float(camera.width + camera.height))
    else:
        view["origin"] = _split(_times(camera.origin, scale))[0]
        axis = center
        view["axis"], view["axis_low"] = _split(axis)
        view["first"] = _split(camera.first)[0]
        view["focal"] = 1.0 / math.sqrt(min(_dot(tangent_x, tangent_x), _dot(tangent_y, tangent_y)))
    determinant = _dot(tangent_x, _cross(tangent_y, axis))
    view["inverse_x"] = _split(_times(_cross(tangent_y, axis), 1.0 / determinant))[0]
    view["inverse_y"] = _split(_times(_cross(axis, tangent_x), 1.0 / determinant))[0]
    view["inverse_w"] = _split(_times(_cross(tangent_x, tangent_y), 1.0 / determinant))[0]
    view["tangent_x"] = _split(tangent_x)[0]
    view["tangent_y"] = _split(tangent_y)[0]
    reach_center = _times(center, scale) if camera.projection == "orthographic" else center
    _find_reaches(view, camera, reach_center, (tangent_x, tangent_y))
