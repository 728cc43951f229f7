"""GLB as pygltflib reads it back."""

import math
from pathlib import Path

import numpy as np
import pygltflib
import pytest
from motion_samples import ARM_HANDS, arm, positions, still, tumbling

from jaxmocap._errors import InputError
from jaxmocap.io import glb_bytes, write_glb

GOLDEN = Path(__file__).parent / "golden"
NAN = math.nan
_DTYPES = {5126: "<f4", 5123: "<u2"}
_WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}


def load(data: bytes) -> pygltflib.GLTF2:
    return pygltflib.GLTF2.load_from_bytes(data)


def array(gltf: pygltflib.GLTF2, number: int) -> np.ndarray:
    accessor = gltf.accessors[number]
    view = gltf.bufferViews[accessor.bufferView]
    width = _WIDTHS[accessor.type]
    flat = np.frombuffer(gltf.binary_blob(), _DTYPES[accessor.componentType], accessor.count * width, view.byteOffset)
    return flat.reshape(accessor.count, width)


def tracks(gltf: pygltflib.GLTF2) -> dict[tuple[str, str], tuple[np.ndarray, np.ndarray, str]]:
    """Times, values and interpolation by name of the node and property."""
    found = {}
    for animation in gltf.animations:
        for channel in animation.channels:
            sampler = animation.samplers[channel.sampler]
            key = (gltf.nodes[channel.target.node].name, channel.target.path)
            found[key] = (array(gltf, sampler.input)[:, 0], array(gltf, sampler.output), sampler.interpolation)
    return found


def turned(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """A vector turned by a quaternion x y z w."""
    return v + 2 * np.cross(q[:3], np.cross(q[:3], v) + q[3] * v)


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.array([*(a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])), a[3] * b[3] - a[:3] @ b[:3]])


def world(gltf: pygltflib.GLTF2, frame: int) -> dict[str, np.ndarray]:
    """Positions of the joints at a key."""
    moves = tracks(gltf)
    found: dict[str, np.ndarray] = {}

    def down(number: int, p: np.ndarray, q: np.ndarray) -> None:
        node = gltf.nodes[number]
        at = {
            path: moves[node.name, path][1][frame] for path in ("translation", "rotation") if (node.name, path) in moves
        }
        p = p + turned(q, np.array(at.get("translation", node.translation), dtype=float))
        q = product(q, np.array(at.get("rotation", node.rotation), dtype=float))
        found[node.name] = p
        for child in node.children or []:
            down(child, p, q)

    down(gltf.skins[0].skeleton, np.zeros(3), np.array([0.0, 0, 0, 1]))
    return found


@pytest.mark.parametrize("seed", range(3))
def test_the_joints_are_where_they_are_in_metres(seed):
    motion = tumbling(seed, frames=6)
    gltf = load(glb_bytes(motion)[0])
    expected = positions(motion) / 1000
    for frame in range(6):
        found = world(gltf, frame)
        for joint, name in enumerate(motion.names):
            np.testing.assert_allclose(found[name], expected[frame, joint], atol=1e-6)


def test_keys_are_in_seconds_and_quaternions_do_not_flip():
    motion = tumbling(1, frames=200)
    for (_, path), (times, values, interpolation) in tracks(load(glb_bytes(motion, fps=29.97)[0])).items():
        np.testing.assert_allclose(times, np.arange(200) / 29.97, rtol=1e-6)
        assert interpolation == "LINEAR"
        if path == "rotation":
            np.testing.assert_allclose(np.linalg.norm(values, axis=1), 1, atol=1e-6)
            assert (np.sum(values[1:] * values[:-1], axis=1) > 0).all()


def test_a_single_pose_has_no_animation():
    gltf = load(glb_bytes(still(1))[0])
    assert gltf.animations == []
    np.testing.assert_allclose(world(gltf, 0)["hand"], ARM_HANDS[1] * 0.01, atol=1e-7)


