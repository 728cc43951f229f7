"""The calibration matrix K: from normalised image coordinates to pixels and back."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmocap._arrays import Matrix3, Vector2


class Intrinsics(eqx.Module):
    r"""K = [[fx, skew, cx], [0, fy, cy], [0, 0, 1]].

    u = fx x + skew y + cx, v = fy y + cy, with (0, 0) the centre of the top-left pixel. Every number is a leaf of
    its own, so each can be frozen, scaled and given a sigma by itself.

    Source: optical tracking document, eq. 4.10 (alpha, beta, s, u0, v0) and 4.18.
    """

    fx: Float[Array, "*batch"]
    """Focal length in units of the pixel width [px]."""
    fy: Float[Array, "*batch"]
    """Focal length in units of the pixel height [px]."""
    cx: Float[Array, "*batch"]
    """Principal point, horizontal [px]."""
    cy: Float[Array, "*batch"]
    """Principal point, vertical [px]."""
    skew: Float[Array, "*batch"]
    """K[0][1] [px]."""

    @classmethod
    def from_matrix(cls, K: Matrix3) -> "Intrinsics":
        """Intrinsics of a matrix with K[2, 2] = 1 (its lower triangle is not looked at)."""
        return cls(fx=K[0, 0], fy=K[1, 1], cx=K[0, 2], cy=K[1, 2], skew=K[0, 1])

    def matrix(self) -> Matrix3:
        """K [px]."""
        zero, one = jnp.zeros_like(self.fx), jnp.ones_like(self.fx)
        return jnp.stack(
            [
                jnp.stack([self.fx, self.skew, self.cx]),
                jnp.stack([zero, self.fy, self.cy]),
                jnp.stack([zero, zero, one]),
            ]
        )

    def pixel_from_normalised(self, xy: Vector2) -> Vector2:
        """Pixel of a normalised image point. Source: eq. 4.18."""
        return jnp.stack([self.fx * xy[0] + self.skew * xy[1] + self.cx, self.fy * xy[1] + self.cy])

    def normalised_from_pixel(self, uv: Vector2) -> Vector2:
        """Normalised image point of a pixel, K^-1 applied in closed form. Source: eq. 4.18."""
        y = (uv[1] - self.cy) / self.fy
        return jnp.stack([(uv[0] - self.cx - self.skew * y) / self.fx, y])
