"""What an image's header says of how it was made: what decides its pixels, and nothing else."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from clrast import __version__
from clrast.opencl.features import Edges
from clrast.options import COARSE, EFFECTS, RenderOptions
from clrast.visibility.methods import AUTO, resolve_method


def effects_text(switched_on: Iterable[str]) -> str:
    """Effects as an image's header names them: in the fixed order, with underscores, between commas."""
    names = set(switched_on)
    return ",".join(name.replace(" ", "_") for name in EFFECTS if name in names)


def resolved_header(
    options: RenderOptions,
    camera_vectors: Mapping[str, Sequence[float]],
    effects_on: Iterable[str] | None = None,
    projection: str = "perspective",
) -> dict[str, Any]:
    """What decides the pixels, in a fixed order, for an image's header: no device, method, threads or tile size.

    Keys are bare: a file writer puts `clrast:` before them.

    camera_vectors : name -> 3 float32 values, as in the stats. effects_on : the effects that the plan
    switched on; None stands for those that the options force on.
    """
    if effects_on is None:
        effects_on = [name for name, state in options.effects.items() if state in ("on", COARSE)]
    effects_on = list(effects_on)
    header: dict[str, Any] = {
        "version": __version__,
        "size": f"{options.size[0]}x{options.size[1]}",
        "projection": projection,
        "mode": options.mode,
        "precision": options.precision,
        "aa": options.aa_in_use,
        "effects": effects_text(effects_on),
    }
    on = set(effects_on)
    if "derivatives" in on and options.effects.get("derivatives") == COARSE:
        header["derivatives"] = COARSE
    if on & {"reflection", "refraction", "indirect light"}:
        header["max_depth"] = str(options.depth)
    if "indirect light" in on:
        header["samples"], header["seed"] = str(options.path_count), str(options.seed)
    if options.aa_in_use != "none" and options.shading_rate != "pixel":
        header["shading_rate"] = options.shading_rate
    if options.aa_in_use != "none" and options.filter != "box":
        header["filter"] = options.filter
    if options.evaluation != "direct":
        header["evaluation"] = options.evaluation
    if options.method != AUTO:
        edges = resolve_method(options.method, (), intersection=options.intersection).edges
        if edges != Edges.SPATIAL:
            header["edges"] = edges.name.lower()
    for name, vector in camera_vectors.items():
        x, y, z = (float(component) for component in vector)
        header[f"camera.{name}"] = (x, y, z)
    return header
