"""The suites that other systems run: a part here, the rest with --long and by tools/check_suites.py; and that they fail
where a kernel is wrong."""

from __future__ import annotations

import importlib.util
import itertools
import json
import sys
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
import reference as ref
from conformance import METHOD_OPTIONS, UNJUDGED_RUNGS, Verdict, expect, make_image, run_case
from conformance_inputs import run_inputs
from conformance_integer import covers, integer_cases, random_triangles
from conformance_spheres import dense_bumpy_cases, far_cases, small_bumpy_cases
from conformance_worlds import Case, aimed_sheet, quad_cases, sheet, small_cases
from exact_counts import exact_hit_counts, faces_one_way
from kernel_world import NO_HIT, make_scene
from patched_kernels import CONTRACTED, PLAIN, patched

from clrast.opencl.device import Device
from clrast.options import AVAILABLE_PRECISIONS
from clrast.study.double_hits import hit_counts

TOOL = Path(__file__).resolve().parents[1] / "tools" / "check_suites.py"
JUDGED = tuple(rung for rung in AVAILABLE_PRECISIONS if rung not in UNJUDGED_RUNGS)
PROJECTIONS = ("perspective", "orthographic")


def short_cases() -> dict[str, list[Case]]:
    """A little of every suite, by its name on the tool's command line."""
    quads = list(quad_cases())
    return {
        "quads": [quads[k] for k in (0, 3, 4, 20, 32, 150, 160, 200)],
        "sheets": [sheet(0, level, projection) for level in (1, 4, 7) for projection in PROJECTIONS],
        "aimed": [aimed_sheet(1, level, projection) for level in (1, 5) for projection in PROJECTIONS],
        "far": [next(far_cases())],
        "small": [next(small_cases())],
        "bumpy": list(itertools.islice(small_bumpy_cases(), 6)),
        "integer": list(itertools.islice(integer_cases(), 30, 40)),
    }


@pytest.fixture(scope="module")
def tool():
    """tools/check_suites.py as a module."""
    spec = importlib.util.spec_from_file_location("check_suites", TOOL)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["check_suites"] = module
    spec.loader.exec_module(module)
    return module


# --- the references --------------------------------------------------------------------------------


def test_exact_counts_are_those_of_fractions() -> None:
    """Samples in general position, on edges and on vertices, by the slow reference."""
    for case in (aimed_sheet(0, 2, "perspective"), aimed_sheet(0, 2, "orthographic")):
        given = case.scene.positions, case.scene.triangles, case.view.named()
        found = exact_hit_counts(*given, case.view.width, case.view.height)
        camera, triangles = ref.exact_camera(case.view.named()), ref.exact_triangles(*given[:2])
        assert case.vertices is not None and case.edges is not None
        for i, j in np.concatenate([case.vertices, case.edges, [(3, 5), (17, 40)]]).tolist():
            assert found[j, i] == len(ref.hits_at(triangles, camera, i, j)) == 1


def test_aimed_samples_are_on_vertices_and_edges() -> None:
    """V = 0 for two edges and for one, in fractions."""
    for projection in ("perspective", "orthographic"):
        case = aimed_sheet(2, 3, projection)
        camera = ref.exact_camera(case.view.named())
        triangles = ref.exact_triangles(case.scene.positions, case.scene.triangles)
        for samples, least in ((case.vertices, 2), (case.edges, 1)):
            assert samples is not None and len(samples) > 20
            for i, j in samples.tolist():
                ray = ref.sample_ray(camera, i + ref.HALF, j + ref.HALF)
                values = [ref.edge_values(t, ray, camera.is_perspective)[0] for t in triangles]
                assert max(sum(v == 0 for v in three) for three in values) >= least


@pytest.mark.parametrize("name", ["sheets", "aimed", "bumpy", "quads"])
def test_single_worlds_are_met_once(name: str) -> None:
    """That the eye sees them unfolded, and they fill the view: by counts in real arithmetic."""
    for case in short_cases()[name]:
        if case.single and case.scene.triangle_count < 5000:
            given = case.scene.positions, case.scene.triangles, case.view.named()
            assert faces_one_way(*given)
            assert (exact_hit_counts(*given, case.view.width, case.view.height) == 1).all()


