"""A large chessboard calibration against OpenCV and mrcal: 200 views of 20x14 corners, nine shared parameters.

    python scripts/bench_chessboard.py [--views 200] [--repeats 7] [--json ROWS]

Everybody gets the same corners and nothing else, on the same two cores, in turns. Ours is the whole warm call, start
values included. All must end at the same root mean squared error, or nothing is reported.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from peers.rows import Row, alternate, arguments, report, timed, use_cores

use_cores()

import cv2  # noqa: E402
import jax  # noqa: E402
import numpy as np  # noqa: E402

from jaxmocap.calibration.boards import (  # noqa: E402
    TargetViews,
    chessboard_points,
    free_parameters,
    refine_targets,
)
from jaxmocap.calibration.start import start_rig  # noqa: E402
from jaxmocap.observations import PixelObservations  # noqa: E402
from jaxmocap.results import Estimate  # noqa: E402

COLUMNS, ROWS = 20, 14
SIZE = (1280, 960)
NOISE = 0.3
MODEL = "k1k2p1p2k3"
SAME_RMS = 1e-6
SYSTEM_PYTHON = "/usr/bin/python3"


def draw_corners(views: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """The board (corners, 3) and its images (views, corners, 2) with noise; every corner in every picture."""
    rng = np.random.default_rng(seed)
    K = np.array([[1100.0, 0, 645.0], [0, 1104.0, 476.0], [0, 0, 1]])
    lens = np.array([-0.2, 0.06, 4e-4, -3e-4, -0.01])
    board = chessboard_points(COLUMNS, ROWS, 1.0)
    found: list[np.ndarray] = []
    while len(found) < views:
        tilt, azimuth, roll = rng.uniform(0.05, 0.7), rng.uniform(0, 2 * np.pi), rng.normal(0, 0.2)
        R = cv2.Rodrigues(np.array([tilt * np.cos(azimuth), tilt * np.sin(azimuth), roll]))[0]
        z = rng.uniform(20.0, 40.0)
        t = np.array([rng.uniform(-0.3, 0.3) * z, rng.uniform(-0.25, 0.25) * z, z]) - R @ board.mean(axis=0)
        uv = cv2.projectPoints(board, cv2.Rodrigues(R)[0], t, K, lens)[0].reshape(-1, 2)
        if (uv > 5).all() and (uv < np.array(SIZE) - 5).all():
            found.append(uv + NOISE * rng.standard_normal(uv.shape))
    return board, np.array(found)


def ours(board: np.ndarray, corners: np.ndarray, covariance: bool = False) -> Estimate:
    """From corners to the result, waited for."""
    points = np.broadcast_to(board, (len(corners), *board.shape))
    views = TargetViews(jax.numpy.asarray(points), PixelObservations.of(corners[:, None]))
    start, _ = start_rig(views, [SIZE], ["cam1"])
    free = free_parameters(1, MODEL, skew=False)
    return jax.block_until_ready(refine_targets(start, views, free, covariance=covariance))


def by_opencv(board: np.ndarray, corners: np.ndarray) -> float:
    """Root mean squared error of cv2.calibrateCamera [px]."""
    points = [board.astype(np.float32)] * len(corners)
    seen = [uv.astype(np.float32)[:, None] for uv in corners]
    return cv2.calibrateCamera(points, seen, SIZE, None, None)[0]


def by_mrcal(path: Path) -> tuple[float, float] | None:
    """(seconds, rms) of mrcal in the system's Python; None where it is not installed."""
    script = Path(__file__).parent / "peers" / "mrcal_board.py"
    try:
        done = subprocess.run([SYSTEM_PYTHON, script, path], capture_output=True, text=True)
    except FileNotFoundError:
        return None
    if done.returncode:
        print(f"mrcal: not measured ({(done.stderr.strip().splitlines() or ['no message'])[-1]})")
        return None
    _, seconds, rms = done.stdout.split()[-3:]
    return float(seconds), float(rms)


def check_same(name: str, rms: float, own: float) -> None:
    """End if a peer found another optimum: times would then mean nothing."""
    if abs(rms - own) > SAME_RMS:
        sys.exit(f"{name} ends at {rms:.9f} px, we at {own:.9f} px: not the same optimum")


def main() -> None:
    """Measure and report."""
    parser = arguments(__doc__)
    parser.add_argument("--views", type=int, default=200)
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    cv2.setNumThreads(2)
    board, corners = draw_corners(options.views)
    # OpenCV takes 32-bit corners; everybody gets those.
    corners = corners.astype(np.float32).astype(float)
    cold, estimate = timed(lambda: ours(board, corners))
    rms = float(estimate.stats["rms_px"])
    check_same("OpenCV", by_opencv(board, corners), rms)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "corners.npz"
        np.savez(path, corners=corners.reshape(-1, ROWS, COLUMNS, 2), size=np.array(SIZE), focal=1000.0)
        first = by_mrcal(path)
        runs = [lambda: timed(lambda: ours(board, corners))[0], lambda: timed(lambda: by_opencv(board, corners))[0]]
        if first is not None:
            check_same("mrcal", first[1], rms)
            runs.append(lambda: (by_mrcal(path) or (float("nan"),))[0])
        medians = alternate(runs, options.repeats)
    ours(board, corners, True)
    covariance = alternate([lambda: timed(lambda: ours(board, corners, True))[0]], options.repeats)[0]
    name = f"chessboard, {options.views} views x {COLUMNS}x{ROWS}"
    note = f"all end at {rms:.6f} px; first call {cold:.1f} s"
    rows = [
        Row(name, medians[0], "cv2.calibrateCamera", medians[1], note=note),
        Row(name, medians[0], "mrcal", medians[2] if first else None),
        Row(f"{name}, with covariance", covariance),
    ]
    report(rows, options.json)


if __name__ == "__main__":
    main()
