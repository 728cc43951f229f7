"""Beads in pictures drawn here: shaded discs in linear light, coded as sRGB."""

import colorsys

import numpy as np
import pytest

from jaxmocap._errors import InputError
from jaxmocap.vision import find_beads

SHAPE = (140, 200)
FINE = 8  # sub-pixels per pixel
RED, GREEN, BLUE, PALE = (0.8, 0.1, 0.1), (0.1, 0.6, 0.15), (0.1, 0.25, 0.8), (0.7, 0.6, 0.5)
FIVE = [((30.3, 30.7), RED), ((80.5, 33.1), GREEN), ((130.2, 30.0), BLUE), ((40.8, 100.4), PALE), ((150.6, 90.2), RED)]


def draw(beads, radius=6.5, cover=(), noise=1.0, ground=0.01, gain=(1.0, 1.0, 1.0), shape=SHAPE) -> np.ndarray:
    """Beads (centre, colour[, radius]) from back to front, then half planes (normal, offset) of the ground's colour."""
    steps = (np.arange(FINE) + 0.5) / FINE - 0.5
    v = (np.arange(shape[0])[:, None] + steps).ravel()[:, None]
    u = (np.arange(shape[1])[:, None] + steps).ravel()[None, :]
    light = np.full((*np.broadcast(u, v).shape, 3), ground, np.float32)
    for centre, colour, *own in beads:
        r = own[0] if own else radius
        near2 = ((u - centre[0]) ** 2 + (v - centre[1]) ** 2) / r**2
        inside = near2 < 1
        light[inside] = np.sqrt(1 - near2[inside])[:, None] * np.array(colour)
    for (a, b), offset in cover:
        light[a * u + b * v > offset] = ground
    light = light.reshape(shape[0], FINE, shape[1], FINE, 3).mean((1, 3)) * gain
    coded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)
    jitter = np.random.default_rng(0).normal(0.0, noise, coded.shape)
    return np.clip(np.rint(255 * coded + jitter), 0, 255).astype(np.uint8)


def errors(found, beads) -> np.ndarray:
    """Distance of the nearest candidate from each bead, px."""
    truth = np.array([bead[0] for bead in beads])
    return np.linalg.norm(found.uv[None] - truth[:, None], axis=-1).min(axis=1)


@pytest.mark.parametrize("radius", [1.5, 2.5, 6.5, 12.0])
def test_centres_are_found_whatever_the_size(radius):
    found = find_beads(draw(FIVE, radius))
    assert len(found.uv) == 5
    assert errors(found, FIVE).max() < 0.15
    np.testing.assert_allclose(found.radius, radius, rtol=0.05, atol=0.3)
    assert (found.sigma > 0).all() and (found.sigma < 0.2).all() and (found.arc > 0.9).all()


def test_colours_are_the_beads():
    found = find_beads(draw(FIVE, noise=0.0))
    for centre, colour in FIVE:
        k = np.linalg.norm(found.uv - centre, axis=1).argmin()
        coded = 1.055 * np.array(colour) ** (1 / 2.4) - 0.055
        # The middle 5x5 pixels of a sphere of 6.5 px are dimmer by some per cent; hue and saturation stay.
        np.testing.assert_allclose(found.hsb[k], colorsys.rgb_to_hsv(*coded), atol=0.035)
        np.testing.assert_allclose(found.hsb_square[k], found.hsb[k], atol=0.02)


def test_centre_of_a_half_hidden_bead_is_not_drawn_away():
    """The visible half's centroid is 0.42 r = 2.8 px off (4 r / 3 pi)."""
    centre = np.array([90.3, 80.4])
    half = draw([(centre, GREEN)], cover=[((1.0, 0.0), 90.0)])
    alone = find_beads(half)
    assert np.linalg.norm(alone.uv[0] - centre) < 1.0  # nothing tells its size but its own edge
    picture = draw(FIVE)
    picture[60:, 60:110] = half[60:, 60:110]
    found = find_beads(picture)
    k = np.linalg.norm(found.uv - centre, axis=1).argmin()
    assert np.linalg.norm(found.uv[k] - centre) < 0.3
    assert found.arc[k] < 0.7 and found.sigma[k] > np.median(found.sigma)


@pytest.mark.parametrize("second", [GREEN, RED], ids=["two colours", "one colour"])
def test_touching_beads_are_two(second):
    pair = [((90.3, 80.4), RED), ((102.1, 83.2), second)]
    found = find_beads(draw([*FIVE, *pair]))
    assert errors(found, pair).max() < 0.4
    for centre, _ in pair:
        assert found.merged[np.linalg.norm(found.uv - centre, axis=1).argmin()]
    assert found.merged.sum() == 2


def test_a_bead_partly_behind_another_of_another_colour():
    pair = [((90.3, 80.4), GREEN), ((97.1, 83.2), RED)]  # the red one in front
    found = find_beads(draw([*FIVE, *pair]))
    assert errors(found, pair[1:])[0] < 0.2
    assert errors(found, pair[:1])[0] < 0.6


def test_warm_light_and_noise():
    found = find_beads(draw(FIVE, noise=8.0, gain=(1.0, 0.75, 0.4)))
    assert errors(found, FIVE).max() < 0.3


def test_a_bead_that_leaves_the_picture_is_fitted_by_its_visible_edge():
    beads = [*FIVE, ((196.5, 60.2), GREEN)]
    found = find_beads(draw(beads))
    assert errors(found, beads)[-1] < 0.5


def test_specks_of_other_sizes_stay_out_and_radius_and_count_limit():
    specks = [((20.0 + 17 * k, 65.0), PALE, 1.0) for k in range(10)]
    picture = draw([*FIVE, *specks])
    assert len(find_beads(picture).uv) == 5
    assert errors(find_beads(picture), FIVE).max() < 0.2
    assert len(find_beads(picture, radius=(0.7, 2.0)).uv) == 10
    best = find_beads(picture, count=3)
    assert len(best.uv) == 3 and (np.diff(best.score) <= 0).all()


@pytest.mark.parametrize("value", [0, 30, 255])
def test_nothing_in_an_empty_picture(value):
    found = find_beads(np.full((*SHAPE, 3), value, np.uint8))
    assert found.uv.shape == (0, 2) and found.hsb.shape == (0, 3) and found.merged.shape == (0,)


def test_noise_alone_and_tiny_pictures_give_finite_numbers():
    rng = np.random.default_rng(1)
    for shape in ((60, 80), (3, 3), (1, 1), (5, 200)):
        found = find_beads(rng.integers(0, 256, (*shape, 3), dtype=np.uint8))
        assert all(np.isfinite(field).all() for field in found)


def test_same_picture_same_numbers():
    picture = draw(FIVE)
    for one, two in zip(find_beads(picture), find_beads(picture.copy())):
        np.testing.assert_array_equal(one, two)


def test_wrong_calls_are_refused():
    picture = draw(FIVE)
    with pytest.raises(InputError, match="rgb: expected a colour picture"):
        find_beads(picture[..., 0])
    with pytest.raises(InputError, match="rgb"):
        find_beads(picture.astype(float))
    with pytest.raises(InputError, match="radius"):
        find_beads(picture, radius=(5, 2))
    with pytest.raises(InputError, match="count"):
        find_beads(picture, count=0)
