"""The folder of a pose: what it refuses, and that it survives an interruption at any moment."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from jaxmocap._errors import InputError
from jaxmocap.io import puppet_folder, write_many
from jaxmocap.io.folder_lock import LOCK, locked
from jaxmocap.io.puppet_folder import PuppetFolder, add_photos, create_puppet_folder, open_puppet_folder

INDEX = """\
schema = 1
unit = "mm"
distance = 400.0
height = 80.0
inputs = ["camera"]
[photos]
0 = "a_000.jpg"
30 = "a_030.jpg"
"""


@pytest.fixture()
def pictures(tmp_path: Path) -> dict[str, Path]:
    """Files that stand for photographs: the folder never looks into them."""
    (tmp_path / "new").mkdir()
    made = {}
    for name in ("a_000.jpg", "a_030.jpg", "b_030.jpg", "new/a_030.jpg", "camera.toml", "colours.toml"):
        made[name] = tmp_path / name
        made[name].write_bytes(name.encode() * 20)
    return made


def make(path: Path, pictures: dict[str, Path]) -> PuppetFolder:
    inputs = {"camera": pictures["camera.toml"], "colours": pictures["colours.toml"], "bones": None}
    return create_puppet_folder(path, inputs, unit="mm", distance=400.0, height=80.0)


def filled(path: Path, pictures: dict[str, Path]) -> PuppetFolder:
    return add_photos(make(path, pictures), {0.0: pictures["a_000.jpg"], 30.0: pictures["a_030.jpg"]})[0]


def content_of(folder: Path) -> dict[float, bytes]:
    """Photographs that count, by angle."""
    opened = open_puppet_folder(folder)
    return {angle: opened.photo(name).read_bytes() for angle, name in opened.photos.items()}


def test_what_is_put_in_is_there(tmp_path, pictures):
    folder = filled(tmp_path / "deep" / "w", pictures)
    assert open_puppet_folder(folder.path) == folder and folder.inputs == ("camera", "colours")
    assert content_of(folder.path) == {
        0.0: pictures["a_000.jpg"].read_bytes(),
        30.0: pictures["a_030.jpg"].read_bytes(),
    }
    assert folder.input("colours").read_bytes() == pictures["colours.toml"].read_bytes()
    assert folder.input("turntable") is None


@pytest.mark.parametrize("name, at", [("b_030.jpg", 30.0), ("new/a_030.jpg", 30.0), ("b_030.jpg", 390.0)])
def test_a_photo_taken_again_takes_the_place_of_the_old_one(tmp_path, pictures, name, at):
    folder = filled(tmp_path / "w", pictures)
    changed, said = add_photos(folder, {at: pictures[name]})
    assert content_of(folder.path)[30.0] == pictures[name].read_bytes() and len(changed.photos) == 2
    assert len(said) == 1 and "replaced" in said[0] and "replaced/a_030.1.jpg" in said[0]
    assert (folder.path / "replaced/a_030.1.jpg").read_bytes() == pictures["a_030.jpg"].read_bytes()
    assert sorted(p.name for p in (folder.path / "photos").iterdir()) == ["a_000.jpg", pictures[name].name]
    # The same once more changes nothing; another one keeps this one too.
    assert add_photos(changed, {30.0: pictures[name]}) == (changed, [])
    add_photos(changed, {30.0: pictures["a_030.jpg"]})
    assert len(list((folder.path / "replaced").iterdir())) == 2


def test_photographs_that_are_gone_are_named_and_can_be_taken_again(tmp_path, pictures):
    folder = filled(tmp_path / "w", pictures)
    folder.photo("a_030.jpg").unlink()
    with pytest.raises(InputError, match=r"gone: a_030\.jpg.*again.*puppet add"):
        open_puppet_folder(folder.path)
    _, said = add_photos(open_puppet_folder(folder.path, repair=True), {30.0: pictures["b_030.jpg"]})
    assert "was gone" in said[0] and 30.0 in content_of(folder.path)


@pytest.mark.parametrize("name", ["camera.toml", "colours.toml"])
def test_a_file_it_was_made_with_is_missed(tmp_path, pictures, name):
    folder = filled(tmp_path / "w", pictures)
    (folder.path / name).unlink()
    with pytest.raises(InputError, match=f"{name} of this pose is gone. Put the file back"):
        open_puppet_folder(folder.path)


def test_one_name_for_two_angles_is_refused(tmp_path, pictures):
    folder = filled(tmp_path / "w", pictures)
    before = content_of(folder.path)
    with pytest.raises(InputError, match=r"a_030\.jpg: a photograph of this name stands at 30 degrees.*Rename"):
        add_photos(folder, {60.0: pictures["new/a_030.jpg"]})
    assert content_of(folder.path) == before


@pytest.mark.parametrize(
    "old, new, said",
    [
        ("schema = 1", "schema = 2", "newer jaxmocap"),
        ("schema = 1", 'schema = "1"', "schema: expected 1, got '1'"),
        ("schema = 1", "", "schema: expected 1, got None"),
        ('unit = "mm"', 'unit = "mn"', "unit: expected one of"),
        ('unit = "mm"', 'units = "mm"', "unknown key `units`; did you mean `unit`"),
        ("distance = 400.0", "distence = 400.0", "unknown key `distence`; did you mean `distance`"),
        ("distance = 400.0", "distance = -400.0", "distance: expected a positive length, got -400"),
        ("distance = 400.0", "distance = 0x" + "f" * 5000, "distance: expected a number, got a very large int"),
        ("height = 80.0", "height = nan", "height: expected a number, got nan"),
        ("height = 80.0", "height = true", "height: expected a number, got True"),
        ('["camera"]', '["kamera"]', "inputs: expected some of camera"),
        ('["camera"]', '["colours"]', "inputs: expected some of camera"),
        ("30 =", "x30 =", "expected angles in degrees as keys, got 'x30'"),
        ("30 =", "inf =", "expected angles in degrees as keys, got 'inf'"),
        ("30 =", "360 =", "listed twice"),
        ("30 =", '"0.0" =', "listed twice"),
        ('"a_030.jpg"', '"a_000.jpg"', "listed twice"),
        ('"a_030.jpg"', '"../a_030.jpg"', "expected the name of a file in photos/"),
        ('"a_030.jpg"', '"/etc/passwd"', "expected the name of a file in photos/"),
        ('"a_030.jpg"', "'..\\a_030.jpg'", "expected the name of a file in photos/"),
        ('"a_030.jpg"', '".."', "expected the name of a file in photos/"),
        ('"a_030.jpg"', '""', "expected the name of a file in photos/"),
        ('"a_030.jpg"', "30", "expected the name of a file in photos/"),
        ('"a_030.jpg"', '"a\\u0000.jpg"', "expected the name of a file in photos/"),
        ('[photos]\n0 = "a_000.jpg"\n30 = "a_030.jpg"', "photos = 3", "expected a table"),
        ("[photos]", "[photos", "not valid TOML"),
        ('0 = "a_000.jpg"', '0 = "a_000.jpg', "not valid TOML"),
    ],
)
def test_a_damaged_index_is_refused_in_words(tmp_path, pictures, old, new, said):
    folder = filled(tmp_path / "w", pictures)
    assert INDEX.count(old) == 1
    (folder.path / "puppet.toml").write_text(INDEX.replace(old, new))
    with pytest.raises(InputError, match=said) as refused:
        open_puppet_folder(folder.path)
    assert "puppet.toml" in str(refused.value) and len(str(refused.value)) < 1000


@pytest.mark.parametrize("content, said", [(b"", "empty"), (b"\xff\xfes\0", "UTF-16"), (b"schema = \x80", "not UTF-8")])
def test_an_index_that_is_no_text(tmp_path, pictures, content, said):
    folder = filled(tmp_path / "w", pictures)
    (folder.path / "puppet.toml").write_bytes(content)
    with pytest.raises(InputError, match=said):
        open_puppet_folder(folder.path)


def test_a_folder_is_not_made_over_something(tmp_path, pictures):
    filled(tmp_path / "w", pictures)
    with pytest.raises(InputError, match="is a puppet's folder already"):
        make(tmp_path / "w", pictures)
    with pytest.raises(InputError, match=r"holds other files \(a_000.jpg.*new or empty folder"):
        make(tmp_path, pictures)
    with pytest.raises(InputError, match="cannot be made"):
        make(pictures["a_000.jpg"] / "w", pictures)
    with pytest.raises(InputError, match="no puppet's folder.*puppet new"):
        open_puppet_folder(tmp_path)


HOLDER = """
import sys
from jaxmocap.io.folder_lock import locked
with locked(sys.argv[1]):
    print("ok", flush=True)
    sys.stdin.read()
