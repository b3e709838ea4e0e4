"""Reading EXR and PNG files through OpenImageIO: every part, every channel, ids exact, faults in one line."""

from __future__ import annotations

import os
import stat
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from clrast.errors import InputNotFoundError, SceneError
from clrast.image.frame import Part, in_order

HEADER_PREFIX = "clrast:"
"""Before each key of a frame's header in the file, so that none collides with a name that EXR gives a meaning."""

MAGIC = {".exr": b"\x76\x2f\x31\x01", ".png": b"\x89PNG\r\n\x1a\n"}
MAX_BYTES = 8 << 30
"""Largest image that is read, as pixels in memory; a broken header may ask for anything."""
MAX_PARTS = 4096

# What OpenImageIO derives from the structure of a file: compared as parts, channels and sizes, not as header
_DERIVED = frozenset(("openexr:chunkCount", "openexr:lineOrder", "name", "compression", "planarconfig"))
_DERIVED_PREFIXES = ("oiio:", "png:")


def read_parts(path: str | Path) -> list[Part]:
    """All parts of an .exr or .png file in their order.

    UINT channels are uint32, all others float32 (8-bit ones divided by 255, as the file has them).
    Raises InputNotFoundError, or SceneError where the file cannot be read.
    """
    import OpenImageIO as oiio

    _check_file(path)
    try_all = oiio.get_int_attribute("try_all_readers", 1)
    oiio.attribute("try_all_readers", 0)  # a broken EXR is not handed to the readers of thirty other formats
    image = None
    try:
        config = oiio.ImageSpec()
        config.attribute("oiio:UnassociatedAlpha", 1)  # PNG: the values as stored
        image = oiio.ImageInput.open(os.fspath(path), config)
        if image is None:
            raise SceneError(_line(path, oiio.geterror()))
        return _read_all(oiio, image, path)
    except (UnicodeError, ValueError, RuntimeError, MemoryError) as fault:
        raise SceneError(_line(path, str(fault))) from None
    finally:
        oiio.attribute("try_all_readers", try_all)
        if image is not None:
            image.geterror()  # what is not fetched would be printed by its destructor
            image.close()
        oiio.geterror()


def _check_file(path: str | Path) -> None:
    """Suffix and first bytes agree, and the file is a file."""
    try:
        os.fspath(path).encode("utf-8")  # OpenImageIO takes no other names
        kind = os.stat(path).st_mode
        if not stat.S_ISREG(kind):
            raise SceneError(f"{path}: is no file: give an .exr or .png file")
        suffix = os.path.splitext(os.fspath(path))[1].lower()
        if suffix not in MAGIC:
            raise SceneError(f"{path}: cannot read {suffix or 'a name without a suffix'}: give an .exr or .png file")
        with open(path, "rb") as file:
            start = file.read(8)
    except (FileNotFoundError, NotADirectoryError):
        raise InputNotFoundError(f"{path}: there is no such file: check the name") from None
    except (OSError, ValueError) as fault:
        raise SceneError(_line(path, getattr(fault, "strerror", None) or str(fault))) from None
    if not start.startswith(MAGIC[suffix]):
        raise SceneError(f"{path}: is not in the {suffix[1:].upper()} format: write it again")
    if suffix == ".png":
        _check_png(path)


def _check_png(path: str | Path) -> None:
    """Check the sums of all chunks: libpng would print what it finds wrong to stderr, past our one line."""
    content = Path(path).read_bytes()
    place, kind = 8, b""
    while kind != b"IEND":
        size = int.from_bytes(content[place : place + 4], "big")
        kind, chunk = content[place + 4 : place + 8], content[place + 4 : place + 8 + size]
        sum_given = content[place + 8 + size : place + 12 + size]
        if len(sum_given) < 4 or int.from_bytes(sum_given, "big") != zlib.crc32(chunk):
            raise SceneError(f"{path}: cannot be read (it is damaged at byte {place}): write it again")
        place += 12 + size


def _read_all(oiio: Any, image: Any, path: str | Path) -> list[Part]:
    parts: list[Part] = []
    total = 0
    while image.seek_subimage(len(parts), 0):
        spec = image.spec()
        total += spec.width * spec.height * spec.nchannels * 4
        if total > MAX_BYTES or len(parts) >= MAX_PARTS:
            raise SceneError(f"{path}: claims more than {MAX_BYTES >> 30} GiB of pixels: it is broken or too large")
        parts.append(_read_part(oiio, image, len(parts), path))
    subimages = image.spec(0).get_int_attribute("oiio:subimages", len(parts))
    if not parts or len(parts) != subimages:
        raise SceneError(_line(path, image.geterror() or f"part {len(parts)} of {subimages} is broken"))
    return parts


def _read_part(oiio: Any, image: Any, index: int, path: str | Path) -> Part:
    spec = image.spec()
    names = tuple(spec.channelnames)
    if spec.deep:
        raise SceneError(f"{path}: part {index} is deep, with many samples in a pixel: give a flat image")
    if image.seek_subimage(index, 1):
        raise SceneError(f"{path}: part {index} has smaller copies of itself (mip levels): give a plain image")
    image.geterror()
    image.seek_subimage(index, 0)
    if not names or len(set(names)) != len(names) or spec.width < 1 or spec.height < 1 or spec.depth != 1:
        raise SceneError(f"{path}: part {index} has no pixels, or two channels of one name: write it again")
    types = [str(kind) for kind in spec.channelformats] or [str(spec.format)] * len(names)
    channels: dict[str, np.ndarray] = {}
    # Runs of one type are read at once: asked for as floats, UINT values would lose their last digits
    begin = 0
    while begin < len(names):
        uint = types[begin] == "uint"
        end = begin + 1
        while end < len(names) and (types[end] == "uint") == uint:
            end += 1
        pixels = image.read_image(index, 0, begin, end, "uint" if uint else "float")
        if pixels is None:
            raise SceneError(_line(path, image.geterror()))
        pixels = pixels.reshape(spec.height, spec.width, end - begin)
        for offset in range(end - begin):
            channels[names[begin + offset]] = np.ascontiguousarray(pixels[:, :, offset])
        begin = end
    return Part(
        name=spec.get_string_attribute("oiio:subimagename"),
        channels={name: channels[name] for name in in_order(channels)},
        window=(spec.x, spec.y, spec.width, spec.height),
        display=(spec.full_x, spec.full_y, spec.full_width, spec.full_height),
        pixel_types=dict(zip(names, types, strict=True)),
        header=_header(spec),
    )


def _header(spec: Any) -> dict[str, Any]:
    """The attributes of a part, without those that follow from its structure."""
    header: dict[str, Any] = {}
    for index in range(len(spec.extra_attribs)):
        attribute = spec.extra_attribs[index]
        try:
            name, value = attribute.name, attribute.value
        except UnicodeError:
            name, value = f"attribute {index}", "(text that is not UTF-8)"
        if name not in _DERIVED and not name.startswith(_DERIVED_PREFIXES):
            header[name] = value if isinstance(value, (str, int, float, tuple)) else str(value)
    return header


def _line(path: str | Path, reason: str) -> str:
    """One line from OpenImageIO's words."""
    words = " ".join(reason.split())[:300] or "it is broken"
    return f"{path}: cannot be read ({words}): write it again, or give another file"
