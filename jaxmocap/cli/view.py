"""`jaxmocap view`: files as one page for the browser."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from jaxmocap.cli.ending import Outputs
from jaxmocap.cli.run import Outcome, run


def view(
    things: Annotated[list[Path], Parameter(help="A .glb, a table of points (.csv), a rig or a turntable (.toml).")],
    *,
    html: Annotated[Path | None, Parameter(help="Page to write; THING.view.html here if not given.")] = None,
    unit: Annotated[str | None, Parameter(help="Unit of a table of points, for instance mm.")] = None,
    up: Annotated[str | None, Parameter(help="Axis of the world that points up: y, -y, z, ...")] = None,
) -> int:
    """Write a page that shows motions, points, cameras and turning axis in three dimensions; it needs no network.

    Files given together share one world: a motion or points, the rig, the turntable.
    """
    page = html or Path(f"{things[0].stem}.view.html")

    def job() -> Outcome:
        from jaxmocap.viewer import scene_page
        from jaxmocap.workflows.view import view_scene

        scene = view_scene(things, unit=unit, up=up)
        text = scene_page(scene).encode()
        counts = [
            (len(scene.markers.names) if scene.markers else 0, "markers"),
            (len(scene.skeleton.names) if scene.skeleton else 0, "joints"),
            (len(scene.cameras), "cameras"),
            (scene.frames, "frames"),
        ]
        said = ", ".join(f"{n} {what}" for n, what in counts if n)
        return Outcome(f"{scene.title}: {said}; open the page in a browser\n", {page: text}, tuple(scene.notes))

    return run(job, Outputs(results=(page,)), things, "reading")
