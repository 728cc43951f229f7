"""The document's skeleton: printed formulas by hand, and poses in which they break down."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from puppet_poses import BEADS, MIRRORED, beads_of, pose, random_pose
from samplers import over
from scipy.spatial.transform import Rotation

from jaxmocap._errors import InputError
from jaxmocap.bodies import forward_kinematics
from jaxmocap.bodies.puppet import DEFAULT_LENGTHS, MARKERS, RIG_JOINTS
from jaxmocap.reconstruction.bone_directions import bone_directions, document_foot, document_shoulders, facing
from jaxmocap.reconstruction.skeleton import (
    BONE_NAMES,
    bone_translations,
    default_lengths,
    motion_from_poses,
    rig_tree,
    skeleton_from_markers,
)

X, Y, Z = np.eye(3)
ROW = {name: i for i, name in enumerate(BONE_NAMES)}
ALL = np.ones(16, bool)
RIGHT = [ROW["r" + n[1:] if n[:2] == "l-" else "l" + n[1:] if n[:2] == "r-" else n] for n in BONE_NAMES]


def repaired(points, seen):
    return skeleton_from_markers(points, seen, default_lengths())


def literal(points, seen):
    return skeleton_from_markers(points, seen, default_lengths(), literal=True)


def turned(points, seen, yaw):
    return skeleton_from_markers(points, seen, default_lengths(), yaw=yaw)


def kinematics(rotvec, root):
    return forward_kinematics(rig_tree(default_lengths()), rotvec, root)


def of(poses, convention=repaired, seen=None):
    return batch(convention, np.stack([beads_of(p) for p in poses]), ALL if seen is None else seen)


def batch(convention, points, seen=ALL):
    """Always twenty poses, so that each convention is compiled once."""
    n = len(points)
    padded = np.concatenate([points, np.broadcast_to(points[:1], (20 - n, 16, 3))])
    mask = np.ones((20, 16), bool)
    mask[:n] = seen
    return jax.tree.map(lambda x: x[:n], over(convention, padded, mask))


def direction(skeleton, k, name):
    return skeleton.directions[k, ROW[name]]


def test_the_document_s_example():
    """l-elbow relative to l-shoulder as printed in 6.3: length 3.3 along its direction."""
    printed = np.array([3.2703316, -0.31502795, -0.3093352])
    points = np.zeros((16, 3))
    points[BEADS.index("arm.L1")] = (1.0, 2, 3)
    points[BEADS.index("arm.L2")] = (1.0, 2, 3) + 7.0 * printed
    directions, valid = bone_directions(jnp.array(points), jnp.array(ALL))
    t = bone_translations(directions, jnp.full(10, 3.3))
    np.testing.assert_allclose(t[2], printed, atol=1e-7)
    assert valid[2] and not valid[0] and np.isfinite(directions).all()  # the other beads stand on one spot


def test_feet_and_shoulders_as_printed():
    foot, valid = document_foot(jnp.array([0.6, -0.8, 0.0]))  # (0.6, -0.8, 0) x (1, 0, 0) = (0, 0, 0.8)
    np.testing.assert_allclose(foot, Z, atol=1e-15)
    assert valid
    two, valid = document_shoulders(jnp.array([0.6, 0.8, 0.0]))  # (0.6, 0.8, 0) x (0, 0, 1) = (0.8, -0.6, 0)
    np.testing.assert_allclose(two, [[0.8, -0.6, 0.0], [-0.8, 0.6, 0.0]], atol=1e-15)
    assert valid


@pytest.mark.parametrize("formula, v", [(document_foot, X), (document_foot, -X), (document_shoulders, Z)])
def test_what_is_printed_has_no_value_there(formula, v):
    value, valid = formula(jnp.array(v))
    assert not valid and np.isfinite(value).all()
    assert np.isfinite(jax.jacfwd(lambda u: formula(u)[0])(jnp.array(v))).all()


def test_t_pose_is_zero_rotation():
    for convention in (repaired, literal):
        s = of([pose()], convention)
        np.testing.assert_allclose(s.rotvec, 0.0, atol=1e-12)
        assert s.valid.all()
        # Knees: 0.9 of their bead's 53 mm above ... the beads' mean height minus hip-to-knee, which points down.
        np.testing.assert_allclose(s.root[0], [0, 53 + DEFAULT_LENGTHS["l-knee-joint"], 0], atol=1e-9)


POSES = {
    "arm up along y": pose(arm_L=(Y, Y)),
    "arm down": pose(arm_L=(-Y, -Y), arm_R=(-Y, -Y)),
    "arm across to the other side": pose(arm_L=(-X, -X)),
    "elbow folded back": pose(arm_L=(X, -X)),
    "leg along x": pose(leg_L=(X, X)),
    "leg along -x": pose(leg_R=(-X, -X)),
    "leg kicked over the head": pose(leg_L=(Z, Y)),
    "leg straight up": pose(leg_L=(Y, Y)),
    "knee folded": pose(leg_L=(-Y, Y)),
    "back along z": pose(back=Z, head=Z),
    "back along -z": pose(back=-Z, head=-Z),
    "back along x": pose(back=X),
    "head over back": pose(head=-Y),
    "upside down": pose(back=-Y, head=-Y),
}


@pytest.fixture(scope="module")
def hard():
    return {c: of(POSES.values(), c) for c in (repaired, literal)}


@pytest.mark.parametrize("name", POSES)
def test_hard_poses_keep_every_bone_with_beads(hard, name):
    k, p = list(POSES).index(name), POSES[name]
    for s in hard.values():
        wanted = {"upper-back-joint": p["back"], "head-joint": p["head"]}
        for side in "LR":
            for limb, (upper, lower) in {"arm": ("elbow", "hand"), "leg": ("knee", "foot")}.items():
                a, b = p[side][limb]
                wanted |= {f"{side.lower()}-{upper}-joint": a, f"{side.lower()}-{lower}-joint": b}
        for bone, v in wanted.items():
            np.testing.assert_allclose(direction(s, k, bone), v, atol=1e-12, err_msg=bone)
        np.testing.assert_allclose(np.linalg.norm(s.directions[k], axis=-1), 1.0, atol=1e-12)
        assert np.isfinite(s.rotvec[k]).all() and np.isfinite(s.root[k]).all()


@pytest.mark.parametrize("name", POSES)
def test_repaired_feet_and_shoulders_are_perpendicular_and_valid(hard, name):
    s, k = hard[repaired], list(POSES).index(name)
    assert s.valid[k].all()
    for side in "lr":
        leg, toes = direction(s, k, f"{side}-foot-joint"), direction(s, k, f"{side}-toes-joint")
        back, shoulder = direction(s, k, "upper-back-joint"), direction(s, k, f"{side}-shoulder-joint")
        assert abs(leg @ toes) < 1e-12 and abs(back @ shoulder) < 1e-12
    np.testing.assert_allclose(direction(s, k, "l-shoulder-joint"), -direction(s, k, "r-shoulder-joint"), atol=1e-12)


@pytest.mark.parametrize(
    "name, bone, forward",
    [
        ("leg along x", "l-toes-joint", Z),  # a leg lifted sideways still points its toes forwards
        ("leg along -x", "r-toes-joint", Z),
        ("leg kicked over the head", "l-toes-joint", -Z),
        ("back along z", "l-shoulder-joint", X),  # a deep bow leaves the left shoulder on the left
        ("back along -z", "l-shoulder-joint", X),
        ("arm up along y", "l-finger-joint", Y),
    ],
)
def test_repaired_values_where_the_print_has_none(hard, name, bone, forward):
    k = list(POSES).index(name)
    np.testing.assert_allclose(direction(hard[repaired], k, bone), forward, atol=1e-12)


def test_the_literal_skeleton_says_where_it_has_no_value(hard):
    valid = hard[literal].valid
    assert not valid[list(POSES).index("leg along x"), ROW["l-toes-joint"]]
    assert not valid[list(POSES).index("back along z"), ROW["r-shoulder-joint"]]
    assert valid[list(POSES).index("arm up along y")].all()


def test_near_the_horizontal_leg_the_repaired_foot_does_not_flip():
    """As printed the toes turn from forwards to backwards when a leg that is lifted sideways passes the horizontal."""
    legs = [(np.cos(t), np.sin(t), 0.0) for t in (-0.02, -1e-6, 1e-6, 0.02)]
    poses = [pose(leg_L=(v, v)) for v in legs]
    found = of(poses)
    np.testing.assert_allclose([direction(found, k, "l-toes-joint") for k in range(4)], [Z] * 4, atol=1e-9)
    printed = of(poses, literal)
    np.testing.assert_allclose([direction(printed, k, "l-toes-joint") for k in (0, 3)], [Z, -Z], atol=1e-12)


@pytest.fixture(scope="module")
def twenty():
    rng = np.random.default_rng(4)
    return np.stack([beads_of(random_pose(rng, 1.0)) for _ in range(20)])


def test_conventions_agree_where_the_print_means_something(twenty):
    a, b = batch(repaired, twenty), batch(literal, twenty)
    away = np.ones((20, len(BONE_NAMES)), bool)
    for side in "lr":  # 20 degrees and more from the direction where the cross product vanishes, and not flipped
        leg, toes = a.directions[:, ROW[f"{side}-foot-joint"]], b.directions[:, ROW[f"{side}-toes-joint"]]
        away[:, ROW[f"{side}-toes-joint"]] = (np.abs(leg[:, 0]) < np.cos(np.radians(20.0))) & (toes[:, 2] > 0)
    assert away.mean() > 0.9
    np.testing.assert_allclose(a.directions[away], b.directions[away], atol=1e-12)


def test_kinematics_of_the_result_gives_back_directions_and_lengths(twenty):
    s = batch(repaired, twenty)
    p = over(kinematics, s.rotvec, s.root).translation
    lengths = np.array([DEFAULT_LENGTHS[n] for n in BONE_NAMES])
    m = motion_from_poses(s, lengths, "mm")
    np.testing.assert_allclose(m.world()[1], p, atol=1e-9)
    names, _, t = m.world_translations()
    for k, name in enumerate(BONE_NAMES):
        wanted = lengths[k] * s.directions[:, k]
        np.testing.assert_allclose(t[:, names.index(name)], wanted, atol=1e-9, err_msg=name)


@pytest.mark.parametrize("angle", [0.3, 2.5, -3.1])
def test_turning_the_whole_puppet_turns_the_skeleton(twenty, angle):
    R = Rotation.from_rotvec(angle * Y).as_matrix()
    seen = np.broadcast_to(ALL, (20, 16))
    plain = over(turned, twenty, seen, np.zeros(20))
    moved = over(turned, twenty @ R.T, seen, np.full(20, angle))
    np.testing.assert_allclose(moved.directions, plain.directions @ R.T, atol=1e-10)
    local = [i for i, name in enumerate(RIG_JOINTS) if name != "root-joint"]
    np.testing.assert_allclose(moved.rotvec[:, local], plain.rotvec[:, local], atol=1e-9)
    np.testing.assert_allclose(moved.rotvec[:, 0], angle * np.broadcast_to(Y, (20, 3)), atol=1e-12)


def test_a_mirrored_puppet_has_the_mirrored_skeleton(twenty):
    flip = np.array([-1.0, 1, 1])
    for convention in (repaired, literal):
        plain, mirrored = batch(convention, twenty), batch(convention, twenty[:, MIRRORED] * flip)
        np.testing.assert_allclose(mirrored.directions, plain.directions[:, RIGHT] * flip, atol=1e-10)


def test_a_puppet_that_faces_away_is_noticed():
    points = beads_of(pose(arm_L=(X, Y)))
    for angle in (0.0, 1.0, 2.0, np.pi - 0.01, -2.0):
        R = Rotation.from_rotvec(angle * Y).as_matrix()
        measured, known = facing(jnp.array(points @ R.T), jnp.array(ALL))
        assert known and abs(float(measured) - angle) < 1e-9
        toes = batch(repaired, (points @ R.T)[None]).directions[0, ROW["l-toes-joint"]]
        np.testing.assert_allclose(toes, R @ Z if abs(angle) > np.pi / 4 else Z, atol=1e-9)


def test_missing_beads_mask_their_bones_and_nothing_else():
    points = np.stack([beads_of(pose(arm_L=(Y, X)))] * 17)
    seen = np.ones((17, 16), bool)
    for k in range(16):
        seen[k, k] = False
        points[k, k] = np.nan if k % 2 else 1e300  # whatever stands there is not looked at
    seen[16] = False
    s = batch(repaired, points, seen)
    assert np.isfinite(s.rotvec).all() and np.isfinite(s.root).all() and np.isfinite(s.directions).all()
    lost = {
        "arm.L1": {"l-elbow-joint"},
        "arm.L2": {"l-elbow-joint", "l-hand-joint", "l-finger-joint"},
        "leg.R3": {"r-foot-joint", "r-toes-joint"},
        "torso.1": {"upper-back-joint", "l-shoulder-joint", "r-shoulder-joint"},
        "head.2": {"head-joint"},
    }
    for bead, bones in lost.items():
        found = {name for name, good in zip(BONE_NAMES, s.valid[BEADS.index(bead)]) if not good}
        assert found == bones, bead
    pelvis = {"lower-back-joint", "l-hip-joint", "r-hip-joint"}
    assert {name for name, good in zip(BONE_NAMES, s.valid[16]) if good} == pelvis
    np.testing.assert_allclose(s.rotvec[16], 0.0, atol=0)


def test_derivatives_are_finite_in_hard_poses_and_with_missing_beads():
    hard = np.stack([beads_of(p) for p in POSES.values()])
    seen = np.ones((len(hard), 16), bool)
    seen[::3, 5] = False

    def derivative(points, seen):
        return jax.jacrev(lambda p: repaired(p, seen).directions)(points)

    assert np.isfinite(over(derivative, hard, seen)).all()


def test_wrong_sizes_are_refused():
    with pytest.raises(InputError, match="lengths"):
        skeleton_from_markers(jnp.zeros((16, 3)), jnp.ones(16, bool), jnp.ones(20))
    assert tuple(MARKERS) == tuple(BEADS)
