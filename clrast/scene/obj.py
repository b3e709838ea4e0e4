"""Wavefront OBJ: triangles in the order of the `f` lines, whatever their materials and objects.

Read here and not by trimesh 5.2, which was measured to resolve relative indices from the end of the
file instead of from the face's line, to skip a `v` that a tab follows, to take index 0 as vertex 0, and
to sort faces by material: each of them without a word.

- A polygon becomes a fan (0, k, k+1) in place, concave ones too. Vertices are split where texture
  coordinates or normals differ; the parts keep bitwise the same position.
- `vt` grows upwards in OBJ and downwards in a Scene: v is flipped. Colours after `v x y z` are linear.
- Each name of an `o` or `g` line is an object, each name of a `usemtl` line a material, both numbered in
  the order in which faces first use them.
- Not drawn, and said so: lines, points, free-form surfaces. Smoothing groups make no normals.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

import numpy as np

from clrast.errors import SceneError
from clrast.scene.model import Scene
from clrast.scene.mtl import MaterialLibrary
from clrast.scene.polygons import fan_triangles, unit_rows
from clrast.scene.texture import shorten

_ABSENT = 1 << 62
"""Stands for an index that a corner leaves out, between the slashes."""
_OTHER_FLOAT = re.compile(r"([+-]?)1\.#(INF|IND|QNAN|SNAN)[0-9]*", re.IGNORECASE)
_SILENT = frozenset({"bevel", "c_interp", "d_interp", "lod", "mg", "shadow_obj", "trace_obj", "vp"})


@dataclass
class Statements:
    """The lines of an OBJ file by kind, without their keyword; `_lines` are line numbers, from 1.

    faces : corners as written; face_counts : v, vt and vn lines before each face;
    face_materials, face_objects : into the lists of names
    """

    positions: list[str] = field(default_factory=list)
    position_lines: list[int] = field(default_factory=list)
    texture_coordinates: list[str] = field(default_factory=list)
    texture_coordinate_lines: list[int] = field(default_factory=list)
    normals: list[str] = field(default_factory=list)
    normal_lines: list[int] = field(default_factory=list)
    faces: list[list[str]] = field(default_factory=list)
    face_lines: list[int] = field(default_factory=list)
    face_counts: list[tuple[int, int, int]] = field(default_factory=list)
    face_materials: list[int] = field(default_factory=list)
    face_objects: list[int] = field(default_factory=list)
    material_names: list[str | None] = field(default_factory=lambda: [None])
    object_names: list[str | None] = field(default_factory=lambda: [None])
    libraries: list[str] = field(default_factory=list)
    smoothed: bool = False
    left_out: dict[str, int] = field(default_factory=dict)


def read_obj(path: Path) -> Scene:
    """The triangles of an OBJ file; positions are float64, not yet rounded or checked."""
    statements = read_statements(path.read_bytes().decode("utf-8", "replace"))
    warnings = _left_out_warnings(statements)
    positions, colors = _read_positions(statements)
    uv = _read_numbers(statements.texture_coordinates, statements.texture_coordinate_lines, 2, "vt", 1)
    normals = _read_numbers(statements.normals, statements.normal_lines, 3, "vn", 3)
    corners = _read_corners(statements, (len(positions), len(uv), len(normals)))
    counts = np.fromiter(map(len, statements.faces), np.int64, len(statements.faces))
    triangles, faces = fan_triangles(counts)
    short = int((counts < 3).sum())
    if short:
        warnings.append(f"faces with fewer than 3 corners are not drawn: {short}")
    if statements.smoothed and not len(normals):
        warnings.append("smoothing groups make no normals: export the file with normals for a smooth look")
    objects, object_ids = _number_by_use(statements.object_names, statements.face_objects, faces)
    names, material_ids = _number_by_use(statements.material_names, statements.face_materials, faces)
    library = MaterialLibrary(path.parent, statements.libraries, warnings)
    materials = tuple(library.material(name, colors is not None) for name in names)
    vertices, triangles = _split_vertices(corners, triangles)
    return Scene(
        positions=positions[vertices[:, 0]],
        triangles=triangles,
        object_ids=object_ids,
        material_ids=material_ids,
        normals=_gather(normals, vertices[:, 2], unit_rows),
        uv=_gather(uv, vertices[:, 1], _flip_v),
        colors=None if colors is None else colors[vertices[:, 0]],
        materials=materials or (library.material(None, False),),
        textures=tuple(library.textures),
        object_names=tuple(path.stem if name is None else name for name in objects) or (path.stem,),
        warnings=tuple(warnings),
        name=path.stem,
    )


def read_statements(text: str) -> Statements:
    """Sort the lines of an OBJ file by their keyword."""
    found = Statements()
    positions, position_lines = found.positions, found.position_lines
    faces, face_lines, face_counts = found.faces, found.face_lines, found.face_counts
    face_materials, face_objects = found.face_materials, found.face_objects
    texture_coordinates, normals = found.texture_coordinates, found.normals
    current = {"usemtl": 0, "o": 0}
    material = group = 0
    known: dict[str, dict[str, int]] = {"usemtl": {}, "o": {}}
    for number, line in _logical_lines(text):
        words = line.split(None, 1)
        if not words:
            continue
        keyword = words[0]
        rest = words[1] if len(words) == 2 else ""
        if keyword == "v":
            positions.append(rest)
            position_lines.append(number)
        elif keyword == "f":
            faces.append(_words(rest))
            face_lines.append(number)
            face_counts.append((len(positions), len(texture_coordinates), len(normals)))
            face_materials.append(material)
            face_objects.append(group)
        elif keyword == "vt":
            texture_coordinates.append(rest)
            found.texture_coordinate_lines.append(number)
        elif keyword == "vn":
            normals.append(rest)
            found.normal_lines.append(number)
        elif keyword[0] != "#":
            _read_state(found, keyword, rest.strip(), current, known)
            material, group = current["usemtl"], current["o"]
    return found


def _read_state(
    found: Statements, keyword: str, rest: str, current: dict[str, int], known: dict[str, dict[str, int]]
) -> None:
    """A line that is no vertex and no face: names that hold for the faces below it, libraries, the rest."""
    if keyword in ("usemtl", "o", "g"):
        kind = "usemtl" if keyword == "usemtl" else "o"
        names = found.material_names if kind == "usemtl" else found.object_names
        if not rest:
            current[kind] = 0
            return
        if rest not in known[kind]:
            known[kind][rest] = len(names)
            names.append(rest)
        current[kind] = known[kind][rest]
    elif keyword == "mtllib":
        found.libraries.append(rest)
    elif keyword == "s":
        found.smoothed = found.smoothed or rest not in ("off", "0", "")
    elif keyword not in _SILENT:
        key = shorten(keyword, 20)
        if key in found.left_out or len(found.left_out) < 8:
            found.left_out[key] = found.left_out.get(key, 0) + 1


def _logical_lines(text: str) -> Iterable[tuple[int, str]]:
    """(number, line) of each line; a backslash at its end joins the next one to it."""
    if "\r" in text:
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    lines = text.split("\n")
    if "\\\n" not in text:
        return enumerate(lines, 1)
    joined: list[tuple[int, str]] = []
    parts: list[str] = []
    for number, line in enumerate(lines, 1):
        continues = line.endswith("\\")
        parts.append(line[:-1] if continues else line)
        if not continues or number == len(lines):
            joined.append((number - len(parts) + 1, " ".join(parts)))
            parts = []
    return joined


def _left_out_warnings(statements: Statements) -> list[str]:
    kinds = {"l": "lines", "p": "points"}
    return [
        f"{kinds[key]} are not drawn: {count}" if key in kinds else f"'{key}' statements are not read: {count}"
        for key, count in statements.left_out.items()
    ]


def _read_positions(statements: Statements) -> tuple[np.ndarray, np.ndarray | None]:
    """(vertex_count, 3) float64 positions, and (vertex_count, 4) float32 linear colours or None.

    A line has x y z, or x y z w (w is for curves), or x y z r g b.
    """
    lines, numbers = statements.positions, statements.position_lines
    rows = list(map(_words, lines))
    widths = set(map(len, rows))
    if widths <= {3}:
        return _to_floats(rows, numbers, "v").reshape(-1, 3), None
    if min(widths) < 3:
        bad = next(i for i, row in enumerate(rows) if len(row) < 3)
        raise SceneError(f"line {numbers[bad]}: 'v {shorten(lines[bad], 40)}' has fewer than 3 numbers: repair it")
    positions = _to_floats([row[:3] for row in rows], numbers, "v").reshape(-1, 3)
    if max(widths) < 6:
        return positions, None
    white = ["1", "1", "1"]
    values = _to_floats([row[3:6] if len(row) >= 6 else white for row in rows], numbers, "v").reshape(-1, 3)
    colors = np.ones((len(rows), 4), np.float32)
    with np.errstate(over="ignore"):
        colors[:, :3] = values
    return positions, colors


def _words(rest: str) -> list[str]:
    """The words before a comment, which begins with a word that begins with #."""
    words = rest.split()
    if "#" in rest:
        for k, word in enumerate(words):
            if word[0] == "#":
                return words[:k]
    return words


