"""From photographs of a chessboard on the turntable to the turntable: detect, start, solve, check. No formula."""

import re
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxmocap._arrays import require_x64
from jaxmocap._errors import InputError, SolveError
from jaxmocap.calibration.boards import LENS_NAMES, Lens, chessboard_points
from jaxmocap.calibration.evidence import Weakness
from jaxmocap.calibration.turntable import BoardPhotos, TurntableEstimate, solve_board
from jaxmocap.calibration.turntable_checks import check_angles, missing_angles, turned_the_other_way, wrap_deg
from jaxmocap.calibration.turntable_start import start_board
from jaxmocap.cameras.turntable import DOCUMENT_HEIGHT
from jaxmocap.io import NamedCamera, RigFile, hash_files, read_rig
from jaxmocap.io.length_units import unit_factor
from jaxmocap.observations import PixelObservations
from jaxmocap.optim import ArrowVariables
from jaxmocap.vision import BoardDetections, consistent_order, detect_boards
from jaxmocap.workflows.calibrate import Photos, Progress
from jaxmocap.workflows.turntable_result import TurntableResult
from jaxmocap.workflows.units import parse_length, parse_pair

_PHOTOS = 12
"""Photos are padded to a multiple: one compiled program for a turn of up to 30-degree steps."""


def calibrate_turntable(
    camera: str | Path,
    photos: Photos,
    board: str | tuple[int, int],
    square: str | float,
    *,
    height: str | float | None = None,
    command: str = "calibrate turntable",
    progress: Progress | None = None,
) -> TurntableResult:
    """The turntable's axis, and the angle of every photo, from a chessboard standing on it.

    Args:
        camera: rig file of the one camera, as `calibrate chessboard` writes it.
        photos: files, folders or patterns, named *_<angle in degrees>.jpg. Photos that show the board's back or edge
            are not used.
        board: INNER corners, "9x6" or (9, 6).
        square: side of a square with its unit.
        height: of the camera above the origin of the world, with its unit; None: 80 mm.
        command: recorded in files.
        progress: called with photos done and their number.

    Returns:
        TurntableResult.

    Raises:
        InputError: files, photos or options are wrong.
        SolveError: the photos cannot be solved; the turntable did not turn, turned the other way, or it was the camera
            that turned.
    Source: stop-motion document, 4.2.
    """
    require_x64("A calibration")
    columns, rows = parse_pair(board, "--board", "9x6")
    side, unit = parse_length(square, "--square")
    points = chessboard_points(columns, rows, side)
    height_here, notes = _height(height, unit)
    rig = read_rig(camera)
    lens, covariance_lens, more = lens_of(rig, str(camera))
    notes += more
    files = [photos] if isinstance(photos, str | Path) else list(photos)
    detected = detect_boards(files, (columns, rows), progress=progress)
    if detected.image_size != rig.cameras[0].camera.image_size:
        raise InputError(
            f"photos: {detected.image_size[0]}x{detected.image_size[1]} px, but {camera} is of a camera with "
            f"{'x'.join(map(str, rig.cameras[0].camera.image_size))} px. Use photos of the camera that was calibrated, "
            "at the same size."
        )
    stated_all = np.array([stated_angle(name) for name in detected.names])
    seen = _views(detected, stated_all)
    solved = _solve(lens, covariance_lens, points, seen, height_here)
    return TurntableResult(
        solved=solved.estimate,
        names=seen.names,
        stated_deg=seen.stated_deg,
        held=seen.held,
        unit=unit,
        board=f"{columns}x{rows} inner corners, squares of {side:g}{'' if unit == '1' else ' ' + unit}",
        command=command,
        inputs={**hash_files([camera]), **dict(zip(detected.names, detected.sha256))},
        weaknesses=tuple(_weaknesses(solved, seen)),
        notes=tuple(notes) + _said_of_photos(detected, stated_all),
        skipped=tuple(
            (name, "the board was not found: its back or edge, or not wholly in the picture")
            for name, ok in zip(detected.names, detected.found)
            if not ok
        ),
    )


def stated_angle(name: str) -> float:
    """Angle [degrees] in a photo's name: the number after the last underscore.

    Raises:
        InputError: if there is none.
    """
    match = re.search(r"_(-?[0-9]{1,6}(?:\.[0-9]{1,9})?)$", Path(name).stem)
    if not match:
        raise InputError(
            f"{name}: no angle in the name. Call photos of a turntable *_<angle>.jpg, for instance turntable_030.jpg."
        )
    return float(match[1])


