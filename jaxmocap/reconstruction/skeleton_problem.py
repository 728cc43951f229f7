"""The skeleton as a least-squares problem: bead model against bead pixels or against points in space.

Shared: the body (and, where asked for, the turntable). Local, one block per pose: turns of the limbs, slip of beads,
angles of the photographs. What a pose does not show is held by a residual of its own, which nothing else pulls at.
"""

import dataclasses
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxmocap._errors import InputError
from jaxmocap.bodies.bead_body import AXES, PARTS, UPPER_BEADS, BeadBody, BeadPose, PoseStart, bead_points
from jaxmocap.cameras import BrownDistortion, Camera, Intrinsics, pixel_of_point, project
from jaxmocap.cameras.turntable import Turntable
from jaxmocap.observations import PixelObservations
from jaxmocap.optim import ArrowProblem, ArrowVariables
from jaxmocap.reconstruction.skeleton_start import TANGENTS, UPPER_ROWS

Mode = Literal["document", "learn", "known"]
"""document: directions only, each limb's first bead anywhere, nothing twists. learn: one body for all poses, lengths
and places of beads sought, limbs twist. known: as learn with a body that is given."""


class TablePhotos(eqx.Module):
    """One camera before a turntable.

    Source: stop-motion document, 4.2.
    """

    turntable: Turntable
    intrinsics: Intrinsics
    distortion: BrownDistortion


class FitShared(eqx.Module):
    """Shared unknowns."""

    body: BeadBody
    table: TablePhotos | None
    """None: cameras are given photo by photo, or there are no photos."""


class FitLocal(eqx.Module):
    """Unknowns of one pose."""

    pose: BeadPose
    angles: Float[Array, "*batch photos"] | None
    """Angle of each photo [rad]; with a turntable only."""


class Hold(eqx.Module):
    """1 where a pose says nothing about a number, else 0."""

    root_turn: Float[Array, "*batch 3"]
    turns: Float[Array, "*batch 10 3"]
    slip: Float[Array, "*batch 6 3"]


class FitData(eqx.Module):
    """What one pose is fitted to."""

    start: PoseStart | None
    hold: Hold | None
    points: Float[Array, "*batch markers 3"] | None = None
    """Beads in space [scene], with `whitening`."""
    whitening: Float[Array, "*batch markers 3 3"] | None = None
    """W with W^T W the inverse covariance of each bead [1/scene]; zero where not seen."""
    cameras: Camera | None = None
    """One per photo, with `seen`."""
    seen: PixelObservations | None = None
    """(photos, markers)."""


class FitCommon(eqx.Module):
    """The same for all poses."""

    scale: Float[Array, ""]
    """Typical length by which what is held is measured [scene]."""
    prior: BeadBody
    """Expected body, for `length_sigma` and spans that no pose shows."""
    length_sigma: Float[Array, "6"]
    """Standard deviations of the expected lengths [scene]."""
    hold_spans: Float[Array, "10"]
    """1 where no pose shows both beads of a part."""


def _pixels(shared: FitShared, local: FitLocal, data: FitData, p: Array) -> Array:
    if shared.table is None:
        of_photo = lambda camera: jax.vmap(lambda q: project(camera, q)[0])(p)  # noqa: E731
        return jax.vmap(of_photo)(data.cameras)
    table = shared.table

    def at_angle(angle: Array) -> Array:
        p_camera = jax.vmap(lambda q: table.turntable.act(angle, q))(p)
        return jax.vmap(lambda q: pixel_of_point(table.intrinsics, table.distortion, q))(p_camera)

    return jax.vmap(at_angle)(local.angles)  # pyright: ignore[reportArgumentType]


def pose_residuals(shared: FitShared, local: FitLocal, data: FitData, common: FitCommon) -> Float[Array, "rows"]:
    """Residuals of one pose in units of sigma.

    Source: stop-motion document, eq. 4.18 and 6.1, as one model.
    """
    p = bead_points(shared.body, local.pose, data.start)  # pyright: ignore[reportArgumentType]
    if data.seen is not None:
        d = (_pixels(shared, local, data, p) - data.seen.uv) / data.seen.sigma[..., None]
        measured = jnp.where(data.seen.visible[..., None], d, 0.0)
    else:
        assert data.points is not None and data.whitening is not None
        measured = jnp.sum(data.whitening * (p - data.points)[:, None, :], axis=2)
    hold, pose = data.hold, local.pose
    held = [hold.root_turn * pose.root_turn, hold.turns * pose.turns, hold.slip * pose.slip / common.scale]  # pyright: ignore[reportOptionalMemberAccess]
    return jnp.concatenate([measured.reshape(-1), *(h.reshape(-1) for h in held)])


def body_prior(shared: FitShared, common: FitCommon) -> Float[Array, "16"]:
    """What is known of the body beforehand, in units of sigma.

    Source: stop-motion document, 6.2 (lengths are measured on the puppet).
    """
    lengths = (shared.body.lengths - common.prior.lengths) / common.length_sigma
    spans = common.hold_spans * (shared.body.spans - common.prior.spans) / common.scale
    return jnp.concatenate([lengths, spans])


