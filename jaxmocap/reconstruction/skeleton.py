"""The document's skeleton from its beads: directions, translations, and the bones that carry no beads.

Two conventions side by side. LITERAL is what is printed: feet and shoulders from cross products with the fixed axes
of the world (6.4-6.6). REPAIRED, the default, equals it wherever it means something and differs where it does not:

- the printed axes are those of a puppet that faces the camera at angle 0; one that is turned away has axes of its own;
- a leg along x or a back along z has no printed foot or shoulders, and near there the printed ones flip over;
- a bead that was not seen leaves its bones in line with their parents, marked as not valid, instead of NaN.

Markers do not say how a limb is twisted about itself; no bone of the result is twisted relative to its parent, except
as feet and shoulders demand.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxmocap._arrays import Flag, Scalar, Vector3
from jaxmocap._errors import InputError
from jaxmocap.bodies import puppet
from jaxmocap.bodies.motion import SkeletonMotion
from jaxmocap.bodies.puppet import BONES, JOINTS, MARKERS, RIG_JOINTS, RIG_PARENTS, rig_parents
from jaxmocap.bodies.tree import KinematicTree
from jaxmocap.geometry import rotation
from jaxmocap.reconstruction.bone_directions import (
    TURNED_AWAY,
    bone_directions,
    document_foot,
    document_shoulders,
    facing,
    repaired_cross,
    unit_or,
)

BONE_NAMES = JOINTS[1:]
"""All bones, in the order of the document's hierarchy; they carry the name of the joint at their end."""

_ROW = {bone.name: i for i, bone in enumerate(BONES)}
_RIG = {name: i for i, name in enumerate(RIG_JOINTS)}
_REST_DIRECTIONS = np.array([puppet.REST_DIRECTIONS[name] for name in BONE_NAMES])
_X, _Y = np.eye(3)[:2]


def _bones_to_joint() -> np.ndarray:
    """(joints, bones): 1 where a bone lies between the root and a joint of the rig."""
    rows = []
    for joint in RIG_JOINTS:
        on_the_way, at = set(), joint
        while at is not None:
            on_the_way.add(at)
            at = RIG_PARENTS[at]
        rows.append([float(bone in on_the_way) for bone in BONE_NAMES])
    return np.array(rows)


_BONES_TO_JOINT = _bones_to_joint()


class SkeletonPose(eqx.Module):
    """A pose of the puppet.

    Source: stop-motion document, section 6.
    """

    rotvec: Float[Array, "*batch joints 3"]
    """Rotation of each joint of `puppet.RIG_JOINTS` relative to its parent [rad]; zero everywhere is the T-pose."""
    root: Float[Array, "*batch 3"]
    """Position of the root in the world [scene]."""
    directions: Float[Array, "*batch bones 3"]
    """Unit direction of each bone of `BONE_NAMES` in the world."""
    valid: Bool[Array, "*batch bones"]
    """False where beads were missing or a printed formula has no value; the direction is then the parent's."""


class BodyFrames(NamedTuple):
    """Orientation of the parts of the body in the world."""

    root: Array
    torso: Array
    head: Array
    arms: tuple[Array, Array]
    """(2, 3, 3): left and right; upper, lower."""
    legs: tuple[Array, Array]
    feet: Array


def bone_translations(directions: Float[Array, "bones 3"], lengths: Float[Array, "bones"]) -> Float[Array, "bones 3"]:
    """Translation of each bone's joint from its parent's, in the axes of the world [scene].

    Source: stop-motion document, eq. 6.2-6.3.
    """
    return lengths[:, None] * directions


def _turn_about_y(angle: Scalar) -> Array:
    return rotation.exp(jnp.stack([jnp.zeros_like(angle), angle, jnp.zeros_like(angle)]))


def _swing(R_world_parent: Array, rest: Array, axis: Array, direction: Vector3, valid: Flag) -> Array:
    """Frame of a bone that turns from its rest direction by the smallest turn."""
    a = jnp.sum(R_world_parent * rest[None, :], axis=1)
    b = jnp.where(valid, direction, a)
    R = rotation.between(a, b, jnp.sum(R_world_parent * axis[None, :], axis=1))
    return jnp.sum(R[:, :, None] * R_world_parent[None, :, :], axis=1)