def test_the_integer_rasterizer_agrees_with_fractions() -> None:
    """At samples inside, outside and on edges, slivers and triangles without area among them."""
    triangles = np.concatenate([random_triangles(3, 40) % 256, [[(8, 8), (248, 8), (8, 248)]]])
    case = next(integer_cases())
    camera = ref.exact_camera(case.view.named())
    hits = 0
    for one in triangles:
        mask = covers(one, 16)
        corners = np.concatenate([one / 16 * (1, -1), -np.ones((3, 1))], axis=1)
        exact = ref.exact_triangles(corners, np.array([[0, 1, 2]]))
        found = [[bool(ref.hits_at(exact, camera, i, j)) for i in range(16)] for j in range(16)]
        np.testing.assert_array_equal(mask, found)
        hits += int(mask.sum())
    assert hits > 300


def test_alpha_counts_the_hits(first_device: Device) -> None:
    """Against one render for each triangle, folds and hidden surfaces included."""
    rng = np.random.default_rng(5)
    corners = (rng.normal(size=(30, 1, 3)) * 0.3 + rng.normal(size=(30, 3, 3)) * 0.7).astype(np.float32)
    view = sheet(0, 1, "perspective", 48).view
    case = Case("here", "random", make_scene(corners), view)
    image = make_image(first_device, case, {"method": "3dr-binning"}, is_opaque=False)

    def alone(chosen: np.ndarray) -> np.ndarray:
        part = Case("here", "part", make_scene(corners[chosen]), view)
        return make_image(first_device, part, {"method": "3dr-binning"}, is_opaque=False).ids

    np.testing.assert_array_equal(image.counts, hit_counts(alone, 30))
    assert image.counts.max() > 5


# --- the suites ------------------------------------------------------------------------------------


def check(
    device: Device, cases: Iterable[Case], rungs: tuple[str, ...], methods: tuple[str, ...], is_opaque: bool = True
) -> int:
    """Fails at the first broken promise; returns the number of images judged."""
    count = 0
    for case in cases:
        for verdict in run_case(device, case, rungs, methods, is_opaque=is_opaque):
            assert verdict.forbidden == 0, verdict
            count += 1
    return count


@pytest.mark.parametrize("name", ["quads", "sheets", "aimed", "far", "small", "bumpy", "integer"])
def test_a_part_of_every_suite(first_device: Device, name: str) -> None:
    """By one method: each program takes seconds to build. Others give the same bits: see test_continuum.py."""
    cases = short_cases()[name]
    assert check(first_device, cases, ("midpoint",), ("3dr-binning",), is_opaque=False) == len(cases)
    if "exact" in JUDGED:
        seen = [case for case in cases if case.view.projection == "perspective"]
        assert check(first_device, seen, ("exact",), ("3dr-binning",), is_opaque=False) == len(seen)


@pytest.mark.parametrize("faces", [2, pytest.param(6, marks=pytest.mark.long)])
def test_rays_aimed_at_a_hundred_thousand_vertices(first_device: Device, faces: int) -> None:
    """pbrt's bumpy sphere, a third of it in short: no miss but at vertices, and none at all where `exact` is there."""
    rung, aimed, samples = "exact" if "exact" in JUDGED else "midpoint", 0, 0
    for case in itertools.islice(dense_bumpy_cases(), faces):
        for verdict in run_case(first_device, case, (rung,), ("3dr-binning",), with_ids=False, is_opaque=False):
            assert verdict.forbidden == 0, verdict
            aimed, samples = aimed + verdict.aimed_vertices, samples + verdict.samples
    assert aimed > 16_600 * faces and samples > 260_000 * faces


@pytest.mark.long
def test_hostile_inputs(device: Device, tmp_path: Path) -> None:
    """In short the tests of loaders and limits have them; here each in a process of its own, within a time."""
    found = list(run_inputs(tmp_path, device.runtime))
    assert [(one.name, fault) for one, fault in found if fault] == [] and len(found) > 9


