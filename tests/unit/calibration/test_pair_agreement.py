"""Pairs of photos that do not belong together are told from those that do; poses by OpenCV from noisy corners."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxmocap.calibration.boards import chessboard_points
from jaxmocap.calibration.pair_agreement import CameraPoses, disagreements

BOARD = chessboard_points(7, 5, 20.0) - [60.0, 40.0, 0.0]
K, NOISE = np.array([[610.0, 0, 322.0], [0, 612.0, 236.0], [0, 0, 1.0]]), 0.1
R_RL, T_RL = Rotation.from_rotvec([0.02, 0.25, -0.01]).as_matrix(), np.array([-90.0, 2.0, 8.0])
VIEWS = 10


def board_poses(rng, depth=(300.0, 420.0)):
    """Matrices T_left_board."""
    T = np.tile(np.eye(4), (VIEWS, 1, 1))
    for v in range(VIEWS):
        about = rng.uniform(0, 2 * np.pi)
        lean = np.radians(rng.uniform(15, 40)) * np.array([np.cos(about), np.sin(about), 0.0])
        T[v, :3, :3] = (Rotation.from_rotvec(lean) * Rotation.from_rotvec([0, 0, rng.normal(0, 0.3)])).as_matrix()
        T[v, :3, 3] = rng.uniform(-40, 40), rng.uniform(-30, 30), rng.uniform(*depth)
    return T


def in_right(T_left_board):
    T_right_left = np.eye(4)
    T_right_left[:3, :3], T_right_left[:3, 3] = R_RL, T_RL
    return T_right_left @ T_left_board


def seen_by(T, rng, noise=NOISE):
    """What one camera finds: poses by OpenCV from noisy corners."""
    found, squares = np.tile(np.eye(4), (len(T), 1, 1)), 0.0
    for v, true in enumerate(T):
        rotvec, t = Rotation.from_matrix(true[:3, :3]).as_rotvec(), true[:3, 3].copy()
        exact = cv2.projectPoints(BOARD, rotvec, t, K, None)[0].reshape(-1, 2)
        uv = exact + rng.normal(0, noise, exact.shape)
        _, rotvec, t = cv2.solvePnP(BOARD, uv, K, None, rotvec.copy(), t, useExtrinsicGuess=True)
        found[v, :3, :3], found[v, :3, 3] = Rotation.from_rotvec(rotvec.ravel()).as_matrix(), t.ravel()
        squares += np.sum((cv2.projectPoints(BOARD, rotvec, t, K, None)[0].reshape(-1, 2) - uv) ** 2)
    return CameraPoses(K, found, np.ones(len(T), bool), squares / (len(T) * (2 * len(BOARD) - 6)))


def compared(left, right):
    views = len(left.T)
    return disagreements([left, right], np.tile(BOARD, (views, 1, 1)), np.ones((views, 2, len(BOARD)), bool))


def test_a_hundred_good_rigs_raise_no_alarm():
    for seed in range(100):
        rng = np.random.default_rng(seed)
        T = board_poses(rng)
        assert compared(seen_by(T, rng), seen_by(in_right(T), rng)) == []


def test_covariances_hold_and_sigmas_five_times_too_small_raise_no_alarm():
    tight = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        T = board_poses(rng)
        cameras = [seen_by(T, rng), seen_by(in_right(T), rng)]
        points, seen = np.tile(BOARD, (VIEWS, 1, 1)), np.ones((VIEWS, 2, len(BOARD)), bool)
        tight += len(disagreements(cameras, points, seen, inflation=1.0))  # one view in a million, 400 views
        assert disagreements([c._replace(variance=c.variance / 25) for c in cameras], points, seen) == []
    assert tight == 0


@pytest.mark.parametrize("wrong", [(3,), (0, 5, 6), (1, 2, 4, 9)])
def test_views_in_which_the_board_moved_between_the_two_photos_are_named(wrong):
    rng = np.random.default_rng(1)
    T = board_poses(rng)
    later = T.copy()
    for v in wrong:
        later[v, :3, 3] += rng.choice([-1, 1], 3) * [6.0, 5.0, 8.0]
    (found,) = compared(seen_by(T, rng), seen_by(in_right(later), rng))
    np.testing.assert_array_equal(found.views, wrong)
    assert found.agreeing == VIEWS - len(wrong) and found.total == VIEWS and not found.swapped


@pytest.mark.parametrize("order", [range(VIEWS)[::-1], np.roll(range(VIEWS), 1)], ids=["reversed", "one off"])
def test_wrong_order_leaves_no_group_that_agrees(order):
    rng = np.random.default_rng(2)
    T = board_poses(rng)
    (found,) = compared(seen_by(T, rng), seen_by(in_right(T[list(order)]), rng))
    assert found.agreeing <= 2 and len(found.views) == VIEWS


def test_photos_of_a_pair_that_are_swapped_are_recognised():
    rng = np.random.default_rng(3)
    T = board_poses(rng)
    left, right = T.copy(), in_right(T)
    left[[2, 7]], right[[2, 7]] = right[[2, 7]], left[[2, 7]]
    (found,) = compared(seen_by(left, rng), seen_by(right, rng))
    np.testing.assert_array_equal(found.views, [2, 7])
    assert found.swapped


def test_board_numbered_from_the_other_end_in_one_photo():
    rng = np.random.default_rng(4)
    T = board_poses(rng)
    turned = T.copy()
    turned[6, :3, :3] = turned[6, :3, :3] @ np.diag([-1.0, -1.0, 1.0])
    (found,) = compared(seen_by(T, rng), seen_by(in_right(turned), rng))
    np.testing.assert_array_equal(found.views, [6])


def test_two_views_that_contradict_each_other():
    rng = np.random.default_rng(5)
    T = board_poses(rng)[:2]
    later = T.copy()
    later[1, :3, 3] += [6.0, 5.0, 8.0]
    (found,) = compared(seen_by(T, rng), seen_by(in_right(later), rng))
    np.testing.assert_array_equal(found.views, [0, 1])


def test_mirrored_pose_of_a_far_board_is_not_blamed_on_the_pair():
    rng = np.random.default_rng(6)
    T = board_poses(rng)
    T[4, :3, 3] = [300.0, -100.0, 6000.0]
    left, right = seen_by(T, rng), seen_by(in_right(T), rng)
    middle = left.T[4, :3, 3] / np.linalg.norm(left.T[4, :3, 3])
    left.T[4, :3, :3] = (2 * np.outer(middle, middle) - np.eye(3)) @ left.T[4, :3, :3] @ np.diag([-1.0, -1.0, 1.0])
    assert compared(left, right) == []


def test_unit_of_length_does_not_matter():
    rng = np.random.default_rng(7)
    T = board_poses(rng)
    left, right = seen_by(T, rng), seen_by(in_right(T), rng)
    right.T[3, :3, 3] += [6.0, 5.0, 8.0]
    for unit in (1e-3, 1.0, 1e3):
        scaled = []
        for camera in (left, right):
            moved = camera.T.copy()
            moved[:, :3, 3] *= unit
            scaled.append(camera._replace(T=moved))
        points, seen = np.tile(BOARD * unit, (VIEWS, 1, 1)), np.ones((VIEWS, 2, len(BOARD)), bool)
        (found,) = disagreements(scaled, points, seen)
        np.testing.assert_array_equal(found.views, [3])
