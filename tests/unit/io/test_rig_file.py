"""Rig files: what is written reads back exactly, and every mistake is named with its place."""

import locale
import math
import re
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from jaxmocap._errors import InputError
from jaxmocap.cameras import stack_cameras
from jaxmocap.io import NamedCamera, RigFile, read_rig, rig_text, write_rig
from jaxmocap.io.rig_file import table_names

sys.path.insert(0, str(Path(__file__).parent))
from io_samples import CAMERA, METADATA, camera_of_numbers, numbers_of, simple

finite = st.floats(allow_nan=False, allow_infinity=False, width=64)
positive = st.floats(min_value=1e-300, max_value=1e300)
names = st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=12)
plain_values = st.one_of(
    st.booleans(), st.integers(-(2**63), 2**63 - 1), finite, st.text(max_size=8), st.just([1, [2]])
)


# Plain numbers only: the cameras are built within the test, since beartype draws random numbers of its own.
camera_numbers = st.builds(
    lambda focal, rest: [*focal, *rest],
    st.lists(positive, min_size=2, max_size=2),
    st.lists(finite, min_size=14, max_size=14),
)
sizes = st.tuples(st.integers(1, 10**6), st.integers(1, 10**6))
given_camera = st.tuples(camera_numbers, sizes, st.dictionaries(names, st.floats(0, 1e300), max_size=3))
rest_of_rig = st.fixed_dictionaries(
    {
        "unit": st.sampled_from(["1", "mm", "m"]),
        "up": st.sampled_from(["", "x", "-x", "y", "-y", "z", "-z"]),
        "error": st.none() | st.floats(0, 1e300),
        "inputs": st.dictionaries(names, st.just("0f" * 32), max_size=2),
        "seed": st.none() | st.integers(0, 2**63 - 1),
        "settings": st.dictionaries(names, plain_values, max_size=2),
        "foreign_tables": st.dictionaries(names, st.dictionaries(names, plain_values, min_size=1), max_size=2),
    }
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("rigs")


@given(called=st.dictionaries(names, given_camera, min_size=1, max_size=3), rest=rest_of_rig)
def test_what_is_written_reads_back_exactly(folder, called, rest):
    rest = {**rest, "sigmas": {name: sigmas for name, (_, _, sigmas) in called.items() if sigmas}}
    cameras = tuple(NamedCamera(name, camera_of_numbers(numbers, size)) for name, (numbers, size, _) in called.items())
    write_rig(folder / "rig.toml", RigFile(cameras, **rest))
    back = read_rig(folder / "rig.toml")
    assert [(c.name, numbers_of(c.camera), c.camera.image_size) for c in back.cameras] == [
        (name, numbers, size) for name, (numbers, size, _) in called.items()
    ]
    assert {key: getattr(back, key) for key in rest} == rest


def _read(tmp_path, text):
    (tmp_path / "rig.toml").write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_rig(tmp_path / "rig.toml")


def test_a_written_file_by_hand(tmp_path):
    rig = RigFile(
        cameras=(simple("left", skew=0.25),),
        unit="mm",
        up="-y",
        error=0.5,
        sigmas={"left": {"fx": 1.5, "k3": math.inf}},
        inputs={"left 01.jpg": "ab" * 32},
        seed=7,
        settings={"robust": False},
    )
    said = write_rig(tmp_path / "rig.toml", rig)
    assert (
        (tmp_path / "rig.toml")
        .read_text()
        .startswith(
            '[cam_left]\nname = "left"\nsize = [640, 480]\n'
            "matrix = [[800.0, 0.25, 320.0], [0.0, 810.0, 240.0], [0.0, 0.0, 1.0]]\n"
            "distortions = [0.1, -0.2, 0.001, 0.002, 0.05]\n"
            "rotation = [0.1, -0.2, 0.3]\ntranslation = [0.0, 0.5, 2.0]\n"
            "fisheye = false\n\n[metadata]\n"
        )
    )
    metadata = tomllib.loads((tmp_path / "rig.toml").read_text())["metadata"]
    assert metadata.pop("jaxmocap")
    assert metadata == {
        "schema": 1, "unit": "mm", "up": "-y", "error": 0.5, "seed": 7, "skew": {"left": 0.25},
        "sigmas": {"left": {"fx": 1.5}}, "inputs": {"left 01.jpg": "ab" * 32}, "settings": {"robust": False},
    }  # fmt: skip
    assert len(said) == 2 and "skew of 0.25 px" in said[0] and "no finite sigma of k3" in said[1]


def test_same_rig_same_bytes_in_any_locale(tmp_path):
    text = rig_text(RigFile((simple("left"),), error=0.5))
    before = locale.setlocale(locale.LC_ALL)
    commas = [name for name in ("de_DE.UTF-8", "fr_FR.UTF-8") if _has_locale(name)]
    try:
        for name in commas or ["C"]:
            locale.setlocale(locale.LC_ALL, name)
            assert rig_text(RigFile((simple("left"),), error=0.5)) == text
            assert float(_read(tmp_path, text[0]).cameras[0].camera.intrinsics.fy) == 810.0
    finally:
        locale.setlocale(locale.LC_ALL, before)


def _has_locale(name):
    before = locale.setlocale(locale.LC_ALL)
    try:
        locale.setlocale(locale.LC_ALL, name)
    except locale.Error:
        return False
    locale.setlocale(locale.LC_ALL, before)
    return True


@pytest.mark.parametrize(
    ("called", "tables"),
    [
        (["left", "right"], ["cam_left", "cam_right"]),
        (["cam1", "cam2"], ["cam_1", "cam_2"]),
        (["cam_0", "cam_1"], ["cam_0", "cam_1"]),
        (["0", "1"], ["cam_0", "cam_1"]),
        (["cam1", "cam10"], ["cam_01", "cam_10"]),
        (["cam_front", "camera7"], ["cam_front", "cam_camera7"]),
        (["cam1", "01"], ["cam_1", "cam_2"]),
        (['"a', "'b'", "ü 1.x", "]"], ["cam__a", "cam_'b'", "cam_ü 1.x", "cam_]"]),
        (["metadata"], ["cam_metadata"]),
    ],
)
def test_tables_are_called_as_other_programs_expect(called, tables):
    assert table_names(called) == tables


def test_twelve_numbered_cameras_sort_as_text():
    tables = table_names([f"cam{i}" for i in range(1, 13)])
    assert tables == sorted(tables) and tables[0] == "cam_01"


def test_a_plain_file(tmp_path):
    rig = _read(tmp_path, CAMERA + METADATA)
    expected = [800, 810, 320, 240, 0, 0.1, -0.2, 0.001, 0.002, 0.05, 0.1, 0.2, 0.3, 1, 2, 3]
    assert numbers_of(rig.cameras[0].camera) == expected
    assert (rig.cameras[0].name, rig.cameras[0].camera.image_size, rig.unit) == ("left", (640, 480), "mm")
    assert rig.warnings == ()


@pytest.mark.parametrize("change", [lambda t: "\ufeff" + t, lambda t: t.replace("\n", "\r\n")], ids=["BOM", "CRLF"])
def test_marks_and_line_ends_of_other_systems(tmp_path, change):
    assert _read(tmp_path, change(CAMERA + METADATA)).cameras[0].name == "left"


@pytest.mark.parametrize("head", ["[cam_0]", "[cameras.0]", "[demo]", '["cam 0"]', "[int_cam1_img]"])
def test_any_table_with_a_matrix_is_a_camera(tmp_path, head):
    rig = _read(tmp_path, CAMERA.replace("[cam_left]", head).replace('name = "left"\n', "") + METADATA)
    assert rig.cameras[0].name == head.strip('[]"').split(".")[-1]


@pytest.mark.parametrize("angle", [0.0, 1e-8, 1.0, math.pi])
def test_rotation_matrices_are_read(tmp_path, angle):
    R = Rotation.from_rotvec(angle * np.array([2, -1, 2]) / 3)
    rig = _read(tmp_path, CAMERA.replace("[0.1, 0.2, 0.3]", str(R.as_matrix().tolist())) + METADATA)
    back = Rotation.from_rotvec(np.array(rig.cameras[0].camera.T_camera_world.rotvec))
    assert (back * R.inv()).magnitude() < 1e-15


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("[0.1, -0.2, 0.01, 0.02]", [0.1, -0.2, 0.01, 0.02, 0]),
        ("[0.1, -0.2]", [0.1, -0.2, 0, 0, 0]),
        ("[[0.1, -0.2, 0.01, 0.02, 0.3]]", [0.1, -0.2, 0.01, 0.02, 0.3]),
        ("[0.1, -0.2, 0.01, 0.02, 0.3, 0, 0, 0]", [0.1, -0.2, 0.01, 0.02, 0.3]),
        ("[0, 0, 0, 0]", [0, 0, 0, 0, 0]),
    ],
)
def test_lengths_of_distortions(tmp_path, given, expected):
    rig = _read(tmp_path, CAMERA.replace("[0.1, -0.2, 0.001, 0.002, 0.05]", given) + METADATA)
    assert numbers_of(rig.cameras[0].camera)[5:10] == expected
    assert bool(rig.warnings) == (given == "[0.1, -0.2]")


