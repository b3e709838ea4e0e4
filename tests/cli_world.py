"""Stand-ins for the loader and the renderer, for tests of the command line that need no device."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from clrast import errors
from clrast.__main__ import main
from clrast.options import RenderOptions
from clrast.scene.model import Camera, Scene


@dataclass(frozen=True)
class FakeFrame:
    channels: dict[str, Any]
    header: dict[str, Any] = field(default_factory=dict)
    stats: dict[str, Any] = field(default_factory=dict)
    disk_is_full: bool = False

    def save(self, path: str, half: bool = False) -> None:
        if self.disk_is_full and path.endswith(".png"):
            raise errors.OutputError(f"{path}: cannot be written (No space left on device): make room")
        Path(path).write_text(",".join(self.channels))


@dataclass
class World:
    """What the stand-ins give, and what they were asked for."""

    folder: Path
    scene: Scene
    calls: list[tuple[Camera, RenderOptions]] = field(default_factory=list)
    fault: BaseException | None = None
    disk_is_full: bool = False
    load_fault: BaseException | None = None

    @property
    def source(self) -> str:
        return str(self.folder / "scene.ply")

    def out(self, name: str = "out.exr") -> str:
        return str(self.folder / name)

    def files(self) -> list[str]:
        return sorted(path.name for path in self.folder.iterdir())

    def load(self, path: str) -> Scene:
        if self.load_fault:
            raise self.load_fault
        return self.scene

    def render(
        self, scene: Scene, camera: Camera | None = None, *, options: RenderOptions, watch: Any = None
    ) -> FakeFrame:
        if self.fault:
            raise self.fault
        assert camera is not None
        self.calls.append((camera, options))
        channels: dict[str, Any] = {"Z": 0, "id.prim": 0}
        if "color" in options.aov:
            channels = {"R": 0, "G": 0, "B": 0, "A": 0, **channels}
        stats = {
            "device": "a device", "method": "3dr-binning", "bytes_device": np.int64(12), "camera": {"e": np.zeros(3)},
            "counts": {"triangles": 1, "samples": math.nan}, "times_ms": {"setup": 1.5, "visibility": np.float32(2.5)},
            "effects": [{"name": "textures", "on": False, "reason": "no texture"}],
        }  # fmt: skip
        return FakeFrame(channels, {}, stats, self.disk_is_full)


def make_scene(**changes: Any) -> Scene:
    """One triangle in the box from (0,0,0) to (2,4,0)."""
    scene = Scene(
        positions=np.array([[0, 0, 0], [2, 0, 0], [0, 4, 0]], np.float32),
        triangles=np.array([[0, 1, 2]], np.uint32),
        object_ids=np.zeros(1, np.uint32),
        material_ids=np.zeros(1, np.uint32),
        name="scene.ply",
    )
    return replace(scene, **changes)


def make_world(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> World:
    """A folder with one input file, and the stand-ins in place of the loader and the renderer."""
    made = World(tmp_path, make_scene())
    Path(made.source).write_text("ply")
    for name, members in {
        "clrast.renderer": {"render": made.render},
        "clrast.scene.load": {"load": made.load, "check_scene": lambda scene, path: scene},
    }.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    return made


def fails(capsys: pytest.CaptureFixture[str], code: int, *arguments: str) -> str:
    """Run, check the exit code and that stderr has one error line; returns it."""
    assert main(arguments) == code
    printed = capsys.readouterr()
    assert printed.out == ""
    lines = [line for line in printed.err.splitlines() if line.startswith("clrast: error: ")]
    assert len(lines) == 1
    assert "Traceback" not in printed.err
    return lines[0]
