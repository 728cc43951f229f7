"""OpenCV's calibration files, ours and those of its samples."""

import sys
from pathlib import Path

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from jaxmocap._errors import InputError
from jaxmocap.io import NamedCamera, read_opencv_yaml, write_opencv_yaml

sys.path.insert(0, str(Path(__file__).parent))
from io_samples import YAML, camera_of_numbers, numbers_of, simple

finite = st.floats(allow_nan=False, allow_infinity=False, width=64)
positive = st.floats(min_value=1e-300, max_value=1e300)
names = st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=12)


def _read(tmp_path, text, **options):
    (tmp_path / "camera.yml").write_text(text, encoding="utf-8")
    return read_opencv_yaml(tmp_path / "camera.yml", **options)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("yaml")


@given(name=names, focal=st.tuples(positive, positive), rest=st.lists(finite, min_size=14, max_size=14))
def test_what_is_written_reads_back_exactly(folder, name, focal, rest):
    numbers = [*focal, *rest]
    write_opencv_yaml(folder / "camera.yml", NamedCamera(name, camera_of_numbers(numbers, (1, 10**6))))
    (back,) = read_opencv_yaml(folder / "camera.yml")
    assert (back.name, back.camera.image_size, numbers_of(back.camera)) == (name, (1, 10**6), numbers)


def test_a_file_of_the_calibration_sample(tmp_path):
    (named,) = _read(
        tmp_path, YAML + "avg_reprojection_error: 0.3\nextrinsic_parameters: !!opencv-matrix\n   rows: 9\n"
    )
    expected = [800, 810, 320, 240, 0, 0.1, -0.2, 0.001, 0.002, 0.05, 0, 0, 0, 0, 0, 0]
    assert numbers_of(named.camera) == expected
    assert (named.name, named.camera.image_size, named.warnings) == ("camera", (640, 480), ())


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("camera_matrix", "K"), ("camera_matrix", "cameraMatrix"), ("camera_matrix", "Camera_Matrix"),
        ("distortion_coefficients", "D"), ("distortion_coefficients", "dist_coeffs"), ("%YAML:1.0", "%YAML 1.2"),
        ("image_width: 640\nimage_height: 480\n", "imageSize: [ 640, 480 ]\n"),
        ("image_width: 640\nimage_height: 480\n", "image_size:\n   - 640\n   - 480\n"),
        (" !!opencv-matrix", ""), ("\n", "\r\n"), ("%YAML", "\ufeff%YAML"),
    ],
)  # fmt: skip
def test_other_spellings(tmp_path, old, new):
    (named,) = _read(tmp_path, YAML.replace(old, new))
    assert named.camera.image_size == (640, 480) and numbers_of(named.camera)[:6] == [800, 810, 320, 240, 0, 0.1]


def _block(key, rows):
    data = ", ".join(f"{x!r}" for row in rows for x in row)
    return f"{key}: !!opencv-matrix\n   rows: {len(rows)}\n   cols: {len(rows[0])}\n   dt: d\n   data: [ {data} ]\n"


