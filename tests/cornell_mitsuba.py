"""The Cornell box as a scene of Mitsuba 3, for tests and benchmarks: the quads of cornell_box.py.

Nothing here imports Mitsuba: what is made is the nested dictionary that its load_dict takes.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from cornell_box import CAMERA, QUADS, SURFACES, Surface

ROULETTE = 4
"""Mitsuba's rr_depth that ends paths where ROULETTE_DEPTH, 3, does: it counts a hit after its ray is drawn."""


def write_ply(path: Path, corners: Any) -> None:
    header = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    header += "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
    rows = [" ".join(repr(float(np.float32(c))) for c in corner) for corner in corners]
    path.write_text(header + "\n".join([*rows, "3 0 1 2", "3 0 2 3", ""]))


def box_tree(folder: Path, bsdf_of: Callable[[str], dict[str, Any]]) -> dict[str, Any]:
    """The box without camera and integrator. folder : where its meshes are put. bsdf_of : name of a surface -> BSDF."""
    tree: dict[str, Any] = {"type": "scene"}
    for k, quad in enumerate(QUADS):
        path = folder / f"quad{k}.ply"
        write_ply(path, quad.corners)
        tree[f"quad{k}"] = {
            "type": "ply", "filename": str(path), "face_normals": True, "bsdf": bsdf_of(quad.surface),
        }  # fmt: skip
        emission = SURFACES[quad.surface].emission
        if any(emission):
            tree[f"quad{k}"]["emitter"] = {"type": "area", "radiance": {"type": "rgb", "value": list(emission)}}
    return tree


def path_tree(bounces: int, roulette: int = 1000) -> dict[str, Any]:
    """The path tracer that follows as many rays as --max-depth, as whose own number counts the eye's ray and the one to
    the lamp too. roulette : its rr_depth."""
    return {"type": "path", "max_depth": bounces + 2, "rr_depth": roulette}


def native_bsdf(name: str, kind: str = "principled") -> dict[str, Any]:
    """The nearest of Mitsuba's own to a surface. kind : principled; or diffuse, which is less work."""
    surface: Surface = SURFACES[name]
    base = {"type": "rgb", "value": list(surface.base)}
    if kind == "diffuse":
        bsdf: dict[str, Any] = {"type": "diffuse", "reflectance": base}
    else:
        shape = {"metallic": surface.metallic, "roughness": surface.roughness, "specular": 0.5}
        bsdf = {"type": "principled", "base_color": base, **shape}
    return {"type": "twosided", "bsdf": bsdf}


def sensor_tree(look_at: Callable[..., Any], side: int, samples: int) -> dict[str, Any]:
    """The card's camera with a square film, samples anywhere in a pixel. look_at : Mitsuba's transform of that name."""
    eye, target, up = (list(CAMERA[name]) for name in ("eye", "look_at", "up"))  # type: ignore[call-overload]
    film = {"type": "hdrfilm", "width": side, "height": side, "pixel_format": "rgb", "rfilter": {"type": "box"}}
    return {
        "type": "perspective", "fov": CAMERA["fov"], "fov_axis": "y", "film": film,
        "to_world": look_at(origin=eye, target=target, up=up),
        "sampler": {"type": "independent", "sample_count": samples},
    }  # fmt: skip
