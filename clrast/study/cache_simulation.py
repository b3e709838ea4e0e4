"""A direct-mapped cache in front of what rays through a grid read: hit rates, and bytes that are left.

Purcell et al., 'Ray Tracing on Programmable Graphics Hardware', section 4.1 (64 KB, lines of 48 bytes: four RGB texels
of floats; kernels run as through a pipeline of one pixel), Fig. 9, and section 5.3 (tile by tile). Reads go through the
cache, streams too, since they are textures; writes do not. A fetch is of the line that its first byte is in.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from clrast.study.ray_traces import Trace, run_passes
from clrast.study.traffic import GRID_DATA, KINDS, LISTS, STATE, STENCIL, TRIANGLES
from clrast.visibility.grid_passes import TRAVERSE
from clrast.visibility.oracles import OracleChoice

CACHE_BYTES, LINE_BYTES = 64 << 10, 48
SET_COUNT = CACHE_BYTES // LINE_BYTES
"""Lines that the cache holds: 1365, and 16 bytes are left over."""

RECORD_FETCHES = (((48, 8),), ((48, 8), (36, 12)), ((48, 8), (36, 12), (0, 12), (12, 12), (24, 12), (56, 4)))
"""By how far a test reached: (first byte of the record, bytes) of each fetch, at most three floats, as a texel has."""

RECORD_BYTES = 64

_NUMBER = {kind: number for number, kind in enumerate(KINDS)}


@dataclass(frozen=True)
class Accesses:
    """Reads in their order. lines : (count,) int64, 48-byte lines of memory. kinds : (count,) uint8, into KINDS."""

    lines: np.ndarray
    kinds: np.ndarray

    def __len__(self) -> int:
        return len(self.lines)


@dataclass(frozen=True)
class HitRate:
    """Of one kind of data. reads : fetches. misses : lines that were brought."""

    reads: int
    misses: int

    @property
    def rate(self) -> float | None:
        return 1 - self.misses / self.reads if self.reads else None


def simulate(lines: np.ndarray, set_count: int = SET_COUNT) -> np.ndarray:
    """(count,) bool, whether each read finds its line: the last read of that set was of the same line."""
    order = np.argsort((lines % set_count).astype(np.uint16), kind="stable")
    sorted_lines = lines[order]
    hit = np.zeros(len(lines), dtype=bool)
    same = np.zeros(len(lines), dtype=bool)
    if len(lines):
        # Lines of other sets differ, so that where a set begins nothing is found.
        same[1:] = sorted_lines[1:] == sorted_lines[:-1]
    hit[order] = same
    return hit


def hit_rates(accesses: Accesses, set_count: int = SET_COUNT) -> dict[str, HitRate]:
    """By kind."""
    missed = ~simulate(accesses.lines, set_count)
    reads = np.bincount(accesses.kinds, minlength=len(KINDS))
    misses = np.bincount(accesses.kinds[missed], minlength=len(KINDS))
    return {kind: HitRate(int(reads[k]), int(misses[k])) for k, kind in enumerate(KINDS)}


class Memory:
    """Where things lie: grid, lists, triangles, then the rays' state, each from a line of its own on.

    cell_begin : (cell_count + 1,) uint32. triangle_count, pixel_count : of the scene, of the streams.
    """

    def __init__(self, cell_begin: np.ndarray, triangle_count: int, pixel_count: int) -> None:
        self.cell_begin = cell_begin.astype(np.int64)
        sizes = {
            "cell_begin": 4 * len(cell_begin),
            "references": 4 * int(cell_begin[-1]),
            "records": RECORD_BYTES * triangle_count,
            **{name: 4 * pixel_count for name in ("rays", "cells", "nearness", "visible_prims")},
            "cursors": 8 * pixel_count,
            "states": pixel_count,
        }
        self.base: dict[str, int] = {}
        place = 0
        for name, size in sizes.items():
            self.base[name] = place
            place += -(-size // LINE_BYTES) * LINE_BYTES

    def of_words(self, trace: Trace) -> tuple[np.ndarray, Accesses]:
        """The reads of each word of a trace: (word_count + 1,) where they begin, and the reads."""
        count = np.ones(len(trace.places), dtype=np.int64)
        for reached, fetches in enumerate(RECORD_FETCHES):
            count[trace.is_test & (trace.reached == reached)] = 1 + len(fetches)
        begin = np.concatenate([[0], np.cumsum(count)])
        address, kinds = np.zeros(begin[-1], dtype=np.int64), np.zeros(begin[-1], dtype=np.uint8)
        first = begin[:-1]
        cells = np.flatnonzero(~trace.is_test)
        address[first[cells]] = self.base["cell_begin"] + 4 * trace.places[cells]
        kinds[first[cells]] = _NUMBER[GRID_DATA]
        tests = np.flatnonzero(trace.is_test)
        last_cell = np.maximum.accumulate(np.where(trace.is_test, 0, np.arange(len(trace.places))))
        reference = self.cell_begin[trace.places[last_cell[tests]]] + tests - last_cell[tests] - 1
        address[first[tests]] = self.base["references"] + 4 * reference
        kinds[first[tests]] = _NUMBER[LISTS]
        for reached, fetches in enumerate(RECORD_FETCHES):
            own = tests[trace.reached[tests] == reached]
            for k, (offset, _) in enumerate(fetches):
                address[first[own] + 1 + k] = self.base["records"] + RECORD_BYTES * trace.places[own] + offset
                kinds[first[own] + 1 + k] = _NUMBER[TRIANGLES]
        return begin, Accesses(address // LINE_BYTES, kinds)

    def of_stream(self, name: str, places: np.ndarray) -> np.ndarray:
        """Lines of elements of an array of the rays' state."""
        size = {"cursors": 8, "states": 1}.get(name, 4)
        return (self.base[name] + size * places) // LINE_BYTES


