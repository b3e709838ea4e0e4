"""Every output of a hit against real arithmetic and closed forms; lights against a float64 twin; pair arithmetic."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import reference as ref
from edge_error import U, edge_error, permanent
from kernel_probe import Probe
from kernel_world import NO_HIT, make_scene, orthographic, perspective, render
from light_twin import radiance, unit
from panels import SIDE, panel, panel_scene, panel_view

from clrast.image.frame import Frame
from clrast.opencl.device import Device
from clrast.scene.camera import CameraVectors, camera_vectors
from clrast.scene.model import Camera, Light, Material, Scene, Texture, TextureUse

PROJECTIONS = ["perspective", "orthographic"]
ALL_BUT_COLOR = ("depth", "distance", "normal", "position", "bary", "uv", "ray", "id")


def stack(frame: Frame, name: str, components: str = "XYZ") -> np.ndarray:
    """(height, width, n) float32 channels."""
    return np.stack([frame[f"{name}.{c}"] for c in components], axis=2)


def oblique(projection: str, width: int = 40, height: int = 30) -> CameraVectors:
    camera = Camera("oblique", projection, (0.3, 0.7, 2.5), (0.1, -0.2, 0.05), (0.1, 1.0, 0.2), 60.0, 3.0)
    return camera_vectors(camera, width, height)


def full_scene(seed: int, count: int = 25) -> Scene:
    """Random triangles with all attributes, some vertices without a normal."""
    rng = np.random.default_rng(seed)
    positions = rng.normal(size=(count, 1, 3)) * 0.6 + rng.normal(size=(count, 3, 3)) * 0.4
    normals = rng.normal(size=(3 * count, 3))
    normals /= np.sqrt((normals * normals).sum(axis=1, keepdims=True))
    normals[::13] = 0
    return make_scene(
        positions,
        normals=normals.astype(np.float32),
        uv=rng.uniform(-2, 2, size=(3 * count, 2)).astype(np.float32),
        object_ids=rng.integers(0, 1000, size=count).astype(np.uint32),
        material_ids=rng.integers(0, 3, size=count).astype(np.uint32),
        materials=(Material("a"), Material("b"), Material("c")),
    )


# --- outputs of a hit ------------------------------------------------------------------------------


def weight_error(view: CameraVectors, corners: np.ndarray, at: np.ndarray, hit: ref.Hit, ray: ref.Ray) -> np.ndarray:
    """Bound (3,) on the error of the barycentrics V_i / sum V of a sample, from that of V_i."""
    errors = np.array([edge_error(view, corners[[i - 1]], corners[[i - 2]], at[None])[0] for i in range(3)])
    triangle = ref.exact_triangles(corners, np.array([[0, 1, 2]]))[0]
    is_perspective = view.projection == "perspective"
    values, _, _ = ref.edge_values(triangle, ray, is_perspective)
    total = abs(float(sum(values))) * (2 if is_perspective else 1)
    weights = np.array([float(b) for b in hit.bary])
    return 1.01 * ((errors + weights * errors.sum()) / total + 5 * U)


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_outputs_against_real_arithmetic(device: Device, projection: str) -> None:
    view, scene = oblique(projection), full_scene(1)
    frame = render(device, scene, view, aov=ALL_BUT_COLOR)
    camera, triangles = ref.exact_camera(view.named()), ref.exact_triangles(scene.positions, scene.triangles)
    bary, uv = stack(frame, "bary", "UV"), stack(frame, "uv", "UV")
    checked = 0
    for j, i in np.argwhere(frame["id.prim"] != NO_HIT)[::5].tolist():
        ray = ref.sample_ray(camera, i + ref.HALF, j + ref.HALF)
        prim_id = int(frame["id.prim"][j, i])
        hit = ref.intersect(triangles[prim_id], ray, camera.is_perspective, prim_id)
        assert hit is not None
        owners = scene.triangles[prim_id]
        corners = scene.positions[owners]
        at = np.array([i + 0.5 - view.width / 2, j + 0.5 - view.height / 2])
        error = weight_error(view, corners, at, hit, ray)
        weights = np.array([float(b) for b in hit.bary])
        t, d = float(hit.t), np.array([float(c) for c in ray.d])
        length = math.sqrt(float((d * d).sum()))
        assert abs(float(frame["Z"][j, i]) / t - 1) <= 1.01 * U
        assert abs(float(frame["distance.Y"][j, i]) / (t * length) - 1) <= 9 * U
        # Position comes from pairs: 2^-40 of e and of t d, then one rounding.
        exact = np.array([float(c) for c in hit.position])
        slack = 1.01 * U * abs(exact) + 2.0**-40 * (abs(np.array([float(c) for c in ray.e])) + t * abs(d))
        assert (abs(stack(frame, "P")[j, i] - exact) <= slack).all()
        assert (abs(bary[j, i] - weights[1:]) <= error[1:]).all()
        exact_uv = weights @ scene.uv[owners].astype(np.float64)
        assert (abs(uv[j, i] - exact_uv) <= error @ abs(scene.uv[owners]) + 5 * U * 2).all()
        check_normals(frame, scene, owners, corners.astype(np.float64), (j, i), weights, error)
        assert frame["id.object"][j, i] == scene.object_ids[prim_id]
        assert frame["id.material"][j, i] == scene.material_ids[prim_id]
        checked += 1
    assert checked > 35


def check_normals(
    frame: Frame,
    scene: Scene,
    owners: np.ndarray,
    corners: np.ndarray,
    pixel: tuple[int, int],
    weights: np.ndarray,
    error: np.ndarray,
) -> None:
    """Ng is the unit normal of the vertices' own order; N the unit blend, or Ng where a vertex has no normal."""
    assert scene.normals is not None
    p, q = corners[1] - corners[0], corners[2] - corners[0]
    n = np.array([p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]])
    size = math.sqrt(float((n * n).sum()))
    # p and q have u of error, so their products 4u; making it a unit vector adds 8u.
    slack = 4 * U * permanent(p[None], q[None])[0].sum() / size + 8 * U
    assert abs(stack(frame, "Ng")[pixel] - n / size).max() <= 2 * slack
    at_vertices = scene.normals[owners].astype(np.float64)
    if not (at_vertices != 0).any(axis=1).all():
        np.testing.assert_array_equal(stack(frame, "N")[pixel], stack(frame, "Ng")[pixel])
        return
    blend = weights @ at_vertices
    size = math.sqrt(float((blend * blend).sum()))
    slack = (error.sum() + 5 * U) / size + 8 * U
    assert abs(stack(frame, "N")[pixel] - blend / size).max() <= 2 * slack


