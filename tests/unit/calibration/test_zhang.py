import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxmocap.calibration.zhang import (
    conic_rows,
    fit_distortion_linear,
    fit_focal_linear,
    fit_intrinsics_linear,
    intrinsics_from_conic,
    mirrored_pose,
    pose_from_homography,
)
from jaxmocap.geometry import Pose

SIZE = (640.0, 480.0)
K_SKEW = np.array([[800.0, 3.5, 330.0], [0, 780.0, 225.0], [0, 0, 1]])
K_PLAIN = np.array([[800.0, 0, 330.0], [0, 780.0, 225.0], [0, 0, 1]])
ROTVECS = np.array([[0.4, 0.1, 0.2], [-0.3, 0.5, 1.0], [0.2, -0.6, -0.5], [0.5, 0.5, 2.0]])
T = np.array([[-20.0, 10, 300], [5, -30, 400], [40, 20, 350], [-60, 0, 500]])


def _homographies(K):
    R = Rotation.from_rotvec(ROTVECS).as_matrix()
    H = K @ np.stack([R[:, :, 0], R[:, :, 1], T], axis=2)
    return H * np.array([1.0, -2.0, 1e-3, 50.0])[:, None, None]  # any scale and sign


def _conic(K):
    B = np.linalg.inv(K).T @ np.linalg.inv(K)
    return np.array([B[0, 0], B[0, 1], B[1, 1], B[0, 2], B[1, 2], B[2, 2]])


def test_conic_rows_vanish_on_the_true_conic():
    for H in _homographies(K_SKEW):
        rows = np.asarray(conic_rows(jnp.asarray(H)))
        h1, h2 = H[:, 0], H[:, 1]
        B = np.linalg.inv(K_SKEW).T @ np.linalg.inv(K_SKEW)
        np.testing.assert_allclose(rows @ _conic(K_SKEW), 0.0, atol=1e-9 * np.abs(rows).max())
        # And on another conic they are the two bilinear forms of 4.37 and 4.38.
        M = np.random.default_rng(0).normal(size=(3, 3))
        S = M + M.T
        b = np.array([S[0, 0], S[0, 1], S[1, 1], S[0, 2], S[1, 2], S[2, 2]])
        np.testing.assert_allclose(rows @ b, [h1 @ S @ h2, h1 @ S @ h1 - h2 @ S @ h2], rtol=1e-9)
        assert B.shape == (3, 3)


@pytest.mark.parametrize("scale", [1.0, -7.0, 1e-6])
def test_intrinsics_from_conic(scale):
    found, real = intrinsics_from_conic(jnp.asarray(scale * _conic(K_SKEW)))
    assert bool(real)
    np.testing.assert_allclose(found.matrix(), K_SKEW, rtol=1e-9, atol=1e-7)


def test_conic_of_no_camera_is_told_and_finite():
    found, real = intrinsics_from_conic(jnp.asarray([1.0, 0.0, -1.0, 0.0, 0.0, 1.0]))
    assert not bool(real)
    assert np.all(np.isfinite(found.matrix()))


def test_linear_intrinsics_with_and_without_skew():
    every, two = jnp.ones(4, bool), jnp.asarray([True, True, False, False])
    with_skew, real = fit_intrinsics_linear(jnp.asarray(_homographies(K_SKEW)), every, SIZE, skew=True)
    assert bool(real)
    np.testing.assert_allclose(with_skew.matrix(), K_SKEW, rtol=1e-8, atol=1e-6)
    without, real = fit_intrinsics_linear(jnp.asarray(_homographies(K_PLAIN)), every, SIZE)
    assert bool(real)
    np.testing.assert_allclose(without.matrix(), K_PLAIN, rtol=1e-8, atol=1e-6)
    H = _homographies(K_PLAIN)
    H[2:] = 1.0
    pair, real = fit_intrinsics_linear(jnp.asarray(H), two, SIZE)
    assert bool(real)
    np.testing.assert_allclose(pair.matrix(), K_PLAIN, rtol=1e-8, atol=1e-6)
    assert float(pair.skew) == 0.0


