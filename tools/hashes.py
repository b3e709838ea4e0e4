#!/usr/bin/env python3
"""Holds AOVs against a stored table of SHA-256, on every OpenCL runtime that is here; exit 1 where one differs.

    python tools/hashes.py                                   every runtime that passes the self-test, all of the table
    python tools/hashes.py --device rusticl --scenes cube,room --precision midpoint
    python tools/hashes.py --markdown data/golden/aov_hashes.md         writes what was found, too
    python tools/hashes.py --write                           makes the table anew, on the default device

The table is data/golden/aov_hashes.json: for each scene and rung the methods that give the same image, and the hashes
of `id.prim`, `Z` and the shaded `R G B A` (channels one after the other, rows from the top, little-endian). Another
runtime, such as Intel's (`pip install intel-opencl-rt intel-cmplr-lib-rt tbb`), is found where OCL_ICD_VENDORS names a
folder with its .icd file; nothing is installed here. Look at the pictures before --write, and say why they changed.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import clrast  # noqa: E402
from clrast.errors import ClrastError, DeviceError, UsageError  # noqa: E402
from clrast.opencl.device import ListedDevice, list_devices, self_test  # noqa: E402
from clrast.options import AVAILABLE_PRECISIONS  # noqa: E402
from clrast.scene.model import Camera, Scene  # noqa: E402
from clrast.study.suite import make_scene  # noqa: E402
from clrast.visibility.methods import METHODS  # noqa: E402

TABLE = ROOT / "data" / "golden" / "aov_hashes.json"
SIZE = (80, 56)
CARDS = ("cube", "fan", "crossing", "icosphere", "room")
GENERATED = {"hall": 0.01, "city": 0.01}
"""Scenes of clrast/study/suite.py, at a share of their triangles."""
ROWS: dict[str, dict[str, str]] = {
    **{name: {"method": name} for name in METHODS},
    "raycast-brute:barycentric": {"method": "raycast-brute", "intersection": "barycentric"},
    "3dr-binning:incremental": {"method": "3dr-binning", "evaluation": "incremental"},
}
FEW_ROWS = ("2dh-binning", "3dr-binning", "3dr-full")
"""For scenes with textures, lights and glass, whose programs build for long."""
IMAGES = ("id.prim", "Z", "RGBA")
Hashes = dict[str, str]


@dataclass(frozen=True)
class View:
    """A scene and a camera of it."""

    name: str
    scene: Scene
    camera: Camera | None
    rows: tuple[str, ...] = tuple(ROWS)


def views() -> Iterator[View]:
    """Small scenes: dyadic and oblique numbers, folds, triangles across the eye's plane, textures, masks, glass."""
    for name in CARDS:
        scene = clrast.load(ROOT / "data" / f"{name}.toml")
        yield View(name, scene, None, FEW_ROWS if scene.lights else tuple(ROWS))
        if name == "room":
            yield View("room-plan", scene, next(c for c in scene.cameras if c.name == "plan"), FEW_ROWS)
    for name, scale in GENERATED.items():
        yield View(name, make_scene(name, scale), None, FEW_ROWS)


def digest(*planes: np.ndarray) -> str:
    """SHA-256 of arrays one after the other; -0 and NaN payloads count."""
    whole = hashlib.sha256()
    for plane in planes:
        whole.update(np.ascontiguousarray(plane).astype(plane.dtype.newbyteorder("<"), copy=False).tobytes())
    return whole.hexdigest()


def hashes_of(view: View, device: str | None, rung: str, row: str) -> Hashes | None:
    """The hashes of one render; None where the program refuses this rung for this method or this device."""
    try:
        frame = clrast.render(
            view.scene, camera=view.camera, size=SIZE, aov=("color", "depth", "id"), precision=rung, device=device,
            **ROWS[row],
        )  # fmt: skip
    except UsageError:
        return None
    except DeviceError:
        if rung == "double" or METHODS[row.split(":")[0]].grid:  # a device without float64, or one that ends loops
            return None
        raise
    return dict(zip(IMAGES, (digest(frame["id.prim"]), digest(frame["Z"]), digest(*(frame[c] for c in "RGBA"))),
                    strict=True))  # fmt: skip


def grouped(found: dict[str, Hashes]) -> list[dict[str, Any]]:
    """Methods of equal images together, in the order of their first ones."""
    groups: list[dict[str, Any]] = []
    for row, hashes in found.items():
        same = next((group for group in groups if all(group[k] == hashes[k] for k in IMAGES)), None)
        if same:
            same["methods"].append(row)
        else:
            groups.append({"methods": [row], **hashes})
    return groups


def make_table(rungs: Sequence[str]) -> dict[str, Any]:
    """The whole table, by the default device."""
    table: dict[str, Any] = {}
    for view in views():
        table[view.name] = {}
        for rung in rungs:
            found = {row: hashes_of(view, None, rung, row) for row in view.rows}
            table[view.name][rung] = grouped({row: one for row, one in found.items() if one is not None})
        print(f"{view.name}: {sum(len(groups) for groups in table[view.name].values())} different images", flush=True)
    return table