@pytest.mark.small
@pytest.mark.parametrize("projection", PROJECTIONS)
def test_where_nothing_is_hit(device: Device, projection: str) -> None:
    view = perspective(8, 4) if projection == "perspective" else orthographic(8, 4)
    scene = make_scene([(9, 9, -1), (10, 9, -1), (9, 10, -1)])
    frame = render(device, scene, view, aov="all")
    for name in frame:
        if name.startswith("id."):
            assert (frame[name] == 4294967295).all(), name
        elif name in ("Z", "distance.Y"):
            assert (frame[name] == np.inf).all(), name
        elif not name.startswith("ray"):
            assert not frame[name].any(), name
    assert frame["ray.Z"].all()


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_rays_are_those_of_the_definition(device: Device, projection: str) -> None:
    """Everywhere, hit or not; d in float32 to three roundings, the tangents as they are."""
    view = oblique(projection)
    frame = render(device, full_scene(2, 5), view, aov="ray")
    named, (x, y) = view.named(), np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    if projection == "orthographic":
        assert (stack(frame, "ray") == np.array(named["d"], dtype=np.float32)).all()
        tangents = named["ex"], named["ey"]
    else:
        d0, dx, dy = (np.array(named[name]) for name in ("d0", "dx", "dy"))
        exact = d0 + x[..., None] * dx + y[..., None] * dy
        slack = 3.01 * U * (abs(d0) + x[..., None] * abs(dx) + y[..., None] * abs(dy))
        assert (abs(stack(frame, "ray") - exact) <= slack).all()
        tangents = named["dx"], named["dy"]
    for name, tangent in zip(("raydx", "raydy"), tangents, strict=True):
        assert (stack(frame, name) == np.array(tangent, dtype=np.float32)).all()


