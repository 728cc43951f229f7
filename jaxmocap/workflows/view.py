"""From files to the scene that the page shows: motions, points, rigs, turntables, alone or together."""

import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap._errors import InputError
from jaxmocap.io import RigFile, read_glb, read_points, read_rig
from jaxmocap.io.length_units import METRES, unit_factor
from jaxmocap.io.turntable_file import TurntableFile, read_turntable
from jaxmocap.viewer import Axis, CameraView, Markers, Skeleton, ViewerScene

_NARROW = np.array([[-0.35, -0.25, 1], [0.35, -0.25, 1], [0.35, 0.25, 1], [-0.35, 0.25, 1]])
"""Corners of a picture whose camera nobody described: about 40 by 28 degrees."""


@dataclass(frozen=True)
class _Seen:
    """What one file holds, with the unit it is in; None where the file does not say."""

    scene: ViewerScene
    unit: str | None


def view_scene(paths: Sequence[str | Path], *, unit: str | None = None, up: str | None = None) -> ViewerScene:
    """The scene of one file, or of several that share a world.

    Args:
        paths: motions (.glb), tables of points (.csv), rigs or turntables (.toml). A turntable beside a rig of one
            camera shows that camera at every angle.
        unit: of lengths in tables, which do not say; None: that of the files beside them, or none.
        up: axis of the world that points up; None: what a file says, y for motions, points and turntables, and -y
            for rigs that do not say (their first camera's y points down).

    Returns:
        The scene.

    Raises:
        InputError: for a file that cannot be read or shown, two of a kind, or units that do not go together.
    """
    if not paths:
        raise InputError("expected a file to show: a .glb, a table of points (.csv), a rig or a turntable (.toml)")
    kinds = [_kind(path) for path in paths]
    for kind in set(kinds):
        if kinds.count(kind) > 1:
            raise InputError(f"{kinds.count(kind)} files are each a {kind}; show one of a kind at a time")
    by_kind = dict(zip(kinds, paths))
    rig = read_rig(by_kind["rig"]) if "rig" in by_kind else None
    parts = [
        _of_kind(kind, path, rig if "turntable" in by_kind or kind == "rig" else None) for kind, path in by_kind.items()
    ]
    return _together([part for part in parts if part is not None], paths, unit, up)


def _kind(path: str | Path) -> str:
    suffix = Path(path).suffix.lower()
    if suffix == ".glb":
        return "motion"
    if suffix == ".csv":
        return "table of points"
    if suffix != ".toml":
        raise InputError(f"{path}: expected a .glb, a table of points (.csv), a rig or a turntable (.toml)")
    try:
        keys = tomllib.loads(Path(path).read_text(encoding="utf-8-sig"))
    except (OSError, ValueError, RecursionError):
        keys = {}  # the reader of rigs says what is wrong with it
    return "turntable" if "distance" in keys and "rotation" in keys else "rig"


def _of_kind(kind: str, path: str | Path, rig: RigFile | None) -> _Seen | None:
    if kind == "motion":
        return _motion(path)
    if kind == "table of points":
        return _points(path)
    if kind == "turntable":
        return _turntable(path, read_turntable(path), rig)
    assert rig is not None
    return _rig(rig)


def _motion(path: str | Path) -> _Seen:
    tracks = read_glb(path)
    unit = tracks.source_unit
    factor = 1 / METRES.get(unit, 1.0)
    colours = tuple(c or (0.95, 0.6, 0.1) for c in tracks.object_colours)
    p_joint, p_object = tracks.p_joint * factor, tracks.p_object * factor
    step = np.diff(tracks.times)
    even = len(step) > 0 and np.ptp(step) < 1e-3 * step[0]
    scene = ViewerScene(
        title="",
        markers=Markers(tracks.object_names, p_object, colours=colours) if tracks.object_names else None,
        skeleton=Skeleton(tracks.joint_names, tracks.joint_parents, p_joint) if tracks.joint_names else None,
        fps=tracks.fps or (float(1 / step.mean()) if even else None),
    )
    return _Seen(scene, unit)


def _points(path: str | Path) -> _Seen:
    points = read_points(path)
    numbers, xyz, sigma = points.by_frame()
    markers = Markers(points.marker_labels, xyz, sigma if np.isfinite(sigma).any() else None)
    return _Seen(ViewerScene("", markers=markers, frame_numbers=numbers, notes=points.warnings), None)


