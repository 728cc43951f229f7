"""The folder of compiled programs, damaged between runs."""

import os
import subprocess
import sys
from pathlib import Path

PROGRAM = """
from jaxmocap.cli.jax_setup import use_jax
use_jax()
import jax, warnings
print(float(jax.jit(lambda x: x * 3 + 1)(2.0)))
warnings.warn("another one")
"""


def test_a_damaged_entry_is_told_once_and_made_anew(tmp_path: Path) -> None:
    def run() -> str:
        env = {**os.environ, "JAXMOCAP_CACHE_DIR": str(tmp_path)}
        done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, env=env, check=True)
        assert done.stdout == "7.0\n" and "another one" in done.stderr
        return done.stderr

    assert "damaged" not in run()
    entries = list(tmp_path.glob("*-cache"))
    assert entries
    for entry in entries:
        entry.write_bytes(b"not an entry")
    second = run()
    assert second.count("note: damaged entries") == 1 and "Error reading" not in second
    third = run()
    assert "damaged" not in third and "Error reading" not in third
    assert all(entry.read_bytes() != b"not an entry" for entry in entries)
