"""`jaxmocap view`: from files to the scene, and to the page."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from motion_samples import ARM_HANDS, arm, positions

from jaxmocap._errors import InputError
from jaxmocap.io import write_glb, write_points
from jaxmocap.workflows.view import view_scene

RIG = """\
[cam_left]
name = "left"
size = [640, 480]
matrix = [[800.0, 0.0, 319.5], [0.0, 800.0, 239.5], [0.0, 0.0, 1.0]]
distortions = [0.1, -0.2, 0.0, 0.0, 0.0]
rotation = [0.0, 0.0, 0.0]
translation = [0.0, 0.0, 0.0]
[cam_right]
name = "right"
size = [640, 480]
matrix = [[800.0, 0.0, 319.5], [0.0, 800.0, 239.5], [0.0, 0.0, 1.0]]
distortions = [0.0, 0.0, 0.0, 0.0, 0.0]
rotation = [0.0, 1.5707963267948966, 0.0]
translation = [0.0, 0.0, 5.0]
[metadata]
unit = "cm"
"""


@pytest.fixture()
def files(tmp_path: Path) -> Path:
    """A motion in cm, three frames of two markers, a rig in cm."""
    write_glb(tmp_path / "arm.glb", arm(), markers={"m": np.array([[0.0, 1, 2]] * 3)}, colours={"m": (1, 0, 0)})
    xyz = np.array([[0.0, 1, 2], [3, 4, 5], [0, 1, 3]])
    write_points(
        tmp_path / "points.csv", np.array([0, 1, 2]), ["a", "b", "a"], xyz, np.full((3, 3), 0.1), np.ones(3, int)
    )
    (tmp_path / "rig.toml").write_text(RIG)
    return tmp_path


def test_a_motion_is_shown_in_its_own_unit(files):
    scene = view_scene([files / "arm.glb"])
    assert (scene.title, scene.unit, scene.up, scene.fps) == ("arm.glb", "cm", "y", 25.0)
    np.testing.assert_allclose(scene.skeleton.p_world, positions(arm()), atol=1e-5)
    np.testing.assert_allclose(scene.skeleton.p_world[:, 2], ARM_HANDS, atol=1e-5)
    np.testing.assert_allclose(scene.markers.p_world, np.tile([[[0.0, 1, 2]]], (3, 1, 1)), atol=1e-5)
    np.testing.assert_allclose(scene.markers.colours, [(1, 0, 0)], atol=1e-6)


def test_a_table_has_the_unit_that_it_is_given(files):
    assert view_scene([files / "points.csv"]).unit == "1"
    scene = view_scene([files / "points.csv"], unit="mm", up="z")
    assert (scene.unit, scene.up, scene.markers.names) == ("mm", "z", ("a", "b"))
    assert np.isnan(scene.markers.p_world[0, 1]).all() and scene.markers.sigma[1, 1, 0] == 0.1


def test_cameras_stand_where_they_are_and_look_where_they_look(files):
    scene = view_scene([files / "rig.toml"])
    left, right = scene.cameras
    assert (left.name, right.name, scene.unit, scene.up) == ("left", "right", "cm", "-y")
    # Half a pixel beyond the centre of the corner pixel: 320 px and 240 px from the middle at 800 px.
    np.testing.assert_allclose(left.corners, [[-0.4, -0.3, 1], [0.4, -0.3, 1], [0.4, 0.3, 1], [-0.4, 0.3, 1]])
    # p_camera = Ry(90) p_world + (0, 0, 5): the camera's z is the world's -x, and its centre is 5 along x.
    np.testing.assert_allclose(right.centre, [5, 0, 0], atol=1e-12)
    np.testing.assert_allclose(right.corners.mean(axis=0), [-1, 0, 0], atol=1e-12)


def test_files_together_share_unit_and_world(files):
    scene = view_scene([files / "points.csv", files / "rig.toml"])
    assert (scene.unit, scene.up, len(scene.cameras)) == ("cm", "-y", 2)
    np.testing.assert_array_equal(scene.markers.p_world[1, 1], [3, 4, 5])
    in_mm = view_scene([files / "points.csv", files / "rig.toml"], unit="mm")
    np.testing.assert_allclose(in_mm.markers.p_world[1, 1], [0.3, 0.4, 0.5])
    both = view_scene([files / "arm.glb", files / "points.csv"])
    assert both.markers.names == ("a", "b") and both.skeleton.names == arm().names


TURNTABLE = "rotation = [3.141592653589793, 0.0, 0.0]\ndistance = 400.0\nheight = 80.0\n"
ANGLES = '[angles_deg]\n"a_000.jpg" = 0.0\n"a_090.jpg" = 90.0\n[metadata]\nunit = "mm"\n'


def test_a_turntable_has_its_camera_at_each_angle(files):
    (files / "turntable.toml").write_text(TURNTABLE + ANGLES)
    scene = view_scene([files / "turntable.toml"])
    assert (scene.unit, scene.up, [c.name for c in scene.cameras]) == ("mm", "y", ["0°", "90°"])
    # The document's table: at 0 the camera stands at (0, 80, 400), at 90 at (-400, 80, 0); it looks at the axis.
    np.testing.assert_allclose([c.centre for c in scene.cameras], [[0, 80, 400], [-400, 80, 0]], atol=1e-9)
    looks = [c.corners.mean(axis=0) for c in scene.cameras]
    np.testing.assert_allclose(looks, [[0, 0, -1], [1, 0, 0]], atol=1e-9)
    assert (scene.cameras[0].corners[0] > 0).tolist() == [False, True, False]  # top left of the picture: -x, +y
    np.testing.assert_array_equal(scene.axis.direction, [0, 1, 0])
    assert "give its camera file too" in scene.notes[0]


def test_a_turntable_beside_its_camera_and_points(files):
    (files / "turntable.toml").write_text(TURNTABLE + ANGLES)
    (files / "camera.toml").write_text(RIG.split("[cam_right]")[0] + '[metadata]\nunit = "mm"\n')
    scene = view_scene([files / "points.csv", files / "camera.toml", files / "turntable.toml"])
    assert (scene.unit, scene.up, len(scene.cameras), scene.notes) == ("mm", "y", 2, ())
    np.testing.assert_allclose(scene.cameras[0].corners[0], [-0.4, 0.3, -1], atol=1e-9)
    with pytest.raises(InputError, match="a turntable has one camera; the rig beside it has 2"):
        view_scene([files / "turntable.toml", files / "rig.toml"])


def test_what_cannot_be_shown_is_refused(files):
    (files / "x.bvh").write_text("HIERARCHY")
    write_points(files / "one.csv", np.array([0]), ["a"], np.ones((1, 3)))
    for paths, sentence in [
        ([], "expected a file to show"),
        ([files / "x.bvh"], "expected a .glb"),
        ([files / "rig.toml", files / "rig.toml"], "2 files are each a rig"),
        ([files / "arm.glb", files / "one.csv"], "have 3 and 1 frames"),
        ([files / "gone.toml"], "no such file"),
    ]:
        with pytest.raises(InputError, match=sentence):
            view_scene(paths)
    with pytest.raises(InputError, match="expected a unit out of"):
        view_scene([files / "points.csv"], unit="yards")


def test_the_command_writes_a_page_and_nothing_on_failure(jaxmocap, files):
    done = jaxmocap("view", files / "points.csv", files / "rig.toml", "--html", "out.html")
    assert done.status == 0 and "2 markers, 2 cameras, 3 frames" in done.text, done.text
    text = (files / "out.html").read_text(encoding="utf-8")
    data = json.loads(re.search(r'<script type="application/json">(.*?)</script>', text, re.S)[1])
    assert data["unit"] == "cm" and [c["name"] for c in data["cameras"]] == ["left", "right"]
    done = jaxmocap("view", files / "arm.glb")
    assert done.status == 0 and (files / "arm.view.html").is_file(), done.text
    (files / "broken.glb").write_bytes((files / "arm.glb").read_bytes()[:500])
    done = jaxmocap("view", files / "broken.glb", "--html", "out.html")
    assert done.status == 2 and "cut off or damaged" in done.text and "Traceback" not in done.text
    assert (files / "out.html").read_text(encoding="utf-8") == text
