"""Scene cards: TOML files that put meshes, materials, lights and cameras together (data/README.md).

Triangles are those of the card's meshes, in its order. A mesh is placed in float64 and rounded to
float32 once, by `check_scene`. Materials of the card come first, then those that mesh files bring;
so do lights and cameras, whose first one is the view that is rendered by default.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from clrast.errors import SceneError, UsageError
from clrast.scene.camera import view_basis
from clrast.scene.card_schema import CardTable, MaterialTable, MeshTable, TextureTable, check_card
from clrast.scene.gltf import MAX_TRIANGLES, MAX_VERTICES
from clrast.scene.gltf_materials import texture_transform
from clrast.scene.gltf_nodes import IDENTITY, Matrix, unit
from clrast.scene.load import check_mesh, read_scene
from clrast.scene.model import Camera, Light, Material, Scene, Texture, TextureUse
from clrast.scene.placement import place, place_scene
from clrast.scene.polygons import smooth_normals, unit_rows
from clrast.scene.texture import find_below, load_image_file, shorten

if TYPE_CHECKING:
    from clrast.scene.shapes import Shape

MAX_RADIANCE = 1e30
MAX_CARD_BYTES = 1 << 24
WHITE = (1.0, 1.0, 1.0)


def read_card(path: Path) -> Scene:
    """The scene of a card; positions are float64, not yet rounded or checked."""
    size = path.stat().st_size
    if size > MAX_CARD_BYTES:
        raise SceneError(f"has {size} bytes, a card at most {MAX_CARD_BYTES}: put its meshes into files of their own")
    try:
        tree = tomllib.loads(path.read_bytes().decode("utf-8"))
    except UnicodeDecodeError as error:
        raise SceneError(f"is not UTF-8 at byte {error.start}: save it as UTF-8") from error
    except RecursionError as error:
        raise SceneError("its tables are nested too deep: a card needs three levels") from error
    except ValueError as error:  # TOMLDecodeError, and numbers of thousands of digits
        raise SceneError(f"is no TOML: {shorten(str(error), 120)}: mend that line") from error
    return CardReader(path, check_card(tree)).scene()


class CardReader:
    """Builds the scene of one card: what is looked up by name or by file, and what has been read so far."""

    def __init__(self, path: Path, card: CardTable) -> None:
        self.path = path
        self.folder = path.parent
        self.card = card
        self.textures: list[Texture] = []
        self.warnings: list[str] = []
        self._texture_numbers: dict[Path, int] = {}
        self._files: dict[Path, Scene] = {}
        self._default_materials: dict[bool, int] = {}
        self._check_names()
        self._material_numbers = {entry.name: k for k, entry in enumerate(card.material)}
        self.materials = [self._material(entry, f"material[{k}]") for k, entry in enumerate(card.material)]

    def scene(self) -> Scene:
        """The whole card as one scene."""
        card = self.card
        meshes = [self._mesh(entry, f"mesh[{k}]") for k, entry in enumerate(card.mesh)]
        _check_size(meshes)
        lights, cameras = self._lights(), self._cameras()
        materials = list(self.materials)
        material_ids, object_ids = [], []
        object_names: list[str] = []
        textures = list(self.textures)
        shared: dict[tuple[int, int], tuple[int, list[Texture]]] = {}
        for mesh in meshes:
            if mesh.material_number is None:
                first = self._append_materials(mesh.scene, materials, textures, shared)
                material_ids.append((mesh.scene.material_ids + first).astype(np.uint32))
            else:
                material_ids.append(np.full(mesh.scene.triangle_count, mesh.material_number, np.uint32))
            object_ids.append((mesh.scene.object_ids + len(object_names)).astype(np.uint32))
            object_names += mesh.object_names()
            lights += mesh.scene.lights
            cameras += mesh.scene.cameras
        positions, triangles = _join(meshes)
        return Scene(
            positions=positions,
            triangles=triangles,
            normals=_join_attribute(meshes, "normals", 3, 0.0),
            uv=_join_attribute(meshes, "uv", 2, 0.0),
            uv1=_join_attribute(meshes, "uv1", 2, 0.0),
            colors=_join_attribute(meshes, "colors", 4, 1.0),
            material_ids=np.concatenate(material_ids),
            object_ids=np.concatenate(object_ids),
            materials=tuple(materials),
            textures=tuple(textures),
            lights=tuple(lights),
            cameras=tuple(cameras),
            object_names=tuple(object_names),
            image_size=None if card.image is None else (card.image.size[0], card.image.size[1]),
            render_options=self._render_options(),
            environment=self._environment(),
            warnings=tuple(self.warnings),
            name=card.name or self.path.stem,
        )

    def _check_names(self) -> None:
        """Names that are looked up must differ."""
        for kind, names in (
            ("material", [entry.name for entry in self.card.material]),
            ("camera", [entry.name for entry in self.card.camera]),
        ):
            seen: dict[str, int] = {}
            for k, name in enumerate(names):
                if name is not None and seen.setdefault(name, k) != k:
                    first = f"{kind}[{seen[name]}]"
                    raise SceneError(f'{kind}[{k}].name is "{shorten(name, 40)}", as that of {first}: rename one')

    def _environment(self) -> tuple[float, float, float] | None:
        entry = self.card.environment
        if entry is None:
            return None
        red, green, blue = (min(each * entry.intensity, MAX_RADIANCE) for each in entry.color)
        return red, green, blue

    def _render_options(self) -> dict[str, str]:
        if self.card.render is None:
            return {}
        written = self.card.render.model_dump(exclude_none=True)
        return {name.replace("_", "-"): value for name, value in written.items()}

    def _mesh(self, entry: MeshTable, where: str) -> Mesh:
        world = _world_matrix(entry)
        number = self._material_number(entry.material, where)
        if entry.file is not None:
            scene = self._file(entry.file, f"{where}.file")
        else:
            scene = check_mesh(_inline_scene(entry), where)
            if number is None:
                number = self._default_material(scene.colors is not None)
        name = entry.name or (entry.file and Path(entry.file.replace("\\", "/")).stem) or entry.shape or where
        if entry.smooth is not None:
            normals = smooth_normals(scene.positions, scene.triangles) if entry.smooth else None
            scene = dataclasses.replace(scene, normals=normals)
        return Mesh(name, place_scene(scene, world), number)

    def _file(self, file: str, where: str) -> Scene:
        """The mesh in a file below the card's folder, read once however often it is placed."""
        try:
            path = find_below(self.folder, file, False)
        except SceneError as error:
            raise SceneError(f"{where}: {error}") from error
        if path.suffix.lower() == ".toml":
            raise SceneError(f'{where} is "{shorten(file)}", a card: name a mesh, a card holds no cards')
        if path not in self._files:
            try:
                scene = check_mesh(read_scene(path), path)
            except SceneError as error:
                message = str(error).removeprefix(f"{path}: ")
                raise SceneError(f"{where}: {shorten(file)}: {message}") from error
            self.warnings += [f"{shorten(file)}: {line}" for line in scene.warnings]
            self._files[path] = scene
        return self._files[path]

    def _material_number(self, name: str | None, where: str) -> int | None:
        if name is None:
            return None
        if name in self._material_numbers:
            return self._material_numbers[name]
        names = list(self._material_numbers)
        near = difflib.get_close_matches(name, names, n=1)
        hint = f'did you mean "{near[0]}"?' if near else f"add a [[material]] of that name (there are: {names})"
        raise SceneError(f'{where}.material is "{shorten(name, 40)}", which the card has not: {shorten(hint, 200)}')

    def _default_material(self, colored: bool) -> int:
        """The number of the plain material, appended when a mesh first needs it."""
        if colored not in self._default_materials:
            base = (*WHITE, 1.0) if colored else Material().base_color
            self._default_materials[colored] = len(self.materials)
            self.materials.append(Material(base_color=base, double_sided=True))
        return self._default_materials[colored]

    def _append_materials(
        self, scene: Scene, materials: list[Material], textures: list[Texture], shared: dict
    ) -> int:
        """Append a file's own materials and textures, once for each file; returns the first one's number."""
        key = id(scene.materials)
        if key not in shared:
            offset = len(textures)
            shared[key] = len(materials)
            textures += scene.textures
            materials += [
                dataclasses.replace(
                    material,
                    base_color_texture=_shift(material.base_color_texture, offset),
                    emissive_texture=_shift(material.emissive_texture, offset),
                )
                for material in scene.materials
            ]
        return shared[key]

    def _material(self, entry: MaterialTable, where: str) -> Material:
        color_texture = self._texture_use(entry.base_color_texture, f"{where}.base_color_texture")
        emissive_texture = self._texture_use(entry.emissive_texture, f"{where}.emissive_texture")
        color = entry.base_color or (WHITE if color_texture else Material().base_color)
        emissive = entry.emissive or (WHITE if emissive_texture else (0.0, 0.0, 0.0))
        return Material(
            name=entry.name,
            base_color=(color[0], color[1], color[2], color[3] if len(color) == 4 else 1.0),
            metallic=entry.metallic,
            roughness=entry.roughness,
            emissive=(emissive[0], emissive[1], emissive[2]),
            alpha_mode=entry.alpha_mode,
            alpha_cutoff=entry.alpha_cutoff,
            double_sided=entry.double_sided,
            unlit=entry.unlit,
            transmission=entry.transmission,
            ior=entry.ior,
            base_color_texture=color_texture,
            emissive_texture=emissive_texture,
        )

    def _texture_use(self, entry: TextureTable | None, where: str) -> TextureUse | None:
        if entry is None:
            return None
        try:
            path = find_below(self.folder, entry.file, False)
            if path not in self._texture_numbers:
                self.textures.append(load_image_file(entry.file, self.folder))
                self._texture_numbers[path] = len(self.textures) - 1
        except SceneError as error:
            raise SceneError(f"{where}: {error}") from error
        scale, offset = (entry.scale[0], entry.scale[1]), (entry.offset[0], entry.offset[1])
        return TextureUse(
            texture=self._texture_numbers[path],
            uv_set=entry.uv_set,
            transform=texture_transform(offset, math.radians(entry.rotate), scale),
            wrap_u=entry.wrap[0],
            wrap_v=entry.wrap[1],
            nearest=entry.nearest,
            mipmap=entry.mipmap,
        )

    def _lights(self) -> list[Light]:
        lights = []
        for k, entry in enumerate(self.card.light):
            position = entry.position or [0.0, 0.0, 0.0]
            toward = entry.direction or [0.0, 0.0, -1.0]
            if entry.look_at is not None:
                toward = [a - b for a, b in zip(entry.look_at, position, strict=True)]
            direction = unit((toward[0], toward[1], toward[2]))
            assert direction is not None
            red, green, blue = (c * entry.intensity for c in entry.color)
            lights.append(Light(
                name=entry.name or f"light{k}",
                kind=entry.kind,
                intensity=(red, green, blue),
                position=(position[0], position[1], position[2]),
                direction=direction,
                range=entry.range,
                inner_cone=math.radians(entry.inner_cone),
                outer_cone=math.radians(entry.outer_cone),
            ))  # fmt: skip
        return lights

    def _cameras(self) -> list[Camera]:
        cameras = []
        for k, entry in enumerate(self.card.camera):
            camera = Camera(
                name=entry.name or f"camera{k}",
                projection=entry.projection,
                eye=(entry.eye[0], entry.eye[1], entry.eye[2]),
                look_at=(entry.look_at[0], entry.look_at[1], entry.look_at[2]),
                up=(entry.up[0], entry.up[1], entry.up[2]),
                fov=entry.fov or (180.0 if entry.projection == "fisheye" else 45.0),
                height=entry.height,
            )
            try:
                view_basis(camera)
            except UsageError as error:
                raise SceneError(f"camera[{k}]: {error}") from error
            cameras.append(camera)
        return cameras


