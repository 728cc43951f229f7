"""What is weak about the data behind a calibration: the faults that a small reprojection error hides.

A camera calibrated from ten photos taken square to the board reprojects to 0.27 px and may be wrong by a
factor of ten. Each check looks at one such cause, says it with its numbers, and names the next step.
Thresholds are arguments, not fits: each states its reason, and tests/unit/calibration/test_weakness.py
simulates the data that must and must not be flagged.
"""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from jaxmocap.calibration.evidence import (
    CameraEvidence,
    SeenView,
    Severity,
    Weakness,
    board_shift,
    covered_fraction,
    image_corners,
    radius_px,
    tilt_worth,
)

_RANK: dict[Severity, int] = {"serious": 0, "warning": 1, "note": 2}


def find_weaknesses(evidence: CameraEvidence) -> tuple[Weakness, ...]:
    """Everything that speaks against one calibrated camera, the most serious first.

    Args:
        evidence: the camera and its photos.

    Returns:
        Empty if nothing was found.
    """
    if not (np.all(np.isfinite(evidence.K)) and np.all(np.isfinite(evidence.distortion))):
        return (_not_finite(evidence),)
    found = [w for check in _CHECKS for w in check(evidence)]
    if evidence.label:
        found = [Weakness(w.code, w.severity, f"{evidence.label}: {w.sentence}", w.next_step) for w in found]
    return tuple(sorted(found, key=lambda w: _RANK[w.severity]))


_Found = Iterator[Weakness]
_TILT_STEP = "Tilt the board 20-45 degrees, in different directions, in 6 or more views."


def _not_finite(e: CameraEvidence) -> Weakness:
    return Weakness(
        "not-finite",
        "serious",
        f"{e.label + ': ' if e.label else ''}The solution holds numbers that are not finite.",
        "Look for NaN or infinite corner coordinates in the input, and calibrate again.",
    )


def _few_views(e: CameraEvidence) -> _Found:
    """Each view of a plane gives 2 equations for fx, fy, cx, cy (Zhang 2000, 3.1).

    1 view is too few, 2 are just enough and test nothing, and among 3 a bad one cannot be told.
    """
    n = len(e.views)
    if not e.planar or n > 3:
        return
    views = "1 view gives" if n == 1 else f"{n} views give"
    yield Weakness(
        "few-views",
        "serious" if n < 2 else "warning",
        f"{views} {2 * n} equations for the 4 numbers of the camera matrix"
        + (": they cannot all be found." if n < 2 else ", too few to show a bad one among them."),
        "Take 10 to 20 photos of the board, tilted differently and spread over the whole image.",
    )


def _fronto_parallel(e: CameraEvidence) -> _Found:
    """Less than one well-tilted view's worth leaves the focal length to the noise.

    Six views at 15 degrees make 1.0, six at 20 degrees 2.3. Below a tenth df/f is three times larger again;
    ten square-on views, which noise makes look tilted by 3 degrees, make 0.006.
    """
    tilts = np.array([v.tilt_deg for v in e.views])
    if not e.planar or len(tilts) < 2 or tilt_worth(tilts) >= 1.0:
        return
    worth = tilt_worth(tilts)
    yield Weakness(
        "fronto-parallel",
        "serious" if worth < 0.1 else "warning",
        f"The board is seen almost square-on (tilt {tilts.min():.0f} to {tilts.max():.0f} degrees in "
        f"{len(tilts)} "
        f"views): for the focal length they are worth {worth:.1g} views tilted by 30 degrees.",
        _TILT_STEP,
    )
    depths = np.array([v.depth for v in e.views])
    # Square-on views at different distances at least fix the principal point, as the centre of the zoom.
    if depths.min() > 0 and depths.max() < 1.2 * depths.min():
        yield Weakness(
            "one-depth",
            "warning",
            f"Besides, all views are at nearly one distance ({_length(depths.min(), e)} to "
            f"{_length(depths.max(), e)}).",
            "Take photos at distances that differ by a factor of 1.5 or more.",
        )


