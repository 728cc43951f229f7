"""Start values on exact and noisy views, judged by OpenCV's projection of what was found."""

import cv2
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxmocap import SolveError
from jaxmocap.calibration.boards import TargetViews, chessboard_points, free_parameters, refine_targets
from jaxmocap.calibration.start import start_rig
from jaxmocap.observations import PixelObservations

SIZE, BOARD = (640, 480), chessboard_points(9, 6, 30.0)
K = np.array([[700.0, 0, 310.0], [0, 690.0, 250.0], [0, 0, 1]])
CENTRE = BOARD.mean(axis=0)
POSES = [  # rotation vector, place of the board's middle
    ([0.5, 0.1, 0.1], [20.0, -15.0, 520.0]),
    ([-0.3, 0.5, 0.8], [-60.0, 30.0, 600.0]),
    ([0.2, -0.6, -0.4], [50.0, 25.0, 560.0]),
    ([0.6, 0.4, 1.9], [0.0, -40.0, 620.0]),
]


def _see(rotvec, middle, k=(), K=K, target=BOARD, centre=CENTRE):
    """Pixels of a target and its T_camera_target as (rotvec, t)."""
    t = np.asarray(middle) - Rotation.from_rotvec(rotvec).apply(centre)
    k = np.pad(np.asarray(k, float), (0, 5 - len(k)))
    return cv2.projectPoints(target, np.asarray(rotvec, float), t, K, k)[0].reshape(-1, 2), t


def _views(uv, seen=None, target=BOARD):
    """uv (views, cameras, points, 2)."""
    uv = np.asarray(uv, float)
    seen = np.ones(uv.shape[:3], bool) if seen is None else seen
    points = np.tile(target, (len(uv), 1, 1))
    return TargetViews(jnp.asarray(points), PixelObservations.of(jnp.asarray(uv), jnp.asarray(seen)))


def _rms(value, views, camera=0):
    """RMS distance [px] between what was seen and OpenCV's projection of the solution."""
    lens = value.shared.lenses[camera]
    k = np.asarray(lens.distortion.vector())
    uv, seen, errors = np.asarray(views.seen.uv), np.asarray(views.seen.visible), []
    for v in np.flatnonzero(seen[:, camera].any(axis=1)):
        R, t = Rotation.from_rotvec(np.array(value.local.rotvec[v])), np.array(value.local.translation[v])
        if camera:
            T = value.shared.T_camera_rig[camera - 1]
            R2 = Rotation.from_rotvec(np.array(T.rotvec))
            R, t = R2 * R, R2.apply(t) + np.array(T.translation)
        found = cv2.projectPoints(np.array(views.points[v]), R.as_rotvec(), t, np.array(lens.intrinsics.matrix()), k)[
            0
        ].reshape(-1, 2)
        errors.append(np.sum((found - uv[v, camera]) ** 2, axis=1)[seen[v, camera]])
    return float(np.sqrt(np.mean(np.concatenate(errors))))


def _solve(views):
    start, used = start_rig(views, [SIZE], ["cam"])
    return start, used, refine_targets(start, views, free_parameters(1, "k1k2", False))


@pytest.mark.parametrize(
    "k",
    [(), (-0.1, 0.02), (-0.35, 0.12), (0.25, 0.1), (-0.45, 0.22)],
    ids=["none", "weak", "strong barrel", "pincushion", "very strong"],
)
def test_four_views_reach_the_truth(k):
    views = _views([[_see(r, t, k)[0]] for r, t in POSES])
    start, used, estimate = _solve(views)
    assert used.all() and estimate.success, estimate.sentence
    assert _rms(estimate.value, views) < 1e-6
    np.testing.assert_allclose(estimate.value.shared.lenses[0].intrinsics.matrix(), K, atol=1e-4)
    for v, (r, t) in enumerate(POSES):
        np.testing.assert_allclose(estimate.value.local.translation[v], _see(r, t)[1], atol=1e-3)


