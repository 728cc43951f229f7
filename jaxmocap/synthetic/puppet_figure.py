"""The drawn lay figure: proportions, poses, where its beads sit, and the solids that make up its body.

Lengths in mm, numpy only. A bone is called by the joint at its end and turns as a rigid body: `rotvecs[bone]`
turns it against its parent bone, all zero is the T-pose. A bead is glued to one bone; elbows and knees of `random_pose`
turn about the line on which their bead sits, so that marker lines stay parallel to the bones.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap.bodies.puppet import MARKERS, PARENTS

Array = np.ndarray

ROOT_HEIGHT = 106.0
BEAD_RADIUS = 3.0
SIDES = ("l", "r")
BODY_COLOUR = 0.027  # linear reflectance of matt black paint
METAL_COLOUR = 0.05

_REST = {  # end of a bone minus its start in the T-pose, left side
    "lower-back-joint": (0.0, 16.0, 0.0),
    "upper-back-joint": (0.0, 38.0, 0.0),
    "head-joint": (0.0, 45.0, 0.0),
    "hip-joint": (11.5, -8.0, 0.0),
    "knee-joint": (1.35, -44.98, 0.0),
    "foot-joint": (1.29, -42.98, 0.0),
    "toes-joint": (0.0, 0.0, 18.0),
    "shoulder-joint": (22.0, 0.0, 0.0),
    "elbow-joint": (34.0, 0.0, 0.0),
    "hand-joint": (32.0, 0.0, 0.0),
    "finger-joint": (20.0, 0.0, 0.0),
}
_FRONT, _ARM_SIDE, _LEG_SIDE = (0.0, 0.0, 1.0), (0.0, 0.196, 0.981), (0.969, 0.029, 0.243)
# bead: (bone, part of the bone's length from its start, direction of the bead, distance of the limb's surface)
_BEADS = {
    "head.1": ("head-joint", 0.789, _FRONT, 11.2),
    "head.2": ("head-joint", 0.411, _FRONT, 11.2),
    "torso.1": ("upper-back-joint", 0.816, _FRONT, 12.0),
    "torso.2": ("upper-back-joint", 0.211, _FRONT, 12.0),
    "arm.1": ("elbow-joint", 0.176, _ARM_SIDE, 4.2),
    "arm.2": ("elbow-joint", 1.0, _ARM_SIDE, 4.2),
    "arm.3": ("hand-joint", 0.9375, _ARM_SIDE, 4.2),
    "leg.1": ("knee-joint", 0.1556, _LEG_SIDE, 5.9),
    "leg.2": ("knee-joint", 1.0, _LEG_SIDE, 5.9),
    "leg.3": ("foot-joint", 0.930, _LEG_SIDE, 5.9),
}


def _mirrored(v: tuple[float, float, float], side: str) -> Array:
    return np.array(v) * ([-1.0, 1.0, 1.0] if side == "r" else [1.0, 1.0, 1.0])


def _bead(name: str) -> tuple[str, float, Array, float]:
    """The row of a bead; arm.L1 from that of arm.1 for the left side."""
    limb, number = name.split(".")
    side = number[0].lower() if number[0] in "LR" else ""
    bone, part, towards, surface = _BEADS[f"{limb}.{number[-1]}"]
    return (f"{side}-{bone}" if side else bone), part, _mirrored(towards, side), surface


BONE_TABLE = {
    bone: (parent, _mirrored(_REST[bone.removeprefix("l-").removeprefix("r-")], bone[0]))
    for bone, parent in PARENTS.items()
    if parent is not None
}
BEAD_TABLE = {name: _bead(name) for name in MARKERS}


@dataclass(frozen=True)
class Proportions:
    """How much longer and thicker than the document's figure; bones not named keep their length."""

    length: Mapping[str, float] = field(default_factory=dict)
    """Factor by bone."""
    girth: float = 1.0
    """Factor of all limb radii."""
    bead_radius: float = BEAD_RADIUS
    """Radius of the beads [mm]."""


