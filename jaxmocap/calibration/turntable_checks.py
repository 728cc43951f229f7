"""What the angles of the photos say about how the turntable was turned. Plain numbers, degrees, sentences."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from jaxmocap.calibration.evidence import Weakness

Angles = TypeVar("Angles", float, np.ndarray)


@dataclass(frozen=True)
class Steps:
    """How the measured angles follow the stated ones."""

    deviation_deg: np.ndarray
    """(photos,) measured minus stated, in [-180, 180); zero for the photo that holds the zero."""
    mean_factor: float | None
    """Mean measured step over stated step; None with fewer than three different angles."""
    sigma_mean_factor: float | None
    spread_deg: float | None
    """Standard deviation of the single photo about the mean steps."""


def wrap_deg(a: Angles) -> Angles:
    """Angles in [-180, 180)."""
    return (a + 180.0) % 360.0 - 180.0


def smallest_step(stated_deg: np.ndarray) -> float:
    """Smallest difference between two different stated angles, around the circle; 360 if there is only one."""
    a = np.unique(np.round(np.asarray(stated_deg, float) % 360.0, 6))
    return 360.0 if len(a) < 2 else float(np.min(np.diff(np.append(a, a[0] + 360.0))))


def _off_most(difference: np.ndarray) -> np.ndarray:
    """Differences from the value that most share (the one with the least sum of distances), wrapped."""
    around = np.abs(wrap_deg(difference[:, None] - difference[None, :])).sum(axis=0)
    return wrap_deg(difference - difference[int(np.argmin(around))])


def turned_the_other_way(stated_deg: np.ndarray, measured_deg: np.ndarray) -> bool:
    """Whether minus the stated angles explain the measured ones, and the stated ones themselves do not.

    A photo is explained if it is off by less than half the smallest step, where it would pass for its neighbour.

    Args:
        stated_deg: (photos,).
        measured_deg: (photos,).

    Returns:
        True if all but a quarter of the photos are explained by turning the other way, and fewer by the right way.
    Source: majority of angles; half a step is where a photo passes for its neighbour.
    """
    half = 0.5 * smallest_step(stated_deg)
    with_it = np.sum(np.abs(_off_most(measured_deg - stated_deg)) < half)
    against = np.sum(np.abs(_off_most(measured_deg + stated_deg)) < half)
    return bool(against > with_it and against >= 0.75 * len(stated_deg))


def steps(stated_deg: np.ndarray, measured_deg: np.ndarray, held: int, sigma_deg: np.ndarray) -> Steps:
    """Deviations and mean step.

    Args:
        stated_deg: (photos,).
        measured_deg: (photos,).
        held: photo whose stated angle was kept.
        sigma_deg: (photos,) of the measured ones.

    Returns:
        Steps.
    Source: straight line through the origin by least squares.
    """
    off = wrap_deg(measured_deg - stated_deg)
    x = wrap_deg(stated_deg - stated_deg[held])
    others = np.abs(x) > 1e-9
    if others.sum() < 2:
        return Steps(off, None, None, None)
    x, y = x[others], off[others]
    slope = float(x @ y / (x @ x))
    spread = float(np.sqrt(np.sum((y - slope * x) ** 2) / (len(x) - 1)))
    # Steps set by hand scatter by more than they are measured; both are in `spread`, but two photos say little of it.
    each = max(spread, float(np.median(sigma_deg[others])))
    return Steps(off, 1.0 + slope, each / float(np.sqrt(x @ x)), spread)


def check_angles(
    names: Sequence[str], stated_deg: np.ndarray, measured_deg: np.ndarray, sigma_deg: np.ndarray, held: int
) -> list[Weakness]:
    """Everything odd about the angles, in sentences.

    Args:
        names: of the photos.
        stated_deg: (photos,).
        measured_deg: (photos,).
        sigma_deg: (photos,) of the measured ones.
        held: photo whose stated angle was kept.

    Returns:
        Weaknesses, none of which makes the axis wrong: every photo has its measured angle.
    Source: faults of a turntable turned by hand.
    """
    half = 0.5 * smallest_step(stated_deg)
    off = _off_most(measured_deg - stated_deg)
    wrong = [i for i in range(len(names)) if abs(off[i]) >= half]
    found = _exchanged(names, stated_deg, off, wrong, half) if wrong else []
    found += _not_turned(names, stated_deg, measured_deg, half, {w for w in wrong})
    if wrong and not found:
        said = ", ".join(f"{names[i]} by {off[i]:+.1f}" for i in wrong[:6])
        found.append(
            Weakness(
                "wrong-angle",
                "warning",
                f"Measured angles differ from the names by half a step or more: {said} degrees.",
                "Take these photos again at their angle, or rename them.",
            )
        )
    if held in wrong:
        found.append(
            Weakness(
                "wrong-zero",
                "warning",
                f"{names[held]}, whose stated angle is the zero of all others, is itself off by {off[held]:+.1f} "
                "degrees from what most photos say.",
                "Correct its name; the axis is right all the same, but all angles are shifted.",
            )
        )
    if not wrong:
        found += _mean_step(steps(stated_deg, measured_deg, held, sigma_deg), stated_deg)
    return found + _named_twice(names, stated_deg)


def _exchanged(
    names: Sequence[str], stated: np.ndarray, off: np.ndarray, wrong: list[int], half: float
) -> list[Weakness]:
    """Pairs of photos each of which stands at the other's stated angle."""
    found = []
    for a, i in enumerate(wrong):
        for j in wrong[a + 1 :]:
            # off is measured - stated - (what most share): at the other's angle it is the difference of the two.
            apart = wrap_deg(np.array([stated[i] + off[i] - stated[j], stated[j] + off[j] - stated[i]]))
            if np.abs(apart).max() < half:
                found.append(
                    Weakness(
                        "exchanged",
                        "warning",
                        f"{names[i]} and {names[j]} are exchanged: each shows the angle in the other's name.",
                        "Exchange their names.",
                    )
                )
    return found


