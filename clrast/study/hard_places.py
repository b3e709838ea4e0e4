"""Hard cases about places: the eye on planes, edges and vertices, what lies behind, extreme sizes and distances."""

from __future__ import annotations

import numpy as np

from clrast.scene.model import Camera
from clrast.scene.shapes import icosphere
from clrast.study.hard_case import (
    AHEAD,
    ALL,
    NO_EXACT,
    OBLIQUE,
    Built,
    Family,
    blob,
    fan,
    join,
    loose,
    noise,
    orthographic,
    ring,
)

FAMILY = Family()
WALL = np.array([[(-8.0, -8.0, -4.0), (8.0, -8.0, -4.0), (0.0, 12.0, -4.0)]])


@FAMILY.case("near-plane", "Large triangles round the eye, most of which reach behind it.")
def near_plane() -> Built:
    eyes = [((0.1, 0.2, 0.3), (1.0, 0.5, -1.0)), ((-0.4, 0.1, 0.2), (0.3, -1.0, 0.2))]
    cameras = [Camera(f"amid {k}", "perspective", eye, at, (0.1, 1.0, 0.2), 70.0) for k, (eye, at) in enumerate(eyes)]
    return loose(blob(80, 40, 3.0)), [*cameras, orthographic(cameras[0], 4.0)]


@FAMILY.case("floor", "One floor of two triangles from far behind the eye to the horizon.")
def floor() -> Built:
    points = np.array([(-1e6, -1.0, 1e6), (1e6, -1.0, 1e6), (1e6, -1.0, -1e6), (-1e6, -1.0, -1e6)])
    oblique = Camera("walker", "perspective", (0.3, 0.7, 2.5), (1.0, 0.6, 0.0), fov=60.0)
    return (points, np.array([(0, 1, 2), (0, 2, 3)])), [AHEAD, oblique]


@FAMILY.case("behind", "Everything lies behind the eye: nothing is seen.", right=ALL)
def behind() -> Built:
    return loose(blob(81, 60, 1.0) + np.array([0.0, 0.0, 6.0])), [AHEAD, orthographic(AHEAD, 4.0)]


@FAMILY.case(
    "eye-on-plane", "The eye lies in the planes of triangles before, round and behind it: those cover nothing.",
    right=ALL,
)  # fmt: skip
def eye_on_plane() -> Built:
    through = np.array([
        [(0, -1, -2), (0, 1, -2), (0, 0, -1)],
        [(-1, 0, -1), (1, 0, -3), (1, 0, 2)],
        [(0.5, 0.5, -1), (-0.25, -0.25, -1), (2, 2, 3)],
    ])  # fmt: skip
    return loose(np.concatenate([through, WALL])), [AHEAD]


@FAMILY.case(
    "eye-near-plane", "The eye lies within rounding of the planes of triangles: seen edge-on, or not at all.",
)
def eye_near_plane() -> Built:
    corners, eye = blob(82, 60, 1.0), np.array(OBLIQUE.eye)
    share = 0.5 + 0.5 * noise(84, 60, 2)
    corners[:, 2] = eye + share[:, :1] * (corners[:, 0] - eye) + share[:, 1:] * (corners[:, 1] - eye)
    return loose(corners), [OBLIQUE]


@FAMILY.case("eye-on-edge", "Edges pass through the eye: their triangles cover nothing.", right=ALL)
def eye_on_edge() -> Built:
    edges = np.array([
        [(-1, -1, -1), (1, 1, 1), (3, 1, -5)],
        [(1, 0, -1), (-2, 0, 2), (0, 3, -3)],
        [(0.25, -0.5, -1), (-0.5, 1, 2), (-4, 0, -2)],
    ])  # fmt: skip
    return loose(np.concatenate([edges, WALL])), [AHEAD]


@FAMILY.case("eye-on-vertex", "The eye is a vertex of a fan: its triangles cover nothing, their neighbours do.")
def eye_on_vertex() -> Built:
    eye = np.array(OBLIQUE.eye, np.float32).astype(np.float64)
    rim = 0.6 * noise(85, 10, 3)
    blades = np.array([[eye, rim[k], rim[(k + 1) % 10]] for k in range(10)])
    return loose(np.concatenate([blades, blob(86, 30)])), [OBLIQUE]


def tiny_fan(size: float) -> Built:
    """A closed fan of that size round the world's origin, which lies on a sample's ray; a wall behind it."""
    rim = [(size * (x - 0.5), size * (0.5 - y), 0.0) for x, y in ring(8, 2.0, 0.5, 0.5, 1024.0)]
    wall = WALL - np.array([0.0, 0.0, 4.0])
    eye = Camera("before", "perspective", (-0.0625, 0.0625, 4.0), (-0.0625, 0.0625, 3.0), fov=90.0)
    return join([fan((0.0, 0.0, 0.0), rim), loose(wall)]), [eye]


