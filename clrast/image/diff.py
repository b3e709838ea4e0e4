"""What changed between two images: every part, every channel, and a verdict that says what would pass.

Beside idiff, whose options and exit codes it keeps, it compares ids exactly, sees a NaN or Inf on one
side only, looks at all parts, and measures colour by FLIP.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from clrast.errors import UsageError
from clrast.image.channel_diff import (
    ChannelDiff,
    PartTotals,
    Thresholds,
    compare_floats,
    compare_ids,
    largest_but,
    rounded_up,
)
from clrast.image.flip import FlipError, flip_error
from clrast.image.frame import Frame, Part
from clrast.image.heatmap import ErrorMaps, write_heatmap
from clrast.image.pairing import Pair, Pairing, pair_up
from clrast.image.read import HEADER_PREFIX, read_parts

EXIT_CODES = {"pass": 0, "warning": 1, "failure": 2, "structure": 3}


@dataclass
class DiffReport:
    """The result of a comparison.

    status : "pass", "warning", "failure", or "structure" (sizes, channels or parts differ)
    channels : one ChannelDiff per channel that was compared, in the order of the reference
    structure : sentences on what differs in structure; notes : on what decided nothing
    flip : FLIP of the colour, None where there is none on both sides
    passes_with : options of `clrast diff` that let the pixels pass; None where none do
    verdict : one line
    """

    reference: str
    test: str
    status: str = "pass"
    channels: list[ChannelDiff] = field(default_factory=list)
    structure: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    flip: FlipError | None = None
    passes_with: list[str] | None = field(default_factory=list)
    verdict: str = ""

    @property
    def exit_code(self) -> int:
        """As idiff documents them: 0 pass, 1 warning, 2 failure, 3 sizes, channels or parts differ."""
        return EXIT_CODES[self.status]

    @property
    def equal(self) -> bool:
        """True where nothing differs, however little; headers aside."""
        return not self.structure and not any(channel.differing for channel in self.channels)

    def __getitem__(self, channel: str) -> ChannelDiff:
        for found in self.channels:
            if found.channel == channel:
                return found
        raise KeyError(f"no channel {channel!r} was compared")

    def to_dict(self) -> dict[str, Any]:
        """For JSON: numbers that JSON has no form for become the texts "nan", "inf", "-inf"."""
        flip = None
        if self.flip is not None:
            flip = {"mean": self.flip.mean, "max": self.flip.max, "worst": list(self.flip.worst)}
        return _plain({
            "reference": self.reference, "test": self.test, "status": self.status, "exit_code": self.exit_code,
            "verdict": self.verdict, "passes_with": self.passes_with, "structure": self.structure,
            "notes": self.notes, "flip": flip, "channels": [asdict(found) for found in self.channels],
        })  # fmt: skip


def diff(
    reference: str | Path | Frame,
    test: str | Path | Frame,
    output: str | Path | None = None,
    output_only_different: bool = False,
    **thresholds: Any,
) -> DiffReport:
    """Compare two images: frames, or .exr and .png files.

    output : where to write the difference image, .exr (error of each channel) or .png (heat map); not
        written where sizes differ, nor, with output_only_different, where all pixels are equal
    thresholds : fields of Thresholds, as fail=0.01 or rules={"N.*": 0.1}

    Raises InputNotFoundError or SceneError where a file cannot be read, UsageError, OutputError.
    """
    limits = _limits(thresholds)
    names = (
        "the reference" if isinstance(reference, Frame) else str(reference),
        "the test" if isinstance(test, Frame) else str(test),
    )
    from_files = not (isinstance(reference, Frame) or isinstance(test, Frame))
    pairing = pair_up(_parts(reference), _parts(test), names, from_files)
    _check_rules(limits, pairing)
    report = DiffReport(*names)
    maps = None if output is None else ErrorMaps()
    for part in dict.fromkeys(id(pair.reference) for pair in pairing.pairs):
        _compare_part(report, [pair for pair in pairing.pairs if id(pair.reference) == part], limits, maps)
    _compare_colour(report, pairing.pairs, limits)
    _judge(report, pairing, limits)
    if output is not None and maps is not None and not (output_only_different and report.equal):
        if maps.ratio is None:
            report.notes.append(f"{output} is not written: no pixels could be compared")
        else:
            write_heatmap(output, maps, report.flip)
    return report


def _limits(thresholds: dict[str, Any]) -> Thresholds:
    try:
        return Thresholds(**thresholds)
    except TypeError:
        known = ", ".join(Thresholds.__dataclass_fields__)
        unknown = ", ".join(sorted(set(thresholds) - set(Thresholds.__dataclass_fields__)))
        raise UsageError(f"diff knows no threshold {unknown}: use {known}") from None


def _parts(image: str | Path | Frame) -> list[Part]:
    if not isinstance(image, Frame):
        return read_parts(image)
    parts = image.parts()
    parts[0].header.update({HEADER_PREFIX + key: value for key, value in image.header.items()})
    return parts


def _check_rules(limits: Thresholds, pairing: Pairing) -> None:
    """A rule that no channel obeys is a slip of the pen, and would let a difference pass unseen."""
    keys = [pair.key for pair in pairing.pairs]
    for name in limits.rules:
        alone = Thresholds(rules={name: 0.0})
        if keys and not any(alone.rule_for(key) is not None for key in keys):
            raise UsageError(f"--rule {name}: no such channel was compared: there are {' '.join(keys)}")


def _compare_part(report: DiffReport, pairs: Sequence[Pair], limits: Thresholds, maps: ErrorMaps | None) -> None:
    """Compare the channels of one part; pixels are counted over all of its float channels together."""
    floats: list[ChannelDiff] = []
    totals: PartTotals | None = None
    for pair in pairs:
        a, b = pair.reference.channels[pair.name], pair.test.channels[pair.name]
        rule = limits.rule_for(pair.key)
        uint = a.dtype == np.uint32
        standard = float(limits.id_fail) if uint else limits.fail
        threshold = standard if rule is None else rule
        found = ChannelDiff(pair.reference.name, pair.key, "uint" if uint else "float", threshold)
        errors = compare_ids(found, a, b) if uint else compare_floats(found, a, b, limits, rule)
        report.channels.append(found)
        if maps is not None:
            maps.add(pair.key, a.shape, None if errors is None else errors.error, 0.0 if uint else threshold)
        if found.worst is not None:
            found.worst = (found.worst[0] + pair.reference.window[0], found.worst[1] + pair.reference.window[1])
        if uint and found.failing:
            found.status = "failure"
            _let_pass(report, "--id-fail" if rule is None else f"--rule {pair.key}=", found.differing)
        elif not uint and errors is not None:
            totals = PartTotals(a.shape) if totals is None else totals
            totals.add(errors, rule is not None)
            floats.append(found)
    if totals is not None:
        _judge_part(report, floats, totals, limits)


def _judge_part(
    report: DiffReport, floats: Sequence[ChannelDiff], totals: PartTotals, limits: Thresholds
) -> None:
    """Status of a part's float channels, and what would let them pass."""
    allowed = max(limits.allowfailures, limits.failpercent * totals.fails.size / 100.0)
    allowed_warnings = max(limits.allowfailures, limits.warnpercent * totals.fails.size / 100.0)
    over, warned = np.count_nonzero(totals.fails) > allowed, np.count_nonzero(totals.warns) > allowed_warnings
    over_hard = np.count_nonzero(totals.error > limits.hardfail) > limits.allowfailures
    warned_hard = np.count_nonzero(totals.error > limits.hardwarn) > limits.allowfailures
    for found in floats:
        error = found.max_error or 0.0
        if found.nonfinite or (over and found.failing) or (over_hard and error > limits.hardfail):
            found.status = "failure"
        elif (warned and found.warning) or (warned_hard and error > limits.hardwarn):
            found.status = "warning"
    if any(found.nonfinite for found in floats):
        report.passes_with = None
        return
    if over:
        needed = largest_but(totals.without_rule, math.floor(allowed))
        if needed > limits.fail:
            _let_pass(report, "--fail", rounded_up(needed))
        for found in floats:
            if found.failing and limits.rule_for(found.channel) is not None:
                _let_pass(report, f"--rule {found.channel}=", found.passes_at or 0.0)
    if over_hard:
        _let_pass(report, "--hardfail", rounded_up(largest_but(totals.error, limits.allowfailures)))


