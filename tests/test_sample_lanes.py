"""Samples of listed pixels by lanes: the same bits as passes over the whole band; what is skipped is counted."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import open_first_device
from kernel_world import orthographic, render
from small_renders import LAMPS
from test_antialiasing import SIDE, some_triangles

import clrast
from clrast.job import RenderJob
from clrast.opencl import buffers
from clrast.opencl.constants import VISIT_SAMPLES
from clrast.opencl.device import Device
from clrast.opencl.layout import NO_HIT
from clrast.options import RenderOptions
from clrast.scene.camera import camera_vectors, frame_scene
from clrast.shading.effects import plan_effects
from clrast.shading.rounds import rounds_of
from clrast.visibility.listed_samples import ListedSamples
from clrast.visibility.sample_patterns import CENTER, parse_antialiasing, scrambled

SIZE = (75, 70)  # sticks out of tiles and squares
PATTERN = scrambled(256).positions


@pytest.fixture(scope="module")
def lamps(tmp_path_factory: pytest.TempPathFactory) -> clrast.Scene:
    path = tmp_path_factory.mktemp("cards") / "lamps.toml"
    path.write_text(LAMPS)
    return clrast.load(path)


def start(device: Device, scene: clrast.Scene, **more: object) -> RenderJob:
    given = RenderOptions(size=SIZE, method="3dr-binning", **more)  # type: ignore[arg-type]
    vectors = camera_vectors(frame_scene(scene, *SIZE), *SIZE)
    job = RenderJob(device, scene, vectors, given, plan_effects(scene, given.aov, given.effects))
    job._frame_times = {}
    job.sample_passes.set_up(PATTERN)
    job.sample_passes.start_band(0, int(job.view["tile_rows"]))
    return job


def by_passes(job: RenderJob, visit: int) -> np.ndarray:
    """(pixels, VISIT_SAMPLES) prim_ids of a visit's samples."""
    found = []
    for position in PATTERN[VISIT_SAMPLES * visit : VISIT_SAMPLES * (visit + 1)]:
        job.sample_passes.decide((position,))
        found.append(buffers.download(job.device, job.tiles.visible_prims, np.uint32, SIZE[0] * SIZE[1]))
    return np.stack(found, axis=1)


