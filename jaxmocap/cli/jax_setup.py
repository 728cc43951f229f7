"""How the commands run JAX: 64-bit numbers, and compiled programs kept between runs."""

import os
import re
import sys
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any

_DAMAGED = re.compile(r"Error reading persistent compilation cache entry for '([\w.<>-]+)'")


def use_jax() -> None:
    """Switch 64-bit numbers on and keep compiled programs (a second run starts several times faster)."""
    import jax

    jax.config.update("jax_enable_x64", True)
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    folder = Path(os.environ.get("JAXMOCAP_CACHE_DIR") or Path(base) / "jaxmocap" / "compiled")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK):
            return
    except OSError:
        return  # no cache: slower, nothing else
    from jaxmocap import _programs

    _programs.keep_in(folder / "programs")
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    _mend(folder)


def _mend(folder: Path) -> None:
    """Remove an entry that JAX cannot read, and say so once: JAX itself leaves it, and warns at every run."""
    show, told = warnings.showwarning, False

    def showwarning(message: Warning | str, *others: Any, **named: Any) -> None:
        nonlocal told
        damaged = _DAMAGED.match(str(message))
        if damaged is None:
            show(message, *others, **named)
            return
        with suppress(OSError):  # a folder that has become protected: told again at the next run
            for entry in folder.iterdir():
                if entry.name.startswith(f"{damaged[1]}-"):
                    entry.unlink(missing_ok=True)
        if not told:
            print(f"note: damaged entries of {folder} are made anew; nothing else is affected", file=sys.stderr)
        told = True

    warnings.showwarning = showwarning