def test_without_a_lens_the_start_itself_is_exact():
    views = _views([[_see(r, t)[0]] for r, t in POSES])
    start, _ = start_rig(views, [SIZE], ["cam"])
    np.testing.assert_allclose(start.shared.lenses[0].intrinsics.matrix(), K, rtol=1e-4, atol=0.02)
    assert _rms(start, views) < 0.02


@pytest.mark.parametrize("count", [1, 2])
def test_few_views(count):
    """The views that are missing are masked: same shapes, no new compilation."""
    uv = np.array([[_see(r, t, (-0.1, 0.02))[0]] for r, t in POSES])
    seen = np.zeros(uv.shape[:3], bool)
    seen[:count] = True
    views = _views(uv, seen)
    start, used = start_rig(views, [SIZE], ["cam"])
    np.testing.assert_array_equal(used[0], np.arange(4) < count)
    assert _rms(start, views) < 3.0
    f = float(start.shared.lenses[0].intrinsics.fx)
    assert 0.7 < f / K[0, 0] < 1.4
    if count == 2:
        estimate = refine_targets(start, views, free_parameters(1, "k1k2", False))
        assert estimate.success, estimate.sentence
        np.testing.assert_allclose(estimate.value.shared.lenses[0].intrinsics.matrix(), K, atol=0.01)


def test_nearly_parallel_views_still_start():
    """Zhang's equations are nearly singular here, one focal length is not."""
    rng = np.random.default_rng(0)
    poses = [([0.35, 0.02, 0.0], [10.0, 5.0, 500.0]), ([0.352, 0.021, 0.3], [-50.0, 30.0, 650.0])] * 2
    uv = np.array([[_see(r, t)[0]] for r, t in poses]) + 0.2 * rng.normal(size=(4, 1, 54, 2))
    views = _views(uv)
    start, _ = start_rig(views, [SIZE], ["cam"])
    assert _rms(start, views) < 1.5
    assert 0.6 < float(start.shared.lenses[0].intrinsics.fx) / K[0, 0] < 1.6


def test_board_from_behind():
    """A board whose z points at the camera (a transparent one, or corners counted the other way round)."""
    behind = [(Rotation.from_rotvec(r) * Rotation.from_rotvec([np.pi, 0, 0])).as_rotvec() for r, _ in POSES]
    views = _views([[_see(r, t, (-0.1, 0.02))[0]] for r, (_, t) in zip(behind, POSES)])
    _, _, estimate = _solve(views)
    assert estimate.success and _rms(estimate.value, views) < 1e-6
    R = Rotation.from_rotvec(np.array(estimate.value.local.rotvec)).as_matrix()
    assert np.all(R[:, 2, 2] < 0)
    np.testing.assert_allclose(estimate.value.shared.lenses[0].intrinsics.matrix(), K, atol=1e-4)


@pytest.mark.parametrize("seed", range(3))
def test_far_small_board_takes_the_right_one_of_two_mirrored_poses(seed):
    """Three near boards fix the lens; the fourth is so far away that its mirrored pose is a local minimum."""
    rng = np.random.default_rng(seed)
    about = rng.uniform(0, 2 * np.pi)
    far = (0.5 * np.array([np.cos(about), np.sin(about), 0.0]), [150.0, -80.0, 4000.0])
    uv = np.array([[_see(r, t)[0]] for r, t in [*POSES[:3], far]]) + 0.01 * rng.normal(size=(4, 1, 54, 2))
    views = _views(uv)
    start, _, estimate = _solve(views)
    found = Rotation.from_rotvec(np.array(start.local.rotvec[3]))
    assert (found * Rotation.from_rotvec(far[0]).inv()).magnitude() < 0.3
    assert estimate.success and _rms(estimate.value, views) < 0.05


