"""`calibrate stereo`, `calibrate points` and `demo` from files to files."""

import csv
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest
from workflows_support import D_TRUE, K_TRUE, board_poses, draw_board, read_json

BOARD = np.array([[20.0 * i, 20.0 * j, 0.0] for j in range(5) for i in range(7)])
R_TRUE, T_TRUE = cv2.Rodrigues(np.array([0.02, 0.25, -0.01]))[0], np.array([-90.0, 2.0, 8.0])


@pytest.fixture(scope="module")
def pairs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten photographs by each of two cameras with one lens; two have no partner."""
    folder = tmp_path_factory.mktemp("pairs")
    for i, (rvec, tvec) in enumerate(board_poses(10, 3)):
        if i != 8:
            cv2.imwrite(str(folder / f"left_{i}.png"), draw_board(rvec, tvec, i))
        if i != 9:
            there = cv2.Rodrigues(R_TRUE @ cv2.Rodrigues(rvec)[0])[0].ravel()
            cv2.imwrite(str(folder / f"right_{i}.png"), draw_board(there, R_TRUE @ tvec + T_TRUE, 100 + i))
    return folder


def test_stereo(jaxmocap, pairs: Path, tmp_path: Path) -> None:
    done = jaxmocap(
        "calibrate", "stereo", "--left", *sorted(pairs.glob("left*")), "--right", *sorted(pairs.glob("right*")),
        "--board", "7x5", "--square", "0.02m", "-o", "rig.toml", "--json", "rig.json", "--report", "rig.html",
    )  # fmt: skip
    assert done.status == 0, done.text
    result = read_json(tmp_path / "rig.json")
    assert result["unit"] == "m" and [c["name"] for c in result["cameras"]] == ["left", "right"]
    left, right = result["cameras"]
    assert left["rotation"] == [0, 0, 0] and left["translation"] == [0, 0, 0]
    sigma = [right["sigma"][n] for n in ("tx", "ty", "tz")]
    assert np.all(np.abs(np.array(right["translation"]) - T_TRUE / 1000) < 4 * np.array(sigma)), (right, sigma)
    turned = cv2.Rodrigues(R_TRUE)[0].ravel()
    sigma = [right["sigma"][n] for n in ("rx", "ry", "rz")]
    assert np.all(np.abs(np.array(right["rotation"]) - turned) < 4 * np.array(sigma))
    assert "left_9.png" in done.text and "right_8.png" in done.text  # named as having no partner
    rig = tomllib.loads((tmp_path / "rig.toml").read_text())
    assert {"cam_left", "cam_right", "metadata"} <= set(rig)


def write_points(path: Path, target: np.ndarray, views: int, noise: float = 0.05, cameras: bool = False) -> None:
    """Correspondences of a target seen in several poses, made by OpenCV's projection."""
    rng = np.random.default_rng(5)
    rows = []
    for view, (rvec, tvec) in enumerate(board_poses(views, 7)):
        for name, R, t in (("a", np.eye(3), np.zeros(3)), ("b", R_TRUE, T_TRUE))[: 2 if cameras else 1]:
            turned = cv2.Rodrigues(R @ cv2.Rodrigues(rvec)[0])[0]
            uv = cv2.projectPoints(target, turned, R @ tvec + t, K_TRUE, D_TRUE)[0].reshape(-1, 2)
            uv += rng.normal(0, noise, uv.shape)
            rows += [[view, *p, *m, *([name] if cameras else [])] for p, m in zip(target.tolist(), uv.tolist())]
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["view", "x", "y", "z", "u", "v", *(["camera"] if cameras else [])])
        writer.writerows(rows)


@pytest.mark.parametrize("solid", [False, True], ids=["flat", "solid"])
def test_points(jaxmocap, tmp_path: Path, solid: bool) -> None:
    target = BOARD + (np.random.default_rng(2).uniform(-40, 40, BOARD.shape) if solid else 0.0)
    write_points(tmp_path / "points.csv", target, 8 if not solid else 3)
    done = jaxmocap(
        "calibrate", "points", "points.csv", "--size", "640x480", "--unit", "mm", "-o", "c.toml", "--json", "c.json"
    )
    assert done.status == 0, done.text
    camera = read_json(tmp_path / "c.json")["cameras"][0]
    for name, truth in {"fx": 610.0, "fy": 612.0, "cx": 322.0, "cy": 236.0, "k1": -0.18}.items():
        assert abs(camera[name] - truth) < 4 * camera["sigma"][name], (name, camera)


def test_points_of_two_cameras(jaxmocap, tmp_path: Path) -> None:
    write_points(tmp_path / "points.csv", BOARD, 10, cameras=True)
    done = jaxmocap(
        "calibrate", "points", "points.csv", "--size", "640x480", "--unit", "mm", "-o", "c.toml", "--json", "c.json"
    )
    assert done.status == 0, done.text
    second = read_json(tmp_path / "c.json")["cameras"][1]
    sigma = np.array([second["sigma"][n] for n in ("tx", "ty", "tz")])
    assert np.all(np.abs(np.array(second["translation"]) - T_TRUE) < 4 * sigma)


