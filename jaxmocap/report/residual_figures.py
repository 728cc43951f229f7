"""Figures of what the fit left over: which photos, which directions, where in the image."""

from collections.abc import Sequence

import numpy as np

from jaxmocap.calibration.evidence import radius_px
from jaxmocap.report.canvas import (
    BLUE,
    GREY,
    HALF,
    ORANGE,
    RED,
    Axes,
    Figure,
    Picture,
    draw,
    image_axes,
    round_number,
)
from jaxmocap.report.data import CameraReport, ViewReport

_MOST_BARS = 60  # names stay readable at 12 pixels a bar


def view_rms_bars(views: Sequence[ViewReport]) -> Picture:
    """RMS of each photo, the three worst in red, and the median."""
    shown = sorted(views, key=lambda v: v.name)
    if len(shown) > _MOST_BARS:
        shown = sorted(sorted(views, key=lambda v: (-v.rms_px, v.name))[:_MOST_BARS], key=lambda v: v.name)
    rms = np.array([v.rms_px for v in shown])
    worst = np.argsort(-rms, kind="stable")[:3]
    median = float(np.median([v.rms_px for v in views]))

    def paint(figure: Figure) -> None:
        axes = figure.subplots()
        colours = [_bar_colour(value, median, i in worst) for i, value in enumerate(rms)]
        axes.bar(np.arange(len(shown)), rms, color=colours, width=0.75)
        axes.axhline(median, color="#333333", lw=1.0, ls="--")
        axes.annotate(f"median {median:.2f} px", (1.0, median), (4, 0), xycoords=("axes fraction", "data"),
                      textcoords="offset points", va="center", fontsize=8, annotation_clip=False)  # fmt: skip
        axes.set_xticks(np.arange(len(shown)), [_short(v.name) for v in shown], rotation=60, ha="right",
                        rotation_mode="anchor", fontsize=7 if len(shown) > 30 else 8)  # fmt: skip
        axes.set_xlim(-0.6, len(shown) - 0.4)
        axes.set_ylabel("RMS [px]")
        axes.grid(axis="x", visible=False)

    left_out = f" The {_MOST_BARS} worst of {len(views)} photos are shown." if len(views) > _MOST_BARS else ""
    return Picture(
        draw((9.0, 2.9), paint),
        "image/svg+xml",
        "RMS of each photo",
        "Bars of similar height are what noise does (the three largest are orange); a bar beyond three "
        "medians, red, "
        f"is a photo to look at.{left_out}",
        wide=True,
    )


def _bar_colour(rms: float, median: float, is_worst: bool) -> str:
    return RED if rms > 3 * median else ORANGE if is_worst and rms > median else BLUE


def residual_scatter(views: Sequence[ViewReport]) -> Picture:
    """All residuals, both components."""
    residual = np.concatenate([v.residual for v in views])
    reach = 1.05 * float(np.abs(residual).max(initial=1e-9))
    # A handful of bad corners must not squeeze the cloud of the others into a dot.
    typical = 6.0 * float(np.sqrt(np.median(np.sum(residual**2, axis=1)))) + 1e-9
    limit = min(reach, max(typical, 1e-9))
    outside = int(np.sum(np.abs(residual).max(axis=1) > limit))

    def paint(figure: Figure) -> None:
        axes = figure.subplots()
        axes.plot(residual[:, 0], residual[:, 1], ".", ms=3.5, alpha=0.5, color=BLUE, mew=0, rasterized=True)
        sd = residual.std(axis=0)
        angle = np.linspace(0, 2 * np.pi, 181)
        for k, style in ((1, "-"), (2, "--")):
            axes.plot(residual[:, 0].mean() + k * sd[0] * np.cos(angle),
                      residual[:, 1].mean() + k * sd[1] * np.sin(angle), style, color=RED, lw=1.2,
                      label=f"{k} sd")  # fmt: skip
        axes.axhline(0, color=GREY, lw=0.6)
        axes.axvline(0, color=GREY, lw=0.6)
        axes.set(xlim=(-limit, limit), ylim=(limit, -limit), aspect="equal")
        axes.set(xlabel="horizontal residual [px]", ylabel="vertical residual [px]")
        axes.legend(loc="upper right", title=f"sd {sd[0]:.2f}, {sd[1]:.2f} px", title_fontsize=8)

    beyond = f" {outside} points lie outside the frame." if outside else ""
    return Picture(
        draw(HALF, paint),
        "image/svg+xml",
        "Residuals",
        f"Measured minus predicted: a round cloud about zero is noise; streaks or clumps are not.{beyond}",
    )


def residual_arrows(camera: CameraReport, views: Sequence[ViewReport]) -> Picture:
    """Every residual where it was measured, exaggerated."""
    uv, residual = np.concatenate([v.uv for v in views]), np.concatenate([v.residual for v in views])
    scale = exaggeration(residual, 0.035 * max(camera.image_size))

    def paint(figure: Figure) -> None:
        axes = figure.subplots()
        image_axes(axes, camera.image_size)
        _arrows(axes, uv, residual, scale, 0.0024)
        axes.set_title(f"arrows drawn {scale:g} times too long", fontsize=8.5, loc="right", color=GREY)

    return Picture(
        draw(HALF, paint),
        "image/svg+xml",
        "Residuals over the image",
        "Arrows that agree with their neighbours mean that the lens model or the board does not fit there; "
        "noise "
        "points in every direction.",
    )