MISTAKES = {
    "size missing": ("size = [640, 480]\n", "", r"\[cam_left\]: `size` is missing"),
    "size misspelt": ("size =", "sizes =", "`size` is missing. Is `sizes` a misspelling"),
    "size negative": ("[640, 480]", "[640, -480]", r"\[cam_left\] size: expected \[width, height\]"),
    "size fraction": ("[640, 480]", "[640.5, 480]", "size: expected"),
    "size huge": ("[640, 480]", "[640, 1e30]", "size: expected"),
    "size text": ("[640, 480]", '"640x480"', "size: expected numbers, got '640x480'"),
    "matrix missing": ("matrix = ", "matrx = ", "`matrix` is missing. Is `matrx`"),
    "matrix text": ("[[800.0, 0.0, 320.0], [0.0, 810.0, 240.0], [0.0, 0.0, 1.0]]", '"null"', "camera calibrated"),
    "matrix ragged": ("[[800.0, 0.0, 320.0]", "[[800.0, 320.0]", "matrix: expected numbers, or rows of equally many"),
    "matrix 2x3": (", [0.0, 0.0, 1.0]]", "]", "matrix: expected 3 rows of 3"),
    "matrix deep": ("800.0,", "[[[[[[800.0]]]]]],", "matrix: expected numbers, or rows"),
    "matrix nan": ("800.0", "nan", r"\[cam_left\] matrix: holds nan"),
    "matrix inf": ("320.0", "-inf", "matrix: holds -inf"),
    "matrix bool": ("320.0", "true", "matrix: expected numbers, got True"),
    "matrix huge": ("320.0", "0x" + "f" * 5000, "matrix: holds a very large int"),
    "fx negative": ("800.0", "-800.0", "positive focal lengths, got fx = -800"),
    "fy zero": ("810.0", "0.0", "positive focal lengths"),
    "transposed": ("320.0], [0.0, 810.0, 240.0], [0.0, 0.0,", "0.0], [0.0, 810.0, 0.0], [320.0, 240.0,", "transposed"),
    "scaled": ("0.0, 1.0]]", "0.0, 2.0]]", r"K\[2\]\[2\] = 1, got 2"),
    "distortions missing": ("distortions", "distortion", "`distortions` is missing. Is `distortion`"),
    "distortions 3": ("0.001, 0.002, 0.05]", "0.001]", r"distortions: expected 5 numbers .* got 3"),
    "rational": ("0.05]", "0.05, 0.1, 0.2, 0.3]", "rational"),
    "fisheye": ("size =", "fisheye = true\nsize =", "fisheye = true: fisheye lenses are not supported"),
    "fisheye text": ("size =", 'fisheye = "no"\nsize =', "fisheye: expected true or false, got str"),
    "rotation missing": ("rotation = [0.1, 0.2, 0.3]\n", "", "`rotation` is missing"),
    "quaternion": ("[0.1, 0.2, 0.3]", "[0, 0, 0, 1]", "quaternion"),
    "mirror": ("[0.1, 0.2, 0.3]", "[[1, 0, 0], [0, 1, 0], [0, 0, -1]]", "rotation: the matrix mirrors"),
    "no rotation": ("[0.1, 0.2, 0.3]", "[[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]", "no rotation matrix"),
    "rotation 1e300": ("[0.1, 0.2, 0.3]", "[[1e300, 0, 0], [0, 1, 0], [0, 0, 1]]", "no rotation matrix"),
    "translation 2": ("[1.0, 2.0, 3.0]", "[1.0, 2.0]", "translation: expected 3 numbers"),
    "name number": ('"left"', "1", "name: expected text in quotes, got int"),
    "name empty": ('"left"', '""', "empty name"),
    "duplicate key": ("size = [640, 480]\n", "size = [640, 480]\n" * 2, r"line 4.* stands there twice"),
    "duplicate table": ("[metadata]", "[cam_left]", "twice"),
    "not toml": ("size = ", "size ", r"not valid TOML.*\(at line 3, column 6\)"),
    "metadata misspelt": ("unit =", "units =", r"\[metadata\]: unknown key `units`; did you mean `unit`"),
    "metadata case": ("unit =", "Unit =", "did you mean `unit`"),
    "metadata text": ("[metadata]\n", "metadata = 3\n[other]\n", None),
    "unit number": ('"mm"', "3", r"\[metadata\] unit: expected text in quotes, got int"),
    "up": ('unit = "mm"', 'up = "down"', r"\[metadata\] up: expected one of"),
    "error text": ('unit = "mm"', 'error = "0.5"', r"\[metadata\] error: expected a number, got str"),
    "error nan": ('unit = "mm"', "error = nan", "error: expected a number that is not negative"),
    "seed": ('unit = "mm"', "seed = 1.5", "seed: expected a whole number"),
    "schema": ('unit = "mm"', "schema = 2", "written by a newer jaxmocap"),
    "schema huge": ('unit = "mm"', "schema = 0x" + "f" * 5000, "written by a newer jaxmocap"),
    "sigmas": ('unit = "mm"', "sigmas = {left = 3}", r"\[metadata.sigmas\] left: expected a table"),
    "sigma": ('unit = "mm"', "sigmas = {left = {fx = -1}}", r"\[metadata.sigmas.left\] fx: expected a number"),
    "hash": ('unit = "mm"', 'inputs = {"a.jpg" = "xyz"}', r"\[metadata.inputs\] a.jpg"),
    "no camera": (CAMERA, "[board]\nsize = 3\n", r"no table holds a camera `matrix` \(found: board\)"),
    "two of a name": (CAMERA, CAMERA + CAMERA.replace("[cam_left]", "[cam_2]"), "2 are called 'left'"),
    "deep": ("size =", "deep = " + "[" * 5000 + "]" * 5000 + "\nsize =", "nested too deeply"),
}  # fmt: skip


