"""The refined point: against scipy, its covariance against simulation, wrong views named."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import view_samples as scene
from scipy.optimize import least_squares
from scipy.stats import chi2

from jaxmocap.observations import PixelObservations
from jaxmocap.reconstruction import name_wrong_views, refine_point

RIG = scene.rig()
POINT = np.array([12.0, -30.0, 25.0])
EXACT = scene.pixels(POINT[None])[0]
SIGMA = np.array([0.3, 0.5, 0.2, 0.4, 0.3, 0.6])
FALSE_ALARM = 0.01
TRIALS = 800


def _observed(uv, visible=None):
    uv = jnp.asarray(uv)
    seen = jnp.ones(uv.shape[:-1], bool) if visible is None else jnp.asarray(visible)
    return PixelObservations(uv, seen, jnp.broadcast_to(jnp.asarray(SIGMA), uv.shape[:-1]))


PLAIN = jax.jit(lambda seen: jax.vmap(lambda s: refine_point(RIG, s))(seen))
ROBUST = jax.jit(lambda seen: jax.vmap(lambda s: refine_point(RIG, s, "cauchy"))(seen))
JUDGE = jax.jit(lambda seen: jax.vmap(lambda s: name_wrong_views(RIG, s, false_alarm=FALSE_ALARM))(seen))


@pytest.fixture(scope="module")
def noisy():
    return EXACT + np.random.default_rng(4).normal(size=(TRIALS, scene.VIEWS, 2)) * SIGMA[:, None]


def test_minimum_is_scipy_s(noisy):
    def residual(p, uv, use):
        return (((scene.pixels(p[None])[0] - uv) / SIGMA[:, None])[use]).reshape(-1)

    visible = np.ones((TRIALS, scene.VIEWS), bool)
    visible[:5, 1:3], visible[5:10, 2:] = False, False
    got = PLAIN(_observed(noisy, visible))
    for i in range(12):
        best = least_squares(residual, POINT, args=(noisy[i], visible[i]), xtol=1e-15, ftol=1e-15, gtol=1e-15)
        np.testing.assert_allclose(got.p_world[i], best.x, atol=2e-5)
        np.testing.assert_allclose(got.chi2[i], 2 * best.cost, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("refine, widest", [(PLAIN, 1.0), (ROBUST, 1.15)])
def test_stated_covariance_is_that_of_repeated_trials(noisy, refine, widest):
    got = refine(_observed(noisy))
    e = np.asarray(got.p_world) - POINT
    d2 = np.einsum("ni,nij,nj->n", e, np.linalg.inv(np.asarray(got.covariance)), e)
    # Mean of chi-squared with 3 degrees of freedom over 800 trials: 3 +- 0.09.
    assert abs(d2.mean() - 3) < 0.3 if widest == 1.0 else 3 / widest**2 < d2.mean() < 3.3
    assert np.all(np.asarray(got.valid))


def test_chi2_has_the_distribution_it_should_have(noisy):
    values = np.asarray(PLAIN(_observed(noisy)).chi2)
    assert abs(np.mean(values > chi2(2 * scene.VIEWS - 3).ppf(0.9)) - 0.1) < 0.033


def test_one_wrong_view_is_named(noisy):
    wrong = noisy.copy()
    which = np.arange(TRIALS) % scene.VIEWS
    wrong[np.arange(TRIALS), which] += np.array([25.0, -18.0])  # the bead next to it
    verdict = JUDGE(_observed(wrong))
    named = np.asarray(verdict.wrong)
    assert np.mean(named[np.arange(TRIALS), which]) > 0.995
    right = np.asarray(verdict.point.p_world)[named.sum(axis=1) == 1]
    assert np.abs(right - POINT).max() < 1.5 and len(right) > 0.97 * TRIALS


def test_two_wrong_views_are_named(noisy):
    wrong = noisy.copy()
    wrong[:, 1] += [30.0, 5.0]
    wrong[:, 4] -= [5.0, 40.0]
    named = np.asarray(JUDGE(_observed(wrong)).wrong)
    assert np.mean(named[:, 1] & named[:, 4]) > 0.98


def test_false_alarms_are_as_rare_as_stated(noisy):
    named = np.asarray(JUDGE(_observed(noisy)).wrong).any(axis=1)
    # 1 %, Bonferroni errs on the safe side; three standard deviations of a binomial above.
    assert named.mean() <= FALSE_ALARM + 3 * np.sqrt(FALSE_ALARM / TRIALS)
    assert named.any()


def test_two_views_can_disagree_but_nobody_knows_which_is_wrong():
    visible = np.zeros((TRIALS, scene.VIEWS), bool)
    visible[:, [0, 2]] = True
    uv = np.tile(EXACT, (TRIALS, 1, 1))
    uv[0, 2] += [0.0, 20.0]  # across the epipolar line of the first view, which is nearly level
    verdict = JUDGE(_observed(uv, visible))
    assert not verdict.wrong[:2].any()
    assert not verdict.consistent[0] and verdict.consistent[1]


def test_fewer_than_two_views_are_masked():
    visible = np.zeros((TRIALS, scene.VIEWS), bool)
    visible[0, 3] = True
    for refine in (PLAIN, ROBUST):
        got = refine(_observed(np.tile(EXACT, (TRIALS, 1, 1)), visible))
        assert not got.valid[:2].any()
        assert np.isfinite(got.p_world[:2]).all() and np.isposinf(np.diagonal(got.covariance[0])).all()


def test_derivative_is_that_of_the_minimum_and_finite_where_there_is_none(noisy):
    """Central differences of the whole refinement by a pixel of the first view and by k1; one point has one view."""
    uv = jnp.asarray(np.stack([noisy[0], noisy[1]]))
    visible = jnp.ones((2, scene.VIEWS), bool).at[1, 1:].set(False)

    @jax.jit
    def points(x):
        lens = RIG.distortion
        moved = type(lens)(lens.k1 + x[1], lens.k2, lens.p1, lens.p2, lens.k3)
        cameras = type(RIG)(RIG.intrinsics, moved, RIG.T_camera_world, RIG.image_size)
        return jax.vmap(lambda s: refine_point(cameras, s).p_world)(_observed(uv.at[:, 0, 0].add(x[0]), visible))

    J = np.asarray(jax.jit(jax.jacfwd(points))(jnp.zeros(2)))
    assert np.isfinite(J).all()
    for k, h in ((0, 1e-3), (1, 1e-5)):
        step = h * np.eye(2)[k]
        numeric = (np.asarray(points(jnp.asarray(step))) - np.asarray(points(jnp.asarray(-step)))) / (2 * h)
        np.testing.assert_allclose(J[0, :, k], numeric[0], rtol=1e-5, atol=1e-7)
