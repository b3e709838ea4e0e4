"""Probe and exact values for the float32 filter's error bounds (cl/error_bounds.clh); no word on what is right.

Exact values come from Python integers: every float32 is a whole number of 2^-149.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from kernel_probe import Probe

from clrast.opencl import kernels
from clrast.opencl.device import Device
from clrast.opencl.features import Features, Precision, Projection
from clrast.scene.camera import CameraVectors
from clrast.visibility.view import build_view

POSITIONS = 7
"""Samples at which each triangle is looked at: the image's corners, its centre, two at random."""

PROBE = """
#include "vector.clh"
#include "edge_function.clh"

// Writes: edges, near, bounds, open. Work item: VECTOR_WIDTH triangles. Local memory: 0 bytes.
kernel void probe_bounds(
    View view,
    uint count,                             // triangles, a multiple of VECTOR_WIDTH
    global const float *restrict corners,   // [9][count] x y z of three vertices
    global const float *restrict positions, // [14][count] X Y of 7 samples, from the image's centre, pixels
    global float *restrict edges,           // [21][count] V_0 V_1 V_2 at each sample
    global float *restrict near,            // [14][count] upper and lower bound of nearness at each sample
    global float *restrict bounds,          // [2][count] E; volume
    global int *restrict open)              // [count] not 0: the sign of the volume is not known
{
  const uint k = get_global_id(0) * VECTOR_WIDTH;
  if (k >= count) return;
  Vec3 p[3];
  for (uint i = 0; i < 3; ++i) {
    p[i].x = LOAD_V(corners + 3 * i * count + k);
    p[i].y = LOAD_V(corners + (3 * i + 1) * count + k);
    p[i].z = LOAD_V(corners + (3 * i + 2) * count + k);
  }
  const Triangles t = canonical_triangles(p[0], p[1], p[2]);
  TriangleSetup setup = setup_triangles_3d(t, view);
  const ErrorBounds bound = bound_errors(t, setup.volume, view, view.direction_reach);
  const float_v right = (float_v)(view.center_x - 0.5f), low = (float_v)(view.center_y - 0.5f);
  const BlockRange range = BLOCK_RANGE(view, -right, -low, right, low);
  const float_v nearest = block_highest(setup.nearness.c, setup.nearness.x, setup.nearness.y, range);
  float span[VECTOR_WIDTH];
  widen_nearness(&setup.nearness, bound, nearest, view.center_x, view.center_y, span);
  for (uint n = 0; n < 7; ++n) {
    const float_v x = LOAD_V(positions + 2 * n * count + k), y = LOAD_V(positions + (2 * n + 1) * count + k);
    for (uint i = 0; i < 3; ++i)
      STORE_V(edge_value_at(setup.edge[i], sample_point(view, x, y)), edges + (3 * n + i) * count + k);
    const float_v upper = edge_value(setup.nearness.c, setup.nearness.x, setup.nearness.y, sample_point(view, x, y));
    STORE_V(upper, near + 2 * n * count + k);
    STORE_V(upper - LOAD_V(span), near + (2 * n + 1) * count + k);
  }
  STORE_V(bound.edge, bounds + k);
  STORE_V(setup.volume, bounds + count + k);
  STORE_V(bound.facing_unsure, open + k);
}
"""


@dataclass(frozen=True)
class Found:
    """What the device says of triangles; edges follow the canonical order of the corners.

    corners : (count, 3, 3) float32, world space, in that order
    at : (count, POSITIONS, 2) samples, pixels from the image's upper left corner
    values : (count, POSITIONS, 3) V_i as computed, turned so that inside is positive
    error : (count,) E; volume : (count,) N . (p_0 - e), orthographic N . d, as computed
    upper, lower : (count, POSITIONS) interval of nearness; facing_unsure : (count,) bool
    scale : the power of two that positions were multiplied with
    """

    corners: np.ndarray
    at: np.ndarray
    values: np.ndarray
    error: np.ndarray
    volume: np.ndarray
    upper: np.ndarray
    lower: np.ndarray
    facing_unsure: np.ndarray
    scale: float