@pytest.mark.small
def test_the_order_of_vertices_is_kept(device: Device) -> None:
    """Seen from both sides, Ng is that of the file's order; a mirror image that keeps its order has Ng turned round."""
    points = np.array([(0, 0, -4), (16, 0, -4), (0, -16, -4)], dtype=np.float64)
    mirrored = points * (1, -1, 1)
    for corners, sign in ((points, -1.0), (mirrored, 1.0)):
        low = -16 if sign < 0 else 0
        front = orthographic(16, 16, e0=(0, low + 16, 0))
        back = orthographic(16, 16, e0=(16, low + 16, -8), d=(0, 0, 1), ex=(-1, 0, 0))
        for view in (front, back):
            frame = render(device, make_scene(corners), view, aov=("normal", "bary", "id"))
            hit = frame["id.prim"] == 0
            assert 100 < hit.sum() < 150
            assert (frame["Ng.Z"][hit] == sign).all() and not frame["Ng.X"].any() and not frame["Ng.Y"].any()
            j, i = np.argwhere(hit)[17].tolist()
            x = i + 0.5 if view is front else 15.5 - i
            assert frame["bary.U"][j, i] == x / 16


# --- pair arithmetic, and what it is for -----------------------------------------------------------


@pytest.mark.small
def test_pairs_are_exact_or_nearly(device: Device, tmp_path: Path) -> None:
    """two_sum and two_product lose nothing; pairs keep 2^-43 in sums of one sign, products and quotients."""
    rng = np.random.default_rng(3)
    high = (rng.normal(size=(2, 400)) * 10.0 ** rng.uniform(-6, 6, size=(2, 400))).astype(np.float32)
    high[:, 0], high[:, 1], high[:, 2] = (1.0, -1.0), (1 + 2.0**-23, 2.0**-23), (3.0, 1 / np.float32(3))
    low = (high * rng.uniform(-1, 1, size=(2, 400)) * 2.0**-25).astype(np.float32)
    found = Probe(device, tmp_path).pairs(np.stack([high[0], low[0], high[1], low[1]]))
    for k in range(400):
        a, b = Fraction(float(high[0, k])), Fraction(float(high[1, k]))
        pairs = [Fraction(float(x)) + Fraction(float(y)) for x, y in found[:, :, k]]
        assert pairs[0] == a + b and pairs[1] == a * b
        a, b = a + Fraction(float(low[0, k])), b + Fraction(float(low[1, k]))
        assert abs(pairs[2] - (a + b)) <= (abs(a) + abs(b)) / 2**43
        assert abs(pairs[3] - a * b) <= abs(a * b) / 2**43
        assert abs(pairs[4] - a / b) <= abs(a / b) / 2**43


@pytest.mark.parametrize("tilt", [1e-2, 1e-4, 1e-6])
@pytest.mark.parametrize("projection", PROJECTIONS)
def test_depth_of_grazing_planes_is_right_to_an_ulp(device: Device, projection: str, tilt: float) -> None:
    """A floor whose plane passes the eye at a distance of `tilt`: N . d cancels, Z still is the nearest float32."""
    # Rows are as close as the floor is seen: it reaches from row 6 (9 units away) to row 20 (1 unit away).
    step = tilt / 16
    view = perspective(24, 24, (0.1, 0.2, 0.3), (-0.375, 4 * step, -1), dy=(0, -step, 0))
    if projection == "orthographic":
        down = (0, -tilt, tilt * tilt)
        view = orthographic(24, 24, (-3, 0.2 + 9 * tilt, 0.3), unit((0, -tilt, -1)), (0.25, 0, 0), down)
    rng = np.random.default_rng(4)
    corners = []
    for _ in range(40):
        x, z = rng.uniform(-3, 3, size=3), rng.uniform(-9, -1, size=3)
        corners.append(np.column_stack([x, 0.2 - tilt * (1 + rng.uniform(0, 0.1, size=3)), z]))
    scene = make_scene(np.array(corners))
    frame = render(device, scene, view, aov=("id", "depth"))
    camera, triangles = ref.exact_camera(view.named()), ref.exact_triangles(scene.positions, scene.triangles)
    hits = np.argwhere(frame["id.prim"] != NO_HIT).tolist()
    for j, i in hits:
        ray = ref.sample_ray(camera, i + ref.HALF, j + ref.HALF)
        t = ref.plane_t(triangles[int(frame["id.prim"][j, i])], ray)
        assert t is not None
        z = frame["Z"][j, i]
        assert abs(Fraction(float(z)) - t) <= Fraction(float(np.spacing(z))) * 51 / 100, (j, i)
    assert len(hits) >= 50


