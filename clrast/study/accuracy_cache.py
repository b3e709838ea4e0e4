"""References between runs: colour arrays in a folder of the user's cache, named by all that decides their pixels.

The name is a hash of the scene's arrays, materials and lights, the view, the options, and this program's own source, so
that a reference of another version is never taken. A file appears whole or not at all, and carries a checksum (that of
the zip file inside); one that is damaged counts as absent. No fault of the cache is a fault of the study.
"""

from __future__ import annotations

import dataclasses
import hashlib
import os
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from clrast.opencl.binaries import cache_folder
from clrast.opencl.kernels import kernel_folder
from clrast.scene.model import Scene

FOLDER = "references"
MOST_FILES = 20
"""Files in the folder, the last used; one of 512x512 pixels takes 3 MB."""
IGNORED = ("name", "warnings", "cameras", "render_options", "image_size")
"""Fields of a scene that decide no pixel once the view and the options are chosen."""


def reference_key(scene: Scene, decided: Mapping[str, Any]) -> str:
    """40 hexadecimal digits. decided : what an image's header says of options and view."""
    digest = hashlib.sha256(_program_digest().encode())
    for field in dataclasses.fields(scene):
        if field.name not in IGNORED:
            _add(digest, field.name)
            _add(digest, getattr(scene, field.name))
    _add(digest, dict(decided))
    return digest.hexdigest()[:40]


def _add(digest: Any, value: Any) -> None:
    """Feed a value whole: its type, its length and its parts."""
    digest.update(f"{type(value).__name__}:".encode())
    if isinstance(value, np.ndarray):
        digest.update(f"{value.dtype.str}{value.shape}".encode())
        digest.update(np.ascontiguousarray(value).tobytes())
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        for field in dataclasses.fields(value):
            _add(digest, field.name)
            _add(digest, getattr(value, field.name))
    elif isinstance(value, Mapping):
        _add(digest, tuple(value.items()))
    elif isinstance(value, (list, tuple)):
        digest.update(f"{len(value)}:".encode())
        for member in value:
            _add(digest, member)
    else:
        text = repr(value).encode()
        digest.update(f"{len(text)}:".encode() + text)


def _program_digest() -> str:
    """Of the text of every module and kernel: versions in between two releases differ too."""
    package = Path(__file__).resolve().parents[1]
    files = [*package.rglob("*.py"), *kernel_folder().glob("*.cl"), *kernel_folder().glob("*.clh")]
    digest = hashlib.sha256()
    for path in sorted(files):
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def load_reference(key: str, shape: tuple[int, ...]) -> np.ndarray | None:
    """The colour under a key, or None: nothing there, damaged, or of another shape."""
    path = _path(key)
    if path is None:
        return None
    try:
        with np.load(path, allow_pickle=False) as stored:
            color = stored["color"]
        os.utime(path)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    return color if color.shape == shape and color.dtype == np.float32 else None


def save_reference(key: str, color: np.ndarray) -> None:
    """Keep (H, W, 3) float32 under a key; a folder that cannot be written is no error."""
    path = _path(key)
    if path is None:
        return
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".tmp", delete=False) as file:
            try:
                np.savez(file, color=color)
                file.flush()
                os.replace(file.name, path)
            except BaseException:
                os.unlink(file.name)
                raise
        for old in sorted(path.parent.glob("*.npz"), key=lambda p: p.stat().st_mtime)[:-MOST_FILES]:
            old.unlink()
    except OSError:
        pass


def _path(key: str) -> Path | None:
    folder = cache_folder()
    return None if folder is None else folder / FOLDER / f"{key}.npz"
