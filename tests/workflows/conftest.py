"""Running the command line as a user types it."""

import os
import subprocess
import sys
from pathlib import Path

import cv2
import pytest
from workflows_support import Outcome, board_poses, draw_board


@pytest.fixture(scope="session")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One compilation cache for all commands of the session."""
    return tmp_path_factory.mktemp("compiled")


@pytest.fixture()
def jaxmocap(compiled: Path, tmp_path: Path):
    """A function that runs `jaxmocap ARGS` in a process of its own, in an empty folder."""

    def run(*args: object, timeout: float = 300.0) -> Outcome:
        env = {**os.environ, "JAXMOCAP_CACHE_DIR": str(compiled), "COLUMNS": "200", "NO_COLOR": "1"}
        env.pop("JAX_ENABLE_X64", None)
        command = [sys.executable, "-m", "jaxmocap", *map(str, args)]
        done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=env, timeout=timeout)
        return Outcome(done.returncode, done.stdout, done.stderr)

    return run


@pytest.fixture(scope="session")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder, with a space and an umlaut in its name, of twelve drawn photographs."""
    folder = tmp_path_factory.mktemp("pictures") / "board phötos"
    folder.mkdir()
    for i, (rvec, tvec) in enumerate(board_poses(12, 1)):
        cv2.imencode(".png", draw_board(rvec, tvec, i))[1].tofile(folder / f"view_{i:02d}.png")
    return folder