def _one_direction(e: CameraEvidence) -> _Found:
    """Boards parallel to each other count as one (Zhang 2000, 3.1).

    Tilts within one quadrant let the principal point and the tilt stand in for each other: simulated, sigma
    of the principal point is three times that of tilts all around.
    """
    tilted = [v.tilt_direction_deg for v in e.views if v.tilt_deg >= 10.0]
    if not e.planar or len(tilted) < 4 or len(tilted) < len(e.views) / 2:
        return
    angles = np.sort(np.mod(tilted, 360.0))
    gaps = np.diff(np.append(angles, angles[0] + 360.0))
    if gaps.max() <= 270.0:
        return
    middle = np.mod(angles[(int(gaps.argmax()) + 1) % len(angles)] + (360.0 - gaps.max()) / 2, 360.0)
    word = ("right", "bottom right", "bottom", "bottom left", "left", "top left", "top", "top right")
    yield Weakness(
        "one-tilt-direction",
        "warning",
        f"All {len(tilted)} tilted views recede in nearly the same direction (within "
        f"{360.0 - gaps.max():.0f} "
        f"degrees, towards the {word[int(np.round(middle / 45.0)) % 8]} of the image).",
        "Tilt the board also to the other side, up and down.",
    )


def _coverage(e: CameraEvidence) -> _Found:
    """Where no corner was seen, nothing tests the lens model: below half of the image that is most of it.

    A board that never left one half of the width and one half of the height covers a quarter at most.
    """
    if not e.views:
        return
    covered = covered_fraction(e.image_size, [v.uv for v in e.views])
    if covered < 0.5:
        yield Weakness(
            "coverage",
            "warning" if covered < 0.25 else "note",
            f"The board was seen in only {100 * covered:.0f} % of the image.",
            "Move the board to the edges and corners of the image, or closer to the camera.",
        )
    yield from _extrapolation(e)


def _extrapolation(e: CameraEvidence) -> _Found:
    """A term r^n fitted up to the outermost corner carries its error out as (r_corner / r_outermost)^n.

    Ten-fold turns the 0.1 px of a good corner fit into a pixel.
    """
    free = [n for name, n in (("k1", 3), ("k2", 5), ("k3", 7)) if name in e.sigma]
    uv = np.concatenate([v.uv for v in e.views])
    if not free or not len(uv):
        return
    reached, corner = radius_px(e.K, uv).max(), radius_px(e.K, image_corners(e.image_size)).max()
    growth = (corner / reached) ** free[-1]
    if growth > 10.0:
        yield Weakness(
            "extrapolated-lens",
            "warning",
            f"The outermost board corner lies {reached:.0f} px from the principal point, the image corner "
            f"{corner:.0f} px: errors of the k{len(free)} term grow {growth:.0f} times between the two.",
            "Take photos with the board reaching into the corners of the image, or use fewer distortion terms.",
        )


def _focal_sigma(e: CameraEvidence) -> _Found:
    """A focal length off by 1 % puts every distance off by 1 %: 10 mm in a metre; 10 % is no measurement."""
    for name, value in (("fx", e.K[0, 0]), ("fy", e.K[1, 1])):
        relative = e.sigma.get(name, 0.0) / abs(value) if value else np.inf
        if not relative <= 0.01:
            yield Weakness(
                "focal-uncertain",
                "serious" if not relative <= 0.1 else "warning",
                f"{name} = {value:.1f} px is known only to {100 * relative:.2g} %, and so is every distance "
                "that this "
                "camera measures."
                if np.isfinite(relative)
                else f"{name} = {value:.1f} px is not determined by these photos.",
                _TILT_STEP,
            )
            return  # fy repeats what fx says


def _undetermined_lens(e: CameraEvidence) -> _Found:
    """Within two sigma of zero, a coefficient may as well be left out."""
    values: dict[str, float] = dict(zip(("k1", "k2", "p1", "p2", "k3"), e.distortion.tolist()))
    weak = [n for n, v in values.items() if e.sigma.get(n, 0.0) > 0 and abs(v) < 2.0 * e.sigma[n]]
    if weak:
        listed = ", ".join(f"{n} = {values[n]:.2g} with sigma {e.sigma[n]:.2g}" for n in weak)
        yield Weakness(
            "lens-term-near-zero",
            "note",
            f"Not told apart from zero: {listed}.",
            "If a model with fewer terms (--distortion) has nearly the same RMS, prefer it.",
        )


def _clearly(difference: float, *sigmas: float | None) -> bool:
    """Whether a difference exceeds three standard deviations (unknown ones count as zero)."""
    return bool(abs(difference) > 3.0 * np.hypot.reduce([s or 0.0 for s in (*sigmas, 0.0)]))


