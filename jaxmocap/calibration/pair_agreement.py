"""Do two cameras' views agree on how the cameras stand to each other? Found out before they are solved together.

Each view of a target gives the relative pose of two cameras, with an uncertainty that follows from the corners'
noise. Views that were not taken at one moment, or are paired wrongly, give another pose than the rest; solved
together they would be blamed on lens or start values.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import chdtri

_LIMIT = float(chdtri(6, 1e-6))
"""Squared, normalised difference of two poses (6 numbers) that one view in a million exceeds by independent noise."""

SHARED_ERRORS = 25.0
"""Errors that the corners of one photo share (blur, light, a bent board, a lens model that does not fit) make poses
scatter more than independent noise does. Pairs are blamed only beyond what sigmas five times too small would allow:
a good set of photographs with a bent board has a design effect of 9, sigmas three times too small."""

_LEAST_SIGMA = 0.02
"""Pixels. No corner of a photo is known better; exact simulated ones are."""

_AMBIGUOUS = 10.0
"""Pixels per sigma by which the mirrored pose of a flat target must be worse for the pose to be certain."""


class CameraPoses(NamedTuple):
    """What one camera alone says of each view."""

    K: np.ndarray
    """(3, 3) [px]."""
    T: np.ndarray
    """T_camera_target (views, 4, 4); the target's frame has its origin in the middle of the points."""
    used: np.ndarray
    """(views,), whether the pose is known."""
    variance: float
    """Of one coordinate of a corner [px^2]."""


class Disagreement(NamedTuple):
    """Pairs of two cameras that do not agree."""

    cameras: tuple[int, int]
    views: np.ndarray
    """Those that disagree with the largest group that agrees; all if no group holds more than half of them."""
    agreeing: int
    """Size of the largest group that agrees."""
    total: int
    """Number of views that were compared."""
    swapped: bool
    """Whether all that disagree would agree with left and right exchanged."""


def disagreements(
    cameras: list[CameraPoses], points: np.ndarray, seen: np.ndarray, inflation: float = SHARED_ERRORS
) -> list[Disagreement]:
    """Views whose relative pose of two cameras differs from that of the other views far beyond the noise.

    Args:
        cameras: poses of the targets, for each camera alone.
        points: (views, points, 3) in frames whose origins are in the middle of the targets [scene].
        seen: (views, cameras, points).
        inflation: how many times the variance of independent noise is allowed.

    Returns:
        one entry for each two cameras that disagree; empty where all agree or fewer than two views are shared.
    Source: squared Mahalanobis distance of poses, chi-squared with 6 degrees of freedom; the largest group that
        agrees with one of its members as in RANSAC (Fischler and Bolles 1981), every member tried.
    """
    covariances = [_pose_covariances(c, points, seen[:, k]) for k, c in enumerate(cameras)]
    certain = [c.used & _is_certain(c, points, seen[:, k]) for k, c in enumerate(cameras)]
    found = []
    for a in range(len(cameras)):
        for b in range(a + 1, len(cameras)):
            views = np.flatnonzero(certain[a] & certain[b])
            if len(views) >= 2:
                found += _compare((a, b), views, cameras, covariances, inflation * _LIMIT)
    return found


def _compare(
    pair: tuple[int, int],
    views: np.ndarray,
    cameras: list[CameraPoses],
    covariances: list[np.ndarray],
    limit: float,
) -> list[Disagreement]:
    """The disagreement of two cameras, if there is one."""
    sides = [(cameras[k].T[views], covariances[k][views]) for k in pair]
    middle = np.median(sides[0][0][:, :3, 3], axis=0)  # where the poses are compared: amid the targets
    R, x, C = _relative(*sides[0], *sides[1], middle)
    distance = _distances((R, x, C), (R, x, C))
    agree = distance <= limit
    best = min(range(len(views)), key=lambda i: (-agree[i].sum(), np.median(distance[i])))
    inside, out = agree[best], ~agree[best]
    if inside.sum() * 2 <= len(views):
        return [Disagreement(pair, views, int(inside.sum()), len(views), False)]
    if inside.all():
        return []
    # Exchanged: the same with the two sides' photos in each other's place.
    back = _distances((R[[best]], x[[best]], C[[best]]), _relative(*sides[1], *sides[0], middle))[0]
    swapped = bool((back[out] <= limit).all())
    return [Disagreement(pair, views[out], int(inside.sum()), len(views), swapped)]


