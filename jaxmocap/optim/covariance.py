"""Covariance of an arrow estimate from the Schur factors, plain and allowing for correlation within blocks.

Plain: s^2 (H^-1), with s^2 the residual variance; right if residuals are independent. Corners of one photograph are
not: blur, lighting and a board that is not flat move them together. Leaving out one block after the other (to first
order, from the same factors) gives a covariance that holds whatever happens within a block, but a noisy one: with
n blocks its every element has a relative error of about sqrt(2/n). What is stated is therefore the plain
covariance times ONE number, the mean ratio of the two across all parameters (the design effect of sampling theory),
and only where it exceeds 1 by more than chance makes of independent residuals. The plain jackknife would be too
large by half with ten photographs, since each left out weakens the rest; the ratio used here has mean 1 exactly when
residuals are independent. scripts/simulate_calibration.py shows what the intervals then cover.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxmocap.optim.linearise import (
    ArrowData,
    ArrowProblem,
    NormalEquations,
    block_jacobians,
    chunk_size,
    chunk_start,
    cut_chunk,
    residuals,
)
from jaxmocap.optim.packing import ArrowVariables, Flat, Layout, unflatten_last
from jaxmocap.optim.schur import backward_blocks, eliminate, solve_positive

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
    """Mean ratio of the variance seen between blocks to the plain one; 1 where not computed."""
    chance: Float[Array, ""]
    """Standard deviation of the design effect when residuals are independent; 0 where not computed."""
    determined: Bool[Array, ""]
    """False if the normal equations are singular; the numbers are then meaningless."""

    @property
    def inflation(self) -> Float[Array, ""]:
        """What the stated covariance is multiplied with: the design effect, or 1 if that may be chance."""
        return jnp.where(self.design_effect > 1.0 + self.chance, self.design_effect, 1.0)

    def shared_plain(self) -> Float[Array, "ns ns"]:
        """Covariance of the free shared parameters for independent residuals."""
        return self.variance * self.unit_shared

    def shared(self) -> Float[Array, "ns ns"]:
        """Stated covariance of the free shared parameters, in the order of the flattened tree."""
        return self.inflation * self.shared_plain()

    def cross(self, block: int | Int[Array, ""]) -> Float[Array, "nl ns"]:
        """Covariance between the free parameters of one block and the shared ones."""
        return -self.T[:, :, block] @ self.shared()

    def local(self, block: int | Int[Array, ""]) -> Float[Array, "nl nl"]:
        """Stated covariance of the free parameters of one block, shared uncertainty included."""
        L, T = self.L[:, :, block], self.T[:, :, block]
        half = jax.scipy.linalg.solve_triangular(L, jnp.eye(L.shape[0], dtype=L.dtype), lower=True)
        return self.inflation * self.variance * (half.T @ half) + T @ self.shared() @ T.T


@jax.custom_jvp
def _inverse(A: Float[Array, "n n"]) -> tuple[Float[Array, "n n"], Float[Array, ""]]:
    """Inverse of a symmetric matrix of unit size where its eigenvalues are not rounding, and the smallest of them."""
    values, vectors = jnp.linalg.eigh(A)
    return (vectors / jnp.where(values > _SINGULAR, values, jnp.inf)[None, :]) @ vectors.T, values[0]


@_inverse.defjvp
def _inverse_jvp(primals: tuple[Array], tangents: tuple[Array]) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    # Through the eigenvectors it would divide by differences of eigenvalues.
    inverse, smallest = _inverse(*primals)
    return (inverse, smallest), (-inverse @ tangents[0] @ inverse, jnp.zeros_like(smallest))


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
    inverse, smallest = _inverse(jnp.where(finite, reduced, jnp.eye(ns, dtype=reduced.dtype)))
    regular = regular_l & finite & (smallest > _SINGULAR) & jnp.all(d > 0)
    unit = inverse * scale[:, None] * scale[None, :]
    # What is not determined is not known at all, rather than perfectly.
    return jnp.where(regular, unit, jnp.inf), factors.L, T, regular


def _leave_one_out(
    problem: ArrowProblem,
    layout: Layout,
    y: Flat,
    base: ArrowVariables,
    data: ArrowData,
    unit: Float[Array, "ns ns"],
    T: Float[Array, "nl ns blocks"],
) -> tuple[Float[Array, "ns ns"], Float[Array, ""], Float[Array, ""]]:
    r"""Jackknife covariance of the shared parameters, each block left out to first order, and its design effect.

    Without block i the normal equations are S - S_i and the gradient -u_i, so the estimate moves by
    d_i = (S - S_i)^-1 u_i = C (I - C^T S_i C)^-1 C^T u_i with S^-1 = C C^T. For independent
    residuals of variance s^2 the covariance of u_i is s^2 (S_i - S_i S^-1 S_i), so u_i . d_i has mean
    s^2 tr(S^-1 S_i): the sum over i of u_i . d_i / s^2 has mean ns exactly and variance 2 sum tr((S^-1 S_i)^2),
    blocks taken as independent of one another.

    Returns:
        jackknife covariance (infinite if one block alone determines something), sum of u_i . d_i, sum of
        tr((S^-1 S_i)^2).
    Source: Efron and Tibshirani, An Introduction to the Bootstrap, 1993, chapter 11; Bell and McCaffrey 2002 (CR3;
        the trace is that of their CR2, whose square root drops out of it).
    """
    full = unflatten_last(layout, y, base)
    blocks, ns = y.local.shape[1], layout.shared_size
    # The solver's chunks, so that its trace of the block Jacobian serves here too.
    rows = jax.eval_shape(lambda: residuals(problem, full, data)).shape[0]
    size = chunk_size(ns + layout.local_size, rows, blocks)
    half = jnp.linalg.cholesky(unit)  # in units of it S is the identity, and what is solved is symmetric
    solve = jax.vmap(solve_positive, (-1, -1), -1)

    def body(chunk: Array, total: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        start, counts = chunk_start(chunk, size, blocks)
        local, block_data, w, T_chunk = cut_chunk((full.local, data.blocks, data.weight, T), start, size)
        part = ArrowData(block_data, data.common, w)
        r, J_s, J_l = block_jacobians(problem, layout, ArrowVariables(full.shared, local), part)
        # Shared columns with their part along the block's own columns removed.
        J = jnp.einsum("st,srb->trb", half, J_s - jnp.einsum("lrb,lsb->srb", J_l, T_chunk))
        S_i = jnp.einsum("srb,trb->stb", J, J)
        u = jnp.einsum("srb,rb->sb", J, r)
        used = w > 0 if counts is None else (w > 0) & (counts > 0)
        move = jnp.where(used, solve(jnp.eye(ns, dtype=u.dtype)[:, :, None] - S_i, u), 0.0)
        leverage = jnp.sum(jnp.where(used, S_i * S_i, 0.0))
        new = (move @ move.T, jnp.sum(move, axis=1), jnp.sum(u * move), leverage)
        return jax.tree.map(jnp.add, total, new)

    zero = tuple(jnp.zeros(shape, y.shared.dtype) for shape in ((ns, ns), (ns,), (), ()))
    squares, total, seen, leverage = jax.lax.fori_loop(0, -(-blocks // size), body, zero)
    n = jnp.sum(data.weight)
    mean = total / n
    spread = half @ (squares - n * jnp.outer(mean, mean)) @ half.T
    return jnp.where(jnp.all(jnp.isfinite(spread)), (n - 1.0) / n * spread, jnp.inf), seen, leverage


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
    loo, effect, chance = None, jnp.ones((), y.shared.dtype), jnp.zeros((), y.shared.dtype)
    ns = layout.shared_size
    if by_block and ns:
        loo, seen, leverage = _leave_one_out(problem, layout, y, base, data, unit, T)
        ratio = seen / (ns * variance)
        usable = (jnp.sum(data.weight) >= 3) & jnp.isfinite(ratio)
        effect = jnp.where(usable, ratio, 1.0)
        chance = jnp.where(usable, jnp.sqrt(2.0 * leverage) / ns, 0.0)
    return ArrowCovariance(unit, L, T, variance, loo, effect, chance, regular)
