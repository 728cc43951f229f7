"""COLLADA against its schema, against pycollada, and against what the document prints."""

import io
import math
from pathlib import Path
from xml.etree import ElementTree

import collada
import lxml.etree
import numpy as np
import pytest
from collada.schema import ColladaValidator
from motion_samples import ARM_ELBOWS, ARM_HANDS, arm, positions, still, tumbling

from jaxmocap.io import collada_text, write_collada

GOLDEN = Path(__file__).parent / "golden"
NS = {"c": "http://www.collada.org/2005/11/COLLADASchema"}
HOSTILE = ("a<b>&\"c'", "</node>", "3 legs")


@pytest.fixture(scope="module")
def validator():
    return ColladaValidator()


def valid(validator, text: str) -> str:
    document = lxml.etree.fromstring(text.encode())
    good = validator.validate(document)
    return "" if good else str(validator.COLLADA_SCHEMA_1_4_1_INSTANCE.error_log)


def load(text: str) -> collada.Collada:
    return collada.Collada(io.BytesIO(text.encode()))


def world(node, above=None, found=None) -> dict[str, np.ndarray]:
    """Position of every node of pycollada's scene, by id."""
    found = {} if found is None else found
    T = (np.eye(4) if above is None else above) @ node.matrix
    found[node.id] = T[:3, 3]
    for child in node.children:
        if isinstance(child, collada.scene.Node):
            world(child, T, found)
    return found


def test_the_document_s_elbow_as_printed():
    # Section 6.3: the elbow relative to the shoulder.
    printed = np.array([3.2703316, -0.31502795, -0.3093352])
    motion = still(
        names=("root-joint", "l-shoulder-joint", "l-elbow-joint"),
        rotvec=np.zeros((1, 3, 3)),
        offsets=np.array([[0.0, 0, 0], [1, 2, 3], printed]),
    )
    text, _ = collada_text(motion)
    nodes = {n.get("id"): n for n in ElementTree.fromstring(text).iter(f"{{{NS['c']}}}node")}
    assert all(n.get("type") == "JOINT" for n in nodes.values())
    matrix = nodes["l-elbow-joint"].find("c:matrix", NS).text
    assert matrix == "1 0 0 3.2703316 0 1 0 -0.31502795 0 0 1 -0.3093352 0 0 0 1"
    assert nodes["root-joint"].find("c:matrix", NS) is None  # "with the exception of the root-joint"
    assert nodes["l-shoulder-joint"].find("c:node", NS) is nodes["l-elbow-joint"]


def test_a_still_pose_holds_translations_along_the_axes_of_the_world():
    # Bent by 90 degrees, the hand lies 2 towards -x of the elbow, and no matrix says a rotation.
    text, said = collada_text(still(2, root=np.zeros((1, 3))))
    assert "1 0 0 -2 0 1 0 " in text and "translations only" in said
    for matrix in ElementTree.fromstring(text).iter(f"{{{NS['c']}}}matrix"):
        T = np.array(matrix.text.split(), dtype=float).reshape(4, 4)
        np.testing.assert_array_equal(T[:3, :3], np.eye(3))


@pytest.mark.parametrize("rotations", [False, True])
@pytest.mark.parametrize(
    "motion", [arm(), still(1), tumbling(2), arm(names=HOSTILE)], ids=["arm", "1", "tree", "names"]
)
def test_files_follow_the_schema(validator, motion, rotations):
    assert valid(validator, collada_text(motion, rotations=rotations)[0]) == ""


def test_the_schema_would_notice_the_document_s_misprints(validator):
    text, _ = collada_text(still())
    assert valid(validator, text.replace("instance_visual_scene", "instace_visual_scene"))
    assert valid(validator, text.replace("1970-01-01T00:00:00Z", "Fri Oct 15 17:37:04 CEST 2010"))
    assert valid(validator, text.replace('name="elbow"', 'name="an elbow"'))


