"""glTF accessors as numpy arrays: component types, strides, sparse values, normalised integers.

Every size is checked against the bytes that are there before anything is allocated.
glTF 2.0 specification, section 3.6.2 (accessors), with KHR_mesh_quantization's wider choice of
component types.
"""

from __future__ import annotations

import numpy as np

from clrast.errors import SceneError
from clrast.scene.gltf_file import GltfFile, get_integer, get_object, shorten

COMPONENT_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
COMPONENT_COUNTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
MAX_ELEMENTS = 1 << 30  # of one accessor
MAX_IMPLIED_ELEMENTS = 1 << 24  # of one accessor without bytes of its own (zeros)
MAX_COPIED_VALUES = 1 << 31  # of all accessors that cannot share the file's bytes


class Accessors:
    """The accessors of one file, each decoded once."""

    def __init__(self, file: GltfFile) -> None:
        self._file = file
        self._arrays: dict[int, np.ndarray] = {}
        self._copied_values = 0

    def count(self, index: int, where: str) -> int:
        """How many elements accessor `index` claims to have."""
        accessor = self._file.item("accessors", index, where)
        return get_integer(accessor, "count", f"accessor {index}", high=MAX_ELEMENTS)

    def has_bytes(self, index: int, where: str) -> bool:
        """Whether accessor `index` says where its values are; compressed ones may not."""
        accessor = self._file.item("accessors", index, where)
        return "bufferView" in accessor or "sparse" in accessor

    def read(self, index: int, where: str, types: tuple[str, ...]) -> np.ndarray:
        """The values of accessor `index` : (count, components), read-only.

        Normalised integers come as float64 in -1..1 or 0..1, other values as they are stored.
        `types` : which of SCALAR, VEC2, VEC3, VEC4 will do.
        """
        accessor = self._file.item("accessors", index, where)
        kind = accessor.get("type")
        if kind not in types:
            shown = shorten(str(kind), 20)
            raise SceneError(f"{where}: accessor {index} needs type {' or '.join(types)}, not {shown}: export it again")
        if index not in self._arrays:
            values = self._decode(accessor, f"accessor {index}", COMPONENT_COUNTS[kind])
            if accessor.get("normalized") is True:
                values = normalise(values)
            values.flags.writeable = False
            self._arrays[index] = values
        return self._arrays[index]

    def _decode(self, accessor: dict, where: str, width: int) -> np.ndarray:
        count = get_integer(accessor, "count", where, high=MAX_ELEMENTS)
        dtype = _component_type(accessor, where)
        if "bufferView" in accessor:
            values = self._from_view(accessor, where, count, width, dtype)
        elif count <= MAX_IMPLIED_ELEMENTS:
            values = np.zeros((count, width), dtype)
        else:
            raise SceneError(f"{where} has {count} elements and no bytes: give it a bufferView")
        if "sparse" in accessor or "bufferView" not in accessor or accessor.get("normalized") is True:
            self._copied_values += count * width
            if self._copied_values > MAX_COPIED_VALUES:
                raise SceneError(f"{where} and those before it need over {MAX_COPIED_VALUES} values: split the file")
        if "sparse" in accessor:
            values = self._with_sparse(values, get_object(accessor, "sparse", where), where)
        return values

    def _from_view(self, source: dict, where: str, count: int, width: int, dtype: np.dtype) -> np.ndarray:
        """(count, width) values that start at `byteOffset` of a buffer view; shares its bytes."""
        view_index = get_integer(source, "bufferView", where)
        view, stride = self._file.view(view_index, where)
        offset = get_integer(source, "byteOffset", where, 0)
        element_bytes = width * dtype.itemsize
        stride = stride or element_bytes
        if stride < element_bytes:
            there = f"bufferView {view_index} has byteStride {stride}"
            raise SceneError(f"{where} needs {element_bytes} bytes an element, {there}: export the file again")
        end = offset + stride * (count - 1) + element_bytes if count else offset
        if end > len(view):
            there = f"bufferView {view_index} has {len(view)}"
            raise SceneError(f"{where} needs {end} bytes for {count} elements, {there}: the file is cut short")
        if count == 0:
            return np.zeros((0, width), dtype)
        return np.ndarray((count, width), dtype, view, offset, (stride, dtype.itemsize))

    def _with_sparse(self, base: np.ndarray, sparse: dict, where: str) -> np.ndarray:
        """A copy of `base` with the elements replaced that `sparse` lists."""
        place = f"{where}, sparse"
        count = get_integer(sparse, "count", place, high=len(base))
        index_source = get_object(sparse, "indices", place)
        value_source = get_object(sparse, "values", place)
        index_type = _component_type(index_source, place)
        if index_type.kind != "u":
            raise SceneError(f"{place}: indices need an unsigned integer type: export the file again")
        indices = self._from_view(index_source, place, count, 1, index_type)[:, 0]
        values = self._from_view(value_source, place, count, base.shape[1], base.dtype)
        if count and int(indices.max()) >= len(base):
            there = f"there are {len(base)} elements"
            raise SceneError(f"{place}: index {int(indices.max())} passes the end, {there}: export the file again")
        changed = base.copy()
        changed[indices] = values
        return changed


def _component_type(source: dict, where: str) -> np.dtype:
    code = get_integer(source, "componentType", where)
    if code not in COMPONENT_TYPES:
        raise SceneError(f"{where}: componentType {code} is none of glTF's: export the file again")
    return np.dtype(COMPONENT_TYPES[code])


def normalise(values: np.ndarray) -> np.ndarray:
    """Normalised integers as float64: c / max, signed ones not below -1 (glTF 2.0, section 3.6.2.2)."""
    if values.dtype.kind == "f":
        return values
    scaled = values.astype(np.float64) / float(np.iinfo(values.dtype).max)
    return np.maximum(scaled, -1.0) if values.dtype.kind == "i" else scaled
