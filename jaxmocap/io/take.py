"""A motion made ready for a file: gaps bridged, in the unit and the axes of the file."""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from jaxmocap._errors import InputError
from jaxmocap.bodies.motion import SkeletonMotion
from jaxmocap.geometry.upright import R_UPRIGHT_WORLD
from jaxmocap.io.length_units import unit_factor
from jaxmocap.io.written_names import check_writable

_MAX_DEPTH = 200
"""Readers of nested files recurse; Python's own limit of 1000 calls leaves room for about this many levels."""


@dataclass(frozen=True)
class Take:
    """A motion as a file stores it: y up, every number finite."""

    motion: SkeletonMotion
    """In the unit and the axes of the file, without gaps; the root's offset is zero."""
    quaternions: np.ndarray
    """(frames, joints, 4) its local rotations, x y z w, of length 1, signs without jumps."""
    bridged: int
    """Values of joints or of the root that were missing and interpolated."""

    @property
    def times(self) -> np.ndarray:
        """(frames,) seconds; the first is 0."""
        return np.arange(self.motion.frames) / self.motion.fps

    def children(self, joint: int) -> list[int]:
        """Joints that hang on this one."""
        return [child for child, parent in enumerate(self.motion.parents) if parent == joint]

    def sentence(self, *more: str, joints: int | None = None) -> str:
        """What a file holds, in one sentence; `more` clauses follow. `joints`: how many it holds, if not all."""
        m = self.motion
        n = len(m.names) if joints is None else joints
        written = f"{n} joint{'s' * (n != 1)}"
        frames = f"{m.frames} frames at {m.fps:.6g} frames per second" if m.frames > 1 else "1 frame"
        unit = "lengths without a physical unit" if m.unit == "1" else f"lengths in {m.unit}"
        bridged = [f"{self.bridged} missing values interpolated"] if self.bridged else []
        return ", ".join([written, frames, unit, "y up", *bridged, *more]) + "."


def prepare_take(motion: SkeletonMotion, *, unit: str | None, up: str, fps: float | None, gaps: int) -> Take:
    """Turn a motion into what a file stores.

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
    check_writable(motion.names)
    _check_depth(motion)
    wanted = motion.unit if unit is None else unit
    rate = motion.fps if fps is None else float(fps)
    if not (math.isfinite(rate) and rate > 0):
        raise InputError(f"fps: expected frames per second above 0, got {fps!r}. Give the rate of the recording.")
    if isinstance(gaps, bool) or not isinstance(gaps, int | np.integer) or gaps < 0:
        raise InputError(f"gaps: expected a number of frames from 0, got {gaps!r}.")
    # Offsets and rotations are carried over to the new axes alike: rotation vectors turn as points do.
    offsets, root = (points_in_file(values, motion.unit, wanted, up) for values in (motion.offsets, motion.root))
    offsets[motion.parents.index(-1)] = 0.0
    rotvec = points_in_file(motion.rotvec, "1", "1", up)
    bridged = int(np.sum(~_seen(rotvec)) + np.sum(~_seen(root)))
    quaternions, root = _bridge(motion.names, rotvec, root, gaps)
    filled = Rotation.from_quat(quaternions.reshape(-1, 4)).as_rotvec().reshape(rotvec.shape)
    ready = replace(motion, offsets=offsets, rotvec=filled, root=root, unit=wanted, fps=rate)
    return Take(ready, quaternions, bridged)


def points_in_file(p_world: np.ndarray, unit: str, wanted: str, up: str) -> np.ndarray:
    """Points (..., 3) of the world in the unit and the axes of the file.

    Raises:
        InputError: for units that do not convert, or an unknown axis.
    """
    if up not in R_UPRIGHT_WORLD:
        raise InputError(f"up: expected one of {', '.join(R_UPRIGHT_WORLD)}, got {up!r}.")
    return p_world @ R_UPRIGHT_WORLD[up].T * unit_factor(unit, wanted, "unit")


def continuous_quaternions(quaternions: np.ndarray) -> np.ndarray:
    """The same rotations with signs such that neighbours along the first axis lie on one half of the sphere.

    The first has w >= 0. Programs interpolate the numbers: a change of sign would make a joint spin.
    """
    flips = np.sum(quaternions[1:] * quaternions[:-1], axis=-1, keepdims=True) < 0
    first = quaternions[:1, ..., 3:] < 0
    odd = np.cumsum(np.concatenate([first, flips]), axis=0) % 2
    return quaternions * (1 - 2 * odd)


def _check_depth(motion: SkeletonMotion) -> None:
    depth = {-1: 0}
    for joint, (name, parent) in enumerate(zip(motion.names, motion.parents)):
        depth[joint] = depth[parent] + 1
        if depth[joint] > _MAX_DEPTH:
            raise InputError(f"parents: joint {name!r} lies more than {_MAX_DEPTH} levels deep; use fewer.")


def _bridge(names: tuple[str, ...], rotvec: np.ndarray, root: np.ndarray, gaps: int) -> tuple[np.ndarray, np.ndarray]:
    """Quaternions and root without holes."""
    frames = np.arange(len(root))
    seen, seen_root = _seen(rotvec), _seen(root)
    for joint, name in enumerate(names):
        _refuse_gaps(f"joint {name!r}", seen[:, joint], gaps)
    _refuse_gaps("the position of the root", seen_root, gaps)
    quaternions = np.empty((*rotvec.shape[:2], 4))
    for joint in range(len(names)):
        known = Rotation.from_rotvec(rotvec[seen[:, joint], joint])
        path = known if seen[:, joint].all() else Slerp(frames[seen[:, joint]], known)(frames)
        quaternions[:, joint] = path.as_quat()
    filled = np.stack([np.interp(frames, frames[seen_root], root[seen_root, k]) for k in range(3)], axis=1)
    return continuous_quaternions(quaternions), filled


def _seen(values: np.ndarray) -> np.ndarray:
    return np.asarray(np.isfinite(values).all(axis=-1))


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
