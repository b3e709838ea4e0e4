"""Projections that are not planar: their samples, bounds and images against closed forms and exact arithmetic."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from curved_probe import CurvedProbe
from curved_reference import exact_image, rays_of
from curved_world import CURVED, aimed_sheet, ball, box, curved_view, octahedron, soup_in_box
from kernel_world import NO_HIT, make_scene, render

from clrast import renderer
from clrast.__main__ import main
from clrast.commands.viewpoint import choose_camera, make_view
from clrast.errors import UsageError
from clrast.image.frame import Frame
from clrast.opencl.device import Device
from clrast.options import METHODS_OF_ANY_VIEW
from clrast.scene.camera import CameraVectors
from clrast.scene.model import Camera, Material, Scene
from clrast.visibility.loop_limits import loop_limit
from clrast.visibility.sample_generator import SampleRays, sample_rays
from clrast.visibility.sample_patterns import UNITS, pattern_of

SIZES = {"paraboloid": (121, 98), "latlong": (120, 75), "fisheye": (98, 121)}
AXES = {"eye": (0, 0, 0), "look_at": (0, 0, 1), "up": (0, 1, 0), "fov": 360.0}


def centers(view: CameraVectors) -> tuple[np.ndarray, np.ndarray]:
    return np.arange(view.width)[None] + 0.5, np.arange(view.height)[:, None] + 0.5


# --- samples ---------------------------------------------------------------------------------------


@pytest.mark.small
def test_elementary_functions(device: Device, tmp_path: Path) -> None:
    """Against float64; the errors that cl/elementary.clh promises."""
    rng = np.random.default_rng(1)
    x = np.concatenate([rng.uniform(-2, 2, 4000), np.arange(-16, 17) / 8, rng.uniform(-1e-4, 1e-4, 200)])
    y = np.concatenate([rng.uniform(-150, 150, 4033), rng.uniform(-1e-4, 1e-4, 200)])
    y = np.round(y * 256) / 256 + 0.0  # no -0, whose half turn is on the other side
    x = x.astype(np.float32).astype(np.float64)
    found = CurvedProbe(device, tmp_path, "latlong").angles(x, y, 301.0).astype(np.float64)
    for angle, sine, cosine in ((x, *found[:2]), (y / 301, *found[2:4])):
        turned = 2 * np.pi * (angle - np.round(angle))
        assert abs(sine - np.sin(turned)).max() < 1.2e-7
        assert abs(cosine - np.cos(turned)).max() < 1.2e-7
        small = abs(np.sin(turned)) < 0.5
        assert (abs(sine - np.sin(turned)) <= 4 * 2.0**-24 * abs(np.sin(turned)) + 1e-15)[small].all()
    assert abs(found[4] - np.arctan2(y, x) / (2 * np.pi)).max() < 9e-8
    axes = np.array([[1, 0], [0, 1], [-1, 0], [0, -1], [0, 0]], dtype=np.float64)
    assert CurvedProbe(device, tmp_path, "latlong").angles(*axes.T, 1.0)[4].tolist() == [0.0, 0.25, 0.5, -0.25, 0.0]


def closed_form(view: CameraVectors, fov: float, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, ...]:
    """d, tx, ty in float64 by DESIGN's table (fisheye: by its definition), and which samples there are."""
    f, r, u = (np.array(v) for v in (view.direction, view.tangent_x, view.tangent_y))
    x, y = np.broadcast_arrays(x, y)
    if view.projection == "latlong":
        lon, lat = ((x / view.width - 0.5) * 2 * np.pi)[..., None], ((0.5 - y / view.height) * np.pi)[..., None]
        ahead = np.cos(lon) * f + np.sin(lon) * r
        d = np.cos(lat) * ahead + np.sin(lat) * u
        return d, np.cos(lon) * r - np.sin(lon) * f, np.sin(lat) * ahead - np.cos(lat) * u, np.ones_like(x) > 0
    s = min(view.width, view.height) / 2
    a, b = ((x - view.width / 2) / s)[..., None], ((view.height / 2 - y) / s)[..., None]
    inside = ((x - view.width / 2) ** 2 + (y - view.height / 2) ** 2) <= s * s
    if view.projection == "paraboloid":
        return a * r + b * u + (0.5 - (a * a + b * b) / 2) * f, r - a * f, -u + b * f, inside
    half = np.radians(fov) / 2

    def at(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        q = np.maximum(np.sqrt(a * a + b * b), 1e-12)
        return np.cos(half * q) * f + np.sin(half * q) / q * (a * r + b * u)

    step = 1e-5
    with_a, against_b = at(a + step, b) - at(a - step, b), at(a, b - step) - at(a, b + step)
    return at(a, b), with_a / (2 * step), against_b / (2 * step), inside


@pytest.mark.parametrize("projection", CURVED)
@pytest.mark.parametrize("size", [(64, 64), (65, 33), (5, 6), (1, 1), (33, 129)])
def test_samples_are_what_the_table_says(projection: str, size: tuple[int, int]) -> None:
    """Directions within 3e-7 and tangents within 1e-6 of the closed forms, and 0 where there is no sample."""
    view = curved_view(projection, *size, fov=300.0)
    x, y = (np.concatenate([c.ravel(), [0, size[k] / 2, size[k]]]) for k, c in enumerate(centers(view)))
    found, (d, tx, ty, inside) = sample_rays(view, x[None], y[:, None]), closed_form(view, 300.0, x[None], y[:, None])
    assert abs(found.d - d)[inside].max() < 3e-7
    assert max(abs(found.tx - tx)[inside].max(), abs(found.ty - ty)[inside].max()) < 1e-6
    assert not any(part[~inside].any() for part in (found.d, found.tx, found.ty))
    assert found.d[inside].any(axis=-1).all()
    if projection == "latlong":
        lengths = np.linalg.norm([found.d.astype(np.float64), found.tx, found.ty], axis=-1)
        assert abs(lengths - 1).max() < 4e-7


def test_the_rim_is_decided_in_integers() -> None:
    """A centre on the rim, 3-4-5, is a sample; the next one out is none."""
    view = curved_view("paraboloid", 5, 6)
    found = sample_rays(view, *centers(view)).d.any(axis=-1)
    assert found[1, 4] and found[4, 0] and not found[0, 4] and found.sum() == 22


def same_rays(frame: dict[str, np.ndarray], expected: SampleRays) -> bool:
    return all((found == right).all() for found, right in zip(rays_of(frame), (expected.d, expected.tx, expected.ty)))


# --- blocks ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("projection", CURVED)
def test_no_sample_of_a_block_exceeds_its_bound(device: Device, projection: str, tmp_path: Path) -> None:
    """Of random edges and blocks of all sizes; and the bound is the maximum itself, but for the fisheye's."""
    view = curved_view(projection, 96, 64, fov=360.0)
    rng, count, side = np.random.default_rng(4), 600, 17
    normals = rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(-9, 9, (count, 1))
    normals[:40] = rng.integers(-1, 2, (40, 3))  # along axes, and none at all
    sizes = np.minimum(2.0 ** rng.uniform(0, 7, (count, 2)), [96, 64]).astype(int)
    low = (rng.random((count, 2)) * (np.array([96, 64]) - sizes + 1)).astype(int) - np.array([48, 32])
    blocks = np.concatenate([low, low + sizes], axis=1).astype(np.float64)
    found = CurvedProbe(device, tmp_path, projection).blocks(view, normals, blocks)
    share = np.linspace(0, 1, side)
    x = np.round((blocks[:, :1] + share * sizes[:, :1]) * 256) / 256 + 48
    y = np.round((blocks[:, 1:2] + share * sizes[:, 1:]) * 256) / 256 + 32
    d = sample_rays(view, x[:, None], y[:, :, None]).d
    rounded = normals.astype(np.float32)
    values = (rounded[:, None, None, 0] * d[..., 0] + rounded[:, None, None, 1] * d[..., 1]) + rounded[
        :, None, None, 2
    ] * d[..., 2]
    values[~d.any(axis=-1)] = -np.inf
    assert (found[:, None, None] >= values).all()
    if projection == "fisheye":
        return
    whole = d.any(axis=-1).all(axis=(1, 2))
    size = np.linalg.norm(rounded, axis=1)
    # Between samples 1/16 of the block apart the value grows by at most the square of that, half the curvature.
    gap = (2 * np.pi * sizes / np.array([96, 64])).max(axis=1) / (side - 1)
    excess = (found - values.max(axis=(1, 2)))[whole]
    assert (excess <= (size * (gap**2 + 2e-5))[whole] + 1e-30).all()


# --- images ----------------------------------------------------------------------------------------


def judge(
    device: Device, scene: Scene, view: CameraVectors, **options: object
) -> tuple[dict[str, np.ndarray], int, int]:
    """A rendered frame's channels, how many of its samples are wrong, and how many samples there are."""
    frame = render(device, scene, view, aov="ray,depth,id", **options)
    d, tx, ty = rays_of(frame.channels)
    prim_id, _, t, _ = exact_image(scene.positions, scene.triangles, np.array(view.origin), d, tx, ty)
    agree = (frame["id.prim"] == prim_id) & (prim_id != NO_HIT)
    along = d[agree].astype(np.float64) @ np.array(view.direction)
    assert (abs(frame["Z"][agree] - t[agree] * along) <= 1e-7 * t[agree]).all()
    assert np.isposinf(frame["Z"][frame["id.prim"] == NO_HIT]).all()
    return frame.channels, int((frame["id.prim"] != prim_id).sum()), int(d.any(axis=-1).sum())


SCENES = {"ball": lambda: ball(2), "soup": soup_in_box}


@pytest.mark.parametrize("projection", CURVED)
def test_the_image_is_right(device: Device, projection: str) -> None:
    """At most one sample of 20,000 is wrong with midpoint (here: none), and rays have the bits of the host's twin."""
    wrong = samples = 0
    for make in SCENES.values():
        view = curved_view(projection, *SIZES[projection])
        scene = make()
        channels, own_wrong, own_samples = judge(device, scene, view)
        assert same_rays(channels, sample_rays(view, *centers(view)))
        sampled = rays_of(channels)[0].any(axis=-1)
        assert ((channels["id.prim"] != NO_HIT) == sampled).all()  # all scenes are closed: no hole, and nothing beyond
        assert projection == "paraboloid" or (channels["Z"][sampled] < 0).any()
        wrong, samples = wrong + own_wrong, samples + own_samples
    assert wrong * 20000 <= samples


@pytest.mark.parametrize("projection", CURVED)
def test_rays_through_corners_and_along_edges(device: Device, projection: str) -> None:
    """An octahedron round the eye: rays of the middle row and column lie in its edges' planes, V = 0 in float32 too."""
    view = curved_view(projection, 63, 63, **AXES)
    _, wrong, _ = judge(device, octahedron(), view)
    assert wrong == 0


def check_once(device: Device, projection: str) -> None:
    """Of closed meshes each sample is hit, and by one triangle only."""
    view = curved_view(projection, *SIZES[projection])
    for scene in (ball(2), make_scene(*box())):
        frame = render(device, scene, view, aov="id,ray", counters=True, method="raycast-brute")
        count = int(rays_of(frame.channels)[0].any(axis=-1).sum())
        assert int((frame["id.prim"] != NO_HIT).sum()) == count
        assert frame.stats["other_counts"]["samples_covered"] == count


def test_each_sample_of_a_closed_mesh_is_hit_once(first_device: Device) -> None:
    check_once(first_device, "latlong")


@pytest.mark.long
@pytest.mark.parametrize("projection", CURVED)
def test_each_sample_is_hit_once_everywhere(device: Device, projection: str) -> None:
    check_once(device, projection)


def check_methods(device: Device, projection: str, methods: tuple[str, ...], **options: object) -> None:
    """The same bits of every method, on scenes of small, large and aimed triangles."""
    view = curved_view(projection, *SIZES[projection])
    for scene in (soup_in_box(), ball(2), aimed_sheet(view)):
        right = render(device, scene, view, aov="depth,id", **options)
        for method in methods:
            found = render(device, scene, view, aov="depth,id", method=method, **options)
            for name in ("id.prim", "Z"):
                assert (found[name].view(np.uint32) == right[name].view(np.uint32)).all(), (method, name)


def test_methods_agree(device: Device) -> None:
    """Two whose programs the other tests build not; all of them, in all rungs, with --long."""
    check_methods(device, "latlong", ("3dr-full",))


@pytest.mark.long
@pytest.mark.parametrize("precision", ["fast", "ordered", "midpoint", "double", "exact"])
@pytest.mark.parametrize("projection", CURVED)
def test_all_methods_agree(device: Device, projection: str, precision: str) -> None:
    if precision == "double" and not device.has_fp64:
        pytest.skip(f"{device.runtime} has no float64")
    check_methods(device, projection, METHODS_OF_ANY_VIEW, precision=precision)
    if precision == "midpoint" and device.runtime == "pocl":
        for width in (1, 8):
            check_methods(device, projection, ("3dr-binning", "raycast-bvh"), vector_width=width)


def check_exact(device: Device, projection: str) -> None:
    """No wrong sample, though samples lie within rounding of corners and edges; midpoint has some."""
    view = curved_view(projection, 61, 50)
    scene = aimed_sheet(view)
    assert judge(device, scene, view, precision="exact")[1] == 0
    assert judge(device, scene, view)[1] > 0
    assert judge(device, octahedron(), curved_view(projection, 63, 63, **AXES), precision="exact")[1] == 0


def test_exact_is_right(first_device: Device) -> None:
    check_exact(first_device, "latlong")


@pytest.mark.long
@pytest.mark.parametrize("projection", CURVED)
def test_exact_is_right_everywhere(device: Device, projection: str) -> None:
    check_exact(device, projection)


def test_where_there_is_no_sample(first_device: Device) -> None:
    """Rays 0, ids 'nothing', depth and distance infinite, the rest 0; distance is counted from the eye."""
    view = curved_view("paraboloid", 40, 30)
    frame = render(first_device, ball(2), view, aov="all")
    outside = ~sample_rays(view, *centers(view)).d.any(axis=-1)
    assert outside.sum() > 400
    for name, values in frame.channels.items():
        nothing = NO_HIT if name.startswith("id.") else np.inf if name in ("Z", "distance.Y") else 0
        assert (values[outside] == nothing).all(), name
    position = np.stack([frame[f"P.{c}"] for c in "XYZ"], -1)[~outside].astype(np.float64)
    distance = np.linalg.norm(position - np.array(view.origin), axis=-1)
    assert abs(frame["distance.Y"][~outside] / distance - 1).max() < 1e-6


@pytest.mark.parametrize("aa", ["ssaa:4", "msaa:4", "csaa:2+6", "auto:0.05"])
def test_antialiasing(first_device: Device, aa: str) -> None:
    """What has one colour keeps it; with flat colours shared shading is the same as shading each sample."""
    view = curved_view("latlong", 48, 32)
    flat = tuple(Material(base_color=(r, 0.5, 1.25 - r, 1.0), unlit=True) for r in (0.25, 1.0))
    plain = replace(ball(1), materials=flat)
    frame = render(first_device, plain, view, aov="color", aa=aa)
    assert all((frame[name] == value).all() for name, value in zip("RGBA", flat[0].base_color, strict=True))
    two = replace(soup_in_box(), materials=flat)
    two = replace(two, material_ids=(np.arange(two.triangle_count) % 2).astype(np.uint32))
    found = render(first_device, two, view, aov="color", aa=aa)
    once = render(first_device, two, view, aov="color")
    assert (found["R"] != once["R"]).any()
    if aa == "msaa:4":
        every = render(first_device, two, view, aov="color", aa="ssaa:4")
        assert abs(found["R"] - every["R"]).max() < 1e-6


def test_samples_lie_where_the_pattern_says(first_device: Device) -> None:
    """Supersampling is the mean of what its samples see, each of them rendered for itself in a finer image."""
    flat = tuple(Material(base_color=(r, r, r, 1.0), unlit=True) for r in (1.0, 0.0))
    scene = replace(soup_in_box(), materials=flat)
    scene = replace(scene, material_ids=(np.arange(scene.triangle_count) % 2).astype(np.uint32))
    for projection in ("latlong", "paraboloid"):
        coarse, fine = curved_view(projection, 12, 10), curved_view(projection, 12 * 16, 10 * 16)
        color = render(first_device, scene, coarse, aov="color", aa="ssaa:4")["R"]
        seen = render(first_device, scene, fine, aov="id")["id.prim"]
        # Standard positions are multiples of 1/16 pixel: corners of the fine image's pixels, among four centres.
        total, sure = np.zeros((10, 12)), np.ones((10, 12), dtype=bool)
        for x, y in pattern_of(4).positions:
            i, j = x * 16 // UNITS, y * 16 // UNITS
            four = np.stack([seen[max(j - a, 0) :: 16, max(i - b, 0) :: 16][:10, :12] for a in (0, 1) for b in (0, 1)])
            sure &= (four == four[0]).all(axis=0)
            total += np.where(four[0] == NO_HIT, 0, four[0] % 2 == 0)
        assert sure.sum() > 60
        assert abs(color - total / 4)[sure].max() < 1e-6


# --- cube maps -------------------------------------------------------------------------------------

FACES = {
    # By ImfEnvmap.h: direction of the face, then of its right and of its lower edge.
    "+X": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "-X": ((-1, 0, 0), (0, 0, -1), (0, -1, 0)),
    "+Y": ((0, 1, 0), (1, 0, 0), (0, 0, -1)),
    "-Y": ((0, -1, 0), (1, 0, 0), (0, 0, 1)),
    "+Z": ((0, 0, 1), (-1, 0, 0), (0, -1, 0)),
    "-Z": ((0, 0, -1), (1, 0, 0), (0, -1, 0)),
}


def test_a_cube_map_is_laid_out_as_openexr_has_it(first_device: Device, tmp_path: Path) -> None:
    camera = Camera("probe", "cube", (0.25, -0.5, 1.0), (0.25, -0.5, 1.0))
    scene = ball(1)
    frame = renderer.render(scene, camera, size=(16, 16), aov="ray,position,id", device=first_device.runtime)
    assert (frame.width, frame.height) == (16, 96) and frame.stats["image"] == {"width": 16, "height": 96}
    assert frame.stats["counts"]["samples"] == 16 * 96
    d = rays_of(frame.channels)[0]
    along = (np.arange(16) + 0.5) / 8 - 1
    for k, (forward, right, down) in enumerate(FACES.values()):
        expected = np.array(forward) + along[None, :, None] * np.array(right) + along[:, None, None] * np.array(down)
        assert abs(d[16 * k : 16 * k + 16] - expected).max() < 1e-6
    position = np.stack([frame[f"P.{c}"] for c in "XYZ"], -1) - np.array(camera.eye)
    hit = frame["id.prim"] != NO_HIT
    assert hit.any() and abs(np.cross(position, d)[hit]).max() < 1e-5
    frame.save(tmp_path / "cube.exr")
    assert b"envmap\0envmap\0\1\0\0\0\1" in (tmp_path / "cube.exr").read_bytes()
    whole = renderer.render(scene, camera, size=(16, 96), aov="ray,position,id", device=first_device.runtime)
    assert all((whole[name].view(np.uint32) == frame[name].view(np.uint32)).all() for name in frame)


def test_a_cube_map_through_a_grid(first_device: Device, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Counts that are lists are those of a face: all have one grid. Studies have one view, and refuse six."""
    if loop_limit(first_device) is not None:
        pytest.skip("grids are refused here")
    frames = []
    for method in ("raycast-grid", "3dr-binning"):
        camera = Camera("probe", "cube", (0.25, -0.5, 1.0), (0.25, -0.5, 1.0))
        options = {"size": (16, 16), "aov": "depth,id", "device": first_device.runtime}
        frames.append(renderer.render(ball(1), camera, method=method, **options))
    assert all((frames[0][name] == frames[1][name]).all() for name in frames[0])
    columns, rows, layers = frames[0].stats["other_counts"]["grid"]
    assert min(columns, rows, layers) >= 1
    scene = tmp_path / "one.obj"
    scene.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    for study in ("accuracy", "cost", "compare"):
        assert main([study, str(scene), "--projection", "cube", "--size", "8x8"]) == 64
        assert f"{study} measures one view" in capsys.readouterr().err


# --- the command line ------------------------------------------------------------------------------


def test_what_a_file_says_of_its_view(first_device: Device, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Camera vectors in stats and header, and a warning of each option that a projection does not use."""
    card = Path(__file__).resolve().parent.parent / "data" / "triangle.toml"
    out, stats = tmp_path / "x.exr", tmp_path / "stats.json"
    view = ["--eye", "0,0,2", "--look-at", "0,0,-1", "--fov", "270", "--height", "2", "--size", "12x8"]
    more = ["--projection", "fisheye", "-o", str(out), "--stats", str(stats), "--device", first_device.runtime]
    assert main(["render", str(card), *view, *more, "--method", "3dr-binning", "--aov", "ray,depth"]) == 0
    warnings = [line for line in capsys.readouterr().err.splitlines() if line.startswith("warning:")]
    assert warnings == ["warning: --height is ignored: the fisheye projection does not use it"]
    vectors = {"e": [0, 0, 2], "right": [1, 0, 0], "up": [0, 1, 0], "forward": [0, 0, -1]}
    assert json.loads(stats.read_text())["camera"] == vectors
    header = Frame.load(out).header
    assert header["projection"] == "fisheye" and header["fov"] == 270
    assert {name: list(header[f"camera.{name}"]) for name in vectors} == vectors


@pytest.mark.parametrize(
    ("projection", "unused"),
    [("paraboloid", ("fov", "height")), ("latlong", ("fov", "height")), ("fisheye", ("height",)),
     ("cube", ("look_at", "up", "fov", "height"))],
)  # fmt: skip
def test_options_that_a_projection_does_not_use(projection: str, unused: tuple[str, ...]) -> None:
    given = {"eye": "-1,2,3", "look_at": "0,0,1", "up": "0,1,0", "fov": "60", "height": "2", "projection": projection}
    choice = choose_camera(ball(0), make_view(given), (8, 8), "ball")
    assert [line.split()[0] for line in choice.warnings] == [f"--{name.replace('_', '-')}" for name in unused]
    assert choice.camera.projection == projection and choice.camera.eye == (-1, 2, 3)
    assert choice.camera.fov == (60 if projection == "fisheye" else 45)
    del given["fov"]
    fov = choose_camera(ball(0), make_view(given), (8, 8), "ball").camera.fov
    assert fov == (180 if projection == "fisheye" else 45)


def test_auto_takes_a_3d_method(first_device: Device) -> None:
    camera = Camera("inside", "latlong", (0.0, 0.0, 0.0), (0.0, 0.0, -1.0))
    frame = renderer.render(ball(1), camera, size=(16, 8), aov="id", device=first_device.runtime)
    assert frame.stats["method"] in METHODS_OF_ANY_VIEW


@pytest.mark.parametrize("method", ["2dr-brute", "2dr-binning", "2dh-brute", "2dh-binning"])
def test_2d_methods_refuse(method: str) -> None:
    for projection in CURVED:
        with pytest.raises(UsageError, match=f"--method {method} .*{projection}.* use 3dr-brute, 3dr-binning"):
            renderer.render(ball(0), Camera("inside", projection), size=(8, 8), method=method)
