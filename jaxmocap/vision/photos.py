"""Reading photographs for measurement: pixels as the sensor stored them, and no damaged file let through.

OpenCV decodes (it keeps 16 bits and can be told to leave the EXIF rotation alone); Pillow checks, because
OpenCV's `imread` returns a truncated JPEG with a grey tail and no error, where Pillow raises.
"""

from __future__ import annotations

import hashlib
import io
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from jaxmocap._errors import InputError

MAX_PIXELS = 89_478_485
"""Largest photo that is decoded: the size above which Pillow suspects a decompression bomb."""

_MAX_FILE_BYTES = 8 * MAX_PIXELS  # four channels of 16 bits, uncompressed: no honest photo within MAX_PIXELS is bigger
_EXIF_ORIENTATION = 0x0112
_WHITE = 255.0


@dataclass(frozen=True)
class Photo:
    """One photograph, ready for measuring.

    Attributes:
        name: File name with extension; what messages call the photo.
        path: Where it was read from.
        grey: Brightness, uint8 (height, width), row 0 at the top, as stored on the sensor (EXIF rotation not
            applied).
        sha256: Hash of the file's bytes, hexadecimal.
        warnings: What the user should know about this file; empty when all is plain.
    """

    name: str
    path: Path
    grey: NDArray[np.uint8]
    sha256: str
    warnings: tuple[str, ...] = ()

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        height, width = self.grey.shape
        return width, height


@dataclass(frozen=True)
class ColourPhoto:
    """One photograph in colour, ready for measuring.

    Attributes:
        name: File name with extension; what messages call the photo.
        path: Where it was read from.
        rgb: Red, green, blue, uint8 (height, width, 3), row 0 at the top, as stored on the sensor (EXIF rotation not
            applied).
        sha256: Hash of the file's bytes, hexadecimal.
        warnings: What the user should know about this file; empty when all is plain.
    """

    name: str
    path: Path
    rgb: NDArray[np.uint8]
    sha256: str
    warnings: tuple[str, ...] = ()

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        height, width = self.rgb.shape[:2]
        return width, height


@runtime_checkable
class NamedSize(Protocol):
    """Anything with a name and an image size: a `Photo`, or what was kept of one."""

    @property
    def name(self) -> str:
        """File name."""
        ...

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        ...


def read_photo(path: str | Path) -> Photo:
    """Read one photo as 8-bit grey.

    Grey, colour, alpha, 16-bit and CMYK files are accepted. Transparent pixels are laid over white. The EXIF
    rotation is ignored (with a warning): a calibration describes the sensor, whose axes do not turn with the
    viewer's.

    Args:
        path: A PNG, JPEG, TIFF, BMP, WebP or PNM file; spaces and Unicode in the path are fine.

    Returns:
        The photo.

    Raises:
        InputError: The file is missing, a folder, empty, not an image, truncated, damaged or too big.
    """
    path = Path(path)
    data = _read_bytes(path)
    image = _decode_strictly(data, path)
    pixels, warnings = _pixels(image, data, path)
    grey = pixels if pixels.ndim == 2 else _luma(image, pixels)
    return Photo(path.name, path, _to_8_bits(grey), hashlib.sha256(data).hexdigest(), warnings)


def read_colour_photo(path: str | Path) -> ColourPhoto:
    """Read one photo as 8-bit red, green and blue, as strictly as `read_photo`.

    Args:
        path: A PNG, JPEG, TIFF, BMP, WebP or PNM file; spaces and Unicode in the path are fine.

    Returns:
        The photo.

    Raises:
        InputError: The file is missing, a folder, empty, not an image, truncated, damaged or too big, or only greys.
    """
    path = Path(path)
    data = _read_bytes(path)
    image = _decode_strictly(data, path)
    pixels, warnings = _pixels(image, data, path)
    if pixels.ndim == 2 or _all_grey(pixels):
        raise InputError(
            f"{path}: a greyscale photo, but colour is needed: beads are told apart by it. Give the colour photo, and "
            "switch off black-and-white in the camera."
        )
    rgb = np.ascontiguousarray(_to_8_bits(pixels)[..., ::-1])
    return ColourPhoto(path.name, path, rgb, hashlib.sha256(data).hexdigest(), warnings)


