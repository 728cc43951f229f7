"""What all benchmarks share: fixed cores, alternating runs, and rows of the table."""

from __future__ import annotations

import argparse
import json
import os
import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

REPEATS = 7
THREADS = 2


@dataclass(frozen=True)
class Row:
    """One measurement: medians in seconds, or another number with its unit; `peer_value` None is 'not measured'."""

    name: str
    value: float
    peer: str = ""
    peer_value: float | None = None
    unit: str = "s"
    note: str = ""

    def cells(self) -> tuple[str, str, str, str, str]:
        """Name, our number, the peer's number, ratio, note."""
        ours, theirs, ratio = f"{self.value:.3g} {self.unit}", "", ""
        if self.peer and self.peer_value is None:
            theirs = f"{self.peer}: not measured"
        elif self.peer and self.peer_value is not None:
            theirs = f"{self.peer}: {self.peer_value:.3g} {self.unit}"
            ratio = f"{self.peer_value / self.value:.2f} x"
        return self.name, ours, theirs, ratio, self.note


def use_cores(threads: int = THREADS) -> None:
    """Keep this process and all it starts on the same cores. Before jax is imported, which counts them once."""
    cores = sorted(os.sched_getaffinity(0))[:threads]
    os.sched_setaffinity(0, cores)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = str(len(cores))


def timed(run: Callable[[], Any]) -> tuple[float, Any]:
    """Wall seconds and what came out."""
    start = time.perf_counter()
    out = run()
    return time.perf_counter() - start, out


def alternate(runs: list[Callable[[], float]], repeats: int = REPEATS) -> list[float]:
    """Median of what each run returns (its seconds), one after the other in every round."""
    seconds: list[list[float]] = [[] for _ in runs]
    for _ in range(repeats):
        for k, run in enumerate(runs):
            seconds[k].append(run())
    return [statistics.median(s) for s in seconds]


def arguments(description: str | None) -> argparse.ArgumentParser:
    """Options of every benchmark."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--repeats", type=int, default=REPEATS, help="runs of which the median is taken")
    parser.add_argument("--json", type=Path, help="also write the rows to this file")
    return parser


def report(rows: list[Row], path: Path | None) -> None:
    """Print rows, and write them for bench_table.py if asked to."""
    for row in rows:
        print(" | ".join(cell for cell in row.cells() if cell), flush=True)
    if path is not None:
        path.write_text(json.dumps([asdict(row) for row in rows], indent=1))
