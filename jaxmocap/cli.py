"""The command line. Heavy imports stand inside the commands, so that `--help` answers at once."""

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import App, Parameter

from jaxmocap._errors import InputError, JaxMocapError, SolveError

if TYPE_CHECKING:
    from jaxmocap.workflows.calibration_result import CalibrationResult

DONE, WRONG_INPUT, NOT_SOLVED, INTERRUPTED = 0, 2, 3, 130

app = App(
    name="jaxmocap",
    help="Calibrate cameras and capture motion; every number comes with its standard deviation.",
    version_flags=["--version"],
    result_action="return_value",
)
calibrate = App(name="calibrate", help="Find out what a camera, or several, are.")
app.command(calibrate)

Photos = Annotated[list[str], Parameter(help="Files, folders or quoted patterns.", negative="")]
Many = Parameter(consume_multiple=True, negative="")
Board = Annotated[str, Parameter(help="INNER corners as COLUMNSxROWS, for instance 9x6.")]
Square = Annotated[str, Parameter(help="Side of a square with its unit, for instance 30mm.")]
Output = Annotated[Path, Parameter(name=["--output", "-o"], help="Rig file to write (TOML).")]
Distortion = Annotated[str, Parameter(help="none, k1k2, k1k2k3 or k1k2p1p2k3.")]
Skew = Annotated[bool, Parameter(help="Also seek K[0][1].", negative="")]
Robust = Annotated[bool, Parameter(help="Let outliers count less (Cauchy loss).", negative="")]
Report = Annotated[Path | None, Parameter(help="Write a report, one HTML page.")]
Json = Annotated[Path | None, Parameter(name="--json", help="Write every printed number.")]
Yaml = Annotated[Path | None, Parameter(name="--opencv", help="Also write an OpenCV YAML file.")]


def main() -> None:
    """Run the command line and exit with its status: 0 done, 2 wrong input, 3 not solved, 130 interrupted."""
    try:
        status = app(print_error=True, exit_on_error=False)
    except KeyboardInterrupt:
        print("interrupted; nothing was written", file=sys.stderr)
        status = INTERRUPTED
    except Exception as error:
        from cyclopts import CycloptsError

        if not isinstance(error, CycloptsError):
            raise
        status = WRONG_INPUT
    sys.exit(status if isinstance(status, int) else DONE)


def _use_jax() -> None:
    """64-bit numbers, and compiled programs kept between runs (a second run starts several times faster)."""
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
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def _command() -> str:
    """The command line as it was typed, for the record."""
    import shlex

    return shlex.join(["jaxmocap", *sys.argv[1:]])


def _progress(what: str) -> Callable[[int, int], None] | None:
    """A progress bar on a terminal, nothing elsewhere."""
    if not sys.stderr.isatty():
        return None
    from tqdm import tqdm

    bar = tqdm(desc=what, unit="photo", leave=False)

    def advance(done: int, total: int) -> None:
        bar.total = total
        bar.update(done - bar.n)
        if done >= total:
            bar.close()

    return advance


def _run(
    job: Callable[[], "CalibrationResult"],
    output: Path,
    report: Path | None,
    json: Path | None,
    opencv: Path | None,
) -> int:
    """Do a calibration, write all of its files or none, print its summary; on failure write the JSON alone."""
    command = _command()
    try:
        _use_jax()
        result = job()
        said = _write(result, output, report, json, opencv)
    except JaxMocapError as error:
        status = NOT_SOLVED if isinstance(error, SolveError) else WRONG_INPUT
        print(f"error: {error}", file=sys.stderr)
        _write_failure(json, report, command, error)
        return status
    print(result.summary(), end="")
    for sentence in said:
        print(f"note: {sentence}")
    print("wrote " + ", ".join(str(p) for p in (output, report, json, opencv) if p))
    return DONE


def _write(
    result: "CalibrationResult", output: Path, report: Path | None, json: Path | None, opencv: Path | None
) -> list[str]:
    from jaxmocap.io import opencv_yaml_text, rig_text, write_many

    text, said = rig_text(result.rig())
    files: dict[str | Path, bytes] = {output: text.encode()}
    if report:
        files[report] = result.html().encode()
    if json:
        files[json] = result.json({"outputs": [str(output)]})
    if opencv:
        yaml, more = opencv_yaml_text(result.rig().cameras)
        files[opencv] = yaml.encode()
        said = [*said, *(s for s in more if s not in said)]
    write_many(files)
    return said


