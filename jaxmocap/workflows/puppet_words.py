"""What the steps of stop-motion capture say: plain text for the terminal, records for `--json`, and back."""

import json
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap.bodies.puppet import MARKERS
from jaxmocap.calibration.turntable import axis_numbers
from jaxmocap.calibration.turntable_checks import wrap_deg
from jaxmocap.tracking import BeadColours
from jaxmocap.tracking.tpose import TPoseColours
from jaxmocap.workflows.puppet_beads import NamedBeads
from jaxmocap.workflows.puppet_pose import PuppetPose


def record(command: str, unit: str, warnings: Sequence[str]) -> dict[str, Any]:
    """The keys that every result has."""
    return {
        "jaxmocap": version("jaxmocap"),
        "command": command,
        "success": True,
        "message": "Done.",
        "unit": unit,
        "seed": None,
        "warnings": list(warnings),
    }


def colours_json(found: TPoseColours) -> dict[str, Any]:
    """Colours by bead, as in the file."""
    colours = found.colours
    assert colours is not None
    return {
        "views_used": int(np.sum((found.index >= 0).any(axis=1))),
        "colours": _colours(colours),
        "markers": {
            name: {"xyz": [float(x) for x in found.p_world[i]], "views": int((found.index[:, i] >= 0).sum())}
            for i, name in enumerate(MARKERS)
            if (found.index[:, i] >= 0).any()
        },
    }


def _colours(colours: BeadColours) -> dict[str, Any]:
    rows = zip(colours.names, colours.hsb, colours.sd, colours.n)
    return {
        name: {"h": float(hsb[0]), "s": float(hsb[1]), "b": float(hsb[2]), "sd": [float(x) for x in sd], "n": int(n)}
        for name, hsb, sd, n in rows
    }


def colours_summary(found: TPoseColours) -> str:
    """Table of colours."""
    colours = found.colours
    assert colours is not None
    lines = [f"Colours of {len(colours.names)} beads", "  bead      hue    sat.   bright.  photos"]
    for name, hsb, n in zip(colours.names, colours.hsb, colours.n):
        lines.append(f"  {name:8}  {hsb[0]:.3f}  {hsb[1]:.3f}  {hsb[2]:.3f}    {n}")
    return "\n".join(lines) + "\n"


def beads_json(beads: NamedBeads) -> dict[str, Any]:
    """Detections, sigmas, radii and rejected candidates by photograph."""
    detections, sigmas, radii = {}, {}, {}
    for k, name in enumerate(beads.names):
        seen = np.flatnonzero(beads.visible[k])
        detections[name] = {MARKERS[i]: [float(x) for x in beads.uv[k, i]] for i in seen}
        sigmas[name] = {MARKERS[i]: float(beads.sigma[k, i]) for i in seen}
        radii[name] = {MARKERS[i]: float(beads.radius[k, i]) for i in seen}
    return {
        "views_used": len(beads.names),
        "stated_deg": dict(zip(beads.names, beads.stated_deg.tolist())),
        "observations_used": int(beads.visible.sum()),
        "observations_rejected": sum(len(uv) for uv in beads.rejected.values()),
        "detections": detections,
        "sigma_px": sigmas,
        "radius_px": radii,
        "rejected": {name: [[float(x) for x in p] for p in uv] for name, uv in beads.rejected.items()},
        "unsure": dict(beads.unsure),
    }


