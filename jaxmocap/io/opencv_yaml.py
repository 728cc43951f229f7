"""OpenCV's calibration files: one camera (sample calibration.cpp) or a stereo pair (stereo_calib.cpp)."""

import json
from collections.abc import Iterable
from dataclasses import dataclass, field
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
_MATRIX = ("cameramatrix{n}", "k{n}", "m{n}")
_LENS = ("distortioncoefficients{n}", "distcoeffs{n}", "distcoeff{n}", "d{n}")
_ROTATION, _TRANSLATION = ("r", "rvec"), ("t", "tvec")
_FISHEYE_KEYS = ("fisheyemodel", "fisheye", "distortionmodel")
_FISHEYE_VALUES = ("1", "true", "equidistant", "fisheye", "kannala_brandt")


def read_opencv_yaml(
    path: str | Path, image_size: tuple[int, int] | None = None, extrinsics: str | Path | None = None
) -> list[NamedCamera]:
    """Read one camera or a stereo pair that a program wrote with OpenCV's FileStorage as YAML.

    One camera has camera_matrix (or K) and distortion_coefficients (or D), and may have R or rvec, T or
    tvec (world -> camera). A pair has M1 D1 M2 D2 (or the long names with 1 and 2), and R, T from the first
    camera to the second; its cameras are called left and right, and the world is the first camera. The
    camera_info files of ROS are alike and read too.

    Args:
        path: the file.
        image_size: (width, height) [px], for files that do not say, as those of stereo_calib.cpp.
        extrinsics: file with R and T, for programs that write them apart (intrinsics.yml, extrinsics.yml).

    Returns:
        The cameras; one camera is called by its camera_name or else by the name of the file. What is odd
        about each stands in its `warnings`.

    Raises:
        InputError: naming line and key of what is missing, damaged or impossible; for a fisheye lens; if
            JAX is not in 64-bit mode.

    Source: OpenCV, samples/cpp/tutorial_code/calib3d/camera_calibration and samples/cpp/stereo_calib.cpp.
    """
    require_x64("reading a calibration")
    file = _File(path, _by_plain_name(read_entries(path)))
    _refuse_fisheye(file)
    size = image_size or _size(file)
    apart = _File(extrinsics, _by_plain_name(read_entries(extrinsics))) if extrinsics else file
    if file.find(_MATRIX, "1"):
        return [
            _camera(file, "1", "left", size, _Standing()),
            _camera(file, "2", "right", size, _standing(apart)),
        ]
    given = file.entries["cameraname"].scalar() if "cameraname" in file.entries else ""
    fixed = apart.find(_ROTATION) or apart.find(_TRANSLATION)
    return [_camera(file, "", given or Path(path).stem, size, _standing(apart) if fixed else _Standing())]


def write_opencv_yaml(path: str | Path, cameras: NamedCamera | Iterable[NamedCamera]) -> list[str]:
    """Write one camera or a stereo pair for cv2.FileStorage, under names that `read_opencv_yaml` reads.

    One camera: camera_name, image_width, image_height, camera_matrix, distortion_coefficients, rvec, tvec
    (world -> camera). A pair: image_width, image_height, M1, D1, M2, D2; R, T from the first to the second.

    Args:
        path: the file.
        cameras: one or two.

    Returns:
        Sentences to say: what OpenCV will not see.

    Raises:
        InputError: for more than two cameras, a pair of different image sizes, or if it cannot be written.

    Source: as `read_opencv_yaml`.
    """
    text, said = opencv_yaml_text(cameras)
    write_text(path, text)
    return said


