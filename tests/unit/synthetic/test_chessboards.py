import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxmocap import InputError, SolveError
from jaxmocap.geometry import Pose
from jaxmocap.synthetic.chessboards import add_noise, add_view_noise, chessboard_world, lens_of_numbers

LEFT = (700.0, 690.0, 320.0, 230.0, (-0.2, 0.05, 0.001, -0.002, 0.01))
RIGHT = (650.0, 655.0, 310.0, 250.0, (-0.1, 0.02))
R_RIGHT, T_RIGHT = np.array([0.02, -0.15, 0.01]), np.array([-120.0, 3.0, 8.0])


@pytest.fixture(scope="module")
def stereo():
    return chessboard_world(
        5,
        [lens_of_numbers(*LEFT), lens_of_numbers(*RIGHT)],
        [(640, 480), (640, 480)],
        T_camera_rig=[Pose(jnp.asarray(R_RIGHT), jnp.asarray(T_RIGHT))],
        board=(6, 4),
        seed=3,
    )


def test_corners_are_opencvs(stereo):
    pose = stereo.truth.local
    for view in range(5):
        board = np.array(stereo.views.points[view])
        R, t = Rotation.from_rotvec(np.array(pose.rotvec[view])), np.array(pose.translation[view])
        R2 = Rotation.from_rotvec(R_RIGHT) * R
        t2 = Rotation.from_rotvec(R_RIGHT).apply(t) + T_RIGHT
        for camera, (numbers, rot, move) in enumerate(((LEFT, R, t), (RIGHT, R2, t2))):
            fx, fy, cx, cy, k = numbers
            K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
            distortion = np.pad(k, (0, 5 - len(k)))
            place = np.array(rot.as_rotvec()), np.array(move)
            expected = cv2.projectPoints(board, *place, K, distortion)[0].reshape(-1, 2)
            seen = np.asarray(stereo.views.seen.visible[view, camera])
            assert np.all(expected[seen] >= 0) and np.all(expected[seen] <= [639, 479])
            np.testing.assert_allclose(stereo.views.seen.uv[view, camera][seen], expected[seen], atol=1e-9)


def test_first_camera_sees_every_corner_and_same_seed_same_world(stereo):
    assert np.all(stereo.views.seen.visible[:, 0])
    again = chessboard_world(2, [lens_of_numbers(*LEFT)], [(640, 480)], board=(6, 4), seed=3)
    once = chessboard_world(2, [lens_of_numbers(*LEFT)], [(640, 480)], board=(6, 4), seed=3)
    other = chessboard_world(2, [lens_of_numbers(*LEFT)], [(640, 480)], board=(6, 4), seed=4)
    np.testing.assert_array_equal(once.views.seen.uv, again.views.seen.uv)
    assert np.any(once.views.seen.uv != other.views.seen.uv)


def test_noise(stereo):
    keys = jax.random.split(jax.random.key(0), 500)
    clean = np.asarray(stereo.views.seen.uv)
    seen = np.asarray(stereo.views.seen.visible)
    white = np.asarray(jax.vmap(lambda k: add_noise(stereo.views, 0.3, k).seen.uv)(keys)) - clean
    assert np.all(white[:, ~seen] == 0)
    np.testing.assert_allclose(white[:, seen].std(), 0.3, rtol=0.01)
    common = np.asarray(jax.vmap(lambda k: add_view_noise(stereo.views, 0.2, 0.0, k).seen.uv)(keys)) - clean
    np.testing.assert_allclose(np.ptp(common[:, :, 0], axis=2), 0.0, atol=1e-12)  # one shift for all corners
    np.testing.assert_allclose(common[:, :, 0].std(), 0.2, rtol=0.06)
    bent = np.asarray(jax.vmap(lambda k: add_view_noise(stereo.views, 0.0, 0.2, k).seen.uv)(keys)) - clean
    np.testing.assert_allclose(bent[:, :, 0].mean(axis=2), 0.0, atol=1e-12)  # leaves the middle where it is
    np.testing.assert_allclose(np.sqrt(np.mean(bent[:, :, 0] ** 2)), 0.2, rtol=0.06)


def test_wrong_calls():
    lens = lens_of_numbers(500.0, 500.0, 320.0, 240.0)
    with pytest.raises(InputError, match="image_sizes"):
        chessboard_world(1, [lens], [(640, 480), (640, 480)])
    with pytest.raises(InputError, match="5|five|at most"):
        lens_of_numbers(1.0, 1.0, 0.0, 0.0, (0.0,) * 6)
    with pytest.raises(SolveError, match="fits into"):
        chessboard_world(1, [lens], [(640, 480)], fill=(3.0, 4.0))
