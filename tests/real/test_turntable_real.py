"""The rendered turntable: axis, distance and angles against the truth beside the photographs, in stated sigmas."""

import json
from pathlib import Path

import numpy as np
import pytest

from jaxmocap.io import write_rig
from jaxmocap.workflows.calibrate import calibrate_chessboard
from jaxmocap.workflows.turntable import calibrate_turntable

pytestmark = pytest.mark.real


def test_rendered_turntable_within_three_sigma(data_dir: Path, tmp_path: Path) -> None:
    folder = data_dir / "rendered_puppet"
    truth = json.loads((folder / "ground_truth.json").read_text())["turntable"]
    camera = calibrate_chessboard(str(folder / "chess_*.jpg"), "9x6", "12mm")
    write_rig(tmp_path / "camera.toml", camera.rig())
    result = calibrate_turntable(tmp_path / "camera.toml", str(folder / "turntable_*.jpg"), "9x6", "12mm")
    direction = np.array(truth["axis_direction_camera"])
    point = np.array(truth["axis_point_camera"])
    nearest = point - direction * (point @ direction)
    z = (np.stack([result.axis.point, result.axis.direction]) - [nearest, direction]) / [
        result.axis.sigma_point,
        result.axis.sigma_direction,
    ]
    assert np.abs(z[0]).max() < 3 and np.abs(z[1][[0, 2]]).max() < 3, z
    assert abs(float(result.turntable.distance) - np.linalg.norm(nearest)) < 3 * result.sigma_distance
    true = dict(zip(truth["nominal_deg"], truth["actual_deg"]))
    for stated, measured, sigma in zip(result.stated_deg, result.angles_deg, result.sigma_angles_deg):
        assert abs(measured - true[round(stated)]) <= 3 * sigma, (stated, measured, sigma)
    # The board is printed on its front only: those photos are named, and no fault.
    assert len(result.names) == 5 and len(result.skipped) == 7
    assert not result.weaknesses
