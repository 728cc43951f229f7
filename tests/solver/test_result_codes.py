"""Every result code is reached by a problem that deserves it, and none by one that does not."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arrow_problems import decay_case, mixed_case

from jaxmocap import InputError, SolveError
from jaxmocap.optim import ArrowProblem, ArrowVariables, least_squares
from jaxmocap.results import RESULTS


def _solve(case, **options):
    return least_squares(case.problem, case.y0, case.data, case.common, **options)


def _single(block, x, covariance=True, **options):
    """One shared number, one block without unknowns of its own that matter."""
    y0 = ArrowVariables({"x": jnp.asarray(x)}, {"l": jnp.zeros(1)})
    free = ArrowVariables({"x": True}, {"l": False})
    return least_squares(ArrowProblem(block), y0, {"d": jnp.zeros(1)}, free=free, covariance=covariance, **options)


def test_not_finite_at_start():
    case = decay_case()
    y = np.array(case.data["y"])
    y[0, 0] = np.nan
    estimate = least_squares(case.problem, case.y0, {**case.data, "y": jnp.asarray(y)}, case.common)
    assert estimate.result == RESULTS.not_finite_at_start
    assert not estimate.success and "not finite at the start" in estimate.sentence
    with pytest.raises(SolveError, match="not finite at the start"):
        estimate.check()


def test_out_of_steps_and_history():
    estimate = _solve(decay_case(), max_steps=2)
    assert estimate.result == RESULTS.out_of_steps
    assert int(estimate.stats["steps"]) == 2
    with pytest.raises(SolveError, match="used all its steps"):
        _solve(decay_case(), max_steps=2, throw=True)


def test_enough_steps_exactly():
    needed = int(_solve(decay_case()).stats["steps"])
    assert _solve(decay_case(), max_steps=needed).success


def jump(shared, local, data, common):
    """Slope everywhere, but any move raises it."""
    x = shared["x"]
    return jnp.stack([x + 1000.0 * (x != 1.0).astype(x.dtype), 3.0 + 0.0 * x])


def test_stalled():
    estimate = _single(jump, 1.0)
    assert estimate.result == RESULTS.stalled, estimate.sentence


def only_sum(shared, local, data, common):
    return shared["a"] * data["t"] + shared["b"] * data["t"] + local["l"] - data["y"]


def only_local_sum(shared, local, data, common):
    return (shared["a"] + shared["b"] * data["t"]) * data["t"] + 0.7 * local["l"] + 0.3 * local["m"] - data["y"]


def unseen_local(shared, local, data, common):
    return (shared["a"] + shared["b"] * data["t"]) * data["t"] + local["l"] + 0.0 * local["m"] - data["y"]


@pytest.mark.parametrize("block", [only_sum, only_local_sum, unseen_local])
def test_undetermined(block):
    rng = np.random.default_rng(0)
    data = {"t": jnp.asarray(rng.normal(size=(5, 4))), "y": jnp.asarray(rng.normal(size=(5, 4)))}
    y0 = ArrowVariables({"a": jnp.asarray(0.1), "b": jnp.asarray(0.2)}, {"l": jnp.zeros(5), "m": jnp.zeros(5)})
    free = ArrowVariables(True, {"l": True, "m": block is not only_sum})
    estimate = least_squares(ArrowProblem(block), y0, data, free=free)
    assert estimate.result == RESULTS.undetermined, (estimate.sentence, estimate.covariance.local(0))


def nearly_same(shared, local, data, common):
    """Two shared numbers that differ in effect by one part in 10^5: badly determined, but determined."""
    return shared["a"] * data["t"] + shared["b"] * (data["t"] + 1e-5 * data["y"]) + local["l"] - data["y"]


def test_badly_determined_is_not_undetermined():
    rng = np.random.default_rng(0)
    data = {"t": jnp.asarray(rng.normal(size=(5, 4))), "y": jnp.asarray(rng.normal(size=(5, 4)))}
    y0 = ArrowVariables({"a": jnp.asarray(0.1), "b": jnp.asarray(0.2)}, {"l": jnp.zeros(5)})
    assert least_squares(ArrowProblem(nearly_same), y0, data).success


def test_too_few_observations():
    case = mixed_case(blocks=3, rows=6)  # 18 residuals, 4 + 3 * 4 unknowns
    assert _solve(case).success
    estimate = _solve(case, count=15.0)
    assert estimate.result == RESULTS.too_few_observations
    fewer = jax.tree.map(lambda x: x[:, :4], case.data)  # 12 residuals: singular, too
    short = least_squares(case.problem, case.y0, fewer, case.common)
    assert short.result == RESULTS.too_few_observations, short.sentence


def test_history_goes_down_and_progress_is_called():
    seen = []
    case = decay_case()
    estimate = least_squares(
        case.problem,
        case.y0,
        case.data,
        case.common,
        progress=lambda *numbers: seen.append([float(x) for x in numbers]),
    )
    jax.effects_barrier()
    steps = int(estimate.stats["steps"])
    history = np.asarray(estimate.stats["cost_history"])
    np.testing.assert_array_equal(np.isfinite(history), np.arange(len(history)) < steps)
    assert np.all(np.diff(history[:steps]) <= 1e-13 * history[: steps - 1])
    np.testing.assert_allclose(history[steps - 1], float(estimate.stats["cost"]))
    assert [int(step) for step, _, _ in seen] == list(range(steps))
    np.testing.assert_array_equal([cost for _, cost, _ in seen], history[:steps])


def test_zero_residual_problem_converges():
    estimate = _solve(decay_case(noise=0.0))
    assert estimate.success, estimate.sentence
    np.testing.assert_allclose(estimate.value.shared["rate"], np.log(0.8), rtol=1e-10)
    assert float(estimate.stats["cost"]) < 1e-25
    again = least_squares(decay_case(noise=0.0).problem, estimate.value, *_data(decay_case(noise=0.0)))
    assert again.success and int(again.stats["steps"]) <= 3


def _data(case):
    return case.data, case.common


def valley(shared, local, data, common):
    """Rosenbrock's valley, steeper: steps are rejected again and again on the way."""
    x = shared["x"]
    return jnp.stack([1.0 - x[0], 100.0 * (x[1] - x[0] ** 2)])


