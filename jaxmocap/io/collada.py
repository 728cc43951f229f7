"""COLLADA 1.4.1: the skeleton as nested JOINT nodes, each with one 4x4 matrix, as the stop-motion document has it."""

from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap.bodies.motion import SkeletonMotion
from jaxmocap.io.atomic import write_text
from jaxmocap.io.length_units import METRES
from jaxmocap.io.take import Take, prepare_take
from jaxmocap.io.written_names import unique_words

# The schema demands dates of creation and change; a clock would make every run's file another one.
_NO_DATE = "1970-01-01T00:00:00Z"
_UNIT_NAMES = {"um": "micrometer", "mm": "millimeter", "cm": "centimeter", "m": "meter", "in": "inch", "1": "unit"}
# XML's NCName, which ids AND names of nodes are in the schema of version 1.4.1 (the letters of the
# commonest scripts; what is left out becomes "_").
_FIRST = "A-Z_a-z\u00c0-\u00d6\u00d8-\u00f6\u00f8-\u0131\u0388-\u038a\u0391-\u03a1\u03a3-\u03ce\u0410-\u044f"
_FIRST += "\u05d0-\u05ea\u3041-\u3094\u30a1-\u30fa\u4e00-\u9fa5\uac00-\ud7a3"
_ALLOWED = _FIRST + r"0-9.\-\u00b7"
_Element = ElementTree.Element


class _Joints:
    """Names, ids, parents and (frames, joints, 4, 4) local matrices, as the nodes have them."""

    def __init__(self, names: tuple[str, ...], parents: tuple[int, ...], matrices: np.ndarray) -> None:
        self.names, self.parents, self.matrices = names, parents, matrices
        self.ids = unique_words(names, _ALLOWED, _FIRST)


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
            world, as the document's do, and joints of no length (the neck of the rig) are left out. True: they hold
            local rotations and the rest offset, so that programs turn the bones. None: False for one frame, True for
            several.

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
    turned = take.motion.frames > 1 if rotations is None else rotations
    joints = _rotations(take) if turned else _translations(take)
    scene_id = _unused("skeleton", joints.ids)
    document = _Element("COLLADA", xmlns="http://www.collada.org/2005/11/COLLADASchema", version="1.4.1")
    document.append(_asset(take))
    if take.motion.frames > 1:
        document.append(_animations(take, joints))
    scenes = ElementTree.SubElement(document, "library_visual_scenes")
    scene = ElementTree.SubElement(scenes, "visual_scene", id=scene_id, name="skeleton")
    scene.append(_nodes(joints))
    ElementTree.SubElement(ElementTree.SubElement(document, "scene"), "instance_visual_scene", url=f"#{scene_id}")
    ElementTree.indent(document)
    body = ElementTree.tostring(document, encoding="unicode")
    dropped = [name for name in take.motion.names if name not in joints.names]
    more = ["rotations" if turned else "translations only"]
    more += [f"without {', '.join(dropped)} (no length)"] if dropped else []
    more += ["one unit is taken for a metre by programs that need one"] if take.motion.unit == "1" else []
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{body}\n', take.sentence(*more, joints=len(joints.names))


def _asset(take: Take) -> _Element:
    asset = _Element("asset")
    contributor = ElementTree.SubElement(asset, "contributor")
    ElementTree.SubElement(contributor, "authoring_tool").text = "jaxmocap"
    comments = f"frames per second: {take.motion.fps!r}. The dates mean nothing: equal input gives equal bytes."
    ElementTree.SubElement(contributor, "comments").text = comments
    ElementTree.SubElement(asset, "created").text = _NO_DATE
    ElementTree.SubElement(asset, "modified").text = _NO_DATE
    ElementTree.SubElement(
        asset, "unit", meter=repr(METRES.get(take.motion.unit, 1.0)), name=_UNIT_NAMES[take.motion.unit]
    )
    ElementTree.SubElement(asset, "up_axis").text = "Y_UP"
    return asset


def _nodes(joints: _Joints) -> _Element:
    """The root's node with all others inside; a still root at the origin has no matrix, as printed."""
    nodes: list[_Element] = []
    for word, parent, T in zip(joints.ids, joints.parents, joints.matrices.swapaxes(0, 1)):
        node = _Element("node", id=word, name=word, sid=word, type="JOINT")
        if parent >= 0 or len(T) > 1 or not np.array_equal(T[0], np.eye(4)):
            ElementTree.SubElement(node, "matrix", sid="transform").text = _numbers(T[0].ravel())
        nodes.append(node)
        if parent >= 0:
            nodes[parent].append(node)
    for name, word, node in zip(joints.names, joints.ids, nodes):  # `extra` comes after the inner nodes
        if word != name:
            technique = ElementTree.SubElement(ElementTree.SubElement(node, "extra"), "technique", profile="jaxmocap")
            ElementTree.SubElement(technique, "name").text = name
    return nodes[joints.parents.index(-1)]


def _animations(take: Take, joints: _Joints) -> _Element:
    """One animation per joint: a matrix at each time."""
    library = _Element("library_animations")
    start, n = _unused("animation", joints.ids), take.motion.frames
    for joint, word in enumerate(joints.ids):
        name = f"{start}-{joint}"
        animation = ElementTree.SubElement(library, "animation", id=name)
        _source(animation, f"{name}-time", "float", _numbers(take.times), n, 1, "TIME", "float")
        values = _numbers(joints.matrices[:, joint].ravel())
        _source(animation, f"{name}-matrix", "float", values, n, 16, "TRANSFORM", "float4x4")
        _source(animation, f"{name}-kind", "Name", " ".join(["LINEAR"] * n), n, 1, "INTERPOLATION", "name")
        sampler = ElementTree.SubElement(animation, "sampler", id=f"{name}-sampler")
        for semantic, part in (("INPUT", "time"), ("OUTPUT", "matrix"), ("INTERPOLATION", "kind")):
            ElementTree.SubElement(sampler, "input", semantic=semantic, source=f"#{name}-{part}")
        ElementTree.SubElement(animation, "channel", source=f"#{name}-sampler", target=f"{word}/transform")
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


def _translations(take: Take) -> _Joints:
    """From each parent's joint to the next along the world's axes, eq. 6.1-6.3."""
    names, parents, steps = take.motion.world_translations()
    matrices = np.tile(np.eye(4), (*steps.shape[:2], 1, 1))
    matrices[..., :3, 3] = steps
    return _Joints(names, parents, matrices)


def _rotations(take: Take) -> _Joints:
    """Local rotation and rest offset of every joint."""
    m = take.motion
    matrices = np.tile(np.eye(4), (m.frames, len(m.names), 1, 1))
    turns = Rotation.from_quat(take.quaternions.reshape(-1, 4)).as_matrix()
    matrices[..., :3, :3] = turns.reshape(m.frames, -1, 3, 3)
    matrices[..., :3, 3] = m.offsets
    matrices[:, m.parents.index(-1), :3, 3] = m.root
    return _Joints(m.names, m.parents, matrices)


def _numbers(values: Iterable[float]) -> str:
    # Rounding turns what is left of a cosine of 90 degrees into 0, and + 0.0 turns -0 into 0.
    return " ".join(f"{round(float(v), 12) + 0.0:.10g}" for v in values)
