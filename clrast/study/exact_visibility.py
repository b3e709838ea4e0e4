"""The exact visible triangle of every sample of a real scene, in seconds: float64 with proof, integers for the rest.

    boxes   of samples that a triangle can reach: projected with an error margin; the whole image where it
            crosses the eye's plane; nothing where it is surely behind
    blocks  of 128 and 16 samples a side: kept unless one edge function is surely negative over all of the block
    pairs   (sample, triangle): kept unless an edge function is surely negative; w = 1/t as an interval
    answer  a sample with one possible triangle, surely covered, is settled; the others go to Python integers

Every rejection is by a bound that is proven in linear_forms.py, so the result is the answer in real arithmetic
for the float32 inputs, the smaller prim_id where two w are equal. Shares nothing with the kernels.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from clrast.study.linear_forms import BOUND_64, FloatForms, IntegerForms, cross, dot, float_forms

NO_HIT = 4294967295
BLOCK_SIDES = (128, 16)
PAIRS_PER_CHUNK = 1 << 21
T_ERROR_LIMIT = 1e-12


@dataclass(frozen=True)
class ExactVisibility:
    """What each sample sees.

    prim_id : (height, width) uint32, NO_HIT where nothing is hit
    t : (height, width) float64, within 1e-12 relative of the exact t, +inf where nothing is hit
    contested_count : samples that float64 could not settle and integers did
    pair_count : (sample, triangle) pairs that were looked at
    """

    prim_id: np.ndarray
    t: np.ndarray
    contested_count: int
    pair_count: int


@dataclass
class Boxes:
    """Rectangles of samples [x0, x1) x [y0, y1), each for one triangle; all arrays (box_count,) int64."""

    triangle: np.ndarray
    x0: np.ndarray
    x1: np.ndarray
    y0: np.ndarray
    y1: np.ndarray

    def __getitem__(self, chosen: np.ndarray | slice) -> Boxes:
        return Boxes(self.triangle[chosen], self.x0[chosen], self.x1[chosen], self.y0[chosen], self.y1[chosen])

    def area(self) -> np.ndarray:
        return (self.x1 - self.x0) * (self.y1 - self.y0)

    def chunks(self) -> Iterator[Boxes]:
        """The boxes in pieces of about PAIRS_PER_CHUNK samples."""
        ends = np.cumsum(self.area())
        cuts = np.searchsorted(ends, np.arange(PAIRS_PER_CHUNK, ends[-1] if len(ends) else 0, PAIRS_PER_CHUNK))
        for chosen in np.split(np.arange(len(self.triangle)), cuts):
            yield self[chosen]

    @staticmethod
    def join(parts: Sequence[Boxes]) -> Boxes:
        names = ("triangle", "x0", "x1", "y0", "y1")
        return Boxes(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def screen_boxes(
    corners: np.ndarray, camera: Mapping[str, Sequence[float]], width: int, height: int, margin: float = 1e-9
) -> Boxes:
    """Per triangle a box that surely holds every sample it covers; triangles that cover none are left out.

    corners : (triangle_count, 3 vertices, 3) float64; margin : added on every side, pixels.
    A point is t (d0 + x dx + y dy) from the eye, so by Cramer's rule x = (v . (dy x d0)) / (v . (dx x dy)), and
    the denominator has the sign of t.
    """
    c = {name: np.array(values, dtype=np.float64) for name, values in camera.items()}
    origin, depth, dx, dy = (
        (c["e"], c["d0"], c["dx"], c["dy"]) if "d0" in c else (c["e0"], c["d"], c["ex"], c["ey"])
    )
    plane, plane_perm = cross(dx, dy)
    orientation, doubt = dot(plane, depth), BOUND_64 * dot(plane_perm, abs(depth))
    if abs(orientation) <= doubt:
        raise ValueError("the camera vectors lie in one plane: no view")
    v = corners - origin
    scaled = []
    for a, b in ((dy, depth), (depth, dx)):
        normal, perm = cross(a, b)
        scaled.append((dot(v, normal), BOUND_64 * dot(abs(v), perm)))
    if "d0" in c:
        below, below_error = dot(v, plane), BOUND_64 * dot(abs(v), plane_perm)
    else:
        below, below_error = np.full(v.shape[:2], orientation), np.full(v.shape[:2], doubt)
    side = below * np.sign(orientation)
    in_front, behind = np.all(side > 2 * below_error, axis=1), np.all(side < -below_error, axis=1)
    limits = []
    for (above, above_error), size in zip(scaled, (width, height), strict=True):
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = above / below
            error = 2 * (above_error + abs(ratio) * below_error) / abs(below) + margin + abs(ratio) * 1e-12
        low, high = (ratio - error).min(axis=1), (ratio + error).max(axis=1)
        first = np.where(in_front, np.ceil(np.clip(low, -1, size + 1) - 0.5), 0)
        last = np.where(in_front, np.floor(np.clip(high, -1, size + 1) - 0.5), size - 1)
        limits += [np.clip(first, 0, size), np.clip(last + 1, 0, size)]
    x0, x1, y0, y1 = (limit.astype(np.int64) for limit in limits)
    keep = np.flatnonzero(~behind & (x1 > x0) & (y1 > y0))
    return Boxes(keep, x0[keep], x1[keep], y0[keep], y1[keep])


def split_boxes(boxes: Boxes, side: int) -> Boxes:
    """Boxes with a side longer than `side` cut into pieces of at most `side` x `side`."""
    columns = (boxes.x1 - boxes.x0 + side - 1) // side
    rows = (boxes.y1 - boxes.y0 + side - 1) // side
    of, k = spread(columns * rows)
    column, row = k % columns[of], k // columns[of]
    x0, y0 = boxes.x0[of] + column * side, boxes.y0[of] + row * side
    x1, y1 = np.minimum(x0 + side, boxes.x1[of]), np.minimum(y0 + side, boxes.y1[of])
    return Boxes(boxes.triangle[of], x0, x1, y0, y1)


def spread(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For counts (2, 3): owners (0, 0, 1, 1, 1) and ranks (0, 1, 0, 1, 2)."""
    owner = np.repeat(np.arange(len(counts)), counts)
    start = np.cumsum(counts) - counts
    return owner, np.arange(len(owner)) - start[owner]


