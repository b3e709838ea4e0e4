"""What Davidovic et al., '3D Rasterization', section 5, found on their machines, and whether it holds on this one.

The paper gives its findings in words and in bars without numbers; where a word needs a number to be judged by, that
number is ours and stands below. Scenes are those of study/suite.py, of the kinds that the paper measured.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from statistics import median
from typing import Any, Protocol

from clrast.study.compare import Comparison

HOLDS = "holds"
FAILS = "does not hold here"
NOT_MEASURED = "not measured"

FOLLOWS = 0.15
"""'Closely matching': the ratio of times lies within this of the ratio of instructions."""
COMPARABLE = 2.0
"""'Comparable': neither takes more than this many times the other's time."""
HALVED = 0.6
"""'Half' of the evaluations: at most this share."""
EQUAL = 0.05
"""'The same speed': times within this share."""
LOOSER = 1.02
"""A screen bound is looser where it costs more than this many times the evaluations."""


class SceneKind(Protocol):
    """What of a scene matters to a finding; study/suite.py says it of each of its scenes."""

    @property
    def tiny(self) -> bool: ...
    @property
    def occluded(self) -> bool: ...


@dataclass(frozen=True)
class Measured:
    """The whole table: comparisons and kinds by scene."""

    comparisons: Mapping[str, Comparison]
    kinds: Mapping[str, SceneKind]

    def scenes(self, *, tiny: bool | None = None, occluded: bool | None = None) -> tuple[str, ...]:
        """Names of the scenes of a kind, None for any."""
        return tuple(
            name
            for name in self.comparisons
            if (tiny is None or self.kinds[name].tiny == tiny)
            and (occluded is None or self.kinds[name].occluded == occluded)
        )

    def times(self, method: str, base: str, scenes: Sequence[str] | None = None) -> dict[str, float]:
        """Scene -> time of `method` over that of `base`, where both were measured."""
        chosen = self.comparisons if scenes is None else scenes
        ratios = {name: self.comparisons[name].time_ratio(method, base) for name in chosen}
        return {name: ratio for name, ratio in ratios.items() if ratio is not None}

    def instructions(self, method: str, base: str) -> dict[str, float]:
        ratios = {name: each.instruction_ratio(method, base) for name, each in self.comparisons.items()}
        return {name: ratio for name, ratio in ratios.items() if ratio is not None}

    def evaluations(self, method: str, base: str, scenes: Sequence[str] | None = None) -> dict[str, float]:
        chosen = self.comparisons if scenes is None else scenes
        ratios = {name: self.comparisons[name].evaluation_ratio(method, base) for name in chosen}
        return {name: ratio for name, ratio in ratios.items() if ratio is not None}


@dataclass(frozen=True)
class Judgement:
    """`holds` : None where what it takes was not measured. figures : the numbers it rests on, a line each."""

    holds: bool | None
    figures: tuple[str, ...] = ()


@dataclass(frozen=True)
class Finding:
    """text : the finding in our words. section : of the paper. reason : why it does not hold here, where known."""

    name: str
    text: str
    section: str
    judge: Callable[[Measured], Judgement]
    reason: str = ""


@dataclass(frozen=True)
class Verdict:
    """What became of a finding. `reason` is empty unless the finding does not hold and the reason is known."""

    name: str
    text: str
    section: str
    verdict: str
    figures: tuple[str, ...]
    reason: str = ""

    def as_dict(self) -> dict[str, Any]:
        return {**asdict(self), "figures": list(self.figures)}


def judge_findings(measured: Measured) -> tuple[Verdict, ...]:
    """A verdict on every finding, in the paper's order."""
    verdicts = []
    for finding in FINDINGS:
        judged = finding.judge(measured)
        verdict = NOT_MEASURED if judged.holds is None else HOLDS if judged.holds else FAILS
        reason = finding.reason if verdict == FAILS else ""
        verdicts.append(Verdict(finding.name, finding.text, finding.section, verdict, judged.figures, reason))
    return tuple(verdicts)


