"""A calibration repeated with new noise: its intervals hold the truth as often as they claim.

The bands are quantiles of the binomial and chi-square distributions, so that a right program fails once in 10,000
runs (with the fixed seed it does not fail at all unless the program changes).
"""

import jax
import numpy as np
import pytest
import scipy.stats

from jaxmocap.calibration.boards import free_parameters, refine_targets
from jaxmocap.synthetic.chessboards import add_noise, chessboard_world, lens_of_numbers

REPEATS, SIGMA, FALSE_ALARM = 200, 0.3, 1e-4
NAMES = ("fx", "fy", "cx", "cy", "k1", "k2")


@pytest.fixture(scope="module")
def world():
    lens = lens_of_numbers(800.0, 800.0, 319.5, 239.5, (-0.25, 0.08))
    return chessboard_world(12, [lens], [(640, 480)], board=(7, 5), fill=(0.35, 0.8), seed=1)


def _found(value):
    lens = value.shared.lenses[0]
    return jax.numpy.stack(
        [getattr(lens.intrinsics, n) for n in NAMES[:4]] + [getattr(lens.distortion, n) for n in NAMES[4:]]
    )


@pytest.fixture(scope="module")
def repeats(world):
    free = free_parameters(1, "k1k2", False)

    def one(key):
        estimate = refine_targets(world.truth, add_noise(world.views, SIGMA, key), free)
        cov = estimate.covariance
        z = _found(estimate.value) - _found(world.truth)
        return {
            "error": z,
            "plain": cov.shared_plain(),
            "stated": cov.shared(),
            "effect": cov.design_effect,
            "variance": cov.variance,
            "code": estimate.result._value,
        }

    batch = jax.jit(jax.vmap(one))
    keys = jax.random.split(jax.random.key(0), REPEATS).reshape(4, -1)
    parts = [jax.tree.map(np.asarray, batch(k)) for k in keys]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def test_every_repeat_converges(repeats):
    assert np.all(repeats["code"] == 0)


@pytest.mark.parametrize("kind", ["plain", "stated"])
def test_each_interval_holds_95_percent(repeats, kind):
    sigma = np.sqrt(np.diagonal(repeats[kind], axis1=1, axis2=2))
    held = (np.abs(repeats["error"]) < 1.96 * sigma).sum(axis=0)
    low, high = scipy.stats.binom.ppf([FALSE_ALARM / 12, 1 - FALSE_ALARM / 12], REPEATS, 0.95)
    assert np.all(held >= low), dict(zip(NAMES, held))
    if kind == "plain":  # the stated one may be larger on purpose
        assert np.all(held <= high), dict(zip(NAMES, held))


def test_whole_covariance_not_only_its_diagonal(repeats):
    """error^T covariance^-1 error is chi-square with 6 degrees of freedom (residual variance known to 5 %)."""
    d2 = np.einsum("ri,ri->r", repeats["error"], np.linalg.solve(repeats["plain"], repeats["error"][..., None])[..., 0])
    low, high = scipy.stats.chi2.ppf([FALSE_ALARM / 2, 1 - FALSE_ALARM / 2], 6 * REPEATS)
    assert low < d2.sum() < high
    assert scipy.stats.kstest(d2, "chi2", args=(6,)).pvalue > FALSE_ALARM


def test_spread_is_the_stated_sigma(repeats):
    """The Cramer-Rao bound, to which stated sigmas are equal for a linear problem, is reached."""
    mean_sigma2 = np.mean(np.diagonal(repeats["plain"], axis1=1, axis2=2), axis=0)
    ratio = repeats["error"].var(axis=0, ddof=1) / mean_sigma2
    band = scipy.stats.chi2.ppf([FALSE_ALARM / 12, 1 - FALSE_ALARM / 12], REPEATS - 1) / (REPEATS - 1)
    assert np.all((ratio > band[0]) & (ratio < band[1])), dict(zip(NAMES, ratio))


def test_residual_variance_and_design_effect_are_unbiased(repeats):
    freedom = 12 * 35 * 2 - 6 - 6 * 12
    low, high = scipy.stats.chi2.ppf([FALSE_ALARM / 2, 1 - FALSE_ALARM / 2], freedom * REPEATS)
    assert low < repeats["variance"].sum() * freedom / SIGMA**2 < high
    effect = repeats["effect"]
    limit = scipy.stats.norm.ppf(1 - FALSE_ALARM / 2)
    assert abs(effect.mean() - 1.0) < limit * effect.std(ddof=1) / np.sqrt(REPEATS)
