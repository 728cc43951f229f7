"""Strict switches for every test: 64 bits, no silent broadcasting or promotion, shapes checked at each call."""

import os
import subprocess
import sys
from pathlib import Path

os.environ.setdefault("MPLBACKEND", "Agg")
# Nearly all of a test's time is XLA compiling what then runs once: plain code halves it. A version of XLA that does
# not know these options ends the process, so another process tries them; workers inherit what it found.
_PLAIN_CODE = "--xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=0"
if "XLA_FLAGS" not in os.environ:
    _try = [sys.executable, "-c", "import jax; jax.devices()"]
    _known = subprocess.run(_try, env={**os.environ, "XLA_FLAGS": _PLAIN_CODE}, capture_output=True).returncode == 0
    os.environ["XLA_FLAGS"] = _PLAIN_CODE if _known else ""
sys.path.insert(0, str(Path(__file__).parent))  # so that test modules may `import samplers`

import jax
import jaxtyping
import pytest
from hypothesis import settings

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

# Shape annotations are checked at run time. Before any test module imports the package.
jaxtyping.install_import_hook("jaxmocap", "beartype.beartype")

# Same examples in every run; the first call of a function compiles, so no deadline.
settings.register_profile("jaxmocap", derandomize=True, deadline=None, database=None, max_examples=50)
settings.load_profile("jaxmocap")


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of photographs and recordings, from JAXMOCAP_DATA; a test that needs it skips without."""
    folder = os.environ.get("JAXMOCAP_DATA")
    if folder and Path(folder).is_dir():
        return Path(folder)
    reason = f"JAXMOCAP_DATA: expected a folder, got {folder!r}"
    if folder or os.environ.get("CI"):
        pytest.fail(reason)
    pytest.skip("JAXMOCAP_DATA is not set: photographs and recordings are not at hand")