def reachable(boxes: Boxes, forms: FloatForms) -> np.ndarray:
    """False where some edge function is surely negative at every sample of the box (forms face the viewer)."""
    keep = np.ones(len(boxes.triangle), dtype=bool)
    for i in range(3):
        a, b, c = (forms.edge[i, k][boxes.triangle] for k in range(3))
        x = np.where(b > 0, boxes.x1 - 0.5, boxes.x0 + 0.5)
        y = np.where(c > 0, boxes.y1 - 0.5, boxes.y0 + 0.5)
        keep &= a + b * x + c * y >= -forms.edge_error[i][boxes.triangle]
    return keep


def small_boxes(boxes: Boxes, forms: FloatForms) -> Boxes:
    """Boxes cut down to the smallest blocks, those without a sample of their triangle left out."""
    for side in BLOCK_SIDES:
        is_large = (boxes.x1 - boxes.x0 > side) | (boxes.y1 - boxes.y0 > side)
        done, large, pieces = boxes[~is_large], boxes[is_large], []
        batch = max(1, (1 << 22) // 1024)
        for start in range(0, len(large.triangle), batch):
            cut = split_boxes(large[start : start + batch], side)
            pieces.append(cut[reachable(cut, forms)])
        boxes = Boxes.join([done, *pieces])
    return boxes[reachable(boxes, forms)]


def facing_signs(forms: FloatForms, exact: IntegerForms, triangles: np.ndarray) -> np.ndarray:
    """The sign of V (orthographic: S) of every listed triangle, exactly; the others get 0."""
    signs = np.zeros(len(forms.facing), dtype=np.int64)
    signs[triangles] = np.sign(forms.facing[triangles])
    for k in triangles[abs(forms.facing[triangles]) <= forms.facing_error[triangles]].tolist():
        facing = exact.of(k)[1]
        signs[k] = (facing > 0) - (facing < 0)
    return signs


@dataclass
class Pairs:
    """Samples and triangles that may cover them; w_low <= w <= w_high; all (pair_count,)."""

    sample: np.ndarray
    triangle: np.ndarray
    is_sure: np.ndarray
    w_low: np.ndarray
    w_high: np.ndarray

    def __getitem__(self, chosen: np.ndarray) -> Pairs:
        return Pairs(*(value[chosen] for value in vars(self).values()))


def covered_pairs(boxes: Boxes, forms: FloatForms, width: int) -> Pairs:
    """The samples of some boxes that their triangles may cover, with w as an interval."""
    owner, k = spread(boxes.area())
    across = (boxes.x1 - boxes.x0)[owner]
    x, y, triangle = boxes.x0[owner] + k % across, boxes.y0[owner] + k // across, boxes.triangle[owner]
    is_sure = np.ones(len(x), dtype=bool)
    for i in range(3):
        a, b, c = (forms.edge[i, m][triangle] for m in range(3))
        value, error = a + b * (x + 0.5) + c * (y + 0.5), forms.edge_error[i][triangle]
        keep = value >= -error
        is_sure &= value > error
        x, y, triangle, is_sure = x[keep], y[keep], triangle[keep], is_sure[keep]
    numerator, numerator_doubt = ratio_parts(forms.numerator, forms.numerator_error, triangle, x, y)
    denominator, denominator_doubt = ratio_parts(forms.denominator, forms.denominator_error, triangle, x, y)
    with np.errstate(divide="ignore", invalid="ignore"):
        w = denominator / numerator
    doubt = 1.25 * (numerator_doubt + denominator_doubt) + 1e-15
    # Beyond these limits nothing is known of w, not even its sign.
    known = (numerator_doubt < 0.1) & (denominator_doubt < 0.1)
    w_low = np.where(known, w - abs(w) * doubt, -np.inf)
    w_high = np.where(known, w + abs(w) * doubt, np.inf)
    pairs = Pairs(y * width + x, triangle, is_sure, w_low, w_high)
    return pairs[w_high > 0]


def ratio_parts(
    form: np.ndarray, error: np.ndarray, triangle: np.ndarray, x: np.ndarray, y: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """A form at samples, and its relative error bound (inf where the form is 0)."""
    value = form[0][triangle] + form[1][triangle] * (x + 0.5) + form[2][triangle] * (y + 0.5)
    with np.errstate(divide="ignore", invalid="ignore"):
        doubt = np.where(value == 0, np.inf, error[triangle] / abs(value))
    return value, doubt


def contenders(boxes: Boxes, forms: FloatForms, width: int, height: int) -> tuple[Pairs, int]:
    """All pairs that may be the visible one, ordered by sample; and how many pairs were looked at."""
    best = np.full(width * height, -np.inf)
    kept = []
    for chunk in boxes.chunks():
        pairs = covered_pairs(chunk, forms, width)
        sure = pairs.is_sure & (pairs.w_low > 0)
        np.maximum.at(best, pairs.sample[sure], pairs.w_low[sure])
        kept.append(pairs[pairs.w_high >= best[pairs.sample]])
    names = ("sample", "triangle", "is_sure", "w_low", "w_high")
    pairs = Pairs(*(np.concatenate([getattr(part, name) for part in kept]) for name in names))
    pairs = pairs[pairs.w_high >= best[pairs.sample]]
    return pairs[np.lexsort((pairs.triangle, pairs.sample))], int(boxes.area().sum())


def facing_boxes(
    positions: np.ndarray,
    triangles: np.ndarray,
    camera_vectors: Mapping[str, Sequence[float]],
    width: int,
    height: int,
) -> tuple[Boxes, FloatForms, IntegerForms]:
    """Boxes of samples that triangles may cover, and their forms, all three edges positive inside.

    Arguments as of `exact_visibility`.
    """
    positions, triangles = np.asarray(positions, dtype=np.float32), np.asarray(triangles)
    corners = positions.astype(np.float64)[triangles.astype(np.int64)]
    exact = IntegerForms(positions, triangles, camera_vectors)
    forms = float_forms(corners, camera_vectors, width, height)
    boxes = screen_boxes(corners, camera_vectors, width, height)
    signs = facing_signs(forms, exact, boxes.triangle)
    forms.edge[:] *= signs
    return small_boxes(boxes[signs[boxes.triangle] != 0], forms), forms, exact


def exact_visibility(
    positions: np.ndarray,
    triangles: np.ndarray,
    camera_vectors: Mapping[str, Sequence[float]],
    width: int,
    height: int,
) -> ExactVisibility:
    """The exact answer for every sample at a pixel centre.

    positions : (vertex_count, 3) float32; triangles : (triangle_count, 3) vertex indices; camera_vectors: float32
    numbers as in `stats["camera"]`, `e d0 dx dy` or `d e0 ex ey`.
    """
    boxes, forms, exact = facing_boxes(positions, triangles, camera_vectors, width, height)
    pairs, pair_count = contenders(boxes, forms, width, height)
    return settle(pairs, pair_count, forms, exact, width, height)


def settle(
    pairs: Pairs, pair_count: int, forms: FloatForms, exact: IntegerForms, width: int, height: int
) -> ExactVisibility:
    """One triangle per sample from the contenders; integers decide where there are several, or an unsure one."""
    prim_id = np.full(width * height, NO_HIT, dtype=np.uint32)
    t = np.full(width * height, np.inf)
    sample, first, count = np.unique(pairs.sample, return_index=True, return_counts=True)
    is_settled = (count == 1) & pairs.is_sure[first] & (pairs.w_low[first] > 0)
    alone = first[is_settled]
    triangle, at = pairs.triangle[alone], sample[is_settled]
    x, y = at % width, at // width
    numerator, numerator_doubt = ratio_parts(forms.numerator, forms.numerator_error, triangle, x, y)
    denominator, denominator_doubt = ratio_parts(forms.denominator, forms.denominator_error, triangle, x, y)
    prim_id[at], t[at] = triangle, numerator / denominator
    blurred = np.flatnonzero(numerator_doubt + denominator_doubt > T_ERROR_LIMIT / 2)
    for k in blurred.tolist():
        ratio = exact.depth_ratio(int(triangle[k]), int(x[k]), int(y[k]))
        assert ratio is not None
        t[at[k]] = float(exact.t(ratio))
    contested = np.flatnonzero(~is_settled)
    for k in contested.tolist():
        group = pairs.triangle[first[k] : first[k] + count[k]].tolist()
        found = exact.closest(group, int(sample[k]) % width, int(sample[k]) // width)
        if found is not None:
            prim_id[sample[k]], t[sample[k]] = found[0], float(exact.t(found[1]))
    shape = (height, width)
    return ExactVisibility(prim_id.reshape(shape), t.reshape(shape), len(contested), pair_count)
