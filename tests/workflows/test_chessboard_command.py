"""`jaxmocap calibrate chessboard` from photographs to files, and what it does with bad input."""

import os
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest
from workflows_support import K_TRUE, board_poses, draw_board, read_json

OPTIONS = ("--board", "7x5", "--square", "20mm", "-o", "camera.toml", "--json", "result.json")


def test_calibrates_drawn_photographs(jaxmocap, photos: Path, tmp_path: Path) -> None:
    done = jaxmocap("calibrate", "chessboard", photos, *OPTIONS, "--report", "report.html", "--opencv", "camera.yaml")
    assert done.status == 0, done.text
    result = read_json(tmp_path / "result.json")
    camera = result["cameras"][0]
    assert result["success"] and result["unit"] == "mm" and result["views_used"] == 12
    assert result["observations_used"] == 12 * 35 and result["frozen"] == []
    for name, truth in {"fx": 610.0, "fy": 612.0, "cx": 322.0, "cy": 236.0, "k1": -0.18, "k2": 0.05}.items():
        assert abs(camera[name] - truth) < 4 * camera["sigma"][name], (name, camera[name], camera["sigma"][name])
    assert result["rms_px"] < 0.2
    rig = tomllib.loads((tmp_path / "camera.toml").read_text())
    np.testing.assert_allclose(rig["cam_1"]["matrix"][0][0], camera["fx"], rtol=0, atol=0)
    storage = cv2.FileStorage(str(tmp_path / "camera.yaml"), cv2.FILE_STORAGE_READ)
    np.testing.assert_allclose(storage.getNode("camera_matrix").mat()[0, 0], camera["fx"], rtol=1e-12)
    page = (tmp_path / "report.html").read_text()
    assert page.count("<svg") + page.count("data:image") > 3 and "http://" not in page.replace("http://www.w3.org", "")
    assert "±" in done.out and "root of the mean squared residual length" in done.out


def test_does_not_depend_on_the_order_of_files_and_writes_the_same_bytes(jaxmocap, photos: Path, tmp_path) -> None:
    files = sorted(photos.glob("*.png"))
    written = []
    for order in (files, files[::-1]):
        done = jaxmocap("calibrate", "chessboard", *order, *OPTIONS)
        assert done.status == 0, done.text
        written.append((tmp_path / "camera.toml").read_bytes())
    assert written[0] == written[1]


def test_robust_forgives_a_spoilt_view(jaxmocap, photos: Path, tmp_path: Path) -> None:
    folder = tmp_path / "spoilt"
    shutil.copytree(photos, folder)
    spoilt = folder / "view_03.png"
    grey = cv2.imdecode(np.fromfile(spoilt, np.uint8), 0)
    shear = np.array([[1.0, 0.02, -3.0], [0.0, 1.0, 0.0]])  # as if that photo had been scanned askew
    cv2.imencode(".png", cv2.warpAffine(grey, shear, grey.shape[::-1], borderValue=100))[1].tofile(spoilt)
    options = [o if o != "result.json" else "robust.json" for o in OPTIONS]
    assert jaxmocap("calibrate", "chessboard", folder, *OPTIONS, "--force").status == 0
    done = jaxmocap("calibrate", "chessboard", folder, *options, "--robust", "--force")
    assert done.status == 0, done.text
    plain, robust = read_json(tmp_path / "result.json"), read_json(tmp_path / "robust.json")
    miss = lambda r: abs(r["cameras"][0]["fx"] - K_TRUE[0, 0])  # noqa: E731
    assert miss(robust) < 0.5 * miss(plain)
    assert robust["observations_rejected"] >= 10