def residual_by_radius(camera: CameraReport, views: Sequence[ViewReport]) -> Picture:
    """Radial residual against the distance from the principal point, with the mean of each ring."""
    uv, residual = np.concatenate([v.uv for v in views]), np.concatenate([v.residual for v in views])
    r = radius_px(camera.K, uv)
    outward = (uv - camera.K[:2, 2]) / np.maximum(np.linalg.norm(uv - camera.K[:2, 2], axis=1), 1e-9)[:, None]
    radial = np.sum(residual * outward, axis=1)
    # Rings of equally many points, so that each mean is known equally well.
    rings = [ring for ring in np.array_split(np.argsort(r, kind="stable"), min(10, max(1, len(r) // 20))) if len(ring)]
    middle = np.array([r[ring].mean() for ring in rings])
    mean = np.array([radial[ring].mean() for ring in rings])
    error = np.array([radial[ring].std() / np.sqrt(len(ring)) for ring in rings])
    limit = 4.0 * float(np.median(np.abs(radial))) + 2.0 * float(np.abs(mean).max()) + 1e-9

    def paint(figure: Figure) -> None:
        axes = figure.subplots()
        axes.plot(r, radial, ".", ms=3.0, alpha=0.35, color=BLUE, mew=0, rasterized=True)
        axes.errorbar(middle, mean, 2 * error, fmt="o-", color=RED, ms=4, lw=1.3, capsize=2, label="mean ± 2 sigma")
        axes.axhline(0, color=GREY, lw=0.8)
        axes.set(ylim=(-limit, limit), xlabel="distance from the principal point [px]")
        axes.set_ylabel("outward residual [px]")
        axes.legend(loc="upper left")

    return Picture(
        draw(HALF, paint),
        "image/svg+xml",
        "Residual against radius",
        "The orange means stay at zero when the lens model fits; a wave means that it lacks a term.",
    )


def worst_views(views: Sequence[ViewReport]) -> Picture | None:
    """The three photos with the largest RMS, cropped to the board; None without photos."""
    with_photo = [v for v in views if v.grey is not None and len(v.uv)]
    shown = sorted(with_photo, key=lambda v: (-v.rms_px, v.name))[:3]
    if not shown:
        return None

    def paint(figure: Figure) -> None:
        for axes, view in zip(np.atleast_1d(figure.subplots(1, 3)), [*shown, None, None]):
            _photo(axes, view) if view else axes.set_axis_off()

    return Picture(
        draw((9.0, 2.85), paint, "image/jpeg"),
        "image/jpeg",
        "The photos with the largest RMS",
        "Blue rings are the corners found, orange arrows their residuals (measured minus predicted, "
        "exaggerated as "
        "stated): look for blur, glare, or a corner found in the wrong place.",
        wide=True,
    )


def _photo(axes: Axes, view: ViewReport) -> None:
    assert view.grey is not None
    low, high = view.uv.min(axis=0), view.uv.max(axis=0)
    centre, half = (low + high) / 2, 0.62 * np.maximum((high - low).max(), 16.0) * np.array([1.0, 0.86])
    scale = exaggeration(view.residual, 0.2 * float(half[0]))
    axes.imshow(view.grey, cmap="gray", vmin=0, vmax=255, interpolation="antialiased")
    axes.plot(view.uv[:, 0], view.uv[:, 1], "o", ms=5, mfc="none", mec="#35a7ff", mew=0.9)
    _arrows(axes, view.uv, view.residual, scale, 0.008, ORANGE)
    axes.set(xlim=(centre[0] - half[0], centre[0] + half[0]), ylim=(centre[1] + half[1], centre[1] - half[1]))
    axes.set_title(f"{_short(view.name, 22)}   {view.rms_px:.2f} px, arrows × {scale:g}", fontsize=8.5)
    axes.set(xticks=[], yticks=[], facecolor="#f3f3f3")
    axes.grid(False)


def _arrows(axes: Axes, uv: np.ndarray, residual: np.ndarray, scale: float, width: float, colour: str = RED) -> None:
    # angles and scale in data units: an arrow of 1 px times `scale` is `scale` px of the image long.
    geometry = {"angles": "xy", "scale_units": "xy", "scale": 1.0 / scale}
    heads = {"headwidth": 3.2, "headlength": 4, "headaxislength": 3.6, "minlength": 0}
    axes.quiver(*uv.T, *residual.T, color=colour, width=width, rasterized=True, **geometry, **heads)


def exaggeration(residual: np.ndarray, length_px: float) -> float:
    """Round factor by which residuals are drawn longer: the 90th percentile gets the given length."""
    size = float(np.quantile(np.linalg.norm(residual, axis=1), 0.9)) if len(residual) else 0.0
    return max(round_number(length_px / size), 1.0) if size > 0 else 1.0


def _short(name: str, most: int = 18) -> str:
    """A name that fits: its end tells the photos of one folder apart. Dollar signs would start a formula."""
    text = name if len(name) <= most else "…" + name[1 - most :]
    return text.replace("$", r"\$")
