"""Every knob that trades accuracy for time, as one table: a new knob is a new row, and nothing else changes.

A setting is the scene's own options with those of one value of a knob, or of one combination, in their place. What this
version refuses is left out with its reason, so that a row may stand here before its option does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from clrast.errors import UsageError
from clrast.options import OPTION_NAMES, RenderOptions

Changes = Mapping[str, Any]
"""Options of a render by name, which take the place of the scene's own; effects, a mapping, only of those named."""

DEFAULT = "default"
"""Name of the setting that changes nothing."""
COMBINATION = "combination"
"""Stands for the knob of settings that turn several."""
REFERENCE_SAMPLES = 1024
REFERENCE_RATIO = 4
"""The reference has so many times the samples of a setting at least, as those of ssaa are among its own."""
CONVERGENCE = 0.75
"""The error of N samples falls with N to this power: edges in a stratified pattern."""
CONVERGENCE_OF_PATHS = 0.5
"""Likewise of N random paths."""
PATH = "path"
"""The mode in which `--samples` counts the paths of each shaded sample."""


@dataclass(frozen=True)
class Knob:
    """One row of the table. settings : from cheap to dear. reference : what the reference takes of it.

    modes : those of `--mode` in which it acts; none stands for all.
    """

    name: str
    settings: tuple[Changes, ...]
    reference: Changes = field(default_factory=dict)
    modes: tuple[str, ...] = ()


def _values(option: str, *values: Any, **more: Any) -> tuple[Changes, ...]:
    return tuple({option: value, **more} for value in values)


KNOBS = (
    Knob(
        "precision",
        _values("precision", "fast", "ordered", "midpoint", "fixed", "double", "exact"),
        {"precision": "exact"},
    ),
    Knob("evaluation", _values("evaluation", "direct", "incremental"), {"evaluation": "direct"}),
    Knob(
        "antialiasing",
        (
            *_values(
                "aa", "none", "msaa:2", "msaa:4", "msaa:8", "msaa:16", "msaa:32", "csaa:4+4", "csaa:4+12", "csaa:8+8",
                "ssaa:2", "ssaa:4", "ssaa:8", "ssaa:16", "ssaa:64", "ssaa:256", "auto:0.1", "auto:0.01", "auto:0.001",
            ),
            *({"aa": aa, "shading_rate": "auto"} for aa in ("msaa:4", "msaa:16")),
        ),
        {"aa": f"ssaa:{REFERENCE_SAMPLES}"},
    ),
    # Many samples of a whole texture are what a filtered lookup stands for.
    Knob(
        "textures",
        _values("effects", {"derivatives": "off"}, {"derivatives": "coarse"}, {"derivatives": "on"}),
        {"effects": {"derivatives": "off"}},
    ),
    Knob("output", _values("half", False, True), {"half": False}),
    Knob("samples", _values("samples", 1, 4, 16, 64, 256), {"samples": 1}, modes=(PATH,)),  # with many by its aa
    Knob("depth", _values("max_depth", 1, 2, 4, 8), {"max_depth": 16}, modes=("whitted", PATH)),
    Knob("grid", _values("grid_resolution", 32, 64, 128, method="raycast-grid")),
)  # fmt: skip

COMBINATIONS: tuple[Changes, ...] = (
    *({"precision": rung, "aa": aa} for aa in ("msaa:8", "ssaa:16") for rung in ("fast", "exact")),
    {"precision": "exact", "aa": "ssaa:64"},
)


KNOB_NAMES = (*(knob.name for knob in KNOBS), COMBINATION)


@dataclass(frozen=True)
class Setting:
    """One point of the curve. knob : its row, COMBINATION, or DEFAULT. changes : what differs from the default."""

    name: str
    knob: str
    changes: Changes
    options: RenderOptions


@dataclass(frozen=True)
class Settings:
    """The settings to measure, the default first. left_out : name of a setting or of a knob -> why."""

    chosen: tuple[Setting, ...]
    left_out: Mapping[str, str]
    reference: RenderOptions


