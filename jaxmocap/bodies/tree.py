"""Trees of joints and their forward kinematics."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmocap._arrays import Vector3
from jaxmocap._errors import InputError
from jaxmocap.geometry import Pose, rotation


def check_tree(names: Sequence[str], parents: Sequence[int]) -> None:
    """Refuse what is no tree of joints.

    Raises:
        InputError: no joints, empty or repeated names, a parent that does not exist, no root or two, a cycle, or a
            parent that comes after its child.
    """
    if len(names) != len(parents) or not names:
        raise InputError(f"parents: expected one per joint and at least one joint, got {len(parents)} for {len(names)}")
    if not all(isinstance(name, str) and name.strip() for name in names):
        raise InputError(f"names: expected a name for every joint, got {list(names)}")
    if len(set(names)) < len(names):
        twice = next(name for name in names if list(names).count(name) > 1)
        raise InputError(f"names: joint {twice!r} is there twice")
    for name, parent in zip(names, parents):
        if not -1 <= parent < len(names):
            raise InputError(f"parents: joint {name!r} has parent {parent}; expected -1 or 0..{len(names) - 1}")
    roots = [name for name, parent in zip(names, parents) if parent == -1]
    if len(roots) > 1:
        raise InputError(f"parents: expected one root, got {len(roots)}: {', '.join(roots)}")
    for i, name in enumerate(names):
        at, steps = i, 0
        while at != -1 and steps <= len(names):
            at, steps = parents[at], steps + 1
        if at != -1:
            raise InputError(f"parents: joint {name!r} hangs on a cycle; every joint must lead to the root")
        if parents[i] >= i:
            raise InputError(f"parents: joint {name!r} comes before its parent {names[parents[i]]!r}; sort the joints")


class KinematicTree(eqx.Module):
    """Joints that hang on one another; parents come before their children.

    Source: stop-motion document, 6.1.
    """

    offsets: Float[Array, "*batch joints 3"]
    """Rest offset of each joint from its parent's joint, in the parent's frame [scene]; the root's is not used."""
    names: tuple[str, ...] = eqx.field(static=True)
    parents: tuple[int, ...] = eqx.field(static=True)
    """Index of the parent, -1 for the root."""

    def __check_init__(self):
        check_tree(self.names, self.parents)
        shape = getattr(self.offsets, "shape", None)
        if shape is not None and shape[-2:] != (len(self.names), 3):
            raise InputError(f"offsets: expected ({len(self.names)}, 3), got {shape}")

    def index(self, name: str) -> int:
        """Place of a joint.

        Raises:
            InputError: if there is none of that name.
        """
        if name not in self.names:
            raise InputError(f"there is no joint {name!r}; there are {', '.join(self.names)}")
        return self.names.index(name)


def _ancestors(parents: tuple[int, ...]) -> list[np.ndarray]:
    """For rounds k = 0, 1, ...: each joint's ancestor 2^k steps up, or `len(parents)` (nobody) above the root."""
    nobody = len(parents)
    up = np.array([nobody if p == -1 else p for p in parents] + [nobody])
    rounds = []
    while (up[:-1] != nobody).any():
        rounds.append(up[:-1].copy())
        up = up[up]
    return rounds


def chain(
    parents: tuple[int, ...], R_parent_joint: Float[Array, "joints 3 3"], t_parent_joint: Float[Array, "joints 3"]
) -> tuple[Float[Array, "joints 3 3"], Float[Array, "joints 3"]]:
    """Every joint's pose in the world from every joint's pose in its parent (the root's: in the world).

    Joints are composed with their ancestors 1, 2, 4, ... steps up: three rounds for a depth of eight, instead of one
    product per joint, which is what compiles quickly.

    Args:
        parents: index of the parent, -1 for the root.
        R_parent_joint: rotations.
        t_parent_joint: origins of the joints in their parents [scene].

    Returns:
        R_world_joint, p_world: the same in the world.
    Source: stop-motion document, 6.1 (hierarchic structure).
    """
    R, t = R_parent_joint, t_parent_joint
    eye, zero = jnp.eye(3, dtype=R.dtype)[None], jnp.zeros((1, 3), t.dtype)
    for above in _ancestors(parents):
        R_above, t_above = jnp.concatenate([R, eye])[above], jnp.concatenate([t, zero])[above]
        t = jnp.sum(R_above * t[:, None, :], axis=2) + t_above
        R = jnp.sum(R_above[:, :, :, None] * R[:, None, :, :], axis=2)
    return R, t


def joint_matrices(
    tree: KinematicTree, rotvec: Float[Array, "joints 3"], root: Vector3
) -> tuple[Float[Array, "joints 3 3"], Float[Array, "joints 3"]]:
    """Orientation and position of every joint in the world.

    Args:
        tree: the joints.
        rotvec: rotation of each joint relative to its parent's frame [rad] (root: to the world).
        root: position of the root [scene].

    Returns:
        R_world_joint, p_world [scene].
    Source: stop-motion document, 6.1-6.3, with rotations in place of its world translations.
    """
    at_root = (np.array(tree.parents) == -1)[:, None]
    return chain(tree.parents, jax.vmap(rotation.exp)(rotvec), jnp.where(at_root, root[None, :], tree.offsets))


def forward_kinematics(tree: KinematicTree, rotvec: Float[Array, "joints 3"], root: Vector3) -> Pose:
    """Pose of every joint in the world.

    Args:
        tree: the joints.
        rotvec: rotation of each joint relative to its parent's frame [rad] (root: to the world).
        root: position of the root [scene].

    Returns:
        T_world_joint, stacked over the joints.
    Source: stop-motion document, 6.1-6.3; `joint_matrices` is the same without logarithms.
    """
    R, p = joint_matrices(tree, rotvec, root)
    return Pose(jax.vmap(rotation.log)(R), p)
