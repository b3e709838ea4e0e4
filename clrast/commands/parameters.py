"""The options of `render` as typer sees them: flags, placeholders and help, no values.

Every value arrives as a list of texts, so that an option given twice can be seen; parsing and
checking is in clrast/options.py.
"""

from __future__ import annotations

from typing import Annotated

import typer

from clrast.option_values import listed
from clrast.options import AVAILABLE_METHODS
from clrast.options import EFFECTS as EFFECT_NAMES
from clrast.quality import PRESETS
from clrast.visibility.oracles import FRUSTUM_SIDES, ORACLES, RAY_ORACLES

Texts = list[str] | None


def _option(*flags: str, metavar: str, text: str, panel: str) -> object:
    return typer.Option(*flags, metavar=metavar, help=text, rich_help_panel=panel, show_default=False)


def _switch(*flags: str, text: str, panel: str) -> object:
    return typer.Option(*flags, help=text, rich_help_panel=panel, show_default=False)


VIEW, ACCURACY, METHOD, EFFECTS, OUTPUTS, MACHINE = "View", "Accuracy", "Method", "Effects", "Outputs", "Machine"

Input = Annotated[str, typer.Argument(metavar="INPUT", help="A mesh or a scene card.", show_default=False)]

Size = Annotated[
    Texts, _option("--size", metavar="WxH", text="Pixels [default: the card's, else 1024x1024].", panel=VIEW)
]
Eye = Annotated[
    Texts, _option("--eye", metavar="X,Y,Z", text="The eye; replaces a camera of the file wholly.", panel=VIEW)
]
LookAt = Annotated[
    Texts,
    _option("--look-at", metavar="X,Y,Z", text="Where to look [default: the bounding box's centre].", panel=VIEW),
]
Up = Annotated[Texts, _option("--up", metavar="X,Y,Z", text="The way up [default: 0,1,0].", panel=VIEW)]
Fov = Annotated[
    Texts,
    _option(
        "--fov",
        metavar="DEG",
        text="Vertical angle of view [default: 45]; of a fisheye's disc, up to 360 [default: 180].",
        panel=VIEW,
    ),
]
CameraName = Annotated[
    Texts,
    _option("--camera", metavar="NAME|INDEX", text="A camera that the file brings [default: its first].", panel=VIEW),
]
ProjectionName = Annotated[
    Texts,
    _option(
        "--projection",
        metavar="NAME",
        text="perspective, orthographic, paraboloid, latlong, fisheye, or cube: six faces along the world's axes, "
        "--size WxW (of a face) or Wx6W [default: the camera's].",
        panel=VIEW,
    ),
]
Height = Annotated[
    Texts, _option("--height", metavar="H", text="Height of an orthographic view, world units.", panel=VIEW)
]

Precision = Annotated[
    Texts,
    _option(
        "--precision",
        metavar="RUNG",
        text="fast, ordered, midpoint, double, fixed (2dr-* alone) or exact [default: midpoint].",
        panel=ACCURACY,
    ),
]
Antialiasing = Annotated[
    Texts,
    _option(
        "--aa", metavar="MODE", panel=ACCURACY,
        text="none [default]; ssaa:N, all of N samples shaded (1 to 1024); msaa:N, each surface of N samples (2, 4, 8, "
        "16, 32); csaa:S+C, S of them with depth, C that say only whose they are (32 in all); auto:EPS, samples until "
        "a colour is estimated to be within EPS (1e-6 to 1).",
    ),
]  # fmt: skip
ShadingRate = Annotated[
    Texts,
    _option(
        "--shading-rate", metavar="RATE", panel=ACCURACY,
        text="Of msaa and csaa: pixel [default], once a surface; sample; auto, auto:EPS: a quarter of samples, and all "
        "where a colour is estimated to be off by more than EPS (0.05).",
    ),  # fmt: skip
]
Filter = Annotated[
    Texts,
    _option(
        "--filter", metavar="NAME", panel=ACCURACY,
        text="Of samples: box [default]; tent, gaussian, blackman-harris, which reach into neighbours: with ssaa, or "
        "msaa and csaa that shade by pixel, in images that fit into memory whole.",
    ),
]  # fmt: skip
Evaluation = Annotated[
    Texts,
    _option(
        "--evaluation", metavar="WAY",
        text="Edge functions: direct [default], or incremental, by sums from sample to sample (not latlong, fisheye).",
        panel=ACCURACY,
    ),
]  # fmt: skip
Samples = Annotated[
    Texts, _option("--samples", metavar="N", text="Paths of a sample in mode path [default: 16].", panel=ACCURACY)
]
Seed = Annotated[Texts, _option("--seed", metavar="N", text="Of random numbers [default: 0].", panel=ACCURACY)]
MaxDepth = Annotated[
    Texts,
    _option(
        "--max-depth", metavar="N", panel=ACCURACY,
        text="Reflections and refractions of a ray, or bounces of a path, modes whitted and path [default: 8].",
    ),
]  # fmt: skip
Quality = Annotated[
    Texts,
    _option(
        "--quality", metavar="NAME", panel=ACCURACY,
        text="; ".join(
            f"{name}: {', '.join(f'--{option} {value}' for option, value in preset.items())}"
            for name, preset in PRESETS.items()
        ) + ". Options that are given win.",
    ),
]  # fmt: skip

