"""From a file to a scene: the reader for its kind, and the checks that every scene passes.

Readers give positions as float64, or as float32 where the file holds those; `check_scene` is the
one home of what makes a scene valid, and the one place where positions are rounded to float32.
"""

from __future__ import annotations

import dataclasses
import warnings as python_warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

from clrast.errors import ClrastError, InputNotFoundError, SceneError
from clrast.scene.model import Scene
from clrast.scene.texture import one_line

MAX_FILE_BYTES = 1 << 32
MAX_COUNT = (1 << 32) - 2
"""Largest number of triangles or vertices: 4294967295 is 'nothing'."""

SUFFIXES = (".ply", ".obj", ".stl", ".off", ".glb", ".gltf", ".toml")


def load(path: str | Path) -> Scene:
    """Read a mesh (.ply .obj .stl .off .glb .gltf) or a scene card (.toml); the suffix says which, in any case.

    Raises InputNotFoundError where there is no such file, SceneError where it cannot be rendered.
    """
    return check_scene(read_scene(path), path)


def read_scene(path: str | Path) -> Scene:
    """As `load`, without the checks of `check_scene`: positions may be float64, not yet rounded."""
    file = Path(path)
    shown = show_path(path)
    _check_file(file, shown)
    reader = _reader(file, shown)
    try:
        with python_warnings.catch_warnings(), np.errstate(over="ignore", invalid="ignore"):
            python_warnings.simplefilter("ignore")
            return reader(file)
    except ClrastError as error:
        raise type(error)(_name_file(str(error), file, shown)) from error
    except MemoryError as error:
        raise SceneError(f"{shown}: needs more memory than there is: split it") from error
    except Exception as error:  # readers raise anything on broken files
        what = f"{type(error).__name__}: {one_line(error)}"
        raise SceneError(f"{shown}: is no sound {file.suffix.lower()} file ({what}): export it again") from error


def show_path(path: str | Path) -> str:
    """A path for a message: as given, on one line."""
    return "".join(c if c.isprintable() else "?" for c in str(path))


def _name_file(message: str, file: Path, shown: str) -> str:
    """`message` with the whole path in front, once."""
    for prefix in (f"{shown}: ", f"{show_path(file.name)}: "):
        message = message.removeprefix(prefix)
    return f"{shown}: {message}"


def _check_file(file: Path, shown: str) -> None:
    try:
        status = file.stat()
        is_directory, is_file = file.is_dir(), file.is_file()
    except (FileNotFoundError, NotADirectoryError) as error:
        raise InputNotFoundError(f"{shown}: there is no such file: check the path") from error
    except (OSError, ValueError) as error:
        raise InputNotFoundError(f"{shown}: cannot be reached ({one_line(error)}): check the path") from error
    if is_directory:
        raise SceneError(f"{shown}: is a directory: name a file in it")
    if not is_file:
        raise SceneError(f"{shown}: is no regular file: save the scene to a file first")
    if status.st_size > MAX_FILE_BYTES:
        raise SceneError(f"{shown}: has {status.st_size} bytes, at most {MAX_FILE_BYTES} are read: split it")
    try:
        with file.open("rb"):
            pass
    except OSError as error:
        raise SceneError(f"{shown}: cannot be read ({one_line(error)}): check its rights") from error


def _reader(file: Path, shown: str) -> Callable[[Path], Scene]:
    """The reader for a file's suffix, imported only now."""
    suffix = file.suffix.lower()
    if suffix in (".ply", ".stl", ".off"):
        from clrast.scene.meshes import read_mesh

        return read_mesh
    if suffix == ".obj":
        from clrast.scene.obj import read_obj

        return read_obj
    if suffix in (".glb", ".gltf"):
        from clrast.scene.gltf import read_gltf

        return read_gltf
    if suffix == ".toml":
        from clrast.scene.card import read_card

        return read_card
    kind = f'the suffix "{show_path(suffix)}" is unknown' if suffix else "the name has no suffix"
    raise SceneError(f"{shown}: {kind}: use one of {' '.join(SUFFIXES)}")


def check_scene(scene: Scene, path: str | Path) -> Scene:
    """The scene with float32 positions, if it can be rendered; `path` is named in errors.

    Raises SceneError for: no triangle, an index out of range, a vertex that a triangle uses and that
    is NaN, infinite or beyond float32, and, in a scene made by hand, arrays that do not fit together.
    Vertices that no triangle uses become 0, 0, 0 where they are not finite; so do normals and texture
    coordinates, and colours white, with a warning.
    """
    scene = check_mesh(scene, path)
    if scene.positions.dtype == np.float32:
        return scene
    with np.errstate(over="ignore"):
        rounded = np.ascontiguousarray(scene.positions, np.float32)
    used = _used_vertices(scene)
    too_large = used & ~np.isfinite(rounded).all(axis=1)
    if too_large.any():
        vertex = int(np.argmax(too_large))
        raise SceneError(
            f"{show_path(path)}: vertex {vertex} at {_show_point(scene.positions[vertex])} is beyond float32 "
            "(3.4e38): scale the scene down"
        )
    rounded[~used & ~np.isfinite(rounded).all(axis=1)] = 0.0
    return dataclasses.replace(scene, positions=rounded)


