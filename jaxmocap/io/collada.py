"""COLLADA 1.4.1: the skeleton as nested JOINT nodes, each with one 4x4 matrix, as the stop-motion document has it."""

from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap.io.atomic import write_text
from jaxmocap.io.length_units import METRES
from jaxmocap.io.skeleton_tree import unique_words
from jaxmocap.io.take import SkeletonMotion, Take, prepare_take

# The schema demands dates of creation and change; a clock would make every run's file another one.
_NO_DATE = "1970-01-01T00:00:00Z"
_UNIT_NAMES = {"um": "micrometer", "mm": "millimeter", "cm": "centimeter", "m": "meter", "in": "inch", "1": "unit"}
# XML's NCName, which ids AND names of nodes are in the schema of version 1.4.1 (the letters of the
# commonest scripts; what is left out becomes "_").
_FIRST = "A-Z_a-z\u00c0-\u00d6\u00d8-\u00f6\u00f8-\u0131\u0388-\u038a\u0391-\u03a1\u03a3-\u03ce\u0410-\u044f"
_FIRST += "\u05d0-\u05ea\u3041-\u3094\u30a1-\u30fa\u4e00-\u9fa5\uac00-\ud7a3"
_ALLOWED = _FIRST + r"0-9.\-\u00b7"
_Element = ElementTree.Element


def write_collada(
    path: str | Path,
    motion: SkeletonMotion,
    *,
    unit: str | None = None,
    up: str = "y",
    fps: float | None = None,
    gaps: int = 0,
    rotations: bool | None = None,
) -> str:
    """Write a skeleton as COLLADA, whole or not at all.

    Args:
        path: the file.
        motion: the motion.
        unit: unit of lengths in the file; None keeps that of the motion.
        up: axis of the motion's world that points up; it becomes y, the file's own.
        fps: frames per second; None takes the motion's own. The file's keys are in seconds.
        gaps: longest run of missing frames that is interpolated.
        rotations: False: matrices hold translations alone, relative to the parent but along the axes of the
            world, as the document's do. True: they hold local rotations and the rest offset, so that programs
            turn the bones. None: False for one frame, True for several.

    Returns:
        One sentence on what was written.

    Raises:
        InputError: for a motion that no file can hold, or if the file cannot be written.
    Source: stop-motion document, 6.3 and 7.1.3, with the element names and the unit put right.
    """
    text, said = collada_text(motion, unit=unit, up=up, fps=fps, gaps=gaps, rotations=rotations)
    write_text(path, text)
    return f"{path}: {said}"


def collada_text(
    motion: SkeletonMotion,
    *,
    unit: str | None = None,
    up: str = "y",
    fps: float | None = None,
    gaps: int = 0,
    rotations: bool | None = None,
) -> tuple[str, str]:
    """The text that `write_collada` writes, and its sentence without the file name.

    Raises:
        InputError: as `write_collada`.
    """
    take = prepare_take(motion, unit=unit, up=up, fps=fps, gaps=gaps)
    turned = take.frames > 1 if rotations is None else rotations
    matrices = _local_matrices(take) if turned else _translations(take)
    ids = unique_words(take.tree.names, _ALLOWED, _FIRST)
    scene_id = _unused("skeleton", ids)
    document = _Element("COLLADA", xmlns="http://www.collada.org/2005/11/COLLADASchema", version="1.4.1")
    document.append(_asset(take))
    if take.frames > 1:
        document.append(_animations(take, ids, matrices))
    scenes = ElementTree.SubElement(document, "library_visual_scenes")
    scene = ElementTree.SubElement(scenes, "visual_scene", id=scene_id, name="skeleton")
    scene.append(_nodes(take, ids, matrices))
    ElementTree.SubElement(ElementTree.SubElement(document, "scene"), "instance_visual_scene", url=f"#{scene_id}")
    ElementTree.indent(document)
    body = ElementTree.tostring(document, encoding="unicode")
    more = ["rotations" if turned else "translations only"]
    more += ["one unit is taken for a metre by programs that need one"] if take.unit == "1" else []
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{body}\n', take.sentence(*more)


def _asset(take: Take) -> _Element:
    asset = _Element("asset")
    contributor = ElementTree.SubElement(asset, "contributor")
    ElementTree.SubElement(contributor, "authoring_tool").text = "jaxmocap"
    comments = f"frames per second: {take.fps!r}. The dates mean nothing: equal input gives equal bytes."
    ElementTree.SubElement(contributor, "comments").text = comments
    ElementTree.SubElement(asset, "created").text = _NO_DATE
    ElementTree.SubElement(asset, "modified").text = _NO_DATE
    ElementTree.SubElement(asset, "unit", meter=repr(METRES.get(take.unit, 1.0)), name=_UNIT_NAMES[take.unit])
    ElementTree.SubElement(asset, "up_axis").text = "Y_UP"
    return asset


