"""A skeleton over time as plain numbers: what exporters and the viewer take."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap._arrays import check_finite, check_shape
from jaxmocap._errors import InputError
from jaxmocap.bodies.tree import check_tree


@dataclass(frozen=True)
class SkeletonMotion:
    """Joint rotations frame by frame. A single pose is a motion of one frame. Checked when made.

    What is missing is NaN here and never reaches a file: exporters bridge gaps as they are told, or refuse them.

    Joint j stands at p_parent + R_parent offset_j and is turned by R_parent exp(rotvec_j).
    """

    names: tuple[str, ...]
    """One per joint, parents before children."""
    parents: tuple[int, ...]
    """Index of the parent, -1 for the root."""
    offsets: np.ndarray
    """(joints, 3) rest offset from the parent's joint, in the parent's frame; the root's is not used."""
    rotvec: np.ndarray
    """(frames, joints, 3) rotation relative to the parent [rad]; the root's: to the world. NaN where it is missing."""
    root: np.ndarray
    """(frames, 3) position of the root; NaN where it is missing."""
    unit: str = "mm"
    """Unit of offsets and root; "1": no physical unit."""
    fps: float = 25.0
    """Frames per second."""

    def __post_init__(self):
        check_tree(self.names, self.parents)
        joints = len(self.names)
        rotvec = check_shape("rotvec", self.rotvec, (None, joints, 3))
        values = {
            "offsets": check_shape("offsets", self.offsets, (joints, 3)),
            "rotvec": rotvec,
            "root": check_shape("root", self.root, (rotvec.shape[0], 3)),
        }
        if not rotvec.shape[0]:
            raise InputError("rotvec: expected at least one frame, got none")
        check_finite("offsets", values["offsets"], "A bone needs a length, whether or not it was seen.")
        for name, value in values.items():
            if np.isinf(value).any():
                raise InputError(f"{name}: expected finite numbers, or NaN where something is missing, got infinity")
            object.__setattr__(self, name, np.array(value))  # JAX lends its memory read-only, which scipy refuses
        if not (np.isfinite(self.fps) and self.fps > 0):
            raise InputError(f"fps: expected a positive number, got {self.fps}")
        if not self.unit.strip():
            raise InputError('unit: expected a unit such as "mm", or "1" for none, got an empty text')

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.rotvec.shape[0]

    def world(self) -> tuple[np.ndarray, np.ndarray]:
        """Orientation (frames, joints, 3, 3) and position (frames, joints, 3) of every joint in the world."""
        local = Rotation.from_rotvec(np.array(self.rotvec.reshape(-1, 3))).as_matrix().reshape(*self.rotvec.shape, 3)
        R, p = np.empty_like(local), np.empty_like(self.rotvec)
        for j, parent in enumerate(self.parents):
            if parent == -1:
                R[:, j], p[:, j] = local[:, j], self.root
            else:
                R[:, j] = R[:, parent] @ local[:, j]
                p[:, j] = p[:, parent] + R[:, parent] @ self.offsets[j]
        return R, p

    def world_translations(self) -> tuple[tuple[str, ...], tuple[int, ...], np.ndarray]:
        """The motion as the document's COLLADA has it: no rotations, translations in the axes of the world.

        Joints that stand on their parent's (the neck) are left out; what hangs on them hangs on the parent.

        Returns:
            names, parents, (frames, joints, 3): each joint's position minus its parent's; the root's position.
        Source: stop-motion document, 6.3 (eq. 6.2-6.3).
        """
        _, p = self.world()
        keep = [j for j, parent in enumerate(self.parents) if parent == -1 or np.any(self.offsets[j] != 0)]
        parents = []
        for j in keep:
            above = self.parents[j]
            while above != -1 and above not in keep:
                above = self.parents[above]
            parents.append(above)
        t = np.stack([p[:, j] - (0.0 if a == -1 else p[:, a]) for j, a in zip(keep, parents)], axis=1)
        return tuple(self.names[j] for j in keep), tuple(-1 if a == -1 else keep.index(a) for a in parents), t
