"""Binary glTF 2.0 (GLB): joints that turn, bones that viewers show, markers as balls; metres, y up, seconds."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap._errors import InputError
from jaxmocap.bodies.motion import SkeletonMotion
from jaxmocap.io.atomic import write_bytes
from jaxmocap.io.gltf_chunks import ARRAY_BUFFER, Buffer, glb_container
from jaxmocap.io.gltf_shapes import Mesh, balls, bones, unit_ball
from jaxmocap.io.take import Take, points_in_file, prepare_take

Colour = tuple[float | int, float | int, float | int]
"""Red, green, blue, 0..1, as in a picture (sRGB)."""

_BONE: Colour = (0.75, 0.78, 0.84)
_JOINT: Colour = (0.25, 0.45, 0.8)
_MARKER: Colour = (0.95, 0.6, 0.1)
_BALL = 0.012  # radius of a ball, in sizes of the skeleton: about a thumb's width on a person


def write_glb(
    path: str | Path,
    motion: SkeletonMotion,
    *,
    unit: str | None = None,
    up: str = "y",
    fps: float | None = None,
    gaps: int = 0,
    markers: Mapping[str, np.ndarray] | None = None,
    colours: Mapping[str, Colour] | None = None,
) -> str:
    """Write a motion as binary glTF, whole or not at all.

    Joints are nodes with a rotation (quaternion) each; a skin carries one octahedron per bone. Markers are balls
    that stand in the world, and vanish in the frames where they were not seen.

    Args:
        path: the file.
        motion: the motion.
        unit: "m" or None: glTF knows only metres. A motion without a physical unit is written as if it were in
            metres, and the sentence says so.
        up: axis of the motion's world that points up; it becomes y, as glTF demands.
        fps: frames per second; None takes the motion's own. The file's keys are in seconds.
        gaps: longest run of missing frames that is interpolated.
        markers: (frames, 3) positions by name, in the unit and the world of the motion; NaN where not seen.
        colours: of markers, by name; orange where none is given.

    Returns:
        One sentence on what was written.

    Raises:
        InputError: for a motion that no file can hold, or if the file cannot be written.
    """
    data, said = glb_bytes(motion, unit=unit, up=up, fps=fps, gaps=gaps, markers=markers, colours=colours)
    write_bytes(path, data)
    return f"{path}: {said}"


def glb_bytes(
    motion: SkeletonMotion,
    *,
    unit: str | None = None,
    up: str = "y",
    fps: float | None = None,
    gaps: int = 0,
    markers: Mapping[str, np.ndarray] | None = None,
    colours: Mapping[str, Colour] | None = None,
) -> tuple[bytes, str]:
    """The bytes that `write_glb` writes, and its sentence without the file name.

    Raises:
        InputError: as `write_glb`.
    """
    if unit not in (None, "m"):
        raise InputError(f"unit: glTF files are in metres; expected 'm', got {unit!r}. Leave unit= out.")
    wanted = "1" if motion.unit == "1" else "m"
    take = prepare_take(motion, unit=wanted, up=up, fps=fps, gaps=gaps)
    seen = _markers(markers or {}, motion.frames, motion.unit, wanted, up)
    document = _Document(take)
    document.add_skeleton()
    for name, p_file in seen.items():
        document.add_marker(name, p_file, (colours or {}).get(name, _MARKER))
    lost = [name for name in markers or {} if name not in seen]
    more = [f"{len(seen)} markers"] if seen else []
    more += [f"never seen and left out: {', '.join(lost)}"] if lost else []
    more += ["one unit counts as one metre"] if wanted == "1" else []
    return document.finish(motion.unit), take.sentence(*more)


def _markers(markers: Mapping[str, np.ndarray], frames: int, unit: str, wanted: str, up: str) -> dict[str, np.ndarray]:
    """Positions in the file by name, without markers that are never seen."""
    kept = {}
    for name, positions in markers.items():
        p_world = np.asarray(positions, dtype=float)
        if p_world.shape != (frames, 3):
            raise InputError(
                f"markers: {name!r}: expected shape ({frames}, 3), one row per frame, got {p_world.shape}."
            )
        if np.isfinite(p_world).all(axis=1).any():
            kept[name] = points_in_file(p_world, unit, wanted, up)
    return kept


class _Document:
    """The glTF under construction; nodes 0..joints-1 are the joints."""

    def __init__(self, take: Take) -> None:
        self.take = take
        self.buffer = Buffer()
        self.nodes: list[dict[str, Any]] = []
        self.scene: list[int] = []
        self.meshes: list[dict[str, Any]] = []
        self.materials: list[dict[str, Any]] = []
        self.skins: list[dict[str, Any]] = []
        self.channels: list[dict[str, Any]] = []
        self.samplers: list[dict[str, Any]] = []
        self.balls: dict[Colour, int] = {}
        self.times = self.buffer.add(take.times, bounds=True) if take.motion.frames > 1 else -1
        self.p_rest = p_rest = np.zeros((len(take.motion.names), 3))
        for joint, parent in enumerate(take.motion.parents):
            p_rest[joint] = take.motion.offsets[joint] + (p_rest[parent] if parent >= 0 else 0.0)
        size = float(np.max(np.ptp(p_rest, axis=0)))
        self.radius = _BALL * (size if size > 0 else 1.0)

    def add_skeleton(self) -> None:
        """The joints with their motion, and the skin on them."""
        take, m = self.take, self.take.motion
        for joint, name in enumerate(m.names):
            translation = m.root[0] if m.parents[joint] < 0 else m.offsets[joint]
            node = {"name": name, "translation": _floats(translation), "rotation": _floats(take.quaternions[0, joint])}
            children = take.children(joint)
            self.nodes.append(node | ({"children": children} if children else {}))
            if np.ptp(take.quaternions[:, joint], axis=0).any():
                self._animate(joint, "rotation", take.quaternions[:, joint])
        root = m.parents.index(-1)
        if np.ptp(m.root, axis=0).any():
            self._animate(root, "translation", m.root)
        inverse_bind = np.tile(np.eye(4), (len(m.names), 1, 1))
        inverse_bind[:, 3, :3] = -self.p_rest  # glTF stores matrices by columns
        joints = list(range(len(m.names)))
        self.skins.append({"joints": joints, "skeleton": root, "inverseBindMatrices": self.buffer.add(inverse_bind)})
        parts = ((bones(self.p_rest, m.parents), _BONE), (balls(self.p_rest, self.radius), _JOINT))
        primitives = [self._primitive(mesh, colour, skinned=True) for mesh, colour in parts if len(mesh.positions)]
        self.meshes.append({"name": "skeleton", "primitives": primitives})
        self.nodes.append({"name": "skeleton", "mesh": len(self.meshes) - 1, "skin": 0})
        self.scene += [root, len(self.nodes) - 1]

    def add_marker(self, name: str, p_file: np.ndarray, colour: Colour) -> None:
        """A ball; in frames without a position it shrinks to nothing, in one step."""
        if colour not in self.balls:
            ball = unit_ball()
            mesh = Mesh(1.3 * self.radius * ball, ball, np.zeros(0))  # a little larger than the joint it may sit on
            self.meshes.append({"name": "marker", "primitives": [self._primitive(mesh, colour, skinned=False)]})
            self.balls[colour] = len(self.meshes) - 1
        seen = np.asarray(np.isfinite(p_file).all(axis=1))
        # Where it is hidden its place does not matter; where it was last seen keeps the file free of NaN.
        last_seen = np.maximum.accumulate(np.where(seen, np.arange(len(seen)), np.argmax(seen)))
        placed = p_file[last_seen]
        node = {"name": name, "mesh": self.balls[colour], "translation": _floats(placed[0])}
        self.nodes.append(node | ({} if seen[0] else {"scale": [0.0, 0.0, 0.0]}))
        self.scene.append(len(self.nodes) - 1)
        if np.ptp(placed, axis=0).any():
            self._animate(len(self.nodes) - 1, "translation", placed)
        if not seen.all():
            self._animate(len(self.nodes) - 1, "scale", np.repeat(seen[:, None], 3, axis=1), "STEP")

    def finish(self, unit: str) -> bytes:
        """The file."""
        content: dict[str, Any] = {
            "asset": {
                "version": "2.0",
                "generator": "jaxmocap",
                "extras": {"fps": self.take.motion.fps, "source_unit": unit},
            },
            "scene": 0,
            "scenes": [{"name": "scene", "nodes": self.scene}],
            "nodes": self.nodes,
            "meshes": self.meshes,
            "materials": self.materials,
            "skins": self.skins,
        }
        if self.channels:
            content["animations"] = [{"name": "take", "channels": self.channels, "samplers": self.samplers}]
        return glb_container(content, self.buffer)

    def _animate(self, node: int, path: str, values: np.ndarray, interpolation: str = "LINEAR") -> None:
        output = self.buffer.add(values)
        self.samplers.append({"input": self.times, "output": output, "interpolation": interpolation})
        self.channels.append({"sampler": len(self.samplers) - 1, "target": {"node": node, "path": path}})

    def _primitive(self, mesh: Mesh, colour: Colour, skinned: bool) -> dict[str, Any]:
        linear = [((c + 0.055) / 1.055) ** 2.4 if c > 0.04045 else c / 12.92 for c in colour]  # sRGB's own curve
        surface = {"baseColorFactor": [*linear, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.6}
        self.materials.append({"pbrMetallicRoughness": surface})
        attributes = {
            "POSITION": self.buffer.add(mesh.positions, bounds=True, target=ARRAY_BUFFER),
            "NORMAL": self.buffer.add(mesh.normals, target=ARRAY_BUFFER),
        }
        if skinned:
            carriers, weights = np.zeros((2, len(mesh.joint), 4))
            carriers[:, 0], weights[:, 0] = mesh.joint, 1.0
            attributes["JOINTS_0"] = self.buffer.add(carriers, dtype="<u2", target=ARRAY_BUFFER)
            attributes["WEIGHTS_0"] = self.buffer.add(weights, target=ARRAY_BUFFER)
        return {"attributes": attributes, "material": len(self.materials) - 1}


def _floats(values: np.ndarray) -> list[float]:
    """Numbers rounded to what the arrays of the file hold, so that the still pose is the first key exactly."""
    return [float(v) + 0.0 for v in np.asarray(values, dtype=np.float32)]
