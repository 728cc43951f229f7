"""Skeleton fits: derivatives through triangulation and fit, bodies learnt from poses, missing beads, wrong calls."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from puppet_poses import BEADS, beads_of, pose, random_pose
from scipy.spatial.transform import Rotation

from jaxmocap._errors import InputError
from jaxmocap.bodies.bead_body import PARTS, UPPER_BEADS
from jaxmocap.cameras import BrownDistortion, Camera, Intrinsics, Turntable
from jaxmocap.observations import PixelObservations
from jaxmocap.reconstruction import fit_skeleton_to_pixels, fit_skeleton_to_points, joint_angles, pose_from_pixels
from jaxmocap.reconstruction.bone_directions import bend
from jaxmocap.reconstruction.pose_from_pixels import camera_share
from jaxmocap.reconstruction.skeleton import BONE_NAMES, default_lengths

PHOTOS, ELBOW = 5, (BONE_NAMES.index("l-elbow-joint"), BONE_NAMES.index("l-hand-joint"))


def cameras(k1):
    number = lambda v: jnp.full(PHOTOS, v)  # noqa: E731
    poses = jax.vmap(Turntable.nominal().pose)(2 * jnp.pi * jnp.arange(float(PHOTOS)) / PHOTOS)
    lens = BrownDistortion(jnp.broadcast_to(k1, (PHOTOS,)), *[number(v) for v in (0.03, 0.0, 0.0, 0.0)])
    return Camera(Intrinsics(*[number(v) for v in (859.0, 860.2, 337.3, 288.2, 0.0)]), lens, poses, (704, 576))


def pixels(p, k1=-0.12):
    """Pixels by the document's formulas, eq. 4.8-4.18 with distortion, in numpy."""
    out = []
    for a in 2 * np.pi * np.arange(PHOTOS) / PHOTOS:
        c, s = np.cos(a), np.sin(a)
        x, y, z = c * p[:, 0] + s * p[:, 2], 80 - p[:, 1], 400 - (c * p[:, 2] - s * p[:, 0])
        m = np.stack([x / z, y / z], axis=1)
        r2 = np.sum(m**2, axis=1, keepdims=True)
        out.append(m * (1 + k1 * r2 + 0.03 * r2**2) * (859.0, 860.2) + (337.3, 288.2))
    return np.stack(out)


@pytest.fixture(scope="module")
def bent():
    """Pixels with noise of a pose with a bent elbow, and the elbow's angle as a function of one pixel and kappa1."""
    rng = np.random.default_rng(5)
    points = beads_of(pose(arm_L=((1, 0.2, 0.1), (0.3, 1, 0.2)), back=(0.1, 1, 0.05)))
    uv = jnp.array(pixels(points) + 0.1 * rng.normal(size=(PHOTOS, 16, 2)))
    visible = rng.uniform(size=(PHOTOS, 16)) < 0.9

    def elbow(numbers):
        moved = uv.at[2, BEADS.index("arm.L2")].set(numbers[:2])
        seen = PixelObservations.of(moved, jnp.array(visible).at[2, BEADS.index("arm.L2")].set(True), 0.1)
        found = pose_from_pixels(seen, cameras(numbers[2]), default_lengths()).directions
        return bend(found[ELBOW[0]], found[ELBOW[1]])

    return jax.jit(elbow), jnp.concatenate([uv[2, BEADS.index("arm.L2")], jnp.array([-0.12])])


def test_derivative_of_an_elbow_through_the_whole_pipeline(bent):
    """One jax.jacobian by a bead's pixel and by kappa1, against central differences of the pipeline run again."""
    elbow, numbers = bent
    J = jax.jit(jax.jacobian(elbow))(numbers)
    steps = np.array([1e-3, 1e-3, 1e-4])
    for k, h in enumerate(steps):
        e = jnp.zeros(3).at[k].set(h)
        difference = (elbow(numbers + e) - elbow(numbers - e)) / (2 * h)
        np.testing.assert_allclose(J[k], difference, rtol=1e-4, atol=1e-8)
    assert np.all(np.abs(J[:2]) > 1e-5)  # rad per pixel: the bead does say something


