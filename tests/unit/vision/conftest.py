"""Boards drawn sample by sample, so that the true corners are known by construction."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
import pytest

SUPERSAMPLING = 4


@dataclass(frozen=True)
class Drawn:
    grey: np.ndarray  # uint8 (h, w)
    corners: np.ndarray  # (columns * rows, 2), pixels, row by row, first square dark


def tilted_homography(square: float, origin: tuple[float, float], roll: float, tilt: float) -> np.ndarray:
    """Pixels from board squares: rolled by `roll` radians, and foreshortened by `tilt` per square along the rows."""
    c, s = np.cos(roll) * square, np.sin(roll) * square
    return np.array([[c, -s, origin[0]], [s, c, origin[1]], [0, 0, 1]]) @ np.array(
        [[1, 0, 0], [0, 1, 0], [tilt, tilt / 2, 1]]
    )


def draw(
    columns: int,
    rows: int,
    *,
    size: tuple[int, int] = (320, 240),
    square: float = 24.0,
    origin: tuple[float, float] = (60.0, 55.0),
    roll: float = 0.06,
    tilt: float = 0.01,
    noise: float = 1.0,
    angle: float = 90.0,
) -> Drawn:
    """A board of `columns` x `rows` inner corners on a light wall; corner (i, j) is at board point (i, j).

    Its columns are sheared so that they meet the rows at `angle` degrees (before the foreshortening `tilt`).
    """
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    sheared = np.array([[1, c, 0], [0, s, 0], [0, 0, 1]]) if angle != 90.0 else np.eye(3)
    pixels_from_board = tilted_homography(square, origin, roll, tilt) @ sheared
    board_from_pixels = np.linalg.inv(pixels_from_board)
    u = (np.arange(size[0] * SUPERSAMPLING) + 0.5) / SUPERSAMPLING - 0.5
    v = (np.arange(size[1] * SUPERSAMPLING) + 0.5) / SUPERSAMPLING - 0.5
    x, y, w = np.tensordot(board_from_pixels, np.stack([*np.meshgrid(u, v), np.ones((v.size, u.size))]), axes=1)
    p, q = np.floor(x / w), np.floor(y / w)
    dark = ((p + q) % 2 == 0) & (p >= -1) & (p < columns) & (q >= -1) & (q < rows)
    fine = np.where(dark, 40.0, 210.0)
    fine = cv2.GaussianBlur(fine, (0, 0), 0.7 * SUPERSAMPLING)  # pixels: a sharp lens
    coarse = fine.reshape(size[1], SUPERSAMPLING, size[0], SUPERSAMPLING).mean(axis=(1, 3))
    noisy = coarse + np.random.default_rng(0).normal(0, noise, coarse.shape)
    lattice = np.stack([*np.meshgrid(np.arange(columns), np.arange(rows)), np.ones((rows, columns))])
    corners = np.tensordot(pixels_from_board, lattice, axes=1).reshape(3, -1)
    return Drawn(np.clip(np.rint(noisy), 0, 255).astype(np.uint8), (corners[:2] / corners[2]).T)


@pytest.fixture
def draw_board() -> Callable[..., Drawn]:
    return draw
