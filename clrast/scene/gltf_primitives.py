"""Mesh primitives of a glTF file as arrays, still in the mesh's own space.

Triangles keep the order of the file; none is merged, dropped or turned. glTF 2.0 specification,
section 3.7.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clrast.errors import SceneError
from clrast.scene.gltf_accessors import Accessors, normalise
from clrast.scene.gltf_file import GltfFile, get_extension, get_integer, get_list, get_object, get_text

TRIANGLES, STRIP, FAN = 4, 5, 6
_MODE_NAMES = {0: "points", 1: "lines", 2: "line loops", 3: "line strips"}


@dataclass(frozen=True)
class Primitive:
    """Triangles of one material.

    positions : (vertex_count, 3) any numeric dtype, mesh space
    triangles : (triangle_count, 3) unsigned, into these vertices
    normals : (vertex_count, 3) or None; uv, uv1 : (vertex_count, 2) or None
    colors : (vertex_count, 4) float64 in 0..1, or None
    material : number in the file, or None for the default one
    """

    positions: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray | None
    uv: np.ndarray | None
    uv1: np.ndarray | None
    colors: np.ndarray | None
    material: int | None


class Meshes:
    """The meshes of one file, each read once, when first placed."""

    def __init__(self, file: GltfFile, accessors: Accessors) -> None:
        self._file = file
        self._accessors = accessors
        self._primitives: dict[int, list[Primitive]] = {}
        self.skipped: dict[str, int] = {}
        self.morphed = 0

    def primitives(self, mesh_index: int, where: str) -> list[Primitive]:
        """The primitives of a mesh that have triangles, in order."""
        if mesh_index not in self._primitives:
            mesh = self._file.item("meshes", mesh_index, where)
            found = []
            for k, entry in enumerate(get_list(mesh, "primitives", f"mesh {mesh_index}")):
                place = f"mesh {mesh_index}, primitive {k}"
                if not isinstance(entry, dict):
                    raise SceneError(f"{place} needs an object: export the file again")
                primitive = self._read(entry, place)
                if primitive is not None and len(primitive.triangles):
                    found.append(primitive)
            self._primitives[mesh_index] = found
        return self._primitives[mesh_index]

    def name(self, mesh_index: int) -> str:
        return get_text(self._file.item("meshes", mesh_index, "a node"), "name")

    def warn_of_skipped(self) -> None:
        """One warning for each kind of primitive that has no triangles, and for morph targets."""
        for kind, count in self.skipped.items():
            self._file.warn(f"{kind} are not drawn: {count} primitive{'s' * (count != 1)}")
        if self.morphed:
            self._file.warn(f"morph targets are not applied: {self.morphed} primitive{'s' * (self.morphed != 1)}")

    def _read(self, entry: dict, where: str) -> Primitive | None:
        mode = get_integer(entry, "mode", where, TRIANGLES)
        if mode not in (TRIANGLES, STRIP, FAN):
            kind = _MODE_NAMES.get(mode, f"primitives of mode {mode}")
            self.skipped[kind] = self.skipped.get(kind, 0) + 1
            return None
        attributes = get_object(entry, "attributes", where)
        if "POSITION" not in attributes:
            self._file.warn(f"{where} has no POSITION: left out")
            return None
        self._refuse_compressed(entry, attributes, where)
        self.morphed += bool(get_list(entry, "targets", where))
        positions = self._attribute(attributes, "POSITION", where, ("VEC3",), None)
        vertex_count = len(positions)
        normals = self._optional(attributes, "NORMAL", where, ("VEC3",), vertex_count)
        uv = self._optional(attributes, "TEXCOORD_0", where, ("VEC2",), vertex_count)
        uv1 = self._optional(attributes, "TEXCOORD_1", where, ("VEC2",), vertex_count)
        colors = self._optional(attributes, "COLOR_0", where, ("VEC3", "VEC4"), vertex_count)
        material = None
        if "material" in entry:
            material = get_integer(entry, "material", where)
            self._file.item("materials", material, where)
        order = self._vertex_order(entry, where, vertex_count)
        primitive = Primitive(positions, self._triangles(order, mode, where), normals, uv, uv1, colors, material)
        return self._finished(primitive, where)

    def _refuse_compressed(self, entry: dict, attributes: dict, where: str) -> None:
        if get_extension(entry, "KHR_draco_mesh_compression", where) is None:
            return
        indices = [get_integer(attributes, "POSITION", where)]
        indices += [get_integer(entry, "indices", where)] if "indices" in entry else []
        if not all(self._accessors.has_bytes(index, where) for index in indices):
            raise SceneError(f"{where} is compressed with KHR_draco_mesh_compression: decompress the file first")

    def _attribute(self, attributes: dict, key: str, where: str, types: tuple, count: int | None) -> np.ndarray:
        index = get_integer(attributes, key, where)
        values = self._accessors.read(index, f"{where}, {key}", types)
        if count is not None and len(values) != count:
            raise SceneError(f"{where}: {key} has {len(values)} elements, POSITION {count}: export the file again")
        return values

    def _optional(self, attributes: dict, key: str, where: str, types: tuple, count: int) -> np.ndarray | None:
        return self._attribute(attributes, key, where, types, count) if key in attributes else None

    def _vertex_order(self, entry: dict, where: str, vertex_count: int) -> np.ndarray:
        """The vertices to draw, in order : (count,) unsigned."""
        if "indices" not in entry:
            return np.arange(vertex_count, dtype=np.uint32)
        index = get_integer(entry, "indices", where)
        order = self._accessors.read(index, f"{where}, indices", ("SCALAR",))[:, 0]
        if order.dtype.kind != "u":
            raise SceneError(f"{where}: indices need an unsigned integer type: export the file again")
        largest = int(order.max()) if len(order) else 0
        if len(order) and largest >= vertex_count:
            raise SceneError(f"{where}: index {largest} is out of range, there are {vertex_count} vertices: repair it")
        return order

    def _triangles(self, order: np.ndarray, mode: int, where: str) -> np.ndarray:
        """(triangle_count, 3) vertex indices of a list, a strip or a fan, as the specification orders them."""
        count = len(order)
        if mode == TRIANGLES:
            if count % 3:
                self._file.warn(f"{where}: {count} vertices make no whole triangles: the last {count % 3} are left out")
            return order[: count - count % 3].reshape(-1, 3)
        if count < 3:
            return np.zeros((0, 3), order.dtype)
        if mode == FAN:
            return np.stack([order[1:-1], order[2:], np.broadcast_to(order[0], count - 2)], axis=1)
        triangles = np.stack([order[:-2], order[1:-1], order[2:]], axis=1)
        triangles[1::2] = triangles[1::2, [0, 2, 1]]
        return triangles

    def _finished(self, primitive: Primitive, where: str) -> Primitive:
        """With unused vertices left out where most are, and attributes made finite."""
        arrays = [primitive.positions, primitive.normals, primitive.uv, primitive.uv1, primitive.colors]
        triangles = primitive.triangles
        if 3 * len(triangles) < len(primitive.positions):  # a pool of vertices that primitives share
            used, triangles = np.unique(triangles, return_inverse=True)
            triangles = triangles.reshape(-1, 3)
            arrays = [None if array is None else array[used] for array in arrays]
        positions, normals, uv, uv1, colors = arrays
        assert positions is not None
        uv = self._finite(uv, f"{where}, TEXCOORD_0", 0.0)
        uv1 = self._finite(uv1, f"{where}, TEXCOORD_1", 0.0)
        colors = self._finite(None if colors is None else _linear_rgba(colors), f"{where}, COLOR_0", 1.0)
        return Primitive(positions, triangles, normals, uv, uv1, colors, primitive.material)

    def _finite(self, values: np.ndarray | None, where: str, otherwise: float) -> np.ndarray | None:
        """`values` with NaN and infinities replaced, with a warning."""
        if values is None or values.dtype.kind != "f":
            return values
        finite = np.isfinite(values)
        if finite.all():
            return values
        self._file.warn(f"{where} has values that are not finite: taken as {otherwise:g}")
        return np.where(finite, values, otherwise)


def _linear_rgba(colors: np.ndarray) -> np.ndarray:
    """COLOR_0 as (vertex_count, 4) float64, held within 0..1, opaque where it has no alpha."""
    rgba = np.ones((len(colors), 4), np.float64)
    rgba[:, : colors.shape[1]] = normalise(colors)
    return np.clip(rgba, 0.0, 1.0)