def test_uncertainty_of_the_lens_is_added_to_first_order(bent):
    elbow, numbers = bent
    at = lambda k1: elbow(jnp.concatenate([numbers[:2], k1]))[None]  # noqa: E731
    added = camera_share(at, numbers[2:], jnp.array([[0.01**2]]))
    slope = (at(jnp.array([-0.119])) - at(jnp.array([-0.121]))) / 2e-3
    np.testing.assert_allclose(added, (0.01 * slope[:, None]) ** 2, rtol=1e-3)
    with pytest.raises(InputError, match="covariance"):
        camera_share(at, numbers[2:], jnp.eye(2))


def rigid_body_poses(rng, n):
    """Beads of a body with true lengths: limbs turn about joints and twist, beads sit beside the bones."""
    lower, upper, shoulder, hip = 20.0, 35.0, 21.0, 12.0
    out, angles = [], []
    for _ in range(n):
        turn = lambda s, P=None: Rotation.from_rotvec(s * rng.normal(size=3))  # noqa: E731
        torso, at = turn(0.25), {}
        back = np.array([0.0, 100 + lower, 0])
        at["torso.2"] = back + torso.apply([0.5, 8, 15])
        at["torso.1"] = at["torso.2"] + torso.apply([0, 23, 0])
        neck, head = back + torso.apply([0, upper, 0]), torso * turn(0.25)
        at["head.2"] = neck + head.apply([0, 18, 14])
        at["head.1"] = at["head.2"] + head.apply([0, 17, 0])
        for side, sign in (("L", 1.0), ("R", -1.0)):
            arm, thigh = torso * turn(0.6), turn(0.35)
            folded = arm * Rotation.from_rotvec([0, 0, rng.uniform(0.1, 2.0)])
            bent = thigh * Rotation.from_rotvec([rng.uniform(0.1, 1.5), 0, 0])
            place = back + torso.apply([sign * shoulder, upper, 0])
            at[f"arm.{side}1"] = place + arm.apply([sign * 6, 0, 7])
            at[f"arm.{side}2"] = at[f"arm.{side}1"] + arm.apply([sign * 28, 0, 0])
            at[f"arm.{side}3"] = at[f"arm.{side}2"] + folded.apply([sign * 30, 0, 0])
            at[f"leg.{side}1"] = np.array([sign * hip, 100, 0]) + thigh.apply([sign * 9, -7, 0])
            at[f"leg.{side}2"] = at[f"leg.{side}1"] + thigh.apply([0, -38, 0])
            at[f"leg.{side}3"] = at[f"leg.{side}2"] + bent.apply([0, -40, 0])
        out.append(np.array([at[b] for b in BEADS]))
        angles.append(torso)
    return np.stack(out), angles


@pytest.fixture(scope="module")
def learnt():
    rng = np.random.default_rng(11)
    points, torsos = rigid_body_poses(rng, 6)
    noisy = points + 0.05 * rng.normal(size=points.shape)
    cov = jnp.broadcast_to(0.05**2 * jnp.eye(3), (6, 16, 3, 3))
    fit = fit_skeleton_to_points(jnp.array(noisy), jnp.ones((6, 16), bool), cov, default_lengths(), mode="learn")
    return fit, torsos


def test_a_body_is_learnt_from_six_poses(learnt):
    fit, _ = learnt
    assert fit.estimate.success, fit.estimate.sentence
    body, sigma = fit.estimate.value.shared.body, np.sqrt(np.diag(fit.estimate.covariance.shared()))
    truth = np.array([20.0, 35, 21, 21, 12, 12])
    z = (np.asarray(body.lengths) - truth) / sigma[3:9]  # after the root's three numbers
    assert np.all(np.abs(z) < 4) and np.all(sigma[3:9] < 3.0), (body.lengths, sigma[3:9])
    np.testing.assert_allclose(body.spans, [17, 23, 28, 30, 28, 30, 38, 40, 38, 40], atol=0.15)
    radius = np.linalg.norm(np.delete(np.asarray(body.offsets), 1, axis=0)[1:3, 1:], axis=1)
    np.testing.assert_allclose(radius, 7.0, atol=0.6)
    cost, freedom = float(fit.estimate.stats["cost"]), float(fit.estimate.stats["degrees_of_freedom"])
    # 48 numbers a pose and 6 expected lengths; 27 turns a pose, 31 free numbers of the body.
    assert freedom == 6 * 48 + 6 - 6 * 27 - 32
    assert abs(2 * cost - freedom) < 4.5 * np.sqrt(2 * freedom)


