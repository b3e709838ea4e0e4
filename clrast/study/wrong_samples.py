"""The wrong samples of an image by kind, against the exact answer:

    hole            nothing, or a surface behind, along an edge that two triangles share
    double hit      both triangles of a shared edge cover it, as parts of the scene rendered alone show
    wrong neighbour the triangle on the other side of a shared edge
    vertex          anything within rounding of two edges or three: round a vertex, or in a sliver
    unexplained     no rounding of an edge function or a depth explains it: as where a whole triangle is lost
    other           another surface of nearly equal depth, or a silhouette or a border missed by rounding
    Z               not the triangle is wrong but its depth, by more than a float32 step

classify_visibility.py tells more places apart; here are those that people ask about.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from clrast.scene.model import Scene
from clrast.study.classify_visibility import Classifier, Difference, classify
from clrast.study.exact_visibility import NO_HIT, ExactVisibility

KINDS = ("hole", "double hit", "wrong neighbour", "vertex", "unexplained", "other", "Z")
DEPTH = "Z"
VISIBLE = tuple(kind for kind in KINDS if kind != DEPTH)
"""Kinds of samples that show the wrong triangle."""


def judge(
    scene: Scene,
    vectors: Mapping[str, Sequence[float]],
    exact: ExactVisibility,
    prim_id: np.ndarray,
    depth: np.ndarray,
    twice: Iterable[tuple[int, int, str]] = (),
    classifier: Classifier | None = None,
) -> tuple[np.ndarray, dict[tuple[str, str], int]]:
    """(height, width) uint8, 0 where a sample is right, else 1 + the place in KINDS; and (kind, place) -> samples.

    twice : (x, y, place) of double hits. classifier : of the same scene and view, if there is one.
    """
    kinds = np.zeros(prim_id.shape, dtype=np.uint8)
    details: Counter[tuple[str, str]] = Counter()
    wrong_depth = is_depth_wrong(exact, prim_id, depth)
    kinds[wrong_depth] = 1 + KINDS.index(DEPTH)
    if wrong_depth.any():
        details["right", DEPTH] = int(wrong_depth.sum())
    judged = classify(scene.positions, scene.triangles, vectors, exact, prim_id, classifier=classifier)
    details.update(judged.counts)
    kinds[prim_id != exact.prim_id] = 1 + KINDS.index("other")
    for one in judged.differences:
        kinds[one.y, one.x] = 1 + KINDS.index(kind_of(one))
    for x, y, place in twice:
        details["double", place] += 1
        kind = "vertex" if place == "vertex" else "double hit"
        if kinds[y, x] != 1 + KINDS.index("hole"):
            kinds[y, x] = 1 + KINDS.index(kind)
    return kinds, dict(details)


def kind_of(one: Difference) -> str:
    """The kind of a sample that shows the wrong triangle."""
    if one.kind == "neighbour":
        return "wrong neighbour"
    if one.kind == "fan" or one.place in ("vertex", "sliver"):
        return "vertex"
    if one.place == "elsewhere":
        return "unexplained"
    return "hole" if one.kind in ("hole", "farther") and one.place == "edge" else "other"


def is_depth_wrong(exact: ExactVisibility, prim_id: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """(height, width) bool: the right triangle, or rightly none, at a depth more than a float32 step from the exact."""
    agree = prim_id == exact.prim_id
    with np.errstate(over="ignore"):
        nearest = exact.t.astype(np.float32)
    with np.errstate(invalid="ignore"):
        is_near = abs(depth.astype(np.float64) - exact.t) <= np.spacing(abs(nearest)).astype(np.float64)
    return agree & ~(is_near | (depth == nearest)) | agree & (exact.prim_id == NO_HIT) & (depth != np.inf)