def _aspect(e: CameraEvidence) -> _Found:
    """Pixels are made square by lithography, far better than 1 %; analogue video had 0.91, 1.07 or 1.09."""
    fx, fy = e.K[0, 0], e.K[1, 1]
    if min(fx, fy) <= 0:
        yield Weakness(
            "focal-sign", "serious", f"A focal length is not positive: fx = {fx:.4g} px, fy = {fy:.4g} px.",
            "Check the order of the board's corners and the board size.",
        )  # fmt: skip
        return
    if abs(fx / fy - 1.0) > 0.01 and _clearly(fx - fy, e.sigma.get("fx"), e.sigma.get("fy")):
        yield Weakness(
            "aspect",
            "serious" if max(fx / fy, fy / fx) > 2.0 else "warning",
            f"fx / fy = {fx / fy:.3f}, but pixels of today's cameras are square (1.000).",
            "Check that the photos were not stretched or resized, and the order columns x rows of the board.",
        )


def _principal_point(e: CameraEvidence) -> _Found:
    """A tenth of the image is ten times the mounting tolerance of a lens (0.05 mm on a sensor of 5 mm).

    More is a cropped photo, swapped axes, or a point that the views do not determine.
    """
    (w, h), c = e.image_size, e.K[:2, 2]
    centre = np.array([(w - 1) / 2, (h - 1) / 2])
    if not (-0.5 <= c[0] <= w - 0.5 and -0.5 <= c[1] <= h - 0.5):
        yield Weakness(
            "principal-point-outside", "serious",
            f"The principal point ({c[0]:.0f}, {c[1]:.0f}) px lies outside the image of {w} x {h} px.",
            "Check that the stated image size is that of the photos, and that x and y are not swapped.",
        )  # fmt: skip
        return
    off = np.abs(c - centre) / (w, h)
    clear = [o > 0.1 and _clearly(d, e.sigma.get(n)) for o, d, n in zip(off, c - centre, ("cx", "cy"))]
    if not any(clear):
        return
    # Towards the centre of the turned image by more than half of the way: the axes are swapped.
    swapped = w != h and np.linalg.norm(c - centre[::-1]) < 0.5 * np.linalg.norm(c - centre)
    yield Weakness(
        "swapped-axes" if swapped else "principal-point-off-centre",
        "serious" if swapped else "warning",
        f"The principal point ({c[0]:.0f}, {c[1]:.0f}) px is far from the image centre ({centre[0]:.0f}, "
        f"{centre[1]:.0f}) px" + (f" and fits an image of {h} x {w} px." if swapped else "."),
        "Check whether x and y (or width and height) are swapped." if swapped
        else "If the photos are not cropped, take more views tilted in all directions.",
    )  # fmt: skip


def _field_of_view(e: CameraEvidence) -> _Found:
    """3 degrees is a 700 mm lens on full frame; beyond 150 degrees lenses are fisheyes, no pinholes."""
    if e.K[0, 0] <= 0:
        return
    angle = 2.0 * np.degrees(np.arctan(e.image_size[0] / 2 / e.K[0, 0]))
    if not 3.0 <= angle <= 150.0:
        yield Weakness(
            "field-of-view",
            "serious",
            f"fx = {e.K[0, 0]:.0f} px means a horizontal field of view of {angle:.1f} degrees, which is "
            "hardly "
            "this camera's.",
            _TILT_STEP if angle < 3.0 else "Check the board size; a fisheye lens needs another lens model.",
        )


def _fold_back(e: CameraEvidence) -> _Found:
    """Outside the fold no ray is seen there by the model, so those pixels cannot be used at all."""
    if e.valid_radius_px is None or not np.isfinite(e.valid_radius_px) or not e.views:
        return
    corner = radius_px(e.K, image_corners(e.image_size)).max()
    reached = radius_px(e.K, np.concatenate([v.uv for v in e.views])).max()
    if e.valid_radius_px >= corner:
        return
    inside = e.valid_radius_px < reached
    yield Weakness(
        "lens-folds-back",
        "serious" if inside else "warning",
        f"The fitted lens folds back {e.valid_radius_px:.0f} px from the principal point, inside the image "
        "(corner "
        f"at {corner:.0f} px)" + (f" and inside the board corners (up to {reached:.0f} px)." if inside else "."),
        "Calibrate with fewer distortion terms, or with photos that reach into the image corners.",
    )


