"""`calibrate turntable` from drawn photographs to files, and every fault of the hand that turns it."""

import shutil
from pathlib import Path

import cv2
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from workflows_support import D_TRUE, K_TRUE, SIZE, draw_board, read_json

from jaxmocap._errors import InputError, SolveError
from jaxmocap.cameras import BrownDistortion, Camera, Intrinsics
from jaxmocap.geometry import Pose
from jaxmocap.io import NamedCamera, RigFile, read_turntable, write_rig
from jaxmocap.workflows.turntable import calibrate_turntable, stated_angle

# A build that is not perfect: the axis leans by a degree and more, the camera is turned aside, steps are off.
R0 = Rotation.from_rotvec([0.02, 0.018, -0.015]) * Rotation.from_rotvec([np.pi, 0, 0])
DISTANCE, HEIGHT = 360.0, 80.0
ANGLES = {0: 0.0, 25: 25.3, 50: 49.6, 310: 310.4, 335: 334.8}
R_BOARD = Rotation.from_euler("x", 168, degrees=True)


def pose(angle_deg: float, R0=R0, distance: float = DISTANCE) -> tuple[np.ndarray, np.ndarray]:
    """rvec, tvec of the board at an angle; its middle is 15 in front of the axis."""
    R = R0 * Rotation.from_euler("y", angle_deg, degrees=True)
    middle = np.array([4.0, HEIGHT - 6.0, 15.0])
    origin = middle - R_BOARD.apply([60.0, 40.0, 0.0])
    return (R * R_BOARD).as_rotvec(), R.apply(origin) - R0.apply([0, HEIGHT, distance])