"""


def test_one_process_at_a_time(tmp_path):
    other = subprocess.Popen([sys.executable, "-c", HOLDER, str(tmp_path)], stdin=-1, stdout=-1, text=True)
    try:
        assert other.stdout.readline() == "ok\n"
        with pytest.raises(InputError, match=rf"another process \({other.pid}\) is working.*Wait"), locked(tmp_path):
            pass
    finally:
        other.kill()
        other.communicate()
    with locked(tmp_path):  # its holder was killed
        with pytest.raises(InputError, match="another process"), locked(tmp_path):
            pass
    (tmp_path / LOCK).write_text(str(os.getpid()))  # a number that another, living process bears by now
    with locked(tmp_path):
        pass


class Killed(BaseException):
    """The process was ended."""


def interrupted(monkeypatch: pytest.MonkeyPatch, at: int, job: Callable[[], object]) -> bool:
    """Run until the at-th call that changes the disk; from there on nothing gets through, as after a kill."""
    calls = 0

    def fatal(name: str):
        real = getattr(os, name)

        def call(*args, **kwargs):
            nonlocal calls
            calls += 1
            if calls >= at:
                raise Killed
            return real(*args, **kwargs)

        return call

    with monkeypatch.context() as patched:
        for name in ("open", "write", "replace", "unlink", "mkdir", "fsync"):
            patched.setattr(os, name, fatal(name))
        try:
            job()
        except Killed:
            return True
    return False


def refused(monkeypatch: pytest.MonkeyPatch, at: int, job: Callable[[], object]) -> bool:
    """Let the at-th call that changes the disk fail as on a full disk, and only that one."""
    calls = 0

    def failing(name: str):
        real = getattr(os, name)

        def call(*args, **kwargs):
            nonlocal calls
            calls += 1
            if calls == at:
                raise OSError(28, "No space left on device")
            return real(*args, **kwargs)

        return call

    with monkeypatch.context() as patched:
        for name in ("open", "write", "replace", "mkdir"):
            patched.setattr(os, name, failing(name))
        try:
            job()
        except InputError:
            return True
    return False


@pytest.mark.parametrize("stop", [interrupted, refused])
def test_making_a_folder_can_stop_anywhere(tmp_path, pictures, monkeypatch, stop):
    for at in range(1, 100):
        path = tmp_path / f"w{at}"
        stopped = stop(monkeypatch, at, lambda path=path: make(path, pictures))
        if not (path / "puppet.toml").exists():
            assert stopped
            make(path, pictures)  # nothing is in the way of a second start
        assert open_puppet_folder(path).photos == {} and open_puppet_folder(path).inputs == ("camera", "colours")
        if not stopped:
            break
    assert at > 8  # it had that many places to stop


NEW = {"added": (60.0, "b_030.jpg"), "replaced": (30.0, "b_030.jpg"), "same name": (30.0, "new/a_030.jpg")}


@pytest.mark.parametrize("stop", [interrupted, refused])
@pytest.mark.parametrize("kind", NEW)
def test_adding_can_stop_anywhere(tmp_path, pictures, monkeypatch, stop, kind):
    angle, name = NEW[kind]
    outcomes = set()
    for at in range(1, 100):
        folder = filled(tmp_path / f"w{at}", pictures)
        old = content_of(folder.path)
        new = {**old, angle: pictures[name].read_bytes()}
        stopped = stop(monkeypatch, at, lambda folder=folder: add_photos(folder, {angle: pictures[name]}))
        state = content_of(folder.path)
        assert state in (old, new)
        outcomes.add(state == new)
        if state == new and angle in old:
            kept = [p.read_bytes() for p in (folder.path / "replaced").glob("*.jpg")]
            assert old[angle] in kept
        add_photos(open_puppet_folder(folder.path), {angle: pictures[name]})  # once more: no leftover is in the way
        assert content_of(folder.path) == new
        if not stopped:
            break
    assert outcomes == {True, False} and at > 6


def test_writing_results_can_stop_anywhere(tmp_path, pictures, monkeypatch):
    for at in range(1, 100):
        folder = filled(tmp_path / f"w{at}", pictures)
        results = [folder.path / name for name in (puppet_folder.IDENTIFIED, puppet_folder.POINTS)]
        write_many({path: b"old" for path in results})
        stopped = interrupted(monkeypatch, at, lambda results=results: write_many({path: b"new" for path in results}))
        assert {path.read_bytes() for path in results} <= {b"old", b"new"}
        assert len(content_of(folder.path)) == 2
        if not stopped:
            break
    assert {path.read_bytes() for path in results} == {b"new"} and at > 6


# One process makes workers that add photographs without end, ends each by SIGKILL, and looks at what is left.
LOOP = """
import os, random, signal, sys, time
from pathlib import Path
from jaxmocap.io.folder_lock import locked
from jaxmocap.io.puppet_folder import add_photos, create_puppet_folder, open_puppet_folder
work = Path(sys.argv[1])
contents = set()
for name in ("a_000.jpg", "b_000.jpg", "again/a_000.jpg", "a_030.jpg"):
    (work / name).parent.mkdir(exist_ok=True)
    (work / name).write_bytes(name.encode() * 5000)
    contents.add((work / name).read_bytes())