def _not_turned(
    names: Sequence[str], stated: np.ndarray, measured: np.ndarray, half: float, wrong: set[int]
) -> list[Weakness]:
    """Photos in order of their stated angles between which the turntable stood still."""
    order = np.argsort(stated % 360.0, kind="stable")
    found = []
    for i, j in zip(order, order[1:]):
        said, seen = stated[j] % 360.0 - stated[i] % 360.0, float(wrap_deg(measured[j] - measured[i]))
        if said > 1e-6 and (i in wrong or j in wrong) and abs(seen) < half:
            found.append(
                Weakness(
                    "not-turned",
                    "warning",
                    f"From {names[i]} to {names[j]} the turntable turned by {seen:.2f} degrees instead of {said:g}.",
                    "Take the later one again, or rename it and all after it.",
                )
            )
    return found


def _mean_step(found: Steps, stated: np.ndarray) -> list[Weakness]:
    if found.mean_factor is None or found.sigma_mean_factor is None:
        return []
    if abs(found.mean_factor - 1.0) <= 3.0 * found.sigma_mean_factor:
        return []
    step = smallest_step(stated)
    return [
        Weakness(
            "mean-step",
            "note",
            f"The steps are {found.mean_factor * step:.3f} +- {found.sigma_mean_factor * step:.3f} degrees on average "
            f"instead of {step:g}.",
            "The measured angles are used; check the scale of the turntable if it should not be so.",
        )
    ]


def _named_twice(names: Sequence[str], stated: np.ndarray) -> list[Weakness]:
    found = []
    for i in range(len(names)):
        same = [j for j in range(i + 1, len(names)) if abs(wrap_deg(stated[j] - stated[i])) < 1e-6]
        if same:
            found.append(
                Weakness(
                    "angle-twice",
                    "warning",
                    f"{names[i]} and {names[same[0]]} are both said to be at {stated[i]:g} degrees.",
                    "Both are used, each with its measured angle; rename or remove one if that was not meant.",
                )
            )
    return found


def missing_angles(stated_deg: np.ndarray) -> list[float]:
    """Angles left out of an otherwise regular series of stated angles.

    Args:
        stated_deg: of all photos that were given.

    Returns:
        Multiples of the smallest step that lie between photos; empty if angles are no multiples of it, or if more are
        missing than there are (then it is a part of the circle that was photographed, not a series with gaps).
    Source: regular steps.
    """
    a = np.unique(np.round(np.asarray(stated_deg, float) % 360.0, 6))
    step = smallest_step(a)
    if len(a) < 3 or abs(round(360.0 / step) - 360.0 / step) > 1e-6:
        return []
    k = (a - a[0]) / step
    if np.any(np.abs(k - np.round(k)) > 1e-6):
        return []
    there = set(np.round(k).astype(int))
    absent = [int(i) for i in range(round(360.0 / step)) if i not in there]
    return sorted(float((a[0] + i * step) % 360.0) for i in absent) if len(absent) < len(there) else []
