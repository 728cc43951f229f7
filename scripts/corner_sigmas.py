"""Which corner finder and which refinement window give standard deviations that hold?

    python scripts/corner_sigmas.py [FOLDER_OF_RENDERED_CHESSBOARDS] [--worlds 2]

Each way of finding corners calibrates the same pictures with OpenCV's `calibrateCameraExtended` (k1, k2
only). Its parameters are compared with the truth in units of the standard deviations that the same call
states: z. If the stated sigmas hold, the root mean square of z is about 1 whatever the noise; far above 1
means errors that do not average out, however small the residuals. Pictures: chessboards drawn here
(supersampled, lens, blur, shading, gamma, noise, JPEG), several worlds of each kind; and, if a folder is
given, rendered chessboards with their ground_truth.json. The choice of `jaxmocap.vision.chessboard` (finder,
WINDOW_FRACTION, MIN_HALF_WINDOW) rests on this table.
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
from jaxmocap.vision.board_grid import orient_by_colour
from jaxmocap.vision.photos import read_photo

COLUMNS, ROWS = BOARD = (9, 6)
Finder = Callable[[NDArray], NDArray | None]


@dataclass(frozen=True)
class Kind:
    """A kind of drawn photo: distance in board widths, blur in pixels, noise in grey levels, lens, tilt in degrees.

    A sheared one is tilted about a diagonal of its squares, so that its grid lines meet at a small angle.
    """

    name: str
    distance: tuple[float, float]
    blur: float
    noise: float
    k1: float
    k2: float
    tilt: tuple[float, float] = (5.0, 50.0)
    sheared: bool = False


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
    # 2 arctan(cos tilt): grid lines meet at 50 to 30 degrees
    Kind("sheared", (1.5, 2.2), blur=0.7, noise=3.0, k1=-0.12, k2=0.03, tilt=(62.0, 74.0), sheared=True),
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
    points = board_points(1.0)
    photos, corners = [], []
    while len(photos) < VIEWS:
        rvec, tvec = random_pose(rng, kind)
        seen = cv2.projectPoints(points, rvec, tvec, camera_matrix(truth), lens(truth))[0].reshape(-1, 2)
        if (seen < 25).any() or (seen > np.array(SIZE) - 26).any():
            continue
        photos.append(draw_photo(kind, rvec, tvec, undistorted, rng))
        corners.append(seen)
    return World(photos, np.array(corners), 1.0, truth)


def random_pose(rng: np.random.Generator, kind: Kind) -> tuple[NDArray, NDArray]:
    """Board centre somewhere in view, tilted about a random axis in the picture plane."""
    azimuth, tilt, roll = rng.uniform(0, 2 * np.pi), np.deg2rad(rng.uniform(*kind.tilt)), rng.normal(0, 0.3)
    if kind.sheared:
        roll = azimuth + rng.choice([-1, 1]) * np.pi / 4 + rng.normal(0, 0.1)
    tilted, _ = cv2.Rodrigues(np.array([np.cos(azimuth), np.sin(azimuth), 0]) * tilt)
    rotation = tilted @ cv2.Rodrigues(np.array([0, 0, roll]))[0]
    z = rng.uniform(*kind.distance) * COLUMNS
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
    """One photo, uint8: pattern, shading, blur, pixel integration, gamma, noise, JPEG quality 92."""
    linear = 0.75 * shading(rays[::SUPERSAMPLING, ::SUPERSAMPLING])
    u0, v0, u1, v1 = surroundings(rvec, tvec, rays)
    s = SUPERSAMPLING
    fine = pattern(rvec, tvec, rays[v0 * s : v1 * s, u0 * s : u1 * s])
    blurred = cv2.GaussianBlur(fine, (0, 0), kind.blur * s)
    linear[v0:v1, u0:u1] = cv2.resize(blurred, (u1 - u0, v1 - v0), interpolation=cv2.INTER_AREA)
    grey = 255 * np.clip(linear, 0, 1) ** (1 / 2.2) + rng.normal(0, kind.noise, linear.shape)
    levels = np.clip(np.rint(grey), 0, 255).astype(np.uint8)
    coded = cv2.imencode(".jpg", levels, [cv2.IMWRITE_JPEG_QUALITY, 92])[1]
    return cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE)


def surroundings(rvec: NDArray, tvec: NDArray, rays: NDArray) -> tuple[int, int, int, int]:
    """Pixels u0, v0, u1, v1 that hold the board's dark squares and room for the blur."""
    s = SUPERSAMPLING
    p, q = board_coordinates(rvec, tvec, rays[::s, ::s])
    inside = (p > -1.5) & (p < COLUMNS + 0.5) & (q > -1.5) & (q < ROWS + 0.5)
    v, u = np.nonzero(inside)
    return max(u.min() - 8, 0), max(v.min() - 8, 0), min(u.max() + 9, SIZE[0]), min(v.max() + 9, SIZE[1])


def board_coordinates(rvec: NDArray, tvec: NDArray, rays: NDArray) -> tuple[NDArray, NDArray]:
    """Where rays meet the board, in squares from the first inner corner."""
    rotation = cv2.Rodrigues(rvec)[0]
    board_from_ray = np.linalg.inv(np.column_stack([rotation[:, 0], rotation[:, 1], np.ravel(tvec)]))
    x, y = rays[..., 0], rays[..., 1]
    p, q, w = (float(row[0]) * x + float(row[1]) * y + np.float32(row[2]) for row in board_from_ray)
    return p / w, q / w


