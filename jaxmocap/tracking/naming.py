"""Names for tracks: the assignment of the largest probability, and how sure each name is."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment
from scipy.special import gammaln

from jaxmocap._errors import InputError
from jaxmocap.tracking.bead_colours import BeadColours, ColourDensity
from jaxmocap.tracking.light import STARTS, common_gains, light_cost, under_light

MIN_MARGIN = float(np.log(1000.0))
"""A name is given if the best explanation with it is a thousand times as probable as the best one without."""

MIN_MARGIN_ALONE = float(np.log(100.0))
"""The same for names that rest on the colour of one view: a hundred times, which is what one view can give."""

# A foreign thing can have any colour: even over the cone, whose volume is pi.
_FOREIGN = -float(np.log(np.pi))
# A foreign thing that stands in space and is found again and again is rarer than a bead by this factor.
_FOREIGN_THING = float(np.log(0.01))
_IMPOSSIBLE = 1e9


@dataclass(frozen=True)
class Names:
    """Which thing bears which name."""

    index: Int[np.ndarray, "markers"]
    """Thing of every marker, -1 where none is sure."""
    margin: Float[np.ndarray, "markers"]
    """Logarithm of the odds of the name given in the best explanation, also where it was too small to give it; zero
    where no thing was considered."""
    rival: Int[np.ndarray, "markers"]
    """The thing that was considered; -1 where none."""
    colours: BeadColours
    """References after the common change of the light."""
    gains: Float[np.ndarray, "3"]
    """Common change of red, green, blue; ones if the light is fixed."""


def name_things(
    cone: Float[np.ndarray, "things 3"],
    views: Int[np.ndarray, "things"],
    photos: int,
    support: Float[np.ndarray, "things"],
    colours: BeadColours,
    light: str = "adapt",
    min_margin: float = MIN_MARGIN,
) -> Names:
    """Names of things whose colour is known, as one decision over all of them.

    Every thing is a bead, something foreign of any colour, or (tracks) no thing at all but an accident. The names
    are the explanation of the largest probability, found by linear assignment. The margin of a name is what the best
    explanation WITHOUT it loses, so two beads of similar colour are unsure together, while a colour that only one
    bead has is sure.

    Args:
        cone: colours in the colour cone, means or medians over the views.
        views: photographs each was measured in.
        photos: photographs there are; a bead is expected in about half of them, as the figure hides it from the rest.
        support: logarithm of the odds against accident, see `tracks.chance_support`.
        colours: references.
        light: "adapt" estimates a common change of red, green and blue from all names; "fixed" takes none.
        min_margin: a name of a smaller margin is not given.

    Returns:
        Names, margins, adapted references.

    Raises:
        InputError: for another `light`.
    Source: stop-motion document, 3.3.3, made one optimal assignment; light: J. von Kries 1902 (one gain per channel).
    """
    if light not in ("adapt", "fixed"):
        raise InputError(f"light: expected 'adapt' or 'fixed', got {light!r}.")

    def costs(adapted: BeadColours, blur: float) -> tuple[np.ndarray, np.ndarray]:
        return _costs(cone, views, photos, support, adapted, blur)

    if light == "fixed" or not len(cone):
        readings = [_Reading(*costs(colours, 1.0), np.ones(3), colours)]
    else:
        readings = _read(cone, colours, costs)
    best = readings[0]
    margin = np.zeros(len(colours.names))
    for m in np.flatnonzero(best.thing >= 0):
        without = best.cost.copy()
        without[best.thing[m], m] = _IMPOSSIBLE
        margin[m] = _total(without, best.free, _assign(without, best.free)) - _total(best.cost, best.free, best.thing)
    for other in readings[1:]:  # another light under which other names fit nearly as well makes those names unsure
        differs = (best.thing >= 0) & (other.thing != best.thing)
        margin[differs] = np.minimum(margin[differs], other.total - best.total)
    index = np.where(margin >= min_margin, best.thing, -1)
    return Names(index, margin, best.thing, best.colours, best.gains)


class _Reading:
    """The best explanation under one light; `total` is minus its log probability, that of the light included."""

    def __init__(self, cost: np.ndarray, free: np.ndarray, gains: np.ndarray, colours: BeadColours) -> None:
        self.cost, self.free, self.gains, self.colours = cost, free, gains, colours
        self.thing = _assign(cost, free)
        self.total = _total(cost, free, self.thing) + light_cost(gains)


def _read(cone: np.ndarray, colours: BeadColours, costs: Callable) -> list[_Reading]:
    """The explanations that all start values of the light lead to, each once.

    At first any colour somewhat near counts, as the light is not known yet.
    """
    lights = list(STARTS)
    for blur in (3.0, 1.5, 1.0):
        distinct: dict[bytes, np.ndarray] = {}  # what names the same things has the same light
        for gains in lights:
            thing = _assign(*costs(under_light(colours, gains), blur))
            if (thing >= 0).any():
                distinct.setdefault(thing.tobytes(), common_gains(cone, colours, thing))
        lights = list(distinct.values()) or [np.ones(3)]
    readings = [_Reading(*costs(adapted, 1.0), g, adapted) for g in lights for adapted in [under_light(colours, g)]]  # pyright: ignore[reportCallIssue]
    return sorted(readings, key=lambda reading: reading.total)


def look_alike(colours: BeadColours) -> tuple[str, ...]:
    """Sentences about pairs of beads that colour cannot tell apart as surely as a name needs.

    Source: the margin of `name_things` for two tracks that have just the reference colours.
    """
    own = colours.density_of(1)
    log_density = own.log_density(colours.cone)
    said = []
    for i in range(len(colours.names)):
        for j in range(i + 1, len(colours.names)):
            straight, swapped = log_density[i, i] + log_density[j, j], log_density[i, j] + log_density[j, i]
            if straight - swapped < MIN_MARGIN:
                said.append(
                    f"{colours.names[i]} and {colours.names[j]} have nearly the same colour, so that names cannot be "
                    "sure. Repaint one of them and learn the colours anew."
                )
    return tuple(said)


def _costs(
    cone: np.ndarray, views: np.ndarray, photos: int, support: np.ndarray, colours: BeadColours, blur: float
) -> tuple[np.ndarray, np.ndarray]:
    """Cost of every name for every thing (things, markers), and of none (things,): minus log probabilities."""
    cost = np.zeros((len(cone), len(colours.names)))
    for n in np.unique(views):
        density = colours.density_of(int(n))
        density = ColourDensity(density.mean, density.covariance * blur**2, density.freedom)
        cost[views == n] = -density.log_density(cone[views == n])
    half = photos // 2  # binomial with one half, over its mode
    seen = gammaln(half + 1) + gammaln(photos - half + 1) - gammaln(views + 1) - gammaln(photos - views + 1)
    return cost - (support + seen)[:, None], -(np.logaddexp(support + _FOREIGN_THING, 0.0) + _FOREIGN)


def _assign(cost: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Thing of each marker, -1 for none, of the smallest total; a name dearer than none is not given."""
    gain = np.minimum(cost - free[:, None], 0.0)  # a pair that gains nothing stands for "none"
    rows, markers = linear_sum_assignment(gain)
    thing = np.full(cost.shape[1], -1)
    better = gain[rows, markers] < 0
    thing[markers[better]] = rows[better]
    return thing


def _total(cost: np.ndarray, free: np.ndarray, thing: np.ndarray) -> float:
    named = np.flatnonzero(thing >= 0)
    return float((cost[thing[named], named] - free[thing[named]]).sum())
