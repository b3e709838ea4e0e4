"""The hard cases on a device: each image by each method and rung against the exact answer, sample by sample.

What is right comes from exact_visibility.py, which shares nothing with the kernels; wrong_samples.py names the kinds
of what is wrong. A rung is held to its promise, whatever a case expects of it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from clrast.errors import EXIT_BAD_INPUT, UsageError
from clrast.opencl.device import open_device
from clrast.opencl.features import Edges
from clrast.options import AVAILABLE_METHODS, AVAILABLE_PRECISIONS, RenderOptions, make_options
from clrast.scene.camera import camera_vectors
from clrast.scene.model import Camera, Scene
from clrast.study.classify_visibility import Classifier, Difference
from clrast.study.double_hits import double_hits
from clrast.study.exact_visibility import ExactVisibility, exact_visibility
from clrast.study.hard_case import HardCase
from clrast.study.hard_cases import REFUSALS, make_case
from clrast.study.stress_views import View, views_of
from clrast.study.wrong_samples import DEPTH, KINDS, VISIBLE, judge
from clrast.visibility.loop_limits import loop_limit
from clrast.visibility.methods import AUTO, METHODS

PROMISES: Mapping[str, tuple[str, ...]] = {"exact": VISIBLE, "midpoint": ("hole", "double hit")}
"""Rung -> the kinds of wrong samples that it promises never to give; others promise nothing, and Z is a float32 number
by the same formula in all."""

REPRODUCE = "clrast stress --case {case} --precision {precision} --method {method} --failures DIR"
"""The command that makes one case's wrong images again, with its cards."""

Show = Callable[[str], None]


@dataclass(frozen=True)
class Finding:
    """One image, and the methods that all made it.

    kinds : (height, width) uint8, 0 where the sample is right, else 1 + the place in KINDS
    details : (kind, place) as in classify_visibility.py -> samples
    """

    case: str
    view: View
    precision: str
    methods: tuple[str, ...]
    prim_id: np.ndarray
    depth: np.ndarray
    kinds: np.ndarray
    details: Mapping[tuple[str, str], int] = field(default_factory=dict)

    @property
    def sample_count(self) -> int:
        """Samples of one image."""
        return self.kinds.size

    @property
    def counts(self) -> dict[str, int]:
        """Wrong samples of one image by kind."""
        numbers = np.bincount(self.kinds.reshape(-1), minlength=len(KINDS) + 1)
        return {kind: int(numbers[k + 1]) for k, kind in enumerate(KINDS)}

    @property
    def wrong_count(self) -> int:
        """Samples of one image that show the wrong triangle."""
        return sum(n for kind, n in self.counts.items() if kind != DEPTH)

    @property
    def broken(self) -> dict[str, int]:
        """Kinds that the rung promises never to give -> how many there are."""
        counts = self.counts
        return {kind: counts[kind] for kind in PROMISES.get(self.precision, ()) if counts[kind]}

    def first_wrong(self, kinds: Sequence[str] = KINDS) -> tuple[int, int] | None:
        """(column, row) of the first wrong sample of some kinds."""
        rows, columns = np.nonzero(np.isin(self.kinds, [1 + KINDS.index(kind) for kind in kinds]))
        return (int(columns[0]), int(rows[0])) if len(rows) else None

    def as_dict(self) -> dict[str, Any]:
        """The figures, without the images."""
        return {
            "case": self.case,
            "view": self.view.name,
            "precision": self.precision,
            "methods": list(self.methods),
            "samples": self.sample_count,
            "wrong": self.wrong_count,
            "kinds": self.counts,
            "details": {f"{kind}, {place}": n for (kind, place), n in sorted(self.details.items())},
            "broken": self.broken,
        }


@dataclass(frozen=True)
class Plan:
    """What to check.

    options : of the machine, for every render. must_have : a rung that the device lacks is an error.
    """

    precisions: tuple[str, ...]
    methods: tuple[str, ...]
    options: Mapping[str, Any] = field(default_factory=dict)
    long: bool = False
    must_have: bool = False

    def check(self) -> None:
        """Raises UsageError where no method takes any of the rungs."""
        if not any(is_offered(method, precision) for method in self.methods for precision in self.precisions):
            rungs, methods = ",".join(self.precisions), ",".join(self.methods)
            raise UsageError(f"--precision {rungs} is not offered with --method {methods}: give another")


