"""Triangles, views and a probe for edges of the other kinds (cl/projected_edges.clh); no word on what is right."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
from edge_twins import ViewTwin
from kernel_probe import Probe
from kernel_world import make_scene

from clrast.opencl import kernels
from clrast.opencl.device import Device
from clrast.opencl.features import Edges, Features, Projection
from clrast.scene.camera import CameraVectors, camera_vectors
from clrast.scene.model import Camera, Scene
from clrast.visibility.view import build_view

PROBE = """
#include "vector.clh"
#include "edge_function.clh"

// Reads: corners. Writes: coefficients, flags. Work item: VECTOR_WIDTH triangles. Local memory: 0 bytes.
kernel void probe_setup(
    View view,
    uint count,                           // triangles, a multiple of VECTOR_WIDTH
    global const float *restrict corners, // [9][count] x y z of three vertices
    global float *restrict coefficients,  // [12][count] c gx gy of three edges, nearness c x y
    global int *restrict flags)           // [4][count] exclusive of three edges, valid
{
  const uint k = get_global_id(0) * VECTOR_WIDTH;
  if (k >= count) return;
  Vec3 p[3];
  for (uint i = 0; i < 3; ++i) {
    p[i].x = LOAD_V(corners + 3 * i * count + k);
    p[i].y = LOAD_V(corners + (3 * i + 1) * count + k);
    p[i].z = LOAD_V(corners + (3 * i + 2) * count + k);
  }
  const TriangleSetup setup = setup_triangles_at(canonical_triangles(p[0], p[1], p[2]), view);
  for (uint i = 0; i < 3; ++i) {
    STORE_V(setup.edge[i].c, coefficients + 3 * i * count + k);
    STORE_V(setup.edge[i].gx, coefficients + (3 * i + 1) * count + k);
    STORE_V(setup.edge[i].gy, coefficients + (3 * i + 2) * count + k);
    STORE_V(setup.edge[i].exclusive, flags + i * count + k);
  }
  STORE_V(setup.nearness.c, coefficients + 9 * count + k);
  STORE_V(setup.nearness.x, coefficients + 10 * count + k);
  STORE_V(setup.nearness.y, coefficients + 11 * count + k);
  STORE_V(setup.valid, flags + 3 * count + k);
}
"""
KINDS = [
    ("perspective", Edges.PROJECTED),
    ("perspective", Edges.HOMOGENEOUS),
    ("perspective", Edges.BARYCENTRIC),
    ("orthographic", Edges.PROJECTED),
    ("orthographic", Edges.BARYCENTRIC),
]
"""In orthographic views homogeneous edges are the projected ones, bit for bit."""
METHODS = {
    Edges.PROJECTED: {"method": "2dr-binning"},
    Edges.HOMOGENEOUS: {"method": "2dh-binning"},
    Edges.BARYCENTRIC: {"method": "raycast-brute", "intersection": "barycentric"},
}
"""Options of a render that takes such edges."""


class SetupProbe(Probe):
    """What setup_triangles_at makes of triangles."""

    def __init__(self, device: Device, folder: Path, **features: object) -> None:
        for path in kernels.kernel_folder().glob("*.clh"):
            shutil.copy(path, folder)
        (folder / "probe_setup.cl").write_text(PROBE)
        self.device, self.width = device, features.pop("vector_width", device.vector_width)
        self.program = kernels.build(device, "probe_setup.cl", Features(self.width, **features), folder)

    def setups(self, view: CameraVectors, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(coefficients (count, 4, 3) of three edges and nearness, exclusive (count, 3), valid (count,) bool)."""
        points = corners.reshape(-1, 3).astype(np.float64)
        found, flags = self.run(
            "probe_setup",
            len(corners),
            {"coefficients": (np.float32, 12), "flags": (np.int32, 4)},
            view=build_view(view, points.min(axis=0), points.max(axis=0), 5),
            corners=np.ascontiguousarray(corners.reshape(-1, 9).T, dtype=np.float32),
        )
        return found.T.reshape(-1, 4, 3), flags[:3].T, flags[3] != 0


