"""What is wrong in a rendered id image, against the exact answer: each differing sample by kind and place.

Kind, from the triangle that is right and the one that was given:
    neighbour  the two share an edge, and the sample is within float32 rounding of it
    fan        they share only a vertex, and the sample is within rounding of two edges that meet there
    hole       nothing was given, though something is hit
    tie        another surface at exactly the same depth, with a greater id
    farther    a surface behind the right one
    phantom    something where nothing is hit, or a surface before the right one

Place, from the edges (of the right triangle; of the given one for a phantom) within rounding of the sample:
    edge       one edge, and a triangle on the other side of it as seen from the eye: a crack, or a double hit
    sliver     the same, but the triangle on the other side is itself thinner than rounding there
    vertex     two edges or three
    silhouette one edge, all its other triangles lie on the same side: a fold of the surface
    open       one edge that no other triangle has
    depth      no edge is to blame: the given triangle is hit too, and the depths agree within rounding
    elsewhere  none of these: not explained by rounding at all

'Within rounding' is |V_i| <= the bound in float32_bounds.py, V_i taken exactly.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from math import isqrt

import numpy as np

from clrast.study.exact_visibility import NO_HIT, ExactVisibility
from clrast.study.float32_bounds import Float32Bounds
from clrast.study.linear_forms import IntegerForms
from clrast.study.mesh_topology import Topology

LIMIT = 50_000
WRONG_KINDS = ("fan", "tie", "hole", "farther", "phantom", "unexamined")


@dataclass(frozen=True)
class Difference:
    """One wrong sample. `edge_pixels`: distance to the nearest edge line of the triangle that `place` speaks of.

    x, y : column and row of the pixel; t_ratio : plane depth of the given triangle over the right depth, 0 if unknown
    """

    x: int
    y: int
    right: int
    given: int
    kind: str
    place: str
    edge_pixels: float
    t_ratio: float = 0.0


@dataclass(frozen=True)
class Classification:
    """All differences of a frame, and the depth where the ids agree."""

    sample_count: int
    hit_count: int
    differences: tuple[Difference, ...]
    depth_error: float
    depth_worst: tuple[int, int] | None
    counts: Mapping[tuple[str, str], int] = field(default_factory=dict)

    @property
    def right_count(self) -> int:
        return self.sample_count - sum(self.counts.values())

    def count(self, *kinds: str, place: str | None = None) -> int:
        """Samples of some kinds, in one place or all."""
        return sum(n for (kind, where), n in self.counts.items() if kind in kinds and place in (None, where))

    @property
    def neighbour_count(self) -> int:
        return self.count("neighbour")

    @property
    def hole_along_edge_count(self) -> int:
        return self.count("hole", "farther", place="edge")

    @property
    def wrong_surface_count(self) -> int:
        """Everything that is not a neighbour across an edge within rounding."""
        return self.count(*WRONG_KINDS)


class Classifier:
    """Judges samples of one view of one scene."""

    def __init__(
        self, positions: np.ndarray, triangles: np.ndarray, camera_vectors: Mapping[str, Sequence[float]]
    ) -> None:
        self.exact = IntegerForms(np.asarray(positions, dtype=np.float32), np.asarray(triangles), camera_vectors)
        self.bounds = Float32Bounds(camera_vectors)
        self.topology = Topology(positions, triangles)
        self.positions, self.triangles = np.asarray(positions, dtype=np.float64), np.asarray(triangles)
        self.known: dict[tuple[int, int, int, int], Difference] = {}

    def corners(self, prim_id: int) -> np.ndarray:
        return self.positions[self.triangles[prim_id].astype(np.int64)]

    def edge_distances(self, prim_id: int, i: int, j: int) -> list[tuple[float, float, bool]]:
        """Per edge: |V_i| over its float32 bound, distance to the edge's line in pixels, within rounding."""
        found = []
        for edge, (a, b, c) in enumerate(self.exact.of(prim_id)[0]):
            value = abs(a + b * (2 * i + 1) + c * (2 * j + 1))
            # The integer form is V_i times 2^shift, in steps of half a pixel.
            shift = 2 * self.exact.length_bits + self.exact.ray_bits + 1
            bound = self.bounds.edge(self.corners(prim_id), edge, i + 0.5, j + 0.5)
            slope = isqrt(b * b + c * c)
            relative = float(Fraction(value, 1 << shift) / Fraction(bound))
            found.append((relative, value / (2 * slope) if slope else float("inf"), relative <= 1.0))
        return found

    def near_edges(self, prim_id: int, i: int, j: int) -> list[int]:
        """The edges of a triangle within float32 rounding of a sample."""
        return [edge for edge, (_, _, is_near) in enumerate(self.edge_distances(prim_id, i, j)) if is_near]

    def is_across(self, prim_id: int, edge: int, other: int, other_edge: int) -> bool:
        """Whether the eye sees two triangles on different sides of the edge that they share."""
        facing, other_facing = self.exact.of(prim_id)[1], self.exact.of(other)[1]
        if facing == 0 or other_facing == 0:
            return False
        places = self.topology.places
        runs_alike = places[prim_id, (edge + 1) % 3] == places[other, (other_edge + 1) % 3]
        return runs_alike != ((facing > 0) == (other_facing > 0))

    def place(self, prim_id: int, i: int, j: int) -> str:
        """Where on a triangle a sample lies, as far as rounding can tell."""
        near = self.near_edges(prim_id, i, j)
        if len(near) != 1:
            return "vertex" if near else "elsewhere"
        others = self.topology.across(prim_id, near[0])
        if not others:
            return "open"
        beyond = [other for other, edge in others if self.is_across(prim_id, near[0], other, edge)]
        if not beyond:
            return "silhouette"
        return "sliver" if any(len(self.near_edges(other, i, j)) > 1 for other in beyond) else "edge"

    def is_neighbour(self, right: int, given: int, i: int, j: int) -> str | None:
        """'neighbour', 'fan', or None."""
        near, shared = self.near_edges(right, i, j), self.topology.shared_edge(right, given)
        if shared is not None and shared in near:
            return "neighbour"
        # Edge k is opposite vertex k, so two near edges meet at any vertex that is not opposite one of the two.
        meets = [k for k in self.topology.shared_places(right, given) if len(set(near) - {k}) == 2]
        return "fan" if meets else None

    def depth_ratio(self, right: int, given: int, i: int, j: int) -> float:
        """Plane depth of the given triangle over that of the right one, 1 only if equal; 0 where behind the eye."""
        over, under = self.exact.depth_ratio(given, i, j), self.exact.depth_ratio(right, i, j)
        if over is None or under is None or over[0] <= 0 or under[0] <= 0:
            return 0.0
        ratio = self.exact.t(over) / self.exact.t(under)
        nearest = float(ratio)
        return nearest if nearest != 1 or ratio == 1 else float(np.nextafter(1.0, 2.0 if ratio > 1 else 0.0))

    def judge(self, right: int, given: int, i: int, j: int) -> Difference:
        """Kind and place of one wrong sample; kept for the next image of the view."""
        key = (right, given, i, j)
        if key not in self.known:
            self.known[key] = self._judge(*key)
        return self.known[key]

    def _judge(self, right: int, given: int, i: int, j: int) -> Difference:
        blamed = given if right == NO_HIT else right
        ratio = 0.0
        if right == NO_HIT:
            kind, place = "phantom", self.place(given, i, j)
        elif given == NO_HIT:
            kind, place = "hole", self.place(right, i, j)
        else:
            ratio = self.depth_ratio(right, given, i, j)
            is_also_hit = self.exact.covers(given, i, j)
            kind = "farther" if ratio >= 1 else "phantom"
            kind = "tie" if is_also_hit and ratio == 1 else self.is_neighbour(right, given, i, j) or kind
            blamed = given if kind == "phantom" else right
            place = self.place(blamed, i, j)
            if kind in ("tie", "farther") and is_also_hit and self.is_depth_rounding(right, given, ratio, i, j):
                place = "depth"
        pixels = min(distance for _, distance, _ in self.edge_distances(blamed, i, j))
        return Difference(i, j, right, given, kind, place, pixels, ratio)

    def is_depth_rounding(self, right: int, given: int, ratio: float, i: int, j: int) -> bool:
        """Whether float32 may take two depths at a sample for each other."""
        bound = sum(self.bounds.relative_depth(self.corners(k), i + 0.5, j + 0.5) for k in (right, given))
        return abs(ratio - 1) <= bound


