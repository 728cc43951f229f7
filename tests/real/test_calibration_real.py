"""Photographs: the same corners as OpenCV, the same optimum, the published stereo pair, the rendered truth."""

import importlib.util
import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from jaxmocap.calibration.boards import chessboard_points

pytestmark = [pytest.mark.real, pytest.mark.slow]

_SCRIPT = Path(__file__).parents[2] / "scripts" / "compare_opencv.py"
_spec = importlib.util.spec_from_file_location("compare_opencv", _SCRIPT)
compare = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(compare)

CASES = [(name, "k1k2") for name in compare.SETS] + [
    (name, model) for name in ("OpenCV left", "Pose2Sim cam02") for model in ("none", "k1k2p1p2k3")
]


@cache
def _corners(data_dir, name):
    return compare.corners(data_dir, name)


@cache
def _estimate(data_dir, name, model):
    uv, size = _corners(data_dir, name)
    _, board, square = compare.SETS[name]
    return compare.ours(chessboard_points(*board, square), uv[:, None], size, model)


@pytest.mark.parametrize("name, model", CASES)
def test_optimum_is_opencvs(data_dir, name, model):
    uv, size = _corners(data_dir, name)
    _, board, square = compare.SETS[name]
    points = chessboard_points(*board, square)
    estimate = _estimate(data_dir, name, model)
    assert estimate.success, estimate.sentence
    rms, numbers = compare.opencv(points, uv, size, model)
    found = compare.lens_numbers(estimate)
    assert float(estimate.stats["rms_px"]) <= rms + 1e-4
    np.testing.assert_allclose(float(estimate.stats["rms_px"]), rms, atol=1e-4)
    assert np.all(np.abs(found - numbers) / compare.plain_sigmas(estimate, model) < 0.1)


def test_order_of_photos_changes_nothing(data_dir):
    uv, size = _corners(data_dir, "OpenCV left")
    order = np.random.default_rng(0).permutation(len(uv))
    again = compare.ours(chessboard_points(9, 6, 30.0), uv[order][:, None], size, "k1k2")
    first = _estimate(data_dir, "OpenCV left", "k1k2")
    sigma = compare.plain_sigmas(first, "k1k2")
    assert np.abs((compare.lens_numbers(again) - compare.lens_numbers(first)) / sigma).max() < 1e-5
    np.testing.assert_allclose(again.covariance.shared(), first.covariance.shared(), rtol=1e-5)
    np.testing.assert_allclose(again.value.local.translation, first.value.local.translation[order], atol=1e-4)


def test_stereo_pair_against_opencv_and_bouguet(data_dir):
    both = compare.stereo(data_dir)
    assert both["estimate"].success
    rms = float(both["estimate"].stats["rms_px"])
    assert abs(rms - both["opencv_rms"]) < 1e-4
    assert np.abs((both["T"] - both["opencv_T"]) / both["sigma"]).max() < 0.1
    # Bouguet's corners are his own: the difference is within the three sigmas he states plus three of ours.
    assert np.all(np.abs(both["T"] - compare.BOUGUET_T) < compare.BOUGUET_THREE_SIGMA + 3 * both["sigma"])


def test_rendered_truth_is_within_the_stated_sigmas(data_dir):
    """Corners by the package's own finder: the sum of z squared of six parameters stays below its 99.9 % limit."""
    from scipy.stats import chi2

    from jaxmocap.vision import detect_boards

    folder = data_dir / "rendered_puppet"
    truth = json.loads((folder / "ground_truth.json").read_text())["camera"]
    boards = detect_boards([str(folder / "chess_*.jpg")], (9, 6))
    assert boards.found.all()
    estimate = compare.ours(chessboard_points(9, 6, 12.0), boards.uv[:, None], boards.image_size, "k1k2")
    error = compare.lens_numbers(estimate)[:6] - np.array([truth[n] for n in ("fx", "fy", "cx", "cy", "k1", "k2")])
    covariance = np.asarray(estimate.covariance.shared())
    assert np.all(np.abs(error) < 3 * np.sqrt(np.diag(covariance)))
    assert error @ np.linalg.solve(covariance, error) < chi2.ppf(0.999, 6)
