"""Calibration of simulated corners by OpenCV and by the package: one optimum, one set of sigmas."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.calibration.boards import free_parameters, refine_targets
from jaxmocap.calibration.start import start_rig
from jaxmocap.geometry import Pose
from jaxmocap.synthetic.chessboards import add_noise, chessboard_world, lens_of_numbers

SIZE, BOARD = (640, 480), (6, 5)
TIGHT = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 1000, 1e-15)
FLAGS = cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST


@pytest.fixture(scope="module")
def stereo():
    lenses = [
        lens_of_numbers(700.0, 690.0, 320.0, 230.0, (-0.2, 0.05)),
        lens_of_numbers(650.0, 655.0, 310.0, 250.0, (-0.1, 0.02)),
    ]
    T = Pose(jnp.asarray([0.02, -0.1, 0.01]), jnp.asarray([-80.0, 3.0, 8.0]))
    world = chessboard_world(8, lenses, [SIZE, SIZE], T_camera_rig=[T], board=BOARD, fill=(0.25, 0.45), seed=5)
    noisy = add_noise(world.views, 0.3, jax.random.key(0))
    whole = np.asarray(noisy.seen.visible).all(axis=(1, 2))  # stereoCalibrate wants all points in both pictures
    return jax.tree.map(lambda x: x[np.flatnonzero(whole)], noisy)


def _lists(views, camera):
    points = [np.array(p, np.float32) for p in views.points]
    return points, [np.array(uv, np.float32) for uv in views.seen.uv[:, camera]]


def test_one_camera(stereo):
    """float32 is all that OpenCV takes, so its input is what both sides get."""
    points, uv = _lists(stereo, 0)
    one = jax.tree.map(lambda x: x, stereo)
    for name in ("uv", "visible", "sigma"):
        object.__setattr__(one.seen, name, getattr(stereo.seen, name)[:, :1])
    object.__setattr__(one.seen, "uv", jnp.asarray(np.array(uv, np.float64)[:, None]))
    start, _ = start_rig(one, [SIZE], ["camera"])
    estimate = refine_targets(start, one, free_parameters(1, "k1k2", False))
    rms, K, k, _, _, sigmas, *_ = cv2.calibrateCameraExtended(points, uv, SIZE, None, None, flags=FLAGS, criteria=TIGHT)
    lens = estimate.value.shared.lenses[0]
    inner = [float(getattr(lens.intrinsics, n)) for n in ("fx", "fy", "cx", "cy")]
    found = np.array([*inner, float(lens.distortion.k1), float(lens.distortion.k2)])
    theirs = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], k.ravel()[0], k.ravel()[1]])
    plain = np.sqrt(np.diag(estimate.covariance.shared_plain()))
    assert np.abs((found - theirs) / plain).max() < 1e-3
    np.testing.assert_allclose(float(estimate.stats["rms_px"]), rms, rtol=1e-7)
    # OpenCV divides by the number of residuals less parameters, too; its sigmas are for independent corners.
    np.testing.assert_allclose(plain, sigmas.ravel()[:6], rtol=0.05)


def test_stereo(stereo):
    points, left = _lists(stereo, 0)
    _, right = _lists(stereo, 1)
    start, _ = start_rig(stereo, [SIZE, SIZE], ["left", "right"])
    estimate = refine_targets(start, stereo, free_parameters(2, "k1k2", False))
    assert estimate.success
    lenses = []
    for side in (left, right):
        _, K, k, *_ = cv2.calibrateCamera(points, side, SIZE, None, None, flags=FLAGS, criteria=TIGHT)
        lenses += [K, k]
    rms, K1, _, K2, _, R, T, *_ = cv2.stereoCalibrate(
        points, left, right, *lenses, SIZE, flags=FLAGS | cv2.CALIB_USE_INTRINSIC_GUESS, criteria=TIGHT
    )
    sigma = np.sqrt(np.diag(estimate.covariance.shared_plain()))
    np.testing.assert_allclose(float(estimate.stats["rms_px"]), rms, atol=1e-4)
    found = estimate.value.shared
    pose = found.T_camera_rig[0]
    assert np.abs((np.array(pose.rotvec) - cv2.Rodrigues(R)[0].ravel()) / sigma[-6:-3]).max() < 0.1
    assert np.abs((np.array(pose.translation) - T.ravel()) / sigma[-3:]).max() < 0.1
    for lens, K, at in zip(found.lenses, (K1, K2), (0, 6)):
        assert (
            np.abs((np.array(lens.intrinsics.matrix()) - K)[[0, 1, 0, 1], [0, 1, 2, 2]] / sigma[at : at + 4]).max()
            < 0.1
        )
