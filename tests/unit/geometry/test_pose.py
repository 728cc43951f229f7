"""Poses by hand: a quarter turn and a step, read both ways."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxmocap.geometry import Pose

QUARTER_TURN_AND_STEP = np.array([[0.0, -1, 0, 10], [1, 0, 0, 20], [0, 0, 1, 30], [0, 0, 0, 1]])


def quarter() -> Pose:
    return Pose(jnp.array([0.0, 0.0, np.pi / 2]), jnp.array([10.0, 20.0, 30.0]))


def test_act_turns_first_and_moves_then():
    np.testing.assert_allclose(quarter().act(jnp.array([1.0, 2.0, 3.0])), [8, 21, 33], atol=1e-14)


def test_matrix_and_back():
    np.testing.assert_allclose(quarter().matrix(), QUARTER_TURN_AND_STEP, atol=1e-15)
    back = Pose.from_matrix(jnp.array(QUARTER_TURN_AND_STEP))
    np.testing.assert_allclose(back.rotvec, [0, 0, np.pi / 2], atol=1e-15)
    np.testing.assert_allclose(back.translation, [10, 20, 30])


def test_inverse_by_hand():
    # p_b = R^T (p_a - t), and R^T (10, 20, 30) = (20, -10, 30).
    inverse = quarter().inverse()
    np.testing.assert_allclose(inverse.rotvec, [0, 0, -np.pi / 2])
    np.testing.assert_allclose(inverse.translation, [-20, 10, -30], atol=1e-14)


def test_compose_by_hand():
    twice = quarter().compose(quarter())  # half a turn about z; t = R t + t = (-20, 10, 30) + (10, 20, 30)
    np.testing.assert_allclose(np.abs(twice.rotvec), [0, 0, np.pi], atol=1e-14)
    np.testing.assert_allclose(twice.translation, [-10, 30, 60], atol=1e-14)


def test_identity_changes_nothing():
    p = jnp.array([1.0, -2.0, 3.0])
    assert np.array_equal(Pose.identity().act(p), p)
    assert np.array_equal(Pose.identity().matrix(), np.eye(4))


def test_retract_turns_about_the_axes_of_frame_a_and_moves_along_them():
    moved = quarter().retract(jnp.array([0.0, 0.0, np.pi / 2, 1.0, 2.0, 3.0]))
    np.testing.assert_allclose(np.abs(moved.rotvec), [0, 0, np.pi], atol=1e-14)
    np.testing.assert_allclose(moved.translation, [11, 22, 33])


def test_canonical_keeps_the_translation():
    pose = Pose(jnp.array([0.0, 5.0, 0.0]), jnp.array([1.0, 2.0, 3.0])).canonical()
    np.testing.assert_allclose(pose.rotvec, [0, 5 - 2 * np.pi, 0])
    assert np.array_equal(pose.translation, [1, 2, 3])


def test_a_pose_is_two_arrays():
    assert [leaf.shape for leaf in eqx.filter(quarter(), eqx.is_array).__dict__.values()] == [(3,), (3,)]