Method = Annotated[
    Texts,
    _option(
        "--method", metavar="NAME",
        text=f"{listed(AVAILABLE_METHODS)} [default: auto, the fastest for scene and view]. The image is the same by "
        "all that begin with 3dr or raycast.", panel=METHOD,
    ),
]  # fmt: skip
Oracle = Annotated[
    Texts,
    _option(
        "--oracle", metavar="NAME=VALUE",
        text="Change one decision of a --method that has no tiles; may be given again. "
        + "; ".join(f"{name}={'|'.join(oracle.settings)}" for name, oracle in ORACLES.items())
        + f"; frustum=SIDE of the root frusta, {FRUSTUM_SIDES[0]} to {FRUSTUM_SIDES[1]} samples. "
        "split_frustum takes a ratio of areas too, as in small:8. Of methods with a grid: "
        + "; ".join(f"{name}={'|'.join(oracle.settings)}" for name, oracle in RAY_ORACLES.items())
        + "; a number after a colon: of pass per cent of the rays, of unroll tests, of mailbox boxes.", panel=METHOD,
    ),
]  # fmt: skip
Intersection = Annotated[
    Texts,
    _option(
        "--intersection", metavar="WAY",
        text="edge [default], or barycentric, by determinants, with --method raycast-brute.", panel=METHOD,
    ),
]  # fmt: skip
Accelerator = Annotated[
    Texts,
    _option(
        "--accelerator", metavar="NAME",
        text="What secondary rays walk through, bvh or grid; auto [default] is bvh, with which they took half the time "
        "or less. In mode cast the camera's rays: with --method auto, grid is raycast-grid.",
        panel=METHOD,
    ),
]  # fmt: skip
GridResolution = Annotated[
    Texts,
    _option(
        "--grid-resolution", metavar="N",
        text="Cells of a grid along the scene's shortest side, 1 to 1023 [default: as many as make traversal and "
        "intersection cost the same].", panel=METHOD,
    ),
]  # fmt: skip

Mode = Annotated[
    Texts, _option("--mode", metavar="NAME", text="cast [default], shadow, whitted or path.", panel=EFFECTS)
]
Effects = Annotated[
    Texts,
    _option(
        "--effects", metavar="NAME=STATE",
        text="Force an effect: on, off or auto, as in alpha_mask=off; may be given again. derivatives=coarse takes "
        "differences of 2 x 2 pixels, as graphics hardware does. Effects: "
        + ", ".join(name.replace(" ", "_") for name in EFFECT_NAMES) + ".", panel=EFFECTS,
    ),
]  # fmt: skip

Output = Annotated[
    Texts,
    _option(
        "-o", "--output", metavar="FILE",
        text="x.exr (every channel asked for) or x.png (a tone-mapped picture); may be given twice.", panel=OUTPUTS,
    ),
]  # fmt: skip
Aov = Annotated[
    Texts,
    _option(
        "--aov", metavar="LIST",
        text="Comma list of color, depth, distance, normal, position, bary, uv, albedo, ray, id, cost (what each "
        "pixel took); or all, which is all but cost [default: color,depth].",
        panel=OUTPUTS,
    ),
]  # fmt: skip
Half = Annotated[bool, _switch("--half", text="Float channels of .exr files as 16-bit floats.", panel=OUTPUTS)]
Stats = Annotated[
    Texts, _option("--stats", metavar="FILE", text="Camera, counts, times and effects as JSON.", panel=OUTPUTS)
]
Counters = Annotated[
    bool,
    _switch(
        "--counters", panel=OUTPUTS,
        text="Count setups, edge evaluations, tests and traversal steps, for --stats; slower, and the same pixels.",
    ),
]  # fmt: skip
Report = Annotated[bool, _switch("--report", text="Print effects with reasons, and times.", panel=OUTPUTS)]
Json = Annotated[bool, _switch("--json", text="Print the stats as JSON in place of the report.", panel=OUTPUTS)]
Quiet = Annotated[bool, _switch("-q", "--quiet", text="No notes and no progress; warnings stay.", panel=OUTPUTS)]
StudyJson = Annotated[bool, _switch("--json", text="Print the table as JSON.", panel=OUTPUTS)]
StudyQuiet = Annotated[bool, _switch("-q", "--quiet", text="No notes and no progress.", panel=OUTPUTS)]

Device = Annotated[
    Texts,
    _option("--device", metavar="SELECTOR", text="An OpenCL device, as 'clrast devices' lists them.", panel=MACHINE),
]
Threads = Annotated[Texts, _option("-t", "--threads", metavar="N", text="Processor threads to use.", panel=MACHINE)]
Memory = Annotated[
    Texts,
    _option(
        "--memory", metavar="BYTES",
        text="Budget of device memory, such as 512M or 2G; larger images are rendered in bands.", panel=MACHINE,
    ),
]  # fmt: skip
TimeBudget = Annotated[
    Texts,
    _option(
        "--time-budget", metavar="S", panel=MACHINE,
        text="Seconds after which no further path is begun: the image has those so far, and the exit code is 75.",
    ),
]  # fmt: skip
Resume = Annotated[
    Texts,
    _option(
        "--resume", metavar="FILE", panel=MACHINE,
        text="Keep the sums of paths in FILE, and go on from it where it is there: as if never stopped.",
    ),
]  # fmt: skip
Repeat = Annotated[
    Texts,
    _option(
        "--repeat", metavar="N", text="A warm-up, then N frames; the stats have each stage's smallest time.",
        panel=MACHINE,
    ),
]  # fmt: skip
