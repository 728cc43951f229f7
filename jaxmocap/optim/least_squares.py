"""The one entry to structured least squares: freeze, scale, pad, solve, covariance -> Estimate."""

from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, PyTree

from jaxmocap._programs import program
from jaxmocap.optim import arrow_solver
from jaxmocap.optim.arrow_solver import ArrowDescent, ArrowLevenbergMarquardt
from jaxmocap.optim.checks import check_arguments, check_precision
from jaxmocap.optim.covariance import ArrowCovariance, arrow_covariance
from jaxmocap.optim.implicit import attach, follow
from jaxmocap.optim.linearise import ArrowData, ArrowProblem, cost, linearise, prior_residuals, residuals
from jaxmocap.optim.packing import (
    ArrowVariables,
    Flat,
    Layout,
    blocks_first,
    blocks_last,
    bucket,
    flatten,
    make_layout,
    unflatten_last,
)
from jaxmocap.results import RESULTS, Estimate


class _Options(eqx.Module):
    """Static choices of one solve."""

    max_steps: int = eqx.field(static=True)
    rtol: float = eqx.field(static=True)
    atol: float = eqx.field(static=True)
    covariance: bool = eqx.field(static=True)
    by_block: bool = eqx.field(static=True)
    progress: Callable[[Any, Any, Any], None] | None = eqx.field(static=True)


def _result_code(status: Array, determined: Array, freedom: Array) -> RESULTS:
    """Our code for the solver's status."""
    S = arrow_solver
    code = RESULTS.where(determined, RESULTS.successful, RESULTS.undetermined)
    code = RESULTS.where(freedom > 0, code, RESULTS.too_few_observations)
    code = RESULTS.where(status == S.STALLED, RESULTS.stalled, code)
    code = RESULTS.where(status == S.GOING, RESULTS.out_of_steps, code)
    return RESULTS.where(status == S.NOT_FINITE, RESULTS.not_finite_at_start, code)


@program
def _solve(
    problem: ArrowProblem,
    layout: Layout,
    base: ArrowVariables,
    data: ArrowData,
    scale: Flat | None,
    count: Float[Array, ""],
    options: _Options,
) -> tuple[ArrowVariables, Any, RESULTS, dict[str, Any]]:
    start = flatten(layout, ArrowVariables(base.shared, blocks_first(base.local)))
    still_base, still_data, start = jax.lax.stop_gradient((base, data, start))
    solver = ArrowLevenbergMarquardt(
        rtol=options.rtol,
        atol=options.atol,
        norm=optx.max_norm,
        problem=problem,
        layout=layout,
        descent=ArrowDescent(jax.lax.stop_gradient(scale)),
        history=options.max_steps,
        linearise_last=options.covariance,
        progress=options.progress,
    )

    def all_residuals(y: Flat, args: tuple[ArrowVariables, ArrowData]) -> tuple[Array, Array]:
        full = unflatten_last(layout, y, args[0])
        return residuals(problem, full, args[1]), prior_residuals(problem, full.shared, args[1])

    solution = optx.least_squares(
        all_residuals, solver, start, (still_base, still_data), max_steps=options.max_steps + 1, throw=False
    )
    y, state = jax.lax.stop_gradient((solution.value, solution.state))
    n_prior = jax.eval_shape(lambda: prior_residuals(problem, base.shared, data)).shape[0]
    parameters = layout.shared_size + layout.local_size * jnp.sum(data.weight)
    freedom = count + n_prior - parameters
    moving = attach(y, problem, layout, base, data)
    final = follow(state.cost, partial(_cost_at, problem, layout), (moving, base, data))
    variance = 2.0 * final / jnp.maximum(freedom, 1.0)
    determined, covariance = jnp.array(True), None
    if options.covariance:
        still = jax.lax.stop_gradient((y, base, data, variance))
        covariance = follow(
            arrow_covariance(problem, layout, *still[:3], state.descent.normal, still[3], options.by_block),
            partial(_covariance_at, problem, layout, options.by_block),
            (moving, base, data, variance),
        )
        determined = covariance.determined
    value = unflatten_last(layout, moving, base)
    stats = {
        "cost": final,
        "steps": state.steps,
        "linearisations": state.linearisations,
        "cost_history": state.cost_history,
        "damping_history": state.damping_history,
        "residual_variance": variance,
        "degrees_of_freedom": freedom,
    }
    # A start that is not finite never reaches the solver's first step.
    status = jnp.where(jnp.isfinite(state.cost), state.status, arrow_solver.NOT_FINITE)
    result = _result_code(status, determined, freedom)
    return ArrowVariables(value.shared, blocks_first(value.local)), covariance, result, stats


def _cost_at(problem: ArrowProblem, layout: Layout, y: Flat, base: ArrowVariables, data: ArrowData) -> Array:
    return cost(problem, unflatten_last(layout, y, base), data)


def _covariance_at(
    problem: ArrowProblem,
    layout: Layout,
    by_block: bool,
    y: Flat,
    base: ArrowVariables,
    data: ArrowData,
    variance: Float[Array, ""],
) -> ArrowCovariance:
    normal = linearise(problem, layout, y, base, data)
    return arrow_covariance(problem, layout, y, base, data, normal, variance, by_block)


