"""Reading GLB files: our own come back, strange ones are refused by name."""

import json
import math
import struct

import numpy as np
import pytest
from motion_samples import arm, positions, still, tumbling

from jaxmocap._errors import InputError
from jaxmocap.io import glb_bytes, read_glb

NAN = math.nan


def glb(document: dict, blob: bytes = b"") -> bytes:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(blob), b"BIN\0") + blob
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def read(tmp_path, data: bytes):
    (tmp_path / "x.glb").write_bytes(data)
    return read_glb(tmp_path / "x.glb")


@pytest.mark.parametrize("seed", range(2))
def test_a_motion_comes_back(tmp_path, seed):
    motion = tumbling(seed, frames=12)
    tracks = read(tmp_path, glb_bytes(motion)[0])
    assert tracks.joint_names == motion.names and tracks.joint_parents == motion.parents
    np.testing.assert_allclose(tracks.p_joint, positions(motion) / 1000, atol=1e-6)
    np.testing.assert_allclose(tracks.times, np.arange(12) / 29.97, rtol=1e-6)
    assert tracks.fps == 29.97 and tracks.source_unit == "mm"


def test_a_pose_with_markers_comes_back(tmp_path):
    markers = {"a": np.array([[1.0, 2, 3]]), "b": np.array([[-4.0, 5, 6]])}
    tracks = read(tmp_path, glb_bytes(still(1), markers=markers, colours={"b": (0.2, 0.5, 1.0)})[0])
    assert len(tracks.times) == 1 and tracks.object_names == ("a", "b")
    np.testing.assert_allclose(tracks.p_object[0], [[0.01, 0.02, 0.03], [-0.04, 0.05, 0.06]], atol=1e-8)
    np.testing.assert_allclose(tracks.object_colours[1], (0.2, 0.5, 1.0), atol=1e-6)


def test_a_marker_that_was_not_seen_is_not_seen_again(tmp_path):
    p = np.array([[1.0, 2, 3], [NAN] * 3, [4, 5, 6]])
    tracks = read(tmp_path, glb_bytes(arm(), markers={"m": p})[0])
    np.testing.assert_allclose(tracks.p_object[:, 0], p * 0.01, rtol=1e-6)


def test_a_parent_between_joints_and_keys_at_other_times(tmp_path):
    # A joint under a plain node with a matrix (90 degrees about z, 5 in z); a ball with keys of its own.
    blob = struct.pack("<3f", 0, 1, 2) + struct.pack("<9f", 0, 0, 0, 4, 0, 0, 4, 2, 0)
    blob += struct.pack("<2f", 0.5, 1.5) + struct.pack("<6f", 0, 0, 0, 0, 0, 8)
    views, accessors, start = [], [], 0
    for count, kind, width in ((3, "SCALAR", 1), (3, "VEC3", 3), (2, "SCALAR", 1), (2, "VEC3", 3)):
        views.append({"buffer": 0, "byteOffset": start, "byteLength": 4 * count * width})
        accessors.append({"bufferView": len(views) - 1, "componentType": 5126, "count": count, "type": kind})
        start += 4 * count * width
    document = {
        "nodes": [
            {"children": [1], "name": "root"},
            {
                "children": [2],
                "matrix": [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 5, 1],
            },
            {"name": "tip", "translation": [1, 0, 0]},
            {"name": "ball", "mesh": 0},
        ],
        "skins": [{"joints": [0, 2]}],
        "meshes": [{"primitives": []}],
        "animations": [
            {
                "channels": [
                    {"sampler": 0, "target": {"node": 0, "path": "translation"}},
                    {"sampler": 1, "target": {"node": 3, "path": "translation"}},
                ],
                "samplers": [{"input": 0, "output": 1}, {"input": 2, "output": 3, "interpolation": "STEP"}],
            }
        ],
        "buffers": [{"byteLength": len(blob)}],
        "bufferViews": views,
        "accessors": accessors,
    }
    tracks = read(tmp_path, glb(document, blob))
    np.testing.assert_allclose(tracks.times, [0, 0.5, 1, 1.5, 2])
    assert tracks.joint_parents == (-1, 0) and tracks.fps is None and tracks.source_unit == "m"
    roots = np.array([[0, 0, 0], [2, 0, 0], [4, 0, 0], [4, 1, 0], [4, 2, 0]])
    np.testing.assert_allclose(tracks.p_joint[:, 0], roots, atol=1e-12)
    np.testing.assert_allclose(tracks.p_joint[:, 1], roots + [0, 1, 5], atol=1e-12)
    np.testing.assert_allclose(tracks.p_object[:, 0, 2], [0, 0, 0, 8, 8])


JOINT = {"nodes": [{"name": "j"}], "skins": [{"joints": [0]}]}


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        (b"", "not a GLB file"),
        (b"glTF" + bytes(40), "glTF version 0"),
        (glb(JOINT)[:-30], "cut off or damaged"),
        (glb({}), "neither joints nor objects"),
        (glb({"nodes": [{"children": [0]}], **{"skins": [{"joints": [0]}]}}), "circle"),
        (glb({"nodes": [{"children": [2]}, {"children": [2]}, {}]}), "node 2 hangs on two others"),
        (glb({"nodes": [{"children": [7]}]}), "expected a number from 0 to 0, got '7'"),
        (glb({"nodes": [{"rotation": [0, 0, 0, 0]}], "skins": [{"joints": [0]}]}), "quaternion of length 0"),
        (glb({"nodes": [{"translation": [0, 0, "x"]}], "skins": [{"joints": [0]}]}), "expected 3 finite numbers"),
        (glb({"nodes": [{"translation": [0, 0, NAN]}], "skins": [{"joints": [0]}]}), "NaN is no number"),
        (glb({"nodes": {}}), "nodes: expected a list of objects"),
    ],
)
def test_damage_is_named(tmp_path, data, sentence):
    with pytest.raises(InputError, match=sentence):
        read(tmp_path, data)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"buffers": [{"uri": "file:///etc/passwd", "byteLength": 8}]}, "lie in another file, which is not opened"),
        ({"bufferViews": [{"buffer": 0, "byteOffset": 4, "byteLength": 8}] * 2}, "reach beyond the file"),
        ({"accessors": [{"bufferView": 0, "componentType": 5126, "count": 10**9, "type": "SCALAR"}] * 2}, "from 0 to"),
        ({"accessors": [{"bufferView": 0, "componentType": 5123, "count": 1, "type": "SCALAR"}] * 2}, "32-bit floats"),
    ],
)
def test_numbers_are_looked_for_in_the_file_alone(tmp_path, change, sentence):
    document = JOINT | {
        "buffers": [{"byteLength": 8}],
        "bufferViews": [{"buffer": 0, "byteLength": 8}] * 2,
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 2, "type": "SCALAR"}] * 2,
        "animations": [
            {
                "channels": [{"sampler": 0, "target": {"node": 0, "path": "translation"}}],
                "samplers": [{"input": 0, "output": 1}],
            }
        ],
    }
    with pytest.raises(InputError, match=sentence):
        read(tmp_path, glb(document | change, bytes(8)))
