"""A tiny writer of GLB files, for tests that need one with known contents."""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path

import numpy as np
import PIL.Image

COMPONENT_CODES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
TRIANGLE = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]


class GltfWriter:
    """Collects objects into `tree` and bytes into `blob`; `add` and friends return the new index."""

    def __init__(self) -> None:
        self.tree: dict = {"asset": {"version": "2.0"}}
        self.blob = bytearray()

    def add(self, kind: str, **entry) -> int:
        self.tree.setdefault(kind, []).append(entry)
        return len(self.tree[kind]) - 1

    def view(self, content: bytes, **more) -> int:
        self.blob += b"\0" * (-len(self.blob) % 4)
        entry = {"buffer": 0, "byteOffset": len(self.blob), "byteLength": len(content), **more}
        self.blob += content
        return self.add("bufferViews", **entry)

    def accessor(self, values, dtype: str = "f4", **more) -> int:
        array = np.array(values, dtype="<" + dtype)
        array = array.reshape(len(array), -1)
        entry = {"count": len(array), "type": TYPES[array.shape[1]], "componentType": COMPONENT_CODES[dtype]}
        return self.add("accessors", bufferView=self.view(array.tobytes()), **{**entry, **more})

    def mesh(self, positions=None, indices=None, name=None, **more) -> int:
        """A mesh of one primitive; upper-case keywords are attributes (accessor numbers)."""
        attributes = {key: value for key, value in more.items() if key.isupper() or key[-1].isdigit()}
        primitive: dict = {key: value for key, value in more.items() if key not in attributes}
        if positions is not None:
            attributes["POSITION"] = self.accessor(positions)
        if indices is not None:
            primitive["indices"] = self.accessor(indices, "u2")
        named = {} if name is None else {"name": name}
        return self.add("meshes", primitives=[{"attributes": attributes, **primitive}], **named)

    def triangle(self, **more) -> int:
        return self.mesh(TRIANGLE, **more)

    def node(self, **entry) -> int:
        return self.add("nodes", **entry)

    def scene(self, *roots: int) -> GltfWriter:
        self.add("scenes", nodes=list(roots))
        return self

    def image(self, texels, **more) -> int:
        """An image of (height, width, 3 or 4) uint8 texels, in a buffer view."""
        return self.add("images", bufferView=self.view(png_bytes(texels)), mimeType="image/png", **more)

    def glb(self) -> bytes:
        self.tree["buffers"] = [{"byteLength": len(self.blob)}]
        return pack_glb(json.dumps(self.tree).encode(), bytes(self.blob))

    def write(self, folder: Path, name: str = "scene.glb") -> Path:
        path = folder / name
        path.write_bytes(self.glb())
        return path


def pack_glb(text: bytes, blob: bytes) -> bytes:
    text += b" " * (-len(text) % 4)
    blob += b"\0" * (-len(blob) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(blob), 0x004E4942) + blob
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def png_bytes(texels) -> bytes:
    stream = io.BytesIO()
    PIL.Image.fromarray(np.asarray(texels)).save(stream, "PNG")
    return stream.getvalue()
