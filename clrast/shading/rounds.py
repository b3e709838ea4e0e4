"""Which samples of a listed pixel are looked at and shaded, round by round, where strata.py samples it.

auto: 16, 32, 64 .. 256 samples, a quarter of them shaded where their surface is open.
msaa:S and csaa:S+C with shading rate auto: all S + C samples at once; beside the centre a quarter of S is shaded, then
all S where their surface is open. So no pixel has more than S + 1 shaded, however hard it is, but for one of each
surface that coverage samples alone show; samples of a crowd (cl/strata.clh) are each one of a surface.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from clrast.opencl.constants import VISIT_SAMPLES
from clrast.visibility.sample_patterns import Antialiasing, Position, scrambled

SHADED_SHARE = 4
"""Of so many samples whose visibility is known one is shaded before more are called for."""

VISITS_AT_ONCE = 4
"""Visits of the listed pixels whose samples are kept at once, beside the first of all pixels."""

EDGE_ERROR = 0.9
"""Of the deviation between a pixel's surfaces by N^(3/4), the error of N samples: straight edges through the pixel have
0.78 of it with 16 samples of this pattern, and 0.89 with 256, the most."""

LONE_DEVIATION = 0.25
"""Of the colours of a surface of which one sample was shaded, which tells nothing; evenly from 0 to 1 it is 0.29."""

FOOTPRINT = 0.25
"""Side of what a sample of a listed pixel stands for, pixels: that of one in 16. For the first samples finer ones than
that are as good, and with coarser ones the error stops to fall where textures are blurred."""


@dataclass(frozen=True)
class Visit:
    """VISIT_SAMPLES samples, by number. lanes, shaded, seconds : a bit for each that is one, that is shaded where its
    surface is open, and that may be the second of its surface. is_new : whether they are counted now."""

    number: int
    lanes: int
    shaded: int
    seconds: int
    is_new: bool

    @property
    def most_shaded(self) -> int:
        """A bit for each sample that is shaded in some pixel: of many surfaces, each new sample is."""
        return self.lanes if self.is_new else self.shaded


@dataclass(frozen=True)
class Rounds:
    """samples : of a pixel that are known at the end of each round; shaded : the first so many may be then.

    positions : of whole visits. seconds : the first so many samples may be the second of a surface that is shaded; the
    first may be any. threshold : estimated error from which on a pixel goes on. footprint : side of what a
    shaded sample stands for, pixels. uses_center : the colour of the centre is that of a sample of its surface.
    """

    positions: tuple[Position, ...]
    seconds: int
    samples: tuple[int, ...]
    shaded: tuple[int, ...]
    threshold: float
    footprint: float
    uses_center: bool

    def threshold_of(self, number: int) -> float:
        """Error that ends a pixel after a round: any after the last."""
        return self.threshold if number + 1 < len(self.samples) else math.inf

    def edge_error(self, number: int) -> float:
        """Error of the shares of a pixel's surfaces by the deviation between them, which more samples would lessen."""
        if self.samples[number] == self.samples[-1]:
            return 0.0
        return EDGE_ERROR * math.pow(self.samples[number], -0.75)

    def lone_samples(self, number: int) -> int:
        """So many samples of a surface after a round are so small a share that one that is shaded is enough."""
        return min(int(self.samples[number] * self.threshold / (0.5 * LONE_DEVIATION)), self.samples[number])

    def visits(self, number: int) -> list[Visit]:
        """What a round looks at: new samples, then known ones of which more may be shaded."""
        known, known_shaded = (self.samples[number - 1], self.shaded[number - 1]) if number else (0, 0)
        new: list[Visit] = []
        old: list[Visit] = []
        for k in range(-(-self.samples[number] // VISIT_SAMPLES)):
            is_new = known <= VISIT_SAMPLES * k
            shaded = _bits(known_shaded, self.shaded[number], k)
            if is_new or shaded:
                lanes, seconds = _bits(0, self.samples[number], k), _bits(0, self.seconds, k)
                visit = Visit(k, lanes, shaded, lanes & seconds, is_new)
                (new if is_new else old).append(visit)
        return new + old

    def parts(self, number: int) -> list[list[Visit]]:
        """The visits of a round in parts of as many as are kept at once; samples of the first are kept always."""
        parts: list[list[Visit]] = [[]]
        for visit in self.visits(number):
            if visit.number != 0 and sum(other.number != 0 for other in parts[-1]) == VISITS_AT_ONCE:
                parts.append([])
            parts[-1].append(visit)
        return parts

    def all_parts(self) -> Iterator[list[Visit]]:
        for number in range(len(self.samples)):
            yield from self.parts(number)

    @property
    def worst_shaded(self) -> int:
        """Samples of a listed pixel that may be shaded at once: all new ones, and known ones that a round names."""
        return max(sum(visit.most_shaded.bit_count() for visit in part) for part in self.all_parts())

    @property
    def worst_visits(self) -> int:
        """Visits whose samples are kept at once, beside the first."""
        return max(sum(visit.number != 0 for visit in part) for part in self.all_parts())


def _bits(first: int, end: int, visit: int) -> int:
    """Of the samples from `first` to `end` - 1 those of a visit, a bit each."""
    return sum(1 << k for k in range(VISIT_SAMPLES) if first <= VISIT_SAMPLES * visit + k < end)


def rounds_of(wanted: Antialiasing) -> Rounds:
    """The rounds of a mode that has a threshold."""
    count = len(wanted.pattern)
    if wanted.kind == "auto":
        samples = tuple(VISIT_SAMPLES << k for k in range((count // VISIT_SAMPLES).bit_length()))
        shaded = tuple(n // SHADED_SHARE for n in samples)
        return Rounds(wanted.pattern.positions, count, samples, shaded, wanted.threshold, FOOTPRINT, uses_center=False)
    # Few of the samples are to be a pattern too, as those of scrambled are. Lanes that do not count have positions.
    positions = scrambled(-(-count // VISIT_SAMPLES) * VISIT_SAMPLES).positions
    most = wanted.depth_count
    shaded = tuple(sorted({max(1, most // SHADED_SHARE), most}))
    footprint = 1.0 / math.sqrt(most)
    return Rounds(positions, most, (count,) * len(shaded), shaded, wanted.threshold, footprint, uses_center=True)