@dataclass(frozen=True)
class Solids:
    """Ellipsoids and cylinders: points p with |shape (p - centre)| <= 1 and 0 <= cut[:3].(p - centre) <= cut[3]."""

    shape: Array
    """(n, 3, 3) [1/mm]; for a cylinder it takes no notice of the component along the axis."""
    centre: Array
    """(n, 3) middle of an ellipsoid, start of a cylinder [mm]."""
    cut: Array
    """(n, 4) unit axis and length of a cylinder; zero axis and infinite length for an ellipsoid."""
    colour: Array
    """(n, 3) linear reflectance."""
    ends: Array
    """(n, 2, 3) two spheres of radius `reach` about these points and their hull hold the solid."""
    reach: Array
    """(n,) [mm]."""

    def moved(self, R: Array, t: Array) -> "Solids":
        """The solids in another frame: p' = R p + t."""
        cut = np.concatenate([self.cut[:, :3] @ R.T, self.cut[:, 3:]], axis=1)
        return Solids(self.shape @ R.T, self.centre @ R.T + t, cut, self.colour, self.ends @ R.T + t, self.reach)

    def chosen(self, index: Array) -> "Solids":
        """Some of the solids."""
        return Solids(*(getattr(self, k)[index] for k in Solids.__dataclass_fields__))


def stack_solids(parts: list[Solids]) -> Solids:
    """Several collections as one."""
    return Solids(*(np.concatenate([getattr(p, k) for p in parts]) for k in Solids.__dataclass_fields__))


def ellipsoid(centre: Array, R: Array, radii: object, colour: object) -> Solids:
    """One ellipsoid: half axes `radii` along the columns of R."""
    radii = np.asarray(radii, dtype=float)
    centre = np.asarray(centre, dtype=float)
    return Solids(
        (R / radii).T[None],
        centre[None],
        np.array([[0.0, 0.0, 0.0, np.inf]]),
        np.broadcast_to(np.asarray(colour, dtype=float), (1, 3)),
        np.stack([centre, centre])[None],
        np.array([radii.max()]),
    )


def sphere(centre: Array, radius: float, colour: object) -> Solids:
    """One sphere."""
    return ellipsoid(centre, np.eye(3), [radius] * 3, colour)


def cylinder(start: Array, end: Array, radius: float, colour: object) -> Solids:
    """One cylinder without lids."""
    length = np.linalg.norm(end - start)
    axis = (end - start) / length
    return Solids(
        ((np.eye(3) - np.outer(axis, axis)) / radius)[None],
        start[None],
        np.append(axis, length)[None],
        np.broadcast_to(np.asarray(colour, dtype=float), (1, 3)),
        np.stack([start, end])[None],
        np.array([radius]),
    )


@dataclass(frozen=True)
class Figure:
    """The figure in one pose, in its own frame = world of the turntable."""

    joints: dict[str, Array]
    """Position of every joint [mm]."""
    directions: dict[str, Array]
    """Unit direction of every bone."""
    lengths: dict[str, float]
    """Length of every bone [mm]."""
    orientations: dict[str, Array]
    """R_world_bone of every bone."""
    beads: Array
    """(16, 3) bead centres, in the order of MARKERS [mm]."""
    body: Solids
    """Everything but the beads."""
    bead_radius: float
    """[mm]."""


def pose_figure(
    rotvecs: Mapping[str, Array], proportions: Proportions | None = None, root: Array | None = None
) -> Figure:
    """The figure with each bone turned against its parent bone.

    Args:
        rotvecs: rotation vector by bone [rad], in the frame that is the world's in the T-pose; "root-joint" turns
            the whole figure; bones not named stay as in the T-pose.
        proportions: lengths and thickness.
        root: place of the root joint [mm]; on the axis by default.

    Returns:
        Joints, beads and solids.
    """
    p = proportions or Proportions()
    joints = {"root-joint": np.array([0.0, ROOT_HEIGHT, 0.0]) if root is None else np.asarray(root, dtype=float)}
    R = {"root-joint": Rotation.from_rotvec(rotvecs.get("root-joint", np.zeros(3))).as_matrix()}
    directions, lengths = {}, {}
    for bone, (parent, rest) in BONE_TABLE.items():
        R[bone] = R[parent] @ Rotation.from_rotvec(np.asarray(rotvecs.get(bone, np.zeros(3)))).as_matrix()
        vector = R[bone] @ rest * p.length.get(bone, 1.0)
        joints[bone] = joints[parent] + vector
        lengths[bone] = float(np.linalg.norm(vector))
        directions[bone] = vector / lengths[bone]
    beads = []
    for bone, part, side, surface in BEAD_TABLE.values():
        start = joints[BONE_TABLE[bone][0]]
        unit = side - directions_at_rest(bone) * (side @ directions_at_rest(bone))
        unit = unit / np.linalg.norm(unit)
        middle = start + part * lengths[bone] * directions[bone]
        beads.append(middle + R[bone] @ unit * (surface * p.girth + p.bead_radius))
    return Figure(joints, directions, lengths, R, np.array(beads), _body(joints, R, p.girth), p.bead_radius)


