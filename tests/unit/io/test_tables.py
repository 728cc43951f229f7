"""Tables: exact both ways, and every mistake named with line and column."""

import csv
import math

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxmocap._errors import InputError
from jaxmocap.io import read_correspondences, read_observations, table_text, write_table

finite = st.floats(allow_nan=False, allow_infinity=False, width=64)
GOOD = "view,x,y,z,u,v,sigma,camera\n7,1,2,3,10.5,20.25,0.1,left\n7,1,2,4,-1e1,+.5,2,right\n3,0,0,0,1.,2,1,left\n"


def _read(tmp_path, text, reader=read_correspondences):
    (tmp_path / "points.csv").write_bytes(text if isinstance(text, bytes) else text.encode())
    return reader(tmp_path / "points.csv")


def test_a_table_by_hand(tmp_path):
    table = _read(tmp_path, GOOD)
    assert table.view.tolist() == [0, 0, 1] and table.view_labels == ("7", "3")
    assert table.xyz.tolist() == [[1, 2, 3], [1, 2, 4], [0, 0, 0]]
    assert table.uv.tolist() == [[10.5, 20.25], [-10, 0.5], [1, 2]]
    assert table.sigma.tolist() == [0.1, 2, 1]
    assert table.camera.tolist() == [0, 1, 0] and table.camera_labels == ("left", "right")
    assert table.warnings == ()


@pytest.mark.parametrize(
    "change",
    [
        lambda t: t.replace("\n", "\r\n"),
        lambda t: t.replace("\n", "\r"),
        lambda t: "\ufeff" + t,
        lambda t: t.rstrip("\n"),
        lambda t: t.replace("\n", "\n\n") + "\n\n,,,,,,,\n",
        lambda t: t.replace(",", " , "),
        lambda t: t.replace("left", '"left"'),
    ],
)
def test_harmless_variants(tmp_path, change):
    assert _read(tmp_path, change(GOOD)).uv.tolist() == [[10.5, 20.25], [-10, 0.5], [1, 2]]


def test_columns_in_another_order_and_more_of_them(tmp_path):
    table = _read(tmp_path, "v,u,z,y,x,view,name\n2,1,5,4,3,photo 1.jpg,corner\n")
    assert (table.uv.tolist(), table.xyz.tolist(), table.view_labels) == ([[1, 2]], [[3, 4, 5]], ("photo 1.jpg",))
    assert table.sigma is None and table.camera is None and table.camera_labels == ()
    assert len(table.warnings) == 1 and "left out: 'name'" in table.warnings[0]


def test_observations_by_hand(tmp_path):
    text = "frame,camera,marker,u,v\n3,cam2,tip,1,2\n3,cam2,,3,4\n0,cam1,root,5,6\n"
    table = _read(tmp_path, text, read_observations)
    assert table.frame.tolist() == [3, 3, 0]
    assert table.camera.tolist() == [0, 0, 1] and table.camera_labels == ("cam2", "cam1")
    assert table.marker.tolist() == [0, -1, 1] and table.marker_labels == ("tip", "root")
    assert table.uv.tolist() == [[1, 2], [3, 4], [5, 6]] and table.sigma is None