def _levels(R_world_parents: Array, rest: np.ndarray, given: Array, valid: Array) -> Array:
    """Frames of bones that hang on known parents; one vmapped call per level of the body compiles quickly."""
    # Where a bone points exactly against its rest it turns about the parent's x, arms (along x) about y.
    axis = np.where(np.abs(rest[:, :1]) > 0.5, _Y[None], _X[None])
    return jax.vmap(_swing)(R_world_parents, jnp.array(rest), jnp.array(axis), given, valid)


def _pose_frames(given: Array, valid: Array, R_root: Array, literal: bool, shoulder_line: Vector3 | None) -> BodyFrames:
    """Frames of all parts, level by level from the pelvis."""
    row = lambda *names: np.array([_ROW[f"{name}-joint"] for name in names])  # noqa: E731
    one, two, three = (
        row("upper-back", "l-knee", "r-knee"),
        row("head", "l-elbow", "r-elbow", "l-foot", "r-foot"),
        row("l-hand", "r-hand"),
    )
    hips = jnp.broadcast_to(R_root, (3, 3, 3))
    back_swing, *thigh = _levels(hips, np.stack([_Y, -_Y, -_Y]), given[one], valid[one])
    back = back_swing[:, 1]
    shoulder = document_shoulders(back)[0][0] if literal else repaired_cross(back, R_root[:, 2], back_swing[:, 0])
    if shoulder_line is not None:
        shoulder = unit_or(shoulder_line - back * jnp.sum(back * shoulder_line), shoulder)[0]
    # A literal shoulder is not perpendicular to the back where it has no value; then the swing's is used.
    upright = jnp.abs(jnp.sum(shoulder * back)) < 1e-6
    torso = jnp.where(upright, jnp.stack([shoulder, back, jnp.cross(shoulder, back)], axis=1), back_swing)
    parents = jnp.stack([torso, torso, torso, *thigh])
    head, *four = _levels(parents, np.stack([_Y, _X, -_X, -_Y, -_Y]), given[two], valid[two])
    upper_arm, shank = jnp.stack(four[:2]), jnp.stack(four[2:])
    lower_arm = _levels(upper_arm, np.stack([_X, -_X]), given[three], valid[three])
    feet = feet_frames(shank, R_root, literal)
    return BodyFrames(R_root, torso, head, (upper_arm, lower_arm), (jnp.stack(thigh), shank), feet)


def feet_frames(
    R_world_shanks: Float[Array, "2 3 3"], R_world_root: Float[Array, "3 3"], literal: bool = False
) -> Float[Array, "2 3 3"]:
    """Orientation of both feet: toes (z) forwards, perpendicular to the lower leg (-y).

    Source: stop-motion document, eq. 6.4.
    """
    leg, calm = -R_world_shanks[:, :, 1], R_world_shanks[:, :, 2]
    if literal:
        toes, there = jax.vmap(document_foot)(leg)
        toes = jnp.where(there[:, None], toes, calm)
    else:
        toes = jax.vmap(repaired_cross, (0, None, 0))(leg, R_world_root[:, 0], calm)
    return jnp.stack([jnp.cross(-leg, toes), -leg, toes], axis=2)


def world_rotations(f: BodyFrames) -> Float[Array, "joints 3 3"]:
    """Orientation of every joint of the rig in the world."""
    world = {"root-joint": f.root, "lower-back-joint": f.torso, "upper-back-joint": f.torso}
    world |= {puppet.NECK: f.head, "head-joint": f.head}
    for k, side in enumerate("lr"):
        for joint, R in (
            *(("shoulder", f.arms[0][k]), ("elbow", f.arms[1][k]), ("hand", f.arms[1][k]), ("finger", f.arms[1][k])),
            *(("hip", f.legs[0][k]), ("knee", f.legs[1][k]), ("foot", f.feet[k]), ("toes", f.feet[k])),
        ):
            world[f"{side}-{joint}-joint"] = R
    return jnp.stack([world[name] for name in RIG_JOINTS])