def _all_grey(pixels: NDArray) -> bool:
    """Whether all three channels are the same everywhere."""
    return bool((pixels[..., 0] == pixels[..., 1]).all() and (pixels[..., 0] == pixels[..., 2]).all())


def check_same_size(photos: Sequence[NamedSize], expected: tuple[int, int] | None = None) -> tuple[int, int]:
    """The common size of photos that are said to come from one camera.

    Args:
        photos: At least one photo.
        expected: Width and height the camera is known to have; by default the most frequent size.

    Returns:
        Width and height in pixels.

    Raises:
        InputError: No photo, or some have another size; the message names them.
    """
    if not photos:
        raise InputError("no photos: there is nothing to take the image size from.")
    counts = Counter(photo.size for photo in photos)
    usual = expected or max(counts, key=lambda size: (counts[size], size))
    odd = [photo for photo in photos if photo.size != usual]
    if not odd:
        return usual
    source = "the camera's size" if expected else f"as {counts[usual]} of {len(photos)} are"
    turned = any(photo.size == usual[::-1] for photo in odd)
    cause = "turned or rotated copies" if turned else "another camera, or resized or cropped copies"
    names = ", ".join(f"{photo.name} ({photo.size[0]}x{photo.size[1]})" for photo in odd[:8])
    more = f" and {len(odd) - 8} more" if len(odd) > 8 else ""
    raise InputError(
        f"photos of different sizes: expected {usual[0]}x{usual[1]}, {source}, but got {names}{more}. Likely "
        f"{cause}. Give only untouched photos of one camera at one resolution."
    )


def _read_bytes(path: Path) -> bytes:
    """The file's bytes, or an error that says why there are none."""
    try:
        if path.is_dir():
            raise InputError(f"{path}: is a folder where one photo was expected. Name a file in it.")
        if path.stat().st_size > _MAX_FILE_BYTES:
            raise InputError(f"{path}: {path.stat().st_size} bytes are too many for a photo. Is it a video?")
        data = path.read_bytes()
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file. Check the spelling and the folder.") from error
    except (OSError, ValueError) as error:  # ValueError: a NUL character in the path
        raise InputError(f"{path}: cannot be read ({error}). Check its permissions and its folder's.") from error
    if not data:
        raise InputError(f"{path}: is empty (0 bytes); a copy was probably interrupted. Copy it again.")
    return data


def _decode_strictly(data: bytes, path: Path) -> Image.Image:
    """The image as Pillow decodes it: Pillow raises on a missing tail or a wrong checksum."""
    try:
        image = Image.open(io.BytesIO(data))
        pixels = image.size[0] * image.size[1]
    except (Image.DecompressionBombError, Image.DecompressionBombWarning):
        pixels = MAX_PIXELS + 1
    except Exception as error:  # damaged headers make Pillow raise SyntaxError, struct.error, KeyError, ...
        raise InputError(
            f"{path}: not an image that can be read ({_reason(error)}). It may be another kind of file "
            "with an image's name. Give PNG, JPEG, TIFF, BMP or WebP."
        ) from error
    if pixels > MAX_PIXELS:
        raise InputError(f"{path}: more than {MAX_PIXELS} pixels. Give the photo at the size used for capture.")
    try:
        image.load()
    except Exception as error:  # as above, for the pixel data
        raise InputError(
            f"{path}: damaged or truncated image ({_reason(error)}); a copy was probably interrupted. "
            "Copy it again or leave it out."
        ) from error
    return image


def _reason(error: Exception) -> str:
    """Pillow's words without the address of the buffer, which would differ from run to run."""
    return str(error).split(" <_io")[0] or type(error).__name__


