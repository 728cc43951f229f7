"""Run every benchmark and write the table of the README.

    python scripts/bench_table.py [--only bar chessboard first_call puppet] [--repeats 7]

The table goes between `<!-- bench:start -->` and `<!-- bench:end -->`; without these marks it is printed. It names
the commit, the machine's load and its cores, since none of the numbers means anything without them.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from peers.rows import REPEATS, THREADS, Row

HERE = Path(__file__).resolve().parent
README = HERE.parent / "README.md"
START, END = "<!-- bench:start -->", "<!-- bench:end -->"
BENCHMARKS = ("bar", "chessboard", "first_call", "puppet")


def commit() -> str:
    """Short hash, with a word if the working tree differs from it."""
    git = ["git", "-C", str(HERE.parent)]
    found = subprocess.run([*git, "rev-parse", "--short", "HEAD"], capture_output=True, text=True)
    if found.returncode:
        return "unknown"
    changed = subprocess.run([*git, "status", "--porcelain", "--", "jaxmocap", "scripts"], capture_output=True)
    return found.stdout.strip() + (" with changes" if changed.stdout.strip() else "")


def measured(name: str, repeats: int) -> list[Row]:
    """Rows of one benchmark, run as a process of its own; none if it fails (with its words)."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rows.json"
        command = [sys.executable, str(HERE / f"bench_{name}.py"), "--repeats", str(repeats), "--json", str(path)]
        done = subprocess.run(command)
        if done.returncode or not path.exists():
            print(f"bench_{name}.py ended with {done.returncode}; its rows are missing", file=sys.stderr)
            return [Row(f"{name}: not measured", float("nan"))]
        return [Row(**row) for row in json.loads(path.read_text())]


def table(rows: list[Row], before: float) -> str:
    """Markdown table with the line that says where and when."""
    lines = ["| what | jaxmocap | peer | ratio | note |", "|---|---|---|---|---|"]
    lines += ["| " + " | ".join(row.cells()) + " |" for row in rows]
    where = (
        f"Commit {commit()}; {THREADS} threads of {os.cpu_count()} cores; load average {before:.1f} before and "
        f"{os.getloadavg()[0]:.1f} after; medians; ratio = peer / jaxmocap."
    )
    return "\n".join([*lines, "", where])


def put_between_marks(text: str, new: str) -> str | None:
    """The text with what is between the marks replaced; None if it has no marks."""
    head, start, rest = text.partition(START)
    _, end, tail = rest.partition(END)
    return f"{head}{START}\n{new}\n{END}{tail}" if start and end else None


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="+", choices=BENCHMARKS, default=list(BENCHMARKS))
    parser.add_argument("--repeats", type=int, default=REPEATS)
    options = parser.parse_args()
    before = os.getloadavg()[0]
    new = table([row for name in options.only for row in measured(name, options.repeats)], before)
    written = put_between_marks(README.read_text(), new) if README.exists() else None
    if written is None:
        print(new)
    else:
        README.write_text(written)
        print(f"{README.name}: table written")


if __name__ == "__main__":
    main()
