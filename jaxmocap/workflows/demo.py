"""The whole way from bundled photographs to a skeleton, beside the truth. The truth is printed, never used."""

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap.bodies.puppet import MARKERS
from jaxmocap.io import rig_text
from jaxmocap.io.atomic import write_many
from jaxmocap.io.puppet_folder import CONTACT_SHEET, INDEX
from jaxmocap.workflows.calibrate import calibrate_chessboard
from jaxmocap.workflows.puppet_export import exported
from jaxmocap.workflows.puppet_page import pose_page
from jaxmocap.workflows.puppet_pose import PuppetPose
from jaxmocap.workflows.stopmotion import add_to_puppet, contact_sheet, learn_colours, new_puppet, reconstruct
from jaxmocap.workflows.turntable import calibrate_turntable

Progress = Callable[[str], Callable[[int, int], None] | None]
_ASSETS = Path(__file__).parent.parent / "assets"


def run_demo(out: Path, command: str, progress: Progress) -> Iterator[str]:
    """Run all steps, writing files as they come.

    Args:
        out: folder to write into.
        command: recorded in files.
        progress: makes a progress callback for a step.

    Yields:
        What each step found, in words, beside the truth.

    Raises:
        InputError: files cannot be written.
        SolveError: never, unless the bundled photographs are damaged.
    Source: stop-motion document, chapters 3-7.
    """
    boards, puppet = _ASSETS / "chessboard", _ASSETS / "puppet"
    known, truth = (json.loads((f / "truth.json").read_text(encoding="utf-8")) for f in (boards, puppet))
    camera = calibrate_chessboard(
        boards, known["board"], known["square"], command=command, progress=progress("looking for the board")
    )
    camera = replace(camera, truth=known["camera"])
    files = {out / "camera.toml": rig_text(camera.rig())[0].encode(), out / "camera.html": camera.html().encode()}
    write_many(files)
    yield f"1. {camera.summary()}"

    table = calibrate_turntable(
        out / "camera.toml",
        puppet / "turntable_*.jpg",
        truth["board"],
        truth["square"],
        height="80mm",
        command=command,
        progress=progress("looking for the board on the turntable"),
    )
    write_many({out / "turntable.toml": table.text().encode(), out / "turntable.html": table.html().encode()})
    yield "2. Turntable\n" + _axis_beside(table, truth)

    colours = learn_colours(
        sorted(puppet.glob("tpose_*.jpg")),
        out / "camera.toml",
        turntable=out / "turntable.toml",
        output=out / "colours.toml",
        command=command,
        progress=progress("looking for beads in the T-pose"),
    )
    write_many(colours.files)
    yield f"3. {colours.summary}"

    folder = out / truth["pose"]
    if not (folder / INDEX).exists():
        new_puppet(folder, out / "camera.toml", turntable=out / "turntable.toml", colours=out / "colours.toml")
    add_to_puppet(folder, sorted(puppet.glob(f"{truth['pose']}_*.jpg")))
    sheet = contact_sheet(folder, command=command, progress=progress("looking for beads in the pose"))
    write_many(sheet.files)
    solved = reconstruct(folder, command=command)
    write_many(solved.files)
    pose: PuppetPose = solved.value
    yield f"4. {sheet.summary.splitlines()[0]}; contact sheet: {folder / CONTACT_SHEET}\n" + _beads_beside(pose, truth)

    models, said = exported(
        pose,
        dae=out / "puppet.dae",
        glb=out / "puppet.glb",
        bvh=out / "puppet.bvh",
        csv=out / "points.csv",
        colours=colours.value,
    )
    page = pose_page(
        pose,
        title=f"Puppet, pose “{truth['pose']}”",
        command=command,
        notes=solved.notes,
        contact_sheet=sheet.files[folder / CONTACT_SHEET],
        colours=colours.value,
        truth=truth,
    )
    write_many({**models, out / "report.html": page.encode()})
    yield "5. Files\n" + "".join(f"  {sentence}\n" for sentence in said) + f"  {out / 'report.html'}: open it\n"


def _axis_beside(table: Any, truth: dict[str, Any]) -> str:
    """Axis with sigma beside the truth."""
    axis = table.axis
    lines = ["                        measured ± sigma         truth"]
    direction = np.array(truth["axis"]["direction"])
    point = np.array(truth["axis"]["point"])
    nearest = point - direction * (point @ direction)  # of the true axis to the camera centre
    for word, values, sigmas, true in (
        ("point", axis.point, axis.sigma_point, nearest),
        ("direction", axis.direction, axis.sigma_direction, direction),
    ):
        for name, v, s, t in zip("xyz", values, sigmas, true):
            unit = f" {table.unit}" if word == "point" else ""
            lines.append(f"  axis {word:9} {name}   {v:10.4f} ± {s:.4f}{unit:3}   {t:10.4f}")
    return "\n".join(lines) + "\n"


def _beads_beside(pose: PuppetPose, truth: dict[str, Any]) -> str:
    """Beads with sigma beside the truth, and the largest errors of beads and bones."""
    lines = [f"  bead            x        y        z   ± largest sigma      truth [{pose.scene.unit}]"]
    off = []
    for i in np.flatnonzero(pose.seen):
        t = np.array(truth["beads"][MARKERS[i]])
        off.append(np.abs(pose.points[i] - t).max())
        here, there = (" ".join(f"{v:8.2f}" for v in p) for p in (pose.points[i], t))
        lines.append(f"  {MARKERS[i]:9} {here}   ± {pose.sigma[i].max():.3f}   {there}")
    lines.append(f"  largest error of a coordinate {max(off):.3f} {pose.scene.unit}, median {np.median(off):.3f}")
    turned = []
    for name, t in truth["directions"].items():
        if name in pose.directions():
            d = pose.directions()[name]
            turned.append(np.degrees(np.arctan2(np.linalg.norm(np.cross(d, t)), np.dot(d, t))))
    lines.append(f"  largest error of a bone's direction {max(turned):.2f} degrees, of {len(turned)} bones")
    return "\n".join(lines) + "\n"
