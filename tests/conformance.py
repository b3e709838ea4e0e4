"""Runs the suites of conformance_worlds.py: hits counted in integers at every sample, against real arithmetic.

    opaque   `id.prim` and `Z` as anyone renders them, against the exact visible triangle
    counted  all surfaces as BLEND of alpha 1/2: the alpha of a sample is 1 - 2^-n for n hits, exactly, so that one
             render counts every hit of every sample, hidden ones and double ones too

A miss is a sample with fewer hits than in real arithmetic, a double hit one with more. What is promised:

    exact             nothing missed, nothing hit twice, every `id.prim` right
    the other rungs   no miss and no double hit where one shared edge alone is within rounding; at vertices, on open
                      borders and at folds float32 promises nothing: counted, not forbidden
    midpoint, double  a wrong id is within the midpoint form's float32 error bound of an edge
    piglit            nothing is rounded: every rung is right
    3D edges          all methods give the same bits
    barycentric       its sums are no functions of one edge alone: neighbours disagree below `exact`, and are counted
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from conformance_worlds import Case
from exact_counts import exact_hit_counts, faces_one_way
from kernel_world import NO_HIT, render

from clrast.errors import UsageError
from clrast.opencl.device import Device
from clrast.opencl.features import Edges
from clrast.options import PRECISIONS
from clrast.scene.model import Material
from clrast.study.classify_visibility import Classifier
from clrast.study.exact_visibility import exact_visibility
from clrast.visibility.methods import METHODS

Options = Mapping[str, str]
METHOD_OPTIONS: Mapping[str, Options] = {
    **{name: {"method": name} for name in METHODS},
    "raycast-brute:barycentric": {"method": "raycast-brute", "intersection": "barycentric"},
    "3dr-binning:incremental": {"method": "3dr-binning", "evaluation": "incremental"},
}
"""Every method of the continuum, and the two that decide samples by other sums."""
REFERENCE = "3dr-binning"
BRUTE_LIMIT = 1 << 26
"""Triangles times samples beyond which methods that look at all of these pairs are left out."""
UNJUDGED_RUNGS = {"fixed": "its vertices are its own, on a grid of 1/4096 pixel"}
UNPROMISED_PLACES = ("vertex", "open", "silhouette", "sliver")
"""Of classify_visibility.py: where more than one shared edge is within rounding, or an edge that is not shared."""
MIDPOINT_RUNGS = ("midpoint", "double")
"""Whose wrong ids are all within the midpoint form's float32 error bound of an edge."""
HALF = (Material("half", (1.0, 1.0, 1.0, 0.5), alpha_mode="BLEND", unlit=True),)
EXAMINED = 2000
"""Wrong samples of a case whose place is looked up; the rest count as forbidden."""


@dataclass
class Expected:
    """What real arithmetic says of a case: ids (height, width) uint32 or None where only counts are asked, counts."""

    ids: np.ndarray | None
    counts: np.ndarray
    places: dict[tuple[int, int], str]


def expect(case: Case, with_ids: bool = True) -> Expected:
    """The exact answer. A `single` world is proven to be one; its counts then are a closed form.

    Raises ValueError where a world that should be one unfolded layer is not.
    """
    if case.known is not None:
        return Expected(*case.known, {})
    view, scene = case.view, case.scene
    given = scene.positions, scene.triangles, view.named()
    size = view.width, view.height
    if case.single:
        if not faces_one_way(*given):
            raise ValueError(f"{case.suite}, {case.name}: the eye sees a fold")
        counts = np.ones(size[::-1], dtype=np.int64)
    else:
        counts = exact_hit_counts(*given, *size)
    ids = exact_visibility(*given, *size).prim_id if with_ids else None
    if ids is not None and not ((ids != NO_HIT) == (counts > 0)).all():
        raise ValueError(f"{case.suite}, {case.name}: the references contradict each other")
    return Expected(ids, counts, {})


@dataclass(frozen=True)
class Image:
    """What a method made of a case: ids, the bits of Z, and hits at each sample."""

    ids: np.ndarray
    depth_bits: np.ndarray
    counts: np.ndarray


def make_image(device: Device, case: Case, options: Options, is_opaque: bool = True) -> Image:
    """Two renders: as it is, and with every surface half transparent; the latter alone where not `is_opaque`."""
    glass = replace(case.scene, materials=HALF, material_ids=np.zeros_like(case.scene.material_ids))
    with np.errstate(over="ignore", invalid="ignore"):
        frame = counted = render(device, glass, case.view, aov=("color", "id", "depth"), **options)
        if is_opaque:
            frame = render(device, case.scene, case.view, aov=("id", "depth"), **options)
    counts = -np.log2(1 - counted["A"].astype(np.float64))
    if not (counts == np.round(counts)).all():
        raise ValueError(f"{case.suite}, {case.name}: an alpha is not 1 - 2^-n")
    return Image(frame["id.prim"], frame["Z"].view(np.uint32), counts.astype(np.int64))


