"""tools/check_projections.py as a program: bars, kinds of wrong samples, and the exact answer that it goes by."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from curved_reference import exact_image, exact_image_by_blocks
from curved_world import CURVED, aimed_sheet, curved_view, soup_in_box
from kernel_world import NO_HIT

from clrast.visibility.sample_generator import sample_rays

TOOL = Path(__file__).resolve().parents[1] / "tools" / "check_projections.py"


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    spec = importlib.util.spec_from_file_location("check_projections", TOOL)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["check_projections"] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("projection", CURVED)
def test_blocks_leave_nothing_out(projection: str) -> None:
    """The answer by blocks is that of every triangle at every sample: loose triangles, and samples at corners."""
    view = curved_view(projection, 41, 35)
    x, y = np.arange(41)[None] + 0.5, np.arange(35)[:, None] + 0.5
    rays = sample_rays(view, x, y)
    for scene in (soup_in_box(), aimed_sheet(view)):
        given = (scene.positions, scene.triangles, np.array(view.origin), rays.d, rays.tx, rays.ty)
        prim_id, _, t, _ = exact_image(*given)
        found, times = exact_image_by_blocks(*given)
        assert (found == prim_id).all() and (prim_id != NO_HIT).any()
        np.testing.assert_allclose(times, t, rtol=1e-12)  # sums of three products in another order


@pytest.fixture
def box_file(tmp_path: Path) -> str:
    """A closed mesh round the eye as OFF: a box out of shape, so that no ray is aimed at an edge."""
    corners = [(x + 0.3 * y * z, y + 0.2 * x, z + 0.1 * x * y) for x in (-1, 1.5) for y in (-0.7, 1) for z in (-2, 2.3)]
    faces = [(0, 2, 1), (1, 2, 3), (4, 5, 6), (5, 7, 6), (0, 1, 4), (1, 5, 4), (2, 6, 3), (3, 6, 7), (0, 4, 2),
             (2, 4, 6), (1, 3, 5), (3, 7, 5)]  # fmt: skip
    rows = [" ".join(map(str, c)) for c in corners] + [f"3 {a} {b} {c}" for a, b, c in faces]
    (tmp_path / "box.off").write_text("\n".join(["OFF", "8 12 0", *rows]) + "\n")
    return str(tmp_path / "box.off")


def test_what_is_right_passes(tool: ModuleType, box_file: str, capsys: pytest.CaptureFixture[str]) -> None:
    given = [box_file, "--size", "32", "--precision", "midpoint", "--projections", "paraboloid:incremental,cube"]
    assert tool.main(given) == 0
    rows = capsys.readouterr().out.splitlines()
    assert len(rows) == 3 and all("ok     wrong 0; double hits 0" in row for row in rows[:2])


@pytest.mark.parametrize(
    ("fault", "said"), [("hole", "1 other"), ("neighbour", "1 neighbour"), ("twice", "double hits [1-9]")]
)
def test_faults_are_found(
    tool: ModuleType, box_file: str, fault: str, said: str, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """One sample of an image changed: nothing in the middle of a triangle, its neighbour, or both of them."""
    honest = tool.render_ids

    def faulty(scene: object, view: object, precision: str) -> dict[str, np.ndarray]:
        channels = honest(scene, view, precision)
        ids = channels["id.prim"].copy()
        is_part = scene.triangle_count < 12  # type: ignore[attr-defined]
        if fault == "twice" and is_part and (ids != NO_HIT).any():
            ids[:] = ids[ids != NO_HIT][0]  # what is seen of a part is seen everywhere
        elif fault != "twice" and not is_part:
            ids[16, 16] = NO_HIT if fault == "hole" else ids[16, 16] ^ 1
        return {**channels, "id.prim": ids}

    monkeypatch.setattr(tool, "render_ids", faulty)
    given = [box_file, "--size", "32", "--precision", "midpoint", "--projections", "paraboloid"]
    assert tool.main(given) == 1
    row = capsys.readouterr().out.splitlines()[0]
    assert "BROKEN" in row and re.search(said, row), row


def test_no_scene_is_an_exit_of_its_own(tool: ModuleType, tmp_path: Path) -> None:
    assert tool.main([str(tmp_path / "none.ply")]) == 66