(work / "camera.toml").write_text("x")
folder = create_puppet_folder(work / "w", {"camera": work / "camera.toml"}, unit="mm", distance=1.0, height=0.0)
add_photos(folder, {0.0: work / "a_000.jpg", 30.0: work / "a_030.jpg"})
rng = random.Random(1)
for _ in range(30):
    worker = os.fork()
    if worker == 0:
        while True:
            with locked(work / "w"):
                name = rng.choice(["a_000.jpg", "b_000.jpg", "again/a_000.jpg"])
                add_photos(open_puppet_folder(work / "w"), {0.0: work / name})
    time.sleep(0.005 + 0.06 * rng.random())
    os.kill(worker, signal.SIGKILL)
    os.waitpid(worker, 0)
    rng.random()
    with locked(work / "w"):
        opened = open_puppet_folder(work / "w")
    assert list(opened.photos) == [0.0, 30.0], opened
    for name in opened.photos.values():
        assert opened.photo(name).read_bytes() in contents, name
print(len(list((work / "w/replaced").glob("*.jpg"))))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork and SIGKILL")
def test_a_real_kill_leaves_a_folder_that_opens(tmp_path):
    done = subprocess.run([sys.executable, "-c", LOOP, str(tmp_path)], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0 and done.stderr == "", done.stderr[-2000:]
    assert int(done.stdout) > 3  # workers did add
