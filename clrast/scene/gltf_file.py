"""A glTF file as a checked JSON tree and its buffers: containers, URIs, and typed look-ups.

Nothing in the tree is trusted: every look-up names the place, what was needed and what there is,
as a SceneError. Buffers are read when first used; that external ones exist, and lie below the
scene's folder, is checked for all of them at once.
"""

from __future__ import annotations

import base64
import json
import math
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

from clrast.errors import InputNotFoundError, SceneError
from clrast.scene.texture import find_below, one_line, read_below, shorten

MAX_BYTES = 1 << 33  # of a scene file or of one buffer
MAX_WARNINGS = 100
MAX_VALUE = 1e30  # of colours, lengths and places outside vertex data: products stay within float32
_MAX_INTEGER = 1 << 53
_JSON_CHUNK, _BIN_CHUNK = 0x4E4F534A, 0x004E4942
_REQUIRED: Any = object()


def type_name(value: Any) -> str:
    """How a JSON value is called in a message."""
    names = {dict: "an object", list: "an array", str: "a string", bool: "a boolean", type(None): "null"}
    return names.get(type(value), "a number")


def get_object(parent: dict, key: str, where: str) -> dict:
    """The object at `key`, {} where there is none."""
    value = parent.get(key, {})
    if not isinstance(value, dict):
        raise SceneError(f"{where}: {key} needs an object, there is {type_name(value)}: export the file again")
    return value


def get_list(parent: dict, key: str, where: str) -> list:
    """The array at `key`, [] where there is none."""
    value = parent.get(key, [])
    if not isinstance(value, list):
        raise SceneError(f"{where}: {key} needs an array, there is {type_name(value)}: export the file again")
    return value


def get_integer(parent: dict, key: str, where: str, default: Any = _REQUIRED, high: int = _MAX_INTEGER) -> int:
    """The integer 0 <= value <= high at `key`; one without a default must be there."""
    if key not in parent:
        if default is _REQUIRED:
            raise SceneError(f"{where} lacks {key}: export the file again")
        return default
    return to_integer(parent[key], f"{where}: {key}", high)


def to_integer(value: Any, where: str, high: int = _MAX_INTEGER) -> int:
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    if not isinstance(value, int) or isinstance(value, bool):
        raise SceneError(f"{where} needs an integer, there is {type_name(value)}: export the file again")
    if not 0 <= value <= high:
        shown = value if abs(value) < 1 << 63 else "a huge number"
        raise SceneError(f"{where} needs an integer from 0 to {high}, there is {shown}: export the file again")
    return value


def to_number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise SceneError(f"{where} needs a number, there is {type_name(value)}: export the file again")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise SceneError(f"{where} needs a finite number: export the file again")
    return number


def get_number(parent: dict, key: str, where: str, default: float) -> float:
    return to_number(parent[key], f"{where}: {key}") if key in parent else default


def get_numbers(parent: dict, key: str, where: str, default: tuple[float, ...]) -> tuple[float, ...]:
    """As many finite numbers as the default has."""
    if key not in parent:
        return default
    values = get_list(parent, key, where)
    if len(values) != len(default):
        raise SceneError(f"{where}: {key} needs {len(default)} numbers, there are {len(values)}: export the file again")
    return tuple(to_number(value, f"{where}: {key}") for value in values)


def get_text(parent: dict, key: str, default: str = "") -> str:
    """A printable string of bounded length; the default where there is none or it is not a string."""
    value = parent.get(key)
    return shorten(value, 200) if isinstance(value, str) and value else default


def get_extension(parent: dict, name: str, where: str) -> dict | None:
    """The extension object `name` of a glTF object, None where it has none."""
    extensions = get_object(parent, "extensions", where)
    return get_object(extensions, name, where) if name in extensions else None


