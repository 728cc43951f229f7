"""Where a target's frame has its origin, and how thick the target is, must not matter."""

import cv2
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxmocap.calibration.boards import TargetViews, chessboard_points, free_parameters, refine_targets
from jaxmocap.calibration.centring import centred, moved_back
from jaxmocap.calibration.start import start_rig
from jaxmocap.observations import PixelObservations
from jaxmocap.workflows.target_solve import make_views, solve_targets

SIZE, FLAT = (640, 480), chessboard_points(7, 5, 20.0)
SOLID = FLAT + np.random.default_rng(2).uniform(-40, 40, FLAT.shape)
K, D = np.array([[610.0, 0, 322.0], [0, 612.0, 236.0], [0, 0, 1.0]]), np.array([-0.18, 0.05, 0, 0, 0])
POSES = [
    ([0.5, 0.1, 0.1], [15.0, -10.0, 340.0]),
    ([-0.3, 0.5, 0.8], [-40.0, 20.0, 390.0]),
    ([0.2, -0.6, -0.4], [35.0, 15.0, 360.0]),
    ([0.6, 0.4, 1.9], [0.0, -30.0, 400.0]),
    ([-0.5, -0.2, 0.3], [25.0, 30.0, 310.0]),
]


def seen(target):
    """Noisy pixels (views, 1, points, 2), the same noise each time."""
    rng, uv = np.random.default_rng(5), []
    for rotvec, middle in POSES:
        t = np.array(middle) - Rotation.from_rotvec(rotvec).apply(FLAT.mean(axis=0))
        uv.append(cv2.projectPoints(target, np.array(rotvec), t, K, D)[0].reshape(-1, 2))
    return (np.array(uv) + rng.normal(0, 0.05, (len(POSES), len(target), 2)))[:, None]


def solved(target, offset=0.0):
    uv = seen(target)
    points = np.tile(target + offset, (len(uv), 1, 1))
    return solve_targets(make_views(points, uv, np.ones(uv.shape[:3], bool)), ["c"], [SIZE])


def lens_numbers(result):
    lens = result.estimate.value.shared.lenses[0]
    i, d = lens.intrinsics, lens.distortion
    return np.array([i.fx, i.fy, i.cx, i.cy, d.k1, d.k2])


@pytest.mark.parametrize("target", [FLAT, SOLID], ids=["flat", "solid"])
def test_surveyed_coordinates_give_the_same_camera(target):
    """120 mm of target at a distance of 12 km and more from its origin: 1e5 times its size."""
    offset = np.array([1.2e7, -1.5e7, 0.8e7])
    near, far = solved(target), solved(target, offset)
    # Rounding: 1.5e7 has steps of 2e-9 mm, a pixel is 0.5 mm wide there.
    np.testing.assert_allclose(lens_numbers(far), lens_numbers(near), rtol=1e-6)
    sigma = [np.sqrt(np.diag(np.asarray(r.estimate.covariance.shared()))) for r in (near, far)]
    np.testing.assert_allclose(sigma[1], sigma[0], rtol=1e-4)
    # The poses are those of the user's frame: they take the user's points to where the near ones went.
    np.testing.assert_array_equal(np.asarray(far.views.points)[0, : len(target)], target + offset)
    for v in range(len(POSES)):
        places = []
        for r in (near, far):
            T = r.estimate.value.local
            R = Rotation.from_rotvec(np.array(T.rotvec[v]))
            places.append(R.apply(np.array(r.views.points[v])) + np.array(T.translation[v]))
        np.testing.assert_allclose(places[1], places[0], atol=1e-5)


def test_covariance_of_the_poses_is_that_of_a_solve_in_the_users_frame():
    uv, points = seen(SOLID), np.tile(SOLID + [150.0, -90.0, 60.0], (len(POSES), 1, 1))
    views = TargetViews(jnp.asarray(points), PixelObservations.of(jnp.asarray(uv)))
    start, _ = start_rig(views, [SIZE], ["c"])
    free = free_parameters(1, "k1k2", False)
    expected = refine_targets(start, views, free)
    moved, middle = centred(views)
    np.testing.assert_allclose(np.asarray(moved.points).mean(axis=1), 0.0, atol=1e-12)
    start, _ = start_rig(moved, [SIZE], ["c"])
    got = moved_back(refine_targets(start, moved, free), middle)
    np.testing.assert_allclose(got.value.local.translation, expected.value.local.translation, atol=1e-4)
    for v in (0, 3):
        C = np.asarray(expected.covariance.local(v))
        np.testing.assert_allclose(got.covariance.local(v), C, atol=1e-6 * np.abs(C).max(), rtol=1e-4)
        X = np.asarray(expected.covariance.cross(v))
        np.testing.assert_allclose(got.covariance.cross(v), X, atol=1e-6 * np.abs(X).max(), rtol=1e-4)


@pytest.mark.parametrize("percent", [0.01, 0.05, 0.1, 0.15, 0.25, 0.5, 3.0])
def test_almost_flat_targets(percent):
    """Points up to this much of the target's length out of its plane, used with their true coordinates."""
    z = np.random.default_rng(1).uniform(-0.5, 0.5, len(FLAT)) * 120 * percent / 100
    target = FLAT + z[:, None] * [0.0, 0.0, 1.0]
    result = solved(target)
    assert result.frozen == ((),)
    sigma = np.sqrt(np.diag(np.asarray(result.estimate.covariance.shared())))
    assert np.all(np.abs(lens_numbers(result) - [610, 612, 322, 236, -0.18, 0.05]) < 4 * sigma)
    assert float(result.estimate.stats["rms_px"]) < 0.08  # sqrt(2) times the noise of 0.05 px
