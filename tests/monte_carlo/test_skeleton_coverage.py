"""Skeletons fitted to the pixels of 200 noisy copies of one pose: stated sigmas of joint angles hold."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from puppet_poses import beads_of, random_pose

from jaxmocap.bodies.bead_body import PARTS
from jaxmocap.cameras import BrownDistortion, Intrinsics, Turntable
from jaxmocap.observations import PixelObservations
from jaxmocap.reconstruction.pose_from_pixels import joint_angles
from jaxmocap.reconstruction.skeleton import BONE_NAMES, default_lengths
from jaxmocap.reconstruction.skeleton_fit import fit_skeleton_to_pixels
from jaxmocap.reconstruction.skeleton_problem import TablePhotos

pytestmark = pytest.mark.slow

REPEATS, SIGMA, FALSE_ALARM, PHOTOS = 200, 0.2, 1e-4, 6
FREE = ("upper-back-joint", "l-knee-joint", "r-knee-joint")  # parts that hang on the pelvis, which does not move


def table():
    number = lambda *values: [jnp.array(v) for v in values]  # noqa: E731
    lens = BrownDistortion(*number(-0.12, 0.03, 0.0, 0.0, 0.0))
    return TablePhotos(Turntable.nominal(), Intrinsics(*number(859.0, 860.2, 337.3, 288.2, 0.0)), lens)


def pixels(p):
    """Pixels of the beads by the document's formulas, eq. 4.8-4.18 with distortion, in numpy."""
    out = []
    for a in 2 * np.pi * np.arange(PHOTOS) / PHOTOS:
        c, s = np.cos(a), np.sin(a)
        x, y, z = c * p[:, 0] + s * p[:, 2], 80 - p[:, 1], 400 - (c * p[:, 2] - s * p[:, 0])
        m = np.stack([x / z, y / z], axis=1)
        r2 = np.sum(m**2, axis=1, keepdims=True)
        out.append(m * (1 - 0.12 * r2 + 0.03 * r2**2) * (859.0, 860.2) + (337.3, 288.2))
    return np.stack(out)


def truth(directions):
    """Angles between the bones, in the order of PARTS, in numpy."""
    at = {"head-joint": (directions["back"], directions["head"]), "upper-back-joint": ((0, 1, 0), directions["back"])}
    out = {"l": directions["L"], "r": directions["R"]}
    found = []
    for part in PARTS:
        if part in at:
            u, v = at[part]
        else:
            arm, leg = out[part[0]]["arm"], out[part[0]]["leg"]
            rest = {"l": 1.0, "r": -1.0}[part[0]]
            R = torso(directions["back"])
            u, v = {
                "elbow": (rest * R[:, 0], arm[0]), "hand": arm, "knee": ((0, -1, 0), leg[0]), "foot": leg,
            }[part[2:].split("-")[0]]  # fmt: skip
        found.append(np.arctan2(np.linalg.norm(np.cross(u, v)), np.dot(u, v)))
    return np.array(found)


def torso(back):
    left = np.cross(back, (0, 0, 1))  # eq. 6.5
    left = left / np.linalg.norm(left)
    return np.stack([left, back, np.cross(left, back)], axis=1)


@pytest.fixture(scope="module")
def world():
    return random_pose(np.random.default_rng(8), 0.7)


@pytest.fixture(scope="module")
def repeats(world):
    points = beads_of(world)
    uv, photos, angles = jnp.array(pixels(points)), table(), 2 * jnp.pi * jnp.arange(float(PHOTOS))[None] / PHOTOS

    def one(key):
        seen = PixelObservations.of((uv + SIGMA * jax.random.normal(key, uv.shape))[None], sigma=SIGMA)
        fit = fit_skeleton_to_pixels(
            seen, photos, jnp.array(points)[None], jnp.ones((1, 16), bool), default_lengths(), angles=angles
        )
        joints = joint_angles(fit)
        return {
            "bends": joints.bends[0],
            "sigma": joints.sigma_bends[0],
            "turns": joints.sigma_turns[0],
            "directions": fit.poses().directions[0],
            "variance": fit.estimate.stats["residual_variance"],
            "steps": fit.estimate.stats["steps"],
            "freedom": fit.estimate.stats["degrees_of_freedom"],
            "code": fit.estimate.result._value,
        }

    batch = jax.jit(jax.vmap(one))
    keys = jax.random.split(jax.random.key(0), REPEATS).reshape(2, -1)
    parts = [jax.tree.map(np.asarray, batch(k)) for k in keys]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def test_every_repeat_converges(repeats):
    assert np.all(repeats["code"] == 0) and np.all(repeats["steps"] < 15)
    # 6 photos of 16 beads; 6 limbs placed by 3 numbers, 10 directions of 2, 10 distances between beads.
    assert np.all(repeats["freedom"] == 2 * 6 * 16 - 18 - 20 - 10)


def test_residual_variance_is_one(repeats):
    low, high = scipy.stats.chi2.ppf([FALSE_ALARM / 2, 1 - FALSE_ALARM / 2], 144 * REPEATS)
    assert low < repeats["variance"].sum() * 144 < high


def test_bends_hold_their_sigmas(repeats, world):
    """Angles of limbs that hang on bones with beads; upper arms hang on shoulders, whose print is a convention."""
    rows = [i for i, part in enumerate(PARTS) if "elbow" not in part]
    z = ((repeats["bends"] - truth(world)) / repeats["sigma"])[:, rows]
    low, high = scipy.stats.chi2.ppf([FALSE_ALARM / 20, 1 - FALSE_ALARM / 20], REPEATS - 1) / (REPEATS - 1)
    assert np.all((z.var(axis=0, ddof=1) > low) & (z.var(axis=0, ddof=1) < high)), z.var(axis=0, ddof=1)
    # A bend is the length of a vector with noise: its bias is of second order, far below its sigma here.
    assert np.all(np.abs(z.mean(axis=0)) < 4.5 / np.sqrt(REPEATS))
    held = (np.abs(z) < 1.96).sum()
    assert scipy.stats.binom.ppf(FALSE_ALARM, z.size, 0.95) <= held


def test_turns_hold_their_sigmas(repeats, world):
    """Truth in the frame of the estimated part: what stands beside the bone is the error of its turn."""
    wanted = {
        "upper-back-joint": world["back"],
        "l-knee-joint": world["L"]["leg"][0],
        "r-knee-joint": world["R"]["leg"][0],
    }
    for part in FREE:
        found = repeats["directions"][:, BONE_NAMES.index(part)]
        sigma = repeats["turns"][:, PARTS.index(part)]
        assert np.all(np.isinf(sigma[:, 1]))  # twist about the bone: nothing sees it
        error = np.linalg.norm(found - wanted[part], axis=1) ** 2
        ratio = error.mean() / (sigma[:, [0, 2]] ** 2).sum(axis=1).mean()
        low, high = scipy.stats.chi2.ppf([FALSE_ALARM / 6, 1 - FALSE_ALARM / 6], REPEATS) / REPEATS
        assert low < ratio < high, part


def test_bones_are_right_to_a_degree(repeats, world):
    for side in "LR":
        for limb, names in {"arm": ("elbow", "hand"), "leg": ("knee", "foot")}.items():
            for v, name in zip(world[side][limb], names):
                found = repeats["directions"][:, BONE_NAMES.index(f"{side.lower()}-{name}-joint")]
                assert np.degrees(np.arccos(np.min(found @ v))) < 1.0
