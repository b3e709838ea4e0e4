"""The methods of the continuum: one table. A method is a choice of oracles and a way to evaluate an edge.

Davidovic et al., '3D Rasterization', sections 4 and 5; Durand, 'A Unifying Paradigm', sections 3 to 5. A new point
of the continuum is a new row here and no new kernel. All rows with 3D edges return the same image, bit for bit.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

from clrast.errors import UsageError
from clrast.opencl import constants
from clrast.opencl.features import Edges, Features, Precision
from clrast.visibility.oracles import ORACLES, RAY_ORACLES, OracleChoice, parse_oracle

AUTO = "auto"

EVALUATIONS = MappingProxyType(
    {"direct": constants.EVALUATION_DIRECT, "incremental": constants.EVALUATION_INCREMENTAL}
)


@dataclass(frozen=True)
class Method:
    """A row of the table.

    edges : how the three edge functions of a triangle are found. tiles : triangles are sorted into lists of
    screen tiles (bin_triangles, rasterize_tiles), so that a tile meets only its own; else frusta meet nodes or the
    whole scene (traverse_frusta). oracles : name -> choice. frustum : side of the root frusta, samples.
    evaluation : direct or incremental. grid : rays walk through a uniform grid (record_triangles, traverse_grid); with
    `passes` in passes that the host chooses (pass_rays). rays : name -> choice, of RAY_ORACLES.
    """

    name: str
    meaning: str
    section: str
    edges: Edges
    tiles: bool
    oracles: Mapping[str, OracleChoice]
    frustum: int = 256
    evaluation: str = "direct"
    grid: bool = False
    passes: bool = False
    rays: Mapping[str, OracleChoice] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def needs_bvh(self) -> bool:
        return not self.tiles and self.oracles["generate_samples"].setting == "leaf"

    @property
    def is_brute(self) -> bool:
        """Whether its time grows with triangles times samples or frusta."""
        return not self.tiles and not self.needs_bvh and not self.grid

    def configure(self, features: Features) -> Features:
        """The features with what this method decides; rungs that settle every sample have one answer, and one form of
        the edges: theirs are 3D whatever the method."""
        chosen: dict[str, Any] = {}
        for name, choice in self.oracles.items():
            chosen[name] = ORACLES[name].settings[choice.setting][0]
        if "mailbox" in self.rays:
            chosen["mailbox"] = self.rays["mailbox"].number if self.rays["mailbox"].setting == "boxes" else 0
        if "unroll" in self.rays:
            steps = int(self.rays["unroll"].setting)
            chosen |= {"unroll_steps": steps, "unroll_tests": self.rays["unroll"].number or steps}
        edges = Edges.SPATIAL if features.filtered else self.edges
        # Integer edge functions have one value, however it is come by.
        evaluation = "direct" if features.precision is Precision.FIXED else self.evaluation
        return replace(features, edges=edges, evaluation=EVALUATIONS[evaluation], **chosen)

    @property
    def small_ratio(self) -> int:
        """The parameter of split_frustum."""
        return max(1, self.oracles["split_frustum"].number)


_NOTHING = {
    "is_outside": "never",
    "is_occluded": "never",
    "split_frustum": "never",
    "generate_samples": "root",
    "binning": "never",
}
_BINNING = {**_NOTHING, "binning": "blocks"}
_CULLING = {**_NOTHING, "is_outside": "screen_bound", "generate_samples": "leaf"}


def _row(name: str, meaning: str, section: str, edges: Edges, oracles: Mapping[str, str], *, tiles: bool = False,
         frustum: int = 256) -> Method:  # fmt: skip
    chosen = dict(parse_oracle("oracle", f"{each}={setting}") for each, setting in oracles.items())
    return Method(name, meaning, section, edges, tiles, MappingProxyType(chosen), frustum)


def _grid_row(name: str, meaning: str, section: str, rays: tuple[str, ...], *, passes: bool = False) -> Method:
    chosen = dict(parse_oracle("oracle", text) for text in rays)
    row = _row(name, meaning, section, Edges.SPATIAL, _BINNING)
    return replace(row, grid=True, passes=passes, rays=MappingProxyType(chosen))


METHODS: Mapping[str, Method] = MappingProxyType({
    row.name: row
    for row in (
        _row("2dr-brute", "projected, clipped triangles; every sample of the screen bound", "3.1, 5",
             Edges.PROJECTED, _NOTHING),
        _row("2dr-binning", "projected, clipped triangles; binning and early w", "3.1, 5",
             Edges.PROJECTED, _BINNING, tiles=True),
        _row("2dh-brute", "homogeneous 2D edges; every sample of the screen bound", "5, Fig. 10",
             Edges.HOMOGENEOUS, _NOTHING),
        _row("2dh-binning", "homogeneous 2D edges; binning and early w", "5, Fig. 10",
             Edges.HOMOGENEOUS, _BINNING, tiles=True),
        _row("3dr-brute", "3D edges; every sample of the screen bound", "3.2, 5",
             Edges.SPATIAL, _NOTHING),
        _row("3dr-binning", "3D edges; hierarchical binning and early w", "5",
             Edges.SPATIAL, _BINNING, tiles=True),
        _row("3dr-frustum-cull", "frusta of 256 x 256 through the BVH, binning at its leaves", "5",
             Edges.SPATIAL, {**_CULLING, "binning": "blocks"}),
        _row("3dr-frustum-split", "occlusion culling and adaptive splitting, no binning", "5",
             Edges.SPATIAL, {**_CULLING, "is_occluded": "w_buffer", "split_frustum": "adaptive"}, frustum=64),
        _row("3dr-full", "occlusion culling, adaptive splitting, binning and early w", "5",
             Edges.SPATIAL, {**_CULLING, "is_occluded": "w_buffer", "split_frustum": "adaptive", "binning": "blocks"},
             frustum=64),
        _row("raycast-bvh", "packets of 8 x 8 rays through the BVH", "4",
             Edges.SPATIAL, {**_CULLING, "is_occluded": "w_buffer"}, frustum=8),
        _grid_row("raycast-grid", "one ray at a time through the uniform grid, branching", "Purcell 3.1",
                  ("mailbox=never",)),
        _grid_row("raycast-grid-multipass", "the same in passes over streams of rays, chosen by the host",
                  "Purcell 3.2", ("pass=purcell:40", "unroll=4"), passes=True),
        _row("raycast-brute", "a loop over triangles for each vector of rays (Durand, section 3)", "Durand 3, 4",
             Edges.SPATIAL, _NOTHING, frustum=4),
    )
})  # fmt: skip
"""Name -> method, in the order of the design."""

SNAPPED_METHODS = tuple(name for name, row in METHODS.items() if row.edges is Edges.PROJECTED)
"""What --precision fixed is for: methods that project vertices, which can then be snapped."""

SNAPPED_DEFAULT = "2dr-binning"
"""What `auto` is with --precision fixed."""

BASELINE = "2dr-brute"
"""What the paper's Fig. 9 is relative to."""