def wall(shared, local, data, common):
    """Steps beyond x = 2 are infinite: the damping must rise by ten orders before one is accepted."""
    x = shared["x"]
    return jnp.stack([1e-3 * (x - 100.0), jnp.where(x < 2.0, 0.0, 1e6) + 0.0 * x])


def test_rejected_steps_do_not_stop_it():
    estimate = _single(valley, np.array([-1.2, 1.0]), covariance=False)
    np.testing.assert_allclose(estimate.value.shared["x"], [1.0, 1.0], rtol=1e-9)
    at_wall = _single(wall, 2.0 - 1e-12, covariance=False)
    # Nothing is to be gained beyond the wall, but the gradient is not zero: this is no optimum.
    assert not at_wall.success


def test_far_start_with_bad_scale_does_not_settle_at_once():
    """Damping measured by scales that are far too small makes tiny steps: they must not pass for convergence."""
    case = decay_case()
    small = jax.tree.map(lambda x: jnp.full(np.shape(x), 1e-5), case.y0)
    estimate = _solve(case, scale=small, max_steps=200)
    good = _solve(case)
    np.testing.assert_allclose(float(estimate.stats["cost"]), float(good.stats["cost"]), rtol=1e-9)


def test_wrong_calls_are_named():
    case = decay_case()
    with pytest.raises(InputError, match="leading axis of 6 blocks"):
        least_squares(case.problem, case.y0, {"t": case.data["t"][:5], "y": case.data["y"][:5]}, case.common)
    with pytest.raises(InputError, match="leading block axis"):
        least_squares(
            case.problem, ArrowVariables(case.y0.shared, {"height": jnp.ones(6), "floor": jnp.ones(5)}), case.data
        )
    with pytest.raises(InputError, match="at least one free"):
        _solve(case, free=ArrowVariables(False, False))
    with pytest.raises(InputError, match=r"free\.shared"):
        _solve(case, free=ArrowVariables({"speed": True}, True))
