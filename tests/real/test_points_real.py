"""`calibrate_points` on board corners that somebody else's webcams saw, against their own bundle adjustment."""

import csv
import tomllib
from pathlib import Path

import numpy as np
import pytest

import jaxmocap
from jaxmocap.geometry import rotation


@pytest.mark.real
def test_two_webcams_stand_where_their_owners_found_them(data_dir: Path, tmp_path: Path) -> None:
    folder = data_dir / "caliscope_charuco_4cam_a"
    with (folder / "xy.csv").open() as file, (tmp_path / "points.csv").open("w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(["view", "x", "y", "z", "u", "v", "camera"])
        for r in csv.DictReader(file):
            if r["cam_id"] in "03":
                place = [r["sync_index"], r["obj_loc_x"], r["obj_loc_y"], 0, r["img_loc_x"], r["img_loc_y"]]
                writer.writerow([*place, "cam" + r["cam_id"]])
    result = jaxmocap.calibrate_points(tmp_path / "points.csv", "1280x720", unit="m")
    assert result.estimate.success
    cameras = tomllib.loads((folder / "camera_array.toml").read_text())["cameras"]

    def centre(R: np.ndarray, t: np.ndarray) -> np.ndarray:
        return -R.T @ t

    theirs = [centre(np.array(cameras[k]["rotation"]), np.array(cameras[k]["translation"])) for k in "03"]
    where = {name: k for k, name in enumerate(result.cameras)}
    ours = []
    for name in ("cam0", "cam3"):
        pose = result.camera(where[name]).T_camera_world
        ours.append(centre(np.asarray(rotation.exp(pose.rotvec)), np.asarray(pose.translation)))
    distance, known = (float(np.linalg.norm(c[0] - c[1])) for c in (ours, theirs))
    # Free-running webcams and a board that fills 3 to 7 % of the images: both results are good to a few percent.
    assert abs(distance / known - 1) < 0.03
