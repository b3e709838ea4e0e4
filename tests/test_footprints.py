"""What pixels cover: footprints of the camera's samples and of secondary rays against finite differences in float64."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from curved_world import box, curved_view
from footprint_twin import Triangles, difference, dot, follow, rays, unit
from kernel_world import make_scene, orthographic, start
from mode_worlds import CHALK, GLASS, MIRROR, SHARED, assemble, ball, floor, looking, square

from clrast.errors import UsageError
from clrast.image.header import resolved_header
from clrast.opencl import buffers
from clrast.opencl.device import Device
from clrast.options import make_options
from clrast.scene.camera import CameraVectors
from clrast.scene.model import Light, Material, Scene, Texture, TextureUse
from clrast.shading.effects import plan_effects
from clrast.shading.integrator import Integrator

NO_HIT = 0xFFFFFFFF
ROUNDING = 2.0**-24
CLOSE = 512 * ROUNDING
"""Relative: some 30 operations of float32, and the cancellation of what is not seen at a grazing angle."""

CHECKER = Texture("checker", np.tile(np.kron([[0, 255], [255, 0]], np.ones((8, 8)))[..., None], 4).astype(np.uint8))
TEXTURED = Material("textured", base_color_texture=TextureUse(0, mipmap=True))
UV = np.array([[0, 0], [4, 0], [4, 4], [0, 4]], dtype=np.float64)
SUN = Light("sun", "directional", (1.0, 1.0, 1.0), direction=(0.1, 0.2, -1.0))
PATTERN = {"textures": (CHECKER,), "lights": (SUN,)}


@dataclass(frozen=True)
class Generation:
    """Items as a kernel left them. parents, slots : of the items before, None in the first generation."""

    prims: np.ndarray
    pixels: np.ndarray
    directions: np.ndarray
    footprints: np.ndarray
    parents: np.ndarray | None = None
    slots: np.ndarray | None = None

    @property
    def weights(self) -> tuple[np.ndarray, np.ndarray]:
        """(count, 3) changes of the weights, to the right and float64."""
        spread = self.footprints[:, 0].astype(np.float64)
        right, down = spread[:, [0, 2]], spread[:, [1, 3]]
        return tuple(np.concatenate([-each.sum(axis=1, keepdims=True), each], axis=1) for each in (right, down))

    @property
    def changes(self) -> tuple[np.ndarray, np.ndarray]:
        """(count, 3) changes of the unit direction."""
        return self.footprints[:, 1, :3].astype(np.float64), self.footprints[:, 2, :3].astype(np.float64)


@contextmanager
def recorded(made: list[Generation]) -> Iterator[None]:
    """Meanwhile the items of all generations that are gathered are added to a list."""
    gather, arrive = Integrator.gather, Integrator._arrive

    def read(device: Device, hits: dict[str, Any], count: int) -> dict[str, np.ndarray]:
        prims = buffers.download(device, hits["item_prims"], np.uint32, count)
        vectors = {"directions": (count, 4), "footprints": (count, 3, 4)}
        found = {
            name: buffers.download(device, hits[f"item_{name}"], np.float32, shape) for name, shape in vectors.items()
        }
        for each in found.values():
            each[prims == NO_HIT] = 0  # nothing is written there
        return {"prims": prims, **found}

    def gathering(self: Integrator, prims: Any, hits: Any, count: int, *more: Any) -> None:
        names = {"item_prims": prims, "item_directions": hits["hit_directions"],
                 "item_footprints": hits["hit_footprints"]}  # fmt: skip
        made.append(Generation(pixels=np.arange(count), **read(self.device, names, count)))
        gather(self, prims, hits, count, *more)

    def arriving(self: Integrator, items: Any, sources: Any, count: int, *more: Any) -> Any:
        found = arrive(self, items, sources, count, *more)
        slots = buffers.download(self.device, sources, np.uint32, count)
        pixels = buffers.download(self.device, found.pixels, np.uint32, count)
        parents = {"parents": slots // self.slot_count, "slots": slots % self.slot_count}
        made.append(Generation(pixels=pixels, **parents, **read(self.device, found.hits, count)))
        return found

    Integrator.gather, Integrator._arrive = gathering, arriving  # type: ignore[method-assign]
    try:
        yield
    finally:
        Integrator.gather, Integrator._arrive = gather, arrive  # type: ignore[method-assign]


def generations(
    device: Device, scene: Scene, view: CameraVectors, mode: str = "whitted", state: str = "on", **options: Any
) -> list[Generation]:
    """The items of a render's generations."""
    made: list[Generation] = []
    with recorded(made):
        effects = {**SHARED, "derivatives": state}
        start(device, scene, view, mode=mode, method="3dr-binning", effects=effects, **options)
    return made


