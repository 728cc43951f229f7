"""The axis from board poses alone: exact, noisy, with a mirrored pose, and the cases that have none."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxmocap._errors import SolveError
from jaxmocap.calibration.turntable_start import start_turntable

R0 = Rotation.from_rotvec([np.pi - 0.02, 0.01, 0.03])
ANGLES = np.array([300.0, 330, 0, 30, 60])


def poses(angles_deg, noise=0.0, distance=400.0):
    rng = np.random.default_rng(0)
    board = np.eye(4)
    board[:3, :3], board[:3, 3] = Rotation.from_euler("x", 168, degrees=True).as_matrix(), [-48, 83, -3]
    out = []
    for a in angles_deg:
        T = np.eye(4)
        T[:3, :3] = (R0 * Rotation.from_euler("y", a, degrees=True)).as_matrix()
        T[:3, 3] = -R0.apply([0, 80.0, distance])
        T = T @ board
        T[:3, :3] = Rotation.from_rotvec(rng.normal(0, noise, 3)).as_matrix() @ T[:3, :3]
        out.append(T)
    return np.stack(out)


def test_exact_poses_give_the_exact_axis():
    found = start_turntable(poses(ANGLES))
    np.testing.assert_allclose(found.direction, R0.apply([0, 1, 0]), atol=1e-9)
    np.testing.assert_allclose(found.point, R0.apply([0, 0, -400.0]), atol=1e-6)
    np.testing.assert_allclose(np.degrees(found.angles), [0, 30, 60, 90, 120], atol=1e-7)


def test_a_mirrored_pose_is_outvoted():
    T = poses(ANGLES, noise=1e-3)
    T[4, :3, :3] = T[4, :3, :3] @ Rotation.from_euler("x", 40, degrees=True).as_matrix()
    found = start_turntable(T)
    assert np.degrees(np.arccos(found.direction @ R0.apply([0, 1, 0]))) < 1.0
    assert found.best != 4


def test_turning_the_other_way_gives_falling_angles():
    assert np.all(np.diff(start_turntable(poses([0.0, -20, -40])).angles) < 0)


def test_a_table_that_did_not_turn_has_no_axis():
    with pytest.raises(SolveError, match="did not turn"):
        start_turntable(poses([10.0, 10, 10], noise=1e-4))
