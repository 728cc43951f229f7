"""A pose as files of other programs. No formula."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from jaxmocap._errors import InputError
from jaxmocap.bodies.puppet import MARKERS
from jaxmocap.io import bvh_text, collada_text, glb_bytes
from jaxmocap.tracking.bead_colours import BeadColours
from jaxmocap.tracking.colour_space import rgb_from_hsb
from jaxmocap.workflows.puppet_pose import PuppetPose
from jaxmocap.workflows.stopmotion import pose_points

NOTHING = "puppet export: nothing to write. Give one or more of --dae, --glb, --bvh, --csv."


def exported(
    pose: PuppetPose,
    *,
    dae: str | Path | None = None,
    glb: str | Path | None = None,
    bvh: str | Path | None = None,
    csv: str | Path | None = None,
    colours: BeadColours | None = None,
) -> tuple[dict[str | Path, bytes], list[str]]:
    """Contents of the files asked for, and a sentence about each.

    Args:
        pose: of the puppet.
        dae: COLLADA file: the document's hierarchy of translations.
        glb: binary glTF file with rotations and the beads as balls.
        bvh: BVH file with rotations.
        csv: table of the beads.
        colours: of the beads, for glTF.

    Returns:
        content by path; sentences.

    Raises:
        InputError: nothing was asked for.
    Source: stop-motion document, 6.3 and 7.1.3 (COLLADA).
    """
    if not any((dae, glb, bvh, csv)):
        raise InputError(NOTHING)
    motion = pose.motion()
    files: dict[str | Path, bytes] = {}
    said = []
    if dae:
        text, sentence = collada_text(motion)
        files[dae] = text.encode()
        said.append(f"{dae}: {sentence}")
    if glb:
        data, sentence = glb_bytes(motion, markers=_balls(pose), colours=_painted(colours))
        files[glb] = data
        said.append(f"{glb}: {sentence}")
    if bvh:
        text, sentence = bvh_text(motion)
        files[bvh] = text.encode()
        said.append(f"{bvh}: {sentence}")
    if csv:
        files[csv] = pose_points(pose).encode()
        said.append(f"{csv}: {int(pose.seen.sum())} beads, lengths in {pose.scene.unit}.")
    return files, said


def _balls(pose: PuppetPose) -> dict[str, np.ndarray]:
    return {name: pose.points[i][None] for i, name in enumerate(MARKERS) if pose.seen[i]}


def _painted(colours: BeadColours | None) -> Mapping[str, tuple[float, float, float]] | None:
    if colours is None:
        return None
    return {name: tuple(map(float, rgb)) for name, rgb in zip(colours.names, rgb_from_hsb(colours.hsb))}  # type: ignore[misc]
