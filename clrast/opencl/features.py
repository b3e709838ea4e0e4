"""What a kernel may be specialised by: array sizes and choices that change its shape; never scene content."""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import IntEnum
from functools import cache


class Precision(IntEnum):
    """Rungs of `--precision`, with the numbers that kernels compare against (PRECISION_* in constants.py)."""

    FAST = 0
    ORDERED = 1
    MIDPOINT = 2
    DOUBLE = 3
    FIXED = 4
    EXACT = 5


class Projection(IntEnum):
    """Sample generators (PROJECTION_* in constants.py)."""

    PERSPECTIVE = 0
    ORTHOGRAPHIC = 1
    PARABOLOID = 2
    LATLONG = 3
    FISHEYE = 4


class Edges(IntEnum):
    """How the three edge functions of a triangle are found (EDGES_* in constants.py)."""

    SPATIAL = 0
    PROJECTED = 1
    HOMOGENEOUS = 2
    BARYCENTRIC = 3


@dataclass(frozen=True)
class Features:
    """Build options of all programs. Each field becomes the macro of its upper-case name.

    A program is built for the fields whose macro its text mentions, so that a change of another field
    rebuilds nothing. Booleans become 0 or 1, enumerations their number.
    """

    vector_width: int = 16  # samples per explicit vector: 1, 8, 16
    tile_log2: int = 5  # tiles have 2**tile_log2 samples a side
    precision: Precision = Precision.MIDPOINT
    float64: bool = False  # the device has it: exact decisions ask it before integers
    projection: Projection = Projection.PERSPECTIVE
    edges: Edges = Edges.SPATIAL
    keep_nearness: bool = False  # a tile's nearness goes to memory: split launches, layers behind BLEND surfaces
    prefetch: bool = False  # the compiler's prefetch, on CPUs whose own OpenCL prefetch() does nothing
    counters: bool = False
    evaluation: int = 0  # EVALUATION_* of constants.py
    is_outside: int = 0  # the oracles of traverse_frusta.cl: numbers of visibility/oracles.py
    is_occluded: int = 0
    split_frustum: int = 0
    generate_samples: int = 0
    binning: int = 1  # blocks of samples are tested before their samples
    node_bounds: bool = False  # setup finds each triangle's greatest nearness, for the nodes of a BVH
    leaf_order: bool = False  # triangles lie in the order of the leaves of a BVH
    stack_capacity: int = 1  # entries of a work item's stack in traverse_frusta.cl
    mailbox: int = 0  # boxes of a ray through a grid that remember which triangles it was tested against
    trace: bool = False  # rays through a grid write down what they read
    unroll_steps: int = 1  # cells that a traversal pass looks at for each ray
    unroll_tests: int = 1  # triangles that an intersection pass tests for each ray
    resumable: bool = False  # traversal stops and goes on in another launch, on drivers that limit loops
    alpha_mask: bool = False
    alpha_blend: bool = False
    textures: bool = False
    normal_interpolation: bool = False
    emission: bool = False
    vertex_colors: bool = False
    derivatives: bool = False  # textures are filtered by what a pixel covers
    coarse_derivatives: bool = False  # of the camera's samples, by differences of 2 x 2 pixels
    sample_list: bool = False  # shading takes a list of samples, not all pixels of a band
    lit: bool = False  # punctual lights; off: the headlight
    secondary: bool = False  # shading leaves hits for rays that go on from them
    reflection: bool = False
    refraction: bool = False
    indirect: bool = False  # paths: one ray at a hit, drawn

    @property
    def filtered(self) -> bool:
        """Whether float32 only filters samples, and the rest is settled by float64 or exact arithmetic."""
        return self.precision in (Precision.DOUBLE, Precision.EXACT)

    @property
    def colors_vary(self) -> bool:
        """Whether base colours are more than their materials say (COLORS_VARY of cl/surface.clh)."""
        return self.textures or self.vertex_colors

    @property
    def nearness_planes(self) -> int:
        """float32 values that a sample's nearness takes where it is kept: one, or an interval's two."""
        return 2 if self.filtered else 1

    def defines(self, source: str | None = None) -> tuple[str, ...]:
        """`-D NAME=value` for each field, in their order; with `source` only those that it mentions."""
        words = None if source is None else _words(source)
        return tuple(
            f"-D {f.name.upper()}={int(getattr(self, f.name))}"
            for f in fields(self)
            if words is None or f.name.upper() in words
        )


@cache
def _words(source: str) -> frozenset[str]:
    """The names in a program; each is looked through once, as that takes longer than a small frame."""
    import re

    return frozenset(re.findall(r"[A-Za-z_]\w*", source))