@dataclass(frozen=True)
class Verdict:
    """The figures of one case by one method; all are numbers of samples.

    aimed_vertices, aimed_edges : rays exactly on a vertex, on the middle of an edge. at_vertices : misses and double
    hits where float32 promises nothing; forbidden : the others, and all that differs where nothing may.
    wrong_ids : None where no exact ids were asked
    for. differing : from REFERENCE in `id.prim` or `Z`.
    """

    suite: str
    case: str
    runtime: str
    method: str
    rung: str
    samples: int
    aimed_vertices: int
    aimed_edges: int
    misses: int
    doubles: int
    at_vertices: int
    wrong_ids: int | None
    differing: int
    forbidden: int


def is_spatial(method: str) -> bool:
    """Whether a row of METHOD_OPTIONS has 3D edges, evaluated directly."""
    return ":" not in method and METHODS[method].edges == Edges.SPATIAL


def place_of(case: Case, expected: Expected, image: Image, at: tuple[int, int], judge: Classifier) -> str:
    """Where a wrong sample lies, by the triangle that is right, or else by the one that was given."""
    if at not in expected.places:
        column, row = at
        right = NO_HIT if expected.ids is None else int(expected.ids[row, column])
        blamed = int(image.ids[row, column]) if right == NO_HIT else right
        expected.places[at] = judge.place(blamed, column, row) if blamed != NO_HIT else "unknown"
    return expected.places[at]


def is_strict(case: Case, method: str, rung: str) -> bool:
    """Whether every sample must be right."""
    return rung == "exact" or (case.rounds_nothing and is_spatial(method))


def is_promised(case: Case, method: str, rung: str) -> bool:
    """Whether anything is promised of wrong counts."""
    barycentric = method.endswith("barycentric") and rung != "exact"
    return not barycentric and PRECISIONS.index(rung) >= PRECISIONS.index(case.least_rung)


def unexcused(case: Case, expected: Expected, image: Image, wrong: np.ndarray, places: tuple[str, ...]) -> int:
    """How many of the wrong samples, (height, width) bool, lie elsewhere than at `places`."""
    rows, columns = np.nonzero(wrong)
    if not len(rows):
        return 0
    classifier = Classifier(case.scene.positions, case.scene.triangles, case.view.named())
    found = list(zip(columns.tolist(), rows.tolist(), strict=True))
    known = [place_of(case, expected, image, at, classifier) for at in found[:EXAMINED]]
    return max(0, len(found) - EXAMINED) + sum(place not in places for place in known)


def judge(case: Case, expected: Expected, image: Image, reference: Image, labels: tuple[str, str, str]) -> Verdict:
    """labels : runtime, method, rung."""
    _, method, rung = labels
    wrong = image.counts != expected.counts
    other = np.zeros_like(wrong) if expected.ids is None else image.ids != expected.ids
    differing = int(((image.ids != reference.ids) | (image.depth_bits != reference.depth_bits)).sum())
    forbidden, wrong_count = 0, int(wrong.sum())
    if is_strict(case, method, rung):
        forbidden = int((wrong | other).sum())
    elif is_promised(case, method, rung):
        vertices = np.zeros_like(wrong)
        if case.vertices is not None:
            vertices[case.vertices[:, 1], case.vertices[:, 0]] = True
        forbidden = unexcused(case, expected, image, wrong & ~vertices, UNPROMISED_PLACES)
        if rung in MIDPOINT_RUNGS and is_spatial(method) and case.single and other.any():
            explained = (*UNPROMISED_PLACES, "edge")
            some = np.flatnonzero(other.ravel() & ~vertices.ravel())[:EXAMINED]
            forbidden += unexcused(case, expected, image, np.isin(np.arange(other.size), some).reshape(other.shape),
                                   explained)  # fmt: skip
    excused = max(0, wrong_count - forbidden)
    forbidden += differing if is_spatial(method) else 0
    return Verdict(
        case.suite, case.name, *labels, wrong.size,
        0 if case.vertices is None else len(case.vertices), 0 if case.edges is None else len(case.edges),
        int((image.counts < expected.counts).sum()), int((image.counts > expected.counts).sum()),
        excused, None if expected.ids is None else int(other.sum()), differing, forbidden,
    )  # fmt: skip


def run_case(
    device: Device,
    case: Case,
    rungs: tuple[str, ...],
    methods: tuple[str, ...],
    with_ids: bool = True,
    is_opaque: bool = True,
) -> Iterator[Verdict]:
    """Every method and rung that the program accepts and the device can; the others yield nothing.

    with_ids : off, only hits are counted. is_opaque : off, ids are those of the nearest transparent surface.
    """
    expected = expect(case, with_ids)
    pairs = case.scene.triangle_count * case.view.width * case.view.height
    for rung in rungs:
        if rung == "double" and not device.has_fp64:
            continue
        reference = make_image(device, case, {"method": REFERENCE, "precision": rung}, is_opaque)
        for method in methods:
            if METHODS[method.split(":")[0]].is_brute and pairs > BRUTE_LIMIT:
                continue
            try:
                options = {**METHOD_OPTIONS[method], "precision": rung}
                image = reference if method == REFERENCE else make_image(device, case, options, is_opaque)
            except UsageError:  # the rung is not one of this method's
                continue
            yield judge(case, expected, image, reference, (device.runtime, method, rung))
