"""Alpha: masked samples that are no hits, and layers of BLEND surfaces put together front to back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import reference as ref
from kernel_world import NO_HIT, make_scene, orthographic, perspective, render
from panels import SIDE, panel_scene, panel_view

from clrast.image.frame import Frame
from clrast.opencl.device import Device
from clrast.scene.model import Material, Scene, Texture, TextureUse

U = 2.0**-24


def square(depth: float, side: float = 8.0) -> list[list[tuple[float, float, float]]]:
    """Two triangles over the whole of `view`, at z = -depth."""
    a, b, c, d = (0, 0, -depth), (side, 0, -depth), (side, -side, -depth), (0, -side, -depth)
    return [[a, b, c], [c, d, a]]


def layers(depths: list[float], materials: list[Material], **fields: object) -> Scene:
    """Squares over the whole view in the order given, one material each."""
    corners = np.array([triangle for depth in depths for triangle in square(depth)])
    ids = np.repeat(np.arange(len(depths)), 2).astype(np.uint32)
    return make_scene(corners, materials=tuple(materials), material_ids=ids, **fields)


def blend(name: str, color: tuple[float, float, float], alpha: float) -> Material:
    return Material(name, (*color, alpha), alpha_mode="BLEND")


def rgba(frame: Frame) -> np.ndarray:
    return np.stack([frame[c] for c in "RGBA"], axis=2)


def composited(materials: list[Material]) -> np.ndarray:
    """Front to back, premultiplied, of surfaces that are seen head on by the headlight: radiance is the base colour."""
    total, through = np.zeros(4), 1.0
    for material in materials:
        color = np.array(material.base_color)
        alpha = color[3] if material.alpha_mode == "BLEND" else 1.0
        total[:3] += through * alpha * color[:3]
        through *= 1 - alpha
    total[3] = 1 - through
    return total


# --- MASK ------------------------------------------------------------------------------------------


def masked_scene(seed: int, rotation: int = 0) -> tuple[Scene, np.ndarray]:
    """A MASK panel with random alpha, one texel a pixel, before an opaque wall; and the alpha of each pixel."""
    texels = np.random.default_rng(seed).integers(0, 256, size=(SIDE, SIDE, 4), dtype=np.uint8)
    leaf = Material("leaf", (1.0, 1.0, 1.0, 0.5), alpha_mode="MASK", alpha_cutoff=0.25)
    leaf = replace(leaf, base_color_texture=TextureUse(0, nearest=True))
    front = panel_scene([leaf], textures=(Texture("leaf", texels, srgb=False),), rotation=rotation)
    back = panel_scene([leaf], depth=8.0).positions
    scene = replace(
        front,
        positions=np.concatenate([front.positions, back]),
        triangles=np.concatenate([front.triangles, front.triangles + 4]),
        uv=np.concatenate([front.uv, front.uv]),
        materials=(leaf, Material("wall", (0.5, 0.25, 0.125, 1.0))),
        material_ids=np.array([0, 0, 1, 1], dtype=np.uint32),
        object_ids=np.zeros(4, dtype=np.uint32),
    )
    return scene, texels[..., 3] / 255.0 * 0.5


@pytest.mark.small
@pytest.mark.parametrize("rotation", [0, 1, 2])
def test_under_the_cutoff_is_no_hit(device: Device, rotation: int) -> None:
    """Whatever the order of the vertices, every output is that of the wall where alpha is under the cutoff."""
    scene, alpha = masked_scene(1, rotation)
    frame = render(device, scene, panel_view(1), aov=("color", "depth", "id", "albedo"))
    hit = alpha >= 0.25
    assert 0.3 < hit.mean() < 0.7 and abs(alpha - 0.25).min() > 1e-4
    np.testing.assert_array_equal(frame["id.material"], np.where(hit, 0, 1))
    np.testing.assert_array_equal(frame["Z"], np.where(hit, 4.0, 8.0))
    assert (frame["id.prim"][hit] < 2).all() and (frame["id.prim"][~hit] >= 2).all()
    assert (frame["A"] == 1).all(), "a masked surface is opaque where it is there"
    expected = np.where(hit, scene.textures[0].texels[..., 0] / 255.0, 0.5)
    np.testing.assert_allclose(frame["R"], expected, rtol=4 * U, atol=4 * U)
    np.testing.assert_array_equal(frame["albedo.R"], frame["R"])


def test_masks_can_be_switched_off(device: Device) -> None:
    scene, _ = masked_scene(1)
    frame = render(device, scene, panel_view(1), aov="id", effects={"alpha mask": "off"})
    assert (frame["id.material"] == 0).all()


@pytest.mark.small
def test_the_cutoff_itself_is_a_hit(device: Device) -> None:
    """glTF: alpha no less than the cutoff is opaque. No texture: the factor decides for the whole surface."""
    for alpha, cutoff, is_hit in ((0.5, 0.5, True), (0.49, 0.5, False), (1.0, 1.5, False), (0.0, 0.0, True)):
        material = Material("m", (1.0, 1.0, 1.0, alpha), alpha_mode="MASK", alpha_cutoff=cutoff)
        frame = render(device, layers([2.0], [material]), orthographic(8, 8), aov="id", effects={"textures": "on"})
        assert (frame["id.prim"] != NO_HIT).all() == is_hit, (alpha, cutoff)


def test_vertex_colours_take_part_in_a_mask(device: Device) -> None:
    """Alpha 1 on the left, 0 on the right: cut at 1/4, so that 12 of 16 columns stay."""
    material = Material("m", (1.0, 1.0, 1.0, 1.0), alpha_mode="MASK", alpha_cutoff=0.25)
    scene = panel_scene([material])
    colors = np.array([(1, 1, 1, a) for a in (1, 0, 0, 1)], dtype=np.float32)
    frame = render(device, replace(scene, colors=colors), panel_view(1), aov="id")
    np.testing.assert_array_equal(frame["id.prim"] != NO_HIT, np.broadcast_to(np.arange(SIDE) < 12, (SIDE, SIDE)))


def test_many_masked_layers(device: Device) -> None:
    """A hedge: 40 masked panels behind one another; the first that has a leaf at a pixel is seen."""
    rng = np.random.default_rng(2)
    texels = rng.integers(0, 256, size=(40, SIDE, SIDE, 4), dtype=np.uint8)
    textures = tuple(Texture(str(k), one, srgb=False) for k, one in enumerate(texels))
    materials = [
        Material(
            str(k), alpha_mode="MASK", alpha_cutoff=0.9, base_color=(1.0, 1.0, 1.0, 1.0),
            base_color_texture=TextureUse(k, nearest=True),
        )
        for k in range(40)
    ]  # fmt: skip
    parts = [panel_scene([material], depth=2.0 + k) for k, material in enumerate(materials)]
    order = rng.permutation(40)
    scene = make_scene(
        np.concatenate([parts[k].positions for k in order]),
        np.concatenate([parts[0].triangles + 4 * n for n in range(40)]),
        uv=np.concatenate([parts[k].uv for k in order]),
        materials=tuple(materials),
        textures=textures,
        material_ids=np.repeat(order, 2).astype(np.uint32),
    )
    frame = render(device, scene, panel_view(1), aov=("id", "depth"))
    leaf = texels[..., 3] / 255.0 >= 0.9
    expected = np.where(leaf.any(axis=0), leaf.argmax(axis=0), NO_HIT)
    np.testing.assert_array_equal(frame["id.material"], expected)
    np.testing.assert_array_equal(frame["Z"], np.where(leaf.any(axis=0), 2.0 + expected, np.inf).astype(np.float32))


# --- BLEND -----------------------------------------------------------------------------------------


RED, GREEN, BLUE = (1.0, 0.0, 0.25), (0.0, 1.0, 0.5), (0.5, 0.25, 1.0)


@pytest.mark.parametrize("has_wall", [True, False])
def test_layers_front_to_back(device: Device, has_wall: bool) -> None:
    """Closed form, in whatever order the file has them; the other outputs are those of the nearest layer."""
    front = [blend("red", RED, 0.25), blend("green", GREEN, 0.5), blend("blue", BLUE, 0.75)]
    if has_wall:
        front.append(Material("wall", (0.5, 0.5, 0.5, 1.0)))
        front.append(blend("hidden", RED, 0.5))
    depths = [2.0, 3.0, 4.0, 5.0, 6.0][: len(front)]
    expected = composited(front[:4])
    assert expected[3] == (1.0 if has_wall else 1 - 0.75 * 0.5 * 0.25)
    for order in ([0, 1, 2, 3, 4], [4, 3, 2, 1, 0], [2, 4, 0, 3, 1]):
        order = [k for k in order if k < len(front)]
        scene = layers([depths[k] for k in order], [front[k] for k in order])
        frame = render(device, scene, orthographic(8, 8), aov=("color", "depth", "id", "albedo"))
        np.testing.assert_allclose(rgba(frame), np.broadcast_to(expected, (8, 8, 4)), rtol=8 * U)
        assert (frame["Z"] == 2.0).all() and (frame["id.material"] == order.index(0)).all()
        assert (frame["albedo.R"] == 1.0).all()


def test_layers_at_one_depth_come_in_the_order_of_ids(device: Device) -> None:
    """Coincident BLEND surfaces all count, the smaller id in front; of coincident opaque ones only the first."""
    colors = [RED, GREEN, BLUE]
    for order in ([0, 1, 2], [2, 1, 0], [1, 2, 0]):
        front = [blend(str(k), colors[k], 0.5) for k in order]
        wall = Material("wall", (0.25, 0.5, 0.75, 1.0))
        scene = layers([4.0] * 5, [*front, wall, Material("never seen", (9.0, 9.0, 9.0, 1.0))])
        frame = render(device, scene, orthographic(8, 8), aov=("color", "id"))
        np.testing.assert_allclose(rgba(frame), np.broadcast_to(composited([*front, wall]), (8, 8, 4)), rtol=8 * U)
        assert (frame["id.material"] == 0).all()


@pytest.mark.small
def test_an_opaque_surface_with_a_smaller_id_hides_what_coincides(device: Device) -> None:
    wall, pane = Material("wall", (0.25, 0.5, 0.75, 1.0)), blend("pane", RED, 0.5)
    frame = render(device, layers([4.0, 4.0], [wall, pane]), orthographic(8, 8))
    np.testing.assert_array_equal(rgba(frame), np.broadcast_to(np.float32(composited([wall])), (8, 8, 4)))


@pytest.mark.parametrize("precision", ["midpoint", "exact"])
def test_what_lies_behind_panes_whose_edge_passes_through_samples(device: Device, precision: str) -> None:
    """Nothing else in the tile lets light through, and float32 cannot tell how near the pane is there."""
    pane, wall = [(4.5, -2, -1), (5.2, -2, -1), (4.5, -12, -1)], [(-50, 50, -3), (-50, -150, -3), (150, 50, -3)]
    materials = (blend("pane", (1.0, 0.0, 0.0), 0.5), Material("wall", (0.0, 1.0, 0.0, 1.0), unlit=True))
    scene = make_scene([*pane, *wall], materials=materials, material_ids=np.array([0, 1], np.uint32))
    frame = render(device, scene, orthographic(16, 16), aov=("color", "id"), precision=precision, method="3dr-binning")
    shown = np.asarray(frame["id.prim"]) == 0
    assert shown[3:6, 4].all() and not shown[:, :4].any() and not shown[:, 6:].any()
    expected = np.where(shown[..., None], np.float32([0.5, 0.5, 0.0, 1.0]), np.float32([0.0, 1.0, 0.0, 1.0]))
    np.testing.assert_array_equal(rgba(frame), expected)


def test_forty_layers(device: Device) -> None:
    rng = np.random.default_rng(3)
    materials = [blend(str(k), tuple(rng.uniform(size=3)), float(rng.uniform(0.01, 0.2))) for k in range(40)]
    order = rng.permutation(40)
    scene = layers([2.0 + k for k in order], [materials[k] for k in order])
    frame = render(device, scene, orthographic(8, 8))
    np.testing.assert_allclose(rgba(frame), np.broadcast_to(composited(materials), (8, 8, 4)), rtol=3 * 40 * U)


def test_alpha_of_nothing_and_of_more_than_one(device: Device) -> None:
    """Alpha 0 is a hit all the same, and adds nothing; alpha over 1 or under 0 counts as 1 or 0."""
    wall = Material("wall", (0.25, 0.5, 0.75, 1.0))
    for alpha, counted in ((0.0, 0.0), (-3.0, 0.0), (1.0, 1.0), (7.0, 1.0)):
        scene = layers([2.0, 4.0], [blend("pane", RED, alpha), wall])
        frame = render(device, scene, orthographic(8, 8), aov=("color", "id"))
        expected = composited([blend("pane", RED, counted), wall])
        np.testing.assert_allclose(rgba(frame), np.broadcast_to(expected, (8, 8, 4)), rtol=4 * U)
        assert (frame["id.material"] == 0).all()


def test_alpha_of_a_texture_and_of_vertex_colours(device: Device) -> None:
    """Factor times texture times vertex colour, at each pixel."""
    texels = np.random.default_rng(4).integers(0, 256, size=(SIDE, SIDE, 4), dtype=np.uint8)
    pane = replace(blend("pane", (1.0, 1.0, 1.0), 0.5), base_color_texture=TextureUse(0, nearest=True))
    scene = panel_scene([pane], textures=(Texture("pane", texels, srgb=False),))
    colors = np.array([(1, 1, 1, a) for a in (1, 0.5, 0.5, 1)], dtype=np.float32)
    frame = render(device, replace(scene, colors=colors), panel_view(1))
    across = 1 - (np.arange(SIDE) + 0.5) / SIDE / 2
    alpha = 0.5 * texels[..., 3] / 255.0 * across
    np.testing.assert_allclose(frame["A"], alpha, rtol=8 * U)
    np.testing.assert_allclose(frame["G"], alpha * texels[..., 1] / 255.0, rtol=16 * U, atol=1e-12)


@pytest.mark.small
def test_blending_can_be_switched_off(device: Device) -> None:
    """Then the nearest surface is opaque."""
    scene = layers([2.0, 4.0], [blend("pane", RED, 0.25), Material("wall")])
    frame = render(device, scene, orthographic(8, 8), effects={"alpha blend": "off"})
    assert (rgba(frame) == np.array([*RED, 1.0], dtype=np.float32)).all()


def test_masks_and_layers_together(device: Device) -> None:
    """Masked leaves between panes: where there is no leaf the wall is seen through both panes."""
    scene, alpha = masked_scene(5)
    front = panel_scene([Material()], depth=2.0)
    middle = panel_scene([Material()], depth=6.0)
    count = scene.vertex_count
    panes = blend("front", RED, 0.25), blend("middle", GREEN, 0.5)
    together = replace(
        scene,
        positions=np.concatenate([scene.positions, front.positions, middle.positions]),
        triangles=np.concatenate([scene.triangles, front.triangles + count, front.triangles + count + 4]),
        uv=np.concatenate([scene.uv, front.uv, front.uv]),
        materials=(*scene.materials, *panes),
        material_ids=np.array([0, 0, 1, 1, 2, 2, 3, 3], dtype=np.uint32),
        object_ids=np.zeros(8, dtype=np.uint32),
    )
    frame = render(device, together, panel_view(1), aov=("color", "id"))
    wall = composited([panes[0], panes[1], scene.materials[1]])
    leaf = scene.textures[0].texels[..., :3] / 255.0
    seen = 0.25 * np.array(RED) + 0.75 * leaf
    expected = np.where((alpha >= 0.25)[..., None], seen, wall[:3])
    np.testing.assert_allclose(rgba(frame)[..., :3], expected, rtol=8 * U, atol=1e-12)
    assert (frame["A"] == 1).all() and (frame["id.material"] == 2).all()


FAR_VIEW = orthographic(33, 21, e0=(-1, 0.7, 0), ex=(0.0625, 0, 0), ey=(0, -0.0625, 0))


@pytest.mark.parametrize("view", [perspective(33, 21), FAR_VIEW], ids=["perspective", "orthographic"])
def test_slanted_panes_in_any_order(device: Device, view: object) -> None:
    """Forty panes of all directions through one another: each pixel's layers, sorted by exact depth, composited."""
    rng = np.random.default_rng(6)
    corners = rng.normal(size=(40, 1, 3)) * 0.3 + rng.normal(size=(40, 3, 3)) * 0.5 + (0, 0, -2.5)
    materials = [blend(str(k), tuple(rng.uniform(size=3)), float(rng.uniform(0.2, 0.8))) for k in range(40)]
    unlit = tuple(replace(material, unlit=True) for material in materials)
    scene = make_scene(corners, materials=unlit, material_ids=np.arange(40).astype(np.uint32))
    frame = render(device, scene, view, aov=("color", "id"))
    camera, triangles = ref.exact_camera(view.named()), ref.exact_triangles(scene.positions, scene.triangles)
    deepest = 0
    for j, i in np.argwhere(frame["id.prim"] != NO_HIT)[::9].tolist():
        hits = ref.hits_at(triangles, camera, i, j)
        deepest = max(deepest, len(hits))
        expected = composited([materials[hit.prim_id] for hit in hits])
        np.testing.assert_allclose(rgba(frame)[j, i], expected, rtol=4 * 40 * U, err_msg=f"{j, i}")
    assert deepest > 6
