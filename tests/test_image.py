"""Frames as files: what an EXR holds, that its bytes never vary, and that it appears whole or not at all."""

from __future__ import annotations

import hashlib
import inspect
import math
import os
import struct
import subprocess
import sys
import tempfile
import textwrap
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from clrast.errors import InputNotFoundError, OutputError, SceneError, UsageError
from clrast.image.files import check_writable, write_whole
from clrast.image.frame import CHANNEL_GROUPS, Frame, channels_of, part_of
from clrast.options import AOV_GROUPS

HEADER = {"version": "9.9", "precision": "midpoint", "e": (0.5, -1.25, 3.0), "seed": 7, "fov": 0.1}
BYTES_OF_ALL_GROUPS = "a652128a14780b3c740244636b98c843a9ab79c420645870036f4f6d1d6869e2"
"""SHA-256 of make_frame() as a file, the same on every machine: OpenImageIO's version decides it."""


def make_frame(groups=AOV_GROUPS, height: int = 37, width: int = 53) -> Frame:
    """A frame made from integers alone, so that its values cannot depend on the machine."""
    channels = {}
    for group in groups:
        for name in CHANNEL_GROUPS[group]:
            salt = sum(name.encode()) * 2654435761
            bits = (np.arange(height * width, dtype=np.uint64) * 40503 + salt) % (1 << 20)
            plane = bits.astype(np.uint32).reshape(height, width)
            channels[name] = plane if group == "id" else plane.astype(np.float32) / np.float32(1 << 18)
    return Frame(channels, HEADER)


SUBPROCESS_START = f"""
import numpy as np
from clrast.image.frame import CHANNEL_GROUPS, Frame
from clrast.options import AOV_GROUPS
HEADER = {HEADER!r}
{inspect.getsource(make_frame)}
"""


def raw_headers(content: bytes) -> list[dict[str, tuple[str, bytes]]]:
    """The headers of an EXR file, one per part, read by the published layout and no library."""
    assert content[:4] == b"\x76\x2f\x31\x01"
    multipart = struct.unpack("<I", content[4:8])[0] & 0x1000
    place, headers = 8, []
    while True:
        attributes: dict[str, tuple[str, bytes]] = {}
        while content[place]:
            end = content.index(0, place)
            kind_end = content.index(0, end + 1)
            size = struct.unpack("<i", content[kind_end + 1 : kind_end + 5])[0]
            value = content[kind_end + 5 : kind_end + 5 + size]
            attributes[content[place:end].decode()] = (content[end + 1 : kind_end].decode(), value)
            place = kind_end + 5 + size
        headers.append(attributes)
        place += 1
        if not multipart or not content[place]:
            return headers


def in_subprocess(code: str, *arguments: str, cwd: Path | None = None, **env: str) -> subprocess.CompletedProcess[str]:
    root = Path(__file__).resolve().parents[1]
    text = SUBPROCESS_START + textwrap.dedent(code)
    environment = dict(os.environ, PYTHONPATH=str(root), **env)
    return subprocess.run(
        [sys.executable, "-c", text, *arguments], cwd=cwd, env=environment, capture_output=True, text=True, timeout=300
    )


def test_groups_are_those_of_the_options():
    assert tuple(CHANNEL_GROUPS) == AOV_GROUPS
    assert channels_of(("depth", "color")) == ("R", "G", "B", "A", "Z")
    assert [part_of(name) for name in ("Z", "Ng.X", "a.b.C", "W")] == ["beauty", "normal", "a.b", "other"]


def test_round_trip_of_all_groups_is_exact(tmp_path):
    frame = make_frame()
    special = frame.channels["P.X"].view(np.uint32)
    special[0, :8] = [0x7F800000, 0xFF800000, 0x7FC00000, 0x80000000, 1, 0x007FFFFF, 0x7F7FFFFF, 0xFFC12345]
    frame.channels["id.prim"][0, :3] = [4294967295, 70001, 16777217]
    frame.save(tmp_path / "all.exr")
    back = Frame.load(tmp_path / "all.exr")
    assert list(back) == list(frame)
    for name in frame:
        assert back[name].dtype == frame[name].dtype
        assert np.array_equal(back[name].view(np.uint32), frame[name].view(np.uint32)), name
    assert back.header == {**HEADER, "fov": "0.1"}  # 0.1 is no float32, so the file has its digits


