"""What `least_squares` refuses, and blocks that do not count."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arrow_problems import mixed_case

from jaxmocap._errors import InputError
from jaxmocap.optim import ArrowVariables, least_squares
from jaxmocap.optim.checks import check_arguments, check_precision
from jaxmocap.optim.packing import make_layout

CASE = mixed_case(blocks=7)
SINGLE = jax.tree.map(lambda x: x.astype(jnp.float32), CASE.y0)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"y0": (CASE.y0.shared, CASE.y0.local)}, r"y0: expected ArrowVariables.*got tuple"),
        ({"y0": SINGLE}, r"y0.shared\['a'\]: expected float64, got float32"),
        ({"y0": ArrowVariables(CASE.y0.shared, SINGLE.local)}, r"y0.local\['p'\]: expected float64, got float32"),
        ({"free": True}, r"free: expected ArrowVariables.*got bool"),
        ({"scale": ArrowVariables(CASE.y0.shared, ())}, r"scale: expected the tree of y0"),
        ({"scale": ArrowVariables({"a": 1.0, "b": 1.0}, CASE.y0.local)}, r"scale.*'a'.*expected shape \(3,\)"),
        ({"weight": jnp.ones(5)}, r"weight: expected shape \(7,\).*got \(5,\)"),
        ({"weight": 1.0}, r"weight: expected shape \(7,\).*got \(\)"),
        ({"data": {**CASE.data, "d": CASE.data["d"][:5]}}, r"data: expected a leading axis of 7"),
    ],
)
def test_wrong_calls_name_the_argument(changed, said):
    # Asked of the checks themselves: in tests, types are checked at every public call before its first line.
    arguments = {"y0": CASE.y0, "data": CASE.data, "free": None, "scale": None, "weight": None, **changed}
    with pytest.raises(InputError, match=said):
        check_arguments(**arguments)
        check_precision(arguments["y0"], make_layout(arguments["y0"], None))


def test_whole_numbers_do_no_harm_where_they_are_frozen():
    y0 = ArrowVariables({**CASE.y0.shared, "b": jnp.asarray(1)}, CASE.y0.local)
    check_precision(y0, make_layout(y0, ArrowVariables({"a": True, "b": False}, True)))
    with pytest.raises(InputError, match=r"y0.shared\['b'\]: expected float64, got int64"):
        least_squares(CASE.problem, y0, CASE.data, CASE.common)


@pytest.mark.parametrize("spoilt", [np.nan, np.inf])
def test_a_block_that_does_not_count_may_hold_anything(spoilt):
    """Value, cost and derivative are those of the problem without it; its own unknowns keep their start."""
    gone = np.array([0, 3])
    kept = np.delete(np.arange(7), gone)
    few = replace(CASE, y0=ArrowVariables(CASE.y0.shared, jax.tree.map(lambda x: x[kept], CASE.y0.local)))
    weight = jnp.ones(7).at[gone].set(0.0)

    def solve(d):
        data = {**CASE.data, "d": d}
        estimate = least_squares(CASE.problem, CASE.y0, data, CASE.common, weight=weight, covariance=False)
        return jnp.sum(estimate.value.shared["a"]), estimate

    bad = CASE.data["d"].at[gone].set(spoilt)
    slope, estimate = jax.jit(jax.grad(solve, has_aux=True))(bad)
    alone = least_squares(CASE.problem, few.y0, jax.tree.map(lambda x: x[kept], CASE.data), CASE.common)
    np.testing.assert_allclose(estimate.value.shared["a"], alone.value.shared["a"], rtol=1e-8)
    np.testing.assert_allclose(estimate.stats["cost"], alone.stats["cost"], rtol=1e-10)
    np.testing.assert_array_equal(estimate.value.local["q"][gone], CASE.y0.local["q"][gone])
    np.testing.assert_allclose(estimate.value.local["q"][kept], alone.value.local["q"], rtol=1e-6)
    assert np.all(np.isfinite(slope)) and not slope[gone].any() and slope[kept].any()
