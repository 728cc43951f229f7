"""What a user waits for: the first calibration of 13 photographs, the second one, and the help.

    python scripts/bench_first_call.py [PHOTOS --board 9x6 --square 25mm] [--runs 3] [--json ROWS]

Every run is a process of its own on two cores. Cold: an empty folder of compiled programs; warm: the folder that a
cold run has filled. Without PHOTOS, 13 photographs are drawn.
"""

from __future__ import annotations

import os
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from peers.rows import Row, arguments, report, timed, use_cores

use_cores()

import cv2  # noqa: E402
import numpy as np  # noqa: E402

COLUMNS, ROWS, SQUARE_MM = 9, 6, 25.0
PHOTOS, SIZE, FOCAL = 13, (1280, 960), 1150.0
_PIXELS_PER_SQUARE = 64
_MARGIN = 2  # white squares around the board


def _pattern() -> np.ndarray:
    """The printed board: (COLUMNS + 1) x (ROWS + 1) squares with a white margin, grey levels."""
    y, x = np.mgrid[0 : ROWS + 1 + 2 * _MARGIN, 0 : COLUMNS + 1 + 2 * _MARGIN]
    inside = (x >= _MARGIN) & (x <= COLUMNS + _MARGIN) & (y >= _MARGIN) & (y <= ROWS + _MARGIN)
    squares = np.where(inside & ((x + y) % 2 == 0), 30, 220).astype(np.uint8)
    return np.kron(squares, np.ones((_PIXELS_PER_SQUARE, _PIXELS_PER_SQUARE), np.uint8))


def _homography(rng: np.random.Generator) -> np.ndarray:
    """Pixels of the pattern -> pixels of a photo with the board somewhere in it, tilted by up to 40 degrees."""
    R = cv2.Rodrigues(np.append(rng.uniform(-0.5, 0.5, 2), rng.uniform(-0.2, 0.2)))[0]
    z = rng.uniform(15.0, 19.0)
    middle = np.array([(COLUMNS + 1) / 2 + _MARGIN, (ROWS + 1) / 2 + _MARGIN, 0.0])
    t = np.array([rng.uniform(-2, 2), rng.uniform(-1.2, 1.2), z]) - R @ middle
    K = np.array([[FOCAL, 0, SIZE[0] / 2], [0, FOCAL, SIZE[1] / 2], [0, 0, 1]])
    scale = np.diag([1.0 / _PIXELS_PER_SQUARE, 1.0 / _PIXELS_PER_SQUARE, 1.0])
    return K @ np.column_stack([R[:, 0], R[:, 1], t]) @ scale


def draw_photos(folder: Path, count: int = PHOTOS) -> None:
    """Photographs of a board by a pinhole camera, drawn at twice their size and reduced."""
    rng = np.random.default_rng(0)
    double = np.diag([2.0, 2.0, 1.0])
    large = (2 * SIZE[0], 2 * SIZE[1])
    for i in range(count):
        photo = cv2.warpPerspective(_pattern(), double @ _homography(rng), large, borderValue=120)
        photo = cv2.GaussianBlur(cv2.resize(photo, SIZE, interpolation=cv2.INTER_AREA), (0, 0), 0.7)
        noisy = photo + rng.normal(0, 2, photo.shape)
        cv2.imwrite(str(folder / f"photo_{i:02d}.png"), np.clip(np.rint(noisy), 0, 255).astype(np.uint8))


def cpu_of_children() -> float:
    """CPU seconds of all processes that have ended so far."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def seconds_of(arguments: list[str], cache: Path, folder: Path) -> tuple[float, float]:
    """Wall and CPU time of one `jaxmocap` process; ends this script if it fails."""
    env = {**os.environ, "JAXMOCAP_CACHE_DIR": str(cache)}
    command = [sys.executable, "-m", "jaxmocap", *arguments]
    before = cpu_of_children()
    seconds, done = timed(lambda: subprocess.run(command, env=env, cwd=folder, capture_output=True, text=True))
    if done.returncode:
        sys.exit(f"jaxmocap {' '.join(arguments)} ended with {done.returncode}:\n{done.stdout}{done.stderr}")
    return seconds, cpu_of_children() - before


def _row(name: str, runs: list[tuple[float, float]], demand: str) -> Row:
    """Median wall time; the CPU time beside it says what an idle machine would have to do."""
    wall, cpu = (statistics.median(column) for column in zip(*runs))
    return Row(name, wall, note=f"to be < {demand}; CPU {cpu:.1f} s; load {os.getloadavg()[0]:.1f}")


def measure(photos: Path, board: str, square: str, runs: int, folder: Path) -> list[Row]:
    """Cold, warm and help, medians."""
    calibrate = ["calibrate", "chessboard", str(photos), "--board", board, "--square", square, "-o", "rig.toml"]
    cold, warm, words = [], [], []
    for k in range(runs):
        cache = folder / f"cache{k}"
        cold.append(seconds_of([*calibrate, "--force"], cache, folder))
        warm.append(seconds_of([*calibrate, "--force"], cache, folder))
        words.append(seconds_of(["--help"], cache, folder))
    return [
        _row("jaxmocap calibrate chessboard, 13 photographs, cold", cold, "15 s"),
        _row("the same, compiled programs kept", warm, "6 s"),
        _row("jaxmocap --help", words, "0.5 s"),
    ]


def main() -> None:
    """Measure and report."""
    parser = arguments(__doc__)
    parser.add_argument("photos", type=Path, nargs="?", help="folder of photographs")
    parser.add_argument("--board", default=f"{COLUMNS}x{ROWS}", help="inner corners")
    parser.add_argument("--square", default=f"{SQUARE_MM:g}mm", help="side of a square")
    parser.add_argument("--runs", type=int, default=3, help="processes of each kind of which the median is taken")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        photos = options.photos.resolve() if options.photos else folder / "photos"
        if not options.photos:
            photos.mkdir()
            draw_photos(photos)
        report(measure(photos, options.board, options.square, options.runs, folder), options.json)


if __name__ == "__main__":
    main()
