"""Reading a GLB for its motion: where joints and separate objects are at every key."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from jaxmocap.io.glb_container import GlbFile
from jaxmocap.io.length_units import METRES

_MAX_DEPTH = 1000


@dataclass(frozen=True)
class GlbTracks:
    """What moves in a GLB, in its world (metres, y up)."""

    times: np.ndarray
    """(frames,) seconds, increasing; one where nothing is animated."""
    joint_names: tuple[str, ...]
    joint_parents: tuple[int, ...]
    """Index of the next joint above, -1 where there is none."""
    p_joint: np.ndarray
    """(frames, joints, 3)."""
    object_names: tuple[str, ...]
    """Nodes with a mesh of their own that is not bound to joints: markers."""
    p_object: np.ndarray
    """(frames, objects, 3); NaN where it is shrunk to nothing, which is how our files hide what was not seen."""
    object_colours: tuple[tuple[float, float, float] | None, ...]
    """sRGB, 0..1."""
    fps: float | None
    """Frames per second as our files state them."""
    source_unit: str
    """Unit of the lengths before they were put into metres, as our files state it; "m" elsewhere."""


def read_glb(path: str | Path) -> GlbTracks:
    """Read joints and separate objects of a GLB file.

    Args:
        path: binary glTF 2.0 with its numbers inside.

    Returns:
        Positions at every key of any animation (linear or in steps; smooth curves are read at their keys alone).

    Raises:
        InputError: for what is no GLB, is damaged, or holds neither joints nor objects.
    """
    file = GlbFile(path)
    nodes = file.objects("nodes")
    above = _parents(file, nodes)
    moves = _animations(file, len(nodes))
    times = np.unique(np.concatenate([[0.0], *(track[0] for track in moves.values())]))
    if moves and min(track[0][0] for track in moves.values()) > 0:
        times = times[1:]  # nothing is animated at 0
    joints = list(
        dict.fromkeys(
            j for skin in file.objects("skins") for j in file.indices(skin.get("joints"), len(nodes), "skin joints")
        )
    )
    objects = [i for i, node in enumerate(nodes) if "mesh" in node and "skin" not in node and i not in set(joints)]
    if not joints and not objects:
        raise file.wrong("holds neither joints nor objects to show")
    found = dict(_world(file, nodes, above, moves, times, {*joints, *objects}))
    none = np.zeros((len(times), 0, 3))
    fps, unit = _stated(file)
    return GlbTracks(
        times,
        tuple(_name(nodes, i) for i in joints),
        tuple(_joint_above(i, above, joints) for i in joints),
        np.stack([found[i][1] for i in joints], axis=1) if joints else none,
        tuple(_name(nodes, i) for i in objects),
        np.stack([_unless_shrunk(*found[i]) for i in objects], axis=1) if objects else none,
        tuple(_colour(file, nodes[i]) for i in objects),
        fps,
        unit,
    )


def _name(nodes: list[dict[str, Any]], number: int) -> str:
    name = nodes[number].get("name")
    return name if isinstance(name, str) and name.strip() else f"node {number}"


def _parents(file: GlbFile, nodes: list[dict[str, Any]]) -> list[int]:
    """Number of the node above each, -1 at the top.

    Raises:
        InputError: if a node hangs on two, or in a circle.
    """
    above = [-1] * len(nodes)
    for number, node in enumerate(nodes):
        for child in file.indices(node.get("children", []), len(nodes), f"children of node {number}"):
            if above[child] >= 0:
                raise file.wrong(f"node {child} hangs on two others")
            above[child] = number
    depth: dict[int, int] = {-1: 0}
    for number in range(len(nodes)):
        path = []
        at = number
        while at not in depth:
            path.append(at)
            at = above[at]
            if len(path) > _MAX_DEPTH:
                raise file.wrong(f"node {number} hangs in a circle, or too deep")
        for node in reversed(path):
            depth[node] = depth[above[node]] + 1
    return above


def _joint_above(joint: int, above: list[int], joints: list[int]) -> int:
    at = above[joint]
    while at >= 0 and at not in joints:
        at = above[at]
    return joints.index(at) if at >= 0 else -1


_Moves = dict[tuple[int, str], tuple[np.ndarray, np.ndarray, str]]
_KINDS = {"translation": "VEC3", "rotation": "VEC4", "scale": "VEC3"}


def _animations(file: GlbFile, nodes: int) -> _Moves:
    """Times, values and interpolation by node and property."""
    moves: _Moves = {}
    for animation in file.objects("animations")[:1]:  # further ones are other takes of the same joints
        samplers = file.objects("samplers", animation)
        for channel in file.objects("channels", animation):
            target = channel.get("target")
            if not isinstance(target, dict) or target.get("path") not in _KINDS or "node" not in target:
                continue
            node, path = file.index(target["node"], nodes, "animated node"), target["path"]
            sampler = samplers[file.index(channel.get("sampler"), len(samplers), "sampler")]
            what = f"{path} of node {node}"
            times = file.array(sampler.get("input"), "SCALAR", what)[:, 0]
            values = file.array(sampler.get("output"), _KINDS[path], what)
            way = sampler.get("interpolation", "LINEAR")
            if way == "CUBICSPLINE" and len(values) == 3 * len(times):
                values = values[1::3]  # tangent, value, tangent
            if len(times) != len(values) or not len(times) or (np.diff(times) <= 0).any():
                raise file.wrong(f"{what}: expected a value for each of its increasing times")
            moves[node, path] = (times, values, way if isinstance(way, str) else "LINEAR")
    return moves


def _world(
    file: GlbFile, nodes: list[dict[str, Any]], above: list[int], moves: _Moves, times: np.ndarray, wanted: set[int]
) -> Iterator[tuple[int, tuple[np.ndarray, np.ndarray]]]:
    """Linear part (frames, 3, 3) and position (frames, 3) of the nodes that are wanted."""
    children: dict[int, list[int]] = {}
    for number, parent in enumerate(above):
        children.setdefault(parent, []).append(number)
    start = (np.broadcast_to(np.eye(3), (len(times), 3, 3)), np.zeros((len(times), 3)))
    waiting = [(number, start) for number in children.get(-1, [])]
    while waiting:
        number, (A, p) = waiting.pop()
        A_local, p_local = _local(file, number, nodes[number], moves, times)
        here = (A @ A_local, p + np.einsum("fij,fj->fi", A, p_local))
        if number in wanted:
            yield number, here
        waiting += [(child, here) for child in children.get(number, [])]


def _local(
    file: GlbFile, number: int, node: dict[str, Any], moves: _Moves, times: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    if "matrix" in node:
        M = file.vector(node["matrix"], 16, f"matrix of node {number}").reshape(4, 4).T  # stored by columns
        return np.broadcast_to(M[:3, :3], (len(times), 3, 3)), np.broadcast_to(M[:3, 3], (len(times), 3))

    def values(path: str, default: list[float]) -> np.ndarray:
        if (number, path) in moves:
            return _at(*moves[number, path], times, path)
        fixed = file.vector(node.get(path, default), len(default), f"{path} of node {number}")
        return np.broadcast_to(fixed, (len(times), len(default)))

    q, scale = values("rotation", [0.0, 0.0, 0.0, 1.0]), values("scale", [1.0, 1.0, 1.0])
    if not (np.linalg.norm(q, axis=1) > 1e-6).all():
        raise file.wrong(f"rotation of node {number}: a quaternion of length 0")
    return Rotation.from_quat(q).as_matrix() * scale[:, None, :], values("translation", [0.0, 0.0, 0.0])


def _at(keys: np.ndarray, values: np.ndarray, way: str, times: np.ndarray, path: str) -> np.ndarray:
    """A property at other times; before the first and after the last key it stands still, as glTF says."""
    if len(keys) == len(times) and (keys == times).all():
        return values
    if way == "STEP" or len(keys) == 1:
        return values[np.clip(np.searchsorted(keys, times, side="right") - 1, 0, None)]
    if path == "rotation" and (np.linalg.norm(values, axis=1) > 1e-6).all():
        return Slerp(keys, Rotation.from_quat(values))(np.clip(times, keys[0], keys[-1])).as_quat()
    return np.stack([np.interp(times, keys, column) for column in values.T], axis=1)


def _unless_shrunk(A: np.ndarray, p: np.ndarray) -> np.ndarray:
    return np.where((np.abs(A).max(axis=(1, 2)) > 0)[:, None], p, np.nan)


def _colour(file: GlbFile, node: dict[str, Any]) -> tuple[float, float, float] | None:
    """Base colour of the first material of a node's mesh, from linear light to sRGB."""
    meshes, materials = file.objects("meshes"), file.objects("materials")
    primitives = file.objects("primitives", meshes[file.index(node["mesh"], len(meshes), "mesh")])
    if not primitives or "material" not in primitives[0]:
        return None
    surface = materials[file.index(primitives[0]["material"], len(materials), "material")].get("pbrMetallicRoughness")
    factor = surface.get("baseColorFactor") if isinstance(surface, dict) else None
    if factor is None:
        return None
    r, g, b = (float(np.clip(c, 0, 1)) for c in file.vector(factor, 4, "baseColorFactor")[:3])
    return _srgb(r), _srgb(g), _srgb(b)


def _srgb(linear: float) -> float:
    return 12.92 * linear if linear <= 0.0031308 else 1.055 * linear ** (1 / 2.4) - 0.055


def _stated(file: GlbFile) -> tuple[float | None, str]:
    """Frames per second and unit that our own files carry."""
    asset = file.content.get("asset")
    extras = asset.get("extras") if isinstance(asset, dict) else None
    extras = extras if isinstance(extras, dict) else {}
    fps, unit = extras.get("fps"), extras.get("source_unit")
    rate = float(fps) if isinstance(fps, int | float) and not isinstance(fps, bool) and 0 < fps < 1e9 else None
    return rate, unit if isinstance(unit, str) and unit in (*METRES, "1") else "m"
