"""From pixels to joint angles as one function that `jax.jacobian` differentiates, and what the angles' sigmas are."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmocap._errors import InputError
from jaxmocap.bodies.bead_body import AXES, PARTS, BeadBody, BeadPose, PoseStart, parent_part, part_frames
from jaxmocap.cameras import Camera
from jaxmocap.observations import PixelObservations
from jaxmocap.reconstruction.bone_directions import bend
from jaxmocap.reconstruction.skeleton import SkeletonPose
from jaxmocap.reconstruction.skeleton_fit import SkeletonFit, fit_skeleton_to_pixels
from jaxmocap.reconstruction.skeleton_problem import Mode, free_parameters
from jaxmocap.reconstruction.triangulation import fit_point_linear, rays

_ABOVE = np.array([0 if parent_part(part) is None else 1 + PARTS.index(parent_part(part) or "") for part in PARTS])


def pose_from_pixels(
    observations: PixelObservations,
    cameras: Camera,
    lengths: Float[Array, "bones"],
    *,
    mode: Mode = "document",
    body: BeadBody | None = None,
) -> SkeletonPose:
    """Skeleton of one pose from the beads' pixels in several photos: triangulation, then the likeliest skeleton.

    Pure: works under `jax.jit` and `jax.jacobian`, by pixels and by every number of the cameras. The derivative is
    that of the optimum (implicit function theorem); the triangulated start is not differentiated.

    Args:
        observations: arrays (photos, markers).
        cameras: stacked over the photos.
        lengths: of all bones, in the order of `skeleton.BONE_NAMES` [scene].
        mode: "document", or "known" with a body.
        body: what a fit in the mode "learn" found.

    Returns:
        SkeletonPose.

    Raises:
        InputError: as `fit_skeleton_to_pixels`.
    Source: stop-motion document, eq. 5.8-5.13 and section 6.
    """
    fixed = jax.lax.stop_gradient((observations, cameras))
    points, seen = triangulated(*fixed)
    one = lambda tree: jax.tree.map(lambda x: x[None], tree)  # noqa: E731
    fit = fit_skeleton_to_pixels(
        one(observations), one(cameras), points[None], seen[None], lengths, mode=mode, body=body
    )
    return jax.tree.map(lambda x: x[0], fit.poses())


@eqx.filter_jit
def triangulated(observations: PixelObservations, cameras: Camera) -> tuple[Array, Array]:
    """Beads in space, (markers, 3), and which of them two or more photos determine.

    Source: stop-motion document, eq. 5.8-5.13.
    """

    def bead(uv: Array, visible: Array) -> tuple[Array, Array]:
        return fit_point_linear(*rays(cameras, uv, visible))

    return jax.vmap(bead, (1, 1))(observations.uv, observations.visible)


def _bends(body: BeadBody, pose: BeadPose, start: PoseStart) -> Array:
    """Angle of every part from where it would point if it were not turned against what it hangs on."""
    R, _ = part_frames(body, pose, start)
    axes = jnp.array(AXES)[:, None, :]
    return jax.vmap(bend)(jnp.sum(R[_ABOVE] * axes, axis=2), jnp.sum(R[1:] * axes, axis=2))


class JointAngles(eqx.Module):
    """Angles of the joints with their standard deviations; infinite where a pose or the beads do not determine one.

    Source: stop-motion document, 6.1; covariance of `optim.covariance`, shared uncertainty included.
    """

    bends: Float[Array, "poses 10"]
    """Angle of each part of `bead_body.PARTS` from the T-pose of what it hangs on [rad], 0..pi; 0: straight limb."""
    sigma_bends: Float[Array, "poses 10"]
    sigma_turns: Float[Array, "poses 10 3"]
    """Standard deviation of each part's turn about its own axes, relative to what it hangs on [rad]."""


@eqx.filter_jit
def joint_angles(fit: SkeletonFit) -> JointAngles:
    """Joint angles of a fit, and how well they are known.

    Args:
        fit: with covariance.

    Returns:
        JointAngles.
    Source: stop-motion document, 6.1; first-order propagation.
    """
    value, covariance = fit.estimate.value, fit.estimate.covariance
    body = value.shared.body
    angles = value.local.angles
    photos = 0 if angles is None else angles.shape[1]
    free = free_parameters(fit.mode, angles is not None, False, photos).local.pose
    before = int(np.sum(free.root_turn))
    flags = np.asarray(free.turns).reshape(-1)
    rows = before + np.arange(int(flags.sum()))

    def one(i: Array, pose: BeadPose, start: PoseStart, bones: Array) -> tuple[Array, Array, Array]:
        block = covariance.local(i)[rows][:, rows]
        at = lambda turns: _bends(body, eqx.tree_at(lambda p: p.turns, pose, turns), start)  # noqa: E731
        J = jax.jacfwd(at)(pose.turns).reshape(10, 30)[:, np.flatnonzero(flags)]
        variance = jnp.sum((J @ block) * J, axis=1)
        turns = jnp.full(30, jnp.inf).at[np.flatnonzero(flags)].set(jnp.sqrt(jnp.diagonal(block)))
        known = jnp.where(bones[:, None], turns.reshape(10, 3), jnp.inf)
        above = jnp.concatenate([jnp.array([True]), bones])[_ABOVE]
        return at(pose.turns), jnp.where(bones & above, jnp.sqrt(variance), jnp.inf), known

    poses = jnp.arange(fit.bones.shape[0])
    return JointAngles(*jax.vmap(one)(poses, value.local.pose, fit.start, fit.bones))


def camera_share(
    quantity: Callable[[Float[Array, "n"]], Float[Array, "m"]],
    numbers: Float[Array, "n"],
    covariance: Array,
) -> Float[Array, "m m"]:
    """Covariance that cameras or a turntable, estimated elsewhere, add to what is computed with them.

    Add it to the covariance of the fit, which holds for exact cameras; right as long as the cameras were not
    estimated from the same pixels (else free the turntable in the fit itself).

    Args:
        quantity: joint angles, say, as a function of the cameras' numbers, through `pose_from_pixels`.
        numbers: where it is taken.
        covariance: of the numbers.

    Returns:
        J covariance J^T.

    Raises:
        InputError: if the covariance does not fit the numbers.
    Source: first-order propagation of the stop-motion document's chain, sections 4-6.
    """
    if covariance.shape != (numbers.shape[0], numbers.shape[0]):
        raise InputError(f"covariance: expected {(numbers.shape[0],) * 2}, got {covariance.shape}")
    J = jax.jacobian(quantity)(numbers)
    return J @ covariance @ J.T
