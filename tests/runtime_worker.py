"""Runs `clrast render` several times in one process, whose environment decides what a process decides once.

stdin: a JSON list of {"arguments": [...], "output": FILE, "stats": FILE, "in_bands": bool}
stdout: a JSON list of {"code", "error", "sha256", "bands", "device"}, one for each
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import re
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from clrast.__main__ import main  # noqa: E402


def run(arguments: list[str]) -> tuple[int, str]:
    """Exit code and stderr of one command."""
    stderr = io.StringIO()
    with contextlib.redirect_stderr(stderr):
        code = main(arguments)
    return code, stderr.getvalue()


def least_memory(arguments: list[str]) -> str:
    """The number of bytes that the command itself names as enough."""
    code, error = run([*arguments, "--memory", "1"])
    found = re.search(r"at least (\d+)", error)
    assert code == 75 and found, error
    return found[1]


def result(task: dict[str, Any]) -> dict[str, Any]:
    arguments = ["render", *task["arguments"], "-q", "-o", task["output"], "--stats", task["stats"]]
    if task["in_bands"]:
        arguments += ["--memory", least_memory(arguments)]
    code, error = run(arguments)
    if code:
        return {"code": code, "error": error, "sha256": "", "bands": 0, "device": ""}
    stats = json.loads(Path(task["stats"]).read_text())
    sha256 = hashlib.sha256(Path(task["output"]).read_bytes()).hexdigest()
    device = f"{stats['device']['platform']} {stats['device']['name']}"
    return {"code": 0, "error": error, "sha256": sha256, "bands": stats["other_counts"]["bands"], "device": device}


if __name__ == "__main__":
    print(json.dumps([result(task) for task in json.load(sys.stdin)]))
