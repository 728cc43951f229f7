"""A motion made ready for a file: checked, gaps bridged, in the unit and the axes of the file."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from jaxmocap._errors import InputError
from jaxmocap.io.length_units import unit_factor
from jaxmocap.io.skeleton_tree import SkeletonOrder, check_tree

# Rows: x, y, z of the file in coordinates of the world, so that the axis named is y of the file. Proper rotations.
_R_FILE_WORLD = {
    "y": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "-y": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
    "z": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
    "-z": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
    "x": [[0, -1, 0], [1, 0, 0], [0, 0, 1]],
    "-x": [[0, 1, 0], [-1, 0, 0], [0, 0, 1]],
}


@runtime_checkable
class SkeletonMotion(Protocol):
    """What the exporters read."""

    names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: np.ndarray
    rotvec: np.ndarray
    root: np.ndarray
    unit: str
    fps: float


@dataclass(frozen=True)
class Take:
    """Joints over frames as a file stores them: y up, every number finite."""

    tree: SkeletonOrder
    """Names and hierarchy."""
    offsets: np.ndarray
    """(joints, 3) from the parent's joint, in the parent's frame [unit]; zero for the root."""
    quaternions: np.ndarray
    """(frames, joints, 4) local rotations, x y z w, of length 1, signs without jumps."""
    root: np.ndarray
    """(frames, 3) position of the root [unit]."""
    unit: str
    """Unit of lengths; "1" is none."""
    fps: float
    """Frames per second, as given: 29.97 is not rounded."""
    bridged: int
    """Values of joints or of the root that were missing and interpolated."""

    @property
    def frames(self) -> int:
        """How many frames there are, at least one."""
        return len(self.root)

    @property
    def times(self) -> np.ndarray:
        """(frames,) seconds; the first is 0."""
        return np.arange(self.frames) / self.fps

    def world(self) -> tuple[np.ndarray, np.ndarray]:
        """Position (frames, joints, 3) and quaternion (frames, joints, 4) of every joint in the world."""
        positions, rotations = np.empty((*self.quaternions.shape[:2], 3)), np.empty_like(self.quaternions)
        for joint in self.tree.order:
            parent = self.tree.parents[joint]
            local = Rotation.from_quat(self.quaternions[:, joint])
            if parent < 0:
                positions[:, joint], rotations[:, joint] = self.root, local.as_quat()
            else:
                above = Rotation.from_quat(rotations[:, parent])
                positions[:, joint] = positions[:, parent] + above.apply(self.offsets[joint])
                rotations[:, joint] = (above * local).as_quat()
        return positions, rotations

    def sentence(self, *more: str) -> str:
        """What a file holds, in one sentence; `more` clauses follow."""
        joints = f"{len(self.tree.names)} joint{'s' * (len(self.tree.names) != 1)}"
        frames = f"{self.frames} frames at {self.fps:.6g} frames per second" if self.frames > 1 else "1 frame"
        unit = "lengths without a physical unit" if self.unit == "1" else f"lengths in {self.unit}"
        bridged = [f"{self.bridged} missing values interpolated"] if self.bridged else []
        return ", ".join([joints, frames, unit, "y up", *bridged, *more]) + "."


def points_in_file(p_world: np.ndarray, unit: str, wanted: str, up: str) -> np.ndarray:
    """Points (..., 3) of the world in the unit and the axes of the file.

    Raises:
        InputError: for units that do not convert, or an unknown axis.
    """
    if up not in _R_FILE_WORLD:
        raise InputError(f"up: expected one of {', '.join(_R_FILE_WORLD)}, got {up!r}.")
    return p_world @ np.array(_R_FILE_WORLD[up], dtype=float).T * unit_factor(unit, wanted, "unit")


def prepare_take(motion: SkeletonMotion, *, unit: str | None, up: str, fps: float | None, gaps: int) -> Take:
    """Check a motion and turn it into what a file stores.

    Args:
        motion: the motion; NaN in rotvec or root marks what is missing.
        unit: unit of lengths in the file; None keeps that of the motion.
        up: axis of the motion's world that points up ("y", "-z", ...): it becomes y.
        fps: frames per second; None takes the motion's own.
        gaps: longest gap, in frames, that is bridged by interpolation (rotations along the shortest arc, the root
            on a straight line); 0 bridges none.

    Returns:
        The take.

    Raises:
        InputError: naming argument, joint and frames of what is wrong.
    """
    tree = check_tree(motion.names, motion.parents)
    offsets, rotvec, root = _arrays(motion, len(tree.names))
    wanted = motion.unit if unit is None else unit
    rate = _rate(motion.fps if fps is None else fps)
    # Offsets and rotations are carried over to the new axes alike: rotation vectors turn as points do.
    offsets, root = (points_in_file(values, motion.unit, wanted, up) for values in (offsets, root))
    quaternions, root, bridged = _bridge(tree.names, points_in_file(rotvec, "1", "1", up), root, gaps)
    offsets[tree.order[0]] = 0.0
    return Take(tree, offsets, quaternions, root, wanted, rate, bridged)


def continuous_quaternions(quaternions: np.ndarray) -> np.ndarray:
    """The same rotations with signs such that neighbours along the first axis lie on one half of the sphere.

    The first has w >= 0. Programs interpolate the numbers: a change of sign would make a joint spin.
    """
    flips = np.sum(quaternions[1:] * quaternions[:-1], axis=-1, keepdims=True) < 0
    first = quaternions[:1, ..., 3:] < 0
    odd = np.cumsum(np.concatenate([first, flips]), axis=0) % 2
    return quaternions * (1 - 2 * odd)


def _arrays(motion: SkeletonMotion, joints: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    offsets, rotvec, root = (
        np.array(values, dtype=float) for values in (motion.offsets, motion.rotvec, motion.root)
    )  # fmt: skip
    if offsets.shape != (joints, 3):
        raise InputError(f"offsets: expected shape ({joints}, 3), one row per joint, got {offsets.shape}.")
    if rotvec.ndim != 3 or rotvec.shape[1:] != (joints, 3):
        raise InputError(f"rotvec: expected shape (frames, {joints}, 3), got {rotvec.shape}.")
    if root.shape != (len(rotvec), 3):
        raise InputError(f"root: expected shape ({len(rotvec)}, 3), one row per frame, got {root.shape}.")
    if not len(rotvec):
        raise InputError("motion: expected at least one frame, got none. There is nothing to write.")
    for joint in np.flatnonzero(~np.isfinite(offsets).all(axis=1)):
        raise InputError(f"offsets: joint {motion.names[joint]!r} has no finite offset. Leave the joint out.")
    if np.isinf(rotvec).any() or np.isinf(root).any():
        raise InputError("motion: expected finite numbers, or NaN where something is missing, got infinity.")
    return offsets, rotvec, root


def _rate(fps: float) -> float:
    if not (isinstance(fps, int | float | np.number) and math.isfinite(fps) and fps > 0):
        raise InputError(f"fps: expected frames per second above 0, got {fps!r}. Give the rate of the recording.")
    return float(fps)


def _bridge(
    names: Sequence[str], rotvec: np.ndarray, root: np.ndarray, gaps: int
) -> tuple[np.ndarray, np.ndarray, int]:
    """Quaternions and root without holes, and how many values were filled in."""
    if isinstance(gaps, bool) or not isinstance(gaps, int | np.integer) or gaps < 0:
        raise InputError(f"gaps: expected a number of frames from 0, got {gaps!r}.")
    frames = np.arange(len(root))
    seen = ~np.isnan(rotvec).any(axis=2)
    seen_root = ~np.isnan(root).any(axis=1)
    for joint, name in enumerate(names):
        _refuse_gaps(f"joint {name!r}", seen[:, joint], gaps)
    _refuse_gaps("the position of the root", seen_root, gaps)
    quaternions = np.empty((*rotvec.shape[:2], 4))
    for joint in range(len(names)):
        known = Rotation.from_rotvec(rotvec[seen[:, joint], joint])
        path = known if seen[:, joint].all() else Slerp(frames[seen[:, joint]], known)(frames)
        quaternions[:, joint] = path.as_quat()
    filled = np.stack([np.interp(frames, frames[seen_root], root[seen_root, k]) for k in range(3)], axis=1)
    return continuous_quaternions(quaternions), filled, int(np.sum(~seen) + np.sum(~seen_root))


def _refuse_gaps(what: str, seen: np.ndarray, longest: int) -> None:
    """Refuse gaps longer than `longest`, and those at the ends, which nothing bounds on one side."""
    if seen.all():
        return
    if not seen.any():
        raise InputError(f"motion: {what} is missing in every frame. Leave it out, or repair the reconstruction.")
    edges = np.flatnonzero(np.diff(np.concatenate([[True], seen, [True]]).astype(int)))
    for start, stop in edges.reshape(-1, 2):
        where = f"frame {start}" if stop == start + 1 else f"frames {start} to {stop - 1}"
        if start == 0 or stop == len(seen):
            raise InputError(
                f"motion: {what} is missing in {where}, at the {'start' if start == 0 else 'end'} of the take, "
                "where nothing can be interpolated. Cut these frames off."
            )
        if stop - start > longest:
            raise InputError(
                f"motion: {what} is missing in {where}; gaps={longest} allows {longest or 'no'} missing frames. "
                f"Repair the gap, or give gaps={stop - start} to interpolate it."
            )
