"""The files of a render: checked before it, written whole, and all of them or none."""

from __future__ import annotations

import os
import stat
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from clrast.errors import OutputError, UsageError
from clrast.image.files import IMAGE_SUFFIXES, check_writable
from clrast.option_values import did_you_mean

if TYPE_CHECKING:
    from clrast.image.frame import Frame


@dataclass
class Outputs:
    """Where results go. `images` : paths with a suffix of IMAGE_SUFFIXES; `stats` : a path or None; `half` : of EXR.

    Files are prepared beside their targets and take their places together in `commit`.
    """

    images: tuple[str, ...]
    stats: str | None = None
    half: bool = False
    _prepared: list[tuple[str, str]] = field(default_factory=list)

    @property
    def has_png(self) -> bool:
        return any(_suffix(path) == ".png" for path in self.images)

    def check_usage(self, source: str) -> None:
        """Raises UsageError for an unknown suffix, for one file named twice, and where `source` would be lost."""
        for path in self.images:
            if _suffix(path) not in IMAGE_SUFFIXES:
                hint = did_you_mean(_suffix(path), IMAGE_SUFFIXES)
                raise UsageError(f"--output {path!r} has no known suffix: name a file .exr or .png{hint}")
        paths = [*self.images, *([self.stats] if self.stats is not None else [])]
        if self.stats == "":
            raise UsageError("--stats '' names no file: give one, such as stats.json")
        seen = {_real(source): "the input"}
        for path in paths:
            real = _real(path)
            if real in seen:
                raise UsageError(f"output {path!r} is {seen[real]} too: give each a file of its own")
            seen[real] = "another output"

    def check_writable(self) -> None:
        """Raises OutputError where a file could not be written in the end; writes nothing."""
        for path in self.images:
            check_writable(path)
        if self.stats is not None and not _is_stream(self.stats):
            check_writable(self.stats, suffixes=None)

    def prepare_images(self, frame: Frame, exr_frame: Frame) -> None:
        """Write every image beside its target: EXR files take `exr_frame`, pictures take `frame`."""
        for path in self.images:
            real = _real(path)
            kept = exr_frame if _suffix(path) == ".exr" else frame
            temporary = self._beside(real)
            try:
                kept.save(temporary, self.half)
            except OutputError as fault:
                raise OutputError(str(fault).replace(temporary, path)) from None

    def prepare_stats(self, text: str) -> None:
        """Write the stats beside their target, or into it where it is a pipe or a terminal."""
        if self.stats is None:
            return
        try:
            if _is_stream(self.stats):
                with open(self.stats, "w", encoding="utf-8") as stream:
                    stream.write(text)
                return
            with open(self._beside(_real(self.stats)), "x", encoding="utf-8") as file:
                file.write(text)
        except OSError as fault:
            raise OutputError(f"cannot write {self.stats}: {fault.strerror}: free space or name another file") from None

    def commit(self) -> None:
        """Move all prepared files to their places."""
        while self._prepared:
            temporary, target = self._prepared[0]
            try:
                os.replace(temporary, target)
            except OSError as fault:
                self.discard()
                raise OutputError(f"cannot write {target}: {fault.strerror}: name another file") from None
            self._prepared.pop(0)

    def discard(self) -> None:
        """Remove what was prepared and not committed."""
        while self._prepared:
            temporary, _ = self._prepared.pop()
            try:
                os.unlink(temporary)
            except OSError:
                pass

    def _beside(self, target: str) -> str:
        """A temporary name in the target's folder, with its suffix; remembered for `commit`."""
        folder, name = os.path.split(target)
        temporary = os.path.join(folder, f".clrast-{os.getpid()}-{len(self._prepared)}{_suffix(name)}")
        self._prepared.append((temporary, target))
        return temporary


def _suffix(path: str) -> str:
    return os.path.splitext(path)[1].lower()


def _real(path: str) -> str:
    """The path with links followed; as it is where that cannot be."""
    try:
        return os.path.realpath(path)
    except (OSError, ValueError):
        return path


def _is_stream(path: str) -> bool:
    """Whether the path is a pipe or a device, into which one writes directly."""
    if os.path.abspath(path).startswith("/dev/"):
        return os.path.exists(path)
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):
        return False
    return stat.S_ISCHR(mode) or stat.S_ISFIFO(mode)
