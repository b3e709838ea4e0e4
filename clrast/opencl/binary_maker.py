"""Binaries for the cache, made beside the run that built the programs.

For a binary PoCL compiles all kernels of a program once more, with no size of work groups fixed. That takes as long as
what the run itself compiles at its launches, so another process does it, on another core where there is one. Only
`clrast render` of a single image asks for it: its start is what binaries make shorter, and nothing else runs while
times are measured.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from clrast.opencl import binaries

NICENESS = 10
"""The run goes first."""


@contextmanager
def kept_binaries() -> Iterator[BinaryMaker]:
    """Within it the binaries of all that is built are kept; its end waits for them, unless it ends by a fault.

    CLRAST_KEEP_BINARIES=off, for machines that are thrown away after a run, makes none.
    """
    maker = BinaryMaker()
    wishes = binaries.wishes if os.environ.get("CLRAST_KEEP_BINARIES") != "off" else []
    wishes.append(maker.ask)
    try:
        yield maker
        maker.wait()
    finally:
        wishes.remove(maker.ask)
        maker.stop()


class BinaryMaker:
    """Binaries, made by a process of its own that starts with the first wish."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._count = 0

    @property
    def is_busy(self) -> bool:
        return self._process is not None and self._process.poll() is None

    def ask(self, source: str, options: str, file_name: str) -> None:
        """Wish for the binary of a program, to lie in the cache under this name; no fault of it is one of the run."""
        try:
            if self._process is None:
                python = [sys.executable, *(["-P"] if sys.flags.safe_path else []), "-m", "clrast.opencl.binary_maker"]
                silent = subprocess.DEVNULL
                self._folder = tempfile.TemporaryDirectory(prefix="clrast-binaries-", ignore_cleanup_errors=True)
                self._process = subprocess.Popen(python, stdin=subprocess.PIPE, stdout=silent, stderr=silent)
            assert self._folder is not None and self._process.stdin is not None
            self._count += 1
            text = Path(self._folder.name) / f"{self._count}.cl"
            text.write_text(source, "utf-8")
            wish = {"source": str(text), "options": options, "file_name": file_name}
            self._process.stdin.write(json.dumps(wish).encode() + b"\n")
            self._process.stdin.flush()
        except (OSError, ValueError):
            pass

    def wait(self) -> None:
        """Until all wishes are fulfilled; an interruption ends the waiting, and no more."""
        if self._process is None:
            return
        assert self._process.stdin is not None
        try:
            self._process.stdin.close()
            self._process.wait()
        except (OSError, KeyboardInterrupt):
            pass

    def stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        if self._folder is not None:
            self._folder.cleanup()


def main() -> None:
    """The process: one wish a line on its standard input; what cannot be made is left out."""
    import pyopencl as cl

    os.nice(NICENESS)
    handles = [handle for platform in cl.get_platforms() for handle in platform.get_devices()]
    for line in sys.stdin:
        wish = json.loads(line)
        source = Path(wish["source"]).read_text("utf-8")
        for handle in handles:
            try:
                if binaries.make_binary(handle, source, wish["options"], wish["file_name"]):
                    break
            except Exception:
                pass


if __name__ == "__main__":
    main()
