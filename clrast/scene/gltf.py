"""Load .gltf and .glb: the file's own JSON and accessors, not through trimesh.

trimesh 5.2 leaves sparse values out, does not scale normalised integers, rounds colour factors
to 8 bits, shows one of many GPU instances, drops fans, lights, wrap modes, texture transforms
and most material extensions, forgets the parents of cameras, and checks no index: too much to
mend from outside. So this package reads glTF 2.0 itself, with numpy.

Order of triangles: the default scene, depth first, nodes, then primitives, then triangles as
listed; a mirrored instance keeps its vertex order. World matrices are float64, written out in
+ - * /. `read_gltf` leaves positions in float64, for who places them further (a card) before their
one rounding to float32; normals are rounded at the end.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from clrast.errors import ClrastError, SceneError
from clrast.scene.gltf_accessors import Accessors
from clrast.scene.gltf_file import GltfFile, get_integer, get_list, get_text, shorten
from clrast.scene.gltf_materials import DEFAULT_MATERIAL, read_materials
from clrast.scene.gltf_nodes import Matrix, instance_matrices, read_camera, read_light, walk
from clrast.scene.gltf_primitives import Meshes, Primitive
from clrast.scene.model import Camera, Light, Material, Scene
from clrast.scene.texture import one_line

MAX_TRIANGLES = 200_000_000  # placed in the world
MAX_VERTICES = 400_000_000
MAX_PLACEMENTS = 1_000_000  # of primitives

SUPPORTED_EXTENSIONS = frozenset({
    "EXT_mesh_gpu_instancing", "EXT_texture_webp", "KHR_lights_punctual", "KHR_materials_emissive_strength",
    "KHR_materials_ior", "KHR_materials_pbrSpecularGlossiness", "KHR_materials_transmission",
    "KHR_materials_unlit", "KHR_mesh_quantization", "KHR_texture_transform",
})  # fmt: skip
_COMPRESSIONS = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression")
# Words in the names of extensions that leave the geometry as it is: a file may require them all the same.
_APPEARANCE = ("_materials_", "_texture_", "_image_", "_lights_", "_animation_", "_xmp", "_metadata", "_audio")


@dataclass(frozen=True)
class Placement:
    """One primitive in the world, as one part of object `object_id`."""

    primitive: Primitive
    world: Matrix
    object_id: int


class Placements:
    """What the default scene shows, collected before anything large is allocated."""

    def __init__(self, file: GltfFile) -> None:
        self.file = file
        self.accessors = Accessors(file)
        self.meshes = Meshes(file, self.accessors)
        self.parts: list[Placement] = []
        self.object_names: list[str] = []
        self.cameras: list[Camera] = []
        self.lights: list[Light] = []
        self.triangle_count = self.vertex_count = 0
        skinned = 0
        for visit in walk(file):
            camera = read_camera(file, visit, len(self.cameras))
            self.cameras += [] if camera is None else [camera]
            light = read_light(file, visit, len(self.lights))
            self.lights += [] if light is None else [light]
            if "mesh" not in visit.node:
                continue
            skinned += "skin" in visit.node
            mesh = get_integer(visit.node, "mesh", visit.where)
            primitives = self.meshes.primitives(mesh, visit.where)
            if not primitives:
                continue
            name = get_text(visit.node, "name", self.meshes.name(mesh) or f"node{visit.index}")
            matrices = instance_matrices(file, self.accessors, visit, MAX_PLACEMENTS)
            if matrices is None:
                self._place(primitives, visit.world, name)
                continue
            for k, world in enumerate(matrices):
                self._place(primitives, world, f"{name}[{k}]")
        self.meshes.warn_of_skipped()
        if skinned:
            file.warn(f"skins are not applied, the bind pose is shown: {skinned} node{'s' * (skinned != 1)}")

    def _place(self, primitives: list[Primitive], world: Matrix, name: str) -> None:
        """Add an object of at least one primitive."""
        for primitive in primitives:
            self.parts.append(Placement(primitive, world, len(self.object_names)))
            self.triangle_count += len(primitive.triangles)
            self.vertex_count += len(primitive.positions)
        self.object_names.append(name)
        for count, limit, what in (
            (self.triangle_count, MAX_TRIANGLES, "triangles"),
            (self.vertex_count, MAX_VERTICES, "vertices"),
            (len(self.parts), MAX_PLACEMENTS, "placed primitives"),
        ):
            if count > limit:
                raise SceneError(f"the scene has over {limit} {what}: split it")


def load_gltf(path: Path) -> Scene:
    """As `read_gltf`, with positions rounded to float32; those beyond its range become infinite."""
    scene = read_gltf(path)
    with np.errstate(over="ignore"):
        return replace(scene, positions=scene.positions.astype(np.float32))


def read_gltf(path: Path) -> Scene:
    """Read a .gltf or .glb file, whichever its content is; positions are (vertex_count, 3) float64, world space.

    Raises SceneError, in one line, for whatever is wrong with the file; what it asks for and this
    program does not do is in `Scene.warnings`. Positions may be NaN or infinite: `load.check_scene`
    refuses those that a triangle uses.
    """
    path = Path(path)
    try:
        with np.errstate(all="ignore"):
            return _read(path)
    except SceneError as error:
        raise SceneError(f"{shorten(path.name)}: {error}") from error
    except ClrastError:
        raise
    except MemoryError as error:
        raise SceneError(f"{shorten(path.name)}: needs more memory than there is: split it") from error
    except Exception as error:
        what = f"{type(error).__name__}: {one_line(error)}"
        raise SceneError(f"{shorten(path.name)}: is not understood ({what}): export it again") from error


def _read(path: Path) -> Scene:
    file = GltfFile(path)
    _check_extensions(file)
    placements = Placements(file)
    if placements.triangle_count == 0:
        seen = f" ({'; '.join(file.warnings[:3])})" if file.warnings else ""
        raise SceneError(f"no triangle in the default scene{seen}: give a file with triangles")
    animations = file.count("animations")
    if animations:
        file.warn(f"animations are not played, the rest pose is shown: {animations}")
    materials, textures = read_materials(file)
    _warn_of_missing_uv(file, placements.parts, materials)
    if any(part.primitive.material is None for part in placements.parts):
        materials += (DEFAULT_MATERIAL,)
    return replace(
        _assemble(placements, len(materials) - 1),
        materials=materials,
        textures=textures,
        lights=tuple(placements.lights),
        cameras=tuple(placements.cameras),
        object_names=tuple(placements.object_names),
        warnings=file.warnings,
        name=shorten(path.stem, 200),
    )


def _check_extensions(file: GltfFile) -> None:
    """Warn of each extension that is not done; refuse required ones that hide the geometry."""
    used = {}
    for key in ("extensionsUsed", "extensionsRequired"):
        for name in get_list(file.tree, key, "the file"):
            if not isinstance(name, str):
                raise SceneError(f"{key} needs strings: export the file again")
            used[name] = key == "extensionsRequired"
    for name in _extensions_met(file.tree):
        used.setdefault(name, False)
    for name, required in used.items():
        shown = shorten(name, 60)
        if name in SUPPORTED_EXTENSIONS:
            continue
        if required and name in _COMPRESSIONS:
            raise SceneError(f"its geometry is compressed with {shown}: decompress the file first")
        if required and not any(word in name for word in _APPEARANCE):
            raise SceneError(f"it requires the extension {shown}, which is not supported: export the file without it")
        file.warn(f"the extension {shown} is not supported: shown without it")


def _extensions_met(tree: dict) -> list[str]:
    """Names of extensions that objects of the file have, in the order met, `extras` left out."""
    names: dict[str, None] = {}
    stack: list = [tree]
    while stack:
        value = stack.pop()
        if isinstance(value, dict):
            extensions = value.get("extensions")
            if isinstance(extensions, dict):
                names.update(dict.fromkeys(extensions))
            stack.extend(child for key, child in value.items() if key != "extras")
        elif isinstance(value, list):
            stack.extend(child for child in value if isinstance(child, (dict, list)))
    return sorted(names)


def _warn_of_missing_uv(file: GltfFile, parts: list[Placement], materials: tuple[Material, ...]) -> None:
    lacking = 0
    for primitive in {id(part.primitive): part.primitive for part in parts}.values():
        if primitive.material is None:
            continue
        material = materials[primitive.material]
        uses = [use for use in (material.base_color_texture, material.emissive_texture) if use is not None]
        lacking += any((primitive.uv, primitive.uv1)[use.uv_set] is None for use in uses)
    if lacking:
        file.warn(f"{lacking} primitives lack the texture coordinates that their material uses: taken as 0, 0")


def _assemble(placements: Placements, default_material: int) -> Scene:
    """A Scene of arrays alone: every placement's own copy of its vertices, in order; positions float64."""
    parts, vertex_count, triangle_count = placements.parts, placements.vertex_count, placements.triangle_count

    def column(name: str, width: int, fill: float) -> np.ndarray | None:
        present = any(getattr(part.primitive, name) is not None for part in parts)
        return np.full((vertex_count, width), fill, np.float32) if present else None

    positions = np.zeros((vertex_count, 3), np.float64)
    triangles = np.zeros((triangle_count, 3), np.uint32)
    object_ids = np.zeros(triangle_count, np.uint32)
    material_ids = np.zeros(triangle_count, np.uint32)
    normals, colors = column("normals", 3, 0.0), column("colors", 4, 1.0)
    uv, uv1 = column("uv", 2, 0.0), column("uv1", 2, 0.0)
    first_vertex = first_triangle = 0
    for part in parts:
        primitive = part.primitive
        vertices = slice(first_vertex, first_vertex + len(primitive.positions))
        rows = slice(first_triangle, first_triangle + len(primitive.triangles))
        positions[vertices] = transform_points(part.world, primitive.positions)
        triangles[rows] = primitive.triangles
        triangles[rows] += np.uint32(first_vertex)
        object_ids[rows] = part.object_id
        material_ids[rows] = default_material if primitive.material is None else primitive.material
        if normals is not None and primitive.normals is not None:
            normals[vertices] = transform_normals(part.world, primitive.normals)
        for target, source in ((uv, primitive.uv), (uv1, primitive.uv1), (colors, primitive.colors)):
            if target is not None and source is not None:
                target[vertices] = source
        first_vertex, first_triangle = vertices.stop, rows.stop
    return Scene(positions, triangles, object_ids, material_ids, normals, uv, uv1, colors)