def _bad_view(e: CameraEvidence) -> _Found:
    """By chance the RMS of n corners varies by 1 / sqrt(4 n), 7 % for 54: three times is no chance."""
    rms = np.array([v.rms_px for v in e.views])
    if len(rms) < 3:
        return
    median = float(np.median(rms))
    bad = [v for v in sorted(e.views, key=lambda v: (-v.rms_px, v.name)) if v.rms_px > 3.0 * median]
    if bad:
        yield Weakness(
            "bad-view",
            "warning",
            f"{_names([f'{v.name} ({v.rms_px:.2f} px)' for v in bad])}: far above the median of the views "
            f"({median:.2f} px).",
            "Look at the corners found there; leave the photo out, or calibrate with --robust.",
        )


def _duplicates(e: CameraEvidence) -> _Found:
    """Corners that moved by less than 1 % of the board's size give the same equations to 1 %.

    Such a view repeats the errors of the other (lens, board, blur) while the sigmas shrink as if it were new.
    """
    groups: list[list[SeenView]] = []
    for view in e.views:
        home = next((g for g in groups if board_shift(g[0].uv, view.uv) < 0.01), None)
        if home is None:
            groups.append([view])
        else:
            home.append(view)
    repeated = [g for g in groups if len(g) > 1]
    if repeated:
        listed = "; ".join(_names([v.name for v in g]) for g in repeated)
        extra = len(e.views) - len(groups)
        yield Weakness(
            "duplicate-views",
            "serious" if e.planar and len(groups) < 2 else "warning",
            f"{len(e.views)} views are only {len(groups)} different ones, the sigmas are therefore too "
            "small. "
            f"(Nearly) the same: {listed}.",
            f"Leave out the {extra} repeated photo{'s' if extra > 1 else ''}; take new ones with the board elsewhere.",
        )


def _large_rms(e: CameraEvidence) -> _Found:
    """Board corners are found to about 0.1 px; ten times that is not noise."""
    if not e.rms_px <= 1.0:
        yield Weakness(
            "large-rms",
            "warning",
            f"The RMS of {e.rms_px:.2f} px is far above the 0.1 to 0.5 px of a sharp board."
            if np.isfinite(e.rms_px)
            else "The RMS is not finite.",
            "Check the board size (inner corners), its flatness and the sharpness of the photos.",
        )


_MILLIMETRES = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4}


def _square_size(e: CameraEvidence) -> _Found:
    """Only a question: the images cannot tell a small near board from a large far one."""
    if e.square is None or e.unit not in _MILLIMETRES:
        return
    size = e.square * _MILLIMETRES[e.unit]
    if not 1.0 <= size <= 500.0:
        yield Weakness(
            "square-size",
            "note",
            f"Is a square of the board really {_length(e.square, e)} wide? The photos cannot tell, and all "
            "lengths "
            "scale with it.",
            "Measure ten squares with a ruler, divide by ten, and give that with its unit (--square 25mm).",
        )


def _lens_misfit(e: CameraEvidence) -> _Found:
    """Residuals that go together within a photo make the sigmas per photo larger than those per corner.

    From 5 views on, chance alone spreads this ratio by 1 / sqrt(2 (5 - 1)) = 35 %: 2 is 3 sigma. The sigmas allow
    for what differs from photo to photo, but not for what all photos share: a bent board moves every estimate the
    same way. n corners then count as n / ratio^2, and below 4 no homography is left of a photo.
    """
    ratio = {n: e.sigma[n] / p for n, p in e.sigma_plain.items() if p > 0 and n in e.sigma}
    name = max(ratio, key=lambda n: ratio[n], default=None)
    if len(e.views) < 5 or name is None or not ratio[name] > 2.0:
        return
    worth = float(np.mean([len(v.uv) for v in e.views])) / ratio[name] ** 2
    yield Weakness(
        "correlated-residuals",
        "warning",
        f"The residuals within a photo go together: sigma of {name} is {ratio[name]:.1f} times what independent "
        f"errors would give; a photo counts like {worth:.0f} independent corners.",
        "The sigmas allow for what differs between photos, not for a bent board. Check that it is flat; look at the "
        "residual arrows; try more lens terms.",
    )


def _length(value: float, e: CameraEvidence) -> str:
    return f"{value:.4g}" + ("" if e.unit == "1" else f" {e.unit}")


def _names(names: Sequence[str]) -> str:
    """Up to four names in full, the others counted."""
    return ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")


_CHECKS: tuple[Callable[[CameraEvidence], _Found], ...] = (
    _few_views, _duplicates, _fronto_parallel, _one_direction, _focal_sigma, _aspect, _principal_point,
    _field_of_view, _fold_back, _coverage, _bad_view, _large_rms, _lens_misfit, _square_size,
    _undetermined_lens,
)  # fmt: skip