def gather(begin: np.ndarray, which: np.ndarray) -> np.ndarray:
    """Places of all elements of the rows `which` of a table whose rows begin at `begin`."""
    lengths = begin[which + 1] - begin[which]
    starts = np.concatenate([[0], np.cumsum(lengths)])
    return np.repeat(begin[which] - starts[:-1], lengths) + np.arange(starts[-1])


def branching_accesses(memory: Memory, trace: Trace) -> Accesses:
    """Ray after ray, each to its end; its state stays in registers."""
    return memory.of_words(trace)[1]


READS = {"traverse": ("rays", "cells"), "intersect": ("rays", "nearness", "visible_prims", "cursors")}
"""State that a kernel reads of each ray, before its data."""


def multipass_accesses(
    memory: Memory,
    trace: Trace,
    choice: OracleChoice,
    steps: int,
    tests: int,
    tiles: Sequence[np.ndarray] | None = None,
) -> Accesses:
    """Pass after pass. tiles : rays of each tile, which is rendered to its end before the next; None: all at once."""
    parts = [trace] if tiles is None else [trace.chosen(rays) for rays in tiles]
    pieces = [piece for part in parts for piece in _passes_of(memory, part, choice, steps, tests)]
    if not pieces:
        return Accesses(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.uint8))
    return Accesses(np.concatenate([p.lines for p in pieces]), np.concatenate([p.kinds for p in pieces]))


def _passes_of(memory: Memory, trace: Trace, choice: OracleChoice, steps: int, tests: int) -> Iterator[Accesses]:
    begin, reads = memory.of_words(trace)
    owner = np.repeat(np.arange(trace.ray_count), np.diff(trace.begin))
    for each in run_passes(trace, choice, steps, tests):
        names = READS["traverse" if each.kind == TRAVERSE else "intersect"]
        place = np.arange(len(each.rays))
        lines = [memory.of_stream(name, place if name == "rays" else each.rays) for name in names]
        number = len(names)
        # A ray's state comes before its data: keys sort both into one stream.
        rank = np.zeros(trace.ray_count, dtype=np.int64)
        rank[each.rays] = place
        data = gather(begin, each.words)
        data_rank = np.repeat(rank[owner[each.words]], begin[each.words + 1] - begin[each.words])
        keys = np.concatenate([np.repeat(2 * place, number), 2 * data_rank + 1])
        order = np.argsort(keys, kind="stable")
        all_lines = np.concatenate([np.stack(lines, axis=1).ravel(), reads.lines[data]])
        kinds = np.concatenate([np.full(number * len(place), _NUMBER[STATE], dtype=np.uint8), reads.kinds[data]])
        yield Accesses(all_lines[order], kinds[order])
        # Compaction reads the numbers and the states again.
        again = np.stack([memory.of_stream("states", place), memory.of_stream("rays", place)], axis=1).ravel()
        yield Accesses(again, np.tile(np.array([_NUMBER[STENCIL], _NUMBER[STATE]], dtype=np.uint8), len(place)))


def tiles_of(trace: Trace, width: int, side: int) -> list[np.ndarray]:
    """Rays of each square of `side` pixels, row by row."""
    x, y = trace.pixels % width, trace.pixels // width
    number = y // side * (-(-width // side)) + x // side
    order = np.argsort(number, kind="stable")
    cuts = np.flatnonzero(np.diff(number[order])) + 1
    return np.split(order, cuts)