@FAMILY.case(
    "tiny-triangles", "A fan of triangles of 1e-20 lies round a sample's ray, four units from the eye: it is hit.",
    wrong=NO_EXACT,
)  # fmt: skip
def tiny_triangles() -> Built:
    return tiny_fan(1e-20)


def scaled(scale: float) -> Built:
    (x, y, z), (u, v, w) = OBLIQUE.eye, OBLIQUE.look_at
    eye, look_at = (scale * x, scale * y, scale * z), (scale * u, scale * v, scale * w)
    camera = Camera("scaled", "perspective", eye, look_at, OBLIQUE.up, 60.0)
    cameras = [camera, orthographic(camera, 3.0 * scale)] if scale > 1e-30 else [camera]  # pixels of float32 numbers
    return loose(blob(87, 50) * scale), cameras


@FAMILY.case("world-1e-20", "The whole world is 1e-20 wide: products of four coordinates leave float32's range.")
def world_tiny() -> Built:
    return scaled(1e-20)


@FAMILY.case("world-1e20", "The whole world is 1e20 wide: products of two coordinates leave float32's range.")
def world_huge() -> Built:
    return scaled(1e20)


@FAMILY.case(
    "huge-triangles", "Triangles of 1e20 pass by an eye that looks at things of size 1: both in one image."
)
def huge_triangles() -> Built:
    huge = np.array([
        [(-1e20, -1.0, 1e20), (1e20, -1.0, 1e20), (0.0, -1.0, -1e20)],
        [(-1e20, 1e20, -1e19), (1e20, 1e20, -1e19), (0.0, -1e20, -3e19)],
    ])  # fmt: skip
    return loose(np.concatenate([huge, blob(88, 30)])), [OBLIQUE]


def offset(distance: float, scale: float) -> Built:
    """Scene and camera together far from the origin, in a direction of long numbers."""
    far = np.array([0.6, 0.3, -0.74]) * distance
    ball = icosphere(3)
    eye, target = (tuple((np.array(p) * scale + far).tolist()) for p in ((0.3, 0.7, 2.5), (0.1, -0.2, 0.05)))
    camera = Camera("far", "perspective", eye, target, (0.1, 1.0, 0.2), 60.0)
    return (ball.positions * scale + far, ball.triangles), [camera, orthographic(camera, 2.5 * scale)]


@FAMILY.case("offset-1e4", "Scene and eye are 10^4 from the origin: vertices lie on a grid of 1/1024.")
def offset_1e4() -> Built:
    return offset(1e4, 1.0)


@FAMILY.case("offset-1e6", "Scene and eye are 10^6 from the origin, as in map coordinates: a grid of 1/16.")
def offset_1e6() -> Built:
    return offset(1e6, 4.0)


@FAMILY.case("offset-1e8", "Scene and eye are 10^8 from the origin: a grid of 8, and a scene of some hundred steps.")
def offset_1e8() -> Built:
    return offset(1e8, 400.0)


@FAMILY.case("telescope", "The eye is a million units away: vertices minus eye lose all but a hundredth of a pixel.")
def telescope() -> Built:
    ball = icosphere(2)
    camera = Camera("telescope", "perspective", (6e5, 5e5, 6e5), (0.0, 0.0, 0.0), fov=1e-4)
    return (0.8 * ball.positions, ball.triangles), [camera]


@FAMILY.case("denormal-world", "All coordinates of vertices and eye are denormal numbers of float32.")
def denormal_world() -> Built:
    return scaled(2.0**-132)


@FAMILY.case(
    "denormal-steps", "Vertices differ from a sample's ray by denormal numbers, in a world of size 1.", wrong=NO_EXACT
)
def denormal_steps() -> Built:
    return tiny_fan(2.0**-140)


@FAMILY.case("narrow", "An angle of view of a thousandth of a degree: edge normals nearly cancel.")
def narrow() -> Built:
    ball = icosphere(2)
    return (ball.positions, ball.triangles), [
        Camera("narrow", "perspective", (0.3, 0.7, 2.5), (0.0, 0.0, 0.0), (0.1, 1.0, 0.2), 1e-3),
        Camera("through a vertex", "perspective", (0.3, 0.7, 2.5), tuple(ball.positions[7].tolist()),
               (0.1, 1.0, 0.2), 1e-5),
    ]  # fmt: skip


@FAMILY.case("wide-angle", "An angle of view of 179 degrees: the rays at the border are a hundred times as long.")
def wide_angle() -> Built:
    camera = Camera("wide", "perspective", (0.3, 0.7, 2.5), (0.1, -0.2, 0.05), (0.1, 1.0, 0.2), 179.0)
    return loose(blob(89, 60, 2.0)), [camera]

