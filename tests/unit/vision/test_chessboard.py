import cv2
import numpy as np
import pytest

from jaxmocap._errors import InputError
from jaxmocap.vision import consistent_order, find_corners, orient_by_colour
from jaxmocap.vision.chessboard import half_windows

SIZES = [(9, 6), (6, 9), (7, 4), (5, 5), (6, 6), (8, 6), (3, 3)]
FITTING = {(6, 9): 16.0, (8, 6): 20.0, (6, 6): 20.0, (9, 6): 20.0}  # pixels per square, to fit the picture


def found(drawn, board, **options):
    result = find_corners(drawn.grey, board, **options)
    assert result is not None
    return result.uv


@pytest.mark.parametrize("board", SIZES)
@pytest.mark.parametrize("tilt", [0.0, 0.015])
def test_corners_are_where_they_were_drawn(draw_board, board, tilt):
    drawn = draw_board(*board, square=FITTING.get(board, 24.0), tilt=tilt)
    uv = found(drawn, board)
    assert uv.shape == (board[0] * board[1], 2) and uv.dtype == np.float64
    # any order: the nearest true corner; edges along pixel rows are drawn to half a sample, 1/8 px
    distance = np.linalg.norm(uv[:, None] - drawn.corners[None], axis=-1)
    assert np.sqrt((distance.min(axis=1) ** 2).mean()) < 0.1
    assert distance.min(axis=1).max() < 0.25
    assert len(set(distance.argmin(axis=1))) == len(uv)


@pytest.mark.parametrize("board", [(9, 6), (7, 4), (6, 9)])
@pytest.mark.parametrize("roll", [0.06, 0.06 + np.pi, 0.8, -2.2])
def test_boards_of_odd_and_even_counts_are_numbered_absolutely(draw_board, board, roll):
    back = np.array([160.0, 120.0])
    centre = np.array([(board[0] - 1) / 2, (board[1] - 1) / 2]) * 15
    turned = np.array([[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]]) @ centre
    drawn = draw_board(*board, square=15.0, origin=tuple(back - turned), roll=roll, tilt=0.0)
    np.testing.assert_allclose(found(drawn, board), drawn.corners, atol=0.15)


@pytest.mark.parametrize("board", [(9, 6), (7, 4)])
def test_a_half_turned_photo_keeps_each_corners_number(draw_board, board):
    drawn = draw_board(*board, square=20.0)
    upright = found(drawn, board)
    turned = find_corners(np.ascontiguousarray(drawn.grey[::-1, ::-1]), board)
    assert turned is not None
    np.testing.assert_allclose((319, 239) - turned.uv, upright, atol=0.05)


@pytest.mark.parametrize("board", SIZES)
def test_never_mirrored(draw_board, board):
    drawn = draw_board(*board, square=FITTING.get(board, 24.0))
    for grey in (drawn.grey, np.ascontiguousarray(drawn.grey[::-1])):
        result = find_corners(grey, board)
        assert result is not None
        grid = result.uv.reshape(board[1], board[0], 2)
        along, down = grid[0, 1] - grid[0, 0], grid[1, 0] - grid[0, 0]
        assert along[0] * down[1] - along[1] * down[0] > 0


def test_symmetric_boards_run_to_the_right(draw_board):
    for board in ((5, 5), (8, 6), (6, 6)):
        uv = found(draw_board(*board, square=20.0, roll=0.06 + np.pi, origin=(200, 180), tilt=0.0), board)
        direction = uv[board[0] - 1] - uv[0]
        assert direction[0] > abs(direction[1])


def numberings(uv, board):
    """All numberings row by row of one grid, mirrored ones too."""
    grid = uv.reshape(board[1], board[0], 2)
    turns = [np.rot90(g, k) for g in (grid, grid[:, ::-1]) for k in range(4)]
    return [g.reshape(-1, 2) for g in turns if g.shape == grid.shape]


@pytest.mark.parametrize("board", [(9, 6), (5, 5), (6, 6)])
def test_orientation_does_not_depend_on_the_finders(draw_board, board):
    drawn = draw_board(*board, square=20.0)
    for uv in numberings(drawn.corners, board):
        np.testing.assert_array_equal(orient_by_colour(drawn.grey, uv, board), drawn.corners)


