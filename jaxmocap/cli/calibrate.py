"""`jaxmocap calibrate ...`."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

from jaxmocap.cli.ending import Outputs, command_line
from jaxmocap.cli.options import PLAIN_FIT, Board, FitOptions, Json, Photos, Report, RigOptions, Several, Square
from jaxmocap.cli.run import Outcome, progress, run

if TYPE_CHECKING:
    from jaxmocap.workflows.calibration_result import CalibrationResult

calibrate = App(name="calibrate", help="Find out what a camera, or several, are.")


def run_calibration(job: Callable[[], "CalibrationResult"], files: RigOptions, inputs: Sequence[str | Path]) -> int:
    """Do a calibration, write its files and print its summary.

    Args:
        job: the calibration.
        files: what to write, and whether also a result that is not to be used.
        inputs: files that no output may replace.

    Returns:
        exit status.
    """
    results = (files.output, files.opencv) if files.opencv else (files.output,)
    outputs = Outputs(results, files.report, files.json)
    return run(lambda: _outcome(job(), files), outputs, inputs, "calibrating")


def _outcome(result: "CalibrationResult", files: RigOptions) -> Outcome:
    serious = [w for w in result.weaknesses if w.severity == "serious"]
    contents: dict[str | Path, bytes] = {}
    said: list[str] = []
    refused = ""
    if serious and not files.force:
        refused = f"{serious[0].sentence} {serious[0].next_step} (--force writes the result all the same.)"
    else:
        contents, said = _rig_files(result, files)
    if files.report:
        contents[files.report] = result.html().encode()
    if files.json:
        contents[files.json] = result.json({"success": False, "message": refused} if refused else None)
    return Outcome(result.summary(), contents, tuple(said), refused)


def _rig_files(result: "CalibrationResult", files: RigOptions) -> tuple[dict[str | Path, bytes], list[str]]:
    """The rig in the forms asked for, and what is to be said of them."""
    from jaxmocap.io import opencv_yaml_text, rig_text

    rig = result.rig()
    text, said = rig_text(rig)
    contents: dict[str | Path, bytes] = {files.output: text.encode()}
    if files.opencv:
        yaml, more = opencv_yaml_text(rig.cameras)
        contents[files.opencv] = yaml.encode()
        said = said or more  # both speak of a skew
    return contents, said


@calibrate.command
def chessboard(
    images: Photos,
    *,
    board: Board,
    square: Square,
    name: Annotated[str, Parameter(help="Name of the camera in files.")] = "cam1",
    fit: FitOptions = PLAIN_FIT,
    files: RigOptions,
) -> int:
    """Calibrate one camera from photographs of a chessboard."""

    def job() -> "CalibrationResult":
        from jaxmocap.workflows.calibrate import calibrate_chessboard as solve

        watch = progress("looking for the board")
        return solve(images, board, square, name=name, command=command_line(), progress=watch, **fit.arguments())

    return run_calibration(job, files, images)


@calibrate.command
def stereo(
    *,
    left: Annotated[list[str], Several],
    right: Annotated[list[str], Several],
    board: Board,
    square: Square,
    fit: FitOptions = PLAIN_FIT,
    files: RigOptions,
) -> int:
    """Calibrate two cameras and the pose between them from photographs taken at the same moments.

    Pairs match by the last number in the file name, else by order.
    """

    def job() -> "CalibrationResult":
        from jaxmocap.workflows.calibrate import calibrate_stereo as solve

        watch = progress("looking for the board")
        return solve(left, right, board, square, command=command_line(), progress=watch, **fit.arguments())

    return run_calibration(job, files, [*left, *right])


@calibrate.command
def points(
    correspondences: Path,
    *,
    size: Annotated[list[str], Parameter(consume_multiple=True, negative="", help="640x480, or cam3=1280x720.")],
    unit: Annotated[str, Parameter(help="Unit of x, y, z, for instance mm.")] = "1",
    fit: FitOptions = PLAIN_FIT,
    files: RigOptions,
) -> int:
    """Calibrate cameras from known points whose pixels were found elsewhere (CSV view,x,y,z,u,v[,sigma][,camera])."""

    def job() -> "CalibrationResult":
        from jaxmocap.workflows.calibrate import calibrate_points as solve

        return solve(correspondences, size, unit=unit, command=command_line(), **fit.arguments())

    return run_calibration(job, files, [correspondences])


@calibrate.command
def turntable(
    camera: Path,
    photos: Photos,
    *,
    board: Board,
    square: Square,
    output: Annotated[Path, Parameter(name=["--output", "-o"], help="Turntable file to write (TOML).")],
    height: Annotated[str | None, Parameter(help="Of the camera above the origin; 80mm.")] = None,
    report: Report = None,
    json: Json = None,
    force: Annotated[bool, Parameter(help="Write a result that is marked as not to be used.", negative="")] = False,
) -> int:
    """Find a turntable's axis, and the angle of each photo, from a chessboard standing on it (NAME_ANGLE.jpg)."""

    def job() -> Outcome:
        from jaxmocap.workflows.turntable import calibrate_turntable as solve

        watch = progress("looking for the board")
        result = solve(camera, photos, board, square, height=height, command=command_line(), progress=watch)
        serious = [w for w in result.weaknesses if w.severity == "serious"]
        refused = ""
        if serious and not force:
            refused = f"{serious[0].sentence} {serious[0].next_step} (--force writes the result all the same.)"
        contents: dict[str | Path, bytes] = {} if refused else {output: result.text().encode()}
        if report:
            contents[report] = result.html().encode()
        if json:
            contents[json] = result.json({"success": False, "message": refused} if refused else None)
        return Outcome(result.summary(), contents, refused=refused)

    return run(job, Outputs((output,), report, json), [camera, *photos], "calibrating")
