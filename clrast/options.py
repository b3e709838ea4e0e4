"""The options of a render, checked once and shared by the command line and the Python API.

`RenderOptions` takes each value as the object or as the text that the command line takes, and
raises UsageError where it makes no sense (option_values.py reads one value), or not beside the others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

from clrast.errors import UsageError
from clrast.opencl.constants import MAX_GRID_SIDE
from clrast.opencl.features import Edges
from clrast.option_values import (
    MAX_PIXELS,
    MAX_SIDE,
    UnavailableError,
    check_choice,
    did_you_mean,
    listed,
    parse_count,
    parse_memory,
    parse_number,
    parse_size,
    parse_texts,
)
from clrast.quality import PRESETS, with_preset
from clrast.visibility.methods import AUTO, SNAPPED_METHODS, resolve_method
from clrast.visibility.methods import METHODS as METHOD_TABLE
from clrast.visibility.oracles import parse_oracle
from clrast.visibility.sample_patterns import FILTERS, Antialiasing, parse_antialiasing, parse_shading_rate, with_rate

PRECISIONS = ("fast", "ordered", "midpoint", "double", "fixed", "exact")
AVAILABLE_PRECISIONS = PRECISIONS
AVAILABLE_METHODS = (AUTO, *METHOD_TABLE)
METHODS = AVAILABLE_METHODS
"""In the order of the design."""
AUTO_ACCELERATOR = "bvh"
"""Of secondary rays where --accelerator does not say.

