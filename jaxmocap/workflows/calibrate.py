"""Calibrations from photographs and from points: read, detect, solve, result. No formula."""

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np

from jaxmocap._arrays import require_x64
from jaxmocap._errors import InputError
from jaxmocap.calibration.boards import MODELS, DistortionModel
from jaxmocap.io import hash_files, read_correspondences
from jaxmocap.vision import BoardDetections, consistent_order, detect_boards, expand_photos, read_photo
from jaxmocap.workflows.board import parse_board
from jaxmocap.workflows.calibration_result import CalibrationResult, Settings
from jaxmocap.workflows.target_solve import PairingError, SolvedTargets, make_views, solve_targets
from jaxmocap.workflows.units import parse_length, parse_sizes

Progress = Callable[[int, int], None]
Photos = str | Path | Sequence[str | Path]


def _listed(photos: Photos) -> list[str | Path]:
    return [photos] if isinstance(photos, (str, Path)) else list(photos)


def _check_model(distortion: str) -> DistortionModel:
    if distortion not in MODELS:
        raise InputError(f"--distortion: expected one of {', '.join(MODELS)}, got {distortion!r}")
    return cast(DistortionModel, distortion)


def _not_found(detected: BoardDetections) -> tuple[tuple[str, str], ...]:
    return tuple((name, "the whole board was not found") for name, ok in zip(detected.names, detected.found) if not ok)


def _poseless(solved: SolvedTargets, names: Sequence[tuple[str | None, ...]]) -> tuple[tuple[str, str], ...]:
    reason = "fewer than 4 points, or all on a line: the target has no pose"
    return tuple((names[v][k] or f"view {v}", reason) for v, k in solved.dropped)


def _loader(paths: list[dict[str, Path]], names: list[tuple[str | None, ...]]) -> Callable[[int, int], np.ndarray]:
    def load(view: int, camera: int) -> np.ndarray:
        return read_photo(paths[camera][cast(str, names[view][camera])]).grey

    return load


def calibrate_chessboard(
    photos: Photos,
    board: str | tuple[int, int],
    square: str | float,
    *,
    distortion: str = "k1k2",
    skew: bool = False,
    robust: bool = False,
    name: str = "cam1",
    command: str = "calibrate chessboard",
    progress: Progress | None = None,
) -> CalibrationResult:
    """Calibrate one camera from photographs of a chessboard.

    Args:
        photos: files, folders or glob patterns; the result does not depend on their order.
        board: INNER corners, "9x6" or (9, 6): columns x rows.
        square: side of a square with its unit, "30mm"; a bare number has no unit.
        distortion: "none", "k1k2", "k1k2k3" or "k1k2p1p2k3".
        skew: also seek K[0][1].
        robust: Cauchy loss instead of plain least squares.
        name: of the camera in files.
        command: recorded in files.
        progress: called with photos done and their number.

    Returns:
        CalibrationResult.

    Raises:
        InputError: photos or options are wrong; the sentence says which and what to do.
        SolveError: the photos cannot be solved.
    Source: optical tracking document, algorithm 3; stop-motion document, chapter 4.
    """
    require_x64("A calibration")
    model = _check_model(distortion)
    target = parse_board(board, square)
    files = _listed(photos)
    detected = detect_boards(files, target.corners, progress=progress)
    keep = np.flatnonzero(detected.found)
    seen = np.ones((len(keep), 1, len(target.points)), bool)
    views = make_views(np.tile(target.points, (len(keep), 1, 1)), detected.uv[keep][:, None], seen)
    sizes = [detected.image_size]
    solved = solve_targets(views, [name], sizes, distortion=model, skew=skew, robust=robust)
    names: list[tuple[str | None, ...]] = [(detected.names[i],) for i in keep]
    return _result(
        solved,
        [name],
        sizes,
        names,
        Settings(
            command=command,
            unit=target.unit,
            board=target.spoken,
            square=target.square,
            distortion=distortion,
            skew=skew,
            robust=robust,
            inputs=dict(zip(detected.names, detected.sha256)),
        ),
        skipped=_not_found(detected),
        notes=detected.warnings,
        load_grey=_loader([{p.name: p for p in expand_photos(files)}], names),
    )


def _result(
    solved: SolvedTargets,
    cameras: Sequence[str],
    sizes: Sequence[tuple[int, int]],
    view_names: Sequence[tuple[str | None, ...]],
    settings: Settings,
    *,
    skipped: Sequence[tuple[str, str]] = (),
    notes: Sequence[str] = (),
    load_grey: Callable[[int, int], np.ndarray] | None = None,
) -> CalibrationResult:
    """What was solved, with what is known of where it came from."""
    return CalibrationResult(
        estimate=solved.estimate,
        views=solved.views,
        free=solved.free,
        frozen=solved.frozen,
        cameras=tuple(cameras),
        image_sizes=tuple(sizes),
        view_names=tuple(view_names),
        settings=settings,
        skipped=(*skipped, *_poseless(solved, view_names)),
        notes=tuple(notes),
        load_grey=load_grey,
    )


