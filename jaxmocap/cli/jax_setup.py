"""How the commands run JAX: 64-bit numbers, and compiled programs kept between runs."""

import os
from pathlib import Path


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
