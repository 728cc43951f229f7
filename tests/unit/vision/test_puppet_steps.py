"""Threshold, outline, Hough circles and colours of the stop-motion document, on pictures made by hand."""

import colorsys

import numpy as np
import pytest

from jaxmocap._errors import InputError
from jaxmocap.vision import (
    edge_map,
    grey_of,
    hough_circles,
    hsb_of_rgb,
    linear_light,
    mean_threshold,
    opencv_circles,
    outline,
    square_hsb,
)


def disc_picture(circles, shape=(120, 160), dark=10, bright=200) -> np.ndarray:
    v, u = np.indices(shape)
    white = np.zeros(shape, bool)
    for u0, v0, r in circles:
        white |= (u - u0) ** 2 + (v - v0) ** 2 <= r**2
    return np.where(white, bright, dark).astype(np.uint8)


def test_threshold_rises_until_it_exceeds_the_composite_average():
    # At or below t in 0..9 there is nothing, from 10 on: (10 + 100) / 2 = 55, first exceeded by 56.
    assert mean_threshold(np.array([10, 10, 10, 100], np.uint8)) == 56
    # Means 0 and (40 + 100) / 2: composite 35, but exceeding it at 36 comes before 40 joins the dark ones.
    assert mean_threshold(np.array([0, 40, 100], np.uint8)) == 36
    # With 20 instead: at 20 the dark mean is 10, the composite 55 (at 0..19 it was 30, not exceeded).
    assert mean_threshold(np.array([0, 20, 100], np.uint8)) == 56


def test_threshold_of_an_even_picture_leaves_nothing_white():
    grey = np.full((4, 4), 77, np.uint8)
    assert not (grey > mean_threshold(grey)).any()


def test_outline_keeps_white_pixels_with_a_black_neighbour():
    white = np.zeros((7, 7), bool)
    white[1:6, 1:6] = True
    expected = white.copy()
    expected[2:5, 2:5] = False
    np.testing.assert_array_equal(outline(white), expected)
    white[3, 3] = False  # a hole makes its eight neighbours outline; black stays black
    assert outline(white)[2:5, 2:5].sum() == 8 and not outline(white)[3, 3]
    assert outline(np.ones((3, 3), bool)).sum() == 8  # beyond the border is black


def test_edge_map_is_of_the_grey_picture():
    grey = disc_picture([(50, 40, 6)])
    np.testing.assert_array_equal(edge_map(np.stack([grey] * 3, -1)), outline(grey > 100))


@pytest.mark.parametrize("find", ["document", "opencv"])
def test_hough_finds_circles_where_they_are(find):
    truth = [(50.0, 40.0, 6.0), (110.0, 80.0, 7.0), (20.0, 90.0, 5.0)]
    grey = disc_picture(truth)
    if find == "document":
        circles = hough_circles(outline(grey > 100), (5, 7), 3)
    else:
        circles = opencv_circles(grey, (5, 7), 3)
    assert circles.shape == (3, 3)
    for u, v, _ in truth:
        assert np.linalg.norm(circles[:, :2] - (u, v), axis=1).min() <= 1.0


def test_hough_counts_and_strikes_out():
    edges = outline(disc_picture([(50, 40, 6)]) > 100)
    one, two = hough_circles(edges, (5, 7), 1), hough_circles(edges, (5, 7), 2)
    np.testing.assert_array_equal(one[0, :2], [50, 40])
    assert one[0, 2] in (5, 6)  # the outermost pixel centres of this disc lie between 5 and 6 px from its middle
    assert np.linalg.norm(two[1, :2] - one[0, :2]) > 6
    assert hough_circles(np.zeros((20, 20), bool)).shape == (0, 3)
    assert opencv_circles(np.zeros((20, 20), np.uint8)).shape == (0, 3)


@pytest.mark.parametrize("radius", [(0, 5), (7, 5), (5, np.nan), (1, np.inf)])
def test_radii_that_make_no_sense_are_refused(radius):
    with pytest.raises(InputError, match="radius: expected"):
        hough_circles(np.zeros((20, 20), bool), radius)


def test_other_arguments_that_make_no_sense_are_refused():
    with pytest.raises(InputError, match="widen the range"):
        hough_circles(np.zeros((20, 20), bool), (5.2, 5.8))
    with pytest.raises(InputError, match="count"):
        hough_circles(np.zeros((20, 20), bool), count=0)
    with pytest.raises(InputError, match="colour picture"):
        grey_of(np.zeros((4, 4), np.uint8))
    with pytest.raises(InputError, match="grey"):
        mean_threshold(np.zeros((0, 4), np.uint8))
    with pytest.raises(InputError, match="not finite"):
        square_hsb(np.zeros((4, 4, 3), np.uint8), [[np.nan, 1.0]])


def test_hsb_is_python_s():
    colours = np.random.default_rng(0).integers(0, 256, (200, 3))
    expected = [colorsys.rgb_to_hsv(*(c / 255.0)) for c in colours]
    np.testing.assert_allclose(hsb_of_rgb(colours), expected, atol=1e-12)
    np.testing.assert_array_equal(hsb_of_rgb([[0, 0, 0], [9, 9, 9]])[:, :2], 0.0)


def test_square_colour_is_the_mean_of_25_pixels():
    rgb = np.zeros((9, 9, 3), np.uint8)
    rgb[2:7, 2:7, 0] = 100
    rgb[4, 4] = (100, 250, 0)  # 10 of green on the average
    np.testing.assert_allclose(square_hsb(rgb, [[4.4, 3.6]]), [colorsys.rgb_to_hsv(100 / 255, 10 / 255, 0)], atol=1e-12)


def test_square_colour_at_the_border_uses_the_pixels_there_are():
    rgb = np.zeros((9, 9, 3), np.uint8)
    rgb[:3, :3] = (50, 100, 200)
    np.testing.assert_allclose(square_hsb(rgb, [[0, 0]]), [colorsys.rgb_to_hsv(50 / 255, 100 / 255, 200 / 255)])


def test_linear_light_has_the_standard_s_values():
    """IEC 61966-2-1: linear below 0.04045, then ((v + 0.055) / 1.055)^2.4."""
    np.testing.assert_allclose(
        linear_light(np.array([0, 10, 188, 255], np.uint8)), [0, 0.0030353, 0.5028865, 1], atol=1e-6
    )
