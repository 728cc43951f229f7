"""`jaxmocap demo`: from bundled photographs to a skeleton, beside the truth."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from jaxmocap.cli.ending import WRONG_INPUT, Outputs, command_line, failed
from jaxmocap.cli.run import Outcome, progress, run


def demo(*, out: Annotated[Path, Parameter(help="Folder to write into.")] = Path("jaxmocap-demo")) -> int:
    """Calibrate the camera, find the puppet's beads and skeleton in bundled photographs, beside the truth."""
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        return failed(f"--out {out}: the folder cannot be made ({error.strerror}); name another", WRONG_INPUT)

    def job() -> Outcome:
        from jaxmocap.workflows.demo import run_demo

        for said in run_demo(out, command_line(), progress):
            print(said, flush=True)
        return Outcome("", {})

    return run(job, Outputs((out / "camera.toml",)), waiting="running the demo")
