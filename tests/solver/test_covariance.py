"""Shared, local and cross covariance, and leaving out one block, against dense algebra."""

import numpy as np
import pytest
from arrow_problems import solved

NAMES = ("prior", "masked and weighted", "frozen parts", "14 local", "pinhole")


def _kept(name):
    """Estimate, dense form, and the dense problem without the columns and rows of blocks that do not count."""
    case, reference, estimate, _, r, J = solved(name)
    return case, reference, estimate, r, J, np.any(J != 0, axis=0)


def _freedom(case, r, J, kept):
    seen = np.any(J[:, kept] != 0, axis=1)  # masked rows have no derivative
    return int(seen.sum()) - int(kept.sum())


@pytest.mark.parametrize("name", NAMES)
def test_plain_covariance_is_dense(name):
    case, reference, estimate, r, J, kept = _kept(name)
    freedom = _freedom(case, r, J, kept)
    assert float(estimate.stats["degrees_of_freedom"]) == freedom
    variance = r @ r / freedom
    np.testing.assert_allclose(float(estimate.covariance.variance), variance, rtol=1e-10)
    full = np.zeros((J.shape[1], J.shape[1]))
    full[np.ix_(kept, kept)] = variance * np.linalg.inv(J[:, kept].T @ J[:, kept])
    ns = reference.ns
    covariance = estimate.covariance
    np.testing.assert_allclose(covariance.shared_plain(), full[:ns, :ns], rtol=1e-7, atol=1e-9 * full[:ns, :ns].max())
    # Local and cross parts are stated ones; one number lies between plain and stated.
    inflation = float(covariance.shared()[0, 0] / covariance.shared_plain()[0, 0])
    for i in range(reference.blocks):
        own = reference.block_columns(i)
        if not kept[own].all():
            continue
        block, cross = inflation * full[own, own], inflation * full[own, :ns]
        np.testing.assert_allclose(covariance.local(i), block, rtol=1e-7, atol=1e-9 * np.abs(block).max())
        np.testing.assert_allclose(covariance.cross(i), cross, rtol=1e-7, atol=1e-9 * np.abs(cross).max())


def _jackknife(reference, r, J, blocks):
    """Covariance of the shared part from Gauss-Newton steps with each block's rows and columns deleted."""
    rows, ns = reference.rows, reference.ns
    moves = []
    for i in blocks:
        keep_rows = np.ones(len(r), bool)
        keep_rows[i * rows : (i + 1) * rows] = False
        columns = np.any(J[keep_rows] != 0, axis=0)
        columns[reference.block_columns(i)] = False
        step = np.linalg.lstsq(J[np.ix_(keep_rows, columns)], -r[keep_rows], rcond=None)[0]
        moves.append(step[:ns])
    moves = np.array(moves)
    n = len(blocks)
    return (n - 1) / n * (moves - moves.mean(axis=0)).T @ (moves - moves.mean(axis=0))


@pytest.mark.parametrize("name", NAMES)
def test_leaving_out_blocks_is_the_dense_jackknife(name):
    case, reference, estimate, r, J, kept = _kept(name)
    blocks = [i for i in range(reference.blocks) if kept[reference.block_columns(i)].all()]
    expected = _jackknife(reference, r, J, blocks)
    found = np.asarray(estimate.covariance.leave_one_out)
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.abs((found - expected) / size).max() < 1e-5


@pytest.mark.parametrize("name", NAMES)
def test_design_effect_is_the_unbiased_one(name):
    """Bell and McCaffrey's CR2 from whole hat matrices of residuals, which the package never forms."""
    case, reference, estimate, r, J, kept = _kept(name)
    ns, rows = reference.ns, reference.rows
    variance = r @ r / _freedom(case, r, J, kept)
    X = J[:, kept]
    bread = np.linalg.inv(X.T @ X)
    hat = X @ bread @ X.T
    middle, expected = np.zeros((ns, ns)), []
    for i in range(reference.blocks):
        if not kept[reference.block_columns(i)].all():
            continue
        own = slice(i * rows, (i + 1) * rows)
        # (I - H_ii) is singular along what the block's own unknowns absorb: its root on the rest.
        values, vectors = np.linalg.eigh(np.eye(rows) - hat[own, own])
        root = (vectors * np.where(values > 1e-9, 1 / np.sqrt(np.maximum(values, 1e-300)), 0)) @ vectors.T
        move = (bread @ X[own].T @ root @ r[own])[:ns]
        middle += np.outer(move, move)
        expected.append(i)
    plain = bread[:ns, :ns]
    effect = np.trace(np.linalg.solve(plain, middle)) / (ns * variance)
    np.testing.assert_allclose(float(estimate.covariance.design_effect), effect, rtol=1e-6)
    # Its spread by chance, from normal residuals with the model's columns projected out, block by block.
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(len(r), 4000)) * np.any(X != 0, axis=1)[:, None]
    noise -= hat @ noise
    total = np.zeros(4000)
    for i in expected:
        own = slice(i * rows, (i + 1) * rows)
        values, vectors = np.linalg.eigh(np.eye(rows) - hat[own, own])
        root = (vectors * np.where(values > 1e-9, 1 / np.sqrt(np.maximum(values, 1e-300)), 0)) @ vectors.T
        move = (bread @ X[own].T @ root @ noise[own])[:ns]
        total += np.sum(move * np.linalg.solve(plain, move), axis=0) / ns
    if case.problem.prior is None:
        assert abs(total.mean() - 1.0) < 5 * total.std() / np.sqrt(4000)
    # The formula takes blocks as independent of each other; they are tied by the shared unknowns.
    assert 0.6 < float(estimate.covariance.chance) / total.std() < 1.6
