"""One point refined to the smallest reprojection error, with covariance; and which of its views are not of it."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxmocap._arrays import Flag, Matrix3, Scalar, Vector3
from jaxmocap.cameras import Camera, pixel_of_point
from jaxmocap.observations import PixelObservations
from jaxmocap.optim import robust
from jaxmocap.reconstruction.triangulation import fit_point_linear, midpoint, rays

_ROUNDS = 4
_STEPS = 12  # from a linear start Gauss-Newton doubles the digits in each of the last steps; 5 suffice without outliers


class RefinedPoint(eqx.Module):
    """A point and what is known of it."""

    p_world: Float[Array, "*batch 3"]
    """[scene]; zero where not valid."""
    covariance: Float[Array, "*batch 3 3"]
    """[scene^2], for the stated sigma of the pixels; infinite where not valid."""
    residual: Float[Array, "*batch views 2"]
    """Measured minus predicted [px]; zero where not seen."""
    chi2: Float[Array, "*batch"]
    """Sum of squared residuals in units of sigma; 2 views - 3 degrees of freedom if the loss is plain."""
    views: Float[Array, "*batch"]
    """Number of views used."""
    valid: Bool[Array, "*batch"]
    """False with fewer than two views, parallel rays, or a point that ends up behind a camera."""


def _residuals(cameras: Camera, seen: PixelObservations, use: Array, p: Array) -> Array:
    """(views, 2) predicted minus measured in units of sigma; zero where the view does not count."""
    uv = jax.vmap(lambda c: pixel_of_point(c.intrinsics, c.distortion, c.T_camera_world.act(p)))(cameras)
    return jnp.where(use[:, None], (uv - seen.uv) / seen.sigma[:, None], 0.0)


def _descend(residual: Any, p: Array, steps: int) -> Array:
    """Damped Gauss-Newton steps from p."""

    def body(carry: tuple[Array, Array, Array, Array], _: None):
        p, trial, cost, damping = carry
        r, J = residual(trial), jax.jacfwd(residual)(trial)
        better = jnp.sum(r * r) < cost
        A, g = J.T @ J, J.T @ r
        D = jnp.diag(jnp.where(jnp.diagonal(A) > 0, jnp.diagonal(A), 1.0))
        damping = damping * jnp.where(better, 0.1, 20.0)
        step = jnp.linalg.solve(A + damping * D, g)
        p, cost = jnp.where(better, trial, p), jnp.where(better, jnp.sum(r * r), cost)
        return (p, jnp.where(better, p - step, 0.5 * (p + trial)), cost, damping), None

    start = (p, p, jnp.full_like(p[0], jnp.inf), jnp.full_like(p[0], 1e-4))
    (p, _, _, _), _ = jax.lax.scan(body, start, None, length=steps)
    return p


def refine_point(
    cameras: Camera, seen: PixelObservations, loss: robust.Loss | None = None, width: float | None = None
) -> RefinedPoint:
    """The point of the smallest reprojection error.

    Unbatched; `jax.vmap` over `seen` gives many points. Derivatives are those of the minimum (implicit function
    theorem, exact Hessian), not of the steps that led there.

    Args:
        cameras: stacked over views.
        seen: (views,) raw pixels with mask and sigma [px].
        loss: None for least squares, else "cauchy" or "huber".
        width: of the loss [sigma]; None: 95 % efficient.

    Returns:
        RefinedPoint; with a robust loss its covariance counts each view by its weight.
    Source: stop-motion document, 5.2 (least squares of its 5.11, in the image instead of in space); optical tracking
        document, 4.4 (refinement).
    """
    return _refine(cameras, seen, rays(cameras, seen.uv, seen.visible), loss, width)


def _refine(
    cameras: Camera,
    seen: PixelObservations,
    from_pixels: tuple[Array, Array, Array],
    loss: robust.Loss | None = None,
    width: float | None = None,
) -> RefinedPoint:
    """`refine_point` with the rays given."""
    centre, v, inside = from_pixels
    start, determined = fit_point_linear(centre, v, inside & seen.visible)
    use = inside & seen.visible & determined
    fixed = jax.lax.stop_gradient((cameras, seen, start))

    def residual_of(cameras: Camera, seen: PixelObservations, p: Array) -> Array:
        r = _residuals(cameras, seen, use, p)
        if loss is not None:
            r = robust.apply(loss, r, jnp.asarray(robust.TUNING[loss] if width is None else width, r.dtype))
        return r.reshape(-1)

    p = jax.lax.stop_gradient(_descend(lambda p: residual_of(fixed[0], fixed[1], p), fixed[2], _STEPS))

    def cost(p: Array, cameras: Camera, seen: PixelObservations) -> Scalar:
        r = residual_of(cameras, seen, p)
        return 0.5 * jnp.sum(r * r)

    # One Newton step from the minimum: no move, but its derivative is that of the minimum.
    H = jax.lax.stop_gradient(jax.hessian(cost)(p, *fixed[:2]))
    H = jnp.where(determined, H, jnp.eye(3, dtype=H.dtype))
    p = p - jnp.linalg.solve(H, jax.grad(cost)(p, cameras, seen))
    return _described(cameras, seen, use, p, determined, loss, width)


def _described(
    cameras: Camera,
    seen: PixelObservations,
    use: Array,
    p: Vector3,
    determined: Flag,
    loss: robust.Loss | None,
    width: float | None,
) -> RefinedPoint:
    r = _residuals(cameras, seen, use, p)
    J = jax.jacfwd(lambda q: _residuals(cameras, seen, use, q))(p)
    w = jnp.ones_like(r[:, 0])
    if loss is not None:
        w = robust.weight(loss, jnp.sum(r * r, axis=1), jnp.asarray(width or robust.TUNING[loss], r.dtype))
    information = jnp.einsum("vai,v,vaj->ij", J, w, J)
    in_front = jnp.all(jnp.where(use, jax.vmap(lambda c: c.T_camera_world.act(p)[2] > 0)(cameras), True))
    valid = determined & in_front & jnp.all(jnp.isfinite(p))
    covariance = _inverse(jnp.where(valid, information, jnp.eye(3, dtype=p.dtype)))
    return RefinedPoint(
        p_world=jnp.where(valid, p, 0.0),
        covariance=jnp.where(valid, covariance, jnp.inf),
        residual=jnp.where(valid, -r * seen.sigma[:, None], 0.0),
        chi2=jnp.where(valid, jnp.sum(r * r), 0.0),
        views=jnp.sum(use.astype(p.dtype)),
        valid=valid,
    )


def _inverse(A: Matrix3) -> Matrix3:
    d = 1.0 / jnp.sqrt(jnp.diagonal(A))
    return jnp.linalg.inv(A * d[:, None] * d[None, :]) * d[:, None] * d[None, :]


class ViewVerdict(eqx.Module):
    """Which views of one point show something else."""

    wrong: Bool[Array, "*batch views"]
    """Named: too far from where the other views say the point is."""
    probability: Float[Array, "*batch views"]
    """Of a right view being as far from the others or farther (1: not judged)."""
    consistent: Bool[Array, "*batch"]
    """Whether the views that are left agree; False with two views means one of them is wrong, but not which."""
    point: RefinedPoint
    """Plain least squares from the views that are left."""


def name_wrong_views(cameras: Camera, seen: PixelObservations, *, false_alarm: float = 1e-3) -> ViewVerdict:
    r"""Views in which another thing was taken for the point.

    It begins with the pair of views whose point the others agree with best. Then, four times, the point is refined
    from the views that are kept, and every view is judged by its distance d from where the OTHER kept views say the
    point must be, with the covariance of both: a right view is farther off with probability exp(-d^2 / 2). Kept are
    those for which n times that is not below `false_alarm` (Bonferroni, n views). What is left is consistent if its
    own sum of squares is not less probable than `false_alarm`.

    Args:
        cameras: stacked over views.
        seen: (views,) raw pixels; sigma must be honest, since it is what a distance is measured by.
        false_alarm: probability that a point whose views are all right loses one.

    Returns:
        ViewVerdict; unbatched, use `jax.vmap`. With two views nobody is named.
    Source: Fischler and Bolles 1981 (consensus), with all pairs instead of random ones; Barnett and Lewis, Outliers
        in Statistical Data, 1994, chapter 8; the stop-motion document's 8.2 asks for wrong names to be found.
    """
    from_pixels = rays(cameras, seen.uv, seen.visible)

    def judge(keep: Array, _: None) -> tuple[Array, tuple[Array, RefinedPoint, Array]]:
        point = _refine(cameras, PixelObservations(seen.uv, keep, seen.sigma), from_pixels)
        use = seen.visible & from_pixels[2]
        n = jnp.sum(use.astype(seen.sigma.dtype))
        judged = use & point.valid & (n >= 3)
        p = jnp.where(judged, jnp.exp(-0.5 * _distance2(cameras, seen, keep, point)), 1.0)
        return jnp.where(point.valid, use & (p * n >= false_alarm), keep), (keep, point, p)

    _, rounds = jax.lax.scan(judge, _best_pair(cameras, seen, from_pixels), None, length=_ROUNDS)
    keep, point, p = jax.tree.map(lambda x: x[-1], rounds)
    freedom = jnp.maximum(2.0 * point.views - 3.0, 1.0)
    tail = jax.scipy.special.gammaincc(0.5 * freedom, 0.5 * point.chi2)
    return ViewVerdict(seen.visible & ~keep, p, (tail >= false_alarm) | ~point.valid, point)


def _best_pair(cameras: Camera, seen: PixelObservations, from_pixels: tuple[Array, Array, Array]) -> Array:
    """The two views whose point the others agree with best (least Cauchy loss); all views if no more than two count."""
    centre, v, inside = from_pixels
    use = inside & seen.visible
    i, j = np.triu_indices(len(seen.uv), 1)
    points, _, crossing = jax.vmap(midpoint)(centre[i], v[i], centre[j], v[j])

    def loss(p: Array) -> Scalar:
        r = _residuals(cameras, seen, use, p)
        return jnp.sum(jnp.log1p(jnp.sum(r * r, axis=1) / robust.TUNING["cauchy"] ** 2))

    possible = use[i] & use[j] & crossing
    best = jnp.argmin(jnp.where(possible, jax.vmap(loss)(points), jnp.inf))
    index = jnp.arange(len(seen.uv))
    pair = (index == jnp.asarray(i)[best]) | (index == jnp.asarray(j)[best])
    return jnp.where(jnp.any(possible) & (jnp.sum(use) > 2), pair, use)


def _distance2(cameras: Camera, seen: PixelObservations, keep: Array, point: RefinedPoint) -> Float[Array, "views"]:
    """Squared distance of each view from what the other kept views say, in units of its standard deviation.

    For a view that is not kept the covariance of the difference is 1 + J C J^T; a kept one has pulled the point to
    itself, and its residual r has covariance 1 - J C J^T: r^T (1 - J C J^T)^-1 r is by how much the sum of squares
    falls without it, to first order.
    """

    def residual(p: Array) -> Array:
        return _residuals(cameras, seen, seen.visible, p)

    r, J = residual(point.p_world), jax.jacfwd(residual)(point.p_world)
    C = jnp.where(point.valid, point.covariance, 0.0)
    sign = jnp.where(keep, -1.0, 1.0)[:, None, None]
    S = jnp.eye(2, dtype=r.dtype)[None] + sign * jnp.einsum("vai,ij,vbj->vab", J, C, J)
    a, b, d = S[:, 0, 0], S[:, 0, 1], S[:, 1, 1]
    determinant = a * d - b * b
    # Singular: the other views leave the point free in some direction, and say nothing of this view along it.
    usable = determinant > 1e-9
    inverse_r = jnp.stack([d * r[:, 0] - b * r[:, 1], a * r[:, 1] - b * r[:, 0]], axis=1)
    return jnp.where(usable, jnp.sum(r * inverse_r, axis=1) / jnp.where(usable, determinant, 1.0), 0.0)
