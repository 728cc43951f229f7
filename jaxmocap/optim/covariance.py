"""Covariance of an arrow estimate from the Schur factors, plain and allowing for correlation within blocks.

Plain: s^2 (H^-1), with s^2 the residual variance; right if residuals are independent. Corners of one photograph are
not: blur, lighting and a board that is not flat move them together. Leaving out one block after the other (to first
order, from the same factors) gives a covariance that holds whatever happens within a block, but a noisy one: with
n blocks its every element has a relative error of about sqrt(2/n). What is stated is therefore the plain
covariance times ONE number, the mean of the leave-one-out variance over the plain one across all parameters
(the design effect of sampling theory), never below 1.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxmocap.optim.linearise import (
    ArrowData,
    ArrowProblem,
    NormalEquations,
    block_jacobians,
    chunk_size,
    split_chunks,
)
from jaxmocap.optim.packing import ArrowVariables, Flat, Layout, unflatten_last
from jaxmocap.optim.schur import backward_blocks, eliminate

# Smallest eigenvalue of the reduced matrix, relative to a unit diagonal before elimination, that is not rounding:
# the elimination subtracts numbers of size 1 with an error of a few eps = 2e-16 each.
_SINGULAR = 1e-13


class ArrowCovariance(eqx.Module):
    """Covariance of the free parameters, asked for by part."""

    unit_shared: Float[Array, "ns ns"]
    """Shared part for residuals of unit variance, S^-1."""
    L: Float[Array, "nl nl blocks"]
    """Cholesky factors of the local parts."""
    T: Float[Array, "nl ns blocks"]
    """How the local solution follows the shared one, H_ll^-1 H_ls."""
    variance: Float[Array, ""]
    """Residual variance s^2 = sum of squares / (observations - parameters)."""
    leave_one_out: Float[Array, "ns ns"] | None
    """Shared covariance from leaving out blocks, or None."""
    design_effect: Float[Array, ""]
    """Mean ratio of leave-one-out to plain variance; 1 where not computed."""
    determined: Bool[Array, ""]
    """False if the normal equations are singular; the numbers are then meaningless."""

    @property
    def inflation(self) -> Float[Array, ""]:
        """The design effect, never below 1: what the stated covariance is multiplied with."""
        return jnp.maximum(self.design_effect, 1.0)

    def shared_plain(self) -> Float[Array, "ns ns"]:
        """Covariance of the free shared parameters for independent residuals."""
        return self.variance * self.unit_shared

    def shared(self) -> Float[Array, "ns ns"]:
        """Stated covariance of the free shared parameters, in the order of the flattened tree."""
        return self.inflation * self.shared_plain()

    def cross(self, block: int) -> Float[Array, "nl ns"]:
        """Covariance between the free parameters of one block and the shared ones."""
        return -self.T[:, :, block] @ self.shared()

    def local(self, block: int) -> Float[Array, "nl nl"]:
        """Stated covariance of the free parameters of one block, shared uncertainty included."""
        L, T = self.L[:, :, block], self.T[:, :, block]
        half = jax.scipy.linalg.solve_triangular(L, jnp.eye(L.shape[0], dtype=L.dtype), lower=True)
        return self.inflation * self.variance * (half.T @ half) + T @ self.shared() @ T.T


def _unit(normal: NormalEquations, idle: Bool[Array, "blocks"]) -> tuple[Array, Array, Array, Array]:
    """S^-1, L, T and whether the matrix is regular; blocks that do not count (`idle`) may be singular."""
    diagonal = jnp.moveaxis(jnp.diagonal(normal.ll), -1, 0)
    factors, taken, _ = eliminate(normal, jnp.where(diagonal > 0, 0.0, 1.0))
    T = backward_blocks(factors.L, factors.W)
    ns = normal.ss.shape[0]
    pivots = jnp.moveaxis(jnp.diagonal(factors.L), -1, 0) ** 2
    regular_l = jnp.all((pivots > _SINGULAR * diagonal) & (diagonal > 0) | idle[None, :])
    if not ns:
        return normal.ss, factors.L, T, regular_l
    d = jnp.diagonal(normal.ss)
    scale = 1.0 / jnp.sqrt(jnp.where(d > 0, d, 1.0))
    reduced = (normal.ss - taken) * scale[:, None] * scale[None, :]
    finite = jnp.all(jnp.isfinite(reduced))
    values, vectors = jnp.linalg.eigh(jnp.where(finite, reduced, jnp.eye(ns, dtype=reduced.dtype)))
    regular = regular_l & finite & (values[0] > _SINGULAR) & jnp.all(d > 0)
    inverse = (vectors / jnp.where(values > _SINGULAR, values, jnp.inf)[None, :]) @ vectors.T
    return inverse * scale[:, None] * scale[None, :], factors.L, T, regular


def _leave_one_out(
    problem: ArrowProblem,
    layout: Layout,
    y: Flat,
    base: ArrowVariables,
    data: ArrowData,
    unit: Float[Array, "ns ns"],
    T: Float[Array, "nl ns blocks"],
) -> Float[Array, "ns ns"]:
    r"""Jackknife covariance of the shared parameters, each block left out to first order.

    Without block i the normal equations are S - S_i and the gradient -u_i, so the estimate moves by
    (S - S_i)^-1 u_i = (I - S^-1 S_i)^-1 S^-1 u_i.

    Source: Efron and Tibshirani, An Introduction to the Bootstrap, 1993, chapter 11; Bell and McCaffrey 2002 (CR3).
    """
    full = unflatten_last(layout, y, base)
    blocks, ns = y.local.shape[1], layout.shared_size
    size = chunk_size(ns + layout.local_size, max(ns, 16), blocks)
    chunks = split_chunks((full.local, data.blocks, data.weight, T), size)
    weight = jnp.where(np.arange(chunks[2].size).reshape(chunks[2].shape) < blocks, chunks[2], 0.0)

    def one(S_i: Array, u: Array) -> Array:
        return jnp.linalg.solve(jnp.eye(ns, dtype=u.dtype) - unit @ S_i, unit @ u)

    def body(total: tuple[Array, Array], chunk):
        local, block_data, w, T_chunk = chunk
        part = ArrowData(block_data, data.common, w)
        r, J_s, J_l = block_jacobians(problem, layout, ArrowVariables(full.shared, local), part)
        # Shared columns with their part along the block's own columns removed.
        J = J_s - jnp.einsum("lrb,lsb->srb", J_l, T_chunk)
        S_i = jnp.einsum("srb,trb->bst", J, J)
        u = jnp.einsum("srb,rb->bs", J, r)
        move = jnp.where(w[:, None] > 0, jax.vmap(one)(S_i, u), 0.0)
        return (total[0] + move.T @ move, total[1] + jnp.sum(move, axis=0)), None

    zero = (jnp.zeros((ns, ns), y.shared.dtype), jnp.zeros((ns,), y.shared.dtype))
    (squares, total), _ = jax.lax.scan(body, zero, (chunks[0], chunks[1], weight, chunks[3]))
    n = jnp.sum(data.weight)
    mean = total / n
    return (n - 1.0) / n * (squares - n * mean[:, None] * mean[None, :])


def arrow_covariance(
    problem: ArrowProblem,
    layout: Layout,
    y: Flat,
    base: ArrowVariables,
    data: ArrowData,
    normal: NormalEquations,
    variance: Float[Array, ""],
    by_block: bool,
) -> ArrowCovariance:
    """Covariance at a solution.

    Args:
        problem: residual functions.
        layout: which entries are free.
        y: solution.
        base: frozen numbers, block axis last.
        data: observations, block axis last.
        normal: undamped normal equations at the solution.
        variance: residual variance s^2 [sigma^2].
        by_block: also leave out blocks one by one (needs three blocks or more to mean anything).

    Returns:
        ArrowCovariance.
    Source: Triggs et al., Bundle Adjustment, 2000, section 6; module docstring for the stated one.
    """
    unit, L, T, regular = _unit(normal, data.weight == 0)
    loo, effect = None, jnp.ones((), y.shared.dtype)
    ns = layout.shared_size
    if by_block and ns:
        loo = _leave_one_out(problem, layout, y, base, data, unit, T)
        # trace(plain^-1 leave-one-out) / ns, in coordinates of unit diagonal so that px and 1/px^2 can be mixed.
        scale = 1.0 / jnp.sqrt(jnp.diagonal(unit))
        outer = scale[:, None] * scale[None, :]
        ratio = jnp.trace(jnp.linalg.solve(unit * outer, loo * outer)) / (ns * variance)
        effect = jnp.where((jnp.sum(data.weight) >= 3) & jnp.isfinite(ratio), ratio, 1.0)
    return ArrowCovariance(unit, L, T, variance, loo, effect, regular)