def directions_at_rest(bone: str) -> Array:
    """Unit direction of a bone in the T-pose."""
    rest = BONE_TABLE[bone][1]
    return rest / np.linalg.norm(rest)


def _body(joints: dict[str, Array], R: dict[str, Array], girth: float) -> Solids:
    """Trunk, head and limbs of matt black paint, and the metal rod that holds the figure."""

    def between(bone: str, part: float, radii: tuple[float, float, float]) -> Solids:
        start, end = joints[BONE_TABLE[bone][0]], joints[bone]
        return ellipsoid(start + part * (end - start), R[bone], np.array(radii) * girth, BODY_COLOUR)

    def limb(a: str, b: str, radius: float) -> list[Solids]:
        return [cylinder(joints[a], joints[b], radius * girth, BODY_COLOUR)]

    def ball(a: str, radius: float) -> Solids:
        return sphere(joints[a], radius * girth, BODY_COLOUR)

    neck = joints["upper-back-joint"] + 0.3 * (joints["head-joint"] - joints["upper-back-joint"])
    parts = [
        between("head-joint", 0.58, (11.0, 18.5, 11.2)),
        cylinder(joints["upper-back-joint"], neck, 4.4 * girth, BODY_COLOUR),
        between("upper-back-joint", 0.52, (18.0, 25.0, 12.0)),
        between("lower-back-joint", 1.05, (11.0, 9.0, 9.0)),
        between("lower-back-joint", 0.1, (15.0, 10.0, 10.0)),
    ]
    for s in SIDES:
        parts += [ball(f"{s}-shoulder-joint", 5.0), ball(f"{s}-elbow-joint", 4.2), ball(f"{s}-hand-joint", 3.9)]
        parts += limb("upper-back-joint", f"{s}-shoulder-joint", 4.0)
        parts += limb(f"{s}-shoulder-joint", f"{s}-elbow-joint", 4.2)
        parts += limb(f"{s}-elbow-joint", f"{s}-hand-joint", 4.0)
        parts.append(between(f"{s}-finger-joint", 0.5, (11.0, 3.8, 2.8)))
        parts += [ball(f"{s}-hip-joint", 6.6), ball(f"{s}-knee-joint", 5.9), ball(f"{s}-foot-joint", 5.2)]
        parts += limb(f"{s}-hip-joint", f"{s}-knee-joint", 5.9)
        parts += limb(f"{s}-knee-joint", f"{s}-foot-joint", 5.3)
        parts.append(between(f"{s}-toes-joint", 0.5, (4.6, 4.0, 12.5)))
    root = joints["root-joint"]
    foot = np.array([root[0], 0.0, root[2]])
    parts.append(cylinder(foot, root, 2.0, METAL_COLOUR))
    return stack_solids(parts)


def random_proportions(rng: np.random.Generator, bead_radius: float = BEAD_RADIUS) -> Proportions:
    """Another figure: bones up to 12 % longer or shorter, left as right."""
    factor = dict(zip(_REST, rng.uniform(0.88, 1.12, len(_REST))))
    length = {bone: float(factor[bone.removeprefix("l-").removeprefix("r-")]) for bone in BONE_TABLE}
    return Proportions(length, float(rng.uniform(0.9, 1.15)), bead_radius)


def _turn(angles: object) -> Array:
    """Rotation vector of turns about the fixed axes x, then y, then z [deg]."""
    return Rotation.from_euler("xyz", angles, degrees=True).as_rotvec()


