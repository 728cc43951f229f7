"""BVH as bvhio reads it back, and angles that do not jump."""

import math
import warnings
from pathlib import Path

import numpy as np
import pytest
from motion_samples import ARM_HANDS, arm, matrix, positions, still, tumbling

from jaxmocap.io import bvh_text, write_bvh
from jaxmocap.io.bvh import continuous_euler

with warnings.catch_warnings():
    warnings.simplefilter("ignore", PendingDeprecationWarning)  # bvhio imports PyGLM under its old name
    import bvhio

GOLDEN = Path(__file__).parent / "golden"
ORDERS = [(0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)]


def read_back(path: Path) -> tuple[dict[str, np.ndarray], bvhio.BvhContainer]:
    """Position of each joint at each frame, (frames, 3) by name."""
    container = bvhio.readAsBvh(str(path))
    root = bvhio.convertBvhToHierarchy(container.Root)
    found: dict[str, list] = {}
    for frame in range(container.FrameCount):
        root.loadPose(frame)
        for joint, _, _ in root.layout():
            found.setdefault(joint.Name, []).append(np.array(joint.PositionWorld))
    return {name: np.array(values) for name, values in found.items()}, container


@pytest.mark.parametrize("seed", range(3))
def test_bvhio_finds_the_joints_where_they_are(tmp_path, seed):
    motion = tumbling(seed, frames=20)
    write_bvh(tmp_path / "t.bvh", motion)
    found, container = read_back(tmp_path / "t.bvh")
    assert container.FrameTime == pytest.approx(1 / 29.97, rel=1e-12)
    expected = positions(motion)
    for joint, name in enumerate(motion.names):
        np.testing.assert_allclose(found[name], expected[:, joint], atol=2e-3)  # bvhio counts in 32 bits; mm


def test_a_single_pose_and_another_unit(tmp_path):
    write_bvh(tmp_path / "s.bvh", still(1), unit="mm")
    found, container = read_back(tmp_path / "s.bvh")
    assert container.FrameCount == 1
    np.testing.assert_allclose(found["hand"][0], 10 * ARM_HANDS[1], atol=1e-4)


def test_a_name_with_spaces_becomes_one_word_and_is_said(tmp_path):
    said = write_bvh(tmp_path / "n.bvh", still(names=("my root", "my_root", "End Site")))
    found, _ = read_back(tmp_path / "n.bvh")
    assert set(found) == {"my_root_2", "my_root", "End_Site"}
    assert "2 joint names changed ('my root' is called my_root_2)" in said


@pytest.mark.parametrize("order", ORDERS)
def test_angles_give_the_rotation_back_in_every_order(order):
    rng = np.random.default_rng(1)
    R = np.array([matrix(v) for v in rng.normal(size=(40, 3)) * 2])
    for angles, expected in zip(continuous_euler(R, order), R):
        axes = np.eye(3)
        made = np.linalg.multi_dot([matrix(angle * axes[axis]) for angle, axis in zip(angles, order)])
        np.testing.assert_allclose(made, expected, atol=1e-9)


@pytest.mark.parametrize("order", ORDERS)
def test_angles_of_many_turns_do_not_jump(order):
    # First and last axis turn on; the middle angle passes through a quarter turn, to the far side and back.
    t = np.linspace(0, 1, 400)
    true = np.stack([9 * t, 2.5 * np.sin(7 * t), -8 * t], axis=1)
    axes = np.eye(3)
    R = np.array([np.linalg.multi_dot([matrix(a * axes[x]) for a, x in zip(row, order)]) for row in true])
    np.testing.assert_allclose(continuous_euler(R, order), true, atol=1e-6)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("side", [1, -1])
def test_at_gimbal_lock_the_rotation_is_still_right(order, side):
    axes = np.eye(3)
    turns = [(a, side * math.pi / 2, c) for a, c in ((0.3, 0.2), (0.5, -1.0), (3.0, 3.0))]
    R = np.array([np.linalg.multi_dot([matrix(a * axes[x]) for a, x in zip(row, order)]) for row in turns])
    for angles, expected in zip(continuous_euler(R, order), R):
        made = np.linalg.multi_dot([matrix(a * axes[x]) for a, x in zip(angles, order)])
        np.testing.assert_allclose(made, expected, atol=1e-7)


def test_a_joint_that_reaches_gimbal_lock_gets_another_order():
    # ZXY locks at a quarter turn about x: there a small turn about another axis would fling the outer angles.
    rotvec = np.zeros((3, 3, 3))
    rotvec[:, 1, 0] = [0, math.pi / 2, 1.6]
    text, _ = bvh_text(arm(rotvec=rotvec))
    lines = [line.split() for line in text.splitlines() if "CHANNELS" in line]
    assert lines[0][-3:] == lines[2][-3:] == ["Zrotation", "Xrotation", "Yrotation"]
    assert lines[1][-2] != "Xrotation"


def test_nothing_but_finite_numbers_leaves():
    text, _ = bvh_text(tumbling(7, frames=50))
    motion = text.split("MOTION")[1].split("\n", 3)[3]
    assert np.isfinite(np.array(motion.split(), dtype=float)).all()


def test_the_bytes_are_those_kept(tmp_path):
    said = write_bvh(tmp_path / "arm.bvh", arm())
    assert "3 joints, 3 frames at 25 frames per second, lengths in cm, y up." in said
    assert (tmp_path / "arm.bvh").read_bytes() == (GOLDEN / "arm.bvh").read_bytes()