@dataclasses.dataclass(frozen=True)
class Mesh:
    """A placed mesh of a card. `material_number` : of the card, None where the file's own are kept."""

    name: str
    scene: Scene
    material_number: int | None

    def object_names(self) -> list[str]:
        names = self.scene.object_names
        return [self.name] if len(names) == 1 else [f"{self.name}/{name}" for name in names]


def _shift(use: TextureUse | None, offset: int) -> TextureUse | None:
    return None if use is None else dataclasses.replace(use, texture=use.texture + offset)


def _world_matrix(entry: MeshTable) -> Matrix:
    if entry.matrix is not None:
        return tuple(entry.matrix[:12])
    if entry.scale is None and entry.rotate is None and entry.translate is None:
        return IDENTITY
    turns = [(tuple(turn.axis), turn.degrees) for turn in entry.rotate or []]
    return place(tuple(entry.scale or (1.0, 1.0, 1.0)), turns, tuple(entry.translate or (0.0, 0.0, 0.0)))


def _shape(entry: MeshTable) -> Shape:
    from clrast.scene import shapes

    if entry.shape == "plane":
        return shapes.plane()
    if entry.shape == "box":
        return shapes.box()
    if entry.shape == "sphere":
        segments = 48 if entry.segments is None else entry.segments
        return shapes.sphere(segments, max(segments // 2, 2) if entry.rings is None else entry.rings)
    return shapes.icosphere(4 if entry.subdivisions is None else entry.subdivisions)


def _inline_scene(entry: MeshTable) -> Scene:
    """A shape, or the vertices and triangles that stand in the card."""
    colors = None
    if entry.shape is not None:
        shape = _shape(entry)
        positions, triangles, normals, uv = shape.positions, shape.triangles, shape.normals, shape.uv
    else:
        positions = np.array(entry.vertices, np.float64)
        triangles = np.array(entry.triangles, np.uint32)
        normals = None if entry.normals is None else np.array(entry.normals, np.float64)
        uv = None if entry.uv is None else np.array(entry.uv, np.float64)
        if entry.colors is not None:
            colors = np.array([[*color, 1.0][:4] for color in entry.colors], np.float64).astype(np.float32)
    return Scene(
        positions=positions,
        triangles=triangles,
        object_ids=np.zeros(len(triangles), np.uint32),
        material_ids=np.zeros(len(triangles), np.uint32),
        normals=None if normals is None else unit_rows(normals),
        uv=None if uv is None else uv.astype(np.float32),
        colors=colors,
    )


def _check_size(meshes: list[Mesh]) -> None:
    """Bound what is about to be copied together."""
    for count, limit, what in (
        (sum(mesh.scene.triangle_count for mesh in meshes), MAX_TRIANGLES, "triangles"),
        (sum(mesh.scene.vertex_count for mesh in meshes), MAX_VERTICES, "vertices"),
    ):
        if count > limit:
            raise SceneError(f"its meshes have {count} {what}, at most {limit} are possible: split the card")


def _join(meshes: list[Mesh]) -> tuple[np.ndarray, np.ndarray]:
    """Positions (vertex_count, 3) float64 and triangles (triangle_count, 3) uint32 of all meshes, in order."""
    positions, triangles = [], []
    first_vertex = 0
    for mesh in meshes:
        positions.append(mesh.scene.positions.astype(np.float64))
        triangles.append((mesh.scene.triangles + np.uint32(first_vertex)).astype(np.uint32))
        first_vertex += mesh.scene.vertex_count
    return np.concatenate(positions), np.concatenate(triangles)


def _join_attribute(meshes: list[Mesh], name: str, width: int, neutral: float) -> np.ndarray | None:
    """An attribute of all vertices, `neutral` for a mesh that lacks it; None where all do."""
    columns = [getattr(mesh.scene, name) for mesh in meshes]
    if all(column is None for column in columns):
        return None
    filled = [
        np.full((mesh.scene.vertex_count, width), neutral, np.float32) if column is None else column
        for mesh, column in zip(meshes, columns, strict=True)
    ]
    return np.concatenate(filled)
