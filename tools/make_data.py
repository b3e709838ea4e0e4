"""Write the meshes, the textures and the computed cards of data/ from closed formulas and one seed.

    python tools/make_data.py [FOLDER]

Run again it gives the same bytes (a test holds this): arithmetic is float64 rounded to float32 once,
random numbers are a generator written out here, and PNG files are stored without compression, whose
bytes would depend on a library's version. The other cards of data/ are written by hand.
"""

from __future__ import annotations

import math
import struct
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from clrast.scene.shapes import icosphere
from clrast.study.hard_cases import card_files

DATA = Path(__file__).resolve().parents[1] / "data"
SEED = 20110721
Pixel = tuple[int, int, int, int]


def ply_bytes(
    positions: np.ndarray,
    triangles: np.ndarray,
    normals: np.ndarray | None = None,
    colors: np.ndarray | None = None,
) -> bytes:
    """A binary little-endian PLY file.

    positions, normals : (n, 3) float64; triangles : (m, 3); colors : (n, 3) uint8, sRGB-encoded
    """
    columns: list[tuple] = [("position", "<f4", 3)]
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(positions)}"]
    lines += [f"property float {name}" for name in "xyz"]
    if normals is not None:
        columns.append(("normal", "<f4", 3))
        lines += [f"property float n{name}" for name in "xyz"]
    if colors is not None:
        columns.append(("color", "u1", 3))
        lines += [f"property uchar {name}" for name in ("red", "green", "blue")]
    lines += [f"element face {len(triangles)}", "property list uchar uint vertex_indices", "end_header", ""]
    vertices = np.zeros(len(positions), np.dtype(columns))
    vertices["position"] = positions
    if normals is not None:
        vertices["normal"] = normals
    if colors is not None:
        vertices["color"] = colors
    faces = np.zeros(len(triangles), np.dtype([("count", "u1"), ("corners", "<u4", 3)]))
    faces["count"], faces["corners"] = 3, triangles
    return "\n".join(lines).encode("ascii") + vertices.tobytes() + faces.tobytes()


def png_bytes(width: int, height: int, pixel: Callable[[int, int], Pixel]) -> bytes:
    """An RGBA PNG file of `pixel(x, y)`, in stored (uncompressed) deflate blocks."""
    raw = b"".join(b"\0" + b"".join(bytes(pixel(x, y)) for x in range(width)) for y in range(height))
    blocks = [raw[start : start + 65535] for start in range(0, len(raw), 65535)]
    stream = b"\x78\x01"
    for k, block in enumerate(blocks):
        stream += struct.pack("<BHH", k == len(blocks) - 1, len(block), len(block) ^ 0xFFFF) + block
    stream += struct.pack(">I", zlib.adler32(raw))

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    header = struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", stream) + chunk(b"IEND", b"")


def random_byte(*key: int) -> int:
    """A byte that depends on SEED and the key alone (a multiply-and-shift hash of 32 bits)."""
    state = SEED
    for part in key:
        state = ((state ^ part) * 0x9E3779B1 + 0x7F4A7C15) & 0xFFFFFFFF
        state ^= state >> 15
    return ((state * 0x85EBCA6B) & 0xFFFFFFFF) >> 24