def test_mirrored_pose_of_a_far_board_is_a_second_minimum():
    """What the test above guards against: OpenCV's own planar solver returns both, close in error."""
    uv, _ = _see([0.5, 0.0, 0.0], [150.0, -80.0, 4000.0])
    count, rotvecs, _, errors = cv2.solvePnPGeneric(BOARD, uv, K, None, flags=cv2.SOLVEPNP_IPPE)
    assert count == 2 and errors[1] < 0.5
    apart = Rotation.from_rotvec(rotvecs[0].ravel()) * Rotation.from_rotvec(rotvecs[1].ravel()).inv()
    assert apart.magnitude() > 0.8


def test_solid_target():
    """Points in all three dimensions go through projection matrices; one view is enough."""
    target = np.stack(np.meshgrid([0.0, 90, 180, 240], [0.0, 75, 150], [0.0, 60, 110]), axis=-1).reshape(-1, 3)
    target = np.concatenate([target, target[:18] + [11.0, 7.0, 5.0]])  # 54 points, as the boards have
    centre = target.mean(axis=0)
    uv = [[_see(r, t, (-0.1, 0.02), target=target, centre=centre)[0]] for r, t in POSES]
    views = _views(uv, target=target)
    _, used, estimate = _solve(views)
    assert used.all() and estimate.success and _rms(estimate.value, views) < 1e-6
    np.testing.assert_allclose(estimate.value.shared.lenses[0].intrinsics.matrix(), K, atol=1e-4)


def test_plane_that_is_not_z_zero():
    turn = Rotation.from_rotvec([0.7, -0.4, 1.1])
    target = turn.apply(BOARD) + [5.0, -8.0, 3.0]
    uv = [[_see(r, t)[0]] for r, t in POSES]  # seen as the plain board; only its coordinates differ
    views = _views(uv, target=target)
    start, _ = start_rig(views, [SIZE], ["cam"])
    assert _rms(start, views) < 0.02


# Several cameras -------------------------------------------------------------------------------------------------

RIG = [  # T_camera_rig of cameras 0, 1, 2
    (np.zeros(3), np.zeros(3)),
    (np.array([0.02, -0.25, 0.01]), np.array([-150.0, 4.0, 30.0])),
    (np.array([-0.03, -0.5, 0.02]), np.array([-300.0, 5.0, 100.0])),
]


def _rig_views(seen_by):
    """seen_by[view] = cameras that saw it."""
    uv, seen = np.zeros((len(seen_by), 3, 54, 2)), np.zeros((len(seen_by), 3, 54), bool)
    for v, cameras in enumerate(seen_by):
        r, middle = POSES[v % 4]
        middle = np.asarray(middle) + 4.0 * v
        for c in cameras:
            Rc, tc = Rotation.from_rotvec(RIG[c][0]), RIG[c][1]
            uv[v, c] = _see((Rc * Rotation.from_rotvec(r)).as_rotvec(), Rc.apply(middle) + tc)[0]
            seen[v, c] = True
    return _views(uv, seen)


def test_cameras_are_chained_over_the_views_they_share():
    """0 and 2 never see the board together; views that only 2 saw get their pose through it."""
    views = _rig_views([(0, 1), (0, 1), (0,), (1, 2), (1, 2), (2,), (0,), (2,)])
    start, used = start_rig(views, [SIZE] * 3, ["a", "b", "c"])
    np.testing.assert_array_equal(used.sum(axis=1), [4, 4, 4])
    for found, (rotvec, t) in zip(start.shared.T_camera_rig, RIG[1:]):
        np.testing.assert_allclose(found.rotvec, rotvec, atol=2e-3)
        np.testing.assert_allclose(found.translation, t, atol=2.0)
    for camera in range(3):
        assert _rms(start, views, camera) < 1.0


def test_groups_that_share_no_view_are_named():
    views = _rig_views([(0, 1), (0, 1), (0, 1), (2,), (2,), (2,)])
    with pytest.raises(SolveError, match=r"left, right \| top"):
        start_rig(views, [SIZE] * 3, ["left", "right", "top"])


def test_camera_without_a_usable_view_is_named():
    views = _rig_views([(0, 1)] * 3)
    with pytest.raises(SolveError, match="camera top: No view shows enough points"):
        start_rig(views, [SIZE] * 3, ["left", "right", "top"])