def _pixels(image: Image.Image, data: bytes, path: Path) -> tuple[NDArray, tuple[str, ...]]:
    """The photo's pixels, (h, w) or BGR (h, w, 3), 8 or 16 bits, opaque, and what the user should know about them."""
    if image.mode == "CMYK":  # OpenCV would take four inks for blue, green, red and alpha
        pixels = np.array(image.convert("RGB"), dtype=np.uint8)[..., ::-1]
        warnings = ["CMYK colours (a print format); converted."]
    else:
        pixels, warnings = _pixels_of_file(data, path)
    if (pixels.shape[1], pixels.shape[0]) != image.size:
        raise InputError(
            f"{path}: two decoders disagree about its size ({pixels.shape[1]}x{pixels.shape[0]} and "
            f"{image.size[0]}x{image.size[1]}); the file is damaged. Export it again from the camera."
        )
    warnings += _orientation_warning(image)
    return pixels, tuple(f"{path.name}: {text}" for text in warnings)


def _luma(image: Image.Image, pixels: NDArray) -> NDArray:
    """Grey of a colour picture."""
    if image.mode == "CMYK":
        return np.array(image.convert("RGB").convert("L"), dtype=np.uint8)
    return cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY)


def _pixels_of_file(data: bytes, path: Path) -> tuple[NDArray, list[str]]:
    """The file as OpenCV decodes it, without alpha, and what was done to get there."""
    flags = cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        pixels = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags)
    except cv2.error as error:
        raise InputError(f"{path}: OpenCV cannot decode it ({error.err}). Save it as PNG or JPEG.") from error
    if pixels is None:
        raise InputError(f"{path}: OpenCV cannot decode it. Save it as PNG or JPEG.")
    if pixels.dtype not in (np.uint8, np.uint16):
        raise InputError(f"{path}: pixels of type {pixels.dtype}; expected 8 or 16 bit. Save it as PNG or JPEG.")
    warnings = [] if pixels.dtype == np.uint8 else ["16-bit pixels, scaled to 8 bits."]
    channels = 1 if pixels.ndim == 2 else pixels.shape[2]
    if channels == 4:
        pixels, seen_through = _over_white(pixels)
        warnings += ["transparent pixels, laid over white."] if seen_through else []
    return pixels if channels >= 3 else pixels.reshape(pixels.shape[:2]), warnings


def _over_white(bgra: NDArray) -> tuple[NDArray, bool]:
    """BGR over a white ground, and whether any pixel was not opaque."""
    top = np.iinfo(bgra.dtype).max
    alpha = bgra[..., 3:]
    if alpha.min() == top:
        return np.ascontiguousarray(bgra[..., :3]), False
    weight = alpha.astype(np.float64) / top
    mixed = bgra[..., :3] * weight + top * (1.0 - weight)
    return np.rint(mixed).astype(bgra.dtype), True


def _to_8_bits(pixels: NDArray) -> NDArray[np.uint8]:
    """8-bit pixels; 16-bit files often hold 10 to 14 bits: scaled by the least power of two that fits."""
    if pixels.dtype == np.uint8:
        return pixels
    bits = max(8, int(pixels.max()).bit_length())
    return np.minimum(np.rint(pixels / 2.0 ** (bits - 8)), _WHITE).astype(np.uint8)


def _orientation_warning(image: Image.Image) -> list[str]:
    """A sentence when a viewer would turn this photo."""
    try:
        orientation = int(image.getexif().get(_EXIF_ORIENTATION, 1))
    except Exception:  # a damaged EXIF block says nothing about the pixels, which have been decoded
        return []
    if orientation == 1:
        return []
    return [
        f"EXIF orientation {orientation}: viewers turn or mirror this photo. Its pixels are used as the "
        "sensor stored them, so that one camera matrix fits photos taken upright and on the side."
    ]
