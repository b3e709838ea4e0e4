"""The `clrast render` command of a setting: as a line to copy, and run in a process of its own as the user would."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from clrast.errors import ClrastError
from clrast.options import parse_effects
from clrast.study.accuracy import Accuracy, Row
from clrast.study.accuracy_answers import Run
from clrast.study.accuracy_errors import measure_errors

FRAME_STAGES = ("setup", "bin", "visibility", "shade", "resolve")
OUTPUT = "best.exr"


class RunError(ClrastError):
    """The command of a setting did not do what the same options did in this process."""


def command_of(
    row: Row, size: tuple[int, int], source: str, given: Mapping[str, Any], view: Mapping[str, Any]
) -> list[str]:
    """The words of the command that renders a setting as it was measured.

    given, view : options as the user typed them. The method is named, so that no time goes into choosing it.
    """
    own = {name: value for name, value in given.items() if name not in ("size", *row.setting.changes)}
    options = {**view, **own, **row.setting.changes, "method": row.method}
    if "effects" in row.setting.changes:
        effects = {**parse_effects("--effects", given.get("effects", [])), **row.setting.changes["effects"]}
        options["effects"] = [f"{name.replace(' ', '_')}={state}" for name, state in effects.items()]
    words = ["clrast", "render", source, "-o", OUTPUT, "--size", f"{size[0]}x{size[1]}"]
    for name, value in options.items():
        flag = "--" + name.replace("_", "-")
        if value is None or value is False:
            continue
        for each in value if isinstance(value, (list, tuple)) else [value]:
            # A value may begin with a minus.
            words += [flag] if each is True else [flag, str(each)]
    return words


def as_line(words: Sequence[str]) -> str:
    return shlex.join(words)


class CommandRunner:
    """Runs printed commands and measures what comes of them, in a folder that goes when it is closed."""

    def __init__(self, study: Accuracy, commands: Mapping[str, Sequence[str]]) -> None:
        self._study, self._commands = study, commands
        self._folder = tempfile.TemporaryDirectory(prefix="clrast-accuracy-")

    def __enter__(self) -> CommandRunner:
        return self

    def __exit__(self, *fault: object) -> None:
        self._folder.cleanup()

    def __call__(self, row: Row) -> Run:
        """Raises RunError where the command fails."""
        image = os.path.join(self._folder.name, OUTPUT)
        stats = os.path.join(self._folder.name, "stats.json")
        words = [image if word == OUTPUT else word for word in self._commands[row.name][1:]]
        python = [sys.executable, *(["-P"] if sys.flags.safe_path else []), "-m", "clrast"]
        started = time.perf_counter()
        done = subprocess.run([*python, *words, "--stats", stats, "-q"], capture_output=True, text=True)
        spent = time.perf_counter() - started
        if done.returncode != 0:
            said = (done.stderr.strip().splitlines() or ["it said nothing"])[-1]
            raise RunError(f"{as_line(self._commands[row.name])} ended with {done.returncode}: {said}")
        with open(stats, encoding="utf-8") as file:
            times = json.load(file)["times_ms"]
        return Run(spent, sum(times[stage] for stage in FRAME_STAGES), self._error_of(image))

    def _error_of(self, image: str) -> float:
        from clrast.image.frame import Frame

        frame = Frame.load(image)
        color = np.stack([frame[axis] for axis in "RGB"], axis=-1)
        metric = self._study.metric
        return measure_errors(color, self._study.reference.color, metric == "flip").value(metric)
