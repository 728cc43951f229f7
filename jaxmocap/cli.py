"""The command line. Heavy imports stand inside the commands, so that `--help` answers at once."""

import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
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
    suppress_keyboard_interrupt=False,
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
Force = Annotated[bool, Parameter(help="Write a result that is marked as not to be used.", negative="")]
Yaml = Annotated[Path | None, Parameter(name="--opencv", help="Also write an OpenCV YAML file.")]


def main() -> None:
    """Run the command line and exit with its status: 0 done, 2 wrong input, 3 not solved, 130 interrupted."""
    try:
        status = app(print_error=True, exit_on_error=False)
        sys.stdout.flush()
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        status = INTERRUPTED
    except BrokenPipeError:  # the reader of the summary has gone; the files are written
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = DONE
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
    from jaxmocap import _programs

    _programs.keep_in(folder / "programs")
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


@dataclass(frozen=True)
class _Outputs:
    """The files a command was asked to write."""

    rig: Path
    report: Path | None = None
    json: Path | None = None
    opencv: Path | None = None

    @property
    def all(self) -> list[Path]:
        return [path for path in (self.rig, self.report, self.json, self.opencv) if path]


def _run(job: Callable[[], "CalibrationResult"], outputs: _Outputs, inputs: list[str], force: bool = False) -> int:
    """Do a calibration, write all of its files or none, print its summary; on failure write JSON and report alone."""
    try:
        _check_places(outputs, inputs)
        _use_jax()
        if sys.stderr.isatty():
            print("calibrating (the first run compiles, later ones are faster) ...", file=sys.stderr)
        result = job()
        serious = [w for w in result.weaknesses if w.severity == "serious"]
        if serious and not force:
            print(result.summary(), end="")
            message = f"{serious[0].sentence} {serious[0].next_step} (--force writes the result all the same.)"
            _write_refused(result, outputs, message)
            return _failed(message, NOT_SOLVED)
        said = _write(result, outputs)
    except JaxMocapError as error:
        _write_failure(outputs, error)
        return _failed(str(error), NOT_SOLVED if isinstance(error, SolveError) else WRONG_INPUT)
    print(result.summary(), end="")
    for sentence in said:
        print(f"note: {sentence}")
    print("wrote " + ", ".join(map(str, outputs.all)))
    return DONE


def _failed(message: str, status: int) -> int:
    print(f"error: {message}", file=sys.stderr)
    return status


# An existing file that ends so is somebody's recording: no output replaces it.
_INPUT_SUFFIXES = {".jpg", ".jpeg", ".jpe", ".png", ".tif", ".tiff", ".bmp", ".webp", ".pgm", ".ppm", ".pnm", ".csv"}


def _check_places(outputs: _Outputs, inputs: list[str]) -> None:
    """Refuse at once what could not be written after minutes of work, or would overwrite an input."""
    for path in outputs.all:
        if path.is_dir():
            raise InputError(f"{path} is a folder; give the name of a file to write")
        if not path.absolute().parent.is_dir():
            raise InputError(f"{path}: the folder {path.absolute().parent} does not exist; make it first")
        if not os.access(path.absolute().parent, os.W_OK):
            raise InputError(f"{path}: the folder {path.absolute().parent} cannot be written to; choose another")
        same = any(path.exists() and Path(i).exists() and path.samefile(i) for i in inputs)
        if same or (path.exists() and path.suffix.lower() in _INPUT_SUFFIXES):
            raise InputError(f"{path} is, or looks like, one of the inputs; give another name for the output")
    if len({path.resolve() for path in outputs.all}) < len(outputs.all):
        raise InputError("two outputs have the same name; give each its own")


def _write(result: "CalibrationResult", outputs: _Outputs) -> list[str]:
    from jaxmocap.io import opencv_yaml_text, rig_text, write_many

    text, said = rig_text(result.rig())
    files: dict[str | Path, bytes] = {outputs.rig: text.encode()}
    if outputs.report:
        files[outputs.report] = result.html().encode()
    if outputs.json:
        files[outputs.json] = result.json()
    if outputs.opencv:
        yaml, more = opencv_yaml_text(result.rig().cameras)
        files[outputs.opencv] = yaml.encode()
        said = said or more  # both speak of a skew
    write_many(files)
    return said


def _write_refused(result: "CalibrationResult", outputs: _Outputs, message: str) -> None:
    """JSON and report of a result that is not to be used; an earlier rig file stays."""
    from jaxmocap.io import write_many

    files: dict[str | Path, bytes] = {}
    if outputs.report:
        files[outputs.report] = result.html().encode()
    if outputs.json:
        files[outputs.json] = result.json({"success": False, "message": message})
    write_many(files)


def _write_failure(outputs: _Outputs, error: JaxMocapError) -> None:
    """The machine-readable failure and, if asked for, a page that says the same; nothing else is touched."""
    from importlib.metadata import version

    from jaxmocap.io.atomic import write_bytes
    from jaxmocap.io.json_file import json_bytes
    from jaxmocap.report.failure import failure_html

    command = _command()
    content: dict[str, Any] = {
        "jaxmocap": version("jaxmocap"),
        "command": command,
        "success": False,
        "message": str(error),
        "unit": None,
        "seed": None,
        "warnings": [],
    }
    page = failure_html(command, str(error)).encode()
    for path, data in ((outputs.json, json_bytes(content)), (outputs.report, page)):
        # Whatever was typed, a failure replaces neither a recording nor the rig.
        if path is None or path.suffix.lower() in _INPUT_SUFFIXES or path.resolve() == outputs.rig.resolve():
            continue
        try:
            write_bytes(path, data)
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
    force: Force = False,
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

    return _run(job, _Outputs(output, report, json, opencv), images, force)


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
    force: Force = False,
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

    return _run(job, _Outputs(output, report, json, opencv), [*left, *right], force)


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
    force: Force = False,
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

    return _run(job, _Outputs(output, report, json, opencv), [str(correspondences)], force)


@app.command
def demo(*, out: Annotated[Path, Parameter(help="Folder to write into.")] = Path("jaxmocap-demo")) -> int:
    """Calibrate a camera from the bundled photographs and show the result beside the truth."""

    def job() -> "CalibrationResult":
        from dataclasses import replace

        from jaxmocap.workflows.calibrate import calibrate_chessboard as solve
        from jaxmocap.workflows.calibrate import demo_photos

        folder, known = demo_photos()
        result = solve(
            folder,
            known["board"],
            known["square"],
            command=_command(),
            progress=_progress("looking for the board"),
        )
        return replace(result, truth=known["camera"])

    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        return _failed(f"--out {out}: the folder cannot be made ({error.strerror}); name another", WRONG_INPUT)
    return _run(job, _Outputs(out / "camera.toml", out / "report.html"), [])


if __name__ == "__main__":
    main()
