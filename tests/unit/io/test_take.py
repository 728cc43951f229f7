"""What every exporter refuses, converts and bridges; tried on all of them."""

import math

import numpy as np
import pytest
from motion_samples import arm, positions, tumbling

from jaxmocap._errors import InputError
from jaxmocap.io import bvh_text, collada_text, glb_bytes
from jaxmocap.io.take import continuous_quaternions, prepare_take

EXPORTERS = (bvh_text, collada_text, glb_bytes)
NAN = math.nan


def with_gap(start: int, stop: int, joint: int = 1, frames: int = 8):
    motion = tumbling(3, frames=frames, joints=3)
    motion.rotvec[start:stop, joint, 1] = NAN
    return motion


WRONG = {
    "no joint": (
        lambda: arm(names=(), parents=(), offsets=np.zeros((0, 3)), rotvec=np.zeros((3, 0, 3))),
        "at least one joint",
    ),
    "two roots": (lambda: arm(parents=(-1, 0, -1)), "one root, got 2"),
    "circle": (lambda: arm(parents=(-1, 2, 1)), "cycle"),
    "no root": (lambda: arm(parents=(2, 0, 1)), "cycle"),
    "unknown parent": (lambda: arm(parents=(-1, 0, 7)), "'hand' has parent 7"),
    "too few parents": (lambda: arm(parents=(-1, 0)), "parents: expected one per joint"),
    "double name": (lambda: arm(names=("a", "b", "b")), "'b' is there twice"),
    "empty name": (lambda: arm(names=("a", " ", "c")), "expected a name for every joint"),
    "control character": (lambda: arm(names=("a", "b\x00", "c")), "no file can store"),
    "half a surrogate": (lambda: arm(names=("a", "b\udc80", "c")), "no file can store"),
    "no frame": (lambda: arm(rotvec=np.zeros((0, 3, 3)), root=np.zeros((0, 3))), "at least one frame"),
    "offset missing": (lambda: arm(offsets=np.array([[0, 0, 0], [0, NAN, 0], [0, 2, 0]])), "offsets: 1 of 9"),
    "infinite": (lambda: arm(root=np.array([[0, 0, 0], [math.inf, 0, 0], [2, 0, 0]])), "infinity"),
    "fps 0": (lambda: arm(fps=0.0), "fps: expected a positive number, got 0.0"),
    "fps NaN": (lambda: arm(fps=NAN), "fps"),
    "unit unknown": (lambda: arm(unit="yards"), "expected a unit out of"),
    "gap": (lambda: with_gap(2, 4), "'joint1' is missing in frames 2 to 3; gaps=0 allows no"),
    "gap at the start": (lambda: with_gap(0, 1), "frame 0, at the start"),
    "gap at the end": (lambda: with_gap(6, 8), "frames 6 to 7, at the end"),
    "joint never seen": (lambda: with_gap(0, 8), "'joint1' is missing in every frame"),
    "root missing": (lambda: arm(root=np.array([[0, 0, 0], [NAN, 0, 0], [2, 0, 0]])), "root is missing in frame 1"),
}


@pytest.mark.parametrize("export", EXPORTERS)
@pytest.mark.parametrize("case", WRONG)
def test_a_motion_that_no_file_can_hold_is_refused_by_name(export, case):
    make, sentence = WRONG[case]
    with pytest.raises(InputError, match=sentence):
        export(make())


@pytest.mark.parametrize("export", EXPORTERS)
@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"fps": 0.0}, "fps"),
        ({"fps": NAN}, "fps"),
        ({"up": "w"}, "up: expected one of y"),
        ({"gaps": -1}, "gaps"),
        ({"gaps": True}, "gaps"),
        ({"unit": "yards"}, "unit"),
    ],
)
def test_wrong_options_are_refused(export, options, sentence):
    with pytest.raises(InputError, match=sentence):
        export(arm(), **options)