# --- light -----------------------------------------------------------------------------------------


def color(frame: Frame) -> np.ndarray:
    return np.stack([frame[c] for c in "RGB"], axis=2)


@pytest.mark.small
def test_the_headlight_is_base_times_cosine(device: Device) -> None:
    """A plane along a 3-4-5 triangle: the cosine is 4/5, on both faces and in every order of vertices."""
    base = (0.5, 0.25, 1.0, 1.0)
    slanted = np.array([(-8, 8, -20), (16, 8, -2), (-8, -16, -20)])
    for corners in (slanted, slanted[::-1]):
        scene = make_scene(corners, materials=(Material("plain", base),))
        frame = render(device, scene, orthographic(8, 8, e0=(-4, 4, 0)))
        np.testing.assert_allclose(color(frame), np.broadcast_to(0.8 * np.array(base[:3]), (8, 8, 3)), rtol=8 * U)
        assert (frame["A"] == 1).all()


def test_the_headlight_follows_shading_normals(device: Device) -> None:
    """With normals as of a sphere: the cosine between the blended normal and the way to the viewer."""
    view = perspective(32, 32)
    corners = np.array([(-0.9, -0.8, -1.5), (0.9, -0.7, -1.75), (0.1, 0.9, -1.6)])
    normals = np.array([unit(p + (0, 0, 2.5)) for p in corners]).astype(np.float32)
    frame = render(device, make_scene(corners, normals=normals), view, aov=("color", "normal", "ray", "id"))
    hit = frame["id.prim"] == 0
    d = stack(frame, "ray").astype(np.float64)
    length = np.sqrt((d * d).sum(axis=2))
    cosine = abs((stack(frame, "N") * d).sum(axis=2)) / length
    np.testing.assert_allclose(frame["R"][hit], np.float32(0.8) * cosine[hit], rtol=16 * U)
    assert hit.sum() > 200 and np.ptp(frame["R"][hit]) > 0.01


MATERIALS = [
    Material("chalk", (0.8, 0.6, 0.4, 1.0), metallic=0.0, roughness=1.0),
    Material("plastic", (0.2, 0.5, 0.9, 1.0), metallic=0.0, roughness=0.4),
    Material("gold", (1.0, 0.7, 0.3, 1.0), metallic=1.0, roughness=0.5),
    Material("alloy", (0.6, 0.6, 0.7, 1.0), metallic=0.5, roughness=0.7),
]
MIDDLE = (len(MATERIALS) * SIDE / 2, -SIDE / 2)
LIGHTS = {
    "point": Light("p", "point", (900.0, 500.0, 300.0), (MIDDLE[0] - 9, MIDDLE[1] + 3, 8.0)),
    "ranged": Light("r", "point", (900.0, 500.0, 300.0), (MIDDLE[0], MIDDLE[1], 8.0), range=30.0),
    "directional": Light("d", "directional", (3.0, 2.0, 1.0), direction=tuple(unit((0.3, -0.5, -1.0)))),
    "spot": Light(
        "s", "spot", (900.0, 700.0, 500.0), (*MIDDLE, 14.0), tuple(unit((0.2, 0.1, -1.0))), 0.0, 0.3, 1.1
    ),
    "behind": Light("b", "point", (900.0, 500.0, 300.0), (MIDDLE[0], MIDDLE[1], -40.0)),
}


