"""Names of points from the layout of a T-pose: no colour is looked at, and no proportion of the body is assumed."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment

from jaxmocap._arrays import check_finite, check_shape
from jaxmocap.bodies.puppet import MARKERS

_CENTRE = ("head.1", "head.2", "torso.1", "torso.2")
_LEVEL = np.tan(np.radians(20.0))  # arms that rise or fall by more are not held out
_UPRIGHT = np.cos(np.radians(35.0))  # legs that lean by more do not stand
_MOST_TURNED = np.radians(60.0)  # beyond, left and front of the figure are not those of the world
_LEAST = 8  # points: half the beads; with fewer there is no layout to speak of


@dataclass(frozen=True)
class Layout:
    """Which point is which bead."""

    point: Int[np.ndarray, "markers"]
    """Point of each of `MARKERS`, -1 where none is sure."""
    turned: float
    """Angle of the figure's front from the world's z about y [rad]; positive: its left comes to the front."""
    problems: tuple[str, ...]
    """What is missing or not as in a T-pose, and what to do."""

    @property
    def complete(self) -> bool:
        """True if every bead has a point."""
        return bool((self.point >= 0).all())


def facing(
    p_world: Float[np.ndarray, "points 3"],
    centre_world: Float[np.ndarray, "photos 3"],
    seen: Bool[np.ndarray, "points photos"],
) -> tuple[float, Bool[np.ndarray, "points"]]:
    """Where the front of a figure looks, from which photographs show its beads.

    Beads sit on the front and the sides, so the cameras that see them stand on the whole before it. Cameras that
    see a point and cameras that do not are compared, so that photographs from one side only do not mislead.

    Returns:
        angle of the front from the world's z about y [rad], positive from z to x.
        False for points that are seen from behind, where the document's figure has no bead.
    Source: stop-motion document, 3.1.3 (places of the beads); the estimate is ours.
    """
    to_camera = centre_world[None] - p_world[:, None]
    to_camera = to_camera / np.linalg.norm(to_camera, axis=-1, keepdims=True)
    weight = seen - seen.mean(axis=1, keepdims=True)
    each = np.einsum("pk,pki->pi", weight, to_camera)
    x, z = each[:, 0].sum(), each[:, 2].sum()
    front = float(np.arctan2(x, z))
    along = each[:, 0] * np.sin(front) + each[:, 2] * np.cos(front)
    # The side beads of the legs look 75 degrees aside; cos 120 degrees leaves the arms room to turn.
    return front, along > -0.5 * np.hypot(each[:, 0], each[:, 2]) - 1e-9


def name_tpose(
    p_world: Float[np.ndarray, "points 3"], front: float = 0.0, views: Int[np.ndarray, "points"] | None = None
) -> Layout:
    """Names of points of a figure that stands upright with both arms held out.

    The figure is turned to the front by the line of its arms. The highest points beside the midline that lie level
    are the arms, ordered outwards; on the midline two above the arms are the head, two below them the torso; the
    rest are the legs, ordered downwards. Where a limb lacks a bead, or something foreign is taken for one, the other
    side tells which.

    Args:
        p_world: points, y up, z front, x the figure's left [scene].
        front: where its front looks, roughly, see `facing` [rad].
        views: photographs that show each point; where there is one thing too many, one that far fewer show than the
            beads is left out.

    Returns:
        Names, and what is wrong, in sentences.

    Raises:
        InputError: if the points are not finite numbers (points, 3).
    Source: stop-motion document, 3.1.3 and figure 7 (places of the beads), 3.2 (T-pose).
    """
    p = check_shape("p_world", p_world, (None, 3))
    check_finite("p_world", p, "Leave such points out.")
    none = np.full(len(MARKERS), -1)
    if len(p) < _LEAST:
        return Layout(none, front, (_few_sentence(len(p)),))
    if abs(front) > _MOST_TURNED:
        return Layout(none, front, (_turned_sentence(front),))
    turned = _arm_line(p, front)
    c, s = np.cos(turned), np.sin(turned)
    x, y = c * p[:, 0] - s * p[:, 2], p[:, 1]
    x = x - np.median(x)
    groups, problems = _groups(x, y)
    if problems:
        return Layout(none, turned, tuple(problems))
    names: dict[str, int] = {}
    shown = np.ones(len(p)) if views is None else np.asarray(views, float)
    for limb, key in (("arm", np.abs(x)), ("leg", -y)):
        left, right = (_thinned(groups[f"{limb}.{side}"], shown, 3) for side in "LR")
        _name_pair(limb, left[np.argsort(key[left])], right[np.argsort(key[right])], key, names, problems)
    arm_y = float(np.median(y[np.concatenate([groups["arm.L"], groups["arm.R"]])]))
    for pair, above in (("head", True), ("torso", False)):
        found = _thinned(groups["centre"][(y[groups["centre"]] > arm_y) == above], shown, 2)
        _name_centre(pair, found[np.argsort(-y[found])], names, problems)
    _check_pose(x, y, names, problems)
    return Layout(np.array([names.get(name, -1) for name in MARKERS]), turned, tuple(problems))


def _arm_line(p: np.ndarray, front: float) -> float:
    """Angle of the front from the direction in which the points spread most, seen from above: the arms."""
    flat = p[:, [0, 2]] - np.median(p[:, [0, 2]], axis=0)
    along = np.linalg.eigh(flat.T @ flat)[1][:, 1]
    angle = float(np.arctan2(-along[1], along[0]))  # of a left hand along (x, z) = (cos, -sin)
    return front + (angle - front + np.pi / 2) % np.pi - np.pi / 2


def _groups(x: np.ndarray, y: np.ndarray) -> tuple[dict[str, np.ndarray], list[str]]:
    """Midline, arms and legs of either side."""
    order = np.argsort(np.abs(x))
    gaps = np.diff(np.abs(x)[order])[1:7]  # two to seven points on the midline
    centre, beside = order[: int(gaps.argmax()) + 2], order[int(gaps.argmax()) + 2 :]
    down = beside[np.argsort(-y[beside])]
    arms = 0
    for n in range(1, len(down) + 1):
        span = np.ptp(np.abs(x)[down[:n]])
        if np.ptp(y[down[:n]]) <= _LEVEL * span:
            arms = n
    groups = {"centre": centre}
    for side, sign in (("L", 1), ("R", -1)):
        groups[f"arm.{side}"] = down[:arms][sign * x[down[:arms]] > 0]
        groups[f"leg.{side}"] = down[arms:][sign * x[down[arms:]] > 0]
    problems = []
    if min(len(groups["arm.L"]), len(groups["arm.R"])) < 2:
        problems.append("The arms are not held out level on both sides: this is no T-pose, or most of an arm's beads "
                        "were not found. Raise both arms sideways to the height of the shoulders.")  # fmt: skip
    return groups, problems


def _name_pair(
    limb: str, left: np.ndarray, right: np.ndarray, key: np.ndarray, names: dict[str, int], problems: list[str]
) -> None:
    """Beads of two limbs that mirror each other; `key` grows along the limb."""
    for side, mine, other, theirs in (("L", left, right, "R"), ("R", right, left, "L")):
        if len(mine) == 3:
            place = [0, 1, 2]
        elif len(other) == 3 and len(mine) > 0:
            cost = np.abs(key[mine][:, None] - key[other][None])
            rows, columns = linear_sum_assignment(cost)
            spacing = np.diff(key[other]).min()
            place = [-1] * len(mine)
            for row, column in zip(rows, columns):
                place[row] = int(column) if cost[row, column] < 0.5 * spacing else -1
        else:
            place = [-1] * len(mine)
        for i, k in zip(mine, place):
            if k >= 0:
                names[f"{limb}.{side}{k + 1}"] = int(i)
        lost = [f"{limb}.{side}{k + 1}" for k in range(3) if k not in place]
        if lost and any(k >= 0 for k in place):
            problems.append(f"{', '.join(lost)}: not found. Check that it is on the figure, clean and in the light.")
        elif lost:
            problems.append(
                f"{limb}.{side}1 to {limb}.{side}3: {len(mine)} beads where 3 belong, and {limb}.{theirs} does not "
                "tell which are which. Check both limbs and take away what is no bead."
            )
        if len(mine) > 3:
            problems.append(f"{len(mine) - 3} more things than beads on {limb}.{side}. Take away what is no bead.")


def _name_centre(pair: str, found: np.ndarray, names: dict[str, int], problems: list[str]) -> None:
    """Head or torso from the top down; with one missing nothing tells which."""
    if len(found) == 2:
        names[f"{pair}.1"], names[f"{pair}.2"] = map(int, found)
    else:
        side = "above" if pair == "head" else "below"
        problems.append(
            f"{pair}.1, {pair}.2: {len(found)} beads on the midline {side} the arms where 2 belong. Check that both "
            "are on the figure and nothing else is taken for a bead."
        )


def _thinned(group: np.ndarray, views: np.ndarray, count: int) -> np.ndarray:
    """A group without what is too many, if far fewer photographs show that than the rest."""
    best = group[np.argsort(-views[group], kind="stable")]
    if len(best) > count and views[best[count]] < 0.6 * views[best[count - 1]]:
        return best[:count]
    return group


def _check_pose(x: np.ndarray, y: np.ndarray, names: dict[str, int], problems: list[str]) -> None:
    """Take back the names if the figure does not stand as in a T-pose."""
    wrong = []
    for side in "LR":
        leg = [names.get(f"leg.{side}{i}") for i in (1, 2, 3)]
        known = [i for i in leg if i is not None]
        if len(known) >= 2:
            fall, aside = y[known[0]] - y[known[-1]], x[known[-1]] - x[known[0]]
            if fall < _UPRIGHT * np.hypot(fall, aside):
                wrong.append(f"leg.{side} does not point down")
    hips = [y[names[n]] for n in ("leg.L1", "leg.R1") if n in names]
    trunk = [y[names[n]] for n in _CENTRE if n in names]
    if hips and trunk and min(trunk) < min(hips):
        wrong.append("a bead of head or torso lies under the thighs")
    if wrong:
        names.clear()
        problems[:] = [f"This is no T-pose: {' and '.join(wrong)}. Stand the figure upright with both arms held out."]


def _few_sentence(count: int) -> str:
    return (
        f"Only {count} beads were found in space, {len(MARKERS)} are on the figure. Check light, sharpness and that "
        "the photographs show the whole figure."
    )


def _turned_sentence(front: float) -> str:
    return (
        f"The figure looks {np.degrees(front):.0f} degrees away from the camera at stated angle 0, where its front "
        "belongs. Turn it to face the camera there, or check the angles in the file names."
    )
