"""The document's turntable, row by row, and a real one against matrices made by scipy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxmocap.cameras import DOCUMENT_TABLE, Turntable, turntable_from_axis
from jaxmocap.cameras import turntable as tt

POSE = jax.jit(lambda t, a: (t.pose(a).matrix(), t.act(a, jnp.array([3.0, 5.0, 7.0]))))
PRINTED = jax.jit(lambda a: (tt.document_T_world_camera(a), tt.document_T_camera_world(a), tt.document_translation(a)))


def matrix(R, t):
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = R, t
    return out


def by_hand(angle_deg, rotvec, distance, height):
    """World to camera at an angle: the world is turned about y, then seen from the camera at angle 0."""
    R0 = Rotation.from_rotvec(rotvec).as_matrix()
    Ry = Rotation.from_euler("y", angle_deg, degrees=True).as_matrix()
    return matrix(R0 @ Ry, -R0 @ [0, height, distance])


@pytest.mark.parametrize("row", DOCUMENT_TABLE, ids=lambda row: f"{row[0]:.0f}")
def test_every_row_of_the_document_s_table(row):
    angle_deg, r_x, r_y, r_z, *t = row
    to_world, to_camera, translation = (np.asarray(x) for x in PRINTED(jnp.asarray(np.radians(angle_deg))))
    np.testing.assert_allclose(translation, t, atol=0.5)  # printed to the millimetre
    # The table's three rotations, applied in the order of eq. 4.16: x first, then y.
    R = Rotation.from_euler("xyz", [r_x, r_y, r_z], degrees=True).as_matrix()
    np.testing.assert_allclose(to_world[:3, :3], R, atol=1e-12)
    np.testing.assert_allclose(to_world[:3, 3], translation, atol=1e-12)
    np.testing.assert_allclose(to_world @ to_camera, np.eye(4), atol=1e-12)


def test_the_table_has_the_twelve_steps_of_30_degrees():
    np.testing.assert_array_equal(DOCUMENT_TABLE[:, 0], np.arange(12) * 30)


def test_equations_4_16_and_4_17_as_numbers():
    to_world, to_camera, _ = PRINTED(jnp.asarray(np.pi / 6))
    c, s = np.sqrt(3) / 2, 0.5
    np.testing.assert_allclose(
        to_world, [[c, 0, s, -200], [0, -1, 0, 80], [s, 0, -c, 400 * c], [0, 0, 0, 1]], atol=1e-12
    )
    np.testing.assert_allclose(to_camera, [[c, 0, s, 0], [0, -1, 0, 80], [s, 0, -c, 400], [0, 0, 0, 1]], atol=1e-12)


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 180.0, -90.0, 359.0])
def test_the_nominal_build_is_the_document_s(angle_deg):
    T, p = POSE(Turntable.nominal(), jnp.asarray(np.radians(angle_deg)))
    np.testing.assert_allclose(T, PRINTED(jnp.asarray(np.radians(angle_deg)))[1], atol=1e-9)
    np.testing.assert_allclose(p, (np.asarray(T) @ [3, 5, 7, 1])[:3], atol=1e-9)


@pytest.mark.parametrize("angle_deg", [0.0, 33.0, 200.0])
def test_a_real_build(angle_deg):
    rotvec, distance, height = np.array([np.pi - 0.02, 0.01, 0.03]), 410.0, 75.0
    T, p = POSE(Turntable(*map(jnp.asarray, (rotvec, distance, height))), jnp.asarray(np.radians(angle_deg)))
    expected = by_hand(angle_deg, rotvec, distance, height)
    np.testing.assert_allclose(T, expected, atol=1e-9)
    np.testing.assert_allclose(p, (expected @ [3, 5, 7, 1])[:3], atol=1e-9)
    centre = np.linalg.inv(expected)[:3, 3]
    a = np.radians(angle_deg)
    np.testing.assert_allclose(centre, [-distance * np.sin(a), height, distance * np.cos(a)], atol=1e-9)


def test_the_axis_is_the_line_of_world_points_above_the_origin():
    table = Turntable(jnp.array([np.pi - 0.02, 0.01, 0.03]), jnp.asarray(410.0), jnp.asarray(75.0))
    point, direction = (np.asarray(x) for x in table.axis())
    T = by_hand(0, np.array(table.rotvec), 410.0, 75.0)
    low, high = (T @ [0, 0, 0, 1])[:3], (T @ [0, 100, 0, 1])[:3]
    np.testing.assert_allclose(direction, (high - low) / 100, atol=1e-12)
    np.testing.assert_allclose(np.cross(point - low, direction), 0, atol=1e-9)
    assert abs(point @ direction) < 1e-9  # nearest the camera centre, the origin of the camera frame
    again = turntable_from_axis(jnp.asarray(low), jnp.asarray(3 * direction), jnp.asarray(75.0))
    np.testing.assert_allclose(again.rotvec, [np.pi - 0.02, 0.01, 0.03], atol=1e-9)
    np.testing.assert_allclose(again.pose(jnp.asarray(0.3)).matrix(), table.pose(jnp.asarray(0.3)).matrix(), atol=1e-9)


@pytest.mark.parametrize("axis, sees", [(0, [0, -1, -1]), (1, [1, 0, 1]), (2, [1, -1, 0])])
def test_signs_of_the_deviation(axis, sees):
    """A turn by 0.1 about each camera axis and where it shows: lean in depth, axis right of centre, top right."""
    d = np.zeros(3)
    d[axis] = 0.1
    R = Rotation.from_rotvec(d) * Rotation.from_rotvec([np.pi, 0, 0])
    table = Turntable(jnp.asarray(R.as_rotvec()), jnp.asarray(400.0), jnp.asarray(80.0))
    np.testing.assert_allclose(table.deviation(), d, atol=1e-12)
    point, direction = (np.asarray(x) for x in table.axis())
    if axis == 1:
        assert point[0] > 0 and abs(direction[0]) < 1e-12
    else:
        np.testing.assert_array_equal(np.sign(np.round(direction, 9)), sees)


def test_equation_4_18_by_hand():
    P = jnp.array([[859.0, 0, 337.0, 0], [0, 860.0, 288.0, 0], [0, 0, 1, 0]])
    # At 90 degrees the camera stands at (-400, 80, 0) and looks along +x, with world z to its right:
    # p = (0, 90, 20) is 400 in front of it, 10 above the lens and 20 to the right.
    uv = tt.document_pixel(P, jnp.asarray(np.pi / 2), jnp.array([0.0, 90.0, 20.0]))
    np.testing.assert_allclose(uv, [337 + 859 * 20 / 400, 288 - 860 * 10 / 400], atol=1e-9)


def test_derivatives_are_finite_at_the_perfect_build():
    J = jax.jacfwd(lambda t: t.pose(jnp.asarray(0.0)).matrix())(Turntable.nominal())
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(J))