def test_one_focal_length():
    K = np.array([[900.0, 0, 319.5], [0, 900.0, 239.5], [0, 0, 1]])
    only = jnp.asarray([True, False, False, False])
    found, real = fit_focal_linear(jnp.asarray(_homographies(K)), only, SIZE)
    assert bool(real)
    np.testing.assert_allclose(found.matrix(), K, rtol=1e-9)
    frontal = K @ np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 400]])  # tells nothing of f
    found, real = fit_focal_linear(jnp.asarray(np.tile(frontal, (4, 1, 1))), only, SIZE)
    assert not bool(real) and np.all(np.isfinite(found.matrix()))


def test_pose_from_homography():
    for H, rotvec, t in zip(_homographies(K_SKEW), ROTVECS, T):
        pose = pose_from_homography(jnp.asarray(K_SKEW), jnp.asarray(H))
        np.testing.assert_allclose(pose.rotvec, rotvec, atol=1e-9)
        np.testing.assert_allclose(pose.translation, t, atol=1e-7)


def test_pose_of_a_wrong_homography_has_the_nearest_rotation():
    rng = np.random.default_rng(0)
    G = np.stack([*Rotation.from_rotvec([0.3, 0.2, 0.1]).as_matrix().T[:2], [0.1, 0.2, 5.0]], axis=1)
    G = G + 0.05 * rng.normal(size=(3, 3))
    pose = pose_from_homography(jnp.eye(3), jnp.asarray(G))
    G = G * 2 / (np.linalg.norm(G[:, 0]) + np.linalg.norm(G[:, 1]))
    U, _, Vt = np.linalg.svd(np.stack([G[:, 0], G[:, 1], np.cross(G[:, 0], G[:, 1])], axis=1))
    np.testing.assert_allclose(Rotation.from_rotvec(np.array(pose.rotvec)).as_matrix(), U @ Vt, atol=1e-12)


def test_mirrored_pose_is_an_involution_that_keeps_the_centre():
    centre = np.array([120.0, 75.0, 0.0])
    pose = Pose(jnp.asarray([0.5, -0.4, 0.3]), jnp.asarray([-30.0, 20.0, 900.0]))
    other = mirrored_pose(pose, jnp.asarray(centre))
    where = [Rotation.from_rotvec(np.array(p.rotvec)).apply(centre) + np.asarray(p.translation) for p in (pose, other)]
    np.testing.assert_allclose(where[0], where[1], atol=1e-9)
    v = where[0] / np.linalg.norm(where[0])
    n, m = (Rotation.from_rotvec(np.array(p.rotvec)).as_matrix()[:, 2] for p in (pose, other))
    np.testing.assert_allclose(m, 2 * (n @ v) * v - n, atol=1e-12)
    back = mirrored_pose(other, jnp.asarray(centre))
    np.testing.assert_allclose(back.rotvec, pose.rotvec, atol=1e-9)
    np.testing.assert_allclose(back.translation, pose.translation, atol=1e-9)


def test_mirrored_pose_of_a_far_plane_looks_the_same():
    """To first order in size / distance both poses give the same picture: a second minimum."""
    xy = np.stack(np.meshgrid([-1.0, 0, 1], [-1.0, 0, 1]), axis=-1).reshape(-1, 2)
    board = np.column_stack([xy, np.zeros(9)])
    for distance, limit in ((1e2, 3e-2), (1e4, 3e-4)):
        pose = Pose(jnp.asarray([0.5, -0.4, 0.3]), jnp.asarray([0.0, 0.0, distance]))
        other = mirrored_pose(pose, jnp.zeros(3))
        seen = []
        for p in (pose, other):
            q = Rotation.from_rotvec(np.array(p.rotvec)).apply(board) + np.asarray(p.translation)
            seen.append(q[:, :2] / q[:, 2:] * distance)
        assert np.abs(seen[0] - seen[1]).max() < limit


def test_linear_distortion_is_exact():
    rng = np.random.default_rng(0)
    xy = rng.uniform(-0.4, 0.4, (40, 2))
    k1, k2 = -0.31, 0.12
    r2 = np.sum(xy**2, axis=1, keepdims=True)
    pixels = lambda m: (np.column_stack([m, np.ones(40)]) @ K_PLAIN.T)[:, :2]  # noqa: E731
    seen = pixels(xy * (1 + k1 * r2 + k2 * r2**2))
    mask = rng.uniform(size=40) > 0.2
    seen[~mask] += 100
    found = fit_distortion_linear(*(jnp.asarray(x) for x in (pixels(xy), seen, mask, K_PLAIN)))
    np.testing.assert_allclose(found, [k1, k2], rtol=1e-9)
