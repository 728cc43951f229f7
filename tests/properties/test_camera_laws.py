"""Laws of cameras: the ray of a pixel meets the point, with all five distortion numbers and skew."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from samplers import CameraNumbers, cameras, invertible_radius, points_in_view

from jaxmocap.cameras import BrownDistortion, Camera, Intrinsics, project, ray_from_pixel, undistort
from jaxmocap.geometry import Pose

each_camera = pytest.mark.parametrize("numbers", cameras(10, seed=4), ids=lambda n: f"f={n.K[0, 0]:.0f}")
project_all = jax.jit(jax.vmap(project, in_axes=(None, 0)))
rays = jax.jit(jax.vmap(ray_from_pixel, in_axes=(None, 0)))


def camera_from(numbers: CameraNumbers) -> Camera:
    return Camera(
        Intrinsics.from_matrix(jnp.array(numbers.K)),
        BrownDistortion.from_vector(jnp.array(numbers.k)),
        Pose(jnp.array(numbers.rotvec), jnp.array(numbers.translation)),
        numbers.size,
    )


@each_camera
def test_the_ray_of_a_projected_point_meets_the_point(numbers):
    camera, (p_world, p_camera) = camera_from(numbers), points_in_view(numbers, 40)
    uv, seen = project_all(camera, jnp.array(p_world))
    centre, direction, valid = rays(camera, uv)
    assert np.all(seen) and np.all(valid)
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1, rtol=1e-14)
    distance = np.linalg.norm(p_camera, axis=1)[:, None]
    np.testing.assert_allclose(centre + distance * direction, p_world, atol=1e-12 * distance.max())


@each_camera
@pytest.mark.parametrize("distance", [0.5, 10.0, 1000.0])
def test_any_point_on_the_ray_of_a_pixel_is_seen_at_the_pixel(numbers, distance):
    """Pixels all over the picture, kept inside the lens' invertible range; 1e-10 px."""
    camera, (p_world, _) = camera_from(numbers), points_in_view(numbers, 40, seed=1)
    uv = project_all(camera, jnp.array(p_world))[0]
    centre, direction, valid = rays(camera, uv)
    assert np.all(valid)
    again, seen = project_all(camera, centre + distance * direction)
    assert np.all(seen)
    np.testing.assert_allclose(again, uv, rtol=0, atol=1e-10)


def test_wherever_undistort_says_valid_it_is_the_inverse_and_elsewhere_finite():
    """Lenses that may fold back inside the picture; real points far outside as well."""
    lenses = jnp.array([numbers.k for numbers in cameras(60, seed=5, wide=True)])
    xy = jnp.array(np.random.default_rng(0).normal(size=(60, 40, 2)))

    def both(k, m):
        lens = BrownDistortion.from_vector(k)
        ideal, valid = undistort(lens, m)
        return ideal, valid, lens.distort(ideal)

    ideal, valid, back = (np.asarray(a) for a in jax.jit(jax.vmap(jax.vmap(both, (None, 0))))(lenses, xy))
    assert np.all(np.isfinite(ideal)) and 0.2 < valid.mean() < 0.98
    np.testing.assert_allclose(back[valid], np.asarray(xy)[valid], atol=1e-12)
    radius = np.array([invertible_radius(np.asarray(k)) for k in lenses])
    inside = np.linalg.norm(ideal, axis=2) < radius[:, None] * (1 + 1e-9)
    assert np.all(inside[valid])


def test_every_point_inside_the_invertible_radius_is_found_again():
    """Radial lenses up to 99.9 percent of the radius; lenses with a small tangential part up to 95 percent."""
    rng = np.random.default_rng(1)
    for tangential, fraction in ((0.0, 0.999), (1.0, 0.95)):
        lenses = np.array([numbers.k for numbers in cameras(40, seed=6, wide=True)]) * [1, 1, tangential, tangential, 1]
        radius = np.minimum([invertible_radius(k) for k in lenses], 2.0)
        unit = rng.normal(size=(40, 30, 2))
        unit *= np.sqrt(rng.uniform(0, fraction**2, (40, 30, 1))) / np.linalg.norm(unit, axis=2, keepdims=True)
        ideal = unit * radius[:, None, None]
        got, valid = round_trip(jnp.array(lenses), jnp.array(ideal))
        assert np.all(valid)
        np.testing.assert_allclose(got, ideal, atol=1e-9)


@jax.jit
def round_trip(lenses, ideal):
    def one(k, m):
        lens = BrownDistortion.from_vector(k)
        return undistort(lens, lens.distort(m))

    return jax.vmap(jax.vmap(one, (None, 0)))(lenses, ideal)


number = st.floats(-0.5, 0.5, allow_nan=False, allow_subnormal=False)
_single = jax.jit(lambda k, m: round_trip(k[None], m[None, None]))


@given(st.tuples(number, number, number), st.floats(0, 0.99), st.floats(0, 6.3))
def test_any_radial_lens_is_inverted_inside_its_radius(k, part, phi):
    k = np.array([k[0], k[1], 0.0, 0.0, k[2]])
    radius = min(invertible_radius(k), 1.5)
    assume(radius > 1e-3)
    m = part * radius * np.array([np.cos(phi), np.sin(phi)])
    got, valid = _single(jnp.array(k), jnp.array(m))
    assert np.all(valid)
    np.testing.assert_allclose(got[0, 0], m, atol=1e-10)
