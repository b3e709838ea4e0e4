"""What the rays of a frame read, one word after the other, and the passes that they would take.

Purcell et al., 'Ray Tracing on Programmable Graphics Hardware', section 4.1: functional simulators whose traces of
memory references the costs are counted from. Here the branching kernel itself writes down which cells each ray entered
and which triangles it was tested against; passes under any oracle follow from that (the device's are as many: a test).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from clrast.opencl.layout import TRACE_EVALUATED, TRACE_IN_BOUND, TRACE_TEST
from clrast.visibility.grid_passes import INTERSECT, TRAVERSE, PassCounts, choose_pass
from clrast.visibility.oracles import OracleChoice


@dataclass(frozen=True)
class Trace:
    """Rays and their words.

    begin : (ray_count + 1,) int64, where each ray's words begin. places : (word_count,) int64, cell or prim_id.
    is_test : (word_count,) bool, whether the word is a triangle that was tested, else a cell that was entered.
    reached : (word_count,) uint8, of a test: 0 its bound alone was read, 1 its nearness too, 2 its edges too.
    pixels : (ray_count,) int64, pixel of the image of each ray.
    """

    begin: np.ndarray
    places: np.ndarray
    is_test: np.ndarray
    reached: np.ndarray
    pixels: np.ndarray

    @property
    def ray_count(self) -> int:
        return len(self.begin) - 1

    @property
    def steps(self) -> np.ndarray:
        """(ray_count,) int64, cells that each ray entered."""
        return self._sums(~self.is_test)

    @property
    def tests(self) -> np.ndarray:
        """(ray_count,) int64, triangles that each ray was tested against."""
        return self._sums(self.is_test)

    def _sums(self, wanted: np.ndarray) -> np.ndarray:
        total = np.concatenate([[0], np.cumsum(wanted, dtype=np.int64)])
        return total[self.begin[1:]] - total[self.begin[:-1]]

    def chosen(self, rays: np.ndarray) -> Trace:
        """The trace of these rays alone, in that order."""
        lengths = (self.begin[1:] - self.begin[:-1])[rays]
        begin = np.concatenate([[0], np.cumsum(lengths)])
        where = np.repeat(self.begin[:-1][rays] - begin[:-1], lengths) + np.arange(begin[-1])
        return Trace(begin, self.places[where], self.is_test[where], self.reached[where], self.pixels[rays])


def make_trace(counts: np.ndarray, words: np.ndarray) -> Trace:
    """From what GridRaycaster.trace returns."""
    begin = np.concatenate([[0], np.cumsum(counts, dtype=np.int64)])
    is_test = (words & np.uint32(TRACE_TEST)) != 0
    flags = np.uint32(TRACE_TEST | TRACE_IN_BOUND | TRACE_EVALUATED)
    places = np.where(is_test, words & ~flags, words).astype(np.int64)
    reached = ((words & np.uint32(TRACE_IN_BOUND)) != 0).astype(np.uint8) + ((words & np.uint32(TRACE_EVALUATED)) != 0)
    reached[~is_test] = 0
    return Trace(begin, places, is_test, reached, np.arange(len(counts), dtype=np.int64))


@dataclass(frozen=True)
class Pass:
    """One pass: its kind, the rays in it, and the words that they read, in the order of the stream and of the loop.

    rays : (active,) int64, in the order of the stream. words : (word_count,) int64, places in the trace, ray by ray.
    """

    kind: str
    rays: np.ndarray
    words: np.ndarray


def run_passes(trace: Trace, choice: OracleChoice, steps: int = 1, tests: int = 1) -> Iterator[Pass]:
    """The passes of cl/pass_rays.cl over these rays; streams are in the order of the rays' numbers.

    steps, tests : how often the loops of a traversal pass and of an intersection pass run for each ray.
    """
    place, end = trace.begin[:-1].copy(), trace.begin[1:]
    active = np.flatnonzero(place < end)
    streams = {TRAVERSE: active, INTERSECT: active[:0]}
    while len(streams[TRAVERSE]) or len(streams[INTERSECT]):
        kind = choose_pass(choice, len(streams[TRAVERSE]), len(streams[INTERSECT]))
        rays, read = streams[kind], []
        wants_test = kind == INTERSECT
        going = rays
        for _ in range(tests if wants_test else steps):
            read.append(place[going])
            place[going] += 1
            going = going[place[going] < end[going]]
            going = going[trace.is_test[place[going]] == wants_test]
            if not len(going):
                break
        yield Pass(kind, rays, _interleaved(trace, read))
        left = rays[place[rays] < end[rays]]
        tested = trace.is_test[place[left]]
        other = TRAVERSE if wants_test else INTERSECT
        streams[kind] = left[tested == wants_test]
        streams[other] = np.union1d(streams[other], left[tested != wants_test])


def _interleaved(trace: Trace, read: list[np.ndarray]) -> np.ndarray:
    """Places of words ray by ray: a ray's own words follow each other in the trace."""
    return np.sort(np.concatenate(read)) if len(read) > 1 else read[0]


def count_passes(trace: Trace, choice: OracleChoice, steps: int = 1, tests: int = 1) -> PassCounts:
    """Passes by kind and the rays in them; `other` is the eye rays' one."""
    counts = PassCounts(other=1, rays=trace.ray_count)
    for each in run_passes(trace, choice, steps, tests):
        if each.kind == TRAVERSE:
            counts.traverse += 1
            counts.rays_traverse += len(each.rays)
        else:
            counts.intersect += 1
            counts.rays_intersect += len(each.rays)
    return counts
