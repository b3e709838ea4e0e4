"""How many triangles each sample meets in real arithmetic, hidden ones too: the count that no double hit may exceed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from clrast.study.exact_visibility import covered_pairs, facing_boxes, facing_signs
from clrast.study.linear_forms import IntegerForms, float_forms


def exact_hit_counts(
    positions: np.ndarray,
    triangles: np.ndarray,
    camera_vectors: Mapping[str, Sequence[float]],
    width: int,
    height: int,
) -> np.ndarray:
    """(height, width) int64: triangles that cover the sample before the eye; float64 with proof, else integers."""
    boxes, forms, exact = facing_boxes(positions, triangles, camera_vectors, width, height)
    counts = np.zeros(width * height, dtype=np.int64)
    for chunk in boxes.chunks():
        pairs = covered_pairs(chunk, forms, width)
        sure = pairs.is_sure & (pairs.w_low > 0)
        np.add.at(counts, pairs.sample[sure], 1)
        for sample, triangle in zip(pairs.sample[~sure].tolist(), pairs.triangle[~sure].tolist(), strict=True):
            at = sample % width, sample // width
            ratio = exact.depth_ratio(triangle, *at)
            if ratio is not None and ratio[0] > 0 and exact.covers(triangle, *at):
                counts[sample] += 1
    return counts.reshape(height, width)


def faces_one_way(positions: np.ndarray, triangles: np.ndarray, camera_vectors: Mapping[str, Sequence[float]]) -> bool:
    """Whether the eye sees all triangles from the same side, exactly: of a closed fan or sheet then, none is folded."""
    positions, triangles = np.asarray(positions, dtype=np.float32), np.asarray(triangles)
    corners = positions.astype(np.float64)[triangles.astype(np.int64)]
    forms = float_forms(corners, camera_vectors, 1, 1)
    exact = IntegerForms(positions, triangles, camera_vectors)
    signs = facing_signs(forms, exact, np.arange(len(triangles)))
    return abs(int(signs.sum())) == len(triangles)
