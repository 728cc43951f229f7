"""What a calibration gives its user: an object that shows itself, saves itself and can be computed with."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxmocap.calibration.boards import LENS_NAMES, POSE_NAMES, TargetViews, parameter_names
from jaxmocap.calibration.describe import RigDescription, describe
from jaxmocap.calibration.evidence import CameraEvidence, Weakness, board_attitude, real_radius_px
from jaxmocap.calibration.start import plane_frames
from jaxmocap.calibration.weakness import find_weaknesses
from jaxmocap.cameras import Camera
from jaxmocap.geometry import Pose
from jaxmocap.io import NamedCamera, RigFile, json_bytes, rig_text, write_many
from jaxmocap.optim import ArrowVariables
from jaxmocap.optim.robust import weight as robust_weight
from jaxmocap.report import (
    CalibrationReport,
    CameraReport,
    ParameterRow,
    ViewReport,
    calibration_html,
    card_html,
    summary_text,
)
from jaxmocap.results import Estimate

_UNITS = {**dict.fromkeys(("fx", "fy", "cx", "cy", "skew"), "px"), **dict.fromkeys(("rx", "ry", "rz"), "rad")}
# A robust weight below this counts as a rejection in the tables: the observation had less than a quarter of a say.
_REJECTED_BELOW = 0.25


@dataclass(frozen=True)
class Settings:
    """What was asked for, and where it came from."""

    command: str
    unit: str = "1"
    board: str | None = None
    square: float | None = None
    distortion: str = "k1k2"
    skew: bool = False
    robust: bool = False
    inputs: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 by file name."""


