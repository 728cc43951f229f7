"""Where the beads are when the puppet's limbs are turned: the body that a fit learns, and its pose.

A limb's upper bead is fixed to the limb; the lower bead lies from it along the bone (so the document's 6.1 holds for
every pose), and on elbow and knee it is the next limb's upper bead too. Parts are numbered as `puppet.BONES`.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmocap.bodies import puppet
from jaxmocap.bodies.puppet import BONES, MARKERS
from jaxmocap.bodies.tree import chain
from jaxmocap.geometry import rotation

PARTS = tuple(bone.name for bone in BONES)
"""Turning parts of the body, called by their bones."""

AXES = np.array([puppet.REST_DIRECTIONS[name] for name in PARTS])
"""Direction of each bone in its part's own frame."""

LENGTH_BONES = (
    "lower-back-joint",
    "upper-back-joint",
    "l-shoulder-joint",
    "r-shoulder-joint",
    "l-hip-joint",
    "r-hip-joint",
)
"""Bones whose length decides where a limb's joint is; a limb's own length decides nothing that a bead sees."""

UPPER_PARTS = ("head-joint", "upper-back-joint", "l-elbow-joint", "r-elbow-joint", "l-knee-joint", "r-knee-joint")
"""Parts whose upper bead hangs on their own joint."""

UPPER_BEADS = tuple(next(bone.m1 for bone in BONES if bone.name == part) for part in UPPER_PARTS)
"""Those beads."""

_ROOT = 0  # joints of the chain below: the root, then the parts
_UPPER = np.array([PARTS.index(part) for part in UPPER_PARTS])


def parent_part(part: str) -> str | None:
    """Part that a part hangs on; None: the pelvis."""
    above = puppet.PARENTS[part]
    while above is not None and above not in PARTS:
        above = puppet.PARENTS[above]
    return above


_PARENTS = (-1, *(_ROOT if parent_part(p) is None else 1 + PARTS.index(parent_part(p) or "") for p in PARTS))


def _bead_matrices() -> tuple[np.ndarray, np.ndarray]:
    """(beads, upper beads) and (beads, parts): which upper bead and which spans lead to a bead."""
    from_upper, from_span = np.zeros((len(MARKERS), len(UPPER_BEADS))), np.zeros((len(MARKERS), len(PARTS)))
    for row, bead in enumerate(MARKERS):
        at = bead
        while at not in UPPER_BEADS:
            bone = next(b for b in BONES if b.m2 == at)
            from_span[row, PARTS.index(bone.name)] = 1.0
            at = bone.m1
        from_upper[row, UPPER_BEADS.index(at)] = 1.0
    return from_upper, from_span


_FROM_UPPER, FROM_SPAN = _bead_matrices()


class BeadBody(eqx.Module):
    """What stays the same from pose to pose.

    Source: stop-motion document, 3.1.3 (beads) and 6.2 (bones).
    """

    root: Float[Array, "3"]
    """Position of the root: the pelvis is fixed to the axis [scene]."""
    lengths: Float[Array, "6"]
    """Of `LENGTH_BONES` [scene]."""
    offsets: Float[Array, "6 3"]
    """Place of each of `UPPER_BEADS` in its part's frame, from the part's joint [scene]."""
    spans: Float[Array, "10"]
    """Distance between the two beads of each part [scene]."""


class BeadPose(eqx.Module):
    """What changes: small turns from a known start, each about the axes of the turning part itself.

    Source: stop-motion document, 6.1.
    """

    root_turn: Float[Array, "*batch 3"]
    """Of the pelvis [rad]."""
    turns: Float[Array, "*batch 10 3"]
    """Of each part relative to what it hangs on [rad]; the component along `AXES` is its twist."""
    slip: Float[Array, "*batch 6 3"]
    """Of each upper bead from where its joint has it, in the world [scene]; zero unless bodies are not known."""


class PoseStart(eqx.Module):
    """Orientations that the turns start from.

    Source: stop-motion document, section 6.
    """

    R_world_root: Float[Array, "*batch 3 3"]
    R_parent_part: Float[Array, "*batch 10 3 3"]


def _joint_offsets(body: BeadBody) -> Float[Array, "11 3"]:
    """Joint of each part in the frame of what it hangs on; elbows and knees are nobody's business."""
    lower, upper, l_shoulder, r_shoulder, l_hip, r_hip = (body.lengths[i] for i in range(6))
    zero = jnp.zeros_like(lower)
    nothing = jnp.stack([zero, zero, zero])
    place = {
        "upper-back-joint": jnp.stack([zero, lower, zero]),
        "head-joint": jnp.stack([zero, upper, zero]),
        "l-elbow-joint": jnp.stack([l_shoulder, upper, zero]),
        "r-elbow-joint": jnp.stack([-r_shoulder, upper, zero]),
        "l-knee-joint": jnp.stack([l_hip, zero, zero]),
        "r-knee-joint": jnp.stack([-r_hip, zero, zero]),
    }
    return jnp.stack([body.root, *(place.get(part, nothing) for part in PARTS)])


def part_frames(
    body: BeadBody, pose: BeadPose, start: PoseStart
) -> tuple[Float[Array, "11 3 3"], Float[Array, "11 3"]]:
    """Orientation and joint of the pelvis and of every part, in the world.

    Source: stop-motion document, 6.1-6.2.
    """
    R0 = jnp.concatenate([start.R_world_root[None], start.R_parent_part])
    turns = jax.vmap(rotation.exp)(jnp.concatenate([pose.root_turn[None], pose.turns]))
    R = jnp.sum(R0[:, :, :, None] * turns[:, None, :, :], axis=2)
    return chain(_PARENTS, R, _joint_offsets(body))


def bead_points(body: BeadBody, pose: BeadPose, start: PoseStart) -> Float[Array, "markers 3"]:
    """Beads in the world, in the order of `puppet.MARKERS` [scene].

    Args:
        body: lengths and places of beads.
        pose: turns of the parts.
        start: what they turn from.

    Returns:
        bead centres.
    Source: stop-motion document, eq. 6.1 solved for m2, along the hierarchy of 6.2.
    """
    R, p = part_frames(body, pose, start)
    R_upper, p_upper = R[1 + _UPPER], p[1 + _UPPER]
    upper = p_upper + jnp.sum(R_upper * body.offsets[:, None, :], axis=2) + pose.slip
    along = body.spans[:, None] * jnp.sum(R[1:] * jnp.array(AXES)[:, None, :], axis=2)
    return jnp.array(_FROM_UPPER) @ upper + jnp.array(FROM_SPAN) @ along