@pytest.mark.parametrize("case", [case for case in MISTAKES if MISTAKES[case][2]])
def test_a_mistake_is_named_with_its_place(tmp_path, case):
    old, new, words = MISTAKES[case]
    text = CAMERA + METADATA
    assert old in text
    with pytest.raises(InputError, match=words) as caught:
        _read(tmp_path, text.replace(old, new, 1))
    assert str(tmp_path / "rig.toml") in str(caught.value)


def test_metadata_that_is_no_table(tmp_path):
    with pytest.raises(InputError, match=r"expected a table \[metadata\], got int"):
        _read(tmp_path, "metadata = 3\n" + CAMERA)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "is empty"),
        (b"  \n\n", "is empty"),
        (CAMERA.encode("utf-16"), "UTF-16"),
        (b"\x89PNG\r\n\0\0", "not a text file"),
        (CAMERA.replace("left", "gr\xfcn").encode("latin-1"), "line 1: byte 0xfc is not UTF-8"),
    ],
)
def test_files_that_are_something_else(tmp_path, data, words):
    with pytest.raises(InputError, match=words):
        _read(tmp_path, data)


def test_files_that_cannot_be_read(tmp_path):
    (tmp_path / "rig.toml").write_text(CAMERA)
    with pytest.raises(InputError, match="no such file. Did you mean 'rig.toml'"):
        read_rig(tmp_path / "rigs.toml")
    with pytest.raises(InputError, match="Its folder .* does not exist either"):
        read_rig(tmp_path / "nowhere" / "rig.toml")
    with pytest.raises(InputError, match="this is a folder"):
        read_rig(tmp_path)
    with pytest.raises(InputError, match="cannot be read"):
        read_rig("rig\0.toml")
    with pytest.raises(InputError, match="larger than 8 MiB"):
        read_rig("/dev/zero")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("320.0", "2000.0", "principal point .* is off the 640x480 sensor"),
        ("[0.1, 0.2, 0.3]", "[90.0, 0.0, 0.0]", "degrees"),
        ("[0.1, 0.2, 0.3]", "[[1.0, 0.00001, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]", "rounded"),
        (
            "rotation = [0.1, 0.2, 0.3]\ntranslation = [1.0, 2.0, 3.0]\n",
            "",
            "own frame is taken as the world",
        ),
        ('unit = "mm"', "", "unit of lengths is not given"),
        ('unit = "mm"', 'unit = "mm"\nadjusted = false', "another program are kept: adjusted"),
        ("size =", "exposure = -7\nsize =", "another program are kept: exposure"),
        ('unit = "mm"', "sigmas = {right = {fx = 1.0}}", "no camera is called so"),
        ("[metadata]", "[charuco]\nrows = 4\n[metadata]", "no cameras are kept: charuco"),
    ],
)
def test_what_is_odd_is_said(tmp_path, old, new, words):
    rig = _read(tmp_path, (CAMERA + METADATA).replace(old, new, 1))
    assert [w for w in rig.warnings if re.search(words, w)], rig.warnings


