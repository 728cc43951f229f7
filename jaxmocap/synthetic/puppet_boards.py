"""Drawn photos of a chessboard: before the camera, and standing on the turntable."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap.synthetic.puppet_camera import PuppetCamera, pixels, ray_grid
from jaxmocap.synthetic.puppet_render import Look

Array = np.ndarray

_WHITE, _BLACK, _BACK = 0.78, 0.035, 0.3  # light 0..1 of a board that faces the lamp


@dataclass(frozen=True)
class Board:
    """Origin at the first inner corner, x along the columns, y along the rows, z into the board."""

    columns: int = 9
    rows: int = 6
    square: float = 12.0
    """[mm]."""
    border: float = 12.0
    """White margin beyond the outer squares [mm]."""

    def corners(self) -> Array:
        """(columns * rows, 3) inner corners, row by row."""
        v, u = np.mgrid[: self.rows, : self.columns]
        return np.stack([u.ravel(), v.ravel(), np.zeros(u.size)], axis=1) * self.square

    def rim(self) -> Array:
        """(4, 3) corners of the board itself."""
        low = -self.square - self.border
        high = np.array([self.columns, self.rows]) * self.square + self.border
        return np.array([[low, low, 0], [high[0], low, 0], [high[0], high[1], 0], [low, high[1], 0]])


def draw_board(light: Array, camera: PuppetCamera, T_camera_board: Array, board: Board, look: Look) -> None:
    """Draw a board over a picture of light (height, width, 3), in place; its back is plain grey.

    The light is set so that the whites of the board's middle are bright, as one would for a photo of it.
    """
    n = look.supersampling
    R, t = T_camera_board[:3, :3], T_camera_board[:3, 3]
    rim = pixels(camera, board.rim() @ R.T + t)
    size = [camera.width, camera.height]
    u0, v0 = np.floor(rim.min(axis=0) - 6.0).clip(0, size).astype(int)
    u1, v1 = np.ceil(rim.max(axis=0) + 7.0).clip(0, size).astype(int)
    x, y = (g[v0 * n : v1 * n, u0 * n : u1 * n] for g in ray_grid(camera, n))
    board_from_ray = np.linalg.inv(np.column_stack([R[:, 0], R[:, 1], t])).astype(np.float32)
    p, q, w = (row[0] * x + row[1] * y + row[2] for row in board_from_ray)
    p, q = p / w, q / w
    (low, _, _), (high_x, high_y, _) = board.rim()[0], board.rim()[2]
    on_board = (p > low) & (p < high_x) & (q > low) & (q < high_y) & (w > 0)
    front = R[:, 2] @ t > 0
    value = _pattern(p / board.square, q / board.square, board) if front else np.full(p.shape, _BACK)
    shaded = np.where(on_board, value * _falloff(x, y, w, R, t, board, look), 0.0).astype(np.float32)
    rows, cover = (sum(a[k::n] for k in range(n)) for a in (shaded, on_board.astype(np.float32)))
    bright, cover = (sum(a[:, k::n] for k in range(n)) / (n * n) for a in (rows, cover))  # pyright: ignore[reportIndexIssue]
    box = light[v0:v1, u0:u1]
    box *= 1.0 - cover[..., None]  # pyright: ignore[reportIndexIssue]
    box += bright[..., None]  # pyright: ignore[reportIndexIssue]


def _pattern(p: Array, q: Array, board: Board) -> Array:
    """White and black at coordinates in squares, edges softened by the width of a sub-pixel.

    Without that, corners found in pictures of 2x2 sub-pixels are 0.12 px off (median), with it 0.05 px.
    """
    signs, inside = [], []
    for f, size in ((p, board.columns), (q, board.rows)):
        step = np.hypot(*np.gradient(f))  # squares per sub-pixel
        line = np.rint(f)
        signs.append((1.0 - 2.0 * (line % 2)) * np.clip(2.0 * (f - line) / step, -1.0, 1.0))
        inside.append(np.clip(np.minimum(f + 1.0, size - f) / step + 0.5, 0.0, 1.0))
    dark = inside[0] * inside[1] * (1.0 + signs[0] * signs[1]) / 2.0
    return _WHITE + (_BLACK - _WHITE) * dark


def _falloff(x: Array, y: Array, w: Array, R: Array, t: Array, board: Board, look: Look) -> Array:
    """Light that falls on the board's points, 1 where it would face the lamp at its middle's distance."""
    rays = np.stack([x, y, np.ones_like(x)]) / np.where(w > 0, w, 1.0)
    to_lamp = np.asarray(look.lamp, dtype=np.float32)[:, None, None] - rays
    far = np.sqrt((to_lamp * to_lamp).sum(axis=0))
    cosine = np.abs(np.tensordot(R[:, 2].astype(np.float32), to_lamp, 1)) / far
    middle = R @ board.corners().mean(axis=0) + t
    return cosine * np.float32(middle @ middle) / (far * far)


def random_board_pose(rng: np.random.Generator, camera: PuppetCamera, board: Board) -> Array:
    """T_camera_board (4, 4) of a board held anyhow, every inner corner at least 8 px inside the picture."""
    middle = board.corners().mean(axis=0)
    size = np.array([camera.width, camera.height])
    while True:
        about = rng.uniform(0.0, 2.0 * np.pi)
        lean = rng.uniform(0.1, 0.75) * np.array([np.cos(about), np.sin(about), 0.0])
        roll = rng.choice([0.0, np.pi / 2, -np.pi / 2, np.pi]) + rng.normal(0.0, 0.15)
        R = (Rotation.from_rotvec(lean) * Rotation.from_rotvec([0.0, 0.0, roll])).as_matrix()
        depth = rng.uniform(190.0, 360.0)
        uv = rng.uniform(0.2, 0.8, 2) * size
        where = depth * np.array([(uv[0] - camera.cx) / camera.fx, (uv[1] - camera.cy) / camera.fy, 1.0])
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R, where - R @ middle
        seen = pixels(camera, board.corners() @ R.T + T[:3, 3])
        if (seen > 8.0).all() and (seen < size - 9.0).all():
            return T


def standing_board(board: Board, lean: float = 0.2094, yaw: float = 0.0, shift: float = 0.0) -> Array:
    """T_world_board (4, 4) of a board that stands on the platform near the axis.

    Args:
        board: the board.
        lean: by which it leans backwards [rad].
        yaw: by which it is turned from facing the camera at angle 0 [rad].
        shift: of its middle along the world's x [mm].

    Returns:
        The pose; the board's lower edge lies on y = 0 of the world.
    """
    R = (Rotation.from_rotvec([0.0, yaw, 0.0]) * Rotation.from_rotvec([np.pi + lean, 0.0, 0.0])).as_matrix()
    middle = R @ board.corners().mean(axis=0)
    lowest = (board.rim() @ R.T)[:, 1].min()
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = [shift - middle[0], -lowest, -middle[2]]
    return T


def board_truth(camera: PuppetCamera, T_camera_board: Array, board: Board) -> dict:
    """`board_to_camera`, `corners_px`, and how the pattern faces the camera."""
    R, t = T_camera_board[:3, :3], T_camera_board[:3, 3]
    corners = board.corners() @ R.T + t
    middle = corners.mean(axis=0)
    cosine = float(R[:, 2] @ middle / np.linalg.norm(middle))
    return {
        "board_to_camera": T_camera_board.tolist(),
        "corners_px": np.round(pixels(camera, corners), 6).tolist(),
        "pattern_towards_camera": cosine > 0,
        "cos_incidence": round(cosine, 6),
    }