def local_rotations(R_world_joint: Float[Array, "joints 3 3"]) -> Float[Array, "joints 3"]:
    """Rotation vector of every joint of the rig relative to its parent [rad].

    Source: stop-motion document, 6.1 (hierarchic structure).
    """
    R = R_world_joint
    above = jnp.concatenate([R, jnp.eye(3)[None]])[np.array(rig_parents())]
    return jax.vmap(rotation.log)(jnp.sum(above[:, :, :, None] * R[:, :, None, :], axis=1))


def world_directions(R_world_joint: Float[Array, "joints 3 3"]) -> Float[Array, "bones 3"]:
    """Unit directions of all bones in the world, in the order of `BONE_NAMES`, from the joints' orientations.

    Source: stop-motion document, 6.1 (hierarchic structure).
    """
    above = np.array([rig_parents()[_RIG[name]] for name in BONE_NAMES])
    return jnp.sum(R_world_joint[above] * jnp.array(_REST_DIRECTIONS)[:, None, :], axis=2)


def _valid_bones(with_beads: Array, literal: bool, f: BodyFrames) -> Bool[Array, "bones"]:
    """Pelvis: always; bones with beads: where seen; the others as the bone they hang on."""
    said = {bone.name: with_beads[i] for i, bone in enumerate(BONES)}
    always = jnp.array(True)
    back = said["upper-back-joint"]
    if literal:
        back = back & document_shoulders(f.torso[:, 1])[1]
    for k, side in enumerate("lr"):
        foot = said[f"{side}-foot-joint"]
        said[f"{side}-toes-joint"] = foot & document_foot(-f.legs[1][k][:, 1])[1] if literal else foot
        said[f"{side}-finger-joint"] = said[f"{side}-hand-joint"]
        said[f"{side}-shoulder-joint"] = back
    return jnp.stack([said.get(name, always) for name in BONE_NAMES])


def rig_tree(lengths: Float[Array, "bones"]) -> KinematicTree:
    """The puppet's rig with given bone lengths.

    Args:
        lengths: of the bones, in the order of `BONE_NAMES` [scene].

    Returns:
        KinematicTree of `puppet.RIG_JOINTS`.
    Source: stop-motion document, 6.2 (figure 27), with the neck as a joint of its own.
    """
    rows = np.array([_RIG[name] for name in BONE_NAMES])
    offsets = jnp.zeros((len(RIG_JOINTS), 3)).at[rows].set(bone_translations(jnp.array(_REST_DIRECTIONS), lengths))
    return KinematicTree(offsets, RIG_JOINTS, rig_parents())


def default_lengths() -> Float[Array, "bones"]:
    """`puppet.DEFAULT_LENGTHS` in the order of `BONE_NAMES` [mm]."""
    return jnp.array([puppet.DEFAULT_LENGTHS[name] for name in BONE_NAMES])


def _root_position(points: Array, seen: Array, p_joint: Array) -> Vector3:
    """The pelvis is on the turning axis; its height is that at which knees (else elbows) are level with their beads.

    Source: stop-motion document, 3.1.3 (beads on knees and elbows) and 2 (pelvis on the axis).
    """
    joints = np.array([_RIG[f"{s}-{j}-joint"] for j in ("knee", "elbow") for s in "lr"])
    beads = np.array([MARKERS.index(n) for n in ("leg.L2", "leg.R2", "arm.L2", "arm.R2")])
    weight = seen[beads].astype(float) * jnp.where(jnp.any(seen[beads[:2]]), jnp.array([1.0, 1.0, 0.0, 0.0]), 1.0)
    height = jnp.where(seen[beads], points[beads, 1] - p_joint[joints, 1], 0.0)
    y = jnp.sum(weight * height) / jnp.maximum(jnp.sum(weight), 1.0)
    return jnp.stack([jnp.zeros_like(y), y, jnp.zeros_like(y)])


