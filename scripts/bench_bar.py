"""The bar problem against Ceres: 18 shared unknowns, six per block, nine residuals per block.

    python scripts/bench_bar.py [--blocks 250 2500 25000] [--repeats 7] [--json ROWS]

Both solve the same problem from the same start, in turns, on the same two cores. Ceres (peers/ceres_bar.cpp, built
here with -O3 -march=native) logs every accepted cost with its time; its time is that at which its cost is within
1e-9 of the best cost that either of them finds. Ours is the whole call, from arrays to Estimate.
"""

from __future__ import annotations

import resource
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from peers.rows import THREADS, Row, alternate, arguments, report, timed, use_cores

use_cores()

import jax  # noqa: E402
import numpy as np  # noqa: E402

from jaxmocap.optim import least_squares  # noqa: E402
from jaxmocap.results import Estimate  # noqa: E402
from jaxmocap.synthetic.bar import BAR_PROBLEM, BarWorld, make_bar  # noqa: E402

WITHIN = 1e-9
SOURCE = Path(__file__).parent / "peers" / "ceres_bar.cpp"


def build_ceres(folder: Path) -> Path | None:
    """The peer's program, or None (with a sentence) if it cannot be built here."""
    if shutil.which("g++") is None:
        print("Ceres: not measured (no g++)")
        return None
    program = folder / "ceres_bar"
    flags = ["-std=c++17", "-O3", "-march=native", "-DNDEBUG", "-I/usr/include/eigen3"]
    command = ["g++", *flags, str(SOURCE), "-o", str(program), "-lceres", "-lglog"]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        first = done.stderr.strip().splitlines()[:1]
        print(f"Ceres: not measured (does not compile: {' '.join(first)})")
        return None
    return program


def write_problem(world: BarWorld, path: Path) -> None:
    """The problem as doubles, in the order that ceres_bar.cpp states."""
    c, s = world.common, world.start.shared
    head = [world.images.first.shape[0], c.length, c.sigma_px, c.sigma_length]
    for camera in (s.first, s.second):
        head += [camera.fx, camera.fy, camera.cx, camera.cy, camera.k1, camera.k2]
    head += [*s.T_second_first.rotvec, *s.T_second_first.translation]
    pixels = np.stack([np.asarray(world.images.first), np.asarray(world.images.second)], axis=2)
    local = [np.asarray(world.start.local.a), np.asarray(world.start.local.b), pixels.reshape(len(pixels), 8)]
    np.concatenate([np.array(head, float), np.concatenate(local, axis=1).ravel()]).tofile(path)


def run_ceres(program: Path, problem: Path) -> tuple[list[tuple[float, float]], float]:
    """(seconds, cost) of every accepted point, and the cost at the end."""
    done = subprocess.run([program, problem, str(THREADS)], capture_output=True, text=True, check=True)
    words = [line.split() for line in done.stdout.splitlines()]
    path = [(float(seconds), float(cost)) for what, seconds, cost in words if what == "iteration"]
    return path, float(words[-1][2])


def time_to(path: list[tuple[float, float]], best: float) -> float:
    """When the cost came within 1e-9 of the best; infinity if it never did."""
    return next((seconds for seconds, cost in path if cost <= best * (1.0 + WITHIN)), float("inf"))


def solve(world: BarWorld, covariance: bool = False) -> Estimate:
    """Our whole call, waited for."""
    return jax.block_until_ready(
        least_squares(BAR_PROBLEM, world.start, world.images, world.common, covariance=covariance)
    )


def compare(blocks: int, program: Path | None, folder: Path, repeats: int) -> list[Row]:
    """Rows of one size."""
    world = make_bar(blocks)
    cold, estimate = timed(lambda: solve(world))
    ours = float(estimate.stats["cost"])
    best, runs = ours, [lambda: timed(lambda: solve(world))[0]]
    if program is not None:
        problem = folder / f"bar{blocks}"
        write_problem(world, problem)
        best = min(best, run_ceres(program, problem)[1])
        runs.append(lambda: time_to(run_ceres(program, problem)[0], best))
    if ours > best * (1.0 + WITHIN):
        sys.exit(f"{blocks} blocks: our cost {ours!r} is above the optimum {best!r}")
    medians = alternate(runs, repeats)
    note = f"to {WITHIN:g} of cost {best:.9g}; {int(estimate.stats['steps'])} steps; first call {cold:.1f} s"
    return [Row(f"bar, {blocks} blocks", medians[0], "Ceres", medians[1] if program else None, note=note)]


def with_covariance(blocks: int, repeats: int) -> Row:
    """The same call when the covariance is wanted."""
    world = make_bar(blocks)
    solve(world, True)
    median = alternate([lambda: timed(lambda: solve(world, True))[0]], min(repeats, 3))[0]
    return Row(f"bar, {blocks} blocks, with covariance", median)


def own_peak() -> float:
    """Peak resident size of this process [MB]; Linux' ru_maxrss would be the parent's if that was larger."""
    status = Path("/proc/self/status")
    lines = status.read_text().splitlines() if status.exists() else []
    peaks = [float(line.split()[1]) for line in lines if line.startswith("VmHWM")]
    return (peaks[0] if peaks else float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)) / 1024


def peak_memory(blocks: int) -> Row:
    """Largest resident size of a fresh process that solves once, in MB."""
    done = subprocess.run(
        [sys.executable, __file__, "--memory-of", str(blocks)], capture_output=True, text=True, check=True
    )
    return Row(f"bar, {blocks} blocks, peak memory", float(done.stdout.split()[-1]), unit="MB", note="whole process")


def main() -> None:
    """Measure and report."""
    parser = arguments(__doc__)
    parser.add_argument("--blocks", type=int, nargs="+", default=[250, 2500, 25000])
    parser.add_argument("--memory-of", type=int, help="solve once and print the process' peak memory [MB]")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    if options.memory_of:
        solve(make_bar(options.memory_of))
        print(own_peak())
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        program = build_ceres(folder)
        rows = [row for n in options.blocks for row in compare(n, program, folder, options.repeats)]
    largest, before = rows[-1].value, rows[-2].value if len(rows) > 1 else float("nan")
    if len(rows) > 1:
        growth = options.blocks[-1] / options.blocks[-2]
        rows.append(Row(f"bar, time for {growth:g} x the blocks", largest / before, unit="x"))
    rows += [with_covariance(options.blocks[-1], options.repeats), peak_memory(options.blocks[-1])]
    report(rows, options.json)


if __name__ == "__main__":
    main()
