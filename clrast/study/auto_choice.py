"""What `--method auto` takes for a view, asked apart from a render."""

from __future__ import annotations

from dataclasses import dataclass

from clrast.opencl.device import Device
from clrast.options import RenderOptions
from clrast.renderer import start_job
from clrast.scene.camera import CameraVectors
from clrast.scene.model import Scene
from clrast.shading.effects import EffectPlan


@dataclass(frozen=True)
class AutoChoice:
    """A method, and why."""

    method: str
    reason: str


def choose_automatically(
    device: Device, scene: Scene, vectors: CameraVectors, options: RenderOptions, plan: EffectPlan
) -> AutoChoice:
    """What `auto` takes; options.method must be `auto`."""
    job = start_job(device, scene, vectors, options, plan)
    return AutoChoice(job.method.name, job.reason or "")
