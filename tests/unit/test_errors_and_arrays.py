"""Errors say which argument, what was expected and what came."""

import subprocess
import sys

import numpy as np
import pytest

from jaxmocap import _arrays
from jaxmocap._errors import InputError, JaxMocapError, SolveError


def test_the_two_errors_can_be_caught_by_their_python_kind():
    assert issubclass(InputError, JaxMocapError) and issubclass(InputError, ValueError)
    assert issubclass(SolveError, JaxMocapError) and issubclass(SolveError, RuntimeError)


def test_check_shape_returns_float64():
    value = _arrays.check_shape("uv", [[1, 2], [3, 4]], (None, 2))
    assert value.dtype == np.float64 and value.shape == (2, 2)
    assert _arrays.check_shape("s", 3, ()).shape == ()
    assert _arrays.check_shape("empty", np.zeros((0, 2)), (None, 2)).shape == (0, 2)


@pytest.mark.parametrize(
    "array, expected, sentence",
    [
        (np.zeros((5, 3)), (None, 2), r"uv: expected shape \(any, 2\), got \(5, 3\)"),
        (np.zeros(3), (None, 2), r"uv: expected shape \(any, 2\), got \(3,\)"),
        (np.zeros((2, 2)), (), r"uv: expected shape \(\), got \(2, 2\)"),
        ("three", (None,), r"uv: expected numbers, got str"),
        ([[1, 2], [3]], (None, 2), r"uv: expected numbers, got list"),
        (None, (2,), r"uv: expected"),
        (object(), (2,), r"uv: expected numbers, got object"),
    ],
)
def test_check_shape_names_argument_expected_and_got(array, expected, sentence):
    with pytest.raises(InputError, match=sentence):
        _arrays.check_shape("uv", array, expected)


def test_check_finite_names_how_many_and_where():
    array = np.zeros((3, 2))
    _arrays.check_finite("uv", array, "Mask it.")
    array[1, 1], array[2, 0] = np.nan, np.inf
    with pytest.raises(
        InputError, match=r"uv: 2 of 6 numbers are NaN or infinite, the first at index \(1, 1\). Mask it."
    ):
        _arrays.check_finite("uv", array, "Mask it.")


def test_x64_is_required_with_the_sentence_that_switches_it_on():
    _arrays.require_x64("calibration")  # the tests run in 64 bits
    code = (
        "from jaxmocap import _arrays, _errors\n"
        "try: _arrays.require_x64('calibration')\n"
        "except _errors.InputError as error: print(error)\n"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=_plain_env())
    assert out.stdout.startswith("calibration needs 64-bit numbers")
    assert "jax.config.update('jax_enable_x64', True)" in out.stdout


def _plain_env() -> dict[str, str]:
    import os

    return {name: value for name, value in os.environ.items() if name != "JAX_ENABLE_X64"}
