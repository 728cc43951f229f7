"""Each weakness is found in data that has it, simulated and calibrated by OpenCV, and none in good data."""

import re
from dataclasses import dataclass, replace
from functools import cache

import cv2
import numpy as np
import pytest

from jaxmocap.calibration.evidence import (
    CameraEvidence,
    board_attitude,
    board_shift,
    convex_outline,
    covered_fraction,
    image_corners,
    radius_px,
    real_radius_px,
    tilt_worth,
)
from jaxmocap.calibration.weakness import find_weaknesses

SIZE = (1280, 720)
TRUE_K = np.array([[900.0, 0.0, 640.0], [0.0, 900.0, 360.0], [0.0, 0.0, 1.0]])
TRUE_LENS = np.array([-0.12, 0.05, 0.0, 0.0, 0.0])
SQUARE = 25.0
BOARD = np.zeros((54, 3), np.float32)
BOARD[:, :2] = (np.stack(np.meshgrid(np.arange(9), np.arange(6)), -1).reshape(-1, 2) - (4.0, 2.5)) * SQUARE
NAMES = ("fx", "fy", "cx", "cy", "k1", "k2")


@dataclass(frozen=True)
class View:
    name: str
    uv: np.ndarray
    rms_px: float = 0.28
    tilt_deg: float = 30.0
    tilt_direction_deg: float = 0.0
    depth: float = 400.0


def pose(tilt, direction, depth, where=(0.0, 0.0)):
    """Rotation vector and translation: the board recedes towards `direction`, its centre is at `where`."""
    a = np.radians(direction)
    # Right-handed about (-sin, cos) turns the (cos, sin) side away from the camera for a negative angle.
    w = -np.radians(tilt) * np.array([-np.sin(a), np.cos(a), 0.0])
    return w, np.array([where[0] * depth, where[1] * depth, depth])


def project(poses, lens=TRUE_LENS, noise=0.2, seed=3):
    rng = np.random.default_rng(seed)
    clean = [cv2.projectPoints(BOARD, w, t, TRUE_K, lens)[0].reshape(-1, 2) for w, t in poses]
    return [uv + rng.normal(0.0, noise, uv.shape) for uv in clean]


def calibrated(uvs, size=SIZE, names=None):
    flags = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3
    uvs32 = [uv.astype(np.float32).reshape(-1, 1, 2) for uv in uvs]
    start = np.array([[size[0], 0, size[0] / 2], [0, size[0], size[1] / 2], [0, 0, 1.0]])
    rms, K, lens, w, t, sd, _, _ = cv2.calibrateCameraExtended(
        [BOARD] * len(uvs), uvs32, size, start, None, flags=flags | cv2.CALIB_USE_INTRINSIC_GUESS
    )
    lens = lens.ravel()[:5]
    views = []
    for i, uv in enumerate(uvs):
        error = uv - cv2.projectPoints(BOARD, w[i], t[i], K, lens)[0].reshape(-1, 2)
        attitude = board_attitude(cv2.Rodrigues(w[i])[0], t[i].ravel())
        rms_view = float(np.sqrt(np.mean(np.sum(error**2, axis=1))))
        views.append(View(names[i] if names else f"photo_{i:02d}.jpg", uv, rms_view, *attitude))
    sigma = {n: float(s) for n, s in zip(NAMES, sd.ravel())}
    return CameraEvidence(size, K, lens, views, rms, sigma, sigma, square=SQUARE, unit="mm")


