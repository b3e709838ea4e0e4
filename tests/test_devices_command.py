"""`clrast devices`: the table, the choice and its reason, JSON, exit code 69."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import runtimes

from clrast.commands import devices as command
from clrast.opencl import device as devices
from clrast.opencl import self_test as tests
from clrast.opencl.self_test import SelfTestResult

ROOT = Path(__file__).resolve().parents[1]


def clrast_devices(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "clrast", "devices", *arguments],
        env={**os.environ, "PYTHONPATH": str(ROOT), **environment},
        capture_output=True,
        text=True,
        timeout=300,
    )


def test_json_lists_each_device_and_the_choice_of_open_device() -> None:
    done = clrast_devices("--json")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert {d["runtime"] for d in report["devices"] if d["works"]} == set(runtimes().working)
    chosen = next(d for d in report["devices"] if d["index"] == report["chosen"])
    assert chosen["runtime"] == devices.open_device().runtime
    assert "in the order pocl, intel" in report["why"]


def test_the_table_names_each_device_and_what_render_takes() -> None:
    done = clrast_devices()
    assert done.returncode == 0, done.stderr
    opened = devices.open_device()
    assert f"{opened.name}: the first that passes the self-test" in done.stdout.splitlines()[-1]
    for index in runtimes().working.values():
        assert any(line.split()[:1] == [index] for line in done.stdout.splitlines())


def test_without_a_device_the_exit_code_is_69_and_one_line_says_the_mend(tmp_path: Path) -> None:
    done = clrast_devices(OCL_ICD_VENDORS=str(tmp_path))
    assert done.returncode == 69
    assert done.stdout == ""
    assert done.stderr.startswith("clrast: error: there is no OpenCL device: ")
    assert "apt-get install pocl-opencl-icd" in done.stderr
    assert done.stderr.count("\n") == 1


def test_devices_that_fail_are_shown_and_passed_over(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Every device but the least preferred is made to fail, then that one too."""
    last = devices.preferred(devices.list_devices())[-1]
    real = tests.self_test

    def fails(handle, index=None):  # noqa: ANN001, ANN202
        return real(handle, index) if index == last.index else SelfTestResult(False, "its compiler is too old")

    monkeypatch.setattr(command, "self_test", fails)
    assert command.run() == 0
    out = capsys.readouterr().out
    assert f"render takes {last.index} " in out
    assert out.count("failed: its compiler is too old") == len(devices.list_devices()) - 1

    monkeypatch.setattr(command, "self_test", lambda handle, index=None: SelfTestResult(False, "broken"))
    assert command.run(json_output=True) == 69
    captured = capsys.readouterr()
    assert json.loads(captured.out)["chosen"] is None
    assert "no OpenCL device passes the self-test" in captured.err