@pytest.mark.parametrize(("board", "count"), [((8, 6), 2), ((5, 5), 2), ((6, 6), 4)])
def test_right_photo_is_numbered_as_the_left(draw_board, board, count):
    left = draw_board(*board, square=20.0).corners
    right = draw_board(*board, square=19.0, origin=(40, 60), roll=0.3).corners
    grid = right.reshape(board[1], board[0], 2)
    for k in range(0, 4, 4 // count):
        turned = np.rot90(grid, k).reshape(-1, 2)
        np.testing.assert_array_equal(consistent_order(left, turned, board), right)


def test_absolute_numbering_survives_a_camera_upside_down(draw_board):
    left = draw_board(9, 6, square=20.0).corners
    right = (319, 239) - left  # the same corners seen by a camera that hangs upside down
    np.testing.assert_array_equal(consistent_order(left, right, (9, 6)), right)


@pytest.mark.parametrize("side", ["left", "right", "top", "bottom"])
def test_partly_hidden_board_is_refused(draw_board, side):
    drawn = draw_board(7, 4)
    edge = {"left": np.s_[:, :75], "right": np.s_[:, 190:], "top": np.s_[:70, :], "bottom": np.s_[115:, :]}[side]
    drawn.grey[edge] = 128
    assert find_corners(drawn.grey, (7, 4)) is None


def test_hidden_corner_in_the_middle_is_refused(draw_board):
    drawn = draw_board(7, 4)
    cv2.circle(drawn.grey, tuple(int(x) for x in drawn.corners[10]), 16, 128, -1)
    assert find_corners(drawn.grey, (7, 4)) is None


def test_board_cut_by_the_picture_is_refused(draw_board):
    drawn = draw_board(7, 4)
    assert find_corners(np.ascontiguousarray(drawn.grey[:, 70:]), (7, 4)) is None


@pytest.mark.parametrize("asked", [(6, 4), (7, 3), (6, 3), (8, 5), (8, 4), (5, 4)])
def test_another_size_is_refused(draw_board, asked):
    drawn = draw_board(7, 4)
    assert find_corners(drawn.grey, (7, 4)) is not None
    assert find_corners(drawn.grey, asked) is None


def test_blank_and_tiny_photos_show_no_board():
    assert find_corners(np.full((120, 160), 200, np.uint8), (9, 6)) is None
    assert find_corners(np.zeros((3, 5), np.uint8), (9, 6)) is None


def test_noise_shows_no_board():
    noise = np.random.default_rng(0).integers(0, 255, (240, 320), dtype=np.uint8)
    assert find_corners(noise, (4, 3)) is None


@pytest.mark.parametrize("board", [(2, 6), (9, 2), (0, 0), (-9, 6), (9, 1000)])
def test_impossible_boards(board):
    with pytest.raises(InputError, match="INNER corners"):
        find_corners(np.zeros((100, 100), np.uint8), board)


@pytest.mark.parametrize("photo", [np.zeros((9, 9)), np.zeros((9, 9, 3), np.uint8)])
def test_photo_must_be_grey_bytes(photo):
    with pytest.raises(InputError, match="uint8"):
        find_corners(photo, (9, 6))


def test_corners_that_do_not_fit_the_board():
    with pytest.raises(InputError, match="expected 54 finite positions"):
        consistent_order(np.zeros((54, 2)), np.full((54, 2), np.nan), (9, 6))


def lattice(spacing: float, origin: float = 100.0) -> np.ndarray:
    return np.stack(np.meshgrid(np.arange(9), np.arange(6)), -1).reshape(-1, 2) * spacing + origin


@pytest.mark.parametrize(("spacing", "half"), [(100, 20), (30, 6), (20, 5), (10, 3), (6, 2)])
def test_window_follows_the_spacing(spacing, half):
    # 0.2 spacings; at least 5 px, but at most 0.35 spacings
    np.testing.assert_array_equal(half_windows(lattice(spacing), (9, 6), (2000, 2000)), half)


def test_window_of_narrow_diamonds_follows_their_height():
    sheared = lattice(40) @ np.array([[1.0, 0.0], [1.0, 0.25]])  # rows 10 px apart, in steps of 40 px
    np.testing.assert_array_equal(half_windows(sheared, (9, 6), (2000, 2000)), 3)


def test_window_stays_in_the_picture():
    half = half_windows(lattice(100, origin=8.0), (9, 6), (2000, 2000)).reshape(6, 9)
    assert (half[0] == 8).all() and (half[:, 0] == 8).all() and (half[1:, 1:] == 20).all()


def test_window_matters_where_squares_are_small(draw_board):
    """A window of half size 11 reaches the neighbours of corners 12 px apart."""
    drawn = draw_board(9, 6, square=12.0, tilt=0.0)
    error = np.linalg.norm(found(drawn, (9, 6)) - drawn.corners, axis=1)
    start = np.array(drawn.corners, dtype=np.float32, order="C").reshape(-1, 1, 2)
    wide = cv2.cornerSubPix(drawn.grey, start, (11, 11), (-1, -1), (3, 100, 1e-4)).reshape(-1, 2)
    assert np.sqrt((error**2).mean()) < 0.1
    assert np.sqrt((error**2).mean()) < np.linalg.norm(wide - drawn.corners, axis=1).max() / 5
