import numpy as np
import pytest
from scipy.stats import multivariate_t

from jaxmocap._errors import InputError
from jaxmocap.tracking.bead_colours import (
    PRIOR_VIEWS,
    TURN_SD,
    BeadColours,
    covariance_of_sd,
    learn_colours,
    sd_of_covariance,
)
from jaxmocap.tracking.colour_space import VIEW_SD, cone_from_hsb, hue_difference


def test_the_mean_goes_around_the_circle_of_hue():
    learnt = learn_colours(["red"], [np.array([[0.98, 0.5, 0.6], [0.02, 0.5, 0.6]])])
    assert hue_difference(learnt.hsb[0, 0], 0.0) < 1e-9  # not the 0.5 of the arithmetic mean
    assert learnt.hsb[0, 1] == pytest.approx(0.5 * np.cos(2 * np.pi * 0.02)) and learnt.hsb[0, 2] == pytest.approx(0.6)


def test_many_views_teach_their_own_scatter_and_one_view_none():
    rng = np.random.default_rng(0)
    views = np.array([0.3, 0.6, 0.5]) + rng.normal(size=(4000, 3)) * [0.002, 0.01, 0.02]
    many = learn_colours(["a"], [views])
    assert np.allclose(many.sd[0], [0.002, 0.01, 0.02], rtol=0.1)
    one = learn_colours(["a"], [views[:1]])
    assert np.allclose(one.covariance[0], np.diag(VIEW_SD**2)) and one.n.tolist() == [1]


def test_the_density_is_the_student_density_of_scipy():
    colours = learn_colours(["a", "b"], [np.full((3, 3), 0.4), np.full((8, 3), 0.7)])
    points = cone_from_hsb(np.array([[0.41, 0.38, 0.45], [0.9, 0.1, 0.9]]))
    got = colours.density_of(2).log_density(points)
    for m, n in enumerate((3, 8)):
        spread = colours.covariance[m] * (1 / 2 + 1 / n) + np.diag(TURN_SD**2)
        expected = multivariate_t(colours.cone[m], spread, df=PRIOR_VIEWS + n).logpdf(points)
        assert np.allclose(got[:, m], expected)


def test_scatter_of_hue_becomes_scatter_across_and_back():
    hsb = np.array([0.25, 0.5, 0.7])  # across is -x here, along is y
    covariance = covariance_of_sd(hsb, np.array([0.01, 0.03, 0.05]))
    assert np.allclose(covariance, np.diag([(2 * np.pi * 0.5 * 0.01) ** 2, 0.03**2, 0.05**2]))
    assert np.allclose(sd_of_covariance(hsb, covariance), [0.01, 0.03, 0.05])


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: BeadColours.of({}), "at least one bead"),
        (lambda: BeadColours.of({"a": (0.1, 0.2, 1.2)}), "colour of a: expected h, s, b in 0..1"),
        (lambda: BeadColours.of({"a": (0.1, float("nan"), 0.2)}), "colour of a: 1 of 3 numbers are NaN"),
        (lambda: learn_colours(["a"], [np.zeros((0, 3))]), "samples of a: no view"),
        (lambda: learn_colours(["a", "b"], [np.zeros((1, 3))]), "one array for each of 2 beads"),
    ],
)
def test_wrong_calls(call, says):
    with pytest.raises(InputError, match=says):
        call()
