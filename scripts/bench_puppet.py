"""What an animator waits for: twelve photographs identified and reconstructed, and the demo on a fresh machine.

    python scripts/bench_puppet.py [--repeats 5] [--runs 1] [--json ROWS]

Twelve bundled photographs of 704x576 px. Warm: the second and later calls in one process, photographs read from disk.
The demo is a process of its own, with an empty folder of compiled programs (cold) and with the one it has filled.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from bench_first_call import seconds_of
from peers.rows import Row, alternate, arguments, report, timed, use_cores

use_cores()

import jax  # noqa: E402

from jaxmocap.workflows import stopmotion  # noqa: E402
from jaxmocap.workflows.demo import run_demo  # noqa: E402


def steps(folder: Path, repeats: int) -> list[Row]:
    """Identification and reconstruction of one pose, in one process."""
    folder.mkdir()
    first, _ = timed(lambda: list(run_demo(folder, "bench", lambda _: None)))
    pose = folder / "wave"

    def both() -> float:
        (pose / "identified.json").unlink(missing_ok=True)
        return timed(lambda: stopmotion.reconstruct(pose))[0]

    both()
    named, whole = alternate([lambda: timed(lambda: stopmotion.identify(pose))[0], both], repeats)
    return [
        Row("puppet, 12 photographs identified, warm", named),
        Row("puppet, 12 photographs identified and reconstructed, warm", whole, note="to be < 3 s"),
        Row("the whole demo in one process, first time", first),
    ]


def demo(folder: Path, runs: int) -> list[Row]:
    """`jaxmocap demo` as a process, cold and warm."""
    cold, warm = [], []
    for k in range(runs):
        cache = folder / f"cache{k}"
        cold.append(seconds_of(["demo", "--out", f"cold{k}"], cache, folder))
        warm.append(seconds_of(["demo", "--out", f"warm{k}"], cache, folder))
    return [
        Row("jaxmocap demo, cold", min(w for w, _ in cold), note=f"to be < 60 s; CPU {min(c for _, c in cold):.0f} s"),
        Row("the same, compiled programs kept", min(w for w, _ in warm), note=f"CPU {min(c for _, c in warm):.0f} s"),
    ]


def main() -> None:
    """Measure and report."""
    parser = arguments(__doc__)
    parser.add_argument("--runs", type=int, default=1, help="demo processes of each kind, of which the fastest counts")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rows = demo(folder, options.runs)
        rows += steps(folder / "here", options.repeats)
    report(rows, options.json)


if __name__ == "__main__":
    main()