def _nodes(take: Take, ids: list[str], matrices: np.ndarray) -> _Element:
    """The root's node with all others inside; the root has no matrix where it would say nothing, as printed."""
    nodes: dict[int, _Element] = {}
    for joint in take.tree.order:
        name, parent = take.tree.names[joint], take.tree.parents[joint]
        node = _Element("node", id=ids[joint], name=ids[joint], sid=ids[joint], type="JOINT")
        if parent >= 0 or take.frames > 1 or not np.array_equal(matrices[0, joint], np.eye(4)):
            ElementTree.SubElement(node, "matrix", sid="transform").text = _numbers(matrices[0, joint].ravel())
        nodes[joint] = node
        if parent >= 0:
            nodes[parent].append(node)
    for joint, node in nodes.items():  # `extra` comes after the inner nodes
        if ids[joint] != take.tree.names[joint]:
            name = take.tree.names[joint]
            technique = ElementTree.SubElement(ElementTree.SubElement(node, "extra"), "technique", profile="jaxmocap")
            ElementTree.SubElement(technique, "name").text = name
    return nodes[take.tree.order[0]]


def _animations(take: Take, ids: list[str], matrices: np.ndarray) -> _Element:
    """One animation per joint: a matrix at each time."""
    library = _Element("library_animations")
    start = _unused("animation", ids)
    for joint in take.tree.order:
        name, n = f"{start}-{joint}", take.frames
        animation = ElementTree.SubElement(library, "animation", id=name)
        _source(animation, f"{name}-time", "float", _numbers(take.times), n, 1, "TIME", "float")
        _source(
            animation, f"{name}-matrix", "float", _numbers(matrices[:, joint].ravel()), n, 16, "TRANSFORM", "float4x4"
        )
        _source(animation, f"{name}-kind", "Name", " ".join(["LINEAR"] * n), n, 1, "INTERPOLATION", "name")
        sampler = ElementTree.SubElement(animation, "sampler", id=f"{name}-sampler")
        for semantic, part in (("INPUT", "time"), ("OUTPUT", "matrix"), ("INTERPOLATION", "kind")):
            ElementTree.SubElement(sampler, "input", semantic=semantic, source=f"#{name}-{part}")
        ElementTree.SubElement(animation, "channel", source=f"#{name}-sampler", target=f"{ids[joint]}/transform")
    return library


def _unused(word: str, ids: list[str]) -> str:
    """The word, lengthened until no id starts with it."""
    while any(i.startswith(word) for i in ids):
        word += "_"
    return word


def _source(
    above: _Element, name: str, kind: str, values: str, frames: int, stride: int, parameter: str, type_: str
) -> None:
    source = ElementTree.SubElement(above, "source", id=name)
    array = ElementTree.SubElement(source, f"{kind}_array", id=f"{name}-array", count=str(frames * stride))
    array.text = values
    technique = ElementTree.SubElement(source, "technique_common")
    accessor = ElementTree.SubElement(
        technique, "accessor", source=f"#{name}-array", count=str(frames), stride=str(stride)
    )
    ElementTree.SubElement(accessor, "param", name=parameter, type=type_)


def _translations(take: Take) -> np.ndarray:
    """(frames, joints, 4, 4): from the parent's joint to this one along the world's axes, eq. 6.1-6.3."""
    positions, _ = take.world()
    matrices = np.tile(np.eye(4), (*positions.shape[:2], 1, 1))
    for joint, parent in enumerate(take.tree.parents):
        matrices[:, joint, :3, 3] = positions[:, joint] - (positions[:, parent] if parent >= 0 else 0.0)
    return matrices


def _local_matrices(take: Take) -> np.ndarray:
    """(frames, joints, 4, 4): local rotation and offset."""
    matrices = np.tile(np.eye(4), (*take.quaternions.shape[:2], 1, 1))
    turns = Rotation.from_quat(take.quaternions.reshape(-1, 4)).as_matrix()
    matrices[..., :3, :3] = turns.reshape(*take.quaternions.shape[:2], 3, 3)
    matrices[..., :3, 3] = take.offsets
    matrices[:, take.tree.order[0], :3, 3] = take.root
    return matrices


def _numbers(values: Iterable[float]) -> str:
    # Rounding turns what is left of a cosine of 90 degrees into 0, and + 0.0 turns -0 into 0.
    return " ".join(f"{round(float(v), 12) + 0.0:.10g}" for v in values)
