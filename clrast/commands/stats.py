"""The stats of a render, as JSON and as a report: the schema of DESIGN section 2, keys always present."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from typing import Any

from clrast.options import EFFECTS, RenderOptions

KEYS = (
    "camera", "image", "device", "method", "method_requested", "precision", "aa", "mode", "bytes_device",
    "counts", "times_ms", "effects",
)  # fmt: skip
COUNTS = (
    "triangles", "setups", "edge_evaluations", "samples", "hits", "rays_primary", "rays_shadow", "rays_reflection",
    "rays_refraction", "rays_indirect", "traversal_steps", "intersection_tests", "kernel_launches", "passes",
)  # fmt: skip
STAGES = ("load", "build", "setup", "bin", "visibility", "shade", "resolve", "write", "plan", "total")

_VECTOR = re.compile(r"\[[-+.eE0-9,\s]+\]")


def complete_stats(own: Mapping[str, Any], options: RenderOptions, times_ms: Mapping[str, float]) -> dict[str, Any]:
    """The renderer's `own` stats in the design's order, with every key present.

    times_ms : what only the command knows (load, write, total), milliseconds. What the renderer does
    not count is null. Times that the design does not name stand apart, in `other_times_ms`; other keys of
    the renderer follow at the end.
    """
    width, height = options.size
    counts = own.get("counts", {})
    times = {**own.get("times_ms", {}), **times_ms}
    known: dict[str, Any] = {
        "image": {"width": width, "height": height},
        "method_requested": options.method,
        "precision": options.precision,
        "aa": options.aa,
        "mode": options.mode,
        **own,
        "counts": {**{name: counts.get(name) for name in COUNTS}, **counts},
        "times_ms": {name: float(times.get(name, 0.0)) for name in STAGES},
        "effects": _effects(own),
        "other_times_ms": {name: float(spent) for name, spent in times.items() if name not in STAGES},
    }
    stats = {name: known.pop(name, None) for name in KEYS}
    return _plain({**stats, **known})


def to_json(stats: Mapping[str, Any]) -> str:
    """JSON without NaN or Infinity, a key or a vector a line, ending in a line end."""
    text = json.dumps(_plain(stats), indent=2, allow_nan=False)
    return _VECTOR.sub(lambda vector: json.dumps(json.loads(vector.group())), text) + "\n"


def report_lines(stats: Mapping[str, Any]) -> list[str]:
    """The effects with their reasons and the stages with their times, as lines of a table."""
    costs = stats.get("effect_costs") or {}
    total_ms = stats["times_ms"]["total"] or 1.0
    rows: list[tuple[str, ...]] = [("effect", "on", "rays", "launches", "ms", "share", "reason")]
    for row in stats["effects"]:
        cost = costs.get(row["name"])
        figures = ("", "", "", "")
        if cost is not None:
            ms = cost["ms"]
            figures = (f"{cost['rays']:,}", f"{cost['launches']:,}", f"{ms:.1f}", f"{100 * ms / total_ms:.0f} %")
        rows.append((row["name"], "on" if row["on"] else "off", *figures, row["reason"]))
    if not costs:
        rows = [(row[0], row[1], row[-1]) for row in rows]
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]) - 1)]
    lines = []
    for row in rows:
        sized = enumerate(zip(row, widths, strict=False))
        cells = [cell.ljust(width) if k < 2 else cell.rjust(width) for k, (cell, width) in sized]
        lines.append("  ".join((*cells, row[-1])))
    if "method_reason" in stats:
        lines += ["", f"method {stats['method']}: {stats['method_reason']}"]
    counts = {**stats["counts"], **stats.get("other_counts", {})}
    if counts["setups"] is not None:
        lines += ["", f"{'count':<20}  {'number':>14}"]
        lines += [f"{name:<20}  {number:>14,}" for name, number in counts.items() if number is not None]
    lines += ["", f"{'stage':<10}  {'ms':>9}"]
    times = {**stats["times_ms"], **stats["other_times_ms"]}
    total = times.pop("total")
    lines += [f"{stage:<10}  {spent:9.2f}" for stage, spent in (*times.items(), ("total", total))]
    return lines


def summary(stats: Mapping[str, Any]) -> str:
    """One line: size, device, method, effects that are on, seconds."""
    device = stats["device"]
    if isinstance(device, Mapping):
        device = device.get("name", "unknown device")
    on = [row["name"] for row in stats["effects"] if row["on"]]
    image = stats["image"]
    return (
        f"{image['width']}x{image['height']} on {device}, method {stats['method']}, precision {stats['precision']}, "
        f"effects: {', '.join(on) if on else 'none'}; {stats['times_ms']['total'] / 1000:.2f} s"
    )


def _effects(own: Mapping[str, Any]) -> list[dict[str, Any]]:
    """All effects of the design in its order, each with a reason."""
    given = {row["name"]: row for row in own.get("effects", ())}
    absent = {"on": False, "reason": "not part of this version's renderer"}
    return [{"name": name, **{key: given.get(name, absent)[key] for key in ("on", "reason")}} for name in EFFECTS]


def _plain(value: Any) -> Any:
    """The value with numpy scalars and arrays as Python's own, and non-finite numbers as None."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(member) for key, member in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(member) for member in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
