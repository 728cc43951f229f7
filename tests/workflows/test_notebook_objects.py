"""The same from Python, in three lines, and the covariance in further JAX code."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmocap


@pytest.fixture(scope="module")
def result():
    from jaxmocap.workflows.calibrate import demo_photos

    folder, known = demo_photos()
    return jaxmocap.calibrate_chessboard(sorted(folder.glob("*.jpg"))[:12], known["board"], known["square"])


def test_it_shows_itself_and_reports(result, tmp_path: Path) -> None:
    assert "859" in result._repr_html_() or "fx" in result._repr_html_()
    assert "±" in repr(result)
    result.report(tmp_path / "report.html")
    assert (tmp_path / "report.html").read_text().lower().startswith("<!doctype html>")
    result.save(tmp_path / "camera.toml")
    back = jaxmocap.read_rig(tmp_path / "camera.toml").cameras[0].camera
    np.testing.assert_array_equal(np.asarray(back.intrinsics.matrix()), np.asarray(result.camera().intrinsics.matrix()))


def test_covariance_is_usable_in_jax(result) -> None:
    covariance = result.estimate.covariance.shared()
    pixel = jnp.array([100.0, 80.0])

    def direction(numbers: jax.Array) -> jax.Array:
        fx, fy, cx, cy = numbers[0], numbers[1], numbers[2], numbers[3]
        return jnp.stack([(pixel[0] - cx) / fx, (pixel[1] - cy) / fy])

    at = jnp.asarray([float(getattr(result.camera().intrinsics, n)) for n in ("fx", "fy", "cx", "cy")])
    J = jax.jacfwd(direction)(at)
    sigma = jnp.sqrt(jnp.diagonal(J @ covariance[:4, :4] @ J.T))
    assert np.all(np.isfinite(sigma)) and np.all(np.asarray(sigma) > 0)


def test_single_precision_is_refused_with_the_remedy() -> None:
    jax.config.update("jax_enable_x64", False)
    try:
        with pytest.raises(jaxmocap.InputError, match="jax_enable_x64"):
            jaxmocap.calibrate_chessboard("photo.jpg", "9x6", "30mm")
    finally:
        jax.config.update("jax_enable_x64", True)