STEREO = "%YAML:1.0\n---\n" + "".join(
    _block(f"M{n}", [[800.0 + n, 0.0, 320.0], [0.0, 810.0, 240.0], [0.0, 0.0, 1.0]])
    + _block(f"D{n}", [[0.1, 0.2, 0, 0, 0]])
    for n in (1, 2)
)
QUARTER_TURN = _block("R", [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) + _block("T", [[-60.0], [1.0], [2.0]])


def test_a_stereo_pair_in_the_two_files_of_the_sample(tmp_path):
    (tmp_path / "extrinsics.yml").write_text("%YAML:1.0\n---\n" + QUARTER_TURN + _block("Q", [[1.0]]))
    left, right = _read(tmp_path, STEREO, image_size=(640, 480), extrinsics=tmp_path / "extrinsics.yml")
    assert (left.name, right.name) == ("left", "right")
    assert numbers_of(left.camera)[0] == 801 and numbers_of(left.camera)[10:] == [0, 0, 0, 0, 0, 0]
    assert numbers_of(right.camera)[0] == 802
    np.testing.assert_allclose(numbers_of(right.camera)[10:], [0, 0, np.pi / 2, -60, 1, 2], rtol=0, atol=1e-15)


def test_a_pair_keeps_where_the_second_stands_to_the_first(tmp_path):
    pair = simple("a", x=1.0), simple("b", x=-4.0, skew=0.5)
    said = write_opencv_yaml(tmp_path / "pair.yml", pair)
    assert len(said) == 1 and "'b' has a skew of 0.5 px" in said[0]
    left, right = read_opencv_yaml(tmp_path / "pair.yml")
    # Both cameras of the pair look the same way, so only the translations differ: by -5 along x.
    np.testing.assert_allclose(numbers_of(right.camera)[10:], [0, 0, 0, -5, 0, 0], rtol=0, atol=1e-14)
    assert numbers_of(left.camera)[:10] == numbers_of(pair[0].camera)[:10]
    assert numbers_of(right.camera)[:10] == numbers_of(pair[1].camera)[:10]


def test_the_place_of_one_camera(tmp_path):
    (named,) = _read(tmp_path, YAML + QUARTER_TURN)
    turn = Rotation.from_rotvec(numbers_of(named.camera)[10:13])
    np.testing.assert_allclose(turn.as_euler("xyz"), [0, 0, np.pi / 2], atol=1e-15)


MISTAKES = {
    "no size": ("image_width: 640\n", "", "image_width or image_height is missing. Give the image size"),
    "no matrix": ("camera_matrix", "other", r"camera_matrix is missing \(found: imagewidth, imageheight, other"),
    "no distortion": ("distortion_coefficients", "other", "distortion_coefficients is missing"),
    "nan": ("800.", ".Nan", "line 5, camera_matrix: holds nan"),
    "inf": ("320.", "-.Inf", "camera_matrix: holds -inf"),
    "rows huge": ("rows: 3", "rows: 1000000", "rows x cols is 1e[+]06 x 3, but there are 9 numbers"),
    "rows overflow": ("rows: 3", "rows: 1e999", "rows x cols is inf"),
    "rows negative": ("rows: 3", "rows: -3", "rows x cols is -3 x 3"),
    "rows missing": ("   rows: 3\n", "", "line 5, camera_matrix: .*`rows` is missing"),
    "cols fraction": ("rows: 3\n   cols: 3", "rows: 2\n   cols: 4.5", "rows x cols is 2 x 4.5"),
    "short data": ("0., 0., 1. ]", "0., 1. ]", "there are 8 numbers"),
    "cut data": ("0., 0., 1. ]", "0., 0.,", "cut off"),
    "word": ("800.", "eight", "camera_matrix data: expected a number, got 'eight'"),
    "shape": ("rows: 3\n   cols: 3", "rows: 1\n   cols: 9", r"expected 3 rows of 3 numbers, got shape \(1, 9\)"),
    "focal": ("800.", "-800.", "positive focal lengths"),
    "twice": ("image_width", "image_height", "line 4: the key `image_height` stands there twice"),
    "fisheye": ("---\n", "---\nfisheye_model: 1\n", "fisheye lenses are not supported"),
    "equidistant": ("---\n", '---\ndistortion_model: "equidistant"\n', "fisheye lenses are not supported"),
    "R without T": ("---\n", "---\nR: 3\n", r"T \(if it is in a file of its own"),
    "xml": ("%YAML:1.0", "<?xml version='1.0'?>", "this is XML. Save the calibration as .yml"),
    "json": ("%YAML:1.0", "{", "this is JSON"),
    "prose": ("%YAML:1.0", "Dear reader", "line 1: expected `key: value`"),
    "indent": ("---", "  a: 1", "line 2: text before the first key"),
    "size word": ("image_width: 640", "image_width: wide", "line 3, image_width: expected a number, got 'wide'"),
    "size negative": ("image_width: 640", "image_width: -640", "image_width: expected"),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_a_mistake_is_named_with_its_place(tmp_path, case):
    old, new, words = MISTAKES[case]
    assert old in YAML
    with pytest.raises(InputError, match=words) as caught:
        _read(tmp_path, YAML.replace(old, new, 1))
    assert str(tmp_path / "camera.yml") in str(caught.value)


def test_a_pair_without_its_extrinsics(tmp_path):
    with pytest.raises(InputError, match="R .if it is in a file of its own, give that as extrinsics. is missing"):
        _read(tmp_path, STEREO, image_size=(640, 480))


def test_what_no_file_can_hold_is_refused(tmp_path):
    wide = NamedCamera("b", camera_of_numbers(numbers_of(simple("b").camera), (1280, 720)))
    for cameras, words in [
        ([], "at least one"), ([simple(n) for n in "abc"], "one or two, got 3"), ([simple("a"), wide], "sizes differ"),
    ]:  # fmt: skip
        with pytest.raises(InputError, match=words):
            write_opencv_yaml(tmp_path / "x.yml", cameras)
    with jax.enable_x64(False), pytest.raises(InputError, match="needs 64-bit numbers"):
        _read(tmp_path, YAML)
