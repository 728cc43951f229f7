"""Beads of made-up puppet poses, with numpy alone: nothing here calls jaxmocap."""

import numpy as np
from scipy.spatial.transform import Rotation

BEADS = ["head.1", "head.2", "torso.1", "torso.2"] + [
    f"{p}.{s}{i}" for p in ("arm", "leg") for s in "LR" for i in "123"
]
MIRRORED = [BEADS.index(b.replace(".L", ".X").replace(".R", ".L").replace(".X", ".R")) for b in BEADS]
T_POSE = {
    "back": (0, 1, 0), "head": (0, 1, 0),
    "L": {"arm": ((1, 0, 0), (1, 0, 0)), "leg": ((0, -1, 0), (0, -1, 0))},
    "R": {"arm": ((-1, 0, 0), (-1, 0, 0)), "leg": ((0, -1, 0), (0, -1, 0))},
}  # fmt: skip
"""Directions of the bones; of arms and legs: (upper, lower)."""


def pose(**changes):
    """The T-pose with other directions: back=, head=, arm_L=(upper, lower), leg_R=..."""
    made = {"back": T_POSE["back"], "head": T_POSE["head"], "L": dict(T_POSE["L"]), "R": dict(T_POSE["R"])}
    for name, value in changes.items():
        if "_" in name:
            limb, side = name.split("_")
            made[side][limb] = value
        else:
            made[name] = value
    return made


def random_pose(rng, swing=0.6):
    """Every bone turned away from the T-pose by a random angle of that size [rad]."""
    turn = lambda v: Rotation.from_rotvec(swing * rng.normal(size=3) / np.sqrt(3)).apply(np.array(v, float))  # noqa: E731
    made = {"back": turn(T_POSE["back"]), "head": turn(T_POSE["head"])}
    for side in "LR":
        made[side] = {limb: (turn(two[0]), turn(two[1])) for limb, two in T_POSE[side].items()}
    return made


def beads_of(directions):
    """(16, 3) bead centres [mm]: bead lines parallel to the bones, upper beads at any fixed places."""
    unit = lambda v: np.array(v, float) / np.linalg.norm(v)  # noqa: E731
    at = {"torso.2": np.array([0.0, 130, 15]), "head.2": np.array([1.0, 178, 14])}
    at["torso.1"] = at["torso.2"] + 23.0 * unit(directions["back"])
    at["head.1"] = at["head.2"] + 17.0 * unit(directions["head"])
    for side, sign in (("L", 1.0), ("R", -1.0)):
        for limb, first, spans in (("arm", (28, 161, 7), (28, 30)), ("leg", (20, 91, 2), (38, 40))):
            p = np.array(first, float) * (sign, 1, 1)
            at[f"{limb}.{side}1"] = p
            for i, (span, v) in enumerate(zip(spans, directions[side][limb]), 2):
                p = p + span * unit(v)
                at[f"{limb}.{side}{i}"] = p
    return np.array([at[b] for b in BEADS])
