"""An 8-bit picture of a frame, for people: tone-mapped colour, or the first other group made visible."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from clrast.errors import OutputError, UsageError
from clrast.image.files import write_whole
from clrast.image.frame import Frame
from clrast.image.tone import srgb_bytes, tone_map
from clrast.visibility.sample_patterns import hash_bits

NO_HIT = 4294967295


def write_png(path: str | Path, frame: Frame) -> None:
    """Write `picture(frame)` to `path`, whole or not at all; OutputError where that fails."""
    write_pixels(path, picture(frame))


def write_pixels(path: str | Path, pixels: np.ndarray) -> None:
    """Write (H, W, 3 or 4) uint8, sRGB with straight alpha, as a PNG file without a date."""
    import OpenImageIO as oiio

    height, width, count = pixels.shape
    spec = oiio.ImageSpec(width, height, count, "uint8")
    spec.channelnames = ("R", "G", "B", "A")[:count]
    spec.attribute("oiio:ColorSpace", "sRGB")
    spec.attribute("oiio:UnassociatedAlpha", 1)
    spec.attribute("DateTime", "")
    spec.attribute("png:compressionLevel", 6)

    def write(draft: str) -> None:
        output = oiio.ImageOutput.create("png")
        if output is None:
            raise OutputError(f"{path}: this OpenImageIO cannot write PNG: install OpenImageIO from PyPI")
        try:
            done = output.open(draft, spec) and output.write_image(np.ascontiguousarray(pixels))
        finally:
            closed = output.close()
        reason = " ".join(output.geterror().split())
        with open(draft, "rb") as file:
            complete = file.read()[-8:-4] == b"IEND"  # a disk that fills while the file is closed
        if not (done and closed and complete):
            reason = reason or "the file came out incomplete"
            raise OutputError(f"{path}: cannot be written ({reason}): choose another place or make room")

    write_whole(path, write)


def picture(frame: Frame) -> np.ndarray:
    """(H, W, 3 or 4) uint8, sRGB: what a PNG of `frame` shows.

    Colour is divided by alpha and tone-mapped (tone.py), with alpha beside it. Without colour, the
    first of: albedo as colour; normals from -1..1 to 0..255; depth or distance, near white and far
    dark; ids, each in a colour of its own; any other group, stretched to its finite range. Black is
    where nothing was hit.
    """
    if all(name in frame for name in "RGB"):
        return _color(frame)
    if "albedo.R" in frame:
        return srgb_bytes(tone_map(np.stack([frame[f"albedo.{axis}"] for axis in "RGB"], axis=-1)))
    for layer in ("N", "Ng"):
        if f"{layer}.X" in frame:
            return _directions(np.stack([frame[f"{layer}.{axis}"] for axis in "XYZ"], axis=-1))
    for name in ("Z", "distance.Y"):
        if name in frame:
            return _distance(frame[name])
    for name in frame:
        if frame[name].dtype == np.uint32:
            return _ids(frame[name])
    layer = next(iter(frame)).rpartition(".")[0]
    names = [name for name in frame if name.rpartition(".")[0] == layer][:3]
    planes = [_stretched(frame[name]) for name in names]
    planes += [planes[0]] * (3 - len(planes)) if len(planes) == 1 else [np.zeros_like(planes[0])] * (3 - len(planes))
    return np.stack(planes, axis=-1)


def _color(frame: Frame) -> np.ndarray:
    rgb = np.stack([frame[name] for name in "RGB"], axis=-1)
    if rgb.dtype != np.float32:
        raise UsageError("a picture needs R, G and B as float32: save ids as .exr")
    if "A" not in frame:
        return srgb_bytes(tone_map(rgb))
    alpha = frame["A"]
    clear = np.where((alpha > 0) & (alpha < 1), alpha, np.float32(1.0))
    straight = rgb / clear[..., np.newaxis]
    cover = np.where(alpha > 0, np.minimum(alpha, np.float32(1.0)), np.float32(0.0))
    opacity = _to_byte(cover)
    return np.concatenate([srgb_bytes(tone_map(straight)), opacity[..., np.newaxis]], axis=-1)


def _to_byte(unit: np.ndarray) -> np.ndarray:
    """0..1 to the nearest of 0..255."""
    return (unit * np.float32(255.0) + np.float32(0.5)).astype(np.uint8)


def _directions(vectors: np.ndarray) -> np.ndarray:
    """(H, W, 3) of -1..1 as codes; zero vectors, which mean nothing was hit, black."""
    finite = np.where(np.isfinite(vectors), vectors, np.float32(0.0))
    shown = _to_byte(np.clip(finite * np.float32(0.5) + np.float32(0.5), np.float32(0.0), np.float32(1.0)))
    return np.where((finite == 0).all(axis=-1, keepdims=True), np.uint8(0), shown)


def _distance(values: np.ndarray) -> np.ndarray:
    """Near white, far dark grey, nothing black; three equal channels."""
    near = np.float32(1.0) - np.float32(0.9 / 255.0) * _stretched(values)
    grey = np.where(np.isfinite(values), _to_byte(near), np.uint8(0))
    return np.repeat(grey[..., np.newaxis], 3, axis=-1)


def _stretched(values: np.ndarray) -> np.ndarray:
    """uint8: the finite range to 0..255; what is not finite 0."""
    numbers = values.astype(np.float64)
    finite = np.isfinite(numbers)
    if not finite.any():
        return np.zeros(values.shape, np.uint8)
    low, high = numbers[finite].min(), numbers[finite].max()
    scale = 255.0 / (high - low) if high > low else 0.0
    return (np.where(finite, numbers - low, 0.0) * scale + 0.5).astype(np.uint8)


def _ids(ids: np.ndarray) -> np.ndarray:
    """A colour for each id from its mixed bits, none darker than 64; NO_HIT black."""
    mixed = hash_bits(ids.astype(np.uint32))
    octets = np.stack([(mixed >> np.uint32(shift)) & np.uint32(0xFF) for shift in (0, 8, 16)], axis=-1)
    colors = (octets * np.uint32(3) // np.uint32(4) + np.uint32(64)).astype(np.uint8)
    return np.where((ids == np.uint32(NO_HIT))[..., np.newaxis], np.uint8(0), colors)
