"""tests/curved_probe.cl from Python: what functions of elementary.clh, block_ranges.clh, nearness_plane.clh give."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np

from clrast.opencl import buffers, kernels
from clrast.opencl.device import Device
from clrast.opencl.features import Features, Projection
from clrast.scene.camera import CameraVectors
from clrast.visibility.view import build_view


class CurvedProbe:
    """tests/curved_probe.cl on one device for one projection."""

    def __init__(self, device: Device, folder: Path, projection: str) -> None:
        for path in [*kernels.kernel_folder().glob("*.clh"), Path(__file__).with_name("curved_probe.cl")]:
            shutil.copy(path, folder)
        self.device = device
        features = Features(device.vector_width, projection=Projection[projection.upper()])
        self.program = kernels.build(device, "curved_probe.cl", features, folder)

    def _run(self, kernel: str, planes: int, count: int, inputs: dict[str, np.ndarray], **more: Any) -> np.ndarray:
        width = self.device.vector_width
        padded = -(-count // width) * width
        given = {
            name: buffers.upload(self.device, np.pad(values.astype(np.float32), ((0, 0), (0, padded - count)), "edge"))
            for name, values in inputs.items()
        }
        made = buffers.create(self.device, 4 * planes * padded)
        output = {{"probe_angles": "results", "probe_blocks": "highest", "probe_volumes": "volumes"}[kernel]: made}
        self.program.launch(kernel, padded // width, 1, count=padded, **given, **output, **more)
        return buffers.download(self.device, made, np.float32, (planes, padded))[:, :count]

    def angles(self, x: np.ndarray, y: np.ndarray, whole: float) -> np.ndarray:
        """(5, count): sine and cosine of x turns, of y / whole turns, angle of (x, y) in turns."""
        return self._run("probe_angles", 5, len(x), {"numbers": np.stack([x, y])}, whole=whole)

    def blocks(self, view: CameraVectors, normals: np.ndarray, blocks: np.ndarray) -> np.ndarray:
        """(count,) highest values; normals (count, 3), blocks (count, 4) x0 y0 x1 y1 from the image's centre."""
        built = build_view(view, np.zeros(3), np.ones(3), 5)
        return self._run("probe_blocks", 1, len(normals), {"normals": normals.T, "blocks": blocks.T}, view=built)[0]

    def volumes(self, eye: np.ndarray, normals: np.ndarray, points: np.ndarray) -> np.ndarray:
        """(count,) N . (p - eye) of normals and points, (count, 3) float32."""
        place = {f"eye_{axis}": float(value) for axis, value in zip("xyz", eye)}
        return self._run("probe_volumes", 1, len(normals), {"normals": normals.T, "points": points.T}, **place)[0]
