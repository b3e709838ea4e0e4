"""References between runs: colour arrays in a folder of the user's cache, named by all that decides their pixels.

The name is a hash of the scene's arrays, materials and lights, the view, the options, and this program's own source, so
that a reference of another version is never taken. A file appears whole or not at all, and carries a checksum (that of
the zip file inside); one that is damaged counts as absent. No fault of the cache is a fault of the study.
"""

from __future__ import annotations

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
from clrast.scene.content import content_digest
from clrast.scene.model import Scene

FOLDER = "references"
MOST_FILES = 20
"""Files in the folder, the last used; one of 512x512 pixels takes 3 MB."""


def reference_key(scene: Scene, decided: Mapping[str, Any]) -> str:
    """40 hexadecimal digits. decided : what an image's header says of options and view."""
    return content_digest(scene, _program_digest(), dict(decided))


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
