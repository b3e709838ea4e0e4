"""tools/check_rays.py as a program: what it counts, and that it can fail."""

from __future__ import annotations

from pathlib import Path

import pytest

from clrast.errors import EXIT_NO_DEVICE
from clrast.opencl.device import Device
from clrast.visibility.loop_limits import loop_limit


@pytest.fixture
def tool(monkeypatch: pytest.MonkeyPatch):
    """The tool as a module."""
    monkeypatch.syspath_prepend(str(Path(__file__).resolve().parents[1] / "tools"))
    import check_rays

    return check_rays


def short(device: Device) -> list[str]:
    return ["--rays", "300", "--shapes", "3", "--exact", "12", "--device", device.runtime]


def test_nothing_is_wrong_or_rays_are_refused(device: Device, tool, capsys: pytest.CaptureFixture) -> None:
    code = tool.main(short(device))
    out, err = capsys.readouterr()
    if loop_limit(device) is not None:
        assert code == EXIT_NO_DEVICE and "ends long loops early" in err
        return
    assert code == 0
    assert all(" 0 wrong" in line for line in out.splitlines() if " tried " in line)
    for count in ("leaks", "double", "through", "bounces", "left", "exact", "hierarchy", "grid", "any hit"):
        assert count in out


def test_a_hole_is_counted(
    device: Device, tool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    if loop_limit(device) is not None:
        pytest.skip(f"{device.runtime} limits loops: rays are refused there, which another test holds")
    whole = tool.make_tracer
    monkeypatch.setattr(tool, "make_tracer", lambda device, p, t, **given: whole(device, p, t[:-1]))
    assert tool.main(short(device)) == 1
    assert " wrong" in capsys.readouterr().out.splitlines()[-1]


@pytest.mark.long
def test_the_long_run(device: Device, tool, capsys: pytest.CaptureFixture) -> None:
    if loop_limit(device) is not None:
        pytest.skip(f"{device.runtime} limits loops: rays are refused there, which another test holds")
    assert tool.main(["--device", device.runtime]) == 0, capsys.readouterr().out
