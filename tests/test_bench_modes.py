"""tools/bench_modes.py as a program: both ways to sample, Mitsuba where it is, and what is said where it is not."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import pytest

from clrast.opencl.device import Device


@pytest.fixture
def tool(monkeypatch: pytest.MonkeyPatch):
    """The tool as a module."""
    monkeypatch.syspath_prepend(str(Path(__file__).resolve().parents[1] / "tools"))
    import bench_modes

    return bench_modes


def short(device: Device, *more: str) -> list[str]:
    return ["--size", "24", "--samples", "4", "--repetitions", "1", "--bounces", "1", "--device", device.runtime, *more]


def means(text: str, name: str) -> list[float]:
    """Per cent by which the mean of R, G, B differs from that of `ssaa`."""
    (line,) = re.findall(rf"^  {name} +[0-9].*mean (.*) %$", text, re.MULTILINE)
    return [float(each) for each in line.split()]


@pytest.mark.long
def test_without_a_peer(
    first_device: Device, tool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.setattr(tool.importlib.util, "find_spec", lambda name: None)
    assert tool.main(short(first_device)) == 0
    out = capsys.readouterr().out
    assert out.splitlines()[0] == tool.MISSING
    assert means(out, "ssaa") == [0.0, 0.0, 0.0] and len(means(out, "paths")) == 3
    assert "rgb" not in out and "indirect light" in out


@pytest.mark.long
def test_a_peer_that_does_not_start_is_left_out(
    first_device: Device, tool, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    (tmp_path / "mitsuba.py").write_text("raise ImportError('half a Mitsuba')\n")
    assert tool.main(short(first_device, "--peers", "scalar_rgb", "--peer-path", str(tmp_path))) == 0
    assert "scalar_rgb is left out: ImportError: half a Mitsuba" in capsys.readouterr().out


@pytest.mark.long
def test_the_peer_renders_the_same_room(first_device: Device, tool, capsys: pytest.CaptureFixture) -> None:
    if importlib.util.find_spec("mitsuba") is None:
        pytest.skip("Mitsuba 3 is not installed: pip install 'clrast[peers]'")
    assert tool.main(short(first_device, "--size", "64", "--samples", "64")) == 0
    out = capsys.readouterr().out
    # Its surfaces are others, by some 4 to 9 per cent at 512x512; a room without its lamp or a bounce is off by more.
    assert all(abs(each) < 15 for variant in tool.names(tool.PEERS) for each in means(out, variant))
