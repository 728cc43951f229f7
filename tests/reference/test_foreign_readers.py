"""What we write, other programs read: aniposelib's loader, OpenCV's FileStorage, Pose2Sim's way of reading."""

import tomllib

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.cameras import BrownDistortion, Camera, Intrinsics, project
from jaxmocap.geometry import Pose
from jaxmocap.io import NamedCamera, RigFile, read_opencv_yaml, read_rig, write_opencv_yaml, write_rig

NAMES = ("left", "cam2", "größe 3", 'quo"te.dot')


def _rig(names=NAMES) -> RigFile:
    rng = np.random.default_rng(5)
    cameras = []
    for name in names:
        fx, fy = rng.uniform(600, 1200, 2)
        i = Intrinsics(*(jnp.asarray(x) for x in (fx, fy, 320 + rng.normal(), 240 + rng.normal(), 0.0)))
        lens = BrownDistortion(*(jnp.asarray(x) for x in rng.normal(size=5) * [0.1, 0.05, 1e-3, 1e-3, 0.01]))
        pose = Pose(jnp.asarray(rng.normal(size=3) * 0.3), jnp.asarray([*rng.normal(size=2), 6.0]))
        cameras.append(NamedCamera(name, Camera(i, lens, pose, (640, 480))))
    return RigFile(
        tuple(cameras), unit="m", up="-y", error=0.25, seed=1,
        sigmas={name: {"fx": 0.5} for name in names}, inputs={"left 01.jpg": "0f" * 32}, settings={"robust": True},
        foreign_tables={"charuco": {"rows": 4}},
    )  # fmt: skip


def _points() -> np.ndarray:
    return np.random.default_rng(6).uniform(-1, 1, size=(20, 3))


def _ours(camera: Camera, points: np.ndarray | None = None) -> np.ndarray:
    points = _points() if points is None else points
    return np.asarray(jax.vmap(project, in_axes=(None, 0))(camera, jnp.asarray(points))[0])


def test_aniposelib_loads_the_rig_and_projects_alike(tmp_path):
    needs = "install it with `pip install --no-deps aniposelib toml numba llvmlite pandas`: its OpenCV breaks ours"
    aniposelib = pytest.importorskip("aniposelib.cameras", reason=needs)
    write_rig(tmp_path / "rig.toml", _rig())
    group = aniposelib.CameraGroup.load(str(tmp_path / "rig.toml"))
    theirs = {camera.get_name(): camera for camera in group.cameras}
    assert theirs.keys() == set(NAMES)
    assert group.metadata["error"] == 0.25
    for named in _rig().cameras:
        camera = theirs[named.name]
        assert tuple(camera.get_size()) == (640, 480)
        pixels = camera.project(_points()).reshape(-1, 2)
        np.testing.assert_allclose(pixels, _ours(named.camera), rtol=0, atol=1e-9)


def test_aniposelib_keeps_the_order_of_twelve_cameras(tmp_path):
    aniposelib = pytest.importorskip("aniposelib.cameras", reason="as above")
    names = [f"cam{i}" for i in range(1, 13)]
    write_rig(tmp_path / "rig.toml", _rig(names))
    assert aniposelib.CameraGroup.load(str(tmp_path / "rig.toml")).get_names() == names


def test_what_aniposelib_dumps_is_read(tmp_path):
    aniposelib = pytest.importorskip("aniposelib.cameras", reason="as above")
    matrix = np.array([[800.0, 0, 320], [0, 810, 240], [0, 0, 1]])
    camera = aniposelib.Camera(
        matrix, np.array([0.1, -0.2, 0, 0, 0]), (640, 480), np.array([0.1, 0.2, 0.3]), np.array([1.0, 2, 3]), "A"
    )
    aniposelib.CameraGroup([camera], metadata={"adjusted": False, "error": 0.5}).dump(str(tmp_path / "rig.toml"))
    rig = read_rig(tmp_path / "rig.toml")
    assert (rig.cameras[0].name, rig.error, rig.cameras[0].camera.image_size) == ("A", 0.5, (640, 480))
    pixels = camera.project(_points()).reshape(-1, 2)
    np.testing.assert_allclose(pixels, _ours(rig.cameras[0].camera), rtol=0, atol=1e-9)


def test_read_as_pose2sim_reads(tmp_path):
    """Its common.py takes every table but four, in the order of the file, and hands the numbers to OpenCV."""
    write_rig(tmp_path / "rig.toml", _rig())
    document = tomllib.loads((tmp_path / "rig.toml").read_text(encoding="utf-8"))
    tables = [t for key, t in document.items() if key not in ("metadata", "capture_volume", "charuco", "checkerboard")]
    assert [table["name"] for table in tables] == list(NAMES)
    for table, named in zip(tables, _rig().cameras, strict=True):
        numbers = [np.array(table[key]) for key in ("rotation", "translation", "matrix", "distortions")]
        pixels = cv2.projectPoints(_points(), *numbers)[0].reshape(-1, 2)
        np.testing.assert_allclose(pixels, _ours(named.camera), rtol=0, atol=1e-9)
        assert table["size"] == [640, 480] and table["fisheye"] is False


