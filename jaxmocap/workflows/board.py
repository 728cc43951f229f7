"""The chessboard that a user names: its inner corners and the side of its squares."""

from dataclasses import dataclass

import numpy as np

from jaxmocap.calibration.boards import chessboard_points
from jaxmocap.vision.board_grid import check_board
from jaxmocap.workflows.units import parse_length, parse_pair


@dataclass(frozen=True)
class Board:
    """A chessboard with its unit."""

    corners: tuple[int, int]
    """INNER corners, columns and rows."""
    square: float
    """Side of a square [unit]."""
    unit: str
    points: np.ndarray
    """The corners, (columns * rows, 3), row by row, in the board's own frame [unit]."""

    @property
    def spoken(self) -> str:
        """The board in words."""
        length = f"{self.square:g}" if self.unit == "1" else f"{self.square:g} {self.unit}"
        return f"{self.corners[0]}x{self.corners[1]} inner corners, squares of {length}"


def parse_board(board: str | tuple[int, int], square: str | float) -> Board:
    """The board from what --board and --square say.

    Args:
        board: INNER corners, "9x6" or (9, 6): columns x rows.
        square: side of a square with its unit, "30mm"; a bare number has no unit.

    Returns:
        Board.

    Raises:
        InputError: if they are not a board and a length.
    """
    columns, rows = check_board(parse_pair(board, "--board", "9x6"))
    side, unit = parse_length(square, "--square")
    return Board((columns, rows), side, unit, chessboard_points(columns, rows, side))
