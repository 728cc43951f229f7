"""BVH: the skeleton's rest offsets and, frame by frame, Euler angles without jumps."""

import math
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap.bodies.motion import SkeletonMotion
from jaxmocap.io.atomic import write_text
from jaxmocap.io.take import Take, prepare_take
from jaxmocap.io.written_names import unique_words

_ORDERS = ((2, 0, 1), (2, 1, 0), (0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0))
"""Axes in the order of the channels; the first, ZXY, is the usual one and wins draws."""

_LOCKED = 1e-7
"""cos(middle angle) below which the outer angles turn about one axis and only their sum or difference is defined:
rounding of the matrix (1e-16) then moves them by more than 1e-9 rad."""


def write_bvh(
    path: str | Path,
    motion: SkeletonMotion,
    *,
    unit: str | None = None,
    up: str = "y",
    fps: float | None = None,
    gaps: int = 0,
) -> str:
    """Write a motion as BVH, whole or not at all.

    Each joint's channels come in the order (of six) that keeps its middle angle farthest from 90 degrees over the
    take; among the angles that give one rotation, those nearest the frame before are written.

    Args:
        path: the file.
        motion: the motion.
        unit: unit of lengths in the file (BVH itself has no place for it); None keeps that of the motion.
        up: axis of the motion's world that points up; it becomes y, as BVH is usually read.
        fps: frames per second; None takes the motion's own.
        gaps: longest run of missing frames that is interpolated.

    Returns:
        One sentence on what was written.

    Raises:
        InputError: for a motion that no file can hold, or if the file cannot be written.
    """
    text, said = bvh_text(motion, unit=unit, up=up, fps=fps, gaps=gaps)
    write_text(path, text)
    return f"{path}: {said}"


def bvh_text(
    motion: SkeletonMotion, *, unit: str | None = None, up: str = "y", fps: float | None = None, gaps: int = 0
) -> tuple[str, str]:
    """The text that `write_bvh` writes, and its sentence without the file name.

    Raises:
        InputError: as `write_bvh`.
    """
    take = prepare_take(motion, unit=unit, up=up, fps=fps, gaps=gaps)
    m = take.motion
    R_parent_joint = Rotation.from_quat(take.quaternions.reshape(-1, 4)).as_matrix().reshape(*m.rotvec.shape, 3)
    orders = [_best_order(R_parent_joint[:, joint]) for joint in range(len(m.names))]
    words = unique_words(m.names, r"\w.:\-", r"\w")  # a space ends a name in BVH
    hierarchy, listed = _hierarchy(take, words, orders)
    angles = [np.degrees(continuous_euler(R_parent_joint[:, joint], orders[joint])) for joint in listed]
    rows = [_numbers(row) for row in np.concatenate([m.root, *angles], axis=1)]
    lines = [*hierarchy, "MOTION", f"Frames: {m.frames}", f"Frame Time: {1 / m.fps!r}"]
    renamed = [f"{n!r} is called {w}" for n, w in zip(m.names, words) if n != w]
    more = [f"{len(renamed)} joint names changed ({renamed[0]})"] if renamed else []
    return "\n".join([*lines, *rows, ""]), take.sentence(*more)


def continuous_euler(R: np.ndarray, order: tuple[int, int, int]) -> np.ndarray:
    """Angles (a, b, c) with R = R_i(a) R_j(b) R_k(c) at each frame, as near to the frame before as can be.

    Args:
        R: (frames, 3, 3) rotation matrices.
        order: (i, j, k), the axes, all different.

    Returns:
        (frames, 3) angles [rad], not confined to a turn. Where the middle angle is a quarter turn, the first
        angle stays as it was before and the third says the rest.
    """
    i, j, k = order
    sign = 1.0 if (j - i) % 3 == 1 else -1.0
    cosine = np.hypot(R[:, i, i], R[:, i, j])
    b = np.arctan2(sign * R[:, i, k], cosine)
    a = np.arctan2(-sign * R[:, j, k], R[:, k, k])
    c = np.arctan2(-sign * R[:, i, j], R[:, i, i])
    angles, before = [], (0.0, 0.0, 0.0)
    for frame, (now, locked) in enumerate(zip(np.stack([a, b, c], axis=1).tolist(), (cosine <= _LOCKED).tolist())):
        if locked:  # what is left is a turn about the axis k after the angle kept: R_j(-b) R_i(-a) R
            rest = (_turn(i, before[0]) @ _turn(j, now[1])).T @ R[frame]
            now = [before[0], now[1], math.atan2(rest[(k + 2) % 3, (k + 1) % 3], rest[(k + 1) % 3, (k + 1) % 3])]
        flipped = [now[0] + math.pi, math.pi - now[1], now[2] + math.pi]  # the same rotation
        before = min((_near(now, before), _near(flipped, before)), key=partial(math.dist, before))
        angles.append(before)
    return np.array(angles)


def _near(angles: list[float], before: tuple[float, float, float]) -> tuple[float, float, float]:
    """The same angles, each with the whole turns that bring it nearest to the one before."""
    a, b, c = (x + math.tau * round((y - x) / math.tau) for x, y in zip(angles, before))
    return a, b, c


def _turn(axis: int, angle: float) -> np.ndarray:
    R, i, j = np.eye(3), (axis + 1) % 3, (axis + 2) % 3
    R[i, i] = R[j, j] = math.cos(angle)
    R[j, i] = math.sin(angle)
    R[i, j] = -R[j, i]
    return R


def _best_order(R: np.ndarray) -> tuple[int, int, int]:
    """The order whose middle angle stays farthest from a quarter turn; its sine is the entry (first, last)."""
    worst = [round(float(np.max(np.abs(R[:, order[0], order[2]]))), 6) for order in _ORDERS]
    # The usual order unless it comes within 30 degrees of gimbal lock: readers know it best.
    return _ORDERS[0] if worst[0] < math.cos(math.radians(30)) else _ORDERS[int(np.argmin(worst))]


def _hierarchy(take: Take, words: list[str], orders: list[tuple[int, int, int]]) -> tuple[list[str], list[int]]:
    """The lines of the hierarchy, and the joints in its order, which is also that of the numbers."""
    lines, listed = ["HIERARCHY"], []

    def add(joint: int, tabs: str) -> None:
        is_root = take.motion.parents[joint] < 0
        turns = " ".join(f"{'XYZ'[axis]}rotation" for axis in orders[joint])
        channels = f"6 Xposition Yposition Zposition {turns}" if is_root else f"3 {turns}"
        lines.extend([f"{tabs}{'ROOT' if is_root else 'JOINT'} {words[joint]}", f"{tabs}{{"])
        lines.extend([f"{tabs}\tOFFSET {_numbers(take.motion.offsets[joint])}", f"{tabs}\tCHANNELS {channels}"])
        listed.append(joint)
        children = take.children(joint)
        for child in children:
            add(child, tabs + "\t")
        if not children:  # the grammar wants an end; nothing is known beyond the last joint
            lines.extend([f"{tabs}\tEnd Site", f"{tabs}\t{{", f"{tabs}\t\tOFFSET 0 0 0", f"{tabs}\t}}"])
        lines.append(f"{tabs}}}")

    add(take.motion.parents.index(-1), "")
    return lines, listed


def _numbers(values: np.ndarray) -> str:
    # Rounding turns what is left of a cosine of 90 degrees into 0, and + 0.0 turns -0 into 0.
    return " ".join(f"{round(float(v), 12) + 0.0:.10g}" for v in values)
