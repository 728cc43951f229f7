"""Lens distortion in normalised coordinates, its inverse, and the radius within which it can be inverted."""

import abc
from collections.abc import Callable
from functools import partial
from typing import cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmocap._arrays import Flag, Scalar, Vector2


class AbstractDistortion(eqx.Module):
    """A map from ideal to real normalised image coordinates. Subclasses are final."""

    @abc.abstractmethod
    def distort(self, xy: Vector2) -> Vector2:
        """Where the lens images the ideal point xy [1]."""

    @abc.abstractmethod
    def valid_radius_squared(self) -> Scalar:
        """Squared ideal radius [1] below which `distort` can be inverted; infinite if it can everywhere."""

    def undistort(self, xy: Vector2) -> tuple[Vector2, Flag]:
        """The ideal point that the lens images at xy: see `undistort`."""
        return undistort(self, xy)


class BrownDistortion(AbstractDistortion):
    r"""Radial and tangential distortion; the numbers and their meaning are OpenCV's.

    x_d = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2), y_d alike with p1 and p2 exchanged.
    The field order k1 k2 p1 p2 k3 is that of files.

    Source: optical tracking document, eq. 4.16-4.17 (kappa1, kappa2, kappa3); Brown 1966 for p1, p2.
    """

    k1: Float[Array, "*batch"]
    """kappa1, coefficient of r^2 [1]."""
    k2: Float[Array, "*batch"]
    """kappa2, coefficient of r^4 [1]."""
    p1: Float[Array, "*batch"]
    """First tangential coefficient [1]."""
    p2: Float[Array, "*batch"]
    """Second tangential coefficient [1]."""
    k3: Float[Array, "*batch"]
    """kappa3, coefficient of r^6 [1]."""

    @classmethod
    def none(cls) -> "BrownDistortion":
        """The ideal lens."""
        return cls(*(jnp.zeros(()) for _ in range(5)))

    @classmethod
    def from_vector(cls, k: Float[Array, "5"]) -> "BrownDistortion":
        """Distortion of the five numbers k1 k2 p1 p2 k3."""
        return cls(k[0], k[1], k[2], k[3], k[4])

    def vector(self) -> Float[Array, "5"]:
        """The five numbers k1 k2 p1 p2 k3."""
        return jnp.stack([self.k1, self.k2, self.p1, self.p2, self.k3])

    def distort(self, xy: Vector2) -> Vector2:
        """Where the lens images the ideal point xy [1]. Source: eq. 4.16-4.17."""
        x, y = xy[0], xy[1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        return jnp.stack(
            [
                x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
                y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
            ]
        )

    def valid_radius_squared(self) -> Scalar:
        r"""Squared ideal radius up to which the real radius grows with the ideal one.

        The smallest positive root in s = r^2 of d(r L(r^2))/dr = 1 + 3 k1 s + 5 k2 s^2 + 7 k3 s^3. The tangential
        part is left out: it tilts the circle by the order of p1, p2, and `undistort` checks the full model point
        by point.

        Returns:
            s [1], infinite when the radius grows everywhere.
        """
        return _smallest_positive_root(3.0 * self.k1, 5.0 * self.k2, 7.0 * self.k3)


def _smallest_positive_root(a: Scalar, b: Scalar, c: Scalar) -> Scalar:
    """Smallest positive root of 1 + a s + b s^2 + c s^3, or infinity. Exact to rounding; not differentiated.

    Substituting w = 1/s gives p(w) = w^3 + a w^2 + b w + c, whose LARGEST positive root is wanted: a cubic with
    leading coefficient 1 whatever of a, b, c is zero. Whether there is one, and between which bounds, is read from
    the turning points of p; Cardano's formulas cannot tell a root 0 from a small one.
    """
    a, b, c = (jax.lax.stop_gradient(jnp.asarray(v)) for v in (a, b, c))
    discriminant = a * a - 3.0 * b
    far = -(a + jnp.where(a >= 0, 1.0, -1.0) * jnp.sqrt(jnp.maximum(discriminant, 0.0))) / 3.0
    near = jnp.where(far != 0, b / jnp.where(far != 0, 3.0 * far, 1.0), 0.0)
    top, bottom = jnp.minimum(far, near), jnp.maximum(far, near)  # p rises, falls between these, rises again
    turns = discriminant > 0
    dips = turns & (bottom > 0) & (((bottom + a) * bottom + b) * bottom + c <= 0)
    bound = 2.0 * jnp.maximum(jnp.maximum(jnp.abs(a), jnp.sqrt(jnp.abs(b))), jnp.cbrt(jnp.abs(c)))
    low = jnp.where(dips, bottom, 0.0)
    high = jnp.where(turns & ~dips & (top > 0), top, bound)
    exists = dips | (c < 0)
    w = _rising_root(lambda w: ((w + a) * w + b) * w + c, low, high, exists)
    found = exists & (w > 0)
    return jnp.where(found, 1.0 / jnp.where(found, w, 1.0), jnp.inf)


def _rising_root(p: Callable[[Scalar], Scalar], low: Scalar, high: Scalar, exists: Flag) -> Scalar:
    """Root of a function that rises from low to high: Newton's method, halving the bracket where it would leave it.

    Returns:
        The root; `high` where `exists` is False or the function stays below 0.
    """

    def body(carry):
        low, high, w, _, k = carry
        value, slope = jax.jvp(p, (w,), (jnp.ones_like(w),))
        low, high = jnp.where(value <= 0, w, low), jnp.where(value <= 0, high, w)
        newton = w - value / jnp.where(slope > 0, slope, 1.0)
        new = jnp.where((slope > 0) & (newton > low) & (newton < high), newton, 0.5 * (low + high))
        new = jnp.where(value == 0, w, new)
        return low, high, new, jnp.abs(new - w), k + 1

    def going(carry):
        _, _, w, change, k = carry
        return exists & (k < 100) & (change > 1e-15 * w)

    return jax.lax.while_loop(going, body, (low, high, high, jnp.full_like(high, jnp.inf), 0))[2]


_MAX_NEWTON = 30


def _radial_start(lens: AbstractDistortion, xy: Vector2, limit: Scalar) -> Vector2:
    """Point on the line through xy that the lens images at the radius of xy: the inverse of a purely radial lens.

    Newton's method in the plane from xy itself runs in circles where the lens first stretches and then squeezes.
    """
    radius = jnp.sqrt(jnp.sum(xy * xy))
    unit = xy / jnp.where(radius > 0, radius, 1.0)

    def excess(r: Scalar) -> Scalar:
        return jnp.sum(unit * lens.distort(r * unit)) - radius

    def too_small(carry):
        high, k = carry
        return (k < 60) & (high < limit) & (excess(high) < 0)

    high = jax.lax.while_loop(too_small, lambda carry: (2.0 * carry[0], carry[1] + 1), (radius, 0))[0]
    root = _rising_root(excess, jnp.zeros_like(radius), jnp.minimum(high, limit), radius > 0)
    return root * unit


def _newton(lens: AbstractDistortion, xy: Vector2) -> Vector2:
    """Ideal point of a real one by Newton's method, kept inside the invertible radius."""
    limit = jnp.sqrt(lens.valid_radius_squared())

    def inside(m: Vector2) -> Vector2:
        r = jnp.sqrt(jnp.sum(m * m))
        keep = jnp.where(r > limit, 0.999 * limit / jnp.where(r > 0, r, 1.0), 1.0)
        return m * jnp.where(jnp.isfinite(limit), keep, 1.0)

    def body(carry):
        m, _, k = carry
        J = jax.jacfwd(lens.distort)(m)
        r = lens.distort(m) - xy
        det = J[0, 0] * J[1, 1] - J[0, 1] * J[1, 0]
        det = jnp.where(jnp.abs(det) > 1e-12, det, 1e-12)
        step = jnp.stack([J[1, 1] * r[0] - J[0, 1] * r[1], J[0, 0] * r[1] - J[1, 0] * r[0]]) / det
        new = inside(m - step)
        return new, jnp.max(jnp.abs(new - m)), k + 1

    def going(carry):
        m, change, k = carry
        return (k < _MAX_NEWTON) & (change > 1e-15 * (1.0 + jnp.max(jnp.abs(m))))

    start = inside(_radial_start(lens, xy, limit))
    return jax.lax.while_loop(going, body, (start, jnp.full((), jnp.inf, xy.dtype), 0))[0]


@eqx.filter_custom_jvp
def _inverse(lens: AbstractDistortion, xy: Vector2) -> Vector2:
    return _newton(lens, xy)


@_inverse.def_jvp
def _inverse_jvp(primals, tangents):
    """Implicit function theorem: d(distort(m)) = d(xy) gives dm = J^-1 (d xy - d_lens distort)."""
    lens, xy = primals
    t_lens, t_xy = tangents
    m = _inverse(lens, xy)
    J = jax.jacfwd(lens.distort)(m)
    right = jnp.zeros_like(m) if t_xy is None else t_xy
    dynamic, static = eqx.partition(lens, jax.tree.map(lambda t: t is not None, t_lens, is_leaf=_is_none))
    if jax.tree.leaves(dynamic):
        moved = jax.jvp(lambda d: eqx.combine(d, static).distort(m), (dynamic,), (t_lens,))[1]
        right = right - moved
    det = J[0, 0] * J[1, 1] - J[0, 1] * J[1, 0]
    det = jnp.where(jnp.abs(det) > 1e-12, det, 1e-12)
    t_m = jnp.stack([J[1, 1] * right[0] - J[0, 1] * right[1], J[0, 0] * right[1] - J[1, 0] * right[0]]) / det
    return m, t_m


def _is_none(leaf: object) -> bool:
    return leaf is None


def undistort(lens: AbstractDistortion, xy: Vector2) -> tuple[Vector2, Flag]:
    """The ideal point that the lens images at xy, by Newton's method with derivatives by the implicit function.

    Args:
        lens: any distortion.
        xy: real normalised point [1].

    Returns:
        ideal normalised point [1], right to rounding where valid; finite everywhere.
        valid: False where no ideal point inside the invertible radius is imaged at xy (the lens folds back).
    Source: optical tracking document, 4.3; its printed iteration (4.22-4.23) does not converge to the inverse and
        stands in closed_forms.undistortion.
    """
    m = _inverse(lens, xy)
    still = jax.lax.stop_gradient(m)
    miss = jnp.max(jnp.abs(lens.distort(still) - jax.lax.stop_gradient(xy)))
    # 1e-13 of the focal length is 1e-10 px for any focal length below 1000 px, 1e-9 px below 10,000.
    hit = miss <= 1e-13 * (1.0 + jnp.max(jnp.abs(xy)))
    return m, hit & (jnp.sum(still * still) < lens.valid_radius_squared())


def parameter_names(lens: AbstractDistortion) -> tuple[str, ...]:
    """Names of the numbers of a lens, in the order of its fields."""
    return tuple(cast(dict[str, object], lens.__dataclass_fields__))


undistort_many = partial(jax.vmap, in_axes=(None, 0))(undistort)