def test_two_cameras_need_their_places(tmp_path):
    second = "[cam_2]\n" + CAMERA.split("\n", 2)[2].replace(
        "rotation = [0.1, 0.2, 0.3]\ntranslation = [1.0, 2.0, 3.0]\n", ""
    )
    with pytest.raises(InputError, match=r"\[cam_2\]: `rotation` is missing"):
        _read(tmp_path, CAMERA + second)


def test_foreign_keys_survive_and_are_no_cameras(tmp_path):
    foreign = "exposure = -7\nnotes = {lens = 'wide'}\n"
    rig = _read(tmp_path, CAMERA + foreign + METADATA + "adjusted = false\n[charuco]\nrows = 4\nsizes = [[1, 2]]\n")
    write_rig(tmp_path / "again.toml", rig)
    document = tomllib.loads((tmp_path / "again.toml").read_text())
    assert document.keys() == {"cam_left", "metadata"}
    assert document["cam_left"]["exposure"] == -7 and document["cam_left"]["notes"] == {"lens": "wide"}
    assert document["metadata"]["adjusted"] is False
    again = read_rig(tmp_path / "again.toml")
    assert again.foreign_tables == {"charuco": {"rows": 4, "sizes": [[1, 2]]}}
    assert again.cameras[0].foreign == {"exposure": -7, "notes": {"lens": "wide"}}


