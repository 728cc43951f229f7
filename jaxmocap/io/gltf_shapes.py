"""What a viewer shows of a skeleton: a slender octahedron for each bone, small balls for joints and markers."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

_GIRTH = 0.09
"""Half the width of a bone in lengths: slender enough that neighbours stay apart."""


class Mesh(NamedTuple):
    """Triangles without shared corners, so that each face is flat, or with shared ones and smooth normals."""

    positions: np.ndarray
    """(corners, 3)."""
    normals: np.ndarray
    """(corners, 3), of length 1."""
    joint: np.ndarray
    """(corners,) number of the joint that carries the corner."""


def bones(p_rest: np.ndarray, parents: tuple[int, ...]) -> Mesh:
    """Octahedra from each parent's joint to its child's, at rest; bones of no length are left out.

    Args:
        p_rest: (joints, 3) joints at rest.
        parents: -1 for the root.

    Returns:
        The mesh, carried by the parents; empty where there is no bone.
    """
    parts = [
        (_octahedron(p_rest[parent], p_rest[joint]), parent)
        for joint, parent in enumerate(parents)
        if parent >= 0 and np.linalg.norm(p_rest[joint] - p_rest[parent]) > 0
    ]
    return _joined([(*part, np.full(len(part[0]), carrier)) for part, carrier in parts])


def balls(p_rest: np.ndarray, radius: float) -> Mesh:
    """A small ball at each joint, carried by it."""
    ball = unit_ball()
    return _joined(
        [(p + radius * ball, ball, np.full(len(ball), joint)) for joint, p in enumerate(p_rest)]
    )  # fmt: skip


def unit_ball() -> np.ndarray:
    """(240, 3): an icosahedron whose faces are cut into four once, on the unit sphere; three rows are a triangle."""
    golden = (1 + 5**0.5) / 2
    corners = np.array([(0, s, t * golden) for s in (-1, 1) for t in (-1, 1)], dtype=float)
    corners = np.concatenate([np.roll(corners, k, axis=1) for k in range(3)])
    gaps = np.linalg.norm(corners[:, None] - corners[None], axis=2)
    near = np.isclose(gaps, 2.0)  # the edge of this icosahedron
    n = len(corners)
    faces = [
        (a, b, c) for a in range(n) for b in range(a) for c in range(b) if near[a, b] and near[b, c] and near[a, c]
    ]  # fmt: skip
    triangles = []
    for a, b, c in (corners[list(face)] for face in faces):
        if np.dot(np.cross(b - a, c - a), a) < 0:
            b, c = c, b
        ab, bc, ca = a + b, b + c, c + a
        triangles += [(2 * a, ab, ca), (2 * b, bc, ab), (2 * c, ca, bc), (ab, bc, ca)]
    points = np.array(triangles).reshape(-1, 3)
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def _octahedron(start: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners and normals of the eight faces; the waist lies at a fifth of the way."""
    axis = end - start
    length = np.linalg.norm(axis)
    axis = axis / length
    side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    side = side / np.linalg.norm(side)
    across = np.cross(axis, side)
    waist = [start + length * (0.2 * axis + _GIRTH * d) for d in (side, across, -side, -across)]
    faces = []
    for one, two in pairwise([*waist, waist[0]]):
        faces += [(one, two, end), (two, one, start)]
    triangles = np.array(faces)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    return triangles.reshape(-1, 3), np.repeat(normals, 3, axis=0)


def _joined(parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> Mesh:
    if not parts:
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, dtype=int))
    return Mesh(*(np.concatenate(column) for column in zip(*parts)))
