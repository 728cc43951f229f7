"""Levenberg-Marquardt for arrow problems, as an optimistix descent and an optimistix solver.

The only file that knows optimistix' solver interface. `ArrowDescent` obtains the blocks in `query` (once per
accepted point) and re-damps and solves in `step` (once per trial), as optimistix' own damped Newton descent does;
`ArrowLevenbergMarquardt` evaluates a trial by its residuals alone and linearises only what it accepts, which
`optx.AbstractGaussNewton` would do for every trial.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int, PyTree

from jaxmocap.optim.linearise import ArrowData, ArrowProblem, NormalEquations, cost, linearise, no_normal_equations
from jaxmocap.optim.packing import ArrowVariables, Flat, Layout, unflatten_last
from jaxmocap.optim.schur import damped_step

# Codes of the solver state, translated to RESULTS by optim.least_squares.
GOING, CONVERGED, STALLED, NOT_FINITE = 0, 1, 2, 3

_FIRST_DAMPING = 1e-4  # Marquardt 1963 starts at 1e-2; start values here come from a linear solution
_LARGEST_DAMPING = 1e16
_ACCEPT_RATIO = 1e-4  # More 1978, the MINPACK value
_STILL_SETTLED = 1e-9  # where no step helps any more: a decrease below this fraction is lost in rounding residuals


class ArrowInfo(optx.FunctionInfo):
    """What the descent is told about an accepted point."""

    normal: NormalEquations
    cost: Float[Array, ""]

    def as_min(self) -> Float[Array, ""]:
        """Half the sum of squares."""
        return self.cost


class _DescentState(eqx.Module):
    normal: NormalEquations
    D: Flat


class ArrowDescent(optx.AbstractDescent):
    """Damped Gauss-Newton step by Schur complement; the damping is 1 / step_size."""

    scale: Flat | None
    """Typical size of every free number; None: the Jacobian's column norms, as Marquardt and MINPACK do."""

    def init(self, y: Flat, f_info_struct: ArrowInfo) -> _DescentState:
        """Zeros of the right shapes."""
        empty = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), f_info_struct.normal)
        return _DescentState(empty, jax.tree.map(jnp.ones_like, y))

    def query(self, y: Flat, f_info: ArrowInfo, state: _DescentState) -> _DescentState:
        """Keep the normal equations and the diagonal that damping is measured by."""
        del y, state
        normal = f_info.normal
        if self.scale is None:
            D = Flat(jnp.diagonal(normal.ss), jnp.moveaxis(jnp.diagonal(normal.ll), -1, 0))
            # A parameter that no residual sees has a zero diagonal; any positive number keeps it where it is.
            D = jax.tree.map(lambda d: jnp.where(d > 0, d, 1.0), D)
        else:
            D = jax.tree.map(lambda s: 1.0 / s**2, self.scale)
        return _DescentState(normal, D)

    def step(self, step_size: Float[Array, ""], state: _DescentState) -> tuple[Flat, optx.RESULTS]:
        """The damped step."""
        return damped_step(state.normal, 1.0 / step_size, state.D.shared, state.D.local), optx.RESULTS.successful


class SolverState(eqx.Module):
    """Evolving state of the solver."""

    descent: _DescentState
    cost: Float[Array, ""]
    damping: Float[Array, ""]
    growth: Float[Array, ""]
    stale: Bool[Array, ""]
    status: Int[Array, ""]
    steps: Int[Array, ""]
    linearisations: Int[Array, ""]
    cost_history: Float[Array, "steps"]
    damping_history: Float[Array, "steps"]


def _dot(a: Flat, b: Flat) -> Float[Array, ""]:
    return jnp.sum(a.shared * b.shared) + jnp.sum(a.local * b.local)


def _finite(y: Flat) -> Bool[Array, ""]:
    return jnp.all(jnp.isfinite(y.shared)) & jnp.all(jnp.isfinite(y.local))


