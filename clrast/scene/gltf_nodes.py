"""The node tree of a glTF file: world matrices, instances, cameras and lights.

A matrix is 12 floats, the upper three rows of a 4x4 one, row by row (m00 m01 m02 m03 m10 ...); it
takes column vectors. All arithmetic is float64, written out, so that it gives the same bits on
every machine. glTF 2.0 specification, sections 3.5 and 3.10; KHR_lights_punctual;
EXT_mesh_gpu_instancing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from clrast.errors import SceneError
from clrast.scene.gltf_accessors import Accessors, normalise
from clrast.scene.gltf_file import (
    MAX_VALUE,
    GltfFile,
    get_extension,
    get_integer,
    get_list,
    get_number,
    get_numbers,
    get_object,
    get_text,
    shorten,
    to_integer,
)
from clrast.scene.model import Camera, Light, LightKind

Matrix = tuple[float, ...]
Vector = tuple[float, float, float]

IDENTITY: Matrix = (1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0)
EXTRA_VISITS = 65536  # of nodes that several parents share, beyond one visit each
_LIGHT_KINDS: dict[str, LightKind] = {"point": "point", "spot": "spot", "directional": "directional"}
_LAST_ROW = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Visit:
    """A node as the scene reaches it. `world` takes its local space to world space."""

    index: int
    node: dict
    world: Matrix

    @property
    def where(self) -> str:
        return f"node {self.index}"


def multiply(a: Matrix, b: Matrix) -> Matrix:
    """The matrix that applies b, then a."""
    product: list[float] = []
    for row in (0, 4, 8):
        x, y, z = a[row], a[row + 1], a[row + 2]
        product += [x * b[column] + y * b[column + 4] + z * b[column + 8] for column in range(3)]
        product.append(x * b[3] + y * b[7] + z * b[11] + a[row + 3])
    return tuple(product)


def compose(translation: tuple[float, ...], rotation: tuple[float, ...], scale: tuple[float, ...]) -> Matrix:
    """Scale, then rotate by the quaternion (x, y, z, w), then move; the quaternion is made unit length."""
    x, y, z, w = rotation
    largest = max(abs(x), abs(y), abs(z), abs(w))
    if largest == 0.0:
        x, y, z, w = 0.0, 0.0, 0.0, 1.0
    else:
        x, y, z, w = x / largest, y / largest, z / largest, w / largest
        length = math.sqrt(x * x + y * y + z * z + w * w)
        x, y, z, w = x / length, y / length, z / length, w / length
    sx, sy, sz = scale
    return (
        (1.0 - 2.0 * (y * y + z * z)) * sx, 2.0 * (x * y - z * w) * sy, 2.0 * (x * z + y * w) * sz, translation[0],
        2.0 * (x * y + z * w) * sx, (1.0 - 2.0 * (x * x + z * z)) * sy, 2.0 * (y * z - x * w) * sz, translation[1],
        2.0 * (x * z - y * w) * sx, 2.0 * (y * z + x * w) * sy, (1.0 - 2.0 * (x * x + y * y)) * sz, translation[2],
    )  # fmt: skip


def local_matrix(file: GltfFile, node: dict, where: str) -> Matrix:
    """What takes a node's space to its parent's."""
    if "matrix" in node:
        m = get_numbers(node, "matrix", where, (0.0,) * 16)  # stored column by column
        if (m[3], m[7], m[11], m[15]) != _LAST_ROW:
            file.warn(f"{where}: the last row of its matrix is not 0 0 0 1: taken as that")
        return (m[0], m[4], m[8], m[12], m[1], m[5], m[9], m[13], m[2], m[6], m[10], m[14])
    if not ("translation" in node or "rotation" in node or "scale" in node):
        return IDENTITY
    rotation = get_numbers(node, "rotation", where, (0.0, 0.0, 0.0, 1.0))
    if rotation == (0.0, 0.0, 0.0, 0.0):
        file.warn(f"{where}: its rotation is the zero quaternion: not turned")
    translation = get_numbers(node, "translation", where, (0.0, 0.0, 0.0))
    return compose(translation, rotation, get_numbers(node, "scale", where, (1.0, 1.0, 1.0)))


def root_nodes(file: GltfFile) -> list[int]:
    """Roots of the default scene; without scenes, the nodes that are no one's children."""
    scene_count = file.count("scenes")
    if scene_count:
        index = get_integer(file.tree, "scene", "the file", 0)
        scene = file.item("scenes", index, "the file")
        where = f"scene {index}"
        return [to_integer(i, f"{where}: nodes") for i in get_list(scene, "nodes", where)]
    children: set[int] = set()
    for i, node in enumerate(file.items("nodes")):
        children.update(to_integer(c, f"node {i}: children") for c in get_list(node, "children", f"node {i}"))
    return [i for i in range(file.count("nodes")) if i not in children]