def _write_failure(json: Path | None, report: Path | None, command: str, error: JaxMocapError) -> None:
    """The machine-readable failure and, if asked for, a page that says the same; never an old result's place."""
    from importlib.metadata import version

    from jaxmocap.io import json_bytes, write_bytes
    from jaxmocap.report import failure_html

    content: dict[str, Any] = {
        "jaxmocap": version("jaxmocap"),
        "command": command,
        "success": False,
        "message": str(error),
        "unit": None,
        "seed": None,
        "warnings": [],
    }
    for path, make in ((json, lambda: json_bytes(content)), (report, lambda: failure_html(command, str(error)).encode())):
        if path is None:
            continue
        try:
            write_bytes(path, make())
        except JaxMocapError as second:
            print(f"error: {second}", file=sys.stderr)


@calibrate.command(name="chessboard")
def calibrate_chessboard(
    images: Photos,
    *,
    board: Board,
    square: Square,
    output: Output,
    distortion: Distortion = "k1k2",
    skew: Skew = False,
    robust: Robust = False,
    name: Annotated[str, Parameter(help="Name of the camera in files.")] = "cam1",
    report: Report = None,
    json: Json = None,
    opencv: Yaml = None,
) -> int:
    """Calibrate one camera from photographs of a chessboard."""

    def job() -> "CalibrationResult":
        from jaxmocap.workflows.calibrate import calibrate_chessboard as solve

        return solve(
            images,
            board,
            square,
            distortion=distortion,
            skew=skew,
            robust=robust,
            name=name,
            command=_command(),
            progress=_progress("looking for the board"),
        )

    return _run(job, output, report, json, opencv)


@calibrate.command(name="stereo")
def calibrate_stereo(
    *,
    left: Annotated[list[str], Many],
    right: Annotated[list[str], Many],
    board: Board,
    square: Square,
    output: Output,
    distortion: Distortion = "k1k2",
    skew: Skew = False,
    robust: Robust = False,
    report: Report = None,
    json: Json = None,
    opencv: Yaml = None,
) -> int:
    """Calibrate two cameras and the pose between them from photographs taken at the same moments.

    Pairs match by the last number in the file name, else by order.
    """

    def job() -> "CalibrationResult":
        from jaxmocap.workflows.calibrate import calibrate_stereo as solve

        return solve(
            left,
            right,
            board,
            square,
            distortion=distortion,
            skew=skew,
            robust=robust,
            command=_command(),
            progress=_progress("looking for the board"),
        )

    return _run(job, output, report, json, opencv)


@calibrate.command(name="points")
def calibrate_points(
    correspondences: Path,
    *,
    size: Annotated[list[str], Parameter(consume_multiple=True, negative="", help="640x480, or cam3=1280x720.")],
    output: Output,
    unit: Annotated[str, Parameter(help="Unit of x, y, z, for instance mm.")] = "1",
    distortion: Distortion = "k1k2",
    skew: Skew = False,
    robust: Robust = False,
    report: Report = None,
    json: Json = None,
    opencv: Yaml = None,
) -> int:
    """Calibrate cameras from known points whose pixels were found elsewhere (CSV view,x,y,z,u,v[,sigma][,camera])."""

    def job() -> "CalibrationResult":
        from jaxmocap.workflows.calibrate import calibrate_points as solve

        return solve(
            correspondences,
            size,
            unit=unit,
            distortion=distortion,
            skew=skew,
            robust=robust,
            command=_command(),
        )

    return _run(job, output, report, json, opencv)


@app.command
def demo(*, out: Annotated[Path, Parameter(help="Folder to write into.")] = Path("jaxmocap-demo")) -> int:
    """Calibrate a camera from the bundled photographs and show the result beside the truth."""
    report, camera = out / "report.html", out / "camera.toml"

    def job() -> "CalibrationResult":
        from dataclasses import replace

        from jaxmocap.workflows.calibrate import calibrate_chessboard as solve
        from jaxmocap.workflows.calibrate import demo_photos

        folder, known = demo_photos()
        try:
            out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"--out {out}: the folder cannot be made ({error.strerror}); name another") from None
        result = solve(
            sorted(folder.glob("*.jpg")),
            known["board"],
            known["square"],
            command=_command(),
            progress=_progress("looking for the board"),
        )
        return replace(result, truth=known["camera"])

    return _run(job, camera, report, None, None)


if __name__ == "__main__":
    main()
