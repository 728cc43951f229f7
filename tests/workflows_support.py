"""Truth, drawing and reading shared by the end-to-end tests; boards are drawn by OpenCV and numpy alone."""

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import numpy as np

K_TRUE = np.array([[610.0, 0.0, 322.0], [0.0, 612.0, 236.0], [0.0, 0.0, 1.0]])
D_TRUE = np.array([-0.18, 0.05, 0.0, 0.0, 0.0])
SIZE = (640, 480)


@dataclass(frozen=True)
class Outcome:
    status: int
    out: str
    err: str

    @property
    def text(self) -> str:
        return self.out + self.err


def read_json(path: Path) -> dict:
    text = path.read_text(encoding="utf-8")
    assert "NaN" not in text and "Infinity" not in text
    return json.loads(text)


def board_poses(count: int, seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """rvec, tvec of a 7x5 board of 20 mm squares, tilted in all directions and spread over the image."""
    rng = np.random.default_rng(seed)
    poses = []
    for i in range(count):
        about = 2 * np.pi * i / count
        rvec = np.radians(33) * np.array([np.cos(about), np.sin(about), 0.0]) + rng.normal(0, 0.05, 3)
        centre = np.array([60 * np.cos(2.4 * i), 40 * np.sin(2.4 * i), 330 + 60 * np.sin(1.7 * i)])
        R = cv2.Rodrigues(rvec)[0]
        poses.append((rvec, centre - R @ np.array([60.0, 40.0, 0.0])))
    return poses


@cache
def _ray_grid(s: int) -> np.ndarray:
    """Ideal normalised coordinates of s x s places in every pixel."""
    v, u = np.mgrid[0 : SIZE[1] * s, 0 : SIZE[0] * s]
    pixels = np.stack([(u + 0.5) / s - 0.5, (v + 0.5) / s - 0.5], axis=-1).reshape(-1, 1, 2).astype(np.float64)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-9)
    return cv2.undistortPoints(pixels, K_TRUE, D_TRUE, criteria=criteria).reshape(-1, 2)


def draw_board(rvec: np.ndarray, tvec: np.ndarray, seed: int = 0) -> np.ndarray:
    """Photograph of the board by inverse mapping: each of 3x3 rays per pixel is intersected with its plane."""
    w, h = SIZE
    s = 3
    xy = _ray_grid(s)
    R = cv2.Rodrigues(rvec)[0]
    rays = np.concatenate([xy, np.ones((len(xy), 1))], axis=1) @ R
    start = -R.T @ tvec
    hit = start[:2] - rays[:, :2] * (start[2] / rays[:, 2:])
    square = np.floor(hit / 20.0).astype(int)
    inside = (square >= -1).all(axis=1) & (square[:, 0] < 7) & (square[:, 1] < 5)
    dark = inside & ((square.sum(axis=1) % 2) == 0)
    paper = (np.abs(hit - np.array([60.0, 40.0])) < np.array([95.0, 75.0])).all(axis=1)
    light = np.where(dark, 0.1, np.where(paper, 0.85, 0.4)).reshape(h, s, w, s).mean(axis=(1, 3))
    noisy = cv2.GaussianBlur(light, (0, 0), 0.6) * 255 + np.random.default_rng(seed).normal(0, 1.5, (h, w))
    return np.clip(noisy, 0, 255).astype(np.uint8)