def _read_numbers(lines: list[str], numbers: list[int], width: int, keyword: str, least: int) -> np.ndarray:
    """(line_count, width) float64; numbers that a line leaves out are 0, it has at least `least`."""
    rows = list(map(_words, lines))
    for i, row in enumerate(rows):
        if len(row) != width:
            if len(row) < least:
                shown = shorten(lines[i].strip(), 40)
                raise SceneError(f"line {numbers[i]}: '{keyword} {shown}' needs {least} numbers or more: repair it")
            rows[i] = row[:width] + ["0"] * (width - len(row))
    return _to_floats(rows, numbers, keyword).reshape(-1, width)


def _to_floats(rows: list[list[str]], numbers: list[int], keyword: str) -> np.ndarray:
    """All numbers of `rows`, one behind the other : (count,) float64."""
    try:
        return np.array(list(map(float, chain.from_iterable(rows))), np.float64)
    except ValueError:
        pass
    values = []
    for row, number in zip(rows, numbers, strict=True):
        for word in row:
            try:
                values.append(float(word))
            except ValueError:
                other = _OTHER_FLOAT.fullmatch(word)  # how some C libraries print NaN and infinity
                if other is None:
                    shown = shorten(word, 40)
                    raise SceneError(f"line {number}: '{shown}' in '{keyword}' is no number: repair the file") from None
                values.append(float(other.group(1) + ("inf" if other.group(2).upper() == "INF" else "nan")))
    return np.array(values, np.float64)


