"""Bones files: lengths read back exactly, and every mistake is named with its place."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxmocap._errors import InputError
from jaxmocap.bodies.puppet import DEFAULT_LENGTHS
from jaxmocap.io import BonesFile, read_bones, write_bones

lengths = st.dictionaries(
    st.sampled_from(sorted(DEFAULT_LENGTHS)), st.floats(min_value=1e-6, max_value=1e8), min_size=1
)


@given(lengths, st.sampled_from(["mm", "cm", "m", "in", "1"]))
def test_what_is_written_reads_back_exactly(tmp_path_factory, lengths, unit):
    path = tmp_path_factory.mktemp("bones") / "bones.toml"
    write_bones(path, BonesFile(lengths, unit))
    assert read_bones(path) == BonesFile(lengths, unit)


def test_a_file_by_hand(tmp_path):
    path = tmp_path / "bones.toml"
    path.write_text('# measured with a ruler\nunit = "cm"\n[lengths]\nl-elbow-joint = 3.3\nl-knee-joint = 4\n')
    assert read_bones(path) == BonesFile({"l-elbow-joint": 3.3, "l-knee-joint": 4.0}, "cm")


@pytest.mark.parametrize(
    "text, said",
    [
        ('unit = "mm"\n[lengths]\nl-elbow = 33\n', "Did you mean 'l-elbow-joint'"),
        ('unit = "mm"\n[lengths]\ntail-joint = 33\n', "no bone 'tail-joint'"),
        ('unit = "mm"\n[lengths]\nroot-joint = 33\n', "no bone 'root-joint'"),
        ('unit = "mm"\n[lengths]\nhead-joint = 0\n', "positive"),
        ('unit = "mm"\n[lengths]\nhead-joint = -3.5\n', "positive"),
        ('unit = "mm"\n[lengths]\nhead-joint = nan\n', "positive"),
        ('unit = "mm"\n[lengths]\nhead-joint = inf\n', "positive"),
        ('unit = "mm"\n[lengths]\nhead-joint = true\n', "expected a number, got bool"),
        ('unit = "mm"\n[lengths]\nhead-joint = "33mm"\n', "expected a number, got str"),
        ('unit = "mm"\n[lengths]\nhead-joint = 3\nhead-joint = 4\n', "not valid TOML"),
        ("[lengths]\nhead-joint = 3\n", "unit"),
        ('unit = "furlong"\n[lengths]\nhead-joint = 3\n', "unit"),
        ('unit = "mm"\n', "[lengths]"),
        ('unit = "mm"\nlengths = 3\n', "[lengths]"),
        ('unit = "mm"\nlenghts = 3\n', "Did you mean 'lengths'"),
        ("", "empty"),
    ],
)
def test_mistakes_are_named(tmp_path, text, said):
    path = tmp_path / "bones.toml"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        read_bones(path)
    assert said in str(error.value) and str(path) in str(error.value)


@pytest.mark.parametrize("bones", [BonesFile({"tail": 1.0}), BonesFile({"head-joint": 0.0}), BonesFile({}, "furlong")])
def test_nothing_wrong_is_written(tmp_path, bones):
    path = tmp_path / "bones.toml"
    path.write_text("kept")
    with pytest.raises(InputError):
        write_bones(path, bones)
    assert path.read_text() == "kept"