def lens_of(rig: RigFile, path: str) -> tuple[Lens, np.ndarray, list[str]]:
    """Lens of a rig of one camera, its covariance (10, 10) in the order of `LENS_NAMES`, sentences to say.

    Raises:
        InputError: if the rig has several cameras.
    """
    if len(rig.cameras) != 1:
        raise InputError(
            f"{path}: holds {len(rig.cameras)} cameras ({', '.join(c.name for c in rig.cameras)}); one is needed. "
            "Give the file of that camera."
        )
    named = rig.cameras[0]
    lens = Lens(named.camera.intrinsics, named.camera.distortion)
    stored = _stored_covariance(rig, named)
    if stored is not None:
        return lens, stored, []
    sigmas = rig.sigmas.get(named.name, {})
    covariance = np.diag([float(sigmas.get(name, 0.0)) ** 2 for name in LENS_NAMES])
    if not covariance.any():
        return lens, covariance, [f"{path} states no sigmas: what the camera adds to the uncertainty is left out."]
    return lens, covariance, [f"{path} states sigmas but no covariance: its errors are taken as independent."]


def _stored_covariance(rig: RigFile, named: NamedCamera) -> np.ndarray | None:
    """Covariance of the lens as `calibrate` records it in the settings of the rig; None if it is not there or odd."""
    table = rig.settings.get("covariance", {})
    entry = table.get(named.name, {}) if isinstance(table, dict) else {}
    names, matrix = (entry.get(key) for key in ("names", "matrix")) if isinstance(entry, dict) else (None, None)
    try:
        index = [LENS_NAMES.index(name) for name in names or ()]
        C = np.array(matrix, dtype=float)
    except (TypeError, ValueError):
        return None
    if not index or C.shape != (len(index), len(index)) or not np.isfinite(C).all():
        return None
    out = np.zeros((len(LENS_NAMES), len(LENS_NAMES)))
    out[np.ix_(index, index)] = 0.5 * (C + C.T)
    return out if np.linalg.eigvalsh(out).min() >= -1e-9 * np.abs(C).max() else None


class _Seen(NamedTuple):
    """The photos in which the board was found."""

    names: tuple[str, ...]
    stated_deg: np.ndarray
    uv: np.ndarray
    held: int


class _Solved(NamedTuple):
    estimate: TurntableEstimate
    own_rms: np.ndarray
    """RMS of each photo with a board pose of its own [px]."""


def _views(detected: BoardDetections, stated: np.ndarray) -> _Seen:
    found = np.flatnonzero(detected.found)
    if len(found) < 2:
        raise SolveError(
            f"The board was found in 1 of {len(detected.names)} photos ({detected.names[found[0]]}): an axis needs two "
            "angles, and three to check them. Turn the board's front to the camera in more photos."
        )
    first = detected.uv[found[0]]
    uv = np.stack([consistent_order(first, detected.uv[i], detected.columns_rows) for i in found])
    held = int(np.argmin(np.abs(wrap_deg(stated[found]))))
    return _Seen(tuple(detected.names[i] for i in found), stated[found], uv, held)


