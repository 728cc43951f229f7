"""OpenCV's calibration files: one camera (sample calibration.cpp) or a stereo pair (stereo_calib.cpp)."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from jaxmocap._arrays import require_x64
from jaxmocap._errors import InputError
from jaxmocap.cameras import Camera
from jaxmocap.geometry import rotation
from jaxmocap.io.atomic import write_text
from jaxmocap.io.camera_numbers import (
    NamedCamera,
    assemble,
    check_names,
    intrinsics_from_matrix,
    lens_from_numbers,
    plain_camera,
    rotvec_from_numbers,
    size_from_numbers,
    translation_from_numbers,
)
from jaxmocap.io.opencv_text import Entry, matrix_text, read_entries

# Keys are compared in small letters without underscores; {n} is empty for one camera, 1 or 2 in a pair.
_MATRIX = ("cameramatrix{n}", "k{n}", "m{n}", "intrinsics{n}")
_LENS = ("distortioncoefficients{n}", "distcoeffs{n}", "distcoeff{n}", "distortion{n}", "d{n}")
_ROTATION, _TRANSLATION = ("r", "rvec", "rotation"), ("t", "tvec", "translation")
_FISHEYE_MODELS = ("equidistant", "fisheye", "kannala_brandt")


def read_opencv_yaml(
    path: str | Path, image_size: tuple[int, int] | None = None, extrinsics: str | Path | None = None
) -> list[NamedCamera]:
    """Read one camera or a stereo pair that a program of OpenCV wrote with FileStorage (or ROS as camera_info).

    One camera has camera_matrix (or K) and distortion_coefficients (or D), and may have R or rvec, T or tvec
    (world -> camera). A pair has M1 D1 M2 D2 (or the long names with 1 and 2), and R, T from the first camera to the
    second; its cameras are called left and right, and the world is the first camera.

    Args:
        path: the file.
        image_size: (width, height) [px], for files that do not say, as those of stereo_calib.cpp.
        extrinsics: file with R and T, for programs that write them apart (intrinsics.yml, extrinsics.yml).

    Returns:
        The cameras; one camera is called by its camera_name or else by the name of the file. What is odd about each
        stands in its `warnings`.

    Raises:
        InputError: naming line and key of what is missing, damaged or impossible; for a fisheye lens; if JAX is not
            in 64-bit mode.
    Source: OpenCV samples/cpp/tutorial_code/calib3d/camera_calibration and samples/cpp/stereo_calib.cpp.
    """
    require_x64("reading a calibration")
    entries = _by_plain_name(read_entries(path))
    _refuse_fisheye(entries)
    size = image_size or _size(path, entries)
    apart = _by_plain_name(read_entries(extrinsics)) if extrinsics else entries
    if _find(entries, _MATRIX, "1"):
        poses = [(np.zeros(3), np.zeros(3)), _pose(extrinsics or path, apart, needed=True)]
        return [
            _camera(path, entries, n, name, size, pose)
            for n, name, pose in zip("12", ("left", "right"), poses)
        ]
    named = entries["cameraname"].scalar() if "cameraname" in entries else ""
    name = named or Path(path).stem or "camera"
    return [_camera(path, entries, "", name, size, _pose(extrinsics or path, apart, needed=False))]


def write_opencv_yaml(path: str | Path, cameras: NamedCamera | Iterable[NamedCamera]) -> list[str]:
    """Write one camera or a stereo pair for cv2.FileStorage, under the names that `read_opencv_yaml` reads.

    One camera: camera_name, image_width, image_height, camera_matrix, distortion_coefficients, rvec, tvec
    (world -> camera). A pair: image_width, image_height, M1, D1, M2, D2, and R, T from the first to the second.

    Args:
        path: the file.
        cameras: one or two.

    Returns:
        Sentences to say: what OpenCV will not see.

    Raises:
        InputError: for more than two cameras, a pair of different image sizes, or if the file cannot be written.
    """
    named = [cameras] if isinstance(cameras, NamedCamera) else list(cameras)
    check_names([camera.name for camera in named])
    if len(named) > 2:
        raise InputError(
            f"cameras: an OpenCV file holds one or two, got {len(named)}. Write one file for each."
        )
    body = _one_text(named[0]) if len(named) == 1 else _pair_text(*named)
    write_text(path, "%YAML:1.0\n---\n" + body)
    return [
        f"Camera {camera.name!r} has a skew of {float(camera.camera.intrinsics.skew):.4g} px, which OpenCV ignores."
        for camera in named
        if float(camera.camera.intrinsics.skew) != 0
    ]


def _one_text(named: NamedCamera) -> str:
    plain = plain_camera(named)
    name = named.name.replace("\\", "\\\\").replace('"', '\\"')
    return "".join(
        [
            f'camera_name: "{name}"\n',
            _size_text(plain["size"]),
            matrix_text("camera_matrix", plain["matrix"]),
            matrix_text("distortion_coefficients", [plain["distortions"]]),
            matrix_text("rvec", _column(plain["rotation"])),
            matrix_text("tvec", _column(plain["translation"])),
        ]
    )


def _pair_text(first: NamedCamera, second: NamedCamera) -> str:
    one, two = plain_camera(first), plain_camera(second)
    if one["size"] != two["size"]:
        raise InputError(
            f"cameras: the image sizes differ ({one['size']} and {two['size']}), and an OpenCV pair has one. "
            "Write one file for each camera."
        )
    R, t = _second_from_first(first.camera, second.camera)
    return "".join(
        [
            _size_text(one["size"]),
            matrix_text("M1", one["matrix"]),
            matrix_text("D1", [one["distortions"]]),
            matrix_text("M2", two["matrix"]),
            matrix_text("D2", [two["distortions"]]),
            matrix_text("R", R.tolist()),
            matrix_text("T", _column(t.tolist())),
        ]
    )


def _second_from_first(first: Camera, second: Camera) -> tuple[np.ndarray, np.ndarray]:
    """R, T with p_second = R p_first + T. Source: cv::stereoCalibrate."""
    R_1, R_2 = (np.asarray(rotation.exp(camera.T_camera_world.rotvec)) for camera in (first, second))
    t_1, t_2 = (np.asarray(camera.T_camera_world.translation) for camera in (first, second))
    R = R_2 @ R_1.T
    return R, t_2 - R @ t_1


def _size_text(size: list[int]) -> str:
    return f"image_width: {size[0]}\nimage_height: {size[1]}\n"


def _column(values: list[float]) -> list[list[float]]:
    return [[value] for value in values]


def _by_plain_name(entries: dict[str, Entry]) -> dict[str, Entry]:
    return {key.replace("_", "").lower(): entry for key, entry in entries.items()}


def _find(entries: dict[str, Entry], names: tuple[str, ...], n: str = "") -> Entry | None:
    return next((entries[name.format(n=n)] for name in names if name.format(n=n) in entries), None)


def _needed(path: str | Path, entries: dict[str, Entry], names: tuple[str, ...], n: str, what: str) -> Entry:
    entry = _find(entries, names, n)
    if entry is None:
        found = ", ".join(entries) or "nothing"
        raise InputError(
            f"{path}: {what} is missing (found: {found[:200]}). Is this a calibration written by OpenCV?"
        )
    return entry


def _camera(
    path: str | Path,
    entries: dict[str, Entry],
    n: str,
    name: str,
    size: tuple[int, int],
    pose: tuple[np.ndarray, np.ndarray],
) -> NamedCamera:
    warnings: list[str] = []
    K = _needed(path, entries, _MATRIX, n, "M" + n if n else "camera_matrix")
    k = _needed(path, entries, _LENS, n, "D" + n if n else "distortion_coefficients")
    intrinsics = intrinsics_from_matrix(K.where, K.matrix())
    lens = lens_from_numbers(k.where, k.matrix(), warnings.append)
    return NamedCamera(
        name, assemble(K.where, size, intrinsics, lens, pose, warnings.append), {}, tuple(warnings)
    )


def _pose(path: str | Path, entries: dict[str, Entry], needed: bool) -> tuple[np.ndarray, np.ndarray]:
    """Rotation vector and translation; the identity where they are not needed and not there."""
    if not needed and not _find(entries, _ROTATION) and not _find(entries, _TRANSLATION):
        return np.zeros(3), np.zeros(3)
    R = _needed(path, entries, _ROTATION, "", "R (give the file with R and T as extrinsics)")
    T = _needed(path, entries, _TRANSLATION, "", "T (give the file with R and T as extrinsics)")
    return rotvec_from_numbers(R.where, R.matrix(), _ignore), translation_from_numbers(T.where, T.matrix())


def _ignore(_: str) -> None:
    """A pose has no camera yet to attach a warning to; a matrix that is no rotation is refused anyway."""


def _size(path: str | Path, entries: dict[str, Entry]) -> tuple[int, int]:
    if "imagesize" in entries:
        entry = entries["imagesize"]
        return size_from_numbers(entry.where, entry.sequence())
    width, height = entries.get("imagewidth"), entries.get("imageheight")
    if width is None or height is None:
        raise InputError(
            f"{path}: image_width and image_height are missing. Give the image size with the file."
        )
    return size_from_numbers(width.where, [width.number(), height.number()])


def _refuse_fisheye(entries: dict[str, Entry]) -> None:
    for key in ("fisheyemodel", "fisheye", "distortionmodel"):
        value = entries[key].scalar().lower() if key in entries else ""
        if value in ("1", "true", *_FISHEYE_MODELS):
            raise InputError(
                f"{entries[key].where}: fisheye lenses are not supported, and reading its distortions as k1 k2 p1 p2 "
                "would give wrong pixels without a sign. Calibrate with the k1 k2 model."
            )
