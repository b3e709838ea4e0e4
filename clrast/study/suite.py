"""Five scenes of the kinds that Davidovic et al., '3D Rasterization', measure in section 5, made from a seed.

Theirs are scans and models that others own; these have what matters to a renderer in common with them: the number
and the size of the triangles, how many surfaces lie one behind the other, what crosses the plane of the eye. A scene
is the same in every bit wherever it is made; `write_scene` writes a card that `clrast.load` reads to the same scene.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

from clrast.errors import OutputError, UsageError
from clrast.scene.gltf_nodes import unit
from clrast.scene.load import check_scene
from clrast.scene.model import Camera, Light, Material, Scene
from clrast.scene.polygons import smooth_normals
from clrast.study.suite_city import city_plan
from clrast.study.suite_hall import hall_plan
from clrast.study.suite_meshes import Mesh, Plan
from clrast.study.suite_statue import tiny_plan
from clrast.study.suite_teapots import occluded_plan, teapots_plan

SEED = 20110721
IMAGE_SIZE = (1024, 1024)
MAX_SCALE = 16.0
"""At which the largest scene has some 20 million triangles."""


@dataclass(frozen=True)
class SuiteScene:
    """A scene of the suite.

    kind : the scene of the paper it stands for, and what it is. triangle_count : about, at scale 1.
    tiny : made of finely tessellated things, so that most triangles are smaller than two pixels of 1024x1024; else
    huge and small triangles are mixed. occluded : from the first camera a ray through the scene meets more than
    three surfaces on average.
    """

    name: str
    kind: str
    triangle_count: int
    tiny: bool
    occluded: bool
    plan: Callable[[float, int], Plan]


def _suite(*scenes: SuiteScene) -> Mapping[str, SuiteScene]:
    return MappingProxyType({scene.name: scene for scene in scenes})


SUITE: Mapping[str, SuiteScene] = _suite(
    SuiteScene(
        "tiny",
        "As the Buddha: a scanned statue, one closed skin of tiny triangles, seen whole.",
        1_090_000,
        tiny=True,
        occluded=False,
        plan=tiny_plan,
    ),
    SuiteScene(
        "teapots",
        "As the Teapots: several finely tessellated teapots in a room.",
        410_000,
        tiny=True,
        occluded=False,
        plan=teapots_plan,
    ),
    SuiteScene(
        "teapots-occluded",
        "As the Teapots2: racks of teapots one behind another, a near large one hiding most.",
        890_000,
        tiny=True,
        occluded=True,
        plan=occluded_plan,
    ),
    SuiteScene(
        "hall",
        "As Sponza and Conference: a columned hall from inside, of huge and of small triangles.",
        270_000,
        tiny=False,
        occluded=False,
        plan=hall_plan,
    ),
    SuiteScene(
        "city",
        "As Venice: streets, blocks of houses with framed windows, roofs, canals.",
        1_230_000,
        tiny=False,
        occluded=True,
        plan=city_plan,
    ),
)


def check_request(name: str, scale: float, seed: int) -> None:
    """Raises UsageError where there is no such scene, scale or seed."""
    if name not in SUITE:
        raise UsageError(f'the suite has no scene "{name}": name one of {", ".join(SUITE)}')
    if not (math.isfinite(scale) and 0.0 < scale <= MAX_SCALE):
        limits = f"above 0 and up to {MAX_SCALE:g}"
        raise UsageError(f"the scale of a scene is {scale:g}: give a share of its triangles, {limits}")
    if seed < 0:
        raise UsageError(f"the seed is {seed}: give 0 or more")


@dataclass(frozen=True)
class SuiteView:
    """A scene of the suite from one of its cameras. tiny, occluded : as of SuiteScene, of this view."""

    name: str
    scene: str
    camera: str
    tiny: bool
    occluded: bool


VIEWS: Mapping[str, SuiteView] = MappingProxyType({
    view.name: view
    for view in (
        SuiteView("tiny", "tiny", "outside", tiny=True, occluded=False),
        SuiteView("teapots", "teapots", "view", tiny=True, occluded=False),
        SuiteView("teapots-occluded", "teapots-occluded", "view", tiny=True, occluded=True),
        SuiteView("hall", "hall", "view", tiny=False, occluded=False),
        SuiteView("city", "city", "outside", tiny=False, occluded=False),
        SuiteView("city-street", "city", "inside", tiny=False, occluded=True),
    )
})  # fmt: skip
"""What `clrast compare --suite paper` measures, in its order."""


def make_view(name: str, made: Scene) -> Scene:
    """The scene `made` of a view with that view's camera as its only one, and its name."""
    view = VIEWS[name]
    chosen = tuple(camera for camera in made.cameras if camera.name == view.camera)
    return dataclasses.replace(made, cameras=chosen, name=name)


def plan_scene(name: str, scale: float = 1.0, seed: int = SEED) -> Plan:
    """What the scene `name` is put together from; arguments as of `make_scene`."""
    check_request(name, scale, seed)
    return SUITE[name].plan(scale, seed)


