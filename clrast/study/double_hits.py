"""Double hits, which an id image hides: found from outside, by rendering parts of a scene alone.

Two triangles that share an edge, seen on different sides of it, can never both cover a sample. So the triangles are
coloured such that edge neighbours differ, each colour is rendered as a scene of its own with the same camera, and
a sample at which two colours show such neighbours is a double hit. (What hides behind another triangle of its own
colour is not seen.) For small scenes `hit_counts` renders every triangle alone and hides nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import combinations

import numpy as np

from clrast.study.classify_visibility import Classifier, Difference
from clrast.study.exact_visibility import NO_HIT

RenderIds = Callable[[np.ndarray], np.ndarray]
"""Takes chosen prim_ids (ascending) and returns the id image of that part, numbered from 0 within the part."""


def render_part(render: RenderIds, chosen: np.ndarray) -> np.ndarray:
    """The id image of a part of the scene, with the prim_ids of the whole."""
    image = np.asarray(render(chosen)).astype(np.int64)
    return np.where(image == NO_HIT, NO_HIT, np.append(chosen, NO_HIT)[np.minimum(image, len(chosen))])


def hit_counts(render: RenderIds, triangle_count: int) -> np.ndarray:
    """(height, width) int64: how many triangles cover each sample when each is rendered alone."""
    images = [render_part(render, np.array([k])) != NO_HIT for k in range(triangle_count)]
    return np.stack(images).sum(axis=0)


def double_hits(
    render: RenderIds,
    positions: np.ndarray,
    triangles: np.ndarray,
    camera_vectors: Mapping[str, Sequence[float]],
    classifier: Classifier | None = None,
) -> list[Difference]:
    """Samples that two edge neighbours both cover though the eye sees them on different sides of their edge.

    Each is a Difference of kind 'double' with `right` and `given` the two triangles; place 'edge' (only the shared
    edge is within rounding: forbidden), 'vertex' (another edge of either is too) or 'elsewhere'.
    classifier : of the same scene and view, if there is one.
    """
    classifier = classifier or Classifier(positions, triangles, camera_vectors)
    colours = classifier.topology.colours()
    images = [render_part(render, np.flatnonzero(colours == colour)) for colour in range(colours.max() + 1)]
    found: list[Difference] = []
    known: dict[tuple[int, int], tuple[int, int] | None] = {}
    for first, second in combinations(images, 2):
        rows, columns = np.nonzero((first != NO_HIT) & (second != NO_HIT))
        a, b = first[rows, columns], second[rows, columns]
        shares = (classifier.topology.places[a][:, :, None] == classifier.topology.places[b][:, None, :]).sum((1, 2))
        for k in np.flatnonzero(shares >= 2).tolist():
            pair, at = (int(a[k]), int(b[k])), (int(columns[k]), int(rows[k]))
            if pair not in known:
                known[pair] = unfolded_edge(classifier, *pair)
            edges = known[pair]
            if edges is not None:
                found.append(describe(classifier, pair, edges, at))
    return found


def unfolded_edge(classifier: Classifier, one: int, other: int) -> tuple[int, int] | None:
    """(edge of one, edge of other) that they share and lie on different sides of, or None."""
    for edge in range(3):
        for k, other_edge in classifier.topology.across(one, edge):
            if k == other and classifier.is_across(one, edge, other, other_edge):
                return edge, other_edge
    return None


def describe(
    classifier: Classifier, pair: tuple[int, int], edges: tuple[int, int], at: tuple[int, int]
) -> Difference:
    """The double hit as a Difference."""
    near = [set(classifier.near_edges(prim_id, *at)) for prim_id in pair]
    others = any(found - {edge} for found, edge in zip(near, edges, strict=True))
    place = "vertex" if others else ("edge" if edges[0] in near[0] else "elsewhere")
    return Difference(*at, *pair, "double", place, classifier.edge_distances(pair[0], *at)[edges[0]][1])
