"""What the tests of naming share: counting, and a small refinement of a turntable from beads."""

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from jaxmocap.synthetic.bead_candidates import turntable_cameras


class SmallRefinement:
    """Camera rotation, angle steps and points from beads, by SciPy: independent of the package's own solver."""

    def __init__(self, angles, focal=859.0):
        self.angles, self.focal, self.calls = np.asarray(angles, float), focal, 0
        self.rotvec, self.steps = np.array([np.pi, 0.0, 0.0]), np.zeros(len(angles))

    def __call__(self, uv, visible, sigma):
        self.calls += 1
        used = np.flatnonzero(visible.sum(axis=0) >= 2)
        uv, visible = uv[:, used], visible[:, used]
        xy = (uv - [337.3, 288.2]) / [859.0, 860.2]
        for _ in range(8):  # fixed point of the lens
            r2 = (xy**2).sum(-1, keepdims=True)
            xy = (uv - [337.3, 288.2]) / [859.0, 860.2] / (1 - 0.12 * r2 + 0.03 * r2**2)
        photos, count = visible.shape

        def residual(x):
            rotvec, steps, p = x[:3], np.concatenate([[0.0], x[3 : 2 + photos]]), x[2 + photos :].reshape(count, 3)
            turn = Rotation.from_rotvec(np.outer(self.angles + steps, [0, 1, 0])).as_matrix()
            q = np.einsum("kij,mj->kmi", turn, p) - [0, 80.0, 400.0]
            q = q @ Rotation.from_rotvec(rotvec).as_matrix().T
            off = (q[..., :2] / q[..., 2:] - xy) * self.focal
            return np.concatenate([(off * visible[..., None]).ravel(), (x[3 : 2 + photos] - 0) / np.radians(0.5) * 0.3])

        start = np.concatenate([self.rotvec, self.steps[1:], self._points(xy, visible).ravel()])
        found = least_squares(residual, start, loss="soft_l1", x_scale="jac", jac_sparsity=_pattern(*visible.shape))
        self.rotvec, self.steps = found.x[:3], np.concatenate([[0.0], found.x[3 : 2 + photos]])
        off = np.abs(residual(found.x)[: 2 * photos * count].reshape(photos, count, 2))[visible]
        gate = max(1.0, 6.0 * 1.4826 * float(np.median(off)))
        return turntable_cameras(self.rotvec, self.angles + self.steps), found.x[2 + photos :].reshape(count, 3), gate

    def _points(self, xy, visible):
        """Points nearest to the rays of the present cameras."""
        out = []
        R = Rotation.from_rotvec(self.rotvec).as_matrix()
        turn = Rotation.from_rotvec(np.outer(self.angles + self.steps, [0, 1, 0])).as_matrix()
        for m in range(visible.shape[1]):
            A, y = np.zeros((3, 3)), np.zeros(3)
            for k in np.flatnonzero(visible[:, m]):
                v = turn[k].T @ R.T @ np.array([*xy[k, m], 1.0])
                across = np.eye(3) - np.outer(v, v) / (v @ v)
                A, y = A + across, y + across @ (turn[k].T @ np.array([0, 80.0, 400.0]))
            out.append(np.linalg.solve(A, y))
        return np.array(out)


def _pattern(photos, count):
    """Which residual depends on which unknown: rotation 3, angles of photos 1.., points 3 each."""
    pattern = np.zeros((photos, count, 2, 2 + photos + 3 * count), int)
    pattern[..., :3] = 1
    for k in range(1, photos):
        pattern[k, ..., 2 + k] = 1
    for m in range(count):
        pattern[:, m, :, 2 + photos + 3 * m : 5 + photos + 3 * m] = 1
    steps = np.zeros((photos - 1, 2 + photos + 3 * count), int)
    steps[np.arange(photos - 1), 3 + np.arange(photos - 1)] = 1
    return np.concatenate([pattern.reshape(-1, pattern.shape[-1]), steps])


def score(found, photos):
    """(named right, named wrong, seen but not named) over all photographs; from the truth of the simulation."""
    right = wrong = missed = 0
    for row, photo in zip(found.index, photos):
        for m, i in enumerate(row):
            seen = (photo.truth == m).any()
            right += i >= 0 and photo.truth[i] == m
            wrong += i >= 0 and photo.truth[i] != m
            missed += seen and i < 0
    return int(right), int(wrong), int(missed)