def _line(what: str, ratios: Mapping[str, float]) -> str:
    return f"{what}: " + ", ".join(f"{scene} {ratio:.2f}" for scene, ratio in ratios.items())


def _time_line(measured: Measured, method: str, base: str, scenes: Mapping[str, float]) -> str:
    """Ratios of times; those whose spreads overlap, so that chance may decide, carry a question mark."""
    parts = []
    for scene, ratio in scenes.items():
        unclear = "" if measured.comparisons[scene].is_clear(method, base) else "?"
        parts.append(f"{scene} {ratio:.2f}{unclear}")
    legend = " (? within the spread of the times)" if any(part.endswith("?") for part in parts) else ""
    return f"time, {method} / {base}: {', '.join(parts)}{legend}"


def _most(truths: Sequence[bool]) -> bool:
    return sum(truths) > len(truths) / 2


def _fewer_instructions(measured: Measured) -> Judgement:
    ratios = measured.instructions("3dr-brute", "2dr-brute")
    if not ratios:
        return Judgement(None)
    return Judgement(all(r < 1 for r in ratios.values()), (_line("instructions, 3dr-brute / 2dr-brute", ratios),))


def _time_follows(measured: Measured) -> Judgement:
    counted = measured.instructions("3dr-brute", "2dr-brute")
    times = {name: t for name, t in measured.times("3dr-brute", "2dr-brute").items() if name in counted}
    if not times:
        return Judgement(None)
    close = [abs(ratio - counted[name]) <= FOLLOWS for name, ratio in times.items()]
    lines = (
        _time_line(measured, "3dr-brute", "2dr-brute", times),
        _line("instructions, 3dr-brute / 2dr-brute", counted),
    )
    return Judgement(_most(close), lines)


def _brute_faster(measured: Measured) -> Judgement:
    times = measured.times("3dr-brute", "2dr-brute")
    if not times:
        return Judgement(None)
    return Judgement(_most([r < 1 for r in times.values()]), (_time_line(measured, "3dr-brute", "2dr-brute", times),))


def _loose_bounds(measured: Measured) -> Judgement:
    ratios = measured.evaluations("3dr-brute", "2dr-brute")
    times = measured.times("3dr-brute", "2dr-brute")
    if not ratios:
        return Judgement(None)
    slower = [times.get(name, 0.0) > 1 for name, ratio in ratios.items() if ratio > LOOSER]
    return Judgement(any(slower), (_line("edge evaluations, 3dr-brute / 2dr-brute", ratios),))


def _binning_does_not_pay(measured: Measured) -> Judgement:
    pairs = (("2dr-binning", "2dr-brute"), ("3dr-binning", "3dr-brute"))
    found = {pair: ratios for pair in pairs if (ratios := measured.times(*pair))}
    if not found:
        return Judgement(None)
    lines = tuple(_time_line(measured, a, b, ratios) for (a, b), ratios in found.items())
    return Judgement(all(_most([r > 1 for r in ratios.values()]) for ratios in found.values()), lines)


HIERARCHICAL = ("3dr-frustum-cull", "3dr-frustum-split", "3dr-full")
SPLITTING = ("3dr-frustum-split", "3dr-full")
RAY_CASTER = "raycast-bvh"
"""Stands for the coherent ray tracer that the paper compares with, on the same BVH and edges."""


def _comparable(measured: Measured) -> Judgement:
    """By the method of the three that is in the middle."""
    found: dict[str, list[float]] = {}
    for method in HIERARCHICAL:
        for scene, ratio in measured.times(method, RAY_CASTER).items():
            found.setdefault(scene, []).append(ratio)
    middle = {scene: median(ratios) for scene, ratios in found.items()}
    if not middle:
        return Judgement(None)
    near = [1 / COMPARABLE <= ratio <= COMPARABLE for ratio in middle.values()]
    return Judgement(_most(near), (_line(f"time, the middle one of {', '.join(HIERARCHICAL)} / {RAY_CASTER}", middle),))


