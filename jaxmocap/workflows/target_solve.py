"""From points seen on targets to a calibrated rig: pad, start, refine, freeze what is not determined."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxmocap._arrays import check_finite, require_x64
from jaxmocap._errors import InputError, SolveError
from jaxmocap.calibration.boards import (
    MODELS,
    DistortionModel,
    TargetViews,
    free_parameters,
    refine_targets,
)
from jaxmocap.calibration.centring import centred, moved_back
from jaxmocap.calibration.describe import describe
from jaxmocap.calibration.determined import next_to_freeze, undetermined
from jaxmocap.calibration.pair_agreement import CameraPoses, Disagreement, disagreements
from jaxmocap.calibration.start import join_cameras, start_each
from jaxmocap.observations import PixelObservations
from jaxmocap.optim import ArrowVariables
from jaxmocap.optim.packing import bucket
from jaxmocap.results import RESULTS, Estimate

_MOST_FREEZES = 6
_POINT_STEPS = 8  # each padded point costs as much as a real one: at most an eighth more of them


def make_views(points: np.ndarray, uv: np.ndarray, visible: np.ndarray, sigma: np.ndarray | None = None) -> TargetViews:
    """Views and points padded to sizes that few compilations serve; of the added ones nothing is seen.

    Args:
        points: (views, points, 3) in the target's frame [scene].
        uv: (views, cameras, points, 2) [px].
        visible: (views, cameras, points).
        sigma: same shape [px]; None: 1 px.

    Returns:
        TargetViews.

    Raises:
        InputError: numbers that are not finite where something was seen.
    """
    check_finite("points", points[visible.any(axis=1)], "Correct or remove these rows.")
    check_finite("uv", uv[visible], "Correct or remove these corners.")
    views, _, count = visible.shape
    more = (bucket(views) - views, bucket(count, _POINT_STEPS) - count)
    wide = np.pad(points, ((0, 0), (0, more[1]), (0, 0)), mode="edge")
    observed = PixelObservations(
        uv=jnp.asarray(_padded(np.where(visible[..., None], uv, 0.0), more, 0.0)),
        visible=jnp.asarray(_padded(visible, more, False)),
        sigma=jnp.asarray(_padded(np.ones(visible.shape) if sigma is None else sigma, more, 1.0)),
    )
    return TargetViews(jnp.asarray(np.pad(wide, ((0, more[0]), (0, 0), (0, 0)), mode="edge")), observed)


def _padded(x: np.ndarray, more: tuple[int, int], value: float | bool) -> np.ndarray:
    """An array (views, cameras, points, ...) with more views and points of one value."""
    return np.pad(x, [(0, more[0]), (0, 0), (0, more[1]), *([(0, 0)] * (x.ndim - 3))], constant_values=value)


def _check_enough(views: TargetViews, cameras: list[str], names: int) -> None:
    """Refuse what cannot determine the parameters asked for, by counting equations."""
    seen = np.asarray(views.seen.visible)
    for k, camera in enumerate(cameras):
        used = seen[:, k].any(axis=1).sum()
        equations, unknowns = 2 * int(seen[:, k].sum()), 4 + names + 6 * int(used)
        if used == 0:
            raise InputError(f"camera {camera}: the target was seen in no view. Record it in front of this camera.")
        if equations < unknowns:
            raise SolveError(
                f"camera {camera}: {equations} measured coordinates cannot determine {unknowns} unknowns "
                f"({used} views). Add views or points, or ask for less (--distortion none)."
            )


class PairingError(SolveError):
    """Views that contradict one another about how the cameras stand: not taken at once, or paired wrongly."""


class SolvedTargets(NamedTuple):
    """What `solve_targets` found."""

    estimate: Estimate
    views: TargetViews
    """The views that were used."""
    free: ArrowVariables
    frozen: tuple[tuple[str, ...], ...]
    """For each camera the names held because the data do not determine them."""
    dropped: tuple[tuple[int, int], ...]
    """(view, camera) of what could not be used: too few points, or points on a line."""


def solve_targets(
    views: TargetViews,
    cameras: list[str],
    image_sizes: list[tuple[int, int]],
    *,
    distortion: DistortionModel = "k1k2",
    skew: bool = False,
    robust: bool = False,
    view_names: Sequence[tuple[str | None, ...]] = (),
    progress: Callable[[Any, Any, Any], None] | None = None,
) -> SolvedTargets:
    """Calibrate cameras from what they saw of known targets.

    Args:
        views: as `make_views` makes them.
        cameras: names, for messages.
        image_sizes: (width, height) of each [px].
        distortion: lens model.
        skew: whether K[0][1] is sought.
        robust: Cauchy loss whose width follows from the data, instead of plain least squares.
        view_names: for each view, what each camera calls it, for messages.
        progress: called with (step, cost, damping).

    Returns:
        SolvedTargets.

    Raises:
        InputError: a camera that saw nothing, 32-bit JAX.
        SolveError: too few data, or the solve failed (with the sentence); PairingError if it is the pairs that are
            wrong.
    """
    require_x64("A calibration")
    free_parameters(len(cameras), distortion, skew)  # refuses an unknown model before anything else
    _check_enough(views, cameras, len(MODELS[distortion]) + skew)
    given, (views, middle) = views, centred(views)
    each = start_each(views, image_sizes, cameras)
    start, used = join_cameras(each, cameras)
    poses = [CameraPoses(np.asarray(c.lens.intrinsics.matrix()), c.T, c.used, c.variance) for c in each]
    # A tight limit, for poses that depend on a rough lens: what exceeds it is looked at again, more carefully.
    if disagreements(poses, np.asarray(views.points), np.asarray(views.seen.visible), inflation=1.0):
        _check_pairs(views, cameras, image_sizes, poses, distortion, view_names)
    views, dropped = _without_poseless(views, used)
    start = _without(start, [tuple({"k1", "k2"} - set(MODELS[distortion]))] * len(cameras), image_sizes)
    frozen: tuple[tuple[str, ...], ...] = ((),) * len(cameras)
    for _ in range(_MOST_FREEZES + 1):
        free = free_parameters(len(cameras), distortion, skew, frozen)
        estimate = refine_targets(start, views, free, loss="cauchy" if robust else None, progress=progress)
        if estimate.result == RESULTS.out_of_steps or estimate.result == RESULTS.stalled:
            # A long flat valley: the least needed parameters are the ones that run away along it.
            more = next_to_freeze(free)
        elif estimate.result == RESULTS.successful or estimate.result == RESULTS.undetermined:
            more = undetermined(estimate, free, image_sizes)
        else:
            break
        if not any(more):
            break
        frozen = tuple(tuple(sorted({*a, *b})) for a, b in zip(frozen, more))
        start = _without(start, list(frozen), image_sizes)
    if not estimate.success:
        raise SolveError(f"{estimate.sentence}{_square_on(estimate, views)}")
    _check_cameras(estimate, cameras)
    return SolvedTargets(moved_back(estimate, middle), replace(given, seen=views.seen), free, frozen, dropped)


def _without_poseless(views: TargetViews, used: np.ndarray) -> tuple[TargetViews, tuple[tuple[int, int], ...]]:
    """The views without those in which a camera sees too few points, or points on a line, to have a pose.

    A rig's view keeps what little a camera saw of it if another camera fixes its pose.
    """
    seen = np.asarray(views.seen.visible)
    poseless = np.any(seen, axis=2) & ~np.any(used, axis=0)[:, None]
    if not poseless.any():
        return views, ()
    kept = replace(views.seen, visible=jnp.asarray(seen & ~poseless[:, :, None]))
    return replace(views, seen=kept), tuple((int(v), int(k)) for v, k in np.argwhere(poseless))


def _without(start: ArrowVariables, names: list[tuple[str, ...]], image_sizes: list[tuple[int, int]]) -> ArrowVariables:
    """Start values with the named numbers at what they are held at: 0, or the image centre."""
    lenses = []
    for lens, gone, (width, height) in zip(start.shared.lenses, names, image_sizes):
        held = {n: jnp.zeros(()) for n in gone}
        held |= {n: jnp.asarray(0.5 * (s - 1)) for n, s in (("cx", width), ("cy", height)) if n in gone}
        inner = {n: v for n, v in held.items() if n in ("cx", "cy", "skew")}
        outer = {n: v for n, v in held.items() if n not in inner}
        lenses.append(
            replace(lens, intrinsics=replace(lens.intrinsics, **inner), distortion=replace(lens.distortion, **outer))
        )
    return ArrowVariables(replace(start.shared, lenses=tuple(lenses)), start.local)


def _check_pairs(
    views: TargetViews,
    cameras: list[str],
    image_sizes: list[tuple[int, int]],
    rough: list[CameraPoses],
    distortion: DistortionModel,
    view_names: Sequence[tuple[str | None, ...]],
) -> None:
    """Refuse pairs that disagree also when each camera is calibrated alone, not only with rough start values."""
    points, seen = np.asarray(views.points), np.asarray(views.seen.visible)
    poses = [_alone(views, k, name, image_sizes[k], distortion, rough[k]) for k, name in enumerate(cameras)]
    found = disagreements(poses, points, seen)
    if found:
        raise PairingError(_pairing_sentence(found[0], cameras, view_names))


def _alone(
    views: TargetViews, k: int, name: str, size: tuple[int, int], distortion: DistortionModel, rough: CameraPoses
) -> CameraPoses:
    """The poses of one camera calibrated alone; the rough ones where that cannot be done."""
    mine = PixelObservations(*(x[:, [k]] for x in (views.seen.uv, views.seen.visible, views.seen.sigma)))
    try:
        solved = solve_targets(replace(views, seen=mine), [name], [size], distortion=distortion)
    except (InputError, SolveError):
        return rough
    described = describe(solved.estimate.value, solved.views)
    T = np.tile(np.eye(4), (len(rough.T), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = described.R_camera_target[:, 0], described.t_camera_target[:, 0]
    used = rough.used & np.asarray(solved.views.seen.visible).any(axis=(1, 2))
    squares = float(np.sum(described.residual**2))
    freedom = 2 * solved.views.observations - 6 * int(used.sum())
    return CameraPoses(described.K[0], T, used, squares / max(freedom, 1))


def _pairing_sentence(found: Disagreement, cameras: list[str], view_names: Sequence[tuple[str | None, ...]]) -> str:
    """What is said of pairs that disagree."""
    a, b = found.cameras

    def name(v: int) -> str:
        mine = view_names[v] if v < len(view_names) else (None,) * len(cameras)
        said = list(dict.fromkeys(n for n in (mine[a], mine[b]) if n))
        return " + ".join(said) if said else f"view {v}"

    named = ", ".join(name(int(v)) for v in found.views[:8]) + (", ..." if len(found.views) > 8 else "")
    if len(found.views) == found.total:
        what = (
            f"The {found.total} views that cameras {cameras[a]} and {cameras[b]} share contradict one another about "
            f"how the cameras stand to each other: at most {found.agreeing} of them agree ({named})."
        )
    else:
        what = (
            f"{named}: {len(found.views)} of the {found.total} views that cameras {cameras[a]} and {cameras[b]} share "
            f"contradict the {found.agreeing} that agree about how the cameras stand to each other."
        )
    if found.swapped:
        return (
            f"{what} With left and right exchanged they would agree: the two photos of these pairs are swapped. "
            "Exchange them."
        )
    return (
        f"{what} These photos were not taken at the same moment or are paired wrongly (or a camera was moved between "
        "them). Check which belong together, leave out those that do not, and hold the board still while both "
        "cameras take their photo."
    )


def _square_on(estimate: Estimate, views: TargetViews) -> str:
    """A sentence more if every target stood parallel to the image, where focal length and distance trade freely."""
    described = describe(estimate.value, views)
    seen = np.asarray(views.seen.visible).any(axis=2)
    cosines = np.abs(described.R_camera_target[..., 2, 2][seen])
    if cosines.size and cosines.min() > np.cos(np.radians(5.0)):
        return (
            " All views show the target nearly parallel to the image, which says nothing of the focal length: tilt it "
            "20-45 degrees, in different directions, in 6 or more views."
        )
    return ""


def _check_cameras(estimate: Estimate, cameras: list[str]) -> None:
    for lens, name in zip(estimate.value.shared.lenses, cameras):
        if not (float(lens.intrinsics.fx) > 0 and float(lens.intrinsics.fy) > 0):
            raise SolveError(
                f"camera {name}: the focal length came out negative. Likely cause: the numbering of the points is "
                "mirrored between the target and the image. Check the order of x and y."
            )
