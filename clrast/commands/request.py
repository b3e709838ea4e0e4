"""What is to be rendered: options given, the scene's own ones, and the camera, put together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from clrast.commands.stats import complete_stats
from clrast.commands.viewpoint import VIEW_NAMES, Choice, View, choose_camera, make_view
from clrast.errors import SceneError, UsageError
from clrast.option_values import UnavailableError
from clrast.options import RenderOptions, make_options, parse_effects
from clrast.quality import with_preset
from clrast.scene.model import Camera, Scene
from clrast.visibility.sample_patterns import parse_antialiasing

if TYPE_CHECKING:
    from clrast.image.frame import Frame


UNUSED_OUTSIDE = {"samples": ("path",), "max_depth": ("whitted", "path")}
"""Options that only some modes read."""

UNUSED_BY_AA = {"filter": ("none",), "shading_rate": ("none", "ssaa", "auto")}
"""Options that some kinds of `--aa` do not read."""


@dataclass(frozen=True)
class Request:
    """A render that can start. `notes` and `warnings` are lines to say first."""

    options: RenderOptions
    camera: Camera
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def make_request(scene: Scene, view: View, given: Mapping[str, Any], source: str) -> Request:
    """Merge the options `given` (checked before) over those of the scene's card, and choose the camera.

    source : what messages call the scene.
    """
    options, warnings = merge_options(scene, given, source)
    choice: Choice = choose_camera(scene, view, options.size, source)
    notes = (*choice.notes, *_notes_of_layers(scene, options))
    return Request(options, choice.camera, notes, (*warnings, *choice.warnings))


def _notes_of_layers(scene: Scene, options: RenderOptions) -> tuple[str, ...]:
    """What becomes of samples that share shading where each has layers of its own."""
    from clrast.shading.antialias import antialiasing_of
    from clrast.shading.effects import plan_effects

    wanted = antialiasing_of(options)
    if wanted.kind not in ("msaa", "csaa") or wanted.threshold:
        return ()
    if not plan_effects(scene, options.aov, options.effects, options.mode)["alpha blend"]:
        return ()
    same = f"ssaa:{wanted.depth_count}"
    return (
        f"surfaces blend here, so --aa {options.aa} shades each sample: time and image are those of {same}; "
        "--shading-rate auto shades fewer",
    )  # fmt: skip


def merge_options(scene: Scene, given: Mapping[str, Any], source: str) -> tuple[RenderOptions, tuple[str, ...]]:
    """Options with a card's values below those given; returns them and warnings.

    What a card asks for and this version lacks is a warning; a value that makes no sense is a SceneError.
    """
    merged: dict[str, Any] = {}
    warnings: list[str] = []
    if scene.image_size is not None:
        merged["size"] = scene.image_size
    for written, value in scene.render_options.items():
        name = written.replace("-", "_")
        try:
            make_options({name: value}, whole=False)
        except UnavailableError as fault:
            warnings.append(f"{source} asks for what is ignored here: {fault}")
        except UsageError as fault:
            raise SceneError(f"{source}: {fault}") from None
        else:
            merged[name] = value
    if "effects" in merged and "effects" in given:
        own = parse_effects("--effects", merged["effects"])
        merged["effects"] = {**own, **parse_effects("--effects", given["effects"])}
        given = {name: value for name, value in given.items() if name != "effects"}
    # What was given wins over the card: its --quality too, over options that the card sets by name.
    options = make_options({**with_preset(merged), **with_preset(given)})
    for name, modes in UNUSED_OUTSIDE.items():
        if name in given and options.mode not in modes and "effects" not in given:
            warnings.append(f"--{name.replace('_', '-')} is not used in mode {options.mode}: it is ignored")
    kind = parse_antialiasing("--aa", options.aa).kind
    for name, kinds in UNUSED_BY_AA.items():
        if name in given and kind in kinds:
            warnings.append(f"--{name.replace('_', '-')} is not used by --aa {options.aa}: it is ignored")
    return options, tuple(warnings)


def render_scene(scene: Scene, camera: Camera | str | int | None, values: Mapping[str, Any]) -> Frame:
    """`clrast.render`: see there."""
    import warnings

    from clrast.renderer import render
    from clrast.scene.load import check_scene

    if not isinstance(scene, Scene):
        raise UsageError(f"render takes a scene, not {type(scene).__name__}: give what clrast.load returns")
    scene = check_scene(scene, scene.name)
    given = {name: value for name, value in values.items() if name not in VIEW_NAMES}
    make_options(given, whole=False)
    view = make_view({"camera": camera, **{name: values[name] for name in VIEW_NAMES if name in values}})
    request = make_request(scene, view, given, scene.name)
    for line in request.warnings:
        warnings.warn(line, stacklevel=3)
    frame = render(scene, request.camera, options=request.options)
    stats = complete_stats(frame.stats, request.options, {})
    frame.stats.clear()
    frame.stats.update(stats)
    return frame