@dataclass(frozen=True, repr=False)
class CalibrationResult:
    """A finished calibration: `result` shows it, `result.report(path)` writes the page, `result.save(path)` the rig.

    The covariance is `result.estimate.covariance`, a pytree of JAX arrays; `result.sigma` has the standard
    deviations by name.
    """

    estimate: Estimate
    views: TargetViews
    free: ArrowVariables
    frozen: tuple[tuple[str, ...], ...]
    cameras: tuple[str, ...]
    image_sizes: tuple[tuple[int, int], ...]
    view_names: tuple[tuple[str | None, ...], ...]
    """Per view and camera the photo's name; None where there is none."""
    settings: Settings
    skipped: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()
    load_grey: Callable[[int, int], np.ndarray] | None = None
    """Photo of a view and camera, for the pictures of the report."""
    truth: Mapping[str, float] = field(default_factory=dict)
    """True values of the first camera's parameters, where the photos are simulated; shown, never used."""

    # --- numbers -------------------------------------------------------------------------------------------------

    @cached_property
    def sigma(self) -> dict[str, dict[str, float]]:
        """Stated standard deviation of every free parameter, by camera and name."""
        return self._sigmas(np.asarray(self.estimate.covariance.shared()))

    @cached_property
    def sigma_plain(self) -> dict[str, dict[str, float]]:
        """The same for corners with errors of their own."""
        return self._sigmas(np.asarray(self.estimate.covariance.shared_plain()))

    def _sigmas(self, covariance: np.ndarray) -> dict[str, dict[str, float]]:
        out: dict[str, dict[str, float]] = {name: {} for name in self.cameras}
        for (camera, name), s in zip(parameter_names(self.free), np.sqrt(np.diag(covariance))):
            out[self.cameras[camera]][name] = float(s)
        return out

    @cached_property
    def numbers(self) -> RigDescription:
        """Residuals, poses and camera numbers as plain arrays."""
        return describe(self.estimate.value, self.views)

    @property
    def residual(self) -> np.ndarray:
        """Measured minus predicted pixels, (views, cameras, points, 2); zero where nothing was seen."""
        return self.numbers.residual

    @cached_property
    def visible(self) -> np.ndarray:
        """What was seen, (views, cameras, points)."""
        return np.asarray(self.views.seen.visible)

    @property
    def rms_px(self) -> float:
        """Root of the mean squared residual length per point that was not rejected [px]."""
        return self._rms(self.used)

    def _rms(self, mask: np.ndarray) -> float:
        squares = np.sum(self.residual**2, axis=-1)
        return float(np.sqrt(np.sum(squares[mask]) / max(int(mask.sum()), 1)))

    @cached_property
    def used(self) -> np.ndarray:
        """What was seen and not rejected: a robust fit gave it a quarter of a say or more."""
        if not self.settings.robust:
            return self.visible
        s = np.sum(self.residual**2, axis=-1) / np.asarray(self.views.seen.sigma) ** 2
        w = robust_weight("cauchy", s, self.estimate.stats["loss_width"])
        return self.visible & (np.asarray(w) >= _REJECTED_BELOW)

    @property
    def rejected(self) -> int:
        """Observations that a robust fit gave less than a quarter of a say."""
        return int(self.visible.sum() - self.used.sum())

    def camera(self, index: int = 0) -> Camera:
        """One calibrated camera; the world is the first camera."""
        lens = self.estimate.value.shared.lenses[index]
        pose = Pose(jnp.asarray(self.numbers.rotvec_camera_rig[index]), jnp.asarray(self.numbers.t_camera_rig[index]))
        return Camera(lens.intrinsics, lens.distortion, pose, self.image_sizes[index])

    # --- files ---------------------------------------------------------------------------------------------------

    def rig(self) -> RigFile:
        """The calibration as a rig file holds it."""
        return RigFile(
            cameras=tuple(NamedCamera(name, self.camera(k)) for k, name in enumerate(self.cameras)),
            unit=self.settings.unit,
            error=self.rms_px,
            sigmas=self.sigma,
            inputs=self.settings.inputs,
            settings={
                "distortion": self.settings.distortion,
                "skew": self.settings.skew,
                "robust": self.settings.robust,
                "target": self.settings.board or "points",
                "frozen": self.frozen_names(),
                "covariance": self._lens_covariances(),
            },
        )

    def _lens_covariances(self) -> dict[str, Any]:
        """Covariance of the free numbers of each lens: what is measured with the camera inherits its errors."""
        covariance = np.asarray(self.estimate.covariance.shared())
        out = {}
        for k, camera in enumerate(self.cameras):
            named = enumerate(parameter_names(self.free))
            columns = {n: i for i, (c, n) in named if c == k and n in LENS_NAMES}
            block = covariance[np.ix_(list(columns.values()), list(columns.values()))]
            if columns and np.isfinite(block).all():
                out[camera] = {"names": list(columns), "matrix": block.tolist()}
        return out

    def frozen_names(self) -> list[str]:
        """Parameters held because the data do not determine them; with the camera's name where there are several."""
        many = len(self.cameras) > 1
        return [f"{c}.{n}" if many else n for c, names in zip(self.cameras, self.frozen) for n in names]

    def save(self, path: str | Path) -> list[str]:
        """Write the rig file; returns sentences to say about it."""
        text, said = rig_text(self.rig())
        write_many({path: text.encode()})
        return said

    def report(self, path: str | Path) -> None:
        """Write the report, one self-contained HTML page."""
        write_many({path: self.html().encode()})

    def html(self) -> str:
        """The report as text."""
        return calibration_html(self._report_data(pictures=True))

    def summary(self) -> str:
        """The plain text that the command line prints."""
        return summary_text(self._report_data(pictures=False))

    def json(self, extra: Mapping[str, Any] | None = None) -> bytes:
        """The machine-readable result (see the conventions in the README)."""
        return json_bytes({**self.to_dict(), **(extra or {})})

    def to_dict(self) -> dict[str, Any]:
        """What `json` writes."""
        return {
            "jaxmocap": version("jaxmocap"),
            "command": self.settings.command,
            "success": True,
            "message": self.estimate.sentence,
            "unit": self.settings.unit,
            "seed": None,
            "warnings": [w.sentence for w in self.weaknesses] + list(self.notes),
            "weaknesses": [asdict(w) for w in self.weaknesses],
            "rms_px": self.rms_px,
            "views_used": int(self.visible.any(axis=(1, 2)).sum()),
            "observations_used": int(self.used.sum()),
            "observations_rejected": self.rejected,
            "frozen": self.frozen_names(),
            "cameras": [self._camera_dict(k) for k in range(len(self.cameras))],
            "skipped": dict(self.skipped),
            "design_effect": float(self.estimate.covariance.design_effect),
            "views": [
                {"name": v.name, "camera": self.cameras[v.camera], "rms_px": v.rms_px, "tilt_deg": v.tilt_deg,
                 "depth": v.depth}
                for v in self._views
            ],
        }  # fmt: skip

    def _camera_dict(self, k: int) -> dict[str, Any]:
        numbers = self._numbers(k)
        return {
            "name": self.cameras[k],
            "size": list(self.image_sizes[k]),
            **{n: numbers[n] for n in ("fx", "fy", "cx", "cy", "skew", "k1", "k2", "k3", "p1", "p2")},
            "rotation": self.numbers.rotvec_camera_rig[k].tolist(),
            "translation": self.numbers.t_camera_rig[k].tolist(),
            "sigma": self.sigma[self.cameras[k]],
            "sigma_plain": self.sigma_plain[self.cameras[k]],
            "rms_px": self._rms(self._mask(k)),
        }

    def _numbers(self, k: int) -> dict[str, float]:
        lens = self.estimate.value.shared.lenses[k]
        return {n: float(getattr(lens.intrinsics, n, getattr(lens.distortion, n, 0.0))) for n in LENS_NAMES}

    def _mask(self, k: int) -> np.ndarray:
        mask = np.zeros_like(self.used)
        mask[:, k] = self.used[:, k]
        return mask

    # --- what speaks against it, and the report ------------------------------------------------------------------

    @cached_property
    def weaknesses(self) -> tuple[Weakness, ...]:
        """Everything that speaks against the result, the most serious first."""
        found: list[Weakness] = []
        planar = bool(self._planes[1][self.visible.any(axis=1).sum(axis=1) >= 4].all())
        for k, name in enumerate(self.cameras):
            report = self._camera_report(k)
            found += find_weaknesses(
                CameraEvidence(
                    image_size=self.image_sizes[k],
                    K=report.K,
                    distortion=report.distortion,
                    views=[v for v in self._views if v.camera == k],
                    rms_px=report.rms_px,
                    sigma=self.sigma[name],
                    sigma_plain=self.sigma_plain[name],
                    valid_radius_px=report.valid_radius_px,
                    square=self.settings.square,
                    unit=self.settings.unit,
                    planar=planar,
                    label=name if len(self.cameras) > 1 else "",
                )
            )
        for name in self.frozen_names():
            found.append(
                Weakness(
                    "frozen",
                    "warning",
                    f"{name} is not determined by these data and was held at its start value.",
                    "Add views that tilt more and reach the image corners, or accept the fixed value.",
                )
            )
        rank = {"serious": 0, "warning": 1, "note": 2}
        return tuple(sorted(found, key=lambda w: rank[w.severity]))

    @cached_property
    def _planes(self) -> tuple[np.ndarray, np.ndarray]:
        return plane_frames(np.asarray(self.views.points), np.any(self.visible, axis=1))

    @cached_property
    def _views(self) -> tuple[ViewReport, ...]:
        out = []
        points = np.asarray(self.views.points)
        for i, names in enumerate(self.view_names):
            for k, name in enumerate(names):
                seen = self.visible[i, k]
                if seen.any():
                    out.append(self._view(i, k, name or f"view {i}", points[i][seen], seen))
        return tuple(out)

    def _view(self, i: int, k: int, name: str, points: np.ndarray, seen: np.ndarray) -> ViewReport:
        R, t = self.numbers.R_camera_target[i, k], self.numbers.t_camera_target[i, k]
        # The target's own plane need not be z = 0 of its frame.
        tilt, direction, depth = board_attitude(R @ self._planes[0][i, :3, :3], R @ points.mean(axis=0) + t)
        uv, residual = np.asarray(self.views.seen.uv)[i, k][seen], self.residual[i, k][seen]
        used = self.used[i, k][seen]
        rms = float(np.sqrt(np.mean(np.sum(residual[used] ** 2, axis=1)))) if used.any() else 0.0
        return ViewReport(name, k, uv, residual, rms, tilt, direction, depth)

    def _camera_report(self, k: int) -> CameraReport:
        K, d, limit = self.numbers.K[k], self.numbers.distortion[k], self.numbers.ideal_limit[k]
        named = enumerate(parameter_names(self.free))
        columns = [i for i, (camera, name) in named if camera == k and name in LENS_NAMES]
        covariance = np.asarray(self.estimate.covariance.shared())[np.ix_(columns, columns)]
        s = np.sqrt(np.diag(covariance))
        return CameraReport(
            name=self.cameras[k],
            image_size=self.image_sizes[k],
            parameters=tuple(self._row(k, n) for n in LENS_NAMES if self._shown(k, n)),
            K=K,
            distortion=d,
            rms_px=self._rms(self._mask(k)),
            correlation=covariance / np.outer(s, s),
            correlation_names=tuple(parameter_names(self.free)[i][1] for i in columns),
            valid_radius_px=float(real_radius_px(K, d, limit)) if np.isfinite(limit) else None,
        )

    def _shown(self, k: int, name: str) -> bool:
        return name in self.sigma[self.cameras[k]] or name in self.frozen[k] or self._numbers(k)[name] != 0.0

    def _row(self, k: int, name: str) -> ParameterRow:
        camera = self.cameras[k]
        return ParameterRow(
            name=name,
            value=self._numbers(k)[name],
            sigma=self.sigma[camera].get(name),
            unit=_UNITS.get(name, "1"),
            frozen=name not in self.sigma[camera],
            sigma_plain=self.sigma_plain[camera].get(name),
            truth=self.truth.get(name) if k == 0 else None,
        )

    def _pose_rows(self) -> tuple[ParameterRow, ...]:
        rows = []
        for k, camera in enumerate(self.cameras[1:], start=1):
            values = np.concatenate([self.numbers.rotvec_camera_rig[k], self.numbers.t_camera_rig[k]])
            for name, value in zip(POSE_NAMES, values):
                label = name if len(self.cameras) == 2 else f"{camera}.{name}"
                unit = _UNITS.get(name, self.settings.unit)
                rows.append(
                    ParameterRow(label, float(value), self.sigma[camera].get(name), unit,
                                 sigma_plain=self.sigma_plain[camera].get(name))
                )  # fmt: skip
        return tuple(rows)

    def _with_photos(self, views: tuple[ViewReport, ...], worst: int = 3) -> tuple[ViewReport, ...]:
        """The views with the photos of the worst ones attached."""
        if self.load_grey is None:
            return views
        index = {(name, k): i for i, names in enumerate(self.view_names) for k, name in enumerate(names)}
        order = sorted(range(len(views)), key=lambda j: -views[j].rms_px)
        order = [j for k in range(len(self.cameras)) for j in [j for j in order if views[j].camera == k][:worst]]
        out = list(views)
        for j in order:
            v = views[j]
            out[j] = replace(v, grey=self.load_grey(index[(v.name, v.camera)], v.camera))
        return tuple(out)

    def _report_data(self, pictures: bool) -> CalibrationReport:
        history = np.asarray(self.estimate.stats["cost_history"])
        return CalibrationReport(
            title="Camera calibration" if len(self.cameras) == 1 else f"Calibration of {len(self.cameras)} cameras",
            command=self.settings.command,
            rms_px=self.rms_px,
            cameras=tuple(self._camera_report(k) for k in range(len(self.cameras))),
            views=self._with_photos(self._views) if pictures else self._views,
            observations=int(self.used.sum()),
            unit=self.settings.unit,
            board=self.settings.board,
            rejected=self.rejected,
            stereo=self._pose_rows(),
            skipped=self.skipped,
            warnings=self.weaknesses,
            notes=self.notes,
            provenance={"jaxmocap": version("jaxmocap"), **self.settings.inputs},
            iterations=tuple(float(c) for c in history[np.isfinite(history)]),
        )

    def _repr_html_(self) -> str:
        return card_html(self._report_data(pictures=False))

    def __repr__(self) -> str:
        return self.summary()