def walk(file: GltfFile) -> Iterator[Visit]:
    """Visit the default scene's nodes, depth first, in the order of the file.

    A node that is its own ancestor is skipped there, with a warning. No recursion: any depth will do.
    """
    capacity = 2 * file.count("nodes") + EXTRA_VISITS
    visit_count = 0
    path: set[int] = set()
    stack: list[tuple[int, Matrix | None]] = [(i, IDENTITY) for i in reversed(root_nodes(file))]
    while stack:
        index, parent = stack.pop()
        if parent is None:  # all below this node is done
            path.discard(index)
            continue
        node = file.item("nodes", index, "the node tree")
        if index in path:
            file.warn(f"node {index} is its own ancestor: skipped there")
            continue
        visit_count += 1
        if visit_count > capacity:
            raise SceneError(f"the node tree has over {capacity} visits: nodes must have one parent each")
        where = f"node {index}"
        world = multiply(parent, local_matrix(file, node, where))
        yield Visit(index, node, world)
        path.add(index)
        stack.append((index, None))
        children = [to_integer(child, f"{where}: children") for child in get_list(node, "children", where)]
        stack.extend((child, world) for child in reversed(children))


def instance_matrices(file: GltfFile, accessors: Accessors, visit: Visit, capacity: int) -> list[Matrix] | None:
    """World matrices of EXT_mesh_gpu_instancing, in order; None where the node has none."""
    extension = get_extension(visit.node, "EXT_mesh_gpu_instancing", visit.where)
    if extension is None:
        return None
    where = f"{visit.where}: EXT_mesh_gpu_instancing"
    attributes = get_object(extension, "attributes", where)
    columns = {}
    for key, kind in (("TRANSLATION", "VEC3"), ("ROTATION", "VEC4"), ("SCALE", "VEC3")):
        if key in attributes:
            index = get_integer(attributes, key, where)
            if accessors.count(index, where) > capacity:
                raise SceneError(f"{where} asks for over {capacity} instances: split the file")
            values = accessors.read(index, where, (kind,))
            columns[key] = (normalise(values) if key == "ROTATION" else values).tolist()
    if not columns:
        file.warn(f"{where} has no TRANSLATION, ROTATION or SCALE: shown once")
        return None
    counts = sorted({len(column) for column in columns.values()})
    if len(counts) != 1:
        raise SceneError(f"{where} needs as many of each attribute, there are {counts}: export the file again")
    translations = columns.get("TRANSLATION", [(0.0, 0.0, 0.0)] * counts[0])
    rotations = columns.get("ROTATION", [(0.0, 0.0, 0.0, 1.0)] * counts[0])
    scales = columns.get("SCALE", [(1.0, 1.0, 1.0)] * counts[0])
    return [multiply(visit.world, compose(*placing)) for placing in zip(translations, rotations, scales)]


def unit(vector: Vector) -> Vector | None:
    """`vector` made one long; None where it has no direction."""
    largest = max(abs(c) for c in vector)
    if not 0.0 < largest < math.inf or any(c != c for c in vector):
        return None
    x, y, z = (c / largest for c in vector)
    length = math.sqrt(x * x + y * y + z * z)
    return (x / length, y / length, z / length)


def _position(world: Matrix) -> Vector | None:
    place = (world[3], world[7], world[11])
    return place if all(abs(c) <= MAX_VALUE for c in place) else None


def _forward(world: Matrix) -> Vector | None:
    """Where a camera looks and a light shines: -Z of the node, as a unit vector in the world."""
    return unit((-world[2], -world[6], -world[10]))


