"""The outside of a GLB file of unknown quality: its chunks, its JSON, its arrays."""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap._errors import InputError
from jaxmocap.io.text_file import read_bytes

_MAX_BYTES = 1 << 30
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_FLOAT = 5126


class GlbFile:
    """JSON and numbers of a GLB; every access says what is wrong instead of failing."""

    def __init__(self, path: str | Path) -> None:
        self.path = path
        data = read_bytes(path, _MAX_BYTES)
        if data[:4] != b"glTF" or len(data) < 20:
            raise InputError(f"{path}: not a GLB file (it does not begin with glTF). A .gltf must be saved as .glb.")
        version, length, json_length, kind = struct.unpack_from("<IIII", data, 4)
        if version != 2:
            raise InputError(f"{path}: glTF version {version}; this program reads version 2.")
        if length > len(data) or 20 + json_length > length or kind != 0x4E4F534A:
            raise InputError(f"{path}: the file is cut off or damaged. Export it again.")
        self.content = self._parse(data[20 : 20 + json_length])
        start = 20 + json_length
        self.blob = b""
        if start + 8 <= length:
            blob_length, kind = struct.unpack_from("<II", data, start)
            if kind == 0x004E4942:
                self.blob = data[start + 8 : start + 8 + blob_length]

    def _parse(self, text: bytes) -> dict[str, Any]:
        try:
            content = json.loads(text.decode("utf-8"), parse_constant=_no_number)
        except (ValueError, RecursionError) as error:
            raise InputError(f"{self.path}: its JSON cannot be read ({str(error)[:200]}). Export it again.") from None
        if not isinstance(content, dict):
            raise self.wrong("the JSON is no object")
        return content

    def wrong(self, what: str) -> InputError:
        """The error to raise for something in the JSON."""
        return InputError(f"{self.path}: {what}. Export the file again.")

    def objects(self, key: str, parent: dict[str, Any] | None = None) -> list[dict[str, Any]]:
        """A list of objects, empty where there is none.

        Raises:
            InputError: if it is something else.
        """
        value = (self.content if parent is None else parent).get(key, [])
        if not isinstance(value, list) or not all(isinstance(entry, dict) for entry in value):
            raise self.wrong(f"{key}: expected a list of objects")
        return value

    def indices(self, value: Any, below: int, what: str) -> list[int]:
        """A list of whole numbers from 0 to below - 1.

        Raises:
            InputError: if it is something else.
        """
        if not isinstance(value, list):
            raise self.wrong(f"{what}: expected a list of numbers")
        return [self.index(entry, below, what) for entry in value]

    def index(self, value: Any, below: int, what: str) -> int:
        """A whole number from 0 to below - 1.

        Raises:
            InputError: if it is something else.
        """
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < below:
            raise self.wrong(f"{what}: expected a number from 0 to {below - 1}, got {str(value)[:40]!r}")
        return value

    def vector(self, value: Any, size: int, what: str) -> np.ndarray:
        """(size,) finite numbers.

        Raises:
            InputError: if it is something else.
        """
        good = isinstance(value, list) and len(value) == size
        if not good or not all(isinstance(v, int | float) and not isinstance(v, bool) and abs(v) < 1e30 for v in value):
            raise self.wrong(f"{what}: expected {size} finite numbers")
        return np.array(value, dtype=float)

    def array(self, number: Any, kind: str, what: str) -> np.ndarray:
        """(count, width) 32-bit floats of an accessor, as float64.

        Raises:
            InputError: if it is of another kind, reaches beyond the file, or holds NaN or infinity.
        """
        accessors, views = self.objects("accessors"), self.objects("bufferViews")
        accessor = accessors[self.index(number, len(accessors), what)]
        if accessor.get("type") != kind or accessor.get("componentType") != _FLOAT or "sparse" in accessor:
            raise self.wrong(f"{what}: expected plain 32-bit floats of type {kind}")
        view = views[self.index(accessor.get("bufferView"), len(views), what)]
        if view.get("buffer", 0) != 0 or "uri" in (self.objects("buffers") or [{}])[0]:
            raise self.wrong(f"{what}: its numbers lie in another file, which is not opened; embed them")
        big, width = len(self.blob) + 1, _WIDTHS[kind]
        count = self.index(accessor.get("count"), big, what)
        start = self.index(view.get("byteOffset", 0), big, what) + self.index(accessor.get("byteOffset", 0), big, what)
        if view.get("byteStride", 4 * width) != 4 * width or start + 4 * count * width > len(self.blob):
            raise self.wrong(f"{what}: its numbers reach beyond the file")
        values = np.frombuffer(self.blob, "<f4", count * width, start).reshape(count, width).astype(float)
        if not np.isfinite(values).all():
            raise self.wrong(f"{what}: holds NaN or infinity")
        return values


def _no_number(text: str) -> None:
    raise ValueError(f"{text} is no number in JSON")
