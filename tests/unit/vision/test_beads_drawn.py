"""Beads in drawn photos of the puppet under light, noise and specks that the rendered set does not have."""

from dataclasses import replace

import numpy as np
import pytest

from jaxmocap.synthetic.puppet import Studio, puppet_photo
from jaxmocap.synthetic.puppet_figure import POSES, Proportions, pose_figure
from jaxmocap.synthetic.puppet_render import WARM_LIGHT, Look
from jaxmocap.vision import find_beads

ANGLES = np.radians([10.0, 100.0, 205.0, 310.0])
CONDITIONS = {
    "warm light, specks": (Look(light=WARM_LIGHT, specks=15), 3.0),
    "noise": (Look(noise=3.0), 3.0),
    "glossy, blurred": (Look(highlight=0.3, blur=0.8), 3.0),
    "small beads": (Look(), 1.0),
}


@pytest.mark.parametrize("name", CONDITIONS)
def test_clear_beads_are_found_and_their_sigmas_hold(name):
    look, bead_radius = CONDITIONS[name]
    figure = pose_figure(POSES["wave"], Proportions(bead_radius=bead_radius))
    z, lost, count = [], 0, 0
    for seed, angle in enumerate(ANGLES):
        photo = puppet_photo(Studio(look=replace(look, jpeg_quality=90)), figure, angle, seed)
        found = find_beads(photo.rgb)
        for bead in photo.beads.values():
            if bead["visible_fraction"] > 0.95 and bead["in_image"]:
                offset = found.uv - bead["outline_centroid_px"]
                k = int(np.linalg.norm(offset, axis=1).argmin())
                count += 1
                if np.linalg.norm(offset[k]) < 1.0:
                    z.extend(offset[k] / found.sigma[k])
                else:
                    lost += 1
    assert count > 25 and lost <= 1
    assert np.mean(np.square(z)) < 2.0 and np.mean(np.abs(z) > 3) < 0.05