def checker_pixel(x: int, y: int) -> Pixel:
    """Two tiles by two of 32 pixels, with worn edges and a grain."""
    light = (x // 32 + y // 32) % 2 == 0
    edge = 24 if min(x % 32, y % 32, 31 - x % 32, 31 - y % 32) < 1 else 0
    grain = random_byte(x, y) // 16 - 8
    red, green, blue = (214, 206, 190) if light else (96, 74, 62)
    return (red + grain - edge, green + grain - edge, blue + grain - edge, 255)


def fence_pixel(x: int, y: int) -> Pixel:
    """One mesh of a wire fence, 32 pixels wide: two crossing diagonals, opaque; the rest is clear."""
    wire = min((x + y) % 32, 32 - (x + y) % 32, (x - y) % 32, 32 - (x - y) % 32)
    shade = 200 - 22 * wire
    return (shade, shade, shade + 6, 255) if wire < 4 else (160, 160, 166, 0)


def hue(turn: float) -> tuple[int, int, int]:
    """A saturated sRGB colour; `turn` goes once round the circle from 0 to 1."""
    red, green, blue = (int(140.0 + 110.0 * math.cos(2.0 * math.pi * (turn - k / 3.0))) for k in range(3))
    return red, green, blue


def knot(steps: int = 160, sides: int = 16, radius: float = 0.14) -> bytes:
    """A (2, 3) torus knot as a tube, with smooth normals and the colours of the rainbow along it.

    Centre line: ((2 + cos 3a) cos 2a, (2 + cos 3a) sin 2a, sin 3a) / 3, a from 0 to 2 pi.
    """

    def center(a: float) -> tuple[float, float, float]:
        ring = 2.0 + math.cos(3.0 * a)
        return (ring * math.cos(2.0 * a) / 3.0, math.sin(3.0 * a) / 3.0, ring * math.sin(2.0 * a) / 3.0)

    positions, normals, colors, triangles = [], [], [], []
    for i in range(steps):
        a = 2.0 * math.pi * i / steps
        here, before, after = center(a), center(a - 1e-3), center(a + 1e-3)
        ahead = unit(tuple(q - p for p, q in zip(before, after)))
        bend = tuple(p - 2.0 * c + q for p, c, q in zip(before, here, after))
        side = unit(cross(ahead, bend))
        up = cross(side, ahead)
        for j in range(sides):
            b = 2.0 * math.pi * j / sides
            normal = [math.cos(b) * s + math.sin(b) * u for s, u in zip(side, up)]
            normals.append(normal)
            positions.append([c + radius * n for c, n in zip(here, normal)])
            colors.append(hue(i / steps))
            right, forward = i * sides + (j + 1) % sides, (i + 1) % steps * sides
            triangles.append((i * sides + j, forward + j, right))
            triangles.append((right, forward + j, forward + (j + 1) % sides))
    return ply_bytes(np.array(positions), np.array(triangles), np.array(normals), np.array(colors, np.uint8))


def unit(v: tuple[float, ...]) -> tuple[float, ...]:
    length = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    return tuple(c / length for c in v)


def cross(a: tuple[float, ...], b: tuple[float, ...]) -> tuple[float, ...]:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def fan_card(blades: int = 24) -> bytes:
    """A closed fan round a vertex that lies at the centre of pixel (32, 32) of a 64x64 image, exactly.

    With fov 90 the ray through viewport point (x, y) has d = ((x - 32) / 32, (32 - y) / 32, -1). All
    vertices are at z = -4, and x and y are multiples of 1/16 (half a pixel there), which float32 holds.
    Rim vertices lie at pixel corners and pixel centres near a circle of 28 pixels.
    """

    def at(x: float, y: float) -> str:
        return f"[{(x - 32.0) / 8.0!r}, {(32.0 - y) / 8.0!r}, -4.0]"

    rim = []
    for k in range(blades):
        angle = 2.0 * math.pi * k / blades
        x, y = 32.5 + 28.0 * math.cos(angle), 32.5 - 28.0 * math.sin(angle)
        rim.append(at(math.floor(2.0 * x + 0.5) / 2.0, math.floor(2.0 * y + 0.5) / 2.0))
    lines = [
        "# A closed fan: each ray inside its rim meets exactly one blade, the one at its hub too.",
        "# Written by tools/make_data.py: the hub is at the centre of pixel (32, 32), to the last bit.",
        'name = "fan"',
        "",
        "[image]",
        "size = [64, 64]",
        "",
        "[[camera]]",
        "eye = [0.0, 0.0, 0.0]",
        "look_at = [0.0, 0.0, -1.0]",
        "fov = 90.0",
        "",
        "[[mesh]]",
        'name = "fan"',
        "vertices = [",
        f"  {at(32.5, 32.5)},",
        *(f"  {vertex}," for vertex in rim),
        "]",
        "triangles = [",
        *(f"  [0, {k + 1}, {(k + 1) % blades + 1}]," for k in range(blades)),
        "]",
        "",
    ]
    return "\n".join(lines).encode("ascii")


def make_files() -> dict[str, bytes]:
    """Every generated file, by its path below data/."""
    ball = icosphere(4)
    return {
        "fan.toml": fan_card(),
        "meshes/icosphere.ply": ply_bytes(ball.positions, ball.triangles),
        "meshes/knot.ply": knot(),
        "textures/checker.png": png_bytes(64, 64, checker_pixel),
        "textures/fence.png": png_bytes(32, 32, fence_pixel),
        **{f"hard/{name}": content for name, content in card_files().items()},
    }


def main(folder: Path = DATA) -> None:
    for name, content in make_files().items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
        print(f"{name}: {len(content)} bytes")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
