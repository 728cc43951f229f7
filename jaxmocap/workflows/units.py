"""Lengths with units, sizes and boards as they are typed."""

import re

from jaxmocap._errors import InputError
from jaxmocap.io.length_units import METRES


def parse_length(text: str | float, what: str) -> tuple[float, str]:
    """Value and unit of a length such as "30mm" or 30 (unit "1": no physical unit).

    Args:
        text: as typed.
        what: the option, for messages.

    Returns:
        value in its own unit, unit.

    Raises:
        InputError: if it is no positive length or the unit is not known.
    """
    match = re.fullmatch(r"\s*([-+]?[0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?)\s*([A-Za-z]*)\s*", str(text))
    if not match:
        raise InputError(f"{what}: expected a length such as 30mm, 0.03m or 30, got {text!r}")
    value, unit = float(match[1]), match[2] or "1"
    if unit != "1" and unit not in METRES:
        raise InputError(f"{what}: unit {unit!r} is not known; use one of {', '.join(METRES)}, or none")
    if not 0 < value < float("inf"):
        raise InputError(f"{what}: expected a positive length, got {text!r}")
    return value, unit


def parse_pair(text: str | tuple[int, int], what: str, example: str) -> tuple[int, int]:
    """Two positive whole numbers typed as 9x6.

    Raises:
        InputError: if they are not.
    """
    if isinstance(text, tuple):
        text = "x".join(str(n) for n in text)
    match = re.fullmatch(r"\s*([0-9]{1,6})\s*[xX×]\s*([0-9]{1,6})\s*", text)
    if not match or not (int(match[1]) and int(match[2])):
        raise InputError(f"{what}: expected two whole numbers such as {example}, got {text!r}")
    return int(match[1]), int(match[2])


def parse_sizes(texts: list[str] | tuple[str, ...], cameras: list[str]) -> list[tuple[int, int]]:
    """Image size of each camera from entries such as 640x480 or cam3=1280x720.

    Args:
        texts: entries; one without a name holds for every camera not named.
        cameras: names.

    Returns:
        (width, height) for each camera.

    Raises:
        InputError: an unknown camera, or a camera without a size.
    """
    common: tuple[int, int] | None = None
    own: dict[str, tuple[int, int]] = {}
    for text in texts:
        name, _, size = text.rpartition("=")
        if not name:
            common = parse_pair(size, "--size", "640x480")
        elif name in cameras:
            own[name] = parse_pair(size, f"--size {name}", f"{name}=640x480")
        else:
            raise InputError(f"--size: there is no camera {name!r}; the file has {', '.join(cameras)}")
    sizes = [own.get(name, common) for name in cameras]
    missing = [name for name, size in zip(cameras, sizes) if size is None]
    if missing:
        raise InputError(f"--size: no image size for {', '.join(missing)}; give --size WIDTHxHEIGHT")
    return [size for size in sizes if size is not None]
