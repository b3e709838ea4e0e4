"""What the program is doing, on a terminal; nothing in a pipe."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def progress(quiet: bool) -> Iterator[Callable[[str], None]]:
    """A function that shows what is being done: a moving line on a terminal's stderr, or nothing."""
    if quiet or sys.stderr is None or not sys.stderr.isatty():
        yield lambda text: None
        return
    from rich.console import Console

    # soft_wrap: a warning that is said meanwhile stays one line, however narrow the terminal is
    with Console(stderr=True, soft_wrap=True).status("starting", spinner="dots") as status:
        yield lambda text: status.update(text)


def path_observer(show: Callable[[str], None]) -> Callable[[int, int, int, float], None]:
    """Shows how far paths are: their number, rays per second and the time that is left."""

    def observe(done: int, wanted: int, rays: int, seconds: float) -> None:
        left = seconds / done * (wanted - done)
        speed = rays / seconds / 1e6 if seconds > 0 else 0.0
        show(f"path {done} of {wanted}, {speed:.2f} million rays/s, {left:.0f} s left")

    return observe
