"""clrast renders triangle scenes with portable OpenCL C kernels, bit for bit the same on every machine.

    import clrast
    scene = clrast.load("scene.glb")
    frame = clrast.render(scene, size="640x480", aov="color,depth,id")
    print(frame["id.prim"].shape)
    frame.save("image.exr")

The command line is a thin layer over these names; `clrast --help` lists its verbs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

    from clrast import errors as errors
    from clrast.errors import (
        CapacityError,
        ClrastError,
        DeviceError,
        InputNotFoundError,
        OutputError,
        SceneError,
        UsageError,
    )
    from clrast.image.frame import Frame
    from clrast.options import RenderOptions
    from clrast.scene.model import Camera, Scene

__version__ = "0.1.0"

_HOMES = {
    "Frame": "clrast.image.frame",
    "Scene": "clrast.scene.model",
    "Camera": "clrast.scene.model",
    "RenderOptions": "clrast.options",
    "ClrastError": "clrast.errors",
    "UsageError": "clrast.errors",
    "SceneError": "clrast.errors",
    "InputNotFoundError": "clrast.errors",
    "DeviceError": "clrast.errors",
    "OutputError": "clrast.errors",
    "CapacityError": "clrast.errors",
}
"""Public names that are imported at first use, so that `import clrast` stays quick."""

__all__ = [
    "Camera", "CapacityError", "ClrastError", "DeviceError", "Frame", "InputNotFoundError", "OutputError",
    "RenderOptions", "Scene", "SceneError", "UsageError", "__version__", "diff", "errors", "load", "render",
]  # fmt: skip


def load(path: str | Path) -> Scene:
    """Read a mesh (.ply .obj .stl .off .glb .gltf) or a scene card (.toml); triangles keep the order of the file.

    Raises InputNotFoundError, or SceneError where the file cannot be rendered.
    """
    from clrast.scene.load import load as load_scene

    return load_scene(path)


def render(scene: Scene, camera: Camera | str | int | None = None, **options: Any) -> Frame:
    """Render `scene` to a Frame of float32 and uint32 channels, each (height, width).

    camera : a Camera, the name or index of one that the file brings, or None: the file's first, else
        one that frames the scene. Or give eye, look_at, up, fov (degrees), height, projection.
    options : those of the command line with underscores (see RenderOptions), as values or as text:
        size=(640, 480) or "640x480", precision="midpoint", aov="color,id", effects={"alpha mask": "off"}.

    A scene card's own values yield to options given. Raises UsageError, DeviceError or CapacityError.
    """
    from clrast.commands.request import render_scene

    return render_scene(scene, camera, options)


def diff(reference: str | Path | Frame, test: str | Path | Frame, **thresholds: Any) -> Any:
    """Compare two images, every part and every channel: files or frames; see `clrast diff --help`."""
    from clrast.image.diff import diff as diff_images

    return diff_images(reference, test, **thresholds)


def __getattr__(name: str) -> Any:
    from importlib import import_module

    if name == "errors":
        return import_module("clrast.errors")
    if name in _HOMES:
        value = getattr(import_module(_HOMES[name]), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'clrast' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