def make_scene(name: str, scale: float = 1.0, seed: int = SEED) -> Scene:
    """A scene of the suite: its first camera sees it whole or from the front, `inside` stands in it.

    scale : share of the triangles that it has at 1, about, down to some ten thousand; seed : 0 or more, of all draws
    """
    plan = plan_scene(name, scale, seed)
    return _assemble(name, plan, [_rounded(part.bake()) for part in plan.parts])


def write_scene(name: str, folder: str | Path, scale: float = 1.0, seed: int = SEED) -> Path:
    """Write the scene as `folder`/NAME.toml, with binary PLY meshes in `folder`/NAME: returns the card's path.

    `clrast.load` reads it to what `make_scene` makes, bit for bit.
    """
    plan = plan_scene(name, scale, seed)
    card = Path(folder) / f"{name}.toml"
    try:
        meshes = card.parent / name
        meshes.mkdir(parents=True, exist_ok=True)
        for k, part in enumerate(plan.parts):
            (meshes / f"{k:03}.ply").write_bytes(_ply_bytes(_rounded(part.bake())))
        card.write_text(_card_text(SUITE[name], plan), "utf-8")
    except OSError as error:
        raise OutputError(f"{folder}: cannot write the scene {name} there ({error.strerror}): name another") from error
    return card


# --- in memory -------------------------------------------------------------------------------------


def _rounded(mesh: Mesh) -> Mesh:
    """Positions rounded to float32, once: from here on they are the scene."""
    return Mesh(mesh.positions.astype(np.float32), mesh.triangles)


def _assemble(name: str, plan: Plan, meshes: list[Mesh]) -> Scene:
    """The scene, part by part in the plan's order, as card.py joins the meshes of a card."""
    counts = [mesh.triangle_count for mesh in meshes]
    vertex_counts = [len(mesh.positions) for mesh in meshes]
    firsts = [0, *np.cumsum(vertex_counts).tolist()]
    numbers = {material.name: k for k, material in enumerate(plan.materials)}
    normals = [
        smooth_normals(mesh.positions.astype(np.float64), mesh.triangles)
        if part.smooth
        else np.zeros((count, 3), np.float32)
        for part, mesh, count in zip(plan.parts, meshes, vertex_counts, strict=True)
    ]
    scene = Scene(
        positions=np.concatenate([mesh.positions for mesh in meshes]),
        triangles=np.concatenate(
            [(mesh.triangles + first).astype(np.uint32) for mesh, first in zip(meshes, firsts[:-1], strict=True)]
        ),
        object_ids=np.repeat(np.arange(len(meshes), dtype=np.uint32), counts),
        material_ids=np.repeat(np.array([numbers[part.material] for part in plan.parts], np.uint32), counts),
        normals=np.concatenate(normals) if any(part.smooth for part in plan.parts) else None,
        materials=plan.materials,
        lights=tuple(map(_with_unit_direction, plan.lights)),
        cameras=plan.cameras,
        object_names=tuple(part.name for part in plan.parts),
        image_size=IMAGE_SIZE,
        name=name,
    )
    return check_scene(scene, name)


def _with_unit_direction(light: Light) -> Light:
    direction = unit(light.direction)
    assert direction is not None, light.name
    return dataclasses.replace(light, direction=direction)


# --- on disk ---------------------------------------------------------------------------------------


def _ply_bytes(mesh: Mesh) -> bytes:
    """A binary little-endian PLY file; positions are float32."""
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(mesh.positions)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {mesh.triangle_count}\nproperty list uchar uint vertex_indices\nend_header\n"
    )
    faces = np.zeros(mesh.triangle_count, np.dtype([("count", "u1"), ("corners", "<u4", 3)]))
    faces["count"], faces["corners"] = 3, mesh.triangles
    return header.encode("ascii") + mesh.positions.astype("<f4").tobytes() + faces.tobytes()


def _table(heading: str, **entries: object) -> str:
    """A table of a card. Text, numbers, booleans and lists of numbers are written alike in JSON and in TOML."""
    return "\n".join([f"\n[[{heading}]]", *(f"{key} = {json.dumps(value)}" for key, value in entries.items()), ""])


def _card_text(scene: SuiteScene, plan: Plan) -> str:
    size = ", ".join(map(str, IMAGE_SIZE))
    pieces = [f'# {scene.kind}\nname = "{scene.name}"\n\n[image]\nsize = [{size}]\n']
    pieces += map(_camera_table, plan.cameras)
    pieces += map(_light_table, plan.lights)
    pieces += map(_material_table, plan.materials)
    for k, part in enumerate(plan.parts):
        file = f"{scene.name}/{k:03}.ply"
        pieces.append(_table("mesh", name=part.name, file=file, material=part.material, smooth=part.smooth))
    return "".join(pieces)


def _camera_table(camera: Camera) -> str:
    return _table("camera", name=camera.name, eye=camera.eye, look_at=camera.look_at, up=camera.up, fov=camera.fov)


def _light_table(light: Light) -> str:
    placed = {"direction": light.direction} if light.kind == "directional" else {"position": light.position}
    return _table("light", name=light.name, kind=light.kind, color=light.intensity, **placed)


def _material_table(material: Material) -> str:
    return _table(
        "material",
        name=material.name,
        base_color=material.base_color,
        metallic=material.metallic,
        roughness=material.roughness,
    )
