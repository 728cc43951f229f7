"""Beads of the rendered puppet, found and named from the photographs; the truth is read here only."""

import json

import numpy as np
import pytest
from bead_support import SmallRefinement

from jaxmocap.bodies.puppet import DOCUMENT_COLOURS, MARKERS
from jaxmocap.synthetic.bead_candidates import turntable_cameras
from jaxmocap.tracking import BeadColours, colours_from_tpose, identify_beads
from jaxmocap.vision.beads import find_beads
from jaxmocap.vision.photos import read_colour_photo

pytestmark = pytest.mark.real
ANGLES = np.radians(np.arange(0, 360, 30))


@pytest.fixture(scope="module")
def turns(data_dir):
    """Candidates and truth of the three poses."""
    folder = data_dir / "rendered_puppet"
    truth = json.loads((folder / "ground_truth.json").read_text())
    found = {}
    for pose in ("tpose", "wave", "stride"):
        views = truth["poses"][pose]["views"]
        pictures = [read_colour_photo(folder / view["file"]).rgb for view in views]
        found[pose] = ([find_beads(picture) for picture in pictures], views)
    return found


def rates(index, photos, views):
    """(clear beads, of these named right, wrong names): clear means hardly anything hides it."""
    clear = right = wrong = 0
    for k, view in enumerate(views):
        for m, name in enumerate(MARKERS):
            bead, i = view["beads"][name], index[k, m]
            off = np.inf if i < 0 else np.linalg.norm(photos[k].uv[i] - bead["outline_centroid_px"])
            seen = bead["visible_fraction"] > 0.95
            clear, right = clear + seen, right + (seen and off < 1.0)
            # A radius is 6 to 7 px: what is farther off is another thing.
            wrong += i >= 0 and (off > 4.0 or bead["visible_fraction"] == 0)
    return clear, right, wrong


@pytest.fixture(scope="module")
def learnt(turns):
    photos, _ = turns["tpose"]
    return colours_from_tpose(
        photos, turntable_cameras(np.array([np.pi, 0, 0]), ANGLES), refine=SmallRefinement(ANGLES)
    )


def test_colours_are_learnt_without_a_table(turns, learnt):
    assert learnt.complete and learnt.problems == ()
    clear, right, wrong = rates(learnt.index, *turns["tpose"])
    assert wrong == 0 and right >= 0.98 * clear


@pytest.mark.parametrize("pose", ["tpose", "wave", "stride"])
@pytest.mark.parametrize("source", ["learnt", "document"])
def test_all_clear_beads_are_named_and_none_wrong(turns, learnt, pose, source):
    photos, views = turns[pose]
    colours = learnt.colours if source == "learnt" else BeadColours.of(DOCUMENT_COLOURS)
    start = turntable_cameras(np.array([np.pi, 0, 0]), ANGLES)
    found = identify_beads(photos, start, colours, refine=SmallRefinement(ANGLES))
    clear, right, wrong = rates(found.index, photos, views)
    assert wrong == 0 and right >= 0.98 * clear and clear > 80


@pytest.mark.parametrize("pose", ["wave", "stride"])
def test_a_camera_turned_by_one_degree_and_uneven_steps(turns, learnt, pose):
    photos, views = turns[pose]
    rng = np.random.default_rng(0)
    off = np.array([np.pi, 0, 0]) + np.radians([0.0, 2.0, 2.0])  # near pi, 2 degrees of the vector turn by about 1
    steps = np.radians(rng.uniform(-0.5, 0.5, 12)) * (np.arange(12) > 0)
    start = turntable_cameras(off, ANGLES + steps)
    found = identify_beads(photos, start, learnt.colours, refine=SmallRefinement(ANGLES))
    clear, right, wrong = rates(found.index, photos, views)
    assert wrong == 0 and right >= 0.98 * clear
