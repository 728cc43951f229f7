"""Rigid poses. `T_a_b` takes coordinates in frame b to coordinates in frame a: p_a = T_a_b.act(p_b)."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmocap._arrays import Vector3
from jaxmocap.geometry import rotation


class Pose(eqx.Module):
    r"""Six unconstrained numbers: rotation vector [rad] and translation [scene unit].

    p_a = R(rotvec) p_b + translation. Regular for every rotation with |rotvec| < 2 pi, so a solver may add to the
    six numbers; `canonical` brings |rotvec| back to at most pi between solves.

    Source: optical tracking document, eq. 3.10 and 4.14.
    """

    rotvec: Float[Array, "*batch 3"]
    translation: Float[Array, "*batch 3"]

    @classmethod
    def identity(cls) -> "Pose":
        """The pose that changes nothing."""
        return cls(jnp.zeros(3), jnp.zeros(3))

    @classmethod
    def from_matrix(cls, T: Float[Array, "4 4"]) -> "Pose":
        """Pose of a homogeneous 4x4 matrix (its last row is not looked at)."""
        return cls(rotation.log(T[:3, :3]), T[:3, 3])

    def matrix(self) -> Float[Array, "4 4"]:
        """Homogeneous 4x4 matrix."""
        top = jnp.concatenate([rotation.exp(self.rotvec), self.translation[:, None]], axis=1)
        return jnp.concatenate([top, jnp.array([[0.0, 0.0, 0.0, 1.0]], dtype=top.dtype)])

    def act(self, p_b: Vector3) -> Vector3:
        """Coordinates in frame a of a point given in frame b."""
        return rotation.rotate(self.rotvec, p_b) + self.translation

    def compose(self, T_b_c: "Pose") -> "Pose":
        """T_a_c = T_a_b T_b_c."""
        R = rotation.exp(self.rotvec) @ rotation.exp(T_b_c.rotvec)
        return Pose(rotation.log(R), self.act(T_b_c.translation))

    def inverse(self) -> "Pose":
        """T_b_a."""
        return Pose(-self.rotvec, -rotation.rotate(-self.rotvec, self.translation))

    def retract(self, delta: Float[Array, "6"]) -> "Pose":
        """The pose turned by the small rotation delta[:3] (in frame a, from the left) and moved by delta[3:]."""
        R = rotation.exp(delta[:3]) @ rotation.exp(self.rotvec)
        return Pose(rotation.log(R), self.translation + delta[3:])

    def canonical(self) -> "Pose":
        """The same pose with |rotvec| <= pi."""
        return Pose(rotation.canonical(self.rotvec), self.translation)
