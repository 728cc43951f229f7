"""Options that commands share, declared once; heavy imports stand inside the commands, so that --help is quick."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

Photos = Annotated[list[str], Parameter(help="Files, folders or quoted patterns.", negative="")]
Several = Parameter(consume_multiple=True, negative="")
Board = Annotated[str, Parameter(help="INNER corners as COLUMNSxROWS, for instance 9x6.")]
Square = Annotated[str, Parameter(help="Side of a square with its unit, for instance 30mm.")]
Json = Annotated[Path | None, Parameter(name="--json", help="Write every printed number.")]
Report = Annotated[Path | None, Parameter(help="Write a report, one HTML page.")]


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """What is sought, and how."""

    distortion: Annotated[str, Parameter(help="none, k1k2, k1k2k3 or k1k2p1p2k3.")] = "k1k2"
    skew: Annotated[bool, Parameter(help="Also seek K[0][1].", negative="")] = False
    robust: Annotated[bool, Parameter(help="Let outliers count less (Cauchy loss).", negative="")] = False

    def arguments(self) -> dict[str, Any]:
        """As the workflows take them."""
        return {"distortion": self.distortion, "skew": self.skew, "robust": self.robust}


PLAIN_FIT = FitOptions()


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class RigOptions:
    """The files that a calibration writes."""

    output: Annotated[Path, Parameter(name=["--output", "-o"], help="Rig file to write (TOML).")]
    report: Report = None
    json: Json = None
    opencv: Annotated[Path | None, Parameter(name="--opencv", help="Also write an OpenCV YAML file.")] = None
    force: Annotated[bool, Parameter(help="Write a result that is marked as not to be used.", negative="")] = False