def photograph(path: Path, rvec: np.ndarray, tvec: np.ndarray, seed: int) -> None:
    cv2.imwrite(str(path), draw_board(rvec, tvec, seed))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Camera file and photos; that at 180 degrees shows no board."""
    folder = tmp_path_factory.mktemp("turn")
    for stated, angle in ANGLES.items():
        photograph(folder / f"turn_{stated:03d}.png", *pose(angle), stated)
    grey = np.random.default_rng(0).integers(90, 110, SIZE[::-1]).astype(np.uint8)
    cv2.imwrite(str(folder / "turn_180.png"), grey)
    lens = BrownDistortion.from_vector(jnp.asarray(D_TRUE))
    camera = Camera(Intrinsics.from_matrix(jnp.asarray(K_TRUE)), lens, Pose.identity(), SIZE)
    sigmas = {"cam1": {"fx": 0.1, "fy": 0.1, "cx": 0.1, "cy": 0.1}}
    write_rig(folder / "camera.toml", RigFile((NamedCamera("cam1", camera),), unit="mm", sigmas=sigmas))
    return folder


def photos(folder: Path, *stated: int) -> list[str]:
    return [str(folder / f"turn_{a:03d}.png") for a in stated]


def test_files_and_truth(jaxmocap, folder: Path, tmp_path: Path) -> None:
    done = jaxmocap(
        "calibrate", "turntable", folder / "camera.toml", *photos(folder, *ANGLES, 180), "--board", "7x5",
        "--square", "2cm", "-o", "turntable.toml", "--json", "t.json", "--report", "t.html", "--height", "80mm",
    )  # fmt: skip
    assert done.status == 0, done.text
    result = read_json(tmp_path / "t.json")
    assert result["success"] and result["unit"] == "cm" and result["views_used"] == 5
    axis = result["axis"]
    for key, true in (("point", R0.apply([0, 0, -DISTANCE / 10])), ("direction", R0.apply([0, 1, 0]))):
        sigma = np.array(axis[f"sigma_{key}"])
        assert np.all(np.abs(np.array(axis[key]) - true) < 4 * sigma + 1e-6), (key, axis, true)
        assert sigma.max() < 0.05
    for stated, true in ANGLES.items():
        name = f"turn_{stated:03d}.png"
        sigma = result["sigma_angles_deg"][name]
        assert abs(result["angles_deg"][name] - true) <= 4 * sigma, (name, result)
        assert (sigma == 0) == (stated == 0) and sigma < 0.3
    assert result["skipped"].keys() == {"turn_180.png"}
    # Deviation of this build, as it was made.
    build = result["build"]
    turned = np.degrees([0.02, 0.018, -0.015])
    got = np.array([build["lean_in_depth_deg"], build["camera_turned_aside_deg"], build["lean_in_picture_deg"]])
    assert np.all(np.abs(got - turned) < 4 * np.array(build["sigma_deg"]))
    table = read_turntable(tmp_path / "turntable.toml")
    assert table.unit == "cm" and table.height == 8.0 and abs(table.distance - 36.0) < 0.2
    assert table.covariance is not None and table.held == ("height", "zero angle")
    page = (tmp_path / "t.html").read_text()
    assert "default-src &#x27;none&#x27;" in page and "turn_025.png" in page
    assert "the zero of the angles is free" in done.out.lower()


def solve(folder: Path, files: list[str], **more):
    return calibrate_turntable(folder / "camera.toml", files, "7x5", "20mm", **more)


def test_failures_write_json_alone(jaxmocap, folder: Path, tmp_path: Path) -> None:
    (tmp_path / "turntable.toml").write_text("old")
    done = jaxmocap(
        "calibrate", "turntable", folder / "camera.toml", *photos(folder, 0, 180), "--board", "7x5",
        "--square", "20mm", "-o", "turntable.toml", "--json", "t.json",
    )  # fmt: skip
    assert done.status == 3 and "three to check" in done.err
    assert not read_json(tmp_path / "t.json")["success"] and (tmp_path / "turntable.toml").read_text() == "old"
    shutil.copy(folder / "turn_000.png", tmp_path / "front.png")
    done = jaxmocap(
        "calibrate", "turntable", folder / "camera.toml", "front.png", *photos(folder, 25), "--board", "7x5",
        "--square", "20mm", "-o", "turntable.toml", "--json", "t.json",
    )  # fmt: skip
    assert done.status == 2 and "no angle in the name" in done.err and not read_json(tmp_path / "t.json")["success"]


def test_a_turntable_that_did_not_turn(folder: Path, tmp_path: Path) -> None:
    for i, a in enumerate((0, 30, 60)):
        photograph(tmp_path / f"still_{a:03d}.png", *pose(10.0), 50 + i)
    with pytest.raises(SolveError, match="did not turn"):
        solve(folder, [str(tmp_path)])


def test_a_turntable_that_turned_the_other_way(folder: Path, tmp_path: Path) -> None:
    for a in ANGLES:
        shutil.copy(folder / f"turn_{a:03d}.png", tmp_path / f"turn_{(360 - a) % 360:03d}.png")
    with pytest.raises(SolveError, match="clockwise seen from above"):
        solve(folder, [str(tmp_path)])


def test_a_camera_that_turned_instead(folder: Path, tmp_path: Path) -> None:
    """The board stands still; the camera pans about its own centre."""
    rvec, tvec = pose(10.0)
    for i, a in enumerate((0, 6, 12)):
        pan = Rotation.from_euler("y", -a, degrees=True)
        photograph(tmp_path / f"pan_{a:03d}.png", (pan * Rotation.from_rotvec(rvec)).as_rotvec(), pan.apply(tvec), i)
    with pytest.raises(SolveError, match="it was the camera that turned"):
        solve(folder, [str(tmp_path)])


def test_exchanged_photos_and_a_missing_angle_are_named(folder: Path, tmp_path: Path) -> None:
    exchanged = {0: 0, 25: 50, 50: 25, 310: 310, 335: 335}
    for a, source in exchanged.items():
        shutil.copy(folder / f"turn_{source:03d}.png", tmp_path / f"turn_{a:03d}.png")
    result = solve(folder, [str(tmp_path)])
    sentences = " ".join(w.sentence for w in result.weaknesses)
    assert "turn_025.png and turn_050.png are exchanged" in sentences
    np.testing.assert_allclose(result.angles_deg[1:3], [49.6, 25.3], atol=0.5)


def test_a_board_that_was_moved_is_said(folder: Path, tmp_path: Path) -> None:
    for a in ANGLES:
        shutil.copy(folder / f"turn_{a:03d}.png", tmp_path / f"turn_{a:03d}.png")
    rvec, tvec = pose(49.6)
    photograph(tmp_path / "turn_050.png", rvec, tvec + [3.0, 2.0, 0.0], 9)
    result = solve(folder, [str(tmp_path)])
    assert any(w.code == "moved" for w in result.weaknesses)


def test_two_photos_are_solved_with_a_warning(folder: Path) -> None:
    result = solve(folder, photos(folder, 0, 50))
    assert any(w.code == "two-photos" for w in result.weaknesses)
    assert abs(float(result.turntable.distance) - DISTANCE) < 4 * result.sigma_distance


def test_photos_of_another_camera_are_refused(folder: Path, tmp_path: Path) -> None:
    for a in (0, 25):
        picture = cv2.imread(str(folder / f"turn_{a:03d}.png"), cv2.IMREAD_GRAYSCALE)
        cv2.imwrite(str(tmp_path / f"turn_{a:03d}.png"), cv2.copyMakeBorder(picture, 8, 8, 0, 0, cv2.BORDER_REPLICATE))
    with pytest.raises(InputError, match="640x496"):
        solve(folder, [str(tmp_path)])


@pytest.mark.parametrize(
    "name, angle", [("t_030.jpg", 30.0), ("a_b_-12.5.png", -12.5), ("x_1_0.png", 0.0), ("t_007.tar.jpg", None)]
)
def test_stated_angles(name: str, angle: float | None) -> None:
    if angle is None:
        with pytest.raises(InputError, match="no angle"):
            stated_angle(name)
    else:
        assert stated_angle(name) == angle