def test_parts_of_the_file(tmp_path):
    path = str(tmp_path / "all.exr")
    make_frame().save(path)
    image = oiio.ImageInput.open(path)
    found = []
    while image.seek_subimage(len(found), 0):
        spec = image.spec()
        found.append((spec.get_string_attribute("name"), sorted(spec.channelnames), str(spec.format)))
    image.close()
    expected = [("beauty", sorted(["R", "G", "B", "A", "Z"]), "float")]
    for group in AOV_GROUPS[2:]:
        expected.append((group, sorted(CHANNEL_GROUPS[group]), "uint" if group == "id" else "float"))
    assert found == expected


def test_without_beauty_the_first_group_comes_first(tmp_path):
    make_frame(("id", "normal")).save(tmp_path / "n.exr")
    names = [attributes["name"][1] for attributes in raw_headers((tmp_path / "n.exr").read_bytes())]
    assert names == [b"normal", b"id"]


def test_a_part_holds_one_type(tmp_path):
    channels = {"x.A": np.full((2, 2), 0.5, np.float32), "x.B": np.full((2, 2), 70001, np.uint32)}
    Frame(channels).save(tmp_path / "x.exr")
    assert [part.name for part in Frame(channels).parts()] == ["x", "x_uint"]
    back = Frame.load(tmp_path / "x.exr")
    assert all(np.array_equal(back[name], channels[name]) for name in channels)


def test_header_has_what_decides_pixels_and_nothing_else(tmp_path):
    make_frame().save(tmp_path / "all.exr")
    headers = raw_headers((tmp_path / "all.exr").read_bytes())
    structure = {
        "channels", "chunkCount", "compression", "dataWindow", "displayWindow", "lineOrder", "name",
        "pixelAspectRatio", "screenWindowCenter", "screenWindowWidth", "type",
    }  # fmt: skip
    assert set(headers[0]) == structure | {f"clrast:{key}" for key in HEADER}
    assert all(set(later) == structure for later in headers[1:])
    assert headers[0]["clrast:e"] == ("v3f", struct.pack("<3f", 0.5, -1.25, 3.0))
    assert headers[0]["clrast:seed"] == ("int", struct.pack("<i", 7))
    assert headers[0]["clrast:fov"] == ("string", b"0.1")


@pytest.mark.parametrize(
    "value, back",
    [(2**40, str(2**40)), (-3, -3), ("ü \"x\"\ny", "ü \"x\"\ny"), ((1.0, 2.0), (1.0, 2.0)), ((0.1, 1.0), "0.1 1.0"),
     ((1.0, 2.0, 3.0, 4.0, 5.0), (1.0, 2.0, 3.0, 4.0, 5.0)), (np.float32(0.1), float(np.float32(0.1))),
     (math.inf, math.inf), (True, "True"), (1e300, "1e+300")],
)  # fmt: skip
def test_header_values_come_back_or_come_back_as_text(tmp_path, value, back):
    Frame({"Z": np.zeros((1, 1), np.float32)}, {"key": value}).save(tmp_path / "h.exr")
    assert Frame.load(tmp_path / "h.exr").header == {"key": back}


def test_bytes_do_not_depend_on_run_threads_folder_or_clock(tmp_path):
    make_frame(height=200, width=300).save(tmp_path / "here.exr")
    make_frame().save(tmp_path / "small.exr")
    wanted = (tmp_path / "here.exr").read_bytes()
    code = """
        import sys
        from clrast.image.exr import limit_threads
        if sys.argv[2] != "0":
            limit_threads(int(sys.argv[2]))
        make_frame(height=200, width=300).save(sys.argv[1])
    """
    for index, threads in enumerate(("0", "1", "2", "7")):
        folder = tmp_path / f"folder {index}"
        folder.mkdir()
        name = str(folder / "there.exr") if index % 2 else "there.exr"
        run = in_subprocess(code, name, threads, cwd=folder, TZ=f"UTC{index}", LC_ALL="C", USER=f"u{index}")
        assert run.returncode == 0, run.stderr
        assert (folder / "there.exr").read_bytes() == wanted, f"{threads} threads"
    assert hashlib.sha256((tmp_path / "small.exr").read_bytes()).hexdigest() == BYTES_OF_ALL_GROUPS