@dataclass
class Count:
    """What a runtime made of a scene: images equal to the table's and different, and what was refused."""

    equal: int = 0
    different: int = 0
    refused: int = 0


def check(
    table: dict[str, Any], device: str, names: Sequence[str], rungs: Sequence[str], rows: Sequence[str]
) -> dict[tuple[str, str], Count]:
    """(scene, rung) -> Count of one device; prints what differs."""
    counts: dict[tuple[str, str], Count] = {}
    for view in views():
        if view.name not in names:
            continue
        for rung in rungs:
            count = counts[view.name, rung] = Count()
            for group in table[view.name].get(rung, []):
                for row in group["methods"]:
                    if row not in rows:
                        continue
                    found = hashes_of(view, device, rung, row)
                    if found is None:
                        count.refused += 1
                        continue
                    wrong = [image for image in IMAGES if found[image] != group[image]]
                    count.different += len(wrong)
                    count.equal += len(IMAGES) - len(wrong)
                    if wrong:
                        print(f"DIFFERENT: {view.name}, {rung}, {row}: {', '.join(wrong)}", flush=True)
    return counts


def working(wanted: str | None) -> Iterator[ListedDevice]:
    """The first working device of each runtime; of the one that is wanted, or all but Oclgrind, an interpreter."""
    seen = set()
    for listed in list_devices():
        if listed.runtime in seen or (wanted != listed.runtime if wanted else listed.runtime == "oclgrind"):
            continue
        result = self_test(listed.handle)
        if result.ok:
            seen.add(listed.runtime)
            yield listed
        else:
            print(f"{listed.runtime}: left out: fails the self-test: {result.reason}")


def markdown(found: dict[str, dict[tuple[str, str], Count]], texts: dict[str, str]) -> str:
    """The counts as a page: a row for each scene and rung, a column for each runtime."""
    lines = ["# Hashes of AOVs on other runtimes", "",
             "Made by `python tools/hashes.py --markdown data/golden/aov_hashes.md`.",
             "Each cell: images (`id.prim`, `Z`, RGBA by every method) with the bytes of",
             "`data/golden/aov_hashes.json`, of all that the runtime renders. `double` needs a device with float64,",
             "grids one that ends no loops.",
             ""]  # fmt: skip
    lines += [f"- {name}: {text}" for name, text in texts.items()]
    lines += ["", f"| scene | rung | {' | '.join(found)} |", f"| --- | --- |{' --- |' * len(found)}"]
    for key in next(iter(found.values())):
        cells = [(f"{one.equal} of {one.equal + one.different}" if one.equal + one.different else "not offered")
                 for one in (counts[key] for counts in found.values())]  # fmt: skip
        lines.append(f"| {key[0]} | {key[1]} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def parse_arguments(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="write the table, on the default device")
    parser.add_argument("--device", help="a runtime: pocl, intel, rusticl, oclgrind; default: all but oclgrind")
    parser.add_argument("--scenes", help="comma list; default: all of the table")
    parser.add_argument("--precision", default=",".join(AVAILABLE_PRECISIONS), help="comma list of rungs")
    parser.add_argument("--methods", default=",".join(ROWS), help="comma list")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write what was found as a page")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """0: every hash is the table's; 1: one is not; 64: an unknown name; 69: no working device."""
    options = parse_arguments(arguments)
    rungs, rows = options.precision.split(","), options.methods.split(",")
    unknown = [name for name in (*rungs, *rows) if name not in (*AVAILABLE_PRECISIONS, *ROWS)]
    if unknown:
        print(f"hashes: {', '.join(unknown)}: unknown rung or method", file=sys.stderr)
        return 64
    try:
        if options.write:
            TABLE.write_text(json.dumps(make_table(rungs), indent=1) + "\n", encoding="utf-8")
            return 0
        table = json.loads(TABLE.read_text(encoding="utf-8"))
        names = options.scenes.split(",") if options.scenes else list(table)
        found, texts = {}, {}
        for listed in working(options.device):
            started = time.perf_counter()
            counts = found[listed.runtime] = check(table, listed.index, names, rungs, rows)
            texts[listed.runtime] = f"{listed.platform}, {listed.version}, driver {listed.driver}"
            equal, different, refused = (sum(getattr(one, k) for one in counts.values()) for k in vars(Count()))
            spent = time.perf_counter() - started
            print(f"{listed.runtime}: {equal} images equal, {different} different, {refused} renders refused, "
                  f"{spent:.0f} s ({texts[listed.runtime]})", flush=True)  # fmt: skip
    except ClrastError as error:
        print(f"hashes: {error}", file=sys.stderr)
        return error.exit_code
    if not found:
        print("hashes: no working OpenCL device: clrast devices says why", file=sys.stderr)
        return 69
    if options.markdown:
        options.markdown.write_text(markdown(found, texts), encoding="utf-8")
    checked = [one for counts in found.values() for one in counts.values()]
    return int(any(one.different for one in checked) or not any(one.equal for one in checked))


if __name__ == "__main__":
    sys.exit(main())
