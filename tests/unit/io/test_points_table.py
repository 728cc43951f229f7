"""The table of points: there and back, and every mistake by name."""

import math

import numpy as np
import pytest

from jaxmocap._errors import InputError
from jaxmocap.io import read_points, write_points
from jaxmocap.io.points_table import points_text

HEADER = "frame,marker,x,y,z,sigma_x,sigma_y,sigma_z,views\n"


def test_there_and_back(tmp_path):
    rng = np.random.default_rng(0)
    xyz, sigma = rng.normal(size=(4, 3)) * 100, rng.uniform(0.01, 1, size=(4, 3))
    sigma[1, 2] = math.inf
    names = ["head.1", 'a "b", c', "head.1", 'a "b", c']
    said = write_points(tmp_path / "p.csv", np.array([0, 0, 7, 7]), names, xyz, sigma, np.array([12, 3, 2, 5]))
    assert said.endswith("4 points, 2 markers in 2 frames.")
    assert (tmp_path / "p.csv").read_text().startswith(HEADER)
    points = read_points(tmp_path / "p.csv")
    np.testing.assert_array_equal(points.xyz, xyz)
    sigma[1, 2] = math.nan
    np.testing.assert_array_equal(points.sigma, sigma)
    np.testing.assert_array_equal(points.frame, [0, 0, 7, 7])
    np.testing.assert_array_equal(points.marker, [0, 1, 0, 1])
    np.testing.assert_array_equal(points.views, [12, 3, 2, 5])
    assert points.marker_labels == ("head.1", 'a "b", c') and points.warnings == ()


def test_what_was_not_seen_has_no_row(tmp_path):
    xyz = np.array([[1.0, 2, 3], [math.nan, 2, 3], [4, 5, math.inf]])
    text, said = points_text(np.arange(3), ["a", "b", "c"], xyz)
    assert text.splitlines()[1:] == ["0,a,1.0,2.0,3.0,,,"]
    assert said == "1 points, 1 markers in 1 frames, 2 not seen and left out."


def test_rows_as_frames(tmp_path):
    (tmp_path / "p.csv").write_text("marker,frame,x,y,z,colour\nb,5,1,2,3,red\na,2,4,5,6,blue\nb,2,7,8,9,red\n")
    points = read_points(tmp_path / "p.csv")
    assert points.marker_labels == ("b", "a") and points.views is None and np.isnan(points.sigma).all()
    assert "'colour'" in points.warnings[0]
    numbers, xyz, _ = points.by_frame()
    np.testing.assert_array_equal(numbers, [2, 5])
    np.testing.assert_array_equal(xyz, [[[7, 8, 9], [4, 5, 6]], [[1, 2, 3], [math.nan] * 3]])


@pytest.mark.parametrize(
    ("rows", "sentence"),
    [
        ("0,a,1,2,3,0.1,0.1,0.1,2\n0,a,1,2,3,0.1,0.1,0.1,2\n", "'a' stands twice in frame 0"),
        ("0,,1,2,3,0.1,0.1,0.1,2\n", "line 2, column 'marker': is blank"),
        ("0,a,,2,3,0.1,0.1,0.1,2\n", "line 2, column 'x': is blank; leave the whole row out"),
        ("0,a,nan,2,3,0.1,0.1,0.1,2\n", "column 'x': 'nan' is no measurement"),
        ("-1,a,1,2,3,0.1,0.1,0.1,2\n", "column 'frame': expected a whole number from 0"),
        ("0,a,1,2,3,-0.1,0.1,0.1,2\n", "column 'sigma_x': expected a standard deviation from 0"),
        ("0,a,1,2,3,0.1,1e999,0.1,2\n", "column 'sigma_y'"),
        ("0,a,1,2,3,0.1,0.1,0.1,\n", "column 'views'"),
    ],
)
def test_mistakes_are_named(tmp_path, rows, sentence):
    (tmp_path / "p.csv").write_text(HEADER + rows)
    with pytest.raises(InputError, match=sentence):
        read_points(tmp_path / "p.csv")


def test_arguments_of_different_length_are_refused():
    with pytest.raises(InputError, match="expected 2 rows as in frame"):
        points_text(np.arange(2), ["a"], np.zeros((2, 3)))