def centers(view: CameraVectors, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return pixels % view.width + 0.5, pixels // view.width + 0.5


def assert_near(found: tuple[np.ndarray, ...], expected: tuple[np.ndarray, ...], share: float) -> None:
    """Relative to the larger of the two changes to the right and downwards."""
    size = np.maximum(*(np.sqrt(dot(each, each)) for each in expected))
    for one, other in zip(found, expected, strict=True):
        assert (abs(one - other) <= share * size).all(), (abs(one - other) / size).max()


def room() -> Scene:
    """A closed box round the eye of curved views, each wall 3 to 4 wide."""
    positions, faces = box()
    uv = np.random.default_rng(3).uniform(0, 4, (len(positions), 2)).astype(np.float32)
    return replace(make_scene(positions, faces, uv=uv, materials=(TEXTURED,)), **PATTERN)


VIEWS = {
    "perspective": looking(16, (0.1, 0.2, 0.3), (1, 0.5, 0.4), 1 / 12),
    "orthographic": orthographic(16, 16, (-0.4, 0.5, 0.3), (0.1, 0.2, -1), (1 / 16, 0, 0.01), (0, -1 / 16, 0)),
    "paraboloid": curved_view("paraboloid", 24, 20),
    "latlong": curved_view("latlong", 24, 14),
    "fisheye": curved_view("fisheye", 22, 24),
}


@pytest.mark.parametrize("projection", VIEWS)
def test_footprints_of_views_are_derivatives(first_device: Device, projection: str) -> None:
    scene, view = room(), VIEWS[projection]
    (first,) = generations(first_device, scene, view)
    hit = np.flatnonzero(first.prims != NO_HIT)
    assert len(hit) > 0.6 * view.width * view.height
    triangles = Triangles.of(scene, first.prims[hit])
    at = centers(view, hit)
    expected = difference(lambda x, y: triangles.meet(*rays(view, x, y)), *at)
    assert_near(tuple(each[hit] for each in first.weights), expected, CLOSE)
    turning = difference(lambda x, y: unit(rays(view, x, y)[1]), *at)
    size = max(abs(each).max() for each in turning)
    for one, other in zip(first.changes, turning, strict=True):
        assert abs(one[hit] - other).max() <= 32 * ROUNDING * size


def test_faces_of_a_cube_are_pinholes(first_device: Device) -> None:
    """Nothing of its own: six perspective views, whose pixels lie as far apart as the cube's do."""
    from clrast import render
    from clrast.scene.camera import camera_vectors, cube_faces
    from clrast.scene.model import Camera

    scene, eye = room(), Camera("c", "cube", eye=(0.1, -0.2, 0.3))
    cube = render(scene, eye, size=(8, 48), effects={"derivatives": "on"}, device=first_device.runtime)
    for k, face in enumerate(cube_faces(eye)):
        view = camera_vectors(face, 8, 8)
        alone = start(first_device, scene, view, effects={"derivatives": "on"})[1]
        np.testing.assert_array_equal(cube["R"][8 * k : 8 * k + 8], alone["R"])


LONG = {"latlong": pytest.mark.long, "fisheye": pytest.mark.long}


@pytest.mark.parametrize("projection", [pytest.param(name, marks=LONG.get(name, ())) for name in VIEWS])
def test_coarse_footprints_are_differences_of_two_by_two(first_device: Device, projection: str) -> None:
    """From the upper left sample of the block, on the same plane; exact where a sample of it does not see that."""
    scene, view = room(), VIEWS[projection]
    (first,) = generations(first_device, scene, view, state="coarse")
    hit = np.flatnonzero(first.prims != NO_HIT)
    triangles = Triangles.of(scene, first.prims[hit])
    x, y = centers(view, hit)
    left, top = x - (hit % view.width) % 2, y - (hit // view.width) % 2
    corners = [rays(view, left + across, top + down) for across, down in ((0, 0), (1, 0), (0, 1))]
    own, right, down = (triangles.meet(*each) for each in corners)
    plane = triangles.planes
    towards = [dot(plane, d)[:, 0] for _, d in (*corners, rays(view, x, y))]
    seen = np.all([each * towards[-1] > 0 for each in towards], axis=0)
    if projection in ("paraboloid", "fisheye"):
        half = min(view.width, view.height) / 2
        for across, below in ((0, 0), (1, 0), (0, 1)):
            seen &= np.hypot(left + across - view.width / 2, top + below - view.height / 2) <= half
    exact = difference(lambda x, y: triangles.meet(*rays(view, x, y)), x, y)
    expected = tuple(
        np.where(seen[:, None], each, other) for each, other in zip((right - own, down - own), exact, strict=True)
    )
    found = tuple(each[hit] for each in first.weights)
    # A difference of weights loses what is the same in both.
    most = np.max([abs(each).max(axis=1) for each in (own, right, down)], axis=0)
    for one, other in zip(found, expected, strict=True):
        assert (abs(one - other) <= CLOSE * np.maximum(most, abs(other).max(axis=1))[:, None]).all()
    if projection == "orthographic":
        assert seen.all()
        assert_near(found, exact, CLOSE * 16)
    else:
        assert 0.5 < seen.mean() and max(abs(found[0] - exact[0]).max(), abs(found[1] - exact[1]).max()) > 0.01


# --- rays that go on from hits -----------------------------------------------------------------------


def wall_and_floor() -> Scene:
    """A mirror in the plane x = 2 that faces a textured floor and a wall."""
    mirror = square((2, -4, -1), (0, 8, 0), (0, 0, 5), MIRROR)
    wall = square((-3, -4, -1), (0, 8, 0), (0, 0, 5), TEXTURED, uv=UV)
    return assemble(mirror, floor(6, TEXTURED, -1.0, uv=UV), wall, **PATTERN)


def test_a_mirror_s_footprints_are_those_of_the_mirrored_camera(first_device: Device) -> None:
    scene = wall_and_floor()
    view = looking(20, (0.25, -1, 0.5), (2, 0.25, 0.25), 1 / 20)

    def mirrored(vector: tuple[float, float, float], about: float = 0.0) -> tuple[float, float, float]:
        return (2 * about - vector[0], vector[1], vector[2])

    parts = {name: mirrored(getattr(view, name)) for name in ("direction", "first", "tangent_x", "tangent_y")}
    image = replace(view, origin=mirrored(view.origin, 2.0), **parts)
    behind = replace(scene, triangles=scene.triangles[2:], object_ids=scene.object_ids[2:],
                     material_ids=scene.material_ids[2:])  # fmt: skip
    first, second = generations(first_device, scene, view)
    (direct,) = generations(first_device, behind, image)
    met = second.prims != NO_HIT
    assert met.sum() > 200 and len(set(second.prims[met])) > 2
    pixels = second.pixels[met]
    np.testing.assert_array_equal(second.prims[met] - 2, direct.prims[pixels])
    chosen = tuple(each[pixels] for each in direct.weights)
    assert_near(tuple(each[met] for each in second.weights), chosen, CLOSE)
    assert_near(tuple(each[met] for each in second.changes), tuple(each[pixels] for each in direct.changes), CLOSE)


def chains(made: list[Generation], generation: int) -> tuple[np.ndarray, list[np.ndarray], list[np.ndarray]]:
    """Of the items of a generation: indices of those that met something, prims on the way, slots of their rays."""
    index = np.flatnonzero(made[generation].prims != NO_HIT)
    prims, slots, at = [made[generation].prims[index]], [], index
    for each, before in zip(made[generation:0:-1], made[generation - 1 :: -1], strict=True):
        assert each.parents is not None and each.slots is not None
        slots.insert(0, each.slots[at])
        at = each.parents[at]
        prims.insert(0, before.prims[at])
    return index, prims, slots


def compare_generation(scene: Scene, view: CameraVectors, made: list[Generation], generation: int) -> int:
    """Footprints of a generation against finite differences along the same chains of triangles; returns how many."""
    index, prims, slots = chains(made, generation)
    at = centers(view, made[generation].pixels[index])
    chain = [Triangles.of(scene, each) for each in prims]
    _, d, cosines = follow(view, chain, slots, *at)
    straight = np.abs(made[generation].directions[index, :3] - d).max(axis=1) < 1e-4
    chosen = straight & (abs(dot(unit(chain[-1].planes), d)[:, 0]) > 0.2) & np.all([c > 0.3 for c in cosines], axis=0)
    assert straight.mean() > 0.9, "but at rims interpolated normals are what rays leave by"
    expected = difference(lambda x, y: follow(view, chain, slots, x, y)[0], *at)
    found = tuple(each[index][chosen] for each in made[generation].weights)
    # Curved surfaces multiply what is rounded: a normal's 2^-24 by the ratio of the ball's distance to its triangles.
    assert_near(found, tuple(each[chosen] for each in expected), 16 * CLOSE)
    return int(chosen.sum())


def test_balls_mirror_and_bend_footprints(first_device: Device) -> None:
    """Interpolated normals: mirrored once, refracted into glass, out of it, and what is mirrored within."""
    shiny = ball(3, 0.7, MIRROR, smooth=True).moved(1, (-0.9, 0, 0))
    clear = ball(3, 0.7, GLASS, smooth=True).moved(1, (0.9, 0, 0))
    wall = square((-6, 3, -5), (12, 0, 0), (0, 0, 9), TEXTURED, uv=UV)
    scene = assemble(shiny, clear, floor(8, TEXTURED, -1.0, uv=UV), wall, **PATTERN)
    view = looking(36, (0, -4, 0.8), (0, 0, 0), 1 / 40)
    made = generations(first_device, scene, view, max_depth=3)
    assert len(made) == 4
    counts = [compare_generation(scene, view, made, k) for k in (1, 2, 3)]
    assert min(counts) > 100


def test_flat_glass_and_paraboloids(first_device: Device) -> None:
    """A pane of two faces, seen by a curved view: what comes out is parallel to what went in."""
    pane = (square((-1, 1, -1), (2, 0, 0), (0, 0, 2), GLASS), square((1, 1.25, -1), (-2, 0, 0), (0, 0, 2), GLASS))
    wall = square((-6, 3, -5), (12, 0, 0), (0, 0, 10), TEXTURED, uv=UV)
    scene = assemble(*pane, wall, **PATTERN)
    view = curved_view("paraboloid", 24, 24, (0.0625, -0.5, 0.125), (0.0625, 3, 0.125), (0, 0, 1))
    made = generations(first_device, scene, view, max_depth=2)
    assert min(compare_generation(scene, view, made, k) for k in (1, 2)) > 40
    _, prims, slots = chains(made, 2)
    through = np.flatnonzero((slots[0] == 1) & (slots[1] == 1))
    assert len(through) > 20
    for one, other in zip(made[2].changes, made[0].changes, strict=True):
        kept = chains(made, 2)[0][through]
        before = other[made[2].pixels[kept]]
        assert abs(one[kept] - before).max() <= 64 * ROUNDING * abs(before).max()


@pytest.mark.parametrize("look", ["diffuse", "glossy"])
def test_drawn_rays_are_cones(first_device: Device, look: str) -> None:
    """Of a path: a quarter wide from a diffuse surface, less by the root of the density from a glossy one."""
    chalk = replace(TEXTURED, metallic=float(look == "glossy"), roughness=1.0 if look == "diffuse" else 0.3)
    scene = assemble(floor(6, chalk, uv=UV), square((-6, 4, -1), (12, 0, 0), (0, 0, 8), chalk, uv=UV), **PATTERN)
    view = looking(24, (0, -3, 2), (0, 1, 0.5), 1 / 16)
    made = generations(first_device, scene, view, "path", samples=1, max_depth=1)
    _, second = made
    index, (left, met), _ = chains(made, 1)
    d, density = (second.directions[index].astype(np.float64)[:, k] for k in (slice(0, 3), slice(3, 4)))
    right, down = (each[index] for each in second.changes)
    spread = 0.25 * np.minimum(1, 1 / np.sqrt(np.pi * density))
    assert len(index) > 100
    assert (spread == 0.25).all() if look == "diffuse" else np.median(spread) < 0.15
    for each in (right, down):
        np.testing.assert_allclose(dot(each, d), 0, atol=8 * ROUNDING)
        np.testing.assert_allclose(np.sqrt(dot(each, each)), spread, rtol=16 * ROUNDING)
    np.testing.assert_allclose(dot(right, down), 0, atol=8 * ROUNDING)
    # What is carried is linear: from the point that moves as the footprint left says, along d that turns.
    before = Triangles.of(scene, left)
    after = Triangles.of(scene, met)
    start_at = before.meet(*rays(view, *centers(view, second.pixels[index])))
    moves = [each[made[1].parents[index]] for each in made[0].weights]
    steps = []
    for move, turn in zip(moves, (right, down), strict=True):
        ends = [after.meet(before.at(start_at + h * move), d + h * turn) for h in (-1e-5, 1e-5)]
        steps.append((ends[1] - ends[0]) / 2e-5)
    steep = abs(dot(unit(after.planes), d))[:, 0] > 0.2
    assert steep.sum() > 100
    assert_near(tuple(each[index][steep] for each in second.weights), tuple(each[steep] for each in steps), 4 * CLOSE)


# --- what is called for -----------------------------------------------------------------------------


def test_nothing_is_carried_where_textures_are_not_filtered(first_device: Device) -> None:
    scene, view = wall_and_floor(), looking(8, (0.25, -1, 0.5), (2, 0.25, 0.25), 1 / 8)
    held, names = {}, {}
    for state in ("off", "on"):
        job, frame = start(first_device, scene, view, mode="whitted", method="3dr-binning",
                           effects={**SHARED, "derivatives": state})  # fmt: skip
        assert job.integrator is not None
        held[state] = frame.stats["bytes_device"]
        kernels = {"shade_hits": job.shader._program, "arrive": job.integrator._scattering,
                   "scatter_rays": job.integrator._scattering, "aim_at_light": job.integrator._lighting}  # fmt: skip
        names[state] = {a.name for kernel, program in kernels.items() for a in program.arguments(kernel)}
        assert ("hit_footprints" in job.shader._hits) == (state == "on")
        assert state == "on" or Integrator.bytes_per_pixel(True) > job.integrator.bytes_per_pixel(False)
    assert held["on"] > held["off"]
    assert names["on"] - names["off"] == {
        "footprint", "hit_footprints", "item_footprints", "footprints_left", "prims_left", "slot_changes", "origins"
    }  # fmt: skip


def test_coarse_is_a_state_of_derivatives_alone() -> None:
    assert make_options({"effects": "derivatives=coarse"}).effects == {"derivatives": "coarse"}
    with pytest.raises(UsageError, match="on, off or auto"):
        make_options({"effects": "shadow=coarse"})
    options = make_options({"effects": {"derivatives": "coarse"}})
    plan = plan_effects(room(), ("color",), options.effects)
    row = next(each for each in plan.effects if each.name == "derivatives")
    assert row.on and "2 x 2" in row.reason
    view = VIEWS["perspective"].named()
    assert resolved_header(options, view, [e.name for e in plan.effects if e.on])["derivatives"] == "coarse"
    assert "derivatives" not in resolved_header(make_options({"effects": "derivatives=on"}), view, ["derivatives"])
    plain = replace(room(), materials=(CHALK,), textures=())
    assert not plan_effects(plain, ("color",), options.effects)["derivatives"]


# --- pictures ---------------------------------------------------------------------------------------


def errors(shown: dict[str, np.ndarray], inside: np.ndarray) -> dict[str, float]:
    """RMSE of each picture against `reference`, where asked."""
    assert inside.sum() > 200
    return {
        name: float(np.sqrt(np.mean((each - shown["reference"])[inside].astype(np.float64) ** 2)))
        for name, each in shown.items()
    }


def even(ids: np.ndarray) -> np.ndarray:
    """Pixels whose neighbours show the same triangle."""
    return np.all([np.roll(ids, step, axis) == ids for step in (-1, 1) for axis in (0, 1)], axis=0)


REFERENCE = {"aa": "ssaa:256", "effects": {"derivatives": "off"}}


def test_a_floor_by_a_paraboloid(device: Device, first_device: Device) -> None:
    """Near many samples, coarse or exact; and the same bits on every runtime."""
    scene = assemble(floor(40, replace(TEXTURED, unlit=True), uv=20 * UV), textures=(CHECKER,))
    view = curved_view("paraboloid", 40, 40, (0, 0, 2), (0.5, 4, 1), (0, 0, 1))
    states = {state: {"effects": {"derivatives": state}} for state in ("off", "on", "coarse")}
    shown = {name: start(device, scene, view, **each)[1]["R"] for name, each in states.items()}
    usual = {name: start(first_device, scene, view, **each)[1]["R"] for name, each in states.items()}
    for name, each in states.items():
        np.testing.assert_array_equal(shown[name], usual[name])
    shown["reference"] = start(first_device, scene, view, **REFERENCE)[1]["R"]
    ids = start(first_device, scene, view, aov="id")[1]["id.prim"]
    error = errors(shown, even(ids) & (ids != NO_HIT))
    assert error["off"] > 0.1 and max(error["on"], error["coarse"]) < error["off"] / 3
    assert not np.array_equal(shown["on"], shown["coarse"])


def test_a_floor_in_a_mirror(first_device: Device) -> None:
    unlit = replace(TEXTURED, unlit=True)
    mirror = square((-30, 6, 0), (60, 0, 0), (0, 0, 6), MIRROR)
    scene = assemble(floor(40, unlit, uv=20 * UV), mirror, **PATTERN)
    view = looking(40, (0, -2, 2), (0, 6, 1), 1 / 40)
    options = {"reference": REFERENCE, "off": REFERENCE, "on": {"effects": {"derivatives": "on"}}}
    options["off"] = {**REFERENCE, "aa": "none"}
    shown = {
        name: start(first_device, scene, view, mode="whitted", method="3dr-binning",
                    **{**each, "effects": {**SHARED, **each["effects"]}})[1]["R"]
        for name, each in options.items()
    }  # fmt: skip
    ids = start(first_device, scene, view, aov="id")[1]["id.prim"]
    error = errors(shown, even(ids) & (ids >= 2) & (ids != NO_HIT) & (shown["reference"] > 0))
    assert error["off"] > 0.1 and error["on"] < error["off"] / 3