def _let_pass(report: DiffReport, option: str, value: float) -> None:
    """Add an option to those that would let the images pass; of two values the larger stays."""
    if report.passes_with is None:
        return
    words = report.passes_with
    rule = option.startswith("--rule ")
    text = _short(value)
    if rule:
        words += ["--rule", f"{option.removeprefix('--rule ')}{text}"]
    elif option in words:
        place = words.index(option) + 1
        words[place] = text if value > float(words[place]) else words[place]
    else:
        words += [option, text]


def _compare_colour(report: DiffReport, pairs: Sequence[Pair], limits: Thresholds) -> None:
    """FLIP, where both images have R, G and B of one size."""
    colour = {pair.key: pair for pair in pairs if pair.key in ("R", "G", "B")}
    sides = []
    if len(colour) == 3:
        sides = [[getattr(colour[key], side).channels[key] for key in "RGB"] for side in ("reference", "test")]
    planes = [plane for side in sides for plane in side]
    if not planes or any(plane.dtype != np.float32 or plane.shape != planes[0].shape for plane in planes):
        if limits.fail_flip is not None:
            raise UsageError("--fail-flip needs colour (R G B) of one size in both images: leave it out")
        return
    report.flip = flip_error(np.stack(sides[0], axis=-1), np.stack(sides[1], axis=-1))
    if limits.fail_flip is not None and report.flip.mean > limits.fail_flip:
        _let_pass(report, "--fail-flip", rounded_up(report.flip.mean))