SKELETON_PROBLEM = ArrowProblem(pose_residuals, body_prior)

_PRIOR_ROWS = 6 + 10
_ALONG = np.abs(AXES) > 0.5
"""(10, 3): the component of a part's turn that twists it."""


def free_parameters(mode: Mode, table: bool, table_free: bool, photos: int) -> ArrowVariables:
    """Which numbers a fit seeks.

    Gauge and conventions: forearms and shins never twist (no bead sees it). In the mode "document" nothing twists.
    In the modes "learn" and "known" the pelvis turns about the axis only, and the zero of a limb's twist is where its
    upper bead lies in front of it (legs: outside). With a free turntable its distance (the scale), its height and
    the angle of every take's first photo are held.

    Raises:
        InputError: for an unknown mode.
    """
    if mode not in ("document", "learn", "known"):
        raise InputError(f"mode: expected document, learn or known, got {mode!r}")
    learn, twists = mode == "learn", mode != "document"
    upper = np.zeros(10, bool)
    upper[UPPER_ROWS] = twists
    offsets = np.abs(TANGENTS) < 0.5
    offsets[PARTS.index("upper-back-joint") == UPPER_ROWS] = True  # its twist is that of the shoulders
    body = _tree(BeadBody, (np.full(3, learn), np.full(6, learn), offsets & learn, np.full(10, mode != "known")))
    turns = ~_ALONG | upper[:, None]
    pose = _tree(BeadPose, (np.array([False, twists, False]), turns, np.full((6, 3), not twists)))
    if not table:
        return ArrowVariables(FitShared(body, None), FitLocal(pose, None))
    turntable = _tree(Turntable, (np.full(3, table_free), False, False))
    still = (_tree(Intrinsics, (False,) * 5), _tree(BrownDistortion, (False,) * 5))
    angles = (np.arange(photos) > 0) & table_free
    free_table = _tree(TablePhotos, (turntable, *still))
    return ArrowVariables(_tree(FitShared, (body, free_table)), _tree(FitLocal, (pose, angles)))


def _tree(kind: Any, values: tuple[Any, ...]) -> Any:
    """An instance of a module with anything in its fields: flags are no arrays of numbers."""
    it = object.__new__(kind)
    for field, value in zip(dataclasses.fields(kind), values, strict=True):
        object.__setattr__(it, field.name, value)
    return it


def holds(mode: Mode, bones: Bool[Array, "10"], limbs: Bool[Array, "6"]) -> Hold:
    """What one pose says nothing about.

    Args:
        mode: of the fit.
        bones: which parts have both beads.
        limbs: which of the six limbs have any bead.

    Returns:
        Hold; frozen numbers are not held.
    Source: stop-motion document, 6.3 (bones without markers take a convention).
    """
    lost = jnp.repeat((~bones).astype(float)[:, None], 3, axis=1)
    turn = jnp.zeros(3)
    if mode == "document":
        return Hold(turn, jnp.where(_ALONG, 0.0, lost), jnp.repeat((~limbs).astype(float)[:, None], 3, axis=1))
    thighs = bones[np.array([PARTS.index("l-knee-joint"), PARTS.index("r-knee-joint")])]
    turn = turn.at[1].set(jnp.where(jnp.any(thighs), 0.0, 1.0))
    upper = np.isin(np.arange(10), UPPER_ROWS)
    return Hold(turn, jnp.where(_ALONG & ~upper[:, None], 0.0, lost), jnp.zeros((6, 3)))


def counted(data: FitData, common: FitCommon, mode: Mode, weight: Array) -> Float[Array, ""]:
    """Number of residuals that say something; the prior's own rows are counted by the solver."""
    if data.seen is not None:
        measured = 2.0 * jnp.sum(data.seen.visible.astype(float), axis=(1, 2))
    else:
        assert data.whitening is not None
        measured = 3.0 * jnp.sum(jnp.any(data.whitening != 0, axis=(2, 3)).astype(float), axis=1)
    held = sum(jnp.sum(h.reshape(h.shape[0], -1), axis=1) for h in jax.tree.leaves(data.hold))
    telling = {"document": jnp.sum(common.hold_spans), "learn": 6.0 + jnp.sum(common.hold_spans), "known": 0.0}[mode]
    return jnp.sum(weight * (measured + held)) - _PRIOR_ROWS + telling


def local_names(mode: Mode, photos_free: int = 0) -> tuple[tuple[str, str], ...]:
    """(part, number) of every free local number, in the order of the covariance; parts are called by their bones."""
    free: Any = free_parameters(mode, photos_free > 0, photos_free > 0, photos_free + 1).local
    names = [("root-joint", axis) for axis, f in zip("xyz", free.pose.root_turn) if f]
    names += [(part, axis) for part, row in zip(PARTS, free.pose.turns) for axis, f in zip("xyz", row) if f]
    names += [(bead, axis) for bead, row in zip(UPPER_BEADS, free.pose.slip) for axis, f in zip("xyz", row) if f]
    return tuple(names + [("angle", str(i)) for i in range(1, photos_free + 1)])
