"""Antialiasing by visibility at many samples and shading of few of each surface.

`--aa auto:EPS`, and msaa and csaa with shading rate auto; they differ in their rounds (rounds.py). The kernels are
cl/stratify_samples.cl, which says how, and cl/judge_strata.cl.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from clrast.opencl import buffers, kernels
from clrast.opencl.constants import LIST_CHUNK, STRATA, VISIT_SAMPLES
from clrast.opencl.device import Device
from clrast.opencl.features import Features
from clrast.opencl.layout import NO_HIT
from clrast.shading.edge_pixels import BYTES_PER_PIXEL, EdgePixels, padded
from clrast.shading.multisample import ground_arguments
from clrast.shading.rounds import Rounds, Visit
from clrast.shading.shade import WORK_GROUP, Shader
from clrast.visibility.listed_layers import ListedLayers, nearness_bytes
from clrast.visibility.listed_samples import ListedSamples
from clrast.visibility.sample_passes import SamplePasses
from clrast.visibility.sample_patterns import Position

SUMS_BYTES = 2 * 16 * STRATA
STATE_BYTES = SUMS_BYTES + 12 * STRATA + 1
"""Device bytes of what is known of a listed pixel's strata."""

TYPICAL_SHADED = 6
"""Samples of a listed pixel shaded at once that memory is planned for where no budget is given."""