@pytest.mark.parametrize("name", NAMES)
def test_opencv_reads_one_camera(tmp_path, name):
    named = NamedCamera(name, _rig().cameras[0].camera)
    write_opencv_yaml(tmp_path / "camera.yml", named)
    storage = cv2.FileStorage(str(tmp_path / "camera.yml"), cv2.FILE_STORAGE_READ)
    assert storage.getNode("camera_name").string() == name
    assert (storage.getNode("image_width").real(), storage.getNode("image_height").real()) == (640, 480)
    keys = ("rvec", "tvec", "camera_matrix", "distortion_coefficients")
    pixels = cv2.projectPoints(_points(), *(storage.getNode(key).mat() for key in keys))[0].reshape(-1, 2)
    np.testing.assert_allclose(pixels, _ours(named.camera), rtol=0, atol=1e-9)


def test_opencv_reads_a_pair(tmp_path):
    pair = _rig().cameras[:2]
    write_opencv_yaml(tmp_path / "pair.yml", pair)
    storage = cv2.FileStorage(str(tmp_path / "pair.yml"), cv2.FILE_STORAGE_READ)
    M1, D1, M2, D2, R, T = (storage.getNode(key).mat() for key in ("M1", "D1", "M2", "D2", "R", "T"))
    pose = pair[0].camera.T_camera_world
    r_1, t_1 = np.array(pose.rotvec), np.array(pose.translation)
    r_2, t_2 = cv2.composeRT(r_1, t_1, cv2.Rodrigues(R)[0].ravel(), T.ravel())[:2]
    for named, r, t, M, D in [(pair[0], r_1, t_1, M1, D1), (pair[1], r_2, t_2, M2, D2)]:
        pixels = cv2.projectPoints(_points(), r, t, M, D)[0].reshape(-1, 2)
        np.testing.assert_allclose(pixels, _ours(named.camera), rtol=0, atol=1e-9)


def test_what_opencv_writes_is_read(tmp_path):
    rng = np.random.default_rng(7)
    K = np.array([[800 + rng.normal(), 0, 320 + rng.normal()], [0, 810 + rng.normal(), 240 + rng.normal()], [0, 0, 1]])
    k = rng.normal(size=(5, 1)) * 0.01
    storage = cv2.FileStorage(str(tmp_path / "out.yml"), cv2.FILE_STORAGE_WRITE)
    storage.write("calibration_time", "Mon 01 Jan 12:00:00")
    storage.write("nframes", 13)
    for key, value in [
        ("image_width", 640),
        ("image_height", 480),
        ("camera_matrix", K),
        ("distortion_coefficients", k),
    ]:
        storage.write(key, value)
    storage.writeComment("a remark", 0)
    storage.write("per_view_reprojection_errors", rng.normal(size=(13, 1)).astype(np.float32))
    storage.write("image_points", rng.normal(size=(13, 54)))
    storage.startWriteStruct("files", cv2.FileNode_SEQ)
    for name in ("left01.jpg", "left: 02.jpg"):
        storage.write("", name)
    storage.endWriteStruct()
    storage.release()
    (named,) = read_opencv_yaml(tmp_path / "out.yml")
    assert np.asarray(named.camera.intrinsics.matrix()).tolist() == K.tolist()
    assert np.asarray(named.camera.distortion.vector()).tolist() == k.ravel().tolist()
    assert (named.name, named.camera.image_size) == ("out", (640, 480))


def test_a_rig_of_caliscope(data_dir):
    file = data_dir / "caliscope_charuco_4cam_a" / "camera_array.toml"
    tables = tomllib.loads(file.read_text())["cameras"]
    rig = read_rig(file)
    assert [named.name for named in rig.cameras] == ["0", "1", "2", "3"]
    for named, table in zip(rig.cameras, tables.values(), strict=True):
        R, t, K, k = (np.array(table[key]) for key in ("rotation", "translation", "matrix", "distortions"))
        points = (_points() + [0, 0, 4] - t) @ R  # in front of this camera
        pixels = cv2.projectPoints(points, cv2.Rodrigues(R)[0], t, K, k)[0].reshape(-1, 2)
        np.testing.assert_allclose(pixels, _ours(named.camera, points), rtol=0, atol=1e-9)
        assert named.camera.image_size == (1280, 720)


def test_a_rig_of_pose2sim(data_dir):
    rig = read_rig(data_dir / "sports2d_walk_video" / "Calib_demo.toml")
    assert [named.name for named in rig.cameras] == ["demo"]
    assert float(rig.cameras[0].camera.intrinsics.fx) == 2520.0897058227038
    assert rig.foreign_metadata == {"adjusted": False} and rig.error == 0.0
