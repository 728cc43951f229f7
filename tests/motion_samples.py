"""Skeletons in motion for the tests of exporters, with positions of their joints worked out here."""

import math

import numpy as np

from jaxmocap.bodies import SkeletonMotion


def arm(**changes) -> SkeletonMotion:
    """Root, elbow 3 up, hand 2 further: the elbow bends by 0, 45 and 90 degrees about z. Lengths in cm."""
    rotvec = np.zeros((3, 3, 3))
    rotvec[:, 1, 2] = [0.0, math.pi / 4, math.pi / 2]
    values = {
        "names": ("root-joint", "elbow", "hand"),
        "parents": (-1, 0, 1),
        "offsets": np.array([[0.0, 0, 0], [0, 3, 0], [0, 2, 0]]),
        "rotvec": rotvec,
        "root": np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]),
        "unit": "cm",
        "fps": 25.0,
    }
    return SkeletonMotion(**values | changes)


# By hand: the hand is 2 beyond the elbow, turned by the angle from y towards -x.
ARM_HANDS = np.array([[0.0, 5, 0], [1 - math.sqrt(2), 3 + math.sqrt(2), 0], [2 - 2, 3, 0]])
ARM_ELBOWS = np.array([[0.0, 3, 0], [1, 3, 0], [2, 3, 0]])


def still(frame: int = 0, **changes) -> SkeletonMotion:
    """One frame of the arm."""
    whole = arm()
    return arm(**{"rotvec": whole.rotvec[frame : frame + 1], "root": whole.root[frame : frame + 1]} | changes)


def tumbling(seed: int, frames: int = 30, joints: int = 6) -> SkeletonMotion:
    """A random tree whose joints turn by several whole turns; lengths in mm."""
    rng = np.random.default_rng(seed)
    parents = (-1, *(int(rng.integers(0, j)) for j in range(1, joints)))
    return SkeletonMotion(
        names=tuple(f"joint{j}" for j in range(joints)),
        parents=parents,
        offsets=rng.normal(size=(joints, 3)) * 30 * (np.arange(joints) > 0)[:, None],
        rotvec=np.cumsum(rng.normal(size=(frames, joints, 3)) * 0.3, axis=0),
        root=rng.normal(size=(frames, 3)) * 10,
        unit="mm",
        fps=29.97,
    )


def matrix(rotvec: np.ndarray) -> np.ndarray:
    """Rodrigues' formula, so that no rotation of the package or of scipy is needed."""
    angle = float(np.linalg.norm(rotvec))
    if angle == 0:
        return np.eye(3)
    x, y, z = rotvec / angle
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * K + (1 - math.cos(angle)) * K @ K


def positions(motion: SkeletonMotion) -> np.ndarray:
    """(frames, joints, 3) by going down the tree; parents come first in these samples."""
    frames, joints, _ = motion.rotvec.shape
    p, R = np.zeros((frames, joints, 3)), np.zeros((frames, joints, 3, 3))
    for f in range(frames):
        for j, parent in enumerate(motion.parents):
            local = matrix(motion.rotvec[f, j])
            R[f, j] = local if parent < 0 else R[f, parent] @ local
            p[f, j] = motion.root[f] if parent < 0 else p[f, parent] + R[f, parent] @ motion.offsets[j]
    return p
