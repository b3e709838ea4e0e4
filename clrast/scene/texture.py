"""Images of a scene: where they may be read from, and their decoding to 8-bit RGBA.

`resolve_below` is the one rule for every file that a scene names: it lies below the scene's own
folder, and no URL is ever fetched. Image decoding is Pillow's; formats that start other programs
are left out, and sizes are checked in the header, before any pixel is allocated.
"""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote

import numpy as np

from clrast.errors import SceneError
from clrast.scene.model import Texture

if TYPE_CHECKING:
    from PIL.Image import Image

MAX_IMAGE_SIDE = 16384  # texels; also what OpenCL devices commonly allow
MAX_TEXELS = 1 << 30  # of all images that are decoded in one go: 4 GiB
MAX_FILE_BYTES = 1 << 30  # of one image file, before decoding
DECODE_THREADS = 2
IMAGE_FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "GIF", "TIFF", "PPM", "TGA")

_SCHEME = re.compile(r"^[A-Za-z][A-Za-z0-9+.\-]*:")


def resolve_below(folder: Path, uri: str, percent_encoded: bool = True) -> Path:
    """The file that a scene in `folder` names by a relative path or URI; it need not exist.

    uri : relative, `/` or backslash between its parts; percent escapes are decoded where
        `percent_encoded` is set (glTF; not for MTL).
    Raises SceneError for URLs, absolute paths, and whatever leads out of `folder`, by `..` or
    by a symbolic link.
    """
    shown = f'"{shorten(uri)}"'
    if _SCHEME.match(uri):
        raise SceneError(f"{shown} is a URL or a drive: put the file beside the scene and name it by a relative path")
    text = (unquote(uri) if percent_encoded else uri).replace("\\", "/")
    if not text or "\0" in text:
        raise SceneError(f"{shown} is no file name: name a file below the scene's folder")
    if text.startswith("/") or _SCHEME.match(text):
        raise SceneError(f"{shown} is absolute: put the file below the scene's folder and name it by a relative path")
    try:
        home = folder.resolve()
        path = (home / text).resolve()
    except (OSError, RuntimeError, ValueError) as error:
        reason = one_line(error)
        raise SceneError(f"{shown} cannot be followed ({reason}): name a file below the scene's folder") from error
    if not path.is_relative_to(home) or path == home:
        raise SceneError(f"{shown} lies outside the scene's folder: move it below that folder")
    return path


def find_below(folder: Path, uri: str, percent_encoded: bool = True) -> Path:
    """As `resolve_below`, for a file that must exist."""
    path = resolve_below(folder, uri, percent_encoded)
    try:
        if path.is_file():
            return path
    except (OSError, ValueError):
        pass
    raise SceneError(f'"{shorten(uri)}" is missing from the scene\'s folder: put it there')


def read_below(folder: Path, uri: str, max_bytes: int, percent_encoded: bool = True) -> bytes:
    """The bytes of a file below `folder`; SceneError where there is none, or more than `max_bytes`."""
    path = find_below(folder, uri, percent_encoded)
    shown = f'"{shorten(uri)}"'
    try:
        size = path.stat().st_size
        if size > max_bytes:
            raise SceneError(f"{shown} has {size} bytes, at most {max_bytes} are read: make it smaller")
        return path.read_bytes()
    except OSError as error:
        raise SceneError(f"{shown} cannot be read ({one_line(error)}): check its rights") from error


def load_image_file(path: str | Path, folder: Path, percent_encoded: bool = False) -> Texture:
    """Decode an image file that a scene in `folder` names; SceneError where that cannot be done."""
    return decode_image(read_below(folder, str(path), MAX_FILE_BYTES, percent_encoded), str(path))


def decode_image(data: bytes, name: str) -> Texture:
    """Decode an image file's bytes; `texels` : (height, width, 4) uint8, row 0 the top row.

    Raises SceneError where the format is unknown, the data broken, or the image too large.
    """
    result = decode_images([(data, name)])[0]
    if isinstance(result, SceneError):
        raise result
    return result


def decode_images(images: Sequence[tuple[bytes, str]]) -> list[Texture | SceneError]:
    """Decode (bytes, name) pairs on a few threads; a broken image is its SceneError, in its place."""
    if not images:
        return []
    with warnings.catch_warnings():  # Pillow's remarks on odd metadata; set once, for all threads
        warnings.simplefilter("ignore")
        opened: list[Image | SceneError] = []
        texel_count = 0
        for data, name in images:
            image = _open_image(data, name, MAX_TEXELS - texel_count)
            if not isinstance(image, SceneError):
                texel_count += image.width * image.height
            opened.append(image)
        names = [name for _, name in images]
        if len(images) == 1:
            return [_decode(opened[0], names[0])]
        from concurrent.futures import ThreadPoolExecutor

        with ThreadPoolExecutor(DECODE_THREADS) as pool:
            return list(pool.map(_decode, opened, names))


def _open_image(data: bytes, name: str, texel_capacity: int) -> Image | SceneError:
    """An image whose header is read and whose size is within bounds."""
    import PIL.Image

    shown = f'image "{shorten(name)}"'
    try:
        image = PIL.Image.open(io.BytesIO(data), formats=IMAGE_FORMATS)
    except PIL.UnidentifiedImageError:
        return SceneError(f"{shown} is of no known format: save it as PNG or JPEG")
    except Exception as error:  # decoders raise anything on broken data
        return SceneError(f"{shown} cannot be opened ({one_line(error)}): save it again as PNG or JPEG")
    width, height = image.size
    if not (0 < width <= MAX_IMAGE_SIDE and 0 < height <= MAX_IMAGE_SIDE):
        return SceneError(f"{shown} is {width}x{height}, at most {MAX_IMAGE_SIDE} a side are read: scale it down")
    if width * height > texel_capacity:
        return SceneError(f"{shown} is one too many: all images may have {MAX_TEXELS} texels: scale them down")
    return image


def _decode(image: Image | SceneError, name: str) -> Texture | SceneError:
    if isinstance(image, SceneError):
        return image
    try:
        with image:
            return Texture(name, _to_rgba8(image))
    except Exception as error:  # decoders raise anything on broken data
        return SceneError(f'image "{shorten(name)}" is broken ({one_line(error)}): save it again as PNG or JPEG')


def _to_rgba8(image: Image) -> np.ndarray:
    """(height, width, 4) uint8 of an open Pillow image; 16-bit grey is scaled, not clipped."""
    if image.mode.startswith("I"):
        grey = np.clip(np.asarray(image).astype(np.int64), 0, 65535)
        texels = np.full((*grey.shape, 4), 255, np.uint8)
        texels[:, :, :3] = ((grey * 255 + 32767) // 65535)[:, :, None]
        return texels
    if image.mode == "F":
        raise ValueError("float pixels")
    return np.array(image if image.mode == "RGBA" else image.convert("RGBA"), dtype=np.uint8, order="C")


def shorten(text: str, limit: int = 80) -> str:
    """`text` on one line, printable and of bounded length: for messages and names."""
    clean = "".join(c if c.isprintable() else "?" for c in text[: limit + 1])
    return clean if len(clean) <= limit else clean[: limit - 3] + "..."


def one_line(error: BaseException) -> str:
    """What an exception says, on one bounded line; its type's name where it says nothing."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return shorten(" ".join(str(error).split()) or type(error).__name__, 120)
