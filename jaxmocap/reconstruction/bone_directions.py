"""Directions of the puppet's bones from its beads: the printed formulas, and the repair of those that break down."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxmocap._arrays import Flag, Scalar, Vector3
from jaxmocap.bodies import puppet
from jaxmocap.bodies.puppet import BONES, MARKERS

_M1 = np.array([MARKERS.index(bone.m1) for bone in BONES])
_M2 = np.array([MARKERS.index(bone.m2) for bone in BONES])
_X, _Z = np.eye(3)[[0, 2]]

# Nearer than this to the direction in which a printed cross product vanishes, the repaired convention turns over to
# the undisturbed one. An error of a bone's direction is enlarged by 1 / sin of the distance: here three times.
_NEAR = np.sin(np.radians(20.0))

# The document's puppet faces the camera at angle 0 and its legs may swing; beyond this its left side is no longer
# the world's, whichever way the legs stand.
TURNED_AWAY = np.radians(45.0)


def unit_or(v: Vector3, instead: Vector3, floor: float | Scalar = 1e-12) -> tuple[Vector3, Flag]:
    """V / |v| and True, or the other vector and False; no derivative is ever infinite."""
    squared = jnp.sum(v * v)
    good = squared > floor**2
    length = jnp.sqrt(jnp.where(good, squared, 1.0))
    return jnp.where(good, v / length, instead), good


def bone_directions(
    points: Float[Array, "markers 3"], seen: Bool[Array, "markers"]
) -> tuple[Float[Array, "bones 3"], Bool[Array, "bones"]]:
    """Directions of the bones with beads, in the order of `puppet.BONES`.

    Args:
        points: beads in the order of `puppet.MARKERS` [scene]; any finite numbers where not seen.
        seen: which beads there are.

    Returns:
        unit vectors (the rest direction where a bead is missing or both stand on one spot), which are valid.
    Source: stop-motion document, eq. 3.1, 3.2 and 6.1.
    """
    rest = jnp.array([puppet.REST_DIRECTIONS[bone.name] for bone in BONES])
    a = jnp.where((seen[_M1] & seen[_M2])[:, None], points[_M2] - points[_M1], 0.0)
    return jax.vmap(unit_or)(a, rest)


def document_foot(leg: Vector3) -> tuple[Vector3, Flag]:
    """Direction of a foot as printed, leg x (1, 0, 0) / |...|; not valid for a leg along x.

    Source: stop-motion document, eq. 6.4.
    """
    return unit_or(jnp.cross(leg, jnp.array(_X)), jnp.array(_Z), 1e-9)


def document_shoulders(upper_back: Vector3) -> tuple[Float[Array, "2 3"], Flag]:
    """Directions of left and right shoulder as printed, upper back x (0, 0, +-1) / |...|; not valid along z.

    Source: stop-motion document, eq. 6.5-6.6 (6.6 is printed as a translation; a direction is meant).
    """
    left, valid = unit_or(jnp.cross(upper_back, jnp.array(_Z)), jnp.array(_X), 1e-9)
    return jnp.stack([left, -left]), valid


def repaired_cross(bone: Vector3, axis: Vector3, calm: Vector3) -> Vector3:
    """Bone x axis / |...| without its faults: on the side of `calm`, and `calm` itself where it vanishes.

    `calm` is what an undisturbed turn of the parent gives, perpendicular to the bone.
    """
    c = jnp.cross(bone, axis)
    printed, good = unit_or(c, calm, 1e-9)
    side = jnp.where(jnp.sum(printed * calm) < 0, -1.0, 1.0)
    t = jnp.clip(jnp.sqrt(jnp.where(good, jnp.sum(c * c), 0.0) + 1e-30) / _NEAR, 0.0, 1.0)
    weight = t * t * (3.0 - 2.0 * t)
    return unit_or(weight * side * printed + (1.0 - weight) * calm, calm)[0]


def facing(points: Float[Array, "markers 3"], seen: Bool[Array, "markers"]) -> tuple[Scalar, Flag]:
    """Angle about y by which the puppet is turned from facing the camera at angle 0, as its left and right beads say.

    Args:
        points: beads in the order of `puppet.MARKERS` [scene].
        seen: which beads there are.

    Returns:
        angle [rad] (swung limbs make it uncertain by some 10 degrees), False if no pair was seen.
    Source: stop-motion document, 4.2.1 (x is the puppet's left).
    """
    weight_of = {"leg.{}1": 1.0, "leg.{}2": 0.25, "arm.{}1": 1.0, "arm.{}2": 0.25}  # upper beads swing less
    pairs = [(MARKERS.index(n.format("L")), MARKERS.index(n.format("R"))) for n in weight_of]
    left, right = np.array(pairs).T
    weight = jnp.array(list(weight_of.values())) * (seen[left] & seen[right]).astype(float)
    d = jnp.sum(weight[:, None] * jnp.where((weight > 0)[:, None], points[left] - points[right], 0.0), axis=0)
    known = d[0] ** 2 + d[2] ** 2 > 1e-18
    return jnp.arctan2(jnp.where(known, -d[2], 0.0), jnp.where(known, d[0], 1.0)), known


def bend(a: Vector3, b: Vector3) -> Scalar:
    """Angle between two unit directions [rad], 0..pi; its derivative is zero where they are parallel.

    Source: stop-motion document, 6.1 (a bone relative to the one it hangs on).
    """
    c = jnp.cross(a, b)
    squared = jnp.sum(c * c)
    bent = squared > 1e-24
    sine = jnp.where(bent, jnp.sqrt(jnp.where(bent, squared, 1.0)), 0.0)
    cosine = jnp.sum(a * b)
    return jnp.where(bent, jnp.arctan2(sine, cosine), jnp.where(cosine < 0, jnp.pi, 0.0))
