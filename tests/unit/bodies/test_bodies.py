"""Trees, motions and the puppet's data: hand-computed positions, the document's example, and what is refused."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap._errors import InputError
from jaxmocap.bodies import KinematicTree, SkeletonMotion, forward_kinematics, puppet
from jaxmocap.bodies.tree import check_tree


def test_default_lengths_hold_the_document_s_example():
    example = np.linalg.norm([3.2703316, -0.31502795, -0.3093352])  # l-elbow from l-shoulder, 6.3, centimetres
    np.testing.assert_allclose(puppet.DEFAULT_LENGTHS["l-elbow-joint"], 10 * example, rtol=1e-7)
    # Drillis and Contini: upper arm 0.186, shank 0.246, half the shoulders 0.129, trunk 0.288 of the stature.
    np.testing.assert_allclose(puppet.DEFAULT_LENGTHS["r-foot-joint"], 33.0 * 246 / 186, atol=5e-4)
    np.testing.assert_allclose(puppet.DEFAULT_LENGTHS["r-shoulder-joint"], 33.0 * 129 / 186, atol=5e-4)
    trunk = puppet.DEFAULT_LENGTHS["lower-back-joint"] + puppet.DEFAULT_LENGTHS["upper-back-joint"]
    np.testing.assert_allclose(trunk, 33.0 * 288 / 186, atol=1e-3)


def test_hierarchy_of_the_document():
    assert puppet.PARENTS["l-toes-joint"] == "l-foot-joint" and puppet.PARENTS["l-foot-joint"] == "l-knee-joint"
    assert puppet.PARENTS["head-joint"] == "upper-back-joint" == puppet.PARENTS["r-shoulder-joint"]
    assert {j for j, p in puppet.PARENTS.items() if p == "root-joint"} == {
        "lower-back-joint", "l-hip-joint", "r-hip-joint",
    }  # fmt: skip
    assert len(puppet.JOINTS) == 20 and set(puppet.RIG_JOINTS) - set(puppet.JOINTS) == {"neck-joint"}
    check_tree(puppet.RIG_JOINTS, puppet.rig_parents())


def test_sixteen_beads_and_ten_bones():
    assert len(puppet.MARKERS) == 16 == len(puppet.DOCUMENT_COLOURS)
    assert puppet.DOCUMENT_COLOURS["arm.R2"] == (0.978, 0.265, 0.598)
    assert puppet.DOCUMENT_COLOURS["leg.R3"] == (0.554, 0.431, 0.790)
    assert puppet.BONES[3] == ("l-hand-joint", "arm.L2", "arm.L3") and len(puppet.BONES) == 10
    assert {m for b in puppet.BONES for m in (b.m1, b.m2)} == set(puppet.MARKERS)


def test_missing_lengths_follow_the_other_side_and_the_proportions():
    full = puppet.complete_lengths({"l-elbow-joint": 66.0})
    assert full["r-elbow-joint"] == 66.0
    np.testing.assert_allclose(full["l-hand-joint"], 2 * puppet.DEFAULT_LENGTHS["l-hand-joint"])
    assert puppet.complete_lengths() == dict(puppet.DEFAULT_LENGTHS)


@pytest.mark.parametrize("lengths", [{"tail": 1.0}, {"head-joint": 0.0}, {"head-joint": -1.0}, {"head-joint": np.nan}])
def test_impossible_lengths_are_refused(lengths):
    with pytest.raises(InputError, match="lengths"):
        puppet.complete_lengths(lengths)


def two_links(rotvec, root=(0.0, 0.0, 0.0)):
    tree = KinematicTree(jnp.array([[9.0, 9, 9], [2.0, 0, 0], [1.0, 0, 0]]), ("a", "b", "c"), (-1, 0, 1))
    return forward_kinematics(tree, jnp.array(rotvec), jnp.array(root))


def test_two_links_by_hand():
    quarter = np.pi / 2
    T = two_links([[0, 0, quarter], [0, 0, quarter / 2], [0.0, 0, 0]], root=(10.0, 0, 0))
    h = np.sqrt(0.5)
    np.testing.assert_allclose(T.translation, [[10, 0, 0], [10, 2, 0], [10 - h, 2 + h, 0]], atol=1e-14)
    np.testing.assert_allclose(T.rotvec[:, 2], [quarter, 1.5 * quarter, 1.5 * quarter], atol=1e-14)


def test_the_root_s_offset_is_not_used():
    np.testing.assert_allclose(two_links(np.zeros((3, 3))).translation[0], 0.0, atol=0)


BAD_TREES = [
    (("a", "b"), (1, 0), "cycle"),
    (("a", "b", "c"), (-1, 2, 1), "cycle"),
    (("a", "b"), (-1, -1), "one root"),
    (("a", "b"), (-1, 5), "parent 5"),
    (("a", "b"), (-1, -2), "parent -2"),
    (("a", "a"), (-1, 0), "twice"),
    (("a", " "), (-1, 0), "name"),
    (("a", "b"), (-1,), "one per joint"),
    ((), (), "at least one"),
    (("a", "b"), (1, -1), "comes before its parent"),
]


@pytest.mark.parametrize("names, parents, said", BAD_TREES)
def test_what_is_no_tree_is_refused(names, parents, said):
    n = len(names)
    with pytest.raises(InputError, match=said):
        KinematicTree(jnp.zeros((n, 3)), names, parents)
    with pytest.raises(InputError, match=said):
        SkeletonMotion(names, parents, np.zeros((n, 3)), np.zeros((1, n, 3)), np.zeros((1, 3)))


def motion(**changes):
    numbers = dict(
        names=("a", "b", "c"), parents=(-1, 0, 1), offsets=np.array([[0.0, 0, 0], [2, 0, 0], [1, 0, 0]]),
        rotvec=np.zeros((2, 3, 3)), root=np.zeros((2, 3)),
    )  # fmt: skip
    return SkeletonMotion(**{**numbers, **changes})


@pytest.mark.parametrize(
    "changes, said",
    [
        ({"rotvec": np.full((2, 3, 3), np.inf)}, "rotvec"),
        ({"root": np.zeros((1, 3))}, "root"),
        ({"offsets": np.zeros((2, 3))}, "offsets"),
        ({"rotvec": np.zeros((0, 3, 3)), "root": np.zeros((0, 3))}, "frame"),
        ({"fps": 0.0}, "fps"),
        ({"fps": float("nan")}, "fps"),
        ({"unit": ""}, "unit"),
    ],
)
def test_motions_that_cannot_be_are_refused(changes, said):
    with pytest.raises(InputError, match=said):
        motion(**changes)


def test_motion_in_the_world_and_as_the_document_s_translations():
    quarter = np.pi / 2
    rotvec = np.array([[[0, 0, quarter], [0, 0, quarter], [0, 0, 0]]] * 2)
    m = motion(rotvec=rotvec, root=np.array([[10.0, 0, 0], [0, 0, 7]]))
    R, p = m.world()
    np.testing.assert_allclose(p, [[[10, 0, 0], [10, 2, 0], [9, 2, 0]], [[0, 0, 7], [0, 2, 7], [-1, 2, 7]]], atol=1e-14)
    np.testing.assert_allclose(R[0, 2], [[-1, 0, 0], [0, -1, 0], [0, 0, 1]], atol=1e-14)
    names, parents, t = m.world_translations()
    assert names == m.names and parents == m.parents
    np.testing.assert_allclose(t[0], [[10, 0, 0], [0, 2, 0], [-1, 0, 0]], atol=1e-14)


def test_joints_without_length_are_left_out_of_the_document_s_hierarchy():
    m = SkeletonMotion(
        puppet.RIG_JOINTS, puppet.rig_parents(), puppet.rest_offsets(), np.zeros((1, 21, 3)), np.zeros((1, 3))
    )
    names, parents, t = m.world_translations()
    assert dict(zip(names, [None if p < 0 else names[p] for p in parents])) == dict(puppet.PARENTS)
    np.testing.assert_allclose(t[0, names.index("head-joint")], [0, puppet.DEFAULT_LENGTHS["head-joint"], 0])
