"""tests/kernel_probe.cl from Python: what the functions of cl/edge_function.clh and cl/pair.clh give for numbers."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np

from clrast.opencl import buffers, kernels
from clrast.opencl.device import Device
from clrast.opencl.features import Features
from clrast.scene.camera import CameraVectors
from clrast.visibility.view import build_view


class Probe:
    """tests/kernel_probe.cl on one device with one set of build options."""

    def __init__(self, device: Device, folder: Path, **features: Any) -> None:
        for path in [*kernels.kernel_folder().glob("*.clh"), Path(__file__).with_name("kernel_probe.cl")]:
            shutil.copy(path, folder)
        self.device = device
        self.width = features.pop("vector_width", device.vector_width)
        self.program = kernels.build(device, "kernel_probe.cl", Features(self.width, **features), folder)

    def run(self, kernel: str, count: int, outputs: dict[str, tuple[Any, int]], **arguments: Any) -> list[np.ndarray]:
        """Arrays (planes, count); inputs are (planes, count), too, and are padded to whole vectors."""
        padded = -(-count // self.width) * self.width
        given: dict[str, Any] = {"count": padded}
        for name, value in arguments.items():
            if name != "view":
                value = buffers.upload(self.device, np.pad(value, ((0, 0), (0, padded - count)), "edge"))
            given[name] = value
        made = {name: buffers.create(self.device, 4 * planes * padded) for name, (_, planes) in outputs.items()}
        items = padded if kernel == "probe_pairs" else padded // self.width
        self.program.launch(kernel, items, 1, **given, **made)
        return [
            buffers.download(self.device, made[name], dtype, (planes, padded))[:, :count]
            for name, (dtype, planes) in outputs.items()
        ]

    def edges(
        self, view: CameraVectors, a: np.ndarray, b: np.ndarray, is_turned: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients c gx gy (count, 3) float32 and 'exclusive' (count,) of edges with ends (count, 3) float32."""
        signs = np.zeros(len(a), np.int32)
        if is_turned is not None:
            signs[is_turned] = -(2**31)
        ends = np.concatenate([a, b], axis=1).astype(np.float64)
        low, high = np.minimum(ends[:, :3], ends[:, 3:]).min(axis=0), np.maximum(ends[:, :3], ends[:, 3:]).max(axis=0)
        coefficients, exclusive = self.run(
            "probe_edges",
            len(a),
            {"coefficients": (np.float32, 3), "exclusive": (np.int32, 1)},
            view=build_view(view, low, high, 5),
            ends=np.ascontiguousarray(ends.T, dtype=np.float32),
            sign_bits=signs[None],
        )
        return coefficients.T, exclusive[0]

    def samples(self, edges: np.ndarray, exclusive: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values (count, 3) and 'outside' (count,) of edges (count, 3, 3) at positions (count, 2) from the centre."""
        values, outside = self.run(
            "probe_samples",
            len(edges),
            {"values": (np.float32, 3), "outside": (np.int32, 1)},
            edges=np.ascontiguousarray(edges.reshape(-1, 9).T, dtype=np.float32),
            exclusive=np.ascontiguousarray(exclusive.T, dtype=np.int32),
            positions=np.ascontiguousarray(at.T, dtype=np.float32),
        )
        return values.T, outside[0] < 0

    def pairs(self, numbers: np.ndarray) -> np.ndarray:
        """Pairs (5, 2, count) float32 from a, b as (4, count) float32: high and low of a, then of b.

        The exact sum and product of the highs; sum, product and quotient of the pairs.
        """
        (found,) = self.run(
            "probe_pairs", numbers.shape[1], {"results": (np.float32, 10)}, numbers=np.ascontiguousarray(numbers)
        )
        return found.reshape(5, 2, -1)
