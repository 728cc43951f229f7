"""The stop-motion document's lay figure as data: beads, colours, bones, hierarchy, lengths. No formula is here.

World of the figure: y up, x to the puppet's left, z forwards. A bone is called by the joint at its end, as in the
document (`l-elbow-joint` is the left upper arm).
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from jaxmocap._errors import InputError


class Bone(NamedTuple):
    """A bone whose direction two beads give: from the upper bead m1 to the lower bead m2."""

    name: str
    m1: str
    m2: str


MARKERS = (
    "head.1", "head.2", "torso.1", "torso.2",
    "arm.L1", "arm.L2", "arm.L3", "arm.R1", "arm.R2", "arm.R3",
    "leg.L1", "leg.L2", "leg.L3", "leg.R1", "leg.R2", "leg.R3",
)  # fmt: skip
"""The beads, in the order of the document's table of colours (section 3)."""

DOCUMENT_COLOURS: Mapping[str, tuple[float, float, float]] = dict(
    zip(
        MARKERS,
        (
            (0.499, 0.176, 0.754), (0.303, 0.611, 0.607), (0.768, 0.329, 0.562), (0.187, 0.633, 0.706),
            (0.589, 0.234, 0.804), (0.286, 0.251, 0.694), (0.077, 0.715, 0.575),
            (0.558, 0.605, 0.827), (0.978, 0.265, 0.598), (0.240, 0.619, 0.675),
            (0.514, 0.540, 0.599), (0.867, 0.387, 0.575), (0.286, 0.505, 0.515),
            (0.387, 0.667, 0.558), (0.188, 0.237, 0.777), (0.554, 0.431, 0.790),
        ),
    )
)  # fmt: skip
"""Hue, saturation, brightness of each bead, 0..1. Source: stop-motion document, table of section 3."""

BONES = (
    Bone("head-joint", "head.2", "head.1"),
    Bone("upper-back-joint", "torso.2", "torso.1"),
    Bone("l-elbow-joint", "arm.L1", "arm.L2"),
    Bone("l-hand-joint", "arm.L2", "arm.L3"),
    Bone("r-elbow-joint", "arm.R1", "arm.R2"),
    Bone("r-hand-joint", "arm.R2", "arm.R3"),
    Bone("l-knee-joint", "leg.L1", "leg.L2"),
    Bone("l-foot-joint", "leg.L2", "leg.L3"),
    Bone("r-knee-joint", "leg.R1", "leg.R2"),
    Bone("r-foot-joint", "leg.R2", "leg.R3"),
)
"""Bones with beads. Source: stop-motion document, table of 6.3."""

PARENTS: Mapping[str, str | None] = {
    "root-joint": None,
    "lower-back-joint": "root-joint",
    "upper-back-joint": "lower-back-joint",
    "head-joint": "upper-back-joint",
    "l-shoulder-joint": "upper-back-joint",
    "l-elbow-joint": "l-shoulder-joint",
    "l-hand-joint": "l-elbow-joint",
    "l-finger-joint": "l-hand-joint",
    "r-shoulder-joint": "upper-back-joint",
    "r-elbow-joint": "r-shoulder-joint",
    "r-hand-joint": "r-elbow-joint",
    "r-finger-joint": "r-hand-joint",
    "l-hip-joint": "root-joint",
    "l-knee-joint": "l-hip-joint",
    "l-foot-joint": "l-knee-joint",
    "l-toes-joint": "l-foot-joint",
    "r-hip-joint": "root-joint",
    "r-knee-joint": "r-hip-joint",
    "r-foot-joint": "r-knee-joint",
    "r-toes-joint": "r-foot-joint",
}
"""Hierarchy of the joints, parents before children. Source: stop-motion document, 6.2-6.3 (figure 27)."""

JOINTS = tuple(PARENTS)
"""The joints, in the order of `PARENTS`."""

NECK = "neck-joint"
"""Where the upper back ends, as a joint of its own: head and shoulders hang on one joint in the document, but the head
turns alone. The rig below has it, with no length, between upper back and head; the document's hierarchy has not."""

RIG_PARENTS: Mapping[str, str | None] = {
    name: parent
    for joint, above in PARENTS.items()
    for name, parent in (((NECK, above), (joint, NECK)) if joint == "head-joint" else ((joint, above),))
}
"""`PARENTS` with the neck: the hierarchy for rotations."""

RIG_JOINTS = tuple(RIG_PARENTS)
"""The joints, in the order of `RIG_PARENTS`."""

