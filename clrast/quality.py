"""What `--quality` stands for: the one table, with what it was measured to cost.

Options that the user gives win over a preset, and a preset that the user gives over a scene's card. An image's header
has the options that come out, never the preset's name: what a preset stands for may change, what an image is may not.

    clrast accuracy INPUT        what these settings cost and how far they are off on a scene of yours

At 512x512 (tools/make_accuracy_pictures.py; times over that of `preview`, rmse of linear colour):

            bunny           Sponza inside   data/room.toml
    preview 1    0.0103     1    0.0202     1    0.0212      as fast as the rung `fast`, and without its wrong samples
    draft   4.4  0.0037     5.5  0.0070     4.7  0.0056      textures too, which msaa leaves as they are
    final   57   0.0006     49   0.0009     87   0.0008      exact is within the noise of ssaa:64 by `midpoint`
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

PRESETS: dict[str, dict[str, str]] = {
    "preview": {"precision": "midpoint", "aa": "none"},
    "draft": {"precision": "midpoint", "aa": "ssaa:4"},
    "final": {"precision": "exact", "aa": "ssaa:64"},
}


def with_preset(values: Mapping[str, Any]) -> dict[str, Any]:
    """Options by name, with those of their `quality` in its place where they are not given themselves.

    A name that is no preset stays, for the check of options to refuse.
    """
    name = values.get("quality")
    if not isinstance(name, str) or name not in PRESETS:
        return dict(values)
    return {**PRESETS[name], **{option: value for option, value in values.items() if option != "quality"}}