def test_half_rounds_floats_and_leaves_ids(tmp_path):
    frame = make_frame(("color", "id"))
    frame.channels["R"][0, :3] = [1e6, 0.1, 65520.0]
    frame.save(tmp_path / "h.exr", half=True)
    back = Frame.load(tmp_path / "h.exr")
    with np.errstate(over="ignore"):
        assert np.array_equal(back["R"], frame["R"].astype(np.float16).astype(np.float32))
    assert back["R"][0, 0] == np.inf
    assert np.array_equal(back["id.prim"], frame["id.prim"])
    assert (tmp_path / "h.exr").stat().st_size > 0
    assert b"\x01\x00\x00\x00" == raw_headers((tmp_path / "h.exr").read_bytes())[0]["channels"][1][2:6]  # HALF is 1


def test_any_memory_layout_is_written(tmp_path):
    plane = np.arange(24, dtype=np.float32).reshape(4, 6)
    strided = np.zeros((8, 12), np.float32)
    strided[::2, ::-2] = plane
    frame = Frame({"R": np.asfortranarray(plane), "G": strided[::2, ::-2], "B": plane[:, ::-1][:, ::-1]})
    frame.save(tmp_path / "s.exr")
    back = Frame.load(tmp_path / "s.exr")
    assert all(np.array_equal(back[name], plane) for name in "RGB")


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    shape=st.tuples(st.integers(1, 40), st.integers(1, 40)),
    names=st.sets(st.sampled_from([*channels_of(AOV_GROUPS), "W", "my.layer.K"]), min_size=1),
    seed=st.integers(0, 2**32 - 1),
)
def test_any_bits_survive(tmp_path, shape, names, seed):
    random = np.random.default_rng(seed)
    channels = {}
    for name in sorted(names):
        bits = random.integers(0, 2**32, shape, np.uint32)
        channels[name] = bits if name.startswith("id.") else bits.view(np.float32)
    Frame(channels).save(tmp_path / "f.exr")
    back = Frame.load(tmp_path / "f.exr")
    assert set(back) == names
    assert all(back[name].tobytes() == channels[name].tobytes() for name in names)


@pytest.mark.parametrize(
    "channels, said",
    [({}, "at least one channel"), ({"R": np.zeros((2, 2))}, "float64"), ({"R": np.zeros(4, np.float32)}, "shape"),
     ({"R": np.zeros((2, 2), np.float32), "G": np.zeros((2, 3), np.float32)}, r"\(2, 2\)"),
     ({"R": np.zeros((0, 2), np.float32)}, "shape")],
)  # fmt: skip
def test_frames_refuse_what_is_no_image(channels, said):
    with pytest.raises(UsageError, match=said):
        Frame(channels)


def test_a_missing_channel_is_named():
    with pytest.raises(KeyError, match="id.prim.*R"):
        Frame({"R": np.zeros((1, 1), np.float32)})["id.prim"]


def test_outputs_are_checked_before_any_work(tmp_path):
    (tmp_path / "folder.exr").mkdir()
    os.mkfifo(tmp_path / "pipe.exr")
    (tmp_path / "old.exr").write_bytes(b"old")
    for name, error in [
        ("missing/x.exr", OutputError), ("folder.exr", OutputError), ("pipe.exr", OutputError), ("x.jpg", UsageError),
        ("x", UsageError), ("n" * 300 + ".exr", OutputError), ("old.exr/x.exr", OutputError),
        ("\udcff.exr", OutputError),
    ]:  # fmt: skip
        with pytest.raises(error) as caught:
            check_writable(tmp_path / name)
        assert "\n" not in str(caught.value)
        if error is OutputError:
            with pytest.raises(error):
                Frame({"R": np.zeros((1, 1), np.float32)}).save(tmp_path / name)
    check_writable(tmp_path / "old.exr")
    check_writable(tmp_path / "NEW.PNG")
    check_writable(tmp_path / "stats.json", suffixes=(".json",))
    assert (tmp_path / "old.exr").read_bytes() == b"old"
    assert sorted(os.listdir(tmp_path)) == ["folder.exr", "old.exr", "pipe.exr"]


def test_write_protection_is_respected():
    with tempfile.TemporaryDirectory() as folder:
        old, user = Path(folder, "old.exr"), os.geteuid()
        old.write_bytes(b"old")
        old.chmod(0o444)
        os.chmod(folder, 0o555)
        try:
            if user == 0:  # root may write anywhere: be nobody for a moment
                os.seteuid(65534)
            with pytest.raises(OutputError, match="write-protected"):
                check_writable(old)
            with pytest.raises(OutputError, match="[Pp]ermission"):
                check_writable(Path(folder, "new.exr"))
        finally:
            os.seteuid(user)
            os.chmod(folder, 0o755)