UNIT = "mm"
"""Unit of `DEFAULT_LENGTHS`."""

# The document prints one length: l-elbow relative to l-shoulder, (3.2703316, -0.31502795, -0.3093352) in centimetres
# (6.3, with the head of 7.1.3), that is 33.000 mm. It says that only ratios matter (6.2); they are those of
# Drillis and Contini, Body Segment Parameters, 1966 (as drawn in Winter, Biomechanics, figure 4.1), fractions of the
# stature; the trunk of 0.288 is divided as its lower and its other two parts are in de Leva, J. Biomechanics 29, 1996.
_UPPER_ARM, _LOWER_TRUNK = 33.0, 145.7 / (145.7 + 215.5 + 170.7)
_STATURE = _UPPER_ARM / 0.186
_FRACTIONS = {
    "lower-back": 0.288 * _LOWER_TRUNK,
    "upper-back": 0.288 * (1 - _LOWER_TRUNK),
    "head": 1 - 0.818,
    "shoulder": 0.129,
    "elbow": 0.186,
    "hand": 0.146,
    "finger": 0.108,
    "hip": 0.0955,
    "knee": 0.245,
    "foot": 0.246,
    "toes": 0.152,
}


def _part(joint: str) -> str:
    """l-elbow-joint -> elbow."""
    return joint.removesuffix("-joint").removeprefix("l-").removeprefix("r-")


DEFAULT_LENGTHS: Mapping[str, float] = {
    joint: round(_FRACTIONS[_part(joint)] * _STATURE, 3) for joint in JOINTS if joint != "root-joint"
}
"""Length of every bone [mm] for which no file and no fit says otherwise."""

_REST = {"head": (0, 1, 0), "lower-back": (0, 1, 0), "upper-back": (0, 1, 0), "knee": (0, -1, 0), "foot": (0, -1, 0)}


def _rest_direction(joint: str) -> tuple[float, float, float]:
    part, side = _part(joint), -1.0 if joint.startswith("r-") else 1.0
    if part == "toes":
        return (0.0, 0.0, 1.0)
    x, y, z = _REST.get(part, (side, 0, 0))
    return (float(x), float(y), float(z))


REST_DIRECTIONS: Mapping[str, tuple[float, float, float]] = {
    joint: _rest_direction(joint) for joint in JOINTS if joint != "root-joint"
}
"""Unit direction of every bone where all rotations are zero: the T-pose, facing the camera at angle 0."""


def complete_lengths(lengths: Mapping[str, float] | None = None) -> dict[str, float]:
    """Length of every bone: the given ones, the others from the defaults in the same proportion.

    Args:
        lengths: some or all bones, by name, all in one unit.

    Returns:
        All bones, in that unit; the defaults [mm] where nothing is given. A bone that is missing takes the length of
        its counterpart on the other side, else the default times the mean ratio of given to default lengths.

    Raises:
        InputError: for a bone that does not exist or a length that is not a positive number.
    """
    given = dict(lengths or {})
    for name, length in given.items():
        if name not in DEFAULT_LENGTHS:
            raise InputError(f"lengths: there is no bone {name!r}; expected some of {', '.join(DEFAULT_LENGTHS)}")
        if not (np.isfinite(length) and length > 0):
            raise InputError(f"lengths[{name!r}]: expected a positive length, got {length}")
    scale = float(np.mean([v / DEFAULT_LENGTHS[n] for n, v in given.items()])) if given else 1.0
    mirror = {n: ("r-" if n[0] == "l" else "l-") + n[2:] for n in DEFAULT_LENGTHS if n[:2] in ("l-", "r-")}
    return {
        name: float(given.get(name, given.get(mirror.get(name, name), default * scale)))
        for name, default in DEFAULT_LENGTHS.items()
    }


def rest_offsets(lengths: Mapping[str, float] | None = None) -> np.ndarray:
    """Offset of every joint of the rig from its parent in the rest pose.

    Args:
        lengths: as for `complete_lengths`.

    Returns:
        (joints of RIG_JOINTS, 3), zero for root and neck.

    Raises:
        InputError: as `complete_lengths`.
    """
    full = complete_lengths(lengths)
    zero = np.zeros(3)
    return np.array([full[j] * np.array(REST_DIRECTIONS[j]) if j in full else zero for j in RIG_JOINTS])


def rig_parents() -> tuple[int, ...]:
    """Index of every joint's parent in RIG_JOINTS, -1 for the root."""
    return tuple(-1 if p is None else RIG_JOINTS.index(p) for p in RIG_PARENTS.values())