def body_frames(
    points: Float[Array, "markers 3"],
    seen: Bool[Array, "markers"],
    *,
    literal: bool = False,
    yaw: Scalar | None = None,
    shoulder_line: Vector3 | None = None,
) -> tuple[BodyFrames, Bool[Array, "10"]]:
    """Orientation of every part of the body, and which of `puppet.BONES` are valid; arguments as below.

    Source: stop-motion document, eq. 6.1, 6.4-6.6.
    """
    given, with_beads = bone_directions(points, seen)
    if literal:
        turn = jnp.zeros(())
    elif yaw is None:
        measured, known = facing(points, seen)
        turn = jnp.where(known & (jnp.abs(measured) > TURNED_AWAY), measured, 0.0)
    else:
        turn = yaw
    frames = _pose_frames(given, with_beads, _turn_about_y(turn), literal, shoulder_line)
    return frames, with_beads


def skeleton_of_frames(
    frames: BodyFrames,
    with_beads: Bool[Array, "10"],
    points: Float[Array, "markers 3"],
    seen: Bool[Array, "markers"],
    lengths: Float[Array, "bones"],
    literal: bool = False,
) -> SkeletonPose:
    """The pose whose parts are oriented as given; the root stands where knees and elbows are level with their beads.

    Source: stop-motion document, 6.1-6.2.
    """
    R = world_rotations(frames)
    directions = world_directions(R)
    p_joint = jnp.array(_BONES_TO_JOINT) @ bone_translations(directions, lengths)
    root = _root_position(points, seen, p_joint)
    return SkeletonPose(local_rotations(R), root, directions, _valid_bones(with_beads, literal, frames))


def skeleton_from_markers(
    points: Float[Array, "markers 3"],
    seen: Bool[Array, "markers"],
    lengths: Float[Array, "bones"],
    *,
    literal: bool = False,
    yaw: Scalar | None = None,
    shoulder_line: Vector3 | None = None,
) -> SkeletonPose:
    """The document's skeleton of one set of beads.

    Args:
        points: beads in the order of `puppet.MARKERS`, in the world of the turntable [scene]; any finite numbers
            where not seen.
        seen: which beads there are.
        lengths: of the bones, in the order of `BONE_NAMES` [scene].
        literal: feet and shoulders exactly as printed; not valid, and in line with their parents, where the print has
            no value.
        yaw: how far the puppet is turned about y from facing the camera at angle 0 [rad]; None: not at all, unless
            its beads say that it is turned by more than 45 degrees. Not looked at in the literal mode.
        shoulder_line: direction from the right to the left shoulder, where further beads tell it (the document's 8.2);
            it then twists the torso in place of 6.5-6.6.

    Returns:
        SkeletonPose; `rotvec` through the rig of these lengths gives back exactly `directions`.

    Raises:
        InputError: for arrays of other sizes.
    Source: stop-motion document, eq. 6.1-6.6.
    """
    if points.shape != (len(MARKERS), 3) or lengths.shape != (len(BONE_NAMES),):
        raise InputError(
            f"points, lengths: expected ({len(MARKERS)}, 3) and ({len(BONE_NAMES)},), "
            f"got {points.shape} and {lengths.shape}"
        )
    frames, with_beads = body_frames(points, seen, literal=literal, yaw=yaw, shoulder_line=shoulder_line)
    return skeleton_of_frames(frames, with_beads, points, seen, lengths, literal)


def motion_from_poses(poses: SkeletonPose, lengths: np.ndarray, unit: str, fps: float = 25.0) -> SkeletonMotion:
    """Poses stacked over frames as the record that exporters take.

    Args:
        poses: with a leading axis of frames.
        lengths: of the bones, in the order of `BONE_NAMES`.
        unit: of lengths and positions.
        fps: frames per second.

    Returns:
        SkeletonMotion.

    Raises:
        InputError: as SkeletonMotion.
    Source: stop-motion document, 6.3, with rotations.
    """
    offsets = np.asarray(rig_tree(jnp.asarray(lengths)).offsets)
    return SkeletonMotion(RIG_JOINTS, rig_parents(), offsets, np.array(poses.rotvec), np.array(poses.root), unit, fps)