def _judge(report: DiffReport, pairing: Pairing, limits: Thresholds) -> None:
    """Status and verdict of the whole."""
    report.notes += pairing.notes
    report.structure = list(pairing.unequal)
    (report.notes if limits.allow_missing else report.structure).extend(pairing.missing)
    if not pairing.pairs and not report.structure:
        report.structure.append("the images have no channel in common")
    flip_fails = limits.fail_flip is not None and report.flip is not None and report.flip.mean > limits.fail_flip
    header_fails = limits.header and bool(pairing.header)
    report.notes += pairing.header
    statuses = {found.status for found in report.channels}
    if report.structure:
        report.status = "structure"
    elif "failure" in statuses or flip_fails or header_fails:
        report.status = "failure"
    elif "warning" in statuses:
        report.status = "warning"
    report.verdict = _verdict(report, flip_fails, pairing.header if header_fails else [], limits)


def _verdict(report: DiffReport, flip_fails: bool, header: Sequence[str], limits: Thresholds) -> str:
    """One line: the status, the worst channel with its pixel and both values, and what would pass."""
    if report.status == "structure":
        return f"DIFFERENT STRUCTURE: {report.structure[0]}" + _and_more(report.structure)
    title = report.status.upper()
    worst = max(report.channels, key=lambda found: found.severity)
    if not worst.differing:
        said = f"{len(report.channels)} channels are equal"
    else:
        said = _worst_said(report, worst)
    if flip_fails and report.flip is not None:
        said += f"; mean FLIP {_short(report.flip.mean)} is over {_short(limits.fail_flip or 0.0)}"
    if header:
        said += f"; {header[0]}{_and_more(header)}"
    if report.status == "failure" and (worst.status == "failure" or flip_fails):
        options = " ".join(report.passes_with or [])
        said += f"; {options} would pass" if options else "; no threshold would pass"
    return f"{title}: {said}"


def _worst_said(report: DiffReport, worst: ChannelDiff) -> str:
    assert worst.worst is not None
    where = f"{worst.channel} at ({worst.worst[0]}, {worst.worst[1]})"
    values = f"{value_text(worst, worst.reference_value)} in {report.reference}, "
    values += f"{value_text(worst, worst.test_value)} in {report.test}"
    if worst.kind == "uint":
        return f"{where}: {values}; {_pixels(worst.differing)} differ, {_short(worst.threshold)} may"
    if worst.nonfinite:
        return f"{where}: {values}; {_pixels(worst.nonfinite)} NaN or Inf on one side only"
    error = _short(worst.max_error or 0.0)
    return f"{where}: {values}, error {error}; {_pixels(worst.failing)} over {_short(worst.threshold)}"


def value_text(found: ChannelDiff, value: float | int | None) -> str:
    """A channel's value in its shortest form that reads back as the same float32 or uint32."""
    return str(value) if found.kind == "uint" or value is None else str(np.float32(value))


def _short(value: float) -> str:
    """Whole numbers without a point; others in their shortest form, after rounded_up at most six digits."""
    if math.isfinite(value) and value == int(value) and abs(value) < 1e6:
        return str(int(value))
    return repr(rounded_up(value))


def _pixels(count: int) -> str:
    return f"{count} pixel{'s' * (count != 1)}"


def _and_more(sentences: Sequence[str]) -> str:
    return f" (and {len(sentences) - 1} more)" if len(sentences) > 1 else ""


def _plain(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, dict):
        return {key: _plain(member) for key, member in value.items()}
    return [_plain(member) for member in value] if isinstance(value, (list, tuple)) else value
