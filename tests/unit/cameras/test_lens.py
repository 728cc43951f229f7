"""Thin-lens arithmetic, by hand."""

import pytest

from jaxmocap._errors import InputError
from jaxmocap.cameras import lens


def test_image_distance_by_hand():
    assert lens.image_distance(50.0, 100.0) == pytest.approx(100.0)  # twice the focal length images at the same
    assert lens.image_distance(2.0, 6.0) == pytest.approx(3.0)  # 1/2 = 1/6 + 1/3


def test_field_height_by_hand():
    assert lens.field_height(2.0, 3.0, 6.0) == pytest.approx(6.0)  # B/b = G/g: 3/3 = 6/6


def test_the_document_s_example_does_not_follow_from_its_distance():
    """Stop-motion document, 2.1: f = 4.22, B = 2.44, g = 500 mm is said to give G = 229 mm.

    By hand, G = g B (1/f - 1/g) = B (g/f - 1) = 2.44 (118.4834 - 1) = 286.66 mm. The printed 229 mm is what the same
    formula gives for the 400 mm between lens and turning axis: 2.44 (94.7867 - 1) = 228.84 mm.
    """
    assert lens.field_height(4.22, 2.44, 500.0) == pytest.approx(286.66, abs=0.005)
    assert lens.field_height(4.22, 2.44, 400.0) == pytest.approx(228.84, abs=0.005)


@pytest.mark.parametrize(
    "focal_length, distance", [(4.0, 4.0), (4.0, 3.0), (0.0, 5.0), (-1.0, 5.0), (4.0, float("nan"))]
)
def test_no_real_image_is_refused(focal_length, distance):
    with pytest.raises(InputError, match="distance: expected more than the focal length"):
        lens.image_distance(focal_length, distance)
    with pytest.raises(InputError, match="distance: expected more than the focal length"):
        lens.field_height(focal_length, 2.44, distance)