def pattern(rvec: NDArray, tvec: NDArray, rays: NDArray) -> NDArray:
    """Brightness (linear) of the board on a light wall, shaded."""
    p, q = (np.floor(c) for c in board_coordinates(rvec, tvec, rays))
    dark = ((p + q) % 2 == 0) & (p >= -1) & (p < COLUMNS) & (q >= -1) & (q < ROWS)
    return np.where(dark, np.float32(0.03), np.float32(0.75)) * shading(rays)


def shading(rays: NDArray) -> NDArray:
    """Falls off by a quarter to the corners, and across the picture by a tenth."""
    x, y = rays[..., 0], rays[..., 1]
    return 1 - np.float32(0.25 / 0.3) * (x * x + y * y) + np.float32(0.1) * x


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


def found_by(detector: chessboard.Detector) -> Finder:
    """The library's finder by name."""
    return lambda grey: None if (r := chessboard.find_corners(grey, BOARD, detector)) is None else r.uv


def fixed_window(half: int) -> Finder:
    """Quads refined in one window for all photos."""
    return lambda grey: refined(grey, lambda uv: np.full(len(uv), half))


def relative_window(fraction: float, least: int) -> Finder:
    """Quads refined in a window that follows the spacing as `half_windows` does, with other constants."""

    def windows(uv: NDArray) -> NDArray:
        free = chessboard.distance_to_next_line(uv.reshape(ROWS, COLUMNS, 2))
        half = max(fraction * free, min(least, chessboard.MAX_WINDOW_FRACTION * free), 1)
        return np.full(len(uv), int(half))

    return lambda grey: refined(grey, windows)


def refined(grey: NDArray, windows: Callable[[NDArray], NDArray]) -> NDArray | None:
    """Corners of the quads finder, refined in given windows."""
    uv = chessboard.find_quads(grey, BOARD)
    return None if uv is None else chessboard.refine_corners(grey, uv, windows(uv))


def exhaustive_sectors(grey: NDArray) -> NDArray | None:
    """OpenCV's most careful sector search: the lowest residuals of all."""
    flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    found, uv = cv2.findChessboardCornersSB(grey, BOARD, flags=flags)
    return orient_by_colour(grey, uv.reshape(-1, 2), BOARD) if found else None


WAYS: dict[str, Finder] = {
    "DEFAULT (quads, 0.20 >= 5)": found_by("default"),
    "quads, not refined": lambda grey: chessboard.find_quads(grey, BOARD),
    "quads, 5 px": fixed_window(5),
    "quads, 11 px": fixed_window(11),
    "quads, 0.20": relative_window(0.20, 0),
    "quads, 0.30": relative_window(0.30, 0),
    "quads, 0.50": relative_window(0.50, 0),
    "sectors, exhaustive": exhaustive_sectors,
}


@dataclass(frozen=True)
class Score:
    """How one way did on one world: errors (n, 2) px, rms residual px, z (6,), views found."""

    errors: NDArray
    rms: float
    z: NDArray
    views: int


def score(way: Finder, world: World) -> Score | None:
    """Calibrate one world; None if fewer than 6 views were found."""
    pairs = [(uv, true) for grey, true in zip(world.photos, world.corners) if (uv := way(grey)) is not None]
    if len(pairs) < 6:
        return None
    measured = [uv.astype(np.float32).reshape(-1, 1, 2) for uv, _ in pairs]
    points = [board_points(world.square).astype(np.float32)] * len(pairs)
    size = world.photos[0].shape[::-1]
    flags = cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
    rms, k, d, _, _, stated, *_ = cv2.calibrateCameraExtended(points, measured, size, None, None, flags=flags)
    found = np.array([k[0, 0], k[1, 1], k[0, 2], k[1, 2], d.ravel()[0], d.ravel()[1]])
    errors = np.concatenate([uv - true for uv, true in pairs])
    return Score(errors, rms, (found - world.truth) / stated.ravel()[:6], len(pairs))


def table_row(name: str, kind: str, scores: list[Score]) -> str:
    """One line of the table."""
    errors = np.concatenate([s.errors for s in scores])
    length = np.linalg.norm(errors, axis=1)
    z = np.array([s.z for s in scores])
    bias = "({:+.3f}, {:+.3f})".format(*errors.mean(axis=0))
    views, rms = sum(s.views for s in scores), np.mean([s.rms for s in scores])
    return (
        f"{name:27s} {kind:12s} {views:5d} {rms:7.3f} {np.median(length):7.3f} "
        f"{np.sqrt((length**2).mean()):7.3f} {bias:18s} {np.sqrt((z**2).mean()):5.2f}   "
        + " ".join(f"{v:5.1f}" for v in np.sqrt((z**2).mean(axis=0)))
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, help="rendered chessboards with ground_truth.json")
    parser.add_argument("--worlds", type=int, default=2, help="drawn worlds of each kind")
    arguments = parser.parse_args()
    with ThreadPoolExecutor() as pool:
        worlds = {
            kind.name: list(pool.map(lambda seed, kind=kind: draw_world(kind, seed), range(arguments.worlds)))
            for kind in KINDS
        }
        if arguments.folder:
            worlds["rendered"] = [puppet_world(arguments.folder)]
        print("errors and rms in pixels; z and its root mean square by parameter in stated sigmas")
        print(f"{'way':27s} {'photos':12s} views     rms  median   error bias               z rms      ", end="")
        print("fx    fy    cx    cy    k1    k2")
        for name, way in WAYS.items():
            for kind, members in worlds.items():
                scores = [s for s in pool.map(lambda world, way=way: score(way, world), members) if s]
                print(table_row(name, kind, scores) if scores else f"{name:27s} {kind:12s} not found")


if __name__ == "__main__":
    main()
