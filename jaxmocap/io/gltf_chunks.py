"""The binary half of a GLB: arrays, how they are described, and the container around them."""

import json
import struct
from typing import Any

import numpy as np

_COMPONENTS = {np.dtype("<f4"): 5126, np.dtype("<u2"): 5123}
_KINDS = {(): "SCALAR", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}
ARRAY_BUFFER = 34962


class Buffer:
    """Arrays one after the other, with the accessors that describe them."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, values: np.ndarray, dtype: str = "<f4", bounds: bool = False, target: int | None = None) -> int:
        """Append an array.

        Args:
            values: (n,), (n, 3), (n, 4) or (n, 4, 4), the latter by columns.
            dtype: "<f4" or "<u2".
            bounds: whether least and greatest values are stated (positions and times need it).
            target: ARRAY_BUFFER for corners of a mesh.

        Returns:
            Number of the accessor.
        """
        array = np.ascontiguousarray(values, dtype=dtype)
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": array.nbytes}
        self.views.append(view | ({} if target is None else {"target": target}))
        self.data += array.tobytes()
        self.data += bytes(-len(self.data) % 4)
        accessor: dict[str, Any] = {
            "bufferView": len(self.views) - 1,
            "componentType": _COMPONENTS[array.dtype],
            "count": len(array),
            "type": _KINDS[array.shape[1:]],
        }
        if bounds:
            flat = array.reshape(len(array), -1)
            accessor |= {"min": flat.min(axis=0).tolist(), "max": flat.max(axis=0).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def glb_container(document: dict[str, Any], buffer: Buffer) -> bytes:
    """The file: header, JSON chunk, binary chunk."""
    document = document | {
        "buffers": [{"byteLength": len(buffer.data)}],
        "bufferViews": buffer.views,
        "accessors": buffer.accessors,
    }
    text = json.dumps(document, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(buffer.data), b"BIN\0") + bytes(buffer.data)
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
