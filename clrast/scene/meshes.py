"""STL and OFF meshes, and the way in to PLY: triangles alone, in the order of the file.

STL goes through trimesh's own exchange module, which gives the soup as it stands (what `process=False`
would keep), without the cost of a Trimesh object. OFF is read here: trimesh 5.2 puts triangles before
quads, and drops vertex colours without a word. PLY is in ply.py.
"""

from __future__ import annotations

import io
import logging
import re
from pathlib import Path

import numpy as np

from clrast.errors import SceneError
from clrast.scene.color import decode_srgb8, linear_rgba
from clrast.scene.model import Material, Scene
from clrast.scene.ply import read_ply
from clrast.scene.polygons import fan_triangles, unit_rows
from clrast.scene.texture import shorten

_STL_HEADER_BYTES, _STL_FACET_BYTES = 84, 50
_OFF_KEYWORD = re.compile(r"(ST)?(C)?(N)?(4)?(n)?OFF")


def read_mesh(path: Path) -> Scene:
    """The triangles of a .ply, .stl or .off file; positions are not yet rounded or checked."""
    return {".ply": read_ply, ".stl": read_stl, ".off": read_off}[path.suffix.lower()](path)


def read_stl(path: Path) -> Scene:
    """The facets of an STL file, binary or ASCII: three vertices each, as they stand.

    Facet normals are not used (the geometric ones are). Each `solid` of an ASCII file is an object.
    """
    warnings: list[str] = []
    data, vertex_count = _prepare_stl(path.read_bytes(), warnings)
    loaded = _load_stl(data)
    solids = loaded.get("geometry", {path.stem: loaded})
    names = tuple(solids) or (path.stem,)
    if solids and "geometry" not in loaded:
        names = (loaded["metadata"].get("name") or path.stem,)
    positions = [np.asarray(solid["vertices"], np.float64) for solid in solids.values()]
    counts = [len(p) // 3 for p in positions]
    vertices = np.concatenate(positions) if positions else np.zeros((0, 3), np.float64)
    if len(vertices) != vertex_count:
        raise SceneError(
            f"it has {vertex_count} vertex lines, {len(vertices)} of them in whole facets between solid and endsolid: "
            "it is cut short, export it again"
        )
    return Scene(
        positions=vertices,
        triangles=np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3),
        object_ids=np.repeat(np.arange(len(counts), dtype=np.uint32), counts),
        material_ids=np.zeros(len(vertices) // 3, np.uint32),
        materials=(Material(double_sided=True),),
        object_names=names,
        warnings=tuple(warnings),
        name=path.stem,
    )


def _load_stl(data: bytes) -> dict:
    """What trimesh reads; its log, which prints tracebacks to the terminal, is silent meanwhile."""
    from trimesh.exchange.stl import load_stl

    log, silence = logging.getLogger("trimesh"), logging.NullHandler()
    before, log.propagate = log.propagate, False
    log.addHandler(silence)
    try:
        return load_stl(io.BytesIO(data))
    finally:
        log.removeHandler(silence)
        log.propagate = before


def _prepare_stl(data: bytes, warnings: list[str]) -> tuple[bytes, int]:
    """The bytes that trimesh takes for what they are: binary of exact length, or plain text; and their vertex count."""
    facet_count = int.from_bytes(data[80:84], "little") if len(data) >= _STL_HEADER_BYTES else -1
    length = _STL_HEADER_BYTES + _STL_FACET_BYTES * facet_count
    if facet_count >= 0 and length == len(data):
        return data, 3 * facet_count
    if data[:1024].lstrip()[:5].lower() == b"solid" and b"\0" not in data:
        text = data.decode("utf-8", "replace").replace("\r\n", "\n").replace("\r", "\n")
        text = re.sub(r"(?im)^([ \t]*(?:end)?solid)\b(.*)$", _without_keywords, text)
        return text.encode("utf-8"), len(re.findall(r"(?im)^[ \t]*vertex\b", text))
    if facet_count < 0:
        raise SceneError("it is too short for a binary STL and no ASCII one: export the file again")
    if length > len(data):
        raise SceneError(
            f"the header says {facet_count} facets, which take {length} bytes, the file has {len(data)}: "
            "it is cut short, export it again"
        )
    warnings.append(f"{len(data) - length} bytes after the last facet are not read")
    return data[:length], 3 * facet_count


def _without_keywords(line: re.Match[str]) -> str:
    """A `solid` line whose name has no word that trimesh would take for a vertex or a normal."""
    return line.group(1) + re.sub(r"(?i)vertex|normal|solid", "_", line.group(2))


def read_off(path: Path) -> Scene:
    """The faces of an ASCII OFF file: COFF colours and NOFF normals of vertices too.

    Vertex colours are sRGB-encoded 0..255 where all are whole numbers and one is above 1, else linear 0..1.
    """
    text = path.read_bytes().decode("utf-8", "replace")
    text = re.sub(r"#[^\r\n]*", "", text)
    lines = [line for line in text.replace("\r", "\n").split("\n") if line.strip()]
    flags, vertex_count, face_count, first = _off_header(lines)
    if len(lines) - first < vertex_count + face_count:
        raise SceneError(
            f"the header says {vertex_count} vertices and {face_count} faces, {len(lines) - first} lines follow: "
            "it is cut short, export it again"
        )
    rows = _off_rows(lines[first : first + vertex_count])
    warnings: list[str] = []
    triangles = _off_faces(lines[first + vertex_count : first + vertex_count + face_count], vertex_count, warnings)
    if "ST" in flags:
        warnings.append("texture coordinates of OFF are not read: export them in another format")
    normals, colors = _off_attributes(rows, flags)
    base = Material().base_color if colors is None else (1.0, 1.0, 1.0, 1.0)
    return Scene(
        positions=rows[:, :3],
        triangles=triangles,
        object_ids=np.zeros(len(triangles), np.uint32),
        material_ids=np.zeros(len(triangles), np.uint32),
        normals=normals,
        colors=colors,
        materials=(Material(base_color=base, double_sided=True),),
        object_names=(path.stem,),
        warnings=tuple(warnings),
        name=path.stem,
    )


def _off_header(lines: list[str]) -> tuple[str, int, int, int]:
    """Letters before OFF, vertex and face counts, and the first line after the header."""
    words = lines[0].split(None, 1) if lines else [""]
    keyword = _OFF_KEYWORD.match(words[0])
    if keyword is None:
        raise SceneError("the first line does not begin with OFF: this is no OFF file, give another or rename it")
    if keyword.group(4) or keyword.group(5):
        raise SceneError(f"{keyword.group()} has vertices of four or n dimensions: export it as OFF")
    rest = lines[0].strip()[keyword.end() :].strip()
    if rest.upper().startswith("BINARY"):
        raise SceneError("it is a binary OFF file, only ASCII ones are read: export it as ASCII")
    first = 1
    if not rest:
        rest, first = (lines[1] if len(lines) > 1 else ""), 2
    counts = rest.split()
    if len(counts) < 2 or not all(re.fullmatch(r"[0-9]{1,18}", word) for word in counts[:2]):
        raise SceneError(f'"{shorten(rest.strip(), 40)}" stands where two counts are needed: export the file again')
    return keyword.group()[:-3], int(counts[0]), int(counts[1]), first


def _off_rows(lines: list[str]) -> np.ndarray:
    """(vertex_count, width) float64 of the vertex lines: the columns that all of them have."""
    if not lines:
        return np.zeros((0, 3), np.float64)
    rows = [line.split() for line in lines]
    width = min(map(len, rows))
    if width < 3:
        raise SceneError("a vertex has fewer than three coordinates: export the file again")
    return np.array([[float(word) for word in row[:width]] for row in rows], np.float64)


def _off_faces(lines: list[str], vertex_count: int, warnings: list[str]) -> np.ndarray:
    """(triangle_count, 3) uint32: polygons fanned in place, in the order of the file."""
    counts: list[int] = []
    corners: list[int] = []
    colored = 0
    for number, line in enumerate(lines):
        words = line.split()
        count = int(words[0])
        if not 0 <= count < len(words):
            raise SceneError(f"face {number} says {count} corners, its line has {len(words) - 1}: repair the file")
        face = list(map(int, words[1 : count + 1]))
        if face and not (min(face) >= 0 and max(face) < vertex_count):
            raise SceneError(
                f"face {number} has a vertex index outside 0 to {vertex_count - 1}, "
                f"there are {vertex_count} vertices: repair the file"
            )
        colored += len(words) > count + 1
        counts.append(count)
        corners += face
    if colored:
        warnings.append(f"colours of faces are not read: {colored}")
    short = sum(count < 3 for count in counts)
    if short:
        warnings.append(f"faces with fewer than 3 corners are not drawn: {short}")
    places, _ = fan_triangles(np.array(counts, np.int64))
    return np.array(corners, np.uint32)[places].reshape(-1, 3)


def _off_attributes(rows: np.ndarray, flags: str) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Vertex normals (n, 3) and colours (n, 4), both float32; None where the keyword has no N or C.

    Columns are x y z, then the normal and the colour that the keyword promises.
    """
    column = 3
    normals = None
    if "N" in flags:
        normals = unit_rows(rows[:, 3:6]) if rows.shape[1] >= 6 else None
        column = 6
    values = rows[:, column : column + 4]
    if "C" not in flags or values.shape[1] < 3 or len(values) == 0:
        return normals, None
    if "ST" in flags and values.shape[1] == 4:
        values = values[:, :3]
    whole = bool((values == np.floor(values)).all()) and float(values.max()) > 1.0
    if whole:
        return normals, decode_srgb8(np.clip(values, 0.0, 255.0).astype(np.uint8))
    return normals, linear_rgba(values)
