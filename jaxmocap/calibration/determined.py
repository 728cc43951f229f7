"""Which parameters the data do not determine, so that they are frozen and said instead of reported as noise."""

import numpy as np

from jaxmocap._errors import SolveError
from jaxmocap.calibration.boards import parameter_names
from jaxmocap.optim import ArrowVariables
from jaxmocap.results import RESULTS, Estimate

# The order in which parameters are given up: least needed for a useful camera first. Focal lengths never are.
GIVE_UP = (("k3",), ("p1", "p2"), ("skew",), ("k2",), ("k1",), ("cx", "cy"))


def corner_radius(lens: object, image_size: tuple[int, int]) -> float:
    """Normalised radius of the image corner farthest from the image centre [1]."""
    fx, fy = abs(float(lens.intrinsics.fx)), abs(float(lens.intrinsics.fy))  # type: ignore[attr-defined]
    return float(np.hypot(0.5 * image_size[0] / max(fx, 1.0), 0.5 * image_size[1] / max(fy, 1.0)))


def _limit(name: str, radius: float, fx: float, image_size: tuple[int, int]) -> float:
    """Largest standard deviation with which a number still says anything.

    A radial coefficient moves the image corner by k r^(2j) of its radius; a lens that moved it by half could not
    be inverted there. The principal point is in the image, the skew below the focal length, for any camera.
    """
    power = {"k1": 2, "k2": 4, "k3": 6, "p1": 1, "p2": 1}
    if name in power:
        return 0.5 / max(radius, 1e-3) ** power[name]
    return {"cx": 0.5 * image_size[0], "cy": 0.5 * image_size[1], "skew": 0.5 * abs(fx)}.get(name, np.inf)


def next_to_freeze(free: ArrowVariables) -> tuple[tuple[str, ...], ...]:
    """For each camera the free parameters that are given up first; empty where only focal lengths are left."""
    out = []
    for k in range(len(free.shared.lenses)):
        mine = {n for camera, n in parameter_names(free) if camera == k}
        out.append(next((tuple(n for n in g if n in mine) for g in GIVE_UP if mine & set(g)), ()))
    return tuple(out)


def undetermined(
    estimate: Estimate, free: ArrowVariables, image_sizes: list[tuple[int, int]]
) -> tuple[tuple[str, ...], ...]:
    """Parameters to freeze next, for each camera; empty tuples when everything is determined.

    Args:
        estimate: of `refine_targets`, with covariance.
        free: what was free.
        image_sizes: (width, height) of each camera [px].

    Returns:
        names to freeze, for each camera.

    Raises:
        SolveError: if even the focal lengths alone are not determined.
    """
    names = parameter_names(free)
    if estimate.result == RESULTS.undetermined:
        more = next_to_freeze(free)
        if not any(more):
            raise SolveError(
                "The data do not determine even the focal length. "
                "Likely cause: one view, or all views parallel to the board. "
                "Tilt the board 20-45 degrees, in different directions, in 6 or more views."
            )
        return more
    sigma = np.sqrt(np.abs(np.diag(np.asarray(estimate.covariance.shared()))))
    out = []
    for k, size in enumerate(image_sizes):
        lens = estimate.value.shared.lenses[k]
        radius, fx = corner_radius(lens, size), float(lens.intrinsics.fx)
        mine = {n: s for (camera, n), s in zip(names, sigma) if camera == k}
        weak = {n for n, s in mine.items() if not s <= _limit(n, radius, fx, size)}
        out.append(next((tuple(n for n in g if n in mine) for g in GIVE_UP if weak & set(g)), ()))
    return tuple(out)
