"""What is right for rays given one by one: float64 with margins for most pairs, reference.py's fractions for the rest.

The rays are float32 numbers as `--aov ray` exports them. A pair (sample, triangle) is
    surely outside  an edge function is below -MARGIN of its terms' sizes, all sides turned by that of the volume
    surely inside   all three are above it
    open            anything else, and then exact fractions decide
A sample with one triangle surely inside and no other possible one is settled; where there are more, those that lie
surely farther are dropped, and fractions decide among the rest. Nothing here is shared with the kernels.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from reference import NO_HIT, Ray, exact_triangles, intersect, vector

MARGIN = 2.0**-46
"""A float64 edge function is within 16 * 2^-53 of its terms' sizes."""
NEARER = 1e-6
SURE_SLOPE = 1e-4
BLOCKS = (128, 16)
"""Samples a side of the squares that `exact_image_by_blocks` looks at, one within the other."""


def rays_of(channels: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """d, tx, ty, each (height, width, 3) float32, from the channels of `--aov ray`."""
    d, tx, ty = (np.stack([channels[f"{name}.{c}"] for c in "XYZ"], -1) for name in ("ray", "raydx", "raydy"))
    return d, tx, ty


def exact_image(
    positions: np.ndarray, triangles: np.ndarray, eye: np.ndarray, d: np.ndarray, tx: np.ndarray, ty: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """The visible triangle of every ray from one eye.

    Returns `prim_id` and `hit_count`, surfaces in line where fractions were asked and else 1 or 0 (shape of d without
    its last axis), `t` float64 of what is visible, and for how many samples fractions were asked.
    """
    shape, d, tx, ty = d.shape[:-1], d.reshape(-1, 3), tx.reshape(-1, 3), ty.reshape(-1, 3)
    corners = positions[triangles].astype(np.float64) - np.asarray(eye, dtype=np.float64)
    inside, possible, t = classify_pairs(corners, d.astype(np.float64))
    prim_id, times = np.full(len(d), NO_HIT, dtype=np.uint32), np.full(len(d), np.inf)
    hit_count, asked = np.zeros(len(d), dtype=np.int64), 0
    origin = vector(np.asarray(eye, dtype=np.float32).tolist())
    for k in np.flatnonzero(possible.any(axis=1) & d.any(axis=1)):
        group = np.flatnonzero(possible[k])
        if len(group) == 1 and inside[k, group[0]]:
            prim_id[k], times[k], hit_count[k] = group[0], t[k, group[0]], 1
            continue
        asked += 1
        ray = Ray(origin, *(vector(v[k].tolist()) for v in (d, tx, ty)))
        asked_about = exact_triangles(*_part(positions, triangles[group]))
        hits = [intersect(triangle, ray, True, int(j)) for j, triangle in zip(group, asked_about, strict=True)]
        found = sorted((hit for hit in hits if hit), key=lambda hit: (hit.t, hit.prim_id))
        hit_count[k] = len(found)
        if found:
            prim_id[k], times[k] = found[0].prim_id, float(found[0].t)
    return prim_id.reshape(shape), hit_count.reshape(shape), times.reshape(shape), asked


def _part(positions: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The positions of some triangles' corners alone, and their indices."""
    used, indices = np.unique(triangles, return_inverse=True)
    return positions[used], indices.reshape(triangles.shape)


def exact_image_by_blocks(
    positions: np.ndarray, triangles: np.ndarray, eye: np.ndarray, d: np.ndarray, tx: np.ndarray, ty: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """`prim_id` and `t` of `exact_image` for scenes of many triangles; d, tx, ty (height, width, 3).

    Of each square of BLOCKS samples a side, the large ones first, those triangles are left out that have an edge which,
    by more than MARGIN of its terms, all its directions lie outside of: they lie within a distance of their mean.
    """
    found = np.full(d.shape[:-1], NO_HIT, dtype=np.uint32), np.full(d.shape[:-1], np.inf)
    corners = positions[triangles].astype(np.float64) - np.asarray(eye, dtype=np.float64)
    edges = _inward_edges(corners)

    def go_on(rows: range, columns: range, part: np.ndarray, sides: tuple[int, ...]) -> None:
        for top in rows[:: sides[0]]:
            for left in columns[:: sides[0]]:
                chosen = np.s_[top : min(top + sides[0], rows.stop), left : min(left + sides[0], columns.stop)]
                own = part[_may_meet(edges[:, part], d[chosen].reshape(-1, 3).astype(np.float64))]
                if len(sides) > 1:
                    go_on(range(*chosen[0].indices(len(d))), range(*chosen[1].indices(d.shape[1])), own, sides[1:])
                    continue
                prim_id, _, t, _ = exact_image(positions, triangles[own], eye, d[chosen], tx[chosen], ty[chosen])
                found[0][chosen] = np.append(own, NO_HIT)[np.minimum(prim_id, len(own))]
                found[1][chosen] = t

    go_on(range(d.shape[0]), range(d.shape[1]), np.arange(len(corners)), BLOCKS)
    return found


def _inward_edges(corners: np.ndarray) -> np.ndarray:
    """(3 edges, triangles, 5): inward normal, its length, and what it may be off for each unit of a direction.

    The length is infinite where the triangle may have no volume: then nothing is left out.
    """
    _, volume, is_flat = planes_of(corners)
    lengths, edges = np.linalg.norm(corners, axis=2), np.zeros((3, len(corners), 5))
    for i in range(3):
        a, b = (i + 2) % 3, (i + 1) % 3
        edges[i, :, :3] = np.where(volume < 0, 1, -1)[:, None] * np.cross(corners[:, a], corners[:, b])
        edges[i, :, 3] = np.where(is_flat, np.inf, np.linalg.norm(edges[i, :, :3], axis=1))
        edges[i, :, 4] = MARGIN * 8 * lengths[:, a] * lengths[:, b] + 1e-300
    return edges


def _may_meet(edges: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Which triangles a direction of d (count, 3) may lie in; those of length 0 are none."""
    d = d[d.any(axis=1)]
    if not len(d):
        return np.zeros(edges.shape[1], dtype=bool)
    middle = d.mean(axis=0)
    apart = max(np.linalg.norm(d - middle, axis=1).max() * (1 + 1e-9), 1e-30)
    at_middle = edges[..., 0] * middle[0] + edges[..., 1] * middle[1] + edges[..., 2] * middle[2]
    return (at_middle + edges[..., 3] * apart >= -edges[..., 4] * (np.linalg.norm(middle) + apart)).all(axis=0)


def planes_of(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normals, volumes, and which triangles may have none; corners (triangles, 3, 3) relative to the eye."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    volume = np.einsum("tk,tk->t", normal, corners[:, 0])
    span = np.linalg.norm(np.roll(corners, 1, axis=1) - corners, axis=2).max(axis=1)
    return normal, volume, abs(volume) <= MARGIN * span * span * np.linalg.norm(corners[:, 0], axis=1)


def classify_pairs(corners: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(samples, triangles) bool 'surely inside', bool 'possible' without what is surely hidden, float64 t.

    corners : (triangles, 3, 3) relative to the eye.
    """
    normal, volume, is_flat = planes_of(corners)
    lengths = np.linalg.norm(corners, axis=2)
    lowest = np.full((len(d), len(corners)), np.inf)
    for i in range(3):
        a, b = corners[:, (i + 2) % 3], corners[:, (i + 1) % 3]
        n = np.cross(a, b)
        size = 4 * lengths[:, (i + 2) % 3] * lengths[:, (i + 1) % 3] * np.linalg.norm(d, axis=1)[:, None]
        lowest = np.minimum(lowest, np.where(volume < 0, 1, -1) * (d @ n.T) / (MARGIN * size + 1e-300))
    possible, inside = (lowest >= -1) | is_flat, (lowest > 1) & ~is_flat
    slope = d @ normal.T
    with np.errstate(divide="ignore", invalid="ignore"):
        t = volume / slope
    steep = abs(slope) > SURE_SLOPE * np.linalg.norm(normal, axis=1)
    nearest = np.where(inside & steep & (t > 0), t, np.inf).min(axis=1, initial=np.inf)
    hidden = steep & (t > nearest[:, None] * (1 + NEARER))
    return inside, possible & ~hidden, t
