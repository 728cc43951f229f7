"""Names and folders that the system refuses: a sentence and exit status 2, never a traceback. No solve is run."""

import json
import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from jaxmocap._errors import InputError
from jaxmocap.cli import main
from jaxmocap.cli.ending import Outputs
from jaxmocap.cli.places import check_places
from jaxmocap.io.text_file import read_text
from jaxmocap.vision import expand_photos, read_photo

BOARD = ("--board", "9x6", "--square", "3mm")
LONG = 300 * "a"


@pytest.fixture()
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with one picture, where the command runs."""
    monkeypatch.chdir(tmp_path)
    cv2.imwrite("photo.png", np.full((40, 60), 200, np.uint8))
    return tmp_path


@pytest.fixture()
def command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Runs `jaxmocap ARGS` in this process, without its folder of compiled programs: exit status and stderr."""
    monkeypatch.setattr("jaxmocap.cli.run.use_jax", lambda: None)

    def run(*arguments: str) -> tuple[object, str]:
        monkeypatch.setattr("sys.argv", ["jaxmocap", *arguments])
        with pytest.raises(SystemExit) as end:
            main()
        return end.value.code, capsys.readouterr().err

    return run


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("photo.png", *BOARD, "-o", f"{LONG}.toml"), "too long"),
        (("photo.png", *BOARD, "-o", "c.toml", "--report", f"{LONG}.html"), "too long"),
        ((f"{LONG}.png", *BOARD, "-o", "c.toml"), "cannot be listed"),
        (("~no-such-user-here/photo.png", *BOARD, "-o", "c.toml"), "cannot be listed"),
        (("photo.png", "--board", "99999x99999", "--square", "3mm", "-o", "c.toml"), "from 3 to 200"),
        (("b\udce9.png", *BOARD, "-o", "c.toml"), "rename the file"),
        (("photo.png", *BOARD, "-o", "b\udce9.toml"), "rename the file"),
        (("photo.png", "--board", "9x6", "-o", "c.toml"), "--square"),
    ],
    ids=["long output", "long report", "long photo", "unknown home", "huge board", "photo", "output", "usage"],
)
def test_wrong_names_are_status_2_with_a_sentence(folder: Path, command, arguments, said: str) -> None:
    status, err = command("calibrate", "chessboard", *arguments, "--json", "result.json")
    assert status == 2 and said in err
    failure = json.loads((folder / "result.json").read_bytes())
    assert failure["success"] is False and said in failure["message"]
    assert sorted(p.name for p in folder.iterdir()) == ["photo.png", "result.json"]


def test_a_wrong_command_line_replaces_no_other_file_that_it_names(folder: Path, command) -> None:
    before = (folder / "photo.png").read_bytes()
    assert command("calibrate", "chessboard", "photo.png", "--json", "photo.png")[0] == 2
    (folder / "rig.toml").write_text("old")
    assert command("calibrate", "chessboard", "photo.png", "-o", "rig.toml", "--json", "rig.toml")[0] == 2
    assert (folder / "photo.png").read_bytes() == before and (folder / "rig.toml").read_text() == "old"


@pytest.mark.skipif(os.name != "posix", reason="names are bytes on POSIX only")
@pytest.mark.parametrize("given", [".", "*.png"])
def test_a_photo_whose_name_is_not_utf8_is_refused(folder: Path, given: str) -> None:
    try:
        Path(os.fsdecode(b"b\xe9.png")).write_bytes((folder / "photo.png").read_bytes())
    except OSError:
        pytest.skip("this file system takes UTF-8 names only")
    with pytest.raises(InputError, match=r"udce9.*rename"):
        expand_photos([given])


def _forbid(monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
    """Path methods raise as for a folder that may be read but not entered (the superuser may enter any)."""

    def refused(self: Path, *_: object, **__: object) -> bool:
        raise PermissionError(13, "Permission denied", str(self))

    for name in names:
        monkeypatch.setattr(Path, name, refused)


def test_a_folder_that_may_not_be_entered(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "table.csv").write_text("x")
    with monkeypatch.context() as patch:
        _forbid(patch, "is_file")
        with pytest.raises(InputError, match=r"photo.png.*cannot be listed.*entered"):
            expand_photos(["photo.png"])
    with monkeypatch.context() as patch:
        _forbid(patch, "is_dir", "stat")
        with pytest.raises(InputError, match=r"photo.png: cannot be read.*permission"):
            read_photo("photo.png")
        with pytest.raises(InputError, match=r"other.csv: no such file"):
            read_text("other.csv", 100)
        with pytest.raises(InputError, match=r"rig.toml: cannot be written: no permission"):
            check_places(Outputs((Path("rig.toml"),)), [])
