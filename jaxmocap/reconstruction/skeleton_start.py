"""Start of a skeleton fit: the document's skeleton, limbs twisted to where their beads sit, and a body to match."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxmocap.bodies import puppet
from jaxmocap.bodies.bead_body import (
    AXES,
    LENGTH_BONES,
    PARTS,
    UPPER_BEADS,
    UPPER_PARTS,
    BeadBody,
    BeadPose,
    PoseStart,
    bead_points,
    parent_part,
    part_frames,
)
from jaxmocap.bodies.puppet import BONES, MARKERS
from jaxmocap.geometry import rotation
from jaxmocap.reconstruction.skeleton import BONE_NAMES, BodyFrames, body_frames, skeleton_of_frames

UPPER_ROWS = np.array([PARTS.index(part) for part in UPPER_PARTS])
"""Rows of `PARTS` whose upper bead hangs on their own joint."""

_UPPER_BEAD_ROWS = np.array([MARKERS.index(bead) for bead in UPPER_BEADS])
_M1 = np.array([MARKERS.index(bone.m1) for bone in BONES])
_M2 = np.array([MARKERS.index(bone.m2) for bone in BONES])
_LENGTH_ROWS = np.array([BONE_NAMES.index(name) for name in LENGTH_BONES])
_PARENT_ROWS = np.array([-1 if parent_part(p) is None else PARTS.index(parent_part(p) or "") for p in PARTS])
_LOWER_ROWS = np.array([i for i in range(len(PARTS)) if i not in UPPER_ROWS])

# A limb's frame is twisted so that its upper bead lies on this side of the bone: the front for head, torso and arms,
# the outside for legs. This is the zero of its twist where the fit finds twists.
_SIDES = np.array([[0, 0, 1.0], [0, 0, 1], [0, 0, 1], [0, 0, 1], [1, 0, 0], [-1, 0, 0]])
TANGENTS = np.cross(AXES[UPPER_ROWS], _SIDES)
"""(6, 3): across the bone and the side on which each of `UPPER_BEADS` lies."""


class FitStart(eqx.Module):
    """Where a fit starts in one pose.

    Source: stop-motion document, section 6.
    """

    start: PoseStart
    body: BeadBody
    """The body that puts every bead of this pose on its spot."""
    bones: Bool[Array, "*batch 10"]
    """Which of `puppet.BONES` have both beads."""
    beads: Bool[Array, "*batch 6"]
    """Which of `bead_body.UPPER_BEADS` are where `body` says."""


def frames_as_parts(f: BodyFrames) -> tuple[Float[Array, "3 3"], Float[Array, "10 3 3"]]:
    """Orientation of the pelvis and of the parts in the order of `bead_body.PARTS`.

    Source: stop-motion document, 6.2.
    """
    (upper_arm, lower_arm), (thigh, shank) = f.arms, f.legs
    of = {"head-joint": f.head, "upper-back-joint": f.torso}
    for k, side in enumerate("lr"):
        of |= {f"{side}-elbow-joint": upper_arm[k], f"{side}-hand-joint": lower_arm[k]}
        of |= {f"{side}-knee-joint": thigh[k], f"{side}-foot-joint": shank[k]}
    return f.root, jnp.stack([of[part] for part in PARTS])


def _relative(R_root: Array, R_part: Array) -> PoseStart:
    above = jnp.concatenate([R_part, R_root[None]])[_PARENT_ROWS]
    return PoseStart(R_root, jnp.sum(above[:, :, :, None] * R_part[:, :, None, :], axis=1))


def _twisted(R_part: Array, off: Array, known: Array, radius: Array) -> Array:
    """Parts twisted so that their upper beads lie on `_SIDES`; the torso keeps the twist that its shoulders give."""
    side, across = jnp.sum(off * _SIDES, axis=1), jnp.sum(off * TANGENTS, axis=1)
    far = side**2 + across**2 > radius**2
    torso = np.array([part == "upper-back-joint" for part in UPPER_PARTS])
    turn = jnp.where(known & far & ~torso, jnp.arctan2(jnp.where(far, across, 0.0), jnp.where(far, side, 1.0)), 0.0)
    twist = jax.vmap(rotation.exp)(turn[:, None] * AXES[UPPER_ROWS])
    new = R_part.at[UPPER_ROWS].set(jnp.sum(R_part[UPPER_ROWS][:, :, :, None] * twist[:, None, :, :], axis=2))
    # Forearms and shins follow without a twist of their own.
    above = new[_PARENT_ROWS[_LOWER_ROWS]]
    axes = jnp.array(AXES[_LOWER_ROWS])
    from_, to = (jnp.sum(R * axes[:, None, :], axis=2) for R in (above, R_part[_LOWER_ROWS]))
    sideways = jnp.sum(above * jnp.array(np.roll(np.abs(AXES[_LOWER_ROWS]), 1, axis=1))[:, None, :], axis=2)
    swing = jax.vmap(rotation.between)(from_, to, sideways)
    return new.at[_LOWER_ROWS].set(jnp.sum(swing[:, :, :, None] * above[:, None, :, :], axis=2))


def start_from_markers(
    points: Float[Array, "markers 3"],
    seen: Bool[Array, "markers"],
    lengths: Float[Array, "bones"],
    twist: bool = True,
    body: BeadBody | None = None,
) -> FitStart:
    """Start of a fit in one pose.

    Args:
        points: beads in the order of `puppet.MARKERS` [scene]; any finite numbers where not seen.
        seen: which beads there are.
        lengths: of all bones, in the order of `skeleton.BONE_NAMES` [scene].
        twist: twist limbs to their beads; False: as the document has them.
        body: a known one, whose root and lengths are then used.

    Returns:
        FitStart.
    Source: stop-motion document, section 6.
    """
    points = jnp.where(seen[:, None], points, 0.0)
    frames, bones = body_frames(points, seen)
    root = skeleton_of_frames(frames, bones, points, seen, lengths).root if body is None else body.root
    R_root, R_part = frames_as_parts(frames)
    chosen = lengths[_LENGTH_ROWS] if body is None else body.lengths
    spans = jnp.where(bones, jnp.sqrt(jnp.sum((points[_M2] - points[_M1]) ** 2, axis=1) + 1e-300), 0.0)
    own = BeadBody(root, chosen, jnp.zeros((6, 3)), spans)
    still = BeadPose(jnp.zeros(3), jnp.zeros((10, 3)), jnp.zeros((6, 3)))

    def offsets(R_part: Array) -> tuple[Array, PoseStart]:
        start = _relative(R_root, R_part)
        R, p = part_frames(own, still, start)
        rows = 1 + UPPER_ROWS
        return jnp.sum(R[rows] * (points[_UPPER_BEAD_ROWS] - p[rows])[:, :, None], axis=1), start

    known = seen[_UPPER_BEAD_ROWS] & bones[UPPER_ROWS]
    off, start = offsets(R_part)
    if twist:
        off, start = offsets(_twisted(R_part, off, known, 1e-9 * lengths[0]))
    own = BeadBody(root, chosen, jnp.where(known[:, None], off, 0.0), spans)
    return FitStart(start, own, bones, known)


def _mean(values: Array, counts: Array) -> Array:
    """Mean over the leading axis of what counts; zero where nothing does."""
    weight = counts.astype(float).reshape(counts.shape + (1,) * (values.ndim - counts.ndim))
    return jnp.sum(weight * values, axis=0) / jnp.maximum(jnp.sum(weight, axis=0), 1.0)


def common_body(starts: FitStart) -> BeadBody:
    """One body for several poses: the mean of theirs.

    Args:
        starts: with a leading axis of poses.

    Returns:
        BeadBody.
    Source: stop-motion document, 3.1.3 (beads are fixed to the limbs).
    """
    everywhere = jnp.ones(starts.bones.shape[:1], bool)
    return BeadBody(
        _mean(starts.body.root, everywhere),
        starts.body.lengths[0],
        _mean(starts.body.offsets, starts.beads),
        _mean(starts.body.spans, starts.bones),
    )


def slip_onto(points: Float[Array, "markers 3"], seen: Bool[Array, "markers"], body: BeadBody, start: PoseStart):
    """Slip of the upper beads that puts each limb's first visible bead on its spot, (6, 3) [scene].

    Source: stop-motion document, 3.1.3.
    """
    still = BeadPose(jnp.zeros(3), jnp.zeros((10, 3)), jnp.zeros((6, 3)))
    gap = jnp.where(seen[:, None], points - bead_points(body, still, start), 0.0)
    slip = []
    for bead in UPPER_BEADS:
        limb = [bead, *(b.m2 for b in BONES if b.m1 == bead)]
        limb += [b.m2 for b in BONES if b.m1 == limb[-1]]
        value = jnp.zeros(3)
        for name in reversed(limb):
            row = MARKERS.index(name)
            value = jnp.where(seen[row], gap[row], value)
        slip.append(value)
    return jnp.stack(slip)


def complete(lengths: dict[str, float] | None) -> Float[Array, "bones"]:
    """Lengths by name as an array in the order of `skeleton.BONE_NAMES`, gaps filled as `puppet.complete_lengths`."""
    full = puppet.complete_lengths(lengths)
    return jnp.array([full[name] for name in BONE_NAMES])