def _read_corners(statements: Statements, totals: tuple[int, int, int]) -> np.ndarray:
    """(corner_count, 3) int64: indices from 0 of position, texture coordinates and normal; -1 where left out."""
    written = _parse_corners(statements)
    counts = np.fromiter(map(len, statements.faces), np.int64, len(statements.faces))
    faces = np.repeat(np.arange(len(counts), dtype=np.int64), counts)
    before = np.array(statements.face_counts, np.int64).reshape(-1, 3)[faces]
    corners = np.where(written > 0, written - 1, before + written)
    given = written != _ABSENT
    bad = given & ((written == 0) | (corners < 0) | (corners >= np.array(totals, np.int64)))
    bad[:, 0] |= ~given[:, 0]
    if bad.any():
        corner = int(np.argmax(bad.any(axis=1)))
        kind = int(np.argmax(bad[corner]))
        raise _index_error(statements, int(faces[corner]), int(written[corner, kind]), kind, totals[kind])
    corners[~given] = -1
    return corners


def _index_error(statements: Statements, face: int, index: int, kind: int, total: int) -> SceneError:
    keyword = ("v", "vt", "vn")[kind]
    where = f"line {statements.face_lines[face]}: 'f {shorten(' '.join(statements.faces[face]), 40)}'"
    if index == 0:
        return SceneError(f"{where} has index 0, OBJ counts from 1: repair it")
    if index < 0:
        before = statements.face_counts[face][kind]
        return SceneError(f"{where} has {keyword} index {index}, {before} '{keyword}' lines precede it: repair it")
    return SceneError(f"{where} has {keyword} index {index}, the file has {total} '{keyword}' lines: repair it")


