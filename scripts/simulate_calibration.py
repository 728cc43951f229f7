"""Do the standard deviations that a calibration states hold? Simulate, calibrate again and again, and count.

    python scripts/simulate_calibration.py --repeats 4000 --seed 0
    python scripts/simulate_calibration.py --repeats 4000 --seed 0 --correlated

A perfect world (jaxmocap.synthetic.chessboards) gets new noise in every repeat and is calibrated by the package.
For each parameter: how often the interval estimate +- 1.96 sigma holds the truth (95 % if sigma is right), once
with the PLAIN sigma, which takes all corners for independent, and once with the STATED one, which is what every
report prints (see jaxmocap.optim.covariance); and the spread of the estimates over the Cramer-Rao bound, from a
dense Jacobian at the truth. With --correlated the corners of a picture also share an error (a shift and an affine
distortion of 0.1 px each): there plain sigmas must fail, and the question is whether the stated ones hold.
"""

from __future__ import annotations

import argparse
import time
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from jaxmocap.calibration.boards import (
    TargetViews,
    free_parameters,
    parameter_names,
    refine_targets,
    residual_pixels,
)
from jaxmocap.optim import ArrowVariables
from jaxmocap.synthetic.chessboards import (
    ChessboardWorld,
    add_noise,
    add_view_noise,
    chessboard_world,
    lens_of_numbers,
)

SIGMA = 0.3  # px
SHIFT = AFFINE = 0.1  # px, only with --correlated
BATCH = 50
MODEL = "k1k2"


def worlds(views: int, seed: int) -> dict[str, ChessboardWorld]:
    """Two cameras: a webcam with a strong lens, and a long lens with larger pictures."""
    webcam = lens_of_numbers(800.0, 800.0, 319.5, 239.5, (-0.25, 0.08))
    tele = lens_of_numbers(2400.0, 2390.0, 660.0, 340.0, (-0.10, 0.15))
    return {
        f"f = 800 px, 640x480, k1 = -0.25, {views} views": chessboard_world(
            views, [webcam], [(640, 480)], fill=(0.35, 0.8), seed=seed
        ),
        f"f = 2400 px, 1280x720, k1 = -0.10, {views} views": chessboard_world(
            views, [tele], [(1280, 720)], fill=(0.2, 0.5), tilt=0.9, seed=seed + 1
        ),
    }


@partial(jax.jit, static_argnames=("repeats",))
def _batch(
    truth: ArrowVariables, views: TargetViews, shift: jax.Array, affine: jax.Array, key: jax.Array, repeats: int
):
    """Estimates, plain sigmas, leave-one-out sigmas and design effects of some repeats."""
    free = free_parameters(1, MODEL, False)

    def one(key: jax.Array):
        own, common = jax.random.split(key)
        noisy = add_view_noise(add_noise(views, SIGMA, own), shift, affine, common)
        estimate = refine_targets(truth, noisy, free)
        lens = estimate.value.shared.lenses[0]
        K, d = lens.intrinsics, lens.distortion
        found = jnp.stack([K.fx, K.fy, K.cx, K.cy, d.k1, d.k2])
        cov = estimate.covariance
        plain = jnp.sqrt(jnp.diagonal(cov.shared_plain()))
        stated = jnp.sqrt(jnp.diagonal(cov.shared()))
        return {
            "found": found,
            "plain": plain,
            "stated": stated,
            "left_out": jnp.sqrt(jnp.diagonal(cov.leave_one_out)),
            "effect": cov.design_effect,
            "settled": estimate.result._value,
        }

    return jax.vmap(one)(jax.random.split(key, repeats))


