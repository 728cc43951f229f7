"""All figures of a camera, in the order in which they are read."""

from collections.abc import Sequence

import numpy as np

from jaxmocap.report.camera_figures import (
    correlation_matrix,
    coverage_map,
    distortion_curve,
    tilts_and_depths,
)
from jaxmocap.report.canvas import Picture
from jaxmocap.report.data import CameraReport, ViewReport
from jaxmocap.report.residual_figures import (
    residual_arrows,
    residual_by_radius,
    residual_scatter,
    view_rms_bars,
    worst_views,
)


def camera_pictures(camera: CameraReport, views: Sequence[ViewReport], unit: str) -> tuple[Picture, ...]:
    """The figures of one camera.

    Args:
        camera: the result.
        views: its photos; those without corners, or not finite, are left out.
        unit: unit of the distances.

    Returns:
        Empty where there is nothing to draw.
    """
    views = [v for v in views if len(v.uv) and np.isfinite([v.uv, v.residual]).all()]
    if not views or not np.isfinite([*camera.K.ravel(), *camera.distortion]).all():
        return ()
    pictures = [
        view_rms_bars(views),
        worst_views(views),
        residual_scatter(views),
        residual_arrows(camera, views),
        coverage_map(camera, views),
        distortion_curve(camera, views),
        residual_by_radius(camera, views),
        correlation_matrix(camera),
        tilts_and_depths(views, unit),
    ]
    return tuple(p for p in pictures if p is not None)
