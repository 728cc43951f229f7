"""What is said of angles: each fault of a hand that turns a table, made on purpose."""

import numpy as np
import pytest

from jaxmocap.calibration.turntable_checks import (
    check_angles,
    missing_angles,
    smallest_step,
    steps,
    turned_the_other_way,
)

STATED = np.array([0.0, 30, 60, 300, 330])
NAMES = [f"t_{a:03.0f}.jpg" for a in STATED]
SIGMA = np.full(5, 0.05)


def codes(measured, stated=STATED, names=NAMES, held=0):
    found = check_angles(names, np.asarray(stated, float), np.asarray(measured, float), np.full(len(names), 0.05), held)
    return {w.code: w.sentence for w in found}


def test_steps_half_a_degree_off_are_nothing_to_speak_of():
    assert codes(STATED + [0, 0.5, -0.5, 0.4, -0.3]) == {}


def test_exchanged_photos_are_named():
    measured = STATED.copy()
    measured[[1, 2]] = measured[[2, 1]]
    found = codes(measured)
    assert list(found) == ["exchanged"]
    assert "t_030.jpg" in found["exchanged"] and "t_060.jpg" in found["exchanged"]


def test_a_turntable_that_stood_still_once_is_named():
    found = codes([0, 30, 30.02, 300, 330])
    assert "not-turned" in found and "t_030.jpg to t_060.jpg" in found["not-turned"]


def test_a_wrong_zero_is_named():
    # The photo called 0 was taken at 30: held at 0, all others seem to be 30 lower.
    found = codes([0, 0, 30, 270, 300])
    assert "wrong-zero" in found and "t_000.jpg" in found["wrong-zero"]


def test_one_angle_far_off_is_named():
    found = codes([0, 30, 81, 300, 330])
    assert list(found) == ["wrong-angle"] and "t_060.jpg by +21.0" in found["wrong-angle"]


def test_a_mean_step_that_is_off_is_said_with_its_sigma():
    x = np.array([0.0, 30, 60, -60, -30])
    found = codes((1.02 * x + [0, 0.05, -0.04, 0.02, -0.05]) % 360)
    assert list(found) == ["mean-step"] and "30.598" in found["mean-step"]
    s = steps(STATED, (1.02 * x) % 360, 0, SIGMA)
    assert abs(s.mean_factor - 1.02) < 1e-9


def test_the_same_angle_twice_is_said():
    found = codes([0, 30, 30.1, 300, 330], stated=[0, 30, 30, 300, 330])
    assert list(found) == ["angle-twice"]


@pytest.mark.parametrize("stated", [STATED, np.array([0.0, 30]), np.arange(12) * 30.0])
def test_the_other_way_is_told_from_the_right_one(stated):
    noise = np.random.default_rng(0).normal(0, 0.5, len(stated))
    assert turned_the_other_way(stated, -stated + noise)
    assert not turned_the_other_way(stated, stated + noise)


def test_one_exchange_is_not_the_other_way():
    measured = STATED.copy()
    measured[[1, 2]] = measured[[2, 1]]
    assert not turned_the_other_way(STATED, measured)


def test_half_turns_look_alike_both_ways():
    assert not turned_the_other_way(np.array([0.0, 180]), np.array([0.0, -180]))


def test_missing_angles_of_a_series():
    full = np.arange(12) * 30.0
    assert missing_angles(full) == []
    assert missing_angles(np.delete(full, [3, 7])) == [90.0, 210.0]
    assert missing_angles(STATED) == []  # half a turn was photographed, not a series with gaps
    assert missing_angles(np.array([0.0, 30, 45, 100])) == []
    assert smallest_step(np.array([350.0, 10, 100])) == 20.0
