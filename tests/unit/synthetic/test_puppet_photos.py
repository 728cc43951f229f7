"""Drawn puppet photos against what is known without them: OpenCV's projection, rendered_puppet's truth, pixels."""

import cv2
import numpy as np
import pytest

from jaxmocap.bodies.puppet import MARKERS
from jaxmocap.synthetic.puppet import Studio, puppet_photo
from jaxmocap.synthetic.puppet_camera import Build, PuppetCamera, pixels, ray_grid
from jaxmocap.synthetic.puppet_figure import POSES, pose_figure

CURVED = PuppetCamera(k1=-0.25, k2=0.08, p1=0.002, p2=-0.001, k3=-0.01)


def test_pixels_are_those_of_opencv():
    p = np.random.default_rng(0).uniform([-150, -120, 300], [150, 120, 500], (50, 3))
    expected = cv2.projectPoints(p, np.zeros(3), np.zeros(3), CURVED.matrix(), CURVED.distortions())[0][:, 0]
    np.testing.assert_allclose(pixels(CURVED, p), expected, atol=1e-9)


def test_every_ray_comes_back_to_its_subpixel():
    x, y = ray_grid(CURVED, 3)
    uv = pixels(CURVED, np.stack([x, y, np.ones_like(x)], axis=-1).astype(float))
    v, u = np.mgrid[: CURVED.height * 3, : CURVED.width * 3]
    assert np.abs(uv[..., 0] - ((u + 0.5) / 3 - 0.5)).max() < 2e-4
    assert np.abs(uv[..., 1] - ((v + 0.5) / 3 - 0.5)).max() < 2e-4


@pytest.mark.parametrize("angle_deg", [0, 30, 330])
def test_bead_pixels_are_where_the_truth_says(angle_deg):
    photo = puppet_photo(Studio(), pose_figure(POSES["wave"]), np.deg2rad(angle_deg), 0)
    bright = photo.rgb.max(axis=2) > 75
    checked = 0
    for name in MARKERS:
        bead = photo.beads[name]
        if bead["visible_fraction"] < 1.0:
            continue
        u, v = bead["outline_centroid_px"]
        rows, columns = np.mgrid[round(v) - 9 : round(v) + 10, round(u) - 9 : round(u) + 10]
        disc = bright[rows, columns] & (np.hypot(columns - u, rows - v) < 9)
        centroid = np.array([columns[disc].mean(), rows[disc].mean()])
        assert np.abs(centroid - [u, v]).max() < 0.4, name
        checked += 1
    assert checked >= 6


def test_world_and_axis_are_the_documents():
    T = Build().world_to_camera(np.deg2rad(30.0))
    np.testing.assert_allclose(-T[:3, :3].T @ T[:3, 3], [-200.0, 80.0, 346.41016], atol=1e-5)
    point, direction = Build(tilt=0.02, tilt_towards=0.7, turned=0.01).axis()
    assert np.arccos(-direction[1]) == pytest.approx(0.02, abs=1e-9)
    assert np.linalg.norm(point) == pytest.approx(400.0) and point @ direction == pytest.approx(0.0, abs=1e-9)
