"""Fixtures and options of all tests: `device` over every OpenCL runtime that is installed and working.

The loader reads its settings once per process, so they are made here, before anything asks for OpenCL.
"""

from __future__ import annotations

import dataclasses
import os
import shutil
import sys
import tempfile
from pathlib import Path

import pytest

OCLGRIND_LIBRARIES = (
    Path("/usr/lib/oclgrind/liboclgrind-rt-icd.so"),
    Path("/usr/lib/x86_64-linux-gnu/oclgrind/liboclgrind-rt-icd.so"),
    Path("/usr/local/lib/liboclgrind-rt-icd.so"),
)
SESSION_FOLDER = Path(tempfile.mkdtemp(prefix="clrast-tests-"))
OCLGRIND_LOG = SESSION_FOLDER / "oclgrind.log"


def _prepare_loader() -> None:
    """One folder of .icd files: the machine's, and Oclgrind's, which no package registers."""
    given = os.environ.get("OCL_ICD_VENDORS")
    vendors = SESSION_FOLDER / "vendors"
    vendors.mkdir()
    source = Path(given or "/etc/OpenCL/vendors")
    for file in sorted(source.glob("*.icd")) if source.is_dir() else [source] if source.suffix == ".icd" else []:
        shutil.copy(file, vendors / file.name)
    library = next((path for path in OCLGRIND_LIBRARIES if path.exists()), None)
    if library and not given:
        (vendors / "zz-oclgrind.icd").write_text(f"{library}\n")
    os.environ["OCL_ICD_VENDORS"] = str(vendors)
    os.environ["OCLGRIND_LOG"] = str(OCLGRIND_LOG)
    os.environ["OCLGRIND_DATA_RACES"] = "1"


assert "pyopencl" not in sys.modules, "pyopencl was loaded before conftest.py could set up its loader"
_prepare_loader()
os.environ.setdefault("CLRAST_KEEP_BINARIES", "off")  # each takes as long as the program took to compile

from clrast.opencl import device as devices  # noqa: E402

EXPECTED_RUNTIMES = ("pocl", "rusticl", "oclgrind")


class Runtimes:
    """The runtimes of this machine: `working` maps our name to an index for open_device, `reasons` the rest."""

    def __init__(self) -> None:
        self.working: dict[str, str] = {}
        self.reasons: dict[str, str] = {name: "not installed" for name in EXPECTED_RUNTIMES}
        for listed in devices.list_devices():
            result = devices.self_test(listed.handle)
            if result.ok and listed.runtime not in self.working:
                self.working[listed.runtime] = listed.index
                self.reasons.pop(listed.runtime, None)
            elif listed.runtime not in self.working:
                self.reasons[listed.runtime] = f"fails the self-test: {result.reason}"


_runtimes: list[Runtimes] = []


def runtimes() -> Runtimes:
    if not _runtimes:
        _runtimes.append(Runtimes())
    return _runtimes[0]


def first_runtime() -> str:
    """Where one is enough, or others are compared with it."""
    return next(iter(runtimes().working))


def open_first_device() -> devices.Device:
    return devices.open_device(runtimes().working[first_runtime()])


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--long", action="store_true", help="run the tests that take long, too")
    parser.addoption("--update-golden", action="store_true", help="write golden images instead of comparing")


def pytest_report_header() -> list[str]:
    lines = [f"OpenCL runtimes under test: {', '.join(runtimes().working) or 'none'}"]
    lines += [f"OpenCL runtime {name} is not tested: {reason}" for name, reason in runtimes().reasons.items()]
    return lines


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """`device` runs on every working runtime; Oclgrind, an interpreter, takes only tests marked `small`."""
    if "device" not in metafunc.fixturenames:
        return
    small = metafunc.definition.get_closest_marker("small") is not None
    names = [name for name in runtimes().working if small or name != "oclgrind"]
    metafunc.parametrize("device", names, indirect=True, scope="session")


@pytest.fixture(scope="session")
def device(request: pytest.FixtureRequest) -> devices.Device:
    """An opened device; `device.runtime` is a selector that finds it again."""
    return devices.open_device(runtimes().working[request.param])


@pytest.fixture(scope="session")
def first_device() -> devices.Device:
    """The first runtime that works here, with vectors of one lane, which build fastest: for tests of many programs."""
    names = [name for name in runtimes().working if name != "oclgrind"]
    if not names:
        pytest.skip("no OpenCL runtime works here")
    return dataclasses.replace(devices.open_device(runtimes().working[names[0]]), programs={}, vector_width=1)


@pytest.fixture(autouse=True)
def _no_oclgrind_findings(request: pytest.FixtureRequest):
    """A test fails on an access out of bounds or a data race that Oclgrind found while it ran."""
    if "device" not in request.fixturenames or request.getfixturevalue("device").runtime != "oclgrind":
        yield
        return
    before = OCLGRIND_LOG.stat().st_size if OCLGRIND_LOG.exists() else 0
    yield
    found = OCLGRIND_LOG.read_text(errors="replace")[before:] if OCLGRIND_LOG.exists() else ""
    if found.strip():
        pytest.fail(f"Oclgrind found:\n{found[:4000]}")


@pytest.fixture
def update_golden(request: pytest.FixtureRequest) -> bool:
    return bool(request.config.getoption("--update-golden"))


_deselected: list[str] = []


LONGEST_FILES = ("test_continuum.py", "test_runtimes.py", "test_scenes_render.py", "test_projections.py")
"""First of all: a worker takes a file whole, and one that begins the longest last leaves the others idle."""


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: item.path.name not in LONGEST_FILES)
    if config.getoption("--long"):
        return
    long = [item for item in items if item.get_closest_marker("long")]
    if long:
        _deselected.extend(item.nodeid for item in long)
        config.hook.pytest_deselected(items=long)
        items[:] = [item for item in items if not item.get_closest_marker("long")]


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    if _deselected:
        terminalreporter.write_line(f"{len(_deselected)} tests were not run because they take long: give --long")


def pytest_unconfigure() -> None:
    shutil.rmtree(SESSION_FOLDER, ignore_errors=True)
