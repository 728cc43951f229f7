import colorsys

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from jaxmocap.tracking.colour_space import cone_from_hsb, hsb_from_cone, hsb_from_rgb, hue_difference, rgb_from_hsb

unit = st.floats(0.0, 1.0)


@given(unit, unit, unit)
def test_colours_agree_with_the_standard_library(h, s, b):
    rgb = rgb_from_hsb(np.array([h, s, b]))
    assert np.allclose(rgb, colorsys.hsv_to_rgb(h, s, b), atol=1e-12)
    expected = np.array(colorsys.rgb_to_hsv(*rgb))
    got = hsb_from_rgb(rgb)
    assert np.allclose(got[1:], expected[1:], atol=1e-12)
    assert hue_difference(got[0], expected[0]) < 1e-9


@given(unit, st.floats(0.01, 1.0), unit)
def test_the_cone_and_back(h, s, b):
    back = hsb_from_cone(cone_from_hsb(np.array([h, s, b])))
    assert np.allclose(back[1:], [s, b], atol=1e-12) and hue_difference(back[0], h) < 1e-9
    assert (back >= 0).all() and (back <= 1).all()


def test_hue_is_a_circle():
    assert np.isclose(hue_difference(0.999, 0.001), 0.002)  # document 000, 3.2
    assert np.isclose(hue_difference(0.25, 0.75), 0.5)


def test_grey_of_any_hue_is_one_place():
    assert np.allclose(cone_from_hsb(np.array([0.1, 0.0, 0.5])), cone_from_hsb(np.array([0.7, 0.0, 0.5])))


def test_places_by_hand():
    assert np.allclose(cone_from_hsb(np.array([0.25, 0.6, 0.8])), [0.0, 0.6, 0.8])
    assert np.allclose(cone_from_hsb(np.array([0.5, 0.6, 0.8])), [-0.6, 0.0, 0.8])
