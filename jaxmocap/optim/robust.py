"""Robust losses as a change of residuals: half the sum of squares of the new ones is the robust cost.

Residuals come in groups (the u and v of one point). With s = |r|^2 of a group and loss rho(s), the group becomes
r sqrt(rho(s) / s): its squared length is rho(s), so any least-squares machinery minimises the robust cost exactly,
and derivatives through the solution are those of the robust estimate.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxmocap._errors import InputError

Loss = Literal["huber", "cauchy"]

# 95 % efficiency on Gaussian residuals: Huber 1981; Holland and Welsch 1977.
TUNING = {"huber": 1.345, "cauchy": 2.385}


def rho(loss: Loss, s: Float[Array, "*groups"], width: Float[Array, ""]) -> Float[Array, "*groups"]:
    """Loss of a squared residual length; s for small s.

    Args:
        loss: "huber" or "cauchy".
        s: squared length [sigma^2].
        width: where the loss leaves the parabola [sigma].

    Returns:
        rho(s), concave and increasing.
    Source: Huber 1981; Cauchy: Holland and Welsch 1977.
    """
    w2 = width * width
    if loss == "huber":
        outside = s > w2
        return jnp.where(outside, 2.0 * width * jnp.sqrt(jnp.where(outside, s, 1.0)) - w2, s)
    return w2 * jnp.log1p(s / w2)


def weight(loss: Loss, s: Float[Array, "*groups"], width: Float[Array, ""]) -> Float[Array, "*groups"]:
    """Derivative of rho: 1 for an observation that counts fully, towards 0 for an outlier."""
    if loss == "huber":
        outside = s > width * width
        return jnp.where(outside, width / jnp.sqrt(jnp.where(outside, s, 1.0)), 1.0)
    return 1.0 / (1.0 + s / (width * width))


def apply(loss: Loss, r: Float[Array, "groups d"], width: Float[Array, ""]) -> Float[Array, "groups d"]:
    """Residuals whose squares sum to the robust loss of each group; finite derivatives at r = 0."""
    s = jnp.sum(r * r, axis=1)
    away = s > 1e-12 * width * width
    s_safe = jnp.where(away, s, 1.0)
    factor = jnp.where(away, jnp.sqrt(rho(loss, s_safe, width) / s_safe), 1.0)
    return r * factor[:, None]


def variance_factors(
    loss: Loss, s: Float[Array, "groups"], seen: Float[Array, "groups"], width: Float[Array, ""], d: int
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    r"""What turns the covariance of the changed residuals into that of the robust estimate.

    With psi(r) = w(s) r the estimate's covariance is E[psi^2] / E[psi']^2 (J^T J)^-1 per coordinate, where the changed
    residuals give (m J^T J)^-1, m the mean square of their derivative by r.

    Args:
        loss: "huber" or "cauchy".
        s: squared residual lengths [sigma^2].
        seen: 1 where the group counts, else 0.
        width: of the loss [sigma].
        d: residuals in a group.
    Returns:
        m E[psi^2] / E[psi']^2: stands in for the residual variance [sigma^2].
        m / E[psi']: by what a leave-one-out move of the changed residuals is too small.
    Source: Huber 1981, eq. 6.6 of chapter 7 (asymptotic covariance of M-estimates).
    """
    n = jnp.maximum(jnp.sum(seen), 1.0)
    mean = lambda x: jnp.sum(jnp.where(seen > 0, x, 0.0)) / n  # noqa: E731
    s = jnp.maximum(s, 1e-12 * width * width)
    w = weight(loss, s, width)
    slope = jax.vmap(jax.grad(lambda x: weight(loss, x, width)))(s)
    g = jnp.sqrt(rho(loss, s, width) / s)
    radial = w / g  # d(r g)/dr along r: sqrt(rho)' = w r / sqrt(rho)
    m = mean(radial**2 + (d - 1) * g**2) / d
    psi_squared, psi_slope = mean(w * w * s) / d, mean(w + 2.0 * s * slope / d)
    return m * psi_squared / psi_slope**2, m / psi_slope


@lru_cache(maxsize=64)
def robustify(block: Callable[[Any, Any, Any, Any], Array], loss: Loss) -> Callable[[Any, Any, Any, Any], Array]:
    """The block function with a robust loss; `common` becomes (width [sigma], common).

    Cached, so that the same block gives the same function and nothing is compiled twice.

    Raises:
        InputError: if the loss has no such name.
    """
    if loss not in TUNING:
        raise InputError(f"loss: expected one of {sorted(TUNING)}, got {loss!r}")

    def robust_block(shared: Any, local: Any, data: Any, common: Any) -> Array:
        width, inner = common
        r = block(shared, local, data, inner)
        return apply(loss, jnp.reshape(r, (-1, r.shape[-1])), width)

    return robust_block


def scale_from_data(r: Float[Array, "groups d"], seen: Bool[Array, "groups"] | np.ndarray) -> Float[Array, ""]:
    """Robust sigma per coordinate of residual groups, from the median length.

    Args:
        r: residuals [px].
        seen: True where the group counts.

    Returns:
        sigma [px]; the median length of a d-dimensional Gaussian is sigma sqrt(chi2_d median): 0.6745 for d = 1,
        1.1774 for d = 2, 1.5382 for d = 3.

    Raises:
        InputError: for groups of more than three.
    """
    medians = {1: 0.67448975, 2: 1.17741002, 3: 1.53817225}
    d = r.shape[1]
    if d not in medians:
        raise InputError(f"r: expected groups of 1, 2 or 3 residuals, got {d}")
    length = jnp.where(seen, jnp.sqrt(jax.lax.stop_gradient(jnp.sum(r * r, axis=1))), jnp.nan)
    return jnp.nanmedian(length) / medians[d]