@pytest.mark.parametrize(("share", "visits"), [(1.0, (3,)), (0.3, (0, 7, 2, 3, 9)), (0.002, (1, 2))])
def test_lanes_decide_as_passes_do(
    device: Device, lamps: clrast.Scene, share: float, visits: tuple[int, ...]
) -> None:  # fmt: skip
    """Whatever is guessed to be seen: nothing, all, or by chance."""
    job, count = start(device, lamps), SIZE[0] * SIZE[1]
    if not job.tiles.takes_samples:
        assert device.vector_width == 1 or job.features.keep_nearness
        return
    listed = np.nonzero(np.random.default_rng(5).random(count) < share)[0].astype(np.uint32)
    places = np.full(count, NO_HIT, dtype=np.uint32)
    places[listed] = np.arange(len(listed))
    guess = np.random.default_rng(7).integers(0, 2000, count, dtype=np.uint32)
    guess[: count // 2] = NO_HIT
    samples = ListedSamples(device, job.features, PATTERN)
    found = buffers.create(device, 4 * len(visits) * VISIT_SAMPLES * len(listed))
    lists = buffers.upload(device, places), buffers.upload(device, listed)
    samples.decide(job.sample_passes, visits, len(listed), buffers.upload(device, guess), found, *lists)
    assert job.sample_passes.visits == len(visits)
    assert job.sample_passes.listed == len(visits) * VISIT_SAMPLES * len(listed)
    shape = len(listed), len(visits) * VISIT_SAMPLES
    expected = np.concatenate([by_passes(job, visit)[listed] for visit in visits], axis=1)
    np.testing.assert_array_equal(buffers.download(device, found, np.uint32, shape), expected)
    assert len(np.unique(expected)) > (1 if share < 0.01 else 3)


def test_all_pixels_say_where_samples_differ(device: Device, lamps: clrast.Scene) -> None:
    job, count = start(device, lamps), SIZE[0] * SIZE[1]
    expected = by_passes(job, 0)
    job.sample_passes.decide((CENTER,))
    center = buffers.download(device, job.tiles.visible_prims, np.uint32, count)
    kept = buffers.upload(device, center)
    differs, found = buffers.create(device, count), buffers.create(device, 4 * VISIT_SAMPLES * count)
    ListedSamples(device, job.features, PATTERN).decide_all(job.sample_passes, (0,), count, kept, differs, found)
    where = buffers.download(device, differs, np.uint8, count) != 0
    np.testing.assert_array_equal(where, (expected != center[:, None]).any(axis=1))
    assert 0.01 < where.mean() < 0.9
    prims = buffers.download(device, found, np.uint32, (count, VISIT_SAMPLES))
    np.testing.assert_array_equal(prims[where], expected[where])


def test_what_is_not_listed_costs_nothing(lamps: clrast.Scene) -> None:
    """Counted: no pixel beside the list was evaluated, and a square without a listed pixel set nothing up."""
    device = open_first_device()
    job, count = start(device, lamps, counters=True), SIZE[0] * SIZE[1]
    assert job.tiles.takes_samples and job.work is not None
    samples = ListedSamples(device, job.features, PATTERN)
    found = buffers.create(device, 4 * VISIT_SAMPLES * count)
    guess = buffers.upload(device, np.full(count, NO_HIT, dtype=np.uint32))
    places = np.full(count, NO_HIT, dtype=np.uint32)
    done = []
    for listed in ([], [37 * SIZE[0] + 33], list(range(count))):
        places[:] = NO_HIT
        places[listed] = np.arange(len(listed))
        job.work.clear()
        job.work.clear_cost()
        lists = buffers.upload(device, places), buffers.upload(device, np.array(listed, dtype=np.uint32))
        samples.decide(job.sample_passes, (0,), len(listed), guess, found, *lists)
        work = job.work.collect()
        cost = buffers.download(device, job.work.cost, np.uint32, count)
        assert not cost[places == NO_HIT].any()
        assert int(cost.sum()) == work["samples_tested"]
        done.append(work)
    assert not any(done[0].values())
    assert 0 < done[1]["setups"] < done[2]["setups"] / 8
    assert 0 < done[1]["samples_tested"] < done[2]["samples_tested"] / 256


def test_rounds_look_at_each_sample_once_and_shade_a_quarter() -> None:
    rounds = rounds_of(parse_antialiasing("--aa", "auto:0.1"))
    assert rounds.positions == PATTERN and not rounds.uses_center
    seen: list[int] = []
    shaded: list[int] = []
    for number in range(5):
        for visit in rounds.visits(number):
            samples = [VISIT_SAMPLES * visit.number + k for k in range(VISIT_SAMPLES)]
            seen += samples if visit.is_new else []
            shaded += [k for k in samples if visit.shaded >> (k - samples[0]) & 1]
            assert visit.lanes == 0xFFFF
        assert seen == list(range(16 << number)) and shaded == list(range(4 << number))


@pytest.mark.parametrize("change", [{"method": "3dr-full"}, {"precision": "exact"}, {"counters": True}])
@pytest.mark.parametrize(
    "mode",
    [
        {"aa": "auto:0.02"}, {"aa": "csaa:4+8", "shading_rate": "auto:0.02"}, {"aa": "msaa:32"},
        {"aa": "csaa:16+8", "filter": "tent"},
    ],
    ids=str,
)  # fmt: skip
def test_lists_are_the_same_by_lanes_and_by_passes(mode: dict[str, object], change: dict[str, object]) -> None:
    """Methods and rungs that have no lanes for lists decide whole bands; short numbers, where float32 is exact too."""
    device = open_first_device()
    scene, view = some_triangles(), orthographic(SIDE, SIDE)
    given = {"aov": ("color", "id"), "method": "3dr-binning", **mode}
    expected, found = (render(device, scene, view, **each) for each in (given, {**given, **change}))
    for name in ("R", "G", "B", "A", "id.prim"):
        np.testing.assert_array_equal(found[name], expected[name])
