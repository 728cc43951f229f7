"""Skeletons of the rendered puppet's three poses, from its true bead centres with the noise of their pixels."""

import json

import jax.numpy as jnp
import numpy as np
import pytest
from samplers import over

from jaxmocap.bodies.puppet import MARKERS, PARENTS
from jaxmocap.reconstruction.skeleton import BONE_NAMES, default_lengths, skeleton_from_markers

pytestmark = pytest.mark.real

# The pelvis is not printed in the document: which way its bones point is every author's own choice.
PELVIS = ("lower-back-joint", "l-hip-joint", "r-hip-joint")


def literal(points):
    return skeleton_from_markers(points, jnp.ones(16, bool), default_lengths(), literal=True)


def repaired(points):
    return skeleton_from_markers(points, jnp.ones(16, bool), default_lengths())


@pytest.fixture(scope="module")
def poses(data_dir):
    truth = json.loads((data_dir / "rendered_puppet" / "ground_truth.json").read_text())
    assert truth["bone_parent"] == dict(PARENTS)
    beads = np.array([[p["beads_world"][m] for m in MARKERS] for p in truth["poses"].values()])
    names = [n for n in BONE_NAMES if n not in PELVIS]
    return names, beads, np.array([[p["bones"][n]["direction"] for n in names] for p in truth["poses"].values()])


@pytest.mark.parametrize("convention", [literal, repaired])
def test_bone_directions(poses, convention):
    names, beads, directions = poses
    rows = [BONE_NAMES.index(n) for n in names]
    angle = lambda found: np.degrees(np.arccos(np.clip(np.sum(found[:, rows] * directions, axis=2), -1, 1)))  # noqa: E731
    exact = over(convention, beads)
    assert exact.valid.all() and np.max(angle(exact.directions)) < 0.02  # the truth is printed to 1e-5 mm
    # 0.1 px is 0.05 mm at 400 mm; twelve views leave less.
    noisy = over(convention, beads + 0.05 * np.random.default_rng(0).normal(size=beads.shape))
    assert np.max(angle(noisy.directions)) < 1.0