def read_camera(file: GltfFile, visit: Visit, camera_count: int) -> Camera | None:
    """The camera of a node, None where it has none or one that cannot look anywhere."""
    if "camera" not in visit.node:
        return None
    index = get_integer(visit.node, "camera", visit.where)
    entry = file.item("cameras", index, visit.where)
    where = f"camera {index}"
    name = get_text(visit.node, "name", get_text(entry, "name", f"camera{camera_count}"))
    kind = get_text(entry, "type")
    lens = get_object(entry, kind, where) if kind in ("perspective", "orthographic") else {}
    angle = get_number(lens, "yfov", where, 0.0)
    half_height = abs(get_number(lens, "ymag", where, 0.0))
    if kind == "perspective" and not 0.0 < angle < math.pi:
        file.warn(f"{where} is left out: its yfov {angle:g} is not between 0 and pi")
        return None
    if kind == "orthographic" and not 0.0 < half_height <= MAX_VALUE:
        file.warn(f"{where} is left out: its ymag {half_height:g} is 0 or huge")
        return None
    if not lens:
        file.warn(f"{where} is left out: its type {shorten(kind or 'is missing', 20)} is not known")
        return None
    eye, forward = _position(visit.world), _forward(visit.world)
    up = unit((visit.world[1], visit.world[5], visit.world[9]))
    if eye is None or forward is None or up is None or unit(_cross(forward, up)) is None:
        file.warn(f"{where} is left out: the matrix of {visit.where} leaves it no direction")
        return None
    look_at = (eye[0] + forward[0], eye[1] + forward[1], eye[2] + forward[2])
    if kind == "perspective":
        return Camera(name=name, eye=eye, look_at=look_at, up=up, fov=math.degrees(angle))
    return Camera(name, "orthographic", eye, look_at, up, height=2.0 * half_height)


def _cross(a: Vector, b: Vector) -> Vector:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def read_light(file: GltfFile, visit: Visit, light_count: int) -> Light | None:
    """The punctual light of a node, None where it has none or one of an unknown type."""
    reference = get_extension(visit.node, "KHR_lights_punctual", visit.where)
    if reference is None:
        return None
    index = get_integer(reference, "light", visit.where)
    lights = get_list(get_extension(file.tree, "KHR_lights_punctual", "the file") or {}, "lights", "the file")
    if index >= len(lights) or not isinstance(lights[index], dict):
        raise SceneError(f"{visit.where} names light {index}, there are {len(lights)}: export the file again")
    entry, where = lights[index], f"light {index}"
    kind = _LIGHT_KINDS.get(get_text(entry, "type"))
    if kind is None:
        shown = shorten(get_text(entry, "type", "is missing"), 20)
        file.warn(f"{where} is left out: its type {shown} is not known")
        return None
    position, direction = _position(visit.world), _forward(visit.world)
    if position is None or direction is None and kind != "point":
        file.warn(f"{where} is left out: the matrix of {visit.where} leaves it no direction")
        return None
    color = get_numbers(entry, "color", where, (1.0, 1.0, 1.0))
    strength = get_number(entry, "intensity", where, 1.0)
    inner, outer = _read_cones(file, entry, where) if kind == "spot" else (0.0, math.pi / 4)
    return Light(
        name=get_text(visit.node, "name", get_text(entry, "name", f"light{light_count}")),
        kind=kind,
        intensity=file.clamp(tuple(c * strength for c in color), MAX_VALUE, f"{where}: intensity"),
        position=position,
        direction=direction or (0.0, 0.0, -1.0),
        range=file.clamp((get_number(entry, "range", where, 0.0),), MAX_VALUE, f"{where}: range")[0],
        inner_cone=inner,
        outer_cone=outer,
    )


def _read_cones(file: GltfFile, entry: dict, where: str) -> tuple[float, float]:
    """Half angles of a spot in radians: inner, outer."""
    spot = get_object(entry, "spot", where)
    inner = get_number(spot, "innerConeAngle", where, 0.0)
    outer = get_number(spot, "outerConeAngle", where, math.pi / 4)
    if 0.0 <= inner < outer <= math.pi / 2 + 1e-6:
        return inner, outer
    file.warn(f"{where}: its cones {inner:g} and {outer:g} are not 0 <= inner < outer <= pi/2: taken as 0 and pi/4")
    return 0.0, math.pi / 4
