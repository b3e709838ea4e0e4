"""What the order of the loops costs: hit rates, shading and bytes off chip, answered with counts of one view.

Durand, 'A Unifying Paradigm', section 6.1 (hit rates in object and image order) and section 7 (pre-Z, deferred
shading, a pass per light, sort-last against sort-middle, the last reference of an object), which asks and leaves the
answers open. Counts come from the kernels' counters and the tiles' lists; bytes are counts times the sizes of what
the kernels here read and write (SIZES). 'Off chip' is what must leave a processor whose tile of the image is its
only fast memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from clrast.job import RenderJob
from clrast.opencl.device import open_device
from clrast.opencl.layout import NO_HIT
from clrast.options import RenderOptions
from clrast.scene.camera import camera_vectors
from clrast.scene.model import Camera, Scene
from clrast.shading.effects import plan_effects
from clrast.visibility.tiles import REFERENCE_BYTES, TileRasterizer

SIZES = MappingProxyType({
    "triangle": 48,  # three float4: corners and the plane's normal (prepare_triangles.cl)
    "bound": 8,  # a triangle's screen bound (setup_triangles.cl)
    "reference": REFERENCE_BYTES,  # of a tile's list (bin_triangles.cl)
    "nearness": 4,
    "id": 4,
    "color": 16,  # R G B A
    "surface": 32,  # what deferred shading keeps of a sample: normal, base colour, material, depth
})  # fmt: skip
"""Bytes of one of each."""

HIT_RATE_METHODS = ("3dr-brute", "3dr-binning", "3dr-full", "raycast-bvh")


@dataclass(frozen=True)
class HitRates:
    """Shares of useful work of one method (Durand, 6.1).

    objects : triangles that are seen, of those set up. samples : samples that a triangle covers, of those that it was
    tested at. writes : of the covered ones, nearer than what was there. nodes : tests of nodes that were passed.
    """

    method: str
    objects: float
    samples: float
    writes: float
    nodes: float | None


@dataclass(frozen=True)
class Order:
    """One order of work. shadings : evaluations of a surface's shading, each for all lights. bytes : off chip."""

    name: str
    meaning: str
    shadings: int
    bytes: int


@dataclass(frozen=True)
class LastReference:
    """How long a triangle must stay within reach (Durand, 7): tiles are visited row by row.

    histogram : triangles by the number of tiles from the first to the last reference: bin k counts distances of
    2**(k-1) up to 2**k - 1 tiles, bin 0 those of one tile. live : most triangles that have been referenced and will be
    again; a cache of that many reads each triangle once.
    """

    referenced: int
    references: int
    histogram: tuple[int, ...]
    live: int


@dataclass(frozen=True)
class OrderStudy:
    hit_rates: tuple[HitRates, ...]
    orders: tuple[Order, ...]
    last_reference: LastReference
    counts: dict[str, int]

    def as_json(self) -> dict[str, Any]:
        return asdict(self)


def study_orders(scene: Scene, camera: Camera, options: RenderOptions) -> OrderStudy:
    """Render a view with counters, once a method of HIT_RATE_METHODS, and answer.

    Raises what `render` raises.
    """
    rates = []
    counts: dict[str, int] = {}
    lists: list[np.ndarray] = []
    brute: dict[str, Any] = {}
    for name in HIT_RATE_METHODS:
        stats, prims, tile_lists = _count(scene, camera, replace(options, method=name, oracle=(), counters=True))
        rates.append(_hit_rates(name, stats, prims))
        if tile_lists is not None:
            lists = tile_lists
            counts = _view_counts(scene, stats, prims, lists)
        elif name == "3dr-brute":
            brute = stats["other_counts"]
    # Without early w every triangle is met in the order of the file: what an immediate renderer sees.
    counts |= {"covered": brute["samples_covered"], "written": brute["samples_written"]}
    return OrderStudy(tuple(rates), orders_of(counts), last_reference(lists), counts)


def _count(
    scene: Scene, camera: Camera, options: RenderOptions
) -> tuple[dict[str, Any], np.ndarray, list[np.ndarray] | None]:
    """The stats of one frame, its prim_ids, and the tiles' lists where there are some."""
    options = replace(options, aov=("id",), effects={**options.effects, "alpha blend": "off"})
    device = open_device(options.device, options.threads)
    plan = plan_effects(scene, options.aov, options.effects)
    job = RenderJob(device, scene, camera_vectors(camera, *options.size), options, plan)
    channels = job.allocate()
    job.render_frame(channels, first=True)
    tiles = job.tiles.tile_lists() if isinstance(job.tiles, TileRasterizer) else None
    return job.stats(), channels["id.prim"], tiles


