"""What was seen in the pictures: fixed shapes, masks for what was not seen."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float


class PixelObservations(eqx.Module):
    """Pixels with a mask and a standard deviation. Missing is `visible=False`, never NaN."""

    uv: Float[Array, "*batch 2"]
    """Raw (distorted) pixels, (0, 0) the centre of the top-left one; any finite number where not visible."""
    visible: Bool[Array, "*batch"]
    """True where something was seen."""
    sigma: Float[Array, "*batch"]
    """Standard deviation per coordinate [px]; positive also where not visible."""

    @classmethod
    def of(
        cls,
        uv: Float[Array, "*batch 2"],
        visible: Bool[Array, "*batch"] | None = None,
        sigma: float = 1.0,
    ) -> "PixelObservations":
        """Observations of one sigma; visible everywhere if no mask is given."""
        uv = jnp.asarray(uv)
        seen = jnp.ones(uv.shape[:-1], bool) if visible is None else jnp.asarray(visible)
        # A double `where` at the source: what is not visible is a plain zero from here on.
        return cls(jnp.where(seen[..., None], uv, 0.0), seen, jnp.full(uv.shape[:-1], sigma, uv.dtype))