def test_a_chain_too_deep_for_readers_is_refused():
    n = 201
    motion = arm(
        names=tuple(f"j{j}" for j in range(n)),
        parents=tuple(range(-1, n - 1)),
        offsets=np.zeros((n, 3)),
        rotvec=np.zeros((1, n, 3)),
        root=np.zeros((1, 3)),
    )
    for export in EXPORTERS:
        with pytest.raises(InputError, match="more than 200 levels"):
            export(motion)


def test_a_unit_is_not_made_up():
    with pytest.raises(InputError, match="without a physical unit"):
        collada_text(arm(unit="1"), unit="mm")
    assert "without a physical unit" in collada_text(arm(unit="1"))[1]
    assert "one unit counts as one metre" in glb_bytes(arm(unit="1"))[1]
    with pytest.raises(InputError, match="glTF files are in metres"):
        glb_bytes(arm(), unit="mm")


def test_a_short_gap_is_bridged_and_counted():
    # A turn at constant speed about one axis, and a root on a straight line, come back exactly.
    motion = tumbling(1, frames=6, joints=2)
    motion.rotvec[:, 1] = np.arange(6)[:, None] * np.array([0.1, 0.2, 0.05])
    motion.root[:] = np.arange(6)[:, None] * np.array([1.0, 2, 3])
    whole = positions(motion)
    motion.rotvec[2:4, 1] = NAN
    motion.root[3] = NAN
    take = prepare_take(motion, unit=None, up="y", fps=None, gaps=2)
    assert take.bridged == 3 and "3 missing values interpolated" in take.sentence()
    np.testing.assert_allclose(take.motion.world()[1], whole, atol=1e-12)
    with pytest.raises(InputError, match="gaps=1 allows 1 missing frames"):
        prepare_take(motion, unit=None, up="y", fps=None, gaps=1)


def test_a_gap_takes_the_short_way_across_half_a_turn():
    rotvec = np.zeros((3, 3, 3))
    rotvec[:, 0, 2] = [3.0, NAN, -3.0]  # 344 degrees one way, 16 the other
    motion = arm(rotvec=rotvec)
    take = prepare_take(motion, unit=None, up="y", fps=None, gaps=1)
    np.testing.assert_allclose(np.abs(take.quaternions[1, 0]), [0, 0, 1, 0], atol=1e-12)


@pytest.mark.parametrize("axis", ["y", "-y", "z", "-z", "x", "-x"])
def test_the_axis_that_points_up_becomes_y_and_nothing_is_mirrored(axis):
    motion = tumbling(5)
    upright = prepare_take(motion, unit=None, up=axis, fps=None, gaps=0).motion.world()[1]
    p = positions(motion)
    height = p[..., "xyz".index(axis[-1])] * (-1 if axis[0] == "-" else 1)
    np.testing.assert_allclose(upright[..., 1], height, atol=1e-9)
    a, b = p.reshape(-1, 3)[:3], upright.reshape(-1, 3)[:3]
    np.testing.assert_allclose(np.linalg.det(b), np.linalg.det(a), rtol=1e-9)
    np.testing.assert_allclose(b @ b.T, a @ a.T, atol=1e-8)


def test_units_and_times():
    take = prepare_take(arm(), unit="m", up="y", fps=29.97, gaps=0)
    np.testing.assert_allclose(take.motion.offsets[:, 1], [0, 0.03, 0.02], rtol=1e-15)
    np.testing.assert_allclose(take.times, [0, 1 / 29.97, 2 / 29.97], rtol=1e-15)
    assert "3 joints, 3 frames at 29.97 frames per second, lengths in m, y up." == take.sentence()


def test_quaternions_keep_their_side():
    half = np.linspace(0, 4 * math.pi, 50) / 2
    q = np.stack([np.zeros(50), np.zeros(50), np.sin(half), np.cos(half)], axis=1)
    jumping = q * np.where(np.arange(50) % 3 == 0, -1, 1)[:, None]
    np.testing.assert_allclose(continuous_quaternions(jumping), q, atol=1e-15)
