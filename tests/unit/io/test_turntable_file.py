"""Turntable files: what is written reads back exactly, and every mistake is named."""

from dataclasses import replace

import numpy as np
import pytest

from jaxmocap._errors import InputError
from jaxmocap.io import TurntableFile, read_turntable, write_turntable

_A = np.random.default_rng(0).normal(size=(4, 4))
WHOLE = TurntableFile(
    rotation=(np.pi, 0.0, 0.0),
    distance=400.0,
    height=80.0,
    unit="mm",
    covariance=_A @ _A.T + np.eye(4),
    axis={"point": (0.0, 0.0, 400.0), "direction": (0.0, -1.0, 0.0), "sigma_point": (0.1, 0.2, 0.3)},
    angles_deg={"a_000.jpg": 0.0, 'strange "name"_030.jpg': 30.0 + 1e-13},
    sigma_angles_deg={"a_000.jpg": 0.0, 'strange "name"_030.jpg': 0.05},
    error=0.125,
    held=("height", "zero angle"),
    inputs={"a_000.jpg": "0" * 64},
    settings={"board": "9x6"},
)
SMALLEST = "rotation = [3.141592653589793, 0, 0]\ndistance = 400\nheight = 80\n"


def test_what_is_written_reads_back_exactly(tmp_path):
    path = tmp_path / "turntable.toml"
    write_turntable(path, WHOLE)
    again = read_turntable(path)
    np.testing.assert_array_equal(again.covariance, 0.5 * (WHOLE.covariance + WHOLE.covariance.T))
    assert again.version
    assert replace(again, covariance=None, version="") == replace(WHOLE, covariance=None)


def test_a_file_written_by_hand_needs_little(tmp_path):
    path = tmp_path / "turntable.toml"
    path.write_text(SMALLEST + '[metadata]\nunit = "mm"\n')
    table = read_turntable(path)
    assert (table.distance, table.height, table.unit, table.covariance) == (400.0, 80.0, "mm", None)


@pytest.mark.parametrize(
    "text, said",
    [
        (SMALLEST.replace("distance", "distnace"), "distance"),
        (SMALLEST.replace("height = 80\n", ""), "`height` is missing"),
        (SMALLEST.replace("400", "-400"), "positive"),
        (SMALLEST.replace("400", "nan"), "positive"),
        (SMALLEST.replace("80", "true"), "a number"),
        (SMALLEST.replace("3.141592653589793", "180"), "degrees"),
        (SMALLEST.replace("[3.141592653589793, 0, 0]", "[1, 2]"), "three numbers"),
        (SMALLEST + "[axis]\npoint = [0, 0, 300]\n", "[axis] point"),
        (SMALLEST + "[axis]\ndirection = [0, 1, 0]\n", "[axis] direction"),
        (SMALLEST + "covariance = [[1]]\n", "4 rows"),
        (SMALLEST + f"covariance = {np.diag([1.0, 1, -1, 1]).tolist()}\n", "positive diagonal"),
        (SMALLEST + f"covariance = {(np.eye(4) * 0.1 + 2).tolist()[:3] + [[2, 2, 9, 2.1]]}\n", "symmetric"),
        (SMALLEST + f"covariance = {(np.full((4, 4), 2.0) - np.eye(4)).tolist()}\n", "no covariance"),
        (SMALLEST + "[metadata]\nschema = 99\n", "Upgrade"),
        (SMALLEST + "[metadata]\nunits = 'mm'\n", "did you mean `unit`"),
        (SMALLEST + "[metadata.inputs]\n'a.jpg' = 'abc'\n", "SHA-256"),
        (SMALLEST + "distance = 400\n", "not valid TOML"),
        ("", "empty"),
    ],
)
def test_every_mistake_is_named(tmp_path, text, said):
    path = tmp_path / "turntable.toml"
    path.write_text(text)
    with pytest.raises(InputError, match="turntable.toml") as error:
        read_turntable(path)
    assert said in str(error.value)


@pytest.mark.parametrize("wrong", [{"distance": float("nan")}, {"distance": -1.0}, {"rotation": (400.0, 0.0, 0.0)}])
def test_what_could_not_be_read_is_not_written(tmp_path, wrong):
    path = tmp_path / "turntable.toml"
    path.write_text("old")
    with pytest.raises(InputError):
        write_turntable(path, replace(WHOLE, axis={}, **wrong))
    assert path.read_text() == "old"
