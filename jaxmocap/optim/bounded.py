"""Least squares within bounds: L-BFGS-B of jaxopt, checked, and sharpened by Newton steps on what is not at a bound.

The only file that imports jaxopt, and only when it is called: it is unmaintained, warns on import, mixes precisions,
and calls a start that is not finite solved. Its answer is therefore never believed: cost and gradient are computed
again here.
"""

import warnings
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxmocap._arrays import require_x64
from jaxmocap._errors import InputError
from jaxmocap.results import RESULTS

_POLISH = 12  # Gauss-Newton steps on the free numbers; each squares the error of a problem with small residuals
_SETTLED = 1e-6  # largest step still wanted [units of x's scale] for "settled"


class BoundedSolution(eqx.Module):
    """Where the sum of squares is smallest within the bounds."""

    x: Float[Array, "n"]
    cost: Float[Array, ""]
    """Half the sum of squared residuals."""
    at_bound: Bool[Array, "n"]
    """Numbers that a bound holds back."""
    result: RESULTS


def _jaxopt_start(cost: Callable[[Array], Array], x: Array, lower: Array, upper: Array, max_steps: int) -> Array:
    """Answer of jaxopt's L-BFGS-B, or the start where it is not finite."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="JAXopt is no longer maintained", category=DeprecationWarning)
        import jaxopt
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        solver = jaxopt.LBFGSB(fun=cost, maxiter=max_steps, tol=1e-6)
        found = solver.run(x, bounds=(lower, upper)).params
    return jnp.where(jnp.all(jnp.isfinite(found)), jnp.clip(found, lower, upper), x)


def _held(x: Array, g: Array, lower: Array, upper: Array) -> Array:
    """Numbers at a bound whose gradient pushes them against it."""
    return ((x <= lower) & (g >= 0)) | ((x >= upper) & (g <= 0))


def _newton(residual: Callable[[Array], Array], x: Array, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Step wanted by the free numbers, and which are held."""
    r, J = residual(x), jax.jacfwd(residual)(x)
    g = J.T @ r
    held = _held(x, g, lower, upper)
    free = (~held).astype(x.dtype)
    A = (J.T @ J) * free[:, None] * free[None, :]
    d = jnp.diagonal(A)
    A = A + jnp.diag(jnp.where(d > 0, 1e-12 * d, 1.0))
    return -jnp.linalg.solve(A, g * free), held


@eqx.filter_jit
def _solve(
    residual: Callable[[Array, Any], Array], x0: Array, lower: Array, upper: Array, args: Any, max_steps: int
) -> tuple[Array, Array, Array, Array, Array]:
    of = lambda x: residual(x, args)  # noqa: E731
    cost = lambda x: 0.5 * jnp.sum(of(x) ** 2)  # noqa: E731
    x = _jaxopt_start(cost, x0, lower, upper, max_steps)
    x = jnp.where(cost(x) <= cost(x0), x, x0)

    def polish(_: Any, x: Array) -> Array:
        step, _held_back = _newton(of, x, lower, upper)
        tries = jnp.stack([jnp.clip(x + f * step, lower, upper) for f in (1.0, 0.25)])
        best = tries[jnp.argmin(jax.vmap(cost)(tries))]
        return jnp.where(cost(best) < cost(x), best, x)

    x = jax.lax.fori_loop(0, _POLISH, polish, x)
    step, held = _newton(of, x, lower, upper)
    return x, cost(x), held, jnp.max(jnp.abs(jnp.clip(x + step, lower, upper) - x)), cost(x0)


def bounded_least_squares(
    residual: Callable[[Float[Array, "n"], Any], Float[Array, "rows"]],
    x0: Float[Array, "n"],
    lower: Array,
    upper: Array,
    args: Any = None,
    *,
    max_steps: int = 200,
) -> BoundedSolution:
    """Minimise half the sum of squared residuals with lower <= x <= upper.

    Args:
        residual: (x, args) -> residuals in units of sigma; x of order 1 (radians, or lengths in typical lengths).
        x0: start; moved into the bounds.
        lower: -inf where there is none.
        upper: +inf where there is none.
        args: handed to `residual`.
        max_steps: of the L-BFGS-B iteration.

    Returns:
        BoundedSolution; `result` says out_of_steps where the numbers that no bound holds still want to move.

    Raises:
        InputError: shapes that differ, a start or a bound that is NaN, a lower bound above the upper one, 32-bit mode.
    Source: Byrd, Lu, Nocedal, Zhu, SIAM J. Scientific Computing 16(5), 1995 (L-BFGS-B); projected Gauss-Newton:
        Bertsekas, SIAM J. Control and Optimization 20(2), 1982.
    """
    require_x64("bounded_least_squares")
    start, low, high = (np.asarray(a, dtype=float) for a in (x0, lower, upper))
    if not start.shape == low.shape == high.shape or start.ndim != 1:
        raise InputError(
            f"x0, lower, upper: expected three vectors of one size, got {start.shape, low.shape, high.shape}"
        )
    if not np.isfinite(start).all() or np.isnan(low).any() or np.isnan(high).any():
        raise InputError("x0, lower, upper: expected numbers, got NaN (or an infinite start)")
    if (low > high).any():
        first = int(np.argmax(low > high))
        raise InputError(f"lower: expected at most the upper bound, got {low[first]} > {high[first]} at index {first}")
    clipped = jnp.asarray(np.clip(start, low, high))
    x, cost, held, wanted, first_cost = _solve(residual, clipped, jnp.asarray(low), jnp.asarray(high), args, max_steps)
    result = RESULTS.successful
    if not np.isfinite(float(first_cost)):
        result = RESULTS.not_finite_at_start
    elif not float(wanted) < _SETTLED:
        result = RESULTS.out_of_steps
    return BoundedSolution(x, cost, held, result)