def classify(
    positions: np.ndarray,
    triangles: np.ndarray,
    camera_vectors: Mapping[str, Sequence[float]],
    exact: ExactVisibility,
    prim_id: np.ndarray,
    depth: np.ndarray | None = None,
    limit: int = LIMIT,
    classifier: Classifier | None = None,
) -> Classification:
    """Compare a rendered frame with the exact answer.

    prim_id : (height, width) uint32; depth : (height, width) float32 `Z`, or None. Beyond `limit` wrong samples
    the rest are counted as ('unexamined', 'unexamined'). classifier : of the same scene and view, if there is one.
    """
    given = np.asarray(prim_id)
    if given.shape != exact.prim_id.shape:
        raise ValueError(f"the image is {given.shape}, the exact answer {exact.prim_id.shape}")
    rows, columns = np.nonzero(given != exact.prim_id)
    classifier = classifier or Classifier(positions, triangles, camera_vectors)
    differences = []
    for j, i in list(zip(rows.tolist(), columns.tolist(), strict=True))[:limit]:
        right, got = int(exact.prim_id[j, i]), int(given[j, i])
        if got != NO_HIT and got >= len(classifier.triangles):
            differences.append(Difference(i, j, right, got, "phantom", "elsewhere", float("inf")))
        else:
            differences.append(classifier.judge(right, got, i, j))
    counts = Counter((one.kind, one.place) for one in differences)
    if len(rows) > limit:
        counts["unexamined", "unexamined"] = len(rows) - limit
    depth_error, worst = (0.0, None) if depth is None else depth_errors(exact, given, depth)
    hit_count = int((exact.prim_id != NO_HIT).sum())
    return Classification(given.size, hit_count, tuple(differences), depth_error, worst, dict(counts))


def depth_errors(
    exact: ExactVisibility, prim_id: np.ndarray, depth: np.ndarray
) -> tuple[float, tuple[int, int] | None]:
    """Largest |Z / t - 1| where the ids agree, and its (column, row); inf where Z is NaN, or not +inf at no hit."""
    error = np.zeros(prim_id.shape)
    agree = prim_id == exact.prim_id
    hit = agree & (exact.prim_id != NO_HIT)
    error[hit] = abs(depth[hit].astype(np.float64) / exact.t[hit] - 1)
    error[agree & ~hit & (depth != np.inf)] = np.inf
    error[np.isnan(error)] = np.inf
    row, column = np.unravel_index(int(error.argmax()), error.shape)
    return float(error[row, column]), (int(column), int(row)) if error[row, column] > 0 else None