def test_twist_of_the_torso_is_found(learnt):
    fit, torsos = learnt
    left = np.asarray(fit.poses().directions[:, BONE_NAMES.index("l-shoulder-joint")])
    for found, torso in zip(left, torsos):
        assert np.degrees(np.arccos(found @ torso.apply([1, 0, 0]))) < 2.5


def test_what_no_bead_sees_has_no_sigma(learnt):
    sigma = np.asarray(joint_angles(learnt[0]).sigma_turns)
    lower = [PARTS.index(p) for p in ("l-hand-joint", "r-hand-joint", "l-foot-joint", "r-foot-joint")]
    assert np.all(np.isinf(sigma[:, lower]).sum(axis=2) == 1)
    assert np.all(np.isfinite(np.delete(sigma, lower, axis=1)))


def test_missing_beads_and_hard_poses_stay_finite():
    """Six poses through one compilation: straight arms, arm up, leg along x, head over back; beads missing."""
    poses = [
        pose(), pose(arm_L=((0, 1, 0), (0, 1, 0))), pose(leg_L=((1, 0, 0), (1, 0, 0))), pose(head=(0, -1, 0)),
        random_pose(np.random.default_rng(2)), random_pose(np.random.default_rng(3)),
    ]  # fmt: skip
    points, seen = np.stack([beads_of(p) for p in poses]), np.ones((6, 16), bool)
    lost = {4: ("arm.L2",), 5: ("torso.1", "torso.2", "leg.R1")}
    for k, beads in lost.items():
        for bead in beads:
            seen[k, BEADS.index(bead)] = False
            points[k, BEADS.index(bead)] = np.nan
    cov = jnp.broadcast_to(0.05**2 * jnp.eye(3), (6, 16, 3, 3))
    fit = fit_skeleton_to_points(jnp.array(points), jnp.array(seen), cov, default_lengths())
    assert fit.estimate.success, fit.estimate.sentence
    found, angles = fit.poses(), joint_angles(fit)
    assert np.isfinite(found.rotvec).all() and np.isfinite(found.root).all()
    seen[4, BEADS.index("arm.L3")] = False  # cut off from the body by the missing bead: nothing to say
    np.testing.assert_allclose(
        np.where(seen[..., None], fit.beads(), 0), np.where(seen[..., None], points, 0), atol=1e-6
    )
    unknown = {(k, PARTS[i]) for k, i in np.argwhere(np.isinf(np.asarray(angles.sigma_bends)))}
    assert unknown == {
        (4, "l-elbow-joint"), (4, "l-hand-joint"), (5, "r-knee-joint"), (5, "r-foot-joint"), (5, "upper-back-joint"),
        (5, "head-joint"), (5, "l-elbow-joint"), (5, "r-elbow-joint"),
    }  # fmt: skip
    np.testing.assert_allclose(angles.bends[0], 0.0, atol=1e-6)
    assert not np.isnan(np.asarray(angles.sigma_bends)).any()


def test_wrong_calls_are_refused():
    points, seen, cov = jnp.zeros((1, 16, 3)), jnp.ones((1, 16), bool), jnp.ones((1, 16, 3, 3))
    with pytest.raises(InputError, match="body"):
        fit_skeleton_to_points(points, seen, cov, default_lengths(), mode="known")
    observations = PixelObservations.of(jnp.zeros((1, PHOTOS, 16, 2)))
    views = eqx.tree_at(lambda c: c, cameras(jnp.array(0.0)), jax.tree.map(lambda x: x[None], cameras(jnp.array(0.0))))
    with pytest.raises(InputError, match="angles"):
        fit_skeleton_to_pixels(observations, views, points, seen, default_lengths(), angles=jnp.zeros((1, PHOTOS)))
    assert len(UPPER_BEADS) == 6
