"""Sets of photos: detection over a folder, copies, near copies, advice on the wrong board size."""

import cv2
import numpy as np
import pytest

from jaxmocap._errors import InputError
from jaxmocap.vision import detect_boards, near_duplicates

POSES = {
    "view1.png": {"roll": 0.06},
    "view2.png": {"roll": -0.2, "origin": (40.0, 90.0)},
    "view10.png": {"roll": 0.3, "origin": (80.0, 40.0), "tilt": 0.0},
}


@pytest.fixture
def folder(tmp_path, draw_board):
    """Three photos of a 7x4 board."""
    for name, pose in POSES.items():
        cv2.imwrite(str(tmp_path / name), draw_board(7, 4, **pose).grey)
    return tmp_path


def test_all_photos_in_natural_order(folder, draw_board):
    seen = []
    boards = detect_boards([folder], (7, 4), progress=lambda done, total: seen.append((done, total)))
    assert boards.names == tuple(POSES)
    assert boards.image_size == (320, 240) and boards.columns_rows == (7, 4)
    assert boards.found.tolist() == [True] * 3 and boards.warnings == ()
    assert boards.uv.shape == (3, 28, 2)
    for uv, pose in zip(boards.uv, POSES.values()):
        np.testing.assert_allclose(uv, draw_board(7, 4, **pose).corners, atol=0.25)
    assert seen == [(1, 3), (2, 3), (3, 3)]


def test_result_does_not_depend_on_order_or_workers(folder):
    one = detect_boards([folder / name for name in POSES], (7, 4), workers=1)
    other = detect_boards([folder / name for name in reversed(POSES)], (7, 4), workers=3)
    assert one.names == other.names and one.sha256 == other.sha256
    np.testing.assert_array_equal(one.uv, other.uv)


def test_photo_without_a_board_is_kept_and_named(folder):
    cv2.imwrite(str(folder / "wall.png"), np.full((240, 320), 200, np.uint8))
    boards = detect_boards([folder], (7, 4))
    assert boards.found.tolist() == [True, True, True, False]
    assert (boards.uv[3] == 0).all()
    assert len(boards.warnings) == 1 and "1 of 4" in boards.warnings[0] and "wall.png" in boards.warnings[0]


def test_copy_of_a_photo_is_dropped_with_a_warning(folder):
    (folder / "view7 copy.png").write_bytes((folder / "view2.png").read_bytes())
    boards = detect_boards([folder], (7, 4))
    assert boards.names == tuple(POSES)
    assert "view7 copy.png is a copy of view2.png" in boards.warnings[0]


def test_burst_of_one_pose_is_named(folder, draw_board):
    shifted = draw_board(7, 4, **{**POSES["view2.png"], "origin": (41.0, 91.0)})
    cv2.imwrite(str(folder / "view3.png"), shifted.grey)
    boards = detect_boards([folder], (7, 4))
    assert boards.found.all() and len(boards.found) == 4
    assert "view3.png: the board is where it was in view2.png" in boards.warnings[0]


def test_an_unreadable_photo_is_an_error_naming_it(folder):
    (folder / "view4.png").write_bytes(b"")
    with pytest.raises(InputError, match=r"view4\.png"):
        detect_boards([folder], (7, 4))


def test_mixed_sizes_are_an_error(folder, draw_board):
    cv2.imwrite(str(folder / "small.png"), draw_board(7, 4, size=(300, 200)).grey)
    with pytest.raises(InputError, match=r"small\.png \(300x200\)"):
        detect_boards([folder], (7, 4))


def test_one_name_in_two_folders_is_said(folder, tmp_path, draw_board):
    (tmp_path / "more").mkdir()
    cv2.imwrite(str(tmp_path / "more" / "view2.png"), draw_board(7, 4, roll=0.5, origin=(90.0, 30.0)).grey)
    boards = detect_boards([folder, tmp_path / "more"], (7, 4))
    assert "view2.png" in boards.warnings[0]


@pytest.mark.parametrize(
    ("asked", "said"), [((8, 5), "squares instead of inner corners"), ((6, 3), "outermost"), ((7, 3), "miscounted")]
)
def test_wrong_size_is_explained(folder, asked, said):
    with pytest.raises(InputError, match=said) as caught:
        detect_boards([folder], asked)
    text = str(caught.value)
    assert f"no {asked[0]}x{asked[1]} board in 3 photos" in text and "7x4 fits 3 of 3" in text
    assert "--board 7x4" in text


def test_transposed_size_is_the_same_board(folder):
    boards = detect_boards([folder], (4, 7))
    assert boards.found.all()
    first = boards.uv[0].reshape(7, 4, 2)
    assert np.linalg.norm(first[0, 3] - first[0, 0]) < np.linalg.norm(first[6, 0] - first[0, 0])


def test_no_board_anywhere(tmp_path):
    cv2.imwrite(str(tmp_path / "wall.png"), np.full((240, 320), 200, np.uint8))
    with pytest.raises(InputError, match=r"no 9x6 board in 1 photo, .*INNER corners"):
        detect_boards([tmp_path], (9, 6))


def views(*shifts):
    """One lattice moved by so many pixels to the right."""
    lattice = np.stack(np.meshgrid(np.arange(9.0), np.arange(6.0)), -1).reshape(-1, 2) * 20
    return [lattice + (shift, 0.0) for shift in shifts]


def test_near_duplicates_are_grouped_about_the_first():
    # 640x480: the diagonal is 800 px, the limit 8 px
    groups = near_duplicates(views(0, 100, 5, 10, 103), list("abcde"), (640, 480))
    assert [group.names for group in groups] == [("a", "c"), ("b", "e")]
    assert [group.rms_px for group in groups] == [5.0, 3.0]
    assert "c:" in groups[0].message and "in a " in groups[0].message


def test_same_file_is_a_duplicate_whatever_its_corners():
    groups = near_duplicates(views(0, 100), ["a", "b"], (640, 480), sha256=["f00d", "f00d"])
    assert [group.names for group in groups] == [("a", "b")]


def test_distinct_views_are_no_duplicates():
    assert near_duplicates(views(0, 8.1, 16.2), list("abc"), (640, 480)) == ()


def test_a_name_is_needed_for_each_view():
    with pytest.raises(InputError, match="2 views but 1 names"):
        near_duplicates(views(0, 1), ["a"], (640, 480))