@pytest.mark.parametrize("names", [(name,) for name in LIGHTS] + [("point", "spot", "directional")], ids="+".join)
def test_lights_against_the_twin(device: Device, names: tuple[str, ...]) -> None:
    """Four materials side by side, seen head on.

    D is divided by the square of (N.H)^2 (alpha^2 - 1) + 1, which is alpha^2 at least, and N.H has 4u of error: so
    D has 24u / alpha^2; 64u for everything else.
    """
    lights = tuple(LIGHTS[name] for name in names)
    scene = panel_scene(MATERIALS, lights=lights)
    found = color(render(device, scene, panel_view(len(MATERIALS))))
    n = np.array([0.0, 0.0, 1.0])
    for k, material in enumerate(MATERIALS):
        for j, i in ((0, 0), (3, 12), (8, 8), (15, 1), (11, 15)):
            point = np.array([k * SIDE + i + 0.5, -(j + 0.5), -4.0])
            expected = radiance(material, lights, point, n, n)
            tolerance = 24 * U / material.roughness**4 + 64 * U
            np.testing.assert_allclose(panel(found, k)[j, i], expected, rtol=tolerance, err_msg=material.name)
    assert found.any() == (names != ("behind",))


def test_lights_in_perspective_on_slanted_surfaces(device: Device) -> None:
    """Views and normals of all directions; a face that is lit from its far side stays dark, its back may be lit."""
    view = oblique("perspective")
    lights = (
        Light("p", "point", (3.0, 2.0, 1.0), (0.5, 1.5, 1.0)),
        Light("d", "directional", (1.0, 1.5, 2.0), direction=tuple(unit((0.5, -0.3, -0.4)))),
    )
    scene = full_scene(5, 40)
    materials = tuple(replace(m, roughness=0.6, metallic=0.25) for m in scene.materials)
    scene = replace(scene, materials=materials, lights=lights)
    frame = render(device, scene, view, aov=("color", "normal", "position", "ray", "id"))
    shaded, dark = 0, 0
    for j, i in np.argwhere(frame["id.prim"] != NO_HIT)[::3].tolist():
        v = -unit(stack(frame, "ray")[j, i])
        ng, n = unit(stack(frame, "Ng")[j, i]), unit(stack(frame, "N")[j, i])
        side = -1.0 if ng @ v < 0 else 1.0
        if n @ v * side < 0.1:
            continue  # where the normal turns from the viewer, N.V is bounded by 1e-4 and noise is amplified
        expected = radiance(scene.materials[0], lights, stack(frame, "P")[j, i], n * side, v, ng * side)
        np.testing.assert_allclose(color(frame)[j, i], expected, rtol=24 * U / 0.6**4 + 400 * U, atol=1e-7)
        shaded, dark = shaded + expected.any(), dark + (not expected.any())
    assert shaded > 40 and dark > 5


@pytest.mark.small
def test_emission_adds_to_the_light(device: Device) -> None:
    """Factor times texture, with a transform of its own; the headlight head on adds the base colour."""
    texels = np.array([[[255, 0, 0, 255], [0, 255, 0, 255]]], dtype=np.uint8)
    glow = Material("glow", (0.25, 0.5, 0.125, 1.0), emissive=(2.0, 4.0, 8.0))
    use = TextureUse(0, transform=(1.0, 0.0, 0.5, 0.0, 1.0, 0.0), nearest=True)
    sign = replace(glow, name="sign", emissive_texture=use)
    scene = panel_scene([glow, sign], textures=(Texture("two", texels, srgb=False),))
    found = color(render(device, scene, panel_view(2)))
    assert (panel(found, 0) == np.array([2.25, 4.5, 8.125], dtype=np.float32)).all()
    assert (panel(found, 1)[:, :8] == np.array([0.25, 4.5, 0.125], dtype=np.float32)).all()
    assert (panel(found, 1)[:, 8:] == np.array([2.25, 0.5, 0.125], dtype=np.float32)).all()


@pytest.mark.small
def test_unlit_is_the_base_colour_alone(device: Device) -> None:
    """KHR_materials_unlit: no light, no cosine, no emission, from any side."""
    unlit = Material("sign", (0.5, 0.25, 2.0, 1.0), emissive=(1.0, 1.0, 1.0), unlit=True)
    scene = make_scene([(-8, 8, -20), (16, 8, -2), (-8, -16, -20)], materials=(unlit,))
    lit = replace(scene, lights=(LIGHTS["directional"],))
    for one in (scene, lit):
        found = color(render(device, one, orthographic(8, 8, e0=(-4, 4, 0))))
        assert (found == np.array([0.5, 0.25, 2.0], dtype=np.float32)).all()
