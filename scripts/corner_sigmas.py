"""Which corner finder and which refinement window give standard deviations that hold?

    python scripts/corner_sigmas.py [PUPPET_FOLDER] [--worlds 4]

Each way of finding corners calibrates the same pictures with OpenCV's `calibrateCameraExtended` (k1, k2 only). Its
parameters are compared with the truth in units of the standard deviations that the same call states: z. If the stated
sigmas hold, the root mean square of z is about 1 whatever the noise; far above 1 means errors that do not average
out, however small the residuals. Pictures: chessboards drawn here (supersampled, lens, blur, shading, gamma, noise,
JPEG), several worlds of each kind; and, if a folder is given, the rendered chessboards with their ground_truth.json.
The choice of `jaxmocap.vision.chessboard` (finder, WINDOW_FRACTION) rests on this table.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from jaxmocap.vision import chessboard
from jaxmocap.vision.photos import read_photo

COLUMNS, ROWS = BOARD = (9, 6)
Finder = Callable[[NDArray], NDArray | None]


@dataclass(frozen=True)
class Kind:
    """What one kind of drawn photo looks like: distance in board widths, blur and noise in pixels and grey levels."""

    name: str
    distance: tuple[float, float]
    blur: float
    noise: float
    k1: float
    k2: float


@dataclass(frozen=True)
class World:
    """Photos of one camera with the true corners (views, corners, 2) and parameters fx fy cx cy k1 k2."""

    photos: list[NDArray]
    corners: NDArray
    square: float
    truth: NDArray


KINDS = (
    Kind("near sharp", (1.5, 2.2), blur=0.5, noise=2.0, k1=-0.12, k2=0.03),
    Kind("far", (3.0, 4.5), blur=0.7, noise=3.0, k1=-0.12, k2=0.03),
    Kind("soft noisy", (1.7, 2.6), blur=1.5, noise=6.0, k1=-0.12, k2=0.03),
    Kind("strong lens", (1.3, 2.0), blur=0.8, noise=2.0, k1=-0.30, k2=0.10),
)
SIZE = (640, 480)
VIEWS = 16
SUPERSAMPLING = 4


def board_points(square: float) -> NDArray:
    points = np.zeros((COLUMNS * ROWS, 3))
    points[:, :2] = np.stack(np.meshgrid(np.arange(COLUMNS), np.arange(ROWS)), -1).reshape(-1, 2) * square
    return points


def draw_world(kind: Kind, seed: int) -> World:
    """Photos of a board in random poses within the picture."""
    rng = np.random.default_rng(seed)
    fx = rng.uniform(650, 850)
    truth = np.array([fx, fx * 1.002, 319.5 + rng.normal(0, 8), 239.5 + rng.normal(0, 8), kind.k1, kind.k2])
    undistorted = normalised_rays(truth)
    photos, corners = [], []
    while len(photos) < VIEWS:
        rvec, tvec = random_pose(rng, kind.distance)
        seen = cv2.projectPoints(board_points(1.0), rvec, tvec, camera_matrix(truth), lens(truth))[0].reshape(-1, 2)
        if (seen < 25).any() or (seen > np.array(SIZE) - 26).any():
            continue
        photos.append(draw_photo(kind, rvec, tvec, undistorted, rng))
        corners.append(seen)
    return World(photos, np.array(corners), 1.0, truth)


def random_pose(rng: np.random.Generator, distance: tuple[float, float]) -> tuple[NDArray, NDArray]:
    """Board centre somewhere in view, tilted by up to 50 degrees about a random axis in the picture plane."""
    azimuth, tilt, roll = rng.uniform(0, 2 * np.pi), np.deg2rad(rng.uniform(5, 50)), rng.normal(0, 0.3)
    tilted, _ = cv2.Rodrigues(np.array([np.cos(azimuth), np.sin(azimuth), 0]) * tilt)
    rotation = tilted @ cv2.Rodrigues(np.array([0, 0, roll]))[0]
    z = rng.uniform(*distance) * COLUMNS
    centre = np.array([rng.uniform(-0.35, 0.35) * z, rng.uniform(-0.25, 0.25) * z, z])
    middle = np.array([(COLUMNS - 1) / 2, (ROWS - 1) / 2, 0])
    return cv2.Rodrigues(rotation)[0], centre - rotation @ middle


def camera_matrix(p: NDArray) -> NDArray:
    return np.array([[p[0], 0, p[2]], [0, p[1], p[3]], [0, 0, 1]])


def lens(p: NDArray) -> NDArray:
    return np.array([p[4], p[5], 0.0, 0.0, 0.0])


def normalised_rays(truth: NDArray) -> NDArray:
    """Undistorted x, y of every supersample, (height * s, width * s, 2), by fixed-point iteration."""
    s = SUPERSAMPLING
    u = (np.arange(SIZE[0] * s) + 0.5) / s - 0.5
    v = (np.arange(SIZE[1] * s) + 0.5) / s - 0.5
    distorted = np.stack(np.meshgrid((u - truth[2]) / truth[0], (v - truth[3]) / truth[1]), -1).astype(np.float32)
    rays = distorted.copy()
    for _ in range(12):
        r2 = (rays**2).sum(-1, keepdims=True)
        rays = distorted / (1 + truth[4] * r2 + truth[5] * r2**2)
    return rays


def draw_photo(kind: Kind, rvec: NDArray, tvec: NDArray, rays: NDArray, rng: np.random.Generator) -> NDArray:
    """One photo, uint8: pattern, shading, blur, pixel integration, sRGB-like coding, noise, JPEG quality 92."""
    rotation = cv2.Rodrigues(rvec)[0]
    board_from_ray = np.linalg.inv(np.column_stack([rotation[:, 0], rotation[:, 1], np.ravel(tvec)])).astype(np.float32)
    x, y = rays[..., 0], rays[..., 1]
    p, q, w = (row[0] * x + row[1] * y + row[2] for row in board_from_ray)
    p, q = np.floor(p / w), np.floor(q / w)
    dark = ((p + q) % 2 == 0) & (p >= -1) & (p < COLUMNS) & (q >= -1) & (q < ROWS)
    linear = np.where(dark, np.float32(0.03), np.float32(0.75))
    linear *= 1 - np.float32(0.25) * (x * x + y * y) / np.float32(0.3) + np.float32(0.1) * x
    sigma = kind.blur * SUPERSAMPLING
    blurred = cv2.GaussianBlur(linear, (0, 0), sigma)
    pixels = cv2.resize(blurred, SIZE, interpolation=cv2.INTER_AREA)
    grey = 255 * np.clip(pixels, 0, 1) ** (1 / 2.2) + rng.normal(0, kind.noise, pixels.shape)
    coded = cv2.imencode(".jpg", np.clip(np.rint(grey), 0, 255).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 92])[1]
    return cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE)


def puppet_world(folder: Path) -> World:
    """The rendered chessboards of one folder with ground_truth.json."""
    truth = json.loads((folder / "ground_truth.json").read_text())
    camera, views = truth["camera"], truth["chessboard"]["photos"]
    return World(
        photos=[read_photo(folder / view["file"]).grey for view in views],
        corners=np.array([view["corners_px"] for view in views]).reshape(len(views), -1, 2),
        square=12.0,
        truth=np.array([camera[key] for key in ("fx", "fy", "cx", "cy", "k1", "k2")]),
    )
