"""A rendered image as named channels, and how channels gather into groups and parts."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from clrast.errors import UsageError

CHANNEL_GROUPS: dict[str, tuple[str, ...]] = {
    "color": ("R", "G", "B", "A"),  # linear, premultiplied
    "depth": ("Z",),  # along the view axis, world units
    "distance": ("distance.Y",),  # from the ray's origin to the hit, world units
    "normal": ("N.X", "N.Y", "N.Z", "Ng.X", "Ng.Y", "Ng.Z"),  # shading, geometric; world space
    "position": ("P.X", "P.Y", "P.Z"),  # world space
    "bary": ("bary.U", "bary.V"),  # weights of vertices 1 and 2
    "uv": ("uv.U", "uv.V"),
    "albedo": ("albedo.R", "albedo.G", "albedo.B"),  # linear
    "ray": ("ray.X", "ray.Y", "ray.Z", "raydx.X", "raydx.Y", "raydx.Z", "raydy.X", "raydy.Y", "raydy.Z"),
    "id": ("id.prim", "id.object", "id.material"),  # uint32, 4294967295 where nothing is hit
    "cost": ("cost.edge_evaluations", "cost.setups", "cost.traversal_steps"),  # counts per pixel
}
"""Group of `--aov` -> names of its channels in the file; the one home of both."""

BEAUTY_PART = "beauty"
BEAUTY_GROUPS = ("color", "depth")
"""These share the first part of a file: simple readers open no other."""

_PART_OF = {
    channel: BEAUTY_PART if group in BEAUTY_GROUPS else group
    for group, channels in CHANNEL_GROUPS.items()
    for channel in channels
}
_RANK = {channel: rank for rank, channel in enumerate(_PART_OF)}

HeaderValue = str | int | float | tuple[float, ...]
Window = tuple[int, int, int, int]


@dataclass(frozen=True)
class Part:
    """One part of an image file.

    channels : name -> (H, W) float32 or uint32, names in full
    window : x, y, width, height of the pixels that are stored; display : of the whole image
    pixel_types : channel name -> the type in the file ("half", "float", "uint", "uint8" ...)
    header : what the file says about itself in this part
    """

    name: str
    channels: dict[str, np.ndarray]
    window: Window
    display: Window
    pixel_types: dict[str, str] = field(default_factory=dict)
    header: dict[str, Any] = field(default_factory=dict)


def part_of(channel: str) -> str:
    """Name of the part where a channel is written; one of no known group goes by its layer, or to `other`."""
    if channel in _PART_OF:
        return _PART_OF[channel]
    layer, dot, _ = channel.rpartition(".")
    return layer if dot and layer else "other"


def channels_of(groups: tuple[str, ...]) -> tuple[str, ...]:
    """Channel names of the groups, in the order of CHANNEL_GROUPS."""
    return tuple(name for group, names in CHANNEL_GROUPS.items() if group in groups for name in names)


def in_order(channels: Iterable[str]) -> list[str]:
    """Channel names in the order of CHANNEL_GROUPS, others after them as they come (EXR files sort by name)."""
    return sorted(channels, key=lambda name: _RANK.get(name, len(_RANK)))


class Frame:
    """An image: `frame["id.prim"]` is the (H, W) array of a channel.

    channels : name -> (H, W) float32 or uint32, C-contiguous; row 0 is the top
    header : what decides the pixels (version, resolved options, camera vectors), written into the EXR file
    stats : the stats of the render (DESIGN section 2); never written into an image
    """

    def __init__(
        self,
        channels: Mapping[str, np.ndarray],
        header: Mapping[str, HeaderValue] | None = None,
        stats: Mapping[str, Any] | None = None,
    ) -> None:
        self.channels: dict[str, np.ndarray] = {}
        self.header: dict[str, HeaderValue] = dict(header or {})
        self.stats: dict[str, Any] = dict(stats or {})
        shape = None
        for name, values in channels.items():
            array = np.asarray(values)
            if array.dtype not in (np.float32, np.uint32):
                raise UsageError(f"channel {name} is {array.dtype}: give float32, or uint32 for ids")
            if array.ndim != 2 or array.size == 0 or shape not in (None, array.shape):
                wanted = "(height, width)" if shape is None else str(shape)
                raise UsageError(f"channel {name} has the shape {array.shape}: all channels need {wanted}")
            shape = array.shape
            self.channels[name] = np.ascontiguousarray(array)
        if shape is None:
            raise UsageError("a frame needs at least one channel")
        self.height: int = int(shape[0])
        self.width: int = int(shape[1])

    def __getitem__(self, name: str) -> np.ndarray:
        try:
            return self.channels[name]
        except KeyError:
            raise KeyError(f"there is no channel {name!r}: this frame has {', '.join(self.channels)}") from None

    def __contains__(self, name: object) -> bool:
        return name in self.channels

    def __iter__(self) -> Iterator[str]:
        return iter(self.channels)

    def __repr__(self) -> str:
        return f"Frame({self.width}x{self.height}: {' '.join(self.channels)})"

    def parts(self) -> list[Part]:
        """The channels as the parts of a file: `beauty` first, then one part per group, ids apart as UINT."""
        window = (0, 0, self.width, self.height)
        parts: dict[str, Part] = {}
        for name in in_order(self.channels):
            values = self.channels[name]
            kind = "uint" if values.dtype == np.uint32 else "float"
            place = part_of(name)
            if place in parts and kind not in parts[place].pixel_types.values():
                place = f"{place}_{kind}"  # a part holds one type: that is what keeps ids exact in every reader
            part = parts.setdefault(place, Part(place, {}, window, window))
            part.channels[name] = values
            part.pixel_types[name] = kind
        return list(parts.values())

    def save(self, path: str | Path, half: bool = False) -> None:
        """Write the frame to `path`, whole or not at all: .exr has everything, .png a tone-mapped picture.

        half : float channels as 16-bit floats (EXR only); ids stay UINT.
        Raises OutputError where it cannot be written, UsageError for another suffix.
        """
        from clrast.image.files import image_suffix

        if image_suffix(path) == ".png":
            from clrast.image.png import write_png

            write_png(path, self)
        else:
            from clrast.image.exr import write_exr

            write_exr(path, self.parts(), self.header, half)

    @classmethod
    def load(cls, path: str | Path) -> Frame:
        """Read an .exr or .png file; its parts become one frame.

        Where two parts have a channel of one name, the second is called `part/channel`. Raises
        InputNotFoundError, or SceneError where the file cannot be read or parts differ in size.
        """
        from clrast.errors import SceneError
        from clrast.image.read import HEADER_PREFIX, read_parts

        parts = read_parts(path)
        channels: dict[str, np.ndarray] = {}
        header: dict[str, HeaderValue] = {}
        for part in parts:
            if part.window != parts[0].window:
                raise SceneError(f"{path}: part {part.name!r} has another size than the first: a frame has one")
            for name, values in part.channels.items():
                channels[f"{part.name}/{name}" if name in channels else name] = values
            for key, value in part.header.items():
                if key.startswith(HEADER_PREFIX):
                    header.setdefault(key.removeprefix(HEADER_PREFIX), value)
        return cls({name: channels[name] for name in in_order(channels)}, header)