def opencv_yaml_text(cameras: NamedCamera | Iterable[NamedCamera]) -> tuple[str, list[str]]:
    """The text that `write_opencv_yaml` writes and the sentences it returns.

    Raises:
        InputError: as `write_opencv_yaml`.
    """
    named = [cameras] if isinstance(cameras, NamedCamera) else list(cameras)
    check_names([camera.name for camera in named])
    if len(named) > 2:
        raise InputError(f"cameras: an OpenCV file holds one or two, got {len(named)}. Write one file for each.")
    body = _one_text(named[0]) if len(named) == 1 else _pair_text(*named)
    skews = {camera.name: float(camera.camera.intrinsics.skew) for camera in named}
    said = [
        f"Camera {name!r} has a skew of {skew:.4g} px, which OpenCV ignores."
        for name, skew in skews.items()
        if skew != 0
    ]
    return "%YAML:1.0\n---\n" + body, said


@dataclass(frozen=True)
class _Standing:
    """Where a camera stands: world -> camera, and what is odd about it."""

    rotvec: np.ndarray = field(default_factory=lambda: np.zeros(3))
    translation: np.ndarray = field(default_factory=lambda: np.zeros(3))
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class _File:
    """The entries of a file by plain name."""

    path: str | Path
    entries: dict[str, Entry]

    def find(self, names: tuple[str, ...], n: str = "") -> Entry | None:
        """The entry under one of several names, or None."""
        return next((self.entries[name.format(n=n)] for name in names if name.format(n=n) in self.entries), None)

    def need(self, names: tuple[str, ...], n: str, what: str) -> Entry:
        """The entry under one of several names.

        Raises:
            InputError: if there is none.
        """
        entry = self.find(names, n)
        if entry is None:
            found = ", ".join(self.entries)[:200] or "nothing"
            raise InputError(f"{self.path}: {what} is missing (found: {found}). Is this a calibration of OpenCV?")
        return entry


def _by_plain_name(entries: dict[str, Entry]) -> dict[str, Entry]:
    return {key.replace("_", "").lower(): entry for key, entry in entries.items()}


def _camera(file: _File, n: str, name: str, size: tuple[int, int], standing: _Standing) -> NamedCamera:
    warnings = list(standing.warnings)
    K = file.need(_MATRIX, n, f"M{n}" if n else "camera_matrix")
    k = file.need(_LENS, n, f"D{n}" if n else "distortion_coefficients")
    intrinsics = intrinsics_from_matrix(K.where, K.matrix())
    lens = lens_from_numbers(k.where, k.matrix(), warnings.append)
    pose = standing.rotvec, standing.translation
    camera = assemble(K.where, size, intrinsics, lens, pose, warnings.append)
    return NamedCamera(name, camera, warnings=tuple(warnings))


def _standing(file: _File) -> _Standing:
    advice = " (if it is in a file of its own, give that as extrinsics)"
    R = file.need(_ROTATION, "", "R" + advice)
    T = file.need(_TRANSLATION, "", "T" + advice)
    warnings: list[str] = []
    rotvec = rotvec_from_numbers(R.where, R.matrix(), warnings.append)
    return _Standing(rotvec, translation_from_numbers(T.where, T.matrix()), tuple(warnings))


def _size(file: _File) -> tuple[int, int]:
    entry = file.entries.get("imagesize")
    if entry is not None:
        return size_from_numbers(entry.where, entry.sequence())
    width, height = file.entries.get("imagewidth"), file.entries.get("imageheight")
    if width is None or height is None:
        raise InputError(f"{file.path}: image_width or image_height is missing. Give the image size as well.")
    return size_from_numbers(width.where, [width.number(), height.number()])


def _refuse_fisheye(file: _File) -> None:
    for entry in (file.entries[key] for key in _FISHEYE_KEYS if key in file.entries):
        if entry.scalar().lower() in _FISHEYE_VALUES:
            raise InputError(
                f"{entry.where}: fisheye lenses are not supported; its distortions read as k1 k2 p1 p2 would "
                "give wrong pixels without a sign. Calibrate it with the k1 k2 model."
            )


def _one_text(named: NamedCamera) -> str:
    plain = plain_camera(named)
    return "".join(
        [
            f"camera_name: {json.dumps(named.name, ensure_ascii=False)}\n",
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
