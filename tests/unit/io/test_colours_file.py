import tomllib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxmocap._errors import InputError
from jaxmocap.bodies.puppet import DOCUMENT_COLOURS, MARKERS
from jaxmocap.io import ColoursFile, colours_text, read_colours, write_colours
from jaxmocap.tracking import BeadColours, learn_colours


def write(tmp_path, text):
    path = tmp_path / "colours.toml"
    path.write_text(text)
    return path


@given(st.integers(0, 2**32 - 1))
def test_what_is_written_reads_back(tmp_path_factory, seed):
    rng = np.random.default_rng(seed)
    learnt = learn_colours(MARKERS, [rng.uniform(0, 1, (rng.integers(1, 9), 3)) for _ in MARKERS])
    path = tmp_path_factory.mktemp("c") / "colours.toml"
    write_colours(path, ColoursFile(learnt, {"a.jpg": "0" * 64}, {"gate": 1.5}))
    back = read_colours(path)
    assert back.colours.names == MARKERS and back.warnings == ()
    for name in ("hsb", "sd", "covariance", "n"):
        assert (getattr(back.colours, name) == getattr(learnt, name)).all()
    assert back.inputs == {"a.jpg": "0" * 64} and back.settings == {"gate": 1.5}


def test_other_programs_find_what_the_interface_names():
    table = tomllib.loads(colours_text(ColoursFile(BeadColours.of(DOCUMENT_COLOURS))))["colours"]
    entry = table["leg.R3"]
    assert (entry["h"], entry["s"], entry["b"]) == (0.554, 0.431, 0.790) and entry["n"] == 0 and len(entry["sd"]) == 3


def test_by_hand_with_and_without_quotes(tmp_path):
    second = '"arm.L2" = {h = 0, s = 0.5, b = 0.5, sd = [0.01, 0.02, 0.1]}'
    path = write(tmp_path, f"[colours]\nhead.1 = {{h = 0.5, s = 0.2, b = 1}}\n{second}\n")
    found = read_colours(path)
    assert found.colours.names == ("head.1", "arm.L2") and found.colours.hsb[0].tolist() == [0.5, 0.2, 1.0]
    # across hue 0 is the second axis: 2 pi 0.5 0.01
    assert np.allclose(np.sqrt(np.diag(found.colours.covariance[1])), [0.02, np.pi * 0.01, 0.1])
    assert "no colour of head.2" in found.warnings[0]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "empty"),
        ("[colors]\nx = 1", "unknown table or key `colors`; did you mean `colours`"),
        ("[colours]", "missing or empty"),
        ("[colours]\nx y", "not valid TOML"),
        ('[colours]\n"head.3" = {h = 0, s = 0, b = 0}', "unknown bead `head.3`; did you mean `head."),
        ('[colours]\n"head.1" = {h = 180, s = 0, b = 0}', "expected a number from 0 to 1, got 180. Hue is in turns"),
        ('[colours]\n"head.1" = {h = nan, s = 0, b = 0}', "head.1 h: expected a number from 0 to 1"),
        ('[colours]\n"head.1" = {h = true, s = 0, b = 0}', "head.1 h: expected a number, got bool"),
        ('[colours]\n"head.1" = {h = 0, s = 0}', "head.1: `b` is missing"),
        ('[colours]\n"head.1" = {h = 0, s = 0, b = 0, covarience = []}', "`covarience`; did you mean `covariance`"),
        ('[colours]\n"head.1" = {h = 0, s = 0, b = 0, sd = [1, 2]}', "sd: expected a list of 3 numbers, got 2"),
        ('[colours]\n"head.1" = {h = 0, s = 0, b = 0, sd = [0, -1, 0]}', "sd: expected a number from 0 to 1"),
        ('[colours]\n"head.1" = {h = 0, s = 0, b = 0, n = -1}', "n: expected a number of photographs"),
        ('[colours]\n"head.1" = {h = 0, s = 0, b = 0, covariance = [1, 1, 1, 0, 0, 1]}', "positive definite"),
        (
            '[colours]\n"head.1" = {h = 0, s = 0.5, b = 0, sd = [0.1, 0.1, 0.1], covariance = [1, 0, 1, 0, 0, 0.04]}',
            "sd and covariance do not agree",
        ),
        ('[colours]\n"head.1" = 3', "head.1: expected { h"),
        ('[colours]\n"head.1" = {h = 0, s = 0, b = 0}\nhead.1 = {h = 0, s = 0, b = 0}', "twice"),
        ('[colours]\n"head.1" = {h = 0, s = 0, b = 0}\n[metadata]\nschema = 2', "newer jaxmocap"),
        ('[colours]\n"head.1" = {h = 0, s = 0, b = 0}\n[metadata]\nsetings = 2', "did you mean `settings`"),
    ],
)  # fmt: skip
def test_mistakes_are_named(tmp_path, text, says):
    with pytest.raises(InputError, match="colours.toml") as caught:
        read_colours(write(tmp_path, text))
    assert says in str(caught.value)


def test_a_colour_that_is_no_number_is_not_written(tmp_path):
    path = write(tmp_path, "old")
    good = BeadColours.of({"head.1": (0.1, 0.2, 0.3)})
    bad = BeadColours(good.names, good.hsb * np.nan, good.sd, good.covariance, good.n)
    with pytest.raises(InputError, match="head.1: NaN"):
        write_colours(path, ColoursFile(bad))
    assert path.read_text() == "old"
