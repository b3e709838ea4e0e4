"""When a render of many paths should stop, and who is told how far it is."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

Observer = Callable[[int, int, int, float], None]
"""Told of progress: paths of a sample done, paths wanted, rays traced so far, seconds since the start."""


@dataclass
class Watch:
    """When a render should stop, and who is told how far it is.

    deadline : perf_counter seconds, None for none. interrupted : set from outside, such as by a signal. observer : None
    for nobody. `stopped` : why paths are missing, "time budget" or "interrupted", or None.
    """

    deadline: float | None = None
    observer: Observer | None = None
    interrupted: bool = False
    stopped: str | None = None
    started: float = field(default_factory=time.perf_counter)

    def should_stop(self) -> bool:
        """Whether no further path should be begun; asked where one is wanted, and remembered."""
        if self.interrupted:
            self.stopped = "interrupted"
        elif self.deadline is not None and time.perf_counter() >= self.deadline:
            self.stopped = self.stopped or "time budget"
        return self.stopped is not None

    def tell(self, done: int, wanted: int, rays: int) -> None:
        if self.observer is not None:
            self.observer(done, wanted, rays, time.perf_counter() - self.started)
