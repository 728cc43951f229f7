"""Whatever fails, the old file is whole and nothing is left lying about."""

import errno
import os
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path

import pytest

from jaxmocap._errors import InputError
from jaxmocap.io import write_bytes, write_many, write_text


def _names(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


def test_new_file_is_utf8_with_its_line_ends(tmp_path):
    write_text(tmp_path / "größe mit leer.toml", "é\r\n\n")
    assert (tmp_path / "größe mit leer.toml").read_bytes() == b"\xc3\xa9\r\n\n"
    assert _names(tmp_path) == ["größe mit leer.toml"]


@pytest.mark.parametrize("umask", [0o022, 0o077, 0o002])
def test_permissions_of_a_new_file_are_those_of_open(tmp_path, umask):
    before = os.umask(umask)
    try:
        write_bytes(tmp_path / "ours", b"")
        (tmp_path / "theirs").open("wb").close()
    finally:
        os.umask(before)
    modes = [stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("ours", "theirs")]
    assert modes[0] == modes[1]


def test_permissions_of_an_old_file_are_kept(tmp_path):
    file = tmp_path / "rig.toml"
    file.write_bytes(b"old")
    file.chmod(0o640)
    write_bytes(file, b"new")
    assert (stat.S_IMODE(file.stat().st_mode), file.read_bytes()) == (0o640, b"new")


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "link").symlink_to("data/rig.toml")
    write_bytes(tmp_path / "link", b"new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "data" / "rig.toml").read_bytes() == b"new"


def test_devices_are_written_to_not_replaced():
    write_bytes("/dev/null", b"x" * 100)
    assert stat.S_ISCHR(os.stat("/dev/null").st_mode)


@pytest.mark.parametrize("call", ["open", "write", "fsync", "replace"])
@pytest.mark.parametrize(
    ("code", "words"),
    [
        (errno.ENOSPC, "disk is full"),
        (errno.EACCES, "no permission"),
        (errno.EROFS, "read-only"),
        (errno.EDQUOT, "quota"),
        (errno.EIO, "Input/output error"),
    ],
)
def test_a_fault_of_the_disk_leaves_the_old_file(tmp_path, monkeypatch, call, code, words):
    file = tmp_path / "rig.toml"
    file.write_bytes(b"old")

    def fail(*_args, **_kwargs):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(os, call, fail)
    with pytest.raises(InputError, match=words) as caught:
        write_bytes(file, b"new")
    monkeypatch.undo()
    assert str(file) in str(caught.value)
    assert file.read_bytes() == b"old"
    assert _names(tmp_path) == ["rig.toml"]


def test_a_full_disk_after_half_of_the_data(tmp_path, monkeypatch):
    real, calls = os.write, []

    def half(handle, data):
        calls.append(len(data))
        if len(calls) > 1:
            raise OSError(errno.ENOSPC, "full")
        return real(handle, data[: len(data) // 2])

    monkeypatch.setattr(os, "write", half)
    with pytest.raises(InputError, match="disk is full"):
        write_bytes(tmp_path / "rig.toml", b"0123456789")
    monkeypatch.undo()
    assert calls == [10, 5] and _names(tmp_path) == []


def test_short_writes_are_continued(tmp_path, monkeypatch):
    real = os.write
    monkeypatch.setattr(os, "write", lambda handle, data: real(handle, data[:3]))
    write_bytes(tmp_path / "f", b"0123456789")
    assert (tmp_path / "f").read_bytes() == b"0123456789"


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_ctrl_c_passes_through_and_leaves_the_old_file(tmp_path, monkeypatch, call):
    file = tmp_path / "rig.toml"
    file.write_bytes(b"old")

    def interrupt(*_args):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, call, interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_bytes(file, b"new")
    monkeypatch.undo()
    assert file.read_bytes() == b"old" and _names(tmp_path) == ["rig.toml"]


def test_a_real_limit_of_the_system(tmp_path):
    resource = pytest.importorskip("resource")
    old = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, old[1]))
    try:
        with pytest.raises(InputError, match="larger than the system allows"):
            write_bytes(tmp_path / "f", b"0" * 5000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old)
        signal.signal(signal.SIGXFSZ, handler)
    assert _names(tmp_path) == []


def test_wrong_places_are_named(tmp_path, monkeypatch):
    (tmp_path / "file").write_bytes(b"")
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match="folder .*nowhere.* does not exist. Create it"):
        write_bytes(tmp_path / "nowhere" / "rig.toml", b"")
    with pytest.raises(InputError, match="this is a folder"):
        write_bytes(tmp_path / "folder", b"")
    with pytest.raises(InputError, match="is not a folder"):
        write_bytes(tmp_path / "file" / "rig.toml", b"")
    with pytest.raises(InputError, match="name is too long"):
        write_bytes(tmp_path / ("x" * 300), b"")
    with pytest.raises(InputError, match="null"):
        write_bytes("rig\0.toml", b"")
    with pytest.raises(InputError, match="UTF-8 cannot store"):
        write_text(tmp_path / "f", "photo \udcff.jpg")
    monkeypatch.setattr(os, "access", lambda path, mode: mode != os.W_OK)  # root may write everywhere
    with pytest.raises(InputError, match="write-protected"):
        write_bytes(tmp_path / "file", b"")
    assert _names(tmp_path) == ["file", "folder"]


def test_a_stale_temporary_file_is_in_nobodys_way(tmp_path):
    stale = tmp_path / f".rig.toml.{os.getpid()}-0.tmp"
    stale.write_bytes(b"half")
    write_bytes(tmp_path / "rig.toml", b"new")
    assert (tmp_path / "rig.toml").read_bytes() == b"new" and stale.read_bytes() == b"half"


def test_many_files_are_written_all_or_none(tmp_path):
    first, second = tmp_path / "rig.toml", tmp_path / "report.html"
    write_many({first: b"1", second: b"2"})
    with pytest.raises(InputError, match="nowhere"):
        write_many({first: b"new", second: b"new", tmp_path / "nowhere" / "x.json": b"new"})
    assert (first.read_bytes(), second.read_bytes()) == (b"1", b"2")
    assert _names(tmp_path) == ["report.html", "rig.toml"]


def test_one_file_under_two_names_is_refused(tmp_path):
    (tmp_path / "sub").mkdir()
    with pytest.raises(InputError, match="twice"):
        write_many({tmp_path / "a.json": b"1", tmp_path / "sub" / ".." / "a.json": b"2"})
    assert _names(tmp_path) == ["sub"]


_WRITER = """
import importlib.util, sys
sys.path.insert(0, sys.argv[2])
spec = importlib.util.spec_from_file_location("atomic", sys.argv[2] + "/jaxmocap/io/atomic.py")
atomic = importlib.util.module_from_spec(spec); spec.loader.exec_module(atomic)
n = 0
while True:
    n += 1
    atomic.write_bytes(sys.argv[1], (b"%010d" % n) * 20_000)
    if n == 1: print("ready", flush=True)
"""


@pytest.mark.parametrize("signal_number", [signal.SIGKILL, signal.SIGTERM])
def test_killed_at_any_moment_the_file_is_whole(tmp_path, signal_number):
    file, root = tmp_path / "rig.toml", Path(__file__).parents[3]
    for delay in (0.0, 0.013, 0.031):
        process = subprocess.Popen(
            [sys.executable, "-c", _WRITER, str(file), str(root)], stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None and process.stdout.readline() == "ready\n"
        time.sleep(delay)
        process.send_signal(signal_number)
        process.wait()
        process.stdout.close()
        data = file.read_bytes()
        assert len(data) == 200_000 and data == data[:10] * 20_000