def _relative(
    T_a: np.ndarray, C_a: np.ndarray, T_b: np.ndarray, C_b: np.ndarray, p_a: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rotation b <- a of each view, where it puts the point p_a, and the covariance (views, 6, 6) of both.

    A pose's error is (theta, tau): R becomes exp(theta) R, t becomes t + tau. With R_ba = R_b R_a^T that of the
    relative pose is theta = theta_b - R_ba theta_a, and p_a moves by theta x R_ba (p_a - t_a) + tau_b - R_ba tau_a.
    """
    R = T_b[:, :3, :3] @ np.swapaxes(T_a[:, :3, :3], 1, 2)
    arm = np.einsum("vij,vj->vi", R, p_a - T_a[:, :3, 3])
    six = np.zeros((len(R), 6, 6))
    six[:, :3, :3] = six[:, 3:, 3:] = R
    lever = np.tile(np.eye(6), (len(R), 1, 1))
    lever[:, 3:, :3] = -_cross_matrices(arm)
    C = lever @ (C_b + six @ C_a @ np.swapaxes(six, 1, 2)) @ np.swapaxes(lever, 1, 2)
    return R, arm + T_b[:, :3, 3], C


_Relative = tuple[np.ndarray, np.ndarray, np.ndarray]


def _distances(these: _Relative, those: _Relative) -> np.ndarray:
    """Squared Mahalanobis distance of each of these relative poses from each of those."""
    out = np.zeros((len(these[0]), len(those[0])))
    for i, (R, x, C) in enumerate(zip(*these)):
        turn = Rotation.from_matrix(R @ np.swapaxes(those[0], 1, 2)).as_rotvec()
        d = np.concatenate([turn, x - those[1]], axis=1)
        out[i] = np.einsum("vi,vi->v", d, np.linalg.solve(C + those[2], d[..., None])[..., 0])
    return out


def _pose_covariances(camera: CameraPoses, points: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Covariance (views, 6, 6) of each pose's (theta, tau) for independent noise and a known lens.

    The lens is left out of the derivatives: it changes them by a few per cent.
    """
    variance = max(camera.variance, _LEAST_SIGMA**2)
    out = np.tile(np.eye(6), (len(points), 1, 1))
    for v in np.flatnonzero(camera.used):
        arm = points[v][seen[v]] @ camera.T[v, :3, :3].T
        p = arm + camera.T[v, :3, 3]
        z = p[:, 2, None, None]
        J_uv_p = (camera.K[None, :2] - (p @ camera.K.T)[:, :2, None] / z * [0.0, 0.0, 1.0]) / z
        J = np.concatenate([-J_uv_p @ _cross_matrices(arm), J_uv_p], axis=2).reshape(-1, 6)
        out[v] = variance * np.linalg.pinv(J.T @ J, rcond=1e-14, hermitian=True)
    return out


def _is_certain(camera: CameraPoses, points: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Whether each view tells its pose from the mirrored one (targets far away or small do not).

    Source: `calibration.zhang.mirrored_pose`, here about the normal of any plane.
    """
    sigma = max(np.sqrt(camera.variance), _LEAST_SIGMA)
    out = np.zeros(len(points), bool)
    for v in np.flatnonzero(camera.used):
        p, T = points[v][seen[v]], camera.T[v]
        normal = np.linalg.svd(p - p.mean(axis=0))[2][2]
        middle = T[:3, :3] @ p.mean(axis=0) + T[:3, 3]
        ray = middle / np.linalg.norm(middle)
        about = [2.0 * np.outer(n, n) - np.eye(3) for n in (ray, normal)]
        here = (p - p.mean(axis=0)) @ T[:3, :3].T + middle
        there = (p - p.mean(axis=0)) @ (about[0] @ T[:3, :3] @ about[1]).T + middle
        uv = [(q @ camera.K.T)[:, :2] / q[:, 2:] for q in (here, there)]
        out[v] = np.sqrt(np.mean(np.sum((uv[0] - uv[1]) ** 2, axis=1))) > _AMBIGUOUS * sigma
    return out


def _cross_matrices(v: np.ndarray) -> np.ndarray:
    """[v]x of each vector, (n, 3, 3)."""
    out = np.zeros((len(v), 3, 3))
    out[:, 2, 1], out[:, 0, 2], out[:, 1, 0] = v.T
    return out - np.swapaxes(out, 1, 2)
