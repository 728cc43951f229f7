"""Figures of what the photos show of the camera: coverage, tilts and distances, lens curve, correlations."""

from collections.abc import Sequence

import numpy as np

from jaxmocap.calibration.evidence import convex_outline, covered_fraction, image_corners, radius_px, real_radius_px
from jaxmocap.report.canvas import (
    BLUE,
    GREEN,
    GREY,
    HALF,
    ORANGE,
    RED,
    Axes,
    Figure,
    Picture,
    draw,
    image_axes,
)
from jaxmocap.report.data import CameraReport, ViewReport


def coverage_map(camera: CameraReport, views: Sequence[ViewReport]) -> Picture:
    """Where the board was seen."""
    share = 100 * covered_fraction(camera.image_size, [v.uv for v in views])
    uv = np.concatenate([v.uv for v in views])

    def paint(figure: Figure) -> None:
        axes = figure.subplots()
        for view in views:
            outline = convex_outline(view.uv)
            axes.fill(*outline.T, facecolor=BLUE, alpha=min(0.16, 1.6 / len(views)), lw=0)
            axes.fill(*outline.T, facecolor="none", edgecolor=BLUE, lw=0.6, alpha=0.7)
        axes.plot(uv[:, 0], uv[:, 1], ".", ms=2.0, color="#1d3d5c", mew=0, rasterized=True)
        axes.plot(*camera.K[:2, 2], "+", color=RED, ms=10, mew=1.5, label="principal point")
        image_axes(axes, camera.image_size)
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0, handletextpad=0.2)

    return Picture(
        draw(HALF, paint),
        "image/svg+xml",
        f"Coverage: {share:.0f} % of the image",
        "Each outline goes around the points of one photo; empty areas, above all the corners, are where nothing "
        "tests the "
        "lens model.",
    )


def tilts_and_depths(views: Sequence[ViewReport], unit: str) -> Picture:
    """Tilt and its direction, and the distances of the board."""

    def paint(figure: Figure) -> None:
        axes = figure.add_subplot(1, 2, 1, projection="polar")
        _paint_tilts(axes, views)
        _paint_depths(figure.add_subplot(1, 2, 2), views, unit)

    return Picture(
        draw((9.0, 3.6), paint),
        "image/svg+xml",
        "How the board was held",
        "Left: distance from the centre is the tilt, the angle is where the board recedes in the image; "
        "dots all "
        "around beyond the dashed circle (20°) fix the focal length. Right: the distances should differ.",
        wide=True,
    )


def _paint_tilts(axes: Axes, views: Sequence[ViewReport]) -> None:
    tilt = np.array([v.tilt_deg for v in views])
    direction = np.radians([v.tilt_direction_deg for v in views])
    axes.set_theta_direction(-1)  # type: ignore[attr-defined] # v points down, as in the image
    axes.plot(np.linspace(0, 2 * np.pi, 181), np.full(181, 20.0), "--", color=ORANGE, lw=1.2)
    axes.plot(direction, tilt, "o", ms=6, color=BLUE, alpha=0.8, mec="white", mew=0.6)
    top = max(45.0, 5.0 * np.ceil(1.08 * tilt.max(initial=0.0) / 5.0))
    axes.set_ylim(0, top)
    rings = [15, 30, 45] if top < 60 else [20, 40, 60, 80]
    axes.set_yticks(rings, [f"{r}°" for r in rings], fontsize=7.5)
    axes.set_rlabel_position(-22.5)  # type: ignore[attr-defined]
    axes.set_xticks(np.radians([0, 90, 180, 270]), ["right", "down", "left", "up"])
    axes.set_title("tilt and its direction", fontsize=9)


def _paint_depths(axes: Axes, views: Sequence[ViewReport], unit: str) -> None:
    """Distance against tilt, one dot per photo: a histogram would hide how few photos there are."""
    depth, tilt = np.array([v.depth for v in views]), np.array([v.tilt_deg for v in views])
    axes.plot(depth, tilt, "o", ms=6, color=BLUE, alpha=0.8, mec="white", mew=0.6)
    axes.set_xlim(0, 1.1 * float(depth.max(initial=1e-9)))
    axes.set_ylim(0, max(45.0, 1.08 * float(tilt.max(initial=0.0))))
    axes.set_xlabel("distance of the board" + (" [board units]" if unit == "1" else f" [{unit}]"))
    axes.set_ylabel("tilt [degrees]")
    axes.set_title("distance and tilt", fontsize=9)