def make_settings(
    base: RenderOptions,
    reference_samples: int = REFERENCE_SAMPLES,
    names: Sequence[str] = KNOB_NAMES,
    knobs: Sequence[Knob] = KNOBS,
    combinations: Sequence[Changes] = COMBINATIONS,
    projection: str = "perspective",
) -> Settings:
    """Each knob alone from `base`, then the combinations; and what the reference is rendered with.

    names : of the knobs to turn, of KNOB_NAMES; the reference takes its values of all. projection : of the view.
    """
    check = partial(_check, reference_samples=reference_samples, projection=projection)
    chosen = [Setting(DEFAULT, DEFAULT, {}, base)]
    left_out: dict[str, str] = {}
    for knob in (each for each in knobs if each.name in names):
        refused: dict[str, str] = {}
        for changes in knob.settings:
            _add(chosen, refused, base, knob, changes, check)
        whole = len(refused) == len(knob.settings) and len(set(map(_general, refused.values()))) == 1
        left_out.update({knob.name: next(iter(refused.values()))} if whole else refused)
    for changes in combinations if COMBINATION in names else ():
        _add(chosen, left_out, base, Knob(COMBINATION, ()), changes, check)
    return Settings(tuple(chosen), left_out, _reference(base, reference_samples, knobs))


def name_of(changes: Changes) -> str:
    """The options as a short name, such as `precision exact, aa msaa:8`."""
    texts = []
    for option, value in changes.items():
        if isinstance(value, Mapping):
            texts += [f"{effect} {state}" for effect, state in value.items()]
        else:
            texts.append(option.replace("_", "-") + ("" if value is True else f" {value}"))
    return ", ".join(texts)


def _general(reason: str) -> str:
    """A reason without its numbers: the same for all values of a knob that is refused as a whole."""
    return "".join(letter for letter in reason if not letter.isdigit())


def _add(
    chosen: list[Setting], refused: dict[str, str], base: RenderOptions, knob: Knob, changes: Changes,
    check: Callable[[RenderOptions], None],
) -> None:  # fmt: skip
    """Add a setting that is not there yet, or the reason why it cannot be."""
    name = name_of(changes)
    if knob.modes and base.mode not in knob.modes:
        refused[name] = f"acts in mode {' or '.join(knob.modes)}, and this is {base.mode}"
        return
    try:
        options = apply(base, changes)
        check(options)
    except UsageError as fault:
        refused[name] = str(fault)
        return
    differing = {o: value for o, value in changes.items() if getattr(options, o) != getattr(base, o)}
    if all(_resolved(options) != _resolved(each.options) for each in chosen):
        chosen.append(Setting(name_of(differing), knob.name, differing, options))


def _resolved(options: RenderOptions) -> RenderOptions:
    """The options with numbers for what was left open: to name a default changes nothing."""
    return replace(options, samples=options.path_count, max_depth=options.depth)


def sample_count(options: RenderOptions) -> int:
    """Samples of a pixel that are shaded each by itself; in mode `path` the paths of all of them."""
    wanted = options.antialiasing
    samples = wanted.depth_count if wanted.kind == "ssaa" or wanted.threshold else 1
    return samples * options.path_count if options.mode == PATH else samples


def apply(base: RenderOptions, changes: Changes) -> RenderOptions:
    """The options with `changes`; raises UsageError where this version does not have or not allow them."""
    for option in changes:
        if option not in OPTION_NAMES:
            raise UsageError(f"this version has no option --{option.replace('_', '-')}")
    whole = dict(changes)
    if "effects" in whole:
        whole["effects"] = {**base.effects, **whole["effects"]}
    options = replace(base, **whole)
    options.check_together()
    return options


def _check(options: RenderOptions, reference_samples: int, projection: str) -> None:
    """Raises UsageError where the view is none for them, or the reference hardly better; `auto` takes its most samples
    at few pixels."""
    options.check_projection(projection)
    needed = REFERENCE_RATIO * sample_count(options)
    if needed > reference_samples and (options.mode == PATH or not options.aa.startswith("auto")):
        is_possible = needed <= REFERENCE_SAMPLES
        mend = f"give --reference-samples {needed}" if is_possible else f"at most {REFERENCE_SAMPLES} are to be had"
        raise UsageError(f"needs a reference of {needed} samples: {mend}")


def _reference(base: RenderOptions, samples: int, knobs: Sequence[Knob]) -> RenderOptions:
    """The most accurate options that this version has."""
    options = replace(base, precision="exact", aa=f"ssaa:{samples}")
    for knob in knobs:
        if knob.modes and base.mode not in knob.modes:
            continue
        changes = {option: value for option, value in knob.reference.items() if option not in ("precision", "aa")}
        try:
            options = apply(options, changes)
        except UsageError:
            continue
    return options
