"""Sums of paths that may stop early and go on later: time budgets, interruptions, `--resume`, progress.

Paths of a sample are summed one after the other, in float32, and a file keeps the sums as they are: going on from it
gives the bits of a render that never stopped.
"""

from __future__ import annotations

import os
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from clrast.errors import InputNotFoundError, OutputError, SceneError
from clrast.shading.watch import Watch

MAX_FILE_BYTES = 1 << 33

class Accumulation:
    """The sums of a render's calls, in their order: one for each band, layer and sample of antialiasing.

    path : the file to go on from, if it is there, and to keep the sums in. key : of scene, view and options.
    """

    def __init__(self, watch: Watch, path: str | None = None, key: str = "") -> None:
        self.watch, self.path, self.key = watch, path, key
        self._call = 0
        self._sums: list[np.ndarray] = []
        self._done: list[int] = []
        self._stored = _read(path, key) if path is not None and os.path.lexists(path) else ([], [])

    def start_frame(self) -> None:
        self._call = 0
        self._sums, self._done = [], []

    def begin(self, size: int) -> tuple[int, np.ndarray | None]:
        """Paths that this call has behind it, and their sums: (size,) float32, or None where there are none."""
        counts, sums = self._stored
        if self._call >= len(counts) or not counts[self._call]:
            return 0, None
        kept = sums[self._call]
        if kept.shape != (size,):
            raise SceneError(f"{self.path} does not fit this render: name another file for --resume, or remove it")
        return counts[self._call], kept

    def end(self, done: int, read: Callable[[], np.ndarray]) -> None:
        """The call has so many paths behind it; `read` gives its sums, and is asked only where they are kept."""
        self._call += 1
        self._done.append(done)
        if self.path is not None:
            self._sums.append(read())

    @property
    def paths_done(self) -> tuple[int, int]:
        """The fewest and the most paths that a sample has; (0, 0) where none was wanted."""
        return (min(self._done), max(self._done)) if self._done else (0, 0)

    def save(self) -> None:
        """Keep the sums in the file, whole or not at all; raises OutputError."""
        if self.path is None:
            return
        target = Path(self.path)
        arrays: dict[str, Any] = {f"sums{k}": each for k, each in enumerate(self._sums)}
        try:
            with tempfile.NamedTemporaryFile(dir=target.parent or ".", prefix=".clrast-", delete=False) as file:
                try:
                    np.savez(file, key=np.array(self.key), done=np.array(self._done, dtype=np.int64), **arrays)
                    file.flush()
                    os.replace(file.name, target)
                except BaseException:
                    os.unlink(file.name)
                    raise
        except OSError as fault:
            raise OutputError(f"--resume {self.path}: {fault.strerror}: free space or name another file") from None


def _read(path: str, key: str) -> tuple[list[int], list[np.ndarray]]:
    """Paths done and sums of each call. Raises SceneError for a file that is damaged or of another render."""
    what = f"--resume {path}"
    try:
        if os.path.getsize(path) > MAX_FILE_BYTES:
            raise SceneError(f"{what} has more than {MAX_FILE_BYTES} bytes: it is no file of sums; name another")
        with np.load(path, allow_pickle=False) as stored:
            own, done = str(stored["key"]), [int(count) for count in stored["done"].reshape(-1)]
            sums = [stored[f"sums{k}"] for k in range(len(done))] if own == key else []
    except (ValueError, KeyError, EOFError, zipfile.BadZipFile) as fault:
        raise SceneError(f"{what} is no file of sums ({type(fault).__name__}): name another, or remove it") from None
    except OSError as fault:
        raise InputNotFoundError(f"{what} cannot be read: {fault.strerror}: name a file") from None
    if own != key:
        raise SceneError(f"{what} is of another scene, view or options: name another file, or remove it")
    if any(each.dtype != np.float32 or each.ndim != 1 for each in sums) or min(done, default=0) < 0:
        raise SceneError(f"{what} is damaged: remove it")
    return done, sums
