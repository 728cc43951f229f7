"""Chessboard finding on photographs: which are found, which refused, and how near to the truth."""

import json

import cv2
import numpy as np
import pytest

from jaxmocap.vision import detect_boards, find_corners, read_photo

pytestmark = pytest.mark.real


def test_all_stereo_photos_are_found(data_dir):
    boards = detect_boards([data_dir / "opencv_stereo_chessboard"], (9, 6))
    assert len(boards.names) == 26 and boards.found.all()
    assert boards.warnings == ()


def test_left_and_right_are_numbered_alike(data_dir):
    """The right camera stands 100 mm to the right: each corner lies further left in its picture."""
    left = detect_boards([data_dir / "opencv_stereo_chessboard/left*.jpg"], (9, 6))
    right = detect_boards([data_dir / "opencv_stereo_chessboard/right*.jpg"], (9, 6))
    assert [name[-6:] for name in left.names] == [name[-6:] for name in right.names]
    assert (left.uv[..., 0] > right.uv[..., 0]).all()


def test_rendered_boards_are_found_where_they_are(data_dir):
    folder = data_dir / "rendered_puppet"
    truth = json.loads((folder / "ground_truth.json").read_text())["chessboard"]["photos"]
    boards = detect_boards([folder / "chess_*.jpg"], (9, 6))
    assert boards.found.tolist() == [True] * 20
    assert boards.names == tuple(photo["file"] for photo in truth)
    corners = np.array([photo["corners_px"] for photo in truth]).reshape(20, 54, 2)
    error = np.linalg.norm(boards.uv - corners, axis=-1)
    assert np.median(error) < 0.1
    assert error.max() < 1.0


def test_turntable_boards_are_found_from_the_front_only(data_dir):
    """Printed on one side: seen from behind or edge on there is nothing to find."""
    boards = detect_boards([data_dir / "rendered_puppet/turntable_*.jpg"], (9, 6))
    angles = [name[10:13] for name, ok in zip(boards.names, boards.found) if ok]
    assert angles == ["000", "030", "060", "300", "330"]


@pytest.mark.parametrize("camera", ["cam01", "cam02"])
def test_partly_visible_board_is_refused(data_dir, camera):
    boards = detect_boards([data_dir / "pose2sim_chessboard_cam01_cam02" / camera], (4, 7))
    missing = [name for name, ok in zip(boards.names, boards.found) if not ok]
    assert missing == [{"cam01": "cam01_02_int.jpg", "cam02": "cam02_06_int.jpg"}[camera]]


def test_a_part_of_the_board_is_not_taken_for_the_whole(data_dir):
    for photo in sorted((data_dir / "opencv_stereo_chessboard").glob("left*.jpg"))[:5]:
        for asked in ((8, 6), (9, 5), (8, 5)):
            assert find_corners(read_photo(photo).grey, asked) is None


def test_a_photo_turned_upside_down_keeps_its_numbers(data_dir):
    grey = read_photo(data_dir / "opencv_stereo_chessboard/left01.jpg").grey
    upright, turned = find_corners(grey, (9, 6)), find_corners(cv2.rotate(grey, cv2.ROTATE_180), (9, 6))
    assert upright is not None and turned is not None
    np.testing.assert_allclose((639, 479) - turned.uv, upright.uv, atol=0.05)


def test_the_stated_sigmas_hold_on_the_rendered_boards(data_dir):
    """Parameters calibrated by OpenCV lie within 2.5 of the standard deviations it states (98.8 % each)."""
    folder = data_dir / "rendered_puppet"
    camera = json.loads((folder / "ground_truth.json").read_text())["camera"]
    boards = detect_boards([folder / "chess_*.jpg"], (9, 6))
    target = np.zeros((54, 3), np.float32)
    target[:, :2] = np.stack(np.meshgrid(np.arange(9), np.arange(6)), -1).reshape(-1, 2) * 12
    seen = [uv.astype(np.float32).reshape(-1, 1, 2) for uv in boards.uv]
    flags = cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
    _, k, d, _, _, sigma, *_ = cv2.calibrateCameraExtended(
        [target] * 20, seen, boards.image_size, None, None, flags=flags
    )
    found = np.array([k[0, 0], k[1, 1], k[0, 2], k[1, 2], d.ravel()[0], d.ravel()[1]])
    truth = np.array([camera[name] for name in ("fx", "fy", "cx", "cy", "k1", "k2")])
    assert np.abs((found - truth) / sigma.ravel()[:6]).max() < 2.5
