"""How well a set of rendered puppet photographs with known truth is captured, from pixels to bones.

    python scripts/rendered_puppet.py SET [--square 12mm] [--nominal]

SET holds chess_*.jpg, turntable_*.jpg, tpose_*.jpg and further poses, and ground_truth.json, which only the comparison
reads. Prints a row for each pose: clear beads (more than 95 % of the disc in sight) found within 1 px and rightly
named; wrong names; error of the beads per coordinate after a rigid alignment; bones; errors over stated sigmas.
With --nominal the turntable file is not used: the build is sought from the beads alone.
"""

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

from jaxmocap.bodies.puppet import BONES, MARKERS  # noqa: E402
from jaxmocap.io import rig_text, write_text  # noqa: E402
from jaxmocap.io.atomic import write_many  # noqa: E402
from jaxmocap.workflows import stopmotion  # noqa: E402
from jaxmocap.workflows.calibrate import calibrate_chessboard  # noqa: E402
from jaxmocap.workflows.puppet_pose import PuppetPose  # noqa: E402
from jaxmocap.workflows.turntable import calibrate_turntable  # noqa: E402


def aligned(p: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """The points after the rotation and shift that bring them nearest the truth."""
    a, b = p - p.mean(axis=0), truth - truth.mean(axis=0)
    U, _, Vt = np.linalg.svd(a.T @ b)
    R = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    return a @ R + truth.mean(axis=0)


def names_row(pose: PuppetPose, identified: Any, views: list[dict[str, Any]]) -> tuple[int, int, int]:
    """Clear beads found and rightly named, clear beads, wrong names."""
    good = clear = wrong = 0
    for view in views:
        k = identified.names.index(view["file"])
        for name, bead in view["beads"].items():
            i = MARKERS.index(name)
            seen = identified.visible[k, i]
            off = np.linalg.norm(identified.uv[k, i] - bead.get("outline_centroid_px", bead["centre_px"]))
            wrong += int(seen and off > max(3.0, 0.5 * bead["radius_px"]))
            if bead["visible_fraction"] > 0.95 and bead["in_image"]:
                clear += 1
                good += int(seen and off < 1.0)
    return good, clear, wrong


def row(name: str, pose: PuppetPose, identified: Any, truth: dict[str, Any]) -> tuple[str, np.ndarray]:
    """Markdown row of a pose, and the errors over sigmas of axis and angles."""
    known = truth["poses"][name]
    good, clear, wrong = names_row(pose, identified, known["views"])
    rows = np.flatnonzero(pose.seen)
    beads = np.array([known["beads_world"][MARKERS[i]] for i in rows])
    error = np.abs(aligned(pose.points[rows], beads) - beads)
    raw = (pose.points[rows] - beads) / pose.sigma[rows]
    directions = pose.directions()
    turned = [
        np.degrees(np.arccos(np.clip(directions[b.name] @ known["bones"][b.name]["direction"], -1, 1)))
        for b in BONES
        if b.name in directions
    ]
    shared = truth["turntable"]["actual_deg"]
    actual = {v["file"]: v.get("actual_deg", a) for v, a in zip(known["views"], shared)}
    zero = pose.beads.names[int(np.argmin(pose.sigma_angles_deg))]
    z = []
    for file, measured, sigma in zip(pose.beads.names, pose.angles_deg, pose.sigma_angles_deg):
        if sigma > 0:
            stated_zero = pose.beads.stated_deg[pose.beads.names.index(zero)]
            off = (measured - stated_zero) - (actual[file] - actual[zero])
            z.append(((off + 180.0) % 360.0 - 180.0) / sigma)
    angles = np.array(z)
    text = (
        f"| {name} | {good}/{clear} | {wrong} | {len(rows)} | {np.median(error):.3f} / {error.max():.3f} "
        f"| {max(turned):.2f} | {np.sqrt(np.mean(raw**2)):.2f}, {np.abs(raw).max():.1f} "
        f"| {np.sqrt(np.mean(angles**2)):.2f}, {np.abs(angles).max():.1f} |"
    )
    return text, angles


def axis_z(table: Any, truth: dict[str, Any]) -> np.ndarray:
    """Errors of axis point and direction over their sigmas."""
    t = truth["turntable"]
    direction, point = np.array(t["axis_direction_camera"]), np.array(t["axis_point_camera"])
    direction = direction / np.linalg.norm(direction)
    nearest = point - direction * (point @ direction)
    a = table.axis
    z = [(a.point - nearest) / a.sigma_point, (a.direction - direction) / a.sigma_direction]
    # The component along the axis itself is fixed by the length 1, and its sigma is 0 in a perfect build.
    return np.concatenate([z[0], z[1][np.abs(direction) < 0.9]])


def main() -> None:
    """Capture all poses and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("set", type=Path)
    parser.add_argument("--square", default="12mm")
    parser.add_argument("--nominal", action="store_true")
    options = parser.parse_args()
    source = options.set.resolve()
    truth = json.loads((source / "ground_truth.json").read_text())
    with tempfile.TemporaryDirectory() as name:
        out = Path(name)
        camera, turntable, colours = out / "camera.toml", out / "turntable.toml", out / "colours.toml"
        write_text(camera, rig_text(calibrate_chessboard(source / "chess_*.jpg", "9x6", options.square).rig())[0])
        table = None
        if not options.nominal:
            table = calibrate_turntable(camera, source / "turntable_*.jpg", "9x6", options.square)
            write_text(turntable, table.text())
        given = None if table is None else turntable
        write_many(stopmotion.learn_colours(source / "tpose_*.jpg", camera, turntable=given, output=colours).files)
        print("| pose | clear beads found and named | wrong names | beads placed | error after alignment, median / max "
              "| bones, largest [deg] | beads: RMS and largest error / sigma | angles: the same |")  # fmt: skip
        print("|---|---|---|---|---|---|---|---|")
        for pose in truth["poses"]:
            folder = out / pose
            stopmotion.new_puppet(folder, camera, turntable=given, colours=colours)
            stopmotion.add_to_puppet(folder, source / f"{pose}_*.jpg")
            identified = stopmotion.identify(folder)
            write_many(identified.files)
            print(row(pose, stopmotion.reconstruct(folder).value, identified.value, truth)[0], flush=True)
        if table is not None:
            z = axis_z(table, truth)
            size = np.sqrt(np.mean(z**2))
            print(f"\nAxis from the chessboard, error / sigma: RMS {size:.2f}, largest {np.abs(z).max():.1f}")


if __name__ == "__main__":
    main()
