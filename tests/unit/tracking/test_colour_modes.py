"""The document's own way of naming, and the repaired one, on cases worked out by hand."""

import numpy as np
import pytest

from jaxmocap._errors import InputError
from jaxmocap.tracking.bead_colours import BeadColours
from jaxmocap.tracking.colour_modes import colour_distances, name_by_colour

COLOURS = BeadColours.of({"red": (0.99, 0.5, 0.5), "green": (0.30, 0.5, 0.5), "lime": (0.36, 0.5, 0.5)})


def test_distance_by_hand():
    d = colour_distances(np.array([[0.39, 0.7, 0.9]]), COLOURS, circular=False)
    # dh 0.6, 0.09, 0.03; ds 0.2; db 0.4
    assert np.allclose(d, np.sqrt([[0.36 + 0.2, 0.0081 + 0.2, 0.0009 + 0.2]]))


def test_plain_hue_does_not_wrap_and_circular_does():
    candidate = np.array([[0.01, 0.5, 0.5]])
    assert name_by_colour(candidate, COLOURS, "literal").tolist() == [-1, -1, -1]
    assert name_by_colour(candidate, COLOURS, "repaired").tolist() == [0, -1, -1]


def test_literal_gives_one_candidate_several_names_and_repaired_does_not():
    candidate = np.array([[0.32, 0.5, 0.5]])  # 0.02 from green, 0.04 from lime
    assert name_by_colour(candidate, COLOURS, "literal").tolist() == [-1, 0, 0]
    assert name_by_colour(candidate, COLOURS, "repaired").tolist() == [-1, 0, -1]


def test_the_smallest_distance_comes_first():
    candidates = np.array([[0.33, 0.5, 0.5], [0.31, 0.5, 0.5]])  # 0.03 and 0.01 from green; 0.03 and 0.05 from lime
    assert name_by_colour(candidates, COLOURS, "repaired").tolist() == [-1, 1, 0]


def test_the_limit_is_not_reached_by_what_equals_it():
    candidate = np.array([[0.30, 0.75, 0.5]])  # 0.25 in saturation, exactly representable
    assert name_by_colour(candidate, COLOURS, "literal", max_distance=0.25).tolist() == [-1, -1, -1]
    assert name_by_colour(candidate, COLOURS, "literal", max_distance=0.2501).tolist()[1] == 0


def test_no_candidate_no_name():
    assert name_by_colour(np.zeros((0, 3)), COLOURS, "literal").tolist() == [-1, -1, -1]


def test_wrong_calls():
    with pytest.raises(InputError, match="mode: expected 'literal' or 'repaired'"):
        name_by_colour(np.zeros((1, 3)), COLOURS, "best")
    with pytest.raises(InputError, match="max_distance"):
        name_by_colour(np.zeros((1, 3)), COLOURS, "literal", max_distance=float("nan"))