def _hit_rates(name: str, stats: dict[str, Any], prims: np.ndarray) -> HitRates:
    counts, more = stats["counts"], stats["other_counts"]
    seen = len(np.unique(prims[prims != NO_HIT]))
    tested, covered, steps = counts["intersection_tests"], more["samples_covered"], counts["traversal_steps"]
    return HitRates(
        name,
        seen / max(1, counts["setups"]),
        covered / max(1, tested),
        more["samples_written"] / max(1, covered),
        None if not steps else 1 - more["nodes_culled"] / steps,
    )


def _view_counts(
    scene: Scene, stats: dict[str, Any], prims: np.ndarray, lists: Sequence[np.ndarray]
) -> dict[str, int]:
    return {
        "triangles": scene.triangle_count,
        "pixels": prims.size,
        "hits": int((prims != NO_HIT).sum()),
        "seen": len(np.unique(prims[prims != NO_HIT])),
        "references": sum(len(each) for each in lists),
        "lights": max(1, len(scene.lights)),
        "setups": stats["counts"]["setups"],
    }


def orders_of(counts: dict[str, int]) -> tuple[Order, ...]:
    """Bytes and shadings of each order from the counts of a view.

    counts : triangles, pixels, hits, seen (triangles), references, covered (samples inside a triangle, all layers),
    written (of these nearer than all before, in the order of the file), lights.
    """
    size, n = SIZES, counts
    geometry = n["triangles"] * size["triangle"]
    bounds = n["triangles"] * (size["triangle"] + size["bound"])
    bins = 2 * n["triangles"] * size["bound"] + n["references"] * (2 * size["reference"] + size["triangle"])
    clear = n["pixels"] * (size["nearness"] + size["color"])
    depth = n["covered"] * size["nearness"] + n["written"] * size["nearness"]
    image = n["pixels"] * size["color"]
    return (
        Order("sort-last, forward", "triangle by triangle into the frame buffer, shaded at once", n["written"],
              geometry + clear + depth + n["written"] * size["color"]),
        Order("sort-last, pre-Z", "a pass for nearness alone, then the same again for what is equal", n["hits"],
              2 * geometry + clear + depth + n["covered"] * size["nearness"] + n["hits"] * size["color"]),
        Order("sort-last, deferred", "surfaces into the frame buffer, shaded at the end", n["hits"],
              geometry + clear + depth + n["written"] * size["surface"] + n["hits"] * size["surface"] + image),
        Order("sort-last, a pass per light", "deferred, with the surfaces read again for every light",
              n["hits"] * n["lights"],
              geometry + clear + depth + n["written"] * size["surface"]
              + n["lights"] * n["hits"] * (size["surface"] + 2 * size["color"])),
        Order("sort-middle, forward", "tile by tile, shaded at once: the tile stays on chip", n["written"],
              bounds + bins + image),
        Order("sort-middle, deferred by id", "tile by tile, ids out, shaded once per sample (what renders here)",
              n["hits"], bounds + bins + 2 * n["pixels"] * size["id"] + n["seen"] * size["triangle"] + image),
    )  # fmt: skip


def last_reference(lists: Sequence[np.ndarray]) -> LastReference:
    """From the tiles' lists of prim_ids, tiles row by row."""
    lengths = np.array([len(each) for each in lists], dtype=np.int64)
    prims = np.concatenate([*lists, np.zeros(0, np.uint32)]).astype(np.int64)
    tiles = np.repeat(np.arange(len(lists)), lengths)
    if not len(prims):
        return LastReference(0, 0, (), 0)
    first = np.full(int(prims.max()) + 1, len(lists), dtype=np.int64)
    last = np.full(len(first), -1, dtype=np.int64)
    np.minimum.at(first, prims, tiles)
    np.maximum.at(last, prims, tiles)
    used = last >= 0
    distance = (last - first)[used]
    bins = np.where(distance == 0, 0, 1 + np.floor(np.log2(np.maximum(distance, 1))).astype(np.int64))
    changes = np.zeros(len(lists) + 1, dtype=np.int64)
    np.add.at(changes, first[used], 1)
    np.subtract.at(changes, last[used] + 1, 1)
    histogram = tuple(int(count) for count in np.bincount(bins))
    return LastReference(int(used.sum()), len(prims), histogram, int(np.cumsum(changes).max()))