def limb_pose(shoulders: list, elbows: list, hips: list, knees: list, torso: object, head: object) -> dict[str, Array]:
    """Rotation vectors by bone of angles in degrees, left then right.

    Args:
        shoulders: turns about x, y, z of each upper arm; z > 0 lifts the left arm and lowers the right one.
        elbows: each elbow about the side of its beads; the left one is bent upwards by > 0, the right one by < 0.
        hips: turns about x, y, z of each thigh; x < 0 swings it forwards.
        knees: each knee, > 0 bends it.
        torso: turns about x, y, z; x > 0 leans forwards.
        head: turns about x, y, z against the torso.

    Returns:
        Rotation vector by bone [rad].
    """
    pose = {"upper-back-joint": _turn(torso), "head-joint": _turn(head)}
    for k, side in enumerate(SIDES):
        arm, leg = _hinge(f"arm.{side.upper()}2"), _hinge(f"leg.{side.upper()}2")
        pose[f"{side}-elbow-joint"] = _turn(shoulders[k])
        pose[f"{side}-hand-joint"] = np.deg2rad(elbows[k]) * arm
        pose[f"{side}-knee-joint"] = _turn(hips[k])
        pose[f"{side}-foot-joint"] = np.deg2rad(knees[k]) * leg * np.sign(leg[0])
    return pose


def _hinge(bead: str) -> Array:
    bone, _, side, _ = BEAD_TABLE[bead]
    rest = directions_at_rest(bone)
    unit = side - rest * (side @ rest)
    return unit / np.linalg.norm(unit)


POSES: dict[str, dict[str, Array]] = {
    "tpose": {},
    "wave": limb_pose([[0, 5, 15], [0, 12, 40]], [75, -35], [[-8, 0, 5], [4, 0, -10]], [14, 9], [4, 0, -6], [2, 0, 14]),
    "stride": limb_pose(
        [[0, 55, -35], [0, 55, 40]], [-40, 60], [[-38, 0, 3], [28, 0, -3]], [22, 40], [9, 0, 3], [-17, 0, -5]
    ),
}


def random_pose(rng: np.random.Generator, proportions: Proportions | None = None) -> dict[str, Array]:
    """A pose in which no two beads touch and no bead is inside the body.

    Args:
        rng: of the pose.
        proportions: of the figure that shall take it.

    Returns:
        Rotation vector by bone [rad]. The puppet faces the camera at angle 0 to within 20 degrees; arms twist by 45.
    """
    for _ in range(100):
        twist, swing, roll = rng.uniform(-45, 45, 2), rng.uniform(-50, 30, 2), rng.uniform(-20, 20, 2)
        pose = limb_pose(
            [
                [twist[0], rng.uniform(-60, 30), rng.uniform(-75, 20)],
                [twist[1], rng.uniform(-30, 60), rng.uniform(-20, 75)],
            ],
            [rng.uniform(-30, 100), rng.uniform(-100, 30)],
            [[swing[0], roll[0], rng.uniform(-3, 20)], [swing[1], roll[1], rng.uniform(-20, 3)]],
            [rng.uniform(0, 70), rng.uniform(0, 70)],
            rng.uniform(-9, 9, 3),
            rng.uniform(-14, 14, 3),
        )
        pose["root-joint"] = _turn([0, rng.uniform(-20, 20), 0])
        figure = pose_figure(pose, proportions)
        apart = np.linalg.norm(figure.beads[:, None] - figure.beads[None], axis=2) + 1e3 * np.eye(len(MARKERS))
        if apart.min() > 2.2 * figure.bead_radius and not buried(figure).any():
            return pose
    return pose


def buried(figure: Figure) -> Array:
    """(16,) whether a bead's centre lies inside a solid of the body."""
    offset = figure.beads[:, None, :] - figure.body.centre[None]
    inside = np.linalg.norm(np.einsum("nij,bnj->bni", figure.body.shape, offset), axis=2) < 1.0
    along = np.einsum("ni,bni->bn", figure.body.cut[:, :3], offset)
    return (inside & (along >= 0.0) & (along <= figure.body.cut[:, 3])).any(axis=1)