class BoundProbe(Probe):
    """The filter's setup on one device. patch : (text, other text) in error_bounds.clh, for bounds that are wrong."""

    def __init__(self, device: Device, folder: Path, projection: str, patch: tuple[str, str] | None = None) -> None:
        for path in kernels.kernel_folder().glob("*.clh"):
            shutil.copy(path, folder)
        if patch:
            file = folder / "error_bounds.clh"
            text = file.read_text()
            assert patch[0] in text
            file.write_text(text.replace(*patch))
        (folder / "probe_bounds.cl").write_text(PROBE)
        self.device, self.width = device, device.vector_width
        features = Features(self.width, precision=Precision.EXACT, projection=Projection[projection.upper()])
        self.program = kernels.build(device, "probe_bounds.cl", features, folder)

    def look(self, view: CameraVectors, corners: np.ndarray, seed: int = 0) -> Found:
        """corners : (count, 3, 3) float32, world space."""
        corners, count = canonical(corners), len(corners)
        points = corners.reshape(-1, 3).astype(np.float64)
        with np.errstate(over="ignore", invalid="ignore"):
            made = build_view(view, points.min(axis=0), points.max(axis=0), 5)
        scaled = corners * np.float32(made["world_scale"])
        at = sample_places(view, count, seed)
        from_center = at - np.array([view.width, view.height]) / 2
        edges, near, bounds, unsure = self.run(
            "probe_bounds",
            count,
            {
                "edges": (np.float32, 3 * POSITIONS),
                "near": (np.float32, 2 * POSITIONS),
                "bounds": (np.float32, 2),
                "open": (np.int32, 1),
            },
            view=made,
            corners=np.ascontiguousarray(scaled.reshape(-1, 9).T),
            positions=np.ascontiguousarray(from_center.reshape(-1, 2 * POSITIONS).T, dtype=np.float32),
        )
        values = edges.T.reshape(count, POSITIONS, 3)
        upper, lower = near.reshape(POSITIONS, 2, count).transpose(1, 2, 0)
        scale = float(made["world_scale"])
        return Found(corners, at, values, bounds[0], bounds[1], upper, lower, unsure[0] != 0, scale)


def canonical(corners: np.ndarray) -> np.ndarray:
    """Each triangle turned so that its first corner comes first by x, then y, then z."""
    def turned(triangle: list[list[float]]) -> list[list[float]]:
        k = min(range(3), key=lambda i: (triangle[i], i))
        if triangle.count(triangle[k]) == 3:
            return triangle
        # Of two that coincide the one that follows the third corner is first.
        k = next(i for i in range(3) if triangle[i] == triangle[k] and triangle[i - 1] != triangle[k])
        return triangle[k:] + triangle[:k]

    return np.array([turned(t) for t in corners.astype(np.float64).tolist()], dtype=np.float32)


def sample_places(view: CameraVectors, count: int, seed: int) -> np.ndarray:
    """(count, POSITIONS, 2) pixel centres: the corners, one at the centre, the rest at random."""
    right, low = view.width - 0.5, view.height - 0.5
    fixed = [(0.5, 0.5), (right, 0.5), (0.5, low), (right, low), (view.width // 2 + 0.5, view.height // 2 + 0.5)]
    at = np.empty((count, POSITIONS, 2))
    at[:, :5] = fixed
    at[:, 5:] = np.random.default_rng(seed).integers(0, (view.width, view.height), size=(count, POSITIONS - 5, 2)) + 0.5
    return at


# --- exact values ----------------------------------------------------------------------------------


def whole(values: np.ndarray) -> np.ndarray:
    """float32 or half-integer values in units of 2^-149: an array of Python integers."""
    flat = (values.astype(np.float64) * 2.0**149).ravel().tolist()  # a product by a power of two: at most 2^277
    return np.array([int(value) for value in flat] + [None], dtype=object)[:-1].reshape(values.shape)


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Of (..., 3) integers."""
    parts = [a[..., k - 2] * b[..., k - 1] - a[..., k - 1] * b[..., k - 2] for k in range(3)]
    return np.stack(parts, axis=-1)


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    product = a * b
    return product[..., 0] + product[..., 1] + product[..., 2]


@dataclass(frozen=True)
class Exact:
    """DESIGN section 1, in world space and unscaled. Integers in the units given.

    values : (count, POSITIONS, 3) V_i in the kernels' scale (perspective: twice eq. 1), in value_unit
    volume : (count,) any unit: its sign is the opposite of that of V (orthographic S)
    nearness : (count, POSITIONS) list of Fractions, w or -t; None where V or N . d is 0
    """

    values: np.ndarray
    value_unit: Fraction
    volume: np.ndarray
    nearness: list[list[Fraction | None]]


def exact_values(view: CameraVectors, found: Found) -> Exact:
    """By the definitions of edge functions, V and t alone."""
    p = whole(found.corners)
    first, step_x, step_y = (whole(np.array(v)) for v in (view.first, view.tangent_x, view.tangent_y))
    twice = (2 * found.at).astype(int).astype(object)
    swept = 2 * first + twice[..., :1] * step_x + twice[..., 1:] * step_y  # (count, POSITIONS, 3) in 2^-150
    normal = cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    is_perspective = view.projection == "perspective"
    values = []
    for i in range(3):
        a, b = p[:, (i + 2) % 3], p[:, (i + 1) % 3]
        if is_perspective:
            eye = whole(np.array(view.origin))
            values.append(4 * dot(cross(a - eye, b - eye)[:, None], swept))
        else:
            n = cross(np.broadcast_to(whole(np.array(view.direction)), a.shape), b - a)
            values.append(2 * dot(n[:, None], swept - (a + b)[:, None]))
    if is_perspective:
        volume = dot(normal, p[:, 0] - eye)
        over = dot(normal[:, None], swept)
    else:
        volume = dot(normal, whole(np.array(view.direction)))
        over = -dot(normal[:, None], 2 * p[:, :1] - swept)
    nearness = [
        [Fraction(a, 2 * b) if b else None for a in row] for row, b in zip(over.tolist(), volume.tolist(), strict=True)
    ]
    return Exact(np.stack(values, axis=-1), Fraction(1, 2**449), volume, nearness)
