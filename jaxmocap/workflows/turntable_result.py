"""What a turntable calibration gives its user: it shows itself, saves itself and can be computed with."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from importlib.metadata import version
from typing import Any

import numpy as np

from jaxmocap.calibration.evidence import Weakness
from jaxmocap.calibration.turntable import AxisNumbers, TurntableEstimate, axis_numbers
from jaxmocap.calibration.turntable_checks import Steps, steps, wrap_deg
from jaxmocap.cameras import Turntable
from jaxmocap.io import TurntableFile, json_bytes, turntable_text
from jaxmocap.report import ParameterRow, TurntableReport, turntable_html, turntable_summary
from jaxmocap.report.turntable import AngleRow

HELD = ("height", "zero angle")
"""What photos of a board leave free, and is held."""


@dataclass(frozen=True, repr=False)
class TurntableResult:
    """A finished calibration of a turntable."""

    solved: TurntableEstimate
    names: tuple[str, ...]
    """Photos used."""
    stated_deg: np.ndarray
    held: int
    """The photo whose stated angle is the zero of the others."""
    unit: str
    board: str
    command: str
    inputs: Mapping[str, str]
    weaknesses: tuple[Weakness, ...] = ()
    notes: tuple[str, ...] = ()
    skipped: tuple[tuple[str, str], ...] = ()

    @property
    def turntable(self) -> Turntable:
        """The turntable, for `Turntable.pose(angle)`."""
        return self.solved.turntable

    @cached_property
    def axis(self) -> AxisNumbers:
        """Point and direction of the axis and the deviation from nominal, with sigmas."""
        return axis_numbers(self.solved.turntable, np.asarray(self.solved.covariance)[:4, :4])

    @cached_property
    def angles_deg(self) -> np.ndarray:
        """Measured angle of each photo, in the turn of the stated one."""
        measured = np.degrees(np.asarray(self.solved.angles))
        return self.stated_deg + wrap_deg(measured - self.stated_deg)

    @cached_property
    def sigma_angles_deg(self) -> np.ndarray:
        """Their standard deviations; 0 for the held one."""
        return np.degrees(np.sqrt(np.diag(np.asarray(self.solved.covariance))[4:]))

    @cached_property
    def steps(self) -> Steps:
        """How the measured angles follow the stated ones."""
        return steps(self.stated_deg, self.angles_deg, self.held, self.sigma_angles_deg)

    @property
    def sigma_distance(self) -> float:
        """Standard deviation of the distance [unit]."""
        return float(np.sqrt(np.asarray(self.solved.covariance)[3, 3]))

    @cached_property
    def photo_rms_px(self) -> np.ndarray:
        """RMS residual length of each photo [px]."""
        return np.sqrt(np.mean(np.sum(np.asarray(self.solved.residual) ** 2, axis=-1), axis=1))

    @property
    def rms_px(self) -> float:
        """Root of the mean squared residual length per corner [px]."""
        return float(np.sqrt(np.mean(self.photo_rms_px**2)))

    def file(self) -> TurntableFile:
        """The turntable as its file holds it."""
        t, axis = self.solved.turntable, self.axis
        return TurntableFile(
            rotation=tuple(float(x) for x in t.rotvec),  # pyright: ignore[reportArgumentType]
            distance=float(t.distance),
            height=float(t.height),
            unit=self.unit,
            covariance=np.asarray(self.solved.covariance)[:4, :4],
            axis={  # pyright: ignore[reportArgumentType]
                name: tuple(float(x) for x in getattr(axis, name))
                for name in ("point", "direction", "sigma_point", "sigma_direction")
            },
            angles_deg=self._by_photo(self.angles_deg),
            sigma_angles_deg=self._by_photo(self.sigma_angles_deg),
            error=self.rms_px,
            held=HELD,
            inputs=self.inputs,
            settings={"board": self.board},
        )

    def text(self) -> str:
        """The turntable file."""
        return turntable_text(self.file())

    def _by_photo(self, values: np.ndarray) -> dict[str, float]:
        return {name: float(value) for name, value in zip(self.names, values)}

    def to_dict(self) -> dict[str, Any]:
        """What `json` writes."""
        axis, turn = self.axis, np.degrees(self.axis.deviation)
        sigma_turn = np.degrees(self.axis.sigma_deviation)
        return {
            "jaxmocap": version("jaxmocap"),
            "command": self.command,
            "success": True,
            "message": self.solved.estimate.sentence,
            "unit": self.unit,
            "seed": None,
            "warnings": [w.sentence for w in self.weaknesses] + list(self.notes),
            "weaknesses": [asdict(w) for w in self.weaknesses],
            "rms_px": self.rms_px,
            "views_used": len(self.names),
            "observations_used": int(np.prod(np.shape(self.solved.residual)[:2])),
            "observations_rejected": 0,
            "frozen": list(HELD),
            "axis": {
                "point": axis.point,
                "direction": axis.direction,
                "sigma_point": axis.sigma_point,
                "sigma_direction": axis.sigma_direction,
            },
            "distance": float(self.solved.turntable.distance),
            "sigma_distance": self.sigma_distance,
            "height": float(self.solved.turntable.height),
            "rotation": np.asarray(self.solved.turntable.rotvec),
            "angles_deg": self._by_photo(self.angles_deg),
            "sigma_angles_deg": self._by_photo(self.sigma_angles_deg),
            "build": {
                "lean_in_depth_deg": turn[0],
                "camera_turned_aside_deg": turn[1],
                "lean_in_picture_deg": turn[2],
                "sigma_deg": sigma_turn,
                "mean_step_factor": self.steps.mean_factor,
                "sigma_mean_step_factor": self.steps.sigma_mean_factor,
                "step_spread_deg": self.steps.spread_deg,
                "deviation_deg": self._by_photo(self.steps.deviation_deg),
            },
            "skipped": dict(self.skipped),
        }

    def json(self, extra: Mapping[str, Any] | None = None) -> bytes:
        """The machine-readable result (see the conventions in the README)."""
        return json_bytes({**self.to_dict(), **(extra or {})})

    def html(self) -> str:
        """The report, one self-contained page."""
        return turntable_html(self._report())

    def summary(self) -> str:
        """The plain text that the command line prints."""
        return turntable_summary(self._report())

    def _report(self) -> TurntableReport:
        turn = self.solved.turntable
        names = ("x", "y", "z")
        axis = [
            ParameterRow(f"{what} {name}", float(value), float(sigma), unit)
            for what, values, sigmas, unit in (
                ("point", self.axis.point, self.axis.sigma_point, self.unit),
                ("direction", self.axis.direction, self.axis.sigma_direction, "1"),
            )
            for name, value, sigma in zip(names, values, sigmas)
        ]
        axis.append(ParameterRow("distance", float(turn.distance), self.sigma_distance, self.unit))
        axis.append(ParameterRow("height", float(turn.height), None, self.unit, frozen=True))
        return TurntableReport(
            command=self.command,
            board=self.board,
            rms_px=self.rms_px,
            unit=self.unit,
            axis=tuple(axis),
            build=self._build_rows(),
            angles=tuple(
                AngleRow(*row)
                for row in zip(
                    self.names, self.stated_deg.tolist(), self.angles_deg.tolist(), self.sigma_angles_deg.tolist(),
                    self.steps.deviation_deg.tolist(), self.photo_rms_px.tolist(),
                )
            ),
            free=(
                f"The height of the origin on the axis is free and was put {float(turn.height):g} below the camera.",
                f"The zero of the angles is free: {self.names[self.held]} keeps its stated angle.",
            ),
            warnings=self.weaknesses,
            notes=self.notes,
            skipped=self.skipped,
            provenance={"jaxmocap": version("jaxmocap"), **self.inputs},
        )  # fmt: skip

    def _build_rows(self) -> tuple[ParameterRow, ...]:
        turn, sigma = np.degrees(self.axis.deviation), np.degrees(self.axis.sigma_deviation)
        words = ("axis leans in depth", "camera turned aside", "axis leans in picture")
        rows = [ParameterRow(word, float(v), float(s), "deg") for word, v, s in zip(words, turn, sigma)]
        found = self.steps
        if found.mean_factor is not None:
            rows.append(ParameterRow("mean step / stated", found.mean_factor, found.sigma_mean_factor, "1"))
            rows.append(ParameterRow("spread of the steps", float(found.spread_deg or 0.0), None, "deg"))
        return tuple(rows)

    def __repr__(self) -> str:
        return self.summary()