def _pad_blocks(tree: PyTree, extra: int) -> PyTree:
    """Repeat the last block `extra` times (leading axis)."""
    if not extra:
        return jax.tree.map(jnp.asarray, tree)
    return jax.tree.map(lambda x: jnp.concatenate([x, jnp.repeat(jnp.asarray(x)[-1:], extra, axis=0)]), tree)


@program
def _arrange(
    y0: ArrowVariables, data: PyTree, common: PyTree, one: Float[Array, "blocks"], extra: int, all_count: bool
) -> tuple[ArrowVariables, ArrowData]:
    """Variables and data padded by `extra` blocks, block axes last: one small program instead of dozens."""
    local, of_blocks = _pad_blocks(y0.local, extra), _pad_blocks(data, extra)
    weight = jnp.concatenate([one, jnp.zeros((extra,))])
    if not all_count:
        # What does not count is replaced by a block that does: 0 times NaN would be NaN, also in derivatives.
        counting = jnp.where(weight > 0, jnp.arange(weight.size), jnp.argmax(weight > 0))
        local, of_blocks = jax.tree.map(lambda x: x[counting], (local, of_blocks))
    padded = ArrowVariables(jax.tree.map(jnp.asarray, y0.shared), blocks_last(local))
    return padded, ArrowData(blocks_last(of_blocks), jax.tree.map(jnp.asarray, common), weight)


def least_squares(
    problem: ArrowProblem,
    y0: ArrowVariables,
    data: PyTree,
    common: PyTree = None,
    *,
    free: ArrowVariables | None = None,
    scale: ArrowVariables | None = None,
    weight: Float[Array, "blocks"] | None = None,
    count: Float[Array, ""] | float | None = None,
    max_steps: int = 100,
    rtol: float = 1e-14,
    atol: float = 1e-20,
    covariance: bool = True,
    by_block: bool = False,
    progress: Callable[[Any, Any, Any], None] | None = None,
    pad: bool = True,
    throw: bool = False,
) -> Estimate:
    r"""Minimise half the sum of squared residuals of an arrow problem.

    Pure and differentiable: `jax.jvp`, `jax.vjp` (with respect to `data`, `common` and the frozen part of `y0`) and
    `jax.vmap` work on it. Derivatives are those of the solution, its cost, residual variance and covariance; the
    histories have none. The functions in `problem` must not close over differentiated values: pass those in
    `data` (per block) or `common`.

    Args:
        problem: residuals in units of sigma.
        y0: start; frozen entries keep their value.
        data: pytree with a leading block axis.
        common: pytree handed to every block.
        free: bools in the tree of y0 (for `local`: of one block); None: all free. Fix the gauge here.
        scale: typical sizes in the tree of y0, by which damping is measured; None: from the Jacobian.
        weight: 1 for blocks that count, 0 for those that do not, whose data may be anything and whose local
            unknowns keep their start; None: all count.
        count: number of scalar residuals that are not masked; None: all of them.
        max_steps: largest number of trial steps.
        rtol: settle when the predicted decrease is below this fraction of the cost.
        atol: or below this [sigma^2].
        covariance: also compute the covariance.
        by_block: let the stated covariance allow for correlation within blocks (see optim.covariance).
        progress: called with (step, cost, damping) after each trial.
        pad: round the number of blocks up, so that nearby sizes share one compilation.
        throw: raise SolveError if the solve fails.

    Returns:
        Estimate with value ArrowVariables.

    Raises:
        InputError: wrong trees, shapes or precision.
        SolveError: if `throw` and the solve failed.
    Source: optical tracking document, algorithm 3 and eq. 4.76 (the problems it serves).
    """
    blocks = check_arguments(y0, data, free, scale, weight)
    layout = make_layout(y0, free)
    check_precision(y0, layout)
    extra = bucket(blocks) - blocks if pad else 0
    one = jnp.ones((blocks,)) if weight is None else jnp.asarray(weight, dtype=float)
    if count is None:
        shape = jax.eval_shape(problem.block, *_one_block(y0, data, common)).shape
        count = jnp.sum(one) * float(np.prod(shape))
    padded, arrow_data = _arrange(y0, data, common, one, extra, weight is None)
    flat_scale = None
    if scale is not None:
        flat_scale = flatten(layout, ArrowVariables(scale.shared, _pad_blocks(scale.local, extra)))
    options = _Options(max_steps, rtol, atol, covariance, by_block, progress)
    value, cov, result, stats = _solve(
        problem, layout, padded, arrow_data, flat_scale, jnp.asarray(count, dtype=float), options
    )
    if extra:
        value = ArrowVariables(value.shared, jax.tree.map(lambda x: x[:blocks], value.local))
    if weight is not None:
        value = ArrowVariables(value.shared, _only_counting(one, value.local, y0.local))
    estimate = Estimate(value, cov, result, stats)
    return estimate.check() if throw else estimate


def _only_counting(weight: Float[Array, "blocks"], solved: PyTree, start: PyTree) -> PyTree:
    """The solved blocks where they count, the start where they do not."""
    counts = lambda x: jnp.reshape(weight > 0, (-1, *(1,) * (x.ndim - 1)))  # noqa: E731
    return jax.tree.map(lambda x, x0: jnp.where(counts(x), x, jnp.asarray(x0)), solved, start)


def _one_block(y: ArrowVariables, data: PyTree, common: PyTree) -> tuple[Any, Any, Any, Any]:
    first = lambda tree: jax.tree.map(lambda x: jnp.asarray(x)[0], tree)  # noqa: E731
    return y.shared, first(y.local), first(data), common
