"""What pip and a shell see of the package."""

import resource
import shutil
import statistics
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_the_extras_exist_and_dev_holds_test():
    extras = PROJECT["optional-dependencies"]
    assert {"test", "dev"} <= set(extras)
    assert any(requirement.replace(" ", "").startswith("jaxmocap[test]") for requirement in extras["dev"])


def test_what_the_package_imports_at_run_time_is_declared():
    declared = {requirement.split()[0].split("[")[0].lower() for requirement in PROJECT["dependencies"]}
    assert {"jax", "jaxopt", "optimistix", "equinox", "lineax", "jaxtyping", "numpy", "scipy"} <= declared
    assert any(name.startswith("opencv") and name.endswith("headless") for name in declared)


def test_types_are_shipped_and_the_licence_is_apache():
    assert (ROOT / "jaxmocap" / "py.typed").is_file()
    assert PROJECT["license"] == "Apache-2.0"
    text = (ROOT / "LICENSE").read_text(encoding="utf-8")
    assert "Apache License" in text and "Version 2.0" in text


def test_the_readme_exists_and_the_script_points_at_the_command_line():
    assert (ROOT / PROJECT["readme"]).is_file()
    assert PROJECT["scripts"]["jaxmocap"] == "jaxmocap.cli:main"


def test_help_comes_within_half_a_second():
    command = [sys.executable, "-m", "jaxmocap", "--help"]
    beside = shutil.which("jaxmocap", path=str(Path(sys.executable).parent))
    if beside is not None:
        command = [beside, "--help"]
    # Processor time, not wall time: other tests run beside this one. --help has one thread, so they agree otherwise.
    seconds, out = [], ""
    for _ in range(3):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        out = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT).stdout
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        seconds.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    assert "calibrate" in out
    assert statistics.median(seconds) < 0.5
