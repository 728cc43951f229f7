"""Covariance of an arrow estimate with the uncertainty of the numbers that were held.

A turntable is solved with the camera as its file has it, because everything that is measured later uses that file
too: an error of the principal point and the turn of the camera that makes up for it cancel there. What is stated
must all the same say how far the numbers are from the truth, so the camera's uncertainty is carried along: if the
held numbers c are off by d, the solution moves by G d with G = -(H_yy)^-1 H_yc.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from jaxmocap._programs import program
from jaxmocap.optim import ArrowProblem, ArrowVariables
from jaxmocap.optim.linearise import ArrowData, linearise
from jaxmocap.optim.packing import blocks_last, flatten, make_layout


class JointCovariance(NamedTuple):
    """Covariance of everything that was solved for: shared numbers first, then block after block."""

    total: Float[Array, "n n"]
    """Data and held numbers."""
    data: Float[Array, "n n"]
    """From the data alone, as if the held numbers were exact."""


def _inverse(A: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Inverse of a symmetric matrix whose rows have different units."""
    d = jnp.diagonal(A)
    d = 1.0 / jnp.sqrt(jnp.where(d > 0, d, 1.0))
    return jnp.linalg.inv(A * d[:, None] * d[None, :]) * d[:, None] * d[None, :]


@program
def joint_covariance(
    problem: ArrowProblem,
    value: ArrowVariables,
    free: ArrowVariables,
    held: ArrowVariables,
    data: PyTree,
    common: PyTree,
    weight: Float[Array, "blocks"],
    variance: Float[Array, ""],
    covariance_held: Float[Array, "held held"],
) -> JointCovariance:
    """Covariance of the free numbers when the held ones are known up to a covariance.

    Args:
        problem: as it was solved.
        value: the solution.
        free: flags of the numbers that were solved for.
        held: flags of shared numbers that were held though they are uncertain; False for all that is local.
        data: of the blocks.
        common: as it was solved.
        weight: 1 for blocks that count, else 0 (their rows of the result mean nothing).
        variance: of the residuals, with any inflation.
        covariance_held: of the held numbers, in the order of the flattened tree.

    Returns:
        JointCovariance.
    Source: first-order propagation through the normal equations; Triggs et al., Bundle Adjustment, 2000, section 6.
    """
    free_layout, held_layout = make_layout(value, free), make_layout(value, held)
    both = ArrowVariables(_either(free_layout.shared, held_layout.shared, value.shared), free.local)
    layout = make_layout(value, both)
    index_free, index_held, at = [], [], 0
    for f, h in zip(free_layout.shared, held_layout.shared):
        for is_free, is_held in zip(f, h):
            if is_free or is_held:
                (index_free if is_free else index_held).append(at)
                at += 1
    base = ArrowVariables(value.shared, blocks_last(value.local))
    n = linearise(problem, layout, flatten(layout, value), base, ArrowData(blocks_last(data), common, weight))
    ls, ll = jnp.moveaxis(n.ls, -1, 0), jnp.moveaxis(n.ll, -1, 0)
    nl, blocks = ll.shape[1], ll.shape[0]
    ll = jnp.where(weight[:, None, None] > 0, ll, jnp.eye(nl, dtype=ll.dtype)[None])
    inverse = jax.vmap(_inverse)(ll)
    T = jnp.einsum("bij,bjs->bis", inverse, ls)
    S = n.ss - jnp.einsum("bls,blt->st", ls, T)
    F, C = jnp.asarray(index_free), jnp.asarray(index_held, dtype=int)
    unit = _inverse(S[F][:, F])
    T_free = T[:, :, F].reshape(blocks * nl, -1)
    alone = jnp.einsum("bij,bc->bicj", inverse, jnp.eye(blocks, dtype=ll.dtype))
    corner = alone.reshape(blocks * nl, blocks * nl)
    cross = -unit @ T_free.T
    from_data = variance * jnp.block([[unit, cross], [cross.T, corner + T_free @ unit @ T_free.T]])
    G_shared = -unit @ S[F][:, C]
    G_local = -(T[:, :, C].reshape(blocks * nl, -1) + T_free @ G_shared)
    G = jnp.concatenate([G_shared, G_local])
    return JointCovariance(from_data + G @ covariance_held @ G.T, from_data)


def _either(a: tuple[tuple[bool, ...], ...], b: tuple[tuple[bool, ...], ...], shared: PyTree) -> PyTree:
    """Flags of either layout in the tree of the shared variables."""
    leaves, tree = jax.tree.flatten(shared)
    flags = [np.array(x) | np.array(y) for x, y in zip(a, b)]
    return jax.tree.unflatten(tree, [f.reshape(np.shape(leaf)) for f, leaf in zip(flags, leaves)])
