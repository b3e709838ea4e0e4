"""PLY meshes: polygons of any size, vertex colours, normals, texture coordinates, one texture.

Read here and not by trimesh 5.2, which was measured to
- put all triangles before all quads, and the halves of a quad far apart, where the file's order is wanted;
- refuse a binary file whose polygons differ in size;
- accept an ASCII file that holds fewer vertices than its header says;
- take three times as long for the bunny.
On files of triangles alone both agree (tests).

Colours: 8-bit ones are sRGB-encoded, float ones linear (color.py); they multiply a white base colour.
Texture coordinates (s t, u v or texture_u texture_v) grow upwards in PLY; v is flipped to the way down.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from clrast.errors import SceneError
from clrast.scene.color import decode_srgb8, linear_rgba
from clrast.scene.model import Material, Scene, Texture, TextureUse
from clrast.scene.ply_file import Element, Header, read_columns
from clrast.scene.polygons import fan_triangles, unit_rows
from clrast.scene.texture import load_image_file, shorten

_INDEX_LISTS = ("vertex_indices", "vertex_index")
_UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
_COLOR_NAMES = (("red", "green", "blue"), ("r", "g", "b"), ("diffuse_red", "diffuse_green", "diffuse_blue"))


def read_ply(path: Path) -> Scene:
    """The triangles of a PLY file in its order; positions are float64, not yet rounded or checked."""
    header = read_columns(path.read_bytes())
    elements = {element.name: element for element in header.elements}
    vertex = elements.get("vertex", Element("vertex", 0))
    warnings: list[str] = []
    positions = _positions(vertex)
    triangles = _triangles(elements, len(positions), warnings)
    colors, uv = _colors(vertex, warnings), _texture_coordinates(vertex)
    normals = _stack(vertex, ("nx", "ny", "nz"))
    material, textures = _material(path, header, colors is not None, uv is not None, warnings)
    return Scene(
        positions=positions,
        triangles=triangles,
        object_ids=np.zeros(len(triangles), np.uint32),
        material_ids=np.zeros(len(triangles), np.uint32),
        normals=None if normals is None else unit_rows(normals),
        uv=uv,
        colors=colors,
        materials=(material,),
        textures=textures,
        object_names=(path.stem,),
        warnings=tuple(warnings),
        name=path.stem,
    )


def _stack(element: Element, names: tuple[str, ...]) -> np.ndarray | None:
    """(row_count, len(names)) float64 of the columns `names`, None where one is absent."""
    if not all(name in element.columns for name in names):
        return None
    return np.stack([element.columns[name].astype(np.float64) for name in names], axis=1)


def _positions(vertex: Element) -> np.ndarray:
    positions = _stack(vertex, ("x", "y", "z"))
    if positions is None:
        if vertex.row_count:
            raise SceneError("its vertices lack x, y or z: export the file again")
        return np.zeros((0, 3), np.float64)
    return positions


def _triangles(elements: dict[str, Element], vertex_count: int, warnings: list[str]) -> np.ndarray:
    """(triangle_count, 3) uint32: polygons fanned in place, in the order of the file."""
    none = np.zeros((0, 3), np.uint32)
    if "edge" in elements and elements["edge"].row_count:
        warnings.append(f"edges are not drawn: {elements['edge'].row_count}")
    face = elements.get("face")
    if face is None or face.row_count == 0:
        if "tristrips" in elements:
            raise SceneError("its triangles are strips (tristrips), which are not read: convert it to faces")
        return none
    name = next((name for name in _INDEX_LISTS if name in face.lists), None)
    if name is None:
        raise SceneError("its faces have no list vertex_indices: export the file again")
    if "texcoord" in face.lists:
        warnings.append("texture coordinates per face (texcoord) are not read: export them per vertex")
    if any(names[0] in face.columns for names in _COLOR_NAMES):
        warnings.append("colours per face are not read: export them per vertex")
    counts, values = face.lists[name]
    bad = ~((values >= 0) & (values < vertex_count))
    if values.dtype.kind == "f":
        bad |= values != np.floor(values)
    if bad.any():
        corner = int(np.argmax(bad))
        row = int(np.searchsorted(np.cumsum(counts), corner, side="right"))
        raise SceneError(
            f"face {row} has vertex index {values[corner]:.10g}, there are {vertex_count} vertices "
            f"(0 to {vertex_count - 1}): repair the file"
        )
    short = int((counts < 3).sum())
    if short:
        warnings.append(f"faces with fewer than 3 corners are not drawn: {short}")
    corners, _ = fan_triangles(counts)
    return values.astype(np.uint32)[corners] if len(corners) else none


def _colors(vertex: Element, warnings: list[str]) -> np.ndarray | None:
    """(vertex_count, 4) float32 linear, None where there are none."""
    for names in _COLOR_NAMES:
        if not all(name in vertex.columns for name in names):
            continue
        alpha = next((name for name in ("alpha", "a") if name in vertex.columns), None)
        used = names if alpha is None else (*names, alpha)
        values = _stack(vertex, used)
        assert values is not None
        kinds = {vertex.kind(name) for name in used}
        if kinds == {"u1"}:
            return decode_srgb8(np.clip(values, 0.0, 255.0).astype(np.uint8))
        if kinds <= {"f4", "f8"}:
            return linear_rgba(values)
        warnings.append("vertex colours that are neither all uchar nor all float are not read: export them as uchar")
        return None
    return None


def _texture_coordinates(vertex: Element) -> np.ndarray | None:
    for names in _UV_NAMES:
        uv = _stack(vertex, names)
        if uv is not None:
            uv[:, 1] = 1.0 - uv[:, 1]
            with np.errstate(over="ignore"):
                return uv.astype(np.float32)
    return None


def _material(
    path: Path, header: Header, colored: bool, mapped: bool, warnings: list[str]
) -> tuple[Material, tuple[Texture, ...]]:
    """The one material of a PLY file, and its texture (`comment TextureFile NAME`), if it has one."""
    white = (1.0, 1.0, 1.0, 1.0)
    plain = Material(base_color=white if colored else Material().base_color, double_sided=True)
    if not (header.texture and mapped):
        return plain, ()
    try:
        texture = load_image_file(header.texture, path.parent)
    except SceneError as error:
        warnings.append(f"texture {shorten(header.texture)} is left out: {error}")
        return plain, ()
    return Material(base_color=white, double_sided=True, base_color_texture=TextureUse(0)), (texture,)