def resolve_method(
    name: str, oracles: Iterable[str] = (), *, intersection: str = "edge", evaluation: str = "direct"
) -> Method:
    """The method of that name with the user's own oracles; raises UsageError where they do not go together.

    oracles : texts NAME=SETTING[:NUMBER], or frustum=SIDE.
    """
    method = METHODS[name]
    chosen = dict(parse_oracle("--oracle", text) for text in oracles)
    rays = {each: chosen.pop(each) for each in RAY_ORACLES if each in chosen}
    for each in rays:
        if each not in method.rays:
            owners = [row.name for row in METHODS.values() if each in row.rays]
            raise UsageError(f"--oracle {each}: {name} has no rays that ask it: use --method {' or '.join(owners)}")
    if chosen and method.grid:
        raise UsageError(f"--oracle: {name} has rays in place of frusta: use {' or '.join(method.rays)}")
    if chosen and method.tiles:
        raise UsageError(f"--oracle: {name} has its lists of tiles in place of a traversal: use a frustum method")
    frustum = chosen.pop("frustum", None)
    if frustum is not None:
        method = replace(method, frustum=frustum.number)
    method = replace(
        method, oracles=MappingProxyType({**method.oracles, **chosen}), rays=MappingProxyType({**method.rays, **rays})
    )
    if intersection == "barycentric":
        if name != "raycast-brute":
            raise UsageError("--intersection barycentric is of --method raycast-brute: give that method")
        method = replace(method, edges=Edges.BARYCENTRIC)
    return replace(method, evaluation=evaluation)
