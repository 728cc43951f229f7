"""The same optimum as scipy's and optimistix' dense solvers, whatever the order, the padding, the damping."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
import scipy.optimize
from arrow_problems import CASES, decay_case, dense, flat_value, mixed_case, solved, visible_rows

from jaxmocap.optim import ArrowProblem, ArrowVariables, least_squares
from jaxmocap.optim.robust import robustify

SOLVED = ("masked and weighted", "prior", "frozen parts", "scale", "14 local", "no local", "decay", "pinhole")


def _scipy(reference, case, **options):
    r = jax.jit(lambda z: reference.residual(z, case.data, case.common))
    J = jax.jit(jax.jacfwd(lambda z: reference.residual(z, case.data, case.common)))
    tight = dict(xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale="jac")
    return scipy.optimize.least_squares(
        lambda z: np.asarray(r(z)), reference.z0, lambda z: np.asarray(J(z)), **tight, **options
    )


@pytest.mark.parametrize("name", SOLVED)
def test_optimum_is_scipys(name):
    case, reference, estimate, z, r, J = solved(name)
    assert estimate.success, estimate.sentence
    found = _scipy(reference, case)
    np.testing.assert_allclose(float(estimate.stats["cost"]), found.cost, rtol=1e-11)
    moved = np.any(J != 0, axis=0)
    # In units of what the data say about each parameter.
    size = np.linalg.norm(J[:, moved], axis=0)
    assert np.abs((z - found.x)[moved] * size).max() < 1e-6 * max(1.0, np.sqrt(2 * found.cost))
    np.testing.assert_array_equal(z[~moved], reference.z0[~moved])


@pytest.mark.parametrize("name", ["pinhole", "prior"])
def test_optimum_is_that_of_optimistix(name):
    case, reference, _, z, _, J = solved(name)
    best = optx.least_squares(
        lambda x, args: reference.residual(x, case.data, case.common),
        optx.LevenbergMarquardt(rtol=1e-13, atol=1e-13),
        jnp.asarray(reference.z0),
        max_steps=500,
    )
    assert np.abs((z - best.value) * np.linalg.norm(J, axis=0)).max() < 1e-5


def test_frozen_entries_keep_their_value():
    case, _, estimate, *_ = solved("frozen parts")
    np.testing.assert_array_equal(estimate.value.shared["b"], case.y0.shared["b"])
    np.testing.assert_array_equal(estimate.value.shared["a"][1], case.y0.shared["a"][1])
    np.testing.assert_array_equal(estimate.value.local["p"][:, :, 1], case.y0.local["p"][:, :, 1])
    assert np.all(estimate.value.local["p"][:, :, 0] != case.y0.local["p"][:, :, 0])


def test_blocks_without_weight_stay_and_do_not_count():
    case, _, estimate, *_ = solved("masked and weighted")
    off = np.flatnonzero(case.weight == 0)
    np.testing.assert_array_equal(estimate.value.local["q"][off], case.y0.local["q"][off])
    on = np.flatnonzero(case.weight == 1)
    pick = lambda tree: jax.tree.map(lambda x: x[on], tree)  # noqa: E731
    fewer = least_squares(
        case.problem, ArrowVariables(case.y0.shared, pick(case.y0.local)), pick(case.data), case.common,
        count=visible_rows(case),
    )  # fmt: skip
    np.testing.assert_allclose(fewer.value.shared["a"], estimate.value.shared["a"], rtol=1e-7)
    np.testing.assert_allclose(fewer.covariance.shared(), estimate.covariance.shared_plain(), rtol=1e-6)
    assert float(fewer.stats["degrees_of_freedom"]) == float(estimate.stats["degrees_of_freedom"])


def test_order_of_blocks_and_padding_change_nothing():
    case = mixed_case(blocks=9, prior=True)  # 9 is padded to 10
    order = np.random.default_rng(0).permutation(9)
    turn = lambda tree: jax.tree.map(lambda x: x[order], tree)  # noqa: E731
    run = lambda y, d, pad: least_squares(case.problem, y, d, case.common, pad=pad, by_block=True)  # noqa: E731
    plain = run(case.y0, case.data, False)
    padded = run(case.y0, case.data, True)
    turned = run(ArrowVariables(case.y0.shared, turn(case.y0.local)), turn(case.data), True)
    z = flat_value(case, plain.value)
    np.testing.assert_allclose(flat_value(case, padded.value), z, rtol=1e-9)
    np.testing.assert_allclose(turned.value.shared["a"], plain.value.shared["a"], rtol=1e-9)
    np.testing.assert_allclose(turned.value.local["q"], plain.value.local["q"][order], rtol=1e-9)
    for other in (padded, turned):
        np.testing.assert_allclose(other.covariance.shared(), plain.covariance.shared(), rtol=1e-8)
        np.testing.assert_allclose(other.covariance.design_effect, plain.covariance.design_effect, rtol=1e-8)
        assert float(other.stats["degrees_of_freedom"]) == float(plain.stats["degrees_of_freedom"])


def test_scale_changes_the_path_and_not_the_optimum():
    with_scale, without = solved("scale")[3], flat_value(mixed_case(), least_squares(*_plain(mixed_case())).value)
    np.testing.assert_allclose(with_scale, without, rtol=1e-6, atol=1e-8)


def _plain(case):
    return case.problem, case.y0, case.data, case.common


@pytest.mark.parametrize("loss", ["huber", "cauchy"])
def test_robust_cost_and_optimum_are_scipys(loss):
    case = decay_case(noise=0.02)
    y = np.array(case.data["y"])
    y[1, 3] += 0.8  # two gross errors
    y[4, 7] -= 0.5
    case = replace(case, data={**case.data, "y": jnp.asarray(y)})
    width = 0.03

    def rows(shared, local, data, common):  # groups of one residual: shape (rows, 1)
        return case.problem.block(shared, local, data, common)[:, None]

    estimate = least_squares(
        ArrowProblem(robustify(rows, loss)), case.y0, case.data, (jnp.asarray(width), case.common), max_steps=200
    )
    assert estimate.success, estimate.sentence
    reference = dense(case)
    found = _scipy(reference, case, loss=loss, f_scale=width, max_nfev=2000)
    np.testing.assert_allclose(float(estimate.stats["cost"]), found.cost, rtol=1e-8)
    # scipy's own stopping rule limits this comparison.
    np.testing.assert_allclose(flat_value(case, estimate.value), found.x, rtol=1e-4, atol=1e-5)
    plain = solved("decay")[2]
    assert abs(float(estimate.value.shared["rate"] - plain.value.shared["rate"])) < 0.02  # outliers hardly move it


def test_no_shared_unknowns_are_solved_block_by_block():
    case = CASES["no shared"]()
    estimate = least_squares(*_plain(case), free=case.free)
    assert estimate.success
    reference = dense(case)
    found = _scipy(reference, case)
    np.testing.assert_allclose(flat_value(case, estimate.value), found.x, rtol=1e-6, atol=1e-8)
    assert estimate.covariance.shared().shape == (0, 0)
    r, J = reference.jacobian(flat_value(case, estimate.value), case.data, case.common)
    variance = r @ r / (len(r) - J.shape[1])
    own = J[:, reference.block_columns(2)]
    np.testing.assert_allclose(estimate.covariance.local(2), variance * np.linalg.inv(own.T @ own), rtol=1e-8)