def _number(name: str) -> int | None:
    """Last number in a file name, without its extension."""
    found = re.findall(r"[0-9]+", Path(name).stem)
    return int(found[-1]) if found else None


def pair_photos(left: Sequence[str], right: Sequence[str]) -> tuple[list[tuple[int, int]], list[str], bool]:
    """Pairs of photos taken at once: by the last number in the file names, else by order.

    Args:
        left: names of the first camera's photos.
        right: names of the second camera's.

    Returns:
        pairs of indices; names that have no partner; whether numbers paired them.

    Raises:
        InputError: if no pair can be formed.
    """
    a, b = [_number(n) for n in left], [_number(n) for n in right]
    by_number = None not in a and None not in b and len(set(a)) == len(a) and len(set(b)) == len(b)
    if by_number:
        place = {n: j for j, n in enumerate(b)}
        pairs = [(i, place[n]) for i, n in enumerate(a) if n in place]
    else:
        pairs = [(i, i) for i in range(min(len(left), len(right)))]
    lone = [n for i, n in enumerate(left) if i not in {p[0] for p in pairs}]
    lone += [n for j, n in enumerate(right) if j not in {p[1] for p in pairs}]
    if not pairs:
        raise InputError(
            "No left and right photo belong together: the last numbers in their names never agree "
            f"(left {', '.join(left[:3])}...; right {', '.join(right[:3])}...). Number pairs alike."
        )
    return pairs, lone, by_number


def calibrate_stereo(
    left: Photos,
    right: Photos,
    board: str | tuple[int, int],
    square: str | float,
    *,
    distortion: str = "k1k2",
    skew: bool = False,
    robust: bool = False,
    names: tuple[str, str] = ("left", "right"),
    command: str = "calibrate stereo",
    progress: Progress | None = None,
) -> CalibrationResult:
    """Calibrate two cameras and their relative pose from photographs of a chessboard, all in one refinement.

    Args:
        left: photos of the first camera, which is the rig's frame.
        right: photos of the second; pairs match by the last number in the file name, else by order. A photo whose
            partner does not show the board still counts for its own camera.
        board: as `calibrate_chessboard`.
        square: as `calibrate_chessboard`.
        distortion: as `calibrate_chessboard`, for both lenses.
        skew: also seek both skews.
        robust: Cauchy loss instead of plain least squares.
        names: of the cameras in files.
        command: recorded in files.
        progress: called with photos done and their number.

    Returns:
        CalibrationResult with two cameras; `T_camera_rig` of the second is the stereo pose.

    Raises:
        InputError: photos or options are wrong.
        SolveError: the photos cannot be solved, or the cameras never see the board at once.
    Source: optical tracking document, 4.5 and algorithm 3.
    """
    require_x64("A calibration")
    model = _check_model(distortion)
    target = parse_board(board, square)
    files = [_listed(left), _listed(right)]
    seen = [detect_boards(f, target.corners, progress=progress) for f in files]
    both = set(seen[0].sha256) & set(seen[1].sha256)
    if both:
        twice = [n for n, h in zip(seen[0].names, seen[0].sha256) if h in both]
        raise InputError(
            f"{', '.join(twice[:3])}: the same photo was given for both cameras. Give each camera its own."
        )
    pairs, lone, by_number = pair_photos(seen[0].names, seen[1].names)
    rows_of = [(i, j) for i, j in pairs if seen[0].found[i] or seen[1].found[j]]
    view_names: list[tuple[str | None, ...]] = [(seen[0].names[i], seen[1].names[j]) for i, j in rows_of]
    uv = np.stack([np.stack([seen[0].uv[i], seen[1].uv[j]]) for i, j in rows_of])
    found = np.stack([np.array([seen[0].found[i], seen[1].found[j]]) for i, j in rows_of])
    for v in np.flatnonzero(found.all(axis=1)):
        uv[v, 1] = consistent_order(uv[v, 0], uv[v, 1], target.corners)
    visible = np.repeat(found[:, :, None], len(target.points), axis=2)
    views = make_views(np.tile(target.points, (len(uv), 1, 1)), uv, visible)
    sizes = [d.image_size for d in seen]
    try:
        solved = solve_targets(
            views, list(names), sizes, distortion=model, skew=skew, robust=robust, view_names=view_names
        )
    except PairingError as error:
        if by_number:
            raise
        raise InputError(
            f"{error} The photos were paired in the order of their names, since these hold no numbers that tell them "
            "apart; number pairs alike, left_01 and right_01."
        ) from error
    inputs = {f"{camera}/{n}": h for camera, d in zip(names, seen) for n, h in zip(d.names, d.sha256)}
    paths = [{p.name: p for p in expand_photos(f)} for f in files]
    return _result(
        solved,
        names,
        sizes,
        view_names,
        Settings(
            command=command,
            unit=target.unit,
            board=target.spoken,
            square=target.square,
            distortion=distortion,
            skew=skew,
            robust=robust,
            inputs=inputs,
        ),
        skipped=[*_not_found(seen[0]), *_not_found(seen[1]), *((n, "it has no partner") for n in lone)],
        notes=[*seen[0].warnings, *seen[1].warnings],
        load_grey=_loader(paths, view_names),
    )