def read_beads(
    path: Path, stated_deg: Mapping[str, float], inputs: Mapping[str, str]
) -> tuple[NamedBeads, tuple[str, ...]] | None:
    """Beads that a file holds, and what was said of them; None if it is gone, damaged or of other files.

    Args:
        path: where `identify` wrote its result.
        stated_deg: angles by photograph.
        inputs: SHA-256 of everything that names depend on.

    Returns:
        NamedBeads and sentences.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["inputs"] != dict(inputs):
            return None
        return _beads_from_json(content, stated_deg), tuple(map(str, content["warnings"]))
    except (OSError, ValueError, LookupError, TypeError, AttributeError, OverflowError, RecursionError):
        return None


def _beads_from_json(content: Mapping[str, Any], stated_deg: Mapping[str, float]) -> NamedBeads:
    """What `beads_json` wrote; raises any error if it is not that."""
    names = tuple(stated_deg)
    if content["stated_deg"] != dict(stated_deg):
        raise ValueError("other photographs or angles")
    n, m = len(names), len(MARKERS)
    uv, visible = np.zeros((n, m, 2)), np.zeros((n, m), bool)
    sigma, radius = np.ones((n, m)), np.zeros((n, m))
    for k, name in enumerate(names):
        for bead, place in content["detections"][name].items():
            i = MARKERS.index(bead)
            uv[k, i], visible[k, i] = np.array(place, float).reshape(2), True
            sigma[k, i] = float(content["sigma_px"][name][bead])
            radius[k, i] = float(content["radius_px"][name][bead])
    rejected = {name: np.array(content["rejected"][name], float).reshape(-1, 2) for name in names}
    if not all(np.isfinite(x).all() for x in (uv, radius, sigma, *rejected.values())) or not (sigma > 0).all():
        raise ValueError("numbers that are none")
    angles = np.array([stated_deg[name] for name in names], float)
    unsure = {name: int(content["unsure"][name]) for name in names}
    return NamedBeads(names, angles, uv, visible, sigma, radius, rejected, unsure, (), dict(content["inputs"]))


def beads_summary(beads: NamedBeads) -> str:
    """Beads by photograph, and which were seen how often."""
    lines = [f"Beads named in {len(beads.names)} photographs"]
    for k, name in enumerate(beads.names):
        lines.append(f"  {name:24} {int(beads.visible[k].sum()):2d} beads, {len(beads.rejected[name])} other spots")
    seldom = [f"{m} {v}" for m, v in zip(MARKERS, beads.visible.sum(axis=0)) if v < 2]
    if seldom:
        lines.append(f"  seen in fewer than two photographs: {', '.join(seldom)}")
    return "\n".join(lines) + "\n"


def pose_json(pose: PuppetPose) -> dict[str, Any]:
    """Markers, bones, axis and angles with sigmas, and the skeleton."""
    axis = axis_numbers(pose.solved.turntable, np.asarray(pose.solved.covariance)[:4, :4])
    motion = pose.motion()
    names = pose.beads.names
    stated = pose.beads.stated_deg
    measured = stated + wrap_deg(pose.angles_deg - stated)
    used = int(pose.beads.visible[:, pose.seen].sum())
    r2 = (pose.rms_px**2 * pose.views)[pose.seen].sum()
    return {
        "rms_px": float(np.sqrt(r2 / max(used, 1))),
        "views_used": int(pose.beads.visible.any(axis=1).sum()),
        "observations_used": used,
        "observations_rejected": len(pose.wrong),
        "frozen": list(pose.scene.free),
        "wrong_names": [list(pair) for pair in pose.wrong],
        "markers": pose.markers(),
        "bones": pose.bones(),
        "axis": {
            "point": axis.point,
            "direction": axis.direction,
            "sigma_point": axis.sigma_point,
            "sigma_direction": axis.sigma_direction,
        },
        "angles_deg": dict(zip(names, measured.tolist())),
        "sigma_angles_deg": dict(zip(names, pose.sigma_angles_deg.tolist())),
        "skeleton": {
            "joints": list(motion.names),
            "parents": list(motion.parents),
            "offsets": motion.offsets,
            "rotvec": motion.rotvec[0],
            "root": motion.root[0],
        },
    }


def pose_summary(pose: PuppetPose) -> str:
    """Table of beads and bones."""
    unit = "" if pose.scene.unit == "1" else f" {pose.scene.unit}"
    lines = [f"Beads in space{f' [{unit.strip()}]' if unit else ''}, RMS in px"]
    lines.append("  bead           x        y        z      sigma   photos  RMS")
    for i in np.flatnonzero(pose.seen):
        x, y, z = pose.points[i]
        worst = pose.sigma[i].max()
        lines.append(
            f"  {MARKERS[i]:8}  {x:8.2f} {y:8.2f} {z:8.2f}   {worst:6.3f}   {pose.views[i]:4d}  {pose.rms_px[i]:6.3f}"
        )
    lines.append("Bones: direction and distance of the beads")
    for name, bone in pose.bones().items():
        d, apart = bone["direction"], bone["marker_distance"]
        told = "" if apart is None else f"  {apart:7.2f}{unit}"
        lines.append(f"  {name:20} {d[0]:7.3f} {d[1]:7.3f} {d[2]:7.3f}{told}")
    off = wrap_deg(pose.angles_deg - pose.beads.stated_deg)
    lines.append(f"Angles: off the stated ones by {np.abs(off).max():.2f} degrees at most")
    return "\n".join(lines) + "\n"