@dataclass(frozen=True)
class Refused:
    """What became of an input that must be refused. exit_code : of the error, None where it was taken."""

    name: str
    exit_code: int | None

    @property
    def is_right(self) -> bool:
        return self.exit_code == EXIT_BAD_INPUT


@dataclass(frozen=True)
class Stress:
    """A whole run."""

    device: str
    plan: Plan
    cases: tuple[HardCase, ...]
    findings: tuple[Finding, ...]
    refused: tuple[Refused, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def broken(self) -> tuple[Finding, ...]:
        return tuple(finding for finding in self.findings if finding.broken)

    @property
    def is_broken(self) -> bool:
        return bool(self.broken) or not all(one.is_right for one in self.refused)

    def total(self, precision: str) -> tuple[int, int]:
        """(wrong samples of the kinds that the rung promises never to give, samples), over all methods."""
        images = [finding for finding in self.findings if finding.precision == precision]
        wrong = sum(len(each.methods) * sum(each.broken.values()) for each in images)
        return wrong, sum(len(each.methods) * each.sample_count for each in images)

    def unexpected(self) -> list[tuple[HardCase, str, int]]:
        """(case, rung, wrong samples) where 3D edges are not as the case expects, in its own views."""
        found = []
        for case in self.cases:
            for precision in self.plan.precisions:
                images = [
                    each for each in self.findings
                    if (each.case, each.precision, each.view.is_extra) == (case.name, precision, False)
                    and any(METHODS[name].edges == Edges.SPATIAL for name in each.methods if name in METHODS)
                ]  # fmt: skip
                wrong = sum(each.wrong_count for each in images)
                if images and (precision in case.right and wrong or precision in case.wrong and not wrong):
                    found.append((case, precision, wrong))
        return found

    def as_dict(self) -> dict[str, Any]:
        """Everything but the images, for JSON."""
        return {
            "device": self.device,
            "precisions": list(self.plan.precisions),
            "methods": list(self.plan.methods),
            "rows": [finding.as_dict() for finding in self.findings],
            "refused": [{"case": one.name, "exit_code": one.exit_code} for one in self.refused],
            "promises": [
                {"precision": name, "never": list(PROMISES[name]), "wrong": wrong, "samples": samples}
                for name in self.plan.precisions if name in PROMISES
                for wrong, samples in [self.total(name)]
            ],
            "broken": self.is_broken,
        }  # fmt: skip


def choose_precisions(names: Sequence[str] | None = None) -> tuple[str, ...]:
    """Rungs in the order of the ladder; None: all that there are."""
    if names is None:
        return AVAILABLE_PRECISIONS
    wanted = {make_options({"precision": name}, whole=False).precision for name in names}
    return tuple(name for name in AVAILABLE_PRECISIONS if name in wanted)


SLOW_METHODS = ("raycast-grid-multipass",)
"""Left to `--long` where no method is named: its passes take a third of all time, over the cells of raycast-grid."""


def choose_methods(names: Sequence[str] | None = None, long: bool = True) -> tuple[str, ...]:
    """Methods in the order of the table; None: all, the slow ones with `long` alone. `auto` can be named."""
    if names is None:
        left_out = (AUTO,) if long else (AUTO, *SLOW_METHODS)
        return tuple(name for name in AVAILABLE_METHODS if name not in left_out)
    wanted = {make_options({"method": name}, whole=False).method for name in names}
    return tuple(name for name in AVAILABLE_METHODS if name in wanted)


def is_offered(method: str, precision: str) -> bool:
    """Whether a render takes this method with this rung."""
    try:
        make_options({"method": method, "precision": precision})
    except UsageError:
        return False
    return True


def render_frame(scene: Scene, camera: Camera, options: RenderOptions) -> tuple[np.ndarray, np.ndarray]:
    """(prim_id, Z) of a render."""
    from clrast.renderer import render

    frame = render(scene, camera, options=options)
    return frame["id.prim"], frame["Z"]


def run_stress(names: Sequence[str], plan: Plan, show: Show = lambda text: None) -> Stress:
    """Check the cases and refusals of those names."""
    device = open_device(plan.options.get("device"), plan.options.get("threads"))
    notes = []
    if "double" in plan.precisions and not device.has_fp64 and not plan.must_have:
        notes.append(f"double is left out: {device.name} has no float64")
        plan = replace(plan, precisions=tuple(name for name in plan.precisions if name != "double"))
    grids = [name for name in plan.methods if name in METHODS and METHODS[name].grid]
    if loop_limit(device) is not None and len(grids) < len(plan.methods) and grids:
        notes.append(f"{' and '.join(grids)} are left out: {device.name} ends long loops early")
        plan = replace(plan, methods=tuple(name for name in plan.methods if name not in grids))
    cases, findings, refused = [], [], []
    for name in names:
        if name in REFUSALS:
            refused.append(Refused(name, REFUSALS[name].exit_code()))
            continue
        show(f"{name}: making")
        cases.append(make_case(name))
        findings += check_case(cases[-1], plan, show)
    return Stress(device.name, plan, tuple(cases), tuple(findings), tuple(refused), tuple(notes))


def check_case(case: HardCase, plan: Plan, show: Show = lambda text: None) -> list[Finding]:
    """Every view of a case by every rung and method of the plan."""
    found: list[Finding] = []
    scene = case.scene()
    for view in views_of(case, plan.long):
        vectors = camera_vectors(view.camera, *view.size).named()
        show(f"{case.name}, {view.name}: exact arithmetic")
        exact = exact_visibility(scene.positions, scene.triangles, vectors, *view.size)
        classifier = Classifier(scene.positions, scene.triangles, vectors)
        for precision in plan.precisions:
            show(f"{case.name}, {view.name}: {precision}")
            found += _check_rung(scene, view, classifier, vectors, exact, precision, plan)
    return found


def _check_rung(
    scene: Scene,
    view: View,
    classifier: Classifier,
    vectors: Mapping[str, Sequence[float]],
    exact: ExactVisibility,
    precision: str,
    plan: Plan,
) -> list[Finding]:
    """The images of one rung, those that are equal as one."""
    doubles: dict[Any, list[Difference]] = {}
    groups: dict[Any, tuple[np.ndarray, np.ndarray, list[str]]] = {}
    for method in plan.methods:
        if not is_offered(method, precision):
            continue
        options = make_options({
            **plan.options, "method": method, "precision": precision, "size": view.size, "aov": ("id", "depth"),
        })  # fmt: skip
        prim_id, depth = render_frame(scene, view.camera, options)
        # Whether a triangle covers a sample is a matter of its edges alone: methods that share them share this.
        edges = method if plan.long or method == AUTO else METHODS[method].edges
        if edges not in doubles:
            doubles[edges] = _double_hits(scene, view, classifier, vectors, options)
        twice = tuple(sorted({(one.x, one.y, one.place) for one in doubles[edges]}))
        key = (prim_id.tobytes(), depth.tobytes(), twice)
        groups.setdefault(key, (prim_id, depth, []))[2].append(method)
    findings = []
    for (_, _, twice), (prim_id, depth, methods) in groups.items():
        kinds, details = judge(scene, vectors, exact, prim_id, depth, twice, classifier)
        findings.append(Finding(scene.name, view, precision, tuple(methods), prim_id, depth, kinds, details))
    return findings


def _double_hits(
    scene: Scene,
    view: View,
    classifier: Classifier,
    vectors: Mapping[str, Sequence[float]],
    options: RenderOptions,
) -> list[Difference]:
    def render(chosen: np.ndarray) -> np.ndarray:
        rows = {name: getattr(scene, name)[chosen] for name in ("triangles", "object_ids", "material_ids")}
        return render_frame(replace(scene, **rows), view.camera, options)[0]

    return double_hits(render, scene.positions, scene.triangles, vectors, classifier)
