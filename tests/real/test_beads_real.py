"""Beads of the rendered puppet against the truth that came with it."""

import json

import numpy as np
import pytest

from jaxmocap.vision import find_beads, read_colour_photo

pytestmark = pytest.mark.real
NEAR = 1.0  # px


@pytest.fixture(scope="module")
def photos(data_dir):
    """Candidates and truth of all 36 photos."""
    folder = data_dir / "rendered_puppet"
    truth = json.loads((folder / "ground_truth.json").read_text())
    views = [view for pose in truth["poses"].values() for view in pose["views"]]
    assert len(views) == 36
    return [(find_beads(read_colour_photo(folder / view["file"]).rgb), view) for view in views]


def matches(photos, low, high):
    """Errors (n, 2) of the candidates nearest to beads visible from `low` to `high`, their sigmas, and how many."""
    error, sigma, count = [], [], 0
    for found, view in photos:
        for bead in view["beads"].values():
            if not (low <= bead["visible_fraction"] < high and bead["in_image"]):
                continue
            count += 1
            offset = found.uv - bead["outline_centroid_px"]
            k = int(np.linalg.norm(offset, axis=1).argmin())
            error.append(offset[k])
            sigma.append(found.sigma[k])
    return np.array(error), np.array(sigma), count


def test_clear_beads_are_found(photos):
    error, sigma, count = matches(photos, 0.95, 1.1)
    length = np.linalg.norm(error, axis=1)
    assert count > 250
    assert np.mean(length < NEAR) >= 0.98
    assert np.median(length) < 0.08  # what blob centroids reach by the set's README


def test_stated_sigmas_hold(photos):
    error, sigma, _ = matches(photos, 0.95, 1.1)
    z = error / sigma[:, None]
    assert 0.4 < np.mean(z**2) < 1.6
    assert np.mean(np.abs(z) > 3) < 0.02


def test_partly_hidden_beads_are_not_drawn_to_their_visible_part(photos):
    error, sigma, count = matches(photos, 0.3, 0.95)
    length = np.linalg.norm(error, axis=1)
    assert count > 60
    assert np.mean(length < NEAR) > 0.9
    near = length < 2.5
    z = error[near] / sigma[near, None]
    assert np.mean(z**2) < 2.5 and np.mean(np.abs(z) > 3) < 0.06


def test_few_candidates_are_no_beads(photos):
    foreign = 0
    for found, view in photos:
        truth = np.array([bead["outline_centroid_px"] for bead in view["beads"].values()])
        foreign += int((np.linalg.norm(found.uv[:, None] - truth, axis=-1).min(axis=1) > 3).sum())
    assert foreign / len(photos) < 3


def test_colours_are_those_measured_in_the_set(photos, data_dir):
    truth = json.loads((data_dir / "rendered_puppet" / "ground_truth.json").read_text())
    measured = truth["beads"]["tpose_measured_hsb"]
    for name, hsb in measured.items():
        seen = []
        for found, view in photos[:12]:
            bead = view["beads"][name]
            distance = np.linalg.norm(found.uv - bead["outline_centroid_px"], axis=1)
            if bead["visible_fraction"] > 0.95 and distance.min() < NEAR:
                seen.append(found.hsb_square[distance.argmin()])
        hue = np.abs((np.array(seen)[:, 0] - hsb[0] + 0.5) % 1.0 - 0.5)
        assert np.median(hue) < 0.02
        np.testing.assert_allclose(np.median(seen, axis=0)[1:], hsb[1:], atol=0.08)