def check_mesh(scene: Scene, path: str | Path) -> Scene:
    """As `check_scene`, but positions keep their dtype: for meshes that are yet to be placed."""
    shown = show_path(path)
    _check_arrays(scene, shown)
    _check_counts(scene, shown)
    _check_textures(scene, shown)
    finite = np.isfinite(scene.positions).all(axis=1)
    positions = scene.positions
    if not finite.all():
        bad = _used_vertices(scene) & ~finite
        if bad.any():
            vertex = int(np.argmax(bad))
            triangle = int(np.argmax((scene.triangles == vertex).any(axis=1)))
            raise SceneError(
                f"{shown}: vertex {vertex} at {_show_point(positions[vertex])}, which triangle {triangle} uses, "
                "is not finite: repair the file"
            )
        positions = np.where(finite[:, None], positions, positions.dtype.type(0))
    warnings = list(scene.warnings)
    return dataclasses.replace(
        scene,
        positions=positions,
        triangles=np.ascontiguousarray(scene.triangles, np.uint32),
        object_ids=np.ascontiguousarray(scene.object_ids, np.uint32),
        material_ids=np.ascontiguousarray(scene.material_ids, np.uint32),
        normals=_finite_rows(scene.normals, 0.0, "vertex normals are not finite: the faces' are used", warnings),
        uv=_finite_rows(scene.uv, 0.0, "texture coordinates are not finite: taken as 0, 0", warnings),
        uv1=_finite_rows(scene.uv1, 0.0, "second texture coordinates are not finite: taken as 0, 0", warnings),
        colors=_finite_rows(scene.colors, 1.0, "vertex colours are not finite: taken as white", warnings),
        warnings=tuple(warnings),
    )


_ARRAYS = (
    ("positions", 3, "f", ""), ("triangles", 3, "iu", ""),
    ("object_ids", 0, "iu", "triangle"), ("material_ids", 0, "iu", "triangle"),
    ("normals", 3, "f", "vertex"), ("uv", 2, "f", "vertex"), ("uv1", 2, "f", "vertex"), ("colors", 4, "f", "vertex"),
)  # fmt: skip
"""Arrays of a Scene: values in a row (0: one alone), kinds of numpy dtypes, and of what there is a row each."""


def _check_arrays(scene: Scene, shown: str) -> None:
    for name, width, kinds, each in _ARRAYS:
        array = getattr(scene, name)
        if array is None and each == "vertex":
            continue
        what = "floats" if kinds == "f" else "integers"
        row = f" of {width}" if width else ""
        if not isinstance(array, np.ndarray) or array.dtype.kind not in kinds:
            raise SceneError(f"{shown}: {name} is no numpy array of {what}: make it one")
        if array.ndim != (2 if width else 1) or (width and array.shape[1] != width):
            raise SceneError(f"{shown}: {name} has the shape {array.shape}: give rows{row}")
        count = scene.triangle_count if each == "triangle" else scene.vertex_count
        if each and len(array) != count:
            raise SceneError(f"{shown}: {name} has {len(array)} rows for {count} {each} entries: give one for each")


def _check_textures(scene: Scene, shown: str) -> None:
    for material in scene.materials:
        for use in (material.base_color_texture, material.emissive_texture):
            if use is not None and not 0 <= use.texture < len(scene.textures):
                there = f"there are {len(scene.textures)}"
                raise SceneError(f"{shown}: material '{material.name}' has texture {use.texture}, {there}: repair it")
    for texture in scene.textures:
        texels = texture.texels
        if texels.dtype != np.uint8 or texels.ndim != 3 or texels.shape[2] != 4 or texels.size == 0:
            have = f"{texels.dtype} {texels.shape}"
            raise SceneError(f"{shown}: texture '{texture.name}' is {have}: give uint8 (height, width, 4)")


def _check_counts(scene: Scene, shown: str) -> None:
    if scene.triangle_count == 0:
        found = f"{scene.vertex_count} vertices, no face" if scene.vertex_count else "it is empty"
        seen = f"; {'; '.join(scene.warnings[:3])}" if scene.warnings else ""
        raise SceneError(f"{shown}: no triangle in it ({found}{seen}): give a file with faces")
    for count, what in ((scene.triangle_count, "triangles"), (scene.vertex_count, "vertices")):
        if count > MAX_COUNT:
            raise SceneError(f"{shown}: has {count} {what}, at most {MAX_COUNT} are possible: split it")
    for ids, count, what in (
        (scene.triangles, scene.vertex_count, "vertex"),
        (scene.material_ids, len(scene.materials), "material"),
        (scene.object_ids, len(scene.object_names), "object"),
    ):
        largest = int(ids.max())
        if largest >= count or int(ids.min()) < 0:
            bad = (ids < 0) | (ids >= count)
            triangle = int(np.argmax(bad.reshape(len(ids), -1).any(axis=1)))
            worst = largest if largest >= count else int(ids.min())
            raise SceneError(
                f"{shown}: triangle {triangle} has {what} index {worst}, there are {count}: repair the file"
            )


def _used_vertices(scene: Scene) -> np.ndarray:
    """(vertex_count,) bool: which vertices a triangle uses."""
    used = np.zeros(scene.vertex_count, bool)
    used[scene.triangles.reshape(-1)] = True
    return used


def _finite_rows(rows: np.ndarray | None, instead: float, what: str, warnings: list[str]) -> np.ndarray | None:
    """`rows` as float32, those with a value that is not finite filled with `instead`, and a warning."""
    if rows is None:
        return None
    with np.errstate(over="ignore"):
        rows = np.ascontiguousarray(rows, np.float32)
    bad = ~np.isfinite(rows).all(axis=1)
    if not bad.any():
        return rows
    warnings.append(f"{int(bad.sum())} {what}")
    return np.where(bad[:, None], np.float32(instead), rows)


def _show_point(point: np.ndarray) -> str:
    return ", ".join(f"{float(value):g}" for value in point)
