"""The rendered puppet from photographs to skeleton, by the workflow of the commands; the truth is read here only."""

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from jaxmocap.bodies.puppet import MARKERS
from jaxmocap.io import write_many, write_rig
from jaxmocap.workflows.calibrate import calibrate_chessboard
from jaxmocap.workflows.stopmotion import add_to_puppet, identify, learn_colours, new_puppet, reconstruct
from jaxmocap.workflows.turntable import calibrate_turntable

pytestmark = pytest.mark.real
POSES = ("tpose", "wave", "stride")


class Solved(NamedTuple):
    """What `--json` says of a pose, beside the truth."""

    names: dict
    pose: dict
    truth: dict
    turntable: dict


@pytest.fixture(scope="module")
def solved(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Solved]:
    """All poses, with camera, turntable and colours from the photographs of the set."""
    photos, here = data_dir / "rendered_puppet", tmp_path_factory.mktemp("real")
    write_rig(here / "camera.toml", calibrate_chessboard(str(photos / "chess_*.jpg"), "9x6", "12mm").rig())
    turned = calibrate_turntable(here / "camera.toml", str(photos / "turntable_*.jpg"), "9x6", "12mm")
    files = {"turntable": here / "turntable.toml", "colours": here / "colours.toml"}
    files["turntable"].write_text(turned.text())
    tpose = sorted(photos.glob("tpose_*.jpg"))
    learnt = learn_colours(tpose, here / "camera.toml", turntable=files["turntable"], output=files["colours"])
    write_many(learnt.files)
    truth = json.loads((photos / "ground_truth.json").read_text())
    found = {}
    for pose in POSES:
        new_puppet(here / pose, here / "camera.toml", **files)
        add_to_puppet(here / pose, str(photos / f"{pose}_*.jpg"))
        named = identify(here / pose)
        write_many(named.files)
        found[pose] = Solved(named.content, reconstruct(here / pose).content, truth["poses"][pose], truth["turntable"])
    return found


@pytest.mark.parametrize("pose", POSES)
def test_clear_beads_are_named_and_none_wrong(solved: dict[str, Solved], pose: str) -> None:
    clear, right, wrong = 0, 0, []
    for view in solved[pose].truth["views"]:
        found = solved[pose].names["detections"][view["file"]]
        for bead, there in view["beads"].items():
            off = np.inf
            if bead in found:
                off = np.hypot(*np.subtract(found[bead], there["outline_centroid_px"]))
                # A radius is 6 to 7 px: what is farther off, or where nothing is to be seen, is another thing.
                if off > 4.0 or there["visible_fraction"] == 0:
                    wrong.append((view["file"], bead, off))
            if there["visible_fraction"] > 0.95 and there["in_image"]:
                clear, right = clear + 1, right + (off < 1.0)
    assert wrong == []
    assert clear > 80 and right >= 0.98 * clear


def aligned(points: np.ndarray, to: np.ndarray) -> np.ndarray:
    """Points moved rigidly, without scale, as near to others as they come (Kabsch)."""
    middle, there = points.mean(axis=0), to.mean(axis=0)
    U, _, Vt = np.linalg.svd((points - middle).T @ (to - there))
    turn = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    return (points - middle) @ turn + there


@pytest.mark.parametrize("pose", POSES)
def test_markers_and_bones(solved: dict[str, Solved], pose: str) -> None:
    markers, truth = solved[pose].pose["markers"], solved[pose].truth
    assert markers.keys() == set(MARKERS)
    xyz, true = (np.array([place(name) for name in MARKERS]) for place in (
        lambda name: markers[name]["xyz"], lambda name: truth["beads_world"][name]
    ))  # fmt: skip
    error = np.abs(aligned(xyz, true) - true)
    assert np.median(error) < 0.5 and error.max() < 2.0, error
    turned = {}
    for name, bone in truth["bones"].items():
        if "m1" in bone:
            d = np.array(solved[pose].pose["bones"][name]["direction"])
            turned[name] = np.degrees(np.arctan2(np.linalg.norm(np.cross(d, bone["direction"])), d @ bone["direction"]))
    assert len(turned) == 10 and max(turned.values()) < 1.0, turned


@pytest.mark.parametrize("pose", POSES)
def test_axis_and_angles_within_their_sigmas(solved: dict[str, Solved], pose: str) -> None:
    said, true = solved[pose].pose, solved[pose].turntable
    direction, point = np.array(true["axis_direction_camera"]), np.array(true["axis_point_camera"])
    nearest = point - direction * (point @ direction)
    z = [(np.array(said["axis"]["point"]) - nearest) / said["axis"]["sigma_point"]]
    # The part of a unit vector along itself has an error of second order, and no sigma to compare with.
    z.append(((np.array(said["axis"]["direction"]) - direction) / said["axis"]["sigma_direction"])[[0, 2]])
    held = [name for name, sigma in said["sigma_angles_deg"].items() if sigma == 0]
    assert held == [f"{pose}_000.jpg"]
    for stated, actual in zip(true["nominal_deg"], true["actual_deg"]):
        name = f"{pose}_{round(stated):03d}.jpg"
        if name not in held:
            off = said["angles_deg"][name] - actual
            z.append(np.atleast_1d(((off + 180.0) % 360.0 - 180.0) / said["sigma_angles_deg"][name]))
    z = np.abs(np.concatenate(z))
    assert len(z) == 5 + 11 and z.max() < 3.0, z