def test_what_no_file_can_hold_is_refused(tmp_path):
    left = simple("left")
    stacked = NamedCamera("rig", stack_cameras([left.camera, left.camera]))
    lost = NamedCamera("left", jax.tree.map(lambda x: x * math.nan, left.camera))
    for cameras_, words in [
        ((), "at least one"),
        ((left, left), "2 are called"),
        ((stacked,), "stacked"),
        ((lost,), "nan"),
    ]:
        with pytest.raises(InputError, match=words):
            write_rig(tmp_path / "rig.toml", RigFile(cameras_))
    for change, words in [
        ({"up": "down"}, "up: expected"), ({"unit": ""}, "unit: expected"), ({"error": math.nan}, "error: expected"),
        ({"sigmas": {"right": {"fx": 1.0}}}, "no camera is called 'right'"),
        ({"settings": {"x": object()}}, "TOML cannot store"), ({"settings": {"x": None}}, "TOML cannot store"),
    ]:  # fmt: skip
        with pytest.raises(InputError, match=words):
            write_rig(tmp_path / "rig.toml", replace(RigFile((left,)), **change))
    assert list(tmp_path.iterdir()) == []


def test_single_precision_is_refused(tmp_path):
    (tmp_path / "rig.toml").write_text(CAMERA)
    with jax.enable_x64(False), pytest.raises(InputError, match="needs 64-bit numbers"):
        read_rig(tmp_path / "rig.toml")
