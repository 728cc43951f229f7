import numpy as np
import pytest

from jaxmocap._errors import InputError
from jaxmocap.bodies.puppet import DOCUMENT_COLOURS, MARKERS
from jaxmocap.synthetic.bead_candidates import Build, tpose_scene, turn_of_photos
from jaxmocap.tracking.suspects import suspect_names

FILES = [f"{a:03d}.jpg" for a in range(0, 360, 30)]


@pytest.fixture(scope="module")
def seen():
    build = Build(turn_deg=0.0, step_deg=0.0, specks=0, hidden=0.0, half_hidden=0.0)
    return turn_of_photos(tpose_scene(DOCUMENT_COLOURS), np.arange(0, 360, 30), build, np.random.default_rng(0))


def true_index(seen):
    index = np.full((12, 16), -1)
    for k, photo in enumerate(seen.photos):
        index[k, photo.truth] = np.arange(len(photo.truth))
    return index


def test_right_names_are_not_suspect(seen):
    found = suspect_names(seen.photos, seen.start, true_index(seen), MARKERS, FILES, 2.0)
    assert not found.wrong.any() and not found.undecided.any() and found.problems == () and found.distance.max() < 2.0


def test_a_swap_is_named_in_both_markers(seen):
    index = true_index(seen)
    a, b = MARKERS.index("torso.1"), MARKERS.index("head.2")
    index[0, [a, b]] = index[0, [b, a]]
    found = suspect_names(seen.photos, seen.start, index, MARKERS, FILES, 2.0)
    assert np.argwhere(found.wrong).tolist() == [[0, b], [0, a]]
    # 25 mm of height between them, at 385 mm: 25 860.2 / 385 = 56 px
    assert found.distance[0, a] == pytest.approx(56, abs=2) and "torso.1 is probably another bead in 000.jpg (5" in str(
        found.problems
    )


def test_two_that_contradict_each_other_decide_nothing(seen):
    index = np.full((12, 16), -1)
    truth = true_index(seen)
    index[0, 0], index[1, 0] = truth[0, 0], truth[1, 3]
    found = suspect_names(seen.photos, seen.start, index, MARKERS, FILES, 2.0)
    assert found.undecided[0] and not found.wrong.any() and "no majority" in found.problems[0]


def test_wrong_calls(seen):
    with pytest.raises(InputError, match="index: expected shape"):
        suspect_names(seen.photos, seen.start, np.zeros((2, 16), int), MARKERS, FILES, 2.0)
    bad = true_index(seen)
    bad[2, 1] = 99
    with pytest.raises(InputError, match="head.2 in 060.jpg is candidate 99"):
        suspect_names(seen.photos, seen.start, bad, MARKERS, FILES, 2.0)