GOOD_POSES = [
    pose(tilt, 137.5 * i, depth, where)
    for i, (tilt, depth, where) in enumerate(
        (10.0 + 35.0 * (i % 5) / 4, 330.0 + 20.0 * (i % 7), (0.3 * ((i % 3) - 1), 0.15 * ((i // 3) % 3 - 1)))
        for i in range(18)
    )
]


@cache
def good():
    return calibrated(project(GOOD_POSES))


def codes(evidence):
    return {w.code for w in find_weaknesses(evidence)}


def found(evidence, code):
    return next(w for w in find_weaknesses(evidence) if w.code == code)


def test_good_data_show_no_weakness():
    assert abs(good().K[0, 0] - 900.0) < 3.0
    assert all(np.all((v.uv > 0) & (v.uv < SIZE)) for v in good().views)
    assert find_weaknesses(good()) == ()


def test_one_view_is_serious_and_names_the_equations():
    w = found(replace(good(), views=good().views[:1]), "few-views")
    assert w.severity == "serious" and "1 view gives 2 equations" in w.sentence


@pytest.mark.parametrize("n", [2, 3])
def test_two_and_three_views_are_a_warning(n):
    assert found(replace(good(), views=good().views[:n]), "few-views").severity == "warning"
    assert "few-views" not in codes(replace(good(), views=good().views[:4]))


def test_a_solid_target_needs_neither_many_nor_tilted_views():
    solid = replace(good(), views=[replace(good().views[0], tilt_deg=0.0)], planar=False)
    assert not {"few-views", "fronto-parallel"} & codes(solid)


def test_square_on_views_are_serious_although_the_rms_is_small():
    side = np.linspace(-0.3, 0.3, 10)
    near = calibrated(project([pose(0, 0, 400.0, (x, 0.1)) for x in side]))
    far = calibrated(project([pose(0, 0, 450.0 + 500.0 * x, (x, 0.1)) for x in side]))
    for evidence in (near, far):
        assert evidence.rms_px < 0.3
        assert found(evidence, "fronto-parallel").severity == "serious"
    assert "one-depth" in codes(near) and "one-depth" not in codes(far)


def test_six_views_at_twenty_degrees_are_enough_and_at_ten_not():
    def six(tilt):
        return replace(good(), views=[replace(v, tilt_deg=tilt) for v in good().views[:6]])

    assert "fronto-parallel" not in codes(six(20.0))
    assert found(six(10.0), "fronto-parallel").severity == "warning"


def test_the_worth_of_a_tilt_is_that_of_simulated_calibrations():
    def sigma(tilt):
        uvs = project([pose(tilt, 60.0 * i, 400.0, (0.1 * (i % 3 - 1), 0.1 * (i % 2))) for i in range(12)])
        return calibrated(uvs).sigma["fx"]

    for tilt in (5.0, 10.0, 20.0, 40.0):
        assert sigma(30.0) / sigma(tilt) == pytest.approx(np.sqrt(tilt_worth(np.array([tilt]))), rel=0.25)


def test_tilts_within_a_quadrant_leave_the_principal_point_uncertain():
    def spread_by(degrees):
        places = [(0.2 * (i % 3 - 1), 0.1 * (i % 2)) for i in range(12)]
        directions = np.linspace(-0.5, 0.5, 12) * degrees
        return calibrated(
            project([pose(20 + 8 * (i % 4), directions[i], 400 + 20 * (i % 5), places[i]) for i in range(12)])
        )

    narrow, around = spread_by(80.0), spread_by(330.0)
    assert narrow.sigma["cx"] > 3.0 * around.sigma["cx"]
    assert "one-tilt-direction" in codes(narrow) and "one-tilt-direction" not in codes(around)


def test_one_tilt_direction_names_it():
    views = [replace(v, tilt_deg=30.0, tilt_direction_deg=(350.0 + 3.0 * i) % 360) for i, v in enumerate(good().views)]
    w = found(replace(good(), views=views), "one-tilt-direction")
    assert "towards the right" in w.sentence and "51 degrees" in w.sentence


def test_a_small_board_in_the_middle():
    uvs = project([pose(25.0, 45.0 * i, 1800.0, (0.01 * i, 0.0)) for i in range(10)])
    evidence = calibrated(uvs)
    assert {"coverage", "extrapolated-lens", "focal-uncertain"} <= codes(evidence)
    assert found(evidence, "coverage").severity == "warning"


def test_a_small_board_is_no_extrapolation_without_lens_terms():
    evidence = calibrated(project([pose(25.0, 45.0 * i, 1800.0) for i in range(10)]))
    sigma = {n: s for n, s in evidence.sigma.items() if n[0] != "k"}
    assert "extrapolated-lens" not in codes(replace(evidence, sigma=sigma))


@pytest.mark.parametrize(
    ("sigma", "severity"), [(8.0, None), (10.0, "warning"), (100.0, "serious"), (np.nan, "serious")]
)
def test_an_uncertain_focal_length(sigma, severity):
    weak = [w for w in find_weaknesses(replace(good(), sigma={"fx": sigma})) if w.code == "focal-uncertain"]
    assert [w.severity for w in weak] == ([severity] if severity else [])


def test_a_lens_term_near_zero_is_a_note():
    evidence = calibrated(project(GOOD_POSES, lens=np.zeros(5)))
    assert found(evidence, "lens-term-near-zero").severity == "note"


def test_pixels_that_are_not_square():
    assert found(replace(good(), K=TRUE_K * [[1.09], [1], [1]]), "aspect").severity == "warning"
    assert found(replace(good(), K=TRUE_K * [[1], [0.3], [1]]), "aspect").severity == "serious"
    assert found(replace(good(), K=TRUE_K * [[-1], [1], [1]]), "focal-sign").severity == "serious"


def test_swapped_axes_are_recognised():
    evidence = calibrated([uv[:, ::-1].copy() for uv in project(GOOD_POSES)])
    w = found(evidence, "swapped-axes")
    assert w.severity == "serious" and "720 x 1280" in w.sentence


def test_a_principal_point_off_centre_or_outside():
    K = TRUE_K.copy()
    K[0, 2] = 900.0
    assert found(replace(good(), K=K), "principal-point-off-centre").severity == "warning"
    K[0, 2] = 1300.0
    assert found(replace(good(), K=K), "principal-point-outside").severity == "serious"


@pytest.mark.parametrize("focal", [29425.7, 160.0])
def test_an_implausible_field_of_view(focal):
    K = np.diag([focal, focal, 1.0])
    K[:2, 2] = TRUE_K[:2, 2]
    assert found(replace(good(), K=K), "field-of-view").severity == "serious"


def test_a_lens_that_folds_back_inside_the_image():
    corner = radius_px(good().K, image_corners(SIZE)).max()
    reached = max(radius_px(good().K, v.uv).max() for v in good().views)
    assert "lens-folds-back" not in codes(replace(good(), valid_radius_px=1.01 * corner))
    assert found(replace(good(), valid_radius_px=(corner + reached) / 2), "lens-folds-back").severity == "warning"
    assert found(replace(good(), valid_radius_px=0.9 * reached), "lens-folds-back").severity == "serious"


def test_one_corner_80_px_off_names_its_photo():
    uvs = project(GOOD_POSES)
    uvs[7][20] += (80.0, 0.0)
    evidence = calibrated(uvs)
    w = found(evidence, "bad-view")
    assert w.sentence.startswith("photo_07.jpg") and "photo_08" not in w.sentence
    assert "large-rms" in codes(evidence)


def test_the_same_image_ten_times():
    evidence = calibrated(project(GOOD_POSES[1:2]) * 10)
    w = found(evidence, "duplicate-views")
    assert w.severity == "serious" and "10 views are only 1" in w.sentence


def test_a_burst_is_a_duplicate():
    uvs = project([GOOD_POSES[0], GOOD_POSES[0], *GOOD_POSES])
    w = found(calibrated(uvs), "duplicate-views")
    assert w.severity == "warning" and "photo_00.jpg, photo_01.jpg, photo_02.jpg" in w.sentence


def test_a_large_rms():
    assert "large-rms" in codes(replace(good(), rms_px=3.3))
    assert "large-rms" in codes(replace(good(), rms_px=np.nan))


@pytest.mark.parametrize(
    ("square", "unit", "asked"),
    [(0.025, "mm", True), (25.0, "m", True), (25.0, "1", False), (0.025, "m", False), (2.5, "cm", False)],
)
def test_a_strange_square_is_a_question(square, unit, asked):
    evidence = replace(good(), square=square, unit=unit)
    assert codes(evidence) == ({"square-size"} if asked else set())


def test_residuals_that_go_together():
    for ratio, severity in ((2.5, "warning"), (4.0, "warning")):
        plain = {n: s / ratio for n, s in good().sigma.items()}
        w = found(replace(good(), sigma_plain=plain), "correlated-residuals")
        assert w.severity == severity and f"{ratio} times" in w.sentence


def test_nan_is_one_serious_weakness():
    assert [w.code for w in find_weaknesses(replace(good(), K=np.full((3, 3), np.nan)))] == ["not-finite"]


def test_the_most_serious_comes_first_and_the_camera_is_named():
    weak = find_weaknesses(replace(good(), K=np.diag([1.0, 1.0, 1.0]), square=0.001, rms_px=2.0, label="left"))
    ranks = [{"serious": 0, "warning": 1, "note": 2}[w.severity] for w in weak]
    assert ranks == sorted(ranks) and all(w.sentence.startswith("left: ") for w in weak)


def test_every_sentence_has_a_number_and_every_step_is_a_sentence():
    evidence = replace(calibrated(project([pose(0, 0, 400.0)] * 3)), rms_px=5.0, square=0.001, valid_radius_px=50.0)
    for w in find_weaknesses(evidence):
        assert re.search(r"\d", w.sentence) and w.next_step.endswith(".") and "nan" not in w.sentence


def test_no_views_at_all():
    assert "few-views" in codes(replace(good(), views=[]))


def test_attitude_of_a_known_board():
    w, t = pose(30.0, 90.0, 500.0)
    tilt, direction, depth = board_attitude(cv2.Rodrigues(w)[0], t)
    assert (tilt, direction, depth) == pytest.approx((30.0, 90.0, 500.0))
    # The lower side (v down) recedes: it is farther away.
    assert (cv2.Rodrigues(w)[0] @ [0.0, 1.0, 0.0])[2] > 0


def test_attitude_does_not_depend_on_the_side_of_the_normal():
    w, t = pose(30.0, 200.0, 500.0, (0.3, 0.1))
    R = cv2.Rodrigues(w)[0]
    assert board_attitude(R, t) == pytest.approx(board_attitude(R @ np.diag([1.0, -1.0, -1.0]), t))


def test_coverage_of_known_outlines():
    w, h = SIZE
    assert covered_fraction(SIZE, [image_corners(SIZE)]) == 1.0
    assert covered_fraction(SIZE, [np.array([[0, 0], [w / 2, 0], [w / 2, h], [0, h]])]) == pytest.approx(0.5, abs=0.01)
    assert covered_fraction(SIZE, []) == 0.0


def test_the_outline_of_a_grid_goes_around_it():
    grid = BOARD[:, :2].astype(float)
    x, y = convex_outline(grid).T
    area = 0.5 * abs(np.sum(x * np.roll(y, 1) - y * np.roll(x, 1)))
    assert area == pytest.approx(8 * SQUARE * 5 * SQUARE)
    assert len(convex_outline(grid[:1])) == 1 and len(convex_outline(grid[:0])) == 0


def test_real_radius_is_that_of_the_projection():
    uv = cv2.projectPoints(np.array([[0.3, 0.4, 1.0]]), np.zeros(3), np.zeros(3), TRUE_K, TRUE_LENS)[0].reshape(1, 2)
    assert real_radius_px(TRUE_K, TRUE_LENS, 0.5) == pytest.approx(radius_px(TRUE_K, uv)[0])


def test_shift_of_a_board_is_a_share_of_its_size():
    uv = np.array([[0.0, 0.0], [30.0, 40.0]])
    assert board_shift(uv, uv + (0.0, 5.0)) == pytest.approx(0.1)
    assert board_shift(uv, uv[:1]) == np.inf
