"""Programs kept between processes: same numbers, traced once, and nothing lost when the folder is no good."""

import os

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxmocap import _programs
from jaxmocap.geometry import rotation
from jaxmocap.results import RESULTS, Estimate

V = np.array([0.3, -0.2, 0.9])
R = Rotation.from_rotvec(V).as_matrix()


@pytest.fixture
def folder(tmp_path):
    _programs.keep_in(tmp_path / "programs")
    yield tmp_path / "programs"
    _programs.keep_in(None)


@pytest.fixture
def stored(monkeypatch):
    """Names of the entries that were written, one for each tracing."""
    names = []
    store = _programs._store

    def counted(path, *rest):
        names.append(path.name)
        return store(path, *rest)

    monkeypatch.setattr(_programs, "_store", counted)
    return names


def exp_program():
    """As another process would make it: nothing in memory yet."""
    return _programs.program(rotation.exp)


def test_second_process_does_not_trace(folder, stored):
    for _ in range(2):
        np.testing.assert_allclose(exp_program()(jnp.asarray(V)), R, atol=1e-15)
    assert len(stored) == 1
    assert [p.name for p in folder.iterdir()] == stored


def test_other_shapes_and_types_are_other_programs(folder, stored):
    euler = _programs.program(rotation.matrix_from_euler)
    for order in ("xyz", "zyx"):
        expected = Rotation.from_euler(order.upper(), V).as_matrix()
        found = {s: euler(jnp.asarray(V), s) for s in (order, order.upper())}
        assert any(np.allclose(m, expected, atol=1e-14) for m in found.values())
    assert len(stored) == len(set(stored)) == 4


def test_damaged_entry_is_made_anew(folder, stored):
    exp_program()(jnp.asarray(V))
    (entry,) = folder.iterdir()
    for damage in (b"", b"not a program", entry.read_bytes()[:-7]):
        entry.write_bytes(damage)
        np.testing.assert_allclose(exp_program()(jnp.asarray(V)), R, atol=1e-15)
        np.testing.assert_allclose(exp_program()(jnp.asarray(V)), R, atol=1e-15)
    assert len(stored) == 4  # the first and one after each damage


def test_function_of_another_module_is_compiled_as_usual(folder, stored):
    double = _programs.program(lambda x: 2.0 * x)
    assert float(double(jnp.asarray(2.0))) == 4.0
    assert not stored and not list(folder.iterdir())


def test_transformations_see_through_it(folder):
    J = jax.jacfwd(exp_program())(jnp.asarray(V))
    np.testing.assert_allclose(J, jax.jacfwd(rotation.exp)(jnp.asarray(V)), atol=1e-14)
    many = jax.vmap(exp_program())(jnp.asarray(np.stack([V, -V])))
    np.testing.assert_allclose(many, np.stack([R, R.T]), atol=1e-15)


def test_inside_another_program_with_plain_arguments():
    inner = exp_program()
    found = jax.jit(lambda x: x * inner(jnp.asarray(V)))(jnp.asarray(2.0))
    np.testing.assert_allclose(found, 2.0 * R, atol=1e-15)


def test_another_version_of_the_package_finds_nothing(folder, stored, monkeypatch):
    exp_program()(jnp.asarray(V))
    monkeypatch.setattr(_programs, "_fingerprint", lambda: "other")
    exp_program()(jnp.asarray(V))
    assert len(set(stored)) == 2


def test_folder_that_cannot_be_written(tmp_path, monkeypatch, stored):
    def refuse(*_args, **_kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(_programs.tempfile, "mkstemp", refuse)
    _programs.keep_in(tmp_path)
    try:
        np.testing.assert_allclose(exp_program()(jnp.asarray(V)), R, atol=1e-15)
    finally:
        _programs.keep_in(None)
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="no owners on this system")
def test_folder_of_somebody_else_is_not_trusted(tmp_path, monkeypatch, stored):
    monkeypatch.setattr(os, "getuid", lambda: tmp_path.stat().st_uid + 1)
    _programs.keep_in(tmp_path)
    np.testing.assert_allclose(exp_program()(jnp.asarray(V)), R, atol=1e-15)
    assert not stored and not list(tmp_path.iterdir())


def test_result_codes_come_back(folder):
    out = Estimate(jnp.ones(2), None, RESULTS.stalled, {"steps": jnp.asarray(3)})
    run, leaves, shape = _programs._flat(lambda x: eqx_like(out, x), (jnp.asarray(2.0),))
    call, stored = _programs._store(folder / "entry", run, leaves, shape)
    again, read = _programs._load(folder / "entry")
    for program, like in ((call, stored), (again, read)):
        found = _programs._fill(like, program(*leaves))
        assert found.result == RESULTS.stalled and "No step" in found.sentence
        np.testing.assert_array_equal(found.value, [2.0, 2.0])


def eqx_like(estimate, x):
    return Estimate(estimate.value * x, None, estimate.result, estimate.stats)
