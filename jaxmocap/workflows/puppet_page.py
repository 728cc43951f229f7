"""A pose as a page: photographs, tables, and the scene in 3D. No formula."""

from collections.abc import Mapping
from typing import Any, cast

import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap.bodies.puppet import MARKERS
from jaxmocap.calibration.turntable_checks import wrap_deg
from jaxmocap.report.puppet import BeadRow, BoneRow, PuppetReport, puppet_html
from jaxmocap.tracking import BeadColours
from jaxmocap.tracking.colour_space import rgb_from_hsb
from jaxmocap.viewer.page import viewer_parts
from jaxmocap.viewer.scene import Axis, CameraView, Markers, Skeleton, ViewerScene
from jaxmocap.workflows.puppet_pose import PuppetPose


def pose_scene(pose: PuppetPose, title: str, colours: BeadColours | None = None) -> ViewerScene:
    """Beads, skeleton, axis and the camera at every angle, as the viewer takes them.

    Args:
        pose: of the puppet.
        title: of the picture.
        colours: of the beads.

    Returns:
        ViewerScene.
    """
    rows = np.flatnonzero(pose.seen)
    painted = None
    if colours is not None:
        rgb = dict(zip(colours.names, rgb_from_hsb(colours.hsb)))
        painted = tuple(cast(Any, tuple(float(v) for v in rgb.get(MARKERS[i], (0.8, 0.8, 0.8)))) for i in rows)
    motion = pose.motion()
    return ViewerScene(
        title,
        unit=pose.scene.unit,
        markers=Markers(tuple(MARKERS[i] for i in rows), pose.points[rows][None], pose.sigma[rows][None], painted),
        skeleton=Skeleton(motion.names, motion.parents, motion.world()[1]),
        cameras=_cameras(pose),
        axis=Axis(np.zeros(3), np.array([0.0, 1.0, 0.0])),
    )


def pose_page(
    pose: PuppetPose,
    *,
    title: str,
    command: str,
    notes: tuple[str, ...],
    contact_sheet: bytes | None = None,
    colours: BeadColours | None = None,
    truth: Mapping[str, Any] | None = None,
) -> str:
    """The report of a pose as HTML.

    Args:
        pose: of the puppet.
        title: of the page.
        command: recorded on it.
        notes: sentences.
        contact_sheet: PNG.
        colours: of the beads.
        truth: `beads` and `directions` by name, shown beside the results; None: unknown.

    Returns:
        HTML.
    """
    known = truth or {"beads": {}, "directions": {}}
    beads = tuple(
        BeadRow(name, _three(b["xyz"]), _three(b["sigma"]), b["views"], b["rms_px"], _three(known["beads"].get(name)))
        for name, b in pose.markers().items()
    )
    bones = tuple(
        BoneRow(
            name, _three(b["direction"]), b["marker_distance"], _angle(b["direction"], known["directions"].get(name))
        )
        for name, b in pose.bones().items()
    )
    stated = pose.beads.stated_deg
    measured = stated + wrap_deg(pose.angles_deg - stated)
    use = pose.beads.visible[:, pose.seen].sum()
    report = PuppetReport(
        title=title,
        command=command,
        unit=pose.scene.unit,
        rms_px=float(np.sqrt((pose.rms_px**2 * pose.views)[pose.seen].sum() / max(int(use), 1))),
        photos=int(pose.beads.visible.any(axis=1).sum()),
        beads=beads,
        bones=bones,
        angles=tuple(zip(pose.beads.names, stated.tolist(), measured.tolist(), pose.sigma_angles_deg.tolist())),
        free=pose.scene.free,
        notes=notes,
        contact_sheet=contact_sheet,
        provenance={name: digest[:16] for name, digest in pose.beads.inputs.items()},
    )
    return puppet_html(report, viewer_parts(pose_scene(pose, title, colours)))


def _three(values: Any) -> Any:
    return None if values is None else tuple(float(v) for v in values)


def _angle(a: Any, b: Any) -> float | None:
    if b is None:
        return None
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), np.dot(a, b))))


def _cameras(pose: PuppetPose) -> tuple[CameraView, ...]:
    """The camera around the turning world, one for each photograph."""
    k, (width, height) = pose.scene.lens.intrinsics, pose.scene.image_size
    v = np.array([-0.5, -0.5, height - 0.5, height - 0.5])
    u = np.array([-0.5, width - 0.5, width - 0.5, -0.5])
    y = (v - float(k.cy)) / float(k.fy)
    corners = np.stack([(u - float(k.cx) - float(k.skew) * y) / float(k.fx), y, np.ones(4)], axis=1)
    table = pose.solved.turntable
    R_camera0 = Rotation.from_rotvec(np.array(table.rotvec))
    out = []
    for stated, a in zip(pose.beads.stated_deg, np.radians(pose.angles_deg)):
        R_world_camera = (R_camera0 * Rotation.from_rotvec([0.0, a, 0.0])).inv()
        far, high = float(table.distance), float(table.height)
        centre = np.array([-far * np.sin(a), high, far * np.cos(a)])
        out.append(CameraView(f"{stated:g}°", centre, R_world_camera.apply(corners)))
    return tuple(out)