def test_the_skin_carries_bones_of_the_right_length():
    gltf = load(glb_bytes(arm())[0])
    (skin,) = gltf.skins
    assert [gltf.nodes[j].name for j in skin.joints] == ["root-joint", "elbow", "hand"]
    inverse = array(gltf, skin.inverseBindMatrices).reshape(3, 4, 4)
    np.testing.assert_allclose(inverse[:, 3, 1], [0, -0.03, -0.05], atol=1e-8)  # by columns: translation is row 3
    mesh = gltf.meshes[next(n.mesh for n in gltf.nodes if n.skin is not None)]
    assert len(mesh.primitives) == 2
    bone = mesh.primitives[0].attributes
    corners, carriers = array(gltf, bone.POSITION), array(gltf, bone.JOINTS_0)[:, 0]
    np.testing.assert_allclose([np.ptp(corners[carriers == j, 1]) for j in (0, 1)], [0.03, 0.02], atol=1e-7)
    np.testing.assert_array_equal(array(gltf, bone.WEIGHTS_0), np.tile([1, 0, 0, 0], (len(corners), 1)))
    normals = array(gltf, bone.NORMAL)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
    axis_point = corners * [0, 1, 0]
    assert (np.sum(normals * (corners - axis_point), axis=1) > -1e-9).all()  # outwards


def test_bounds_are_stated_where_viewers_need_them():
    gltf = load(glb_bytes(arm(), markers={"m": np.ones((3, 3))})[0])
    for mesh in gltf.meshes:
        for primitive in mesh.primitives:
            accessor = gltf.accessors[primitive.attributes.POSITION]
            values = array(gltf, primitive.attributes.POSITION)
            np.testing.assert_array_equal(accessor.min, values.min(axis=0))
            np.testing.assert_array_equal(accessor.max, values.max(axis=0))


def test_markers_stand_in_the_world_and_vanish_where_not_seen():
    seen = np.array([[NAN] * 3, [10.0, 20, 30], [40, 50, 60]])
    markers = {"head.1": seen, "</script>": np.ones((3, 3)), "lost": np.full((3, 3), NAN)}
    data, said = glb_bytes(arm(), markers=markers, colours={"head.1": (1.0, 0.0, 0.0)})
    gltf = load(data)
    assert "2 markers" in said and "never seen and left out: lost" in said
    assert {"head.1", "</script>"} <= {n.name for n in gltf.nodes} and "lost" not in {n.name for n in gltf.nodes}
    moves = tracks(gltf)
    np.testing.assert_allclose(moves["head.1", "translation"][1][1:], seen[1:] * 0.01, rtol=1e-6)
    _, scale, interpolation = moves["head.1", "scale"]
    np.testing.assert_array_equal(scale, [[0, 0, 0], [1, 1, 1], [1, 1, 1]])
    assert interpolation == "STEP"
    node = next(n for n in gltf.nodes if n.name == "head.1")
    colour = gltf.materials[gltf.meshes[node.mesh].primitives[0].material].pbrMetallicRoughness.baseColorFactor
    assert colour == [1.0, 0.0, 0.0, 1.0]


def test_markers_of_another_length_are_refused():
    with pytest.raises(InputError, match=r"'m': expected shape \(3, 3\)"):
        glb_bytes(arm(), markers={"m": np.ones((2, 3))})


def test_a_skeleton_of_one_joint_and_bones_of_no_length_are_written():
    one = arm(names=("root",), parents=(-1,), offsets=np.zeros((1, 3)), rotvec=np.zeros((3, 1, 3)))
    assert len(load(glb_bytes(one)[0]).nodes) == 2
    flat = load(glb_bytes(arm(offsets=np.zeros((3, 3))))[0])
    assert len(flat.meshes[0].primitives) == 1  # the balls alone


def test_no_number_in_the_file_is_not_finite():
    seen = np.array([[NAN] * 3, [10.0, 20, 30], [40, NAN, 60]])
    gltf = load(glb_bytes(arm(), markers={"m": seen})[0])
    assert all(np.isfinite(array(gltf, number)).all() for number in range(len(gltf.accessors)))


def test_the_bytes_are_those_kept(tmp_path):
    said = write_glb(tmp_path / "arm.glb", arm())
    assert "3 joints, 3 frames at 25 frames per second, lengths in m, y up." in said
    data = (tmp_path / "arm.glb").read_bytes()
    kept = (GOLDEN / "arm.glb").read_bytes()
    assert len(data) == len(kept)
    new, old = load(data), load(kept)
    assert new.to_json() == old.to_json()
    # Sines may differ in the last bit between processors.
    for number in range(len(new.accessors)):
        np.testing.assert_allclose(array(new, number), array(old, number), atol=1e-7)
    assert data == glb_bytes(arm())[0]
