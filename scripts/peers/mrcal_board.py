"""One chessboard calibration by mrcal, for the system's Python (mrcal is not on PyPI).

    /usr/bin/python3 mrcal_board.py CORNERS.npz

CORNERS.npz holds corners (views, rows, columns, 2) [px], size (2,) [px] and focal, a first guess [px]. Prints
"solve SECONDS RMS": wall time from corners to result, and the root mean squared length of a residual [px].
"""

import sys
import time

import mrcal
import numpy as np


def main() -> None:
    given = np.load(sys.argv[1])
    corners, size, focal = given["corners"], given["size"], float(given["focal"])
    views = len(corners)
    observations = np.concatenate([corners, np.ones((*corners.shape[:3], 1))], axis=-1)
    indices = np.zeros((views, 3), dtype=np.int32)
    indices[:, 0], indices[:, 2] = np.arange(views), -1
    start = time.perf_counter()
    seed = mrcal.seed_stereographic(
        imagersizes=size[None].astype(np.int32),
        focal_estimate=focal,
        indices_frame_camera=indices[:, :2].copy(),
        observations=observations,
        object_spacing=1.0,
    )
    intrinsics = np.concatenate([seed[0].reshape(1, 4), np.zeros((1, 5))], axis=1)
    stats = mrcal.optimize(
        intrinsics,
        None,
        seed[2],
        None,
        observations,
        indices,
        None,
        None,
        lensmodel="LENSMODEL_OPENCV5",
        imagersizes=size[None].astype(np.int32),
        calibration_object_spacing=1.0,
        do_optimize_calobject_warp=False,
        do_apply_outlier_rejection=False,
        do_apply_regularization=False,
    )
    seconds = time.perf_counter() - start
    x = stats["x"][: 2 * corners[..., 0].size]
    print("solve", seconds, np.sqrt(2.0 * np.mean(x * x)))


if __name__ == "__main__":
    main()