@pytest.mark.parametrize(
    ("arguments", "status", "said"),
    [
        (("nothing_*.png", *OPTIONS), 2, "nothing_*.png"),
        (("PHOTOS", "--board", "8x6", "--square", "20mm", "-o", "camera.toml", "--json", "result.json"), 2, "7x5"),
        (("PHOTOS", "--board", "7", "--square", "20mm", "-o", "camera.toml", "--json", "result.json"), 2, "--board"),
        (("PHOTOS", "--board", "7x5", "--square", "0mm", "-o", "camera.toml", "--json", "result.json"), 2, "--square"),
        (("PHOTOS", *OPTIONS, "--distortion", "k4"), 2, "k1k2p1p2k3"),
        (("PHOTOS", *OPTIONS, "--report", "nowhere/report.html"), 2, "nowhere"),
        (("PHOTOS/view_00.png", *OPTIONS), 3, "1 view"),
        (("PHOTOS/view_00.png", "ALIKE", *OPTIONS), 3, "view"),
    ],
    ids=["no file", "squares for corners", "board", "square", "model", "no folder", "one view", "all views alike"],
)
def test_bad_input_is_named_and_overwrites_nothing(
    jaxmocap, photos: Path, tmp_path: Path, arguments: tuple[str, ...], status: int, said: str
) -> None:
    (tmp_path / "camera.toml").write_text("old")
    if "ALIKE" in arguments:
        rvec, tvec = board_poses(12, 1)[0]
        alike = [tmp_path / f"alike_{i}.png" for i in range(5)]
        for i, path in enumerate(alike):
            cv2.imwrite(str(path), draw_board(rvec, tvec + 0.05 * i, 50 + i))
        arguments = tuple(a for a in arguments if a != "ALIKE") + tuple(map(str, alike))
    done = jaxmocap("calibrate", "chessboard", *(a.replace("PHOTOS", str(photos)) for a in arguments))
    assert done.status == status, done.text
    assert said in done.err and "Traceback" not in done.text
    assert (tmp_path / "camera.toml").read_text() == "old"
    if "nowhere" not in said:
        failure = read_json(tmp_path / "result.json")
        assert failure["success"] is False and said in failure["message"]


def test_bad_photographs_are_refused_by_name(jaxmocap, photos: Path, tmp_path: Path) -> None:
    first = photos / "view_00.png"
    good = first.read_bytes()
    jpeg = cv2.imencode(".jpg", cv2.imdecode(np.frombuffer(good, np.uint8), 0))[1].tobytes()
    bad = {
        "empty.png": b"",
        "text.png": b"this is not a picture",
        "cut.png": good[: len(good) // 2],
        "cut.jpg": jpeg[: len(jpeg) // 2],
        "other_size.png": cv2.imencode(".png", np.zeros((100, 100), np.uint8))[1].tobytes(),
    }
    for name, content in bad.items():
        (tmp_path / name).write_bytes(content)
        done = jaxmocap("calibrate", "chessboard", photos, name, *OPTIONS)
        assert done.status == 2 and name in done.err, (name, done.text)
    assert not (tmp_path / "camera.toml").exists()


def test_wrong_usage_is_two_and_help_is_zero(jaxmocap) -> None:
    assert jaxmocap("calibrate", "chessboard").status == 2
    assert jaxmocap("calibrate", "cheesboard").status == 2
    assert jaxmocap("--help").status == 0


@pytest.mark.real
def test_calibrates_the_opencv_photographs(jaxmocap, data_dir: Path, tmp_path: Path) -> None:
    folder = data_dir / "opencv_stereo_chessboard"
    done = jaxmocap(
        "calibrate", "chessboard", folder / "left*.jpg", "--board", "9x6", "--square", "30mm", "-o", "left.toml",
        "--json", "left.json",
    )  # fmt: skip
    assert done.status == 0, done.text
    result = read_json(tmp_path / "left.json")
    assert result["views_used"] == 13 and result["rms_px"] < 0.25


def test_interrupted_is_130_and_leaves_files_whole(compiled: Path, photos: Path, tmp_path: Path) -> None:
    (tmp_path / "camera.toml").write_text("old")
    env = {**os.environ, "JAXMOCAP_CACHE_DIR": str(compiled)}
    command = [sys.executable, "-m", "jaxmocap", "calibrate", "chessboard", str(photos), *OPTIONS]
    running = subprocess.Popen(
        command, cwd=tmp_path, env=env, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    time.sleep(1.5)
    running.send_signal(signal.SIGINT)
    _, err = running.communicate(timeout=120)
    assert running.returncode == 130, err
    assert "interrupted" in err and (tmp_path / "camera.toml").read_text() == "old"
    assert not list(tmp_path.glob("*.tmp*"))
