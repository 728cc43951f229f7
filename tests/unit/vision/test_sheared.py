"""Boards seen so obliquely that their grid lines meet at a small angle, drawn with known corners."""

import numpy as np
import pytest

from jaxmocap.vision import find_corners
from jaxmocap.vision.board_grid import as_grid
from jaxmocap.vision.chessboard import find_quads, find_sectors
from jaxmocap.vision.sheared import find_stretched, smallest_angle, surroundings

BOARD = (7, 4)


def sheared_board(draw_board, angle, square=24.0, **more):
    return draw_board(*BOARD, square=square, angle=angle, tilt=0.002, size=(360, 200), origin=(60.0, 60.0), **more)


@pytest.mark.parametrize("angle", [45, 38, 32, 27])
@pytest.mark.parametrize("noise", [1.0, 4.0])
def test_sheared_boards_are_found_and_measured_as_well_as_others(draw_board, angle, noise):
    drawn = sheared_board(draw_board, angle, noise=noise)
    result = find_corners(drawn.grey, BOARD)
    assert result is not None
    error = result.uv - drawn.corners
    # Noise of 1 and 4 grey levels moves corners of upright boards of this size by 0.04 and 0.05 px (root mean square).
    assert np.sqrt(np.mean(np.sum(error**2, axis=1))) < 0.1
    assert np.linalg.norm(error, axis=1).max() < 0.3
    assert np.linalg.norm(error.mean(axis=0)) < 0.05


def test_what_the_plain_search_misses_the_stretched_one_finds(draw_board):
    drawn = sheared_board(draw_board, 27)
    assert find_quads(drawn.grey, BOARD) is None and find_sectors(drawn.grey, BOARD) is None
    uv = find_stretched(drawn.grey, lambda grey: find_sectors(grey, BOARD))
    assert uv is not None
    np.testing.assert_allclose(uv, drawn.corners, atol=0.35 * 24)  # within the window that refines them


def test_large_photos_are_searched_small_and_measured_in_full(draw_board):
    drawn = draw_board(*BOARD, square=110.0, angle=30, tilt=0.0, size=(1640, 1000), origin=(250.0, 250.0))
    result = find_corners(drawn.grey, BOARD)
    assert result is not None
    assert np.abs(result.uv - drawn.corners).max() < 0.25


@pytest.mark.parametrize("asked", [(6, 4), (7, 3), (8, 4), (6, 3)])
def test_another_size_is_refused(draw_board, asked):
    assert find_corners(sheared_board(draw_board, 32).grey, asked) is None


def test_hidden_corner_is_refused(draw_board):
    drawn = sheared_board(draw_board, 32)
    u, v = drawn.corners[10].round().astype(int)
    drawn.grey[v - 8 : v + 9, u - 16 : u + 17] = 128
    assert find_corners(drawn.grey, BOARD) is None


def test_angle_of_the_lines_by_hand():
    x, y = np.meshgrid(np.arange(7.0), np.arange(4.0))
    for angle in (20.0, 65.0, 90.0, 130.0):
        c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        grid = np.stack([10 * x + 8 * c * y, 8 * s * y], axis=-1)
        assert np.degrees(smallest_angle(grid)) == pytest.approx(min(angle, 180 - angle), abs=1e-9)


def test_surroundings_make_squares_square(draw_board):
    drawn = draw_board(*BOARD, angle=35.0, tilt=0.01)
    A, square = surroundings(as_grid(drawn.corners, BOARD))
    grid = drawn.corners.reshape(4, 7, 2)
    step = (grid[2, 4] - grid[2, 2]) / 2, (grid[3, 3] - grid[1, 3]) / 2  # central differences at corner (2, 3)
    at = A[2 * 7 + 3] * square
    np.testing.assert_allclose(at[:, 0], step[0], rtol=2e-3)
    np.testing.assert_allclose(at[:, 1], step[1], rtol=2e-3)
