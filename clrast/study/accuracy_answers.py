"""The two questions of a user with a deadline: the best within a time, and the cheapest for an error.

A time is that of the whole command as somebody waits for it (starting the program, loading, building, one frame,
writing), or of a frame alone, as in an animation or a service. What comes with every command is measured by running
one, and what is answered is run as printed before it is claimed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clrast.study.accuracy import Accuracy, Row
from clrast.study.accuracy_front import ERROR_MARGIN, is_level

OF_COMMAND, OF_FRAME = "command", "frame"
TIMES = (OF_COMMAND, OF_FRAME)
WHAT_IS_IN = {
    OF_COMMAND: "the whole command: starting, loading, building, a frame and writing",
    OF_FRAME: "a frame alone: setup, bin, visibility, shade and resolve",
}
RUNS = 3
LONG_RUN_S = 20.0
"""A command that takes longer is run once."""
SLACK = 1.1
"""The slowest of the runs may exceed the wanted time by this; their median may not."""
MOST_TRIES = 4


@dataclass(frozen=True)
class Run:
    """One run of a printed command: seconds of the whole, milliseconds of the frame, and the error of its image."""

    command_s: float
    frame_ms: float
    error: float


Runner = Callable[[Row], Run]
"""Runs the command of a row as it is printed."""


@dataclass(frozen=True)
class Answer:
    """What to take. asked : `time` or `error`. of : which time is meant. reached : whether anything does what was
    asked; else `row` is the nearest. predicted_s : of the command, None where none was run. runs : of the printed one.
    """

    asked: str
    value: float
    of: str
    reached: bool
    row: Row
    predicted_s: float | None
    runs: tuple[Run, ...] = ()

    def as_dict(self, command: Sequence[str], metric: str) -> dict[str, Any]:
        return {
            "asked": self.asked,
            "value": self.value,
            "time_of": self.of,
            "time_includes": WHAT_IS_IN[self.of],
            "reached": self.reached,
            "setting": self.row.name,
            "command": list(command),
            "predicted": {
                "command_s": self.predicted_s, "frame_ms": self.row.median_ms, metric: self.row.errors.value(metric),
            },
            "runs": [{"command_s": r.command_s, "frame_ms": r.frame_ms, metric: r.error} for r in self.runs],
        }  # fmt: skip


class Advisor:
    """Answers for one study. run : None claims times without running anything, and then knows frames alone."""

    def __init__(self, study: Accuracy, run: Runner | None) -> None:
        self.study, self._run = study, run
        self._overhead_s: float | None = None
        self._known: dict[str, tuple[Run, ...]] = {}

    def within_time(self, seconds: float, of: str) -> Answer:
        """The most accurate setting that takes at most so long."""
        rows = sorted(self.study.rows, key=lambda row: (self.study.error(row), row.median_ms))
        fitting = [row for row in rows if self._seconds(row, of) <= seconds]
        tries = 0
        while fitting and tries < MOST_TRIES:
            row = self._simplest(self._cheapest_of_level(fitting), fitting)
            runs = self._runs(row)
            if not runs or self._keeps(runs, of, seconds):
                return self._answer("time", seconds, of, True, row)
            fitting = [other for other in fitting if self._seconds(other, of) < 0.95 * self._seconds(row, of)]
            tries += 1
        fastest = min(self.study.rows, key=lambda row: row.median_ms)
        return self._answer("time", seconds, of, False, self._simplest(fastest, self.study.rows))

    def for_error(self, error: float) -> Answer:
        """The cheapest setting whose error is at most so large."""
        fitting = [row for row in self.study.rows if self.study.error(row) <= error]
        if fitting:
            fastest = min(fitting, key=lambda row: row.median_ms)
            return self._answer("error", error, OF_COMMAND, True, self._simplest(fastest, fitting))
        return self._answer("error", error, OF_COMMAND, False, min(self.study.rows, key=self.study.error))

    def _cheapest_of_level(self, rows: Sequence[Row]) -> Row:
        """Of the rows, sorted by error, the fastest among those whose errors equal the first's within the margin."""
        limit = self.study.error(rows[0]) * (1 + ERROR_MARGIN)
        return min((row for row in rows if self.study.error(row) <= limit), key=lambda row: row.median_ms)

    def _simplest(self, row: Row, rows: Sequence[Row]) -> Row:
        """Of the rows that are level with `row` in time and error, the one that changes least."""
        own = self.study.point(row)
        level = [each for each in rows if each is row or is_level(self.study.point(each), own)]
        return min(level, key=lambda each: len(each.setting.changes))

    def _answer(self, asked: str, value: float, of: str, reached: bool, row: Row) -> Answer:
        predicted = self._seconds(row, OF_COMMAND) if self._run is not None else None
        return Answer(asked, value, of, reached, row, predicted, self._runs(row))

    def _seconds(self, row: Row, of: str) -> float:
        """Predicted; that of the command is its frame and what all commands have in common."""
        frame_s = row.median_ms / 1000
        return frame_s if of == OF_FRAME else frame_s + self._overhead()

    def _overhead(self) -> float:
        """Seconds of a command without its frame, from those of the default."""
        if self._overhead_s is None:
            runs = self._runs(self.study.default)
            self._overhead_s = float(np.median([run.command_s - run.frame_ms / 1000 for run in runs])) if runs else 0.0
        return self._overhead_s

    def _runs(self, row: Row) -> tuple[Run, ...]:
        if self._run is None:
            return ()
        if row.name not in self._known:
            first = self._run(row)  # waits for what the driver still compiles
            is_long = first.command_s > LONG_RUN_S
            self._known[row.name] = (first,) if is_long else tuple(self._run(row) for _ in range(RUNS))
        return self._known[row.name]

    @staticmethod
    def _keeps(runs: Sequence[Run], of: str, seconds: float) -> bool:
        times = [run.command_s if of == OF_COMMAND else run.frame_ms / 1000 for run in runs]
        return float(np.median(times)) <= seconds and max(times) <= SLACK * seconds
