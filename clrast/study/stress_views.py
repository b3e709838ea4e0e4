"""The views in which a hard case is rendered: its own, and on request other sizes and cameras at random."""

from __future__ import annotations

import random
from dataclasses import dataclass, replace

from clrast.scene.model import Camera
from clrast.study.hard_case import HardCase

EXTRA_SIZES = ((97, 61), (256, 256))
RANDOM_CAMERAS = 4


@dataclass(frozen=True)
class View:
    """A camera and an image size. is_extra : not one of the case's own, about which it expects nothing."""

    camera: Camera
    size: tuple[int, int]
    is_extra: bool = False

    @property
    def name(self) -> str:
        return f"{self.camera.name} {self.size[0]}x{self.size[1]}"


def views_of(case: HardCase, long: bool) -> list[View]:
    """The case's own views; `long` adds its cameras in other sizes, and cameras at random."""
    own = [View(camera, case.size) for camera in case.cameras]
    if not long:
        return own
    sizes = [View(view.camera, size, True) for view in own for size in EXTRA_SIZES]
    return [*own, *sizes, *(View(camera, case.size, True) for camera in random_cameras(case))]


def random_cameras(case: HardCase, count: int = RANDOM_CAMERAS) -> list[Camera]:
    """Eyes within twice the bounding box, looking at a point inside it; every fourth one is orthographic.

    The same on every machine: the seed is the case's name.
    """
    source = random.Random(case.name)
    low, high = case.scene().bounding_box()
    center, half = (low + high) / 2, (high - low) / 2
    largest = float(half.max()) or 1.0
    cameras: list[Camera] = []
    while len(cameras) < count:
        eye = tuple(float(c + 2 * max(h, largest / 8) * source.uniform(-1, 1)) for c, h in zip(center, half))
        look_at = tuple(float(c + 0.8 * h * source.uniform(-1, 1)) for c, h in zip(center, half))
        up = tuple(source.uniform(-1, 1) for _ in range(3))
        name, fov = f"random {len(cameras)}", source.uniform(20, 90)
        camera = Camera(name, "perspective", (eye[0], eye[1], eye[2]), (look_at[0], look_at[1], look_at[2]),
                        (up[0], up[1], up[2]), fov)  # fmt: skip
        if len(cameras) % 4 == 3:
            camera = replace(camera, projection="orthographic", height=2 * largest)
        cameras.append(camera)
    return cameras