class ArrowLevenbergMarquardt(optx.AbstractLeastSquaresSolver):
    r"""Levenberg-Marquardt on blocks.

    Settles when the decrease still predicted along the step, were it not damped, is below `rtol` of the cost or
    below `atol` (the cost is in units of sigma^2, so 1e-20 is a step of 1e-10 sigma). A trial whose predicted
    decrease is lost in the rounding of the cost counts as settled, not as a rejection.

    Source: optical tracking document, algorithm 3; More 1978; Nielsen 1999 (damping schedule).
    """

    rtol: float
    atol: float
    norm: Callable[[PyTree], Float[Array, ""]]
    problem: ArrowProblem
    layout: Layout = eqx.field(static=True)
    descent: ArrowDescent
    history: int = eqx.field(static=True)
    """Length of the recorded history = largest number of steps."""
    linearise_last: bool = eqx.field(static=True)
    """Also linearise at the solution (for the covariance)."""
    progress: Callable[[Any, Any, Any], None] | None = eqx.field(static=True)
    """Called from the host with (step, cost, damping) after every trial."""

    def init(self, fn, y, args, options, f_struct, aux_struct, tags) -> SolverState:
        """State before the first linearisation."""
        del fn, options, f_struct, aux_struct, tags
        nan = jnp.full((self.history,), jnp.nan, y.shared.dtype)
        return SolverState(
            descent=self.descent.init(y, ArrowInfo(no_normal_equations(y), jnp.zeros((), y.shared.dtype))),
            cost=self._cost(y, args),
            damping=jnp.asarray(_FIRST_DAMPING, y.shared.dtype),
            growth=jnp.asarray(2.0, y.shared.dtype),
            stale=jnp.array(True),
            status=jnp.array(GOING),
            steps=jnp.array(0),
            linearisations=jnp.array(0),
            cost_history=nan,
            damping_history=nan,
        )

    def _cost(self, y: Flat, args: tuple[ArrowVariables, ArrowData]) -> Float[Array, ""]:
        base, data = args
        return cost(self.problem, unflatten_last(self.layout, y, base), data)

    def step(self, fn, y, args, options, state: SolverState, tags):
        """Linearise if the last trial was accepted, then try one damped step."""
        del fn, options, tags
        base, data = args

        def fresh() -> _DescentState:
            normal = linearise(self.problem, self.layout, y, base, data)
            return self.descent.query(y, ArrowInfo(normal, state.cost), state.descent)

        descent = jax.lax.cond(state.stale, fresh, lambda: state.descent)
        delta, _ = self.descent.step(1.0 / state.damping, descent)
        g = Flat(descent.normal.g_s, descent.normal.g_l)
        scaled = Flat(descent.D.shared * delta.shared, descent.D.local * delta.local)
        slope, curved = _dot(g, delta), -_dot(g, delta) - state.damping * _dot(delta, scaled)
        predicted = 0.5 * (state.damping * _dot(delta, scaled) - slope)
        # Decrease along the step if it were not damped: a step that is short because it is damped settles nothing.
        below = lambda limit: 0.5 * slope * slope <= limit * jnp.maximum(curved, 0.0)  # noqa: E731
        y_trial = Flat(y.shared + delta.shared, y.local + delta.local)
        cost_trial = self._cost(y_trial, args)
        usable = _finite(delta) & jnp.isfinite(cost_trial)
        # Rounding of a sum of squares: what is below this cannot be seen in the cost.
        lost = predicted <= 1e-13 * state.cost
        gain = state.cost - cost_trial
        better = usable & (gain > _ACCEPT_RATIO * predicted)
        same = usable & lost & (cost_trial <= state.cost * (1.0 + 1e-13))
        accept = (better | same) & (state.status == GOING)
        settled = usable & below(self.rtol * state.cost + self.atol)
        settled = settled | (usable & lost & ~accept & below(1e-13 * state.cost))

        ratio = jnp.clip(gain / jnp.where(predicted > 0, predicted, 1.0), 0.0, 1.0)
        shrink = jnp.maximum(0.1, 1.0 - (2.0 * ratio - 1.0) ** 3)
        damping = jnp.where(accept, state.damping * shrink, state.damping * state.growth)
        growth = jnp.where(accept, 2.0, state.growth * 2.0)
        exhausted = damping > _LARGEST_DAMPING
        settled = settled | (exhausted & below(_STILL_SETTLED * state.cost + self.atol))
        status = jnp.where(settled, CONVERGED, jnp.where(exhausted, STALLED, GOING))
        status = jnp.where(jnp.isfinite(state.cost), status, NOT_FINITE)
        status = jnp.where(state.status == GOING, status, state.status)
        new_cost = jnp.where(accept, cost_trial, state.cost)
        going = state.status == GOING  # else this step was only taken to linearise at the solution
        if self.progress is not None:
            tell = partial(jax.debug.callback, self.progress)
            jax.lax.cond(going, tell, lambda *_: None, state.steps, new_cost, state.damping)
        at = jnp.where(going, state.steps, self.history)
        keep = lambda a, b: jnp.where(accept, a, b)  # noqa: E731
        new_y = Flat(keep(y_trial.shared, y.shared), keep(y_trial.local, y.local))
        new_state = SolverState(
            descent=descent,
            cost=new_cost,
            damping=jnp.clip(damping, 1e-15, None),
            growth=growth,
            stale=accept,
            status=status,
            steps=state.steps + jnp.where(going, 1, 0),
            linearisations=state.linearisations + jnp.where(state.stale, 1, 0),
            cost_history=state.cost_history.at[at].set(new_cost, mode="drop"),
            damping_history=state.damping_history.at[at].set(state.damping, mode="drop"),
        )
        return new_y, new_state, None

    def terminate(self, fn, y, args, options, state: SolverState, tags):
        """Settled (and, if asked for, linearised there), stalled, not finite, or out of steps."""
        del fn, y, args, options, tags
        done = (state.status != GOING) | (state.steps >= self.history)
        if self.linearise_last:
            done = done & ~(state.stale & (state.status == CONVERGED))
        return done, optx.RESULTS.successful

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        """Nothing to do."""
        del fn, args, options, state, tags, result
        return y, aux, {}
