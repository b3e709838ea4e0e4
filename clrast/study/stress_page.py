"""A whole run of the hard cases as one HTML page that asks for no other file and no network."""

from __future__ import annotations

import base64
import html
import os
import tempfile

import numpy as np

from clrast.image.png import write_pixels
from clrast.study.stress import PROMISES, Finding, Stress
from clrast.study.stress_pictures import COLORS, id_picture, reproducing_card, wrong_findings, wrong_map
from clrast.study.wrong_samples import KINDS

STYLE = (
    "body{font:15px sans-serif;margin:2em;max-width:80em}table{border-collapse:collapse}"
    "td,th{padding:.15em .7em;border-bottom:1px solid #ccc;text-align:right}"
    "td:first-child,th:first-child,.text{text-align:left}.broken{background:#fcc}"
    "img{width:256px;image-rendering:pixelated;margin-right:8px}pre{max-height:20em;overflow:auto}"
)


def page(stress: Stress) -> str:
    """The page: the promises, a table of every image by kind, and what is wrong in pictures."""
    lines = [
        "<!doctype html>", '<html lang="en"><head><meta charset="utf-8"><title>clrast stress</title>',
        f"<style>{STYLE}</style></head><body>", "<h1>clrast stress</h1>",
        f"<p>{len(stress.cases) + len(stress.refused)} hard cases on {html.escape(stress.device)}, against exact "
        f"arithmetic: {'a promise is broken' if stress.is_broken else 'every promise holds'}.</p>", "<ul>",
    ]  # fmt: skip
    for precision in stress.plan.precisions:
        if precision in PROMISES:
            wrong, samples = stress.total(precision)
            lines.append(f"<li>{precision}: {wrong} of {samples} samples are {', '.join(PROMISES[precision])}</li>")
    lines += [f"<li>{html.escape(note)}</li>" for note in stress.notes]
    lines += ["</ul>", *_table(stress), *_refusals(stress), "<h2>Wrong samples</h2>", _legend()]
    for finding in wrong_findings(stress):
        lines += _pictures(finding, stress)
    return "\n".join([*lines, "</body></html>", ""])


def _table(stress: Stress) -> list[str]:
    heads = ("case", "view", "rung", "methods", "samples", "wrong", *KINDS)
    lines = ["<table>", "<tr>" + "".join(f"<th>{head}</th>" for head in heads) + "</tr>"]
    for each in stress.findings:
        texts = (each.case, each.view.name, each.precision, " ".join(each.methods))
        numbers = (each.sample_count, each.wrong_count, *each.counts.values())
        cells = "".join(f'<td class="text">{html.escape(text)}</td>' for text in texts)
        cells += "".join(f"<td>{number or '-'}</td>" for number in numbers)
        lines.append(f'<tr{" class=broken" if each.broken else ""}>{cells}</tr>')
    return [*lines, "</table>"]


def _refusals(stress: Stress) -> list[str]:
    if not stress.refused:
        return []
    lines = ["<h2>Input that must be refused</h2>", "<ul>"]
    for one in stress.refused:
        answer = "taken" if one.exit_code is None else f"exit code {one.exit_code}"
        lines.append(f'<li{"" if one.is_right else " class=broken"}>{html.escape(one.name)}: {answer}</li>')
    return [*lines, "</ul>"]


def _legend() -> str:
    parts = (f'<span style="background:rgb{color};padding:0 .8em"></span> {kind}' for kind, color in COLORS.items())
    return f"<p>{' &nbsp; '.join(parts)}</p>"


def _pictures(finding: Finding, stress: Stress) -> list[str]:
    case = next(each for each in stress.cases if each.name == finding.case)
    what = ", ".join(f"{count} {kind}" for kind, count in finding.counts.items() if count)
    where = ", ".join((finding.case, finding.view.name, finding.precision, " ".join(finding.methods)))
    return [
        f"<h3{' class=broken' if finding.broken else ''}>{html.escape(where)}</h3>",
        f"<p>{html.escape(case.hard)} {html.escape(what)}.</p>",
        f"<p>{_image(id_picture(finding), 'triangles')}{_image(wrong_map(finding), 'wrong samples')}</p>",
        f"<details><summary>card</summary><pre>{html.escape(reproducing_card(finding, stress))}</pre></details>",
    ]


def _image(pixels: np.ndarray, name: str) -> str:
    """The picture inside the page, as PNG."""
    with tempfile.TemporaryDirectory(prefix="clrast-stress-") as folder:
        path = os.path.join(folder, "x.png")
        write_pixels(path, pixels)
        with open(path, "rb") as file:
            content = base64.b64encode(file.read()).decode("ascii")
    return f'<img alt="{name}" src="data:image/png;base64,{content}">'