@pytest.mark.parametrize(
    ("content", "status", "said"),
    [
        ("view,x,y,z,u,v\n0,0,0,0,nan,5\n", 2, "line 2"),
        ("view;x;y;z;u;v\n0;0;0;0;1;5\n", 2, "semicolon"),
        ("view,x,y,z,u\n0,0,0,0,1\n", 2, "v"),
        ("", 2, "points.csv"),
        ("view,x,y,z,u,v\n0,0,0,0,1,5\n0,1,0,0,9,5\n0,1,1,0,9,9\n0,0,1,0,1,9\n", 3, "cannot determine"),
    ],
    ids=["NaN", "semicolons", "column", "empty", "too few"],
)
def test_bad_correspondences(jaxmocap, tmp_path: Path, content: str, status: int, said: str) -> None:
    (tmp_path / "points.csv").write_text(content)
    done = jaxmocap("calibrate", "points", "points.csv", "--size", "640x480", "-o", "c.toml", "--json", "c.json")
    assert done.status == status and said in done.err and "Traceback" not in done.text, done.text
    assert read_json(tmp_path / "c.json")["success"] is False
    assert not (tmp_path / "c.toml").exists()


def test_demo(jaxmocap, tmp_path: Path) -> None:
    done = jaxmocap("demo", "--out", "out")
    assert done.status == 0, done.text
    assert "truth 859" in done.out and "±" in done.out
    assert (tmp_path / "out" / "report.html").stat().st_size > 100_000
    matrix = tomllib.loads((tmp_path / "out" / "camera.toml").read_text())["cam_1"]["matrix"]
    assert abs(matrix[0][0] - 859.0) < 3.0 and abs(matrix[1][1] - 860.2) < 3.0


def test_a_wrong_output_name_destroys_nothing(jaxmocap, tmp_path: Path) -> None:
    write_points(tmp_path / "points.csv", BOARD, 3)
    before = (tmp_path / "points.csv").read_bytes()
    (tmp_path / "old.toml").write_text("old")
    common = ("calibrate", "points", "points.csv", "--size", "640x480")
    assert jaxmocap(*common, "-o", "new.toml", "--json", "points.csv").status == 2
    assert jaxmocap(*common, "-o", "old.toml", "--json", "old.toml").status == 2
    assert jaxmocap(*common, "-o", "points.csv").status == 2
    assert (tmp_path / "points.csv").read_bytes() == before
    assert (tmp_path / "old.toml").read_text() == "old"


def test_one_photo_for_both_cameras_is_refused(jaxmocap, pairs: Path) -> None:
    left = sorted(pairs.glob("left*"))
    done = jaxmocap(
        "calibrate", "stereo", "--left", *left, "--right", *left, "--board", "7x5", "--square", "2cm", "-o", "r.toml"
    )
    assert done.status == 2 and "left_0.png" in done.err, done.text


def test_photos_paired_in_the_wrong_order_are_refused(jaxmocap, pairs: Path, tmp_path: Path) -> None:
    """Names without numbers, the right ones in reverse: nothing is written, and the pairing is blamed."""
    for i in range(6):
        (tmp_path / f"left_{'abcdef'[i]}.png").write_bytes((pairs / f"left_{i}.png").read_bytes())
        (tmp_path / f"right_{'fedcba'[i]}.png").write_bytes((pairs / f"right_{i}.png").read_bytes())
    done = jaxmocap(
        "calibrate", "stereo", "--left", *sorted(tmp_path.glob("left*")), "--right", *sorted(tmp_path.glob("right*")),
        "--board", "7x5", "--square", "2cm", "-o", "rig.toml",
    )  # fmt: skip
    assert done.status == 2, done.text
    assert "left_a.png + right_a.png" in done.err and "same moment or are paired wrongly" in done.err
    assert "in the order of their names" in done.err and not (tmp_path / "rig.toml").exists()


def test_points_of_views_that_were_not_taken_at_once_are_named(jaxmocap, tmp_path: Path) -> None:
    write_points(tmp_path / "points.csv", BOARD, 10, cameras=True)
    with (tmp_path / "points.csv").open(newline="") as file:
        rows = list(csv.reader(file))
    for row in rows[1:]:
        if row[6] == "b" and row[0] in "36":  # the other camera's photos of views 3 and 6 exchanged
            row[0] = {"3": "6", "6": "3"}[row[0]]
    with (tmp_path / "points.csv").open("w", newline="") as file:
        csv.writer(file).writerows(rows)
    done = jaxmocap("calibrate", "points", "points.csv", "--size", "640x480", "--unit", "mm", "-o", "c.toml")
    assert done.status == 3, done.text
    assert "view 3, view 6: 2 of the 10 views" in done.err and "same moment" in done.err
    assert not (tmp_path / "c.toml").exists()
