"""`jaxmocap puppet ...`: stop-motion capture, step by step."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

from jaxmocap.cli.ending import Outputs, command_line
from jaxmocap.cli.options import Json, Photos
from jaxmocap.cli.run import Outcome, progress, run

if TYPE_CHECKING:
    from jaxmocap.workflows.stopmotion import StepResult

puppet = App(name="puppet", help="Photographs of a puppet with coloured beads on a turntable -> skeleton.")

Folder = Annotated[Path, Parameter(help="Folder of the pose.")]
Camera = Annotated[Path, Parameter(help="The camera, as `calibrate chessboard` writes it.")]
Turntable = Annotated[Path | None, Parameter(help="As `calibrate turntable` writes it.")]


def _inside(folder: Path) -> list[Path]:
    """What no output may replace."""
    from jaxmocap.io.puppet_folder import inputs_of

    return inputs_of(folder)


def _step(
    job: "Callable[[], StepResult]", json: Path | None, inputs: Sequence[Path], results: tuple[Path, ...] = ()
) -> int:
    """Run a step and write its files, and its JSON if asked for."""

    def outcome() -> Outcome:
        done = job()
        files = dict(done.files)
        if json:
            files[json] = done.json()
        return Outcome(done.summary, files, done.notes)

    return run(outcome, Outputs(results, json=json), inputs, waiting="looking at the photographs")


@puppet.command
def colours(
    tpose: Annotated[Path, Parameter(help="Folder of photographs of the T-pose, NAME_ANGLE.jpg.")],
    *,
    camera: Camera,
    turntable: Turntable = None,
    output: Annotated[Path, Parameter(name=["--output", "-o"], help="Colours file to write (TOML).")],
    json: Json = None,
) -> int:
    """Learn the beads' colours from a turn of photographs of the T-pose."""

    def job() -> "StepResult":
        from jaxmocap.workflows.stopmotion import learn_colours

        watch = progress("looking for beads")
        return learn_colours(tpose, camera, turntable=turntable, output=output, command=command_line(), progress=watch)

    inputs = [path for path in (camera, turntable, *(tpose.glob("*") if tpose.is_dir() else ())) if path]
    return _step(job, json, inputs, (output,))


@puppet.command
def new(
    folder: Folder,
    *,
    camera: Camera,
    turntable: Turntable = None,
    distance: Annotated[str | None, Parameter(help="Camera to axis, 400mm, where there is no turntable file.")] = None,
    height: Annotated[str | None, Parameter(help="Camera above the origin, 80mm.")] = None,
    colours: Annotated[Path | None, Parameter(help="As `puppet colours` writes it.")] = None,
    bones: Annotated[Path | None, Parameter(help="Lengths of the bones (TOML).")] = None,
) -> int:
    """Make the folder of a pose."""

    def job() -> Outcome:
        from jaxmocap.workflows.stopmotion import new_puppet

        made = new_puppet(
            folder, camera, turntable=turntable, distance=distance, height=height, colours=colours, bones=bones
        )
        return Outcome(f"{made.path} is ready; add photographs with `jaxmocap puppet add {made.path} PHOTO...`\n", {})

    return run(job, Outputs())


@puppet.command
def add(
    folder: Folder,
    photos: Photos,
    *,
    angle: Annotated[float | None, Parameter(help="Of one photograph [degrees]; else NAME_ANGLE.jpg.")] = None,
) -> int:
    """Add photographs to a pose; one at an angle that is there replaces that one, which is kept aside."""

    def job() -> Outcome:
        from jaxmocap.workflows.stopmotion import add_to_puppet

        changed, said = add_to_puppet(folder, photos, angle)
        angles = ", ".join(f"{a:g}" for a in changed.photos)
        return Outcome(f"{len(changed.photos)} photographs, at {angles} degrees\n", {}, tuple(said))

    return run(job, Outputs(), photos)


@puppet.command
def identify(folder: Folder, *, json: Json = None) -> int:
    """Find the beads in all photographs and give them names."""

    def job() -> "StepResult":
        from jaxmocap.workflows.stopmotion import identify as solve

        return solve(folder, command=command_line(), progress=progress("looking for beads"))

    return _step(job, json, _inside(folder))


@puppet.command
def reconstruct(folder: Folder, *, json: Json = None) -> int:
    """Put the beads in space and build the skeleton."""

    def job() -> "StepResult":
        from jaxmocap.workflows.stopmotion import reconstruct as solve

        return solve(folder, command=command_line(), progress=progress("looking for beads"))

    return _step(job, json, _inside(folder))


@puppet.command
def check(folder: Folder, *, json: Json = None) -> int:
    """Draw a contact sheet: each photograph with circled, named beads; a red frame marks a problem."""

    def job() -> "StepResult":
        from jaxmocap.workflows.stopmotion import contact_sheet

        return contact_sheet(folder, command=command_line(), progress=progress("looking for beads"))

    return _step(job, json, _inside(folder))


@puppet.command
def export(
    folder: Folder,
    *,
    dae: Annotated[Path | None, Parameter(help="COLLADA file to write.")] = None,
    glb: Annotated[Path | None, Parameter(help="Binary glTF file to write.")] = None,
    bvh: Annotated[Path | None, Parameter(help="BVH file to write.")] = None,
    csv: Annotated[Path | None, Parameter(help="Table of the beads to write.")] = None,
) -> int:
    """Write the pose for other programs."""

    def job() -> Outcome:
        from jaxmocap._errors import InputError
        from jaxmocap.workflows.puppet_export import NOTHING, exported
        from jaxmocap.workflows.stopmotion import current_pose, folder_colours

        if not outputs.results:
            raise InputError(NOTHING)
        pose, notes = current_pose(folder)
        files, said = exported(pose, dae=dae, glb=glb, bvh=bvh, csv=csv, colours=folder_colours(folder))
        return Outcome("".join(f"{sentence}\n" for sentence in said), files, notes)

    outputs = Outputs(tuple(path for path in (dae, glb, bvh, csv) if path), tables=(csv,) if csv else ())
    return run(job, outputs, _inside(folder))