def simulate(world: ChessboardWorld, repeats: int, seed: int, correlated: bool = False) -> dict[str, np.ndarray]:
    """Everything about every repeat, and the truth.

    Args:
        world: one camera.
        repeats: how many.
        seed: of the noise.
        correlated: whether the corners of a picture share an error.

    Returns:
        Arrays with a leading axis of repeats, "truth" and "bound" (Cramer-Rao sigma of each parameter).
    """
    shift, affine = (jnp.asarray(x if correlated else 0.0) for x in (SHIFT, AFFINE))
    parts = []
    for k, start in enumerate(range(0, repeats, BATCH)):
        key = jax.random.fold_in(jax.random.key(seed), k)
        part = jax.tree.map(np.asarray, _batch(world.truth, world.views, shift, affine, key, BATCH))
        parts.append({name: x[: repeats - start] for name, x in part.items()})
    out = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    lens = world.truth.shared.lenses[0]
    K, d = lens.intrinsics, lens.distortion
    out["truth"] = np.array([float(x) for x in (K.fx, K.fy, K.cx, K.cy, d.k1, d.k2)])
    out["bound"] = SIGMA * cramer_rao(world)
    return out


def cramer_rao(world: ChessboardWorld) -> np.ndarray:
    """Smallest possible sigma of each shared parameter per pixel of noise, by dense algebra at the truth."""
    free = jax.tree.leaves(free_parameters(1, MODEL, False).shared)
    leaves, tree = jax.tree.flatten(world.truth.shared)
    picked = [k for k, flag in enumerate(free) if flag]
    z0 = jnp.stack([leaves[k] for k in picked])
    pose0, pose_tree = jax.tree.flatten(world.truth.local)

    def residual(z: jax.Array, poses: list[jax.Array], views: TargetViews) -> jax.Array:
        new = list(leaves)
        for k, value in zip(picked, z):
            new[k] = value
        value = ArrowVariables(jax.tree.unflatten(tree, new), jax.tree.unflatten(pose_tree, poses))
        return residual_pixels(value, views).reshape(-1)

    J = [np.asarray(jax.jit(jax.jacfwd(residual))(z0, pose0, world.views))]
    by_pose = jax.jit(jax.jacfwd(residual, argnums=1))(z0, pose0, world.views)
    J += [np.asarray(x).reshape(len(J[0]), -1) for x in by_pose]
    R = np.linalg.qr(np.concatenate(J[1:] + J[:1], axis=1), mode="r")  # shared last: its block is the reduced one
    inverse = np.linalg.inv(R[-len(picked) :, -len(picked) :])
    return np.sqrt(np.sum(inverse**2, axis=1))


def print_table(title: str, out: dict[str, np.ndarray], names: list[str]) -> None:
    """Markdown table of one world."""
    error = np.abs(out["found"] - out["truth"])
    spread = out["found"].std(axis=0, ddof=1) / out["bound"]
    covered = {kind: 100 * (error < 1.96 * out[kind]).mean(axis=0) for kind in ("plain", "stated")}
    print(f"\n{title}, {len(error)} repeats, {int((out['settled'] != 0).sum())} failed\n")
    print("| parameter | covered, plain % | covered, stated % | spread / Cramer-Rao bound |")
    print("|---|---|---|---|")
    for k, name in enumerate(names):
        print(f"| {name} | {covered['plain'][k]:.1f} | {covered['stated'][k]:.1f} | {spread[k]:.3f} |")
    pooled = {kind: value.mean() for kind, value in covered.items()}
    print(f"| all | {pooled['plain']:.1f} | {pooled['stated']:.1f} | {np.sqrt(np.mean(spread**2)):.3f} |")
    effect = out["effect"]
    print(f"\nDesign effect: median {np.median(effect):.2f}, 5-95 % {np.quantile(effect, 0.05):.2f} to "
          f"{np.quantile(effect, 0.95):.2f}.")  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=4000)
    parser.add_argument("--views", type=int, default=15)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--correlated", action="store_true", help="corners of one picture share an error")
    parser.add_argument("--save", help="also write every repeat to FOLDER_OR_PREFIX<n>.npz")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    names = [name for _, name in parameter_names(free_parameters(1, MODEL, False))]
    for k, (title, world) in enumerate(worlds(options.views, options.seed).items()):
        begin = time.perf_counter()
        out = simulate(world, options.repeats, options.seed, options.correlated)
        print_table(title + (", correlated within pictures" if options.correlated else ""), out, names)
        print(f"{time.perf_counter() - begin:.0f} s")
        if options.save:
            np.savez(f"{options.save}{k}.npz", **out)


if __name__ == "__main__":
    main()