def _splitting_wins(measured: Measured) -> Judgement:
    scenes = measured.scenes(tiny=True)
    found = {method: ratios for method in SPLITTING if (ratios := measured.times(method, RAY_CASTER, scenes))}
    if len(found) < len(SPLITTING):
        return Judgement(None)
    lines = tuple(_time_line(measured, method, RAY_CASTER, ratios) for method, ratios in found.items())
    return Judgement(all(_most([r < 1 for r in ratios.values()]) for ratios in found.values()), lines)


def _early_w(measured: Measured) -> Judgement:
    times = measured.times("3dr-full", "3dr-frustum-split", measured.scenes(tiny=True, occluded=True))
    if not times:
        return Judgement(None)
    line = _time_line(measured, "3dr-full", "3dr-frustum-split", times)
    return Judgement(_most([r < 1 for r in times.values()]), (line,))


def _fewer_evaluations(measured: Measured) -> Judgement:
    ratios = measured.evaluations("3dr-full", "3dr-binning", measured.scenes(occluded=True))
    if not ratios:
        return Judgement(None)
    halved = [ratio <= HALVED for ratio in ratios.values()]
    return Judgement(_most(halved), (_line("edge evaluations, 3dr-full / 3dr-binning", ratios),))


def _homogeneous_equal(measured: Measured) -> Judgement:
    equal, ahead = measured.times("2dh-brute", "3dr-brute"), measured.times("2dh-brute", "2dr-brute")
    if not equal or not ahead:
        return Judgement(None)
    lines = (
        _time_line(measured, "2dh-brute", "3dr-brute", equal),
        _time_line(measured, "2dh-brute", "2dr-brute", ahead),
    )
    same = _most([abs(ratio - 1) <= EQUAL for ratio in equal.values()])
    return Judgement(same and _most([ratio < 1 for ratio in ahead.values()]), lines)


FINDINGS = (
    Finding(
        "fewer instructions",
        "3D edges need fewer instructions a frame than projected 2D edges, both by brute force.",
        "section 5, Fig. 9 and 10",
        _fewer_instructions,
    ),
    Finding(
        "time follows instructions",
        "What 3D edges gain over 2D edges in time is what they gain in instructions.",
        "section 5",
        _time_follows,
    ),
    Finding(
        "brute force is faster in 3D",
        "By brute force 3D edges are faster than 2D edges in most scenes.",
        "section 5",
        _brute_faster,
    ),
    Finding(
        "loose bounds inside a hall",
        "Seen from inside a hall 3D brute force loses: a few triangles have no tight screen bound and are tested on "
        "the whole screen.",
        "section 5",
        _loose_bounds,
        reason="the bound of a triangle that crosses the plane of the eye is the image's rectangle clipped by the "
        "triangle's own edge functions (cl/setup_triangles.cl), and all methods share it",
    ),
    Finding(
        "binning does not pay",
        "On a processor hierarchical binning costs more than it saves at the average size of these triangles.",
        "section 5",
        _binning_does_not_pay,
    ),
    Finding(
        "level with ray casting",
        "3D rasterization through a BVH takes about the time of coherent ray casting.",
        "section 5",
        _comparable,
    ),
    Finding(
        "splitting wins on tiny triangles",
        "Where triangles are tiny, adaptive splitting, alone or in full, beats coherent ray casting.",
        "section 5",
        _splitting_wins,
    ),
    Finding(
        "early w adds a little",
        "Where most is hidden, early w culling makes full faster than splitting alone.",
        "section 5",
        _early_w,
    ),
    Finding(
        "half the evaluations",
        "Where most is hidden, occlusion culling leaves half of the edge evaluations of binning or less (the paper "
        "shows them as pictures, without a number).",
        "Fig. 1",
        _fewer_evaluations,
    ),
    Finding(
        "homogeneous edges are level",
        "Homogeneous 2D edges are as fast as 3D edges, and both faster than projected ones (the paper measured this "
        "on a graphics card).",
        "section 5, Fig. 10",
        _homogeneous_equal,
    ),
)
