"""What `pip install` brings: the package list, and a wheel that works away from the checkout."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))


def test_the_package_list_names_every_package_folder() -> None:
    folders = {".".join(p.parent.relative_to(ROOT).parts) for p in (ROOT / "clrast").rglob("__init__.py")}
    assert set(PROJECT["tool"]["setuptools"]["packages"]) == folders | {"clrast.cl", "clrast.data"}


def test_openimageio_is_pinned_exactly() -> None:
    """Its codec makes the bytes of the images, which are promised to be the same everywhere."""
    found = [d for d in PROJECT["project"]["dependencies"] if d.lower().startswith("openimageio")]
    assert len(found) == 1
    assert re.fullmatch(r"OpenImageIO==\d+(\.\d+){3}", found[0])


def test_every_dependency_says_why() -> None:
    text = (ROOT / "pyproject.toml").read_text("utf-8")
    extras = [d for group in PROJECT["project"]["optional-dependencies"].values() for d in group]
    for dependency in (*PROJECT["project"]["dependencies"], *extras):
        line = next(line for line in text.splitlines() if f'"{dependency}"' in line)
        assert re.search(r"# \w.{3,}", line), f"{dependency}: no reason beside it"


def test_versions_agree() -> None:
    import clrast

    assert clrast.__version__ == PROJECT["project"]["version"]


@pytest.mark.parametrize("script", ["tools/run", ".ci/run"])
def test_scripts_are_executable_and_parse(script: str) -> None:
    path = ROOT / script
    assert os.access(path, os.X_OK)
    subprocess.run(["bash", "-n", str(path)], check=True)


@pytest.mark.long
def test_a_wheel_carries_kernels_and_data_and_runs_elsewhere(tmp_path: Path) -> None:
    """Built by pip, unpacked in an environment without the checkout; needs the network for setuptools."""
    source = tmp_path / "source"
    unwanted = shutil.ignore_patterns(".*", "__pycache__", "build", "out", "*.egg-info")
    shutil.copytree(ROOT, source, ignore=unwanted)  # pip builds in place, and would leave its folders
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--no-input"]
    subprocess.run([*pip, "wheel", "-q", "--no-deps", "-w", str(tmp_path), str(source)], check=True, cwd=tmp_path)
    (wheel,) = tmp_path.glob("clrast-*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    for folder in ("cl", "data"):
        files = [p for p in (ROOT / folder).rglob("*") if p.is_file() and "__pycache__" not in p.parts]
        assert files
        assert {f"clrast/{p.relative_to(ROOT)}" for p in files} <= names
    modules = {str(p.relative_to(ROOT)) for p in (ROOT / "clrast").rglob("*.py")}
    assert modules <= names
    assert not {n for n in names if n.split("/")[0] not in ("clrast", wheel.name.rsplit("-py3", 1)[0] + ".dist-info")}

    home = tmp_path / "with space"
    venv.create(home, with_pip=False)
    site = home / "lib" / f"python{sys.version_info.major}.{sys.version_info.minor}" / "site-packages"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    here = [p for p in sys.path if p.endswith("site-packages")]  # the dependencies, which are not under test
    (site / "dependencies.pth").write_text("\n".join(here) + "\n")
    code = (
        "from clrast.opencl import kernels; from clrast.opencl.device import open_device;"
        "device = open_device(); folder = kernels.kernel_folder(); print(folder);"
        "[kernels.build(device, path.name) for path in folder.glob('*.cl')]"
    )
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run(
        [str(home / "bin" / "python"), "-P", "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == str(site / "clrast" / "cl")


def test_a_ready_environment_starts_at_once_and_from_any_folder(tmp_path: Path) -> None:
    """`tools/run` against the interpreter that it starts, both at their best of three: under a second between."""
    if not (ROOT / ".venv" / "clrast-ready").exists():
        pytest.skip("tools/run has not set up .venv beside this checkout")
    direct = [str(ROOT / ".venv" / "bin" / "python"), "-P", "-m", "clrast", "--help"]
    through = [str(ROOT / "tools" / "run"), "--help"]
    seconds = {}
    for name, command in (("direct", direct), ("through", through)):
        times = []
        for _ in range(3):
            start = time.perf_counter()
            done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
            times.append(time.perf_counter() - start)
            assert "Usage" in done.stdout
        seconds[name] = min(times)
    assert seconds["through"] - seconds["direct"] < 1.0