@pytest.mark.long
@pytest.mark.parametrize("name", ["quads", "sheets", "aimed", "far", "small", "bumpy", "bumpy-large", "integer"])
def test_whole_suites(device: Device, tool, name: str) -> None:
    """Everything, on every runtime: PoCL by all methods, the others by three."""
    methods = tuple(METHOD_OPTIONS) if device.runtime == "pocl" else tool.SHORT_METHODS
    assert check(device, tool.SUITES[name](), JUDGED, methods) > 0


# --- that they can fail ----------------------------------------------------------------------------


def broken(device: Device, cases: list[Case]) -> int:
    found = (run_case(device, case, ("midpoint",), ("3dr-binning",), is_opaque=False) for case in cases)
    return sum(one.forbidden for verdicts in found for one in verdicts)


def test_a_plain_cross_product_is_caught(first_device: Device, tmp_path: Path) -> None:
    """In place of the midpoint form: the suite of small triangles far away is full of holes."""
    cases = short_cases()["small"]
    with patched(first_device, tmp_path, PLAIN) as faulty:
        assert broken(faulty, cases) > 1000
    assert broken(first_device, cases) == 0


@pytest.mark.long
def test_a_contracted_cross_product_is_caught(first_device: Device, tmp_path: Path) -> None:
    """It is not antisymmetric: quads and aimed sheets tear along their edges."""
    quads = [case for case in short_cases()["quads"] if case.view.projection == "perspective"]
    with patched(first_device, tmp_path, CONTRACTED) as faulty:
        assert broken(faulty, [aimed_sheet(1, 5, "perspective")]) > 100
        assert broken(faulty, quads) > 0


@pytest.mark.long
def test_a_wrong_fill_rule_is_caught(first_device: Device, tmp_path: Path) -> None:
    """Inclusive on all sides: samples on edges are hit twice, in piglit's exact triangles and in aimed sheets."""
    line = "  edge.exclusive = inclusive ? (int_v)(0) : (int_v)(1);\n"
    rule = {("edge_function.clh", line): "  edge.exclusive = inclusive ? (int_v)(0) : (int_v)(0);\n"}
    with patched(first_device, tmp_path, rule) as faulty:
        assert broken(faulty, list(itertools.islice(integer_cases(), 4))) > 100


# --- the tool --------------------------------------------------------------------------------------


def test_the_tool(
    first_device: Device, tool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    open_ = tool.open_device
    monkeypatch.setattr(tool, "open_device", lambda name: open_(name) if name else first_device)
    monkeypatch.setitem(tool.SUITES, "sheets", lambda: iter([sheet(0, 1, "perspective", 32)]))
    report = tmp_path / "report.json"
    arguments = ["--suite", "sheets", "--methods", "3dr-binning", "--precision", "midpoint", "--json", str(report)]
    assert tool.main(arguments) == 0
    (found,) = json.loads(report.read_text())
    assert found["samples"] == 1024 and found["forbidden"] == found["misses"] == found["doubles"] == 0
    assert "Vulkan sheets  midpoint  3dr-binning  1" in capsys.readouterr().out
    torn = Verdict("Vulkan sheets", "torn", "pocl", "3dr-binning", "midpoint", 1024, 0, 0, 3, 0, 0, 3, 0, 3)
    monkeypatch.setattr(tool, "run_case", lambda *given: iter([torn]))
    assert tool.main(arguments) == 1
    assert "BROKEN: 3" in capsys.readouterr().out
    assert tool.main([*arguments, "--device", "none such"]) == 69
    with pytest.raises(SystemExit, match="2"):
        tool.main(["--suite", "sheep"])


def test_a_folded_world_is_refused() -> None:
    """A `single` case whose sheet is folded proves nothing: an error, not a verdict."""
    case = sheet(0, 2, "perspective", 16)
    folded = case.scene.triangles.copy()
    folded[3] = folded[3][::-1]
    with pytest.raises(ValueError, match="sees a fold"):
        expect(Case("here", "folded", make_scene(case.scene.positions, folded), case.view, single=True))
    assert (expect(case).counts == 1).all() and NO_HIT not in expect(case).ids