def calibrate_points(
    correspondences: str | Path,
    size: str | Sequence[str],
    *,
    unit: str = "1",
    distortion: str = "k1k2",
    skew: bool = False,
    robust: bool = False,
    command: str = "calibrate points",
) -> CalibrationResult:
    """Calibrate cameras from known points found elsewhere, on flat targets or others.

    Args:
        correspondences: CSV `view,x,y,z,u,v[,sigma][,camera]`: points in the target's frame and raw pixels.
        size: image size "640x480"; where cameras differ, entries "cam3=1280x720".
        unit: of x, y, z ("mm"); "1": none.
        distortion: as `calibrate_chessboard`.
        skew: also seek K[0][1].
        robust: Cauchy loss instead of plain least squares.
        command: recorded in files.

    Returns:
        CalibrationResult, one camera for each name in the file ("cam1" where it has none).

    Raises:
        InputError: the file or options are wrong.
        SolveError: the points cannot be solved.
    Source: optical tracking document, algorithms 1-3.
    """
    require_x64("A calibration")
    model = _check_model(distortion)
    if unit != "1":
        parse_length(f"1{unit}", "--unit")
    table = read_correspondences(correspondences)
    cameras = list(table.camera_labels) or ["cam1"]
    sizes = parse_sizes([size] if isinstance(size, str) else list(size), cameras)
    notes = list(table.warnings) + _outside(table.uv, table.camera, cameras, sizes)
    names: list[tuple[str | None, ...]] = [(f"view {label}",) * len(cameras) for label in table.view_labels]
    points, uv, visible, sigma = _by_view(table.view, table.camera, table.xyz, table.uv, table.sigma, cameras)
    views = make_views(points, uv, visible, sigma)
    solved = solve_targets(views, cameras, sizes, distortion=model, skew=skew, robust=robust, view_names=names)
    settings = Settings(
        command=command,
        unit=unit,
        distortion=distortion,
        skew=skew,
        robust=robust,
        inputs=hash_files([correspondences]),
    )
    return _result(solved, cameras, sizes, names, settings, notes=notes)


def _outside(uv: np.ndarray, camera: np.ndarray | None, cameras: list[str], sizes: list[tuple[int, int]]) -> list[str]:
    """Sentences about pixels that lie outside their image."""
    which = np.zeros(len(uv), int) if camera is None else camera
    out = []
    for k, (name, (width, height)) in enumerate(zip(cameras, sizes)):
        p = uv[which == k]
        n = int(np.sum((p < -0.5) | (p > np.array([width - 0.5, height - 0.5])), axis=None))
        if n:
            out.append(f"{name}: {n} coordinates lie outside the {width}x{height} image; is --size right?")
    return out


def _by_view(
    view: np.ndarray,
    camera: np.ndarray | None,
    xyz: np.ndarray,
    uv: np.ndarray,
    sigma: np.ndarray | None,
    cameras: list[str],
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None]:
    """Rows as (views, cameras, points) arrays; a point is the same if its coordinates are, within one view."""
    which = np.zeros(len(uv), int) if camera is None else camera
    views = int(view.max()) + 1
    slots: list[dict[tuple[float, ...], int]] = [{} for _ in range(views)]
    place = np.array([slots[v].setdefault(tuple(p), len(slots[v])) for v, p in zip(view, xyz.tolist())])
    most = max(len(s) for s in slots)
    points = np.zeros((views, most, 3))
    seen_uv, seen = np.zeros((views, len(cameras), most, 2)), np.zeros((views, len(cameras), most), bool)
    all_sigma = np.ones(seen.shape)
    for row, (v, k, p) in enumerate(zip(view, which, place)):
        if seen[v, k, p]:
            raise InputError(
                f"correspondences: point {tuple(xyz[row].tolist())} of view {v} is given twice for camera "
                f"{cameras[k]}. "
                "Likely cause: two photos share one view number. Number the views apart."
            )
        points[v, p], seen_uv[v, k, p], seen[v, k, p] = xyz[row], uv[row], True
        if sigma is not None:
            all_sigma[v, k, p] = sigma[row]
    return points, seen_uv, seen, None if sigma is None else all_sigma


def demo_photos() -> tuple[Path, dict[str, Any]]:
    """Folder of the bundled chessboard photographs, and what is known of them (board, square, true camera)."""
    import json

    folder = Path(__file__).parent.parent / "assets" / "chessboard"
    return folder, json.loads((folder / "truth.json").read_text(encoding="utf-8"))