def transform_points(world: Matrix, points: np.ndarray) -> np.ndarray:
    """Points (n, 3) of any dtype taken to world space : (n, 3) float64."""
    x, y, z = (points[:, k].astype(np.float64) for k in range(3))
    moved = np.zeros((len(points), 3), np.float64)
    for k in range(3):
        a, b, c, d = world[4 * k : 4 * k + 4]
        moved[:, k] = a * x + b * y + c * z + d
    return moved


def normal_matrix(world: Matrix) -> tuple[float, ...]:
    """Nine floats, row by row, that point like the inverse transpose of the matrix's 3x3 part.

    They are its cofactors, with the sign of its determinant, so that a mirrored instance keeps
    its normals on the outside; they exist for flattening matrices too. The scale is arbitrary.
    """
    rows = [world[0:3], world[4:7], world[8:11]]
    largest = max(abs(value) for row in rows for value in row)
    if not 0.0 < largest < math.inf:
        return (0.0,) * 9
    exponent = math.frexp(largest)[1]
    m = [[math.ldexp(value, -exponent) for value in row] for row in rows]  # exact, and out of reach of overflow
    cofactors = [
        [m[(i + 1) % 3][(j + 1) % 3] * m[(i + 2) % 3][(j + 2) % 3]
         - m[(i + 1) % 3][(j + 2) % 3] * m[(i + 2) % 3][(j + 1) % 3] for j in range(3)]
        for i in range(3)
    ]  # fmt: skip
    determinant = m[0][0] * cofactors[0][0] + m[0][1] * cofactors[0][1] + m[0][2] * cofactors[0][2]
    sign = -1.0 if determinant < 0.0 else 1.0
    return tuple(sign * value for row in cofactors for value in row)


def transform_normals(world: Matrix, normals: np.ndarray) -> np.ndarray:
    """Normals (n, 3) of any dtype taken to world space : (n, 3) float64 of unit length.

    One without a direction (zero, NaN, flattened away) comes out as 0, 0, 0.
    """
    m = normal_matrix(world)
    x, y, z = (normals[:, k].astype(np.float64) for k in range(3))
    turned = [m[3 * k] * x + m[3 * k + 1] * y + m[3 * k + 2] * z for k in range(3)]
    length = np.sqrt(turned[0] * turned[0] + turned[1] * turned[1] + turned[2] * turned[2])
    usable = (length > 0.0) & (length < np.inf)
    divisor = np.where(usable, length, 1.0)
    return np.stack([np.where(usable, value / divisor, 0.0) for value in turned], axis=1)
