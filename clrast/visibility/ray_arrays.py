"""Rays and what they hit, as arrays of the host and of the device, and what is checked of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from clrast.errors import UsageError

if TYPE_CHECKING:
    import pyopencl as cl

MAX_COORDINATE = 2.0**60
"""Of vertices and origins: products of three stay in float32's range."""

MIN_DIRECTION, MAX_DIRECTION = 2.0**-60, 2.0**60
"""Of a direction's largest component."""


@dataclass(frozen=True)
class RayHits:
    """What rays hit first.

    prim_id : (ray_count,) uint32, NO_HIT where there is nothing.
    t : (ray_count,) float32, in lengths of the direction; +inf where there is nothing.
    t_error : (ray_count,) float32, how far at most t is from its value in real arithmetic; 0 where there is nothing.
    barycentrics : (ray_count, 3) float32, weights of vertices 0, 1, 2, not negative; 0 where there is nothing.
    """

    prim_id: np.ndarray
    t: np.ndarray
    t_error: np.ndarray
    barycentrics: np.ndarray


@dataclass(frozen=True)
class RayBuffers:
    """Rays on the device. arguments : origins, directions and excluded, as the kernels of trace_rays.cl take them.

    ends : of rays that look for light ends and lamp_slots, as trace_any takes them; empty where t_max alone counts.
    draws : of rays of paths what says which panes they pass, ray_keys and path; or empty.
    """

    count: int
    arguments: dict[str, cl.Buffer]
    ends: dict[str, cl.Buffer] = field(default_factory=dict)
    draws: dict[str, Any] = field(default_factory=dict)


def as_vectors(name: str, values: Any, count: int) -> np.ndarray:
    """(count, 3) float32. Raises UsageError where there are not so many."""
    found = np.asarray(values, dtype=np.float32)
    if found.shape != (count, 3):
        raise UsageError(f"{name} of {count} rays are {count} x 3 numbers, not {' x '.join(map(str, found.shape))}")
    return found


def check_directions(directions: np.ndarray) -> None:
    """Raise UsageError where a direction's size is out of range."""
    size = np.abs(directions).max(axis=1, initial=0.0)
    if not ((size >= MIN_DIRECTION) & (size <= MAX_DIRECTION)).all():
        raise UsageError(f"a ray's direction must have a size within {MIN_DIRECTION:.0e} and {MAX_DIRECTION:.0e}")


def padded(vectors: np.ndarray, last: Any) -> np.ndarray:
    """(count, 4) float32: vectors, and `last` beside them."""
    out = np.zeros((len(vectors), 4), dtype=np.float32)
    out[:, :3] = vectors
    out[:, 3] = last
    return out