class GltfFile:
    """One glTF file: `tree` is its JSON, `warnings` collects what is not done."""

    def __init__(self, path: Path) -> None:
        self.folder = path.parent
        self._warnings: dict[str, None] = {}
        self._buffers: dict[int, bytes | memoryview] = {}
        content = _read_scene_file(path)
        self._chunk: memoryview | None = None
        if content[:4] == b"glTF":
            content, self._chunk = _split_glb(content)
        self.tree = _parse_json(content)
        self._check_version()
        for i, buffer in enumerate(self.items("buffers")):
            uri = buffer.get("uri")
            if isinstance(uri, str) and not is_data_uri(uri):
                _at(f"buffer {i}", find_below, self.folder, uri)

    @property
    def warnings(self) -> tuple[str, ...]:
        return tuple(self._warnings)

    def warn(self, sentence: str) -> None:
        """Keep a warning, once; a hostile file cannot make more than a page of them."""
        if len(self._warnings) < MAX_WARNINGS:
            self._warnings[sentence] = None
        else:
            self._warnings["more of this file is not shown as it asks: see the warnings above"] = None

    def clamp(self, values: tuple[float, ...], high: float, what: str) -> tuple:
        """`values` held within 0..high, with a warning where that changes one."""
        held = tuple(min(max(value, 0.0), high) for value in values)
        if held != values:
            self.warn(f"{what} lies outside 0..{high:g}: clamped")
        return held

    def count(self, kind: str) -> int:
        """How many objects the top-level array `kind` has."""
        return len(get_list(self.tree, kind, "the file"))

    def item(self, kind: str, index: int, where: str) -> dict:
        """Object `index` of the top-level array `kind`."""
        array = get_list(self.tree, kind, "the file")
        if index >= len(array):
            raise SceneError(f"{where} names {kind}[{index}], there are {len(array)}: export the file again")
        value = array[index]
        if not isinstance(value, dict):
            raise SceneError(f"{kind}[{index}] needs an object, there is {type_name(value)}: export the file again")
        return value

    def items(self, kind: str) -> Iterator[dict]:
        return (self.item(kind, i, "the file") for i in range(self.count(kind)))

    def view(self, index: int, where: str) -> tuple[memoryview, int]:
        """The bytes of a buffer view and its byteStride (0 where it has none)."""
        place = f"bufferView {index}"
        view = self.item("bufferViews", index, where)
        number = get_integer(view, "buffer", place)
        offset = get_integer(view, "byteOffset", place, 0)
        size = get_integer(view, "byteLength", place)
        buffer = self._buffer(number, place)
        if offset + size > len(buffer):
            there = f"buffer {number} has {len(buffer)}"
            raise SceneError(f"{place} ends at byte {offset + size}, {there}: the file is cut short")
        return memoryview(buffer)[offset : offset + size], get_integer(view, "byteStride", place, 0)

    def _buffer(self, index: int, where: str) -> bytes | memoryview:
        if index not in self._buffers:
            buffer = self.item("buffers", index, where)
            place = f"buffer {index}"
            size = get_integer(buffer, "byteLength", place)
            uri = buffer.get("uri")
            content: bytes | memoryview
            if isinstance(uri, str):
                content = _at(place, self.read_uri, uri, MAX_BYTES)
            elif index == 0 and self._chunk is not None:
                content = self._chunk
            else:
                raise SceneError(f"{place} has neither a file nor a binary chunk: export the file without compression")
            if len(content) < size:
                raise SceneError(f"{place} needs {size} bytes, there are {len(content)}: the file is cut short")
            self._buffers[index] = memoryview(content)[:size]
        return self._buffers[index]

    def read_uri(self, uri: str, max_bytes: int) -> bytes:
        """What a data: URI holds, or a file below the scene's folder."""
        return decode_data_uri(uri) if is_data_uri(uri) else read_below(self.folder, uri, max_bytes)

    def _check_version(self) -> None:
        asset = get_object(self.tree, "asset", "the file")
        version = asset.get("minVersion", asset.get("version"))
        if version is None:
            self.warn("the file does not say its glTF version: read as 2.0")
        elif not isinstance(version, str) or version.split(".")[0] != "2" or version > "2.0" and "minVersion" in asset:
            raise SceneError(f"glTF {shorten(str(version), 20)} is not read, only 2.0: export the file as glTF 2.0")


def _at(where: str, function, *arguments):
    """Call, and put the place before what it complains of."""
    try:
        return function(*arguments)
    except SceneError as error:
        raise SceneError(f"{where}: {error}") from error


def _read_scene_file(path: Path) -> bytes:
    try:
        if not path.is_file():
            raise InputNotFoundError(f"{path}: no such file: check the path")
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise SceneError(f"the file has {size} bytes, at most {MAX_BYTES} are read: split it")
        return path.read_bytes()
    except OSError as error:
        raise SceneError(f"the file cannot be read ({one_line(error)}): check its rights") from error


def _split_glb(content: bytes) -> tuple[bytes, memoryview | None]:
    """The JSON chunk and the binary chunk (None where there is none) of a GLB container."""
    if len(content) < 20:
        raise SceneError(f"a GLB needs at least 20 bytes, there are {len(content)}: the file is cut short")
    version, length = struct.unpack_from("<II", content, 4)
    if version != 2:
        raise SceneError(f"GLB version {version} is not read, only 2: export the file as glTF 2.0")
    if length > len(content):
        raise SceneError(f"the GLB header promises {length} bytes, there are {len(content)}: the file is cut short")
    chunks: list[tuple[int, memoryview]] = []
    offset, view = 12, memoryview(content)[:length]
    while offset + 8 <= length and len(chunks) < 64:
        size, kind = struct.unpack_from("<II", content, offset)
        if offset + 8 + size > length:
            raise SceneError(f"a GLB chunk of {size} bytes at byte {offset} passes the end: the file is cut short")
        chunks.append((kind, view[offset + 8 : offset + 8 + size]))
        offset += 8 + size
    if not chunks or chunks[0][0] != _JSON_CHUNK:
        raise SceneError("the first GLB chunk is not JSON: export the file again")
    binary = chunks[1][1] if len(chunks) > 1 and chunks[1][0] == _BIN_CHUNK else None
    return bytes(chunks[0][1]), binary


def _refuse_constant(text: str) -> float:
    raise ValueError(f"{text} is no JSON number")


def _parse_json(content: bytes) -> dict:
    try:
        tree = json.loads(content.decode("utf-8-sig").rstrip("\0"), parse_constant=_refuse_constant)
    except RecursionError as error:
        raise SceneError("the JSON is nested too deeply: export the file again") from error
    except ValueError as error:
        raise SceneError(f"the JSON is broken ({one_line(error)}): export the file again") from error
    if not isinstance(tree, dict):
        raise SceneError(f"the JSON needs an object, there is {type_name(tree)}: is this a glTF file?")
    return tree


def is_data_uri(uri: str) -> bool:
    return uri[:5].lower() == "data:"


def decode_data_uri(uri: str) -> bytes:
    """The bytes in a data: URI, base64 or percent-encoded."""
    head, comma, payload = uri.partition(",")
    if not comma:
        raise SceneError("a data: URI lacks its comma: export the file again")
    if not head.endswith(";base64"):
        return unquote_to_bytes(payload)
    try:
        return base64.b64decode(unquote(payload) if "%" in payload else payload)
    except ValueError as error:
        raise SceneError(f"a data: URI is no base64 ({one_line(error)}): export the file again") from error