def _parse_corners(statements: Statements) -> np.ndarray:
    """(corner_count, 3) int64 as written: v, vt, vn, counted from 1 or backwards; _ABSENT where left out."""
    words = list(chain.from_iterable(statements.faces))
    if not words:
        return np.zeros((0, 3), np.int64)
    absent = f"/{_ABSENT}"
    slashes = list(map(_count_slashes, words))
    if any(count != 2 for count in slashes):
        endings = (absent + absent, absent, "")
        words = [word + endings[min(count, 2)] for word, count in zip(words, slashes, strict=True)]
    text = " ".join(words) + " "
    text = text.replace("//", f"{absent}/").replace("/ ", f"{absent} ").replace("/", " ")
    try:
        numbers = np.fromstring(text, np.int64, sep=" ")
    except ValueError:
        numbers = np.zeros(0, np.int64)
    if len(numbers) != 3 * len(words) or max(slashes) > 2:
        _find_bad_corner(statements)
    return numbers.reshape(-1, 3)


_count_slashes: Callable[[str], int] = lambda word: word.count("/")  # noqa: E731
_CORNER = re.compile(r"[+-]?[0-9]+(/([+-]?[0-9]+)?(/([+-]?[0-9]+)?)?)?")


def _find_bad_corner(statements: Statements) -> None:
    for face, number in zip(statements.faces, statements.face_lines, strict=True):
        for word in face:
            if not _CORNER.fullmatch(word):
                shown = shorten(word, 40)
                raise SceneError(f"line {number}: '{shown}' is no corner such as v, v/vt, v//vn or v/vt/vn: repair it")
    raise SceneError("its faces cannot be read: export the file again")


def _number_by_use(names: list[str | None], of_faces: list[int], faces: np.ndarray) -> tuple[list, np.ndarray]:
    """The names that triangles use, in that order, and (triangle_count,) uint32 places in that list.

    of_faces : (face_count,) a name of each face; faces : (triangle_count,) the face of each triangle
    """
    used = np.array(of_faces, np.int64)[faces] if len(faces) else np.zeros(0, np.int64)
    kinds, first = np.unique(used, return_index=True)
    order = kinds[np.argsort(first, kind="stable")]
    places = np.zeros(len(names), np.uint32)
    places[order] = np.arange(len(order), dtype=np.uint32)
    return [names[k] for k in order], places[used]


def _split_vertices(corners: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One vertex for each triple of indices that occurs, in the order of their positions in the file.

    corners : (corner_count, 3) int64; triangles : (triangle_count, 3) places in `corners`
    Returns (vertex_count, 3) int64 triples, and (triangle_count, 3) uint32 into them.
    """
    if not len(corners):
        return np.zeros((0, 3), np.int64), np.zeros((0, 3), np.uint32)
    extent = corners.max(axis=0) + 2  # -1 takes place 0
    attributes, attribute_ids = np.unique((corners[:, 1] + 1) * extent[2] + corners[:, 2] + 1, return_inverse=True)
    keys, vertex_ids = np.unique(corners[:, 0] * len(attributes) + attribute_ids.reshape(-1), return_inverse=True)
    attribute = attributes[keys % len(attributes)]
    vertices = np.stack((keys // len(attributes), attribute // extent[2] - 1, attribute % extent[2] - 1), axis=1)
    return vertices, vertex_ids.reshape(-1).astype(np.uint32)[triangles]


def _gather(values: np.ndarray, rows: np.ndarray, convert: Callable[[np.ndarray], np.ndarray]) -> np.ndarray | None:
    """float32 values of vertices, 0 where `rows` is -1; None where all are."""
    if not (rows >= 0).any():
        return None
    converted = convert(values)
    gathered = converted[rows]
    gathered[rows < 0] = 0.0
    return gathered


def _flip_v(uv: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore"):
        return np.stack((uv[:, 0], 1.0 - uv[:, 1]), axis=1).astype(np.float32)
