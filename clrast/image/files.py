"""Output files that appear whole or not at all, and the check that they can, before any work is done."""

from __future__ import annotations

import os
import secrets
import stat
from collections.abc import Callable
from pathlib import Path

from clrast.errors import OutputError, UsageError

IMAGE_SUFFIXES = (".exr", ".png")


def image_suffix(path: str | Path) -> str:
    """`.exr` or `.png`, in lower case; UsageError for any other suffix."""
    suffix = os.path.splitext(os.fspath(path))[1].lower()
    if suffix not in IMAGE_SUFFIXES:
        raise UsageError(f"{path}: cannot write {suffix or 'a name without a suffix'}: use .exr or .png")
    return suffix


def check_writable(path: str | Path, suffixes: tuple[str, ...] | None = IMAGE_SUFFIXES) -> None:
    """Raise OutputError if a file cannot be written at `path`, UsageError if its suffix is none of `suffixes`.

    Call it before rendering: it creates a file in the folder and removes it again. An existing
    file at `path` stays as it is. `suffixes` None allows any name.
    """
    if suffixes is not None and os.path.splitext(os.fspath(path))[1].lower() not in suffixes:
        raise UsageError(f"{path}: unknown suffix: use {' or '.join(suffixes)}")
    target = _target(path)
    probe = _sibling(target, ".tmp")
    try:
        with open(probe, "xb"):
            pass
        os.unlink(probe)
    except (OSError, ValueError) as fault:
        raise _cannot_write(path, fault) from None


def write_whole(path: str | Path, write: Callable[[str], None]) -> None:
    """Let `write(name)` make a file under a name of its own in the same folder, then rename it to `path`.

    Where `write` raises, or the rename fails, nothing is left behind and an old file at `path` stays.
    """
    target = _target(path)
    draft = _sibling(target, os.path.splitext(target)[1].lower())
    try:
        write(draft)
        os.replace(draft, target)
    except (OSError, ValueError) as fault:
        raise _cannot_write(path, fault) from None
    finally:
        try:
            os.unlink(draft)
        except (OSError, ValueError):
            pass


def write_text(path: str | Path, text: str) -> None:
    """Write UTF-8 text, whole or not at all."""

    def write(draft: str) -> None:
        with open(draft, "w", encoding="utf-8", newline="\n") as file:
            file.write(text)

    write_whole(path, write)


def _target(path: str | Path) -> str:
    """The file that `path` stands for, links followed; OutputError if it exists and is no file we may replace."""
    try:
        target = os.path.realpath(os.fspath(path))
        target.encode("utf-8")  # OpenImageIO takes no other names
        mode = os.stat(target).st_mode
    except FileNotFoundError:
        folder = os.path.dirname(target)
        if not os.path.isdir(folder):
            raise OutputError(f"{path}: there is no folder {folder}: create it or choose another place") from None
        return target
    except (OSError, ValueError) as fault:
        raise _cannot_write(path, fault) from None
    if stat.S_ISDIR(mode):
        raise OutputError(f"{path}: is a folder: give the name of a file in it")
    if not stat.S_ISREG(mode):
        raise OutputError(f"{path}: is no regular file: give another name")
    if not os.access(target, os.W_OK, effective_ids=os.access in os.supports_effective_ids):
        raise OutputError(f"{path}: is write-protected: give another name or make it writable")
    return target


def _sibling(target: str, suffix: str) -> str:
    """An unused hidden name in the target's folder: short, so that it fits wherever the target's own name fits."""
    return os.path.join(os.path.dirname(target), f".clrast-{secrets.token_hex(6)}{suffix}")


def _cannot_write(path: str | Path, fault: Exception) -> OutputError:
    reason = fault.strerror if isinstance(fault, OSError) and fault.strerror else str(fault)
    return OutputError(f"{path}: cannot be written ({reason}): choose another place or make room")