On three scenes of 69,000 to 330,000 triangles the grid took 3.0 to 3.6 times as long for closest hits and 3.0 to 6.6
times for any hit (tools/bench_rays.py). It is built in three tenths of the time, which pays where all frames of a scene
together have less than about three rays a triangle.
"""
GRID_METHODS = tuple(name for name, row in METHOD_TABLE.items() if row.grid)
MODES = ("cast", "shadow", "whitted", "path")
PROJECTIONS = ("perspective", "orthographic", "paraboloid", "latlong", "fisheye", "cube")
AVAILABLE_PROJECTIONS = PROJECTIONS
QUALITIES = tuple(PRESETS)
AOV_GROUPS = ("color", "depth", "distance", "normal", "position", "bary", "uv", "albedo", "ray", "id", "cost")
AVAILABLE_AOV_GROUPS = AOV_GROUPS
EFFECTS = (
    "shadow", "reflection", "refraction", "indirect light", "emission", "textures", "normal interpolation",
    "alpha mask", "alpha blend", "environment", "secondary acceleration structure", "derivatives",
)  # fmt: skip
EFFECTS_LEFT_OFF = ("secondary acceleration structure",)
"""Effects that cannot be asked for: it is there where a ray needs it."""
EFFECT_STATES = ("on", "off", "auto")
COARSE = "coarse"
"""A further state of the effect `derivatives`: on, by differences between pixels."""

MAX_DEPTH = 1000
DEFAULT_DEPTH = 8
"""Rays that follow each other from a hit at most, where --max-depth does not say."""
DEFAULT_PATHS = 16
"""Paths of a sample in mode `path`, where --samples does not say."""
MAX_SEED = (1 << 32) - 1

def parse_aov(option: str, value: Any) -> tuple[str, ...]:
    """Groups of AOV_GROUPS in their order, from a comma list or a sequence; `all` is every group but cost."""
    wanted: set[str] = set()
    for name in parse_texts(option, value):
        if name == "all":
            wanted.update(group for group in AOV_GROUPS if group != "cost")
        else:
            wanted.add(check_choice(option, name, (*AOV_GROUPS, "all"), (*AVAILABLE_AOV_GROUPS, "all")))
    if not wanted:
        raise UsageError(f"{option} names no group: use {listed((*AVAILABLE_AOV_GROUPS, 'all'))}")
    return tuple(group for group in AOV_GROUPS if group in wanted)


def parse_effects(option: str, value: Any) -> dict[str, str]:
    """Effect name with spaces -> state, from NAME=STATE (comma lists, sequences) or a mapping."""
    if isinstance(value, Mapping):
        pairs = [(str(name), state) for name, state in value.items()]
    else:
        pairs = []
        for text in parse_texts(option, value):
            name, equals, state = text.partition("=")
            if not equals:
                raise UsageError(f"{option} {text!r}: give NAME=on|off|auto, such as alpha_mask=off")
            pairs.append((name, state))
    effects: dict[str, str] = {}
    underscored = [name.replace(" ", "_") for name in EFFECTS]
    for name, state in pairs:
        key = check_choice(option, name.strip().replace(" ", "_").replace("-", "_"), underscored).replace("_", " ")
        if isinstance(state, bool):
            state = "on" if state else "off"
        states = (*EFFECT_STATES, COARSE) if key == "derivatives" else EFFECT_STATES
        check_choice(f"{option} {key.replace(' ', '_')}", state, states)
        if effects.setdefault(key, state) != state:
            raise UsageError(f"{option} {key.replace(' ', '_')} is given as {effects[key]} and as {state}: give one")
        if state == "on" and key in EFFECTS_LEFT_OFF:
            option_text = f"{option} {key.replace(' ', '_')}"
            raise UnavailableError(f"{option_text}=on is not available in this version; use auto or off")
    return {name: effects[name] for name in EFFECTS if name in effects}


def _parse_antialiasing(option: str, value: Any) -> str:
    return parse_antialiasing(option, value).name


def _parse_oracle(option: str, value: Any) -> tuple[str, ...]:
    texts = tuple(parse_texts(option, value))
    chosen: dict[str, str] = {}
    for text in texts:
        name, _ = parse_oracle(option, text)
        if chosen.setdefault(name, text) != text:
            raise UsageError(f"{option} {name} is given as {chosen[name]!r} and as {text!r}: give one")
    return tuple(chosen.values())


def _choice(names: Sequence[str], available: Sequence[str] | None = None) -> Callable[[str, Any], str]:
    return lambda option, value: check_choice(option, value, names, available)


def _count(low: int, high: int) -> Callable[[str, Any], int]:
    return lambda option, value: parse_count(option, value, low, high)


def _text(option: str, value: Any) -> str:
    if not isinstance(value, str) or not value:
        raise UsageError(f"{option} {value!r} is empty or no text: leave it out for the default")
    return value


def _parse_switch(option: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise UsageError(f"{option} {value!r} is unknown: use True or False")
    return value


def _parse_budget(option: str, value: Any) -> float:
    return parse_number(option, value, "seconds, more than 0", above=0.0)


_PARSERS: dict[str, Callable[[str, Any], Any]] = {
    "size": parse_size,
    "precision": _choice(PRECISIONS, AVAILABLE_PRECISIONS),
    "method": _choice(METHODS, AVAILABLE_METHODS),
    "mode": _choice(MODES),
    "aov": parse_aov,
    "effects": parse_effects,
    "counters": _parse_switch,
    "half": _parse_switch,
    "device": _text,
    "threads": _count(1, 4096),
    "memory": parse_memory,
    "repeat": _count(0, 1_000_000),
    "aa": _parse_antialiasing,
    "shading_rate": lambda option, value: parse_shading_rate(option, value)[0],
    "filter": _choice(FILTERS),
    "evaluation": _choice(("direct", "incremental")),
    "samples": _count(1, 1 << 24),
    "seed": _count(0, MAX_SEED),
    "intersection": _choice(("edge", "barycentric")),
    "accelerator": _choice(("auto", "grid", "bvh")),
    "oracle": _parse_oracle,
    "max_depth": _count(0, MAX_DEPTH),
    "quality": _choice(QUALITIES),
    "grid_resolution": _count(1, MAX_GRID_SIDE),
    "time_budget": _parse_budget,
    "resume": _text,
}


@dataclass(frozen=True)
class RenderOptions:
    """What decides a render beside the scene and the camera. Names are those of the command line.

    Every value may also be given as the text that the command line takes, such as size="640x480".

    size : (width, height) pixels. aov : groups of AOV_GROUPS, in that order, without repeats.
    effects : effect name (with spaces) -> "on" | "off" | "auto"; an effect that is absent is "auto". `derivatives` may
    also be "coarse".
    half : float channels of EXR files as 16-bit floats. quality : of PRESETS; it fills what has its default value here,
    and is then None: make_options also knows which options were given.
    device, threads, memory (bytes), repeat : of the machine; they decide no pixel.
    """

    size: tuple[int, int] = (1024, 1024)
    precision: str = "midpoint"
    method: str = "auto"
    mode: str = "cast"
    aov: tuple[str, ...] = ("color", "depth")
    effects: dict[str, str] = field(default_factory=dict)
    counters: bool = False
    device: str | None = None
    threads: int | None = None
    memory: int | None = None
    repeat: int = 0
    aa: str = "none"
    shading_rate: str = "pixel"
    filter: str = "box"
    evaluation: str = "direct"
    samples: int | None = None
    seed: int = 0
    intersection: str = "edge"
    accelerator: str = "auto"
    oracle: tuple[str, ...] = ()
    max_depth: int | None = None
    half: bool = False
    quality: str | None = None
    grid_resolution: int | None = None
    time_budget: float | None = None
    resume: str | None = None

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            if value is not None:
                parsed = _PARSERS[each.name]("--" + each.name.replace("_", "-"), value)
                object.__setattr__(self, each.name, parsed)
            elif each.default is not None:
                raise UsageError(f"--{each.name.replace('_', '-')} has no value: leave it out for the default")
        if self.quality is not None:
            defaults = {each.name: each.default for each in fields(self)}
            for name, preset in PRESETS[self.quality].items():
                if getattr(self, name) == defaults[name]:
                    object.__setattr__(self, name, preset)
            object.__setattr__(self, "quality", None)

    @property
    def aa_in_use(self) -> str:
        """`aa`, or `none` where no colour is asked for: nothing else is antialiased."""
        return self.aa if "color" in self.aov else "none"

    @property
    def depth(self) -> int:
        """Rays that follow each other from a hit at most."""
        return DEFAULT_DEPTH if self.max_depth is None else self.max_depth

    @property
    def path_count(self) -> int:
        """Paths of a shaded sample in mode `path`."""
        return DEFAULT_PATHS if self.samples is None else self.samples

    @property
    def casts_grid(self) -> bool:
        """Whether --accelerator chooses the grid for the camera's rays: only where there are no others."""
        return self.method == AUTO and self.accelerator == "grid" and self.mode == "cast"

    @property
    def ray_accelerator(self) -> str:
        """What secondary rays walk through, bvh or grid; see AUTO_ACCELERATOR."""
        return AUTO_ACCELERATOR if self.accelerator == "auto" else self.accelerator

    @property
    def antialiasing(self) -> Antialiasing:
        """What --aa and --shading-rate ask for."""
        return with_rate(parse_antialiasing("--aa", self.aa), self.shading_rate)

    @property
    def can_resume(self) -> bool:
        """Whether another render can go on with this one's paths: not where what was found decides on samples."""
        return not self.antialiasing.threshold

    def check_together(self) -> None:
        """Raises UsageError where options do not go together; a render does it before anything else."""
        wanted = self.antialiasing
        if self.resume is not None and not self.can_resume:
            name = "--aa auto" if wanted.kind == "auto" else "--shading-rate auto"
            raise UsageError(f"--resume: with {name} the samples depend on what was found before: use --aa ssaa:N")
        if self.resume is not None and self.repeat > 1:
            raise UsageError("--resume goes on with one render: leave out --repeat")
        if self.method != AUTO:
            resolve_method(self.method, self.oracle, intersection=self.intersection, evaluation=self.evaluation)
        elif self.oracle:
            raise UsageError("--oracle changes a method: name it, such as --method 3dr-full")
        elif self.intersection != "edge":
            raise UsageError("--intersection barycentric is of --method raycast-brute: give that method")
        if self.precision == "fixed" and self.method not in (AUTO, *SNAPPED_METHODS):
            raise UsageError(
                f"--precision fixed snaps projected vertices, and {self.method} projects none: "
                f"use --method {listed(SNAPPED_METHODS)}, or another rung"
            )
        self._check_accelerator()
        if self.filter != "box" and wanted.kind == "auto":
            raise UsageError(f"--filter {self.filter} needs as many samples in each pixel: use --aa ssaa:N or msaa:N")
        if self.filter != "box" and (wanted.threshold or (wanted.kind == "csaa" and wanted.shades_all)):
            rate = f"--shading-rate {self.shading_rate}"
            raise UsageError(f"{rate} of {self.aa} resolves pixels by themselves: use --filter box, or --aa ssaa:N")


    def check_projection(self, projection: str) -> None:
        """Raises UsageError where the options do not go with a projection; a render does it before anything else."""
        if projection == "cube":
            cube_side(self.size)
            for name in ("time_budget", "resume"):
                if getattr(self, name) is not None:
                    option = "--" + name.replace("_", "-")
                    raise UsageError(f"{option} is for one picture, and a cube has six: leave it out")
        if projection not in CURVED_PROJECTIONS:
            return
        if self.precision == "fixed":
            raise UsageError(f"--precision fixed needs planar views, and {projection} is none: use another rung")
        if self.method not in (AUTO, *METHODS_OF_ANY_VIEW):
            others = listed(METHODS_OF_ANY_VIEW)
            raise UsageError(f"--method {self.method} needs planar views, and {projection} is none: use {others}")
        if self.casts_grid:
            raise UsageError(f"--accelerator grid needs planar views, and {projection} is none: leave it out")
        if self.evaluation != "direct" and projection not in SUMMED_PROJECTIONS:
            raise UsageError(
                f"--evaluation {self.evaluation} sums up polynomials, and {projection} has sines and cosines: "
                "use direct"
            )

    def _check_accelerator(self) -> None:
        """In mode cast the accelerator is that of the camera's rays, and has to be the method's; else of all others."""
        is_grid = self.method in GRID_METHODS or self.accelerator == "grid"
        if self.grid_resolution is not None and not is_grid:
            mend = f"use --method {listed(GRID_METHODS)}, or --accelerator grid"
            raise UsageError(f"--grid-resolution is of methods with a grid: {mend}")
        if self.method == AUTO or self.accelerator == "auto" or self.mode != "cast":
            return
        is_named, mend = self.method in GRID_METHODS, "leave it out, or name another method"
        if self.accelerator == "grid" and not is_named:
            raise UsageError(f"--accelerator grid is not that of {self.method}: use --method {listed(GRID_METHODS)}")
        if self.accelerator == "bvh" and is_named:
            raise UsageError(f"--accelerator bvh is not that of {self.method}: {mend}")