def _solve(lens: Lens, covariance_lens: np.ndarray, points: np.ndarray, seen: _Seen, height: float) -> _Solved:
    n = len(seen.names)
    size = -(-n // _PHOTOS) * _PHOTOS
    stated = np.radians(seen.stated_deg)
    start, own_rms = start_board(lens, points, seen.uv, stated, seen.held, height)
    _refuse_wrong_way(seen, np.degrees(np.asarray(start.local)))

    def pad(x: Any) -> jnp.ndarray:
        x = np.asarray(x)
        return jnp.asarray(np.concatenate([x, np.repeat(x[-1:], size - n, axis=0)]))

    real = np.arange(size) < n
    photos = BoardPhotos(PixelObservations.of(pad(seen.uv)), pad(stated), jnp.asarray(np.arange(size) == seen.held))
    padded = ArrowVariables(start.shared, pad(start.local))
    weight = jnp.asarray(real.astype(float))
    estimate = solve_board(padded, photos, jnp.asarray(points), weight, jnp.asarray(covariance_lens))
    if not estimate.estimate.success:
        raise SolveError(f"The turntable could not be solved. {estimate.estimate.sentence}")
    keep = np.concatenate([np.arange(4), 4 + np.flatnonzero(real)])
    return _Solved(
        estimate._replace(
            angles=estimate.angles[:n],
            residual=estimate.residual[:n],
            covariance=estimate.covariance[np.ix_(keep, keep)],
            covariance_data=estimate.covariance_data[np.ix_(keep, keep)],
        ),
        own_rms,
    )


def _refuse_wrong_way(seen: _Seen, measured_deg: np.ndarray) -> None:
    if turned_the_other_way(seen.stated_deg, measured_deg):
        worst = int(np.argmax(np.abs(wrap_deg(measured_deg - seen.stated_deg))))
        raise SolveError(
            "The turntable turned the other way: clockwise seen from above, while the angles in the names grow "
            f"({seen.names[worst]} was measured at {wrap_deg(measured_deg[worst]):.1f} degrees). Angles count "
            "anticlockwise seen from above, so that the puppet's front moves to the right of the picture: rename the "
            "photos to 360 minus their angle, or turn the other way. A camera hung upside down does the same."
        )


def _weaknesses(solved: _Solved, seen: _Seen) -> list[Weakness]:
    estimate = solved.estimate
    sigma = np.sqrt(np.diag(np.asarray(estimate.covariance)))
    found = check_angles(
        seen.names, seen.stated_deg, np.degrees(np.asarray(estimate.angles)), np.degrees(sigma[4:]), seen.held
    )
    found += _moved(estimate, solved.own_rms, seen)
    if len(seen.names) == 2:
        found.append(
            Weakness(
                "two-photos",
                "warning",
                "Only two photos show the board, so nothing checks the axis.",
                "Take three or more that show its front.",
            )
        )
    distance = float(estimate.turntable.distance)
    if sigma[3] > 0.01 * distance or sigma[:3].max() > 0.01:
        found.append(
            Weakness(
                "weak-axis",
                "warning",
                f"The axis is known to {100 * sigma[3] / distance:.2g} % of its distance and "
                f"{np.degrees(sigma[:3].max()):.2g} degrees, which is 1 mm or more at a bead 100 mm from it.",
                "Take photos over a wider turn, with the board larger in the picture, or calibrate the camera better.",
            )
        )
    return found


def _moved(estimate: TurntableEstimate, own_rms: np.ndarray, seen: _Seen) -> list[Weakness]:
    """Whether the board stood still on a turntable that has one axis: else the common fit is worse than single ones."""
    rms = np.sqrt(np.mean(np.sum(np.asarray(estimate.residual) ** 2, axis=-1), axis=1))
    total, own = np.sqrt(np.mean(rms**2)), np.sqrt(np.mean(own_rms**2))
    # Twice the RMS: what no single pose explains is then larger than all errors of the corners together.
    if total <= 2.0 * own:
        return []
    worst = int(np.argmax(rms))
    return [
        Weakness(
            "moved",
            "serious" if total > 10.0 * own else "warning",
            f"One axis explains the photos only to {total:.2f} px where each by itself is explained to {own:.2f} px, "
            f"{seen.names[worst]} worst ({rms[worst]:.2f} px): board or camera moved, or the turntable wobbles.",
            "Fix the board to the turntable and the camera to its stand, and take the photos again.",
        )
    ]


def _height(height: str | float | None, unit: str) -> tuple[float, list[str]]:
    """Height in the unit of the square, and what is to be said if nobody gave one."""
    if height is None:
        value = DOCUMENT_HEIGHT if unit == "1" else DOCUMENT_HEIGHT * unit_factor("mm", unit, "--height")
        said = f"{value:g}" if unit == "1" else f"{value:g} {unit}"
        return value, [f"--height was not given: the origin lies {said} below the camera, as in the document's build."]
    value, own = parse_length(height, "--height")
    return value * unit_factor(own, unit, "--height"), []


def _said_of_photos(detected: BoardDetections, stated: np.ndarray) -> tuple[str, ...]:
    """Warnings of the detection that are not about the back of the board, and angles left out."""
    said = [text for text in detected.warnings if not text.startswith("no whole ")]
    missing = missing_angles(stated)
    if missing:
        said.append(f"No photo at {', '.join(f'{a:g}' for a in missing)} degrees, where the others have their steps.")
    return tuple(said)
