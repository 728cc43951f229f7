"""JSON and file hashes."""

import json
import math
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxmocap._errors import InputError
from jaxmocap.io import hash_files, json_bytes, write_json

texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
finite = st.floats(allow_nan=False, allow_infinity=False, width=64)
trees = st.recursive(
    st.none() | st.booleans() | st.integers() | finite | texts,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(texts, inner, max_size=3),
    max_leaves=12,
)


@given(content=st.dictionaries(texts, trees, max_size=4))
def test_what_is_written_reads_back_exactly_and_in_order(content):
    back = json.loads(json_bytes(content))
    assert back == content and list(back) == list(content)


def test_arrays_scalars_and_what_is_not_a_number(tmp_path):
    content = {
        "b": np.float32(0.5), "a": jnp.array([1.0, math.nan]), "i": np.int64(3),
        "f": [math.inf, (jnp.asarray(2), True)],
        "p": Path("x") / "y", "t": np.array(["ä"]), "flag": np.bool_(True), "e": np.zeros((0, 2)), 3: None,
    }  # fmt: skip
    write_json(tmp_path / "out.json", content)
    text = (tmp_path / "out.json").read_text(encoding="utf-8")
    assert text.endswith("}\n") and "NaN" not in text and "Infinity" not in text and "ä" in text
    assert list(json.loads(text).items()) == [
        ("b", 0.5), ("a", [1.0, None]), ("i", 3), ("f", [None, [2, True]]), ("p", "x/y"), ("t", ["ä"]),
        ("flag", True), ("e", []), ("3", None),
    ]  # fmt: skip


def test_a_file_name_that_is_not_utf8_is_escaped():
    assert json_bytes({"photo": "a\udcff.jpg"}) == b'{\n  "photo": "a\\udcff.jpg"\n}\n'


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"a": {"b": [1, {2}]}}, r"content\['a'\]\['b'\]\[1\]: set has no place"),
        ({"a": np.array([object()])}, r"content\['a'\]: an array of object"),
        ({"a": {(1, 2): 3}}, "expected a text as key, got tuple"),
        ({"z": 1j}, "complex has no place"),
    ],
)
def test_what_has_no_place_in_json(tmp_path, content, words):
    with pytest.raises(InputError, match=words):
        write_json(tmp_path / "out.json", content)
    assert list(tmp_path.iterdir()) == []


def test_hashes_by_name_and_by_path_where_names_meet(tmp_path):
    for folder, data in [("a", b""), ("b", b"abc")]:
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "left01.jpg").write_bytes(data)
    # FIPS 180-2: the hashes of the empty text and of "abc".
    empty = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"
    abc = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    one, two = tmp_path / "a" / "left01.jpg", tmp_path / "b" / "left01.jpg"
    assert hash_files([two]) == {"left01.jpg": abc}
    assert hash_files([one, two]) == {one.as_posix(): empty, two.as_posix(): abc}
    with pytest.raises(InputError, match="no such file"):
        hash_files([tmp_path / "c"])