CURVED_PROJECTIONS = ("paraboloid", "latlong", "fisheye")
"""Projections that are not planar: only 3D edges are functions over them."""

SUMMED_PROJECTIONS = ("perspective", "orthographic", "paraboloid")
"""Projections whose directions are polynomials of the sample's place, so that edge functions can be summed up."""

METHODS_OF_ANY_VIEW = tuple(
    name for name, row in METHOD_TABLE.items() if row.edges not in (Edges.PROJECTED, Edges.HOMOGENEOUS) and not row.grid
)
"""Without a grid: its rays are walked as those of a plane."""


def check_single_view(projection: str, study: str) -> None:
    """Raises UsageError for a projection of several views, of which a study has one."""
    if projection == "cube":
        raise UsageError(f"{study} measures one view, and cube is six: use another --projection")


def cube_side(size: tuple[int, int]) -> int:
    """Pixels a side of a cube's face, for the size of the image, W x 6W, or of one face, W x W; raises UsageError."""
    width, height = size
    if height not in (width, 6 * width):
        raise UsageError(f"--size {width}x{height} is no cube's: give W x 6W, or W x W for one face")
    if 6 * width > MAX_SIDE or 6 * width * width > MAX_PIXELS:
        pixels = 6 * width * width
        raise UsageError(f"--size {width}x{height} is too large for a cube, with {pixels} pixels in all: give less")
    return width


OPTION_NAMES = tuple(each.name for each in fields(RenderOptions))


def make_options(values: Mapping[str, Any], *, whole: bool = True) -> RenderOptions:
    """Options from values by name (underscores or hyphens); an unknown name is a UsageError with the nearest one.

    whole : these are all; else others may come, from a scene's card, and only each alone is checked.
    """
    known = {name.replace("-", "_"): value for name, value in values.items()}
    for name in known:
        if name not in OPTION_NAMES:
            hint = did_you_mean(name, OPTION_NAMES)
            raise UsageError(f"there is no option {name!r}: use {listed(OPTION_NAMES)}{hint}")
    options = RenderOptions(**with_preset(known))
    if whole:
        options.check_together()
    return options
