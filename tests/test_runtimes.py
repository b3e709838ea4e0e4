"""The same render is the same file, byte for byte: on every OpenCL runtime of this machine, for one and two
threads, vector widths 1, 8 and 16, whole and in bands, with cold and warm caches, from any folder, repeated or
not, and beside another render. A table of hashes holds it from machine to machine.

A process chooses its runtime's threads and widths once, so each setting has a process of its own (runtime_worker.py).
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from conftest import OCLGRIND_LIBRARIES, runtimes
from small_renders import ROOT, SmallRender, large_renders, small_renders

import clrast
from clrast.__main__ import main
from clrast.opencl.runtimes import THREAD_VARIABLES

WORKER = Path(__file__).with_name("runtime_worker.py")
HASHES = ROOT / "data" / "golden" / "hashes.json"
WIDTHS = (1, 8, 16)
SECONDS = 1200
"""Longest life of a worker: llvmpipe builds the widest kernels for minutes."""

NAMES = ("room", "plan", "layers", "lamps")
LARGE_NAMES = ("bunny", "sponza")
NAMES_OF_SETTINGS = {
    ("pocl", 1): ("room",), ("pocl", 8): ("room",), ("intel", 1): ("room",), ("intel", 8): ("room",),
    ("rusticl", 8): ("lamps",), ("rusticl", 16): (),
}  # fmt: skip
"""What is rendered where not all of NAMES; the rest runs with --long. Mesa 22.3 builds wide kernels in 5 to 20 s
without MASK, with it in 20 to 100 s."""
KEPT_BINARIES = {1: "off", 8: "off", 16: "on"}
"""Each takes as long as its program took to compile: for one width they are made."""

RUNTIMES = [name for name in runtimes().working if name != "oclgrind"]
OCLGRIND_OPTIONS = "-fno-inline -Drestrict="
"""Oclgrind 21.10 lacks `llvm.experimental.noalias.scope.decl`, which inlining leaves where pointers do not alias."""


@pytest.fixture(scope="module")
def renders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, SmallRender]:
    return {**small_renders(tmp_path_factory.mktemp("cards")), **large_renders()}


@dataclass
class References:
    """Images of this process on the default device, each rendered when first asked for."""

    renders: dict[str, SmallRender]
    folder: Path

    def image(self, name: str) -> Path:
        path, one = self.folder / f"{name}.exr", self.renders[name]
        if not path.exists():
            assert main(["render", str(one.source), *one.view, "-o", str(path), "-q"]) == 0
        return path


@pytest.fixture(scope="module")
def references(renders: dict[str, SmallRender], tmp_path_factory: pytest.TempPathFactory) -> References:
    if not RUNTIMES:
        pytest.skip("no OpenCL runtime works here")
    return References(renders, tmp_path_factory.mktemp("references"))


@dataclass
class Worker:
    """A running process and what it was told to do; `name` of each task is its image's."""

    process: subprocess.Popen[str]
    tasks: list[dict[str, Any]]

    def results(self) -> list[dict[str, Any]]:
        out, err = self.process.communicate(timeout=SECONDS)
        assert (self.process.returncode, err) == (0, ""), f"{out}\n{err}"
        return json.loads(out)

    def check(self, references: References) -> None:
        """Every image as the reference has it; those in bands in more than one."""
        for task, result in zip(self.tasks, self.results(), strict=True):
            what = f"{task['arguments']} on {result['device']}"
            assert (result["code"], result["error"]) == (0, ""), what
            assert result["bands"] > 1 or not task["in_bands"], what
            reference = references.image(task["name"])
            if result["sha256"] != sha256(reference):
                found = clrast.diff(reference, task["output"], header=True)
                pytest.fail(f"{what}: other bytes than on the default device: {found.verdict}")


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def start(
    folder: Path,
    kinds: Sequence[tuple[SmallRender, str]],
    options: Sequence[str],
    cwd: Path = ROOT,
    **environment: str,
) -> Worker:
    """A process that renders each image in its way: "whole", in "bands", or "repeat" for the third of three frames."""
    folder.mkdir(parents=True, exist_ok=True)
    tasks = []
    for one, way in kinds:
        near = cwd == ROOT and one.source.is_relative_to(ROOT)
        source = one.source.relative_to(ROOT) if near else one.source
        more = ("--repeat", "2") if way == "repeat" else ()
        stem = str(folder / f"{one.name}-{way}")
        arguments = [str(source), *one.view, *options, *more]
        tasks.append({
            "name": one.name, "arguments": arguments, "in_bands": way == "bands",
            "output": f"{stem}.exr", "stats": f"{stem}.json",
        })  # fmt: skip
    inherited = {name: value for name, value in os.environ.items() if name not in THREAD_VARIABLES}
    process = subprocess.Popen(
        [sys.executable, str(WORKER)], cwd=cwd, env={**inherited, **environment}, text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    assert process.stdin is not None
    process.stdin.write(json.dumps(tasks))
    process.stdin.close()
    process.stdin = None
    return Worker(process, tasks)


def check_settings(
    runtime: str, width: int, wanted: Sequence[SmallRender], references: References, folder: Path
) -> None:
    """One thread and a cold cache from the project's folder; then two, a warm one, and a folder far away."""
    cache, far = folder / "cache", folder / "far away"
    far.mkdir()
    keeps = KEPT_BINARIES[width]
    settings = {"CLRAST_VECTOR_WIDTH": str(width), "CLRAST_CACHE_DIR": str(cache), "CLRAST_KEEP_BINARIES": keeps}
    kinds = [(one, way) for one in wanted for way in ("whole", "bands")] + [(wanted[-1], "repeat")]
    # `auto` may build more in one run than in another: times decide there what it tries.
    method = ("--method", "3dr-binning")
    start(folder / "cold", kinds, ("--device", runtime, "-t", "1", *method), **settings).check(references)
    binaries = sorted(cache.glob("*.bin"))
    assert bool(binaries) or keeps == "off" or runtime not in ("pocl", "intel")
    start(folder / "warm", kinds, ("--threads", "2", "--device", runtime, *method), far, **settings).check(references)
    assert sorted(cache.glob("*.bin")) == binaries and not list(far.iterdir())


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("runtime", RUNTIMES)
def test_every_setting(runtime: str, width: int, references: References, tmp_path: Path) -> None:
    names = NAMES_OF_SETTINGS.get((runtime, width), NAMES)
    if not names:
        pytest.skip(f"{runtime} builds kernels of width {width} for minutes: give --long")
    check_settings(runtime, width, [references.renders[name] for name in names], references, tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("runtime", RUNTIMES)
def test_every_setting_on_every_scene(runtime: str, width: int, references: References, tmp_path: Path) -> None:
    check_settings(runtime, width, list(references.renders.values()), references, tmp_path)


@pytest.mark.parametrize("runtime", RUNTIMES)
def test_two_at_once_with_cold_caches(runtime: str, references: References, tmp_path: Path) -> None:
    """Neither reads what the other has half written; and no file of the cache is left in the making."""
    caches = {"CLRAST_CACHE_DIR": "clrast", "POCL_CACHE_DIR": "pocl", "MESA_SHADER_CACHE_DIR": "mesa"}
    environment = {name: str(tmp_path / folder) for name, folder in caches.items()}
    for folder in environment.values():
        Path(folder).mkdir()
    environment["CLRAST_KEEP_BINARIES"] = "on"
    kinds = [(references.renders["lamps"], "whole")]
    options = ("--device", runtime)
    workers = [start(tmp_path / str(k), kinds, options, CLRAST_VECTOR_WIDTH="1", **environment) for k in range(2)]
    for worker in workers:
        worker.check(references)
    assert {path.suffix for path in (tmp_path / "clrast").iterdir()} <= {".bin", ".survived"}


@pytest.mark.parametrize("name", [*NAMES, *LARGE_NAMES])
def test_hashes_of_the_table(name: str, references: References, update_golden: bool) -> None:
    """The bytes are those that were stored, perhaps on another machine; --update-golden stores them anew."""
    if name not in references.renders:
        pytest.skip("the shared scenes are not here")
    found = sha256(references.image(name))
    table = json.loads(HASHES.read_text()) if HASHES.exists() else {}
    if update_golden:
        HASHES.parent.mkdir(exist_ok=True)
        HASHES.write_text(json.dumps({**table, name: found}, indent=2, sort_keys=True) + "\n")
        return
    assert table.get(name) == found, f"{references.image(name)} has other bytes than {HASHES.name} says"


# Oclgrind


@pytest.fixture
def oclgrind(tmp_path: Path) -> dict[str, str]:
    """Environment for a process that has Oclgrind alone; what it finds goes to tmp_path/oclgrind.log."""
    library = next((path for path in OCLGRIND_LIBRARIES if path.exists()), None)
    if library is None:
        pytest.skip("Oclgrind is not installed")
    vendors = tmp_path / "vendors"
    vendors.mkdir()
    (vendors / "oclgrind.icd").write_text(f"{library}\n")
    return {
        "OCL_ICD_VENDORS": str(vendors), "OCLGRIND_LOG": str(tmp_path / "oclgrind.log"), "OCLGRIND_DATA_RACES": "1",
        "OCLGRIND_BUILD_OPTIONS": OCLGRIND_OPTIONS,
    }  # fmt: skip


FAULTY = """
import numpy as np, pyopencl as cl
context = cl.create_some_context(interactive=False)
queue = cl.CommandQueue(context)
program = cl.Program(context, "kernel void f(global int *a) { a[get_global_id(0)] = 1; a[0] = get_global_id(0); }")
buffer = cl.Buffer(context, cl.mem_flags.READ_WRITE, 12)
program.build().f(queue, (4,), None, buffer)
queue.finish()
"""


def test_oclgrind_reports(oclgrind: dict[str, str], tmp_path: Path) -> None:
    """That its log speaks when a kernel writes out of bounds and two work-items race; else the next test is void."""
    words = [sys.executable, "-W", "ignore", "-c", FAULTY]
    subprocess.run(words, env={**os.environ, **oclgrind}, check=True, timeout=120, capture_output=True)
    log = (tmp_path / "oclgrind.log").read_text()
    assert "Invalid write of size 4" in log and "data race" in log


@pytest.mark.parametrize("name", ["room", "layers", "lamps", "crossing"])
def test_oclgrind_finds_nothing(
    name: str, renders: dict[str, SmallRender], oclgrind: dict[str, str], tmp_path: Path
) -> None:
    """An image of 16 x 16: no access out of bounds, no data race, and the bytes of the default device.

    Vectors of width 1 only: Oclgrind 21.10 makes 1 of -1 where LLVM turns `a | b` of wide comparisons into a select.
    """
    source = ROOT / "data" / "crossing.toml" if name == "crossing" else renders[name].source
    view = ("--size", "16x16", "--aov", "all", "-q")
    small = tmp_path / "here.exr"
    assert main(["render", str(source), *view, "-o", str(small)]) == 0
    environment = {**os.environ, **oclgrind, "CLRAST_VECTOR_WIDTH": "1", "CLRAST_CACHE_DIR": "off"}
    image = tmp_path / "oclgrind.exr"
    words = [sys.executable, "-m", "clrast", "render", str(source), *view, "-o", str(image)]
    done = subprocess.run(words, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=SECONDS)
    log = tmp_path / "oclgrind.log"
    assert not log.exists() or not log.read_text().strip(), log.read_text()[:4000]
    assert (done.returncode, done.stderr) == (0, "")
    assert sha256(image) == sha256(small), clrast.diff(small, image, header=True).verdict