@pytest.mark.parametrize("name", ["x.exr", "x.png"])
def test_a_disk_that_fills_leaves_the_old_file_and_nothing_else(tmp_path, name):
    path = tmp_path / name
    make_frame(height=64, width=64).save(path)
    size = path.stat().st_size
    path.write_bytes(b"old")
    code = """
        import resource, signal, sys
        from clrast.errors import OutputError
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        frame = make_frame(height=64, width=64)
        for limit in map(int, sys.argv[2:]):
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
            try:
                frame.save(sys.argv[1])
                print("written")
            except OutputError as fault:
                assert "cannot be written" in str(fault) and chr(10) not in str(fault)
                print("refused")
    """
    # OpenImageIO itself reports success where only the end of the file is lost
    limits = [0, 100, size // 2, size - 5000, size - 1000, size - 100, size - 1]
    run = in_subprocess(code, str(path), *(str(limit) for limit in limits if limit >= 0))
    assert run.returncode == 0, run.stderr
    assert run.stdout.split() == ["refused"] * len([limit for limit in limits if limit >= 0])
    assert os.listdir(tmp_path) == [name] and path.read_bytes() == b"old"


def test_an_interrupted_write_leaves_nothing(tmp_path):
    def interrupted(draft: str) -> None:
        Path(draft).write_bytes(b"half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_whole(tmp_path / "x.exr", interrupted)
    assert os.listdir(tmp_path) == []


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "link.exr").symlink_to("real.exr")
    frame = make_frame(("depth",))
    frame.save(tmp_path / "link.exr")
    assert (tmp_path / "link.exr").is_symlink()
    assert np.array_equal(Frame.load(tmp_path / "real.exr")["Z"], frame["Z"])


def test_odd_file_names(tmp_path):
    frame = make_frame(("depth",))
    for name in ("a?x=1.exr", "b#2.exr", "c %04d.exr", "d ü.EXR", "e?.png"):
        frame.save(tmp_path / name)
        assert Frame.load(tmp_path / name).width == frame.width


def test_unreadable_files_are_errors_of_one_line(tmp_path):
    make_frame(("color", "id"), 9, 7).save(tmp_path / "whole.exr")
    make_frame(("color",), 9, 7).save(tmp_path / "whole.png")
    (tmp_path / "text.exr").write_text("not an image")
    (tmp_path / "wrong.png").write_bytes((tmp_path / "whole.exr").read_bytes())
    (tmp_path / "folder.exr").mkdir()
    for name in ("text.exr", "wrong.png", "folder.exr", "whole.exr.txt", "\udcff.exr"):
        with pytest.raises((SceneError, InputNotFoundError)) as caught:
            Frame.load(tmp_path / name)
        assert "\n" not in str(caught.value)
    with pytest.raises(InputNotFoundError):
        Frame.load(tmp_path / "nothing.exr")
    for suffix in (".exr", ".png"):
        whole = (tmp_path / f"whole{suffix}").read_bytes()
        for length in range(0, len(whole)):
            (tmp_path / f"cut{suffix}").write_bytes(whole[:length])
            with pytest.raises(SceneError):
                Frame.load(tmp_path / f"cut{suffix}")


def test_broken_bytes_never_crash_the_interpreter(tmp_path):
    make_frame(("color", "depth", "normal", "id"), 40, 33).save(tmp_path / "whole.exr")
    make_frame(("color",), 40, 33).save(tmp_path / "whole.png")
    code = """
        import random, resource, sys
        from clrast.errors import SceneError
        resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
        for source in sys.argv[1:]:
            whole = open(source, "rb").read()
            for seed in range(400):
                chance = random.Random(seed)
                broken = bytearray(whole)
                for _ in range(chance.choice((1, 1, 2, 8))):
                    place = chance.randrange(min(len(whole) - 4, 2200 if seed % 3 else len(whole)))
                    broken[place] = chance.randrange(256)
                    if seed % 2:
                        wide = chance.choice((0, 2**31 - 1, 2**31, 2**32 - 1))
                        broken[place : place + 4] = wide.to_bytes(4, "little")
                name = source.replace("whole", "broken")
                open(name, "wb").write(broken)
                try:
                    Frame.load(name)
                except SceneError as fault:
                    assert chr(10) not in str(fault)
        print("alive")
    """
    run = in_subprocess(code, str(tmp_path / "whole.exr"), str(tmp_path / "whole.png"))
    assert (run.returncode, run.stdout.strip(), run.stderr) == (0, "alive", "")