def distortion_curve(camera: CameraReport, views: Sequence[ViewReport]) -> Picture:
    """Displacement by the lens against the radius, with its uncertainty and the radii that matter."""
    corner = float(radius_px(camera.K, image_corners(camera.image_size)).max())
    reached = float(radius_px(camera.K, np.concatenate([v.uv for v in views])).max())
    ideal = _ideal_radii(camera, 1.04 * corner)
    focal = float(np.sqrt(abs(camera.K[0, 0] * camera.K[1, 1])))
    real = real_radius_px(camera.K, camera.distortion, ideal)
    shift, sigma = real - focal * ideal, focal * _radial_sigma(camera, ideal)

    def paint(figure: Figure) -> None:
        axes = figure.subplots()
        axes.fill_between(real, shift - 2 * sigma, shift + 2 * sigma, color=BLUE, alpha=0.2, lw=0,
                          label="± 2 sigma")  # fmt: skip
        axes.plot(real, shift, color=BLUE, lw=1.8)
        axes.axhline(0, color=GREY, lw=0.8)
        marks = [(reached, GREEN, "-.", "outermost board corner"), (corner, "#333333", "-", "image corner")]
        if camera.valid_radius_px is not None and camera.valid_radius_px < 1.5 * corner:
            marks.append((camera.valid_radius_px, RED, ":", "lens folds back"))
        for where, colour, style, label in marks:
            axes.axvline(where, color=colour, ls=style, lw=1.3, label=f"{label}, {where:.0f} px")
        axes.set_xlim(0, 1.04 * max(where for where, *_ in marks))
        axes.set(xlabel="distance from the principal point [px]", ylabel="displacement [px]")
        axes.legend(loc="best")

    return Picture(
        draw(HALF, paint),
        "image/svg+xml",
        "What the lens does",
        "How far the lens moves a point outwards (+) or inwards (−); beyond the green line no corner tested it.",
    )


def _ideal_radii(camera: CameraReport, real_limit: float) -> np.ndarray:
    """Ideal normalised radii whose real radius rises to a limit [px], or to where the lens folds back."""
    focal = float(np.sqrt(abs(camera.K[0, 0] * camera.K[1, 1])))
    radii = np.linspace(0.0, 3.0 * real_limit / focal, 1500)
    real = real_radius_px(camera.K, camera.distortion, radii)
    ends = np.flatnonzero((real > real_limit) | (np.diff(real, append=np.inf) <= 0))
    # 150 points draw a smooth curve; 1500 are for finding its end.
    return np.linspace(0.0, radii[ends[0]] if len(ends) else radii[-1], 150)


def _radial_sigma(camera: CameraReport, ideal: np.ndarray) -> np.ndarray:
    """Standard deviation of the radial displacement k1 r^3 + k2 r^5 + k3 r^7 [1]; 0 without sigmas."""
    sigma = {p.name: p.sigma for p in camera.parameters if p.sigma is not None and not p.frozen}
    power = {"k1": 3, "k2": 5, "k3": 7}
    names = [n for n in camera.correlation_names if n in power and np.isfinite(sigma.get(n, np.nan))]
    index = [camera.correlation_names.index(n) for n in names]
    rows = np.stack([ideal ** power[n] * sigma[n] for n in names]) if names else np.zeros((0, len(ideal)))
    covariance = np.nan_to_num(camera.correlation[np.ix_(index, index)]) if names else np.zeros((0, 0))
    return np.sqrt(np.maximum(np.einsum("ir,ij,jr->r", rows, covariance, rows), 0.0))


def correlation_matrix(camera: CameraReport) -> Picture | None:
    """Correlations of the free parameters; None with fewer than two."""
    names, matrix = camera.correlation_names, np.asarray(camera.correlation, dtype=float)
    if len(names) < 2:
        return None

    def paint(figure: Figure) -> None:
        axes = figure.subplots()
        axes.imshow(np.nan_to_num(matrix), cmap="PuOr_r", vmin=-1, vmax=1)
        for i, row in enumerate(matrix):
            for j, value in enumerate(row):
                colour = "white" if abs(value) > 0.65 else "#333333"
                axes.text(j, i, _correlation_text(float(value)), ha="center", va="center", fontsize=7.5, color=colour)
        axes.set_xticks(range(len(names)), names)
        axes.set_yticks(range(len(names)), names)
        axes.tick_params(length=0, labeltop=True, labelbottom=False)
        axes.spines[:].set_visible(False)
        axes.grid(False)

    return Picture(
        draw(HALF, paint),
        "image/svg+xml",
        "Correlations",
        "Near ±1, two parameters can stand in for each other: their sigmas are large one by one, but not together.",
    )


def _correlation_text(value: float) -> str:
    """Two decimals without the leading zero; + 0.0 turns -0.00 into 0.00."""
    return f"{round(value, 2) + 0.0:.2f}".replace("0.", ".", 1).replace("1.00", "1") if np.isfinite(value) else "–"