def quads_of(pixel_count: int, width: int) -> int:
    """Quads of 2 x 2 pixels that cover a band, those at its ends in part."""
    return -(-width // 2) * -(-(pixel_count // width) // 2)


def bits_of(mask: int) -> list[int]:
    """Which bits are set, the lowest first."""
    return [k for k in range(mask.bit_length()) if mask >> k & 1]


def positions_of(part: dict[str, Any], masks: Sequence[int]) -> dict[int, Position]:
    """Where samples of a part lie, by number; masks : of each visit a bit for each of them."""
    numbers = (VISIT_SAMPLES * visit + k for visit, mask in enumerate(masks) for k in bits_of(mask))
    return {number: part["positions"][number] for number in numbers}


class StratifiedSampler:
    """Samples a band's pixels in rounds.

    shader : of colour alone, with features.sample_list. blends : whether surfaces do; what lies behind them is found
    for the samples that are shaded.
    """

    def __init__(
        self, device: Device, features: Features, rounds: Rounds, shader: Shader, max_pixels: int, blends: bool
    ) -> None:
        shader.footprint = rounds.footprint
        self.device, self.rounds, self.shader = device, rounds, shader
        self._projection = features.projection
        self.counts: dict[str, int] = {}
        self.own_launches = 0
        self.edges = EdgePixels(device, features, 0, max_pixels)
        self._samples = ListedSamples(device, features, rounds.positions)
        self._layers = ListedLayers(device, features, max_pixels) if blends else None
        self._nearness_bytes = nearness_bytes(features)
        self._first_prims = buffers.create(device, 4 * VISIT_SAMPLES * max_pixels)
        self._differs = buffers.create(device, max_pixels)
        self._strata = kernels.build(device, "stratify_samples.cl", features)
        self._judging = kernels.build(device, "judge_strata.cl", features)
        self._contrast = kernels.build(device, "flag_contrast.cl", features)
        self._parts: dict[int, list[dict[str, Any]]] = {}
        self._deviations = buffers.create(device, 4 * max_pixels)
        self._numbered = 0

    @property
    def launches(self) -> int:
        """Kernels launched so far, the shader's apart."""
        layers = 0 if self._layers is None else self._layers.launches
        return self.own_launches + self.edges.launches + self._samples.launches + layers

    @staticmethod
    def bytes_per_pixel(rounds: Rounds, at_worst: bool, features: Features | None, of_rays: int) -> tuple[int, int]:
        """Device bytes a pixel of a band takes here where all are listed, and those of them in the largest buffer.

        at_worst : and where all that may be is shaded. features : where surfaces blend. of_rays : what rays from a
        shaded sample take.
        """
        shaded = rounds.worst_shaded if at_worst else TYPICAL_SHADED
        visits = rounds.worst_visits if at_worst else 1
        of_listed = 5 * 4 + STATE_BYTES + 8 * (1 + visits) + 1 + 4 + 1 + 4 * VISIT_SAMPLES * visits
        largest = max(SUMS_BYTES, 4 * VISIT_SAMPLES * visits, 16 * shaded)
        if features is not None:
            of_nearness = nearness_bytes(features) * VISIT_SAMPLES * (1 + visits)
            of_listed += ListedLayers.bytes_per_pixel(features) + 4 * VISIT_SAMPLES + of_nearness
            largest = max(largest, of_nearness)
        of_shaded = 12 + Shader.bytes_per_pixel(("color",)) + (of_rays if at_worst else 0)
        return BYTES_PER_PIXEL + 5 + 4 * VISIT_SAMPLES + of_listed + shaded * of_shaded, largest

    def resolve_band(self, passes: SamplePasses, row: int, rows: int, pixel_count: int, target: Shader) -> None:
        """Replace the colour of a band in `target`, shaded at the centres, where samples are called for. Waits."""
        self.edges.start(passes, row, rows, pixel_count, self.rounds.positions)
        for visit in reversed(self.rounds.visits(0)):  # the first one's samples stay
            found = self.edges.center, self._differs, self._first_prims
            self._samples.decide_all(passes, (visit.number,), pixel_count, *found, (visit.lanes,))
            self._flag_surfaces(passes.tiles.view, visit, pixel_count)
        count = passes.timed("resolve", partial(self._list_first, passes.tiles.view, pixel_count, target))
        self._count("edge_pixels", count)
        self._count("samples_shaded", pixel_count)
        lists = ("edge_pixels", "all_slots")
        round_number = 0
        while count:
            self._band = {"count": count, "pixels": self.edges.room(lists[0]), "slots": self.edges.room(lists[1])}
            for part in self._parts_of(round_number):
                self._visit(passes, part, round_number, pixel_count, target)
            width = int(passes.tiles.view["width"])
            judge = partial(self._judge, round_number, lists, pixel_count, width, target)
            lists, count = passes.timed("resolve", judge)
            round_number += 1

    def _flag_surfaces(self, view: np.ndarray, visit: Visit, pixel_count: int) -> None:
        """Enqueue: flag pixels where a sample of a visit of the first round shows another surface; its last begins."""
        self._launch(
            self._strata, "flag_surfaces", pixel_count, pixel_count=pixel_count, lanes=visit.lanes,
            begins=int(visit == self.rounds.visits(0)[-1]), center_prims=self.edges.center, differs=self._differs,
            sample_prims=self._first_prims, edge_flags=self.edges.flags, **self._ground(view),
        )  # fmt: skip

    def _list_first(self, view: np.ndarray, pixel_count: int, target: Shader) -> int:
        width = int(view["width"])
        self._launch(
            self._contrast, "flag_contrast", quads_of(pixel_count, width), pixel_count=pixel_count, width=width,
            threshold=self.rounds.threshold, values=target.values, edge_flags=self.edges.flags,
        )  # fmt: skip
        self.edges.count_flags(pixel_count)
        count = self.edges.list_flagged(pixel_count)
        self._number_slots(count)
        buffers.fill(self.device, self._deviations, np.float32(-1.0), 4 * pixel_count)
        for name, size in (
            ("sums", SUMS_BYTES), ("stratum_prims", 4 * STRATA), ("stratum_counts", 4 * STRATA),
            ("stratum_firsts", 4 * STRATA), ("open", 1), ("chosen_counts", 1), ("first_shaded", 4), ("keep", 1),
        ):  # fmt: skip
            self.edges.room(name, size * count)
        return count

    def _number_slots(self, count: int) -> None:
        """Let `all_slots` begin with 0 .. count - 1."""
        if count > self._numbered:
            self._numbered = count + count // 8
            numbers = np.arange(self._numbered, dtype=np.uint32)
            buffers.write(self.device, self.edges.room("all_slots", numbers.nbytes), numbers)

    def _parts_of(self, round_number: int) -> list[dict[str, Any]]:
        """What a round looks at, part by part: visits whose samples are decided anew, and the kernels' arguments."""
        if round_number not in self._parts:
            self._parts[round_number] = [self._part_of(part) for part in self.rounds.parts(round_number)]
        return self._parts[round_number]

    def _part_of(self, part: list[Visit]) -> dict[str, Any]:
        later = [visit.number for visit in part if visit.number != 0 or self._layers is not None]
        rows: list[tuple[int, ...]] = []
        positions: list[Position] = []
        # By passes only those samples are decided again that may be shaded.
        lanes = [visit.shaded if self._layers is not None and not visit.is_new else visit.lanes for visit in part]
        for visit, looked_at in zip(part, lanes, strict=True):
            entry = VISIT_SAMPLES * later.index(visit.number) if visit.number in later else NO_HIT
            counted = looked_at | visit.seconds << VISIT_SAMPLES
            rows.append((entry, counted, visit.shaded, VISIT_SAMPLES * visit.number << 1 | int(visit.is_new)))
            positions += self.rounds.positions[VISIT_SAMPLES * visit.number : VISIT_SAMPLES * (visit.number + 1)]
        packed = np.array([x | y << 16 for x, y in positions], dtype=np.uint32)
        later_lanes = [bits for visit, bits in zip(part, lanes, strict=True) if visit.number in later]
        return {
            "later": later, "later_lanes": later_lanes, "visit_count": len(part),
            "stride": VISIT_SAMPLES * len(later), "positions": positions,
            "visits": buffers.upload(self.device, np.array(rows, dtype=np.uint32)),
            "sample_positions": buffers.upload(self.device, packed),
        }  # fmt: skip

    def _visit(
        self, passes: SamplePasses, part: dict[str, Any], round_number: int, pixel_count: int, target: Shader
    ) -> None:
        """Find what samples of the listed pixels show, shade those that are called for, and sum them."""
        view, count = passes.tiles.view, self._band["count"]
        later = self.edges.room("later_prims", 4 * part["stride"] * count)
        if self._layers is None:
            lists = self.edges.places, self._band["pixels"]
            self._samples.decide(passes, part["later"], count, self.edges.center, later, *lists, part["later_lanes"])
        else:
            self._layers.start(pixel_count, self._band["pixels"], count)
            self._layers.decide(passes, positions_of(part, part["later_lanes"]), self._entries(part))
        listed = passes.timed("resolve", partial(self._choose, view, part, round_number))
        if not listed:
            return
        shaded = self.edges.room("shaded_prims"), listed, 0, self.edges.room("places")
        passes.timed("shade", partial(self.shader.shade, view, *shaded))
        if self._layers is not None:
            self._shade_behind(passes, self._layers, part, listed)
        self._count("samples_shaded", listed)
        self._launch(
            self._judging, "gather_strata", count, **self._band, pixel_count=pixel_count, listed_count=listed,
            visit_count=part["visit_count"], begins=int(round_number == 0), colors=self.shader.values,
            values=target.values, deviations=self._deviations,
            **self._rooms("chosen", "stratum_counts", "first_shaded", "sums"),
        )  # fmt: skip

    def _entries(self, part: dict[str, Any]) -> dict[str, Any]:
        """What samples of the visits of a part show, and how near, as arguments."""
        size = self._nearness_bytes * part["stride"] * self._band["count"]
        return {
            "stride": part["stride"], "prims": self.edges.room("later_prims"),
            "nearness": self.edges.room("nearness", size),
        }  # fmt: skip

    def _shade_behind(self, passes: SamplePasses, layers: ListedLayers, part: dict[str, Any], listed: int) -> None:
        """Add what lies behind the samples that are shaded and let light through, layer by layer. Waits."""
        layer = 0
        samples: dict[int, Position] = {}
        while self.shader.has_open_pixels(listed):
            layer += 1
            samples = samples or self._shaded_samples(part)
            shaded = {"visit_count": part["visit_count"], "open_samples": self.shader.open_pixels}
            shaded |= self._rooms("chosen", "first_shaded")
            layers.decide_behind(passes, samples, layer, self._entries(part), shaded)
            passes.timed("resolve", partial(self._list_chosen, part))
            lists = self.edges.room("shaded_prims"), listed, layer, self.edges.room("places")
            passes.timed("shade", partial(self.shader.shade, passes.tiles.view, *lists))

    def _shaded_samples(self, part: dict[str, Any]) -> dict[int, Position]:
        """The samples of a part that are shaded in any pixel. Waits."""
        shape = self._band["count"], part["visit_count"], 4
        chosen = buffers.download(self.device, self.edges.room("chosen"), np.uint16, shape)[..., 0]
        return positions_of(part, np.bitwise_or.reduce(chosen, axis=0).tolist())

    def _choose(self, view: np.ndarray, part: dict[str, Any], round_number: int) -> int:
        """List the samples that are to be shaded; returns their number. Waits."""
        count = self._band["count"]
        chosen = self.edges.room("chosen", 8 * part["visit_count"] * count)
        self._launch(
            self._strata, "meet_strata", count, **self._band, **self._samples_of(part), **self._ground(view),
            chosen=chosen, begins=int(round_number == 0), lone_samples=self.rounds.lone_samples(round_number),
            uses_center=int(self.rounds.uses_center),
            **self._rooms("open", "stratum_prims", "stratum_counts", "stratum_firsts", "chosen_counts"),
        )  # fmt: skip
        listed = self.edges.sum_entries(self.edges.room("chosen_counts"), count)
        if listed:
            self.edges.room("shaded_prims", 4 * listed)
            self.edges.room("places", 8 * listed)
            self._list_chosen(part)
            self.shader.make_room(listed)
        return listed

    def _samples_of(self, part: dict[str, Any]) -> dict[str, Any]:
        """What the samples of a part are and show, as arguments."""
        of_samples = {name: part[name] for name in ("visit_count", "stride", "visits", "sample_positions")}
        return of_samples | {
            "center_prims": self.edges.center, "differs": self._differs, "first_prims": self._first_prims,
            "later_prims": self.edges.room("later_prims"),
        }  # fmt: skip

    def _list_chosen(self, part: dict[str, Any]) -> None:
        """Enqueue: list what the samples that are shaded show."""
        band = {name: self._band[name] for name in ("count", "pixels")}
        self._strata.launch(
            "list_chosen", -(-band["count"] // LIST_CHUNK), 1, **band, **self._samples_of(part),
            begins=self.edges.begins, **self._rooms("chosen", "first_shaded", "shaded_prims", "places"),
        )  # fmt: skip
        self.own_launches += 1

    def _judge(
        self, round_number: int, lists: tuple[str, str], pixel_count: int, width: int, target: Shader
    ) -> tuple[tuple[str, str], int]:
        """Finish the pixels whose error is small; returns the lists of the others, and their number. Waits."""
        count, rounds = self._band["count"], self.rounds
        self._launch(
            self._judging, "judge_strata", count, **self._band, pixel_count=pixel_count, width=width,
            sample_count=float(rounds.samples[round_number]), error_factor=rounds.edge_error(round_number),
            threshold=rounds.threshold_of(round_number), deviations=self._deviations,
            values=target.values, **self._rooms("stratum_counts", "sums", "open", "keep"),
        )  # fmt: skip
        kept = self.edges.sum_entries(self.edges.room("keep"), count)
        others = ("other_pixels", "other_slots") if lists[0] == "edge_pixels" else ("edge_pixels", "slots")
        self._judging.launch(
            "keep_strata", -(-count // LIST_CHUNK), 1, **self._band, begins=self.edges.begins,
            keep=self.edges.room("keep"), kept_pixels=self.edges.room(others[0], 4 * kept),
            kept_slots=self.edges.room(others[1], 4 * kept), pixel_places=self.edges.places,
        )  # fmt: skip
        self.own_launches += 1
        return others, kept

    def _ground(self, view: np.ndarray) -> dict[str, Any]:
        return ground_arguments(self.shader, view, self._projection)

    def _rooms(self, *names: str) -> dict[str, Any]:
        return {name: self.edges.room(name) for name in names}

    def _count(self, name: str, count: int) -> None:
        self.counts[name] = self.counts.get(name, 0) + count

    def _launch(self, program: kernels.Program, kernel: str, items: int, /, **arguments: Any) -> None:
        program.launch(kernel, padded(items), WORK_GROUP, **arguments)
        self.own_launches += 1
