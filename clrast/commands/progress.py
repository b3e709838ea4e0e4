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