HEAD = "view,x,y,z,u,v\n"
MISTAKES = {
    "semicolons": ("view;x;y;z;u;v\n1;0;0;0;1,5;2\n", "line 1: columns are separated by semicolons"),
    "tabs": ("view\tx\ty\tz\tu\tv\n", "separated by tabs"),
    "decimal comma": (HEAD + '1,0,0,0,"1,5",2\n', "line 2, column 'u': '1,5' has a decimal comma"),
    "decimal commas": (
        HEAD + "1,0,0,0,1,5,2,5\n",
        "line 2: expected 6 cells as in the header, got 8. Are there decimal",
    ),
    "short row": (
        HEAD + "1,0,0,0,1,2\n1,0,0\n",
        "line 3: expected 6 cells as in the header, got 3. Is the row cut off",
    ),
    "no header": ("1,0,0,0,1,2\n1,0,0,0,1,2\n", "line 1: the first row holds numbers, so the header is missing"),
    "column twice": ("view,x,y,z,u,u\n1,0,0,0,1,2\n", "column 'u' stands in the header twice"),
    "column missing": (
        "view,x,y,u,v\n1,0,0,1,2\n",
        r"missing columns: z. Expected the header view,x,y,z,u,v\[,sigma\]",
    ),
    "column misspelt": ("veiw,x,y,z,u,v\n", "unknown column 'veiw'; did you mean 'view'"),
    "column case": ("View,x,y,z,u,v\n", "unknown column 'View'; did you mean 'view'"),
    "option misspelt": ("view,x,y,z,u,v,sigmas\n", "unknown column 'sigmas'; did you mean 'sigma'"),
    "nan": (HEAD + "1,0,0,0,1,NaN\n", "line 2, column 'v': 'NaN' is no measurement"),
    "inf": (HEAD + "1,0,0,-inf,1,2\n", "line 2, column 'z': '-inf' is no measurement"),
    "huge": (HEAD + "1,0,0,0,1e999,2\n", "line 2, column 'u': expected a number that a computer can hold"),
    "blank": (HEAD + "1,0,0,0,,2\n", "line 2, column 'u': is blank; leave the whole row out"),
    "blank view": (HEAD + ",0,0,0,1,2\n", "line 2, column 'view': is blank"),
    "word": (HEAD + "\n1,0,0,0,1,left\n", "line 3, column 'v': expected a number, got 'left'"),
    "underscore": (HEAD + "1,0,0,0,1_0,2\n", "expected a number, got '1_0'"),
    "other digits": (HEAD + "1,0,0,0,\u0661,2\n", "expected a number"),
    "sigma": (GOOD.replace("0.1,left", "0,left"), "line 2, column 'sigma': expected a positive"),
    "quote": (HEAD + '1,0,0,0,1,"2"2\n', "line 2: not valid CSV"),
    "open quote": (HEAD + '1,0,0,0,1,"2\n', "not valid CSV"),
    "no rows": (HEAD, "a header but no rows"),
    "empty": ("", "is empty"),
    "only commas": (",,,\n,,,\n", "missing columns: view, x, y, z, u, v"),
    "binary": ("view\0", "zero bytes"),
    "latin-1": (HEAD.encode() + b"gr\xfcn,0,0,0,1,2\n", "line 2: byte 0xfc is not UTF-8"),
    "long cell": (HEAD + "1,0,0,0,1," + "9" * 200_000 + "\n", "line 2: not valid CSV .field larger"),
    "long number": (HEAD + "1,0,0,0,1," + "9" * 100_000 + "x\n", "line 2, column 'v': expected a number, got '999"),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_a_mistake_is_named_with_its_place(tmp_path, case):
    text, words = MISTAKES[case]
    with pytest.raises(InputError, match=words) as caught:
        _read(tmp_path, text)
    assert str(tmp_path / "points.csv") in str(caught.value)


@pytest.mark.parametrize("frame", ["-1", "1.5", "", "1e3", "99999999999999999", "frame"])
def test_frames_are_whole_numbers(tmp_path, frame):
    with pytest.raises(InputError, match="line 2, column 'frame': expected a whole number from 0"):
        _read(tmp_path, f"frame,camera,marker,u,v\n{frame},a,,1,2\n", read_observations)


def test_a_file_too_large(monkeypatch):
    monkeypatch.setattr("jaxmocap.io.csv_text._MAX_BYTES", 3 << 20)
    with pytest.raises(InputError, match="larger than 3 MiB"):
        read_correspondences("/dev/zero")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("tables")


labels = st.text(st.characters(exclude_categories=["Cs", "Cc", "Z"]), min_size=1, max_size=8)
row = st.tuples(labels, st.lists(finite, min_size=5, max_size=5), st.floats(1e-300, 1e300), labels)


@given(rows=st.lists(row, min_size=1, max_size=6))
def test_what_is_written_reads_back_exactly(folder, rows):
    view, numbers, sigma, camera = zip(*rows)
    columns = dict(zip(("x", "y", "z", "u", "v"), np.array(numbers).T))
    write_table(folder / "t.csv", {"view": view, **columns, "sigma": list(sigma), "camera": camera})
    back = read_correspondences(folder / "t.csv")
    assert [back.view_labels[i] for i in back.view] == list(view)
    assert [back.camera_labels[i] for i in back.camera] == list(camera)
    assert np.hstack([back.xyz, back.uv]).tolist() == [list(n) for n in numbers]
    assert back.sigma.tolist() == list(sigma)


def test_cells_of_every_kind(tmp_path):
    columns = {
        "frame": jnp.arange(2), "name": ["a,b", 'say "x"\nnow'], "u": np.array([0.1, math.nan]),
        "v": [math.inf, np.float32(0.5)], "w": jnp.array([1.0, -0.0]), "ok": np.array([True, False]), "n": [None, 3],
    }  # fmt: skip
    text = table_text(columns)
    assert text.splitlines()[0] == "frame,name,u,v,w,ok,n"
    write_table(tmp_path / "t.csv", columns)
    with open(tmp_path / "t.csv", newline="") as file:
        rows = list(csv.reader(file))
    assert rows[1:] == [["0", "a,b", "0.1", "", "1.0", "1", ""], ["1", 'say "x"\nnow', "", "0.5", "-0.0", "0", "3"]]


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({}, "at least one"),
        ({"a": [1], "b": [1, 2]}, "expected one length"),
        ({"xy": np.zeros((2, 2))}, r"column 'xy': expected one value per row, got shape \(2, 2\)"),
        ({"a": [object()]}, "column 'a': object has no place"),
        ({"a": [[1, 2]]}, "column 'a': list has no place"),
    ],
)
def test_what_is_no_table_is_refused(tmp_path, columns, words):
    with pytest.raises(InputError, match=words):
        write_table(tmp_path / "t.csv", columns)
    assert list(tmp_path.iterdir()) == []