def _rig(rig: RigFile) -> _Seen:
    views = []
    for named in rig.cameras:
        pose = named.camera.T_camera_world
        R_world_camera = Rotation.from_rotvec(np.array(pose.rotvec)).inv()
        centre = -R_world_camera.apply(np.array(pose.translation))
        views.append(CameraView(named.name, centre, R_world_camera.apply(_corners(rig, len(views)))))
    return _Seen(ViewerScene("", up=rig.up or "-y", cameras=tuple(views), notes=rig.warnings), rig.unit)


def _corners(rig: RigFile, number: int) -> np.ndarray:
    """(4, 3) rays to the corners of the picture, without the lens: at the corners it may not be invertible."""
    camera = rig.cameras[number].camera
    k, (width, height) = camera.intrinsics, camera.image_size
    v = np.array([-0.5, -0.5, height - 0.5, height - 0.5])
    u = np.array([-0.5, width - 0.5, width - 0.5, -0.5])
    y = (v - float(k.cy)) / float(k.fy)
    x = (u - float(k.cx) - float(k.skew) * y) / float(k.fx)
    return np.stack([x, y, np.ones(4)], axis=1)


def _turntable(path: str | Path, table: TurntableFile, rig: RigFile | None) -> _Seen:
    """The camera at each angle of the file, around the world that turns with the table. Eq. 4.14-4.17."""
    notes = []
    if rig is not None and len(rig.cameras) != 1:
        raise InputError(f"{path}: a turntable has one camera; the rig beside it has {len(rig.cameras)}")
    if rig is None:
        notes.append("How wide the camera sees is not in the file; give its camera file too.")
    corners = _NARROW if rig is None else _corners(rig, 0)
    R_camera0_table = Rotation.from_rotvec(table.rotation)
    views = []
    for degrees in sorted(set(table.angles_deg.values())) or [0.0]:
        a = math.radians(degrees)
        R_world_camera = (R_camera0_table * Rotation.from_rotvec([0.0, a, 0.0])).inv()
        centre = np.array([-table.distance * math.sin(a), table.height, table.distance * math.cos(a)])
        views.append(CameraView(f"{degrees:.4g}°", centre, R_world_camera.apply(corners)))
    axis = Axis(np.zeros(3), np.array([0.0, 1.0, 0.0]))
    return _Seen(ViewerScene("", cameras=tuple(views), axis=axis, notes=tuple(notes)), table.unit)


def _together(parts: list[_Seen], paths: Sequence[str | Path], unit: str | None, up: str | None) -> ViewerScene:
    """One scene of several, in the unit of the first file that states one."""
    stated = [part.unit for part in parts if part.unit is not None]
    shown = stated[0] if stated else unit or "1"
    unit_factor(shown, shown, "unit")  # is it one?
    scenes = [_scaled(part.scene, unit_factor(part.unit or unit or shown, shown, "unit")) for part in parts]
    turning = any(scene.axis is not None for scene in scenes)
    has_rig = [scene for scene in scenes if scene.cameras and scene.axis is None]
    cameras = tuple(c for scene in scenes for c in scene.cameras if not (turning and scene.axis is None))
    several = [s.markers for s in scenes if s.markers is not None]
    markers = max(several, key=lambda m: m.sigma is not None) if several else None  # a table knows more than a motion
    skeleton = next((s.skeleton for s in scenes if s.skeleton is not None), None)
    tracks = [s for s in scenes if s.markers is not None or s.skeleton is not None]
    if len({s.frames for s in tracks}) > 1:
        raise InputError(
            f"the motion and the table of points have {' and '.join(str(s.frames) for s in tracks)} frames"
        )
    return ViewerScene(
        title=" + ".join(Path(path).name for path in paths),
        unit=shown,
        up=up or (has_rig[0].up if has_rig and not turning else "y"),
        markers=markers,
        skeleton=skeleton,
        cameras=cameras,
        axis=next((s.axis for s in scenes if s.axis is not None), None),
        fps=next((s.fps for s in scenes if s.fps), None),
        frame_numbers=next((s.frame_numbers for s in scenes if s.frame_numbers is not None), None),
        notes=tuple(dict.fromkeys(note for s in scenes for note in s.notes)),
    )


def _scaled(scene: ViewerScene, factor: float) -> ViewerScene:
    if factor == 1:
        return scene
    m, s = scene.markers, scene.skeleton
    sigma = None if m is None or m.sigma is None else m.sigma * factor
    return replace(
        scene,
        markers=m and replace(m, p_world=m.p_world * factor, sigma=sigma),
        skeleton=s and replace(s, p_world=s.p_world * factor),
        cameras=tuple(replace(c, centre=c.centre * factor) for c in scene.cameras),
        axis=scene.axis and replace(scene.axis, point=scene.axis.point * factor),
    )
