"""A digest of what a scene is: files that keep results of a scene know by it whether they are of this one."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from clrast.scene.model import Scene

IGNORED = ("name", "warnings", "cameras", "render_options", "image_size")
"""Fields of a scene that decide no pixel once the view and the options are chosen."""


def content_digest(scene: Scene, *others: Any) -> str:
    """40 hexadecimal digits of a scene, and of other values: arrays, dataclasses, mappings, sequences, plain ones."""
    digest = hashlib.sha256()
    for field in dataclasses.fields(scene):
        if field.name not in IGNORED:
            _add(digest, field.name)
            _add(digest, getattr(scene, field.name))
    for value in others:
        _add(digest, value)
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