@pytest.mark.parametrize("rotations", [False, True])
def test_pycollada_finds_the_joints_where_they_are(rotations):
    document = load(collada_text(still(1), rotations=rotations)[0])
    assert str(document.assetInfo.upaxis) == "Y_UP"
    (root,) = document.scene.nodes
    found = world(root)
    np.testing.assert_allclose(found["elbow"], ARM_ELBOWS[1], atol=1e-6)
    np.testing.assert_allclose(found["hand"], ARM_HANDS[1], atol=1e-6)


@pytest.mark.parametrize(
    ("unit", "metres", "name"), [("mm", 0.001, "millimeter"), ("cm", 0.01, "centimeter"), ("in", 0.0254, "inch")]
)
def test_the_unit_comes_back_from_pycollada(unit, metres, name):
    document = load(collada_text(still(1), unit=unit)[0])
    assert document.assetInfo.unitmeter == metres and document.assetInfo.unitname == name
    hand = world(document.scene.nodes[0])["hand"] * document.assetInfo.unitmeter
    np.testing.assert_allclose(hand, ARM_HANDS[1] * 0.01, atol=1e-7)


@pytest.mark.parametrize("rotations", [False, True])
def test_the_keys_of_the_animation_are_the_motion(rotations):
    motion = tumbling(4, frames=5)
    document = load(collada_text(motion, rotations=rotations)[0])
    assert len(document.animations) == len(motion.names)
    tree = ElementTree.fromstring(collada_text(motion, rotations=rotations)[0])
    locals_ = {}
    for animation in tree.iter(f"{{{NS['c']}}}animation"):
        arrays = [np.array(a.text.split(), dtype=float) for a in animation.iter(f"{{{NS['c']}}}float_array")]
        np.testing.assert_allclose(arrays[0], np.arange(5) / 29.97, rtol=1e-9)
        locals_[animation.find("c:channel", NS).get("target")] = arrays[1].reshape(5, 4, 4)
    T: dict[int, np.ndarray] = {}
    for joint, parent in enumerate(motion.parents):
        local = locals_[f"joint{joint}/transform"]
        T[joint] = local if parent < 0 else T[parent] @ local
    found = np.stack([T[joint][:, :3, 3] for joint in range(len(motion.names))], axis=1)
    np.testing.assert_allclose(found, positions(motion), atol=1e-6)


def test_hostile_names_come_back_whole():
    text, _ = collada_text(still(names=HOSTILE))
    tree = ElementTree.fromstring(text)
    assert [e.text for e in tree.iterfind(".//c:technique[@profile='jaxmocap']/c:name", NS)] != []
    assert {e.text for e in tree.iterfind(".//c:technique[@profile='jaxmocap']/c:name", NS)} == set(HOSTILE)


def test_a_joint_of_no_length_is_not_in_the_document_s_hierarchy():
    motion = still(names=("root-joint", "neck", "head"), offsets=np.array([[0.0, 0, 0], [0, 0, 0], [0, 2, 0]]))
    text, said = collada_text(motion)
    assert 'id="neck"' not in text and said.startswith("2 joints, 1 frame") and "without neck (no length)" in said
    assert 'id="neck"' in collada_text(motion, rotations=True)[0]


def test_ids_do_not_meet():
    motion = arm(names=("skeleton", "animation-0", "skeleton_"))
    tree = ElementTree.fromstring(collada_text(motion)[0])
    ids = [e.get("id") for e in tree.iter() if e.get("id")]
    assert len(ids) == len(set(ids))
    url = tree.find("c:scene/c:instance_visual_scene", NS).get("url")
    assert tree.find(f".//c:visual_scene[@id='{url[1:]}']", NS) is not None


def test_the_bytes_are_those_kept(tmp_path):
    said = write_collada(tmp_path / "arm.dae", arm())
    assert said.startswith(str(tmp_path / "arm.dae")) and "3 joints, 3 frames at 25 frames per second" in said
    assert (tmp_path / "arm.dae").read_bytes() == (GOLDEN / "arm.dae").read_bytes()


def test_numbers_never_say_minus_zero():
    assert " -0 " not in collada_text(arm(rotvec=np.full((3, 3, 3), -0.0)))[0]
    assert math.copysign(1, -0.0) == -1  # so that the line above was a test
