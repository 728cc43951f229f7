"""Skeletons of largest likelihood, from points in space or straight from the pixels of the beads, with covariance."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxmocap._arrays import require_x64
from jaxmocap._errors import InputError
from jaxmocap._programs import program
from jaxmocap.bodies.bead_body import AXES, LENGTH_BONES, PARTS, BeadBody, BeadPose, PoseStart, bead_points, part_frames
from jaxmocap.bodies.puppet import MARKERS
from jaxmocap.cameras import Camera
from jaxmocap.observations import PixelObservations
from jaxmocap.optim import ArrowVariables, least_squares
from jaxmocap.reconstruction.skeleton import BONE_NAMES, BodyFrames, SkeletonPose, feet_frames, skeleton_of_frames
from jaxmocap.reconstruction.skeleton_problem import (
    SKELETON_PROBLEM,
    FitCommon,
    FitData,
    FitLocal,
    FitShared,
    Mode,
    TablePhotos,
    counted,
    free_parameters,
    holds,
)
from jaxmocap.reconstruction.skeleton_start import UPPER_ROWS, common_body, slip_onto, start_from_markers
from jaxmocap.results import Estimate

# Nobody has measured the puppet: proportions of other bodies say how long a bone is to about a quarter.
_UNMEASURED = 0.25


class SkeletonFit(eqx.Module):
    """Fitted poses of one puppet.

    Source: stop-motion document, section 6, as one estimate.
    """

    estimate: Estimate
    """Its value is ArrowVariables(FitShared, FitLocal), its blocks are the poses."""
    start: PoseStart
    """What the turns are counted from."""
    bones: Bool[Array, "poses 10"]
    """Which parts had both beads."""
    lengths: Float[Array, "bones"]
    """Of all bones, in the order of `skeleton.BONE_NAMES`; learnt ones where they were learnt [scene]."""
    mode: Mode = eqx.field(static=True)

    def beads(self) -> Float[Array, "poses markers 3"]:
        """Fitted bead centres in the world [scene]."""
        value = self.estimate.value
        return jax.vmap(bead_points, (None, 0, 0))(value.shared.body, value.local.pose, self.start)

    def poses(self) -> SkeletonPose:
        """Skeletons, stacked over the poses."""
        value = self.estimate.value
        one = lambda *a: _skeleton(value.shared.body, *a, self.lengths, self.mode)  # noqa: E731
        return jax.vmap(one)(value.local.pose, self.start, self.bones)


@program
def _skeleton(
    body: BeadBody, pose: BeadPose, start: PoseStart, bones: Array, lengths: Array, mode: Mode
) -> SkeletonPose:
    R, _ = part_frames(body, pose, start)
    of = {part: R[1 + i] for i, part in enumerate(PARTS)}
    pair = lambda joint: jnp.stack([of[f"l-{joint}-joint"], of[f"r-{joint}-joint"]])  # noqa: E731
    shanks = pair("foot")
    frames = BodyFrames(
        R[0], of["upper-back-joint"], of["head-joint"], (pair("elbow"), pair("hand")), (pair("knee"), shanks),
        feet_frames(shanks, R[0]),
    )  # fmt: skip
    points = bead_points(body, pose, start)
    skeleton = skeleton_of_frames(frames, bones, points, jnp.ones(len(MARKERS), bool), lengths)
    return skeleton if mode == "document" else eqx.tree_at(lambda s: s.root, skeleton, body.root)


def _usable(mode: Mode, bones: Array) -> Array:
    """Poses that count: those with all upper parts, where limbs hang on one another by known lengths."""
    return jnp.ones(bones.shape[0]) if mode == "document" else jnp.all(bones[:, UPPER_ROWS], axis=1).astype(float)


def _all_lengths(lengths: Array, body: BeadBody, mode: Mode) -> Array:
    """Lengths with what the body says: trunk, shoulders, hips; upper arm and thigh end abreast of the bead."""
    if mode == "document":
        return lengths
    rows = np.array([BONE_NAMES.index(name) for name in LENGTH_BONES])
    limbs = ("l-elbow-joint", "r-elbow-joint", "l-knee-joint", "r-knee-joint")
    limb_rows = np.array([BONE_NAMES.index(name) for name in limbs])
    part_rows = np.array([PARTS.index(name) for name in limbs])
    along = jnp.sum(body.offsets[2:] * jnp.array(AXES[part_rows]), axis=1) + body.spans[part_rows]
    return lengths.at[rows].set(body.lengths).at[limb_rows].set(along)


def _fit(
    data: FitData,
    table: TablePhotos | None,
    angles: Array | None,
    points: Array,
    seen: Array,
    lengths: Array,
    options: dict[str, Any],
) -> SkeletonFit:
    """The common part of both entries; `data` lacks start and holds."""
    require_x64("fitting a skeleton")
    mode: Mode = options["mode"]
    body, sigma, table_free = options["body"], options["length_sigma"], options["table_free"]
    if (mode == "known") != (body is not None):
        raise InputError('body: give it in the mode "known" and only there; a fit in the mode "learn" makes one')
    start = _prepare(data, points, seen, lengths, body, sigma, mode)
    free = free_parameters(mode, table is not None, table_free, 0 if angles is None else angles.shape[1])
    y0 = ArrowVariables(FitShared(start.common.prior, table), FitLocal(start.pose, angles))
    estimate = least_squares(
        SKELETON_PROBLEM, y0, start.data, start.common, free=free, weight=start.weight, count=start.count,
        max_steps=options["max_steps"], pad=False,
    )  # fmt: skip
    found = _all_lengths(lengths, estimate.value.shared.body, mode)
    return SkeletonFit(estimate, start.data.start, start.bones, found, mode)  # pyright: ignore[reportArgumentType]


class _Prepared(NamedTuple):
    data: FitData
    common: FitCommon
    pose: BeadPose
    bones: Array
    weight: Array
    count: Array


@program
def _prepare(
    data: FitData, points: Array, seen: Array, lengths: Array, body: BeadBody | None, sigma: Array | None, mode: Mode
) -> _Prepared:
    """Everything that the solver needs and that is not an observation: one compilation."""
    twist = mode != "document"
    inputs = jax.lax.stop_gradient((points, lengths, body))
    data = _without_cut_off(data, jax.vmap(_cut_off)(seen))
    starts = jax.vmap(lambda p, s: start_from_markers(p, s, inputs[1], twist, inputs[2]))(inputs[0], seen)
    prior = common_body(starts) if body is None else body
    slip = jax.vmap(slip_onto, (0, 0, None, 0))(points, seen, prior, starts.start)
    slip = jax.lax.stop_gradient(jnp.zeros_like(slip) if twist else slip)
    hold = jax.vmap(lambda b, s: holds(mode, b, _limbs_seen(s)))(starts.bones, seen)
    data = eqx.tree_at(lambda d: (d.start, d.hold), data, (starts.start, hold), is_leaf=lambda x: x is None)
    length_sigma = _UNMEASURED * prior.lengths if sigma is None else jnp.broadcast_to(jnp.asarray(sigma), (6,))
    never = 1.0 - jnp.any(starts.bones, axis=0).astype(float)
    common = FitCommon(lengths[0], prior, length_sigma, never)
    poses = points.shape[0]
    pose = BeadPose(jnp.zeros((poses, 3)), jnp.zeros((poses, 10, 3)), slip)
    weight = _usable(mode, starts.bones)
    return _Prepared(data, common, pose, starts.bones, weight, counted(data, common, mode, weight))


def _cut_off(seen: Bool[Array, "markers"]) -> Bool[Array, "markers"]:
    """Last beads of limbs whose middle bead is missing: they would pull at two bones that are not determined."""
    out = jnp.zeros(len(MARKERS), bool)
    for limb in ("arm.L", "arm.R", "leg.L", "leg.R"):
        first, middle, last = (MARKERS.index(f"{limb}{i}") for i in (1, 2, 3))
        out = out.at[last].set(seen[first] & ~seen[middle])
    return out


def _without_cut_off(data: FitData, cut: Bool[Array, "poses markers"]) -> FitData:
    if data.seen is not None:
        return eqx.tree_at(lambda d: d.seen.visible, data, data.seen.visible & ~cut[:, None, :])
    return eqx.tree_at(lambda d: d.whitening, data, jnp.where(cut[..., None, None], 0.0, data.whitening))  # pyright: ignore[reportArgumentType]


def _limbs_seen(seen: Bool[Array, "markers"]) -> Bool[Array, "6"]:
    """Which of the six limbs have any bead."""
    names = ("head.", "torso.", "arm.L", "arm.R", "leg.L", "leg.R")
    rows = [np.array([i for i, m in enumerate(MARKERS) if m.startswith(name)]) for name in names]
    return jnp.stack([jnp.any(seen[r]) for r in rows])


def fit_skeleton_to_points(
    points: Float[Array, "poses markers 3"],
    seen: Bool[Array, "poses markers"],
    covariance: Float[Array, "poses markers 3 3"],
    lengths: Float[Array, "bones"],
    *,
    mode: Mode = "document",
    body: BeadBody | None = None,
    length_sigma: Float[Array, "6"] | None = None,
    max_steps: int = 60,
) -> SkeletonFit:
    """Skeletons of the largest likelihood for beads in space.

    Args:
        points: beads in the order of `puppet.MARKERS` [scene]; any finite numbers where not seen.
        seen: which beads there are.
        covariance: of each bead [scene^2]; positive definite where seen.
        lengths: of all bones, in the order of `skeleton.BONE_NAMES` [scene].
        mode: see `skeleton_problem.Mode`.
        body: in the mode "known": what a fit in the mode "learn" found.
        length_sigma: how well the lengths of `bead_body.LENGTH_BONES` are known before [scene]; None: to a quarter.
        max_steps: largest number of solver steps.

    Returns:
        SkeletonFit; a pose without all of head, torso, upper arms and thighs keeps the document's skeleton in the
        modes "learn" and "known".

    Raises:
        InputError: wrong mode, or a body where none belongs.
    Source: stop-motion document, section 6; Gaussian likelihood.
    """
    I = jnp.eye(3)  # noqa: E741
    L = jnp.linalg.cholesky(jnp.where(seen[..., None, None], covariance, I))
    W = jnp.where(
        seen[..., None, None], jax.scipy.linalg.solve_triangular(L, jnp.broadcast_to(I, L.shape), lower=True), 0.0
    )
    clean = jnp.where(seen[..., None], points, 0.0)
    data = FitData(None, None, points=clean, whitening=W)  # type: ignore[arg-type]
    options = dict(mode=mode, body=body, length_sigma=length_sigma, max_steps=max_steps, table_free=False)
    return _fit(data, None, None, clean, seen, lengths, options)


def fit_skeleton_to_pixels(
    observations: PixelObservations,
    views: Camera | TablePhotos,
    points: Float[Array, "poses markers 3"],
    seen: Bool[Array, "poses markers"],
    lengths: Float[Array, "bones"],
    *,
    angles: Float[Array, "poses photos"] | None = None,
    table_free: bool = False,
    mode: Mode = "document",
    body: BeadBody | None = None,
    length_sigma: Float[Array, "6"] | None = None,
    max_steps: int = 60,
) -> SkeletonFit:
    """Skeletons of the largest likelihood for the pixels of the beads: all photos of all poses at once.

    Pure: `jax.jacobian` of the result by pixels and by numbers of the cameras works (implicit function theorem); the
    start is not differentiated.

    Args:
        observations: arrays (poses, photos, markers).
        views: cameras stacked as (poses, photos), or one camera before a turntable together with `angles`.
        points: start, beads in space as triangulated [scene].
        seen: beads that the photos determine (two views or more); pixels of the others are not used.
        lengths: of all bones, in the order of `skeleton.BONE_NAMES` [scene].
        angles: of every photo [rad]; with a turntable only.
        table_free: seek axis, camera rotation and angles together with the poses, so that their uncertainty is in
            the covariance; distance (scale), height and the first photo's angle of each pose are held.
        mode: see `skeleton_problem.Mode`.
        body: in the mode "known": what a fit in the mode "learn" found.
        length_sigma: how well the lengths of `bead_body.LENGTH_BONES` are known before [scene]; None: to a quarter.
        max_steps: largest number of solver steps.

    Returns:
        SkeletonFit.

    Raises:
        InputError: wrong mode, a body where none belongs, angles without a turntable or none with one.
    Source: stop-motion document, eq. 4.18 and section 6; Gaussian likelihood.
    """
    table = views if isinstance(views, TablePhotos) else None
    if (table is None) != (angles is None) or (table is None and table_free):
        raise InputError(
            "angles, table_free: they belong to a turntable (TablePhotos); give angles there and only there"
        )
    observed = PixelObservations(observations.uv, observations.visible & seen[:, None, :], observations.sigma)
    cameras = None if isinstance(views, TablePhotos) else views
    data = FitData(None, None, cameras=cameras, seen=observed)  # type: ignore[arg-type]
    clean = jnp.where(seen[..., None], points, 0.0)
    options = dict(mode=mode, body=body, length_sigma=length_sigma, max_steps=max_steps, table_free=table_free)
    return _fit(data, table, angles, clean, seen, lengths, options)
