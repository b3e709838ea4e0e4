"""Broken files from a seed: whatever a reader meets, it loads, or says one line, soon, and in little memory."""

from __future__ import annotations

import random
import shutil
import time
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from mesh_writer import MIXED_FACES, SQUARE, ascii_ply, ascii_stl, binary_ply, binary_stl, mutate

from clrast.errors import ClrastError
from clrast.scene.load import load
from clrast.scene.model import Scene

DATA = Path(__file__).resolve().parents[1] / "data"
FACETS = [[(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(1, 0, 0), (1, 1, 0), (0, 1, 0)]]
OBJ = b"""mtllib a.mtl
v 0 0 0
v 1 0 0 0.5 1 0
v\t1 1 0
v 0 1 0
vt 0 0
vt 1 1
vn 0 0 1
o first
usemtl m
f 1/1/1 2/2/1 \\
 3/1/1
g second
f -1//1 -2//-1 -3//1 -4
s 1
l 1 2
f 1/1 2/2 3/1
"""
MTL = b"newmtl m\nKd 1 .5 0\nmap_Kd -s 2 2 -o 0 1 textures/checker.png\nd 0.5\nNs 10\nKs 1 1 1\nillum 5\nKe 1 1 1\n"
COLORED = "property uchar red\nproperty uchar green\nproperty uchar blue"
SEEDS = {
    "ply": [
        ascii_ply(SQUARE, MIXED_FACES),
        binary_ply(SQUARE, MIXED_FACES),
        binary_ply(SQUARE, [(0, 1, 2), (0, 2, 3)], ">"),
        ascii_ply([(*v, 1, 2, 3) for v in SQUARE], MIXED_FACES, COLORED),
    ],
    "stl": [binary_stl(FACETS), ascii_stl(FACETS).encode(), (ascii_stl(FACETS, "a") + ascii_stl(FACETS)).encode()],
    "off": [
        b"OFF\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2 255 0 0\n4 0 1 2 3\n",
        b"CNOFF 3 1 0 # c\n0 0 0 0 0 1 255 0 0 255\n1 0 0 0 0 1 255 0 0 255\n1 1 0 0 0 1 0 0 0 255\n3 0 1 2\n",
    ],
    "obj": [OBJ],
    "toml": [path.read_bytes() for path in sorted(DATA.glob("*.toml"))],
}
CASES = {"ply": 400, "stl": 300, "off": 300, "obj": 500, "toml": 150}
MAX_SECONDS = 2.0  # of processor time; the slowest, the room's card, takes 0.2
MAX_BYTES = 100e6  # the largest file here has 5 kB, its meshes and textures 0.3 MB


def check(scene: Scene) -> None:
    used = scene.positions[scene.triangles.reshape(-1)]
    assert scene.triangle_count > 0 and np.isfinite(used).all() and used.dtype == np.float32
    assert scene.material_ids.max() < len(scene.materials) and scene.object_ids.max() < len(scene.object_names)
    for attribute in (scene.normals, scene.uv, scene.uv1, scene.colors):
        assert attribute is None or len(attribute) == scene.vertex_count and np.isfinite(attribute).all()


@pytest.mark.parametrize("kind", SEEDS)
def test_broken_files_load_or_say_one_line(tmp_path, kind, capfd, caplog):
    shutil.copytree(DATA / "meshes", tmp_path / "meshes")
    shutil.copytree(DATA / "textures", tmp_path / "textures")
    (tmp_path / "a.mtl").write_bytes(MTL)
    random_ = random.Random(f"clrast {kind}")
    path = tmp_path / f"case.{kind}"
    refused = 0
    for _ in range(CASES[kind]):
        content = mutate(random_, random_.choice(SEEDS[kind]))
        path.write_bytes(content)
        start = time.process_time()
        try:
            check(load(path))
        except ClrastError as error:
            refused += 1
            message = str(error)
            assert message.isprintable() and message.startswith(f"{path}: ") and len(message) < 700, content
        except Exception as error:
            raise AssertionError(f"{error!r} from {content!r}") from error
        assert time.process_time() - start < MAX_SECONDS, content
    assert 0 < refused < CASES[kind]  # neither all broken nor all sound
    assert capfd.readouterr() == ("", "") and caplog.records == []  # a library's log would end up on stderr


@pytest.mark.parametrize("kind", SEEDS)
def test_broken_files_take_little_memory(tmp_path, kind):
    shutil.copytree(DATA / "meshes", tmp_path / "meshes")
    shutil.copytree(DATA / "textures", tmp_path / "textures")
    random_ = random.Random(f"memory {kind}")
    path = tmp_path / f"case.{kind}"
    for seed in SEEDS[kind][:1]:
        path.write_bytes(seed)
        load(path)  # so that imports do not count
    tracemalloc.start()
    try:
        for _ in range(30):
            content = mutate(random_, random_.choice(SEEDS[kind]))
            path.write_bytes(content)
            tracemalloc.reset_peak()
            try:
                load(path)
            except ClrastError:
                pass
            assert tracemalloc.get_traced_memory()[1] < MAX_BYTES, content
    finally:
        tracemalloc.stop()
