"""Small mesh files for the tests of the readers, and broken variants of files from one seed."""

from __future__ import annotations

import random
import re
import struct
from pathlib import Path

import numpy as np

SHARED = Path(__file__).resolve().parents[2] / "shared" / "scenes"
"""Public scenes that are not part of the project."""

SQUARE = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 1.0, 0.0), (0.5, 2.0, 0.0)]
MIXED_FACES = [(0, 1, 2), (0, 1, 2, 3), (2, 4, 3), (0, 1, 2, 4, 3)]
MIXED_TRIANGLES = [(0, 1, 2), (0, 1, 2), (0, 2, 3), (2, 4, 3), (0, 1, 2), (0, 2, 4), (0, 4, 3)]
"""MIXED_FACES, each fanned in place as (0, k, k+1)."""

WORDS = [
    b"-1", b"0", b"nan", b"inf", b"1e999", b"-", b"999999999999999999999", b"99999999", b"4294967296", b"/", b"//",
    b'"', b"[", b"]", b"\n", b"\0", b"\xff", b"#", b"1e30", b"true", b"list", b"vertex", b"element", b"f", b"v",
    b"usemtl", b"..", b"\\", b"=", b" ", b"\r", b"-9223372036854775808", b"0x10", b"1_0", b"solid", b"endsolid",
]  # fmt: skip


def ply_header(form: str, vertex_count: int, face_count: int, more: str = "", position: str = "float") -> str:
    """The header of a PLY file; `more` are further property lines of a vertex."""
    lines = ["ply", f"format {form} 1.0", f"element vertex {vertex_count}"]
    lines += [f"property {position} {name}" for name in "xyz"]
    lines += more.splitlines()
    lines += [f"element face {face_count}", "property list uchar int vertex_indices", "end_header", ""]
    return "\n".join(lines)


def binary_ply(vertices, faces, order: str = "<") -> bytes:
    """A binary PLY of float32 positions and polygons; `order` is < or >."""
    form = "binary_little_endian" if order == "<" else "binary_big_endian"
    body = b"".join(struct.pack(order + "3f", *v) for v in vertices)
    body += b"".join(struct.pack(f"{order}B{len(f)}i", len(f), *f) for f in faces)
    return ply_header(form, len(vertices), len(faces)).encode() + body


def ascii_ply(vertices, faces, more: str = "") -> bytes:
    rows = [" ".join(map(str, v)) for v in vertices] + [" ".join(map(str, (len(f), *f))) for f in faces]
    return (ply_header("ascii", len(vertices), len(faces), more) + "\n".join(rows) + "\n").encode()


def binary_stl(facets, header: bytes = b"") -> bytes:
    """A binary STL; facets : (n, 3, 3)."""
    rows = b"".join(struct.pack("<12fH", 0, 0, 0, *np.ravel(f), 0) for f in facets)
    return header.ljust(80, b"\0") + struct.pack("<I", len(facets)) + rows


def ascii_stl(facets, name: str = "part") -> str:
    lines = [f"solid {name}"]
    for facet in facets:
        lines += ["  facet normal 0 0 1", "    outer loop"]
        lines += [f"      vertex {x} {y} {z}" for x, y, z in facet]
        lines += ["    endloop", "  endfacet"]
    return "\n".join([*lines, f"endsolid {name}", ""])


def mutate(random_: random.Random, data: bytes) -> bytes:
    """`data` with a few bytes or words changed, cut, doubled or put in."""
    content = bytearray(data)
    for _ in range(random_.choice((1, 1, 2, 4, 12))):
        kind, place = random_.randrange(7), random_.randrange(len(content) + 1)
        words = list(re.finditer(rb"\S+", bytes(content[:5000]))) if kind > 4 else []
        if kind == 0 and content:
            content[place % len(content)] = random_.randrange(256)
        elif kind == 1:
            del content[place:]
        elif kind == 2:
            del content[place : place + random_.randrange(1, 60)]
        elif kind == 3:
            content[place:place] = random_.choice(WORDS)
        elif kind == 4:
            content[place:place] = content[place : place + random_.randrange(1, 200)]
        elif words:
            word = random_.choice(words)
            content[word.start() : word.end()] = random_.choice(WORDS if kind == 5 else words[-1:] and [
                random_.choice(words).group()
            ])
    return bytes(content)
