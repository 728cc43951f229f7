"""`jaxmocap demo`: the bundled photographs, beside their truth."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from jaxmocap.cli.calibrate import run_calibration
from jaxmocap.cli.ending import WRONG_INPUT, command_line, failed
from jaxmocap.cli.options import RigOptions
from jaxmocap.cli.run import progress

if TYPE_CHECKING:
    from jaxmocap.workflows.calibration_result import CalibrationResult


def demo(*, out: Annotated[Path, Parameter(help="Folder to write into.")] = Path("jaxmocap-demo")) -> int:
    """Calibrate a camera from the bundled photographs and show the result beside the truth."""

    def job() -> "CalibrationResult":
        from dataclasses import replace

        from jaxmocap.workflows.calibrate import calibrate_chessboard as solve
        from jaxmocap.workflows.calibrate import demo_photos

        folder, known = demo_photos()
        watch = progress("looking for the board")
        result = solve(folder, known["board"], known["square"], command=command_line(), progress=watch)
        return replace(result, truth=known["camera"])

    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        return failed(f"--out {out}: the folder cannot be made ({error.strerror}); name another", WRONG_INPUT)
    return run_calibration(job, RigOptions(output=out / "camera.toml", report=out / "report.html"), [])
