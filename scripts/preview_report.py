"""A report of photos calibrated by OpenCV: preview_report.py OUT.html COLUMNSxROWS SQUARE_MM PHOTO..."""

import sys
from pathlib import Path

import cv2
import numpy as np

from jaxmocap.calibration.evidence import CameraEvidence, board_attitude, real_radius_px
from jaxmocap.calibration.weakness import find_weaknesses
from jaxmocap.report import CalibrationReport, CameraReport, ParameterRow, ViewReport, calibration_html, summary_text


def main(out: str, board: str, square: str, photos: list[str]) -> None:
    cols, rows = (int(n) for n in board.split("x"))
    target = np.zeros((cols * rows, 3), np.float32)
    target[:, :2] = np.stack(np.meshgrid(np.arange(cols), np.arange(rows)), -1).reshape(-1, 2) * float(square)
    found, skipped = [], []
    for photo in photos:
        grey = cv2.imread(photo, 0)
        ok, uv = cv2.findChessboardCorners(grey, (cols, rows))
        if not ok:
            skipped.append((Path(photo).name, "no board found"))
            continue
        uv = cv2.cornerSubPix(grey, uv, (5, 5), (-1, -1), (3, 50, 1e-4))
        found.append((Path(photo).name, grey, uv.reshape(-1, 2)))
    size = found[0][1].shape[::-1]
    flags = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3
    rms, K, d, rv, tv, si, _, _ = cv2.calibrateCameraExtended(
        [target] * len(found), [f[2].reshape(-1, 1, 2).astype(np.float32) for f in found], size, None, None, flags=flags
    )
    d, si = d.ravel(), si.ravel()
    sigma = dict(zip(("fx", "fy", "cx", "cy", "k1", "k2"), si))
    corners = np.array([0, cols - 1, cols * rows - 1, cols * (rows - 1)])
    views = []
    for (name, grey, uv), r, t in zip(found, rv, tv):
        R = cv2.Rodrigues(r)[0]
        p = cv2.projectPoints(target, r, t, K, d)[0].reshape(-1, 2)
        tilt, direction, depth = board_attitude(R, R @ target.mean(0) + t.ravel())
        e = uv - p
        views.append(ViewReport(name, 0, uv, e, float(np.sqrt((e**2).sum(1).mean())), tilt, direction, depth, grey,
                                uv[corners]))
    value = dict(fx=K[0, 0], fy=K[1, 1], cx=K[0, 2], cy=K[1, 2], k1=d[0], k2=d[1])
    rows_ = [ParameterRow(n, float(v), float(sigma[n]), "1" if n[0] == "k" else "px", sigma_plain=float(sigma[n]) * 0.8) for n, v in value.items()]
    rows_.append(ParameterRow("k3", 0.0, None, "1", frozen=True))
    rng = np.random.default_rng(0)
    corr = np.corrcoef(rng.normal(size=(6, 9)))
    roots = np.roots([7 * d[4], 5 * d[1], 3 * d[0], 1.0])
    real = roots[(abs(roots.imag) < 1e-9) & (roots.real > 0)].real
    fold = float(real_radius_px(K, d, np.sqrt(real.min()))) if len(real) else None
    camera = CameraReport("camera", size, tuple(rows_), K, d, rms, corr, tuple(value), fold)
    warnings = find_weaknesses(CameraEvidence(size, K, d, views, rms, sigma, valid_radius_px=fold, square=float(square), unit="mm"))
    report = CalibrationReport("Calibration of " + Path(photos[0]).parent.name, "jaxmocap calibrate chessboard ...", rms, (camera,),
                               tuple(views), sum(len(v.uv) for v in views), "mm", f"{board} inner corners, squares of {square} mm",
                               skipped=tuple(skipped), warnings=warnings, provenance={"jaxmocap": "0.1.0"}, iterations=(10.0, 1.0))
    Path(out).write_text(calibration_html(report))
    print(summary_text(report))


main(sys.argv[1], sys.argv[2], sys.argv[3], sys.argv[4:])