def probe(device: Device, folder: Path, projection: str, kind: Edges, **features: object) -> SetupProbe:
    return SetupProbe(device, folder, projection=Projection[projection.upper()], edges=kind, **features)


def view_of(projection: str, width: int = 48, height: int = 40, far: tuple = (0, 0, 0)) -> CameraVectors:
    """A camera whose vectors are no short numbers, looking at a place that may be far from the world's origin."""
    eye, at = (tuple(np.add(place, far).tolist()) for place in ((0.3, 0.7, 2.5), (0.1, -0.2, 0.05)))
    camera = Camera("oblique", projection, eye, at, (0.1, 1.0, 0.2), 60.0, 3.0)
    return camera_vectors(camera, width, height)


def blob(seed: int, count: int, size: float = 0.4, center: tuple = (0, 0, 0)) -> np.ndarray:
    """(count, 3, 3) float32: triangles round a point."""
    rng = np.random.default_rng(seed)
    return (center + rng.normal(size=(count, 1, 3)) * 0.5 + rng.normal(size=(count, 3, 3)) * size).astype(np.float32)


def behind(view: CameraVectors, corners: np.ndarray) -> np.ndarray:
    """(count,) how many vertices of each triangle lie behind the eye's plane."""
    twin = ViewTwin(view)
    return sum((twin.transform(corners[:, k].astype(np.float64))[2].value < 0).astype(int) for k in range(3))


def crossing(view: CameraVectors, seed: int, count: int, behind_count: int) -> np.ndarray:
    """Large triangles round the eye with so many of their vertices behind it."""
    corners = blob(seed, 40 * count, 2.0, view.origin)
    return corners[behind(view, corners) == behind_count][:count]


def edge_on(view: CameraVectors, seed: int, count: int) -> np.ndarray:
    """Triangles whose planes hold the eye (orthographic: the direction) but for the rounding of a vertex."""
    corners = blob(seed, count).astype(np.float64)
    share = np.random.default_rng(seed).uniform(0.1, 1, size=(2, count, 1))
    eye = np.array(view.origin)
    if view.projection == "perspective":
        corners[:, 2] = eye + share[0] * (corners[:, 0] - eye) + share[1] * (corners[:, 1] - eye)
    else:
        corners[:, 2] = corners[:, 0] + share[0] * (corners[:, 1] - corners[:, 0]) + share[1] * view.direction
    return corners.astype(np.float32)


def thin(seed: int, count: int) -> np.ndarray:
    """Slivers of widths down to 1e-9; the last ones are points and doubled vertices."""
    rng, corners = np.random.default_rng(seed), blob(seed, count, 1.0).astype(np.float64)
    share, width = rng.uniform(size=(count, 1)), 10.0 ** rng.uniform(-9, -1, size=(count, 1))
    corners[:, 2] = corners[:, 0] + share * (corners[:, 1] - corners[:, 0]) + width * rng.normal(size=(count, 3))
    corners[-6:, 2] = corners[-6:, 1]
    corners[-3:] = corners[-3:, :1]
    return corners.astype(np.float32)


def sheet(view: CameraVectors) -> Scene:
    """A sheet over the whole view; its vertices are every second pixel centre, but for rounding."""
    k = np.arange(-2, view.width + 3, 2) + 0.5
    x, y = np.meshgrid(k, k)
    swept = [view.first[c] + x * view.tangent_x[c] + y * view.tangent_y[c] for c in range(3)]
    depth = 3 + 0.01 * np.sin(x * 1.7 + y * y)
    is_perspective = view.projection == "perspective"
    points = [
        view.origin[c] + depth * swept[c] if is_perspective else swept[c] + depth * view.direction[c] for c in range(3)
    ]
    first = [len(k) * j + i for j in range(len(k) - 1) for i in range(len(k) - 1)]
    triangles = [t for c in first for t in ((c, c + len(k), c + len(k) + 1), (c, c + len(k) + 1, c + 1))]
    return make_scene(np.stack(points, axis=2).reshape(-1, 3), triangles)
