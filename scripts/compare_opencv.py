"""The same corners calibrated by jaxmocap and by OpenCV, as a table in markdown.

    python scripts/compare_opencv.py DATA

DATA is the folder of photographs. Corners come from OpenCV (findChessboardCorners, cornerSubPix with a half window of
5) for both sides, so that only the calibrations are compared; OpenCV's calibrateCameraExtended runs to convergence.
RMS is the root of the mean squared residual length. The last column is the largest difference of a parameter in
units of the plain sigma (residuals taken as independent) that jaxmocap gives it. For the stereo pair both cameras
and their relative pose are refined together (stereoCalibrate without FIX_INTRINSIC) and compared with the
translation that J.-Y. Bouguet published for it, too.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import cv2
import jax
import jax.numpy as jnp
import numpy as np

from jaxmocap.calibration.boards import (
    TargetViews,
    chessboard_points,
    free_parameters,
    parameter_names,
    refine_targets,
)
from jaxmocap.calibration.start import start_rig
from jaxmocap.cameras import BrownDistortion
from jaxmocap.observations import PixelObservations
from jaxmocap.results import Estimate

SETS = {
    "OpenCV left": ("opencv_stereo_chessboard/left*.jpg", (9, 6), 30.0),
    "OpenCV right": ("opencv_stereo_chessboard/right*.jpg", (9, 6), 30.0),
    "Pose2Sim cam01": ("pose2sim_chessboard_cam01_cam02/cam01/*.jpg", (4, 7), 60.0),
    "Pose2Sim cam02": ("pose2sim_chessboard_cam01_cam02/cam02/*.jpg", (4, 7), 60.0),
    "rendered puppet": ("rendered_puppet/chess*.jpg", (9, 6), 12.0),
}
FLAGS = {
    "none": cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST,
    "k1k2": cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST,
    "k1k2p1p2k3": 0,
}
BOUGUET_T = np.array([-99.80198, 1.12443, 0.05041])
BOUGUET_THREE_SIGMA = np.array([0.142, 0.1135, 0.498])
_TIGHT = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 1000, 1e-15)
_ORDER = ("k1", "k2", "p1", "p2", "k3")


def corners(data: Path, name: str) -> tuple[np.ndarray, tuple[int, int]]:
    """Corners (views, points, 2) that OpenCV finds in a set, and the picture size."""
    pattern, board, _ = SETS[name]
    found = []
    for path in sorted(data.glob(pattern)):
        grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        ok, uv = cv2.findChessboardCorners(grey, board)
        if ok:
            uv = np.ascontiguousarray(uv.reshape(-1, 1, 2), np.float32)
            cv2.cornerSubPix(grey, uv, (5, 5), (-1, -1), (3, 100, 1e-4))
            found.append(uv.reshape(-1, 2))
    return np.array(found, dtype=np.float64), (grey.shape[1], grey.shape[0])


def ours(points: np.ndarray, uv: np.ndarray, size: tuple[int, int], model: str) -> Estimate:
    """Jaxmocap on corners uv (views, cameras, points, 2)."""
    on_board = jnp.asarray(np.tile(points, (len(uv), 1, 1)))
    views = TargetViews(on_board, PixelObservations.of(jnp.asarray(uv)))
    cameras = uv.shape[1]
    start, _ = start_rig(views, [size] * cameras, [f"camera {k}" for k in range(cameras)])
    if model == "none":  # what is not sought keeps its start value
        none = [replace(lens, distortion=BrownDistortion.none()) for lens in start.shared.lenses]
        start = replace(start, shared=replace(start.shared, lenses=tuple(none)))
    return refine_targets(start, views, free_parameters(cameras, model, False))


def lens_numbers(estimate: Estimate, camera: int = 0) -> np.ndarray:
    """Fx fy cx cy k1 k2 p1 p2 k3."""
    lens = estimate.value.shared.lenses[camera]
    K = [getattr(lens.intrinsics, n) for n in ("fx", "fy", "cx", "cy")]
    return np.array([float(x) for x in [*K, *(getattr(lens.distortion, n) for n in _ORDER)]])


def plain_sigmas(estimate: Estimate, model: str) -> np.ndarray:
    """The same order; infinity where a number is not sought."""
    names = parameter_names(free_parameters(1, model, False))
    found = dict(zip([n for _, n in names], np.sqrt(np.diag(estimate.covariance.shared_plain()))))
    return np.array([found.get(n, np.inf) for n in ("fx", "fy", "cx", "cy", *_ORDER)])


def opencv(points: np.ndarray, uv: np.ndarray, size: tuple[int, int], model: str) -> tuple[float, np.ndarray]:
    """RMS and fx fy cx cy k1 k2 p1 p2 k3 of OpenCV."""
    target, seen = [points.astype(np.float32)] * len(uv), [x.astype(np.float32) for x in uv]
    rms, K, k, *_ = cv2.calibrateCameraExtended(target, seen, size, None, None, flags=FLAGS[model], criteria=_TIGHT)
    return rms, np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *k.ravel()[:5]])


def stereo(data: Path) -> dict[str, object]:
    """Both cameras at once: (RMS, T) of either program, with jaxmocap's plain sigma of T."""
    left, size = corners(data, "OpenCV left")
    right, _ = corners(data, "OpenCV right")
    points = chessboard_points(9, 6, 30.0)
    estimate = ours(points, np.stack([left, right], axis=1), size, "k1k2")
    target = [points.astype(np.float32)] * len(left)
    sides, lenses = [[x.astype(np.float32) for x in side] for side in (left, right)], []
    for side in sides:
        _, K, k, *_ = cv2.calibrateCamera(target, side, size, None, None, flags=FLAGS["k1k2"])
        lenses += [K, k]
    rms, *_, T, _, _ = cv2.stereoCalibrate(
        target, *sides, *lenses, size, flags=FLAGS["k1k2"] | cv2.CALIB_USE_INTRINSIC_GUESS, criteria=_TIGHT
    )
    sigma = np.sqrt(np.diag(estimate.covariance.shared_plain()))[-3:]
    return {
        "estimate": estimate,
        "T": np.array(estimate.value.shared.T_camera_rig[0].translation),
        "sigma": sigma,
        "opencv_rms": rms,
        "opencv_T": T.ravel(),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    data = parser.parse_args().data
    jax.config.update("jax_enable_x64", True)
    print("| photos | views | lens | RMS OpenCV | RMS jaxmocap | largest difference / sigma |")
    print("|---|---|---|---|---|---|")
    for name, (_, board, square) in SETS.items():
        uv, size = corners(data, name)
        points = chessboard_points(*board, square)
        for model in FLAGS:
            estimate = ours(points, uv[:, None], size, model)
            rms, numbers = opencv(points, uv, size, model)
            apart = np.abs(lens_numbers(estimate) - numbers) / plain_sigmas(estimate, model)
            print(
                f"| {name} | {len(uv)} | {model} | {rms:.6f} | {float(estimate.stats['rms_px']):.6f} "
                f"| {apart.max():.1e}{'' if estimate.success else ' (' + estimate.sentence + ')'} |",
                flush=True,
            )
    both = stereo(data)
    mm = lambda T: ", ".join(f"{x:.3f}" for x in T)  # noqa: E731
    print("\n| stereo | RMS | T [mm] |\n|---|---|---|")
    print(f"| OpenCV | {both['opencv_rms']:.6f} | {mm(both['opencv_T'])} |")
    print(f"| jaxmocap | {float(both['estimate'].stats['rms_px']):.6f} | {mm(both['T'])} |")
    print(f"| jaxmocap, plain sigma | | {mm(both['sigma'])} |")
    print(f"| Bouguet | | {mm(BOUGUET_T)} +- {mm(BOUGUET_THREE_SIGMA)} |")


if __name__ == "__main__":
    main()
